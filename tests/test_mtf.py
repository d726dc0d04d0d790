"""Edges, stars, bars and sharpness on rendered targets whose point spread is known."""

import re
from itertools import product
from types import SimpleNamespace

import cv2
import numpy as np
import pandas as pd
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from rendered import slanted_edge, true_mtf50
from scipy.ndimage import gaussian_filter
from scipy.optimize import brentq
from scipy.special import j0, ndtr

from mmqa_lab.mtf import doubts as mtf_doubts
from mmqa_lab.mtf import (
    edges,
    fit_edge,
    haar_sharpness,
    measure_star,
    read_bars,
    resolving_power,
    stars,
    transfer,
)
from mmqa_lab.mtf.transfer import spread_edge
from mmqa_lab.simulate.targets import (
    PointSpread,
    blur_over_image,
    render_bars,
    render_edge,
    render_star,
    texture,
)
from mmqa_lab.simulate.targets.resolution import _render


@pytest.mark.parametrize("sigma", [0.5, 1.0, 2.0])
def test_edge_fit_within_one_percent_at_one_percent_noise(sigma, rng):
    spread = PointSpread(sigma)
    errors = []
    for _ in range(6):
        angle = rng.uniform(3, 11)
        image = render_edge((100, 64), spread, angle_deg=angle)
        fit = fit_edge(image + 0.005 * rng.standard_normal(image.shape), method="sigmoid")
        errors.append((fit.fwhm_px / spread.fwhm(angle) - 1, fit.mtf50 / spread.mtf50(angle) - 1))
    assert np.abs(errors).max() < 0.01


@pytest.mark.parametrize("method", ["binned", "sigmoid"])
@pytest.mark.parametrize("angle", [8.0, 98.0, -40.0])
def test_edge_fit_knows_its_own_shapes(method, angle):
    spread = PointSpread(0.8)
    fit = fit_edge(render_edge((60, 60), spread, angle_deg=angle), method=method)
    assert np.trapezoid(fit.lsf, fit.distance_px) == pytest.approx(1, abs=1e-4)
    assert fit.mtf50 == pytest.approx(spread.mtf50(angle), rel=4e-3)
    assert fit.fwhm_px == pytest.approx(spread.fwhm(angle), rel=5e-3)


def test_logistic_fit_recovers_a_logistic_edge():
    y, x = np.mgrid[:40, :40] - 19.5
    across = x * np.cos(np.radians(5)) + y * np.sin(np.radians(5)) - 0.3
    fit = fit_edge(10 + 80 / (1 + np.exp(-across / 0.8)), method="logistic")
    # 2 ln(3 + 2 sqrt(2)) w, and x / sinh(x) = 1/2 at x = 2.1773
    assert fit.width_px == pytest.approx(0.8, rel=1e-3)
    assert fit.fwhm_px == pytest.approx(2 * np.log(3 + 2 * np.sqrt(2)) * 0.8, rel=1e-3)
    assert fit.mtf50 == pytest.approx(2.17731898 / (2 * np.pi**2 * 0.8), rel=1e-3)


def test_a_sigmoid_that_does_not_fit_says_so(rng):
    from scipy.ndimage import uniform_filter

    image = render_edge((100, 64), PointSpread(0.3), angle_deg=6.0)
    boxed = uniform_filter(image, 5) + 0.001 * rng.standard_normal(image.shape)
    assert "no sigmoid" in str(fit_edge(boxed, method="sigmoid").remarks)
    assert "no sigmoid" not in str(fit_edge(boxed).remarks)  # bins follow any profile


@pytest.mark.parametrize(("half", "sigma"), [(False, 0.7), (True, 0.7), (False, 1.5)])
def test_star_within_two_hundredths(half, sigma, rng):
    spread = PointSpread(sigma)
    image = render_star((190, 190), spread, cycles=24, radius_px=88, centre=(0.3, -0.2), half=half)
    image = image + 0.005 * rng.standard_normal(image.shape)
    part = (-180, 0) if half else (0, 360)
    star = measure_star(image, (94.0, 95.0), cycles=24, radius_px=88, azimuth_deg=part)
    low = star.frequency <= 0.45
    assert np.abs(star.mtf - spread.mtf_mean(star.frequency))[low].max() < 0.02
    assert np.hypot(star.centre[0] - 94.8, star.centre[1] - 94.3) < 0.15
    assert star.at(0.1) > star.mtf50


