"""Where a chart is in an image: from millimetres to pixels, and how a chart is found.

Pixels are (column, row), the centre of the first one at (0, 0). The camera looks along its z axis,
x to the right, y down. A plane chart maps to rays by one 3 x 3 matrix; the camera bends rays into
pixels. Without a camera the map is a homography; a panorama is exactly spherical, and a calibrated
lens bends as it says.

Targets and bars say where a chart may be. Print and photograph, compared without their local light,
then say where it is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import combinations

import cv2
import numpy as np
from numpy.polynomial.polynomial import polyval2d, polyvander2d
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from mmqa_lab._checks import check_image, check_points, check_positive, refuse
from mmqa_lab.charts import Bar, Layout, LinePairs, Marker, reflectance

__all__ = [
    "BLOCKS", "SIGMAS_PX", "Bend", "ChartMap", "LensCamera", "PanoramaCamera", "align",
    "four_corners", "locate",
]  # fmt: skip

WHERE = "place of the chart"

ENLARGEMENTS, ENLARGED_PIXELS, SHRUNK_PIXELS, OTHERS_PIXELS = (1, 2, 4), 4e6, 25e6, 6e6
"""Factors of enlargement for small targets, and the number of pixels up to which they are used;
targets are sought in larger images than the next one made that small first; a second chart without
targets in images of the last one: there it must be 50 pixels wide."""

SLENDEREST, MOST_STREAKS = 6.0, 1500
"""Least length of a dark streak over its width to count as a bar; number of streaks at most."""

SMALLEST_CORRELATION = 0.6
"""Smallest correlation of chart and image after alignment; unrelated pictures stay below 0.4."""

PROMISING, LIKELY, CERTAIN = 0.3, 0.65, 0.8
"""Correlations of a guess: least before alignment, least after it, and enough to try no other."""

GLANCE_CELLS = 80
"""Cells along a side of the chart where a first guess is compared with the image."""

SIGMAS_PX = (0.6, 1.2, 2.0)
"""Point spreads of the print, pixel included, in the alignment: the one that fits best counts."""

MIDDLE, FINEST = 160, 800
"""Cells along a side, on the way and at most."""

LIGHT, LIGHT_CELLS, SPREADS = 0.06, 100, 3.0
"""Reach of local means and spreads over the chart's side, and the cells a side on which they are
taken; number of spreads to which larger values are cut."""

BLOCKS = 20
"""Blocks along a side of the chart in which the alignment looks for bent lines."""

CUBIC = [4 * i + j for i in range(4) for j in range(4 - i)]
"""Products of powers of x and y up to the third, of the sixteen up to x^3 y^3."""

BEND_GAIN, BEND_PX = 14.0, 0.4
"""How many times more than chance a bend must explain, and how far it must reach, to count."""

UNDISTORT = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-10)
LARGEST_BEND = 0.06
"""How far lines may be bent over their length."""

STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-6)


@dataclass(frozen=True)
class PanoramaCamera:
    """An equirectangular panorama: columns are equal steps of azimuth, rows of elevation.

    The middle of the image is the z axis. ``height`` is half of ``width``.

    Parameters
    ----------
    width : int
        Pixels of the whole turn.

    Examples
    --------
    >>> round(PanoramaCamera.of_megapixels(30).pixel_size_mm(10), 2)
    8.11
    """

    width: int

    @classmethod
    def of_megapixels(cls, megapixels: float) -> PanoramaCamera:
        """Return the panorama with N megapixels: width sqrt(2 N)."""
        megapixels = check_positive(megapixels, "megapixels")
        return cls(2 * round(np.sqrt(2e6 * megapixels) / 2))

    @property
    def height(self) -> int:
        """Number of rows."""
        return self.width // 2

    def pixel_size_mm(self, distance: float) -> float:
        """Return the size of a pixel on a sphere ``distance`` metres away, mm."""
        return 2000 * np.pi * check_positive(distance, "distance", unit="m") / self.width

    def pixels(self, rays: ArrayLike) -> np.ndarray:
        """Return the pixels of rays, shape (n, 2)."""
        x, y, z = np.asarray(rays, dtype=float).T
        azimuth, elevation = np.arctan2(x, z), np.arctan2(-y, np.hypot(x, z))
        step = self.width / (2 * np.pi)
        column, row = self.width / 2 + azimuth * step, self.height / 2 - elevation * step
        return np.column_stack([column, row]) - 0.5

    def rays(self, pixels: ArrayLike) -> np.ndarray:
        """Return the directions of pixels as unit vectors, shape (n, 3)."""
        column, row = np.asarray(pixels, dtype=float).T
        step = 2 * np.pi / self.width
        azimuth = (column + 0.5 - self.width / 2) * step
        elevation = (self.height / 2 - row - 0.5) * step
        level = np.cos(elevation)
        across, ahead = level * np.sin(azimuth), level * np.cos(azimuth)
        return np.column_stack([across, -np.sin(elevation), ahead])


@dataclass(frozen=True, eq=False)
class LensCamera:
    """A calibrated lens that bends lines, by OpenCV's model.

    Parameters
    ----------
    matrix : array, shape (3, 3)
        Focal lengths and principal point, pixels.
    distortion : array, shape (n,)
        OpenCV's coefficients; :func:`mmqa_lab.io.read_camera` reads both.

    Examples
    --------
    >>> lens = LensCamera(np.array([[900.0, 0, 320], [0, 900, 240], [0, 0, 1]]), np.zeros(4))
    >>> lens.pixels([[0.1, 0.0, 1.0]]).round(6).tolist()
    [[410.0, 240.0]]
    """

    matrix: np.ndarray
    distortion: np.ndarray

    def pixels(self, rays: ArrayLike) -> np.ndarray:
        """Return the pixels of rays, shape (n, 2)."""
        rays, turn = np.array(rays, dtype=float), np.zeros(3)
        rays *= np.sign(rays[:, 2:])
        return cv2.projectPoints(rays, turn, turn, self.matrix, self.distortion)[0][:, 0]

    def rays(self, pixels: ArrayLike) -> np.ndarray:
        """Return the directions of pixels, shape (n, 3)."""
        pixels = np.array(pixels, dtype=float).reshape(-1, 1, 2)
        flat = cv2.undistortPoints(pixels, self.matrix, self.distortion, criteria=UNDISTORT)
        return np.insert(flat[:, 0], 2, 1.0, axis=1)


@dataclass(frozen=True, eq=False)
class Bend:
    """A cubic displacement on a chart: what a lens or a board adds to a homography.

    Parameters
    ----------
    size : (float, float)
        Width and height of the chart, mm.
    terms : array, shape (4, 4, 2)
        Displacement in x and y, mm, for each power of x and of y, which run from -1 to 1.
    """

    size: tuple
    terms: np.ndarray

    def at(self, xy):
        """Displacement at places, mm, shape (n, 2); it ends a quarter beyond the chart."""
        return polyval2d(*_unit(xy, self.size), self.terms).T


@dataclass(frozen=True, eq=False)
class ChartMap:
    """Where each place of a chart is in an image.

    Parameters
    ----------
    matrix : array, shape (3, 3)
        Takes (x, y, 1) in mm on the chart to a ray of the camera.
    camera : PanoramaCamera or LensCamera, optional
        Without one, rays are pixels: column, row, 1 and a common factor.
    offset : (float, float)
        Column and row that count as (0, 0), for a window of an image.
    source : str
        What the map was made from.
    bend : Bend, optional
        Is added to places before the matrix.
    charts : int
        That were seen in the image; this is the largest.

    Raises
    ------
    ValueError
        From ``from_points``: if they do not fit one chart.

    Examples
    --------
    >>> chart_map = ChartMap(np.array([[0.25, 0, 0], [0, -0.25, 250], [0, 0, 1]]))
    >>> chart_map.pixels([[100, 200]]).tolist()
    [[25.0, 200.0]]
    >>> chart_map.pixel_sizes_mm([[100, 200]]).round(6).tolist()
    [[4.0, 4.0]]
    """

    matrix: np.ndarray
    camera: PanoramaCamera | LensCamera | None = None
    offset: tuple = (0.0, 0.0)
    source: str = "given"
    bend: Bend | None = None
    charts: int = 1

    @classmethod
    def from_points(
        cls,
        xy: ArrayLike,
        pixels: ArrayLike,
        *,
        camera: PanoramaCamera | LensCamera | None = None,
        offset: tuple[float, float] = (0.0, 0.0),
        source: str = "points",
    ) -> ChartMap:
        """Fit the map to four or more points by least squares.

        Parameters
        ----------
        xy : array_like, shape (n, 2)
            Places on the chart, mm.
        pixels : array_like, shape (n, 2)
            Where they are in the image.
        camera, offset, source
            As for the class.

        Examples
        --------
        >>> corners = [[0, 0], [1000, 0], [1000, 1000], [0, 1000]]
        >>> chart_map = ChartMap.from_points(corners, [[10, 90], [90, 90], [90, 10], [10, 10]])
        >>> chart_map.pixels([[500, 500]]).round(6).tolist()
        [[50.0, 50.0]]
        """
        xy = check_points(xy, name="chart points", columns=2, minimum=4)
        pixels = check_points(pixels, name="pixels", columns=2, minimum=4)
        turn, flat = np.eye(3), pixels + offset
        if camera is not None:
            # rays become points of the plane across their mean direction
            rays = camera.rays(pixels + offset)
            rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
            turn = Rotation.align_vectors([[0, 0, 1]], rays.mean(axis=0)[None])[0].as_matrix()
            turned = rays @ turn.T
            flat = turned[:, :2] / turned[:, 2:]
        homography, _ = cv2.findHomography(xy, flat, 0)
        fits = homography is not None and _same_orientation(homography, xy)
        refuse(not fits, source, "no chart fits", "four corners in order")
        return cls(turn.T @ homography, camera, tuple(offset), source=source)

    def pixels(self, xy: ArrayLike) -> np.ndarray:
        """Return the pixels of chart places, shape (n, 2)."""
        xy = np.asarray(xy, dtype=float)
        xy = xy if self.bend is None else xy + self.bend.at(xy)
        if self.camera is None:
            return _projected(self.matrix, xy) - self.offset
        rays = np.column_stack([xy, np.ones(len(xy))]) @ self.matrix.T
        return self.camera.pixels(rays) - self.offset

    def chart(self, pixels: ArrayLike) -> np.ndarray:
        """Return the chart places of pixels, mm, shape (n, 2)."""
        pixels = np.asarray(pixels, dtype=float) + self.offset
        back = np.linalg.inv(self.matrix)
        if self.camera is None:
            flat = _projected(back, pixels)
        else:
            rays = self.camera.rays(pixels) @ back.T
            flat = rays[:, :2] / rays[:, 2:]
        if self.bend is None:
            return flat
        places = flat - self.bend.at(flat)
        for _ in range(30):  # each step leaves less than half of the error
            before, places = places, flat - self.bend.at(places)
            if np.abs(places - before).max(initial=0) < 1e-5 * self.bend.size[0]:
                break
        return places

    def outline(self, corners: ArrayLike) -> np.ndarray:
        """Return the pixels along a closed outline on the chart, eight steps a side, (n, 2)."""
        begin, step = np.asarray(corners, dtype=float)[:, None], np.arange(8)[:, None] / 8
        sides = begin + step * (np.roll(begin, -1, axis=0) - begin)
        return self.pixels(sides.reshape(-1, 2))

    def bent_share(self, layout: Layout) -> float:
        """Return how far the chart's sides leave straight lines, over their length."""
        sides = self.outline(layout.corners()).reshape(4, 8, 2)
        along = np.roll(sides[:, 0], -1, axis=0) - sides[:, 0]
        way = np.stack([-along[:, 1], along[:, 0]], axis=1) / (along**2).sum(axis=1)[:, None]
        off = np.einsum("sij,sj->si", sides - sides[:, :1], way)
        return float(np.abs(off).max())

    def within(self, column: float, row: float) -> ChartMap:
        """Return the map for a window of the image that begins at this column and row."""
        return replace(self, offset=tuple(np.add(self.offset, [column, row])))

    def pixel_sizes_mm(self, xy: ArrayLike) -> np.ndarray:
        """Return the millimetres per pixel along x and along y at chart places, shape (n, 2)."""
        xy, steps = np.asarray(xy, dtype=float), np.eye(2) / 2
        ends = [self.pixels(xy + step) - self.pixels(xy - step) for step in steps]
        return 1 / np.linalg.norm(ends, axis=2).T


