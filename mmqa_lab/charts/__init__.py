"""Test charts as data: what is printed where, in millimetres, in grey tones and colours.

One :class:`Layout` is drawn to PDF and SVG, turned into the reflectance that simulated cameras
photograph, and tells the evaluation where everything lies. The origin is the lower left corner, x
to the right, y up. Tones are relative reflectances, 0 black, 1 white. Print files give them by the
curve of sRGB and show letters as outlines, so that no font is missing. Here are the two charts of
Pfeifer et al. 2021, 1 m x 1 m, from one description.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from mmqa_lab._checks import check_choice, check_count, check_positive
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
__dir__ = __all__.copy

SIDE_MM = 1000.0

CELLS, CELL_MM, BORDER_MM, SQUARE_MM = 100, 10.0, 50.0, 200.0
"""Of the point chart: cells along a side and their size, its white border, its plain squares."""

WIDTHS_H_MM = (40.0, 30.0, 20.0, 15.0, 10.0, 8.0, 6.0, 4.0, 3.0, 2.0)
"""Widths of the line pairs read in horizontal direction, mm."""

WIDTHS_V_MM = WIDTHS_H_MM[1:]
"""Widths of the line pairs read in vertical direction, mm."""

COARSER_MM = {"widths_h": (60.0, *WIDTHS_H_MM), "widths_v": (60.0, 40.0, *WIDTHS_V_MM)}
"""Widths of the revised chart, mm."""

TEXTS = (
    ("line", 0.0, 0, 40.0, "Mo.-Fr. (werkt). v. 6³⁰-19ʰ"),
    ("word", 0.0, 1, 40.0, "Müllsammelfzge."),
    ("word_serif", 0.0, 2, 40.0, "Müllsammelfzge.", "DejaVuSerif"),
    ("block_1", 0.0, 3, 40.0, "ausgen."),
    ("block_2", 0.0, 4, 40.0, "Linienomnibusse"),
    ("block_symbol", 180.0, 3, 46.0, "♿"),
    ("column_1", 0.0, 5, 40.0, "Mo.-Sa."),
    ("column_2", 0.0, 6, 40.0, "v. 6³⁰-18³⁰"),
    ("column_3", 0.0, 7, 40.0, "ausgen."),
    ("column_symbol_1", 165.0, 5, 46.0, "♿"),
    ("column_symbol_2", 235.0, 5, 46.0, "⇦"),
    ("42", 330.0, 5.0, 42.0, "(werkt.) v."),
    ("45_1", 330.0, 6.05, 45.0, "Aus-"),
    ("45_small", 437.0, 6.05, 30.0, "u."),
    ("45_2", 330.0, 7.05, 45.0, "Einsteigen"),
    ("50", 400.0, 4.05, 50.0, "Mo.-Fr."),
)
"""Name, place (mm from the left, line from above), height of the capitals in mm, text, font."""

BLUE, RED, YELLOW = (0.0, 0.105, 0.262), (0.533, 0.006, 0.012), (0.930, 0.462, 0.0)
"""Traffic blue, red and yellow (RAL 5017, 3020, 1023) by their usual sRGB values, linear."""

PANELS = (
    ("faint", 380.0, 1.0, "ausgen.", 0.35, 0.6),
    ("blue", 366.0, 2.8, "19", WHITE, BLUE),
    ("red", 437.0, 2.8, "19", WHITE, RED),
    ("yellow", 508.0, 2.8, "19", BLACK, YELLOW),
)
"""Name, place, text of 40 mm, tones of letters and panel: reduced contrast, colours of signs."""

STRETCH = 0.77
"""Width of the letters as a share of the font's: signs have narrow letters."""

LINES, LINE_MM, LEAST_MM = 8.4, 66.0, 55.0
"""Lines of text, and how far apart they are, mm: where there is room, and at least."""

REPEATS, LENGTH_MM = 8, 80.0

BAR_MM, MARKER_MM, GAP_MM = 40.0, 90.0, 15.0

LABEL_MM, LABEL_GAP_MM = 9.0, 24.0
"""Height of the printed widths and lengths, and the room that they need below a pattern."""

COLUMNS = (16.0, 912.0), 120.0, 760.0
"""x, y and height of the columns for lying bars, beside the long bars, mm."""

FIELD = (212.0, 90.0, 600.0, 890.0)
"""x, y, width and height of the field between the long bars, mm."""


