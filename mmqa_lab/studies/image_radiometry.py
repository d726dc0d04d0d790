"""Image radiometry: targets of known truth, photographs, and the numbers of the report.

Everything is simulated but the photographs of ``REAL_EDGES`` and ``PHOTOGRAPHS``. The images of the
report (EuroSDR 2013, image radiometry) are airborne.
"""

import itertools
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pandas as pd

from mmqa_lab import bench, io, plots, samples
from mmqa_lab.mtf import fit_edge
from mmqa_lab.published import ledger, table
from mmqa_lab.radiometry import fit_sensor, patch_statistics, relative_exposure
from mmqa_lab.simulate.targets import (
    ATMOSPHERES,
    Atmosphere,
    PointSpread,
    expose,
    render_edge,
)
from mmqa_lab.studies import NOTES, SMALL, stated

QUICK = SMALL["image_radiometry"]
"""Small parameters for the tests."""

SOURCE, TOLD = "eurosdr2013_radiometry", NOTES["image_radiometry"]

LOW, HIGH = 0.1, 0.6
"""Levels of all targets of resolution; their noise is a share of the difference."""

PHOTOGRAPHS = TOLD["photographs"]

REAL_EDGES = {
    "slanted edge": ("images/slanted_edge.tif", (slice(None), slice(None)), 0.285),
    "ISO chart, left": ("images/iso_chart_mono.jpg", (slice(478, 652), slice(380, 490)), 0.34),
    "ISO chart, top": ("images/iso_chart_mono.jpg", (slice(353, 440), slice(478, 761)), 0.28),
}
"""File, rows and columns of an edge, and MTF50 (cycles per pixel) by other tools.

Those tools were given the codes of the files, not light: so are ours.
"""

BAR_STEP = 2 ** (1 / 6)
"""Ratio of neighbouring widths of bars."""

GAIN, OFFSET, BITS = 28.0, 60.0, 12
"""DN per W m-2 sr-1 um-1 at reference exposure, and DN of darkness, of the simulated sensor."""

FULL_SCALE = 2**BITS - 1
REFERENCE_SETTING = (0.005, 8.0)

SETTINGS = [(t / 1000, 8.0) for t in (3.5, 4.5, 5.5, 6.5)]
SETTINGS += [(t / 1000, 11.0) for t in (3.5, 4.25, 5, 5.75, 6.5)]
"""Exposure times (s) and f-numbers, assumed: nine as in section 4.3, in the range of 5.2."""

GREY_STEPS = np.array([0.03, 0.05, 0.08, 0.12, 0.18, 0.25, 0.33, 0.45, 0.58, 0.70])
PATCH = 24
"""Side of a radiometric target in the image, px."""

BANDS = {"green": (1.08, 1.5), "red": (1.0, 1.0), "near infrared": (0.68, 0.4)}
"""Irradiance and path radiance over those in the red: scattering falls with the wavelength."""

ANISOTROPY = np.array([1.03, 1.06, 1.04])
"""How much more than at nadir the reference targets reflect towards the camera, assumed."""

UNIFORM_AND_GRASS = TOLD["uniform_and_grass"]
"""Assumed reflectances of asphalt, gravel and grass."""

WATER = 0.015
"""Assumed reflectance of the darkest surface."""

SURROUNDINGS = 0.15
"""Mean reflectance of the ground."""


def edge_patch(sigma_px, noise, seed):
    """A noisy patch with an edge at a random angle of 3 to 11.5 degrees; its MTF50 and FWHM."""
    rng = np.random.default_rng(seed)
    angle, place = rng.uniform(3, 11.5), rng.uniform(-1, 1)
    spread = PointSpread(sigma_px)
    choices = {"angle_deg": angle, "position_px": place, "low": LOW, "high": HIGH}
    image = noisy(render_edge((100, 64), spread, **choices), noise, rng)
    return image, {"mtf50": spread.mtf50(angle), "fwhm_px": spread.fwhm(angle)}


def edge_errors(found, truth):
    """Errors in percent of MTF50, or of the numbers of a dict, where the truth has them."""
    named = found if isinstance(found, dict) else {"mtf50": found}
    known = [name for name in named if name in truth]
    return {f"{name}_error_percent": 100 * (named[name] / truth[name] - 1) for name in known}


