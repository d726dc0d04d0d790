"""Line-segment Hausdorff distance between two sets of 3-D edges.

TEST and MODEL are CSV files of segments (x1,y1,z1,x2,y2,z2 in metres, a line each, header optional)
or two clouds (LAS, LAZ, COPC, PLY), whose edges are extracted first: planes are detected and
adjacent ones intersected. The published method pairs all segments below a threshold (--matcher all,
Poreba & Goulette 2013, hal-00846334). The value holds angle and end-point noise and false pairs as
well as displacement: compare it with the perpendicular part and the displacement vector below it.
"""

from pathlib import Path

from mmqa_lab.commands._output import print_json

SUMMARY = "line-segment Hausdorff distance of two edge sets or two clouds"

EPILOG = """\
example:
  mmqa lhd course.csv reference.csv
  mmqa lhd course.csv reference.csv --matcher displaced --json
  mmqa lhd course.laz reference.laz --tolerance 0.05 --size 2 --edges .
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
        default=200,
        metavar="N",
        help="points of a plane, default %(default)s",
    )
    clouds.add_argument(
        "--edges", type=Path, metavar="FOLDER", help="write extracted edges there as CSV"
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def run(options):
    """Read or extract both sets, compare and print."""
    from mmqa_lab.segments import lhd

    test, model = (_segments(path, options) for path in (options.test, options.model))
    result = lhd(
        test,
        model,
        weight=options.weight,
        sensitivity=options.sensitivity,
        matcher=options.matcher,
        radius=options.radius,
    )
    if options.json:
        print_json(result.to_dict())
    else:
        print("\n".join(_lines(result)))


def _segments(path, options):
    """Segments from a file of them, or the edges of a cloud."""
    if path.suffix.lower() not in CLOUD_ENDINGS:
        from mmqa_lab.segment_files import read_segments

        return read_segments(path)
    from mmqa_lab.edges import extract_edges
    from mmqa_lab.io import read_cloud

    points = read_cloud(path, columns=()).points
    sizes = {"tolerance": options.tolerance, "size": options.size, "minimum": options.minimum}
    edges = extract_edges(points, **sizes)
    if not len(edges):
        raise ValueError(f"Invalid cloud {path}: no edges between planes. Must have some.")
    if options.edges is not None:
        from mmqa_lab.segment_files import write_segments

        write_segments(options.edges / f"{path.stem}_edges.csv", edges.segments)
    return edges.segments


def _lines(result):
    """What the table says."""
    forward, backward = result.test_model, result.model_test
    low, high = result.interval()
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
