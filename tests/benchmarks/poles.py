"""Seconds and memory of each detector over the number of points, to 2e7 points of 400 m of street.

``python tests/benchmarks/poles.py`` drives 60 m of street once (976 kHz, 95 Hz) and lays copies of
it end to end. Seconds a million points must not rise with the number of points.
"""

import argparse
import resource
import time
import warnings

import numpy as np

from mmqa_lab import poles
from mmqa_lab.cloud import Cloud
from mmqa_lab.simulate import streets

LENGTH_M = 60.0


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
    parser.add_argument("--copies", type=int, nargs="+", default=[1, 2, 4, 7])
    options = parser.parse_args()
    warnings.simplefilter("ignore")
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
