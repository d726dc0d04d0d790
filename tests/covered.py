"""Simulations that count how often 95 % intervals contain the truth: for the tests and the README.

Each estimate is a function of a seed. It simulates data whose truth is known, and returns a dict of
figures, each with the ends of its stated interval and the truth: (low, high, truth). Where it
states a standard deviation, the ends are 1.96 of them from the value, or Student's t where its
docstring says so. An ellipsoid has the ends 0 and the 95 % quantile of chi-squared, and as truth
the squared distance in its metric. A truth of None is the mean of the values of all draws, which
come as a fourth number: what an interval of a random pattern is about. Figures that differ behind a
colon only are counted together.
"""

from dataclasses import dataclass, replace
from functools import cache
from itertools import product

import camera
import numpy as np
import pandas as pd
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.stats import chi2, t

from mmqa_lab import bench, chart_image, charts, lines, simulate, stats, test_field
from mmqa_lab.boresight import calibrate
from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.mtf import fit_edge, measure_star
from mmqa_lab.planes import fit_circle
from mmqa_lab.radiometry import adjust_block, empirical_line, fit_sensor, ndvi
from mmqa_lab.repeatability import repeatability
from mmqa_lab.scan_pattern import ScanSetup, Target, measure_pattern, propagate, scan_lattice
from mmqa_lab.simulate.canyon import CENTRE_M, canyon
from mmqa_lab.simulate.point_patterns import point_pattern
from mmqa_lab.simulate.targets import PointSpread, render_edge, render_star
from mmqa_lab.simulate.test_field import drive_test_field, make_test_field
from mmqa_lab.studies import test_field as study
from mmqa_lab.studies.mimic import simulate_patch

Z = 1.959964

PARTS = ("low", "high", "truth", "value")
"""What is kept of each figure of a draw."""

SETUP = ScanSetup(
    pulse_rate_hz=300e3,
    mirror_frequency_hz=100,
    speed_m_s=8,
    scanner_heading_deg=45,
    scanner_tilt_deg=45,
)
CHART = charts.imaging_chart()
WALL = Target(heading_deg=5, tilt_deg=3, range_m=5)


def around(value, std, truth, reach=Z):
    """The interval of a value with a standard deviation."""
    return value - reach * std, value + reach * std, truth


def ellipsoid(error, covariance):
    """The 95 % ellipsoid of a vector."""
    return 0.0, chi2.ppf(0.95, len(error)), error @ np.linalg.solve(covariance, error)


BOARD_M = 0.71


def scan_lines(rng, angle, *, along=0.005, across=0.02, growth=0.0, error=0.001):
    """Scan lines over a board; each errs by 1 mm across, and their gaps grow by a share."""
    half = 0.85 * BOARD_M
    places = [-half + across * rng.random()]
    while places[-1] < half:
        places.append(places[-1] + across * (1 + growth * places[-1] / half))
    start = np.arange(-half, half, along)
    xy = [
        np.column_stack([start + along * rng.random(), np.full(len(start), place)])
        for place in places + rng.normal(0, error, len(places))
    ]
    xy = np.concatenate(xy) + rng.normal(0, 0.0003, (len(xy) * len(start), 2))
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    xy = xy @ np.array([[c, s], [-s, c]]) + BOARD_M / 2
    return xy[((xy > 0) & (xy < BOARD_M)).all(axis=1)]


BOARDS = {
    "random": lambda rng, seed: point_pattern(
        "poisson", density=3000, size=BOARD_M, seed=seed, ratio=1
    ),
    "lines": lambda rng, seed: scan_lines(rng, 20),
    "two heads": lambda rng, seed: np.vstack(
        [scan_lines(rng, angle, along=0.01) for angle in (45, -45)]
    ),
    "tilted": lambda rng, seed: scan_lines(rng, 20, growth=0.1),
    "few lines": lambda rng, seed: scan_lines(rng, 20, across=0.05, growth=0.2, error=0.005),
    "clusters": lambda rng, seed: point_pattern(
        "clusters", density=3000, size=BOARD_M, seed=seed, ratio=3, angle=20
    ),
}
"""Points on a square board: without order, in lines, in lines of two heads, tilted, in few
lines whose gaps vary and grow as where a drive changes speed, in clusters."""


