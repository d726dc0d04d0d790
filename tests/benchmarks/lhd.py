"""Speed and memory of the similarity matrix, the matchers and the edges, beside plain numpy.

``python tests/benchmarks/lhd.py`` compares in one process and prints ratios; ``--points`` sets the
size of the simulated facade cloud. ``--study`` measures ``mmqa lhd`` on clouds of that size:
three passes, each with each and with a reference, extraction of the edges included.
"""

import argparse
import resource
import subprocess
import sys
import tempfile
import time
import tracemalloc
from pathlib import Path

import numpy as np

from mmqa_lab import lines
from mmqa_lab.io import write_cloud
from mmqa_lab.lines.segments import MATCHERS
from mmqa_lab.simulate.canyon import canyon, canyon_cloud


def broadcast(test, model, weight=10.0):
    """The definition written down with numpy arrays of p x q x 3."""
    apart = test.midpoints[:, None] - model.midpoints[None]
    axis, own = model.directions[None], test.directions[:, None]
    sine = np.linalg.norm(np.cross(own, axis), axis=2)
    lengths = test.lengths[:, None], model.lengths[None]
    s = (apart * axis).sum(axis=2)
    angle = np.minimum(*lengths) * sine
    parallel = np.maximum(0, np.abs(s) - np.abs(lengths[0] - lengths[1]) / 2)
    across = np.linalg.norm(apart - s[..., None] * axis, axis=2)
    return np.sqrt(weight * angle**2 + parallel**2 + across**2)


def at_random(rng, n):
    """Segments of some 14 m in a cube of 200 m."""
    first = rng.uniform(0, 200, (n, 3))
    return lines.Segments(np.stack([first, first + rng.normal(0, 8, (n, 3))], axis=1))


def seconds(function, *arguments, repeats):
    """Least time of several calls, the first not counted."""
    function(*arguments)
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        function(*arguments)
        times.append(time.perf_counter() - began)
    return min(times)


def peak_mb(function, *arguments):
    """Peak of the memory that numpy allocates in a call, MB."""
    tracemalloc.start()
    function(*arguments)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak / 1e6


def matrix(rng):
    """The similarity matrix at both sizes of the comparison."""
    print(f"{'p x q':>14}{'numpy ms':>11}{'ours ms':>10}{'ratio':>8}{'numpy MB':>10}{'ours MB':>9}")
    for p, q, repeats in ((37, 68, 200), (2000, 2000, 7)):
        test, model = at_random(rng, p), at_random(rng, q)
        plain = seconds(broadcast, test, model, repeats=max(3, repeats // 10))
        ours = seconds(lines.distance_matrix, test, model, repeats=repeats)
        worst = np.abs(broadcast(test, model) - lines.distance_matrix(test, model)).max()
        assert worst < 1e-9, worst
        memory = [peak_mb(f, test, model) for f in (broadcast, lines.distance_matrix)]
        times = f"{1e3 * plain:>11.2f}{1e3 * ours:>10.3f}{plain / ours:>8.0f}"
        print(f"{p:>7} x {q:<4}{times}{memory[0]:>10.1f}{memory[1]:>9.1f}")


def matchers():
    """The whole distance by matcher on one comparison of the canyon."""
    surveys = canyon(1).surveys
    test, model = surveys["C1"].segments, surveys["TLS"].segments
    for matcher in (*MATCHERS, "displaced"):
        once = seconds(lambda m=matcher: lines.lhd(test, model, matcher=m), repeats=5)
        print(f"lhd, {len(test)} x {len(model)}, matcher {matcher:<10}{1e3 * once:>8.1f} ms")


def edges(points):
    """Planes and edges of a facade cloud."""
    scene = canyon(1)
    cloud = canyon_cloud(scene, "TLS", density=points / 14_770)
    began = time.perf_counter()
    found = lines.extract_edges(cloud.points, tolerance=0.04)
    end = time.perf_counter()
    print(f"{len(cloud)} points: {len(found)} edges in {end - began:.1f} s")


def whole_study(points):
    """Processor and wall time of the command on three passes and a reference."""
    scene = canyon(1)
    with tempfile.TemporaryDirectory() as folder:
        files = [f"{folder}/{name}.laz" for name in ("C1", "C2", "C3", "TLS")]
        for file in files:
            cloud = canyon_cloud(scene, Path(file).stem, density=points / 14_770)
            write_cloud(file, cloud)
        command = [sys.executable, "-m", "mmqa_lab", "lhd", *files[:3], "--reference", files[3]]
        began = time.perf_counter()
        done = subprocess.run(command, capture_output=True, text=True)
        wall = time.perf_counter() - began
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(done.stdout or done.stderr)
    print(f"4 clouds of {len(cloud)} points: {used.ru_utime + used.ru_stime:.1f} s of processor")
    print(f"time, {wall:.1f} s on the clock")


def main():
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=float, default=1e6)
    parser.add_argument("--study", action="store_true", help="the command on whole clouds")
    options = parser.parse_args()
    if options.study:
        whole_study(options.points)
        return
    matrix(np.random.default_rng(1))
    matchers()
    edges(options.points)


if __name__ == "__main__":
    main()
