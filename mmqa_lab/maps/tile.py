"""One tile of a map: per cell and layer, how many points lie there and how.

Points are sorted into cubes of the cell's size (into columns, on horizontal maps). Each cube gets
the regression plane of its points, and with it a layer: *level*, *upright*, or *other* where the
points show no plane. Level cubes on top of each other that show one surface become one patch.

For the spacing, each patch is flattened into its plane together with the points around it that lie
near the plane. The flat pieces stand in a row, farther apart than the search reaches, and one call
of :func:`mmqa_lab.spacing.quadrant_distances` searches them all. Coordinates in the planes are
rounded to 2^-30 m, a nanometre, so that shifting a piece along the row changes no bit of a
distance. Most points have their four neighbours close by, so a first round gives each piece a
narrow margin; patches with a point that needs more get a wider one in the next, up to the radius.

Sums run in the order of the points, one after the other, so that the figures of a cube do not
depend on what lies around it.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from mmqa_lab._checks import check_choice, check_points, check_positive
from mmqa_lab._compiled import median
from mmqa_lab.cloud import sort_into_cells
from mmqa_lab.planes import CONSISTENT_SCALE
from mmqa_lab.spacing import quadrant_distances

MINIMUM = 10
"""Points in a cell that its sigma_MAD needs: fewer lie too near to a plane fitted to them."""

LAYERS = {"local": ("level", "upright", "other"), "horizontal": ("horizontal",)}
"""Layers of a map by the surface that spacing is measured in."""

NEAREST = "median distance to the {} of the nearest points in four quadrants"

FIGURES = {
    "n": ("", "1", "points in the cell"),
    "coincident": ("", "1", "of these, points that share their place with another one"),
    "area": ("", "m2", "area of the surface in the cell"),
    "density": ("density", "m-2", "points per area of the surface"),
    "linear_point_distance": ("linear_point_distance", "mm", "sqrt(1 / density)"),
    "d1": ("spacing", "mm", NEAREST.format("nearest")),
    "d2": ("spacing", "mm", NEAREST.format("second")),
    "d3": ("spacing", "mm", NEAREST.format("third")),
    "d4": ("spacing", "mm", NEAREST.format("farthest")),
    "incomplete_share": ("spacing", "1", "share of points with an empty quadrant in the radius"),
    "f": ("f", "1", "inhomogeneity d4 / d1"),
    "sigma_mad": ("sigma_mad", "mm", "1.4826 x median absolute deviation from the plane"),
    "void_share": ("void_share", "1", "share of the squares on the surface without a point"),
}
"""Variables of a map: the metric that each belongs to ("" for those of all maps), its unit, and
what it is."""

METRICS = tuple(dict.fromkeys(metric for metric, *_ in FIGURES.values() if metric))

LEVEL, UPRIGHT, OTHER = 0, 1, 2
"""Layers: tangent planes up to 45 degrees from the horizontal, steeper ones, and no plane."""

FEWEST = 5
"""Points that make a plane."""

FLATNESS = 4.0
"""The middle eigenvalue of the scatter is this many times the least, or the points show no plane:
a spread in the plane of twice the spread across. Foliage and single scan lines fall out."""

MARGINS = (4.0, 8.0, np.inf)
"""Of the rounds, in mean spacings. Of random points, one quadrant in 300 000 is empty out to the
first; the second is for scan lines, which lie farther apart than the mean says."""

AT_ONCE = 4_000_000
"""Points looked at for one search, which bounds the memory."""

STEP = 2.0**-30
"""Rounding of coordinates in a plane, m: differences of rounded coordinates are exact."""


def variables(metrics):
    """Return the variables that some metrics give, ``n`` and ``area`` first.

    Raises
    ------
    ValueError
        If a metric is unknown.
    """
    for metric in metrics:
        check_choice(metric, "metric", METRICS)
    return [name for name, (metric, *_) in FIGURES.items() if metric in ("", *metrics)]


def reach(surface, *, cell, radius=0.5, thickness=0.1):
    """How far around a tile points matter to its cells, m.

    Parameters
    ----------
    surface : {"local", "horizontal"}
    cell, radius, thickness : float
        As for :func:`evaluate_tile`, m.

    Returns
    -------
    float

    Examples
    --------
    >>> reach("horizontal", cell=0.25, radius=0.5), reach("local", cell=0.25, radius=0.5)
    (0.5, 0.7)
    """
    return max(radius + 2 * thickness, 2 * cell) if surface == "local" else radius


def evaluate_tile(
    points, window, *, cell, surface="local", metrics=METRICS, radius=0.5, thickness=0.1, void=0.1
):
    """Evaluate the points in each cell of a tile.

    On ``local`` maps the points of each cube of the cell's size get their own tangent plane,
    and distances are measured in it among the points near it; level cubes one above the other that
    show one surface are taken together. A cell then has three layers, which gather what is in its
    column: *level* surfaces up to 45 degrees from the horizontal, *upright* ones, and *other*
    points whose cube shows no plane, which are counted only. On ``horizontal``
    maps a cell has one layer, and distances are horizontal.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Those of the tile and around it as far as :func:`reach`, m, from the origin of the cells.
    window : tuple of int, length 4
        Column and row of the first cell, counted in cells from the coordinates' zero; columns and
        rows.
    cell : float
        Side of the square cells, m; their borders lie at its multiples.
    surface : {"local", "horizontal"}
    metrics : sequence of str
        Some of ``METRICS``.
    radius : float
        Farther neighbours do not count, m.
    thickness : float
        Points farther than this from a tangent plane are not its neighbours, m.
    void : float
        Side of the squares that count as void when no point lies in them, m; rounded so that a
        whole number of them fits a cell.

    Returns
    -------
    dict of str to array, shape (layers, rows, columns)
        ``n``, ``coincident`` (of these, points that share their place with another one), ``area``
        (m2 of the surface in the cell), and the variables of the metrics, in the units of
        ``FIGURES``; NaN where not measurable.

    Raises
    ------
    ValueError
        If an argument is out of its range.

    Notes
    -----
    ``area`` is that of the tangent planes within the cell; on horizontal maps, of the cell. A wall
    on the border of two cells counts in the one with more of it, where the rest lies within
    ``thickness`` of the border. The quadrants' axes are east and
    north, on upright planes the horizontal and the line of greatest slope; f depends on them.
    d1..d4 are medians over the cell's points that have a neighbour of that rank, as in
    :func:`mmqa_lab.spacing.quadrants`. sigma_MAD is about the cubes' planes (on horizontal
    maps, about the plane of the cell's points).

    References
    ----------
    Pfeifer et al. 2021, section 3.3. doi:10.3390/rs13020237

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(50) * 0.02, np.arange(25) * 0.04)
    >>> points = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    >>> found = evaluate_tile(points, (0, 0, 2, 2), cell=0.5, surface="horizontal")
    >>> found["n"].tolist(), found["d4"].round().tolist()
    ([[[325, 325], [300, 300]]], [[[40.0, 40.0], [40.0, 40.0]]])
    """
    points = check_points(points, minimum=0)
    check_choice(surface, "surface", tuple(LAYERS))
    cell, radius = check_positive(cell, "cell", unit="m"), check_positive(radius, "radius")
    thickness, void = check_positive(thickness, "thickness"), check_positive(void, "void")
    shape = (len(LAYERS[surface]), window[3], window[2])
    result = {name: np.full(shape, np.nan) for name in variables(metrics)}
    result["n"], result["coincident"] = np.zeros((2, *shape), np.int64)
    result["area"] = np.zeros(shape)
    if len(points):
        _fill(result, points, window, cell, surface, (radius, thickness, void))
    return result


def _fill(result, points, window, cell, surface, lengths):
    """Enter the figures of every layer's cells that have points."""
    radius, thickness, void = lengths
    local = surface == "local"
    cubes = sort_into_cubes(points, cell, columns=not local)
    found = surfaces(cubes, thickness, join=local)
    patches = found.patches
    column, row = patches.index[:, 0] - window[0], patches.index[:, 1] - window[1]
    inside = (column >= 0) & (column < window[2]) & (row >= 0) & (row < window[3])
    layer = found.tangents.layer if local else np.zeros(len(column), int)
    distances, same = None, coincident(patches.xyz)
    if ("d1" in result or "f" in result) and local:
        planar = np.flatnonzero(inside & (layer != OTHER))
        near = {"radius": radius, "thickness": thickness}
        distances = distances_in_planes(found, planar, **near)
    elif "d1" in result or "f" in result:
        distances = quadrant_distances(patches.xyz[:2].T, radius=radius)
    for k in range(len(result["n"])):
        chosen = np.flatnonzero(inside & (layer == k))
        if len(chosen):
            figures = _Layer(found, chosen, distances, local)
            place = (k, row[chosen[figures.first]], column[chosen[figures.first]])
            result["n"][place] = figures.n
            result["coincident"][place] = np.add.reduceat(same[figures.points], figures.starts[:-1])
            if not local or k != OTHER:
                figures.enter(result, place, max(1, round(cell / void)))


