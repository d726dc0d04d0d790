"""Patterns of known anisotropy and real clouds, measured by f and by what else there is."""

import timeit

import numpy as np
import pandas as pd
import xarray as xr
from tqdm.auto import tqdm

from mmqa_lab import io, samples
from mmqa_lab.planes import fit_plane
from mmqa_lab.simulate.point_patterns import (
    KINDS,
    aligned_lines_f,
    expected_f,
    point_pattern,
    true_ratio,
)
from mmqa_lab.spacing import (
    clark_evans,
    directional_spacing,
    pair_contrast,
    quadrant_distances,
    spacing,
    structure_tensor_ratio,
    turned_f,
)
from mmqa_lab.views import is_headless

TURN = tuple(range(0, 90, 15))
"""Turns of the axes for the smallest, mean and largest f."""

MEASURES = {
    "f": "f = d4/d1 at the given axes",
    "f_min": "f, smallest over a turn",
    "f_mean": "f, mean over a turn",
    "f_max": "f, largest over a turn",
    "g": "g, spacing across / along",
    "g_at_axes": "directional spacing at the given axes",
    "structure_tensor": "structure tensor, 16 neighbours",
    "pair_contrast": "Ripley's K by direction",
    "clark_evans": "Clark-Evans index",
}

CLOSED = ("lattice", "hexagonal", "scan_lines", "poisson")
"""Patterns whose f is known in closed form."""

LEAST_NOISE, EXACT = 1e-10, 1e-6
"""Metres of noise that decide on which side of an axis a point lies and nothing else."""

BOARDS = {
    "board, VLP-16": "boards/vlp16_pose02.laz",
    "board, 64 rings": "boards/os64_pose02.laz",
}


def compute(*, ratios, angles, counts, noises_mm, seeds, density):
    """Measure every pattern at every ratio, angle, size, noise and seed.

    Parameters
    ----------
    ratios, angles, counts, noises_mm, seeds : sequences of numbers
        Across / along; degrees; mean points in the window; mm; whole numbers.
    density : float
        Points per square metre.

    Returns
    -------
    Dataset
        Dimensions ``pattern``, ``ratio``, ``angle``, ``n``, ``noise``, ``seed``; the measures of
        ``MEASURES``, ``d1``, ``d4``, ``direction`` and ``true_ratio``. Everything is simulated.
    """
    axes = {
        "pattern": list(KINDS),
        "ratio": [float(ratio) for ratio in ratios],
        "angle": [float(angle) for angle in angles],
        "n": list(counts),
        "noise": [float(noise) for noise in noises_mm],
        "seed": list(seeds),
    }
    index = pd.MultiIndex.from_product(axes.values(), names=axes.keys())
    rows = []
    for kind, ratio, angle, n, noise, seed in tqdm(index, desc="patterns", disable=is_headless()):
        size = np.sqrt(n / density)
        choices = {"ratio": ratio, "angle": angle, "noise": noise / 1000}
        xy = point_pattern(kind, density=density, size=size, seed=seed, **choices)
        rows.append(_measured(xy, density) | {"true_ratio": true_ratio(kind, ratio)})
    table = pd.DataFrame(rows, index=index)
    dataset = xr.Dataset.from_dataframe(table).reindex(axes)
    units = {"ratio": "1", "angle": "degrees", "n": "points", "noise": "mm", "seed": "1"}
    units |= {"d1": "mm", "d4": "mm", "direction": "degrees"}
    for name in [*dataset.data_vars, *units]:
        dataset[name].attrs["units"] = units.get(name, "1")
    dataset.attrs |= {"density_per_m2": density, "kind": "measured on simulated patterns"}
    return dataset


def _measured(xy, density):
    """All measures of one pattern, lengths in mm."""
    gaps, directional = spacing(xy), directional_spacing(xy)
    turned = turned_f(xy, angles=TURN)
    at_axes = directional.at(90) / directional.at(0)
    return {
        "f": gaps.f,
        "f_min": turned.min(),
        "f_mean": turned.mean(),
        "f_max": turned.max(),
        "g": directional.g,
        "g_at_axes": max(at_axes, 1 / at_axes),
        "structure_tensor": structure_tensor_ratio(xy),
        "pair_contrast": pair_contrast(xy, reach=2 / np.sqrt(density)),
        "clark_evans": clark_evans(xy),
        "d1": 1000 * gaps.d[0],
        "d4": 1000 * gaps.d[3],
        "direction": directional.direction_deg,
    }


