"""The command that finds poles."""

from pathlib import Path
from typing import Literal

from mmqa_lab._checks import check_upright
from mmqa_lab.commands.machine import (
    progress,
    table,
)

__all__ = ["poles"]


@table
def poles(
    clouds: list[Path],
    /,
    *,
    method: Literal["learned", "fgi", "itc"] = "learned",
    trajectory: Path | None = None,
    corridor: float | None = None,
    reference: Path | None = None,
):
    """Detect poles in clouds of one street, and score them against a reference.

    Method learned takes any cloud. Method fgi follows scan lines (Lehtomaki et al. 2010), itc
    connected components (Pu et al. 2011).

    Parameters
    ----------
    clouds
        Cloud files: LAS, LAZ, COPC, PLY or text.
    method
        The detector.
    trajectory
        CSV file of the path. Known poles and finds beyond the corridor along it do not count.
    corridor
        Half of the corridor's width, m.
    reference
        CSV file of known poles with x_m, y_m. Prints recall and precision.
    """
    import numpy as np

    from mmqa_lab import io, poles
    from mmqa_lab.cloud import Cloud

    parts = []
    for number, file in enumerate(progress(clouds, "cloud")):
        cloud = io.read_cloud(file)
        check_upright(f"cloud {file}", cloud.crs)
        head = {"head": np.full(len(cloud), number)} if len(clouds) > 1 else {}
        parts.append(Cloud(cloud.points, head | dict(cloud.columns), file.stem, crs=cloud.crs))
    path = None
    if trajectory is not None:
        path = io.read_trajectory(trajectory, crs=parts[0].crs)[["easting_m", "northing_m"]]
    found = poles.detect(Cloud.concatenate(parts), method=method)
    if reference is None:
        return found
    known = io.read_table(reference, "reference", ("x_m", "y_m"))
    return poles.score(found, known, trajectory=path, corridor=corridor).to_frame()
