"""Steps of finding and aligning a chart: streaks, groups of targets, maps, local light, shifts."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from mmqa_lab import charts
from mmqa_lab.chart_image import ChartMap, PanoramaCamera, alignment, finding, maps
from mmqa_lab.charts import Bar, Layout, LinePairs, Marker

CHART = charts.imaging_chart()
MATRIX = np.array([[0.31, 0.02, 40.0], [0.01, -0.29, 330.0], [0, 0, 1]])


def corners_of(chart_map):
    return chart_map.pixels(CHART.corners())


def bar_ends(bar, chart_map):
    """Ends of a bar's middle line in an image."""
    x, y, w, h = bar.x, bar.y, bar.width, bar.height
    ends = [(x + w / 2, y), (x + w / 2, y + h)] if h > w else [(x, y + h / 2), (x + w, y + h / 2)]
    return chart_map.pixels(ends)


def test_two_streaks_that_are_bars_suggest_the_map_that_puts_them_there(rng):
    bars = [CHART[name] for name in ("bar_left", "bar_right", "bar_horizontal")]
    truth = ChartMap(MATRIX)
    for bar in bars:
        ends = finding._axis(bar)
        assert truth.pixels(ends) == pytest.approx(bar_ends(bar, truth))
    streaks = np.array([bar_ends(bar, truth)[:: rng.choice([-1, 1])] for bar in bars])
    clutter = rng.uniform(0, 40, (3, 2, 2)) + [900, 20]
    for some in ([0, 1], [0, 2], [1, 2]):
        given = np.concatenate([streaks[some], clutter])
        found = [corners_of(one) for one in finding._suggested(given, bars)]
        off = [np.abs(one - corners_of(truth)).max() for one in found]
        assert min(off) < 1e-6
    mirrored = streaks * [-1, 1] + [400, 0]
    for one in finding._suggested(mirrored, bars):
        assert np.linalg.det(one.matrix) < 0  # rows count downwards
    assert not list(finding._suggested(streaks[:1], bars))
    assert not list(finding._suggested(np.stack([streaks[0], streaks[0]]), bars[:2]))


STREAKS = np.array([[[0.0, 0], [0, -80]], [[60.0, 0], [60, -80]]])
TWO = [Bar("a", 0, 0, 10, 800), Bar("b", 600, 0, 10, 800)]


def suggestions(streaks):
    return len(list(finding._suggested(np.array(streaks, float), TWO)))


def test_streaks_suggest_bars_up_to_their_misfit_their_distance_and_their_shape():
    assert suggestions(STREAKS) > 0
    # one end off along the streak: a quarter of that is left at each of four ends
    for sigmas, some in ((0.98, True), (1.02, False)):
        low, high = 0.0, 60.0
        for _ in range(50):  # until the misfit is .06 of the bars' reach, in pixels
            off = (low + high) / 2
            moved = STREAKS.copy()
            moved[1, 1, 1] -= off
            design = np.column_stack([[5, 5, 605, 605], [0, 800, 0, 800], np.ones(4)])
            ends = moved.reshape(4, 2)
            affine = np.linalg.lstsq(design, ends, rcond=None)[0]
            misfit = np.sqrt(((design @ affine - ends) ** 2).mean())
            size = np.linalg.svd(affine[:2], compute_uv=False)[1]
            low, high = (off, high) if misfit < sigmas * 0.06 * 800 * size else (low, off)
        assert (suggestions(moved) > 0) == some
    for factor, some in ((1.99, True), (2.01, False)):  # farther apart than twice as long
        apart = STREAKS * [[[1, 1]], [[80 * factor / 60, 1]]]
        assert (suggestions(apart) > 0) == some
    for factor, some in ((0.36, True), (0.34, False)):  # squeezed along one axis
        assert (suggestions(STREAKS * [factor * 80 / 60 * 600 / 800, 1.0]) > 0) == some
    longer = STREAKS.copy()
    longer[1] = [[60, 40], [60, -120]]  # twice as long is allowed for, but does not fit
    assert suggestions(longer) == 0


