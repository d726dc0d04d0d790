"""Training of the learned pole detector, on simulated streets alone.

``python tests/poles_training.py`` grows the trees again and writes ``trees.csv`` in
``mmqa_lab/poles``, with the same bytes each time. More than half of the examples are yards, some on
a slope, of posts, boards, trees with low crowns, and of objects that look like posts: pillars,
fences, wires, scaffolding. The others are crowded streets. Some views are sparse and rough. Every
third is cut off above a height.
"""

from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd

from mmqa_lab.poles import learned
from mmqa_lab.poles.learned import FILE
from mmqa_lab.simulate import PRESETS, Scene, streets, surfaces
from mmqa_lab.simulate.surfaces import box, cylinder, rectangle

__all__ = ["calibrated", "example", "lessons", "yard"]

EXAMPLES = (*range(105), *range(105, 216, 3), *range(252, 324, 3))
"""Numbers of the examples: 70 streets, and 96 yards, whose numbers are multiples of 3."""

FRONTS = 252
"""From this number on a yard has walls, posts before them, and columns as high as two floors."""

FIRST_SEED, SHARES, POLES = 9_500_000, (0.8, 1.0, 1.0), (2.5, 7.5, 7.5)
"""Seeds of tests and studies are smaller. Weights of a yard and of the two streets after it, and of
their poles beside other candidates; both are 1 in yards of fronts."""

BEAMS = {"elevations_deg": tuple(np.linspace(-25, 15, 64)), "pulse_rate_hz": 640_000}
HEADS = {
    "64 beams": [replace(PRESETS["hdl-32e"], **BEAMS)],
    "crossed": [
        replace(PRESETS["lynx-m1"], pulse_rate_hz=75_000, heading_deg=h) for h in (45, -45)
    ],
}
DRIVES = (("roamer", 50), ("push-broom", 60), ("crossed", 40), ("hdl-32e", 24), ("64 beams", 16))
"""Scanner and length of the street (m), in rotation."""


def yard(rng, length, fronts=False):
    """Return a level street of posts, of trees and people, and of what only looks like posts."""
    things, rows = [surfaces.ground(size=(400.0, 400.0))], []
    if fronts:
        high = partial(_porch, least=0.55, most=1.6, tallest=6.5)
        kinds = (*[_walled] * 4, *[_post] * 3, high, high, high, high, _guyed, _front, _person)
    else:
        kinds = (*[_post] * 6, *[_board] * 3, _tree, _tree, _person, _gate, _gate, _fence, _porch)
        kinds += (_porch, _guyed, _scaffold, _shelter, _front, _front, _terrace)
    for side in (-1.0, 1.0):
        out, y = side * np.array([1.0, 0, 0]), 0.0
        while y < length:
            y += rng.uniform(0.8, 2.0)
            make = kinds[rng.integers(len(kinds))] if rows else _tree
            parts, truths, wide = make(rng, rng.uniform(3.5, 14) * out + [0, y, 0], out)
            rows += [truth | {"surface": len(things) + k} for k, truth in enumerate(truths)]
            things += parts
            y += rng.uniform(0.5, 1) * wide
    return streets.Street(Scene(things), pd.DataFrame(rows), length)


# What stands there: surfaces, the shafts of poles first, their truths, and how long it is, m.
# ``at`` is its foot, ``out`` the direction away from the road.

ALONG, UP = np.array([0.0, 1, 0]), np.array([0.0, 0, 1])


