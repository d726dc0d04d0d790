"""What all results share: how they are asked for their intervals, and how they are shown."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest

from mmqa_lab import stats
from mmqa_lab._results import Shown, about, digits, printed
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


@dataclass(frozen=True)
class Made(Shown):
    """A result of every kind of field."""

    place: np.ndarray
    size: np.ndarray
    many: np.ndarray
    residuals: np.ndarray
    n: int
    word: str

    _metres = ("place", "half")
    _derived = ("half",)

    @property
    def half(self):
        """Half of n."""
        return self.n / 2


def test_a_result_is_a_row_of_its_numbers_with_units_by_their_axes():
    made = Made(np.array([1.0, 2]), np.arange(3.0), np.arange(4.0), np.zeros(3), 5, "a")
    (row,) = made.to_frame().to_dict("records")
    expected = {"place_x_m": 1.0, "place_y_m": 2.0, "size_x": 0.0, "size_y": 1.0, "size_z": 2.0}
    assert row == expected | {"n": 5, "word": "a", "half_m": 2.5}
    assert "Made" in made._repr_html_()
    assert made._repr_html_().count("<tr") == 1 + 8  # turned round, a line for each
    assert len(made.intervals()) == 0
    assert about("f", 2.0, 0.5, "m") == ("f", 2.0, 1.02, 2.98, "m")


@pytest.mark.parametrize(
    ("value", "text"),
    [(999.96, "1000"), (1000.0, "1000"), (1000.4567, "1000.457"), (-1234.5, "-1234.5"),
     (999_999_999.4, "999999999.4"), (1e9, "1e+09"), (0.99994, "0.9999"), (-0.0, "0"),
     (1500.0, "1500"), (12.3456, "12.35")],
)  # fmt: skip
def test_numbers_have_four_digits_or_all_before_the_point(value, text):
    assert digits(value) == text


def test_tables_keep_millimetres_of_coordinates_and_words_as_they_are():
    values = [0.123456, 1.0, 452_123.45678, 2e9, np.nan]
    table = pd.DataFrame({"x_m": values, "f": values, "y_deg": values, "x": values})
    table = table.assign(n=[*range(5)], word=[*"abcde"])
    found = printed(table, missing="none")
    assert found["x_m"].tolist() == ["0.1235", "1.000", "452123.457", "2e+09", "none"]
    assert found["f"].tolist() == ["0.1235", "1", "452123.457", "2e+09", "none"]
    assert found["x"].tolist()[:3] == ["0.1234560", "1.0000000", "452123.4567800"]
    assert found["n"].tolist() == [*range(5)]
    assert found["word"].tolist() == [*"abcde"]
    negative = printed(pd.DataFrame({"x_m": [-0.5, -1.0, -20.12345]}))["x_m"].tolist()
    assert negative == ["-0.5", "-1.000", "-20.123"]
    assert len(printed(pd.DataFrame(index=[0, 1]))) == 2
