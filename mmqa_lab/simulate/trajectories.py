"""Trajectories: the true path of a vehicle, and what its navigation would say it was.

Vehicle frame: x to the right, y in the direction of travel, z up. Attitude: heading clockwise from
+y (north), pitch positive nose up, roll positive right side down, all in degrees; the rotation from
vehicle to world is Rz(-heading) Rx(pitch) Ry(roll).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_number, check_points, check_positive
from mmqa_lab._streams import stream
from mmqa_lab.rotations import rotations

__all__ = [
    "NavigationErrors", "Trajectory", "gauss_markov", "measured", "straight",
    "with_speed_variation",
]  # fmt: skip


MOVED_M = 0.3
"""Less movement, as of a standing vehicle measured with noise, shows no heading."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A path with attitude, interpolated by cubic splines between its rows.

    Parameters
    ----------
    time : array_like, shape (n,)
        Seconds, increasing, n >= 2. May be GPS seconds.
    position : array_like, shape (n, 3)
        Easting, northing, height, metres.
    roll, pitch, heading : array_like, shape (n,), or float
        Degrees; see the top of this room for their signs. A heading may pass 360.

    Raises
    ------
    ValueError
        If times do not increase, lengths differ, or a value is not finite.

    Notes
    -----
    Splines keep velocity and rates continuous, which a scan shows more than position; between two
    rows only they are straight lines. Rows of white noise (a measured path) are passed through.

    Examples
    --------
    >>> path = Trajectory([0, 2], [[0, 0, 2], [0, 20, 2]])
    >>> path.at([0.5])[0].tolist(), path.duration_s
    ([[0.0, 5.0, 2.0]], 2.0)
    """

    time: np.ndarray
    position: np.ndarray
    roll: np.ndarray = 0.0  # type: ignore[assignment]  # an array from here on
    pitch: np.ndarray = 0.0  # type: ignore[assignment]
    heading: np.ndarray = 0.0  # type: ignore[assignment]

    if TYPE_CHECKING:  # what is array_like goes in, and arrays come out

        def __init__(
            self, time: ArrayLike, position: ArrayLike,
            roll: ArrayLike = 0.0, pitch: ArrayLike = 0.0, heading: ArrayLike = 0.0,
        ): ...  # fmt: skip

    def __post_init__(self):
        position = check_points(self.position, name="positions", minimum=2).copy()
        object.__setattr__(self, "position", position)
        for name in ("time", "roll", "pitch", "heading"):
            values = np.asarray(getattr(self, name), dtype=np.float64)
            if values.shape not in ((), (len(position),)) or not np.isfinite(values).all():
                raise ValueError(
                    f"Invalid {name} of shape {values.shape}. Must be {len(position)} numbers."
                )
            object.__setattr__(self, name, np.broadcast_to(values, len(position)).copy())
        if not (np.diff(self.time) > 0).all():
            row = int(np.argmax(np.diff(self.time) <= 0)) + 1
            raise ValueError(
                f"Invalid time {self.time[row]} in row {row}. Must be later than before."
            )

    @classmethod
    def from_table(cls, table: pd.DataFrame) -> Trajectory:
        """Return the trajectory of a table as ``io.read_trajectory`` reads it.

        Parameters
        ----------
        table : DataFrame
            ``time_s``, ``easting_m``, ``northing_m``, ``height_m``; ``roll_deg``, ``pitch_deg``,
            ``heading_deg`` where known. Without a heading the vehicle looks where it moves, and
            keeps its heading where it stands.
        """
        position = table[["easting_m", "northing_m", "height_m"]].to_numpy()
        known = {name: table[f"{name}_deg"] for name in ("roll", "pitch") if f"{name}_deg" in table}
        if "heading_deg" in table:
            heading = table["heading_deg"]
        else:
            heading = _course(table["time_s"].to_numpy(), position)
        return cls(table["time_s"], position, heading=heading, **known)

    @property
    def duration_s(self) -> float:
        """Seconds from the first row to the last."""
        return float(self.time[-1] - self.time[0])

    @property
    def origin(self) -> np.ndarray:
        """The position of the first row, from which the spline counts."""
        return self.position[0]

    @cached_property
    def _spline(self):
        """Offset from ``origin`` (m) and roll, pitch, heading (rad) over seconds from the start."""
        from scipy.interpolate import CubicSpline

        angles = np.unwrap(np.radians([self.roll, self.pitch, self.heading]), axis=1)
        values = np.hstack([self.position - self.origin, angles.T])
        return CubicSpline(self.time - self.time[0], values)

    def states(self, since_start: np.ndarray) -> np.ndarray:
        """Return offsets from ``origin`` in metres and roll, pitch, heading in radians, (n, 6).

        Parameters
        ----------
        since_start : array, shape (n,)
            Seconds after the first row; GPS seconds of 1e9 would cost digits.
        """
        return self._spline(since_start)

    def at(self, time: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Return positions (n, 3) and vehicle-to-world rotations (n, 3, 3) at times in seconds.

        Raises
        ------
        ValueError
            If a time lies outside the trajectory.
        """
        time = np.asarray(time, dtype=np.float64)
        if not ((time >= self.time[0]) & (time <= self.time[-1])).all():
            raise ValueError(
                f"Invalid time {time.min()} to {time.max()} s. Must be between {self.time[0]} and "
                f"{self.time[-1]} s, the times of the path."
            )
        states = self.states(time - self.time[0])
        return self.origin + states[:, :3], rotations(*states[:, 3:].T)


