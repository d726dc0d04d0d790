"""Study 06, poles: streets with known poles, counts of detections, tables of rates.

The study follows chapter 4 of EuroSDR 2013, Road Environment Mapping using Mobile Laser Scanning.
It compares its two detectors, a learned detector, and any other function of a cloud that returns
``x_m`` and ``y_m``.
"""

from dataclasses import replace
from functools import lru_cache, partial

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree
from scipy.stats import binomtest, siegelslopes

from mmqa_lab import io, poles, samples, stats
from mmqa_lab.bench import Comparison, cell_table, remarked
from mmqa_lab.cloud import Cloud
from mmqa_lab.poles import learned
from mmqa_lab.poles.common import joined
from mmqa_lab.published import ledger
from mmqa_lab.simulate import streets
from mmqa_lab.simulate.scan import scan

__all__ = [
    "ASKED", "CLASSES", "CORRIDORS_M", "LABELS", "METHODS", "OAKLAND", "PARTS", "PRINTED", "PUBLIC",
    "above_chosen", "bench", "beside_published", "counts", "crowded", "differences", "f1",
    "oakland", "outcomes", "paired", "public_poles", "rates", "scene",
]  # fmt: skip

CORRIDORS_M = (30.0, 15.0, 12.5)
CLASSES = ("tree", "sign", "lamp", "other")

METHODS = {name: partial(poles.detect, method=name) for name in poles.METHODS}
"""The detectors of the package as functions of a cloud."""

LABELS = (
    "clean run (m)", "clean run of\na 15 cm core (m)", "clean run of\na 40 cm core (m)",
    "radius of the core (m)", "foot of the run (m)", "run, whatever is\naround it (m)",
    "log of the core's\npoints a metre", "share of the 2 m above\nwith a shell of points",
    "share of the plan with\npoints above the run", "share of the run with\npoints beside it",
    "log of the points\nwithin 0.7 m", "distance from what\nstands beside (m)",
    "radius of the circle (m)", "misfit of the circle\nby its radius",
    "share of the circle's\ndirections with points", "length of the run\nby the diameter",
    "width of the head\nby that below", "highest bin (m)", "share around with\npoints, up to 1 m",
    "share around with\npoints, 1 to 2.5 m", "share around with\npoints, 2.5 to 5 m",
    "share around with\npoints, above 5 m", "extent in plan (m)", "height by the extent",
)  # fmt: skip
LABELS = dict(zip(learned.MEASURES, LABELS, strict=True))
"""The measures of the learned detector as labels of axes."""

SEEDS = range(7341, 7349)
"""Streets of the study; the trees of the learned detector are grown on other streets."""

INFERRED = "found targets over the rate: inferred"
PRINTED = (
    ("fgi", "recall", 30.0, "all", "FGI detection_rate 30 m", 230, 330, "Lehtomaki et al. 2011"),
    ("fgi", "recall", 12.5, "all", "FGI detection_rate 12.5 m", 136, 190, "printed"),
    ("fgi", "precision", 30.0, "all", "FGI correct_detections 30 m", 230, 266, INFERRED),
    ("fgi", "precision", 12.5, "all", "FGI correct_detections 12.5 m", 136, 143, INFERRED),
    ("fgi", "recall", 30.0, "tree", "rate_trees", 75, 127, "printed"),
    ("fgi", "recall", 30.0, "sign", "rate_signs", 65, 79, "printed"),
    ("fgi", "recall", 30.0, "lamp", "rate_lamp_posts", 44, 46, "printed"),
    ("itc", "recall", 15.0, "all", "ITC detection_rate 15 m", 0, 0, "not printed"),
    ("itc", "precision", 15.0, "all", "ITC correct_detections 15 m", 0, 0, "not printed"),
)
"""Printed rates: method, quantity, corridor (m), class, cell, counts k and n, their source."""


@lru_cache(maxsize=12)
def _driven(seed, plan, scanner, length, speed):
    """A street, its trajectory and its cloud."""
    made = streets.street(plan, length=length, seed=seed)
    cloud = streets.drive(made, scanner, seed=seed, speed=speed)
    return made, made.trajectory(speed), cloud


