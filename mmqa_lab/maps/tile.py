"""One tile of a map: per cell and layer, how many points lie there and how."""

import numpy as np

from mmqa_lab._checks import check_choice, check_points, check_positive
from mmqa_lab.maps import _patches
from mmqa_lab.maps._patches import OTHER
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
    "incomplete_share": (
        *("spacing", "1"),
        "share of points with an empty quadrant within the search radius",
    ),
    "f": ("f", "1", "inhomogeneity d4 / d1"),
    "sigma_mad": (
        *("sigma_mad", "mm"),
        "1.4826 x median absolute deviation of the residuals from the plane",
    ),
    "void_share": ("void_share", "1", "share of the squares on the surface without a point"),
}
"""Variables of a map: the metric that each belongs to ("" for those of all maps), its unit, and
what it is."""

METRICS = tuple(dict.fromkeys(metric for metric, *_ in FIGURES.values() if metric))


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
    cubes = _patches.sort_into_cubes(points, cell, columns=not local)
    found = _patches.surfaces(cubes, thickness, join=local)
    patches = found.patches
    column, row = patches.index[:, 0] - window[0], patches.index[:, 1] - window[1]
    inside = (column >= 0) & (column < window[2]) & (row >= 0) & (row < window[3])
    layer = found.tangents.layer if local else np.zeros(len(column), int)
    distances, same = None, coincident(patches.xyz)
    if ("d1" in result or "f" in result) and local:
        planar = np.flatnonzero(inside & (layer != OTHER))
        near = {"radius": radius, "thickness": thickness}
        distances = _patches.distances_in_planes(found, planar, **near)
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
        patches, tangents = self.found.patches, self.found.tangents.select(self.chosen)
        cell, index = patches.cell, patches.index[self.chosen]
        face, normals = tangents.face, tangents.axes[:, 2]
        if self.local:
            low = index[np.arange(len(face)), face]
            high = np.where(face == 2, self.found.top[self.chosen], low)
            extent = cell * np.stack([low, high + 1], axis=1)
            extent = extent + patches.wider[self.chosen] * [-1, 1]
            areas = _patches.surface_areas(tangents, index, extent, cell)
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
        counts = _patches.surface_squares(xyz, starts, index, face, *planes, cell, side)
        whole, seen = np.add.reduceat(counts, self.first).T
        with np.errstate(invalid="ignore"):
            return area, 1 - seen / whole

    def _spacing(self):
        """d1..d4 in mm, f, and the share of points without four neighbours."""
        medians = [_patches.group_medians(d.copy(), self.starts) for d in self.distances.T]
        missing = np.isnan(self.distances[:, 3]).astype(np.int64)
        share = np.add.reduceat(missing, self.starts[:-1]) / self.n
        found = {f"d{k + 1}": 1000 * median for k, median in enumerate(medians)}
        with np.errstate(invalid="ignore", divide="ignore"):
            found["f"] = np.where(medians[0] > 0, medians[3] / medians[0], np.nan)
        return found | {"incomplete_share": share}

    def _sigma_mad(self):
        """sigma_MAD of the distances from the patches' planes, mm; NaN of few points."""
        residuals = _patches.plane_residuals(self.found)[self.points]
        middle = _patches.group_medians(residuals, self.starts)
        deviations = np.abs(residuals - np.repeat(middle, self.n))
        mads = _patches.group_medians(deviations, self.starts)
        return np.where(self.n >= MINIMUM, 1000 * CONSISTENT_SCALE * mads, np.nan)
