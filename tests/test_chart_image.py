"""Measuring in images of the chart: known renderings, closed forms, real photographs."""

import dataclasses
from types import SimpleNamespace

import cv2
import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from photographed import RealPairs
from rendered import centre_contrast, grey, pattern_case

from mmqa_lab import chart_image, charts, samples
from mmqa_lab.chart_image import (
    ChartMap,
    PanoramaCamera,
    align,
    alignment,
    doubts,
    finding,
    maps,
)
from mmqa_lab.simulate import cameras

CHART = charts.imaging_chart()

JPEG = {"bayer": True, "gamma": "srgb", "bits": 8, "jpeg_quality": 85}

real = pytest.mark.skipif(not samples.has_real("images"), reason="MMQA_DATA is not set")


def photo_of(pixel_mm, *, heading=0.0, roll=0.7, sigma=0.6, layout=CHART, seed=0, **sensor):
    """A panorama's view of a chart 5 m away and its linear grey values."""
    camera = PanoramaCamera(2 * round(5000 * np.pi / pixel_mm))
    view = cameras.chart_view(
        camera, distance=5, layout=layout, heading_deg=heading, roll_deg=roll, aim_deg=0.4
    )
    sensor = {"noise": 0.02} | sensor
    photo = cameras.photograph(
        layout,
        view,
        optics=cameras.Optics(sigma),
        sensor=cameras.Sensor(**sensor),
        seed=seed,
    )
    return photo, grey(photo.image, sensor.get("gamma", "linear"))


@pytest.fixture(scope="module")
def oblique():
    """A view of 45 degrees at 5.4 mm with noise of 5 % of the contrast, and what is read of it."""
    photo, image = photo_of(5.4, heading=45, noise=0.035)
    wrong = photo.chart_map.pixels(CHART.corners()) + [[0.8, -0.5], [-0.7, 0.6], [0.4, 0.9], [0, 1]]
    there = chart_image.locate(
        None, CHART, corners=wrong, camera=photo.chart_map.camera, offset=photo.origin
    )
    return photo, image, chart_image.evaluate_image(image, CHART, there)


# --- pixel size


def test_pixel_size_of_an_oblique_view_is_the_chord_between_the_ends(oblique):
    photo, _, quality = oblique
    for row in quality.sizes.itertuples():
        bar = CHART[row.name]
        ends = np.array([[bar.x, bar.y], [bar.x + bar.width, bar.y + bar.height]], dtype=float)
        axis = 0 if row.direction == "h" else 1
        ends[:, 1 - axis] = ends[:, 1 - axis].mean()
        truth = np.linalg.norm(np.diff(photo.chart_map.pixels(ends), axis=0))
        assert abs(row.length_px - truth) < 4 * row.length_sigma_px
        assert row.length_sigma_px < 0.3  # the paper's own repeats stay below 1 px
        assert row.pixel_mm == pytest.approx(row.length_mm / truth, rel=0.003)


# --- line pairs


@pytest.mark.parametrize("direction", ["h", "v"])
def test_clear_pairs_are_resolved(direction):
    rng = np.random.default_rng(1)
    for width in (3.3, 4.4, 7.5):
        reading = pattern_case(width, rng, direction=direction, **JPEG)
        assert reading.resolved, reading
        assert reading.bars == pytest.approx(8, abs=0.3)
        assert reading.width_px == pytest.approx(width, rel=1e-6)


SPURIOUS = {
    "below Nyquist": lambda r, c: pattern_case(r.uniform(1.1, 2), r, sigma=0.4, **c),
    "beats": lambda r, c: pattern_case(r.uniform(2, 2.3), r, sigma=0.4, **c),
    "defocus": lambda r, c: pattern_case(
        (w := r.uniform(3, 8)), r, sigma=0.3, defocus=r.uniform(0.7, 1.0) * w, **c
    ),
    "motion": lambda r, c: pattern_case(
        r.uniform(2.6, 8), r, sigma=0.4, travel=r.uniform(1.25, 1.7), **c
    ),
    "blurred": lambda r, c: pattern_case(r.uniform(2.5, 4), r, sigma=2.0, noise=0.032, **c),
    "other number": lambda r, c: pattern_case(
        r.uniform(4, 8), r, seen=int(r.choice([6, 7, 9, 12])), **c
    ),
}


