"""Steps of photographs and rendered targets: views, windows, samples, noise, point spreads."""

from types import SimpleNamespace

import numpy as np
import pytest
from rendered import step_seen_by_pixel
from scipy.integrate import quad
from scipy.special import ndtr

from mmqa_lab import charts
from mmqa_lab.charts import Bar, Layout
from mmqa_lab.mtf.transfer import spread_edge
from mmqa_lab.simulate import cameras
from mmqa_lab.simulate.cameras import ChartMap, Optics, PanoramaCamera, Sensor, chart_view
from mmqa_lab.simulate.targets import (
    PointSpread,
    expose,
    render_bars,
    render_edge,
    render_star,
)
from mmqa_lab.simulate.targets.resolution import _render

BAR = Layout("bar", 100, 60, (Bar("a", 30, 20, 40, 20),))


def flat_map(scale, place):
    """Pixels per mm straight on, and the pixel of the chart's lower left corner."""
    return ChartMap(np.array([[scale, 0, place[0]], [0, -scale, place[1]], [0, 0, 1.0]]))


@pytest.mark.parametrize(("roll", "aim"), [(0, 0), (20, 0), (0, 15), (-30, 40)])
def test_turned_is_a_level_camera_rolled_about_its_view_and_aimed_aside(roll, aim):
    place = np.array([3.0, -4.0, 0.0])
    found = cameras._turned(place, *np.radians([roll, aim]))
    assert found @ found.T == pytest.approx(np.eye(3), abs=1e-12)
    view, level = np.array([-0.6, 0.8, 0]), np.array([0.8, 0.6, 0])
    r, a = np.radians([roll, aim])
    right = np.cos(r) * level + np.sin(r) * np.array([0, 0, -1.0])  # down on its right side
    assert found[2] == pytest.approx(np.cos(a) * view + np.sin(a) * right)
    assert found[0] == pytest.approx(np.cos(a) * right - np.sin(a) * view)
    assert found[1] == pytest.approx(np.cross(found[2], found[0]))
    camera = PanoramaCamera(40_000)
    chart = chart_view(
        camera, distance=4, layout=BAR, heading_deg=36.87, roll_deg=roll, aim_deg=aim
    )
    corners = np.array([[0.0, 0], [100, 0], [100, 60], [0, 60]])
    there = np.column_stack([(corners[:, 0] - 50) / 1000, np.zeros(4), (corners[:, 1] - 30) / 1000])
    eye = np.array([4 * np.tan(np.radians(36.87)), -4.0, 0])
    rays = (there - eye) @ cameras._turned(eye, r, a).T
    assert chart.pixels(corners) == pytest.approx(camera.pixels(rays))


def test_window_is_the_chart_with_its_margin_within_the_panorama():
    low, size = cameras._window(BAR, flat_map(0.5, (20.3, 71.8)), 12)
    # columns 20.3 to 70.3, rows 41.8 to 71.8
    assert low.tolist() == [8, 29]
    assert size.tolist() == [71 + 12 + 1 - 8, 72 + 12 + 1 - 29]
    camera = PanoramaCamera(60)
    matrix = np.array([[0.001, 0, -0.05], [0, -0.001, 0.03], [0, 0, 0.1]])
    low, size = cameras._window(BAR, ChartMap(matrix, camera), 40)
    assert low.tolist() == [0, 0]
    assert size.tolist() == [60, 30]
    for wrong in (flat_map(500.0, (5, 9)), flat_map(np.nan, (1, 1))):
        with pytest.raises(ValueError, match="Must be in view"):
            cameras._window(BAR, wrong, 0)
    assert cameras._window(BAR, flat_map(0.005, (0.2, 0.8)), 0)[1].tolist() == [2, 2]


def moment(profile):
    """Variance of a rise from 0 to 1 about its middle, and the middle."""
    step = np.diff(profile)
    place = np.arange(len(step)) + 0.5
    middle = (step * place).sum() / step.sum()
    return (step * (place - middle) ** 2).sum() / step.sum(), middle