@pytest.mark.parametrize(("radius", "tilt"), [(70, 0), (70, 15), (110, 30)])
def test_tilted_stars_and_the_small_star_of_the_report(radius, tilt, rng):
    spread, n, shrink = PointSpread(0.7), 36, np.cos(np.radians(tilt))
    centre, (c, s) = np.array([0.3, -0.2]), (np.cos(0.6), np.sin(0.6))

    def distance(x, y):
        """Into the bright sectors of a star that is foreshortened along a direction."""
        x, y = x - centre[0], y - centre[1]
        u, v = (x * c + y * s) / shrink, y * c - x * s
        phase = n * np.arctan2(v, u) / (2 * np.pi)
        to_border = 0.25 - np.abs(phase - np.round(phase))
        r = np.hypot(u, v)
        return np.minimum(r * np.sin(2 * np.pi * to_border / n), radius - r) * np.sqrt(shrink)

    size = 2 * radius + 16
    image = _render((size, size), spread, distance, 0.1, 0.6)
    image = image + 0.005 * rng.standard_normal(image.shape)
    middle = centre + (size - 1) / 2
    star = measure_star(image, middle + [0.3, -0.4], cycles=n, radius_px=radius)
    low = star.frequency <= 0.45
    error = (star.mtf - spread.mtf_mean(star.frequency))[low]
    assert np.abs(error).max() < 0.01
    assert (np.abs(error) < 1.96 * star.std[low]).mean() > 0.85
    assert star.tilt_deg == pytest.approx(tilt, abs=1.5)
    assert star.mtf50 == pytest.approx(spread.mtf50(0), abs=3 * star.mtf50_sigma + 0.001)


def odd_star(kind, rng, n=24, radius=80):
    """A star that no lens alone makes of square sectors of like shares, as people print them."""
    size = 2 * radius + 10

    def distance(x, y):
        """Into bright sectors, narrower than the dark ones, or behind a lens off its axis."""
        bright, bend = (0.25, 1e-4) if kind == "bent" else (0.21, 0)
        x = x + bend * (x**2 + y**2)
        phase = n * np.arctan2(y, x) / (2 * np.pi)
        to_border, r = bright - np.abs(phase - np.round(phase)), np.hypot(x, y)
        return np.minimum(r * np.sin(2 * np.pi * to_border / n), radius - r)

    image = render_star((size, size), PointSpread(0.8), cycles=n, radius_px=radius)
    if kind in ("unlike", "bent"):
        image = _render((size, size), PointSpread(0.8), distance, 0.1, 0.6)
    if kind == "sinusoidal":
        y, x = np.mgrid[:size, :size] - (size - 1) / 2
        image = gaussian_filter(0.35 + 0.25 * np.cos(n * np.arctan2(y, x)), 0.8)
    if kind in ("sharpened", "mild"):
        image = image + (0.8 if kind == "sharpened" else 0.5) * (
            image - gaussian_filter(image, 1.2)
        )
    return image + 0.005 * rng.standard_normal(image.shape)


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("plain", "^$"), ("unlike", "sectors are unlike"), ("sharpened", "^sharpened"),
        ("mild", "^sharpened"),
        ("sinusoidal", "no plain middle"), ("bent", "^sectors are bent"),
    ],
)  # fmt: skip
def test_a_star_that_no_lens_makes_says_why(kind, words, rng):
    image = odd_star(kind, rng)
    found = measure_star(image, (84.5, 84.5), cycles=24, radius_px=80)
    assert re.search(words, "; ".join(found.remarks))


@pytest.mark.parametrize(("amount", "said"), [(0.0, False), (0.4, True)])
def test_a_star_that_a_camera_sharpens_mildly_says_so_by_its_noise(amount, said, rng):
    image = render_star((190, 190), PointSpread(1.0), cycles=24, radius_px=85)
    image += 0.015 * rng.standard_normal(image.shape)
    image += amount * (image - gaussian_filter(image, 0.85))
    found = measure_star(image, (94.5, 94.5), cycles=24, radius_px=85)
    assert any(one.startswith("sharpened") for one in found.remarks) == said


def test_a_star_of_few_grey_values_is_not_clipped(rng):
    image = 0.28 + 0.16 * render_star((170, 170), PointSpread(0.8), cycles=24, radius_px=80)
    image = np.round(255 * (image + 0.001 * rng.standard_normal(image.shape))) / 255
    assert not measure_star(image, (84.5, 84.5), cycles=24, radius_px=80).remarks


TAILS = [(0.3, 1.0), (0.15, 2.0), (0.1, 4.0)]


def behind_tails(image, share, width):
    """An image of as many rows as columns some of whose light falls by e in each width, px."""
    far = np.hypot(np.fft.fftfreq(len(image))[:, None], np.fft.rfftfreq(len(image)))
    return np.fft.irfft2(np.fft.rfft2(image) * tailed(far, share, width), s=image.shape)


def tailed(f, share, width):
    """Transfer of a lens whose tails take a share of the light."""
    return 1 - share + share * (1 + (2 * np.pi * f * width) ** 2) ** -1.5


@pytest.mark.parametrize(("share", "width"), TAILS)
def test_a_star_behind_a_lens_with_long_tails_says_so(share, width, rng):
    spread = PointSpread(0.8)
    image = behind_tails(render_star((150, 150), spread, cycles=36, radius_px=70), share, width)
    image += 0.003 * rng.standard_normal(image.shape)
    found = measure_star(image, (74.5, 74.5), cycles=36, radius_px=70)
    truth = brentq(
        lambda f: spread.mtf_mean(np.array([f]))[0] * tailed(f, share, width) - 0.5, 0.05, 0.5
    )
    (said,) = found.remarks
    assert said.endswith("in the tails of the lens: MTF50 may be off by 8%")
    assert abs(found.mtf50 - truth) < min(0.08 * truth, 2 * found.mtf50_sigma)


