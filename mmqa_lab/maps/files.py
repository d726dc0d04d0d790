"""Maps as tables of quantiles and as NetCDF and GeoTIFF files."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from mmqa_lab._checks import check_choice
from mmqa_lab.io import write_atomically, write_raster

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["placed", "summarise", "write_map"]

ENDINGS = (".nc", ".tif")
"""Endings of maps: NetCDF and GeoTIFF."""

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


def placed(dataset: xr.Dataset, crs: Any) -> xr.Dataset:
    """Return a map with its coordinate reference system, as the CF conventions write it."""
    import pyproj

    mapping = {"grid_mapping": "spatial_ref"}
    figures = {name: figure.assign_attrs(mapping) for name, figure in dataset.items()}
    return dataset.assign(figures).assign_coords(spatial_ref=((), 0, pyproj.CRS(crs).to_cf()))


def summarise(dataset: xr.Dataset) -> pd.DataFrame:
    """Return quantiles of each figure over the cells.

    Parameters
    ----------
    dataset : Dataset
        From :func:`map_cloud` or :func:`open_map`.

    Returns
    -------
    DataFrame
        A row for each figure: ``figure``, ``unit``, ``n`` (cells with a value), ``q05`` to ``q95``.
    """
    names = [name for name in dataset if name != "n"]
    cells = dataset[names].to_dataframe()[names]
    table = cells.quantile(QUANTILES).T.set_axis([f"q{100 * q:02.0f}" for q in QUANTILES], axis=1)
    table.insert(0, "n", cells.count())
    units = [dataset[name].attrs["units"] for name in names]
    table.insert(0, "unit", ["points/m2" if unit == "m-2" else unit for unit in units])
    return table.rename_axis("figure").reset_index()


def write_map(path: str | os.PathLike, dataset: xr.Dataset) -> None:
    """Write a map as NetCDF (``.nc``) or GeoTIFF (``.tif``, a band for each figure).

    Parameters
    ----------
    path : path
        The file to write.
    dataset : Dataset
        From :func:`map_cloud` or :func:`open_map`.

    Raises
    ------
    ValueError
        If the ending is neither of these, if another kind of file is there, or if a GeoTIFF would
        lack a coordinate system.
    """
    path = Path(path)
    if check_choice(path.suffix.lower(), f"map {path} with ending", ENDINGS) == ".nc":
        write_atomically(path, lambda file: dataset.to_netcdf(file, engine="scipy"))
        return
    if "spatial_ref" not in dataset.coords:
        raise ValueError(f"Invalid map {path}: no coordinate system in the files. Must be .nc.")
    import pyproj

    cell = dataset.attrs["cell_m"]
    write_raster(
        path,
        {str(name): dataset[name].values[::-1] for name in dataset},
        corner=(float(dataset["x"][0]) - cell / 2, float(dataset["y"][-1]) + cell / 2),
        cell=cell,
        crs=pyproj.CRS(dataset["spatial_ref"].attrs["crs_wkt"]),
        units=[dataset[name].attrs.get("units", "") for name in dataset],
    )
