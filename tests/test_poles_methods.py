"""The published methods part by part: both sides of each limit, and figures of scenes by hand."""

import numpy as np
import pandas as pd
import pytest

from mmqa_lab.cloud import Cloud
from mmqa_lab.poles import common, fgi, itc, learned
from mmqa_lab.rotations import turned


def upright(n=40, *, high=3.0, wide=0.02, x=0.0, low=0.0, seed=1):
    """Points about an upright axis."""
    rng = np.random.default_rng(seed)
    turn, z = rng.uniform(0, 2 * np.pi, n), np.linspace(low, low + high, n)
    return np.column_stack([x + wide * np.cos(turn), wide * np.sin(turn), z])


@pytest.mark.parametrize(
    ("kind", "inside", "outside"),
    [("gap", 0.099, 0.101), ("pulses", 3, 4), ("long", 0.449, 0.451), ("few", 3, 2)],
)
def test_groups_of_scan_lines_end_at_their_limits(kind, inside, outside):
    for value, whole in ((inside, True), (outside, False)):
        n = value if kind == "few" else 6
        x, pulse = 0.08 * np.arange(n), np.arange(n)
        if kind == "gap":
            x[3:] += value - 0.08
        if kind == "pulses":
            pulse[3:] += value - 1
        if kind == "long":
            x *= value / x[-1]
        points = np.column_stack([0.6 * x, 0 * x, 0.8 * x]) + [5, 6, 7]
        group, kept = fgi.segment_lines(points, np.full(n, 9), pulse)
        assert (set(group) == {0}) == whole, value
        if whole:
            assert kept["centre"] == pytest.approx(points.mean(axis=0)[None])
            assert kept["half"] == pytest.approx([x[-1] / 2])
            assert kept["line"].tolist() == [9]
        if kind in ("gap", "pulses") and not whole:
            assert group.tolist() == [0, 0, 0, 1, 1, 1]
        if kind == "long":
            assert kept["rise"] == pytest.approx([] if whole else [0.8])


@pytest.mark.parametrize(
    ("kind", "inside", "outside"), [("gap", 0.029, 0.031), ("lines", 2, 3), ("same", 1, 0)]
)
def test_groups_that_overlap_on_neighbouring_lines_are_a_cluster(kind, inside, outside):
    for value, one in ((inside, True), (outside, False)):
        apart = 0.2 + 0.1 + (value if kind == "gap" else 0)
        line = np.array([4, 4 + (1 if kind == "gap" else value)])
        centre = np.array([[5.0, 6, 1], [5 + 0.6 * apart, 6 + 0.8 * apart, 9]])
        groups = {"centre": centre, "half": np.array([0.2, 0.1]), "line": line}
        assert (len(set(fgi._clusters(groups))) == 1) == one, value


@pytest.mark.parametrize(
    ("kind", "inside", "outside"),
    [("aside", 0.195, 0.205), ("gap", 1.95, 2.05), ("angle", 11, 13), ("short", 0.45, 0.6),
     ("low", 0.21, 0.19)],
)  # fmt: skip
def test_coaxial_clusters_are_merged_within_limits(kind, inside, outside):
    for value, one in ((inside, True), (outside, False)):
        high = value if kind in ("short", "low") else 1.0
        lower, upper = upright(wide=0.004), upright(high=high, wide=0.004, seed=2)
        if kind == "low":
            upper[:, 2] += 0.05
        if kind in ("angle", "short"):  # about its own middle; a short one may lean as it likes
            lean = value if kind == "angle" else 25
            upper = (upper - upper.mean(axis=0)) @ turned(x=lean).T + [0, 0, upper[:, 2].mean()]
        lower[:, 2] = lower[:, 2] / 3 - 1.1
        upper[:, 2] += value - 0.1 if kind == "gap" else 0
        upper[:, 0] += value if kind == "aside" else 0
        points = np.vstack([lower, upper])
        if kind == "angle":  # both axes meet in the middle between them
            upper[:, 1] += (
                np.tan(np.radians(value)) * (upper[:, 2].mean() - lower[:, 2].mean()) / -2
            )
            points = np.vstack([lower, upper])
        found = fgi._merged(points, np.repeat([0, 1], 40))
        assert (len(set(found)) == 1) == one, value


