"""Circles fitted to points in plan: poles, seen from one side or from all round."""

from dataclasses import dataclass

import numpy as np

from mmqa_lab._checks import check_points, check_positive
from mmqa_lab.planes.regression import sigma_mad


@dataclass(frozen=True, eq=False)
class Circle:
    """A circle fitted to points in plan.

    Parameters
    ----------
    centre : array, shape (2,)
        m.
    radius : float
        m; as given where it was.
    std : float
        Standard deviation of a coordinate of the centre, m; NaN where the arc leaves it open.

    Examples
    --------
    >>> circle = fit_circle([[1.0, 0], [0, 1], [-1, 0], [0, -1]])
    >>> round(circle.radius, 6)
    1.0
    """

    centre: np.ndarray
    radius: float
    std: float


def fit_circle(points, *, diameter=None, scale=0.01):
    """Fit a circle to points in plan, robustly: Cauchy loss of the distances from it.

    Parameters
    ----------
    points : array_like, shape (n, 2)
        Metres, n >= 3.
    diameter : float, optional
        Where it is known, m. Points of a pole cover less than half of the circle: with a free
        diameter centre and radius trade off along the line of sight.
    scale : float
        Distances beyond this weigh less, m.

    Returns
    -------
    Circle
        The best one from seven starts: the algebraic circle, and circles beside the points.

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
    from scipy.optimize import least_squares

    points = check_points(points, columns=2, minimum=3)
    origin = np.median(points, axis=0)
    xy = points - origin
    x, y, algebraic = algebraic_circle(xy)
    free = diameter is None
    radius = np.clip(algebraic, 0.01, 1.0) if free else check_positive(diameter, "diameter") / 2
    turn = np.arange(0, 2 * np.pi, np.pi / 3)
    around = radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)

    def misfit(p):
        """Distances from the circle."""
        return np.hypot(*(xy - p[:2]).T) - (np.exp(p[2]) if free else radius)

    def jacobian(p):
        """Derivatives of the distances."""
        off = p[:2] - xy
        away = off / np.maximum(np.hypot(*off.T), 1e-9)[:, None]
        return np.column_stack([away, np.full(len(xy), -np.exp(p[2]))]) if free else away

    choices = {"jac": jacobian, "loss": "cauchy", "f_scale": scale}
    fits = [
        least_squares(misfit, [*start, np.log(radius)][: 2 + free], **choices)
        for start in [(x, y), *around]
    ]
    best = min(fits, key=lambda fit: fit.cost)
    normal = best.jac.T @ best.jac
    std = np.nan
    if np.linalg.cond(normal) < 1e10:
        covariance = sigma_mad(misfit(best.x)) ** 2 * np.linalg.inv(normal)
        std = float(np.sqrt(np.trace(covariance[:2, :2]) / 2))
    return Circle(origin + best.x[:2], float(np.exp(best.x[2]) if free else radius), std)


def algebraic_circle(xy):
    """Return centre x, centre y and radius of the circle with the least algebraic distance.

    Parameters
    ----------
    xy : array, shape (n, 2)

    Returns
    -------
    tuple of 3 float

    Examples
    --------
    >>> corners = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 2.0], [2.0, 2.0]])
    >>> [round(float(value), 3) for value in algebraic_circle(corners)]
    [1.0, 1.0, 1.414]
    """
    design = np.column_stack([xy, np.ones(len(xy))])
    (a, b, c), *_ = np.linalg.lstsq(design, (xy**2).sum(axis=1), rcond=None)
    return a / 2, b / 2, np.sqrt(max(c + a**2 / 4 + b**2 / 4, 0.0))
