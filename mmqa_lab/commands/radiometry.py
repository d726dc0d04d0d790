"""Resolution and radiometry of images with several bands."""

from pathlib import Path

from mmqa_lab.commands import OUTPUT, Lazy, command, option, switch
from mmqa_lab.commands._output import print_rows, with_progress

np = Lazy("numpy")
pd = Lazy("pandas")
checks = Lazy("mmqa_lab._checks")
image_files = Lazy("mmqa_lab.io")
mtf = Lazy("mmqa_lab.mtf")
stats = Lazy("scipy.stats")
tables = Lazy("mmqa_lab.io")
radiometry = Lazy("mmqa_lab.radiometry")

REGION = ("x_px", "y_px", "width_px", "height_px")

NEEDED = {
    "edge": REGION,
    "star": ("x_px", "y_px", "radius_px", "cycles"),
    "bars": ("x_px", "y_px", "period_px", "bars", "angle_deg"),
    "sharpness": (),
    "calibrate": REGION,
    "reflect": REGION,
}

OVER_IMAGE = {"edge": "fwhm_px", "star": "fwhm_px", "bars": "resolving_px"}
"""What is regressed on the distance from the centre."""

DARK_SHARE, DARK_REFLECTANCE = 0.001, 0.01

SATURATED_SHARE = 0.01

ROUNDING_DN = 12**-0.5
"""Standard deviation that rounding alone gives a pixel."""


@command(
    "resolution, calibration and reflectance of images with several bands",
    option("measure", None, "what to measure, see above", choices=tuple(NEEDED)),
    option("image", "IMAGE", "JPEG, PNG or TIFF", nargs="+"),
    option("--targets", "FILE", "CSV, see above", Path),
    switch("--linear", "8-bit values are linear in light"),
    option("--gsd-cm", "CM", "size of a pixel on the ground", float),
    option("--pixel-um", "UM", "size of a detector pixel", float),
    switch("--over-image", "regression over the image"),
    switch("--through-zero", "calibrate without offset"),
    option("--radiance", "FILE", "image of known radiance, see above"),
    switch("--even", "images of even ground, see above"),
    switch("--dark-pixel", "darkest pixels as reference"),
    switch("--repeatability", "over images and heights"),
    *OUTPUT,
    examples=(
        "star IMG_1.tif --targets stars.csv --gsd-cm 5 --pixel-um 12",
        "calibrate a.tif b.tif --targets tarps.csv",
        "reflect a.tif b.tif --targets tarps.csv --csv reflectance.csv",
    ),
)
def radiometry_(options):
    """Measure a camera in your own images: resolution, sharpness, sensor and reflectance, band by
    band.

    edge, star and bars measure resolution on targets, sharpness does without any; calibrate fits
    gain and offset of the sensor to targets of known radiance, and reflect turns digital numbers
    into reflectance by the empirical line (EuroSDR 2013, image radiometry). Images are JPEG, PNG or
    TIFF with any number of bands. Values of 8 bits are decoded from sRGB unless --linear is given;
    calibrate and reflect refuse them without it. Intervals are 95 %; what cannot be measured is
    empty. With --pixel-um frequencies are also given in lines per mm as the report counts them,
    bright and dark ones: two to a cycle.

    With --over-image edge, star and bars give what the results of all targets depend on: a linear
    regression on the distance from the image's centre, its factor between corner and centre, and
    for edges the blur along and across the radius and along the flight (y). calibrate
    --through-zero fits no offset; calibrate --radiance FILE takes the radiance from an image of the
    same ground by a calibrated sensor in coarser pixels; calibrate --even takes images of even
    ground and gives the loss of light in the corners, unevenness and defects. reflect --dark-pixel
    takes the darkest thousandth of a band for a reference of 1 % (+- 1 %), so that one target is
    enough; reflect --repeatability gives how well reflectances of a target agree over all images,
    and over heights.

    The targets are a CSV file with a row for each target. Columns for all: image (name of the file;
    without the column a target is in every image), name.

      edge       x_px, y_px, width_px, height_px: upper left corner and size of a region with one
                 edge (without targets the whole image is one)
      star       x_px, y_px (centre), radius_px, cycles; or from_deg and to_deg, the part to use
      bars       x_px, y_px (middle of a group), period_px, bars, angle_deg (across them, x to y);
                 place, where there are several ladders of bars
      calibrate  the region as for edge; radiance, or radiance_1, radiance_2, ... for the bands;
                 exposure, or time_s and f_number (without them EXIF is read)
      reflect    the region; reflectance, or reflectance_1, ...: empty where it is to be measured;
                 reflectance_std, anisotropy; height_m, of the flight
    """
    for name in ("gsd_cm", "pixel_um"):
        if getattr(options, name) is not None:
            checks.check_positive(getattr(options, name), name.replace("_", "-"))
    _check_choices(options)
    targets = _targets(options)
    images = {}
    for file in with_progress(options.image, "image"):
        images[file] = image = image_files.read_bands(file)
        _check_bands(f"image {file}", image, options.image[0], images[options.image[0]])
        physical = options.measure in ("calibrate", "reflect")
        if image.values.dtype.itemsize == 1 and physical and not options.linear:
            raise ValueError(
                f"Invalid image {file}: 8 bits, usually not linear in light. Must have 16 bits, or "
                "be said to be --linear."
            )
    if options.measure == "calibrate":
        rows = _calibrations(images, targets, options)
    elif options.measure == "reflect":
        rows = _reflectances(images, targets, options)
    else:
        rows = _resolutions(images, targets, options)
    table = pd.DataFrame(rows)
    if options.measure == "bars":
        table = pd.concat([table, pd.DataFrame(_resolving(table))], ignore_index=True)
    if options.over_image:
        table = pd.DataFrame(_dependences(table, options.measure))
    if options.repeatability:
        table = pd.DataFrame(_repeated(table))
    table = table.drop(columns=list(HIDDEN), errors="ignore")
    print_rows(pd.DataFrame([_in_units(row, options) for row in table.to_dict("records")]), options)


