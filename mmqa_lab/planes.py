"""Planes, lines and circles fitted to points, their dispersion, and the planes of whole clouds.

Pfeifer et al. 2021 (doi 10.3390/rs13020237), section 3.3 and Appendix A: the plane of a chart is
the orthogonal regression plane of its points; sigma_MAD of the residuals is the precision.

Planes of a whole cloud come from local trials and growth over a grid of cells, in linear time.
A trial of three neighbouring points needs no normals. Profiles of mobile scanners are dense along
the line and sparse across it, so normals from nearest neighbours describe a scan line, not the
wall. Every trial and every step of growth uses only the cells around it. So a kilometre of street
is treated like a room, and no cloud is thinned. Poreba & Goulette 2013 name principal planes, such
as walls and roads, and leave their detection to a companion paper.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array, eye_array
from scipy.spatial import cKDTree
from scipy.special import lambertw

from mmqa_lab._checks import check_number, check_points, check_positive
from mmqa_lab._results import Shown
from mmqa_lab.cloud import sort_into_cells

CONSISTENT_SCALE = 1.482602218505602
"""1 / Phi^-1(3/4): makes sigma_MAD equal the standard deviation of normal residuals."""

PAPER_SCALE = 1.4862
"""The factor in the code of Pfeifer et al. 2021, Appendix A (1.4826 with two digits swapped)."""

TUKEY = 4.685
"""Tukey's biweight constant, 95 % efficient for normal residuals (Huber & Ronchetti 2009)."""

FAR = 0.01
"""Distances from a circle beyond this get less weight, m."""


@dataclass(frozen=True, eq=False)
class Plane(Shown):
    """A fitted plane and the points' distances from it.

    Parameters
    ----------
    centre : array, shape (3,)
        A point of the plane: the (weighted) mean of the points, m.
    normal : array, shape (3,)
        Unit normal, its largest component positive.
    axes : array, shape (2, 3)
        Unit principal axes in the plane, the longer extent first; right-handed with the normal.
    residuals : array, shape (n,)
        Signed orthogonal distances of all given points, m.

    Examples
    --------
    >>> plane = fit_plane([[0, 0, 1], [4, 0, 1], [4, 2, 1], [0, 2, 1.0]])
    >>> plane.normal.tolist(), plane.distances([[1, 1, 3]]).tolist(), plane.std
    ([0.0, 0.0, 1.0], [2.0], 0.0)
    """

    centre: np.ndarray
    normal: np.ndarray
    axes: np.ndarray
    residuals: np.ndarray

    _metres = ("centre", "std")
    _derived = ("n", "std")

    @property
    def n(self) -> int:
        """Number of points."""
        return len(self.residuals)

    @property
    def std(self) -> float:
        """Standard deviation of the residuals, n - 1 in the denominator as in the paper, m."""
        return float(np.std(self.residuals, ddof=1))

    def project(self, points: ArrayLike) -> np.ndarray:
        """Coordinates of points (n, 3) along ``axes``, from ``centre``: shape (n, 2), m."""
        return (np.asarray(points, dtype=np.float64) - self.centre) @ self.axes.T

    def distances(self, points: ArrayLike) -> np.ndarray:
        """Signed orthogonal distances of points (n, 3) from the plane, shape (n,), m."""
        return (np.asarray(points, dtype=np.float64) - self.centre) @ self.normal

    def horizontal_axes(self) -> np.ndarray:
        """Return axes (2, 3) in the plane: the horizontal one, then the line of greatest slope.

        Raises
        ------
        ValueError
            If the plane is horizontal to within 0.1 degree: its horizontal axis is then undefined.
        """
        level = np.cross([0.0, 0.0, 1.0], self.normal)
        slope = np.linalg.norm(level)
        if slope < np.sin(np.radians(0.1)):
            raise ValueError(
                f"Invalid plane, tilted by {np.degrees(np.arcsin(slope)):.3f} degrees. "
                "Must be 0.1 degrees or more for horizontal axes."
            )
        level /= slope
        return np.array([level, np.cross(self.normal, level)])


