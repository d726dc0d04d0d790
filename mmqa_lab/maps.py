"""Maps of quality figures in square cells, for a cloud in memory or for a campaign in tiles.

Each cell has the figures of a chart: density, spacings d1..d4, f, and sigma_MAD about the plane of
its points. :func:`map_cloud` maps a cloud. :func:`map_campaign` maps files tile by tile on Dask,
and :func:`open_map` opens the map. The figures do not depend on the size of the tiles.
``dataset["f"].plot()`` draws a figure.
"""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_choice, check_file, check_points, check_positive, check_same_crs
from mmqa_lab.io import LAS_ENDINGS, iterate_cloud, write_atomically
from mmqa_lab.planes import CONSISTENT_SCALE
from mmqa_lab.spacing import quadrant_distances

if TYPE_CHECKING:
    import xarray as xr
    from numpy.typing import ArrayLike

__all__ = ["map_campaign", "map_cloud", "open_map", "summarise", "write_map"]

FIGURES = {
    "n": ("1", "points in the cell"),
    "density": ("m-2", "points per area of the cell"),
    "d1": ("mm", "median distance to the nearest of the nearest points in four quadrants"),
    "d2": ("mm", "median distance to the second of them"),
    "d3": ("mm", "median distance to the third of them"),
    "d4": ("mm", "median distance to the farthest of them"),
    "f": ("1", "inhomogeneity d4 / d1"),
    "incomplete_share": ("1", "share of points with an empty quadrant within the radius"),
    "sigma_mad": ("mm", "1.4826 x median absolute deviation from the plane of the cell's points"),
}
"""Variables of a map with their units and meanings."""

# Fewest points for the sigma_MAD of a cell. A plane fits fewer points too closely.
MINIMUM = 10

# Most tiles in the rectangle around a campaign: 11 km x 11 km for cells of half a metre.
MOST_TILES = 30_000

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


def map_cloud(points: ArrayLike, *, cell: float = 0.5, radius: float = 0.5) -> xr.Dataset:
    """Evaluate every cell of a cloud.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Easting, northing and height, m.
    cell : float
        Side of the square cells, m. The borders lie at multiples of the side.
    radius : float
        Largest distance of a neighbour in plan, m.

    Returns
    -------
    Dataset
        Dimensions ``y``, ``x`` (centres of the cells, m), and the variables of ``FIGURES`` with
        their units; NaN if not measurable.

    Raises
    ------
    ValueError
        If the cloud is empty, or if ``cell`` or ``radius`` is not above zero.

    References
    ----------
    Pfeifer et al. 2021, section 3.3. doi:10.3390/rs13020237

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(50) * 0.02, np.arange(50) * 0.04)
    >>> found = map_cloud(np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1))
    >>> dict(found.sizes), float(found["d4"].median().round(6))
    ({'y': 4, 'x': 2}, 40.0)
    """
    points = check_points(points)
    cell, radius = check_positive(cell, "cell", unit="m"), check_positive(radius, "radius")
    plan = points[:, :2]
    low, high = (np.floor(end / cell).astype(int) for end in (plan.min(axis=0), plan.max(axis=0)))
    inner = np.ones(len(points), dtype=bool)
    return _evaluated(points - np.append(low, 0) * cell, low, high + 1 - low, cell, radius, inner)


def _evaluated(local, first, size, cell, radius, inner):
    """The Dataset of cells, from points with the corner of the first cell as origin."""
    import xarray as xr

    column, row = np.floor(local[inner, :2] / cell).astype(int).T
    order = np.argsort(row * size[0] + column, kind="stable")
    cells, starts = np.unique((row * size[0] + column)[order], return_index=True)
    counts = np.diff(np.append(starts, len(order)))
    group = np.repeat(np.arange(len(cells)), counts)
    distances = quadrant_distances(local[:, :2], radius=radius, of=inner)[inner][order]
    found = {"n": counts, "density": counts / cell**2}
    for k in range(4):
        found[f"d{k + 1}"] = 1000 * _medians(distances[:, k], group)
    with np.errstate(invalid="ignore", divide="ignore"):
        found["f"] = np.where(found["d1"] > 0, found["d4"] / found["d1"], np.nan)
    missing = np.isnan(distances[:, 3]).astype(float)
    found["incomplete_share"] = np.add.reduceat(missing, starts) / counts
    deviations = _deviations(local[inner][order], starts, counts, group)
    off = np.abs(deviations - _medians(deviations, group)[group])
    sigma = 1000 * CONSISTENT_SCALE * _medians(off, group)
    found["sigma_mad"] = np.where(counts >= MINIMUM, sigma, np.nan)
    data = {}
    for name, (unit, meaning) in FIGURES.items():
        whole = np.full(size[0] * size[1], 0 if name == "n" else np.nan)
        whole[cells] = found[name]
        about = {"units": unit, "long_name": meaning}
        data[name] = (("y", "x"), whole.reshape(size[1], size[0]), about)
    x, y = ((first[k] + np.arange(size[k]) + 0.5) * cell for k in (0, 1))
    axes = {"y": ("y", y, {"units": "m"}), "x": ("x", x, {"units": "m"})}
    return xr.Dataset(data, coords=axes, attrs={"cell_m": cell, "radius_m": radius})


