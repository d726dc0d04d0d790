"""The files of one run of a study: tables, figures, values, checks, the ledger, its record."""

from __future__ import annotations

import ast
import functools
import itertools
import json
import os
import platform
import re
import shutil
import subprocess
import zlib
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from string import Formatter
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from IPython import get_ipython
from IPython.display import Markdown, display
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle
from matplotlib_inline.backend_inline import set_matplotlib_formats

from mmqa_lab import __version__
from mmqa_lab._checks import refuse
from mmqa_lab._results import digits
from mmqa_lab.bench import heading, split_unit
from mmqa_lab.io import write_atomically
from mmqa_lab.plots import finish_figure, laid_out, say_kind
from mmqa_lab.published.ledger import entries, verdicts
from mmqa_lab.run.quotes import as_latex, quoted_name, values_tex, values_typ

__all__ = ["RECORD", "Run", "new_record", "parameter_names", "read_record", "verdict"]
__all__ += ["write_record"]

# Formats of figures, with what is left out so that equal runs give equal bytes.
FORMATS = {"pdf": {"CreationDate": None}, "svg": {"Date": None}, "png": {}}

# Most rows of a table that is also written for LaTeX.
LONGEST_LATEX = 60

# Kinds of numbers. Published numbers are printed in a source. Predicted numbers follow from
# specifications alone. Fitted numbers follow from parameters that were chosen to come close to
# published ones. Measured numbers come from a real or simulated cloud or image.
NUMBER_KINDS = ("published", "predicted", "fitted", "measured")

RECORD = "run.json"
UNFINISHED = "running, or stopped before its end"

# A file that :func:`mmqa_lab.io.write_atomically` was writing when it was killed.
LEFT_OVER = re.compile(r"\..{0,40}\.[0-9a-f]{16}\.\w+")


