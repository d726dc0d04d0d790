"""Steps of reading line pairs, bars and tones: loops over pixels and closed forms."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.ndimage import distance_transform_edt

from mmqa_lab import charts
from mmqa_lab.chart_image import ChartMap, chart_site, line_pairs, tones
from mmqa_lab.chart_image.quality import ImageQuality, _window
from mmqa_lab.chart_image.site import _view
from mmqa_lab.chart_image.tones import Tones
from mmqa_lab.charts import Bar, Layout, LinePairs

PAIRS = LinePairs("p", 30.0, 20.0, 10.0, "h", repeats=4, length=60.0)


def flat_map(scale=0.5, place=(5.0, 90.0)):
    """Pixels per mm straight on, and the pixel of the chart's lower left corner."""
    return ChartMap(np.array([[scale, 0, place[0]], [0, -scale, place[1]], [0, 0, 1.0]]))


def test_gaps_are_weighted_means_of_bars_and_what_stands_out_between_them(rng):
    n = 900
    across, along = rng.uniform(-2, 42, n), rng.uniform(3, 57, n)
    values, noise = rng.random(n), 0.03
    gaps, limits, contrast, tone = line_pairs._gaps(across, along, values, PAIRS, 3, noise)
    strip = ((along - along.min()) / np.ptp(along) * 3).astype(int)
    strip[along.argmax()] = 2
    mean, variance = np.empty((3, 7)), np.empty((3, 7))
    for s in range(3):
        for bar in range(7):
            off = across / 5 - 0.5 - bar  # in bars from the middle of this one
            own = (strip == s) & (np.abs(off) < 0.5)
            weight = 1 + np.cos(2 * np.pi * off[own])
            mean[s, bar] = np.average(values[own], weights=weight)
            variance[s, bar] = noise**2 * (weight**2).sum() / weight.sum() ** 2
    for s in range(3):
        for gap in range(3):
            black = mean[s, [2 * gap, 2 * gap + 2]]
            white = mean[s, 2 * gap + 1]
            assert gaps[s, gap] == pytest.approx(white - black.max())
            worst = max(variance[s, 2 * gap], variance[s, 2 * gap + 2])
            expected = max(0.1, 3 * np.sqrt(variance[s, 2 * gap + 1] + worst))
            assert limits[s, gap] == pytest.approx(expected)
            assert tone[s, gap] == pytest.approx((2 * white + black.sum()) / 4)
    assert contrast == pytest.approx(mean[:, 1::2].mean() - mean[:, ::2].mean())
    few = (across > 5) & (across < 15)  # no bar is seen, or not all
    gaps, limits, _, _ = line_pairs._gaps(across[few], along[few], values[few], PAIRS, 1, noise)
    assert (gaps[0, 1:] == -np.inf).all()
    assert (limits[0, 1:] == np.inf).all()
    none = line_pairs._gaps(
        across[across < 0], along[across < 0], values[across < 0], PAIRS, 1, 0.1
    )
    assert np.isnan(none[2])
    loud = line_pairs._gaps(across, along, values, PAIRS, 3, 10 * noise)[1]
    assert loud.max() > 0.1


@pytest.mark.parametrize("phase", [0.0, 30.0, -100.0, 180.0])
def test_wave_has_the_modulation_phase_and_bars_of_what_is_seen(phase, rng):
    across = rng.uniform(0, 40, 4000)
    turns = 2 * np.pi * (across / 10 - 0.25) - np.radians(phase)
    values = 0.6 + 0.004 * across - 0.2 * np.cos(turns)
    modulation, found, bars = line_pairs._wave(across, values, PAIRS, 8.0)
    # black first: the printed wave's first harmonic is -2 / pi
    assert modulation == pytest.approx(0.2 * np.cos(np.radians(phase)) * np.pi / 2, abs=2e-3)
    assert (found - phase + 180) % 360 == pytest.approx(180, abs=0.6)
    assert bars == pytest.approx(4, abs=0.05)
    for rate, width, expected in (
        (0.5, 8.0, 2.0),
        (1.7, 8.0, 6.8),
        (2.4, 8.0, 9.6),
        (1.4, 3.0, 5.6),
    ):
        other = 0.5 + 0.2 * np.cos(2 * np.pi * rate * across / 10 + 1)
        assert line_pairs._wave(across, other, PAIRS, width)[2] == pytest.approx(expected, abs=0.07)
    fine = line_pairs._wave(across, other, PAIRS, 2.4)[2]  # up to the Nyquist frequency
    assert fine < 0.499 * 2.4 * 4 + 0.05


