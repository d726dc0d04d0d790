"""Study 05: scan patterns predicted by the paper's equations and by the lattice, and measured.

What the notebook shows in full is not here: these are its simulated walls, the methods of its
bench, the readings of Table 4, the checks and the ledger.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pandas as pd

from mmqa_lab import bench, simulate
from mmqa_lab.published import ledger, number, table
from mmqa_lab.scan_pattern import (
    QUANTITIES,
    Patch,
    ScanSetup,
    Target,
    measure_pattern,
    mimic,
    scan_lattice,
)
from mmqa_lab.studies import NOTES, SMALL, stated

SOURCE, TOLD = "cahalane2014", NOTES["mimic"]
QUICK = SMALL["mimic"]

MIRROR_HZ = 100.0
"""Not printed for the constructed models; 0.100 m at 10 m/s in row 2 of Table 3 needs it."""

SETUP = ScanSetup(
    pulse_rate_hz=360 * MIRROR_HZ / number(SOURCE, "cad_point_step")["value"],
    mirror_frequency_hz=MIRROR_HZ,
    speed_m_s=number(SOURCE, "cad_speed")["value"],
    scanner_heading_deg=45.0,
    scanner_tilt_deg=45.0,
)
"""The scanner of the constructed models: 45/45 degrees and 10 m/s (4.1.1), 0.12 degrees (4.2.1)."""

SYSTEMS = (
    {"pulse_rate_khz": 300.0, "mirror_hz": 100.0},
    {"pulse_rate_khz": 125.0, "mirror_hz": 100.0},
    {"pulse_rate_khz": 500.0, "mirror_hz": 200.0},
)
"""Rates of the XP1 and of the two settings of the Lynx M1 (section 4.2.2)."""


@dataclass(frozen=True)
class Scan:
    """What a method of the bench gets: the set-up, the wall, and the simulated points on it."""

    setup: ScanSetup
    target: Target
    spot: np.ndarray
    cloud: object


def cad_walls(ranges_m, *, height_m=-1.5):
    """Return the 14 walls of Tables 3 and 4 at some ranges as cases of the bench."""
    parts = [table(SOURCE, name).assign(table=name) for name in ("table_3", "table_4")]
    walls = pd.concat(parts).rename(columns={"alpha_targ_deg": "alpha", "beta_targ_deg": "beta"})
    scanner = {"pulse_rate_khz": SETUP.pulse_rate_hz / 1000, "mirror_hz": MIRROR_HZ}
    scanner |= {"speed_m_s": SETUP.speed_m_s, "alpha_scan": 45.0, "gamma_scan": 45.0}
    walls = walls[["table", "no", "alpha", "beta"]].assign(**scanner, height_m=height_m)
    return walls.merge(pd.DataFrame({"range_m": list(ranges_m)}), how="cross")


def surfaces(n, *, seed=1):
    """Return ``n`` surfaces within the limits that section 3.2.3 prints, as cases of the bench.

    Range, height and rotations are drawn evenly; the head is turned by 45 degrees to the side from
    which it sees more of the surface, tilted by 45, and the speed is what gives a density drawn
    from 300 to 1500 points per square metre, at most 30 m/s. The mountings are assumed: the paper
    does not print them.
    """
    rng = np.random.default_rng(seed)
    low, high = (
        [number(SOURCE, f"{name}_{end}")["value"] for name in ("range", "horizontal", "vertical")]
        for end in ("min", "max")
    )
    rows = []
    while len(rows) < n:
        range_m, alpha, beta = rng.uniform(low, high)
        case = {"table": "surfaces", "no": len(rows) + 1, **SYSTEMS[len(rows) % 3]}
        case |= {"alpha": alpha, "beta": beta, "range_m": range_m, "speed_m_s": 1.0}
        case |= {"alpha_scan": float(np.copysign(45, alpha)), "gamma_scan": 45.0}
        case |= {"height_m": rng.uniform(-2, 2)}
        setup, target = parts(case)
        lattice = scan_lattice(setup, target.patch(setup))
        speed = float(lattice.density_per_m2 / rng.uniform(300, 1500))
        if 2 < speed < 30 and lattice.incidence_deg < 70:
            rows.append({**case, "speed_m_s": speed})
    return pd.DataFrame(rows)


def parts(case):
    """Set-up and target of a case."""
    setup = ScanSetup(
        pulse_rate_hz=1000 * case["pulse_rate_khz"],
        mirror_frequency_hz=case["mirror_hz"],
        speed_m_s=case["speed_m_s"],
        scanner_heading_deg=case["alpha_scan"],
        scanner_tilt_deg=case["gamma_scan"],
    )
    angles = {"heading_deg": case["alpha"], "tilt_deg": case["beta"]}
    return setup, Target(**angles, range_m=case["range_m"], height_difference_m=case["height_m"])


def make(*, seed, size_m=1.0, range_noise_m=0.005, **case):
    """Return a case's simulated scan and its true spacings, those of rays cast on the wall."""
    setup, target = parts(case)
    noise = {"range_noise_m": range_noise_m}
    cloud, lattice = simulate_patch(setup, target, size=size_m, seed=seed, **noise)
    return Scan(lattice.setup, target, lattice.beam, cloud), cast(lattice.setup, target)


