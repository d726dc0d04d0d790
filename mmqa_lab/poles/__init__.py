"""Poles: two published detectors, a learned one, and scores against a reference.

    from mmqa_lab import poles

    found = poles.detect(cloud)                         # or method="fgi", method="itc"
    result = poles.score(found, reference, corridor=15, trajectory=positions)
    result.recall, result.precision

``fgi`` follows scan lines (Lehtomaki et al. 2010), ``itc`` connected components (Pu et al. 2011).
``learned`` uses 24 named measures and 200 small trees, and 20 trees of two leaves calibrate it.

A pole is an upright shaft (tilt at most 12 degrees) of 1 m or more that stands free, at least six
times as high as wide with what it carries: lamps, signs, masts, trunks and slender bollards are
poles. Pillars of gates, columns that carry a building, posts of fences and terraces, scaffolding
and wires are none.
"""

from mmqa_lab.poles.detectors import METHODS, detect
from mmqa_lab.poles.scores import Score, match, score

__all__ = ["METHODS", "Score", "detect", "match", "score"]
