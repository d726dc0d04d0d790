"""Blocks: overlapping vertical images over flat ground of fields.

Each field has a surface class with its own reflectance and its own anisotropy. What an image shows
of a tie point depends on the height of the sun, the exposure and the haze at that moment. It falls
off to the corners and has the sensor's noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from mmqa_lab._checks import check_count
from mmqa_lab._streams import stream
from mmqa_lab.simulate.targets.resolution import ELECTRONS_PER_DN, READ_NOISE_DN

__all__ = [
    "ATMOSPHERES", "FLIGHT_LENGTH_M", "SURFACES", "Atmosphere", "Flight", "ImageBlock", "fly_block",
]  # fmt: skip


@dataclass(frozen=True)
class Atmosphere:
    """What air does to radiance between level ground and a camera.

    The terms of equation 1 of EuroSDR 2013, image radiometry, that level ground has: light of sun
    and sky reflected by the target, light reflected by the surroundings into the beam, path
    radiance.

    Parameters
    ----------
    irradiance : float
        On the ground under a black ground, W m-2 um-1.
    path_radiance : float
        Added by the air, W m-2 sr-1 um-1.
    path_std : float
        Standard deviation of it from place to place, as a share.
    direct, diffuse : float
        Transmittance from the target to the camera, and of light from its surroundings that the
        air turns into the same direction (adjacency).
    spherical_albedo : float
        Share of the light leaving the ground that the air sends back.
    """

    irradiance: float
    path_radiance: float
    path_std: float
    direct: float
    diffuse: float
    spherical_albedo: float

    def radiance(
        self,
        reflectance: ArrayLike,
        *,
        surroundings: float | np.ndarray = 0.15,
        seed: int | None = None,
    ) -> np.ndarray:
        """Radiance at the camera over targets of a reflectance in surroundings of another.

        Without a seed the path radiance is the same everywhere.

        Examples
        --------
        >>> round(float(ATMOSPHERES["clean"].radiance(0.2)), 1)
        79.3
        """
        rho = np.asarray(reflectance, dtype=np.float64)
        lit = self.irradiance / (np.pi * (1 - self.spherical_albedo * surroundings))
        path = np.full(rho.shape, self.path_radiance)
        if seed is not None:
            rng = stream(seed, "radiance")
            path = path * (1 + self.path_std * rng.standard_normal(rho.shape))
        return path + lit * (self.direct * rho + self.diffuse * surroundings)


ATMOSPHERES = {
    "clean": Atmosphere(1200.0, 6.0, 0.002, 0.93, 0.03, 0.05),
    "hazy": Atmosphere(950.0, 38.0, 0.005, 0.62, 0.15, 0.20),
}
"""Assumed values in the red, flying at 1-2 km: visibility above 40 km, and of a few kilometres."""


SURFACES = pd.DataFrame(
    {
        "surface": ["asphalt", "gravel", "grass", "crop", "forest"],
        "reflectance": [0.11, 0.26, 0.16, 0.20, 0.07],
        "b1": [0.10, 0.12, 0.25, 0.30, 0.20],
        "b2": [0.06, 0.10, 0.22, 0.28, 0.40],
    }
)
"""Assumed reflectance in the green and Walthall's terms over nadir, for surfaces as in towns."""

GAIN_DN, WINDOW_PIXELS = 9000.0, 25
"""Of a block's observations: DN per unit of light, pixels that are averaged about a tie point."""

WIDTH_M, FLIGHT_LENGTH_M, HEIGHT_M = 360.0, 240.0, 300.0
"""Ground that an image of a block sees across and along the flight, height of flight."""

FORWARD_OVERLAP, SIDE_OVERLAP = 0.6, 0.4
SUN_ZENITH_DEG, SUN_AZIMUTH_DEG = (40.0, 47.0), (150.0, 175.0)
"""At the first and the last image of a block."""


@dataclass(frozen=True, kw_only=True)
class Flight:
    """How a block is flown, and what disturbs it.

    Parameters
    ----------
    strips, images : int
        Strips, and images in each; neighbouring strips are flown in opposite directions.
    gain_std : float
        Standard deviation of the logarithm of what an image's exposure differs from its label.
    radial : float
        Share of light lost in the corners.
    haze : float
        Added everywhere, in units of reflectance under a sun in the zenith.
    """

    strips: int = 4
    images: int = 7
    gain_std: float = 0.04
    radial: float = 0.12
    haze: float = 0.02


