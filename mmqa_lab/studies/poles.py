"""Study 06, poles: streets whose poles are known, the counts of a detector, tables of rates.

After chapter 4 of EuroSDR 2013, Road Environment Mapping using Mobile Laser Scanning: our versions
of its two detectors, a learned one, and any other function of a cloud that returns ``x_m`` and
``y_m``.
"""

from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from mmqa_lab import io, poles, samples, simulate, stats
from mmqa_lab.bench import Comparison, grid
from mmqa_lab.cloud import Cloud
from mmqa_lab.poles import ours
from mmqa_lab.poles.common import joined
from mmqa_lab.published import ledger
from mmqa_lab.simulate import streets
from mmqa_lab.simulate.scan import scan_all
from mmqa_lab.studies import NOTES, SMALL, stated
from mmqa_lab.studies.poles_training import fit, labels

QUICK, TOLD = SMALL["poles"], NOTES["poles"]

CORRIDORS_M = (30.0, 15.0, 12.5)
CLASSES = ("tree", "sign", "lamp", "other")

CHANGES = TOLD["changes"]
"""Changes of the plan by name; all else, the places of all things included, stays."""

SHAFTS_M = {
    "diameter": (0.06, 0.1, 0.15, 0.2, 0.3, 0.45, 0.6, 0.9),
    "height": (1.2, 1.6, 2.0, 2.5, 3.0, 4.0, 6.0, 10.0),
}
"""Bare shafts of :func:`bare_shafts`, m."""

METHODS = {name: partial(poles.detect, method=name) for name in poles.METHODS}
"""The detectors of the package as functions of a cloud."""

PRINTED = {row[:4]: row[4:6] for row in TOLD["printed"]}
"""Printed cell of a rate: method, quantity, corridor in m and class."""

COUNTS = {row[:4]: row[6:] for row in TOLD["printed"] if row[7]}
"""Counts behind the printed rates, and where n comes from; for Table 4-2 none is printed."""


def scene(
    *,
    seed,
    plan="table-4-1",
    scanner="roamer",
    length=100.0,
    speed=30 / 3.6,
    change="as it is",
    share=1.0,
    both_ways=False,
    progress=False,
):
    """Return the cloud of a simulated street, and its truth.

    Parameters
    ----------
    seed : int
    plan, scanner, length, speed
        As for :mod:`mmqa_lab.simulate.streets`, m and m/s.
    change : str
        Of ``CHANGES``.
    share : float
        Share of the pulses that are kept, drawn at random. Targets stay those that the whole cloud
        shows: what a thinner one does not show is missed.
    both_ways : bool
        The street is driven there and back, and both clouds are put together.
    progress : bool
        Show a bar of the drive.

    Returns
    -------
    Cloud, dict
        Truth: ``targets`` (:func:`mmqa_lab.simulate.streets.visible_targets`), ``path`` (m, 3),
        ``street``, ``length_m``, ``poles`` and ``visible`` (their numbers).
    """
    made, cloud, targets = _drive_once(plan, change, scanner, length, speed, seed, progress)
    if both_ways:
        cloud = Cloud.concatenate([cloud, _driven_back(made, scanner, seed, speed)])
    if share < 1:
        cloud = cloud[np.random.default_rng(seed).random(len(cloud)) < share]
    path = made.trajectory(speed).position
    truth = {"targets": targets.copy(), "path": path, "street": made, "length_m": length}
    return cloud, truth | {"poles": len(targets), "visible": targets["visible"].sum()}


def _drive_once(plan, change, scanner, length, speed, seed, progress):
    """Street, cloud and visible targets; the first streets of a run come again and are kept."""
    key = plan, change, scanner, length, speed, seed
    if key in _DRIVES:
        return _DRIVES[key]
    made = streets.street(replace(streets.PLANS[plan], **CHANGES[change]), length=length, seed=seed)
    cloud = streets.drive(made, scanner, seed=seed, speed=speed, progress=progress)
    found = made, cloud, streets.visible_targets(made, cloud)
    if change == "as it is" and len(_DRIVES) < KEPT:
        _DRIVES[key] = found
    return found


_DRIVES, KEPT = {}, 5


def _driven_back(made, scanner, seed, speed):
    """The cloud of a drive the other way; its scan lines are numbered anew."""
    there = made.trajectory(speed)
    turned = {"heading": there.heading + 180.0, "pitch": -there.pitch}
    back = replace(there, position=there.position[::-1].copy(), **turned)
    cloud = scan_all(made.scene, streets.SCANNERS[scanner], back, seed=seed + 1)
    line = cloud["scan_line"] + 1_000_000
    return Cloud(cloud.points, dict(cloud.columns) | {"scan_line": line})


