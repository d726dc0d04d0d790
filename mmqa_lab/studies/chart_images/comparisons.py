"""Published, predicted, fitted and measured figures of Table 1 in one table, and its tender."""

import numpy as np
import pandas as pd

from mmqa_lab import tender
from mmqa_lab.published import pfeifer2021_images as published
from mmqa_lab.studies.chart_images.predicted import (
    TYPICAL_SIGMA_PX,
    ladder_widths,
    limits_mm,
    steps_between,
)
from mmqa_lab.studies.chart_images.rendered import ROW, readings

CELL = [*ROW, "direction", "quantity"]
"""What names a cell of Table 1."""


def pixel_sizes(rows, photos):
    """Return the pixel sizes of the orthogonal views: published, predicted and measured.

    Parameters
    ----------
    rows : DataFrame
        Of :func:`geometry`.
    photos : DataFrame
        Of :func:`photographs` of :func:`specified` rows; others are not measured.

    Returns
    -------
    DataFrame
        ``system``, ``distance_m``, ``view``, ``direction``, ``quantity`` = pixel_mm, ``model``,
        ``kind``, ``value``, ``sigma`` (of the measurement).
    """
    rows = rows[rows["view"] == "orthogonal"]
    measured = photos.groupby(ROW).mean(numeric_only=True).reset_index()
    parts = []
    for direction in "hv":
        size, sigma = f"pixel_{direction}_mm", f"pixel_{direction}_sigma_mm"
        for model, kind, table, names in (
            ("published", "published", rows.dropna(subset=[size]), {size: "value"}),
            ("specification", "predicted", rows, {"specified_mm": "value"}),
            ("photograph", "measured", measured, {size: "value", sigma: "sigma"}),
        ):
            part = table[[*ROW, *names]].rename(columns=names)
            parts.append(part.assign(direction=direction, model=model, kind=kind))
    return pd.concat(parts, ignore_index=True).assign(quantity="pixel_mm")


def widths(cells, limits, models):
    """Return the resolved widths: published, predicted, and with fitted spread and motion.

    The prediction knows the specification: pixel size from megapixels and distance, oblique views
    longer as published, a point spread of 0.6 pixels, no motion.

    Parameters
    ----------
    cells : DataFrame
        Of :func:`width_cells`.
    limits : DataArray
        Of :func:`pair_limits`.
    models : dict of str to DataFrame
        ``system``, ``sigma_px`` and ``blur_mm`` by the fit's name.

    Returns
    -------
    DataFrame
        As :func:`pixel_sizes`, ``quantity`` = w_mm.
    """
    directions = cells["direction"]
    parts = [cells.assign(value=cells["published_mm"], model="published", kind="published")]
    seen = cells.assign(pixel_mm=cells["specified_mm"])
    found = ladder_widths(limits_mm(seen, limits, TYPICAL_SIGMA_PX).to_numpy(), directions)
    parts.append(cells.assign(value=found, model="specification", kind="predicted"))
    for name, model in models.items():
        for own in model.itertuples():
            part = cells[cells["system"] == own.system]
            finest = limits_mm(part, limits, own.sigma_px, own.blur_mm).to_numpy()
            found = ladder_widths(finest, part["direction"])
            parts.append(part.assign(value=found, model=name, kind="fitted"))
    names = [*ROW, "direction", "model", "kind", "value"]
    return pd.concat(parts, ignore_index=True)[names].assign(quantity="w_mm")


def photographed(photos):
    """Return the widths read in photographs taken with the fitted models.

    Parameters
    ----------
    photos : dict of str to DataFrame
        Of :func:`photographs`, by the fit's name.

    Returns
    -------
    DataFrame
        As :func:`widths`; ``model`` is the fit's name with ``, photographed``.
    """
    parts = [
        readings(found).rename(columns={"w_mm": "value"}).assign(model=f"{name}, photographed")
        for name, found in photos.items()
    ]
    table = pd.concat(parts, ignore_index=True).assign(kind="fitted", quantity="w_mm")
    return table[[*CELL, "model", "kind", "value"]]


def compare(*parts):
    """Put every figure of Table 1 beside the published one, cell by cell.

    Parameters
    ----------
    *parts : DataFrame
        Of :func:`pixel_sizes`, :func:`widths` and :func:`photographed`.

    Returns
    -------
    DataFrame
        ``system``, ``distance_m``, ``view``, ``direction``, ``quantity``, ``model``, ``kind``,
        ``value``, ``sigma``, ``published``, ``difference``, ``difference_percent``, and of widths
        ``steps``: of the chart's ladder, positive where finer than published.
    """
    table = pd.concat(parts, ignore_index=True)
    printed = table[table["kind"] == "published"][[*CELL, "value"]]
    table = table.merge(printed.rename(columns={"value": "published"}), on=CELL, how="left")
    table["difference"] = table["value"] - table["published"]
    table["difference_percent"] = 100 * table["difference"] / table["published"]
    steps = steps_between(table["value"], table["published"], table["direction"])
    counted = (table["quantity"] == "w_mm") & table["published"].notna()
    table["steps"] = np.where(counted, steps, np.nan)
    order = [*CELL, "model", "kind", "value", "sigma"]
    return table[[*order, "published", "difference", "difference_percent", "steps"]]


def side_by_side(table, quantity):
    """Return the figures of one quantity with a column per model, as one reads Table 1."""
    part = table[table["quantity"] == quantity]
    columns = part["model"].drop_duplicates()
    wide = part.pivot(index=[*ROW, "direction"], columns="model", values="value")
    return wide[columns].reset_index().rename_axis(columns=None)


def scenarios():
    """Return what the tender says of the three systems, and whether a step changes it.

    Returns
    -------
    DataFrame
        ``scenario`` and the columns of :func:`mmqa_lab.tender.qualification`;
        ``one_step_coarser``: the verdict if all widths had been read one step coarser, which is
        what readers differ by.
    """
    parts = []
    for number in published.SCENARIOS:
        criteria = published.tender_criteria(number)
        figures = published.results()
        found = tender.qualification(tender.verdicts(criteria, figures))
        coarser = [
            _coarser(row.value, row.direction) if row.quantity == "w_mm" else row.value
            for row in figures.itertuples()
        ]
        shifted = tender.qualification(tender.verdicts(criteria, figures.assign(value=coarser)))
        found.insert(2, "one_step_coarser", shifted["verdict"])
        parts.append(found.assign(scenario=number))
    table = pd.concat(parts, ignore_index=True)
    return table[["scenario", *table.columns.drop("scenario")]]


def _coarser(width, direction):
    """The next coarser width of the ladder; half as wide again beyond its end."""
    wider = [one for one in published.LADDERS_MM[direction] if one > width]
    return min(wider, default=1.5 * width)
