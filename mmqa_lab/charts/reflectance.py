"""The printed chart as an image of exact area means, for cameras to photograph."""

import numpy as np

from mmqa_lab._checks import check_count, check_positive
from mmqa_lab.charts.elements import WHITE, Text

LETTER_ROWS = 8
"""Lines through each row of cells on which letters are measured, exactly along the line."""


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
    rings = [ring / cell for ring in element.outlines()]
    if not rings:
        return
    points = np.concatenate(rings)
    first = np.maximum(np.floor(points.min(axis=0)).astype(int), 0)
    last = np.minimum(np.ceil(points.max(axis=0)).astype(int) + 1, image.shape[::-1])
    starts = np.concatenate([ring - first for ring in rings])
    ends = np.concatenate([np.roll(ring, -1, axis=0) - first for ring in rings])
    columns, rows = last - first
    covered = np.zeros((rows, columns + 2))
    for line in range(rows * LETTER_ROWS):
        y = (line + 0.5) / LETTER_ROWS
        crossing = (starts[:, 1] <= y) != (ends[:, 1] <= y)
        low, high = starts[crossing], ends[crossing]
        x = np.sort(low[:, 0] + (y - low[:, 1]) / (high[:, 1] - low[:, 1]) * (high - low)[:, 0])
        # from each crossing on the line is inside or outside in turn; summed up below
        x = np.clip(x, 0, columns)
        sign = np.where(np.arange(len(x)) % 2 == 0, 1.0, -1.0)
        place = np.floor(x).astype(int)
        np.add.at(covered[line // LETTER_ROWS], place, sign * (place + 1 - x))
        np.add.at(covered[line // LETTER_ROWS], place + 1, sign * (x - place))
    share = np.cumsum(covered, axis=1)[:, :columns] / LETTER_ROWS
    target = image[first[1] : last[1], first[0] : last[0]]
    target += (share * (element.tone - element.ground)).astype(np.float32)
