"""Charts as files to print, PDF and SVG, at true size.

They give tones by the curve of sRGB and show letters as outlines, so that no font is missing.
"""

from io import BytesIO

import numpy as np

from mmqa_lab.charts.elements import WHITE, Bar, Text
from mmqa_lab.charts.light import encode

__all__ = ["drawn"]


def drawn(layout, form, metadata, notes=""):
    """The chart in a file format, at true size."""
    from matplotlib import style
    from matplotlib.backends.backend_pdf import PdfPages
    from matplotlib.figure import Figure
    from matplotlib.patches import PathPatch
    from matplotlib.transforms import Affine2D

    place, stream = Affine2D().scale(72 / 25.4), BytesIO()
    # a style that someone set must not change the size of the page
    with style.context(["default", {"svg.hashsalt": "mmqa_lab"}]):
        size = layout.width / 25.4, layout.height / 25.4
        page = Figure(figsize=size, frameon=False, dpi=72)
        for element in layout.elements:
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


def _ink(tone):
    """The colour of a tone in a file: a grey stays a grey."""
    coded = encode(np.array(tone, dtype=float), "srgb")
    return tuple(coded) if coded.ndim else str(float(coded))
