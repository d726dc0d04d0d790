"""Quality figures in the cells of a map, of a cloud in memory or of a campaign of any size.

What a chart gets as a whole, each cell of a map gets: density, spacing d1..d4, f, sigma_MAD, linear
point distance, share of voids. :func:`map_cloud` maps a cloud in memory; :func:`map_campaign` maps
files tile by tile, on all cores or a Dask cluster, and :func:`open_map` opens what it made. Nothing
depends on what lies beyond the search radius, nor on the tiles: the same points give the same bits.
"""

from mmqa_lab.maps.campaign import Outcome, map_campaign
from mmqa_lab.maps.results import map_cloud, open_map, summarise, write_map
from mmqa_lab.maps.tile import METRICS

__all__ = ["METRICS", "Outcome", "map_campaign", "map_cloud", "open_map", "summarise", "write_map"]
__dir__ = __all__.copy
