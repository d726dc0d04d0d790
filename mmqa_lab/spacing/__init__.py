"""Spacing of points in a plane: quadrant distances, d1..d4, f, spacing by direction, g.

d1..d4 and f compare the distances from each point to its neighbours in four quadrants
(:func:`quadrants`), g those by direction (:func:`directional`). The *empty-space distance* e95 is
a length of its own: 95 % of the places of the surface lie within e95 of a point
(:func:`empty_space`). :func:`exempt` tells where f does not matter.
"""

from mmqa_lab.spacing.directions import DirectionalSpacing, block_numbers, directional, line_parts
from mmqa_lab.spacing.empty import EmptySpace, empty_space
from mmqa_lab.spacing.quadrants import (
    Spacing,
    exempt,
    poisson_spacing,
    quadrant_distances,
    quadrants,
    turned_f,
)

__all__ = [
    "DirectionalSpacing", "EmptySpace", "Spacing", "block_numbers", "directional", "empty_space",
    "exempt", "line_parts", "poisson_spacing", "quadrant_distances", "quadrants", "turned_f",
]  # fmt: skip
