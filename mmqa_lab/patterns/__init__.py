"""Scan patterns measured in point clouds: of planar patches, and of whole profiles with time."""

from mmqa_lab.patterns.measure import PatternMeasurement, measure_pattern
from mmqa_lab.patterns.numbering import (
    mirror_frequency,
    profiles_from_pattern,
    revolutions_from_time,
)
from mmqa_lab.patterns.scan_planes import ScanPlanes, fit_scan_planes

__all__ = [
    "PatternMeasurement",
    "ScanPlanes",
    "fit_scan_planes",
    "measure_pattern",
    "mirror_frequency",
    "profiles_from_pattern",
    "revolutions_from_time",
]
