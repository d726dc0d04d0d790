"""What the lattice predicts beyond MIMIC: maps, posts, two heads, error budgets, largest speeds."""

from dataclasses import replace

import numpy as np
import pandas as pd
import xarray as xr

from mmqa_lab import simulate
from mmqa_lab.scan_pattern import (
    Patch,
    ScanSetup,
    Target,
    largest_speed,
    propagate,
    scan_lattice,
    sensitivities,
)

MAPPED = ("density_per_m2", "profile_spacing_perpendicular_m", "point_spacing_m")

UNITS = {"density_per_m2": "1/m2", "f": "1"}
"""Of quantities whose names end in no unit of length."""

ERRORS = {
    "speed": {"speed_m_s": 0.05},
    "mirror": {"mirror_frequency_hz": 0.1},
    "boresight": {
        "boresight_roll_deg": 0.1,
        "boresight_pitch_deg": 0.1,
        "boresight_heading_deg": 0.1,
    },
    "target": {"target_heading_deg": 0.5, "target_tilt_deg": 0.5},
    "roll": {"roll_deg": 0.05},
    "pitch": {"pitch_deg": 0.05},
    "yaw": {"heading_deg": 0.05},
    "roll, pitch, yaw rates": {
        "roll_rate_deg_s": 0.5,
        "pitch_rate_deg_s": 0.5,
        "heading_rate_deg_s": 0.5,
    },
}
"""Standard deviations of a usual vehicle, in degrees, m/s, Hz and degrees per second."""


def facade(setup, *, turn_deg, distance_m, length_m, height_m, step_m=0.25):
    """Map the lattice over a facade that is turned about its middle.

    Parameters
    ----------
    setup : ScanSetup
    turn_deg : float
        Positive towards the vehicle, as a target's heading.
    distance_m : float
        X of the facade's middle.
    length_m, height_m : float
        The facade reaches from 2 m below the scanner upwards.
    step_m : float

    Returns
    -------
    Dataset
        ``MAPPED`` and ``f`` over ``height`` and ``along``, metres.
    """
    along = np.arange(-length_m / 2, length_m / 2 + step_m / 2, step_m)
    height = np.arange(-2.0, height_m - 2.0 + step_m / 2, step_m)
    u, z = np.meshgrid(along, height)
    turn = np.radians(turn_deg)
    points = np.stack([distance_m - u * np.sin(turn), u * np.cos(turn), z], axis=-1)
    patch = Patch(points, [-np.cos(turn), -np.sin(turn), 0])
    return _dataset(scan_lattice(setup, patch), {"height": height, "along": along})


def post(setup, *, distance_m, radius_m, heights_m, azimuths_deg):
    """Map the lattice over an upright post; NaN where it looks away.

    Returns
    -------
    Dataset
        ``MAPPED`` and ``f`` over ``height`` (m) and ``azimuth`` (degrees from X).
    """
    patch = Patch.cylinder(
        [distance_m, 0], radius_m, azimuths_deg=azimuths_deg, heights_m=heights_m
    )
    lattice = scan_lattice(setup, patch)
    coordinates = {"height": heights_m, "azimuth": azimuths_deg}
    return _dataset(lattice, coordinates).where(xr.DataArray(lattice.facing, coordinates))


def _dataset(lattice, coordinates):
    """Mapped quantities of a lattice as a Dataset with units."""
    found = xr.Dataset(coords=coordinates)
    for name in (*MAPPED, "f"):
        found[name] = (tuple(coordinates), lattice.quantity(name))
        found[name].attrs["units"] = UNITS.get(name, "m")
    return found


def counted(setup, *, distance_m, radius_m, height_m):
    """Count simulated points on a wall patch and on a post, beside the closed form.

    Returns
    -------
    DataFrame
        ``surface``, ``counted``, ``predicted``, ``ratio``.
    """
    scanner = simulate.ProfileScanner(
        pulse_rate_hz=setup.pulse_rate_hz,
        mirror_frequency_hz=setup.mirror_frequency_hz,
        heading_deg=setup.scanner_heading_deg,
        tilt_deg=setup.scanner_tilt_deg,
    )
    half = height_m / 2
    ends = (distance_m, 0, -half - 1), (distance_m, 0, half + 1)
    surfaces = {
        "wall, 2 m wide": simulate.rectangle((distance_m, -1, -half), (0, 2, 0), (0, 0, height_m)),
        f"post, {100 * radius_m:.0f} cm radius": simulate.cylinder(*ends, radius_m),
    }
    y, z = np.meshgrid((np.arange(40) - 19.5) / 20, (np.arange(100) - 49.5) * height_m / 100)
    flat = Patch(np.stack([0 * y + distance_m, y, z], axis=-1), [-1, 0, 0])
    azimuths, heights = np.arange(720) / 2, z[:, 0]
    round_ = Patch.cylinder([distance_m, 0], radius_m, azimuths_deg=azimuths, heights_m=heights)
    areas = 2 * height_m / y.size, radius_m * np.radians(0.5) * height_m / 100
    rows = []
    for (name, surface), patch, area in zip(surfaces.items(), (flat, round_), areas, strict=True):
        reach = patch.points @ setup.plane_normal / setup.plane_normal[1]
        first, last = reach.min() - 0.5, reach.max() + 0.5
        path = simulate.straight(last - first, setup.speed_m_s, start=(0, first, 0))
        cloud = simulate.scan_all(simulate.Scene([surface]), scanner, path, seed=1)
        number = int((np.abs(cloud.points[:, 2]) < half).sum())
        lattice = scan_lattice(setup, patch)
        predicted = float((lattice.density_per_m2 * lattice.facing).sum() * area)
        rows.append((name, number, predicted, number / predicted))
    return pd.DataFrame(rows, columns=["surface", "counted", "predicted", "ratio"])