def test_streaks_are_the_long_dark_things_the_longest_first():
    image = np.full((300, 400), 200, np.uint8)
    image[40:46, 100:300] = 60  # 200 x 6
    image[60:180, 30:38] = 140  # 120 x 8, less than 72 % of 200
    image[200:300, 350:358] = 146  # too bright
    cv2.line(image, (120, 120), (220, 220), 50, 7)
    image[250:256, 20:40] = 50  # too short
    image[100:120, 250:330] = 60  # too wide for a streak
    found = finding._streaks(image)
    length = np.linalg.norm(found[:, 0] - found[:, 1], axis=1)
    assert len(found) == 3
    assert length == pytest.approx([199, 148, 119], abs=3)
    ends = np.sort(found[0], axis=0)
    assert ends == pytest.approx(np.array([[100, 42.5], [299, 42.5]]), abs=0.6)
    assert np.sort(found[1], axis=0) == pytest.approx(
        np.array([[118.5, 118.5], [221.5, 221.5]]), abs=3
    )
    assert np.sort(found[2], axis=0) == pytest.approx(np.array([[33.5, 60], [33.5, 179]]), abs=0.6)
    for long, some in ((41, 0), (42, 1)):  # six times as long as wide, which counts a pixel more
        plain = np.full((80, 120), 200, np.uint8)
        plain[30:37, 20 : 20 + long + 1] = 60
        assert len(finding._streaks(plain)) == some


def targets_of(chart_map, names=("marker_0", "marker_1", "marker_2", "marker_3")):
    """Numbers and corners of coded targets as they are found."""
    found = []
    for name in names:
        marker = CHART[name]
        found.append(
            ((marker.dictionary, marker.identifier), chart_map.pixels(marker.corners()[::-1]))
        )
    return found


def test_targets_of_two_charts_are_told_apart_and_the_larger_one_comes_first():
    markers = finding._markers(CHART)
    assert len(markers) == 4
    near = ChartMap(MATRIX)
    far = ChartMap(np.array([[0.11, 0, 500.0], [0, -0.11, 300], [0, 0, 1]]))
    seen = targets_of(near, ("marker_0", "marker_2", "marker_3")) + targets_of(far)
    groups = finding.by_chart(seen[::-1], markers, CHART)
    assert [len(group) for group in groups] == [3, 4]
    assert dict(groups[0]).keys() == dict(seen[:3]).keys()
    # two targets of a near chart come behind three of a far one
    groups = finding.by_chart(targets_of(near)[:2] + targets_of(far), markers, CHART)
    assert [len(group) for group in groups] == [4, 2]
    twice = finding.by_chart(targets_of(near) + targets_of(near)[:1], markers, CHART)
    assert [len(group) for group in twice] == [4, 1]
    diagonal = np.linalg.norm(np.subtract(*corners_of(near)[[1, 3]]))
    for share, together in ((0.99, True), (1.01, False)):  # of a third of it between the middles
        aside = [
            (key, corners + [share * diagonal / 3, 0]) for key, corners in targets_of(near)[1:2]
        ]
        groups = finding.by_chart(targets_of(near)[:1] + aside, markers, CHART)
        assert (len(groups) == 1) == together


def test_three_targets_give_the_map_and_other_charts_are_counted(monkeypatch):
    markers, truth, grey = finding._markers(CHART), ChartMap(MATRIX), np.zeros((9, 9), np.uint8)
    far = ChartMap(np.array([[0.11, 0, 500.0], [0, -0.11, 300], [0, 0, 1]]))
    monkeypatch.setattr(finding, "_other", lambda *_: None)
    known = {"camera": None, "offset": (0.0, 0.0)}

    def found(seen):
        return finding._by_targets(grey, CHART, seen, markers, known)

    three = found(targets_of(truth)[:3])
    assert corners_of(three) == pytest.approx(corners_of(truth), abs=1e-3)
    assert (three.source, three.charts) == ("3 coded targets", 1)
    both = found(targets_of(far) + targets_of(truth))
    assert corners_of(both) == pytest.approx(corners_of(truth), abs=1e-3)
    assert both.charts == 2
    assert found(targets_of(truth) + targets_of(far)[:1]).charts == 1  # one target is no chart
    assert found([]) is None
    more = replace(far, charts=3)
    monkeypatch.setattr(finding, "_other", lambda *_: more)
    assert found(targets_of(truth)).charts == 4
    assert corners_of(found(targets_of(truth))) == pytest.approx(corners_of(truth), abs=1e-3)
    larger = ChartMap(2 * np.diag([1, 1, 0.5]) @ MATRIX)
    monkeypatch.setattr(finding, "_other", lambda *_: larger)
    assert found(targets_of(truth)).source == finding.LONG_BARS
    one = [targets_of(truth)[0]]
    monkeypatch.setattr(finding, "_near", lambda *_: [far, truth, larger])
    good = {id(far): (0.7, far), id(truth): (0.9, truth), id(larger): None}
    monkeypatch.setattr(finding, "confirmed", lambda _, __, chart, least: good[id(chart)])
    assert corners_of(found(one)) == pytest.approx(corners_of(truth), abs=1e-3)
    assert found(one).source == "1 coded targets"
    monkeypatch.setattr(finding, "confirmed", lambda *_: None)
    assert found(one) is None
    # a lens moves the targets of one chart apart: all different, more than two
    bent = targets_of(truth)[:3]
    bent[1] = bent[1][0], bent[1][1] + [130, 0]
    monkeypatch.setattr(finding, "_other", lambda *_: None)
    assert found(bent).source == "3 coded targets"