def bare_shafts(scanner="roamer", *, seed):
    """Return the cloud of 64 bare shafts along an empty road, and their truth.

    Parameters
    ----------
    scanner : Scanner or str
        As for :mod:`mmqa_lab.simulate.streets`.
    seed : int
        Of their places.

    Returns
    -------
    Cloud, DataFrame
        ``x_m``, ``y_m``, ``z_base_m``, ``height_m``, ``diameter_m``: eight diameters from 0.06 to
        0.9 m by eight heights from 1.2 to 10 m, 4 to 9 m beside the path.
    """
    rng = np.random.default_rng(seed)
    truth = pd.DataFrame(grid(diameter_m=SHAFTS_M["diameter"], height_m=SHAFTS_M["height"]))
    truth = truth.iloc[rng.permutation(len(truth))].reset_index(drop=True)
    sides = np.where(np.arange(len(truth)) % 2, 1, -1)
    truth["x_m"] = sides * rng.uniform(4, 9, len(truth))
    truth["y_m"] = 15 + np.arange(len(truth)) + rng.uniform(-0.2, 0.2, len(truth))
    truth["z_base_m"] = 0.0
    surfaces = [simulate.ground()]
    for one in truth.itertuples():
        foot = np.array([one.x_m, one.y_m, 0.0])
        surfaces.append(simulate.cylinder(foot, foot + [0, 0, one.height_m], one.diameter_m / 2))
    scanner = streets.SCANNERS[scanner] if isinstance(scanner, str) else scanner
    path = simulate.straight(len(truth) + 30.0, 14.0)
    return scan_all(simulate.Scene(surfaces), scanner, path, seed=seed), truth


def reliability(detections):
    """Return what share of the detections are right, by their score: is it a probability?

    Parameters
    ----------
    detections : DataFrame
        Of :class:`mmqa_lab.poles.Score`, of one or several streets; ignored ones do not count.

    Returns
    -------
    DataFrame
        A row for each fifth of the scores: ``low``, ``high``, ``n``, ``mean_score``, ``right``, the
        share of right ones.
    """
    counted = detections[detections["outcome"].isin(["hit", "false", "duplicate"])]
    fifth = np.minimum((counted["score"] * 5).astype(int), 4)
    made = counted.assign(right=counted["outcome"] == "hit").groupby(fifth)
    table = made.agg(n=("right", "size"), mean_score=("score", "mean"), right=("right", "mean"))
    ends = pd.DataFrame({"low": table.index / 5, "high": (table.index + 1) / 5}, table.index)
    return ends.join(table).reset_index(drop=True)


def counts(found, truth):
    """Return hits, targets and detections within each corridor, and hits and targets by class.

    Parameters
    ----------
    found : DataFrame
        ``x_m``, ``y_m`` and whatever else :func:`mmqa_lab.poles.score` uses.
    truth : dict
        Of :func:`scene`.

    Returns
    -------
    dict of int
        ``hits_30``, ``targets_30``, ``finds_30``, ``tree_hits_30``, ``tree_targets_30``, ...
    """
    numbers = {}
    for corridor in CORRIDORS_M:
        result = poles.score(found, truth["targets"], corridor=corridor, trajectory=truth["path"])
        end = f"{corridor:g}"
        numbers |= {f"hits_{end}": result.recall.k, f"targets_{end}": result.recall.n}
        numbers[f"finds_{end}"] = result.precision.n
        for kind in CLASSES:
            own = result.targets[result.targets["target"] & (result.targets["class"] == kind)]
            numbers |= {f"{kind}_hits_{end}": own["found"].sum()}
            numbers |= {f"{kind}_targets_{end}": len(own)}
    return numbers


def rates(results, by=()):
    """Return recall, precision and F1 of each method, all streets together.

    Parameters
    ----------
    results : xarray.Dataset
        Of :func:`mmqa_lab.bench.run` with :func:`counts`.
    by : str or sequence of str
        Parameters of the cases that get rows of their own.

    Returns
    -------
    DataFrame
        ``method``, the parameters, ``quantity`` (recall, precision, f1), ``corridor_m``, ``class``,
        ``k``, ``n``, ``value``, ``low``, ``high`` (Wilson; F1: bootstrap over streets, NaN for
        one), ``kind``.
    """
    keys = ["method", *([by] if isinstance(by, str) else by)]
    cells = results.drop_vars("failure").to_dataframe().reset_index()
    rows = []
    for key, part in cells.groupby(keys, sort=False):
        for corridor in CORRIDORS_M:
            first = dict(zip(keys, key, strict=True)) | {"corridor_m": corridor}
            rows += [first | row for row in _pooled(part, f"{corridor:g}")]
    return pd.DataFrame(rows).assign(kind="measured")


