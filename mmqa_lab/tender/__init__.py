"""A tender's verdicts: measured figures against criteria, with margin and uncertainty.

:func:`verdicts` compares any figures with any criteria, :func:`qualification` sums up per system.
:func:`published_criteria` and :func:`published_results` are those of Pfeifer et al. 2021
(doi:10.3390/rs13020237), sections 4.2 and 4.4, Tables 1 and 2. ``mmqa accept`` judges a delivered
drive past the test site: ``acceptance`` finds, checks and evaluates, ``report`` writes.
"""

from mmqa_lab.tender.criteria import (
    COVERAGE,
    CRITERIA,
    SETS,
    published_criteria,
    published_results,
    qualification,
    verdicts,
)

__all__ = [
    "COVERAGE",
    "CRITERIA",
    "SETS",
    "published_criteria",
    "published_results",
    "qualification",
    "verdicts",
]
__dir__ = __all__.copy