def coincident(xyz):
    """1 where points (3, n) share their place with another one, else 0."""
    sums = xyz[0] + np.sqrt(2) * xyz[1] + np.sqrt(3) * xyz[2]
    _, place, count = np.unique(sums, return_inverse=True, return_counts=True)
    return (count[place] > 1).astype(np.int64)


class _Layer:
    """The patches of one layer, gathered into cells."""

    def __init__(self, found, chosen, distances, local):
        self.found, self.chosen, self.local = found, chosen, local
        patches = found.patches
        columns = patches.index[chosen, :2]
        self.first = np.flatnonzero(np.append(True, (np.diff(columns, axis=0) != 0).any(axis=1)))
        self.n = np.add.reduceat(patches.counts[chosen], self.first)
        self.starts = np.append(0, np.cumsum(self.n))
        taken = np.zeros(len(patches.counts), dtype=bool)
        taken[chosen] = True
        self.points = np.repeat(taken, patches.counts)
        self.distances = None if distances is None else distances[self.points]

    def enter(self, result, place, side):
        """Enter the figures of the cells at ``place`` into the arrays that are wanted."""
        area, void_share = self._faces(side if "void_share" in result else 0)
        density = self.n / area
        found = {"area": area, "density": density, "void_share": void_share}
        found["linear_point_distance"] = 1000 / np.sqrt(density)
        if self.distances is not None:
            found |= self._spacing()
        if "sigma_mad" in result:
            found["sigma_mad"] = self._sigma_mad()
        for name in found.keys() & result.keys():
            result[name][place] = found[name]

    def _faces(self, side):
        """Area of the surface in each cell, m2, and the share of its squares without a point."""
        patches = self.found.patches
        tangents = Tangents(*(values[self.chosen] for values in self.found.tangents))
        cell, index = patches.cell, patches.index[self.chosen]
        face, normals = tangents.face, tangents.axes[:, 2]
        if self.local:
            low = index[np.arange(len(face)), face]
            high = np.where(face == 2, self.found.top[self.chosen], low)
            extent = cell * np.stack([low, high + 1], axis=1)
            extent = extent + patches.wider[self.chosen] * [-1, 1]
            areas = surface_areas(tangents, index, extent, cell)
            area = np.add.reduceat(areas, self.first)
        else:
            face, normals = np.full(len(face), 2), np.tile([0.0, 0.0, 1.0], (len(face), 1))
            extent = np.tile([-np.inf, np.inf], (len(face), 1))
            area = np.full(len(self.first), cell**2)
        if not side:
            return area, None
        starts = np.append(0, np.cumsum(patches.counts[self.chosen]))
        planes = tangents.centres, normals, extent
        xyz = patches.xyz[:, self.points]
        counts = surface_squares(xyz, starts, index, face, *planes, cell, side)
        whole, seen = np.add.reduceat(counts, self.first).T
        with np.errstate(invalid="ignore"):
            return area, 1 - seen / whole

    def _spacing(self):
        """d1..d4 in mm, f, and the share of points without four neighbours."""
        medians = [group_medians(d.copy(), self.starts) for d in self.distances.T]
        missing = np.isnan(self.distances[:, 3]).astype(np.int64)
        share = np.add.reduceat(missing, self.starts[:-1]) / self.n
        found = {f"d{k + 1}": 1000 * median for k, median in enumerate(medians)}
        with np.errstate(invalid="ignore", divide="ignore"):
            found["f"] = np.where(medians[0] > 0, medians[3] / medians[0], np.nan)
        return found | {"incomplete_share": share}

    def _sigma_mad(self):
        """sigma_MAD of the distances from the patches' planes, mm; NaN of few points."""
        patches, (centres, axes, *_) = self.found.patches, self.found.tangents
        residuals = _residuals(patches.xyz, patches.starts, centres, axes[:, 2])[self.points]
        middle = group_medians(residuals, self.starts)
        deviations = np.abs(residuals - np.repeat(middle, self.n))
        mads = group_medians(deviations, self.starts)
        return np.where(self.n >= MINIMUM, 1000 * CONSISTENT_SCALE * mads, np.nan)


