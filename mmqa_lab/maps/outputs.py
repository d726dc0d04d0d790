"""A run's tiles as one xarray Dataset, and that as NetCDF, Zarr or GeoTIFF.

Everything is lazy: however large the map, only a few tiles are in memory at a time.
"""

import json
import os
import shutil
from pathlib import Path

import numpy as np

from mmqa_lab._checks import check_choice, check_positive
from mmqa_lab.io import write_atomically
from mmqa_lab.maps.files import read_array
from mmqa_lab.maps.run import tile_name
from mmqa_lab.maps.tile import LAYERS, UNITS, VARIABLES

ENDINGS = (".nc", ".zarr", ".tif")

MEANINGS = {
    "n": "points in the cell",
    "area": "area of the surface in the cell",
    "density": "points per area of the surface",
    "linear_point_distance": "sqrt(1 / density)",
    "d1": "median distance to the nearest of the nearest points in four quadrants",
    "d2": "median distance to the second of the nearest points in four quadrants",
    "d3": "median distance to the third of the nearest points in four quadrants",
    "d4": "median distance to the farthest of the nearest points in four quadrants",
    "incomplete_share": "share of points with an empty quadrant within the search radius",
    "f": "inhomogeneity d4 / d1",
    "sigma_mad": "1.4826 x median absolute deviation of the residuals from the plane",
    "void_share": "share of the squares on the surface without a point",
}


def open_map(folder, *, crs=None, rho0=None):
    """Open the tiles of a run as one lazy Dataset.

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
        ``long_name``. Cells of tiles without a result hold NaN, and no points.

    Raises
    ------
    FileNotFoundError
        If the folder holds no run.
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
    import xarray as xr

    folder = Path(folder)
    if not (folder / "run.json").is_file():
        raise FileNotFoundError(f"Invalid run folder {folder}: no run.json. Must hold a run.")
    record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    names = ["n", "area", *(name for key in record["metrics"] for name in VARIABLES[key])]
    layers, cell, tile = LAYERS[record["surface"]], record["cell"], record["tile"]
    low_x, low_y, high_x, high_y = record["cells"]
    i, j = low_x // tile, low_y // tile
    places = [[(k, m) for k in range(i, -(-high_x // tile))] for m in range(j, -(-high_y // tile))]
    current = map(tuple, record["tiles"])
    done = {place for place in current if (folder / "tiles" / tile_name(place)).is_file()}
    cut = (slice(low_y - j * tile, high_y - j * tile), slice(low_x - i * tile, high_x - i * tile))
    variables = {}
    for name in names:
        values = _blocks(folder, name, places, done, (len(layers), tile, tile))
        about = {"units": UNITS[name], "long_name": MEANINGS[name]}
        variables[name] = (("layer", "y", "x"), values[:, *cut], about)
    axes = {
        "layer": list(layers),
        "y": ("y", (np.arange(low_y, high_y) + 0.5) * cell, {"units": "m"}),
        "x": ("x", (np.arange(low_x, high_x) + 0.5) * cell, {"units": "m"}),
    }
    kept = ("cell", "surface", "radius", "thickness", "void")
    about = {f"{name}_m" if name != "surface" else name: record[name] for name in kept}
    about["axes"] = "quadrants: east and north; on upright planes horizontal and steepest line"
    dataset = xr.Dataset(variables, coords=axes, attrs=about)
    if rho0 is not None:
        dataset = _with_exemption(dataset, check_positive(rho0, "rho0", unit="points per m2"))
    return _referenced(dataset, crs or record["crs"])


def _with_exemption(dataset, rho0):
    """The map and where f does not matter, since d1 and d4 are small enough."""
    import xarray as xr

    from mmqa_lab.spacing import exempt

    if "d1" not in dataset:
        raise ValueError(f"Invalid rho0 {rho0:g}: no spacing in the map. Must have d1 and d4.")
    lazily = {"dask": "parallelized", "output_dtypes": [bool], "kwargs": {"rho0": rho0}}
    found = xr.apply_ufunc(exempt, dataset["d1"] / 1000, dataset["d4"] / 1000, **lazily)
    about = {"units": "1", "long_name": "1 where f does not matter: d1, d4 <= sqrt(1 / rho0)"}
    found = found.where(dataset["d4"].notnull()).assign_attrs(about)
    return dataset.assign(exempt=found).assign_attrs(rho0_per_m2=rho0)


def write_map(dataset, path):
    """Write a map as NetCDF (``.nc``), Zarr (``.zarr``) or GeoTIFF (``.tif``), whole or not at all.

    In a GeoTIFF each variable of each layer is a band that bears its name.

    Parameters
    ----------
    dataset : Dataset
        From :func:`open_map`.
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
    >>> cells = xr.DataArray(np.ones((1, 2, 2)), dims=("layer", "y", "x")).chunk()
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_map(cells.to_dataset(name="n"), Path(folder) / "map.nc")
    ...     with xr.open_dataset(Path(folder) / "map.nc") as written:
    ...         counted = float(written["n"].sum())
    >>> counted
    4.0
    """
    path = Path(path)
    check_ending(path)
    if path.suffix == ".tif":
        check_place(path, "spatial_ref" in dataset.coords)
        write_atomically(path, lambda temporary: _write_tif(dataset, temporary))
    elif path.suffix == ".nc":
        write_atomically(path, lambda temporary: _write_netcdf(dataset, temporary))
    else:
        _write_zarr(dataset, path)


def check_ending(path):
    """Raise unless the file's ending is one of ``ENDINGS``."""
    check_choice(Path(path).suffix, "ending of the map", ENDINGS)


def check_crs(crs):
    """Return the coordinate reference system, or raise where it is unknown."""
    import pyproj

    try:
        return pyproj.CRS(crs)
    except pyproj.exceptions.CRSError:
        raise ValueError(f"Invalid crs {crs!r}. Must be known, like EPSG:25832.") from None


def _blocks(folder, name, places, done, shape):
    """A variable of all tiles as one lazy array."""
    import dask.array as da
    from dask import delayed

    kind = np.int64 if name == "n" else np.float64
    empty = da.full(shape, 0 if name in ("n", "area") else np.nan, dtype=kind, chunks=shape)
    load = delayed(read_array, pure=True)

    def block(place):
        if place not in done:
            return empty
        return da.from_delayed(load(str(folder / "tiles" / tile_name(place)), name), shape, kind)

    return da.block([[block(place) for place in row] for row in places])


def _referenced(dataset, crs):
    """The dataset with its coordinate reference system, where there is one."""
    if not crs:
        return dataset
    import rioxarray  # noqa: F401 - it adds the accessor

    known = check_crs(crs)
    if known.is_compound:
        known = known.sub_crs_list[0]
    return dataset.rio.write_crs(known.to_wkt())


def check_place(path, crs):
    """Raise where a GeoTIFF would have no place on earth: without a coordinate reference system."""
    if Path(path).suffix == ".tif" and not crs:
        raise ValueError(
            f"Invalid map {path}: no coordinate reference system in the files. "
            "Must be given, as EPSG:25832 or the like, or the map be .nc or .zarr."
        )


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
    encoding = {
        name: {"zlib": True, "chunksizes": tuple(max(size) for size in values.chunks)}
        for name, values in dataset.data_vars.items()
    }
    dataset.to_netcdf(path, engine="netcdf4", encoding=encoding)


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
