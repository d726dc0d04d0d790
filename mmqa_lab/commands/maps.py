"""The command that maps a campaign."""

import warnings
from pathlib import Path

from mmqa_lab._checks import needs
from mmqa_lab.commands.machine import check_ending, table
from mmqa_lab.commands.metrics import metrics_of

__all__ = ["map_"]


@table
def map_(clouds: list[Path], /, *, out: Path, cell: float = 0.5, metrics: str | None = None):
    """Map the quality of a campaign: density, d1..d4, f, sigma_MAD in every cell.

    The tiles of the map are kept in a folder beside it, whose name ends in .run. An interrupted
    run continues from there.

    Parameters
    ----------
    clouds
        Cloud files (LAS, LAZ, COPC, PLY or text), and folders of LAS, LAZ or COPC files.
    out
        Write the map into this file: .nc (NetCDF) or .tif (GeoTIFF).
    cell
        Side of the square cells, m.
    metrics
        More metrics, such as e95_of_3,noise_of_a_mean,MODULE:FUNCTION, or all; see evaluate.
    """
    from mmqa_lab import maps

    check_ending(out, "map", maps.ENDINGS)
    if out.suffix.lower() == ".tif":
        needs("files", "rasterio")
    chosen = metrics_of(metrics)
    with warnings.catch_warnings(action="ignore"):  # the map has them as remarks
        folder = maps.map_campaign(clouds, out.with_suffix(".run"), cell=cell, metrics=chosen)
    dataset = maps.open_map(folder)
    maps.write_map(out, dataset)
    return maps.summarise(dataset).assign(remarks=dataset.attrs["remarks"])
