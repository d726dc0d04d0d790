"""A street camera of the tests' own: charts photographed by a model that shares no code with it.

Skew for a rolling shutter, optics, motion and pixel on a grid of 5 x 5 samples, shadow and poles,
a mosaic with noise in each colour, OpenCV's demosaicing, sharpening, tone curve, JPEG. Pixels are
(column, row); the first centre is at (0, 0).

Places are interpolated by splines: OpenCV's cubic bends a straight line by up to 5 % of the knots'
distance, and its remap takes steps of 1/32 of it.
"""

from dataclasses import dataclass, field, replace
from functools import lru_cache

import cv2
import numpy as np
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import map_coordinates

from mmqa_lab import charts

FINE = 5
"""Samples along each side of a pixel."""

CELL_MM, STEP_PX = 0.2, 4
"""Of the print; and between the pixels whose places are calculated, not interpolated."""

FEWEST_PX, LEAST_CONTRAST = 2.0, 0.10
"""A pattern counts as resolved from here on; as spurious below 5 % or 2 px."""


@dataclass(frozen=True)
class Scene:
    """What a photograph shows and how it was taken; lengths in mm on the chart or in pixels."""

    yaw: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0
    panorama: bool = False
    shutter: tuple = (1.0, 0.0)
    blur: float = 0.5
    motion: float = 0.0
    vignette: float = 0.0
    gradient: float = 0.0
    shadows: tuple = ()
    shade: float = 1.0
    strips: tuple = ()
    white: float = 0.7
    black: float = 0.05
    noise: float = 0.01
    mono: bool = False
    halo: float = 0.0
    curve: bool = False
    jpeg: int = 92
    board: float = 0.0
    margin: float = 0.25


SHADOW, TWO_LINES = ((0.5, 0.87, 480.0),), ((0.5, 0.87, 330.0), (0.94, -0.34, 560.0))
"""Normals and distances of the lines behind which shadow lies."""

CONDITIONS = {
    "base": {},
    "oblique 30": {"yaw": 30},
    "oblique 50": {"yaw": -50},
    "oblique 40+30": {"yaw": 40, "pitch": 30},
    "panorama": {"panorama": True, "yaw": 20},
    "rolling 6 %": {"shutter": (1.06, 0.0)},
    "rolling shear": {"shutter": (1.0, 0.15)},
    "vignette": {"vignette": 0.6, "gradient": 0.5},
    "shadow 75": {"shadows": SHADOW, "shade": 0.25},
    "shadow 75, two": {"shadows": TWO_LINES, "shade": 0.25},
    "jpeg 60": {"jpeg": 60},
    "halo 3, curve": {"halo": 3.0, "curve": True},
    "phone": {"halo": 2.0, "curve": True, "jpeg": 80, "noise": 0.02},
    "motion 2": {"motion": 2.0},
    "motion 4": {"motion": 4.0},
    "motion 8": {"motion": 8.0},
    "noise 5": {"noise": 0.05},
    "noise 10": {"noise": 0.10},
    "blur 1.2": {"blur": 1.2},
    "blur 2": {"blur": 2.0},
    "pole": {"strips": ((0, 500.0, 30.0),)},
    "pole on bar": {"strips": ((0, 150.0, 30.0),)},
    "pole on targets": {"strips": ((0, 55.0, 30.0),)},
    "white board": {"board": 0.25},
    "dark": {"white": 0.12, "black": 0.01, "noise": 0.005},
    "overexposed": {"white": 1.3, "black": 0.09},
    "mono": {"mono": True, "jpeg": 98},
}
"""The conditions of one photograph."""


