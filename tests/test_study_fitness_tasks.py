"""Errors of tasks: brute force over strips and patches, each built with an answer of its own."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from mmqa_lab.studies.fitness import tasks

FAR = 7.0  # a height that no place of a task may see


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


def within(rng, low, high, n=12):
    """Points in a rectangle, at its corners too, but a hair within."""
    low, high = np.add(low, 1e-9), np.subtract(high, 1e-9)
    corners = [(x, y) for x in (low[0], high[0]) for y in (low[1], high[1])]
    return np.concatenate([corners, rng.uniform(low, high, (n, 2))])


def laid(patches):
    """Points and heights of patches, and among them what lies between and beside."""
    uv = np.concatenate([points for points, _ in patches])
    heights = [np.broadcast_to(height, len(points)) for points, height in patches]
    return uv, np.concatenate(heights)


def test_a_surface_ends_where_the_last_point_of_each_part_lies(rng):
    xy = rng.uniform(-0.52, 0.52, (40, 2))
    xy = xy[np.abs(xy[:, 1] + 0.16) > 0.081]  # one part sees nothing at all
    gaps = []
    for turned in (xy, -xy, xy[:, ::-1], -xy[:, ::-1]):  # each edge is the right one once
        for low in (-0.40, -0.24, -0.08, 0.08, 0.24):
            part = turned[(turned[:, 1] >= low) & (turned[:, 1] <= low + 0.16)]
            gaps.append(min([0.5, *(max(0.5 - x, 0) for x in part[:, 0])]))
    assert gaps.count(0.5) >= 2
    assert tasks.end_mm(xy) == pytest.approx(1000 * rms(gaps))


def test_a_round_sign_lacks_the_rim_of_each_sector(rng):
    angle, radius = rng.uniform(-180, 180, 60), rng.uniform(0.05, 0.31, 60)
    lacks = []
    for low in np.arange(-180, 180, 22.5):
        own = radius[(angle >= low) & (angle < low + 22.5)]
        lacks.append(tasks.SIGN_M - own.max(initial=0))
    way = np.radians(angle)
    xy = radius[:, None] * np.column_stack([np.cos(way), np.sin(way)])
    assert tasks.outline_mm(xy) == pytest.approx(1000 * rms(lacks))


def test_each_sign_has_the_height_and_slope_of_its_quarter(rng):
    quarters = {(-1, -1): (0.01, 0.02, 0.003), (1, -1): (0.0, -0.03, -0.001)}
    quarters |= {(-1, 1): (0.04, 0.0, 0.002), (1, 1): (-0.02, 0.01, 0.005)}
    patches, offsets, tilts = [], [], []
    for (i, j), (a, b, c) in quarters.items():
        xy = within(rng, (min(0.5 * i, 0), min(0.5 * j, 0)), (max(0.5 * i, 0), max(0.5 * j, 0)))
        patches.append((xy, a * (xy[:, 0] - 0.25 * i) + b * (xy[:, 1] - 0.25 * j) + c))
        offsets.append(1000 * c)
        tilts.append(np.degrees(np.arctan(np.hypot(a, b))))
    beside = np.array([[0.501, 0.1], [-0.501, 0.1], [0.1, 0.501], [0.1, -0.501]])
    xy, z = laid([*patches, (beside, FAR)])
    found = tasks.sign_errors(np.column_stack([xy, z]))
    assert found == pytest.approx({"offset_mm": rms(offsets), "tilt_deg": rms(tilts)})
    few = xy[:, 0] * xy[:, 1] < 0  # two of the quarters are seen
    found = tasks.sign_errors(np.column_stack([xy, z])[few & (np.abs(xy).max(axis=1) < 0.5)])
    expected = {"offset_mm": rms([100, 100, 1, 2]), "tilt_deg": rms([90, 90, *tilts[1:3]])}
    assert found == pytest.approx(expected)
    assert tasks.sign_errors(np.column_stack([xy, z + 5]))["offset_mm"] == 100


def test_a_step_is_between_the_patches_on_both_sides_of_it(rng):
    heights, patches = rng.normal(0, 0.004, (5, 2)), []
    for row, pair in zip(np.arange(-0.5, 0.4, 0.2), heights, strict=True):
        for left, height in zip((-0.2, 0.0), pair, strict=True):
            patches.append((within(rng, (left, row), (left + 0.2, row + 0.2)), height))
    beside = np.array([[0.2001, 0.1], [-0.2001, 0.1], [0.1, 0.5001], [-0.1, -0.5001]])
    uv, z = laid([*patches, (beside, FAR)])
    steps = 1000 * np.diff(heights)[:, 0]
    assert tasks.step_mm(uv, z) == pytest.approx(rms(steps))
    for side in (1, -1):  # of one row a patch is not seen
        seen = ~((uv[:, 1] > 0.3) & (side * uv[:, 0] > 0))
        assert tasks.step_mm(uv[seen], z[seen]) == pytest.approx(rms([*steps[:4], 10]))


def test_a_crack_is_lower_than_what_lies_beside_it(rng):
    heights, patches = rng.normal(0, 0.004, (9, 2)), []
    for row, (deep, top) in zip(np.arange(-0.45, 0.36, 0.1), heights, strict=True):
        patches.append((within(rng, (-0.02, row), (0.02, row + 0.1)), deep))
        for left in (-0.15, 0.03):
            patches.append((within(rng, (left, row), (left + 0.12, row + 0.1)), top))
    between = np.array([[0.0201, 0], [0.0299, 0], [-0.0299, 0], [0.1501, 0], [-0.1501, 0]])
    uv, z = laid([*patches, (between, FAR), ([[0.0, 0.4501], [0.0, -0.4501]], FAR)])
    errors = 20 + 1000 * (heights[:, 0] - heights[:, 1])
    assert tasks.crack_mm(uv, z) == pytest.approx(rms(errors))
    for seen in (np.abs(uv[:, 0]) > 0.02, np.abs(uv[:, 0]) < 0.03):  # of one piece not both
        seen = seen | (uv[:, 1] < 0.35)
        assert tasks.crack_mm(uv[seen], z[seen]) == pytest.approx(rms([*errors[:8], 20]))


def test_a_kerb_stands_where_two_means_leave_least(rng):
    errors, patches = [], []
    for row in np.arange(-0.35, 0.26, 0.1):
        uv = within(rng, (-0.15, row), (0.15, row + 0.1), 14)
        z = rng.normal(0, 0.01, len(uv)) + np.where(uv[:, 0] > rng.uniform(-0.1, 0.1), 0.015, 0)
        x, heights = uv[np.argsort(uv[:, 0]), 0], z[np.argsort(uv[:, 0])]
        left = [sum(part.var() * len(part) for part in (heights[:k], heights[k:]))
                for k in range(1, len(x))]  # fmt: skip
        k = int(np.argmin(left))
        errors.append(1000 * (x[k] + x[k + 1]) / 2)
        patches.append((uv, z))
    beside = [[0.1501, 0], [-0.1501, 0], [0.1, 0.3501], [-0.1, -0.3501]]
    uv, z = laid([*patches, (np.array(beside), FAR)])
    assert tasks.kerb_mm(uv, z) == pytest.approx(rms(errors))
    order = np.argsort(uv[:, 1])
    uv, z = uv[order], z[order]
    last = np.flatnonzero((uv[:, 1] > 0.25) & (uv[:, 1] < 0.35))
    three = np.delete(np.arange(len(uv)), last[3:])  # of the last strip three points are left
    assert tasks.kerb_mm(uv[three], z[three]) == pytest.approx(rms([*errors[:6], 150]))
    four = np.array([[-0.02, 0], [-0.01, 0], [0.03, 0], [0.04, 0]])
    found = tasks.kerb_mm(four, np.array([0, 0, 1.0, 1]))
    assert found == pytest.approx(rms([10] + 6 * [150]))


def test_a_pothole_is_the_mean_depth_within_its_rim(rng):
    uv = rng.uniform(-0.5, 0.5, (60_000, 2))
    square = (uv**2).sum(axis=1)
    for power in (0, 1, 2):  # the mean of r^(2k) in a circle is R^(2k) / (k + 1)
        z = np.where(square < 0.255**2, -0.02 * (power + 1) * (square / 0.25**2) ** power, FAR)
        assert tasks.pothole_percent(uv, z) == pytest.approx(20, abs=0.4)
    assert tasks.pothole_percent(uv, np.where(uv[:, 0] > 0, -0.03, 0)) == pytest.approx(40, abs=1)
    assert tasks.pothole_percent(uv, np.where(uv[:, 1] > 0, -0.03, 0)) == pytest.approx(40, abs=1)
    assert tasks.pothole_percent(uv, np.full(len(uv), 0.1)) == 100


@pytest.mark.parametrize(("noise", "beam"), [(0.0, 0.0), (0.006, 0.0), (-0.013, 0.02)])
def test_a_relief_of_one_point_is_the_variance_of_its_waves(noise, beam):
    at = 0.0125  # a quarter of the shortest wave from its crest
    found = [tasks.relief_percent(np.array([[at, 0.1]]), np.array([noise]), beam, [k])
             for k in range(60)]  # fmt: skip
    shares = []
    for length in (0.05, 0.10, 0.20):
        ring = beam * np.array([0, 1, 0.5, -0.5, -1, -0.5, 0.5])
        seen = noise + 0.01 * np.mean(np.cos(2 * np.pi * (at + ring) / length))
        shares.append(100 * np.sqrt(1 + 2 * (seen / 0.01) ** 2))  # whole waves in 60 cm
    assert np.mean(found) == pytest.approx(np.mean(shares), rel=0.005)
    still = tasks.relief_percent(np.array([[0.0, 0.0], [0.1, 0]]), np.zeros(2), 0.0, [1])
    assert still != tasks.relief_percent(np.array([[0.0, 0.0]]), np.zeros(1), 0.0, [1])


def test_walls_lie_apart_by_their_mean_distance(rng):
    along, up = rng.uniform(0.06, 1, 30), rng.uniform(-1, 1, 30)
    walls = {side: np.column_stack([side * along, up, -along]) for side in (-1, 1)}
    normals = {side: np.array([side, 0, 1]) / 2**0.5 for side in (-1, 1)}
    corner = np.concatenate([*walls.values(), [[0.05, 0, FAR], [-0.05, 0, FAR]]])
    moved = [walls[side] + off * normals[side] for side, off in ((-1, 0.003), (1, -0.004))]
    again = np.concatenate([*moved, [[0.05, 0, FAR], [-0.05, 0, FAR]]])
    assert tasks.alignment_mm(corner, again) == pytest.approx(rms([3, 4]))
    assert tasks.alignment_mm(again, corner) == pytest.approx(rms([3, 4]))
    assert tasks.alignment_mm(corner, corner + 3 * normals[1]) == 100
    near = np.array([[0.051, 0, -0.051]]) + 0.031 * normals[1]
    both = rms([(31 - 30 * 4) / 31, 3])  # one wall has one point more
    assert tasks.alignment_mm(corner, np.concatenate([again, near])) == pytest.approx(both)
    left, right = walls[-1][:10], walls[1][:10]
    assert tasks.alignment_mm(np.r_[left, right], np.r_[left, right]) < 1e-9
    for few in (np.r_[left[:9], right], np.r_[left, right[:9]]):
        assert tasks.alignment_mm(np.r_[left, right], few) == 100
        assert tasks.alignment_mm(few, np.r_[left, right]) == 100


def test_a_wire_is_seen_between_its_ends_alone():
    start, end = np.array(tasks.WIRE[:2])
    side = np.array([0.4, -1, 0]) / np.hypot(0.4, 1) * 0.01  # at its surface
    at = np.array([-0.1, 0.1, 0.2, 0.65, 0.9, 1.3])
    points = start + at[:, None] * (end - start) + side
    assert tasks.wire_m(points) == pytest.approx(0.45 * np.hypot(2, 0.8))
    assert tasks.wire_m(points[1:3]) == pytest.approx(0.8 * np.hypot(2, 0.8))
    assert tasks.wire_m(points[3:5]) == pytest.approx(0.65 * np.hypot(2, 0.8))


def test_a_corner_is_covered_by_the_edges_near_it(monkeypatch):
    upright = [
        [(0.003, -0.83, 0.004), (0.0, 0.11, 0.002)],
        [(0, 0.67, -0.01), (0.006, 0.44, 0.008)],
    ]
    aside = [[(0.2, -1, 0), (0, 1, 0)], [(0, -1, 0), (0, 1, 0.2)]]  # one end more than 10 cm off
    segments = np.array(upright + aside)
    monkeypatch.setattr(tasks, "extract_edges", lambda _: SimpleNamespace(segments=segments))
    wall = np.repeat([3, 4], [100, 10])
    found = tasks.corner_errors(None, wall)
    heights = np.arange(-0.975, 1, 0.05)  # forty
    seen = [-0.83 <= h <= 0.11 or 0.44 <= h <= 0.67 for h in heights]
    assert found["edge_missed_percent"] == pytest.approx(100 * (1 - np.mean(seen)))
    assert found["edge_mm"] == pytest.approx(rms([5, 2, 10, 10]))
    assert np.isnan(list(tasks.corner_errors(None, wall[:-1]).values())).all()
    assert np.isnan(list(tasks.corner_errors(None, wall[:100]).values())).all()
    segments = segments[2:]
    assert tasks.corner_errors(None, wall) == {"edge_missed_percent": 100, "edge_mm": 100}


def test_a_post_is_found_at_its_foot_and_a_missed_one_has_no_diameter(monkeypatch, rng):
    seen = []
    rows = [(-1.2, 0.0, 0.07), (-1.3, 0.1, 0.08), (0.29, -0.29, np.nan), (1.51, 0, 0.5)]
    rows += [(1.2, 0.31, 0.9), (-1.2, -0.31, 0.9)]
    table = pd.DataFrame(rows, columns=["x_m", "y_m", "diameter_m"])

    def detect(points, *, method):
        seen.append((points, method))
        return table

    monkeypatch.setattr(tasks.poles, "detect", detect)
    points = rng.normal(size=(5, 3))
    found = tasks.post_errors(points)
    turned, method = seen[0]
    assert method == "itc"
    assert turned == pytest.approx(np.column_stack([points[:, 0], -points[:, 2], points[:, 1]]))
    # the widest of two near the first; the second without diameter; none near the third
    assert found["diameter_mm"] == pytest.approx(rms([80 - 60, 120, 300]))
    assert found["pole_missed_percent"] == pytest.approx(100 / 3)
    table = table[:0]
    assert tasks.post_errors(points)["diameter_mm"] == pytest.approx(rms([60, 120, 300]))


def test_details_are_not_shown_where_fewer_than_three_points_lie(rng):
    none = {"detail_5_percent": 100.0, "detail_10_percent": 100.0, "detail_mm": 1000.0}
    assert tasks.shown(rng.uniform(-0.4, 0.4, (3, 2))) == none
    xy = rng.uniform(-0.7, 0.7, (1200, 2))  # beyond the edges, so that no place lacks neighbours
    found = tasks.shown(xy)
    assert tasks.shown(0.05 * xy[:4])["detail_10_percent"] < 100
    places = rng.uniform(-0.5, 0.5, (3000, 2))
    third = np.partition(np.hypot(*(places[:, None] - xy).T), 2, axis=0)[2]
    for k in (5, 10):
        missed = 100 * np.mean(third > k / 200)
        assert found[f"detail_{k}_percent"] == pytest.approx(missed, abs=1.5)
    assert found["detail_mm"] == pytest.approx(2000 * np.quantile(third, 0.95), rel=0.03)


def test_errors_of_a_case_are_those_of_its_things(rng, monkeypatch):
    places = {
        "board": (300, 3),
        "sign": (50, 3),
        "corner": (90, 3),
        "wire": (9, 3),
        "posts": (9, 3),
    }
    points = {name: rng.uniform(-0.5, 0.5, shape) for name, shape in places.items()}
    again, turn = rng.uniform(-0.5, 0.5, (90, 3)), 0.7
    monkeypatch.setattr(tasks, "corner_errors", lambda *given: {"corner": given})
    monkeypatch.setattr(tasks, "post_errors", lambda given: {"posts": given})
    surface = {"corner": np.arange(90)}
    found = tasks.errors_of(points, surface, again, beam_m=0.004, turn=turn, seed=[5])
    board = points["board"]
    turned = (board[:, 0] + 1j * board[:, 1]) * np.exp(-1j * turn)
    uv = np.column_stack([turned.real, turned.imag])
    expected = tasks.relief_errors(uv, board[:, 2], 0.004, [5]) | tasks.sign_errors(board)
    expected |= tasks.shown(board[:, :2]) | {"end_mm": tasks.end_mm(board[:, :2])}
    expected |= {"outline_mm": tasks.outline_mm(points["sign"][:, :2])}
    expected |= {"alignment_mm": tasks.alignment_mm(points["corner"], again)}
    expected |= {"wire_m": tasks.wire_m(points["wire"])}
    assert found.pop("corner") == (points["corner"], surface["corner"])
    assert found.pop("posts") is points["posts"]
    assert found == pytest.approx(expected)


def test_things_that_are_drawn_onto_a_board_have_their_sizes(rng):
    uv = rng.uniform(-0.4, 0.4, (500, 2))
    seen = {}
    with pytest.MonkeyPatch.context() as patch:
        for name in ("crack_mm", "pothole_percent", "kerb_mm"):
            patch.setattr(tasks, name, lambda *given, name=name: seen.setdefault(name, given[1]))
        tasks.relief_errors(uv, np.full(500, 0.001), 0.0, [1])
    for (x, y), crack, hole, kerb in zip(uv, *seen.values(), strict=True):
        assert crack == pytest.approx(0.001 - (0.02 if abs(x) < 0.02 else 0))
        assert kerb == pytest.approx(0.001 + (0.015 if x > 0 else 0))
        depth = 0.05 * (1 - (x * x + y * y) / 0.25**2)
        assert hole == pytest.approx(0.001 - max(depth, 0))