def _projected(matrix, xy):
    """Plane places under a homography, shape (n, 2)."""
    xy = np.array(xy, dtype=float).reshape(-1, 1, 2)
    return cv2.perspectiveTransform(xy, matrix)[:, 0] if len(xy) else xy[:, 0]


def _unit(xy, size):
    """Places as x and y from -1 to 1 over the chart."""
    return np.clip(2 * np.asarray(xy, dtype=float) / size - 1, -1.5, 1.5).T


def _same_orientation(homography, xy):
    """Whether a homography keeps all points on one side and turns up to down, as images do."""
    depth = np.column_stack([xy, np.ones(len(xy))]) @ homography[2]
    turned = np.linalg.det(homography / np.sign(depth[0])) < 0
    return bool((depth * depth[0] > 0).all() and turned)


def four_corners(corners, *, columns):
    """Four corners as an array, checked."""
    corners = check_points(corners, name="corners", columns=columns, minimum=4)
    refuse(len(corners) != 4, "corners", f"{len(corners)} given", "four")
    return corners


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
    dark streaks are paired as if they were two of the long bars, and the best pair is aligned.

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
        If there are not four corners in this order, or neither targets nor long bars are found.

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
    place = partial(ChartMap.from_points, camera=camera, offset=offset)
    if corners is not None:
        corners = four_corners(corners, columns=2)
        return place(layout.corners(), corners, source="corners")
    grey, by_bars = _stretched(image), {"source": "long bars", "camera": camera, "offset": offset}
    markers = {marker.identifier: marker for marker in layout.of_kind(Marker)}
    shrunk = min((SHRUNK_PIXELS / grey.size) ** 0.5, 1)
    for times in (shrunk, 1) if shrunk < 1 else (1,):
        found = _decoded(grey, markers, times) if markers else []
        groups = _by_chart(found, markers, layout)
        if len(dict(found)) == len(found) > 2 and len(groups) > 1:  # a lens moves them apart
            groups = [found]
        if groups and len(groups[0]) > 2:
            # OpenCV counts from the upper left corner, clockwise
            places = np.concatenate([markers[key].corners()[::-1] for key, _ in groups[0]])
            seen = np.concatenate([corners for _, corners in groups[0]])
            source = f"{len(groups[0])} coded targets"
            chart_map = place(places, seen, source=source)
            other = _other(grey, chart_map, layout)
            charts = sum(len(group) > 1 for group in groups), 1 + (other.charts if other else 0)
            if other and _side(other, layout) > _side(chart_map, layout):
                chart_map = _plain(other, layout, **by_bars)
            return replace(chart_map, charts=max(charts))
        chart_map = _by_bars(grey, layout, times) if times == shrunk else None
        if chart_map is not None:
            return _plain(chart_map, layout, **by_bars)
    seen = f"{len(found)} of {len(markers)} coded targets and no long bars found"
    must = "show the whole chart, not cut by the border, or its corners must be given"
    raise ValueError(f"Invalid image: {seen}. Must {must}.")


