"""The alignment of a chart: print and photograph, compared without their local light.

A cubic displacement follows the bent lines that print and photograph show.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.polynomial.polynomial import polyvander2d
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_image, refuse
from mmqa_lab.chart_image.maps import Bend, ChartMap, mirrored, plain, unit
from mmqa_lab.charts import Layout, LinePairs, reflectance
from mmqa_lab.charts.draw import LUMINANCE
from mmqa_lab.charts.elements import BLACK, WHITE

__all__ = [
    "BLOCKS", "CERTAIN", "CLEARLY", "MIDDLE", "SIGMAS_PX", "SMALLEST_CORRELATION", "SPREADS",
    "Level", "align", "straight", "with_bend",
]  # fmt: skip


WHERE = "place of the chart"

SMALLEST_CORRELATION = 0.6
"""Smallest correlation of chart and image after alignment; unrelated pictures stay below 0.4."""

CERTAIN = 0.8
"""Correlation that needs no other guess; share of it that a map without a bend must reach."""

CLEARLY = 0.1
"""How much better the mirror image of a chart must correlate; some charts are symmetric."""

SIGMAS_PX, RIM_SIGMAS = (0.6, 1.2, 2.0, 3.2), 2.0
"""Point spreads of the print, pixel included, in the alignment: the one that fits best counts. As
far as so many of it reach in from the chart's edge, nothing counts."""

SLIGHT = 1e-4
"""Weight, in local means and spreads, of what does not count."""

MIDDLE, FINEST = 160, 800
"""Cells along a side, on the way and at most."""

LIGHT, LIGHT_CELLS = 0.06, 100
"""Reach of local means and spreads over the chart's side, and the cells a side on which they are
taken."""

LARGEST_BEND = 0.06
"""How far lines may be bent over their length."""

STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-6)

BLOCKS = 20
"""Blocks along a side of the chart in which the alignment looks for bent lines."""

SPREADS = 3.0
"""Number of local spreads to which larger differences are cut."""

CUBIC = [4 * i + j for i in range(4) for j in range(4 - i)]
"""Products of powers of x and y up to the third, of the sixteen up to x^3 y^3."""

BEND_GAIN, BEND_PX = 14.0, 0.4
"""How many times more than chance a bend must explain, and how far it must reach, to count."""


def align(image: ArrayLike, layout: Layout, chart_map: ChartMap) -> ChartMap:
    """Improve a map by the whole printed chart.

    In the chart's frame, photograph and print are each divided by their local mean and spread;
    OpenCV's enhanced correlation finds the homography between them, on finer and finer cells. A
    cubic displacement is added where lens or board bend lines clearly more than chance does. Fine
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
        If the chart is not found there: a correlation below 0.6, also where
        lines are bent by more than a cubic displacement takes.

    References
    ----------
    Baker and Matthews 2004, doi:10.1023/B:VISI.0000011205.11775.fd.
    Evangelidis and Psarakis 2008, doi:10.1109/TPAMI.2008.113.

    Examples
    --------
    >>> from mmqa_lab.chart_image import ChartMap
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4)[::-1]  # pixels of 4 mm
    >>> chart_map = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> wrong = ChartMap(chart_map.matrix + [[0, 0, 0.8], [0, 0, -0.6], [0, 0, 0]])
    >>> right = align(image, layout, wrong)
    >>> off = np.abs(right.pixels(layout.corners()) - chart_map.pixels(layout.corners()))
    >>> bool(off.max() < 0.1)
    True
    """
    image = check_image(image).astype(np.float32)
    found, correlation = _aligned(image, layout, chart_map, bent=True)
    if found.bend is not None:  # it must show the print better than a homography alone
        level = Level(image, layout, found, MIDDLE)
        flat, alone = level.aligned(plain(found, layout))
        if alone > CERTAIN * level.correlation(found):
            flat, alone = _aligned(image, layout, flat, bent=False)
            found, correlation = (flat, alone) if alone >= correlation else (found, correlation)
    level = Level(image, layout, found, MIDDLE)
    turned = level.correlation(mirrored(found, layout)) > level.correlation(found) + CLEARLY
    refuse(turned, "image", "the chart is mirrored", "as the camera saw it")
    bent = found.bent_share(layout) if found.bend is not None else 0.0
    lines = f"straight lines are bent by more than {LARGEST_BEND:.0%} of their length"
    told = "straighter, or a camera file must tell how the lens bends (is the chart there?)"
    refuse(bent > LARGEST_BEND, WHERE, lines, told)
    alike = f"its print correlates by {correlation:.2f} with the image"
    there = "(is the chart there, not mirrored, and are its lines straight?)"
    differs = not correlation >= SMALLEST_CORRELATION
    refuse(differs, WHERE, alike, f"{SMALLEST_CORRELATION} or more {there}")
    return replace(found, source=f"{found.source}, aligned")


