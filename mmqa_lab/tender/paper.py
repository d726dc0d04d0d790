"""Criteria and results of Pfeifer et al. 2021 (doi:10.3390/rs13020237) as tables of a tender."""

import numpy as np
import pandas as pd

from mmqa_lab import published
from mmqa_lab._checks import check_choice
from mmqa_lab.chart_image import MARKS, expected_marks
from mmqa_lab.published.ledger import COARSEST_MM
from mmqa_lab.tender.tables import CRITERIA

__all__ = ["published_criteria", "published_results"]

IMAGE_NAMES = {"pixel size": "pixel_mm", "line-pair width": "w_mm"}

SETS = ("test", "scenario 1", "scenario 2")
"""Sets of criteria that Pfeifer et al. 2021 print: the test (section 4.2), two examples (4.4)."""

OWN_SET = "test with g"
"""The test with g in place of f, which the paper does not print."""

RUNGS_MM = (40.0, 30.0, 20.0, 15.0, 10.0, 8.0, 6.0, 4.0)
"""Widths of line pairs that Table 1 shows."""

RANGE_OF_FIVE = 2.326
"""Mean range of five normal values in standard deviations: five selections were compared."""

REPEATED = ("selection_density", "selection_precision", "bar_std")
"""Printed numbers (section 4.4) that say how repeatable a figure is."""


def published_criteria(name: str, *, cloud_distance_m: float = 5.0) -> pd.DataFrame:
    """Return a set of criteria as Pfeifer et al. 2021 print it.

    Parameters
    ----------
    name : {"test", "scenario 1", "scenario 2", "test with g"}
        The test of section 4.2, an example of section 4.4, or the test with g < 2 in place of
        f < 2, which the paper does not print.
    cloud_distance_m : float
        Where no distance is printed for a figure of the cloud: the 5 m of the other criteria.

    Returns
    -------
    DataFrame
        As :func:`verdicts` wants it. Where the paper prints no relation (section 4.4), a
        figure may reach its threshold.

    Raises
    ------
    ValueError
        If the name is another.

    Examples
    --------
    >>> table = published_criteria("scenario 1")
    >>> table[["quantity", "relation", "threshold", "distance_m"]].values.tolist()
    [['legibility_40mm', '<=', 'b', 10.0], ['density_per_m2', '>=', 4000.0, 5.0],
     ['sigma_mad_mm', '<=', 5.0, 5.0]]
    """
    with_g = check_choice(name, "criteria", (*SETS, OWN_SET)) == OWN_SET
    name = "test" if with_g else name
    table = published.table("pfeifer2021", "criteria").query("set == @name").reset_index(drop=True)
    names = IMAGE_NAMES | {"density": "density_per_m2", "sigma_mad": "sigma_mad_mm"}
    text = table["quantity"] == "legibility"
    height = table["text_height_mm"].map("legibility_{:.0f}mm".format)
    table["quantity"] = height.where(text, table["quantity"].replace(names))
    table["threshold"] = table["threshold"].astype(object).where(~text, table["printed"])
    cloud = table["quantity"].isin(["density_per_m2", "sigma_mad_mm", "f"])
    unknown = cloud & table["distance_m"].isna()
    table["distance_m"] = table["distance_m"].mask(unknown, cloud_distance_m)
    table["view"] = np.where(text & table["views"].str.startswith("orthogonal"), "orthogonal", "")
    rho0 = float(table.loc[table["quantity"] == "density_per_m2", "threshold"].iloc[0])
    table["rho0_per_m2"] = np.where(table["quantity"] == "f", rho0, np.nan)
    if with_g:
        table = table.replace({"quantity": {"f": "g"}})
    return table[[*CRITERIA, "distance_m", "view", "rho0_per_m2"]]


