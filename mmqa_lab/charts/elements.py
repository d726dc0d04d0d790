"""What is printed on a chart: bars, line pairs, coded targets, cells, texts."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.path import Path as Outline

__all__ = ["BLACK", "WHITE", "Bar", "Cells", "LinePairs", "Marker", "Rectangle", "Text"]

BLACK, WHITE = 0.0, 1.0


class Rectangle:
    """A rectangle by its lower left corner, width and height."""

    def corners(self):
        """Return the corners from the lower left, counterclockwise, mm, shape (4, 2)."""
        share = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
        return np.array([self.x, self.y]) + share * [float(self.width), float(self.height)]


@dataclass(frozen=True)
class _Element(Rectangle):
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
    plain = text.replace("$", r"\$")  # no formula
    # matplotlib flattens curves to half a unit: here a two thousandth of the capitals
    outline = TextPath((0, 0), plain, size=1000 / cap, prop=face).cleaned(curves=False)
    drawn = outline.codes != Outline.STOP
    return Outline(outline.vertices[drawn] / 1000, outline.codes[drawn])
