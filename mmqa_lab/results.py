"""What a study leaves behind: tables, figures, named values, claims and a run record."""

import json
import os
import platform
import time
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path

import numpy as np
import pandas as pd

from mmqa_lab import samples
from mmqa_lab.io import write_atomically

ROOT_VARIABLE = "MMQA_RESULTS"
FORMATS = ("pdf", "svg", "png")

KINDS = ("published", "predicted", "fitted", "measured")
"""What a number can be: printed in a paper, from specifications alone, from parameters chosen so
that it comes close, or taken from a real or simulated cloud or image."""

TOUCHING_PX = 1.5
"""Boxes of texts include the room of letters that are not there; so much of it may be shared."""

LIBRARIES = ("numpy", "scipy", "pandas", "laspy", "matplotlib", "pyvista", "xarray", "statsmodels")


@dataclass(frozen=True)
class Claim:
    """A sentence of a study's prose, put to the test.

    Parameters
    ----------
    sentence : str
        What the notebook says.
    holds : bool
        Whether this run bears it out.
    obtained : str
        The numbers of this run.
    reason : str
        Where the tolerance comes from.

    Examples
    --------
    >>> ratio = 40.1 / 20.0
    >>> claim = Claim("f is 2.", abs(ratio - 2) < 0.01, f"f = {ratio:.3f}", "digits of d1 and d4")
    >>> claim.holds, claim.obtained
    (True, 'f = 2.005')
    """

    sentence: str
    holds: bool
    obtained: str
    reason: str


def root():
    """Return the folder of all results: ``MMQA_RESULTS``, or ``notebooks/results``.

    Returns
    -------
    Path

    Examples
    --------
    >>> from unittest.mock import patch
    >>> with patch.dict(os.environ, MMQA_RESULTS="elsewhere"):
    ...     root().name
    'elsewhere'
    """
    default = Path(__file__).resolve().parent.parent / "notebooks" / "results"
    return Path(os.environ.get(ROOT_VARIABLE, default))


class Run:
    """The results of one run of one study, each file written whole or not at all.

    Parameters
    ----------
    stem : str
        The study's stem; results go to ``<root>/<stem>/``.
    parameters : dict
        What the notebook was run with, for the record.

    Examples
    --------
    >>> import tempfile
    >>> os.environ["MMQA_RESULTS"] = tempfile.mkdtemp()
    >>> run = Run("example", parameters={"seed": 1})
    >>> run.save_value("f_poisson", 3.257, "1", "predicted")
    >>> run.finish()
    >>> sorted(path.name for path in run.folder.iterdir())
    ['run.json', 'values.csv']
    >>> del os.environ["MMQA_RESULTS"]
    """

    def __init__(self, stem, *, parameters):
        self.stem = stem
        self.folder = root() / stem
        self._parameters = parameters
        self._began = time.time()
        self._values = []
        self._claims = []
        self._files = []
        self._overlaps = {}
        self._answer = {"sentence": "", "figure": ""}
        for left in self.folder.glob(".*"):  # by a run that was killed while it wrote
            left.unlink()

    def save_table(self, frame, name, *, kind=""):
        """Write a DataFrame as ``<name>.csv``.

        A table says of its numbers which of ``KINDS`` they are, by a column's name or in a column;
        where it does not, ``kind`` becomes such a column, and tells of the columns without a word.

        Raises
        ------
        ValueError
            If the table has numbers, and neither it nor ``kind`` says of which kind they are.
        """
        if kind:
            frame = frame.assign(**{"kind_of_number" if "kind" in frame else "kind": kind})
        if not _says_kind(frame):
            raise ValueError(
                f"Invalid table {name}: nothing says which kind its numbers are. "
                f"Must be one of {', '.join(KINDS)}."
            )
        self._write(f"{name}.csv", lambda path: frame.to_csv(path, index=False))

    def save_figure(self, figure, name):
        """Write a matplotlib figure as PDF, SVG and PNG, equal to the byte from run to run.

        Texts that overlap or leave the figure are named in the run record.
        """
        dates = {"pdf": {"CreationDate": None}, "svg": {"Date": None}, "png": {}}
        for form in FORMATS:
            self._write(
                f"{name}.{form}",
                lambda path, form=form: figure.savefig(path, metadata=dates[form]),
            )
        if found := overlapping_texts(figure):
            self._overlaps[name] = found

    def save_value(self, name, value, unit, kind):
        """Keep a named number of a kind; :meth:`finish` writes all of them as ``values.csv``."""
        self._values.append({"name": name, "value": float(value), "unit": unit, "kind": kind})

    def save_answer(self, sentence, *, figure):
        """Keep the study's answer with its numbers, and the figure that shows it.

        The gallery and the README take them from the run record.
        """
        self._answer = {"sentence": sentence, "figure": figure}

    def save_claims(self, claims):
        """Write the claims as ``claims.csv``.

        Raises
        ------
        AssertionError
            If one does not hold; it names the first.
        """
        self._claims = list(claims)
        frame = pd.DataFrame([asdict(claim) for claim in self._claims])
        self._write("claims.csv", lambda path: frame.to_csv(path, index=False))
        broken = [claim for claim in self._claims if not claim.holds]
        if broken:
            self.finish()
            raise AssertionError(f"Does not hold: {broken[0].sentence} ({broken[0].obtained})")

    def finish(self):
        """Write the named values and the run record."""
        if self._values:
            self.save_table(pd.DataFrame(self._values), "values")
        record = {
            "study": self.stem,
            "answer": self._answer,
            "parameters": self._parameters,
            "seconds": round(time.time() - self._began, 1),
            "claims": len(self._claims),
            "claims_that_hold": sum(bool(claim.holds) for claim in self._claims),
            "overlapping_texts": self._overlaps,
            "files": self._files,
            "python": platform.python_version(),
            "versions": {name: metadata.version(name) for name in LIBRARIES},
            "samples": {sample.name: sample.sha256 for sample in samples.SAMPLES},
        }
        text = json.dumps(record, indent=1, default=_plain)
        self._write("run.json", lambda path: path.write_text(text, encoding="utf-8"))

    def _write(self, name, write):
        """Write one file of this run and remember its name."""
        write_atomically(self.folder / name, write)
        if name not in self._files:
            self._files.append(name)


