"""The point-distribution chart: quality figures of a selection of points.

The source is Pfeifer et al. 2021 (doi 10.3390/rs13020237), sections 3.3 and 4.2 and Appendix A.
``evaluate`` chooses points and measures, ``quality`` is the result, and ``doubts`` says what speaks
against it.
"""

from mmqa_lab.chart_cloud.evaluate import (
    CHART_MARGINS_M,
    chart_polygon,
    evaluate_cloud,
    inside_polygon,
)
from mmqa_lab.chart_cloud.quality import CloudQuality

__all__ = [
    "CHART_MARGINS_M", "CloudQuality", "chart_polygon", "evaluate_cloud", "inside_polygon",
]  # fmt: skip