def _decoded(grey, markers, smaller):
    """Numbers and corners of the coded targets that are seen in an image made smaller."""
    dictionary = next(iter(markers.values())).dictionary
    book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_CONTOUR
    best = []
    for times in ENLARGEMENTS if grey.size <= ENLARGED_PIXELS else (smaller,):
        way = cv2.INTER_CUBIC if times > 1 else cv2.INTER_AREA
        large = cv2.resize(grey, None, fx=times, fy=times, interpolation=way)
        # targets of less than 6 px a side cannot be decoded, their contours would cost time
        settings.minMarkerPerimeterRate = 24 * times / max(large.shape)
        corners, numbers, _ = cv2.aruco.ArucoDetector(book, settings).detectMarkers(large)
        places = [(seen.reshape(4, 2).astype(float) + 0.5) / times - 0.5 for seen in corners]
        numbers = [] if numbers is None else np.ravel(numbers).tolist()
        ours = [one for one in zip(numbers, places, strict=True) if one[0] in markers]
        # a mirrored square is none of the chart's targets
        found = [one for one in ours if np.linalg.det(one[1][1:3] - one[1][:2]) > 0]
        best = max(best, found, key=len)
        # a fifth target is one of another chart, whose others are smaller
        if best and len(best) % len(markers) == 0:
            break
    return best


