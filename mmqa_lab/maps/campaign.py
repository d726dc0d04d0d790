"""A campaign from its files to its tiles.

The headers are read first. Each file is unpacked once into the run folder: bare coordinates, and
the bounding box of every piece of 50 000 points. Square tiles are laid over the pieces; cells lie
at multiples of their size from the coordinates' zero, tiles at multiples of theirs. The tiles go to
processes on this machine or to a Dask cluster. Each reads its points and a halo around it and
writes one file.

What is on disk is what is done: a tile's file appears whole, with the names of the points' sources
in it, so a run that was stopped goes on with the tiles that are missing or out of date.
"""

import contextlib
import hashlib
import json
import logging
import os
import threading
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mmqa_lab._checks import check_count, check_metres, check_positive
from mmqa_lab._results import Shown
from mmqa_lab.io import LAS_ENDINGS, iterate_cloud, write_atomically
from mmqa_lab.maps.tile import METRICS, evaluate_tile, reach

PIECE = 50_000
"""Points with a bounding box of their own."""

TOLERANCE_M = 1.0
"""Points this far outside of the box in their file's header are taken for damage."""

MOST_CELLS = 5e9
"""Cells of the raster over a campaign, most of them empty: 35 km x 35 km of half metres."""

COMFORTABLE = 1_500_000
"""Points that a tile should have at most, by the pieces' boxes: about half a gigabyte of work."""

WIDEST_M, NARROWEST_M = 128.0, 4.0

ANSWERS_S = 30
"""A scheduler that does not answer for so long is not running."""

SPAWN = "distributed.nanny.pre-spawn-environ."
KEEP_MEMORY = {
    f"{SPAWN}MALLOC_TRIM_THRESHOLD_": 2**30,
    f"{SPAWN}MALLOC_MMAP_THRESHOLD_": 2**29,
    f"{SPAWN}MALLOC_ARENA_MAX": 1,
}
"""Workers keep what arrays leave instead of giving it back and asking anew for each one, which took
a seventh of their time."""

_ONE_AT_A_TIME = threading.Lock()
"""Python 3.11 may fail when several threads parse at once, as numpy does an array's header."""


@dataclass(frozen=True)
class Outcome(Shown):
    """What a run did.

    Parameters
    ----------
    folder : Path
        The run folder.
    tiles, computed : int
        Tiles of the map, and how many of them this run computed.
    points : int
        Points of the sound files.
    problems : tuple of str
        A sentence for each file that could not be used and each tile that could not be computed.
    remarks : tuple of str
        A sentence for each file that was left out without harm: without points, or the same again.

    Examples
    --------
    >>> import tempfile
    >>> from mmqa_lab import samples
    >>> run = {"cell": 0.5, "metrics": ("density",), "workers": 1}
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     first = map_campaign([samples.path("road_patch")], folder, **run)
    ...     again = map_campaign([samples.path("road_patch")], folder, **run)
    >>> first.points, first.computed == first.tiles, again.computed, again.problems
    (28185, True, 0, ())
    """

    folder: Path
    tiles: int
    computed: int
    points: int
    problems: tuple
    remarks: tuple


@dataclass(frozen=True)
class Source:
    """A file of the campaign.

    ``key`` is its name in the run folder, another one once the file has changed; ``low`` and
    ``high`` are the corners of the box in its header, ``scale`` the step of its coordinates, m.
    ``crs`` is well-known text, empty where the file has none.
    """

    path: str
    key: str
    n: int
    low: tuple
    high: tuple
    scale: float
    crs: str