def board(seed, kind):
    """Every figure of a board, by its default axes; 5 mm of noise off its plane."""
    rng = np.random.default_rng([seed, 7])
    xy = BOARDS[kind](rng, seed)
    off = rng.normal(0, 0.005, len(xy))
    lean = np.radians(30 if kind == "tilted" else 0)
    corners = BOARD_M * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    on, ring = (
        np.column_stack([uv[:, 0], uv[:, 1] * np.sin(lean), uv[:, 1] * np.cos(lean)])
        for uv in (xy, corners)
    )
    points = on + off[:, None] * [0, np.cos(lean), -np.sin(lean)]
    table = evaluate_cloud(points, polygon=ring).intervals()
    return {row.figure: (row.low, row.high, None, row.value) for row in table.itertuples()}


def rate(seed, share, n):
    """A rate, such as recall, of independent trials."""
    found = stats.wilson(int(np.random.default_rng(seed).binomial(n, share)), n)
    return {"rate": (found.low, found.high, share)}


def mean_of(seed, n):
    """The bootstrap of a mean and of a median of exponential values."""
    values = np.random.default_rng(seed).exponential(size=n)
    found = {}
    for name, truth in (("mean", 1.0), ("median", np.log(2))):
        one = stats.bootstrap(getattr(np, name), values, repeats=400, seed=seed)
        found[name] = one.low, one.high, truth
    return found


def selections(seed, scans):
    """Repeatability of 12 selections of each scan."""
    rng = np.random.default_rng(seed)
    values = rng.normal(0, 1, (scans, 12)) + rng.normal(0, 1, (scans, 1))
    table = pd.DataFrame({"scan": np.repeat(np.arange(scans), 12), "f": values.ravel() + 100})
    found = repeatability(table, "f")
    return {"s_r": (found.s_r_low, found.s_r_high, 1.0)}


def trend(seed, n):
    """The growth of errors with distance."""
    rng = np.random.default_rng(seed)
    distance = rng.uniform(2, 35, n)
    found = test_field.trend(distance, 5 + 0.3 * distance + rng.normal(0, 3, n))
    return {"slope": (found["slope_low"], found["slope_high"], 0.3)}


def pole(seed, known, n):
    """The position of a pole of 10 cm, 150 degrees of it seen by n points, 4 mm of noise."""
    rng = np.random.default_rng(seed)
    turn = rng.uniform(-1.3, 1.3, n)
    points = (0.05 + rng.normal(0, 0.004, n))[:, None] * np.stack([np.cos(turn), np.sin(turn)], 1)
    found = fit_circle(points, diameter=0.1 if known else None)
    std = np.sqrt(np.diag(found.covariance))
    return {name: around(found.centre[k], std[k], 0.0) for k, name in enumerate("xy")}


def pattern(seed, by):
    """The scan pattern of a wall, 1 m x 1 m, from a vehicle whose speed wanders by 1 %."""
    cloud, driven = simulate_patch(SETUP, WALL, size_m=1.0, seed=seed)
    truth = scan_lattice(driven, WALL)
    columns = {name: cloud[name] for name in {"gps_time", by}}
    table = measure_pattern(cloud, reference=truth.beam, **columns).to_frame()
    return {
        row.quantity.rsplit("_", 1)[0]: around(row.measured, row.std, getattr(truth, row.quantity))
        for row in table.itertuples()
    }


