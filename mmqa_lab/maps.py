"""Maps of quality figures in square cells, for a cloud in memory or for a campaign in tiles.

Each cell has the figures of a chart: density, spacings d1..d4, f, the empty-space distance e95, and
sigma_MAD about the plane of its points. :func:`map_cloud` maps a cloud. :func:`map_campaign` maps
files tile by tile on Dask, and :func:`open_map` opens the map. The figures do not depend on the
size of the tiles. ``dataset["f"].plot()`` draws a figure.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import sys
import warnings
from collections.abc import Sequence
from contextlib import nullcontext
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from mmqa_lab._checks import (
    check_choice,
    check_count,
    check_file,
    check_points,
    check_positive,
    check_same_crs,
    check_upright,
)
from mmqa_lab.chart_cloud import COARSE_MM, PAIRS, is_below_step
from mmqa_lab.cloud import ON_BORDER, cells_of, extent, sort_into_cells, unit_remarks
from mmqa_lab.io import LAS_ENDINGS, iterate_cloud, own_folder, write_atomically
from mmqa_lab.planes import CONSISTENT_SCALE
from mmqa_lab.spacing import STEPS, quadrant_distances

if TYPE_CHECKING:
    import xarray as xr
    from numpy.typing import ArrayLike

__all__ = ["FIGURES", "map_campaign", "map_cloud", "open_map", "placed", "summarise", "write_map"]

FIGURES = {
    "n": ("1", "points in the cell"),
    "density": ("m-2", "points per area of the cell"),
    "d1": ("mm", "median distance to the nearest of the nearest points in four quadrants"),
    "d2": ("mm", "median distance to the second of them"),
    "d3": ("mm", "median distance to the third of them"),
    "d4": ("mm", "median distance to the farthest of them"),
    "f": ("1", "inhomogeneity d4 / d1"),
    "e95": ("mm", "95 % of the places in the cell lie within this distance of a point"),
    "incomplete_share": ("1", "share of points with an empty quadrant within the radius"),
    "sigma_mad": ("mm", "1.4826 x median absolute deviation from the plane of the cell's points"),
    "coincident": ("1", "points in the place of another one: they raise the density"),
}
"""Variables of a map with their units and meanings."""

ENDINGS = (".nc", ".tif")
"""Endings of maps: NetCDF and GeoTIFF."""

# Fewest points for the sigma_MAD of a cell. A plane fits fewer points too closely.
MINIMUM = 10

# Places of a cell from which the nearest point is sought for e95: as evenly as in ``spacing``. The
# last but one stands for 95 % of them.
CELL_PLACES = np.outer(np.arange(1, 31), STEPS) % 1

# Most cells in the rectangle of a map, 8 GB: 5 km x 5 km for cells of half a metre.
MOST_MAP_CELLS = 1e8

# Points are sorted into tiles of this side, m, which are joined until one has so many points.
TILE_M, ENOUGH = 4.0, 100_000

# A bar on a terminal only, of a size of its own: some terminals say that theirs is zero.
BAR = {"disable": None, "leave": False, "ncols": 80, "nrows": 24}

# The folder of a campaign's own within a run folder, and the ending of its working files.
OWN, WORKING = "mmqa_map", ".mmqa_points"

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


def map_cloud(points: ArrayLike, *, cell: float = 0.5, radius: float = 0.5) -> xr.Dataset:
    """Evaluate every cell of a cloud.

    Parameters
    ----------
    points : Cloud or array_like, shape (n, 3)
        Easting, northing and height, m.
    cell : float
        Side of the square cells, m. The borders lie at multiples of the side.
    radius : float
        Largest distance of a neighbour in plan, m; one at this distance counts.

    Returns
    -------
    Dataset
        Dimensions ``y``, ``x`` (centres of the cells, m), and the variables of ``FIGURES`` with
        their units; NaN if not measurable. The attribute ``remarks`` tells what speaks against
        them.

    Raises
    ------
    ValueError
        If the cloud is empty or too wide, or if ``cell`` or ``radius`` is not above zero.

    See Also
    --------
    map_campaign : the same for files of any size.

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
    step, crs = getattr(points, "resolution", np.nan), getattr(points, "crs", None)
    points = check_points(points)
    cell, radius = check_positive(cell, "cell", unit="m"), check_positive(radius, "radius")
    _check_extent(points, cell)
    index = cells_of(points[:, :2], cell)
    table = _evaluated(points, index, np.ones(len(points), dtype=bool), cell, radius)
    remarks = unit_remarks(points, crs=crs)
    return _dataset(table, {"cell": cell, "radius": radius, "step": step, "remarks": remarks})


