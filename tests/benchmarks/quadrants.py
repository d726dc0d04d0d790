"""Measure the quadrant search beside other libraries, on even and on awkward patterns.

Processor time per point on one thread, warm, median of the repeats, all methods in turn in one
process; memory and first calls in fresh processes. (a) is scipy's cKDTree with k growing until all
quadrants are hit, the others find one single nearest neighbour. A library that is not installed is
left out with a line that says so.

    python tests/benchmarks/quadrants.py --points 30000 1000000
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time

import numpy as np

RADIUS_M = 0.5

# Read when the libraries are imported, which is in the functions below.
os.environ |= {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}


def uniform(n, rng):
    """2000 points per square metre, in rows 47 mm high as a scanner would deliver them."""
    xy = rng.random((n, 2)) * np.sqrt(n / 2000)
    return xy[np.lexsort((xy[:, 0], xy[:, 1] // 0.047))]


def scan_lines(n, rng):
    """4.6 mm along, 47 mm across, turned by 34 degrees."""
    lines = 1 + int(np.sqrt(n * 0.0046 / 0.047))
    each = 1 + n // lines
    along = (np.arange(lines * each) % each + rng.random(lines).repeat(each)) * 0.0046
    xy = np.stack([along, 0.047 * np.arange(lines).repeat(each)], axis=1)[:n]
    c, s = np.cos(np.radians(34)), np.sin(np.radians(34))
    return (xy + rng.normal(0, 0.0003, xy.shape)) @ np.array([[c, s], [-s, c]])


def dense_matching(n, rng):
    """A jittered raster of 30 000 points per square metre, row by row."""
    side = 1 + int(np.sqrt(n))
    raster = np.stack(np.divmod(np.arange(n), side), axis=1) / np.sqrt(30_000)
    return raster + rng.normal(0, 0.3 / np.sqrt(30_000), raster.shape)


def rings(n, rng):
    """Clusters with holes."""
    turn, reach = 2 * np.pi * rng.random(n), 0.05 + 0.01 * rng.random(n)
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1) * reach[:, None]
    return (10 * rng.random((2000, 2)))[rng.integers(0, 2000, n)] + ring


def two_densities(n, rng, share=0.5):
    """A share of the points in a square metre of a square kilometre."""
    xy = 1000 * rng.random((n, 2))
    xy[int(n * (1 - share)) :] = 500 + rng.random((n - int(n * (1 - share)), 2))
    return xy


EVEN = {"uniform": uniform, "scan lines": scan_lines, "dense matching": dense_matching}
AWKWARD = {
    "clusters": lambda n, rng: (
        100 * rng.random((200, 2))[rng.integers(0, 200, n)] + rng.normal(0, 0.05, (n, 2))
    ),
    "clusters with holes": rings,
    "two densities, half and half": two_densities,
    "two densities, 1 to 999": lambda n, rng: two_densities(n, rng, 0.999),
    "one line along x": lambda n, rng: rng.random((n, 1)) * [n / 1000, 0],
    "one diagonal line": lambda n, rng: rng.random((n, 1)) * [n / 1000, n / 1000],
    "one noisy line": lambda n, rng: rng.random((n, 2)) * [n / 10_000, 0.002],
    "circle": lambda n, rng: (
        0.4 * np.stack([np.cos(t := 2 * np.pi * rng.random(n)), np.sin(t)], axis=1)
    ),
    "duplicates": lambda n, rng: np.resize(uniform(n // 100, rng), (n, 2)),
    "one cell": lambda n, rng: np.vstack([rng.random((n - 1, 2)) * 1e-6, [[1000, 1000]]]),
    "exact lattice": lambda n, rng: (
        np.stack(np.divmod(np.arange(n), 1 + int(n**0.5)), axis=1) * 0.02
    ),
}


def points(name, n, order):
    """A pattern in scan order or shuffled."""
    rng = np.random.default_rng(1)
    xy = (EVEN | AWKWARD)[name](n, rng)
    return np.ascontiguousarray(rng.permutation(xy) if order == "random" else xy)


def quadrants(xy):
    """This package."""
    from mmqa_lab.spacing import quadrant_distances

    return quadrant_distances(xy, radius=RADIUS_M)


def growing_k(xy):
    """Scipy's tree: 16 neighbours, four times as many for points still without all quadrants."""
    from scipy.spatial import cKDTree

    tree = cKDTree(xy)
    best, rows, k = np.full((len(xy), 4), np.inf), np.arange(len(xy)), 16
    beyond = np.vstack([xy, [[np.inf, np.inf]]])
    while len(rows):
        k = min(k, len(xy))
        more = []
        for some in np.array_split(rows, 1 + len(rows) * k // 2_000_000):
            near = tree.query(xy[some], k=k, distance_upper_bound=RADIUS_M)[1]
            dx, dy = np.moveaxis(beyond[near] - xy[some][:, None], 2, 0)
            d = np.sqrt(dx * dx + dy * dy)
            north, south = dy > 0, dy < 0
            inside = [(dx > 0) & ~south, (dx <= 0) & north, (dx < 0) & ~north, (dx >= 0) & south]
            best[some] = np.stack([np.where(q, d, np.inf).min(axis=1) for q in inside], axis=1)
            # The list is full and a quadrant empty: there may be more within the radius.
            more.append(some[(near[:, -1] < len(xy)) & np.isinf(best[some]).any(axis=1)])
        rows, k = np.concatenate(more) if k < len(xy) else rows[:0], 4 * k
    return np.sort(np.where(np.isinf(best), np.nan, best), axis=1)


def scipy_one(xy):
    """One neighbour, scipy."""
    from scipy.spatial import cKDTree

    return cKDTree(xy).query(xy, k=2)


def pykdtree_one(xy):
    """One neighbour, pykdtree."""
    from pykdtree.kdtree import KDTree

    return KDTree(xy).query(xy, k=2)


def pynanoflann_one(xy):
    """One neighbour, pynanoflann."""
    from pynanoflann import KDTree

    tree = KDTree(n_neighbors=2)
    tree.fit(xy)
    return tree.kneighbors(xy)


def open3d_one(xy):
    """One neighbour, Open3D."""
    import open3d

    tensor = open3d.core.Tensor(xy)
    search = open3d.core.nns.NearestNeighborSearch(tensor)
    search.knn_index()
    return search.knn_search(tensor, 2)


METHODS = {
    "quadrants": quadrants,
    "(a) scipy, growing k": growing_k,
    "one: scipy": scipy_one,
    "one: pykdtree": pykdtree_one,
    "one: pynanoflann": pynanoflann_one,
    "one: Open3D": open3d_one,
}


def installed():
    """The methods that can run here; the others are named with the reason."""
    found = {}
    for name, method in METHODS.items():
        try:
            method(points("uniform", 100_000, "scan"))  # enough for the compiled search
            found[name] = method
        except ImportError as reason:
            print(f"{name}: left out ({reason})")
    return found


def seconds(method, xy):
    """Processor seconds of one call."""
    start = time.process_time()
    method(xy)
    return time.process_time() - start


def compare(methods, n, repeats):
    """Print all methods on the even patterns, in both orders."""
    print(f"\n{n} points\n{'pattern, order':28}{'method':24}{'ns/point':>9}{'M/s':>8}{'times':>7}")
    for name in EVEN:
        for order in ("random", "scan"):
            xy = points(name, n, order)
            rounds = [{key: seconds(m, xy) for key, m in methods.items()} for _ in range(repeats)]
            cost = {key: np.median([found[key] for found in rounds]) for key in methods}
            for key, value in cost.items():
                print(
                    f"{name + ', ' + order:28}{key:24}{1e9 * value / len(xy):9.0f}"
                    f"{len(xy) / value / 1e6:8.3f}{value / cost['quadrants']:7.1f}",
                    flush=True,
                )


def awkward(n, repeats):
    """Print the quadrant search on the awkward patterns, shuffled, against the uniform one."""
    print(f"\n{n} points, random order\n{'pattern':32}{'ns/point':>9}{'times uniform':>15}")
    cost = {}
    for name in ("uniform", *AWKWARD):
        xy = points(name, n, "random")
        cost[name] = np.median([seconds(quadrants, xy) for _ in range(repeats)]) / len(xy)
        print(f"{name:32}{1e9 * cost[name]:9.0f}{cost[name] / cost['uniform']:15.2f}", flush=True)


CHILD = """
import sys, time
sys.path.insert(0, {folder!r})
import quadrants as q
method, xy = q.METHODS[{method!r}], q.points("scan lines", {n}, "random")
start = time.perf_counter(); method(xy[:2000].copy()); first = time.perf_counter() - start
status = lambda key: 1024 * int(open("/proc/self/status").read().split(key + ":")[1].split()[0])
with open("/proc/self/clear_refs", "w") as reset:
    reset.write("5")
before = status("VmRSS"); method(xy); print(first, (status("VmHWM") - before) / len(xy))
"""
"""Linux alone tells a peak that can be set back: what making the pattern took must not count."""


def fresh(method, n, **environment):
    """First call, seconds, and peak bytes per point beyond the input, in a process of its own."""
    code = CHILD.format(folder=os.path.dirname(__file__), method=method, n=n)
    run = [sys.executable, "-c", code]
    found = subprocess.run(run, env=os.environ | environment, capture_output=True, check=True)
    return [float(value) for value in found.stdout.split()]


def memory(methods, n):
    """Print peak memory of each method, and the first calls of this package."""
    print(f"\n{'peak memory, ' + str(n) + ' points':32}{'bytes/point':>12}")
    for name in methods:
        print(f"{name:32}{fresh(name, n)[1]:12.0f}", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        for state in ("compiled anew", "from the disk cache"):
            first = fresh("quadrants", n, NUMBA_CACHE_DIR=folder)[0]
            print(f"first call, imports included, {state}: {first:.1f} s", flush=True)


def main():
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--points", type=int, nargs="+", default=[30_000, 1_000_000])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--only", choices=["compare", "awkward", "memory"], nargs="+")
    options = parser.parse_args()
    parts = options.only or ["compare", "awkward", "memory"]
    methods = installed()
    for n in options.points:
        if "compare" in parts:
            compare(methods, n, options.repeats)
        if "awkward" in parts:
            awkward(n, options.repeats)
    if "memory" in parts:
        memory(methods, max(options.points))


if __name__ == "__main__":
    main()
