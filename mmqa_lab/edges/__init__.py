"""Edges from clouds: principal planes, the lines where they meet, and outlines of boards."""

from mmqa_lab.edges.intersections import Edges, extract_edges, intersect_patches
from mmqa_lab.edges.outlines import Outline, fit_outline
from mmqa_lab.edges.patches import Patch, detect_planes

__all__ = [
    "Edges",
    "Outline",
    "Patch",
    "detect_planes",
    "extract_edges",
    "fit_outline",
    "intersect_patches",
]