@dataclass(frozen=True, eq=False)
class Shot:
    """A photograph, 8 bits: grey values or blue, green, red; the truth beside it."""

    image: np.ndarray
    clean: np.ndarray
    scene: Scene
    size: tuple
    place: dict = field(repr=False)

    @property
    def linear(self):
        """Linear light of the photograph as one grey image."""
        return linear(self.image)

    def pixels(self, xy):
        """Where places of the chart, mm, are in the photograph, shape (n, 2)."""
        return _forward(np.asarray(xy, dtype=float), self.scene, self.place)

    def length(self, bar):
        """True length of a bar's middle line, pixels."""
        ends = np.array([[bar.x, bar.y], [bar.x + bar.width, bar.y + bar.height]], dtype=float)
        narrow = 0 if bar.width < bar.height else 1
        ends[:, narrow] = ends[:, narrow].mean()
        return float(np.linalg.norm(np.diff(self.pixels(ends), axis=0)))

    def contrast(self, pairs):
        """Contrast of the bars at their printed places without noise, and their width in pixels."""
        axis = 0 if pairs.direction == "h" else 1
        steps = (np.arange(2 * pairs.repeats - 1) + 0.5) * pairs.pair / 2
        along = np.linspace(0.25, 0.75, 41) * pairs.length
        grid = np.stack(np.meshgrid(steps, along, indexing="ij"), axis=-1)
        grid = grid if axis == 0 else grid[..., ::-1]
        places = grid.reshape(-1, 2) + [pairs.x, pairs.y]
        seen = _at(self.clean, self.pixels(places)).reshape(len(steps), -1).mean(axis=1)
        light = self.scene.white - self.scene.black
        ends = np.array([[pairs.x, pairs.y], [pairs.x, pairs.y]])
        ends[1, axis] += pairs.pair
        middle = np.array([pairs.width, pairs.height]) / 2
        width = np.linalg.norm(np.diff(self.pixels(ends + middle), axis=0))
        return float((seen[1::2].mean() - seen[::2].mean()) / light), float(width)

    def hidden(self, pairs):
        """Whether a pole or dirt lies over more than a tenth of a pattern."""
        share = (np.indices((30, 30)).reshape(2, -1).T + 0.5) / 30
        places = [pairs.x, pairs.y] + share * [pairs.width, pairs.height]
        return (_covered(self.scene, places, np.full(len(places), -1.0)) > 0).mean() > 0.1

    def steps(self, layout, readings, direction):
        """Steps by which the resolved width is finer than the truth's, None without a truth.

        What a pole hides takes no part.
        """
        ladder = [one for one in layout.of_kind(charts.LinePairs) if one.direction == direction]
        ladder = [one for one in ladder if not self.hidden(one)]
        ladder = sorted(ladder, key=lambda one: -one.pair)
        truth = [self.contrast(pairs) for pairs in ladder]
        seen = [contrast >= LEAST_CONTRAST and width >= FEWEST_PX for contrast, width in truth]
        limit = len(seen) if all(seen) else seen.index(False)
        found = sum(pairs.pair >= readings for pairs in ladder)  # none where it is NaN
        return found - limit if limit else None


def linear(image):
    """Linear light of an 8-bit image by sRGB's curve, one grey image."""
    values = image.astype(np.float32) / 255
    return linear_of(values if values.ndim == 2 else cv2.cvtColor(values, cv2.COLOR_BGR2GRAY))


def shoot(layout, pixel_mm, *, seed=0, background=None, **changes):
    """Photograph a chart with pixels of about this size at its middle."""
    rng = np.random.default_rng(seed)
    small = dict(zip(("yaw", "pitch", "roll"), rng.uniform(-2, 2, 3), strict=True))
    scene = Scene(**changes)
    scene = replace(scene, **{name: getattr(scene, name) + one for name, one in small.items()})
    place = _placed(layout, scene, pixel_mm, rng)
    size = place["size"]
    light, places = _exposed(layout, scene, place, size, background, rng)
    covered = _covered(scene, places, light * _shade(scene, places))
    image = _recorded(_blurred(covered, scene), scene, rng, noisy=True)
    clean = _recorded(_blurred(light, scene), scene, rng, noisy=False)
    return Shot(image, clean, scene, size, place)


def _placed(layout, scene, pixel_mm, rng):
    """Focal length, pose and frame so that the chart has its size in the image."""
    distance = 5000.0
    angles = np.radians([scene.yaw, scene.pitch, scene.roll])
    (a, b, c), (s, t, u) = np.cos(angles), np.sin(angles)
    yaw = np.array([[a, 0, s], [0, 1, 0], [-s, 0, a]])
    pitch = np.array([[1, 0, 0], [0, b, -t], [0, t, b]])
    roll = np.array([[c, -u, 0], [u, c, 0], [0, 0, 1]])
    # chart: x right, y up, z towards the camera; camera: y down, z ahead
    turn = roll @ np.diag([1.0, -1.0, -1.0]) @ pitch @ yaw
    place = {"turn": turn, "away": np.array([0, 0, distance]), "focal": distance / pixel_mm}
    place["middle"] = np.array([layout.width, layout.height]) / 2
    place["shift"] = np.zeros(2)
    frame = np.array([[0, 0], [0.5, 0], [1, 0], [1, 0.5], [1, 1], [0.5, 1], [0, 1], [0, 0.5]])
    outline = frame * [layout.width, layout.height]
    seen = _forward(outline, scene, place)
    side = np.ptp(seen, axis=0)
    low = seen.min(axis=0) - scene.margin * side * rng.uniform(0.7, 1.3, 2)
    place["shift"] = low
    place["size"] = tuple(np.ceil((1 + 2 * scene.margin) * side).astype(int))
    return place