@pytest.mark.parametrize(("sigma", "scale"), [(0.2, 0.5), (0.6, 0.3), (1.1, 0.4)])
def test_exposed_edges_have_the_variance_of_their_optics_and_pixels(sigma, scale):
    """An edge of many phases: the optics', that of the pixel and of taking differences, 1/12."""
    found, off = [], []
    for phase in np.linspace(0, 1, 24, endpoint=False):
        layout = Layout("edge", 80, 20, (Bar("b", 0, 0, 40 + 1.618 * phase / scale % 1, 20),))
        view = flat_map(scale, (phase, 8.0))
        tones = cameras._exposed(layout, view, (int(80 * scale), 8), Optics(sigma), colour=False)
        row = tones[5, int(40 * scale) - 6 : int(40 * scale) + 8]
        variance, middle = moment(row)
        found.append(variance)
        off.append(middle + int(40 * scale) - 6 - layout["b"].width * scale - phase)
    assert np.mean(found) == pytest.approx(sigma**2 + 1 / 6, rel=0.01, abs=0.002)
    assert np.mean(off) == pytest.approx(0, abs=0.01)


def test_exposed_motion_and_defocus_add_their_variances():
    layout = Layout("edge", 80, 40, (Bar("b", 0, 0, 40, 40),))

    def variance(optics):
        rows = []
        for phase in np.linspace(0, 1, 8, endpoint=False):
            view = flat_map(0.5, (phase, 16.0))
            tones = cameras._exposed(layout, view, (40, 16), optics, colour=False)
            rows.append(moment(tones[8, 8:33])[0])
        return np.mean(rows)

    plain = variance(Optics(0.5))
    assert variance(Optics(0.5, travel=(4.0, 0, 0))) - plain == pytest.approx(16 / 12, rel=0.02)
    assert variance(Optics(0.5, travel=(0, 4.0, 0))) - plain == pytest.approx(0, abs=0.01)
    # a disc's variance along a direction is a quarter of its radius squared
    assert variance(Optics(0.5, defocus_px=2.0)) - plain == pytest.approx(1.0, rel=0.04)
    around = cameras._exposed(layout, flat_map(0.5, (10.0, 30.0)), (60, 40), Optics(0.3), False)
    assert around[3:7, 3:7] == pytest.approx(0.4, abs=1e-6)  # beyond the chart
    assert around[20, 40] == pytest.approx(1.0, abs=1e-6)
    assert around[20, 20] == pytest.approx(0.0, abs=1e-6)
    colour = cameras._exposed(layout, flat_map(0.5, (10.0, 30.0)), (60, 40), Optics(0.3), True)
    assert colour.shape == (40, 60, 3)


def test_samples_lie_in_sixths_of_a_pixel_about_its_centre():
    # OpenCV 4 finds places to a 64th of a cell, whose neighbours differ by 0.005 and 0.008
    x = np.arange(200) * 0.5 + 0.25  # mm of cells half a millimetre wide
    printed = np.tile(np.float32(x / 100), (120, 1))
    view = flat_map(0.5, (3.0, 28.0))
    found = cameras._sampled(printed, 0.5, view, (40, 20))
    assert found.shape == (120, 240)
    column = (np.arange(240) + 0.5) / 6 - 0.5
    place = (column - 3) / 0.5
    known = (place > 1) & (place < 99)
    assert found[60, known] == pytest.approx(place[known] / 100, abs=1.5e-4)
    assert found[60, 0] == pytest.approx(0.4)
    upright = np.tile(np.float32((np.arange(120) * 0.5 + 0.25) / 60), (200, 1)).T.copy()
    found = cameras._sampled(upright, 0.5, view, (40, 20))
    row = (np.arange(120) + 0.5) / 6 - 0.5
    high = (28 - row) / 0.5
    known = (high > 1) & (high < 59)
    assert found[known, 120] == pytest.approx(high[known] / 60, abs=1.5e-4)


