"""Test charts as data: what is printed where, in millimetres, in black, white and tones between.

One :class:`Layout` is drawn to PDF and SVG, turned into the reflectance that simulated cameras
photograph, and tells the evaluation where everything lies. The origin is the lower left corner, x
to the right, y up. Tones are relative reflectances, 0 black, 1 white. Here are the two charts of
Pfeifer et al. 2021, 1 m x 1 m, from one description.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from mmqa_lab._checks import check_choice, check_count, check_number, check_positive
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
    reflectance,
)

__all__ = [
    "Bar",
    "Layout",
    "LinePairs",
    "Marker",
    "Text",
    "imaging_chart",
    "point_chart",
    "reflectance",
]

SIDE_MM = 1000.0

WIDTHS_H_MM = (40.0, 30.0, 20.0, 15.0, 10.0, 8.0, 6.0, 4.0, 3.0, 2.0)
"""Widths of the line pairs read in horizontal direction, mm."""

WIDTHS_V_MM = WIDTHS_H_MM[1:]
"""Widths of the line pairs read in vertical direction, mm."""

TEXTS = (
    (50.0, "Linienomnibusse"),
    (45.0, "Aus-ᵤ. Einsteigen"),
    (42.0, "ausgen. v. 18³⁰"),
    (40.0, "Mo.-Fr. (werkt). v."),
    (40.0, "6³⁰-19ʰ"),
    (40.0, "Müllsammelfzge."),
    (40.0, "Müllsammelfzge.", "DejaVuSerif"),
)
"""Height of the capitals in mm, text and, where it is another, font."""

FAINT_TEXT = (40.0, "ausgen.", 0.35, 0.6)
"""Height of the capitals, text, and the tones of letters and panel: the reduced contrast."""

REPEATS, LENGTH_MM = 8, 80.0

BAR_MM, MARKER_MM, GAP_MM = 40.0, 90.0, 15.0

COLUMN = (16.0, 120.0, 80.0, 760.0)
"""x, y, width and height of the column for lying bars, left of the long bar, mm."""

FIELD = (212.0, 90.0, 585.0, 890.0)
"""x, y, width and height of the field between the long bars, mm."""


def imaging_chart(
    *,
    horizontal_bar: str = "grey",
    widths_h: Sequence[float] = WIDTHS_H_MM,
    widths_v: Sequence[float] = WIDTHS_V_MM,
    texts: Sequence[tuple[float, str] | tuple[float, str, str]] = TEXTS,
    dictionary: str | None = "DICT_4X4_50",
    first_marker: int = 0,
) -> Layout:
    """Return the imaging chart.

    Two standing bars 800 mm long and a lying one 600 mm long give the pixel size, line pairs the
    resolution, lines of text the legibility. Four coded targets in the corners locate the chart.

    Parameters
    ----------
    horizontal_bar : {"grey", "black"}
        The lying bar grey as built, or black as section 4.4 recommends.
    widths_h, widths_v : sequence of float
        Widths of the line pairs, mm, from coarse to fine, for standing and for lying bars.
    texts : sequence of (float, str) or (float, str, str)
        Height of the capitals in mm, text and, where it is another, font of each line.
    dictionary : str or None
        OpenCV dictionary of the coded targets; None leaves them out.
    first_marker : int
        Number of the target in the lower left corner; the others follow counterclockwise.

    Returns
    -------
    Layout

    Raises
    ------
    ValueError
        If a width is not positive, widths do not decrease, or the elements do not fit.

    Notes
    -----
    The paper gives lengths, numbers of pairs and the ends of the ladder (lying bars begin at 30
    mm). The rungs of 40 to 4 mm occur as readings in its Table 1; the rung of 3 mm is assumed. It
    names the texts and their heights, 40 to 50 mm; raised and small letters are those of Unicode
    here. Which text has which height, the places on the chart, the thickness of the bars, the grey
    and the fonts are this package's own. The coded targets are an addition. Left out are symbols,
    colours, vertical text, the printed widths and lengths, and the retro-reflective coating.

    References
    ----------
    Pfeifer et al. 2021, sections 3.2 and 4.2. doi:10.3390/rs13020237

    Examples
    --------
    >>> chart = imaging_chart()
    >>> chart["bar_left"].height, chart["pairs_h_40"].extent, chart["pairs_v_2"].direction
    (800.0, 320.0, 'v')
    """
    check_choice(horizontal_bar, "horizontal_bar", ("grey", "black"))
    tone = GREY if horizontal_bar == "grey" else BLACK
    bars = [
        Bar("bar_left", 134.0, 100.0, BAR_MM, 800.0),
        Bar("bar_right", 836.0, 100.0, BAR_MM, 800.0),
        Bar("bar_horizontal", 200.0, 30.0, 600.0, BAR_MM, tone),
    ]
    pairs, top = _place_pairs(_ladder(widths_h, "widths_h"), _ladder(widths_v, "widths_v"))
    markers = [] if dictionary is None else _markers(dictionary, first_marker)
    elements = [*bars, *pairs, *_place_texts(texts, top), *markers]
    return Layout(f"imaging chart, {horizontal_bar} bar", SIDE_MM, SIDE_MM, tuple(elements))


def point_chart(
    *, seed: int = 0, cells: int = 100, square: float = 200.0, border: float = 50.0
) -> Layout:
    """Return the point-distribution chart: random cells, a border, a black and a white square.

    Parameters
    ----------
    seed : int
        Of the random cells.
    cells : int
        Cells along a side of 1 m.
    square : float
        Side of the two plain squares in the lower corners of the pattern, mm.
    border : float
        Width of the white border, mm.

    Returns
    -------
    Layout

    Raises
    ------
    ValueError
        If a count is below its least value, or border and squares leave no pattern between them.

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
    seed, cells = check_count(seed, "seed", low=0), check_count(cells, "cells")
    square = check_number(square, "square", low=1, high=SIDE_MM / 2, unit="mm")
    border = check_number(border, "border", low=0, high=SIDE_MM / 2 - square, unit="mm")
    right = SIDE_MM - border - square
    edges = np.linspace(0, SIDE_MM, cells + 1)
    rows = _overlapped(edges, border, border + square)
    bits = np.random.default_rng(seed).random((cells, cells)) < 0.5
    for low in (border, right):  # white below the squares, which are drawn over it
        bits[np.ix_(rows, _overlapped(edges, low, low + square))] = True
    for low in (0.0, SIDE_MM - border):
        outer = _overlapped(edges, low, low + border)
        bits[outer] = bits[:, outer] = True
    elements = (
        Cells("cells", 0.0, 0.0, SIDE_MM, cells, np.packbits(bits).tobytes().hex()),
        Bar("black", border, border, square, square, BLACK),
        Bar("white", right, border, square, square, WHITE),
    )
    return Layout(f"point chart, seed {seed}", SIDE_MM, SIDE_MM, elements)


