"""Controls for notebooks: explorers of figures, the selection of a surface, the jury's form.

Without a screen (``MMQA_HEADLESS``) every control is replaced by a picture of its first state.
"""

from mmqa_lab._checks import needs

needs("lab", "ipywidgets")

from mmqa_lab.widgets.jury import JuryForm
from mmqa_lab.widgets.screen import Halt, choice, explore, slider
from mmqa_lab.widgets.selection import SelectionTool
from mmqa_lab.widgets.surfaces import SurfaceTool

__all__ = ["Halt", "JuryForm", "SelectionTool", "SurfaceTool", "choice", "explore", "slider"]
__dir__ = __all__.copy