def test_recorded_noise_is_half_constant_and_half_in_proportion_to_the_signal():
    one = SimpleNamespace(standard_normal=lambda shape: np.ones(shape))
    signal = np.array([[-0.2, 0.0, 0.5, 1.0]])
    found = cameras._recorded(signal, Sensor(noise=0.04), one)
    expected = signal + 0.04 * np.sqrt(0.5 * np.clip(signal, 0, None) + 0.5)
    assert found == pytest.approx(expected, abs=1e-6)
    none = Sensor(noise=0.0, bits=8)
    levels = np.array([[-0.1, 0.4 / 255, 0.6 / 255, 99.4 / 255, 99.6 / 255, 1.2]])
    assert cameras._recorded(levels, none, one).tolist() == [[0, 0, 1, 99, 100, 255]]
    coded = cameras._recorded(np.full((16, 16), 0.2), Sensor(noise=0, bits=8, gamma="srgb"), one)
    assert (coded == round(255 * (1.055 * 0.2 ** (1 / 2.4) - 0.055))).all()
    curve, packed = np.tile(np.linspace(0, 1, 64), (64, 1)) ** 2, {"noise": 0, "bits": 8}
    files = [cameras._recorded(curve, Sensor(**packed, jpeg_quality=q), one) for q in (5, 95)]
    plain = cameras._recorded(curve, none, one)
    losses = [np.abs(file.astype(float) - plain).mean() for file in files]
    assert losses[0] > 3 * losses[1] > 0
    wide = cameras._recorded(np.full((8, 8), 0.5), Sensor(noise=0, bayer=True), one)
    assert wide == pytest.approx(np.full((8, 8, 3), 0.5), abs=1e-4)


@pytest.mark.parametrize("shape", [(20, 31), (27, 24)])
@pytest.mark.parametrize("angle", [0.0, 12.0, -70.0])
def test_rendered_edges_are_the_integrals_over_their_pixels(shape, angle):
    image = render_edge(
        shape, PointSpread(0.7), angle_deg=angle, position_px=1.3, low=0.2, high=0.9
    )
    y, x = np.mgrid[: shape[0], : shape[1]]
    turn = np.radians(angle)
    x, y = x - (shape[1] - 1) / 2, y - (shape[0] - 1) / 2
    across = x * np.cos(turn) + y * np.sin(turn) - 1.3
    expected = 0.2 + 0.7 * spread_edge(across, 0.7, turn)
    inner = slice(1, -1), slice(1, -1)
    assert np.abs(image - expected)[inner].max() < 2e-3


def test_render_draws_where_the_distance_is_positive_and_keeps_the_light():
    image = _render((41, 51), PointSpread(0.8), lambda x, y: 6.0 - np.hypot(x - 4, y + 3), 0.0, 1.0)
    y, x = np.mgrid[:41, :51]
    x, y = x - 25 - 4, y - 20 + 3
    assert image.sum() == pytest.approx(np.pi * 36, rel=2e-3)
    assert (image * x).sum() == pytest.approx(0, abs=0.05)
    assert (image * y).sum() == pytest.approx(0, abs=0.05)
    # a disc's variance, the lens's and the pixel's
    assert (image * x**2).sum() / image.sum() == pytest.approx(9 + 0.64 + 1 / 12, rel=3e-3)
    assert image.max() < 1.0001
    star = render_star(
        (61, 61), PointSpread(0.4), cycles=6, radius_px=28.0, half=True, low=0, high=1
    )
    assert star[:28].sum() > 100  # upwards in the image
    assert np.abs(star[34:]).max() < 1e-3
    tilted = render_star((61, 61), PointSpread(0.4), cycles=6, radius_px=28.0, tilt_deg=60)
    wide = np.ptp(np.nonzero((tilted > 0.3).any(axis=0))[0])
    assert wide == pytest.approx(28, abs=2)
    moved = render_star((61, 61), PointSpread(0.4), cycles=6, radius_px=20.0, centre=(5.0, -3.0))
    assert moved[4:55, 10:61] == pytest.approx(
        render_star((51, 51), PointSpread(0.4), cycles=6, radius_px=20.0, centre=(0.0, 0.0))[
            :51, :51
        ],
        abs=0.6,
    )


