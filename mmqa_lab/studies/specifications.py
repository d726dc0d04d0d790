"""Specifications: Table 2 of Pfeifer et al. 2021 predicted from them, and fitted.

Predicted is what follows from the specifications that the paper and the data sheets state, with
what they leave open anywhere within plausible bounds. Fitted is what the best values of the open
parameters give: three or four free numbers for ten printed ones, so a fit is no reproduction.
"""

from functools import partial

import numpy as np
import pandas as pd
from scipy.stats import qmc, t
from tqdm.auto import tqdm

from mmqa_lab import bench as benches
from mmqa_lab.cloud import Cloud
from mmqa_lab.published import ledger
from mmqa_lab.scan_pattern import Patch, ScanSetup, scan_lattice
from mmqa_lab.simulate import systems
from mmqa_lab.simulate.point_patterns import thin
from mmqa_lab.studies.chart_tables import FIGURES, SENSORS, chart_cloud, read, table_2

USUAL = {"A": {"tilt_deg": 45, "height_m": 0.75}, "B": {"tilt_deg": 0, "height_m": 1}}
"""Parameters that are not stated: the usual values."""

FITS = (
    ("A", "stated", {"tilt_deg": (30, 60), "height_m": (0, 1.5)}),
    ("A", "free", {"tilt_deg": (30, 60), "height_m": (0, 1.5), "mirror_frequency_hz": (100, 200)}),
    ("B", "free", {"tilt_deg": (0, 50), "height_m": (0, 2)}),
    ("C", "free", {"resampled_per_m2": (20_000, 40_000), "hard_core": (0, 0.55)}),
)
"""System, name and bounds of each fit; the free one of A gives up the stated 200 Hz."""

FITTED = ["density_per_m2", "d1_mm", "d4_mm", "f"]

HALF_UNITS = (0.5, 0.5, 0.5, 0.05)
"""Half a unit of the last printed digit of what is fitted."""

TOLERANCE = 0.02
"""Relative part of a fit's tolerance: charts and crops are not known to a per cent."""

NOTES = {
    "predicted": {
        "A": "Simulated at the stated 1 MHz and 200 Hz, tilted by 30 to 60 degrees, 0 to 1.5 m up.",
        "B": "Simulated with the data sheet, pitched by 0 to 50 degrees, 0 to 2 m up.",
    },
    "fitted": {
        "A": "Tilt, height, noise and mirror frequency fitted, the stated 200 Hz given up.",
        "B": "Pitch, height and noise fitted to both rows.",
        "C": "Resampled to one density; density, hard core and noise fitted to both rows.",
    },
}
"""How an entry of the ledger was obtained, by kind and system."""

ARGUMENTS = {
    ("A", "d1_mm"): " At 200 Hz d1 is at least range x 2 pi / 5000; the printed ones need 7000.",
    ("A", "f"): " At 200 Hz d1 is too large for it, see d1.",
    ("A", "density_per_m2"): " At 200 Hz no tilt gives the printed density and d4 together.",
    ("B", "precision_mm"): " The data sheet's 20 mm are about twice what the chart shows.",
    ("B", "f"): " The data sheet's noise also moves points across oblique rays: f is larger.",
    ("C", "density_per_m2"): " One density for both distances leaves the rise of 7 % over.",
}
"""Why a figure differs, added to the note."""


def one_pair(distance_m, seed):
    """System C as one stereo pair; points a pixel and noise are fitted at 5 m."""
    per_px = 28_901 * (5 / systems.SYSTEM_C.focal_px) ** 2
    pair = {"resampled_per_m2": 0, "hard_core": 0.36, "points_per_px": per_px}
    return chart_cloud("C", distance_m, seed=seed, noise_px=0.69, floor_m=0, **pair)


def pairs_fused(distance_m, seed):
    """As many stereo pairs as keep the density."""
    count = round((distance_m / 5) ** 2)
    return Cloud.concatenate(one_pair(distance_m, 100 * seed + k) for k in range(count))


def thinned(distance_m, seed):
    """A dense cloud thinned in space; supply, least distance and noise are fitted."""
    supply = 75_000 * (distance_m / systems.SYSTEM_C.focal_px) ** 2
    noise = {"correlated_share": 0, "noise_px": 0.15, "floor_m": 0.0113}
    choices = {"hard_core": 0, "resampled_per_m2": 0, "points_per_px": supply}
    cloud = chart_cloud("C", distance_m, seed=seed, **noise, **choices)
    return cloud[thin(cloud.points, 0.0081)]


def resampled(distance_m, seed):
    """Points resampled on the surface to one density with a least distance, as fitted."""
    return chart_cloud("C", distance_m, seed=seed)


METHODS = {
    "one pair": one_pair,
    "pairs fused": pairs_fused,
    "thinned in space": thinned,
    "resampled on the surface": resampled,
}
"""Ways to match images and to sample: functions of the distance in m and a seed."""


