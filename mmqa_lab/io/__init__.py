"""Every file in and out: clouds, outlines, trajectories, lines, heights and images.

Files are written whole or not at all. A damaged file gives one sentence. Functions of other rooms
take arrays; columns, units and coordinate systems of files are checked here. Each module reads what
its name says; ``files`` is how a file is written and read at all.
"""

from mmqa_lab.io.cameras import read_camera
from mmqa_lab.io.clouds import CLOUD_ENDINGS, iterate_cloud, read_cloud
from mmqa_lab.io.contents import describe_file
from mmqa_lab.io.files import own_folder, write_atomically
from mmqa_lab.io.images import IMAGE_ENDINGS, read_bands, read_image
from mmqa_lab.io.las import LAS_ENDINGS, write_cloud
from mmqa_lab.io.outlines import (
    OUTLINE_ENDINGS,
    read_outlines,
    read_polygon,
    write_outlines,
    write_polygon,
)
from mmqa_lab.io.rasters import is_raster, read_heights, write_raster
from mmqa_lab.io.tables import coordinate_columns, read_segments, read_table, with_numbers
from mmqa_lab.io.trajectories import read_trajectory

__all__ = [
    "CLOUD_ENDINGS", "IMAGE_ENDINGS", "LAS_ENDINGS", "OUTLINE_ENDINGS", "coordinate_columns",
    "describe_file",
    "is_raster", "iterate_cloud", "own_folder", "read_bands", "read_camera", "read_cloud",
    "read_heights", "read_image", "read_outlines", "read_polygon", "read_segments", "read_table",
    "read_trajectory", "with_numbers", "write_atomically", "write_cloud", "write_outlines",
    "write_polygon", "write_raster",
]  # fmt: skip
