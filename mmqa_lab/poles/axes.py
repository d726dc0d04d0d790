"""Straight axes through the points of candidates, and circles around them."""

import numpy as np

from mmqa_lab.poles.candidates import SCATTER_M
from mmqa_lab.poles.common import pairs

__all__ = ["circles", "fit_axes"]

MAX_LEAN, WIDEST_M = 0.27, 0.6


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
    centre, radius, rough = circles(a, place, k)
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
        m = np.array([[mean(weight * s * t) for t in terms] for s in terms]).transpose(2, 0, 1)
        m[:, range(3), range(3)] += hold
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
