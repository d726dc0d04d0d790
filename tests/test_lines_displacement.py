"""Steps of the search for a displacement, and its least squares, against plain linear algebra."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from mmqa_lab.lines import (
    directions,
    displacement,
    fit_displacement,
    hausdorff,
    lengths,
    midpoints,
    pairing,
    segments,
)
from mmqa_lab.lines import displacement_search as search
from mmqa_lab.lines.pairing import apart, levers, paired


def at_random(rng, n, extent=30.0):
    """Segments of 1 to 6 m anywhere in a cube."""
    first, way = rng.uniform(0, extent, (n, 3)), rng.normal(size=(n, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    return np.stack([first, first + way * rng.uniform(1, 6, (n, 1))], axis=1)


def test_pairs_share_a_stretch_as_plain_vectors_say(rng):
    model = at_random(rng, 8)
    way = directions(model)
    test = model + 0.02 * rng.normal(size=model.shape) + way[:, None] * rng.normal(size=(8, 1, 1))
    test[::2] = test[::2, ::-1]
    moved = rng.normal(0, 0.3, (8, 3))
    lines = paired(test, model, np.arange(8), np.arange(8))
    again = lines.again(moved)
    for given, back in ((lines, 0 * moved), (again, moved)):
        for k in range(8):
            half_t, half_m = (np.linalg.norm(one[k, 1] - one[k, 0]) / 2 for one in (test, model))
            middle = model[k].mean(axis=0)
            ends = np.sort((test[k] - back[k] - middle) @ way[k])
            at = (test[k].mean(axis=0) - back[k] - middle) @ way[k]
            low, high = max(at - half_t, -half_m), min(at + half_t, half_m)
            assert ends == pytest.approx([at - half_t, at + half_t], abs=0.02)
            assert given.along[k] == pytest.approx(at)
            assert given.stretches[1][k] == pytest.approx([low, high])
            own = np.array([low, high]) - at
            own = own if (test[k, 1] - test[k, 0]) @ way[k] > 0 else -own[::-1]
            assert given.stretches[0][k] == pytest.approx(own)
            assert given.overlap[k] == pytest.approx((high - low) / 2 / min(half_t, half_m))
            place = middle + (low + high) / 2 * way[k]
            assert given.place[k] == pytest.approx(place - midpoints(model).mean(axis=0))
            own_way = (test[k, 1] - test[k, 0]) / (2 * half_t)
            own_way *= np.sign(own_way @ way[k])
            there = test[k].mean(axis=0) + ((low + high) / 2 - at) * own_way
            assert given.offset[k] == pytest.approx(given.frame[k] @ (there - place))
        assert np.einsum("nkd,nd->nk", given.frame, given.axis) == pytest.approx(0)
    # the design: what a vector and a turn about the vertical change across the lines
    centre = np.array([1.0, 2, 3])
    design, arm = again.design(centre), again.place - centre
    for k in range(8):
        turned = np.cross([0, 0, 1.0], arm[k])
        assert design[k] @ [0, 0, 0, 1] == pytest.approx(again.frame[k] @ turned)
        assert design[k] @ [1, -2, 3, 0] == pytest.approx(again.frame[k] @ [1, -2, 3])
    assert levers(arm) == pytest.approx(np.cross([0, 0, 1.0], arm))


def test_pairs_are_accepted_in_order_where_a_third_at_most_is_taken(rng, uncompiled):
    uncompiled(pairing)
    n = 60
    rows, columns = rng.integers(0, 4, n), rng.integers(0, 5, n)
    ends = np.sort(rng.uniform(0, 10, (2, n, 2)), axis=2)
    ends[0, :5] = ends[0, :5, ::-1]  # gaps
    costs = np.where(rng.random(n) < 0.9, rng.random(n), np.inf)
    lines = SimpleNamespace(rows=rows, columns=columns, stretches=tuple(ends), shape=(4, 5))
    taken, expected = [], np.zeros((4, 5), bool)
    for k in np.argsort(costs):
        free = np.isfinite(costs[k])
        for other in taken:
            for side, line in enumerate((rows, columns)):
                if line[k] == line[other]:
                    (low, high), (a, b) = ends[side, k], ends[side, other]
                    free &= high > low and min(high, b) - max(low, a) <= 0.3 * (high - low)
        if free:
            taken.append(k)
            expected[rows[k], columns[k]] = True
    assert np.array_equal(apart(lines, costs), expected)
    assert 4 < len(taken) < 40


def test_the_displacement_is_that_of_weighted_rows_and_its_covariance_a_jackknife(rng):
    n = 14
    frames = rng.normal(size=(n, 2, 4))
    lines = SimpleNamespace(design=lambda _: frames, offset=rng.normal(size=(n, 2)))
    lines.offset += frames @ [0.5, -0.2, 0.1, 0.003]
    lines.offset[3] += 9  # an outlier
    which = np.array([0, 0, *range(1, n - 1)])  # the first two are one line
    solution, covariance = displacement._solved(lines, which, None, np.zeros(4))
    prior = np.array([0, 0, 0, 0.1 / np.radians(1)])
    at = np.zeros(4)

    def solved(weights):
        root = np.repeat(np.sqrt(weights), 2)
        rows = np.vstack([root[:, None] * frames.reshape(-1, 4), prior])
        return np.linalg.lstsq(rows, np.append(root * lines.offset.ravel(), 0))[0]

    for _ in range(10):
        off = lines.offset - frames @ at
        far = np.linalg.norm(off, axis=1) / np.sqrt(2) / np.median(np.abs(off))
        weights = np.minimum(1, 2.5 / far)
        at = solved(weights)
    assert solution == pytest.approx(at)
    spread = np.array([(solved(weights * (which != k)) - at)[:3] for k in range(n - 1)])
    wider = 1.3 * 3 * stats.f.ppf(0.95, 3, n - 5) / stats.chi2.ppf(0.95, 3)
    assert covariance == pytest.approx(wider * (n - 2) / (n - 1) * spread.T @ spread, rel=1e-6)


def test_a_shift_and_a_turn_are_found_and_told_at_places(rng):
    model = at_random(rng, 30)
    middle, turn = midpoints(model).mean(axis=0), np.radians(0.02)
    test = model + [0.3, -0.2, 0.1]
    test[..., :2] += turn * np.stack([-(model - middle)[..., 1], (model - middle)[..., 0]], axis=-1)
    found = fit_displacement(test, model, np.eye(30, dtype=bool))
    assert found.turn_deg == pytest.approx(0.02, rel=0.02)
    places = midpoints(model) - middle
    moved = midpoints(test) - midpoints(model)
    assert found.at(places) == pytest.approx(moved, abs=2e-4)
    by_hand = found.vector + np.radians(found.turn_deg) * np.cross(
        [0, 0, 1.0], places - found.centre
    )
    assert found.at(places) == pytest.approx(by_hand)
    frame = found.to_frame()
    half = (frame["high_m"] - frame["value_m"]).to_numpy()
    assert half == pytest.approx(1.96 * frame["std_m"].to_numpy())
    few = np.eye(30, dtype=bool) & (np.arange(30) < 2)
    assert np.isnan(fit_displacement(test, model, few).vector).all()


def test_candidates_are_nearly_parallel_within_reach(rng, uncompiled):
    uncompiled(segments)
    model = at_random(rng, 25, extent=14.0)
    turn = np.linalg.qr(np.eye(3) + 0.06 * rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.diag(turn))
    test = (model @ turn.T) + rng.normal(0, 1.5, (25, 1, 3))
    test[0] += [300, 0, 0]  # far from the middle, its reach has an end
    found = search._candidates(test, model, 3.0)
    off = np.linalg.norm(midpoints(test) - midpoints(test)[1:].mean(axis=0), axis=1)
    reach, expected = 3 + np.minimum(0.06 * off, 6), []
    for i in range(25):
        for j in range(25):
            u, v = directions(test)[i], directions(model)[j]
            between = midpoints(test)[i] - midpoints(model)[j]
            s = between @ v
            across = np.linalg.norm(between - s * v)
            gap = abs(s) - (lengths(test)[i] + lengths(model)[j]) / 2
            angle = np.arcsin(min(1, np.linalg.norm(np.cross(u, v))))
            if angle < np.radians(8) and across < reach[i] and gap < reach[i]:
                expected.append((i, j))
    assert list(zip(found.rows.tolist(), found.columns.tolist(), strict=True)) == expected
    assert len(expected) > 10
    places = np.column_stack([[0.0, 1, -1, 2, -2, 9.9, -10.1], np.zeros((7, 2))])
    median = np.median(np.abs(places[:, 0]))
    assert search.together(places).tolist() == (np.abs(places[:, 0]) <= 5 * median).tolist()


def upright(rng, n, long=22.0):
    """Upright lines along a street."""
    feet = np.column_stack([rng.uniform(0, long, n), rng.uniform(-4, 4, n), rng.uniform(0, 1, n)])
    return np.stack([feet, feet + [0, 0, 3.0]], axis=1)


def test_a_search_has_stations_moves_shares_and_votes_by_their_definition(rng, uncompiled):
    uncompiled(search, segments)
    model = upright(rng, 9)
    test = model + [0.35, -0.2, 0.0]
    lines = paired(test, model, np.arange(9), np.arange(9))
    found = search.Search(lines, 1.0)
    places = midpoints(test) - midpoints(model).mean(axis=0)
    flat = (places - places.mean(axis=0))[:, :2]
    way = np.linalg.svd(flat)[2][0]
    assert abs(found.way @ way) == pytest.approx(1)
    along = flat @ found.way
    assert found.along(places) == pytest.approx(along)
    number = int(np.ceil(np.ptp(along) / 5))
    assert found.stations == pytest.approx(np.linspace(along.min(), along.max(), number + 1))
    gap = np.ptp(along) / number
    farthest = 0.06 * np.abs(along).max()
    wide, up = int((1 + farthest) / 0.3) + 2, int(1 / 0.3) + 2
    axes = [0.3 * np.arange(-one, one + 1) for one in (wide, wide, up)]
    moves = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    assert found.moves == pytest.approx(moves)
    assert found.strides == (1, 2 * up + 1, (2 * up + 1) * (2 * wide + 1))
    reach = 1 + np.minimum(0.06 * np.abs(found.stations), farthest)
    inside = np.linalg.norm(moves, axis=1) <= reach[:, None] + 1e-9
    inside &= np.abs(moves[:, 2]) <= 1
    assert np.array_equal(np.isfinite(found.votes), inside)
    costs = [(step * 0.3 / gap / 0.05) ** 2 / 2 / 2.5 for step in (1, 2)]
    assert found.costs == pytest.approx(costs, rel=1e-5)
    # every line votes at its two stations for moves near the one that brings it to its own
    shares = np.maximum(0, 1 - np.abs(along - found.stations[:, None]) / gap)
    shares = np.round(32 * shares) / 32
    off = np.round(moves[:, :2] / 0.3) - np.array([0.35, -0.2]) / 0.3
    value = np.round(32 * (1 - (off**2).sum(axis=1) / 1.7**2)) / 32
    expected = shares.sum(axis=1)[:, None] * np.maximum(value, 0)
    assert np.where(inside, found.votes, 0) == pytest.approx(
        np.where(inside, expected, 0), abs=1e-4
    )
    path, total = next(found.paths())
    assert path[:, :2] == pytest.approx(np.tile([0.3, -0.3], (number + 1, 1)))
    assert total == pytest.approx(expected.max(axis=1).sum(), rel=1e-5)
    # between stations and beside them
    bent = np.column_stack([found.stations, 2 * found.stations, 0 * found.stations])
    moved = found.at(places, bent, 0.01)
    beside = flat - along[:, None] * found.way
    turned = 0.01 * np.column_stack([-beside[:, 1], beside[:, 0]])
    assert moved[:, :2] == pytest.approx(np.column_stack([along, 2 * along]) + turned)
    assert moved[:, 2] == pytest.approx(0)


@pytest.mark.parametrize(("aside", "members"), [(0.27, 12), (0.31, 11)])
def test_evidence_is_that_of_normal_distances_beside_unrelated_lines(
    aside, members, rng, uncompiled
):
    """Lines at their place but one, which is moved aside: up to 3.41 deviations, 99.7 %."""
    uncompiled(search, segments, pairing)
    model = at_random(rng, 12)
    lines = paired(model, model, np.arange(12), np.arange(12))
    test = model.copy()
    test[5] += aside * lines.frame[5, 0]
    lines = paired(test, model, np.arange(12), np.arange(12))
    evidence, pairs, ends = search.refined(lines, lambda place: 0 * place)
    assert pairs.sum() == members
    assert pairs[5, 5] == (members == 12)
    variance = 0.03**2 + 0.08**2
    both = 2 * np.log(0.7 + 0.3 / 0.15 / 0.4)
    rel = 1e-3 if members == 11 else 0.06  # the one aside draws at the others
    assert ends == pytest.approx(members * both, rel=rel)
    ratio = -members * np.log(2 * np.pi * variance * 0.1)
    ratio -= aside**2 / variance / 2 if members == 12 else 0
    assert evidence == pytest.approx(ratio + ends, rel=rel)


def test_what_is_left_of_a_path_is_a_vector_a_turn_and_drift_from_the_others(rng, uncompiled):
    uncompiled(search)
    model = at_random(rng, 9)
    lines = paired(model + 0.05 * rng.normal(size=model.shape), model, np.arange(9), np.arange(9))
    members, noise, path = np.array([0, 2, 3, 5, 8]), 0.04, 0.02 * rng.normal(size=(9, 3))
    found = search._field(lines, path, members, noise)
    centre = lines.place[members].mean(axis=0)
    rows = lines.design(centre)[members].reshape(-1, 4)
    off = lines.offset - np.einsum("nkd,nd->nk", lines.frame, path)
    prior = noise * np.diag([1e-3, 1e-3, 1e-3, 1 / np.radians(1)])
    mean = np.linalg.lstsq(np.vstack([rows, prior]), np.append(off[members].ravel(), [0] * 4))[0]
    left = off[members] - (rows @ mean).reshape(-1, 2)
    for n in range(9):
        near = np.exp(-np.linalg.norm(lines.place[members] - lines.place[n], axis=1) / 20)
        near[members == n] = 0
        root = np.repeat(np.sqrt(near), 2)
        frames = lines.frame[members].reshape(-1, 3)
        drift = np.linalg.lstsq(
            np.vstack([root[:, None] * frames, noise / 0.25 * np.eye(3)]),
            np.append(root * left.ravel(), [0, 0, 0]),
        )[0]
        turned = mean[3] * np.cross([0, 0, 1.0], lines.place[n] - centre)
        assert found[n] == pytest.approx(path[n] + mean[:3] + turned + drift)


def test_kinds_are_groups_of_pairs_and_the_interval_is_that_of_drawn_sources(rng):
    """One pair, one test line with two, two with one, two with two, and lines without any."""
    pairs = np.zeros((8, 8), bool)
    pairs[0, 0] = pairs[1, 1] = pairs[1, 2] = pairs[2, 3] = pairs[3, 3] = True
    pairs[4, 4] = pairs[4, 5] = pairs[5, 5] = True
    lines = at_random(rng, 8)
    source = np.nonzero(pairs)[0]
    share = rng.uniform(1, 2, 8)
    parts = SimpleNamespace(distance=lambda weight: weight * np.arange(1.0, 9))
    side = SimpleNamespace(pairs=pairs, share=share, source=source, parts=parts)
    side.olhd = lambda weight: share @ parts.distance(weight)
    other = SimpleNamespace(olhd=lambda _: np.nan)
    found = hausdorff.LHD(2.0, "all", side, other, lines, lines, ())
    expected = {"one-to-null": 2 + 2, "one-to-one": 1, "one-to-multiple": 1}
    expected |= {"multiple-to-one": 1, "multiple-to-multiple": 1}
    assert found.kinds().to_dict() == expected
    assert found.value == pytest.approx(2 * share @ np.arange(1, 9))
    # by the same draws one by one: the mean of the pairs of drawn lines, and Student's t of six
    drawn = np.random.default_rng(0).multinomial(6, np.full(6, 1 / 6), size=1000)
    distances, means = 2 * np.arange(1.0, 9), []
    for one in drawn:
        weights = np.concatenate([np.full(np.sum(source == k), one[k]) for k in range(6)]) * share
        means.append((weights * distances).sum() / weights.sum())
    mean = (share * distances).sum() / share.sum()
    wider = stats.t.ppf(0.975, 5) * np.sqrt(6 / 5) / 1.96
    ends = [mean + wider * (np.quantile(means, q) - mean) for q in (0.025, 0.975)]
    assert found._interval == pytest.approx(np.maximum(ends, [0, 0]) * share.sum())
    single = SimpleNamespace(**vars(side) | {"source": np.zeros(8, int)})
    assert np.isnan(hausdorff.LHD(2.0, "all", single, other, lines, lines, ())._interval).all()


def test_the_parts_of_a_distance_are_steps_of_sums_of_squares(rng, uncompiled):
    """Of true pairs with a common shift, and one false pair."""
    uncompiled(segments, pairing)
    model = at_random(rng, 12)
    test = model + [0.2, -0.1, 0.05] + 0.02 * rng.normal(size=model.shape)
    truth, pairs = np.eye(12, dtype=bool), np.eye(12, dtype=bool)
    pairs[3, 4] = True
    rows, columns = np.nonzero(pairs)
    parts = SimpleNamespace(
        perpendicular=rng.uniform(0.3, 0.5, 13), angle=rng.uniform(0, 0.2, 13),
        parallel=rng.uniform(0, 0.3, 13),
    )  # fmt: skip
    share = rng.uniform(0.05, 0.1, 13)
    side = SimpleNamespace(pairs=pairs, share=share, parts=parts, olhd=lambda _: 1.0)
    none = SimpleNamespace(olhd=lambda _: np.nan)
    found = hausdorff.LHD(1.5, "all", side, none, test, model, ())
    shift = fit_displacement(test, model, truth)
    lines = paired(test, model, rows, columns)
    across = [np.linalg.norm(frame @ (shift.vector + np.radians(shift.turn_deg) * turned))
              for frame, turned in zip(lines.frame, levers(lines.place - shift.centre),
                                       strict=True)]  # fmt: skip
    flat = parts.perpendicular
    bent = np.hypot(flat, np.sqrt(1.5) * parts.angle)
    whole = np.hypot(bent, parts.parallel)
    right = share * (rows == columns)
    means = [(right * one).sum() / right.sum() for one in (across, flat, bent, whole)]
    means.append((share * whole).sum() / share.sum())
    told = found.split(truth=truth)["value_m"].tolist()
    assert told[:5] == pytest.approx([means[0], *np.diff(means)], abs=1e-6)
    assert told[5] == pytest.approx(means[-1])
