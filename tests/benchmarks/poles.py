"""Rates of the learned detector on streets that it never saw, and what five million points take.

``python tests/benchmarks/poles.py`` writes the tables into RESULTS.md; ``--streets N`` takes the
first N of each row and writes nothing. ``MMQA_DATA`` names the real street. ``--calibration`` only
fits ``poles_training.CALIBRATION`` again, to scores that have it already: 0, 1, 0 confirm it.
``--versions`` prints the table of four versions, the last of which is measured now.
"""

import argparse
import re
import sys
import time
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd

from mmqa_lab import poles, samples, simulate, stats
from mmqa_lab.cloud import Cloud
from mmqa_lab.poles import learned
from mmqa_lab.simulate import streets, surfaces
from mmqa_lab.simulate.scan import scan
from mmqa_lab.simulate.systems import PRESETS
from mmqa_lab.studies import poles as study

sys.path.insert(0, str(Path(__file__).parents[1]))
import built_street
import gated_street
import other_street
from results import write_section

BEAMS = replace(PRESETS["hdl-32e"], lever_arm_m=(0.0, 0.0, 2.2))
SCANNERS = {"profiler": streets.SCANNERS["roamer"], "32 beams": BEAMS}
BARE = [(d, h) for d in (0.06, 0.1, 0.15, 0.2, 0.3, 0.45, 0.6, 0.9) for h in
        (1.2, 1.6, 2.0, 2.5, 3.0, 4.0, 6.0, 10.0)]  # fmt: skip
KINDS = (
    *("leaning", "conical", "square", "double"),
    *("with boards", "with a box", "in a hedge", "cut at 2 m"),
)
WALLS = ("before a higher wall", "before a wall of 3 m")


def own(seed):
    """A street of the generator of the training: cloud, targets, path."""
    cloud, truth = study.scene(seed=seed, length=80.0)
    return cloud, truth["targets"], truth["path"]


def other(seed, scanner="tilted profiler", **choices):
    """A street of the tests' own generator."""
    made = other_street.make(seed, **choices)
    points, seconds, line, pole, path = other_street.scan(made, scanner, seed)
    cloud = Cloud(points, {"scan_line": line, "gps_time": seconds})
    return cloud, other_street.tables(made, pole)[0], path, made


def posts(kind, scanner, seed, n=30):
    """Posts of one kind along an empty road: cloud, truth."""
    rng = np.random.default_rng([seed, 5])
    things, rows = [surfaces.ground(size=(400.0, 400.0))], []
    sizes, step = rng.uniform([0.06, 2.0], [0.3, 5.0], (n, 2)), 3.0
    if kind == "bare":
        sizes, step = rng.permutation(BARE), 1.0
    for k, (wide, height) in enumerate(sizes):
        side, draw = 1 if k % 2 else -1, rng.uniform
        foot = np.array([side * draw(4, 9), 15 + step * k + draw(-0.2, 0.2), 0.0])
        lean, turn = np.zeros(2), draw(0, 2 * np.pi)
        if kind == "leaning":
            lean = np.tan(np.radians(draw(5, 10))) * np.array([np.cos(turn), np.sin(turn)])
        way = height * np.array([*lean, 1.0])
        top = wide / 2 * (0.4 if kind == "conical" else 1.0)
        row = {"x_m": foot[0] + way[0] / 2, "y_m": foot[1] + way[1] / 2, "z_base_m": 0.0}
        row |= {"height_m": min(height, 2.0) if kind == "cut at 2 m" else height}
        row |= {"lean_x": lean[0], "lean_y": lean[1]}
        rows.append(row | {"diameter_base_m": wide, "diameter_top_m": 2 * top})
        if kind == "square":
            things.append(surfaces.box(foot, (wide, wide, height), heading=draw(0, 90)))
        else:
            things.append(surfaces.cylinder(foot, foot + way, wide / 2, top_radius=top))
        if kind == "double":  # two posts of one sign
            beside = foot + [0, 0.8, 0]
            rows.append(rows[-1] | {"y_m": rows[-1]["y_m"] + 0.8})
            things.append(surfaces.cylinder(beside, beside + way, wide / 2))
        if kind == "with a box":
            middle = foot + [0, wide / 2 + 0.12, 1.0]
            things.append(surfaces.box(middle, (0.3, 0.2, 0.5), heading=0.0))
        if kind == "with boards":
            size = draw(0.4, 0.7)
            middle = foot + [0, wide / 2 + 0.03, height - size / 2]
            things.append(surfaces.board(middle, size, size, heading=0.0))
        if kind == "in a hedge":
            leaves, middle = int(rng.integers(2**31)), foot + [0, 0, 0.5]
            things.append(streets.crown(middle, (0.4, 1.2, 0.6), 4.0, leaves))
        if kind in WALLS:
            rise = height + draw(0.5, 2.0) if kind == WALLS[0] else 3.0
            corner = foot + [side * (0.5 + wide / 2), -1.4, 0]
            things.append(surfaces.rectangle(corner, (0, 2.8, 0), (0, 0, rise)))
    path = simulate.straight(30 + step * len(sizes), 14.0)
    cloud = scan(simulate.Scene(things), SCANNERS[scanner], path, seed=seed)
    if kind == "cut at 2 m":
        cloud = cloud[cloud.points[:, 2] < 2]
    return cloud, pd.DataFrame(rows)


