"""Maps of campaigns of any size: tile by tile on threads or a Dask cluster, resumed if stopped.

The figures do not depend on the size of the tiles.
"""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import sys
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from tqdm import tqdm

from mmqa_lab._checks import check_count, check_file, check_positive, check_same_crs, check_upright
from mmqa_lab.cloud import cells_of, extent, sort_into_cells, step_of
from mmqa_lab.io import LAS_ENDINGS, iterate_cloud, own_folder, write_atomically
from mmqa_lab.maps.cells import check_extent, chosen_metrics, dataset_of, evaluated_cells, placed

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["map_campaign", "open_map"]

# Points are sorted into tiles of this side, m, which are joined until one has so many points.
TILE_M, ENOUGH = 4.0, 100_000

# A bar on a terminal only, of a size of its own: some terminals say that theirs is zero.
BAR = {"disable": None, "leave": False, "ncols": 80, "nrows": 24}

# The folder of a campaign's own within a run folder, and the ending of its working files.
OWN, WORKING = "mmqa_map", ".mmqa_points"


def map_campaign(
    paths: Sequence[str | os.PathLike],
    folder: str | os.PathLike,
    *,
    cell: float = 0.5,
    radius: float = 0.5,
    tile: int = 128,
    metrics: Iterable[str] | Mapping[str, Callable] = (),
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
    metrics : names of ``metrics.METRICS``, or mapping of names to functions of a chart
        More variables of the map, see :func:`map_cloud`.
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
    files = [
        [str(one), one.stat().st_size, one.stat().st_mtime_ns, _hash_of_ends(one)] for one in paths
    ]
    functions = chosen_metrics(metrics)
    run = {"cell": cell, "radius": radius, "tile": tile, "files": files, "metrics": [*functions]}
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
        tasks = [
            (own, place, _near(slices, place, kept), kept, functions)
            for place in _missing(own, kept)
        ]
        _computed(_map_tile, tasks, "tiles", client)
        _remove_working_files(own)
    return Path(folder)


def _computed(function, tasks, unit, client):
    """The results of a function for many tasks, on threads or on a Dask client."""
    if client is not None:
        return client.gather([client.submit(function, *task, pure=False) for task in tasks])
    pool = ThreadPoolExecutor(os.cpu_count())
    try:
        done = pool.map(lambda task: function(*task), tasks)
        return list(tqdm(done, desc=unit, total=len(tasks), **BAR))
    finally:
        pool.shutdown(cancel_futures=True)


def _hash_of_ends(path):
    """The hash of the first and the last MB of a file: others may have its size and time."""
    with path.open("rb") as file:
        content = file.read(2**20)
        file.seek(max(path.stat().st_size - 2**20, 0))
        return sha256(content + file.read()).hexdigest()


def _files(paths):
    """The cloud files of paths and of folders, each once, in the order of their names."""
    found = {}
    for path in map(Path, paths):
        inside = [file for file in path.rglob("*") if file.suffix.lower() in LAS_ENDINGS]
        inside = [file for file in inside if not file.name.startswith(".")]
        if path.is_dir() and not inside:
            raise ValueError(f"Invalid folder {path}: no cloud. Must contain .las or .laz files.")
        for file in inside if path.is_dir() else [check_file(path, "cloud")]:
            found.setdefault((file.stat().st_dev, file.stat().st_ino), file.resolve())
    if not found:
        raise ValueError("Invalid clouds: none given. Must be one or more files.")
    return sorted(found.values())


def _record(folder):
    """The record of a run folder; an empty dict without one that can be read."""
    return _kept(Path(folder) / OWN / "run.json")


def _kept(file):
    """What a run wrote as JSON; an empty dict where that is missing or damaged."""
    with contextlib.suppress(OSError, ValueError):  # as when the machine lost its power
        kept = json.loads(file.read_text(encoding="utf-8"))
        return kept if isinstance(kept, dict) else {}
    return {}


def _key(*values):
    """A short name that stands for values."""
    return sha256(json.dumps(values).encode()).hexdigest()[:16]


def _tile_file(own, place, run):
    """The file of a tile's figures."""
    key = _key(*(run[name] for name in ("cell", "radius", "tile", "files", "metrics")))
    return own / f"tile_{place[0]}_{place[1]}_{key}.npy"


def _missing(own, run):
    """The tiles without a file that can be read."""
    return [place for place in run["tiles"] if not _is_whole(_tile_file(own, place, run))]


def _is_whole(file):
    """Whether a tile is there and can be read."""
    with contextlib.suppress(OSError, ValueError, EOFError):
        np.load(file)
        return True
    return False


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
    if again and (found := _kept(index)):
        return found
    found = {"path": file[0], "n": 0, "crs": None, "step": 0.0, "rise": 0.0, "slices": []}
    ends, total = [], np.zeros(3)
    remote = multiprocessing.parent_process() is not None  # what is said here, nobody reads
    with warnings.catch_warnings(record=True) if remote else nullcontext([]) as said:
        for number, part in enumerate(iterate_cloud(file[0], columns=())):
            if not len(part):
                continue
            ends += [*extent(part.points)]
            check_extent(np.array(ends), cell, np.inf)
            order, starts, tiles = sort_into_cells(cells_of(part.points[:, :2], cell), tile)
            name = f"{key}_{number}{WORKING}"
            write_atomically(own / name, part.points.take(order, axis=0).tofile)
            rows = np.column_stack([tiles, starts[:-1], starts[1:]]).tolist()
            found["slices"] += [(name, *row) for row in rows]
            found["crs"] = None if part.crs is None else part.crs.to_wkt()
            steps = found["step"], part.resolution, step_of(part.points)
            found["step"] = float(np.fmax.reduce(steps))
            steps = found["rise"], found["step"], step_of(part.points[:, 2:])
            found["rise"] = float(np.fmax.reduce(steps))
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
    ends = np.concatenate([file["about"][:2] for file in counted])
    check_extent(ends, run["cell"], sum(file["n"] for file in counted))
    slices = pd.DataFrame(
        [row for file in counted for row in file["slices"]],
        columns=["name", "column", "row", "start", "stop"],
    )
    side, tiles = _tiles(slices, run["tile"])
    steps = {name: max(file[name] for file in counted) for name in ("step", "rise")}
    crs = None if crs is None else crs.to_wkt()
    return slices, {"side": side, "tiles": tiles, "crs": crs, "remarks": remarks} | steps


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


def _map_tile(own, place, near, run, metrics):
    """Read and evaluate a tile with the points around it, and write its file."""
    first, side, cell = np.multiply(place, run["side"]), run["side"], run["cell"]
    points = np.concatenate([
        np.fromfile(own / name, count=3 * (stop - start), offset=24 * start).reshape(-1, 3)
        for name, start, stop in near
    ])  # fmt: skip
    margin = 1.001 * run["radius"] + 0.001 * cell  # all that rounding may need
    points = points[_within(points, first * cell - margin, (first + side) * cell + margin)]
    index = cells_of(points[:, :2], cell)
    inner = _within(index, first, first + side)
    table = evaluated_cells(points, index, inner, cell, run["radius"], metrics)
    write_atomically(_tile_file(own, place, run), lambda path: np.save(path, table))


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
    files = [_tile_file(own, place, run) for place in run["tiles"] if place not in missing]
    whole = dataset_of(np.concatenate([np.load(file) for file in files]), run)
    return placed(whole, run["crs"]) if run["crs"] else whole
