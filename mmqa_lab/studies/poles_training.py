"""Training of the learned pole detector, on simulated streets alone.

``python -m mmqa_lab.studies.poles_training FOLDER`` grows the trees anew and writes them to
``model.txt`` and ``classes.txt`` in ``mmqa_lab/poles``; the same seed gives the same files. What
the varied examples teach is kept in the folder, so that an interrupted run goes on. Streets,
scanners and errors are drawn widely, so that the trees learn poles and not a street: every example
has its own plan, scanner, speed, noise and thinning. The trees of the classes learn from the varied
ones, among them yards of bare shafts.
"""

import sys
from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np
import pandas as pd

from mmqa_lab.io import write_atomically
from mmqa_lab.poles import ours
from mmqa_lab.poles.features import NAMES
from mmqa_lab.poles.on_lines import scan_lines
from mmqa_lab.simulate import streets, surfaces
from mmqa_lab.simulate.scenes import Scene
from mmqa_lab.simulate.systems import PRESETS
from mmqa_lab.studies import NOTES

EXAMPLES = 240
FIRST_SEED = 9_000_000
"""Seeds of training streets start here; tests and studies use smaller ones."""

_ROAMER = ("roamer", 150.0, (5.0, 14.0))
_PUSH_BROOM = ("push-broom", 140.0, (3.0, 9.0))
SETUPS = (
    *(_ROAMER, _PUSH_BROOM, ("vq-450", 60.0, (8.0, 14.0)), _PUSH_BROOM, _ROAMER, _PUSH_BROOM),
    *(("dense-profiler", 50.0, (8.0, 14.0)), _ROAMER, _PUSH_BROOM, _ROAMER),
)
"""Scanner, length of the street (m) and range of speeds (m/s), by turns."""

TREES = {
    "min_data_in_leaf": 20,
    "lambda_l2": 1.0,
    # at each split: on another kind of street a single feature may mislead
    "feature_fraction_bynode": 0.3,
    "deterministic": True,
    "force_row_wise": True,
    "num_threads": 1,
    "seed": 0,
    "verbose": -1,
}
"""What all trees share."""

BEAMS_MRAD = {"push-broom": (0.0, 5.0, 11.0), "roamer": (0.0, 0.0, 0.16)}
"""Divergences to draw from, 0 for the others; old industrial profilers have 11 mrad."""

SCATTER_M = (0.0, 0.0, 0.01, 0.03)
"""Standard deviations of an added error of every coordinate: navigation and old sensors."""


def random_plan(rng):
    """Return a street plan drawn at random between few and many of everything."""
    setback, thinnest = rng.uniform(7, 20), rng.uniform(1, 10)
    drawn = {name: rng.uniform(*ends) for name, ends in NOTES["poles_training"]["plan"].items()}
    least = {"thicket_height_m": 2.0, "trunk_radius_m": 0.05, "crown_height_m": 2.5}
    drawn |= {name: (low, drawn[name]) for name, low in least.items()}
    drawn["setback_m"] = setback, setback + drawn["setback_m"]
    drawn["thicket_density"] = thinnest, thinnest + drawn["thicket_density"]
    slope, cross_slope = rng.normal(0, 0.02), rng.normal(0, 0.02)
    return streets.Plan(**drawn, slope=slope, cross_slope=cross_slope)


def example(number, *, seed=FIRST_SEED, stretch=1.0):
    """Return the street, the cloud and the targets of a training example.

    The cloud is degraded by thinning, scatter and rounding; ``stretch`` multiplies the length.
    """
    rng = np.random.default_rng([seed, number])
    name, length, speeds = SETUPS[number % len(SETUPS)]
    made = streets.street(random_plan(rng), length=stretch * length, seed=seed + number)
    scanner = streets.SCANNERS[name]
    beam = rng.choice(BEAMS_MRAD.get(name, (0.0,)))
    scanner = replace(scanner, exit_diameter_m=0.0, divergence_mrad=beam)
    scatter, rounding, share = rng.choice(SCATTER_M), rng.choice([0, 0, 0.01]), rng.uniform(0.3, 1)
    cloud = streets.drive(made, scanner, seed=seed + number, speed=rng.uniform(*speeds))
    cloud = cloud[rng.random(len(cloud)) < share]
    points = cloud.points + scatter * rng.standard_normal((len(cloud), 3))
    if rounding:
        points = np.round(points / rounding) * rounding
    cloud = replace(cloud, points=points)
    # an upright scan plane draws a post in one or two lines
    sweeps = 1 if name == "push-broom" else 5
    return made, cloud, streets.visible_targets(made, cloud, minimum_sweeps=sweeps)