HIDDEN = ("x", "y", "corner", "across_deg", "place", "height_m")
"""Columns of rows that only sums over them need."""


def _check_bands(name, image, file, other):
    """Raise where two images have different numbers of bands."""
    count, wanted = len(image.values), len(other.values)
    if count != wanted:
        raise ValueError(f"Invalid {name}: {count} bands. Must have {wanted} as {file} has.")


def _check_choices(options):
    """Each choice belongs to some measures."""
    belongs = dict.fromkeys(("through_zero", "radiance", "even"), ("calibrate",))
    belongs |= {"over_image": tuple(OVER_IMAGE)}
    belongs |= dict.fromkeys(("dark_pixel", "repeatability"), ("reflect",))
    for name, measures in belongs.items():
        if getattr(options, name) and options.measure not in measures:
            words = name.replace("_", "-")
            raise ValueError(
                f"Invalid --{words} for {options.measure}. Must be with {', '.join(measures)}."
            )


def _targets(options):
    """The table of targets with the columns that the measure needs; None without a file."""
    needed = NEEDED[options.measure]
    if options.targets is None:
        if needed and options.measure != "edge" and not (options.even or options.radiance):
            raise ValueError(f"Invalid {options.measure} without targets. Must have --targets.")
        return None
    table = tables.read_table(options.targets, "targets")
    return tables.with_numbers(table, needed, "targets")


def _of_image(targets, file):
    """The targets that an image shows."""
    if "image" in targets:
        targets = targets[targets["image"].isin([str(file), Path(file).name, Path(file).stem])]
    if targets.empty:
        raise ValueError(f"Invalid targets: none of {Path(file).name}. Must have some.")
    if "name" not in targets:
        targets = targets.assign(name=[f"target {k + 1}" for k in targets.index])
    return targets


def _resolutions(images, targets, options):
    """A row for each target in each band; without targets for each band."""
    measure = {"edge": _edge, "star": _star, "bars": _bars, "sharpness": _sharpness}
    for file, image in images.items():
        shape = image.values.shape[1:]
        whole = pd.DataFrame([("image", 0, 0, *shape[::-1])], columns=["name", *REGION])
        shown = whole if targets is None else _of_image(targets, file)
        if options.measure == "sharpness":
            shown = whole
        for band, values in zip(image.bands, image.values, strict=True):
            if values.dtype == np.uint8:
                values = values / np.float32(255)
                values = values if options.linear else image_files.decode(values, "srgb")
            known = {"image": Path(file).name, "band": band}
            full = radiometry.saturation_level(values)
            for target in shown.to_dict("records"):
                row = known | {"target": target["name"]} | _centred(target, shape)
                row |= measure[options.measure](values, target)
                share = (_around(values, target) >= full).mean()
                if share > SATURATED_SHARE:
                    row["remark"] = "; ".join(filter(None, [row["remark"], "saturated pixels"]))
                yield row


