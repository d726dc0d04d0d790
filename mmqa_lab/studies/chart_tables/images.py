"""The imaging chart: Table 1 from the systems' specifications and from rendered photographs."""

from dataclasses import replace

import numpy as np
import pandas as pd

from mmqa_lab import chart_image, charts
from mmqa_lab.chart_image.light import decode
from mmqa_lab.chart_image.line_pairs import SMALLEST_GAP, SMALLEST_PAIR_PX
from mmqa_lab.figures import COLOURS, KIND_COLOURS
from mmqa_lab.published import pfeifer2021_images as published
from mmqa_lab.results import Claim
from mmqa_lab.simulate import cameras

QUICK = {"image_seeds": 1, "image_systems": ["C"]}

SIGMAS_PX = np.round(np.arange(0.4, 1.11, 0.05), 2)
"""Point spreads tried, pixels."""

TYPICAL_SIGMA_PX = 0.6
"""Point spread that the prediction takes for every camera, set beforehand."""

BLURS_MM = np.arange(0.0, 8.1, 0.5)
"""Motion blurs tried, millimetres at the chart."""

FINER_MM = (50.0, 42.0, 35.0, 30.0, 25.0, 21.0, 17.5, 15.0, 12.5, 10.5, 9.0, 7.5, 6.2)
"""A ladder with steps of a sixth to a fifth, from coarser on: where it fits on the chart."""


def geometry(systems):
    """Return how each row of Table 1 was seen, as far as the published pixel sizes tell.

    A camera at the required distance sees the pixel size of its panorama in vertical direction; in
    horizontal direction the oblique view makes pixels longer by 1/cos of the view's angle. That
    angle follows from the published horizontal pixel size.

    Parameters
    ----------
    systems : sequence of str

    Returns
    -------
    DataFrame
        Table 1 with ``specified_mm`` (pixel size from megapixels and distance), ``seen_h_mm``,
        ``seen_v_mm`` (pixel sizes to render: published where at hand) and ``view_deg``. Rows
        without a published pixel size or width are left out.
    """
    table = published.table_1()
    table = table[table["system"].isin(systems)].dropna(subset=["pixel_h_mm", "w_h_mm"])
    megapixels = published.systems().set_index("system")["megapixels"]
    rows = []
    for row in table.to_dict("records"):
        camera = chart_image.PanoramaCamera.of_megapixels(megapixels[row["system"]])
        row["specified_mm"] = camera.pixel_size_mm(row["distance_m"])
        oblique = row["view"] != "orthogonal"
        upright = row["pixel_v_mm"]
        if not np.isfinite(upright):
            upright = row["specified_mm"] if oblique else row["pixel_h_mm"]
        row["seen_h_mm"], row["seen_v_mm"] = row["pixel_h_mm"], upright
        row["view_deg"] = float(np.degrees(np.arccos(min(upright / row["pixel_h_mm"], 1.0))))
        rows.append(row)
    return pd.DataFrame(rows)


def photographs(rows, *, sigma_px, blur_mm, seeds, layout=None):
    """Photograph the chart as each row saw it, and evaluate the photographs.

    Noise of 1 %, sRGB, 8 bits and JPEG are in the chain; the point spread is that of the whole
    camera, interpolation of colours included.

    Parameters
    ----------
    rows : DataFrame
        Of :func:`geometry`.
    sigma_px, blur_mm : dict of str to float
        Point spread and horizontal motion blur at the chart by system.
    seeds : int
        Photographs per row, with other noise and other places of the pixels.
    layout : Layout, optional
        The chart as built when not given.

    Returns
    -------
    DataFrame
        A row per photograph: system, distance, view, seed and the columns of
        :meth:`mmqa_lab.chart_image.ImageQuality.to_frame`.
    """
    layout = charts.imaging_chart() if layout is None else layout
    found = []
    for row in rows.itertuples():
        for seed in range(seeds):
            optics = cameras.Optics(sigma_px[row.system])
            photo = photograph(row, layout, optics, blur_mm[row.system], seed)
            there = chart_image.locate_corners(
                photo.chart_map.pixels(layout.corners()),
                layout,
                camera=photo.chart_map.camera,
                offset=photo.origin,
            )
            quality = chart_image.evaluate_image(photo.image, layout, there)
            known = {"system": row.system, "distance_m": row.distance_m, "view": row.view}
            found.append(quality.to_frame().assign(**known, seed=seed))
    return pd.concat(found, ignore_index=True)