def _by_chart(found, markers, layout):
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


def _other(grey, chart_map, layout):
    """The largest of other charts, whose targets may be too small or blurred, or None.

    Paints over the one that is known.
    """
    outline = chart_map.outline(layout.corners()).round().astype(np.int32)
    factor = min((OTHERS_PIXELS / grey.size) ** 0.5, 1)
    return _by_bars(cv2.fillPoly(grey, [outline], cv2.mean(grey)), layout, factor)


def _side(chart_map, layout):
    """Length of a chart's longer side in the image, pixels."""
    return np.ptp(chart_map.pixels(layout.corners()), axis=0).max()


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


def align(image, layout, chart_map):
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
        level = _Level(image, layout, found, MIDDLE)
        plain, alone = level.aligned(_plain(found, layout))
        if alone > CERTAIN * level.correlation(found):
            plain, alone = _aligned(image, layout, plain, bent=False)
            found, correlation = (plain, alone) if alone >= correlation else (found, correlation)
    bent = found.bent_share(layout) if found.bend is not None else 0.0
    lines = f"straight lines are bent by {bent:.1%} of their length"
    told = "or a camera file must tell how the lens bends (is the chart there?)"
    refuse(bent > LARGEST_BEND, WHERE, lines, f"less than {LARGEST_BEND:.0%}, {told}")
    alike = f"its print correlates by {correlation:.2f} with the image"
    there = "(is the chart there, not mirrored, and are its lines straight?)"
    differs = not correlation >= SMALLEST_CORRELATION
    refuse(differs, WHERE, alike, f"{SMALLEST_CORRELATION} or more {there}")
    return replace(found, source=f"{found.source}, aligned")


