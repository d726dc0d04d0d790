"""Charts drawn: as reflectance for simulated cameras, and as PDF and SVG to print at true size.

Files give tones by the curve of sRGB and show letters as outlines, so that no font is missing.
:func:`encode` and :func:`decode` lead from linear light to the values of image files and back.
"""

from dataclasses import replace
from io import BytesIO

import numpy as np

from mmqa_lab._checks import check_choice, check_positive, real_array, refuse
from mmqa_lab.charts.elements import WHITE, Bar, Text
from mmqa_lab.charts.layout import Layout

__all__ = ["decode", "drawn", "encode", "reflectance"]


LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Shares of red, green and blue in a grey tone (ITU-R BT.709)."""


GAMMAS = ("srgb", "linear")

KNEE = 0.0031308
"""Linear light below which the curve of sRGB is a straight line."""


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
    """Cover the image with the letters' tone, by the share of each cell that they cover."""
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
    part = image[first[1] : last[1], first[0] : last[0]]
    part += share * (np.float32(element.tone) - part)


def drawn(layout, form, metadata, notes=""):
    """Return the chart in a file format, at true size."""
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
    values = np.clip(_grey(values), 0, 1)
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
    values = _grey(values)
    curve = ((np.maximum(values, 12.92 * KNEE) + 0.055) / 1.055) ** 2.4
    return np.where(values <= 12.92 * KNEE, values / 12.92, curve).astype(values.dtype)


def _grey(values):
    """Grey values in their type, if that has fractions."""
    values = real_array(values, "grey values")
    refuse(not np.isfinite(values).all(), "grey values", "some not finite", "finite")
    return values if values.dtype.kind == "f" else values.astype(np.float64)
