"""Targets in your own images: resolution, sensor and reflectance of each, band by band.

A table of targets says where they are in the image; :func:`measure` gives a row for each in each
band. The measures themselves are in :mod:`mmqa_lab.mtf` and :mod:`mmqa_lab.radiometry`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from mmqa_lab import mtf, radiometry
from mmqa_lab._checks import check_choice, check_columns, check_known, check_number, refuse
from mmqa_lab._results import NORMAL, sentences
from mmqa_lab.charts import decode
from mmqa_lab.radiometry.doubts import unlikely_term
from mmqa_lab.stats import student_reach

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["measure"]
__dir__ = __all__.copy

REGION = ("x_px", "y_px", "width_px", "height_px")

SETTINGS = {"exposure": 1.0, "time_s": 0.01, "f_number": 4.0}
"""Exposure of a calibrated image, relative or by time and f-number, and the usual values."""

UNEVEN_LIGHT = 0.05, 6.0
"""Share of their mean, and standard errors, by which halves of a region differ that lies across a
border."""


def measure(
    values: ArrayLike,
    what: str,
    *,
    targets: pd.DataFrame | None = None,
    linear: bool = False,
) -> pd.DataFrame:
    """Measure the targets of an image in each of its bands.

    Parameters
    ----------
    values : array_like, shape (bands, rows, columns)
        In the type of the file; of floats from 0 to 1, unless they are linear.
    what : {"edge", "star", "sharpness", "calibrate", "reflect"}
        ``edge``, ``star``: resolution on targets; ``sharpness``: of the whole image;
        ``calibrate``: gain and offset from targets of known radiance; ``reflect``: reflectance of
        targets without one by the empirical line of those with one.
    targets : DataFrame
        A row for each target with the columns of ``OF_TARGETS``, px, ``name`` and, of the last two
        measures, ``radiance`` or ``reflectance`` (or radiance_1, radiance_2, ... by band).
        Optionally to calibrate ``exposure``, or ``time_s`` and ``f_number`` (relative to 1/100 s at
        4); to reflect ``reflectance_std`` and ``anisotropy``. No other columns but ``image``.
    linear : bool
        Grey values are linear in light; else resolution is measured on values decoded from sRGB, of
        8 and 16 bits alike.

    Returns
    -------
    DataFrame
        Frequencies are per pixel; columns with low and high are 95 % confidence intervals; what
        cannot be measured is NaN.

    Raises
    ------
    ValueError
        If a column is missing or not known, a region leaves the image or is no number, 8-bit
        values that are not linear are to give radiances or reflectances, or values to decode
        have no full scale.
    """
    values = np.asarray(values)
    refuse(values.ndim != 3, "image", f"shape {values.shape}", "(bands, rows, columns)")
    needed, read = OF_TARGETS[check_choice(what, "measure", OF_TARGETS)]
    check_columns({} if targets is None else targets, needed, "targets")
    if targets is not None:
        targets = _known_targets(targets, needed, len(values))
    physical = what in ("calibrate", "reflect")
    if values.dtype.itemsize == 1 and physical and not linear:
        raise ValueError("Invalid image of 8 bits, usually not linear. Must have 16, or be linear.")
    rows, whole = [], values.dtype.kind == "u"
    if not (physical or linear or whole):
        shares = values.dtype.kind == "f" and np.nanmin(values) >= 0 and np.nanmax(values) <= 1
        found, must = f"{values.dtype} without a full scale", "uint8, uint16, from 0 to 1 or linear"
        refuse(not shares, "image", found, must)
    for number, band in enumerate(values, start=1):
        if not physical and (whole or not linear):
            full = np.float32(np.iinfo(values.dtype).max if whole else 1)
            band = decode(band / full, "linear" if linear else "srgb")
        rows += [{"band": str(number)} | row for row in read(band, targets, number)]
    return pd.DataFrame(rows)


def _known_targets(targets, needed, bands):
    """Targets with names, no column or row that is not understood, empty rows left out."""
    physical = ("radiance", "reflectance")
    known = {"image", "name", *REGION, "radius_px", "cycles", *physical, *SETTINGS}
    known |= {"reflectance_std", "anisotropy"}
    known |= {f"{name}_{k}" for name in physical for k in range(1, bands + 1)}
    for name in targets.columns:
        check_known(name, "column of targets", sorted(known))
    targets = targets.dropna(how="all").reset_index(drop=True)
    refuse(not len(targets), "targets", "none of this image", "one or more")
    for row, target in enumerate(targets[list(needed)].to_dict("records"), start=1):
        for name, value in target.items():
            check_number(value, f"{name} of target {row}", unit="px")
    usual = SETTINGS | {"name": range(1, len(targets) + 1)}
    return targets.assign(**{name: usual[name] for name in usual if name not in targets})


def _region(band, target):
    """The part of an image in a target's region."""
    column, row, width, height = (round(target[name]) for name in REGION)
    rows, columns = band.shape
    beyond = min(column, row) < 0 or column + width > columns or row + height > rows
    found = f"{width} x {height} px at {column}, {row}"
    refuse(beyond, "region of a target", found, f"within {columns} x {rows} pixels")
    return band[row : row + height, column : column + width]