def _centred(target, shape):
    """Where a target lies from the image's centre, px, and how far the corner is."""
    size = target.get("width_px", 1) - 1, target.get("height_px", 1) - 1
    x, y = (
        target[name] + side / 2 - (whole - 1) / 2
        for name, side, whole in zip(("x_px", "y_px"), size, shape[::-1], strict=True)
    )
    return {"x": x, "y": y, "corner": (shape[0] ** 2 + shape[1] ** 2) ** 0.5 / 2}


def _around(values, target):
    """The part of an image that shows a target, as far as the image reaches."""
    if "width_px" in target:
        return _region(values, target)
    reach = target.get("radius_px") or _reach_of_bars(target)
    row, column = round(target["y_px"]), round(target["x_px"])
    reach = int(reach)
    rows = slice(max(row - reach, 0), row + reach + 1)
    return values[rows, max(column - reach, 0) : column + reach + 1]


def _reach_of_bars(target):
    """How far a group of bars and its surroundings reach, px."""
    return int(target["bars"] * target["period_px"] / 2 + target["period_px"])


def _region(values, target):
    """The part of an image in a target's region."""
    column, row, width, height = (round(target[name]) for name in REGION)
    rows, columns = values.shape
    if min(column, row) < 0 or column + width > columns or row + height > rows:
        raise ValueError(
            f"Invalid region of {target['name']!r}. Must lie within {columns} x {rows} pixels."
        )
    return values[row : row + height, column : column + width]


def _edge(values, target):
    """MTF50 and FWHM of one edge."""
    edge = mtf.fit_edge(_region(values, target))
    by_row, by_column = np.gradient(np.asarray(_region(values, target), dtype=np.float64))
    twice = 2 * (by_row * by_column).sum(), (by_column**2 - by_row**2).sum()
    share = 1.96 * edge.mtf50_sigma / edge.mtf50
    figures = _interval("mtf50", "per_px", edge.mtf50, share * edge.mtf50)
    figures |= _interval("fwhm", "px", edge.fwhm_px, share * edge.fwhm_px)
    figures |= {"across_deg": float(np.degrees(np.arctan2(*twice)) / 2)}
    return figures | {"angle_deg": edge.angle_deg, "n": edge.n, "remark": edge.remark}


def _star(values, target):
    """MTF50, MTF10 and FWHM of a star."""
    part = target.get("from_deg", 0.0), target.get("to_deg", 360.0)
    centre, cycles = (target["x_px"], target["y_px"]), int(target["cycles"])
    radius = target["radius_px"]
    star = mtf.measure_star(values, centre, cycles=cycles, radius_px=radius, azimuth_deg=part)
    reach = 1.96 * star.mtf50_sigma
    figures = _interval("mtf50", "per_px", star.mtf50, reach)
    figures |= _interval("fwhm", "px", star.fwhm_px, reach / star.mtf50 * star.fwhm_px)
    remark = "" if star.mtf50 == star.mtf50 else "the star does not show the frequency of MTF50"
    if star.mtf50 == star.mtf50 and reach != reach:
        remark = "the contrast does not fall evenly to a half: are centre and cycles right?"
    return figures | {"mtf10_per_px": star.mtf10, "tilt_deg": star.tilt_deg, "remark": remark}


def _bars(values, target):
    """Whether a group of bars is resolved."""
    reach = _reach_of_bars(target)
    column, row = round(target["x_px"]), round(target["y_px"])
    region = [column - reach, row - reach, 2 * reach + 1, 2 * reach + 1]
    around = _region(values, target | dict(zip(REGION, region, strict=True)))
    low, high = np.percentile(around, [2, 98])
    diagonal = around[1:, 1:] - around[1:, :-1] - around[:-1, 1:] + around[:-1, :-1]
    noise = max(float(np.median(np.abs(diagonal))) * 1.4826 / 2, 1e-6 * (high - low))
    found = mtf.read_bars(values, pd.DataFrame([target]), dark=low, bright=high, noise=noise).iloc[
        0
    ]
    figures = {"period_px": target["period_px"], "contrast": found["contrast"]}
    figures |= {"counted": found["counted"], "resolved": bool(found["resolved"])}
    figures |= {"angle_deg": target["angle_deg"], "place": target.get("place", 1)}
    return figures | {"remark": found["reason"]}