class Cubes(NamedTuple):
    """Points in the order of their cubes: by column, in each column from below.

    Parameters
    ----------
    xyz : array, shape (3, n)
        Coordinates, m; within a cube in the order they came in.
    starts : array of int, shape (m + 1,)
        First point of each cube.
    index : array of int, shape (m, 3)
        Place of each cube, in cells from the origin.
    cell : float
        Their side, m.
    wider : array, shape (m, 2)
        How far points that joined a cube lie outside of it, before and behind, m.
    """

    xyz: np.ndarray
    starts: np.ndarray
    index: np.ndarray
    cell: float
    wider: np.ndarray

    @property
    def counts(self):
        """Points in each cube."""
        return np.diff(self.starts)

    def find(self, index):
        """Return the numbers of the cubes at some places, shape (k, 3); -1 where there is none."""
        first = self.index.min(axis=0) - 1
        wide = self.index.max(axis=0) - first + 2
        keys, wanted = _key((self.index - first).T, wide), _key((index - first).T, wide)
        found = np.searchsorted(keys, wanted)
        return np.where(keys[np.minimum(found, len(keys) - 1)] == wanted, found, -1)


def sort_into_cubes(points, cell, *, columns=False):
    """Sort points (n, 3) into cubes of side ``cell``, or into columns of that width.

    Examples
    --------
    >>> cubes = sort_into_cubes(np.array([[0.9, 0, 0], [0.1, 0, 0], [0.2, 0, 0.7]]), 0.5)
    >>> cubes.index.tolist(), cubes.counts.tolist()
    ([[0, 0, 0], [0, 0, 1], [1, 0, 0]], [1, 1, 1])
    """
    cells = sort_into_cells(points[:, :2] if columns else points, cell)
    index = cells.places
    if columns:
        index = np.column_stack([index, np.zeros(len(index), np.int64)])
    xyz = np.ascontiguousarray(points.T)[:, cells.order]
    return Cubes(xyz, cells.starts, index, cell, np.zeros((len(index), 2)))