def test_maps_near_that_of_one_target_are_turned_and_stretched(monkeypatch):
    truth = ChartMap(np.array([[0.3, 0.02, 40.0], [0.02, -0.3, 330.0], [0, 0, 1]]))
    asked = []

    def level(_, __, chart_map, cells):
        asked.append((chart_map, cells))
        return SimpleNamespace(correlation=lambda one: -np.abs(corners_of(one) - aim).max())

    monkeypatch.setattr(finding, "Level", level)
    (_, seen), places = targets_of(truth)[0], CHART["marker_0"].corners()[::-1]
    middle = seen.mean(axis=0) @ [1, 1j]
    for steps, turn in ((0, 0), (4, -3), (-4, 4)):  # of 1.5 % and of .015 radians
        change = np.exp(0.015 * (steps + 1j * turn))
        moved = middle + change * (corners_of(truth) @ [1, 1j] - middle)
        aim = np.column_stack([moved.real, moved.imag])
        found = finding._near(None, CHART, places, seen)
        assert len(found) == 3
        assert corners_of(found[0]) == pytest.approx(aim, abs=1e-3)
    assert corners_of(asked[0][0]) == pytest.approx(corners_of(truth), abs=1e-3)
    assert asked[0][1] == 60


def test_a_glance_is_highest_where_the_chart_lies():
    image = np.pad(np.uint8(30 + 200 * charts.reflectance(CHART, cell=4)[::-1]), 40)
    truth = ChartMap(np.array([[0.25, 0, 39.5], [0, -0.25, 289.5], [0, 0, 1]]))
    shifts = [(0, 0), (6, 0), (0, -6), (14, 9)]
    some = [ChartMap(truth.matrix + [[0, 0, x], [0, 0, y], [0, 0, 0]]) for x, y in shifts]
    scores = [score for score, _ in finding._glanced(image, CHART, some)]
    assert scores[0] > 0.8
    assert scores[0] > scores[1] > scores[3]
    assert scores[0] > scores[2] > scores[3]
    assert abs(scores[3]) < 0.45
    dim = np.uint8(image * np.linspace(0.4, 1, 330))  # light that changes does not count
    ((score, there),) = finding._glanced(dim, CHART, some[:1])
    assert score == pytest.approx(scores[0], abs=0.03)
    assert there is some[0]
    ((negative, _),) = finding._glanced(255 - image, CHART, some[:1])
    assert negative == pytest.approx(-scores[0], abs=0.02)


def test_grey_values_are_stretched_between_their_outer_half_per_cent(rng):
    plain = rng.uniform(0, 1, (200, 300))
    for image in (plain * 40 + 100, (plain * 40 + 100).astype(np.float32), np.uint16(plain * 4000)):
        found = finding._stretched(image)
        low, high = np.percentile(image, [0.5, 99.5])
        expected = np.clip((image - low) / (high - low), 0, 1) * 255
        assert np.abs(found - expected).max() < 1.6
        assert found.dtype == np.uint8
    large = np.zeros((1800, 2000), np.uint8)  # every third pixel is looked at
    large[::2, ::2] = 7
    large[1::2] = 9
    assert finding._stretched(np.full((9, 9), 5, np.uint8)).max() == 0
    assert finding._shrunk(np.broadcast_to(np.uint8(0), (10_000, 10_000))) == pytest.approx(0.5)
    assert finding._shrunk(np.zeros((9, 9))) == 1


