"""The reflectance of a chart as an image: what simulated cameras photograph."""

from dataclasses import replace

import numpy as np

from mmqa_lab._checks import check_positive, refuse
from mmqa_lab.charts.elements import WHITE, Text
from mmqa_lab.charts.layout import Layout

__all__ = ["reflectance"]

LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Shares of red, green and blue in a grey tone (ITU-R BT.709)."""


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