def prediction(seed, plan):
    """What a set-up known to 1 % and half a degree predicts, beside what it truly gives."""
    rng = np.random.default_rng(seed)
    sigmas = {"speed_m_s": 0.08, "scanner_heading_deg": 0.5, "range_m": 0.05}
    table = propagate(SETUP, WALL, sigmas=sigmas, draws=2000, seed=seed)
    off = {name: std * rng.standard_normal() for name, std in sigmas.items()}
    moved = {name: getattr(SETUP, name) + off[name] for name in list(sigmas)[:2]}
    setup = replace(SETUP, **moved)
    wall = Target(heading_deg=5, tilt_deg=3, range_m=5 + off["range_m"])
    lattice = scan_lattice(setup, wall.patch(setup))
    return {
        row.quantity: (row.low, row.high, float(getattr(lattice, row.quantity)))
        for row in table.itertuples()
        if np.isfinite(row.low) and row.quantity.split("_")[0] in ("profile", "point", "density")
    }


def displaced(seed, comparison, matched, turn_deg):
    """The mean displacement of the lines of a street, pairs given or found.

    The courses drift by 8 cm along a street, and the test set is turned about the vertical.
    """
    scene, names = canyon(5000 + seed), comparison.split("-")
    (test, model), pairs = (scene.surveys[name].segments for name in names), scene.pairs(*names)
    turn = np.radians((-1) ** seed * turn_deg)
    places = lines.midpoints(test)[np.nonzero(pairs)[0]]
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    shift = CENTRE_M - rotation @ CENTRE_M
    moves = scene.displacements(*names) + places @ (rotation.T - np.eye(3)) + shift
    test = test @ rotation.T + shift
    if matched:
        found = lines.match_displaced(test, model)
    else:
        found = lines.fit_displacement(test, model, pairs)
    known = found.n > 2 and np.isfinite(found.vector).all()
    if not known:
        return {}
    return {"vector": ellipsoid(found.vector - moves.mean(axis=0), found.covariance)}


def line_distance(seed, n):
    """The Hausdorff distance of n upright and level lines of 1 to 6 m that moved by 10 cm; pairs
    are given, ends are extracted to 3 cm."""
    rng = np.random.default_rng(seed)
    start = rng.uniform([0, 0, 0], [60, 20, 8], (n, 3))
    ways = np.eye(3)[rng.integers(0, 3, n)] * rng.uniform(1, 6, (n, 1))
    model = np.stack([start, start + ways], axis=1)
    test = model + [0.08, 0.06, 0.0] + rng.normal(0, 0.03, model.shape)
    pairs = np.eye(n, dtype=bool)
    found = lines.lhd(test, model, pairs=pairs)
    low, high = found.intervals()[["low", "high"]].to_numpy()[0]
    return {"distance": (low, high, None, found.value)}


def edge_of_walls(seed, angle_deg, density, noise):
    """Both ends of the line in which two walls of 4 m x 3 m meet, across the line and along it."""
    rng = np.random.default_rng(seed)
    n = rng.poisson(12 * density, 2)
    way = np.array([np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))])
    walls = [rng.uniform(0, 1, (k, 2)) * [4, 3] for k in n]
    first, second = (np.zeros((k, 2)) for k in n)
    first[:, 0], second[:] = walls[0][:, 0], walls[1][:, :1] * way
    points = np.vstack(
        [
            np.column_stack([plan, wall[:, 1]])
            for plan, wall in zip((first, second), walls, strict=True)
        ]
    )
    points += rng.normal(0, noise, points.shape)
    found = lines.extract_edges(points, tolerance=max(0.05, 3.5 * noise))
    if len(found) != 1:
        return {}
    ends, covariance = found.segments[0], found.covariance[0]
    figures = {}
    for k, height in enumerate((0.0, 3.0)):
        end = int(np.abs(ends[:, 2] - height).argmin())
        figures[f"across: {k}"] = ellipsoid(ends[end, :2], covariance[end, :2, :2])
        figures[f"along: {k}"] = around(ends[end, 2], covariance[end, 2, 2] ** 0.5, height)
    return figures


LENS_PX = {"gaussian": 0.6, "disc": 1.3, "diffraction": 1.4}
"""Widths of simulated lenses, in the unit of each."""


