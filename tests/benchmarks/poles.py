"""Rates of the learned detector on streets that it never saw; seconds and memory of all detectors.

``python tests/benchmarks/poles.py --rates`` scores streets of both generators, bare shafts and,
with ``MMQA_DATA``, Oakland part 2; ``--streets N`` takes the first N of each row. Without
``--rates`` it drives 60 m of street once (976 kHz, 95 Hz) and lays copies of it end to end: seconds
a million points must not rise with the number of points.
"""

import argparse
import resource
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pandas as pd

from mmqa_lab import poles, samples
from mmqa_lab.cloud import Cloud
from mmqa_lab.poles.ours import CLASSES
from mmqa_lab.simulate import streets
from mmqa_lab.simulate.systems import PRESETS
from mmqa_lab.studies import poles as study
from mmqa_lab.studies.poles_training import kinds

sys.path.insert(0, str(Path(__file__).parents[1]))
import other_street

LENGTH_M = 60.0
GREEN = (("facades", 8211), ("green", 8212), ("facades", 8213), ("green", 8214))
SEEDS = {
    "own": range(8201, 8207),
    "dense": range(8201, 8204),
    "shafts": range(8201, 8206),
    "tilted profiler": range(321, 329),
    "clutter": range(331, 337),
    "32 beams": range(341, 345),
}
"""Streets of the rates; none was used to choose anything."""

OTHERS = {"lamp": 0, "sign": 1, "tree": 2}
BEAMS = streets.replace(PRESETS["hdl-32e"], lever_arm_m=(0.0, 0.0, 2.2))


def own(plan, seed, length, scanner="roamer"):
    """A street of the generator of the training."""
    cloud, truth = study.scene(plan=plan, seed=seed, length=length, scanner=scanner)
    targets = truth["targets"]
    return cloud, targets.assign(kind=np.array(CLASSES)[kinds(targets)]), truth["path"]


def other(scanner, seed, clutter=0):
    """A street of the tests' own generator, with some more cars and people."""
    made, rng = other_street.make(seed), np.random.default_rng([seed, 79])
    for _ in range(clutter):
        side = rng.choice([-1, 1])
        other_street._car(made, side * 2.4, rng.uniform(0, 45))
        other_street._person(made, side * rng.uniform(4, 8), rng.uniform(0, 45))
    points, seconds, line, pole, path = other_street.scan(made, scanner, seed)
    cloud = Cloud(points, {"scan_line": line, "gps_time": seconds})
    truth = other_street.tables(made, pole)[0]
    low = pd.Series(np.where(truth["height_m"] < 2, 3, 0), truth.index)  # bollards and masts
    kind = truth["class"].map(OTHERS).fillna(low).astype(int)
    return cloud, truth.assign(kind=np.array(CLASSES)[kind]), path


