"""The study: what its streets are, what it counts, what it sets side by side, its checks."""

import built_street
import gated_street
import numpy as np
import other_street
import pandas as pd
import poles_training as training
import pytest
from conftest import spoiled

from mmqa_lab import io, poles, published, stats
from mmqa_lab.cloud import Cloud
from mmqa_lab.poles import learned
from mmqa_lab.published import ledger
from mmqa_lab.simulate import streets
from mmqa_lab.studies import poles as study

COLUMNS = ["method", "quantity", "corridor_m", "class"]


@pytest.fixture(scope="module")
def surveyed():
    """One short street and its truth."""
    return study.scene(seed=5001, length=60.0, speed=14.0)


@pytest.fixture(scope="module")
def counted():
    """The bench on two short streets, without the learned method."""
    methods = {name: study.METHODS[name] for name in ("fgi", "itc")}
    return study.bench(methods=methods, seeds=(5001, 5003), length=30.0, speed=14.0).run()


def test_every_target_is_a_surface_of_its_class():
    made = streets.street("green", length=60, seed=2)
    assert (made.labels[made.targets["surface"]] == made.targets["class"]).all()


def test_visible_targets_count_the_points_of_the_shaft_below_the_crown(surveyed):
    cloud, truth = surveyed
    for kind in ("lamp", "tree"):
        own = truth["targets"][truth["targets"]["class"] == kind]
        one = own.nlargest(1, "points").iloc[0]
        height = cloud.points[cloud["surface"] == one["surface"], 2] - one["z_base_m"]
        assert one["points"] == (height <= one["clear_height_m"]).sum() > 10


def test_a_street_driven_back_is_seen_from_the_other_side(surveyed):
    cloud, truth = surveyed
    both, same = study.scene(seed=5001, length=60.0, speed=14.0, both_ways=True)
    assert np.array_equal(both.points[: len(cloud)], cloud.points)
    assert same["targets"].equals(truth["targets"])
    back = both[len(cloud) :]
    assert len(back) > 0.8 * len(cloud)
    assert back["scan_line"].min() > cloud["scan_line"].max()
    # time runs backwards along the street
    assert np.corrcoef(back["gps_time"], back.points[:, 1])[0, 1] < -0.9


def test_counts_are_those_of_the_scores(surveyed):
    cloud, truth = surveyed
    found = poles.detect(cloud, method="fgi")
    numbers = study.counts(found, truth)
    for corridor in study.CORRIDORS_M:
        inside = {"corridor": corridor, "trajectory": truth["path"]}
        score = poles.score(found, truth["targets"], **inside)
        end = f"{corridor:g}"
        hits = numbers[f"hits_{end}"], numbers[f"finds_{end}"]
        assert hits == (score.precision.k, score.precision.n)
        parts = [numbers[f"{kind}_targets_{end}"] for kind in study.CLASSES]
        assert sum(parts) == numbers[f"targets_{end}"] == score.recall.n


def test_rates_pool_the_streets(counted):
    rates = study.rates(counted).set_index(COLUMNS)
    names = ("hits", "targets", "finds")
    hits, targets, finds = (
        int(counted[f"{name}_30"].sel({"method": "fgi"}).sum()) for name in names
    )
    recall, row = stats.wilson(hits, targets), rates.loc[("fgi", "recall", 30.0, "all")]
    assert (row["k"], row["n"], row["low"], row["high"]) == (hits, targets, recall.low, recall.high)
    f1 = rates.loc[("fgi", "f1", 30.0, "all"), "value"]
    assert f1 == pytest.approx(2 * hits / (targets + finds))
    assert np.isnan(study.rates(counted.isel(seed=[0])).query("quantity == 'f1'")["low"]).all()


def test_differences_are_those_of_the_same_streets(counted):
    rates = study.rates(counted).query("quantity == 'f1' and corridor_m == 30").set_index("method")
    one = study.differences(counted, "fgi").squeeze()
    assert one["other"] == "itc"
    assert one["less"] == pytest.approx(rates["value"]["fgi"] - rates["value"]["itc"])
    assert one["low"] <= one["less"] <= one["high"]
    worse = counted.assign(hits_30=counted["hits_30"].where(counted["method"] == "fgi", 0))
    assert study.differences(worse, "fgi")["less"][0] == pytest.approx(rates["value"]["fgi"])
    single = study.differences(counted.isel(seed=[0]), "itc")
    assert single["low"].isna().all()
    fgi = {"method": "fgi"}
    alone = counted[["hits_30", "targets_30", "finds_30"]].sel(fgi)
    same = counted.assign({name: 0 * counted[name] + alone[name] for name in alone})
    assert (study.differences(same, "fgi")[["less", "low", "high"]] == 0).all(axis=None)


def test_a_method_of_ones_own_gets_rates(surveyed):
    _, truth = surveyed

    def oracle(cloud):
        return truth["targets"].query("visible")[["x_m", "y_m", "z_base_m", "height_m"]]

    methods = {"oracle": oracle, "nothing": lambda cloud: pd.DataFrame({"x_m": [], "y_m": []})}
    results = study.bench(methods=methods, seeds=(5001,), length=60.0, speed=14.0).run()
    rates = study.rates(results).query("corridor_m == 30 and `class` == 'all'")
    value = rates.set_index(["method", "quantity"])["value"]
    assert value["oracle", "recall"] == value["oracle", "precision"] == 1
    assert value["nothing", "recall"] == 0
    assert np.isnan(value["nothing", "precision"])