def edge_of_image(seed, lens):
    """MTF50 of a slanted edge behind a lens, 1 % of noise; sigmoids do not contain the lens."""
    spread, rng = PointSpread(LENS_PX[lens], lens=lens), np.random.default_rng(seed)
    angle = float(rng.uniform(4, 12))
    place = float(rng.uniform(-0.5, 0.5))
    # the renderer repeats its image: the next edge must be too far away for long tails
    image = render_edge((80, 260), spread, angle_deg=angle, position_px=place)[:, 100:160]
    found = fit_edge(image + 0.005 * rng.standard_normal(image.shape))
    return {"MTF50": around(found.mtf50, found.mtf50_sigma, spread.mtf50(angle))}


@cache
def clean_star(lens, tilt_deg):
    """The star of Banyoles, 5 degree sectors on 70 px, behind a lens."""
    spread, choices = PointSpread(LENS_PX[lens], lens=lens), {"cycles": 36, "radius_px": 70}
    return spread, render_star((150, 150), spread, centre=(0.3, -0.2), tilt_deg=tilt_deg, **choices)


def star_of_image(seed, lens, tilt_deg):
    """MTF50 of a Siemens star of the report's size behind a lens, 1 % of noise."""
    (spread, clean), rng = clean_star(lens, tilt_deg), np.random.default_rng(seed)
    image = clean + 0.005 * rng.standard_normal(clean.shape)
    found = measure_star(image, 74.5 + rng.uniform(-0.5, 0.5, 2), cycles=36, radius_px=70)
    fine = np.linspace(0.05, 0.9, 2000)
    truth = float(np.interp(-0.5, -spread.mtf_mean(fine), fine))
    return {"MTF50": around(found.mtf50, found.mtf50_sigma, truth)}


def photographed(seed, pixel_mm):
    """The lengths of the bars of a chart in a photograph by the tests' own camera."""
    rng = np.random.default_rng(seed)
    view = {"blur": rng.uniform(0.4, 1.2), "yaw": float(rng.choice([0, 20, -35, 45]))}
    shot = camera.shoot(CHART, pixel_mm, seed=seed, noise=0.01, margin=0.15, **view)
    corners = shot.pixels(CHART.corners()) + rng.normal(0, 0.5, (4, 2))
    there = chart_image.locate(None, CHART, corners=corners)
    quality = chart_image.evaluate_image(shot.linear, CHART, there)
    return {
        f"length: {row.name}": around(
            row.length_px, row.length_sigma_px, shot.length(CHART[row.name])
        )
        for row in quality.sizes.dropna(subset=["length_px"]).itertuples()
    }


def sensor(seed, n):
    """Gain and offset of a sensor from targets, Student's t as its p-values."""
    rng, radiance = np.random.default_rng(seed), np.linspace(10, 90, n)
    found = fit_sensor(radiance, 20 + 8 * radiance + rng.normal(0, 4, n))
    reach = t.ppf(0.975, n - 2)
    return {
        "gain": around(found.gain, found.std[0], 8.0, reach),
        "offset": around(found.offset, found.std[1], 20.0, reach),
    }


def reflectance(seed, n, stated):
    """Reflectance by the empirical line, targets with known standard errors; or without, then the
    reflectance of an exact DN by Student's t."""
    rng, truth = np.random.default_rng(seed), np.linspace(0.05, 0.5, n)
    dn = (truth + 0.05) / 0.0005 + rng.normal(0, 8 * stated, n)
    known = truth + rng.normal(0, 0.01 * (not stated), n)
    line = empirical_line(dn, known, std_dn=8.0 if stated else None)
    seen = (0.3 + 0.05) / 0.0005 + rng.normal(0, 8 * stated)
    found = float(line.reflectance(seen)), float(line.std(seen, std_dn=8.0 * stated))
    return {"reflectance": around(*found, 0.3, Z if stated else t.ppf(0.975, n - 2))}


def index(seed, std):
    """NDVI of two reflectances with errors of a share of each."""
    near, red = np.array([0.45, 0.08]) * (1 + std * np.random.default_rng(seed).normal(size=2))
    found = ndvi(near, red, std_near_infrared=std * near, std_red=std * red)
    return {"NDVI": around(*map(float, found), 0.37 / 0.53)}