def _pooled(cells, end):
    """Rates of several streets together."""
    cells = cells.dropna(subset=[f"hits_{end}"])
    total = cells.sum(numeric_only=True).astype(int)
    ends = {"recall": "targets", "precision": "finds"}
    for quantity, n in ends.items():
        rate = stats.wilson(total[f"hits_{end}"], total[f"{n}_{end}"])
        yield {"quantity": quantity, "class": "all", **vars(rate)}
    columns = [f"{name}_{end}" for name in ("hits", "targets", "finds")]
    own = cells[columns].to_numpy()
    spread = stats.bootstrap(_f1, own, repeats=500) if len(own) > 1 else None
    low, high = (spread.low, spread.high) if spread else (np.nan, np.nan)
    counted = {"k": total[f"hits_{end}"], "n": total[f"targets_{end}"]}
    yield {"quantity": "f1", "class": "all", **counted, "value": _f1(own), "low": low, "high": high}
    for kind in CLASSES:
        rate = stats.wilson(total[f"{kind}_hits_{end}"], total[f"{kind}_targets_{end}"])
        yield {"quantity": "recall", "class": kind, **vars(rate)}


def _f1(counted):
    """F1 of rows of hits, targets, detections."""
    hits, targets, finds = counted.sum(axis=0)
    return 2 * hits / (targets + finds) if targets + finds else np.nan


def beside_published(one_way, both_ways):
    """Return every printed rate beside ours.

    Parameters
    ----------
    one_way, both_ways : DataFrame
        Of :func:`rates`; the component method is taken from streets driven both ways, as in the
        report.

    Returns
    -------
    DataFrame
        ``method``, ``quantity``, ``corridor_m``, ``class``, ``published``, ``published_low``,
        ``published_high`` (Wilson), ``published_n`` (where n comes from), ``measured``,
        ``measured_low``, ``measured_high``, and ``table``, ``cell`` of the ledger.
    """
    printed = ledger.cells().query("source == 'eurosdr2013_mls'").set_index(["table", "cell"])
    ours = {"fgi": one_way, "itc": both_ways}
    columns = ["method", "quantity", "corridor_m", "class"]
    rows = []
    for key, place in PRINTED.items():
        mine = ours[key[0]].set_index(columns).loc[key]
        row = dict(zip(columns, key, strict=True))
        row["published"] = printed.loc[place, "value"] / 100
        k, n, source = COUNTS.get(key, (0, 0, "not printed"))
        rate = stats.wilson(k, n)
        row |= {"published_low": rate.low, "published_high": rate.high, "published_n": source}
        row |= {"measured": mine["value"]}
        row |= {"measured_low": mine["low"], "measured_high": mine["high"]}
        rows.append(row | dict(zip(("table", "cell"), place, strict=True)))
    return pd.DataFrame(rows)


def ledger_entries(beside, *, visible, diameters, correctness, crowded):
    """Return the ledger's rows of chapter 4.

    Parameters
    ----------
    beside : DataFrame
        Of :func:`beside_published`.
    visible, correctness, crowded : mmqa_lab.stats.Rate
        Visible poles, facade points among those classed as wall, missed targets with points around.
    diameters : mmqa_lab.stats.Errors
        Of the scan-line method within 12.5 m, mm.

    Returns
    -------
    list of dict
        Of :func:`mmqa_lab.published.ledger.entry`.
    """
    rows = []
    for row in beside.to_dict("records"):
        numbers = [100 * row[name] for name in ("measured", "measured_low", "measured_high")]
        kind, note = ("fitted", "chosen") if row["method"] == "fgi" else ("measured", "other")
        rows.append((row["table"], row["cell"], numbers, kind, note))
    for cell, rate, kind, note in (
        ("visible_share", visible, "fitted", "chosen"),
        ("facade_points_correct", correctness, "measured", "plain"),
        ("missed_points_around", crowded, "measured", "other"),
    ):
        numbers = [100 * value for value in (rate.value, rate.low, rate.high)]
        rows.append(("poles_text", cell, numbers, kind, note))
    for cell, value, unit in (
        ("diameter_rmse", diameters.rmse, 0.1),
        ("diameter_bias", diameters.bias, 1.0),
    ):
        half = 1.96 * diameters.std / np.sqrt(max(diameters.n, 1) * (2 if unit < 1 else 1))
        numbers = [unit * number for number in (value, value - half, value + half)]
        rows.append(("poles_text", cell, numbers, "measured", "perfect"))
    return [
        ledger.entry("eurosdr2013_mls", table, cell, v, low=lo, high=hi, kind=kind, note=TOLD[note])
        for table, cell, (v, lo, hi), kind, note in rows
    ]