def test_axes_of_clusters_have_their_ends_and_shape(rng):
    lean = turned(x=20)
    parts = [rng.normal(size=(200, 3)) * [0.1, 0.2, 1], rng.normal(size=(90, 3)) * [1, 0.2, 0.1]]
    parts[0] = parts[0] @ lean.T + [5, 6, 7]
    order = rng.permutation(290)
    points, member = np.vstack(parts)[order], np.repeat([0, 1], [200, 90])[order]
    found = fgi._axes(points, member)
    for k, part in enumerate(parts):
        values, vectors = np.linalg.eigh(np.cov(part.T, ddof=0))
        way = vectors[:, 2] * (1 if vectors[2, 2] >= 0 else -1)
        along = (part - part.mean(axis=0)) @ way
        assert found["centre"][k] == pytest.approx(part.mean(axis=0))
        assert found["direction"][k] == pytest.approx(way)
        assert found["ends"][k] == pytest.approx([along.min(), along.max()])
        assert found["ratio"][k] == pytest.approx(values[2] / values[1])


@pytest.mark.parametrize(("degrees", "wide", "right"), [(14, 0.1, 1), (16, 0.1, 0), (0, 0.48, 1),
                                                         (0, 0.52, 0)])  # fmt: skip
def test_what_is_upright_leans_by_fifteen_degrees_and_is_four_times_as_varied(degrees, wide, right):
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 9)] * 3), axis=-1).reshape(-1, 3)
    points = grid * [wide / 2, wide, 1] @ turned(x=degrees).T
    assert fgi._is_upright(points) == bool(right)


@pytest.mark.parametrize(("more", "kept"), [(6, True), (8, False)])
def test_the_mask_takes_steps_whose_inner_cylinder_has_most_points(more, kept):
    """40 points a step in the inner cylinder: with 7 around it the share is .85."""
    own = upright(150, high=3.05, wide=0.05)
    axis = np.array([0, 0, 1.525]), np.array([0, 0, 1.0])
    inside = [((own[:, 2] >= a) & (own[:, 2] <= a + 0.8)).sum() for a in np.arange(0, 2.3, 0.2)]
    assert {*inside} == {39, 40}
    beside = np.column_stack([np.full(more, 0.34), np.zeros(more), np.full(more, 0.5)])
    aside = np.column_stack([np.full(9, 0.36), np.zeros(9), np.full(9, 0.5)])
    tree = common.cKDTree(np.vstack([own, beside, aside]))
    accepted, share = fgi._mask(tree, own, axis)
    at = np.arange(0, 2.2 + 1e-9, 0.2)
    shares = np.array(
        [n / (n + more * (a <= 0.5 <= a + 0.8)) for a, n in zip(at, inside, strict=True)]
    )
    good = shares >= 0.85
    assert good.all() == kept
    assert share == pytest.approx(shares[good].mean())
    steps = [(own[:, 2] >= a) & (own[:, 2] <= a + 0.8) for a in at[good]]
    assert np.array_equal(accepted, np.any(steps, axis=0))
    nothing = fgi._mask(tree, own[:2], axis)
    assert (nothing[0].any(), nothing[1]) == (False, 0)


@pytest.mark.parametrize(("lines", "known"), [(5, True), (4, False)])
def test_a_chord_is_the_median_of_lines_and_their_spacing(lines, known, rng):
    """Lines of 3, 5, 7 ... hits, 1, 2, 3 ... cm apart, across a slanted axis; one line has one."""
    way = turned(x=30)
    parts, number = [np.array([[9.0, 0, 0]])], [0]
    for k in range(1, lines + 1):
        x = 0.01 * k * np.arange(2 * k + 1)
        parts.append(np.column_stack([x, 0 * x, 0.3 * k + rng.normal(size=2 * k + 1)]))
        number += [k] * (2 * k + 1)
    found = fgi.chord_diameter(np.vstack(parts) @ way.T, way[:, 2], np.array(number))
    chords = [0.02 * k * k for k in range(1, lines + 1)]
    spacings = [0.01 * k for k in range(1, lines + 1)]
    assert np.isfinite(found) == known
    assert not known or found == pytest.approx(np.median(chords) + np.median(spacings))


