"""In the notebook: controls, selecting a polygon, marking legibility."""

from mmqa_lab.widgets.controls import choice, explore, slider
from mmqa_lab.widgets.jury import JuryForm
from mmqa_lab.widgets.selection import SelectionTool, View, select_polygon, summary

__all__ = [
    "JuryForm",
    "SelectionTool",
    "View",
    "choice",
    "explore",
    "select_polygon",
    "slider",
    "summary",
]
