"""Where a chart is in an image: coded targets, long bars, and then all that is printed.

Targets and bars say where a chart may be. Print and photograph, compared without their local light,
then say where it is.
"""

from dataclasses import replace
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_image
from mmqa_lab.chart_image.geometry import (
    ChartMap,
    PanoramaCamera,
    four_corners,
)
from mmqa_lab.charts import Bar, Layout, LinePairs, Marker, reflectance

ENLARGEMENTS = (1, 2, 4)
"""Small targets are looked for in the image enlarged so many times."""

ENLARGED_PIXELS = 4e6
"""Larger images than this are not enlarged."""

SMALLEST_OUTLINE_PX = 24
"""Pixels around a target: those of 8 px a side cannot be decoded any more."""

SEARCHED_PIXELS = 12e6
"""Larger images than this are searched in strips."""

OVERLAP_ROWS = 512
"""Of the strips: larger than any target in images that large."""

BAR_PX, BAR_SHARE = 13, 0.72
"""Bars are sought that are narrower than this and darker than this share of what is around them."""

LARGEST_SOUGHT = 3e7
"""Larger images are halved before bars are sought."""

SLENDEREST = 6.0
"""A dark streak is taken for a bar when it is so many times longer than wide."""

MOST_STREAKS = 1500
"""The longest streaks of each size that are tried as bars."""

FINEST_PAIR_PX = 2.5
"""Line pairs narrower than this take no part in the alignment: aliased, they would mislead it."""

LARGEST_MISFIT = 0.06
"""Of the ends of two streaks and two bars, as share of the bars' extent."""

MOST_GUESSES = 6
"""So many of the best pairs of streaks are aligned."""

SMALLEST_CORRELATION = 0.6
"""Between chart and image after alignment; unrelated pictures stay below 0.4."""

PROMISING, LIKELY, CERTAIN = 0.3, 0.65, 0.8
"""The same of streaks taken for bars: before it, after it, and when no others need be tried."""

SMALLEST_CHART_PX = 50
"""Charts that small show nothing."""

GLANCE_CELLS = 80
"""Along a side of the chart, to compare a first guess with the image."""

LARGEST_DIFFERENCE = 0.15
"""Share of the printed blocks that may differ before a remark says so."""

LARGEST_MOVE = 0.06
"""Share of the chart's side by which the alignment may move a corner."""

TYPICAL_SIGMA_PX = 0.6
"""Point spread of the print, pixel included, in the alignment."""

FINEST, BLOCKS = 800, 12
"""Cells along a side at most, and blocks whose agreement is asked for."""

LIGHT_MM, SPREADS = 60.0, 3.0
"""Reach of local means and spreads; values beyond so many spreads count as that many."""

STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-6)


def locate(
    image: ArrayLike | None,
    layout: Layout,
    *,
    corners: ArrayLike | None = None,
    camera: PanoramaCamera | None = None,
    offset: tuple[float, float] = (0.0, 0.0),
) -> ChartMap:
    """Find a chart by its coded targets and long bars, or at its corners.

    Dark streaks are paired as if they were two of the long bars, and the best pair is aligned.
    OpenCV decodes the targets around it, or in the whole image where no pair will do; the corners
    of three or four give the map.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Grey values, any unit. None will do where corners are given.
    layout : Layout
    corners : array_like, shape (4, 2), optional
        Column and row of the lower left, lower right, upper right and upper left corner of the
        printed chart. Without them the layout must have targets,
        :class:`mmqa_lab.charts.Marker`.
    camera : PanoramaCamera, optional
        What bends rays into pixels, for distorted images and panoramas.
    offset : (float, float)
        Column and row of the whole image where this window begins.

    Returns
    -------
    ChartMap

    Raises
    ------
    ValueError
        If there are not four corners in this order; or the layout has no targets or neither they
        nor the long bars are found.

    Notes
    -----
    The six modules of a target need about 2.5 pixels each; the long bars are seen when they are
    two pixels wide.

    Examples
    --------
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()  # 1000 mm x 1000 mm
    >>> image = np.pad(255 * reflectance(layout, cell=4)[::-1], 20, constant_values=255)
    >>> found = locate(image.astype(np.uint8), layout)
    >>> found.source, bool(np.abs(found.pixels([[0, 0]]) - [19.5, 269.5]).max() < 0.5)
    ('4 coded targets', True)
    >>> there = locate(None, layout, corners=[[100, 350], [350, 350], [350, 100], [100, 100]])
    >>> there.pixels([[0, 0], [500, 500]]).round(6).tolist()
    [[100.0, 350.0], [225.0, 225.0]]
    """
    bent = {"camera": camera, "offset": offset}
    if corners is not None:
        corners = four_corners(corners, columns=2)
        return ChartMap.from_points(layout.corners(), corners, source="corners", **bent)
    dictionary, markers = _book([layout])
    grey = _stretched(image)
    charts = _by_bars(grey, layout)
    for there in charts:
        found = _sought(grey, dictionary, markers, there)
        own = [key for key in found if key in markers]
        if len(own) > 2:
            return replace(map_of_markers(found, layout, **bent), remark=there.remark)
        if own or not _other_board(found, markers, there):
            places = _mesh(layout)
            by_bars = ChartMap.from_points(places, there.pixels(places), source="long bars", **bent)
            return replace(by_bars, remark=there.remark)
    return map_of_markers(find_markers(image, [layout]), layout, **bent)