def bench(*, methods=None, distances_m=(5.0, 10.0), seeds=range(4)):
    """Define the study's bench: what each way to match and sample gives at both distances.

    Parameters
    ----------
    methods : dict, optional
        Functions of ``distance_m`` and ``seed``, which return points from the chart's centre; by
        default ``METHODS``.
    distances_m : tuple of float
    seeds : iterable of int

    Returns
    -------
    Comparison
    """
    ways = {name: lambda drive, way=way: way(**drive) for name, way in (methods or METHODS).items()}
    cases = benches.grid(distance_m=distances_m)
    return benches.Comparison(cases, ways, dict, lambda cloud, _: read(cloud), seeds=seeds)


def misfits(results):
    """Return the figures of each way, means over seeds, and their distance from the printed rows.

    Parameters
    ----------
    results : Dataset
        Of :func:`bench`.

    Returns
    -------
    DataFrame
        ``model``, ``distance_m``, the figures, and ``misfit``: root mean square of the
        differences of both distances in tolerances, half a printed digit and 2 % in quadrature.
    """
    models = benches.cell_table(results.mean("seed", keep_attrs=True))
    models = models.rename(columns={"method": "model"})
    printed = table_2().query("system == 'C'").set_index("distance_m")[list(FIGURES)]
    goal = printed.loc[models["distance_m"]].to_numpy()
    off = (models[list(FIGURES)] - goal) / np.hypot([0.5, 0.05, 0.5, 0.5, 0.05], TOLERANCE * goal)
    square = (off**2).mean(axis=1).groupby(models["model"]).transform("mean")
    return models[["model", "distance_m", *FIGURES]].assign(misfit=np.sqrt(square))


def measure(system, parameters, *, seeds, distances=(5.0, 10.0)):
    """Return what Appendix A reads of a system with these parameters, a row for each pass."""
    return pd.DataFrame(
        {"system": system, "distance_m": distance, "seed": seed}
        | read(chart_cloud(system, distance, seed=seed, **parameters))
        for distance in distances
        for seed in seeds
    )


def fit(*, seed, candidates, repeats):
    """Fit the open parameters of each system to its published rows; of A, also the stated 200 Hz.

    Candidates are drawn over the bounds by a Latin hypercube, as many again over a third of them
    about the best, and again over a ninth. System A's candidates are judged by the closed form of
    the scan lattice, the others' by simulation; C is simulated at 5 m alone, since resampling makes
    its pattern independent of the distance. The candidates have the data sheets' noise; that of
    the result follows from sigma_MAD.

    Parameters
    ----------
    seed, candidates : int
        Candidates a round for the systems that are simulated; 1000 for the closed form.
    repeats : int
        Passes for the table, on seeds that the search has not seen.

    Returns
    -------
    parameters : DataFrame
        ``system``, ``fit`` (``stated``, ``free``), ``parameter``, ``fitted``, ``misfit``.
    passes : DataFrame
        Of :func:`measure`, with ``fit``.
    """
    judges = {"A": closed_form, "B": partial(simulated, "B", seed, (5.0, 10.0))}
    judges["C"] = partial(simulated, "C", seed, (5.0,))
    rows, passes = [], []
    for system, name, bounds in tqdm(FITS, unit="fit", leave=False):
        target = table_2().query("system == @system")
        count = 1000 if system == "A" else candidates
        best, misfit = search(judges[system], bounds, target, seed=seed, candidates=count)
        best |= fitted_noise(system, best, target, seed)
        rows += [(system, name, parameter, value, misfit) for parameter, value in best.items()]
        fresh = seed + 1000 + np.arange(repeats)
        passes.append(measure(system, best, seeds=fresh).assign(fit=name))
    names = ["system", "fit", "parameter", "fitted", "misfit"]
    return pd.DataFrame(rows, columns=names), pd.concat(passes, ignore_index=True)


def search(judge, bounds, target, *, seed, candidates):
    """Return the best of three rounds of candidates, a dict, and its misfit in tolerances."""
    low, high = np.array(list(bounds.values()), dtype=float).T
    printed = target[FITTED].to_numpy()
    best, smallest = None, np.inf
    for stage in range(3):
        if stage:
            reach = (high - low) / 6
            low, high = np.maximum(low, best - reach), np.minimum(high, best + reach)
        drawn = qmc.LatinHypercube(len(bounds), rng=seed + stage).random(candidates)
        values = low + drawn * (high - low)
        off = (judge(list(bounds), values) - printed) / np.hypot(HALF_UNITS, TOLERANCE * printed)
        found = np.sqrt((off**2).mean(axis=(1, 2)))
        if found.min() < smallest:
            best, smallest = values[np.argmin(found)], float(found.min())
    return dict(zip(bounds, best.tolist(), strict=True)), smallest


