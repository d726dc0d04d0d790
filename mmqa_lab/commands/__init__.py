"""The commands of ``mmqa``.

``machine`` registers commands and writes what they return, ``surveys`` has those on a user's own
data, ``laboratory`` those of studies, notebooks and tests.
"""

from mmqa_lab.commands import laboratory, surveys
from mmqa_lab.commands.machine import run

__all__ = ["laboratory", "run", "surveys"]
