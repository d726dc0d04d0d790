"""Charts by their long bars: dark streaks of an image, paired as if they were two of the bars."""

from dataclasses import replace
from itertools import combinations

import cv2
import numpy as np

from mmqa_lab.chart_image.alignment import CERTAIN, CLEARLY, MIDDLE, Level
from mmqa_lab.chart_image.maps import ChartMap, mirrored, side
from mmqa_lab.chart_image.targets import ENLARGED_PIXELS
from mmqa_lab.charts import Bar, reflectance

__all__ = ["by_bars", "confirmed"]

SLENDEREST, MOST_STREAKS = 6.0, 1500
"""Least length of a dark streak over its width to count as a bar; number of streaks at most."""

PROMISING, LIKELY = 0.3, 0.65
"""Correlations of a guess: least before alignment, least after it."""

GLANCE_CELLS, COARSE_CELLS = 80, 60
"""Cells along a side of the chart where a first guess is compared with the image, and where it is
aligned first."""


def by_bars(grey, layout, smaller):
    """The map of the likeliest chart by its long bars, or None."""
    bars = [bar for bar in layout.of_kind(Bar) if max(bar.width, bar.height) >= 400]
    found = []
    # sizes of the image, from the likeliest on
    for factor in (smaller, smaller / 3, smaller / 9, 2):
        if not factor * min(grey.shape) > 100 or (factor > 1 and grey.size > ENLARGED_PIXELS):
            continue
        way = cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC
        small = cv2.resize(grey, None, fx=factor, fy=factor, interpolation=way)
        half = (factor - 1) / 2
        grow = np.linalg.inv([[factor, 0, half], [0, factor, half], [0, 0, 1]])
        guesses = _guesses(small, layout, bars)
        found += [(r, replace(guess, matrix=grow @ guess.matrix)) for r, guess in guesses]
        if any(correlation > CERTAIN for correlation, _ in found):
            break
    if not found:
        return None
    middle, charts = [[layout.width / 2, layout.height / 2]], []
    for _, chart_map in sorted(found, key=lambda guess: -guess[0]):
        long = side(chart_map, layout)
        apart = [np.ptp([chart_map.pixels(middle), at], axis=0).max() for at, _, _ in charts]
        if not any(distance < long / 2 for distance in apart):
            charts.append((chart_map.pixels(middle), long, chart_map))
    return replace(max(charts, key=lambda chart: chart[1])[2], charts=len(charts))


def _guesses(grey, layout, bars):
    """Correlations and aligned maps of the charts that streaks suggest."""
    scored = _glanced(grey, layout, _suggested(_streaks(grey), bars))
    best = sorted(scored, key=lambda guess: -guess[0])[:6]
    guesses = [chart_map for first, chart_map in best if first > PROMISING]
    return [found for guess in guesses if (found := confirmed(grey, layout, guess))]


def confirmed(grey, layout, chart_map, least=LIKELY):
    """Correlation and map of a guess after alignment, or None where the print does not agree."""
    for along in (COARSE_CELLS, MIDDLE):
        outline = chart_map.outline(layout.corners())
        if not ((outline > -2) & (outline < np.array(grey.shape[::-1]) + 1)).all():
            return None
        level = Level(grey, layout, chart_map, along)
        chart_map, correlation = level.aligned(chart_map)
    wide = np.ptp(chart_map.pixels(layout.corners()), axis=0)
    good = correlation > least and wide.prod() > 50**2  # a smaller chart shows nothing
    good = good and correlation + CLEARLY > level.correlation(mirrored(chart_map, layout))
    return (correlation, chart_map) if good else None


def _glanced(grey, layout, suggested):
    """Maps with the mean correlation of 5 x 5 blocks of print and image, on coarse cells."""
    cell = layout.width / GLANCE_CELLS
    rows = int(layout.height / cell) // 5 * 5
    printed = cv2.GaussianBlur(reflectance(layout, cell=cell)[:rows], (0, 0), 0.7)
    y, x = (np.indices((rows, GLANCE_CELLS)) + 0.5) * cell
    places = np.column_stack([x.ravel(), y.ravel()])

    def standard(values):
        blocks = values.reshape(5, rows // 5, 5, GLANCE_CELLS // 5).swapaxes(1, 2).reshape(25, -1)
        blocks = blocks - blocks.mean(axis=1, keepdims=True)
        spread = blocks.std(axis=1, keepdims=True)
        return blocks / np.maximum(spread, 1e-6), spread[:, 0]

    expected, weight = standard(printed.astype(float))
    for chart_map in suggested:
        pixels = chart_map.pixels(places).astype(np.float32).reshape(rows, GLANCE_CELLS, 2)
        seen = cv2.remap(grey, pixels, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        each = (standard(seen.astype(float))[0] * expected).mean(axis=1)
        yield float(weight @ each / weight.sum()), chart_map


def _streaks(grey):
    """Both ends of the long dark streaks in an image, shape (n, 2, 2), the longest first."""
    # bars are narrower than 13 px and darker than 72 % of what is around them
    around = cv2.morphologyEx(grey, cv2.MORPH_CLOSE, np.ones((13, 13), np.uint8))
    dark = np.uint8(grey < 0.72 * around)
    outlines, _ = cv2.findContours(dark, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    found = []
    for outline in outlines:
        box = cv2.boundingRect(outline)
        if max(box[2:]) < 4 * SLENDEREST:
            continue
        middle, size, angle = cv2.minAreaRect(outline)
        if max(size) < SLENDEREST * (min(size) + 1):
            continue
        turn = np.radians(angle if size[0] > size[1] else angle + 90)
        half = np.array([np.cos(turn), np.sin(turn)]) * max(size) / 2
        found.append((max(size), [middle - half, middle + half]))
    longest = sorted(found, key=lambda streak: -streak[0])[:MOST_STREAKS]
    return np.array([ends for _, ends in longest]).reshape(-1, 2, 2)


def _suggested(streaks, bars):
    """Maps, to a few per cent, under which two streaks are two of the bars."""
    length = np.linalg.norm(streaks[:, 0] - streaks[:, 1], axis=1)
    middles = streaks.mean(axis=1)
    apart = np.linalg.norm(middles[:, None] - middles, axis=2)
    near = (apart > 0) & (apart < 2 * length) & (length[:, None] < 2.5 * length)
    first, second = np.nonzero(near & near.T)
    for bar, other in combinations(bars, 2):
        places = np.concatenate([_axis(bar), _axis(other)])
        design = np.column_stack([places, np.ones(4)])
        for order in ([0, 1, 2, 3], [1, 0, 2, 3], [0, 1, 3, 2], [1, 0, 3, 2]):
            ends = np.concatenate([streaks[first], streaks[second]], axis=1)[:, order]
            affine = np.linalg.pinv(design) @ ends
            misfit = np.sqrt(((design @ affine - ends) ** 2).mean(axis=(1, 2)))
            size = np.linalg.svd(affine[:, :2], compute_uv=False)
            good = misfit < 0.06 * np.ptp(places) * size[:, 1]
            # rows count downwards: the chart's axes are mirrored in the image
            good &= (size[:, 1] > 0.35 * size[:, 0]) & (np.linalg.det(affine[:, :2]) < 0)
            for found in affine[good]:
                yield ChartMap(np.vstack([found.T, [0, 0, 1]]))


def _axis(bar):
    """Both ends of a bar's middle line."""
    corners = bar.corners()
    sides = [0, 1, 2, 3] if bar.width < bar.height else [3, 0, 1, 2]
    return np.stack([corners[sides[:2]].mean(axis=0), corners[sides[2:]].mean(axis=0)])
