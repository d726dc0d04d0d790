"""3-D line segments: from clouds, their Hausdorff distance, which belong together, how far apart.

Edges of clouds are the lines where principal planes meet; outlines are those of boards.
"""

from mmqa_lab.lines.comparisons import study
from mmqa_lab.lines.displacement import fit_displacement, match_displaced
from mmqa_lab.lines.edges import extract_edges, fit_outline
from mmqa_lab.lines.hausdorff import LHD, hausdorff, lhd
from mmqa_lab.lines.segments import (
    Segments,
    components,
    correspond,
    distance_matrix,
    pairing_scores,
    peak_threshold,
)

__all__ = [
    "LHD",
    "Segments",
    "components",
    "correspond",
    "distance_matrix",
    "extract_edges",
    "fit_displacement",
    "fit_outline",
    "hausdorff",
    "lhd",
    "match_displaced",
    "pairing_scores",
    "peak_threshold",
    "study",
]
__dir__ = __all__.copy
