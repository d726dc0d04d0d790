"""What speaks against an edge."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator

from mmqa_lab._checks import refuse
from mmqa_lab._results import sentences
from mmqa_lab.mtf.edge_bins import BINS_PER_PIXEL, profile

__all__ = ["CUT", "check", "remark_on"]
__dir__ = __all__.copy

EDGE_BLOCKS = 8
"""Parts of an edge that are compared with its line."""

SMALLEST_ANGLE_DEG = 3.0

CROOKED, TORN = 0.12, 0.5
"""Deviations of the edge from its line over the width of the edge: remark, and refusal. At a tenth
MTF50 is half a per cent too low, at a half an eighth."""

OTHER_STEP, OTHER_EDGE = 0.03, 0.25
"""A second step beside the edge over the first one: remark, and refusal."""

OVERSHOOT, LOBE_BINS = 0.01, (4, 8, 12, 16)
"""Of both sides of a profile, over the step: only sharpening gives that; bins that are averaged."""

CUT, ONE_SIDED = 0.005, 0.025
"""Share of the step by which the two halves of a profile differ where one is clipped; and where
something else is on one side."""

ODD_SIDES = "the profile is not alike on both sides, as beside a second edge"


def remark_on(fit, turn, mtf50, crooked, second, by_sigmoid):
    """What is said about an edge; empty if nothing is."""
    cut = [side for side, sign in (("white", 1), ("black", -1)) if clipped(fit, sign)]
    alone = not cut and second <= OTHER_STEP
    said = sentences(
        (not np.isfinite(mtf50), "MTF stays above 0.5"),
        (
            turn < SMALLEST_ANGLE_DEG,
            f"edge within {SMALLEST_ANGLE_DEG:g} degrees of the pixel grid",
        ),
        (by_sigmoid and strangeness(fit) > 0.02, "no sigmoid of this shape fits"),
        (overshoot(fit) > OVERSHOOT, "sharpened"),
        *((True, f"{side} is clipped: MTF50 is too high") for side in cut),
        (crooked > CROOKED, f"not straight by {crooked:.0%} of its width: MTF50 is too low"),
        (second > OTHER_STEP, f"a second edge of {second:.0%} of the step"),
        (alone and one_sided(fit) > ONE_SIDED, ODD_SIDES),
    )
    return "; ".join(said)


def strangeness(fit):
    """Largest share of the step by which the binned profile leaves the sigmoid."""
    _, means, count, _ = profile(fit.distance, fit.residuals)
    return float((np.abs(means) - 4 * fit.noise / np.sqrt(count)).max() / fit.contrast)


def check(fit, rows, columns):
    """Raise if there is no edge, or more than one; how crooked it is, and a second step."""
    faint = not fit.contrast * np.sqrt(rows) > 8 * fit.noise
    step = f"a step of {fit.contrast:.3g} at a noise of {fit.noise:.3g}"
    refuse(faint, "edge", step, "one that stands out")
    row = fit.rows // columns
    crooked = max(bend(fit, row // size) for size in (1, 4, max(rows // EDGE_BLOCKS, 5)))
    leaves = f"it leaves a straight line by {crooked:.0%} of its width"
    refuse(crooked > TORN, "edge", leaves, "straight, neither bent nor torn")
    strange = strangeness(fit)
    several = strange > OTHER_EDGE and overshoot(fit) <= OVERSHOOT
    leaves = f"the profile leaves a single step by {strange:.0%} of it"
    refuse(several, "edge", leaves, "one edge between two plain sides")
    return crooked, max(second_step(fit, -1), second_step(fit, 1))


def bend(fit, part):
    """Standard deviation of the edge's place in parts of its length over its width.

    What noise gives, and four standard deviations of that, is taken off.
    """
    left = fit.values - np.interp(fit.distance, fit.places, fit.means)
    noise = np.var(left[np.abs(fit.distance) > 4 * fit.spread + 2])
    slope = np.exp(-((fit.distance / fit.spread) ** 2) / 2)
    slope *= fit.contrast / (np.sqrt(2 * np.pi) * fit.spread)
    weight = np.bincount(part, slope**2)
    shift = np.bincount(part, slope * left) / np.maximum(weight, 1e-12)
    full = np.flatnonzero(weight > np.median(weight) / 2)
    if len(full) < 4:
        return 0.0
    shift = shift[full] - np.polyval(np.polyfit(full, shift[full], 1), full)
    by_noise = np.mean(noise / weight[full]) * (1 + 4 * np.sqrt(2 / len(full)))
    return float(np.sqrt(max((shift @ shift) / (len(full) - 2) - by_noise, 0)) / fit.spread)


def second_step(fit, side):
    """Largest step on one side of the edge that stands out, over the edge's own.

    The side's level, slope and the long tail of a lens, which falls with the inverse of the
    distance, are estimated with it.
    """
    beside = fit.places * side > 3 * fit.spread + 2
    far = fit.places[beside] * side
    weight = np.sqrt(fit.count[beside]) / max(fit.noise, 1e-9)
    if len(far) < 4 * BINS_PER_PIXEL:
        return 0.0
    plain = np.column_stack([np.ones_like(far), 1 / far, far]) * weight[:, None]
    beyond = (far[:, None] > np.arange(far.min() + 2, far.max() - 2, 0.5)) * weight[:, None]
    basis, seen = np.linalg.qr(plain)[0], weight * fit.means[beside]
    beyond = beyond - basis @ (basis.T @ beyond)
    square = np.square(beyond).sum(axis=0)
    steps = np.abs(beyond.T @ seen) / square  # of least squares, beside the plain side
    return float(steps[steps**2 * square > 25].max(initial=0) / fit.contrast)


def clipped(fit, side):
    """Whether one side is cut off: its pixels share a value, and the profile is one-sided."""
    beside = side * fit.values[side * fit.distance > 4 * fit.spread + 1]
    levels = np.unique(side * fit.values)[-2:]
    if len(levels) < 2 or np.mean(beside == levels[1]) < 0.1:
        return False
    # noise on one side of a wall
    noisy = beside.std() > max(np.diff(levels)[0], CUT / 2 * fit.contrast)
    return noisy or one_sided(fit) > CUT


def one_sided(fit):
    """By how much both halves of the profile differ, over the step, less what noise gives."""
    share, noise = fit.shares()
    reach = np.linspace(0, 4 * fit.spread + 1, 60)
    middle = np.linspace(-0.6, 0.6, 61)[:, None] * fit.spread
    curve = PchipInterpolator(fit.places, share)
    halves = curve(middle + reach) + curve(middle - reach) - 1
    least = np.sqrt(np.square(halves).mean(axis=1)).min()
    return float(np.sqrt(max(least**2 - (1.3 * noise) ** 2, 0)))


def overshoot(fit):
    """By how much both sides pass their levels where it is more than noise, over the step."""
    share, noise = fit.shares()
    end, found = min(3 * fit.spread + 6, -fit.places[0], fit.places[-1]), 0.0
    reach = np.arange(0, end, 1 / BINS_PER_PIXEL)
    past = [sign * np.interp(sign * reach, fit.places, share - (sign > 0)) for sign in (-1, 1)]
    for bins in LOBE_BINS:
        sides = np.stack([np.convolve(one, np.full(bins, 1 / bins), "valid") for one in past])
        mean = sides.mean(axis=0)
        clear = (mean > 4 * noise / np.sqrt(2 * bins)) & (sides.min(axis=0) > mean / 4)
        found = max(found, float(mean[clear].max(initial=0)))
    return found
