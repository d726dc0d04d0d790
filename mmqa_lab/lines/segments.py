"""3-D line segments and the parts of their distance.

A set is an array (n, 2, 3): the two ends of each segment, in metres. The distance follows Chen,
Leung & Gao 2003. One line is fixed, with direction e. The other line is rotated about its midpoint
until it is parallel. With midpoints c and lengths L of the test (t) and model (m) segments,

    d_theta = min(L_t, L_m) sin(angle between the lines)
    s       = (c_t - c_m) . e
    d_par   = max(0, |s| - |L_t - L_m| / 2)
    d_perp  = |(c_t - c_m) - s e|
    d       = sqrt(W d_theta^2 + d_par^2 + d_perp^2)

(Poreba & Goulette 2013, section 2.2 and equations 3-5). The sine comes from the cross product,
since the arccosine of a scalar product loses angles below 1e-8 rad. Coordinates are subtracted
before they are multiplied.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_choice, check_number, check_points, real_array
from mmqa_lab._compiled import in_threads, njit

__all__ = [
    "Components", "check_segments", "components", "directions", "from_common_origin", "lengths",
    "midpoints",
]  # fmt: skip


# Number of pairs that a thread computes at a time: fewer take less than waking it.
BLOCK_PAIRS = 100_000


def check_segments(segments: ArrayLike, name: str = "segments") -> np.ndarray:
    """Return segments as float64 of shape (n, 2, 3), n >= 0, all finite and with a length.

    Raises ``TypeError`` if they are not real numbers, ``ValueError`` if a segment is invalid.

    Examples
    --------
    >>> check_segments([[[1, 2, 3], [1, 2, 3]]])
    Traceback (most recent call last):
    ValueError: Invalid segments: no length in row 0. Must have two different ends.
    """
    values = real_array(segments, name)
    if values.ndim < 1 or (values.size and values.shape[1:] != (2, 3)):
        raise ValueError(f"Invalid {name} of shape {values.shape}. Must have shape (n, 2, 3).")
    ends = check_points(values.reshape(-1, 3), name=name, minimum=0).reshape(-1, 2, 3)
    points = (ends[:, 0] == ends[:, 1]).all(axis=1)
    if points.any():
        row = int(points.argmax())
        raise ValueError(f"Invalid {name}: no length in row {row}. Must have two different ends.")
    return ends


def lengths(segments: ArrayLike) -> np.ndarray:
    """Return lengths of segments (n, 2, 3), shape (n,), m."""
    return np.linalg.norm(np.diff(check_segments(segments), axis=1)[:, 0], axis=1)


def directions(segments: ArrayLike) -> np.ndarray:
    """Unit vectors of segments (n, 2, 3) from the first end to the second, shape (n, 3)."""
    segments = check_segments(segments)
    return np.diff(segments, axis=1)[:, 0] / lengths(segments)[:, None]


def midpoints(segments: ArrayLike) -> np.ndarray:
    """Return midpoints of segments (n, 2, 3), shape (n, 3), m."""
    segments = check_segments(segments)
    return segments[:, 0] + (segments[:, 1] - segments[:, 0]) / 2


def from_common_origin(test: ArrayLike, model: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Return both sets, checked and shifted to a common origin, exact to 1e-9 m."""
    test, model = check_segments(test, "test"), check_segments(model, "model")
    origin = np.concatenate([model, test])[:1, 0]
    return (test, model) if not len(origin) else (test - origin, model - origin)


@dataclass(frozen=True, eq=False)
class Components:
    """The parts of the distance for p x q pairs.

    Parameters
    ----------
    angle, parallel, perpendicular : array, shape (p, q)
        d_theta, d_par and d_perp, m.
    shift : array, shape (p, q)
        Midpoint of the test segment along the fixed line, from the model's midpoint, m.

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

    def distance(self, weight: float) -> np.ndarray:
        """Return d for a weight W >= 0 of the angle, shape (p, q), m (equation 5)."""
        weight = check_number(weight, "weight", low=0)
        return np.sqrt(weight * self.angle**2 + self.parallel**2 + self.perpendicular**2)


def components(
    test: ArrayLike, model: ArrayLike, *, rotate: str = "test", within: str = "containment"
) -> Components:
    """Return the angle, parallel and perpendicular distances of every test to every model segment.

    Parameters
    ----------
    test, model : array_like, shapes (p, 2, 3) and (q, 2, 3)
        Segments, m.
    rotate : {"test", "shorter"}
        The line that is rotated about its midpoint: always the test segment (Poreba & Goulette
        2013, section 2.2) or the shorter segment of each pair (Gao & Leung 2002).
    within : {"containment", "overlap"}
        Condition for a parallel distance of zero: the range of one segment contains the other
        (figure 2 of the paper), or the two overlap at all.

    Returns
    -------
    Components

    Raises
    ------
    ValueError
        If segments are not (n, 2, 3), not finite or without length, or a choice is unknown.

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
    check_choice(rotate, "rotate", ("test", "shorter"))
    check_choice(within, "within", ("containment", "overlap"))
    test, model = map(_described, from_common_origin(test, model))
    parts = np.empty((4, test.shape[1], model.shape[1]))
    settings = rotate == "shorter", within == "overlap"
    least = max(BLOCK_PAIRS // max(model.shape[1], 1), 1)
    in_threads(_measure, test.shape[1], test, model, *settings, parts, least=least)
    return Components(*parts)


def _described(ends):
    """Midpoints, directions and lengths of segments that are checked, (7, n)."""
    way = ends[:, 1] - ends[:, 0]
    length = np.sqrt((way * way).sum(axis=1))
    return np.vstack([(ends[:, 0] + way / 2).T, way.T / length, length])


@njit(cache=True, nogil=True)
def _measure(first, last, test, model, shorter, overlap, parts):
    """Write d_theta, d_par, d_perp and s of pairs. Without branches the loop is vectorised."""
    for i in range(first, last):
        x, y, z = test[0, i], test[1, i], test[2, i]
        tx, ty, tz, length = test[3, i], test[4, i], test[5, i], test[6, i]
        for j in range(model.shape[1]):
            mx, my, mz, least = model[3, j], model[4, j], model[5, j], min(length, model[6, j])
            cx, cy, cz = ty * mz - tz * my, tz * mx - tx * mz, tx * my - ty * mx
            turned = shorter & (model[6, j] < length)
            ex, ey, ez = tx if turned else mx, ty if turned else my, tz if turned else mz
            dx, dy, dz = x - model[0, j], y - model[1, j], z - model[2, j]
            s = dx * ex + dy * ey + dz * ez
            px, py, pz = dx - s * ex, dy - s * ey, dz - s * ez
            parallel = max(0.0, abs(s) - abs(length - model[6, j]) / 2)
            none = overlap & (abs(s) < (length + model[6, j]) / 2)
            parts[0, i, j] = least * math.sqrt(cx * cx + cy * cy + cz * cz)
            parts[1, i, j] = 0.0 if none else parallel
            parts[2, i, j] = math.sqrt(px * px + py * py + pz * pz)
            parts[3, i, j] = s
