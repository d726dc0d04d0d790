"""One tile of a map: per cell and layer, how many points lie there and how."""

from dataclasses import dataclass

import numpy as np

from mmqa_lab._checks import check_choice, check_points, check_positive
from mmqa_lab.planes import CONSISTENT_SCALE

METRICS = ("density", "linear_point_distance", "spacing", "f", "sigma_mad", "void_share")

SURFACES = ("local", "horizontal")

MINIMUM = 10
"""Points in a cell that its sigma_MAD needs: fewer lie too near to a plane fitted to them."""

LAYERS = {"local": ("level", "upright", "other"), "horizontal": ("horizontal",)}
"""Layers of a map by the surface that spacing is measured in."""

VARIABLES = {
    "density": ("density",),
    "linear_point_distance": ("linear_point_distance",),
    "spacing": ("d1", "d2", "d3", "d4", "incomplete_share"),
    "f": ("f",),
    "sigma_mad": ("sigma_mad",),
    "void_share": ("void_share",),
}
"""The arrays that each metric gives; ``n`` and ``area`` always come with them."""

UNITS = {
    "n": "1",
    "area": "m2",
    "density": "m-2",
    "linear_point_distance": "mm",
    **{f"d{k}": "mm" for k in range(1, 5)},
    "incomplete_share": "1",
    "f": "1",
    "sigma_mad": "mm",
    "void_share": "1",
}


@dataclass(frozen=True)
class Window:
    """The cells of a tile: the place of its first cell, and how many there are each way.

    Parameters
    ----------
    column, row : int
        Of the first cell, counted in cells from the coordinates' zero.
    columns, rows : int
        Cells to the east and to the north.

    Examples
    --------
    >>> points = [[10.1, 20.1, 0.0], [10.6, 20.1, 0.0]]
    >>> found = evaluate_tile(points, Window(20, 40, 2, 1), cell=0.5, surface="horizontal")
    >>> found["n"].tolist()
    [[[1, 1]]]
    """

    column: int
    row: int
    columns: int
    rows: int


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
    points,
    window,
    *,
    cell,
    surface="local",
    metrics=METRICS,
    radius=0.5,
    thickness=0.1,
    void=0.1,
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
    window : Window
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
        ``n`` and ``area`` (m2 of the surface in the cell), and what ``VARIABLES`` lists for the
        metrics, in ``UNITS``; NaN where not measurable.

    Raises
    ------
    ValueError
        If an argument is out of its range.

    Notes
    -----
    ``area`` is that of the tangent planes within the cell; on horizontal maps, of the cell. A wall
    on the border of two cells counts in the one that holds more of it, where the rest lies within
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
    >>> found = evaluate_tile(points, Window(0, 0, 2, 2), cell=0.5, surface="horizontal")
    >>> found["n"].tolist(), found["d4"].round().tolist()
    ([[[325, 325], [300, 300]]], [[[40.0, 40.0], [40.0, 40.0]]])
    """
    points = check_points(points, minimum=0)
    check_choice(surface, "surface", SURFACES)
    cell, radius = check_positive(cell, "cell", unit="m"), check_positive(radius, "radius")
    thickness, void = check_positive(thickness, "thickness"), check_positive(void, "void")
    for metric in metrics:
        check_choice(metric, "metric", METRICS)
    names = ("n", "area", *(name for metric in metrics for name in VARIABLES[metric]))
    shape = (len(LAYERS[surface]), window.rows, window.columns)
    result = {name: np.full(shape, np.nan) for name in names}
    result["n"] = np.zeros(shape, np.int64)
    result["area"] = np.zeros(shape)
    if len(points):
        _fill(result, points, window, cell, surface, (radius, thickness, void))
    return result


def _fill(result, points, window, cell, surface, lengths):
    """Enter the figures of every layer's cells that hold points."""
    from mmqa_lab.maps.cubes import join, moved, ranges_around, sort_into_cubes
    from mmqa_lab.maps.tangents import OTHER, fuller_parts, one_surface, tangent_planes
    from mmqa_lab.maps.unfolding import distances_in_planes
    from mmqa_lab.spacing import quadrant_distances

    radius, thickness, void = lengths
    local = surface == "local"
    cubes = sort_into_cubes(points, cell, columns=not local)
    tangents, patches, top = tangent_planes(cubes), cubes, cubes.index[:, 2]
    if local:
        whole = moved(cubes, fuller_parts(cubes, tangents, thickness), thickness)
        if whole is not cubes:
            cubes, tangents = whole, tangent_planes(whole)
        patches, top = join(cubes, one_surface(cubes, tangents, thickness))
        tangents = tangent_planes(patches)
    column, row = patches.index[:, 0] - window.column, patches.index[:, 1] - window.row
    inside = (column >= 0) & (column < window.columns) & (row >= 0) & (row < window.rows)
    layer = tangents.layer if local else np.zeros(len(column), int)
    distances = None
    if ("d1" in result or "f" in result) and local:

        def around(chosen, distance):
            cells = int(np.ceil(distance / cell))
            return ranges_around(cubes, patches.index[chosen], top[chosen], cells)

        planar = np.flatnonzero(inside & (layer != OTHER))
        near = {"radius": radius, "thickness": thickness}
        distances = distances_in_planes(patches, tangents, planar, around, **near)
    elif "d1" in result or "f" in result:
        distances = quadrant_distances(cubes.xyz[:2].T, radius=radius)
    for k in range(result["n"].shape[0]):
        chosen = np.flatnonzero(inside & (layer == k))
        if len(chosen):
            figures = _Layer(patches, top, tangents, chosen, distances, local, void)
            place = (k, row[chosen[figures.first]], column[chosen[figures.first]])
            result["n"][place] = figures.n
            if not local or k != OTHER:
                figures.enter(result, place)


