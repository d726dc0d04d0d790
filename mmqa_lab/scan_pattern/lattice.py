"""The scan lattice: the two steps that lay a surface out with points, and what follows from them.

Around a spot of a plane, two successive pulses and two successive revolutions are solved exactly,
with the motion of the vehicle in between. In the equations of Cahalane et al. 2014
(doi 10.3390/s140609471) the scan plane stands still during a revolution.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from mmqa_lab._results import Shown
from mmqa_lab.scan_pattern.setups import ScanSetup

QUANTITIES = (
    *("profile_spacing_perpendicular_m", "profile_spacing_horizontal_m"),
    *("profile_spacing_vertical_m", "profile_angle_deg", "point_spacing_m", "density_per_m2"),
    *("d1_mm", "d2_mm", "d3_mm", "d4_mm", "f"),
)
"""What a lattice predicts, in the order of its table."""

LEVEL = np.sin(np.radians(0.1))
"""A surface closer to level than 0.1 degree has no horizontal line of its own."""


@dataclass(frozen=True, eq=False)
class Lattice(Shown):
    """Steps on the surface from pulse to pulse and from profile to profile.

    Parameters
    ----------
    setup : ScanSetup
    beam : array, shape (..., 3)
        From the scanner to the spot, metres.
    normal : array, shape (..., 3)
        Unit normal of the surface.
    a : array, shape (..., 3)
        Step from a pulse to the next, motion of vehicle and mirror; the spot is halfway in time.
    b : array, shape (..., 3)
        Step to the same mirror angle one revolution later, the spot halfway in time.
    nearest : array, shape (..., 3)
        Step to the pulse of the next profile that is ``b`` up to half a step of the mirror: with
        ``a`` it spans the points, also where PRR / Mf is not whole.

    Examples
    --------
    >>> from mmqa_lab.scan_pattern import ScanSetup, Target, scan_lattice
    >>> scanner = {"pulse_rate_hz": 1e6, "mirror_frequency_hz": 200, "scanner_tilt_deg": 45}
    >>> setup = ScanSetup(**scanner, speed_m_s=10)
    >>> there = scan_lattice(setup, Target(range_m=5).patch(setup))
    >>> float(there.density_per_m2.round(6)), float(there.profile_spacing_horizontal_m.round(6))
    (4501.581581, 0.05)
    """

    setup: ScanSetup
    beam: np.ndarray
    normal: np.ndarray
    a: np.ndarray
    b: np.ndarray
    nearest: np.ndarray

    @property
    def range_m(self):
        """Length of the beam."""
        return np.linalg.norm(self.beam, axis=-1)

    @property
    def facing(self):
        """Whether the beam comes from the side to which the normal points."""
        return _dot(self.beam, self.normal) < 0

    @property
    def incidence_deg(self):
        """Angle between beam and normal, 0 to 90."""
        cosine = np.abs(_dot(self.beam, self.normal)) / self.range_m
        return np.degrees(np.arccos(np.minimum(cosine, 1)))

    @cached_property
    def axes(self):
        """The horizontal line and the line of greatest slope of the surface, (..., 2, 3).

        On a level surface: across the track and along it.
        """
        level = np.cross([0.0, 0.0, 1.0], self.normal)
        slope = np.linalg.norm(level, axis=-1, keepdims=True)
        across = np.cross([0.0, 1.0, 0.0], self.normal)
        chosen = np.where(slope < LEVEL, across, level)
        chosen = chosen / np.linalg.norm(chosen, axis=-1, keepdims=True)
        return np.stack([chosen, np.cross(self.normal, chosen)], axis=-2)

    def plane_steps(self):
        """Return ``a``, ``b`` and ``nearest`` along ``axes``, three arrays (..., 2)."""
        steps = (self.a, self.b, self.nearest)
        return tuple((self.axes @ step[..., None])[..., 0] for step in steps)

    @property
    def cell_m2(self):
        """Area of the parallelogram of ``a`` and ``b``."""
        return np.linalg.norm(np.cross(self.a, self.b), axis=-1)

    @property
    def point_spacing_m(self):
        """Distance to the next point of the profile (d_PS)."""
        return np.linalg.norm(self.a, axis=-1)

    @property
    def profile_spacing_perpendicular_m(self):
        """Gap between neighbouring profiles."""
        return self.cell_m2 / self.point_spacing_m

    @property
    def profile_spacing_horizontal_m(self):
        """Gap along the surface's horizontal line (d_PrSH); inf along profiles, NaN if level."""
        return self._spacing_along(1)

    @property
    def profile_spacing_vertical_m(self):
        """Gap along its line of greatest slope (d_PrSV); inf along profiles, NaN if level."""
        return self._spacing_along(0)

    @property
    def profile_angle_deg(self):
        """Angle between profiles and the horizontal line, 0 to 90 (theta_PrA); NaN if level."""
        along, up = np.moveaxis(np.abs(self.plane_steps()[0]), -1, 0)
        return np.where(self._level, np.nan, np.degrees(np.arctan2(up, along)))[()]

    @property
    def density_per_m2(self):
        """Points per square metre at the spot, PRR cos(i) / (2 pi R v |Y.n_s|).

        For a turning vehicle the velocity is that of the scan plane at the spot. The mirror
        frequency does not appear in it.
        """
        setup = self.setup
        lever = setup.vehicle_rotation() @ np.asarray(setup.lever_arm_m, dtype=np.float64)
        sweep = setup.velocity + np.cross(setup.turn_rate(), self.beam + lever)
        cosine = np.abs(_dot(self.beam, self.normal)) / self.range_m
        gain = 2 * np.pi * self.range_m * np.abs(_dot(sweep, setup.plane_normal))
        with np.errstate(divide="ignore"):
            return setup.pulse_rate_hz * cosine / gain

    @cached_property
    def distances_m(self):
        """Sorted quadrant distances d1..d4 of the chart's metric along ``axes``, (..., 4)."""
        a, _, nearest = self.plane_steps()
        return lattice_distances(a, nearest)

    @property
    def f(self):
        """Inhomogeneity d4 / d1."""
        return self.distances_m[..., 3] / self.distances_m[..., 0]

    def crossing_angle(self, other):
        """Angle between these profiles and another lattice's at the same places, 0 to 90 degrees.

        Examples
        --------
        >>> from dataclasses import replace
        >>> from mmqa_lab.scan_pattern import ScanSetup, Target
        >>> slow = ScanSetup(pulse_rate_hz=1e8, mirror_frequency_hz=200, speed_m_s=0.1)
        >>> heads = (replace(slow, scanner_tilt_deg=tilt) for tilt in (-30, 30))
        >>> left, right = (scan_lattice(head, Target(range_m=5).patch(head)) for head in heads)
        >>> round(float(left.crossing_angle(right)), 2)
        60.0
        """
        lengths = self.point_spacing_m * other.point_spacing_m
        return np.degrees(np.arccos(np.minimum(np.abs(_dot(self.a, other.a)) / lengths, 1)))

    def to_frame(self):
        """Return a DataFrame of ``QUANTITIES``, a row per spot."""
        shape = np.shape(self.range_m)
        columns = {name: np.broadcast_to(self.quantity(name), shape).ravel() for name in QUANTITIES}
        return pd.DataFrame(columns)

    def points(self, half_width=0.25):
        """Return the points that the steps lay about the spot, along ``axes``, (n, 2), metres."""
        a, _, b = self.plane_steps()
        reach = np.abs(np.linalg.inv(np.array([a, b]).T)).sum(axis=1) * half_width
        i, j = np.meshgrid(*(np.arange(-r, r + 1) for r in np.minimum(np.ceil(reach), 2000)))
        xy = np.multiply.outer(i, a) + np.multiply.outer(j, b)
        return xy[(np.abs(xy) <= half_width).all(axis=-1)]

    def plot(self, *, ax=None, half_width=0.25):
        """Draw the points about a single spot and the two steps, millimetres; return the axes."""
        from mmqa_lab.plots import COLOURS, subplots

        ax = ax or subplots()[1]
        ax.plot(*(1000 * self.points(half_width)).T, ".", ms=2.5, color="0.6", mew=0)
        a, _, b = 1000 * np.array(self.plane_steps())
        for step, name, colour in ((a, "a", COLOURS["vermilion"]), (b, "b", COLOURS["blue"])):
            ax.annotate("", step, (0, 0), arrowprops={"arrowstyle": "-|>", "color": colour})
            ax.annotate(name, step, (4, 4), textcoords="offset points", color=colour)
        ends = (-1000 * half_width, 1000 * half_width)
        ax.set(xlim=ends, ylim=ends, aspect="equal")
        ax.set(xlabel="along the level line (mm)", ylabel="up the slope (mm)")
        return ax

    def quantity(self, name):
        """Return one of ``QUANTITIES`` by its name."""
        if name[0] == "d" and name[1:2].isdigit():
            return 1000 * self.distances_m[..., int(name[1]) - 1]
        return getattr(self, name)

    @property
    def _level(self):
        """Whether the surface has no horizontal line of its own."""
        return np.hypot(self.normal[..., 0], self.normal[..., 1]) < LEVEL

    def _spacing_along(self, other):
        """Gap between profiles along one of the axes, from the step along the other."""
        step = np.abs(self.plane_steps()[0][..., other])
        with np.errstate(divide="ignore"):
            return np.where(self._level, np.nan, self.cell_m2 / step)[()]


