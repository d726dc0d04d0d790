"""Every file in and out: clouds, polygons, trajectories, lines, heights and images.

Files are written whole or not at all. A damaged file gives one sentence. Functions of other rooms
take arrays; columns, units and coordinate systems of files are checked here. ``files`` is how a
file is written and read at all, ``clouds`` has clouds and LAS, ``ply`` and ``tables`` the other
forms of them, ``systems`` coordinate systems, ``polygons``, ``images`` and ``cameras`` what
their names say.
"""

from mmqa_lab.io.cameras import read_camera
from mmqa_lab.io.clouds import CLOUD_ENDINGS, LAS_ENDINGS, iterate_cloud, read_cloud, write_cloud
from mmqa_lab.io.files import own_folder, write_atomically
from mmqa_lab.io.images import IMAGE_ENDINGS, read_bands, read_heights, read_image
from mmqa_lab.io.polygons import OUTLINE_ENDINGS, read_polygon, write_polygon
from mmqa_lab.io.tables import (
    coordinate_columns,
    read_segments,
    read_table,
    read_trajectory,
    with_numbers,
)

__all__ = [
    "CLOUD_ENDINGS", "IMAGE_ENDINGS", "LAS_ENDINGS", "OUTLINE_ENDINGS", "coordinate_columns",
    "iterate_cloud", "own_folder", "read_bands", "read_camera", "read_cloud", "read_heights",
    "read_image", "read_polygon", "read_segments", "read_table", "read_trajectory",
    "with_numbers", "write_atomically", "write_cloud", "write_polygon",
]  # fmt: skip