def simulate_patch(setup, target, *, size, seed, range_noise_m=0.005, speed_share=0.01, **noise):
    """Scan a square patch of a target, from a vehicle whose speed wanders.

    Parameters
    ----------
    setup : ScanSetup
    target : Target
    size : float
        Width of the patch, metres.
    seed : int
    range_noise_m, speed_share : float
        Standard deviations of ranges and of speed (correlated over 0.5 s).
    **noise
        ``angle_noise_deg`` (0.005 where left out) of recorded mirror angles, ``dropout_share``
        (0.05) of pulses without an echo.

    Returns
    -------
    Cloud, Lattice
        The points, and the lattice in the patch's middle at the mean of the speeds at which they
        were scanned. The beam of the lattice ends there.
    """
    spot = target.patch(setup)
    corners = _corners(setup, spot, size)
    reach = corners @ setup.plane_normal / setup.plane_normal[1]
    ends = reach.min() - 0.1, reach.max() + 0.1
    level = simulate.straight(ends[1] - ends[0], setup.speed_m_s, start=(0, ends[0], 0))
    drive = simulate.with_speed_variation(level, share=speed_share, seed=seed)
    scanner = simulate.ProfileScanner(
        pulse_rate_hz=setup.pulse_rate_hz,
        mirror_frequency_hz=setup.mirror_frequency_hz,
        heading_deg=setup.scanner_heading_deg,
        tilt_deg=setup.scanner_tilt_deg,
        field_of_view_deg=_view(setup, spot, corners),
        range_noise_m=range_noise_m,
        **{"angle_noise_deg": 0.005, "dropout_share": 0.05, **noise},
    )
    wall = simulate.rectangle(corners[0], corners[1] - corners[0], corners[2] - corners[0])
    cloud = simulate.scan_all(simulate.Scene([wall]), scanner, drive, seed=seed)
    after, before = (drive.at(cloud["gps_time"] + side * 1e-4)[0][:, 1] for side in (1, -1))
    speed = float(np.mean(after - before) / 2e-4)
    return cloud, scan_lattice(replace(setup, speed_m_s=speed), spot)


def _corners(setup, spot, size):
    """Corners of a square about a spot, along its level line and its slope."""
    along, up = scan_lattice(setup, spot).axes
    first = spot.points - size / 2 * (along + up)
    return np.array([first, first + size * along, first + size * up, first + size * (along + up)])


def _view(setup, spot, corners):
    """Scan angles between which a patch lies, with a margin of two degrees."""
    beams = scan_lattice(setup, Patch(corners, spot.normals)).beam @ setup.rotation()
    angle = np.degrees(np.arctan2(beams[:, 0], -beams[:, 2]))
    return max(angle.min() - 2, -180.0), min(angle.max() + 2, 180.0)


