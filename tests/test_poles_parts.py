"""Parts of the detectors: each against plain loops, a closed form, or cases on both sides of it."""

import re

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import brentq

from mmqa_lab.poles import axes, common, learned, measures

RADII, BIN = (0.08, 0.15, 0.25, 0.40, 0.55), 0.25


def ring(radius, n, centre=(0.0, 0.0), start=0.0, end=2 * np.pi):
    """Points on a part of a circle."""
    turn = np.linspace(start, end, n, endpoint=False)
    return np.column_stack([np.cos(turn), np.sin(turn)]) * np.reshape(radius, (-1, 1)) + centre


def longest(flags):
    """Ends of the first of the longest runs with gaps of one."""
    runs = re.finditer("1(?:0?1)*", "".join("01"[int(flag)] for flag in flags))
    return max((run.span() for run in runs), key=lambda ends: ends[1] - ends[0], default=(0, 0))


def test_longest_runs_are_those_of_a_regular_expression(rng):
    flags = rng.random((300, 64)) < rng.choice([0.1, 0.5, 0.8], (300, 1))
    flags[:3] = [[False], [True], [False]] * np.ones((1, 64), bool)
    found = measures.longest_runs(flags)
    assert np.column_stack(found).tolist() == [[*longest(row)] for row in flags]


def loops(points, height, axis, coarse):
    """All measures of one axis but the circle, each by its description."""
    off = points[:, :2] - axis[:2] - axis[2:4] * (height - axis[4])[:, None]
    across = np.hypot(*off.T)
    near = (np.hypot(*(points[:, :2] - axis[:2]).T) < 1.3) & (across < 1)
    off, across, height = off[near], across[near], height[near]
    bins = np.floor(height / BIN).astype(int)
    count = lambda which: np.bincount(bins[which], minlength=64)  # noqa: E731
    cores = [count(across <= r) for r in RADII]
    shells = [count((across > r) & (across <= r + 0.25)) for r in RADII]
    runs = [longest((c > 0) & (s <= 0.15 * c)) for c, s in zip(cores, shells, strict=True)]
    long = [last - first for first, last in runs]
    chosen = next(k for k in range(5) if long[k] >= max(long) / 2)
    column = longest(cores[chosen] > 0)
    first, last = runs[chosen] if long[chosen] else column
    told = {"run_m": BIN * long[chosen], "clean_150_m": BIN * long[1], "clean_400_m": BIN * long[3]}
    told |= {
        "core_m": RADII[chosen],
        "low_m": BIN * first,
        "column_m": BIN * (column[1] - column[0]),
    }
    right_above = shells[chosen][last : min(last + 8, 64)] > 0
    told["above_shell"] = right_above.mean() if len(right_above) else 0
    over = off[(height >= BIN * last) & (height < BIN * last + 0.75)]
    told["roof"] = len({tuple(cell) for cell in np.floor(over / 0.25)}) / 52
    run = (height >= BIN * first) & (height < BIN * last)
    aside = run & (across > RADII[chosen] + 0.03)
    told["beside"] = len(set(bins[aside])) / max(last - first, 1)
    told["crowd"] = np.log(1 + ((across < 0.7) & (height < 5)).sum())
    told["off_line_m"] = 1.0
    if aside.sum() >= 5:
        across_line = np.linalg.eigh(np.cov(off[aside].T))[1][:, 0]
        told["off_line_m"] = abs(off[aside].mean(axis=0) @ across_line)
    own = run & (across <= RADII[chosen])
    told["points"] = np.log(1 + own.sum() / max(BIN * (last - first), BIN))
    spread = np.linalg.eigvalsh(np.cov(off[own].T, ddof=0))[1] if own.sum() > 1 else 0
    told["wide_m"] = np.sqrt(12 * max(spread, 0))
    top = height.max(initial=0)
    told["top_m"], told["slim"] = top // BIN * BIN, min(top / (told["wide_m"] + 0.02), 100)
    away = coarse[:, :2] - axis[:2]
    far = (np.hypot(*away.T) > 1) & (np.hypot(*away.T) < 4)
    sector = np.floor(np.degrees(np.arctan2(away[:, 1], away[:, 0])) % 360 / 15)
    for name, low, high in (("low", -9, 1), ("mid", 1, 2.5), ("high", 2.5, 5), ("top", 5, 99)):
        seen = far & (coarse[:, 2] >= low) & (coarse[:, 2] < high)
        told[f"around_{name}"] = len(set(sector[seen])) / 24
    return told, off[own], height[own], (BIN * first, BIN * last)