@dataclass(frozen=True)
class NavigationErrors:
    """What GNSS and IMU add to a path: a slow drift of each axis.

    Parameters
    ----------
    drift_m : float or tuple of 3
        Standard deviations in east, north, height, metres.
    drift_deg : float or tuple of 3
        Of roll, pitch, heading, degrees.
    correlation_s : float
        Correlation time of the drift (first-order Gauss-Markov), seconds.

    Examples
    --------
    >>> errors = NavigationErrors(drift_m=(0.02, 0.02, 0.0))
    >>> path = measured(straight(20, 10), errors, seed=1)
    >>> path.position[-1, 2].item(), bool(0.001 < abs(path.position[-1, 0]) < 0.1)
    (0.0, True)
    """

    drift_m: float | tuple[float, float, float] = 0.0
    drift_deg: float | tuple[float, float, float] = 0.0
    correlation_s: float = 60.0


def straight(
    length: float,
    speed: float,
    *,
    start: ArrayLike = (0.0, 0.0, 0.0),
    heading: float = 0.0,
    roll: float = 0.0,
    pitch: float = 0.0,
    start_time: float = 0.0,
) -> Trajectory:
    """Return a straight level drive at constant speed.

    Parameters
    ----------
    length : float
        Metres.
    speed : float
        Metres per second.
    start : array_like, shape (3,)
        First position, metres.
    heading, roll, pitch : float
        Degrees.
    start_time : float
        Seconds.

    Returns
    -------
    Trajectory

    Raises
    ------
    ValueError
        If length or speed is not above zero.

    Examples
    --------
    >>> straight(20.0, 10.0, heading=90).position[-1].round(9).tolist()
    [20.0, 0.0, 0.0]
    """
    length = check_positive(length, "length", unit="m")
    speed = check_positive(speed, "speed", unit="m/s")
    h = np.radians(check_number(heading, "heading", unit="degrees"))
    start = check_points(np.atleast_2d(start), name="start")[0]
    end = start + length * np.array([np.sin(h), np.cos(h), 0.0])
    times = start_time + np.array([0.0, length / speed])
    return Trajectory(times, np.array([start, end]), roll, pitch, heading)


