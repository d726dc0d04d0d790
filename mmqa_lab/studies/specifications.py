"""Specifications: Table 2 of Pfeifer et al. 2021 predicted from specifications, and fitted.

Predicted figures follow from the specifications in the paper and the data sheets. Parameters that
are not stated (open parameters) may lie anywhere within plausible bounds. Fitted figures follow
from the best open parameters. A fit has three or four free parameters for ten printed numbers, so
it is no reproduction.
"""

from functools import partial

import numpy as np
import pandas as pd
from scipy.stats import qmc

from mmqa_lab import bench as benches
from mmqa_lab.cloud import Cloud
from mmqa_lab.scan_pattern import Patch, ScanSetup, scan_lattice
from mmqa_lab.simulate import systems
from mmqa_lab.simulate.point_patterns import thin
from mmqa_lab.stats import student_reach
from mmqa_lab.studies.chart_tables import FIGURES, SENSORS, chart_cloud, read, table_2

__all__ = [
    "FITS", "FITTED", "HALF_UNITS", "METHODS", "TOLERANCE", "USUAL", "bench", "closed_form",
    "compare", "fit", "fitted_noise", "in_tolerances", "make", "measure", "misfits", "one_pair",
    "pairs_fused", "resampled", "score", "search", "simulated", "thinned",
]  # fmt: skip

USUAL = {"A": {"tilt_deg": 45, "height_m": 0.75}, "B": {"tilt_deg": 0, "height_m": 1}}
"""Usual values of the parameters that are not stated."""

FITS = (
    ("A", "stated", {"tilt_deg": (30, 60), "height_m": (0, 1.5)}),
    ("A", "free", {"tilt_deg": (30, 60), "height_m": (0, 1.5), "mirror_frequency_hz": (100, 200)}),
    ("B", "free", {"tilt_deg": (0, 50), "height_m": (0, 2)}),
    ("C", "free", {"resampled_per_m2": (20_000, 40_000), "hard_core": (0, 0.55)}),
)
"""System, name and bounds of each fit. The free fit of A also varies the stated 200 Hz."""

HALF_UNITS = pd.Series([0.5, 0.05, 0.5, 0.5, 0.05], list(FIGURES))
"""Half a unit of the last digit printed in Table 2."""

FITTED = ["density_per_m2", "d1_mm", "d4_mm", "f"]

TOLERANCE = 0.02
"""Relative part of a fit's tolerance: charts and crops are not known to 1 %."""


def one_pair(drive):
    """Match a stereo pair of system C; points per pixel and noise are fitted at 5 m."""
    per_px = 28_901 * (5 / systems.SYSTEM_C.focal_px) ** 2
    pair = {"resampled_per_m2": 0, "hard_core": 0.36, "points_per_px": per_px}
    return chart_cloud("C", drive[0], seed=drive[1], noise_px=0.69, floor_m=0, **pair)


def pairs_fused(drive):
    """Fuse the number of stereo pairs that gives the same density at each distance."""
    distance_m, seed = drive
    seeds = range(100 * seed, 100 * seed + round((distance_m / 5) ** 2))
    return Cloud.concatenate(one_pair((distance_m, each)) for each in seeds)


def thinned(drive):
    """Thin a dense cloud in space; density, least distance and noise are fitted."""
    supply = 75_000 * (drive[0] / systems.SYSTEM_C.focal_px) ** 2
    dense = {"hard_core": 0, "resampled_per_m2": 0, "points_per_px": supply, "correlated_share": 0}
    cloud = chart_cloud("C", drive[0], seed=drive[1], noise_px=0.15, floor_m=0.0113, **dense)
    return cloud[thin(cloud.points, 0.0081)]


def resampled(drive):
    """Resample the surface to a fixed density with a least distance; both are fitted."""
    return chart_cloud("C", drive[0], seed=drive[1])


METHODS = {
    "one pair": one_pair,
    "pairs fused": pairs_fused,
    "thinned in space": thinned,
    "resampled on the surface": resampled,
}
"""Methods of matching and sampling: functions of a drive, a tuple (distance in m, seed)."""


