"""3-D line segments: from clouds, their Hausdorff distance, which belong together, how far apart.

A set of segments is an array (n, 2, 3). Edges of clouds are the lines where planes meet.
"""

from mmqa_lab.lines.displacement import fit_displacement, match_displaced
from mmqa_lab.lines.edges import extract_edges
from mmqa_lab.lines.hausdorff import LHD, compare, hausdorff, lhd
from mmqa_lab.lines.segments import (
    components,
    correspond,
    directions,
    distance_matrix,
    lengths,
    midpoints,
    pairing_scores,
    peak_threshold,
)

__all__ = [
    "LHD",
    "compare",
    "components",
    "correspond",
    "directions",
    "distance_matrix",
    "extract_edges",
    "fit_displacement",
    "hausdorff",
    "lengths",
    "lhd",
    "match_displaced",
    "midpoints",
    "pairing_scores",
    "peak_threshold",
]
