"""Steps of the measurement of edges, stars and sharpness: closed forms, loops, draws."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import ndtr

from mmqa_lab.mtf import edges, sharpness, stars, transfer
from mmqa_lab.mtf.stars import StarMtf
from mmqa_lab.mtf.transfer import spread_edge


def gaussian_mtf(f, sigma, angle):
    """Transfer of a Gaussian lens and a square pixel across an edge."""
    pixel = np.sinc(f * np.cos(angle)) * np.sinc(f * np.sin(angle))
    return np.exp(-2 * (np.pi * sigma * f) ** 2) * pixel


def test_crossing_is_the_first_between_straight_lines():
    f, values = np.array([0, 0.1, 0.3, 0.4, 0.5]), np.array([1.0, 0.8, 0.2, 0.9, 0.1])
    assert transfer.crossing(f, values, 0.5) == pytest.approx(0.2)
    assert transfer.crossing(f, values, 0.35) == pytest.approx(0.25)
    assert transfer.crossing(f, values, 0.8) == pytest.approx(0.1)
    assert transfer.crossing(f, values, 0.15) == pytest.approx(0.49375)
    assert np.isnan(transfer.crossing(f, values, 0.1))
    assert np.isnan(transfer.crossing(f, values, 1.1))


def test_double_integral_of_a_normal_distribution_is_that_by_sums():
    x = np.linspace(-9, 4, 130_001)
    once = np.cumsum(ndtr(x / 0.7)) * (x[1] - x[0])
    twice = np.cumsum(once) * (x[1] - x[0])
    places = np.array([20_000, 70_000, 90_000, 97_000, 130_000])
    assert transfer._double_integral(x[places], 0.7) == pytest.approx(twice[places], abs=1e-3)


def an_edge(rng, n=9000, noise=0.0, widths=(0.7, 0.7), **known):
    """Pixels beside an edge as by_bins takes them; its halves may have two widths."""
    across, along = rng.uniform(-9, 9, n), rng.uniform(-20, 20, n)
    wide = np.where(along < 0, *widths)
    values = np.where(wide == widths[0], *(spread_edge(across, w, 0.1) for w in widths))
    values = values + noise * rng.standard_normal(n)
    given = {"distance": across, "along": along, "values": values, "length": np.ptp(along)}
    given |= {"noise": np.full(n, max(noise, 1e-6)), "spread": np.hypot(0.7, 12**-0.5)}
    given |= {"width": 0.7, "angle": 0.1, "rounding": 0.0, "rounded_alike": False, "ringing": 0.0}
    return SimpleNamespace(**(given | known))


def test_by_bins_gives_transfer_width_and_spread_of_a_known_edge(rng):
    found = transfer.by_bins(an_edge(rng))
    f = transfer.FREQUENCIES
    assert found["mtf"] == pytest.approx(gaussian_mtf(f, 0.7, 0.1), abs=2e-3)
    fine = np.linspace(0.2, 0.4, 20_001)
    mtf50 = fine[np.argmin(np.abs(gaussian_mtf(fine, 0.7, 0.1) - 0.5))]
    assert found["mtf50"] == pytest.approx(mtf50, rel=1e-3)
    places = np.linspace(-9, 9, 180_001)
    lsf = np.gradient(spread_edge(places, 0.7, 0.1), places)
    half = np.ptp(places[lsf > lsf.max() / 2])
    assert found["fwhm_px"] == pytest.approx(half, rel=3e-3)
    expected = np.interp(found["distance_px"], places, lsf)
    assert found["lsf"] == pytest.approx(expected, abs=4e-3)
    blurred = an_edge(rng, widths=(1.0, 1.0), width=1.0, spread=np.hypot(1, 12**-0.5))
    wider = transfer.by_bins(blurred)
    assert wider["mtf"] == pytest.approx(gaussian_mtf(f, 1.0, 0.1), abs=4e-3)


def test_by_bins_states_the_deviation_of_its_draws(rng):
    found = [transfer.by_bins(an_edge(rng, 1500, 0.02)) for _ in range(16)]
    told = np.sqrt(np.mean([one["mtf50_sigma"] ** 2 for one in found]))
    least = 0.002 * found[0]["mtf50"]
    expected = np.hypot(np.std([one["mtf50"] for one in found]), least)
    assert 0.8 < told / expected < 1.6


def test_by_bins_states_the_deviation_of_parts_that_differ(rng):
    halves = an_edge(rng, 4000, widths=(0.5, 0.9))
    tenth = np.floor((halves.along + 20) / 4).astype(int)
    places = []
    for k in range(10):
        part = {name: value[tenth != k] for name, value in vars(halves).items()
                if np.size(value) > 1}  # fmt: skip
        places.append(transfer.by_bins(SimpleNamespace(**(vars(halves) | part)))["mtf50"])
    jackknife = np.sqrt(9 / 10 * np.sum((places - np.mean(places)) ** 2))
    assert transfer.by_bins(halves)["mtf50_sigma"] == pytest.approx(jackknife, rel=0.06)


def test_by_bins_adds_what_rounding_and_compression_may_do(rng):
    fit = an_edge(rng)
    plain = transfer.by_bins(fit)

    def more(**known):
        """What is added to the deviation, over MTF50."""
        other = transfer.by_bins(SimpleNamespace(**(vars(fit) | known)))
        assert other["mtf50"] == plain["mtf50"]
        return np.sqrt(other["mtf50_sigma"] ** 2 - plain["mtf50_sigma"] ** 2) / plain["mtf50"]

    assert more(ringing=0.05) == pytest.approx(1.3 * 0.05)
    assert more(rounding=0.01, rounded_alike=True) == pytest.approx(0.01)
    assert more(rounding=0.5) == 0
    assert np.isnan(more(rounding=0.011, rounded_alike=True))
    kept = np.abs(fit.distance - 2) > 0.37  # 0.74 px
    for there, measured in ((kept, True), (np.abs(fit.distance - 2) > 0.38, False)):
        part = {name: value[there] for name, value in vars(fit).items() if np.size(value) > 1}
        part |= {"length": fit.length}
        found = transfer.by_bins(SimpleNamespace(**(vars(fit) | part)))
        assert np.isfinite(found["mtf50"]) == measured
        assert np.isnan(found["mtf50_sigma"]) == np.isnan(found["fwhm_px"]) != measured
    steep = transfer.by_bins(an_edge(rng, widths=(0.16, 0.16), width=0.16))
    assert steep["mtf50"] > 0.45


def test_narrow_bins_are_sums_over_parts_and_sixteenths(rng):
    fit = an_edge(rng, 700, 0.1, noise_of=0)
    fit.noise = rng.choice([1e-4, 0.01, 0.02], 700)
    place, seen, weight, part = transfer._narrow_bins(fit)
    rows = {}
    for k in range(700):
        tenth = min(int((fit.along[k] - fit.along.min()) / np.ptp(fit.along) * 10), 9)
        rows.setdefault((tenth, round(fit.distance[k] * 16)), []).append(k)
    cells = sorted(rows)
    assert part.tolist() == [tenth for tenth, _ in cells]
    assert place == pytest.approx([fit.distance[rows[cell]].mean() for cell in cells])
    assert seen == pytest.approx([fit.values[rows[cell]].mean() for cell in cells])
    noise = np.maximum(fit.noise, 0.002)
    assert weight == pytest.approx([(1 / noise[rows[cell]] ** 2).sum() for cell in cells])


def pixels_of(rng, n=6000, **known):
    """An EdgeFit whose values are those of its sigmoid."""
    across, along = rng.uniform(-20, 20, n), rng.uniform(-30, 30, n)
    values = spread_edge(across, 0.7, 0.1)
    given = {"distance": across, "along": along, "values": values, "grey": values}
    given |= {"residuals": 0 * values, "noise": 0 * values, "angle": 0.1, "width": 0.7}
    given |= {"log_width_sigma": 0.03, "step": 1.0, "rounding": 0.0, "hot": 0}
    return edges.EdgeFit(**(given | known))


def test_ringing_is_what_is_more_beside_the_edge_than_far_from_it(rng):
    plain, deviates = pixels_of(rng), rng.standard_normal(6000)
    assert plain.spread == pytest.approx(np.sqrt(0.49 + 1 / 12))
    assert plain.length == pytest.approx(np.ptp(plain.along))
    size = np.abs(plain.distance)
    near, far = (size > 1.5 * plain.spread) & (size < 6), size > 12
    for by_left, by_right, ring, rounding in ((0.01, 0.02, 0.05, 0.0), (0.03, 0.01, 0.06, 0.1)):
        noise = np.where(plain.distance < 0, by_left, by_right)
        noise = np.where(near, ring, np.where(far, noise, 0.4))
        fit = pixels_of(rng, **{name: getattr(plain, name) for name in ("distance", "along")},
                        values=plain.values + noise * deviates, rounding=rounding)  # fmt: skip
        usual = max(by_left, by_right) ** 2 * (1 + 4 * np.sqrt(2 / near.sum()))
        expected = np.sqrt(ring**2 - usual - rounding**2 / 12)
        assert fit.ringing == pytest.approx(expected, rel=0.08)
    noise = np.where(near, 0.01, 0.02)
    assert (
        pixels_of(rng, distance=plain.distance, values=plain.values + noise * deviates).ringing == 0
    )
    few = np.flatnonzero(far & (plain.distance > 0))[49:]
    kept = np.delete(np.arange(6000), few)
    part = {name: getattr(plain, name)[kept] for name in ("distance", "along")}
    assert pixels_of(rng, **part, values=(plain.values + 0.1 * near * deviates)[kept]).ringing == 0
    kept = np.delete(np.arange(6000), few[1:])
    part = {name: getattr(plain, name)[kept] for name in ("distance", "along")}
    assert (
        pixels_of(rng, **part, values=(plain.values + 0.1 * near * deviates)[kept]).ringing > 0.05
    )
    left = 0.02 * deviates
    fit = pixels_of(rng, distance=plain.distance, residuals=left, rounding=0.039)
    bins = np.round(plain.distance * 4)
    groups = [left[bins == k] for k in np.unique(bins)]
    within = sum(((one - one.mean()) ** 2).sum() for one in groups) / (6000 - len(groups))
    assert fit.grain == pytest.approx(np.sqrt(within))
    assert not fit.rounded_alike
    assert pixels_of(rng, distance=plain.distance, residuals=left, rounding=0.041).rounded_alike


def test_sigmoid_finds_its_line_its_width_and_how_well_it_knows_it(rng):
    across, along = rng.uniform(-9, 9, 3000), rng.uniform(-20, 20, 3000)
    half = np.abs(along).max()
    truth = across - 0.8 + 1.3 * along / half
    values = 30 + 200 * spread_edge(truth, 0.9, 0.2)
    found, width, _, left = edges._sigmoid(across, along, values, 0.2, spread_edge)
    assert found == pytest.approx(truth, abs=1e-3)
    assert width == pytest.approx(0.9, rel=1e-3)
    assert np.abs(left).max() < 0.2
    falling = edges._sigmoid(across, along, -values, 0.2, spread_edge, 0.9)
    assert falling[0] == pytest.approx(truth, abs=1e-3)
    widths, told = [], []
    for _ in range(12):
        noisy = values + 4 * rng.standard_normal(3000)
        _, width, sigma, left = edges._sigmoid(across, along, noisy, 0.2, spread_edge, 0.9)
        widths.append(np.log(width))
        told.append(sigma)
        assert left.std() == pytest.approx(4, rel=0.06)
    slope = (spread_edge(truth, 0.9 * 1.001, 0.2) - spread_edge(truth, 0.9 / 1.001, 0.2)) / 0.002
    others = np.column_stack([np.ones(3000), spread_edge(truth, 0.9, 0.2)])  # both levels
    slope = slope - others @ np.linalg.lstsq(others, slope, rcond=None)[0]
    expected = 4 / 200 / np.sqrt((slope**2).sum())
    assert np.mean(told) == pytest.approx(expected, rel=0.06)
    assert np.std(widths) == pytest.approx(expected, rel=0.5)


def test_by_sigmoid_is_the_transfer_of_its_gaussian():
    fit = SimpleNamespace(width=0.7, angle=0.1, log_width_sigma=0.03)
    found = edges._by_sigmoid(fit, spread_edge)
    assert found["mtf"] == pytest.approx(gaussian_mtf(transfer.FREQUENCIES, 0.7, 0.1), abs=6e-4)
    assert found["mtf50_sigma"] == pytest.approx(0.03 * found["mtf50"])
    places, lsf = found["distance_px"], found["lsf"]
    assert np.trapezoid(lsf, places) == pytest.approx(1, abs=1e-6)
    assert [places[0], places[-1]] == pytest.approx(
        np.array([-1, 1]) * (12 * np.hypot(0.7, 0.3) + 2)
    )
    assert found["fwhm_px"] == pytest.approx(np.ptp(places[lsf > lsf.max() / 2]), abs=0.15)
    assert edges._logistic(np.array([-0.6, 0, 1.2]), 0.6, None) == pytest.approx(
        1 / (1 + np.exp([1, 0, -2]))
    )


def test_plausible_pixels_lie_near_the_median_of_those_at_their_distance(rng):
    across = rng.uniform(-8, 8, 800)
    values = spread_edge(across, 0.7, 0.0) + 0.01 * rng.standard_normal(800)
    values[::40] += rng.choice([-1, 1], 20) * rng.uniform(0.03, 0.6, 20)
    bins = {k: np.flatnonzero(np.round(2 * across) == k) for k in np.unique(np.round(2 * across))}
    middle = {k: sorted(values[rows])[len(rows) // 2] for k, rows in bins.items()}
    levels = np.array([middle[k] for k in sorted(middle)])
    steep = dict(zip(sorted(middle), np.abs(np.gradient(levels)), strict=True))
    left = np.array([abs(v - middle[round(2 * a)]) for a, v in zip(across, values, strict=True)])
    usual = max(np.median(left[across < 0]), np.median(left[across > 0])) / 0.6745
    limit = max(6 * usual, 0.1 * np.ptp(levels))
    expected = [x <= limit + steep[round(2 * a)] for x, a in zip(left, across, strict=True)]
    assert edges._plausible(across, values).tolist() == expected
    assert 5 < np.sum(~np.array(expected)) < 20


def test_fit_line_tells_step_rounding_and_odd_pixels_of_an_image(rng):
    y, x = np.mgrid[:60, :50]
    across = (x - 24.5) * np.cos(0.15) + (y - 29.5) * np.sin(0.15)
    image = np.round(40 + 120 * spread_edge(across, 0.8, 0.15) + rng.normal(0, 1, across.shape))
    hot = np.array([(5, 10), (30, 8), (41, 40), (50, 33)])
    image[*hot.T] += 90 * np.where(across[*hot.T] > 0, -1, 1)
    fit = edges.fit_line(image, spread_edge)
    assert fit.hot == 4
    assert fit.step == pytest.approx(120, rel=0.01)
    assert fit.rounding == pytest.approx(1 / 120, rel=0.01)
    assert fit.width == pytest.approx(0.8, rel=0.03)
    assert fit.angle == pytest.approx(0.15, abs=2e-3)
    assert len(fit.values) == (np.abs(fit.distance) <= 24 * np.hypot(fit.width, 0.3) + 7).sum()
    assert fit.grain == pytest.approx(np.hypot(1, 12**-0.5) / 120, rel=0.06)
    assert fit.values == pytest.approx(spread_edge(fit.distance, 0.8, 0.15), abs=0.06)
    assert np.ptp(fit.grey) == pytest.approx((image.max() - image.min()) / 120, rel=0.3)
    wide = np.hstack([np.full((60, 60), 40.0), image, np.full((60, 60), 160.0)])
    wide = wide + rng.normal(0, 1, wide.shape)
    far = np.abs(edges.fit_line(wide, spread_edge).distance).max()
    assert far == pytest.approx(24 * np.hypot(0.8, 0.3) + 6, abs=1)


def test_star_falls_to_a_share_with_the_error_that_its_contrasts_have(rng):
    f = np.linspace(0.05, 0.6, 60)
    seen, std = np.exp(-2 * (np.pi * 0.6 * f) ** 2), 0.004 + 0.01 * f

    def star(mtf, **known):
        return StarMtf(f, mtf, std, 9 / f, (0.0, 0.0), **known)

    for share in (0.5, 0.2):
        place, sigma = star(seen)._falls_to(share)
        assert place == pytest.approx(np.sqrt(np.log(1 / share) / 2) / (np.pi * 0.6))
        square = 0.0
        for k in range(60):  # propagated, of contrasts of which four share each pixel
            off = 1e-5 * (np.arange(60) == k)
            pair = [star(seen + sign * off)._falls_to(share)[0] for sign in (1, -1)]
            square += (np.subtract(*pair) / 2e-5 * std[k]) ** 2
        assert sigma == pytest.approx(np.hypot(np.sqrt(4 * square), 0.0015 * place), rel=1e-3)
        found = star(seen, tail=0.1)._falls_to(share)[1]
        assert found == pytest.approx(np.hypot(np.sqrt(4 * square), 0.04 * place), rel=1e-3)
    assert star(seen).mtf50 == star(seen).at(0.5) == star(seen)._falls_to(0.5)[0]
    assert star(seen).mtf50_sigma == star(seen)._falls_to(0.5)[1]
    coarse = StarMtf(f[::20], seen[::20], std[::20], 9 / f[::20], (0, 0))
    place, sigma = coarse._falls_to(0.5)
    assert place == pytest.approx(np.interp(-0.5, -seen[::20], f[::20]))
    assert np.isnan(sigma)


@pytest.mark.parametrize("span", [(0, 360), (30, 75), (-90, 90), (-20, 260)])
def test_sector_keeps_three_pixels_from_its_limits(span, rng):
    x, y = rng.uniform(-30, 30, (2, 600))
    used = stars._sector(y, x, span)
    turn = (np.degrees(np.arctan2(y, x)) - span[0]) % 360
    wide = span[1] - span[0]
    for a, b, angle, found in zip(x, y, turn, used, strict=True):
        clear = wide == 360
        if not clear and angle < wide:
            away = []
            for limit in np.radians(span):
                along = a * np.cos(limit) + b * np.sin(limit)
                off = abs(b * np.cos(limit) - a * np.sin(limit))
                away.append(off if along > 0 else np.hypot(a, b))
            clear = min(away) > 3
        assert found == clear


@pytest.mark.parametrize(
    ("weight", "expected"), [(0.0, 0.0), (0.4, 0.4 / 1.16), (-0.4, -0.4 / 1.16)]
)
def test_neighbours_of_a_star_are_as_alike_as_their_noise(weight, expected, rng):
    size, place, n = 90, (44.7, 45.2, 0.0, 0.0), 12
    white = rng.standard_normal((size + 1, size + 1))
    noise = white[1:, 1:] + weight * white[1:, :-1]  # beside, and not above
    x, y = (part.ravel() for part in np.meshgrid(np.arange(90.0), np.arange(90.0)))
    r, azimuth = stars._polar((x, y), place)
    wave = 0.5 + 0.3 * np.cos(n * azimuth) + 0.05 * np.sin(7 * n * azimuth)
    values = wave + 0.02 * noise.ravel()
    found, pairs = stars._neighbours((x, y, values), place, n, 42.0, 0.6)
    used = ((r > 25.2) & (r < 39)).reshape(size, size)
    beside = (used[:, 1:] & used[:, :-1]).sum(), (used[1:] & used[:-1]).sum()
    assert pairs == sum(beside)
    assert found == pytest.approx(expected / 2, abs=0.035)


@pytest.mark.parametrize(("noise", "told"), [(0.0037, False), (0.0049, True)])
def test_neighbours_tell_nothing_where_noise_is_less_than_seven_thousandths(noise, told, rng):
    x, y = (part.ravel() for part in np.meshgrid(np.arange(90.0), np.arange(90.0)))
    _, azimuth = stars._polar((x, y), (44.7, 45.2, 0.0, 0.0))
    values = 0.5 + 0.3 * np.cos(12 * azimuth) + noise * rng.standard_normal(8100)
    found, _ = stars._neighbours((x, y, values), (44.7, 45.2, 0.0, 0.0), 12, 42.0, 0.6)
    assert (found != 0) == told


def haar_details(grey):
    """Details and approximation of squares of four pixels, one after the other."""
    rows, columns = (size // 2 for size in grey.shape)
    approximation, details = np.empty((rows, columns)), np.empty((3, rows, columns))
    signs = ([[1, 1], [-1, -1]], [[1, -1], [1, -1]], [[1, -1], [-1, 1]])
    for i in range(rows):
        for j in range(columns):
            four = grey[2 * i : 2 * i + 2, 2 * j : 2 * j + 2]
            approximation[i, j] = four.sum() / 2
            details[:, i, j] = [(np.array(sign) * four).sum() / 2 for sign in signs]
    return approximation, details


@pytest.mark.parametrize("given", [True, False])
def test_haar_sharpness_is_the_ratio_of_details_of_squares_of_four(given, rng):
    image = rng.normal(0, 5, (53, 70)).cumsum(axis=1) + rng.normal(0, 2, (53, 70))
    image[24:48, 48:] = 7.0 + 0.1 * rng.standard_normal((24, 22))  # nothing to see
    noise = 1.1 if given else None
    found = sharpness.haar_sharpness(image, block=24, noise_std=noise)
    approximation, fine = haar_details(image[:48, :48])
    coarse = haar_details(approximation)[1]
    for known, part in zip(sharpness._haar(image[:48, :48])[1], fine, strict=True):
        assert known == pytest.approx(part)
    if not given:
        diagonal = fine[2].ravel()
        noise = np.median(np.abs(diagonal - np.median(diagonal))) / 0.674489750196
    assert found.attrs["noise_std"] == pytest.approx(noise)
    for i, j in np.ndindex(2, 2):
        above = (fine[:, 12 * i : 12 * i + 12, 12 * j : 12 * j + 12] ** 2).sum(axis=0).mean()
        below = (coarse[:, 6 * i : 6 * i + 6, 6 * j : 6 * j + 6] ** 2).sum(axis=0).mean()
        ratio = np.sqrt((above - 3 * noise**2) / (below - 3 * noise**2))
        assert found["sharpness"].values[i, j] == pytest.approx(ratio)
    assert found["y_px"].values.tolist() == found["x_px"].values.tolist() == [12, 36]
    flat = sharpness.haar_sharpness(image[24:48, 48:68][:20], block=20, noise_std=noise)
    assert np.isnan(flat["sharpness"].item())
    assert flat.attrs["not_measurable"] == 1


def test_details_stand_out_where_they_have_four_times_the_variance_of_noise(rng):
    image = rng.standard_normal((32, 32))
    below = (haar_details(haar_details(image)[0])[1] ** 2).sum(axis=0).mean()
    limit = np.sqrt(below / (3 + 12))  # less three of noise, more than four times three
    for noise, seen in ((0.999 * limit, 0), (1.001 * limit, 1)):
        found = sharpness.haar_sharpness(image, block=32, noise_std=noise)
        assert found.attrs["not_measurable"] == seen


@pytest.mark.parametrize("turn", [0.0, 90.0, -35.0])
def test_place_of_bars_has_their_middle_and_their_direction(turn):
    group = {"period_px": 6.0, "x_px": 40.0, "y_px": 25.0, "angle_deg": turn, "bars": 4}
    place = sharpness._place_of_bars(group)
    across = np.array([np.cos(np.radians(turn)), np.sin(np.radians(turn))])
    wide, long = 3.5 * 6, 2.5 * 6  # from the first bar's beginning to the last one's end
    corners = np.array([[0, 0], [wide, 0], [0, long], [wide, long]])
    pixels = place.pixels(corners)
    assert pixels.mean(axis=0) == pytest.approx([40, 25])
    assert pixels[1] - pixels[0] == pytest.approx(wide * across)
    assert pixels[2] - pixels[0] == pytest.approx(long * np.array([across[1], -across[0]]))


def test_a_line_forgets_what_lies_farther_than_six_pixels_from_it():
    y, x = np.mgrid[:70, :60].astype(float)
    across = (x - 29.5) * np.cos(0.12) + (y - 34.5) * np.sin(0.12) - 0.7
    image = spread_edge(across, 0.8, 0.12)
    spot = 0.5 * np.exp(-(((across - 10) / 1.2) ** 2) / 2) * (y > 40)  # steep on both of its sides
    plain, _, angle = edges._line(image)
    beside, _, turned = edges._line(image + spot)
    near = np.abs(across.ravel()) < 4
    assert np.abs(plain - across.ravel())[near].max() < 0.05
    assert np.abs(beside - plain)[near].max() < 0.03
    assert abs(turned - angle) < 1e-3
