"""How well a photograph's texts can be read: marks, and what stands in for a jury.

Pfeifer et al. 2021 (doi:10.3390/rs13020237), sections 3.2 and 4.2: a jury of three works through a
list of elements in its order, hard cases first, and gives one mark to each photograph. Pixels per
capital height stand in for it; their marks are never merged with those of a jury.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mmqa_lab import published
from mmqa_lab.chart_image.geometry import ChartMap
from mmqa_lab.chart_image.reading import find_tones
from mmqa_lab.chart_image.rules import MARKS
from mmqa_lab.charts import Layout, LinePairs

TEXT_MM, ROUNDING_MM = 40.0, 0.05
"""Capital height that was judged, and half of the last digit of printed pixel sizes."""


def expected_marks(cap_px: ArrayLike) -> pd.DataFrame:
    """Return the marks that a jury would give by the pixels per capital height.

    Parameters
    ----------
    cap_px : array_like, shape (n,)
        Height of the capitals, pixels.

    Returns
    -------
    DataFrame
        ``cap_px``, ``mark`` (thresholds half way between the published photographs of neighbouring
        marks), ``best`` and ``worst`` (thresholds at the one and the other of these photographs,
        whose pixel sizes are rounded).

    Notes
    -----
    Two thresholds, a from 11.0 and b from 9.0 pixels, are fitted to the twelve marks of Table 1 and
    agree with all of them. Predicted from the eleven others, 10 of the 12 are right. One photograph
    alone has mark b.

    Examples
    --------
    >>> expected_marks([30.0, 11.3, 9.5, 5.0])[["mark", "best", "worst"]].values.tolist()
    [['a', 'a', 'a'], ['a', 'a', 'b'], ['b', 'b', 'c'], ['c', 'c', 'c']]
    """
    limits = mark_limits(_judged())
    table = pd.DataFrame({"cap_px": np.atleast_1d(np.asarray(cap_px, dtype=float))})
    for name in ("mark", "best", "worst"):
        steps = [(table["cap_px"] < limits.loc[name, mark]).to_numpy() for mark in MARKS[:-1]]
        table[name] = np.array(MARKS, dtype=object)[np.sum(steps, axis=0)]
    return table


def mark_limits(judged):
    """Fewest pixels per capital height for marks a and b.

    Parameters
    ----------
    judged : DataFrame
        ``mark``, ``cap_px``, ``least_px`` and ``most_px`` (by rounding), a row per photograph.

    Returns
    -------
    DataFrame
        Columns a, b; rows ``mark`` (half way between neighbouring photographs), ``best``,
        ``worst``. NaN where a mark or all worse ones are missing.
    """
    limits = pd.DataFrame(index=["mark", "best", "worst"], columns=list(MARKS[:-1]), dtype=float)
    for mark in limits.columns:
        up, down = judged[judged["mark"] <= mark], judged[judged["mark"] > mark]
        half = (up["cap_px"].min() + down["cap_px"].max()) / 2
        limits[mark] = [half, down["least_px"].max(), up["most_px"].min()]
    return limits


def colour_fringes(image: np.ndarray, layout: Layout, chart_map: ChartMap) -> pd.DataFrame:
    """Measure the colours that black and white line pairs take on in a colour photograph.

    The paper saw strong ones at and beyond the limit of resolution (section 4.4).

    Parameters
    ----------
    image : array, shape (rows, columns, 3)
        Linear light, full scale 1.
    layout : Layout
    chart_map : ChartMap

    Returns
    -------
    DataFrame
        A row per pattern: ``name``, ``direction``, ``width_mm``, ``width_px`` and ``fringe``, the
        mean range of the three colours as share of the contrast of black and white.

    Examples
    --------
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4, colour=True)[::-1]  # pixels of 4 mm
    >>> there = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> float(colour_fringes(image, layout, there)["fringe"].max().round(6))
    0.0
    """
    bands = [find_tones(image[..., k], layout, chart_map) for k in range(3)]
    span = replace(bands[0], values=np.ptp([band.values for band in bands], axis=0))
    rows = []
    for pairs in layout.of_kind(LinePairs):
        outline = pairs.corners()
        places, values, _ = span.near(chart_map, outline)
        inside = ((places >= outline[0]) & (places <= outline[2])).all(axis=1)
        axis = "hv".index(pairs.direction)
        pixel_mm = chart_map.pixel_sizes_mm(outline.mean(axis=0)[None])[0, axis]
        fringe = float(values[inside].mean()) if inside.any() else np.nan
        rows.append((pairs.name, pairs.direction, pairs.pair, pairs.pair / pixel_mm, fringe))
    return pd.DataFrame(rows, columns=["name", "direction", "width_mm", "width_px", "fringe"])


@lru_cache(maxsize=1)
def _judged():
    """The photographs of Table 1 with their marks and pixels per capital height."""
    table = published.table("pfeifer2021", "table_1").query("status != 'not_evaluated'")
    key = ["system", "distance_m", "view"]
    marks = table[table["quantity"] == "legibility"].set_index(key)["printed"].rename("mark")
    bars = table.query("quantity == 'pixel size' and direction == 'v'").set_index(key)["value"]
    sizes = {"cap_px": bars, "least_px": bars + ROUNDING_MM, "most_px": bars - ROUNDING_MM}
    return pd.concat([marks, TEXT_MM / pd.DataFrame(sizes)], axis=1)
