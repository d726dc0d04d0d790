"""Quality figures in the cells of a map, of a cloud in memory or of a campaign of any size.

What a chart gets as a whole, each cell of a map gets: density, spacing d1..d4, f, sigma_MAD, linear
point distance, share of voids. :func:`map_cloud` maps a cloud in memory; :func:`map_campaign` maps
files tile by tile, on all cores or a Dask cluster, and :func:`open_map` opens what it made. Nothing
depends on what lies beyond the search radius, nor on the tiles: the same points give the same bits.
"""

from __future__ import annotations

import base64
import io
import json
import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from scipy.ndimage import binary_fill_holes

from mmqa_lab import plots
from mmqa_lab._checks import check_choice, check_number, check_points, check_positive
from mmqa_lab.cloud import Cloud
from mmqa_lab.io import write_atomically
from mmqa_lab.maps.campaign import Grid, Outcome, corner, map_campaign, read_array, tile_name
from mmqa_lab.maps.tile import FIGURES, LAYERS, METRICS, evaluate_tile, variables
from mmqa_lab.spacing import exempt, said_coincident

if TYPE_CHECKING:
    import xarray as xr
    from numpy.typing import ArrayLike

__all__ = ["METRICS", "Outcome", "map_campaign", "map_cloud", "open_map", "summarise", "write_map"]
__dir__ = __all__.copy

ENDINGS = (".nc", ".zarr", ".tif")

IN_MEMORY = 2**27
"""Maps of fewer bytes than this are read once, larger ones piece by piece at each use."""

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)

DRAWN = {
    "density": "density (points/m²)",
    "d4": "d4 (mm)",
    "f": "f = d4/d1",
    "sigma_mad": r"$\sigma_\mathrm{MAD}$ (mm)",
    "void_share": "void share",
    "linear_point_distance": "linear point distance (mm)",
}
"""The variables to draw, the first four of those that a map has, and their labels."""

PIXELS = 600
"""Cells drawn along a side; larger maps are drawn by the means of blocks."""

SLIMMEST = 4
"""Length over width of a panel; maps of streets are longer, and stretched to that."""