def test_lines_and_pulses_are_those_of_columns_or_of_time():
    columns = {"scan_line": [7, 7, 9, 9], "gps_time": [5.0, 5.2, 6.0, 6.5], "head": [0, 1, 0, 1]}
    line, pulse = fgi.scan_lines(Cloud(np.zeros((4, 3)), columns))
    assert line.tolist() == [0, 2 + 2 + 1, 2, 2 + 2 + 2 + 1]
    # the steps within lines of a head are none, so pulses are whole seconds
    assert pulse.tolist() == [0, 0, 1, 2]
    columns = {"scan_line": [3, 3, 3, 4, 4], "gps_time": [1.0, 1.01, 1.03, 2.0, 2.02]}
    line, pulse = fgi.scan_lines(Cloud(np.zeros((5, 3)), columns))
    assert line.tolist() == [0, 0, 0, 1, 1]
    assert pulse.tolist() == pytest.approx(np.round(np.array([0, 0.01, 0.03, 1, 1.02]) / 0.02))
    given = {"scan_line": [3, 4], "pulse": [17, 5], "point_source_id": [1, 8]}
    line, pulse = fgi.scan_lines(Cloud(np.zeros((2, 3)), given))
    assert (line.tolist(), pulse.tolist()) == ([0, 1 + 1 + 3], [17, 5])


def test_a_leaning_post_has_its_place_length_and_chord_by_scan_lines():
    """Profiles each 10 cm, seven points 2 cm apart: a chord of 12 cm and a spacing."""
    h, k = (
        one.ravel() for one in np.meshgrid(np.arange(0, 3.01, 0.1), np.arange(7), indexing="ij")
    )
    points = np.column_stack([0.1 * h + 0.02 * (k - 3), 0 * h + 5, h])
    line = np.round(h * 10).astype(int)
    order = np.random.default_rng(0).permutation(len(h))
    (found,) = fgi.detect(points[order], (line[order], k[order])).to_dict("records")
    vectors = np.linalg.eigh(np.cov(points.T))[1]
    way = vectors[:, 2] * np.sign(vectors[2, 2])
    along = (points - points.mean(axis=0)) @ way
    steps = np.floor((np.ptp(along) - 0.8) / 0.2)  # of the mask, which is 80 cm long
    own = along <= along.min() + 0.8 + 0.2 * steps
    low, high = (points.mean(axis=0) + end * way for end in (along.min(), along[own].max()))
    assert [found["x_m"], found["y_m"]] == pytest.approx((low + high)[:2] / 2)
    assert (found["z_base_m"], found["height_m"]) == pytest.approx((low[2], high[2] - low[2]))
    assert (found["lean_x"], found["lean_y"]) == pytest.approx((way[0] / way[2], 0), abs=1e-9)
    across = points - np.outer(points @ way, way)
    chord = np.median(
        [np.linalg.norm(across[line == n][-1] - across[line == n][0]) for n in range(31)]
    )
    assert found["diameter_m"] == pytest.approx(chord * 7 / 6)
    assert found["score"] == 1
    assert found["tilt_deg"] == pytest.approx(np.degrees(np.arctan(way[0] / way[2])))