class Run:
    """The results of one run of a study; each file is written whole or not at all.

    The run record ``run.json`` is updated with every file. The record of a run that ends early
    therefore lists the files of that run.

    Parameters
    ----------
    stem : str
        The study's stem; results go to ``<stem>/`` in the folder that ``MMQA_RESULTS`` names. A
        notebook that is run by hand writes to ``results/by_hand/<stem>/`` beside it. It therefore
        replaces neither the results of ``mmqa studies`` nor the results of another user.
    parameters : dict
        The notebook's ``globals()``. The record keeps the parameters of the notebook
        ``*<stem>*.ipynb`` in the working folder: the names that its cell tagged ``parameters``
        sets.
    files : sequence of path
        The reader's own files. Runs by hand on other files, or in another notebook, then write to
        other folders within ``<stem>/``, named by the first file.

    Examples
    --------
    >>> import tempfile
    >>> os.environ["MMQA_RESULTS"] = tempfile.mkdtemp()
    >>> run = Run("example", parameters={"seed": 1})
    >>> run.save_value("f_poisson", 3.257, "1", "predicted")
    >>> run.finish()
    >>> sorted(path.name for path in run.folder.iterdir())
    ['run.json', 'values.csv', 'values.tex', 'values.typ']
    >>> del os.environ["MMQA_RESULTS"]
    """

    def __init__(
        self, stem: str, *, parameters: dict[str, Any], files: Sequence[str | os.PathLike] = ()
    ):
        self.folder = Path(os.environ.get("MMQA_RESULTS", Path.cwd() / "results/by_hand")) / stem
        if files and "MMQA_RESULTS" not in os.environ:
            paths = [Path(file).resolve() for file in files]
            told_apart = [os.environ.get("JPY_SESSION_NAME", ""), *map(str, paths)]
            self.folder /= f"{paths[0].stem}_{zlib.crc32(chr(10).join(told_apart).encode()):08x}"
        self._values, self._kinds, self._checks = {}, {}, {}
        commit = {"unit": "commit of the code", "kind": f"version {__version__}"}
        commit["text"] = _code_commit() or __version__
        self._commit = commit | {"quoted": quoted_name(stem, "code_commit")}
        notebooks = sorted(Path.cwd().glob(f"*{stem}*.ipynb"), key=lambda one: len(one.name))
        names = parameter_names(notebooks[0]) if notebooks else []
        self._record = new_record(self.folder) | {
            "study": stem,
            "parameters": {name: parameters.get(name) for name in names},
            "version": __version__,
            "python": platform.python_version(),
            "versions": {found.name: found.version for found in metadata.distributions()},
        }
        self._note()
        if get_ipython() is not None:
            pd.set_option("display.max_colwidth", None, "display.float_format", digits)
            get_ipython().events.callbacks["post_execute"].insert(0, _finish_shown)
            if self._record["size"] != "full":  # a tight border takes another drawing
                set_matplotlib_formats("png", bbox_inches=None)

    def save_table(self, frame: pd.DataFrame, name: str, *, kind: str = "") -> None:
        """Write a DataFrame as ``<name>.csv`` and, for a paper, as ``<name>.tex``.

        The table states the kind of its numbers, one of ``NUMBER_KINDS``, in the name of a column
        or in a column of texts. ``kind`` adds such a column. It applies to the columns whose kind
        is not stated otherwise.

        Raises
        ------
        ValueError
            If the table has numbers, and neither the table nor ``kind`` states their kind.
        """
        _check_name(name)
        if any(frame.index.names):
            frame = frame.reset_index()
        if kind:
            frame = frame.assign(**{"kind_of_number" if "kind" in frame else "kind": kind})
        self._kinds[name] = _kind_of(frame)
        has_numbers = len(frame) and len(frame.select_dtypes(["number", "bool"]).columns)
        if has_numbers and not self._kinds[name]:
            kinds = ", ".join(NUMBER_KINDS)
            raise ValueError(f"Invalid table {name}: numbers of no kind. Must be one of {kinds}.")
        self._remove(name)
        self._write(f"{name}.csv", frame)
        if len(frame) <= LONGEST_LATEX:
            shown = frame.set_axis([heading(str(name)) for name in frame], axis=1)
            self._write(f"{name}.tex", as_latex(shown, name, self._kinds[name]))

    def save_figure(
        self,
        figure: Figure,
        name: str,
        *,
        seen: str,
        data: pd.DataFrame | None = None,
        kind: str = "",
    ) -> None:
        """Write a matplotlib figure as PDF, SVG and PNG; equal runs give equal bytes.

        A run that is not full writes a PNG for the screen. The panels of the figure get letters.
        ``data`` is a DataFrame of the numbers shown, written as ``<name>.csv``, by default the
        table of this name, or what is drawn. The kind of the numbers is ``kind``, the kind of
        ``data``, or the kind of the table of this name. It stands in the lower right corner unless
        the texts of the figure state it. ``seen`` says in a sentence what is seen, and of how many.
        With the kind it is the caption, shown in a notebook, kept with the licence in
        ``captions.csv``, and the text for readers without the picture.
        """
        _check_name(name)
        if name not in self._kinds or data is not None:
            self._remove(name)
        kind = kind or ("" if data is None else _kind_of(data)) or self._kinds.get(name, "")
        say_kind(figure, kind)
        finish_figure(figure)
        said = all(word in seen for word in re.findall(r"\w+", kind))
        caption = seen if said else f"{seen} Numbers: {kind}."
        with laid_out(figure):
            full = self._record["size"] == "full"
            look: dict[str, Any] = {} if full else {"dpi": "figure"}
            for form in FORMATS if full else ["png"]:
                look["metadata"] = FORMATS[form] | {"Title": caption}
                self._write(f"{name}.{form}", functools.partial(figure.savefig, **look))
        self._record["figures"][name] = caption
        rows = pd.DataFrame(self._record["figures"].items(), columns=["figure", "caption"])
        self._write("captions.csv", rows.assign(licence="CC BY 4.0"))
        if data is None and name not in self._kinds:
            data = _drawn(figure).assign(kind=kind)
        if data is not None:
            self._write(f"{name}.csv", data)
        if get_ipython() is not None:
            display(Markdown(f"**Figure `{name}`.** {caption}"))

    def save_value(self, name: str, value: float, unit: str, kind: str) -> None:
        """Write a named number to ``values.csv`` and, for papers, ``values.tex`` and ``.typ``.

        A paper names it by study and name, digits and Greek letters as words: ``f_2`` of study
        ``mimic`` is ``mmqaMimicFTwo``.

        Raises
        ------
        ValueError
            If another value of this run is named alike in a paper.
        """
        self._keep_value(name, value, unit, kind, digits(value))

    def _keep_value(self, name, value, unit, kind, text):
        """Write a named number and its text in papers."""
        row = {"name": name, "value": float(value), "unit": unit, "kind": kind}
        row |= {"quoted": quoted_name(self._record["study"], name), "text": text}
        twins = [one for one in self._values.values() if one["quoted"] == row["quoted"]]
        if not re.search(r"[^\W_]", name) or (twins and twins[0]["name"] != name):
            alike = f"a paper names {twins[0]['name']} so, too" if twins else "no letter in it"
            raise ValueError(f"Invalid name {name!r} of a value: {alike}. Must be its own.")
        self._values[name] = row
        rows = list(self._values.values())
        self._write("values.csv", pd.DataFrame(rows)[["name", "value", "unit", "kind"]])
        self._write("values.tex", values_tex([*rows, self._commit]))
        self._write("values.typ", values_typ([*rows, self._commit]))

    def save_answer(
        self,
        sentence: str,
        *,
        figure: str,
        short: str = "",
        kind: str = "",
        thumbnail: str = "",
        **numbers: float,
    ) -> None:
        """Keep the study's answer, its numbers, and the names of the figures that show it.

        The index page and :mod:`mmqa_lab.run.notebooks` take them from the run record.

        Parameters
        ----------
        sentence : str
            With a place for each number, such as ``"At 5 m {speed_kmh:.0f} km/h."``
        figure : str
            The figure that shows the numbers.
        short : str
            The answer in a sentence of at most 18 words with one number, for the front page; by
            default ``sentence``.
        kind : str
            The kind of the numbers, one of ``NUMBER_KINDS``.
        thumbnail : str
            A figure that shows what the study is about; by default ``figure``.
        **numbers : float
            Each is saved as a value too, with the digits that it has in the sentence, so that a
            paper can quote it. The end of its name gives the unit.
        """
        forms = {name: form for _, name, form, _ in Formatter().parse(sentence + short) if form}
        for name, number in numbers.items():
            text = _spaced(format(number, forms[name])) if name in forms else digits(number)
            self._keep_value(name, number, split_unit(name)[1] or "1", kind, text)
        filled = [_spaced(one.format(**numbers) if numbers else one) for one in (sentence, short)]
        self._record["answer"] = {
            "sentence": filled[0],
            "short": filled[1] or filled[0],
            "figure": figure,
            "thumbnail": thumbnail or figure,
            "kind": kind,
            "values": list(numbers),
        }
        self._note()

    def check(self, statement: str, passed: bool, obtained: str, reason: str) -> None:
        """Print and record whether a statement holds for this run; a failed check stops nothing.

        Parameters
        ----------
        statement : str
            The statement of the notebook.
        passed : bool
            Whether the statement is true of this run.
        obtained : str
            The numbers of this run.
        reason : str
            The reason for the tolerance.
        """
        print(f"Check {'passed' if passed else 'FAILED'}: {statement} Found {obtained} ({reason}).")
        row = {"statement": statement, "passed": bool(passed), "obtained": obtained}
        self._checks[statement] = row | {"reason": reason}
        self._record["checks"] = list(self._checks.values())
        self._write("checks.csv", pd.DataFrame(self._record["checks"]))

    def save_ledger(self, rows: pd.DataFrame | list[dict[str, Any]]) -> None:
        """Write the study's values beside printed results as ``ledger.csv``.

        Parameters
        ----------
        rows : DataFrame or list of dict
            From :func:`mmqa_lab.published.ledger.entries`.
        """
        self._write("ledger.csv", pd.DataFrame(rows))

    def agrees(self, *cells: str) -> bool:
        """Return whether the ledger says of no printed cell that ours differs.

        A check that compares with print reads this verdict and has none of its own.

        Parameters
        ----------
        *cells : str
            Source, table and name of cells in :meth:`save_ledger`, which comes first, such as
            ``"pfeifer2021 table_2 A 5 m d1"``.

        Raises
        ------
        KeyError
            If the ledger of this study has no such cell.
        """
        file = self.folder / "ledger.csv"
        found = verdicts(entries(pd.read_csv(file)))
        return all(found[cell] != "differs" for cell in cells)

    def finish(self) -> None:
        """Mark the run as complete in its record."""
        self._check_alone()
        self._record["failure"] = ""
        self._note()

    def _remove(self, name):
        """Remove the table that an earlier cell wrote under a name."""
        for file in {f"{name}.csv", f"{name}.tex"} & set(self._record["files"]):
            (self.folder / file).unlink(missing_ok=True)
            self._record["files"].remove(file)

    def _write(self, name, write):
        """Write a file of this run and enter it into the record."""
        self._check_alone()
        write_atomically(self.folder / name, write)
        if name not in self._record["files"]:
            self._record["files"].append(name)
        self._note()

    def _check_alone(self):
        """Raise where another run has written into the folder since."""
        other = read_record(self.folder) not in ({}, self._known)
        refuse(other, f"run in {self.folder}", "another one writes there", "the only one")

    def _note(self):
        """Write the record and keep what it is as a file."""
        write_record(self.folder, self._record)
        self._known = read_record(self.folder)