@pytest.mark.parametrize(("lens", "width"), [("disc", 2.0), ("diffraction", 2.0)])
def test_stars_and_edges_behind_other_lenses(lens, width, rng):
    spread = PointSpread(width, lens=lens)
    star = render_star((150, 150), spread, cycles=36, radius_px=70)
    star = star + 0.005 * rng.standard_normal(star.shape)
    found = measure_star(star, (74.5, 74.5), cycles=36, radius_px=70)
    # sectors of 6 px show no plain grey behind such a lens
    assert found.mtf50 == pytest.approx(spread.mtf50(0), rel=0.02)
    # the Fourier transform repeats what it renders: far away, as long tails see it
    edge = render_edge((100, 260), spread, angle_deg=5.0)[:, 100:160]
    edge = edge + 0.002 * rng.standard_normal(edge.shape)
    bins, gaussian = (fit_edge(edge, method=method) for method in ("binned", "sigmoid"))
    # one Gaussian cannot follow the tails, bins do
    assert bins.mtf50 == pytest.approx(spread.mtf50(5), rel=0.01)
    assert abs(gaussian.mtf50 / spread.mtf50(5) - 1) > 0.01
    assert bins.fwhm_px == pytest.approx(spread.fwhm(5), rel=0.02)


def test_the_stated_deviation_of_mtf50_is_that_of_its_draws(rng):
    rows, columns = np.mgrid[:40, :40]
    distance = (columns - 20 + 0.12 * rows - 2) / np.hypot(1, 0.12)
    edge = 0.3 + 0.4 * spread_edge(distance, 0.8, np.arctan(0.12))
    found = [fit_edge(edge + rng.normal(0, 0.01, edge.shape)) for _ in range(20)]
    told = np.sqrt(np.mean([one.mtf50_sigma**2 for one in found]))
    assert 0.6 < told / np.std([one.mtf50 for one in found]) < 1.8


def test_bars_are_resolved_down_to_a_width_and_no_further():
    rows = []
    for period in (8.0, 5.0, 3.5, 1.9):
        image = render_bars((64, 64), PointSpread(0.5), period_px=period)
        group = {"period_px": period, "x_px": 31.5, "y_px": 31.5, "angle_deg": 0.0, "bars": 4}
        rows.append(read_bars(image, pd.DataFrame([group]), dark=0.1, bright=0.6, noise=0.005))
    readings = pd.concat(rows)
    assert readings["resolved"].tolist() == [True, True, True, False]
    assert resolving_power(readings) == (3.5, 1.9)


def test_sharpness_falls_with_blur(rng):
    scene = 200 * texture((256, 256), seed=3)
    values = []
    for sigma in (0.4, 0.7, 1.0, 1.5):
        image = blur_over_image(scene, np.full(scene.shape, sigma)) + rng.normal(0, 2, scene.shape)
        values.append(float(haar_sharpness(image, noise_std=2.0)["sharpness"].median()))
    assert np.all(np.diff(values) < 0)
    tiny = haar_sharpness(1e-12 * image, noise_std=2e-12)["sharpness"].median()
    assert float(tiny) == pytest.approx(values[-1])
    plain = haar_sharpness(np.full((64, 64), 5.0), noise_std=1.0)
    assert plain.attrs["not_measurable"] == 1


def test_a_long_oblique_edge_with_grain_is_found_among_many_pixels():
    image = slanted_edge(0.9, np.radians(40), 0.0, shape=(650, 700))
    image += 0.1 * np.random.default_rng(1).standard_normal(image.shape) * (image > 0.35)
    found = fit_edge(image, method="sigmoid")
    assert found.mtf50 == pytest.approx(true_mtf50(0.9, np.radians(40)), rel=0.02)
    assert not [one for one in found.remarks if not one.endswith("as its interval says")]


def odd_edge(kind, rng, *, noise=0.01, angle_deg=None):
    """An edge as people photograph it, rendered from 36 places a pixel; and its true MTF50."""
    sigma, turn = rng.uniform(0.5, 1.6), np.radians(angle_deg or rng.uniform(3.5, 12))
    y, x = (np.mgrid[:600, :384] + 0.5) / 6
    y, x = y - 50, x - 32 - rng.uniform(-1, 1)
    d, along = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    d -= {
        "bend": lambda: rng.uniform(1, 8) * (along / 50) ** 2,
        "kink": lambda: np.maximum(along, 0) * np.tan(np.radians(rng.uniform(3, 12))),
        "wave": lambda: rng.uniform(0.6, 3) * np.sin(2 * np.pi * along / rng.uniform(8, 60)),
        "torn": lambda: np.interp(along, np.arange(-90, 91, 3), rng.normal(0, 1, 61)),
    }.get(kind, lambda: 0)()
    seen = ndtr(d / sigma)
    if kind == "second":
        seen += rng.uniform(0.05, 0.3) * ndtr((d - rng.uniform(10, 22)) / sigma)
    if kind == "near":
        side = rng.choice([-1, 1])
        seen += rng.uniform(0.08, 0.3) * ndtr((d - side * rng.uniform(5, 9)) / sigma)
    seen = seen.reshape(100, 6, 64, 6).mean(axis=(1, 3))
    if kind == "sharpened":
        seen += rng.uniform(1.0, 2.5) * (seen - gaussian_filter(seen, rng.uniform(1, 2)))
    seen += noise * rng.standard_normal(seen.shape)
    if kind == "white":
        seen = np.minimum(seen, 1 / rng.uniform(1.04, 1.6))
    if kind == "black":
        seen = np.maximum(seen, rng.uniform(0.04, 0.37))
    return 0.1 + 0.5 * (seen if rng.random() < 0.5 else seen.T), true_mtf50(sigma, turn)


