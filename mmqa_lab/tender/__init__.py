"""A tender's verdicts: measured figures against criteria, with margin and uncertainty.

:func:`verdict` is the rule for one figure, :func:`verdicts` compares any figures with any
criteria, :func:`qualification` sums up per system. Of marks a is better than b, and b than c.
:func:`published_criteria` and :func:`published_results` are those of Pfeifer et al. 2021
(doi:10.3390/rs13020237), sections 4.2 and 4.4, Tables 1 and 2.
"""

from mmqa_lab.tender.paper import published_criteria, published_results
from mmqa_lab.tender.tables import QUANTITIES
from mmqa_lab.tender.verdicts import COVERAGE, qualification, verdict, verdicts

__all__ = [
    "COVERAGE", "QUANTITIES", "published_criteria", "published_results", "qualification",
    "verdict", "verdicts",
]  # fmt: skip
