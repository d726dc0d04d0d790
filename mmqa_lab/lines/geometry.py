"""Sets of 3-D line segments."""

import warnings
from dataclasses import dataclass

import numpy as np

from mmqa_lab._checks import check_choice, check_points

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
    origin : array_like, shape (3,), optional
        Coordinates are given relative to this point, which is added in float64. Shift before you
        store as float32: Lambert-93 northings in float32 are rounded to half a metre.
    on_bad : {"raise", "drop"}
        What to do with segments that are not finite or have no length.
    name : str
        For tables and figures.

    Attributes
    ----------
    kept : array of int, shape (n,)
        The input row of each segment.

    Raises
    ------
    TypeError
        If the values are not real numbers.
    ValueError
        If the shape is wrong; if rows are not finite or of zero length (named); if float32
        coordinates go beyond 100 km and no origin is given.

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
    origin: tuple | None = None
    on_bad: str = "raise"
    name: str = ""

    def __post_init__(self):
        check_choice(self.on_bad, "on_bad", ("raise", "drop"))
        values = np.asarray(self.ends)
        ends = _as_ends(values)
        if values.dtype in (np.float32, np.float16) and self.origin is None:
            _refuse_coarse(values)
        if self.origin is not None:
            ends = ends + check_points(np.atleast_2d(self.origin), name="origin")[0]
        finite = np.isfinite(ends).all(axis=(1, 2))
        empty = finite & (ends[:, 0] == ends[:, 1]).all(axis=1)
        if self.on_bad == "raise":
            _refuse_rows(~finite, "not finite", "be finite coordinates")
            _refuse_rows(empty, "no length", "have two different ends")
        kept = np.flatnonzero(finite & ~empty)
        object.__setattr__(self, "ends", ends[kept])
        object.__setattr__(self, "kept", kept)
        self._warn_of_units()

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

    def _warn_of_units(self):
        """Say when the numbers are unlikely to be metres."""
        if not len(self):
            return
        median = float(np.median(self.lengths))
        horizontal = np.abs(self.ends[..., :2])
        degrees = (horizontal[..., 0] <= 180).all() and (horizontal[..., 1] <= 90).all()
        if median > 1000:
            warnings.warn(
                f"Median segment length {median:.0f}: millimetres? Must be metres.", stacklevel=4
            )
        elif median < 0.01:
            unit = "geographic degrees" if degrees else "kilometres"
            warnings.warn(
                f"Median segment length {median:.2g}: {unit}? Must be metres.", stacklevel=4
            )


def check_segments(segments, *, name="segments"):
    """Return ``segments`` as :class:`Segments`, made from an array where it is none yet.

    Parameters
    ----------
    segments : Segments or array_like, shape (n, 2, 3)
        Metres.
    name : str
        For the message.

    Returns
    -------
    Segments

    Raises
    ------
    ValueError
        If the array has another shape, a value is not finite or a segment has no length.

    Examples
    --------
    >>> check_segments([[[0, 0, 0], [3, 4, 0]]]).lengths.tolist()
    [5.0]
    """
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
    """Raise where float32 cannot represent the coordinates."""
    largest = float(np.abs(values[np.isfinite(values)]).max(initial=0))
    if largest > FLOAT32_LIMIT_M:
        raise ValueError(
            f"Invalid segments of type {values.dtype} with a coordinate of {largest:.0f} m. "
            "Must be float64, or offsets from a given origin."
        )


def _refuse_rows(bad, what, wanted):
    """Raise with the rows that are bad."""
    if bad.any():
        rows = np.flatnonzero(bad)
        listed = ", ".join(map(str, rows[:5])) + (", ..." if len(rows) > 5 else "")
        plural = "s" if len(rows) > 1 else ""
        raise ValueError(f"Invalid segments: {what} in row{plural} {listed}. Must {wanted}.")