@pytest.mark.parametrize("kind", SPURIOUS)
def test_spurious_pairs_are_refused_with_a_reason(kind):
    rng = np.random.default_rng(11)
    for direction in "hv":
        reading = SPURIOUS[kind](rng, {**JPEG, "direction": direction})
        assert not reading.resolved
        assert reading.reason


def test_motion_and_defocus_reverse_contrast_before_they_are_refused():
    # otherwise the tests above would show nothing
    rng = np.random.default_rng(3)
    assert pattern_case(6.0, rng, sigma=0.4, travel=1.45).contrast < -0.1
    assert pattern_case(6.0, rng, sigma=0.3, defocus=4.8).contrast < -0.05
    assert abs(pattern_case(6.0, rng, seen=9).bars - 9) < 0.3


@settings(max_examples=12, deadline=None)
@given(
    st.floats(1.02, 1.999),
    st.floats(0.1, 0.6),
    st.sampled_from(["h", "v"]),
    st.integers(0, 2**31),
)
def test_nothing_below_nyquist_is_ever_resolved(width, sigma, direction, seed):
    rng = np.random.default_rng(seed)
    reading = pattern_case(width, rng, sigma=sigma, direction=direction, noise=0.0)
    assert not reading.resolved


@pytest.mark.parametrize(
    ("width", "sigma", "blur"), [(2.6, 0.5, 0.0), (4.0, 0.8, 1.5), (9.0, 0.4, 3.0)]
)
def test_expected_contrast_is_the_integral_over_the_bars(width, sigma, blur):
    found = chart_image.expected_contrast(width, sigma, blur)
    # harmonics beyond the seventh
    assert float(found) == pytest.approx(centre_contrast(width, sigma, blur), abs=0.005)


def readings(resolved):
    """A table of readings of one direction, coarse to fine, pairs of 40, 39, ... mm."""
    widths = 40.0 - np.arange(len(resolved))
    return pd.DataFrame({"direction": "h", "width_mm": widths, "resolved": resolved})


@given(st.lists(st.booleans(), min_size=1, max_size=9))
def test_width_is_the_finest_with_all_coarser_ones(resolved):
    found = chart_image.resolution(readings(resolved).sample(frac=1, random_state=1), "h")
    run = 0
    while run < len(resolved) and resolved[run]:
        run += 1
    expected = 40.0 - run + 1 if run else np.nan
    following = 40.0 - run if run < len(resolved) else np.nan
    assert found.width_mm == pytest.approx(expected, nan_ok=True)
    assert found.next_mm == pytest.approx(following, nan_ok=True)


@pytest.mark.real
@real
def test_real_pairs_are_resolved_down_to_three_pixels_and_never_below_two():
    pairs = RealPairs()
    for width in (8.5, 6.3, 4.4, 3.3):
        assert [reading.resolved for reading in pairs.readings(width)] == [True] * 5, width
    for width in (2.0, 1.8, 1.5):
        assert not any(reading.resolved for reading in pairs.readings(width)), width


@pytest.mark.real
@real
def test_real_pairs_reversed_by_motion_are_refused():
    pairs = RealPairs()
    for width in (8.0, 5.0):
        found = list(pairs.readings(width, motion=1.5))
        assert not any(reading.resolved for reading in found)


# --- locating


def test_a_map_through_points_is_the_projective_one():
    matrix = np.array([[0.31, 0.02, 40], [0.01, -0.29, 330], [2e-5, -1e-5, 1.0]])
    truth = ChartMap(matrix)
    rng = np.random.default_rng(0)
    places = rng.uniform(0, 1000, (9, 2))
    seen = np.column_stack([places, np.ones(9)]) @ matrix.T
    found = ChartMap.from_points(places, seen[:, :2] / seen[:, 2:])
    there = rng.uniform(0, 1000, (20, 2))
    # OpenCV stops its iteration at 1e-7 of the size
    assert found.pixels(there) == pytest.approx(truth.pixels(there), abs=1e-4)
    assert truth.chart(truth.pixels(there)) == pytest.approx(there, abs=1e-9)


