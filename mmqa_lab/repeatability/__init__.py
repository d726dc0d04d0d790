"""How far quality figures vary when an operator selects the same surface again.

An operator's polygon is a nominal outline whose vertices carry a click error. Selections of one
scan differ in it alone (repeatability), scans of one surface differ too; ISO 5725 and the analysis
of variance take these parts from each other, and ``laws`` says what to expect.
"""

from mmqa_lab.repeatability.laws import PowerLaw, contaminated_sigma_mad, power_law, strip_law
from mmqa_lab.repeatability.operator import evaluate_selections, operator_polygons, with_strays
from mmqa_lab.repeatability.variance import Repeatability, repeatability, variance_components

__all__ = [
    "PowerLaw",
    "Repeatability",
    "contaminated_sigma_mad",
    "evaluate_selections",
    "operator_polygons",
    "power_law",
    "repeatability",
    "strip_law",
    "variance_components",
    "with_strays",
]