def cast(setup, target, *, still=False):
    """Cast the pulses half a step and half a revolution before and after a spot on its wall.

    Parameters
    ----------
    setup : ScanSetup
    target : Target
    still : bool
        The vehicle stands while the mirror turns by a step, as the paper assumes, and the step is
        that from the spot to the pulse above it.

    Returns
    -------
    dict
        ``horizontal_mm``, ``vertical_mm``, ``angle_deg``, ``point_mm``: from four rays.
    """
    spot = target.patch(setup)
    beam = scan_lattice(setup, spot).beam
    level, slope = scan_lattice(setup, spot).axes
    wall = simulate.rectangle(beam - 200 * (level + slope), 400 * level, 400 * slope)
    scene, rotation = simulate.Scene([wall]), setup.rotation()
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
    spacing = {"horizontal_mm": 1000 * abs(s - t * u / v), "vertical_mm": 1000 * abs(t - s * v / u)}
    return spacing | {
        "angle_deg": float(np.degrees(np.arctan2(abs(v), abs(u)))),
        "point_mm": 1000 * float(np.hypot(u, v)),
    }


def paper(scan, *, literal=False, ways=(True, False)):
    """Equations 2 to 10 of the paper, with r2 in equation 10; the mean of both next pulses.

    The paper does not say whether the spacing is that to the pulse above or below (``ways``).
    """
    setup, target = scan.setup, scan.target
    scanner = setup.scanner_heading_deg, setup.scanner_tilt_deg
    angles = target.heading_deg, target.tilt_deg
    d = setup.speed_m_s / setup.mirror_frequency_hz
    horizontal = mimic.profile_spacing_horizontal(d, scanner[0], angles[0])
    angle = mimic.profile_angle(*scanner, *angles)
    given = {
        "h_r": target.range_m,
        "height_difference": target.height_difference_m,
        "theta_a": mimic.pulse_angle(setup.pulse_rate_hz, setup.mirror_frequency_hz),
        "literal": literal,
    }
    points = [mimic.point_spacing(scanner, angles, **given, upwards=way).d_ps for way in ways]
    vertical = mimic.profile_spacing_vertical(horizontal, angle)
    return _figures(horizontal, vertical, angle, np.mean(points))


def lattice(scan):
    """The scan lattice, with the motion of the vehicle."""
    found = scan_lattice(scan.setup, scan.target.patch(scan.setup))
    return _figures_of(found)


def measured(scan):
    """All profiles of the simulated points fitted at once, with time."""
    found = measure_pattern(scan.cloud, gps_time=scan.cloud["gps_time"], reference=scan.spot)
    stds = _figures(*(found.std[name] for name in QUANTITIES[1:5]))
    return _figures_of(found) | {f"std_{name}": value for name, value in stds.items()}


def clicked(scan, *, clicks=5):
    """Five distances at the points nearest the spot, their mean and scatter, as in the paper.

    To the next point of the profile, and along the level line and the slope to the next profile,
    between two of its points.
    """
    found = scan_lattice(scan.setup, scan.target.patch(scan.setup))
    line = scan.cloud["scan_line"]
    uv = (scan.cloud.points - scan.spot) @ found.axes.T
    rows = []
    for i in np.argsort(np.hypot(*uv.T))[:clicks]:
        here, beside = uv[line == line[i]], uv[line == line[i] + 1]
        ahead = here[(here - uv[i]) @ found.plane_steps()[0] > 0] - uv[i]
        rows.append((_across(beside, uv[i], 0), _across(beside, uv[i], 1), _nearest(ahead)))
    rows = np.array(rows)
    rows[rows[:, 2] > 1.5 * np.nanmedian(rows[:, 2]), 2] = np.nan  # over a pulse without echo
    mean, std = 1000 * np.nanmean(rows, axis=0), 1000 * np.nanstd(rows, axis=0, ddof=1)
    names = ("horizontal_mm", "vertical_mm", "point_mm")
    stds = {f"std_{name}": value for name, value in zip(names, std.tolist(), strict=True)}
    return dict(zip(names, mean.tolist(), strict=True)) | stds


def _across(profile, point, axis):
    """Distance along an axis from a point to a profile, NaN where it ends before."""
    order = profile[np.argsort(profile[:, 1 - axis])]
    places = order[:, 1 - axis]
    if not len(order) or not places[0] <= point[1 - axis] <= places[-1]:
        return np.nan
    return abs(np.interp(point[1 - axis], places, order[:, axis]) - point[axis])