@pytest.mark.parametrize(
    ("kind", "inside", "outside"),
    [("diagonal", 0.59, 0.61), ("shift", 0.145, 0.155), ("growth", 0.245, 0.255), ("empty", 1, 2)],
)
def test_stacks_of_slices_end_at_their_limits(kind, inside, outside):
    """Twelve slices with the corners of a square of 20 cm; the upper five differ."""
    for value, whole in ((inside, True), (outside, False)):
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2
        level, xy = np.repeat(np.arange(12), 4), np.tile(0.2 * corners, (12, 1))
        upper = level > 6
        if kind == "diagonal":  # of all slices but the lowest two
            level, upper = np.repeat(np.arange(12), 4), level > 1
            xy = np.where(upper[:, None], np.sqrt(0.5) * value, np.sqrt(0.5) * 0.5) * np.tile(
                corners, (12, 1)
            )
        if kind == "shift":
            xy[upper] += [0.6 * value, 0.8 * value]
        if kind == "growth":
            xy[upper] *= 1 + value / (0.2 * np.sqrt(2))
        if kind == "empty":
            level[upper] += value
        row = dict(zip(itc.STACK_COLUMNS, itc._stack(xy + [50, 60], level), strict=True))
        levels = 12 + (value if kind == "empty" else 0)
        expected = levels if whole else 2 if kind == "diagonal" else 7
        assert row["height_m"] == pytest.approx(0.3 * expected), value
        assert row["score"] == pytest.approx(1 if whole else {"diagonal": 2}.get(kind, 7) / 12)


def test_a_stack_has_the_place_and_the_lean_of_its_slices():
    corners, level = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [0.1, 0.05], np.arange(10) + 3
    xy = np.concatenate([corners + [50 + 0.03 * k, 60 - 0.015 * k] for k in range(10)])
    row = dict(zip(itc.STACK_COLUMNS, itc._stack(xy, np.repeat(level, 4)), strict=True))
    expected = {"x_m": 50 + 0.03 * 4.5, "y_m": 60 - 0.015 * 4.5, "z_base_m": 0.9, "height_m": 3.0}
    expected |= {"diameter_m": 0.2, "lean_x": 0.1, "lean_y": -0.05, "score": 1}
    assert row == pytest.approx(expected, abs=1e-6)


def test_components_are_found_above_the_ground_with_their_base():
    """A ring each 10 cm from the ground to 3 m: points lower than 30 cm belong to the ground."""
    turn = np.linspace(0, 2 * np.pi, 36, endpoint=False)
    ring = np.column_stack([0.1 * np.cos(turn), 0.1 * np.sin(turn)])
    level = np.arange(0.05, 3.0, 0.1)
    post = np.column_stack([np.tile(ring, (30, 1)) + [5, 7], np.repeat(level, 36)])
    i, j = (one.ravel() for one in np.mgrid[0:14:0.25, 0:14:0.25])
    floor = np.column_stack([i, j, 0 * i])
    found = itc.detect(np.vstack([floor, post])).to_dict("records")
    assert len(found) == 1
    assert (found[0]["x_m"], found[0]["y_m"]) == pytest.approx((5, 7), abs=1e-6)
    assert found[0]["z_base_m"] == pytest.approx(0.35)
    assert found[0]["height_m"] == pytest.approx(2.7)  # nine slices from 0.35 to 2.95
    assert found[0]["diameter_m"] == pytest.approx(0.2, abs=1e-3)
    short = itc.detect(np.vstack([floor, post[post[:, 2] < 1.2]]), explain=True)
    assert short["rejected_by"].tolist() == ["length"]


@pytest.mark.parametrize(
    ("kind", "inside", "outside"),
    [("long", 2.0, 1.2), ("high", 2.4, 1.6), ("lean", 13, 17), ("thick", 0.025, 0.036)],
)
def test_walls_are_long_high_upright_and_thin(kind, inside, outside, rng):
    for value, right in ((inside, True), (outside, False)):
        size = [value if kind == "long" else 3.2, value if kind == "high" else 3.2]
        n = int(900 * size[0] * size[1] / 10)
        a, b = rng.uniform(0, 1, (2, n)) * np.array(size)[:, None]
        off = (value if kind == "thick" else 0.001) * np.where(rng.random(n) < 0.5, 1, -1)
        wall = np.column_stack([a, off, b]) @ turned(x=value if kind == "lean" else 0).T
        found = itc.walls(wall + [0.05, 0.2, 0.05])
        assert (found.mean() > 0.6) == right, value
        assert right or found.mean() < 0.2