ODD_EDGES = {
    "white": "white is clipped",
    "black": "black is clipped",
    "second": "a second edge|one edge between",
    "near": "a second edge|one edge between",
    "bend": "straight",
    "kink": "straight|one edge between",
    "wave": "straight",
    "torn": "straight",
    "sharpened": "sharpened",
}


@pytest.mark.parametrize(("kind", "words"), ODD_EDGES.items())
@settings(max_examples=4, deadline=None)
@given(seed=st.integers(0, 10**6), noise=st.sampled_from([0.005, 0.02]))
@example(seed=706, noise=0.005)
def test_an_edge_that_is_not_one_straight_unclipped_edge_says_why(kind, words, seed, noise):
    image, truth = odd_edge(kind, np.random.default_rng(seed), noise=noise)
    harmless = False
    try:
        found = fit_edge(image)
        said = "; ".join(found.remarks)
        # a second edge so faint, or so near to the border, that MTF50 is within the 3 % that edges
        # are promised to without a word need not be said; all others must
        harmless = kind == "second" and abs(found.mtf50 / truth - 1) < 0.03
    except ValueError as error:
        assert kind != "sharpened"
        said = str(error)
    assert harmless or re.search(words, said)


@pytest.mark.parametrize("draw", [9003, 9007, 9014, 9021, 1, 2])
def test_sharpening_is_said_where_noise_is_strong_and_alone(draw):
    sharp, plain = (
        odd_edge(kind, np.random.default_rng(draw), noise=0.05)[0]
        for kind in ("sharpened", "plain")
    )
    assert "sharpened" in fit_edge(sharp).remarks
    (said,) = fit_edge(plain).remarks
    assert re.search(r"^MTF50 may be off by (\d|1\d)%, as its interval says$", said)


@settings(max_examples=6, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    noise=st.sampled_from([0.0, 0.01]),
    angle=st.sampled_from([None, 26.565, 40.0, 45.0]),
)
@example(seed=3, noise=0.0, angle=45.0)  # .12 for .28 where noise of none is believed
@example(seed=627754, noise=0.0, angle=45.0)
def test_one_straight_edge_is_measured_without_a_remark(seed, noise, angle):
    image, truth = odd_edge("plain", np.random.default_rng(seed), noise=noise, angle_deg=angle)
    found = fit_edge(image)
    few_phases = found.mtf50_sigma > 0.015 * found.mtf50  # of 45 degrees
    assert (found.remarks == ()) != (few_phases and "its interval" in found.remarks[0])
    assert found.mtf50 == pytest.approx(truth, abs=max(4 * found.mtf50_sigma, 0.03 * truth))
    assert found.mtf50 == pytest.approx(truth, rel=0.1)


def of_camera(degrees, seed, *, shape=(80, 80), noise=0.02, low=0.12, step=0.63):
    """An edge by quadrature at any angle up to 45 degrees, turned at random, and its MTF50."""
    rng = np.random.default_rng(seed)
    sigma, angle, place = rng.uniform(0.5, 1.1), np.radians(degrees), rng.uniform(-2, 2)
    image = slanted_edge(sigma, angle, place, shape=shape, levels=(low, low + step))
    image += noise * step * rng.standard_normal(shape)
    return np.rot90(image, rng.integers(4)), true_mtf50(sigma, angle)


SLOPES = {"1:1": 1, "1:2": 1 / 2, "1:3": 1 / 3, "2:3": 2 / 3, "1:4": 1 / 4, "3:4": 3 / 4}


@pytest.mark.parametrize("slope", SLOPES.values(), ids=SLOPES)
def test_edges_along_a_repeated_step_of_the_grid_are_measured_as_others_are(slope):
    for seed, shape in enumerate([(80, 80), (120, 50), (50, 120)]):
        image, truth = of_camera(np.degrees(np.arctan(slope)), seed, shape=shape)
        assert fit_edge(image).mtf50 == pytest.approx(truth, rel=0.04)


@pytest.mark.parametrize("degrees", [4, 13, 22, 31, 38, 41.5, 44])
def test_edges_at_any_angle_in_noise(degrees):
    fits = []
    for seed in range(4):
        image, truth = of_camera(degrees, seed, shape=(120, 60), noise=0.03)
        found = fit_edge(image)
        noisy = 1.96 * found.mtf50_sigma > 0.03 * found.mtf50  # then, and only then, it is said
        assert bool(found.remarks) == noisy, found.remarks
        fits.append(found.mtf50 / truth - 1)
    assert np.sqrt(np.mean(np.square(fits))) < 0.031  # sfrmat5 has so much at this noise


