"""Resolution in images: edges, Siemens stars, bars, and sharpness without targets.

All take an array of grey values in proportion to light. Lengths in pixels, frequencies in cycles
per pixel. What speaks against an edge or a star is in ``doubts``.
"""

from mmqa_lab.mtf.edges import EdgeResponse, fit_edge
from mmqa_lab.mtf.sharpness import haar_sharpness, read_bars, resolving_power
from mmqa_lab.mtf.stars import StarMtf, measure_star

__all__ = [
    "EdgeResponse", "StarMtf", "fit_edge", "haar_sharpness", "measure_star", "read_bars",
    "resolving_power",
]  # fmt: skip