def summary(dataset):
    """Return the mean over the seeds and its 95 % interval (Student's t).

    Returns
    -------
    Dataset
        As ``dataset`` with ``statistic`` = mean, low, high in place of ``seed``.
    """
    from scipy.stats import t

    count = dataset.sizes["seed"]
    mean = dataset.mean("seed")
    factor = t.ppf(0.975, count - 1) / np.sqrt(count) if count > 1 else np.nan
    half = factor * dataset.std("seed", ddof=1)
    parts = xr.concat([mean, mean - half, mean + half], dim="statistic")
    return parts.assign_coords(statistic=["mean", "low", "high"])


def rank_correlations(dataset, *, draws=200, seed=0):
    """Compare the measures by how they order the patterns.

    Parameters
    ----------
    dataset : Dataset
        Of :func:`compute`.
    draws : int
        Of the bootstrap over patterns.

    Returns
    -------
    DataFrame
        A row per measure: Spearman's ``rank_correlation`` with the true ratio over all patterns,
        ratios, angles, sizes, noises and seeds, its bootstrap interval ``low`` to ``high``,
        ``right_order`` (share of the pairs with different true ratios that the measure orders
        rightly) and ``n``. ``attrs["difference"]``: interval of g's correlation minus f's.
    """
    table = dataset[[*MEASURES, "true_ratio"]].to_dataframe().dropna()
    rng = np.random.default_rng(seed)
    drawn = [table.iloc[rng.integers(len(table), size=len(table))] for _ in range(draws)]
    spread = pd.DataFrame([_spearman(part) for part in drawn])
    low, high = spread.quantile(0.025), spread.quantile(0.975)
    result = pd.DataFrame(
        {
            "measure": MEASURES.values(),
            "rank_correlation": _spearman(table),
            "low": low,
            "high": high,
            "right_order": [_right_order(table[name], table["true_ratio"]) for name in MEASURES],
            "n": len(table),
            "kind": "measured",
        }
    )
    result.attrs["difference"] = tuple(np.quantile(spread["g"] - spread["f"], [0.025, 0.975]))
    return result.rename_axis("name").reset_index()


def _spearman(table):
    """Spearman's correlation of every measure with the true ratio."""
    return table.corr(method="spearman")["true_ratio"].drop("true_ratio")


def _right_order(values, truth):
    """Share of the pairs with different truths whose values stand in the same order."""
    from scipy.stats import somersd

    # Somers' D counts (right - wrong) / pairs with different truths
    return (somersd(truth.to_numpy(), values.to_numpy()).statistic + 1) / 2


def costs(*, density, n, rounds=3):
    """Time the measures on one pattern of scan lines.

    Returns
    -------
    DataFrame
        ``measure`` and ``ms``, the fastest of a few rounds on this machine, and ``n`` points.
    """
    size = np.sqrt(n / density)
    xy = point_pattern("scan_lines", density=density, size=size, seed=1, ratio=5, angle=20)
    calls = {
        "f": lambda: spacing(xy),
        f"f over {len(TURN)} turns": lambda: turned_f(xy, angles=TURN),
        "g": lambda: directional_spacing(xy),
        "structure tensor": lambda: structure_tensor_ratio(xy),
        "Ripley's K by direction": lambda: pair_contrast(xy, reach=2 / np.sqrt(density)),
        "Clark-Evans index": lambda: clark_evans(xy),
    }
    best = {name: min(timeit.repeat(call, number=1, repeat=rounds)) for name, call in calls.items()}
    table = pd.DataFrame(best.items(), columns=["measure", "ms"])
    return table.assign(ms=1000 * table["ms"], n=len(xy))


