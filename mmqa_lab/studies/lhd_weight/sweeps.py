"""The distance's settings swept over simulated canyons: W, sensitivity, matcher, displacement."""

from functools import partial
from itertools import product

import numpy as np
import pandas as pd
import xarray as xr
from tqdm.auto import tqdm

from mmqa_lab import lines
from mmqa_lab.simulate.canyon import COMPARISONS, Conditions, canyon
from mmqa_lab.stats import bootstrap
from mmqa_lab.studies.lhd_weight.comparisons import MEASURES, comparisons, measure, oracle_f1
from mmqa_lab.views import is_headless

SETTINGS = ("weight", "sensitivity", "matcher")
SCENES = ("displacement", "angle_noise", "jambs", "kind", "seed")


def compute(*, weights, sensitivities, matchers, displacements, angle_noises, jambs, kinds, seeds):
    """Sweep the distance's settings over simulated scenes.

    Parameters
    ----------
    weights : sequence of float
        W of the angle.
    sensitivities : sequence of float
        Of the peak threshold, m.
    matchers : sequence of str
    displacements : sequence of float
        Length of the displacement common to all courses, m; their own errors come on top.
    angle_noises : sequence of float
        Standard deviation of the courses' edge directions, degrees.
    jambs : sequence of float
        Mean number of window jambs found per building: short edges that cross long ones.
    kinds : sequence of {"repeatability", "absolute"}
    seeds : sequence of int
        One scene each.

    Returns
    -------
    xarray.Dataset
        Means over the three comparisons of each kind and both directions: the MEASURES, with
        ``oracle_f1`` (the best threshold known), ``true_m`` and ``true_perpendicular_m``.
    """
    coordinates = {
        "weight": list(weights),
        "sensitivity": list(sensitivities),
        "matcher": list(matchers),
        "displacement": list(displacements),
        "angle_noise": list(angle_noises),
        "jambs": list(jambs),
        "kind": list(kinds),
        "seed": list(seeds),
    }
    dims = dict.fromkeys(MEASURES, (*SETTINGS, *SCENES))
    dims |= {"true_m": SCENES, "true_perpendicular_m": SCENES, "oracle_f1": ("weight", *SCENES)}
    data = {
        name: np.full([len(coordinates[dim]) for dim in order], np.nan)
        for name, order in dims.items()
    }
    cells = list(product(*(enumerate(coordinates[dim]) for dim in SCENES)))
    for cell in tqdm(cells, desc="scenes", disable=is_headless()):
        here = tuple(place for place, _ in cell)
        displacement, angle, jamb, kind, seed = (value for _, value in cell)
        conditions = Conditions((displacement,) * 2, angle_noise_deg=angle, jambs=jamb)
        found = comparisons(canyon(seed, conditions=conditions), kinds=(kind,))
        for name, values in _scene_values(found, coordinates).items():
            data[name][(..., *here)] = values
    variables = {name: (dims[name], values) for name, values in data.items()}
    return _with_units(xr.Dataset(variables, coordinates))


def bands(values, *, confidence=0.95):
    """Mean over the seeds of a one-dimensional slice, with its scene-bootstrap interval.

    Parameters
    ----------
    values : DataArray
        Dimensions: one of the settings, and ``seed``.

    Returns
    -------
    DataFrame
        The setting, ``mean``, ``low``, ``high``, ``n``.
    """
    (setting,) = [dim for dim in values.dims if dim != "seed"]
    rows = []
    for value in values[setting].to_numpy():
        scenes = values.sel({setting: value}).to_numpy()
        interval = bootstrap(np.nanmean, scenes, confidence=confidence, repeats=500)
        rows.append((value, interval.value, interval.low, interval.high, len(scenes)))
    return pd.DataFrame(rows, columns=[setting, "mean", "low", "high", "n"])


def against(values, *, reference=10.0):
    """Difference of each W from a reference W on the same scenes, with its interval.

    Returns
    -------
    DataFrame
        ``weight``, ``difference``, ``low``, ``high``, ``n``; an interval without zero is a
        difference that the scenes bear out.
    """
    table = bands(values - values.sel(weight=reference))
    return table.rename(columns={"mean": "difference"})


