"""How well the chart's texts can be read: marks of a jury, and what stands in for them.

The jury's marks are the reference. Pixels per capital and the quality index of line pairs stand in
for them; they have columns of their own and are never merged with the marks.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_choice, check_positive
from mmqa_lab._results import Shown
from mmqa_lab.charts import Text

MARKS = ("a", "b", "c")
"""a: each letter on its own can definitely be read; b: the text is legible; c: it is not (Pfeifer
et al. 2021, section 4.2, where a symbol counts like a letter)."""

X_HEIGHT_SHARE = 0.75
"""Height of lower-case letters in capitals of the chart's font."""

CROP_SIDES, CROP_BELOW, CROP_ABOVE = 0.5, 0.35, 0.2
"""Margins of a line, in heights of its capitals: its own tails fit, its neighbours' do not."""


@dataclass(frozen=True, eq=False)
class Crop:
    """One line of text as the image shows it.

    Parameters
    ----------
    name, text : str
        Of the chart's element.
    image : array, shape (rows, columns)
        Original pixels, linear light.
    cap_px : float
        Height of the capitals, pixels.

    Examples
    --------
    >>> from mmqa_lab.chart_image import ChartMap
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4)[::-1]  # pixels of 4 mm
    >>> there = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> crop = text_crops(image, layout, there)[0]
    >>> crop.text, round(crop.cap_px * 4), crop.image.ndim
    ('Linienomnibusse', 50, 2)
    """

    name: str
    text: str
    image: np.ndarray
    cap_px: float


@dataclass(frozen=True, eq=False)
class Agreement(Shown):
    """What a jury decided, and how well its members agree.

    Parameters
    ----------
    verdict : DataFrame
        Per element: ``element``, ``mark`` of the majority (None for a tie), ``n`` jurors,
        ``unanimous``.
    fleiss_kappa : float
        Over the elements that all jurors marked; NaN when all of them got one and the same mark,
        where kappa is not defined, and for a single juror.
    unanimous_share : float
        Share of the elements with one mark only.
    """

    verdict: pd.DataFrame
    fleiss_kappa: float
    unanimous_share: float

    def to_frame(self):
        """Return the verdict."""
        return self.verdict


def text_crops(image, layout, chart_map):
    """Cut every line of text out of an image.

    Parameters
    ----------
    image : array, shape (rows, columns)
    layout : Layout
    chart_map : ChartMap

    Returns
    -------
    list of Crop
        In the layout's order; without the lines that reach over the image's edge.

    Examples
    --------
    >>> from mmqa_lab.chart_image import ChartMap
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4)[::-1]  # pixels of 4 mm
    >>> there = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> [crop.text for crop in text_crops(image, layout, there)][:2]
    ['Linienomnibusse', 'Aus-ᵤ. Einsteigen']
    """
    crops = []
    for element in layout.of_kind(Text):
        low, size = np.array([element.x, element.y]), np.array([element.width, element.cap])
        high = low + size + element.cap * np.array([CROP_SIDES, CROP_ABOVE])
        low = low - element.cap * np.array([CROP_SIDES, CROP_BELOW])
        outline = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
        pixels = chart_map.pixels(outline)
        first = np.floor(pixels.min(axis=0)).astype(int)
        last = np.ceil(pixels.max(axis=0)).astype(int) + 1
        if (first < 0).any() or (last > image.shape[1::-1]).any():
            continue
        middle = (low + high)[None] / 2
        cap_px = element.cap / chart_map.pixel_sizes_mm(middle)[0, 1]
        part = image[first[1] : last[1], first[0] : last[0]]
        crops.append(Crop(element.name, element.text, part, float(cap_px)))
    return crops


def agreement(marks):
    """Return the jury's verdict per element and how well its members agree.

    Parameters
    ----------
    marks : DataFrame
        ``juror``, ``element`` and ``mark`` (a, b or c), one row per juror and element.

    Returns
    -------
    Agreement

    Raises
    ------
    ValueError
        If a column is missing, a mark is another, or a juror marked an element twice.

    References
    ----------
    Fleiss 1971, doi:10.1037/h0031619.

    Examples
    --------
    >>> rows = [(j, e, m) for j in "123" for e, m in (("x", "a"), ("y", "c"))]
    >>> found = agreement(pd.DataFrame(rows, columns=["juror", "element", "mark"]))
    >>> found.verdict["mark"].tolist(), round(found.fleiss_kappa, 6)
    (['a', 'c'], 1.0)
    """
    from statsmodels.stats.inter_rater import fleiss_kappa

    marks = check_marks(marks)
    counts = pd.crosstab(marks["element"], marks["mark"]).reindex(columns=list(MARKS), fill_value=0)
    counts = counts.loc[marks["element"].drop_duplicates()]
    best, total = counts.max(axis=1), counts.sum(axis=1)
    winner = counts.idxmax(axis=1).astype(object)
    winner[counts.eq(best, axis=0).sum(axis=1) > 1] = None
    verdict = pd.DataFrame({"mark": winner, "n": total, "unanimous": best == total}).reset_index()
    complete = counts[total == marks["juror"].nunique()].to_numpy()
    several = marks["juror"].nunique() > 1 and (complete.sum(axis=0) > 0).sum() > 1
    kappa = float(fleiss_kappa(complete)) if several else np.nan
    return Agreement(verdict, kappa, float(verdict["unanimous"].mean()))


def check_marks(marks):
    """Return a jury's marks as a DataFrame, checked."""
    missing = {"juror", "element", "mark"} - set(marks.columns)
    if missing:
        raise ValueError(f"Invalid marks: no column {sorted(missing)[0]!r}. Must have one.")
    for mark in marks["mark"].unique():
        check_choice(mark, "mark", MARKS)
    if marks.duplicated(["juror", "element"]).any():
        first = marks[marks.duplicated(["juror", "element"])].iloc[0]
        raise ValueError(
            f"Invalid marks: juror {first['juror']} marked {first['element']} twice. Must be once."
        )
    return marks


def quality_index(cap_mm, width_mm):
    """Return the quality index QI: height of lower-case letters over the resolved pair width.

    Parameters
    ----------
    cap_mm : float
        Height of the capitals.
    width_mm : float or array_like
        Resolved width w, mm; the geometric mean of both directions is usual.

    Returns
    -------
    float or array
        About 3 barely legible, 3.6 marginal, 5 good, 8 excellent in the reading of documents.

    Raises
    ------
    ValueError
        If ``cap_mm`` is not above zero.

    References
    ----------
    ANSI/AIIM MS23; Kenney and Chapman 1996, Digital Resolution Requirements, Cornell University.

    Examples
    --------
    >>> quality_index(40, 10)
    3.0
    """
    return X_HEIGHT_SHARE * check_positive(cap_mm, "cap_mm", unit="mm") / width_mm