def find_markers(image, layouts):
    """Return the corners of the coded targets of one or more charts that are seen, by number."""
    dictionary, markers = _book(layouts)
    found = _sought(_stretched(image), dictionary, markers, None)
    found = {key: corners for key, corners in found.items() if key in markers}
    if not found:
        raise ValueError(
            f"Invalid image: none of the {len(markers)} coded targets of {dictionary} found. "
            "Must show them or long bars, or the corners of the chart must be given."
        )
    return found


def map_of_markers(found, layout, **bent):
    """Return the map of a chart from those of its coded targets that were found."""
    markers = _book([layout])[1]
    own = [key for key in found if key in markers]
    if not own:
        raise ValueError(f"Invalid image: no coded target of {layout.name!r}. Must show them.")
    # OpenCV counts from the upper left corner, clockwise
    places = np.concatenate([markers[key].corners()[::-1] for key in own])
    seen, source = np.concatenate([found[key] for key in own]), f"{len(own)} coded targets"
    return ChartMap.from_points(places, seen, source=source, **bent)


def _book(layouts):
    """The dictionary of the targets of some charts, and the targets by number."""
    markers = {one.identifier: one for layout in layouts for one in layout.of_kind(Marker)}
    if not markers:
        name = layouts[0].name
        raise ValueError(f"Invalid chart {name!r}: no coded targets. Must have some.")
    return next(iter(markers.values())).dictionary, markers


def _stretched(image):
    """An image as bytes from its darkest to its brightest grey values."""
    image = check_image(image, convert=False)
    if image.dtype not in (np.uint8, np.uint16):
        image = image.astype(np.float32)
    step = 1 + int(np.sqrt(image.size / 1e6))
    limits = np.percentile(image[::step, ::step], [0.5, 99.5]).astype(image.dtype)
    low, high = (float(limit) for limit in limits)
    scale = 255 / max(high - low, 1e-12)
    return cv2.convertScaleAbs(np.clip(image, *limits), alpha=scale, beta=-low * scale)


def align(image, layout, chart_map):
    """Improve a map by the whole printed chart.

    In the chart's frame, photograph and print are each divided by their local mean and spread;
    OpenCV's enhanced correlation finds the homography between them, on finer and finer cells. Fine
    line pairs are left out.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Linear light.
    layout : Layout
    chart_map : ChartMap
        Right to a few pixels.

    Returns
    -------
    ChartMap

    Raises
    ------
    ValueError
        If the chart is not found there: a correlation below 0.6, or corners that moved by more
        than 6 % of the chart's side.

    References
    ----------
    Evangelidis and Psarakis 2008, doi:10.1109/TPAMI.2008.113.

    Examples
    --------
    >>> from mmqa_lab.chart_image import ChartMap
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4)[::-1]  # pixels of 4 mm
    >>> there = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> wrong = ChartMap(there.matrix + [[0, 0, 0.8], [0, 0, -0.6], [0, 0, 0]])
    >>> right = align(image, layout, wrong)
    >>> off = np.abs(right.pixels(layout.corners()) - there.pixels(layout.corners()))
    >>> bool(off.max() < 0.1)
    True
    """
    image = check_image(image)
    start = chart_map
    finest = min(int(layout.width / np.median(start.pixel_sizes_mm(layout.corners()))), FINEST)
    for along in sorted({min(60, finest), min(160, finest), max(finest, 12)}):
        chart_map, correlation, each = _compared(image, layout, chart_map, along)
    if not correlation >= SMALLEST_CORRELATION:
        raise ValueError(
            f"Invalid place of the chart: its print correlates by {correlation:.2f} with the "
            f"image. Must be {SMALLEST_CORRELATION} or more; is the chart there, and not mirrored?"
        )
    strange = (each < SMALLEST_CORRELATION * np.median(each)).mean()
    remarks = [start.remark] if start.remark else []
    if strange > LARGEST_DIFFERENCE:
        remarks.append(
            f"{strange:.0%} of the print differ from the layout: hidden, or another chart"
        )
    moved = _apart(chart_map, start, layout).max()
    pixel_mm = float(np.median(start.pixel_sizes_mm(layout.corners())))
    limit = max(LARGEST_MOVE * layout.width / pixel_mm, 4)
    if moved > limit:
        raise ValueError(
            f"Invalid place of the chart: a corner lies {moved:.1f} px away. Must be given to "
            f"{limit:.1f} px."
        )
    return replace(chart_map, source=f"{start.source}, aligned", remark="; ".join(remarks))