def estimator(method, figures=("mtf50",)):
    """Return a function that measures these figures of a patch with one edge."""
    return lambda patch: {name: getattr(fit_edge(patch, method=method), name) for name in figures}


METHODS = {
    "Gaussian sigmoid": estimator("sigmoid", ("mtf50", "fwhm_px")),
    "logistic sigmoid": estimator("logistic", ("mtf50", "fwhm_px")),
    "edge method, sigmoid": estimator("sigmoid"),
    "edge method, binned": lambda patch: fit_edge(patch).mtf50,
}
"""Estimators of resolution: functions of an image patch that shows one edge."""

COLOURS = dict(zip(METHODS, ("blue", "vermilion", "green", "orange"), strict=True))
"""A colour of :mod:`mmqa_lab.plots` for each estimator."""


LABELS = {"mtf50_error_percent": "MTF50 error (%)", "fwhm_px_error_percent": "FWHM error (%)"}


def comparison(quick=False):
    """Compare estimators of resolution on edges of known blur.

    Returns
    -------
    Comparison
        Every method is a function of a patch, an array of grey values with one edge. It returns
        MTF50 in cycles per pixel, or a dict with ``mtf50`` and ``fwhm_px``.
    """
    sigmas = QUICK["sigmas_px"] if quick else (0.35, 0.5, 0.7, 1.0, 1.5, 2.0)
    cases = bench.grid(sigma_px=sigmas, noise=(0.01,) if quick else (0.01, 0.03))
    return bench.Comparison(
        cases,
        dict(METHODS),
        edge_patch,
        score=edge_errors,
        seeds=range(QUICK["edges"] if quick else 20),
        tables=lambda results: {"edge_errors": error_table(results)},
        figures=lambda results: {"edge_errors": draw_errors(results)},
    )


def error_table(results):
    """Median and 90 % range of the errors of each method, and what could not be measured."""
    groups = bench.cell_table(results).groupby("method", sort=False)
    rows = {}
    for name in bench.figure_names(results):
        of_name = groups[name]
        rows |= {f"{name}_median": of_name.median(), f"{name}_p05": of_name.quantile(0.05)}
        rows |= {
            f"{name}_p95": of_name.quantile(0.95),
            f"{name}_missing": of_name.apply(lambda values: values.isna().sum()),
        }
    return pd.DataFrame(rows).reset_index()


def draw_errors(results):
    """Draw median and 90 % range of the errors over the blur, for all methods."""
    figures = bench.figure_names(results)
    figure, axes = plots.subplots(1, len(figures), width="double", height_mm=65, squeeze=False)
    for ax, name in zip(axes.flat, figures, strict=True):
        for shift, (method, rows) in enumerate(
            bench.cell_table(results).groupby("method", sort=False)
        ):
            groups = rows.groupby("sigma_px")[name]
            low, middle, high = (groups.quantile(q) for q in (0.05, 0.5, 0.95))
            colour = plots.COLOURS[COLOURS.get(method, "black")]
            look = {"fmt": "o", "ms": 3, "capsize": 2, "color": colour, "label": method}
            ax.errorbar(
                middle.index * (1 + 0.02 * shift), middle, [middle - low, high - middle], **look
            )
        ax.axhspan(-1, 1, color=plots.COLOURS["sky"], alpha=0.3)
        ax.set(xlabel="blur before the pixel, sigma (px)", ylabel=LABELS.get(name, name))
    axes.flat[-1].legend(loc="upper left", bbox_to_anchor=(1, 1))
    return figure


def real_patch(photograph, seed=0):
    """An edge of a real photograph, and its MTF50 by other tools."""
    name, part, other = REAL_EDGES[photograph]
    return io.read_image(samples.real_path(name))[part] / 255, {"mtf50": other}


def noisy(image, noise, rng):
    """An image with noise of a share of the targets' contrast."""
    return image + noise * (HIGH - LOW) * rng.standard_normal(image.shape)


def grey_wedge(radiance, exposure, seed):
    """An image of targets side by side, and their places (rows and columns) in it."""
    light = np.repeat(np.repeat(radiance[None], PATCH, axis=0), PATCH, axis=1)
    image = expose(light * exposure, gain=GAIN, offset=OFFSET, bits=BITS, seed=seed)
    columns = PATCH * np.arange(len(radiance))
    return image, np.stack([0 * columns, 0 * columns + PATCH, columns, columns + PATCH], axis=1)


