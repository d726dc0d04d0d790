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


def remarks_on(waves, clipped):
    """What is said about a star."""
    faintest = np.abs(waves).min() / np.median(np.abs(waves))
    hidden = f"a part of the star is hidden: contrast {faintest:.0%} of the others'"
    clips = f"{clipped} is clipped: MTF50 is too high"
    return tuple(sentences((faintest < SEEN_SHARE, hidden), (clipped, clips)))


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
