"""What speaks against an edge, and against a star."""

from __future__ import annotations

import numpy as np

from mmqa_lab._checks import refuse
from mmqa_lab._results import NORMAL, sentences
from mmqa_lab.mtf.transfer import BINS_PER_PIXEL, COARSE, profile, spread_edge

__all__ = [
    "CUT", "STAR_PARTS", "TAILED", "check", "check_cycles", "clipped_side", "remarks_on",
    "remarks_on_star",
]  # fmt: skip


EDGE_BLOCKS = 8
"""Parts of an edge that are compared with its line."""

SMALLEST_ANGLE_DEG = 3.0

CROOKED, TORN = 0.12, 0.5
"""Deviations of the edge from its line over the width of the edge: remark, and refusal. At a tenth
MTF50 is half a per cent too low, at a half an eighth."""

OTHER_STEP, OTHER_EDGE = 0.03, 0.25
"""A second step beside the edge over the first one: remark, and refusal."""

OVERSHOOT, LOBE_BINS = 0.006, (4, 8, 12, 16)
"""Of both sides of a profile, over the step: only sharpening gives that; bins that are averaged."""

COMPRESSED = 0.012
"""Noise beside the edge, over the step, that is not far from it."""

CUT, ONE_SIDED = 0.005, 0.025
"""Share of the step by which the two halves of a profile differ where one is clipped; and where
something else is on one side."""

NOISY = 0.03
"""Half an interval of MTF50, as a share of it, from which it is said, as of noise or few phases."""

ODD_SIDES = "the profile is not alike on both sides, as beside a second edge"

STAR_PARTS, LARGEST_DRIFT, SEEN_SHARE = 12, 1.5, 0.7
"""Parts of the circle in which the outer wave is compared: its phase may differ by so many radians,
and its contrast in a part that is not hidden is at least this share of the others'."""

ADDED, TAILED, OPPOSED = -0.3, 0.08, -0.02
"""Share of light that only sharpening moves from a lens's tails into its middle; error of a star
behind tails, of which its sectors do not show the levels; correlation of the noise of neighbouring
pixels that only sharpening makes so low."""

UNLIKE, SQUARE, SHARPENED, BENT_PHASE = 0.06, 0.6, 0.025, 0.02
"""Share of a wave of twice the cycles; least share of the one of three times that square sectors
have; contrast above that of the best lens; radians by which the wave is behind on one side and
ahead on the other: beyond them it is said."""


def check(fit):
    """Raise if there is no edge, or more than one."""
    step = f"a step of {fit.step:.3g} at a noise of {fit.grain * fit.step:.3g}"
    refuse(not np.sqrt(fit.length) > 8 * fit.grain, "edge", step, "one that stands out")
    bent = bend(fit)
    leaves = f"it leaves a straight line by {bent:.0%} of its width"
    refuse(bent > TORN, "edge", leaves, "straight, neither bent nor torn")
    strange = strangeness(fit)
    several = strange > OTHER_EDGE and overshoot(fit) <= OVERSHOOT
    leaves = f"the profile leaves a single step by {strange:.0%} of it"
    refuse(several, "edge", leaves, "one edge between two plain sides")


def remarks_on(fit, mtf50, sigma, turn, by_sigmoid):
    """Return what is said about an edge, whose MTF50 has that standard deviation."""
    cut = [side for side, sign in (("white", 1), ("black", -1)) if clipped(fit, sign)]
    bent, second = bend(fit), max(second_step(fit, -1), second_step(fit, 1))
    alone = not cut and second <= OTHER_STEP
    along_grid = f"edge within {SMALLEST_ANGLE_DEG:g} degrees of the pixel grid"
    levels = f"{1 / fit.rounding:.0f} grey values in the step and no noise"
    known = NORMAL * sigma / mtf50
    loose = f"MTF50 may be off by {known:.0%}, as its interval says"
    rings = f"noise of {fit.ringing:.1%} beside the edge alone, as of compression: MTF50 may be"
    rings += f" off by {4 * fit.ringing:.0%}"
    said = sentences(
        (not np.isfinite(mtf50), "MTF stays above 0.5"),
        (turn < SMALLEST_ANGLE_DEG, along_grid),
        (by_sigmoid and strangeness(fit) > 0.02, "no sigmoid of this shape fits"),
        (overshoot(fit) > OVERSHOOT, "sharpened"),
        *((True, f"{side} is clipped: MTF50 is too high") for side in cut),
        (bent > CROOKED, f"not straight by {bent:.0%} of its width: MTF50 is too low"),
        (second > OTHER_STEP, f"a second edge of {second:.0%} of the step"),
        (alone and one_sided(fit) > ONE_SIDED, ODD_SIDES),
        (fit.rounding * fit.rounded_alike > COARSE, f"{levels}: MTF50 may be a tenth too high"),
        (alone and fit.ringing > COMPRESSED, rings),
        (known > NOISY and fit.ringing <= COMPRESSED, loose),
        (fit.hot > 0, f"{fit.hot} odd pixels left out"),
    )
    return tuple(said)


