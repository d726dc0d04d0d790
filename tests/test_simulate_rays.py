"""One ray and one primitive, one box, one node: polynomials, gradients and loops written here."""

from types import SimpleNamespace

import numpy as np
import pytest

from mmqa_lab import simulate
from mmqa_lab.simulate import Scene, scenes
from mmqa_lab.simulate.primitives import DISC, RECTANGLE, SHAFT
from mmqa_lab.simulate.surfaces import disc


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


@pytest.fixture(autouse=True)
def _plain(uncompiled):
    uncompiled(scenes)


def frusta(rng, n):
    """Shape numbers of shafts about the origin: cylinders, cones and those through their tips."""
    growth = rng.choice([0.0, 0.15, -0.3, 0.6], n)
    capped = rng.integers(0, 2, n)
    sizes = [rng.uniform(0.5, 2, n), rng.uniform(0.1, 0.7, n), growth, capped]
    return np.column_stack([unit(rng.normal(size=(n, 3))), *sizes, np.zeros((n, 2))])


def on_mantle(shape, place):
    """|off the axis|^2 - radius^2, zero on the mantle, and the height along the axis."""
    high = place @ shape[:3]
    off = place - np.multiply.outer(high, shape[:3])
    return (off**2).sum(axis=-1) - (shape[4] + shape[5] * high) ** 2, high


def range_to(shape, origin, way):
    """The first of the polynomial's roots on the shaft, and of the places on its caps."""
    t = np.array([-1.0, 0.0, 1.0])
    roots = np.roots(np.polyfit(t, on_mantle(shape, origin + t[:, None] * way)[0], 2))
    found = [np.inf]
    for root in roots[np.isreal(roots)].real:
        high = (origin + root * way) @ shape[:3]
        if root > 0 and abs(high) <= shape[3] and shape[4] + shape[5] * high >= 0:
            found.append(root)
    for end in (-shape[3], shape[3]):
        t = (end - origin @ shape[:3]) / (way @ shape[:3])
        off = origin + t * way - end * shape[:3]
        if shape[6] and t > 0 and np.linalg.norm(off) <= abs(shape[4] + shape[5] * end):
            found.append(t)
    return min(found)


def test_shaft_is_met_at_the_first_root_on_it(rng):
    count = {True: 0, False: 0}
    for shape in frusta(rng, 300):
        start = rng.normal(0, 2, 3) if rng.random() < 0.7 else 0.1 * rng.normal(size=3)
        way = unit(0.4 * rng.normal(size=3) - rng.choice([1, 1, 1, -1]) * start)
        expected = range_to(shape, start, way)
        found = scenes._shaft(shape, *start, *way)
        assert found == pytest.approx(expected, rel=1e-7)
        count[np.isfinite(expected)] += 1
    assert min(count.values()) > 60
    post = np.array([0, 0, 1, 2, 0.5, 0, 1, 0, 0.0])
    assert scenes._shaft(post, 3, 0.3, 1.9, -1, 0, 0) == pytest.approx(3 - 0.4)  # level
    assert scenes._shaft(post, 0.3, 0, 5, 0, 0, -1) == pytest.approx(3)  # along the axis
    assert scenes._shaft(post, 3, 0.51, 1.9, -1, 0, 0) == np.inf
    assert scenes._shaft(post, 3, 0.3, 2.1, -1, 0, 0) == np.inf
    tip = np.array([0, 0, 1, 1, 0.0, 0.5, 0, 0, 0.0])  # below its tip there is nothing
    assert scenes._shaft(tip, 3, 0, 0.5, -1, 0, 0) == pytest.approx(2.75)
    assert scenes._shaft(tip, 3, 0, -0.5, -1, 0, 0) == np.inf