def test_published_counts_round_to_the_printed_rates():
    printed = ledger.cells().query("source == 'eurosdr2013_mls'").set_index("cell")["value"]
    text = published.table("eurosdr2013_mls", "poles_text").set_index("id")["n"]
    for *_, cell, k, n, _ in study.PRINTED:
        assert n == 0 or round(100 * k / n, 1) == printed[cell]
        assert cell not in text or n == text[cell]


def example_rates():
    """Rates as the report has them, the learned method above."""
    rows = []
    for *key, _, k, n, _ in study.PRINTED:
        rows.append((*key, *vars(stats.wilson(k or 80, n or 100)).values()))
    columns = [*COLUMNS, "k", "n", "value", "low", "high"]
    return pd.DataFrame(rows, columns=columns)


def test_every_printed_rate_stands_beside_ours():
    beside = study.beside_published(example_rates(), example_rates())
    same = beside[beside["method"] == "fgi"]
    # printed with one decimal of a percent
    assert np.allclose(same["published"], same["measured"], atol=0.0005)
    assert beside.loc[beside["method"] == "itc", "published_low"].isna().all()
    cells = ledger.cells().query("source == 'eurosdr2013_mls' and role == 'result'")
    asked = cells[cells["table"].isin(["table_4_1", "table_4_2"])]
    left = set(asked["cell"]) - set(beside["cell"])
    assert all(name.endswith(" n") or name.startswith(("targets", "state")) for name in left), left


def test_each_check_fails_when_its_statement_is_false():
    known = {
        "NAMES": {"learned": "a", "fgi": "b", "itc": "c"},
        "f1": {"a": 0.9, "b": 0.8, "c": 0.6},
    }
    known["row"] = {"measured": 0.7, "measured_low": 0.6, "measured_high": 0.8, "published": 0.7}
    known["row"] |= {"published_low": 0.65, "published_high": 0.75}
    known |= {"recalls": [0.6, 0.9], "behind": []}
    assert spoiled("poles", known) == []
    for name, wrong in {
        "behind": ["recall"],
        "row": known["row"] | {"measured_low": 0.8, "measured_high": 0.9},
        "recalls": [0.9, 0.6],
    }.items():
        assert len(spoiled("poles", known | {name: wrong})) == 1


def test_shafts_are_crowded_by_what_stands_around_them(surveyed):
    cloud, truth = surveyed
    result = poles.score(pd.DataFrame({"x_m": [0.0], "y_m": [20.0]}), truth["targets"])
    assert len(study.outcomes(result)["false alarm"]) == 1
    alone = cloud[np.isin(cloud["surface"], truth["targets"]["surface"])]
    assert study.crowded(result, alone).k == 0
    assert study.crowded(result, cloud).n == truth["targets"]["visible"].sum()


@pytest.mark.parametrize("scanner", ["tilted profiler", "16 beams"])
def test_rates_on_streets_of_another_generator(scanner):
    street = other_street.make(301, length=30.0)
    points, time, line, pole, path = other_street.scan(street, scanner, 301)
    truth, _ = other_street.tables(street, pole)
    found = poles.detect(Cloud(points, {"scan_line": line, "gps_time": time}))
    # 12 poles: loose on purpose, the benchmark measures
    assert poles.score(found, truth, corridor=30, trajectory=path).f1 > 0.75


def test_paired_differences_are_those_of_mcnemar():
    truth = pd.DataFrame({"x_m": 5.0 * np.arange(40), "y_m": 0.0})
    one, other = (poles.score(truth.iloc[rows], truth) for rows in (range(24), range(24, 40)))
    said = study.paired(one, other)
    assert (said["only_one"], said["only_other"]) == (24, 16)
    assert said["p"] == pytest.approx(0.268, abs=0.001)  # of 40 fair coins 24 heads or more, twice
    assert study.paired(one, one) == {"only_one": 0, "only_other": 0, "p": 1.0}


def test_pillars_of_gates_are_no_poles():
    points, _, _, truth, path, street = gated_street.looked_at(954, "tilted profiler", 30.0)
    found = poles.detect(points)
    score = poles.score(found, truth, corridor=30, trajectory=path)
    # 10 poles: loose on purpose, the benchmark measures
    assert score.recall.value > 0.85
    round_ = score.hits["diameter_m"].notna()
    assert round_.sum() >= 3
    assert score.hits["distance_m"][round_].max() < 0.05
    pillars = pd.DataFrame(np.array(street.pillars)[:, :2], columns=["x_m", "y_m"])
    assert len(pillars) >= 4
    assert poles.score(found, pillars).recall.k <= 1


