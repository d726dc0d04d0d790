"""The pattern that a scanner lays on a surface: before the drive, and in its cloud."""

import argparse
import warnings
from dataclasses import replace

from mmqa_lab.commands import CLOUDS, OUTPUT, POLYGON, Lazy, command, option, switch
from mmqa_lab.commands._output import print_json, print_rows, with_progress, write_rows

pd = Lazy("pandas")
checks = Lazy("mmqa_lab._checks")
chart_cloud = Lazy("mmqa_lab.chart_cloud")
io = Lazy("mmqa_lab.io")
scan_pattern = Lazy("mmqa_lab.scan_pattern")
systems = Lazy("mmqa_lab.simulate.systems")

SETUP = {
    "pulse_rate": "pulse_rate_hz",
    "mirror_frequency": "mirror_frequency_hz",
    "speed": "speed_m_s",
    "scanner_heading": "scanner_heading_deg",
    "scanner_tilt": "scanner_tilt_deg",
}
"""Options that describe the set-up, and the fields of ``ScanSetup`` that they give."""

SCANNERS = (
    *("zf-9012", "zf-9012-fitted", "roamer", "roamer-dense", "vq-250", "vq-450", "lynx-m1"),
    *("lynx-m1-second", "push-broom"),
)

HEADS = ("roamer", "vmx-250", "streetmapper-360", "lynx", "sensei", "xp1", "lynx-m1")
"""Scanners of profiles, and systems."""

GRAZING_DEG = 85.0
"""Incidence beyond which neighbouring points lie too far apart for a prediction at one point."""


def limit(text):
    """A quantity and its limit from ``quantity=limit``."""
    quantity, _, value = text.partition("=")
    try:
        return quantity, float(value)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"Invalid limit {text!r}. Must be a quantity and a number, like density_per_m2=3000."
        ) from None


OF_ONE = ("sigma", "sensitivities", "largest_speed")
"""Options that a whole system does not take."""

SIGMA = {"action": "append", "default": []}


@command(
    "profile spacing, point spacing, density and f of a scan before it is driven",
    option("--pulse-rate", "HZ", "pulses per second", float),
    option("--mirror-frequency", "HZ", "revolutions of the mirror per second", float),
    option("--speed", "M/S", "speed of the vehicle", float),
    option("--scanner-heading", "DEG", "scan plane turned about the vertical, default 0", float),
    option("--scanner-tilt", "DEG", "scan plane tilted about X, default 0", float),
    option("--target-heading", "DEG", "of the target", float, 0.0),
    option("--target-tilt", "DEG", "of the target", float, 0.0),
    option("--range", "M", "X of the target at scanner height", float, required=True),
    option("--height-difference", "M", "above the scanner", float, 0.0),
    option("--scanner", "PRESET", f"a profile scanner by name: {', '.join(SCANNERS)}"),
    option(
        "--system", "NAME", f"all heads (layers) of a system, range from each: {', '.join(HEADS)}"
    ),
    option(
        "--sigma",
        "INPUT=STD",
        "standard deviation of an input, such as speed_m_s=0.1; may be given several times",
        limit,
        **SIGMA,
    ),
    switch("--sensitivities", "add the change of each figure per input"),
    option(
        "--largest-speed",
        "QUANTITY=LIMIT",
        "predict at the largest speed that keeps the limit, and name it",
        limit,
    ),
    *OUTPUT,
    examples=(
        "--pulse-rate 300000 --mirror-frequency 100 --speed 10 --scanner-heading 45 \\\n"
        "      --scanner-tilt 45 --target-heading 15 --range 5",
        "--scanner vq-450 --speed 14 --range 8 --json",
        "--system vmx-250 --speed 10 --range 8 --target-heading 20",
        "--scanner zf-9012 --range 5 --largest-speed density_per_m2=3000",
        "--scanner vq-250 --speed 10 --range 8 --sigma speed_m_s=0.2 \\\n"
        "      --sigma target_heading_deg=1.93",
    ),
)
def plan(options):
    """Predict what a profile scanner on a vehicle lays on a plane: spacings, angle, density, f.

    Frame: X across the track to the target's side, Y in the direction of travel, Z up. Angles are
    counter-clockwise positive, tilt is applied before heading. Scanner: all zero is a vertical scan
    plane across the track. Target: all zero is a vertical wall along the track; a positive heading
    turns it towards the vehicle, a positive tilt leans its top away. The range is the X at which
    the horizontal pulse strikes the plane; the figures are those at the height difference. After
    Cahalane et al. 2014 (doi 10.3390/s140609471), with the motion during a revolution.
    """
    target = scan_pattern.Target(
        heading_deg=options.target_heading,
        tilt_deg=options.target_tilt,
        range_m=options.range,
        height_difference_m=options.height_difference,
    )
    if options.system is not None:
        print_rows(_of_system(target, options), options)
        return
    setup, answer = _setup(options), {}
    if options.largest_speed is not None:
        quantity, limit = options.largest_speed
        answer["speed_m_s"] = scan_pattern.largest_speed(
            setup, target, quantity=quantity, limit=limit
        )
        setup = replace(setup, speed_m_s=answer["speed_m_s"])
    answer |= _prediction(setup, target)
    if options.sigma or options.sensitivities:
        print_rows(_with_errors(answer, setup, target, options), options)
        return
    write_rows(pd.DataFrame([answer]), options)
    if options.json:
        print_json(answer)
        return
    for name, value in answer.items():
        print(f"{name:<31}  {value:.6g}")


