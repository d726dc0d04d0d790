"""A cloud thinned to the mean point of each voxel, and the part of a cloud near some places."""

from typing import NamedTuple

import numpy as np

from mmqa_lab.cloud import sort_into_cells

__all__ = ["Thin", "around", "thinned"]

VOXEL_M = 0.04
PLACES = ((0, 0, 0, 0), (0.5, 0.5, 0.5, 22), (0.25, 0.75, 0.25, 45), (0.75, 0.25, 0.75, 67))
"""Shifts (voxels) and turns (degrees) of the thinning grid; scores are averaged over them."""

BIN_M, BINS, COARSE_M = 0.25, 64, 0.3
"""Height bins and their number, 16 m in all; side of coarse cells in plan."""


class Thin(NamedTuple):
    """Thinned points (n, 3) up to 16 m above ground, heights (n,), centres of coarse cells, m."""

    points: np.ndarray
    height: np.ndarray
    coarse: np.ndarray


def thinned(points, height_of, place=PLACES[0]):
    """Return the ``Thin`` cloud: the mean point of each voxel, and the centres of coarse cells.

    Points (n, 3) in metres; ``height_of`` gives the ground; ``place`` is one of ``PLACES``.
    """
    if not len(points):
        return Thin(points, points[:, 2], points)
    turn = np.exp(1j * np.radians(place[3]))
    turned = points @ [[turn.real, turn.imag, 0], [-turn.imag, turn.real, 0], [0, 0, 1]]
    turned += VOXEL_M * np.array(place[:3])
    order, starts, _ = sort_into_cells(turned, VOXEL_M)
    sums = [np.add.reduceat(axis[order], starts[:-1]) for axis in points.T]  # no copy of the cloud
    centres = np.column_stack(sums) / np.diff(starts)[:, None]
    height = (centres[:, 2] - height_of(centres)).clip(0, BINS * BIN_M - 1e-6)
    cells = np.column_stack([centres[:, :2], height * (COARSE_M / 0.5)])
    coarse = (sort_into_cells(cells, COARSE_M)[2] + 0.5) * [COARSE_M, COARSE_M, 0.5]
    return Thin(centres, height, coarse)


PLOT_M, TABLE = 1.5, 2**20
"""Side of a plot, not less than the reach of any measure of thinned points; places of a table."""


def around(points, axes):
    """Return the points (n, 3) on the plots of the axes and on those that touch them.

    Plots are looked up by remainders of their numbers, so a few other plots come along.
    """

    def remainder(plot):
        return (plot[..., 0] * 73_856_093 ^ plot[..., 1] * 19_349_663) % TABLE

    steps = np.stack(np.meshgrid(*[(-1, 0, 1)] * 2), axis=-1).reshape(-1, 2)
    wanted = np.zeros(TABLE, bool)
    wanted[remainder(np.floor(axes[:, None, :2] / PLOT_M).astype(np.int64) + steps)] = True
    return points[wanted[remainder(np.floor(points[:, :2] / PLOT_M).astype(np.int64))]]