def _compared(image, layout, chart_map, along):
    """A map after OpenCV's enhanced correlation, the correlation, and its part in each block.

    Photograph and print lie in the chart's frame, ``along`` cells a side, each divided by its own
    local mean and spread, so that light and shadow do not count.
    """
    pixel_mm = float(np.median(chart_map.pixel_sizes_mm(layout.corners())))
    cell = layout.width / along
    columns, rows = along, int(np.ceil(layout.height / cell))
    printed = reflectance(layout, cell=cell)[:rows]
    blur = np.hypot(TYPICAL_SIGMA_PX * pixel_mm / cell, 0.5)
    y, x = (np.indices((rows, columns)) + 0.5) * cell
    pixels = chart_map.pixels(np.column_stack([x.ravel(), y.ravel()])).astype(np.float32)
    pixels = pixels.reshape(rows, columns, 2)
    soft = max(cell / pixel_mm / 2.5, 0.3)
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), soft)
    seen = cv2.remap(smooth, pixels, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    inside = ((pixels >= 0) & (pixels <= np.array(image.shape[::-1]) - 1)).all(axis=2)
    reach = LIGHT_MM / cell
    printed = _standardised(cv2.GaussianBlur(printed, (0, 0), blur), reach)
    seen = _standardised(seen, reach)
    trusted = (_trusted(layout, pixel_mm, cell, printed.shape) * inside).astype(np.uint8)
    try:
        _, warp = cv2.findTransformECC(
            printed, seen, np.eye(3, dtype=np.float32), cv2.MOTION_HOMOGRAPHY, STOP, trusted, 1
        )
    except cv2.error:  # nothing in common
        warp = np.eye(3)
    size = {"dsize": (columns, rows), "flags": cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP}
    moved = cv2.warpPerspective(seen, warp, **size)
    to_mm = np.array([[cell, 0, cell / 2], [0, cell, cell / 2], [0, 0, 1]])
    better = chart_map.corrected(to_mm @ warp @ np.linalg.inv(to_mm))
    product = np.clip(moved, -SPREADS, SPREADS) * np.clip(printed, -SPREADS, SPREADS) * trusted
    weight = np.clip(printed, -SPREADS, SPREADS) ** 2 * trusted
    other = np.clip(moved, -SPREADS, SPREADS) ** 2 * trusted
    correlation = product.sum() / max(np.sqrt(weight.sum() * other.sum()), 1e-12)
    each = _in_blocks(product) / np.maximum(np.sqrt(_in_blocks(weight) * _in_blocks(other)), 1e-12)
    return better, float(correlation), each[_in_blocks(weight) > 0.5 * _in_blocks(weight).max()]


def _standardised(tones, reach):
    """Tones less their local mean, in local spreads."""
    mean = cv2.GaussianBlur(tones, (0, 0), reach)
    spread = np.sqrt(np.maximum(cv2.GaussianBlur((tones - mean) ** 2, (0, 0), reach), 0))
    return (tones - mean) / np.maximum(spread, 0.1 * spread.max() + 1e-12)


def _in_blocks(values):
    """Sums over blocks of a chart, shape (BLOCKS, BLOCKS)."""
    rows, columns = (np.linspace(0, n, BLOCKS + 1).astype(int)[:-1] for n in values.shape)
    return np.add.reduceat(np.add.reduceat(values, rows, axis=0), columns, axis=1)


def _apart(one, other, layout):
    """Distances of the chart's corners in two maps, pixels."""
    corners = layout.corners()
    return np.linalg.norm(one.pixels(corners) - other.pixels(corners), axis=1)


def _mesh(layout):
    """Five times five places all over a chart, mm."""
    steps = np.linspace(0, 1, 5)
    return np.stack(np.meshgrid(steps * layout.width, steps * layout.height), -1).reshape(-1, 2)


def _trusted(layout, pixel_mm, cell, shape):
    """Which cells may take part in the alignment."""
    trusted = np.ones(shape, dtype=np.float32)
    for pairs in layout.of_kind(LinePairs):
        if pairs.pair / pixel_mm < FINEST_PAIR_PX:
            low, high = pairs.corners()[[0, 2]] / cell
            low, high = np.maximum(low - 2, 0).astype(int), np.ceil(high + 2).astype(int)
            trusted[low[1] : high[1], low[0] : high[0]] = 0
    return trusted


def _by_bars(grey, layout):
    """The maps of the charts whose long bars are seen, the likeliest first."""
    bars = [bar for bar in layout.of_kind(Bar) if _slender(bar)]
    found = []
    for factor in _factors(grey.shape):
        size = [max(round(side * factor), 1) for side in grey.shape[::-1]]
        way = cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC
        small = grey if factor == 1 else cv2.resize(grey, size, interpolation=way)
        half = (factor - 1) / 2
        grow = np.linalg.inv([[factor, 0, half], [0, factor, half], [0, 0, 1]])
        guesses = _guesses(small, layout, bars)
        found += [(one, replace(there, matrix=grow @ there.matrix)) for one, there in guesses]
        if any(correlation > CERTAIN for correlation, _ in found):
            break
    middle, charts = [[layout.width / 2, layout.height / 2]], []
    for _, there in sorted(found, key=lambda one: -one[0]):
        side = np.ptp(there.pixels(layout.corners()), axis=0).max()
        away = [np.linalg.norm(one.pixels(middle) - there.pixels(middle)) for one in charts]
        if not any(distance < side / 2 for distance in away):
            charts.append(there)
    remark = "another chart is seen" if len(charts) > 1 else ""
    return [replace(there, remark=remark) for there in charts]


def _slender(bar):
    """Whether an element is long enough to be sought as a bar."""
    return max(bar.width, bar.height) >= 10 * min(bar.width, bar.height)


def _factors(shape):
    """Sizes at which bars are sought, as shares of the image's."""
    factor = 1.0 if np.prod(shape) < LARGEST_SOUGHT else 0.5
    while factor * min(shape) > 100:
        yield factor
        factor /= 3
    if np.prod(shape) < ENLARGED_PIXELS:
        yield 2.0


def _guesses(grey, layout, bars):
    """Correlations and aligned maps of the charts that streaks suggest."""
    scored = _glanced(grey, layout, _suggested(_streaks(grey), bars))
    scored = sorted((one for one in scored if one[0] > PROMISING), key=lambda one: -one[0])
    found = []
    for _, there in scored[:MOST_GUESSES]:
        for along in (60, 160):
            outline = there.outline(layout.corners())
            if not ((outline > -2) & (outline < np.array(grey.shape[::-1]) + 1)).all():
                break
            there, correlation, _ = _compared(grey, layout, there, along)
        else:
            wide = np.ptp(there.pixels(layout.corners()), axis=0)
            if wide.prod() > SMALLEST_CHART_PX**2:
                found.append((correlation, there))
    return [one for one in found if one[0] > LIKELY]


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
    for there in suggested:
        pixels = there.pixels(places).astype(np.float32).reshape(rows, GLANCE_CELLS, 2)
        seen = cv2.remap(grey, pixels, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        each = (standard(seen.astype(float))[0] * expected).mean(axis=1)
        yield float(weight @ each / weight.sum()), there


def _streaks(grey):
    """Both ends of the long dark streaks in an image, shape (n, 2, 2), the longest first."""
    around = cv2.morphologyEx(grey, cv2.MORPH_CLOSE, np.ones((BAR_PX, BAR_PX), np.uint8))
    dark = grey < BAR_SHARE * around
    outlines, _ = cv2.findContours(np.uint8(dark), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
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
    found = sorted(found, key=lambda one: -one[0])[:MOST_STREAKS]
    return np.array([ends for _, ends in found]).reshape(-1, 2, 2)


def _suggested(streaks, bars):
    """Maps, to a few per cent, under which two streaks are two of the bars."""
    length = np.linalg.norm(streaks[:, 0] - streaks[:, 1], axis=1)
    middles = streaks.mean(axis=1)
    apart = np.linalg.norm(middles[:, None] - middles, axis=2)
    near = (apart > 0) & (apart < 2 * length) & (length[:, None] < 2.5 * length)
    first, second = np.nonzero(near & near.T)
    for one, two in combinations(bars, 2):
        places = np.concatenate([_axis(one), _axis(two)])
        design = np.column_stack([places, np.ones(4)])
        for order in ([0, 1, 2, 3], [1, 0, 2, 3], [0, 1, 3, 2], [1, 0, 3, 2]):
            ends = np.concatenate([streaks[first], streaks[second]], axis=1)[:, order]
            affine = np.linalg.pinv(design) @ ends
            misfit = np.sqrt(((design @ affine - ends) ** 2).mean(axis=(1, 2)))
            size = np.linalg.svd(affine[:, :2], compute_uv=False) if len(ends) else np.ones((0, 2))
            good = misfit < LARGEST_MISFIT * np.ptp(places) * size[:, 1]
            # rows count downwards: the chart's axes are mirrored in the image
            good &= (size[:, 1] > 0.35 * size[:, 0]) & (np.linalg.det(affine[:, :2]) < 0)
            for found in affine[good]:
                yield ChartMap(np.vstack([found.T, [0, 0, 1]]))


def _axis(bar):
    """Both ends of a bar's middle line."""
    corners = bar.corners()
    sides = [0, 1, 2, 3] if bar.width < bar.height else [3, 0, 1, 2]
    return np.stack([corners[sides[:2]].mean(axis=0), corners[sides[2:]].mean(axis=0)])


def _sought(grey, dictionary, markers, there):
    """Corners of coded targets by number, sought around a chart or everywhere."""
    first = np.zeros(2, dtype=int)
    if there is not None:
        outline = there.outline(np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * _extent(markers))
        side = np.ptp(outline, axis=0)
        first = np.maximum(outline.min(axis=0) - side / 8, 0).astype(int)
        last = (outline.max(axis=0) + side / 8).astype(int)
        grey = np.ascontiguousarray(grey[first[1] : last[1], first[0] : last[0]])
    found = {}
    for enlargement in ENLARGEMENTS:
        if enlargement > 1 and grey.size > ENLARGED_PIXELS:
            break
        seen = _detected(grey, dictionary, enlargement)
        found = seen if len(seen) > len(found) else found
        if set(markers) <= set(found):
            break
    return {key: corners + first for key, corners in found.items()}


def _other_board(found, markers, there):
    """Whether targets with other numbers stand where those of the chart should."""
    for marker in markers.values():
        corners = there.pixels(marker.corners())
        near = np.linalg.norm(corners[2] - corners[0]) / 4
        middles = [seen.mean(axis=0) - corners.mean(axis=0) for seen in found.values()]
        if any(np.linalg.norm(middle) < near for middle in middles):
            return True
    return False


def _extent(markers):
    """How far the targets reach to the right and up, mm."""
    return np.max([marker.corners()[2] for marker in markers.values()], axis=0)


def _detected(image, dictionary, enlargement):
    """Corners of the coded targets by number, in pixels of the image."""
    book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_CONTOUR
    found = {}
    for first, strip in _strips(image):
        if enlargement > 1:
            size = (strip.shape[1] * enlargement, strip.shape[0] * enlargement)
            strip = cv2.resize(strip, size, interpolation=cv2.INTER_CUBIC)
        # of the longer side; every smaller contour of a textured image would cost its time
        settings.minMarkerPerimeterRate = SMALLEST_OUTLINE_PX * enlargement / max(strip.shape)
        detector = cv2.aruco.ArucoDetector(book, settings)
        corners, identifiers, _ = detector.detectMarkers(strip)
        for one, key in zip(corners, () if identifiers is None else identifiers, strict=False):
            places = (one.reshape(4, 2).astype(float) + 0.5) / enlargement - 0.5
            found[int(np.ravel(key)[0])] = places + [0, first]
    return found


def _strips(image):
    """An image as strips of rows that overlap, with their first rows."""
    rows = max(int(SEARCHED_PIXELS / image.shape[1]), 4 * OVERLAP_ROWS)
    for first in range(0, max(len(image) - OVERLAP_ROWS, 1), rows - OVERLAP_ROWS):
        yield first, image[first : first + rows]