def _forward(xy, scene, place):
    """Chart places to pixels."""
    flat = xy - place["middle"]
    z = np.zeros(len(flat))
    ray = np.column_stack([flat, z]) @ place["turn"].T + place["away"]
    if scene.panorama:
        up = np.arctan2(ray[:, 1], np.hypot(ray[:, 0], ray[:, 2]))
        out = np.column_stack([np.arctan2(ray[:, 0], ray[:, 2]), up]) * place["focal"]
    else:
        out = ray[:, :2] / ray[:, 2:] * place["focal"]
    stretch, shear = scene.shutter
    out = out @ np.array([[1, 0], [shear, stretch]])
    return out - place["shift"]


def _places(scene, place, size):
    """Chart places of all samples, by Newton's steps through the forward model at every 4th pixel
    and splines in between."""
    knots = [np.arange(-2 * STEP_PX, side + 3 * STEP_PX, STEP_PX, dtype=float) for side in size]
    grid = np.stack(np.meshgrid(*knots), axis=-1).reshape(-1, 2)
    xy = np.tile(place["middle"], (len(grid), 1))
    for _ in range(25):
        error = grid - _forward(xy, scene, place)
        slopes = [
            (_forward(xy + one, scene, place) - _forward(xy - one, scene, place)) / 2
            for one in np.eye(2)
        ]
        jacobian = np.stack(slopes, axis=2)
        xy = xy + np.clip(np.linalg.solve(jacobian, error[..., None])[..., 0], -600, 600)
        if np.abs(error).max() < 1e-6:
            break
    xy = xy.reshape(len(knots[1]), len(knots[0]), 2)
    at = [(np.arange(side * FINE) + 0.5) / FINE - 0.5 for side in size]
    both = np.empty((len(at[1]), len(at[0]), 2), dtype=np.float32)
    for k in (0, 1):
        both[..., k] = RectBivariateSpline(*knots[::-1], xy[..., k])(*at[::-1])
    return both


