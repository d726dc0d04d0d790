"""Measure this package beside what a user would pick instead, and write the table of the README.

Two tasks, each on the same points for everyone, in processor time (user and system), the median of
the repeats, warm, all in turn in one run:

- *chart*: one chart as in Pfeifer et al. 2021, Appendix A: plane, sigma_MAD, hull, density. This
  package also reads the LAZ file and finds d1..d4; Octave's start is not counted.
- *neighbours*: what tells the spacing of points. This package finds the nearest point in each of
  four quadrants; the others find one neighbour, or count those within 5 cm.

Every peer is optional: one that is missing is named with the reason.

    python tests/benchmarks/peers.py --points 1000000 --markdown README.md
"""

import argparse
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from importlib import metadata
from pathlib import Path

# Read when the libraries are imported, which is in the functions below.
os.environ |= {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

import numpy as np

from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.cloud import Cloud
from mmqa_lab.io import read_cloud, write_cloud
from mmqa_lab.planes import PAPER_SCALE
from mmqa_lab.run.pages import replaced
from mmqa_lab.spacing import quadrant_distances

CHART_POINTS = 30_000
NEAR_M = 0.05

OCTAVE = """
1;
function r = evaluate(p)
  c = mean(p);
  q = p - c;
  [v, e] = eig(q' * q);
  [~, order] = sort(diag(e));
  v = v(:, order);
  d = q * v(:, 1);
  s = 1.4862 * median(abs(d - median(d)));
  uv = q * v(:, 2:3);
  h = convhull(uv(:, 1), uv(:, 2));
  a = polyarea(uv(h, 1), uv(h, 2));
  r = [s, a, rows(p) / a];
end
points = load("{text}");
r = evaluate(points);
t = zeros(2, {repeats});
for k = 1:{repeats}
  begin = cputime(); points = load("{text}"); t(1, k) = cputime() - begin;
  begin = cputime(); r = evaluate(points); t(2, k) = cputime() - begin;
end
printf("%.17g %.17g %.17g %.17g %.17g\\n", r, median(t, 2));
"""


class Missing(Exception):
    """Why a peer cannot run here."""


def chart(n):
    """A chart 1 m wide: noisy scan lines on a tilted plane, in the coordinates of a map."""
    rng = np.random.default_rng(1)
    u, v = rng.random(n), np.round(rng.random(n) * 60) / 60
    axes = np.array([[0.6, 0.8, 0.0], [0.0, 0.0, 1.0], [0.8, -0.6, 0.0]])
    points = np.stack([u, v, rng.normal(0, 0.003, n)], axis=1) @ axes
    return points + [600_000, 5_200_000, 200]


def street(n):
    """A road, 2000 points per square metre, in scan order."""
    rng = np.random.default_rng(2)
    wide = 10.0
    y = np.sort(rng.random(n)) * n / 2000 / wide
    return np.stack([rng.random(n) * wide, y, rng.normal(0, 0.003, n)], axis=1)


def seconds(function, repeats):
    """Median processor time of a call, after one that does not count."""
    function()
    found = []
    for _ in range(repeats):
        began = time.process_time()
        function()
        found.append(time.process_time() - began)
    return float(np.median(found))


def child_seconds(command, **choices):
    """Processor time of a child process, and what it printed."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, capture_output=True, text=True, check=True, **choices)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return spent, done.stdout


def program(*names):
    """The path of the first of these programs that is there."""
    found = next((path for name in names if (path := shutil.which(name))), None)
    if found is None:
        raise Missing(f"no program {names[0]}")
    return found


def version(package):
    """A library's version; Missing where it is not installed."""
    try:
        return f"{package} {metadata.version(package)}"
    except metadata.PackageNotFoundError:
        raise Missing(f"{package} is not installed") from None


def chart_ours(points, folder, repeats):
    """Read LAZ, plane, sigma_MAD, hull, density, d1..d4."""
    path = folder / "chart.laz"
    write_cloud(path, Cloud(points), scale=1e-6)
    choices = {"scale": PAPER_SCALE}
    cost = seconds(lambda: evaluate_cloud(read_cloud(path, columns=()), **choices), repeats)
    return version("mmqa-lab"), cost


def chart_octave(points, folder, repeats):
    """Plane, sigma_MAD, hull, density; the same answer or an error."""
    who, _, evaluating = _octave(points, folder, repeats)
    return who, evaluating


def chart_octave_reading(points, folder, repeats):
    """The same with reading the points as text."""
    who, reading, evaluating = _octave(points, folder, repeats)
    return who, reading + evaluating


def _octave(points, folder, repeats):
    """Version, and processor time of reading and of evaluating."""
    octave = program("octave-cli", "octave")
    text, script = folder / "chart.txt", folder / "chart.m"
    write_cloud(folder / "chart.laz", Cloud(points), scale=1e-6)
    points = read_cloud(folder / "chart.laz").points
    np.savetxt(text, points, fmt="%.6f")
    script.write_text(OCTAVE.format(text=text, repeats=repeats))
    _, printed = child_seconds([octave, "--no-gui", "--norc", "--quiet", str(script)])
    sigma, area, density, reading, evaluating = map(float, printed.split())
    ours = evaluate_cloud(points, scale=PAPER_SCALE)
    expected = ours.sigma_mad_mm / 1000, ours.area_hull_m2, ours.density_hull_per_m2
    # Octave works on coordinates of a map: 1e-9 m of rounding in each.
    np.testing.assert_allclose((sigma, area, density), expected, rtol=1e-6)
    _, printed = child_seconds([octave, "--version"])
    return "Octave " + re.search(r"version (\S+)", printed)[1], reading, evaluating


def chart_scipy(points, folder, repeats):
    """Plane, sigma_MAD, hull, density in plain numpy and scipy."""
    from scipy.spatial import ConvexHull

    def evaluate():
        q = points - points.mean(axis=0)
        _, vectors = np.linalg.eigh(q.T @ q)
        d = q @ vectors[:, 0]
        area = ConvexHull(q @ vectors[:, 1:]).volume
        return PAPER_SCALE * np.median(np.abs(d - np.median(d))), len(q) / area

    np.testing.assert_allclose(
        len(points) / evaluate()[1], evaluate_cloud(points).area_hull_m2, rtol=1e-9
    )
    return version("scipy"), seconds(evaluate, repeats)


def near_ours(points, folder, repeats):
    """Nearest point in each of four quadrants, within 0.5 m."""
    return version("mmqa-lab"), seconds(lambda: quadrant_distances(points[:, :2]), repeats)


def near_scipy(points, folder, repeats):
    """One neighbour, cKDTree."""
    from scipy.spatial import cKDTree

    return version("scipy"), seconds(lambda: cKDTree(points).query(points, k=2), repeats)


def near_sklearn(points, folder, repeats):
    """One neighbour, NearestNeighbors."""
    from sklearn.neighbors import NearestNeighbors

    def search():
        return NearestNeighbors(n_neighbors=2).fit(points).kneighbors(points)

    return version("scikit-learn"), seconds(search, repeats)


def near_open3d(points, folder, repeats):
    """One neighbour, compute_nearest_neighbor_distance."""
    name = version("open3d")
    import open3d

    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    return name, seconds(cloud.compute_nearest_neighbor_distance, repeats)


def near_jakteristics(points, folder, repeats):
    """Points within 5 cm."""
    name = version("jakteristics")
    from jakteristics import compute_features

    choices = {"search_radius": NEAR_M, "feature_names": ["number_of_neighbors"], "num_threads": 1}
    return name, seconds(lambda: compute_features(points, **choices), repeats)


def near_cloudcompare(points, folder, repeats):
    """One neighbour (approximate density), less the time for starting and loading."""
    return _cloudcompare(points, folder, ["-APPROX_DENSITY"])


def near_cloudcompare_radius(points, folder, repeats):
    """Points within 5 cm (density), less the time for starting and loading."""
    return _cloudcompare(points, folder, ["-DENSITY", str(NEAR_M)])


def _cloudcompare(points, folder, task):
    """CloudCompare on the command line, one thread, without a screen."""
    path = program("CloudCompare", "cloudcompare.CloudCompare")
    ply = folder / "street.ply"
    vertices = np.empty(len(points), [(axis, "<f8") for axis in "xyz"])
    for k, axis in enumerate("xyz"):
        vertices[axis] = points[:, k]
    from plyfile import PlyData, PlyElement

    PlyData([PlyElement.describe(vertices, "vertex")]).write(str(ply))
    load = [path, "-SILENT", "-AUTO_SAVE", "OFF", "-O", str(ply)]
    quiet = {"env": os.environ | {"QT_QPA_PLATFORM": "offscreen"}, "timeout": 600}
    bare, _ = child_seconds(load, **quiet)
    whole, printed = child_seconds([*load, *task], **quiet)
    if "ERROR" in printed.upper():
        raise Missing(f"CloudCompare: {printed.strip().splitlines()[-1]}")
    return _debian("cloudcompare", "CloudCompare"), whole - bare


def near_pdal(points, folder, repeats):
    """One neighbour, filters.nndistance, less the time for starting and reading."""
    pdal = program("pdal")
    path = folder / "street.laz"
    write_cloud(path, Cloud(points))
    copy = [pdal, "translate", str(path), str(folder / "out.las")]
    bare, _ = child_seconds(copy)
    whole, _ = child_seconds([*copy, "nndistance", "--filters.nndistance.k=1"])
    _, printed = child_seconds([pdal, "--version"])
    return "PDAL " + re.search(r"\d+\.\d+\.\d+", printed)[0], whole - bare


def _debian(package, name):
    """The version of a Debian package."""
    done = subprocess.run(
        ["dpkg-query", "-W", "-f", "${Version}", package], capture_output=True, text=True
    )
    return f"{name} {done.stdout.split('+')[0]}".strip()


CHART = (chart_ours, chart_scipy, chart_octave, chart_octave_reading)
NEIGHBOURS = (
    *(near_ours, near_scipy, near_sklearn, near_open3d, near_jakteristics),
    *(near_cloudcompare, near_cloudcompare_radius, near_pdal),
)


def compare(title, methods, points, repeats):
    """Rows (task, points, who, what, processor seconds, times this package)."""
    print(f"\n{title}, {len(points)} points", flush=True)
    rows, ours = [], None
    for method in methods:
        what = method.__doc__.split("\n")[0].rstrip(".")
        with tempfile.TemporaryDirectory() as folder:
            try:
                who, cost = method(points, Path(folder), repeats)
            except Missing as reason:
                print(f"  {what}: left out ({reason})")
                continue
            except (ImportError, subprocess.SubprocessError) as reason:
                print(f"  {what}: left out ({str(reason).splitlines()[0]})")
                continue
        ours = cost if ours is None else ours
        print(f"  {who:24} {what:72} {cost:8.3f} s {cost / ours:7.1f} times", flush=True)
        rows.append((title, len(points), who, what, cost, cost / ours))
    return rows


def markdown(rows):
    """The rows as a table for the README."""
    lines = [
        "| task | points | program | what it does | processor time (s) | times ours |",
        "|---|---|---|---|---|---|",
    ]
    for task, n, who, what, cost, ratio in rows:
        lines.append(f"| {task} | {n:,} | {who} | {what} | {cost:.3f} | {ratio:.1f} |")
    return "\n".join(lines)


def main():
    """Run both tasks, print them, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--points", type=int, nargs="+", default=[1_000_000])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write between its marks")
    options = parser.parse_args()
    print(f"Python {sys.version.split()[0]}, one thread")
    rows = compare("chart", CHART, chart(CHART_POINTS), max(options.repeats, 5))
    for n in options.points:
        rows += compare("neighbours", NEIGHBOURS, street(n), options.repeats)
    if options.markdown:
        text = options.markdown.read_text(encoding="utf-8")
        options.markdown.write_text(replaced(text, "peers", markdown(rows)), encoding="utf-8")


if __name__ == "__main__":
    main()