def block(seed, noise):
    """Gains and haze of a block of 8 images, and the anisotropy of its ground."""
    rng = np.random.default_rng(seed)
    images, ties = np.repeat(np.arange(8), 60), np.tile(np.arange(60), 8)
    ground, gain = rng.uniform(0.05, 0.5, 60), np.exp(rng.normal(0, 0.05, 8))
    sun = np.cos(np.radians(40.0))
    view, azimuth = rng.uniform(0, 40, 480), rng.uniform(-180, 180, 480)
    v, along = np.radians(view), np.cos(np.radians(azimuth))
    light = sun * (1 + 0.2 * v**2 + 0.1 * v * along)
    radiance = gain[images] * (ground[ties] * light + 0.02) * (1 + rng.normal(0, noise, 480))
    seen = pd.DataFrame({"image": images, "tie": ties, "radiance": radiance})
    seen = seen.assign(sun_zenith_deg=40.0, view_zenith_deg=view, azimuth_deg=azimuth, radius=0.0)
    known = ground[:10] + rng.normal(0, 0.001, 10)
    control = pd.DataFrame({"tie": range(10), "reflectance": known, "std": 0.001})
    found = adjust_block(seen, control=control, haze=(0.0, np.inf))
    relative = found.gains["gain_std_percent"].to_numpy() / 100 * found.gains["gain"].to_numpy()
    gains = zip(found.gains["gain"], relative, gain, strict=True)
    ends = {f"gain: {k}": around(*values) for k, values in enumerate(gains)}
    ends["haze"] = around(*found.gains[["haze", "haze_std"]].iloc[0], 0.02)
    for name, true in (("b1", 0.2), ("b2", 0.1)):
        ends[name] = around(*found.anisotropy[[name, f"{name}_std"]].iloc[0], true)
    return ends


def mounting(seed, drift):
    """Boresight and lever arms of two heads from a drive each way past 48 m of another street."""
    errors = {"m": (0.008,) * 3, "deg": (0.004, 0.004, 0.012)} if drift else {"m": 0.0, "deg": 0.0}
    navigation = simulate.NavigationErrors(drift_m=errors["m"], drift_deg=errors["deg"])
    path_std = {f"path_std_{unit}": values for unit, values in errors.items()}
    street = make_test_field(length_m=48, seed=seed)
    system = study.two_heads(navigation)
    drives = drive_test_field(street, system, seed=seed, pulses_per_s=30_000)
    control = street.ground(spacing_m=4.0, seed=seed)
    known = {"lever_arms_m": system.assumed_lever_arms, "poles": street.poles}
    found = calibrate(drives, control=control, patches=40, **known, **path_std)
    truth = np.hstack([study.BORESIGHT_DEG, -np.array(study.LEVER_ARM_ERROR_M)])
    rows = zip(found.table.itertuples(), truth.ravel(), strict=True)
    kinds = {"deg": "boresight", "m": "lever arm"}
    return {
        f"{kinds[row.parameter.split('_')[1]]}: {row.parameter} {row.head}": (
            *(row.low, row.high),
            true,
        )
        for row, true in rows
    }


def levelled(seed, reach_m):
    """Shift and RMSE of heights: 100 levelled points on a street whose cloud errs over a length."""
    rng = np.random.default_rng(seed)
    cell = 0.25
    error = gaussian_filter(rng.standard_normal((240, 80)), reach_m / cell, mode="wrap")
    points = rng.uniform(0, 1, (40_000, 3)) * [60, 20, 0]
    points[:, 2] = 0.02 + 0.008 * map_coordinates(error / error.std(), points[:, :2].T / cell)
    points[:, 2] += rng.normal(0, 0.005, len(points))
    known = rng.uniform(1, 19, (4100, 3)) * [3, 1, 0] + [0, 0, 1] * rng.normal(0, 0.011, (4100, 1))
    table = test_field.height_differences(points, known)
    row, other = (test_field.height_accuracy(rows).iloc[0] for rows in (table[:100], table[100:]))
    # the intervals are for other reference points of the same field: what its errors share is in it
    ends = {name: row[[f"{name}_low_mm", f"{name}_high_mm"]] for name in ("mean", "rmse")}
    return {
        "shift of heights": (*ends["mean"], 20 + 8 * error.mean() / error.std()),
        "RMSE of heights": (*ends["rmse"], other["rmse_mm"]),
    }