@pytest.mark.parametrize("heading", [-45, 0, 45])
def test_targets_locate_the_chart_in_oblique_panoramas(heading):
    photo, image = photo_of(3.5, heading=heading, gamma="srgb", bits=8)
    found = chart_image.locate(image, CHART, camera=photo.chart_map.camera, offset=photo.origin)
    places = CHART.corners()
    error = np.linalg.norm(found.pixels(places) - photo.chart_map.pixels(places), axis=1)
    # corners of targets are found to some 0.3 px, and the chart's own lie a little outside
    assert error.max() < 1.5
    aligned = align(image, CHART, found)
    error = np.linalg.norm(aligned.pixels(places) - photo.chart_map.pixels(places), axis=1)
    assert error.max() < 0.3
    middle = [[500.0, 500.0]]
    assert aligned.pixels(middle) == pytest.approx(photo.chart_map.pixels(middle), abs=0.05)


def test_alignment_says_when_the_chart_is_not_there():
    photo, image = photo_of(6.0)
    noise = np.random.default_rng(0).random(image.shape)
    with pytest.raises(ValueError, match=r"correlates by .*is the chart there"):
        align(noise, CHART, photo.chart_map)
    with pytest.raises(ValueError, match="is the chart there"):
        align(image, CHART, photo.chart_map.within(60, 30))


# --- everything together


def test_an_evaluated_image_has_every_figure(oblique):
    photo, _, quality = oblique
    row = quality.to_frame().iloc[0]
    assert row["located_by"] == "corners, aligned"
    assert row["residual_px"] < 0.3
    assert 0.04 < row["noise_share"] < 0.06  # 5 % of white were put in
    truth = photo.chart_map.pixel_sizes_mm([[500, 500]])[0]
    assert [row["pixel_h_mm"], row["pixel_v_mm"]] == pytest.approx(truth, rel=0.02)
    for direction in "hv":
        w, finer = row[f"w_{direction}_mm"], row[f"w_{direction}_next_mm"]
        assert finer < w <= 40
        pixel = row[f"pixel_{direction}_mm"]
        assert 2.0 < w / pixel < 5.0  # the published cells span 2.3 to 4.6


def test_brightness_changes_no_verdict():
    photo, image = photo_of(6.5, noise=0.01)
    first = chart_image.find_tones(image, CHART, photo.chart_map)
    slope = 1 + 0.1 * np.linspace(-1, 1, image.shape[1])
    second = chart_image.find_tones(0.4 * image * slope + 0.1, CHART, photo.chart_map)
    a, b = (chart_image.read_pairs(one, CHART, photo.chart_map) for one in (first, second))
    assert (a["resolved"] == b["resolved"]).all()
    assert b["contrast"].to_numpy() == pytest.approx(
        a["contrast"].to_numpy(), abs=0.05, nan_ok=True
    )
    assert first.noise == pytest.approx(0.01 / 0.64, rel=0.5)


def test_clipped_images_say_so():
    photo, image = photo_of(8.0)
    assert chart_image.find_tones(image, CHART, photo.chart_map).clipped_share == 0
    bright = np.clip(2 * image, 0, 1)
    assert chart_image.find_tones(bright, CHART, photo.chart_map).clipped_share > 0.3


# --- the test site


SITE = chart_image.chart_site().set_index("chart")


def stations(north, *, easting=-5.0, heading=1):
    """Images of a straight drive at 1.5 m, north or (heading -1) south."""
    return pd.DataFrame(
        {"easting_m": easting, "northing_m": np.asarray(north)[::heading], "height_m": 1.5}
    )


