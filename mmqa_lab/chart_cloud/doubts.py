"""What speaks against the figures of a selection of points, and which part of it stands off."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab._results import sentences
from mmqa_lab.planes import checked_plane, sigma_mad
from mmqa_lab.spacing.directions import FEWEST_POINTS, block_numbers
from mmqa_lab.spacing.empty import space_within

__all__ = [
    "is_below_step", "is_coarse", "of_copies", "of_pairs", "of_steps", "of_turns", "part_off",
    "remarks_on",
]  # fmt: skip


LAYER_ERRORS = 4.0
"""Errors of a count by which the dip between two layers is deeper than by chance."""

GAP_PLACES, EMPTY_MEDIANS, EMPTY_SHARE = 2000, 4.0, 0.02
"""Places of an outline; one is empty if its nearest point is farther than so many medians of all
(of random points one in 70,000, of lines none); the share of empty places that gets a remark."""

ALIKE = 1.1
"""Ratio of the two largest variances below which the principal axes have a random direction."""

FAR_QUANTILES = 3.0
"""Points farther than this many 90 % quantiles of all distances get a remark."""

PAIRS = 5.0
"""Points come in pairs if d2 / d1 is larger. It is 1.7 for random points and 2 on lines."""

COARSE_MM, DIGIT_LESS = 1e-3, 4.0
"""Smaller steps of coordinates are never too coarse; ratio from which those of an axis count."""

FULL = 1.5
"""Ratio of a polygon's area to the hull of its points above which a remark is given."""

DUPLICATES = 0.001
"""Share of points in the place of another up to which they do not count for the density."""

UNEVEN_RATIO, UNEVEN_POINTS = 3.0, 25
"""Ratio of the densities of the dense and the sparse tenth of the blocks from which a remark is
given (of even points 1.7 at most), and the mean number of points of a block."""

BENT = 0.5
"""Share of the variance of the distances, explained by a surface of second degree, above which a
remark is given."""

OFF_SIGMAS = 4.0
"""Points farther than so many sigma_MAD from the plane of most points stand off it."""

OFF_SHARES = 0.01, 0.3
"""Least and largest share of such points: fewer are strays, more are a layer."""

MISLED = 1.1
"""Ratio of sigma_MAD with and without such points from which they mislead the plane."""

MOST_FITTED = 10_000
"""Points that the plane of most points is fitted to."""


def remarks_on(chart):
    """Return what speaks against the figures of a chart, sentences."""
    turns = sentences(of_turns(chart.beams)) if chart.n >= FEWEST_POINTS else ()
    return (*_on_points(chart), *_on_surface(chart), *turns)


def _on_points(chart):
    """Remarks on figures that these points cannot give or give wrongly."""
    gaps, step_mm = chart.spacing, chart.step_mm
    outline_m2, hull_m2 = chart.outline.area, chart.area_hull_m2
    d1_mm, d2_mm = 1000 * gaps.d[:2]
    away = np.hypot(*(gaps.xy - np.median(gaps.xy, axis=0)).T)
    far = away > FAR_QUANTILES * np.percentile(away, 90)
    coarse, steps = of_steps(step_mm, chart.sigma_mad_mm, d1_mm, chart.across_mm)
    without = " d1 to d4, f and g have no intervals." * bool(is_coarse(d1_mm, step_mm))
    return sentences(
        (coarse, steps + without),
        (
            is_below_step(d1_mm, step_mm),
            "f is not measured: points lie nearer to each other than the steps of coordinates.",
        ),
        (
            far.any(),
            f"{far.sum()} points lie far from the others, up to {away.max():.4g} m: they widen the "
            "hull, which lowers its density, and turn the plane.",
        ),
        (
            gaps.incomplete_share == 1,
            "No point has neighbours in all four quadrants within the search radius: d4 and f are "
            "not measured.",
        ),
        (gaps.coincident > DUPLICATES * gaps.n, of_copies(gaps.coincident, gaps.n)),
        of_pairs(d1_mm, d2_mm),
        (gaps.n < FEWEST_POINTS, f"Fewer than {FEWEST_POINTS} points: no confidence intervals."),
        (
            is_by_chance(gaps.xy, chart.axes),
            "Points spread alike in all directions: principal axes, and f, are by chance. So d1 to "
            "d4 and f have no intervals.",
        ),
        (
            outline_m2 > FULL * hull_m2,
            lambda: (
                f"Points lie on {100 * hull_m2 / outline_m2:.0f} % of the polygon: its density "
                "counts the rest too."
            ),
        ),
    )