def shafts(rng):
    """Shafts of several widths with a few points around some of their heights, and their axes."""
    parts, places = [], []
    for k, (radius, around) in enumerate(
        [(0.05, 1), (0.12, 3), (0.2, 1), (0.35, 4), (0.5, 1), (0.05, 12), (0.1, 0)]
    ):
        rise = rng.uniform(0, 4 + 2 * k, 900)
        rise = rise[(rise * 1.3 % 4 > 0.6) | (k % 3 == 0)]
        xy = ring(radius, len(rise), start=0, end=50 + k) + 0.004 * rng.normal(size=(len(rise), 2))
        few = rng.uniform([-0.9, -0.9, 0], [0.9, 0.9, 12], (60 * around, 3))
        place = np.array([8.0 * k, 3.0 * k])
        lean = rng.uniform(-0.1, 0.1, 2)
        middle = rise.mean()
        shaft = np.column_stack([xy + lean * (rise - middle)[:, None], rise])
        parts.append(np.vstack([shaft, few]) + [*place, 0])
        places.append([*place, *lean, middle])
    places.append([100.0, 100, 0, 0, 1])  # with nothing near
    points = np.vstack(parts)
    coarse = rng.uniform([-4, -4, 0], [60, 30, 12], (4000, 3))
    return common.Thin(points, points[:, 2].clip(0, 15.99), coarse), np.array(places)


def test_measures_of_candidates_are_those_of_plain_loops(rng, uncompiled):
    uncompiled(measures, common)
    thin, places = shafts(rng)
    same, found, shaft = measures.measure(thin, places)
    assert same is places
    assert {0.08, 0.15, 0.25, 0.55} <= set(found["core_m"])
    for k, place in enumerate(places):
        told, own, height, ends = loops(thin.points, thin.height, place, thin.coarse)
        if len(own):
            (centre,), (r,), (rough,) = axes.circles(np.zeros(len(own), int), own, 1)
            spoke = own - centre
            away, below = np.hypot(*spoke.T), height.max() - height
            sector = np.floor(np.degrees(np.arctan2(spoke[:, 1], spoke[:, 0])) % 360 / 15)
            upper, lower = (below > 0.08) & (below < 0.28), below >= 0.28
            head = away[upper].mean() / away[lower].mean() if upper.sum() > 1 else 1
            told |= {"radius_m": r, "rough": rough / (r + 0.02), "arc": len(set(sector)) / 24}
            told |= {"head": head, "slender": min(told["run_m"] / (2 * r + 0.02), 100)}
            assert shaft["centre"][k] == pytest.approx(centre)
        assert dict(found.iloc[k][[*told]]) == pytest.approx(told, abs=1.01e-4), k
        assert (shaft["low"][k], shaft["high"][k]) == ends
    again = measures.measure(thin._replace(coarse=thin.coarse[:0]), places, found)[1]
    assert again.equals(found)  # what stands around is taken from before


def described(points, core, low, high, places):
    """Candidates with a level ground, their run and their core."""
    k = len(places)
    shaft = {"low": np.full(k, low), "high": np.full(k, high), "centre": np.zeros((k, 2))}
    given = pd.DataFrame({"core_m": np.full(k, core), "radius_m": 0.1, "arc": 1.0})
    return learned.Described(places, given, shaft, lambda p: 10 + 0 * p[:, 0], points)


