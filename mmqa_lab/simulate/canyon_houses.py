"""The houses of the canyon along its three streets: their edges and faces."""

from __future__ import annotations

from itertools import chain
from typing import Any

import numpy as np
import pandas as pd

__all__ = [
    "STREETS", "house_edges", "house_faces", "house_outline", "houses", "located", "side_face",
    "station_along",
]  # fmt: skip


STREETS = pd.DataFrame(
    [("x", 0.0, 15.0, 130.0, 14.0), ("x", 0.0, 95.0, 130.0, 9.0), ("y", 85.0, 24.0, 65.0, 8.0)],
    columns=["axis", "x_m", "y_m", "length_m", "width_m"],
)


SETBACKS_M = (0.0, 0.25, 0.4, 0.7, 1.2)


EDGE_SHARES = (0.33, 0.33, 0.15, 0.57, 0.57)
"""Share of the buildings where foot, eave, cornice and both corners are straight lines that a
detector can find."""


TWINS, JAMBS = 0.15, 0.2
"""Share of edges with a parallel neighbour (reveals, kerbs, cornices); mean number of window jambs
per building."""


def houses(rng: np.random.Generator) -> pd.DataFrame:
    """Return facades side by side along both sides of each street, no two neighbours flush."""
    rows = []
    for street, length in enumerate(STREETS["length_m"]):
        for side in (-1, 1):
            start, setback = rng.uniform(0, 5), None
            while start < length - 9:
                width, height = min(rng.uniform(9, 22), length - start), rng.uniform(12, 21)
                setback = rng.choice([value for value in SETBACKS_M if value != setback])
                rows.append((street, side, start, width, setback, height))
                start += width
    columns = ["street", "side", "start_m", "width_m", "setback_m", "height_m"]
    return pd.DataFrame(rows, columns=columns)


def house_edges(buildings: pd.DataFrame, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """End points (n, 2, 3) of the true edges and the street of each."""
    lines = [_building_edges(house, rng) for house in buildings.itertuples()]
    streets = np.repeat(buildings["street"].to_numpy(), [len(edges) for edges in lines])
    ends = located(streets, np.array(list(chain(*lines))))
    twin = rng.random(len(ends)) < TWINS
    return np.concatenate([ends, _twins(ends[twin], rng)]), np.concatenate([streets, streets[twin]])


def _building_edges(house, rng):
    """The edges of a facade that a detector can find, as ``house_outline`` gives them."""
    left, right, top, offset = _extent(house)
    level = rng.uniform(3.5, 4.5)
    lines = house_outline(house)
    lines.insert(2, ((left, offset, level), (right, offset, level)))
    lines = [line for line, share in zip(lines, EDGE_SHARES, strict=True) if rng.random() < share]
    for _ in range(rng.poisson(JAMBS)):
        station, sill = rng.uniform(left + 1, right - 1), rng.uniform(1, top - 4)
        head = sill + rng.uniform(1.5, 2.5)
        lines.append(((station, offset, sill), (station, offset, head)))
    return lines


def house_outline(house: Any) -> list[tuple]:
    """Foot, eave and both corners of a facade, as (station, offset, height) of both ends."""
    left, right, top, offset = _extent(house)
    low = (left, offset, 0.0), (right, offset, 0.0)
    high = (left, offset, top), (right, offset, top)
    return [low, high, *zip(low, high, strict=True)]


def _extent(house):
    """First and last station of a facade, its height, and its signed offset from the axis, m."""
    offset = house.side * (STREETS["width_m"][house.street] / 2 + house.setback_m)
    return house.start_m, house.start_m + house.width_m, house.height_m, offset


def located(street: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Coordinates of places (n, m, 3): station along a street (n,), offset from it, height."""
    turned = (STREETS["axis"] == "y").to_numpy()[street, None, None]
    origin = STREETS[["x_m", "y_m"]].assign(z_m=0.0).to_numpy()[street, None]
    return origin + np.where(turned, places[..., [1, 0, 2]], places)


def station_along(points: np.ndarray, street: np.ndarray) -> np.ndarray:
    """Return metres along the street of points (n, 3) of the streets (n,)."""
    along_x = (STREETS["axis"] == "x").to_numpy()[street]
    origin = STREETS[["x_m", "y_m"]].to_numpy()[street]
    return np.where(along_x, points[:, 0] - origin[:, 0], points[:, 1] - origin[:, 1])


def _twins(ends, rng):
    """Parallel neighbours 0.3-1.1 m off the given edges."""
    vectors = ends[:, 1] - ends[:, 0]
    across = np.cross(vectors, rng.normal(size=vectors.shape))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return ends + (across * rng.uniform(0.3, 1.1, (len(ends), 1)))[:, None]


def house_faces(house: Any) -> list[tuple]:
    """Front, pavement and soffit (0.6 m) of a house: a corner and the ends of both sides each."""
    left, right, top, offset = _extent(house)
    eave = offset - house.side * 0.6
    front = (left, offset, 0), (right, offset, 0), (left, offset, top)
    pavement = (left, 0, 0), (right, 0, 0), (left, offset, 0)
    soffit = (left, offset, top), (right, offset, top), (left, eave, top)
    return [front, pavement, soffit]


def side_face(a: Any, b: Any) -> tuple:
    """The wall between neighbours of different setback, or 3 m of gable at the end of a row."""
    if a is None or b is None:
        house = b if a is None else a
        left, right, top, near = _extent(house)
        station, far = left if a is None else right, near + house.side * 3.0
    else:
        station = b.start_m
        near, far = sorted((_extent(house)[3] for house in (a, b)), key=abs)
        top = a.height_m if near == _extent(a)[3] else b.height_m
    return (station, near, 0), (station, far, 0), (station, near, top)
