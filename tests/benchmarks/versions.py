"""Processor time and memory beside an older version of the package, and growth with the size.

``PYTHONPATH=tests/benchmarks python tests/benchmarks/versions.py FOLDER`` takes the folder of an
older version, as ``git worktree add FOLDER v0.2.0`` makes it. Each case runs in a process of its
own, on both versions in turns, at three sizes. The table has the median of the ratios to the older
version and their range, the largest memory of the process, what was aimed at, and the exponent of
the growth. What a version lacks is left empty. Writes its section of RESULTS.md; with names of
cases only those, without writing.
"""

import argparse
import os
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pandas as pd
from results import write_section

HERE = Path(__file__).resolve().parents[2]

START = """
import resource, subprocess, sys, tempfile, time
from pathlib import Path
import numpy as np
n, rng = int(sys.argv[1]), np.random.default_rng(1)
xy = rng.random((n, 2)) * (n / 2000) ** 0.5
cloud = np.column_stack([xy, rng.normal(0, 0.003, n)])
folder = Path(tempfile.mkdtemp())
def used():
    both = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(one.ru_utime + one.ru_stime for one in both)
"""

END = """
spent = []
while len(spent) < 2 or len(spent) < 4 and sum(spent) < 10:
    began = used()
    call()
    spent.append(used() - began)
peaks = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
print(min(spent), max(one.ru_maxrss for one in peaks) / 1e6)
"""

WALLS = """
from mmqa_lab.lines import extract_edges
def two_walls(n, density):
    side = (n / (2 * density)) ** 0.5
    u, v, off = rng.random(n) * side, rng.random(n) * side, rng.normal(0, 0.005, n)
    half = np.arange(n) % 2 == 0
    return np.column_stack([np.where(half, u, off), np.where(half, off, u), v])
"""

CASES = {
    # name: sizes, what was aimed at, code that makes ``call``
    "quadrants, uniform (points)": (
        (50_000, 200_000, 800_000),
        "1.2 times",
        """
        from mmqa_lab.spacing import quadrant_distances
        quadrant_distances(rng.random((50_000, 2)))
        call = lambda: quadrant_distances(xy)
        """,
    ),
    "chart with intervals (points)": (
        (20_000, 200_000, 2_000_000),
        "1.2 times; 2 million 6 s, .8 GB",
        """
        from mmqa_lab.chart_cloud import evaluate_cloud
        call = lambda: evaluate_cloud(cloud).intervals()
        """,
    ),
    "map_cloud (points)": (
        (50_000, 200_000, 800_000),
        "1.2 times",
        """
        from mmqa_lab.maps import map_cloud
        call = lambda: map_cloud(cloud)
        """,
    ),
    "map of a campaign (points)": (
        (250_000, 1_000_000, 4_000_000),
        "1.3 us a point",
        """
        from mmqa_lab.cloud import Cloud
        from mmqa_lab.io import write_cloud
        from mmqa_lab.maps import map_campaign
        files = [folder / "west.laz", folder / "east.laz"]
        west = xy[:, 0] < np.median(xy[:, 0])
        for file, part in zip(files, (west, ~west)):
            write_cloud(file, Cloud(cloud[part]))
        def call():
            map_campaign(files, tempfile.mkdtemp(), cell=1.0)
        """,
    ),
    "measure_pattern (points)": (
        (4_000, 16_000, 64_000),
        "1.2 times",
        """
        from mmqa_lab.scan_pattern import measure_pattern
        along = np.arange(n) % 200
        line = np.arange(n) // 200
        wall = np.column_stack([0 * along, line * 0.05, along * 0.01 + 0.004 * line])
        wall += rng.normal(0, 0.003, wall.shape)
        time_s = line * 0.01 + along * 1e-6
        call = lambda: measure_pattern(wall, gps_time=time_s)
        """,
    ),
    "extract_edges, 60 points/m2 (points)": (
        (20_000, 80_000, 320_000),
        "1.2 times",
        """
        walls = two_walls(n, 60)
        call = lambda: extract_edges(walls)
        """,
    ),
    "extract_edges, 10 points/m2 (m2 of wall)": (
        (30_000, 80_000, 230_000),
        "40 s, 1 GB at 230,000 m2",
        """
        walls = two_walls(10 * n, 10)
        call = lambda: extract_edges(walls)
        """,
    ),
    "lhd, all pairs (segments)": (
        (50, 200, 800),
        "1.2 times",
        """
        from mmqa_lab.lines import lhd
        one = np.stack([rng.random((n, 3)) * 50, rng.random((n, 3)) * 50], axis=1)
        other = one + rng.normal(0, 0.02, one.shape)
        call = lambda: lhd(one, other)
        """,
    ),
    "poles, learned (m of a street of 10,000 pulses/m)": (
        (50, 150, 500),
        "5 million points 8 s",
        """
        from mmqa_lab import poles, simulate
        from mmqa_lab.simulate.scenes import Scene
        posts = [simulate.cylinder((5, y, 0), (5, y, 6), 0.08) for y in range(2, n, 20)]
        wall = simulate.rectangle((9, 0, 0), along=(0, n, 0), up=(0, 0, 8))
        scanner = simulate.Scanner(
            pulse_rate_hz=100_000, mirror_frequency_hz=100, heading_deg=45, tilt_deg=45,
            lever_arm_m=(0, 0, 2.5), range_noise_m=0.005,
        )
        street = simulate.scan(
            Scene([simulate.ground(), wall, *posts]), scanner, simulate.straight(n, 10), seed=1
        )
        call = lambda: poles.detect(street)
        """,
    ),
    "chart in a photograph (million pixels)": (
        (24, 100, 200),
        "3, 4, 6 s; .6, .8, 1.2 GB",
        """
        import cv2
        from mmqa_lab import chart_image, charts
        chart = charts.imaging_chart()
        grey = cv2.imread(str(Path(TESTS).parent / "data_samples/chart_photo.jpg"), 0)
        side = round(n**0.5 * 1000)
        street = rng.integers(90, 160, (side // 100, side // 100), dtype=np.uint8)
        photo = cv2.resize(street, (side, side), interpolation=cv2.INTER_CUBIC)
        photo[side // 2 :, side // 3 :][: grey.shape[0], : grey.shape[1]] = grey
        cv2.imwrite(str(folder / "photo.jpg"), photo)
        del photo
        call = lambda: chart_image.evaluate_file(folder / "photo.jpg", chart)
        """,
    ),
    "mmqa evaluate (points)": (
        (1_000, 3_000, 10_000),
        ".7 s",
        """
        from mmqa_lab.cloud import Cloud
        from mmqa_lab.io import write_cloud
        write_cloud(folder / "chart.laz", Cloud(cloud))
        order = [sys.executable, "-m", "mmqa_lab", "evaluate", folder / "chart.laz"]
        call = lambda: subprocess.run(order, check=True, capture_output=True)
        """,
    ),
    "mmqa --help": (
        (1, 2, 3),
        ".25 s",
        """
        order = [sys.executable, "-m", "mmqa_lab", "--help"]
        call = lambda: subprocess.run(order, check=True, capture_output=True)
        """,
    ),
}