def positions(seed, n):
    """Shift and RMSE in plan of poles, each seen from one side in two slices."""
    rng = np.random.default_rng(seed)
    place = np.column_stack([np.arange(n) * 12.0, rng.uniform(0, 20, n)])
    seen = place + [0.02, -0.01] + rng.normal(0, 0.01, (n, 2))
    turn = np.radians(rng.uniform(-80, 80, (n, 80)))
    away = 0.07 + rng.normal(0, 0.005, turn.shape)
    height = np.tile([1.0, 5.0], 40) + rng.uniform(-0.4, 0.4, turn.shape)
    xy = seen[:, None] + away[..., None] * np.stack([-np.cos(turn), np.sin(turn)], axis=-1)
    survey = place + rng.normal(0, 0.014, (n, 2))
    targets = pd.DataFrame(survey, columns=["x_m", "y_m"]).assign(z_m=0.0, diameter_m=0.14)
    cloud = np.column_stack([xy.reshape(-1, 2), height.ravel()])
    row = test_field.plan_accuracy(test_field.plan_differences(cloud, targets)).iloc[0]
    rmse = *row[["rmse_low_mm", "rmse_high_mm"]], None, row["rmse_mm"]
    shifts = {
        f"shift in plan: {axis}": (*row[[f"mean_{axis}_low_mm", f"mean_{axis}_high_mm"]], true)
        for axis, true in (("east", 20.0), ("north", -10.0))
    }
    return shifts | {"RMSE in plan": rmse}


def average(seed, n):
    """The mean of a method over cells and its difference from another, as the bench has them."""
    values = np.random.default_rng(seed).normal([3, 2.5], 1, (n, 2))
    methods = {"one": lambda data: data[0], "other": lambda data: data[1]}
    make, cases = (lambda k, seed: values[k]), bench.grid(k=range(n))
    results = bench.run(cases, methods, make=make)
    mean = bench.summary(results).iloc[0]
    apart = bench.compare(results, reference="other").iloc[0]
    return {
        "mean": (mean["low"], mean["high"], 3.0),
        "difference": (apart["low"], apart["high"], 0.5),
    }


def ranked(seed, n):
    """Rank correlations of two methods with the truth over n cases, and how far one is behind."""
    rng = np.random.default_rng(seed)
    values = np.arange(n)[:, None] / n + rng.normal(0, [0.1, 0.3], (n, 2))
    methods = {"sharp": lambda data: data[0], "dull": lambda data: data[1]}
    results = bench.run(bench.grid(k=range(n)), methods, make=lambda k, seed: values[k])
    rows = bench.rank(results, truth="k").set_index("method")
    found = {
        f"correlation: {name}": (row["low"], row["high"], None, row["spearman"])
        for name, row in rows.iterrows()
    }
    row = rows.loc["dull"]
    return found | {"behind": (row["behind_low"], row["behind_high"], None, row["behind_best"])}


@dataclass(frozen=True)
class Estimate:
    """An estimate: what it is called, its simulation, its cases, draws in CI and in full."""

    name: str
    draw: object
    cases: tuple
    few: int
    many: int


DISPLACED = {
    matched: bench.grid(
        comparison=("C1-C3", "C2-C3", "C1-TLS"), matched=(matched,), turn_deg=(0.1, 0.5)
    )
    for matched in (False, True)
}

