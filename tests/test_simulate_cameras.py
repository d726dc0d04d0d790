"""Photographs against closed forms of what pixels see."""

import numpy as np
import pytest
from rendered import slanted_edge, step_seen_by_pixel
from scipy.ndimage import gaussian_filter
from scipy.special import j1

from mmqa_lab import charts
from mmqa_lab.charts import Bar, Layout, LinePairs, decode
from mmqa_lab.simulate import cameras
from mmqa_lab.simulate.cameras import (
    ChartMap,
    Optics,
    PanoramaCamera,
    Sensor,
    chart_view,
    photograph,
)
from mmqa_lab.simulate.targets import texture
from mmqa_lab.simulate.targets.resolution import (
    PointSpread,
    blur_over_image,
    render_bars,
    render_star,
)
from mmqa_lab.studies import image_resolution

IDEAL = Sensor(black=0.0, white=1.0, noise=0.0)

CHART = charts.imaging_chart()

WITHIN = slice(19, -19), slice(19, -19)
"""Without the 12 pixels around a chart, and what blur and motion mix with them."""


def flat_map(scale, place, angle=0.0):
    """An orthogonal view: pixels per mm, pixel of the lower left corner, turn in radians."""
    c, s = scale * np.cos(angle), scale * np.sin(angle)
    return ChartMap(np.array([[c, s, place[0]], [s, -c, place[1]], [0, 0, 1.0]]))


def seen_bar(bar, scale, place, shape, sigma, shift=0.0):
    """A black bar on white behind a Gaussian and square pixels, closed form, moved to the right."""
    columns, rows = np.arange(shape[1]), np.arange(shape[0])
    x = place[0] + shift + scale * np.array([bar.x, bar.x + bar.width])
    y = place[1] - scale * np.array([bar.y + bar.height, bar.y])
    across, upright = (
        step_seen_by_pixel(pixels - ends[0], sigma) - step_seen_by_pixel(pixels - ends[1], sigma)
        for pixels, ends in ((columns, x), (rows, y))
    )
    return 1 - upright[:, None] * across


@pytest.mark.parametrize(("sigma", "scale"), [(0.4, 0.37), (0.8, 0.19), (1.5, 0.74)])
def test_a_bar_is_the_closed_form(sigma, scale):
    bar = Bar("a", 41.7, 33.2, 60.0, 25.0)
    layout = Layout("a bar", 150, 100, (bar,))
    there = flat_map(scale, (10.3, 70.6))
    photo = photograph(layout, there, optics=Optics(sigma), sensor=IDEAL)
    place = photo.chart_map.pixels([[0, 0]])[0]
    expected = seen_bar(bar, scale, place, photo.image.shape, sigma)
    # six samples along each side of a pixel, weighted as if evenly spread
    assert np.abs(photo.image - expected)[WITHIN].max() < 0.01


def test_motion_averages_the_closed_form_along_the_way():
    bar = Bar("a", 41.7, 33.2, 60.0, 25.0)
    layout = Layout("a bar", 150, 100, (bar,))
    optics = Optics(0.6, travel=(5.0, 0.0, 0.0))
    photo = photograph(layout, flat_map(0.3, (9.1, 60.2)), optics=optics, sensor=IDEAL)
    place = photo.chart_map.pixels([[0, 0]])[0]
    shifts = 5.0 * ((np.arange(400) + 0.5) / 400 - 0.5)
    expected = np.mean(
        [seen_bar(bar, 0.3, place, photo.image.shape, 0.6, shift) for shift in shifts], axis=0
    )
    assert np.abs(photo.image - expected)[WITHIN].max() < 0.01


