"""The urban canyon as a point cloud: facades, side walls, eaves and pavement of known edges."""

from itertools import pairwise

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_choice, check_count, check_number, check_positive
from mmqa_lab.cloud import Cloud
from mmqa_lab.lines import Segments
from mmqa_lab.simulate.canyon import SURVEYS, facade_offset, located

EAVE_M = 0.6
"""Width of the soffit under each eave; a facade meets it along a level edge."""

GABLE_M = 3.0
"""Depth of the wall that closes a row of houses at either end."""


def canyon_faces(scene):
    """The plane faces of a canyon.

    Parameters
    ----------
    scene : Canyon

    Returns
    -------
    DataFrame
        ``kind`` (front, pavement, eave, side), ``street``, ``corner``, ``along``, ``up``: a corner
        and both sides of each rectangle as arrays (3,), m.
    """
    rows = []
    for _, row in scene.buildings.groupby(["street", "side"]):
        houses = list(row.itertuples())
        for house in houses:
            rows += _house_faces(house)
        rows += [_side_face(a, b) for a, b in pairwise([None, *houses, None])]
    return pd.DataFrame(rows, columns=["kind", "street", "corner", "along", "up"])


def canyon_edges(scene):
    """The edges where two faces of the canyon meet: feet, eaves and corners of the facades.

    Returns
    -------
    Segments
        In the order of the buildings, four each: foot, eave, corner at the start, corner at the
        end.
    """
    ends = []
    for house in scene.buildings.itertuples():
        left, right, top = house.start_m, house.start_m + house.width_m, house.height_m
        offset = facade_offset(house)
        for line in (
            ((left, 0), (right, 0)),
            ((left, top), (right, top)),
            ((left, 0), (left, top)),
            ((right, 0), (right, top)),
        ):
            ends.append([located(house.street, s, offset, z) for s, z in line])
    return Segments(np.array(ends), name="canyon")


def canyon_cloud(scene, survey, *, density, noise=0.01, seed=0):
    """Cover the canyon with points as one survey places them.

    Parameters
    ----------
    scene : Canyon
    survey : {"C1", "C2", "C3", "TLS"}
        Whose positioning error moves the points.
    density : float
        Points per square metre on every face, at random.
    noise : float
        Standard deviation per axis, m.
    seed : int

    Returns
    -------
    Cloud
        With ``face`` (row of :func:`canyon_faces`) and ``street``.

    Raises
    ------
    ValueError
        If the survey is unknown, the density is not positive, or the noise is negative.

    Notes
    -----
    No occlusion and no scan pattern: for those, scan a scene of the faces with
    :mod:`mmqa_lab.simulate`.

    Examples
    --------
    >>> from mmqa_lab.simulate.canyon import canyon
    >>> cloud = canyon_cloud(canyon(1), "C1", density=1)
    >>> 10_000 < len(cloud) < 30_000
    True
    """
    check_choice(survey, "survey", SURVEYS)
    density = check_positive(density, "density", unit="per m2")
    noise = check_number(noise, "noise", low=0, unit="m")
    rng = np.random.default_rng(check_count(seed, "seed", low=0))
    faces = canyon_faces(scene)
    corner, along, up = (np.stack(faces[name].to_numpy()) for name in ("corner", "along", "up"))
    area = np.linalg.norm(np.cross(along, up), axis=1)
    face = np.repeat(np.arange(len(faces)), rng.poisson(density * area))
    a, b = rng.random((2, len(face), 1))
    points = corner[face] + a * along[face] + b * up[face]
    street = faces["street"].to_numpy()[face]
    points += scene.surveys[survey].positioning.at(points, street)
    points += rng.normal(0, noise, points.shape)
    return Cloud(points, {"face": face, "street": street}, f"canyon {survey}")


def _house_faces(house):
    """Front, pavement and eave of a house."""
    left, right, top = house.start_m, house.start_m + house.width_m, house.height_m
    offset = facade_offset(house)
    eave = offset - house.side * EAVE_M
    return [
        _face("front", house.street, (left, offset, 0), (right, offset, 0), (left, offset, top)),
        _face("pavement", house.street, (left, 0, 0), (right, 0, 0), (left, offset, 0)),
        _face("eave", house.street, (left, offset, top), (right, offset, top), (left, eave, top)),
    ]


def _side_face(a, b):
    """The wall between neighbours of different setback, or the gable at the end of a row."""
    if a is None or b is None:
        house = b if a is None else a
        station = house.start_m if a is None else house.start_m + house.width_m
        near, top = facade_offset(house), house.height_m
        far = near + house.side * GABLE_M
    else:
        house, station = b, b.start_m
        near, far = sorted((facade_offset(a), facade_offset(b)), key=abs)
        top = a.height_m if near == facade_offset(a) else b.height_m
    return _face("side", house.street, (station, near, 0), (station, far, 0), (station, near, top))


def _face(kind, street, corner, along, up):
    """A rectangle from a corner and the ends of both sides, each (station, offset, height)."""
    corner, along, up = (located(street, *place) for place in (corner, along, up))
    return kind, street, corner, along - corner, up - corner