def scene(
    *, seed, plan="table-4-1", scanner="roamer", length=100.0, speed=30 / 3.6, both_ways=False
):
    """Return the cloud of a simulated street, and its truth; the last twelve streets are kept.

    Parameters
    ----------
    seed : int
        Seed of the street and of the scan.
    plan, scanner, length, speed
        As for :mod:`mmqa_lab.simulate.streets`, m and m/s.
    both_ways : bool
        The street is driven in both directions, and both clouds are merged.

    Returns
    -------
    Cloud, dict
        Truth: ``targets`` (:func:`mmqa_lab.simulate.streets.visible_targets`), ``path`` (m, 3),
        ``street``, ``poles`` and ``visible`` (their numbers).
    """
    made, there, cloud = _driven(seed, plan, scanner, length, speed)
    targets = streets.visible_targets(made, cloud)
    if both_ways:
        turned = {"heading": there.heading + 180.0, "pitch": -there.pitch}
        back = replace(there, position=there.position[::-1].copy(), **turned)
        again = scan(made.scene, streets.SCANNERS[scanner], back, seed=seed + 1)
        columns = dict(again.columns) | {"scan_line": again["scan_line"] + 1_000_000}
        cloud = Cloud.concatenate([cloud, Cloud(again.points, columns)])
    truth = {"targets": targets, "path": there.position, "street": made}
    return cloud, truth | {"poles": len(targets), "visible": targets["visible"].sum()}


def counts(found, truth):
    """Return hits, targets and detections within each corridor, and hits and targets by class.

    Parameters
    ----------
    found : DataFrame
        ``x_m``, ``y_m`` and the optional columns of :func:`mmqa_lab.poles.score`.
    truth : dict
        From :func:`scene`.

    Returns
    -------
    dict of int
        ``hits_30``, ``targets_30``, ``finds_30``, ``tree_hits_30``, ``tree_targets_30``, ...
    """
    numbers = {}
    for corridor in CORRIDORS_M:
        result = poles.score(found, truth["targets"], corridor=corridor, trajectory=truth["path"])
        end, targets = f"{corridor:g}", result.targets[result.targets["target"]]
        numbers |= {f"hits_{end}": result.recall.k, f"targets_{end}": result.recall.n}
        numbers[f"finds_{end}"] = result.precision.n
        for kind in CLASSES:
            own = targets.loc[targets["class"] == kind, "found"]
            numbers |= {f"{kind}_hits_{end}": own.sum(), f"{kind}_targets_{end}": len(own)}
    return numbers


def rates(results):
    """Return recall, precision and F1 of each method over all streets.

    Parameters
    ----------
    results : xarray.Dataset
        Results of :func:`bench`.

    Returns
    -------
    DataFrame
        ``method``, ``quantity`` (recall, precision, f1), ``corridor_m``, ``class``, ``k``, ``n``,
        ``value``, ``low``, ``high``: 95 % intervals (Wilson; for F1 a bootstrap over streets, NaN
        for a single street).
    """
    kinds = ("hits", "targets", *(f"{kind}_{of}" for kind in CLASSES for of in ("hits", "targets")))
    counts = [f"{name}_{corridor:g}" for name in (*kinds, "finds") for corridor in CORRIDORS_M]
    rows, cells = [], cell_table(results).reindex(columns=["method", *counts])
    for method, streets_of in cells.groupby("method", sort=False):
        for corridor in CORRIDORS_M:
            first = {"method": method, "corridor_m": corridor}
            rows += [first | row for row in _pooled(streets_of, f"{corridor:g}")]
    return remarked(pd.DataFrame(rows), results)