def wedge_targets(label_std, seed, settings=None):
    """Targets of a grey wedge at all settings, with labels of the exposure that err; the truth."""
    rng = np.random.default_rng([seed, 7])
    tables = []
    for number, setting in enumerate(SETTINGS if settings is None else settings):
        exposure = relative_exposure(*setting, reference=REFERENCE_SETTING)
        radiance = ATMOSPHERES["clean"].radiance(GREY_STEPS)
        true = exposure * np.exp(label_std * rng.standard_normal())
        image, places = grey_wedge(radiance, true, [seed, number])
        found = patch_statistics(image, places, full_scale=FULL_SCALE)
        label = f"{1000 * setting[0]:g} ms, f/{setting[1]:g}"
        known = dict(zip(("time_s", "f_number"), setting, strict=True))
        known |= {"setting": label, "radiance": radiance, "exposure": exposure}
        tables.append(found.assign(**known))
    return pd.concat(tables, ignore_index=True), {"gain": GAIN, "offset": OFFSET}


def calibrated(targets):
    """The sensor that targets show: weighted, and without the saturated ones."""
    std = targets["std_dn"].clip(0.3)  # rounding alone gives a pixel 0.3 DN
    choices = {"exposure": targets["exposure"], "std_dn": std, "full_scale": FULL_SCALE}
    return fit_sensor(targets["radiance"], targets["mean_dn"], **choices)


@dataclass(frozen=True, eq=False)
class Field:
    """What a method may know of a field.

    ``references`` has ``mean_dn``, ``std_error_dn``, ``reflectance``, ``anisotropy``; ``surfaces``
    has ``mean_dn``, ``std_error_dn``; ``darkest_dn`` is that of water; ``sensor`` is a fitted
    sensor and ``exposure`` that of the image; ``air`` is the mean state of the air as a perfect
    model would give it, ``standard_air`` that of a clear day.
    """

    references: pd.DataFrame
    surfaces: pd.DataFrame
    darkest_dn: float
    sensor: object
    exposure: float
    air: Atmosphere
    standard_air: Atmosphere


def surfaces_of(band):
    """Surfaces by class, with ``reference``; tarps of Hyytiälä as printed for the green."""
    tarps = table(SOURCE, "reference_targets").query("campaign == 'Hyytiälä'")["reflectance"]
    others = UNIFORM_AND_GRASS[band]
    names = ["black tarp", *["bright tarps"] * 3, "uniform", "uniform", "grass"]
    return pd.DataFrame({"target_class": names, "reference": [*tarps.dropna(), *others]})


def air_of(name, band):
    """An atmosphere in a band."""
    mean, (irradiance, path) = ATMOSPHERES[name], BANDS[band]
    irradiance, path = mean.irradiance * irradiance, mean.path_radiance * path
    return replace(mean, irradiance=irradiance, path_radiance=path)


def field(air, band, reference_std, seed):
    """A field with the portable targets of Sjökulla, whose reflectances are known to a share."""
    key = [seed, list(ATMOSPHERES).index(air), list(BANDS).index(band)]
    rng, mean = np.random.default_rng([*key, 5]), air_of(air, band)
    targets = table(SOURCE, "reference_targets").query("campaign == 'Sjökulla'")
    true, surfaces = targets["reflectance"].dropna().to_numpy(), surfaces_of(band)
    exposure = relative_exposure(0.0035, 11.0, reference=REFERENCE_SETTING)

    def measured(reflectance, number):
        """Statistics of patches of these reflectances."""
        light = mean.radiance(reflectance, surroundings=SURROUNDINGS, seed=[*key, number])
        image, places = grey_wedge(light, exposure, [*key, number])
        return patch_statistics(image, places, full_scale=FULL_SCALE)

    known = true * (1 + reference_std * rng.standard_normal(len(true)))
    references = measured(true * ANISOTROPY, 1).assign(reflectance=known, anisotropy=ANISOTROPY)
    seen = measured(np.append(surfaces["reference"], WATER), 2)
    sensor = calibrated(wedge_targets(0.0, seed, SETTINGS[:3])[0])
    dark = float(seen["mean_dn"].iloc[-1])
    clean = air_of("clean", band)
    return Field(references, seen[:-1], dark, sensor, exposure, mean, clean), {"surfaces": surfaces}


