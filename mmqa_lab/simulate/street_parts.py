"""The things of a street: poles with their truth, vegetation, vehicles, people, facades.

Each function draws what varies from a random generator in a fixed order, so that two streets
that differ in one setting share everything else. Heights count from the ground under the thing.
"""

import numpy as np

from mmqa_lab.simulate.surfaces import (
    board,
    box,
    cylinder,
    disc,
    ellipsoid,
    foliage,
    group,
    rectangle,
    wall,
)

LEAF_RADIUS_M = 0.07
LEAVES_PER_M = 0.8
"""Leaves that a ray meets on a metre of its way through foliage of density 1, on average."""


def shaft(rng, at, kind, *, radius, top_radius, height, lean_deg=1.0):
    """Return the surface of a tapered shaft and its truth as a dict.

    Parameters
    ----------
    rng : Generator
    at : array, shape (3,)
        Foot, metres.
    kind : str
        Class of the pole; the label of the surface.
    radius, top_radius, height : float
        Metres.
    lean_deg : float
        Standard deviation of the lean in each of two directions.
    """
    lean = np.tan(np.radians(rng.normal(0, lean_deg, 2)))
    top = at + height * np.array([*lean, 1.0])
    surface = cylinder(at, top, radius, top_radius=top_radius, label=kind, reflectance=0.35)
    middle = at + height / 2 * np.array([*lean, 1.0])
    truth = {
        "class": kind,
        "x_m": middle[0],
        "y_m": middle[1],
        "z_base_m": at[2],
        "height_m": height,
        "clear_height_m": height,
        "lean_x": lean[0],
        "lean_y": lean[1],
        "diameter_base_m": 2 * radius,
        "diameter_top_m": 2 * top_radius,
    }
    return surface, truth


def lamp(rng, at, side):
    """A lamp post with an arm and a head over the road; ``side`` is +1 right of it, -1 left."""
    radius, end = rng.uniform(0.055, 0.1), rng.uniform(0.03, 0.045)
    height, arm = rng.uniform(4.5, 9.0), rng.uniform(0.3, 2.0)
    post, truth = shaft(rng, at, "lamp", radius=radius, top_radius=end, height=height)
    top = np.array([truth["x_m"], truth["y_m"], at[2] + height / 2])
    top = at + 2 * (top - at)
    tip = top - np.array([side * arm, 0, -0.2])
    parts = [cylinder(top, tip, 0.03), box(tip - [0, 0, 0.1], (0.6, 0.25, 0.15))]
    return [post, group(parts, label="lamp head")], truth


def sign(rng, at, side):
    """A sign: a thin post with one or two boards that face along the road."""
    radius, height = rng.choice([0.03, 0.038, 0.045]), rng.uniform(2.2, 3.4)
    post, truth = shaft(rng, at, "sign", radius=radius, top_radius=radius, height=height)
    heading = rng.choice([0.0, 180.0]) + rng.normal(0, 8)
    size, round_, second = rng.uniform(0.45, 0.8), rng.random() < 0.5, rng.random() < 0.35
    h = np.radians(heading)
    front = np.array([np.sin(h), np.cos(h), 0])
    middle = at + [0, 0, height - size / 2] + (radius + 0.02) * front
    middle[:2] += [truth["lean_x"] * height, truth["lean_y"] * height]
    plate = disc(middle, front, size / 2) if round_ else board(middle, size, size, heading=heading)
    plates = [plate]
    if second:
        plates.append(board(middle - [0, 0, size / 2 + 0.15], size, 0.25, heading=heading))
    return [post, group(plates, label="board")], truth