def test_a_street_is_driven_once_whatever_is_asked_of_it(surveyed, monkeypatch):
    monkeypatch.setattr(streets, "drive", None)
    both, known = study.scene(seed=5001, length=60.0, speed=14.0, both_ways=True)
    again, same = study.scene(seed=5001, length=60.0, speed=14.0)
    assert again is surveyed[0]
    assert len(both) > len(again)
    assert known["street"] is same["street"]


def test_a_small_training_reproduces_itself():
    trees = [learned.grow(*training.lessons([1]), rounds=4) for _ in range(2)]
    assert all(np.array_equal(*parts) for parts in zip(*trees, strict=True))


def test_calibrated_trees_add_a_line_to_scaled_log_odds(rng, monkeypatch):
    trees = learned.shipped()
    measures = pd.DataFrame(
        rng.uniform(0, 4, (200, len(learned.MEASURES))), columns=[*learned.MEASURES]
    )
    measures["points"] = rng.uniform(1, 6, 200)
    monkeypatch.setattr(training, "CALIBRATION", (-0.5, 1.2, -0.4))
    found = training.calibrated(trees).log_odds(measures)
    line = -0.5 + 1.2 * trees.log_odds(measures) - 0.4 * (measures["points"] - 3)
    assert np.abs(found - line).max() < 0.4 * training.STEP / 2 + 1e-9


def test_scores_order_the_finds_on_a_street_of_another_generator():
    points, truth, path, _ = built_street.looked_at(651, "32 beams")
    found = poles.detect(points, threshold=0.1)
    finds = poles.score(found, truth, corridor=30, trajectory=path).detections
    finds = finds.query("outcome in ('hit', 'false')")
    right, high = finds["outcome"] == "hit", finds["score"] > finds["score"].median()
    assert len(finds) > 15
    assert right[high].mean() > right[~high].mean() + 0.3
    assert right[finds["score"] > 0.9].mean() > 0.75


@pytest.mark.real
def test_real_references(real):
    real(study.OAKLAND[0])
    whole, truth = study.oakland()
    targets = truth[~truth["ignore"]]
    assert len(whole) == pytest.approx(1e6, rel=0.001)
    assert (targets["height_m"] >= 1).all()
    assert 120 < len(targets) < 220
    assert poles.score(poles.detect(whole), truth).f1 > 0.7


def test_a_real_reference_leans_as_its_points_do(rng):
    z, lean = rng.uniform(0, 9, 300), np.array([0.05, -0.03])
    arm = np.column_stack([20 + np.maximum(z - 3, 0), 0 * z])
    points = np.vstack([np.column_stack([xy, z]) for xy in (z[:, None] * lean, arm)])
    points[:, :2] += rng.normal(0, 0.03, (600, 2))
    found = study._components(Cloud(points, {"label": np.full(600, 1103)}), study.ASKED)
    one = found.iloc[0]
    assert one[["lean_x", "lean_y"]].to_numpy(float) == pytest.approx(lean, abs=0.005)
    assert one[["x_m", "y_m"]].to_numpy(float) == pytest.approx(4.5 * lean, abs=0.03)
    assert (found.iloc[1:][["lean_x", "lean_y"]] == 0).all(axis=None)


def test_a_threshold_of_one_half_is_used_on_the_other():
    right = {"x_m": [0.0, 1, 2, 10, 11, 12], "y_m": 0.0, "score": [0.5, 0.5, 0.5, 0.3, 0.3, 0.3]}
    wrong = {"x_m": [0.0, 1, 2, 10, 11, 12], "y_m": 9.0, "score": [0.4, 0.4, 0.4, 0.2, 0.2, 0.2]}
    finds = pd.concat([pd.DataFrame(right), pd.DataFrame(wrong)], ignore_index=True)
    kept = study.above_chosen(finds, pd.DataFrame(right).drop(columns="score"))
    # the west is best above .4, the east above .2: right finds of the east lie below .4
    assert (kept["x_m"] < 6).all()
    assert kept["score"].tolist() == [0.5, 0.5, 0.5, 0.4, 0.4, 0.4]


def test_known_poles_of_public_tiles_are_those_within_the_cloud(tmp_path, monkeypatch):
    z, turn = np.arange(0, 3, 0.02), np.arange(150) * 2.4
    ring = np.column_stack([0.1 * np.cos(turn), 0.1 * np.sin(turn), z])
    floor = np.stack(np.meshgrid(*[np.arange(0, 9, 0.2)] * 2, [0.0]), axis=-1).reshape(-1, 3)
    posts = [ring + [x, x, 0] for x in (2.0, 4.0, 6.0)]
    listed = pd.DataFrame({"bgt_type": "lichtmast", "x": [2.0, 8, 20], "y": [2.0, 8, 20]})
    listed.to_csv(tmp_path / "pole_street_list.csv", index=False)
    io.write_cloud(tmp_path / "pole_street_a.laz", Cloud(np.vstack([floor, *posts])))
    there = {path.stem: path for path in tmp_path.iterdir()}
    monkeypatch.setattr(study.samples, "real_path", there.__getitem__)
    row = study.public_poles(("pole_street_a",), methods=("itc",)).iloc[0]
    assert row[["k", "n", "others"]].tolist() == [1, 2, 2]
