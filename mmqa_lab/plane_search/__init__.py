"""Planes of a whole cloud, from local trials and growth over a grid of cells, in linear time.

A trial of three neighbouring points needs no normals. Profiles of mobile scanners are dense along
the line and sparse across it, so normals from nearest neighbours describe a scan line, not the
wall. Every trial and every step of growth uses only the cells around it. So a kilometre of street
is treated like a room, and no cloud is thinned. Poreba & Goulette 2013 name principal planes, such
as walls and roads, and leave their detection to a companion paper.
"""

from mmqa_lab.plane_search.detection import PlanePart, detect_planes, usual_size
from mmqa_lab.plane_search.growth import CELLS_PER_SIZE, Grid

__all__ = ["CELLS_PER_SIZE", "Grid", "PlanePart", "detect_planes", "usual_size"]