def bench(*, methods=None, seeds=range(4)):
    """Define the study's bench: methods of matching and sampling at both distances.

    Parameters
    ----------
    methods : dict, optional
        Functions of a tuple (distance in m, seed) that return points, m, with the chart's centre as
        origin; by default ``METHODS``.
    seeds : iterable of int
        Seeds of the drives.

    Returns
    -------
    Comparison
    """
    cases = benches.grid(distance_m=(5.0, 10.0))
    answer = {"tables": lambda results: {"misfits": misfits(results)}}
    return benches.Comparison(cases, dict(methods or METHODS), make, score, seeds=seeds, **answer)


def make(distance_m, *, seed):
    """Return a drive past the chart, the argument of a method."""
    return (distance_m, seed), None


def score(cloud, _):
    """Return the figures of Table 2 by Appendix A; there is no truth."""
    return read(cloud)


def misfits(results):
    """Return the mean figures of each method and their misfit from C's printed rows.

    ``results`` is the Dataset of :func:`bench`. A row has ``model``, ``distance_m``, the figures,
    and ``misfit``, the root mean square difference in tolerances over all figures and distances.
    """
    models = benches.cell_table(results.mean("seed", keep_attrs=True))
    models = models.reindex(columns=["method", "distance_m", *FIGURES])
    printed = table_2().query("system == 'C'").set_index("distance_m")[list(FIGURES)]
    goal = printed.loc[models["distance_m"]].to_numpy()
    square = in_tolerances(models[list(FIGURES)], goal, list(FIGURES)) ** 2
    square = square.mean(axis=1).groupby(models["method"]).transform("mean")
    table = benches.remarked(models.assign(misfit=np.sqrt(square)), results)
    return table.rename(columns={"method": "model"})


def in_tolerances(figures, printed, names):
    """Return differences in units of a tolerance: half a printed digit and 2 %, in quadrature."""
    return (figures - printed) / np.hypot(HALF_UNITS[names], TOLERANCE * printed)


def measure(cases, *, seeds):
    """Return the figures of Appendix A for each case; cases are arguments of ``chart_cloud``."""
    readings = benches.run(cases, {"Appendix A": read}, make=chart_cloud, seeds=seeds)
    return benches.cell_table(readings)


def fit(*, seed, candidates, repeats):
    """Fit the open parameters of each system to its published rows; for A, also the stated 200 Hz.

    A Latin hypercube draws candidates over the bounds. A second round draws candidates over a third
    of the bounds around the best candidate, a third round over a ninth. The figures of system A
    follow from the closed form of the scan lattice, the figures of B and C from simulation. C is
    simulated at 5 m only, because resampling makes its pattern independent of the distance. The
    candidates have the noise of the data sheets. The fitted noise follows from sigma_MAD.

    Parameters
    ----------
    seed : int
        Seed of the candidates and of the simulations.
    candidates : int
        Candidates per round for the simulated systems. The closed form takes 1000.
    repeats : int
        Passes for the table, with other seeds than the search.

    Returns
    -------
    parameters : DataFrame
        ``system``, ``fit`` (``stated``, ``free``), ``parameter``, ``fitted``, ``misfit``.
    passes : DataFrame
        The table of :func:`measure`, with ``fit``.
    """
    rows, passes = [], []
    for system, name, bounds in FITS:
        target = table_2().query("system == @system")
        judge = closed_form if system == "A" else partial(simulated, system=system, seed=seed)
        count = 1000 if system == "A" else candidates
        best, misfit = search(judge, bounds, target, seed=seed, candidates=count)
        best |= fitted_noise(system, best, target, seed)
        rows += [(system, name, parameter, value, misfit) for parameter, value in best.items()]
        cases = benches.grid(system=system, distance_m=(5.0, 10.0), **best)
        fresh = range(seed + 1000, seed + 1000 + repeats)
        passes.append(measure(cases, seeds=fresh).assign(fit=name))
    names = ["system", "fit", "parameter", "fitted", "misfit"]
    return pd.DataFrame(rows, columns=names), pd.concat(passes, ignore_index=True)


def search(judge, bounds, target, *, seed, candidates):
    """Return the best of three rounds of candidates, a dict, and its misfit in tolerances."""
    low, high = np.array(list(bounds.values()), dtype=float).T
    printed = target[FITTED].to_numpy()
    best, smallest = None, np.inf
    for stage in range(3):
        drawn = qmc.LatinHypercube(len(bounds), rng=seed + stage).random(candidates)
        values = pd.DataFrame(low + drawn * (high - low), columns=list(bounds))
        found = np.sqrt((in_tolerances(judge(values), printed, FITTED) ** 2).mean(axis=(1, 2)))
        if found.min() < smallest:
            best, smallest = values.to_numpy()[np.argmin(found)], float(found.min())
        reach = (high - low) / 6
        low, high = np.maximum(low, best - reach), np.minimum(high, best + reach)
    return dict(zip(bounds, best.tolist(), strict=True)), smallest


