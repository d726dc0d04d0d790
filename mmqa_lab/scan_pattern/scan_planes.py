"""The moving plane of a profile scanner, found in the time stamps of a whole street scan."""

from dataclasses import dataclass

import numpy as np

from mmqa_lab._checks import check_points, check_positive
from mmqa_lab.planes import TUKEY, sigma_mad
from mmqa_lab.scan_pattern.lines import solve_groups
from mmqa_lab.scan_pattern.numbering import mirror_frequency, revolutions_from_time

PHASES = 1500
"""Parts of a revolution within which the beam is taken to have one direction."""


@dataclass(frozen=True, eq=False)
class ScanPlanes:
    """Profiles of a scan as planes that follow each other.

    Parameters
    ----------
    normal : array, shape (3,)
        Of the scan plane, in the direction in which it moves.
    speed_m_s : float
        Of the plane along its normal, the vehicle taken to move without turning.
    scatter_m : float
        Robust standard deviation of the points about that plane.
    mirror_frequency_hz : float
    centre : array, shape (3,)
        Where ``advance_m`` holds.
    advance_m, advance_std : float
        How far points at the same mirror angle move along the normal in a revolution.
    turning, turning_std : array, shape (3,)
        Change of that per metre of place, within the plane: a turn of the vehicle, m/m.
    points : int

    Examples
    --------
    >>> y, x = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
    >>> still = {"turning": np.zeros(3), "turning_std": np.zeros(3), "points": 1000}
    >>> drive = {"speed_m_s": 10.0, "mirror_frequency_hz": 100.0, "advance_m": 0.1}
    >>> found = ScanPlanes(y, scatter_m=0.0, centre=x, advance_std=0.0, **drive, **still)
    >>> float(found.spacing_on(x, [1, 0, 0]))  # a wall beside the track
    0.1
    """

    normal: np.ndarray
    speed_m_s: float
    scatter_m: float
    mirror_frequency_hz: float
    centre: np.ndarray
    advance_m: float
    advance_std: float
    turning: np.ndarray
    turning_std: np.ndarray
    points: int

    @property
    def turn_rate_deg_s(self):
        """Turn of the plane about an axis in it, degrees per second."""
        return float(np.degrees(np.linalg.norm(self.turning) * self.mirror_frequency_hz))

    def advance_at(self, places):
        """How far the plane moves along its normal in a revolution at places (..., 3), metres."""
        return self.advance_m + (np.asarray(places, dtype=np.float64) - self.centre) @ self.turning

    def spacing_on(self, places, surface_normal):
        """Profile spacing, square to the profiles, on a surface through places, metres.

        Parameters
        ----------
        places : array_like, shape (..., 3)
        surface_normal : array_like, shape (3,)
        """
        normal = np.asarray(surface_normal, dtype=np.float64)
        crossing = np.linalg.norm(np.cross(self.normal, normal / np.linalg.norm(normal)))
        return self.advance_at(places) / crossing


def fit_scan_planes(points, gps_time, *, mirror_frequency_hz=None, phases=PHASES):
    """Fit the moving plane of a profile scanner to points of many surfaces.

    First n.P - v t = c, a plane in uniform motion (total least squares, Tukey's weights). Then, for
    points of the same mirror angle in successive revolutions, the displacement along n as
    a linear function of place: what MIMIC leaves out, the turn of the vehicle, is its slope.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Two revolutions or more of one scanner head, metres.
    gps_time : array_like, shape (n,)
        Seconds.
    mirror_frequency_hz : float, optional
        From the pauses of the times where left out.
    phases : int
        Parts of a revolution within which points are compared.

    Returns
    -------
    ScanPlanes

    Raises
    ------
    ValueError
        If there are fewer than two revolutions, or no points at the same angle in them.

    Examples
    --------
    >>> from mmqa_lab.simulate import ProfileScanner, Scene, ground, scan_all, straight, wall
    >>> street = Scene([ground(), wall((5, 9, 0), (0, -20, 0), 8)])
    >>> scanner = ProfileScanner(pulse_rate_hz=36_000, mirror_frequency_hz=100, heading_deg=60)
    >>> cloud = scan_all(street, scanner, straight(1, 10, start=(0, 0, 2)), seed=1)
    >>> found = fit_scan_planes(cloud.points, cloud["gps_time"], mirror_frequency_hz=100)
    >>> round(found.speed_m_s, 3)  # of the plane along its normal: 10 cos(60 degrees)
    5.0
    """
    points = check_points(points, minimum=20)
    time = np.asarray(gps_time, dtype=np.float64)
    if time.shape != (len(points),) or not np.isfinite(time).all():
        raise ValueError(f"Invalid gps_time of shape {time.shape}. Must be {len(points)} seconds.")
    since = time - time.min()
    number = revolutions_from_time(since, mirror_frequency_hz=mirror_frequency_hz)
    if number.max() < 1:
        raise ValueError("Invalid gps_time within one revolution. Must hold two or more.")
    frequency = mirror_frequency_hz or mirror_frequency(since)
    centre = points.mean(axis=0)
    local = points - centre
    normal, speed, residuals = _moving_plane(local, since)
    if speed < 0:
        normal, speed = -normal, -speed
    axes = np.linalg.svd(normal[None])[2][1:]
    frequency = check_positive(frequency, "mirror_frequency_hz", unit="Hz")
    phase = np.floor(since * frequency % 1 * phases)
    found, used = _displacement(local, local @ normal, number, phase, axes)
    spread = np.sqrt(np.diag(found.covariance))
    return ScanPlanes(
        normal=normal,
        speed_m_s=float(speed),
        scatter_m=sigma_mad(residuals),
        mirror_frequency_hz=float(frequency),
        centre=centre,
        advance_m=float(found.coefficients[0]),
        advance_std=float(spread[0]),
        turning=found.coefficients[1:3] @ axes,
        turning_std=spread[1:3] @ np.abs(axes),
        points=used,
    )


def _moving_plane(local, since, rounds=50):
    """Normal and speed of a plane in uniform motion, and the points' distances from it."""
    weights = np.ones(len(local))
    for _ in range(rounds):
        share = weights / weights.sum()
        time, place = since - share @ since, local - share @ local
        velocity = (share * time) @ place / (share @ time**2)
        still = place - np.outer(time, velocity)
        normal = np.linalg.eigh((still * share[:, None]).T @ still)[1][:, 0]
        residuals = still @ normal
        sigma = max(sigma_mad(residuals), 1e-9)
        u = residuals / (TUKEY * sigma)
        previous, weights = weights, np.where(np.abs(u) < 1, (1 - u**2) ** 2, 0.0)
        if np.abs(weights - previous).max() < 1e-6:
            break
    return normal, normal @ velocity, residuals


def _displacement(local, height, number, phase, axes, rounds=4):
    """Displacement per revolution and its slopes, from points of the same mirror angle."""
    place = number[:, None] * np.column_stack([np.ones(len(local)), local @ axes.T])
    kept = np.arange(len(local))
    for _ in range(rounds):
        group = np.unique(phase[kept], return_inverse=True)[1]
        found = solve_groups(place[kept], height[kept], group)
        sigma = max(sigma_mad(found.residuals), 1e-9)
        inside = np.abs(found.residuals) <= 4 * sigma
        if inside.all():
            break
        kept = kept[inside]
    return found, len(found.residuals)
