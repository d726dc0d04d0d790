"""Steps of sensors, lines and blocks: derivatives by differences, dense matrices, loops."""

import numpy as np
import pandas as pd
import pytest
from scipy import sparse, stats

from mmqa_lab.radiometry import blocks, doubts, sensor
from mmqa_lab.radiometry.blocks import Block


def observed(rng, n=60, images=5, ties=12):
    """Observations of two surfaces in two groups of images, numbers without any order."""
    table = pd.DataFrame({"image": rng.integers(0, images, n) * 7, "tie": rng.integers(0, ties, n)})
    table["surface"] = np.where(table["tie"] % 2, "road", "grass")
    table["group"] = np.where(table["image"] > 15, "late", "early")
    limits = {"radiance": (1, 9), "sun_zenith_deg": (20, 60), "view_zenith_deg": (0, 40)}
    limits |= {"azimuth_deg": (0, 180), "radius": (0, 1)}
    return table.assign(**{name: rng.uniform(*ends, n) for name, ends in limits.items()})


def model(row, p, images, ties):
    """Equation of the module for one observation; parameters by name."""
    v, a = np.radians(row["view_zenith_deg"]), np.radians(row["azimuth_deg"])
    b1, b2 = p["b"][int(row["surface"] == "road")]
    lit = np.cos(np.radians(row["sun_zenith_deg"])) * p["ground"][ties.index(row["tie"])]
    light = lit * (1 + b1 * v**2 + b2 * v * np.cos(a)) + p["haze"][int(row["group"] == "late")]
    gain = np.exp(p["log_gain"][images.index(row["image"])])
    return gain * light * (1 - p["radial"] * row["radius"] ** 2)


def test_linearised_has_the_misfit_and_its_derivatives(rng):
    table = observed(rng)
    block = Block(table)
    images, ties = sorted(table["image"].unique()), sorted(table["tie"].unique())
    p = {"log_gain": rng.normal(0, 0.1, len(images)), "b": rng.uniform(0.1, 0.4, (2, 2))}
    p |= {"radial": 0.15, "haze": rng.uniform(0.1, 0.3, 2), "ground": rng.uniform(1, 3, len(ties))}
    estimate = np.concatenate([np.ravel(one) for one in p.values()])
    assert block.sizes == (len(images), 4, 1, 2)
    for found, known in zip(block.split(estimate), p.values(), strict=True):
        assert np.array_equal(found, known)
    misfit, jacobian = block.linearised(estimate)
    seen = [model(row, p, images, ties) for row in table.to_dict("records")]
    assert misfit == pytest.approx(table["radiance"].to_numpy() - seen)
    steps = 1e-6 * np.eye(len(estimate))
    both = [[block.linearised(estimate + sign * step)[0] for step in steps] for sign in (-1, 1)]
    assert jacobian.toarray() == pytest.approx(np.subtract(*both).T / 2e-6, abs=1e-6)


def test_block_has_arrays_and_indices_of_its_observations(rng):
    table = observed(rng)
    block = Block(table)
    assert block.images.tolist() == sorted(table["image"].unique())
    assert block.images[block.image].tolist() == table["image"].tolist()
    assert block.ties[block.tie].tolist() == table["tie"].tolist()
    assert block.surfaces[block.surface].tolist() == table["surface"].tolist()
    assert block.groups[block.group].tolist() == table["group"].tolist()
    late = ["late" if image > 15 else "early" for image in block.images]
    assert block.groups[block.group_of_image].tolist() == late
    assert block.radius2 == pytest.approx(table["radius"] ** 2)
    assert block.sun == pytest.approx(np.cos(np.radians(table["sun_zenith_deg"])))
    sun, view, azimuth = np.radians(table[list(blocks.ANGLES)].to_numpy()).T
    to_sun = np.stack([np.sin(sun), 0 * sun, np.cos(sun)])
    to_camera = np.stack(
        [np.sin(view) * np.cos(azimuth), np.sin(view) * np.sin(azimuth), np.cos(view)]
    )
    angle = np.degrees(np.arccos((to_sun * to_camera).sum(axis=0)))
    assert block.phase_deg == pytest.approx(angle)
    straight = pd.DataFrame({name: [33.0] for name in blocks.ANGLES}).assign(azimuth_deg=0.0)
    assert blocks._phase(straight) == pytest.approx(0, abs=1e-6)
    assert blocks.view_terms(table)[:, 0] == pytest.approx(view**2)
    assert blocks.view_terms(table)[:, 1] == pytest.approx(view * np.cos(azimuth))
    with pytest.raises(ValueError, match="below 90 degrees"):
        blocks.sun_cosine(table.assign(sun_zenith_deg=90.1))
    only = pd.DataFrame({"image": [0, 1, 1], "tie": [3, 4, 4]})
    with pytest.raises(ValueError, match="no tie point in two images"):
        Block(only.assign(**dict.fromkeys(blocks.OBSERVATION_COLUMNS[2:], 1.0)))
    with pytest.raises(ValueError, match="Invalid radiance: 0"):
        Block(table.assign(radiance=table["radiance"].where(table.index > 0, 0.0)))


