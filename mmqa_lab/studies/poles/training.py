"""Training of the verifier of "ours", on simulated streets alone.

``python -m mmqa_lab.studies.poles.training`` writes ``mmqa_lab/poles/model.json`` anew, and
``quiet.json`` beside this module, which has seen quiet streets alone; the same seed gives the same
files. Streets, scanners and errors are drawn widely, so that the verifier learns poles and not a
street: every example has its own plan, scanner, speed, noise and thinning.
"""

from dataclasses import replace
from importlib import resources

import numpy as np

from mmqa_lab.io import write_atomically
from mmqa_lab.poles import ours
from mmqa_lab.poles.profiles import scan_lines
from mmqa_lab.poles.trees import Trees
from mmqa_lab.simulate import streets

EXAMPLES = 240
QUIET_EXAMPLES = 120
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


def quiet_plan(rng):
    """Return such a plan without balconies and with a fifth of the columns and pipes."""
    plan = random_plan(rng)
    few = {name: getattr(plan, name) / 5 for name in ("columns_per_100m", "pipes_per_100m")}
    return replace(plan, balcony_share=0.0, **few)


WARY = 50.0
"""Weight, on quiet streets, of what is no pole and stands at a wall: who has seen little there must
be wary. Chosen on eight streets full of balconies that no result is reported of."""

WALL_M = 3.0
WALL_OFF_M = 2.0
"""Something stands at a wall when so much of one is seen no farther than that from its axis."""


def example(number, *, plan=random_plan, seed=FIRST_SEED, stretch=1.0):
    """Return the street, the cloud and the targets of a training example.

    The street is of the plan that ``plan`` makes of a random generator; the cloud is degraded by
    thinning, scatter and rounding; ``stretch`` multiplies the length.
    """
    rng = np.random.default_rng([seed, number])
    name, length, speeds = SETUPS[number % len(SETUPS)]
    made = streets.street(plan(rng), length=stretch * length, seed=seed + number)
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


def fit(features, label, group, *, rounds=300, leaves=31, rate=0.05, wary=1.0, more=(), notes=None):
    """Return the ``Trees`` of a gradient boosting of the log loss; each street weighs the same.

    Parameters
    ----------
    features, label, group
        Of :func:`examples`.
    rounds, leaves, rate : int, int, float
        Number of trees, leaves of each, learning rate.
    wary : float
        Weight of what is no pole and stands at a wall (``WALL_M``, ``WALL_OFF_M``).
    more : tuple of str
        Names of columns that follow those of :func:`examples`.
    """
    from sklearn.ensemble import HistGradientBoostingClassifier

    size = np.bincount(group)[group]
    weight = np.sqrt(np.median(size) / size)
    length, off = (features[:, ours.FEATURES.index(f"facade_{name}m")] for name in ("", "off_"))
    weight[(length >= WALL_M) & (off <= WALL_OFF_M) & (label == 0)] *= wary
    model = HistGradientBoostingClassifier(
        max_iter=rounds,
        max_leaf_nodes=leaves,
        learning_rate=rate,
        min_samples_leaf=30,
        l2_regularization=1.0,
        max_features=0.3,  # at each split: on another kind of street a single feature may mislead
        early_stopping=False,
        random_state=0,
    )
    model.fit(features, label, sample_weight=weight)
    nodes, roots = [], []
    for (tree,) in model._predictors:
        first = len(nodes)
        roots.append(first)
        for node in tree.nodes:
            if node["is_leaf"]:
                nodes.append([-1, 0, 0, 0, node["value"]])
            else:
                sides = node["left"] + first, node["right"] + first
                nodes.append([node["feature_idx"], node["num_threshold"], *sides, 0])
    base = float(model._baseline_prediction.ravel()[0])
    return Trees(ours.FEATURES + more, base, np.array(nodes, float), np.array(roots), notes or {})


def train(numbers, *, plan=random_plan, seed=FIRST_SEED, stretch=1.0, progress=True, **choices):
    """Return the verifier that the given training examples make: from seeds to ``Trees``.

    Parameters
    ----------
    numbers : iterable of int
        Of the examples; the model of the package is ``train(range(EXAMPLES))``.
    plan : callable
        ``random_plan`` or ``quiet_plan``.
    seed : int
    stretch : float
        Multiplies the length of every street.
    progress : bool
    **choices
        Handed to :func:`fit`.
    """
    numbers = list(numbers)
    data = examples(numbers, plan=plan, seed=seed, stretch=stretch, progress=progress)
    notes = {
        "trained on": f"{len(numbers)} simulated streets, seeds from {seed}",
        "plans": plan.__name__,
        "candidates": len(data[1]),
        "poles": int(data[1].sum()),
        "program": "python -m mmqa_lab.studies.poles.training",
    }
    return fit(*data, notes=notes, **choices)


def quiet_model():
    """Return the verifier that has seen quiet streets alone."""
    text = resources.files("mmqa_lab.studies.poles").joinpath("quiet.json").read_text("utf-8")
    return Trees.from_json(text)


def main():
    """Train on all examples and write both models; takes about half an hour."""
    _write(train(range(EXAMPLES)), "mmqa_lab.poles", "model.json")
    quiet = train(range(QUIET_EXAMPLES), plan=quiet_plan, wary=WARY)
    _write(quiet, "mmqa_lab.studies.poles", "quiet.json")


def _write(model, package, name):
    """Write a model into a package."""
    text = model.to_json()
    target = resources.files(package).joinpath(name)
    write_atomically(target, lambda path: path.write_text(text, encoding="utf-8"))


if __name__ == "__main__":
    main()
