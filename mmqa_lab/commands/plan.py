"""Predict what a profile scanner on a moving vehicle lays on a plane: spacings, angle, density, f.

Frame: X across the track to the target's side, Y in the direction of travel, Z up. Angles are
counter-clockwise positive, tilt is applied before heading. Scanner: all zero is a vertical scan
plane across the track. Target: all zero is a vertical wall along the track; a positive heading
turns it towards the vehicle, a positive tilt leans its top away. The range is the X at which the
horizontal pulse strikes the plane; the figures are those at the height difference.
After Cahalane et al. 2014 (doi 10.3390/s140609471), with the motion during a revolution.
"""

import argparse
import warnings

from mmqa_lab.commands._output import add_output_arguments, print_json, print_rows, write_rows

SUMMARY = "profile spacing, point spacing, density and f of a scan before it is driven"

EPILOG = """\
example:
  mmqa plan --pulse-rate 300000 --mirror-frequency 100 --speed 10 --scanner-heading 45 \\
      --scanner-tilt 45 --target-heading 15 --range 5
  mmqa plan --scanner vq-450 --speed 14 --range 8 --json
  mmqa plan --system vmx-250 --speed 10 --range 8 --target-heading 20
  mmqa plan --scanner zf-9012 --range 5 --largest-speed density_per_m2=3000
  mmqa plan --scanner vq-250 --speed 10 --range 8 --sigma speed_m_s=0.2 \\
      --sigma target_heading_deg=1.93
"""

SETUP = {
    "pulse_rate": ("pulse_rate_hz", "pulses per second"),
    "mirror_frequency": ("mirror_frequency_hz", "revolutions of the mirror per second"),
    "speed": ("speed_m_s", "speed of the vehicle"),
    "scanner_heading": ("scanner_heading_deg", "scan plane turned about the vertical, default 0"),
    "scanner_tilt": ("scanner_tilt_deg", "scan plane tilted about X, default 0"),
}
"""Options that describe the set-up: fields of ``ScanSetup`` and what they are."""

GRAZING_DEG = 85.0
"""Incidence beyond which neighbouring points lie too far apart for a prediction at one point."""

UNITS = {"_hz": "HZ", "_m_s": "M/S", "_deg": "DEG"}


def add_arguments(parser):
    """Declare the arguments."""
    for name, (field, text) in SETUP.items():
        unit = next(unit for ending, unit in UNITS.items() if field.endswith(ending))
        parser.add_argument(_flag(name), type=float, metavar=unit, help=text)
    number = {"type": float, "default": 0.0}
    parser.add_argument("--target-heading", metavar="DEG", help="default 0", **number)
    parser.add_argument("--target-tilt", metavar="DEG", help="default 0", **number)
    parser.add_argument(
        "--range", type=float, required=True, metavar="M", help="X of the target at scanner height"
    )
    parser.add_argument(
        "--height-difference", metavar="M", help="above the scanner, default 0", **number
    )
    presets = parser.add_mutually_exclusive_group()
    presets.add_argument(
        "--scanner",
        metavar="PRESET",
        help="a profile scanner by name: zf-9012, roamer, vq-250, vq-450, lynx-m1, lynx-m1-second",
    )
    presets.add_argument(
        "--system",
        metavar="NAME",
        help="all heads of a system: roamer, vmx-250, streetmapper-360, lynx, xp1, lynx-m1; "
        "the range is that from each head",
    )
    parser.add_argument(
        "--sigma",
        type=_limit,
        action="append",
        default=[],
        metavar="INPUT=STD",
        help="standard deviation of an input, such as speed_m_s=0.1; may be given several times",
    )
    parser.add_argument(
        "--sensitivities", action="store_true", help="add the change of each figure per input"
    )
    parser.add_argument(
        "--largest-speed",
        type=_limit,
        metavar="QUANTITY=LIMIT",
        help="predict at the largest speed that keeps the limit, and name it",
    )
    add_output_arguments(parser)


