"""Test charts as data: what is printed where, in millimetres, in grey tones and colours.

One :class:`Layout` is drawn to PDF and SVG, turned into the reflectance that simulated cameras
photograph, and tells the evaluation where everything lies. The origin is the lower left corner, x
to the right, y up. Tones are relative reflectances, 0 black, 1 white. Print files give them by the
curve of sRGB and show letters as outlines, so that no font is missing. Here are the two charts of
Pfeifer et al. 2021, 1 m x 1 m, from one description.
"""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from mmqa_lab._checks import check_choice, check_count
from mmqa_lab.charts.elements import (
    BLACK,
    GREY,
    WHITE,
    Bar,
    Cells,
    Layout,
    LinePairs,
    Marker,
    Text,
    layout_of,
    reflectance,
)

__all__ = [
    "Bar",
    "Layout",
    "LinePairs",
    "Marker",
    "Text",
    "imaging_chart",
    "layout_of",
    "point_chart",
    "read_layout",
    "reflectance",
]
__dir__ = __all__.copy

SIDE_MM = 1000.0

CELLS, CELL_MM, BORDER_MM, SQUARE_MM = 100, 10.0, 50.0, 200.0
"""Of the point chart: cells along a side and their size, its white border, its plain squares."""

TONES = {"grey": GREY, "black": BLACK}

NAMES = {"grey": {}, "black": {"horizontal_bar": "black"}, "revised": {"revised": True}}
"""Imaging charts by their names."""


def imaging_chart(*, revised: bool = False, horizontal_bar: str | None = None) -> Layout:
    """Return the imaging chart, from the table of its elements (``imaging.csv``, ``revised.csv``).

    Two standing bars 800 mm long and a lying one 600 mm long give the pixel size, line pairs the
    resolution, texts and symbols the legibility. Widths stand below the line pairs, lengths beside
    the bars. Four coded targets in the corners locate the chart.

    Parameters
    ----------
    revised : bool
        As the authors advise in section 4.4: the lying bar black, and pairs of 60 mm (lying ones of
        40 mm, too) before the others.
    horizontal_bar : {"grey", "black"}, optional
        The lying bar.

    Returns
    -------
    Layout

    Notes
    -----
    The paper gives lengths, numbers of pairs and the ends of the ladder (lying bars begin at 30
    mm). The rungs of 40 to 4 mm occur as readings in its Table 1; the rung of 3 mm is assumed. It
    gives the texts that were judged, 40 mm high, and the heights of others. Which text has which of
    those heights, the places on the chart, the thickness of the bars, the grey, which symbols and
    colours, and the fonts are this package's own. The vertical block is read as lines below each
    other. Raised letters are those of Unicode. The coded targets are an addition. The coating of
    the boards, retro-reflective, is not a matter of this description.

    References
    ----------
    Pfeifer et al. 2021, sections 3.2 and 4.2. doi:10.3390/rs13020237

    Examples
    --------
    >>> chart = imaging_chart()
    >>> chart["bar_left"].height, chart["pairs_h_40"].extent, chart["pairs_v_2"].direction
    (800.0, 320.0, 'v')
    """
    horizontal_bar = horizontal_bar or ("black" if revised else "grey")
    tone = TONES[check_choice(horizontal_bar, "horizontal_bar", tuple(TONES))]
    table = Path(__file__).with_name("revised.csv" if revised else "imaging.csv")
    name = f"{'revised ' if revised else ''}imaging chart, {horizontal_bar} bar"
    chart = layout_of(table.read_text(encoding="utf-8"), name=name)
    bar = replace(chart["bar_horizontal"], tone=tone)
    return replace(
        chart, elements=tuple(bar if one.name == bar.name else one for one in chart.elements)
    )


def read_layout(source: str | os.PathLike) -> Layout:
    """Return a chart by its name (grey, black, revised) or from a CSV table of its elements.

    Parameters
    ----------
    source : str or path
        A table is of a chart of 1 m x 1 m; ``Layout.to_csv`` writes one to begin with.

    Returns
    -------
    Layout

    Raises
    ------
    ValueError
        If it is neither a name nor a .csv file.

    Examples
    --------
    >>> read_layout("black")["bar_horizontal"].tone
    0.0
    """
    if source in NAMES:
        return imaging_chart(**NAMES[source])
    path = Path(source)
    if path.suffix.lower() != ".csv":
        raise ValueError(f"Invalid chart {source}. Must be {', '.join(NAMES)} or a .csv file.")
    return layout_of(path.read_text(encoding="utf-8"), name=path.stem)


def point_chart(*, seed: int = 0) -> Layout:
    """Return the point-distribution chart: random cells, a border, a black and a white square.

    Parameters
    ----------
    seed : int
        Of the random cells.

    Returns
    -------
    Layout

    Raises
    ------
    ValueError
        If the seed is below zero.

    Notes
    -----
    The paper describes 100 cells of 10 mm along a side of 1 m, a border, and one black and one
    white square in the lower part. The widths of border and squares, the border's tone and the
    squares' places there are assumed.

    References
    ----------
    Pfeifer et al. 2021, section 3.3. doi:10.3390/rs13020237

    Examples
    --------
    >>> chart = point_chart(seed=1)
    >>> chart["cells"].count, chart["black"].tone, chart["white"].tone
    (100, 0.0, 1.0)
    >>> chart["black"].x, chart["black"].y, chart["white"].x + chart["white"].width
    (50.0, 50.0, 950.0)
    """
    generator = np.random.default_rng(check_count(seed, "seed", low=0))
    bits = generator.random((CELLS, CELLS)) < 0.5
    border, square = round(BORDER_MM / CELL_MM), round(SQUARE_MM / CELL_MM)
    pattern = slice(border, CELLS - border)
    white = np.ones_like(bits)
    white[pattern, pattern] = False
    for columns in (slice(border, border + square), slice(-border - square, -border)):
        white[border : border + square, columns] = True  # below the squares, drawn over it
    elements = (
        Cells("cells", 0.0, 0.0, SIDE_MM, CELLS, np.packbits(bits | white).tobytes().hex()),
        Bar("black", BORDER_MM, BORDER_MM, SQUARE_MM, SQUARE_MM, BLACK),
        Bar("white", SIDE_MM - BORDER_MM - SQUARE_MM, BORDER_MM, SQUARE_MM, SQUARE_MM, WHITE),
    )
    return Layout(f"point chart, seed {seed}", SIDE_MM, SIDE_MM, elements)
