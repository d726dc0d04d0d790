"""Rays against surfaces: closed forms and brute force written here, shifts."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmqa_lab import simulate
from mmqa_lab.simulate import Scene, scenes, streets
from mmqa_lab.simulate.surfaces import disc, foliage

FAR = np.array([1e7, -4e6, 300.0])


def random_rays(rng, n, *, reach=20.0):
    """Rays from within a cube to random directions."""
    return rng.uniform(-reach, reach, (n, 3)), rng.standard_normal((n, 3))


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def parallelogram_range(corner, a, b, origin, direction):
    """o + t d = corner + s a + r b, solved as three equations."""
    matrix = np.stack(
        [direction, *np.broadcast_to([-a, -b], (len(direction), 2, 3)).swapaxes(0, 1)]
    )
    t, s, r = np.linalg.solve(np.moveaxis(matrix, 0, 2), (corner - origin)[..., None])[..., 0].T
    return np.where((t > 0) & (s >= 0) & (s <= 1) & (r >= 0) & (r <= 1), t, np.inf)


def cylinder_range(base, top, radius, origin, direction):
    """Uncapped cylinder: the quadratic of |(o + t d - base) x axis|^2 = radius^2."""
    axis = unit(top - base)
    length = np.linalg.norm(top - base)
    p, q = np.cross(origin - base, axis), np.cross(direction, axis)
    a, b, c = (q * q).sum(1), 2 * (p * q).sum(1), (p * p).sum(1) - radius**2
    with np.errstate(invalid="ignore"):
        root = np.sqrt(b * b - 4 * a * c)
    best = np.full(len(direction), np.inf)
    for t in ((-b - root) / (2 * a), (-b + root) / (2 * a)):
        h = ((origin + t[:, None] * direction - base) * axis).sum(1)
        best = np.where((t > 0) & (h >= 0) & (h <= length) & (t < best), t, best)
    return best


def disc_range(centre, normal, radius, origin, direction):
    """Where the ray meets the plane, if that is within the radius."""
    t = ((centre - origin) @ normal) / (direction @ normal)
    away = np.linalg.norm(origin + t[:, None] * direction - centre, axis=1)
    return np.where((t > 0) & (away <= radius), t, np.inf)


def test_a_street_of_all_kinds_equals_brute_force(rng):
    origin, direction = random_rays(rng, 3000, reach=12)
    direction = unit(direction)
    surfaces, ranges = [], []
    for _ in range(80):
        place, a, b = rng.uniform(-12, 12, 3), *rng.uniform(-3, 3, (2, 3))
        surfaces.append(simulate.rectangle(place, a, b))
        ranges.append(parallelogram_range(place, a, b, origin, direction))
        top, radius = place + rng.uniform(-4, 4, 3), rng.uniform(0.02, 1)
        surfaces.append(simulate.cylinder(place, top, radius, capped=False))
        ranges.append(cylinder_range(place, top, radius, origin, direction))
        normal, radius = unit(rng.standard_normal(3)), rng.uniform(0.1, 2)
        surfaces.append(disc(place, normal, radius))
        ranges.append(disc_range(place, normal, radius, origin, direction))
    ranges = np.array(ranges)
    hits = Scene(surfaces).cast(origin, direction)
    expected = ranges.min(axis=0)
    met = np.isfinite(expected)
    assert 0.2 < met.mean() < 0.99
    assert np.array_equal(np.isfinite(hits.range_m), met)
    assert np.abs(hits.range_m - expected)[met].max() < 1e-9
    assert np.array_equal(hits.surface[met], ranges.argmin(axis=0)[met])


@settings(max_examples=100, deadline=None)
@given(
    distance=st.floats(0.5, 300),
    radius=st.floats(0.002, 0.4),
    lean=st.floats(-0.5, 0.5),
    offset=st.floats(-0.99, 0.99),
)
def test_thin_leaning_posts_far_away_keep_their_digits(distance, radius, lean, offset):
    scene = Scene([simulate.cylinder((0, -3 * lean, -3), (0, 3 * lean, 3), radius, capped=False)])
    origin = np.array([[-distance, offset * radius, 0.0]])
    hits = scene.cast(origin, [[1.0, 0.0, 0.0]])
    across = np.longdouble(offset) * radius * np.cos(np.arctan(np.longdouble(lean)))
    expected = np.longdouble(distance) - np.sqrt(np.longdouble(radius) ** 2 - across**2)
    assert abs(hits.range_m[0] - expected) < 1e-11 * max(1, distance)


def test_cone_closes_at_its_tip_and_at_its_caps():
    cone = Scene([simulate.cylinder((0, 0, 0), (0, 0, 2), 0.4, top_radius=0.0)])
    hits = cone.cast(
        [[5, 0, 1], [5, 0, 1.999], [5, 0, 2.001], [0, 0, -3]], [[-1, 0, 0]] * 3 + [[0, 0, 1]]
    )
    expected = [4.8, 5 - 0.4 * 0.001 / 2, np.nan, 3.0]
    assert np.allclose(hits.range_m, expected, atol=1e-12, equal_nan=True)
    assert hits.cosine[0] == pytest.approx(1 / np.hypot(1, 0.2), abs=1e-12)
    assert hits.cosine[3] == pytest.approx(1, abs=1e-12)


def test_crown_lets_through_what_beer_and_lambert_say(rng):
    leaves, leaf, radius = 3000, 0.04, 2.0
    crown = foliage((0, 0, 0), radius, leaves=leaves, leaf_radius=leaf, seed=4)
    direction = unit(rng.standard_normal((20_000, 3)))
    gap = np.isnan(Scene([crown]).cast(-5 * direction, direction).range_m).mean()
    volume = 4 / 3 * np.pi * radius**3
    expected = np.exp(-leaves / volume * np.pi * leaf**2 / 2 * 2 * radius)
    # 3000 leaves seen through the middle: the sampling error of the crown itself is about 0.01
    assert gap == pytest.approx(expected, abs=0.03)


def test_moving_by_ten_thousand_kilometres_changes_nothing(rng):
    origin, direction = random_rays(rng, 500)

    def cast(shift):
        surfaces = [
            simulate.ground(-20 + shift[2], centre=shift[:2]),
            simulate.cylinder(shift + [3, 3, -20], shift + [3, 4, 20], 2.0, top_radius=1.0),
            disc(shift + [-8, 0, 0], (1, 2, 3), 2.0),
            simulate.box(shift + [0, 9, -20], (3, 5, 30), heading=20),
        ]
        return Scene(surfaces).cast(origin + shift, direction)

    here, there = cast(np.zeros(3)), cast(FAR)
    assert np.array_equal(here.surface, there.surface)
    met = here.surface >= 0
    # one step of float64 at 1e7 m is 1.9e-9 m; grazing rays stretch it
    assert np.abs(here.range_m - there.range_m)[met].max() < 1e-6
    assert np.median(np.abs(here.range_m - there.range_m)[met]) < 1e-8


def test_a_wall_is_open_where_its_openings_are(rng):
    """Openings of all sizes at all heights: everywhere a ray meets the wall or the pane."""
    openings = [(0.5, 0.2, 1.0, 3.0), (2.0, 1.0, 2.5, 1.0), (5.0, 2.0, 0.5, 1.5)]
    scene = Scene(simulate.wall((6, 5, 0), (-6, 0, 0), 4, openings=openings, reveal=0.3))
    x, z = rng.uniform([0, 0], [6, 4], (3000, 2)).T
    hits = scene.cast(np.column_stack([x, 0 * x, z]), np.tile([0.0, 1, 0], (3000, 1)))
    left = 6 - x
    within = [(left > s) & (left < s + w) & (z > b) & (z < b + h) for s, b, w, h in openings]
    assert np.allclose(hits.range_m, np.where(np.any(within, axis=0), 5.3, 5.0))


def test_many_equal_boxes_do_not_break_the_tree():
    stack = [disc((0, 0, 0), (1, 0, 0), 1.0) for _ in range(300)]
    hits = Scene(stack).cast([[5, 0, 0]], [[-1, 0, 0]])
    assert hits.range_m[0] == pytest.approx(5, abs=1e-12)


def test_an_opening_has_reveals_on_its_four_sides_and_wall_around_it():
    """From the middle of an opening 2 m wide and 3 m high, and from the road around it."""
    scene = Scene(simulate.wall((5, 0, 0), (0, 9, 0), 6, openings=[(4, 1, 2, 3)]))
    hits = scene.cast([[5.1, 5, 2.5]] * 4, [[0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]])
    assert hits.range_m == pytest.approx([1, 1, 1.5, 1.5])
    assert {scene.surfaces[k].label for k in hits.surface} == {"reveal"}
    aside = [(3.9, 2), (6.1, 2), (5, 0.9), (5, 4.1), (5, 2)]
    hits = scene.cast([[0, y, z] for y, z in aside], [[1, 0, 0]] * 5)
    assert hits.range_m == pytest.approx([5, 5, 5, 5, 5.2])


def extent_of(surface):
    return (surface.centre - surface.half).min(axis=0), (surface.centre + surface.half).max(axis=0)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("seed", range(6))
def test_what_stands_along_a_street_ends_where_its_truth_says(seed, side):
    at, plan = np.array([6.0, 20.0, 0.5]), streets.PLANS["quiet"]
    made = {}
    for kind in ("lamp", "sign", "tree", "other"):
        build = getattr(streets, f"_{kind}")
        parts, truth = build(np.random.default_rng(seed), at, side, plan)
        top = at + [truth["lean_x"], truth["lean_y"], 0] * np.array(truth["height_m"])
        made[kind] = truth, top, parts[-1]
        low, high = extent_of(parts[0])  # of the shaft; as it leans its end is a little higher
        assert low[2] == pytest.approx(0.5, abs=0.02)
        assert high[2] == pytest.approx(0.5 + truth["height_m"], abs=0.02)
        middle = (truth["x_m"], truth["y_m"])
        assert middle == pytest.approx((at[:2] + top[:2]) / 2)
    truth, top, head = made["lamp"]  # 10 to 25 cm above the end of an arm over the road
    low, high = extent_of(head)
    assert high[2] == pytest.approx(0.5 + truth["height_m"] + 0.25)
    assert 0.6 <= (top[0] - low[0] if side > 0 else high[0] - top[0]) <= 2.3
    truth, top, boards = made["sign"]  # up to the top, 2 cm before the post
    size = 2 * (0.5 + truth["height_m"] - boards.centre[0, 2])
    assert 0.45 <= size <= 0.8
    assert boards.half[0, 2] == pytest.approx(size / 2)
    off = np.hypot(*(boards.centre[0] - top)[:2])
    assert off == pytest.approx(truth["diameter_top_m"] / 2 + 0.02)
    if len(boards) > 1:
        assert boards.centre[0, 2] - boards.centre[1, 2] == pytest.approx(size / 2 + 0.15)
    truth, top, leaves = made["tree"]  # the shaft ends in the middle of the crown
    low, high = extent_of(leaves)
    assert low[2] == pytest.approx(0.5 + truth["clear_height_m"], abs=0.4)
    assert (low[2] + high[2]) / 2 == pytest.approx(0.5 + truth["height_m"], abs=0.3)


def test_rays_meet_cones_discs_and_rectangles_at_the_angle_of_their_normals(rng, uncompiled):
    uncompiled(scenes)
    place, axis = np.array([0.4, -0.2, 0.3]), unit(np.array([0.2, -0.3, 1.0]))
    base, top, radii = place - 1.5 * axis, place + 1.5 * axis, (0.5, 0.2)
    made = [
        simulate.cylinder(base, top, radii[0], top_radius=radii[1]),
        disc((0, 3, 0), (0.3, 1, 0.2), 0.8),
        simulate.rectangle((-3, -1, -1), (0.3, 2, 0), (0, 0, 2)),
    ]
    aims = [place, np.array([0, 3, 0]), np.array([-2.85, 0, 0])]
    for surface, aim in zip(made, aims, strict=True):
        origin = rng.uniform(-6, 6, (60, 3))
        hits = Scene([surface]).cast(origin, aim + 0.3 * rng.standard_normal((60, 3)) - origin)
        assert np.isfinite(hits.range_m).sum() > 15
    origin = rng.uniform(-6, 6, (200, 3))
    way = unit(place + 0.4 * rng.standard_normal((200, 3)) - origin)
    hits = Scene(made[:1]).cast(origin, way)
    met = np.isfinite(hits.range_m)
    points = (origin + hits.range_m[:, None] * way)[met]
    along = (points - place) @ axis
    off = points - place - along[:, None] * axis
    cap = np.abs(along) > 1.5 - 1e-9
    assert 2 < cap.sum() < 30
    radius = 0.35 - 0.1 * along  # from 0.5 to 0.2 over 3 m
    assert np.linalg.norm(off, axis=1)[~cap] == pytest.approx(radius[~cap])
    assert (np.linalg.norm(off, axis=1) <= radius + 1e-9).all()
    assert np.abs(along).max() <= 1.5 + 1e-9
    normal = np.where(cap[:, None], axis, unit(unit(off) + 0.1 * axis))
    assert hits.cosine[met] == pytest.approx(np.abs((normal * way[met]).sum(axis=1)))
    # the first of both crossings of |off|^2 = radius^2, where it lies on the shaft
    for k in np.flatnonzero(met)[~cap]:
        t = np.linspace(0, 14, 4001)
        at = origin[k] + t[:, None] * way[k] - place
        high = at @ axis
        inside = np.linalg.norm(at - high[:, None] * axis, axis=1) - (0.35 - 0.1 * high)
        through = np.flatnonzero((np.diff(np.sign(inside)) != 0) & (np.abs(high[1:]) < 1.49))
        if len(through):
            assert hits.range_m[k] == pytest.approx(t[through[0]], abs=0.01)
    flat = Scene(made[1:])
    normals = unit(np.array([[0.3, 1, 0.2], [2, -0.3, 0.0]]))
    for normal, aim in zip(normals, aims[1:], strict=True):
        way = unit(0.2 * rng.standard_normal((60, 3)) - 5 * normal)
        start = aim + 0.2 * rng.standard_normal((60, 3)) + 2 * normal
        hits = flat.cast(start, way)
        met = np.isfinite(hits.range_m)
        assert met.sum() > 10
        there = start + hits.range_m[:, None] * way - aim
        assert np.abs((there @ normal)[met]).max() < 1e-9
        assert hits.cosine[met] == pytest.approx(np.abs(way @ normal)[met])
