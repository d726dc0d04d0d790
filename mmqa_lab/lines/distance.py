"""The line-segment distance of Chen, Leung & Gao 2003 in closed form, for all pairs of two sets.

With e the direction of the line that stays, c the midpoints and L the lengths, rotating the other
line about its midpoint until it is parallel leaves

    d_theta = min(L_t, L_m) sin(angle between the lines)
    s       = (c_t - c_m) . e
    d_par   = max(0, |s| - |L_t - L_m| / 2)
    d_perp  = |(c_t - c_m) - s e|
    d       = sqrt(W d_theta^2 + d_par^2 + d_perp^2)

(Poreba & Goulette 2013, section 2.2 and equations 3-5). The sine comes from the cross product: the
arccosine of a scalar product is lost below 1e-8 rad. Differences are taken before products.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numba
import numpy as np

from mmqa_lab._checks import check_choice, check_number
from mmqa_lab.lines.geometry import check_segments, relative_ends

ROTATE = ("test", "shorter")
RANGE = ("containment", "overlap")
BLOCK_PAIRS = 500_000
"""Pairs that one thread takes at a time."""


@dataclass(frozen=True, eq=False)
class Components:
    """The parts of the distance for p x q pairs.

    Parameters
    ----------
    angle, parallel, perpendicular : array, shape (p, q)
        d_theta, d_par and d_perp, m.
    shift : array, shape (p, q)
        Midpoint of the test segment along the line that stays, from the model's midpoint, m.

    Raises
    ------
    ValueError
        If a weight is negative.

    Examples
    --------
    >>> parts = components([[[0, 0, 0], [4, 0, 0]]], [[[0, 3, 0], [4, 3, 0]]])
    >>> float(parts.perpendicular[0, 0]), float(parts.distance(10)[0, 0])
    (3.0, 3.0)
    """

    angle: np.ndarray
    parallel: np.ndarray
    perpendicular: np.ndarray
    shift: np.ndarray

    def distance(self, weight):
        """Return d for a weight W >= 0 of the angle, shape (p, q), m (equation 5)."""
        weight = check_number(weight, "weight", low=0)
        return np.sqrt(weight * self.angle**2 + self.parallel**2 + self.perpendicular**2)


def components(test, model, *, rotate="test", within="containment"):
    """Angle, parallel and perpendicular distances of every test to every model segment.

    Parameters
    ----------
    test, model : Segments or array_like
        p and q segments, m.
    rotate : {"test", "shorter"}
        Which line is turned about its midpoint: always the one of the test set (Poreba & Goulette
        2013, section 2.2) or the shorter one of each pair (Gao & Leung 2002).
    within : {"containment", "overlap"}
        When the parallel distance vanishes: one segment lies within the range of the other (figure
        2 of the paper), or they overlap at all.

    Returns
    -------
    Components

    Notes
    -----
    The distance is not a metric: nested collinear segments are at distance zero, the triangle
    inequality fails, and with ``rotate="test"`` it is not symmetric.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), section 2.2, equations 3 and 4.

    Examples
    --------
    >>> parts = components([[[0, 0, 0], [4, 0, 0]]], [[[2, -5, 0], [2, 5, 0]]])
    >>> [float(part[0, 0]) for part in (parts.angle, parts.parallel, parts.perpendicular)]
    [4.0, 0.0, 0.0]
    """
    shape, arguments = _arguments(test, model, rotate, within)
    parts = [np.empty(shape) for _ in range(4)]
    _in_blocks(_components_block, shape, arguments, parts)
    return Components(*parts)


def distance_matrix(test, model, *, weight=10.0, rotate="test", within="containment"):
    """Distances d(W) of every test to every model segment: the similarity matrix.

    Parameters
    ----------
    test, model : Segments or array_like
        p and q segments, m.
    weight : float
        W of equation 5, >= 0: a larger W punishes angles more. (In Gao & Leung 2002 the angle's
        square is *divided* by W: there a larger W punishes them less.)
    rotate, within
        As in :func:`components`.

    Returns
    -------
    array, shape (p, q)
        Metres. Nothing larger than this array is kept in memory.

    Raises
    ------
    ValueError
        If the weight is negative or not finite, or a choice is unknown.

    Examples
    --------
    >>> d = distance_matrix([[[0, 0, 0], [4, 0, 0]]], [[[2, -5, 0], [2, 5, 0]]])
    >>> round(float(d[0, 0]), 6)
    12.649111
    """
    weight = check_number(weight, "weight", low=0)
    shape, arguments = _arguments(test, model, rotate, within)
    distances = np.empty(shape)
    _in_blocks(_distances_block, shape, (*arguments, weight), [distances])
    return distances


def _arguments(test, model, rotate, within):
    """Shape of the matrix and the arrays that the compiled blocks read."""
    check_choice(rotate, "rotate", ROTATE)
    check_choice(within, "within", RANGE)
    test, model = check_segments(test, name="test"), check_segments(model, name="model")
    sides = []
    for ends in relative_ends(test, model):
        vectors = ends[:, 1] - ends[:, 0]
        lengths = np.linalg.norm(vectors, axis=1)
        middles = ends[:, 0] + vectors / 2
        columns = [middles, vectors / lengths[:, None], lengths[:, None]]
        sides.append(np.ascontiguousarray(np.concatenate(columns, axis=1).T))
    shape = (len(test), len(model))
    return shape, (*sides, rotate == "shorter", within == "overlap")


def _in_blocks(kernel, shape, arguments, outputs):
    """Run a compiled kernel over blocks of rows, in threads when there are many pairs."""
    rows = max(1, BLOCK_PAIRS // max(1, shape[1]))
    starts = range(0, shape[0], rows)

    def block(start):
        kernel(start, min(start + rows, shape[0]), *arguments, *outputs)

    if len(starts) > 1:
        with ThreadPoolExecutor() as threads:
            list(threads.map(block, starts))
    else:
        for start in starts:
            block(start)


@numba.njit
def _parts(x, y, z, tx, ty, tz, t_length, u, v, w, mx, my, mz, m_length, shorter, overlap):
    """Squared d_theta, d_par, squared d_perp and s of one pair: midpoint, direction, length each.

    Scalars throughout and no branch: the loop over the models then fills whole vector registers.
    """
    least = min(t_length, m_length)
    cx, cy, cz = ty * mz - tz * my, tz * mx - tx * mz, tx * my - ty * mx
    angle2 = least * least * (cx * cx + cy * cy + cz * cz)
    stays = shorter & (m_length < t_length)
    ex, ey, ez = (tx if stays else mx), (ty if stays else my), (tz if stays else mz)
    dx, dy, dz = x - u, y - v, z - w
    s = dx * ex + dy * ey + dz * ez
    parallel = max(0.0, abs(s) - abs(t_length - m_length) / 2)
    parallel = 0.0 if overlap & (abs(s) < (t_length + m_length) / 2) else parallel
    px, py, pz = dx - s * ex, dy - s * ey, dz - s * ez
    return angle2, parallel, px * px + py * py + pz * pz, s


@numba.njit(nogil=True, cache=True)
def _distances_block(first, last, t, m, shorter, overlap, weight, distances):
    for i in range(first, last):
        x, y, z, tx, ty, tz, length = t[0, i], t[1, i], t[2, i], t[3, i], t[4, i], t[5, i], t[6, i]
        row = distances[i]
        for j in range(m.shape[1]):
            u, v, w, mx, my, mz, n = m[0, j], m[1, j], m[2, j], m[3, j], m[4, j], m[5, j], m[6, j]
            angle2, along, across2, _ = _parts(
                x, y, z, tx, ty, tz, length, u, v, w, mx, my, mz, n, shorter, overlap
            )
            row[j] = np.sqrt(weight * angle2 + along * along + across2)


@numba.njit(nogil=True, cache=True)
def _components_block(first, last, t, m, shorter, overlap, angle, parallel, perpendicular, shift):
    for i in range(first, last):
        x, y, z, tx, ty, tz, length = t[0, i], t[1, i], t[2, i], t[3, i], t[4, i], t[5, i], t[6, i]
        for j in range(m.shape[1]):
            u, v, w, mx, my, mz, n = m[0, j], m[1, j], m[2, j], m[3, j], m[4, j], m[5, j], m[6, j]
            angle2, along, across2, s = _parts(
                x, y, z, tx, ty, tz, length, u, v, w, mx, my, mz, n, shorter, overlap
            )
            angle[i, j], parallel[i, j] = np.sqrt(angle2), along
            perpendicular[i, j], shift[i, j] = np.sqrt(across2), s