def _overlapped(edges, low, high):
    """Which cells between the edges reach into an interval."""
    return (edges[1:] > low + 1e-9) & (edges[:-1] < high - 1e-9)


def _ladder(widths, name):
    """Widths of line pairs, checked and decreasing."""
    widths = [check_positive(width, name, unit="mm") for width in widths]
    if any(fine >= coarse for coarse, fine in pairwise(widths)):
        raise ValueError(f"Invalid {name} {widths}. Must decrease from each to the next.")
    return widths


def _markers(dictionary, first):
    """The four coded targets, from the lower left corner counterclockwise."""
    low, high = 10.0, SIDE_MM - 10.0 - MARKER_MM
    places = [(low, low), (high, low), (high, high), (low, high)]
    return [
        Marker(f"marker_{k}", x, y, MARKER_MM, dictionary, check_count(first, "marker", low=0) + k)
        for k, (x, y) in enumerate(places)
    ]


def _place_pairs(widths_h, widths_v):
    """Line pairs and the height that is left below those in the field.

    Lying bars fill the column left of the long bar while they fit, downwards; the others follow the
    standing bars in the rows of the field.
    """
    x, bottom, _, height = COLUMN
    top, placed, rest = bottom + height, [], []
    for width in widths_v:
        extent = REPEATS * width
        if top - extent >= bottom:
            placed.append(_pairs("v", width, x, top - extent))
            top -= extent + GAP_MM
        else:
            rest.append(width)
    x, bottom, room, height = FIELD
    sizes = [("h", width, REPEATS * width, LENGTH_MM) for width in widths_h]
    sizes += [("v", width, LENGTH_MM, REPEATS * width) for width in rest]
    right, top, row = x, bottom + height, 0.0
    for direction, width, across, up in sizes:
        if right > x and right + across > x + room:
            right, top, row = x, top - row - GAP_MM, 0.0
        if across > room or top - up < bottom:
            raise ValueError(f"Invalid width {width} mm of line pairs. Must fit on the chart.")
        placed.append(_pairs(direction, width, right, top - up))
        right, row = right + across + GAP_MM, max(row, up)
    return placed, top - row - 2 * GAP_MM


def _pairs(direction, width, x, y):
    """One group of line pairs with its name."""
    return LinePairs(
        f"pairs_{direction}_{width:g}", x, y, width, direction, repeats=REPEATS, length=LENGTH_MM
    )


def _place_texts(texts, top):
    """Lines of text below each other, then the panel of reduced contrast."""
    x, bottom, room, _ = FIELD
    placed = []
    for number, (cap, text, *font) in enumerate(texts, start=1):
        face = font[0] if font else Text.font
        placed.append(Text(f"text_{number}", x, top - 1.15 * cap, text, cap, font=face))
        top -= 1.65 * cap
    if texts:
        cap, text, tone, panel = FAINT_TEXT
        faint = Text("text_faint", x + cap / 2, top - 1.55 * cap, text, cap, tone, panel)
        placed.append(Bar("panel", x, top - 1.9 * cap, faint.width + cap, 1.7 * cap, panel))
        placed.append(faint)
    for element in placed:
        if element.y < bottom or element.width > room:
            raise ValueError(f"Invalid texts: {element.name!r} does not fit. Must be fewer.")
    return placed
