"""A third street generator, for tests alone: poles among things that only look like poles.

Gate pillars of 0.4 m x 0.4 m x 2 m, guy wires, columns of facades, posts of terraces; catenary
masts, guyed masts, traffic lights and guarded trees, on slopes. Rays are those of ``other_street``.
"""

import numpy as np
import other_street

RISES = (0.0, 0.08, 0.2)
"""Slopes of the streets along their axis, in turn."""


def make(seed, length=45.0):
    """A street with ten poles or so on each side, and what is none: ``columns``, ``pillars``."""
    rng = np.random.default_rng([seed, 91])
    street = other_street.OtherStreet(length, slope=RISES[seed % len(RISES)])
    low = -60 * street.slope
    street.face((-70, -60, low), (140, 0, 0), (0, length + 120, (length + 120) * street.slope))
    makers = [_catenary, _guyed, _light, _guarded, _post, _gate, _gate, _columns, _terrace]
    for side in (-1, 1):
        y, kinds = 1.0, list(rng.permutation(len(makers)))
        while y < length:
            kind = makers[kinds.pop() if kinds else rng.integers(len(makers))]
            out = rng.uniform(9.5, 13) if kind in (_columns, _terrace) else rng.uniform(4.5, 8)
            y += kind(street, rng, np.array([side * out, y, street.slope * y]), side)
            y += rng.uniform(0.8, 2.0)
    return street


def _up(street, foot, along=0.0, up=0.0, across=0.0):
    """A place beside a foot, as high above the ground there."""
    return foot + np.array([across, along, street.slope * along + up])


def _catenary(street, rng, foot, side):
    """A mast with two arms over the road and a wire between."""
    top = street.pole("catenary", foot, rng.uniform(6.5, 8), rng.uniform(0.2, 0.32), (0, 0))
    for down in (0.4, 1.4):
        street.cylinder(top - [0, 0, down], top - [side * 3.0, 0, down + 0.2], 0.03)
    street.cylinder(top - [side * 3, 20, 1], top - [side * 3, -20, 1], 0.008)
    return 1.0


def _guyed(street, rng, foot, side):
    """A mast that one to three wires hold."""
    top = street.pole("guyed", foot, rng.uniform(6, 9), rng.uniform(0.16, 0.28), (0, 0))
    for _ in range(rng.integers(1, 4)):
        turn, away = rng.uniform(0, 2 * np.pi), rng.uniform(1.6, 4)
        anchor = _up(street, foot, away * np.cos(turn), 0.0, away * np.sin(turn))
        street.cylinder(anchor, top - [0, 0, rng.uniform(0.2, 1)], rng.uniform(0.006, 0.015))
        street.columns.append((anchor + top) / 2)
    return 2.0


def _light(street, rng, foot, side):
    """A traffic light: a low one, or one with an arm over the road."""
    if rng.random() < 0.5:
        top = street.pole("light", foot, rng.uniform(3, 3.6), 0.11, (0, 0))
        street.block(top - [0.15, 0.4, 1.0], top + [0.15, -0.1, 0])
        return 0.5
    top = street.pole("light", foot, rng.uniform(5.5, 6.5), 0.2, (0, 0))
    tip = top - [side * rng.uniform(3, 4.2), 0, 0.2]
    street.cylinder(top - [0, 0, 0.2], tip, 0.05)
    street.block(tip - [0.2, 0.2, 0.9], tip + [0.2, 0.2, 0.1])
    return 0.5


def _guarded(street, rng, foot, side):
    """A young tree between three stakes or within a cage of bars."""
    fork = street.pole("guarded", foot, rng.uniform(2.2, 3), rng.uniform(0.07, 0.16), (0, 0))
    street.balls.append([*(fork + [0, 0, 0.7]), rng.uniform(0.8, 1.3), 0.9])
    n = rng.choice([3, 12])
    for turn in np.arange(n) * 2 * np.pi / n:
        foot_of = _up(street, foot, 0.35 * np.cos(turn), 0, 0.35 * np.sin(turn))
        street.cylinder(foot_of, foot_of + [0, 0, 1.2], 0.03 if n == 3 else 0.008)
    return 1.0


def _post(street, rng, foot, side):
    """A bare post."""
    street.pole("post", foot, rng.uniform(1.2, 4), rng.uniform(0.06, 0.12), (0, 0))
    return 0.5


def _gate(street, rng, foot, side):
    """Two pillars of 0.4 m x 0.4 m x 2 m, most with wings between them and walls beside."""
    gap = rng.uniform(1.2, 3.5)
    for along in (0, gap):
        at = _up(street, foot, along)
        street.block(at - [0.2, 0.2, 0.3], at + [0.2, 0.2, 2.0])
        street.pillars.append(at)
    if rng.random() < 0.6:
        rise = [0, gap, street.slope * gap]
        street.face(_up(street, foot, 0, 0.1), rise, (0, 0, 1.5))
    if rng.random() < 0.4:
        street.face(_up(street, foot, gap), (0, 3, 3 * street.slope), (0, 0, rng.uniform(0.6, 1.4)))
    return gap + 0.5


def _columns(street, rng, foot, side):
    """A facade with columns before it, that reach its cornice or the first floor."""
    n, step = rng.integers(2, 5), rng.uniform(1.5, 2.5)
    rise, away = rng.choice([2.8, 5.5]), rng.uniform(0.25, 1.0)
    long = n * step
    base = _up(street, foot, -0.5, -2.0, side * away)
    street.face(base, (0, long + 1, 0), (0, 0, 9 + street.slope * long))
    for k in range(n + 1):
        at = _up(street, foot, k * step)
        street.cylinder(at, at + [0, 0, rise + street.slope * (n - k) * step], 0.1 + 0.1 * (n % 2))
        street.columns.append(at)
    level = foot[2] + rise + street.slope * long
    ends = (foot[0] - side * 0.2, foot[1] - 0.5), (foot[0] + side * away, foot[1] + long + 0.5)
    street.block((*ends[0], level - 0.1), (*ends[1], level + 0.4))
    return long + 1


def _terrace(street, rng, foot, side):
    """A floor on posts, with rails, and a roof or none."""
    long, deep, up = rng.uniform(2.5, 4), 2.0, rng.uniform(0.4, 1.0) + street.slope * 4
    low, high = foot + [0, 0, -1], foot + [side * deep, long, up]
    street.block(low, high)
    roofed, deck = rng.random() < 0.5, foot[2] + up
    tall = 2.3 if roofed else 1.0
    for along in np.linspace(0.1, long - 0.1, rng.integers(3, 5)):
        at = np.array([foot[0] + side * 0.1, foot[1] + along, deck])
        street.cylinder(at, at + [0, 0, tall], 0.05)
        street.columns.append(at)
    for over in (0.5, 1.0):
        rail = np.array([foot[0] + side * 0.1, foot[1], deck + over])
        street.cylinder(rail, rail + [0, long, 0], 0.025)
    if roofed:
        street.block(
            (foot[0], foot[1], deck + 2.3), (foot[0] + side * deep, foot[1] + long, deck + 2.45)
        )
    street.face(foot + [side * (deep + 0.1), -1, -2], (0, long + 2, 0), (0, 0, 8))
    return long + 1


def looked_at(seed, scanner, length=45.0):
    """Points, times, lines, poles as a table (visible with 15 points), path and the street."""
    street = make(seed, length)
    points, time, line, pole, path = other_street.scan(street, scanner, seed)
    truth, _ = other_street.tables(street, pole)
    return points, time, line, truth.assign(visible=truth["points"] >= 15), path, street
