"""A layout as PDF and SVG at true size, and as an image of area means, all by matplotlib."""

from io import BytesIO
from itertools import pairwise

import numpy as np

from mmqa_lab._checks import check_count, check_positive
from mmqa_lab.charts.elements import WHITE, Text

MM_PER_INCH = 25.4

STYLE = {
    "figure.constrained_layout.use": False,
    "figure.autolayout": False,
    "savefig.bbox": None,
    "svg.hashsalt": "mmqa_lab",
}
"""A style that someone set must not change the size of the page."""


def to_pdf(layout):
    """Return a layout as a PDF of one page at true size; letters are outlines.

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
    return _saved(layout, "pdf", {"CreationDate": None, "Title": layout.name})


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
    return _saved(layout, "svg", {"Date": None, "Title": layout.name}).decode()


def reflectance(layout, *, cell):
    """Return the mean tone of each square cell of a chart.

    Everything but letters consists of rectangles, whose share of a cell is a product of two
    overlaps and therefore exact. Of letters matplotlib measures the share, to 1/255.

    Parameters
    ----------
    layout : Layout
    cell : float
        Side of a cell, mm. The last column and row may reach beyond the chart: white there.

    Returns
    -------
    array of float32, shape (rows, columns)
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
    check_count(columns * rows, "number of cells")
    if columns * rows > 1e9:
        raise ValueError(f"Invalid cell {cell} mm: {columns * rows} cells. Must be 1e9 or fewer.")
    image = np.full((rows, columns), WHITE, dtype=np.float32)
    for element in layout.elements:
        if isinstance(element, Text):
            _add_text(image, element, cell)
        else:
            _add_grid(image, element, cell)
    return image


def _saved(layout, form, metadata):
    """The page in one form, equal to the byte from run to run."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    stream = BytesIO()
    with mpl.rc_context(STYLE):
        size = (layout.width / MM_PER_INCH, layout.height / MM_PER_INCH)
        page = Figure(figsize=size, frameon=False)
        ax = page.add_axes((0, 0, 1, 1), xlim=(0, layout.width), ylim=(0, layout.height))
        ax.set_axis_off()
        for element in layout.elements:
            _draw(element, ax)
        page.savefig(stream, format=form, metadata=metadata)
    return stream.getvalue()


def _draw(element, ax):
    """Draw one element as filled outlines, one for each of its tones."""
    from matplotlib.collections import PathCollection

    shapes = {element.tone: element.outline()} if isinstance(element, Text) else _shapes(element)
    colours = [str(float(tone)) for tone in shapes]
    drawn = PathCollection(list(shapes.values()), facecolors=colours, linewidths=0)
    ax.add_collection(drawn, autolim=False)
    drawn.set_gid(element.name)


def _shapes(element):
    """The outline of each tone that differs from white; cells alike in a row are one rectangle."""
    from matplotlib.path import Path

    corners = {}
    x, y, tones = element.grid()
    for (low, high), values in zip(pairwise(y), tones, strict=True):
        starts = np.concatenate([[0], np.flatnonzero(np.diff(values)) + 1, [len(values)]])
        for first, last in pairwise(starts):
            left, right = x[first], x[last]
            ring = [(left, low), (right, low), (right, high), (left, high), (left, low)]
            corners.setdefault(float(values[first]), []).append(ring)
    if element.ground == WHITE:
        corners.pop(WHITE, None)
    codes = [Path.MOVETO, Path.LINETO, Path.LINETO, Path.LINETO, Path.CLOSEPOLY]
    return {
        tone: Path(np.concatenate(rings), codes * len(rings)) for tone, rings in corners.items()
    }


def _add_grid(image, element, cell):
    """Add the difference of a grid's tones to what lies below them."""
    x, y, tones = element.grid()
    first_column, across = _overlaps(x, cell, image.shape[1])
    first_row, upward = _overlaps(y, cell, image.shape[0])
    part = upward.T @ (tones - element.ground) @ across
    rows, columns = part.shape
    image[first_row : first_row + rows, first_column : first_column + columns] += part


def _overlaps(edges, cell, count):
    """The share of each cell that each interval covers, from the first cell that any covers."""
    first = int(np.floor(edges[0] / cell))
    last = min(int(np.ceil(edges[-1] / cell)), count)
    low = np.arange(first, last) * cell
    inner = np.minimum(edges[1:, None], low + cell) - np.maximum(edges[:-1, None], low)
    return first, np.clip(inner, 0, None) / cell


def _add_text(image, element, cell):
    """Add the difference of letters' tone to what lies below them."""
    from matplotlib.backends.backend_agg import RendererAgg
    from matplotlib.transforms import Affine2D

    outline = element.outline()
    if not len(outline.vertices):
        return
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
