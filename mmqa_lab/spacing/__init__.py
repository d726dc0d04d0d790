"""Spacing of points: quadrant distances d1..d4, f, directional spacing, g, coincident points."""

from mmqa_lab.spacing.directional import (
    DirectionalSpacing,
    clark_evans,
    directional_spacing,
    pair_contrast,
    structure_tensor_ratio,
    turned_f,
)
from mmqa_lab.spacing.quadrants import (
    Spacing,
    count_coincident,
    poisson_spacing,
    quadrant_distances,
    spacing,
)

__all__ = [
    "DirectionalSpacing",
    "Spacing",
    "clark_evans",
    "count_coincident",
    "directional_spacing",
    "pair_contrast",
    "poisson_spacing",
    "quadrant_distances",
    "spacing",
    "structure_tensor_ratio",
    "turned_f",
]
