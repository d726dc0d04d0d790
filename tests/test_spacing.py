"""Quadrant distances against brute force, spacing against the closed form of a Poisson pattern."""

import json
import subprocess
import sys
import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmqa_lab import io, samples, spacing
from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.planes import fit_plane
from mmqa_lab.spacing import (
    Spacing,
    _search,
    exempt,
    poisson_spacing,
    quadrant_distances,
    quadrants,
)
from mmqa_lab.spacing.quadrants import nearest_by_scipy

NAN = np.nan


def brute_force(xy, radius, rows=None):
    """Sorted quadrant distances of the points in ``rows``, each compared with every point."""
    rows = np.arange(len(xy)) if rows is None else rows
    found = np.full((len(rows), 4), np.inf)
    for place, row in enumerate(rows):
        dx, dy = (xy - xy[row]).T
        d = np.sqrt(dx * dx + dy * dy)
        d[d > radius] = np.inf
        for q, inside in enumerate(
            [
                (dx > 0) & (dy >= 0),
                (dx <= 0) & (dy > 0),
                (dx < 0) & (dy <= 0),
                (dx >= 0) & (dy < 0),
            ]
        ):
            found[place, q] = d[inside].min(initial=np.inf)
    found.sort(axis=1)
    return np.where(np.isinf(found), NAN, found)


