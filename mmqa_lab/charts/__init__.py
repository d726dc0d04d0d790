"""Test charts as data: what is printed where, in millimetres, in grey tones and colours.

One :class:`Layout` is drawn to PDF and SVG, turned into the reflectance that simulated cameras
photograph, and tells the evaluation where everything lies. The origin is the lower left corner, x
to the right, y up. Tones are relative reflectances, 0 black, 1 white. Print files give them by the
curve of sRGB and show letters as outlines, so that no font is missing. Here are the two charts of
Pfeifer et al. 2021, 1 m x 1 m, from one description; :func:`encode` and :func:`decode` lead from
linear light to the values of image files and back.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, lru_cache
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mmqa_lab._checks import check_choice, check_count, check_number, check_positive, refuse

if TYPE_CHECKING:
    from matplotlib.path import Path as Outline

__all__ = [
    *("Bar", "Layout", "LinePairs", "Marker", "Text"),
    *("decode", "encode", "how_to_use", "imaging_chart", "point_chart", "reflectance"),
]
__dir__ = __all__.copy

BLACK, WHITE = 0.0, 1.0

LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Shares of red, green and blue in a grey tone (ITU-R BT.709)."""


GAMMAS = ("srgb", "linear")

KNEE = 0.0031308
"""Linear light below which the curve of sRGB is a straight line."""

SIDE_MM, CELLS_A_SIDE, BORDER_MM, SQUARE_MM = 1000.0, 100, 50.0, 200.0
"""Point chart: side (mm), cells along it, white border and plain squares (mm)."""

IMAGING = {"grey": "imaging.csv", "revised": "revised.csv"}
"""Tables of the imaging charts: with a grey lying bar, and as their authors advise."""

BAR_MM = 800.0
"""Standing bars of the imaging charts, mm."""

LENGTHS = {"x", "y", "width", "height", "size", "pair", "length", "cap"}
"""Fields of elements that are lengths."""


class _Rectangle:
    """A rectangle by its lower left corner, width and height."""

    def corners(self):
        """Return the corners from the lower left, counterclockwise, mm, shape (4, 2)."""
        share = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
        return np.array([self.x, self.y]) + share * [float(self.width), float(self.height)]


@dataclass(frozen=True)
class _Element(_Rectangle):
    """A printed element: name, lower left corner (mm) and the tone around it."""

    name: str
    x: float
    y: float
    ground: float | tuple[float, float, float] = field(default=WHITE, kw_only=True)

    def grid(self):
        """Return the edges in x (m + 1) and y (n + 1), mm, and the tones (n, m) between them."""
        rows, columns = self.tones.shape[:2]
        x, y = np.linspace(0, self.width, columns + 1), np.linspace(0, self.height, rows + 1)
        return self.x + x, self.y + y, self.tones


@dataclass(frozen=True)
class _Square(_Element):
    """A square element."""

    size: float

    @property
    def width(self):
        """Side, mm."""
        return self.size

    height = width


@dataclass(frozen=True)
class Bar(_Element):
    """A plain rectangle: long bars, panels, patches.

    Parameters
    ----------
    name : str
    x, y : float
        Lower left corner, mm.
    width, height : float
        Size, mm.
    tone, ground : float or (float, float, float)
        Reflectance of the bar and of what is around it.

    Examples
    --------
    >>> x, y, tones = Bar("a", 10, 10, 5, 30).grid()
    >>> x.tolist(), y.tolist(), tones.tolist()
    ([10.0, 15.0], [10.0, 40.0], [[0.0]])
    """

    width: float
    height: float
    tone: float | tuple[float, float, float] = BLACK

    @property
    def tones(self) -> np.ndarray:
        """The tone, shape (1, 1)."""
        return np.array([[self.tone]])