def _moved(cubes, target, reach):
    """Move the points of cubes to others, whose numbers are in ``target``, shape (m,).

    The cubes that points were moved to become wider by ``reach`` on that side. Where none moves,
    the cubes themselves come back.
    """
    gone = np.flatnonzero(target != np.arange(len(target)))
    if not len(gone):
        return cubes
    number = np.repeat(target, cubes.counts)
    order = np.argsort(number, kind="stable")
    kept = np.unique(target)
    starts = np.append(np.searchsorted(number[order], kept), len(order))
    wider = cubes.wider.copy()
    behind = (cubes.index[gone] > cubes.index[target[gone]]).any(axis=1)
    wider[target[gone], behind.astype(int)] = reach
    return Cubes(cubes.xyz[:, order], starts, cubes.index[kept], cubes.cell, wider[kept])


def _joined(cubes, with_next):
    """Join cubes with the next ones where the mask, shape (m - 1,), says so.

    Returns
    -------
    Cubes
        The points as they are; ``index`` is that of the lowest cube of each.
    array of int
        Height of the highest cube of each, in cells from the origin.
    """
    first = np.flatnonzero(np.append(True, ~with_next))
    ends = np.append(first[1:], len(cubes.index))
    starts = cubes.starts[np.append(first, len(cubes.index))]
    joined = Cubes(cubes.xyz, starts, cubes.index[first], cubes.cell, cubes.wider[first])
    return joined, cubes.index[ends - 1, 2]


