"""What studies of poles, lines and scan patterns make of clouds: components, crowds, clicks."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2

from mmqa_lab.cloud import Cloud
from mmqa_lab.studies import lhd_weight, mimic, poles


def poled(rng, *parts):
    """A cloud of labelled columns: x, y, low, high, label, count and lean."""
    points, labels = [], []
    for x, y, low, high, label, count, lean in parts:
        z = np.linspace(low, high, count)
        at = np.column_stack([x + lean * (z - low), np.full(count, y), z])
        points.append(at + [[0, 0, 0]] + 0.01 * rng.standard_normal((count, 3)) * [1, 1, 0])
        labels += [label] * count
    return Cloud(np.concatenate(points), {"label": np.array(labels)})


def test_components_of_labelled_points_have_their_feet_heights_and_axes(rng):
    cloud = poled(rng, (0, 0, 1, 7, 5, 121, 0.02), (3, 0, 0, 2.5, 5, 51, 0.0),
                  (6, 0, 0, 6, 9, 61, 0.0), (9, 4, 0, 8, 5, 81, 0.3))  # fmt: skip
    found = poles._components(cloud, (5,)).sort_values("x_m")
    assert len(found) == 3
    assert found["points"].tolist() == [121, 51, 81]
    assert found["z_base_m"].to_numpy() == pytest.approx([1, 0, 0])
    assert found["height_m"].to_numpy() == pytest.approx([6, 2.5, 8])
    # half-way up the leaning axis; of the low one the lowest 2 m; the arm leans too far
    assert found["x_m"].to_numpy() == pytest.approx([0.06, 3, 9.3], abs=0.02)
    assert found["y_m"].to_numpy() == pytest.approx([0, 0, 4], abs=0.01)
    assert found["lean_x"].to_numpy() == pytest.approx([0.02, 0, 0], abs=2e-3)
    lean = pd.DataFrame({"x_m": np.zeros(50), "y_m": np.zeros(50), "z": np.linspace(0, 3.99, 50)})
    assert poles._lean(lean.assign(x_m=0.05 * lean["z"])) == (0, 0)
    high = lean.assign(z=np.linspace(0, 4.01, 50))
    assert poles._lean(high.assign(x_m=0.05 * high["z"], y_m=-0.08 * high["z"])) == pytest.approx(
        [0.05, -0.08]
    )
    assert poles._lean(high.assign(x_m=0.08 * high["z"], y_m=-0.08 * high["z"])) == (0, 0)


def test_references_are_labelled_poles_and_others_are_ignored(rng, monkeypatch):
    parts = [(0, 0, 0, 3, 1107, 40, 0), (3, 0, 0, 3, 1107, 7, 0), (6, 0, 0, 0.95, 1107, 40, 0),
             (9, 0, 0, 3, 1109, 40, 0), (12, 0, 0, 3, 1000, 40, 0), (15, 0, 0, 3, 1000, 7, 0),
             (18, 0, 0, 0.95, 1000, 40, 0), (3.1, 0, 0, 3, 1107, 1, 0),
             (21, 0, 0, 1.0, 1303, 8, 0)]  # fmt: skip
    monkeypatch.setattr(poles.samples, "real_path", lambda name: name)
    monkeypatch.setattr(poles.io, "read_cloud", lambda name: poled(rng, *parts))
    cloud, found = poles.oakland(1)
    assert len(cloud) == sum(part[5] for part in parts)
    found = found.sort_values("x_m")
    assert found["x_m"].round().tolist() == [0, 3, 6, 9, 12, 21]
    assert found["visible"].tolist() == [True, True, False, False, False, True]
    assert (found["ignore"] == ~found["visible"]).all()
    assert len(poles.OAKLAND) == 10


def test_a_shaft_is_crowded_by_more_than_three_of_twenty_others(monkeypatch):
    pole = {"x_m": 5.0, "y_m": 7.0, "diameter_base_m": 0.2, "z_base_m": 1.0}
    pole |= {"clear_height_m": 3.0, "surface": 4}
    monkeypatch.setattr(poles, "outcomes", lambda _: {"miss": pd.DataFrame([pole])})
    own = np.column_stack([np.full(17, 5.05), np.full(17, 7.0), np.linspace(1.25, 3.9, 17)])
    near, beside = [5.39, 7.0, 2.0], [5.41, 7.0, 2.0]

    def share(*others):
        points = np.concatenate([own, np.reshape(others, (-1, 3))])
        surface = np.r_[np.full(17, 4), np.full(len(others), 9)]
        return poles.crowded(None, Cloud(points, {"surface": surface}))

    assert (share(near, near, near).k, share(near, near, near).n) == (0, 1)  # 3 of 20
    assert share(near, near, near, near).k == 1
    assert share(*[beside] * 9).k == 0
    low, high = [5.2, 7.0, 1.19], [5.2, 7.0, 4.01]  # at the foot, and above the clear height
    assert share(*[low] * 9, *[high] * 9).k == 0
    assert share(*[[5.2, 7.0, 1.21]] * 9).k == 1
    assert share(*[[5.2, 7.0, 3.99]] * 9).k == 1
    empty = Cloud(np.array([[90.0, 0, 0]]), {"surface": np.array([1])})
    assert poles.crowded(None, empty).k == 0


def test_a_threshold_is_chosen_on_one_half_by_its_f1():
    references = pd.DataFrame({"x_m": [0.0, 1, 2, 10, 11, 12], "y_m": 0.0, "ignore": False,
                               "z_base_m": 0.0, "height_m": 3.0, "visible": True})  # fmt: skip
    west = pd.DataFrame({"x_m": [0.0, 1, 2, 3.5, 4.5], "score": [0.9, 0.62, 0.61, 0.59, 0.4]})
    east = pd.DataFrame({"x_m": [10.0, 11, 12, 14, 15], "score": [0.9, 0.32, 0.31, 0.29, 0.2]})
    finds = pd.concat([west, east]).assign(y_m=0.0).reset_index(drop=True)
    kept = poles.above_chosen(finds, references)
    # east above .6 or .65, chosen in the west; west above .3, chosen in the east
    assert sorted(kept["x_m"]) == [0, 1, 2, 3.5, 4.5, 10]
    first = SimpleNamespace(
        targets=pd.DataFrame({"target": True, "found": [1, 1, 1, 0, 0, 1, 1]}, dtype=bool)
    )
    other = SimpleNamespace(
        targets=pd.DataFrame({"target": True, "found": [0, 0, 0, 1, 0, 0, 1]}, dtype=bool)
    )
    told = poles.paired(first, other)
    assert (told["only_one"], told["only_other"]) == (4, 1)
    assert told["p"] == pytest.approx(2 * 6 / 32)
    assert poles.paired(first, first)["p"] == 1
    counted = np.array([[6, 10, 8], [3, 5, 4]])
    assert poles.f1(counted) == pytest.approx(2 * 9 / 27)
    assert np.isnan(poles.f1(0 * counted))


def test_a_vector_is_inside_its_ellipsoid_up_to_the_quantile_of_chi_square(monkeypatch):
    monkeypatch.setattr(lhd_weight, "score", lambda *_: {"f1": 1.0})
    truth = SimpleNamespace(displacements=np.array([[0.1, 0, 0], [0.3, 0, 0]]))
    covariance = np.diag([0.01, 0.04, 0.09])
    limit = np.sqrt(chi2.ppf(0.95, 3))
    for factor, inside in ((0.999, 1.0), (1.001, 0.0)):
        vector = np.array([0.2, factor * limit * 0.2, 0])
        found = SimpleNamespace(displacement=SimpleNamespace(vector=vector, covariance=covariance))
        told = lhd_weight.score_vector(found, truth)
        assert told["inside"] == inside
        assert told["vector_error_m"] == pytest.approx(factor * limit * 0.2)
        assert told["vector_length_m"] == pytest.approx(np.linalg.norm(vector))
    lost = SimpleNamespace(
        displacement=SimpleNamespace(vector=np.full(3, np.nan), covariance=covariance)
    )
    assert lhd_weight.score_vector(lost, truth) == {"f1": 1.0}
    values = np.array([1.0, 2.0, 4.0, np.nan])
    told = lhd_weight.of_scenes(values)
    assert told["value"] == pytest.approx(7 / 3)
    assert told["low"] == 0


def test_surfaces_are_drawn_within_what_is_printed_with_the_speed_of_a_density():
    cases = mimic.surfaces(60, seed=3)
    assert cases["no"].tolist() == [*range(1, 61)]
    for k, case in enumerate(cases.to_dict("records")):
        assert (case["pulse_rate_hz"], case["mirror_frequency_hz"]) == mimic.RATES_HZ[k % 3]
        assert case["scanner_heading_deg"] == 45 * np.sign(case["heading_deg"])
        assert case["scanner_tilt_deg"] == 45
        found = mimic.scan_lattice(*mimic.parts(case))
        assert 300 <= found.density_per_m2 <= 1500
        assert 2 < case["speed_m_s"] < 30
        assert found.incidence_deg < 70
    heights = cases["height_difference_m"]
    assert -2 <= heights.min() < -1.8
    assert 1.8 < heights.max() <= 2
    assert cases["range_m"].max() > 15


def test_clicks_lead_to_the_next_point_and_along_both_axes_to_the_next_profile(monkeypatch):
    setup, target = mimic.parts(mimic.cad_walls((8.0,)).iloc[2].to_dict())
    found = mimic.scan_lattice(setup, target)
    a, b = found.a, found.b
    i, j = np.meshgrid(np.arange(-40, 41), np.arange(-3, 4))
    uv = np.outer(i.ravel(), a) + np.outer(j.ravel(), b)
    spot = found.beam
    cloud = Cloud(spot + uv @ found.axes, {"scan_line": j.ravel() + 100})
    clicks = mimic.clicked(mimic.Scan(setup, target, spot, cloud))
    exact = mimic.lattice(mimic.Scan(setup, target, spot, cloud))
    for name in mimic.FIGURES[:3]:
        assert clicks[name] == pytest.approx(exact[name], rel=1e-6)
        assert clicks[f"std_{name}"] == pytest.approx(0, abs=1e-6)
    lost = ~((i.ravel() == 1) & (j.ravel() == 0))  # the pulse next to the spot has no echo
    holed = Cloud(cloud.points[lost], {"scan_line": (j.ravel() + 100)[lost]})
    again = mimic.clicked(mimic.Scan(setup, target, spot, holed))
    assert again["point_mm"] == pytest.approx(exact["point_mm"], rel=1e-6)
    profile = np.array([[0.0, 1.0], [0.2, 2.0], [0.4, 1.5]])
    assert mimic._across(profile, np.array([0.1, 0.0]), 1) == pytest.approx(1.5)
    assert mimic._across(profile[::-1], np.array([0.0, 1.75]), 0) == pytest.approx(0.3)
    assert np.isnan(mimic._across(profile, np.array([0.5, 0.0]), 1))
    assert np.isnan(mimic._across(profile[:0], np.array([0.5, 0.0]), 1))
    assert mimic._figures(0.001, 0.002, 0.003, 4.0) == dict(
        zip(mimic.FIGURES, (1, 2, 3, 4), strict=True)
    )


@pytest.mark.parametrize(("density", "low", "high"), [(18_000, 12, 30), (1200, 2, 4)])
def test_speeds_and_incidences_beyond_what_is_driven_are_drawn_again(
    density, low, high, monkeypatch
):
    seen = []

    def lattice(*_):
        seen.append(69.9 if len(seen) % 2 else 70.1)
        return SimpleNamespace(density_per_m2=density, incidence_deg=seen[-1])

    monkeypatch.setattr(mimic, "scan_lattice", lattice)
    speeds = mimic.surfaces(300, seed=1)["speed_m_s"]
    assert low <= speeds.min() < 1.03 * low  # of 300 to 1500 points per square metre
    assert 0.97 * high < speeds.max() <= high
    assert len(seen) >= 600