def strangeness(fit):
    """Return the largest share of the step by which the binned profile leaves the sigmoid."""
    _, means, count, _ = profile(fit.distance, fit.residuals)
    return float((np.abs(means) - 4 * fit.grain / np.sqrt(count)).max())


def bend(fit):
    """Largest standard deviation of the edge's place in parts of its length, over its width.

    What noise gives, and four standard deviations of that, is taken off.
    """
    places, means, *_ = fit.bins
    left = fit.values - np.interp(fit.distance, places, means)
    far = np.abs(fit.distance) > 4 * fit.spread + 2
    noise = np.var(left[far] if far.any() else left)
    slope = np.exp(-((fit.distance / fit.spread) ** 2) / 2) / (np.sqrt(2 * np.pi) * fit.spread)
    found = 0.0
    for size in (1, 4, max(fit.length / EDGE_BLOCKS, 5)):
        part = ((fit.along - fit.along.min()) / size).astype(int)
        weight = np.bincount(part, slope**2)
        shift = np.bincount(part, slope * left) / np.maximum(weight, 1e-12)
        full = np.flatnonzero(weight > np.median(weight) / 2)
        if len(full) < 4:
            continue
        shift = shift[full] - np.polyval(np.polyfit(full, shift[full], 1), full)
        by_noise = np.mean(noise / weight[full]) * (1 + 4 * np.sqrt(2 / len(full)))
        found = max(found, (shift @ shift) / (len(full) - 2) - by_noise)
    return float(np.sqrt(found) / fit.spread)


def second_step(fit, side):
    """Return the largest step on one side of the edge that stands out, over the edge's own.

    The side's level, slope and the long tail of a lens, which falls with the inverse of the
    distance, are estimated with it.
    """
    places, means, count, _ = fit.bins
    beside = places * side > 3 * fit.spread + 2
    far = places[beside] * side
    weight = np.sqrt(count[beside]) / max(fit.grain, 1e-9)
    if len(far) < 4 * BINS_PER_PIXEL:
        return 0.0
    plain = np.column_stack([np.ones_like(far), 1 / far, far]) * weight[:, None]
    beyond = (far[:, None] > np.arange(far.min() + 2, far.max() - 2, 0.5)) * weight[:, None]
    basis, seen = np.linalg.qr(plain)[0], weight * means[beside]
    beyond = beyond - basis @ (basis.T @ beyond)
    square = np.square(beyond).sum(axis=0)
    steps = np.abs(beyond.T @ seen) / square  # of least squares, beside the plain side
    return float(steps[steps**2 * square > 25].max(initial=0))


def clipped(fit, side):
    """Whether one side is cut off: its pixels share a value, and the profile is one-sided."""
    beside = side * fit.grey[side * fit.distance > 4 * fit.spread + 1]
    levels = np.unique(side * fit.grey)[-2:]
    if len(levels) < 2 or np.mean(beside == levels[1]) < 0.1:
        return False
    # noise on one side of a wall
    noisy = beside.std() > max(np.diff(levels)[0], CUT / 2)
    return noisy or one_sided(fit) > CUT + fit.rounding / 2


def one_sided(fit):
    """By how much both halves of the profile differ, over the step, less what noise gives."""
    places, share, noise = _shares(fit)
    # between places the sigmoid tells how the profile is bent
    left = share - spread_edge(places, fit.width, fit.angle)
    reach = np.linspace(0, min(4 * fit.spread + 1, -places[0], places[-1]), 60)
    middle = np.linspace(-0.6, 0.6, 61)[:, None] * fit.spread
    halves = -1.0
    for there in (middle + reach, middle - reach):
        halves = halves + spread_edge(there, fit.width, fit.angle) + np.interp(there, places, left)
    least = np.sqrt(np.square(halves).mean(axis=1)).min()
    return float(np.sqrt(max(least**2 - (1.3 * noise) ** 2, 0)))


