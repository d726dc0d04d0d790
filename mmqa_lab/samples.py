"""The small clouds in ``data_samples`` and larger public clouds outside the repository."""

import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from mmqa_lab._checks import check_choice
from mmqa_lab._data import read_toml, shipped_folder

__all__ = ["has_real", "path", "real_path", "road_patch_heads"]
__dir__ = __all__.copy

FOLDER = shipped_folder("data_samples")

# The environment variable that names the folder of larger public clouds.
REAL_VARIABLE = "MMQA_DATA"

_ROWS = read_toml(Path(__file__).with_suffix(".toml"))["samples"]
SAMPLES = {row["name"]: SimpleNamespace(**row) for row in _ROWS}
"""The files of ``data_samples`` by name: file, sha256, licence, origin, units and contents."""


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
    """Return whether the folder of larger clouds contains this file.

    Parameters
    ----------
    relative : str
        Path below the folder that ``MMQA_DATA`` names.

    Returns
    -------
    bool
        False also if that variable is not set.

    Examples
    --------
    >>> has_real("no such file.laz")
    False
    """
    root = os.environ.get(REAL_VARIABLE, "")
    return root != "" and (Path(root) / relative).exists()


def real_path(relative: str) -> Path:
    """Return the path of a larger public cloud under the folder that ``MMQA_DATA`` names.

    Parameters
    ----------
    relative : str
        Path below that folder.

    Returns
    -------
    Path

    Raises
    ------
    FileNotFoundError
        If the variable is not set or the file does not exist.

    Examples
    --------
    >>> try:
    ...     real_path("none.laz")
    ... except FileNotFoundError as error:
    ...     print(error)
    Invalid real cloud none.laz. Must be below $MMQA_DATA.
    """
    if not has_real(relative):
        raise FileNotFoundError(f"Invalid real cloud {relative}. Must be below ${REAL_VARIABLE}.")
    return Path(os.environ[REAL_VARIABLE]) / relative