def _ranges_around(found, chosen, distance):
    """Ranges of points in the cubes as far as ``distance`` from chosen patches.

    Shape (m, k, 2): columns are sorted from below, so each column around a patch has one range.
    """
    cubes, reach = found.cubes, int(np.ceil(distance / found.cubes.cell))
    first = cubes.index.min(axis=0) - reach
    wide = cubes.index.max(axis=0) - first + 1 + reach
    keys = _key((cubes.index - first).T, wide)
    places, top = found.patches.index[chosen] - first, found.top[chosen] - first[2]
    steps = np.arange(-reach, reach + 1)
    dx, dy = (step.ravel() for step in np.meshgrid(steps, steps, indexing="ij"))
    column = ((places[:, :1] + dx) * wide[1] + places[:, 1:2] + dy) * wide[2]
    ends = [np.searchsorted(keys, column + places[:, 2:] - reach)]
    ends.append(np.searchsorted(keys, column + top[:, None] + reach, side="right"))
    return cubes.starts[np.stack(ends, axis=2)]


def _key(index, wide):
    """One number per place, shape (3, n) -> (n,): columns in turn, each from below."""
    return (index[0] * wide[1] + index[1]) * wide[2] + index[2]


class Tangents(NamedTuple):
    """Tangent planes of cubes.

    Parameters
    ----------
    centres : array, shape (m, 3)
        Means of the points, m.
    axes : array, shape (m, 3, 3)
        Rows u, v, w. The normal w has its largest component positive. Level planes: u as near to
        east as lies in the plane; upright planes: u horizontal. v completes them right-handed.
    layer : array of int, shape (m,)
        ``LEVEL``, ``UPRIGHT`` or ``OTHER``.
    secant : array, shape (m,)
        Area of the plane over a face of the cube, per area of the face.
    face : array of int, shape (m,)
        The axis nearest to the normal: 0 east, 1 north, 2 up.
    """

    centres: np.ndarray
    axes: np.ndarray
    layer: np.ndarray
    secant: np.ndarray
    face: np.ndarray


def tangent_planes(cubes):
    """Fit the plane of each cube: the same one as :func:`mmqa_lab.planes.fit_plane`."""
    centres, scatter = _centred_scatter(cubes.xyz, cubes.starts)
    values, vectors = np.linalg.eigh(scatter)
    normals = vectors[:, :, 0]
    face = np.abs(normals).argmax(axis=1)
    largest = np.take_along_axis(normals, face[:, None], axis=1)
    normals = normals * np.where(largest < 0, -1.0, 1.0)
    planar = (cubes.counts >= FEWEST) & (values[:, 1] > 1e-12 * values[:, 2])
    planar &= values[:, 1] >= FLATNESS * values[:, 0]
    level = np.abs(normals[:, 2]) >= np.sqrt(0.5)
    face = np.where(level, 2, np.abs(normals[:, :2]).argmax(axis=1))
    layer = np.where(planar, np.where(level, LEVEL, UPRIGHT), OTHER)
    secant = 1 / np.abs(np.take_along_axis(normals, face[:, None], axis=1)[:, 0])
    return Tangents(centres, _axes(normals, level), layer, secant, face)


class Surfaces(NamedTuple):
    """Cubes, the patches that some of them were joined to, and the planes of the patches.

    ``top`` is the height of the highest cube of each patch, in cells from the origin.
    """

    cubes: Cubes
    patches: Cubes
    top: np.ndarray
    tangents: Tangents


def surfaces(cubes, thickness, *, join):
    """Return the :class:`Surfaces` of cubes; without ``join`` each cube is a patch."""
    tangents = tangent_planes(cubes)
    if not join:
        return Surfaces(cubes, cubes, cubes.index[:, 2], tangents)
    whole = _moved(cubes, _fuller_parts(cubes, tangents, thickness), thickness)
    if whole is not cubes:
        cubes, tangents = whole, tangent_planes(whole)
    patches, top = _joined(cubes, _one_surface(cubes, tangents, thickness))
    return Surfaces(cubes, patches, top, tangent_planes(patches))


def _one_surface(cubes, tangents, thickness):
    """Mask of the cubes, shape (m - 1,), that show one level surface with the cube on top of them.

    A road at the height of a border between cubes has points below it and above it.
    """
    index, centres = cubes.index, tangents.centres
    same = (np.diff(index[:, :2], axis=0) == 0).all(axis=1) & (np.diff(index[:, 2]) == 1)
    same &= (tangents.layer[1:] == LEVEL) & (tangents.layer[:-1] == LEVEL)
    step = np.diff(centres, axis=0)
    for normal in (tangents.axes[:-1, 2], tangents.axes[1:, 2]):
        off = step[:, 0] * normal[:, 0] + step[:, 1] * normal[:, 1] + step[:, 2] * normal[:, 2]
        same &= np.abs(off) <= thickness
    return same