def photograph(row, layout, optics, blur_mm, seed):
    """Return one photograph of a row of :func:`geometry`, linear light in grey."""
    rng = np.random.default_rng(seed)
    width = 2 * round(1000 * np.pi * row.distance_m / row.seen_v_mm)
    angle = row.view_deg if row.view == "forward" else -row.view_deg
    # the slant distance is the required one
    view = cameras.chart_view(
        cameras.PanoramaCamera(width),
        distance=row.distance_m * np.cos(np.radians(angle)),
        heading_deg=angle,
        roll_deg=rng.uniform(-1, 1),
        aim_deg=rng.uniform(0, 2),
        layout=layout,
    )
    # along the chart, as the vehicle drives
    optics = replace(optics, travel=tuple(view.matrix[:, 0] * blur_mm))
    sensor = cameras.Sensor(noise=0.01, gamma="srgb", bits=8, jpeg_quality=90)
    photo = cameras.photograph(layout, view, optics=optics, sensor=sensor, seed=seed)
    return replace(photo, image=decode(photo.image.astype(np.float32) / 255, "srgb"))


def expected_width(pixel_mm, sigma_px, blur_mm=0.0, ladder=published.LADDER_MM):
    """Return the finest resolved width of a ladder by the closed form, NaN for none.

    Examples
    --------
    >>> expected_width(8.0, 0.6)
    20.0
    """
    ladder = np.asarray(ladder)
    contrast = chart_image.expected_contrast(ladder / pixel_mm, sigma_px, blur_mm / pixel_mm)
    good = (contrast >= SMALLEST_GAP) & (ladder / pixel_mm >= SMALLEST_PAIR_PX)
    count = len(ladder) if good.all() else int(np.argmin(good))
    return float(ladder[count - 1]) if count else np.nan


def steps_between(one, two, directions):
    """Return how many steps of the chart's ladder the first widths are finer than the second.

    The ladder for lying bars begins one step later; no width at all is one step before the ladder.

    Examples
    --------
    >>> steps_between([8.0, np.nan], [10.0, 30.0], ["h", "v"]).tolist()
    [1, -1]
    """
    ladders = {"h": published.LADDER_MM, "v": published.LADDER_MM[1:]}
    return np.array(
        [
            _rung(first, ladders[direction]) - _rung(second, ladders[direction])
            for first, second, direction in zip(one, two, directions, strict=True)
        ]
    )


def _rung(width, ladder):
    """Place of a width on a ladder, -1 for none."""
    return ladder.index(width) if width in ladder else -1


def one_spread(cells):
    """Return how well one point spread for all systems explains the published widths.

    Parameters
    ----------
    cells : DataFrame
        Of :func:`mmqa_lab.published.pfeifer2021_images.widths`.

    Returns
    -------
    DataFrame
        Per ``sigma_px``: ``exact`` and ``within_one_step``, of ``cells``.
    """
    rows = []
    for sigma in SIGMAS_PX:
        widths = [expected_width(pixel, sigma) for pixel in cells["pixel_mm"]]
        steps = np.abs(steps_between(widths, cells["w_mm"], cells["direction"]))
        rows.append((sigma, int((steps == 0).sum()), int((steps <= 1).sum()), len(cells)))
    return pd.DataFrame(rows, columns=["sigma_px", "exact", "within_one_step", "cells"])