def _resolving(table):
    """A row for each ladder of bars: the narrowest period resolved, up to the next."""
    for key, rows in table.groupby(["image", "band", "place", "angle_deg"], sort=False):
        period, finer = mtf.resolving_power(rows)
        names = ("image", "band", "place", "angle_deg")
        row = dict(zip(names, key, strict=True)) | {"target": f"ladder {key[2]}"}
        row |= rows[["x", "y", "corner"]].mean().to_dict()
        row |= {"resolving_px": period, "resolving_low_px": finer, "resolving_high_px": period}
        row |= {"resolving_per_px": 1 / period, "resolving_low_per_px": 1 / period}
        yield row | {"resolving_high_per_px": 1 / finer, "remark": ""}


def _dependences(table, measure):
    """Rows for each band: what a result depends on over the image."""
    value = OVER_IMAGE[measure]
    for band, rows in table.dropna(subset=[value]).groupby("band", sort=False):
        far = np.hypot(rows["x"], rows["y"]) / rows["corner"]
        if len(rows) < 4 or np.ptp(far) < 0.2:
            raise ValueError(
                f"Invalid targets: {len(rows)} measured in band {band}. Must be four or more, over "
                "a fifth of the way from centre to corner."
            )
        (slope, centre), covariance = np.polyfit(far, rows[value], 1, cov=True)
        by = np.array([1 / centre, -slope / centre**2])
        found = [
            ("centre", centre, covariance[1, 1] ** 0.5),
            ("corner less centre", slope, covariance[0, 0] ** 0.5),
            ("corner over centre", 1 + slope / centre, float(by @ covariance @ by) ** 0.5),
        ]
        reach = stats.t.ppf(0.975, len(rows) - 2)
        for term, estimate, std in found:
            yield _term(band, f"{value}: {term}", estimate, reach * std, len(rows))
        if measure == "edge":
            places = {"x_px": rows["x"], "y_px": rows["y"], "angle_deg": rows["across_deg"]}
            terms = mtf.blur_dependence(pd.DataFrame(places | {"fwhm_px": rows["fwhm_px"]}))
            reach = stats.t.ppf(0.975, len(rows) - 4)
            for one in terms.itertuples():
                term = f"squared fwhm_px: {one.term}"
                yield _term(band, term, one.estimate, reach * one.std, len(rows))


def _term(band, term, estimate, reach, n):
    """One row of a regression."""
    ends = {"low": estimate - reach, "high": estimate + reach}
    return {"band": band, "term": term, "estimate": estimate} | ends | {"n": n}


def _sharpness(values, target):
    """Median of the local sharpness of an image, with the interval of a median."""
    found = mtf.haar_sharpness(values)
    figures = {}
    for name in ("sharpness", "along_x", "along_y"):
        blocks = found[name].values[np.isfinite(found[name].values)]
        if not len(blocks):
            figures |= {name: np.nan, f"{name}_low": np.nan, f"{name}_high": np.nan}
            continue
        quartiles = np.quantile(blocks, [0.25, 0.5, 0.75])
        reach = 1.57 * (quartiles[2] - quartiles[0]) / len(blocks) ** 0.5
        middle = float(quartiles[1])
        figures |= {name: middle, f"{name}_low": middle - reach, f"{name}_high": middle + reach}
    missing = found.attrs["not_measurable"]
    remark = f"{missing} blocks without detail" if missing else ""
    return figures | {"blocks": found["sharpness"].size, "remark": remark}


def _interval(name, unit, value, reach):
    """A figure with the ends of its interval."""
    unit = unit and f"_{unit}"
    ends = {f"{name}_low{unit}": value - reach, f"{name}_high{unit}": value + reach}
    return {f"{name}{unit}": value} | ends


def _in_units(row, options):
    """A row with lengths on the ground and frequencies on the detector, where sizes are known."""
    found = dict(row)
    for name, value in row.items():
        if name.endswith("_per_px") and options.pixel_um:
            found[name.replace("_per_px", "_lines_per_mm")] = 2 * value * 1000 / options.pixel_um
        elif name.endswith("_px") and options.gsd_cm:
            found[name.removesuffix("_px") + "_cm"] = value * options.gsd_cm
    return found


