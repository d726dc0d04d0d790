"""Variation of quality figures when an operator selects the same surface again.

An operator's polygon is a nominal outline whose vertices have a click error. Selections of the same
scan differ by this error alone (repeatability). Scans of the same surface differ too. The analysis
of variance separates the two parts (ISO 5725). :func:`strip_law` predicts the first part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.stats import chi2

from mmqa_lab._checks import (
    check_columns,
    check_count,
    check_number,
    check_polygon,
    check_positive,
    refuse,
)
from mmqa_lab._results import Shown
from mmqa_lab._streams import stream
from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.planes import fit_plane

__all__ = [
    "Repeatability", "evaluate_selections", "operator_polygons", "repeatability", "strip_law",
    "variance_components",
]  # fmt: skip
__dir__ = __all__.copy

STRIP = 0.4579
"""Half of the mean area between two outlines with click errors, per perimeter and error."""

LIMIT = 2.8
"""1.96 sqrt(2): two results differ by less than 2.8 s_r in 95 % of cases (ISO 5725-6)."""


def operator_polygons(
    corners: ArrayLike, *, repeats: int, click: float, seed: int, vertices: int = 4
) -> np.ndarray:
    """Draw the polygons of an operator who clicks the same outline again and again.

    Vertices are spaced evenly along each side and include the corners. They get independent normal
    errors in both directions of the plane.

    Parameters
    ----------
    corners : array_like, shape (4, 3)
        Corners of the intended outline in order, m, for example from
        :func:`mmqa_lab.chart_cloud.chart_polygon`.
    repeats : int
        Number of polygons.
    click : float
        Standard deviation of a vertex in each direction, m. In a 3-D editor it is 1 to 2 cm.
    seed : int
        Seed of the random errors.
    vertices : int
        Number of vertices, a multiple of 4: 4 for a quadrilateral, more for a free polygon.

    Returns
    -------
    array, shape (repeats, vertices, 3)
        Vertices of the polygons, m.

    Raises
    ------
    ValueError
        If there are not four corners, or if ``vertices`` is not a multiple of 4.

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
    if len(corners) != 4:
        raise ValueError(f"Invalid corners: {len(corners)} given. Must be four.")
    if check_count(vertices, "vertices", low=4) % 4:
        raise ValueError(f"Invalid vertices {vertices}. Must be a multiple of four corners.")
    plane = fit_plane(corners)
    steps = np.arange(vertices // 4)[:, None] * 4 / vertices
    sides = np.roll(corners, -1, axis=0) - corners
    outline = (corners[:, None] + steps * sides[:, None]).reshape(-1, 3)
    errors = click * stream(seed, "operator_polygons").standard_normal((repeats, vertices, 2))
    return outline + errors @ plane.axes


def evaluate_selections(
    points: ArrayLike,
    polygons: Sequence[ArrayLike] | np.ndarray,
    *,
    axes: str | float | None = None,
) -> pd.DataFrame:
    """Evaluate the selection of each polygon in the same cloud.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        The cloud, m.
    polygons : array_like, shape (repeats, vertices, 3)
        Vertices of the polygons, m.
    axes
        See :func:`mmqa_lab.chart_cloud.evaluate_cloud`.

    Returns
    -------
    DataFrame
        A row per polygon: ``selection`` and the figures of ``CloudQuality.to_frame``.

    Raises
    ------
    ValueError
        If there is no polygon, or one cannot be evaluated, for example because it contains too
        few points.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(50) * 0.02, np.arange(50) * 0.02)
    >>> cloud = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    >>> square = np.array([[0.1, 0.1, 0], [0.9, 0.1, 0], [0.9, 0.9, 0], [0.1, 0.9, 0]]) - 0.01
    >>> evaluate_selections(cloud, [square, square + [0.04, 0, 0]])["n"].tolist()
    [1600, 1600]
    """
    refuse(not len(polygons), "polygons", "none given", "one or more")
    frames = [evaluate_cloud(points, polygon=p, axes=axes).to_frame() for p in polygons]
    table = pd.concat(frames, ignore_index=True)
    return table.rename_axis("selection").reset_index()


@dataclass(frozen=True)
class Repeatability(Shown):
    """Repeatability of a figure, with the symbols of ISO 5725-2.

    Parameters
    ----------
    mean : float
        Mean of all results. The mean and the standard deviations have the unit of the figure.
    s_r : float
        Repeatability standard deviation, between selections of the same scan.
    s_l : float
        Standard deviation between scans without the part of the selections; at least 0.
    icc : float
        Intraclass correlation ICC(1,1), the share of the variance between scans.
    s_r_low, s_r_high : float
        95 % confidence interval of s_r (chi-squared distribution). The degrees of freedom allow for
        the kurtosis of the selections about the mean of their scan.
    groups, n : int
        Number of scans, and number of all results.

    Examples
    --------
    >>> found = Repeatability(100.0, 1.0, 0.0, 0.0, 0.8, 1.2, groups=4, n=40)
    >>> found.r
    2.8
    """

    mean: float
    s_r: float
    s_l: float
    icc: float
    s_r_low: float
    s_r_high: float
    groups: int
    n: int

    @property
    def r(self) -> float:
        """Repeatability limit 2.8 s_r."""
        return LIMIT * self.s_r

    def _ends(self):
        return [("s_r", self.s_r, self.s_r_low, self.s_r_high, "as the figure")]

    def to_frame(self) -> pd.DataFrame:
        """Return a row with all fields, ``r``, and ``relative_s_r_percent`` with its interval."""
        percent = 100 / abs(self.mean) if self.mean else np.nan
        relative = {
            "relative_s_r_percent": percent * self.s_r,
            "low_percent": percent * self.s_r_low,
            "high_percent": percent * self.s_r_high,
        }
        return pd.DataFrame([asdict(self) | {"r": self.r} | relative])


def repeatability(table: pd.DataFrame, value: str) -> Repeatability:
    """Separate repeatability and the variance between scans.

    This is the one-way analysis of variance of a figure over the scans (ISO 5725-2, section 7.4).
    The numbers of selections may differ between scans.

    Parameters
    ----------
    table : DataFrame
        A row per selection. The column ``scan`` names the scan. Without this column all selections
        belong to the same scan.
    value : str
        The column of the figure.

    Returns
    -------
    Repeatability
        The parts between scans are NaN for a single scan.

    Raises
    ------
    ValueError
        If the table lacks the figure, a value is not finite, or a scan has fewer than two
        selections.

    References
    ----------
    ISO 5725-2:2019; Shrout and Fleiss 1979, doi:10.1037/0033-2909.86.2.420 (ICC(1,1)).

    Examples
    --------
    >>> table = pd.DataFrame({"scan": [1, 1, 2, 2], "f": [2.0, 2.2, 3.0, 3.2]})
    >>> found = repeatability(table, "f")
    >>> round(found.s_r, 3), round(found.s_l, 3), round(found.icc, 3)
    (0.141, 0.7, 0.961)
    """
    check_columns(table, [value], "table")
    _check_named(table, ["scan"] if "scan" in table else [])
    grouped = table.groupby("scan" if "scan" in table else np.zeros(len(table)))[value]
    parts = [rows.to_numpy(dtype=np.float64) for _, rows in grouped]
    if not parts or min(len(part) for part in parts) < 2:
        raise ValueError("Invalid scan: a single selection. Must be two or more of each.")
    if not np.isfinite(np.concatenate(parts)).all():
        raise ValueError(f"Invalid {value}: not finite. Must be measured in every selection.")
    off = np.concatenate([part - part.mean() for part in parts])
    freedom = len(off) - len(parts)
    s_r = float(np.sqrt(off @ off / freedom))
    low, high = (s_r * np.sqrt(_chi_squared_ends(off, freedom))).tolist()
    mean, n = float(np.concatenate(parts).mean()), sum(len(part) for part in parts)
    s_l, icc = _between(parts, s_r**2)
    return Repeatability(mean, s_r, s_l, icc, low, high, len(parts), n)


def variance_components(table: pd.DataFrame, value: str, *, factors: Sequence[str]) -> pd.DataFrame:
    """Estimate the variance component of each level of a balanced nested design.

    The analysis of variance uses logarithms, so the components are relative. Every factor is nested
    in the factors before it. A component is the difference of two mean squares over the number of
    results per level.

    Parameters
    ----------
    table : DataFrame
        A row per result.
    value : str
        The column of the figure, with positive values.
    factors : sequence of str
        The columns of the factors from the coarsest to the finest, for example system, distance_m,
        scan.

    Returns
    -------
    DataFrame
        ``factor`` (the last is ``selection``), ``variance`` (of the natural logarithm, 0 if the
        difference is negative), ``share``, ``relative_sd`` (1), ``n`` (results).

    Raises
    ------
    ValueError
        If the table lacks a column, a value is not positive, the design is not balanced, or a
        factor has a single level.

    Examples
    --------
    >>> table = pd.DataFrame({"scan": [1, 1, 2, 2], "f": [2.0, 2.1, 4.0, 4.2]})
    >>> found = variance_components(table, "f", factors=["scan"])
    >>> found["factor"].tolist(), found["relative_sd"].round(3).tolist()
    (['scan', 'selection'], [0.49, 0.034])
    """
    check_columns(table, [value, *factors], "table")
    _check_named(table, factors)
    if not (np.isfinite(table[value]) & (table[value] > 0)).all():
        raise ValueError(f"Invalid {value}: not positive. Must be positive in every selection.")
    logs = np.log(table[value])
    cells = [logs.groupby([table[name] for name in factors[: k + 1]]) for k in range(len(factors))]
    if any(groups.size().nunique() > 1 for groups in cells):
        raise ValueError("Invalid table: not balanced. Must have equal counts in every cell.")
    levels = [np.full(len(logs), logs.mean()), *(g.transform("mean") for g in cells), logs]
    counts = np.array([1, *(groups.ngroups for groups in cells), len(logs)])
    if min(np.diff(counts)) < 1:
        raise ValueError(f"Invalid factors {factors}. Must have at least two levels each.")
    squares = (np.diff(levels, axis=0) ** 2).sum(axis=1) / np.diff(counts)
    behind = len(logs) / counts[1:-1]
    variances = np.clip([*(-np.diff(squares) / behind), squares[-1]], 0, None)
    found = {"factor": [*factors, "selection"], "variance": variances}
    found |= {"share": variances / variances.sum(), "relative_sd": np.sqrt(variances)}
    return pd.DataFrame(found | {"n": len(logs)})


def _check_named(table, columns):
    """Refuse rows that do not say which scan, or which level of a factor, they belong to."""
    for name in columns:
        if table[name].isna().any():
            row = int(np.argmax(table[name].isna()))
            raise ValueError(f"Invalid {name} in row {row}: none. Must be named in every row.")


def _chi_squared_ends(off, freedom):
    """Limits of the 95 % interval of a variance over its estimate (Bonett 2006)."""
    variance = (off**2).mean()
    excess = (off**4).mean() / variance**2 - 3 if variance > 0 else 0.0
    # a small sample understates its kurtosis, so normal kurtosis is the minimum
    freedom = 2 / (2 / freedom + max(excess, 0) / len(off))
    return freedom / chi2.ppf([0.975, 0.025], freedom)


def _between(parts, within):
    """Standard deviation between groups and ICC(1,1); NaN for a single group."""
    groups, sizes = len(parts), np.array([len(part) for part in parts])
    if groups < 2:
        return np.nan, np.nan
    n, means = sizes.sum(), np.array([part.mean() for part in parts])
    typical = (n - (sizes**2).sum() / n) / (groups - 1)
    between = (sizes * (means - sizes @ means / n) ** 2).sum() / (groups - 1)
    excess = (between - within) / typical
    total = excess + within
    return float(np.sqrt(max(excess, 0.0))), float(excess / total) if total else np.nan


def strip_law(*, density: float, area: float, click: float) -> float:
    """Return the predicted relative s_r of the density for square selections of a random pattern.

    Two selections share all points except the points in the strip between their outlines. The mean
    area of this strip is 0.916 P click for the perimeter P. The density varies with the random
    number of points in the strip: s_r / value = sqrt(0.458 P click / density) / area, with
    P = 4 sqrt(area). The prediction falls with area^(-3/4) and density^(-1/2), not with the number
    of points alone.

    Parameters
    ----------
    density : float
        Points per m2.
    area : float
        Area of the selection, m2.
    click : float
        Standard deviation of a vertex in each direction, m.

    Returns
    -------
    float
        s_r over the density, as a share.

    Raises
    ------
    ValueError
        If density or area is not above zero, or if ``click`` is negative.

    Notes
    -----
    The law holds for a Poisson pattern. Points on scan lines enter a selection as whole lines and
    vary differently. For other figures the prediction is multiplied by the influence of a point on
    the figure: sqrt(1/2) for std and 1.166 for sigma_MAD, for normal residuals (asymptotic).

    Examples
    --------
    >>> round(100 * strip_law(density=1712, area=0.5, click=0.015), 2)
    0.67
    """
    density = check_positive(density, "density", unit="points per m2")
    area = check_positive(area, "area", unit="m2")
    click = check_number(click, "click", low=0, unit="m")
    return float(np.sqrt(STRIP * 4 * np.sqrt(area) * click / density) / area)
