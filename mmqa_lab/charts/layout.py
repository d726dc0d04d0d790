"""Layouts: what is printed where on a chart, in millimetres, and the charts of the paper.

The origin is the lower left corner, x to the right, y up. Tones are relative reflectances, 0 black,
1 white. Here are the two charts of Pfeifer et al. 2021, 1 m x 1 m, from one description.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np

from mmqa_lab._checks import (
    check_choice,
    check_count,
    check_known,
    check_number,
    check_positive,
    refuse,
)  # fmt: skip
from mmqa_lab.charts.elements import BLACK, WHITE, Bar, Cells, LinePairs, Marker, Rectangle, Text

__all__ = ["Layout", "how_to_use", "imaging_chart", "point_chart"]

SIDE_MM, CELLS_A_SIDE, BORDER_MM, SQUARE_MM = 1000.0, 100, 50.0, 200.0
"""Point chart: side (mm), cells along it, white border and plain squares (mm)."""

IMAGING = {"grey": "imaging.csv", "revised": "revised.csv"}
"""Tables of the imaging charts: with a grey lying bar, and as their authors advise."""

BAR_MM = 800.0
"""Standing bars of the imaging charts, mm."""

LENGTHS = {"x", "y", "width", "height", "size", "pair", "length", "cap"}
"""Fields of elements that are lengths."""

BOOKS = tuple(name for name in dir(cv2.aruco) if name.startswith("DICT_"))
"""OpenCV's dictionaries of coded targets."""

ELEMENTS = {kind.__name__: kind for kind in (Bar, LinePairs, Marker, Text)}


@dataclass(frozen=True)
class Layout(Rectangle):
    """A chart: its size in mm and its elements, each with a name of its own.

    Parameters
    ----------
    name : str
    width, height : float
        Size of the chart, mm.
    elements : tuple of Bar, Cells, LinePairs, Marker, Text
        Texts cover what is before them; others lie beside each other, or where all tones
        are their ground.

    Raises
    ------
    ValueError
        If two elements share a name or a place, or one reaches over the chart's edge.

    Examples
    --------
    >>> chart = Layout("two bars", 100, 50, (Bar("a", 10, 10, 5, 30), Bar("b", 60, 10, 5, 30)))
    >>> chart["b"].x
    60
    >>> chart.to_pdf()[:5], b'<g id="a">' in chart.to_svg()
    (b'%PDF-', True)
    """

    name: str
    width: float
    height: float
    elements: tuple
    x = y = 0.0

    def __post_init__(self):
        check_positive(self.width, "chart width", unit="mm")
        check_positive(self.height, "chart height", unit="mm")
        object.__setattr__(self, "elements", tuple(self.elements))
        odd = [type(one).__name__ for one in self.elements if not hasattr(one, "corners")]
        refuse(odd, f"elements of chart {self.name!r}", f"{odd} among them", "elements")
        repeats = len(self._by_name) < len(self.elements)
        refuse(repeats, f"chart {self.name!r}", "a name repeats", "distinct")
        for element in self.elements:
            _check_element(element)
            low, high = element.corners()[[0, 2]]
            inside = (low >= 0).all() and (high <= [self.width, self.height]).all()
            within = f"within {self.width} mm x {self.height} mm"
            refuse(not inside, f"element {element.name!r}", f"from {low} to {high} mm", within)
        grids = [one for one in self.elements if not isinstance(one, Text)]
        ends = np.reshape([one.corners()[[0, 2]] for one in grids], (-1, 2, 2))
        shared = np.minimum(ends[:, None, 1], ends[:, 1]) - np.maximum(ends[:, None, 0], ends[:, 0])
        for first, second in np.argwhere(np.triu((shared > 1e-6).all(axis=2), 1)):
            *edges, tones = grids[first].grid()
            ahead = zip(edges, ends[second].T, strict=True)
            cols, rows = ((e[1:] > low + 1e-6) & (e[:-1] < high - 1e-6) for e, (low, high) in ahead)
            under = np.atleast_3d(tones)[rows][:, cols]
            on_it = (under == np.ravel(grids[second].ground)).all()
            names = f"elements {grids[first].name!r} and {grids[second].name!r}"
            refuse(not on_it, names, "one over the other", "beside each other, but for texts")

    @cached_property
    def _by_name(self):
        return {element.name: element for element in self.elements}

    def __getitem__(self, name):
        return self._by_name[check_choice(name, "element", tuple(self._by_name))]

    def of_kind(self, kind: type) -> list:
        """Return the elements of a class, in their order."""
        return [element for element in self.elements if isinstance(element, kind)]

    def printed(self, standing_mm: float) -> Layout:
        """Return the chart as a printer made it: its standing bars of 800 mm are this long.

        Examples
        --------
        >>> round(imaging_chart().printed(798.4)["bar_left"].height, 6)
        798.4
        """
        factor = check_number(standing_mm, "printed_mm", low=100, high=2000, unit="mm") / BAR_MM
        elements = [
            replace(one, **{k: factor * getattr(one, k) for k in LENGTHS & set(vars(one))})
            for one in self.elements
        ]
        size = factor * self.width, factor * self.height
        return Layout(self.name, *size, tuple(elements))

    def to_pdf(self, *, notes: str = "") -> bytes:
        """Return the chart as a PDF of one page at true size; letters are outlines.

        Notes, if any, are a second page, A4.
        """
        from mmqa_lab.charts.draw import drawn

        return drawn(self, "pdf", {"CreationDate": None, "Title": self.name}, notes)

    def to_svg(self) -> bytes:
        """Return the chart as SVG at true size, bytes; each element is a named group."""
        from mmqa_lab.charts.draw import drawn

        return drawn(self, "svg", {"Date": None, "Title": self.name})