def imaging_chart(
    *,
    revised: bool = False,
    horizontal_bar: str | None = None,
    widths_h: Sequence[float] | None = None,
    widths_v: Sequence[float] | None = None,
    texts: bool = True,
    dictionary: str | None = "DICT_4X4_50",
    first_marker: int = 0,
) -> Layout:
    """Return the imaging chart.

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
    widths_h, widths_v : sequence of float, optional
        Widths of the line pairs, mm, from coarse to fine, for standing and for lying bars.
    texts : bool
        With the texts.
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
    wanted = COARSER_MM if revised else {"widths_h": WIDTHS_H_MM, "widths_v": WIDTHS_V_MM}
    given = {"widths_h": widths_h, "widths_v": widths_v}
    ladders = {name: _ladder(given[name] or wanted[name], name) for name in given}
    horizontal_bar = horizontal_bar or ("black" if revised else "grey")
    check_choice(horizontal_bar, "horizontal_bar", ("grey", "black"))
    tone = GREY if horizontal_bar == "grey" else BLACK
    bars = [
        Bar("bar_left", 134.0, 100.0, BAR_MM, 800.0),
        Bar("bar_right", 836.0, 100.0, BAR_MM, 800.0),
        Bar("bar_horizontal", 200.0, 30.0, 600.0, BAR_MM, tone),
    ]
    pairs, top = _place_pairs(**ladders)
    markers = [] if dictionary is None else _markers(dictionary, first_marker)
    elements = [*bars, *pairs, *_labels(pairs), *markers, *(_place_texts(top) if texts else ())]
    name = f"{'revised ' if revised else ''}imaging chart, {horizontal_bar} bar"
    return Layout(name, SIDE_MM, SIDE_MM, tuple(elements))


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
    """Line pairs and the height of the field that is left below them.

    Lying bars fill the column left of the long bars. Of the others, those higher than standing bars
    fill the column on the right, and the rest follow the standing bars in the rows of the field.
    Each pattern goes to the first place with room for it.
    """
    lefts, bottom, height = COLUMNS
    tops, placed, rest = dict.fromkeys(lefts, bottom + height), [], []
    for width in widths_v:
        extent = REPEATS * width
        open_to = lefts if extent > LENGTH_MM else lefts[:1]
        x = next((left for left in open_to if tops[left] - extent >= bottom), None)
        if x is None:
            rest.append(("v", width, LENGTH_MM, extent))
        else:
            placed.append(_pairs("v", width, x, tops[x] - extent))
            tops[x] -= extent + LABEL_GAP_MM
    left, bottom, room, height = FIELD
    rows, low = [], bottom + height  # a row: where it is free, its top and its height
    for direction, width, across, up in [
        *(("h", width, REPEATS * width, LENGTH_MM) for width in widths_h),
        *rest,
    ]:
        row = next((r for r in rows if r[0] + across <= left + room and up <= r[2]), None)
        if row is None:
            row = [left, low, up]
            rows.append(row)
            low -= up + LABEL_GAP_MM
        if across > room or low < bottom - LABEL_GAP_MM:
            raise ValueError(f"Invalid width {width} mm of line pairs. Must fit on the chart.")
        placed.append(_pairs(direction, width, row[0], row[1] - up))
        row[0] += across + GAP_MM
    return placed, low


def _pairs(direction, width, x, y):
    """One group of line pairs with its name."""
    return LinePairs(
        f"pairs_{direction}_{width:g}", x, y, width, direction, repeats=REPEATS, length=LENGTH_MM
    )


def _labels(pairs):
    """Widths below the line pairs, lengths of the long bars at the edge of the chart."""
    look = {"cap": LABEL_MM, "stretch": STRETCH}
    high, low = SIDE_MM - 5 - LABEL_MM, 8.0
    labels = [
        Text("label_bar_left", 134.0, high, "800 mm", **look),
        Text("label_bar_right", 836.0, high, "800 mm", **look),
        Text("label_bar_horizontal", 838.0, low, "600 mm", **look),
    ]
    below = (LABEL_GAP_MM - LABEL_MM) / 2 + LABEL_MM
    for one in pairs:
        label = Text(f"label_{one.name}", one.x, one.y - below, f"{one.pair:g} mm", **look)
        fits = label.width <= one.width
        labels.append(label if fits else replace(label, text=f"{one.pair:g}"))
    return labels


def _place_texts(top):
    """The texts below a height, panels under those that need one."""
    left, bottom, *_ = FIELD
    line = min(LINE_MM, (top - bottom) / LINES)
    if line < LEAST_MM:
        raise ValueError("Invalid line pairs: leave no room for the texts. Must be fewer or finer.")
    placed = []
    for name, x, row, cap, text, *font in TEXTS:
        look = {"font": font[0] if font else Text.font, "stretch": STRETCH}
        y = top - (row + 0.7) * line
        placed.append(Text(f"text_{name}", left + x, y, text, cap, **look))
    for name, x, row, text, tone, ground in PANELS:
        look = {"ground": ground, "stretch": STRETCH}
        y, cap = top - (row + 0.7) * line, TEXTS[0][3]
        words = Text(f"text_{name}", left + x + 0.25 * cap, y, text, cap, tone, **look)
        size = words.width + 0.5 * cap, 1.55 * cap
        placed += [Bar(f"panel_{name}", left + x, y - 0.36 * cap, *size, ground), words]
    return placed
