"""Resolution in images: edges, Siemens stars, bars and local sharpness.

Two estimators of one quantity, the transfer of contrast across an edge: ``fit_edge`` describes the
edge by a sigmoid (two shapes) and gives FWHM and MTF50; ``edge_response`` is the edge method of ISO
12233 with a fit that follows any profile, sharpened ones too, and gives the whole MTF. Both take an
array of grey values in proportion to light and share what pixels see of an edge (``spread``).
"""

from mmqa_lab.mtf.bars import read_bars, resolving_power
from mmqa_lab.mtf.edge_method import EdgeResponse, edge_response
from mmqa_lab.mtf.sharpness import haar_sharpness, mean_sharpness
from mmqa_lab.mtf.sigmoid import EdgeFit, dependence, fit_edge
from mmqa_lab.mtf.star import StarMtf, measure_star

__all__ = [
    "EdgeFit",
    "EdgeResponse",
    "StarMtf",
    "dependence",
    "edge_response",
    "fit_edge",
    "haar_sharpness",
    "mean_sharpness",
    "measure_star",
    "read_bars",
    "resolving_power",
]
