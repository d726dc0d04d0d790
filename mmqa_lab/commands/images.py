"""Charts to print, and their photographs."""

from mmqa_lab.commands import FIGURE, OUTPUT, Lazy, command, option, output_file, switch
from mmqa_lab.commands._output import print_rows, with_progress, write_figure

pd = Lazy("pandas")
checks = Lazy("mmqa_lab._checks")
chart_image = Lazy("mmqa_lab.chart_image")
charts = Lazy("mmqa_lab.charts")
io = Lazy("mmqa_lab.io")
legibility = Lazy("mmqa_lab.chart_image.legibility")
plots = Lazy("mmqa_lab.plots")


@command(
    "write a test chart to print, as PDF or SVG",
    option("--out", "FILE", ".pdf, .svg, or .csv for its elements", output_file, required=True),
    option("--chart", "LAYOUT", "grey (default), black, revised, or a CSV", str, "grey"),
    switch("--points", "the point-distribution chart"),
    option("--seed", "N", "of the point chart's cells, default 0", int, 0),
    *OUTPUT,
    examples=(
        "--out chart.pdf",
        "--chart revised --out chart.csv",
        "--points --seed 4 --out points.pdf",
    ),
)
def chart(options):
    """Write a test chart to print, 1 m x 1 m at true size, as PDF or SVG.

    The imaging chart has long bars for the pixel size, line pairs for the resolution, texts and
    symbols for the legibility and coded targets for its place; the point chart has random cells and
    two plain squares (Pfeifer et al. 2021, doi 10.3390/rs13020237). Print without scaling; greys
    and colours are sRGB. With an ending .csv the table of elements is written: edit it, and give it
    to --chart for a chart of your own.
    """
    writers = {
        ".pdf": charts.Layout.to_pdf,
        ".svg": charts.Layout.to_svg,
        ".csv": lambda layout: layout.to_csv().encode(),
    }
    ending = checks.check_choice(options.out.suffix.lower(), "ending", tuple(writers))
    points = options.points
    layout = charts.point_chart(seed=options.seed) if points else charts.read_layout(options.chart)
    text = writers[ending](layout)
    io.write_atomically(options.out, lambda path: path.write_bytes(text))
    size = {"width_mm": layout.width, "height_mm": layout.height}
    row = {"file": str(options.out), "chart": layout.name, **size, "elements": len(layout.elements)}
    print_rows(pd.DataFrame([row]), options)


@command(
    "pixel size and resolved line pairs of a photographed chart",
    option("image", "IMAGE", "JPEG, PNG or TIFF", nargs="+"),
    option("--chart", "LAYOUT", "grey (default), black, revised, or a CSV", str, "grey"),
    option("--corners", "'X,Y; ...'", "the chart's corners, pixels"),
    switch("--panorama", "equirectangular, 2 : 1"),
    switch("--linear", "grey values are linear in light"),
    option("--patterns", "FILE", "write every pattern's reading as CSV", output_file),
    FIGURE,
    *OUTPUT,
    examples=(
        "IMG_0001.jpg --chart chart.csv --out reading.png",
        "pano.jpg --chart grey --panorama --json \\\n"
        '      --corners "2010,1390; 2350,1392; 2352,1050; 2008,1049"',
    ),
)
def image(options):
    """Measure a photograph of the imaging chart: pixel size, resolved line pairs, legibility.

    One row per image: how the chart was located, the pixel size in both directions with standard
    deviations, the finest resolved line pairs w with the next finer ones and the interpolated
    limit, noise and clipping as shares of the chart's contrast, the pixels per capital of 40 mm and
    the mark that a jury would give by them (Pfeifer et al. 2021, doi 10.3390/rs13020237). What
    cannot be measured is empty, and what speaks against the figures stands in remark. Of several
    images those that cannot be evaluated have their row too, the last. The chart is found by its
    coded targets and long bars, or at --corners: column and row of the printed chart's lower left,
    lower right, upper right and upper left corner.
    """
    if options.out is not None:
        checks.check_choice(options.out.suffix.lower(), "figure", (".pdf", ".svg", ".png"))
    layout = charts.read_layout(options.chart)
    choices = {
        "corners": None if options.corners is None else _corners(options.corners),
        "camera": "panorama" if options.panorama else "plain",
        "gamma": "linear" if options.linear else "srgb",
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
        pixels = legibility.TEXT_MM / quality.pixel_size("v")[0]
        mark = {"px_per_40mm": pixels, "expected_mark": legibility.expected_text(pixels)}
        rows.append(quality.to_frame().assign(file=str(file), **mark))
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
