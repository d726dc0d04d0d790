"""Measure the map of a campaign: time over points, share of reading, memory, and workers.

A street is simulated by this package's ray caster, and laid out one stretch after the other as LAZ
files of a million points each. Every run is ``mmqa map`` in a process of its own; its processor
time, with that of its workers, stands beside that of laspy reading the same files whole. Each size
is measured with one worker and with two.

    python tests/benchmarks/campaign.py --points 1e6 1e7 1e8 --markdown README.md
"""

import argparse
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

os.environ |= {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

import numpy as np

from mmqa_lab.cloud import Cloud
from mmqa_lab.io import write_cloud
from mmqa_lab.maps import METRICS
from mmqa_lab.run.pages import replaced

PER_FILE = 1_000_000

HEAD = (
    *("points", "surface", "workers", "wall s", "CPU s", "us a point", "reading", "x laspy", "MB"),
)

READ_ALL = """
import sys, laspy
for path in sys.argv[1:]:
    with laspy.open(path) as reader:
        for part in reader.chunk_iterator(1_000_000):
            part.x, part.y, part.z
"""

READ_OURS = """
import sys
from mmqa_lab.io.clouds import iterate_cloud
for path in sys.argv[1:]:
    for cloud in iterate_cloud(path, columns=()):
        pass
"""


def stretch():
    """A million points of a street with a road and two facades, and its length."""
    from mmqa_lab import simulate

    length = 40.0
    scene = simulate.Scene(
        [
            simulate.ground(),
            simulate.rectangle((9, -60, 0), along=(0, 160, 0), up=(0, 0, 9), label="wall"),
            simulate.rectangle((-7, -60, 0), along=(0, 160, 0), up=(0, 0, 9), label="wall"),
        ]
    )
    scanner = simulate.ProfileScanner(
        pulse_rate_hz=500_000,
        mirror_frequency_hz=100,
        heading_deg=45,
        tilt_deg=30,
        lever_arm_m=(0, 0, 2.5),
        range_noise_m=0.005,
        max_range_m=60,
    )
    cloud = simulate.scan_all(scene, scanner, simulate.straight(length, 10), seed=1)
    rows = np.linspace(0, len(cloud) - 1, PER_FILE).astype(int)
    return Cloud(cloud.points[rows], {"gps_time": cloud["gps_time"][rows]}), length


def write_files(folder, points):
    """LAZ files of a million points each; returns their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"street_{k:03d}.laz" for k in range(max(1, round(points / PER_FILE)))]
    missing = [(k, path) for k, path in enumerate(paths) if not path.is_file()]
    if missing:
        cloud, length = stretch()
        for k, path in missing:
            move = [600_000, 5_200_000 + k * length, 100]
            moved = Cloud(cloud.points + move, {"gps_time": cloud["gps_time"] + 4.0 * k})
            write_cloud(path, moved)
    return paths


def child(command):
    """Wall time and processor time of a process and its children."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    began = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.perf_counter() - began, spent


def peak_megabytes():
    """Most memory that any child process had so far."""
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024


def measure(paths, surface, workers, metrics, folder):
    """Wall and processor time of one map, from nothing."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    command = [sys.executable, "-m", "mmqa_lab", "map", *map(str, paths), "--surface", surface]
    command += ["--metrics", metrics, "--workers", str(workers)]
    found = child([*command, "--out", str(folder / "map.nc")])
    shutil.rmtree(folder)
    return found


def main():
    """Print a row for each size, surface and number of workers."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--points", type=float, nargs="+", default=[1e6, 1e7])
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--surface", nargs="+", default=["local", "horizontal"])
    parser.add_argument("--metrics", default=",".join(METRICS))
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "campaign")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write between its marks")
    options = parser.parse_args()
    print("  ".join(f"{text:>12}" for text in HEAD))
    rows = []
    for points in options.points:
        paths = write_files(options.folder / "files", points)
        names = list(map(str, paths))
        _, laspy_cpu = child([sys.executable, "-c", READ_ALL, *names])
        _, ours_cpu = child([sys.executable, "-c", READ_OURS, *names])
        for surface in options.surface:
            for workers in options.workers:
                run = options.folder / "run"
                wall, cpu = measure(paths, surface, workers, options.metrics, run)
                n = len(paths) * PER_FILE
                row = (
                    *(f"{n:,}", surface, str(workers), f"{wall:.1f}", f"{cpu:.1f}"),
                    *(f"{1e6 * cpu / n:.2f}", f"{ours_cpu / cpu:.2f}", f"{cpu / laspy_cpu:.1f}"),
                    f"{peak_megabytes():.0f}",
                )
                print("  ".join(f"{text:>12}" for text in row), flush=True)
                rows.append(row)
    if options.markdown:
        text = options.markdown.read_text(encoding="utf-8")
        table = "\n".join(f"| {' | '.join(row)} |" for row in (HEAD, ["---"] * len(HEAD), *rows))
        options.markdown.write_text(replaced(text, "campaign", table), encoding="utf-8")


if __name__ == "__main__":
    main()