def _post(rng, at, out):
    """A post with perhaps something beside it or on it: a pole if it is slender enough."""
    draw = rng.uniform
    height, radius = np.exp(draw(*np.log([[1.1, 0.02], [12, 0.5]])))
    lean, taper = rng.choice([0, 1, 5]), rng.choice([1, draw(0.4, 1)])
    post, truth = streets.shaft(rng, at, "other", radius, taper * radius, height, lean)
    if lean == 0 and rng.random() < 0.3:
        post = box(at, (1.8 * radius, 1.8 * radius, height), heading=draw(0, 90))
    foot, size = at + (radius + draw(0.35, 1.5)) * out, draw([0.7] * 3, [3, 3, 1.5])
    side = draw(1, 3) * ALONG
    wall = rectangle(foot - side, 2 * side, (0, 0, height + draw(-0.5, 3)))
    crown = streets.crown(at + [0, 0, height], size, 1.0, rng.integers(2**31))
    arm = at + height * UP - draw(1, 6) * out
    mast = cylinder(at + height * UP, arm, 0.04), box(arm - [0, 0, 0.5], (0.3, 0.3, 0.9))
    thick, tall = min(radius * draw(2, 8), 0.6), draw(0.15, 0.6)
    head = box(at + (height - draw(0, tall)) * UP, (thick, thick, tall), heading=draw(0, 90))
    flag = rectangle(at + height * UP, draw([-1, -1, -0.3], [1, 1, 0]), -draw(0.5, 3) * UP)
    beside = [[wall], [crown], mast, [head], [flag], []][rng.integers(6)]
    slender = height >= learned.SLENDER * 2 * radius
    return [post, *(beside if rng.random() < 0.7 else [])], [truth] if slender else [], 0.5


def _walled(rng, at, out):
    """One to four posts before a wall that is lower or higher than they are."""
    n, (step, over, tall) = rng.integers(1, 5), rng.uniform([0.8, 0.3, 1.5], [3, 3, 6.5])
    made, back = [], at + rng.uniform(0.3, 1.1) * out
    for k in range(n):
        height, radius = np.exp(rng.uniform(*np.log([[1.2, 0.02], [7, 0.17]])))
        height = max(height, learned.SLENDER * 2 * radius)
        made.append(streets.shaft(rng, at + k * step * ALONG, "other", radius, radius, height))
    wall = rectangle(back - over * ALONG, ((n - 1) * step + 2 * over) * ALONG, tall * UP)
    posts, truths = zip(*made, strict=True)
    return [*posts, wall], truths, (n - 1) * step + over


def _board(rng, at, out):
    """A board on one to three thin posts, beside the road or across it."""
    n, (step, low, tall) = rng.integers(1, 4), rng.uniform([0.5, 0.4, 0.3], [1.6, 2.5, 1.8])
    way, face = [(ALONG, -out), (out, ALONG)][rng.integers(2)]
    radius, made = rng.uniform(0.025, 0.09), []
    for k in range(n):
        foot, rise = at + k * step * way, low + tall * rng.uniform(0.6, 1.1)
        made.append(streets.shaft(rng, foot, "other", radius, radius, max(rise, 1.2)))
    over = rng.uniform(0.1, 0.6)
    corner = at - over * way + (radius + 0.02) * rng.choice([-1, 1]) * face + low * UP
    board = rectangle(corner, ((n - 1) * step + 2 * over) * way, tall * UP)
    posts, truths = zip(*made, strict=True)
    return [*posts, board], truths, n * step


def _tree(rng, at, _):
    """A tree, one time in three between stakes."""
    radius, base, size = rng.uniform([0.06, 1.2, 0.8], [0.25, 4.0, 3.5])
    trunk, truth = streets.shaft(rng, at, "tree", radius, radius, base + 0.5, 3)
    top = at + [0, 0, base + 0.7 * size]
    size, density = [size, size, 0.7 * size], rng.uniform(0.3, 1.5)
    parts = [trunk, streets.crown(top, size, density, rng.integers(2**31))]
    if rng.random() < 0.33:
        away, rise = radius + rng.uniform(0.1, 0.3), rng.uniform(0.8, 1.8)
        for turn in np.arange(rng.integers(2, 5)) * np.pi / 2:
            foot = at + away * np.array([np.cos(turn), np.sin(turn), 0])
            parts.append(cylinder(foot, foot + rise * UP, 0.03))
    return parts, [truth | {"clear_height_m": base}], 1.0


