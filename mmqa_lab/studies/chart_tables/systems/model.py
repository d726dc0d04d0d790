"""Table 2 from specifications: what the systems should have scanned, and what it takes to fit.

Predicted is what follows from the specifications that the paper and the data-sheets state, with
what they leave open anywhere within plausible bounds. Fitted is what the best values of the open
parameters give. Neither is a reproduction: a fit has as many free numbers as it needs.
"""

from dataclasses import replace
from itertools import product

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_count
from mmqa_lab.chart_cloud import chart_polygon, evaluate_cloud
from mmqa_lab.planes import PAPER_SCALE
from mmqa_lab.published import pfeifer2021
from mmqa_lab.scan_pattern import Patch, ScanSetup, scan_lattice
from mmqa_lab.simulate import chart_corners, systems

QUICK = {"candidates": 4, "repeats": 1, "tilts": (25, 32, 45, 53)}
"""For the tests: arguments of the same names below."""

QUANTITIES = ("density_per_m2", "precision_mm", "d1_mm", "d4_mm", "f")

SENSORS = {"A": systems.SYSTEM_A, "B": systems.SYSTEM_B, "C": systems.SYSTEM_C}

OPEN = {
    "A": {"tilt_deg": (30.0, 45.0, 60.0), "height_m": (0.0, 0.75, 1.5)},
    "B": {"tilt_deg": (0.0, 0.0, 50.0), "height_m": (0.0, 1.0, 2.0)},
    "C": {"hard_core": (0.0, 0.0, 0.55)},
}
"""Parameters that are not stated: lowest, usual and highest plausible value."""

RELEASED = {"A": {"mirror_frequency_hz": (100.0, 200.0, 200.0)}}
"""Stated parameters that a second fit gives up."""

GUESSED_DENSITY = 28_000.0
"""Points per square metre at 5 m of system C where only the pattern counts."""

FITTED = ["density_per_m2", "d1_mm", "d4_mm"]
CLOSED_FORM_CANDIDATES = 1000

MODEL_TOLERANCE = 0.02
"""What a fit is not asked to do better than: charts and crops are not known to a per cent."""


def evaluate(cloud, distance, *, turn=0.0):
    """Evaluate the middle of a simulated chart, 0.71 m x 0.71 m, as Appendix A of the paper does.

    Parameters
    ----------
    cloud : Cloud
        Of :func:`mmqa_lab.simulate.systems.pass_chart`.
    distance : float
        Of the chart, metres.
    turn : float
        Degrees by which the crop is turned in the chart.

    Returns
    -------
    CloudQuality
    """
    corners = chart_corners((distance, 0, 0), heading=systems.FACING_THE_ROAD)
    polygon = chart_polygon(corners) - [distance, 0, 0]
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    polygon = polygon @ np.array([[1, 0, 0], [0, c, s], [0, -s, c]]) + [distance, 0, 0]
    return evaluate_cloud(cloud, polygon=polygon, thickness=0.2, scale=PAPER_SCALE)


def usual(system):
    """Return the usual value of each parameter of a system that is not stated, as a dict.

    Examples
    --------
    >>> usual("B")
    {'tilt_deg': 0.0, 'height_m': 1.0}
    """
    return {name: values[1] for name, values in OPEN[system].items()}


def chart_points(system, parameters, *, distance, seed):
    """Return the cloud of a chart as a system with these parameters scans it.

    Parameters
    ----------
    system : {"A", "B", "C"}
    parameters : dict
        Values of fields of the sensor, of ``height_m``, and of ``density`` (system C, points per
        square metre at 5 m).
    distance : float
        Metres.
    seed : int
    """
    changes = dict(parameters)
    height = changes.pop("height_m", 0.0)
    if system == "C":
        density = changes.pop("density", GUESSED_DENSITY)
        changes["points_per_px"] = density * (5 / SENSORS["C"].focal_px) ** 2
    sensor = replace(SENSORS[system], **changes)
    return systems.pass_chart(sensor, distance, seed=seed, height=height)