BEAMS = {
    "hdl-32e": replace(PRESETS["hdl-32e"], lever_arm_m=(0.0, 0.0, 2.2)),
    "beams-64": replace(
        PRESETS["hdl-32e"],
        pulse_rate_hz=64 * 10 * 900,
        elevations_deg=tuple(np.linspace(-24.0, 6.0, 64)),
        lever_arm_m=(0.0, 0.0, 2.2),
    ),
}
"""Spinning scanners of the varied examples."""

VARIED = 150
VARIED_SETUPS = (
    *(("roamer", 48.0, (5.0, 14.0)), ("push-broom", 48.0, (3.0, 9.0))),
    *(("vq-450", 18.0, (8.0, 14.0)), ("hdl-32e", 16.0, (6.0, 14.0))),
    *(("roamer", 48.0, (5.0, 14.0)), ("push-broom", 48.0, (3.0, 9.0))),
    *(("dense-profiler", 16.0, (8.0, 14.0)), ("beams-64", 12.0, (6.0, 14.0))),
)
DENSE = ("vq-450", "dense-profiler")
"""Scanners whose clouds are thinned to as little as a twentieth; those of others to a quarter."""


def yard(rng, length):
    """A level place with bare shafts of all sizes and what is as tall and narrow but no pole."""
    things, rows = [surfaces.ground(size=(400.0, 400.0))], []
    for k in range(int(length / 1.6)):
        at = np.array([rng.choice([-1, 1]) * rng.uniform(3.5, 14), 1.6 * k, 0.0])
        kind = rng.choice(len(YARD) + 1, p=[0.6, *[0.4 / len(YARD)] * len(YARD)])
        if kind:
            things += YARD[kind - 1](rng, at)
            continue
        height = np.exp(rng.uniform(np.log(1.1), np.log(12)))
        radius = np.exp(rng.uniform(np.log(0.02), np.log(0.5)))
        top, lean = radius * rng.uniform(0.6, 1), rng.choice([0, 1, 5])
        post, truth = streets._shaft(rng, at, "other", radius, top, height, lean)
        rows.append(truth | {"surface": len(things)})
        things.append(post)
    return streets.Street(Scene(things), pd.DataFrame(rows), length, streets.PLANS["quiet"])


def _pillar(rng, at):
    """A gate pillar with a low fence on either side."""
    wide, turn = rng.uniform(0.3, 0.6), rng.uniform(0, 180)
    along = np.array([np.cos(np.radians(turn)), -np.sin(np.radians(turn)), 0])
    fence = surfaces.rectangle(at - 1.5 * along, 3 * along, (0, 0, rng.uniform(0.8, 1.6)))
    return [surfaces.box(at, (wide, wide, rng.uniform(1.2, 2.2)), heading=turn), fence]


def _cabinet(rng, at):
    """A box of 0.6 to 1.4 m."""
    size = rng.uniform([0.6, 0.3, 0.9], [1.4, 0.6, 1.7])
    return [surfaces.box(at, tuple(size), heading=rng.uniform(0, 180))]


def _strip(rng, at):
    """A strip of a wall that is seen between other things, and hangs as often as it stands."""
    turn, wide = rng.uniform(0, np.pi), rng.uniform(0.15, 0.7)
    along = wide * np.array([np.cos(turn), np.sin(turn), 0])
    foot = at + [0, 0, rng.choice([0.0, rng.uniform(0.8, 5)])]
    return [surfaces.rectangle(foot, along, (0, 0, rng.uniform(1, 6)))]


def _bush(rng, at):
    """A hedge post: narrow foliage; or the tip of a crown, which hangs."""
    radius, height = rng.uniform(0.15, 0.5), rng.uniform(1.2, 3.5)
    middle = at + [0, 0, height / 2 + rng.choice([0.0, rng.uniform(1, 5)])]
    seed = int(rng.integers(2**31))
    return [streets._crown(middle, (radius, radius, height / 2), rng.uniform(1, 6), seed)]


def _person(rng, at):
    """A pedestrian."""
    return [streets._pedestrian(rng, at)]


def _car(rng, at):
    """A car."""
    return [streets._car(rng, at)]


def _porch(rng, at):
    """Two columns under a roof before a wall."""
    side, radius = np.sign(at[0]), rng.uniform(0.08, 0.25)
    rise = rng.uniform(2.3, 3.2)
    feet = [at + [side * 0.5, -0.6, 0], at + [side * 0.5, 0.6, 0]]
    columns = [surfaces.cylinder(foot, foot + [0, 0, rise], radius) for foot in feet]
    roof = surfaces.box(at + [side * 1.0, 0, rise], (1.6, 2.2, 0.3))
    back = surfaces.rectangle(at + [side * 1.8, -1.4, 0], (0, 2.8, 0), (0, 0, rise + 0.5))
    return [*columns, roof, back]


YARD = (_pillar, _cabinet, _strip, _bush, _person, _car, _porch)