ESTIMATES = (
    *(Estimate(f"board, {kind}", board, ({"kind": kind},), 12, 200) for kind in BOARDS),
    Estimate("rates", rate, bench.grid(share=(0.7, 0.95), n=(20, 100)), 20, 1000),
    Estimate("bootstrap", mean_of, bench.grid(n=(20, 100)), 20, 300),
    Estimate("repeatability", selections, bench.grid(scans=(4, 10)), 40, 300),
    Estimate("trend over distance", trend, bench.grid(n=(8, 40)), 150, 500),
    Estimate("pole position", pole, bench.grid(known=(True, False), n=(8, 12, 40)), 5, 300),
    Estimate("scan pattern", pattern, bench.grid(by=("gps_time", "scan_line")), 12, 60),
    Estimate("predicted pattern", prediction, bench.grid(plan=("wall",)), 30, 200),
    Estimate("line distance", line_distance, bench.grid(n=(10, 60)), 30, 200),
    Estimate("displacement, pairs given", displaced, DISPLACED[False], 8, 50),
    Estimate("displacement, pairs found", displaced, DISPLACED[True], 1, 50),
    Estimate(
        "edge of a cloud",
        edge_of_walls,
        bench.grid(angle_deg=(90, 60), density=(5, 100, 3000), noise=(0.005, 0.02)),
        *(1, 60),
    ),
    Estimate(
        "edge of an image",
        edge_of_image,
        bench.grid(lens=tuple(LENS_PX)),
        *(1, 100),
    ),
    Estimate(
        "Siemens star",
        star_of_image,
        bench.grid(lens=tuple(LENS_PX), tilt_deg=(0.0, 15.0)),
        *(1, 40),
    ),
    Estimate(
        "chart in photographs",
        photographed,
        bench.grid(pixel_mm=(2.7, 5.4, 8.0)),
        *(4, 60),
    ),
    Estimate("sensor calibration", sensor, bench.grid(n=(5, 12)), 30, 300),
    Estimate("reflectance", reflectance, bench.grid(n=(4, 12), stated=(True, False)), 15, 300),
    Estimate("NDVI", index, bench.grid(std=(0.01, 0.03)), 40, 500),
    Estimate("radiometric block", block, bench.grid(noise=(0.02,)), 20, 100),
    Estimate("mounting, exact paths", mounting, ({"drift": False},), 1, 200),
    Estimate("mounting, drift stated", mounting, ({"drift": True},), 0, 200),
    Estimate("heights of a field", levelled, bench.grid(reach_m=(0.5, 1.5)), 5, 300),
    Estimate("positions of a field", positions, bench.grid(n=(6, 16)), 2, 100),
    Estimate("mean over cells", average, bench.grid(n=(6, 20)), 10, 100),
    Estimate("ranks of methods", ranked, bench.grid(n=(12, 40)), 3, 200),
)


def simulated(estimate, draws):
    """A row for each draw, case and figure: whether the interval contains the truth."""
    rows, names = [], [*estimate.cases[0], "figure"]
    for case, seed in product(estimate.cases, range(draws)):
        for figure, numbers in estimate.draw(seed, **case).items():
            rows.append(case | {"figure": figure} | dict(zip(PARTS, numbers, strict=False)))
    table = pd.DataFrame(rows, columns=[*names, *PARTS]).astype(dict.fromkeys(PARTS, float))
    means = table.groupby(names, sort=False)["value"].transform("mean")
    table["truth"] = table["truth"].fillna(means)
    table["inside"] = (table["low"] <= table["truth"]) & (table["truth"] <= table["high"])
    table["figure"] = table["figure"].str.split(":").str[0]
    return table.dropna(subset=["low", "high"])


def shares(estimate, rows):
    """Coverage of each figure over all cases, with the least and the largest of a case."""
    table, by_case = [], list(estimate.cases[0])
    for figure, part in rows.groupby("figure", sort=False):
        found = stats.wilson(int(part["inside"].sum()), len(part))
        cases = part.groupby(by_case)["inside"].mean()
        whole = {
            "estimate": estimate.name,
            "figure": figure,
            "cases": len(cases),
            "draws": len(part),
        }
        ends = {"coverage": found.value, "low": found.low, "high": found.high}
        table.append(whole | ends | {"least case": cases.min(), "largest case": cases.max()})
    return pd.DataFrame(table)