def _check_name(name):
    """Raise if a table or figure has a name that is none of a file everywhere."""
    found = repr(name) if re.search(r"[^\w-]", name) or not name else ""
    refuse(found, "name", found, "of letters, digits and _")


def _spaced(text):
    """A text with a space between a number and its per cent sign."""
    return re.sub(r"(?<=\d)%", " %", text)


def _finish_shown():
    """Give the figures of a cell their letters and symbols before the notebook shows them."""
    for number in plt.get_fignums():
        finish_figure(plt.figure(number))


def _drawn(figure):
    """The points, lines and bars of a figure as a table: panel, label, and both coordinates."""
    rows = []
    for panel, ax in enumerate(figure.axes, 1):
        bars = [one for one in ax.patches if isinstance(one, Rectangle)]
        bars = np.reshape([(one.get_center()[0], one.get_height()) for one in bars], (-1, 2))
        parts = [(ax, bars), *((one, one.get_xydata()) for one in ax.lines)]
        parts += [(one, one.get_xy()) for one in ax.patches if isinstance(one, Polygon)]
        dots = [one for one in ax.collections if isinstance(one, PathCollection)]
        parts += [(one, np.ma.filled(one.get_offsets(), np.nan)) for one in dots]
        for part, xy in parts:
            texts = {"panel": panel, "label": part.get_label(), "x_label": ax.get_xlabel()}
            table = pd.DataFrame(np.asarray(xy, dtype=float), columns=["x", "y"])
            rows.append(table.assign(**texts, y_label=ax.get_ylabel()))
    return pd.concat([table for table in rows if len(table)] or [pd.DataFrame({"x": []})])


