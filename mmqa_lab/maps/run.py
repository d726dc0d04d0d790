"""A campaign from its files to its tiles."""

import hashlib
import json
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from mmqa_lab._checks import check_choice, check_positive
from mmqa_lab.io import write_atomically
from mmqa_lab.maps import files
from mmqa_lab.maps.engine import workers as start_workers
from mmqa_lab.maps.grid import Grid, cells_of, corner, fitting_tile, occupied_tiles
from mmqa_lab.maps.tile import METRICS, evaluate_tile, reach

MOST_CELLS = 5e9
"""Cells of the raster over a campaign, most of them empty: 35 km x 35 km of half metres."""


@dataclass(frozen=True)
class Outcome:
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


def map_campaign(
    paths,
    folder,
    *,
    cell,
    surface="local",
    metrics=METRICS,
    radius=0.5,
    thickness=0.1,
    void=0.1,
    tile=None,
    workers=None,
    scheduler=None,
    progress=False,
):
    """Evaluate every cell of a campaign, tile by tile, into a run folder.

    Parameters
    ----------
    paths : sequence of path
        LAS, LAZ or COPC files, and folders of them.
    folder : path
        The run folder. Where it holds an unfinished run with the same parameters, that goes on.
    cell, surface, metrics, radius, thickness, void
        See :func:`mmqa_lab.maps.evaluate_tile`.
    tile : float, optional
        Side of the tiles, m, rounded to whole cells; chosen from the number of points when not
        given. Results do not depend on it.
    workers, scheduler
        See :func:`mmqa_lab.maps.engine.workers`.
    progress : bool
        Show progress bars.

    Returns
    -------
    Outcome

    Raises
    ------
    FileNotFoundError, ValueError
        If there are no files, none is sound, they have different coordinate reference systems,
        the folder holds a run with other parameters, or an argument is out of its range.

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
    found = files.find_files(paths)
    check_positive(cell, "cell", unit="m")
    for metric in metrics:
        check_choice(metric, "metric", METRICS)
    chosen = {"surface": surface, "metrics": tuple(metrics), "radius": radius}
    chosen |= {"thickness": thickness, "void": void}
    evaluate_tile(np.empty((0, 3)), Grid(cell, 1, (0, 0)).window((0, 0)), cell=cell, **chosen)
    if tile is not None:
        tile = max(1, round(check_positive(tile, "tile", unit="m") / cell))
    run = _Run(Path(folder).resolve(), cell, chosen, tile)
    with start_workers(workers, scheduler=scheduler) as engine:
        return run.complete(found, partial(_shown, engine, progress))


class _Run:
    """A run folder and what is to be done in it."""

    def __init__(self, folder, cell, choices, tile):
        self.folder, self.cell, self.choices, self.tile = folder, cell, choices, tile
        self.files, self.tiles = folder / "files", folder / "tiles"
        self.problems = []

    def complete(self, found, engine):
        """Unpack, lay out and evaluate what is still missing."""
        sources = self._sources(found)
        grid = self._begin(sources)
        missing = [s for s in sources if not (self.files / f"{s.key}.npz").is_file()]
        sound, sources, computed = self._unpack(sources, missing, grid, engine), None, set()
        while sound != sources:  # damage inside of a COPC file is found when a tile reads it
            sources = sound
            index = {source: files.read_index(source, self.files) for source in sources}
            boxes, counts = (np.concatenate(arrays) for arrays in zip(*index.values(), strict=True))
            if not grid.tile:
                grid = replace(grid, tile=fitting_tile(boxes, counts, cell=self.cell))
            tiles = self._tiles(index, boxes, grid)
            self._write_record(sources, grid, tiles=list(tiles), cells=_extent(boxes, grid))
            todo = {place: near for place, near in tiles.items() if not self._is_done(place, near)}
            computed |= todo.keys()
            needed = dict.fromkeys(source for near in todo.values() for source in near)
            packed = [s for s in needed if not files.is_unpacked(s, self.files)]
            sound = self._unpack(sources, packed, grid, engine)
            if sound == sources:
                sound = self._evaluate(sources, todo, grid, engine)
        points = int(counts.sum())
        if not self.problems:
            self._count(tiles, points)
            for unpacked in self.files.glob("*.xyz"):
                unpacked.unlink()
        return Outcome(self.folder, len(tiles), len(computed), points, tuple(self.problems))

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

    def _sources(self, found):
        """The files whose headers are sound, in one coordinate reference system."""
        sources = []
        for path in found:
            try:
                sources.append(files.read_source(path))
            except ValueError as error:
                self.problems.append(str(error))
        if not sources:
            raise ValueError(self.problems[0])
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
            if problem is not None:
                named = source.path in str(problem)
                self.problems.append(str(problem) if named else f"{source.path}: {problem}")
                damaged.add(source)
        return self._without(damaged, sources)

    def _without(self, damaged, sources):
        """The sources that are not damaged."""
        sound = [source for source in sources if source not in damaged]
        if not sound:
            raise ValueError(self.problems[0])
        return sound

    def _tiles(self, index, boxes, grid):
        """Every tile with points, and the sources of its points and of those around it."""
        tiles = {}
        for place in occupied_tiles(boxes, grid):
            box = grid.box(place, _halo(grid, self.choices))
            tiles[place] = [s for s, (pieces, _) in index.items() if _any_overlap(pieces, box)]
        return tiles

    def _is_done(self, place, near):
        """Whether a tile's file is there and made from the same points."""
        path = self.tiles / tile_name(place)
        if not path.is_file():
            return False
        return str(files.read_array(path, "sources")) == _mark(near)

    def _evaluate(self, sources, todo, grid, engine):
        """Compute the tiles; the sources without those that turned out to be damaged."""
        tasks = [
            (place, near, self.folder, grid, self.choices) for place, near in sorted(todo.items())
        ]
        damaged, failed = {}, []
        for (place, *_), problem in engine(_evaluate_place, tasks, "tiles"):
            if isinstance(problem, files.Damaged):
                damaged[problem.source] = str(problem)
            elif problem is not None:
                x, y, *_ = np.array(grid.box(place)) + np.tile(grid.origin[:2], 2)
                failed.append(f"Tile at {x:.0f} {y:.0f} not computed: {problem}")
        self.problems += damaged.values()
        if not damaged:  # else the next round tries these tiles again
            self.problems += failed
        return self._without(damaged, sources)

    def _count(self, tiles, points):
        """Whether every point is in a tile: damage may move points of a COPC file out of reach."""
        arrays = (files.read_array(self.tiles / tile_name(place), "n") for place in tiles)
        lost = points - sum(int(n.sum()) for n in arrays)
        if lost:
            self.problems.append(f"{lost} of {points} points are in no tile: a file is damaged.")

    def _write_record(self, sources, grid, *, tiles=(), cells=()):
        """Write what the run is, for those who resume and those who put it together."""
        record = {
            "cell": self.cell,
            **self.choices,
            "tile": grid.tile,
            "first": grid.first,
            "crs": next((source.crs for source in sources if source.crs), ""),
            "cells": cells,
            "tiles": tiles,
            "sources": [asdict(source) for source in sources],
        }
        text = json.dumps(record, indent=1)
        write_atomically(self.folder / "run.json", lambda path: path.write_text(text, "utf-8"))


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