def test_sections_have_the_interval_of_a_jackknife_of_eight_parts(rng, uncompiled):
    uncompiled(common)
    radii = 0.1 + np.array([0, 3, -1, 2, -4, 1, 5, -2]) * 1e-3
    turn = ring(1.0, 40)
    shaft = np.vstack([np.column_stack([r * turn, np.full(40, 11 + 0.5 * g + 0.25)])
                       for g, r in enumerate(radii)])  # fmt: skip
    shaft[:, :2] += [5, 7] + [0.1, -0.05] * (shaft[:, 2:] - 12)  # it leans
    beside = [[5.9, 7, 12], [5, 7, 10.5], [5, 7, 15.5]]  # outside of core and run
    place = np.array([[5.0, 7, 0.1, -0.05, 2]])
    found = measures.sections(described(np.vstack([shaft, beside]), 0.3, 1.0, 5.0, place),
                              np.array([True]))  # fmt: skip

    def robust(radii):
        return brentq(lambda r: ((radii - r) / (1 + ((radii - r) / 0.03) ** 2) ** 2).sum(), 0, 1)

    r = robust(radii)
    std = 2 * np.sqrt(7 * np.var([robust(np.delete(radii, g)) for g in range(8)]))
    half = np.hypot(3 * std, 0.002 + 0.02 * 2 * r)
    told = [found[name][0] for name in ("diameter_m", "diameter_low_m", "diameter_high_m")]
    assert told == pytest.approx([2 * r, 2 * r - half, 2 * r + half], abs=1e-7)
    assert found["section_m"] == found["diameter_m"]


@pytest.mark.parametrize(
    ("kind", "inside", "outside"),
    [("count", 15, 14), ("rough", 0.0295, 0.0305), ("arc", 1.0, 0.8), ("wave", 0.0011, 0.0014),
     ("spread", 0.010, 0.012)],
)  # fmt: skip
def test_a_diameter_is_told_on_one_side_of_each_limit_alone(kind, inside, outside, uncompiled):
    uncompiled(common)
    for value, known in ((inside, True), (outside, False)):
        n = value if kind == "count" else 240
        place = np.arange(n)
        angle = 2 * np.pi * place / n
        if kind == "arc":  # of half an opening: what is seen is about 2 sin r wide
            angle = np.linspace(-value, value, n)
        off = 0.004 * np.where(place % 2, 1, -1.0)
        if kind == "rough":  # two points in eight are off
            off = 2 * value * np.select([place % 8 == 3, place % 8 == 7], [1, -1.0])
        off += value * np.cos(4 * angle) if kind == "wave" else 0
        rise = (place * 8 // n + 0.5) / 2
        if kind == "spread":  # every second of the eight parts is wider
            rise, off = (place % 8 + 0.5) / 2, value * np.where(place % 2, 1, -1.0)
        radius = (0.04 if kind == "spread" else 0.15) + off
        points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), 10 + rise])
        given = described(points, 0.4, 0.0, 4.0, np.zeros((1, 5)))
        found = measures.sections(given, np.array([True]))
        assert np.isfinite(found["diameter_m"][0]) == known, value
        assert np.isfinite(found["section_m"][0])


def straight(xy, height, places, leans, scatter):
    """A robust straight axis by rows of weighted least squares, one of them the prior."""
    middle = height.mean()
    place, lean, rise = np.zeros(2), np.zeros(2), height - middle
    for scale in (0.15, 0.13, 0.11, 0.09, 0.075, 0.06, 0.06, 0.06):
        off = xy - place - lean * rise[:, None]
        root = 1 / (1 + (off**2).sum(axis=1) / max(scale, scatter) ** 2)
        rows = np.vstack([np.column_stack([root, root * rise]), [0, 1]])
        place, lean = np.linalg.lstsq(rows, np.vstack([root[:, None] * xy, [0, 0]]))[0]
        lean = lean.clip(-0.27, 0.27)
    return [*places + place, *lean, middle]


