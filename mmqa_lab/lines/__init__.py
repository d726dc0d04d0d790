"""3-D line segments: from clouds, their Hausdorff distance, which belong together, how far apart.

Edges of clouds are the lines where principal planes meet; outlines are those of boards.
"""

from mmqa_lab.lines.compensation import DisplacedMatch, match_displaced
from mmqa_lab.lines.correspondence import MATCHERS, correspond
from mmqa_lab.lines.displacement import Displacement, DriftPrior, fit_displacement
from mmqa_lab.lines.distance import Components, components, distance_matrix
from mmqa_lab.lines.edges import Edges, extract_edges, intersect_patches
from mmqa_lab.lines.geometry import Segments, check_segments
from mmqa_lab.lines.hausdorff import LHD, Directed, hausdorff, lhd, olhd
from mmqa_lab.lines.outlines import Outline, fit_outline
from mmqa_lab.lines.scores import PairingScores, pairing_scores, scores_from_counts
from mmqa_lab.lines.thresholds import (
    Threshold,
    fixed_threshold,
    mad_threshold,
    mixture_threshold,
    otsu_threshold,
    peak_threshold,
)

__all__ = [
    "LHD",
    "MATCHERS",
    "Components",
    "Directed",
    "DisplacedMatch",
    "Displacement",
    "DriftPrior",
    "Edges",
    "Outline",
    "PairingScores",
    "Segments",
    "Threshold",
    "check_segments",
    "components",
    "correspond",
    "distance_matrix",
    "extract_edges",
    "fit_displacement",
    "fit_outline",
    "fixed_threshold",
    "hausdorff",
    "intersect_patches",
    "lhd",
    "mad_threshold",
    "match_displaced",
    "mixture_threshold",
    "olhd",
    "otsu_threshold",
    "pairing_scores",
    "peak_threshold",
    "scores_from_counts",
]
