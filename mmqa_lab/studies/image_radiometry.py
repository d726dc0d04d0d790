"""From digital numbers (DN) to reflectance: simulated targets, and the report's numbers.

The images of the report (EuroSDR 2013, image radiometry) are airborne and not published.
"""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pandas as pd

from mmqa_lab import radiometry
from mmqa_lab.bench import Comparison, grid
from mmqa_lab.published import table
from mmqa_lab.simulate.targets import ATMOSPHERES, expose

__all__ = [
    "BITS", "FULL_SCALE", "GAIN", "GREY_STEPS", "METHODS", "OFFSET", "PATCH", "REFERENCE_SETTING",
    "SETTINGS", "SOURCE", "SURROUNDINGS", "air_of", "bench", "calibrated", "class_errors",
    "dark_pixel", "equation_4", "field", "grey_wedge", "line", "one_target", "surfaces_of",
    "wedge_targets",
]  # fmt: skip

SOURCE = "eurosdr2013_radiometry"

GAIN, OFFSET, BITS = 28.0, 60.0, 12
"""Gain (DN per W m-2 sr-1 um-1 at reference exposure) and offset (DN) of the simulated sensor."""

FULL_SCALE = 2**BITS - 1
REFERENCE_SETTING = (0.005, 8.0)

SETTINGS = [(t / 1000, 8.0) for t in (3.5, 4.5, 5.5, 6.5)]
SETTINGS += [(t / 1000, 11.0) for t in (3.5, 4.25, 5, 5.75, 6.5)]
"""Assumed exposure times (s) and f-numbers: nine as in section 4.3, in the range of 5.2."""

GREY_STEPS = np.array([0.03, 0.05, 0.08, 0.12, 0.18, 0.25, 0.33, 0.45, 0.58, 0.70])
PATCH = 24
"""Side of a radiometric target in the image, px."""

BANDS = {"green": (1.08, 1.5), "red": (1.0, 1.0), "near infrared": (0.68, 0.4)}
"""Ratios of irradiance and of path radiance to red: scattering falls with the wavelength."""

ANISOTROPY = np.array([1.03, 1.06, 1.04])
"""Assumed reflectance of the reference targets towards the camera, over reflectance at nadir."""

OTHERS = dict(zip(BANDS, [(0.1, 0.2, 0.09), (0.11, 0.24, 0.06), (0.13, 0.29, 0.42)], strict=True))
"""Assumed reflectances of asphalt, gravel and grass."""

WATER, SURROUNDINGS = 0.015, 0.15
"""Assumed reflectance of the darkest surface, and mean reflectance of the ground."""


def grey_wedge(radiance, exposure, seed):
    """Return an image of targets side by side, and their rows and columns, shape (n, 4)."""
    light = np.repeat(np.repeat(radiance[None], PATCH, axis=0), PATCH, axis=1)
    image = expose(light * exposure, gain=GAIN, offset=OFFSET, bits=BITS, seed=seed)
    columns = PATCH * np.arange(len(radiance))
    return image, np.stack([0 * columns, 0 * columns + PATCH, columns, columns + PATCH], axis=1)


def wedge_targets(exposure_std, seed, settings=None):
    """Return targets of a grey wedge at all settings with errors of exposure, and the truth."""
    rng = np.random.default_rng([seed, 7])
    radiance, tables = ATMOSPHERES["clean"].radiance(GREY_STEPS), []
    for number, setting in enumerate(SETTINGS if settings is None else settings):
        recorded = radiometry.relative_exposure(*setting, reference=REFERENCE_SETTING)
        true = recorded * np.exp(exposure_std * rng.standard_normal())
        image, places = grey_wedge(radiance, true, [seed, number])
        found = radiometry.patch_statistics(image, places, full_scale=FULL_SCALE)
        known = dict(zip(("time_s", "f_number"), setting, strict=True))
        known["setting"] = f"{1000 * setting[0]:g} ms, f/{setting[1]:g}"
        tables.append(found.assign(**known, radiance=radiance, exposure=recorded))
    return pd.concat(tables, ignore_index=True), {"gain": GAIN, "offset": OFFSET}


def calibrated(targets):
    """Fit a sensor to targets by weighted least squares, without saturated targets."""
    std = targets["std_dn"].clip(0.3)  # rounding alone gives a pixel 0.3 DN
    choices = {"exposure": targets["exposure"], "std_dn": std, "full_scale": FULL_SCALE}
    return radiometry.fit_sensor(targets["radiance"], targets["mean_dn"], **choices)


def surfaces_of(band):
    """Return surfaces by class with ``reference``; the tarps of Hyytiälä as printed for green."""
    names = ["black tarp", *["bright tarps"] * 3, "uniform", "uniform", "grass"]
    reference = [*_printed("Hyytiälä"), *OTHERS[band]]
    return pd.DataFrame({"target_class": names, "reference": reference})


@cache
def _printed(campaign):
    """Printed reflectances of the reference targets of a campaign."""
    targets = table(SOURCE, "reference_targets")
    return targets["reflectance"][targets["campaign"] == campaign].dropna().to_numpy()


@cache
def _sensor(seed):
    """The sensor fitted to a grey wedge, the same in all bands and states of the air."""
    return calibrated(wedge_targets(0.0, seed, SETTINGS[:3])[0])


