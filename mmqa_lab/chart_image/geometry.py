"""From millimetres on the chart to pixels of the image and back.

Pixels are (column, row), the centre of the first one at (0, 0). The camera looks along its z axis,
x to the right, y down. A plane chart maps to rays by one 3 x 3 matrix; the camera bends rays into
pixels. Without a camera the map is a homography; a panorama is exactly spherical.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from mmqa_lab._checks import check_count, check_points, check_positive

STEP_MM = 0.5
"""Half of the step that local scales are measured over."""


@dataclass(frozen=True)
class PanoramaCamera:
    """An equirectangular panorama: columns are equal steps of azimuth, rows of elevation.

    The middle of the image is the z axis. ``height`` is half of ``width``.

    Parameters
    ----------
    width : int
        Pixels of the whole turn.

    Raises
    ------
    ValueError
        If the width is below four.

    Examples
    --------
    >>> round(PanoramaCamera.of_megapixels(30).pixel_size_mm(10), 2)
    8.11
    """

    width: int

    def __post_init__(self):
        check_count(self.width, "width", low=4)

    @classmethod
    def of_megapixels(cls, megapixels: float) -> PanoramaCamera:
        """Return the panorama with N megapixels: width sqrt(2 N)."""
        megapixels = check_positive(megapixels, "megapixels")
        return cls(2 * round(np.sqrt(2e6 * megapixels) / 2))

    @property
    def height(self) -> int:
        """Rows."""
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
class ChartMap:
    """Where each place of a chart is in an image.

    Parameters
    ----------
    matrix : array, shape (3, 3)
        Takes (x, y, 1) in mm on the chart to a ray of the camera.
    camera : PanoramaCamera, optional
        Without one, rays are pixels: column, row, 1 and a common factor.
    offset : (float, float)
        Column and row that count as (0, 0), for a window of an image.
    source : str
        What the map was made from.
    remark : str
        What was noticed on the way to the map.

    Raises
    ------
    ValueError
        From ``from_points``: if they do not fit one chart.

    Examples
    --------
    >>> there = ChartMap(np.array([[0.25, 0, 0], [0, -0.25, 250], [0, 0, 1]]))
    >>> there.pixels([[100, 200]]).tolist(), there.pixel_sizes_mm([[100, 200]]).round(6).tolist()
    ([[25.0, 200.0]], [[4.0, 4.0]])
    """

    matrix: np.ndarray
    camera: object = None
    offset: tuple = (0.0, 0.0)
    source: str = "given"
    remark: str = ""

    @classmethod
    def from_points(
        cls,
        xy: ArrayLike,
        pixels: ArrayLike,
        *,
        camera: PanoramaCamera | None = None,
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
        >>> there = ChartMap.from_points(corners, [[10, 90], [90, 90], [90, 10], [10, 10]])
        >>> there.pixels([[500, 500]]).round(6).tolist()
        [[50.0, 50.0]]
        """
        xy = check_points(xy, name="chart points", columns=2, minimum=4)
        pixels = check_points(pixels, name="pixels", columns=2, minimum=4)
        if len(xy) != len(pixels):
            raise ValueError(f"Invalid pixels: {len(pixels)} given. Must be {len(xy)}.")
        turn, flat = np.eye(3), pixels + offset
        if camera is not None:
            # rays become points of the plane across their mean direction
            rays = camera.rays(pixels + offset)
            rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
            turn = Rotation.align_vectors([[0, 0, 1]], rays.mean(axis=0)[None])[0].as_matrix()
            turned = rays @ turn.T
            flat = turned[:, :2] / turned[:, 2:]
        homography, _ = cv2.findHomography(xy, flat, 0)
        if homography is None or not _same_orientation(homography, xy):
            raise ValueError(f"Invalid {source}: no chart fits. Must be four corners in order.")
        return cls(turn.T @ homography, camera, tuple(offset), source=source)

    def pixels(self, xy: ArrayLike) -> np.ndarray:
        """Return the pixels of chart places, shape (n, 2)."""
        rays = np.column_stack([xy, np.ones(len(xy))]) @ self.matrix.T
        if self.camera is None:
            return rays[:, :2] / rays[:, 2:] - self.offset
        return self.camera.pixels(rays) - self.offset

    def chart(self, pixels: ArrayLike) -> np.ndarray:
        """Return the chart places of pixels, mm, shape (n, 2)."""
        pixels = np.asarray(pixels, dtype=float) + self.offset
        if self.camera is None:
            rays = np.column_stack([pixels, np.ones(len(pixels))])
        else:
            rays = self.camera.rays(pixels)
        places = rays @ np.linalg.inv(self.matrix).T
        return places[:, :2] / places[:, 2:]

    def outline(self, corners: ArrayLike) -> np.ndarray:
        """Return the pixels along a closed outline on the chart, eight steps a side, (n, 2)."""
        step = np.arange(8)[:, None] / 8
        ends = zip(corners, np.roll(corners, -1, axis=0), strict=True)
        return self.pixels(np.concatenate([a + step * (b - a) for a, b in ends]))

    def within(self, column: float, row: float) -> ChartMap:
        """Return the map for a window of the image that begins at this column and row."""
        offset = np.asarray(self.offset) + [column, row]
        return replace(self, offset=tuple(offset))

    def corrected(self, change: np.ndarray) -> ChartMap:
        """Return the map after a 3 x 3 change of places on the chart."""
        return replace(self, matrix=self.matrix @ change, source=f"{self.source}, aligned")

    def scale(self, xy: ArrayLike) -> np.ndarray:
        """Return the pixels per mm along x and y as vectors, shape (n, 2, 2): [k, axis, pixel]."""
        xy = np.asarray(xy, dtype=float)
        ends = [self.pixels(xy + step) - self.pixels(xy - step) for step in np.eye(2) * STEP_MM]
        return np.stack(ends, axis=1) / (2 * STEP_MM)

    def pixel_sizes_mm(self, xy: ArrayLike) -> np.ndarray:
        """Return the millimetres per pixel along x and along y at chart places, shape (n, 2)."""
        return 1 / np.linalg.norm(self.scale(xy), axis=2)


def _same_orientation(homography, xy):
    """Whether a homography keeps all points on one side and turns up to down, as images do."""
    depth = np.column_stack([xy, np.ones(len(xy))]) @ homography[2]
    turned = np.linalg.det(homography / np.sign(depth[0])) < 0
    return bool((depth * depth[0] > 0).all() and turned)


def four_corners(corners, *, columns):
    """Four corners as an array, checked."""
    corners = check_points(corners, name="corners", columns=columns, minimum=4)
    if len(corners) != 4:
        raise ValueError(f"Invalid corners: {len(corners)} given. Must be four.")
    return corners