def run(options):
    """Predict, print and write."""
    from dataclasses import replace

    import pandas as pd

    from mmqa_lab.scan_pattern import Target, largest_speed

    target = Target(
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
        answer["speed_m_s"] = largest_speed(setup, target, quantity=quantity, limit=limit)
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
    from mmqa_lab.scan_pattern import QUANTITIES, scan_lattice

    lattice = scan_lattice(setup, target.patch(setup))
    found = {name: float(lattice.quantity(name)) for name in QUANTITIES}
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
    import pandas as pd

    from mmqa_lab.scan_pattern import ScanSetup

    others = [_flag(name) for name in (*SETUP, "sigma", "sensitivities", "largest_speed")
              if name != "speed" and getattr(options, name)]  # fmt: skip
    if others:
        raise ValueError(f"Invalid {others[0]} with --system. Must be used with --scanner.")
    if options.speed is None:
        raise ValueError("Invalid plan without --speed. Must have it.")
    found = pd.DataFrame()
    for number, head in enumerate(_heads(options.system), start=1):
        setup = ScanSetup.of_scanner(head, speed_m_s=options.speed)
        if abs(target.heading_deg - setup.scanner_heading_deg) < 90:
            found[f"head_{number}"] = pd.Series(_prediction(setup, target))
    if found.empty:
        raise ValueError(
            f"Invalid target heading {target.heading_deg}. Must be less than 90 degrees from that "
            "of a head."
        )
    found.loc["density_per_m2", "together"] = found.loc["density_per_m2"].sum()
    return found.rename_axis("quantity").reset_index()


def _heads(name):
    """The heads of a system of profile scanners."""
    from mmqa_lab._checks import check_choice
    from mmqa_lab.simulate import ProfileScanner
    from mmqa_lab.simulate.systems import SYSTEMS

    known = {
        key: system.heads
        for key, system in SYSTEMS.items()
        if all(isinstance(head, ProfileScanner) for head in system.heads)
    }
    return known[check_choice(name, "system", tuple(known))]


def _with_errors(answer, setup, target, options):
    """The figures with their uncertainty, and with their change per unit of each input."""
    import pandas as pd

    from mmqa_lab.scan_pattern import propagate, sensitivities

    found = pd.DataFrame({"predicted": answer}).rename_axis("quantity")
    if options.sigma:
        errors = propagate(setup, target, sigmas=dict(options.sigma)).set_index("quantity")
        found = found.join(errors[["std", "low", "high"]])
    if options.sensitivities:
        found = found.join(sensitivities(setup, target).T.add_prefix("per_"))
    return found.reset_index()


def _setup(options):
    """The set-up from the preset and from what was given beside it."""
    from dataclasses import replace

    from mmqa_lab.scan_pattern import ScanSetup

    scanner = _preset(options.scanner) if options.scanner else None
    given = {name: getattr(options, name) for name in SETUP if getattr(options, name) is not None}
    if options.largest_speed is not None:
        given.setdefault("speed", 1.0)
    for name in ("speed",) if scanner else ("pulse_rate", "mirror_frequency", "speed"):
        if name not in given:
            preset = "" if name == "speed" else ", or a preset with --scanner"
            raise ValueError(f"Invalid plan without {_flag(name)}. Must have it{preset}.")
    values = {SETUP[name][0]: value for name, value in given.items()}
    if scanner is None:
        return ScanSetup(**values)
    return replace(ScanSetup.of_scanner(scanner, speed_m_s=1.0), **values)


def _flag(name):
    """An option as it is typed."""
    return "--" + name.replace("_", "-")


def _preset(name):
    """A profile scanner of the simulator."""
    from mmqa_lab._checks import check_choice
    from mmqa_lab.simulate import ProfileScanner
    from mmqa_lab.simulate.systems import PRESETS

    profilers = {key: s for key, s in PRESETS.items() if isinstance(s, ProfileScanner)}
    return profilers[check_choice(name, "scanner", tuple(profilers))]


def _limit(text):
    """A quantity and its limit from ``quantity=limit``."""
    quantity, _, limit = text.partition("=")
    try:
        return quantity, float(limit)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"Invalid limit {text!r}. Must be a quantity and a number, like density_per_m2=3000."
        ) from None