def _kind_of(frame):
    """The kinds of a table's numbers, from a column with a kind in each row or from the names."""
    words = frame.select_dtypes(exclude=["number", "bool"]).astype(str)
    columns = [name for name in words if words[name].str.contains("|".join(NUMBER_KINDS)).all()]
    text = " ".join(words[columns[0]].unique() if columns else map(str, frame))
    kinds = ", ".join(kind for kind in NUMBER_KINDS if kind in text)
    return f"{kinds} (simulated)" if kinds and "simulated" in text else kinds


def _code_commit():
    """The commit of the code, short; nothing where it lies in no repository of its own."""
    root = Path(__file__).parents[2]
    order = ["git", "-C", str(root), "rev-parse", "--short=10", "HEAD"]
    if not (root / ".git").exists() or shutil.which("git") is None:
        return ""
    return subprocess.run(order, capture_output=True, text=True, check=False).stdout.strip()


def new_record(folder):
    """Remove the files of an earlier or a killed run; return the record of a run that begins."""
    before = read_record(folder)
    ours = {one for one in map(str, before.get("files", [])) if Path(one).name == one}
    for left in folder.iterdir() if folder.is_dir() else ():
        if (left.name in ours or LEFT_OVER.fullmatch(left.name)) and not left.is_dir():
            left.unlink()
    answer = dict.fromkeys(("sentence", "short", "figure", "thumbnail", "kind"), "")
    record = {"size": before.get("size", "full"), "failure": UNFINISHED, "seconds": 0.0}
    return record | {"answer": answer | {"values": []}, "checks": [], "files": [], "figures": {}}


def read_record(folder):
    """Return the run record in a study's folder; an empty dict without one that can be read."""
    try:
        record = json.loads((Path(folder) / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):  # none yet, or damaged when the machine lost its power
        return {}
    return record if isinstance(record, dict) else {}


def write_record(folder, record):
    """Write the run record into a study's folder."""
    write_atomically(Path(folder) / RECORD, json.dumps(record, indent=1, default=str))


def verdict(record):
    """Return the reason of a failure, or the count of the checks that passed."""
    passed = sum(check["passed"] for check in record["checks"])
    return record["failure"] or f"{passed} of {len(record['checks'])} checks passed"


def parameter_names(notebook):
    """Return the names that a notebook's cell tagged ``parameters`` sets, in the cell's order.

    Parameters
    ----------
    notebook : path

    Returns
    -------
    list of str

    Examples
    --------
    >>> from mmqa_lab.studies import chosen
    >>> parameter_names(chosen(["mimic"])[0].path)[:2]
    ['ranges_m', 'seeds']
    """
    cells = json.loads(Path(notebook).read_text(encoding="utf-8"))["cells"]
    tagged = [cell["source"] for cell in cells if "parameters" in cell["metadata"].get("tags", [])]
    nodes = ast.walk(ast.parse("".join(itertools.chain(*tagged))))
    return [n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]
