"""What courses and a static scanner make of the edges of the canyon."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mmqa_lab.lines import lengths
from mmqa_lab.simulate.canyon_houses import STREETS, station_along
from mmqa_lab.simulate.trajectories import gauss_markov

__all__ = ["CENTRE_M", "SHARED_BIAS_M", "Positioning", "Survey", "positionings", "seen", "survey"]


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
    """Which edges each survey finds; prominent edges are found by all of them more often."""
    prominence = rng.uniform(0.25, 1.75, n)
    shared = rng.random(n) < SHARED_COURSE * prominence
    seen = {name: shared & (rng.random(n) < SHARED_SEEN) for name in ("C1", "C3")}
    return seen | {name: rng.random(n) < share * prominence for name, share in SEEN.items()}


def positionings(shared_m: tuple[float, float], rng: np.random.Generator) -> dict[str, Positioning]:
    """The positioning error of each course; the static scanner has none."""
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
    """What a survey makes of the edges ``rows``: pieces of them, displaced and noisy."""
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
