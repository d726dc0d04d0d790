"""Blocks of overlapping vertical images over flat ground whose radiometry is known.

The ground is a map of fields; every field has a surface class with its own reflectance and its own
anisotropy. Images see it with the height of the sun, exposure and haze of their moment, fall off
to the corners, and record digital numbers with noise.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_count, check_positive
from mmqa_lab.simulate.targets import expose, texture

SURFACES = pd.DataFrame(
    {
        "surface": ["asphalt", "gravel", "grass", "crop", "forest"],
        "reflectance": [0.11, 0.26, 0.16, 0.20, 0.07],
        "b1": [0.10, 0.12, 0.25, 0.30, 0.20],
        "b2": [0.06, 0.10, 0.22, 0.28, 0.40],
    }
)
"""Assumed reflectance in the green and Walthall's terms over nadir, for surfaces as in towns."""

OFFSET_DN, GAIN_DN, BITS = 64.0, 9000.0, 12


@dataclass(frozen=True)
class Flight:
    """How a block is flown, and what disturbs it.

    Parameters
    ----------
    strips, images : int
        Strips, and images in each; neighbouring strips are flown in opposite directions.
    rows, columns : int
        Of an image; rows along the flight.
    gsd_m, height_m : float
        Pixel on the ground, height of flight.
    forward_overlap, side_overlap : float
    sun_zenith_deg, sun_azimuth_deg : (float, float)
        At the first and the last image.
    gain_std : float
        Standard deviation of the logarithm of what an image's exposure differs from its label.
    radial : float
        Share of light lost in the corners.
    haze : float
        Added everywhere, in units of reflectance under a sun in the zenith.
    """

    strips: int = 4
    images: int = 7
    rows: int = 120
    columns: int = 180
    gsd_m: float = 2.0
    height_m: float = 300.0
    forward_overlap: float = 0.6
    side_overlap: float = 0.4
    sun_zenith_deg: tuple = (40.0, 47.0)
    sun_azimuth_deg: tuple = (150.0, 175.0)
    gain_std: float = 0.04
    radial: float = 0.12
    haze: float = 0.02


@dataclass(frozen=True, eq=False)
class ImageBlock:
    """Images, what is known of them, and the truth.

    Parameters
    ----------
    dn : array, shape (n, rows, columns)
        Digital numbers.
    stations : DataFrame
        One row an image: ``image``, ``x_m``, ``y_m`` of its centre, ``exposure`` (the label),
        ``sun_zenith_deg``, ``sun_azimuth_deg``, and the truth: ``gain``.
    flight : Flight
    reflectance, surface : array, shape (height, width)
        Truth at nadir and number of the surface class, one cell a ground pixel; row 0 at y = 0.
    """

    dn: np.ndarray
    stations: pd.DataFrame
    flight: Flight
    reflectance: np.ndarray
    surface: np.ndarray

    def pixels(self, image, row, column):
        """What the adjustment needs to know of pixels.

        Parameters
        ----------
        image, row, column : array_like of int, shape (n,)

        Returns
        -------
        DataFrame
            ``image``, ``sun_zenith_deg``, ``view_zenith_deg``, ``azimuth_deg``, ``radius``,
            ``surface``, ``x_m``, ``y_m``.
        """
        station = self.stations.iloc[np.asarray(image)].reset_index(drop=True)
        view = _view(station, np.asarray(row), np.asarray(column), self.flight)
        cell = (
            (view["y_m"] / self.flight.gsd_m).astype(int),
            (view["x_m"] / self.flight.gsd_m).astype(int),
        )
        names = SURFACES["surface"].to_numpy()[self.surface[cell]]
        sun = station[["image", "sun_zenith_deg"]]
        return pd.concat([sun, pd.DataFrame(view)], axis=1).assign(surface=names)

    def radiance(self, image, row, column, *, window=1):
        """Mean radiance (DN less offset, over gain and labelled exposure) in windows of pixels."""
        from scipy.ndimage import uniform_filter

        smooth = [uniform_filter(dn, window, mode="nearest") for dn in self.dn]
        exposure = self.stations["exposure"].to_numpy()[np.asarray(image)]
        return (np.stack(smooth)[image, row, column] - OFFSET_DN) / (GAIN_DN * exposure)

    def observations(self, *, spacing_m=20.0, window=5):
        """Return what every image shows of a grid of tie points, as ``adjust_block`` wants it.

        Parameters
        ----------
        spacing_m : float
            Of the grid on the ground.
        window : int
            Side of the window that is averaged, px. Tie points whose window is not of one surface
            class are left out.

        Returns
        -------
        DataFrame
            Also ``reference``: true nadir reflectance, the mean over the window.
        """
        half = window // 2 + 1
        flight, gsd = self.flight, self.flight.gsd_m
        high, wide = self.surface.shape
        step = check_positive(spacing_m, "spacing_m", unit="m") / gsd
        y, x = np.meshgrid(np.arange(half, high - half, step), np.arange(half, wide - half, step))
        y, x = y.ravel().astype(int), x.ravel().astype(int)
        even, reference = _even_windows(self.surface, self.reflectance, window)
        y, x = y[even[y, x]], x[even[y, x]]
        parts = []
        for image, station in enumerate(self.stations.itertuples()):
            row = np.round((station.y_m / gsd - 0.5 - y) + (flight.rows - 1) / 2).astype(int)
            column = np.round((x + 0.5 - station.x_m / gsd) + (flight.columns - 1) / 2).astype(int)
            seen = (row >= half) & (row < flight.rows - half)
            seen &= (column >= half) & (column < flight.columns - half)
            place = np.full(seen.sum(), image), row[seen], column[seen]
            part = self.pixels(*place).assign(tie=y[seen] * wide + x[seen])
            part["reference"] = reference[y[seen], x[seen]]
            part["row"], part["column"] = place[1:]
            parts.append(part)
        table = pd.concat(parts, ignore_index=True)
        table["radiance"] = self.radiance(
            table["image"].to_numpy(), table["row"], table["column"], window=window
        )
        often = table.groupby("tie")["image"].transform("nunique") > 1
        return table[often].reset_index(drop=True)