def varied_example(number, *, seed=FIRST_SEED, stretch=1.0):
    """Return the thinned points of a varied example, and its visible and hidden targets.

    More scanners than :func:`example`, single sweeps of spinning ones, clouds thinned to a
    twentieth, one in four cut off above 1.5 to 4 m; a third are yards of bare shafts.
    """
    rng = np.random.default_rng([seed, number])
    name, length, speeds = VARIED_SETUPS[number % len(VARIED_SETUPS)]
    if number // len(VARIED_SETUPS) % 3 == 2:
        made = yard(rng, stretch * length)
    else:
        made = streets.street(random_plan(rng), length=stretch * length, seed=seed + number)
    beam = rng.choice(BEAMS_MRAD.get(name, (0.0,)))
    scanner = (streets.SCANNERS | BEAMS)[name]
    scanner = replace(scanner, exit_diameter_m=0.0, divergence_mrad=beam)
    cloud = streets.drive(made, scanner, seed=seed + number, speed=rng.uniform(*speeds))
    if name in BEAMS and rng.random() < 0.5:  # one sweep
        middle = cloud["gps_time"].max() * rng.uniform(0.3, 0.7)
        cloud = cloud[np.abs(cloud["gps_time"] - middle) < 0.05]
    least = 0.05 if name in DENSE else 0.25
    cloud = cloud[rng.random(len(cloud)) < np.exp(rng.uniform(np.log(least), 0))]
    if rng.random() < 0.25:
        slopes = np.array([made.plan.cross_slope, made.plan.slope])
        rise = cloud.points[:, 2] - cloud.points[:, :2] @ slopes
        cloud = cloud[rise < rng.uniform(1.5, 4)]
    points = cloud.points + rng.choice(SCATTER_M) * rng.standard_normal((len(cloud), 3))
    if rng.random() < 0.25:
        points = np.round(points, 2)
    cloud = replace(cloud, points=points)
    # an upright scan plane draws a post in one or two lines
    sweeps = 1 if name == "push-broom" else 3
    return cloud, streets.visible_targets(made, cloud, minimum_sweeps=sweeps)


def labels(axes, targets, *, near=0.3, far=0.6):
    """Return what each candidate is: 1 a visible pole, 0 none, -1 not to be learned from.

    Parameters
    ----------
    axes : array, shape (k, 8)
        Of :func:`mmqa_lab.poles.features.describe`, in the coordinates of the targets.
    targets : DataFrame
        Of :func:`mmqa_lab.simulate.streets.visible_targets`.
    near, far : float
        Candidates nearer than ``near`` to a visible pole are that pole; those between, and those
        near a pole that the cloud hardly shows, are left out, metres. Of poles wider than 0.3 m
        it counts from a circle 0.15 m within the surface: the cloud shows their front.

    Returns
    -------
    label, nearest : arrays of int, shape (k,)
        With the row of the nearest target.
    """
    middle = (axes[:, 5] + axes[:, 6]) / 2
    xy = axes[:, :2] + axes[:, 2:4] * (middle - axes[:, 4])[:, None]
    half = targets["height_m"].to_numpy() / 2
    shift = np.clip(middle[:, None] - half, -half, half)
    off = xy[:, None] - targets[["x_m", "y_m"]].to_numpy()
    off -= targets[["lean_x", "lean_y"]].to_numpy() * shift[:, :, None]
    within = np.maximum(targets["diameter_base_m"].to_numpy() / 2 - 0.15, 0)
    distance = np.hypot(off[..., 0], off[..., 1]) - within
    nearest = distance.argmin(axis=1)
    least = distance[np.arange(len(axes)), nearest]
    label = np.where(least < far, -1, 0)
    label[(least < near) & targets["visible"].to_numpy()[nearest]] = 1
    return label, nearest


def examples(numbers, *, progress=True, **choices):
    """Return the features and the labels of many training examples; choices as for ``example``.

    Each cloud comes twice, with its scan lines and without, so that one verifier serves both.

    Returns
    -------
    features, label, group
        (k, features), (k,), and the number of the example of each, (k,).
    """
    from tqdm.auto import tqdm

    parts = []
    for number in tqdm(numbers, unit="street", disable=not progress):
        _, cloud, targets = example(number, **choices)
        origin = np.floor(cloud.points.min(axis=0))
        for lines in (None, scan_lines(cloud)):
            where = ours.described(cloud.points - origin, ours.Settings(), lines=lines)
            features, axes, _ = where
            axes[:, :2] += origin[:2]
            label, _ = labels(axes, targets)
            parts.append((features, label, np.full(len(label), number)))
    features, label, group = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    kept = label >= 0
    return features[kept], label[kept], group[kept]