@dataclass(frozen=True)
class LinePairs(_Element):
    """Equal black and white bars; ``pair`` is the width w of one black and one white bar.

    ``direction`` says along what the pairs follow each other: ``"h"`` is standing bars, read in
    horizontal direction, ``"v"`` lying bars. It begins with black at the low end.

    Parameters
    ----------
    name, x, y, ground
        As of :class:`Bar`.
    pair : float
        Width of a black and a white bar together, mm.
    direction : {"h", "v"}
    repeats : int
        Pairs.
    length : float
        Of the bars, mm.

    Examples
    --------
    >>> pairs = LinePairs("w 4", 0, 0, 4.0, "h", repeats=2)
    >>> pairs.grid()[0].tolist(), pairs.grid()[2].tolist()
    ([0.0, 2.0, 4.0, 6.0, 8.0], [[0.0, 1.0, 0.0, 1.0]])
    """

    pair: float
    direction: str
    repeats: int = 8
    length: float = 80.0

    @property
    def extent(self) -> float:
        """Length across all bars, mm."""
        return self.pair * self.repeats

    @property
    def width(self) -> float:
        """Size along x, mm."""
        return self.extent if self.direction == "h" else self.length

    @property
    def height(self) -> float:
        """Size along y, mm."""
        return self.length if self.direction == "h" else self.extent

    @property
    def tones(self) -> np.ndarray:
        """Black and white by turns, a row or a column."""
        tones = np.tile([BLACK, WHITE], (1, self.repeats))
        return tones if self.direction == "h" else tones.T


@dataclass(frozen=True)
class Marker(_Square):
    """A coded square target of an OpenCV dictionary, black border included.

    Parameters
    ----------
    name, x, y, ground
        As of :class:`Bar`.
    size : float
        Side, mm.
    dictionary : str
        Name in OpenCV, such as ``"DICT_4X4_50"``.
    identifier : int
        Number in the dictionary.

    Examples
    --------
    >>> _, _, tones = Marker("target", 0, 0, 60, "DICT_4X4_50", 0).grid()
    >>> tones.shape, float(tones[0].max())  # four modules and a black border
    ((6, 6), 0.0)
    """

    dictionary: str
    identifier: int

    @property
    def tones(self) -> np.ndarray:
        """The modules, border included: 0 black, 1 white."""
        import cv2

        book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        side = book.markerSize + 2
        return cv2.aruco.generateImageMarker(book, self.identifier, side)[::-1] / 255.0


@dataclass(frozen=True)
class Cells(_Square):
    """A square of equal cells.

    Parameters
    ----------
    name, x, y, ground
        As of :class:`Bar`.
    size : float
        Side, mm.
    rows : tuple of tuple of float
        Tones of the cells, row by row from below.

    Examples
    --------
    >>> Cells("four", 0, 0, 100, ((1.0, 0.0), (0.0, 1.0))).grid()[0].tolist()
    [0.0, 50.0, 100.0]
    """

    rows: tuple

    @property
    def tones(self) -> np.ndarray:
        """Tones of the cells, shape (n, n)."""
        return np.array(self.rows, dtype=float)


@dataclass(frozen=True)
class Text(_Element):
    """A line of text from its lower left corner on the base line; ``cap`` is the height of H.

    Parameters
    ----------
    name, x, y, tone, ground
        As of :class:`Bar`; from the left end of the base line.
    text : str
    cap : float
        Height of the capitals, mm.
    font : str
        Name of a TrueType file that matplotlib brings along, such as ``"DejaVuSerif"``.
    stretch : float
        Width of the letters as a share of the font's: below 1 for narrow ones.

    Raises
    ------
    ValueError
        If the font lacks a letter, once the text is drawn or measured.

    Examples
    --------
    >>> one, two = Text("a", 0, 0, "HH", 20.0), Text("b", 0, 0, "HH", 40.0)
    >>> one.height, round(two.width / one.width, 6)
    (20.0, 2.0)
    """

    text: str
    cap: float
    tone: float | tuple[float, float, float] = BLACK
    font: str = "DejaVuSans"
    stretch: float = 1.0

    @property
    def width(self) -> float:
        """From the start of the base line to the right end of the letters, mm."""
        vertices = _letters(self.text, self.font).vertices
        return float(vertices[:, 0].max(initial=0)) * self.cap * self.stretch

    @property
    def height(self) -> float:
        """Height of the capitals, mm; accents and descenders reach beyond."""
        return self.cap

    def outline(self) -> Outline:
        """Return the letters' outline as a matplotlib Path, mm, to be filled."""
        from matplotlib.transforms import Affine2D

        place = Affine2D().scale(self.stretch * self.cap, self.cap).translate(self.x, self.y)
        return place.transform_path(_letters(self.text, self.font))


