"""Charts to print, and their photographs."""

from functools import partial
from importlib.util import find_spec
from pathlib import Path

from mmqa_lab.commands import FIGURE, OUTPUT, Lazy, command, numbers, option, output_file, switch
from mmqa_lab.commands._output import print_rows, with_progress, write_figure

pd = Lazy("pandas")
checks = Lazy("mmqa_lab._checks")
chart_image = Lazy("mmqa_lab.chart_image")
charts = Lazy("mmqa_lab.charts")
io = Lazy("mmqa_lab.io")
legibility = Lazy("mmqa_lab.chart_image.legibility")
plots = Lazy("mmqa_lab.plots")


WIDTHS = "numbers between commas"


@command(
    "write a test chart to print, as PDF or SVG",
    option("--out", "FILE", ".pdf, .svg or .json", output_file, required=True),
    switch("--points", "the point-distribution chart"),
    switch("--revised", "as the authors advise: pairs of 60 mm, too, and the lying bar black"),
    option("--bar", None, "tone of the lying bar: grey", choices=("grey", "black")),
    option("--widths-h", "MM,MM,...", "widths of line pairs with standing bars, coarse to fine"),
    option("--widths-v", "MM,MM,...", "widths of line pairs with lying bars, coarse to fine"),
    switch("--no-texts", "line pairs and bars alone"),
    switch("--no-targets", "without coded targets"),
    option("--first-target", "N", "number of the lower left target, so that charts differ", int),
    option("--seed", "N", "of the point chart's cells, default 0", int),
    option("--layout", "FILE", "also write the layout as JSON", output_file),
    switch("--crop-marks", "a larger page with marks to cut the chart at"),
    option("--tiles", None, "a page for each part, with marks", choices=("a3", "a4")),
    *OUTPUT,
    examples=(
        "--out chart.pdf",
        "--out fine.svg --widths-h 30,24,20,16,12,10 --layout fine.json",
        "--points --seed 4 --out points.pdf",
        "--revised --tiles a3 --out tiles.pdf",
    ),
)
def chart(options):
    """Write a test chart to print, 1 m x 1 m at true size, as PDF or SVG.

    The imaging chart has long bars for the pixel size, line pairs for the resolution, texts and
    symbols for the legibility and coded targets for its place; the point chart has random cells and
    two plain squares (Pfeifer et al. 2021, doi 10.3390/rs13020237). Print without scaling; greys
    and colours are sRGB. Tiles are to be cut at their marks and mounted edge to edge. With an
    ending .json the layout itself is written, for mmqa image --chart.
    """
    sheets = {"crop_marks": options.crop_marks, "tiles": options.tiles}
    writers = {
        ".pdf": partial(charts.Layout.to_pdf, **sheets),
        ".svg": charts.Layout.to_svg,
        ".json": lambda layout: layout.to_json().encode(),
    }
    ending = checks.check_choice(options.out.suffix.lower(), "ending", tuple(writers))
    if options.layout is not None:
        checks.check_choice(options.layout.suffix.lower(), "layout's ending", (".json",))
    if any(sheets.values()) and ending != ".pdf":
        raise ValueError(f"Invalid ending {ending} for crop marks or tiles. Must be .pdf.")
    layout = _layout(options)
    for file, write in ((options.out, writers[ending]), (options.layout, writers[".json"])):
        if file is not None:
            text = write(layout)
            io.write_atomically(file, lambda path, text=text: path.write_bytes(text))
    size = {"width_mm": layout.width, "height_mm": layout.height}
    row = {"file": str(options.out), "chart": layout.name, **size, "elements": len(layout.elements)}
    print_rows(pd.DataFrame([row]), options)


