"""3-D line segments: their distances, which belong together, and how far apart the sets are."""

from mmqa_lab.segments.distance import Components, components, distance_matrix, overlaps
from mmqa_lab.segments.geometry import Segments, check_segments

__all__ = [
    "Components",
    "Segments",
    "check_segments",
    "components",
    "distance_matrix",
    "overlaps",
]