def with_real_lessons():
    """Score of the real street, each half by trees that learned from the other half as well."""
    cloud, references = study.oakland()
    middle, found = np.median(references["x_m"]), []
    for west in (True, False):
        own, named = ((part < middle) == west for part in (cloud.points[:, 0], references["x_m"]))
        measures, label, _ = learned.lessons(cloud.points[own], references[named])
        trees = learned.grow(measures, label, start=learned.shipped(), rounds=30)
        found.append(poles.detect(cloud.points[~own], trees=trees))
    return poles.score(pd.concat(found), references)


def rated(count):
    """Yield the row, what was asked for, and the score of each street."""
    scored = partial(poles.score, corridor=30)
    for seed in range(8201, 8225)[:count]:
        cloud, targets, path = own(seed)
        yield "own streets", scored(poles.detect(cloud), targets, trajectory=path)
    rows = {"nominal": {}, "many cars and people": {"clutter": 8}, "32 beams": {}}
    for number, (row, choices) in enumerate(rows.items()):
        scanner = "32 beams" if row == "32 beams" else "tilted profiler"
        for seed in range(321 + 10 * number, 331 + 10 * number)[:count]:
            cloud, targets, path, _ = other(seed, scanner, **choices)
            yield f"other streets, {row}", scored(poles.detect(cloud), targets, trajectory=path)
    for seed in range(351, 359)[:count]:
        cloud, targets, path, made = other(seed, porches=True)
        found = poles.detect(cloud)
        yield "other streets, porches", scored(found, targets, trajectory=path)
        columns = pd.DataFrame(np.array(made.columns)[:, :2], columns=["x_m", "y_m"])
        yield "their columns found as poles", poles.score(found, columns)
    for number, name in enumerate(("tilted profiler", "32 beams", "64 beams")):
        for seed in range(1071 + 10 * number, 1075 + 10 * number)[:count]:
            points, *_, targets, path, made = gated_street.looked_at(seed, name)
            found = poles.detect(points)
            yield f"gates and wires, {name}", scored(found, targets, trajectory=path)
            feet = pd.DataFrame(np.array(made.pillars)[:, :2], columns=["x_m", "y_m"])
            yield "their pillars found as poles", poles.score(found, feet)
        for seed in range(661 + 10 * number, 665 + 10 * number)[:count]:
            points, targets, path, _ = built_street.looked_at(seed, name)
            yield (
                f"shelters and arcades, {name}",
                scored(poles.detect(points), targets, trajectory=path),
            )
    for name in SCANNERS:
        for kind in ("bare", *KINDS, *WALLS):
            cloud, truth = posts(kind, name, 8301)
            truth["visible"] = truth["height_m"] >= learned.SLENDER * truth["diameter_base_m"]
            yield f"posts {kind}, {name}", poles.score(poles.detect(cloud), truth)
    if samples.has_real(study.OAKLAND[0]):
        cloud, references = study.oakland()
        yield (
            "real street, trees of simulated streets",
            poles.score(poles.detect(cloud), references),
        )
        yield "real street, with lessons of its other half", with_real_lessons()


OLDER = (
    ("0.2", "", "", 0.748, 0.46),
    ("0.3", "121/158, 121/137", "143/144, 143/315", 0.714, 0.48),
    ("0.4", "104/158, 104/114", "143/144, 143/159", 0.621, 0.74),
)
"""Of older versions: right of asked and of found on the real street and on streets with gates, as
their releases were run; F1 of 122 real poles elsewhere and precision on somebody else's streets
full of things that look like poles, as printed. Nothing of 0.2 was measured here."""