def test_another_chart_is_looked_for_beside_the_known_one(monkeypatch):
    asked = []
    monkeypatch.setattr(finding, "by_bars", lambda *given: asked.append(given))
    image = np.arange(3000 * 4000, dtype=np.uint32).reshape(3000, 4000) % 251
    finding._other(np.uint8(image), ChartMap(MATRIX), CHART)
    painted, _, factor = asked[0]
    assert factor == pytest.approx(np.sqrt(6e6 / 12e6))
    inside = ChartMap(MATRIX).pixels([[500, 500], [10, 990]]).round().astype(int)
    assert [painted[row, column] for column, row in inside] == pytest.approx([125, 125], abs=1)
    assert painted[2000, 3000] == image[2000, 3000]


def test_confirmed_needs_its_place_its_print_and_its_size(monkeypatch):
    results = {"correlation": 0.9, "other": 0.5}

    def level(_, __, chart_map, along):
        return SimpleNamespace(aligned=lambda one: (one, results["correlation"]),
                               correlation=lambda one: results["other"])  # fmt: skip

    monkeypatch.setattr(finding, "Level", level)
    grey, inside = np.zeros((400, 500)), ChartMap(MATRIX)

    def good(chart_map=inside, **known):
        results.update({"correlation": 0.9, "other": 0.5} | known)
        return finding.confirmed(grey, CHART, chart_map)

    assert good() == (0.9, inside)
    assert good(correlation=0.651) is not None
    assert good(correlation=0.649) is None
    assert good(other=0.99) is not None
    assert good(other=1.01) is None  # its mirror image correlates better
    for size, seen in ((51.0, True), (49.0, False)):
        small = ChartMap(np.array([[size / 1000, 0, 40], [0, -size / 1000, 330], [0, 0, 1]]))
        assert (good(small) is not None) == seen
    square = ChartMap(np.array([[0.1, 0, 0.0], [0, -0.1, 100.0], [0, 0, 1]]))
    for x, y, seen in ((-1.9, 0, 1), (-2.1, 0, 0), (0, -1.9, 1), (0, -2.1, 0), (400.9, 0, 1),
                       (401.1, 0, 0), (0, 300.9, 1), (0, 301.1, 0)):  # fmt: skip
        moved = ChartMap(square.matrix + [[0, 0, x], [0, 0, y], [0, 0, 0]])
        assert (good(moved) is not None) == bool(seen)


def test_maps_of_a_chart_keep_its_sides_and_turn_up_to_down(rng):
    truth = ChartMap(np.array([[0.31, 0.02, 40], [0.01, -0.29, 330], [2e-5, -1e-5, 1.0]]))
    flipped = maps.mirrored(truth, CHART)
    xy = rng.uniform(0, 1000, (9, 2))
    assert flipped.pixels(xy) == pytest.approx(truth.pixels([1000, 0] + xy * [-1, 1]))
    assert maps.unit([[0, 500], [1000, 250], [9000, -9000]], (1000, 500)) == pytest.approx(
        np.array([[-1, 1, 1.5], [1, 0, -1.5]])
    )
    terms = np.zeros((4, 4, 2))
    terms[3, 0], terms[0, 1] = (4.0, 0), (0, 3.0)
    bent = replace(truth, bend=maps.Bend((1000.0, 1000.0), terms), charts=2, offset=(5.0, 6.0))
    flat = maps.plain(bent, CHART, source="mine")
    assert (flat.source, flat.charts, flat.bend, flat.offset) == ("mine", 2, None, (5.0, 6.0))
    mesh = np.array([(x, y) for x in np.linspace(0, 1000, 5) for y in np.linspace(0, 1000, 5)])
    off = flat.pixels(mesh) - bent.pixels(mesh)
    other = [
        ChartMap(flat.matrix + d, offset=(5.0, 6.0)).pixels(mesh) - bent.pixels(mesh)
        for d in (0.003 * np.outer([1, 0, 0], [0, 0, 1]), 1e-5 * np.outer([0, 1, 0], [1, 0, 0]))
    ]
    assert all((off**2).sum() <= (one**2).sum() + 1e-6 for one in other)  # of least squares
    assert maps.side(truth, CHART) == pytest.approx(np.ptp(corners_of(truth), axis=0).max())
    homography = truth.matrix
    assert maps._same_orientation(homography, xy)
    assert maps._same_orientation(-homography, xy)
    assert not maps._same_orientation(flipped.matrix, xy)
    behind = homography - [[0, 0, 0], [0, 0, 0], [0, 0, 1.008]]  # some before, some behind
    assert not maps._same_orientation(behind, np.array([[0, 0], [1000, 0.0]]))
    assert maps._projected(homography, np.empty((0, 2))).shape == (0, 2)
    assert PanoramaCamera(8000).pixel_size_mm(4.0) == pytest.approx(4000 * 2 * np.pi / 8000)