def seconds(folder, code, size):
    """Processor time (s) and memory (GB) of a case in a fresh process of a version, or NaN."""
    tests = f"TESTS = {str(HERE / 'tests')!r}"
    text = START + tests + WALLS * ("two_walls" in code) + textwrap.dedent(code) + END
    threads = dict.fromkeys(("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    environment = os.environ | threads | {"PYTHONPATH": str(folder)}
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", text, str(size)],
        env=environment,
        cwd="/",
        capture_output=True,
        text=True,
    )
    if done.returncode:
        print(f"left out at {folder}: {done.stderr.strip().splitlines()[-1]}")
        return np.nan, np.nan
    return tuple(map(float, done.stdout.split()[-2:]))


def beside(name, older, turns):
    """Rows of a case, one a size, on both versions in turns."""
    sizes, aim, code = CASES[name]
    found = np.array(
        [
            [[seconds(folder, code, size) for folder in (older, HERE)] for size in sizes]
            for _ in range(turns)
        ]
    )
    times, peaks = found[..., 0], found[..., 1].max(axis=0)
    ratios = times[:, :, 1] / times[:, :, 0]
    before, today = np.median(times, axis=0).T
    slopes = [np.polyfit(np.log(sizes), np.log(one), 1)[0] for one in (before, today)]
    growth = dict(zip(("exponent, older", "exponent, today"), slopes, strict=True))
    rows = []
    for k, size in enumerate(sizes):
        row = {"case": name, "size": size, "older (s)": before[k], "today (s)": today[k]}
        row |= {"ratio": np.median(ratios[:, k])}
        row |= {"least": ratios[:, k].min(), "most": ratios[:, k].max()}
        row |= {"older (GB)": peaks[k, 0], "today (GB)": peaks[k, 1], "aim": aim}
        rows.append(row | growth)
    return pd.DataFrame(rows)


def main():
    """Run the cases in turns, print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="an older version")
    parser.add_argument("cases", nargs="*", help="beginnings of names; by default all")
    parser.add_argument("--turns", type=int, default=3)
    options = parser.parse_args()
    tables = []
    for name in CASES:
        if not options.cases or name.startswith(tuple(options.cases)):
            tables.append(beside(name, options.folder.resolve(), options.turns))
            print(tables[-1].round(3).to_string(index=False), flush=True)
    if not options.cases:
        write_section(f"Beside {options.folder.resolve().name}", pd.concat(tables))


if __name__ == "__main__":
    main()
