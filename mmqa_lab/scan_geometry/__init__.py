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

    from mmqa_lab import scan_geometry as sg

    setup = sg.ScanSetup(
        pulse_rate_hz=300_000, mirror_frequency_hz=100, speed_m_s=10,
        scanner_heading_deg=45, scanner_tilt_deg=45,
    )
    lattice = sg.scan_lattice(setup, sg.Target(heading_deg=15, range_m=5).patch(setup))
    lattice.profile_spacing_horizontal_m, lattice.density_per_m2, lattice.f
"""

from mmqa_lab.scan_geometry.lattice import (
    QUANTITIES,
    Lattice,
    crossing_angle,
    lattice_distances,
    scan_lattice,
)
from mmqa_lab.scan_geometry.planning import largest_speed
from mmqa_lab.scan_geometry.setups import ScanSetup
from mmqa_lab.scan_geometry.surfaces import Patch, Target, cylinder_patch, mesh_patch
from mmqa_lab.scan_geometry.uncertainty import propagate, sensitivities

__all__ = [
    "QUANTITIES",
    "Lattice",
    "Patch",
    "ScanSetup",
    "Target",
    "crossing_angle",
    "cylinder_patch",
    "largest_speed",
    "lattice_distances",
    "mesh_patch",
    "propagate",
    "scan_lattice",
    "sensitivities",
]
