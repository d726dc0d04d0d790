"""An urban canyon of three streets, surveyed by three courses and a static scanner.

It stands in for the unpublished edges of Poreba & Goulette 2013 (hal-00846334): facades along
three streets give straight edges; each course sees a part of them, displaced by its positioning
error, turned, cut short, split and mixed with clutter. Which segments belong together is known,
and so is every displacement. ``canyon_cloud`` covers the faces of the houses with points.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_choice, check_number, check_positive
from mmqa_lab._streams import stream
from mmqa_lab.cloud import Cloud
from mmqa_lab.simulate.canyon_houses import (
    house_edges,
    house_faces,
    house_outline,
    houses,
    located,
    side_face,
)
from mmqa_lab.simulate.canyon_surveys import (
    CENTRE_M,
    SHARED_BIAS_M,
    Positioning,
    Survey,
    positionings,
    seen,
    survey,
)

__all__ = [
    "CENTRE_M", "COMPARISONS", "Canyon", "Positioning", "Survey", "canyon", "canyon_cloud",
    "canyon_edges", "canyon_faces",
]  # fmt: skip


COMPARISONS = {
    "repeatability": (("C1", "C2"), ("C1", "C3"), ("C2", "C3")),
    "absolute": (("C1", "TLS"), ("C2", "TLS"), ("C3", "TLS")),
}
"""Test and model of each comparison, as in Tables 1 and 2 of the paper."""


@dataclass(frozen=True, eq=False)
class Canyon:
    """A scene: its buildings, its true edges and the surveys of it.

    Parameters
    ----------
    buildings : DataFrame
        ``street``, ``side`` (-1, 1), ``start_m``, ``width_m``, ``setback_m``, ``height_m``.
    edges : array, shape (m, 2, 3)
        The true edges, m.
    street : array of int
        The street of each edge.
    surveys : dict of str to Survey
        ``C1``, ``C2``, ``C3``, ``TLS``.
    """

    buildings: pd.DataFrame
    edges: np.ndarray
    street: np.ndarray
    surveys: dict = field(repr=False)

    def pairs(self, test: str, model: str) -> np.ndarray:
        """True pairs of two surveys, bool (p, q).

        Pieces of one edge are a pair when they share more than 20 % of the shorter one.
        """
        test, model = self.surveys[test], self.surveys[model]
        same = (test.edge[:, None] == model.edge[None]) & (test.edge >= 0)[:, None]
        low = np.maximum(test.interval[:, None, 0], model.interval[None, :, 0])
        high = np.minimum(test.interval[:, None, 1], model.interval[None, :, 1])
        size = [np.diff(survey.interval, axis=1)[:, 0] for survey in (test, model)]
        least = np.minimum(size[0][:, None], size[1][None])
        return same & (high - low > 0.2 * least)

    def displacements(self, test: str, model: str) -> np.ndarray:
        """Displacement of each true pair, test from model, shape (pairs, 3), m, in row order."""
        rows, columns = np.nonzero(self.pairs(test, model))
        test, model = self.surveys[test], self.surveys[model]
        return test.displacement[rows] - model.displacement[columns]


def canyon(
    seed: int, *, displacement_m: float | None = None, angle_noise_deg: float = 0.08
) -> Canyon:
    """Simulate the canyon and its four surveys.

    A scene is 130 m x 120 m with facades 9-22 m wide and 12-21 m high along streets of 14, 9 and
    8 m. C1 and C3 pass the same facades, C2 others. The mean numbers of segments and true pairs
    follow the paper's tables (36, 28, 41 and 64 segments).

    Parameters
    ----------
    seed : int
        Equal seeds give equal scenes.
    displacement_m : float, optional
        Length of the displacement that all courses share, m; by default 0.62 to 0.82 m.
    angle_noise_deg : float
        Standard deviation of the courses' edge directions, degrees; the static scanner has a
        quarter of it.

    Returns
    -------
    Canyon

    Raises
    ------
    ValueError
        If a displacement or noise is negative.

    Notes
    -----
    The shares of edges, splits and clutter are assumptions of this simulator, set so that the
    numbers of segments and true pairs agree with the paper. The lengths of the displacements,
    drift, and noise of directions and ends were fitted to the distances and errors of four rows,
    C1-C2, C1-C3, C1-TLS and C2-TLS; C2-C3, C3-TLS and the second extraction of C1-C3 were held out.
    Directions with 0.3 degrees of noise or more fit the printed distances clearly worse. The canyon
    has the extent of the test site and is no reconstruction of it.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), Tables 1 and 2: counts and distances.

    Examples
    --------
    >>> scene = canyon(1)
    >>> sorted(scene.surveys), scene.pairs("C1", "C3").sum() > scene.pairs("C1", "C2").sum()
    (['C1', 'C2', 'C3', 'TLS'], np.True_)
    """
    angle_noise_deg = check_number(angle_noise_deg, "angle_noise_deg", low=0)
    shared = SHARED_BIAS_M if displacement_m is None else (displacement_m, displacement_m)
    check_number(shared[0], "displacement_m", low=0, unit="m")
    rng = stream(seed, "canyon")
    buildings = houses(rng)
    ends, street = house_edges(buildings, rng)
    found = seen(len(ends), rng)
    surveys = {}
    for name, positioning in positionings(shared, rng).items():
        rows = np.flatnonzero(found[name])
        surveys[name] = survey(name, ends, street, rows, positioning, angle_noise_deg, rng)
    return Canyon(buildings, ends, street, surveys)


def canyon_faces(scene: Canyon) -> tuple[np.ndarray, np.ndarray]:
    """The plane faces of a canyon: fronts, pavements, eaves, and walls between houses.

    Parameters
    ----------
    scene : Canyon

    Returns
    -------
    faces : array, shape (m, 3, 3)
        A corner of each rectangle and the ends of both its sides from there, m.
    street : array of int, shape (m,)
    """
    places, streets = [], []
    for (street, _), row in scene.buildings.groupby(["street", "side"]):
        houses = list(row.itertuples())
        faces = [face for house in houses for face in house_faces(house)]
        faces += [side_face(a, b) for a, b in pairwise([None, *houses, None])]
        places += faces
        streets += [street] * len(faces)
    streets = np.array(streets)
    return located(streets, np.array(places)), streets


def canyon_edges(scene: Canyon) -> np.ndarray:
    """The edges where two faces of the canyon meet: feet, eaves and corners of the facades.

    Returns
    -------
    array, shape (n, 2, 3)
        Metres; in the order of the buildings, four each: foot, eave, corner at the start, corner at
        the end.
    """
    lines = np.array([house_outline(house) for house in scene.buildings.itertuples()])
    streets = np.repeat(scene.buildings["street"].to_numpy(), lines.shape[1])
    return located(streets, lines.reshape(-1, 2, 3))


def canyon_cloud(
    scene: Canyon, survey: str, *, density: float, noise: float = 0.01, seed: int = 0
) -> Cloud:
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
        If the density is not positive.

    Notes
    -----
    No occlusion and no scan pattern: for those, scan a scene of the faces with
    :mod:`mmqa_lab.simulate`.

    Examples
    --------
    >>> cloud = canyon_cloud(canyon(1), "C1", density=1)
    >>> 10_000 < len(cloud) < 30_000
    True
    """
    positioning = scene.surveys[check_choice(survey, "survey", scene.surveys)].positioning
    density = check_positive(density, "density", unit="per m2")
    rng = stream(seed, "canyon_cloud")
    faces, streets = canyon_faces(scene)
    corner, along, up = faces[:, 0], faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0]
    area = np.linalg.norm(np.cross(along, up), axis=1)
    face = np.repeat(np.arange(len(faces)), rng.poisson(density * area))
    a, b = rng.random((2, len(face), 1))
    points = corner[face] + a * along[face] + b * up[face]
    street = streets[face]
    points += positioning.at(points, street)
    points += rng.normal(0, noise, points.shape)
    return Cloud(points, {"face": face, "street": street}, f"canyon {survey}")
