"""Two real drives against airborne heights, and against each other."""

import pandas as pd

from mmqa_lab import io, samples
from mmqa_lab.io import read_heights
from mmqa_lab.testfield import (
    between_drives,
    height_accuracy,
    height_differences,
    split_drives,
    thinned,
)

CLOUD = "road_ground/mls_two_drives.laz"
HEIGHTS = "road_ground/airborne_ground_height.npz"


def at_hand():
    """Whether the real clouds are there."""
    return samples.has_real(CLOUD) and samples.has_real(HEIGHTS)


def compare(*, spacing_m, radius=0.2):
    """Compare two drives over one tile with airborne heights, and with each other.

    Parameters
    ----------
    spacing_m : float
        Squares of the raster from which one cell each is taken; 0.1 m is all cells.
    radius : float
        Of the triangulated surfaces, m.

    Returns
    -------
    dict of str to DataFrame, DataFrame
        The differences by comparison; and the summary: ``comparison``, ``kind`` (absolute or
        relative), ``shift`` and the columns of ``height_accuracy``.
    """
    reference = thinned(read_heights(samples.real_path(HEIGHTS)), spacing_m)
    cloud = io.read_cloud(samples.real_path(CLOUD), columns=("gps_time",))
    drive = split_drives(cloud["gps_time"])
    tables = {
        f"drive {number + 1}": height_differences(
            cloud.points[drive == number], reference, radius=radius
        )
        for number in range(2)
    }
    tables["drive 1 - drive 2"] = between_drives(tables["drive 1"], tables["drive 2"])
    rows = [
        height_accuracy(table).assign(
            comparison=name, accuracy="relative" if "-" in name else "absolute", kind="measured"
        )
        for name, table in tables.items()
    ]
    summary = pd.concat(rows, ignore_index=True)
    names = ["comparison", "accuracy", "kind"]
    return tables, summary[[*names, *summary.columns.drop(names)]]