def _patches(image, targets, name, number):
    """Statistics of all targets in one band, and what is known of them in this band."""
    column = f"{name}_{number}" if f"{name}_{number}" in targets else name
    checks.check_columns(targets, [column], "targets")
    first, size = targets[["y_px", "x_px"]], targets[["height_px", "width_px"]]
    places = np.round(np.stack([first.to_numpy(), first.to_numpy() + size.to_numpy()], axis=-1))
    found = radiometry.patch_statistics(image.values[number - 1], places.reshape(-1, 4).astype(int))
    found["std_dn"] = np.hypot(found["std_dn"], ROUNDING_DN)
    found["std_error_dn"] = found["std_dn"] / np.sqrt(found["n"])
    return found.assign(known=targets[column].to_numpy(), name=targets["name"].to_numpy())


def _exposure(file, image, targets):
    """Exposure time and f-number, or a relative exposure and 1; None where nothing says it."""
    if "exposure" in targets:
        return float(targets["exposure"].iloc[0]), 1.0
    if {"time_s", "f_number"} <= set(targets):
        return tuple(float(targets[name].iloc[0]) for name in ("time_s", "f_number"))
    return image.exposure


def _calibrations(images, targets, options):
    """Rows of the calibration that was asked for."""
    if options.even:
        return _relative(images)
    if options.radiance:
        return _against_image(images, options)
    return _calibrated(images, targets, options)


def _relative(images):
    """A row for each band: how even the sensor is."""
    sizes = {image.values.shape for image in images.values()}
    if len(sizes) > 1:
        raise ValueError(f"Invalid images of {len(sizes)} sizes. Must be of one.")
    for number, band in enumerate(next(iter(images.values())).bands):
        values = np.stack([image.values[number] for image in images.values()])
        _check_unsaturated(values, band)
        found = radiometry.relative_response(values)
        radial, reach = found["radial"], 1.96 * found.pop("radial_std")
        ends = {"radial_low": radial - reach, "radial_high": radial + reach}
        yield {"band": band, "images": len(images)} | found | ends


def _check_unsaturated(values, band):
    """Whole images must not be cut off at full scale."""
    share = (values >= radiometry.saturation_level(values)).mean()
    if share > SATURATED_SHARE:
        raise ValueError(
            f"Invalid band {band}: {share:.0%} saturated. Must be below {SATURATED_SHARE:.0%}."
        )


def _against_image(images, options):
    """A row for each band of each image: DN against the radiance of another sensor's image."""
    known = image_files.read_bands(options.radiance)
    for file, image in images.items():
        _check_bands(f"radiance {options.radiance}", known, file, image)
        for band, dn, radiance in zip(image.bands, image.values, known.values, strict=True):
            _check_unsaturated(dn, band)
            pairs = radiometry.coarse_pairs(dn, radiance)
            fit = radiometry.fit_sensor(pairs[1], pairs[0], through_zero=options.through_zero)
            yield {"image": Path(file).name, "band": band} | _sensor(fit)


def _calibrated(images, targets, options):
    """A row for each band and setting, and one for all settings of the band."""
    shown = {file: _of_image(targets, file) for file in images}
    settings = {file: _exposure(file, image, shown[file]) for file, image in images.items()}
    unknown = [file for file, setting in settings.items() if setting is None]
    if unknown and len(images) > 1:
        raise ValueError(
            f"Invalid image {unknown[0]}: no exposure time and f-number in its EXIF. Must have "
            "them, or the targets must have columns time_s and f_number."
        )
    reference = next(iter(settings.values()))
    for number, band in enumerate(next(iter(images.values())).bands, start=1):
        parts = []
        for file, image in images.items():
            part = _patches(image, shown[file], "radiance", number)
            setting = settings[file]
            label = "unknown" if setting is None else f"{setting[0]:g} s, f/{setting[1]:g}"
            exposure = (
                radiometry.relative_exposure(*setting, reference=reference) if setting else 1.0
            )
            parts.append(part.assign(setting=label, exposure=exposure))
        table = pd.concat(parts)
        unsaturated = table[(table["saturated_share"] == 0) & table["known"].notna()]
        groups = [*unsaturated.groupby("setting", sort=False), ("all", unsaturated)]
        fits = {name: _fitted(rows, options) for name, rows in groups}
        own = {name: fit for name, fit in fits.items() if name != "all"}
        moved = {}
        if len(own) > 1:
            known = unsaturated["known"][unsaturated["known"] > 0]
            moved = radiometry.stability(own, known).groupby("setting")["difference_percent"].mean()
        saturated = int((table["saturated_share"] > 0).sum())
        for name, fit in fits.items():
            more = {"saturated": saturated, "stability_percent": moved.get(name, np.nan)}
            yield {"band": band, "setting": name} | _sensor(fit) | more


