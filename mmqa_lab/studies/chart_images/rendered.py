"""The chart photographed as each row of Table 1 saw it, and evaluated."""

from dataclasses import replace

import numpy as np
import pandas as pd

from mmqa_lab import chart_image, charts
from mmqa_lab.chart_image.light import decode
from mmqa_lab.simulate import cameras

FINER_MM = (50.0, 42.0, 35.0, 30.0, 25.0, 21.0, 17.5, 15.0, 12.5, 10.5, 9.0, 7.5, 6.2)
"""A ladder with steps of about a sixth that begins one step coarser."""

ROW = ["system", "distance_m", "view"]
"""What names a row of Table 1."""

SENSOR = cameras.Sensor(noise=0.01, gamma="srgb", bits=8, jpeg_quality=90)


def photograph(row, model, *, layout=None, seed=0):
    """Return one photograph of a row of :func:`geometry`, linear light in grey.

    Noise of 1 %, sRGB, 8 bits and JPEG are in the chain; the point spread is that of the whole
    camera, interpolation of colours included. Roll and place of the pixels follow from the seed.

    Parameters
    ----------
    row : namedtuple
        Of ``geometry(...).itertuples()``.
    model : DataFrame
        ``system``, ``sigma_px`` and ``blur_mm`` along the chart.
    layout : Layout, optional
        The chart as built when not given.
    seed : int

    Returns
    -------
    mmqa_lab.simulate.cameras.Photo
    """
    rng = np.random.default_rng(seed)
    layout = charts.imaging_chart() if layout is None else layout
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
    own = model.set_index("system").loc[row.system]
    # along the chart, as the vehicle drives
    travel = tuple(view.matrix[:, 0] * own["blur_mm"])
    optics = cameras.Optics(own["sigma_px"], travel=travel)
    photo = cameras.photograph(layout, view, optics=optics, sensor=SENSOR, seed=seed)
    return replace(photo, image=decode(photo.image.astype(np.float32) / 255, "srgb"))


def evaluate(photo, layout):
    """Return the :class:`mmqa_lab.chart_image.ImageQuality` of a photograph with its corners."""
    there = chart_image.locate_corners(
        photo.chart_map.pixels(layout.corners()),
        layout,
        camera=photo.chart_map.camera,
        offset=photo.origin,
    )
    return chart_image.evaluate_image(photo.image, layout, there)


def photographs(rows, model, *, seeds, layout=None):
    """Photograph the chart as each row saw it, and evaluate the photographs.

    Parameters
    ----------
    rows : DataFrame
        Of :func:`geometry`.
    model : DataFrame
        ``system``, ``sigma_px``, ``blur_mm``.
    seeds : int
        Photographs per row, with other noise and other places of the pixels.
    layout : Layout, optional
        The chart as built when not given.

    Returns
    -------
    DataFrame
        A row per photograph: ``system``, ``distance_m``, ``view``, ``seed`` and the columns of
        :meth:`mmqa_lab.chart_image.ImageQuality.to_frame`.
    """
    from tqdm.auto import tqdm

    layout = charts.imaging_chart() if layout is None else layout
    found = []
    for row in tqdm(list(rows.itertuples()), desc="photographs", leave=False):
        known = {name: getattr(row, name) for name in ROW}
        for seed in range(seeds):
            photo = photograph(row, model, layout=layout, seed=seed)
            found.append(evaluate(photo, layout).to_frame().assign(**known, seed=seed))
    return pd.concat(found, ignore_index=True)


def specified(rows):
    """Return the orthogonal rows as the specification has them: square pixels from megapixels."""
    rows = rows[rows["view"] == "orthogonal"]
    return rows.assign(seen_h_mm=rows["specified_mm"], seen_v_mm=rows["specified_mm"], view_deg=0.0)


def readings(photos):
    """Return the widths read, a row per cell of Table 1.

    Returns
    -------
    DataFrame
        ``system``, ``distance_m``, ``view``, ``direction``, ``w_mm`` and ``next_mm`` (of the
        photograph in the middle: the lower median), ``limit_mm`` (interpolated, mean), ``n``.
    """
    parts = []
    for direction in "hv":
        names = {f"w_{direction}_mm": "w_mm", f"w_{direction}_next_mm": "next_mm"}
        names |= {f"limit_{direction}_mm": "limit_mm"}
        part = photos[[*ROW, *names]].rename(columns=names).assign(direction=direction)
        # no width at all is coarser than every width
        parts.append(part.assign(w_mm=part["w_mm"].fillna(np.inf)))
    groups = pd.concat(parts).groupby([*ROW, "direction"])
    middle = groups[["w_mm", "next_mm"]].quantile(0.5, interpolation="lower")
    found = middle.assign(limit_mm=groups["limit_mm"].mean(), n=groups.size()).reset_index()
    return found.replace({"w_mm": np.inf}, np.nan)


def finer_chart(rows, model, *, seeds):
    """Return what a chart with finer steps would have shown, orthogonal.

    Parameters
    ----------
    rows, model : DataFrame
    seeds : int

    Returns
    -------
    DataFrame
        As :func:`readings`, for the ladder :data:`FINER_MM`, with ``published_mm``.
    """
    layout = charts.imaging_chart(widths_h=FINER_MM, widths_v=FINER_MM, texts=())
    chosen = rows[rows["view"] == "orthogonal"]
    found = readings(photographs(chosen, model, seeds=seeds, layout=layout))
    printed = chosen.melt(ROW, ["w_h_mm", "w_v_mm"], "direction", "published_mm")
    printed["direction"] = printed["direction"].str[2]
    return found.merge(printed, on=[*ROW, "direction"])