def open_map(
    folder: str | os.PathLike, *, crs: str | None = None, rho0: float | None = None
) -> xr.Dataset:
    """Open the tiles of a run as one Dataset, from 128 MiB on a lazy one.

    Parameters
    ----------
    folder : path
        The run folder.
    crs : str, optional
        Coordinate reference system, where the files do not say: ``EPSG:25832`` or the like.
    rho0 : float, optional
        Density that is asked for, points per m2. The map then has ``exempt``: 1 where f does not
        matter (:func:`mmqa_lab.spacing.exempt`), 0 where it does, NaN where d4 is not measurable.

    Returns
    -------
    Dataset
        Dimensions ``layer``, ``y``, ``x`` (centres of the cells, m); variables with ``units`` and
        ``long_name``. Cells of tiles without a result contain NaN, and no points.

    Raises
    ------
    FileNotFoundError
        If the folder contains no run.
    ValueError
        If the coordinate reference system is unknown, or ``rho0`` is not above zero or given for a
        map without spacing.

    Examples
    --------
    >>> import tempfile
    >>> from mmqa_lab import maps, samples
    >>> run = {"cell": 0.5, "metrics": ("density",), "workers": 1}
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     done = maps.map_campaign([samples.path("road_patch")], folder, **run)
    ...     opened = open_map(folder).load()
    >>> opened["density"].attrs["units"], float(opened["x"][1] - opened["x"][0])
    ('m-2', 0.5)
    """
    folder = Path(folder)
    if not (folder / "run.json").is_file():
        raise FileNotFoundError(f"Invalid run folder {folder}: no run.json. Must contain a run.")
    record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    layers, tile = LAYERS[record["surface"]], record["tile"]
    low_x, low_y, high_x, high_y = record["cells"]
    i, j = low_x // tile, low_y // tile
    places = [[(k, m) for k in range(i, -(-high_x // tile))] for m in range(j, -(-high_y // tile))]
    current = map(tuple, record["tiles"])
    done = {place for place in current if (folder / "tiles" / tile_name(place)).is_file()}
    cut = (slice(low_y - j * tile, high_y - j * tile), slice(low_x - i * tile, high_x - i * tile))
    shape = (len(layers), tile, tile)
    arrays = {
        name: _blocks(folder, name, places, done, shape)[:, *cut]
        for name in variables(record["metrics"])
    }
    return _dataset(arrays, record, crs or record["crs"], rho0)


def map_cloud(
    cloud: Cloud | ArrayLike | pd.DataFrame | str | os.PathLike,
    *,
    cell: float = 0.5,
    surface: str = "local",
    metrics: Sequence[str] = METRICS,
    radius: float = 0.5,
    thickness: float = 0.1,
    void: float = 0.1,
    crs: str | None = None,
    rho0: float | None = None,
) -> xr.Dataset:
    """Evaluate every cell of a cloud in memory.

    Parameters
    ----------
    cloud : Cloud, array_like of shape (n, 3), DataFrame or path
        Metres.
    cell : float
        Side of the square cells, m; their borders lie at its multiples.
    surface : {"local", "horizontal"}
        Measure in the tangent plane of the points of each cube, with a layer for *level* surfaces,
        one for *upright* ones and the count of *other* points; or in plan.
    metrics : sequence of str
        Some of ``METRICS``.
    radius : float
        Farther neighbours do not count, m.
    thickness : float
        Points farther than this from a tangent plane are not its neighbours, m.
    void : float
        Side of the squares that count as void when no point lies in them, m; rounded so that a
        whole number of them fits a cell.
    crs, rho0
        See :func:`open_map`; ``crs`` is by default that of the cloud.

    Returns
    -------
    Dataset
        As :func:`open_map` gives it, to the same bits, but loaded.

    Raises
    ------
    ValueError
        If there is no point or an argument is out of its range.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(50) * 0.02, np.arange(50) * 0.04)
    >>> found = map_cloud(np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1))
    >>> dict(found.sizes), float(found["d4"].median().round(6))
    ({'layer': 3, 'y': 4, 'x': 2}, 40.0)
    """
    cloud = cloud if isinstance(cloud, Cloud) else Cloud(cloud)
    points = check_points(cloud)
    check_positive(cell, "cell", unit="m")
    grid = Grid(cell, 1, corner(points.min(axis=0), cell))
    local = points - grid.origin
    box = np.concatenate([local.min(axis=0)[:2], local.max(axis=0)[:2]])[None]
    low_x, low_y, high_x, high_y = map(int, grid.cells_of(box)[0] + [0, 0, 1, 1])
    choices = {"surface": surface, "radius": radius, "thickness": thickness, "void": void}
    window = (*grid.window((low_x, low_y))[:2], high_x - low_x, high_y - low_y)
    arrays = evaluate_tile(local, window, cell=cell, metrics=metrics, **choices)
    record = {"cell": cell, "cells": (low_x, low_y, high_x, high_y), **choices}
    return _dataset(arrays, record | {"resolution": cloud.resolution}, crs or cloud.crs, rho0)


def summarise(dataset: xr.Dataset, *, below: Mapping[str, float] | None = None) -> pd.DataFrame:
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
        says where f is exempt, the rows of f have ``exempt_share`` of their area, too. ``remarks``
        says where coordinates are too coarse for a figure, how much area without points lies
        between cells with points, how many points share their place, and which files were left out.

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
    names = [
        name for name in dataset.data_vars if name not in ("n", "coincident", "area", "exempt")
    ]
    check_thresholds(below, names)
    whole = dataset.transpose("layer", ...)
    figures = {name: whole[name].values for name in names}
    area, rows = whole["area"].values, []
    for k, layer in enumerate(whole["layer"].values):
        for name in names:
            known = np.isfinite(figures[name][k]) & (area[k] > 0)
            weights = area[k][known]
            about = {"layer": str(layer), "variable": name, "unit": dataset[name].attrs["units"]}
            about |= _quantiles(figures[name][k][known], weights, below.get(name, np.nan))
            if name == "f" and "exempt" in dataset and known.any():
                free = whole["exempt"].values[k][known]
                about["exempt_share"] = float((free * weights).sum() / weights.sum())
            rows.append(about)
    table = pd.DataFrame(rows)
    table = table[table["n"] > 0].reset_index(drop=True)
    general = [dataset.attrs.get("remarks", ""), _gaps(dataset), _shared(dataset)]
    coarse = _too_coarse(table, 1000 * dataset.attrs.get("resolution_m", np.nan))
    return table.assign(remarks=[" ".join(filter(None, [*general, one])) for one in coarse])


def write_map(dataset: xr.Dataset, path: str | os.PathLike) -> None:
    """Write a map as NetCDF (``.nc``), Zarr (``.zarr``) or GeoTIFF (``.tif``), whole or not at all.

    In a GeoTIFF each variable of each layer is a band that bears its name.

    Parameters
    ----------
    dataset : Dataset
        From :func:`open_map` or :func:`map_cloud`.
    path : path
        An existing file is replaced.

    Raises
    ------
    ValueError
        If the ending is another, or a GeoTIFF is asked for and there is no coordinate reference
        system.

    Examples
    --------
    >>> import tempfile
    >>> import xarray as xr
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_map(map_cloud(np.zeros((4, 3)), metrics=()), Path(folder) / "map.nc")
    ...     with xr.open_dataset(Path(folder) / "map.nc") as written:
    ...         counted = float(written["n"].sum())
    >>> counted
    4.0
    """
    path = Path(path)
    check_place(path, "spatial_ref" in dataset.coords)
    if path.suffix == ".tif":
        write_atomically(path, lambda temporary: _write_tif(dataset, temporary))
    elif path.suffix == ".nc":
        write_atomically(path, lambda temporary: _write_netcdf(dataset, temporary))
    else:
        _write_zarr(dataset, path)


def write_report(path, dataset, table, *, title, lines, problems):
    """Write a page of one file with figure, table, words and what went wrong; and a PNG."""
    from jinja2 import Environment, FileSystemLoader

    figure, picture = draw_map(dataset), io.BytesIO()
    figure.savefig(picture, format="png", dpi=200)
    environment = Environment(loader=FileSystemLoader(Path(__file__).parent), autoescape=True)
    text = environment.get_template("report.html.j2").render(
        title=title,
        lines=lines,
        problems=problems,
        picture=base64.b64encode(picture.getvalue()).decode(),
        table=table.to_html(index=False, float_format=lambda v: f"{v:.4g}", na_rep="", border=0),
    )
    write_atomically(path, text)
    write_atomically(path.with_suffix(".png"), figure.savefig)


@plots.style()
def draw_map(dataset):
    """Return a figure with a row for each layer and a panel for each figure of the map."""
    names = [name for name in DRAWN if name in dataset][:4]
    layers = [k for k in dataset["layer"].values if (dataset["area"].sel(layer=k) > 0).any()]
    steps = {axis: int(np.ceil(dataset.sizes[axis] / PIXELS)) for axis in ("x", "y")}
    small = dataset[[*names, "area"]]
    if max(steps.values()) > 1:
        small = small.coarsen(steps, boundary="pad").mean()
    rows, columns = max(len(layers), 1), max(len(names), 1)
    slim = dataset.sizes["y"] / dataset.sizes["x"]
    shape = float(np.clip(slim, 1 / SLIMMEST, SLIMMEST))
    height = min(rows * float(np.clip(178 / columns * shape, 45, 150)), 230)
    same = {"squeeze": False, "sharex": True, "sharey": True}
    figure, axes = plots.subplots(rows, columns, width="double", height_mm=height, **same)
    for row, layer in zip(axes, layers, strict=False):
        for ax, name in zip(row, names, strict=False):
            _draw_panel(small[name].sel(layer=layer), ax, DRAWN[name])
            ax.set_aspect("equal" if shape == slim else "auto")
        row[0].set_ylabel(f"{layer}\nnorthing (m)" + ", stretched" * (slim < shape))
    for ax in axes[-1]:
        ax.set_xlabel("easting (m)" + ", stretched" * (slim > shape))
    return figure


def check_thresholds(below, names):
    """Raise unless every threshold is a number for one of the variables ``names``."""
    for name, threshold in below.items():
        check_choice(name, "figure with a threshold", names)
        check_number(threshold, f"threshold of {name}", low=0)


def check_place(path, crs):
    """Raise where the ending is none of a map, or a GeoTIFF would have no place on earth."""
    check_choice(Path(path).suffix, "ending of the map", ENDINGS)
    if Path(path).suffix == ".tif" and not crs:
        raise ValueError(
            f"Invalid map {path}: no coordinate reference system in the files. "
            "Must be given, as EPSG:25832 or the like, or the map be .nc or .zarr."
        )


def _dataset(arrays, record, crs, rho0):
    """The arrays of a map with coordinates, units and meanings."""
    import xarray as xr

    cell = record["cell"]
    low_x, low_y, high_x, high_y = record["cells"]
    axes = {
        "layer": list(LAYERS[record["surface"]]),
        "y": ("y", (np.arange(low_y, high_y) + 0.5) * cell, {"units": "m"}),
        "x": ("x", (np.arange(low_x, high_x) + 0.5) * cell, {"units": "m"}),
    }
    data = {}
    for name, values in arrays.items():
        _, unit, meaning = FIGURES[name]
        data[name] = (("layer", "y", "x"), values, {"units": unit, "long_name": meaning})
    dataset = xr.Dataset(data, coords=axes)
    lengths = {f"{name}_m": record[name] for name in ("cell", "radius", "thickness", "void")}
    turned = "quadrants: east and north; on upright planes horizontal and steepest line"
    dataset.attrs = {**lengths, "surface": record["surface"], "axes": turned}
    dataset.attrs["resolution_m"] = record["resolution"]
    dataset.attrs["remarks"] = " ".join(record.get("remarks", []))
    if rho0 is not None:
        dataset = _with_exemption(dataset, check_positive(rho0, "rho0", unit="points per m2"))
    if not crs:
        return dataset
    import pyproj
    import rioxarray  # noqa: F401 - it adds the accessor

    known = pyproj.CRS(crs)
    known = known.sub_crs_list[0] if known.is_compound else known
    return dataset.rio.write_crs(known.to_wkt())


def _blocks(folder, name, places, done, shape):
    """A variable of all tiles as one array, lazy where the whole map would fill the memory."""
    kind = np.int64 if name in ("n", "coincident") else np.float64
    nothing = 0 if name in ("n", "coincident", "area") else np.nan
    empty, loaded, block = np.full(shape, nothing, kind), read_array, np.block
    if len(places) * len(places[0]) * empty.nbytes * len(FIGURES) > IN_MEMORY:
        import dask.array as da
        from dask import delayed

        load, block = delayed(read_array, pure=True), da.block

        def loaded(path, name):
            return da.from_delayed(load(path, name), shape, kind)

    paths = [
        [(place in done, str(folder / "tiles" / tile_name(place))) for place in row]
        for row in places
    ]
    return block([[loaded(path, name) if there else empty for there, path in row] for row in paths])


def _with_exemption(dataset, rho0):
    """The map and where f does not matter, since d1 and d4 are small enough."""
    import xarray as xr

    if "d1" not in dataset:
        raise ValueError(f"Invalid rho0 {rho0:g}: no spacing in the map. Must have d1 and d4.")
    lazily = {"dask": "parallelized", "output_dtypes": [bool], "kwargs": {"rho0": rho0}}
    found = xr.apply_ufunc(exempt, dataset["d1"] / 1000, dataset["d4"] / 1000, **lazily)
    about = {"units": "1", "long_name": "1 where f does not matter: d1, d4 <= sqrt(1 / rho0)"}
    found = found.where(dataset["d4"].notnull()).assign_attrs(about)
    return dataset.assign(exempt=found).assign_attrs(rho0_per_m2=rho0)


def _quantiles(values, area, threshold):
    """Count, area, quantiles and the share below a threshold."""
    weighted = {"weights": area, "method": "inverted_cdf"}
    found = np.quantile(values, QUANTILES, **weighted) if len(values) else [np.nan] * len(QUANTILES)
    names = [f"q{100 * q:02.0f}" for q in QUANTILES]
    measurable = len(values) and np.isfinite(threshold)
    share = float(area[values < threshold].sum() / area.sum()) if measurable else np.nan
    about = {"n": len(values), "area_m2": float(area.sum())} | dict(zip(names, found, strict=True))
    return about | {"threshold": threshold, "share_below": share}


def _gaps(dataset):
    """A sentence on the cells without points that others enclose."""
    if "n" not in dataset or not {"y", "x"} <= set(dataset["n"].dims):
        return ""
    seen = (dataset["n"].sum("layer") > 0).transpose("y", "x").values
    cells = int((binary_fill_holes(seen) & ~seen).sum())
    area = cells * dataset.attrs["cell_m"] ** 2
    text = (
        f"{cells} cells ({area:.4g} m2) without points lie between others: no figure counts them."
    )
    return text if cells else ""


def _shared(dataset):
    """A sentence on points that share their place, as those of a tile given twice."""
    if "coincident" not in dataset:
        return ""
    return said_coincident(int(dataset["coincident"].sum()), int(dataset["n"].sum()))


def _too_coarse(table, step_mm):
    """For each row a sentence where its median is too small for the step of the coordinates."""
    least = {"d1": 5 * step_mm, "d2": 5 * step_mm, "sigma_mad": step_mm}
    text = f"Coordinates are in steps of {step_mm:.3g} mm: too coarse for this figure."
    rows = zip(table["variable"], table["q50"], strict=True)
    return [text if middle < least.get(name, -np.inf) else "" for name, middle in rows]


def _draw_panel(values, ax, label):
    """One figure of one layer; colours between the 2nd and the 98th percentile."""
    shown = values.values
    known = shown[np.isfinite(shown)]
    low, high = np.percentile(known, [2, 98]) if len(known) else (0, 1)
    places = [values[axis].values for axis in ("x", "y")]
    widths = [
        np.ptp(centres) * len(centres) / max(len(centres) - 1, 1) or 1.0 for centres in places
    ]
    place = {"origin": "lower", "extent": (0, widths[0], 0, widths[1]), "interpolation": "nearest"}
    image = ax.imshow(shown, vmin=low, vmax=high, **place)
    ax.figure.colorbar(image, ax=ax, label=label, location="top", shrink=0.9)


def _write_tif(dataset, path):
    """All layers and variables as bands, north up, block by block."""
    import threading

    import xarray as xr

    names = [(layer, name) for layer in dataset["layer"].values for name in dataset.data_vars]
    bands = [dataset[name].sel(layer=layer).drop_vars("layer") for layer, name in names]
    stack = xr.concat([band.astype(np.float64) for band in bands], dim="band")
    stack = stack.isel(y=slice(None, None, -1)).rio.write_crs(dataset.rio.crs)
    stack.attrs = {"long_name": tuple(f"{layer} {name}" for layer, name in names)}
    stack.rio.write_nodata(np.nan, inplace=True)
    choices = {"tiled": True, "compress": "deflate", "BIGTIFF": "IF_SAFER"}
    stack.rio.to_raster(path, driver="GTiff", lock=threading.Lock(), **choices)


def _write_netcdf(dataset, path):
    """Compressed NetCDF-4, chunk by chunk."""
    packed = {name: {"zlib": True} for name in dataset.data_vars}
    for name, chunks in ((name, dataset[name].chunks) for name in packed):
        if chunks:
            packed[name]["chunksizes"] = tuple(map(max, chunks))
    dataset.to_netcdf(path, engine="netcdf4", encoding=packed)


def _write_zarr(dataset, path):
    """A Zarr folder, written beside and renamed."""
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        # Zarr wants chunks of one size; those at the borders are cut by the extent of the points.
        dataset.chunk(layer=-1, y=512, x=512).to_zarr(temporary, mode="w", zarr_format=2)
        if path.exists():
            shutil.rmtree(path)
        os.replace(temporary, path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
