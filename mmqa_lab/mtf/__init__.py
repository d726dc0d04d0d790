"""Resolution in images: edges, Siemens stars, bars and local sharpness."""

from mmqa_lab.mtf.bars import read_bars, resolving_power
from mmqa_lab.mtf.chart_edge import EdgeResponse, edge_response
from mmqa_lab.mtf.edge import EdgeFit, dependence, fit_edge
from mmqa_lab.mtf.sharpness import haar_sharpness, mean_sharpness
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