def test_point_spreads_have_their_transfer_and_their_width():
    spread = PointSpread(0.6)
    assert spread.mtf(0.2, 0.3) == pytest.approx(
        np.exp(-2 * (np.pi * 0.6) ** 2 * (0.04 + 0.09)) * np.sinc(0.2) * np.sinc(0.3)
    )

    def line(d):
        """The line spread across an upright edge: a Gaussian behind a pixel."""
        return ndtr((d + 0.5) / 0.6) - ndtr((d - 0.5) / 0.6)

    half = spread.fwhm(0) / 2
    assert line(half) == pytest.approx(line(0) / 2, rel=1e-4)
    oblique = PointSpread(0.6).fwhm(45) / 2

    def weight(d):
        """The same across a diagonal: the pixel is a triangle from there."""
        seen = lambda u: (1 - abs(u) * 2**0.5) * np.exp(-(((d - u) / 0.6) ** 2) / 2)  # noqa: E731
        return quad(seen, -(0.5**0.5), 0.5**0.5)[0]

    assert weight(oblique) == pytest.approx(weight(0) / 2, rel=1e-3)
    f = spread.mtf50(30)
    turn = np.radians(30)
    assert spread.mtf(f * np.cos(turn), f * np.sin(turn)) == pytest.approx(0.5)
    mean = [spread.mtf(0.3 * np.cos(a), 0.3 * np.sin(a)) for a in np.linspace(0, 2 * np.pi, 720)]
    assert spread.mtf_mean(np.array([0.3]))[0] == pytest.approx(np.mean(mean), abs=1e-3)


def test_exposed_light_has_its_gain_its_noise_and_its_bits():
    light = np.full(20_000, 30.0)
    found = expose(light, gain=10.0, offset=50.0, bits=12, seed=3)
    assert (found == np.round(found)).all()
    assert found.mean() == pytest.approx(350, abs=0.2)
    assert found.std() == pytest.approx(np.sqrt(300 / 10 + 4 + 1 / 12), rel=0.02)
    dark = expose(0 * light, gain=10.0, offset=50.0, seed=3)
    assert dark.std() == pytest.approx(np.sqrt(4 + 1 / 12), rel=0.02)
    bright = expose(100 * light, gain=10.0, bits=10, seed=3)
    assert (bright == 1023).all()
    assert expose(0 * light - 9, gain=10.0, seed=3).min() == 0
    assert charts.imaging_chart().width == 1000


@pytest.mark.parametrize("bars", [1, 4, 5])
def test_rendered_bars_have_their_number_width_length_and_place(bars):
    image = render_bars((48, 60), PointSpread(0.5), period_px=7.0, bars=bars, offset_px=1.7,
                        low=0.0, high=1.0)  # fmt: skip
    x, y = np.arange(60) - 29.5, np.arange(48) - 23.5

    def seen(at, low, high):
        """An interval behind a Gaussian and a pixel, along one axis."""
        ends = [step_seen_by_pixel(at - end, 0.5) for end in (low, high)]
        return ends[0] - ends[1]

    across = sum(
        seen(x, middle - 1.75, middle + 1.75)
        for middle in 1.7 + 7.0 * (np.arange(bars) - (bars - 1) / 2)
    )
    expected = np.outer(seen(y, -8.75, 8.75), across)
    assert np.abs(image - expected).max() < 0.02  # corners are drawn a little rounder
    assert image.sum() == pytest.approx(bars * 3.5 * 17.5, rel=3e-3)
