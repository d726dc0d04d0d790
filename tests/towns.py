"""Edges of houses in any direction seen by two surveys, for tests alone; shares nothing with ours.

The test survey is shifted, turned about the vertical and drifts smoothly (a sum of waves); both see
parts of the edges, cut short or in two, 3 cm off, and things that the other does not see.
"""

import numpy as np

MIDDLE = np.array([60.0, 60.0, 0.0])


def town(seed, shift, turn_deg=0.0, drift=0.0):
    """Segments of the test and the model survey, true pairs (p, q) and displacements (p, 3)."""
    rng = np.random.default_rng([seed, 7])
    edges = np.concatenate([_house(rng) for _ in range(rng.integers(8, 14))])
    vector = rng.normal(size=3)
    vector *= shift / np.linalg.norm(vector)
    test, of_test = _seen(edges, 0.5, rng)
    model, of_model = _seen(edges, 0.7, rng)
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    turned = (test - MIDDLE) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + MIDDLE
    waves = rng.normal(size=(60, 3))
    waves *= np.abs(rng.standard_cauchy((60, 1))) / 60 / np.linalg.norm(waves, axis=1)[:, None]
    phases, sizes = rng.uniform(0, 2 * np.pi, (60, 3)), rng.normal(size=(60, 3))
    angles = (test.mean(axis=1) @ waves.T)[:, :, None] + phases
    drifts = drift * np.sqrt(2 / 60) * (np.cos(angles) * sizes).sum(axis=1)
    moved = turned + (vector + drifts)[:, None]
    low = np.maximum(of_test[:, None, 1], of_model[None, :, 1])
    high = np.minimum(of_test[:, None, 2], of_model[None, :, 2])
    shorter = np.minimum(np.diff(of_test[:, 1:]), np.diff(of_model[:, 1:]).T)
    same = (of_test[:, None, 0] == of_model[:, 0]) & (of_test[:, :1] >= 0)
    return moved, model, same & (high - low > 0.2 * shorter), (moved - test).mean(axis=1)


def _house(rng):
    """Feet, eaves, corners and a few gutters of a house with four walls: (n, 2, 3)."""
    corner, turn = rng.uniform(0, 120, 2), rng.choice([0, rng.uniform(0, np.pi)])
    along = np.array([np.cos(turn), np.sin(turn)]) * rng.uniform(6, 18)
    back = np.array([-np.sin(turn), np.cos(turn)]) * rng.uniform(6, 12)
    top = rng.uniform(4, 14)
    plan = [corner, corner + along, corner + along + back, corner + back]
    edges = []
    for a, b in zip(plan, plan[1:] + plan[:1], strict=True):
        edges += [[[*a, 0], [*b, 0]], [[*a, top], [*b, top]], [[*a, 0], [*a, top]]]
        if rng.random() < 0.3:
            aside = 0.4 * np.array([b[1] - a[1], a[0] - b[0]]) / np.linalg.norm(b - a)
            edges.append([[*(a + aside), top], [*(b + aside), top]])
    return np.array(edges, float)


def _seen(edges, share, rng):
    """Pieces that a survey finds (n, 2, 3), with (edge, from, to) of each; -1 for strays."""
    pieces, origins = [], []
    for number in np.flatnonzero(rng.random(len(edges)) < share):
        start, way = edges[number, 0], np.diff(edges[number], axis=0)[0]
        length, cuts = np.linalg.norm(way), [(0.0, 1.0)]
        if rng.random() < 0.3:
            first = rng.uniform(0, 0.5)
            cuts = [(first, first + rng.uniform(0.4, 0.5))]
        elif rng.random() < 0.1:
            cuts = [(0.0, 0.45), (0.52, 1.0)]
        for low, high in cuts:
            tilt = rng.normal(size=3) * np.hypot(np.radians(0.15), 0.02 / length) * length / 2.8
            ends = start + np.outer([low, high], way) + rng.normal(0, 0.03, 3)
            ends += np.outer([-1, 1], tilt) + np.outer(rng.normal(0, 0.15, 2), way / length)
            pieces.append(ends[:: rng.choice([-1, 1])])
            origins.append((number, low * length, high * length))
    for _ in range(len(pieces) // 8):
        half = np.eye(3)[rng.integers(3)] * rng.uniform(1, 5)
        pieces.append(rng.uniform([0, 0, 0], [120, 120, 10]) + np.array([-half, half]))
        origins.append((-1, 0.0, 0.0))
    return np.array(pieces), np.array(origins, float)
