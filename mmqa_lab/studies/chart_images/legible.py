"""Legibility: the jury's marks, and beside them the quality index and an automatic reader.

The marks are the reference. The stand-ins keep columns of their own and are never merged with them.
"""

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from mmqa_lab import chart_image, charts
from mmqa_lab._checks import check_choice
from mmqa_lab.chart_image.legibility import MARKS
from mmqa_lab.simulate import cameras
from mmqa_lab.studies.chart_images.rendered import ROW, photograph

CAP_MM = 40.0
"""Height of the capitals that the paper judges."""

LEGIBLE_SHARE = 0.75
"""Share of the lines that the reader must read for mark b, set beforehand."""


@dataclass(frozen=True)
class IndexFit:
    """Thresholds of the quality index chosen so that they give the jury's marks: a fit.

    Parameters
    ----------
    a_from, b_from : float
        Indices from which on a text gets mark a and mark b.
    agree, n : int
        Rows that get the jury's mark, and all rows.
    """

    a_from: float
    b_from: float
    agree: int
    n: int

    def marks(self, index):
        """Return the mark of each index."""
        index = np.asarray(index)
        return np.where(index >= self.a_from, "a", np.where(index >= self.b_from, "b", "c"))


def fit_index(index, marks):
    """Fit the thresholds of the quality index to marks.

    Parameters
    ----------
    index : array_like of float, shape (n,)
    marks : sequence of {"a", "b", "c"}

    Returns
    -------
    IndexFit
        The first pair, from below, that gives most rows their mark; in the middle between indices.

    Examples
    --------
    >>> fit_index([6.0, 2.5, 2.0, 1.5], ["a", "a", "b", "c"])
    IndexFit(a_from=2.25, b_from=1.75, agree=4, n=4)
    """
    for mark in marks:
        check_choice(mark, "mark", MARKS)
    steps, marks = np.unique(index), np.asarray(marks)
    between = [float(steps[0]), *map(float, (steps[1:] + steps[:-1]) / 2), np.inf]
    pairs = [(a_from, b_from) for b_from in between for a_from in between if a_from >= b_from]
    fits = [IndexFit(*pair, agree=0, n=len(marks)) for pair in pairs]
    fits = [replace(fit, agree=int((fit.marks(index) == marks).sum())) for fit in fits]
    return max(fits, key=lambda fit: fit.agree)


def text_crops(rows, model, *, seed):
    """Photograph the chart as each row saw it and cut its texts out.

    Parameters
    ----------
    rows, model : DataFrame
        As for :func:`photographs`.
    seed : int

    Returns
    -------
    dict of tuple to list of mmqa_lab.chart_image.Crop
        By system, distance and view.
    """
    layout = charts.imaging_chart()
    crops = {}
    for row in rows.itertuples():
        photo = photograph(row, model, layout=layout, seed=seed)
        key = tuple(getattr(row, name) for name in ROW)
        crops[key] = chart_image.text_crops(photo.image, layout, photo.chart_map)
    return crops


def jury_crops(crops, element):
    """Return one text from each photograph under names that do not tell the system.

    Returns
    -------
    dict of str to array, shape (rows, columns)
        ``photo 1`` ..., in the order of ``crops``.
    """
    return {
        f"photo {number}": next(crop.image for crop in lines if crop.name == element)
        for number, lines in enumerate(crops.values(), start=1)
    }


def readable(read):
    """Return the names of the texts that a reader reads without error in a sharp photograph.

    Of the others nobody could tell whether the camera or the reader failed.
    """
    layout = charts.imaging_chart()
    view = cameras.chart_view(cameras.PanoramaCamera(60_000), distance=10.0, layout=layout)
    sharp = cameras.Sensor(noise=0.0)
    photo = cameras.photograph(layout, view, sensor=sharp, supersampling=2)
    lines = chart_image.text_crops(photo.image, layout, photo.chart_map)
    found = chart_image.read_crops(lines, read)
    return found.loc[found["error"] == 0, "element"].tolist()


def legibility(rows, crops, *, engine="auto"):
    """Put the jury's marks, the quality index and an automatic reader side by side.

    Parameters
    ----------
    rows : DataFrame
        Of :func:`geometry`.
    crops : dict
        Of :func:`text_crops`, for these rows or some of them.
    engine : str
        Of :func:`mmqa_lab.chart_image.reader`.

    Returns
    -------
    DataFrame
        ``system``, ``distance_m``, ``view``; ``jury`` (published); ``quality_index`` (of 40 mm
        capitals, by the published widths) and ``index_mark`` (its thresholds are fitted to these
        marks); ``cap_px``; ``ocr_mark`` (a: every line without error; b: three quarters of the
        lines with a fifth of errors at most; else c), ``ocr_error`` (mean of edits per letter) and
        ``ocr_lines``. The reader's columns are empty without an engine or a photograph.
        ``attrs["reader"]`` names the engine or says why there is none, ``attrs["index"]`` is the
        :class:`IndexFit`.
    """
    table = rows[[*ROW, "legibility"]].rename(columns={"legibility": "jury"})
    width = np.sqrt(rows["w_h_mm"] * rows["w_v_mm"])
    table["quality_index"] = chart_image.quality_index(CAP_MM, width)
    fit = fit_index(table["quality_index"], table["jury"])
    table["index_mark"] = fit.marks(table["quality_index"])
    table["cap_px"] = CAP_MM / rows["seen_v_mm"]
    try:
        read = chart_image.reader(engine)
    except ImportError as error:
        name, marks = str(error), {}
    else:
        name, sound = read.name, readable(read)
        marks = {key: _read_mark(lines, sound, read) for key, lines in crops.items()}
    keys = [tuple(key) for key in table[ROW].itertuples(index=False)]
    found = [marks.get(key, ("", np.nan, 0)) for key in keys]
    table["ocr_mark"], table["ocr_error"], table["ocr_lines"] = zip(*found, strict=True)
    table.attrs |= {"reader": name, "index": fit}
    return table


def _read_mark(lines, sound, read):
    """Mark, mean error and number of lines of one photograph."""
    found = chart_image.read_crops([line for line in lines if line.name in sound], read)
    if found.empty:
        return "", np.nan, 0
    legible = (found["ocr_mark"] != "c").mean() >= LEGIBLE_SHARE
    mark = "a" if (found["ocr_mark"] == "a").all() else "b" if legible else "c"
    return mark, float(found["error"].mean()), len(found)


def jury_of(marks, *, jurors=("first", "second", "third"), others=()):
    """Return the votes of a jury that agrees, but for some.

    Parameters
    ----------
    marks : dict of str to {"a", "b", "c"}
        By element.
    jurors : sequence of str
    others : sequence of (juror, element, mark)
        Who sees what otherwise.

    Returns
    -------
    DataFrame
        ``juror``, ``element``, ``mark``: as :func:`mmqa_lab.chart_image.agreement` wants them.
    """
    votes = {(juror, element): mark for juror in jurors for element, mark in marks.items()}
    votes |= {(juror, element): mark for juror, element, mark in others}
    rows = [(*key, mark) for key, mark in votes.items()]
    return pd.DataFrame(rows, columns=["juror", "element", "mark"])