def published_results(*, repeatability: bool = False, by_pixels: bool = False) -> pd.DataFrame:
    """Return Tables 1 and 2 of Pfeifer et al. 2021 in the form that :func:`verdicts` takes.

    Parameters
    ----------
    repeatability : bool
        Add what section 4.4 says of repeated measurements, for all systems and distances: ``sigma``
        of the density (five selections of B at 10 m vary by less than 1 %), of sigma_MAD (by less
        than 1 mm) and of pixel sizes (below 1 px for a bar), and one rung to either side of a
        line-pair width. Upper bounds are printed, so these are too wide.
    by_pixels : bool
        Give texts of 60 mm that were not judged the marks that their pixels per capital height
        allow: the worst one, and the interval to the best one
        (:func:`mmqa_lab.chart_image.expected_marks`).

    Returns
    -------
    DataFrame
        ``system``, ``quantity``, ``value``, ``low``, ``high``, ``sigma``, ``distance_m``, ``view``,
        ``direction``. A dash of a line-pair width is an interval that begins at the coarsest
        pattern of the chart. Texts of 60 mm at 5 m, which the chart does not have, are as legible
        as those of 40 mm where these are (a, b); else empty.

    Examples
    --------
    >>> results = published_results(by_pixels=True)
    >>> texts = results.query("quantity == 'legibility_60mm'")
    >>> texts[["system", "value"]].values.tolist()
    [['A', 'b'], ['B', 'a'], ['C', 'b']]
    """
    images = published.table("pfeifer2021", "table_1").query("status != 'not_evaluated'")
    rows = [_image_row(row) for row in images.to_dict("records")]
    rows += _larger_text(images, by_pixels)
    for cloud in published.table("pfeifer2021", "table_2").to_dict("records"):
        place = {"system": cloud["system"], "distance_m": float(cloud["distance_m"])}
        names = ("density_per_m2", "sigma_mad_mm", "d1_mm", "d4_mm", "f")
        rows += [{**place, "quantity": name, "value": float(cloud[name])} for name in names]
    table = pd.DataFrame(rows)
    table[["view", "direction"]] = table[["view", "direction"]].fillna("")
    table["sigma"] = np.nan
    if repeatability:
        of = {name: published.number("pfeifer2021", name)["value"] for name in REPEATED}
        table = table.apply(_repeated, axis=1, of=of)
    return table


def _image_row(row):
    """A cell of Table 1 as a result."""
    names = {"legibility": "legibility_40mm"} | IMAGE_NAMES
    result = {name: row[name] for name in ("system", "distance_m", "view", "direction")}
    result["quantity"] = names[row["quantity"]]
    result["value"] = row["printed"] if row["quantity"] == "legibility" else row["value"]
    if row["status"] == "not_resolved" and row["quantity"] == "line-pair width":
        coarsest = COARSEST_MM[row["direction"]]
        result |= {"low": np.nextafter(coarsest, np.inf), "high": np.inf}
    return result


def _larger_text(images, by_pixels):
    """Results for text of 60 mm in the orthogonal view at 5 m."""
    place = {"distance_m": 5.0, "view": "orthogonal", "quantity": "legibility_60mm"}
    keys = ["system", "distance_m", "view"]
    marks = images.query("quantity == 'legibility'").set_index(keys)["printed"]
    pixels = images.query("quantity == 'pixel size' and direction == 'v'").set_index(keys)["value"]
    rows = []
    for system in "ABC":
        key = (system, 5.0, "orthogonal")
        row = {**place, "system": system, "value": marks[key]}
        if marks[key] == "c":
            found = expected_marks(60 / pixels[key]).iloc[0]
            ends = {"low": MARKS.index(found["best"]), "high": MARKS.index(found["worst"])}
            row |= {"value": found["worst"], **ends} if by_pixels else {"value": None}
        rows.append(row)
    return rows


def _repeated(row, of):
    """A result with the repeatability that section 4.4 prints."""
    row = row.copy()
    if row["quantity"] == "density_per_m2":
        row["sigma"] = of["selection_density"] / 100 * row["value"] / RANGE_OF_FIVE
    elif row["quantity"] == "sigma_mad_mm":
        row["sigma"] = of["selection_precision"] / RANGE_OF_FIVE
    elif row["quantity"] == "pixel_mm":  # of a bar of L: pixel / (L / pixel); v is a mean of two
        bar, count = (600, 1) if row["direction"] == "h" else (800, 2)
        row["sigma"] = of["bar_std"] * row["value"] ** 2 / bar / np.sqrt(count)
    elif row["quantity"] == "w_mm" and np.isfinite(row["value"]):
        rung = RUNGS_MM.index(row["value"])
        row["low"] = RUNGS_MM[min(rung + 1, len(RUNGS_MM) - 1)]
        row["high"] = RUNGS_MM[rung - 1] if rung else np.inf
    return row