def _nearest(steps):
    """Length of the shortest step, NaN if there is none."""
    return np.hypot(*steps.T).min() if len(steps) else np.nan


METHODS = {
    "paper, equation 10 as printed": partial(paper, literal=True),
    "paper, equation 10 with r2": paper,
    "scan lattice": lattice,
    "measured": measured,
    "clicked": clicked,
}


STYLES = 9 * ["o-", "s--", "^:", "x-.", "d-", "v--", "*:"]
"""Lines of methods, told apart without colour."""

FLOOR = 1e-3
"""The least error that is drawn, millimetres or degrees."""

EQUATIONS = tuple(METHODS)[:3]
"""The methods that do not look at the points."""

FIGURES = ("horizontal_mm", "vertical_mm", "point_mm", "angle_deg")


def score(result, truth):
    """Errors of the four figures; standard deviations as they are."""
    return {name: value - truth.get(name, 0.0) for name, value in result.items()}


def comparison(quick=False):
    """Return the study's comparison: the walls of Tables 3 and 4 x equations and measurements."""
    ranges, seeds = (QUICK["ranges_m"], range(1)) if quick else ((4.0, 8.0, 16.0), range(5))
    return bench.Comparison(
        cases=cad_walls(ranges),
        methods=dict(METHODS),
        make=make,
        score=score,
        seeds=seeds,
        tables=lambda results: {"errors": errors(results)},
        figures=lambda results: {"errors": draw_errors(results)},
    )


def by_case(results):
    """Return results with the dimension ``case``, also where cases are a grid (one surface is)."""
    grid = [dim for dim in results.dims if dim not in ("method", "seed", "case")]
    return results.stack(case=grid) if grid else results


def errors(results):
    """Return median absolute errors, a row for each method, and how many cells are missing."""
    names = [name for name in FIGURES if name in results]
    over = [dim for dim in results["failure"].dims if dim != "method"]
    middle = np.abs(results[names]).median(over).to_dataframe()[names]
    failed = (results["failure"] != "").sum(over).to_series()
    found = middle.assign(failed=failed).rename_axis("method").reset_index()
    return found.assign(kind=np.where(found["method"].isin(EQUATIONS), "predicted", "measured"))


def draw_errors(results):
    """Draw the errors of point spacing and profile angle over range, a colour for each method."""
    from mmqa_lab import plots

    figure, axes = plots.subplots(1, 2, width="double", height_mm=70)
    titles = {"point_mm": ("point spacing", "mm"), "angle_deg": ("profile angle", "degrees")}
    for ax, (name, (title, unit)) in zip(axes, titles.items(), strict=True):
        size = np.abs(results[name]).to_dataframe().groupby(["range_m", "method"])[name]
        lines = size.median().unstack().clip(lower=FLOOR)  # rounding errors lie far below
        lines.plot(ax=ax, style=STYLES[: len(lines.columns)], logy=True, legend=False)
        ax.set(title=title, xlabel="range (m)", ylabel=f"median error ({unit})")
        ax.axhline(FLOOR, color="0.7", lw=0.6, zorder=0)
        beside = ("axes fraction", "data")
        ax.annotate("this or less", (0.99, FLOOR), xycoords=beside, ha="right", va="bottom", size=6)
        ax.set_ylim(bottom=FLOOR / 1.5)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def _figures(horizontal, vertical, angle, point):
    """The four figures, millimetres and degrees."""
    lengths = 1000 * np.array([horizontal, vertical, point], dtype=float)
    return dict(zip(FIGURES, [*lengths.tolist(), float(angle)], strict=True))


def _figures_of(found):
    """The four figures of a lattice or a measurement."""
    return _figures(*(getattr(found, name) for name in QUANTITIES[1:5]))


