"""Table 1 from images: predicted from specifications, fitted, and read in simulated photographs.

The methods stand in the notebook. Here is what is too long to read there: the limit of line pairs
by rendering, the search for point spreads, the photographs of the bench and the ledger.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pandas as pd
import xarray as xr

from mmqa_lab import bench, chart_image, charts, plots, published
from mmqa_lab.chart_image import legibility
from mmqa_lab.chart_image.reading import (
    SMALLEST_GAP,
    SMALLEST_PAIR_PX,
    expected_contrast,
    find_tones,
)
from mmqa_lab.charts import Bar, Layout, LinePairs
from mmqa_lab.published import ledger
from mmqa_lab.simulate import cameras
from mmqa_lab.srgb import decode
from mmqa_lab.studies import NOTES, SMALL, stated

QUICK, TOLD = SMALL["chart_images"], NOTES["chart_images"]

ROW = ["system", "distance_m", "view"]
"""What names a row of Table 1."""

PAIRS = charts.imaging_chart().of_kind(charts.LinePairs)

LADDERS_MM = {d: sorted((p.pair for p in PAIRS if p.direction == d), reverse=True) for d in "hv"}
"""Widths on the chart, of the standing and of the lying bars."""

FITTED_PX = 0.8
"""Point spread of the photographs: the one that explains most widths of Table 1."""

SENSOR = cameras.Sensor(noise=0.01, gamma="srgb", bits=8, jpeg_quality=90)

SPEED_KMH = 40.0

LIMIT_STEP, LIMIT_STEPS = 1.04, 9
"""Between the line pairs that find the limit of a point spread, and how many there are."""

LIMIT_LENGTH_PX = 24.0
"""Length of their bars: 80 mm at pixels of 3.3 mm."""

MAP_ERROR_PX = 0.1
"""By which the place of their chart is wrong."""


def table_1():
    """Return Table 1 with a row for each photograph that was evaluated.

    Returns
    -------
    DataFrame
        ``system``, ``distance_m``, ``view``, ``pixel_h_mm`` (lying bar), ``pixel_v_mm`` (standing
        bars), ``w_h_mm`` (standing bars), ``w_v_mm``, ``legibility`` (a, b, c), all published.
        NaN is a printed dash, which the paper does not explain; of a width it is read as coarser
        than the chart's widest pairs, which some systems did not resolve (section 4.4).

    Examples
    --------
    >>> table = table_1()
    >>> len(table), table["w_h_mm"].count() + table["w_v_mm"].count()
    (12, np.int64(22))
    """
    table = published.table("pfeifer2021", "table_1").query("status != 'not_evaluated'")
    numbers = table[table["unit"] == "mm"]
    names = numbers["quantity"].map({"pixel size": "pixel", "line-pair width": "w"})
    numbers = numbers.assign(figure=names + "_" + numbers["direction"] + "_mm")
    wide = numbers.pivot(index=ROW, columns="figure", values="value").rename_axis(columns=None)
    wide["legibility"] = table[table["unit"] == "mark"].set_index(ROW)["printed"]
    order = {"orthogonal": 0, "forward": 1, "backward": 2}
    return wide.reset_index().sort_values(
        ROW, key=lambda column: column.replace(order), ignore_index=True
    )


def width_cells(table):
    """Return the 24 widths of Table 1, a row for each, with the pixels that saw them.

    Parameters
    ----------
    table : DataFrame
        Of :func:`table_1`.

    Returns
    -------
    DataFrame
        ``system``, ``distance_m``, ``view``, ``direction``, ``published_mm`` (NaN for a dash),
        ``pixel_mm`` (published, of the same direction where it is printed, else of the other) and
        ``blur_share``: what part of the vehicle's motion blurs the bars. Along the chart it is all
        for standing bars and none for lying ones; a board across the path moves by the tangent of
        the angle under which it is seen.

    Examples
    --------
    >>> cells = width_cells(table_1())
    >>> len(cells), int(cells["published_mm"].isna().sum())
    (24, 2)
    """
    share = np.where(table["view"] == "orthogonal", 1.0, np.tan(view_angle(table)))
    parts = []
    for direction, other, blur_share in (("h", "v", share), ("v", "h", 0.0)):
        pixel = table[f"pixel_{direction}_mm"].fillna(table[f"pixel_{other}_mm"])
        part = table[ROW].assign(direction=direction, published_mm=table[f"w_{direction}_mm"])
        parts.append(part.assign(pixel_mm=pixel, blur_share=blur_share))
    return pd.concat(parts).sort_index(kind="stable").reset_index(drop=True)


def view_angle(table):
    """Return the angle off the chart's normal that the published pixel sizes give, radians.

    An oblique view makes pixels longer along x by 1/cos of the angle. Orthogonal views count as
    orthogonal: there a difference is that of two bars, one of which is grey.
    """
    ratio = (table["pixel_v_mm"] / table["pixel_h_mm"]).clip(upper=1).fillna(1)
    return np.arccos(ratio.where(table["view"] != "orthogonal", 1)).to_numpy()


def pair_limit(sigma_px, blur_px=0.0, *, seed=0):
    """Return the narrowest line pairs that are definitely resolved, pixels.

    Patterns in steps of 4 % around the limit of the noise-free contrast are photographed at one
    pixel per millimetre, with 1 % noise, a roll of up to a degree and a map wrong by 0.1 pixels,
    and read by the rule of :func:`mmqa_lab.chart_image.reading.read_pattern`.

    Parameters
    ----------
    sigma_px : float
        Point spread, standard deviation without that of the pixel itself.
    blur_px : float
        Motion across the bars.
    seed : int

    Returns
    -------
    float
        NaN when none of them is resolved.

    Examples
    --------
    >>> 2.3 < pair_limit(0.5) < pair_limit(1.0) < 3.5
    True
    """
    rng = np.random.default_rng(seed)
    layout = _steps_chart(sigma_px, blur_px)
    roll = np.radians(rng.uniform(-1, 1))
    c, s = np.cos(roll), np.sin(roll)
    column, row = rng.uniform(0, 1, 2)
    there = chart_image.ChartMap(np.array([[c, s, column], [s, -c, row], [0.0, 0.0, 1.0]]))
    optics = cameras.Optics(sigma_px, travel=(blur_px * c, blur_px * s, 0.0))
    photo = cameras.photograph(layout, there, optics=optics, margin=3, seed=seed)
    place = photo.chart_map.within(*rng.normal(0, MAP_ERROR_PX, 2))
    levels = find_tones(photo.image, layout, place)
    return chart_image.resolution(chart_image.read_pairs(levels, layout, place), "h").width_mm


def limits_mm(cells, limits, sigma_px, blur_mm=0.0):
    """Return the narrowest resolved width of each cell, millimetres, linear between the limits.

    Parameters
    ----------
    cells : DataFrame
        Of :func:`width_cells`.
    limits : DataArray
        :func:`pair_limit` over ``sigma_px`` and ``blur_px``.
    sigma_px, blur_mm : float
        Point spread, and way of the vehicle during the exposure.

    Returns
    -------
    array, shape (n,)
        NaN beyond the range of the limits.
    """
    pixel = xr.DataArray(cells["pixel_mm"].to_numpy(), dims="cell")
    places = {"sigma_px": sigma_px, "blur_px": blur_mm * cells["blur_share"].to_numpy() / pixel}
    several = limits.squeeze(drop=True)  # one spread or motion alone stands for all
    found = several.interp({name: places[name] for name in several.dims})
    return (found * pixel).to_numpy()


def ladder_widths(finest_mm, directions):
    """Return the finest width of the chart's ladder that is resolved, NaN for none.

    Parameters
    ----------
    finest_mm : array_like, shape (n,)
        Narrowest resolved width, millimetres.
    directions : sequence of {"h", "v"}

    Examples
    --------
    >>> ladder_widths([9.0, 35.0, 35.0], ["h", "h", "v"]).tolist()
    [10.0, 40.0, nan]
    """
    found = []
    for finest, direction in zip(finest_mm, directions, strict=True):
        wider = [width for width in LADDERS_MM[direction] if width >= finest]
        found.append(min(wider, default=np.nan))
    return np.array(found)


def steps_between(one, two, directions):
    """Return how many steps of the chart's ladder the first widths are finer than the second.

    The ladder for lying bars begins one step later; no width at all is one step before the ladder.

    Examples
    --------
    >>> steps_between([8.0, np.nan], [10.0, 30.0], ["h", "v"]).tolist()
    [1, -1]
    """
    pairs = zip(one, two, directions, strict=True)
    return np.array([_rung(first, d) - _rung(second, d) for first, second, d in pairs])


def spread_trials(cells, limits, sigmas_px, blurs_mm=(0.0,)):
    """Return how well each point spread and motion explains the published widths.

    Parameters
    ----------
    cells : DataFrame
        Of :func:`width_cells`.
    limits : DataArray
        As for :func:`limits_mm`; spreads beyond its range are left out.
    sigmas_px, blurs_mm : sequence of float
        What is tried, every combination.

    Returns
    -------
    DataFrame
        ``sigma_px``, ``blur_mm``, ``exact`` and ``within_one_step`` of the ``cells`` with a printed
        width, ``dashes_met`` (dashes for which no width of the ladder is resolved either),
        ``steps`` in sum over all cells, and ``kind`` = fitted.
    """
    known, printed = limits["sigma_px"], cells["published_mm"].notna().to_numpy()
    rows = []
    for case in bench.grid(sigma_px=sigmas_px, blur_mm=blurs_mm):
        if known.min() <= case["sigma_px"] <= known.max():
            found = ladder_widths(limits_mm(cells, limits, **case), cells["direction"])
            steps = np.abs(steps_between(found, cells["published_mm"], cells["direction"]))
            near, met = steps[printed] <= 1, steps[~printed] == 0
            counts = {"exact": int((steps[printed] == 0).sum()), "within_one_step": int(near.sum())}
            counts |= {"cells": len(near), "dashes_met": int(met.sum()), "steps": int(steps.sum())}
            rows.append(case | counts)
    return pd.DataFrame(rows).assign(kind="fitted")


@lru_cache(maxsize=64)
def take(system, distance_m, view, *, exposure_ms=0.0, seed=0, sigma_px=FITTED_PX, layout=None):
    """Photograph the chart as a row of Table 1 saw it.

    Noise of 1 %, sRGB, 8 bits and JPEG are in the chain; the point spread is that of the whole
    camera, interpolation of colours included. Roll and place of the pixels follow from the seed.

    Parameters
    ----------
    system, distance_m, view
        The row.
    exposure_ms : float
        At 40 km/h: 1 ms are 11 mm.
    seed : int
    sigma_px : float
        Point spread.
    layout : Layout, optional
        Of the chart; the imaging chart as built when not given.

    Returns
    -------
    seen : ImageQuality
        Of :func:`mmqa_lab.chart_image.evaluate_image`.
    truth : dict
        ``pixel_h_mm``, ``pixel_v_mm`` (true, along the bars), ``published`` (the row) and
        ``patterns``: the readings with ``there``, whether the optics carry the pattern at all: two
        pixels a pair or more, and a tenth of the contrast in closed form.
    """
    rng = np.random.default_rng(seed)
    row = table_1().set_index(ROW).loc[[(system, distance_m, view)]].reset_index()
    layout = layout or charts.imaging_chart()
    angle = float(view_angle(row)[0])
    sizes = row[["pixel_v_mm", "pixel_h_mm"]].iloc[0].fillna(row["pixel_v_mm"].item())
    pixel_mm = sizes.mean() if view == "orthogonal" else sizes["pixel_v_mm"]
    there = cameras.chart_view(
        cameras.PanoramaCamera(2 * round(1000 * np.pi * distance_m / pixel_mm)),
        distance=distance_m * np.cos(angle),
        heading_deg=np.degrees(-angle if view == "backward" else angle),
        roll_deg=rng.uniform(-1, 1),
        aim_deg=rng.uniform(0, 2),
        layout=layout,
    )
    travel = _way(there, view) * SPEED_KMH / 3.6 * exposure_ms
    optics = cameras.Optics(sigma_px, travel=tuple(travel))
    photo = cameras.photograph(layout, there, optics=optics, sensor=SENSOR, seed=seed)
    image = decode(photo.image.astype(np.float32) / 255, "srgb")
    corners = photo.chart_map.pixels(layout.corners())
    bent = {"camera": there.camera, "offset": photo.origin}
    place = chart_image.locate(None, layout, corners=corners, **bent)
    seen = chart_image.evaluate_image(image, layout, place)
    middle = {"h": [[500.0, 50.0]], "v": [[154.0, 500.0], [856.0, 500.0]]}
    truth = {
        f"pixel_{direction}_mm": photo.chart_map.pixel_sizes_mm(places)[:, axis].mean()
        for axis, (direction, places) in enumerate(middle.items())
    }
    patterns = seen.pairs
    blurs = [_blur_px(photo.chart_map, travel, layout[name]) for name in patterns["name"]]
    contrast = expected_contrast(patterns["width_px"].to_numpy(), sigma_px, blurs)
    carried = (contrast >= SMALLEST_GAP) & (patterns["width_px"] >= 2)
    return seen, truth | {"published": row.iloc[0], "patterns": patterns.assign(there=carried)}


def photo_case(system, distance_m, view, spread_px=FITTED_PX, exposure_ms=0.0, seed=0):
    """Return the photograph of a case of the bench and its truth: ``make`` of :func:`bench.run`."""
    choices = {"exposure_ms": exposure_ms, "seed": seed, "sigma_px": spread_px}
    return take(system, distance_m, view, **choices, layout=None)


def photo_cases(systems="ABC", spreads_px=(FITTED_PX,), exposures_ms=(0.0,)):
    """Return cases of the bench: photographs as Table 1 has them, then sharper and moved ones.

    Parameters
    ----------
    systems : sequence of str
    spreads_px, exposures_ms : sequence of float
        Of the orthogonal views at 10 m, every combination.

    Returns
    -------
    list of dict
        ``system``, ``distance_m``, ``view``, ``spread_px``, ``exposure_ms``.
    """
    table = table_1()
    rows = table[table["system"].isin(list(systems))][ROW].to_dict("records")
    cases = [row | {"spread_px": FITTED_PX, "exposure_ms": 0.0} for row in rows]
    for row in rows:
        if row["view"] == "orthogonal" and row["distance_m"] == 10:
            cases += bench.grid(**row, spread_px=spreads_px, exposure_ms=exposures_ms)
    cases = [case | {"exposure_ms": float(case["exposure_ms"])} for case in cases]
    return [case for k, case in enumerate(cases) if case not in cases[:k]]


def score_rule(resolved, truth):
    """Compare what a rule accepts as resolved with the optics and with Table 1.

    Parameters
    ----------
    resolved : array_like of bool
        For each pattern, in the order of ``seen.pairs``.
    truth : dict
        Of :func:`take`.

    Returns
    -------
    dict
        ``spurious``: patterns accepted that the optics do not carry; ``missed``: patterns refused
        that they do; ``steps_h``, ``steps_v``: of the ladder, finer than published.
    """
    patterns = truth["patterns"].assign(resolved=np.asarray(resolved, dtype=bool))
    there = patterns["there"]
    scores = {
        "spurious": int((patterns["resolved"] & ~there).sum()),
        "missed": int((~patterns["resolved"] & there).sum()),
    }
    for direction in "hv":
        width = chart_image.resolution(patterns, direction).width_mm
        printed = truth["published"][f"w_{direction}_mm"]
        scores[f"steps_{direction}"] = int(steps_between([width], [printed], [direction])[0])
    return scores


def every_gap(seen):
    """Accept a pattern when every gap stands out and number and place of the bars are right."""
    return seen.pairs["resolved"]


def contrast_alone(seen):
    """Accept a pattern when its bars differ by a tenth of the contrast, whichever is darker."""
    return seen.pairs["contrast"].abs() >= SMALLEST_GAP


def by_pixels(seen):
    """Mark a photograph by the pixels of capitals of 40 mm."""
    pixel_mm = seen.pixel_size("v")[0]
    return legibility.expected_marks(legibility.TEXT_MM / pixel_mm)["mark"].item()


RULES = {"every gap": every_gap, "contrast alone": contrast_alone}
"""Rules for resolved: a truth value for each pattern of ``seen.pairs``."""


def comparison(quick=False):
    """Return the bench of this study: rules for resolved on photographs of the chart."""
    systems, spreads, exposures = "ABC", (0.4, FITTED_PX), (0.0, 0.5, 1.5)
    if quick:
        systems, spreads, exposures = "C", (0.4,), (0.0, 1.5)
    cases = photo_cases(systems, spreads, exposures)
    return bench.Comparison(
        cases,
        dict(RULES),
        photo_case,
        score_rule,
        tables=lambda results: {"rules": rule_scores(results)},
        figures=lambda results: {"rules": draw_rules(results)},
    )


def rule_scores(results):
    """Return the spurious and missed patterns a photograph of each rule, orthogonal at 10 m.

    Parameters
    ----------
    results : Dataset
        Of the bench of rules.

    Returns
    -------
    DataFrame
        ``spurious`` and ``missed``, indexed by ``method``, ``spread_px`` and ``exposure_ms``.
    """
    table = bench.cell_table(results)
    seen = table[(table["view"] == "orthogonal") & (table["distance_m"] == 10)]
    groups = seen.groupby(["method", "spread_px", "exposure_ms"], sort=False)
    return groups[["spurious", "missed"]].mean()


def draw_rules(results):
    """Draw spurious and missed patterns of each rule, and how its widths differ from Table 1."""
    figure, axes = plots.subplots(1, 3, width="double", height_mm=55)
    table, scores = bench.cell_table(results), rule_scores(results)
    order = list(table["method"].unique())
    for ax, name in zip(axes, ("spurious", "missed"), strict=False):
        scores.pivot_table(name, "spread_px", "method")[order].plot.bar(ax=ax, legend=False, rot=0)
        ax.set(xlabel="point spread (pixels)", ylabel=f"{name} per photograph")
    printed = table[(table["spread_px"] == FITTED_PX) & (table["exposure_ms"] == 0)]
    steps = printed.set_index("method")[["steps_h", "steps_v"]].abs().stack().astype(int)
    counts = pd.crosstab(steps, steps.index.get_level_values("method"))
    counts[order].plot.bar(ax=axes[2], legend=False, rot=0)
    axes[2].set(xlabel="steps from Table 1", ylabel="widths")
    figure.legend(*axes[2].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return figure


def answer(trials):
    """Return the study's answer in a sentence, from :func:`spread_trials` without motion."""
    best = best_trial(trials)
    return (
        f"One fitted point spread of {best['sigma_px']:.2f} px for all systems puts "
        f"{best['within_one_step']} of {best['cells']} line-pair widths of Table 1 within one step "
        f"of the chart, {best['exact']} exactly."
    )