def _check_extent(points, cell):
    """Refuse clouds that are too wide, such as clouds in millimetres."""
    size = np.ptp(extent(points), axis=0)[:2]
    if np.prod(size / cell + 1) > MOST_MAP_CELLS:
        wide = " x ".join(f"{length / 1000:.4g} km" for length in size)
        most = f"{MOST_MAP_CELLS / 1e6:.0f} million cells of {cell} m"
        raise ValueError(f"Invalid clouds over {wide}. Must lie in {most}, in metres.")


def _evaluated(points, index, inner, cell, radius):
    """A row for each cell with points: its place and its figures, shape (m, 2 + figures).

    ``index`` has the points' cells. Points that are not ``inner`` only count as neighbours.
    """
    order, starts, cells = sort_into_cells(index[inner], 1)
    starts, counts = starts[:-1], np.diff(starts)
    group = np.repeat(np.arange(len(cells)), counts)
    rows, radius = np.flatnonzero(inner)[order], radius * (1 + ON_BORDER)
    local = points[:, :2] - cells[0] * cell
    distances = quadrant_distances(local, radius=radius, of=inner)
    distances, own = (np.take(one, rows, axis=0).T.copy() for one in (distances, points))
    deviations = _deviations(own, starts, counts, group)
    *d, middle = _medians([*distances, deviations], group)
    (off,) = _medians([np.abs(deviations - middle[group])], group)
    sigma = np.where(counts >= MINIMUM, CONSISTENT_SCALE * off, np.nan)
    missing = np.add.reduceat(np.isnan(distances[3]).astype(float), starts)
    same = np.add.reduceat(_coincident(own), starts)
    e95 = _empty_space(local, (cells - cells[0])[:, None] + CELL_PLACES, cell, radius)
    *d_mm, e95_mm, sigma_mm = (1000 * length for length in (*d, e95, sigma))
    figures = counts, counts / cell**2, *d_mm, d[3] / d[0], e95_mm, missing / counts
    return np.column_stack([cells, *figures, sigma_mm, same])


def _medians(rows, group):
    """Median of each group in each row without its NaN; NaN for a group without numbers."""
    return pd.DataFrame(np.transpose(rows)).groupby(group).median().to_numpy().T


def _empty_space(xy, places, cell, radius):
    """e95 of cells with places, shape (cells, places, 2), m; NaN beyond the radius."""
    from scipy.spatial import cKDTree

    tree = cKDTree(xy, leafsize=64, balanced_tree=False, compact_nodes=False)
    away = tree.query(cell * places, [1], distance_upper_bound=radius)[0]
    e95 = np.partition(away[:, :, 0], -2, axis=1)[:, -2]
    return np.where(np.isfinite(e95), e95, np.nan)


def _deviations(xyz, starts, counts, group):
    """Signed distances from the regression planes of the groups, m."""
    local = xyz - xyz[:, starts][:, group]
    local -= (np.add.reduceat(local, starts, axis=1) / counts)[:, group]
    squares = [np.add.reduceat(a * b, starts) for a in local for b in local]
    normals = np.linalg.eigh(np.reshape(squares, (3, 3, -1)).T)[1][:, :, 0]
    return (local * normals.T[:, group]).sum(axis=0)


def _coincident(xyz):
    """1 for a point with the three coordinates of another one, else 0."""
    x, y, z = (xyz + 0.0).view(np.uint64)  # of zeros both signs are one place
    key = x * np.uint64(3**20) + y * np.uint64(5**20) + z * np.uint64(7**20)
    listed = np.sort(key)
    twice = listed[1:][listed[1:] == listed[:-1]]
    return np.isin(key, twice).astype(int) if len(twice) else np.zeros(len(key), dtype=int)


def _dataset(table, run):
    """The Dataset of rows of :func:`_evaluated`."""
    import xarray as xr

    cells, cell = table[:, :2].astype(np.int64), run["cell"]
    first = cells.min(axis=0)
    columns, rows = (cells - first).T
    data = {}
    for (name, (unit, meaning)), values in zip(FIGURES.items(), table.T[2:], strict=True):
        whole = np.full((rows.max() + 1, columns.max() + 1), 0 if name == "n" else np.nan)
        whole[rows, columns] = values
        data[name] = (("y", "x"), whole, {"units": unit, "long_name": meaning})
    places = {"y": first[1] + np.arange(len(whole)), "x": first[0] + np.arange(len(whole[0]))}
    step_mm = 1000 * run["step"]
    below = is_below_step(data["d1"][1], step_mm)
    data["f"][1][below] = np.nan
    axes = {name: (name, (place + 0.5) * cell, {"units": "m"}) for name, place in places.items()}
    medians = pd.DataFrame(table[:, 2:], columns=list(FIGURES)).median()
    same = np.nansum(data["coincident"][1]), data["n"][1].sum()
    remarks = [*run["remarks"], *_remarks(medians, step_mm, int(below.sum()), *same)]
    about = {"cell_m": cell, "radius_m": run["radius"], "remarks": " ".join(remarks)}
    return xr.Dataset(data, coords=axes, attrs=about)