def tree(rng, at, plan):
    """A tree: trunk and crown, low or with branches as often as the plan says."""
    radius, taper = rng.uniform(*plan.trunk_radius_m), rng.uniform(0.6, 0.9)
    crown_radius, crown_height = rng.uniform(1.0, 2.4), rng.uniform(*plan.crown_height_m)
    base = rng.uniform(0.7, 1.5) if rng.random() < plan.low_crown_share else rng.uniform(2.0, 3.5)
    height = base + 0.5 * crown_height
    sizes = {"radius": radius, "top_radius": radius * taper, "height": height}
    trunk, truth = shaft(rng, at, "tree", **sizes, lean_deg=plan.trunk_lean_deg)
    seeds = rng.integers(2**31, size=8)
    centre = at + np.array([0, 0, base + crown_height / 2])
    radii = (crown_radius, crown_radius, crown_height / 2)
    leaves = [crown(centre, radii, plan.crown_density, seeds[0])]
    branched = rng.random() < plan.low_branch_share
    spots = rng.uniform([0.15, 0, 0.6], [0.6, 2 * np.pi, max(base, 1.6)], (5, 3))
    sizes = rng.uniform(0.15, 0.4, (5, 1)) * [1, 1, 0.6]
    if branched:
        for (r, turn, z), size, seed in zip(spots, sizes, seeds[1:6], strict=True):
            spot = at + [r * np.cos(turn), r * np.sin(turn), z]
            leaves.append(crown(spot, size, 1.5 * plan.crown_density, seed))
    return [trunk, group(leaves, label="crown")], truth | {"clear_height_m": base}


def other(rng, at, side):
    """A traffic light, utility pole, bollard, parking meter or flagpole."""
    which = rng.choice(5, p=[0.25, 0.2, 0.25, 0.15, 0.15])
    low = [(0.05, 3.0), (0.1, 6.5), (0.04, 1.1), (0.025, 1.2), (0.04, 6.0)][which]
    high = [(0.075, 3.8), (0.15, 9.0), (0.09, 1.4), (0.04, 1.5), (0.06, 8.0)][which]
    radius, height = rng.uniform(low, high)
    taper = rng.uniform(0.6, 1.0) if which in (1, 4) else 1.0
    post, truth = shaft(rng, at, "other", radius=radius, top_radius=radius * taper, height=height)
    if which == 0:
        return [post, box(at + [0, 0.15, height - 1.0], (0.25, 0.2, 0.85), label="signal")], truth
    if which == 3:
        return [post, box(at + [0, 0, height], (0.2, 0.15, 0.3), label="meter")], truth
    return [post], truth


def crown(centre, radii, density, seed, label="crown"):
    """Foliage of a density that counts leaves met along the way, not leaves."""
    volume = 4 / 3 * np.pi * np.prod(radii)
    per_m3 = density * LEAVES_PER_M * 2 / (np.pi * LEAF_RADIUS_M**2)
    n = max(int(volume * per_m3), 1)
    return foliage(centre, radii, leaves=n, leaf_radius=LEAF_RADIUS_M, seed=seed, label=label)


def shrub(rng, at):
    """A shrub around a foot: 0.3-0.7 m in radius, 0.5-1.5 m high."""
    radius, height = rng.uniform(0.3, 0.7), rng.uniform(0.5, 1.5)
    shift = np.array([*rng.normal(0, 0.15, 2), height / 2])
    density = rng.uniform(1.5, 4.0)
    radii = (radius, radius, height / 2)
    return crown(at + shift, radii, density, int(rng.integers(2**31)), "shrub")


def thicket(rng, at, plan):
    """Undergrowth around a foot, 1-2 m in radius, as high and as dense as the plan says."""
    radius, height = rng.uniform(1.0, 2.0), rng.uniform(*plan.thicket_height_m)
    shift = np.array([*rng.normal(0, 0.3, 2), 0.45 * height])
    density = rng.uniform(*plan.thicket_density)
    radii = (radius, radius, 0.55 * height)
    return crown(at + shift, radii, density, int(rng.integers(2**31)), "thicket")


def hedge(rng, at, length):
    """A dense hedge along the street from ``at``."""
    height, depth = rng.uniform(1.2, 2.4), rng.uniform(0.5, 0.9)
    seeds = rng.integers(2**31, size=max(int(length / 1.5), 1))
    parts = [
        crown(at + [0, 1.5 * k + 0.75, height / 2], (depth / 2, 1.1, height / 2), 5.0, seed)
        for k, seed in enumerate(seeds)
    ]
    return group(parts, label="hedge")


def car(rng, at):
    """A parked car, or one time in four a van."""
    van, length = rng.random() < 0.25, rng.uniform(4.0, 5.2)
    if van:
        return box(at + [0, 0, 0.25], (2.0, length + 0.8, rng.uniform(1.9, 2.5)), label="car")
    body = box(at + [0, 0, 0.3], (1.8, length, 0.6), label="car")
    cabin = box(at + [0, -0.2, 0.9], (1.6, 0.5 * length, 0.55), label="car")
    return group([body, cabin], label="car")