READ = {"width_px": 6.0, "length_px": 30.0, "phase": 0.0, "bars": 4.0, "n": 500, "short": 0}


@pytest.mark.parametrize(
    ("known", "fine", "wrong", "reason"),
    [
        ("width_px", 2.301, 2.299, "beats with the pixels"),
        ("width_px", 2.301, 1.999, "below the Nyquist width"),
        ("bars", 4.59, 4.61, "wrong number of bars"),
        ("bars", 3.41, 3.39, "wrong number of bars"),
        ("phase", 49.9, 50.1, "bars not where they are printed"),
        ("phase", -49.9, -50.1, "bars not where they are printed"),
        ("short", 2, 3, "gaps do not stand out"),
        ("n", 16, 15, "too few pixels"),
    ],
)
def test_read_pattern_refuses_beyond_its_bounds(known, fine, wrong, reason, monkeypatch):
    for value, said in ((fine, ""), (wrong, reason)):
        given = READ | {known: value}
        n = given["n"]
        seen = np.zeros(n), np.linspace(0, 60, n), np.ones(n), given["width_px"], 20.0
        gaps = np.where(np.arange(8)[:, None] < given["short"], 0.05, [0.3, 0.1, 0.4])
        monkeypatch.setattr(line_pairs, "_pixels", lambda *_, seen=seen: seen)
        wave = 0.7, given["phase"], given["bars"]
        monkeypatch.setattr(line_pairs, "_wave", lambda *_, wave=wave: wave)
        result = gaps, 0.1 + 0 * gaps, 0.5, np.array([[0.4, np.nan, 0.6]])
        monkeypatch.setattr(line_pairs, "_gaps", lambda *_, result=result: result)
        found = line_pairs.read_pattern(SimpleNamespace(noise=0.01), PAIRS, None)
        assert (found.reason, found.resolved) == (said, not said)
        assert (found.name, found.direction, found.width_mm) == ("p", "h", 10.0)
        if n > 15:
            assert (found.contrast, found.modulation) == (0.5, 0.7)
            assert found.strip_share == pytest.approx(1 - given["short"] / 8)
            assert found.worst_gap == pytest.approx(0.1)
            assert found.mean == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("phase", "width_px", "shift"),
    [(20.0, 3.0, 20 / 36), (-20.0, 3.0, -20 / 36), (90.0, 4.0, 1.25), (90.0, 12.0, 0.5)],
)
def test_read_pattern_follows_a_shift_of_an_eighth_or_of_six_tenths_of_a_pixel(
    phase, width_px, shift, monkeypatch
):
    seen, across = [], np.linspace(0, 40, 300)
    given = across, np.linspace(0, 60, 300), np.ones(300), width_px, 50.0

    def gaps(shifted, along, values, pairs, strips, noise):
        seen.append((shifted, strips))
        return np.ones((1, 3)), np.zeros((1, 3)), 0.5, np.full((1, 3), np.nan)

    monkeypatch.setattr(line_pairs, "_pixels", lambda *_: given)
    monkeypatch.setattr(line_pairs, "_wave", lambda *_: (0.7, phase, 4.0))
    monkeypatch.setattr(line_pairs, "_gaps", gaps)
    found = line_pairs.read_pattern(SimpleNamespace(noise=0.1), PAIRS, None)
    assert seen[0][0] == pytest.approx(across - shift)
    # strips so high that three deviations of a bar's mean reach a tenth: (60 x .1)^2 / (w / 2)
    assert seen[0][1] == min(max(int(50 / max(2, 36 / (width_px / 2))), 1), 8)
    assert np.isnan(found.mean)
    line_pairs.read_pattern(SimpleNamespace(noise=0.001), PAIRS, None)
    assert seen[1][1] == 8  # 2 px each, eight at most
    line_pairs.read_pattern(SimpleNamespace(noise=1.0), PAIRS, None)
    assert seen[2][1] == 1