@pytest.mark.parametrize("heading", [1, -1])
@pytest.mark.parametrize("easting", [-5.0, -10.0])
def test_images_are_chosen_as_a_search_by_hand_does(easting, heading):
    north = np.arange(-40.0, 61, 2.5)
    drive = stations(north, easting=easting, heading=heading)
    views = {"forward": "backward", "backward": "forward"} if heading < 0 else {}
    for chart in ("image forward", "image orthogonal", "image backward"):
        middle = SITE.loc[chart, "corners"].mean(axis=0)
        found = chart_image.choose_images(drive, SITE.loc[chart, "corners"], distance=10).iloc[0]
        view = chart.split()[1]
        assert found["view"] == views.get(view, view)
        away = drive["northing_m"] - middle[1]
        distance = np.hypot(away, easting)
        if view == "orthogonal":
            best = away.abs().idxmin()
            off = np.degrees(np.arctan2(abs(away[best]), abs(easting)))
        else:
            front = away < 0 if view == "forward" else away > 0
            best = distance[front & (distance >= 10)].idxmin()
            off = np.degrees(np.arctan2(abs(easting), abs(away[best])))
        assert found["station"] == best
        assert found["distance_m"] == pytest.approx(distance[best])
        assert found["off_normal_deg"] == pytest.approx(off)


def test_a_board_that_no_image_shows_has_none():
    past = stations([20.0, 30.0, 40.0])
    none = chart_image.choose_images(past, SITE.loc["image forward", "corners"], distance=10)
    assert none.iloc[0].isna().tolist() == [False, True, True, True]


# --- what is said of a photograph


def quality_of(monkeypatch, *, clipped=0.0, residual=0.1, charts=1, bent=0.0, gone=(), sizes=1.0,
               crossed=(), hidden_text=(), resolved=(20.0, 20.0), **columns):  # fmt: skip
    """What a photograph of four line pairs would give, made up."""
    names = ["h_20", "h_8", "v_20", "v_8"]
    pairs = {"name": names, "direction": list("hhvv"), "width_mm": [20.0, 8.0, 20.0, 8.0]}
    pairs |= {"width_px": [6.0, 2.5, 6.0, 2.5], "resolved": [True, False, True, False]}
    pairs |= {"contrast": [0.9, 0.05, 0.9, 0.05], "mean": 0.5, "reason": ["", "few", "", "few"]}
    chart_map = SimpleNamespace(charts=charts, bend=bent or None, bent_share=lambda _: bent)
    table = {"name": ["left", "lower"], "pixel_mm": [sizes, 3.0]}
    monkeypatch.setattr(doubts, "hidden_texts", lambda *_: [*hidden_text])
    monkeypatch.setattr(doubts, "is_crossed", lambda _, one, __: one in crossed)
    return SimpleNamespace(
        tones=SimpleNamespace(clipped_share=clipped), residual_px=residual, chart_map=chart_map,
        pairs=pd.DataFrame(pairs | columns), sizes=pd.DataFrame(table),
        layout={name: name for name in names},
        resolution=lambda one: SimpleNamespace(width_mm=resolved["hv".index(one)]),
    )  # fmt: skip