def closed_form(values):
    """Return density, d1, d4 and f of n candidates for A from the lattice at the chart's centre.

    The array has the shape (n, 2, 4), for 5 m and 10 m.
    """
    given = {name: values[[name]].to_numpy() for name in values}
    setup = ScanSetup(
        pulse_rate_hz=SENSORS["A"].pulse_rate_hz,
        speed_m_s=systems.SPEED,
        scanner_tilt_deg=given["tilt_deg"],
        mirror_frequency_hz=given.get("mirror_frequency_hz", SENSORS["A"].mirror_frequency_hz),
    )
    points = np.zeros((len(values), 2, 3))
    points[..., 0], points[..., 2] = (5.0, 10.0), -given["height_m"]
    lattice = scan_lattice(setup, Patch(points, [1, 0, 0]))
    return np.stack([getattr(lattice, name) for name in FITTED], axis=-1)


def simulated(values, *, system, seed):
    """Return density, d1, d4 and f of n candidates from a pass each; for C at 5 m only."""
    distances = pd.DataFrame({"distance_m": (5.0, 10.0) if system == "B" else (5.0,)})
    cases = values.assign(system=system).merge(distances, how="cross")
    return measure(cases, seeds=[seed])[FITTED].to_numpy().reshape(len(values), -1, len(FITTED))


def fitted_noise(system, parameters, target, seed):
    """Return the noise that gives the published sigma_MAD, as fields of the sensor.

    The noise of a scanner is scaled. The noise of matching has a constant part and a part that
    grows with the square of the distance. The two published values determine both parts.
    """
    if system == "C":
        near, far = target["precision_mm"] / 1000
        growth = np.sqrt((far**2 - near**2) / (10**4 - 5**4))
        noise_px = growth * SENSORS["C"].base_m * SENSORS["C"].focal_px
        return {"floor_m": np.sqrt(near**2 - (25 * growth) ** 2), "noise_px": noise_px}
    cases = benches.grid(system=system, distance_m=(5.0, 10.0), **parameters)
    read_mm = measure(cases, seeds=[seed, seed + 1])["precision_mm"].mean()
    factor = target["precision_mm"].mean() / read_mm
    return {"range_noise_m": factor * SENSORS[system].range_noise_m}


def compare(cells, passes):
    """Return the published, predicted and fitted numbers of Table 2; NaN is a missing number.

    Parameters
    ----------
    cells : DataFrame
        Readings of A and B with open parameters over their bounds: ``system``,
        ``distance_m``, ``tilt_deg``, ``height_m``, and the figures.
    passes : DataFrame
        From :func:`fit`.

    Returns
    -------
    DataFrame
        ``system``, ``distance_m``, ``figure``, ``published``; ``predicted``, the mean over passes
        with usual values; ``predicted_low`` and ``predicted_high``, the limits over all readings;
        ``fitted``; ``fitted_low`` and ``fitted_high``, the limits for 95 % of further passes;
        ``fitted_stated``, fitted with the stated 200 Hz of A.
    """
    kept, names = ["system", "distance_m"], list(FIGURES)
    usual = cells.merge(pd.DataFrame({"system": name, **USUAL[name]} for name in USUAL))
    usual, bounds = (rows.groupby(kept)[names] for rows in (usual, cells))
    fits = {name: rows.groupby(kept)[names] for name, rows in passes.groupby("fit")}
    mean, n = fits["free"].mean(), passes["seed"].nunique()
    reach = fits["free"].std() * student_reach(np.sqrt(1 + 1 / n), n - 1)
    columns = {
        "published": table_2().set_index(kept)[names],
        "predicted": usual.mean(),
        "predicted_low": bounds.min(),
        "predicted_high": bounds.max(),
        "fitted": mean,
        "fitted_low": mean - reach,
        "fitted_high": mean + reach,
        "fitted_stated": fits["stated"].mean(),
    }
    table = pd.concat({name: part.stack() for name, part in columns.items()}, axis=1)
    return table.rename_axis([*kept, "figure"]).reset_index()
