"""Planes, lines and circles fitted to points, and the dispersion of points about them.

Pfeifer et al. 2021 (doi 10.3390/rs13020237), section 3.3 and Appendix A: the plane of a chart is
the orthogonal regression plane of its points; sigma_MAD of the residuals is the precision.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_choice, check_number, check_points, check_positive, real_array
from mmqa_lab._results import Shown, about
from mmqa_lab.stats import CONSISTENT_SCALE

__all__ = [
    "CONSISTENT_SCALE", "PAPER_SCALE", "TUKEY", "Circle", "Line", "Plane", "fit_circle",
    "fit_line", "fit_plane", "flat_points", "sigma_mad",
]  # fmt: skip

# The factor in the code of Pfeifer et al. 2021, Appendix A (1.4826 with two digits swapped).
PAPER_SCALE = 1.4862

# Tukey's biweight constant, 95 % efficient for normal residuals (Huber & Ronchetti 2009).
TUKEY = 4.685

# Distances from a circle beyond this get less weight, m.
FAR_FROM_CIRCLE_M = 0.01


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
            tilted = f"tilted by {np.degrees(np.arcsin(slope)):.3f} degrees"
            wanted = "0.1 degrees or more for horizontal axes"
            raise ValueError(f"Invalid plane, {tilted}. Must be {wanted}.")
        level /= slope
        return np.array([level, np.cross(self.normal, level)])

    def directions(self, axes: str | float) -> np.ndarray:
        """Return principal or horizontal axes (2, 3), or principal ones turned by degrees."""
        if not isinstance(axes, str):
            turn = np.radians(check_number(axes, "axes", unit="degrees"))
            return (
                np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) @ self.axes
            )
        check_choice(axes, "axes", ("principal", "horizontal"))
        return self.axes if axes == "principal" else self.horizontal_axes()


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

    See Also
    --------
    mmqa_lab.plane_search.detect_planes : all planes of a cloud.

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
    return checked_plane(check_points(points, minimum=3), robust)


def checked_plane(points, robust=False):
    """Return the plane of points that are checked."""
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
    points = check_points(points, name="xy", columns=None, minimum=minimum)
    if points.shape[1] != 3:
        return check_points(points, name="xy", columns=2, minimum=minimum)
    check_points(points, name="xy", minimum=max(minimum, 3))
    return checked_plane(points).project(points)


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
    """Return the robust standard deviation: scale x median(|r - median r|).

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

    See Also
    --------
    mmqa_lab.stats.errors : bias, RMSE and NMAD of errors whose zero is known.

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
    residuals = real_array(residuals, "residuals").astype(np.float64)
    if residuals.ndim != 1 or not len(residuals) or not np.isfinite(residuals).all():
        shape = residuals.shape
        raise ValueError(f"Invalid residuals of shape {shape}. Must be a row of finite numbers.")
    scale = check_positive(scale, "scale")
    return float(scale * np.median(np.abs(residuals - np.median(residuals))))


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

    def _ends(self):
        rows = zip(("x", "y"), self.centre, np.sqrt(np.diag(self.covariance)), strict=True)
        return [about(*row, "m") for row in rows]

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

    settings = {"loss": "cauchy", "f_scale": FAR_FROM_CIRCLE_M, "x_scale": "jac"}
    fits = [least_squares(misfits, start[: 2 + free], slopes, **settings) for start in starts]
    circles, costs = [fit.x for fit in fits], np.array([fit.cost for fit in fits])
    best = np.argmin(costs)
    centre = circles[best][:2]
    radius = float(np.exp(circles[best][2])) if free else radius
    off, ways = misfits(circles[best]), slopes(circles[best])
    pulls = off / (1 + (off / FAR_FROM_CIRCLE_M) ** 2)
    normal = fits[best].jac.T @ fits[best].jac  # scaled by the loss
    places = len(np.unique(xy, axis=0))  # a row that is there twice says nothing new
    freedom, covariance = places - ways.shape[1], np.full((2, 2), np.nan)
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
        scatter = np.sqrt(pulls @ off / freedom * places / len(xy)) / radius
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
    largest = np.abs(vectors).round(9).argmax(axis=1)  # the first of equal ones
    signs = np.sign(vectors[np.arange(len(vectors)), largest])
    return origin, centre, vectors * signs[:, None]


def _principal(local, weights):
    """Weighted centre and the principal directions as rows, smallest extent first."""
    centre = weights @ local / weights.sum()
    centred = local - centre
    scatter = (centred * weights[:, None]).T @ centred
    values, vectors = np.linalg.eigh(scatter)
    if values[1] <= 1e-12 * values[-1] or values[-1] <= 0:
        shape = "line or spot. Must span a plane" if len(values) == 3 else "spot. Must span a line"
        used = np.count_nonzero(weights)
        raise ValueError(
            f"Invalid points: {used} of {len(local)} that count on one {shape}."
            if used < len(local)
            else f"Invalid points: {used} of them on one {shape}."
        )
    return centre, vectors.T
