"""Quality figures in the cells of a map: one tile's points in, one array per figure out.

What a chart gets as a whole, each cell of a map gets: density, spacing d1..d4, f, sigma_MAD, linear
point distance, share of voids. The order of work is that of the modules:

1. ``cubes``: points are sorted into cubes of the cell's size (into columns, on horizontal maps).
2. ``tangents``: each cube gets the regression plane of its points, and with it a layer: *level*,
   *upright*, or *other* where the points show no plane. Level cubes on top of each other that show
   one surface become one patch.
3. ``unfolding``: patches are laid out side by side, each in its own plane, and searched at once by
   :func:`mmqa_lab.neighbourhoods.quadrant_distances`.
4. ``tile``: per cell and layer, counts and medians.

Nothing here depends on what lies beyond the search radius, nor on the tile: the same points give
the same bits.
"""

from mmqa_lab.maps.tile import LAYERS, METRICS, UNITS, VARIABLES, Window, evaluate_tile, reach

__all__ = ["LAYERS", "METRICS", "UNITS", "VARIABLES", "Window", "evaluate_tile", "reach"]
