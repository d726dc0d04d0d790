"""The second street generator: its points lie on what it says stands there."""

import numpy as np
import pytest
from other_street import SCANNERS, OtherStreet, _cylinders, _faces, cast, make, scan, tables


@pytest.fixture(scope="module")
def driven():
    """A short street and what the tilted profiler sees of it."""
    street = make(3, length=12.0)
    return street, *scan(street, "tilted profiler", 3)


def test_points_of_poles_lie_on_their_shafts(driven):
    street, points, _, _, pole, _ = driven
    poles, _ = tables(street, pole)
    assert poles["visible"].sum() >= 4
    assert (poles["height_m"] > 1).all()
    row = poles.iloc[pole[pole >= 0]]
    on = points[pole >= 0]
    lean = row[["lean_x", "lean_y"]].to_numpy()
    up = on[:, 2] - row["z_base_m"].to_numpy()
    axis = row[["foot_x_m", "foot_y_m"]].to_numpy() + up[:, None] * lean
    away = np.hypot(*(on[:, :2] - axis).T)
    noise = SCANNERS["tilted profiler"]["noise"]
    # the shaft leans by 1.5 %: a level cut is an ellipse 0.01 % longer than wide
    assert np.abs(away - row["diameter_base_m"].to_numpy() / 2).max() < 6 * noise
    assert -6 * noise < up.min()
    assert (up <= row["height_m"].to_numpy() + 6 * noise).all()


def test_points_lie_on_both_sides_of_the_edges_that_are_seen(driven):
    """Beside the middle of a foot of a wall there is pavement, above it wall: a right angle."""
    street, points, _, _, pole, _ = driven
    _, edges = tables(street, pole)
    level = np.ptp(edges[:, :, 2], axis=1) == 0
    low = edges[level & (edges[:, 0, 2] < 0.2) & (np.ptp(edges[:, :, 1], axis=1) > 0)]
    shares = []
    for start, end in low:
        along = (points - start) @ (end - start) / np.sum((end - start) ** 2)
        off = points - start - along[:, None] * (end - start)
        off = off[(along > 0) & (along < 1) & (np.linalg.norm(off, axis=1) < 0.5)]
        if len(off) > 100:
            shares.append((np.abs(off[:, [0, 2]]).min(axis=1) < 0.05).mean())
    assert len(shares) >= 2
    assert min(shares) > 0.9  # the rest is furniture


def test_culling_changes_no_range():
    street = make(5, length=14.0)
    rng = np.random.default_rng(1)
    direction = rng.normal(size=(640, 3)) * 0.2 + [1, 0, 0]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    origin = np.tile([0.0, 7.0, 2.0], (640, 1))
    street.balls = [[0, 0, 500, 0.1, 1.0]]  # out of reach: leaves are drawn at random
    reach, _ = cast(street, origin, direction, rng)
    rays = origin[:, None], direction[:, None]
    cylinders, faces = np.array(street.cylinders), np.array(street.faces, float)
    brute = np.column_stack([_cylinders(cylinders, *rays), _faces(faces, *rays)]).min(axis=1)
    assert np.array_equal(reach, brute)
    assert np.isfinite(reach).mean() > 0.5


def test_solids_are_met_where_geometry_says():
    ray = np.array([[[0.0, 0, 1]]]), np.array([[[1.0, 0, 0]]])
    leaning = np.array([[5.0, 0, 0, 5, 0, 3, 0.25, 0]])
    assert _cylinders(leaning, *ray) == pytest.approx(4.75)
    plate = np.array([[4.0, -1, 0, 0, 2, 0, 0, 0, 1.9, 0], [3.0, -1, 0, 0, 2, 0, 0, 0, 1.9, 1]])
    assert _faces(plate, *ray).tolist() == [[4.0, np.inf]]  # the triangle's half is below the ray


def test_leaves_let_through_what_beer_and_lambert_say():
    street = OtherStreet(1.0)
    street.balls.append([5.0, 0, 0, 1.0, 0.7])
    street.cylinder((0, 0, -90), (0, 0, -80), 0.1)
    street.face((0, 0, -99), (1, 0, 0), (0, 1, 0))
    n = 20_000
    ways = cast(street, np.zeros((n, 3)), np.tile([1.0, 0, 0], (n, 1)), np.random.default_rng(2))[0]
    through = np.exp(-0.7 * 2)
    assert np.isinf(ways).mean() == pytest.approx(through, abs=4 * np.sqrt(through / n))


@pytest.mark.parametrize("scanner", SCANNERS)
def test_every_scanner_sees_poles(scanner):
    points, time, line, pole, path = scan(make(1, length=6.0), scanner, 1)
    assert np.isfinite(points).all()
    assert (np.diff(time) > 0).all()
    assert len(np.unique(line)) > 15
    assert (pole >= 0).any()
    assert np.ptp(path[:, 1]) == pytest.approx(0 if scanner == "single sweep" else 6, abs=0.1)


def test_seeds_repeat_a_street_and_its_scan():
    first, again = (scan(make(1, length=2.0), "16 beams", 1)[0] for _ in range(2))
    assert np.array_equal(first, again)
    assert len(first) != len(scan(make(2, length=2.0), "16 beams", 1)[0])
