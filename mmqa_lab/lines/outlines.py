"""The outline of a rectangular board in a cloud: four edges where a single plane ends."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import ConvexHull

from mmqa_lab._checks import check_points
from mmqa_lab.lines.geometry import Segments
from mmqa_lab.planes import Plane, fit_plane


@dataclass(frozen=True, eq=False)
class Outline:
    """A rectangle fitted to the outline of a planar set of points.

    Parameters
    ----------
    corners : array, shape (4, 3)
        In order around the rectangle, m.
    size : array, shape (2,)
        The longer and the shorter side, m.
    sigma : array, shape (2,)
        Standard deviation of either side, m.
    residuals : array, shape (k,)
        Signed distances of the k outline points from the rectangle, outside positive, m.
    plane : Plane

    Examples
    --------
    >>> x, z = np.mgrid[0:1:0.005, 0:0.51:0.02].reshape(2, -1)
    >>> board = fit_outline(np.stack([x, 0 * x, z], axis=1), lines=z)
    >>> board.size.round(1).tolist(), len(board.segments)
    ([1.0, 0.5], 4)
    """

    corners: np.ndarray
    size: np.ndarray
    sigma: np.ndarray
    residuals: np.ndarray
    plane: Plane

    @property
    def segments(self):
        """The four edges, in the order of the corners."""
        return Segments(np.stack([self.corners, np.roll(self.corners, -1, axis=0)], axis=1))


def fit_outline(points, *, lines=None):
    """Fit a rectangle to the outline of a board.

    The points are projected on their plane. The outline points are the ends of the scan lines,
    moved out by half of the line's point spacing (the edge lies anywhere within one spacing
    beyond the last point), or the convex hull when no lines are known. The rectangle with the least
    robust distances (soft L1 of 1 cm) from them is sought from eight turned starts.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        A board and nothing else, m.
    lines : array_like, shape (n,), optional
        Scan line (ring) of each point.

    Returns
    -------
    Outline

    Raises
    ------
    ValueError
        If fewer than eight outline points remain, or ``lines`` has another length.

    Notes
    -----
    Points that a beam split by the edge returned lie beyond it; the size then comes out too large
    by part of the footprint.

    Examples
    --------
    >>> z, y = np.mgrid[-1:1:0.1, -1:1:0.005].reshape(2, -1)
    >>> board = (np.abs(0.8 * y + 0.6 * z) < 0.4) & (np.abs(0.8 * z - 0.6 * y) < 0.3)
    >>> y, z = y[board], z[board]
    >>> fit_outline(np.stack([0 * y, y, z], axis=1), lines=z).size.round(2).tolist()
    [0.8, 0.6]
    """
    points = check_points(points, minimum=8)
    plane = fit_plane(points, robust=True)
    flat = plane.project(points)
    outline = flat[ConvexHull(flat).vertices] if lines is None else _line_ends(flat, lines)
    if len(outline) < 8:
        raise ValueError(f"Invalid outline of {len(outline)} points. Must have 8 or more.")
    fits = [_fitted(outline, turn) for turn in np.radians(np.arange(0, 90, 11.25))]
    best = min(fits, key=lambda fit: fit.cost)
    x, y, turn, length, width = best.x
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    corners = [x, y] + signs * [length / 2, width / 2] @ axes
    freedom = max(1, len(outline) - 5)
    variance = (best.fun**2).sum() / freedom * np.diag(np.linalg.pinv(best.jac.T @ best.jac))
    order = np.argsort([-length, -width])
    return Outline(
        corners=plane.centre + corners @ plane.axes,
        size=np.array([length, width])[order],
        sigma=np.sqrt(variance[3:])[order],
        residuals=best.fun,
        plane=plane,
    )


def _line_ends(flat, lines):
    """Both ends of each scan line with four points or more, half a spacing further out."""
    lines = np.asarray(lines)
    if lines.shape != (len(flat),):
        raise ValueError(f"Invalid lines of shape {lines.shape}. Must be ({len(flat)},).")
    ends = []
    for line in np.unique(lines):
        members = flat[lines == line]
        if len(members) < 4:
            continue
        centred = members - members.mean(axis=0)
        direction = np.linalg.svd(centred, full_matrices=False)[2][0]
        along = np.sort(centred @ direction)
        step = np.median(np.diff(along)) / 2
        order = np.argsort(centred @ direction)
        ends += [members[order[0]] - step * direction, members[order[-1]] + step * direction]
    return np.array(ends).reshape(-1, 2)


def _fitted(outline, turn):
    """Least squares from a rectangle turned by ``turn`` about the outline's middle."""
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    turned = outline @ axes.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    middle = (low + high) / 2 @ axes
    start = [*middle, turn, *(high - low)]
    return least_squares(_distances, start, args=(outline,), loss="soft_l1", f_scale=0.01)


def _distances(rectangle, outline):
    """Signed distances of points from a rectangle's outline, outside positive, m."""
    x, y, turn, length, width = rectangle
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    local = np.abs((outline - [x, y]) @ axes.T) - np.abs([length, width]) / 2
    outside = np.linalg.norm(np.maximum(local, 0), axis=1)
    return np.where((local > 0).any(axis=1), outside, local.max(axis=1))