def damaged(kind, cloud, truth):
    """A cloud cropped, thin, with stray points below the ground or without columns; its targets."""
    rng = np.random.default_rng(len(cloud))
    if kind == "cropped at 2 m":
        cloud = cloud[cloud.points[:, 2] < 2]
        plain = streets.Street(None, truth.drop(columns=SEEN), 0.0, None)
        return cloud, streets.visible_targets(plain, cloud)
    if kind == "5 % of the points":
        return cloud[rng.random(len(cloud)) < 0.05], truth
    if kind == "no columns but time":
        columns = {"gps_time": cloud["gps_time"], "scan_angle": np.zeros(len(cloud))}
        return Cloud(cloud.points, columns), truth
    stray = cloud[rng.choice(len(cloud), len(cloud) // 5000)]
    stray.points[:, 2] = -rng.uniform(1, 6, len(stray))
    return Cloud.concatenate([cloud, stray]), truth


SEEN = ["points", "sweeps", "span_m", "visible", "distance_m"]
DAMAGES = ("cropped at 2 m", "0.02 % stray points", "5 % of the points", "no columns but time")


def rated(count):
    """Yield the row, the cloud, the targets and the path of each street, shafts and real cloud."""
    for seed in SEEDS["own"][:count]:
        cloud, truth, path = own("table-4-1", seed, 80.0)
        yield "own generator, table-4-1", cloud, truth, path
        for kind in DAMAGES:
            yield f"the same, {kind}", *damaged(kind, cloud, truth), path
    for plan, seed in GREEN[:count]:
        yield "own generator, facades and green", *own(plan, seed, 40.0)
    for seed in SEEDS["dense"][:count]:
        cloud, truth, path = own("table-4-1", seed, 40.0, "dense-profiler")
        yield "976 kHz, 5 % of the points", *damaged("5 % of the points", cloud, truth), path
    for name, scanner in (("profiler", "roamer"), ("32 beams", BEAMS)):
        for seed in SEEDS["shafts"][:count]:
            yield f"64 bare shafts, {name}", *study.bare_shafts(scanner, seed=seed), None
    for row in ("tilted profiler", "clutter", "32 beams"):
        scanner, more = ("tilted profiler", 8) if row == "clutter" else (row, 0)
        for seed in SEEDS[row][:count]:
            yield f"other generator, {row}", *other(scanner, seed, more)
    if samples.has_real(study.OAKLAND[0]):
        yield "Oakland part 2", *study.oakland(), None


def right_class(result):
    """Whether each hit has the class of its target; none where the reference has no classes."""
    hits = result.detections[result.detections["outcome"] == "hit"]
    if "kind" not in result.targets:
        return np.empty(0)
    return (hits["class"] == result.targets.loc[hits["reference"], "kind"].to_numpy()).to_numpy()


def print_rates(count):
    """Print a row for each kind of street."""
    rows = {}
    for name, cloud, truth, path in rated(count):
        scope = {} if path is None else {"corridor": 30, "trajectory": path}
        rows.setdefault(name, []).append(poles.score(poles.detect(cloud), truth, **scope))
    for name, results in rows.items():
        print_row(name, results)


def print_row(name, results):
    """Print the rates of some streets together."""
    found, asked, made = (
        sum(numbers)
        for numbers in zip(*[(r.recall.k, r.recall.n, r.precision.n) for r in results], strict=True)
    )
    judged = pd.concat([r.detections for r in results])
    hits = judged[judged["outcome"] == "hit"]
    right = np.concatenate([right_class(r) for r in results])
    reliable = study.reliability(judged)
    error = ((reliable["right"] - reliable["mean_score"]).abs() * reliable["n"]).sum()
    print(
        f"{name:<40}{found:>4}/{asked:<4} {found:>4}/{made:<4} F1 {2 * found / (asked + made):.3f} "
        f"calibration {error / made:.3f} class {np.mean(right) if len(right) else np.nan:.2f} "
        f"diameters {hits['diameter_m'].notna().mean():.2f}",
        flush=True,
    )


def piece():
    """One drive through 60 m of street."""
    made = streets.street("table-4-1", length=LENGTH_M, seed=1)
    cloud = streets.drive(made, "dense-profiler", seed=1)
    inside = (cloud.points[:, 1] >= 0) & (cloud.points[:, 1] < LENGTH_M)
    return cloud[inside & (np.abs(cloud.points[:, 0]) < 40)]


def repeated(cloud, times):
    """Copies of a drive, one after the other."""
    lines = int(cloud["scan_line"].max()) + 10
    pulses = int(cloud["pulse"].max()) + 1
    parts = [
        Cloud(
            cloud.points + [0, LENGTH_M * k, 0],
            {"scan_line": cloud["scan_line"] + lines * k, "pulse": cloud["pulse"] + pulses * k},
        )
        for k in range(times)
    ]
    return Cloud.concatenate(parts)


def main():
    """Print a row for each method and size."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rates", action="store_true")
    parser.add_argument("--streets", type=int)
    parser.add_argument("--copies", type=int, nargs="+", default=[1, 2, 4, 7])
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    if options.rates:
        print_rates(options.streets)
        return
    one = piece()
    for method in poles.METHODS:
        poles.detect(one[::20], method=method)  # compiles
    print(f"{'method':<8}{'points':>12}{'poles':>8}{'s':>9}{'CPU s':>9}{'s/1e6':>9}{'peak GB':>9}")
    for times in options.copies:
        cloud = repeated(one, times)
        for method in poles.METHODS:
            began, cpu = time.perf_counter(), time.process_time()
            found = poles.detect(cloud, method=method)
            seconds, cpu = time.perf_counter() - began, time.process_time() - cpu
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
            rate = 1e6 * seconds / len(cloud)
            row = f"{method:<8}{len(cloud):>12}{len(found):>8}{seconds:>9.1f}"
            print(f"{row}{cpu:>9.1f}{rate:>9.2f}{peak:>9.1f}", flush=True)


if __name__ == "__main__":
    main()
