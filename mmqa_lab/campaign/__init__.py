"""Maps of whole campaigns: any number of LAS, LAZ and COPC files, in tiles, on any number of cores.

The way of a campaign:

1. ``files`` lists the files, reads their headers, and unpacks each once into the run folder: bare
   coordinates, and the bounding box of every piece of 50 000 points. COPC files have an index of
   their own and stay as they are.
2. ``grid`` lays square tiles over the pieces. Cells lie at multiples of their size from the
   coordinates' zero, tiles at multiples of theirs.
3. ``engine`` hands the tiles to Dask: to processes on this machine or to a cluster. Each reads its
   points and a halo around it, calls :func:`mmqa_lab.maps.evaluate_tile` and writes one file.
4. ``outputs`` puts the files together, lazily, as an xarray Dataset, and writes it;
   ``summary`` and ``report`` tell what is in it.

What is on disk is what is done: a tile's file appears whole, with the names of the points' sources
in it, so a run that was stopped goes on with the tiles that are missing or out of date.
"""

from mmqa_lab.campaign.outputs import open_map, write_map
from mmqa_lab.campaign.run import Outcome, map_campaign
from mmqa_lab.campaign.summary import summarise

__all__ = ["Outcome", "map_campaign", "open_map", "summarise", "write_map"]