@dataclass(frozen=True, eq=False)
class ImageBlock:
    """What the images of a block show of its tie points, and the truth.

    Parameters
    ----------
    observations : DataFrame
        As ``adjust_block`` wants it, a row for each image of each tie point: ``image``,
        ``sun_zenith_deg``, ``view_zenith_deg``, ``azimuth_deg``, ``radius``, ``surface``, ``x_m``,
        ``y_m``, ``tie``, ``radiance`` (DN over gain and labelled exposure), and the truth:
        ``reference``, the nadir reflectance.
    stations : DataFrame
        One row an image: ``image``, ``centre_x_m``, ``centre_y_m``, ``exposure`` (the label),
        ``sun_zenith_deg``, ``sun_azimuth_deg``, and the truth: ``gain``.
    flight : Flight
    """

    observations: pd.DataFrame
    stations: pd.DataFrame
    flight: Flight


def fly_block(flight: Flight = Flight(), *, seed: int) -> ImageBlock:
    """Return what a simulated block of images shows of tie points on flat ground.

    Parameters
    ----------
    flight : Flight
    seed : int

    Returns
    -------
    ImageBlock
    """
    rng = stream(seed, "fly_block")
    stations = _stations(flight, rng)
    seen = stations.merge(_ties(stations, rng), how="cross")
    dx, dy = seen["x_m"] - seen["centre_x_m"], seen["y_m"] - seen["centre_y_m"]
    inside = (dx.abs() < WIDTH_M / 2) & (dy.abs() < FLIGHT_LENGTH_M / 2)
    often = inside.groupby(seen["tie"]).transform("sum") > 1
    seen, dx, dy = (table[inside & often].reset_index(drop=True) for table in (seen, dx, dy))
    distance, to_camera = np.hypot(dx, dy), np.degrees(np.arctan2(-dx, -dy))
    seen["view_zenith_deg"] = np.degrees(np.arctan2(distance, HEIGHT_M))
    seen["azimuth_deg"] = np.abs((to_camera - seen["sun_azimuth_deg"] + 180) % 360 - 180)
    seen["radius"] = 2 * distance / np.hypot(WIDTH_M, FLIGHT_LENGTH_M)
    view, azimuth = np.radians(seen["view_zenith_deg"]), np.radians(seen["azimuth_deg"])
    turned = 1 + seen["b1"] * view**2 + seen["b2"] * view * np.cos(azimuth)
    sun = np.cos(np.radians(seen["sun_zenith_deg"]))
    light = sun * seen["reference"] * turned + flight.haze
    exposure = seen["gain"] * seen["exposure"]
    dn = GAIN_DN * light * (1 - flight.radial * seen["radius"] ** 2) * exposure
    noise = np.sqrt((dn / ELECTRONS_PER_DN + READ_NOISE_DN**2) / WINDOW_PIXELS)
    dn += noise * rng.standard_normal(len(dn))
    seen["radiance"] = dn / (GAIN_DN * seen["exposure"])
    hidden = ["gain", "exposure", "b1", "b2", "centre_x_m", "centre_y_m", "sun_azimuth_deg"]
    return ImageBlock(seen.drop(columns=hidden), stations, flight)


def _stations(flight, rng):
    """Images of the flight in the order of time."""
    strips, images = check_count(flight.strips, "strips"), check_count(flight.images, "images")
    base = FLIGHT_LENGTH_M * (1 - FORWARD_OVERLAP)
    strip, k = (v.ravel() for v in np.indices((strips, images)))
    n = strips * images
    exposure = np.round(np.exp(rng.normal(0, 0.1, n)) * 20) / 20
    return pd.DataFrame(
        {
            "image": np.arange(n),
            "centre_x_m": WIDTH_M * (0.5 + strip * (1 - SIDE_OVERLAP)),
            "centre_y_m": FLIGHT_LENGTH_M / 2 + base * np.where(strip % 2 == 0, k, images - 1 - k),
            "exposure": exposure,
            "sun_zenith_deg": np.linspace(*SUN_ZENITH_DEG, n),
            "sun_azimuth_deg": np.linspace(*SUN_AZIMUTH_DEG, n),
            "gain": np.exp(rng.normal(0, flight.gain_std, n)),
        }
    )


def _ties(stations, rng, fields=60):
    """Tie points every 20 m: each has the surface of the nearest of some fields, and details."""
    size = stations[["centre_x_m", "centre_y_m"]].max() + [WIDTH_M / 2, FLIGHT_LENGTH_M / 2]
    x, y = np.meshgrid(*(np.arange(10, side, 20) for side in size))
    places = np.column_stack([x.ravel(), y.ravel()])
    kind = rng.permutation(np.arange(fields) % len(SURFACES))
    level = np.exp(rng.normal(0, 0.15, fields))
    nearest = cKDTree(rng.uniform(0, size, (fields, 2))).query(places)[1]
    ties = SURFACES.iloc[kind[nearest]].reset_index(drop=True)
    ties["reference"] = ties.pop("reflectance") * level[nearest] * rng.normal(1, 0.045, len(ties))
    return ties.assign(tie=ties.index, x_m=places[:, 0], y_m=places[:, 1])
