"""Study of MIMIC: scan patterns on walls, predicted by equations and lattice, and measured."""

from dataclasses import dataclass, fields, replace
from functools import partial

import numpy as np
import pandas as pd

from mmqa_lab import simulate
from mmqa_lab.bench import Comparison
from mmqa_lab.published import ledger, number, table
from mmqa_lab.scan_pattern import Patch, ScanSetup, Target, measure_pattern, mimic, scan_lattice

__all__ = [
    "EQUATIONS", "FIGURES", "METHODS", "SETUP", "SOURCE", "Scan", "bench", "cad_walls", "cast",
    "clicked", "lattice", "ledger_table", "make", "measured", "paper", "parts", "score",
    "simulate_patch", "surfaces",
]  # fmt: skip

SOURCE = "cahalane2014"

# The mirror frequency is not printed; 0.100 m in row 2 of Table 3 needs 100 Hz.
SETUP = ScanSetup(
    pulse_rate_hz=36_000 / number(SOURCE, "cad_point_step")["value"],
    mirror_frequency_hz=100.0,
    speed_m_s=number(SOURCE, "cad_speed")["value"],
    scanner_heading_deg=45.0,
    scanner_tilt_deg=45.0,
)
"""The scanner of the constructed models: 45/45 degrees and 10 m/s (4.1.1), 0.12 degrees (4.2.1)."""

RATES_HZ = ((300e3, 100.0), (125e3, 100.0), (500e3, 200.0))
"""Pulses and revolutions per second of the XP1 and two settings of the Lynx M1 (section 4.2.2)."""

FIGURES = ("horizontal_mm", "vertical_mm", "point_mm", "angle_deg")


@dataclass(frozen=True)
class Scan:
    """The data of a method: the set-up, the wall, and the simulated points on it."""

    setup: ScanSetup
    target: Target
    spot: np.ndarray
    cloud: object


def cad_walls(ranges_m, *, height_m=-1.5):
    """Return the 14 walls of Tables 3 and 4 at the given ranges (m) as cases of the bench."""
    walls = pd.concat([table(SOURCE, name).assign(table=name) for name in ("table_3", "table_4")])
    walls = walls.rename(columns={"alpha_targ_deg": "heading_deg", "beta_targ_deg": "tilt_deg"})
    walls = walls[["table", "no", "heading_deg", "tilt_deg"]].assign(**vars(SETUP))
    walls["height_difference_m"] = height_m
    return walls.merge(pd.DataFrame({"range_m": ranges_m}), how="cross")


def surfaces(n, *, seed=1):
    """Return ``n`` surfaces within the limits of section 3.2.3, as cases of the bench.

    Range, height and rotations are drawn uniformly. The head is turned by 45 degrees to the side
    from which it sees more of the surface, and tilted by 45 degrees. The speed, at most 30 m/s,
    gives a density drawn from 300 to 1500 points per square metre. The mountings are assumed, since
    the paper does not print them.
    """
    rng = np.random.default_rng(seed)
    names = "range", "horizontal", "vertical"
    low, high = (
        [number(SOURCE, f"{name}_{end}")["value"] for name in names] for end in ("min", "max")
    )
    rows = []
    while len(rows) < n:
        range_m, heading, tilt = rng.uniform(low, high)
        pulses, turns = RATES_HZ[len(rows) % 3]
        case = {"no": len(rows) + 1, "pulse_rate_hz": pulses, "mirror_frequency_hz": turns}
        case |= {"heading_deg": heading, "tilt_deg": tilt, "range_m": range_m, "speed_m_s": 1.0}
        case |= {"scanner_heading_deg": float(np.copysign(45, heading)), "scanner_tilt_deg": 45.0}
        case |= {"height_difference_m": rng.uniform(-2, 2)}
        found = scan_lattice(*parts(case))
        speed = float(found.density_per_m2 / rng.uniform(300, 1500))
        if 2 < speed < 30 and found.incidence_deg < 70:
            rows.append({**case, "speed_m_s": speed})
    return pd.DataFrame(rows)


def parts(case):
    """Return the set-up and the target of a case."""
    kinds = ScanSetup, Target
    return tuple(kind(**{part.name: case[part.name] for part in fields(kind)}) for kind in kinds)


def make(*, seed, range_noise_m=0.005, **case):
    """Return the simulated scan of a case, and its true spacings from rays cast on the wall."""
    setup, target = parts(case)
    choices = {"size_m": 1.0, "seed": seed, "range_noise_m": range_noise_m}
    cloud, driven = simulate_patch(setup, target, **choices)
    return Scan(driven, target, target.patch(setup).points, cloud), cast(driven, target)