HIDE, MOVE = doubts.HIDDEN, doubts.MOVED


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({}, ""),
        ({"clipped": 0.049}, ""),
        ({"clipped": 0.06}, "6% of the plain pixels are clipped"),
        ({"residual": 0.99}, ""),
        ({"residual": 1.04}, "bars end 1.0 px from their places"),
        ({"charts": 2}, "2 charts are seen, the largest is measured"),
        ({"bent": 0.009}, ""),
        ({"bent": 0.012}, "straight lines are bent by 1.2%, the map follows them"),
        ({"sizes": np.nan}, "an end is not seen where the map has it: left"),
        ({"hidden_text": ["text_a"]}, "hidden: text_a, by a thing, glare or a shadow's edge"),
        ({"reason": ["", HIDE, "", "few"]}, "hidden: h_8, by a thing"),
        ({"reason": ["", "few", MOVE, "few"]}, "bars are not where they are printed: v_20"),
        ({"reason": ["", "few", MOVE, "few"], "width_px": [6, 2.5, 4.0, 2.5]}, ""),
        ({"reason": ["", "few", MOVE, "few"], "contrast": [0.9, 0, 0.1, 0]}, ""),
        ({"reason": ["", "few", MOVE, "few"], "contrast": [0.9, 0, -0.11, 0]}, "not where"),
        ({"contrast": [0.6, 0.1, 0.6, 0.1], "mean": 0.61}, ""),
        ({"contrast": [0.6, 0.1, 0.6, 0.1], "mean": 0.63}, "mean tone of 0.63 for 0.50: is gamma"),
        ({"contrast": [0.6, 0.1, 0.6, 0.1], "mean": 0.37}, "mean tone of 0.37 for 0.50: is gamma"),
        ({"contrast": [0.9, 0.01, 0.9, 0.01], "mean": 0.9}, ""),  # sharp, or lost
        ({"contrast": [0.6, 0, 0.6, 0], "mean": 0.9, "crossed": ["h_20", "v_20"]}, ""),
        ({"resolved": (np.nan, 20.0)}, "no line pairs are resolved in direction h"),
        ({"resolved": (30.0, 20.0), "contrast": [0.9, 0.3, 0.9, 0.05]}, "h_20, h_8 have contrast"),
        ({"resolved": (30.0, 20.0), "contrast": [0.9, 0.19, 0.9, 0.05]}, ""),
        ({"resolved": (30.0, 20.0), "contrast": [0.9, 0.3, 0.9, 0], "width_px": [6, 2.2, 6, 2]},
         ""),
    ],
)  # fmt: skip
def test_what_speaks_against_a_photograph_is_said_from_its_limit_on(given, words, monkeypatch):
    said = doubts.doubts(quality_of(monkeypatch, **given))
    assert len(said) == bool(words), said
    assert words in " ".join(said)


def test_a_text_of_which_a_part_lacks_its_contrast_is_hidden(rng):
    text = SimpleNamespace(name="text_1", x=0.0, cap=10.0, corners=lambda: None)
    other = SimpleNamespace(name="title", x=0.0, cap=10.0, corners=lambda: None)
    places = np.column_stack([np.repeat(np.arange(0.5, 20, 1.0), 8), np.tile(np.arange(8.0), 20)])
    printed = np.tile([0.0, 1.0], 80)
    layout = SimpleNamespace(of_kind=lambda _: [text, other])
    for gain, share, expected in ((0.8, 1.0, []), (0.8, 0.05, ["text_1"]), (0.8, 0.2, []),
                                  (0.2, 0.0, [])):  # fmt: skip
        seen = 0.1 + gain * printed
        part = (places[:, 0] >= 5) & (places[:, 0] < 10)  # half as wide as capitals are high
        seen[part] = 0.1 + gain * share * printed[part]
        tones = FakeTones(seen, printed, places)
        assert doubts.hidden_texts(tones, layout, None) == expected
    assert doubts.hidden_texts(FakeTones(seen, None, places), layout, None) == []


@dataclasses.dataclass
class FakeTones:
    values: np.ndarray
    printed: np.ndarray
    places: np.ndarray

    def near(self, *_):
        return self.places, self.values


