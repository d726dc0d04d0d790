"""What a reader of the README writes, with the types that it then has; read by a type checker only.

A wrong annotation of a public name makes one of these lines wrong (tests/test_types.py).
"""

from pathlib import Path
from typing import assert_type

import numpy as np
import pandas as pd

from mmqa_lab import (
    bench,
    boresight,
    chart_cloud,
    chart_image,
    charts,
    io,
    lines,
    maps,
    mtf,
    planes,
    poles,
    radiometry,
    repeatability,
    samples,
    scan_pattern,
    spacing,
    stats,
    test_field,
)
from mmqa_lab.cloud import Cloud
from mmqa_lab.simulate import Trajectory

cloud = io.read_cloud(samples.path("road_patch"))
assert_type(cloud, Cloud)
assert_type(cloud.points, np.ndarray)
quality = chart_cloud.evaluate_cloud(cloud, polygon=[[0, 0, 0], [1, 0, 0], [1, 1, 0]])
assert_type(quality.f, float)
assert_type(quality.e95_mm, float)
assert_type(quality.remarks, tuple[str, ...])
assert_type(quality.details(0.05)[0], float)
xy = cloud.points[:, :2]
assert_type(spacing.quadrants(xy).f, float)
assert_type(spacing.empty_space(xy).e95, float)
assert_type(spacing.directional(xy).g, float)
assert_type(planes.fit_plane([[0, 0, 0], [1, 0, 0], [0, 1, 0]]).std, float)
assert_type(planes.fit_circle(xy).radius, float)
assert_type(stats.wilson(3, 4).low, float)
assert_type(stats.errors([0.1, 0.2]).nmad, float)
assert_type(stats.median_interval(cloud["intensity"], [0, 1]), tuple[float, float])
segments = lines.extract_edges(cloud)
distance = lines.lhd([[[0, 0, 0], [0, 0, 6]]], np.zeros((1, 2, 3)), weight=2)
assert_type(distance.value, float)
assert_type(distance.remarks, tuple[str, ...])
found = poles.detect([[0, 0, 0]], method="itc")
score = poles.score(found, found, corridor=12)
assert_type(score.f1, float)
drive = [(Cloud(np.zeros((1, 3))), Trajectory([0, 2], [[0, 0, 2], [0, 20, 2]]))]
mounting = boresight.calibrate(drive, lever_arms_m=[[0, 0, 0]])
heights, differences = test_field.compare_heights(cloud, [[0, 0, 0]], radius=0.2)
sweep = {"pulse_rate_hz": 3e5, "mirror_frequency_hz": 200.0}
setup = scan_pattern.ScanSetup(**sweep, speed_m_s=np.arange(1, 9))
wall = scan_pattern.Target(range_m=5)
assert_type(scan_pattern.speeds(setup, wall, detail=0.05), pd.DataFrame)
edge = mtf.fit_edge(np.zeros((32, 32)))
assert_type(edge.mtf50, float)
line = radiometry.empirical_line([100, 500], [0.05, 0.45])
assert_type(line.reflectance(300), np.ndarray)
assert_type(radiometry.ndvi(0.4, 0.1)[0], np.ndarray)
layout = charts.imaging_chart()
where = chart_image.locate(None, layout, corners=[[0, 9], [9, 9], [9, 0], [0, 0]])
assert_type(where.pixels([[0, 0]]), np.ndarray)
table = repeatability.evaluate_selections(cloud, np.zeros((2, 4, 3)))
assert_type(repeatability.repeatability(table, "f").s_r, float)
cases = bench.grid(ratio=(1, 5))
maps.map_cloud(cloud, cell=0.5)
io.write_cloud(Path("part.laz"), cloud)