def _remarks(medians, step_mm, below, same, count):
    """What speaks against the figures of a map."""
    d1, d2, sigma = medians[["d1", "d2", "sigma_mad"]]
    coarse = [f"sigma_MAD {sigma:.3g} mm"] * (step_mm > sigma)
    coarse += [f"d1 {d1:.3g} mm"] * (step_mm > d1 / 5)
    steps = f"Coordinates are in steps of {step_mm:.3g} mm: too coarse for {' and '.join(coarse)}."
    pairs = f"d2 is {d2 / d1:.0f} times d1: points come in pairs, as from two returns of a pulse"
    share = f"{same:.0f} points ({100 * same / count:.3g} %) share their place with another"
    remarks = (
        (step_mm > COARSE_MM and coarse, steps),
        (below, f"f is not measured in {below} cells: points lie nearer than the steps."),
        (d2 > PAIRS * d1, f"{pairs} or from a repeated scan; density and f count both."),
        (same, f"{share}: they raise the density."),
    )
    return [sentence for holds, sentence in remarks if holds]


def map_campaign(
    paths: Sequence[str | os.PathLike],
    folder: str | os.PathLike,
    *,
    cell: float = 0.5,
    radius: float = 0.5,
    tile: int = 128,
    client: Any = None,
) -> Path:
    """Map cloud files of any size tile by tile on Dask; tiles on disk are not computed again.

    Dask gives the files, and then the tiles, to its workers: threads of this process, or those of a
    cluster. Each file is read once; its points, sorted into tiles, take 24 bytes each on disk until
    the map is done. Then each tile is evaluated with the points around it.

    Parameters
    ----------
    paths : sequence of path
        Cloud files, and folders of LAS, LAZ and COPC files, all in the same coordinate system. A
        file that is given twice, or with the points of another one, counts once.
    folder : path
        Folder of this run. A run that was stopped continues with the missing tiles. All its files
        lie in the folder ``mmqa_map`` within; others are left as they are.
    cell, radius : float
        See :func:`map_cloud`, m.
    tile : int
        Largest side, in cells, of the tiles in which points lie on disk. Neighbours of few points
        are evaluated together. The figures do not depend on it.
    client : distributed.Client, optional
        A cluster whose workers reach the same paths and this folder, such as
        ``Client("tcp://address:8786")``, or ``Client()`` for processes of this machine. A tile
        whose worker is lost goes to another one.

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
    paths = _files(paths)
    cell, radius = check_positive(cell, "cell", unit="m"), check_positive(radius, "radius")
    tile = min(check_count(tile, "tile"), max(1, round(TILE_M / cell)))
    files = [[str(path), path.stat().st_size, path.stat().st_mtime_ns] for path in paths]
    run = {"cell": cell, "radius": radius, "tile": tile, "files": files}
    own, kept = Path(folder).resolve() / OWN, _record(folder)
    if kept and {name: kept.get(name) for name in run} != run:
        found = f"{OWN} in it is a map of other files or parameters"
        raise ValueError(f"Invalid folder {folder}: {found}. Must be another, or without {OWN}.")
    if kept:
        count = len(kept["tiles"])
        there = count - len(_missing(own, kept))
        if there:
            print(f"{folder}: {there} of {count} tiles are there.", file=sys.stderr)
        if there == count:
            return Path(folder)
    with own_folder(own):
        try:
            tasks = [(own, file, cell, tile, bool(kept)) for file in files]
            with warnings.catch_warnings(record=True) as said:  # by threads of this process
                warnings.simplefilter("always")
                sorted_files = _computed(_sort_file, tasks, "files", client)
            slices, found = _joined(sorted_files, run, [str(one.message) for one in said])
        except ValueError:
            _remove_working_files(own)
            raise
        if not kept:
            for sentence in found["remarks"]:
                warnings.warn(sentence, stacklevel=2)
            kept = run | found
            write_atomically(own / "run.json", json.dumps(kept, indent=1))
        tasks = [(own, place, _near(slices, place, kept), kept) for place in _missing(own, kept)]
        _computed(_map_tile, tasks, "tiles", client)
        _remove_working_files(own)
    return Path(folder)


def _computed(function, tasks, unit, client):
    """The results of a function for many tasks, on Dask."""
    import dask
    from tqdm.dask import TqdmCallback

    delayed = [dask.delayed(function)(*task) for task in tasks]
    if client is not None:
        return client.gather(client.compute(delayed))
    with TqdmCallback(desc=unit, **BAR):
        return dask.compute(delayed, scheduler="threads")[0]


def _files(paths):
    """The cloud files of paths and of folders, each once, in the order of their names."""
    found = {}
    for path in map(Path, paths):
        inside = [file for file in path.rglob("*") if file.suffix.lower() in LAS_ENDINGS]
        if path.is_dir() and not inside:
            raise ValueError(f"Invalid folder {path}: no cloud. Must contain .las or .laz files.")
        for file in inside if path.is_dir() else [check_file(path, "cloud")]:
            found.setdefault((file.stat().st_dev, file.stat().st_ino), file.resolve())
    if not found:
        raise ValueError("Invalid clouds: none given. Must be one or more files.")
    return sorted(found.values())


def _record(folder):
    """The record of a run folder; an empty dict without a record."""
    file = Path(folder) / OWN / "run.json"
    return json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}


def _key(*values):
    """A short name that stands for values."""
    return sha256(json.dumps(values).encode()).hexdigest()[:16]


def _tile(own, place, run):
    """The file of a tile's figures."""
    key = _key(*(run[name] for name in ("cell", "radius", "tile", "files")))
    return own / f"tile_{place[0]}_{place[1]}_{key}.npy"


