"""Candidates: columns of points with nothing around them, their straight axes and circles."""

import numpy as np
from scipy import ndimage

from mmqa_lab._compiled import njit
from mmqa_lab.poles.common import BIN_M, BINS, pairs

__all__ = ["candidates", "circles", "fit_axes"]


MAX_LEAN, WIDEST_M = 0.27, 0.6

GRID_M = 0.1
"""Plan cells of candidates."""

SCALES = ((1, 4), (2, 5), (4, 7), (1, 0))
"""Half width of the core and of the ring around it, in cells; a ring of 0 is not tested."""

SCATTER_M, WIDEST = (0.25, 0.06), 4
"""Scatter about the axis on the widest and on all other scales, m; core of the widest, cells."""

TILE, MARGIN = 200, 12
SIDE = TILE + 2 * MARGIN
"""Cells along the side of a tile, few enough for a processor's cache, with what counts beside it.
"""


def fit_axes(thin, xy, scatter):
    """Return robust straight axes (k, 5): place (x, y), lean (x, y), height of the place; m, m/m.

    Reweighted least squares of the points within 0.5 m, with Geman-McClure weights whose scale
    shrinks from 0.15 to 0.06 m. A prior of 1 m2 draws leans towards 0. On the widest scale, if the
    points within 0.65 m lie on a circle, the axis stands upright in its centre.
    """
    a, b = pairs(xy, thin.points, 0.65)
    away = np.hypot(*(thin.points[b, :2] - xy[a]).T)
    near = (away < 0.5) | (scatter[a] > SCATTER_M[1])
    a, b, k = a[near], b[near], len(xy)
    sums = lambda values: np.bincount(a, values, k)  # noqa: E731
    height = thin.height[b]
    middle = sums(height) / np.maximum(np.bincount(a, minlength=k), 1)
    rise, place = height - middle[a], thin.points[b, :2] - xy[a]
    axes = np.zeros((k, 4))
    for scale in (0.15, 0.13, 0.11, 0.09, 0.075, 0.06, 0.06, 0.06):
        off = place - axes[a, :2] - axes[a, 2:] * rise[:, None]
        w = (1 + (off**2).sum(axis=1) / np.maximum(scale, scatter[a]) ** 2) ** -2.0
        w0, w1, w2 = sums(w) + 1e-9, sums(w * rise), sums(w * rise**2) + 1.0
        det = w0 * w2 - w1**2
        for i in (0, 1):
            s, t = sums(w * place[:, i]), sums(w * rise * place[:, i])
            axes[:, i], axes[:, 2 + i] = (w2 * s - w1 * t) / det, (w0 * t - w1 * s) / det
        axes[:, 2:] = axes[:, 2:].clip(-MAX_LEAN, MAX_LEAN)
    own = scatter[a] > SCATTER_M[1]
    centre, radius, rough = circles(a[own], place[own], k)
    wide = (scatter > SCATTER_M[1]) & (radius > 0.25) & (rough < 0.18 * radius)
    axes[wide] = np.column_stack([centre, 0 * centre])[wide]
    return np.column_stack([xy + axes[:, :2], axes[:, 2:], middle])


def circles(a, off, k, steps=5, hold=0.02):
    """Centre, radius and misfit of the circle through the points of each of k candidates.

    An algebraic circle (Kasa), then robust Gauss-Newton steps.
    """
    n = np.maximum(np.bincount(a, minlength=k), 1)
    mean = lambda values: np.bincount(a, values, k) / n  # noqa: E731

    def solved(terms, right, weight, hold):
        """Coefficients (k, 3) of the terms by weighted and damped least squares."""
        m = np.empty((k, 3, 3))
        for i, j in zip(*np.triu_indices(3), strict=True):
            m[:, i, j] = m[:, j, i] = mean(weight * terms[i] * terms[j]) + hold * (i == j)
        sums = np.stack([mean(weight * s * right) for s in terms], -1)
        return np.linalg.solve(m, sums[..., None])[..., 0]

    middle = np.column_stack([mean(c) for c in off.T])
    x, y = (off - middle[a]).T
    one, square = np.ones(len(x)), x * x + y * y
    centre = solved((one, x, y), square, one, 1e-6)[:, 1:] / 2  # the steps below correct its bias
    centre /= np.maximum(np.hypot(*centre.T) / WIDEST_M, 1)[:, None]
    r = np.sqrt(mean(square) + (centre**2).sum(axis=1))
    for _ in range(steps):
        u, v = x - centre[a, 0], y - centre[a, 1]
        d = np.maximum(np.hypot(u, v), 1e-6)
        e = d - r[a]
        step = solved((one, u / d, v / d), e, 1 / (1 + (e / 0.03) ** 2) ** 2, hold)
        r, centre = np.clip(r + step[:, 0], 0.01, WIDEST_M), centre + step[:, 1:]
    e = np.hypot(x - centre[a, 0], y - centre[a, 1]) - r[a]
    rough = np.minimum(np.sqrt(mean(e * e)), np.sqrt(np.maximum(mean(square), 1e-9)))
    return middle + centre, r, rough