def _prediction(setup, target):
    """What a set-up lays on a target, by the quantities' names."""
    lattice = scan_pattern.scan_lattice(setup, target.patch(setup))
    found = {name: float(lattice.quantity(name)) for name in scan_pattern.QUANTITIES}
    if found["point_spacing_m"] != found["point_spacing_m"]:
        raise ValueError(
            f"Invalid target: at {lattice.incidence_deg:.4f} degrees of incidence the next pulse "
            "or profile passes beside it. Must be struck less obliquely."
        )
    if lattice.incidence_deg > GRAZING_DEG:
        warnings.warn(
            f"the target is struck at {lattice.incidence_deg:.1f} degrees of incidence; beyond "
            f"{GRAZING_DEG:g} degrees the point spacing along a profile changes so fast that the "
            "prediction may be wrong by half.",
            stacklevel=2,
        )
    return found


def _of_system(target, options):
    """What each head of a system lays on a target, and the density of all that see it."""
    alone = [name for name in (*SETUP, "scanner", *OF_ONE) if name != "speed"]
    others = [_flag(name) for name in alone if getattr(options, name)]
    if others:
        raise ValueError(f"Invalid {others[0]} with --system. Must be without it.")
    if options.speed is None:
        raise ValueError("Invalid plan without --speed. Must have it.")
    heads = systems.SYSTEMS[checks.check_choice(options.system, "system", HEADS)].heads
    found = pd.DataFrame()
    for number, profiler in enumerate((one for head in heads for one in head.layers), start=1):
        setup = scan_pattern.ScanSetup.of_scanner(profiler, speed_m_s=options.speed)
        if abs(target.heading_deg - setup.scanner_heading_deg) < 90:
            found[f"head_{number}"] = pd.Series(_prediction(setup, target))
    if found.empty:
        raise ValueError(
            f"Invalid target heading {target.heading_deg}. Must be less than 90 degrees from that "
            "of a head."
        )
    found.loc["density_per_m2", "together"] = found.loc["density_per_m2"].sum()
    return found.rename_axis("quantity").reset_index()


def _with_errors(answer, setup, target, options):
    """The figures with their uncertainty, and with their change per unit of each input."""
    found = pd.DataFrame({"predicted": answer}).rename_axis("quantity")
    if options.sigma:
        errors = scan_pattern.propagate(setup, target, sigmas=dict(options.sigma)).set_index(
            "quantity"
        )
        found = found.join(errors[["std", "low", "high"]])
    if options.sensitivities:
        found = found.join(scan_pattern.sensitivities(setup, target).T.add_prefix("per_"))
    return found.reset_index()


def _setup(options):
    """The set-up from the preset and from what was given beside it."""
    scanner = None
    if options.scanner is not None:
        scanner = systems.PRESETS[checks.check_choice(options.scanner, "scanner", SCANNERS)]
    given = {name: getattr(options, name) for name in SETUP if getattr(options, name) is not None}
    if options.largest_speed is not None:
        given.setdefault("speed", 1.0)
    for name in ("speed",) if scanner else ("pulse_rate", "mirror_frequency", "speed"):
        if name not in given:
            preset = "" if name == "speed" else ", or a preset with --scanner"
            raise ValueError(f"Invalid plan without {_flag(name)}. Must have it{preset}.")
    values = {SETUP[name]: value for name, value in given.items()}
    if scanner is None:
        return scan_pattern.ScanSetup(**values)
    return replace(scan_pattern.ScanSetup.of_scanner(scanner, speed_m_s=1.0), **values)


def _flag(name):
    """An option as it is typed."""
    return "--" + name.replace("_", "-")


@command(
    "profile spacing, profile angle and point spacing in a cloud",
    CLOUDS,
    *POLYGON,
    switch("--alone", "use neither times nor scan lines"),
    option("--mirror-frequency", "HZ", "revolutions a second, if known", float),
    option("--pulse-rate", "HZ", "pulses a second, if known", float),
    *OUTPUT,
    examples=(
        'facade.laz --polygon "0,0,0; 1,0,0; 1,0,1; 0,0,1"',
        "facade.laz --polygon patch.geojson --mirror-frequency 100 --json",
    ),
)
def pattern(options):
    """Measure the scan pattern of a planar patch: profile spacing, profile angle, point spacing.

    All profiles of the patch are fitted at once; every figure has its standard deviation. Profiles
    are told apart by scan line or GPS time where the file has them and --alone is not given,
    otherwise by the pattern: the straightest of its families of lines, with a warning where two fit
    equally well. One patch, one pass of one scanner head; without --polygon the whole cloud is
    taken for the patch. After Cahalane et al. 2014 (doi 10.3390/s140609471), section 4, who
    clicked.
    """
    tables = []
    for file in with_progress(options.cloud, "cloud"):
        found = _measured(file, options)
        tables.append(found.to_frame().assign(numbering=found.numbering))
        tables[-1].insert(0, "file", file)
    print_rows(pd.concat(tables, ignore_index=True), options)


def _measured(file, options):
    """The pattern of one file."""
    cloud = io.read_cloud(file)
    if options.polygon is not None:
        polygon = io.read_polygon(options.polygon)
        cloud = cloud[chart_cloud.inside_polygon(cloud, polygon, thickness=options.thickness)]
    rates = {
        "mirror_frequency_hz": options.mirror_frequency,
        "pulse_rate_hz": options.pulse_rate,
    }
    columns = {} if options.alone else {name: cloud[name] for name in _present(cloud)}
    return scan_pattern.measure_pattern(cloud, **columns, **rates)


def _present(cloud):
    """Which of the columns that tell profiles apart a cloud has."""
    return [name for name in ("gps_time", "scan_line") if name in cloud.columns]