def test_priors_and_start_of_a_block_are_what_is_given_and_the_scale_of_control(rng):
    table = observed(rng)
    block = Block(table)
    images, ties = len(block.images), len(block.ties)
    given = ((0.1, 0.2), (0.3, 0.4), (0.5, 0.6), (0.7, 0.8))
    value, std = block.priors(given, None)
    counts = images, 4, 1, 2, ties
    assert value.tolist() == np.repeat([0.1, 0.3, 0.5, 0.7, 0.0], counts).tolist()
    assert std.tolist() == np.repeat([0.2, 0.4, 0.6, 0.8, np.inf], counts).tolist()
    control = pd.DataFrame({"tie": [5, 2, 5], "reflectance": [0.2, 0.5, 0.3]})
    value, std = block.priors(given, control.assign(std=[0.01, 0.03, 0.02]))
    place = {tie: k - ties for k, tie in enumerate(block.ties)}
    assert value[place[2]] == pytest.approx(0.5)
    assert std[place[2]] == pytest.approx(0.03)
    assert value[place[5]] == pytest.approx((4 * 0.2 + 0.3) / 5)  # weights of 4 and 1
    assert std[place[5]] == pytest.approx(0.01 * np.sqrt(0.8))
    assert np.isinf(std[-ties:]).sum() == ties - 2
    for wrong in ({"std": 0.0}, {"std": 0.1, "tie": 99}):
        with pytest.raises(ValueError, match="Invalid control"):
            block.priors(given, control.assign(**wrong))
    with pytest.raises(ValueError, match="prior's standard deviation"):
        block.priors(((0.0, -1.0), *given[1:]), None)
    level = table["radiance"] / np.cos(np.radians(table["sun_zenith_deg"]))
    ground = level.groupby(table["tie"]).mean()
    scale = np.median([ground[2] / value[place[2]], ground[5] / value[place[5]]])
    found = block.start(value, std)
    assert found[-ties:] == pytest.approx(ground.to_numpy() / scale)
    assert found[:images] == pytest.approx(0.1 + np.log(scale))
    assert found[images:-ties].tolist() == value[images:-ties].tolist()
    plain = block.start(*block.priors(given, None))
    assert plain[-ties:] == pytest.approx(ground.to_numpy())
    assert plain[:images] == pytest.approx(0.1)


def test_covariance_and_std_of_known_are_parts_of_the_dense_inverse(rng):
    a = rng.normal(size=(30, 9))
    normal = sparse.csc_matrix(a.T @ a)
    inverse = np.linalg.inv(a.T @ a)
    assert blocks._covariance(normal, 4) == pytest.approx(inverse[:4, :4])
    std = np.array([np.inf, 0.1, np.inf, 0.2, np.inf])
    found = blocks._std_of_known(normal, 4, std)
    expected = np.sqrt(np.diag(inverse)[4:])
    assert found == pytest.approx(np.where(np.isfinite(std), expected, np.nan), nan_ok=True)
    assert np.isnan(blocks._std_of_known(normal, 4, std[:1] * np.ones(5))).all()
    a[:, 1] = a[:, 0] * (1 + 1e-9 * rng.normal(size=30))
    with pytest.raises(ValueError, match="cannot be told apart"):
        blocks._covariance(sparse.csc_matrix(a.T @ a), 4)


