"""Choosing reference points on the ground from a survey that is better than the clouds to test."""

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_count, check_points, check_positive
from mmqa_lab.planes import fit_plane


def ground_reference(
    points, *, grid=1.0, radius=0.2, deviation_limit=0.005, fewest=8, slope_limit=20.0
):
    """Choose reference points where a static survey shows flat, smooth ground.

    The plan is cut into squares. In each, the lowest tenth of the points marks the ground; the
    ground point nearest the middle of the square is taken (thinning), a plane is fitted to the
    ground points around it, and it is kept where that plane is not steep, its residuals stay below
    the limit, and so does its own.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Static scans or levelled points, metres.
    grid : float
        Side of the squares, m: one reference point each at most.
    radius : float
        Of the neighbourhood, m.
    deviation_limit : float
        Largest rms deviation of the neighbourhood, and deviation of the point, m.
    fewest : int
        Points a neighbourhood must have.
    slope_limit : float
        Degrees.

    Returns
    -------
    DataFrame
        ``x_m``, ``y_m``, ``z_m`` (on the fitted plane), ``rms_m``, ``slope_deg``, ``n``.

    Raises
    ------
    ValueError
        If a point is not finite, a length is not above zero or ``fewest`` is below four.

    References
    ----------
    EuroSDR 2013, mobile laser scanning, section 3.1.2.3. There classified ground was gridded to
    5 cm, every thousandth point was kept, and points more than 5 mm from the original ground were
    dropped; squares, lowest points and fitted planes are our way.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(0.05, 3, 0.1), np.arange(0.05, 2, 0.1))
    >>> flat = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3)
    >>> len(ground_reference(flat))
    6
    """
    from scipy.spatial import cKDTree

    points = check_points(points)
    side = check_positive(grid, "grid", unit="m")
    limit = check_positive(deviation_limit, "deviation_limit", unit="m")
    fewest = check_count(fewest, "fewest", low=4)
    origin = points.min(axis=0)
    local = points - origin
    ground = local[_low(local, side)]
    chosen = _thinned(ground, side)
    tree = cKDTree(ground[:, :2])
    around = tree.query_ball_point(ground[chosen, :2], check_positive(radius, "radius", unit="m"))
    rows = []
    for point, index in zip(ground[chosen], around, strict=True):
        if len(index) < fewest:
            continue
        plane = _plane(ground[index])
        if plane is None:
            continue
        slope = np.degrees(np.arccos(min(abs(plane.normal[2]), 1.0)))
        own = plane.distances(point[None])[0]
        if plane.rms <= limit and abs(own) <= limit and slope <= slope_limit:
            z = point[2] - own / plane.normal[2]
            rows.append((*(np.array([*point[:2], z]) + origin), plane.rms, slope, len(index)))
    return pd.DataFrame(rows, columns=["x_m", "y_m", "z_m", "rms_m", "slope_deg", "n"])


def thinned(points, side):
    """Return one point of each square in plan: the one nearest its middle.

    Parameters
    ----------
    points : array_like, shape (n, 3)
    side : float
        Of the squares, m.

    Returns
    -------
    array, shape (m, 3)

    Raises
    ------
    ValueError
        If a point is not finite or the side is not above zero.

    Examples
    --------
    >>> thinned([[0.1, 0.1, 0], [0.4, 0.5, 1], [1.5, 0.5, 2]], 1.0).tolist()
    [[0.4, 0.5, 1.0], [1.5, 0.5, 2.0]]
    """
    points = check_points(points)
    side = check_positive(side, "side", unit="m")
    local = points - np.floor(points.min(axis=0) / side) * side
    return points[_thinned(local, side)]


def _plane(points):
    """The plane of points, or None where they lie on a line."""
    try:
        return fit_plane(points)
    except ValueError:
        return None


def _squares(local, side):
    """Number of the square each point lies in."""
    cell = (local[:, :2] // side).astype(np.int64)
    return cell[:, 0] * (cell[:, 1].max() + 1) + cell[:, 1]


def _low(local, side, band=0.15):
    """Which points lie within a band above the lowest tenth of their square."""
    square = pd.Series(_squares(local, side))
    height = pd.Series(local[:, 2])
    base = height.groupby(square).quantile(0.1)
    return (height - square.map(base)).abs().to_numpy() < band


def _thinned(ground, side):
    """Index of the point nearest the middle of each square."""
    off = ground[:, :2] % side - side / 2
    table = pd.DataFrame({"square": _squares(ground, side), "gap": np.hypot(*off.T)})
    return table.groupby("square")["gap"].idxmin().to_numpy()
