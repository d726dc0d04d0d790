"""One tile of a map: per cell and layer, how many points lie there and how."""

from dataclasses import dataclass

import numpy as np

from mmqa_lab._checks import check_choice, check_points, check_positive
from mmqa_lab.planes import CONSISTENT_SCALE

METRICS = ("density", "linear_point_distance", "spacing", "f", "sigma_mad", "void_share")

SURFACES = ("local", "horizontal")

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
    """The cells of a tile: the place of its first cell, and how many there are each way."""

    column: int
    row: int
    columns: int
    rows: int


def reach(surface, *, radius=0.5, thickness=0.1):
    """How far around a tile points matter to its cells, m."""
    return radius + 2 * thickness if surface == "local" else radius


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
    and distances are measured in it among the points near it. A cell then has three layers, which
    gather the cubes of its column: *level* ones up to 45 degrees from the horizontal, *upright*
    ones, and *other* points whose cube shows no plane, which are counted only. On ``horizontal``
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
    ``area`` is that of the cell over the cosine of the surface's tilt, once for each sheet: level
    cubes that touch one above the other are one sheet, upright cubes a sheet each. A wall on the
    border of two cells shows in both, with a part of its points. The quadrants' axes are east and
    north, on upright planes the horizontal and the line of greatest slope; f depends on them.
    d1..d4 are medians over the cell's points that have a neighbour of that rank, as in
    :func:`mmqa_lab.neighbourhoods.spacing`. sigma_MAD is about the cubes' planes (on horizontal
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
    from mmqa_lab.maps.cubes import sort_into_cubes
    from mmqa_lab.maps.tangents import OTHER, tangent_planes

    radius, thickness, void = lengths
    local = surface == "local"
    cubes = sort_into_cubes(points, cell, columns=not local)
    tangents = tangent_planes(cubes)
    column, row = cubes.index[:, 0] - window.column, cubes.index[:, 1] - window.row
    inside = (column >= 0) & (column < window.columns) & (row >= 0) & (row < window.rows)
    layer = tangents.layer if local else np.zeros(len(column), int)
    distances = None
    if "d1" in result or "f" in result:
        planar = np.flatnonzero(inside & (tangents.layer != OTHER))
        distances = _distances(cubes, tangents, planar, surface, radius, thickness)
    for k in range(result["n"].shape[0]):
        chosen = np.flatnonzero(inside & (layer == k))
        if len(chosen):
            figures = _Layer(cubes, tangents, chosen, distances, local, void)
            place = (k, row[chosen[figures.first]], column[chosen[figures.first]])
            result["n"][place] = figures.n
            if not local or k != OTHER:
                figures.enter(result, place)


def _distances(cubes, tangents, chosen, surface, radius, thickness):
    """Sorted quadrant distances of all points, m."""
    from mmqa_lab.maps.unfolding import distances_in_planes
    from mmqa_lab.neighbourhoods import quadrant_distances

    if surface == "horizontal":
        return quadrant_distances(cubes.xyz[:2].T, radius=radius)
    return distances_in_planes(cubes, tangents, chosen, radius=radius, thickness=thickness)


class _Layer:
    """The cubes of one layer, gathered into cells."""

    def __init__(self, cubes, tangents, chosen, distances, local, void):
        self.cubes, self.tangents, self.chosen, self.local = cubes, tangents, chosen, local
        self.side = max(1, round(cubes.cell / void))
        columns = cubes.index[chosen, :2]
        self.first = np.flatnonzero(np.append(True, (np.diff(columns, axis=0) != 0).any(axis=1)))
        counts = cubes.counts[chosen]
        self.n = np.add.reduceat(counts, self.first)
        self.starts = np.append(0, np.cumsum(self.n))
        taken = np.zeros(len(cubes.counts), dtype=bool)
        taken[chosen] = True
        self.points = np.repeat(taken, cubes.counts)
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
        from mmqa_lab.maps._grouped import occupied_squares

        cubes, chosen = self.cubes, self.chosen
        index, face = cubes.index[chosen], self.tangents.face[chosen]
        secant = self.tangents.secant[chosen] if self.local else np.ones(len(chosen))
        joined = (np.diff(index[:, :2], axis=0) == 0).all(axis=1) & (np.diff(index[:, 2]) == 1)
        joined &= face[1:] == 2
        sheets = np.flatnonzero(np.append(True, ~joined))
        counts = cubes.counts[chosen]
        area = cubes.cell**2 * np.add.reduceat(secant * counts, sheets)
        area /= np.add.reduceat(counts, sheets)
        cell = np.searchsorted(self.first, sheets, side="right") - 1
        cells = len(self.first)
        total = np.bincount(cell, weights=area, minlength=cells)
        if not with_voids:
            return total, np.full(cells, np.nan)
        face = face if self.local else np.full(len(chosen), 2)
        ends = np.append(sheets, len(chosen))
        starts = np.append(0, np.cumsum(counts))
        xyz = cubes.xyz[:, self.points]
        seen = occupied_squares(xyz, starts, index, face, ends, cubes.cell, self.side)
        filled = np.bincount(cell, weights=seen, minlength=cells)
        return total, 1 - filled / (np.bincount(cell, minlength=cells) * self.side**2)

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
        """sigma_MAD of the distances from the cubes' planes, mm; NaN where a cell has no plane."""
        from mmqa_lab.maps._grouped import group_mads, group_medians
        from mmqa_lab.maps.tangents import MINIMUM, plane_residuals

        residuals = plane_residuals(self.cubes, self.tangents)[self.points]
        mads = group_mads(residuals, self.starts, group_medians(residuals, self.starts))
        return np.where(self.n >= MINIMUM, 1000 * CONSISTENT_SCALE * mads, np.nan)