def test_result_of_a_block_puts_values_and_deviations_in_their_tables(rng):
    table = observed(rng)
    block = Block(table)
    images, ties = len(block.images), len(block.ties)
    size = images + 4 + 1 + 2
    estimate = np.concatenate([rng.normal(0, 0.1, images), rng.uniform(0, 0.3, 7)])
    estimate = np.append(estimate, rng.uniform(1, 3, ties))
    free = np.ones(len(estimate), bool)
    free[[images, images + 4]] = False  # the first surface's b1 and the fall to the corners
    variance = rng.uniform(1, 4, size - 2) * 1e-4
    found = blocks._result(block, estimate, np.diag(variance), free, True)
    std = np.zeros(size)
    std[free[:size]] = np.sqrt(variance)
    assert found.gains["gain"].to_numpy() == pytest.approx(np.exp(estimate[:images]))
    assert found.gains["gain_std_percent"].to_numpy() == pytest.approx(100 * std[:images])
    assert found.gains["n"].tolist() == [int((table["image"] == k).sum()) for k in block.images]
    late = (block.images > 15).astype(int)
    assert found.gains["haze"].to_numpy() == pytest.approx(estimate[images + 5 + late])
    assert found.gains["haze_std"].to_numpy() == pytest.approx(std[images + 5 + late])
    both = found.anisotropy.set_index("surface")
    assert both.index.tolist() == ["grass", "road"]
    assert both[["b1", "b2"]].to_numpy().ravel() == pytest.approx(estimate[images : images + 4])
    assert both[["b1_std", "b2_std"]].to_numpy().ravel() == pytest.approx(std[images : images + 4])
    assert found.radial == (estimate[images + 4], 0.0)
    assert found.ties["reflectance"].to_numpy() == pytest.approx(estimate[-ties:])
    corrected = found.correct(table)
    for k, tie in enumerate(block.ties):
        own = (table["tie"] == tie).to_numpy()
        for name, values in (("before", table["radiance"] / block.sun), ("after", corrected)):
            values = np.asarray(values)[own]
            expected = 100 * values.std(ddof=1) / values.mean() if len(values) > 1 else np.nan
            assert found.ties[f"cv_{name}_percent"][k] == pytest.approx(expected, nan_ok=True)
        assert found.ties["n"][k] == own.sum()
    turned = found.correct(table, to_nadir=False) / corrected
    terms = blocks.view_terms(table) * both.loc[table["surface"], ["b1", "b2"]].to_numpy()
    assert turned == pytest.approx(1 + terms.sum(axis=1))


def test_a_term_is_likely_by_the_test_of_nested_models(rng):
    said = 0
    for _ in range(60):
        n = int(rng.integers(5, 12))
        x, std = rng.uniform(0, 9, n), rng.uniform(0.5, 2, n)
        design, term = np.column_stack([x, np.ones(n)]), x**2
        seen = 2 + 3 * x + rng.choice([0, 0.2]) * term + std * rng.standard_normal(n)
        both = np.column_stack([design, term])
        squares, known = [], None
        for terms in (design, both):
            known = np.linalg.lstsq(terms / std[:, None], seen / std, rcond=None)[0]
            squares.append((((seen - terms @ known) / std) ** 2).sum())
        chance = stats.f.sf((squares[0] - squares[1]) / (squares[1] / (n - 3)), 1, n - 3)
        expected = known[2] if chance < 0.01 else 0.0
        assert doubts.unlikely_term(design, term, seen, std) == pytest.approx(expected)
        said += chance < 0.01
    assert 5 < said < 50
    x = np.arange(5.0)
    design, exact = np.column_stack([x, np.ones(5)]), 1 + x + 2 * x**2
    assert doubts.unlikely_term(design, x**2, exact, np.ones(5)) == pytest.approx(2)
    assert doubts.unlikely_term(design[:4], x[:4] ** 2, exact[:4], np.ones(4)) == 0
    assert doubts.unlikely_term(design, 3 * x, exact, np.ones(5)) == 0