def class_errors(found, truth):
    """RMSE of reflectance in percent (equation 8) by class of target."""
    surfaces = truth["surfaces"]
    square = (100 * (found / surfaces["reference"] - 1)) ** 2
    rmse = np.sqrt(square.groupby(surfaces["target_class"]).mean())
    return rmse.rename(lambda name: f"{name.replace(' ', '_')}_percent").to_dict()


def mosaic(block, adjustment=None):
    """Return a block as one picture: each cell from the image whose centre is nearest.

    Without an adjustment it shows radiance as the sensor gives it.
    """
    flight, stations = block.flight, block.stations
    x, y = (stations[name].to_numpy() / flight.gsd_m for name in ("x_m", "y_m"))
    rows, columns = (v.ravel() for v in np.indices(block.surface.shape))
    gaps = [np.hypot(columns - x0, rows - y0) for x0, y0 in zip(x, y, strict=True)]
    image = np.argmin(gaps, axis=0)
    row = np.round(y[image] - 0.5 - rows + (flight.rows - 1) / 2).astype(int)
    column = np.round(columns + 0.5 - x[image] + (flight.columns - 1) / 2).astype(int)
    place = image, row.clip(0, flight.rows - 1), column.clip(0, flight.columns - 1)
    values = block.radiance(*place)
    if adjustment is not None:
        values = adjustment.correct(block.pixels(*place).assign(radiance=values))
    return values.reshape(block.surface.shape)


def ledger_entries(*, corner, sensors, stable, reflectance, laboratory):
    """Return our values for the printed results that a simulation can be compared with.

    Parameters
    ----------
    corner : Interval
        Factor by which bars are resolved worse in the corner.
    sensors : DataFrame
        Of the simulated calibrations: ``r_squared``, ``offset_dn``, ``offset_std_dn``.
    stable : Series
        Mean difference between settings, percent, of each seed.
    reflectance : DataFrame
        Cells of the bench in clean air, with the errors by class in percent.
    laboratory : DataFrame
        Errors in percent that 10 and 20 % of radiance make: ``target_class``, ``low``, ``high``.
    """
    tables = ("resolution", "calibration", "reflectance")
    resolution, calibration, other = (partial(_entry, f"{name}_results") for name in tables)
    found = [resolution("corner_factor", corner.value, corner, TOLD["predicted"], "predicted")]
    lines = [1000 / pixel for pixel in (12.0, 12.5, 11.5)]
    found.append(resolution("theoretical_resolution", *_split(lines), TOLD["pixels"], "predicted"))
    r2 = _split(sensors["r_squared"].quantile([0.025, 0.025, 0.975]))
    found += [calibration(f"dmc_r2_{site}", *r2, TOLD["linear"]) for site in SITES]
    offset, std = sensors[["offset_dn", "offset_std_dn"]].mean() - [OFFSET, 0]
    ends = offset - 2 * std, offset + 2 * std
    found.append(calibration("dmc_intercept", offset, ends, TOLD["dark"]))
    between = _split([stable.mean(), *stable.quantile([0.025, 0.975])])
    for name, band in itertools.product(CHANGES, ("rgb", "nir")):
        note = TOLD[f"stability_{band}"]
        found.append(calibration(f"stability_{band}_{name}", *between, note, "fitted"))
    for cell, ours in TOLD["comparable"].items():
        rows = reflectance[reflectance["method"] == ours["method"]]
        errors = rows[f"{ours['target_class']}_percent"]
        ends = errors.quantile([0.025, 0.975])
        found.append(other(cell, np.sqrt((errors**2).mean()), ends, ours["note"]))
    for cell, name in LABORATORY.items():
        ends = laboratory.set_index("target_class").loc[name, ["low", "high"]]
        found.append(other(cell, ends.mean(), ends, TOLD["passed_on"]))
    corner_deg = np.degrees(np.arctan2(np.hypot(*DMC_PIXELS) / 2 * 0.012, 120.0))
    ends = (corner_deg - 0.1, corner_deg + 0.1)
    return [*found, other("brf_view_angles", corner_deg, ends, TOLD["data_sheet"], "predicted")]


