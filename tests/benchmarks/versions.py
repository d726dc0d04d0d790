"""Processor time beside an older version of the package, and its growth with the size.

``PYTHONPATH=tests/benchmarks python tests/benchmarks/versions.py FOLDER`` takes the folder of an
older version, as ``git worktree add FOLDER v0.2.0`` makes it. Each case runs in a process of its
own, on both versions in turns, at three sizes. The table has the median of the ratios to the older
version and their range, and the exponent of the growth. What a version lacks is left empty. Writes
its section of RESULTS.md; with names of cases only those, without writing.
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
import sys, time, tempfile
import numpy as np
n, rng = int(sys.argv[1]), np.random.default_rng(1)
xy = rng.random((n, 2)) * (n / 2000) ** 0.5
cloud = np.column_stack([xy, rng.normal(0, 0.003, n)])
folder = tempfile.mkdtemp()
"""

END = """
call()
spent = []
for _ in range(3):
    began = time.process_time()
    call()
    spent.append(time.process_time() - began)
print(min(spent))
"""

CASES = {
    # name: sizes, code that makes ``call``
    "quadrants, uniform (points)": (
        (50_000, 200_000, 800_000),
        """
        from mmqa_lab.spacing import quadrant_distances
        quadrant_distances(rng.random((50_000, 2)))
        call = lambda: quadrant_distances(xy)
        """,
    ),
    "chart with intervals (points)": (
        (5_000, 50_000, 500_000),
        """
        from mmqa_lab.chart_cloud import evaluate_cloud
        call = lambda: evaluate_cloud(cloud).intervals()
        """,
    ),
    "map_cloud (points)": (
        (50_000, 200_000, 800_000),
        """
        from mmqa_lab.maps import map_cloud
        call = lambda: map_cloud(cloud)
        """,
    ),
    "measure_pattern (points)": (
        (4_000, 16_000, 64_000),
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
    "extract_edges (points of two walls)": (
        (20_000, 80_000, 320_000),
        """
        from mmqa_lab.lines import extract_edges
        side = (n / 120) ** 0.5  # 60 points/m2
        u, v, off = rng.random(n) * side, rng.random(n) * side, rng.normal(0, 0.005, n)
        half = np.arange(n) % 2 == 0
        walls = np.column_stack([np.where(half, u, off), np.where(half, off, u), v])
        call = lambda: extract_edges(walls)
        """,
    ),
    "lhd, all pairs (segments)": (
        (50, 200, 800),
        """
        from mmqa_lab.lines import lhd
        one = np.stack([rng.random((n, 3)) * 50, rng.random((n, 3)) * 50], axis=1)
        other = one + rng.normal(0, 0.02, one.shape)
        call = lambda: lhd(one, other)
        """,
    ),
    "poles, learned (points of a street)": (
        (20, 40, 80),
        """
        from mmqa_lab import poles, simulate
        from mmqa_lab.simulate.scenes import Scene
        posts = [simulate.cylinder((5, y, 0), (5, y, 6), 0.08) for y in range(2, n, 6)]
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
    "chart in a photograph (pixels a side)": (
        (1000, 2000, 4000),
        """
        import sys
        sys.path.insert(0, TESTS)
        import camera
        from mmqa_lab import chart_image, charts
        chart = charts.imaging_chart()
        shot = camera.shoot(chart, 5400 / n, seed=1, noise=0.01, margin=0.15)
        grey = np.clip(shot.linear, 0, 1)
        call = lambda: chart_image.evaluate_image(grey, chart, chart_image.locate(grey, chart))
        """,
    ),
}


def seconds(folder, code, size):
    """Processor time of a case in a fresh process of a version; NaN where it lacks something."""
    tests = f"TESTS = {str(HERE / 'tests')!r}"
    text = START + tests + textwrap.dedent(code) + END
    threads = dict.fromkeys(("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    environment = os.environ | threads | {"PYTHONPATH": str(folder)}
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", text, str(size)],
        **{"env": environment, "cwd": "/", "capture_output": True, "text": True},
    )
    if done.returncode:
        print(f"left out at {folder}: {done.stderr.strip().splitlines()[-1]}")
        return np.nan
    return float(done.stdout.split()[-1])


def main():
    """Run the cases in turns, print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="an older version")
    parser.add_argument("cases", nargs="*", help="beginnings of names; by default all")
    parser.add_argument("--turns", type=int, default=3)
    options = parser.parse_args()
    rows = []
    for name, (sizes, code) in CASES.items():
        if options.cases and not name.startswith(tuple(options.cases)):
            continue
        versions = (options.folder.resolve(), HERE)
        times = np.array(
            [
                [[seconds(folder, code, size) for folder in versions] for size in sizes]
                for _ in range(options.turns)
            ]
        )
        ratios = times[:, :, 1] / times[:, :, 0]
        older, today = np.median(times, axis=0).T
        slopes = [np.polyfit(np.log(sizes), np.log(one), 1)[0] for one in (older, today)]
        growth = dict(zip(("exponent, older", "exponent, today"), slopes, strict=True))
        for k, size in enumerate(sizes):
            row = {"case": name, "size": size, "older (s)": older[k], "today (s)": today[k]}
            row |= {"ratio": np.median(ratios[:, k])}
            row |= {"least": ratios[:, k].min(), "most": ratios[:, k].max()}
            rows.append(row | growth)
        print(pd.DataFrame(rows[-len(sizes) :]).round(3).to_string(index=False), flush=True)
    if not options.cases:
        write_section(f"Beside {options.folder.resolve().name}", pd.DataFrame(rows))


if __name__ == "__main__":
    main()
