"""Every file in and out: clouds, polygons, trajectories, lines, heights and images.

Files are written whole or not at all; a damaged one gives one sentence.
"""

from mmqa_lab.io._files import write_atomically
from mmqa_lab.io.clouds import CLOUD_ENDINGS, LAS_ENDINGS, read_cloud, write_cloud
from mmqa_lab.io.images import read_grey
from mmqa_lab.io.lines import read_segments, write_segments
from mmqa_lab.io.rasters import read_heights
from mmqa_lab.io.tables import read_polygon, read_trajectory, write_polygon

__all__ = [
    "CLOUD_ENDINGS",
    "LAS_ENDINGS",
    "read_cloud",
    "read_grey",
    "read_heights",
    "read_polygon",
    "read_segments",
    "read_trajectory",
    "write_atomically",
    "write_cloud",
    "write_polygon",
    "write_segments",
]
__dir__ = __all__.copy