def table_4(*, gamma_scan, through_m, height_m=0.0):
    """Return Table 4 beside what one reading of its set-up gives.

    Parameters
    ----------
    gamma_scan : float
        Tilt of the scanner, degrees. Its heading is 45.
    through_m : tuple of 3
        Where the walls' axes of turning meet, from the scanner, metres.
    height_m : float
        Of the point at which spacing is read, above the scanner.

    Returns
    -------
    DataFrame
        The table with ``fitted_mm`` (NaN where the pulses miss the wall) and ``agrees``.
    """
    found = table(SOURCE, "table_4").rename(columns={"mimic_m": "published_mm"})
    found["published_mm"] = (1000 * found["published_mm"]).round(3)
    step = number(SOURCE, "cad_point_step")["value"]
    rows = []
    for alpha, beta in found[["alpha_targ_deg", "beta_targ_deg"]].to_numpy(dtype=float):
        normal = mimic.target_normal(alpha, beta)
        reach = (normal @ np.asarray(through_m)) / (normal @ [1.0, 1.0, 0.0])
        given = {"h_r": reach, "height_difference": height_m, "theta_a": step}
        chain = mimic.point_spacing((45.0, gamma_scan), (alpha, beta), **given)
        rows.append(1000 * chain.d_ps if reach > 0 and chain.theta_o > 0 else np.nan)
    found["fitted_mm"] = rows
    found["agrees"] = (found["fitted_mm"] - found["published_mm"]).abs() <= 0.5
    return found[["no", "alpha_targ_deg", "beta_targ_deg", "published_mm", "fitted_mm", "agrees"]]


check = stated("mimic")


def checks(*, table_3, benches, still, readings, counted):
    """Yield the notebook's statements with the numbers of this run.

    Parameters
    ----------
    table_3, counted : DataFrame
        ``agrees``; ``counted`` and ``predicted`` points.
    benches : pair of Dataset
        Results on the walls of the paper, and on surfaces within its limits.
    still : DataFrame
        Differences of the paper's equations from rays of a vehicle that stands, ``FIGURES``.
    readings : list of DataFrame
        Of ``table_4``.
    """
    yield check(
        "table_3",
        table_3["agrees"].all(),
        f"{table_3['agrees'].sum()} of {len(table_3)} to the printed digits",
    )
    worst = float(np.abs(still).max(axis=None))
    yield check("standing", worst < 1e-6, f"largest difference {worst:.1g} mm or degrees")
    moving = np.abs(benches[0][list(FIGURES)].sel({"method": "scan lattice"})).to_array().max()
    yield check(
        "moving", float(moving) < 1e-6, f"largest difference {float(moving):.1g} mm or degrees"
    )
    most = max(int(reading["agrees"].sum()) for reading in readings)
    together = int(np.any([reading["agrees"] for reading in readings], axis=0).sum())
    yield check(
        "table_4", most <= 6 and together == 9, f"{most} rows in the best, {together} in either"
    )
    off = float((counted["counted"] / counted["predicted"] - 1).abs().max())
    yield check("counted", off < 0.01, f"off by {100 * off:.2f} % at most")
    both = [part.sel({"method": "measured"}) for part in benches]
    z = np.concatenate([(part["point_mm"] / part["std_point_mm"]).values.ravel() for part in both])
    z = z[np.isfinite(z)]
    covered, slack = np.mean(np.abs(z) < 1.96), 3 * np.sqrt(0.95 * 0.05 / len(z))
    yield check(
        "intervals",
        abs(covered - 0.95) < slack + 0.02,
        f"{100 * covered:.0f} % of {len(z)}",
        percent=100 * slack,
    )


