"""The clouds in ``data_samples``, public clouds that others host, and a folder of larger ones.

:func:`fetch` downloads a public cloud once, :func:`path` names a file that comes with the package.
"""

import hashlib
import os
from io import FileIO
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from mmqa_lab._checks import check_choice, refuse
from mmqa_lab._data import read_toml, shipped_folder

__all__ = ["PUBLIC", "SAMPLES", "fetch", "has_real", "path", "real_path", "road_patch_heads"]
__dir__ = __all__.copy

FOLDER = shipped_folder("data_samples")

# The environment variable that names the folder of larger public clouds.
REAL_VARIABLE = "MMQA_DATA"

# The environment variable that names the folder of downloaded clouds.
CACHE_VARIABLE = "MMQA_CACHE"

# GitHub keeps no larger file: for clouds whose size is not known.
LARGEST_BYTES = 100 * 2**20

_ROWS = read_toml(Path(__file__).with_suffix(".toml"))
SAMPLES = {row["name"]: SimpleNamespace(**row) for row in _ROWS["samples"]}
"""The files of ``data_samples`` by name: file, sha256, licence, origin, units and contents."""


PUBLIC = {row["name"]: SimpleNamespace(**row) for row in _ROWS["public"]}
"""Clouds where their authors published them, by name: url at a commit, hash, size, licence, doi,
origin and contents."""


def fetch(name: str) -> Path:
    """Return the path of a public cloud, which is downloaded if it was not before.

    Downloads are kept in the folder that ``MMQA_CACHE`` names, by default ``~/.cache/mmqa_lab``. A
    file with the right hash stays as it is, and needs no network.

    Parameters
    ----------
    name : str
        A name of ``PUBLIC``, which states licence and origin.

    Returns
    -------
    Path

    Raises
    ------
    ValueError
        If no public cloud has that name, or if the host has another file under its address.
    OSError
        If the host cannot be reached, or the file cannot be written.

    Examples
    --------
    >>> PUBLIC["hdl32e_target"].doi, PUBLIC["hdl32e_target"].licence
    ('10.21105/joss.06948', 'MIT')
    """
    from mmqa_lab.io import write_atomically

    one = PUBLIC[check_choice(name, "public cloud", PUBLIC)]
    target = _cached(one)
    if _hash(target, one.hash) != one.hash:
        write_atomically(target, lambda part: _download(one, part))
    return target


class _Limited(FileIO):
    """A file of a public cloud, which takes no more bytes than that has."""

    one = SimpleNamespace()

    def write(self, part):
        most = self.one.size or LARGEST_BYTES
        what, found = f"public cloud {self.one.name}", f"more than {most} bytes at its address"
        refuse(self.tell() + len(part) > most, what, found, "the published file")
        return super().write(part)


def _download(one, part):
    """Write the bytes of a public cloud into a file, or raise where they are others."""
    import pooch
    import requests

    try:
        with _Limited(part, "wb") as file:
            file.one = one
            pooch.HTTPDownloader(progressbar=True)(one.url, file, None)
    except requests.RequestException as error:
        found = "no answer, or one that was cut short"
        raise OSError(f"Invalid address {one.url}: {found}. Must be reachable once.") from error
    other = _hash(part, one.hash)
    refuse(other != one.hash, f"public cloud {one.name}", f"a file with {other}", one.hash)


def _cached(one):
    """Where a public cloud is kept."""
    cache = Path(os.environ.get(CACHE_VARIABLE) or "~/.cache/mmqa_lab").expanduser()
    return cache / f"{one.name}{Path(one.url).suffix}"


def _hash(file, wanted):
    """The hash of a file, of the kind that is wanted; an empty text if there is none."""
    if not file.is_file():
        return ""
    content = file.read_bytes()
    if wanted.startswith("sha256:"):
        return f"sha256:{hashlib.sha256(content).hexdigest()}"
    return f"blob:{hashlib.sha1(b'blob %d%c' % (len(content), 0) + content).hexdigest()}"


def path(name: str) -> Path:
    """Return the path of a sample by its registered name.

    Parameters
    ----------
    name : str
        A name of ``SAMPLES``.

    Returns
    -------
    Path

    Raises
    ------
    ValueError
        If no sample has that name.

    Examples
    --------
    >>> path("road_patch").name
    'road_patch.laz'
    """
    return FOLDER / SAMPLES[check_choice(name, "sample", SAMPLES)].file


def road_patch_heads() -> dict:
    """Return the road patch split by scan head, without repeated points.

    The two heads passed the patch one after the other. The largest gap in GPS time separates them.

    Returns
    -------
    dict of str to array, shape (n, 3)
        Points of ``head A``, ``head B`` and ``both heads``, m.

    Examples
    --------
    >>> {name: len(points) for name, points in road_patch_heads().items()}
    {'head A': 12265, 'head B': 6373, 'both heads': 18335}
    """
    from mmqa_lab.io import read_cloud

    cloud = read_cloud(path("road_patch"), columns=["gps_time"])
    times = np.sort(cloud["gps_time"])
    first = cloud["gps_time"] <= times[np.argmax(np.diff(times))]
    parts = {"head A": first, "head B": ~first, "both heads": np.ones(len(cloud), dtype=bool)}
    return {name: np.unique(cloud.points[mask], axis=0) for name, mask in parts.items()}


def has_real(relative: str) -> bool:
    """Return whether a public cloud was fetched, or the folder of larger clouds has this file.

    Parameters
    ----------
    relative : str
        A name of ``PUBLIC``, or a path below the folder that ``MMQA_DATA`` names.

    Returns
    -------
    bool
        False also if that variable is not set. Nothing is downloaded.

    Examples
    --------
    >>> has_real("no such file.laz")
    False
    """
    if relative in PUBLIC:
        one = PUBLIC[relative]
        return _hash(_cached(one), one.hash) == one.hash
    root = os.environ.get(REAL_VARIABLE, "")
    return root != "" and (Path(root) / relative).exists()


def real_path(relative: str) -> Path:
    """Return the path of a fetched public cloud, or under the folder that ``MMQA_DATA`` names.

    Parameters
    ----------
    relative : str
        A name of ``PUBLIC``, or a path below that folder.

    Returns
    -------
    Path

    Raises
    ------
    FileNotFoundError
        If the variable is not set, or the file does not exist or was not fetched.

    Examples
    --------
    >>> try:
    ...     real_path("none.laz")
    ... except FileNotFoundError as error:
    ...     print(error)
    Invalid real cloud none.laz. Must be below $MMQA_DATA.
    """
    if not has_real(relative):
        where = "fetched before" if relative in PUBLIC else f"below ${REAL_VARIABLE}"
        raise FileNotFoundError(f"Invalid real cloud {relative}. Must be {where}.")
    if relative in PUBLIC:
        return _cached(PUBLIC[relative])
    return Path(os.environ[REAL_VARIABLE]) / relative
