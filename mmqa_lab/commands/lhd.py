"""Distances between sets of 3-D edges."""

from pathlib import Path

from mmqa_lab.commands import OUTPUT, Lazy, command, option
from mmqa_lab.commands._output import print_json, print_rows, write_rows

pd = Lazy("pandas")
checks = Lazy("mmqa_lab._checks")
comparisons = Lazy("mmqa_lab.lines.comparisons")

MATCHERS = ("all", "nearest", "mutual", "hungarian", "fragments", "displaced")

WITHIN = ("containment", "overlap")

NORMS = ("pairs", "matched", "all")

SETTINGS = ("weight", "sensitivity", "matcher", "radius", "rotate", "within", "norm")

SIZES = ("tolerance", "size", "minimum")


@command(
    "line-segment Hausdorff distances of edge sets or clouds",
    option("files", "FILE", "file of segments, or a cloud", Path, nargs="+"),
    option("--reference", "FILE", "the static survey", Path),
    option(
        "--truth",
        "FILE",
        "CSV of true pairs: test_set,model_set,test_segment,model_segment, from 0",
        Path,
    ),
    option("--settings", "FILE", 'settings by name as JSON; of one: {"C1": {"size": 3}}', Path),
    option("--weight", "W", "of the angle, default 10", float),
    option("--sensitivity", "M", "of the peak that gives the threshold, default 0.5 m", float),
    option("--radius", "M", "largest displacement that is sought, default 4 m", float),
    option("--tolerance", "M", "clouds: of a plane, three times the noise, default 0.05 m", float),
    option("--size", "M", "clouds: extent of the smallest plane, default 1.5 or 2 m", float),
    option(
        "--minimum",
        "N",
        "clouds: points of a plane; its least area grows with the size, default 10 to 30",
        int,
    ),
    option("--matcher", None, "who pairs, default all", choices=MATCHERS),
    option("--rotate", None, "who of a pair turns, default test", choices=("test", "shorter")),
    option("--within", None, "where the parallel part is 0, default containment", choices=WITHIN),
    option("--norm", None, "denominator of equation 7, default pairs", choices=NORMS),
    option("--out --edges", "FOLDER", "write the report and edges there", Path),
    option("--seed", "N", "of the interval", int, 0),
    *OUTPUT,
    examples=(
        "course.csv reference.csv",
        "course.csv reference.csv --matcher displaced --json",
        "course.laz reference.laz --tolerance 0.05 --size 2 --out edges",
        "C1.laz C2.laz C3.laz --reference TLS.laz --truth pairs.csv --out report",
    ),
)
def lhd(options):
    """Line-segment Hausdorff distances between sets of 3-D edges, both ways.

    FILES are two or more sets: files of segments (CSV with x1,y1,z1,x2,y2,z2 in metres, a line
    each, header optional; GeoJSON; DXF where ezdxf is installed) or clouds (LAS, LAZ, COPC, PLY),
    whose edges are extracted first: planes are detected and adjacent ones intersected. Every set is
    compared with every other, and with --reference. The published method pairs all segments below a
    threshold (--matcher all, Poreba & Goulette 2013, hal-00846334). The value contains the noise of
    angles and ends and false pairs as well as displacement: compare it with the perpendicular part
    and the displacement vector below it. --out writes the tables, matrices, figures and a page.
    """
    checks.check_count(options.seed, "seed", low=0)
    settings = comparisons.read_settings(options.settings)
    given = {name: getattr(options, name) for name in (*SETTINGS, *SIZES)}
    settings |= {name: value for name, value in given.items() if value is not None}
    found = comparisons.study(
        options.files, reference=options.reference, truth=options.truth, settings=settings
    )
    if options.out is not None:
        comparisons.write_report(found, options.out)
    if len(found.results) == 1 and options.truth is None:
        names, result = next(iter(found.results.items()))
        _print_one(result, found.displacements[names], options)
    elif options.json:
        write_rows(found.to_frame(), options)
        tables = {"directions": found.to_frame(), "comparisons": found.comparisons()}
        print_json({name: table.to_dict(orient="records") for name, table in tables.items()})
    else:
        print_rows(found.to_frame(), options)
        print(f"\n{found.comparisons().T.to_string(header=False, float_format='{:.4g}'.format)}")


def _print_one(result, moved, options):
    """One comparison in detail; pairs and covariances are left to JSON.

    The displacement is that of the pairs that agree on one: those of the distance may be false.
    """
    interval = result.interval(seed=options.seed)
    values = result.to_dict() | dict(zip(("lhd_low_m", "lhd_high_m"), interval, strict=True))
    values |= {"displacement_m": moved.vector.tolist(), "turn_deg": moved.turn_deg}
    values["displacement_covariance_m2"] = moved.covariance.tolist()
    values["turn_sigma_deg"] = moved.turn_sigma_deg
    row = {"test": result.test.name, "model": result.model.name}
    row |= {name: value for name, value in values.items() if not isinstance(value, list)}
    for axis, shift, variance in zip("xyz", moved.vector, moved.covariance.diagonal(), strict=True):
        row |= {f"displacement_{axis}_m": shift, f"displacement_{axis}_sigma_m": variance**0.5}
    if options.json:
        write_rows(pd.DataFrame([row]), options)
        print_json(values)
    else:
        print_rows(pd.DataFrame([row]), options, upright="test")