def of_steps(step_mm, sigma_mm, d1_mm, across_mm):
    """Return whether steps of coordinates decide figures, and the remark on them.

    ``across_mm``: the step along the normal, that of the points or, where one axis has a digit
    less, its own; a smaller difference may be by chance, as of heights of two values.
    """
    across_mm = across_mm if across_mm > DIGIT_LESS * step_mm else step_mm
    coarse = [f"sigma_MAD {sigma_mm:.3g} mm"] * int(across_mm > sigma_mm)
    largest = across_mm if coarse else step_mm
    coarse += [f"d1 {d1_mm:.3g} mm"] * int(is_coarse(d1_mm, step_mm))
    steps = f"Coordinates are in steps of {largest:.3g} mm: too coarse for {' and '.join(coarse)}."
    return largest > COARSE_MM and coarse, steps


def of_pairs(d1_mm, d2_mm):
    """Return whether points come in pairs, and the remark on them."""
    said = "points come in pairs, as from two returns of a pulse or from a repeated scan; density "
    said += "and f count both."
    return d2_mm > PAIRS * d1_mm, lambda: f"d2 is {d2_mm / d1_mm:.0f} times d1: {said}"


def of_turns(beams):
    """Return whether points come from beams that turn, and the remark on what one pass shows."""
    said = "one pass does not show the phases of its turns, so the intervals of d1 to d4, f and g "
    said += "hold in about half of the passes, not in 95 %."
    return beams > 1, f"The points come from {beams} beams of a spinning scanner: {said}"


def of_copies(same, n):
    """Return the remark on points in the place of another."""
    share = f"{same:.0f} points ({100 * same / n:.3g} %) share their place with another"
    return f"{share}: they raise the density."


def _on_surface(chart):
    """Remarks on what lies empty, and on a surface that is no plane with noise alone."""
    xy, outline, step_mm, scale = chart.xy, chart.outline, chart.across_mm, chart.scale
    residuals_mm = 1000 * chart.plane.residuals
    space = space_within(xy, outline, most=GAP_PLACES)
    block = block_numbers(np.concatenate([space.places, xy]))
    small = block_numbers(xy, side=int(np.clip((len(xy) / 8) ** 0.5, 1, 8)))
    gaps: tuple[str, ...] = ()
    if outline.area:
        has_polygon = np.isfinite(chart.area_polygon_m2)
        gaps = (*_gaps(space, has_polygon), *_uneven(block, len(space.places), outline.area))
    layers = _layers(residuals_mm, step_mm)
    form = _form(xy, residuals_mm, small, step_mm, scale)
    part = _part(np.column_stack([xy, chart.plane.residuals]), scale, step_mm)
    return (*gaps, *layers, *part, *form)


def is_coarse(d1_mm: float, step_mm: float) -> bool:
    """Return whether steps of coordinates decide a spacing: it then has no interval.

    Examples
    --------
    >>> is_coarse(9.0, 1.0), is_coarse(9.0, 2.0)
    (False, True)
    """
    return step_mm > max(d1_mm / 5, COARSE_MM)


def is_below_step(d1_mm: ArrayLike, step_mm: float) -> np.ndarray:
    """Return whether a spacing is due to rounding alone: points in a grid of steps lie farther.

    Examples
    --------
    >>> is_below_step([0.1, 9.0], 10.0).tolist()
    [True, False]
    """
    return np.multiply(2, d1_mm) < step_mm


def _gaps(space, has_polygon):
    """A remark if a part of the outline is empty beside what the other gaps let expect."""
    away = space.distances
    limit = EMPTY_MEDIANS * np.median(away)
    share = np.mean(away > limit)
    if share < EMPTY_SHARE:
        return ()
    empty = f"{100 * share:.0f} % of the {'polygon' if has_polygon else 'hull of the points'} lies "
    empty += f"more than {1000 * limit:.0f} mm from any point: the density counts it."
    whole = np.percentile(away, 95)
    return sentences(
        (True, empty),
        (not has_polygon, "Give a polygon if the surface is smaller than the hull."),
        (
            has_polygon and not whole < 1.1 * space.e95,
            f"Points end before the border: e95 is {1000 * whole:.0f} mm if places there count.",
        ),
    )


def _uneven(block, places, area_m2):
    """A remark if some blocks of the outline have several times as many points as others.

    ``block`` are the blocks of so many places, then those of the points.
    """
    of, n = (np.bincount(part, minlength=16) for part in (block[:places], block[places:]))
    full = (n > 0) & (of > of.max() / 2)
    if n.sum() < UNEVEN_POINTS * len(n) or not full.any():
        return ()
    low, high = np.percentile((n[full] / of[full]) * places / area_m2, [10, 90])
    said = f"Points are uneven: {low:.0f} per m2 in the sparse tenth, {high:.0f} in the dense one."
    return sentences((high > UNEVEN_RATIO * low, said))