DMC_PIXELS = (13_824, 7_680)
CHANGES = ("same_aperture", "other_aperture", "other_day")
SITES = ("sjokulla", "banyoles")
LABORATORY = {"bright_laboratory": "bright tarps", "black_tarp_laboratory": "black tarp"}


def _split(three):
    """A value and its ends."""
    value, *ends = three
    return value, ends


def _entry(name, cell, value, ends, note, kind="measured"):
    """One row of the ledger; the ends are a pair or an Interval."""
    low, high = (ends.low, ends.high) if hasattr(ends, "low") else ends
    choices = {"low": min(low, value), "high": max(high, value), "note": note}
    return ledger.entry(SOURCE, name, cell, value, kind=kind, **choices)


check = stated("image_radiometry")


def checks(*, edges, stars, sensors, reflectance, block):
    """Compare what the notebook says with this run.

    Parameters
    ----------
    edges, stars : Dataset
        Of :func:`mmqa_lab.bench.run`: estimators on edges and on stars.
    sensors, reflectance : DataFrame
        Cells of the benches of calibrations and of estimators of reflectance.
    block : DataFrame
        ``adjustment``, ``cv_before_percent``, ``cv_after_percent``, ``rmse_percent``.

    Yields
    ------
    mmqa_lab.run.Check
    """
    cells = bench.cell_table(edges).query("noise <= 0.01")
    names = ["mtf50_error_percent", "fwhm_px_error_percent"]
    worst = cells.query("method == 'Gaussian sigmoid'")[names].abs().quantile(0.95)
    yield check(
        "edges",
        worst.max() < 1,
        f"95 % of edges within {worst.iloc[1]:.2f} % and {worst.iloc[0]:.2f} %",
    )
    logistic = cells.query("method == 'logistic sigmoid'")["fwhm_px_error_percent"].median()
    yield check("logistic", logistic < -10, f"median {logistic:.1f} %")
    star = float(stars["mtf_error"].max())
    yield check("stars", star < 0.02, f"largest error {star:.4f}")
    weighted = sensors.query("method == 'weighted, without saturated targets' and label_std == 0")
    shares = [(weighted[f"{name}_z"].abs() <= 2).mean() for name in ("gain", "offset")]
    slack = 3 * np.sqrt(0.95 * 0.05 / len(weighted))
    yield check(
        "sensor",
        min(shares) > 0.95 - slack,
        f"gain {100 * shares[0]:.1f} %, offset {100 * shares[1]:.1f} % of {len(weighted)}",
        percent=100 * slack,
    )
    exact = reflectance.query("reference_std == 0 and air == 'clean'").groupby("method")
    error = exact["uniform_percent"].mean()
    yield check(
        "empirical_line",
        error["empirical line"] < 1 and error["line, anisotropy ignored"] > 2,
        f"uniform surfaces {error['empirical line']:.2f} % and "
        f"{error['line, anisotropy ignored']:.2f} %",
    )
    rows = block.set_index("adjustment")
    before, after, rmse = rows.loc[
        "absolute", ["cv_before_percent", "cv_after_percent", "rmse_percent"]
    ]
    yield check(
        "block",
        after < 0.1 * before and rmse < 2.5,
        f"variation at ties {before:.2f} % before, {after:.2f} % after; RMSE {rmse:.2f} %",
    )


def answer(errors, stars, reflectance):
    """The study's answer in one sentence; ``errors`` is :func:`error_table` at 1 % noise."""
    row = errors.set_index("method").loc["Gaussian sigmoid"]
    names = ("mtf50_error_percent", "fwhm_px_error_percent")
    edge = max(abs(row[f"{name}_{end}"]) for name in names for end in ("p05", "p95"))
    line = reflectance.query("method == 'empirical line' and air == 'clean'")
    by_std = line.groupby("reference_std")["uniform_percent"].mean()
    return (
        f"On simulated images (the source's are airborne) at 1 % noise, edges give FWHM and MTF50 "
        f"within {edge:.1f} %, stars the MTF within {float(stars['mtf_error'].max()):.3f}; "
        f"reflectance by the empirical line is good to {by_std.iloc[0]:.1f} % with exact reference "
        f"targets and {by_std.iloc[-1]:.1f} % with targets known to {100 * by_std.index[-1]:.0f} %."
    )