def imaging_chart(which: str = "grey") -> Layout:
    """Return the imaging chart, from the table of its elements (``imaging.csv``, ``revised.csv``).

    Two standing bars 800 mm long and a lying one 600 mm long give the pixel size, line pairs the
    resolution, texts and symbols the legibility. Widths stand below the line pairs, lengths beside
    the bars. Four coded targets in the corners locate the chart.

    Parameters
    ----------
    which : {"grey", "revised"}
        As built, with a grey lying bar; or as the authors advise in section 4.4: that bar black,
        and pairs of 60 mm (lying ones of 40 mm, too) before the others.

    Returns
    -------
    Layout

    Raises
    ------
    ValueError
        If there is no such chart.

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
    file = Path(__file__).with_name(IMAGING[check_choice(which, "chart", tuple(IMAGING))])
    with file.open(encoding="utf-8", newline="") as table:
        elements = tuple(map(_element, csv.DictReader(table)))
    return Layout(f"imaging chart, {which}", SIDE_MM, SIDE_MM, elements)


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
    >>> chart["cells"].tones.shape, chart["black"].tone, chart["white"].tone
    ((100, 100), 0.0, 1.0)
    >>> chart["black"].x, chart["black"].y, chart["white"].x + chart["white"].width
    (50.0, 50.0, 950.0)
    """
    generator = np.random.default_rng(check_count(seed, "seed", low=0))
    white = generator.random((CELLS_A_SIDE, CELLS_A_SIDE)) < 0.5
    border, square = (round(CELLS_A_SIDE * side / SIDE_MM) for side in (BORDER_MM, SQUARE_MM))
    white[:border] = white[-border:] = white[:, :border] = white[:, -border:] = True
    for columns in (slice(border, border + square), slice(-border - square, -border)):
        white[border : border + square, columns] = True  # below the squares, drawn over it
    low, side = (BORDER_MM, BORDER_MM), (SQUARE_MM, SQUARE_MM)
    elements = (
        Cells("cells", 0.0, 0.0, SIDE_MM, tuple(map(tuple, white.astype(float).tolist()))),
        Bar("black", *low, *side, BLACK),
        Bar("white", SIDE_MM - BORDER_MM - SQUARE_MM, BORDER_MM, *side, WHITE),
    )
    return Layout(f"point chart, seed {seed}", SIDE_MM, SIDE_MM, elements)


def how_to_use() -> str:
    """Return how the imaging chart is printed, checked, set up, photographed and measured.

    Examples
    --------
    >>> "--printed-mm" in how_to_use()
    True
    """
    return Path(__file__).with_name("use.txt").read_text(encoding="utf-8")


def _element(row):
    """An element from a row of a table; what its kind does not have is empty."""
    kind = ELEMENTS[row.pop("kind")]
    read = {one.name: {"str": str, "int": int}.get(one.type, _numbers) for one in fields(kind)}
    return kind(**{name: read[name](text) for name, text in row.items() if text})


def _numbers(text):
    """A number, or several with spaces between."""
    numbers = tuple(map(float, text.split()))
    return numbers[0] if len(numbers) == 1 else numbers


def _check_element(element):
    """Raise if a size, tone or direction of an element is not possible."""
    if isinstance(element, LinePairs):
        check_choice(element.direction, f"direction of element {element.name!r}", ("h", "v"))
    if isinstance(element, Marker):
        name = f"target {element.name!r}"
        book = getattr(cv2.aruco, check_known(element.dictionary, f"dictionary of {name}", BOOKS))
        most = len(cv2.aruco.getPredefinedDictionary(book).bytesList) - 1
        check_number(check_count(element.identifier, name, low=0), name, low=0, high=most)
    for side in ("width", "height"):
        check_positive(getattr(element, side), f"{side} of element {element.name!r}", unit="mm")
    for name in ("tone", "ground"):
        for share in np.ravel(getattr(element, name, WHITE)):
            check_number(share, f"{name} of element {element.name!r}", low=0, high=1)