def test_cells_touch_at_faces_edges_and_corners(rng):
    points = rng.uniform(0, 2, (80, 3))
    cell, count, found = itc._cells(points, 0.25)
    place = np.floor(points / 0.25).astype(int)
    unique = np.unique(place, axis=0)
    assert count == len(unique)
    where = np.array([place[cell == k][0] for k in range(count)])
    assert all((place[cell == k] == where[k]).all() for k in range(count))
    near = np.abs(where[:, None] - where).max(axis=2) == 1
    assert {tuple(sorted(pair)) for pair in found.T.tolist()} == {
        (i, j) for i, j in np.argwhere(near).tolist() if i < j
    }


def test_parts_joined_by_links_and_their_axes(rng):
    links = [(0, 3), (3, 5), (1, 2), (6, 6)]
    found = common.joined(*np.array(links).T, 8)
    groups = [{0, 3, 5}, {1, 2}, {4}, {6}, {7}]
    assert all(len({found[k] for k in one}) == 1 for one in groups)
    assert len(set(found)) == 5
    points, part = rng.normal(size=(60, 3)), rng.permutation(np.arange(60) % 3)
    centres, variances, vectors = common.principal_axes(points, part)
    for k in range(3):
        own = points[part == k]
        assert centres[k] == pytest.approx(own.mean(axis=0))
        assert variances[k] == pytest.approx(np.linalg.eigvalsh(np.cov(own.T, ddof=0)))
        spread = vectors[k].T @ np.cov(own.T, ddof=0) @ vectors[k]
        assert spread == pytest.approx(np.diag(variances[k]), abs=1e-12)


def test_trees_add_what_each_test_changes_and_their_roots(uncompiled):
    """Two trees: one asks the first measure and then the second, one is a leaf alone."""
    uncompiled(learned)
    trees = learned.Trees(
        feature=np.array([0, 1, 0, 0, 0, 0]), limit=np.array([1.0, 2, 0, 0, 0, 0]),
        left=np.array([1, 3, -1, -1, -1, -1]), right=np.array([2, 4, -1, -1, -1, -1]),
        value=np.array([0.5, 1.5, -2, 4, -1, 0.25]),
    )  # fmt: skip
    x = np.array([[1.0, 2.0], [1.0, 2.1], [1.1, 0.0]])
    parts, first = trees.parts(pd.DataFrame(x))
    assert parts.tolist() == [[1, 2.5], [1, -2.5], [-2.5, 0]]
    assert first == 0.75
    odds = np.array([4.25, -0.75, -1.75])
    assert trees.log_odds(x) == pytest.approx(odds)
    assert trees.score(x) == pytest.approx(1 / (1 + np.exp(-odds)))


def test_lessons_are_weighed_and_told_by_their_distance_at_the_height_of_their_run(monkeypatch):
    """Candidates at distances from a leaning pole of 4 m, seen in its upper half."""
    places = np.array([0.0, 0.29, 0.31, 0.59, 0.61, 5.0])
    given = np.column_stack([100 + places, np.full(6, 200.0), np.zeros((6, 3))])
    shaft = {"low": np.full(6, 2.0), "high": np.full(6, 4.0), "centre": np.full((6, 2), 9.0)}
    table = pd.DataFrame({"radius_m": np.full(6, 0.1), "arc": 0.5})

    def found(points, frame=None):
        shift = [*np.floor(given_points.min(axis=0))[:2], 0, 0, 0]
        return learned.Described(given - shift, table, shaft, lambda a: 0 * a[:, 0], points)

    given_points = np.array([[90.5, 190.5, 7.5], [110, 210, 12]])
    monkeypatch.setattr(learned, "describe", found)
    # at half of its height, 9 m, the pole is 0.2 m before the candidates' place at 10 m
    pole = {"x_m": [99.8], "y_m": [200.0], "z_base_m": [7.0], "height_m": [4.0]}
    pole = pd.DataFrame(pole | {"lean_x": 0.2, "lean_y": 0.0, "visible": True})
    measures, label, weight = learned.lessons(given_points, pole)
    assert measures.index.tolist() == [0, 1, 4, 5]
    assert label.tolist() == [1, 1, 0, 0]
    assert weight.tolist() == [1.25, 1.25, 0.5, 0.5]
    assert learned.lessons(given_points, pole.assign(visible=False))[1].tolist() == [0, 0]