def test_a_bent_map_is_undone_and_a_panorama_has_its_angles(rng):
    terms = np.zeros((4, 4, 2))
    terms[2, 0], terms[0, 2], terms[1, 1] = (9.0, -4.0), (-6.0, 5.0), (3.0, 2.0)
    matrix = np.array([[0.5, 0.02, 300], [0.01, -0.5, 700], [1e-5, 2e-5, 1]])
    bent = ChartMap(matrix, bend=maps.Bend((1000.0, 1000.0), terms), offset=(40.0, 7.0))
    xy = rng.uniform(0, 1000, (40, 2))
    assert np.abs(bent.chart(bent.pixels(xy)) - xy).max() < 0.05
    u, v = (2 * xy / 1000 - 1).T
    moved = np.array([9 * u**2 - 6 * v**2 + 3 * u * v, -4 * u**2 + 5 * v**2 + 2 * u * v]).T
    assert bent.bend.at(xy) == pytest.approx(moved)
    flat = np.column_stack([xy + moved, np.ones(40)]) @ matrix.T
    assert bent.pixels(xy) == pytest.approx(flat[:, :2] / flat[:, 2:] - [40, 7])
    panorama = PanoramaCamera(3600)
    azimuth, elevation = np.radians([10.0, -120, 179]), np.radians([5.0, -40, 60])
    rays = np.column_stack([np.cos(elevation) * np.sin(azimuth), -np.sin(elevation),
                            np.cos(elevation) * np.cos(azimuth)])  # fmt: skip
    pixels = panorama.pixels(7 * rays)
    assert pixels + 0.5 == pytest.approx(
        np.column_stack([1800 + np.degrees(azimuth) * 10, 900 - np.degrees(elevation) * 10])
    )
    assert panorama.rays(pixels) == pytest.approx(rays)


def test_how_far_sides_leave_straight_lines_is_their_sagitta():
    terms = np.zeros((4, 4, 2))
    terms[0, 2] = (12.0, 0.0)  # x moves by 12 mm times the square of y from -1 to 1
    bent = ChartMap(np.diag([1.0, -1.0, 1.0]), bend=maps.Bend((CHART.width, CHART.height), terms))
    assert bent.bent_share(CHART) == pytest.approx(12 / CHART.height, rel=0.01)
    assert ChartMap(np.diag([1.0, -1.0, 1.0])).bent_share(CHART) < 1e-9


def printed(cell, border=60):
    """The chart seen straight on with pixels of ``cell`` mm, grey around it, and its map."""
    tones = charts.reflectance(CHART, cell=cell)[::-1]
    image = np.pad(np.uint8(30 + 200 * tones), border, constant_values=120)
    matrix = [[1 / cell, 0, border - 0.5], [0, -1 / cell, border - 0.5 + len(tones)], [0, 0, 1]]
    return image, ChartMap(np.array(matrix))


def test_a_chart_without_targets_is_found_by_its_bars():
    image, truth = printed(3.0)
    corners = CHART.corners()
    found = finding.by_bars(image, CHART, 1.0)
    assert np.abs(found.pixels(corners) - truth.pixels(corners)).max() < 2.5
    correlation, again = finding.confirmed(image, CHART, truth)
    assert correlation > 0.95
    assert np.abs(again.pixels(corners) - truth.pixels(corners)).max() < 0.2


def test_small_targets_are_decoded_in_an_image_made_smaller(monkeypatch):
    image, truth = printed(5.0)  # 18 pixels a side
    monkeypatch.setattr(finding, "ENLARGED_PIXELS", image.size - 1)
    markers = finding._markers(CHART)
    found = dict(finding.decoded(image, markers, 0.5))
    assert set(found) == set(markers)
    for key, corners in found.items():
        assert np.abs(corners - truth.pixels(markers[key].corners()[::-1])).max() < 1.5


def test_the_bend_that_print_and_photograph_show_is_found_in_several_steps():
    terms = np.zeros((4, 4, 2))
    terms[2, 0], terms[0, 2] = (0.0, 12.0), (9.0, 0.0)  # mm, 4 and 3 pixels
    flat, fine = printed(3.0)[1], charts.reflectance(CHART, cell=1.0)
    bent = dataclasses.replace(flat, bend=maps.Bend((CHART.width, CHART.height), terms))
    pixels = np.indices((454, 454))[::-1].reshape(2, -1).T
    places = np.float32(bent.chart(pixels) - 0.5).reshape(454, 454, 2)
    tones = cv2.remap(cv2.blur(fine, (3, 3)), places, None, cv2.INTER_LINEAR)
    level = alignment.Level(np.uint8(30 + 200 * tones), CHART, flat, 333)
    found = alignment.with_bend(level, flat)
    off = found.outline(CHART.corners()) - bent.outline(CHART.corners())
    assert np.abs(off).max() < 0.25