def measure(system, parameters, *, seeds, distances=systems.DISTANCES):
    """Return density, precision, d1, d4 and f of a system at both distances, means over seeds.

    Parameters
    ----------
    system, parameters
        As for :func:`chart_points`.
    seeds : sequence of int
    distances : sequence of float
        Metres.

    Returns
    -------
    DataFrame
        A row a distance: ``system``, ``distance_m``, the quantities.
    """
    rows = []
    for distance, seed in product(distances, seeds):
        q = evaluate(chart_points(system, parameters, distance=distance, seed=seed), distance)
        figures = (q.density_hull_per_m2, q.sigma_mad_mm, q.d1_mm, q.d4_mm, q.f)
        rows.append((system, distance, *figures))
    table = pd.DataFrame(rows, columns=["system", "distance_m", *QUANTITIES])
    return table.groupby(["system", "distance_m"], as_index=False).mean()


def predict(*, seed, repeats):
    """Predict Table 2 from what is stated, without looking at the published values.

    Parameters
    ----------
    seed, repeats : int
        Passes averaged, with their places and errors by seed.

    Returns
    -------
    DataFrame
        ``system``, ``distance_m``, ``quantity``, ``predicted`` (open parameters at their usual
        values), ``predicted_low``, ``predicted_high`` (over their plausible bounds). NaN for
        density, precision and spacing of system C, whose images are not described.
    """
    tables = []
    seeds = seed + np.arange(check_count(repeats, "repeats"))
    for system, bounds in OPEN.items():
        grid = [dict(zip(bounds, values, strict=True)) for values in product(*_ends(bounds))]
        spread = pd.concat([measure(system, each, seeds=seeds[:1]) for each in grid])
        table = _long(measure(system, usual(system), seeds=seeds), "predicted")
        spread = spread.groupby(["system", "distance_m"], as_index=False)
        low, high = _long(spread.min(), "predicted_low"), _long(spread.max(), "predicted_high")
        table = table.merge(low).merge(high)
        # the range spans the usual case too, which repeats may put outside of single passes
        table["predicted_low"] = table[["predicted", "predicted_low"]].min(axis=1)
        table["predicted_high"] = table[["predicted", "predicted_high"]].max(axis=1)
        tables.append(table)
    table = pd.concat(tables, ignore_index=True)
    unknown = (table["system"] == "C") & (table["quantity"] != "f")
    table.loc[unknown, ["predicted", "predicted_low", "predicted_high"]] = np.nan
    return table


def fit(published, *, seed, candidates, repeats):
    """Fit the open parameters of each system to its published rows; of A, also the stated 200 Hz.

    Candidates are drawn over the bounds by a Latin hypercube, as many again over a third of them
    about the best, and again over a ninth. System A's candidates are judged by the closed form of
    the scan lattice, the others' by simulation; the fitted rows are simulated. The misfit is the
    root mean square of (model - published) / tolerance over density, d1 and d4 at both distances; a
    tolerance is half a unit of the last printed digit and 2 %, in quadrature. f = d4 / d1 is left
    out: it adds nothing to the two.

    Parameters
    ----------
    published : DataFrame
        As :func:`mmqa_lab.published.pfeifer2021.table_2`.
    seed, candidates : int
        Candidates a round for the systems that are simulated; 1000 for the closed form.
    repeats : int
        Passes averaged for the table, on seeds that the search has not seen.

    Returns
    -------
    parameters : DataFrame
        ``system``, ``fit`` (``open``, ``released``), ``parameter``, ``value``, ``low``,
        ``high``, ``misfit``, ``numbers_fitted``, ``numbers_published``.
    rows : DataFrame
        ``system``, ``distance_m``, ``quantity``, ``fitted``, ``fitted_released``.
    """
    parameters, rows = [], []
    fresh = seed + 1000 + np.arange(check_count(repeats, "repeats"))
    judges = {"A": (_closed_form, CLOSED_FORM_CANDIDATES)}
    for system, kind, bounds in _fits():
        target = published[published["system"] == system]
        judge, count = judges.get(system, (_simulated(system, seed), candidates))
        best, misfit = _search(judge, bounds, target, seed, check_count(count, "candidates"))
        given = int(target[FITTED].notna().sum().sum())
        for name, value in best.items():
            low, _, high = bounds[name]
            row = (system, kind, name, value, low, high, misfit, len(best), given)
            parameters.append(row)
        name = "fitted" if kind == "open" else "fitted_released"
        rows.append(_long(measure(system, best, seeds=fresh), name))
    columns = ["system", "fit", "parameter", "value", "low", "high", "misfit"]
    columns += ["numbers_fitted", "numbers_published"]
    rows = pd.concat(rows).groupby(["system", "distance_m", "quantity"], as_index=False).first()
    return pd.DataFrame(parameters, columns=columns), rows