def best_spread(trials):
    """Return the point spread with most cells within one step, of these with most exact ones."""
    order = trials.sort_values(["within_one_step", "exact"], ascending=False, kind="stable")
    return float(order["sigma_px"].iloc[0])


def fit_systems(cells):
    """Fit a point spread and a horizontal motion blur to each system's published widths.

    Two parameters per system, in-sample: it describes Table 1, it does not reproduce it.

    Returns
    -------
    DataFrame
        ``system``, ``kind`` = fitted, ``sigma_px``, ``blur_mm``, ``exact``, ``within_one_step``,
        ``cells``. Of equally good pairs the one with least blur, then least spread.
    """
    rows = []
    for system, part in cells.groupby("system"):
        standing = (part["direction"] == "h").to_numpy()
        best = None
        for blur in BLURS_MM:
            for sigma in SIGMAS_PX:
                widths = [
                    expected_width(pixel, sigma, blur * across)
                    for pixel, across in zip(part["pixel_mm"], standing, strict=True)
                ]
                steps = np.abs(steps_between(widths, part["w_mm"], part["direction"]))
                cost = (int(steps.sum()), blur, sigma)
                if best is None or cost < best[0]:
                    best = (cost, int((steps == 0).sum()), int((steps <= 1).sum()))
        rows.append((system, "fitted", best[0][2], best[0][1], *best[1:], len(part)))
    names = ["system", "kind", "sigma_px", "blur_mm", "exact", "within_one_step", "cells"]
    return pd.DataFrame(rows, columns=names)


def compare_widths(rows, photos):
    """Put published, predicted and fitted widths side by side, a row per published cell.

    The prediction knows the specification only: pixel size from megapixels and distance, oblique
    views longer as published, a point spread of 0.6 pixels, no motion; closed form.

    Parameters
    ----------
    rows : DataFrame
        Of :func:`geometry`.
    photos : dict of str to DataFrame
        Of :func:`photographs`, by the name of the model they were taken with.

    Returns
    -------
    DataFrame
        ``system``, ``distance_m``, ``view``, ``direction``, ``published_mm``, ``predicted_mm``, and
        for each model ``<model>_mm`` (lower median over the photographs) and ``<model>_limit_mm``
        (interpolated); for each of them ``<name>_steps``, positive where finer than published.
    """
    keys = ["system", "distance_m", "view", "direction"]
    table = published.widths()[[*keys, "w_mm"]].rename(columns={"w_mm": "published_mm"})
    table = table.merge(rows[[*keys[:3], "specified_mm", "seen_h_mm", "seen_v_mm"]], on=keys[:3])
    longer = np.where(table["direction"] == "h", table["seen_h_mm"] / table["seen_v_mm"], 1.0)
    pixels = table["specified_mm"] * np.where(table["view"] == "orthogonal", 1.0, longer)
    table["predicted_mm"] = [expected_width(pixel, TYPICAL_SIGMA_PX) for pixel in pixels]
    table = table[[*keys, "published_mm", "predicted_mm"]]
    for model, found in photos.items():
        parts = []
        for direction in "hv":
            names = {
                f"w_{direction}_mm": f"{model}_mm",
                f"limit_{direction}_mm": f"{model}_limit_mm",
            }
            part = found[[*keys[:3], *names]].rename(columns=names)
            parts.append(part.assign(direction=direction))
        middle = pd.concat(parts).groupby(keys).quantile(0.5, interpolation="lower")
        table = table.merge(middle.reset_index(), on=keys)
    for name in ("predicted", *photos):
        steps = steps_between(table[f"{name}_mm"], table["published_mm"], table["direction"])
        table[f"{name}_steps"] = steps
    return table