class _Layer:
    """The patches of one layer, gathered into cells."""

    def __init__(self, patches, top, tangents, chosen, distances, local, void):
        self.patches, self.tangents, self.chosen, self.local = patches, tangents, chosen, local
        self.top = top
        self.side = max(1, round(patches.cell / void))
        self.index = patches.index[chosen]
        columns = self.index[:, :2]
        self.first = np.flatnonzero(np.append(True, (np.diff(columns, axis=0) != 0).any(axis=1)))
        counts = patches.counts[chosen]
        self.n = np.add.reduceat(counts, self.first)
        self.starts = np.append(0, np.cumsum(self.n))
        taken = np.zeros(len(patches.counts), dtype=bool)
        taken[chosen] = True
        self.points = np.repeat(taken, patches.counts)
        self.distances = None if distances is None else distances[self.points]

    def enter(self, result, place):
        """Enter the figures of the cells at ``place`` into the arrays that are wanted."""
        area, void_share = self._faces("void_share" in result)
        density = self.n / area
        found = {"area": area, "density": density, "void_share": void_share}
        found["linear_point_distance"] = 1000 / np.sqrt(density)
        if self.distances is not None:
            found |= self._spacing()
        if "sigma_mad" in result:
            found["sigma_mad"] = self._sigma_mad()
        for name in found.keys() & result.keys():
            result[name][place] = found[name]

    def _faces(self, with_voids):
        """Area of the surface in each cell, m2, and the share of it that is void."""
        from mmqa_lab.maps._grouped import surface_squares
        from mmqa_lab.maps.tangents import surface_areas

        patches, tangents, index = self.patches, self.tangents.select(self.chosen), self.index
        face, normals = tangents.face, tangents.axes[:, 2]
        if self.local:
            low = index[np.arange(len(face)), face]
            high = np.where(face == 2, self.top[self.chosen], low)
            extent = patches.cell * np.stack([low, high + 1], axis=1)
            extent = extent + patches.wider[self.chosen] * [-1, 1]
            area = np.add.reduceat(surface_areas(tangents, index, extent, patches.cell), self.first)
        else:
            face, normals = np.full(len(face), 2), np.tile([0.0, 0.0, 1.0], (len(face), 1))
            extent = np.tile([-np.inf, np.inf], (len(face), 1))
            area = np.full(len(self.first), patches.cell**2)
        if not with_voids:
            return area, None
        starts = np.append(0, np.cumsum(patches.counts[self.chosen]))
        planes = tangents.centres, normals, extent
        xyz, squares = patches.xyz[:, self.points], (patches.cell, self.side)
        counts = surface_squares(xyz, starts, index, face, *planes, *squares)
        whole, seen = np.add.reduceat(counts, self.first).T
        with np.errstate(invalid="ignore"):
            return area, 1 - seen / whole

    def _spacing(self):
        """d1..d4 in mm, f, and the share of points without four neighbours."""
        from mmqa_lab.maps._grouped import group_medians

        medians = [group_medians(self.distances[:, k].copy(), self.starts) for k in range(4)]
        d1, d4 = medians[0], medians[3]
        missing = np.isnan(self.distances[:, 3]).astype(np.int64)
        share = np.add.reduceat(missing, self.starts[:-1]) / self.n
        found = {f"d{k + 1}": 1000 * median for k, median in enumerate(medians)}
        with np.errstate(invalid="ignore", divide="ignore"):
            found["f"] = np.where(d1 > 0, d4 / d1, np.nan)
        return found | {"incomplete_share": share}

    def _sigma_mad(self):
        """sigma_MAD of the distances from the patches' planes, mm; NaN of few points."""
        from mmqa_lab.maps._grouped import group_mads, group_medians
        from mmqa_lab.maps.tangents import plane_residuals

        residuals = plane_residuals(self.patches, self.tangents)[self.points]
        mads = group_mads(residuals, self.starts, group_medians(residuals, self.starts))
        return np.where(self.n >= MINIMUM, 1000 * CONSISTENT_SCALE * mads, np.nan)