def scan_lattice(setup, patch):
    """Return the scan lattice on each piece of a surface.

    The piece is struck when the scan plane comes past it. The pulses half a step before and after,
    and those half a revolution before and after at the same mirror angle, are intersected with the
    piece's plane in closed form, each from its own position and attitude.

    Parameters
    ----------
    setup : ScanSetup
    patch : Patch
        Its shape and the set-up's broadcast.

    Returns
    -------
    Lattice
        NaN where a pulse does not meet the plane.

    Notes
    -----
    The lattice is local: over a wall of some metres range and incidence change, and so do the
    steps. Laid about the spot they are those of the spot; a step from the spot to the next pulse
    differs by half of what spacing changes from step to step (0.2 to 2 %), upwards and downwards
    with opposite signs. 1 / |a x b| is the density up to the square of the mirror's step (1e-5).

    References
    ----------
    Cahalane et al. 2014, equations 2-10. doi:10.3390/s140609471

    Examples
    --------
    >>> from mmqa_lab.scan_pattern import ScanSetup, Target
    >>> setup = ScanSetup(pulse_rate_hz=3e5, mirror_frequency_hz=100, speed_m_s=10,
    ...                   scanner_heading_deg=45, scanner_tilt_deg=45)
    >>> lattice = scan_lattice(setup, Target(heading_deg=15, range_m=5).patch(setup))
    >>> round(lattice.profile_spacing_horizontal_m.item(), 6)
    0.08165
    """
    shape = (*np.broadcast_shapes(setup.shape, patch.points.shape[:-1]), 3)
    beam = np.broadcast_to(_meet(setup, patch.points), shape)
    normal = np.broadcast_to(patch.normals, shape)
    rates = np.broadcast_arrays(setup.pulse_rate_hz, setup.mirror_frequency_hz)
    pulse_rate, mirror = (np.asarray(rate, dtype=np.float64) for rate in rates)
    whole = np.round(pulse_rate / mirror)
    steps = (
        _step(setup, beam, normal, 1 / pulse_rate, mirror / pulse_rate),
        _step(setup, beam, normal, 1 / mirror, np.zeros_like(mirror)),
        _step(setup, beam, normal, whole / pulse_rate, whole * mirror / pulse_rate - 1),
    )
    return Lattice(setup, beam, normal, *(np.broadcast_to(step, shape) for step in steps))