def _aligned(image, layout, chart_map, *, bent):
    """An aligned map, a homography alone if it may not be bent, and its correlation."""
    finest = min(int(layout.width / _pixel_mm(layout, chart_map)), FINEST)
    for along in sorted({min(along, finest) for along in (30, 60, MIDDLE)}):
        level = Level(image, layout, chart_map, along)
        if along > 30:
            chart_map, _ = level.aligned(chart_map)
        chart_map = with_bend(level, chart_map) if bent else chart_map
    chart_map = straight(chart_map, layout)
    level = Level(image, layout, chart_map, max(finest, 12))
    chart_map, _ = level.aligned(chart_map)
    sigma, top = _point_spread(level, chart_map)
    if level.behind(sigma).correlation(chart_map) > CERTAIN:  # nothing large stands before it
        level.behind(top).as_seen(chart_map)
    chart_map, _ = level.aligned(chart_map)
    chart_map = straight(with_bend(level, chart_map) if bent else chart_map, layout)
    return replace(chart_map, blur_px=sigma), level.correlation(chart_map)


def _point_spread(level, chart_map):
    """The point spread that fits best, and where between its neighbours the best one would lie."""
    fits = [level.behind(sigma).correlation(chart_map) for sigma in SIGMAS_PX]
    best = int(np.argmax(fits))
    if best == 0:
        return SIGMAS_PX[0], SIGMAS_PX[0]
    # the top of a parabola through three
    around = slice(low := min(best - 1, len(fits) - 3), low + 3)
    curve, slope, _ = np.polyfit(np.log(SIGMAS_PX[around]), fits[around], 2)
    top = np.exp(-slope / (2 * curve)) if curve < 0 else SIGMAS_PX[best]
    return SIGMAS_PX[best], float(np.clip(top, SIGMAS_PX[0], SIGMAS_PX[-1]))


def _pixel_mm(layout, chart_map):
    """Millimetres of a pixel, in the median of the corners."""
    return float(np.median(chart_map.pixel_sizes_mm(layout.corners())))


