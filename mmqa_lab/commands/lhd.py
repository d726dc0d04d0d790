"""Distances between sets of 3-D edges."""

from pathlib import Path

from mmqa_lab.commands import OUTPUT, Lazy, command, option
from mmqa_lab.commands._output import print_rows, write_rows

io = Lazy("mmqa_lab.io")
lines = Lazy("mmqa_lab.lines")

MATCHERS = ("all", "nearest", "mutual", "hungarian", "fragments", "displaced")


@command(
    "line-segment Hausdorff distances of edge sets or clouds",
    option("files", "FILE", "file of segments (CSV), or a cloud", Path, nargs="+"),
    option("--reference", "FILE", "the static survey", Path),
    option("--weight", "W", "of the angle", float, 10.0),
    option("--sensitivity", "M", "of the peak that gives the threshold", float, 0.5),
    option("--radius", "M", "largest displacement that is sought", float, 4.0),
    option("--tolerance", "M", "clouds: of a plane, three times the noise", float, 0.05),
    option("--size", "M", "clouds: extent of the smallest plane, default 1.5 or 2 m", float),
    option("--matcher", None, "who pairs, default all", choices=MATCHERS),
    *OUTPUT,
    examples=(
        "course.csv reference.csv --matcher displaced",
        "C1.laz C2.laz C3.laz --reference TLS.laz",
    ),
)
def lhd(options):
    """Line-segment Hausdorff distances between sets of 3-D edges, both ways.

    FILES are two or more sets: files of segments (CSV with x1,y1,z1,x2,y2,z2 in metres, a line
    each, header optional) or clouds (LAS, LAZ, COPC, PLY), whose edges are extracted first: planes
    are detected and adjacent ones intersected. Every set is compared with every other, and with
    --reference. The published method pairs all segments below a threshold (--matcher all, Poreba &
    Goulette 2013, hal-00846334). The value contains the noise of angles and ends and false pairs as
    well as displacement: compare it with the perpendicular part and the displacement beside it.
    """
    files = [*options.files, *([options.reference] if options.reference else [])]
    names = [file.stem for file in files]
    if len(set(names)) < len(names):
        names = [str(file) for file in files]
    sets = {}
    for name, file in zip(names, files, strict=True):
        if file.suffix.lower() in (".csv", ".txt"):
            sets[name] = io.read_segments(file)
        else:
            points = io.read_cloud(file, columns=()).points
            sizes = {"tolerance": options.tolerance, "size": options.size}
            sets[name] = lines.extract_edges(points, **sizes).segments
    table = lines.compare(
        sets,
        reference=names[-1] if options.reference else None,
        radius=options.radius,
        weight=options.weight,
        sensitivity=options.sensitivity,
        matcher=options.matcher or "all",
    )
    if options.json:
        write_rows(table, options)
    print_rows(table, options)