def _exposed(layout, scene, place, size, background, rng):
    """Light on all samples and their places on the chart."""
    places = _places(scene, place, size)
    printed = _print_of(layout)
    # a sample is its share of the pixel, less what cells and the line between them spread
    ends = place["middle"] + np.array([[-1, -1], [1, -1], [-1, 1]]) / 2
    sides = 1 / np.linalg.norm(np.diff(_forward(ends[[1, 0, 2]], scene, place), axis=0), axis=1)
    spread = np.sqrt(np.maximum((sides / FINE / CELL_MM) ** 2 / 12 - 1 / 4, 1e-4))
    printed = cv2.GaussianBlur(printed, (0, 0), spread[0], sigmaY=spread[1])
    sought = places / np.float32(CELL_MM) - np.float32(0.5)
    light = cv2.remap(printed, sought, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    light = scene.black + (scene.white - scene.black) * light
    limit = [layout.width, layout.height]
    inside = ((places >= 0) & (places <= limit)).all(axis=2)
    around = _ground(size, background, rng, scene)
    if scene.board:
        wide = scene.board * layout.width
        board = ((places >= -wide) & (places <= np.array(limit) + wide)).all(axis=2)
        around = np.where(board, scene.white, around)
    return np.where(inside, light, around).astype(np.float32), places


@lru_cache(maxsize=1)
def _print_of(layout):
    """The print of a layout in fine cells."""
    return charts.reflectance(_printed(layout), cell=CELL_MM).astype(np.float32)


def _printed(layout):
    """The layout with its greys as printers print them: DeviceGray along sRGB's curve."""
    elements = []
    for one in layout.elements:
        tones = {
            name: _light(getattr(one, name)) for name in ("tone", "ground") if hasattr(one, name)
        }
        elements.append(replace(one, **tones))
    return replace(layout, elements=tuple(elements))


def _light(tone):
    colour = isinstance(tone, tuple)
    return tone if colour or tone in (0.0, 1.0) else ((tone + 0.055) / 1.055) ** 2.4


def _ground(size, background, rng, scene):
    """What is around the chart: a piece of a photograph, or blots."""
    wide, high = size[0] * FINE, size[1] * FINE
    if background is None:
        small = rng.random((high // 40 + 2, wide // 40 + 2)).astype(np.float32)
        around = cv2.resize(small, (wide, high), interpolation=cv2.INTER_NEAREST)
    else:
        rows, columns = background.shape
        scale = min(1.0, rows / size[1], columns / size[0])
        need = (int(size[1] * scale), int(size[0] * scale))
        top = int(rng.integers(0, rows - need[0] + 1))
        left = int(rng.integers(0, columns - need[1] + 1))
        piece = background[top : top + need[0], left : left + need[1]].astype(np.float32) / 255
        around = cv2.resize(linear_of(piece), (wide, high), interpolation=cv2.INTER_CUBIC)
    return np.clip(around, 0.02, 1) * scene.white


def linear_of(values):
    """Linear light of sRGB values 0 to 1."""
    return np.where(
        values <= 0.04045, values / 12.92, ((np.maximum(values, 0) + 0.055) / 1.055) ** 2.4
    )


def _shade(scene, places):
    """Share of the light on each sample: shadows with an edge of 6 mm, vignette, gradient."""
    share = np.ones(places.shape[:2], dtype=np.float32)
    for a, b, distance in scene.shadows:
        behind = (a * places[..., 0] + b * places[..., 1] - distance) / 3.0
        share *= scene.shade + (1 - scene.shade) / (1 + np.exp(-np.clip(behind, -30, 30)))
    rows, columns = np.ogrid[-1 : 1 : places.shape[0] * 1j, -1 : 1 : places.shape[1] * 1j]
    share *= (1 - scene.vignette * (rows**2 + columns**2) / 2) * (
        1 - scene.gradient * (columns + 1) / 2
    )
    return share.astype(np.float32)


def _covered(scene, places, light):
    """The light with poles and dirt before the chart."""
    for axis, middle, half in scene.strips:
        light = np.where(np.abs(places[..., axis] - middle) < half, 0.25 * scene.white, light)
    return light.astype(np.float32)


def _blurred(light, scene):
    """Means over point spread, motion along the rows and pixel."""
    light = cv2.GaussianBlur(light, (0, 0), scene.blur * FINE)
    if scene.motion:
        light = cv2.blur(light, (round(scene.motion * FINE) | 1, 1))
    rows, columns = (side // FINE for side in light.shape)
    return cv2.resize(light, (columns, rows), interpolation=cv2.INTER_AREA)


def _recorded(light, scene, rng, *, noisy):
    """The file's grey values; without noise linear light, before curve and JPEG."""
    spread = scene.noise * np.sqrt(0.5 + 0.5 * np.clip(light, 0, None)) if noisy else 0.0
    values = light + spread * rng.standard_normal(light.shape)
    if not scene.mono:
        mosaic = np.clip(values * 30_000 + 2_000, 0, 65_535).astype(np.uint16)
        values = cv2.cvtColor(mosaic, cv2.COLOR_BayerRG2BGR_EA).astype(np.float32)
        values = (values - 2_000) / 30_000
    values = values.astype(np.float32)
    if scene.halo:
        values = values + scene.halo * 0.5 * (values - cv2.GaussianBlur(values, (0, 0), 1.2))
    if not noisy:
        return values if values.ndim == 2 else cv2.cvtColor(values, cv2.COLOR_BGR2GRAY)
    values = np.clip(values, 0, 1)
    values = np.where(values <= 0.0031308, 12.92 * values, 1.055 * values ** (1 / 2.4) - 0.055)
    if scene.curve:
        values = values + 0.08 * np.sin(2 * np.pi * (values - 0.5))
    values = np.uint8(np.clip(np.round(values * 255), 0, 255))
    _, buffer = cv2.imencode(".jpg", values, [cv2.IMWRITE_JPEG_QUALITY, scene.jpeg])
    return cv2.imdecode(buffer, cv2.IMREAD_UNCHANGED)


def _at(image, pixels):
    """Values of an image between its pixels."""
    low = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - 20, 0)
    high = np.ceil(pixels.max(axis=0)).astype(int) + 20
    part = image[low[1] : high[1], low[0] : high[0]]
    return map_coordinates(part, (pixels - low)[:, ::-1].T, order=3, mode="nearest")