def closed_form(names, values):
    """Return density, d1, d4 and f of candidates for A, from the lattice at the chart's centre.

    Parameters
    ----------
    names : list of str
    values : array, shape (n, len(names))

    Returns
    -------
    array, shape (n, 2, 4)
        At 5 m and at 10 m.
    """
    given = dict(zip(names, values.T[:, :, None], strict=True))
    scanner = SENSORS["A"]
    known = {"pulse_rate_hz": scanner.pulse_rate_hz, "speed_m_s": systems.SPEED}
    known["mirror_frequency_hz"] = given.get("mirror_frequency_hz", scanner.mirror_frequency_hz)
    setup = ScanSetup(scanner_tilt_deg=given["tilt_deg"], **known)
    points = np.zeros((len(values), 2, 3))
    points[..., 0], points[..., 2] = (5.0, 10.0), -given["height_m"]
    lattice = scan_lattice(setup, Patch(points, [1, 0, 0]))
    figures = lattice.density_per_m2, lattice.d1_mm, lattice.d4_mm, lattice.f
    return np.stack(figures, axis=-1)


def simulated(system, seed, distances, names, values):
    """Return density, d1, d4 and f of candidates, one pass each: shape (n, m, 4)."""
    given, choices = pd.DataFrame(values, columns=names), {"seeds": [seed], "distances": distances}
    passes = [measure(system, one, **choices) for one in given.to_dict("records")]
    return np.array([rows[FITTED] for rows in passes])


def fitted_noise(system, parameters, target, seed):
    """Return the noise that gives the published sigma_MAD, as fields of the sensor.

    That of a scanner is scaled; that of matching is a floor and a part that grows with the square
    of the distance, which two published values determine.
    """
    if system == "C":
        near, far = target["precision_mm"] / 1000
        growth = np.sqrt((far**2 - near**2) / (10**4 - 5**4))
        camera = SENSORS["C"]
        return {
            "floor_m": float(np.sqrt(near**2 - (25 * growth) ** 2)),
            "noise_px": float(growth * camera.base_m * camera.focal_px),
        }
    read_mm = measure(system, parameters, seeds=[seed, seed + 1])["precision_mm"].mean()
    factor = target["precision_mm"].mean() / read_mm
    return {"range_noise_m": float(factor * SENSORS[system].range_noise_m)}


def compare(cells, passes):
    """Return Table 2 published, predicted and fitted, cell by cell.

    Parameters
    ----------
    cells : DataFrame
        Readings of A and B with the open parameters over their bounds: ``system``,
        ``distance_m``, ``tilt_deg``, ``height_m``, and the figures.
    passes : DataFrame
        Of :func:`fit`.

    Returns
    -------
    DataFrame
        ``system``, ``distance_m``, ``figure``, ``published``; ``predicted`` (usual values, mean
        over passes) with ``predicted_low`` and ``predicted_high`` over all of them; ``fitted`` with
        ``fitted_low`` and ``fitted_high``, 95 % of further passes; ``fitted_stated``, where the
        stated 200 Hz of A are kept. NaN where there is none.
    """
    usual = cells.merge(pd.DataFrame({"system": name, **USUAL[name]} for name in USUAL))
    free, stated = (passes[passes["fit"] == name] for name in ("free", "stated"))
    kept, n = ["system", "distance_m"], free["seed"].nunique()

    def figures(rows):
        return rows.groupby(kept)[list(FIGURES)]

    reach = t.ppf(0.975, n - 1) * np.sqrt(1 + 1 / n) * figures(free).std()
    columns = {
        "published": table_2().set_index(kept)[list(FIGURES)],
        "predicted": figures(usual).mean(),
        "predicted_low": figures(cells).min(),
        "predicted_high": figures(cells).max(),
        "fitted": figures(free).mean(),
        "fitted_low": figures(free).mean() - reach,
        "fitted_high": figures(free).mean() + reach,
        "fitted_stated": figures(stated).mean(),
    }
    table = pd.concat({name: part.stack() for name, part in columns.items()}, axis=1)
    return table.rename_axis([*kept, "figure"]).reset_index()


def ledger_table(table):
    """Return the ledger's entries on Table 2, from the table of :func:`compare`."""
    rows = []
    for row in table.to_dict("records"):
        system, figure = row["system"], row["figure"]
        cell = f"{system} {row['distance_m']:.0f} m {FIGURES[figure]}"
        assumed = (system, figure) == ("A", "precision_mm")  # no noise is stated
        for kind in ("fitted",) if assumed else NOTES:
            note = NOTES[kind].get(system, "") + ARGUMENTS.get((system, figure), "")
            numbers = [row[f"{kind}{end}"] for end in ("", "_low", "_high")]
            rows.append(("pfeifer2021", "table_2", cell, *numbers, kind, note))
    return ledger.entries(pd.DataFrame(rows, columns=ledger.COLUMNS).dropna(subset="value"))
