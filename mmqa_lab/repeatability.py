"""How far quality figures vary when an operator selects the same surface again.

An operator's polygon is a nominal outline whose vertices carry a click error. Selections of one
scan differ in it alone (repeatability), scans of one surface differ too; ISO 5725 and the analysis
of variance separate these parts, and :func:`strip_law` says what to expect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
import pandas as pd
import shapely
from numpy.typing import ArrayLike
from scipy.stats import chi2
from scipy.stats import f as f_distribution

from mmqa_lab._checks import check_count, check_number, check_polygon, check_positive
from mmqa_lab._results import Shown
from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.planes import fit_plane

__all__ = [
    "Repeatability",
    "evaluate_selections",
    "operator_polygons",
    "repeatability",
    "strip_law",
    "variance_components",
]
__dir__ = __all__.copy

STRIP = 0.4579
"""Half of the mean area between two jittered outlines, per perimeter and click error."""

LIMIT = 2.8
"""1.96 sqrt(2): two results differ by less than 2.8 standard deviations in 95 % (ISO 5725-6)."""


def operator_polygons(
    corners: ArrayLike, *, repeats: int, click: float, seed: int, vertices: int = 4
) -> np.ndarray:
    """Draw the polygons of an operator who clicks the same outline again and again.

    Vertices lie evenly on the outline, the corners among them, and get independent normal errors in
    both directions of the plane.

    Parameters
    ----------
    corners : array_like, shape (4, 3)
        The intended outline, in order, metres, such as
        :func:`mmqa_lab.chart_cloud.chart_polygon` gives.
    repeats : int
        Number of polygons.
    click : float
        Standard deviation of a vertex in each direction, m; 1 to 2 cm in a 3-D editor.
    seed : int
    vertices : int
        A multiple of 4; 4 for a quadrilateral, more for a free polygon.

    Returns
    -------
    array, shape (repeats, vertices, 3)
        Metres.

    Raises
    ------
    ValueError
        If a polygon crosses itself because the click error is too large for the outline.

    Examples
    --------
    >>> square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    >>> polygons = operator_polygons(square, repeats=5, click=0.01, seed=1, vertices=8)
    >>> polygons.shape, bool(abs(polygons[:, 1] - [0.5, 0, 0]).max() < 0.05)
    ((5, 8, 3), True)
    """
    corners = check_polygon(corners, name="corners")
    repeats = check_count(repeats, "repeats")
    click = check_number(click, "click", low=0, unit="m")
    if len(corners) != 4 or check_count(vertices, "vertices", low=4) % 4:
        raise ValueError(f"Invalid vertices {vertices}. Must be a multiple of four corners.")
    plane = fit_plane(corners)
    steps = np.arange(vertices // 4)[:, None] * 4 / vertices
    sides = np.roll(corners, -1, axis=0) - corners
    outline = (corners[:, None] + steps * sides[:, None]).reshape(-1, 3)
    errors = click * np.random.default_rng(seed).standard_normal((repeats, vertices, 2))
    polygons = outline + errors @ plane.axes
    valid = shapely.is_valid(shapely.polygons(plane.project(polygons)))
    if not valid.all():
        raise ValueError(
            f"Invalid click {click}: {int((~valid).sum())} of {repeats} polygons cross themselves. "
            "Must be well below the distance of the vertices."
        )
    return polygons


def evaluate_selections(
    points: ArrayLike, polygons: ArrayLike, *, axes: str | float | None = None
) -> pd.DataFrame:
    """Evaluate one cloud with each of many polygons.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Metres.
    polygons : array_like, shape (repeats, vertices, 3)
        Metres.
    axes
        See :func:`mmqa_lab.chart_cloud.evaluate_cloud`.

    Returns
    -------
    DataFrame
        A row per polygon: ``selection`` and the figures of ``CloudQuality.to_frame``.

    Raises
    ------
    ValueError
        As :func:`mmqa_lab.chart_cloud.evaluate_cloud`: too few points in a polygon, and the like.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(50) * 0.02, np.arange(50) * 0.02)
    >>> cloud = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    >>> square = np.array([[0.1, 0.1, 0], [0.9, 0.1, 0], [0.9, 0.9, 0], [0.1, 0.9, 0]]) - 0.01
    >>> evaluate_selections(cloud, [square, square + [0.04, 0, 0]])["n"].tolist()
    [1600, 1600]
    """
    frames = [evaluate_cloud(points, polygon=p, axes=axes).to_frame() for p in polygons]
    table = pd.concat(frames, ignore_index=True)
    return table.rename_axis("selection").reset_index()


@dataclass(frozen=True)
class Repeatability(Shown):
    """Repeatability of one figure, as ISO 5725-2 names its parts.

    Parameters
    ----------
    mean : float
        Mean of all results, in the unit of the figure, like all standard deviations here.
    s_r : float
        Repeatability standard deviation: between selections of the same scan.
    s_l : float
        Standard deviation between scans, beyond what selections explain; 0 where none is seen.
    icc : float
        Intraclass correlation ICC(1,1): share of the variance that lies between scans.
    icc_low, icc_high : float
        Its 95 % interval (F distribution).
    s_r_low, s_r_high : float
        95 % interval of s_r by chi-squared, whose degrees of freedom allow for the kurtosis of the
        selections about their scan's mean.
    groups, n : int
        Scans, and results in all.

    Examples
    --------
    >>> found = Repeatability(100.0, 1.0, 0.0, 0.0, 0.0, 0.2, 0.8, 1.2, groups=4, n=40)
    >>> found.r
    2.8
    """

    mean: float
    s_r: float
    s_l: float
    icc: float
    icc_low: float
    icc_high: float
    s_r_low: float
    s_r_high: float
    groups: int
    n: int

    @property
    def r(self) -> float:
        """Repeatability limit 2.8 s_r."""
        return LIMIT * self.s_r

    def to_frame(self) -> pd.DataFrame:
        """Return one row with all parts, ``r`` and ``relative_s_r_percent`` with its interval."""
        percent = 100 / self.mean
        relative = {
            "relative_s_r_percent": percent * self.s_r,
            "low_percent": percent * self.s_r_low,
            "high_percent": percent * self.s_r_high,
        }
        return pd.DataFrame([asdict(self) | {"r": self.r} | relative])


def repeatability(table: pd.DataFrame, value: str) -> Repeatability:
    """Separate repeatability and the variance between scans.

    One-way analysis of variance of a figure over the scans (ISO 5725-2, section 7.4); unequal
    numbers are allowed.

    Parameters
    ----------
    table : DataFrame
        A row per selection; its column ``scan`` names the scan, all rows are of one without it.
    value : str
        The column of the figure.

    Returns
    -------
    Repeatability
        Between-scan parts are NaN with one scan only.

    Raises
    ------
    ValueError
        If a value is not finite or a scan has fewer than two selections.

    References
    ----------
    ISO 5725-2:2019; Shrout and Fleiss 1979, doi:10.1037/0033-2909.86.2.420 (ICC(1,1), interval).

    Examples
    --------
    >>> table = pd.DataFrame({"scan": [1, 1, 2, 2], "f": [2.0, 2.2, 3.0, 3.2]})
    >>> found = repeatability(table, "f")
    >>> round(found.s_r, 3), round(found.s_l, 3), round(found.icc, 3)
    (0.141, 0.7, 0.961)
    """
    grouped = table.groupby("scan" if "scan" in table else np.zeros(len(table)))[value]
    parts = [rows.to_numpy(dtype=np.float64) for _, rows in grouped]
    if not parts or min(len(part) for part in parts) < 2:
        raise ValueError("Invalid scan: a single selection. Must be two or more of each.")
    if not np.isfinite(np.concatenate(parts)).all():
        raise ValueError(f"Invalid {value}: not finite. Must be measured in every selection.")
    off = np.concatenate([part - part.mean() for part in parts])
    freedom = len(off) - len(parts)
    s_r = float(np.sqrt(off @ off / freedom))
    low, high = s_r * np.sqrt(_chi_squared_ends(off, freedom))
    mean, n = float(np.concatenate(parts).mean()), sum(len(part) for part in parts)
    ends = {"s_r_low": float(low), "s_r_high": float(high), "groups": len(parts), "n": n}
    return Repeatability(mean, s_r, *_between(parts, s_r**2), **ends)


def variance_components(table: pd.DataFrame, value: str, *, factors: Sequence[str]) -> pd.DataFrame:
    """Estimate the variance that each level of a balanced nested design adds.

    Analysis of variance of the logarithms (so that the parts are relative), with every factor
    nested in those before it; a component is the difference of two mean squares over the number of
    results behind one level.

    Parameters
    ----------
    table : DataFrame
        A row per result.
    value : str
        The figure; positive.
    factors : sequence of str
        Columns from the coarsest to the finest, for example system, distance_m, scan.

    Returns
    -------
    DataFrame
        ``factor`` (the last is ``selection``), ``degrees_of_freedom``, ``mean_square``,
        ``variance`` (of the natural logarithm, 0 where the difference is negative), ``share``,
        ``relative_sd`` (1), ``n``.

    Raises
    ------
    ValueError
        If a value is not positive or the design is not balanced.

    Examples
    --------
    >>> table = pd.DataFrame({"scan": [1, 1, 2, 2], "f": [2.0, 2.1, 4.0, 4.2]})
    >>> found = variance_components(table, "f", factors=["scan"])
    >>> found["factor"].tolist(), found["relative_sd"].round(3).tolist()
    (['scan', 'selection'], [0.49, 0.034])
    """
    if not (np.isfinite(table[value]) & (table[value] > 0)).all():
        raise ValueError(f"Invalid {value}: not positive. Must be so in every selection.")
    logs = np.log(table[value])
    nested = [
        logs.groupby([table[name] for name in factors[:k]]) for k in range(1, 1 + len(factors))
    ]
    if any(groups.size().nunique() > 1 for groups in nested):
        raise ValueError("Invalid table: not balanced. Must have as many results in every cell.")
    means = np.array(
        [np.full(len(logs), logs.mean()), *(g.transform("mean") for g in nested), logs]
    )
    counts = np.array([1, *(groups.ngroups for groups in nested), len(logs)])
    freedom = np.diff(counts)
    if min(freedom) < 1:
        raise ValueError(f"Invalid factors {factors}. Must have two levels or more each.")
    squares = (np.diff(means, axis=0) ** 2).sum(axis=1) / freedom
    behind = len(logs) / counts[1:-1]
    variances = np.clip([*(-np.diff(squares) / behind), squares[-1]], 0, None)
    return pd.DataFrame(
        {
            "factor": [*factors, "selection"],
            "degrees_of_freedom": freedom,
            "mean_square": squares,
            "variance": variances,
            "share": variances / variances.sum(),
            "relative_sd": np.sqrt(variances),
            "n": len(logs),
        }
    )


def _chi_squared_ends(off, freedom):
    """Ends of the 95 % interval of a variance over its estimate (Bonett 2006)."""
    variance = (off**2).mean()
    excess = (off**4).mean() / variance**2 - 3 if variance > 0 else 0.0
    # a small sample understates its kurtosis, so at least that of normal values is taken
    freedom = 2 / (2 / freedom + max(excess, 0) / len(off))
    return freedom / chi2.ppf([0.975, 0.025], freedom)


def _between(parts, within):
    """Standard deviation between groups, ICC(1,1) and its interval; NaN for a single group."""
    groups, sizes = len(parts), np.array([len(part) for part in parts])
    if groups < 2:
        return (np.nan,) * 4
    n, means = sizes.sum(), np.array([part.mean() for part in parts])
    typical = (n - (sizes**2).sum() / n) / (groups - 1)
    between = (sizes * (means - sizes @ means / n) ** 2).sum() / (groups - 1)
    s_l = float(np.sqrt(max(between - within, 0.0) / typical))
    if within == 0:
        return s_l, np.nan, np.nan, np.nan
    ratio, freedom = between / within, (groups - 1, n - groups)
    low, high = f_distribution.ppf(0.975, *freedom), f_distribution.ppf(0.975, *freedom[::-1])
    shares = ((x - 1) / (x + typical - 1) for x in (ratio, ratio / low, ratio * high))
    return s_l, *map(float, shares)


def strip_law(*, density: float, area: float, click: float) -> float:
    """Predicted relative s_r of the density when square selections of one random pattern vary.

    Two selections share all points but those in the strip between their outlines, whose mean area
    is 0.916 P click for the perimeter P. The density changes by the chance in these points:
    s_r / value = sqrt(0.458 P click / density) / area, with P = 4 sqrt(area). So it falls with
    area^(-3/4) and density^(-1/2), not with the number of points alone.

    Parameters
    ----------
    density : float
        Points per square metre.
    area : float
        Of the selection, square metres.
    click : float
        Standard deviation of a vertex in each direction, m.

    Returns
    -------
    float

    Raises
    ------
    ValueError
        If density or area is not above zero or ``click`` is negative.

    Notes
    -----
    For a Poisson pattern; points on scan lines come in whole lines and vary otherwise. Figures
    other than the density vary by the influence of one point on them times as much: sqrt(1/2) for
    std, 1.166 for sigma_MAD of normal residuals (asymptotic).

    Examples
    --------
    >>> round(100 * strip_law(density=1712, area=0.5, click=0.015), 2)
    0.67
    """
    density = check_positive(density, "density", unit="points per m2")
    area = check_positive(area, "area", unit="m2")
    click = check_number(click, "click", low=0, unit="m")
    return float(np.sqrt(STRIP * 4 * np.sqrt(area) * click / density) / area)
