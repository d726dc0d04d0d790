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
from mmqa_lab.lines import lengths
from mmqa_lab.simulate.canyon_houses import (
    STREETS,
    house_edges,
    house_faces,
    house_outline,
    houses,
    located,
    side_face,
    station_along,
)
from mmqa_lab.simulate.trajectories import gauss_markov

__all__ = [
    "CENTRE_M", "COMPARISONS", "Canyon", "Positioning", "Survey", "canyon", "canyon_cloud",
    "canyon_edges", "canyon_faces",
]  # fmt: skip


COMPARISONS = {
    "repeatability": (("C1", "C2"), ("C1", "C3"), ("C2", "C3")),
    "absolute": (("C1", "TLS"), ("C2", "TLS"), ("C3", "TLS")),
}
"""Test and model of each comparison, as in Tables 1 and 2 of the paper."""


CENTRE_M = np.array([65.0, 60.0, 0.0])


SHARED_COURSE, SHARED_SEEN = 0.39, 0.84
"""Share of the edges along the way of C1 and C3, and what each of the two finds of them."""


SEEN = {"C2": 0.265, "TLS": 0.57}


DRIFT_LENGTH_M = 60.0


DRIFT_STEP_M = 5.0


YAW_DEG = 0.05


POSITION_NOISE_M = {"C1": 0.04, "C2": 0.04, "C3": 0.04, "TLS": 0.03}


ANGLE_FROM_POSITION_M = 0.02


SHARED_BIAS_M = (0.62, 0.82)
"""Range of the length of the displacement that all courses share (GNSS)."""


OWN_BIAS_M, COURSE2_M = 0.09, 0.45
"""Length of each course's own displacement, and what Course 2 has beyond the others along the
shared one: the paper finds the worst repeatability with it and names poor GNSS as the cause."""


DRIFT_M, END_NOISE_M = 0.08, 0.22
"""Standard deviations of each course's drift per street and axis, and of ends along their edge."""


SPLITS, TRUNCATIONS, CLUTTER = 0.12, 0.35, 0.08
"""Shares of segments found in two pieces, cut short, and without any counterpart."""


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
    """Return the plane faces of a canyon: fronts, pavements, eaves, and walls between houses.

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
    """Return the edges where two faces of the canyon meet: feet, eaves and corners of the facades.

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


@dataclass(frozen=True, eq=False)
class Positioning:
    """Error of a course's positions: constant, drifting along each street, and turned.

    Parameters
    ----------
    bias : array, shape (3,)
        Metres.
    drift : array, shape (streets, nodes, 3)
        Metres, a node every 5 m along the street.
    yaw : float
        Radians, about the centre of the scene.
    """

    bias: np.ndarray
    drift: np.ndarray
    yaw: float

    def at(self, points: np.ndarray, street: np.ndarray) -> np.ndarray:
        """Displacement of points (n, 3) of the given streets (n,), shape (n, 3), m."""
        points, street = np.asarray(points, dtype=np.float64), np.asarray(street)
        station = station_along(points, street) / DRIFT_STEP_M
        node = np.clip(station.astype(int), 0, self.drift.shape[1] - 2)
        part = np.clip(station - node, 0, 1)[:, None]
        drift = (1 - part) * self.drift[street, node] + part * self.drift[street, node + 1]
        arm = points - CENTRE_M
        turned = self.yaw * np.stack([-arm[:, 1], arm[:, 0], np.zeros(len(arm))], axis=1)
        return self.bias + drift + turned


@dataclass(frozen=True, eq=False)
class Survey:
    """The segments that one survey found, and where they come from.

    Parameters
    ----------
    segments : array, shape (n, 2, 3)
        Metres.
    edge : array of int, shape (n,)
        The true edge of each; -1 for clutter.
    interval : array, shape (n, 2)
        The part of the true edge that it shows, m from the edge's first end; NaN for clutter.
    displacement : array, shape (n, 3)
        The positioning error at its midpoint, m.
    positioning : Positioning
    """

    segments: np.ndarray
    edge: np.ndarray
    interval: np.ndarray
    displacement: np.ndarray
    positioning: Positioning