def _aligned(image, layout, chart_map, *, bent):
    """An aligned map, a homography alone if it may not be bent, and its correlation."""
    finest = min(int(layout.width / _pixel_mm(layout, chart_map)), FINEST)
    for along in sorted({min(along, finest) for along in (30, 60, MIDDLE)}):
        level = _Level(image, layout, chart_map, along)
        if along > 30:
            chart_map, _ = level.aligned(chart_map)
        chart_map = level.bent(chart_map) if bent else chart_map
    chart_map = _straight(chart_map, layout)
    level = _Level(image, layout, chart_map, max(finest, 12))
    chart_map, _ = level.aligned(chart_map)
    sigma = max(SIGMAS_PX, key=lambda sigma: level.behind(sigma).correlation(chart_map))
    chart_map, _ = level.behind(sigma).aligned(chart_map)
    chart_map = _straight(level.bent(chart_map) if bent else chart_map, layout)
    return chart_map, level.correlation(chart_map)


def _pixel_mm(layout, chart_map):
    """Millimetres of a pixel, in the median of the corners."""
    return float(np.median(chart_map.pixel_sizes_mm(layout.corners())))


class _Level:
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
        y, x = (np.indices(self.print.shape) + 0.5) * self.cell
        self.places = np.column_stack([x.ravel(), y.ravel()])
        self.behind(SIGMAS_PX[0])

    def behind(self, sigma_px):
        """The level itself, its print as behind a point spread."""
        blur = np.hypot(sigma_px * self.pixel_mm / self.cell, 0.5)
        self.printed = _standardised(cv2.GaussianBlur(self.print, (0, 0), blur))
        return self

    def seen(self, chart_map):
        """The photograph as a map puts it, and which cells count."""
        pixels = chart_map.pixels(self.places)
        inside = ((pixels >= 0) & (pixels <= self.last)).all(axis=1).reshape(self.printed.shape)
        pixels = np.float32(pixels - self.first).reshape(*self.printed.shape, 2)
        how = {"interpolation": cv2.INTER_LINEAR, "borderMode": cv2.BORDER_REPLICATE}
        seen = _standardised(cv2.remap(self.image, pixels, None, **how))
        return seen, (self.trusted * inside).astype(np.uint8)

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

    def bent(self, chart_map):
        """A map with the cubic displacement that print and photograph show, if they show one.

        Blocks of the chart ask for shifts (Lucas and Kanade); those that differ from the print,
        behind a post or at a shadow's edge, count little.
        """
        places = (np.indices((BLOCKS, BLOCKS))[::-1].reshape(2, -1).T + 0.5) / BLOCKS * self.size
        design = polyvander2d(*_unit(places, self.size), (3, 3))[:, CUBIC]
        for _ in range(8):
            seen, trusted = self.seen(chart_map)
            # close to the chart's edge, pixels see what is beyond
            trusted[:2] = trusted[-2:] = trusted[:, :2] = trusted[:, -2:] = 0
            change, gain = _shifts(self.printed, seen, trusted, design)
            far = np.abs(design @ change).max() * self.cell / max(self.pixel_mm, self.cell)
            if chart_map.bend is None and (gain < BEND_GAIN or far < BEND_PX):
                break
            terms = np.zeros((16, 2))
            terms[CUBIC] = change * self.cell
            terms = terms.reshape(4, 4, 2)
            if chart_map.bend is not None:
                terms = terms + chart_map.bend.terms
            chart_map = replace(chart_map, bend=Bend(self.size, terms))
            if gain < 1 or far < 0.02:
                break
        return chart_map