@dataclass(frozen=True)
class Grid:
    """Square cells in square tiles.

    Parameters
    ----------
    cell : float
        Side of a cell, m. Cell (i, j) reaches from i * cell to (i + 1) * cell in easting.
    tile : int
        Cells along the side of a tile. Tile (i, j) begins with cell (i * tile, j * tile).
    first : tuple of int, length 3
        The cell, eastward, northward and upward, at whose corner local coordinates have their zero.
    """

    cell: float
    tile: int
    first: tuple

    @property
    def origin(self):
        """Coordinates of the local zero, shape (3,), m."""
        return np.array(self.first) * self.cell

    def window(self, place):
        """The cells of the tile at ``place`` = (i, j), counted from the local zero."""
        column, row = np.multiply(place, self.tile) - self.first[:2]
        return int(column), int(row), self.tile, self.tile

    def box(self, place, halo=0.0):
        """Local box of a tile and a halo around it: x low, y low, x high, y high, m."""
        low = np.array(self.window(place)[:2]) * self.cell
        return (*(low - halo).tolist(), *(low + self.tile * self.cell + halo).tolist())

    def cells_of(self, boxes):
        """First and last cells of local boxes, shape (m, 4), counted from the coordinates' zero.

        Rounded as the points themselves are, so that none falls between two tiles.
        """
        return np.floor(boxes / self.cell).astype(int) + np.tile(self.first[:2], 2)

    def occupied(self, boxes):
        """The tiles that boxes touch, as a sorted list of (i, j)."""
        places = {place for box in self.cells_of(boxes) // self.tile for place in _inside(box)}
        return sorted(places)


def map_campaign(
    paths: Sequence[str | os.PathLike],
    folder: str | os.PathLike,
    *,
    cell: float,
    surface: str = "local",
    metrics: Sequence[str] = METRICS,
    radius: float = 0.5,
    thickness: float = 0.1,
    void: float = 0.1,
    tile: float | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: bool = False,
) -> Outcome:
    """Evaluate every cell of a campaign, tile by tile, into a run folder.

    Parameters
    ----------
    paths : sequence of path
        LAS, LAZ or COPC files, and folders of them. A file whose header has the same count and box
        as another one's counts once.
    folder : path
        The run folder. An unfinished run with the same parameters in it goes on. Until the run has
        finished, the folder needs 24 bytes a point.
    cell, surface, metrics, radius, thickness, void
        See :func:`mmqa_lab.maps.map_cloud`.
    tile : float, optional
        Side of the tiles, m, rounded to whole cells; chosen from the number of points when not
        given. Results do not depend on it.
    workers : int, optional
        Processes on this machine; when not given, one for every 1.5 million points, up to the
        number of cores. With 1, tiles are computed in this process.
    scheduler : str, optional
        Address of a running Dask scheduler, ``tcp://host:port``; ``workers`` is then up to it. Its
        workers need this package, and the files under the same paths.
    progress : bool
        Show progress bars.

    Returns
    -------
    Outcome

    Raises
    ------
    FileNotFoundError, ValueError
        If there are no files, none is sound, they have different coordinate reference systems,
        the folder contains a run with other parameters, or an argument is out of its range.
    OSError
        If no scheduler answers.

    Notes
    -----
    A tile whose worker dies is computed again elsewhere; one that took four workers with it is
    named in ``problems``.

    Examples
    --------
    >>> import tempfile
    >>> from mmqa_lab import maps, samples
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     done = map_campaign(
    ...         [samples.path("road_patch")], folder, cell=0.5, metrics=("density",), workers=1
    ...     )
    ...     counted = int(maps.open_map(folder)["n"].sum())
    >>> counted == done.points
    True
    """
    found = find_files(paths)
    check_positive(cell, "cell", unit="m")
    choices = {"surface": surface, "metrics": tuple(metrics), "radius": radius}
    choices |= {"thickness": thickness, "void": void}
    evaluate_tile(np.empty((0, 3)), (0, 0, 1, 1), cell=cell, **choices)
    if tile is not None:
        tile = max(1, round(check_positive(tile, "tile", unit="m") / cell))
    run = _Run(Path(folder).resolve(), cell, choices, tile)
    sources = run.sources(found)
    if workers is None:
        workers = min(os.cpu_count(), 1 + sum(source.n for source in sources) // COMFORTABLE)
    with _started(workers, scheduler) as engine:
        return run.complete(sources, lambda *tasks: _shown(engine, progress, *tasks))


class _Run:
    """A run folder and what is to be done in it."""

    def __init__(self, folder, cell, choices, tile):
        self.folder, self.cell, self.choices, self.tile = folder, cell, choices, tile
        self.files, self.tiles = folder / "files", folder / "tiles"
        self.problems, self.remarks = [], []

    def complete(self, sources, engine):
        """Unpack, lay out and evaluate what is still missing."""
        grid = self._begin(sources)
        missing = [s for s in sources if not (self.files / f"{s.key}.npz").is_file()]
        sources = self._distinct(self._unpack(sources, missing, grid, engine))
        index = {source: _read_index(source, self.files) for source in sources}
        boxes, counts = (np.concatenate(arrays) for arrays in zip(*index.values(), strict=True))
        if not grid.tile:
            grid = replace(grid, tile=fitting_tile(boxes, counts, cell=self.cell))
        tiles = self._tiles(index, boxes, grid)
        cells = grid.cells_of(boxes)
        extent = [*cells[:, :2].min(axis=0).tolist(), *(cells[:, 2:].max(axis=0) + 1).tolist()]
        self._write_record(sources, grid, tiles=list(tiles), cells=extent)
        todo = {place: near for place, near in tiles.items() if not self._is_done(place, near)}
        needed = dict.fromkeys(source for near in todo.values() for source in near)
        packed = [s for s in needed if not (self.files / f"{s.key}.xyz").is_file()]
        self._unpack(sources, packed, grid, engine)
        self._evaluate(todo, grid, engine)
        if not self.problems:
            for unpacked in self.files.glob("*.xyz"):
                unpacked.unlink()
        told = tuple(self.problems), tuple(self.remarks)
        return Outcome(self.folder, len(tiles), len(todo), int(counts.sum()), *told)

    def _begin(self, sources):
        """Make or clean the folder; the grid of the run in it, or that of a new one."""
        record = self._earlier()
        self.files.mkdir(parents=True, exist_ok=True)
        self.tiles.mkdir(exist_ok=True)
        for stale in [*self.files.glob(".*"), *self.tiles.glob(".*")]:
            stale.unlink()
        if record is not None:
            return Grid(self.cell, self.tile or record["tile"], tuple(record["first"]))
        first = corner(np.min([source.low for source in sources], axis=0), self.cell)
        grid = Grid(self.cell, self.tile or 0, first)
        self._write_record(sources, grid)
        return grid

    def _earlier(self):
        """The record of an earlier run in this folder, None where there is none."""
        path = self.folder / "run.json"
        if not path.is_file():
            return None
        record = json.loads(path.read_text(encoding="utf-8"))
        ours = json.loads(json.dumps({"cell": self.cell, **self.choices}))
        ours["tile"] = (record["tile"] and self.tile) or record["tile"]
        for name, value in ours.items():
            if record[name] != value:
                raise ValueError(
                    f"Invalid run folder {self.folder}: its {name} is {record[name]}, not {value}. "
                    "Must be removed, or completed with the same parameters."
                )
        return record

    def sources(self, found):
        """The files whose headers are sound, in one coordinate reference system."""
        sources = []
        for path in found:
            try:
                source = read_source(path)
            except ValueError as error:
                self.problems.append(str(error))
                continue
            if source.n:
                sources.append(source)
            else:
                self.remarks.append(f"{path} has no points.")
        if not sources:
            raise ValueError((self.problems or [f"Invalid campaign: {self.remarks[0]}"])[0])
        known = {source.crs: source.path for source in sources if source.crs}
        if len(known) > 1:
            one, other = sorted(known.values())[:2]
            raise ValueError(
                f"Invalid coordinate reference systems: {one} and {other} have different ones. "
                "Must be the same."
            )
        _check_extent(sources, self.cell)
        return sources

    def _unpack(self, sources, missing, grid, engine):
        """Unpack files; the sources without those that turned out to be damaged."""
        tasks = [(source, self.files, grid.origin) for source in missing]
        damaged = set()
        for (source, *_), problem in engine(_unpack_file, tasks, "files"):
            if isinstance(problem, UserWarning):
                self.remarks.append(str(problem))
            elif problem is not None:
                named = source.path in str(problem)
                self.problems.append(str(problem) if named else f"{source.path}: {problem}")
                damaged.add(source)
        sound = [source for source in sources if source not in damaged]
        if not sound:
            raise ValueError(self.problems[0])
        return sound

    def _distinct(self, sources):
        """The files without those that have the points of another one."""
        distinct = {}
        for source in sources:
            same = distinct.setdefault((source.n, source.low, source.high), source)
            if same is not source:
                self.remarks.append(f"{source.path} has the points of {same.path}: counted once.")
        return list(distinct.values())

    def _tiles(self, index, boxes, grid):
        """Every tile with points, and the sources of its points and of those around it."""
        tiles = {}
        for place in grid.occupied(boxes):
            box = grid.box(place, _halo(grid, self.choices))
            tiles[place] = [s for s, (pieces, _) in index.items() if _overlaps(pieces, box).any()]
        return tiles

    def _is_done(self, place, near):
        """Whether a tile's file is there and made from the same points."""
        path = self.tiles / tile_name(place)
        return path.is_file() and str(read_array(path, "sources")) == _mark(near)

    def _evaluate(self, todo, grid, engine):
        """Compute the tiles."""
        tasks = [
            (place, near, self.folder, grid, self.choices) for place, near in sorted(todo.items())
        ]
        for (place, *_), problem in engine(_evaluate_place, tasks, "tiles"):
            if problem is not None:
                x, y = np.array(grid.box(place)[:2]) + grid.origin[:2]
                self.problems.append(f"Tile at {x:.0f} {y:.0f} not computed: {problem}")

    def _write_record(self, sources, grid, *, tiles=(), cells=()):
        """Write what the run is, for those who resume and those who put it together."""
        record = {
            "cell": self.cell,
            **self.choices,
            "tile": grid.tile,
            "first": grid.first,
            "crs": next((source.crs for source in sources if source.crs), ""),
            "resolution": max(source.scale for source in sources),
            "remarks": self.remarks,
            "cells": cells,
            "tiles": tiles,
            "sources": [source.path for source in sources],
        }
        text = json.dumps(record, indent=1)
        write_atomically(self.folder / "run.json", text)


def find_files(paths):
    """Return the LAS, LAZ and COPC files among files and folders, in the order of their names.

    Raises
    ------
    FileNotFoundError
        If a path does not exist.
    ValueError
        If a file has another ending or a folder contains none.
    """
    found = set()
    for path in map(Path, paths):
        if not path.exists():
            raise FileNotFoundError(f"Invalid cloud {path}: no such file or folder. Must exist.")
        inside = [path] if path.is_file() else path.rglob("*")
        clouds = [file for file in inside if file.suffix.lower() in LAS_ENDINGS]
        if not clouds:
            raise ValueError(f"Invalid cloud {path}. Must be, or contain, .las or .laz files.")
        found.update(file.resolve() for file in clouds)
    return sorted(found)


def known_crs(paths):
    """Return the first coordinate reference system that files' headers name, as WKT; "" for none.

    Damaged headers are passed over: mapping names them.
    """
    for path in find_files(paths):
        with contextlib.suppress(ValueError):
            if crs := read_source(path).crs:
                return crs
    return ""


def read_source(path):
    """Read a file's header.

    Raises
    ------
    ValueError
        If the header is damaged.
    """
    import laspy

    try:
        with laspy.open(path) as reader:
            header = reader.header
            crs = header.parse_crs()
    except Exception as error:
        reason = str(error).rstrip(". ")
        raise ValueError(f"Invalid cloud {path}: {reason}. Must have a header.") from error
    check_metres(crs, f"cloud {path}")
    state = os.stat(path)
    mark = f"{path}|{state.st_size}|{state.st_mtime_ns}"
    key = f"{Path(path).stem}-{hashlib.sha256(mark.encode()).hexdigest()[:12]}"
    box = tuple(map(float, header.mins)), tuple(map(float, header.maxs))
    wkt = "" if crs is None else crs.to_wkt()
    return Source(str(path), key, header.point_count, *box, float(max(header.scales)), wkt)


def corner(low, cell):
    """The cell at which local coordinates begin, for a campaign whose least corner is ``low``.

    In steps of 1024 cells, so that a further file seldom moves it.

    Examples
    --------
    >>> corner((600_123.4, 5_200_045.6, -3.0), 0.5)
    (1200128, 10399744, -1024)
    """
    return tuple(int(k) * 1024 for k in np.floor(np.asarray(low) / (1024 * cell)))


def fitting_tile(boxes, counts, *, cell):
    """Cells along the largest tile, a power of two, with a comfortable number of points.

    Points of each box, shape (m, 4), are taken as spread evenly.
    """
    tile = 2 ** int(np.log2(max(WIDEST_M / cell, 1)))
    while tile * cell > NARROWEST_M and _fullest(boxes, counts, tile * cell) > COMFORTABLE:
        tile //= 2
    return tile


def tile_name(place):
    """The file of a tile in the folder ``tiles``."""
    return f"{place[0]}_{place[1]}.npz"


def read_array(path, name):
    """Return one array of an ``.npz`` file."""
    with _ONE_AT_A_TIME, np.load(path) as arrays:
        return arrays[name]


def _inside(box):
    """All places (i, j) from the first to the last of a box."""
    x_low, y_low, x_high, y_high = box
    return [(int(i), int(j)) for i in range(x_low, x_high + 1) for j in range(y_low, y_high + 1)]


def _fullest(boxes, counts, side):
    """Most points in a tile of this side."""
    sums = Counter()
    for box, count in zip(np.floor(boxes / side).astype(int), counts, strict=True):
        places = _inside(box)
        sums.update(dict.fromkeys(places, count / len(places)))
    return max(sums.values())


def _check_extent(sources, cell):
    """Refuse files that lie too far apart for one raster, as local coordinates beside national."""
    low, high = (np.array([getattr(s, end)[:2] for s in sources]) for end in ("low", "high"))
    wide = high.max(axis=0) - low.min(axis=0)
    if np.prod(wide / cell) > MOST_CELLS:
        axis = wide.argmax()
        first, last = (sources[k].path for k in (low[:, axis].argmin(), high[:, axis].argmax()))
        raise ValueError(
            f"Invalid campaign, {wide[0] / 1000:.0f} km x {wide[1] / 1000:.0f} km from {first} "
            f"to {last}. Must lie within {MOST_CELLS:.0e} cells of {cell} m."
        )


def _unpack_file(source, folder, origin):
    """Task: write a file's coordinates and its pieces' boxes; the problem or doubt, or None."""
    boxes, counts = [], []

    def write(temporary):
        """All points from the origin, three numbers each."""
        with open(temporary, "wb") as file:
            for points in _points(source):
                points = points - origin
                for first in range(0, len(points), PIECE):
                    xy = points[first : first + PIECE, :2]
                    boxes.append(np.concatenate(_box(xy)))
                    counts.append(len(xy))
                file.write(points.data)

    try:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            write_atomically(folder / f"{source.key}.xyz", write)
        index = {"boxes": np.array(boxes), "counts": np.array(counts)}
        write_atomically(folder / f"{source.key}.npz", lambda path: np.savez(path, **index))
    except (ValueError, OSError) as error:
        return error
    return UserWarning(" ".join(str(one.message) for one in said)) if said else None


def _points(source):
    """Pieces of a file's points, compared with its header."""
    low, high = np.array(source.low) - TOLERANCE_M, np.array(source.high) + TOLERANCE_M
    for cloud in iterate_cloud(source.path, columns=()):
        points = cloud.points
        least, most = _box(points)
        if (least < low).any() or (most > high).any():
            outside = (points < low).any(axis=1) | (points > high).any(axis=1)
            raise ValueError(
                f"Invalid cloud {source.path}: {outside.sum()} points outside of the box in its "
                "header. Must be a complete LAS or LAZ file."
            )
        yield points


def _box(points):
    """Least and largest coordinates; an axis at a time, which is several times quicker."""
    axes = points.T
    return np.array([axis.min() for axis in axes]), np.array([axis.max() for axis in axes])


def _read_index(source, folder):
    """The boxes (m, 4: x low, y low, x high, y high) and counts of a file's pieces."""
    path = folder / f"{source.key}.npz"
    return read_array(path, "boxes"), read_array(path, "counts")


def _read_box(sources, folder, box):
    """The unpacked points (n, 3) within a box, in the order of the sources and of their files."""
    parts = [np.empty((0, 3))]
    for source in sources:
        boxes, counts = _read_index(source, folder)
        ends = np.cumsum(counts)
        points = np.memmap(folder / f"{source.key}.xyz", dtype=np.float64, mode="r").reshape(-1, 3)
        for k in np.flatnonzero(_overlaps(boxes, box)):
            piece = np.asarray(points[ends[k] - counts[k] : ends[k]])
            x, y = piece[:, 0], piece[:, 1]
            near = (x >= box[0]) & (x <= box[2]) & (y >= box[1]) & (y <= box[3])
            parts.append(piece[near])
    return np.concatenate(parts)


def _overlaps(boxes, box):
    """The mask of the boxes (m, 4) that share a point with ``box``."""
    x = (boxes[:, 0] <= box[2]) & (boxes[:, 2] >= box[0])
    return x & (boxes[:, 1] <= box[3]) & (boxes[:, 3] >= box[1])


def _evaluate_place(place, sources, folder, grid, choices):
    """Task: compute a tile and write its file; the problem, if there is one."""
    import numba

    numba.set_num_threads(1)
    path = folder / "tiles" / tile_name(place)
    try:
        points = _read_box(sources, folder / "files", grid.box(place, _halo(grid, choices)))
    except (ValueError, OSError) as error:
        path.unlink(missing_ok=True)  # what an earlier run left there is out of date
        return error
    figures = evaluate_tile(points, grid.window(place), cell=grid.cell, **choices)
    content = {**figures, "sources": _mark(sources)}
    write_atomically(path, lambda temporary: np.savez_compressed(temporary, **content))
    return None


def _halo(grid, choices):
    """How far around a tile points matter, m."""
    near = {name: choices[name] for name in ("radius", "thickness")}
    return reach(choices["surface"], cell=grid.cell, **near)


def _mark(sources):
    """A short name for the files behind a tile."""
    names = "|".join(source.key for source in sources)
    return hashlib.sha256(names.encode()).hexdigest()[:16]


@contextlib.contextmanager
def _started(count, scheduler):
    """Give a function ``run(function, tasks)`` that yields ``(task, result)`` as results come in.

    The result of a task that took four workers with it is the exception.
    """
    count = check_count(count, "workers")
    if scheduler is None and count == 1:
        yield lambda function, tasks: ((task, function(*task)) for task in tasks)
        return
    import dask
    from distributed import Client, LocalCluster

    quiet = {"memory_limit": 0, "dashboard_address": ":0", "silence_logs": logging.ERROR}
    with contextlib.ExitStack() as stack:
        patience_s = ANSWERS_S
        if scheduler is None:
            patience_s = 600  # it runs, however slowly it starts
            stack.enter_context(dask.config.set(KEEP_MEMORY))
            cluster = LocalCluster(n_workers=count, threads_per_worker=1, **quiet)
            scheduler = stack.enter_context(cluster)
        try:
            client = stack.enter_context(Client(scheduler, timeout=patience_s))
        except (OSError, ValueError) as error:
            raise OSError(f"Invalid scheduler {scheduler}. Must be a running one.") from error
        yield lambda function, tasks: _there(client, function, tasks)


def _there(client, function, tasks):
    """All tasks on the cluster; results as they come."""
    from distributed import CancelledError, KilledWorker, as_completed

    futures = {client.submit(function, *task, pure=False): task for task in tasks}
    for future in as_completed(futures):
        try:
            result = future.result()
        except KilledWorker as error:
            result = error
        except CancelledError as error:
            raise OSError("Lost the scheduler. Must run on; what was finished is kept.") from error
        yield futures.pop(future), result
        future.release()


def _shown(engine, progress, function, tasks, name):
    """Results of tasks under a progress bar."""
    from tqdm.auto import tqdm

    hidden = not (progress and tasks)
    yield from tqdm(engine(function, tasks), total=len(tasks), desc=name, disable=hidden)
