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

from mmqa_lab._checks import check_count, check_number, check_points, check_positive
from mmqa_lab.charts import Layout

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


@dataclass(frozen=True)
class Pose:
    """Where a camera stands and how it is turned.

    Parameters
    ----------
    position : array_like, shape (3,)
        East, north, height, metres.
    rotation : array_like, shape (3, 3)
        Rows are the camera's x (right), y (down) and z (view) axis in the world.

    Raises
    ------
    ValueError
        From its maker: if the view is plumb or the roll is not finite.

    Examples
    --------
    >>> pose = Pose.looking((0, 0, 2), (10, 0, 2))
    >>> pose.to_camera([[10, -1, 3]]).round(9).tolist()  # 1 m right, 1 m up, 10 m ahead
    [[1.0, -1.0, 10.0]]
    """

    position: tuple
    rotation: tuple

    @classmethod
    def looking(cls, position, target, *, roll_deg=0.0):
        """Return the pose at ``position`` that looks at ``target`` with a level x axis.

        Examples
        --------
        >>> Pose.looking((0, 0, 2), (0, 10, 2)).rotation.round(12).tolist()[2]
        [0.0, 1.0, 0.0]
        """
        position, target = (np.asarray(place, dtype=float) for place in (position, target))
        view = target - position
        level = np.cross(view, [0, 0, 1.0])
        if not np.linalg.norm(level) > 0:
            raise ValueError(f"Invalid target {target}. Must not lie plumb above or below.")
        view, right = view / np.linalg.norm(view), level / np.linalg.norm(level)
        down = np.cross(view, right)
        angle = np.radians(check_number(roll_deg, "roll_deg"))
        turned = np.cos(angle) * right + np.sin(angle) * down
        return cls(position, np.stack([turned, np.cross(view, turned), view]))

    def to_camera(self, points):
        """Return world points in the camera's axes, metres; differences are taken first."""
        return (np.asarray(points, dtype=float) - self.position) @ np.asarray(self.rotation).T


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
        From its makers: if points do not fit one chart, or lie behind the camera.

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

    @classmethod
    def from_orientation(
        cls, camera: PanoramaCamera, pose: Pose, corners: ArrayLike, layout: Layout
    ) -> ChartMap:
        """Return the map of a chart whose corners are surveyed, for a camera of known orientation.

        Parameters
        ----------
        camera : PanoramaCamera
        pose : Pose
        corners : array_like, shape (4, 3)
            East, north, height of the chart's corners from the lower left counterclockwise as one
            looks at it, metres. The chart is taken for plane with right angles and the layout's
            size; its frame is fitted to the corners.
        layout : Layout

        Raises
        ------
        ValueError
            If the corners do not have the layout's size within 2 %, or lie behind the camera.
        """
        seen = pose.to_camera(four_corners(corners, columns=3))
        sides = np.linalg.norm(np.roll(seen, -1, axis=0) - seen, axis=1) * 1000
        expected = np.array([layout.width, layout.height] * 2)
        if (np.abs(sides / expected - 1) > 0.02).any():
            raise ValueError(
                f"Invalid corners with sides {np.round(sides).tolist()} mm. "
                f"Must be a chart of {layout.width:g} mm x {layout.height:g} mm."
            )
        origin, x, y = rectangle_frame(seen, layout.corners() / 1000)
        found = cls(np.stack([x / 1000, y / 1000, origin], axis=1), camera, source="orientation")
        if not np.isfinite(found.pixels(layout.corners())).all():
            raise ValueError("Invalid corners: behind the camera. Must lie before it.")
        return found

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


def rectangle_frame(corners, places):
    """Origin, x axis and y axis in space of the flat places that lie nearest to four corners."""
    flat = np.column_stack([places - places.mean(axis=0), np.zeros(len(places))])
    turn = Rotation.align_vectors(corners - corners.mean(axis=0), flat)[0]
    x, y, _ = turn.as_matrix().T
    return corners.mean(axis=0) - turn.apply([*places.mean(axis=0), 0]), x, y
