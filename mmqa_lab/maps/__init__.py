"""Quality figures in the cells of a map: one tile's points in, one array per figure out.

What a chart gets as a whole, each cell of a map gets: density, spacing d1..d4, f, sigma_MAD, linear
point distance, share of voids. The order of work is that of the modules:

1. ``cubes``: points are sorted into cubes of the cell's size (into columns, on horizontal maps).
2. ``tangents``: each cube gets the regression plane of its points, and with it a layer: *level*,
   *upright*, or *other* where the points show no plane. Level cubes on top of each other that show
   one surface become one patch.
3. ``unfolding``: patches are laid out side by side, each in its own plane, and searched at once by
   :func:`mmqa_lab.spacing.quadrant_distances`.
4. ``tile``: per cell and layer, counts and medians.

Nothing here depends on what lies beyond the search radius, nor on the tile: the same points give
the same bits.

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

from mmqa_lab.maps.outputs import open_map, write_map
from mmqa_lab.maps.run import Outcome, map_campaign
from mmqa_lab.maps.summary import summarise
from mmqa_lab.maps.tile import LAYERS, METRICS, UNITS, VARIABLES, Window, evaluate_tile, reach

__all__ = [
    "LAYERS",
    "METRICS",
    "UNITS",
    "VARIABLES",
    "Outcome",
    "Window",
    "evaluate_tile",
    "map_campaign",
    "open_map",
    "reach",
    "summarise",
    "write_map",
]