def best_trial(trials):
    """Return the trial with most widths within one step; of these with most exact ones."""
    order = trials.sort_values(["within_one_step", "exact"], ascending=False, kind="stable")
    return order.iloc[0].to_dict()


def ledger_entries(sizes, widths, legibility, repeats_px):
    """Return what this study says of the printed cells of Table 1 and of repeated bar lengths.

    Parameters
    ----------
    sizes : DataFrame
        ``system``, ``distance_m``, ``view``, ``direction``, ``published_mm`` (NaN for a dash),
        ``predicted_mm``, ``low_mm``, ``high_mm``.
    widths : DataFrame
        Of :func:`width_cells` with ``predicted_mm``, ``low_mm``, ``high_mm`` and ``fitted_mm``.
    legibility : DataFrame
        ``system``, ``distance_m``, ``view``, ``fitted_mark``.
    repeats_px : array_like
        Standard deviations of repeated bar lengths.

    Returns
    -------
    list of dict
        Of :func:`mmqa_lab.published.ledger.entry`.
    """
    entries = []
    for row in sizes.itertuples():
        ours = {"kind": "predicted", "low": row.low_mm, "high": row.high_mm}
        note = TOLD["pixels"][row.system] if row.published_mm > 0 else TOLD["dash"]
        entries.append(_entry(row, "pixel size", row.predicted_mm, ours, note))
    for row in widths.itertuples():
        ours = {"kind": "predicted", "low": row.low_mm, "high": row.high_mm}
        entries.append(_entry(row, "line-pair width", row.predicted_mm, ours, TOLD["width"]))
        entries.append(
            _entry(row, "line-pair width", row.fitted_mm, {"kind": "fitted"}, TOLD["fit"])
        )
    for row in legibility.itertuples():
        mark = "abc".index(row.fitted_mark) + 1
        entries.append(_entry(row, "legibility", mark, {"kind": "fitted"}, TOLD["mark"]))
    for name, times in (("bar_std", 1.0), ("bar_difference_max", 4.0)):
        ours = {"kind": "measured", "note": f"{TOLD['repeats']}; {times:g} standard deviations."}
        value = times * float(np.max(repeats_px))
        entries.append(ledger.entry("pfeifer2021", "numbers", name, value, **ours))
    return entries