def _missing(own, run):
    """The tiles without a file."""
    return [place for place in run["tiles"] if not _tile(own, place, run).is_file()]


def _remove_working_files(own):
    """Remove sorted points, and what a run that was killed had half written."""
    for pattern in (f"*{WORKING}", ".tile_*.npy", ".run.*.json"):
        for left in own.glob(pattern):
            left.unlink(missing_ok=True)


def _sort_file(own, file, cell, tile, again):
    """Write the points of a file sorted into tiles; return what was found in it.

    Another time what is there is taken: the record has the remarks of the first time.
    """
    key = _key(file, cell, tile)
    index = own / f"{key}{WORKING}"
    if again and index.is_file():
        return json.loads(index.read_text(encoding="utf-8"))
    found = {"path": file[0], "n": 0, "crs": None, "step": 0.0, "slices": []}
    ends, total = [], np.zeros(3)
    remote = multiprocessing.parent_process() is not None  # what is said here, nobody reads
    with warnings.catch_warnings(record=True) if remote else nullcontext([]) as said:
        for number, part in enumerate(iterate_cloud(file[0], columns=())):
            if not len(part):
                continue
            ends += [*extent(part.points)]
            _check_extent(np.array(ends), cell)
            order, starts, tiles = sort_into_cells(cells_of(part.points[:, :2], cell), tile)
            name = f"{key}_{number}{WORKING}"
            write_atomically(own / name, part.points.take(order, axis=0).tofile)
            rows = np.column_stack([tiles, starts[:-1], starts[1:]]).tolist()
            found["slices"] += [(name, *row) for row in rows]
            found["crs"] = None if part.crs is None else part.crs.to_wkt()
            found["step"] = float(np.fmax(part.resolution, 0))
            found["n"] += len(part)
            total += [axis.sum() for axis in (part.points - ends[0]).T]
    if found["n"]:
        mean = ends[0] + total / found["n"]
        found["about"] = np.stack([np.min(ends, axis=0), np.max(ends, axis=0), mean]).tolist()
    found["said"] = [str(one.message) for one in said]
    write_atomically(index, json.dumps(found))
    return found