def test_a_steep_profile_is_read_nowhere_beyond_its_bins():
    rng = np.random.default_rng(11)
    y, x = np.mgrid[:80, :80]
    angle = np.arctan(0.5)
    d = (x - 39.5 - rng.uniform(-2, 2)) * np.cos(angle) + (y - 39.5) * np.sin(angle)
    image = 0.12 + 0.63 * spread_edge(d, 0.7, angle) + 0.012 * rng.normal(size=(80, 80))
    assert fit_edge(image).mtf50 == pytest.approx(true_mtf50(0.7, angle), rel=0.03)


def test_compression_widens_the_interval_and_is_said_where_it_is_strong():
    """JPEG leaves nothing far from an edge and rings beside it; noise is the same at both."""
    off = []
    for seed in range(6):
        image, truth = of_camera(6, seed, noise=0.005)
        assert fit_edge(image).remarks == ()
        codes = np.uint8(np.round(255 * np.clip(image, 0, 1)))
        file = cv2.imencode(".jpg", codes, [cv2.IMWRITE_JPEG_QUALITY, 50])[1]
        found = fit_edge(cv2.imdecode(file, 0) / 255)
        assert "as of compression: MTF50 may be off by" in found.remarks[0]
        off.append((found.mtf50 - truth) / found.mtf50_sigma)
    assert np.abs(off).max() < 3  # 3.9 without what compression leaves
    assert np.sqrt(np.mean(np.square(off))) > 0.5  # nor is the interval far too wide


def test_hot_pixels_are_left_out_and_counted(rng):
    image, truth = of_camera(6, 3, noise=0.01)
    assert fit_edge(image).remarks == ()
    hot = rng.random(image.shape) < 0.005
    image[hot] = rng.choice([0, 1.0], hot.sum())
    found = fit_edge(image)
    assert int(found.remarks[0].split()[0]) == pytest.approx(hot.sum(), abs=0.3 * hot.sum())
    assert found.mtf50 == pytest.approx(truth, rel=0.02)


@pytest.mark.parametrize("axis", [0, 1])
def test_light_that_changes_over_the_image_is_taken_out(axis):
    for seed in range(3):
        image, truth = of_camera(6, seed, noise=0.01)
        light = 1 + 0.2 * (np.indices(image.shape)[axis] / 80 - 0.5)
        found = fit_edge(image * light)
        assert found.remarks == ()
        assert found.mtf50 == pytest.approx(truth, rel=0.02)


def test_few_grey_values_are_no_clipping_and_have_no_interval_without_noise():
    for noise, said in ((0.04, False), (0.0, True)):
        image, truth = of_camera(6, 1, noise=noise, low=0.2, step=0.08)
        found = fit_edge(np.round(255 * image) / 255)
        assert [remark[:19] for remark in found.remarks] == [
            "20 grey values in t" if said else "MTF50 may be off by"
        ]
        assert np.isnan(found.mtf50_sigma) == said
        assert found.mtf50 == pytest.approx(truth, rel=0.1)


def test_an_edge_in_other_units_is_the_same_edge():
    images = [of_camera(*one)[0] for one in ((6, 2), (6, 3), (4, 2))]
    for image, method in product(images, ("binned", "sigmoid", "logistic")):
        widths = [fit_edge(scale * image + scale, method=method) for scale in (1, 1e-7, 1e9)]
        assert np.ptp([one.mtf50 for one in widths]) < 1e-7


def test_intervals_hold_where_noise_is_strong():
    fits = [(fit_edge(image), truth) for image, truth in (
        odd_edge("plain", np.random.default_rng(k), noise=0.05) for k in range(30)
    )]  # fmt: skip
    errors = np.array([(fit.mtf50 - truth) / fit.mtf50_sigma for fit, truth in fits])
    assert np.mean(np.abs(errors) < 1.96) >= 0.86
    assert np.std(errors) > 0.7  # and are not wider than they must be


def test_transfer_functions_of_lenses_are_the_integrals_of_their_spreads():
    f, r = np.array([0.03, 0.1, 0.22, 0.4]), np.linspace(1e-6, 60, 100_001)

    def hankel(spread):
        weight = spread * r
        waves = j0(2 * np.pi * f[:, None] * r)
        return np.trapezoid(waves * weight, r) / np.trapezoid(weight, r)

    assert transfer._gauss(f * 1.3) == pytest.approx(hankel(np.exp(-(r**2) / 2 / 1.3**2)), abs=1e-5)
    assert transfer._disc(f * 2.0) == pytest.approx(hankel(r <= 2.0), abs=1e-3)
    assert transfer.tail_mtf(f * 1.5) == pytest.approx(hankel(np.exp(-r / 1.5)), abs=1e-5)
    # the share that two discs of diameter 1 have in common where their middles are x apart
    x = np.array([0.0, 0.2, 0.5, 0.9, 1.0, 1.4])
    at = (np.arange(800) + 0.5) / 400 - 1
    u, v = np.meshgrid(at, at)
    both = [(np.hypot(u - k / 2, v) < 0.5) & (np.hypot(u + k / 2, v) < 0.5) for k in x]
    assert transfer._diffraction(x) == pytest.approx(np.sum(both, axis=(1, 2)) / np.sum(both[0]),
                                                     abs=5e-3)  # fmt: skip
    pixel = [np.mean([np.sinc(k * np.cos(t)) * np.sinc(k * np.sin(t))
                      for t in np.linspace(0, 2 * np.pi, 720)]) for k in f]  # fmt: skip
    assert transfer.lens_mtf(transfer._gauss, 0.8, f) == pytest.approx(
        np.exp(-2 * (np.pi * 0.8 * f) ** 2) * pixel, abs=2e-4
    )


