"""Table 1 from images: the limit of line pairs in rendered images and simulated photographs."""

from functools import lru_cache

import numpy as np

from mmqa_lab import chart_image, charts, published
from mmqa_lab.bench import Comparison, grid
from mmqa_lab.charts import Bar, Layout, LinePairs, decode
from mmqa_lab.published import ledger
from mmqa_lab.simulate import cameras

__all__ = [
    "LADDERS_MM", "ROW", "bench", "contrast_alone", "enough_pixels", "every_gap", "ledger_rows",
    "pair_limit", "photo_case", "score_rule", "table_1",
]  # fmt: skip

ROW = ["system", "distance_m", "view"]
"""Columns that name a row of Table 1."""

PAIRS = charts.imaging_chart().of_kind(LinePairs)

LADDERS_MM = {d: sorted((p.pair for p in PAIRS if p.direction == d), reverse=True) for d in "hv"}
"""Widths on the chart of the standing (h) and of the lying bars (v)."""

FITTED_PX = 0.8
"""Point spread of the photographs. Its limit is 2.8 pixels per line pair."""

SENSOR = cameras.Sensor(noise=0.01, gamma="srgb", bits=8, jpeg_quality=90)

SPEED_KMH = 40.0

LIMIT_STEP, LIMIT_STEPS, LIMIT_LENGTH_PX, MAP_ERROR_PX = 1.04, 9, 24.0, 0.1
"""Ratio, number and length of the line pairs for the limit, and the error of their position."""


def table_1():
    """Return Table 1 with a row for each evaluated photograph.

    Returns
    -------
    DataFrame
        ``system``, ``distance_m``, ``view``, ``pixel_h_mm`` (lying bar), ``pixel_v_mm`` (standing
        bars), ``w_h_mm`` (standing bars), ``w_v_mm``, ``legibility`` (a, b, c), all published.
        A printed dash is NaN.

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
    wide = wide.reset_index()
    ranks = {"key": lambda column: column.map(lambda one: order.get(one, one))}
    return wide.sort_values(ROW, **ranks, ignore_index=True)


def pair_limit(sigma_px, blur_px=0.0, *, seed=0):
    """Return the width of the narrowest line pairs that are resolved, px; NaN without any.

    The patterns have widths in steps of 4 % around the limit of the noise-free contrast. They are
    photographed with 1 % noise, a roll of up to a degree and a position error of 0.1 pixels, and
    read by :func:`mmqa_lab.chart_image.read_pairs`.

    Parameters
    ----------
    sigma_px : float
        Standard deviation of the point spread without the pixel, px.
    blur_px : float
        Motion across the bars, px.
    seed : int
        Seed of noise, roll and position.

    Returns
    -------
    float

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
    levels = chart_image.find_tones(photo.image, layout, place)
    return chart_image.resolution(chart_image.read_pairs(levels, layout, place), "h").width_mm


@lru_cache(maxsize=64)
def photo_case(system, distance_m, view, spread_px=FITTED_PX, exposure_ms=0.0, seed=0, layout=None):
    """Photograph the chart with the view of a row of Table 1, as ``make`` of the bench.

    The chain includes noise of 1 %, sRGB, 8 bits and JPEG. The seed sets the roll and the position
    of the pixels.

    Parameters
    ----------
    system, distance_m, view
        Columns ``ROW`` of the row.
    spread_px : float
        Standard deviation of the camera's point spread, px.
    exposure_ms : float
        Exposure time at 40 km/h, ms. The camera moves 11 mm per ms along the chart, so only an
        orthogonal view has one.
    seed : int
        Seed of noise, roll and position.
    layout : Layout, optional
        Layout of the chart; by default the imaging chart as built.

    Returns
    -------
    seen : ImageQuality
        From :func:`mmqa_lab.chart_image.evaluate_image`.
    truth : dict
        ``pixel_h_mm``, ``pixel_v_mm`` (true pixel sizes along the bars) and ``carried`` (whether
        the optics carry each pattern: two pixels per line pair or more, and at least a tenth of the
        contrast in closed form).
    """
    row = table_1().set_index(ROW).loc[(system, distance_m, view)]
    layout = layout or charts.imaging_chart()
    there = _view(row, distance_m, view, layout, np.random.default_rng(seed))
    travel_mm = SPEED_KMH / 3.6 * exposure_ms
    optics = cameras.Optics(spread_px, travel=tuple(travel_mm * there.matrix[:, 0]))
    photo = cameras.photograph(layout, there, optics=optics, sensor=SENSOR, seed=seed)
    image = decode(photo.image.astype(np.float32) / 255, "srgb")
    known = {"corners": photo.chart_map.pixels(layout.corners()), "camera": there.camera}
    place = chart_image.locate(None, layout, offset=photo.origin, **known)
    seen = chart_image.evaluate_image(image, layout, place)
    blurs = [_blur_px(photo.chart_map, travel_mm, layout[name]) for name in seen.pairs["name"]]
    width_px = seen.pairs["width_px"].to_numpy()
    left = chart_image.expected_contrast(width_px, spread_px, blurs)
    truth = {"carried": (left >= chart_image.SMALLEST_GAP) & (width_px >= 2)}
    for k, places in enumerate(([[500, 50]], [[154, 500], [856, 500]])):  # lying, standing bars
        sizes = photo.chart_map.pixel_sizes_mm(np.array(places, dtype=float))
        truth[f"pixel_{'hv'[k]}_mm"] = sizes[:, k].mean()
    return seen, truth