def _pooled(cells, end):
    """Yield the rates of several streets together."""
    cells = cells.dropna(subset=[f"hits_{end}"])
    total = cells.sum(numeric_only=True).astype(int)

    def rate(quantity, kind, hits, of):
        found = stats.wilson(total[f"{hits}_{end}"], total[f"{of}_{end}"])
        return {"quantity": quantity, "class": kind} | vars(found)

    yield rate("recall", "all", "hits", "targets")
    yield rate("precision", "all", "hits", "finds")
    own = cells[[f"{name}_{end}" for name in ("hits", "targets", "finds")]].to_numpy()
    nothing = stats.Interval(np.nan, np.nan, np.nan)
    spread = stats.bootstrap(f1, own, repeats=500) if len(own) else nothing
    yield rate("f1", "all", "hits", "targets") | vars(spread)
    for kind in CLASSES:
        yield rate("recall", kind, f"{kind}_hits", f"{kind}_targets")


def differences(results, first, *, corridor=30.0):
    """Return F1 of one method less that of each other on the same streets.

    Parameters
    ----------
    results : xarray.Dataset
        Results of :func:`bench`.
    first : str
        The method.
    corridor : float
        One of ``CORRIDORS_M``.

    Returns
    -------
    DataFrame
        ``other``, ``less`` and its 95 % interval ``low``, ``high``, a bootstrap over streets (NaN
        for a single street), and ``streets``, their number.
    """
    names = [f"{name}_{corridor:g}" for name in ("hits", "targets", "finds")]
    cells = cell_table(results).groupby("method", sort=False)[names]
    counted = {method: own.to_numpy() for method, own in cells}

    def less(rows):
        return f1(rows[:, :3]) - f1(rows[:, 3:])

    rows = []
    for other in [method for method in counted if method != first]:
        both = np.hstack([counted[first], counted[other]])
        spread = stats.bootstrap(less, both, repeats=500)
        rows.append({"other": other, "less": spread.value, "low": spread.low, "high": spread.high})
    return pd.DataFrame(rows).assign(streets=results.sizes["seed"])


def f1(counted):
    """Return F1 of rows (n, 3) of hits, targets and detections; NaN if all are zero."""
    hits, targets, finds = counted.sum(axis=0)
    return 2 * hits / (targets + finds) if targets + finds else np.nan


def bench(*, methods=None, seeds=SEEDS, **conditions):
    """Define the study's bench: detectors on simulated streets.

    Parameters
    ----------
    methods : dict, optional
        Functions of a cloud that return a table with ``x_m`` and ``y_m``; by default ``METHODS``.
    seeds : iterable of int
        Each seed gives a street.
    **conditions
        Conditions of :func:`scene`, a single value for each.

    Returns
    -------
    Comparison
    """
    methods, tables = dict(methods or METHODS), lambda results: {"rates": rates(results)}
    return Comparison([conditions], methods, scene, counts, seeds, tables=tables)


def beside_published(one_way, both_ways):
    """Return every printed rate beside the measured rate.

    Parameters
    ----------
    one_way, both_ways : DataFrame
        From :func:`rates`. The component method is taken from streets driven in both directions, as
        in the report.

    Returns
    -------
    DataFrame
        ``method``, ``quantity``, ``corridor_m``, ``class``, ``cell`` and ``table`` of the ledger,
        ``published`` with the Wilson interval of its counts and the source of ``n``,
        ``measured`` with its interval.
    """
    keys = ["method", "quantity", "corridor_m", "class"]
    rows = pd.DataFrame(PRINTED, columns=[*keys, "cell", "k", "n", "published_n"])
    printed = [stats.wilson(k, n) for k, n in zip(rows.pop("k"), rows.pop("n"), strict=True)]
    rows["published_low"] = [rate.low for rate in printed]
    rows["published_high"] = [rate.high for rate in printed]
    cells = ledger.cells().query("source == 'eurosdr2013_mls'")[["table", "cell", "value"]]
    rows = rows.merge(cells, on="cell")
    rows["published"] = rows.pop("value") / 100
    ours = pd.concat([one_way.query("method == 'fgi'"), both_ways.query("method == 'itc'")])
    names = {"value": "measured", "low": "measured_low", "high": "measured_high"}
    return rows.merge(ours[[*keys, *names]].rename(columns=names), on=keys)