def _person(rng, at, out):
    """One to three people, some with a bicycle."""
    parts = []
    for k in range(rng.integers(1, 4)):
        foot = at + 0.7 * k * ALONG + rng.uniform(-0.3, 0.3) * out
        parts.append(streets.pedestrian(rng, foot))
        if rng.random() < 0.4:
            wheels = [foot + 0.4 * out + [0, y, 0.34] for y in (-0.5, 0.5)]
            parts += [surfaces.disc(wheel, out, 0.33) for wheel in wheels]
            parts.append(cylinder(*(wheel + [0, 0, 0.4] for wheel in wheels), 0.03))
    return parts, [], 1.0


def _gate(rng, at, _):
    """Pillars at most five times as high as wide, of any section, with a gate and a low wall."""
    draw, wide = rng.uniform, rng.uniform(0.25, 0.7)
    height, round_, cap = draw(0.9, min(5 * wide, 3)), rng.random() < 0.25, draw(0, 0.1)
    parts, gap, turn = [], draw(1, 4), rng.choice([0, draw(0, 90)])
    for foot in (at, at + gap * ALONG):
        if round_:
            parts.append(cylinder(foot, foot + height * UP, wide / 2))
        else:
            parts.append(box(foot, (wide, wide, height), heading=turn))
        parts.append(box(foot + height * UP, (wide + cap, wide + cap, 0.08), heading=turn))
    leaf, low = draw(0.5, 0.95) * height * UP, draw(0.3, 0.9) * height * UP
    sides = [rectangle(at + 0.1 * UP, gap * ALONG, leaf)]
    sides += [rectangle(at, -draw(1, 4) * ALONG, low), rectangle(at + gap * ALONG, 3 * ALONG, low)]
    parts += [side for side in sides if rng.random() < 0.5]
    return parts, [], gap + 1


def _fence(rng, at, _):
    """Posts with rails or with panels between them."""
    height, radius, step = rng.uniform([0.9, 0.03, 1.2], [2.0, 0.08, 2.6])
    n, panels, parts = rng.integers(2, 5), rng.random() < 0.4, []
    for k in range(n + 1):
        foot = at + k * step * ALONG
        parts.append(cylinder(foot, foot + height * UP, radius))
    for share in (0.3, 0.6, 0.95):
        low = at + share * height * UP
        parts.append(cylinder(low, low + n * step * ALONG, 0.03))
    if panels:
        parts.append(rectangle(at + 0.1 * UP, n * step * ALONG, 0.9 * height * UP))
    return parts, [], n * step


def _porch(rng, at, out, least=1.0, most=2.5, tallest=3.5):
    """Columns that carry a roof before a wall: its depth from and to, and the highest, m."""
    draw, half = rng.uniform, rng.uniform(1, 3) * ALONG
    deep, thick, rise, inset = draw([least, 0.15, 2.2, 0.1], [most, 1.2, tallest, 0.4])
    parts = []
    for foot in at + np.outer(np.linspace(-0.9, 0.9, rng.integers(2, 5)), half):
        parts.append(cylinder(foot, foot + rise * UP, draw(0.07, 0.25)))
    roof, wall = at + (deep / 2 - inset) * out, at + (deep - inset) * out - 2 * half
    parts.append(box(roof + rise * UP, (deep, 2 * half[1], thick)))
    parts.append(rectangle(wall, 4 * half, (draw(3, 7) + tallest - 3.5) * UP))
    return parts, [], half[1]


def _guyed(rng, at, _):
    """A mast with guy wires and wires overhead."""
    height, radius = rng.uniform([4, 0.06], [10, 0.17])
    post, truth = streets.shaft(rng, at, "other", radius, radius * rng.uniform(0.6, 1), height)
    top, wires = at + rng.uniform(0.6, 0.95) * height * UP, []
    for _ in range(rng.integers(1, 4)):
        turn, away = rng.uniform([0, 1.2], [2 * np.pi, 5])
        anchor = at + away * np.array([np.cos(turn), np.sin(turn), 0])
        wires.append(cylinder(anchor, top, rng.uniform(0.005, 0.03)))
    if rng.random() < 0.5:
        wires.append(cylinder(top - 20 * ALONG, top + 20 * ALONG, 0.012))
    return [post, *wires], [truth], 1.5


