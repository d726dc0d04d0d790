"""The diameter of a pole, from chords of scan lines or from circles."""

import numpy as np


def chord_diameter(points, axis_direction, line, *, minimum_points=2):
    """Return the diameter from the chords that scan lines cut: mean chord plus one ray spacing.

    A ray every ``s`` metres meets a post of diameter d between floor(d / s) and ceil(d / s) times,
    d / s times on average, and the chord from the first to the last hit is one spacing less.

    Parameters
    ----------
    points : array, shape (n, 3)
        On the shaft, metres.
    axis_direction : array, shape (3,)
        Unit vector of the axis.
    line : array of int, shape (n,)
        Scan line of each.
    minimum_points : int
        Lines with fewer hits do not count.

    Returns
    -------
    float
        Metres; NaN where no line has enough hits.

    Notes
    -----
    Lines with a single hit tell no spacing and are left out, which makes thin, far posts too wide;
    the spacing is the median over lines. A front-facing arc is less wide than the post by less
    than 1 % unless the scanner is nearer than ten radii.

    References
    ----------
    The estimator is ours.
    """
    from scipy.stats import median_abs_deviation

    if not len(points):
        return np.nan
    cross = np.eye(3) - np.outer(axis_direction, axis_direction)
    flat = (points - points.mean(axis=0)) @ cross
    order = np.argsort(line, kind="stable")
    first = np.flatnonzero(np.diff(line[order], prepend=line[order[0]] - 1))
    chords, spacings = [], []
    for part in np.split(flat[order], first[1:]):
        if len(part) >= minimum_points:
            wide = np.linalg.svd(part - part.mean(axis=0), full_matrices=False)[2][0]
            chords.append(np.ptp(part @ wide))
            spacings.append(chords[-1] / (len(part) - 1))
    if not chords:
        return np.nan
    chords, spacing = np.array(chords), np.median(spacings)
    # a board or a branch widens some chords: the narrow quarter says what the shaft may be
    chords = chords[chords <= 1.5 * np.quantile(chords, 0.25) + 2 * spacing]
    spread = 3 * max(median_abs_deviation(chords, scale="normal"), spacing)
    usual = np.abs(chords - np.median(chords)) <= spread
    return float(chords[usual].mean() + spacing)


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
            found.append(_kasa(part))
    found = np.array([d for d in found if np.isfinite(d) and d <= largest])
    return float(np.median(found)) if len(found) else np.nan


def _kasa(xy):
    """Diameter of the circle with the least algebraic distance."""
    design = np.column_stack([xy, np.ones(len(xy))])
    (a, b, c), *_ = np.linalg.lstsq(design, (xy**2).sum(axis=1), rcond=None)
    return 2 * np.sqrt(max(c + a**2 / 4 + b**2 / 4, 0.0))