def best_weights(dataset, *, tolerance=0.01):
    """The range of W within ``tolerance`` of the best F1, for each angle noise.

    Parameters
    ----------
    dataset : Dataset
        Of :func:`compute`, with one sensitivity, matcher, displacement and number of jambs.

    Returns
    -------
    DataFrame
        ``angle_noise_deg``, ``best_weight``, ``low_weight``, ``high_weight``, ``f1_best``,
        ``f1_at_10``, ``n``. ``attrs["rule"]``: c of the fitted rule high_weight = c / sigma^2,
        degrees squared; over the noises where the range ends within the sweep.
    """
    f1 = dataset["f1"].mean(["seed", "kind"]).squeeze(drop=True)
    rows = []
    for angle in dataset["angle_noise"].to_numpy():
        curve = f1.sel(angle_noise=angle).to_series()
        good = curve[curve >= curve.max() - tolerance].index
        row = (angle, curve.idxmax(), good.min(), good.max(), curve.max(), curve.loc[10.0])
        rows.append((*row, dataset.sizes["seed"]))
    names = ["angle_noise_deg", "best_weight", "low_weight", "high_weight", "f1_best", "f1_at_10"]
    table = pd.DataFrame(rows, columns=[*names, "n"])
    ends = table[(table["high_weight"] > 0) & (table["high_weight"] < f1["weight"].max().item())]
    logs = np.log(ends["high_weight"] * ends["angle_noise_deg"] ** 2)
    table.attrs["rule"] = float(np.exp(logs.mean())) if len(ends) else np.nan
    return table


def shares(seeds, *, weight, angle_noises, displacement=0.55):
    """Shares of angle, parallel and perpendicular part of the squared distance at true pairs.

    Returns
    -------
    DataFrame
        ``kind``, ``angle_noise_deg``, ``angle``, ``parallel``, ``perpendicular``, ``n`` (pairs).
    """
    rows = []
    for angle in angle_noises:
        conditions = Conditions(bias_m=(displacement,) * 2, angle_noise_deg=angle)
        found = [c for s in seeds for c in comparisons(canyon(s, conditions=conditions))]
        for kind in COMPARISONS:
            sums, pairs = np.zeros(3), 0
            for one in (c for c in found if c.kind == kind):
                parts, _, target, truth = one.directions[0]
                lengths = np.broadcast_to(target.lengths, truth.shape)[truth]
                squares = (weight * parts.angle**2, parts.parallel**2, parts.perpendicular**2)
                sums += [float(lengths @ square[truth]) for square in squares]
                pairs += int(truth.sum())
            rows.append((kind, angle, *(sums / sums.sum()), pairs))
    names = ["kind", "angle_noise_deg", "angle", "parallel", "perpendicular", "n"]
    return pd.DataFrame(rows, columns=names)


def angle_noise(test, model, pairs):
    """Standard deviation of edge directions that the angles of pairs show, degrees.

    The angle between two noisy directions of the same line is Rayleigh distributed; its median
    is 1.1774 standard deviations per axis, and a direction has two axes.
    """
    parts = lines.components(test, model)
    rows, columns = np.nonzero(pairs)
    shorter = np.minimum(test.lengths[rows], model.lengths[columns])
    angles = np.degrees(np.arcsin(np.minimum(parts.angle[rows, columns] / shorter, 1)))
    return float(np.median(angles) / np.sqrt(2 * np.log(2)) * np.sqrt(2))


def _scene_values(found, coordinates):
    """All variables of one scene's comparisons, over the settings."""
    settings = [coordinates[dim] for dim in SETTINGS]
    rows = []
    for weight, sensitivity, matcher in product(*settings):
        peak = partial(lines.peak_threshold, sensitivity=sensitivity)
        each = [measure(c, weight=weight, threshold=peak, matcher=matcher) for c in found]
        rows.append({name: _mean([row[name] for row in each]) for name in MEASURES})
    shape = [len(values) for values in settings]
    values = {name: np.reshape([row[name] for row in rows], shape) for name in MEASURES}
    values["true_m"] = _mean([one.true_length for one in found])
    values["true_perpendicular_m"] = _mean([one.true_perpendicular for one in found])
    values["oracle_f1"] = [
        _mean([oracle_f1(c.directions[0][0].distance(weight), c.truth) for c in found])
        for weight in coordinates["weight"]
    ]
    return values


def _mean(values):
    """Mean of what is measurable, NaN where nothing is."""
    values = np.array(values, dtype=float)
    return values[np.isfinite(values)].mean() if np.isfinite(values).any() else np.nan


def _with_units(dataset):
    """Say the unit of everything."""
    units = {"sensitivity": "m", "displacement": "m", "angle_noise": "degrees"}
    for name in dataset.variables:
        dataset[name].attrs["units"] = units.get(name, "m" if name.endswith("_m") else "1")
    return dataset
