"""Maps of quality figures in square cells, for a cloud in memory or for a campaign in tiles.

Each cell has the figures of a chart: density, spacings d1..d4, f, the empty-space distance e95, and
sigma_MAD about the plane of its points. :func:`map_cloud` maps a cloud. :func:`map_campaign` maps
files tile by tile on Dask, and :func:`open_map` opens the map. The figures do not depend on the
size of the tiles. ``dataset["f"].plot()`` draws a figure.
"""

from mmqa_lab.maps.campaign import map_campaign, open_map
from mmqa_lab.maps.cells import ENDINGS, FIGURES, map_cloud, placed, summarise, write_map

__all__ = [
    "ENDINGS", "FIGURES", "map_campaign", "map_cloud", "open_map", "placed", "summarise",
    "write_map",
]  # fmt: skip