def fit(features, label, group, *, rounds=300, leaves=31, rate=0.05):
    """Return trees grown by gradient boosting of the log loss; each street weighs the same.

    Parameters
    ----------
    features, label, group
        Of :func:`examples`.
    rounds, leaves, rate : int, int, float
        Number of trees, leaves of each, learning rate.

    Returns
    -------
    lightgbm.Booster
    """
    import lightgbm

    size = np.bincount(group)[group]
    weight = np.sqrt(np.median(size) / size)
    data = lightgbm.Dataset(features, label, weight=weight, feature_name=list(ours.FEATURES))
    choices = TREES | {"objective": "binary", "num_leaves": leaves, "learning_rate": rate}
    choices["min_data_in_leaf"] = 30
    return lightgbm.train(choices, data, num_boost_round=rounds)


def lessons(numbers, folder, *, progress=True, **choices):
    """Return what varied examples teach: features, label, kind and number of the example.

    Parameters
    ----------
    numbers : iterable of int
        Of the examples.
    folder : path
        Where each is kept once it is made, so that an interrupted run goes on where it stopped.
    progress : bool
    **choices
        As for :func:`varied_example`.

    Returns
    -------
    features, label, kind
        (k, features) without scan lines, (k,) of :func:`labels`, and (k,) row of
        ``ours.CLASSES`` of the nearest target.
    """
    from tqdm.auto import tqdm

    Path(folder).mkdir(parents=True, exist_ok=True)
    parts = []
    for number in tqdm(numbers, unit="street", disable=not progress):
        file = Path(folder) / f"{number:04d}.npz"
        if not file.exists():
            made = _lesson(number, **choices)
            write_atomically(file, lambda path, made=made: np.savez(path.open("wb"), **made))
        with np.load(file) as made:
            kept = made["label"] >= 0
            parts.append([made[name][kept] for name in ("features", "label", "kind")])
    return [np.concatenate(columns) for columns in zip(*parts, strict=True)]


def _lesson(number, **choices):
    """Arrays of one varied example."""
    cloud, targets = varied_example(number, **choices)
    origin = np.floor(cloud.points.min(axis=0))
    features, axes, _ = ours.described(cloud.points - origin, ours.Settings())
    axes[:, :2] += origin[:2]
    label, nearest = labels(axes, targets)
    features = features.astype(np.float32)
    return {"features": features, "label": label, "kind": kinds(targets)[nearest]}


def kinds(targets):
    """Return the class of each target, a row of :data:`mmqa_lab.poles.ours.CLASSES`.

    Bare shafts and the targets called other are classed by their sizes, as the generator makes
    them: utility poles are wider than flagpoles, signals stand 3 to 4 m high, shafts wider than
    0.45 m are other.
    """
    name, height = targets["class"].to_numpy(), targets["height_m"].to_numpy()
    width = targets["diameter_base_m"].to_numpy()
    street = np.isin(name, ("lamp", "sign", "tree")).any()
    signal = street & (height >= 2) & (height < 4.5)
    utility = (height >= 4.5) & ((width >= 0.2) | (not street)) & (width <= 0.45)
    low = (height < 4.5) & (width <= 0.45)
    known = [name == "lamp", name == "sign", name == "tree", signal, utility, low]
    return np.select(known, [0, 1, 2, 1, 0, 3], 4)


def fit_classes(features, label, kind, *, rounds=40):
    """Return trees that tell the class of a pole from its features, one set a class."""
    import lightgbm

    own = label == 1
    features, kind = features[own][:, : len(NAMES)], kind[own]
    weight = 1 / np.sqrt(np.bincount(kind)[kind])
    data = lightgbm.Dataset(features, kind, weight=weight / weight.mean(), feature_name=list(NAMES))
    choices = TREES | {
        "objective": "multiclass",
        "num_class": len(ours.CLASSES),
        "num_leaves": 8,
        "learning_rate": 0.08,
        "feature_fraction_bynode": 0.4,
    }
    return lightgbm.train(choices, data, num_boost_round=rounds)


def train(numbers, *, seed=FIRST_SEED, stretch=1.0, progress=True, **choices):
    """Return the trees that the given training examples make; choices as for :func:`fit`.

    Parameters
    ----------
    numbers : iterable of int
        Of the examples; the program takes ``range(EXAMPLES)``.
    seed : int
    stretch : float
        Multiplies the length of every street.
    progress : bool
    """
    data = examples(list(numbers), seed=seed, stretch=stretch, progress=progress)
    return fit(*data, **choices)


def main(folder):
    """Train on all examples and write both files of trees; takes about half an hour."""
    features, label, kind = lessons(range(VARIED), folder)
    _write("classes.txt", fit_classes(features, label, kind))
    _write("model.txt", train(range(EXAMPLES)))


def _write(name, model):
    """Write trees where the package reads them."""
    target, text = resources.files("mmqa_lab.poles").joinpath(name), model.model_to_string()
    write_atomically(target, text)


if __name__ == "__main__":
    main(sys.argv[1])