NEAR_M = 0.4
"""Points so near to the middle of a detection tell what stands there."""


def outcomes(result):
    """Return the tables of hits, misses and false alarms, duplicates among them, by name."""
    made, targets = result.detections, result.targets
    return {
        "hit": made[made["outcome"] == "hit"],
        "miss": targets[targets["target"] & ~targets["found"]],
        "false alarm": made[made["outcome"].isin(["false", "duplicate"])],
    }


def causes(result, cloud, truth):
    """Return what stands where a method gives a false alarm: what most points nearby are labelled.

    Parameters
    ----------
    result : mmqa_lab.poles.Score
    cloud, truth
        Of :func:`scene`.

    Returns
    -------
    list of str
        One for each false alarm; a second hit on a pole is a ``duplicate``.
    """
    tree, labels = cKDTree(cloud.points), truth["street"].labels[cloud["surface"]]
    found = []
    for one in outcomes(result)["false alarm"].itertuples():
        middle = one.x_m, one.y_m, one.z_base_m + one.height_m / 2
        near = labels[tree.query_ball_point(middle, NEAR_M)]
        kinds, number = np.unique(near, return_counts=True)
        cause = str(kinds[number.argmax()]) if len(near) else "nothing"
        found.append("duplicate" if one.outcome == "duplicate" else cause)
    return found


def crowded(result, cloud):
    """Return how many missed targets have other points around the shaft, a ``Rate``.

    A shaft is crowded where more than 15 % of the points within 0.3 m of its surface, over its
    clear height, belong to something else: what the mask of the scan-line method refuses.
    """
    tree, surface = cKDTree(cloud.points[:, :2]), np.asarray(cloud["surface"])
    missed = outcomes(result)["miss"]
    hidden = 0
    for one in missed.itertuples():
        near = np.array(tree.query_ball_point([one.x_m, one.y_m], one.diameter_base_m / 2 + 0.3))
        rise = cloud.points[near, 2] - one.z_base_m
        near = near[(rise > 0.2) & (rise < one.clear_height_m)]
        hidden += len(near) > 0 and (surface[near] != one.surface).mean() > 0.15
    return stats.wilson(int(hidden), len(missed))


check = stated("poles")


def checks(one_way, both_ways, beside, wider):
    """Yield the statements of the notebook with the numbers of this run.

    Parameters
    ----------
    one_way, both_ways, beside : DataFrame
        Of :func:`rates` and :func:`beside_published`.
    wider : float
        What the scan-line method's recall within 30 m gains from a gate of 1 m instead of 0.5 m.
    """
    value = one_way.set_index(["method", "quantity", "corridor_m", "class"])["value"]
    f1 = {name: value[name, "f1", 30.0, "all"] for name in poles.METHODS}
    yield check(
        "learned",
        f1["ours"] > max(f1["fgi"], f1["itc"]),
        ", ".join(f"{name} F1 {number:.3f}" for name, number in f1.items()),
    )
    trees, lamps = (value["fgi", "recall", 30.0, kind] for kind in ("tree", "lamp"))
    yield check("trees_and_lamps", trees < lamps, f"trees {trees:.2f}, lamp posts {lamps:.2f}")
    near, far = (value["fgi", "precision", reach, "all"] for reach in (12.5, 30.0))
    yield check("corridor", near >= far, f"{near:.2f} within 12.5 m, {far:.2f} within 30 m")
    row = beside.iloc[0]
    yield check(
        "recall",
        row["measured_low"] <= row["published_high"]
        and row["published_low"] <= row["measured_high"],
        f"{row['measured']:.3f}, published {row['published']:.3f}",
    )
    yield check("gate", wider < 0.1, f"recall of the scan-line method rises by {wider:.3f}")


def comparison(quick: bool = False) -> Comparison:
    """Return the study's detectors, streets and tables for ``mmqa bench poles``.

    Parameters
    ----------
    quick : bool
        One short street instead of four.
    """
    seeds, length = ((5001,), 60.0) if quick else ((7341, 7342, 7343, 7344), 100.0)
    cases = grid(plan=["table-4-1"] if quick else ["table-4-1", "facades"], length=length)
    return Comparison(
        cases,
        dict(METHODS),
        scene,
        counts,
        seeds,
        tables=lambda results: {"rates": rates(results, by="plan")},
    )