check = stated("chart_images")


def checks(sizes, errors, trials, fits, rules):
    """Test what the notebook says.

    Parameters
    ----------
    sizes : DataFrame
        As for :func:`ledger_entries`.
    errors : Dataset
        Of the bench of estimators of the pixel size.
    trials, fits : DataFrame
        Of :func:`spread_trials` for all systems, and the best row for each.
    rules : Dataset
        Of the bench of rules.
    """
    measured = errors.sel({"method": "ends fitted"})
    worst = max(float(abs(measured[f"error_{d}_percent"]).max()) for d in "hv")
    yield check("bar_ends", worst < 1, f"largest error {worst:.2f} %")
    inside = sizes["published_mm"].between(sizes["low_mm"], sizes["high_mm"])
    known = sizes["published_mm"].notna()
    near = (inside & (sizes["system"] != "A")).sum()
    total = (known & (sizes["system"] != "A")).sum()
    yield check("pixels_of_b_and_c", near >= 14, f"{near} of {total} within their ranges")
    ratio = (sizes["published_mm"] / sizes["predicted_mm"])[sizes["system"] == "A"]
    yield check(
        "pixels_of_a", (ratio.dropna() > 1.1).all(), f"by {100 * (ratio.min() - 1):.0f} % or more"
    )
    best, cells = best_trial(trials), int(trials["cells"].iloc[0])
    yield check(
        "one_spread",
        best["within_one_step"] == cells,
        "{within_one_step} of {cells}, {exact} exactly at {sigma_px:.2f} px".format(**best),
    )
    exact = int(fits["exact"].sum())
    yield check(
        "spread_and_motion", exact > best["exact"], f"{exact} against {best['exact']} of {cells}"
    )
    wrong = bench.cell_table(rules).groupby("method")["spurious"].sum()
    yield check(
        "contrast_alone",
        wrong["contrast alone"] > 0 and wrong["every gap"] == 0,
        f"{wrong['contrast alone']:.0f} against {wrong['every gap']:.0f}",
    )