def _says_kind(frame):
    """Whether a table says of which kind its numbers are, or has none."""
    words = frame.select_dtypes(exclude=["number", "bool"])
    if len(words.columns) == len(frame.columns):
        return True
    if any(kind in str(name) for name in frame for kind in KINDS):
        return True
    pattern = "|".join(KINDS)
    return any(words[name].astype(str).str.contains(pattern).all() for name in words)


def overlapping_texts(figure):
    """Return the texts of a matplotlib figure that overlap one another or leave the figure.

    Parameters
    ----------
    figure : matplotlib.figure.Figure

    Returns
    -------
    list of str
        A sentence for each pair, and for each text that reaches beyond the figure's edge.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> figure = Figure(figsize=(4, 3))
    >>> _ = figure.text(0.5, 0.5, "density"), figure.text(0.52, 0.5, "f")
    >>> overlapping_texts(figure)
    ["'density' and 'f' overlap"]
    """
    figure.draw_without_rendering()
    hidden = _ticks_out_of_view(figure)
    texts = [text for text in figure.findobj(_is_shown_text) if text not in hidden]
    shown = [(text, text.get_window_extent()) for text in texts if text.get_text().strip()]
    edge = figure.bbox.padded(1.0)
    found = [
        f"{text.get_text()!r} leaves the figure"
        for text, box in shown
        if not (edge.contains(box.x0, box.y0) and edge.contains(box.x1, box.y1))
    ]
    for k, (text, box) in enumerate(shown):
        for other, there in shown[:k]:
            width = min(box.x1, there.x1) - max(box.x0, there.x0)
            height = min(box.y1, there.y1) - max(box.y0, there.y0)
            if width > TOUCHING_PX and height > TOUCHING_PX:
                found.append(f"{other.get_text()!r} and {text.get_text()!r} overlap")
    return found


def _is_shown_text(artist):
    """Whether an artist is a text that one can read, in axes that are shown.

    Slanting texts are left out: their upright boxes say little about where they are.
    """
    if not hasattr(artist, "get_fontsize") or not artist.get_visible():
        return False
    if artist.get_rotation() % 90:
        return False
    axes = artist.axes
    return axes is None or (axes.get_visible() and (axes.axison or artist in axes.texts))


def _ticks_out_of_view(figure):
    """Labels of ticks beyond the limits of their axis: they exist but are not drawn."""
    hidden = set()
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            slack = 1e-9 * (high - low)
            for tick in [*axis.get_major_ticks(), *axis.get_minor_ticks()]:
                if not low - slack <= tick.get_loc() <= high + slack:
                    hidden |= {tick.label1, tick.label2}
    return hidden


def _plain(value):
    """NumPy values and paths as JSON knows them."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    return value.item() if isinstance(value, np.generic) else str(value)
