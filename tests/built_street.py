"""A fourth street generator, for tests alone: its streets calibrate the scores of the poles.

Poles (flags, meters, signs on two posts, trees behind hoops, rows of bollards) among shelters,
arcades, scaffolding, fence pillars, bins, stairs, cyclists and rails. Rays: ``other_street``.
"""

import numpy as np
import other_street


def make(seed, length=30.0):
    """A street with eight poles or so on each side, and what is none."""
    rng = np.random.default_rng([seed, 97])
    street = other_street.OtherStreet(length, slope=float(rng.choice([0, 0.05])))
    low = -60 * street.slope
    street.face((-70, -60, low), (140, 0, 0), (0, length + 120, (length + 120) * street.slope))
    street.balls.append([90.0, 0, 5, 1, 1])
    poles = [_flag, _meter, _two_posts, _hooped, _bollards, _lamp]
    others = [_shelter, _arcade, _scaffold, _pillars, _bins, _stairs, _cyclists, _rails]
    for side in (-1, 1):
        y, kinds = rng.uniform(0, 3), []
        while y < length:
            kinds = kinds or list(rng.permutation(poles + others))
            across = side * rng.uniform(4, 9.5)
            foot = np.array([across, y, street.slope * y])
            y += kinds.pop()(street, rng, foot, side) + rng.uniform(0.6, 1.6)
    return street


def _post(street, foot, height, diameter, kind="other"):
    """A pole that leans a little with its place; returns its top."""
    lean = 0.01 * np.sin(np.array([3.1, 1.7]) * foot[1])
    return street.pole(kind, foot, height, diameter, lean)


def _stick(street, foot, height, radius, along=0.0, out=0.0):
    """A shaft that is no pole, its foot ``along`` and ``out`` from a place."""
    low = foot + np.array([out, along, street.slope * along])
    street.cylinder(low - [0, 0, 0.1], low + [0, 0, height], radius)
    street.columns.append(low)


def _flag(street, rng, foot, side):
    top = _post(street, foot, rng.uniform(5, 8), rng.uniform(0.08, 0.13))
    street.face(top - [0, 0, 0.1], (0.9 * rng.choice([-1, 1]), 0.3, -0.2), (0, 0, -2.5))
    return 0.4


def _meter(street, rng, foot, side):
    top = _post(street, foot, rng.uniform(1.2, 1.6), rng.uniform(0.06, 0.1))
    street.block(top - [0.08, 0.08, 0.05], top + [0.08, 0.08, 0.3])
    return 0.4


def _two_posts(street, rng, foot, side):
    wide, height = rng.uniform(0.9, 2.2), rng.uniform(2.0, 3.2)
    for along in (0, wide):
        _post(street, foot + [0, along, street.slope * along], height, 0.08, "sign")
    street.face(foot + [side * 0.06, -0.2, 1.1], (0, wide + 0.4, 0), (0, 0, height - 1.1))
    return wide + 0.4


def _hooped(street, rng, foot, side):
    """A tree with a low crown behind two hoops of pipe."""
    fork = _post(street, foot, rng.uniform(2.0, 3.5), rng.uniform(0.1, 0.3), "tree")
    for x, y in rng.uniform(-0.6, 0.6, (4, 2)):
        street.balls.append([*(fork + [x, y, rng.uniform(0.6, 1.2)]), rng.uniform(0.6, 1.1), 1.1])
    for out in (-0.5, 0.5):
        for along in (-0.4, 0.4):
            street.cylinder(foot + [out, along, 0], foot + [out, along, 0.8], 0.025)
        street.cylinder(foot + [out, -0.4, 0.8], foot + [out, 0.4, 0.8], 0.025)
    return 1.2


def _bollards(street, rng, foot, side):
    step, height, wide = rng.uniform(1.2, 2), rng.uniform(1.1, 1.3), rng.uniform(0.08, 0.16)
    for k in range(3):
        _post(street, foot + [0, k * step, street.slope * k * step], height, wide)
    return 2 * step


def _lamp(street, rng, foot, side):
    top = _post(street, foot, rng.uniform(4, 9), rng.uniform(0.1, 0.2), "lamp")
    street.balls.append([*(top + [0, 0, 0.2]), 0.25, 1e3])
    street.block(foot + [-0.15, -0.2, 0.0], foot + [0.15, 0.2, rng.uniform(0.5, 1.0)])
    return 0.5


def _shelter(street, rng, foot, side):
    long, deep = rng.uniform(2.5, 4), rng.uniform(1.2, 1.8) * side
    for along in (0, long):
        for out in (0, deep):
            _stick(street, foot, 2.3, 0.04, along, out)
    low, high = sorted([foot[0], foot[0] + deep])
    street.block((low - 0.2, foot[1] - 0.2, foot[2] + 2.3), (high, foot[1] + long, foot[2] + 2.4))
    street.face(foot + [deep, 0, 0.2], (0, long, 0), (0, 0, 1.9))
    return long


def _arcade(street, rng, foot, side):
    """Square or round piers that carry a storey, whose wall stands flush over them or set back."""
    n, step, wide = rng.integers(2, 5), rng.uniform(1.6, 2.6), rng.uniform(0.2, 0.45)
    rise, back = rng.uniform(2.4, 3.4), side * rng.choice([0, 1.0])
    for k in range(n):
        at = foot + [0, k * step, street.slope * k * step]
        if rng.random() < 0.6:
            half = [wide / 2, wide / 2]
            street.block(at - [*half, 0.3], [*(at[:2] + half), foot[2] + rise])
            street.columns.append(at)
        else:
            _stick(street, at, rise, wide / 2)
    front = foot + [-side * wide / 2, -0.4, rise]
    street.face(front, (0, n * step, 0), (0, 0, 0.5))
    street.face(front + [back, 0, 0], (0, n * step, 0), (0, 0, 4))
    street.face(front, (side * 3, 0, 0), (0, n * step, 0))
    street.face(foot + [side * 2.5, -0.4, -1], (0, n * step, 0), (0, 0, rise + 1))
    return (n - 1) * step + 0.5