def _correlation(printed, seen, trusted):
    """Correlation of two standardised images where they are trusted."""
    one, two = (np.clip(part, -SPREADS, SPREADS)[trusted > 0] for part in (seen, printed))
    return float(one @ two / max(np.linalg.norm(one) * np.linalg.norm(two), 1e-12))


@lru_cache(maxsize=4)
def _print(layout, cell):
    """The reflectance of a chart, kept for the next steps."""
    return reflectance(layout, cell=cell)


def _plain(chart_map, layout, **other):
    """The homography nearest to a map, of the same camera or of another."""
    mesh = np.indices((5, 5)).reshape(2, -1).T / 4 * [layout.width, layout.height]
    known = {name: getattr(chart_map, name) for name in ("camera", "offset", "source")}
    plain = ChartMap.from_points(mesh, chart_map.pixels(mesh), **(known | other))
    return replace(plain, charts=chart_map.charts)


def _straight(chart_map, layout):
    """A map without its bend where a homography does as well."""
    plain, outline = _plain(chart_map, layout), layout.corners()
    leaves = plain.outline(outline) - chart_map.outline(outline)
    return chart_map if np.linalg.norm(leaves, axis=1).max() > BEND_PX else plain


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


def _standardised(tones):
    """Tones less their local mean, in local spreads."""
    off = tones - _around(tones)
    spread = np.sqrt(np.maximum(_around(off**2), 0))
    return off / np.maximum(spread, 0.1 * spread.max() + 1e-12)


def _around(tones):
    """Local means of an image of the chart; they change slowly."""
    size = [min(side, LIGHT_CELLS) for side in tones.shape[::-1]]
    small = cv2.resize(tones, size, interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), LIGHT * size[0])
    return cv2.resize(small, tones.shape[::-1], interpolation=cv2.INTER_LINEAR)


def _trusted(layout, pixel_mm, cell, shape):
    """Which cells may take part in the alignment."""
    trusted = np.ones(shape, dtype=np.float32)
    for pairs in layout.of_kind(LinePairs):
        if pairs.pair / pixel_mm < 2.5:  # aliased, they would mislead
            low, high = pairs.corners()[[0, 2]] / cell
            low, high = np.maximum(low - 2, 0).astype(int), np.ceil(high + 2).astype(int)
            trusted[low[1] : high[1], low[0] : high[0]] = 0
    return trusted


def _by_bars(grey, layout, smaller):
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
        side = _side(chart_map, layout)
        apart = [np.ptp([chart_map.pixels(middle), at], axis=0).max() for at, _, _ in charts]
        if not any(distance < side / 2 for distance in apart):
            charts.append((chart_map.pixels(middle), side, chart_map))
    return replace(max(charts, key=lambda chart: chart[1])[2], charts=len(charts))


def _guesses(grey, layout, bars):
    """Correlations and aligned maps of the charts that streaks suggest."""
    scored = _glanced(grey, layout, _suggested(_streaks(grey), bars))
    best, found = sorted(scored, key=lambda guess: -guess[0])[:6], []
    for chart_map in [chart_map for first, chart_map in best if first > PROMISING]:
        for along in (60, 160):
            outline = chart_map.outline(layout.corners())
            if not ((outline > -2) & (outline < np.array(grey.shape[::-1]) + 1)).all():
                break
            chart_map, correlation = _Level(grey, layout, chart_map, along).aligned(chart_map)
        else:
            wide = np.ptp(chart_map.pixels(layout.corners()), axis=0)
            if correlation > LIKELY and wide.prod() > 50**2:  # a smaller chart shows nothing
                found.append((correlation, chart_map))
    return found


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
