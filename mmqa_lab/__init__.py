"""A laboratory for the quality of mobile mapping point clouds and images.

The package is a set of rooms, each a module named by a noun of the field; import the room you
need (``from mmqa_lab import chart_cloud``). Nothing heavy is imported here.
"""

__version__ = "0.2.0"