def score_rule(resolved, truth):
    """Count the patterns that a rule accepts or refuses wrongly.

    ``resolved`` has a truth value for each pattern, in the order of ``seen.pairs``. ``truth`` comes
    from :func:`photo_case`. ``spurious`` patterns are accepted although the optics do not carry
    them. ``missed`` patterns are refused although the optics carry them.
    """
    resolved, carried = np.asarray(resolved, dtype=bool), truth["carried"]
    return {"spurious": int(sum(resolved & ~carried)), "missed": int(sum(carried & ~resolved))}


def every_gap(seen):
    """Accept a pattern if all gaps are visible and number and positions of the bars are right."""
    return seen.pairs["resolved"]


def contrast_alone(seen):
    """Accept a pattern if bars and gaps differ by a tenth of the contrast, with either sign."""
    return seen.pairs["contrast"].abs() >= chart_image.SMALLEST_GAP


def enough_pixels(seen):
    """Accept a pattern from 2.74 pixels per line pair on, which agrees with most of Table 1."""
    return seen.pairs["width_px"] >= 2.74


def bench(systems="ABC", photo_spreads_px=(0.4, FITTED_PX), exposures_ms=(0, 0.5, 1.5), seed=1):
    """Return the study's comparison: rules for *resolved* on photographs of the chart.

    The first photographs have the views of Table 1 and the fitted point spread. The further
    photographs have the orthogonal views at 10 m and every combination of ``photo_spreads_px`` (px)
    and ``exposures_ms`` (ms).

    Examples
    --------
    >>> len(bench().cases)
    27
    """
    table = table_1()
    rows = table[table["system"].isin(list(systems))][ROW].to_dict("records")
    cases = [row | {"spread_px": FITTED_PX, "exposure_ms": 0.0} for row in rows]
    for row in rows:
        if row["view"] == "orthogonal" and row["distance_m"] == 10:
            cases += grid(**row, spread_px=photo_spreads_px, exposure_ms=exposures_ms)
    cases = [case for k, case in enumerate(cases) if case not in cases[:k]]
    rules = {"every gap": every_gap, "contrast alone": contrast_alone, "2.74 pixels": enough_pixels}
    return Comparison(cases, rules, photo_case, score_rule, [seed], figures=("spurious", "missed"))


def ledger_rows(rows, what, *, value, kind, note):
    """Return the ledger's entries for a quantity of Table 1, such as ``"pixel size"``.

    ``rows`` has the columns ``ROW``, the column that ``value`` names and, if the quantity depends
    on the direction, ``direction``. Predictions also have the limits of their interval, ``low_mm``
    and ``high_mm``.
    """
    place = rows["system"] + rows["distance_m"].map(" {:.0f} m ".format) + rows["view"] + " "
    cell = place + rows["direction"] + " " + what if "direction" in rows else place + what
    ends = {"low_mm": "low", "high_mm": "high"} if kind == "predicted" else {}
    named = rows.rename(columns={value: "value", **ends}).assign(cell=cell, note=note)
    return ledger.entries(named, source="pfeifer2021", table="table_1", kind=kind)


def _steps_chart(sigma_px, blur_px):
    """A chart of line pairs around the limit; a millimetre of the chart is a pixel."""
    widths = np.geomspace(60, chart_image.SMALLEST_PAIR_PX, 2000)
    poor = chart_image.expected_contrast(widths, sigma_px, blur_px) < chart_image.SMALLEST_GAP
    closed = widths[max(np.argmax(poor) - 1, 0)] if poor.any() else chart_image.SMALLEST_PAIR_PX
    start = max(closed / LIMIT_STEP, chart_image.SMALLEST_PAIR_PX)
    pairs, low = [], 10.0
    for width in start * LIMIT_STEP ** np.arange(LIMIT_STEPS):
        name = f"pairs_{width:.3f}"
        pairs.append(LinePairs(name, 10.0, low, float(width), "h", length=LIMIT_LENGTH_PX))
        low += LIMIT_LENGTH_PX + 6
    right = pairs[-1].extent + 20
    bar = Bar("bar", right, 10.0, 15.0, low - 16)
    return Layout("steps", right + 25, low + 4, (*pairs, bar))


def _view(row, distance_m, view, layout, rng):
    """The map of a chart whose pixels have the sizes of a row of Table 1.

    An oblique view makes pixels longer along x by 1/cos of its angle. In an orthogonal view the two
    sizes differ because one of the two bars is grey.
    """
    upright, along = row["pixel_v_mm"], row["pixel_h_mm"]
    along = upright if np.isnan(along) else along
    straight = view == "orthogonal"
    angle = 0.0 if straight else float(np.arccos(min(upright / along, 1)))
    pixel_mm = (upright + along) / 2 if straight else upright
    camera = cameras.PanoramaCamera(2 * round(1000 * np.pi * distance_m / pixel_mm))
    turn = {"heading_deg": np.degrees(-angle if view == "backward" else angle)}
    turn |= {"roll_deg": rng.uniform(-1, 1), "aim_deg": rng.uniform(0, 2)}
    return cameras.chart_view(camera, distance=distance_m * np.cos(angle), layout=layout, **turn)


def _blur_px(chart_map, travel_mm, pairs):
    """Blur of a pattern across its bars by a motion along the chart, px."""
    middle, bar = pairs.corners().mean(axis=0), np.eye(2)["hv".index(pairs.direction)] / 2
    places = [middle, middle - [travel_mm, 0], middle - bar, middle + bar]
    place, moved, low, high = chart_map.pixels(np.stack(places))
    return float(abs((moved - place) @ (high - low)) / np.linalg.norm(high - low))