def _joined(files, run, said):
    """The slices of all files, and what the record says of them."""
    import pyproj

    counted, without, crs = [], [], None
    remarks = list(dict.fromkeys([*said, *(text for file in files for text in file["said"])]))
    for file in (one for one in files if one["n"]):
        same = next((one["path"] for one in counted if _has_same_points(one, file)), None)
        if same is not None:
            remarks.append(f"{file['path']} has the points of {same}: counted once.")
            continue
        counted.append(file)
        own = None if file["crs"] is None else pyproj.CRS(file["crs"])
        crs = crs or own
        check_same_crs(file["path"], own, "first cloud", crs)
        check_upright(file["path"], own)
        without += [file["path"]] * (own is None)
    if not counted:
        listed = ", ".join(file["path"] for file in files)
        raise ValueError(f"Invalid clouds {listed}: no point. Must have one.")
    if crs is not None and without:
        listed = ", ".join(without)
        remarks.append(f"No coordinate system in {listed}: taken for {crs.name}.")
    _check_extent(np.concatenate([file["about"][:2] for file in counted]), run["cell"])
    slices = pd.DataFrame(
        [row for file in counted for row in file["slices"]],
        columns=["name", "column", "row", "start", "stop"],
    )
    side, tiles = _tiles(slices, run["tile"])
    step, crs = max(file["step"] for file in counted), None if crs is None else crs.to_wkt()
    return slices, {"side": side, "tiles": tiles, "crs": crs, "step": step, "remarks": remarks}


def _has_same_points(file, other):
    """Whether two files agree in count, box and mean of points, but for the steps they are in."""
    off = np.abs(np.subtract(file["about"], other["about"])).max()
    return file["n"] == other["n"] and off <= 1.001 * max(file["step"], other["step"], 1e-5)


def _tiles(slices, side):
    """Side in cells and places of tiles that are joined until one has enough points."""
    counts = (slices["stop"] - slices["start"]).groupby([slices["column"], slices["row"]]).sum()
    while counts.max() < ENOUGH and len(counts) > 4:  # four meet at the origin and stay
        columns, rows = (counts.index.get_level_values(level) // 2 for level in (0, 1))
        counts, side = counts.groupby([columns, rows]).sum(), 2 * side
    return side, [list(place) for place in counts.index]


def _reach(run):
    """Cells around a tile in which its points may have neighbours."""
    return int(np.ceil(run["radius"] / run["cell"])) + 1


def _near(slices, place, run):
    """The slices with points in a tile and around it; those of a column lie in a row."""
    inside = np.ones(len(slices), dtype=bool)
    for name, low in zip(("column", "row"), np.multiply(place, run["side"]), strict=True):
        inside &= (slices[name] >= (low - _reach(run)) // run["tile"]).to_numpy()
        inside &= (slices[name] < (low + run["side"] + _reach(run)) / run["tile"]).to_numpy()
    columns = slices[inside].groupby(["name", "column"], as_index=False)
    ends = columns.agg({"start": "min", "stop": "max"})
    return ends[["name", "start", "stop"]].to_numpy().tolist()


def _map_tile(own, place, near, run):
    """Evaluate a tile with the points around it, and write its file."""
    first, side, cell = np.multiply(place, run["side"]), run["side"], run["cell"]
    points = np.concatenate([
        np.fromfile(own / name, count=3 * (stop - start), offset=24 * start).reshape(-1, 3)
        for name, start, stop in near
    ])  # fmt: skip
    margin = 1.001 * run["radius"] + 0.001 * cell  # all that rounding may need
    points = points[_within(points, first * cell - margin, (first + side) * cell + margin)]
    index = cells_of(points[:, :2], cell)
    inner = _within(index, first, first + side)
    table = _evaluated(points, index, inner, cell, run["radius"])
    write_atomically(_tile(own, place, run), lambda path: np.save(path, table))


def _within(places, low, high):
    """Whether places lie in a rectangle."""
    x, y = places.T[:2]
    return (x >= low[0]) & (x < high[0]) & (y >= low[1]) & (y < high[1])


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
        If the folder contains no run, or one without a tile.
    """
    own, run = Path(folder).resolve() / OWN, _record(folder)
    missing = _missing(own, run) if run else []
    if not run or len(missing) == len(run["tiles"]):
        raise FileNotFoundError(f"Invalid folder {folder}: no tile. Must be of a campaign's map.")
    if missing:
        run["remarks"] += [f"{len(missing)} of {len(run['tiles'])} tiles are missing."]
    files = [_tile(own, place, run) for place in run["tiles"] if place not in missing]
    whole = _dataset(np.concatenate([np.load(file) for file in files]), run)
    return placed(whole, run["crs"]) if run["crs"] else whole


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
    names = [name for name in FIGURES if name != "n"]
    cells = dataset[names].to_dataframe()[names]
    table = cells.quantile(QUANTILES).T.set_axis([f"q{100 * q:02.0f}" for q in QUANTILES], axis=1)
    table.insert(0, "n", cells.count())
    units = [FIGURES[name][0] for name in names]
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
