"""From digital numbers to radiance, reflectance and NDVI, on simulated targets."""

from dataclasses import replace

import numpy as np
import pandas as pd

from mmqa_lab.radiometry.reflectance import empirical_line, ndvi, reflectance_errors
from mmqa_lab.radiometry.sensor import fit_sensor, patch_statistics, relative_exposure
from mmqa_lab.simulate.targets import atmosphere, expose

GAIN, OFFSET, BITS = 28.0, 60.0, 12
"""DN per W m-2 sr-1 um-1 at reference exposure, and DN of darkness, of the simulated sensor."""

FULL_SCALE = 2**BITS - 1

GREY_STEPS = np.array([0.03, 0.05, 0.08, 0.12, 0.18, 0.25, 0.33, 0.45, 0.58, 0.70])

SETTINGS = {
    "1/200 s, f/4": (0.005, 4.0),
    "1/100 s, f/5.6": (0.01, 5.6),
    "1/100 s, f/4": (0.01, 4.0),
}
"""Exposure time and f-number; the reference is the last."""

REPEATS = 4
"""Images of the wedge at each setting: 120 targets, so that two standard errors are 95 %."""

FIELD_SETTING = (0.005, 4.0)
"""At which the reference targets and surfaces are taken."""

PATCH = 24
"""Side of a target in the image, px."""

BANDS = {"green": (1.08, 1.5), "red": (1.0, 1.0), "near infrared": (0.68, 0.4)}
"""Irradiance and path radiance over those in the red: scattering falls with the wavelength."""

REFERENCE_TARGETS = (0.05, 0.20, 0.45)

TARGET_ANISOTROPY = np.array([1.03, 1.06, 1.04])
"""How much more than at nadir the targets reflect towards the camera: painted boards, assumed."""

CLASSES = pd.DataFrame(
    {
        "target_class": ["asphalt", "gravel", "grass", "crop", "forest"],
        "green": [0.10, 0.20, 0.09, 0.11, 0.05],
        "red": [0.11, 0.24, 0.06, 0.07, 0.04],
        "near infrared": [0.13, 0.29, 0.42, 0.48, 0.30],
    }
)
"""Assumed reflectances of the surfaces to be measured."""


def grey_wedge(*, setting, seed, label_error=1.0):
    """Return an image of a grey wedge under clean air, its patches and their radiances.

    Parameters
    ----------
    setting : (float, float)
        Exposure time (s) and f-number.
    seed : int
    label_error : float
        True exposure over that of the label.
    """
    radiance = atmosphere("clean").radiance(GREY_STEPS)
    exposure = relative_exposure(*setting) * label_error
    light = np.repeat(np.repeat(radiance[None], PATCH, axis=0), PATCH, axis=1)
    image = expose(light * exposure, gain=GAIN, offset=OFFSET, bits=BITS, seed=seed)
    columns = PATCH * np.arange(len(GREY_STEPS))
    patches = np.stack([0 * columns, 0 * columns + PATCH, columns, columns + PATCH], axis=1)
    return image, patches, radiance


def calibrate(*, setting, seed, label_error=1.0, exclude=True):
    """Calibrate the sensor on one grey wedge.

    Returns
    -------
    SensorFit
    """
    image, patches, radiance = grey_wedge(setting=setting, seed=seed, label_error=label_error)
    found = patch_statistics(image, patches, full_scale=FULL_SCALE)
    spread = found["std_dn"].to_numpy().clip(0.3)
    return fit_sensor(
        radiance,
        found["mean_dn"],
        exposure=relative_exposure(*setting),
        std_dn=spread if exclude else None,
        full_scale=FULL_SCALE if exclude else np.inf,
    )


def sensor_trials(*, seeds):
    """Calibrate many times and hold the coefficients against the truth.

    All settings together make one calibration, 120 targets less the saturated ones.

    Returns
    -------
    DataFrame
        ``gain_z``, ``offset_z``: errors over their standard errors; ``saturated`` targets.
    """
    rows = []
    for seed in range(seeds):
        radiance, dn, spread, exposure = [], [], [], []
        for number, setting in enumerate([*SETTINGS.values()] * REPEATS):
            image, patches, known = grey_wedge(setting=setting, seed=[seed, number])
            found = patch_statistics(image, patches, full_scale=FULL_SCALE)
            radiance.append(known)
            dn.append(found["mean_dn"])
            spread.append(found["std_dn"].clip(0.3))
            exposure.append(np.full(len(known), relative_exposure(*setting)))
        fit = fit_sensor(
            np.concatenate(radiance),
            np.concatenate(dn),
            exposure=np.concatenate(exposure),
            std_dn=np.concatenate(spread),
            full_scale=FULL_SCALE,
        )
        z = (np.array([fit.gain, fit.offset]) - [GAIN, OFFSET]) / fit.std
        rows.append((*z, fit.saturated))
    return pd.DataFrame(rows, columns=["gain_z", "offset_z", "saturated"])


