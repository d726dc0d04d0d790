"""Study 12: its acquisitions, tasks with known answers, correlations, rules, and its checks."""

import numpy as np
import pandas as pd
import pytest
from conftest import spoiled
from hypothesis import given, settings
from hypothesis import strategies as st

from mmqa_lab.spacing import empty_space
from mmqa_lab.studies import fitness as study
from mmqa_lab.studies import fitness_text as texts

CASE = {"kind": "two heads", "speed_kmh": 40, "distance_m": 6, "pulse_rate_hz": 4e5}
CASE |= {"mirror_frequency_hz": 150, "noise_mm": 0, "heading_deg": 30, "tilt_deg": 30}
CASE |= {"height_m": 1, "turn_deg": 20}


def lines(apart, step=0.001):
    """Dense lines across a board, from its middle, m."""
    x, y = np.meshgrid(np.arange(-0.5, 0.5, step), np.arange(-0.5 + apart / 2, 0.5, apart))
    return np.column_stack([x.ravel(), y.ravel()])


def test_acquisitions_fill_their_ranges_and_halves_differ():
    one, two = (study.acquisitions(20, seed=seed) for seed in (1, 2))
    assert one["kind"].tolist() == np.repeat(study.KINDS, 20).tolist()
    for name, (low, high) in study.RANGES.items():
        heads = one[one["kind"] != "32 beams"][name]
        assert heads.between(low, high).all()
        assert np.ptp(heads) > 0.85 * (high - low)
        assert not np.isin(one[name], two[name]).any()


def test_all_points_of_a_drive_without_noise_lie_on_their_objects(monkeypatch):
    monkeypatch.setattr(study, "BORESIGHT_DEG", 0.0)
    points, surface, _ = study.drive(CASE, np.random.default_rng(1))
    for name in ("chart", "board"):
        assert len(points[name]) > 500
        assert np.abs(points[name][:, 2]).max() < 1e-9
        assert np.abs(points[name][:, :2]).max() < 0.5 + 1e-9
    assert study.step_mm(points["board"], points["stepped"]) < 1e-6
    assert study.sign_errors(points["board"])["tilt_deg"] < 1e-6
    assert study.corner_errors(points["corner"], surface["corner"])["edge_mm"] < 0.1
    assert study.post_errors(points["posts"])["pole_missed_percent"] == 0


def test_a_second_head_that_is_turned_shows_as_noise():
    rng = np.random.default_rng(1)
    board = study.drive(CASE, rng)[0]["board"]
    assert 0.01 < 1000 * np.abs(board[:, 2]).max() < 10  # 0.02 degrees are 2 mm at 6 m


@pytest.mark.parametrize("apart", [0.02, 0.03, 0.07])
def test_details_between_lines_are_missed_as_derived(apart):
    missed = study.detail_missed_percent(lines(apart), size_m=0.015, fewest=1)
    assert abs(missed - 100 * (1 - 0.015 / apart)) < 3


def test_places_of_details_cover_the_board():
    left, right = lines(0.01), lines(0.01)
    assert study.detail_missed_percent(left[left[:, 0] < 0]) == pytest.approx(47, abs=3)
    assert study.detail_missed_percent(right[right[:, 0] > 0]) == pytest.approx(47, abs=3)


@given(seed=st.integers(0, 50), density=st.integers(300, 4000))
@settings(max_examples=10, deadline=None)
def test_missed_details_are_those_of_the_empty_space_function(seed, density):
    xy = np.random.default_rng(seed).uniform(-0.5, 0.5, (density, 2))
    seen = empty_space(xy, rank=3).share(0.025)
    assert abs(study.detail_missed_percent(xy) - 100 * (1 - seen)) < 5