def _fuller_parts(cubes, tangents, thickness):
    """The cube that each cube's points belong to, shape (m,): mostly itself.

    A wall on a border between cubes has points to either side of it. The cube with fewer of them
    gives its points to the other one where all of them are near the border and near the other's
    plane, no farther than ``thickness``.
    """
    own = np.arange(len(cubes.counts))
    target = own.copy()
    for axis in (0, 1):
        place, begin = cubes.xyz[axis], cubes.index[:, axis] * cubes.cell
        high = np.maximum.reduceat(place, cubes.starts[:-1]) - begin
        low = np.minimum.reduceat(place, cubes.starts[:-1]) - begin
        for side, depth in ((-1, high), (1, cubes.cell - low)):
            other = cubes.find(cubes.index + side * np.eye(3, dtype=np.int64)[axis])
            here = own[(other >= 0) & (depth <= thickness) & (tangents.layer != LEVEL)]
            there = other[here]
            wall = (tangents.layer[there] == UPRIGHT) & (tangents.face[there] == axis)
            more = cubes.counts[there] - cubes.counts[here]
            wall &= (more > 0) | ((more == 0) & (side < 0))
            here, there = here[wall], there[wall]
            planes = tangents.centres[there], tangents.axes[there, 2]
            near = _farthest(cubes.xyz, cubes.starts, here, *planes) <= thickness
            target[here[near]] = there[near]
    gives = target != own
    return np.where(gives & ~gives[target], target, own)


def surface_areas(tangents, index, extent, cell):
    """Area of each plane within its patch, m2.

    Over the square face of the patch, of side ``cell``, where the plane is within ``extent``, shape
    (m, 2), along the axis across the face.
    """
    take = np.arange(len(index))
    a, b = np.where(tangents.face == 0, 1, 0), np.where(tangents.face == 2, 1, 2)
    normal, centre = tangents.axes[:, 2], tangents.centres
    across = normal[take, tangents.face]
    slopes = [-cell * normal[take, axis] / across for axis in (a, b)]
    corner = centre[take, tangents.face]
    for axis, slope in zip((a, b), slopes, strict=True):
        start = np.where(slope < 0, index[take, axis] + 1, index[take, axis]) * cell
        corner = corner + slope / cell * (start - centre[take, axis])
    share = _share_below(extent[:, 1] - corner, *slopes)
    share = share - _share_below(extent[:, 0] - corner, *slopes)
    return cell**2 * tangents.secant * share


def _share_below(height, first, second):
    """Share of the unit square where |first| u + |second| v is below the height."""
    # At least a tenth of a millimetre over the face, to divide by.
    first, second = np.maximum(np.abs(first), 1e-4), np.maximum(np.abs(second), 1e-4)
    corners = (height, height - first, height - second, height - first - second)
    squares = [np.maximum(corner, 0.0) ** 2 for corner in corners]
    share = (squares[0] - squares[1] - squares[2] + squares[3]) / (2 * first * second)
    return np.where(corners[3] >= 0, 1.0, share)


def _axes(normals, level):
    """Rows u, v, w of each plane; sums written out, so that the last bit does not depend on m."""
    x, y, z = normals.T
    zero = np.zeros_like(x)
    # East without its part along the normal, or the horizontal direction across the normal.
    u = np.where(level, np.array([1 - x * x, -x * y, -x * z]), np.array([-y, x, zero]))
    u = u / np.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    v = np.array([y * u[2] - z * u[1], z * u[0] - x * u[2], x * u[1] - y * u[0]])
    return np.stack([u.T, v.T, normals], axis=1)


def distances_in_planes(found, chosen, *, radius, thickness):
    """Sorted quadrant distances of the points of some patches, each in its patch's plane.

    Parameters
    ----------
    found : Surfaces
    chosen : array of int
        The patches of interest; they have planes.
    radius, thickness : float
        Neighbours lie within ``radius`` in the plane and ``thickness`` to either side of it, m.

    Returns
    -------
    array, shape (n, 4)
        For all points, m; NaN for points of other patches and points off the plane.
    """
    patches = found.patches
    distances = np.full((patches.xyz.shape[1], 4), np.nan)
    for margin in MARGINS:
        near = np.minimum(margin * patches.cell / np.sqrt(patches.counts[chosen]), radius)
        unsettled = np.zeros(len(chosen), dtype=bool)
        cells = np.ceil((near + 2 * thickness) / patches.cell)
        for wide in np.unique(cells):
            part = np.flatnonzero(cells == wide)
            unsettled[part] = _search(found, chosen[part], near[part], thickness, distances)
        chosen = chosen[unsettled & (near < radius)]
    return distances