def air_of(name, band):
    """Return an atmosphere in a band."""
    mean, (irradiance, path) = ATMOSPHERES[name], BANDS[band]
    irradiance, path = mean.irradiance * irradiance, mean.path_radiance * path
    return replace(mean, irradiance=irradiance, path_radiance=path)


def field(air, band, reference_std, seed):
    """Return a field with the targets of Sjökulla as references, and the true surfaces.

    Parameters
    ----------
    air, band : str
        Names in ``ATMOSPHERES`` and ``BANDS``.
    reference_std : float
        Standard deviation of the known reflectances of the references, as a share.
    seed : int
        Seed of the field.

    Returns
    -------
    field : SimpleNamespace
        ``references`` (``mean_dn``, ``std_error_dn``, ``reflectance``, ``anisotropy``),
        ``surfaces`` (``mean_dn``, ``std_error_dn``), ``darkest_dn`` (of water), ``sensor``
        (fitted), ``exposure`` (relative, of the image), ``air`` (its true mean state, as from a
        perfect model) and ``standard_air`` (of a clear day).
    surfaces : DataFrame
        ``target_class`` and true reflectance, ``reference``.
    """
    key = [seed, list(ATMOSPHERES).index(air), list(BANDS).index(band)]
    rng, mean = np.random.default_rng([*key, 5]), air_of(air, band)
    true, surfaces = _printed("Sjökulla"), surfaces_of(band)
    exposure = radiometry.relative_exposure(0.0035, 11.0, reference=REFERENCE_SETTING)

    def measured(reflectance, number):
        light = mean.radiance(reflectance, surroundings=SURROUNDINGS, seed=[*key, number])
        image, places = grey_wedge(light, exposure, [*key, number])
        return radiometry.patch_statistics(image, places, full_scale=FULL_SCALE)

    known = true * (1 + reference_std * rng.standard_normal(len(true)))
    references = measured(true * ANISOTROPY, 1).assign(reflectance=known, anisotropy=ANISOTROPY)
    seen = measured(np.append(surfaces["reference"], WATER), 2)
    airs = {"air": mean, "standard_air": air_of("clean", band)}
    of_image = {"darkest_dn": float(seen["mean_dn"].iloc[-1]), "exposure": exposure}
    known = airs | of_image | {"references": references, "sensor": _sensor(seed)}
    return SimpleNamespace(surfaces=seen[:-1], **known), surfaces


def line(field, anisotropy=True):
    """Return reflectances by an empirical line, with or without the known anisotropy."""
    known = field.references
    factor = known["anisotropy"] if anisotropy else 1.0
    choices = {"std_dn": known["std_error_dn"], "anisotropy": factor}
    fit = radiometry.empirical_line(known["mean_dn"], known["reflectance"], **choices)
    return fit.reflectance(field.surfaces["mean_dn"])


def one_target(field):
    """Return reflectances in proportion to DN, scaled by the brightest reference."""
    known = field.references.iloc[-1]
    return field.surfaces["mean_dn"] * known["reflectance"] / known["mean_dn"]


def equation_4(field):
    """Return reflectances by equation 4, with the calibrated sensor and the state of the air."""
    air, mean = field.air, {"surroundings": SURROUNDINGS}
    light = field.sensor.radiance(field.surfaces["mean_dn"], exposure=field.exposure)
    known = {"path_radiance": air.radiance(0.0, **mean), "transmittance": air.direct, **mean}
    known["spherical_albedo"] = air.spherical_albedo
    return radiometry.reflectance_factor(light, air.irradiance, **known)


def dark_pixel(field):
    """Return reflectances by equation 4 in clean air; the darkest surface is taken for 1 %."""
    air = field.standard_air
    dn = field.surfaces["mean_dn"], field.darkest_dn
    light, dark = (field.sensor.radiance(value, exposure=field.exposure) for value in dn)
    known = {"path_radiance": dark - 0.01 * air.irradiance * air.direct / np.pi}
    return radiometry.reflectance_factor(light, air.irradiance, transmittance=air.direct, **known)


METHODS = {
    "one target": one_target,
    "empirical line": line,
    "line, anisotropy ignored": lambda field: line(field, anisotropy=False),
    "equation 4": equation_4,
    "dark pixel": dark_pixel,
}
"""Methods: functions of a :func:`field` that return the reflectances of its surfaces."""


def class_errors(found, surfaces):
    """Return the RMSE of reflectance in percent (equation 8) by class of target."""
    square = (100 * (np.asarray(found) / surfaces["reference"] - 1)) ** 2
    rmse = np.sqrt(square.groupby(surfaces["target_class"]).mean())
    return rmse.rename(lambda name: f"{name.replace(' ', '_')}_percent").to_dict()


def bench(methods=None, airs=("clean", "hazy"), reference_stds=(0, 0.03), seeds=range(20)):
    """Return the study's comparison: reflectances of surfaces in three bands.

    Parameters
    ----------
    methods : dict, optional
        Functions of a :func:`field`; by default ``METHODS``.
    airs : sequence of str
        Names of ``ATMOSPHERES``.
    reference_stds : sequence of float
        Standard deviations of the known reflectances of reference targets, as shares.
    seeds : iterable of int
        Seeds of the fields.

    Examples
    --------
    >>> len(bench().cases)
    12
    """
    cases = grid(air=airs, band=tuple(BANDS), reference_std=reference_stds)
    shown = {"figures": ("uniform_percent",)}
    return Comparison(cases, dict(methods or METHODS), field, class_errors, seeds, **shown)
