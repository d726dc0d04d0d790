"""Training of the learned pole detector, on simulated streets alone.

``python -m mmqa_lab.studies.poles_training`` grows the trees anew and writes them to
``mmqa_lab/poles/model.txt``; the same seed gives the same file. Streets, scanners and errors are
drawn widely, so that the trees learn poles and not a street: every example has its own plan,
scanner, speed, noise and thinning.
"""

from dataclasses import replace
from importlib import resources

import numpy as np

from mmqa_lab.io import write_atomically
from mmqa_lab.poles import ours
from mmqa_lab.poles.profiles import scan_lines
from mmqa_lab.simulate import streets

EXAMPLES = 240
FIRST_SEED = 9_000_000
"""Seeds of training streets start here; tests and studies use smaller ones."""

SETUPS = (
    ("roamer", 150.0, (5.0, 14.0)),
    ("push-broom", 140.0, (3.0, 9.0)),
    ("vq-450", 60.0, (8.0, 14.0)),
    ("push-broom", 140.0, (3.0, 9.0)),
    ("roamer", 150.0, (5.0, 14.0)),
    ("push-broom", 140.0, (3.0, 9.0)),
    ("dense-profiler", 50.0, (8.0, 14.0)),
    ("roamer", 150.0, (5.0, 14.0)),
    ("push-broom", 140.0, (3.0, 9.0)),
    ("roamer", 150.0, (5.0, 14.0)),
)
"""Scanner, length of the street (m) and range of speeds (m/s), by turns."""

BEAMS_MRAD = {"push-broom": (0.0, 5.0, 11.0), "roamer": (0.0, 0.0, 0.16)}
"""Divergences to draw from, 0 for the others; old industrial profilers have 11 mrad."""

SCATTER_M = (0.0, 0.0, 0.01, 0.03)
"""Standard deviations of an added error of every coordinate: navigation and old sensors."""


def random_plan(rng):
    """Return a street plan drawn at random between few and many of everything."""
    setback, thinnest = rng.uniform(7, 20), rng.uniform(1, 10)
    return streets.Plan(
        trees_per_100m=rng.uniform(8, 20),
        signs_per_100m=rng.uniform(5, 14),
        lamps_per_100m=rng.uniform(3, 8),
        others_per_100m=rng.uniform(5, 14),
        far_share=rng.uniform(0.1, 0.8),
        shrub_share=rng.uniform(0, 0.7),
        thicket_share=rng.uniform(0, 1),
        thicket_density=(thinnest, thinnest + rng.uniform(0, 20)),
        thicket_height_m=(2.0, rng.uniform(3, 8)),
        low_crown_share=rng.uniform(0, 0.7),
        low_branch_share=rng.uniform(0, 0.9),
        trunk_radius_m=(0.05, rng.uniform(0.15, 0.4)),
        trunk_lean_deg=rng.uniform(1.0, 5.0),
        crown_height_m=(2.5, rng.uniform(4.0, 10.0)),
        crown_density=rng.uniform(0.5, 1.8),
        cars_per_100m=rng.uniform(0, 15),
        pedestrians_per_100m=rng.uniform(0, 5),
        billboards_per_100m=rng.uniform(0, 2),
        hedges_per_100m=rng.uniform(0, 8),
        building_share=rng.uniform(0.1, 1.0),
        setback_m=(setback, setback + rng.uniform(1, 10)),
        balcony_share=rng.uniform(0, 0.9),
        columns_per_100m=rng.uniform(0, 10),
        pipes_per_100m=rng.uniform(0, 10),
        slope=rng.normal(0, 0.02),
        cross_slope=rng.normal(0, 0.02),
    )


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
        near a pole that the cloud hardly shows, are left out, metres.
    """
    middle = (axes[:, 5] + axes[:, 6]) / 2
    xy = axes[:, :2] + axes[:, 2:4] * (middle - axes[:, 4])[:, None]
    half = targets["height_m"].to_numpy() / 2
    shift = np.clip(middle[:, None] - half, -half, half)
    off = xy[:, None] - targets[["x_m", "y_m"]].to_numpy()
    off -= targets[["lean_x", "lean_y"]].to_numpy() * shift[:, :, None]
    distance = np.hypot(off[..., 0], off[..., 1])
    nearest = distance.argmin(axis=1)
    least = distance[np.arange(len(axes)), nearest]
    label = np.where(least < far, -1, 0)
    label[(least < near) & targets["visible"].to_numpy()[nearest]] = 1
    return label


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
            label = labels(axes, targets)
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
    choices = {
        "objective": "binary",
        "num_leaves": leaves,
        "learning_rate": rate,
        "min_data_in_leaf": 30,
        "lambda_l2": 1.0,
        # at each split: on another kind of street a single feature may mislead
        "feature_fraction_bynode": 0.3,
        "deterministic": True,
        "force_row_wise": True,
        "seed": 0,
        "verbose": -1,
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


def main():
    """Train on all examples and write the model; takes about half an hour."""
    text = train(range(EXAMPLES)).model_to_string()
    target = resources.files("mmqa_lab.poles").joinpath("model.txt")
    write_atomically(target, lambda path: path.write_text(text, encoding="utf-8"))


if __name__ == "__main__":
    main()
