"""The empty-space distance: how far the places of a surface are from its points."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_count, check_points, refuse
from mmqa_lab._results import Shown
from mmqa_lab.planes import flat_points
from mmqa_lab.spacing.neighbours import tree_of

__all__ = ["STEPS", "EmptySpace", "empty_space", "places_within", "space_within"]

EMPTY_PLACES = 10_000
"""Number of places of a surface from which points are sought; four times as many move e95 by 1 %
at most, on random points, lines and clusters."""

STEPS = np.array([0.7548776662466927, 0.5698402909980532])
"""Steps from place to place as shares of the box of an outline: powers of the root of
x^3 = x + 1. They fill the box evenly and never in step with rows of points."""


@dataclass(frozen=True, eq=False)
class EmptySpace(Shown):
    """How far the places of a surface are from its points.

    Parameters
    ----------
    places : array, shape (m, 2)
        Places spread evenly over the surface, m.
    distances : array, shape (m,)
        From each place to its nearest point, or to the k-th nearest, m; infinite without one.
    border : array, shape (m,)
        From each place to the outline, m.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(50) * 0.02, np.arange(50) * 0.02)
    >>> found = empty_space(np.stack([x.ravel(), y.ravel()], axis=1))
    >>> round(found.e95, 3), round(found.share(0.01), 2)  # pi / 4 of a square lie within
    (0.012, 0.78)
    """

    places: np.ndarray = field(repr=False)
    distances: np.ndarray = field(repr=False)
    border: np.ndarray = field(repr=False)

    _metres = ("e95",)
    _derived = ("e95",)

    @cached_property
    def _within(self):
        """The distances in order, and the share of places up to each (Kaplan and Meier)."""
        reach = np.minimum(self.distances, self.border)
        order = np.argsort(reach, kind="stable")
        known = (self.distances <= self.border)[order]
        return reach[order], 1 - np.cumprod(1 - known / np.arange(len(reach), 0, -1))

    @property
    def e95(self) -> float:
        """The distance within which 95 % of the places have a point, m; NaN if not measurable."""
        return self.quantile(0.95)

    def quantile(self, share: float) -> float:
        """The distance within which a share of the places have a point, m."""
        reach, shares = self._within
        return float(np.append(reach, np.nan)[np.searchsorted(shares, share)])

    def share(self, distance: float) -> float:
        """Share of the places that have a point within a distance, m.

        Details of a diameter that show k points are the places whose k-th point is within half of
        it. NaN for a distance that no place is away from the outline.
        """
        reach, share = self._within
        if not distance <= self.border.max(initial=0):
            return np.nan
        return float(np.append(0, share)[np.searchsorted(reach, distance, "right")])


def empty_space(xy: ArrayLike, *, outline: object = None, rank: int = 1) -> EmptySpace:
    """Distances from the places of a surface to their nearest points: the empty-space function.

    While d1..d4, f and g start at points, these distances start at places with or without a point.
    So they tell how large a gap is, whatever the density.

    Parameters
    ----------
    xy : array_like of shape (n, 2), or points in space (laid onto their regression plane)
        Coordinates in the plane, metres.
    outline : array_like of shape (m, 2), or shapely polygon, optional
        The surface, in the same coordinates; by default the convex hull of the points.
    rank : int
        Distances are to the nearest point (1), or to the point of this rank.

    Returns
    -------
    EmptySpace
        With ``e95`` and ``share``.

    Raises
    ------
    ValueError
        If there is no point, a coordinate is not finite, ``rank`` is not a count, or the outline
        encloses no surface.

    See Also
    --------
    quadrants : distances between points, by which f compares directions.

    Notes
    -----
    The nearest point of a place near the outline may lie beyond it. So a place counts up to its
    distance from the outline only (Kaplan-Meier estimator of Baddeley and Gill). An outline that is
    narrower than three times the result gives too small a one, or none. Coincident points count
    each. e95 of random points is sqrt(ln 20 / (pi density)), 0.98 / sqrt(density).

    References
    ----------
    Diggle 2013, Statistical Analysis of Spatial and Spatio-Temporal Point Patterns, section 2.3;
    Illian et al. 2008, Statistical Analysis and Modelling of Spatial Point Patterns; Baddeley and
    Gill 1997, Annals of Statistics 25, 263-292, doi:10.1214/aos/1034276629.

    Examples
    --------
    >>> line = np.stack([np.arange(2000) * 0.001, np.zeros(2000)], axis=1)
    >>> xy = np.vstack([line + [0, 0.04 * k] for k in range(30)])  # lines 4 cm apart
    >>> round(empty_space(xy).e95, 3)  # 95 % of half the gap
    0.019
    """
    xy, rank = flat_points(xy), check_count(rank, "rank")
    given = outline is not None
    if not given:
        outline = shapely.convex_hull(shapely.multipoints(xy))
    elif not isinstance(outline, shapely.Geometry):
        outline = shapely.Polygon(check_points(outline, name="outline", columns=2, minimum=3))
    bad = given and not (shapely.is_valid(outline) and outline.area > 0)
    refuse(bad, "outline", "crosses itself or has no area", "the border of a surface")
    return space_within(xy, outline, rank=rank)


def space_within(xy, outline, *, most=EMPTY_PLACES, rank=1):
    """Return the empty space of coordinates and an outline that are checked."""
    places = places_within(outline, most)
    border = from_border(outline, places)
    return EmptySpace(places, tree_of(xy).query(places, [rank])[0][:, 0], border)


def places_within(outline, most=EMPTY_PLACES):
    """Return places spread evenly over a surface, (m, 2), m."""
    low, high = np.reshape(outline.bounds, (2, 2))
    count = most * min(100, np.prod(high - low) / max(outline.area, 1e-300))
    places = np.outer(np.arange(count if outline.area else 0), STEPS) % 1 * (high - low)
    moved = shapely.transform(outline, lambda xy: xy - low)
    shapely.prepare(moved)
    return places[shapely.contains_xy(moved, *places.T)] + low


def from_border(outline, places):
    """Return distances of places (m, 2) from the outline of a surface, (m,), m."""
    low = outline.bounds[:2]
    rings = shapely.get_rings(shapely.get_parts(outline))
    corners, ring = shapely.get_coordinates(rings, return_index=True)
    corners, places = ((xy - low) @ (1, 1j) for xy in (corners, places))
    found = np.full(len(places), np.inf)
    for k in np.flatnonzero((np.diff(ring) == 0) & (np.diff(corners) != 0)):
        away, side = places - corners[k], corners[k + 1] - corners[k]
        share = np.clip((away * side.conj()).real / abs(side) ** 2, 0, 1)
        np.minimum(found, np.abs(away - share * side), out=found)
    return found