def _scaffold(rng, at, out):
    """Tubes and boards on two or three floors before a wall."""
    n, floors, bay, deep = rng.integers(2, 4), rng.integers(2, 4), rng.uniform(1.5, 2.6), 0.8
    parts = [rectangle(at + (deep + 0.3) * out, n * bay * ALONG, 3 * floors * UP)]
    for foot in (at + k * bay * ALONG + d * out for k in range(n + 1) for d in (0, deep)):
        parts.append(cylinder(foot, foot + (2 * floors + 1) * UP, 0.025))
    for level in np.outer(np.arange(1, floors + 1), 2 * UP):
        for up in (0, 1):
            low = at + level + up * UP
            parts.append(cylinder(low, low + n * bay * ALONG, 0.025))
        parts.append(rectangle(at + level, n * bay * ALONG, deep * out))
    return parts, [], n * bay


def _shelter(rng, at, out):
    """A roof on two to four posts, with or without a pane behind."""
    long, deep, rise, radius = rng.uniform([2, 1.0, 2.1, 0.03], [4.5, 2.0, 2.8, 0.07])
    feet = [at + d * deep * out + y * long * ALONG for d in (0, 1) for y in (0.05, 0.95)]
    parts = [cylinder(foot, foot + rise * UP, radius) for foot in feet[2 * rng.integers(2) :]]
    middle = at + deep / 2 * out + [0, long / 2, rise]
    parts.append(box(middle, (deep + 0.3, long + 0.4, 0.1)))
    if rng.random() < 0.6:
        parts.append(rectangle(at + deep * out + 0.2 * UP, long * ALONG, 1.8 * UP))
    return parts, [], long


def _front(rng, at, out):
    """A facade of piers or pilasters, with balconies whose rails are bars."""
    draw, bays = rng.uniform, rng.integers(2, 5)
    pitch, pier, depth, floors = (
        draw(1.2, 3.2),
        draw(0.2, 0.7),
        draw(0.05, 0.35),
        rng.integers(1, 4),
    )
    parts, height, deep = [], 3 * floors + draw(0, 1), draw(0.8, 1.5)
    for k in range(bays + 1):
        foot = at + k * pitch * ALONG
        parts.append(box(foot, (2 * depth, pier, height)))
    back = at + rng.choice([0, 0.1, 4]) * out
    parts.append(rectangle(back, bays * pitch * ALONG, height * UP))
    for floor in range(1, floors + 1):  # the lintels, and balconies on some
        low = at + 3 * floor * UP
        parts.append(rectangle(low - 0.6 * UP, bays * pitch * ALONG, 0.6 * UP))
        if rng.random() < 0.6:
            parts.append(box(low - deep / 2 * out + [0, pitch, 0], (deep, 2 * pitch, 0.15)))
            rail = low - deep * out + 0.15 * UP
            for y in np.arange(0, 2 * pitch, draw(0.12, 0.9)):
                parts.append(cylinder(rail + y * ALONG, rail + y * ALONG + UP, 0.015))
            parts.append(cylinder(rail + UP, rail + UP + 2 * pitch * ALONG, 0.025))
            if rng.random() < 0.5:  # dividing walls
                parts.append(rectangle(low, -deep * out, 2.4 * UP))
    return parts, [], bays * pitch


def _terrace(rng, at, out):
    """A raised floor with steps before it, rails on it, and posts with a beam or none."""
    long, deep, rise, step = rng.uniform([2, 1.5, 0.3, 0.6], [5, 3, 1.4, 2])
    parts = [box(at + deep / 2 * out + [0, long / 2, 0], (deep, long, rise))]
    for k in (1, 2):
        parts.append(box(at - 0.3 * k * out + [0, 0.7, 0], (0.3, 1.2, rise * (1 - k / 3))))
    edge, tall = at + rise * UP + 0.06 * out, rng.choice([0.95, rng.uniform(1.1, 2.6)])
    for y in np.arange(0.05, long, step):
        parts.append(cylinder(edge + y * ALONG, edge + [0, y, tall], rng.uniform(0.02, 0.07)))
    parts.append(cylinder(edge + tall * UP, edge + [0, long, tall], 0.04))
    if rng.random() < 0.5:
        parts.append(cylinder(edge + 0.5 * UP, edge + [0, long, 0.5], 0.025))
    return parts, [], long