def fit_plane(points: ArrayLike, *, robust: bool = False) -> Plane:
    """Fit the orthogonal regression plane.

    The normal is the eigenvector of the smallest eigenvalue of the centred scatter matrix. The axes
    are the other two eigenvectors. The robust fit repeats this with Tukey's biweights of the
    residuals, scaled by their sigma_MAD, until the weights converge.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Metres, n >= 3, not on one line.
    robust : bool
        Reduce the weight of points off the plane. All points keep their residuals.

    Returns
    -------
    Plane

    Raises
    ------
    ValueError
        If there are fewer than three points, or all lie on one line or spot.

    Notes
    -----
    Principal axes follow the outline of the selection, not the scan. In a nearly square selection
    their direction is random.

    References
    ----------
    Pfeifer et al. 2021, Appendix A. doi:10.3390/rs13020237

    Examples
    --------
    >>> plane = fit_plane([[0, 0, 1], [2, 0, 1], [2, 1, 1], [0, 1, 1]])
    >>> plane.normal.tolist(), plane.std
    ([0.0, 0.0, 1.0], 0.0)
    """
    points = check_points(points, minimum=3)
    origin, centre, (normal, _, first) = _principal_axes(points, robust)
    axes = np.array([first, np.cross(normal, first)])
    return Plane(origin + centre, normal, axes, (points - origin - centre) @ normal)


def flat_points(points: ArrayLike, *, minimum: int = 1) -> np.ndarray:
    """Return coordinates in a plane; points in space are projected onto their regression plane.

    Parameters
    ----------
    points : array_like, shape (n, 2) or (n, 3)
        Coordinates in a plane, or points in space, m.
    minimum : int
        Fewest points.

    Returns
    -------
    array, shape (n, 2)
        Metres. Points in space get coordinates along the principal axes of their plane, from their
        mean.

    Raises
    ------
    ValueError
        If there are too few points, one is not finite, or points in space lie on a line.

    Examples
    --------
    >>> flat_points([[3, 4]]).tolist()
    [[3.0, 4.0]]
    >>> flat_points([[0, 5, 0], [4, 5, 0], [0, 5, 2], [4, 5, 2]]).round(6).tolist()
    [[-2.0, 1.0], [2.0, 1.0], [-2.0, -1.0], [2.0, -1.0]]
    """
    if np.shape(points)[1:] != (3,):
        return check_points(points, name="xy", columns=2, minimum=minimum)
    points = check_points(points, name="xy", minimum=minimum)
    return fit_plane(points).project(points)


@dataclass(frozen=True, eq=False)
class Line:
    """A fitted straight line in plan and the points' distances from it.

    Parameters
    ----------
    centre : array, shape (2,)
        A point of the line: the (weighted) mean of the points, m.
    direction : array, shape (2,)
        Unit vector along the line.
    """

    centre: np.ndarray
    direction: np.ndarray

    def distances(self, points: ArrayLike) -> np.ndarray:
        """Signed orthogonal distances of points (n, 2), shape (n,), m, positive to the left."""
        normal = np.array([-self.direction[1], self.direction[0]])
        return (np.asarray(points, dtype=np.float64) - self.centre) @ normal


def fit_line(points: ArrayLike, *, robust: bool = False) -> Line:
    """Fit the orthogonal regression line to points in plan, as ``fit_plane`` fits planes.

    Parameters
    ----------
    points : array_like, shape (n, 2)
        Metres, n >= 2, not on one spot.
    robust : bool
        Reduce the weight of points off the line (Tukey).

    Returns
    -------
    Line

    Raises
    ------
    ValueError
        If there are fewer than two points, or all lie on one spot.

    Examples
    --------
    >>> line = fit_line([[0, 0], [3, 4], [6, 8]])
    >>> line.direction.round(9).tolist(), line.distances([[-4, 3]]).round(9).tolist()
    ([0.6, 0.8], [5.0])
    """
    points = check_points(points, columns=2, minimum=2)
    origin, centre, (_, direction) = _principal_axes(points, robust)
    return Line(origin + centre, direction)


