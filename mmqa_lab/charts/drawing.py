"""A layout as PDF and SVG at true size."""

from io import BytesIO
from itertools import pairwise
from xml.sax.saxutils import escape

import numpy as np

from mmqa_lab.charts import glyphs
from mmqa_lab.charts.elements import WHITE, Text


def to_pdf(layout):
    """Return a layout as a PDF of one page at true size: vectors, its font embedded.

    Parameters
    ----------
    layout : Layout

    Returns
    -------
    bytes

    Examples
    --------
    >>> from mmqa_lab.charts import Bar, Layout
    >>> to_pdf(Layout("bar", 40, 20, (Bar("a", 5, 5, 20, 1),)))[:5]
    b'%PDF-'
    """
    from reportlab.lib.units import mm
    from reportlab.pdfbase import pdfmetrics
    from reportlab.pdfbase.ttfonts import TTFont
    from reportlab.pdfgen.canvas import Canvas

    pdfmetrics.registerFont(TTFont(glyphs.FONT_NAME, str(glyphs.font_path())))
    stream = BytesIO()
    page = Canvas(stream, pagesize=(layout.width * mm, layout.height * mm), invariant=1)
    page.setTitle(layout.name)
    for element in layout.elements:
        if isinstance(element, Text):
            page.setFillGray(element.tone)
            page.setFont(glyphs.FONT_NAME, glyphs.size_of_cap(element.cap) * mm)
            page.drawString(element.x * mm, element.y * mm, element.text)
        else:
            for x, y, width, height, tone in _rectangles(element):
                page.setFillGray(tone)
                page.rect(x * mm, y * mm, width * mm, height * mm, stroke=0, fill=1)
    page.save()
    return stream.getvalue()


def to_svg(layout):
    """Return a layout as SVG at true size; letters are outlines, each element a named group.

    Parameters
    ----------
    layout : Layout

    Returns
    -------
    str

    Examples
    --------
    >>> from mmqa_lab.charts import Bar, Layout
    >>> '<g id="a">' in to_svg(Layout("bar", 40, 20, (Bar("a", 5, 5, 20, 1),)))
    True
    """
    w, h = layout.width, layout.height
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{w:g}mm" height="{h:g}mm" '
        f'viewBox="0 0 {w:g} {h:g}">',
        f"<title>{escape(layout.name)}</title>",
        f'<rect width="{w:g}" height="{h:g}" fill="#fff"/>',
        # SVG counts y from above
        f'<g transform="translate(0 {h:g}) scale(1 -1)" shape-rendering="geometricPrecision">',
    ]
    for element in layout.elements:
        lines += [f"<g id={_quoted(element.name)}>", *_shapes(element), "</g>"]
    return "\n".join([*lines, "</g>", "</svg>", ""])


def _shapes(element):
    """The SVG shapes of one element."""
    if isinstance(element, Text):
        rings = ("M" + " ".join(f"{x:.3f},{y:.3f}" for x, y in r) + "Z" for r in element.outlines())
        yield f'<path fill-rule="evenodd" fill="{_colour(element.tone)}" d="{"".join(rings)}"/>'
        return
    for x, y, width, height, tone in _rectangles(element):
        size = f'x="{x:.4f}" y="{y:.4f}" width="{width:.4f}" height="{height:.4f}"'
        yield f'<rect {size} fill="{_colour(tone)}"/>'


def _rectangles(element):
    """The rectangles of one element that differ from its ground; cells alike in a row are one."""
    x, y, tones = element.grid()
    for row, values in enumerate(tones):
        starts = np.concatenate([[0], np.flatnonzero(np.diff(values)) + 1, [len(values)]])
        for first, last in pairwise(starts):
            if values[first] != WHITE or element.ground != WHITE:
                size = x[last] - x[first], y[row + 1] - y[row]
                yield (x[first], y[row], *size, float(values[first]))


def _colour(tone):
    """A tone as SVG writes it."""
    return f"rgb({100 * tone:g}%,{100 * tone:g}%,{100 * tone:g}%)"


def _quoted(text):
    """A name as an XML attribute."""
    return '"' + escape(text, {'"': "&quot;"}) + '"'