def test_fit_axes_are_rows_of_weighted_least_squares(rng, uncompiled):
    uncompiled(common)
    rise = rng.uniform(0, 3, (3, 120))
    leans = np.array([[0.12, -0.2], [-0.35, 0.1], [0.02, 0.0]])
    places = np.array([[4.0, 5], [14, 5], [24, 5]])
    parts = [
        np.column_stack([p + lean * (z - 1.5)[:, None] + rng.normal(0, 0.06, (120, 2)), z])
        for p, lean, z in zip(places, leans, rise, strict=True)
    ]
    points = np.vstack([*parts, *(rng.uniform([x - 1, 4, 0], [x + 1, 6, 3], (200, 3))
                                  for x in (4, 14, 24))])  # fmt: skip
    thin = common.Thin(points, points[:, 2] - 0.3, points)
    given, scatter = places + [0.05, -0.03], np.array([0.06, 0.06, 0.25])
    found = axes.fit_axes(thin, given, scatter)
    for k, reach in enumerate((0.5, 0.5, 0.65)):
        near = np.hypot(*(points[:, :2] - given[k]).T) < reach
        told = straight(points[near, :2] - given[k], thin.height[near], given[k], 0, scatter[k])
        assert found[k] == pytest.approx(told, abs=1e-8)
    assert np.abs(found[1, 2]) == 0.27


@pytest.mark.parametrize(
    ("radius", "rough", "upright"), [(0.4, 0.16, 1), (0.4, 0.2, 0), (0.27, 0, 1), (0.23, 0, 0)]
)
def test_the_widest_axes_stand_in_the_centre_of_their_circle(radius, rough, upright, uncompiled):
    uncompiled(common)
    z = np.tile(np.linspace(0, 3, 30), 24)
    few = np.select([np.arange(720) % 8 == 3, np.arange(720) % 8 == 7], [2, -2.0])
    flat = ring(radius * (1 + rough * few), 720, (7, 9))
    points = np.column_stack([flat + [0.02, 0] * (z - 1.5)[:, None], z])
    thin = common.Thin(points, z, points)
    for scatter, straight_up in ((0.25, upright), (0.06, 0)):
        (found,) = axes.fit_axes(thin, np.array([[7.01, 9.0]]), np.array([scatter]))
        assert (found[2] == found[3] == 0) == bool(straight_up)
    own = np.hypot(*(points[:, :2] - [7.01, 9.0]).T) < 0.65
    (centre,), *_ = axes.circles(np.zeros(own.sum(), int), points[own, :2] - [7.01, 9.0], 1)
    (found,) = axes.fit_axes(thin, np.array([[7.01, 9.0]]), np.array([0.25]))
    if upright:
        assert found == pytest.approx([*centre + [7.01, 9.0], 0, 0, z[own].mean()])


def test_circles_stand_where_their_weighted_misfits_balance(rng):
    a = np.repeat([0, 2], [90, 60])
    off = np.vstack([ring(0.1, 90, (0.3, -0.2)), ring(0.3, 60, (-0.1, 0.2), end=4.0)])
    exact = axes.circles(a, off, 3, steps=60, hold=1e-9)
    assert exact[0][[0, 2]] == pytest.approx(np.array([[0.3, -0.2], [-0.1, 0.2]]), abs=1e-8)
    assert exact[1][[0, 2]] == pytest.approx([0.1, 0.3], abs=1e-8)
    assert exact[2][[0, 2]] == pytest.approx([0, 0], abs=1e-8)
    assert [part[1].tolist() for part in exact] == [[0, 0], 0.01, 0]  # without points
    off += 0.02 * rng.standard_t(3, (150, 2))
    centre, radius, rough = axes.circles(a, off, 3, steps=200, hold=1e-6)
    for k in (0, 2):
        spoke = off[a == k] - centre[k]
        away = np.hypot(*spoke.T)
        pull = (away - radius[k]) / (1 + ((away - radius[k]) / 0.03) ** 2) ** 2
        assert abs(pull.sum()) < 1e-7
        assert np.abs(spoke.T @ (pull / away)).max() < 1e-7
        assert rough[k] == pytest.approx(np.sqrt(np.mean((away - radius[k]) ** 2)))