def example(number):
    """Yield three views of an example, each with points (n, 3, metres) and targets."""
    rng, seed = np.random.default_rng([77, number]), FIRST_SEED + number
    name, length = DRIVES[number // 3 % len(DRIVES)]
    crowd = {"cars_per_100m": rng.uniform(0, 50), "pedestrians_per_100m": rng.uniform(0, 50)}
    plan = replace(streets.PLANS[rng.choice(list(streets.PLANS))], **crowd)
    if number % 3:
        made = streets.street(plan, length=length, seed=seed)
    else:
        made = yard(rng, length, fronts=number >= FRONTS)
    place = {"lever_arm_m": (0.0, 0.0, 2.2), "max_range_m": rng.uniform(30, 80)}
    heads = [replace(head, **place) for head in HEADS.get(name) or [PRESETS[name]]]
    cloud = streets.drive(made, heads, seed=seed, speed=rng.uniform(4, 13))
    slope = np.random.default_rng([78, number]).choice([0, 0, 0.04, 0.1, 0.2]) * (number % 3 == 0)
    for highest in (99.0, 99.0, rng.uniform(2, 5)):
        view = cloud[rng.random(len(cloud)) < np.exp(rng.uniform(np.log(0.05), 0))]
        view = view[view.points[:, 2] < highest]
        noise = rng.choice([0, 0.01, 0.03, 0.05]) * rng.standard_normal((len(view), 3))
        view = replace(view, points=np.round(view.points + noise, rng.choice([2, 4])))
        truth = streets.visible_targets(made, view, minimum_sweeps=2)
        climb = view.points + slope * view.points[:, 1:2] * UP
        yield climb, truth.assign(z_base_m=truth["z_base_m"] + slope * truth["y_m"])


def lessons(numbers):
    """Return the training data of examples: measures, labels and weights."""
    parts = []
    for k in numbers:
        weight, poles = (1.0, 1.0) if k >= FRONTS else (SHARES[k % 3], POLES[k % 3])
        parts += [learned.lessons(*view, weight=weight, poles=poles) for view in example(k)]
    return [pd.concat(column) for column in zip(*parts, strict=True)]


CALIBRATION, STEP = (-1.06, 1.47, -0.54), 0.25
"""Log odds at 3 units of ``points``, their factor, and what each unit adds: a logistic regression
on 32 streets of two generators of the tests (``other_street``, ``built_street``), whole and thinned
to 0.3 and 0.1. ``tests/benchmarks/poles.py`` fits it again."""


def calibrated(trees):
    """Return trees whose score is the share of poles among finds on streets of other generators.

    The log odds of ``Trees`` are scaled. Trees of two leaves follow: a step each quarter of a unit
    of ``points``, since look-alikes are commoner among the finds in dense clouds.
    """
    middle, factor, unit = CALIBRATION
    limits = np.arange(1.0, 6.0, STEP)
    first = (middle - unit * (3 - limits[0] + STEP / 2)) / len(limits)
    root, leaf = len(trees.left) + 3 * np.arange(len(limits)), np.full(len(limits), -1)
    parts = np.full(3 * len(limits), list(learned.MEASURES).index("points")), np.repeat(limits, 3)
    nodes = (np.column_stack([root + side, leaf, leaf]).ravel() for side in (1, 2))
    steps = *parts, *nodes, np.tile([first, first, first + unit * STEP], len(limits))
    scaled = trees._replace(value=factor * trees.value)
    return learned.Trees(*map(np.concatenate, zip(scaled, steps, strict=True)))


if __name__ == "__main__":
    learned.write(FILE, calibrated(learned.grow(*lessons(EXAMPLES))))
