"""Training of the learned pole detector, on simulated streets alone.

``python -m mmqa_lab.studies.poles_training`` grows the trees again and writes ``trees.csv`` in
``mmqa_lab/poles``, with the same bytes each time. Every second example is a yard of bare posts and
of objects that look like posts. Each cloud is used whole, cut off above a height, and thinned.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from tqdm.auto import tqdm

from mmqa_lab.poles import learned
from mmqa_lab.simulate import streets, surfaces
from mmqa_lab.simulate.scenes import Scene
from mmqa_lab.simulate.systems import PRESETS

EXAMPLES, FIRST_SEED = 112, 9_500_000
"""Seeds of tests and studies are smaller."""

DRIVES = (("roamer", 50), ("push-broom", 60), ("hdl-32e", 24), ("push-broom", 60), ("vq-450", 24))
DRIVES += (("roamer", 50), ("push-broom", 60), ("dense-profiler", 20))
"""Scanner and length of the street (m), in rotation."""

WEIGHTS = (1.0, 0.5, 0.5)
"""Weights of the whole, cut and thinned cloud."""


def yard(rng, length):
    """Return a level street with posts, porches, people in coats, strips of walls and bushes."""
    things, rows = [surfaces.ground(size=(400.0, 400.0))], []
    for y in np.cumsum(rng.uniform(1.2, 2.2, int(length / 1.7))):
        side, draw = rng.choice([-1, 1]), rng.uniform
        at = np.array([side * draw(3.5, 14), y, 0.0])
        kind = rng.choice(["post", "post", "post", "porch", "coat", "strips", "bush"])
        if kind == "post":
            height, radius = np.exp(draw(np.log([1.1, 0.02]), np.log([12, 0.5])))
            top, lean = radius * rng.choice([1, draw(0.4, 1)]), rng.choice([0, 1, 5])
            post, truth = streets._shaft(rng, at, "other", radius, top, height, lean)
            rows.append(truth | {"surface": len(things)})
            square = lean == 0 and rng.random() < 0.3
            box = surfaces.box(at, (1.8 * radius, 1.8 * radius, height), heading=draw(0, 90))
            things += [box if square else post, *_beside(rng, at, height, radius)]
        elif kind == "porch":
            radius, height, places = draw(0.08, 0.25), draw(2.3, 3.2), rng.integers(2, 4)
            for along in np.linspace(-1.2, 1.2, places):
                foot = at + [0, along, 0]
                things.append(surfaces.cylinder(foot, foot + [0, 0, height], radius))
            things.append(surfaces.box(at + [side * 0.6, 0, height], (1.7, 3.0, 0.3)))
            back = at + [side * draw(1, 1.8), -2, 0]
            things.append(surfaces.rectangle(back, (0, 4, 0), (0, 0, height + draw(0.3, 3))))
        elif kind == "coat":
            neck, low, radius = draw(1.25, 1.7), rng.choice([0, draw(0.3, 0.8)]), draw(0.13, 0.27)
            ends = at + [0, 0, low], at + [0, 0, neck]
            things.append(surfaces.cylinder(*ends, radius, top_radius=radius * draw(0.6, 1)))
            things.append(surfaces.cylinder(ends[1], ends[1] + [0, 0, 0.25], 0.1))
        elif kind == "strips":
            along = np.array([*np.array([1, 1]) * draw(-1, 1, 2), 0])
            for place in np.cumsum(draw(0.4, 2.5, rng.integers(1, 5))):
                foot = at + place * along + [4 * side, 0, rng.choice([0, 1, 3])]
                things.append(surfaces.rectangle(foot, draw(0.1, 0.6) * along, (0, 0, draw(1, 6))))
        else:
            things.append(_bush(rng, at + [0, 0, rng.choice([0, draw(1, 5)])], 0.15, 0.6, 1.75))
    return streets.Street(Scene(things), pd.DataFrame(rows), length)


def _bush(rng, at, least, most, tall):
    """Foliage that stands at a place (3,), m."""
    size = np.append(rng.uniform(least, most, 2), rng.uniform(0.3, 1) * tall)
    return streets._crown(at + [0, 0, size[2]], size, rng.uniform(0.3, 5), int(rng.integers(2**31)))


def _beside(rng, at, height, radius):
    """A wall behind a post, a crown over it, a board on it, a hedge around it, or nothing."""
    which, side, draw = rng.integers(5), np.sign(at[0]), rng.uniform
    if which == 0:
        foot, rise = at + [side * (radius + draw(0.35, 1.5)), -draw(1, 4), 0], draw(-0.5, 3)
        return [surfaces.rectangle(foot, (0, draw(3, 6), 0), (0, 0, height + rise))]
    if which == 1:
        return [_bush(rng, at + [0, 0, 0.95 * height], 0.7, 3, 3)]
    if which == 2:
        wide = draw(0.3, 0.8)
        return [surfaces.board(at + [0, radius + 0.04, height - wide / 2], wide, wide, heading=0.0)]
    return [_bush(rng, at, 0.3, 1.5, 1.2)] if which == 3 else []


def example(number):
    """Return three views of an example, each with its points (n, 3, metres) and targets."""
    rng = np.random.default_rng([77, number])
    name, length = DRIVES[number // 2 % len(DRIVES)]
    seed = FIRST_SEED + number
    made = (
        yard(rng, 0.8 * length)
        if number % 2
        else streets.street(_plan(rng), length=length, seed=seed)
    )
    scanner = streets.SCANNERS.get(name) or replace(PRESETS[name], lever_arm_m=(0.0, 0.0, 2.2))
    if name == "push-broom":
        beam = {"exit_diameter_m": 0.0, "divergence_mrad": rng.choice([0.0, 5.0, 11.0])}
        scanner = replace(scanner, max_range_m=rng.uniform(30, 80), **beam)
    cloud = streets.drive(made, scanner, seed=seed, speed=rng.uniform(4, 13))
    cloud = cloud[rng.random(len(cloud)) < rng.uniform(0.3, 1)]
    noise = rng.choice([0, 0, 0.01, 0.03]) * rng.standard_normal((len(cloud), 3))
    whole = replace(cloud, points=np.round(cloud.points + noise, rng.choice([2, 4])))
    cut = whole[whole.points[:, 2] < np.exp(rng.uniform(*np.log([1.5, 5])))]
    thin = whole[rng.random(len(whole)) < np.exp(rng.uniform(*np.log([0.06, 0.4])))]
    least = {"minimum_points": 8, "minimum_span": 0.9}
    least["minimum_sweeps"] = 1 if name == "push-broom" else 3
    return [(one.points, streets.visible_targets(made, one, **least)) for one in (whole, cut, thin)]


def _plan(rng):
    """A random street plan, with few to many objects of each kind."""
    most = {"trees": 25, "signs": 20, "lamps": 12, "others": 20, "cars": 15, "pedestrians": 8}
    most |= {"hedges": 8, "columns": 15, "pipes": 15}
    drawn = {f"{name}_per_100m": rng.uniform(0, high) for name, high in most.items()}
    shares = {"far": 0.8, "shrub": 0.8, "thicket": 0.8, "low_crown": 0.6, "building": 1.0}
    drawn |= {f"{name}_share": rng.uniform(0, high) for name, high in shares.items()}
    near = rng.uniform(7, 20)
    return streets.Plan(**drawn, setback_m=(near, near + rng.uniform(1, 10)))


def lessons(numbers):
    """Return the training data of examples: measures, labels and weights."""
    parts = []
    for number in tqdm(numbers, unit="example"):
        views = zip(example(number), WEIGHTS, strict=True)
        parts += [learned.lessons(*view, weight=weight) for view, weight in views]
    return [pd.concat(column) for column in zip(*parts, strict=True)]


if __name__ == "__main__":
    trees = learned.grow(*lessons(range(EXAMPLES)))
    learned.write(trees, Path(learned.__file__).with_name("trees.csv"))