def with_speed_variation(trajectory: Trajectory, *, share: float, seed: int) -> Trajectory:
    """Return the same path driven at a speed that varies about its own within half a second.

    Parameters
    ----------
    trajectory : Trajectory
    share : float
        Standard deviation of the speed, as a share of it (0.01 = 1 %).
    seed : int

    Returns
    -------
    Trajectory
        A row each hundredth of a second.

    Raises
    ------
    ValueError
        If the share lies outside 0 to 0.3.

    Notes
    -----
    The path ends where it ended; its duration changes by what the speed did on average. The speed
    is first-order Gauss-Markov with a correlation time of 0.5 s.

    Examples
    --------
    >>> path = with_speed_variation(straight(100, 10), share=0.05, seed=1)
    >>> path.position[-1].round(6).tolist(), 9 < path.duration_s < 11
    ([0.0, 100.0, 0.0], True)
    """
    share = check_number(share, "share", low=0, high=0.3)
    n = int(np.ceil(trajectory.duration_s / 0.01)) + 1
    along = np.linspace(0.0, trajectory.duration_s, n)
    speed = 1 + share * gauss_markov(n, along[1], 0.5, stream(seed, "speed"))
    pace = 1 / np.maximum(speed, 0.05)
    since = np.concatenate([[0.0], np.cumsum((pace[1:] + pace[:-1]) / 2 * np.diff(along))])
    values = trajectory.states(along)
    angles = np.degrees(values[:, 3:])
    return Trajectory(trajectory.time[0] + since, trajectory.origin + values[:, :3], *angles.T)


def measured(
    trajectory: Trajectory,
    errors: NavigationErrors,
    *,
    seed: int | Sequence[int],
    interval_s: float = 0.01,
) -> Trajectory:
    """Return the path that navigation with ``errors`` reports for a true path.

    Parameters
    ----------
    trajectory : Trajectory
        The truth; it stays as it is.
    errors : NavigationErrors
    seed : int
    interval_s : float
        Step of the reported rows, seconds.

    Returns
    -------
    Trajectory
        To hand to ``scan`` as ``measured=``: rays leave from the truth, points are computed
        from this.

    Examples
    --------
    >>> path = measured(straight(200, 10), NavigationErrors(drift_m=0.02), seed=1)
    >>> len(path.time)
    2001
    """
    interval_s = check_positive(interval_s, "interval_s", unit="s")
    n = max(int(np.ceil(trajectory.duration_s / interval_s)) + 1, 2)
    since = np.linspace(0.0, trajectory.duration_s, n)
    values = trajectory.states(since)
    rng, correlation = stream(seed, "navigation"), errors.correlation_s
    drift = np.stack([gauss_markov(n, since[1], correlation, rng) for _ in range(6)], axis=1)
    angles = np.degrees(values[:, 3:]) + drift[:, 3:] * errors.drift_deg
    position = trajectory.origin + (values[:, :3] + drift[:, :3] * errors.drift_m)
    return Trajectory(trajectory.time[0] + since, position, *angles.T)


def _course(time, position):
    """Heading in degrees along the movement, from places ``MOVED_M`` apart or farther."""
    moved = [0]
    for row, (east, north) in enumerate(position[:, :2]):
        at = position[moved[-1]]
        if (east - at[0]) ** 2 + (north - at[1]) ** 2 >= MOVED_M**2:
            moved.append(row)
    if len(moved) < 2:
        raise ValueError(f"Invalid path within {MOVED_M} m. Must move, or have a heading_deg.")
    east, north = np.gradient(position[moved, :2], axis=0).T
    return np.interp(time, time[moved], np.degrees(np.unwrap(np.arctan2(east, north))))


def gauss_markov(
    shape: int | tuple[int, ...],
    interval: float,
    correlation: float,
    rng: np.random.Generator,
    axis: int = 0,
) -> np.ndarray:
    """Return first-order Gauss-Markov processes of standard deviation one along an axis."""
    from scipy.signal import lfilter

    keep = np.exp(-interval / check_positive(correlation, "correlation_s", unit="s"))
    white = rng.standard_normal(shape)
    np.moveaxis(white, axis, 0)[1:] *= np.sqrt(1 - keep**2)
    return lfilter([1.0], [1.0, -keep], white, axis=axis)
