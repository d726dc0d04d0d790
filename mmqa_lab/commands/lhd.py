"""Line-segment Hausdorff distance between two sets of 3-D edges.

TEST and MODEL are CSV files of segments (x1,y1,z1,x2,y2,z2 in metres, a line each, header optional)
or two clouds (LAS, LAZ, COPC, PLY), whose edges are extracted first: planes are detected and
adjacent ones intersected. The published method pairs all segments below a threshold (--matcher all,
Poreba & Goulette 2013, hal-00846334). The value contains the noise of angles and ends and false
pairs as well as displacement: compare it with the perpendicular part and the displacement vector
below it.
"""

from pathlib import Path

from mmqa_lab.commands._output import (
    add_output_arguments,
    print_json,
    with_progress,
    write_rows,
)

SUMMARY = "line-segment Hausdorff distance of two edge sets or two clouds"

EPILOG = """\
example:
  mmqa lhd course.csv reference.csv
  mmqa lhd course.csv reference.csv --matcher displaced --json
  mmqa lhd course.laz reference.laz --tolerance 0.05 --size 2 --out edges
"""

MATCHERS = ("all", "nearest", "mutual", "hungarian", "fragments", "displaced")
CLOUD_ENDINGS = (".las", ".laz", ".ply")


def add_arguments(parser):
    """Declare the arguments."""
    parser.add_argument("test", type=Path, metavar="TEST", help="CSV of segments, or a cloud")
    parser.add_argument("model", type=Path, metavar="MODEL", help="the reference, the same kinds")
    parser.add_argument(
        "--weight", type=float, default=10.0, metavar="W", help="of the angle, default %(default)s"
    )
    parser.add_argument(
        "--sensitivity",
        type=float,
        default=0.5,
        metavar="M",
        help="of the peak that gives the threshold, default %(default)s m",
    )
    parser.add_argument("--matcher", choices=MATCHERS, default="all", help="default %(default)s")
    parser.add_argument(
        "--radius",
        type=float,
        default=4.0,
        metavar="M",
        help="largest displacement the displaced matcher seeks, default %(default)s m",
    )
    for name, choices, what in (
        ("rotate", ("test", "shorter"), "the line that is turned"),
        ("within", ("containment", "overlap"), "when the parallel part vanishes"),
        ("norm", ("pairs", "matched", "all"), "denominator of equation 7"),
    ):
        parser.add_argument(
            f"--{name}", choices=choices, default=choices[0], help=f"{what}, default %(default)s"
        )
    clouds = parser.add_argument_group("clouds")
    clouds.add_argument(
        "--tolerance",
        type=float,
        default=0.05,
        metavar="M",
        help="of a plane, about three times the noise, default %(default)s m",
    )
    clouds.add_argument(
        "--size",
        type=float,
        default=2.0,
        metavar="M",
        help="extent of the smallest plane, default %(default)s m",
    )
    clouds.add_argument(
        "--minimum",
        type=int,
        metavar="N",
        help="points of a plane, default 30; its least area grows with the size",
    )
    clouds.add_argument(
        "--out", "--edges", type=Path, metavar="FOLDER", help="write extracted edges there as CSV"
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="of the interval, default 0"
    )
    add_output_arguments(parser)


def run(options):
    """Read or extract both sets, compare, print and write."""
    from mmqa_lab._checks import check_count
    from mmqa_lab.lines import lhd

    check_count(options.seed, "seed", low=0)
    files = with_progress((options.test, options.model), "set")
    test, model = (_segments(path, options) for path in files)
    result = lhd(
        test,
        model,
        weight=options.weight,
        sensitivity=options.sensitivity,
        matcher=options.matcher,
        rotate=options.rotate,
        within=options.within,
        norm=options.norm,
        radius=options.radius,
    )
    interval = result.interval(seed=options.seed)
    values = result.to_dict() | dict(zip(("lhd_low_m", "lhd_high_m"), interval, strict=True))
    if options.csv is not None:
        write_rows(_row(options, values), options)
    if options.json:
        print_json(values)
    else:
        print("\n".join(_lines(result, interval)))


def _segments(path, options):
    """Segments from a file of them, or the edges of a cloud."""
    if path.suffix.lower() not in CLOUD_ENDINGS:
        from mmqa_lab.io import read_segments

        return read_segments(path)
    from mmqa_lab.io import read_cloud
    from mmqa_lab.lines import extract_edges

    points = read_cloud(path, columns=()).points
    sizes = {"tolerance": options.tolerance, "size": options.size, "minimum": options.minimum}
    edges = extract_edges(points, **sizes)
    if not len(edges):
        raise ValueError(f"Invalid cloud {path}: no edges between planes. Must have some.")
    if options.out is not None:
        from mmqa_lab.io import write_segments

        write_segments(options.out / f"{path.stem}_edges.csv", edges.segments)
    return edges.segments


def _row(options, values):
    """The figures as one row; pairs and covariances are left to JSON."""
    import pandas as pd

    vector = dict(zip("xyz", values["displacement_m"], strict=True))
    plain = {name: value for name, value in values.items() if not isinstance(value, list)}
    plain |= {f"displacement_{axis}_m": value for axis, value in vector.items()}
    return pd.DataFrame([{"test": options.test, "model": options.model, **plain}])


def _lines(result, interval):
    """What the table says."""
    forward, backward = result.test_model, result.model_test
    low, high = interval
    covariance = result.displacement.covariance
    vector = " ".join(f"{value:8.3f}" for value in result.displacement.vector)
    sigma = " ".join(f"{value**0.5:8.3f}" for value in covariance.diagonal())
    rows = [
        ("segments", f"{forward.pairs.shape[0]} test, {forward.pairs.shape[1]} model"),
        ("matcher", result.matcher),
        ("LHD", f"{result.value:.3f} m  (95 % {low:.3f} to {high:.3f})"),
        ("  test to model", _direction(forward, result.weight)),
        ("  model to test", _direction(backward, result.weight)),
        ("same pairs, W = 0", f"{result.at_weight(0):.3f} m"),
        ("perpendicular only", f"{result.perpendicular_only:.3f} m"),
        ("displacement", f"{vector} m"),
        ("  standard dev.", f"{sigma} m"),
        ("coverage", f"{forward.coverage:.0%} of test, {backward.coverage:.0%} of model length"),
    ]
    return [f"{name:<20}{text}" for name, text in rows]


def _direction(direction, weight):
    """One direction in words."""
    value = f"{direction.olhd(weight):.3f} m, {direction.n} pairs"
    delta = direction.threshold.delta
    return value if delta != delta else f"{value} within {delta:.3f} m"