def lattice_distances(a, b):
    """Return d1..d4 of an endless lattice: the nearest points of the four quadrants, sorted.

    The quadrants are half open, each without the axis on its counter-clockwise side. The basis is
    reduced (Lagrange); then in each quadrant the nearest point lies on one of three rows, next to
    where the row is closest to the origin or enters the quadrant.

    Parameters
    ----------
    a, b : array_like, shape (..., 2)
        Two steps that span the lattice, in the axes of the quadrants.

    Returns
    -------
    array, shape (..., 4)
        In the unit of the steps; NaN where a step is not finite or the two are parallel. d1 = d2
        and d3 = d4, for a lattice looks the same from behind.

    Raises
    ------
    ValueError
        If the last axis of a step is not two long.

    References
    ----------
    Pfeifer et al. 2021, section 3.3. doi:10.3390/rs13020237

    Examples
    --------
    >>> lattice_distances([0.004, 0], [0.001, 0.047]).round(6).tolist()
    [0.004, 0.004, 0.047096, 0.047096]
    """
    a, b = np.broadcast_arrays(check_shape(a), check_shape(b))
    area = np.abs(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
    with np.errstate(invalid="ignore"):
        spans = area > 1e-12 * np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    usable = spans[..., None]
    short, long = _reduced(np.where(usable, a, [1.0, 0.0]), np.where(usable, b, [0.0, 1.0]))
    near = np.sort([_nearest(short, long, side) for side in (1, -1)], axis=0)
    near = np.where(spans, near, np.nan)
    return np.stack([near[0], near[0], near[1], near[1]], axis=-1)


def check_shape(step):
    """A step as float64 (..., 2)."""
    values = np.asarray(step, dtype=np.float64)
    if values.shape[-1:] != (2,):
        raise ValueError(f"Invalid step of shape {values.shape}. Must be (..., 2).")
    return values


def _meet(setup, points):
    """Beams from where the scanner is when its plane comes past the points."""
    normal = setup.plane_normal
    wait = _dot(points, normal) / normal[..., 1]
    return points - wait[..., None] * np.array([0.0, 1.0, 0.0])


def _step(setup, beam, normal, seconds, turns):
    """Step on the plane from half a time and half a turn before to half of both after."""
    before, after = (_hit(setup, beam, normal, s * seconds / 2, s * turns / 2) for s in (-1, 1))
    return after - before


def _hit(setup, beam, normal, seconds, turns):
    """Where on the plane, seen from the spot, a pulse strikes some time and turn later."""
    local = np.swapaxes(setup.rotation(), -1, -2) @ beam[..., None]
    angle = np.arctan2(local[..., 2, 0], local[..., 0, 0]) + setup.spin * 2 * np.pi * turns
    aim = np.stack([np.cos(angle), np.zeros_like(angle), np.sin(angle)], axis=-1)
    direction = (setup.rotation(seconds) @ aim[..., None])[..., 0]
    origin = setup.origin(seconds)
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = _dot(beam - origin, normal) / _dot(direction, normal)
    ahead = np.isfinite(reach) & (reach > 0)
    return origin + np.where(ahead, reach, np.nan)[..., None] * direction - beam


def _dot(a, b):
    """Inner products over the last axis."""
    return np.sum(a * b, axis=-1)


def _reduced(a, b):
    """The shortest basis of the lattice, the shorter step first (Lagrange)."""
    for _ in range(64):
        swap = (_dot(a, a) > _dot(b, b))[..., None]
        a, b = np.where(swap, b, a), np.where(swap, a, b)
        times = np.round(_dot(a, b) / _dot(a, a))
        if not times.any():
            break
        b = b - times[..., None] * a
    return a, b


def _nearest(short, long, side):
    """Distance of the nearest lattice point in the first (1) or second (-1) quadrant.

    A quadrant contains a disc of the covering radius, at most |long| / sqrt(2), within 1.71 |long|
    of the origin; rows are |long| sin(60) or more apart, so that the second row is out of reach.
    """
    best = np.full(short.shape[:-1], np.inf)
    mirror = np.array([side, 1.0])
    u, v = short * mirror, long * mirror
    for row in (-1, 0, 1):
        start = row * v
        foot = -_dot(start, u) / _dot(u, u)
        with np.errstate(divide="ignore", invalid="ignore"):
            bound = -start / u
        low = np.max(np.where(u > 0, bound, -np.inf), axis=-1)
        high = np.min(np.where(u < 0, bound, np.inf), axis=-1)
        base = np.floor(np.clip(foot, low, np.maximum(low, high)))
        for k in (-1, 0, 1, 2):
            point = start + (base + k)[..., None] * u
            length = np.linalg.norm(point, axis=-1)
            x, y = np.moveaxis(point, -1, 0)
            tiny = 1e-9 * length
            x, y = np.where(np.abs(x) <= tiny, 0, x), np.where(np.abs(y) <= tiny, 0, y)
            inside = (x > 0) & (y >= 0) if side == 1 else (x >= 0) & (y > 0)
            best = np.where(inside & (length > 0) & (length < best), length, best)
    return best