def test_circles_begin_algebraically_and_take_damped_steps():
    alike = 0.2 + 0.02 * np.where(np.arange(80) % 2, 1, -1)
    off, a = ring(alike, 80, (0.3, 0.1)), np.zeros(80, int)
    centre, (start,), (rough,) = axes.circles(a, off, 1, steps=0)
    assert centre == pytest.approx(np.array([[0.3, 0.1]]))
    assert start == pytest.approx(np.sqrt(0.2**2 + 0.02**2))  # root mean square
    assert rough == pytest.approx(np.sqrt(np.mean((alike - start) ** 2)))
    weight = (1 + ((alike - start) / 0.03) ** 2) ** -2.0
    step = np.mean(weight * (alike - start)) / (np.mean(weight) + 0.02)
    assert axes.circles(a, off, 1, steps=1)[1] == pytest.approx([start + step])
    # an arc: the algebraic circle by least squares of its terms, a little damped
    arc = ring(0.3 + 0.01 * np.cos(np.arange(50)), 50, end=2.5)
    local = arc - arc.mean(axis=0)
    terms = np.vstack([np.column_stack([np.ones(50), local]), np.sqrt(50e-6) * np.eye(3)])
    _, *half = np.linalg.lstsq(terms, np.append((local**2).sum(axis=1), [0, 0, 0]))[0] / 2
    centre, (radius,), _ = axes.circles(np.zeros(50, int), arc, 1, steps=0)
    assert centre[0] == pytest.approx(arc.mean(axis=0) + half)
    assert radius == pytest.approx(np.sqrt((local**2).sum(axis=1).mean() + np.dot(half, half)))
    flat = ring(30.0, 50, end=0.01)  # nearly straight: no farther than the widest
    centre, *_ = axes.circles(np.zeros(50, int), flat, 1, steps=0)
    assert np.hypot(*(centre[0] - flat.mean(axis=0))) <= axes.WIDEST_M * (1 + 1e-9)
    _, (tiny,), (rough,) = axes.circles(np.zeros(9, int), np.zeros((9, 2)), 1)
    assert (tiny, rough**2) == pytest.approx((0.01, 1e-9))  # of one spot


def shifted(field, i, j):
    """A field moved by cells, with nothing behind its border."""
    return np.roll(field, (-i, -j), (0, 1))


def places_of(thin):
    """Candidates by their definition: cell, and whether of the widest scale."""
    low = np.floor(thin.points[:, :2] / 0.1).astype(int).min(axis=0) - 20
    x, y = (np.floor(thin.points[:, :2] / 0.1).astype(int) - low).T
    field = np.zeros((*(np.array([x.max(), y.max()]) + 21), 64), bool)
    field[x, y, np.floor(thin.height / 0.25).astype(int)] = True
    held, found = field.sum(axis=2).astype(float), set()
    square = lambda half: [(i, j) for i in range(-half, half + 1) for j in range(-half, half + 1)]  # noqa: E731
    for core, ring_of in ((1, 4), (2, 5), (4, 7), (1, 0)):
        clean = np.any([shifted(field, *at) for at in square(core)], axis=0)
        clean &= field.any(axis=2)[..., None] | (core == 4)
        for at in square(ring_of):
            if ring_of and max(map(abs, at)) >= ring_of - 1:
                clean &= ~shifted(field, *at)
        value = clean.sum(axis=2)
        if core == 4:
            weigh = [np.exp(-(i * i + j * j) / (2 * 3.5**2)) for i, j in square(7)]
            near = zip(weigh, square(7), strict=True)
            more = 80 * sum(w * shifted(held, *at) for w, at in near) / sum(weigh)
        else:
            more = 4 * held + sum(shifted(held, *at) for at in square(core))
        tall = np.where(value >= 3, value + more / (more + 50), 0)
        top = np.max([shifted(tall, *at) for at in square(max(core + 1, 3))], axis=0)
        tops = np.argwhere((tall > 0) & (tall >= top - 1e-6))
        found |= {(*map(int, cell + low), core == 4) for cell in tops}
    return found


def test_candidates_are_the_clean_columns_of_four_scales(rng, uncompiled):
    uncompiled(axes)
    parts = [ring(r, 60, at) for r, at in ((0.05, (0.5, 0.6)), (0.3, (1.9, 0.7)), (0.12, (0.8, 2)))]
    z = rng.uniform(0, 5, (3, 60))
    points = np.vstack([*(np.column_stack(part) for part in zip(parts, z, strict=True)),
                        rng.uniform([0, 0, 0], [2.6, 2.4, 6], (150, 3))])  # fmt: skip
    points[:, :2] += [-30.0, 12]
    thin = common.Thin(points, points[:, 2], points)
    xy, scatter = axes.candidates(thin)
    found = {(*np.floor(place / 0.1).astype(int).tolist(), bool(wide > 0.1))
             for place, wide in zip(xy, scatter, strict=True)}  # fmt: skip
    assert found == places_of(thin)
    assert set(scatter) == {0.06, 0.25}
    assert xy / 0.1 % 1 == pytest.approx(0.5)