def turned(xy, degrees):
    """Points turned about the origin, counter-clockwise."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return xy @ np.array([[c, s], [-s, c]])


def scan_lines(n, rng):
    """Lines 47 mm apart with a point every 4.6 mm, turned by 34 degrees."""
    count = max(2, int(np.sqrt(n * 0.0046 / 0.047)))
    along = np.tile(np.arange(1 + n // count), count) * 0.0046
    line = np.repeat(np.arange(count), 1 + n // count) * 0.047
    start = np.repeat(rng.random(count) * 0.0046, 1 + n // count)
    return turned(
        np.stack([along + start, line], axis=1) + rng.normal(0, 0.0003, (len(line), 2)), 34
    )


def on_circle(turn):
    """Points of the unit circle."""
    return np.stack([np.cos(turn), np.sin(turn)], axis=1)


def rings(n, rng):
    """Points about thin rings: clusters with holes."""
    centres = 2 * rng.random((1 + n // 200, 2))
    reach = 0.05 + 0.01 * rng.random((n, 1))
    return centres[rng.integers(0, len(centres), n)] + reach * on_circle(7 * rng.random(n))


PATTERNS = {
    "uniform": lambda n, rng: rng.random((n, 2)),
    "scan lines": scan_lines,
    "rings": rings,
    "clusters": lambda n, rng: rng.integers(0, 5, (n, 2)) + rng.normal(0, 0.01, (n, 2)),
    "two densities": lambda n, rng: rng.random((n, 2)) * np.where(rng.random((n, 1)) < 0.5, 1, 1e3),
    "along x": lambda n, rng: np.stack([rng.random(n), np.full(n, 3.0)], axis=1),
    "along y": lambda n, rng: np.stack([np.full(n, -3.0), rng.random(n)], axis=1),
    "diagonal": lambda n, rng: np.repeat(rng.random((n, 1)), 2, axis=1),
    "other diagonal": lambda n, rng: rng.random((n, 1)) * [1, -1],
    "noisy line": lambda n, rng: rng.normal(0, [1, 0.001], (n, 2)),
    "circle": lambda n, rng: 0.4 * on_circle(2 * np.pi * rng.random(n)),
    "duplicates": lambda n, rng: rng.random((1 + n // 50, 2))[rng.integers(0, 1 + n // 50, n)],
    "one place": lambda n, rng: np.ones((n, 2)),
    "one cell": lambda n, rng: np.vstack([rng.random((n - 1, 2)) * 1e-6, [[1000, 1000]]]),
    "lattice": lambda n, rng: np.stack(np.divmod(np.arange(n), 1 + int(np.sqrt(n))), axis=1) * 0.02,
    "rounded": lambda n, rng: rng.random((n, 2)).round(2),
    "corridor": lambda n, rng: rng.random((n, 2)) * [1000, 1],
}


def pattern(name, n, seed=0):
    """Points of a pattern."""
    return PATTERNS[name](n, np.random.default_rng(seed))


# Known answers


def test_each_quadrant_by_hand():
    xy = [[0, 0], [3, 4], [-1, 1], [-2, 0], [1, -1]]
    np.testing.assert_array_equal(
        quadrant_distances(xy, radius=6)[0], [np.sqrt(2), np.sqrt(2), 2, 5]
    )


@pytest.mark.parametrize("radius", [0.5, 0.3, 0.1, 1e-3, 1e4])
def test_the_radius_belongs_to_the_search(radius):
    xy = [[0, 0], [radius, 0], [0, np.nextafter(radius, np.inf)]]
    np.testing.assert_array_equal(quadrant_distances(xy, radius=radius)[0], [radius, NAN, NAN, NAN])


def test_spacing_of_a_lattice():
    x, y = np.meshgrid(np.arange(50) * 0.02, np.arange(40) * 0.05)
    found = quadrants(np.stack([x.ravel(), y.ravel()], axis=1))
    # Lattice coordinates are rounded to 1e-16 of a metre and differences of them a little more.
    np.testing.assert_allclose(found.d, [0.02, 0.02, 0.05, 0.05], rtol=1e-12)
    assert found.f == pytest.approx(2.5)
    edge = 2 * 50 + 2 * 40 - 4
    assert found.incomplete_share == pytest.approx(edge / 2000)
    np.testing.assert_array_equal(found.counts, [2000, 2000, 1996, 2000 - edge])
    assert (found.n, found.coincident) == (2000, 0)


def test_nothing_measurable_is_nan_with_a_count_of_none():
    found = quadrants([[0, 0], [10, 10]])
    assert np.isnan(found.d).all()
    assert np.isnan(found.f)
    np.testing.assert_array_equal(found.counts, 0)
    assert found.incomplete_share == 1


def test_coincident_points_are_counted_once_each():
    assert quadrants([[0, 0], [1, 1], [-0.0, 0], [1, 2], [1, 1], [1, 1]]).coincident == 5


# Independent references


@settings(deadline=None, max_examples=120)
@given(
    st.sampled_from(sorted(PATTERNS)),
    st.integers(1, 400),
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.003, 0.02, 0.5, 1e4]),
    st.sampled_from([(0.0, 0.0), (0.3, -0.7), (652_000.1, 6_861_000.3)]),
)
def test_every_pattern_equals_brute_force_bit_for_bit(name, n, seed, radius, corner):
    xy = pattern(name, n, seed) + corner
    expected = brute_force(xy, radius)
    np.testing.assert_array_equal(quadrant_distances(xy, radius=radius), expected)
    few = nearest_by_scipy(xy, radius)  # by scipy
    np.testing.assert_array_equal(few, expected)
    compiled = _search.nearest_per_quadrant(xy, radius, np.ones(len(xy), dtype=bool))
    np.testing.assert_array_equal(compiled, expected)


def test_figures_of_a_small_cloud_need_no_compiler():
    code = "import sys; from mmqa_lab.__main__ import main; main(sys.argv[1:])"
    code += "; sys.exit('numba' in sys.modules)"
    words = ["evaluate", str(samples.path("chart_a_5m")), "--json"]
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    cloud = io.read_cloud(samples.path("chart_a_5m"))
    assert json.loads(done.stdout)[0]["f"] == evaluate_cloud(cloud).f


def test_the_compiled_search_is_loaded_when_enough_points_have_been_searched():
    code = "import sys, numpy as np; from mmqa_lab.spacing import quadrants\n"
    code += "xy = np.random.default_rng(1).random((12_000, 2))\n"
    code += "print(*[[quadrants(xy).f, 'numba' in sys.modules] for _ in range(3)], sep=';')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    (f, *_), *_ = found = [json.loads(one.lower()) for one in done.stdout.split(";")]
    assert found == [[f, False], [f, False], [f, True]]


@pytest.mark.parametrize("name", sorted(PATTERNS))
@pytest.mark.parametrize("radius", [0.01, 0.5])
def test_larger_clouds_equal_brute_force_at_sampled_points(name, radius):
    xy = pattern(name, 30_000)
    rows = np.random.default_rng(1).integers(0, len(xy), 40)
    np.testing.assert_array_equal(
        quadrant_distances(xy, radius=radius)[rows], brute_force(xy, radius, rows)
    )


@pytest.mark.parametrize("name", sorted(PATTERNS))
@pytest.mark.parametrize("share", [0.0, 0.02, 0.9])
def test_distances_of_some_points_are_those_of_all(name, share):
    xy = pattern(name, 3000)
    of = np.random.default_rng(5).random(len(xy)) < share
    expected = np.where(of[:, None], quadrant_distances(xy), NAN)
    np.testing.assert_array_equal(quadrant_distances(xy, of=of), expected)


@pytest.mark.parametrize("density", [100, 2000, 30_000])
def test_random_points_have_the_closed_form(density):
    side = np.sqrt(100_000 / density)
    xy = side * np.random.default_rng(density).random((100_000, 2))
    found = quadrants(xy, radius=side / 20)
    # Medians of 100 000 dependent values scatter by about 0.5 %; the edge adds less than that.
    np.testing.assert_allclose(found.d, poisson_spacing(density), rtol=0.015)
    assert found.f == pytest.approx(3.257, rel=0.02)


def test_closed_form_from_its_own_order_statistics():
    # The k-th largest of four uniforms; 400 000 draws give medians to 0.5 %.
    empty = np.sort(np.random.default_rng(5).random((400_000, 4)), axis=1)
    simulated = np.median(np.sqrt(-4 * np.log(1 - empty) / (np.pi * 7.0)), axis=0)
    np.testing.assert_allclose(poisson_spacing(7.0), simulated, rtol=0.005)
    d = poisson_spacing(7.0)
    assert d[3] / d[0] == pytest.approx(3.257, abs=5e-4)


@pytest.mark.parametrize(
    ("system", "distance", "expected"),
    [("A", 5, False), ("A", 10, False), ("B", 5, False), ("C", 5, True), ("C", 10, True)],
)
def test_exemption_of_the_published_systems(system, distance, expected):
    """Section 3.3 with rho0 = 3000, so d0 = 18.3 mm, and Table 2 of Pfeifer et al. 2021."""
    d1, d4 = {"A5": (4, 47), "A10": (9, 46), "B5": (10, 25), "C5": (3, 8), "C10": (3, 8)}[
        f"{system}{distance}"
    ]
    assert exempt(d1 / 1000, d4 / 1000, 3000) == expected


def test_a_random_pattern_is_exempt_from_2_34_times_the_threshold():
    for share, expected in ((2.33, False), (2.35, True)):
        d1, _, _, d4 = poisson_spacing(share * 3000)
        assert exempt(d1, d4, 3000) == expected


def test_not_measurable_is_not_exempt():
    assert exempt([NAN, 0.001, NAN], [0.001, NAN, NAN], 100).tolist() == [False] * 3


def test_intervals_of_a_random_pattern_cover_the_closed_form():
    """95 % of 100 windows, or 88 % with three standard errors; only points away from the edge."""
    truth = [*poisson_spacing(4000), 3.257]
    inside = np.zeros(5)
    for seed in range(100):
        xy = 1.2 * np.random.default_rng(seed).random((5760, 2))
        middle = (np.abs(xy - 0.6) < 0.5).all(axis=1)
        distances = quadrant_distances(xy)[middle]
        found = Spacing(xy[middle], distances)
        low, high = found.intervals()[["low", "high"]].to_numpy().T * [1e-3, 1e-3, 1e-3, 1e-3, 1]
        inside += (low <= truth) & (truth <= high)
    assert (inside >= 88).all()
    assert (inside < 100).any()


# Invariances


@pytest.mark.parametrize("name", ["uniform", "scan lines", "rings", "two densities"])
def test_order_of_the_points_does_not_matter(name):
    xy = pattern(name, 5000)
    order = np.random.default_rng(2).permutation(len(xy))
    np.testing.assert_array_equal(quadrant_distances(xy[order]), quadrant_distances(xy)[order])


@pytest.mark.parametrize("name", sorted(PATTERNS))
def test_a_quarter_turn_changes_nothing(name):
    xy = pattern(name, 2000)
    quarter = np.stack([-xy[:, 1], xy[:, 0]], axis=1)
    np.testing.assert_array_equal(quadrant_distances(quarter), quadrant_distances(xy))
    np.testing.assert_array_equal(quadrant_distances(xy, angle=-270), quadrant_distances(xy))


def test_ten_thousand_kilometres_away():
    xy = pattern("scan lines", 20_000).round(4)
    near, far = quadrants(xy), quadrants(xy + 1e7)
    # A coordinate of 1e7 m is rounded to 1.9e-9 m, a difference of two to twice that.
    np.testing.assert_allclose(far.d, near.d, rtol=0, atol=4e-9)
    np.testing.assert_allclose(
        quadrants(xy + 1e7, angle=20).d, quadrants(xy, angle=20).d, atol=8e-9
    )


@pytest.mark.parametrize("angle", [12.5, -40, 100])
def test_turned_axes_equal_turned_points(angle):
    xy = pattern("scan lines", 4000)
    # Turning rounds coordinates below 10 m to 2e-15 m.
    np.testing.assert_allclose(
        quadrant_distances(xy, angle=angle), quadrant_distances(turned(xy, -angle)), atol=1e-14
    )


def test_axes_along_noisy_scan_lines_hide_the_gap_between_them():
    xy = pattern("scan lines", 20_000)
    across, along = quadrants(xy, angle=34 + 45), quadrants(xy, angle=34)
    # Half way between the axes, two quadrants face the next lines: 47 mm, give or take the noise.
    np.testing.assert_allclose(across.d[2:], 0.047, rtol=0.01)
    np.testing.assert_array_equal(across.d, quadrants(xy, angle=34 - 45).d)
    # Along the axes, noise of 0.3 mm puts points of the own line into all four.
    assert along.d[3] < 0.6 * 0.047
    # Turning rounds coordinates below 10 m to 2e-15 m.
    np.testing.assert_allclose(along.d[:2], across.d[:2], rtol=0, atol=1e-14)


def test_one_thread_equals_many_and_threads_may_call_at_once():
    import numba

    xy = pattern("rings", 50_000)
    expected = quadrant_distances(xy)
    found = [None] * 4

    def search(place):
        numba.set_num_threads(1 + place % numba.config.NUMBA_NUM_THREADS)
        found[place] = quadrant_distances(xy)

    callers = [threading.Thread(target=search, args=(place,)) for place in range(4)]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join()
    for distances in found:
        np.testing.assert_array_equal(distances, expected)


def test_extents_that_differ_beyond_measure():
    xy = np.vstack([pattern("uniform", 300), [[1e12, -1e12], [1e-300, 1e-310]]])
    np.testing.assert_array_equal(quadrant_distances(xy), brute_force(xy, 0.5))


def test_one_angle_is_a_number_or_a_list():
    xy = pattern("scan lines", 2000)
    one = spacing.turned_f(xy, angles=20)
    np.testing.assert_array_equal(one, spacing.turned_f(xy, angles=[20.0]))
    with pytest.raises(ValueError, match=r"Invalid angles nan\. Must be finite"):
        spacing.turned_f(xy, angles=[20, NAN])


def test_large_coordinates_are_shown_to_the_millimetre():
    html = fit_plane(np.eye(3) + [452_123.4567, 5_411_000.25, 300])._repr_html_()
    assert "452123.790" in html
    assert "5411000.583" in html
