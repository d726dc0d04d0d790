"""Photographs of charts whose truth is known: geometry, optics, motion, sensor, file.

::

    from mmqa_lab import charts
    from mmqa_lab.simulate import cameras

    layout = charts.imaging_chart()
    camera = cameras.PanoramaCamera.of_megapixels(250)
    view = cameras.chart_view(camera, distance=10, heading_deg=30, layout=layout)
    photo = cameras.photograph(layout, view, optics=cameras.Optics(sigma_px=0.6), seed=1)
    photo.image, photo.chart_map                     # grey values and the truth of every element
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from mmqa_lab._checks import check_choice, check_count, check_number, check_positive
from mmqa_lab._streams import stream
from mmqa_lab.chart_image import ChartMap, PanoramaCamera
from mmqa_lab.charts import Layout, encode, reflectance

__all__ = ["ChartMap", "Optics", "PanoramaCamera", "Photo", "Sensor", "chart_view", "photograph"]

FINE_CELLS, SURROUND, SHOT_SHARE = 6, 0.4, 0.5
"""Samples along each side of a pixel; tone around a chart; share of the noise's variance at full
scale that is proportional to the signal."""


@dataclass(frozen=True)
class Optics:
    """What the light passes before the pixels integrate it.

    Parameters
    ----------
    sigma_px : float
        Standard deviation of the Gaussian point spread, pixels, without that of the pixel itself.
    defocus_px : float
        Radius of a uniform disc, pixels; beyond the first zero of its transfer, contrast reverses.
    travel : (float, float, float)
        Way of the camera during the exposure, in its own axes and in the unit of its map's rays:
        metres for oriented cameras, (columns, rows, 0) for plain homographies.
    """

    sigma_px: float = 0.5
    defocus_px: float = 0.0
    travel: tuple = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Sensor:
    """From irradiance to the grey values of a file.

    Parameters
    ----------
    black, white : float
        Signal of black and white print, as shares of full scale.
    noise : float
        Standard deviation at full scale, share of full scale. Half of the variance there is
        proportional to the signal; the rest is constant.
    bayer : bool
        One colour per pixel, interpolated by OpenCV's edge-aware method. Without, the sensor sees
        the luminance of colours.
    gamma : {"linear", "srgb"}
    bits : int or None
        8, None for unrounded values.
    jpeg_quality : int or None
        1 to 100, OpenCV's encoder; None for no compression.
    """

    black: float = 0.06
    white: float = 0.7
    noise: float = 0.01
    bayer: bool = False
    gamma: str = "linear"
    bits: int | None = None
    jpeg_quality: int | None = None

    def __post_init__(self):
        check_number(self.white, "white", low=self.black, high=1)
        check_choice(self.bits, "bits", (8, None) if self.jpeg_quality is None else (8,))


@dataclass(frozen=True, eq=False)
class Photo:
    """A simulated photograph of a chart, the window around it.

    Parameters
    ----------
    image : array, shape (rows, columns) or (rows, columns, 3)
        Blue, green, red for a Bayer sensor.
    chart_map : ChartMap
        The true map, counted from the window's first pixel.
    origin : (int, int)
        Column and row of the window in the whole image.
    """

    image: np.ndarray
    chart_map: ChartMap
    origin: tuple


def chart_view(
    camera: PanoramaCamera,
    *,
    distance: float,
    layout: Layout,
    heading_deg: float = 0.0,
    roll_deg: float = 0.0,
    aim_deg: float = 0.0,
) -> ChartMap:
    """Return the map of a chart for a camera of the test configuration.

    The chart stands upright; its middle is the target. The camera is at ``distance`` on the line
    that leaves the chart's normal by ``heading_deg``: 0 orthogonal, positive to the right.

    Parameters
    ----------
    camera : PanoramaCamera
    distance : float
        From the camera to the chart's plane, metres.
    layout : Layout
    heading_deg : float
        Direction of view against the normal, below 90 degrees.
    roll_deg : float
        Of the camera.
    aim_deg : float
        Turns the camera to the right, away from the target.

    Returns
    -------
    ChartMap

    Examples
    --------
    >>> from mmqa_lab import charts
    >>> camera = PanoramaCamera.of_megapixels(30)
    >>> view = chart_view(camera, distance=10, layout=charts.imaging_chart())
    >>> view.pixel_sizes_mm([[500, 500]]).round(2).tolist()
    [[8.11, 8.11]]
    """
    distance = check_positive(distance, "distance", unit="m")
    heading = np.radians(check_number(heading_deg, "heading_deg", low=-89, high=89, unit="degrees"))
    place = np.array([distance * np.tan(heading), -distance, 0.0])
    turn = _turned(place, *np.radians([check_number(roll_deg, "roll_deg"), aim_deg]))
    corner = -np.array([layout.width, 0.0, layout.height]) / 2000
    # columns: a millimetre to the right and up on the chart, and its lower left corner
    matrix = np.stack([turn[:, 0] / 1000, turn[:, 2] / 1000, turn @ (corner - place)], axis=1)
    return ChartMap(matrix, camera, source="orientation")


def _turned(place, roll, aim):
    """Rows are the x, y and z axis of a level camera that looks at the origin, then turned."""
    view = -place / np.linalg.norm(place)
    level = np.cross(view, [0, 0, 1.0])
    right = np.cos(roll) * level + np.sin(roll) * np.cross(view, level)
    c, s = np.cos(aim), np.sin(aim)
    aside = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    return aside @ np.stack([right, np.cross(view, right), view])


def photograph(
    layout: Layout,
    chart_map: ChartMap,
    *,
    optics: Optics = Optics(),
    sensor: Sensor = Sensor(),
    margin: int = 12,
    seed: int = 0,
) -> Photo:
    """Photograph a chart.

    Each pixel averages 6 x 6 samples of the printed tones after point spread and motion; the motion
    averages exposures along the way. The width of the samples themselves is taken off the point
    spread, so that its standard deviation is the one asked for.

    Parameters
    ----------
    layout : Layout
    chart_map : ChartMap
    optics : Optics
    sensor : Sensor
    margin : int
        Pixels around the chart.
    seed : int
        Of the noise.

    Returns
    -------
    Photo

    Raises
    ------
    ValueError
        If the chart is not in view or an argument is invalid.

    Examples
    --------
    >>> from mmqa_lab import charts
    >>> layout = charts.imaging_chart()
    >>> view = chart_view(PanoramaCamera.of_megapixels(30), distance=10, layout=layout)
    >>> photo = photograph(layout, view, seed=1)
    >>> photo.image.shape
    (149, 150)
    """
    low, size = _window(layout, chart_map, check_count(margin, "margin", low=0))
    inside = chart_map.within(*low)
    tones = _exposed(layout, inside, size, optics, colour=sensor.bayer)
    if sensor.bayer:
        tones = _mosaic(tones)
    signal = sensor.black + (sensor.white - sensor.black) * tones
    origin = tuple(int(place) for place in low)
    return Photo(_recorded(signal, sensor, stream(seed, "photograph")), inside, origin)


def _window(layout, chart_map, margin):
    """First column and row, and columns and rows, of the chart's surroundings."""
    pixels = chart_map.outline(layout.corners())
    if not np.isfinite(pixels).all():
        raise ValueError("Invalid view: the chart lies behind the camera. Must be in view.")
    low = np.floor(pixels.min(axis=0)).astype(int) - margin
    high = np.ceil(pixels.max(axis=0)).astype(int) + margin + 1
    if isinstance(chart_map.camera, PanoramaCamera):
        limit = chart_map.camera.width, chart_map.camera.height
        low, high = np.maximum(low, 0), np.minimum(high, limit)
    size = high - low
    if (size < 2).any() or size.prod() > 1e9:
        raise ValueError(f"Invalid view: {size.tolist()} pixels of chart. Must be in view.")
    return low, size