def candidates(thin):
    """Return plan places (k, 2) and the scatter of points about the axis (k,), metres.

    On one of four scales a place is a local maximum of the count of clean height bins: bins with
    points in the core and an empty ring.
    """
    cell = np.floor(thin.points[:, :2] / GRID_M).astype(np.int64)
    low = cell.min(axis=0)
    x, y = (cell - low).T
    rows = np.unique((x << 37) + (y << 6) + (thin.height / BIN_M).astype(np.int64))
    x, y, level = rows >> 37, (rows >> 6) % 2**31, np.uint64(1) << (rows % BINS).astype(np.uint64)
    tiles = np.unique((x // TILE << 31) + y // TILE)
    found = []
    for corner in np.column_stack([tiles >> 31, tiles % 2**31]) * TILE - MARGIN:
        own = slice(*np.searchsorted(x, corner[0] + [0, SIDE]))
        place = x[own] - corner[0], y[own] - corner[1]
        inside = (place[1] >= 0) & (place[1] < SIDE)
        bits = np.zeros((SIDE, SIDE), np.uint64)
        np.add.at(bits, tuple(p[inside] for p in place), level[own][inside])  # unique: sum = union
        found.append(_tops(bits) + [*corner + low, 0])
    found = np.unique(np.concatenate(found), axis=0)
    return (found[:, :2] + 0.5) * GRID_M, np.where(found[:, 2], *SCATTER_M)


@njit(cache=True)
def _clean(bits, core, ring, out):
    """Number of bins with points in the core and none on the two outermost squares of the ring."""
    n, edge, none = len(bits), max(core, ring), np.uint64(0)
    along = np.zeros_like(bits)
    for k in range(-core, core + 1):
        for i in range(n):
            for j in range(core, n - core):
                along[i, j] |= bits[i, j + k]
    for i in range(edge, n - edge):
        for j in range(edge, n - edge):
            out[i, j], clean = 0, none
            if bits[i, j] != none or core == WIDEST:  # a wide shaft seen from all sides is hollow
                for k in range(-core, core + 1):
                    clean |= along[i + k, j]
            for half in range(max(ring - 1, 1), ring + 1):
                for k in range(-half, half + 1):
                    if clean == none:
                        break
                    side = bits[i + k, j - half] | bits[i + k, j + half]
                    clean &= ~(side | bits[i - half, j + k] | bits[i + half, j + k])
            while clean != none:
                clean &= clean - np.uint64(1)
                out[i, j] += 1


def _tops(bits):
    """Local maxima of clean bins in a tile: row, column, and 1 on the widest scale, else 0."""
    held = np.bitwise_count(bits).astype(np.float32)
    found = np.zeros((*bits.shape, 2), bool)
    value = np.zeros_like(held)
    for core, ring in SCALES:
        _clean(bits, core, ring, value)
        if core == WIDEST:
            more = 80 * ndimage.gaussian_filter(held, 3.5, truncate=2.0)
        else:
            box = 2 * core + 1
            more = 4 * held + ndimage.uniform_filter(held, box) * box**2
        tall = np.where(value >= 3, value + more / (more + 50), 0)
        size = 2 * max(core + 1, 3) + 1
        found[..., int(core == WIDEST)] |= (tall > 0) & (tall == ndimage.maximum_filter(tall, size))
    found[:MARGIN] = found[-MARGIN:] = found[:, :MARGIN] = found[:, -MARGIN:] = False
    return np.argwhere(found)
