"""Letters as outlines in millimetres, from the free font Bitstream Vera Sans that reportlab ships.

Letters stand by their advance widths, without kerning, as the PDF writer sets them.
"""

from functools import lru_cache
from pathlib import Path

import numpy as np

FONT_NAME = "Vera"

CURVE_STEPS = 8
"""Straight pieces per quadratic curve: at 50 mm letters they stay within 0.02 mm of it."""


@lru_cache
def font_path():
    """Return the path of the TrueType file."""
    import reportlab

    return Path(reportlab.__file__).parent / "fonts" / f"{FONT_NAME}.ttf"


@lru_cache
def _font():
    """The font, its table of characters, and the height of H in font units."""
    from fontTools.ttLib import TTFont

    font = TTFont(font_path())
    return font, font.getBestCmap(), font["glyf"]["H"].yMax


def size_of_cap(cap):
    """Return the font size whose capitals are ``cap`` high, in the unit of ``cap``.

    Examples
    --------
    >>> round(size_of_cap(40.0), 2)
    54.87
    """
    font, _, cap_units = _font()
    return cap * font["head"].unitsPerEm / cap_units


def advance(text, cap):
    """Return the width of a text whose capitals are ``cap`` high, in the unit of ``cap``."""
    font, _, cap_units = _font()
    return sum(font["hmtx"][name][0] for name in _names(text)) * cap / cap_units


def outlines(text, cap):
    """Return the closed outlines of a text, arrays (k, 2), from its start on the base line."""
    font, _, cap_units = _font()
    scale, pen_x, found = cap / cap_units, 0, []
    for name in _names(text):
        found += [(ring + [pen_x, 0]) * scale for ring in _rings(name)]
        pen_x += font["hmtx"][name][0]
    return found


def _names(text):
    """The glyph of each character."""
    _, characters, _ = _font()
    missing = [letter for letter in text if ord(letter) not in characters]
    if missing:
        raise ValueError(f"Invalid text {text!r}. Must do without {missing[0]!r}: not in the font.")
    return [characters[ord(letter)] for letter in text]


@lru_cache(maxsize=512)
def _rings(name):
    """The outlines of one glyph in font units, curves flattened."""
    from fontTools.pens.recordingPen import DecomposingRecordingPen

    glyph_set = _font()[0].getGlyphSet()
    pen = DecomposingRecordingPen(glyph_set)
    glyph_set[name].draw(pen)
    rings = []
    for operation, points in pen.value:
        if operation == "moveTo":
            rings.append([points[0]])
        elif operation == "lineTo":
            rings[-1].append(points[0])
        elif operation == "qCurveTo":
            rings[-1] += _flattened(rings[-1][-1], points)
    return [np.array(ring, dtype=float) for ring in rings]


def _flattened(start, points):
    """Points along the quadratic curves that TrueType writes as one run of control points."""
    from fontTools.pens.basePen import decomposeQuadraticSegment

    t = np.linspace(0, 1, CURVE_STEPS + 1)[1:, None]
    along = []
    for control, end in decomposeQuadraticSegment(points):
        a, b, c = (np.asarray(point, dtype=float) for point in (start, control, end))
        along += list((1 - t) ** 2 * a + 2 * t * (1 - t) * b + t**2 * c)
        start = end
    return along
