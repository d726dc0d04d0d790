"""The quadrant search on even and on awkward patterns, beside what a user would pick instead.

Processor time on one thread, warm, the least of the repeats, all in turn in one process. Scipy's
tree with k growing until all quadrants are hit finds the same; the other libraries find one nearest
neighbour. *chart* is one chart as in Pfeifer et al. 2021, Appendix A: this package also reads the
LAZ file and finds d1..d4, Octave and numpy find plane, sigma_MAD, hull and density. What is not
installed is left out with a line that says so. Writes its sections of RESULTS.md.

    PYTHONPATH=tests/benchmarks python tests/benchmarks/quadrants.py --points 300000
"""

import argparse
import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

# read when the libraries are imported
os.environ |= {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

import numpy as np
import pandas as pd
from results import write_section
from scipy.spatial import ConvexHull, cKDTree

from mmqa_lab import chart_cloud, io, maps, spacing
from mmqa_lab.cloud import Cloud
from mmqa_lab.planes import PAPER_SCALE
from mmqa_lab.spacing.quadrants import nearest_by_scipy

OCTAVE = """
points = load("{text}");
begin = cputime();
c = mean(points); q = points - c;
[v, e] = eig(q' * q); [~, order] = sort(diag(e)); v = v(:, order);
d = q * v(:, 1); s = 1.4862 * median(abs(d - median(d)));
uv = q * v(:, 2:3); h = convhull(uv(:, 1), uv(:, 2));
a = polyarea(uv(h, 1), uv(h, 2));
printf("%.17g %.17g %.17g\\n", cputime() - begin, s, a);
"""


def uniform(n, rng):
    """2000 points per square metre."""
    return rng.random((n, 2)) * np.sqrt(n / 2000)


def scan_lines(n, rng):
    """4.6 mm along, 47 mm across, turned by 34 degrees."""
    lines = 1 + int(np.sqrt(n * 0.0046 / 0.047))
    each = 1 + n // lines
    along = (np.arange(lines * each) % each + rng.random(lines).repeat(each)) * 0.0046
    xy = np.stack([along, 0.047 * np.arange(lines).repeat(each)], axis=1)[:n]
    c, s = np.cos(np.radians(34)), np.sin(np.radians(34))
    return (xy + rng.normal(0, 0.0003, xy.shape)) @ np.array([[c, s], [-s, c]])


def two_densities(n, rng):
    """All but a thousandth of the points in a square metre of a square kilometre."""
    xy = 1000 * rng.random((n, 2))
    xy[n // 1000 :] = 500 + rng.random((n - n // 1000, 2))
    return xy


def on_circle(n, rng):
    """Points of a circle."""
    turn = 2 * np.pi * rng.random(n)
    return 0.4 * np.stack([np.cos(turn), np.sin(turn)], axis=1)


PATTERNS = {
    "uniform": uniform,
    "scan lines": scan_lines,
    "exact lattice": lambda n, rng: (
        np.stack(np.divmod(np.arange(n), 1 + int(n**0.5)), axis=1) * 0.02
    ),
    "clusters": lambda n, rng: (
        100 * rng.random((200, 2))[rng.integers(0, 200, n)] + rng.normal(0, 0.05, (n, 2))
    ),
    "two densities, 1 to 999": two_densities,
    "one line along x": lambda n, rng: rng.random((n, 1)) * [n / 1000, 0],
    "one diagonal line": lambda n, rng: rng.random((n, 1)) * [n / 1000, n / 1000],
    "one noisy line": lambda n, rng: rng.random((n, 2)) * [n / 10_000, 0.002],
    "circle": on_circle,
    "duplicates": lambda n, rng: np.resize(uniform(n // 100, rng), (n, 2)),
    "one far point": lambda n, rng: np.vstack([rng.random((n - 1, 2)) * 1e-6, [[1000, 1000]]]),
}


def growing_k(xy):
    """The same by scipy's tree: 16 neighbours, twice as many where quadrants are still empty."""
    return nearest_by_scipy(xy, 0.5)


def one_by_scipy(xy):
    """One neighbour, scipy."""
    return cKDTree(xy).query(xy, k=2)


def one_by_sklearn(xy):
    """One neighbour, scikit-learn."""
    from sklearn.neighbors import NearestNeighbors

    return NearestNeighbors(n_neighbors=2).fit(xy).kneighbors(xy)


def one_by_open3d(xy):
    """One neighbour, Open3D."""
    import open3d

    search = open3d.core.nns.NearestNeighborSearch(open3d.core.Tensor(xy))
    search.knn_index()
    return search.knn_search(open3d.core.Tensor(xy), 2)


PEERS = (spacing.quadrant_distances, growing_k, one_by_scipy, one_by_sklearn, one_by_open3d)


def seconds(function, repeats):
    """Least processor time of a call, after one that does not count."""
    function()
    found = []
    for _ in range(repeats):
        began = time.process_time()
        function()
        found.append(time.process_time() - began)
    return min(found)


def charts(folder, repeats, n=30_000):
    """Rows for one chart: this package, plain numpy and scipy, Octave, which must agree."""
    rng = np.random.default_rng(1)
    uv = np.column_stack([rng.random(n), np.round(rng.random(n) * 60) / 60, rng.normal(0, 3e-3, n)])
    axes = np.array([[0.6, 0.8, 0.0], [0.0, 0.0, 1.0], [0.8, -0.6, 0.0]])
    io.write_cloud(folder / "chart.laz", Cloud(uv @ axes + [600_000, 5_200_000, 200]), scale=1e-6)
    points = io.read_cloud(folder / "chart.laz").points

    def ours():
        cloud = io.read_cloud(folder / "chart.laz", columns=())
        return chart_cloud.evaluate_cloud(cloud, scale=PAPER_SCALE)

    def plain():
        centred = points - points.mean(axis=0)
        _, vectors = np.linalg.eigh(centred.T @ centred)
        off = centred @ vectors[:, 0]
        area = ConvexHull(centred @ vectors[:, 1:]).volume
        return PAPER_SCALE * np.median(np.abs(off - np.median(off))), area

    expected = ours().sigma_mad_mm / 1000, ours().area_hull_m2
    np.testing.assert_allclose(plain(), expected, rtol=1e-6)
    yield "reading LAZ, all figures: this package", seconds(ours, repeats)
    yield "plane, sigma_MAD, hull: numpy and scipy", seconds(plain, repeats)
    octave = shutil.which("octave-cli")
    if octave is None:
        print("Octave: left out, not installed")
        return
    np.savetxt(folder / "chart.txt", points, fmt="%.6f")
    (folder / "chart.m").write_text(OCTAVE.format(text=folder / "chart.txt"))
    run = [octave, "--no-gui", "--norc", "--quiet", str(folder / "chart.m")]
    done = subprocess.run(run, capture_output=True, text=True, check=True)
    spent, *found = map(float, done.stdout.split())
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    yield "plane, sigma_MAD, hull: Octave", spent


def main():
    """Run everything and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--points", type=int, default=300_000)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    n, rows = options.points, []
    for name, make in PATTERNS.items():
        rng = np.random.default_rng(1)
        xy = rng.permutation(make(n, rng))
        spent = seconds(lambda xy=xy: spacing.quadrant_distances(xy), options.repeats)
        rows.append({"pattern": name, "points": n, "ns a point": 1e9 * spent / n})
        rows[-1]["times uniform"] = rows[-1]["ns a point"] / rows[0]["ns a point"]
    write_section("Quadrants by pattern", pd.DataFrame(rows))
    xy, rows = uniform(n, np.random.default_rng(1)), []
    for peer in PEERS:
        try:
            rows.append((peer.__doc__.split("\n")[0], seconds(lambda f=peer: f(xy), 1)))
        except ImportError as reason:
            print(f"{peer.__name__}: left out ({reason})")
    street = np.column_stack([xy, np.random.default_rng(2).normal(0, 0.003, n)])
    rows.append(("A map of these points", seconds(lambda: maps.map_cloud(street), 1)))
    with tempfile.TemporaryDirectory() as folder:
        rows += charts(Path(folder), options.repeats)
    table = pd.DataFrame(rows, columns=["what", "processor time (s)"])
    write_section("Quadrants beside peers", table)
    print(table.to_string(index=False))


if __name__ == "__main__":
    main()