def outcomes(result):
    """Return the tables of hits, misses and false alarms, duplicates among them, by name."""
    made, targets = result.detections, result.targets
    found = {"hit": made[made["outcome"] == "hit"]}
    found["miss"] = targets[targets["target"] & ~targets["found"]]
    return found | {"false alarm": made[made["outcome"].isin(["false", "duplicate"])]}


def paired(one, other):
    """Return the targets that only one of two scores of the same references found, and p.

    Parameters
    ----------
    one, other : Score

    Returns
    -------
    dict
        ``only_one``, ``only_other``; ``p``: how often such a difference or a larger one comes by
        chance if both find alike (McNemar's exact test; 1 where they find the same).
    """
    target = one.targets["target"] & other.targets["target"]
    first, second = (score.targets.loc[target, "found"] for score in (one, other))
    only = int((first & ~second).sum()), int((second & ~first).sum())
    p = binomtest(only[0], sum(only)).pvalue if sum(only) else 1.0
    return {"only_one": only[0], "only_other": only[1], "p": float(p)}


def crowded(result, cloud):
    """Return the share of missed targets with other points around the shaft, as a ``Rate``.

    A shaft is crowded if more than 15 % of the points within 0.3 m of its surface, over its clear
    height, belong to something else. The mask of the scan-line method rejects such shafts.
    """
    tree, surface = cKDTree(cloud.points[:, :2]), np.asarray(cloud["surface"])
    missed, hidden = outcomes(result)["miss"], 0
    for pole in missed.itertuples():
        near = tree.query_ball_point([pole.x_m, pole.y_m], pole.diameter_base_m / 2 + 0.3)
        near = np.array(near, dtype=int)
        rise = cloud.points[near, 2] - pole.z_base_m
        near = near[(rise > 0.2) & (rise < pole.clear_height_m)]
        hidden += len(near) > 0 and (surface[near] != pole.surface).mean() > 0.15
    return stats.wilson(int(hidden), len(missed))


# Oakland part 2: real streets with labels, but without time, trajectory and scan lines

PARTS = ("ac", "ad", "ae", "ag", "ah", "ai", "aj", "ak", "al", "ao")
OAKLAND = tuple(f"oakland/part2_{part}.laz" for part in PARTS)

ASKED = (1103, 1107, 1110, 1111, 1116, 1119, 1302, 1303)
"""Utility pole, lamp support, post, sign, traffic light support, parking meter, trunks."""

UNASKED = (1106, 1109, 1112, 1114, 1115, 1118, 1412)
"""Pole-like classes that are no references: support pole, hydrant, pylon, lamp, lights, column."""

UNKNOWN = (1000, 1001, 9999)
"""Labels of unknown class: such points may or may not belong to a pole."""


def oakland(tiles=None):
    """Return the cloud of the first or all tiles, shuffled, and its reference poles.

    Points are grouped by class in the files, so they are shuffled first. A reference is a connected
    component in plan (0.35 m) of points labelled as poles, with 8 points and 1 m of height at
    least. It passes through the median of its lowest 2 m, since a board hangs beside its post. It
    leans as its points do (repeated medians, Siegel 1982) if it is higher than 4 m. Other pole-like
    classes, and components of unknown points that could be a pole, are ignored.

    Parameters
    ----------
    tiles : int, optional
        Number of tiles; all by default.

    Returns
    -------
    Cloud, DataFrame
        References: ``x_m``, ``y_m``, ``z_base_m``, ``height_m``, ``points``, ``lean_x``,
        ``lean_y``, ``ignore``, ``visible``.
    """
    whole = Cloud.concatenate(io.read_cloud(samples.real_path(name)) for name in OAKLAND[:tiles])
    whole = whole[np.random.default_rng(0).permutation(len(whole))]
    asked, unasked, unknown = (_components(whole, labels) for labels in (ASKED, UNASKED, UNKNOWN))
    small = (asked["points"] < 8) | (asked["height_m"] < 1.0)
    unknown = unknown[(unknown["points"] >= 8) & (unknown["height_m"] >= 1.0)]
    parts = [asked.assign(ignore=small), unasked.assign(ignore=True), unknown.assign(ignore=True)]
    references = pd.concat(parts, ignore_index=True)
    return whole, references.assign(visible=~references["ignore"])