def _each(band, targets, _, *, fit):
    """The figures of each edge or star; one that fails does not cost the others their rows."""
    for target in targets.to_dict("records"):
        part = _region(band, target) if fit is _edge else band
        try:
            figures = fit(part, target)
        except ValueError as error:
            figures = {"remarks": str(error)}
        yield {"target": target["name"]} | figures


def _edge(region, _):
    """MTF50 and full width at half maximum of an edge."""
    edge = mtf.fit_edge(region)
    share = NORMAL * edge.mtf50_sigma / edge.mtf50
    figures = _interval("mtf50", "_per_px", edge.mtf50, share * edge.mtf50)
    figures |= _interval("fwhm", "_px", edge.fwhm_px, share * edge.fwhm_px)
    return figures | {"angle_deg": edge.angle_deg, "n": edge.n, "remarks": "; ".join(edge.remarks)}


def _star(band, target):
    """MTF50 and MTF10 of a star."""
    known = {"cycles": int(target["cycles"]), "radius_px": target["radius_px"]}
    star = mtf.measure_star(band, (target["x_px"], target["y_px"]), **known)
    figures = _interval("mtf50", "_per_px", star.mtf50, NORMAL * star.mtf50_sigma)
    unseen = np.isnan(star.mtf50), "the star does not show the frequency of MTF50"
    remark = "; ".join([*star.remarks, *sentences(unseen)])
    return figures | {"mtf10_per_px": star.at(0.1), "remarks": remark}


def _sharpness(band, *_):
    """Median of the local sharpness of an image, with the interval of a median."""
    found = mtf.haar_sharpness(band)
    blocks = found["sharpness"].values[np.isfinite(found["sharpness"].values)]
    quartiles = np.quantile(blocks, [0.25, 0.5, 0.75]) if len(blocks) else np.full(3, np.nan)
    reach = 1.57 * (quartiles[2] - quartiles[0]) / max(len(blocks), 1) ** 0.5
    missing = found.attrs["not_measurable"]
    remark = f"{missing} blocks without detail" if missing else ""
    figures = {"target": "image"} | _interval("sharpness", "", quartiles[1], reach)
    return [figures | {"blocks": found["sharpness"].size, "remarks": remark}]


def _patches(band, targets, name, number):
    """Statistics of all targets in one band, and what is known of them in this band."""
    column = f"{name}_{number}" if f"{name}_{number}" in targets else name
    check_columns(targets, [column], "targets")
    y, x, high, wide = targets[["y_px", "x_px", "height_px", "width_px"]].to_numpy().T.round()
    places = np.column_stack([y, y + high, x, x + wide])
    found = radiometry.patch_statistics(band, places)
    found["std_dn"] = np.hypot(found["std_dn"], 12**-0.5)  # rounding alone gives a pixel that much
    found["std_error_dn"] = found["std_dn"] / np.sqrt(found["n"])
    # not of the few that are left out
    full = (found["saturated_share"] * (found["n"] + found["hot"])).round() > found["hot"]
    found["saturated_share"] *= full
    uneven = [_uneven(_region(band, target)) for target in targets.to_dict("records")]
    return found.assign(known=targets[column].to_numpy(), name=targets["name"], uneven=uneven)


def _uneven(region):
    """Whether quarters of a region differ, as where it lies half beside its target."""
    noise = np.median(np.abs(np.diff(region.astype(float)))) / 0.954  # of two pixels, normal
    share, errors = UNEVEN_LIGHT
    for part in (region, region.T):
        means = np.array([end.mean() for end in np.array_split(part, min(4, len(part)))])
        error = max(noise, 0.3) / np.sqrt(part.size / len(means))
        if np.ptp(means) > max(share * abs(means.mean()), errors * error):
            return True
    return False


def _said(name, uneven):
    """The remark on targets across a border; empty if there are none."""
    return [f"{', '.join(map(str, name[uneven]))} not even: half beside its target?"] * any(uneven)