def test_local_light_is_taken_out_by_means_and_spreads(rng):
    tones = np.float32(gaussian_filter(rng.random((80, 90)), 1.0))
    alike = np.ones_like(tones)
    local = alignment._around(tones, alike)
    inner = slice(20, -20), slice(20, -20)
    # 6 hundredths of 90 cells
    assert local[inner] == pytest.approx(gaussian_filter(tones, 5.4)[inner], abs=2e-4)
    found = alignment._standardised(tones, alike)
    off = tones - gaussian_filter(tones, 5.4, mode="mirror")
    spread = np.sqrt(gaussian_filter(off**2, 5.4, mode="mirror"))
    assert found[inner] == pytest.approx((off / spread)[inner], abs=0.05)
    faint = np.float32(np.where(np.arange(90) < 45, 1.0, 0.001) * rng.standard_normal((80, 90)))
    assert np.abs(alignment._standardised(faint, alike)[:, 85:]).max() < 0.1
    wide = np.float32(np.tile(np.sin(np.arange(400) / 30), (300, 1)))
    small = cv2.resize(cv2.resize(wide, (100, 100), interpolation=cv2.INTER_AREA), (400, 300))
    reach = gaussian_filter(np.float64(small), (18, 24))
    local = alignment._around(wide, np.ones_like(wide))
    assert local[150, 100:300] == pytest.approx(reach[150, 100:300], abs=0.02)
    # what hardly counts is hardly seen, in means and spreads
    other, counts = tones.copy(), alike.copy()
    other[:, :30], counts[:, :30] = 2.0, 1e-6
    local, spread = alignment._local(other, counts)
    assert local[20:-20, 35:70] == pytest.approx(tones[:, 30:].mean(), abs=0.05)
    assert 0 < spread[inner].max() < 0.3
    one, two = rng.normal(0, 2.5, (2, 40, 40))
    two += one
    trusted = rng.random((40, 40)) < 0.6
    a, b = (part[trusted].clip(-3, 3) for part in (one, two))
    expected = (a * b).sum() / np.sqrt((a**2).sum() * (b**2).sum())
    assert alignment._correlation(one, two, trusted) == pytest.approx(expected)
    assert alignment._correlation(one, 0 * two, trusted) == 0


def test_cells_of_pairs_finer_than_two_and_a_half_pixels_are_not_trusted():
    pairs = LinePairs("fine", 100, 50, 9.9, "h", repeats=4, length=60)
    layout = Layout("two", 300, 200, (pairs, LinePairs("coarse", 200, 50, 10.1, "h", 4, 60)))
    found = alignment._trusted(layout, 4.0, 5.0, (40, 60))
    expected = np.ones((40, 60))
    # from 100 to 139.6 mm and 50 to 110 mm, two cells of 5 mm more
    expected[8:24, 18:30] = 0
    assert np.array_equal(found, expected)