def test_ground_is_the_third_lowest_point_of_cells_and_straight_between_them():
    i, j = (part.ravel() for part in np.mgrid[0:30, 0:25])
    plane = lambda x, y: 2 + 0.05 * x - 0.02 * y  # noqa: E731
    box = np.zeros(len(i))
    for (x, y, wide), rise in {(3, 3, 3): 0.45, (12, 3, 3): 0.7}.items():
        box[(abs(i - x) < wide) & (abs(j - y) < wide)] = rise
    third = plane(i + 0.5, j + 0.5) + box
    parts = [np.column_stack([i + 0.3, j + 0.4, third + off]) for off in (-0.2, -0.1, 0, 1)]
    ground = common.ground(np.vstack(parts) + [100, 200, 0])
    x, y = np.random.default_rng(1).uniform([18, 1], [29, 24], (50, 2)).T
    assert ground(np.column_stack([x + 100, y + 200])) == pytest.approx(plane(x, y), abs=1e-9)
    on = ground(np.array([[103.5, 203.5], [112.5, 203.5]])) - plane(np.array([3.5, 12.5]), 3.5)
    assert on[0] == pytest.approx(0.45)  # a kerb is ground, what stands higher is not
    assert abs(on[1]) < 0.15
    # of few points in a cell the highest of them
    assert common.ground(np.array([[0, 0, 5.0], [0, 0, 3.0]]))(np.zeros((1, 2))) == [5.0]


@pytest.mark.parametrize(("rise", "left"), [(2.4, True), (2.6, False)])
def test_a_roof_is_ground_up_to_its_limit(rise, left):
    i, j = (part.ravel() for part in np.mgrid[0:40, 0:40])
    roof = (i >= 24) * rise  # wider than the opening's window
    ground = common.ground(np.column_stack([i + 0.5, j + 0.5, roof]))
    assert ground(np.array([[25.5, 20.5]]))[0] == (rise if left else 0)


def test_gaps_of_cells_are_cut_to_twice_the_window_of_a_roof():
    at = common._squeezed(np.array([7.0, 3, 4, 3, 29, 130]))
    assert at(np.array([3, 4, 5.5, 7, 18, 29, 130, 79.5])) == pytest.approx(
        [0, 1, 2.5, 4, 15, 26, 52, 39]
    )


@pytest.mark.parametrize("place", common.PLACES)
def test_thinned_points_are_means_of_turned_and_moved_voxels(place, rng):
    points = rng.uniform([10, 20, 1], [10.4, 20.4, 2], (2500, 3))
    turn = np.radians(place[3])
    x = points[:, 0] * np.cos(turn) - points[:, 1] * np.sin(turn)
    y = points[:, 0] * np.sin(turn) + points[:, 1] * np.cos(turn)
    voxel = np.floor(np.column_stack([x, y, points[:, 2]]) / 0.04 + place[:3])
    means = pd.DataFrame(points).groupby([*voxel.T]).mean().to_numpy()
    thin = common.thinned(points, lambda xy: 0.5 + 0 * xy[:, 0], place)
    assert np.sort(thin.points, axis=0) == pytest.approx(np.sort(means, axis=0))
    assert thin.height == pytest.approx(thin.points[:, 2] - 0.5)
    high = common.thinned(points, lambda xy: -18 + 0 * xy[:, 0], place).height
    assert high.max() < 16 == pytest.approx(high.min())  # in the last of 64 bins


