"""The empty-space distance against closed forms and dense grids, and what must not change it."""

import numpy as np
import pytest
import shapely
import shapely.affinity
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from scipy.stats import poisson
from statsmodels.duration.survfunc import SurvfuncRight

from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.spacing import empty_space
from mmqa_lab.spacing.empty import EmptySpace, places_within

BOARD = shapely.box(0, 0, 1, 1)


def lattice(along, across, turn, size=3.0):
    """Points of a lattice over more than the board."""
    u, v = np.meshgrid(np.arange(-size, size, along), np.arange(-size, size, across))
    c, s = np.cos(turn), np.sin(turn)
    return np.stack([u.ravel(), v.ravel()], axis=1) @ [[c, s], [-s, c]]


def on_board(xy):
    """The points that a polygon around the board selects."""
    return xy[((xy >= 0) & (xy <= 1)).all(axis=1)]


@pytest.mark.parametrize("turn", [0.0, 0.3, np.pi / 4])
@pytest.mark.parametrize(("along", "across"), [(0.02, 0.02), (0.005, 0.047), (0.02, 0.1)])
def test_lattices_have_the_distance_of_a_dense_grid_over_one_cell(along, across, turn):
    u, v = np.meshgrid((np.arange(1000) + 0.5) / 2000, (np.arange(1000) + 0.5) / 2000)
    expected = np.quantile(np.hypot(along * u, across * v), 0.95)
    found = empty_space(on_board(lattice(along, across, turn)), outline=BOARD)
    assert found.e95 == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("rank", [1, 3, 10])
@pytest.mark.parametrize("distance", [0.01, 0.025, 0.05])
def test_random_points_are_found_at_as_many_places_as_poisson_says(rng, rank, distance):
    """Twenty boards; neighbours beyond the outline are unknown and yet make no difference."""
    found = [empty_space(rng.random((3000, 2)), outline=BOARD, rank=rank) for _ in range(20)]
    shares = [one.share(distance) for one in found]
    expected = poisson.sf(rank - 1, 3000 * np.pi * distance**2)
    assert np.mean(shares) == pytest.approx(expected, abs=0.002 + 3 * np.std(shares) / 20**0.5)
    if rank == 1:
        e95 = np.mean([one.e95 for one in found])
        assert e95 == pytest.approx(np.sqrt(np.log(20) / (3000 * np.pi)), rel=0.01)


@settings(deadline=None, max_examples=25)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.0, 1e3, -1e7]),
    st.sampled_from([1.0, 0.01, 300.0]),
    st.sampled_from(["random", "lines", "clusters"]),
)
def test_order_place_unit_and_copies_do_not_matter(seed, shift, unit, kind):
    rng = np.random.default_rng(seed)
    xy = {
        "random": lambda: rng.random((500, 2)),
        "lines": lambda: rng.random((500, 2)).round(1) + [0.003, 0.001] * rng.random((500, 2)),
        "clusters": lambda: (
            rng.random((25, 2))[rng.integers(0, 25, 500)] + rng.normal(0, 0.02, (500, 2))
        ),
    }[kind]()
    here = empty_space(xy)
    there = rng.permutation(np.vstack([xy, xy[:100]])) * unit + shift
    # coordinates of 1e7 m are rounded to 2e-9 m, which also moves places in or out of the outline
    assert empty_space(there).e95 == pytest.approx(unit * here.e95, rel=0.005, abs=1e-8)


def test_the_share_follows_the_distance_and_the_rank(rng):
    xy = rng.random((2000, 2))
    first, third = empty_space(xy), empty_space(xy, rank=3)
    assert first.share(first.e95) == pytest.approx(0.95, abs=0.001)
    assert first.share(0.01) > third.share(0.01)
    brute = cKDTree(xy).query(third.places, 3)[0][:, 2]
    np.testing.assert_allclose(third.distances, brute)
    assert np.isnan(first.share(0.51))  # no disc of this size lies within the board
    assert np.isnan(first.share(np.nan))