def _calibrated(band, targets, number):
    """Gain and offset of a band from its unsaturated targets of known radiance."""
    patches = _patches(band, targets, "radiance", number)
    used = patches[(patches["saturated_share"] == 0) & patches["known"].notna()]
    taken = targets.loc[used.index, list(SETTINGS)].to_numpy()
    exposure = [one * radiometry.relative_exposure(*setting) for one, *setting in taken]
    errors = {"std_dn": used["std_dn"], "exposure": exposure}
    fit = radiometry.fit_sensor(used["known"], used["mean_dn"], **errors)
    reach = student_reach(fit.std, fit.freedom)
    figures = _interval("gain", "", fit.gain, reach[0])
    figures |= _interval("offset", "_dn", fit.offset, reach[1])
    signal = used["known"].to_numpy() * exposure
    remarks = [*_said(used["name"], used["uneven"]), *_of_hot(used), *fit.remarks]
    remark = "; ".join([*remarks, *_of_light(targets, used, signal)])
    return [figures | {"r_squared": fit.r_squared, "n": fit.n, "remarks": remark}]


def _of_hot(patches):
    """The remark on pixels that were left out of targets."""
    count = int(patches["hot"].sum())
    return [f"{count} odd pixels left out"] if count else []


def _of_light(targets, patches, known):
    """The remark on light that changes along a row of targets, from one end to the other."""
    places = targets.loc[patches.index, ["x_px", "y_px"]].to_numpy(dtype=float)
    away = places - places.mean(axis=0)
    along = away @ np.linalg.svd(away, full_matrices=False)[2][0]
    if not np.ptp(along) > 0:
        return []
    dn = patches["mean_dn"].to_numpy()
    design = np.stack([known, np.ones_like(known)], axis=1)
    change = unlikely_term(design, known * along / np.ptp(along), dn, np.ones_like(dn))
    change = abs(change) / np.polyfit(known, dn, 1)[0]
    return sentences((change, f"the light changes by {change:.0%} along the targets"))


def _reflectances(band, targets, number):
    """A row for each target without a known reflectance, by the empirical line of the others."""
    patches = _patches(band, targets, "reflectance", number)
    for name, usual in (("anisotropy", 1.0), ("reflectance_std", 0.0)):
        patches[name] = targets[name].fillna(usual) if name in targets else usual
    known = patches[patches["known"].notna() & (patches["saturated_share"] == 0)]
    found = f"{len(known)} unsaturated with a known reflectance"
    refuse(len(known) < 2, "targets", found, "two or more")
    dn = known["mean_dn"]
    given = (known["reflectance_std"] > 0).all()
    slope = np.polyfit(dn, known["known"], 1)[0]
    errors = np.hypot(known["std_error_dn"], known["reflectance_std"] / max(slope, 1e-12))
    stated = {"std_dn": errors} if given or len(known) == 2 else {}
    seen_as = known["anisotropy"]
    line = radiometry.empirical_line(dn, known["known"], anisotropy=seen_as, **stated)
    factor = student_reach(1.0, line.freedom)
    light = _of_light(targets, known, (known["known"] * seen_as).to_numpy())
    for row in patches[patches["known"].isna()].itertuples():
        saturated, inside = row.saturated_share > 0, dn.min() <= row.mean_dn <= dn.max()
        value = float(line.reflectance(row.mean_dn, anisotropy=row.anisotropy))
        value = np.nan if saturated else value
        reach = factor * float(line.std(row.mean_dn, std_dn=row.std_error_dn)) / row.anisotropy
        beyond = not inside, "beyond the reference targets"
        doubted = pd.concat([known, patches.loc[[row.Index]]])
        remarks = [*sentences((saturated, "saturated"), beyond), *line.remarks, *light]
        remarks += [*_said(doubted["name"], doubted["uneven"]), *_of_hot(doubted)]
        figures = {"target": row.name} | _interval("reflectance", "", value, reach)
        yield figures | {"references": line.n, "remarks": "; ".join(remarks)}


def _interval(name, unit, value, reach):
    """A figure with the ends of its interval."""
    ends = {f"{name}_low{unit}": value - reach, f"{name}_high{unit}": value + reach}
    return {f"{name}{unit}": value} | ends


OF_TARGETS: dict[str, tuple[tuple[str, ...], Callable]] = {
    "edge": (REGION, partial(_each, fit=_edge)),
    "star": (("x_px", "y_px", "radius_px", "cycles"), partial(_each, fit=_star)),
    "sharpness": ((), _sharpness),
    "calibrate": (REGION, _calibrated),
    "reflect": (REGION, _reflectances),
}
"""The columns of the targets that a measure needs, and its rows of one band."""
