"""Chart metrics, Pfeifer et al. 2021: Table 2 from point clouds, Table 1 from images.

``points`` holds the published Table 2 and real clouds.
"""

from mmqa_lab.studies.chart_tables import points

QUICK = {}


def claims(table, check):
    """Test what the notebook says."""
    return points.claims(table, check)