def compare_pixels(rows, found):
    """Put published, specified and measured pixel sizes of the orthogonal views side by side.

    Parameters
    ----------
    rows : DataFrame
        Of :func:`specified`.
    found : DataFrame
        Photographs of those.

    Returns
    -------
    DataFrame
        ``system``, ``distance_m``, ``published_mm`` (horizontal), ``predicted_mm`` (from
        megapixels), ``measured_mm`` and ``measured_sigma_mm`` (in rendered photographs),
        ``predicted_minus_published_percent``.
    """
    keys = ["system", "distance_m"]
    measured = found.groupby(keys)[["pixel_h_mm", "pixel_h_sigma_mm"]].mean().reset_index()
    table = rows[[*keys, "pixel_h_mm", "specified_mm"]].merge(
        measured, on=keys, suffixes=("", "_measured")
    )
    table.columns = [*keys, "published_mm", "predicted_mm", "measured_mm", "measured_sigma_mm"]
    change = table["predicted_mm"] / table["published_mm"] - 1
    return table.assign(predicted_minus_published_percent=100 * change)


def specified(rows):
    """Return the orthogonal rows as the specification has them: square pixels from megapixels."""
    rows = rows[rows["view"] == "orthogonal"]
    return rows.assign(seen_h_mm=rows["specified_mm"], seen_v_mm=rows["specified_mm"], view_deg=0.0)


def legibility(rows, *, sigma_px, blur_mm, engine="auto"):
    """Put the jury's marks, the quality index and an automatic reader side by side.

    Parameters
    ----------
    rows : DataFrame
        Of :func:`geometry`.
    sigma_px, blur_mm : dict of str to float
        As for :func:`photographs`.
    engine : str
        Of :func:`mmqa_lab.chart_image.reader`.

    Returns
    -------
    DataFrame
        ``system``, ``distance_m``, ``view``, ``jury`` (published), ``quality_index`` (of 40 mm
        capitals, by the published widths), ``cap_px``, ``ocr_mark`` (a: every line without error;
        b: three quarters of the lines with a fifth of errors at most; else c) and ``ocr_error``
        (median per letter); None and NaN without an engine, ``attrs["reader"]`` says so.
    """
    try:
        read, remark = chart_image.reader(engine), ""
    except ImportError as error:
        read, remark = None, str(error)
    layout = charts.imaging_chart()
    found = []
    for row in rows.itertuples():
        width = np.sqrt(row.w_h_mm * row.w_v_mm)
        known = {
            "system": row.system,
            "distance_m": row.distance_m,
            "view": row.view,
            "jury": row.legibility,
            "quality_index": chart_image.quality_index(40.0, width),
            "cap_px": 40.0 / row.seen_v_mm,
            "ocr_mark": None,
            "ocr_error": np.nan,
        }
        if read is not None:
            optics = cameras.Optics(sigma_px[row.system])
            photo = photograph(row, layout, optics, blur_mm[row.system], 0)
            crops = chart_image.text_crops(photo.image, layout, photo.chart_map)
            lines = chart_image.read_crops(crops, read)
            good = (lines["ocr_mark"] != "c").mean()
            whole = (lines["ocr_mark"] == "a").all()
            known["ocr_mark"] = "a" if whole else "b" if good >= 0.75 else "c"
            known["ocr_error"] = lines["error"].median()
        found.append(known)
    table = pd.DataFrame(found)
    table.attrs["reader"] = remark
    return table


def finer_chart(rows, *, sigma_px, blur_mm, seeds):
    """Return what a chart with finer steps would have shown at 10 m, orthogonal.

    Returns
    -------
    DataFrame
        As :func:`photographs`, for the ladder :data:`FINER_MM`.
    """
    layout = charts.imaging_chart(widths_h=FINER_MM, widths_v=FINER_MM, texts=())
    chosen = rows[(rows["distance_m"] == 10) & (rows["view"] == "orthogonal")]
    return photographs(chosen, sigma_px=sigma_px, blur_mm=blur_mm, seeds=seeds, layout=layout)