def simulate_patch(setup, target, *, size_m, seed, range_noise_m=0.005, speed_share=0.01, **noise):
    """Scan a square patch of a target from a vehicle of varying speed.

    Parameters
    ----------
    setup : ScanSetup
    target : Target
    size_m : float
        Width of the patch, metres.
    seed : int
        Seed of speed and noise.
    range_noise_m, speed_share : float
        Standard deviations of ranges (m) and of speed (share, correlated over 0.5 s).
    **noise
        ``angle_noise_deg`` of recorded mirror angles (default 0.005), ``dropout_share`` of pulses
        without an echo (default 0.05).

    Returns
    -------
    Cloud, ScanSetup
        The points, and the set-up with the mean speed during their scan.
    """
    spot, (along, up) = target.patch(setup), scan_lattice(setup, target).axes
    corners = spot.points + size_m / 2 * np.array([-along - up, along - up, up - along, along + up])
    plane = setup.rotation[:, 1]
    reach = corners @ plane / plane[1]
    start, end = reach.min() - 0.1, reach.max() + 0.1
    level = simulate.straight(end - start, setup.speed_m_s, start=(0, start, 0))
    drive = simulate.with_speed_variation(level, share=speed_share, seed=seed)
    beams = scan_lattice(setup, Patch(corners, spot.normals)).beam @ setup.rotation
    angles = np.degrees(np.arctan2(beams[:, 0], -beams[:, 2]))
    scanner = simulate.Scanner(
        pulse_rate_hz=setup.pulse_rate_hz,
        mirror_frequency_hz=setup.mirror_frequency_hz,
        heading_deg=setup.scanner_heading_deg,
        tilt_deg=setup.scanner_tilt_deg,
        field_of_view_deg=(max(angles.min() - 2, -180.0), min(angles.max() + 2, 180.0)),
        range_noise_m=range_noise_m,
        **{"angle_noise_deg": 0.005, "dropout_share": 0.05, **noise},
    )
    wall = simulate.rectangle(corners[0], size_m * along, size_m * up)
    cloud = simulate.scan(simulate.Scene([wall]), scanner, drive, seed=seed)
    after, before = (drive.at(cloud["gps_time"] + side * 1e-4)[0][:, 1] for side in (1, -1))
    return cloud, replace(setup, speed_m_s=float(np.mean(after - before) / 2e-4))


def cast(setup, target, *, still=False):
    """Cast the pulses half a step and half a revolution before and after a spot on its wall.

    Parameters
    ----------
    setup : ScanSetup
    target : Target
    still : bool
        The vehicle stands while the mirror turns by a step, as the paper assumes. The step leads
        from the spot to the pulse above it.

    Returns
    -------
    dict
        ``FIGURES``, from four rays.
    """
    found, rotation = scan_lattice(setup, target), setup.rotation
    beam, (level, slope) = found.beam, found.axes
    wall = simulate.rectangle(beam - 200 * (level + slope), 400 * level, 400 * slope)
    scene = simulate.Scene([wall])
    mirror = np.arctan2(*(rotation.T @ beam)[[2, 0]])
    pulse, turn = 1 / setup.pulse_rate_hz, 1 / setup.mirror_frequency_hz
    steps = []
    for seconds, turns in ((0 if still else pulse, pulse / turn), (turn, 0)):
        angle = mirror + np.array([0, 2] if still else [-1, 1]) * np.pi * turns
        aims = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1) @ rotation.T
        starts = np.outer([-0.5, 0.5], [0, seconds * setup.speed_m_s, 0])
        hits = starts + scene.cast(starts, aims).range_m[:, None] * aims
        steps.append((hits[1] - hits[0]) @ np.array([level, slope]).T)
    (u, v), (s, t) = steps
    angle = np.degrees(np.arctan2(abs(v), abs(u)))
    return _figures(abs(s - t * u / v), abs(t - s * v / u), np.hypot(u, v), angle)


def paper(scan, *, literal=False, ways=(True, False)):
    """Return Equations 2 to 10 of the paper, with r2 in equation 10 unless ``literal``.

    The paper does not say whether the spacing leads to the pulse above or below. The result is the
    mean over ``ways``, by default both.
    """
    setup, target = scan.setup, scan.target
    scanner = setup.scanner_heading_deg, setup.scanner_tilt_deg
    wall = target.heading_deg, target.tilt_deg
    d = setup.speed_m_s / setup.mirror_frequency_hz
    horizontal = mimic.profile_spacing_horizontal(d, scanner[0], wall[0])
    angle = mimic.profile_angle(*scanner, *wall)
    given = {"h_r": target.range_m, "height_difference": target.height_difference_m}
    given["theta_a"] = mimic.pulse_angle(setup.pulse_rate_hz, setup.mirror_frequency_hz)
    given["literal"] = literal
    points = [mimic.point_spacing(scanner, wall, **given, upwards=way) for way in ways]
    point = np.mean([chain.d_ps for chain in points])
    return _figures(horizontal, mimic.profile_spacing_vertical(horizontal, angle), point, angle)


