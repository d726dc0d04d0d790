"""Points sorted into cubes, and the cubes around a cube."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Cubes:
    """Points in the order of their cubes: by column, in each column from below.

    Parameters
    ----------
    xyz : array, shape (3, n)
        Coordinates, m; within a cube in the order they came in.
    starts : array of int, shape (m + 1,)
        First point of each cube.
    index : array of int, shape (m, 3)
        Place of each cube, in cells from the origin.
    cell : float
        Their side, m.
    wider : array, shape (m, 2)
        How far points that joined a cube lie outside of it, before and behind, m.
    """

    xyz: np.ndarray
    starts: np.ndarray
    index: np.ndarray
    cell: float
    wider: np.ndarray

    @property
    def counts(self):
        """Points in each cube."""
        return np.diff(self.starts)

    def find(self, index):
        """Return the numbers of the cubes at some places, shape (k, 3); -1 where there is none."""
        first = self.index.min(axis=0) - 1
        wide = self.index.max(axis=0) - first + 2
        keys, wanted = _key((self.index - first).T, wide), _key((index - first).T, wide)
        found = np.searchsorted(keys, wanted)
        return np.where(keys[np.minimum(found, len(keys) - 1)] == wanted, found, -1)


def sort_into_cubes(points, cell, *, columns=False):
    """Sort points (n, 3) into cubes of side ``cell``, or into columns of that width.

    Examples
    --------
    >>> cubes = sort_into_cubes(np.array([[0.9, 0, 0], [0.1, 0, 0], [0.2, 0, 0.7]]), 0.5)
    >>> cubes.index.tolist(), cubes.counts.tolist()
    ([[0, 0, 0], [0, 0, 1], [1, 0, 0]], [1, 1, 1])
    """
    xyz = np.ascontiguousarray(points.T)
    index = np.floor(xyz / cell).astype(np.int64)
    if columns:
        index[2] = 0
    first = index.min(axis=1)
    wide = index.max(axis=1) - first + 1
    key = _key(index - first[:, None], wide)
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.append(True, np.diff(key[order]) > 0))
    index = index[:, order[starts]].T.copy()
    starts, wider = np.append(starts, len(order)), np.zeros((len(starts), 2))
    return Cubes(xyz[:, order], starts, index, cell, wider)


def moved(cubes, target, reach):
    """Move the points of cubes to others, whose numbers are in ``target``, shape (m,).

    The cubes that points were moved to become wider by ``reach`` on that side. Where none moves,
    the cubes themselves come back.
    """
    gone = np.flatnonzero(target != np.arange(len(target)))
    if not len(gone):
        return cubes
    number = np.repeat(target, cubes.counts)
    order = np.argsort(number, kind="stable")
    kept = np.unique(target)
    starts = np.append(np.searchsorted(number[order], kept), len(order))
    wider = cubes.wider.copy()
    behind = (cubes.index[gone] > cubes.index[target[gone]]).any(axis=1)
    wider[target[gone], behind.astype(int)] = reach
    return Cubes(cubes.xyz[:, order], starts, cubes.index[kept], cubes.cell, wider[kept])


def join(cubes, with_next):
    """Join cubes with the next ones where the mask, shape (m - 1,), says so.

    Returns
    -------
    Cubes
        The points as they are; ``index`` is that of the lowest cube of each.
    array of int
        Height of the highest cube of each, in cells from the origin.
    """
    first = np.flatnonzero(np.append(True, ~with_next))
    ends = np.append(first[1:], len(cubes.index))
    starts = cubes.starts[np.append(first, len(cubes.index))]
    joined = Cubes(cubes.xyz, starts, cubes.index[first], cubes.cell, cubes.wider[first])
    return joined, cubes.index[ends - 1, 2]


def ranges_around(cubes, low, top, reach):
    """Ranges of points in the cubes up to ``reach`` cubes away from some piles of cubes.

    Parameters
    ----------
    cubes : Cubes
    low : array of int, shape (m, 3)
        The lowest cube of each pile.
    top : array of int, shape (m,)
        The height of its highest cube.
    reach : int

    Returns
    -------
    array of int, shape (m, (2 reach + 1)^2, 2)
        Columns are sorted from below, so each column holds one range.
    """
    first = cubes.index.min(axis=0) - reach
    wide = cubes.index.max(axis=0) - first + 1 + reach
    keys = _key((cubes.index - first).T, wide)
    places, top = low - first, top - first[2]
    steps = np.arange(-reach, reach + 1)
    dx, dy = (step.ravel() for step in np.meshgrid(steps, steps, indexing="ij"))
    column = ((places[:, :1] + dx) * wide[1] + places[:, 1:2] + dy) * wide[2]
    ends = [np.searchsorted(keys, column + places[:, 2:] - reach)]
    ends.append(np.searchsorted(keys, column + top[:, None] + reach, side="right"))
    return cubes.starts[np.stack(ends, axis=2)]


def _key(index, wide):
    """One number per place, shape (3, n) -> (n,): columns in turn, each from below."""
    return (index[0] * wide[1] + index[1]) * wide[2] + index[2]
