"""Training of the learned pole detector, on simulated streets and yards alone.

``python -m mmqa_lab.studies.poles_training FOLDER`` grows the trees anew and writes them to
``model.txt`` in ``mmqa_lab/poles``; the same seed gives the same file. What
each example teaches is kept in the folder, so that an interrupted run goes on. Scanners, streets
and errors are drawn widely, so that the trees learn poles and not a street. Four examples in nine
are yards: bare shafts and what is as tall and narrow but no pole. Of each drive three views are
learned from: the whole, one cropped above the ground, and one that is thin or a single sweep.
"""

import sys
from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np
import pandas as pd

from mmqa_lab.io import write_atomically
from mmqa_lab.poles import ours
from mmqa_lab.simulate import streets, surfaces
from mmqa_lab.simulate.scenes import Scene
from mmqa_lab.simulate.systems import PRESETS
from mmqa_lab.studies import NOTES

EXAMPLES = 504
FIRST_SEED = 9_500_000
"""Seeds of training streets start here; tests and studies use smaller ones."""


def _spinning(elevations, rate):
    """A spinning scanner of ten turns a second; ``rate`` pulses of each beam in a turn."""
    beams = {"elevations_deg": tuple(elevations), "pulse_rate_hz": 10 * rate * len(elevations)}
    return replace(SPINNING["hdl-32e"], **beams)


SPINNING = {"hdl-32e": replace(PRESETS["hdl-32e"], lever_arm_m=(0.0, 0.0, 2.2))}
SPINNING["beams-16"] = _spinning(np.linspace(-15.0, 15.0, 16), 900)
SPINNING["beams-64"] = _spinning(np.linspace(-24.0, 6.0, 64), 900)

_STREET, _YARD = ("street", "roamer", 100.0, (5, 14)), ("yard", "roamer", 64.0, (5, 14))
_PUSH_BROOM = ("street", "push-broom", 90.0, (3, 9))
_PUSHED, _SPARSE = ("yard", "push-broom", 64.0, (3, 9)), ("yard", "hdl-32e", 40.0, (6, 14))
SETUPS = (
    *(_STREET, _YARD, _PUSH_BROOM, _SPARSE, ("street", "hdl-32e", 20.0, (6, 14)), _STREET, _YARD),
    *(("street", "vq-450", 36.0, (8, 14)), _PUSHED, _PUSH_BROOM),
    *(("yard", "beams-16", 40.0, (6, 14)), ("street", "beams-64", 14.0, (6, 14)), _PUSHED),
    *(("yard", "vq-450", 32.0, (8, 14)), ("street", "dense-profiler", 30.0, (8, 14)), _SPARSE),
    *(("street", "beams-16", 24.0, (6, 14)), _PUSH_BROOM),
)
"""Street or yard, scanner, length (m) and range of speeds (m/s), by turns."""

CROWNED, BENT = 0.25, 0.2
"""Shares of the shafts of a yard under a crown, and with a knee."""

SHARES = (1.0, 0.5, 0.5)
YARD_SHARE = 0.7
"""Weights of the views, and of yards beside streets."""

THINNEST = {"vq-450": 0.03, "dense-profiler": 0.03, "roamer": 0.04}
"""Least share of the points in a thin view; 0.1 of other scanners."""

RISING = ("round_m", "round_share", "round_points", "round_slender")
"""Features with which the probability of a pole does not fall: how long a shaft is, its points."""

