"""The printed chart as an image of exact area means, for cameras to photograph."""

import numpy as np

from mmqa_lab._checks import check_count, check_positive
from mmqa_lab.charts.elements import WHITE, Text

LETTER_STEPS = 8
"""Letters are filled on a grid so many times finer than the cells and then averaged."""


def reflectance(layout, *, cell):
    """Return the mean tone of each square cell of a chart.

    Everything but letters consists of rectangles, whose share of a cell is a product of two
    overlaps and therefore exact.

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
    import cv2

    rings = element.outlines()
    if not rings:
        return
    points = np.concatenate(rings)
    first = np.maximum(np.floor(points.min(axis=0) / cell).astype(int) - 1, 0)
    last = np.ceil(points.max(axis=0) / cell).astype(int) + 1
    size = np.minimum(last, image.shape[::-1]) - first
    fine = np.zeros(size[::-1] * LETTER_STEPS, dtype=np.uint8)
    # fillPoly counts pixel centres as whole numbers and takes 8 bits of fractions
    scaled = [(ring / cell - first) * LETTER_STEPS - 0.5 for ring in rings]
    rounded = [np.round(ring * 256).astype(np.int32) for ring in scaled]
    cv2.fillPoly(fine, rounded, 1, shift=8)
    shape = (size[1], LETTER_STEPS, size[0], LETTER_STEPS)
    covered = fine.reshape(shape).mean(axis=(1, 3), dtype=np.float32)
    target = image[first[1] : first[1] + size[1], first[0] : first[0] + size[0]]
    target += covered * np.float32(element.tone - element.ground)
