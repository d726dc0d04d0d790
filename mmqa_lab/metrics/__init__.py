"""The field's metrics of a planar point pattern and its noise, each with its source.

``METRICS`` holds them by name. Each is called with a chart (a
:class:`~mmqa_lab.chart_cloud.CloudQuality`) and has ``unit``, ``better``, ``source``, ``formula``
and ``misses``. :func:`table` measures several; which of them says what can be done with a cloud
is the subject of notebook 12.
"""

from mmqa_lab.metrics import definitions
from mmqa_lab.metrics.pattern import Pattern
from mmqa_lab.metrics.registry import METRICS, Metric, supports, table

__all__ = ["METRICS", "Metric", "Pattern", "definitions", "supports", "table"]
