"""From millimetres on a chart to pixels: the map, and what bends rays into pixels.

Pixels are (column, row), the centre of the first one at (0, 0). The camera looks along its z axis,
x to the right, y down. A plane chart maps to rays by one 3 x 3 matrix; the camera bends rays into
pixels. Without a camera the map is a homography; a panorama is exactly spherical, and a calibrated
lens bends as it says.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.polynomial.polynomial import polyval2d
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from mmqa_lab._checks import check_points, check_positive, refuse
from mmqa_lab.charts import Layout

__all__ = [
    "Bend", "ChartMap", "LensCamera", "PanoramaCamera", "four_corners", "mirrored",
    "plain", "side", "unit",
]  # fmt: skip

UNDISTORT = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-10)

# Both take a criterion, in OpenCV 4 under the first name and in OpenCV 5 under the second.
_undistorted = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)


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
    blur_px : float
        Standard deviation of the point spread, pixel included, with which the print fits best.

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
    blur_px: float = 0.65

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
        same = {"R": np.eye(3), "P": np.eye(3)}
        flat = _undistorted(pixels, self.matrix, self.distortion, **same, criteria=UNDISTORT)
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

    size: tuple[float, float]
    terms: np.ndarray

    def at(self, xy: ArrayLike) -> np.ndarray:
        """Displacement at places, mm, shape (n, 2); it ends a quarter beyond the chart."""
        x, y = unit(xy, self.size)
        return polyval2d(x, y, self.terms).T


def four_corners(corners: ArrayLike, *, columns: int) -> np.ndarray:
    """Return four corners as an array, checked."""
    corners = check_points(corners, name="corners", columns=columns, minimum=4)
    refuse(len(corners) != 4, "corners", f"{len(corners)} given", "four")
    return corners


def mirrored(chart_map, layout):
    """Return the map of the chart's mirror image at the same place."""
    flip = np.array([[-1.0, 0, layout.width], [0, 1, 0], [0, 0, 1]])
    return replace(chart_map, matrix=chart_map.matrix @ flip, bend=None)


def plain(chart_map, layout, **other):
    """Return the homography nearest to a map, of the same camera or of another."""
    mesh = np.indices((5, 5)).reshape(2, -1).T / 4 * [layout.width, layout.height]
    known = {name: getattr(chart_map, name) for name in ("camera", "offset", "source")}
    plain = ChartMap.from_points(mesh, chart_map.pixels(mesh), **(known | other))
    return replace(plain, charts=chart_map.charts)


def side(chart_map, layout):
    """Return the length of a chart's longer side in the image, pixels."""
    return np.ptp(chart_map.pixels(layout.corners()), axis=0).max()


def unit(xy, size):
    """Return places as x and y from -1 to 1 over the chart."""
    return np.clip(2 * np.asarray(xy, dtype=float) / size - 1, -1.5, 1.5).T


def _projected(matrix, xy):
    """Plane places under a homography, shape (n, 2)."""
    xy = np.array(xy, dtype=float).reshape(-1, 1, 2)
    return cv2.perspectiveTransform(xy, matrix)[:, 0] if len(xy) else xy[:, 0]


def _same_orientation(homography, xy):
    """Whether a homography keeps all points on one side and turns up to down, as images do."""
    depth = np.column_stack([xy, np.ones(len(xy))]) @ homography[2]
    turned = np.linalg.det(homography / np.sign(depth[0])) < 0
    return bool((depth * depth[0] > 0).all() and turned)