def is_by_chance(xy, axes):
    """Return whether the axes of the quadrants follow from points that spread alike everywhere."""
    narrow, wide = np.linalg.eigvalsh(np.cov(xy.T))
    return axes != "horizontal" and wide < ALIKE * narrow


def _form(xy, residuals_mm, block, step_mm, scale):
    """A remark if the form of a surface, bent or stepped, is most of its distances from a plane."""
    if len(xy) < FEWEST_POINTS or np.std(residuals_mm) < max(step_mm / 4, COARSE_MM):
        return []
    x, y = (xy / np.abs(xy).max()).T
    terms = np.array([np.ones_like(x), x, y, x * x, x * y, y * y])
    rest = residuals_mm - np.linalg.pinv(terms @ terms.T) @ (terms @ residuals_mm) @ terms
    share = 1 - np.var(rest) / np.var(residuals_mm)
    if share >= BENT:
        return [
            f"The surface is bent: its form is {100 * share:.0f} % of the variance of the "
            f"distances. Without it sigma_MAD is {sigma_mad(rest, scale):.1f} mm."
        ]
    counts = np.maximum(np.bincount(block), 1)
    within = residuals_mm - (np.bincount(block, residuals_mm) / counts)[block]
    # the means of the blocks take a part of the noise
    noise_mm = sigma_mad(within, scale) * (len(xy) / (len(xy) - len(counts))) ** 0.5
    all_mm = sigma_mad(residuals_mm, scale)
    # of few points a median halves by chance, so the variance without outliers must agree
    form = np.bincount(block, np.clip(residuals_mm, -3 * all_mm, 3 * all_mm)) / counts
    if noise_mm**2 > (1 - BENT) * all_mm**2 or np.var(form[block]) < BENT / 2 * all_mm**2:
        return []
    return [
        "The surface is stepped or uneven: most of its distances from the plane are its form. "
        f"Within {len(counts)} blocks sigma_MAD is {noise_mm:.1f} mm."
    ]


def _layers(residuals_mm, step_mm):
    """A remark if the distances from the plane have two peaks, so they are not noise alone."""
    low, high = np.percentile(residuals_mm, [0.5, 99.5])
    width = max(np.std(residuals_mm) / 4, 1.5 * step_mm)
    if len(residuals_mm) < 100 or not high - low > 4 * width:
        return []
    counts, edges = np.histogram(residuals_mm, np.arange(low, high + width, width))
    before, after = np.maximum.accumulate(counts), np.maximum.accumulate(counts[::-1])[::-1]
    lower = np.minimum(before, after)
    k = np.argmax(lower - counts)
    dip = lower[k] - counts[k] < LAYER_ERRORS * np.sqrt(lower[k])
    if dip or 2 * counts[k] > lower[k] or lower[k] < 0.05 * len(residuals_mm):
        return []
    peaks = [edges[np.argmax(counts[:k])], edges[k + np.argmax(counts[k:])]]
    a, b = np.add(peaks, width / 2)
    return [f"Distances from the plane have two layers, {a:.0f} and {b:.0f} mm: not noise alone."]


def part_off(points, scale, step_mm=0.0):
    """Return the mask of the points that mislead the regression plane, and the plane of the others.

    The plane of most points is the robust one; without such points the plane is None. Within two
    steps of the coordinates no point stands off.
    """
    plane = checked_plane(points[:: 1 + len(points) // MOST_FITTED], robust=True)
    away = plane.distances(points)
    least = max(OFF_SIGMAS * sigma_mad(away, scale), 0.002 * step_mm)
    off = np.abs(away - np.median(away)) > least
    if not OFF_SHARES[0] <= off.mean() <= OFF_SHARES[1]:
        return np.zeros(len(points), dtype=bool), None
    return off, checked_plane(points[~off])


def _part(local, scale, step_mm):
    """A remark if a part that stands off turns the regression plane or widens sigma_MAD.

    ``local``: points along two axes of this plane and across it, shape (n, 3), m.
    """
    off, without = part_off(local, scale, step_mm)
    if without is None:
        return ()
    sigma_mm, alone_mm = (
        1000 * sigma_mad(away, scale) for away in (local[:, 2], without.residuals)
    )
    if sigma_mm <= MISLED * alone_mm + 1e-6:
        return ()
    turn = np.degrees(np.arccos(min(1.0, abs(without.normal[2]))))
    return (
        f"{off.sum()} points ({100 * off.mean():.2g} %) stand off the others and turn the plane by "
        f"{turn:.2g} degrees: sigma_MAD is {sigma_mm:.1f} mm with them, {alone_mm:.1f} mm without.",
    )
