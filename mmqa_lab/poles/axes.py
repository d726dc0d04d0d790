"""The diameter and the place of a pole, from chords of scan lines or from circles."""

import numpy as np

from mmqa_lab.planes.regression import algebraic_circle

LEAST_CHORDS = 5
"""That agree; fewer tell no diameter of a shaft."""

TAPERS = np.arange(0, 0.031, 0.003)
"""By how much a shaft may narrow upwards, m/m."""

TAPER_GAIN = 0.01
"""A taper must win one more chord for each so many m/m."""


def shaft_diameter(points, axis_direction, line):
    """Return the diameter halfway up a shaft, from the chords that scan lines cut.

    A ray every ``s`` metres meets a post of diameter d between floor(d / s) and ceil(d / s) times,
    d / s times on average, and the chord from the first to the last hit is one spacing less: the
    diameter is the mean chord plus one ray spacing. A shaft may taper, and what stands in front of
    it or is mounted on it has chords of its own: a straight line of chord over height is sought on
    which the most agree within two spacings. Boards and boxes are wider than their post: the
    narrowest chords that agree, a quarter of all at least, are the shaft's.

    Parameters
    ----------
    points : array, shape (n, 3)
        On the shaft, metres.
    axis_direction : array, shape (3,)
        Unit vector of the axis.
    line : array of int, shape (n,)
        Scan line of each.

    Returns
    -------
    float
        Metres; NaN where fewer than five chords agree.

    Notes
    -----
    Lines with a single hit tell no spacing and are left out, which makes thin, far posts too wide;
    the spacing is the median over lines. A front-facing arc is less wide than the post by less
    than 1 % unless the scanner is nearer than ten radii.

    References
    ----------
    The estimator is ours.
    """
    chords, height, spacing = _chords(points, axis_direction, line)
    best = 0, np.nan
    for taper in TAPERS if len(chords) >= LEAST_CHORDS else ():
        upright = chords + taper * (height - (height.min() + height.max()) / 2)
        ranked = np.sort(upright)
        last = np.searchsorted(ranked, ranked + 2 * spacing, side="right")
        agree = last - np.arange(len(ranked))
        enough = agree >= min(agree.max(), max(2, len(chords) / 4))
        narrow = ranked <= ranked[np.argmax(enough)] + 2 * spacing
        first = np.argmax(np.where(enough & narrow, agree, 0))
        shaft = np.abs(upright - np.median(ranked[first : last[first]])) <= 2 * spacing
        won = agree[first] - taper / TAPER_GAIN
        if won > best[0] and shaft.sum() >= LEAST_CHORDS:
            best = won, upright[shaft].mean() + spacing
    return float(best[1])


def _chords(points, axis_direction, line):
    """Length and height along the axis of each line's chord, and the median ray spacing.

    A chord is measured in the direction in which it and its two neighbours scatter the most: noise
    in depth would turn and lengthen a short one.
    """
    if not len(points):
        return np.empty(0), np.empty(0), np.nan
    centred = points - points.mean(axis=0)
    flat = centred @ (np.eye(3) - np.outer(axis_direction, axis_direction))
    order = np.argsort(line, kind="stable")
    first = np.flatnonzero(np.diff(line[order], prepend=line[order[0]] - 1))
    parts = [part for part in np.split(order, first[1:]) if len(part) >= 2]
    if not parts:
        return np.empty(0), np.empty(0), np.nan
    offs = [flat[part] - flat[part].mean(axis=0) for part in parts]
    scatter = np.pad([off.T @ off for off in offs], ((1, 1), (0, 0), (0, 0)))
    _, axes = np.linalg.eigh(scatter[:-2] + scatter[1:-1] + scatter[2:])
    chords = np.array([np.ptp(off @ wide) for off, wide in zip(offs, axes[:, :, 2], strict=True)])
    height = np.array([(centred[part] @ axis_direction).mean() for part in parts])
    spacing = np.median(chords / [len(part) - 1 for part in parts])
    return chords, height, spacing


def circle_diameter(points, axis_direction, line=None, *, slice_length=0.5, largest=1.0):
    """Return the median diameter of circles fitted to slices across an axis.

    Each slice gets an algebraic circle (Pratt's normalisation is not needed where noise is small
    against the radius); slices with fewer than five points or a circle wider than ``largest``
    metres are left out; scan lines do not matter.

    Returns
    -------
    float
        Metres; NaN where no slice is measurable.

    References
    ----------
    Kasa 1976, IEEE Transactions on Instrumentation and Measurement 25, 8-14,
    doi:10.1109/TIM.1976.6312298.
    """
    if len(points) < 5:
        return np.nan
    centred = points - points.mean(axis=0)
    along = centred @ axis_direction
    u = np.cross(axis_direction, np.eye(3)[np.argmin(np.abs(axis_direction))])
    u /= np.linalg.norm(u)
    plan = centred @ np.stack([u, np.cross(axis_direction, u)], axis=1)
    found = []
    for number in np.unique(np.floor(along / slice_length)):
        part = plan[np.floor(along / slice_length) == number]
        if len(part) >= 5:
            found.append(2 * algebraic_circle(part)[2])
    found = np.array([d for d in found if np.isfinite(d) and d <= largest])
    return float(np.median(found)) if len(found) else np.nan