def _exposed(layout, chart_map, size, optics, colour):
    """The mean tone in each pixel after motion, point spread and integration."""
    centre = np.array([[layout.width / 2, layout.height / 2]])
    pixel, finest = chart_map.pixel_sizes_mm(centre).min(), max(layout.corners()[2]) / 12_000
    cell = max(pixel / FINE_CELLS, finest)
    printed = reflectance(layout, cell=cell, colour=colour)
    travel = np.asarray(optics.travel, dtype=float)
    instants = 1
    if travel.any():
        start, end = (_moved(chart_map, travel, t).pixels(centre) for t in (-0.5, 0.5))
        instants = int(np.ceil(np.linalg.norm(end - start) * FINE_CELLS / 2)) + 1
    total = 0
    for t in (np.arange(instants) + 0.5) / instants - 0.5:
        total = total + _sampled(printed, cell, _moved(chart_map, travel, t), size)
    samples = total / instants
    # samples add a cell (1/12) read bilinearly (1/6), less 1/12, in squares of their steps
    left = optics.sigma_px**2 - (1 / 12 + 1 / 6 - 1 / 12) / FINE_CELLS**2
    if left > 0:
        samples = cv2.GaussianBlur(samples, (0, 0), FINE_CELLS * np.sqrt(left))
    if optics.defocus_px > 0:
        samples = cv2.filter2D(samples, -1, _disc(optics.defocus_px * FINE_CELLS))
    cells = size[1], FINE_CELLS, size[0], FINE_CELLS
    return samples.reshape(*cells, *samples.shape[2:]).mean(axis=(1, 3))