def ledger_entries(*, table_3, still, readings, field, table_6):
    """Yield what this run says of the printed numbers, arguments as for ``checks``.

    ``table_6`` has ``output``, ``name``, ``change_fitted`` and ``error_fitted``.
    """
    entry = partial(ledger.entry, SOURCE)
    printed = table(SOURCE, "table_2").set_index("result")
    for profile in (1, 2):
        both = printed.loc[["Measured (Average)", "MIMIC"], f"profile_{profile}_m"]
        difference, note = abs(both.diff().iloc[-1]), "The difference of the two values above it."
        yield entry("table_2", f"Error profile {profile}", difference, kind="predicted", note=note)
    note = f"Equations 2 and 3 at {MIRROR_HZ:.0f} Hz, which row 2 needs and is not printed."
    for row in table_3.itertuples():
        kind, wall = "fitted" if row.no == 2 else "predicted", f"wall {row.no}"
        yield entry("table_3", f"{wall} mimic", row.predicted_m, kind=kind, note=note)
        error = abs(row.ray_cast_m - row.predicted_m)
        for what, value in (("cad", row.ray_cast_m), ("error", error)):
            yield entry("table_3", f"{wall} {what}", value, kind="measured", note=TOLD["cast"])
    for reading, note in zip(readings[::-1], TOLD["readings"][::-1], strict=True):
        for row in reading.dropna(subset="fitted_mm").itertuples():
            for what in ("mimic", "cad"):
                value, cell = row.fitted_mm / 1000, f"wall {row.no} {what}"
                yield entry("table_4", cell, value, kind="fitted", note=note)
    for place, error in enumerate(still["point_mm"].abs().iloc[-9:] / 1000, start=1):
        yield entry("table_4", f"wall {place} error", error, kind="measured", note=TOLD["cast"])
    yield from _entries_of_table_5(still, field)
    for row in table_6.dropna(subset=["change_fitted"]).itertuples():
        cell, change = f"{row.output} {row.name}", abs(row.change_fitted)
        yield entry("table_6", cell, change, kind="fitted", note=TOLD[row.output])
    for output, error in table_6.groupby("output")["error_fitted"].first().items():
        yield entry("table_6", f"{output} error", error, kind="fitted", note=TOLD[output])
    yield from _entries_of_text(field)


def _entries_of_table_5(still, field):
    """Entries for the errors of three outputs in constructed models and in the field."""
    outputs = {"d_PrSH": "horizontal_mm", "d_PrSV": "vertical_mm", "d_PS": "point_mm"}
    for output, name in outputs.items():
        part = np.abs(still[name]) / 1000
        clicks = np.abs(_clicked_less_predicted(field, name)) / 1000
        for what in ("min", "mean", "max"):
            cell, value = f"Constructed {output} {what}", getattr(part, what)()
            yield _measured_entry("table_5", cell, [value], TOLD["cast"])
            values = getattr(clicks, what)("case").values
            yield _measured_entry("table_5", f"Real World {output} {what}", values, TOLD["field"])


def _measured_entry(name, cell, values, note):
    """The entry of a cell: the median of measured values, and between which they lie."""
    ends = {"low": np.nanmin(values), "high": np.nanmax(values)} if len(values) > 1 else {}
    middle = float(np.nanmedian(values))
    return ledger.entry(SOURCE, name, cell, middle, kind="measured", note=note, **ends)


def _clicked_less_predicted(field, name):
    """What the paper calls the error: distances clicked, less those of the equations, mm."""
    return field[name].sel({"method": "clicked"}) - field[name].sel({"method": EQUATIONS[1]})


def _entries_of_text(field):
    """Entries for the numbers of sections 4.1.2 to 5 about measurements in real clouds."""
    lines, points = (
        np.abs(_clicked_less_predicted(field, name)) for name in ("horizontal_mm", "point_mm")
    )
    scatter = field.sel({"method": "clicked"})
    values = {
        "profile_cases_above_1mm": 15 * (lines >= 1).mean("case"),
        "profile_error_majority": lines.median("case"),
        "profile_sigma_majority": scatter["std_horizontal_mm"].median("case"),
        "profile_mean_error_max": lines.mean("case") / 1000,
        "profile_error_all": lines.max("case"),
        "point_sigma_max": scatter["std_point_mm"].max("case"),
        "point_sigma_majority": scatter["std_point_mm"].median("case"),
        "point_error_max": points.max("case"),
        "point_error_max_range": field["range_m"][points.fillna(-1).argmax("case")],
        "point_mean_error_max": points.mean("case") / 1000,
        "largest_error": np.maximum(lines.max("case"), points.max("case")),
        "largest_mean_error": np.maximum(lines.mean("case"), points.mean("case")),
    }
    for key, found in values.items():
        yield _measured_entry("numbers", key, found.values, TOLD["field"])


def answer(*, counted, speed):
    """The study's answer in a sentence, from counted and predicted points and the largest speed."""
    off = (counted["counted"] / counted["predicted"] - 1).abs().max()
    return (
        f"Counted density is within {100 * off:.1f} % of the prediction; "
        f"3,000 points/m² at 5 m allow {3.6 * speed:.0f} km/h."
    )
