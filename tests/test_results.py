"""What all results share: how they are asked for their intervals, and how they are shown."""

import numpy as np
import pandas as pd
import pytest

from mmqa_lab import stats
from mmqa_lab._results import Shown, about
from mmqa_lab.boresight import Calibration
from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.lines import lhd
from mmqa_lab.mtf import StarMtf, fit_edge
from mmqa_lab.mtf.transfer import spread_edge
from mmqa_lab.planes import fit_circle, fit_plane
from mmqa_lab.poles import score
from mmqa_lab.radiometry import fit_sensor
from mmqa_lab.repeatability import Repeatability
from mmqa_lab.scan_pattern.measure import measure_pattern
from mmqa_lab.spacing import directional, empty_space, quadrants

COLUMNS = ["figure", "value", "low", "high", "unit"]
RNG = np.random.default_rng(1)
SQUARE = RNG.random((400, 3)) * [1, 1, 0.01]
LINES = np.array([[[x, 0, 0], [x, y, 6]] for x in (0, 9) for y in (0, 5)], dtype=float)
ALONG, LINE = (one.ravel() for one in np.meshgrid(np.arange(-20, 21) * 0.02, np.arange(-6, 7)))
WALL = np.stack([0 * ALONG, 0.05 * LINE, ALONG], axis=-1) + 1e-3 * RNG.normal(size=(533, 3))
ROWS, COLS = np.mgrid[:60, :40]
EDGE = spread_edge((COLS - 20 + 0.1 * ROWS - 3) / np.hypot(1, 0.1), 0.7, np.arctan(0.1))
TURN = np.linspace(0, 6, 40)
CIRCLE = np.stack([np.cos(TURN), np.sin(TURN)], axis=1) + 0.01 * RNG.normal(size=(40, 2))
F = np.linspace(0.02, 0.5, 97)
STAR = np.exp(-2 * (np.pi * 0.8 * F) ** 2)
FOUND = {"x_m": [0.0, 5.0], "y_m": [0.0, 0.0]}

RESULTS = {
    "evaluate_cloud": (lambda: evaluate_cloud(SQUARE), "density std sigma_mad d1 d2 d3 d4 f g e95"),
    "quadrants": (lambda: quadrants(SQUARE), "d1 d2 d3 d4 f"),
    "directional": (lambda: directional(SQUARE), "along across g"),
    "empty_space": (lambda: empty_space(SQUARE), ""),
    "fit_plane": (lambda: fit_plane(SQUARE), ""),
    "fit_circle": (lambda: fit_circle(CIRCLE), "x y"),
    "lhd": (lambda: lhd(LINES + RNG.normal(0, 0.02, LINES.shape), LINES), "lhd"),
    "displacement": (
        lambda: lhd(LINES + 0.1, LINES).displacement,
        "displacement_x displacement_y displacement_z",
    ),
    "wilson": (lambda: stats.wilson(3, 10), "share"),
    "bootstrap": (lambda: stats.bootstrap(np.mean, np.arange(9.0)), "statistic"),
    "score": (lambda: score(*[pd.DataFrame(FOUND)] * 2), "recall precision"),
    "repeatability": (lambda: Repeatability(100.0, 1.0, 0.0, 0.0, 0.8, 1.2, 4, 40), "s_r"),
    "fit_edge": (lambda: fit_edge(EDGE + RNG.normal(0, 0.01, EDGE.shape)), "mtf50"),
    "star": (lambda: StarMtf(F, STAR, 0.01 + 0 * F, 9 / F, (50.0, 50.0)), "mtf50"),
    "measure_pattern": (lambda: measure_pattern(WALL, scan_line=LINE), None),
    "fit_sensor": (lambda: fit_sensor([10, 20, 40, 80], [120, 221, 420, 822]), "gain offset"),
}


@pytest.mark.parametrize("name", RESULTS)
def test_every_result_is_asked_for_its_intervals_in_one_way(name):
    make, figures = RESULTS[name]
    result = make()
    table = result.intervals()
    assert isinstance(result, Shown)
    assert list(table)[:5] == COLUMNS
    assert figures is None or table["figure"].tolist() == figures.split()
    known = table.dropna()
    assert (known["low"] <= known["value"]).all()
    assert (known["value"] <= known["high"]).all()
    assert len(known) or name in ("empty_space", "fit_plane")


def test_the_interval_of_normal_errors_is_that_of_the_table():
    assert about("x", 10.0, 1.0, "m") == ("x", 10.0, pytest.approx(8.04), pytest.approx(11.96), "m")


def test_intervals_of_a_calibration_are_those_of_its_table():
    table = pd.DataFrame({"head": [0, 0], "parameter": ["roll_deg", "x_m"]})
    table = table.assign(value=[0.1, 0.2], std=0.01, low=[0.08, 0.18], high=[0.12, 0.22])
    found = Calibration(table, np.zeros((1, 3))).intervals()
    assert found["figure"].tolist() == ["roll_deg of head 0", "x_m of head 0"]
    assert found["unit"].tolist() == ["deg", "m"]
    assert found[["low", "high"]].to_numpy().tolist() == [[0.08, 0.12], [0.18, 0.22]]


@pytest.mark.parametrize("n", [3, 4])
def test_residuals_are_no_vector_however_few_they_are(n):
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.1]])[:n]
    assert not [name for name in fit_plane(points).to_frame() if "residual" in name]
