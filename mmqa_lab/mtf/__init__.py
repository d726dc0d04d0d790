"""Resolution in images: edges, Siemens stars, bars and local sharpness.

All take an array of grey values in proportion to light.
"""

from mmqa_lab.mtf.edges import fit_edge
from mmqa_lab.mtf.patterns import (
    blur_dependence,
    haar_sharpness,
    measure_star,
    read_bars,
    resolving_power,
)

__all__ = [
    "blur_dependence",
    "fit_edge",
    "haar_sharpness",
    "measure_star",
    "read_bars",
    "resolving_power",
]
__dir__ = __all__.copy