def _moved(chart_map, travel, t):
    """The map at time t of an exposure from -0.5 to 0.5."""
    matrix = chart_map.matrix.copy()
    matrix[:, 2] -= t * travel * (matrix[2, 2] if chart_map.camera is None else 1)
    return replace(chart_map, matrix=matrix)


def _sampled(printed, cell, chart_map, size):
    """The tones at a regular grid of samples, ``FINE_CELLS`` along each side of a pixel."""
    columns, rows = size
    column, row = np.meshgrid(np.arange(-1, columns + 1.0), np.arange(-1, rows + 1.0))
    places = chart_map.chart(np.column_stack([column.ravel(), row.ravel()]))
    places = (places / cell - 0.5).astype(np.float32).reshape(rows + 2, columns + 2, 2)
    # within a pixel the map is straight to 1e-4 px; resizing interpolates between centres
    dense = cv2.resize(places, None, fx=FINE_CELLS, fy=FINE_CELLS, interpolation=cv2.INTER_LINEAR)
    dense = np.ascontiguousarray(dense[FINE_CELLS:-FINE_CELLS, FINE_CELLS:-FINE_CELLS])
    samples = np.empty((*dense.shape[:2], *printed.shape[2:]), dtype=np.float32)
    # remap addresses at most 32,767 rows at once
    for first in range(0, len(dense), 16_384):
        part = slice(first, first + 16_384)
        beyond = {"borderMode": cv2.BORDER_CONSTANT, "borderValue": (SURROUND,) * 3}
        samples[part] = cv2.remap(printed, dense[part], None, cv2.INTER_LINEAR, **beyond)
    return samples


def _disc(radius):
    """A uniform disc as a kernel, antialiased at its edge."""
    reach = int(np.ceil(radius))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    kernel = np.clip(radius + 0.5 - np.hypot(x, y), 0, 1)
    return kernel / kernel.sum()


def _recorded(signal, sensor, rng):
    """Noise, colour filter, gamma, rounding and compression, in this order."""
    shot = SHOT_SHARE * np.clip(signal, 0, None) + 1 - SHOT_SHARE
    values = signal + sensor.noise * np.sqrt(shot) * rng.standard_normal(signal.shape)
    values = values.astype(np.float32)
    if sensor.bayer:
        values = _demosaiced(values)
    values = encode(values, sensor.gamma)
    if sensor.bits is None:
        return values
    values = np.clip(np.round(255 * values), 0, 255).astype(np.uint8)
    if sensor.jpeg_quality is None:
        return values
    quality = [cv2.IMWRITE_JPEG_QUALITY, int(sensor.jpeg_quality)]
    return cv2.imdecode(cv2.imencode(".jpg", values, quality)[1], cv2.IMREAD_UNCHANGED)


def _mosaic(tones):
    """Of red, green and blue the one that each pixel sees: the first pixel is blue."""
    mosaic = tones[..., 1].copy()
    mosaic[::2, ::2], mosaic[1::2, 1::2] = tones[::2, ::2, 2], tones[1::2, 1::2, 0]
    return mosaic


def _demosaiced(values):
    """Blue, green and red from a mosaic, through OpenCV's 16-bit interpolation."""
    mosaic = np.clip(np.round((values + 0.25) * 40_000), 0, 65_535).astype(np.uint16)
    colours = cv2.cvtColor(mosaic, cv2.COLOR_BayerRG2BGR_EA)
    return colours.astype(np.float32) / 40_000 - 0.25