def test_a_hole_is_empty_and_two_heads_may_leave_more_than_g_tells(rng):
    xy = rng.random((4000, 2))
    whole, holed = xy, xy[(np.abs(xy - 0.5) > 0.2).any(axis=1)]
    assert empty_space(holed, outline=BOARD).e95 > 5 * empty_space(whole, outline=BOARD).e95
    crossed = on_board(np.vstack([lattice(0.004, 0.07, turn) for turn in (0.785, -0.785)]))
    board = np.column_stack([crossed, rng.normal(0, 0.003, len(crossed))])
    quality = evaluate_cloud(board, polygon=[[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    table = quality.to_frame().iloc[0]
    assert table["g"] == pytest.approx(1, abs=0.05)
    assert table["e95_mm"] > 25  # lines 7 cm apart
    row = quality.intervals().set_index("figure").loc["e95"]
    assert row["value"] == table["e95_mm"]
    assert row["unit"] == "mm"


@pytest.mark.parametrize(
    "outline",
    [
        BOARD.difference(shapely.box(0.4, 0.4, 0.6, 0.6)),
        shapely.MultiPolygon([shapely.box(0, 0, 0.3, 1), shapely.box(0.5, 0, 1, 1)]),
    ],
)
def test_holes_and_parts_have_borders_too(rng, outline):
    found = empty_space(
        rng.random((3000, 2)) + 1e6, outline=shapely.affinity.translate(outline, 1e6, 1e6)
    )
    places = shapely.points(found.places - 1e6)
    np.testing.assert_allclose(found.border, shapely.distance(outline.boundary, places), atol=1e-9)


def test_nothing_to_measure_is_nan():
    assert np.isnan(empty_space([[0, 0], [1, 0], [2, 0]]).e95)  # no area
    assert np.isnan(empty_space([[0.5, 0.5]], outline=BOARD, rank=2).e95)
    assert empty_space([[0.5, 0.5]], outline=BOARD, rank=2).share(0.1) == 0


@pytest.mark.parametrize(
    ("choices", "said"),
    [
        ({"rank": 0}, r"Invalid rank 0\. Must be a whole number"),
        ({"outline": [[0, 0], [1, 1]]}, r"Invalid outline: 2 given\. Must be 3"),
        ({"outline": [[0, 0], [1, np.nan], [1, 1]]}, "Invalid outline: 1 of 3 not finite"),
    ],
)
def test_rejects(choices, said):
    with pytest.raises(ValueError, match=said):
        empty_space([[0, 0], [1, 0], [0, 1]], **choices)


def test_shares_are_those_of_survival_where_the_outline_ends_what_is_known(rng):
    """Kaplan and Meier's estimator, as of statsmodels."""
    distances, border = rng.exponential(1, 200), rng.exponential(2, 200)
    found = EmptySpace(np.zeros((200, 2)), distances, border)
    reach, known = np.minimum(distances, border), distances <= border
    other = SurvfuncRight(reach, known)
    for distance in np.linspace(0, 0.9 * border.max(), 40):
        before = other.surv_times <= distance
        expected = 1 - other.surv_prob[before][-1] if before.any() else 0
        assert found.share(distance) == pytest.approx(expected)
    for share in (0.1, 0.5, 0.9):
        first = other.surv_times[np.argmax(1 - other.surv_prob >= share)]
        assert found.quantile(share) == pytest.approx(first)
    assert found.e95 == found.quantile(0.95) or np.isnan(found.e95)
    assert np.isnan(found.share(1.001 * border.max()))
    assert np.isfinite(found.share(0.999 * border.max()))
    none = EmptySpace(np.zeros((9, 2)), np.full(9, 3.0), np.ones(9))
    assert np.isnan(none.quantile(0.1))
    assert none.share(1.0) == 0


def test_places_are_as_many_and_as_even_within_any_outline():
    ring = shapely.Point(0, 0).buffer(1.0).difference(shapely.Point(0.2, 0).buffer(0.5))
    two = shapely.union(ring, shapely.box(3, 0, 3.5, 1))
    for outline in (shapely.box(5e6, 2, 5e6 + 2, 7), two):
        places = places_within(outline, 2000)
        assert len(places) == pytest.approx(2000, rel=0.03)
        assert shapely.contains_xy(outline, *places.T).all()
        low, high = np.reshape(outline.bounds, (2, 2))
        middle = (low + high)[0] / 2
        part = shapely.intersection(outline, shapely.box(*low, middle, high[1])).area
        assert np.mean(places[:, 0] < middle) == pytest.approx(part / outline.area, abs=0.02)
    thin = shapely.LineString([(0, 0), (100, 100)]).buffer(0.01)
    assert 0 < len(places_within(thin, 2000)) < 100  # of a hundred times as many at most
    assert len(places_within(shapely.LineString([(0, 0), (1, 1)]))) == 0