def lattice(scan):
    """Return the scan lattice, with the motion of the vehicle."""
    return _figures_of(vars(scan_lattice(scan.setup, scan.target)))


def measured(scan):
    """Return a fit of all profiles of the simulated points at once, with time."""
    found = measure_pattern(scan.cloud, gps_time=scan.cloud["gps_time"], reference=scan.spot)
    stds = {f"std_{name}": value for name, value in _figures_of(found.std).items()}
    return _figures_of(vars(found)) | stds


def clicked(scan):
    """Five distances at the points nearest the spot, their mean and scatter, as in the paper.

    Distances lead to the next point of the profile, and along the level line and the slope to the
    next profile, interpolated between two of its points.
    """
    found, line = scan_lattice(scan.setup, scan.target), scan.cloud["scan_line"]
    uv = (scan.cloud.points - scan.spot) @ found.axes.T
    rows = []
    for i in np.argsort(np.hypot(*uv.T))[:5]:
        here, beside = uv[line == line[i]], uv[line == line[i] + 1]
        ahead = here[(here - uv[i]) @ found.a > 0] - uv[i]
        point = np.hypot(*ahead.T).min(initial=np.inf)
        rows.append((_across(beside, uv[i], 0), _across(beside, uv[i], 1), point))
    rows = np.array(rows)
    rows[rows[:, 2] > 1.5 * np.nanmedian(rows[:, 2]), 2] = np.nan  # a pulse has no echo
    mean, std = 1000 * np.nanmean(rows, axis=0), 1000 * np.nanstd(rows, axis=0, ddof=1)
    stds = {f"std_{name}": value for name, value in zip(FIGURES[:3], std, strict=True)}
    return dict(zip(FIGURES[:3], mean, strict=True)) | stds


def _across(profile, point, axis):
    """Distance along an axis from a point to a profile; NaN beyond the ends of the profile."""
    if not len(profile):
        return np.nan
    places, values = profile[np.argsort(profile[:, 1 - axis])].T[[1 - axis, axis]]
    return abs(np.interp(point[1 - axis], places, values, np.nan, np.nan) - point[axis])


def _figures(horizontal, vertical, point, angle):
    """``FIGURES`` of lengths in metres and an angle in degrees."""
    values = 1000 * horizontal, 1000 * vertical, 1000 * point, angle
    return dict(zip(FIGURES, map(float, values), strict=True))


def _figures_of(found):
    """``FIGURES`` from the named fields of a lattice or a measurement."""
    names = (f"profile_spacing_{way}_m" for way in ("horizontal", "vertical"))
    return _figures(*(found[name] for name in (*names, "point_spacing_m", "profile_angle_deg")))


METHODS = {
    "paper, equation 10 as printed": partial(paper, literal=True),
    "paper, equation 10 with r2": paper,
    "scan lattice": lattice,
    "measured": measured,
    "clicked": clicked,
}

EQUATIONS = tuple(METHODS)[:3]
"""The methods that do not use the points."""


def score(result, truth):
    """Return the figures of a method and their absolute errors, such as ``point_error_mm``."""
    errors = {name: abs(result[name] - truth[name]) for name in FIGURES if name in result}
    return result | {name.replace("_", "_error_", 1): value for name, value in errors.items()}


def bench(*, methods=None, seeds=range(5), ranges_m=(4.0, 8.0, 16.0), cases=None, **noise):
    """Define the study's bench: equations and measurements on the walls of Tables 3 and 4.

    Parameters
    ----------
    methods : dict, optional
        Functions of :class:`Scan` that return some or all of ``FIGURES``; by default ``METHODS``.
    seeds : iterable of int
        Each seed gives a scan of each wall.
    ranges_m : tuple of float
        Ranges of the walls, metres.
    cases : DataFrame, optional
        Other walls, such as :func:`surfaces`.
    **noise
        ``range_noise_m`` of :func:`make`.

    Returns
    -------
    Comparison
    """
    cases = cad_walls(ranges_m) if cases is None else cases
    shown = tuple(name.replace("_", "_error_", 1) for name in FIGURES)
    methods, scanned = dict(methods or METHODS), partial(make, **noise)
    return Comparison(cases, methods, scanned, score, seeds, figures=shown)


