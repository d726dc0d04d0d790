"""Maps as tables of quantiles and as NetCDF and GeoTIFF files."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from mmqa_lab._checks import (
    check_choice,
)
from mmqa_lab.io import write_atomically

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
    write_atomically(path, lambda file: _write_geotiff(dataset, file))


def _write_geotiff(dataset, path):
    """Write the figures as bands from north to south (OGC GeoTIFF 1.1, GDAL's names of bands)."""
    import pyproj
    import tifffile

    crs, cell = pyproj.CRS(dataset["spatial_ref"].attrs["crs_wkt"]), dataset.attrs["cell_m"]
    number = (crs.sub_crs_list[0] if crs.is_compound else crs).to_epsg()
    if number is None:
        raise ValueError(f"Invalid map in {crs.name}. Must have an EPSG number, or be .nc.")
    corner = float(dataset["x"][0]) - cell / 2, float(dataset["y"][-1]) + cell / 2
    keys = (1, 1, 0, 3, 1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, number)
    item = '<Item name="DESCRIPTION" sample="{}" role="description">{}</Item>'
    names = "".join(item.format(k, name) for k, name in enumerate(dataset))
    tags = [
        (33550, "d", 3, (cell, cell, 0.0)),
        (33922, "d", 6, (0.0, 0.0, 0.0, *corner, 0.0)),
        (34735, "H", len(keys), keys),
        (42112, "s", 0, f"<GDALMetadata>{names}</GDALMetadata>"),
        (42113, "s", 0, "nan"),
    ]
    bands = np.stack([dataset[name].values[::-1] for name in dataset]).astype(np.float32)
    choices = {"photometric": "minisblack", "planarconfig": "separate", "compression": "zlib"}
    tifffile.imwrite(path, bands, extratags=tags, metadata=None, **choices)