def draw_photo(image, chart_map, layout, readings, *, ax):
    """Draw a photograph of the chart with its line pairs outlined: resolved or refused."""
    ax.imshow(image, cmap="gray", interpolation="nearest")
    resolved = readings.set_index("name")["resolved"]
    for pairs in layout.of_kind(charts.LinePairs):
        low, size = np.array([pairs.x, pairs.y]), np.array([pairs.width, pairs.height])
        outline = low + size * np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]])
        colour = "sky" if resolved[pairs.name] else "vermilion"
        ax.plot(*chart_map.pixels(outline).T, color=COLOURS[colour], lw=1)
    ax.set(xticks=[], yticks=[])
    for colour, label in (("sky", "resolved"), ("vermilion", "refused")):
        ax.plot([], [], color=COLOURS[colour], label=label)
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, 0), ncols=2)
    return ax


def draw_contrast(readings, *, ax, sigma_px=None):
    """Draw the contrast of line pairs over their width in pixels, and what counts as resolved."""
    for direction, marker, label in (("h", "o", "standing bars"), ("v", "s", "lying bars")):
        part = readings[readings["direction"] == direction].dropna(subset=["contrast"])
        for resolved, face in ((True, COLOURS["blue"]), (False, "none")):
            shown = part[part["resolved"] == resolved]
            name = label if resolved else None
            style = {"marker": marker, "ls": "", "mfc": face, "mec": COLOURS["blue"], "ms": 4}
            ax.plot(shown["width_px"], shown["contrast"], label=name, **style)
    if sigma_px is not None:
        widths = np.geomspace(1.2, 25, 200)
        curve = chart_image.expected_contrast(widths, sigma_px)
        label = f"closed form, sigma {sigma_px:g} px"
        ax.plot(widths, curve, color=COLOURS["grey"], label=label)
    ax.axhline(SMALLEST_GAP, color=COLOURS["vermilion"], ls="--", lw=0.8)
    ax.axvspan(0.5, SMALLEST_PAIR_PX, color=COLOURS["vermilion"], alpha=0.12, lw=0)
    ax.annotate("aliases\nand beats", (0.62, 0.75), color=COLOURS["vermilion"], fontsize=7)
    ax.set(xscale="log", xlim=(0.5, 40), ylim=(-0.25, 1.1))
    ax.set_xticks([0.5, 1, 2, 5, 10, 20], ["0.5", "1", "2", "5", "10", "20"])
    ax.set(xlabel="width of a line pair (pixels)", ylabel="contrast")
    ax.legend(loc="lower right")
    return ax