def pedestrian(rng, at):
    """A person: a body and a head."""
    height, width, turn = rng.uniform(1.55, 1.9), rng.uniform(0.2, 0.27), rng.random() < 0.5
    radii = (width, 0.16, 0.43 * height) if turn else (0.16, width, 0.43 * height)
    body = ellipsoid(at + [0, 0, 0.43 * height], radii)
    head = ellipsoid(at + [0, 0, height - 0.12], (0.1, 0.1, 0.13))
    return group([body, head], label="pedestrian")


def billboard(rng, at):
    """A board on the ground, square to the street or along it."""
    width, height = rng.uniform(1.2, 3.0), rng.uniform(1.8, 3.0)
    size = (width, 0.15, height) if rng.random() < 0.6 else (0.15, width, height)
    return box(at, size, label="billboard")


def building(rng, at, length, plan, side):
    """A facade along the street with windows, balconies, columns and pipes, and its two ends.

    Parameters
    ----------
    rng : Generator
    at : array, shape (3,)
        Its nearest-left corner at the ground; the facade runs along +y.
    length : float
        Metres.
    plan : mmqa_lab.simulate.streets.Plan
        Shares of balconies, columns and pipes.
    side : int
        +1 right of the street, -1 left.
    """
    floors, rise = int(rng.integers(1, 5)), 3.0
    height = floors * rise + 0.8
    pitch, reveal = rng.uniform(1.5, 3.2), rng.uniform(0.05, 0.3)
    window = pitch * rng.uniform(0.4, 0.85)
    places = np.arange(pitch / 2, length - pitch / 2, pitch)
    surfaces = []
    for floor in range(floors):
        z = at[2] + floor * rise
        openings = [(p - window / 2, 0.9, window, 1.5) for p in places]
        corner, along = _front(at, length, z, side)
        size = rise + 0.8 * (floor == floors - 1)
        kind = {"openings": openings, "reveal": reveal, "label": "facade"}
        surfaces += wall(corner, along, size, **kind)
    deep = np.array([side * 10.0, 0, 0])
    ends = [at, at + [0, length, 0]]
    surfaces += [rectangle(end, deep, (0, 0, height), label="facade") for end in ends]
    surfaces += _balconies(rng, at, places, floors, plan.balcony_share, side)
    surfaces += _uprights(rng, at, length, height, plan, side)
    return surfaces


def _front(at, length, z, side):
    """Lower corner and edge of a facade whose front looks to the street."""
    low = np.array([at[0], at[1], z])
    if side > 0:
        return low + [0, length, 0], np.array([0, -length, 0])
    return low, np.array([0, length, 0])


def _balconies(rng, at, places, floors, share, side):
    """Slab, parapet and separating walls of each balcony."""
    depth, surfaces = rng.uniform(1.1, 1.8), []
    taken = rng.random((5, 60)) < share
    separated = rng.random((5, 60)) < 0.7
    for floor in range(1, floors):
        for k, place in enumerate(places[1::2]):
            if not taken[floor, k % 60]:
                continue
            middle = at + [-side * depth / 2, place, 3.0 * floor - 0.15]
            parts = [box(middle, (depth, 2.6, 0.15), label="balcony")]
            front = at + [-side * depth, place, 3.0 * floor]
            parts.append(box(front, (0.05, 2.6, 1.0), label="balcony"))
            if separated[floor, k % 60]:
                for end in (-1.3, 1.3):
                    parts.append(box(middle + [0, end, 0.15], (depth, 0.12, 2.7), label="balcony"))
            surfaces.append(group(parts, label="balcony"))
    return surfaces


def _uprights(rng, at, length, height, plan, side):
    """Columns in front of the facade and rain pipes on it."""
    surfaces = []
    n_columns = rng.poisson(plan.columns_per_100m * length / 100)
    n_pipes = rng.poisson(plan.pipes_per_100m * length / 100)
    for y in rng.uniform(0.5, length - 0.5, n_columns):
        foot = at + [-side * rng.uniform(0.2, 1.2), y, 0]
        radius = rng.uniform(0.1, 0.2)
        surfaces.append(cylinder(foot, foot + [0, 0, 2.8], radius, label="column"))
    for y in rng.uniform(0.2, length - 0.2, n_pipes):
        foot = at + [-side * 0.09, y, 0]
        surfaces.append(cylinder(foot, foot + [0, 0, height], 0.05, label="pipe"))
    return surfaces
