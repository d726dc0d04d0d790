"""The spacing of points by direction, its ratio g, and the parts of scan lines.

The *spacing ratio* g is the spacing across the direction in which points lie closest, divided by
the spacing along that direction.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab import stats
from mmqa_lab._checks import check_plan, check_positive
from mmqa_lab._results import Shown
from mmqa_lab.planes import flat_points
from mmqa_lab.spacing.neighbours import STEP_DEG, by_direction, nearest_by_sector, tree_of

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

__all__ = ["FEWEST_POINTS", "DirectionalSpacing", "block_numbers", "directional", "line_parts"]

MOST_DIRECTED = 100_000
"""Most points whose spacing by direction is measured; with more points, a random choice of them."""

CHANCE = 3.2
"""95 % of random patterns of n points have a g below 1 + CHANCE / sqrt(n)."""

FEWEST_POINTS = 50
"""Least number of points for an interval."""


@dataclass(frozen=True, eq=False)
class DirectionalSpacing(Shown):
    """The spacing of a pattern by direction.

    Parameters
    ----------
    directions_deg : array, shape (45,)
        0, 4, ..., 176 degrees counter-clockwise from the first axis.
    spacing : array, shape (45,)
        Median distance to the nearest other point near the direction or its opposite, in the unit
        of the coordinates; NaN if fewer than half of the points have such a neighbour.
    xy : array, shape (n, 2)
        The points measured from: all without repeated places, at most 100,000.
    nearest : array, shape (n, 45)
        Distance of each point to the nearest other point by direction; infinite without neighbour.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(60) * 0.01, np.arange(15) * 0.04)
    >>> found = directional(np.stack([x.ravel(), y.ravel()], axis=1))
    >>> round(found.along, 3), round(found.across, 3), round(found.g, 3)
    (0.01, 0.04, 4.0)
    """

    directions_deg: np.ndarray
    spacing: np.ndarray
    xy: np.ndarray = field(repr=False)
    nearest: np.ndarray = field(repr=False)

    @property
    def n(self) -> int:
        """Number of points measured from."""
        return len(self.xy)

    @cached_property
    def direction_deg(self) -> float:
        """Direction in which points lie closest, along the scan lines, 0 to 180 degrees.

        It is the phase of the second harmonic of log spacing, which uses all directions.
        """
        known = np.isfinite(self.spacing)
        largest = self.spacing[known].max(initial=0) or 1.0
        wave = np.exp(2j * np.radians(self.directions_deg))
        phase = np.angle(-np.log(np.where(known, self.spacing, 2 * largest)) @ wave)
        return float(np.degrees(phase) / 2 % 180)

    @property
    def along(self) -> float:
        """Spacing along ``direction_deg``, in the unit of the coordinates."""
        return self.at(self.direction_deg)

    @property
    def across(self) -> float:
        """Spacing at a right angle to ``direction_deg``; NaN if not measurable."""
        return self.at(self.direction_deg + 90)

    @property
    def g(self) -> float:
        """Spacing ratio across / along, independent of the axes; 1 without a direction."""
        return self.across / self.along

    @cached_property
    def _bounds(self):
        """95 % confidence intervals of along, across and g, shape (3, 2)."""
        block = line_parts(self.xy, self)
        places = (self.direction_deg + np.array([0, 90])) / STEP_DEG
        along, across = self.nearest[:, places.round().astype(int) % len(self.directions_deg)].T
        ends = [stats.median_interval(distances, block) for distances in (along, across)]
        found = np.array([*ends, stats.median_ratio_interval(across, along, block)])
        return np.where(np.isfinite(found), found, np.nan)

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """Draw the spacing (mm) over the direction, and the direction that was found."""
        from mmqa_lab import plots

        ax = plots.subplots()[1] if ax is None else ax
        ax.plot(self.directions_deg, 1000 * self.spacing)
        ax.axvline(self.direction_deg, color="0.5", ls=":")
        ax.set(xlabel="direction (degrees)", ylabel="spacing (mm)", ylim=(0, None))
        return ax

    def intervals(self) -> pd.DataFrame:
        """Return rows for along, across (mm) and g: value, 95 % interval, direction, n.

        The intervals hold for the direction found, and come from :func:`line_parts`.
        """
        values = [self.along, self.across, self.g]
        table = table_of(["along", "across", "g"], values, self._bounds)
        return table.assign(direction_deg=self.direction_deg, n=self.n)

    to_frame = intervals

    def at(self, direction: float) -> float:
        """Spacing in a direction (degrees), interpolated between the directions tried."""
        return float(np.interp(direction, self.directions_deg, self.spacing, period=180))


def directional(xy: ArrayLike, *, radius: float = 0.5) -> DirectionalSpacing:
    """Return the median distance to the nearest point near each direction.

    Directions are 4 degrees apart. For each direction and each point the nearest other point within
    30 degrees of the direction or its opposite is found; the spacing is the median over the points.
    Unlike the quadrants of f, the sectors turn with the direction, and their distances are not
    sorted.

    Parameters
    ----------
    xy : array_like of shape (n, 2), or points in space (laid onto their regression plane)
        Coordinates in the plane, metres; n >= 2.
    radius : float
        Neighbours up to this far count, m.

    Returns
    -------
    DirectionalSpacing
        With ``g``, ``direction_deg`` and the spacing by direction.

    Raises
    ------
    ValueError
        If there are fewer than two points or an argument is invalid.

    See Also
    --------
    quadrants : the published figures d1..d4 and f, in one system of axes.
    empty_space : the largest gaps, in whatever direction.

    Notes
    -----
    Since the direction is chosen from the pattern, random patterns of n points have a mean g of
    1 + 1.6 / sqrt(n). In 95 % of such patterns g is below 1 + 3.2 / sqrt(n) (simulated, n = 200 to
    10,000). The direction is accurate to about 2 degrees. Repeated points are counted once. Of more
    than 100,000 points a random choice of this number is measured, with all as neighbours. On scan
    lines blurred by more than their point spacing, the nearest point across lies on the same line.
    g then falls towards 1, since the pattern has no direction at that scale. Elongated clusters
    have their direction along their length.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(40) * 0.01, np.arange(10) * 0.04)
    >>> found = directional(np.stack([x.ravel(), y.ravel()], axis=1))
    >>> round(found.g, 3), round(abs(found.direction_deg - 90), 1)
    (4.0, 90.0)
    """
    xy = flat_points(xy, minimum=2)
    radius = check_positive(radius, "radius", unit="m")
    local = np.ascontiguousarray(xy - xy.mean(axis=0)).view(np.complex128)
    local = np.sort(local, axis=0)  # by x, then by y
    xy = local[np.append(True, local[1:] != local[:-1])].view(np.float64)
    directions = np.arange(0, 180, STEP_DEG)
    extent = np.ptp(xy, axis=0)
    limit = 3 * max(np.sqrt(np.prod(extent) / len(xy)), extent.max() / len(xy), 1e-9)
    rows = np.sort(np.random.default_rng(0).permutation(len(xy))[:MOST_DIRECTED])
    medians, reach, tree = np.array(np.inf), 16, tree_of(xy)
    while np.isinf(medians).any():  # points beyond the medians cannot change them
        limit = min(limit, radius)
        nearest = nearest_by_sector(xy, tree, rows, limit, reach, len(directions), by_direction)
        # faster than a median
        middle = np.sort(nearest.T)[:, [(len(rows) - 1) // 2, len(rows) // 2]]
        medians = middle.mean(axis=1)
        if limit == radius:
            break
        limit, reach = 2 * limit, 4 * reach
    spacing = np.where(np.isinf(medians), np.nan, medians)
    return DirectionalSpacing(directions, spacing, xy[rows], nearest)


def block_numbers(xy: ArrayLike, *, side: int = 4) -> np.ndarray:
    """Number the points by the square blocks of a grid over them.

    Parameters
    ----------
    xy : array_like, shape (n, 2)
        Coordinates in a plane.
    side : int
        Blocks along each axis.

    Returns
    -------
    array of int, shape (n,)
        0 to side^2 - 1.

    Examples
    --------
    >>> block_numbers([[0, 0], [4, 0], [4, 4]], side=2).tolist()
    [0, 2, 3]
    """
    xy = check_plan(xy, name="xy")
    low, extent = xy.min(axis=0), np.ptp(xy, axis=0)
    place = (xy - low) / np.where(extent > 0, extent, 1) * side
    column, row = np.minimum(place.astype(np.int64), side - 1).T
    return column * side + row


def line_parts(xy: ArrayLike, found: DirectionalSpacing | None = None) -> np.ndarray:
    """Return the parts of the points' order across and along the scan lines, for intervals.

    An error of a whole line, such as its distance from the next line, is common to all of its
    points. The waves follow the direction in which points lie closest. Without such a direction
    there are two pairs of waves, along the axes and at 45 degrees to them: the crossing lines of
    two scan heads on an upright board have no common direction.

    Parameters
    ----------
    xy : array_like, shape (n, 2)
        Coordinates in the plane, metres.
    found : DirectionalSpacing, optional
        Spacing by direction of these points, if known.

    Returns
    -------
    array of int, shape (2, n) or (4, n)
        See :func:`mmqa_lab.stats.order_parts`. A single block, so no interval, shape (n,), for
        fewer than 50 points or points at a single place.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(40) * 0.01, np.arange(16) * 0.04)
    >>> line_parts(np.stack([x.ravel(), y.ravel()], axis=1)).shape
    (2, 640)
    """
    xy = check_plan(xy, name="xy", minimum=0)
    if len(xy) < FEWEST_POINTS or not np.ptp(xy, axis=0).any():
        return np.zeros(len(xy), dtype=np.intp)
    found = directional(xy) if found is None else found
    if found.n < FEWEST_POINTS:  # repeated places are no more points
        return np.zeros(len(xy), dtype=np.intp)
    if found.g > 1 + CHANCE / np.sqrt(found.n):
        return stats.order_parts(xy, found.direction_deg)
    return np.vstack([stats.order_parts(xy, 0), stats.order_parts(xy, 45)])


def table_of(names, values, intervals):
    """Return rows of figures with their intervals; all figures but the last are lengths."""
    import pandas as pd

    numbers = np.column_stack([values, intervals])
    numbers[:-1] *= 1000
    table = pd.DataFrame(numbers, columns=["value", "low", "high"])
    table.insert(0, "figure", names)
    return table.assign(unit=["mm"] * (len(names) - 1) + ["1"])
