"""What f = d4/d1 measures: patterns of known anisotropy, other measures, rules, real clouds."""

import numpy as np
import pandas as pd
from scipy.spatial import ConvexHull, cKDTree

from mmqa_lab import bench, io, plots, samples
from mmqa_lab.planes import fit_plane
from mmqa_lab.published import number
from mmqa_lab.simulate.point_patterns import (
    KINDS,
    aligned_lines_f,
    expected_f,
    point_pattern,
    true_ratio,
)
from mmqa_lab.spacing import directional, quadrant_distances, quadrants, turned_f
from mmqa_lab.studies import SMALL, stated

QUICK = SMALL["anisotropy"]

F0 = float(number("pfeifer2021", "f_threshold")["value"])
"""Section 3.3 gives it as an example of a threshold."""

TURN = tuple(range(0, 90, 15))
"""Turns of the axes for the smallest and largest f."""

CLOSED = ("lattice", "hexagonal", "scan_lines", "poisson")
"""Patterns whose f is known in closed form."""

LEAST_NOISE, EXACT = 1e-10, 1e-6
"""Metres of noise that decide on which side of an axis a point lies and nothing else."""

BOARDS = {"board, VLP-16": "boards/vlp16_pose02.laz", "board, 64 rings": "boards/os64_pose02.laz"}

COLOURS = dict(zip(KINDS, plots.COLOURS, strict=False)) | {"holes": "grey"}
"""A colour of :mod:`mmqa_lab.plots` for each pattern."""


def g_at_axes(xy):
    """Directional spacing across over along, at the given axes instead of the direction found."""
    found = directional(xy)
    ratio = found.at(90) / found.at(0)
    return max(ratio, 1 / ratio)


def structure_tensor(xy):
    """Median of sqrt(largest / smallest eigenvalue) of the scatter of the 16 nearest points.

    Random neighbourhoods are longer than wide: a Poisson pattern has about 1.5. On lines
    the nearest points are all on one line and the ratio is infinite.
    """
    near = cKDTree(xy).query(xy, k=min(17, len(xy)))[1][:, 1:]
    offsets = xy[near] - xy[:, None]
    scatter = np.einsum("nki,nkj->nij", offsets, offsets)
    smallest, largest = np.clip(np.linalg.eigvalsh(scatter), 0, None).T
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.median(np.sqrt(largest / smallest)))


def pair_contrast(xy):
    """Contrast of Ripley's K between the directions with most and fewest pairs: 0 none, 1 all.

    Of the pairs up to twice the linear point distance apart, N lie within 45 degrees of
    the direction of their second harmonic and M at a right angle to it: (N - M) / (N + M). Illian
    et al. 2008, section 4.5, doi:10.1002/9780470725160.
    """
    reach = 2 * np.sqrt(np.prod(np.ptp(xy, axis=0)) / len(xy))
    first, second = cKDTree(xy).query_pairs(reach, output_type="ndarray").T
    if not len(first):
        return np.nan
    angle = np.arctan2(*(xy[second] - xy[first]).T[::-1])
    mean = np.angle(np.exp(2j * angle).sum()) / 2
    return float(np.mean(np.where(np.cos(2 * (angle - mean)) > 0, 1.0, -1.0)))


def clark_evans(xy):
    """Clark and Evans's index: mean nearest distance over that of a random pattern.

    2.149 on a hexagonal lattice, 1 at random, less for clusters; with Donnelly's correction for the
    edges of the hull. It knows no direction. Ecology 35 (1954), doi:10.2307/1931034.
    """
    nearest = cKDTree(xy).query(xy, k=2)[0][:, 1]
    hull = ConvexHull(xy - xy.mean(axis=0))
    n, area, outline = len(xy), hull.volume, hull.area
    expected = 0.5 * np.sqrt(area / n) + (0.0514 + 0.041 / np.sqrt(n)) * outline / n
    return float(nearest.mean() / expected)


def f_over_turn(xy):
    """f at every turn of TURN; the last points are kept, as the bench hands each method a copy."""
    key = xy.tobytes()
    if key not in _OVER_TURN:
        _OVER_TURN.clear()
        _OVER_TURN[key] = turned_f(xy, angles=TURN)
    return _OVER_TURN[key]


_OVER_TURN = {}

PEERS = {
    "f, smallest over a turn": lambda xy: f_over_turn(xy).min(),
    "f, largest over a turn": lambda xy: f_over_turn(xy).max(),
    "g at the given axes": g_at_axes,
    "structure tensor": structure_tensor,
    "Ripley's K by direction": pair_contrast,
    "Clark-Evans index": clark_evans,
}
"""Measures beside f and g."""

