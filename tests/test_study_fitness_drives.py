"""Acquisitions of study 12, thinned real clouds and scores: what is drawn, cut and compared."""

from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import spearmanr

from mmqa_lab import stats
from mmqa_lab.cloud import Cloud
from mmqa_lab.scan_pattern import ScanSetup, Target, scan_lattice
from mmqa_lab.simulate import Scene, rectangle
from mmqa_lab.studies.fitness import acquisitions as make_cases
from mmqa_lab.studies.fitness import comparison, real, transfer
from mmqa_lab.studies.fitness.acquisitions import KINDS, RANGES

module = import_module("mmqa_lab.studies.fitness.acquisitions")

LOGARITHMIC = {"distance_m", "pulse_rate_hz", "mirror_frequency_hz", "noise_mm"}
LOGARITHMIC |= {"divergence_mrad", "nearer"}

CASE = {"heading_deg": 20.0, "tilt_deg": 30.0, "pulse_rate_hz": 1e5, "mirror_frequency_hz": 50.0}
CASE |= {"noise_mm": 4.0, "divergence_mrad": 0.7, "jitter_deg": 0.02, "dropout": 0.1}
CASE |= {"distance_m": 8.0, "turn_deg": 10.0, "elsewhere": True, "nearer": 1.5, "speed_kmh": 36.0}
CASE |= {"chart_turn_deg": -25.0, "height_m": 1.0, "kind": "one head"}