def _fitted(rows, options):
    """The sensor that targets of known radiance show."""
    choices = {"exposure": rows["exposure"], "std_dn": rows["std_dn"]}
    choices |= {"through_zero": options.through_zero}
    return radiometry.fit_sensor(rows["known"], rows["mean_dn"], **choices)


def _sensor(fit):
    """Gain and offset with their intervals."""
    reach = stats.t.ppf(0.975, fit.freedom) * fit.std
    figures = _interval("gain", "", fit.gain, reach[0])
    figures |= _interval("offset", "dn", fit.offset, reach[1])
    return figures | {"r_squared": fit.r_squared, "n": fit.n}


def _dark_reference(values):
    """The darkest pixels of a band as a reference target."""
    dark = np.sort(values, axis=None)[: max(int(DARK_SHARE * values.size), 2)].astype(float)
    row = {"mean_dn": dark.mean(), "std_error_dn": max(dark.std(), ROUNDING_DN)}
    row |= {"known": DARK_REFLECTANCE, "reflectance_std": DARK_REFLECTANCE}
    return pd.DataFrame([row | {"anisotropy": 1.0, "saturated_share": 0.0, "name": "dark"}])


def _repeated(table):
    """A row for each target in each band: agreement over images, and over heights."""
    from mmqa_lab.repeatability import repeatability

    known = table.dropna(subset=["reflectance"])
    for (band, target), rows in known.groupby(["band", "target"], sort=False):
        if len(rows) < 2:
            raise ValueError(f"Invalid images: one shows {target!r}. Must be two or more.")
        heights = rows["height_m"] if rows["height_m"].notna().all() else 0.0
        if np.ndim(heights) and heights.value_counts().min() < 2:
            heights = 0.0  # one image a height: their differences are part of one spread
        found = repeatability(rows.assign(height=heights), "reflectance", group="height")
        spreads = {"within": found.s_r, "within_low": found.s_r_low, "within_high": found.s_r_high}
        spreads |= {"between_heights": found.s_l}
        row = {"band": band, "target": target, "reflectance": found.mean}
        row |= {f"{name}_percent": 100 / found.mean * one for name, one in spreads.items()}
        yield row | {"images": found.n, "heights": found.groups}


def _reflectances(images, targets, options):
    """A row for each target without a known reflectance, in each band of each image."""
    usual = {"anisotropy": 1.0, "reflectance_std": 0.0, "height_m": np.nan}
    for file, image in images.items():
        shown = _of_image(targets, file)
        for number, band in enumerate(image.bands, start=1):
            table = _patches(image, shown, "reflectance", number)
            for name, other in usual.items():
                table[name] = shown[name].fillna(other).to_numpy() if name in shown else other
            references = table[table["known"].notna() & (table["saturated_share"] == 0)]
            if options.dark_pixel:
                dark = _dark_reference(image.values[number - 1])
                references = pd.concat([references, dark], ignore_index=True)
            if len(references) < 2:
                raise ValueError(
                    f"Invalid targets of {file}: {len(references)} unsaturated with a known "
                    "reflectance. Must be two or more."
                )
            known = {"image": Path(file).name, "band": band}
            yield from (known | row for row in _sought(table, references))


def _sought(table, references):
    """A row for each target whose reflectance follows from those of the references."""
    stated = {"std_dn": references["std_error_dn"], "std": references["reflectance_std"]}
    if not (references["reflectance_std"] > 0).all() and len(references) > 2:
        stated = {}  # the residuals tell more than the noise of the pixels alone
    dn, known = references["mean_dn"], references["known"]
    line = radiometry.empirical_line(dn, known, anisotropy=references["anisotropy"], **stated)
    factor = 1.96 if stated else stats.t.ppf(0.975, line.n - 2)
    for row in table[table["known"].isna()].itertuples():
        saturated, inside = row.saturated_share > 0, dn.min() <= row.mean_dn <= dn.max()
        value = float(line.reflectance(row.mean_dn, anisotropy=row.anisotropy))
        value = np.nan if saturated else value
        reach = factor * float(line.std(row.mean_dn, std_dn=row.std_error_dn))
        said = ["saturated"] * saturated + ["beyond the reference targets"] * (not inside)
        more = {"references": line.n, "height_m": row.height_m, "remark": "; ".join(said)}
        yield {"target": row.name} | _interval("reflectance", "", value, reach) | more
