"""What metrics of a planar point pattern share: places, one tree, one triangulation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, wraps
from typing import Any, TypeVar

import numpy as np
import shapely

from mmqa_lab.spacing.empty import EmptySpace, from_border, places_within
from mmqa_lab.spacing.neighbours import tree_of

__all__ = ["LEAST_NEAR", "LOCAL_M", "MOST_CENTRES", "Pattern", "Unmeasured"]

LOCAL_M, LEAST_NEAR, MOST_CENTRES = 0.1, 5, 1000
"""Radius of a neighbourhood, m, its fewest points with its middle, and the most of them: points
that follow each other evenly in the order of x."""

DISC_M = 0.05
"""Radius of the discs in which points are counted, m."""

SLACK = 1e-3
"""Share of its side by which a cell may leave the outline, which noise of the plane tilts."""


Found = TypeVar("Found")


class Unmeasured(ValueError):
    """A pattern has no such figure; the message is the reason."""


def _shared(function: Callable[[Any], Found]) -> cached_property[Found]:
    """A property that is worked out once; its arrays cannot be written."""

    @wraps(function)
    def once(self):
        found = function(self)
        for part in found if isinstance(found, tuple) else (found,):
            if isinstance(part, np.ndarray):
                part.flags.writeable = False
        return found

    return cached_property(once)


@dataclass(frozen=True, eq=False)
class Pattern:
    """Points in a plane, the outline of their surface, and their distances from the plane.

    Parameters
    ----------
    xy : array, shape (n, 2)
        The points, m.
    outline : shapely geometry
        The surface, m.
    residuals : array, shape (n,)
        Distances from the plane, m.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(0.01, 1, 0.02), np.arange(0.02, 1, 0.04))
    >>> xy = np.stack([x.ravel(), y.ravel()], axis=1)
    >>> found = Pattern(xy, shapely.box(0, 0, 1, 1), 0 * xy[:, 0])
    >>> found.counts(0.1).tolist() == 100 * [12.5] or int(found.counts(0.1).sum())
    1250
    """

    xy: np.ndarray = field(repr=False)
    outline: Any
    residuals: np.ndarray = field(repr=False)

    def __post_init__(self) -> None:
        """Look at the arrays without being able to write them."""
        for name in ("xy", "residuals"):
            view = getattr(self, name).view()
            view.flags.writeable = False
            object.__setattr__(self, name, view)

    def __deepcopy__(self, _: dict) -> Pattern:
        """Return itself: nothing in it can be written, so that copies of a chart share its work."""
        return self

    @property
    def density(self) -> float:
        """Points per square metre of the outline."""
        if not self.outline.area:
            raise Unmeasured("the outline has no area")
        return len(self.xy) / self.outline.area

    @_shared
    def tree(self) -> Any:
        """A tree of the points."""
        return tree_of(self.xy)

    @_shared
    def _places(self):
        """Places of the surface, their distances from the outline and from the nearest points."""
        places = places_within(self.outline)
        if not len(places):
            raise Unmeasured("the outline has no area")
        border = from_border(self.outline, places)
        return places, border, self.tree.query(places, [1, 2, 3])[0]

    def empty(self, rank: int = 1) -> EmptySpace:
        """Distances from places to the point of a rank up to 3."""
        places, border, away = self._places
        return EmptySpace(places, away[:, rank - 1], border)

    @_shared
    def nearest(self) -> np.ndarray:
        """Distance from each point to the next one, m, (n,)."""
        if len(self.xy) < 2:
            raise Unmeasured("there is a single point")
        return self.tree.query(self.xy, [2])[0][:, 0]

    @_shared
    def discs(self) -> np.ndarray:
        """Number of points within 5 cm of the places whose disc lies within the outline."""
        places, border, _ = self._places
        inside = places[border >= DISC_M]
        if not len(inside):
            raise Unmeasured(f"no disc of {200 * DISC_M:g} cm lies within the outline")
        return self.tree.query_ball_point(inside, DISC_M, return_length=True)

    @_shared
    def framed(self) -> tuple[np.ndarray, Any]:
        """Points and outline along the sides of the narrowest rectangle around the outline, m.

        So what is counted in cells does not turn with the axes. The rectangle begins at (0, 0).
        """
        box = shapely.get_coordinates(shapely.minimum_rotated_rectangle(self.outline))
        if len(box) < 4:
            raise Unmeasured("the outline has no area")
        corner, along = box[0], (box[1] - box[0]) / np.hypot(*(box[1] - box[0]))
        across = box[2] - box[1]
        frame = np.array([along, across / np.hypot(*across)]).T
        return (self.xy - corner) @ frame, shapely.transform(
            self.outline, lambda ring: (ring - corner) @ frame
        )

    def counts(self, side: float) -> np.ndarray:
        """Number of points in each square cell that lies within the outline, but for ``SLACK``.

        The grid lies in the middle of the outline's box, so that mirrored points have the same.
        """
        xy, outline = self.framed
        high = np.reshape(outline.bounds, (2, 2))[1]
        size = np.floor(high / side + SLACK).astype(int)
        corner = (high - size * side) / 2
        cell = np.floor((xy - corner) / side).astype(int)
        inside = ((cell >= 0) & (cell < size)).all(axis=1)
        numbers = np.ravel_multi_index(cell[inside].T, size) if size.all() else []
        counts = np.bincount(numbers, minlength=size.prod())
        x, y = (corner[:, None, None] + side * np.indices(size)).reshape(2, -1)
        whole = shapely.buffer(outline, SLACK * side, join_style="mitre")
        shapely.prepare(whole)
        counts = counts[shapely.covers(whole, shapely.box(x, y, x + side, y + side))]
        if not len(counts):
            raise Unmeasured(f"no cell of {100 * side:.3g} cm lies within the outline")
        return counts

    @_shared
    def triangles(self) -> Any:
        """The Delaunay triangulation of the distinct points."""
        from scipy.spatial import Delaunay, QhullError

        try:
            return Delaunay(np.unique(self.xy, axis=0))
        except QhullError:
            raise Unmeasured("points lie on a line, or are fewer than four") from None

    @_shared
    def cells(self) -> np.ndarray:
        """Areas of the Voronoi cells that lie within the outline, m2."""
        from scipy.spatial import Voronoi

        found = Voronoi(self.triangles.points)
        closed = [one for one in found.regions if one and min(one) >= 0]
        index = np.repeat(np.arange(len(closed)), [len(one) for one in closed])
        shapely.prepare(self.outline)
        inside = shapely.contains_xy(self.outline, *found.vertices.T)
        corners = np.concatenate(closed) if closed else np.empty(0, int)
        inside = np.bincount(index, ~inside[corners], minlength=len(closed)) == 0
        rings = shapely.linearrings(found.vertices[corners], indices=index) if closed else []
        areas = shapely.area(shapely.polygons(rings))[inside]
        if len(areas) < 2:
            raise Unmeasured("no Voronoi cell lies within the outline")
        return areas

    @_shared
    def local(self) -> tuple[np.ndarray, np.ndarray]:
        """Eigenvalues of the covariances of neighbourhoods, m2, (m, 3), ascending, and roughness.

        Roughness is the distance of a point from the plane of its neighbours, m, (m,).
        """
        xyz = np.column_stack([self.xy, self.residuals])
        order = np.lexsort(self.xy.T)
        centre = order[:: -(-len(order) // MOST_CENTRES)]
        from scipy.spatial import cKDTree

        near = cKDTree(xyz).query_ball_point(xyz[centre], LOCAL_M)
        counts = np.array([len(one) for one in near])
        enough = counts >= LEAST_NEAR
        if not enough.any():
            raise Unmeasured(f"fewer than {LEAST_NEAR} points within {100 * LOCAL_M:g} cm")
        centre, counts, near = centre[enough], counts[enough], np.concatenate(near[enough])
        starts = np.cumsum(counts) - counts
        off = xyz[near.astype(int)] - np.repeat(xyz[centre], counts, axis=0)
        sums = np.add.reduceat(off, starts)
        squares = np.add.reduceat(off[:, :, None] * off[:, None], starts)
        values = [
            (squares - sums[:, :, None] * sums[:, None] / n[:, None, None]) / (n - 1)[:, None, None]
            for n in (counts, counts - 1)  # the middle of a neighbourhood adds nothing to its sums
        ]
        normals = np.linalg.eigh(values[1])[1][:, :, 0]
        away = np.abs((sums / (counts - 1)[:, None] * normals).sum(axis=1))
        return np.maximum(np.linalg.eigvalsh(values[0]), 0), away