def overshoot(fit):
    """By how much both sides pass their levels where it is more than noise, over the step."""
    places, share, noise = _shares(fit)
    end, found = min(3 * fit.spread + 6, -places[0], places[-1]), 0.0
    reach = np.arange(0, end, 1 / BINS_PER_PIXEL)
    past = [sign * np.interp(sign * reach, places, share - (sign > 0)) for sign in (-1, 1)]
    for bins in LOBE_BINS:
        sides = np.stack([np.convolve(one, np.full(bins, 1 / bins), "valid") for one in past])
        mean = sides.mean(axis=0) - fit.rounding / 2
        clear = (mean > 4 * noise / np.sqrt(2 * bins)) & (sides.min(axis=0) > mean / 4)
        found = max(found, float(mean[clear].max(initial=0)))
    return found


def _shares(fit):
    """Profile between the levels of both sides as 0 and 1, and the noise of a place."""
    places, means, count, _ = fit.bins
    far = 4 * fit.spread + 1
    sides = [fit.values[way * fit.distance > far] for way in (-1, 1)]
    low, high = (np.median(one) if len(one) else k for k, one in enumerate(sides))
    return places, (means - low) / (high - low), fit.grain / np.sqrt(np.median(count))


def remarks_on_star(waves, clipped, harmonics, transfers, beyond, tail, alike):
    """Return what is said about a star.

    ``harmonics``: waves of twice and three times the cycles near the outline over the star's own;
    ``transfers``: what the lens leaves of them; ``beyond``: contrast above that of any lens;
    ``tail``: share of light in a lens's tail, below zero what sharpening adds; ``alike``:
    correlation of the noise of neighbouring pixels, and of how many pairs.
    """
    faintest = np.abs(waves).min() / np.median(np.abs(waves))
    hidden = f"a part of the star is hidden: contrast {faintest:.0%} of the others'"
    clips = f"{clipped} is clipped: MTF50 is too high"
    bent = "sectors are bent, as by a lens: MTF50 may be off by some per cent"
    unlike = harmonics[0] > UNLIKE * transfers[0]
    round_ = transfers[1] > 0.15 and harmonics[1] < transfers[1] / 3 * SQUARE
    by_noise = alike[0] < OPPOSED - 3 / np.sqrt(alike[1])
    tails = f"{tail:.0%} of the light are in the tails of the lens: MTF50 may be off by"
    said = sentences(
        (faintest < SEEN_SHARE, hidden),
        (faintest >= SEEN_SHARE and _lag(waves) > BENT_PHASE, bent),
        (clipped, clips),
        (beyond > SHARPENED or tail < ADDED or by_noise, "sharpened: no lens transfers so much"),
        (tail > 0, f"{tails} {TAILED:.0%}"),
        (unlike and not clipped, "dark and bright sectors are unlike: MTF50 is too low"),
        (round_, "sectors have no plain middle, as of a sinusoidal star: MTF50 is too low"),
    )
    return tuple(said)


def _lag(waves):
    """Wave of one turn in the phases around the circle, which a lens off its axis gives."""
    if len(waves) < STAR_PARTS:
        return 0.0
    phase = np.angle(waves * np.conj(waves.sum()))
    return float(np.abs(np.fft.fft(phase)[1])) * 2 / STAR_PARTS


def clipped_side(black, white, rounding=0.0):
    """Which side's pixels share one value though the other side's have noise; empty if neither.

    Noise is what is more than ``rounding``, the distance of grey values.
    """
    step = white.mean() - black.mean()
    least, noisy = max(CUT / 10 * step, rounding), max(CUT / 2 * step, rounding)
    both = ("black", black, np.min, white), ("white", white, np.max, black)
    for name, side, end, other in both:
        piled = np.mean(side == end(side)) > 0.1
        if piled and (side.std() > noisy or other.std() > max(4 * side.std(), least)):
            return name
    return ""


def check_cycles(waves, n):
    """Raise where the wave's phase turns around the circle: it has another number of cycles."""
    seen_well = np.abs(waves) > np.median(np.abs(waves)) / 2
    phase = np.unwrap(np.angle(waves[seen_well]))
    if np.ptp(phase) > LARGEST_DRIFT:
        slope = np.polyfit(np.arange(len(phase)), phase, 1)[0]
        seen = n + round(slope * STAR_PARTS / (2 * np.pi))
        shows = f"it shows about {seen}" if seen != n else "its wave is not regular"
        raise ValueError(f"Invalid star of {n} cycles: {shows}. Must have the cycles stated.")