def two_heads(setup, *, headings_deg, turns_deg, distance_m):
    """Predict what one and two heads lay on facades that are turned.

    Parameters
    ----------
    setup : ScanSetup
        Of the first head; the second differs in heading alone.
    headings_deg : pair of float
    turns_deg : sequence of float
        Of the facade.
    distance_m : float

    Returns
    -------
    DataFrame
        ``turn_deg``, ``density_first_per_m2``, ``density_second_per_m2``, ``density_per_m2`` of
        both, ``crossing_deg``; 0 where a head sees the back, and then no crossing (NaN).
    """
    rows = []
    for turn in turns_deg:
        normal = -Target(heading_deg=turn, range_m=1).normal
        patch = Patch([distance_m, 0, 0], normal)
        heads = [
            scan_lattice(replace(setup, scanner_heading_deg=heading), patch)
            for heading in headings_deg
        ]
        seen = [_front(setup, heading, normal) for heading in headings_deg]
        density = [head.density_per_m2 * sees for head, sees in zip(heads, seen, strict=True)]
        crossing = float(heads[0].crossing_angle(heads[1])) if all(seen) else np.nan
        rows.append((turn, *density, sum(density), crossing))
    names = ["turn_deg", "density_first_per_m2", "density_second_per_m2", "density_per_m2"]
    return pd.DataFrame(rows, columns=[*names, "crossing_deg"])


def _front(setup, heading, normal):
    """Whether the horizontal pulse of a head comes from the front of a wall."""
    level = replace(setup, scanner_heading_deg=heading).rotation()[:, 0]
    return bool(level @ normal < -1e-9)


def error_budget(setup, target, *, draws, seed, errors=None):
    """Propagate each source of error alone, and all together in both ways.

    Returns
    -------
    DataFrame
        A row per source and quantity: ``source``, ``quantity``, ``predicted``, ``std``, ``method``,
        ``n``; the sources ``all`` by first order and by Monte Carlo.
    """
    errors = ERRORS if errors is None else errors
    together = {name: sigma for part in errors.values() for name, sigma in part.items()}
    tables = [
        propagate(setup, target, sigmas=sigmas).assign(source=source)
        for source, sigmas in {**errors, "all": together}.items()
    ]
    drawn = propagate(setup, target, sigmas=together, method="monte_carlo", draws=draws, seed=seed)
    tables.append(drawn.assign(source="all"))
    return pd.concat(tables, ignore_index=True)


def attitude(setup, target):
    """Return what a degree, and a degree per second, of attitude changes.

    Returns
    -------
    DataFrame
        ``input``; ``horizontal_mm``, ``vertical_mm``, ``perpendicular_mm``, ``angle_deg``.
    """
    inputs = ["roll_deg", "pitch_deg", "heading_deg", "roll_rate_deg_s", "pitch_rate_deg_s"]
    slopes = sensitivities(setup, target, inputs=[*inputs, "heading_rate_deg_s"])
    spacing = "profile_spacing_{}_m"
    ways = ("horizontal", "vertical", "perpendicular")
    found = pd.DataFrame({f"{way}_mm": 1000 * slopes[spacing.format(way)] for way in ways})
    return found.assign(angle_deg=slopes["profile_angle_deg"]).reset_index()


def largest_speeds(setup, *, limits, distances_m):
    """Return the largest speed that keeps each limit, over the distance of a parallel wall.

    Parameters
    ----------
    setup : ScanSetup
    limits : dict of str to float
        Per quantity.
    distances_m : sequence of float

    Returns
    -------
    DataFrame
        ``quantity``, ``limit``, ``distance_m``, ``speed_m_s``; NaN where no speed keeps it.
    """
    rows = []
    for quantity, limit in limits.items():
        for distance in distances_m:
            try:
                speed = largest_speed(
                    setup, Target(range_m=distance), quantity=quantity, limit=limit
                )
            except ValueError:
                speed = np.nan
            rows.append((quantity, limit, distance, speed))
    return pd.DataFrame(rows, columns=["quantity", "limit", "distance_m", "speed_m_s"])


def pattern(
    *,
    speed,
    mirror_frequency,
    pulse_rate_khz,
    scanner_heading,
    scanner_tilt,
    target_heading,
    target_tilt,
    range_m,
    half_width=0.25,
):
    """Return the lattice of a set-up and the points it lays about the spot.

    Returns
    -------
    Lattice, array of shape (n, 2)
        Points along the level line and the line of greatest slope, metres, within ``half_width``.
    """
    setup = ScanSetup(
        pulse_rate_hz=1000 * pulse_rate_khz,
        mirror_frequency_hz=mirror_frequency,
        speed_m_s=speed,
        scanner_heading_deg=scanner_heading,
        scanner_tilt_deg=scanner_tilt,
    )
    target = Target(heading_deg=target_heading, tilt_deg=target_tilt, range_m=range_m)
    lattice = scan_lattice(setup, target.patch(setup))
    a, _, b = lattice.plane_steps()
    inverse = np.linalg.inv(np.array([a, b]).T)
    reach = np.ceil(np.abs(inverse).sum(axis=1) * half_width).astype(int)
    i, j = np.meshgrid(*(np.arange(-r, r + 1) for r in np.minimum(reach, 2000)))
    xy = np.multiply.outer(i, a) + np.multiply.outer(j, b)
    return lattice, xy[(np.abs(xy) <= half_width).all(axis=-1)]