TREES = {
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
    least = {"thicket_height_m": 2.0, "trunk_radius_m": 0.05}
    least |= {"crown_height_m": 2.5, "crown_radius_m": 1.0}
    drawn |= {name: (low, drawn[name]) for name, low in least.items()}
    drawn["setback_m"] = setback, setback + drawn["setback_m"]
    drawn["thicket_density"] = thinnest, thinnest + drawn["thicket_density"]
    slope, cross_slope = rng.normal(0, 0.02), rng.normal(0, 0.02)
    return streets.Plan(**drawn, slope=slope, cross_slope=cross_slope)


def yard(rng, length):
    """A level place with bare shafts of all sizes and what is as tall and narrow but no pole."""
    things, rows = [surfaces.ground(size=(400.0, 400.0))], []
    step, share = rng.uniform(1.0, 2.0), rng.choice([0.4, 0.7, 1.0])
    for k in range(int(length / step)):
        at = np.array([rng.choice([-1, 1]) * rng.uniform(3.5, 14), step * k, 0.0])
        if rng.random() > share:
            things += YARD[rng.integers(len(YARD))](rng, at)
            continue
        height = np.exp(rng.uniform(np.log(1.1), np.log(12)))
        radius = np.exp(rng.uniform(np.log(0.02), np.log(0.5)))
        top, lean = radius * rng.choice([1.0, rng.uniform(0.6, 1)]), rng.choice([0, 1, 5])
        kind = "tree" if rng.random() < CROWNED else "other"
        post, truth = streets._shaft(rng, at, kind, radius, top, height, lean)
        rows.append(truth | {"surface": len(things)})
        things.append(_bent(rng, truth, kind) if rng.random() < BENT else post)
        if kind == "tree":
            size = rng.uniform([1.0, 1.0, 0.7], [3.5, 3.5, 3.0])
            middle, seed = at + [0, 0, height + 0.7 * size[2]], int(rng.integers(2**31))
            things.append(streets._crown(middle, size, rng.uniform(0.3, 2.0), seed))
    return streets.Street(Scene(things), pd.DataFrame(rows), length, streets.PLANS["quiet"])


def _bent(rng, truth, kind):
    """A shaft with a knee, up to 4 % of its height beside the straight one."""
    middle = np.array([truth["x_m"], truth["y_m"], truth["z_base_m"] + truth["height_m"] / 2])
    way = truth["height_m"] / 2 * np.array([truth["lean_x"], truth["lean_y"], 1.0])
    knee = middle + [*rng.uniform(-0.03, 0.03, 2) * truth["height_m"], 0.0]
    low, high = truth["diameter_base_m"] / 2, truth["diameter_top_m"] / 2
    half = (low + high) / 2
    lower = surfaces.cylinder(middle - way, knee, low, top_radius=half)
    upper = surfaces.cylinder(knee, middle + way, half, top_radius=high)
    return surfaces.group([lower, upper], label=kind)


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


def _front(rng, at):
    """What is seen of a house front between other things: strips of it in a line."""
    turn, foot = rng.uniform(0, np.pi), at + [6 * np.sign(at[0]), 0, 0]
    along = np.array([np.cos(turn), np.sin(turn), 0])
    strips = []
    for place in np.cumsum(rng.uniform(0.4, 2.5, rng.integers(2, 6))):
        low, wide, rise = rng.choice([0.0, 1.0, 3.0]), rng.uniform(0.08, 0.6), rng.uniform(1.5, 6)
        left = foot + place * along + [0, 0, low]
        strips.append(surfaces.rectangle(left, wide * along, (0, 0, rise)))
    return strips


def _bus(rng, at):
    """A van, truck or bus, across the way now and then."""
    size = rng.uniform([1.9, 4.5, 1.8], [2.6, 12.0, 3.0])
    turn = rng.choice([0.0, 0.0, 90.0]) + rng.normal(0, 4)
    return [surfaces.box(at + [np.sign(at[0]), 0, 0.35], tuple(size), heading=turn)]


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


def _coat(rng, at):
    """A person in a coat: a cylinder or cone on the ground or on two legs, and a head."""
    height, radius = rng.uniform(1.5, 1.95), rng.uniform(0.13, 0.25)
    neck, low = height - rng.uniform(0.2, 0.3), rng.choice([0.0, rng.uniform(0.3, 0.8)])
    narrow = radius * rng.uniform(0.6, 1.0)
    body = surfaces.cylinder(at + [0, 0, low], at + [0, 0, neck], radius, top_radius=narrow)
    size = rng.uniform(0.09, 0.13)
    parts = [body, surfaces.ellipsoid(at + [0, 0, height - size], (size, size, size))]
    for side in (-0.09, 0.09) if low else ():
        parts.append(surfaces.cylinder(at + [side, 0, 0], at + [side, 0, low], 0.07))
    return [surfaces.group(parts, label="pedestrian")]


YARD = (_pillar, _cabinet, _strip, _front, _bush, _bush, _person, _car, _bus, _porch)
YARD += (_person, _person, _coat, _coat)


def example(number, *, seed=FIRST_SEED, stretch=1.0):
    """Return three views of a training example: clouds, and their visible and hidden targets.

    ``stretch`` multiplies the length of the street; views with fewer than 200 points are left out.

    Returns
    -------
    list of (int, Cloud, DataFrame)
        Number of the view, its cloud and targets.
    """
    rng = np.random.default_rng([seed, number])
    kind, name, length, speeds = SETUPS[number % len(SETUPS)]
    if kind == "yard":
        made = yard(rng, stretch * length)
    else:
        plan = random_plan(rng)
        made = _filled(rng, streets.street(plan, length=stretch * length, seed=seed + number))
    beam = rng.choice(BEAMS_MRAD.get(name, (0.0,)))
    scanner = (streets.SCANNERS | SPINNING)[name]
    scanner = replace(scanner, exit_diameter_m=0.0, divergence_mrad=beam)
    if name == "push-broom":
        scanner = replace(scanner, max_range_m=rng.uniform(30, 80))
    cloud = streets.drive(made, scanner, seed=seed + number, speed=rng.uniform(*speeds))
    whole = _worn(rng, cloud)
    views = whole, _cropped(rng, made, whole), _thinner(rng, name, whole)
    # an upright scan plane draws a post in one or two lines
    least = {"minimum_points": 8, "minimum_span": 0.9}
    least["minimum_sweeps"] = 1 if name == "push-broom" else 3
    return [
        (number, view, streets.visible_targets(made, view, **least))
        for number, view in enumerate(views)
        if len(view) > 200
    ]


def _filled(rng, made):
    """A street with some persons in coats, and with groves: foliage whose trunks nobody sees."""
    things, share = [], made.length_m / 48
    for _ in range(rng.poisson(rng.uniform(0, 5) * share)):
        across, along = rng.choice([-1, 1]) * rng.uniform(3.5, 10), rng.uniform(0, made.length_m)
        things += _coat(rng, streets._place(made.plan, across, along))
    for _ in range(rng.poisson(rng.uniform(0, 8) * share)):
        across, along = rng.choice([-1, 1]) * rng.uniform(8, 40), rng.uniform(0, made.length_m)
        things += _grove(rng, streets._place(made.plan, across, along))
    return replace(made, scene=Scene([*made.scene.surfaces, *things]))


def _grove(rng, at):
    """Crowns and bushes that run into each other, up to 17 m high."""
    parts, tall = [], rng.uniform(2, 12)
    for _ in range(rng.integers(2, 6)):
        size = rng.uniform([0.7, 0.7, 0.7], [3.0, 3.0, 3.0])
        middle = at + [*rng.normal(0, 2.5, 2), size[2] * 0.8 + rng.uniform(0, tall)]
        parts.append(streets._crown(middle, size, rng.uniform(0.4, 2.5), int(rng.integers(2**31))))
    return parts


def _worn(rng, cloud):
    """A cloud with fewer points, scattered and now and then rounded."""
    cloud = cloud[rng.random(len(cloud)) < rng.uniform(0.3, 1)]
    points = cloud.points + rng.choice(SCATTER_M) * rng.standard_normal((len(cloud), 3))
    return replace(cloud, points=np.round(points, 2) if rng.random() < 0.25 else points)


def _cropped(rng, made, cloud):
    """What lies less than 1.4 to 4.5 m above the ground."""
    slopes = np.array([made.plan.cross_slope, made.plan.slope])
    rise = cloud.points[:, 2] - cloud.points[:, :2] @ slopes
    return cloud[rise < np.exp(rng.uniform(np.log(1.4), np.log(4.5)))]


def _thinner(rng, name, cloud):
    """Of spinning scanners mostly one sweep, else few points."""
    if name in SPINNING and rng.random() < 0.7:
        middle = cloud["gps_time"].max() * rng.uniform(0.3, 0.7)
        return cloud[np.abs(cloud["gps_time"] - middle) < 0.05]
    least = THINNEST.get(name, 0.1)
    return cloud[rng.random(len(cloud)) < np.exp(rng.uniform(np.log(least), np.log(0.4)))]


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


def lessons(numbers, folder, *, progress=True, **choices):
    """Return what examples teach.

    Parameters
    ----------
    numbers : iterable of int
        Of the examples.
    folder : path
        Where each is kept once it is made, so that an interrupted run goes on where it stopped.
    progress : bool
    **choices
        As for :func:`example`.

    Returns
    -------
    dict of array
        ``features`` (k, features); of each candidate ``label`` of :func:`labels`, ``kind``, the row
        of ``ours.CLASSES`` of the nearest target, ``group``, a number for each view, and ``share``,
        the weight of such a view.
    """
    from tqdm.auto import tqdm

    Path(folder).mkdir(parents=True, exist_ok=True)
    parts = []
    for number in tqdm(numbers, unit="example", disable=not progress):
        file = Path(folder) / f"{number:04d}.npz"
        if not file.exists():
            made = _lesson(number, **choices)
            write_atomically(file, lambda path, made=made: np.savez(path.open("wb"), **made))
        with np.load(file) as made:
            parts.append(dict(made))
    return _together(parts)


def _lesson(number, **choices):
    """Arrays of one example."""
    parts, yard_share = [], YARD_SHARE if SETUPS[number % len(SETUPS)][0] == "yard" else 1.0
    for view, cloud, targets in example(number, **choices):
        origin = np.floor(cloud.points.min(axis=0))
        features, axes, _ = ours.described(cloud.points - origin, ours.Settings())
        axes[:, :2] += origin[:2]
        label, _ = labels(axes, targets)
        group = np.full(len(label), number * len(SHARES) + view)
        made = {"features": features.astype(np.float32), "label": label, "group": group}
        made |= {"share": 0.0 * label}
        made["share"] += SHARES[view] * yard_share
        parts.append({name: column[label >= 0] for name, column in made.items()})
    return _together(parts)


def _together(parts):
    """Tables of the same columns, one below the other."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def fit(features, label, group, share=1.0, *, rounds=800, leaves=20, rate=0.1):
    """Return trees grown by gradient boosting of the log loss.

    Parameters
    ----------
    features, label, group, share
        Of :func:`lessons`. A group weighs as the root of the number of its candidates.
    rounds, leaves, rate : int, int, float
        Number of trees, leaves of each, learning rate.

    Returns
    -------
    lightgbm.Booster
        It never falls with the features in ``RISING``, the others the same.
    """
    import lightgbm

    size = np.unique(group, return_counts=True)[1][np.unique(group, return_inverse=True)[1]]
    weight = np.sqrt(np.median(size) / size) * share
    data = lightgbm.Dataset(features, label, weight=weight, feature_name=list(ours.FEATURES))
    choices = TREES | {"objective": "binary", "num_leaves": leaves, "learning_rate": rate}
    choices |= {"min_data_in_leaf": 200, "lambda_l2": 50.0}
    choices["monotone_constraints"] = [int(name in RISING) for name in ours.FEATURES]
    return lightgbm.train(choices, data, num_boost_round=rounds)


def main(folder):
    """Train on all examples and write both files of trees; takes about half an hour."""
    taught = lessons(range(EXAMPLES), folder)
    _write("model.txt", fit(**taught))


def _write(name, model):
    """Write trees where the package reads them."""
    target, text = resources.files("mmqa_lab.poles").joinpath(name), model.model_to_string()
    write_atomically(target, text)


if __name__ == "__main__":
    main(sys.argv[1])
