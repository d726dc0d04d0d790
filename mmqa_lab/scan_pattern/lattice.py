"""The scan lattice: two steps on the surface, to the next pulse and to the next profile."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_together, check_values, refuse
from mmqa_lab._results import Shown
from mmqa_lab.scan_pattern.measure import MEASURED
from mmqa_lab.scan_pattern.mimic import LEVEL
from mmqa_lab.scan_pattern.setup import Patch, ScanSetup, Target, dot
from mmqa_lab.spacing.empty import STEPS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = [
    "LATTICE_QUANTITIES", "SMOOTH", "Lattice", "detail_size", "lattice_distances", "scan_lattice",
]  # fmt: skip


# Quantities that have derivatives; d1, d4 and f jump from lattice point to lattice point.
SMOOTH = (*MEASURED, "density_per_m2")


LATTICE_QUANTITIES = (*SMOOTH, "d1_mm", "d4_mm", "f")
"""Predicted quantities, in the order of the table of a lattice."""


SPREAD = np.outer(STEPS, np.arange(400))  # over a cell
TRAVEL = np.array([0.0, 1.0, 0.0])  # the vehicle drives along Y


@dataclass(frozen=True, eq=False)
class Lattice(Shown):
    """Steps on the surface from pulse to pulse and from profile to profile.

    Parameters
    ----------
    beam : array, shape (..., 3)
        From the scanner to the spot, metres.
    incidence_deg : array
        Angle between beam and normal, 0 to 90.
    axes : array, shape (..., 2, 3)
        The horizontal line of the surface and its line of greatest slope; on a level surface,
        across the track and along it.
    a : array, shape (..., 2)
        Step along ``axes`` from a pulse to the next, m; the spot is halfway between them in time.
    b : array, shape (..., 2)
        Step to the next profile, m; the spot is halfway in time. It leads to the same mirror angle
        if PRR / Mf is whole, else to the nearest pulse.
    profile_spacing_perpendicular_m : array
        Gap between neighbouring profiles, m.
    profile_spacing_horizontal_m, profile_spacing_vertical_m : array
        Gap along the horizontal line (d_PrSH) and along the slope (d_PrSV), m; infinite along the
        profiles, NaN on a level surface.
    profile_angle_deg : array
        Angle between profiles and the horizontal line, 0 to 90 (theta_PrA); NaN on a level
        surface.
    point_spacing_m : array
        Distance to the next point of the profile (d_PS), m.
    density_per_m2 : array
        PRR cos(i) / (2 pi R v |Y.n_scan|), independent of the mirror frequency.
    d1_mm, d4_mm, f : array
        Quadrant distances of the chart's metric along ``axes`` and f = d4 / d1. In a lattice
        d2 = d1 and d3 = d4 by symmetry.

    Examples
    --------
    >>> from mmqa_lab.scan_pattern import ScanSetup, Target, scan_lattice
    >>> scanner = {"pulse_rate_hz": 1e6, "mirror_frequency_hz": 200, "scanner_tilt_deg": 45}
    >>> found = scan_lattice(ScanSetup(**scanner, speed_m_s=10), Target(range_m=5))
    >>> float(found.density_per_m2.round(6)), float(found.profile_spacing_horizontal_m.round(6))
    (4501.581581, 0.05)
    """

    beam: np.ndarray
    incidence_deg: np.ndarray
    axes: np.ndarray
    a: np.ndarray
    b: np.ndarray
    profile_spacing_perpendicular_m: np.ndarray
    profile_spacing_horizontal_m: np.ndarray
    profile_spacing_vertical_m: np.ndarray
    profile_angle_deg: np.ndarray
    point_spacing_m: np.ndarray
    density_per_m2: np.ndarray
    d1_mm: np.ndarray
    d4_mm: np.ndarray
    f: np.ndarray

    @cached_property
    def detail_mm(self) -> np.ndarray:
        """Diameter of the smallest details of which 95 % show three points or more, mm."""
        return 1000 * detail_size(self.a, self.b)

    def to_frame(self) -> pd.DataFrame:
        """Return a DataFrame of ``LATTICE_QUANTITIES``, one row per spot."""
        return pd.DataFrame({name: np.ravel(getattr(self, name)) for name in LATTICE_QUANTITIES})

    def points(self, half_width: float = 0.25) -> np.ndarray:
        """Return the lattice points about a single spot, along ``axes``, (n, 2), metres."""
        reach = np.abs(np.linalg.inv(np.array([self.a, self.b]).T)).sum(axis=1) * half_width
        i, j = np.meshgrid(*(np.arange(-r, r + 1) for r in np.minimum(np.ceil(reach), 2000)))
        xy = np.multiply.outer(i, self.a) + np.multiply.outer(j, self.b)
        return xy[(np.abs(xy) <= half_width).all(axis=-1)]

    def plot(self, *, ax: Axes | None = None, half_width: float = 0.25) -> Axes:
        """Draw the points about a single spot and both steps, in millimetres; return the axes."""
        from mmqa_lab.plots import COLOURS, subplots

        ax = ax or subplots()[1]
        ax.plot(*(1000 * self.points(half_width)).T, ".", ms=4, color="0.3", mew=0)
        for step, name in ((self.a, "a"), (self.b, "b")):
            colour = COLOURS["vermilion" if name == "a" else "blue"]
            arrow = {"arrowstyle": "-|>", "color": colour, "shrinkA": 0, "shrinkB": 0}
            ax.annotate("", 1000 * step, (0, 0), arrowprops=arrow)
            ax.annotate(name, 1000 * step, (4, 4), textcoords="offset points", color=colour)
        ends = (-1000 * half_width, 1000 * half_width)
        ax.set(xlim=ends, ylim=ends, aspect="equal")
        ax.set(xlabel="along the level line (mm)", ylabel="up the slope (mm)")
        return ax


def scan_lattice(setup: ScanSetup, patch: Patch | Target) -> Lattice:
    """Return the scan lattice on each piece of a surface.

    A piece is hit when the scan plane passes it. The pulses half a step and half a revolution
    before and after that moment are intersected with the plane of the piece in closed form, each
    from the position of the scanner at its own time.

    Parameters
    ----------
    setup : ScanSetup
        Scanner and speed.
    patch : Patch or Target
        Pieces of the surface. Their shape and the shape of the set-up broadcast.

    Returns
    -------
    Lattice
        NaN where a pulse does not hit the plane.

    Raises
    ------
    ValueError
        If a place or normal is not finite, or if shapes do not fit.

    Notes
    -----
    The drive is straight: on a curve of 60 m radius the spacing beside it is off by a sixth, on one
    of 25 m by a third.

    The lattice is local: over a wall of some metres range and incidence change, and so do the
    steps. Each step has the spot in its middle. A step from the spot to the next pulse differs from
    it by half of the change of spacing from step to step (0.2 to 2 %), with opposite signs upwards
    and downwards. 1 / |a x b| equals the density up to the square of the mirror's step (1e-5).

    References
    ----------
    Cahalane et al. 2014, equations 2-10. doi:10.3390/s140609471

    Examples
    --------
    >>> from mmqa_lab.scan_pattern import ScanSetup, Target
    >>> setup = ScanSetup(pulse_rate_hz=3e5, mirror_frequency_hz=100, speed_m_s=10,
    ...                   scanner_heading_deg=45, scanner_tilt_deg=45)
    >>> lattice = scan_lattice(setup, Target(heading_deg=15, range_m=5))
    >>> round(lattice.profile_spacing_horizontal_m.item(), 6)
    0.08165
    """
    patch = patch.patch(setup) if isinstance(patch, Target) else patch
    points, normal = (check_values(values, name) for name, values in patch._asdict().items())
    for name, part in (("points", points[..., ::2]), ("normals", normal)):
        refuse(not part.any(axis=-1).all(), name, "no length from the scanner", "of some length")
    normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    pulse_rate, mirror = np.broadcast_arrays(setup.pulse_rate_hz, setup.mirror_frequency_hz)
    speed = np.asarray(setup.speed_m_s, dtype=np.float64)
    level, plane, upward = np.moveaxis(setup.rotation, -1, 0)
    # from the position of the scanner when its plane passes the points
    beam = points - (dot(points, plane) / plane[..., 1])[..., None] * TRAVEL
    scan_angle = np.arctan2(dot(beam, upward), dot(beam, level))

    def strike(seconds, turns):
        """Hit on the plane of the pulse after a time and a number of turns of the mirror."""
        angle = scan_angle + 2 * np.pi * turns
        aim = np.cos(angle)[..., None] * level + np.sin(angle)[..., None] * upward
        start = (speed * seconds)[..., None] * TRAVEL
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = dot(beam - start, normal) / dot(aim, normal)
        ahead = np.isfinite(reach) & (reach > 0)
        return start + np.where(ahead, reach, np.nan)[..., None] * aim

    def step(pulses):
        """Step along the axes over a number of pulses, about the spot, without whole turns."""
        seconds, turns = pulses / pulse_rate, pulses * mirror / pulse_rate
        turns = turns - np.round(turns)
        ends = [strike(side * seconds, side * turns) for side in (-0.5, 0.5)]
        return (axes @ (ends[1] - ends[0])[..., None])[..., 0]

    axes, flat = _axes(normal)
    a, b = step(1.0), step(np.round(pulse_rate / mirror))
    length, reach = np.linalg.norm(a, axis=-1), np.linalg.norm(beam, axis=-1)
    cosine = np.abs(dot(beam, normal)) / reach
    density = pulse_rate * cosine / (2 * np.pi * reach * speed * np.abs(plane[..., 1]))
    d1, d4 = lattice_distances(a, b)
    with np.errstate(divide="ignore", invalid="ignore"):
        cell = np.abs(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
        along, up = np.moveaxis(np.where(flat[..., None], np.nan, np.abs(a)), -1, 0)
        return Lattice(
            beam=beam,
            incidence_deg=np.degrees(np.arccos(np.minimum(cosine, 1))),
            axes=axes,
            a=a,
            b=b,
            profile_spacing_perpendicular_m=cell / length,
            profile_spacing_horizontal_m=cell / up,
            profile_spacing_vertical_m=cell / along,
            profile_angle_deg=np.degrees(np.arctan2(up, along)),
            point_spacing_m=length,
            density_per_m2=np.broadcast_to(density, length.shape)[()],
            d1_mm=1000 * d1,
            d4_mm=1000 * d4,
            f=d4 / d1,
        )


def _axes(normal):
    """Level line and line of greatest slope of a surface, and whether the surface is level."""
    flat = np.hypot(normal[..., 0], normal[..., 1]) < LEVEL
    level = np.where(flat[..., None], np.cross(TRAVEL, normal), np.cross([0.0, 0.0, 1.0], normal))
    level /= np.linalg.norm(level, axis=-1, keepdims=True)
    return np.stack([level, np.cross(normal, level)], axis=-2), flat


def lattice_distances(a: ArrayLike, b: ArrayLike) -> tuple[np.ndarray, ...]:
    """Return d1 = d2 and d3 = d4 of an infinite lattice: nearest points of its quadrants.

    The quadrants are half open, each without the axis on its counter-clockwise side. The basis is
    reduced (Lagrange); the nearest point of each quadrant is then within three steps.

    Parameters
    ----------
    a, b : array_like, shape (..., 2)
        Two steps that span the lattice, in the axes of the quadrants.

    Returns
    -------
    tuple of array
        In the unit of the steps; NaN where a step is not finite or the two are parallel.

    References
    ----------
    Pfeifer et al. 2021, section 3.3. doi:10.3390/rs13020237

    Examples
    --------
    >>> [round(d.item(), 6) for d in lattice_distances([0.004, 0], [0.001, 0.047])]
    [0.004, 0.047096]
    """
    a, b = np.broadcast_arrays(*check_together(a=a, b=b, missing=True))
    refuse(a.shape[-1:] != (2,), "steps", f"shape {a.shape}", "of two coordinates")
    area = np.abs(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
    with np.errstate(invalid="ignore"):
        spans = area > 1e-12 * np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    short, long = _reduced(
        np.where(spans[..., None], a, [1.0, 0.0]), np.where(spans[..., None], b, [0.0, 1.0])
    )
    i, j = np.mgrid[-3:4, -3:4].reshape(2, -1, 1)
    near = i * short[..., None, :] + j * long[..., None, :]
    length = np.linalg.norm(near, axis=-1)
    x, y = np.moveaxis(np.where(np.abs(near) <= 1e-9 * length[..., None], 0, near), -1, 0)
    nearest = [
        np.where(inside, length, np.inf).min(axis=-1)
        for inside in ((x > 0) & (y >= 0), (x <= 0) & (y > 0))
    ]
    return tuple(np.where(spans, each, np.nan) for each in np.sort(nearest, axis=0))


def detail_size(a: ArrayLike, b: ArrayLike) -> np.ndarray:
    """Return the diameter of the smallest discs of which 95 % contain three points of a lattice.

    Parameters
    ----------
    a, b : array_like, shape (..., 2)
        Two steps that span the lattice.

    Returns
    -------
    array
        In the unit of the steps, accurate to 1 %; NaN where a step is not finite.

    Notes
    -----
    It is twice the 95 % quantile of the distance from a place to its third nearest point, over the
    places of a cell. With the reduced basis this point is one of five on one of the four nearest
    rows.

    Examples
    --------
    >>> float(detail_size([0.001, 0], [0, 0.04]).round(4))  # close points: 95 % of the gap
    0.0379
    """
    short, long = _reduced(*(np.asarray(step, dtype=np.float64) for step in (a, b)))
    length = np.linalg.norm(short, axis=-1)[..., None, None]
    gap = np.abs(short[..., 0] * long[..., 1] - short[..., 1] * long[..., 0])[..., None, None]
    shift = dot(short, long)[..., None, None] / length
    u, v = (SPREAD % 1)[..., None]
    i, j = np.mgrid[-2:3, -1:3].reshape(2, -1)
    place = u - j * shift / length
    away = np.hypot((place - np.round(place) + i) * length, (v - j) * gap / length)
    return 2 * np.quantile(np.partition(away, 2, axis=-1)[..., 2], 0.95, axis=-1)


def _reduced(a, b):
    """The shortest basis of the lattice, the shorter step first (Lagrange)."""
    for _ in range(64):
        swap = (dot(a, a) > dot(b, b))[..., None]
        a, b = np.where(swap, b, a), np.where(swap, a, b)
        times = np.round(dot(a, b) / dot(a, a))
        if not times.any():
            break
        b = b - times[..., None] * a
    return a, b
