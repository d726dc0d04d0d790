"""What a map says as a whole: quantiles and shares, each cell with the weight of its area."""

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_choice, check_number

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


def summarise(dataset, *, below=None):
    """Summarise each figure of each layer.

    Parameters
    ----------
    dataset : Dataset
        As :func:`mmqa_lab.maps.open_map` gives it.
    below : dict of str to float, optional
        Thresholds by variable, in its unit.

    Returns
    -------
    DataFrame
        A row per layer and variable: ``layer``, ``variable``, ``unit``, ``n`` (cells that have the
        figure), ``area_m2`` (of the surface in them), area-weighted quantiles ``q05`` .. ``q95``,
        ``threshold`` and ``share_below`` (of the area; NaN without a threshold). Where the map
        says where f is exempt, the rows of f have ``exempt_share`` of their area, too.

    Raises
    ------
    ValueError
        If a threshold is for a variable that the map does not have.

    Examples
    --------
    >>> import xarray as xr
    >>> cells = {"area": ("x", [3.0, 1.0]), "f": ("x", [1.5, 2.5], {"units": "1"})}
    >>> plane = xr.Dataset(cells).expand_dims(layer=["level"])
    >>> table = summarise(plane, below={"f": 2})
    >>> table[["q50", "share_below"]].values.tolist()
    [[1.5, 0.75]]
    """
    below = {} if below is None else below
    names = [name for name in dataset.data_vars if name not in ("n", "area", "exempt")]
    check_thresholds(below, names)
    layers = dataset["layer"].values
    area = dataset["area"].transpose("layer", ...).values
    rows = {}
    for name in names:
        figures = dataset[name].transpose("layer", ...).values
        for k, layer in enumerate(layers):
            known = np.isfinite(figures[k]) & (area[k] > 0)
            found = _figures(figures[k][known], area[k][known], below.get(name, np.nan))
            about = {"layer": str(layer), "variable": name, "unit": dataset[name].attrs["units"]}
            if name == "f" and "exempt" in dataset:
                free = dataset["exempt"].transpose("layer", ...).values[k][known]
                share = (
                    (free * area[k][known]).sum() / area[k][known].sum() if len(free) else np.nan
                )
                found["exempt_share"] = float(share)
            rows[k, name] = about | found
    table = pd.DataFrame([rows[k, name] for k in range(len(layers)) for name in names])
    return table[table["n"] > 0].reset_index(drop=True)


def check_thresholds(below, names):
    """Raise unless every threshold is a number for one of the variables ``names``."""
    for name, threshold in below.items():
        check_choice(name, "figure with a threshold", names)
        check_number(threshold, f"threshold of {name}")


def _figures(values, area, threshold):
    """Count, area, quantiles and the share below a threshold."""
    found = {"n": len(values), "area_m2": float(area.sum())}
    for q in QUANTILES:
        found[f"q{100 * q:02.0f}"] = (
            float(np.quantile(values, q, weights=area, method="inverted_cdf"))
            if len(values)
            else np.nan
        )
    measurable = len(values) and np.isfinite(threshold)
    share = float(area[values < threshold].sum() / area.sum()) if measurable else np.nan
    return found | {"threshold": threshold, "share_below": share}
