"""3-D line segments: their distances, which belong together, and how far apart the sets are."""

from mmqa_lab.segments.compensation import DisplacedMatch, match_displaced
from mmqa_lab.segments.correspondence import MATCHERS, correspond
from mmqa_lab.segments.displacement import Displacement, DriftPrior, fit_displacement
from mmqa_lab.segments.distance import Components, components, distance_matrix
from mmqa_lab.segments.geometry import Segments, check_segments
from mmqa_lab.segments.hausdorff import LHD, Directed, lhd, olhd
from mmqa_lab.segments.scores import PairingScores, pairing_scores, scores_from_counts
from mmqa_lab.segments.thresholds import (
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
    "PairingScores",
    "Segments",
    "Threshold",
    "check_segments",
    "components",
    "correspond",
    "distance_matrix",
    "fit_displacement",
    "fixed_threshold",
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
