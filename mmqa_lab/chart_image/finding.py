"""How a chart is found in an image: by its coded targets, by its long bars, or at its corners.

Targets, decoded by OpenCV, and bars, dark streaks paired as if they were two of the chart's, say
where a chart may be. :func:`mmqa_lab.chart_image.align` then says where it is.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_image, refuse
from mmqa_lab.chart_image.alignment import CERTAIN, CLEARLY, MIDDLE, SMALLEST_CORRELATION, Level
from mmqa_lab.chart_image.maps import (
    ChartMap,
    LensCamera,
    PanoramaCamera,
    four_corners,
    mirrored,
    plain,
    side,
)
from mmqa_lab.charts import Bar, Layout, Marker, reflectance

__all__ = ["ENLARGED_PIXELS", "by_bars", "by_chart", "confirmed", "decoded", "locate"]


LONG_BARS = "long bars"

WIRES_PX = 9
"""Window of a median in which wires vanish and bars stay."""

SHRUNK_PIXELS, OTHERS_PIXELS = 25e6, 6e6
"""Targets are sought in larger images than the first made that small first; a second chart without
targets in images of the last one: there it must be 50 pixels wide."""

SLENDEREST, MOST_STREAKS = 6.0, 1500
"""Least length of a dark streak over its width to count as a bar; number of streaks at most."""

PROMISING, LIKELY = 0.3, 0.65
"""Correlations of a guess: least before alignment, least after it."""

GLANCE_CELLS, COARSE_CELLS = 80, 60
"""Cells along a side of the chart where a first guess is compared with the image, and where it is
aligned first."""

STRETCHES, LIKELIEST = np.arange(-4, 5) * 0.015, 3
"""Turns (radians) and changes of size that are tried where few targets are seen; maps aligned."""

ENLARGEMENTS, ENLARGED_PIXELS = (1, 2, 4), 4e6
"""Factors of enlargement for small targets, and the number of pixels up to which they are used."""


def locate(
    image: ArrayLike | None,
    layout: Layout,
    *,
    corners: ArrayLike | None = None,
    camera: PanoramaCamera | LensCamera | None = None,
    offset: tuple[float, float] = (0.0, 0.0),
) -> ChartMap:
    """Find a chart by its coded targets and long bars, or at its corners.

    OpenCV decodes the targets; the corners of three or four give the map. Where fewer are read,
    dark streaks are paired as if they were two of the long bars, and the best pair is aligned. What
    one or two targets say must agree with the rest of the print.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Grey values, any unit. None will do where corners are given.
    layout : Layout
    corners : array_like, shape (4, 2), optional
        Column and row of the lower left, lower right, upper right and upper left corner of the
        printed chart.
    camera : PanoramaCamera or LensCamera, optional
        What bends rays into pixels: a panorama, or a lens that bends lines.
    offset : (float, float)
        Column and row of the whole image where this window begins.

    Returns
    -------
    ChartMap

    Raises
    ------
    ValueError
        If there are not four corners in this order, no chart is found, or it is mirrored.

    Notes
    -----
    The six modules of a target need about 2.5 pixels each; the long bars are seen when they are
    two pixels wide. Another chart, whose targets cannot be decoded, is counted where it is 50
    pixels wide in the image made smaller to 6 megapixels.

    Examples
    --------
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()  # 1000 mm x 1000 mm
    >>> image = np.pad(255 * reflectance(layout, cell=4)[::-1], 20, constant_values=255)
    >>> found = locate(image.astype(np.uint8), layout)
    >>> found.source, bool(np.abs(found.pixels([[0, 0]]) - [19.5, 269.5]).max() < 0.5)
    ('4 coded targets', True)
    >>> chart_map = locate(None, layout, corners=[[100, 350], [350, 350], [350, 100], [100, 100]])
    >>> chart_map.pixels([[0, 0], [500, 500]]).round(6).tolist()
    [[100.0, 350.0], [225.0, 225.0]]
    """
    if corners is not None:
        corners = four_corners(corners, columns=2)
        places = layout.corners()
        return ChartMap.from_points(places, corners, camera=camera, offset=offset, source="corners")
    grey, known = _stretched(image), {"camera": camera, "offset": offset}
    chart_map, targets = _found(grey, layout, known)
    if chart_map is None:  # a fence may stand before it
        chart_map, _ = _found(cv2.medianBlur(grey, WIRES_PX), layout, known)
    if chart_map is None or chart_map.source == LONG_BARS:
        flipped = np.ascontiguousarray(grey[:, ::-1])
        if chart_map is None:
            turned = _found(flipped, layout, known)[0] is not None
        else:  # bars alone look alike, targets do not
            turned = len(decoded(flipped, _markers(layout), _shrunk(grey))) > 2
        refuse(turned, "image", "the chart is mirrored", "as the camera saw it")
    if chart_map is None:
        seen = f"{targets} of {len(layout.of_kind(Marker))} coded targets and no long bars found"
        must = "show the whole chart, not cut by the border, or its corners must be given"
        raise ValueError(f"Invalid image: {seen}. Must {must}.")
    return chart_map


def _found(grey, layout, known):
    """The map of the largest chart or None, and how many coded targets are seen."""
    markers, shrunk = _markers(layout), _shrunk(grey)
    for times in (shrunk, 1) if shrunk < 1 else (1,):
        found = decoded(grey, markers, times) if markers else []
        chart_map = _by_targets(grey, layout, found, markers, known)
        if chart_map is None and times == shrunk:
            chart_map = by_bars(grey, layout, times)
            if chart_map is not None:
                chart_map = plain(chart_map, layout, source=LONG_BARS, **known)
        if chart_map is not None:
            break
    return chart_map, len(found)


def _markers(layout):
    """Coded targets by dictionary and number."""
    return {(one.dictionary, one.identifier): one for one in layout.of_kind(Marker)}


def _shrunk(grey):
    """The factor by which an image is made smaller first."""
    return min((SHRUNK_PIXELS / grey.size) ** 0.5, 1)


def _by_targets(grey, layout, found, markers, known):
    """The map by three or four targets of the largest chart, or None; other charts are counted."""
    groups = by_chart(found, markers, layout)
    if len(dict(found)) == len(found) > 2 and len(groups) > 1:  # a lens moves them apart
        groups = [found]
    if not groups:
        return None
    # OpenCV counts from the upper left corner, clockwise
    places = np.concatenate([markers[key].corners()[::-1] for key, _ in groups[0]])
    seen = np.concatenate([corners for _, corners in groups[0]])
    source = f"{len(groups[0])} coded targets"
    chart_map = ChartMap.from_points(places, seen, source=source, **known)
    if len(groups[0]) < 3:  # seen through a fence: the rest of the print must agree
        near = _near(grey, layout, places, seen)
        rest = [
            good for one in near if (good := confirmed(grey, layout, one, SMALLEST_CORRELATION))
        ]
        best = max(rest, key=lambda one: one[0], default=None)
        return None if best is None else plain(best[1], layout, source=source, **known)
    other = _other(grey, replace(chart_map, offset=(0.0, 0.0)), layout)
    charts = sum(len(group) > 1 for group in groups), 1 + (other.charts if other else 0)
    if other and side(other, layout) > side(chart_map, layout):
        chart_map = plain(other, layout, source=LONG_BARS, **known)
    return replace(chart_map, charts=max(charts))


def _near(grey, layout, places, seen):
    """The likeliest maps by the corners of one or two targets.

    The map by them, and those from straight ahead: turned a little and larger or smaller, since a
    target's corners are not certain enough for a whole chart.
    """
    # rows count downwards
    printed, pixels = places @ [1, -1j], seen @ [1, 1j]
    design = np.column_stack([printed, np.ones_like(printed)])
    turn, middle = np.linalg.lstsq(design, pixels, rcond=None)[0][0], pixels.mean()
    maps = [ChartMap.from_points(places, seen)]
    for change in np.exp(np.add.outer(STRETCHES, 1j * STRETCHES)).ravel():
        a = change * turn
        start = middle - a * printed.mean()
        rows = [[a.real, a.imag, start.real], [a.imag, -a.real, start.imag], [0, 0, 1]]
        maps.append(ChartMap(np.array(rows)))
    level = Level(grey, layout, maps[1 + STRETCHES.size**2 // 2], COARSE_CELLS)
    return sorted(maps, key=level.correlation)[: -LIKELIEST - 1 : -1]


def _other(grey, chart_map, layout):
    """The largest of other charts, whose targets may be too small or blurred, or None.

    Paints over the one that is known.
    """
    outline = chart_map.outline(layout.corners()).round().astype(np.int32)
    factor = min((OTHERS_PIXELS / grey.size) ** 0.5, 1)
    return by_bars(cv2.fillPoly(grey, [outline], cv2.mean(grey)), layout, factor)


def _stretched(image):
    """An image as bytes from its darkest to its brightest grey values."""
    image = check_image(image, convert=False)
    if image.dtype not in (np.uint8, np.uint16):
        image = image.astype(np.float32)
    step = 1 + int(np.sqrt(image.size / 1e6))
    limits = np.percentile(image[::step, ::step], [0.5, 99.5]).astype(image.dtype)
    low, high = map(float, limits)
    scale = 255 / max(high - low, 1e-12)
    return cv2.convertScaleAbs(np.clip(image, *limits), alpha=scale, beta=-low * scale)


def by_bars(grey, layout, smaller):
    """Return the map of the likeliest chart by its long bars, or None."""
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


def decoded(grey, markers, smaller):
    """Return numbers and corners of the coded targets that are seen in an image made smaller."""
    dictionaries = sorted({one.dictionary for one in markers.values()})
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_CONTOUR
    best = []
    for times in ENLARGEMENTS if grey.size <= ENLARGED_PIXELS else (smaller,):
        way = cv2.INTER_CUBIC if times > 1 else cv2.INTER_AREA
        large = cv2.resize(grey, None, fx=times, fy=times, interpolation=way)
        # targets of less than 6 px a side cannot be decoded, their contours would cost time
        settings.minMarkerPerimeterRate = 24 * times / max(large.shape)
        ours = []
        for name in dictionaries:
            book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
            corners, numbers, _ = cv2.aruco.ArucoDetector(book, settings).detectMarkers(large)
            places = [(seen.reshape(4, 2).astype(float) + 0.5) / times - 0.5 for seen in corners]
            keys = [] if numbers is None else [(name, one) for one in np.ravel(numbers).tolist()]
            ours += [one for one in zip(keys, places, strict=True) if one[0] in markers]
        # a mirrored square is none of the chart's targets
        found = [one for one in ours if np.linalg.det(one[1][1:3] - one[1][:2]) > 0]
        best = max(best, found, key=len)
        # a fifth target is one of another chart, whose others are smaller
        if best and len(best) % len(markers) == 0:
            break
    return best


def by_chart(found, markers, layout):
    """The targets of each chart, the largest chart first: each says where the middle should be."""
    groups = []
    for key, corners in found:
        one = ChartMap.from_points(markers[key].corners()[::-1], corners)
        middle = one.pixels([[layout.width / 2, layout.height / 2]])[0]
        side = np.linalg.norm(corners[0] - corners[2]) / markers[key].size * layout.width
        for place, _, group in groups:
            if np.linalg.norm(place - middle) < side / 3 and key not in dict(group):
                group.append((key, corners))
                break
        else:
            groups.append((middle, side, [(key, corners)]))
    return [one[2] for one in sorted(groups, key=lambda one: (-min(len(one[2]), 3), -one[1]))]