def _components(whole, labels):
    """One row per connected component in plan of the points with the given labels."""
    points = whole.points[np.isin(whole["label"], labels)]
    pairs = cKDTree(points[:, :2]).query_pairs(0.35, output_type="ndarray")
    frame = pd.DataFrame(points, columns=["x_m", "y_m", "z"])
    frame["part"] = joined(*pairs.T, len(points))
    heights = frame.groupby("part")["z"].agg(z_base_m="min", top="max", points="size")
    low = frame[frame["z"] <= frame["part"].map(heights["z_base_m"]) + 2.0]
    table = low.groupby("part")[["x_m", "y_m", "z"]].median().join(heights)
    table["height_m"] = table.pop("top") - table["z_base_m"]
    leans = [_lean(own) for _, own in frame.groupby("part")]
    table[["lean_x", "lean_y"]] = np.reshape(leans, (-1, 2))
    rise = table["z_base_m"] + table["height_m"] / 2 - table.pop("z")
    for axis in "xy":
        table[f"{axis}_m"] += rise * table[f"lean_{axis}"]
    return table


def _lean(component):
    """Lean (2,) of a component higher than 4 m; 0 if an arm draws it farther than poles lean."""
    if np.ptp(component["z"]) < 4.0:
        return 0.0, 0.0
    lean = [siegelslopes(component[axis], component["z"])[0] for axis in ("x_m", "y_m")]
    return lean if np.hypot(*lean) < 0.1 else (0.0, 0.0)


def above_chosen(finds, references):
    """Return the finds of both halves of a street above a threshold that was chosen on the other.

    Parameters
    ----------
    finds : DataFrame
        With a low threshold: ``x_m``, ``y_m``, ``score``.
    references : DataFrame
        As :func:`oakland` returns them; their median ``x_m`` parts the halves. The threshold of a
        half is the one with the highest F1 there, of .05, .1, .15 and so on.

    Returns
    -------
    DataFrame
    """
    middle, kept = references["x_m"].median(), []
    for west in (True, False):
        own, known = ((part["x_m"] < middle) == west for part in (finds, references))
        rated = {
            least: poles.score(finds[own & (finds["score"] >= least)], references[known]).f1
            for least in np.arange(0.05, 0.75, 0.05)
        }
        kept.append(finds[~own & (finds["score"] >= max(rated, key=rated.get))])
    return pd.concat(kept)


PUBLIC = ("pole_street_a", "pole_street_b", "street_tree_a", "street_tree_b")
"""Public clouds with known poles: two tiles with a list of lamps, signs, trees, and two stems."""


def public_poles(names=PUBLIC, methods=("itc", "learned")):
    """Return how many known poles of the public clouds each method finds.

    Parameters
    ----------
    names : sequence of str
        Those of ``PUBLIC`` that ``samples.fetch`` has brought, ``pole_street_list`` with them.
    methods : sequence of str
        Names of detectors.

    Returns
    -------
    DataFrame
        ``cloud``, ``method``, ``k`` found of ``n`` known, ``value``, ``low``, ``high`` (Wilson),
        and ``others``, the finds that are not listed: the lists need not be complete.
    """
    rows = []
    for name in names:
        cloud = io.read_cloud(samples.real_path(name), columns=())
        plan = pd.DataFrame(cloud.points[:, :2], columns=["x_m", "y_m"])
        known = plan.median().to_frame().T  # of a cloud that is one stem
        if name.startswith("pole_street"):
            known = pd.read_csv(samples.real_path("pole_street_list"))
            known = known.rename(columns={"x": "x_m", "y": "y_m"})[["x_m", "y_m"]]
            known = known[((known >= plan.min()) & (known <= plan.max())).all(axis=1)]
        for method in methods:
            score = poles.score(poles.detect(cloud, method=method), known)
            row = {"cloud": name, "method": poles.METHODS[method], **vars(score.recall)}
            rows.append(row | {"others": score.precision.n - score.precision.k})
    return pd.DataFrame(rows)
