"""Streets with poles whose truth is known: what stands there, how often, and what hides it.

``street`` builds a street from a ``Plan`` and a seed, ``drive`` scans it, ``visible_targets`` says
which of its poles a cloud shows. The vehicle drives along +y at x = 0. What varies is drawn from a
random generator in a fixed order, so that two streets that differ in one setting share all else.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_choice, check_positive
from mmqa_lab._data import read_toml
from mmqa_lab._streams import stream
from mmqa_lab.cloud import Cloud
from mmqa_lab.simulate import surfaces
from mmqa_lab.simulate.scan import Scanner, scan
from mmqa_lab.simulate.scenes import Scene
from mmqa_lab.simulate.systems import PRESETS
from mmqa_lab.simulate.trajectories import Trajectory, straight

__all__ = [
    "PLANS", "SCANNERS", "Plan", "Street", "crown", "drive", "pedestrian", "shaft", "street",
    "visible_targets",
]  # fmt: skip

FAR_M = 12.5
LEAF_RADIUS_M = 0.07

BUSHES = {"shrub": ((0.3, 0.5, 1.5), (0.7, 1.5, 4.0)), "thicket": ((1.0, 1.0, 10), (2.0, 5.0, 30))}
"""Least and largest radius (m), height (m) and density of what stands around feet."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """How much of what stands along a street; rates count both sides together.

    Parameters
    ----------
    trees_per_100m, signs_per_100m, lamps_per_100m, others_per_100m : float
        Poles by class.
    far_share : float
        Share of trees and others that stand 12.5 to 29 m from the vehicle, not at the road.
    shrub_share : float
        Share of poles with a shrub around the foot.
    thicket_share : float
        Share of the poles beyond 12.5 m that stand in undergrowth.
    low_crown_share : float
        Share of trees whose crown begins at 0.7-1.5 m.
    cars_per_100m, pedestrians_per_100m, hedges_per_100m : float
        Hedges are 6-18 m long.
    building_share : float
        Share of the street's sides with a building.
    setback_m : tuple of 2
        Least and largest distance of facades from the vehicle's path.
    columns_per_100m, pipes_per_100m : float
        Along a facade.
    """

    trees_per_100m: float = 10.0
    signs_per_100m: float = 6.0
    lamps_per_100m: float = 3.5
    others_per_100m: float = 6.0
    far_share: float = 0.6
    shrub_share: float = 0.35
    thicket_share: float = 0.6
    low_crown_share: float = 0.2
    cars_per_100m: float = 4.0
    pedestrians_per_100m: float = 0.6
    hedges_per_100m: float = 4.0
    building_share: float = 0.5
    setback_m: tuple = (12.0, 26.0)
    columns_per_100m: float = 1.0
    pipes_per_100m: float = 3.0


_STREETS = read_toml(Path(__file__).with_suffix(".toml"))

PLANS = {name: Plan(**rates) for name, rates in _STREETS["plans"].items()}
"""Streets by name. ``table-4-1`` was chosen so that its rates come near those of that table."""

SCANNERS = {
    name: replace(PRESETS[entry["like"]], lever_arm_m=entry["lever_arm_m"])
    for name, entry in _STREETS["scanners"].items()
}
"""Scanners on a mast: the EuroSDR set-up, two modern ones and an old side-looking one."""


@dataclass(frozen=True, eq=False)
class Street:
    """A scene with poles.

    Parameters
    ----------
    scene : Scene
    targets : DataFrame
        One row a pole: ``class`` (tree, sign, lamp, other), the axis at half height ``x_m``,
        ``y_m``, its lean ``lean_x``, ``lean_y`` (m/m), ``z_base_m``, ``height_m``,
        ``clear_height_m`` (of a tree up to its crown, else the same), ``diameter_base_m``,
        ``diameter_top_m``, ``surface`` (id of the shaft in the scene).
    length_m : float
    """

    scene: Scene
    targets: pd.DataFrame
    length_m: float

    @property
    def labels(self) -> np.ndarray:
        """Label of every surface of the scene, array of str."""
        return np.array([surface.label for surface in self.scene.surfaces])

    def trajectory(self, speed: float = 30 / 3.6) -> Trajectory:
        """Return the drive through the whole street at a speed in m/s."""
        return straight(self.length_m, speed)


def street(plan: Plan | str, *, length: float, seed: int) -> Street:
    """Return a street built at random.

    Parameters
    ----------
    plan : Plan or str
        A plan, or the name of one in ``PLANS``.
    length : float
        Metres.
    seed : int
        Each kind of thing has its own random stream: changing one rate leaves the rest as it is.

    Examples
    --------
    >>> made = street("quiet", length=120, seed=1)
    >>> sorted(made.targets["class"].unique())
    ['lamp', 'other', 'sign', 'tree']
    """
    if isinstance(plan, str):
        plan = PLANS[check_choice(plan, "plan", tuple(PLANS))]
    length = check_positive(length, "length", unit="m")
    blocks = _buildings(plan, length, seed)
    things, rows = [surfaces.ground(centre=(0, length / 2), size=(160, length + 120))], []
    for parts, truth in _poles(plan, length, seed, blocks):
        rows.append(truth | {"surface": len(things)})
        things += parts
    things += _clutter(plan, length, seed)
    for number, (side, setback, start, size) in enumerate(blocks):
        rng = stream(seed, f"building {number}")
        things += _building(rng, side, setback, start, size, plan)
    return Street(Scene(things), pd.DataFrame(rows), length)


def drive(
    made: Street, scanner: Scanner | str, *, seed: int, speed: float = 30 / 3.6, **options: Any
) -> Cloud:
    """Return the cloud of one drive through a street.

    Parameters
    ----------
    made : Street
    scanner : Scanner or str
        A scanner, or the name of one in ``SCANNERS``.
    seed : int
    speed : float
        Metres per second.
    **options
        Handed to :func:`mmqa_lab.simulate.scan`.

    Returns
    -------
    Cloud
        As ``scan`` makes it: ``scan_line``, ``pulse``, ``gps_time``, ``surface``, ...
    """
    if isinstance(scanner, str):
        scanner = SCANNERS[check_choice(scanner, "scanner", tuple(SCANNERS))]
    return scan(made.scene, scanner, made.trajectory(speed), seed=seed, **options)


def visible_targets(made: Street, cloud: Cloud, *, minimum_sweeps: int = 5) -> pd.DataFrame:
    """Return the targets with what a cloud shows of them.

    A visible pole has ten points or more on its shaft, from so many scan lines or more, over a
    height of 1 m or more (2nd to 98th percentile). Trunks count up to the crown only: the part
    within the crown is not pole-like.

    Parameters
    ----------
    made : Street
    cloud : Cloud
        With ``surface`` and ``scan_line``.
    minimum_sweeps : int
        Fewest scan lines of a visible pole.

    Returns
    -------
    DataFrame
        The targets with ``points``, ``sweeps``, ``span_m``, ``visible``, and ``distance_m`` from
        the vehicle's path.
    """
    told = {"surface": cloud["surface"], "line": cloud["scan_line"], "z": cloud.points[:, 2]}
    points = pd.DataFrame(told)
    points = points[points["surface"].isin(made.targets["surface"])]
    top = made.targets.set_index("surface")[["z_base_m", "clear_height_m"]].sum(axis=1)
    grouped = points[points["z"] <= points["surface"].map(top)].groupby("surface")
    span = grouped["z"].quantile(0.98) - grouped["z"].quantile(0.02)
    seen = {"points": grouped.size(), "sweeps": grouped["line"].nunique(), "span_m": span}
    targets = made.targets.join(pd.DataFrame(seen), on="surface").fillna(dict.fromkeys(seen, 0))
    targets["visible"] = (targets[list(seen)] >= [10, minimum_sweeps, 1.0]).all(axis=1)
    return targets.assign(distance_m=targets["x_m"].abs())


def _buildings(plan, length, seed):
    """Side, setback, start and length of each building."""
    found = []
    for side in (-1, 1):
        rng = stream(seed, f"buildings {side}")
        start = -20.0
        while start < length + 20:
            size, gap = rng.uniform(10, 26), rng.uniform(2, 10)
            setback, built = rng.uniform(*plan.setback_m), rng.random() < plan.building_share
            if built:
                found.append((side, setback, start, size))
            start += size + gap
    return found


def _poles(plan, length, seed, blocks):
    """Surfaces, the shaft first, and truth of poles outside buildings and 1 m from each other."""
    taken = np.empty((0, 2))
    dressing = stream(seed, "dressing")
    for kind, make in {"lamp": _lamp, "sign": _sign, "other": _other, "tree": _tree}.items():
        rng = stream(seed, kind)
        for _ in range(rng.poisson(getattr(plan, f"{kind}s_per_100m") * length / 100)):
            own = np.random.default_rng(rng.integers(2**63))
            side = int(rng.choice([-1, 1]))
            shrubby, hidden = dressing.random(2) < (plan.shrub_share, plan.thicket_share)
            at = _foot(own, kind, side, length, plan)
            crowded = (np.hypot(*(taken - at[:2]).T) < 1.0).any()
            if crowded or any(_inside(at, block) for block in blocks):
                continue
            taken = np.vstack([taken, at[:2]])
            parts, truth = make(own, at, side, plan)
            if shrubby:
                parts.append(_bush(own, at, "shrub"))
            if hidden and abs(at[0]) >= FAR_M:
                parts.append(_bush(own, at, "thicket"))
            yield parts, truth


def _foot(rng, kind, side, length, plan):
    """Foot of a pole: at the road, or among the yards."""
    near, far = rng.uniform(4.0, 12.0), rng.uniform(FAR_M, 29.0)
    beside, back = rng.uniform(4.0, 7.0), rng.random()
    if kind in ("lamp", "sign"):
        across = beside if back > 0.3 * plan.far_share else far
    else:
        across = far if back < plan.far_share else near
    return np.array([side * across, rng.uniform(0.0, length), 0.0])


def _inside(at, block):
    """Whether a foot stands within a building or less than 0.8 m from it."""
    side, setback, start, size = block
    return side * at[0] > setback - 0.8 and start - 0.8 < at[1] < start + size + 0.8


def shaft(
    rng: np.random.Generator,
    at: np.ndarray,
    kind: str,
    radius: float,
    top_radius: float,
    height: float,
    lean_deg: float = 1.0,
) -> tuple[surfaces.Surface, dict]:
    """Surface of a tapered shaft that leans at random, and its truth; sizes in metres."""
    lean = np.tan(np.radians(rng.normal(0, lean_deg, 2)))
    way = height * np.array([*lean, 1.0])
    surface = surfaces.cylinder(
        at, at + way, radius, top_radius=top_radius, label=kind, reflectance=0.35
    )
    x, y = at[:2] + height / 2 * lean
    truth = {"class": kind, "x_m": x, "y_m": y, "z_base_m": at[2]}
    truth |= {"height_m": height, "clear_height_m": height, "lean_x": lean[0], "lean_y": lean[1]}
    return surface, truth | {"diameter_base_m": 2 * radius, "diameter_top_m": 2 * top_radius}


def _lamp(rng, at, side, _):
    """A lamp post with an arm and a head over the road; ``side`` is +1 right of it, -1 left."""
    radius, end = rng.uniform(0.055, 0.1), rng.uniform(0.03, 0.045)
    height, arm = rng.uniform(4.5, 9.0), rng.uniform(0.3, 2.0)
    post, truth = shaft(rng, at, "lamp", radius, end, height)
    middle = np.array([truth["x_m"], truth["y_m"], at[2] + height / 2])
    top = at + 2 * (middle - at)
    tip = top - np.array([side * arm, 0, -0.2])
    parts = [surfaces.cylinder(top, tip, 0.03), surfaces.box(tip - [0, 0, 0.1], (0.6, 0.25, 0.15))]
    return [post, surfaces.group(parts, label="lamp head")], truth


def _sign(rng, at, *_):
    """A sign: a thin post with one or two boards that face along the road."""
    radius, height = rng.choice([0.03, 0.038, 0.045]), rng.uniform(2.2, 3.4)
    post, truth = shaft(rng, at, "sign", radius, radius, height)
    heading = rng.choice([0.0, 180.0]) + rng.normal(0, 8)
    size, round_, second = rng.uniform(0.45, 0.8), rng.random() < 0.5, rng.random() < 0.35
    h = np.radians(heading)
    front = np.array([np.sin(h), np.cos(h), 0])
    middle = at + [0, 0, height - size / 2] + (radius + 0.02) * front
    middle[:2] += [truth["lean_x"] * height, truth["lean_y"] * height]
    if round_:
        plates = [surfaces.disc(middle, front, size / 2)]
    else:
        plates = [surfaces.board(middle, size, size, heading=heading)]
    if second:
        below = middle - [0, 0, size / 2 + 0.15]
        plates.append(surfaces.board(below, size, 0.25, heading=heading))
    return [post, surfaces.group(plates, label="board")], truth


def _tree(rng, at, _, plan):
    """A tree: trunk and crown, which is low as often as the plan says."""
    radius, taper = rng.uniform(0.06, 0.2), rng.uniform(0.6, 0.9)
    crown_radius, crown_height = rng.uniform(1.0, 2.4), rng.uniform(2.5, 5.0)
    base = rng.uniform(0.7, 1.5) if rng.random() < plan.low_crown_share else rng.uniform(2.0, 3.5)
    height = base + 0.5 * crown_height
    trunk, truth = shaft(rng, at, "tree", radius, radius * taper, height, lean_deg=2.5)
    radii = (crown_radius, crown_radius, crown_height / 2)
    leaves = crown(at + [0, 0, base + crown_height / 2], radii, 1.0, rng.integers(2**31))
    return [trunk, leaves], truth | {"clear_height_m": base}


def _other(rng, at, *_):
    """A utility pole or the post of a traffic light; four times in ten a bollard or a meter."""
    if rng.random() < 0.6:
        radius, height, taper = rng.uniform([0.05, 3.0, 0.6], [0.15, 9.0, 1.0])
    else:
        radius, height, taper = np.append(rng.uniform([0.025, 1.1], [0.09, 1.5]), 1.0)
    post, truth = shaft(rng, at, "other", radius, radius * taper, height)
    return [post], truth


def crown(
    centre: ArrayLike, radii: ArrayLike, density: float, seed: int, label: str = "crown"
) -> surfaces.Surface:
    """Foliage in which a ray meets 0.8 leaves on a metre of its way, times the density."""
    volume = 4 / 3 * np.pi * np.prod(np.asarray(radii))
    n = max(int(volume * density * 0.8 * 2 / (np.pi * LEAF_RADIUS_M**2)), 1)
    return surfaces.foliage(
        centre, radii, leaves=n, leaf_radius=LEAF_RADIUS_M, seed=seed, label=label
    )


def _bush(rng, at, kind):
    """A shrub or undergrowth around a foot."""
    radius, height, density = rng.uniform(*BUSHES[kind])
    middle = at + [*rng.normal(0, 0.2, 2), height / 2]
    return crown(middle, (radius, radius, height / 2), density, rng.integers(2**31), kind)


def _clutter(plan, length, seed):
    """Cars, people and hedges, at distances from the path in metres."""
    kinds = {"car": (_car, 2.6, 3.2), "pedestrian": (pedestrian, 4, 9), "hedge": (_hedge, 7.5, 13)}
    for kind, (make, low, high) in kinds.items():
        rng = stream(seed, kind)
        for _ in range(rng.poisson(getattr(plan, f"{kind}s_per_100m") * length / 100)):
            own = np.random.default_rng(rng.integers(2**63))
            x, y = own.choice([-1, 1]) * own.uniform(low, high), own.uniform(0, length)
            yield make(own, np.array([x, y, 0.0]))


def _hedge(rng, at):
    """A dense hedge along the street, 6-18 m long."""
    length, height, depth = rng.uniform([6, 1.2, 0.5], [18, 2.4, 0.9])
    middles = at + [[0, y, height / 2] for y in np.arange(0.75, length - 0.75, 1.5)]
    radii = (depth / 2, 1.1, height / 2)
    parts = [crown(middle, radii, 5.0, rng.integers(2**31)) for middle in middles]
    return surfaces.group(parts, label="hedge")


def _car(rng, at):
    """A parked car, or one time in four a van."""
    van, length = rng.random() < 0.25, rng.uniform(4.0, 5.2)
    if van:
        return surfaces.box(
            at + [0, 0, 0.25], (2.0, length + 0.8, rng.uniform(1.9, 2.5)), label="car"
        )
    body = surfaces.box(at + [0, 0, 0.3], (1.8, length, 0.6))
    cabin = surfaces.box(at + [0, -0.2, 0.9], (1.6, 0.5 * length, 0.55))
    return surfaces.group([body, cabin], label="car")


def pedestrian(rng: np.random.Generator, at: np.ndarray) -> surfaces.Surface:
    """A person: a body that widens upwards, and a head."""
    height, width = rng.uniform([1.55, 0.18], [1.9, 0.25])
    neck, top = at + [0, 0, height - 0.28], at + [0, 0, height]
    body = surfaces.cylinder(at, neck, 0.7 * width, top_radius=width)
    return surfaces.group([body, surfaces.cylinder(neck, top, 0.1)], label="pedestrian")


def _building(rng, side, setback, start, length, plan):
    """A facade along the street with bay windows, columns and pipes, and both ends of its house."""
    at = np.array([side * setback, start, -0.2])
    floors, rise = int(rng.integers(1, 5)), 3.0
    height = floors * rise + 0.8
    pitch, reveal = rng.uniform(1.5, 3.2), rng.uniform(0.05, 0.3)
    window = pitch * rng.uniform(0.4, 0.85)
    places = np.arange(pitch / 2, length - pitch / 2, pitch)
    openings = [(place - window / 2, 0.9, window, 1.5) for place in places]
    # seen from the street a wall runs to the right, so its panes stand out by the reveal, as bays
    first, along = (length, -length) if side > 0 else (0, length)
    made = []
    for floor in range(floors):
        low, size = at + [0, first, floor * rise], rise + 0.8 * (floor == floors - 1)
        look = {"openings": openings, "reveal": reveal, "label": "facade"}
        made += surfaces.wall(low, (0, along, 0), size, **look)
    for end in (at, at + [0, length, 0]):
        made.append(surfaces.rectangle(end, (side * 10, 0, 0), (0, 0, height), label="facade"))
    for y in rng.uniform(0.5, length - 0.5, rng.poisson(plan.columns_per_100m * length / 100)):
        foot, radius = at + [-side * rng.uniform(0.2, 1.2), y, 0], rng.uniform(0.1, 0.2)
        made.append(surfaces.cylinder(foot, foot + [0, 0, 2.8], radius, label="column"))
    for y in rng.uniform(0.2, length - 0.2, rng.poisson(plan.pipes_per_100m * length / 100)):
        foot = at + [-side * 0.09, y, 0]
        made.append(surfaces.cylinder(foot, foot + [0, 0, height], 0.05, label="pipe"))
    return made