ELEMENTS = {kind.__name__: kind for kind in (Bar, LinePairs, Marker, Text)}


@dataclass(frozen=True)
class Layout(_Rectangle):
    """A chart: its size in mm and its elements, each with a name of its own.

    Parameters
    ----------
    name : str
    width, height : float
        Size of the chart, mm.
    elements : tuple of Bar, Cells, LinePairs, Marker, Text
        Later ones cover earlier ones.

    Raises
    ------
    ValueError
        If two elements share a name, or one reaches over the chart's edge.

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
        repeats = len(self._by_name) < len(self.elements)
        refuse(repeats, f"chart {self.name!r}", "a name repeats", "distinct")
        for element in self.elements:
            _check_element(element)
            low, high = element.corners()[[0, 2]]
            inside = (low >= 0).all() and (high <= [self.width, self.height]).all()
            within = f"within {self.width} mm x {self.height} mm"
            refuse(not inside, f"element {element.name!r}", f"from {low} to {high} mm", within)

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
        return self._drawn("pdf", {"CreationDate": None, "Title": self.name}, notes)

    def to_svg(self) -> bytes:
        """Return the chart as SVG at true size, bytes; each element is a named group."""
        return self._drawn("svg", {"Date": None, "Title": self.name})

    def _drawn(self, form, metadata, notes=""):
        """The chart in a file format, at true size."""
        from matplotlib import style
        from matplotlib.backends.backend_pdf import PdfPages
        from matplotlib.figure import Figure
        from matplotlib.patches import PathPatch
        from matplotlib.transforms import Affine2D

        place, stream = Affine2D().scale(72 / 25.4), BytesIO()
        # a style that someone set must not change the size of the page
        with style.context(["default", {"svg.hashsalt": "mmqa_lab"}]):
            size = self.width / 25.4, self.height / 25.4
            page = Figure(figsize=size, frameon=False, dpi=72)
            for element in self.elements:
                for tone, outline in _shapes(element).items():
                    look = {"facecolor": _ink(tone), "lw": 0, "gid": element.name}
                    page.add_artist(PathPatch(outline, transform=place, **look))
            if not notes:
                page.savefig(stream, format=form, metadata=metadata)
                return stream.getvalue()
            second = Figure(figsize=(8.27, 11.69))
            second.text(0.09, 0.95, notes, va="top", size=9.5, linespacing=1.45)
            with PdfPages(stream, metadata=metadata) as file:
                file.savefig(page)
                file.savefig(second)
        return stream.getvalue()


def how_to_use() -> str:
    """Return how the imaging chart is printed, checked, set up, photographed and measured.

    Examples
    --------
    >>> "--printed-mm" in how_to_use()
    True
    """
    return Path(__file__).with_name("use.txt").read_text(encoding="utf-8")


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


def _element(row):
    """An element from a row of a table; what its kind does not have is empty."""
    kind = ELEMENTS[row.pop("kind")]
    read = {one.name: {"str": str, "int": int}.get(one.type, _numbers) for one in fields(kind)}
    return kind(**{name: read[name](text) for name, text in row.items() if text})


def _numbers(text):
    """A number, or several with spaces between."""
    numbers = tuple(map(float, text.split()))
    return numbers[0] if len(numbers) == 1 else numbers


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


def reflectance(layout: Layout, *, cell: float, colour: bool = False) -> np.ndarray:
    """Return the mean tone of each square cell of a chart.

    Everything but letters consists of rectangles. Their share of a cell is a product of two
    overlaps and exact. The share of letters is measured by matplotlib, to 1/255.

    Parameters
    ----------
    layout : Layout
    cell : float
        Side of a cell, mm. The last column and row may reach beyond the chart: white there.
    colour : bool
        Red, green and blue instead of grey, which is their luminance.

    Returns
    -------
    array of float32, shape (rows, columns) or (rows, columns, 3)
        The first row lies at the lower edge of the chart.

    Raises
    ------
    ValueError
        If the cell is not positive or so small that the image had more than 1e9 cells.

    Examples
    --------
    >>> from mmqa_lab.charts import Bar, Layout
    >>> reflectance(Layout("bar", 4, 2, (Bar("a", 0.5, 0, 2, 1),)), cell=1).tolist()
    [[0.5, 0.0, 0.5, 1.0], [1.0, 1.0, 1.0, 1.0]]
    """
    cell = check_positive(cell, "cell", unit="mm")
    columns, rows = (int(np.ceil(side / cell - 1e-9)) for side in (layout.width, layout.height))
    refuse(columns * rows > 1e9, f"cell {cell} mm", f"{columns * rows} cells", "1e9 or fewer")
    if colour:
        return np.stack([_painted(layout, (rows, columns), cell, w) for w in np.eye(3)], axis=2)
    return _painted(layout, (rows, columns), cell, LUMINANCE)


def encode(values: np.ndarray, gamma: str) -> np.ndarray:
    """Return values 0..1 of linear light as the file's: unchanged, or by the curve of sRGB.

    References
    ----------
    IEC 61966-2-1:1999, section 5.2.

    Examples
    --------
    >>> encode(np.array([0.0, 0.18, 1.0]), "srgb").round(2).tolist()
    [0.0, 0.46, 1.0]
    """
    if check_choice(gamma, "gamma", GAMMAS) == "linear":
        return values
    values = np.clip(values, 0, 1)
    curve = 1.055 * np.maximum(values, KNEE) ** (1 / 2.4) - 0.055
    return np.where(values <= KNEE, 12.92 * values, curve).astype(values.dtype)


def decode(values: np.ndarray, gamma: str) -> np.ndarray:
    """Return a file's values 0..1 as linear light, the inverse of :func:`encode`.

    Examples
    --------
    >>> bool(np.isclose(decode(encode(np.array([0.2]), "srgb"), "srgb"), 0.2)[0])
    True
    """
    if check_choice(gamma, "gamma", GAMMAS) == "linear":
        return values
    curve = ((np.maximum(values, 12.92 * KNEE) + 0.055) / 1.055) ** 2.4
    return np.where(values <= 12.92 * KNEE, values / 12.92, curve).astype(values.dtype)


def _painted(layout, shape, cell, weights):
    """The image of a chart, with these weights of red, green and blue."""
    image = np.full(shape, WHITE, dtype=np.float32)
    for element in layout.elements:
        add = _add_text if isinstance(element, Text) else _add_grid
        add(image, _seen(element, weights), cell)
    return image


def _seen(element, weights):
    """An element with grey tones in place of its colours."""
    tones = {name: getattr(element, name, WHITE) for name in ("tone", "ground")}
    colours = {name: tone for name, tone in tones.items() if isinstance(tone, tuple)}
    return replace(element, **{name: float(np.dot(weights, t)) for name, t in colours.items()})


def _ink(tone):
    """The colour of a tone in a file: a grey stays a grey."""
    coded = encode(np.array(tone, dtype=float), "srgb")
    return tuple(coded) if coded.ndim else str(float(coded))


def _check_element(element):
    """Raise if a size, tone or direction of an element is not possible."""
    if isinstance(element, LinePairs):
        check_choice(element.direction, f"direction of element {element.name!r}", ("h", "v"))
    for side in ("width", "height"):
        check_positive(getattr(element, side), f"{side} of element {element.name!r}", unit="mm")
    for name in ("tone", "ground"):
        for share in np.ravel(getattr(element, name, WHITE)):
            check_number(share, f"{name} of element {element.name!r}", low=0, high=1)


@lru_cache(maxsize=128)
def _letters(text, font):
    """Outline of a text from the start of its base line, in heights of its capitals."""
    from matplotlib import get_data_path
    from matplotlib.font_manager import FontProperties, get_font
    from matplotlib.path import Path as Outline
    from matplotlib.textpath import TextPath

    file = Path(get_data_path(), "fonts", "ttf", f"{font}.ttf")
    missing = [letter for letter in text if not get_font(file).get_char_index(ord(letter))]
    if missing:
        raise ValueError(f"Invalid text {text!r}. Must do without {missing[0]!r}: not in the font.")
    face = FontProperties(fname=file)
    cap = TextPath((0, 0), "H", size=1, prop=face).get_extents().ymax
    # matplotlib flattens curves to half a unit: here a two thousandth of the capitals
    outline = TextPath((0, 0), text, size=1000 / cap, prop=face).cleaned(curves=False)
    drawn = outline.codes != Outline.STOP
    return Outline(outline.vertices[drawn] / 1000, outline.codes[drawn])


def _shapes(element):
    """The outline of each tone other than white; neighbours of the same tone are joined."""
    import shapely
    from matplotlib.path import Path as Outline

    if isinstance(element, Text):
        return {element.tone: element.outline()}
    if isinstance(element, Bar):
        return {element.tone: Outline(element.corners()[[0, 1, 2, 3, 0]], closed=True)}
    x, y, tones = element.grid()
    boxes = shapely.box(*np.meshgrid(x[:-1], y[:-1]), *np.meshgrid(x[1:], y[1:]))
    outlines = {}
    for tone in np.unique(tones):
        if tone != WHITE or element.ground != WHITE:
            shape = shapely.normalize(shapely.union_all(boxes[tones == tone]))
            rings = shapely.get_rings(shapely.get_parts(shape))
            paths = [Outline(shapely.get_coordinates(ring), closed=True) for ring in rings]
            outlines[float(tone)] = Outline.make_compound_path(*paths)
    return outlines


def _add_grid(image, element, cell):
    """Add the difference between a grid's tones and the ground to the image."""
    x, y, tones = element.grid()
    (columns, across), (rows, upward) = _overlaps(x, cell), _overlaps(y, cell)
    part = image[rows, columns]
    change = upward.T @ (tones - element.ground) @ across
    part += change[: part.shape[0], : part.shape[1]]


