"""Table 1 from specifications: how each system saw the chart, and what it must have resolved."""

import numpy as np
import pandas as pd
import xarray as xr

from mmqa_lab import chart_image
from mmqa_lab.chart_image.line_pairs import SMALLEST_GAP, SMALLEST_PAIR_PX
from mmqa_lab.charts import Bar, Layout, LinePairs
from mmqa_lab.published import pfeifer2021_images as published
from mmqa_lab.simulate import cameras

TYPICAL_SIGMA_PX = 0.6
"""Point spread that the prediction takes for every camera, set beforehand."""

LIMIT_STEP = 1.04
"""Between the line pairs that find the limit of a point spread."""

LIMIT_STEPS = 9

LIMIT_LENGTH_PX = 24.0
"""Length of their bars: 80 mm at pixels of 3.3 mm."""

MAP_ERROR_PX = 0.1
"""By which the place of their chart is wrong."""


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

    Examples
    --------
    >>> geometry(["C"])["specified_mm"].round(2).tolist()
    [4.06, 8.11]
    """
    table = published.table_1()
    table = table[table["system"].isin(systems)].dropna(subset=["pixel_h_mm", "w_h_mm"])
    megapixels = published.systems().set_index("system")["megapixels"]
    rows = []
    for row in table.to_dict("records"):
        camera = chart_image.PanoramaCamera.of_megapixels(megapixels[row["system"]])
        row["specified_mm"] = camera.pixel_size_mm(row["distance_m"])
        upright = row["pixel_v_mm"]
        if not np.isfinite(upright):
            oblique = row["view"] != "orthogonal"
            upright = row["specified_mm"] if oblique else row["pixel_h_mm"]
        row["seen_h_mm"], row["seen_v_mm"] = row["pixel_h_mm"], upright
        row["view_deg"] = float(np.degrees(np.arccos(min(upright / row["pixel_h_mm"], 1.0))))
        rows.append(row)
    return pd.DataFrame(rows)


def width_cells(rows):
    """Return the published widths of rows of :func:`geometry`, a row per cell.

    Returns
    -------
    DataFrame
        ``system``, ``distance_m``, ``view``, ``direction``, ``published_mm``, ``pixel_mm`` (as
        seen) and ``specified_mm`` (from megapixels; in oblique views longer as published).
    """
    cells = []
    for row in rows.itertuples():
        longer = 1.0 if row.view == "orthogonal" else row.seen_h_mm / row.seen_v_mm
        known = {"system": row.system, "distance_m": row.distance_m, "view": row.view}
        for direction, stretch in (("h", longer), ("v", 1.0)):
            cell = {
                "direction": direction,
                "published_mm": getattr(row, f"w_{direction}_mm"),
                "pixel_mm": getattr(row, f"seen_{direction}_mm"),
                "specified_mm": row.specified_mm * stretch,
            }
            cells.append(known | cell)
    return pd.DataFrame(cells)


def pair_limit(sigma_px, blur_px=0.0, *, seed=0):
    """Return the narrowest line pairs that are definitely resolved, pixels.

    Patterns in steps of 4 % around the limit of the noise-free contrast are photographed at one
    pixel per millimetre, with 1 % noise, a roll of up to a degree and a map wrong by 0.1 pixels,
    and read by the rule of :mod:`mmqa_lab.chart_image.line_pairs`.

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
    layout = _steps(sigma_px, blur_px)
    roll = np.radians(rng.uniform(-1, 1))
    c, s = np.cos(roll), np.sin(roll)
    column, row = rng.uniform(0, 1, 2)
    there = chart_image.ChartMap(np.array([[c, s, column], [s, -c, row], [0.0, 0.0, 1.0]]))
    photo = cameras.photograph(
        layout,
        there,
        optics=cameras.Optics(sigma_px, travel=(blur_px * c, blur_px * s, 0.0)),
        margin=3,
        seed=seed,
    )
    place = photo.chart_map.within(*rng.normal(0, MAP_ERROR_PX, 2))
    readings = chart_image.read_pairs(chart_image.tones(photo.image, layout, place), layout, place)
    return chart_image.resolution(readings, "h").width_mm


def pair_limits(sigmas_px, blurs_px, *, seed=0):
    """Return :func:`pair_limit` over point spreads and motion blurs.

    Returns
    -------
    DataArray
        Dimensions ``sigma_px`` and ``blur_px``; pixels.
    """
    from tqdm.auto import tqdm

    limits = [
        [pair_limit(sigma, blur, seed=seed) for blur in blurs_px]
        for sigma in tqdm(sigmas_px, desc="point spreads", leave=False)
    ]
    return xr.DataArray(
        limits,
        coords={"sigma_px": list(sigmas_px), "blur_px": list(blurs_px)},
        dims=("sigma_px", "blur_px"),
        name="pair_limit",
        attrs={"units": "pixels"},
    )


def limits_mm(cells, limits, sigma_px, blur_mm=0.0):
    """Return the narrowest resolved width in each cell, millimetres, linear between the limits.

    Parameters
    ----------
    cells : DataFrame
        With ``pixel_mm`` and ``direction``; motion blurs standing bars alone.
    limits : DataArray
        Of :func:`pair_limits`.
    sigma_px, blur_mm : float or DataArray
        One for all cells, or with dimensions of their own.

    Returns
    -------
    DataArray
        Dimension ``cell`` and those of ``sigma_px`` and ``blur_mm``; NaN beyond the limits' range.
    """
    pixel = xr.DataArray(cells["pixel_mm"].to_numpy(), dims="cell")
    standing = xr.DataArray((cells["direction"] == "h").to_numpy(dtype=float), dims="cell")
    sigma = xr.DataArray(sigma_px) + 0 * pixel
    return limits.interp(sigma_px=sigma, blur_px=blur_mm * standing / pixel) * pixel


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
        wider = [width for width in published.LADDERS_MM[direction] if width >= finest]
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
    return np.array(
        [
            _rung(first, direction) - _rung(second, direction)
            for first, second, direction in zip(one, two, directions, strict=True)
        ]
    )


def _rung(width, direction):
    """Place of a width on a ladder, -1 for none."""
    ladder = published.LADDERS_MM[direction]
    return ladder.index(width) if width in ladder else -1


def _steps(sigma_px, blur_px):
    """A chart of line pairs around the limit, a millimetre for each pixel."""
    widths = np.geomspace(60, SMALLEST_PAIR_PX, 2000)
    poor = chart_image.expected_contrast(widths, sigma_px, blur_px) < SMALLEST_GAP
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