def compare(published, predicted, fitted):
    """Set published, predicted and fitted values side by side.

    Returns
    -------
    DataFrame
        ``system``, ``distance_m``, ``quantity``, ``published``, ``predicted``,
        ``predicted_low``, ``predicted_high``, ``within`` (whether the published value lies in
        the predicted range, None where either is missing), ``fitted``, ``fitted_difference``,
        ``fitted_difference_percent``, and the same of ``fitted_released``.
    """
    table = _long(published[["system", "distance_m", *QUANTITIES]], "published")
    table = table.merge(predicted, how="left").merge(fitted, how="left")
    inside = (table["published"] >= table["predicted_low"]) & (
        table["published"] <= table["predicted_high"]
    )
    known = table["published"].notna() & table["predicted"].notna()
    table.insert(7, "within", inside.astype(object).where(known, None))
    for name in ("fitted", "fitted_released"):
        difference = table[name] - table["published"]
        table[f"{name}_difference"] = difference
        table[f"{name}_difference_percent"] = 100 * difference / table["published"]
    table.attrs["source"] = pfeifer2021.SOURCE
    return table


def sweep_tilt(*, frequencies, tilts, seed):
    """Return density and d4 of system A at 5 m over the tilt of its plane.

    Parameters
    ----------
    frequencies : sequence of float
        Mirror frequencies, Hz.
    tilts : sequence of float
        Degrees.
    seed : int

    Returns
    -------
    DataFrame
        ``mirror_frequency_hz``, ``tilt_deg``, ``density_polygon_per_m2``,
        ``density_hull_per_m2``, ``d1_mm``, ``d4_mm``.
    """
    rows = []
    for frequency, tilt in product(frequencies, tilts):
        scanner = replace(systems.SYSTEM_A, mirror_frequency_hz=frequency, tilt_deg=tilt)
        q = evaluate(systems.pass_chart(scanner, 5.0, seed=seed), 5.0)
        densities = (q.density_polygon_per_m2, q.density_hull_per_m2)
        rows.append((frequency, tilt, *densities, q.d1_mm, q.d4_mm))
    columns = ["mirror_frequency_hz", "tilt_deg", "density_polygon_per_m2"]
    return pd.DataFrame(rows, columns=[*columns, "density_hull_per_m2", "d1_mm", "d4_mm"])


def cap(sweep, *, d4_mm):
    """Return the density at which a mirror frequency gives a spacing d4, from a sweep of tilts.

    Returns
    -------
    DataFrame
        ``mirror_frequency_hz``, ``tilt_deg``, ``density_polygon_per_m2``,
        ``density_hull_per_m2``, all interpolated to ``d4_mm``.
    """
    rows = []
    for frequency, part in sweep.groupby("mirror_frequency_hz"):
        part = part.sort_values("d4_mm")
        names = ["tilt_deg", "density_polygon_per_m2", "density_hull_per_m2"]
        values = [np.interp(d4_mm, part["d4_mm"], part[name]) for name in names]
        rows.append((frequency, *values))
    return pd.DataFrame(rows, columns=["mirror_frequency_hz", *names])


def pulses_per_revolution(published):
    """Return the pulses a revolution that the printed d1 of system A allow, lowest and highest.

    Along a line of a profile scanner d1 is range x 2 pi / pulses where the beam hits square; each
    printed d1 stands for half a millimetre to either side.

    Examples
    --------
    >>> pulses_per_revolution(pfeifer2021.table_2()).round().tolist()
    [6981.0, 7392.0]
    """
    rows = published[published["system"] == "A"]
    turn = 2 * np.pi * 1000 * rows["distance_m"]
    low, high = turn / (rows["d1_mm"] + 0.5), turn / (rows["d1_mm"] - 0.5)
    return np.array([low.max(), high.min()])


