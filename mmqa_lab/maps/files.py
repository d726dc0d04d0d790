"""The files of a campaign, and their points by place."""

import contextlib
import hashlib
import os
import threading
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mmqa_lab.io import LAS_ENDINGS, iterate_cloud, write_atomically

PIECE = 50_000
"""Points with a bounding box of their own."""

TOLERANCE_M = 1.0
"""Points this far outside of the box in their file's header are taken for damage."""

_ONE_AT_A_TIME = threading.Lock()
"""Python 3.11 may fail when several threads parse at once, as numpy does an array's header."""


@dataclass(frozen=True)
class Source:
    """A file of the campaign.

    Parameters
    ----------
    path : str
    key : str
        Its name in the run folder; another one once the file has changed.
    n : int
    low, high : tuple of float, length 3
        Bounding box by the header, m.
    crs : str
        Coordinate reference system as well-known text, empty where the file has none.
    copc : bool
    """

    path: str
    key: str
    n: int
    low: tuple
    high: tuple
    crs: str
    copc: bool


class Damaged(ValueError):
    """A file whose points cannot be had; ``source`` tells which."""

    def __init__(self, source, sentence):
        super().__init__(source, sentence)
        self.source = source

    def __str__(self):
        return self.args[1]


def find_files(paths):
    """Return the LAS, LAZ and COPC files among files and folders, in the order of their names.

    Raises
    ------
    FileNotFoundError
        If a path does not exist.
    ValueError
        If a file has another ending or a folder holds none.
    """
    found = set()
    for path in map(Path, paths):
        if not path.exists():
            raise FileNotFoundError(f"Invalid cloud {path}: no such file or folder. Must exist.")
        inside = [path] if path.is_file() else sorted(path.rglob("*"))
        clouds = [file for file in inside if file.suffix.lower() in LAS_ENDINGS]
        if not clouds:
            raise ValueError(f"Invalid cloud {path}. Must be, or hold, .las or .laz files.")
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
        If the header is damaged or says that there are no points.
    """
    import laspy

    try:
        with laspy.open(path) as reader:
            header = reader.header
            crs = header.parse_crs()
        copc = header.vlrs.get("CopcInfoVlr")
    except Exception as error:
        raise ValueError(f"Invalid cloud {path}: {_line(error)}. Must have a header.") from error
    if not header.point_count:
        raise ValueError(f"Invalid cloud {path}: no points. Must hold one or more.")
    state = os.stat(path)
    mark = f"{path}|{state.st_size}|{state.st_mtime_ns}"
    key = f"{Path(path).stem}-{hashlib.sha256(mark.encode()).hexdigest()[:12]}"
    box = tuple(map(float, header.mins)), tuple(map(float, header.maxs))
    wkt = "" if crs is None else crs.to_wkt()
    return Source(str(path), key, header.point_count, *box, wkt, bool(copc))


def unpack(source, folder, origin):
    """Write a file's coordinates, from ``origin``, and the boxes of its pieces into ``folder``.

    Raises
    ------
    ValueError
        If the file is damaged.
    """
    folder = Path(folder)
    if source.copc:
        _check_octree(source)
        low, high = np.array(source.low) - origin - 0.01, np.array(source.high) - origin + 0.01
        boxes, counts = np.concatenate([low[:2], high[:2]])[None], np.array([source.n])
    else:
        boxes, counts = [], []

        def write(temporary):
            with open(temporary, "wb") as file:
                for points in _points(source):
                    points = points - origin
                    for first in range(0, len(points), PIECE):
                        xy = points[first : first + PIECE, :2]
                        boxes.append(np.concatenate(_box(xy)))
                        counts.append(len(xy))
                    file.write(points.data)

        write_atomically(folder / f"{source.key}.xyz", write)
    index = {"boxes": np.array(boxes), "counts": np.array(counts)}
    write_atomically(folder / f"{source.key}.npz", lambda path: np.savez(path, **index))


def read_index(source, folder):
    """Return the boxes (m, 4: x low, y low, x high, y high) and counts of a file's pieces."""
    path = Path(folder) / f"{source.key}.npz"
    return read_array(path, "boxes"), read_array(path, "counts")


def read_array(path, name):
    """Return one array of an ``.npz`` file."""
    with _ONE_AT_A_TIME, np.load(path) as arrays:
        return arrays[name]


def is_unpacked(source, folder):
    """Return whether a file's points can be read by place."""
    return source.copc or (Path(folder) / f"{source.key}.xyz").is_file()


def read_box(sources, folder, origin, box):
    """Return the points (n, 3), from ``origin``, within a box (x low, y low, x high, y high).

    Points come in the order of the sources and of their files.

    Raises
    ------
    Damaged
        If a COPC file is damaged there.
    """
    parts = [np.empty((0, 3))]
    for source in sources:
        if source.copc:
            parts.append(_query(source, origin, box))
            continue
        boxes, counts = read_index(source, folder)
        ends = np.cumsum(counts)
        points = np.memmap(Path(folder) / f"{source.key}.xyz", dtype=np.float64, mode="r")
        points = points.reshape(-1, 3)
        for k in np.flatnonzero(overlaps(boxes, box)):
            piece = np.asarray(points[ends[k] - counts[k] : ends[k]])
            parts.append(piece[_within(piece, box)])
    return np.concatenate(parts)


def overlaps(boxes, box):
    """Return the mask of the boxes (m, 4) that share a point with ``box``."""
    x = (boxes[:, 0] <= box[2]) & (boxes[:, 2] >= box[0])
    return x & (boxes[:, 1] <= box[3]) & (boxes[:, 3] >= box[1])


def _points(source):
    """Pieces of a file's points, held against its header."""
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


def _query(source, origin, box):
    """The points of a COPC file in a box, in the order of their coordinates."""
    import laspy

    low = np.maximum(np.array(box[:2]) + origin[:2] - 0.01, source.low[:2])
    high = np.minimum(np.array(box[2:]) + origin[:2] + 0.01, source.high[:2])
    if (low > high).any():
        return np.empty((0, 3))
    with _complete(source), laspy.CopcReader.open(source.path) as reader:
        found = reader.query(laspy.copc.Bounds(low, high))
        points = np.stack([found.x, found.y, found.z], axis=1).astype(np.float64) - origin
    points = points[_within(points, box)]
    return points[np.lexsort(points.T)]


def _check_octree(source):
    """Whether a COPC file's octree, which lies at its end, knows all of its points."""
    from laspy.copc import CopcReader, load_octree_for_query

    with _complete(source), CopcReader.open(source.path) as reader:
        nodes = load_octree_for_query(reader.source, reader.copc_info, reader.root_page)
        known = sum(node.point_count for node in nodes)
        if known != source.n:
            raise ValueError(f"{known} points in its octree where the header says {source.n}")


@contextlib.contextmanager
def _complete(source):
    """Turn whatever the reader of a COPC file raises into :class:`Damaged`."""
    try:
        yield
    except BaseException as error:  # the Rust reader of LAZ panics outside of Exception
        if isinstance(error, KeyboardInterrupt | SystemExit | MemoryError):
            raise
        sentence = f"Invalid cloud {source.path}: {_line(error)}. Must be a complete COPC file."
        raise Damaged(source, sentence) from error


def _within(points, box):
    """The mask of the points in a box."""
    x, y = points[:, 0], points[:, 1]
    return (x >= box[0]) & (x <= box[2]) & (y >= box[1]) & (y <= box[3])


def _line(error):
    """The first line of an error's text, without its full stop."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0].rstrip(". ")