def trials(*, seeds):
    """Recover the reflectance of surfaces by the empirical line.

    Three reference targets, whose anisotropy is allowed for or ignored, in clean and hazy air.

    Parameters
    ----------
    seeds : int

    Returns
    -------
    DataFrame
        ``atmosphere``, ``anisotropy``, ``band``, ``target_class``, ``seed``, ``reflectance``,
        ``std`` (propagated), ``reference``.
    """
    rows = []
    for air in ("clean", "hazy"):
        for band, (sun, haze) in BANDS.items():
            base = atmosphere(air)
            layer = replace(
                base,
                irradiance=sun * base.irradiance,
                path_radiance=haze * base.path_radiance,
            )
            for seed in range(seeds):
                rows += _one_trial(air, band, layer, [seed, len(rows)])
    names = ["atmosphere", "anisotropy", "band", "seed", "target_class", "reflectance", "std"]
    return pd.DataFrame(rows, columns=[*names, "reference"])


def summary(table):
    """Errors by atmosphere, anisotropy, band and class (equations 6-8)."""
    return reflectance_errors(table, by=["atmosphere", "anisotropy", "band", "target_class"])


def ndvi_table(table):
    """Return NDVI of the surfaces with its propagated and its actual standard deviation.

    Returns
    -------
    DataFrame
        ``atmosphere``, ``target_class``, ``ndvi`` (mean), ``true_ndvi``, ``std_propagated``,
        ``std_measured`` over the seeds.
    """
    used = table[table["anisotropy"] == "allowed for"]
    keys = ["atmosphere", "target_class", "seed"]
    wide = used.pivot(index=keys, columns="band", values=["reflectance", "std", "reference"])
    value, std = ndvi(
        wide["reflectance", "near infrared"],
        wide["reflectance", "red"],
        std_near_infrared=wide["std", "near infrared"],
        std_red=wide["std", "red"],
    )
    true, _ = ndvi(wide["reference", "near infrared"], wide["reference", "red"])
    frame = pd.DataFrame({"ndvi": value, "std": std, "true_ndvi": true}, index=wide.index)
    groups = frame.groupby(["atmosphere", "target_class"], sort=False)
    return pd.DataFrame(
        {
            "ndvi": groups["ndvi"].mean(),
            "true_ndvi": groups["true_ndvi"].mean(),
            "std_propagated": groups["std"].mean(),
            "std_measured": groups["ndvi"].std(),
        }
    ).reset_index()


def _one_trial(air, band, layer, seed):
    """Rows of one band, atmosphere and seed."""
    known = np.array(REFERENCE_TARGETS)
    seen = _measured(layer.radiance(known * TARGET_ANISOTROPY, seed=[*seed, 2]), seed)
    unknown = CLASSES[band].to_numpy()
    dn = _measured(layer.radiance(unknown, seed=[*seed, 3]), [*seed, 1])
    rows = []
    for name, factor in (("allowed for", TARGET_ANISOTROPY), ("ignored", 1.0)):
        line = empirical_line(
            seen["mean_dn"], known, std_dn=seen["std_error_dn"], anisotropy=factor
        )
        value = line.reflectance(dn["mean_dn"])
        std = line.std(dn["mean_dn"], std_dn=dn["std_error_dn"])
        rows += [
            (air, name, band, seed[0], *row)
            for row in zip(CLASSES["target_class"], value, std, unknown, strict=True)
        ]
    return rows


def _measured(radiance, seed):
    """Statistics of patches of these radiances."""
    light = np.repeat(np.repeat(radiance[None], PATCH, axis=0), PATCH, axis=1)
    light = light * relative_exposure(*FIELD_SETTING)
    image = expose(light, gain=GAIN, offset=OFFSET, bits=BITS, seed=seed)
    columns = PATCH * np.arange(len(radiance))
    patches = np.stack([0 * columns, 0 * columns + PATCH, columns, columns + PATCH], axis=1)
    return patch_statistics(image, patches, full_scale=FULL_SCALE)