def test_an_edge_seen_by_square_pixels_is_the_integral_over_them():
    sigma, angle = 0.6, 0.3
    u, v = np.meshgrid(*[(np.arange(60) + 0.5) / 60 - 0.5] * 2)
    for distance in (-1.2, -0.3, 0.0, 0.45, 1.0):
        off = distance + u * np.cos(angle) + v * np.sin(angle)
        expected = ndtr(off / sigma).mean()
        assert transfer.spread_edge([distance], sigma, angle)[0] == pytest.approx(
            expected, abs=1e-4
        )


def test_widths_bins_and_waves_of_profiles_are_those_of_plain_sums(rng):
    places = np.linspace(-6, 6, 1201)
    lsf = np.exp(-(places**2) / 2 / 0.9**2)
    assert transfer.full_width(places, lsf) == pytest.approx(
        2 * 0.9 * np.sqrt(2 * np.log(2)), abs=2e-4
    )
    distance, values = rng.uniform(-3, 3, 400), rng.normal(size=400)
    at, mean, count, variance = transfer.profile(distance, values)
    bins = np.round(distance * transfer.BINS_PER_PIXEL)
    groups = [bins == k for k in np.unique(bins)]
    assert at == pytest.approx([distance[k].mean() for k in groups])
    assert mean == pytest.approx([values[k].mean() for k in groups])
    assert count.tolist() == [k.sum() for k in groups]
    within = sum(((values[k] - values[k].mean()) ** 2).sum() for k in groups)
    assert variance == pytest.approx(within / (400 - len(groups)))
    f = np.array([0.1, 0.4])
    waves = transfer._waves(f, np.array([0.3, -1.0]))
    assert waves == pytest.approx(np.exp(-2j * np.pi * np.outer(f, [0.3, -1.0]))
                                  / np.sinc(f / transfer.NARROW_BINS)[:, None])  # fmt: skip


def test_terms_of_a_curve_are_a_level_a_sigmoid_two_tails_and_splines_that_end_at_zero():
    fit = SimpleNamespace(spread=0.8, width=0.7, angle=0.1)
    ends, place = (-12.0, 9.0), np.linspace(-12, 9, 211)
    terms, prior = transfer._terms(place, fit, ends)
    assert (terms[:, 0] == 1).all()
    assert terms[:, 1] == pytest.approx(transfer.spread_edge(place, 0.7, 0.1))
    for column, side in ((2, -1), (3, 1)):
        away = np.maximum(side * place, 0) / 1.6
        assert terms[:, column] == pytest.approx(-side * away**3 / (1 + away**2) ** 2 / 1.6)
    assert np.abs(terms[[0, -1], 4:]).max() < 1e-12
    assert prior[:4].tolist() == [0, 0, transfer.TAIL**-2, transfer.TAIL**-2]
    assert set(prior[4:]) == {transfer.LOOSE_NEAR**-2, transfer.LOOSE_FAR**-2}
    peaks = place[terms[:, 4:].argmax(axis=0)]
    near = np.abs(peaks) < 2 * transfer.CORE * 0.8
    clear = np.abs(np.abs(peaks) - 2 * transfer.CORE * 0.8) > 1
    assert np.array_equal((prior[4:] == transfer.LOOSE_NEAR**-2)[clear], near[clear])
    knots = transfer._knots(0.8, ends)
    assert (knots[:4] == -12).all()
    assert (knots[-4:] == 9).all()
    steps = np.diff(knots[3:-3])
    core = np.abs(knots[4:-4]) < transfer.CORE * 0.8 - 1e-9
    assert steps[:-1][core] == pytest.approx(max(transfer.KNOT * 0.8, 0.3))
    assert (np.diff(steps[knots[3:-4] >= 0][:-1]) > -1e-9).all()  # wider and wider outwards


@pytest.mark.parametrize("angle", [0.1, -0.35, np.pi / 2 + 0.2, np.pi - 0.15])
def test_the_line_of_an_edge_is_found_where_it_was_drawn(angle):
    y, x = np.mgrid[:60, :50]
    across = (x - 24.5) * np.cos(angle) + (y - 29.5) * np.sin(angle) - 1.3
    image = transfer.spread_edge(across, 0.8, angle)
    found, along, turned = edges._line(image)
    assert np.degrees(np.abs(np.angle(np.exp(1j * (turned - angle))))) < 0.3
    assert np.abs(found - across.ravel())[np.abs(across.ravel()) < 5].max() < 0.15
    beside = (y - 29.5) * np.cos(angle) - (x - 24.5) * np.sin(angle)
    assert np.abs(along - beside.ravel()).max() < 0.4


