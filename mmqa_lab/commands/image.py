"""Measure a photograph of the imaging chart: pixel size, resolved line pairs, MTF.

One row per image: how the chart was located, the pixel size in both directions with standard
deviations, the finest resolved line pairs w with the next finer ones and the interpolated limit,
MTF50 from the long bars, noise and clipping as shares of the chart's contrast (Pfeifer et al. 2021,
doi 10.3390/rs13020237). What cannot be measured is empty, and what speaks against the figures
stands in remark. Of several images those that cannot be evaluated have their row too, the last.
The chart is found by its coded targets and long bars, at --corners, or from --orientation.

With --legibility the row has the pixels per 40 mm capital and the mark that a jury would give by
them, with its range, and where rapidocr-onnxruntime is installed the mark of what it reads of the
check list's elements that count and the first element with that mark. They never stand for a jury.

Corners are column and row of the printed chart's lower left, lower right, upper right and upper
left corner. An orientation is a JSON file: position [east, north, height], heading_deg, pitch_deg,
roll_deg, camera {width, height, focal_px, principal, distortion} or {width} for a panorama, and
corners, four [east, north, height].
"""

from pathlib import Path

from mmqa_lab.commands._output import (
    FIGURE,
    OUTPUT,
    option,
    output_file,
    print_rows,
    switch,
    with_progress,
    write_figure,
)

SUMMARY = "pixel size, resolved line pairs and MTF of a photographed chart"

EPILOG = """\
example:
  mmqa chart --out chart.pdf --layout chart.json
  mmqa image IMG_0001.jpg --chart chart.json --out reading.png
  mmqa image pano.jpg --chart grey --panorama --json \\
      --corners "2010,1390; 2350,1392; 2352,1050; 2008,1049"
"""


ARGUMENTS = (
    option("image", "IMAGE", "JPEG, PNG or TIFF", nargs="+"),
    option("--chart", "LAYOUT", "grey (default), black, revised, JSON of mmqa chart", str, "grey"),
    option("--corners", "'X,Y; ...'", "the chart's corners, pixels"),
    option("--orientation", "FILE", "JSON, see above", Path),
    switch("--panorama", "equirectangular, 2 : 1"),
    switch("--linear", "grey values are linear in light"),
    switch("--legibility", "how well text of 40 mm can be read"),
    option("--patterns", "FILE", "write every pattern's reading as CSV", output_file),
    FIGURE,
    *OUTPUT,
)


def run(options):
    """Evaluate every image, then print, write and draw."""
    import pandas as pd

    from mmqa_lab._checks import check_choice
    from mmqa_lab.chart_image import evaluate_file
    from mmqa_lab.chart_image.evaluation import read_layout
    from mmqa_lab.io import write_atomically

    if options.out is not None:
        check_choice(options.out.suffix.lower(), "figure", (".pdf", ".svg", ".png"))
    layout = read_layout(options.chart)
    choices = {
        "corners": None if options.corners is None else _corners(options.corners),
        "camera": "panorama" if options.panorama else "plain",
        "gamma": "linear" if options.linear else "srgb",
        "orientation": options.orientation,
    }
    rows, patterns, faults = [], [], {}
    for file in with_progress(options.image, "image"):
        try:
            quality = evaluate_file(file, layout, **choices)
        except (ValueError, OSError) as error:
            faults[file] = error
            rows.append(pd.DataFrame([{"file": str(file), "remark": str(error)}]))
            continue
        last = file
        row = quality.to_frame().assign(file=str(file))
        rows.append(row.assign(**_legibility(quality)) if options.legibility else row)
        patterns.append(quality.pairs.assign(file=str(file)))
    if not patterns:
        if len(faults) > 1:
            raise ValueError("; ".join(f"{file}: {error}" for file, error in faults.items()))
        raise next(iter(faults.values()))
    if options.patterns is not None:
        table = pd.concat(patterns)
        write_atomically(options.patterns, lambda path: table.to_csv(path, index=False))
    if options.out is not None:
        _draw(quality, options.out, last)
    # one figure per line reads better than twenty columns
    rows.sort(key=lambda row: row["file"].item() in map(str, faults))
    print_rows(pd.concat(rows, ignore_index=True), options, upright="file")


def _legibility(quality):
    """What pixels, and a program where one is installed, say of text of 40 mm."""
    from importlib.util import find_spec

    from mmqa_lab.chart_image import legibility, text_crops

    pixels = legibility.TEXT_MM / quality.pixel_size("v")[0]
    found = {"px_per_40mm": pixels, "expected_mark": legibility.expected_text(pixels)}
    if find_spec("rapidocr_onnxruntime") is None:
        return found
    try:
        texts = legibility.check_list(quality.layout)
    except ValueError:  # a chart of one's own, without the paper's texts
        return found
    texts = [text for text in texts if text.name in legibility.JUDGED]
    crops = text_crops(quality.image, quality.layout, quality.chart_map, texts=texts)
    read = legibility.read_texts(crops)
    worst = read.sort_values("mark", ascending=False, kind="stable").iloc[0]
    return found | {"read_mark": worst["mark"], "read_because": worst["element"]}


def _draw(quality, file, name):
    """Write the figure of one evaluated photograph."""
    from mmqa_lab import plots

    with plots.style():
        figure, axes = plots.subplots(1, 2, width="double", height_mm=85)
        quality.plot(ax=axes[0])
        quality.plot_contrast(ax=axes[1])
        write_figure(file, figure, title=f"Imaging chart in {name}")


def _corners(text):
    """Four corners from 'x,y; x,y; x,y; x,y'."""
    try:
        return [[float(part) for part in corner.split(",")] for corner in text.split(";")]
    except ValueError:
        raise ValueError(f"Invalid corners {text!r}. Must be four times x,y between ;.") from None
