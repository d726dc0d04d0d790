"""Scan geometry of 2-D profile scanners on a moving vehicle: prediction and measurement.

The scan lattice has two steps on the surface: to the next pulse, and to the next profile.
Example::

    from mmqa_lab.scan_pattern import ScanSetup, Target, scan_lattice

    setup = ScanSetup(
        pulse_rate_hz=300_000, mirror_frequency_hz=100, speed_m_s=10,
        scanner_heading_deg=45, scanner_tilt_deg=45,
    )
    lattice = scan_lattice(setup, Target(heading_deg=15, range_m=5))
    lattice.profile_spacing_horizontal_m, lattice.density_per_m2, lattice.f

``planning`` has the largest speed and what errors of the inputs do, ``measure`` measured
patterns, ``mimic`` the paper's own equations, ``setup`` the frame and the signs.
"""

from mmqa_lab.scan_pattern import mimic
from mmqa_lab.scan_pattern.lattice import (
    LATTICE_QUANTITIES,
    Lattice,
    detail_size,
    lattice_distances,
    scan_lattice,
)
from mmqa_lab.scan_pattern.measure import measure_pattern, revolutions_from_time
from mmqa_lab.scan_pattern.planning import explain_error, largest_speed, propagate, speeds
from mmqa_lab.scan_pattern.setup import Patch, ScanSetup, Target

__all__ = [
    "LATTICE_QUANTITIES", "Lattice", "Patch", "ScanSetup", "Target", "detail_size",
    "explain_error", "largest_speed", "lattice_distances", "measure_pattern", "mimic",
    "propagate", "revolutions_from_time", "scan_lattice", "speeds",
]  # fmt: skip