def versions():
    """Four versions on the real street and on streets with gates, the last measured now."""
    gates = []
    for number, name in enumerate(("tilted profiler", "32 beams", "64 beams")):
        for seed in range(1071 + 10 * number, 1075 + 10 * number):
            points, *_, targets, path, _ = gated_street.looked_at(seed, name)
            found = poles.detect(points)
            gates.append(poles.score(found, targets, corridor=30, trajectory=path))
    cloud, references = study.oakland()
    told = []
    for scores in ([poles.score(poles.detect(cloud), references)], gates):
        row = row_of("", scores)
        told.append(f"{row['right / asked']}, {row['right / found']}")
    names = ["version", "real street", "gates", "122 real poles: F1 (printed)",
             "look-alikes: precision (printed)"]  # fmt: skip
    return pd.DataFrame([*OLDER, ("now", *told, np.nan, np.nan)], columns=names)


BANDS = (learned.THRESHOLD, 0.5, 0.7, 0.9, 0.97, 1.0)


def score_bands(rows):
    """Share of right finds in bands of the score: streets of three generators, the real one."""
    for kind in ("other streets", "shelters", "gates", "real street, trees"):
        scores = [score for name, own in rows.items() if name.startswith(kind) for score in own]
        if not scores:
            continue
        finds = pd.concat([score.detections for score in scores])
        finds = finds[~finds["outcome"].isin(["ignored", "outside"])]
        for band, own in finds.groupby(pd.cut(finds["score"], BANDS), observed=True):
            right = stats.wilson(int((own["outcome"] == "hit").sum()), len(own))
            yield {"on": kind, "score": str(band), "mean": f"{own['score'].mean():.2f}",
                   "right": str(right)}  # fmt: skip


def changed():
    """Shares of finds that change if gated streets are turned, or thinned to every second point."""
    turn, totals = np.radians(31), np.zeros((2, 2))
    plan = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    for seed, name in ((1075, "tilted profiler"), (1085, "32 beams"), (1095, "64 beams")):
        points, *_ = gated_street.looked_at(seed, name)
        found = poles.detect(points)[["x_m", "y_m"]].to_numpy()
        turned = poles.detect(np.column_stack([points[:, :2] @ plan, points[:, 2]]))
        thinned = poles.detect(points[::2])[["x_m", "y_m"]].to_numpy()
        others = turned[["x_m", "y_m"]].to_numpy() @ plan.T, thinned
        for k, other in enumerate(others):
            away = np.hypot(*(found[:, None] - other).transpose(2, 0, 1))
            lost = (away.min(axis=1) > 0.3).sum() + (away.min(axis=0) > 0.3).sum()
            totals[k] += lost, len(found) + len(other)
    share = totals[:, 0] / totals[:, 1]
    return {"finds": int(totals[0, 1] / 2), "turned by 31 degrees": f"{share[0]:.3f}",
            "every second point": f"{share[1]:.3f}"}  # fmt: skip


def calibrating():
    """Yield points, targets and path of the streets on which scores are calibrated."""
    names = ("tilted profiler", "32 beams", "64 beams", "16 beams")
    for k in range(24):
        points, targets, path, _ = built_street.looked_at(601 + k, names[k % 3])
        yield points, targets, path
    for k in range(8):
        made = other_street.make(401 + k, 30.0, clutter=6, porches=k % 2 == 0)
        points, *_, pole, path = other_street.scan(made, names[k % 4], 401 + k)
        targets = other_street.tables(made, pole)[0]
        yield points, targets.assign(visible=targets["points"] >= 15), path


def correction():
    """Logistic regression of right finds on their log odds and ``points``, as CALIBRATION."""
    rows = []
    for k, (points, targets, path) in enumerate(calibrating()):
        for keep in (1, 0.3, 0.1):
            part = points[np.random.default_rng(k).random(len(points)) < keep]
            every = poles.detect(part, threshold=0.05, explain=True)
            found = poles.score(every[every["rejected_by"] == ""], targets, corridor=30,
                                trajectory=path).detections  # fmt: skip
            rows.append(found[found["outcome"].isin(["hit", "false"])])
    rows = pd.concat(rows)
    right, odds = (rows["outcome"] == "hit").to_numpy(float), np.log(1 / rows["score"] - 1)
    x, fitted = np.column_stack([np.ones(len(rows)), -odds, rows["points"] - 3]), np.zeros(3)
    for _ in range(30):  # Newton's steps
        p = 1 / (1 + np.exp(-x @ fitted))
        fitted += np.linalg.solve((x * (p * (1 - p))[:, None]).T @ x, x.T @ (right - p))
    return fitted.round(3)