def _search(found, chosen, margins, thickness, distances):
    """Fill in the distances of the chosen patches; mask of those the margin did not settle."""
    patches, planes = found.patches, (found.tangents.centres, found.tangents.axes)
    outlines = _outline_patches(patches.xyz, patches.starts, chosen, *planes, thickness)
    ranges = _ranges_around(found, chosen, margins.max() + 2 * thickness)
    candidates = (ranges[:, :, 1] - ranges[:, :, 0]).sum(axis=1)
    some = np.flatnonzero(outlines[:, 0] <= outlines[:, 1])
    batches = np.cumsum(candidates[some]) // AT_ONCE
    unsettled = np.zeros(len(chosen), dtype=bool)
    for batch in np.unique(batches):
        part = some[batches == batch]
        most = candidates[part].sum()
        xy, rows = np.empty((most, 2)), np.empty(most, np.int64)
        shifts = _side_by_side(outlines[part], margins[part])
        near = (margins[part], thickness, outlines[part], shifts)
        pieces = (patches.xyz, patches.starts, ranges[part], chosen[part], *planes)
        counts = _flatten(*pieces, *near, xy, rows)
        rows = rows[: counts.sum()]
        own = rows >= 0
        gaps = quadrant_distances(xy[: len(rows)], radius=margins[part].max(), of=own)[own]
        distances[rows[own]] = gaps
        piece = np.repeat(part, counts)[own]
        beyond = ~(gaps[:, 3] <= margins[piece])
        unsettled |= np.bincount(piece, weights=beyond, minlength=len(chosen)) > 0
    return unsettled


def _side_by_side(outlines, margins):
    """Shifts along the row that keep the pieces apart; whole 1024ths of a metre, so exact."""
    left = np.floor(1024 * (outlines[:, 0] - margins)) / 1024
    wide = np.ceil(1024 * (outlines[:, 1] + margins - left + 1.01 * margins.max())) / 1024
    return np.append(0.0, np.cumsum(wide)[:-1]) - left


@njit(cache=True)
def _centred_scatter(xyz, starts):
    """Mean (m, 3) and matrix of centred squares and products (m, 3, 3) of each group."""
    groups = len(starts) - 1
    centres, scatter = np.zeros((groups, 3)), np.zeros((groups, 3, 3))
    for g in range(groups):
        start, end = starts[g], starts[g + 1]
        corner = xyz[:, start]
        for a in range(3):
            total = 0.0
            for i in range(start, end):
                total += xyz[a, i] - corner[a]
            centres[g, a] = corner[a] + total / (end - start)
        for a in range(3):
            for b in range(a, 3):
                total = 0.0
                for i in range(start, end):
                    total += (xyz[a, i] - centres[g, a]) * (xyz[b, i] - centres[g, b])
                scatter[g, a, b] = total
                scatter[g, b, a] = total
    return centres, scatter


@njit(cache=True)
def _residuals(xyz, starts, centres, normals):
    """Signed distance of each point from the plane of its own patch, m."""
    heights = np.empty(xyz.shape[1])
    for g in range(len(starts) - 1):
        for i in range(starts[g], starts[g + 1]):
            heights[i] = _along(xyz, i, centres[g], normals[g])
    return heights


@njit(cache=True)
def _farthest(xyz, starts, chosen, centres, normals):
    """Largest distance of the points of each chosen group from a plane of its own."""
    most = np.zeros(len(chosen))
    for k in range(len(chosen)):
        for i in range(starts[chosen[k]], starts[chosen[k] + 1]):
            most[k] = max(most[k], abs(_along(xyz, i, centres[k], normals[k])))
    return most