@pytest.mark.parametrize("direction", ["h", "v"])
def test_pixels_of_a_pattern_lie_between_its_first_and_last_black_bar(direction, rng):
    pairs = LinePairs("p", 30.0, 20.0, 10.0, direction, repeats=4, length=60.0)
    values = rng.random((100, 80))
    values[40, 30] = np.nan
    matrix = np.array([[0.5, 0.0, 5.0], [0.0, -0.4, 80.0], [0, 0, 1.0]])
    found = line_pairs._pixels(Tones(values, 0.01), pairs, ChartMap(matrix))
    across, along, seen, width_px, length_px = found
    scale = (0.5, 0.4) if direction == "h" else (0.4, 0.5)
    expected = []
    for row, column in np.ndindex(100, 80):
        place = (column - 5) / 0.5 - 30, (80 - row) / 0.4 - 20
        a, b = place if direction == "h" else place[::-1]
        end = 1.5 / scale[1]
        if 0 <= a <= 35 and end <= b <= 60 - end and np.isfinite(values[row, column]):
            expected.append((a, b, values[row, column]))
    order = np.lexsort(np.transpose(expected)[:2])
    mine = np.lexsort((across, along))
    assert np.column_stack([across, along, seen])[mine] == pytest.approx(np.array(expected)[order])
    assert width_px == pytest.approx(10 * scale[0])
    assert length_px == pytest.approx(60 * scale[1] - 3)


@pytest.mark.parametrize(("value", "noise", "said"), [(0.21, 0.01, 1), (0.19, 0.01, 0),
                                                      (0.39, 0.1, 0), (0.41, 0.1, 1)])  # fmt: skip