def test_each_range_is_drawn_once_in_each_of_its_equal_parts():
    count = 8
    table = make_cases(count, seed=9)
    assert table["number"].tolist() == [*range(count * len(KINDS))]
    assert (table["draw"] == 9).all()
    assert table["elsewhere"].tolist() == [False, True] * (count * len(KINDS) // 2)
    for kind, own in KINDS.items():
        rows = table[table["kind"] == kind]
        for name, (low, high) in (RANGES | own).items():
            values = rows[name].to_numpy()
            if name in LOGARITHMIC:
                share = np.log(values / low) / np.log(high / low)
            else:
                share = (values - low) / (high - low)
            assert sorted(np.floor(count * share)) == [*range(count)], (kind, name)


@pytest.mark.parametrize("turn", [0.0, 20.0, -35.0])
def test_axes_of_an_object_are_along_up_and_towards_the_road(turn):
    along, up, towards = module._axes(turn)
    t = np.radians(turn)
    # right of a drive to the north, an object looks west, turned clockwise from above
    assert towards == pytest.approx([-np.cos(t), np.sin(t), 0])
    assert up == pytest.approx([0, 0, 1])
    assert along == pytest.approx(np.cross(up, towards))


def test_objects_have_their_ends_and_owners():
    names = ["chart", "board", "corner", "posts", "wire", "sign"]
    axes = dict.fromkeys(names, np.eye(3))
    middles = {name: np.array([10.0 * k, 0, 0]) for k, name in enumerate(names)}
    surfaces, ends, owners = module._objects(names, axes, middles)
    assert owners == ["chart", "board", "corner", "corner", "posts", "posts", "posts", "posts",
                      "wire", "sign"]  # fmt: skip
    square = [(-0.5, -0.5, 0), (0.5, -0.5, 0), (-0.5, 0.5, 0), (0.5, 0.5, 0)]
    walls = [square, square + np.array([10, 0, 0])]
    for sign in (-1, 1):
        walls.append([(20, -1, 0), (20 + sign * 1.06, -1, -1.06), (20, 1, 0),
                      (20 + sign * 1.06, 1, -1.06)])  # fmt: skip
    walls.append([(28, -1.5, -0.6), (32, -1.5, -0.6), (28, -1.5, 0.6), (32, -1.5, 0.6)])
    rods = [((30 + x, -1.5, 0), (30 + x, 1.5, 0)) for x in (-1.2, 0, 1.2)]
    rods.append(((39, -0.4, 0), (41, 0.4, 0)))
    expected = np.concatenate([np.concatenate(walls), np.concatenate(rods)])
    assert np.array(ends)[:-2] == pytest.approx(expected)
    assert sorted(np.array(ends)[-2:].tolist()) == [[50, -0.3, 0], [50, 0.3, 0]]
    radii = [one.shape[0, 4] for one in surfaces[5:9]]
    assert radii == pytest.approx([0.03, 0.06, 0.15, 0.01])
    assert surfaces[9].half[0] == pytest.approx([0.3, 0.3, 0])


def test_heads_have_the_rates_noise_and_beams_of_their_kind():
    rng = np.random.default_rng(1)
    made = {kind: module._heads(CASE | {"kind": kind}, rng) for kind in KINDS
            if kind not in ("images", "rosette")}  # fmt: skip
    for heads in made.values():
        for head in heads:
            assert (head.pulse_rate_hz, head.mirror_frequency_hz) == (1e5, 50)
            assert head.range_noise_m == pytest.approx(0.004)
            assert (head.divergence_mrad, head.exit_diameter_m) == (0.7, 0.005)
            assert (head.angle_noise_deg, head.dropout_share) == (0.02, 0.1)
    for kind, span, count in (("16 beams", 30, 16), ("64 beams", 45, 64), ("128 beams", 40, 128),
                              ("walker", 30, 16)):  # fmt: skip
        (head,) = made[kind]
        assert head.upright
        assert head.elevations_deg == pytest.approx(np.linspace(-span / 2, span / 2, count))
    assert len(made["32 beams"][0].elevations_deg) == 32
    assert len(made["one head"]) == len(made["two drives"]) == 1
    first, second = made["two heads"]
    assert (first.heading_deg, second.heading_deg) == (20, -20)
    pairs = [module._heads(CASE | {"kind": "two heads"}, rng)[1] for _ in range(400)]
    assert {one.tilt_deg for one in pairs} == {-30, 30}
    assert np.mean([one.tilt_deg > 0 for one in pairs]) == pytest.approx(0.5, abs=0.1)
    off = np.array([one.boresight_deg for one in pairs])
    assert off.std(axis=0) == pytest.approx([0.02] * 3, rel=0.15)


def test_two_drives_lie_eight_millimetres_apart_along_each_axis(monkeypatch):
    cloud = Cloud(np.zeros((4, 3)), {"surface": np.arange(4)})
    asked = []

    def past(_, head, path, ends, *, seed):
        asked.append((head, seed))
        return cloud

    monkeypatch.setattr(module.systems, "drive_past", past)
    ends, shifts = np.array([[5.0, -6, 0], [5.0, 6, 0]]), []
    for seed in range(300):
        rng = np.random.default_rng(seed)
        points, hit = module._scanned(CASE | {"kind": "two drives"}, None, ends, rng)
        assert len(points) == 8
        assert not points[:4].any()
        assert hit.tolist() == [0, 1, 2, 3] * 2
        shifts.append(points[4])
    assert np.std(shifts, axis=0) == pytest.approx([0.008] * 3, rel=0.15)
    assert len({tuple(seed) for _, seed in asked}) == len(asked)
    points, _ = module._scanned(CASE, None, ends, np.random.default_rng(1))
    assert len(points) == 4
    assert not points.any()
    monkeypatch.setattr(module.systems, "drive_past", lambda *_, **__: cloud[:0])
    assert module._scanned(CASE, None, ends, np.random.default_rng(1))[0].shape == (0, 3)


def test_drives_put_the_chart_elsewhere_and_give_each_object_its_own_frame(monkeypatch):
    seen = {}

    def matched(case, scene, axes, middles, rng):
        seen.update(axes=axes, middles=middles, scene=scene)
        aims = {"chart": [0.1, 0.2, 0.0], "board": [-0.3, 0.1, 0.0]}
        points = [middles[name] + np.array(local) @ axes[name] for name, local in aims.items()]
        return np.array(points), np.array([0, 1])

    monkeypatch.setattr(module, "_matched", matched)
    local, surface, axes = module.drive(CASE | {"kind": "images"}, None)
    assert seen["middles"]["chart"] == pytest.approx([12, -9, 0])
    places = {"board": -6, "corner": -2, "sign": 1, "wire": 3, "posts": 7}
    for name, y in places.items():
        assert seen["middles"][name] == pytest.approx([8, y, 0])
        assert axes[name] == pytest.approx(module._axes(10.0))
    assert axes["chart"] == pytest.approx(module._axes(-25.0))
    assert local["chart"] == pytest.approx(np.array([[0.1, 0.2, 0]]))
    assert local["board"] == pytest.approx(np.array([[-0.3, 0.1, 0]]))
    assert (surface["chart"].tolist(), surface["board"].tolist()) == ([0], [1])
    assert len(local["wire"]) == 0
    module.drive(CASE | {"kind": "images", "elsewhere": False}, None)
    assert seen["middles"]["chart"] == pytest.approx([8, -9, 0])


def test_matched_points_have_holes_a_density_and_errors_in_common():
    wall = Scene([rectangle((10, -50, -50), (0, 100, 0), (0, 0, 100))])
    case = CASE | {"pulse_rate_hz": 3000.0, "noise_mm": 20.0, "height_m": 0.0}
    middles, axes = {"board": np.array([10.0, 0, 0])}, {"board": module._axes(0.0)}
    empty, counts, near, far = [], [], [], []
    first, _ = module._matched(case, wall, axes, middles, np.random.default_rng(99))
    assert len(first) == pytest.approx(25_000, rel=0.1)
    for seed in range(12):
        points, hit = module._matched(case, wall, axes, middles, np.random.default_rng(seed))
        assert not hit.any()
        ranges = np.linalg.norm(points, axis=1)
        rays = points / ranges[:, None]
        off = ranges - 10 / rays[:, 0]
        plan = points[:, 1:] - off[:, None] * rays[:, 1:]
        assert np.abs(plan).max(axis=0) == pytest.approx([1.4, 1.6], abs=0.01)
        counts.append(len(points))
        grid = np.random.default_rng(1).uniform(-1.2, 1.2, (2000, 2))
        tree = module.cKDTree(plan)
        empty.append((tree.query(grid)[0] > 0.05).mean())
        i, j = tree.query_pairs(0.02, output_type="ndarray").T
        near.append(np.corrcoef(off[i], off[j])[0, 1])
        k = np.random.default_rng(2).permutation(len(off))
        far.append(np.corrcoef(off, off[k])[0, 1])
        assert off.std() == pytest.approx(0.02, rel=0.2)
    # eleven holes on 9 m2, of 2 to 12 cm: pi E r^2 = .0182 m2 each
    share = 1 - np.exp(-4 / 3.2 * np.pi * (0.12**3 - 0.02**3) / 0.3)
    assert np.mean(counts) == pytest.approx(3000 * 2.8 * 3.2 * (1 - share), rel=0.02)
    inner = 1 - np.exp(-4 / 3.2 * np.pi * (0.07**3) / 0.3)  # those 5 cm within
    assert np.mean(empty) == pytest.approx(inner, abs=0.004)
    # .6 of the noise is each point's own, .8 is common within 10 cm
    expected = 0.64 * np.exp(-((0.02 * 2 / 3 / 0.1) ** 2) / 2)
    assert np.mean(near) == pytest.approx(expected, abs=0.08)
    assert abs(np.mean(far)) < 0.02
    wide = {"posts": np.array([10.0, 0, 0])}, {"posts": module._axes(0.0)}
    points, _ = module._matched(case, wall, wide[1], wide[0], np.random.default_rng(1))
    assert np.abs(points[:, 1]).max() == pytest.approx(2.5, abs=0.05)
    close = {"board": np.array([5.0, 0, 0])}
    front = Scene([rectangle((5, -50, -50), (0, 100, 0), (0, 0, 100))])
    points, _ = module._matched(case, front, axes, close, np.random.default_rng(1))
    assert len(points) == pytest.approx(4 * np.mean(counts), rel=0.05)


def test_rosettes_wait_and_turn_as_their_prisms(monkeypatch):
    seen = []

    def cast(case, scene, origins, beams, rng):
        seen.append((origins, beams))
        return origins, None, None

    monkeypatch.setattr(module, "_cast", cast)
    case = CASE | {"pulse_rate_hz": 2e4, "dropout": 0.25, "jitter_deg": 0.0, "speed_kmh": 36.0}
    ends = np.array([[6.0, -2.0, 0], [10.0, 3.0, 0]])
    module._rosette(case, None, ends, np.random.default_rng(1))
    origins, beams = seen[0]
    assert np.linalg.norm(beams, axis=1) == pytest.approx(1)
    assert not origins[:, 0].any()
    assert (origins[:, 2] == 1.0).all()
    # from 8 m before the first to 8 m behind the last end at 10 m/s
    assert origins[:, 1].min() == pytest.approx(-10, abs=0.02)
    assert origins[:, 1].max() == pytest.approx(11, abs=0.02)
    time = (origins[:, 1] + 10) / 10
    plane = beams[:, 1:] / beams[:, :1]
    assert np.abs(1.0 + 8 * plane[:, 1]).max() <= 2.5
    tan = np.tan(np.radians(17.6))
    unknown = np.exp(2j * np.pi * np.outer(time, [7294 / 60, -4664 / 60]))
    z = plane @ [1, 1j]
    phases = np.linalg.lstsq(unknown, z, rcond=None)[0]  # of both prisms
    assert np.abs(phases) == pytest.approx([tan, tan], rel=1e-6)
    assert np.abs(unknown @ phases - z).max() < 1e-6
    whole = np.arange(0, 2.1, 1 / 2e4)
    turned = (np.exp(2j * np.pi * np.outer(whole, [7294 / 60, -4664 / 60])) @ phases).imag
    passing = np.abs(1.0 + 8 * turned) < 2.5
    assert len(beams) == pytest.approx(0.75 * passing.sum(), rel=0.02)
    module._rosette(case | {"jitter_deg": 0.1}, None, ends, np.random.default_rng(1))
    moved = seen[1][1][:, 1:] / seen[1][1][:, :1]
    near = np.linalg.norm(moved[:50] - plane[:50], axis=1)
    assert near.max() < 6 * np.radians(0.1) + 0.2


def test_thinned_clouds_are_cut_by_chance_by_stretches_and_by_holes(monkeypatch, rng):
    kept = []
    monkeypatch.setattr(real, "SHARES", np.array([0.5]))
    monkeypatch.setattr(real, "evaluate_cloud", lambda chart, polygon: chart)
    monkeypatch.setattr(real, "shown", lambda xy: kept.append(xy) or {"n": len(xy)})
    relief = lambda uv, noise, beam, seed: {"uv": uv, "noise": noise, "given": (beam, seed)}  # noqa: E731
    monkeypatch.setattr(real, "relief_errors", relief)
    xy = rng.uniform([-1.5, -0.5], [1.5, 0.5], (12_000, 2))
    points = np.column_stack([xy, 0.1 * xy[:, 0] ** 2 + 0.002 * rng.standard_normal(12_000)])
    found = list(real._thinned(points, real.ALONG_M, 2, np.random.default_rng(1)))
    assert len(found) == 6
    for number, (chart, errors) in enumerate(found):
        way = ("chance", "stretches", "holes")[number % 3]
        thing = kept[number]
        assert np.abs(chart[:, :2]).max() < 0.5
        assert np.abs(thing).max() < 0.5
        number_of = 4000 * 0.5
        lost = 0.35 if way == "holes" else 0.1
        assert number_of * (1 - lost) < len(thing) <= number_of * 1.1
        assert errors["given"] == (0.005, [7])
        # the thing is turned about its middle, its heights are those above the dense surface
        assert np.linalg.norm(errors["uv"], axis=1) == pytest.approx(np.linalg.norm(thing, axis=1))
        assert errors["noise"].std() == pytest.approx(0.002, rel=0.15)
        turn = np.angle(errors["uv"][:, :2] @ [1, 1j] / (thing @ [1, 1j]))
        assert np.ptp(np.unwrap(np.sort(turn))) < 1e-6 or np.ptp(turn) > 6
    order = {tuple(one): k for k, one in enumerate(xy.round(9))}
    runs = [np.diff(np.sort([order[tuple(one)] for one in (kept[k] + [1, 0]).round(9)]))
            for k in (0, 1)]  # fmt: skip
    # of all points of a stretch every third lies on the thing
    assert np.median(runs[0]) > np.median(runs[1])
    sparse = list(real._thinned(points[:30], real.ALONG_M, 1, np.random.default_rng(1)))
    assert len(sparse) == 0  # fewer than ten points


def test_height_and_slopes_are_those_of_the_regression_plane(rng):
    xy = rng.uniform(-1, 1, (60, 2)) + [5, 7]
    points = np.column_stack([xy, 3 + 0.2 * xy[:, 0] - 0.1 * xy[:, 1]])
    found = real._height_and_slopes(points, np.array([4.0, 6.0]))
    assert found == pytest.approx((3 + 0.8 - 0.6, 0.2, -0.1))


def test_spearman_and_balanced_accuracy_by_their_definitions(rng):
    values = rng.integers(0, 9, (5, 40)).astype(float)
    expected = [spearmanr(one, values[-1]).statistic for one in values[:-1]]
    assert comparison._spearman(values) == pytest.approx(expected)
    flat = np.vstack([np.ones(40), values[-1]])
    assert comparison._spearman(flat) == pytest.approx([0])
    tied = np.vstack([values, np.full(40, np.inf), rng.random((2, 40))])
    draws = rng.integers(40, size=(20, 40))
    each = np.transpose([comparison._spearman(tied[:, draw]) for draw in draws])
    assert np.array_equal(comparison._drawn_spearman(tied, draws), each)  # to the bit
    assert stats.rank_correlation(values[:-1], values[-1]) == pytest.approx(expected)
    fit, accepted = rng.random(40) < 0.3, rng.random((40, 3)) < 0.5
    found = comparison._balanced(accepted, fit)
    for k in range(3):
        right = [accepted[fit, k].mean(), 1 - accepted[~fit, k].mean()]
        assert found[k] == pytest.approx(np.mean(right))
    halves = np.array([comparison._half(fit, rng) for _ in range(400)])
    for part in (fit, ~fit):
        sizes = halves[:, part].sum(axis=1)
        assert {*sizes} <= {part.sum() // 2, (part.sum() + 1) // 2}
        assert halves[:, part].mean(axis=0) == pytest.approx(0.5, abs=0.1)
    assert comparison._is_more("density")
    assert not comparison._is_more("e95")
    assert not comparison._is_more("unheard of")


def test_rules_accept_up_to_their_limits():
    table = pd.DataFrame({"density": [-2999.9, -3000.0], "d1": 5.0, "d4": 19.0, "f": [1.99, 2.0]})
    found = [*comparison.written(table.assign(usgs_distribution=[-0.899, -0.9])).values()]
    assert [one.tolist() for one in found] == [[True, True], [False, True], [True, False],
                                               [True, False], [False, True]]  # fmt: skip


def test_predictions_go_with_distance_turn_and_the_lattice():
    case = CASE | {"kind": "one head"}
    for far, turn in ((16.0, 0.0), (4.0, 30.0), (10.0, -50.0)):
        found = transfer.predicted(case, far, turn)
        for name in transfer.METRICS_MOVED:
            moved = found[name]
            assert moved["the chart's"] == 1
            assert moved["by distance"] == pytest.approx(np.sqrt(far / 8))
            area = far / 8 / np.cos(np.radians(turn))
            assert moved["by distance and turn"] == pytest.approx(np.sqrt(area))
        setup = ScanSetup(pulse_rate_hz=1e5, mirror_frequency_hz=50.0, speed_m_s=10.0,
                          scanner_heading_deg=20.0, scanner_tilt_deg=30.0)  # fmt: skip
        chart = scan_lattice(setup, Target(heading_deg=0, range_m=8.0))
        thing = scan_lattice(setup, Target(heading_deg=-turn, range_m=far))
        ratio = chart.density_per_m2 / thing.density_per_m2
        assert found["noise_of_a_mean"]["by the lattice"] == pytest.approx(np.sqrt(ratio))
        expected = transfer._lattice_e95(thing) / transfer._lattice_e95(chart)
        assert found["e95"]["by the lattice"] == pytest.approx(expected)
    images = transfer.predicted(case | {"kind": "images"}, 16.0, 60.0)["e95"]
    assert images["by distance"] == pytest.approx(2)
    assert images["by distance and turn"] == pytest.approx(np.sqrt(8))
    assert np.isnan(images["by the lattice"])


@pytest.mark.parametrize(("a", "b"), [((0.02, 0), (0, 0.05)), ((0.01, 0.002), (0.004, 0.06))])
def test_e95_of_a_lattice_is_that_of_its_places(a, b):
    a, b = np.array(a), np.array(b)
    rng = np.random.default_rng(1)
    places = rng.random((20_000, 2)) @ np.array([a, b])
    i, j = np.meshgrid(np.arange(-12, 13), np.arange(-3, 4))
    points = np.column_stack([i.ravel(), j.ravel()]) @ np.array([a, b])
    away = module.cKDTree(points).query(places)[0]
    found = transfer._lattice_e95(SimpleNamespace(a=a, b=b))
    assert found == pytest.approx(np.quantile(away, 0.95), rel=0.01)