def test_ends_signs_and_steps_have_known_errors():
    grid = np.arange(-0.48, 0.481, 0.02)
    xy = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    assert abs(study.end_mm(xy) - 20) < 1e-6
    assert study.end_mm(np.empty((0, 2))) == 500
    tilted = np.column_stack([xy, 0.004 + 0.01 * xy[:, 0]])
    found = study.sign_errors(tilted)
    assert abs(found["tilt_deg"] - np.degrees(np.arctan(0.01))) < 1e-9
    assert abs(found["offset_mm"] - np.hypot(4, 2.5)) < 1e-9
    one_line = tilted[np.abs(xy[:, 1]) < 0.01]  # says nothing of a sign's tilt
    unseen = {name: study.UNSEEN[name] for name in ("offset_mm", "tilt_deg")}
    assert study.sign_errors(one_line) == pytest.approx(unseen)
    flat = np.column_stack([xy, np.zeros(len(xy))])
    half = np.where(xy[:, 0] > 0, -study.STEP, 0.0)
    middle = np.abs(xy[:, 0]) > 0.001
    assert study.step_mm(flat[middle], np.column_stack([xy, half])[middle]) < 1e-6
    assert study.step_mm(flat, flat) == pytest.approx(10 / np.sqrt(2))  # the step is not seen
    assert study.step_mm(flat[:0], flat[:0]) == study.UNSEEN["step_mm"]


def test_a_corner_struck_at_a_flat_angle_is_not_counted():
    points = np.random.default_rng(1).uniform(0, 1, (1000, 3))
    found = study.corner_errors(points, np.r_[np.zeros(970, int), np.ones(30, int)])
    assert np.isnan(found["edge_mm"])
    assert np.isnan(found["edge_missed_percent"])