def closed_forms(*, ratios, repeats, density=3000.0, size=1.5, guard=0.2):
    """Compare f with its closed forms on patterns without edges.

    Parameters
    ----------
    ratios : sequence of float
        Across / along, above 5 (where lines along an axis have theirs).
    repeats : int
        Patterns of each kind; their spread gives the standard error.
    size, guard : float
        Width of the window, and of its edge whose points are only neighbours, m.

    Returns
    -------
    DataFrame
        ``pattern``, ``axes``, ``ratio``, ``f_predicted``, ``f_measured``, ``standard_error``,
        ``z`` (difference in standard errors; 0 where it is below 1e-6, what the least noise
        does), ``n`` (patterns).
    """
    rows = []
    for ratio in ratios:
        for kind in CLOSED:
            seen = _interior_f(kind, repeats, density, size, guard, ratio=ratio, angle=25)
            rows.append((kind, "turned by 25°", ratio, expected_f(kind, ratio), seen))
        seen = _interior_f(
            "scan_lines", repeats, density, size, guard, ratio=ratio, noise=LEAST_NOISE
        )
        rows.append(("scan_lines", "along, least noise", ratio, aligned_lines_f(), seen))
    table = pd.DataFrame(rows, columns=["pattern", "axes", "ratio", "f_predicted", "seen"])
    table["f_measured"] = table["seen"].map(np.mean)
    table["standard_error"] = table["seen"].map(lambda seen: np.std(seen, ddof=1) / repeats**0.5)
    off = table["f_measured"] - table["f_predicted"]
    table["z"] = (off / table["standard_error"]).where(off.abs() > EXACT, 0.0)
    return table.drop(columns="seen").assign(n=repeats)


def _interior_f(kind, repeats, density, size, guard, **choices):
    """f of the points away from the edge, for patterns of several seeds."""
    seen = []
    for seed in range(2000, 2000 + repeats):
        xy = point_pattern(kind, density=density, size=size, seed=seed, jitter=0, **choices)
        inside = (np.abs(xy - size / 2) < size / 2 - guard).all(axis=1)
        medians = np.median(quadrant_distances(xy)[inside], axis=0)
        seen.append(medians[3] / medians[0])
    return seen


def turns(clouds, *, step=3.0):
    """Turn the axes about planar clouds.

    Parameters
    ----------
    clouds : dict of str to array, shape (n, 2)
        Metres.
    step : float
        Degrees.

    Returns
    -------
    DataFrame
        ``cloud``, ``angle_deg``, ``f``, and for the whole cloud ``g``, ``direction_deg``, ``n``.
    """
    angles = np.arange(0, 90 + step / 2, step)
    tables = []
    for name, xy in clouds.items():
        found = directional_spacing(xy)
        tables.append(
            pd.DataFrame(
                {
                    "cloud": name,
                    "angle_deg": angles,
                    "f": turned_f(xy, angles=angles),
                    "g": found.g,
                    "direction_deg": found.direction_deg,
                    "n": len(xy),
                    "kind": "measured",
                }
            )
        )
    return pd.concat(tables, ignore_index=True)


def roundings(*, steps_mm, ratio, seeds, density=3000.0, n=1500):
    """Round the coordinates of scan lines and of a random pattern to grids.

    Returns
    -------
    DataFrame
        ``pattern``, ``rounding_mm``, ``seed``, ``f``, ``g``, ``d1_mm``, ``coincident``.
    """
    rows = []
    for kind in ("scan_lines", "poisson"):
        for step in steps_mm:
            for seed in seeds:
                choices = {"ratio": ratio, "angle": 20, "rounding": step / 1000}
                size = np.sqrt(n / density)
                xy = point_pattern(kind, density=density, size=size, seed=seed, **choices)
                gaps = spacing(xy)
                g = directional_spacing(xy).g
                rows.append((kind, step, seed, gaps.f, g, 1000 * gaps.d[0], gaps.coincident))
    names = ["pattern", "rounding_mm", "seed", "f", "g", "d1_mm", "coincident"]
    return pd.DataFrame(rows, columns=names)


def real_clouds():
    """Return real clouds in their planes, without repeated points: dict of name to (n, 2), m.

    The two heads of the road patch, and both; boards where MMQA_DATA has them.
    """
    patch = io.read_cloud(samples.path("road_patch"), columns=["gps_time"])
    times = np.sort(patch["gps_time"])
    pause = np.argmax(np.diff(times))
    first = patch["gps_time"] <= times[pause]
    clouds = {
        "road, head A": patch.points[first],
        "road, head B": patch.points[~first],
        "road, both heads": patch.points,
    }
    for name, relative in BOARDS.items():
        if samples.has_real(relative):
            clouds[name] = io.read_cloud(samples.real_path(relative), columns=()).points
    distinct = {name: np.unique(points, axis=0) for name, points in clouds.items()}
    return {name: fit_plane(points).project(points) for name, points in distinct.items()}