# Oakland part 2: real streets with labels, without time, trajectory and scan lines

OAKLAND = tuple(
    f"oakland/part2_{part}.laz"
    for part in ("ac", "ad", "ae", "ag", "ah", "ai", "aj", "ak", "al", "ao")
)

POLES = {int(label): name for label, name in TOLD["oakland"].items()}
"""Labels of poles that are asked for."""

UNASKED = (1106, 1109, 1112, 1114, 1115, 1118, 1412)
"""Pole-like, not asked for: support pole, hydrant, pylon, lamp, lights, column."""

UNKNOWN = (1000, 1001, 9999)
"""Points whose class the labels leave open: whether a pole stands there is not known."""


def oakland(tiles=None):
    """Return the cloud of the first or all tiles, shuffled, and its reference poles.

    Points are grouped by class in the files, so that they are shuffled before anything looks at
    them. A reference is a connected component in plan (0.35 m) of points labelled as poles with at
    least 8 points and 1 m of height, placed where its lowest 2 m stand: a board hangs beside its
    post. Pole-like classes that are not asked for, and components of unknown points that could be a
    pole, are ignored.

    Returns
    -------
    Cloud, DataFrame
        The cloud has ``label``; the references ``x_m``, ``y_m``, ``z_base_m``, ``height_m``,
        ``class``, ``points``, ``ignore``.
    """
    whole = Cloud.concatenate(io.read_cloud(samples.real_path(name)) for name in OAKLAND[:tiles])
    whole = whole[np.random.default_rng(0).permutation(len(whole))]
    tables = [_components(whole, labels) for labels in (tuple(POLES), UNASKED, UNKNOWN)]
    asked, unasked, unknown = tables
    asked["ignore"] = small = (asked["points"] < 8) | (asked["height_m"] < 1.0)
    unknown = unknown[(unknown["points"] >= 8) & (unknown["height_m"] >= 1.0)]
    rest = pd.concat([unasked, unknown]).assign(ignore=True)
    return whole, pd.concat([asked.assign(ignore=small), rest], ignore_index=True)


def leave_one_block_out(whole, references, blocks=10):
    """Return the poles of a real cloud by trees that learned from its other blocks alone.

    Parameters
    ----------
    whole, references
        Of :func:`oakland`.
    blocks : int
        Of equally many candidates, from west to east.

    Returns
    -------
    DataFrame
        As of :func:`mmqa_lab.poles.detect`.
    """
    origin = np.floor(whole.points.min(axis=0))
    local, settings = whole.points - origin, ours.Settings()
    where = ours.described(local, settings)
    features, axes, _ = where
    upright = dict.fromkeys(("lean_x", "lean_y", "diameter_base_m"), 0.0)
    truth = references.assign(**upright, visible=~references["ignore"])
    label, _ = labels(axes + np.pad(origin[:2], (0, 6)), truth)
    block = np.argsort(np.argsort(axes[:, 0])) * blocks // len(axes)
    probability = np.empty(len(axes))
    for number in range(blocks):
        other = (block != number) & (label >= 0)
        model = fit(features[other], label[other], block[other], rounds=300)
        probability[block == number] = model.predict(features[block == number])
    found = ours.judged(local, where, probability, settings)
    return found.assign(x_m=found["x_m"] + origin[0], y_m=found["y_m"] + origin[1])


def _components(whole, labels):
    """One row for each connected component in plan of the points with these labels."""
    chosen = whole[np.isin(whole["label"], labels)]
    points = chosen.points
    pairs = cKDTree(points[:, :2]).query_pairs(0.35, output_type="ndarray")
    frame = pd.DataFrame(points, columns=["x", "y", "z"]).assign(label=chosen["label"])
    frame["part"] = joined(*pairs.T, len(points))
    grouped = frame.groupby("part")
    base = grouped["z"].transform("min")
    foot = frame[frame["z"] <= base + 2.0].groupby("part")
    return pd.DataFrame(
        {
            "x_m": foot["x"].median(),
            "y_m": foot["y"].median(),
            "z_base_m": grouped["z"].min(),
            "height_m": grouped["z"].max() - grouped["z"].min(),
            "class": grouped["label"].agg(lambda label: POLES.get(label.mode().iloc[0], "unasked")),
            "points": grouped.size(),
        }
    )
