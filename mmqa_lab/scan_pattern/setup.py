"""Scanner and target of a prediction, and their frame.

The frame is right-handed: X to the target's side, across the track; Y in the direction of travel; Z
up; origin in the scanner at the moment of the pulse. With all rotations zero the scan plane is
vertical across the track (normal Y) and the target is a vertical wall along it (normal X). Scanner
and target are tilted first (scanner about X, target about Y), then turned by their heading about Z.
Angles are counter-clockwise positive. A target of positive heading is turned towards the vehicle; a
target of positive tilt leans away from it. This reading of Cahalane et al. 2014
(doi 10.3390/s140609471, equation 1) reproduces their Table 3.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from mmqa_lab._checks import check_values
from mmqa_lab.rotations import turned
from mmqa_lab.scan_pattern.mimic import target_normal

__all__ = ["SETUP_NAMES", "TARGET_NAMES", "Patch", "ScanSetup", "Target", "dot"]


FEWEST_PULSES = 100  # pulses per revolution; with fewer, a step on the surface is not small


@dataclass(frozen=True, kw_only=True)
class ScanSetup:
    """A profile scanner on a vehicle that drives along Y: the five inputs of MIMIC.

    Every input may be an array; arrays broadcast. So a single set-up can hold a sweep or a
    Monte-Carlo draw.

    Parameters
    ----------
    pulse_rate_hz : float
        Pulses per second (PRR).
    mirror_frequency_hz : float
        Revolutions per second, each a profile (Mf). Pulses run upwards on the +X side.
    speed_m_s : float
        Speed along Y (v).
    scanner_heading_deg, scanner_tilt_deg : float
        Mounting (MIMIC's alpha_scan and gamma_scan), counter-clockwise positive about Z and X;
        tilt first.

    Raises
    ------
    ValueError
        If a rate or the speed is not above zero, a number is not finite, a revolution has fewer
        than 100 pulses, or the scan plane contains the direction of travel.

    Examples
    --------
    >>> setup = ScanSetup(pulse_rate_hz=3e5, mirror_frequency_hz=100, speed_m_s=10,
    ...                   scanner_heading_deg=45, scanner_tilt_deg=45)
    >>> setup.rotation[:, 1].round(4).tolist()  # the normal of the scan plane
    [-0.5, 0.5, 0.7071]
    """

    pulse_rate_hz: float | np.ndarray
    mirror_frequency_hz: float | np.ndarray
    speed_m_s: float | np.ndarray
    scanner_heading_deg: float | np.ndarray = 0.0
    scanner_tilt_deg: float | np.ndarray = 0.0

    def __post_init__(self):
        for name in SETUP_NAMES:
            check_values(getattr(self, name), name, positive=not name.endswith("_deg"))
        if np.min(np.divide(self.pulse_rate_hz, self.mirror_frequency_hz)) < FEWEST_PULSES:
            raise ValueError(
                f"Invalid pulse_rate_hz {self.pulse_rate_hz} for mirror_frequency_hz "
                f"{self.mirror_frequency_hz}. Must be {FEWEST_PULSES} pulses a revolution or more."
            )
        if (np.abs(self.rotation[..., 1, 1]) < 1e-9).any():
            raise ValueError(
                f"Invalid scanner_heading_deg {self.scanner_heading_deg} with scanner_tilt_deg "
                f"{self.scanner_tilt_deg}. Must turn the scan plane off the direction of travel."
            )

    @property
    def rotation(self) -> np.ndarray:
        """Rotation (..., 3, 3); columns: level line, normal and upward line of the scan plane."""
        return turned(z=self.scanner_heading_deg, x=self.scanner_tilt_deg)


SETUP_NAMES = tuple(field.name for field in fields(ScanSetup))


class Patch(NamedTuple):
    """Small pieces of any surface, each given by its place and normal.

    Parameters
    ----------
    points : array_like, shape (..., 3)
        X and Z from the scanner, metres. Y is free, since the scan passes every Y.
    normals : array_like, shape (..., 3)
        Of any length.
    """

    points: np.ndarray
    normals: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Target:
    """MIMIC's target: a plane at a distance, tilted, then turned.

    Parameters
    ----------
    heading_deg : float
        alpha_targ: positive turns the wall towards the vehicle, negative away.
    tilt_deg : float
        beta_targ: positive leans its top away from the vehicle.
    range_m : float
        Horizontal range (Hr): X of the plane where the horizontal pulse of the level vehicle
        hits it. That pulse is ``range_m / cos(scanner heading)`` long.
    height_difference_m : float
        Height of the evaluated spot above the scanner (h_targ - h_scan).

    Raises
    ------
    ValueError
        If a value is not finite or the range is not above zero.

    Examples
    --------
    >>> wall = Target(heading_deg=15, tilt_deg=30, range_m=5)
    >>> setup = ScanSetup(pulse_rate_hz=3e5, mirror_frequency_hz=100, speed_m_s=10)
    >>> wall.patch(setup).normals.round(4).tolist()
    [-0.8365, -0.2241, 0.5]
    """

    heading_deg: float | np.ndarray = 0.0
    tilt_deg: float | np.ndarray = 0.0
    range_m: float | np.ndarray
    height_difference_m: float | np.ndarray = 0.0

    def __post_init__(self):
        for name in TARGET_NAMES.values():
            check_values(getattr(self, name), name, positive=name == "range_m")

    def patch(self, setup: ScanSetup) -> Patch:
        """Return the evaluated spot of the plane as a ``Patch``.

        Raises
        ------
        ValueError
            If the horizontal pulse does not meet the plane's front.
        """
        level, _, upward = np.moveaxis(setup.rotation, -1, 0)
        normal = target_normal(self.heading_deg, self.tilt_deg)
        facing = dot(normal, level)
        if (np.minimum(facing, level[..., 0]) < 1e-9).any():
            raise ValueError(
                f"Invalid target heading {self.heading_deg} and tilt {self.tilt_deg} for a scanner "
                f"heading of {setup.scanner_heading_deg}. Must let the horizontal pulse strike the "
                "front: headings less than 90 degrees apart, tilt less than 90."
            )
        lift = self.height_difference_m / upward[..., 2]
        along = self.range_m / level[..., 0] - lift * dot(normal, upward) / facing
        return Patch(along[..., None] * level + lift[..., None] * upward, -normal)


TARGET_NAMES = {"target_heading_deg": "heading_deg", "target_tilt_deg": "tilt_deg"}


TARGET_NAMES |= {name: name for name in ("range_m", "height_difference_m")}


def dot(a, b):
    """Return the inner products over the last axis."""
    return np.sum(a * b, axis=-1)
