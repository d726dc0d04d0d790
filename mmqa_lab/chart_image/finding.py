"""How a chart is found in an image: by its coded targets, by its long bars, or at its corners.

Targets and bars say where a chart may be. :func:`mmqa_lab.chart_image.align` then says where it is.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_image, refuse
from mmqa_lab.chart_image.alignment import SMALLEST_CORRELATION
from mmqa_lab.chart_image.bars import by_bars, confirmed
from mmqa_lab.chart_image.maps import (
    ChartMap,
    LensCamera,
    PanoramaCamera,
    four_corners,
    plain,
    side,
)
from mmqa_lab.chart_image.targets import by_chart, decoded
from mmqa_lab.charts import Layout, Marker

__all__ = ["locate"]

WIRES_PX = 9
"""Window of a median in which wires vanish and bars stay."""

SHRUNK_PIXELS, OTHERS_PIXELS = 25e6, 6e6
"""Targets are sought in larger images than the first made that small first; a second chart without
targets in images of the last one: there it must be 50 pixels wide."""


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
    if chart_map is None:
        mirrored = _found(np.ascontiguousarray(grey[:, ::-1]), layout, known)[0] is not None
        refuse(mirrored, "image", "the chart is mirrored", "as the camera saw it")
        seen = f"{targets} of {len(layout.of_kind(Marker))} coded targets and no long bars found"
        must = "show the whole chart, not cut by the border, or its corners must be given"
        raise ValueError(f"Invalid image: {seen}. Must {must}.")
    return chart_map


def _found(grey, layout, known):
    """The map of the largest chart or None, and how many coded targets are seen."""
    markers = {(one.dictionary, one.identifier): one for one in layout.of_kind(Marker)}
    shrunk = min((SHRUNK_PIXELS / grey.size) ** 0.5, 1)
    for times in (shrunk, 1) if shrunk < 1 else (1,):
        found = decoded(grey, markers, times) if markers else []
        chart_map = _by_targets(grey, layout, found, markers, known)
        if chart_map is None and times == shrunk:
            chart_map = by_bars(grey, layout, times)
            if chart_map is not None:
                chart_map = plain(chart_map, layout, source="long bars", **known)
        if chart_map is not None:
            break
    return chart_map, len(found)


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
        guess = ChartMap.from_points(places, seen, source=source)
        rest = confirmed(grey, layout, guess, SMALLEST_CORRELATION)
        return None if rest is None else plain(rest[1], layout, source=source, **known)
    other = _other(grey, replace(chart_map, offset=(0.0, 0.0)), layout)
    charts = sum(len(group) > 1 for group in groups), 1 + (other.charts if other else 0)
    if other and side(other, layout) > side(chart_map, layout):
        chart_map = plain(other, layout, source="long bars", **known)
    return replace(chart_map, charts=max(charts))


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