METHODS = {"f": lambda xy: quadrants(xy).f, "g": lambda xy: directional(xy).g, **PEERS}


def pattern(kind, stretch, *, angle, n, noise_mm, seed, density=3000.0):
    """A point pattern of n points on average, and its true ratio across / along."""
    choices = {"ratio": stretch, "angle": angle, "noise": noise_mm / 1000}
    xy = point_pattern(kind, density=density, size=np.sqrt(n / density), seed=seed, **choices)
    return xy, {"ratio": true_ratio(kind, stretch)}


def comparison(quick=False):
    """Compare measures of anisotropy on patterns of known ratio.

    Returns
    -------
    Comparison
        Every method is a function of points in the plane, shape (n, 2), m.
    """
    stretches = QUICK["stretches"] if quick else (1, 2, 3, 5, 10, 20)
    n = QUICK["counts"] if quick else (300, 1500)
    cases = {"kind": KINDS, "stretch": stretches, "angle": (0, 30), "n": n, "noise_mm": (0.5, 3)}
    seeds = QUICK["seeds"] if quick else (1000, 1001, 1002, 1003)
    return bench.Comparison(
        bench.grid(**cases),
        dict(METHODS),
        pattern,
        seeds=seeds,
        tables=lambda results: {"rank_correlations": bench.rank(results, truth="ratio")},
        figures=lambda results: {"rank_correlations": draw_ranking(results)},
    )


def draw_ranking(results):
    """Draw the rank correlations of all methods with the true ratio and their intervals."""
    ranks = bench.rank(results, truth="ratio")[::-1]
    figure, ax = plots.subplots(height_mm=60)
    places = np.arange(len(ranks))
    ax.hlines(places, ranks["low"], ranks["high"], color=plots.COLOURS["grey"])
    ax.plot(ranks["spearman"], places, "o", color=plots.COLOURS["blue"])
    ax.set_yticks(places, ranks["method"])
    ax.set(xlabel="rank correlation with the true ratio", xlim=(-1, 1))
    return figure


def closed_forms(*, stretches, repeats, density=3000.0, size=1.5, guard=0.2):
    """Compare f with its closed forms on patterns without edges.

    Parameters
    ----------
    stretches : sequence of float
        Across / along, above 5 (where lines along an axis have their closed form).
    repeats : int
        Patterns of each kind; their spread gives the standard error.
    density : float
        Points per square metre.
    size, guard : float
        Width of the window, and of its edge whose points are only neighbours, m.

    Returns
    -------
    DataFrame
        ``pattern``, ``axes``, ``stretch``, ``f_predicted``, ``f_measured``, ``standard_error``,
        ``z`` (difference in standard errors; 0 where it is below 1e-6, what the least noise
        does), ``n`` (patterns).
    """
    rows = []
    for ratio in stretches:
        cases = [(kind, "turned by 25°", expected_f(kind, ratio), 25, 0.0) for kind in CLOSED]
        cases.append(("scan_lines", "along, least noise", aligned_lines_f(), 0, LEAST_NOISE))
        for kind, axes, predicted, angle, noise in cases:
            choices = {"density": density, "size": size, "ratio": ratio, "angle": angle}
            choices |= {"jitter": 0, "noise": noise}
            windows = (point_pattern(kind, seed=2000 + k, **choices) for k in range(repeats))
            seen = np.array([_interior_f(xy, guard) for xy in windows])
            error = seen.std(ddof=1) / np.sqrt(repeats)
            off = seen.mean() - predicted
            z = off / error if abs(off) > EXACT else 0.0
            rows.append((kind, axes, ratio, predicted, seen.mean(), error, z, repeats))
    names = ["pattern", "axes", "stretch", "f_predicted", "f_measured", "standard_error", "z", "n"]
    return pd.DataFrame(rows, columns=names)


def _interior_f(xy, guard):
    """f of the points away from the edge of their window."""
    low, high = xy.min(axis=0) + guard, xy.max(axis=0) - guard
    inside = ((xy > low) & (xy < high)).all(axis=1)
    medians = np.median(quadrant_distances(xy)[inside], axis=0)
    return medians[3] / medians[0]


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
        found = directional(xy)
        table = pd.DataFrame({"cloud": name, "angle_deg": angles, "f": turned_f(xy, angles=angles)})
        about = {"g": found.g, "direction_deg": found.direction_deg, "n": len(xy)}
        tables.append(table.assign(**about))
    return pd.concat(tables, ignore_index=True).assign(kind="measured")