def row_of(name, results):
    """A row of rates of some streets together."""
    k, asked = sum(r.recall.k for r in results), sum(r.recall.n for r in results)
    made = sum(r.precision.n for r in results)
    spread = f1_interval(results)
    hits = pd.concat([r.hits for r in results])
    inside = hits["true_diameter_m"].between(hits["diameter_low_m"], hits["diameter_high_m"])
    known = hits["diameter_low_m"].notna() & hits["true_diameter_m"].notna()
    covered = f"{inside[known].mean():.2f} of {known.sum()}" if known.any() else ""
    f1 = f"{2 * k / max(asked + made, 1):.3f} {spread}"
    away = 100 * hits.loc[hits["diameter_m"].notna(), "distance_m"]
    off = f"{away.quantile(0.95):.1f} of {len(away)}" if len(away) else ""
    row = {"on": name, "right / asked": f"{k}/{asked}", "right / found": f"{k}/{made}", "F1": f1}
    return row | {"diameters covered": covered, "axes with a diameter, 95 % (cm)": off}


def f1_interval(results):
    """95 % interval of F1: bootstrap over streets, or over blocks of 50 m of a single one."""
    rows = []
    for result in results:
        made = result.detections[~result.detections["outcome"].isin(["ignored", "outside"])]
        asked = result.targets[result.targets["target"]]
        if len(results) > 1:
            rows.append([result.recall.k, len(asked), len(made)])
            continue
        block = [np.floor(t[["x_m", "y_m"]] / 50).apply(tuple, axis=1) for t in (made, asked)]
        for one in {*block[0], *block[1]}:
            own, named = made[block[0] == one], asked[block[1] == one]
            rows.append([(own["outcome"] == "hit").sum(), len(named), len(own)])
    spread = stats.bootstrap(study.f1, np.array(rows), repeats=1000)
    return f"[{spread.low:.2f}, {spread.high:.2f}]"


def large(count):
    """Processor time and memory of a process that looks for poles in so many points."""
    made = streets.street("table-4-1", length=60.0, seed=1)
    cloud = streets.drive(made, "dense-profiler", seed=1)
    inside = (cloud.points[:, 1] >= 0) & (cloud.points[:, 1] < 60) & (abs(cloud.points[:, 0]) < 40)
    piece = cloud.points[inside]
    copies = -(-count // len(piece))
    points = np.concatenate([piece + [0, 60.0 * k, 0] for k in range(copies)])[:count]
    with TemporaryDirectory() as folder:
        path = Path(folder) / "points.npy"
        np.save(path, points)
        with get_context("spawn").Pool(1) as pool:
            return pool.apply(timed, (path,))


def timed(path):
    """What the detection in stored points takes, and the most memory of this process so far."""
    points = np.load(path)
    before, began = memory(), time.process_time()
    found = poles.detect(points)
    seconds = round(time.process_time() - began, 1)
    return {"points": len(points), "poles": len(found), "processor time (s)": seconds,
            "peak (GB)": memory(), "before (GB)": before}  # fmt: skip


def memory():
    """Most memory of this process so far, GB; ``resource`` would count its parent's as well."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return round(int(re.search(r"VmHWM:\s+(\d+)", status)[1]) / 1e6, 2)


def main():
    """Print and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--streets", type=int)
    parser.add_argument("--calibration", action="store_true")
    parser.add_argument("--versions", action="store_true")
    options = parser.parse_args()
    if options.calibration:
        print(correction())
        return
    if options.versions:
        print(versions().to_string(index=False))
        return
    took = [large(5_000_000), large(20_000_000)]
    print(took, flush=True)
    rows = {}
    for name, result in rated(options.streets):
        rows.setdefault(name, []).append(result)
        print(name, result, flush=True)
    table = pd.DataFrame([row_of(name, results) for name, results in rows.items()])
    bands, unsteady = pd.DataFrame(score_bands(rows)), pd.DataFrame([changed()])
    for part in (table, bands, unsteady):
        print(part.to_string(index=False))
    if options.streets is None:
        write_section("Poles", table)
        write_section("Poles, scores", bands)
        write_section("Poles, finds that change", unsteady)
        write_section("Poles, time and memory", pd.DataFrame(took))


if __name__ == "__main__":
    main()