def test_a_level_has_its_cells_their_places_and_a_window_with_a_margin():
    layout = Layout("bar", 400, 200, (Bar("a", 20, 10, 100, 50),))
    view = ChartMap(np.array([[0.5, 0, 100.3], [0, -0.5, 190.6], [0, 0, 1.0]]))
    image = np.random.default_rng(0).random((260, 400)).astype(np.float32)
    level = alignment.Level(image, layout, view, 50)
    assert (level.cell, level.pixel_mm) == (8.0, pytest.approx(2.0))
    assert level.size == (400, 200)
    assert level.places[[0, 1, -1]] == pytest.approx(np.array([[4, 4], [12, 4], [396, 196]]))
    soft = 8 / 2 / 2.5
    first = np.floor([100.3 - 3 * soft - 20 - 2, 90.6 - 3 * soft - 10 - 2])
    last = np.floor([300.3 + 3 * soft + 20 + 2, 190.6 + 3 * soft + 10 + 2])
    assert level.first.tolist() == first.tolist()
    assert level.image.shape == tuple((last - first)[::-1])
    assert level.last.tolist() == [399, 259]
    window = image[int(first[1]) : int(last[1]), int(first[0]) : int(last[0])]
    smooth = gaussian_filter(window, soft, truncate=5)
    assert level.image[9:-9, 9:-9] == pytest.approx(smooth[9:-9, 9:-9], abs=3e-3)
    assert alignment.Level(image, layout, view, 400).image == pytest.approx(
        cv2.GaussianBlur(image[77:203, 77:323], (0, 0), 0.3), abs=1e-6
    )
    blur = np.hypot(1.2 * 2 / 8, 0.5)
    assert level.behind(1.2).rim == int(np.ceil(2 * blur))
    seen, trusted = level.seen(view)
    assert seen.shape == trusted.shape == (25, 50)
    rim = level.rim
    assert trusted[rim:-rim, rim:-rim].all()
    assert trusted.sum() == (25 - 2 * rim) * (50 - 2 * rim)
    moved = level.seen(ChartMap(view.matrix + [[0, 0, 250], [0, 0, 0], [0, 0, 0]]))[1]
    # up to column 399, 48.7 px from the chart's left side
    assert moved.any(axis=0).sum() == int((399 - 350.3) / 4 + 0.5) - rim
    sharp = alignment.Level(image, layout, view, 50).behind(3.2)
    assert sharp.rim == int(np.ceil(2 * np.hypot(0.8, 0.5)))


def test_shifts_between_print_and_photograph_are_those_of_its_blocks(rng):
    size, blocks = 200, 20
    y, x = np.mgrid[:size, :size].astype(float)
    # half of it rises to the right and half downwards, so that each block asks for one direction
    right = (x // 10 + y // 10) % 2 == 0
    seen = 0.1 * np.where(right, x % 10, y % 10)
    down, across = np.gradient(seen)
    checks = 0.02 * (-1) ** (x + y)
    printed = seen + 0.3 * across - 0.2 * down + checks
    design = np.ones((blocks**2, 1))
    change, gain = alignment._shifts(printed, seen, np.ones((size, size)), design)
    assert change == pytest.approx(np.array([[0.3, -0.2]]), abs=0.03)
    before = ((printed - seen) ** 2).reshape(20, 10, 20, 10).mean(axis=(1, 3)).ravel()
    left = (printed - seen - change[0, 0] * across - change[0, 1] * down) ** 2
    left = left.reshape(20, 10, 20, 10).mean(axis=(1, 3)).ravel()
    weight = 1 / (1 + (left / (2 * np.median(left))) ** 2)
    expected = (weight @ (before - left) / 2) / (weight @ left / (2 * blocks**2))
    assert gain == pytest.approx(expected, rel=1e-3)
    half = np.where(x < 100, 1.0, 0.0)  # what is not trusted does not ask
    odd = np.where(x < 100, printed, seen - 0.5 * across)
    change, _ = alignment._shifts(odd, seen, half, design)
    assert change == pytest.approx(np.array([[0.3, -0.2]]), abs=0.03)
    few = np.where((x < 40) & (y < 100), printed + 0.6 * across, printed)  # a tenth disagrees
    change, _ = alignment._shifts(few, seen, np.ones((size, size)), design)
    assert change == pytest.approx(np.array([[0.3, -0.2]]), abs=0.06)
    noise = alignment._shifts(seen + rng.normal(0, 0.1, seen.shape), seen, 1.0 + 0 * x, design)
    assert noise[1] < 10
    wild = alignment._shifts(seen + 50 * checks / 0.02, seen, 1.0 + 0 * x, design)[0]
    assert np.abs(wild).max() < 3.5  # cut to three spreads


def test_a_bend_counts_where_a_homography_leaves_more_than_four_tenths_of_a_pixel():
    base = ChartMap(np.array([[0.25, 0, 39.5], [0, -0.25, 289.5], [0, 0, 1]]))
    for size, stays in ((1.0, False), (9.0, True)):
        terms = np.zeros((4, 4, 2))
        terms[0, 2] = (size, 0.0)
        bent = replace(base, bend=maps.Bend((1000.0, 1000.0), terms))
        flat = maps.plain(bent, CHART)
        leaves = np.abs(flat.outline(CHART.corners()) - bent.outline(CHART.corners())).max()
        assert (leaves > 0.4) == stays
        assert (alignment.straight(bent, CHART).bend is not None) == stays
    assert isinstance(CHART["marker_0"], Marker)