class Level:
    """Print and photograph in the chart's frame, on so many cells a side.

    Both are divided by their own local mean and spread, so that light and shadow do not count.
    """

    def __init__(self, image, layout, chart_map, along):
        outline, size = chart_map.outline(layout.corners()), np.array(image.shape[::-1])
        self.size, self.pixel_mm = (layout.width, layout.height), _pixel_mm(layout, chart_map)
        self.cell = layout.width / along
        soft = max(self.cell / self.pixel_mm / 2.5, 0.3)
        # a homography may move by a tenth of the chart
        margin = 3 * soft + 0.1 * np.ptp(outline, axis=0) + 2
        first = np.clip(outline.min(axis=0) - margin, 0, size - 2).astype(int)
        last = np.clip(outline.max(axis=0) + margin, first + 2, size).astype(int)
        window = image[first[1] : last[1], first[0] : last[0]].astype(np.float32)
        self.image = cv2.GaussianBlur(window, (0, 0), soft)
        self.first, self.last = first, size - 1
        self.print = _print(layout, self.cell)
        self.trusted = _trusted(layout, self.pixel_mm, self.cell, self.print.shape)
        self.layout, self.least = layout, 1.0
        y, x = (np.indices(self.print.shape) + 0.5) * self.cell
        self.places = np.column_stack([x.ravel(), y.ravel()])
        self.behind(SIGMAS_PX[0])

    def behind(self, sigma_px):
        """The level itself, its print as behind a point spread."""
        self.blur = np.hypot(sigma_px * self.pixel_mm / self.cell, 0.5)
        # up to there pixels see what is beyond the chart
        self.rim = int(np.ceil(RIM_SIGMAS * self.blur))
        self.counts = np.ones(self.print.shape, np.float32)
        rim = min(self.rim, min(self.counts.shape) // 4)
        for rows in (self.counts, self.counts.T):
            rows[:rim] = rows[-rim:] = 0
        return self._blurred()

    def _blurred(self):
        """The level itself, its print blurred and without its local light."""
        self.weight = np.maximum(self.counts, self.least)
        blurred = cv2.GaussianBlur(self.print, (0, 0), self.blur)
        self.printed = _standardised(blurred, self.weight)
        return self

    def as_seen(self, chart_map):
        """The level itself, its greys as the photograph shows them: printers print others.

        From now on local means leave out what sees beyond the chart.
        """
        self.least = SLIGHT
        # what is black or white tells which light is which tone
        weight = np.maximum(self.counts * self._free_of_greys(), SLIGHT)
        mean, spread = _local(cv2.GaussianBlur(self.print, (0, 0), self.blur), weight)
        tones = mean + spread * _standardised(self._photograph(chart_map)[0], weight)
        known, greys = {BLACK: BLACK, WHITE: WHITE}, _greys(self.layout)
        for tone in greys:
            plain = (np.abs(self.print - tone) < 1e-3) & (self.counts > 0)
            depth = cv2.distanceTransform(np.uint8(plain), cv2.DIST_L2, 5)
            if depth.max() > self.rim / 2:
                deep = depth >= min(self.rim, 0.8 * depth.max())
                known[tone] = float(np.clip(np.median(tones[deep]), BLACK, WHITE))
        # those of letters lie between
        places, light = zip(*sorted(known.items()), strict=True)
        known = {tone: float(np.interp(tone, places, light)) for tone in greys}
        self.print = reflectance(_toned(self.layout, known), cell=self.cell)
        return self._blurred()

    def _free_of_greys(self):
        """Cells that no grey reaches, 0 or 1; all, if that leaves less than half of the black."""
        black = _toned(self.layout, dict.fromkeys(_greys(self.layout), BLACK))
        greys = np.abs(self.print - reflectance(black, cell=self.cell)) > 1e-3
        reach = np.ones((2 * self.rim + 1, 2 * self.rim + 1), np.uint8)
        free = 1 - cv2.dilate(np.uint8(greys), reach)
        shadow = 1 - self.print
        return free if (shadow * free).sum() > shadow.sum() / 2 else np.ones_like(free)

    def seen(self, chart_map):
        """The photograph as a map puts it, and which cells count."""
        seen, inside = self._photograph(chart_map)
        seen = _standardised(seen, self.weight)
        return seen, (self.trusted * inside * self.counts).astype(np.uint8)

    def _photograph(self, chart_map):
        """The photograph as a map puts it, and which cells lie within it."""
        pixels = chart_map.pixels(self.places)
        inside = ((pixels >= 0) & (pixels <= self.last)).all(axis=1).reshape(self.print.shape)
        pixels = np.float32(pixels - self.first).reshape(*self.print.shape, 2)
        how = {"interpolation": cv2.INTER_LINEAR, "borderMode": cv2.BORDER_REPLICATE}
        return cv2.remap(self.image, pixels, None, **how), inside

    def correlation(self, chart_map):
        """Of print and photograph."""
        return _correlation(self.printed, *self.seen(chart_map))

    def aligned(self, chart_map):
        """A map after OpenCV's enhanced correlation, and the correlation."""
        seen, trusted = self.seen(chart_map)
        start = np.eye(3, dtype=np.float32)
        try:
            _, warp = cv2.findTransformECC(
                self.printed, seen, start, cv2.MOTION_HOMOGRAPHY, STOP, trusted, 1
            )
        except cv2.error:  # nothing in common
            warp = np.eye(3)
        size = {"dsize": seen.shape[::-1], "flags": cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP}
        moved = cv2.warpPerspective(seen, warp, **size)
        half = self.cell / 2
        to_mm = np.array([[self.cell, 0, half], [0, self.cell, half], [0, 0, 1]])
        change = to_mm @ warp @ np.linalg.inv(to_mm)
        better = replace(chart_map, matrix=chart_map.matrix @ change)
        return better, _correlation(self.printed, moved, trusted)


def _correlation(printed, seen, trusted):
    """Correlation of two standardised images where they are trusted."""
    one, two = (np.clip(part, -SPREADS, SPREADS)[trusted > 0] for part in (seen, printed))
    return float(one @ two / max(np.linalg.norm(one) * np.linalg.norm(two), 1e-12))


@lru_cache(maxsize=4)
def _print(layout, cell):
    """The reflectance of a chart, kept for the next steps."""
    return reflectance(layout, cell=cell)


def _greys(layout):
    """The tones of a chart between black and white, those of colours too."""
    return {_light(tone) for one in layout.elements for tone in _own(one)} - {BLACK, WHITE}


def _own(element):
    """The tones of an element and of what is around it."""
    tones = [getattr(element, name) for name in ("tone", "ground") if hasattr(element, name)]
    return tones + [tone for row in getattr(element, "rows", ()) for tone in row]


def _light(tone):
    """The reflectance of a grey or a colour."""
    return float(np.dot(LUMINANCE, tone)) if isinstance(tone, tuple) else tone


def _toned(layout, known):
    """A layout with other tones in place of some."""

    def other(tone):
        return known.get(_light(tone), tone)

    elements = []
    for one in layout.elements:
        tones = {
            name: other(getattr(one, name)) for name in ("tone", "ground") if hasattr(one, name)
        }
        if hasattr(one, "rows"):
            tones["rows"] = tuple(tuple(map(other, row)) for row in one.rows)
        elements.append(replace(one, **tones))
    return replace(layout, elements=tuple(elements))


def _standardised(tones, weight):
    """Tones less their local mean, in local spreads."""
    mean, spread = _local(tones, weight)
    return (tones - mean) / spread


def _local(tones, weight):
    """Local means and spreads."""
    mean = _around(tones, weight)
    spread = np.sqrt(np.maximum(_around((tones - mean) ** 2, weight), 0))
    return mean, np.maximum(spread, 0.1 * spread.max() + 1e-12)


def _around(tones, weight):
    """Local weighted means of an image of the chart; they change slowly."""
    size = [min(side, LIGHT_CELLS) for side in tones.shape[::-1]]

    def smooth(part):
        small = cv2.resize(part, size, interpolation=cv2.INTER_AREA)
        return cv2.GaussianBlur(small, (0, 0), LIGHT * size[0])

    local = smooth(tones * weight) / smooth(weight)
    return cv2.resize(local, tones.shape[::-1], interpolation=cv2.INTER_LINEAR)


def _trusted(layout, pixel_mm, cell, shape):
    """Which cells may take part in the alignment."""
    trusted = np.ones(shape, dtype=np.float32)
    for pairs in layout.of_kind(LinePairs):
        if pairs.pair / pixel_mm < 2.5:  # aliased, they would mislead
            low, high = pairs.corners()[[0, 2]] / cell
            low, high = np.maximum(low - 2, 0).astype(int), np.ceil(high + 2).astype(int)
            trusted[low[1] : high[1], low[0] : high[0]] = 0
    return trusted


def with_bend(level, chart_map):
    """Return a map with the cubic displacement that print and photograph show, if they show one.

    Blocks of the chart ask for shifts (Lucas and Kanade); those that differ from the print,
    behind a post or at a shadow's edge, count little.
    """
    places = (np.indices((BLOCKS, BLOCKS))[::-1].reshape(2, -1).T + 0.5) / BLOCKS * level.size
    design = polyvander2d(*unit(places, level.size), (3, 3))[:, CUBIC]
    for _ in range(8):
        seen, trusted = level.seen(chart_map)
        # close to the chart's edge, pixels see what is beyond
        trusted[:2] = trusted[-2:] = trusted[:, :2] = trusted[:, -2:] = 0
        change, gain = _shifts(level.printed, seen, trusted, design)
        far = np.abs(design @ change).max() * level.cell / max(level.pixel_mm, level.cell)
        if chart_map.bend is None and (gain < BEND_GAIN or far < BEND_PX):
            break
        terms = np.zeros((16, 2))
        terms[CUBIC] = change * level.cell
        terms = terms.reshape(4, 4, 2)
        if chart_map.bend is not None:
            terms = terms + chart_map.bend.terms
        chart_map = replace(chart_map, bend=Bend(level.size, terms))
        if gain < 1 or far < 0.02:
            break
    return chart_map


def straight(chart_map, layout):
    """Return a map without its bend where a homography does as well."""
    flat, outline = plain(chart_map, layout), layout.corners()
    leaves = flat.outline(outline) - chart_map.outline(outline)
    return chart_map if np.linalg.norm(leaves, axis=1).max() > BEND_PX else flat


def _shifts(printed, seen, trusted, design):
    """Terms of the displacement, cells, and what they explain beyond chance per term."""
    down, right = np.gradient(seen)
    parts = [right, down, np.clip(printed - seen, -SPREADS, SPREADS)]
    sums = np.array([[one * two * trusted for one in parts] for two in parts]).reshape(9, -1)
    size = {"dsize": (BLOCKS, BLOCKS), "interpolation": cv2.INTER_AREA}
    sums = np.stack([cv2.resize(part.reshape(seen.shape), **size).ravel() for part in sums], axis=1)
    sums = sums.reshape(-1, 3, 3)
    slopes, asked, before = sums[:, :2, :2], sums[:, :2, 2], sums[:, 2, 2]
    weight = np.ones(len(sums))
    for _ in range(8):
        # normal equations over blocks b: terms i and l of the displacement along axes j and k
        matrix = np.einsum("b,bi,bjk,bl->ijlk", weight, design, slopes, design)
        matrix = matrix.reshape(2 * design.shape[1], -1)
        wanted = np.einsum("b,bi,bj->ij", weight, design, asked)
        matrix += 1e-6 * np.trace(matrix) * np.eye(len(matrix))
        change = np.linalg.solve(matrix, wanted.ravel()).reshape(-1, 2)
        shift = design @ change
        left = before - 2 * (shift * asked).sum(1) + np.einsum("bi,bij,bj->b", shift, slopes, shift)
        typical = max(np.median(left[before > 0]), 1e-12) if before.any() else 1.0
        weight = 1 / (1 + (np.maximum(left, 0) / (2 * typical)) ** 2)
    explained, rest = weight @ (before - left), max(weight @ left, 1e-12)
    return change, float(explained / change.size / (rest / (2 * len(sums))))
