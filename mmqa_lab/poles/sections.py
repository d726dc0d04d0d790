"""Diameters of poles with their intervals, and widths of what has none."""

import numpy as np

from mmqa_lab.poles.axes import circles
from mmqa_lab.poles.common import pairs
from mmqa_lab.poles.measures import REACH_M
from mmqa_lab.poles.thinning import around

__all__ = ["sections"]

GROUPS, FEWEST, ROUGH_M, CORNERS, COVERED = 8, 15, 0.03, 3.0, 1.5
"""Height groups that are left out in turn; fewest points and largest misfit of a usable circle;
largest wave of its residuals, four to a turn as those of a square, in standard errors; least width
of what is seen, in radii: a flat face is narrower than its circle."""

SHARE, FLOOR_M = 0.02, 0.002
"""Error of a circle beyond its scatter (taper, bark, split beams): share of the diameter, m."""


def sections(found, kept):
    """Return the size of kept candidates halfway up their run, metres.

    A circle is fitted to the points around each axis. Its interval comes from a jackknife that
    leaves out each of eight height groups in turn.

    Returns
    -------
    dict of array
        ``diameter_m``, ``diameter_low_m``, ``diameter_high_m``, NaN where no circle fits, and for
        square shafts; ``section_m``, the diameter, or the width of what is seen.
    """
    axes, low, high = found.axes[kept], found.shaft["low"][kept], found.shaft["high"][kept]
    core, k = found.measures["core_m"].to_numpy()[kept], kept.sum()
    near = around(found.above, axes)
    a, b = pairs(axes[:, :2], near, REACH_M)
    height = near[b, 2] - found.ground(near[b])
    off = near[b, :2] - axes[a, :2] - axes[a, 2:4] * (height - axes[a, 4])[:, None]
    own = (np.hypot(*off.T) <= core[a]) & (height >= low[a]) & (height < high[a])
    a, off, height = a[own], off[own], height[own]
    part = ((height - low[a]) / (high - low)[a] * GROUPS).astype(np.int64)
    centre, radius, rough = circles(a, off, k, steps=30, hold=1e-3)
    count, spoke = np.maximum(np.bincount(a, minlength=k), 1), (off - centre[a]) @ [1, 1j]
    turned = (np.abs(spoke) - radius[a]) * np.exp(4j * np.angle(spoke))
    wave = np.hypot(*(np.bincount(a, part, k) for part in (turned.real, turned.imag))) / count
    others = [
        circles(a[part != g], off[part != g], k, steps=30, hold=1e-3)[1] for g in range(GROUPS)
    ]
    std = np.sqrt((GROUPS - 1) * np.var(others, axis=0)) * 2
    width = _width(a, off, k)
    told = (count >= FEWEST) & (rough < ROUGH_M) & (width > COVERED * radius)
    told &= 2 * wave < CORNERS * rough * np.sqrt(2 / count)
    half = np.hypot(3 * std, FLOOR_M + SHARE * 2 * radius)
    told &= half < radius
    diameter = np.where(told, 2 * radius, np.nan)
    found = {"diameter_m": diameter, "diameter_low_m": diameter - half}
    found |= {"diameter_high_m": diameter + half}
    return found | {"section_m": np.where(told, diameter, width)}


def _width(a, off, k):
    """Widest extent in plan of the inner 95 % of each candidate's points, of 12 directions."""
    widest, ends = np.zeros(k), np.searchsorted(np.sort(a), np.arange(k + 1))
    count = np.diff(ends)
    for turn in np.arange(12) * np.pi / 12:
        along = off @ [np.cos(turn), np.sin(turn)]
        along = np.append(along[np.lexsort([along, a])], 0.0)
        low, high = (along[ends[:-1] + (share * count).astype(int)] for share in (0.025, 0.975))
        widest = np.maximum(widest, np.where(count > 0, high - low, 0))
    return widest