def _entry(row, quantity, value, ours, note):
    """The ledger's row for a cell of Table 1."""
    direction = getattr(row, "direction", "")
    cell = f"{row.system} {row.distance_m:.0f} m {row.view} {direction} {quantity}"
    name = " ".join(cell.split())
    return ledger.entry("pfeifer2021", "table_1", name, float(value), note=note, **ours)


def _rung(width, direction):
    """Place of a width on a ladder, -1 for none."""
    ladder = LADDERS_MM[direction]
    return ladder.index(width) if width in ladder else -1


def _steps_chart(sigma_px, blur_px):
    """A chart of line pairs around the limit, a millimetre for each pixel."""
    widths = np.geomspace(60, SMALLEST_PAIR_PX, 2000)
    poor = expected_contrast(widths, sigma_px, blur_px) < SMALLEST_GAP
    closed = widths[max(np.argmax(poor) - 1, 0)] if poor.any() else SMALLEST_PAIR_PX
    start = max(closed / LIMIT_STEP, SMALLEST_PAIR_PX)
    pairs, low = [], 10.0
    for width in start * LIMIT_STEP ** np.arange(LIMIT_STEPS):
        name = f"pairs_{width:.3f}"
        pairs.append(LinePairs(name, 10.0, low, float(width), "h", length=LIMIT_LENGTH_PX))
        low += LIMIT_LENGTH_PX + 6
    right = pairs[-1].extent + 20
    bar = Bar("bar", right, 10.0, 15.0, low - 16)
    return Layout("steps", right + 25, low + 4, (*pairs, bar))


def _way(chart_map, view):
    """A millimetre of the vehicle's way in the camera's axes: along the chart, or towards it."""
    along, up = chart_map.matrix[:, 0], chart_map.matrix[:, 1]
    return along if view == "orthogonal" else 1000 * np.cross(along, up)


def _blur_px(chart_map, travel, pairs):
    """By how many pixels motion blurs a pattern across its bars."""
    moved = chart_map.matrix.copy()
    moved[:, 2] -= travel
    middle = pairs.corners().mean(axis=0)[None]
    step = replace(chart_map, matrix=moved).pixels(middle) - chart_map.pixels(middle)
    across = chart_map.scale(middle)[0, "hv".index(pairs.direction)]
    return float(abs(step[0] @ across) / np.linalg.norm(across))