def sigma_mad(residuals: ArrayLike, scale: float = CONSISTENT_SCALE) -> float:
    """Robust standard deviation: scale x median(|r - median r|).

    Parameters
    ----------
    residuals : array_like, shape (n,)
        In any unit, finite, n >= 1.
    scale : float
        ``CONSISTENT_SCALE`` = 1.4826 (default) equals the standard deviation for normal
        residuals; ``PAPER_SCALE`` = 1.4862 is the factor in the paper's code.

    Returns
    -------
    float
        In the unit of the residuals.

    Raises
    ------
    ValueError
        If there are no residuals, one is not finite, or the scale is not above zero.

    Notes
    -----
    The paper's factor makes every precision 0.24 % larger. Use it to reproduce Table 2, and the
    default for new data. Coordinates rounded to a grid make sigma_MAD jump in steps of the grid.

    References
    ----------
    Pfeifer et al. 2021, section 3.3 (recommended, no formula) and Appendix A (the code).
    doi:10.3390/rs13020237

    Examples
    --------
    >>> round(sigma_mad([-2, -1, 0, 1, 2]), 4)
    1.4826
    """
    residuals = np.asarray(residuals, dtype=np.float64)
    if residuals.ndim != 1 or not len(residuals) or not np.isfinite(residuals).all():
        raise ValueError(
            f"Invalid residuals of shape {residuals.shape}. Must be a row of finite numbers."
        )
    scale = check_positive(scale, "scale")
    return float(scale * np.median(np.abs(residuals - np.median(residuals))))