@pytest.mark.parametrize("stated", [True, False])
def test_an_odd_target_is_the_one_that_the_others_do_not_expect(stated, rng):
    named = 0
    for _ in range(80):
        n = int(rng.integers(4, 8))
        x, std = rng.uniform(0, 9, n), rng.uniform(0.5, 2, n)
        seen = 2 + 3 * x + std * rng.standard_normal(n)
        seen[rng.integers(n)] += rng.choice([0, 8, 40])
        design, chances = np.column_stack([x, np.ones(n)]), []
        for k in range(n):
            rest = np.arange(n) != k
            scaled = design[rest] / std[rest, None]
            inverse = np.linalg.inv(scaled.T @ scaled)
            line = inverse @ scaled.T @ (seen[rest] / std[rest])
            left = seen[rest] / std[rest] - scaled @ line
            variance = 1.0 if stated else left @ left / (n - 3)
            error = variance * (std[k] ** 2 + design[k] @ inverse @ design[k])
            z = abs(seen[k] - design[k] @ line) / np.sqrt(error)
            chances.append(2 * (stats.norm.sf(z) if stated else stats.t.sf(z, n - 3)))
        least = int(np.argmin(chances))
        expected = least if chances[least] < 0.001 / n else None
        assert doubts.odd_target(design, seen, std, stated=stated) == expected
        named += expected is not None
    assert 4 < named < 76
    three = np.column_stack([np.arange(3.0), np.ones(3)])
    assert doubts.odd_target(three, np.array([0.0, 50, 2]), np.ones(3), stated=stated) is None


def test_looseness_is_the_root_of_chi_square_over_freedom_where_that_is_unlikely(rng):
    for freedom in (1, 3, 10):
        limit = np.sqrt(stats.chi2.isf(0.01, freedom) / (freedom + 2))
        for factor, loose in ((0.999, False), (1.001, True)):
            std = rng.uniform(0.5, 2, freedom + 2)
            left = factor * limit * std * rng.choice([-1, 1], freedom + 2)
            square = (factor * limit) ** 2 * (freedom + 2)
            expected = np.sqrt(square / freedom) if loose else 1.0
            assert doubts.looseness(left, std, freedom) == pytest.approx(expected)
    assert doubts.looseness(np.array([9.0, 9.0]), np.ones(2), 0) == 1
    scaled = np.array([-3.0, 1, 2, 4, 90])
    assert doubts.misfit_scale(scaled) == pytest.approx(2 / 0.674489750196)
    assert doubts.misfit_scale(np.ones(5)) == 1e-6


def test_remarks_on_a_sensor_come_with_their_bounds(monkeypatch):
    signal = np.arange(10.0)
    design = np.column_stack([signal, np.ones(10)])
    wave = np.array([1, -1, -1, 1, 1, -1, -1, 1, 0, 0.0])
    wave = wave - design @ np.linalg.lstsq(design, wave, rcond=None)[0]
    numbers = np.arange(10) + 3
    monkeypatch.setattr(sensor, "odd_target", lambda *_, **__: None)
    monkeypatch.setattr(sensor, "unlikely_term", lambda *_: 0.0)
    for share, said in ((0.0299, ()), (0.0301, ("targets leave the line by 3% of its range",))):
        size = 1.0
        for _ in range(60):  # of the range, which waves with it
            dn = 50 + 100 * signal + size * wave
            size = share * np.ptp(dn) / np.sqrt(wave @ wave / 8)
        assert sensor._remarks_on(design, dn, np.ones(10), numbers) == said
    plain = 50 + 100 * signal
    bend = 0.02 * 900 * 4 / 81  # its arrow over the middle is a 50th of the range
    for factor, said in ((0.999, ()), (-1.001, ("the line is bent by 2% of its range",))):
        monkeypatch.setattr(sensor, "unlikely_term", lambda *_, factor=factor: factor * bend)
        assert sensor._remarks_on(design, plain, np.ones(10), numbers) == said
    monkeypatch.setattr(sensor, "unlikely_term", lambda *_: 0.0)
    monkeypatch.setattr(sensor, "odd_target", lambda *_, **__: 4)
    found = sensor._remarks_on(design, plain, np.ones(10), numbers)
    assert found == ("target 8 leaves the line of the others",)


