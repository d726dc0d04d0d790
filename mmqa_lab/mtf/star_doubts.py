"""What speaks against a star."""

from __future__ import annotations

import numpy as np

from mmqa_lab._results import sentences
from mmqa_lab.mtf.edge_doubts import CUT

__all__ = ["STAR_PARTS", "check_cycles", "clipped_side", "remarks_on"]
__dir__ = __all__.copy

STAR_PARTS, LARGEST_DRIFT, SEEN_SHARE = 12, 1.5, 0.7
"""Parts of the circle in which the outer wave is compared: its phase may differ by so many radians,
and its contrast in a part that is not hidden is at least this share of the others'."""

UNLIKE, SQUARE, SHARPENED = 0.06, 0.6, 0.025
"""Share of a wave of twice the cycles; least share of the one of three times that square sectors
have; contrast above that of the best lens: beyond them it is said."""


def remarks_on(waves, clipped, harmonics, transfers, beyond):
    """What is said about a star.

    ``harmonics``: waves of twice and three times the cycles near the outline over the star's own;
    ``transfers``: what the lens leaves of them; ``beyond``: contrast above that of any lens.
    """
    faintest = np.abs(waves).min() / np.median(np.abs(waves))
    hidden = f"a part of the star is hidden: contrast {faintest:.0%} of the others'"
    clips = f"{clipped} is clipped: MTF50 is too high"
    unlike = harmonics[0] > UNLIKE * transfers[0]
    round_ = transfers[1] > 0.15 and harmonics[1] < transfers[1] / 3 * SQUARE
    said = sentences(
        (faintest < SEEN_SHARE, hidden),
        (clipped, clips),
        (beyond > SHARPENED, "sharpened: no lens transfers so much"),
        (unlike and not clipped, "dark and bright sectors are unlike: MTF50 is too low"),
        (round_, "sectors have no plain middle, as of a sinusoidal star: MTF50 is too low"),
    )
    return tuple(said)


def clipped_side(black, white):
    """Which side's pixels share one value though the other side's have noise; empty if neither."""
    least = CUT / 10 * (white.mean() - black.mean())
    both = ("black", black, np.min, white), ("white", white, np.max, black)
    for name, side, end, other in both:
        piled = np.mean(side == end(side)) > 0.1
        if piled and (side.std() > 5 * least or other.std() > max(4 * side.std(), least)):
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