@pytest.mark.parametrize("tail", [0.0, 0.06])
def test_light_that_slopes_on_either_side_is_taken_out_to_the_step(tail, rng):
    across, along = rng.uniform(-14, 14, 6000), rng.uniform(-30, 30, 6000)
    low, high = 0.1 + 0.002 * along, 0.9 + 0.004 * along - 0.003 * across
    stray = np.where(np.abs(across) > 1, tail / np.maximum(np.abs(across), 1), 0)
    edge = ndtr(across / 0.5)
    values = low + (high - low) * edge - np.sign(across) * stray
    values += 0.002 * rng.standard_normal(6000)
    even, step = edges._under_even_light(across, along, values, 0.6)
    assert step == pytest.approx(np.median(0.8 + 0.002 * along - 0.003 * across), abs=0.005)
    far = np.abs(across) > 4
    left = even - edge + np.sign(across) * stray / (high - low)
    assert np.abs(left[far]).mean() < 0.006
    assert abs(left[far & (across > 0)].mean()) < 0.0022
    assert abs(left[far & (across < 0)].mean()) < 0.0022
    noisy = edges._noise(across, even, 0.6)
    assert tail or np.median(noisy[across < -1]) == pytest.approx(0.002 / 0.8, rel=0.4)


def star_pixels(place=(30.3, 29.1, 0.0, 0.0), n=12, radius=28.0, levels=(0.2, 0.8), size=60):
    """Pixels of a star without any blur, with its sectors' share of each pixel."""
    fine = 8
    at = (np.arange(size * fine) + 0.5) / fine - 0.5
    x, y = np.meshgrid(at, at)
    r, azimuth = stars._polar((x, y), place)
    bright = (np.cos(n * azimuth) > 0) & (r < radius)
    image = bright.reshape(size, fine, size, fine).mean(axis=(1, 3))
    image = levels[0] + (levels[1] - levels[0]) * image
    x, y = np.meshgrid(np.arange(float(size)), np.arange(float(size)))
    return x.ravel(), y.ravel(), image.ravel()


def test_an_ellipse_of_a_tilted_star_is_made_round_and_its_tilt_is_told():
    turn = np.linspace(0, 6, 9)
    for degrees, way in ((0, 0.3), (25, 0.3), (50, -1.1)):
        shrink = np.cos(np.radians(degrees))
        # a circle seen narrower along a direction, then scaled to the same area
        c, s = np.cos(way), np.sin(way)
        along, across = np.cos(turn) * shrink, np.sin(turn)
        x, y = 5 + along * c - across * s, 7 + along * s + across * c
        stretch = (1 - shrink) / (1 + shrink)
        place = (5, 7, stretch * np.cos(2 * way), stretch * np.sin(2 * way))
        r, _ = stars._polar((x, y), place)
        assert np.ptp(r) < 1e-9
        assert stars._tilt(place) == pytest.approx(degrees, abs=1e-6)


def test_levels_of_sectors_are_those_in_their_middle_and_waves_have_their_amplitudes(rng):
    place, n = (30.3, 29.1, 0.0, 0.0), 12
    pixels = star_pixels(place, n)
    levels, borders, _ = stars._plain_levels(pixels, place, n, 28.0)
    assert levels == pytest.approx([0.2, 0.8], abs=0.01)
    assert (borders > 0).all()
    r, azimuth = stars._polar(pixels, place)
    ripple = 0.5 + 0.13 * np.cos(n * azimuth) - 0.07 * np.sin(n * azimuth)
    ripple = ripple + 0.04 * np.cos(2 * n * azimuth) + 0.02 * np.sin(3 * n * azimuth)
    waved = (*pixels[:2], ripple + 0.002 * rng.standard_normal(len(r)))
    found, error = stars._ring(waved, place, n, 20.0)
    # the second harmonic is no term of the ring's fit: it is noise that even sectors average out
    assert found == pytest.approx([0.13, -0.07], abs=4 * error)
    inside = np.abs(r - 20) < 1
    assert error == pytest.approx(np.sqrt(0.04**2 / 2) / np.sqrt(inside.sum() / 2), rel=0.35)
    size = np.hypot(0.13, 0.07)
    found = stars._harmonics(waved, place, n, 20.0)
    assert found == pytest.approx([0.04 / size, 0.02 / size], abs=0.01)
    parts = stars._outer_parts(waved, place, n, 28.0)
    assert len(parts) == stars.STAR_PARTS
    assert np.abs(parts - (0.13 + 0.07j) / 2).max() < 0.02


def test_the_centre_and_the_ellipse_of_a_star_are_refined_to_where_it_is():
    true = (30.3, 29.1, 0.06, -0.04)
    r, azimuth = stars._polar(star_pixels(true)[:2], true)
    falls = np.exp(-((12 / (2 * np.pi * np.maximum(r, 1))) ** 2) * 3)
    pixels = (*star_pixels(true)[:2], 0.5 + 0.3 * falls * np.cos(12 * azimuth + 0.4))
    found = stars._refined(pixels, np.array([30.0, 29.5, 0.0, 0.0]), 12, np.array([8.0, 20.0]))
    assert found == pytest.approx(np.array(true), abs=2e-3)


