"""The small clouds in ``data_samples`` and the larger public ones outside the repository."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mmqa_lab import _shipped
from mmqa_lab._checks import check_choice

__all__ = ["has_real", "path", "real_path", "road_patch_heads"]

FOLDER = _shipped("data_samples")

REAL_VARIABLE = "MMQA_DATA"
"""The environment variable that names the folder of larger public clouds."""


@dataclass(frozen=True)
class Sample:
    """A file of ``data_samples`` and where it comes from.

    Parameters
    ----------
    name : str
        By which :func:`path` finds it.
    file : str
        In ``data_samples``.
    sha256 : str
        Of the file, hexadecimal.
    licence, origin : str
    units : str
        Of the coordinates, and their reference system.
    contents : str
    """

    name: str
    file: str
    sha256: str
    licence: str
    origin: str
    units: str
    contents: str


SAMPLES = (
    Sample(
        name="road_patch",
        file="road_patch.laz",
        sha256="2251306106cd2aaaf4d67b30a81704b421c7d46de0e49eebcd2d87efc00b5948",
        licence="BSD-2-Clause (LICENSE-laspy.txt)",
        origin="laspy 2.7.0 source distribution on PyPI, tests/data/plane.laz",
        units="m, s; projected, system not stated",
        contents="2.2 m x 2.0 m of road, crossing scan heads, rounded to 1 cm",
    ),
    Sample(
        name="chart_a_5m",
        file="chart_a_5m.laz",
        sha256="145bf398a38a02f645f298d54ff9b84fff97bd2c92da5748c075e990468117fe",
        licence="MIT, as the package",
        origin="simulate.systems.pass_chart(SYSTEM_A, 5.0, seed=1) past a chart of 40 cells, moved "
        "to UTM coordinates",
        units="m, s, degrees; simulated",
        contents="1 m x 1 m chart at 5 m by a profile scanner, with range and incidence as truth",
    ),
    Sample(
        name="chart_b_5m",
        file="chart_b_5m.copc.laz",
        sha256="a1fa23c5fdfc2df4928a795fd3f2dd9617f2f4519343528206034629397b07e1",
        licence="MIT, as the package",
        origin="simulate.systems.pass_chart(SYSTEM_B, 5.0, seed=1) past a chart of 40 cells, moved "
        "to UTM coordinates",
        units="m, s; simulated",
        contents="the same chart by a rotating scanner of 32 beams, as a COPC file",
    ),
)


def path(name: str) -> Path:
    """Return the path of a sample by its registered name.

    Parameters
    ----------
    name : str

    Returns
    -------
    Path

    Raises
    ------
    ValueError
        If no sample has that name.
    FileNotFoundError
        If the registered file is missing.

    Examples
    --------
    >>> path("road_patch").name
    'road_patch.laz'
    """
    check_choice(name, "sample", tuple(sample.name for sample in SAMPLES))
    sample = next(sample for sample in SAMPLES if sample.name == name)
    found = FOLDER / sample.file
    if not found.is_file():
        raise FileNotFoundError(f"Invalid sample {found}: no such file. Must exist.")
    return found


def road_patch_heads() -> dict:
    """Return the road patch parted by scan head, without repeated points.

    The two heads passed it one after the other, so the largest gap in GPS time parts them.

    Returns
    -------
    dict of str to array, shape (n, 3)
        ``head A``, ``head B`` and ``both heads``, m.

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
        False without that variable.

    Examples
    --------
    >>> has_real("no such file.laz")
    False
    """
    root = os.environ.get(REAL_VARIABLE)
    return bool(root) and (Path(root) / relative).exists()


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
        If the variable is not set or the file is not there.

    Examples
    --------
    >>> try:
    ...     real_path("none.laz")
    ... except FileNotFoundError as error:
    ...     print(str(error).split(" with ")[0])
    Invalid real cloud none.laz
    """
    if not has_real(relative):
        root = os.environ.get(REAL_VARIABLE, "")
        raise FileNotFoundError(
            f"Invalid real cloud {relative} with {REAL_VARIABLE}={root!r}. "
            "Must exist in the folder which that environment variable names."
        )
    return Path(os.environ[REAL_VARIABLE]) / relative