def draw_turn(turned, *, ax):
    """Draw f over the turn of the axes, a line per cloud, and g in the margin."""
    colours = iter(plots.COLOURS.values())
    for name, rows in turned.groupby("cloud", sort=False):
        (line,) = ax.plot(rows["angle_deg"], rows["f"], color=next(colours), label=name)
        ax.plot(93, rows["g"].iloc[0], "<", ms=5, color=line.get_color(), clip_on=False)
    look = {"color": plots.COLOURS["grey"], "lw": 0.8}
    ax.axhline(expected_f("poisson", 1), ls="--", label="random, closed form", **look)
    ax.axhline(F0, ls=":", label="threshold f0", **look)
    ax.set(xlabel="axes turned by (degrees)", ylabel="f (lines), g (triangles)", xlim=(0, 95))
    ax.set(xticks=range(0, 91, 15), ylim=(0, None))
    return ax


def real_clouds():
    """Return real clouds in their planes, without repeated points: dict of name to (n, 2), m.

    The two heads of the road patch, and both; boards where MMQA_DATA has them.
    """
    clouds = {f"road, {name}": points for name, points in samples.road_patch_heads().items()}
    for name, relative in BOARDS.items():
        if samples.has_real(relative):
            clouds[name] = io.read_cloud(samples.real_path(relative), columns=()).points
    distinct = {name: np.unique(points, axis=0) for name, points in clouds.items()}
    return {name: fit_plane(points).project(points) for name, points in distinct.items()}


check = stated("anisotropy")


def checks(*, results, forms, lines, verdicts, real):
    """Compare what the notebook says with this run.

    Parameters
    ----------
    results, verdicts : Dataset
        Of :func:`mmqa_lab.bench.run`: measures of patterns, and rules that accept them.
    forms, lines, real : DataFrame
        Of :func:`closed_forms`, and :func:`turns` of simulated lines and of real clouds.

    Yields
    ------
    mmqa_lab.run.Check
    """
    yield check(
        "closed_forms",
        (forms["z"].abs() < 3).all(),
        f"|z| up to {forms['z'].abs().max():.1f} in {len(forms)} cases",
    )
    noisy = lines.query("cloud == 'noise 0.5 mm'").set_index("angle_deg")["f"]
    yield check(
        "along_lines",
        noisy.loc[0] < 0.7 * noisy.max() and noisy.loc[0] < 1.5 * aligned_lines_f(),
        f"f = {noisy.loc[0]:.1f} along the lines, {noisy.max():.1f} off them",
    )
    f = results["value"].sel({"method": "f"})
    uneven = float(f.sel(kind=["gradient", "holes"]).mean() / f.sel(kind="poisson").mean())
    yield check(
        "blind_to_gradients",
        abs(uneven - 1) < 0.15,
        f"f is {uneven:.2f} times that of homogeneous random patterns",
    )
    pair = bench.rank(results.sel({"method": ["f", "g"]}), truth="ratio")
    best, other = pair.to_dict("records")
    yield check(
        "g_orders_better",
        best["method"] == "g" and other["behind_low"] > 0,
        f"rank correlation {best['spearman']:.2f} of {best['method']} against "
        f"{other['spearman']:.2f}, which is behind by {other['behind_low']:.2f} or more",
    )
    right = bench.compare(verdicts, "right", reference="f < 2", better="higher", over="cases")
    right = right.set_index("method")
    yield check(
        "exemption",
        right.loc["f < 2 or exempt", "low"] > 0,
        f"right in {100 * right.loc['f < 2 or exempt', 'difference']:.0f} % more of the cases; "
        f"g < 2 in {100 * right.loc['g < 2', 'difference']:.0f} % more",
    )
    found = real.groupby("cloud")["f"].agg(["min", "max"])
    heads, both = found.loc[["road, head A", "road, head B"]], found.loc["road, both heads"]
    yield check(
        "two_heads",
        both["max"] < heads["min"].min(),
        f"both {both['min']:.1f} to {both['max']:.1f}, each {heads['min'].min():.1f} or more",
    )


def answer(ranks, verdicts):
    """The study's answer in two sentences."""
    found = ranks.set_index("method")["spearman"]
    right = verdicts["right"].mean([d for d in verdicts["right"].dims if d != "method"])
    names = ("f < 2", "f < 2 or exempt", "g < 2")
    plain, exempted, by_g = (100 * float(right.sel({"method": name})) for name in names)
    return (
        "The rank correlation with the true anisotropy is "
        f"{found['f']:.2f} for f, which depends on its axes, and {found['g']:.2f} for g, the "
        f"spacing across over along. f < 2 judges {plain:.0f} % of the simulated clouds rightly, "
        f"with the exemption of dense ones {exempted:.0f} %, and g < 2 {by_g:.0f} %."
    )