def _layout(options):
    """The layout that the options ask for."""
    given = {
        "revised": options.revised or None,
        "horizontal_bar": options.bar,
        "widths_h": options.widths_h and numbers(options.widths_h, "widths_h", WIDTHS),
        "widths_v": options.widths_v and numbers(options.widths_v, "widths_v", WIDTHS),
        "first_marker": options.first_target,
        "texts": False if options.no_texts else None,
    }
    choices = {name: value for name, value in given.items() if value is not None}
    if options.points and (choices or options.no_targets):
        raise ValueError("Invalid options for a point chart. Must be --seed alone.")
    if options.points:
        return charts.point_chart(seed=options.seed or 0)
    if options.seed is not None:
        raise ValueError(f"Invalid seed {options.seed}. Must go with --points.")
    if options.no_targets:
        choices["dictionary"] = None
    return charts.imaging_chart(**choices)


@command(
    "pixel size, resolved line pairs and MTF of a photographed chart",
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
    examples=(
        "--out chart.pdf --layout chart.json",
        "IMG_0001.jpg --chart chart.json --out reading.png",
        "pano.jpg --chart grey --panorama --json \\\n"
        '      --corners "2010,1390; 2350,1392; 2352,1050; 2008,1049"',
    ),
)
def image(options):
    """Measure a photograph of the imaging chart: pixel size, resolved line pairs, MTF.

    One row per image: how the chart was located, the pixel size in both directions with standard
    deviations, the finest resolved line pairs w with the next finer ones and the interpolated
    limit, MTF50 from the long bars, noise and clipping as shares of the chart's contrast (Pfeifer
    et al. 2021, doi 10.3390/rs13020237). What cannot be measured is empty, and what speaks against
    the figures stands in remark. Of several images those that cannot be evaluated have their row
    too, the last. The chart is found by its coded targets and long bars, at --corners, or from
    --orientation.

    With --legibility the row has the pixels per 40 mm capital and the mark that a jury would give
    by them, with its range, and where rapidocr is installed (pip install rapidocr onnxruntime) the
    mark of what it reads of the check list's elements that count and the first element with that
    mark. They never stand for a jury.

    Corners are column and row of the printed chart's lower left, lower right, upper right and upper
    left corner. An orientation is a JSON file: position [east, north, height], heading_deg,
    pitch_deg, roll_deg, camera {width, height, focal_px, principal, distortion} or {width} for a
    panorama, and corners, four [east, north, height].
    """
    if options.out is not None:
        checks.check_choice(options.out.suffix.lower(), "figure", (".pdf", ".svg", ".png"))
    layout = chart_image.read_layout(options.chart)
    choices = {
        "corners": None if options.corners is None else _corners(options.corners),
        "camera": "panorama" if options.panorama else "plain",
        "gamma": "linear" if options.linear else "srgb",
        "orientation": options.orientation,
    }
    rows, patterns, faults = [], [], {}
    for file in with_progress(options.image, "image"):
        try:
            quality = chart_image.evaluate_file(file, layout, **choices)
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
        io.write_atomically(options.patterns, lambda path: table.to_csv(path, index=False))
    if options.out is not None:
        _draw(quality, options.out, last)
    # one figure per line reads better than twenty columns
    rows.sort(key=lambda row: row["file"].item() in map(str, faults))
    print_rows(pd.concat(rows, ignore_index=True), options, upright="file")


def _legibility(quality):
    """What pixels, and a program where one is installed, say of text of 40 mm."""
    pixels = legibility.TEXT_MM / quality.pixel_size("v")[0]
    found = {"px_per_40mm": pixels, "expected_mark": legibility.expected_text(pixels)}
    if find_spec("rapidocr") is None:
        return found
    try:
        texts = legibility.check_list(quality.layout)
    except ValueError:  # a chart of one's own, without the paper's texts
        return found
    texts = [text for text in texts if text.name in legibility.JUDGED]
    crops = chart_image.text_crops(quality.image, quality.layout, quality.chart_map, texts=texts)
    read = legibility.read_texts(crops)
    worst = read.sort_values("mark", ascending=False, kind="stable").iloc[0]
    return found | {"read_mark": worst["mark"], "read_because": worst["element"]}


def _draw(quality, file, name):
    """Write the figure of one evaluated photograph."""
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