def test_a_pattern_is_crossed_where_white_around_it_is_not_white(value, noise, said):
    view = flat_map(1.0, (0.0, 119.0))
    odd = np.zeros((120, 120))
    x, y = np.meshgrid(np.arange(120), 119 - np.arange(120))
    inner = (x >= 30) & (x <= 70) & (y >= 20) & (y <= 80)
    rim = (x >= 18) & (x <= 82) & (y >= 8) & (y <= 92) & ~inner
    count = rim.sum()
    rows, columns = np.nonzero(rim)
    for some, crossed in ((int(0.037 * count), False), (int(0.043 * count), True)):
        odd[:] = np.where(inner, 1.0, 0.0)
        odd[rows[:: count // some][:some], columns[:: count // some][:some]] = value
        found = line_pairs.is_crossed(Tones(odd, noise, odd=odd), PAIRS, view)
        assert found == bool(crossed and said)
    assert not line_pairs.is_crossed(Tones(odd, noise), PAIRS, view)
    hardly = np.full((120, 120), np.nan)
    hardly[rows[:10], columns[:10]] = 1.0
    assert not line_pairs.is_crossed(Tones(hardly, noise, odd=hardly), PAIRS, view)
    hardly[rows[:11], columns[:11]] = 1.0
    assert line_pairs.is_crossed(Tones(hardly, noise, odd=hardly), PAIRS, view)


def test_tones_near_an_outline_are_the_known_pixels_of_its_box(rng):
    values = rng.random((30, 40))
    values[12, 20] = np.nan
    view = flat_map(0.5, (4.3, 25.2))
    outline = np.array([[10.0, 4], [60, 4], [60, 33], [10, 33]])
    places, found = Tones(values, 0.1).near(view, outline)
    # columns 9.3 to 34.3, rows 8.7 to 23.2
    box = [(row, column) for row in range(8, 25) for column in range(9, 36)]
    box = [one for one in box if np.isfinite(values[one])]
    assert found.tolist() == [values[one] for one in box]
    expected = [((c - 4.3) / 0.5, (25.2 - r) / 0.5) for r, c in box]
    assert places == pytest.approx(np.array(expected))
    assert len(Tones(values, 0.1).near(view, outline + 500)[1]) == 0
    assert len(Tones(values, 0.1).near(view, outline - 500)[1]) == 0
    assert len(Tones(values, 0.1).near(view, [[-99, -99], [500, 500]])[1]) == 1199


def edge_tones(end_px, shape=(40, 60), dark=0.1, white=0.9):
    """A dark area up to a column and white beyond, with a straight rise of four pixels."""
    rise = np.clip(0.5 + (np.arange(shape[1]) - end_px) / 4, 0, 1)
    return np.tile(dark + (white - dark) * rise, (shape[0], 1))


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("off", [0.05, 0.75, -1.25, 1.95, 2.15])
def test_crossings_tell_how_far_outside_of_its_place_an_end_is(sign, off):
    view = flat_map(0.5, (0.0, 39.0))
    seen = edge_tones(30.0 + sign * off)
    seen = seen if sign > 0 else 1.0 - seen
    lanes = np.array([-6.0, 0.0, 9.0])
    found = tones._crossings(Tones(seen, 0.01), view, np.array([60.0, 30.0]), 0, sign, lanes)
    expected = off if abs(off) < 2 else np.nan
    # read in steps of a tenth of a pixel, the end before the step
    assert found == pytest.approx(np.full(3, expected), abs=0.06, nan_ok=True)


def test_crossings_need_a_white_side_that_differs_and_pixels():
    view, end, lanes = flat_map(0.5, (0.0, 39.0)), np.array([60.0, 30.0]), np.zeros(1)

    def seen(values):
        return bool(np.isfinite(tones._crossings(Tones(values, 0.01), view, end, 0, 1, lanes)[0]))

    assert seen(edge_tones(30.0, dark=0.2, white=0.41))
    assert not seen(edge_tones(30.0, dark=0.22, white=0.41))
    assert seen(edge_tones(30.0, dark=0.0, white=0.36))
    assert not seen(edge_tones(30.0, dark=0.0, white=0.34))
    assert not seen(edge_tones(30.0, shape=(40, 35)))  # the outer side leaves the image
    upright = edge_tones(30.0, shape=(60, 40)).T
    view = ChartMap(np.array([[0.5, 0, 0.0], [0, 0.5, 0.0], [0, 0, 1.0]]))
    found = tones._crossings(Tones(upright, 0.01), view, np.array([30.0, 59.1]), 1, 1, lanes + 3)
    assert found == pytest.approx([0.45], abs=0.06)


def test_bars_are_measured_by_their_ends_and_the_scatter_of_these(monkeypatch, rng):
    bars = (Bar("lying", 20, 10, 60, 8), Bar("standing", 5, 20, 8, 60), Bar("block", 40, 40, 9, 9))
    layout, view = Layout("bars", 100, 100, bars), flat_map(1.25, (3.0, 130.0))
    seen, asked = {}, []

    def crossings(_, __, end, axis, sign, lanes):
        asked.append((end.tolist(), axis, sign, lanes))
        return seen.setdefault((axis, sign), rng.normal(0.1 * sign, 0.05, len(lanes)))

    monkeypatch.setattr(tones, "_crossings", crossings)
    table = tones.pixel_sizes(Tones(np.zeros((9, 9)), 0.01), layout, view)
    assert table["name"].tolist() == ["lying", "standing"]
    assert table["direction"].tolist() == ["h", "v"]
    assert table["length_mm"].tolist() == [60, 60]
    assert table["length_px"].to_numpy() == pytest.approx(75)
    ends = {(axis, sign): end for end, axis, sign, _ in asked}
    assert ends == {(0, -1): [20, 14], (0, 1): [80, 14], (1, -1): [9, 20], (1, 1): [9, 80]}
    # of 10 pixels across nine rows, from half a pixel within to half a pixel within
    assert asked[0][3] == pytest.approx(0.9 * 8 * ((np.arange(9) + 0.5) / 9 - 0.5))
    offsets = []
    for axis, row in enumerate(table.itertuples()):
        low, high = seen[axis, -1], seen[axis, 1]
        assert row.n == 9
        assert row.repeats_std_px == pytest.approx((low + high).std(ddof=1))
        offsets.append(np.sqrt((low.mean() ** 2 + high.mean() ** 2) / 2))
        assert row.offset_px == pytest.approx(offsets[-1])
    sigma = np.sqrt(2 * np.mean(np.square(offsets)))
    assert table["length_sigma_px"].to_numpy() == pytest.approx(sigma / 3)
    assert table["pixel_mm"].to_numpy() == pytest.approx(0.8)
    assert table["pixel_sigma_mm"].to_numpy() == pytest.approx(0.8 * sigma / 3 / 75)
    for loose in (tones.pixel_sizes(Tones(np.zeros((9, 9)), 0.01), layout, view, hidden=True),
                  tones.pixel_sizes(Tones(np.zeros((9, 9)), 0.01), layout,
                                    ChartMap(view.matrix, blur_px=1.21))):  # fmt: skip
        assert loose["length_sigma_px"].to_numpy() == pytest.approx(sigma)
    seen[0, 1][:4] = np.nan  # five of nine rows see an end
    unseen = tones.pixel_sizes(Tones(np.zeros((9, 9)), 0.01), layout, view).iloc[0]
    assert (unseen["n"], unseen["length_px"]) == (0, pytest.approx(75))
    assert np.isnan([unseen["pixel_mm"], unseen["offset_px"]]).all()
    seen[0, 1][3] = 0.2
    assert tones.pixel_sizes(Tones(np.zeros((9, 9)), 0.01), layout, view)["n"].tolist() == [6, 9]


def test_depths_are_distances_from_the_nearest_other_cell_or_the_border(rng):
    mask = rng.random((30, 40)) < 0.97
    expected = distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1]
    # OpenCV's 5 x 5 masks are right to two per cent
    assert tones._depth(mask) == pytest.approx(expected, rel=0.03, abs=0.01)
    depth = np.array([0.31] * 5 + [1.1] * 25 + [3.1] * 29)
    assert tones._plainest(depth).sum() == 54
    assert tones._plainest(np.append(depth, 3.0)).sum() == 30
    assert tones._plainest(np.full(29, 0.3)).sum() == 29
    assert tones._plainest(np.full(40, 0.29)).sum() == 0
    for limit in (3.0, 2.5, 2.0, 1.5, 1.2, 1.0, 0.7, 0.5, 0.3):
        both = np.repeat([limit, limit - 1e-6], [30, 40])
        assert tones._plainest(both).sum() == 30
    assert tones._spread(np.array([1.0, 2, 3, 4, 90])) == pytest.approx(1.4826)


def test_local_white_follows_light_and_fills_what_has_none(rng):
    y, x = np.mgrid[:90, :120]
    light = 0.5 + 0.001 * x + 0.002 * y
    white = rng.random(light.shape) < 0.3
    field = tones._local(np.where(white, light, 0.0), white, 100.0)
    inner = field[15:-15, 15:-15]
    assert inner == pytest.approx(light[15:-15, 15:-15], abs=0.012)
    assert tones._local(np.full((90, 120), 0.7), white, 100.0) == pytest.approx(0.7)
    one = x < 30  # farther away the nearest that is known
    filled = tones._local(np.where(one, light, 9.0), one, 100.0)
    assert filled[45, 110] == pytest.approx(light[45, :30].mean(), abs=0.05)
    still = tones._local(np.where(one, 0.4, 9.0), one, 100.0)
    assert still == pytest.approx(0.4)


def test_printed_tones_and_depths_are_those_of_the_chart_behind_a_usual_lens():
    layout = Layout("bar", 60, 40, (Bar("a", 20, 10, 20, 20),))
    view = flat_map(1.0, (10.0, 50.0))
    inside, spilt, white, black = tones._printed(layout, view, (64, 80))
    column, row = np.meshgrid(np.arange(80), np.arange(64))
    x, y = column - 10.0, 50.0 - row
    on = (x >= 0) & (x <= 60) & (y >= 0) & (y <= 40)
    clear = np.minimum.reduce([np.abs(x), np.abs(x - 60), np.abs(y), np.abs(y - 40)]) > 0.5
    assert (inside == on)[clear].all()
    from scipy.special import ndtr

    across = ndtr((x - 20) / 0.65) - ndtr((x - 40) / 0.65)
    up = ndtr((y - 10) / 0.65) - ndtr((y - 30) / 0.65)
    deep = on & (np.minimum.reduce([x, 60 - x, y, 40 - y]) > 3)
    assert np.abs(spilt - (1 - across * up))[deep].max() < 0.02
    within = np.minimum.reduce([x - 20, 40 - x, y - 10, 30 - y])
    assert np.abs(black - within.clip(0))[deep & (np.abs(within) > 1)].max() < 0.35
    rim = np.minimum.reduce([x, 60 - x, y, 40 - y])
    aside = np.hypot(np.maximum(np.abs(x - 30) - 10, 0), np.maximum(np.abs(y - 20) - 10, 0))
    expected = np.minimum(rim, aside)
    assert np.abs(white - expected)[on & (expected > 1)].max() < 0.4
    wide = tones._printed(layout, ChartMap(view.matrix, blur_px=2.0), (64, 80))[1]
    across = ndtr((x - 20) / 2) - ndtr((x - 40) / 2)
    up = ndtr((y - 10) / 2) - ndtr((y - 30) / 2)
    assert np.abs(wide - (1 - across * up))[deep & (rim > 7)].max() < 0.02


def test_pairs_that_are_crossed_or_behind_finer_ones_are_hidden(monkeypatch):
    rows = [("h_40", "h", 40.0, 0), ("h_30", "h", 30.0, 0.4), ("h_20", "h", 20.0, 0)]
    rows += [("h_10", "h", 10.0, 0), ("v_40", "v", 40.0, 0.9), ("v_20", "v", 20.0, 0.29)]
    rows += [("v_10", "v", 10.0, 0)]
    made = [LinePairs(name, 0.0, 0.0, wide, way) for name, way, wide, _ in rows]
    layout = SimpleNamespace(of_kind=lambda _: made)

    def read(crossed, resolved):
        readings = {name: line_pairs.PairReading(name, way, wide, wide / 4, contrast,
                                                 resolved=name in resolved, reason="why")
                    for name, way, wide, contrast in rows}  # fmt: skip
        monkeypatch.setattr(line_pairs, "read_pattern", lambda _, one, __: readings[one.name])
        monkeypatch.setattr(line_pairs, "is_crossed", lambda _, one, __: one.name in crossed)
        table = line_pairs.read_pairs(None, layout, None)
        assert table["width_mm"].tolist() == [40, 30, 20, 10, 40, 20, 10]
        return table.loc[table["reason"] == line_pairs.HIDDEN, "name"].tolist()

    some = ("h_30", "v_40", "v_20")
    assert read((), some) == ["h_40"]  # coarser than one that is clear
    assert read((), ("v_20",)) == []  # not clear enough
    assert read((), ("h_30",)) == ["h_40"]
    # what is crossed, but for what is resolved or finer than all that is
    assert read(("h_20", "h_10", "v_40", "v_10"), some) == ["h_40", "h_20"]
    assert read(("h_20", "v_40"), ("v_20", "v_10")) == ["v_40"]  # none of h: by motion
    assert read(("h_30", "v_40"), ("v_20",)) == ["h_30", "v_40"]  # but it has contrast


def test_the_site_has_six_boards_where_it_says():
    site = chart_site().set_index("chart")["corners"]
    south = np.array([[-0.5, 0, 1], [0.5, 0, 1], [0.5, 0, 2], [-0.5, 0, 2]])
    assert site["image forward"] == pytest.approx(south)
    assert site["point forward"] == pytest.approx(south + [2, 0, 0])
    west = np.array([[0, 10.5, 1], [0, 9.5, 1], [0, 9.5, 2], [0, 10.5, 2]])
    assert site["image orthogonal"] == pytest.approx(west)
    assert site["point orthogonal"] == pytest.approx(west + [0, 2, 0])
    north = np.array([[0.5, 20, 1], [-0.5, 20, 1], [-0.5, 20, 2], [0.5, 20, 2]])
    assert site["image backward"] == pytest.approx(north)
    assert site["point backward"] == pytest.approx(north + [2, 0, 0])
    right, normal = np.array([0.0, -1, 0]), np.array([-1.0, 0, 0])
    ways = [((0, 9, 0), "orthogonal"), ((9, 8.9, 0), "forward"), ((-9, 8.9, 0), "backward")]
    for way, view in [*ways, ((9, 9.1, 0), "orthogonal"), ((-9, -9.1, 0), "orthogonal")]:
        assert _view(right, normal, np.array([[1, 2, 3], np.add((1, 2, 3), way)])) == view


def test_the_window_of_a_chart_has_a_margin_of_a_twentieth_or_sixteen_pixels():
    layout = Layout("bar", 600, 400, (Bar("a", 20, 10, 20, 20),))
    view = flat_map(1.0, (60.4, 470.3))
    # columns 60.4 to 660.4, rows 70.3 to 470.3; a twentieth are 30 and 20
    assert _window(view, layout, (900, 900)) == ((30, 50), (692, 492))
    assert _window(view, layout, (480, 670)) == ((30, 50), (670, 480))
    small = flat_map(0.25, (60.4, 170.3))
    assert _window(small, layout, (900, 900)) == ((44, 54), (228, 188))
    for shape in ((470, 900), (900, 660)):
        with pytest.raises(ValueError, match="Invalid place of the chart"):
            _window(view, layout, shape)
    assert _window(view, layout, (471, 661))[1] == (661, 471)
    at_rim = flat_map(1.0, (-0.4, 470.3))
    assert _window(at_rim, layout, (900, 900))[0] == (0, 50)


def test_a_pixel_size_is_that_of_all_bars_of_a_direction():
    sizes = pd.DataFrame({"direction": ["h", "v", "v"], "length_mm": [600.0, 800, 800]})
    sizes = sizes.assign(
        length_px=[200.0, 250, 270], length_sigma_px=0.3, offset_px=[0.1, 0.2, 0.5]
    )
    quality = ImageQuality(None, None, sizes.assign(pixel_mm=[3.0, 3.2, 3.0]), None, None, None)
    assert quality.pixel_size("v") == pytest.approx((1600 / 520, 1600 / 520 * 0.3 / 260))
    assert quality.pixel_size("h") == pytest.approx((3.0, 3.0 * 0.3 / 200))
    assert quality.residual_px == pytest.approx(np.sqrt(0.3 / 3))
    hidden = ImageQuality(None, None, sizes.assign(pixel_mm=[3.0, np.nan, 3.0]), None, None, None)
    sigma = np.hypot(0.3, 0.5)
    assert hidden.pixel_size("v") == pytest.approx((1600 / 520, 1600 / 520 * sigma / 260))
    none = ImageQuality(None, None, sizes.assign(pixel_mm=np.nan), None, None, None)
    assert np.isnan(none.pixel_size("v")).all()
    assert charts.imaging_chart()["bar_left"].height == 800
