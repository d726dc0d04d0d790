"""Spacing of points in a plane: quadrant distances, d1..d4, f, spacing by direction, g, and others.

:func:`quadrants` gives d1..d4 and f, :func:`directional` the spacing by direction and g, each with
95 % intervals; :func:`exempt` says where f does not matter.
"""

from mmqa_lab.spacing._directional import (
    DirectionalSpacing,
    clark_evans,
    directional,
    pair_contrast,
    structure_tensor_ratio,
    turned_f,
)
from mmqa_lab.spacing._quadrants import (
    Spacing,
    exempt,
    poisson_spacing,
    quadrant_distances,
    quadrants,
)

__all__ = [
    "DirectionalSpacing",
    "Spacing",
    "clark_evans",
    "directional",
    "exempt",
    "pair_contrast",
    "poisson_spacing",
    "quadrant_distances",
    "quadrants",
    "structure_tensor_ratio",
    "turned_f",
]