def figures_and_errors(n=400, seed=0):
    """A density, a figure that is the error at equal density, a useless one, and constants."""
    rng = np.random.default_rng(seed)
    error, density = rng.uniform(0, 1, n), np.repeat(np.arange(4.0), n // 4)
    figures = pd.DataFrame({"density": density, "exact": error, "useless": rng.uniform(0, 1, n)})
    for name in ("d1", "d4", "f", "g"):
        figures[name] = 100.0
    return figures, pd.DataFrame({"task": error + 10 * density})


def test_a_figure_that_orders_within_a_density_is_found_in_bands_only():
    figures, errors = figures_and_errors()
    plain = study.correlations(figures, errors).set_index("method")
    bands = study.correlations(figures, errors, bands=4).set_index("method")
    assert plain.loc["density", "spearman"] > 0.95
    assert plain.loc["exact", "spearman"] < 0.5
    assert bands.loc["exact", "spearman"] == pytest.approx(1)
    assert abs(bands.loc["density", "spearman"]) < 0.1  # equal within its bands
    assert bands.loc["useless", "low"] < 0 < bands.loc["useless", "high"]
    assert (plain["low"] <= plain["spearman"]).all()
    assert plain.loc["f", "spearman"] == 0  # without spread


def test_thresholds_are_chosen_on_one_half_and_scored_on_the_other():
    figures, errors = figures_and_errors()
    first = np.arange(400) % 2 == 0
    errors = pd.DataFrame({"task": figures["exact"]})
    figures.loc[~first, "exact"] = figures["useless"][~first]  # says nothing in the other half
    found = study.rules(figures, errors, first, good={"task": 0.5}).set_index("rule")
    assert found.loc["exact", "chosen"] > 0.98
    assert 0.4 < found.loc["exact", "balanced"] < 0.6
    assert found.loc["accept all", "balanced"] == 0.5
    assert found.loc["exact", "limits"][0] == pytest.approx(0.5, abs=0.02)
    assert found.loc["density", "gain"] == 0
    assert found["n"].eq(200).all()


def test_a_task_that_nearly_all_clouds_are_fit_for_gets_no_rule():
    figures, errors = figures_and_errors()
    assert study.rules(figures, errors, np.arange(400) < 200, good={"task": 1e9}).empty


def test_rules_as_written_know_the_exemption():
    table = pd.DataFrame({"density": [18.0, 19], "d1": [5.0, 5], "d4": [18.0, 19], "f": [3.6, 3.8]})
    accepted = study.written(table.assign(g=[1.0, 3.0]))
    assert accepted["f < 2"].tolist() == [False, False]
    assert accepted["f < 2 or exempt"].tolist() == [True, False]
    assert accepted["density ≥ 3000"].tolist() == [True, False]
    assert accepted["g < 2 or exempt"].tolist() == [True, False]


def test_the_bench_takes_a_figure_of_ones_own_and_one_that_is_unknown_is_the_worst():
    methods = {"density": study.METHODS["density"], "mine": lambda chart: chart.n}
    bench = study.bench(methods=methods | {"none": lambda chart: np.nan}, count=1)
    with pytest.warns(UserWarning, match="none: 6 of 6 cells not measured"):
        results = bench.run()
    tables = bench.tables(results)
    assert next(iter(tables)) == "tasks"
    assert tables["tasks"]["method"].tolist() == ["density", "mine", "none"]
    assert set(study.GOOD) <= set(tables["tasks"])
    figures, errors = study.measured(results)
    assert len(figures) == len(errors) == 6
    assert np.isinf(figures["none"]).all()
    points = 5e5 / figures["density"] ** 2  # the outline has half a square metre
    assert points.to_numpy() == pytest.approx(figures["mine"].to_numpy(), rel=0.001)


def photographed(pixel_mm, **others):
    """A photograph of the text chart, and its truth."""
    case = {"spread_px": 0.5, "motion_px": 0.0, "white": 0.8, "noise_percent": 0.5, "roll_deg": 4}
    return texts.photographed(1, 0, seed=3, pixel_mm=pixel_mm, **(case | others))


def test_capitals_are_read_where_pixels_are_small_and_not_where_they_are_large():
    sharp, truth = photographed(2.0)
    assert truth == {"text_misread_percent": 0}
    assert photographed(14.0)[1]["text_misread_percent"] > 60
    assert sharp.pixel_mm == pytest.approx(2.0)
    figures = {name: method(sharp) for name, method in texts.METHODS.items()}
    assert 4 <= figures["resolved width"] <= 8
    blurred = texts.METHODS["MTF50"](photographed(2.0, motion_px=3.0)[0])
    assert blurred > 1.5 * figures["MTF50"]


def test_real_boards_and_roads_have_a_figure_and_an_error_each(real):
    real("boards/vlp16_pose02.laz")
    figures, errors = study.real_boards()
    assert len(figures) == len(errors) == 25
    real(study.ROAD)
    figures, errors = study.road_squares()
    assert len(figures) == len(errors) > 20
    assert (errors["offset_mm"] < 100).all()


def test_without_larger_clouds_there_is_no_real_part(monkeypatch):
    monkeypatch.delenv("MMQA_DATA", raising=False)
    assert study.real_boards() == study.road_squares() == (None, None)


def test_each_check_can_fail():
    names = ["density", "f", "sigma_MAD"]
    ends = {"low": [0.9, -0.4, -0.1], "high": [0.96, 0.0, 0.1], "n": 162}
    detail = pd.DataFrame({"spearman": [0.94, -0.2, 0.0]} | ends, index=names)
    tilted = pd.Series([0.5, 0.0, 0.8], index=names)
    sharp, soft = {"spearman": 0.9, "n": 60}, {"spearman": 0.1}
    whole = {"off": 1.0, "detail": detail, "rho": detail["spearman"], "tilted": tilted}
    whole |= {"sharp": sharp, "soft": soft}
    assert spoiled("fitness", whole) == []
    changes = {
        "The share of missed": {"off": 20.0},
        "The density orders": {"detail": detail.assign(high=0.95)},
        "sigma_MAD orders": {"tilted": tilted[::-1].set_axis(names)},
        "The blur": {"sharp": {"spearman": 0.0, "n": 60}},
    }
    for words, change in changes.items():
        (failed,) = spoiled("fitness", whole | change)
        assert failed.startswith(words)