def test_cosine_is_that_of_the_gradient_where_a_ray_arrives(rng):
    for shape in frusta(rng, 150):
        centre, cap = rng.normal(size=3), shape[6] and rng.random() < 0.5
        high = rng.choice([-1, 1]) * shape[3] if cap else 0.95 * rng.uniform(-1, 1) * shape[3]
        radius = shape[4] + shape[5] * high
        if radius < 0.05:
            continue
        side = unit(np.cross(shape[:3], rng.normal(size=3)))
        place = high * shape[:3] + radius * (0.6 if cap else 1) * side
        step = 1e-6 * np.eye(3)
        normal = on_mantle(shape, place + step)[0] - on_mantle(shape, place - step)[0]
        normal = shape[:3] if cap else unit(normal)
        way, t = unit(rng.normal(size=3)), rng.uniform(1, 9)
        ray = np.concatenate([centre + place - t * way, way])
        tree = SimpleNamespace(shape=shape[None], centre=centre[None], kind=np.array([SHAFT]))
        assert scenes._cosine(tree, ray, t, 0) == pytest.approx(abs(normal @ way), abs=1e-6)
        flat = SimpleNamespace(**vars(tree) | {"kind": np.array([DISC])})
        flat.shape = np.concatenate([rng.normal(size=6), 2 * side])[None]
        assert scenes._cosine(flat, ray, t, 0) == pytest.approx(abs(side @ way))


def test_range_to_a_rectangle_or_a_disc_is_that_to_its_plane_within_it(rng):
    met = 0
    for _ in range(200):
        centre, u, v = rng.normal(size=(3, 3))
        surface = simulate.rectangle(centre - u - v, 2 * u, 2 * v)
        round_ = disc(centre, np.cross(u, v), 0.8)
        start = 3 * rng.normal(size=3)
        way = unit(centre + 1.2 * rng.normal(size=3) - start)
        t, s, r = np.linalg.solve(np.column_stack([way, -u, -v]), centre - start)
        off = np.linalg.norm(start + t * way - centre)
        inside = {RECTANGLE: max(abs(s), abs(r)) <= 1, DISC: off <= 0.8}
        rays = np.concatenate([start, way, [0, 0, 0]])[None]
        for one, kind in ((surface, RECTANGLE), (round_, DISC)):
            tree = SimpleNamespace(centre=one.centre, shape=one.shape, kind=one.kind)
            expected = t if t > 0 and inside[kind] else np.inf
            assert scenes._range_to(tree, 0, rays, 0, np.inf) == pytest.approx(expected)
            assert scenes._range_to(tree, 0, rays, 0, 0.99 * abs(t)) == np.inf
            met += np.isfinite(expected)
    assert 40 < met < 300
    post = simulate.cylinder((0, 0, -1), (0, 0, 1), 0.5)
    tree = SimpleNamespace(centre=post.centre + 1, shape=post.shape, kind=post.kind)
    rays = np.array([[5.0, 1, 1, -1, 0, 0, 0, 0, 0]])
    assert scenes._range_to(tree, 0, rays, 0, np.inf) == pytest.approx(3.5)


@pytest.mark.parametrize("n", [1, 4, 5, 37])
def test_hierarchy_has_every_primitive_once_in_the_boxes_above_it(n, rng):
    centre, half = rng.normal(0, [4, 2, 1], (n, 3)), rng.uniform(0, 0.5, (n, 3))
    order, low, high, link, count, axis = scenes._hierarchy(centre - half, centre + half, centre)
    assert sorted(order) == [*range(n)]
    seen = []

    def descend(node):
        """The primitives below a node."""
        if count[node]:
            assert count[node] <= 4
            members = [*range(link[node], link[node] + count[node])]
        else:
            left, right = descend(node + 1), descend(link[node])
            members = left + right
            assert len(members) > 4
            middles = centre[order[members]]
            wide = np.ptp(middles, axis=0)
            assert axis[node] == wide.argmax()
            cut = middles.min(axis=0)[axis[node]] + wide.max() / 2
            assert (middles[: len(left), axis[node]] < cut).all()
            assert (middles[len(left) :, axis[node]] >= cut).all()
        own = order[members]
        assert low[node] == pytest.approx((centre - half)[own].min(axis=0) - 1e-9, abs=1e-12)
        assert high[node] == pytest.approx((centre + half)[own].max(axis=0) + 1e-9, abs=1e-12)
        seen.append(node)
        return members

    assert descend(0) == [*range(n)]
    assert sorted(seen) == [*range(len(link))]


def test_cut_halves_by_number_where_places_do_not_divide():
    centre = np.array([[0.0, 0, 0], [0, 9, 0], [0, 1, 0], [0, 2, 0], [0, 3, 0], [0, 4.6, 0]])
    members = np.arange(6)
    assert scenes._cut(members, centre, 59) == (1, 4)
    assert sorted(members[:4]) == [0, 2, 3, 4]
    assert scenes._cut(np.arange(6), centre, 60) == (1, 3)
    assert scenes._cut(np.arange(5), np.ones((5, 3)), 0) == (0, 2)


