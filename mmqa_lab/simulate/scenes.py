"""Scenes: surfaces side by side, the search tree over them, and the rays that meet them."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_points
from mmqa_lab.simulate.raycast import cast
from mmqa_lab.simulate.surfaces import flattened, merged
from mmqa_lab.simulate.tree import build


@dataclass(frozen=True, eq=False)
class Hits:
    """What rays met: one entry a ray, NaN and surface -1 where it met nothing.

    Parameters
    ----------
    range_m : array, shape (n,)
    surface : array of int, shape (n,)
        Ids in the order of the scene's surfaces.
    normal : array, shape (n, 3)
        Unit normals, towards the ray's origin.
    incidence_deg : array, shape (n,)
        Angle between ray and normal, 0 to 90.
    reflectance : array, shape (n,)

    Examples
    --------
    >>> from mmqa_lab.simulate import ground
    >>> hits = Scene([ground()]).cast([[0, 0, 2.0]], [[0, 1, -1], [0, 0, 1]])
    >>> hits.incidence_deg.round(6).tolist(), hits.surface.tolist()
    ([45.0, nan], [0, -1])
    """

    range_m: np.ndarray
    surface: np.ndarray
    normal: np.ndarray
    incidence_deg: np.ndarray
    reflectance: np.ndarray


class Scene:
    """Surfaces and the search tree over them.

    Parameters
    ----------
    surfaces : iterable of Surface
        May hold lists of surfaces (a wall with its reveals). The place in the flattened list is
        the surface's id.

    Attributes
    ----------
    surfaces : list of Surface
    origin : array, shape (3,)
        The coordinates' mean, taken off before anything is multiplied.
    tree : simulate.tree.Tree

    Raises
    ------
    ValueError
        If there are no surfaces.

    Examples
    --------
    >>> from mmqa_lab.simulate import cylinder, ground
    >>> scene = Scene([ground(), cylinder([5, 0, 0], [5, 0, 4], 0.1, label="post")])
    >>> hits = scene.cast([[0, 0, 2]], [[1, 0, 0]])
    >>> float(hits.range_m[0]), scene.surfaces[hits.surface[0]].label
    (4.9, 'post')
    """

    def __init__(self, surfaces):
        self.surfaces = list(flattened(surfaces))
        if not self.surfaces:
            raise ValueError("Invalid surfaces: none given. Must be one or more.")
        centre = np.concatenate([s.centre for s in self.surfaces])
        self.origin = np.round(centre.mean(axis=0))
        ids = np.repeat(np.arange(len(self.surfaces), dtype=np.int32), [*map(len, self.surfaces)])
        parts = merged(self.surfaces)
        self.tree = build(surface=ids, **{**parts, "centre": centre - self.origin})

    def table(self):
        """Return a DataFrame: surface, label, primitives and the box of each surface, metres."""
        rows = []
        for i, s in enumerate(self.surfaces):
            low, high = (s.centre - s.half).min(axis=0), (s.centre + s.half).max(axis=0)
            rows.append((i, s.label, len(s), *low, *high))
        box = [f"{axis}_{end}_m" for end in ("min", "max") for axis in "xyz"]
        return pd.DataFrame(rows, columns=["surface", "label", "primitives", *box])

    def cast(self, origins, directions):
        """Return the ``Hits`` of rays.

        Parameters
        ----------
        origins : array_like, shape (n, 3) or (3,)
            Metres; one for all rays or one for each.
        directions : array_like, shape (n, 3)
            Of any length above zero.

        Raises
        ------
        ValueError
            If a direction has no length or the shapes do not fit.
        """
        directions = check_points(directions, name="directions")
        origins = check_points(np.atleast_2d(origins), name="origins")
        if len(origins) not in (1, len(directions)):
            raise ValueError(
                f"Invalid origins: {len(origins)} given. Must be 1 or {len(directions)}."
            )
        length = np.linalg.norm(directions, axis=1)
        if not length.all():
            raise ValueError(f"Invalid direction in row {np.argmin(length)}. Must be > 0 m long.")
        unit = directions / length[:, None]
        local = np.ascontiguousarray(np.broadcast_to(origins - self.origin, unit.shape))
        ranges, surface, normal, reflectance = cast(self.tree, local, unit)
        cosine = np.einsum("ij,ij->i", normal, unit)
        normal *= -np.sign(cosine)[:, None]
        ranges[surface < 0] = np.nan
        incidence = np.degrees(np.arccos(np.clip(np.abs(cosine), 0, 1)))
        return Hits(ranges, surface, normal, incidence, reflectance)