def hull_bias(*, turns, seed, repeats):
    """Return by how much the hull's density exceeds the polygon's as the crop turns on the lines.

    Vertical scan lines of system A (plane upright) on both charts, cropped by a square of half a
    square metre.

    Parameters
    ----------
    turns : sequence of float
        Angles between the lines and the edges of the crop, degrees.
    seed, repeats : int

    Returns
    -------
    DataFrame
        ``distance_m``, ``turn_deg``, ``bias_percent`` (mean), ``bias_sd_percent`` of one pass.
    """
    scanner = replace(systems.SYSTEM_A, tilt_deg=0.0)
    rows = []
    for distance, k in product(systems.DISTANCES, range(repeats)):
        cloud = systems.pass_chart(scanner, distance, seed=seed + k)
        for turn in turns:
            q = evaluate(cloud, distance, turn=turn)
            bias = 100 * (q.density_hull_per_m2 / q.density_polygon_per_m2 - 1)
            rows.append((distance, turn, bias))
    table = pd.DataFrame(rows, columns=["distance_m", "turn_deg", "bias_percent"])
    groups = table.groupby(["distance_m", "turn_deg"])["bias_percent"]
    return groups.agg(bias_percent="mean", bias_sd_percent="std").reset_index()


def _ends(bounds):
    """Lowest and highest value of each parameter."""
    return [sorted({values[0], values[2]}) for values in bounds.values()]


def _long(table, name):
    """One row a quantity."""
    return table.melt(["system", "distance_m"], list(QUANTITIES), "quantity", name)


def _fits():
    """System, kind and bounds of every fit."""
    bounds = OPEN | {"C": OPEN["C"] | {"density": (10_000.0, GUESSED_DENSITY, 60_000.0)}}
    for system, each in bounds.items():
        yield system, "open", each
        if system in RELEASED:
            yield system, "released", each | RELEASED[system]


def _search(judge, bounds, target, seed, candidates):
    """The best of three rounds of candidates, and its misfit."""
    from scipy.stats import qmc

    low, _, high = np.array(list(bounds.values())).T
    target = target.dropna(subset=["d1_mm"])
    best, misfit = None, np.inf
    for stage in range(3):
        if stage:
            reach = (high - low) / 6
            low, high = np.maximum(low, best - reach), np.minimum(high, best + reach)
        drawn = qmc.LatinHypercube(len(bounds), rng=seed + stage).random(candidates)
        values = low + drawn * (high - low)
        found = _misfits(judge(list(bounds), values, target["distance_m"].to_numpy()), target)
        if found.min() < misfit:
            best, misfit = values[np.argmin(found)], float(found.min())
    return dict(zip(bounds, best.tolist(), strict=True)), misfit


def _misfits(models, target):
    """Root mean square of the differences in tolerances, of models (n, distances, 3)."""
    printed = target[FITTED].to_numpy()
    tolerance = np.hypot(0.5, MODEL_TOLERANCE * printed)
    return np.sqrt(np.nanmean(((models - printed) / tolerance) ** 2, axis=(1, 2)))


def _simulated(system, seed):
    """Density, d1 and d4 of candidates by simulation."""

    def judge(names, values, distances):
        rows = [
            measure(system, dict(zip(names, v, strict=True)), seeds=[seed], distances=distances)
            for v in values
        ]
        return np.array([row[FITTED].to_numpy() for row in rows])

    return judge


def _closed_form(names, values, distances):
    """Density, d1 and d4 of candidates for system A from the scan lattice at the chart's centre."""
    given = dict(zip(names, values.T[:, :, None], strict=True))
    scanner = SENSORS["A"]
    setup = ScanSetup(
        pulse_rate_hz=scanner.pulse_rate_hz,
        mirror_frequency_hz=given.get("mirror_frequency_hz", scanner.mirror_frequency_hz),
        scanner_tilt_deg=given["tilt_deg"],
        speed_m_s=systems.SPEED,
    )
    points = np.zeros((len(values), len(distances), 3))
    points[..., 0], points[..., 2] = distances, -given["height_m"]
    lattice = scan_lattice(setup, Patch(points, [1, 0, 0]))
    d = 1000 * lattice.distances_m
    return np.stack([lattice.density_per_m2, d[..., 0], d[..., 3]], axis=-1)