def test_may_hit_a_box_is_a_ray_that_has_a_place_in_it_before_the_best(rng):
    hits = 0
    for _ in range(200):
        low = rng.normal(size=3)
        high = low + rng.uniform(0.2, 2, 3)
        start = 2 * rng.normal(size=3)
        way = (low + high) / 2 + rng.normal(size=3) - start
        way = unit(np.where(rng.random(3) < [0.2, 0.2, 0], 0.0, way))
        rays = np.concatenate([start, way, [scenes._reciprocal(x) for x in way]])[None]
        t = np.linspace(0, 9, 4001)[:, None]
        inside = ((start + t * way >= low) & (start + t * way <= high)).all(axis=1)
        first = t[inside.argmax(), 0]
        if 0 < inside.sum() < 30:
            continue  # a corner that is hardly met
        box = low[None], high[None], 0, rays, 0
        assert scenes._may_hit(*box, np.inf) == inside.any()
        if first > 0.1:
            assert not scenes._may_hit(*box, first - 0.05)
            assert scenes._may_hit(*box, first + 0.05)
        hits += inside.any()
    assert 20 < hits < 150


def test_reciprocal_of_next_to_nothing_is_huge_and_finite():
    assert scenes._reciprocal(-4.0) == -0.25
    assert scenes._reciprocal(0.0) == scenes._reciprocal(0.9e-290) == 1e290
    assert scenes._reciprocal(1.1e-290) == 1 / 1.1e-290


def test_boxes_of_a_scene_hold_their_primitives_and_no_more(rng):
    place = np.array([100.0, -50, 7])
    u, v = np.array([1.0, 0.5, 0.2]), np.cross([1.0, 0.5, 0.2], [0.3, 0, 1.0])
    made = [simulate.rectangle(place, 2 * u, 2 * v), disc(place + 3, (1, 2, 3), 0.7)]
    made += [simulate.cylinder(place, place + [1, 2, 4], 0.4, top_radius=0.1)]
    scene = Scene(made)
    assert scene.origin == pytest.approx(np.round([x.centre[0] for x in made]).mean(axis=0), abs=1)
    assert scene.balls[:, :3] + scene.origin == pytest.approx(np.array([x.centre[0] for x in made]))
    radii = [np.linalg.norm(one.half) for one in made]
    assert scene.balls[:, 3] == pytest.approx(radii)
    axes, half = scene.boxes
    assert axes @ axes.swapaxes(1, 2) == pytest.approx(np.tile(np.eye(3), (3, 1, 1)), abs=1e-12)
    assert half[0] == pytest.approx([np.linalg.norm(u), np.linalg.norm(v), 0])
    assert np.abs(axes[0] @ np.array([u, v]).T)[:2] == pytest.approx(
        np.diag(np.linalg.norm([u, v], axis=1))
    )
    assert half[1] == pytest.approx([0.7, 0.7, 0])
    assert np.abs(axes[1, 2] @ unit(np.array([1, 2, 3]))) == pytest.approx(1)
    assert half[2] == pytest.approx([np.sqrt(21) / 2, 0.4, 0.4])  # its widest end
    assert np.abs(axes[2, 0] @ unit(np.array([1, 2, 4]))) == pytest.approx(1)


def test_cast_beams_tells_rays_that_meet_nothing_apart(rng):
    walls = [simulate.rectangle((x, -9, -9), (0, 18, 0), (0, 0, 18), reflectance=x / 10)
             for x in (3, 5)]  # fmt: skip
    scene = Scene([walls[1], walls[0]])
    way = unit(np.array([[[1.0, 0.5, 0], [-1, 0.2, 0]], [[0, 0, 1], [2, 0, 1]]]))
    found = scene.cast_beams(np.zeros((2, 2, 3)) - scene.origin, way)
    ranges = [[3 / way[0, 0, 0], np.nan], [np.nan, 3 / way[1, 1, 0]]]
    assert found.range_m == pytest.approx(np.array(ranges), nan_ok=True)
    assert found.surface.tolist() == [[1, -1], [-1, 1]]
    assert found.cosine == pytest.approx(way[..., 0] * [[1, np.nan], [np.nan, 1]], nan_ok=True)
    assert found.reflectance == pytest.approx(np.array([[0.3, np.nan], [np.nan, 0.3]]), nan_ok=True)
