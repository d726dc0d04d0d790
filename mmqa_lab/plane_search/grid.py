"""Points sorted into the cubic cells that they occupy, and the cells around each."""

from __future__ import annotations

import numpy as np

from mmqa_lab._compiled import njit
from mmqa_lab.cloud import extent, sort_into_cells

__all__ = ["Grid"]


class Grid:
    """Points sorted into the cubic cells that they occupy.

    ``points`` are relative to their lowest corner ``low`` and in the order of the cells; ``order``
    has their rows in the cloud. ``start`` bounds the cells and ``places`` has their indices.
    """

    def __init__(self, points, edge):
        self.edge, self.low = edge, extent(points)[0]
        points = points - self.low
        self.order, self.start, self.places = sort_into_cells(points, edge)
        self.points = points[self.order]
        # with five more places no cell follows one that it does not touch
        self.shape = self.places.max(axis=0) + 5
        self.keys = np.ravel_multi_index((self.places + 2).T, self.shape)

    def near(self, cells: np.ndarray, reach: int) -> np.ndarray:
        """Runs (first, last + 1) of cells within ``reach`` of ascending cells, (n, columns, 2)."""
        side = np.arange(-reach, reach + 1)
        column = (side[:, None] * self.shape[1] + side).ravel() * self.shape[2]
        runs = np.empty((len(cells), len(column), 2), np.int32)
        _find_runs(self.keys, cells, column, reach, runs)
        return runs


@njit(cache=True)
def _find_runs(keys, cells, column, reach, runs):
    """Write the cells with keys within ``reach`` of each cell's key and what leads to a column."""
    for j in range(len(column)):
        first, last = 0, 0
        for k in range(len(cells)):
            middle = keys[cells[k]] + column[j]
            while first < len(keys) and keys[first] < middle - reach:
                first += 1
            while last < len(keys) and keys[last] <= middle + reach:
                last += 1
            runs[k, j, 0], runs[k, j, 1] = first, last
