"""How well the texts of a photographed chart can be read: a jury's marks, and how it agrees."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import pandas as pd

from mmqa_lab._checks import check_choice, check_columns, needs, refuse
from mmqa_lab._results import Shown
from mmqa_lab.chart_image.maps import ChartMap
from mmqa_lab.charts import Bar, Layout, Text

__all__ = ["MARKS", "Agreement", "Crop", "agreement", "check_marks", "text_crops"]

MARKS = ("a", "b", "c")
"""a: each letter on its own can definitely be read; b: the text is legible; c: it is not (Pfeifer
et al. 2021, section 4.2, where a symbol counts like a letter)."""

CROP_SIDES, CROP_BELOW, CROP_ABOVE = 0.5, 0.35, 0.2
"""Margins of a line, in heights of its capitals: its own tails fit, its neighbours' do not."""


def text_crops(image: np.ndarray, layout: Layout, chart_map: ChartMap) -> list[Crop]:
    """Cut lines of text out of an image, upright as they are printed.

    Parameters
    ----------
    image : array, shape (rows, columns)
    layout : Layout
    chart_map : ChartMap

    Returns
    -------
    list of Crop
        In the order of the layout; without the printed widths and lengths, and without texts that
        reach over the image's edge.

    Examples
    --------
    >>> from mmqa_lab.chart_image import ChartMap
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4)[::-1]  # pixels of 4 mm
    >>> chart_map = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> [crop.text for crop in text_crops(image, layout, chart_map)][:2]
    ['Mo.-Fr. (werkt). v. 6³⁰-19ʰ', 'Müllsammelfzge.']
    """
    crops = []
    for element in layout.of_kind(Text):
        if element.name.startswith("label_"):
            continue
        low, high = element.corners()[[0, 2]]
        high = high + element.cap * np.array([CROP_SIDES, CROP_ABOVE])
        low = low - element.cap * np.array([CROP_SIDES, CROP_BELOW])
        pixels = chart_map.pixels(Bar("crop", *low, *(high - low)).corners())
        if (pixels < 0).any() or (pixels > np.array(image.shape[::-1]) - 1).any():
            continue
        sizes = chart_map.pixel_sizes_mm((low + high)[None] / 2)[0]
        # a pixel more on each side, as blur reaches farther than ink
        low, high = low - sizes.min(), high + sizes.min()
        columns, rows = np.ceil((high - low) / sizes.min()).astype(int)
        x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows)[::-1] + 0.5)
        places = low + np.column_stack([x.ravel(), y.ravel()]) * sizes.min()
        sought = chart_map.pixels(places).astype(np.float32).reshape(rows, columns, 2)
        part = cv2.remap(np.asarray(image, dtype=np.float32), sought, None, cv2.INTER_CUBIC)
        crops.append(Crop(element.name, element.text, part, float(element.cap / sizes[1])))
    return crops


def agreement(marks: pd.DataFrame) -> Agreement:
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
    raters = needs("lab", "statsmodels.stats.inter_rater")

    marks = check_marks(marks)
    counts = pd.crosstab(marks["element"], marks["mark"]).reindex(columns=list(MARKS), fill_value=0)
    counts = counts.loc[marks["element"].drop_duplicates()]
    best, total = counts.max(axis=1), counts.sum(axis=1)
    winner = counts.idxmax(axis=1).astype(object)
    winner[counts.eq(best, axis=0).sum(axis=1) > 1] = None
    verdict = pd.DataFrame({"mark": winner, "n": total, "unanimous": best == total}).reset_index()
    complete = counts[total == marks["juror"].nunique()].to_numpy()
    several = marks["juror"].nunique() > 1 and (complete.sum(axis=0) > 0).sum() > 1
    kappa = float(raters.fleiss_kappa(complete)) if several else np.nan
    return Agreement(verdict, kappa, float(verdict["unanimous"].mean()))


def check_marks(marks: pd.DataFrame) -> pd.DataFrame:
    """Return a jury's marks as a DataFrame, checked."""
    check_columns(marks, ("juror", "element", "mark"), "marks")
    for mark in marks["mark"].unique():
        check_choice(mark, "mark", MARKS)
    pairs = marks[["juror", "element"]]
    for juror, element in pairs[pairs.duplicated()].to_numpy():
        refuse(True, "marks", f"juror {juror} marked {element} twice", "once")
    return marks


@dataclass(frozen=True, eq=False)
class Crop:
    """One line of text as the image shows it.

    Parameters
    ----------
    name, text : str
        Of the chart's element.
    image : array, shape (rows, columns)
        Linear light, upright however the photograph is turned, its cells as small as the pixels.
    cap_px : float
        Height of the capitals, pixels of the photograph.

    Examples
    --------
    >>> from mmqa_lab.chart_image import ChartMap
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4)[::-1]  # pixels of 4 mm
    >>> chart_map = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> crop = text_crops(image, layout, chart_map)[0]
    >>> crop.text, round(crop.cap_px * 4), crop.image.ndim
    ('Mo.-Fr. (werkt). v. 6³⁰-19ʰ', 40, 2)
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

    def to_frame(self) -> pd.DataFrame:
        """Return the verdict."""
        return self.verdict
