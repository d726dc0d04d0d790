"""The commands of ``mmqa``.

``machine`` registers commands and writes what they return. ``laboratory`` has those of studies,
notebooks and tests, each other file those on a user's own data by their subject: a command reads
files by ``io``, calls a room's function with arrays and returns a table. Its signature is its
arguments, its docstring its help. Rooms are imported inside the commands, so that help is quick.
"""

from mmqa_lab.commands import laboratory
from mmqa_lab.commands.acceptance import accuracy, calibrate, plan, tender
from mmqa_lab.commands.clouds import evaluate, info, lhd, map_, pattern, poles
from mmqa_lab.commands.images import chart, image, radiometry
from mmqa_lab.commands.machine import run

__all__ = [
    "accuracy", "calibrate", "chart", "evaluate", "image", "info", "laboratory", "lhd", "map_",
    "pattern", "plan", "poles", "radiometry", "run", "tender",
]  # fmt: skip