def test_motion_in_metres_blurs_by_distance_over_pixel_size():
    layout = Layout("edge", 400, 400, (Bar("a", 0, 0, 200, 400),))
    camera = PanoramaCamera(2 * round(4000 * np.pi))  # 4000 px a radian
    view = chart_view(camera, distance=10, layout=layout)
    photo = photograph(
        layout, view, optics=Optics(0.0, travel=(0.02, 0, 0)), sensor=IDEAL, margin=0
    )
    # 20 mm at 10 m and 4000 px are 8 px: the edge rises by 1/8 a pixel
    row = photo.image[len(photo.image) // 2]
    assert np.diff(row[60:-10]).max() == pytest.approx(1 / 8, rel=0.03)


def test_a_slanted_edge_is_the_numerical_integral():
    layout = Layout("edge", 400, 400, (Bar("a", 0, 0, 200, 400),))
    angle = np.radians(7.0)
    photo = photograph(
        layout, flat_map(0.5, (40.0, 230.0), angle), optics=Optics(0.7), sensor=IDEAL
    )
    middle = np.round(photo.chart_map.pixels([[200, 200]])[0]).astype(int)
    part = photo.image[middle[1] - 20 : middle[1] + 21, middle[0] - 15 : middle[0] + 16]
    rest = photo.chart_map.pixels([[200, 200]])[0] - middle
    # where the leaning edge crosses the middle row
    offset = rest[0] + rest[1] * np.tan(angle)
    expected = slanted_edge(0.7, angle, offset, shape=part.shape, levels=(0, 1))
    assert np.abs(part - expected).max() < 0.01


@pytest.mark.parametrize("radius", [1.5, 3.0])
def test_defocus_is_the_transfer_of_a_disc(radius):
    width = 7.0
    pairs = LinePairs("p", 40, 40, width / 0.5, "h", repeats=12, length=60)
    layout = Layout("p", 300, 140, (pairs,))

    def amplitude(defocus):
        photo = photograph(
            layout, flat_map(0.5, (20.2, 90.0)), optics=Optics(0.4, defocus), sensor=IDEAL
        )
        first, last = photo.chart_map.pixels([[40, 70], [40 + 12 * 14, 70]])
        columns = np.arange(int(first[0]) + 14, int(last[0]) - 21)
        wave = np.exp(2j * np.pi * (columns - first[0]) / width)
        row = photo.image[int(first[1]), columns]
        count = len(columns) // 7 * 7
        return (wave * (row - row.mean()))[:count].sum()

    x = 2 * np.pi * radius / width
    ratio = amplitude(radius) / amplitude(0.0)
    assert ratio.real == pytest.approx(2 * j1(x) / x, abs=0.02)
    assert abs(ratio.imag) < 0.02


def test_panorama_columns_are_azimuths_and_rows_elevations():
    camera = PanoramaCamera.of_megapixels(30)
    view = chart_view(camera, distance=5, layout=CHART, heading_deg=40)
    x, y = 130.0, 870.0
    # the camera stands 5 m before the chart, 5 tan 40 to the right, level with its middle
    east, north = (x - 500) / 1000 - 5 * np.tan(np.radians(40)), 5.0
    azimuth = np.arctan2(east, north) - np.arctan2(-5 * np.tan(np.radians(40)), 5.0)
    elevation = np.arctan2((y - 500) / 1000, np.hypot(east, north))
    step = 2 * np.pi / camera.width
    expected = [
        camera.width / 2 + azimuth / step - 0.5,
        camera.height / 2 - elevation / step - 0.5,
    ]
    assert view.pixels([[x, y]])[0] == pytest.approx(expected, abs=1e-6)
    assert view.chart([expected])[0] == pytest.approx([x, y], abs=1e-6)


def test_noise_is_the_one_asked_for_and_follows_its_seed():
    layout = Layout("plain", 400, 400, (Bar("a", 0, 0, 200, 400),))
    sensor = Sensor(black=0.1, white=0.9, noise=0.04)
    there = flat_map(0.5, (0, 200))
    photo, same, other = (
        photograph(layout, there, sensor=sensor, seed=seed).image for seed in (1, 1, 2)
    )
    assert (photo == same).all()
    assert (photo != other).any()
    for level, part in ((0.1, photo[40:-40, 20:90]), (0.9, photo[40:-40, 130:190])):
        expected = 0.04 * np.sqrt(0.5 * level + 0.5)
        assert part.mean() == pytest.approx(level, abs=4 * expected / np.sqrt(part.size))
        # a standard deviation of n values is known to its own over root 2n
        assert part.std() == pytest.approx(expected, rel=4 / np.sqrt(2 * part.size))


def test_files_hold_the_light_within_half_a_step():
    view = chart_view(PanoramaCamera.of_megapixels(30), distance=10, layout=CHART)
    truth = photograph(CHART, view, sensor=Sensor(noise=0.0)).image
    image = photograph(CHART, view, sensor=Sensor(noise=0.0, gamma="srgb", bits=8)).image
    assert image.dtype == np.uint8
    # the steepest part of sRGB's inverse rises by 2.3 here
    assert np.abs(decode(image / 255, "srgb") - truth).max() < 0.5 * 2.3 / 255 + 1e-6
    jpeg = photograph(CHART, view, sensor=Sensor(noise=0.0, bits=8, jpeg_quality=95)).image
    assert 0 < np.abs(jpeg / 255 - truth).mean() < 0.02


def test_mosaics_see_the_colours_of_a_chart():
    red = (0.8, 0.1, 0.2)
    layout = Layout("red", 400, 400, (Bar("a", 0, 0, 200, 400, red),))
    photo = photograph(layout, flat_map(0.5, (0, 200)), sensor=Sensor(noise=0.0, bayer=True))
    signal = 0.06 + 0.64 * np.array(red)[::-1]
    assert photo.image[60:-60, 40:80].mean(axis=(0, 1)) == pytest.approx(signal, abs=1e-3)
    assert photo.image[60:-60, 140:180] == pytest.approx(0.7, abs=1e-4)
    grey = photograph(layout, flat_map(0.5, (0, 200)), sensor=Sensor(noise=0.0))
    luminance = 0.06 + 0.64 * np.dot([0.2126, 0.7152, 0.0722], red)
    assert grey.image[60:-60, 40:80] == pytest.approx(luminance, abs=1e-4)


def test_a_blur_that_changes_over_the_image_is_the_even_one_where_it_stays():
    rng = np.random.default_rng(1)
    scene, sigma = rng.random((40, 60)), np.linspace(0.5, 2, 60) * np.ones((40, 1))
    assert blur_over_image(np.full((40, 60), 0.7), sigma) == pytest.approx(0.7)
    found = blur_over_image(scene, sigma)
    for column in (0, 59):
        even = gaussian_filter(scene, sigma[0, column], mode="reflect")[:, column]
        assert found[:, column] == pytest.approx(even, abs=1e-6)
    noise = image_resolution.noisy(np.zeros((200, 200)), 0.1, rng)
    contrast = image_resolution.HIGH - image_resolution.LOW
    assert noise.std() == pytest.approx(0.1 * contrast, rel=0.02)


def test_bars_turn_with_their_angle_and_sectors_of_a_star_are_as_sharp_as_bars():
    spread, far = PointSpread(0.4), {"period_px": 8.0, "offset_px": 3.0}
    turned = render_bars((80, 60), spread, angle_deg=90.0, **far)
    assert pytest.approx(render_bars((60, 80), spread, **far), abs=1e-6) == turned.T
    star = render_star((81, 81), spread, cycles=12, radius_px=38.0)
    x, y = np.meshgrid(np.arange(-40, 41), np.arange(-40, 41))
    ring = star[np.abs(np.hypot(x, y) - 30) < 1]
    assert [ring.min(), ring.max()] == pytest.approx([0.1, 0.6], abs=1e-3)
    assert ring.mean() == pytest.approx(0.35, abs=0.02)


def test_a_mosaic_has_one_colour_a_pixel_and_even_colours_come_back():
    tones = np.stack(np.broadcast_arrays(0.2, 0.5, 0.8, np.zeros((8, 10)))[:3], axis=-1)
    mosaic = cameras._mosaic(tones)
    assert (mosaic[::2, ::2] == 0.8).all()  # blue first
    assert (mosaic[1::2, 1::2] == 0.2).all()
    assert (mosaic[::2, 1::2] == 0.5).all()
    assert (mosaic[1::2, ::2] == 0.5).all()
    back = cameras._demosaiced(mosaic)[2:-2, 2:-2]
    assert np.abs(back - [0.8, 0.5, 0.2]).max() < 1e-4
    for value in (-0.2, 1.3):  # what noise does beyond black and white is kept
        even = cameras._demosaiced(np.full((8, 8), value))
        assert np.abs(even - value).max() < 1e-4


def test_a_disc_has_its_radius_and_a_moving_camera_its_way():
    for radius in (1.5, 4.0, 7.3):
        kernel = cameras._disc(radius)
        y, x = np.indices(kernel.shape) - len(kernel) // 2
        assert kernel.sum() == pytest.approx(1)
        assert (kernel * (x**2 + y**2)).sum() == pytest.approx(radius**2 / 2, rel=0.08)
        assert (kernel * x).sum() == pytest.approx(0, abs=1e-12)
        assert (kernel > 0).sum() / np.pi == pytest.approx((radius + 0.5) ** 2, rel=0.3)
    layout = charts.imaging_chart()
    view = chart_view(PanoramaCamera(8000), distance=5, layout=layout)
    middle = [[layout.width / 2, layout.height / 2]]
    way = np.array([0.03, 0.0, 0.0])
    moved = [cameras._moved(view, way, t).pixels(middle)[0] for t in (-0.5, 0.0, 0.5)]
    assert moved[1] == pytest.approx(view.pixels(middle)[0])
    length = 0.03 / 5 * 8000 / 2 / np.pi
    assert np.linalg.norm(moved[2] - moved[0]) == pytest.approx(length, rel=1e-3)


def test_textures_fall_off_as_one_over_the_frequency():
    scene = texture((256, 256), seed=3)
    assert scene.min() >= 0
    assert scene.max() <= 1
    assert scene.mean() == pytest.approx(0.5, abs=0.05)
    assert scene.std() == pytest.approx(0.15, rel=0.1)
    power = np.abs(np.fft.fft2(scene - scene.mean()))
    f = np.hypot(*np.meshgrid(np.fft.fftfreq(256), np.fft.fftfreq(256)))
    rings = [(f > low) & (f < 1.3 * low) for low in (0.02, 0.05, 0.12)]
    levels = [np.sqrt((power[ring] ** 2).mean()) * f[ring].mean() for ring in rings]
    assert max(levels) / min(levels) < 1.35