@njit(cache=True)
def group_medians(values, starts):
    """Median of each group's numbers, NaN left out; NaN where there are none."""
    medians, known = np.empty(len(starts) - 1), np.empty(len(values))
    for g in range(len(medians)):
        n = np.int64(0)
        for i in range(starts[g], starts[g + 1]):
            if not math.isnan(values[i]):
                known[n] = values[i]
                n += 1
        medians[g] = median(known, n)
    return medians


@njit(cache=True)
def surface_squares(xyz, starts, index, face, centres, normals, extent, cell, side):
    """Squares where a patch's plane lies in it, and how many of those have a point, shape (m, 2).

    Of side x side squares on the face of each patch, those over whose centre the plane is within
    the patch's extent, shape (m, 2), along the axis across the face.
    """
    found = np.zeros((len(face), 2), np.int64)
    for g in range(len(face)):
        c = face[g]
        a, b = (0, 1) if c == 2 else (1 - c, 2)
        centre, normal = centres[g], normals[g]
        seen = np.zeros((side, side), np.bool_)
        for i in range(starts[g], starts[g + 1]):
            column = int((xyz[a, i] / cell - index[g, a]) * side)
            row = int((xyz[b, i] / cell - index[g, b]) * side)
            seen[min(max(column, 0), side - 1), min(max(row, 0), side - 1)] = True
        for column in range(side):
            for row in range(side):
                u = (index[g, a] + (column + 0.5) / side) * cell - centre[a]
                v = (index[g, b] + (row + 0.5) / side) * cell - centre[b]
                place = centre[c] - (normal[a] * u + normal[b] * v) / normal[c]
                if extent[g, 0] <= place <= extent[g, 1]:
                    found[g, 0] += 1
                    found[g, 1] += seen[column, row]
    return found


@njit(cache=True)
def _outline_patches(xyz, starts, chosen, centres, axes, thickness):
    """Outline (u low, u high, v low, v high) of each chosen patch's points near its plane."""
    outlines = np.empty((len(chosen), 4))
    for k in range(len(chosen)):
        c = chosen[k]
        outline = outlines[k]
        outline[0], outline[1], outline[2], outline[3] = np.inf, -np.inf, np.inf, -np.inf
        for i in range(starts[c], starts[c + 1]):
            if abs(_along(xyz, i, centres[c], axes[c, 2])) <= thickness:
                u = _along(xyz, i, centres[c], axes[c, 0])
                v = _along(xyz, i, centres[c], axes[c, 1])
                outline[0], outline[1] = min(outline[0], u), max(outline[1], u)
                outline[2], outline[3] = min(outline[2], v), max(outline[3], v)
    return outlines


@njit(cache=True)
def _flatten(
    xyz, starts, ranges, chosen, centres, axes, margins, thickness, outlines, shift, xy, rows
):
    """Write the points near each chosen patch's plane, in its outline widened by the margin.

    ``rows`` gets the number of each point of the patch itself, -1 for those around it. Returns how
    many were written for each patch.
    """
    counts = np.zeros(len(chosen), np.int64)
    n = 0
    for k in range(len(chosen)):
        c, before = chosen[k], n
        for r in range(ranges.shape[1]):
            for i in range(ranges[k, r, 0], ranges[k, r, 1]):
                if abs(_along(xyz, i, centres[c], axes[c, 2])) > thickness:
                    continue
                u = _along(xyz, i, centres[c], axes[c, 0])
                v = _along(xyz, i, centres[c], axes[c, 1])
                if _is_within(u, v, outlines[k], margins[k]):
                    xy[n, 0], xy[n, 1] = _rounded(u) + shift[k], _rounded(v)
                    rows[n] = i if starts[c] <= i < starts[c + 1] else -1
                    n += 1
        counts[k] = n - before
    return counts


@njit(cache=True)
def _is_within(u, v, outline, margin):
    """Whether a place lies in the outline widened by the margin."""
    inside = (u >= outline[0] - margin) & (u <= outline[1] + margin)
    return inside & (v >= outline[2] - margin) & (v <= outline[3] + margin)


@njit(cache=True)
def _along(xyz, i, centre, axis):
    """Coordinate of a point along an axis from a centre."""
    dx, dy, dz = xyz[0, i] - centre[0], xyz[1, i] - centre[1], xyz[2, i] - centre[2]
    return dx * axis[0] + dy * axis[1] + dz * axis[2]


@njit(cache=True)
def _rounded(value):
    return math.floor(value / STEP + 0.5) * STEP