def _extent(boxes, grid):
    """The cells, counted from zero coordinates, between which all pieces lie."""
    cells = cells_of(boxes, grid)
    return [*cells[:, :2].min(axis=0).tolist(), *(cells[:, 2:].max(axis=0) + 1).tolist()]


def tile_name(place):
    """The file of a tile in the folder ``tiles``."""
    return f"{place[0]}_{place[1]}.npz"


def _unpack_file(source, folder, origin):
    """Task: unpack a file; the problem, if there is one."""
    try:
        files.unpack(source, folder, origin)
    except (ValueError, OSError) as error:
        return error
    return None


def _evaluate_place(place, sources, folder, grid, choices):
    """Task: compute a tile and write its file; the problem, if there is one."""
    import numba

    numba.set_num_threads(1)
    path = folder / "tiles" / tile_name(place)
    try:
        box = grid.box(place, _halo(grid, choices))
        points = files.read_box(sources, folder / "files", grid.origin, box)
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


def _any_overlap(pieces, box):
    return bool(files.overlaps(pieces, box).any())


def _shown(engine, progress, function, tasks, name):
    """Results of tasks under a progress bar."""
    from tqdm.auto import tqdm

    bar = tqdm(
        engine(function, tasks), total=len(tasks), desc=name, disable=not (progress and tasks)
    )
    yield from bar
