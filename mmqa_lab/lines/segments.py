"""Sets of 3-D line segments, and the distance of Chen, Leung & Gao 2003 between all pairs of two.

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

import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_choice, check_number

ROTATE = ("test", "shorter")
RANGE = ("containment", "overlap")
BLOCK_PAIRS = 500_000
"""Pairs that one thread takes at a time."""

FLOAT32_LIMIT_M = 1e5
"""Beyond this, float32 represents coordinates to 8 mm at best (IEEE 754: 24 bits)."""


@dataclass(frozen=True, eq=False)
class Segments:
    """Checked 3-D line segments with their lengths, directions and midpoints.

    Parameters
    ----------
    ends : array_like, shape (n, 2, 3), (n, 6), (n, 2, 2) or (n, 4)
        The two end points of each segment in metres; 2-D segments lie at height 0. Their order
        does not matter. n = 0 is allowed.
    name : str
        For tables and figures.

    Raises
    ------
    TypeError
        If the values are not real numbers.
    ValueError
        If the shape is wrong; if rows are not finite or of zero length (named); if float32
        coordinates go beyond 100 km: Lambert-93 northings are rounded to half a metre there.

    Warns
    -----
    UserWarning
        If lengths or coordinates look like another unit than metres.

    Examples
    --------
    >>> edges = Segments([[[0, 0, 0], [0, 0, 12]], [[0, 0, 12], [9, 0, 12]]])
    >>> len(edges), edges.lengths.tolist(), edges.midpoints.tolist()
    (2, [12.0, 9.0], [[0.0, 0.0, 6.0], [4.5, 0.0, 12.0]])
    >>> Segments([[[1, 2, 3], [1, 2, 3]]])
    Traceback (most recent call last):
    ValueError: Invalid segments: no length in row 0. Must have two different ends.
    """

    ends: np.ndarray
    name: str = ""

    def __post_init__(self):
        values = np.asarray(self.ends)
        ends = _as_ends(values)
        _refuse_coarse(values)
        _refuse_rows(~np.isfinite(ends).all(axis=(1, 2)), "not finite", "be finite coordinates")
        empty = (ends[:, 0] == ends[:, 1]).all(axis=1)
        _refuse_rows(empty, "no length", "have two different ends")
        object.__setattr__(self, "ends", ends)
        _warn_of_units(ends, self.lengths)

    def __len__(self):
        return len(self.ends)

    @property
    def vectors(self):
        """From the first end to the second, shape (n, 3), m."""
        return self.ends[:, 1] - self.ends[:, 0]

    @property
    def lengths(self):
        """Lengths, shape (n,), m."""
        return np.linalg.norm(self.vectors, axis=1)

    @property
    def directions(self):
        """Unit vectors from the first end to the second, shape (n, 3)."""
        return self.vectors / self.lengths[:, None]

    @property
    def midpoints(self):
        """Midpoints, shape (n, 3), m."""
        return self.ends[:, 0] + self.vectors / 2

    def select(self, which):
        """Return the segments where a mask is true, or those of an index array."""
        return Segments(self.ends[which], name=self.name)

    def moved(self, vector):
        """Return the segments shifted by one vector (3,) or one for each of them (n, 3), m."""
        vector = np.asarray(vector, dtype=np.float64)
        shift = vector[:, None] if vector.ndim == 2 else vector
        return Segments(self.ends + shift, name=self.name)

    def transformed(self, rotation, translation):
        """Return the segments after x -> rotation @ x + translation."""
        turned = self.ends @ np.asarray(rotation, dtype=np.float64).T
        return Segments(turned + np.asarray(translation, dtype=np.float64), name=self.name)


def check_segments(segments, *, name="segments"):
    """Segments as they are, or made from an array."""
    return segments if isinstance(segments, Segments) else Segments(segments, name=name)


def relative_ends(test, model):
    """End points of both sets, less one common origin: what remains is exact to 1e-9 m."""
    for segments in (model, test):
        if len(segments):
            origin = segments.ends[0, 0]
            return test.ends - origin, model.ends - origin
    return test.ends, model.ends


def _as_ends(values):
    """Float64 ends (n, 2, 3) of any accepted shape."""
    if values.size == 0 and values.dtype.kind in "fiu":
        return np.empty((0, 2, 3))
    if values.dtype.kind not in "fiu":
        raise TypeError(f"Invalid segments of type {values.dtype}. Must be real numbers.")
    width = values.shape[-1] if values.ndim == 2 else values.shape[1:]
    if width not in (6, 4, (2, 3), (2, 2)):
        raise ValueError(
            f"Invalid segments of shape {values.shape}. Must have shape (n, 2, 3), (n, 6), "
            "(n, 2, 2) or (n, 4)."
        )
    ends = values.astype(np.float64).reshape(len(values), 2, -1)
    if ends.shape[2] == 2:
        ends = np.concatenate([ends, np.zeros((*ends.shape[:2], 1))], axis=2)
    return ends


def _refuse_coarse(values):
    """Raise where single precision cannot represent the coordinates."""
    if values.dtype not in (np.float32, np.float16):
        return
    largest = float(np.abs(values[np.isfinite(values)]).max(initial=0))
    if largest > FLOAT32_LIMIT_M:
        raise ValueError(
            f"Invalid segments of type {values.dtype} with a coordinate of {largest:.0f} m. "
            "Must be float64."
        )


def _warn_of_units(ends, lengths):
    """Say when the numbers are unlikely to be metres."""
    if not len(ends):
        return
    median = float(np.median(lengths))
    degrees = (np.abs(ends[..., :2]) <= (180, 90)).all()
    if median > 1000:
        unit = "millimetres"
    elif median < 0.01:
        unit = "geographic degrees" if degrees else "kilometres"
    else:
        return
    warnings.warn(f"Median segment length {median:.2g}: {unit}? Must be metres.", stacklevel=4)


def _refuse_rows(bad, what, wanted):
    """Raise with the rows that are bad."""
    if bad.any():
        rows = np.flatnonzero(bad)
        listed = ", ".join(map(str, rows[:5])) + (", ..." if len(rows) > 5 else "")
        plural = "s" if len(rows) > 1 else ""
        raise ValueError(f"Invalid segments: {what} in row{plural} {listed}. Must {wanted}.")


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


def components(
    test: Segments | ArrayLike,
    model: Segments | ArrayLike,
    *,
    rotate: str = "test",
    within: str = "containment",
) -> Components:
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


def distance_matrix(
    test: Segments | ArrayLike,
    model: Segments | ArrayLike,
    *,
    weight: float = 10.0,
    rotate: str = "test",
    within: str = "containment",
) -> np.ndarray:
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
def _parts(own, m, j, shorter, overlap):
    """Squared d_theta, d_par, squared d_perp and s of one pair: midpoint, direction, length each.

    Scalars throughout and no branch: the loop over the models then fills whole vector registers.
    """
    x, y, z, tx, ty, tz, t_length = own
    mx, my, mz, m_length = m[3, j], m[4, j], m[5, j], m[6, j]
    least = min(t_length, m_length)
    cx, cy, cz = ty * mz - tz * my, tz * mx - tx * mz, tx * my - ty * mx
    angle2 = least * least * (cx * cx + cy * cy + cz * cz)
    stays = shorter & (m_length < t_length)
    ex, ey, ez = (tx if stays else mx), (ty if stays else my), (tz if stays else mz)
    dx, dy, dz = x - m[0, j], y - m[1, j], z - m[2, j]
    s = dx * ex + dy * ey + dz * ez
    parallel = max(0.0, abs(s) - abs(t_length - m_length) / 2)
    parallel = 0.0 if overlap & (abs(s) < (t_length + m_length) / 2) else parallel
    px, py, pz = dx - s * ex, dy - s * ey, dz - s * ez
    return angle2, parallel, px * px + py * py + pz * pz, s


@numba.njit(nogil=True, cache=True)
def _distances_block(first, last, t, m, shorter, overlap, weight, distances):
    for i in range(first, last):
        own = t[0, i], t[1, i], t[2, i], t[3, i], t[4, i], t[5, i], t[6, i]
        row = distances[i]
        for j in range(m.shape[1]):
            angle2, along, across2, _ = _parts(own, m, j, shorter, overlap)
            row[j] = np.sqrt(weight * angle2 + along * along + across2)


@numba.njit(nogil=True, cache=True)
def _components_block(first, last, t, m, shorter, overlap, angle, parallel, perpendicular, shift):
    for i in range(first, last):
        own = t[0, i], t[1, i], t[2, i], t[3, i], t[4, i], t[5, i], t[6, i]
        for j in range(m.shape[1]):
            angle2, along, across2, s = _parts(own, m, j, shorter, overlap)
            angle[i, j], parallel[i, j] = np.sqrt(angle2), along
            perpendicular[i, j], shift[i, j] = np.sqrt(across2), s