def seen(n: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return which edges each survey finds; prominent edges are found by all of them more often."""
    prominence = rng.uniform(0.25, 1.75, n)
    shared = rng.random(n) < SHARED_COURSE * prominence
    seen = {name: shared & (rng.random(n) < SHARED_SEEN) for name in ("C1", "C3")}
    return seen | {name: rng.random(n) < share * prominence for name, share in SEEN.items()}


def positionings(shared_m: tuple[float, float], rng: np.random.Generator) -> dict[str, Positioning]:
    """Return the positioning error of each course; the static scanner has none."""
    nodes = int(STREETS["length_m"].max() / DRIFT_STEP_M) + 2
    length, towards = rng.uniform(*shared_m), _unit_vector(rng)
    errors = {}
    for name in ("C1", "C2", "C3"):
        shared = length + (COURSE2_M if name == "C2" else 0.0)
        own = OWN_BIAS_M * _unit_vector(rng)
        shape = len(STREETS), nodes, 3
        drift = DRIFT_M * gauss_markov(shape, DRIFT_STEP_M, DRIFT_LENGTH_M, rng, axis=1)
        turned = np.radians(rng.normal(0, YAW_DEG))
        errors[name] = Positioning(shared * towards + own, drift, turned)
    still = np.zeros((len(STREETS), nodes, 3))
    return errors | {"TLS": Positioning(np.zeros(3), still, 0.0)}


def _unit_vector(rng):
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def survey(
    name: str,
    ends: np.ndarray,
    street: np.ndarray,
    rows: np.ndarray,
    positioning: Positioning,
    angle_noise_deg: float,
    rng: np.random.Generator,
) -> Survey:
    """Return what a survey makes of the edges ``rows``: pieces of them, displaced and noisy."""
    vectors, sizes = ends[:, 1] - ends[:, 0], lengths(ends)
    pieces = [(row, *cut) for row in rows for cut in _pieces(sizes[row], rng)]
    edge = np.array([piece[0] for piece in pieces], dtype=int)
    interval = np.array([piece[1:] for piece in pieces], dtype=float).reshape(-1, 2)
    share = (interval / sizes[edge, None])[..., None]
    found = ends[edge, :1] + share * vectors[edge, None]
    found = np.concatenate([found, _clutter(rng.binomial(len(edge), CLUTTER), rng)])
    strays = len(found) - len(edge)
    streets = np.concatenate([street[edge], rng.integers(len(STREETS), size=strays)])
    displacement = positioning.at(found.mean(axis=1), streets)
    angle = angle_noise_deg * (0.25 if name == "TLS" else 1.0)
    found = _noisy(found, angle, POSITION_NOISE_M[name], rng) + displacement[:, None]
    flip = rng.random(len(found)) < 0.5
    found[flip] = found[flip, ::-1]
    order = rng.permutation(len(found))
    edge = np.concatenate([edge, np.full(strays, -1)])
    interval = np.concatenate([interval, np.full((strays, 2), np.nan)])
    return Survey(found[order], edge[order], interval[order], displacement[order], positioning)


def _pieces(length, rng):
    """Intervals along an edge that a survey finds: whole, cut short, or in two."""
    low, high = 0.0, length
    if rng.random() < TRUNCATIONS:
        size = length * rng.uniform(0.4, 0.9)
        low = rng.uniform(0, length - size)
        high = low + size
    if rng.random() >= SPLITS or high - low < 3:
        return [(low, high)]
    middle = low + (high - low) * rng.uniform(0.3, 0.7)
    gap = rng.uniform(0.1, 0.5)
    return [(low, middle - gap), (middle + gap, high)]


def _clutter(n, rng):
    """Segments of things that no other survey shows: mostly level or upright, anywhere."""
    middle = rng.uniform([0, 0, 0], [130, 120, 12], (n, 3))
    axes = np.eye(3)[rng.integers(3, size=n)]
    free = rng.random(n) < 0.25
    axes[free] = rng.normal(size=(free.sum(), 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    half = rng.uniform(0.75, 5, (n, 1)) * axes
    return np.stack([middle - half, middle + half], axis=1)


def _noisy(ends, angle_deg, position, rng):
    """Segments with their ends moved along, directions turned and places shifted at random."""
    vectors = ends[:, 1] - ends[:, 0]
    sizes = lengths(ends)
    unit = vectors / sizes[:, None]
    sigma = np.hypot(np.radians(angle_deg), ANGLE_FROM_POSITION_M / sizes)
    tilt = rng.normal(size=unit.shape)
    tilt -= (tilt * unit).sum(axis=1, keepdims=True) * unit
    turned = unit + tilt * (sigma / np.sqrt(2))[:, None]
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    half = sizes[:, None] / 2 + rng.normal(0, END_NOISE_M, (len(ends), 2)) * [-1, 1]
    half = np.maximum(half, 0.25)
    middle = ends.mean(axis=1) + rng.normal(0, position, unit.shape)
    return np.stack([middle - half[:, :1] * turned, middle + half[:, 1:] * turned], axis=1)