def _medians(values, group):
    """Median of each group without its NaN; NaN for a group without numbers."""
    return pd.Series(values).groupby(group).median().to_numpy()


def _deviations(points, starts, counts, group):
    """Signed distances from the regression planes of the groups, m."""
    centres = np.add.reduceat(points, starts) / counts[:, None]
    centred = points - centres[group]
    scatter = np.add.reduceat(centred[:, :, None] * centred[:, None, :], starts)
    normals = np.linalg.eigh(scatter)[1][:, :, 0]
    return np.einsum("ni,ni->n", centred, normals[group])


def map_campaign(
    paths: Sequence[str | os.PathLike],
    folder: str | os.PathLike,
    *,
    cell: float = 0.5,
    radius: float = 0.5,
    tile: int = 128,
    client: Any = None,
) -> Path:
    """Map cloud files tile by tile on Dask; tiles on disk are not computed again.

    Parameters
    ----------
    paths : sequence of path
        Cloud files, and folders of LAS, LAZ and COPC files, all in the same coordinate system.
    folder : path
        Folder of this run. A run that was stopped continues with the missing tiles.
    cell, radius : float
        See :func:`map_cloud`, m.
    tile : int
        Cells along the side of a tile.
    client : distributed.Client, optional
        A cluster that can read the same paths; by default processes of this machine.

    Returns
    -------
    Path
        The folder, for :func:`open_map`.

    Raises
    ------
    ValueError
        If the coordinate systems of the files differ, if the files contain no point or too wide an
        area, or if the folder belongs to a run with other files or parameters.
    """
    import dask
    from tqdm.dask import TqdmCallback

    folder, paths = Path(folder), _files(paths)
    cell, radius = check_positive(cell, "cell", unit="m"), check_positive(radius, "radius")
    files = [[str(path), path.stat().st_size, path.stat().st_mtime_ns] for path in paths]
    run = {"cell": cell, "radius": radius, "tile": tile, "files": files}
    kept = _record(folder)
    if kept and {name: kept[name] for name in run} != run:
        raise ValueError(f"Invalid folder {folder}: of other files or parameters. Must be empty.")
    if not kept:
        kept = run | _sorted_points(paths, folder, cell * tile)
        write_atomically(folder / "run.json", json.dumps(kept, indent=1))
    places = [tuple(place) for place in kept["tiles"]]
    missing = [place for place in places if not _tile(folder, place).is_file()]
    tasks = [dask.delayed(_map_tile)(folder, place, kept) for place in missing]
    if client is not None:
        client.gather(client.compute(tasks))
    else:
        with TqdmCallback(desc="tiles", disable=None, leave=False):  # none without a terminal
            dask.compute(tasks, scheduler="processes")
    return folder


def _files(paths):
    """The cloud files of paths and of folders."""
    found = []
    for path in map(Path, paths):
        inside = sorted(file for file in path.rglob("*") if file.suffix.lower() in LAS_ENDINGS)
        found += inside if path.is_dir() else [check_file(path, "cloud")]
    if not found:
        raise ValueError(f"Invalid folder {paths[0]}: no cloud. Must contain .las or .laz files.")
    return found


def _record(folder):
    """The record of a run folder; an empty dict without a record."""
    file = folder / "run.json"
    return json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}


def _tile(folder, place):
    """The file of a tile's figures."""
    return folder / f"tile_{place[0]}_{place[1]}.nc"


def _sorted_points(paths, folder, side):
    """Write the points of each tile to a file; return the tiles, origin and coordinate system."""
    folder.mkdir(parents=True, exist_ok=True)
    for left in folder.glob("*.xyz"):  # of a run that was stopped while sorting
        left.unlink()
    origin = crs = None
    places, without = set(), set()
    for path in paths:
        for part in iterate_cloud(path, columns=()):
            if origin is None:
                origin = (np.floor(part.points.min(axis=0) / side) * side).tolist()
            crs = crs or part.crs
            check_same_crs(str(path), part.crs, "first cloud", crs)
            without |= {str(path)} if part.crs is None else set()
            local = part.points - origin
            own = np.floor(local[:, :2] / side).astype(int)
            places |= set(map(tuple, np.unique(own, axis=0).tolist()))
            _check_extent(places, side)
            for place in np.unique(own, axis=0):
                with open(folder / f"{place[0]}_{place[1]}.xyz", "ab") as file:
                    file.write(local[(own == place).all(axis=1)].tobytes())
    if not places:
        raise ValueError(f"Invalid clouds {', '.join(map(str, paths))}: no point. Must have one.")
    if crs is not None and without:
        listed = ", ".join(sorted(without))
        warnings.warn(f"No coordinate system in {listed}: taken for {crs.name}.", stacklevel=3)
    crs = None if crs is None else crs.to_wkt()
    return {"tiles": sorted(places), "origin": origin, "crs": crs}


