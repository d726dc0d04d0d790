"""The figures of a chart in square cells of a cloud, as quantiles, NetCDF and GeoTIFF."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_choice, check_known, check_points, check_positive
from mmqa_lab._results import sentences
from mmqa_lab.chart_cloud.doubts import is_below_step, of_copies, of_pairs, of_steps
from mmqa_lab.chart_cloud.evaluate import plan_chart
from mmqa_lab.cloud import (
    ON_BORDER,
    cells_of,
    extent,
    sort_into_cells,
    step_of,
    unit_remarks,
)
from mmqa_lab.io import write_atomically, write_raster
from mmqa_lab.metrics import METRICS
from mmqa_lab.planes import CONSISTENT_SCALE
from mmqa_lab.spacing import quadrant_distances
from mmqa_lab.spacing.empty import STEPS

__all__ = ["FIGURES", "map_cloud", "placed", "summarise", "write_map"]


if TYPE_CHECKING:
    import xarray as xr
    from numpy.typing import ArrayLike

FIGURES = {
    "n": ("1", "points in the cell"),
    "density": ("m-2", "points per area of the cell"),
    "d1": ("mm", "median distance to the nearest of the nearest points in four quadrants"),
    "d2": ("mm", "median distance to the second of them"),
    "d3": ("mm", "median distance to the third of them"),
    "d4": ("mm", "median distance to the farthest of them"),
    "f": ("1", "inhomogeneity d4 / d1"),
    "e95": ("mm", "95 % of 30 places in the cell lie within this distance of a point"),
    "incomplete_share": ("1", "share of points with an empty quadrant within the radius"),
    "sigma_mad": ("mm", "1.4826 x median absolute deviation from the plane of the cell's points"),
    "coincident": ("1", "points in the place of another one: they raise the density"),
}
"""Variables of a map with their units and meanings."""

# Fewest points for the sigma_MAD of a cell. A plane fits fewer points too closely.
MINIMUM = 10

# Places of a cell from which the nearest point is sought for e95: as evenly as in ``spacing``. The
# last but one stands for 95 % of them.
CELL_PLACES = np.outer(np.arange(1, 31), STEPS) % 1

# Most cells in the rectangle of a map, 8 GB: 5 km x 5 km for cells of half a metre; and of few
# points, as with one far away by mistake.
MOST_MAP_CELLS, MOST_PER_POINT, ALWAYS = 1e8, 1000, 1e6

ENDINGS = (".nc", ".tif")
"""Endings of maps: NetCDF and GeoTIFF."""

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


def map_cloud(
    points: ArrayLike,
    *,
    cell: float = 0.5,
    radius: float = 0.5,
    metrics: Iterable[str] | Mapping[str, Callable] = (),
) -> xr.Dataset:
    """Evaluate every cell of a cloud.

    Parameters
    ----------
    points : Cloud or array_like, shape (n, 3)
        Easting, northing and height, m.
    cell : float
        Side of the square cells, m. The borders lie at multiples of the side.
    radius : float
        Largest distance of a neighbour in plan, m; one at this distance counts.
    metrics : names of ``metrics.METRICS``, or mapping of names to functions of a chart
        More variables, each of the points of the cell alone: a chart whose outline is the cell.
        One that is a figure of the map already takes its place.

    Returns
    -------
    Dataset
        Dimensions ``y``, ``x`` (centres of the cells, m), and the variables of ``FIGURES`` with
        their units; NaN if not measurable. The attribute ``remarks`` tells what speaks against
        them. e95 is of 30 places, so it scatters by .85 to 1.18 of that of many.

    Raises
    ------
    ValueError
        If the cloud is empty or too wide, or if ``cell`` or ``radius`` is not above zero.

    See Also
    --------
    map_campaign : the same for files of any size.

    References
    ----------
    Pfeifer et al. 2021, section 3.3. doi:10.3390/rs13020237

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(50) * 0.02, np.arange(50) * 0.04)
    >>> found = map_cloud(np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1))
    >>> dict(found.sizes), float(found["d4"].median().round(6))
    ({'y': 4, 'x': 2}, 40.0)
    """
    step, crs = getattr(points, "resolution", np.nan), getattr(points, "crs", None)
    points = check_points(points)
    cell, radius = check_positive(cell, "cell", unit="m"), check_positive(radius, "radius")
    check_extent(points, cell, len(points))
    step = np.fmax(step, step_of(points))
    rise = np.fmax(step, step_of(points[:, 2:]))
    functions = chosen_metrics(metrics)
    index = cells_of(points[:, :2], cell)
    inner = np.ones(len(points), dtype=bool)
    table = evaluated_cells(points, index, inner, cell, radius, functions)
    remarks = unit_remarks(points, crs=crs)
    about = {"cell": cell, "radius": radius, "step": step, "rise": rise, "remarks": remarks}
    found = dataset_of(table, about | {"metrics": list(functions)})
    return found if crs is None else placed(found, crs)


def chosen_metrics(metrics):
    """Return the functions of a chart by their names."""
    if isinstance(metrics, Mapping):
        return dict(metrics)
    return {name: METRICS[check_known(name, "metric", METRICS)] for name in metrics}


def check_extent(points, cell, count):
    """Refuse clouds that are too wide for their points, such as clouds in millimetres."""
    size = np.ptp(extent(points), axis=0)[:2]
    most = min(MOST_MAP_CELLS, ALWAYS + MOST_PER_POINT * count)
    if np.prod(size / cell + 1) > most:
        wide = " x ".join(f"{length / 1000:.4g} km" for length in size)
        told = f"{most / 1e6:.0f} million cells of {cell} m"
        raise ValueError(f"Invalid clouds over {wide}. Must lie in {told}, in metres.")


def evaluated_cells(points, index, inner, cell, radius, metrics):
    """Return a row for each cell with points: its place, figures and metrics, (m, 2 + all of them).

    ``index`` has the points' cells. Points that are not ``inner`` only count as neighbours.
    """
    order, starts, cells = sort_into_cells(index[inner], 1)
    starts, counts = starts[:-1], np.diff(starts)
    group = np.repeat(np.arange(len(cells)), counts)
    rows, radius = np.flatnonzero(inner)[order], radius * (1 + ON_BORDER)
    local = points[:, :2] - cells[0] * cell
    distances = quadrant_distances(local, radius=radius, of=inner)
    distances, own = (np.take(one, rows, axis=0).T.copy() for one in (distances, points))
    deviations = _deviations(own, starts, counts, group)
    *d, middle = _medians([*distances, deviations], group)
    (off,) = _medians([np.abs(deviations - middle[group])], group)
    sigma = np.where(counts >= MINIMUM, CONSISTENT_SCALE * off, np.nan)
    missing = np.add.reduceat(np.isnan(distances[3]).astype(float), starts)
    same = np.add.reduceat(_coincident(own), starts)
    e95 = _empty_space(local, (cells - cells[0])[:, None] + CELL_PLACES, cell, radius)
    *d_mm, e95_mm, sigma_mm = (1000 * length for length in (*d, e95, sigma))
    figures = counts, counts / cell**2, *d_mm, d[3] / d[0], e95_mm, missing / counts
    values = np.full((len(cells), len(metrics)), np.nan)
    for k in np.flatnonzero(counts >= MINIMUM) if metrics else ():
        part = points[rows[starts[k] : starts[k] + counts[k]]] - [*(cells[k] * cell), 0]
        chart = plan_chart(part, cell, radius)
        values[k] = [function(chart) for function in metrics.values()]
    return np.column_stack([cells, *figures, sigma_mm, same, values])


def _medians(rows, group):
    """Median of each group in each row without its NaN; NaN for a group without numbers."""
    return pd.DataFrame(np.transpose(rows)).groupby(group).median().to_numpy().T


def _empty_space(xy, places, cell, radius):
    """e95 of cells with places, shape (cells, places, 2), m; NaN beyond the radius."""
    from scipy.spatial import cKDTree

    tree = cKDTree(xy, leafsize=64, balanced_tree=False, compact_nodes=False)
    away = tree.query(cell * places, [1], distance_upper_bound=radius)[0]
    e95 = np.partition(away[:, :, 0], -2, axis=1)[:, -2]
    return np.where(np.isfinite(e95), e95, np.nan)


def _deviations(xyz, starts, counts, group):
    """Signed distances from the regression planes of the groups, m."""
    local = xyz - xyz[:, starts][:, group]
    local -= (np.add.reduceat(local, starts, axis=1) / counts)[:, group]
    squares = [np.add.reduceat(a * b, starts) for a in local for b in local]
    normals = np.linalg.eigh(np.reshape(squares, (3, 3, -1)).T)[1][:, :, 0]
    return (local * normals.T[:, group]).sum(axis=0)


def _coincident(xyz):
    """1 for a point with the three coordinates of another one, else 0."""
    x, y, z = (xyz + 0.0).view(np.uint64)  # of zeros both signs are one place
    key = x * np.uint64(3**20) + y * np.uint64(5**20) + z * np.uint64(7**20)
    listed = np.sort(key)
    twice = listed[1:][listed[1:] == listed[:-1]]
    found = np.zeros(len(key), dtype=int)
    if len(twice):  # different places may share a key
        same = np.flatnonzero(np.isin(key, twice))
        found[same] = pd.DataFrame(xyz.T[same]).duplicated(keep=False)
    return found


def dataset_of(table, run):
    """Return the Dataset of rows of :func:`evaluated_cells`."""
    import xarray as xr

    cells, cell = table[:, :2].astype(np.int64), run["cell"]
    first = cells.min(axis=0)
    columns, rows = (cells - first).T
    data = {}
    listed = [*FIGURES.items()]
    for name in run["metrics"]:
        known = METRICS.get(name)
        listed.append(
            (name, (known.unit, known.function.__doc__) if known else ("1", "own metric"))
        )
    for (name, (unit, meaning)), values in zip(listed, table.T[2:], strict=True):
        whole = np.full((rows.max() + 1, columns.max() + 1), 0 if name == "n" else np.nan)
        whole[rows, columns] = values
        data[name] = (("y", "x"), whole, {"units": unit, "long_name": meaning})
    places = {"y": first[1] + np.arange(len(whole)), "x": first[0] + np.arange(len(whole[0]))}
    step_mm = 1000 * run["step"]
    below = is_below_step(data["d1"][1], step_mm)
    data["f"][1][below] = np.nan
    axes = {  # by their standard names a GIS finds the place of a map
        name: (
            name,
            (place + 0.5) * cell,
            {"units": "m", "standard_name": f"projection_{name}_coordinate"},
        )
        for name, place in places.items()
    }
    medians = pd.DataFrame(table[:, 2 : 2 + len(FIGURES)], columns=list(FIGURES)).median()
    same = np.nansum(data["coincident"][1]), data["n"][1].sum()
    remarks = [*run["remarks"], *_remarks(medians, run, int(below.sum()), *same)]
    about = {"cell_m": cell, "radius_m": run["radius"], "remarks": " ".join(remarks)}
    return xr.Dataset(data, coords=axes, attrs=about)


def _remarks(medians, run, below, same, count):
    """What speaks against the figures of a map."""
    d1, d2, sigma = medians[["d1", "d2", "sigma_mad"]]
    near = f"f is not measured in {below} cells: points lie nearer than the steps"
    return sentences(
        of_steps(1000 * run["step"], sigma, d1, 1000 * run["rise"]),
        (below, f"{near}, as of tiles that overlap; the density counts both."),
        of_pairs(d1, d2),
        (same, of_copies(same, count)),
    )


def placed(dataset: xr.Dataset, crs: Any) -> xr.Dataset:
    """Return a map with its coordinate reference system, as the CF conventions write it."""
    import pyproj

    mapping = {"grid_mapping": "spatial_ref"}
    figures = {name: figure.assign_attrs(mapping) for name, figure in dataset.items()}
    return dataset.assign(figures).assign_coords(spatial_ref=((), 0, pyproj.CRS(crs).to_cf()))


def summarise(dataset: xr.Dataset) -> pd.DataFrame:
    """Return quantiles of each figure over the cells.

    Parameters
    ----------
    dataset : Dataset
        From :func:`map_cloud` or :func:`open_map`.

    Returns
    -------
    DataFrame
        A row for each figure: ``figure``, ``unit``, ``n`` (cells with a value), ``q05`` to ``q95``.
    """
    names = [name for name in dataset if name != "n"]
    cells = dataset[names].to_dataframe()[names]
    table = cells.quantile(QUANTILES).T.set_axis([f"q{100 * q:02.0f}" for q in QUANTILES], axis=1)
    table.insert(0, "n", cells.count())
    units = [dataset[name].attrs["units"] for name in names]
    table.insert(0, "unit", ["points/m2" if unit == "m-2" else unit for unit in units])
    return table.rename_axis("figure").reset_index()


def write_map(path: str | os.PathLike, dataset: xr.Dataset) -> None:
    """Write a map as NetCDF (``.nc``) or GeoTIFF (``.tif``, a band for each figure).

    Parameters
    ----------
    path : path
        The file to write.
    dataset : Dataset
        From :func:`map_cloud` or :func:`open_map`.

    Raises
    ------
    ValueError
        If the ending is neither of these, if another kind of file is there, or if a GeoTIFF would
        lack a coordinate system.
    """
    path, dataset = Path(path), dataset.sortby(["y", "x"])
    if check_choice(path.suffix.lower(), f"map {path} with ending", ENDINGS) == ".nc":
        write_atomically(path, lambda file: dataset.to_netcdf(file, engine="scipy"))
        return
    if "spatial_ref" not in dataset.coords:
        raise ValueError(f"Invalid map {path}: no coordinate system in the files. Must be .nc.")
    import pyproj

    cell = dataset.attrs["cell_m"]
    write_raster(
        path,
        {str(name): dataset[name].values[::-1] for name in dataset},
        corner=(float(dataset["x"][0]) - cell / 2, float(dataset["y"][-1]) + cell / 2),
        cell=cell,
        crs=pyproj.CRS(dataset["spatial_ref"].attrs["crs_wkt"]),
        units=[dataset[name].attrs.get("units", "") for name in dataset],
    )
