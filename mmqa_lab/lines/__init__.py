"""3-D line segments: distance, correspondence and displacement of two sets, edges of clouds.

:mod:`mmqa_lab.lines.segments` has the parts of the distance, :mod:`mmqa_lab.lines.pairing` the
correspondence, :mod:`mmqa_lab.lines.displacement` the displacement, :mod:`mmqa_lab.lines.distance`
the line-segment Hausdorff distance, :mod:`mmqa_lab.lines.edges` the lines where planes meet.
"""

from mmqa_lab.lines.displacement import Displacement, fit_displacement, match_displaced
from mmqa_lab.lines.distance import LHD, compare, lhd
from mmqa_lab.lines.edges import Edges, extract_edges
from mmqa_lab.lines.pairing import Threshold, correspond, pairing_scores, peak_threshold
from mmqa_lab.lines.segments import check_segments, components, directions, lengths, midpoints

__all__ = [
    "LHD", "Displacement", "Edges", "Threshold", "check_segments", "compare", "components",
    "correspond", "directions", "extract_edges", "fit_displacement", "lengths", "lhd",
    "match_displaced", "midpoints", "pairing_scores", "peak_threshold",
]  # fmt: skip