def fly_block(flight=None, *, seed):
    """Return a simulated block of images.

    Parameters
    ----------
    flight : Flight, optional
    seed : int

    Returns
    -------
    ImageBlock
    """
    flight = Flight() if flight is None else flight
    rng = np.random.default_rng(seed)
    stations, size = _stations(flight, rng)
    reflectance, surface = _fields(size, seed)
    n = len(stations)
    row, column = (v.ravel() for v in np.indices((flight.rows, flight.columns)))
    dn = np.empty((n, flight.rows, flight.columns))
    b = SURFACES[["b1", "b2"]].to_numpy()
    for image in range(n):
        station = stations.iloc[np.full(len(row), image)].reset_index(drop=True)
        view = _view(station, row, column, flight)
        cell = tuple((view[name] / flight.gsd_m).astype(int) for name in ("y_m", "x_m"))
        v, azimuth = np.radians(view["view_zenith_deg"]), np.radians(view["azimuth_deg"])
        b1, b2 = b[surface[cell]].T
        seen = reflectance[cell] * (1 + b1 * v**2 + b2 * v * np.cos(azimuth))
        sun = np.cos(np.radians(stations["sun_zenith_deg"].iloc[image]))
        light = (sun * seen + flight.haze) * (1 - flight.radial * view["radius"] ** 2)
        light = light * stations["gain"].iloc[image] * stations["exposure"].iloc[image]
        seeds = [seed, image]
        recorded = expose(light, gain=GAIN_DN, offset=OFFSET_DN, bits=BITS, seed=seeds)
        dn[image] = recorded.reshape(flight.rows, flight.columns)
    return ImageBlock(dn, stations, flight, reflectance, surface)


def _stations(flight, rng):
    """Images of the flight in the order of time, and the ground's size in cells."""
    strips, images = check_count(flight.strips, "strips"), check_count(flight.images, "images")
    high, wide = flight.rows * flight.gsd_m, flight.columns * flight.gsd_m
    base, gap = high * (1 - flight.forward_overlap), wide * (1 - flight.side_overlap)
    strip, k = (v.ravel() for v in np.indices((strips, images)))
    order = np.where(strip % 2 == 0, k, images - 1 - k)
    n = strips * images
    share = np.linspace(0, 1, n)
    exposure = np.round(np.exp(rng.normal(0, 0.1, n)) * 20) / 20
    stations = pd.DataFrame(
        {
            "image": np.arange(n),
            "x_m": wide / 2 + strip * gap,
            "y_m": high / 2 + order * base,
            "exposure": exposure,
            "sun_zenith_deg": np.interp(share, [0, 1], flight.sun_zenith_deg),
            "sun_azimuth_deg": np.interp(share, [0, 1], flight.sun_azimuth_deg),
            "gain": np.exp(rng.normal(0, flight.gain_std, n)),
        }
    )
    size = (high + (images - 1) * base, wide + (strips - 1) * gap)
    return stations, tuple(int(np.ceil(length / flight.gsd_m)) + 1 for length in size)


def _view(station, row, column, flight):
    """Ground position and viewing geometry of pixels."""
    dx = (column - (flight.columns - 1) / 2) * flight.gsd_m
    dy = ((flight.rows - 1) / 2 - row) * flight.gsd_m
    distance = np.hypot(dx, dy)
    corner = np.hypot(flight.columns - 1, flight.rows - 1) / 2 * flight.gsd_m
    to_camera = np.degrees(np.arctan2(-dx, -dy))
    azimuth = np.abs((to_camera - station["sun_azimuth_deg"].to_numpy() + 180) % 360 - 180)
    return {
        "view_zenith_deg": np.degrees(np.arctan2(distance, flight.height_m)),
        "azimuth_deg": azimuth,
        "radius": distance / corner,
        "x_m": station["x_m"].to_numpy() + dx,
        "y_m": station["y_m"].to_numpy() + dy,
    }


def _fields(size, seed, fields=60):
    """Reflectance and surface class of the ground: fields nearest to random centres, textured."""
    from scipy.spatial import cKDTree

    rng = np.random.default_rng([seed, 1])
    centres = rng.uniform(0, size, (fields, 2))
    kind = rng.permutation(np.arange(fields) % len(SURFACES))
    level = SURFACES["reflectance"].to_numpy()[kind] * np.exp(rng.normal(0, 0.15, fields))
    cells = np.stack(np.indices(size), axis=-1).reshape(-1, 2)
    nearest = cKDTree(centres).query(cells)[1].reshape(size)
    detail = 1 + 0.3 * (texture(size, seed=seed) - 0.5)
    return level[nearest] * detail, kind[nearest]


def _even_windows(surface, reflectance, window):
    """Where a window has one surface class, and the mean reflectance over it."""
    from scipy.ndimage import maximum_filter, minimum_filter, uniform_filter

    even = maximum_filter(surface, window + 2) == minimum_filter(surface, window + 2)
    return even, uniform_filter(reflectance, window)
