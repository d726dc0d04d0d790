"""Fit for what? Figures of a chart beside what can be done with a cloud of the same acquisition."""

from dataclasses import replace

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree
from scipy.stats import qmc, rankdata

from mmqa_lab import bench as benches
from mmqa_lab import poles
from mmqa_lab.chart_cloud import chart_polygon, evaluate_cloud
from mmqa_lab.lines import extract_edges
from mmqa_lab.simulate import PRESETS, Scanner, Scene, cylinder, rectangle, straight, systems
from mmqa_lab.spacing import exempt

RANGES = {
    "speed_kmh": (10, 80),
    "distance_m": (4, 25),
    "pulse_rate_hz": (1e5, 2e6),
    "mirror_frequency_hz": (48, 250),
    "noise_mm": (1, 20),
    "heading_deg": (0, 45),
    "tilt_deg": (0, 45),
    "height_m": (0, 2),
    "turn_deg": (-30, 30),
}
"""From which acquisitions are drawn: those of the five sources, and of heads of today (2 MHz and
250 Hz). They were fixed before any score was computed. Rates are of one head. The scanner is
``height_m`` above the middle of the objects, which are turned from the road by ``turn_deg``."""

BEAMS = {"pulse_rate_hz": (3e5, 1.4e6), "mirror_frequency_hz": (5, 20)}
"""The rates of scanners with 32 beams."""

LOGARITHMIC = ("distance_m", "pulse_rate_hz", "mirror_frequency_hz", "noise_mm")
"""Drawn evenly in their logarithm, the others evenly."""

KINDS = ("one head", "two heads", "32 beams")

BORESIGHT_DEG = 0.02
"""Standard deviation by which a second head is turned against the first, about each axis."""

GOOD = {
    "detail_missed_percent": 5,
    "end_mm": 10,
    "step_mm": 2.5,
    "offset_mm": 3,
    "tilt_deg": 0.5,
    "edge_missed_percent": 10,
    "edge_mm": 10,
    "pole_missed_percent": 0,
    "diameter_mm": 20,
}
"""The tasks, and the largest error with which a cloud is fit for each; fixed beforehand, too."""

STEP_M = 0.01

DIAMETERS_M = (0.06, 0.12, 0.30)
