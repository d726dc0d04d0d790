"""Scan geometry of 2-D profile scanners on a moving vehicle: what falls on a surface, predicted.

Frame, right-handed: X to the target's side, across the track; Y in the direction of travel; Z up;
origin in the scanner at the moment of the pulse. With all rotations zero the scan plane is vertical
across the track (normal Y) and the target a vertical wall along it (normal X). Scanner and target
are tilted first (scanner about X, target about Y), then turned by their heading about Z, both
counter-clockwise positive: a target of positive heading is turned towards the vehicle, one of
positive tilt leans away from it. This reading of Cahalane et al. 2014
(doi 10.3390/s140609471, equation 1) is the one that gives their Table 3.

The core is the scan lattice of two steps on the surface: to the next pulse, and to the same mirror
angle one revolution later. Start here::

    from mmqa_lab import scan_pattern

    setup = scan_pattern.ScanSetup(
        pulse_rate_hz=300_000, mirror_frequency_hz=100, speed_m_s=10,
        scanner_heading_deg=45, scanner_tilt_deg=45,
    )
    wall = scan_pattern.Target(heading_deg=15, range_m=5).patch(setup)
    lattice = scan_pattern.scan_lattice(setup, wall)
    lattice.profile_spacing_horizontal_m, lattice.density_per_m2, lattice.f

Measured patterns: :func:`measure_pattern` on planar patches with time or scan lines.
"""

from mmqa_lab.scan_pattern import mimic
from mmqa_lab.scan_pattern.lattice import (
    QUANTITIES,
    Patch,
    ScanSetup,
    Target,
    explain_error,
    largest_speed,
    propagate,
    scan_lattice,
)
from mmqa_lab.scan_pattern.measure import measure_pattern, revolutions_from_time

__all__ = [
    "QUANTITIES",
    "Patch",
    "ScanSetup",
    "Target",
    "explain_error",
    "largest_speed",
    "measure_pattern",
    "mimic",
    "propagate",
    "revolutions_from_time",
    "scan_lattice",
]
__dir__ = __all__.copy