def _scaffold(street, rng, foot, side):
    n, bay = rng.integers(2, 4), rng.uniform(1.8, 2.5)
    street.face(foot + [side * 1.3, -0.5, -1], (0, n * bay + 1, 0), (0, 0, 8))
    for k in range(n + 1):
        for out in (0, side * 0.9):
            _stick(street, foot, 5.5, 0.024, k * bay, out)
    for level in (2.0, 4.0):
        street.face(foot + [0, 0, level], (side * 0.9, 0, 0), (0, n * bay, 0))
        for up in (0.5, 1.0):
            rail = foot + [0, 0, level + up]
            street.cylinder(rail, rail + [0, n * bay, 0], 0.024)
    return n * bay + 0.5


def _pillars(street, rng, foot, side):
    """Fence pillars at most five times as high as wide, with panels or rails between."""
    n, step, wide = rng.integers(2, 4), rng.uniform(1.5, 2.5), rng.uniform(0.25, 0.6)
    height, round_ = rng.uniform(3, 5) * wide, rng.random() < 0.4
    for k in range(n):
        at = foot + [0, k * step, street.slope * k * step]
        if round_:
            _stick(street, at, height, wide / 2)
            continue
        street.block(at - [wide / 2, wide / 2, 0.3], at + [wide / 2, wide / 2, height])
        street.columns.append(at)
    rise = np.array([0, (n - 1) * step, street.slope * (n - 1) * step])
    if rng.random() < 0.5:
        street.face(foot, rise, (0, 0, 0.7 * height))
    else:
        for up in (0.3, 0.7):
            street.cylinder(foot + [0, 0, up * height], foot + rise + [0, 0, up * height], 0.03)
    return (n - 1) * step + 0.6


def _bins(street, rng, foot, side):
    """A bin, a cabinet, or a pillar for bills."""
    wide, height = [(0.45, 1.1), (0.6, 1.4), (1.2, 3.2)][rng.integers(3)]
    if height == 1.4:
        street.block(foot - [0.2, 0.4, 0.1], foot + [0.2, 0.4, height])
        street.columns.append(foot)
    else:
        _stick(street, foot, height, wide / 2)
    return wide


def _stairs(street, rng, foot, side):
    """Four steps out of the road's way, with two handrails on bars."""
    long = 1.6
    for k in range(4):
        corner = foot + [side * 0.3 * k, 0, -1]
        far = foot + [side * (0.3 * k + 0.3), long, 0.17 * (k + 1)]
        street.block(np.minimum(corner, far), np.maximum(corner, far))
    for along in (0.1, long - 0.1):
        for k in (0, 3):
            _stick(street, foot + [0, 0, 0.17 * (k + 1)], 0.95, 0.02, along, side * (0.3 * k + 0.1))
        rail = foot + [side * 0.1, along, 1.1]
        street.cylinder(rail, rail + [side * 0.9, 0, 0.55], 0.02)
    street.face(foot + [side * 1.3, -2, -1], (0, long + 4, 0), (0, 0, 6))
    return long


def _cyclists(street, rng, foot, side):
    """Two or three people, each with a bicycle of a flat frame."""
    for k in range(rng.integers(2, 4)):
        at = foot + [rng.uniform(-0.4, 0.4), 0.9 * k, street.slope * 0.9 * k]
        street.cylinder(at, at + [0, 0, 1.45], rng.uniform(0.14, 0.2))
        street.balls.append([*(at + [0, 0, 1.62]), 0.11, 1e3])
        street.face(at + [0.35, -0.8, 0.3], (0, 1.6, 0), (0, 0.2, 0.5), triangle=True)
        street.columns.append(at)
    return 2.5


def _rails(street, rng, foot, side):
    """A front with a balcony on every floor: bars, a hand rail, and props below some."""
    long, out, floors = rng.uniform(2.5, 4), side * rng.uniform(0.8, 1.3), rng.integers(1, 3)
    street.face(foot + [side * 1.5, -1, -1], (0, long + 2, 0), (0, 0, 3.2 * floors + 4))
    near = side * 1.5 - out
    for floor in range(1, floors + 1):
        deck = foot + [near, 0, 3.1 * floor]
        street.face(deck, (out, 0, 0), (0, long, 0))
        for along in np.arange(0, long, rng.uniform(0.12, 0.8)):
            street.cylinder(deck + [0, along, 0], deck + [0, along, 1.0], 0.012)
        street.cylinder(deck + [0, 0, 1], deck + [0, long, 1], 0.022)
    if rng.random() < 0.6:
        for along in (0.1, long - 0.1):
            _stick(street, foot, 3.1, rng.uniform(0.05, 0.1), along, near)
    pipe = foot + [side * 1.42, long + 0.5, 0]
    street.cylinder(pipe, pipe + [0, 0, 3.2 * floors + 2], 0.05)
    street.columns.append(pipe)
    return long + 1


def looked_at(seed, scanner, length=30.0):
    """Points, poles as a table (visible with 15 points), path and the street."""
    street = make(seed, length)
    points, *_, pole, path = other_street.scan(street, scanner, seed)
    truth, _ = other_street.tables(street, pole)
    return points, truth.assign(visible=truth["points"] >= 15), path, street