def draw_pixel_sizes(table, *, ax):
    """Draw published, predicted and measured pixel sizes."""
    places = np.arange(len(table))
    for kind, shift, marker in (
        ("published", -0.15, "D"),
        ("predicted", 0.0, "o"),
        ("measured", 0.15, "s"),
    ):
        style = {"marker": marker, "ls": "", "color": KIND_COLOURS[kind], "ms": 4}
        ax.plot(table[f"{kind}_mm"], places + shift, label=kind, **style)
    names = [f"{row.system} at {row.distance_m:.0f} m" for row in table.itertuples()]
    ax.set(yticks=places, yticklabels=names, ylim=(len(table) - 0.5, -0.5))
    ax.set(xlabel="pixel size, horizontal (mm)", xlim=(0, None))
    ax.legend(ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return ax


def draw_spread_trials(trials, *, ax):
    """Draw how many published widths one point spread explains."""
    ax.plot(trials["sigma_px"], trials["within_one_step"], "o-", label="within one step", ms=3)
    ax.plot(trials["sigma_px"], trials["exact"], "s-", label="exactly", ms=3)
    ax.axhline(trials["cells"].iloc[0], color=COLOURS["grey"], lw=0.6)
    ax.set(xlabel="point spread, sigma (pixels)", ylabel="cells of Table 1", ylim=(0, None))
    ax.legend(loc="lower left")
    return ax


MODELS = {
    "predicted": ("predicted: specification", "predicted", "^"),
    "one_spread": ("fitted: one point spread", "fitted", "o"),
    "per_system": ("fitted: spread and blur per system", "fitted", "s"),
}
"""Name, kind and marker of each model of the widths."""


def draw_widths(table, *, ax):
    """Draw the published widths and those predicted and read in photographs, cell by cell."""
    places = np.arange(len(table))
    style = {"marker": "_", "ls": "", "ms": 13, "mew": 2, "color": KIND_COLOURS["published"]}
    ax.plot(places, table["published_mm"], label="published", **style)
    for k, (model, (label, kind, marker)) in enumerate(MODELS.items()):
        face = "none" if model == "one_spread" else KIND_COLOURS[kind]
        style = {"marker": marker, "ls": "", "mec": KIND_COLOURS[kind], "mfc": face, "ms": 4}
        ax.plot(places + 0.22 * (k - 1), table[f"{model}_mm"], label=label, **style)
    names = [
        f"{row.system} {row.distance_m:.0f} m {row.view[:4]}. {row.direction}"
        for row in table.itertuples()
    ]
    ax.set_xticks(places, names, rotation=90)
    ax.set(yscale="log", ylabel="resolved width w (mm)")
    ax.minorticks_off()
    ax.set_yticks(published.LADDER_MM[:-1], [f"{width:g}" for width in published.LADDER_MM[:-1]])
    ax.grid(axis="y", lw=0.3)
    ax.legend(ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return ax


def claims(pixels, widths, trials, fits):
    """Test what the notebook says of Table 1.

    Parameters
    ----------
    pixels, widths : DataFrame
        Of :func:`compare_pixels` and :func:`compare_widths`.
    trials, fits : DataFrame
        Of :func:`one_spread` and :func:`fit_systems`.
    """
    error = (pixels["measured_mm"] / pixels["predicted_mm"] - 1).abs().max()
    largest = widths[["one_spread_steps", "per_system_steps"]].abs().max().max()
    ratio = published.ratio_check().iloc[-1]
    near = pixels[pixels["system"].isin(["B", "C"])]["predicted_minus_published_percent"].abs()
    made = [
        Claim(
            "The pixel size measured in a photograph is that of the panorama, for every system.",
            bool(error < 0.01),
            f"largest difference {100 * error:.2f} %",
            "the lying bar is half a metre below the camera: 0.4 % farther away at 5 m",
        ),
        Claim(
            "For B and C, megapixels predict the published pixel size at both distances.",
            bool(near.max() < 10),
            f"largest difference {near.max():.1f} %",
            "1.3 mm is printed to 4 %; distances are known to some per cent",
        ),
        Claim(
            "No single number of pixels per line pair satisfies all published widths.",
            bool(ratio["satisfies"] < ratio["cells"]),
            f"the best, {ratio['ratio']:.2f}: {ratio['satisfies']} of {ratio['cells']}",
            "counted on the cells at hand",
        ),
        Claim(
            "One point spread for all systems explains every published width within one step.",
            bool(trials["within_one_step"].max() == trials["cells"].iloc[0]),
            f"{trials['within_one_step'].max()} of {trials['cells'].iloc[0]}",
            "one step is what readers differed by (section 4.2); one parameter is fitted",
        ),
        Claim(
            "A point spread and a motion blur for each system explain more widths exactly.",
            bool(fits["exact"].sum() > trials["exact"].max()),
            f"{fits['exact'].sum()} against {trials['exact'].max()} of {fits['cells'].sum()}",
            "six parameters on these cells: a description, no reproduction",
        ),
        Claim(
            "Read in photographs, both fitted models stay within one step of the published widths.",
            bool(largest <= 1),
            f"largest difference {largest} steps",
            "one step is what readers differed by (section 4.2)",
        ),
    ]
    a = pixels[(pixels["system"] == "A") & (pixels["distance_m"] == 10)]
    if len(a):
        made.append(
            Claim(
                "For A, the specification promises finer pixels at 10 m than were published.",
                bool(a["predicted_minus_published_percent"].iloc[0] < -10),
                f"{a['predicted_minus_published_percent'].iloc[0]:.0f} %",
                "more than the rounding of two digits",
            )
        )
    return made
