"""The point-distribution chart: quality figures of a selection of points.

The source is Pfeifer et al. 2021 (doi 10.3390/rs13020237), sections 3.3 and 4.2 and Appendix A.
``evaluate`` measures, ``quality`` is the result, ``doubts`` says what speaks against it, and
``selection`` chooses the points.
"""

from mmqa_lab.chart_cloud.evaluate import evaluate_cloud
from mmqa_lab.chart_cloud.quality import CloudQuality
from mmqa_lab.chart_cloud.selection import CHART_MARGINS_M, chart_polygon, inside_polygon

__all__ = [
    "CHART_MARGINS_M", "CloudQuality", "chart_polygon", "evaluate_cloud", "inside_polygon",
]  # fmt: skip