def test_stripes_have_all_places_once_and_what_lies_within_six_metres(rng, monkeypatch):
    monkeypatch.setattr(common, "STRIPE", 7)
    points, xy = rng.uniform(-50, 50, (300, 3)), rng.uniform(-50, 50, (30, 2))
    thin = common.Thin(points, points[:, 2], points[::2])
    rows, parts = zip(*common.stripes(thin, xy), strict=True)
    assert sorted(np.concatenate(rows)) == [*range(30)]
    assert [len(one) for one in rows] == [7, 7, 7, 7, 2]
    for own, part in zip(rows, parts, strict=True):
        low, high = xy[own, 1].min() - 6, xy[own, 1].max() + 6
        for got, given in ((part.points, points), (part.coarse, points[::2])):
            near = given[(given[:, 1] > low) & (given[:, 1] < high)]
            assert np.array_equal(np.sort(got[:, 1]), np.sort(near[:, 1]))
        assert np.array_equal(part.height, part.points[:, 2])


def test_drop_duplicates_keeps_the_best_of_those_nearby(rng):
    xy, score = rng.uniform(0, 3, (60, 2)), rng.permutation(60) / 60
    reason = np.where(rng.random(60) < 0.2, "length", "").astype(object)
    expected = reason.copy()
    for k in np.argsort(-score):
        if expected[k] == "":
            for other in range(60):
                near = np.hypot(*(xy[k] - xy[other])) <= 0.4
                if other != k and near and expected[other] == "":
                    expected[other] = "duplicate"
    common.drop_duplicates(xy, score, reason, 0.4)
    assert reason.tolist() == expected.tolist()
    assert 3 < (reason == "duplicate").sum() < 40


def test_a_table_of_poles_has_their_tilt_from_south_to_north():
    rows = {"x_m": [1.0, 2, 0], "y_m": [5.0, 5, 3], "z_base_m": 0.0, "height_m": 2.0,
            "diameter_m": 0.1, "lean_x": [0.3, 0, 0], "lean_y": [0.4, 0, 1.0], "score": 0.5,
            "rejected_by": ["", "length", ""]}  # fmt: skip
    found = common.table(rows, "itc")
    assert found["x_m"].tolist() == [0, 1]
    assert found["tilt_deg"].tolist() == pytest.approx([45, np.degrees(np.arctan(0.5))])
    assert "rejected_by" not in found
    every = common.table(rows, "itc", explain=True)
    assert every["rejected_by"].tolist() == ["", "", "length"]
    assert set(every["method"]) == {"itc"}


def test_the_middle_of_a_candidate_is_that_of_its_circle_where_it_is_one():
    places = np.tile([5.0, 7, 0.1, -0.2, 1.0], (4, 1))
    given = described(None, 0.1, 1.0, 4.0, places)
    given.measures["arc"] = [0.5, 0.2, 0.5, 0.21]
    given.shaft["centre"] = np.array([[0.06, -0.08], [0.06, -0.08], [0.09, 0.1], [0.1, 0.08]])
    straight = np.array([5 + 0.15, 7 - 0.3])  # 1.5 m above the axis' place
    shift = np.array([[0.06, -0.08], [0, 0], [0, 0], [0.1, 0.08]])  # 0.1 radius: up to 0.13
    assert given.middle == pytest.approx(straight + shift)


def test_own_frame_turns_and_moves_with_its_points(rng):
    long = rng.uniform(-1, 1, (4000, 1)) ** 2 * 40 * [1, 0, 0]
    points = long + rng.normal(0, [2, 2, 0.5], (4000, 3))
    origin, frame = learned.own_frame(points)
    plan = points[:, :2] - points[:, :2].mean(axis=0)
    along = np.linalg.eigh(plan.T @ plan)[1][:, 1]
    assert abs(frame[:2, 1] @ along) > 0.99
    assert frame.T @ frame == pytest.approx(np.eye(3))
    assert np.linalg.det(frame) == pytest.approx(1)
    assert origin[2] == points[:, 2].min() - learned.BELOW_M
    turn, step = np.radians(130), np.array([300.0, -700, 0])
    spin = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    there = learned.own_frame(points @ spin.T + step)
    assert there[0] == pytest.approx(spin @ origin + step, abs=1e-6)
    assert there[1] == pytest.approx(spin @ frame, abs=1e-6)
