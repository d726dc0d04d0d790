"""The commands that predict the points of a scanner and compare results with criteria."""

import re

from mmqa_lab._checks import check_choice
from mmqa_lab.commands.machine import (
    table,
)

__all__ = ["plan", "tender"]


@table
def tender(criteria: str, results: str, /, *, details: bool = False):
    """Compare systems' results with the criteria of a tender, in a sentence for each system.

    The command judges any figures; it advises none. Which figure goes with which task, study 12
    says: e95_of_3 with small things and gaps, noise_of_a_mean with heights, steps and planes.
    Neither f nor g says what a cloud is fit for.

    Quantities: each metric of evaluate --metrics all, density_per_m2, sigma_mad_mm, std_mm, d1_mm
    to d4_mm, e95_mm (of a cloud); pixel_mm, w_mm, legibility, legibility_40mm, legibility_60mm (of
    a photograph); or your own, in both files. Legibility has marks, better first: a each letter can
    be read, b the text can be read, c it cannot. At least b is written >= b or <= b: both mean a or
    b. A figure is asked for because of what shall be done with the data.

    Parameters
    ----------
    criteria
        CSV file with criterion, quantity, relation (>=, >, <=, <), threshold and, where they
        matter, distance_m, view (orthogonal, forward, backward), direction (h, v), rho0_per_m2 (of
        f: the density from which it does not matter). Or pfeifer2021:test, pfeifer2021:1,
        pfeifer2021:2: the test and both scenarios of Pfeifer et al. 2021 (doi
        10.3390/rs13020237).
    results
        CSV file with system, quantity, value and, where known, sigma or low and high, distance_m,
        view, direction, remarks: a remark that names the figure makes it not certain. Or
        pfeifer2021, the paper's Tables 1 and 2.
    details
        Print a row for each figure instead of one for each system.
    """
    from mmqa_lab import io, tender

    sets = {"test": "test", "1": "scenario 1", "2": "scenario 2"}
    paper, _, name = criteria.partition(":")
    if paper == "pfeifer2021" and name in sets:
        wanted = tender.published_criteria(sets[name])
    else:
        wanted = io.read_table(criteria, "criteria")
    if results == "pfeifer2021":
        found = tender.published_results()
    else:
        found = io.read_table(results, "results")
    verdicts = tender.verdicts(wanted, found)
    return verdicts if details else tender.qualification(verdicts)


@table
def plan(
    *,
    range: float,
    speed: float,
    scanner: str | None = None,
    pulse_rate: float | None = None,
    mirror_frequency: float | None = None,
    scanner_heading: float | None = None,
    scanner_tilt: float | None = None,
    target_heading: float = 0.0,
    target_tilt: float = 0.0,
    height_difference: float = 0.0,
    sigma: list[str] | None = None,
    detail: float | None = None,
):
    """Predict the points of a profile scanner on a plane, or the largest speed for a task.

    X is across the track to the target's side, Y the direction of travel, Z up. Angles are
    counter-clockwise, and tilt is applied before heading. With all angles zero, the scan plane is
    vertical and across the track, and the target is a vertical wall along the track. After Cahalane
    et al. 2014 (doi 10.3390/s140609471).

    Parameters
    ----------
    range
        X where the horizontal pulse strikes the plane, m.
    speed
        Speed of the vehicle, m/s.
    scanner
        Name of a profile scanner, such as zf-9012 or vq-450. Without it, give both rates.
    pulse_rate
        Pulses per second.
    mirror_frequency
        Revolutions of the mirror per second.
    scanner_heading
        Turn of the scan plane about the vertical, degrees.
    scanner_tilt
        Tilt of the scan plane about X, degrees.
    target_heading
        Turn of the target about the vertical, degrees.
    target_tilt
        Tilt of the target about Y, degrees.
    height_difference
        Height of the evaluated spot above the scanner, m.
    sigma
        Standard deviations of inputs, such as speed_m_s=0.2 target_heading_deg=1.93.
    detail
        Size of details, m. Print the largest speed at which 95 % of them get three points, beside
        the speeds for 3000 points/m2 and for f = 2.
    """
    from mmqa_lab import scan_pattern

    angles = {"heading_deg": target_heading, "tilt_deg": target_tilt}
    target = scan_pattern.Target(**angles, range_m=range, height_difference_m=height_difference)
    given = {
        "pulse_rate_hz": pulse_rate,
        "mirror_frequency_hz": mirror_frequency,
        "scanner_heading_deg": scanner_heading,
        "scanner_tilt_deg": scanner_tilt,
    }
    setup = _setup(scanner, speed, {name: one for name, one in given.items() if one is not None})
    if detail is not None:
        return scan_pattern.speeds(setup, target, detail=detail)
    lattice = scan_pattern.scan_lattice(setup, target.patch(setup))
    frame = lattice.to_frame().T.reset_index().set_axis(["quantity", "predicted"], axis=1)
    if sigma:
        found = [pair for text in sigma if (pair := re.fullmatch(r"(\w+)=([\d.eE+-]+)", text))]
        if len(found) < len(sigma):
            raise ValueError(f"Invalid sigma {' '.join(sigma)}. Must be like speed_m_s=0.2.")
        sigmas = {pair[1]: float(pair[2]) for pair in found}
        errors = scan_pattern.propagate(setup, target, sigmas=sigmas)
        frame = frame.merge(errors[["quantity", "std", "low", "high"]], on="quantity", how="left")
    return frame


def _setup(scanner, speed, given):
    """The set-up of a scanner with a name, or of given rates and angles."""
    from mmqa_lab import scan_pattern
    from mmqa_lab.simulate import PRESETS

    if scanner is not None:
        profilers = [name for name, one in PRESETS.items() if not one.upright]
        preset = PRESETS[check_choice(scanner, "scanner", profilers)]
        angles = {f"scanner_{turn}": getattr(preset, turn) for turn in ("heading_deg", "tilt_deg")}
        rates = {name: getattr(preset, name) for name in ("pulse_rate_hz", "mirror_frequency_hz")}
        given = angles | rates | given
    if not {"pulse_rate_hz", "mirror_frequency_hz"} <= set(given):
        raise ValueError(
            "Invalid plan. Must have --pulse-rate and --mirror-frequency, or --scanner."
        )
    return scan_pattern.ScanSetup(speed_m_s=speed, **given)
