"""The study's tables: what it changes, what it counts, what it sets side by side."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from mmqa_lab import io, poles, views
from mmqa_lab.__main__ import main
from mmqa_lab.poles import facades, ours, trees
from mmqa_lab.simulate import streets
from mmqa_lab.studies import poles as study
from mmqa_lab.studies.poles import factors, oakland, reach, scene, surveys, training


@pytest.fixture(scope="module")
def surveyed():
    """One short street, surveyed by all methods."""
    choices = {"plan": "table-4-1", "scanner": "roamer", "speed": 14.0}
    return study.compute(seeds=(5001,), length=60.0, **choices)


def test_a_change_leaves_everything_else_where_it_was():
    plain = streets.street("table-4-1", length=100, seed=7).targets
    changed = factors.CHANGES["5 people per 100 m"]
    plan = factors.replace(streets.PLANS["table-4-1"], **changed)
    other = streets.street(plan, length=100, seed=7).targets
    columns = ["x_m", "y_m", "height_m", "diameter_base_m"]
    assert plain[columns].equals(other[columns])
    bare = factors.replace(streets.PLANS["table-4-1"], **factors.CHANGES["no shrubs"])
    assert plain[columns].equals(streets.street(bare, length=100, seed=7).targets[columns])


def test_a_street_has_the_poles_that_its_plan_asks_for():
    plan = factors.replace(streets.PLANS["quiet"], building_share=0.0, trees_per_100m=0.0)
    made = [streets.street(plan, length=300, seed=seed).targets for seed in range(3)]
    counts = sum(targets["class"].value_counts() for targets in made)
    expected = 9 * plan.lamps_per_100m
    # Poisson within four standard deviations; a few are too near to another pole
    assert abs(counts["lamp"] - expected) < 4 * np.sqrt(expected)


def test_every_target_is_a_surface_of_its_class():
    made = streets.street("green", length=60, seed=2)
    assert (made.labels[made.targets["surface"]] == made.targets["class"]).all()


def test_visible_targets_count_the_points_of_the_shaft_below_the_crown(surveyed):
    survey = surveyed[0][0]
    for kind in ("lamp", "tree"):
        one = survey.targets[survey.targets["class"] == kind].nlargest(1, "points").iloc[0]
        height = survey.cloud.points[survey.cloud["surface"] == one["surface"], 2] - one["z_base_m"]
        assert one["points"] == (height <= one["clear_height_m"]).sum() > 10
        whole = one["clear_height_m"] == one["height_m"]
        assert whole == (kind == "lamp")


def test_rates_are_those_of_the_scores(surveyed):
    (survey,), rates = surveyed
    one = rates.query("method == 'fgi' and corridor_m == 30 and quantity == 'precision'").iloc[0]
    score = survey.score("fgi", corridor=30.0)
    assert (one["k"], one["n"]) == (score.precision.k, score.precision.n)
    f1 = rates.query("method == 'fgi' and corridor_m == 30 and quantity == 'f1'")["value"].item()
    assert f1 == pytest.approx(score.f1)


def test_checks_hold(surveyed):
    assert all(check.passed for check in study.checks(surveyed[1]))


def test_published_and_measured_stand_side_by_side(surveyed):
    table = study.beside_published(surveyed[1])
    assert table["published"].round(3).tolist()[:2] == [0.697, 0.716]
    assert np.allclose(table["measured"] - table["published"], table["difference"])


def test_the_curve_passes_through_the_operating_point(surveyed):
    made, rates = surveyed
    curve = surveys.operating_curves(made, corridor=30.0)
    own = curve[
        (curve["method"] == "ours") & (curve["threshold"] >= ours.Settings().threshold)
    ].iloc[-1]
    point = rates.query("method == 'ours' and corridor_m == 30 and `class` == 'all'")
    recall = point.set_index("quantity")["value"]["recall"]
    # one detection at the edge of the corridor may be counted on either side
    assert own["recall"] == pytest.approx(recall, abs=0.08)


def test_training_labels_are_near_far_and_between():
    axes = np.zeros((3, 8))
    axes[:, 0], axes[:, 6] = [0.1, 0.45, 3.0], 2.0
    targets = pd.DataFrame(
        {"x_m": [0.0], "y_m": 0.0, "lean_x": 0.0, "lean_y": 0.0, "height_m": 2.0, "visible": True}
    )
    assert training.labels(axes, targets).tolist() == [1, -1, 0]
    assert training.labels(axes, targets.assign(visible=False)).tolist() == [-1, -1, 0]


def test_a_fitted_model_is_that_of_scikit_learn_and_reproducible():
    rng = np.random.default_rng(0)
    features = rng.normal(size=(200, len(ours.FEATURES)))
    label = (features[:, 3] > 0).astype(int)
    group = np.repeat([0, 1], 100)
    model = training.fit(features, label, group, rounds=30)
    assert model.to_json() == training.fit(features, label, group, rounds=30).to_json()
    right = (model.probability(features) > 0.5) == label
    assert right.mean() > 0.95  # one feature decides, though each split sees three in ten


def test_a_wary_model_believes_less_at_walls_and_the_same_elsewhere():
    rng = np.random.default_rng(1)
    features = np.zeros((4000, len(ours.FEATURES)))
    at_wall = rng.random(4000) < 0.5
    features[:, ours.FEATURES.index("facade_m")] = np.where(at_wall, training.WALL_M + 1, 0)
    features[:, ours.FEATURES.index("facade_off_m")] = np.where(at_wall, 1, facades.REACH_M)
    label = (rng.random(4000) < 0.5).astype(int)
    group = np.zeros(4000, int)
    plain, wary = (
        training.fit(features, label, group, rounds=200, wary=k).probability(features)
        for k in (1, training.WARY)
    )
    # the odds are those of the weights: 1 to 1, and 1 to the weight at walls
    assert plain[at_wall].mean() == pytest.approx(label[at_wall].mean(), abs=0.01)
    assert wary[at_wall].mean() == pytest.approx(1 / (1 + training.WARY), abs=0.01)
    assert wary[~at_wall].mean() == pytest.approx(label[~at_wall].mean(), abs=0.01)


def test_a_small_training_run_reproduces_itself():
    choices = {"stretch": 0.12, "rounds": 4, "progress": False}
    first = training.train((1, 3), **choices)
    assert first.features == ours.FEATURES
    assert first.notes["poles"] > 5
    assert training.train((1, 3), **choices).to_json() == first.to_json()


def test_the_model_of_the_package_is_what_the_training_module_describes():
    model = trees.read_model()
    assert model.features == ours.FEATURES
    assert model.notes["trained on"].startswith(f"{training.EXAMPLES} simulated streets")
    assert str(training.FIRST_SEED) in model.notes["trained on"]


def test_the_quiet_model_has_seen_no_balconies():
    quiet, usual = (
        plan(np.random.default_rng(3)) for plan in (training.quiet_plan, training.random_plan)
    )
    assert quiet.balcony_share == 0 < usual.balcony_share
    assert quiet.columns_per_100m == pytest.approx(usual.columns_per_100m / 5)
    assert quiet.trees_per_100m == usual.trees_per_100m
    model = training.quiet_model()
    assert model.features == ours.FEATURES
    assert model.notes["plans"] == "quiet_plan"
    assert model.notes["trained on"].startswith(f"{training.QUIET_EXAMPLES} simulated streets")


def test_a_model_of_ones_own_decides(surveyed):
    survey = surveyed[0][0]
    nobody = replace(trees.read_model(), base=-500.0)
    assert len(poles.detect(survey.cloud, model=nobody)) == 0
    with pytest.raises(ValueError, match="Must be one of ours"):
        poles.detect(survey.cloud, method="fgi", model=nobody)


def test_false_alarms_are_counted_per_100_m(surveyed):
    (survey,), _ = surveyed
    causes = surveys.causes([survey], ("fgi", "itc"))
    for name in ("fgi", "itc"):
        own = causes[causes["method"] == name]
        assert own["n"].sum() == len(survey.outcomes(name, corridor=30.0)["false alarm"])
        assert np.allclose(own["per_100m"], own["n"] / 0.6)  # 60 m of street


def test_a_wider_gate_cannot_lose_hits(surveyed):
    table = surveys.by_gate(surveyed[0], ("ours", "fgi"), gates=(0.1, 0.5))
    hits = table[table["quantity"] == "recall"].pivot(index="gate_m", columns="method", values="k")
    assert (hits.loc[0.5] >= hits.loc[0.1]).all()


def test_a_thinner_cloud_shows_fewer_of_the_same_targets(surveyed):
    table = surveys.by_density(surveyed[0], ("fgi",), (0.05, 1.0))
    recall = table[table["quantity"] == "recall"].set_index("share")
    assert recall["n"].nunique() == 1
    assert recall.loc[0.05, "k"] < recall.loc[1.0, "k"]
    density = recall["density_per_m2"]
    # binomial: of some ten thousand points
    assert density[0.05] / density[1.0] == pytest.approx(0.05, rel=0.05)


def test_facades_are_classed_as_walls(surveyed):
    table = surveys.facades(surveyed[0])
    bands, whole = table.iloc[:-1], table.iloc[-1]
    assert bands["n"].sum() == whole["n"]
    assert whole["quality"] <= min(whole["completeness"], whole["correctness"])
    assert whole["correctness"] > 0.5


def test_verdicts_on_what_was_to_be_reached(surveyed):
    made = surveyed[0]
    made[0].detect("ours", name=reach.QUIET, model=training.quiet_model())
    table = reach.table(plain=made, balconies=made, dense=made)
    known = table[table["value"].notna()]
    good = np.where(
        known["unit"] == "mm",
        known["value"].abs() <= known["aim"],
        known["value"] >= known["aim"],
    )
    assert (known["verdict"] == np.where(good, "reached", "missed")).all()
    assert (table.loc[table["value"].isna(), "verdict"] == "not measured").all()
    assert all(check.passed for check in reach.checks(table))
    worse = table.assign(value=table["aim"] - 0.2, n=100, unit="1", verdict="missed")
    (check,) = reach.checks(worse)
    assert not check.passed
    assert check.obtained.startswith(f"missed {len(table)} of {len(table)}")
    one = table[(table["setting"] == "chosen street, 30 m") & (table["quantity"] == "recall")]
    assert one["value"].item() == made[0].score("ours", corridor=30.0).recall.value


def test_the_view_holds_every_outcome(surveyed):
    if not views.can_render():
        pytest.skip("no OpenGL here")
    survey = surveyed[0][0]
    plotter = scene.plot_street(survey, "fgi", corridor=30.0, off_screen=True)
    outcomes = survey.outcomes("fgi", corridor=30.0)
    # one actor a pole, one for the points, one for the legend
    assert len(plotter.actors) >= 1 + sum(len(part) for part in outcomes.values())
    plotter.close()


@pytest.mark.real
def test_real_references(real):
    real(oakland.FILES[0])
    whole = oakland.cloud()
    truth = oakland.references(whole)
    targets = truth[~truth["ignore"]]
    assert len(whole) == pytest.approx(1e6, rel=0.001)
    assert (targets["height_m"] >= 1).all()
    assert 120 < len(targets) < 220


def test_command(surveyed, tmp_path, capsys):
    survey = surveyed[0][0]
    cloud = survey.cloud[survey.cloud["surface"] >= 0]
    io.write_cloud(tmp_path / "street.laz", cloud)
    truth = survey.targets[survey.targets["visible"]]
    truth.to_csv(tmp_path / "truth.csv", index=False)
    words = ["poles", str(tmp_path / "street.laz"), "--method", "fgi", "--json"]
    words += ["--reference", str(tmp_path / "truth.csv"), "--csv", str(tmp_path / "out.csv")]
    words += ["--geojson", str(tmp_path / "out.geojson")]
    assert main(words) in (0, None)
    printed = json.loads(capsys.readouterr().out)
    table = pd.read_csv(tmp_path / "out.csv")
    assert list(table) == [
        *("x_m", "y_m", "z_base_m", "height_m", "diameter_m", "tilt_deg", "score", "method"),
    ]
    assert len(table) == len(printed["poles"]) == len(poles.detect(cloud, method="fgi"))
    assert 0 < printed["scores"]["recall"]["value"] <= 1
    places = json.loads((tmp_path / "out.geojson").read_text())["features"]
    assert places[0]["geometry"]["coordinates"][0] == pytest.approx(table["x_m"][0], abs=1e-4)


def test_command_says_what_is_wrong(tmp_path, capsys):
    (tmp_path / "cloud.csv").write_text("x,y,z\n0,0,0\n1,1,1\n")
    (tmp_path / "truth.csv").write_text("a,b\n1,2\n")
    words = ["poles", str(tmp_path / "cloud.csv"), "--reference", str(tmp_path / "truth.csv")]
    assert main(words) == 2
    assert "Must have x_m and y_m." in capsys.readouterr().err