CAST = "Rays cast on the walls of Tables 3 and 4 in place of the constructed models."
CLICKS = "Five distances clicked on simulated surfaces; mounting and range noise are assumed."


def ledger_table(*, table_3, standing, readings, field, table_6):
    """Return the study's value for each printed result of the source.

    Parameters
    ----------
    table_3 : DataFrame
        With ``predicted_m`` and ``ray_cast_m``.
    standing : DataFrame
        Differences of the paper's equations from rays of a standing vehicle: ``FIGURES``, one row
        for each of the 14 walls.
    readings : dict of str to DataFrame
        Walls of Table 4 (``no``, ``fitted_mm``), by a note on how they were fitted.
    field : Dataset
        Results of the bench on :func:`surfaces`.
    table_6 : DataFrame
        ``output``, ``name``, ``change_fitted``, ``error_fitted`` and a ``note``.

    Returns
    -------
    DataFrame
        As :mod:`mmqa_lab.published.ledger` documents.
    """
    rows = []

    def say(name, cell, value, kind, note):
        """Enter a number, or the median of several and their range."""
        values = np.atleast_1d(value)
        ends = (np.nanmin(values), np.nanmax(values)) if len(values) > 1 else (np.nan, np.nan)
        rows.append((SOURCE, name, cell, float(np.nanmedian(values)), *ends, kind, note))

    printed = table(SOURCE, "table_2").set_index("result")
    for profile in (1, 2):
        by_tape, by_mimic = printed.loc[["Measured (Average)", "MIMIC"], f"profile_{profile}_m"]
        note = "The difference of the two values above it."
        say("table_2", f"Error profile {profile}", abs(by_mimic - by_tape), "predicted", note)
    for row in table_3.itertuples():
        kind, error = "fitted" if row.no == 2 else "predicted", row.ray_cast_m - row.predicted_m
        say("table_3", f"wall {row.no} mimic", row.predicted_m, kind, "Equations 2, 3 at 100 Hz.")
        say("table_3", f"wall {row.no} cad", row.ray_cast_m, "measured", CAST)
        say("table_3", f"wall {row.no} error", abs(error), "measured", CAST)
    for note, reading in readings.items():
        for row in reading.dropna(subset="fitted_mm").itertuples():
            for what in ("mimic", "cad"):
                say("table_4", f"wall {row.no} {what}", row.fitted_mm / 1000, "fitted", note)
    standing = standing.abs() / 1000
    for place, error in enumerate(standing["point_mm"].iloc[-9:], start=1):
        say("table_4", f"wall {place} error", error, "measured", CAST)
    by_click = field.sel({"method": "clicked"})
    clicks = np.abs(by_click[list(FIGURES[:3])] - field.sel({"method": EQUATIONS[1]}))
    for output, name in zip(("d_PrSH", "d_PrSV", "d_PS"), FIGURES, strict=False):
        for way in ("min", "mean", "max"):
            errors = getattr(clicks[name] / 1000, way)("case").values
            say("table_5", f"Constructed {output} {way}", standing[name].agg(way), "measured", CAST)
            say("table_5", f"Real World {output} {way}", errors, "measured", CLICKS)
    for row in table_6.dropna(subset="change_fitted").itertuples():
        say("table_6", f"{row.output} {row.name}", abs(row.change_fitted), "fitted", row.note)
        say("table_6", f"{row.output} error", row.error_fitted, "fitted", row.note)
    lines, points = clicks["horizontal_mm"], clicks["point_mm"]
    for cell, found in {
        "profile_cases_above_1mm": 15 * (lines >= 1).mean("case"),
        "profile_error_majority": lines.median("case"),
        "profile_sigma_majority": by_click["std_horizontal_mm"].median("case"),
        "profile_mean_error_max": lines.mean("case") / 1000,
        "profile_error_all": lines.max("case"),
        "point_sigma_max": by_click["std_point_mm"].max("case"),
        "point_sigma_majority": by_click["std_point_mm"].median("case"),
        "point_error_max": points.max("case"),
        "point_error_max_range": field["range_m"][points.fillna(-1).argmax("case")],
        "point_mean_error_max": points.mean("case") / 1000,
        "largest_error": np.maximum(lines.max("case"), points.max("case")),
        "largest_mean_error": np.maximum(lines.mean("case"), points.mean("case")),
    }.items():
        say("numbers", cell, found.values, "measured", CLICKS)
    return ledger.entries(pd.DataFrame(rows, columns=ledger.COLUMNS).drop_duplicates())