def test_intervals_of_a_sensor_are_students_and_its_row_has_all(rng):
    light = rng.uniform(5, 90, 9)
    dn = 60 + 28 * light + rng.normal(0, 5, 9)
    fit = sensor.fit_sensor(light, dn)
    line = stats.linregress(light, dn)
    reach = stats.t.ppf(0.975, 7)
    rows = {name: (value, low, high) for name, value, low, high, _ in fit._ends()}
    for name, value, error in (("gain", line.slope, line.stderr),
                               ("offset", line.intercept, line.intercept_stderr)):  # fmt: skip
        assert rows[name] == pytest.approx((value, value - reach * error, value + reach * error))
    assert fit.r_squared == pytest.approx(line.rvalue**2)
    assert fit.freedom == 7
    assert fit.radiance(500.0, exposure=2) == pytest.approx((500 - fit.offset) / fit.gain / 2)
    zero = sensor.fit_sensor(light, dn, through_zero=True)
    assert zero.r_squared == pytest.approx(1 - ((dn - zero.gain * light) ** 2).sum() / (dn @ dn))
    assert (zero.freedom, zero.n) == (8, 9)
    errors = rng.uniform(1, 9, 9)
    weighted = sensor.fit_sensor(light, dn, std_dn=errors)
    expected = np.polyfit(light, dn, 1, w=1 / errors)
    assert [weighted.gain, weighted.offset] == pytest.approx(expected)
    exposed = sensor.fit_sensor(light / 4, dn, exposure=4.0)
    assert exposed.gain == pytest.approx(fit.gain)


def test_relative_exposure_is_time_over_the_square_of_the_f_number():
    assert sensor.relative_exposure(0.03, 2.0) == pytest.approx(3 * 4)
    usual = sensor.relative_exposure(0.03, 5.6, reference=(0.002, 8.0))
    assert usual == pytest.approx((0.03 / 5.6**2) / (0.002 / 8.0**2))


def test_hot_pixels_lie_beyond_six_deviations_and_are_few(rng):
    dn = 100 + 2 * np.sign(np.arange(100) % 2 - 0.5) + 0.001 * rng.random(100)
    usual = np.median(np.abs(dn - np.median(dn))) / 0.6745
    for size, hot in ((5.98, 0), (6.02, 1)):
        odd = dn.copy()
        odd[7] = np.median(dn) + size * usual
        assert sensor._hot(odd).sum() == hot
    for count, hot in ((5, 5), (6, 0)):
        odd = dn.copy()
        odd[:count] = 900
        assert sensor._hot(odd).sum() == hot
    assert not sensor._hot(np.r_[np.full(60, 7.0), 9.0]).any()
    image = rng.normal(100, 3, (12, 20))
    image[2, 3], image[0, 19] = 400.0, 900.0
    found = sensor.patch_statistics(image, [[0, 6, 0, 10], [5, 12, 10, 20]], full_scale=350).iloc[0]
    own = np.delete(image[:6, :10].ravel(), 23)
    assert (found["n"], found["hot"]) == (59, 1)
    assert found["mean_dn"] == pytest.approx(own.mean())
    assert found["std_dn"] == pytest.approx(own.std(ddof=1))
    assert found["std_error_dn"] == pytest.approx(own.std(ddof=1) / np.sqrt(59))
    assert found["saturated_share"] == pytest.approx(1 / 60)
    one_pixel = [[0, 1, 0, 1]]
    for wrong in (one_pixel, [[0, 13, 0, 4]], [[3, 2, 0, 4]], [[0, 2, -1, 4]], [[0, 2, 3, 21]]):
        with pytest.raises(ValueError, match="Invalid patch"):
            sensor.patch_statistics(image, wrong)