def turned_axes(axes: ArrayLike, angle: float) -> np.ndarray:
    """Return in-plane ``axes`` (2, 3) turned by ``angle`` degrees from the first to the second.

    Parameters
    ----------
    axes : array_like, shape (2, 3)
        Unit vectors at a right angle.
    angle : float
        Degrees.

    Returns
    -------
    array, shape (2, 3)

    Raises
    ------
    ValueError
        If the angle is not finite.

    Examples
    --------
    >>> turned_axes([[1, 0, 0], [0, 1, 0]], 90).round(9).tolist()
    [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]
    """
    turn = np.radians(check_number(angle, "angle", unit="degrees"))
    c, s = np.cos(turn), np.sin(turn)
    return np.array([[c, s], [-s, c]]) @ np.asarray(axes, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Circle(Shown):
    """A circle fitted to points in plan.

    Parameters
    ----------
    centre : array, shape (2,)
        Metres.
    radius : float
        m; the given radius if the diameter was given.
    covariance : array, shape (2, 2)
        Of the centre, m^2; NaN where the arc does not determine it. With a free diameter the centre
        of an arc is far less certain along the line of sight than across it.
    """

    centre: np.ndarray
    radius: float
    covariance: np.ndarray

    _metres = ("centre", "radius", "std")
    _derived = ("std",)

    @property
    def std(self) -> float:
        """Standard deviation of a coordinate of the centre, mean of all directions, m."""
        return float(np.sqrt(np.trace(self.covariance) / 2))


def fit_circle(points: ArrayLike, *, diameter: float | None = None) -> Circle:
    """Fit a circle to points in plan, with a robust (Cauchy) loss of the distances from it.

    Parameters
    ----------
    points : array_like, shape (n, 2)
        Metres, n >= 3.
    diameter : float, optional
        Known diameter, m. Points on a pole cover less than half of the circle. With a free diameter
        centre and radius then trade off along the line of sight.

    Returns
    -------
    Circle
        The best circle from three starts: the algebraic circle, and a circle on either side of the
        points. Its covariance is NaN if a circle on the other side of the points fits as well, or
        if there are at most four points more than parameters. With a free radius it is also NaN if
        the radius is uncertain by 12 % or the points scatter by 15 % of it: such circles lie among
        the points.

    Raises
    ------
    ValueError
        If there are fewer than three points, or the diameter is not positive.

    Examples
    --------
    >>> turn = np.linspace(0, 2, 20)
    >>> arc = 5 + 0.1 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    >>> fit_circle(arc).centre.round(6).tolist(), round(fit_circle(arc, diameter=0.2).radius, 6)
    ([5.0, 5.0], 0.1)
    """
    from scipy.optimize import least_squares  # slow to import, and planes do not need it

    points = check_points(points, columns=2, minimum=3)
    origin = np.median(points, axis=0)
    xy = points - origin
    # the algebraic circle
    (a, b, c), *_ = np.linalg.lstsq(np.column_stack([xy, np.ones(len(xy))]), (xy**2).sum(axis=1))
    middle, algebraic = (a / 2, b / 2), np.sqrt(max(c + a**2 / 4 + b**2 / 4, 0.0))
    free = diameter is None
    radius = np.clip(algebraic, 0.01, 1.0) if free else check_positive(diameter, "diameter") / 2
    aside = radius * np.linalg.eigh(xy.T @ xy)[1][:, 0]  # across the points, to either side
    starts = [np.append(start, np.log(radius)) for start in (middle, aside, -aside)]

    def misfits(circle):
        """Distances of the points from a circle (x, y, and the log of a free radius)."""
        return np.hypot(*(circle[:2] - xy).T) - (np.exp(circle[2]) if free else radius)

    def slopes(circle):
        """The slopes of the distances."""
        off = circle[:2] - xy
        ways = off / np.maximum(np.hypot(*off.T), 1e-9)[:, None]
        return np.column_stack([ways, np.full((len(xy), int(free)), -np.exp(circle[2:]))])

    fits = [
        least_squares(misfits, start[: 2 + free], slopes, loss="cauchy", f_scale=FAR, x_scale="jac")
        for start in starts
    ]
    circles, costs = [fit.x for fit in fits], np.array([fit.cost for fit in fits])
    best = np.argmin(costs)
    centre = circles[best][:2]
    radius = float(np.exp(circles[best][2])) if free else radius
    off, ways = misfits(circles[best]), slopes(circles[best])
    pulls = off / (1 + (off / FAR) ** 2)
    normal = fits[best].jac.T @ fits[best].jac  # scaled by the loss
    freedom, covariance = len(xy) - ways.shape[1], np.full((2, 2), np.nan)
    # a rival lies more than half a radius away, 120 degrees or more about the points' middle
    others = np.array(circles)[:, :2]
    apart = np.hypot(*(others - centre).T) > radius / 2
    rivals = apart & (others @ centre < -0.5 * np.hypot(*others.T) * np.hypot(*centre))
    ratio = np.min(costs[rivals], initial=np.inf) / max(costs[best], 1e-300)
    # the log likelihood ratio to the best rival must be above 5
    if np.linalg.cond(normal) < 1e10 and freedom > 4 and freedom * np.log(ratio) > 10:
        inverse = np.linalg.inv(normal)
        effects = inverse @ (ways * pulls[:, None]).T
        # from each residual and from their mean; less two, since their spread is uncertain itself
        each = len(xy) / (freedom - 2) * effects @ effects.T
        alike = pulls @ off / (freedom - 2) * inverse
        larger = max(each, alike, key=lambda one: np.trace(one[:2, :2]))
        scatter = np.sqrt(pulls @ off / freedom) / radius
        # beyond these limits the errors of the centre are not normal
        if not free or (larger[2, 2] < 0.12**2 and scatter < 0.15):
            covariance = larger[:2, :2]
    return Circle(origin + centre, float(radius), covariance)


def _principal_axes(points, robust):
    """Mean, weighted centre from it, and directions by extent, largest component positive."""
    origin = points.mean(axis=0)
    local = points - origin
    previous = np.ones(len(local))
    centre, vectors = _principal(local, previous)
    for _ in range(50 if robust else 0):
        residuals = (local - centre) @ vectors[0]
        sigma = sigma_mad(residuals)
        if sigma == 0:
            break
        u = (residuals - np.median(residuals)) / (TUKEY * sigma)
        weights = np.where(np.abs(u) < 1, (1 - u**2) ** 2, 0.0)
        if np.abs(weights - previous).max() < 1e-6:
            break
        centre, vectors = _principal(local, weights)
        previous = weights
    signs = np.sign(vectors[np.arange(len(vectors)), np.abs(vectors).argmax(axis=1)])
    return origin, centre, vectors * signs[:, None]


def _principal(local, weights):
    """Weighted centre and the principal directions as rows, smallest extent first."""
    centre = weights @ local / weights.sum()
    centred = local - centre
    scatter = (centred * weights[:, None]).T @ centred
    values, vectors = np.linalg.eigh(scatter)
    if values[1] <= 1e-12 * values[-1] or values[-1] <= 0:
        shape = "line or spot. Must span a plane" if len(values) == 3 else "spot. Must span a line"
        raise ValueError(f"Invalid points: {len(local)} of them on one {shape}.")
    return centre, vectors.T


CELLS_PER_SIZE, LEAST_AREA = 4, 0.25
"""Cells of the grid along the smallest plane, and its least area in squared sizes (1 m2 at 2 m).
Points of a plane are connected across one cell."""

FEWEST = 10, 30
"""Limits of the least number of points of a plane; its least area sets the number in between."""

USUAL_SIZES = 1.5, 2.0, 3.0
"""Default extents of the smallest plane, m: for points that fill the cells, for scan lines that are
too far apart for that, and the largest extent, for thin clouds."""

TRIM, TRIMMED = 2.5, 1.05
"""Points farther from their plane than TRIM standard deviations are not fitted. The factor TRIMMED
corrects the standard deviation of trimmed normal errors, and that of their mean."""

LEAST_TRIAL = 6
"""Least number of points of a trial."""


@dataclass(frozen=True, eq=False)
class Patch:
    """A connected planar part of a cloud.

    Parameters
    ----------
    plane : Plane
        Fitted to the points that lie within 2.5 standard deviations of this plane and on no
        neighbouring plane.
    index : array of int, shape (n,)
        Rows of the cloud within the tolerance, nearest to this plane.
    clear : array of int, shape (m,)
        Those of them whose foot on the plane is clear of all other planes.
    moments : array, shape (2,)
        Sums of the squared coordinates of the fitted points along the plane's axes, square metres.
    sigma : float
        Standard deviation of the points about the plane, m, if their errors are independent.
    """

    plane: Plane
    index: np.ndarray
    clear: np.ndarray
    moments: np.ndarray
    sigma: float

    def __len__(self):
        return len(self.index)

    def offset_variance(self, point: np.ndarray) -> float:
        """Variance of the plane's height at a point (3,), m^2, for independent residuals."""
        square = self.plane.project(point[None])[0] ** 2
        return (TRIMMED * self.sigma) ** 2 * (1 / self.plane.n + (square / self.moments).sum())


def detect_planes(points: ArrayLike, *, tolerance: float = 0.05, size: float = 2.0) -> list[Patch]:
    """Find the planes of a cloud of any size.

    The space is cut into cells with an edge of a quarter of ``size``. In every block of eight cells
    planes through three neighbouring points are tried around the fullest cell. The plane with most
    points of the neighbourhood is fitted to them. The best of these planes grow first, cell by
    cell, are fitted again and grow again. The trials are repeated among the remaining points. At
    the end each point goes to the nearest plane around it. The planes are then fitted again to the
    points that belong to a single plane.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Metres.
    tolerance : float
        Largest distance of a point from its plane, m: about three times the noise.
    size : float
        Extent of the smallest plane sought, m. Points of a plane are connected across gaps of up to
        a quarter of ``size``, which should exceed the distance between scan lines. The least area
        of a plane is a quarter of ``size`` squared. The least number of points is the number on
        that area, limited to 10 to 30.

    Returns
    -------
    list of Patch
        Sorted by number of points, largest first; empty if there is no plane.

    Raises
    ------
    ValueError
        If a setting is not positive, a coordinate is not finite, or the cloud has too many cells to
        number.

    Warns
    -----
    UserWarning
        If the cloud is too thin for planes of this size.

    Notes
    -----
    Time and memory grow linearly with the number of points. Equal clouds give equal planes. A
    curved or rough surface gives several planes or none. Planes closer to each other than the
    tolerance are merged.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), section 3: edges where principal planes meet.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> flat = rng.uniform(0, 5, (1500, 3))
    >>> floor, wall = flat * [1, 1, 0], flat * [1, 0, 1]
    >>> [len(patch) > 1400 for patch in detect_planes(np.concatenate([floor, wall]))]
    [True, True]
    """
    points = check_points(points, minimum=0)
    tolerance = check_positive(tolerance, "tolerance", unit="m")
    size = check_positive(size, "size", unit="m")
    if len(points) < FEWEST[0]:
        return []
    grid = Grid(points, size / CELLS_PER_SIZE)
    in_cell = _points_per_cell(grid.start)
    if in_cell < 1:  # surfaces are not connected
        least = size / np.sqrt(in_cell)
        warnings.warn(
            f"Too few points for planes of {size:g} m. Must have a size of {least:.2g} m or more.",
            stacklevel=2,
        )
    minimum = int(np.clip(LEAST_AREA * CELLS_PER_SIZE**2 * in_cell, *FEWEST))
    search = _Search(grid, tolerance, minimum)
    for _ in range(4):
        if not search.round():
            break
    owner, clear = (values[np.argsort(grid.order)] for values in search.assigned())
    return _patches(points, owner, clear, tolerance, minimum)


def usual_size(points):
    """Extent of the smallest plane that points (n, 3) support, m."""
    if not len(points):
        return USUAL_SIZES[1]
    _, starts, fine = sort_into_cells(points, USUAL_SIZES[0] / CELLS_PER_SIZE)
    doubled = sort_into_cells(fine, 2)[2]
    in_cell = _points_per_cell(starts)
    at_random = 4 * np.expm1(-in_cell) / np.expm1(-4 * in_cell)
    filled = len(fine) >= 0.8 * at_random * len(doubled)
    # of 2.4 to 4.4 points per cell, 2.8 to 3.8 gave most edges on simulated streets
    carried = USUAL_SIZES[0] * np.sqrt(3.2 / in_cell)
    return float(np.clip(carried, USUAL_SIZES[0 if filled else 1], USUAL_SIZES[2]))


def _points_per_cell(start):
    """Mean number of points per cell of a surface, its empty cells included.

    With a mean of x, the occupied cells (bounded by ``start``) have x / (1 - exp(-x)) on average.
    """
    seen = np.median(np.diff(start)[:: max(1, len(start) // 100_000)])
    mean = max(float(np.diff(start).mean()), 1.0 + 1e-9) if seen < 3 else seen
    return mean + lambertw(-mean * np.exp(-mean)).real


def _patches(points, owner, clear, tolerance, minimum):
    """Fitted patches of each owner's points; groups without a clear plane are left out."""
    patches = []
    for index in _members(owner, owner.max() + 1):
        fitted = index[clear[index]]
        if len(index) < minimum or len(fitted) < 3:
            continue
        plane = fit_plane(points[fitted])
        width = np.std(plane.project(points[fitted])[:, 1])
        # points without any plane have a ratio of 0.58
        if plane.std > 0.48 * tolerance or width < 1.2 * tolerance:
            continue
        # points of window reveals lie on one side of a wall, within the tolerance
        for _ in range(2):
            most = TRIM * max(sigma_mad(plane.residuals), 0.02 * tolerance)
            core = fitted[np.abs(plane.distances(points[fitted])) <= most]
            plane = fit_plane(points[core])
        moments = (plane.project(points[core]) ** 2).sum(axis=0)
        sigma = TRIMMED * np.sqrt((plane.residuals**2).sum() / max(len(core) - 3, 1))
        patches.append(Patch(plane, index, fitted, moments, float(sigma)))
    return sorted(patches, key=len, reverse=True)


class Grid:
    """Points sorted into the cubic cells that they occupy.

    ``points`` are relative to their mean and in the order of the cells; ``order`` has their rows in
    the cloud, ``cell`` their cells. ``start`` bounds the cells and ``size`` counts their points.
    ``near`` (cells, cells) is true where two cells are the same or touch. ``places`` has the
    indices of the cells.
    """

    def __init__(self, points, edge):
        self.edge, low = edge, points.min(axis=0)
        self.order, self.start, self.places = sort_into_cells(points - low, edge)
        self.points = (points - points.mean(axis=0))[self.order]
        self.size = np.diff(self.start)
        n = len(self.size)
        self.cell = np.repeat(np.arange(n), self.size)
        pairs = cKDTree(self.places).query_pairs(1, p=np.inf, output_type="ndarray").T
        half = csr_array((np.ones(pairs.shape[1], dtype=bool), pairs.astype(np.int32)), (n, n))
        self.near = csr_array(half + half.T + eye_array(n, dtype=bool))

    def rows(self, cells):
        """Rows of the points in some cells, and the index at which each cell begins."""
        first = np.cumsum(self.size[cells]) - self.size[cells]
        total = self.size[cells].sum()
        return np.repeat(self.start[cells] - first, self.size[cells]) + np.arange(total), first

    def around(self, cells):
        """The given cells and all cells that touch one of them."""
        return np.unique(self.near[cells].indices)


class _Search:
    """Planes found so far and the points that they own."""

    def __init__(self, grid, tolerance, least_points):
        self.grid, self.tolerance, self.least = grid, tolerance, least_points
        self.owner = np.full(len(grid.points), -1)
        self.seen, self.spreads = np.zeros(len(grid.size), dtype=int), 0
        self.planes, self.taken = [], []
        self.trials = np.random.default_rng(0).random((32, 3))

    def round(self):
        """Try planes among the free points and grow them; return whether any was found."""
        grid, before = self.grid, len(self.planes)
        free = np.flatnonzero(self.owner < 0)
        counts = np.bincount(grid.cell[free], minlength=len(grid.size))
        # the fullest cell of every block of eight
        fullest = np.argsort(-counts, kind="stable")[: np.count_nonzero(counts)]
        seeds = fullest[np.unique(grid.places[fullest] // 2, axis=0, return_index=True)[1]]
        first = np.searchsorted(grid.cell[free], np.arange(len(counts)))
        rank = np.arange(len(free)) - first[grid.cell[free]]
        # about three points per cell, so that dense and sparse parts count alike
        stride = -(-counts // 3)[grid.cell[free]]
        drawn = grid.points[free[rank % stride == 0]]
        tree, low = cKDTree(drawn), grid.points[grid.start[seeds]]
        pieces = []
        for part in np.array_split(low, len(low) // 1000 + 1):
            near = tree.query(part, 64, p=np.inf, distance_upper_bound=2.5 * grid.edge)[1]
            pieces.append(_pieces(drawn, near, self.trials, self.tolerance, grid.edge))
        scores, centres, normals = (np.concatenate(part) for part in zip(*pieces, strict=True))
        for k in np.argsort(-scores, kind="stable"):
            if scores[k] <= LEAST_TRIAL / 2:
                break
            self.grow(seeds[k], centres[k], normals[k])
        return len(self.planes) > before

    def grow(self, seed, centre, normal):
        """Keep the plane of the points connected with the cell of a seed, if it is large enough."""
        cells, grown = np.array([seed]), 0
        for _ in range(4):
            cells, rows, beside = self._spread(cells, centre, normal)
            if len(cells) < LEAST_AREA * CELLS_PER_SIZE**2 or len(rows) < self.least:
                return
            if len(cells) <= grown:
                break
            grown, (centre, normal) = len(cells), _fitted(self.grid.points[rows])
        if len(rows) < 1.5 * beside:  # a filled volume has twice as many points beside
            return
        self.owner[rows] = len(self.planes)
        self.planes.append((centre, normal))
        self.taken.append(cells)

    def _spread(self, front, centre, normal):
        """Connected cells that a plane takes, its free points in them, number of points beside."""
        cells, rows, beside = [], [], 0
        self.spreads += 1
        while len(front):
            self.seen[front] = self.spreads
            within, first = self.grid.rows(front)
            off = np.abs((self.grid.points[within] - centre) @ normal)
            free = self.owner[within] < 0
            on = free & (off <= self.tolerance)
            # tails of a noisy wall and strips of a floor have a smaller share
            least = np.maximum(1, 0.25 * self.grid.size[front])
            takes = np.add.reduceat(on, first, dtype=int) >= least
            cells.append(front[takes])
            rows.append(within[on & np.repeat(takes, self.grid.size[front])])
            beside += (free & (off <= 3 * self.tolerance)).sum() - len(rows[-1])
            front = self.grid.around(cells[-1])
            front = front[self.seen[front] < self.spreads]
        return np.concatenate(cells), np.concatenate(rows), beside

    def assigned(self):
        """Owner (the nearest plane) of each point, and whether it is the only plane.

        The owner is -1 if no plane is within the tolerance. A plane is the only plane of a point if
        the foot of the point on it is clear of all others. With this rule noise removes as many
        points on one side of the plane as on the other.
        """
        grid, points, planes = self.grid, self.grid.points, list(self.planes)
        around = [grid.rows(grid.around(cells))[0] for cells in self.taken]
        for _ in range(2):
            least = np.full(len(points), self.tolerance)
            owner, height = np.full(len(points), -1), np.zeros(len(points))
            for k, (centre, normal) in enumerate(planes):
                rows = around[k]
                off = (points[rows] - centre) @ normal
                nearer = np.abs(off) <= least[rows]
                rows, off = rows[nearer], off[nearer]
                owner[rows], height[rows], least[rows] = k, off, np.abs(off)
            clear, normals = owner >= 0, np.array([normal for _, normal in planes]).reshape(-1, 3)
            for k, (centre, normal) in enumerate(planes):
                rows = around[k][(owner[around[k]] >= 0) & (owner[around[k]] != k)]
                foot = (points[rows] - centre) @ normal
                foot -= (normals @ normal)[owner[rows]] * height[rows]
                clear[rows] &= np.abs(foot) > self.tolerance
            for k, rows in enumerate(_members(np.where(clear, owner, -1), len(planes))):
                if len(rows) >= 3:
                    planes[k] = _fitted(points[rows])
        return owner, clear


def _members(owner, number):
    """Rows of the points of each owner."""
    order = np.argsort(owner, kind="stable")
    return np.split(order, np.searchsorted(owner[order], np.arange(number + 1)))[1:-1]


def _fitted(points):
    """Centre and unit normal of the least-squares plane."""
    centre = points.mean(axis=0)
    local = points - centre
    return centre, np.linalg.eigh(local.T @ local)[1][:, 0]


def _pieces(drawn, near, trials, tolerance, edge):
    """Planes fitted to what the best planes of three points take: score, centre, normal."""
    there = near < len(drawn)
    local = np.concatenate([drawn, np.zeros((1, 3))])[near]
    picks = (trials * there.sum(axis=1)[:, None, None]).astype(int)
    a, b, c = (np.take_along_axis(local, picks[..., i, None], axis=1) for i in range(3))
    across = np.cross(b - a, c - a)
    area = np.linalg.norm(across, axis=2)
    normals = across / np.maximum(area, 1e-12)[..., None]
    off = np.abs(np.einsum("std,snd->stn", normals, local) - (normals * a).sum(axis=2)[..., None])
    on = (off <= tolerance) & there[:, None]
    votes = on.sum(axis=2) * (area > 0.5 * edge**2)
    best = np.arange(len(votes)), votes.argmax(axis=1)
    on = on[best]
    number = np.maximum(on.sum(axis=1), 1)
    centre = (local * on[..., None]).sum(axis=1) / number[:, None]
    shifted = (local - centre[:, None]) * on[..., None]
    values, vectors = np.linalg.eigh(shifted.swapaxes(1, 2) @ shifted)
    # points without any plane have a mean square residual of a third of the squared tolerance
    score = number * (1 - values[:, 0] / number / (tolerance**2 / 3))
    good = votes.max(axis=1) >= LEAST_TRIAL
    return np.where(good, score, 0.0), centre, vectors[:, :, 0]