def _overlaps(edges, cell):
    """The cells that intervals cover, and the share of each cell that each of them covers."""
    first, last = int(np.floor(edges[0] / cell)), int(np.ceil(edges[-1] / cell))
    low = np.arange(first, last) * cell
    inner = np.minimum(edges[1:, None], low + cell) - np.maximum(edges[:-1, None], low)
    return slice(first, last), np.clip(inner, 0, None) / cell


def _add_text(image, element, cell):
    """Add the difference between the letters' tone and the ground to the image."""
    from matplotlib.backends.backend_agg import RendererAgg
    from matplotlib.transforms import Affine2D

    outline = element.outline()
    box = outline.get_extents().get_points() / cell
    first = np.maximum(np.floor(box[0]).astype(int), 0)
    last = np.minimum(np.ceil(box[1]).astype(int), image.shape[::-1])
    renderer = RendererAgg(*(last - first), 72)
    plain = renderer.new_gc()
    plain.set_linewidth(0)
    plain.set_snap(False)
    to_cells = Affine2D().scale(1 / cell).translate(*-first)
    renderer.draw_path(plain, outline, to_cells, (0, 0, 0))
    share = np.asarray(renderer.buffer_rgba())[::-1, :, 3] / np.float32(255)
    change = np.float32(element.tone - element.ground)
    image[first[1] : last[1], first[0] : last[0]] += share * change
