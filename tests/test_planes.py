"""Regression planes and the dispersion about them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize, stats

from mmqa_lab.planes import (
    CONSISTENT_SCALE,
    PAPER_SCALE,
    fit_circle,
    fit_line,
    fit_plane,
    flat_points,
    sigma_mad,
)


def dyadic(rng, n, sigma=0.005):
    """A noisy plane whose coordinates are multiples of 2^-20 m: exact when moved by 10,000 km."""
    x, y = rng.uniform(-0.5, 0.5, (2, n))
    z = 0.3 * x - 0.2 * y + rng.normal(0, sigma, n)
    return np.round(np.stack([x, y, z], axis=1) * 2**20) / 2**20


def test_known_plane_is_found(rng):
    normal = np.array([2.0, -1.0, 2.0]) / 3
    axes = np.linalg.svd(normal[None])[2][1:]
    points = rng.uniform(-1, 1, (50, 2)) @ axes + [5.0, 6.0, 7.0]
    plane = fit_plane(points)
    assert np.abs(plane.normal) @ np.abs(normal) == pytest.approx(1, abs=1e-14)
    assert np.abs(plane.residuals).max() < 1e-13  # rounding of coordinates below 10 m
    assert plane.n == 50


def test_agrees_with_a_search_over_directions(rng):
    points = dyadic(rng, 300)
    local = points - points.mean(axis=0)

    def squares(angles):
        """Sum of squared distances from the plane with this normal."""
        a, b = angles
        normal = [np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)]
        return ((local @ normal) ** 2).sum()

    found = optimize.minimize(squares, [0.4, 2.5], method="Nelder-Mead", options={"xatol": 1e-10})
    squares_found = (fit_plane(points).residuals ** 2).sum()
    assert squares_found == pytest.approx(found.fun, rel=1e-9)


def test_axes_are_orthonormal_and_right_handed(rng):
    plane = fit_plane(dyadic(rng, 100))
    frame = np.vstack([plane.axes, plane.normal])
    assert np.allclose(frame @ frame.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(frame) == pytest.approx(1)
    xy = plane.project(dyadic(rng, 100))
    assert np.ptp(xy[:, 0]) > 0


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_nothing_changes_when_the_cloud_is_moved(seed):
    points = dyadic(np.random.default_rng(seed), 200)
    here = fit_plane(points)
    there = fit_plane(points + [1e7, -6.5e6, 2048.0])
    assert there.std == pytest.approx(here.std, rel=1e-9)
    assert sigma_mad(there.residuals) == pytest.approx(sigma_mad(here.residuals), rel=1e-9)
    assert np.abs(there.normal - here.normal).max() < 1e-12


def test_robust_fit_withstands_points_behind_the_chart(rng):
    points = dyadic(rng, 1000, sigma=0.002)
    clean = fit_plane(points).normal
    dirty = points.copy()
    dirty[:50, 2] -= rng.uniform(0.2, 0.5, 50)  # 5 % behind, all of them one-sided
    tilt = {
        robust: np.degrees(np.arccos(fit_plane(dirty, robust=robust).normal @ clean))
        for robust in (False, True)
    }
    assert tilt[True] < 0.05
    assert tilt[True] < tilt[False] / 3


def test_line_has_the_closed_form_of_orthogonal_regression(rng):
    points = rng.normal(0, 1, (200, 2)) @ [[2.0, 0.7], [0.0, 0.3]] + [1e7, -1e7]
    line = fit_line(points)
    (xx, xy), (_, yy) = np.cov((points - points.mean(axis=0)).T)
    angle = 0.5 * np.arctan2(2 * xy, xx - yy)
    across = abs(line.direction @ [-np.sin(angle), np.cos(angle)])
    assert across < 1e-8  # float64 at 1e7 m carries 2e-9 m
    assert line.distances(points).std() == pytest.approx(
        np.sqrt((xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)) * np.sqrt(199 / 200), rel=1e-6
    )


def test_robust_line_withstands_points_beside_the_wall(rng):
    x = rng.uniform(0, 5, 300)
    y = 0.5 * x + rng.normal(0, 0.005, 300)
    y[:60] += 0.3
    line = fit_line(np.stack([x, y], axis=1), robust=True)
    assert line.direction[1] / line.direction[0] == pytest.approx(0.5, abs=0.002)


def test_sigma_mad_is_consistent_for_normal_residuals():
    quantiles = stats.norm.ppf((np.arange(100_000) + 0.5) / 100_000, scale=3.0)
    assert sigma_mad(quantiles) == pytest.approx(3.0, rel=1e-4)
    assert pytest.approx(1 / stats.norm.ppf(0.75), rel=1e-15) == CONSISTENT_SCALE


def test_paper_factor_is_offered_by_name():
    assert sigma_mad([-1, 0, 1], PAPER_SCALE) == pytest.approx(1.4862)  # Appendix A


def test_sigma_mad_counts_from_the_median_and_not_from_zero(rng):
    residuals = 5 + rng.exponential(2.0, 101)  # skew, so that median and mean differ too
    expected = stats.median_abs_deviation(residuals, scale="normal")
    assert sigma_mad(residuals) == pytest.approx(expected, rel=1e-4)


def test_dispersion_of_a_saddle_of_four_points():
    plane = fit_plane([[0, 0, 0.1], [1, 0, -0.1], [1, 1, 0.1], [0, 1, -0.1]])
    assert plane.std == pytest.approx(0.1 * np.sqrt(4 / 3))  # n - 1 = 3


def test_horizontal_axes(rng):
    plane = fit_plane(dyadic(rng, 100))
    level, slope = plane.horizontal_axes()
    assert level[2] == 0
    assert level @ slope == pytest.approx(0, abs=1e-15)
    assert np.cross(level, slope) @ plane.normal == pytest.approx(1)


def test_a_circle_is_as_sure_as_the_larger_of_two_spreads():
    """Errors of (-1)^k a cos^2 of 40 points on a ring: 5/4 a^2 / (38 - 2) is the variance of x.

    From their mean square alone it would be 3/4 a^2 / (38 - 2).
    """
    turn, a = np.linspace(0, 2 * np.pi, 40, endpoint=False), 1e-4
    radius = 0.1 + a * np.cos(turn) ** 2 * (-1.0) ** np.arange(40)
    ring = np.column_stack([radius * np.cos(turn), radius * np.sin(turn)])
    found = fit_circle(ring, diameter=0.2)
    np.testing.assert_allclose(found.centre, 0, atol=1e-6)
    assert found.covariance[0, 0] == pytest.approx(1.25 * a**2 / 36, rel=2e-3)


def test_a_circle_of_rows_that_are_there_twice_is_no_surer(rng):
    turn = rng.uniform(0, 3, 12)
    arc = 0.1 * np.stack([np.cos(turn), np.sin(turn)], axis=1) + rng.normal(0, 0.002, (12, 2))
    once, often = (fit_circle(points) for points in (arc, np.tile(arc, (10, 1))))
    assert often.std == pytest.approx(once.std, rel=1e-3)


def test_the_normal_of_a_wall_at_45_degrees_does_not_depend_on_the_order(rng):
    along, up = np.meshgrid(np.arange(20.0), np.arange(10.0))
    wall = np.stack([along, -along, up], axis=-1).reshape(-1, 3)
    normals = [fit_plane(rng.permutation(wall)).normal.round(6) for _ in range(12)]
    assert {tuple(np.sign(normal)[:2]) for normal in normals} == {(1.0, 1.0)}


def test_a_robust_plane_lies_where_the_biweights_balance(rng):
    """The weights of its residuals by their definition: those of another function would not."""
    points = rng.random((300, 3)) * [2, 1, 0] + [0, 0, 0.01] * rng.exponential(size=(300, 1))
    found = fit_plane(points, robust=True)
    off = found.distances(points)
    u = (off - np.median(off)) / (4.685 * sigma_mad(off))
    weights = np.where(np.abs(u) < 1, (1 - u**2) ** 2, 0)
    assert abs(np.average(off, weights=weights)) < 1e-5 * off.std()


@pytest.mark.parametrize("diameter", [None, 0.4])
def test_a_circle_has_a_deviation_from_five_points_more_than_parameters(diameter):
    parameters = 2 + (diameter is None)
    for more in range(2, 8):
        turn = np.linspace(0, 5, parameters + more)
        off = 1e-3 * np.cos(7 * turn)
        circle = fit_circle(
            (0.2 + off)[:, None] * np.column_stack([np.cos(turn), np.sin(turn)]), diameter=diameter
        )
        assert np.isfinite(circle.std) == (more > 4), more


def test_a_circle_with_a_free_radius_is_not_certain_where_points_scatter_by_a_seventh():
    turn = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    ways = np.column_stack([np.cos(turn), np.sin(turn)])
    for share in (0.05, 0.1, 0.13, 0.17, 0.25):
        off = share * np.where(np.arange(40) % 2, 1, -1)  # both sides alike
        points = 0.02 * (1 + off)[:, None] * ways
        found = fit_circle(points)
        assert np.isfinite(found.std) == (share < 0.15), share
        assert np.isfinite(fit_circle(points, diameter=0.04).std)


def test_the_deviation_of_a_circle_is_that_of_its_residuals_with_two_degrees_less(rng):
    turn = np.linspace(0, 4, 11)
    for off in (2e-4 * rng.standard_normal(11), 2e-4 * np.r_[3, np.zeros(10)]):
        ways = np.column_stack([np.cos(turn), np.sin(turn)])
        circle = fit_circle((0.15 + off)[:, None] * ways, diameter=0.3)
        points = (0.15 + off)[:, None] * ways
        left = np.linalg.norm(points - circle.centre, axis=1) - 0.15
        ways = (points - circle.centre) / np.linalg.norm(points - circle.centre, axis=1)[:, None]
        inverse = np.linalg.inv(ways.T @ ways)
        freedom = 11 - 2 - 2  # parameters, and two since the spread is uncertain itself
        alike = left @ left / freedom * np.trace(inverse)
        moved = ways * left[:, None] @ inverse
        each = 11 / freedom * (moved**2).sum()
        assert circle.std == pytest.approx(np.sqrt(max(alike, each) / 2), rel=1e-3)


def test_a_rough_ring_has_its_centre_only_where_its_diameter_is_known(rng):
    """With a free radius its points scatter by more than 15 % of it, however many there are."""
    turn = rng.uniform(0, 2 * np.pi, 4000)
    radius = 0.04 + rng.normal(0, 0.012, 4000)
    ring = np.column_stack([radius * np.cos(turn), radius * np.sin(turn)])
    assert np.isnan(fit_circle(ring).std)
    assert 0 < fit_circle(ring, diameter=0.08).std < 0.005


def test_two_shells_have_a_centre_where_they_lie_closer_than_a_radius(rng):
    turn, aside = rng.uniform(0, 2 * np.pi, 600), np.repeat([-1, 1], 300)
    for share, known in ((0.35, True), (1.2, False)):
        ring = 0.3 * np.column_stack([np.cos(turn), np.sin(turn)])
        ring[:, 0] += aside * share * 0.3 / 2
        assert np.isfinite(fit_circle(ring, diameter=0.6).std) == known


def rival_fit(points, diameter, start):
    """A circle by scipy with slopes by differences, from the true circle, in other coordinates."""
    middle = points.mean(axis=0)

    def misfits(circle):
        radius = diameter / 2 if diameter else circle[2]
        return np.hypot(*(points - middle - circle[:2]).T) - radius

    first = [*(np.array(start[:2]) - middle), start[2]][: 2 if diameter else 3]
    close = {"xtol": 1e-14, "ftol": 1e-14, "gtol": 1e-14}
    found = optimize.least_squares(misfits, first, loss="cauchy", f_scale=0.01, **close)
    return found.x[:2] + middle, found.x[2] if not diameter else diameter / 2


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("covered", [1.2, 2.0, 3.5, 6.28])
@pytest.mark.parametrize("far", [0.0, 5_411_000.0])
def test_circles_are_those_of_a_search_from_the_truth(covered, known, far, rng):
    """Arcs of 70 to 360 degrees, 2 mm of noise, and one point in ten 3 cm off to either side."""
    stray = 0.03 * np.where(np.arange(80) % 20, 1, -1)
    for radius in (0.05, 0.15, 0.4):
        turn = rng.uniform(0, 6) + rng.uniform(0, covered, 80)
        away = radius + 0.002 * rng.normal(size=80) + stray * (np.arange(80) % 10 == 0)
        points = [far + 3, 2 * far - 7] + away[:, None] * np.column_stack(
            [np.cos(turn), np.sin(turn)]
        )
        diameter = 2 * radius if known else None
        found = fit_circle(points, diameter=diameter)
        centre, size = rival_fit(points, diameter, (far + 3, 2 * far - 7, radius))
        cost = [np.log1p(((np.hypot(*(points - at).T) - r) / 0.01) ** 2).sum()
                for at, r in ((found.centre, found.radius), (centre, size))]  # fmt: skip
        assert cost[0] <= cost[1] * (1 + 1e-6)  # the best of several starts
        if np.isfinite(found.std):
            assert found.centre == pytest.approx(centre, abs=1e-4, rel=1e-12)
            assert found.radius == pytest.approx(size, abs=1e-4)
            assert np.hypot(*(found.centre - [far + 3, 2 * far - 7])) < 5 * found.std + 0.001


@pytest.mark.parametrize("diameter", [None, 0.2])
def test_a_circle_on_the_other_side_of_a_short_arc_leaves_it_unknown(diameter, rng):
    """The log likelihood ratio of both sides must be above 5, by the residuals of either."""
    known = []
    for covered in (0.2, 0.5, 0.8, 1.0, 1.2, 1.8, 2.4):
        turn = np.linspace(-covered / 2, covered / 2, 40)
        off = 0.001 * np.where(np.arange(40) % 2, 1, -1)
        points = (0.1 + off)[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
        found = fit_circle(points, diameter=diameter)
        known.append(bool(np.isfinite(found.std)))
        if diameter:
            costs = []
            for side in (0.0, 2 * points[:, 0].mean()):
                search = optimize.least_squares(
                    lambda at, points=points: np.hypot(*(points - at).T) - 0.1,
                    [side, 0], loss="cauchy", f_scale=0.01,
                )  # fmt: skip
                costs.append(search.cost)
            ratio = 38 * np.log(costs[1] / costs[0])
            assert known[-1] == (ratio > 10), covered
    assert known == sorted(known)  # from some length on
    assert not known[0]
    assert known[-1]


def test_axes_of_a_plane_are_turned_by_degrees_and_points_flattened(rng):
    points = rng.uniform(-1, 1, (60, 3)) * [3, 1, 0] @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
    plane = fit_plane(points)
    one, two = plane.directions(30.0)
    assert one == pytest.approx((np.sqrt(3) * plane.axes[0] + plane.axes[1]) / 2)
    assert two == pytest.approx((np.sqrt(3) * plane.axes[1] - plane.axes[0]) / 2)
    assert np.array_equal(plane.directions("principal"), plane.axes)
    assert np.array_equal(plane.directions("horizontal"), plane.horizontal_axes())
    assert flat_points(points) == pytest.approx(plane.project(points))
    for degrees, level in ((0.09, True), (0.11, False)):
        tilt = np.radians(degrees)
        flat = points @ np.vstack([plane.axes, plane.normal]).T  # in its own plane
        tilted = fit_plane(flat @ [[1, 0, 0], [0, np.cos(tilt), np.sin(tilt)], [0, 0, 1]])
        if level:
            with pytest.raises(ValueError, match=r"tilted by 0\.090 degrees"):
                tilted.horizontal_axes()
        else:
            assert np.abs(tilted.horizontal_axes()[0]) == pytest.approx([1, 0, 0], abs=1e-9)


@pytest.mark.parametrize(("wide", "line"), [(0.9e-6, True), (1.2e-6, False)])
def test_points_on_a_line_to_a_millionth_have_no_plane(wide, line):
    x = np.linspace(-1, 1, 101)
    points = np.column_stack([x, wide * np.where(np.arange(101) % 2, 1, -1) * np.sqrt(0.34), 0 * x])
    for scale in (1.0, 1000.0):
        if line:
            with pytest.raises(ValueError, match="101 of them on one line or spot"):
                fit_plane(scale * points)
        else:
            assert np.abs(fit_plane(scale * points).normal) == pytest.approx([0, 0, 1], abs=1e-6)