def _check_extent(places, side):
    """Refuse clouds that are too wide, such as clouds in millimetres."""
    spans = np.ptp(np.array(list(places)), axis=0) + 1
    if spans.prod() > MOST_TILES:
        wide = " x ".join(f"{span * side / 1000:.0f} km" for span in spans)
        raise ValueError(f"Invalid clouds over {wide}. Must lie in {MOST_TILES} tiles, in metres.")


def _map_tile(folder, place, run):
    """Evaluate a tile with the points around it, and write its file."""
    side, cell, radius = run["tile"] * run["cell"], run["cell"], run["radius"]
    parts, corner = [], np.array([*place, 0]) * side
    low, high = corner[:2] - radius, corner[:2] + side + radius
    reach = int(np.ceil(radius / side))
    for step in np.ndindex(2 * reach + 1, 2 * reach + 1):
        near = np.array(place) + step - reach
        file = folder / f"{near[0]}_{near[1]}.xyz"
        if file.is_file():
            points = np.fromfile(file).reshape(-1, 3)
            parts.append(points[((points[:, :2] >= low) & (points[:, :2] <= high)).all(axis=1)])
    points = np.concatenate(parts)
    inner = (np.floor(points[:, :2] / side) == place).all(axis=1)
    first = np.round((np.array(run["origin"][:2]) + corner[:2]) / cell).astype(int)
    dataset = _evaluated(points - corner, first, (run["tile"],) * 2, cell, radius, inner)
    write_atomically(_tile(folder, place), lambda path: dataset.to_netcdf(path, engine="scipy"))


def open_map(folder: str | os.PathLike) -> xr.Dataset:
    """Open the map of a campaign, joined from its tiles.

    Parameters
    ----------
    folder : path
        Folder of :func:`map_campaign`.

    Returns
    -------
    Dataset
        The map as from :func:`map_cloud`, with the coordinate system of the files.

    Raises
    ------
    FileNotFoundError
        If the folder contains no run.
    """
    import xarray as xr

    run = _record(Path(folder))
    if not run:
        raise FileNotFoundError(f"Invalid run folder {folder}: no run.json. Must contain a run.")
    files = [_tile(Path(folder), place) for place in run["tiles"]]
    tiles = [xr.load_dataset(file, engine="scipy") for file in files if file.is_file()]
    whole = xr.combine_by_coords(tiles, combine_attrs="override")
    full, cell = {}, run["cell"]
    for axis, other in ("yx", "xy"):  # from the first to the last place with points
        places = whole[axis].values[(whole["n"] > 0).any(other)]
        full[axis] = places[0] + cell * np.arange(round((places[-1] - places[0]) / cell) + 1)
    whole = whole.reindex(full, method="nearest", tolerance=cell / 4)
    whole["n"] = whole["n"].fillna(0)
    return placed(whole, run["crs"]) if run["crs"] else whole


def placed(dataset, crs):
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
    names = [name for name in FIGURES if name != "n"]
    cells = dataset[names].to_dataframe()[names]
    table = cells.quantile(QUANTILES).T.set_axis([f"q{100 * q:02.0f}" for q in QUANTILES], axis=1)
    table.insert(0, "n", cells.count())
    table.insert(0, "unit", [FIGURES[name][0] for name in names])
    return table.rename_axis("figure").reset_index()


def write_map(dataset: xr.Dataset, path: str | os.PathLike) -> None:
    """Write a map as NetCDF (``.nc``) or GeoTIFF (``.tif``, a band for each figure).

    Parameters
    ----------
    dataset : Dataset
        From :func:`map_cloud` or :func:`open_map`.
    path : path
        The file to write.

    Raises
    ------
    ValueError
        If the ending is neither of these, or if a GeoTIFF would lack a coordinate system.
    """
    path = Path(path)
    if check_ending(path) == ".nc":
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


def check_ending(path):
    """Return the ending of a map's file, or raise an error with the possible endings."""
    return check_choice(Path(path).suffix, "ending of the map", (".nc", ".tif"))
