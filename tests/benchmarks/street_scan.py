"""Scan 1e7 pulses along a street of 200 objects and 1e5 leaves: seconds, megabytes, and Embree.

Run as ``python tests/benchmarks/street_scan.py [PULSES]``. To reach: 1e7 pulses under 60 s on two
cores and within 2 GB, memory independent of the length of the drive.
"""

import resource
import sys
import time
from dataclasses import replace

import numpy as np

from mmqa_lab import simulate
from mmqa_lab.simulate import PRESETS
from mmqa_lab.simulate.surfaces import foliage

LENGTH = 400.0


def street(rng):
    """Ground, facades with windows, and 200 lamps, cars, trees and signs."""
    surfaces = [simulate.ground(size=(200, 2 * LENGTH), centre=(0, LENGTH / 2))]
    for side in (-1, 1):
        for k in range(20):
            start = (side * 14, 20 * k + (0 if side > 0 else 20), 0)
            windows = [(1 + 3 * i, 1 + 3 * j, 1.2, 1.6) for i in range(6) for j in range(4)]
            surfaces.append(simulate.wall(start, (0, side * 20, 0), 13, openings=windows))
    for k in range(50):
        x, y = rng.uniform(4, 10, 4) * rng.choice([-1, 1], 4), rng.uniform(0, LENGTH, 4)
        surfaces += [
            simulate.cylinder((x[0], y[0], 0), (x[0], y[0], 7), 0.09, top_radius=0.05),
            simulate.box((x[1], y[1], 0), (1.8, 4.4, 1.5), heading=rng.uniform(-5, 5)),
            simulate.board((x[2], y[2], 2.4), 0.6, 0.6, heading=180),
            simulate.cylinder((x[3], y[3], 0), (x[3], y[3], 3), 0.15),
            foliage((x[3], y[3], 5), 2, leaves=2000, leaf_radius=0.05, seed=k),
        ]
    return simulate.Scene(surfaces)


def drive(scene, scanner, pulses, **options):
    """Seconds and points of a drive of so many pulses at 36 km/h."""
    path = simulate.straight(10 * pulses / scanner.pulse_rate_hz, 10, start=(0, 20, 0))
    began, points = time.perf_counter(), 0
    for cloud in simulate.scan(scene, scanner, path, seed=1, **options):
        points += len(cloud)
    return time.perf_counter() - began, points


def against_embree(rng, n=1_000_000):
    """Ratio of the times for the same triangles and rays, where trimesh and embreex are there."""
    try:
        import trimesh
        from trimesh.ray.ray_pyembree import RayMeshIntersector
    except ImportError:
        print("Embree: trimesh and embreex are not installed")
        return
    corners = rng.uniform(-30, 30, (20_000, 1, 3)) + rng.uniform(-0.5, 0.5, (20_000, 3, 3))
    mesh = trimesh.Trimesh(corners.reshape(-1, 3), np.arange(60_000).reshape(-1, 3), process=False)
    embree = RayMeshIntersector(mesh)
    scene = simulate.Scene([simulate.polygon(c) for c in corners])
    direction = rng.standard_normal((n, 3))
    origin = np.zeros((n, 3))
    scene.cast(origin[:1000], direction[:1000])
    times = []
    for cast in (
        lambda: scene.cast(origin, direction),
        lambda: embree.intersects_first(origin, direction),
    ):
        began = time.perf_counter()
        cast()
        times.append(time.perf_counter() - began)
    ours, theirs = times
    print(
        f"1e6 random rays, 20,000 triangles: {ours:.2f} s in float64, Embree (float32) "
        f"{theirs:.2f} s, ratio {ours / theirs:.1f}"
    )


def main(pulses):
    """Print the figures."""
    rng = np.random.default_rng(1)
    began = time.perf_counter()
    scene = street(rng)
    print(
        f"scene: {len(scene.surfaces)} surfaces, {len(scene.tree.kind)} primitives, "
        f"{time.perf_counter() - began:.1f} s"
    )
    thin = replace(
        PRESETS["vq-450"], pulse_rate_hz=1e6, lever_arm_m=(0, 0, 2.5), divergence_mrad=0.0
    )
    wide = replace(thin, divergence_mrad=0.3)
    drive(scene, wide, 1e5)
    for name, scanner in (("lines", thin), ("beams of seven rays", wide)):
        for share in (0.25, 1.0):
            seconds, points = drive(scene, scanner, share * pulses)
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            print(
                f"{name}: {share * pulses:.3g} pulses in {seconds:.1f} s "
                f"({1e6 * seconds / (share * pulses):.2f} us each), {points} points, "
                f"peak {peak:.0f} MB"
            )
    against_embree(rng)


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 1e7)