@pytest.mark.parametrize("share", [0.0, 0.2])
def test_the_lens_behind_contrasts_and_its_tail_are_told(share):
    f = np.linspace(0.02, 0.35, 30)
    plain = transfer.lens_mtf(transfer._gauss, 0.8, f)
    contrast = 0.7 * plain * (1 - share + share * transfer.tail_mtf(stars.TAILS_PX[0] * f))
    lens, tail = stars._lens_of(f, contrast)
    assert lens(f) == pytest.approx(contrast / 0.7, rel=0.03)
    assert tail == pytest.approx(share, abs=0.05)
    borders = np.array([[5.0, 3.0], [5.0, 7.0]])
    # a wide square wave behind a lens that takes nothing has pi / 4 of its fundamental
    assert stars._plain_level(lambda q: 1.0 + 0 * q, borders) == pytest.approx(np.pi / 4, abs=0.04)
    assert stars._plain_level(lambda q: (q < 0.06) * 1.0, borders) == pytest.approx(
        np.mean(np.sin(np.pi * np.array([0.5, 0.3])))
    )


def fitted(distance, along, values, **known):
    """An edge as the doubts look at it."""
    places, means, count, variance = transfer.profile(distance, values)
    sigmoid = transfer.spread_edge(distance, 0.7, 0.1)
    given = {"distance": distance, "along": along, "values": values, "grey": values}
    given |= {"bins": (places, means, count, variance), "residuals": values - sigmoid}
    given |= {"spread": np.hypot(0.7, 12**-0.5), "width": 0.7, "angle": 0.1, "grain": 1e-3}
    given |= {"length": np.ptp(along), "rounding": 0.0, "rounded_alike": False}
    return SimpleNamespace(**(given | known))


@pytest.fixture
def grid():
    """Places across and along an edge, many a pixel."""
    across, along = np.meshgrid(np.arange(-16, 16, 0.13), np.arange(-30, 30, 0.5))
    return across.ravel(), along.ravel()


def test_an_edge_is_as_bent_as_its_places_scatter(grid):
    across, along = grid
    for size in (0.0, 0.15, 0.4):
        off = size * np.sign(np.sin(along / 4))
        values = transfer.spread_edge(across - off, 0.7, 0.1)
        fit = fitted(across, along, values)
        assert mtf_doubts.bend(fit) * fit.spread == pytest.approx(size, rel=0.2, abs=0.02), size
    tilted = transfer.spread_edge(across - 0.004 * along, 0.7, 0.1)  # is no bend
    assert mtf_doubts.bend(fitted(across, along, tilted)) < 0.02


def test_a_second_step_is_told_with_its_height_and_its_side(grid):
    across, along = grid
    for place, height in ((8.0, 0.05), (-9.0, 0.1)):
        values = transfer.spread_edge(across, 0.7, 0.1) + height * (across > place)
        fit = fitted(across, along, values + 1e-6 * np.sin(1e4 * along))
        side = 1 if place > 0 else -1
        assert mtf_doubts.second_step(fit, side) == pytest.approx(height, rel=0.2)
        assert mtf_doubts.second_step(fit, -side) < height / 20
    slope = transfer.spread_edge(across, 0.7, 0.1) + 0.001 * np.maximum(across, 0)
    assert mtf_doubts.second_step(fitted(across, along, slope), 1) < 0.01


def test_lobes_and_halves_that_differ_are_told_by_their_size(grid):
    across, along = grid
    plain = transfer.spread_edge(across, 0.7, 0.1)
    lobes = 0.06 * np.exp(-((np.abs(across) - 2.5) ** 2) / 2) * np.sign(across)
    found = mtf_doubts.overshoot(fitted(across, along, plain + lobes))
    assert found == pytest.approx(0.06, rel=0.25)
    assert mtf_doubts.overshoot(fitted(across, along, plain)) < 0.005
    assert mtf_doubts.overshoot(fitted(across, along, plain + np.abs(lobes))) < 0.02  # one side's
    assert mtf_doubts.one_sided(fitted(across, along, plain)) < 0.003
    odd = plain + 0.1 * np.exp(-((across - 1.5) ** 2))
    assert 0.01 < mtf_doubts.one_sided(fitted(across, along, odd)) < 0.1
    assert mtf_doubts.strangeness(fitted(across, along, plain)) <= 0
    assert mtf_doubts.strangeness(fitted(across, along, odd)) == pytest.approx(0.1, rel=0.1)


@pytest.mark.parametrize(
    ("tail", "taken"), [(0.05, True), (0.4, True), (-0.2, False), (0.7, False)]
)
def test_a_lens_s_tail_is_taken_off_and_what_is_none_stays(tail, taken):
    """A tail falls with the inverse of the distance, to at most half a spread of the step."""
    rng, spread = np.random.default_rng(3), 1.0
    across, along = rng.uniform(-30, 30, 4000), rng.uniform(-40, 40, 4000)
    side = np.sign(across)
    stated = tail * spread / np.maximum(np.abs(across), 1)  # of what each side misses of its level
    values = 100 + 50 * side * (1 - 2 * stated) + rng.normal(0, 0.1, 4000)
    even, step = edges._under_even_light(across, along, values, spread)
    far = np.abs(across) > 6
    missing = np.abs(even - (side > 0))[far]
    assert (abs(step - 100) < 1) == taken
    assert (np.abs(missing - stated[far]).max() < 0.006) == taken
