"""Cells and tiles: where they lie, and which of them have points."""

from dataclasses import dataclass

import numpy as np

from mmqa_lab.maps.tile import Window

COMFORTABLE = 1_500_000
"""Points that a tile should hold at most, by the pieces' boxes: about half a gigabyte of work."""

WIDEST_M, NARROWEST_M = 128.0, 4.0


@dataclass(frozen=True)
class Grid:
    """Square cells in square tiles.

    Parameters
    ----------
    cell : float
        Side of a cell, m. Cell (i, j) reaches from i * cell to (i + 1) * cell in easting.
    tile : int
        Cells along the side of a tile. Tile (i, j) begins with cell (i * tile, j * tile).
    first : tuple of int, length 3
        The cell, eastward, northward and upward, at whose corner local coordinates have their zero.
    """

    cell: float
    tile: int
    first: tuple

    @property
    def origin(self):
        """Coordinates of the local zero, shape (3,), m."""
        return np.array(self.first) * self.cell

    def window(self, place):
        """The cells of the tile at ``place`` = (i, j), counted from the local zero."""
        column, row = (k * self.tile - first for k, first in zip(place, self.first, strict=False))
        return Window(column, row, self.tile, self.tile)

    def box(self, place, halo=0.0):
        """Local box of a tile and a halo around it: x low, y low, x high, y high, m."""
        window = self.window(place)
        low = np.array([window.column, window.row]) * self.cell - halo
        high = np.array([window.column, window.row]) * self.cell + self.tile * self.cell + halo
        return (*low.tolist(), *high.tolist())


def corner(low, cell):
    """The cell at which local coordinates begin, for a campaign whose least corner is ``low``.

    In steps of 1024 cells, so that a further file seldom moves it.

    Examples
    --------
    >>> corner((600_123.4, 5_200_045.6, -3.0), 0.5)
    (1200128, 10399744, -1024)
    """
    return tuple(int(k) * 1024 for k in np.floor(np.asarray(low) / (1024 * cell)))


def fitting_tile(boxes, counts, *, cell):
    """Cells along the largest tile, a power of two, that holds a comfortable number of points.

    Parameters
    ----------
    boxes : array, shape (m, 4)
    counts : array, shape (m,)
        Points of each box, taken as spread evenly.
    """
    tile = 2 ** int(np.log2(max(WIDEST_M / cell, 1)))
    while tile * cell > NARROWEST_M and _fullest(boxes, counts, tile * cell) > COMFORTABLE:
        tile //= 2
    return tile


def occupied_tiles(boxes, grid):
    """Return the tiles that the boxes touch, as a sorted list of (i, j)."""
    cells = cells_of(boxes, grid)
    places = set()
    for x_low, y_low, x_high, y_high in (cells // grid.tile).tolist():
        places.update((i, j) for i in range(x_low, x_high + 1) for j in range(y_low, y_high + 1))
    return sorted(places)


def cells_of(boxes, grid):
    """Return the first and last cells of local boxes, shape (m, 4), counted from coordinates' zero.

    Rounded as the points themselves are, so that none falls between two tiles.
    """
    return np.floor(boxes / grid.cell).astype(int) + np.tile(grid.first[:2], 2)


def _tile_ranges(boxes, side):
    return np.floor(boxes / side).astype(int).tolist()


def _fullest(boxes, counts, side):
    """Most points in a tile of this side."""
    sums = {}
    for (x_low, y_low, x_high, y_high), count in zip(
        _tile_ranges(boxes, side), counts, strict=True
    ):
        tiles = (x_high - x_low + 1) * (y_high - y_low + 1)
        for i in range(x_low, x_high + 1):
            for j in range(y_low, y_high + 1):
                sums[i, j] = sums.get((i, j), 0) + count / tiles
    return max(sums.values())
