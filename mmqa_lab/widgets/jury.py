"""The jury's form: marks of how well texts can be read."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import ipywidgets
import numpy as np
import pandas as pd
from IPython.display import Image, display

from mmqa_lab._checks import check_choice, refuse
from mmqa_lab.chart_image import MARKS, check_marks
from mmqa_lab.charts import encode
from mmqa_lab.io import write_atomically
from mmqa_lab.io.files import alone
from mmqa_lab.views import is_headless

__all__ = ["LARGEST_ZOOM", "JuryForm"]

MEANINGS = {"a": "a: every letter", "b": "b: the text", "c": "c: not legible"}

# Largest width and zoom of a crop on the screen. The zoom is a whole number, so no pixel is
# interpolated.
WIDEST_PX, LARGEST_ZOOM = 800, 12


class JuryForm:
    """A form in which a juror marks how well texts can be read.

    Each juror sees the same crops in the same order, without their names. The marks are a (every
    letter), b (the text) and c (not legible). Every mark is written to the file before the next
    crop is shown. A new form on the same file continues with the first crop without a mark.

    Parameters
    ----------
    crops : dict of str to array, shape (rows, columns)
        Images in linear light by name of the element, such as ``"photo 3, text_1"``.
    juror : str
        Name of the juror.
    file : path
        CSV with ``juror``, ``element``, ``mark``. All jurors share it. It is created if missing.

    Attributes
    ----------
    box : ipywidgets.Widget
        The form, as a notebook shows it.

    Raises
    ------
    ValueError
        If the file contains invalid marks.

    Examples
    --------
    >>> import tempfile
    >>> file = Path(tempfile.mkdtemp()) / "marks.csv"
    >>> form = JuryForm({"sign": np.ones((4, 9))}, juror="first", file=file)
    >>> form.mark("a")
    >>> pd.read_csv(file)["mark"].tolist(), form.element is None
    (['a'], True)
    """

    def __init__(self, crops: Mapping[str, Any], *, juror: str, file: str | os.PathLike):
        self._juror, self._file, self._crops = juror.strip(), Path(file), dict(crops)
        odd = [name for name in crops if not isinstance(name, str) or not name.strip()]
        refuse(not self._juror, "juror", repr(juror), "a name")
        refuse(odd, "name of a crop", repr(odd[0]) if odd else "", "a text that is not empty")
        self._picture = ipywidgets.Image(format="png", layout={"object_fit": "none"})
        self._line = ipywidgets.Label()
        self._buttons = [ipywidgets.Button(description=text) for text in MEANINGS.values()]
        for mark, button in zip(MEANINGS, self._buttons, strict=True):
            button.on_click(lambda _, mark=mark: self.mark(mark))
        self.box = ipywidgets.VBox([self._line, ipywidgets.HBox(self._buttons), self._picture])
        self._show()

    @property
    def marks(self) -> pd.DataFrame:
        """All marks in the file, of all jurors."""
        if not self._file.is_file():
            return pd.DataFrame(columns=["juror", "element", "mark"])
        return check_marks(pd.read_csv(self._file, dtype=str, keep_default_na=False))

    @property
    def element(self) -> str | None:
        """Name of the crop shown; None if all crops are marked."""
        marks = self.marks
        done = set(marks.loc[marks["juror"] == self._juror, "element"])
        return next((name for name in self._crops if name not in done), None)

    def mark(self, mark: str) -> None:
        """Mark the crop shown with a, b or c, write the mark to the file and show the next crop."""
        check_choice(mark, "mark", MARKS)
        if (element := self.element) is not None:
            row = {"juror": self._juror, "element": element, "mark": mark}
            with alone(self._file):  # other jurors write into it, too
                write_atomically(self._file, pd.concat([self.marks, pd.DataFrame([row])]))
            self._show()

    def _ipython_display_(self):
        """Show the form; without a screen, the current crop."""
        display(Image(self._picture.value) if is_headless() else self.box)

    def _show(self):
        """Show the next crop, or the end of the form."""
        element, names = self.element, list(self._crops)
        place = len(names) if element is None else names.index(element)
        for button in self._buttons:
            button.disabled = element is None
        state = f"{place + 1} of {len(names)}" if element else "all are marked, thank you."
        self._line.value = f"{self._juror}: {state}"
        self._picture.value = _png(self._crops[element]) if element else b""


def _png(crop):
    """A crop as PNG, each pixel enlarged to a square."""
    import cv2

    low, high = np.percentile(crop, [0.5, 99.5])
    shown = encode(np.clip((crop - low) / max(high - low, 1e-9), 0, 1), "srgb")
    zoom = int(np.clip(WIDEST_PX // crop.shape[1], 1, LARGEST_ZOOM))
    pixels = np.kron(np.round(shown * 255).astype(np.uint8), np.ones((zoom, zoom), np.uint8))
    return cv2.imencode(".png", pixels)[1].tobytes()
