"""Training of the learned pole detector, on simulated streets alone.

``python -m mmqa_lab.studies.poles_training`` grows the trees again and writes ``trees.csv`` in
``mmqa_lab/poles``, with the same bytes each time. Every third example is a yard of bare posts, of
trees with low crowns, and of objects that look like posts. Streets are crowded, and some of their
views sparse and rough. Every third view is cut off above a height.
"""

from dataclasses import replace

import numpy as np
import pandas as pd

from mmqa_lab.poles import learned
from mmqa_lab.simulate import PRESETS, Scene, streets, surfaces

EXAMPLES, FIRST_SEED, SHARES = 240, 9_500_000, (0.5, 1.0, 1.0)
"""Seeds of tests and studies are smaller. Weights of a yard and of the two streets after it."""

DRIVES = (("roamer", 50), ("push-broom", 60), ("roamer", 50), ("hdl-32e", 24))
"""Scanner and length of the street (m), in rotation."""


def yard(rng, length):
    """Return a level street of posts, of porches before walls, of trees and of people."""
    things, rows, draw = [surfaces.ground(size=(400.0, 400.0))], [], rng.uniform
    for y in np.cumsum(draw(1.2, 2.2, int(length / 1.7))):
        out, kind = np.array([rng.choice([-1.0, 1.0]), 0, 0]), rng.integers(9)
        at, side = draw(3.5, 14) * out + [0, y, 0], np.array([0, draw(1, 3), 0])
        if kind < 4:  # a post, and perhaps something beside it
            height, radius = np.exp(draw(*np.log([[1.1, 0.02], [12, 0.5]])))
            lean, taper = rng.choice([0, 1, 5]), rng.choice([1, draw(0.4, 1)])
            post, truth = streets._shaft(rng, at, "other", radius, taper * radius, height, lean)
            rows.append(truth | {"surface": len(things)})
            if lean == 0 and rng.random() < 0.3:
                post = surfaces.box(at, (1.8 * radius, 1.8 * radius, height), heading=draw(0, 90))
            foot, size = at + (radius + draw(0.35, 1.5)) * out - side, draw([0.7] * 3, [3, 3, 1.5])
            wall = surfaces.rectangle(foot, 2 * side, (0, 0, height + draw(-0.5, 3)))
            crown = streets._crown(at + [0, 0, height], size, 1.0, rng.integers(2**31))
            things += [post, *[wall, crown][kind : kind + rng.integers(2)]]
        elif kind == 4:  # a porch
            deep, thick, rise, inset = draw([1.0, 0.15, 2.2, 0.1], [2.5, 1.2, 3.5, 0.4])
            for foot in at + np.outer(np.linspace(-0.9, 0.9, rng.integers(2, 5)), side):
                things.append(surfaces.cylinder(foot, foot + [0, 0, rise], draw(0.07, 0.25)))
            roof, wall = at + (deep / 2 - inset) * out, at + (deep - inset) * out - 2 * side
            things.append(surfaces.box(roof + [0, 0, rise], (deep, 2 * side[1], thick)))
            things.append(surfaces.rectangle(wall, 4 * side, (0, 0, draw(3, 7))))
        elif kind < 7:  # a tree
            radius, base, size = draw([0.06, 1.2, 0.8], [0.25, 4.0, 3.5])
            trunk, truth = streets._shaft(rng, at, "tree", radius, radius, base + 0.5, 3)
            rows.append(truth | {"surface": len(things), "clear_height_m": base})
            top, seed = at + [0, 0, base + 0.7 * size], rng.integers(2**31)
            things += [trunk, streets._crown(top, [size, size, 0.7 * size], draw(0.3, 1.5), seed)]
        else:
            things.append(streets._pedestrian(rng, at))
    return streets.Street(Scene(things), pd.DataFrame(rows), length)


def example(number):
    """Yield three views of an example, each with points (n, 3, metres) and targets."""
    rng, seed = np.random.default_rng([77, number]), FIRST_SEED + number
    name, length = DRIVES[number // 3 % len(DRIVES)]
    crowd = {"cars_per_100m": rng.uniform(0, 50), "pedestrians_per_100m": rng.uniform(0, 50)}
    plan = replace(streets.PLANS[rng.choice(list(streets.PLANS))], **crowd)
    made = streets.street(plan, length=length, seed=seed) if number % 3 else yard(rng, length)
    scanner = replace(PRESETS[name], lever_arm_m=(0.0, 0.0, 2.2), max_range_m=rng.uniform(30, 80))
    cloud = streets.drive(made, scanner, seed=seed, speed=rng.uniform(4, 13))
    for highest in (99.0, 99.0, rng.uniform(2, 5)):
        view = cloud[rng.random(len(cloud)) < np.exp(rng.uniform(np.log(0.05), 0))]
        view = view[view.points[:, 2] < highest]
        noise = rng.choice([0, 0.01, 0.03, 0.05]) * rng.standard_normal((len(view), 3))
        view = replace(view, points=np.round(view.points + noise, rng.choice([2, 4])))
        yield view.points, streets.visible_targets(made, view, minimum_sweeps=2)


def lessons(numbers):
    """Return the training data of examples: measures, labels and weights."""
    parts = [learned.lessons(*view, weight=SHARES[k % 3]) for k in numbers for view in example(k)]
    return [pd.concat(column) for column in zip(*parts, strict=True)]


if __name__ == "__main__":
    learned.write(learned.grow(*lessons(range(EXAMPLES))), learned.FILE)
