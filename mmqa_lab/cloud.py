"""The container that every room hands on: points and their named columns."""

from __future__ import annotations

import html
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_crs, check_points, coordinate_columns, is_table

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from numpy.typing import ArrayLike

__all__ = [
    "Cloud",
    "as_cloud",
]
__dir__ = __all__.copy

PLOTTED = 50_000
"""Points that a plot draws; of larger clouds every k-th."""


class _MissingColumnError(KeyError, ValueError):
    """A column that a cloud does not have."""

    def __str__(self):
        return str(self.args[0])


@dataclass(frozen=True, eq=False, repr=False)
class Cloud:
    """Points and the attributes that came with them.

    A cloud is an array (``np.asarray(cloud)``, shape (n, 3)), it is indexed like one (masks,
    slices, index arrays give a cloud, a number gives a point), and ``cloud["ring"]`` is a column.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Easting, northing, height in metres, float64.
    columns : dict of str to array, shape (n,)
        Named values of each point, kept as read: ``gps_time``, ``intensity``, ``ring``, ...
    name : str
        Where the cloud comes from, for tables and figures.
    resolution : float
        The step that the coordinates were rounded to when they were stored, m; the coarsest of
        the three axes. NaN where it is not known.
    crs : pyproj.CRS or what it is made from, optional
        The coordinate reference system: ``"EPSG:25832"``, well-known text. None where it is not
        known.

    Raises
    ------
    ValueError
        If a coordinate is not finite, a column is not as long as the points, or the coordinate
        reference system is unknown.

    Examples
    --------
    >>> cloud = Cloud([[0, 0, 0], [1, 0, 0]], {"ring": [3, 4]})
    >>> len(cloud), cloud["ring"].tolist()
    (2, [3, 4])
    >>> cloud[cloud["ring"] == 4].points.tolist()
    [[1.0, 0.0, 0.0]]
    >>> cloud
    <Cloud: 2 points, 1.000 m x 0.000 m x 0.000 m, columns ring>
    """

    points: np.ndarray
    columns: Mapping[str, np.ndarray] = field(default_factory=dict)
    name: str = ""
    resolution: float = np.nan
    crs: object = None

    def __post_init__(self):
        points = check_points(self.points, minimum=0)
        columns = {key: np.asarray(values) for key, values in self.columns.items()}
        for key, values in columns.items():
            if values.shape[:1] != (len(points),):
                raise ValueError(
                    f"Invalid column {key!r} of shape {values.shape}. "
                    f"Must have one value for each of {len(points)} points."
                )
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "columns", columns)
        if self.crs is not None:
            object.__setattr__(self, "crs", check_crs(self.crs))

    def __len__(self) -> int:
        return len(self.points)

    def __array__(self, dtype=None, copy=None) -> np.ndarray:
        return np.array(self.points, dtype=dtype, copy=copy)

    def __contains__(self, column: str) -> bool:
        return column in self.columns

    def __getitem__(self, which: str | ArrayLike | slice) -> np.ndarray | Cloud:
        if isinstance(which, str):
            return self._column(which)
        points = self.points[which]
        if points.ndim == 1:
            return points
        columns = {key: values[which] for key, values in self.columns.items()}
        return Cloud(points, columns, self.name, self.resolution, self.crs)

    def _column(self, name):
        """A column, or the sentence that lists those present."""
        if name not in self.columns:
            present = ", ".join(self.columns) or "none"
            raise _MissingColumnError(
                f"Invalid column {name!r}. Must be one of those present: {present}."
            )
        return self.columns[name]

    def __repr__(self) -> str:
        name = f" {self.name!r}" if self.name else ""
        columns = ", ".join(self.columns) or "none"
        return f"<Cloud{name}: {len(self)} points, {self._extent()}, columns {columns}>"

    def _repr_html_(self) -> str:
        rows = {
            "points": f"{len(self):,}",
            "extent": self._extent(),
            "resolution": f"{1000 * self.resolution:g} mm",
            "crs": "not known" if self.crs is None else self.crs.name,
            "columns": ", ".join(self.columns) or "none",
        }
        if np.isnan(self.resolution):
            rows["resolution"] = "not known"
        cells = (
            f"<tr><th>{key}</th><td>{html.escape(text)}</td></tr>" for key, text in rows.items()
        )
        return f"<table><caption>Cloud {html.escape(self.name)}</caption>{''.join(cells)}</table>"

    def _extent(self):
        """Length, width and height of the box round the points, in words."""
        if not len(self):
            return "no extent"
        return " x ".join(f"{side:.3f} m" for side in np.ptp(self.points, axis=0))

    def to_frame(self) -> pd.DataFrame:
        """Return a DataFrame with ``x_m``, ``y_m``, ``z_m`` and the one-valued columns."""
        frame = pd.DataFrame(self.points, columns=["x_m", "y_m", "z_m"])
        plain = {key: values for key, values in self.columns.items() if values.ndim == 1}
        return frame.assign(**plain)

    def to_xarray(self) -> xr.Dataset:
        """Return a Dataset over ``point``: ``x_m``, ``y_m``, ``z_m`` and the one-valued columns."""
        data = self.to_frame().rename_axis("point").to_xarray()
        for axis in ("x_m", "y_m", "z_m"):
            data[axis].attrs["units"] = "m"
        crs = "" if self.crs is None else self.crs.to_wkt()
        return data.assign_attrs(name=self.name, resolution_m=self.resolution, crs_wkt=crs)

    def plot(self, color: str | None = None, *, axes: Sequence[Axes] | None = None) -> np.ndarray:
        """Draw the points from above and, below that, from the side.

        Parameters
        ----------
        color : str, optional
            The column that colours the points; heights when not given.
        axes : two matplotlib Axes, optional
            Where to draw; a new figure when not given.

        Returns
        -------
        array of two matplotlib Axes
            The greater extent of the two in plan lies across the page. Coordinates count from
            whole metres that the labels name. Heights are stretched where they are less than a
            tenth of the length. Of large clouds every k-th point is drawn, 50 000 or fewer.
        """
        import matplotlib.pyplot as plt

        if axes is None:
            axes = plt.subplots(2, 1, layout="constrained")[1]
        shown = self[:: max(1, -(-len(self) // PLOTTED))]
        origin = np.floor(shown.points.min(axis=0)) if len(shown) else np.zeros(3)
        local = shown.points - origin
        extent = np.ptp(local, axis=0) if len(shown) else np.ones(3)
        along, across = (1, 0) if extent[1] > extent[0] else (0, 1)
        values = local[:, 2] if color is None else shown[color]
        labels = [f"{axis} {-start:+.0f} m (m)" for axis, start in zip("xyz", origin, strict=True)]
        for ax, upward in zip(axes, (across, 2), strict=True):
            drawn = ax.scatter(local[:, along], local[:, upward], c=values, s=1, linewidths=0)
            ax.set(xlabel=labels[along], ylabel=labels[upward])
            ax.set_aspect("equal" if 10 * extent[upward] > extent[along] else "auto")
        axes[0].set_title(self.name)
        axes[0].figure.colorbar(drawn, ax=list(axes), label=color or labels[2])
        return np.asarray(axes)

    @classmethod
    def from_frame(cls, frame: pd.DataFrame, *, name: str = "") -> Cloud:
        """Return the cloud of a table with x, y, z (or easting, northing, height) and columns.

        Examples
        --------
        >>> frame = pd.DataFrame({"Easting": [5], "Northing": [6], "Height": [7], "ring": [1]})
        >>> cloud = Cloud.from_frame(frame)
        >>> cloud.points.tolist(), list(cloud.columns)
        ([[5.0, 6.0, 7.0]], ['ring'])
        """
        points = check_points(frame, minimum=0)
        used = coordinate_columns(frame.columns)
        rest = [column for column in frame.columns if len(used) == 3 and column not in used]
        columns = {str(column): frame[column].to_numpy() for column in rest}
        return cls(points, columns, name, crs=getattr(frame, "crs", None))

    @classmethod
    def concatenate(cls, clouds: Iterable[Cloud], *, name: str = "") -> Cloud:
        """Return one cloud of several, with the columns that all of them have.

        Raises
        ------
        ValueError
            If they have different coordinate reference systems.
        """
        clouds = list(clouds)
        if not clouds:
            return cls(np.empty((0, 3)), name=name)
        known = [cloud.crs for cloud in clouds if cloud.crs is not None]
        other = next((crs for crs in known if crs != known[0]), None)
        if other is not None:
            raise ValueError(f"Invalid clouds in {known[0].name} and {other.name}. Must be in one.")
        shared = [key for key in clouds[0].columns if all(key in cloud for cloud in clouds)]
        columns = {key: np.concatenate([cloud[key] for cloud in clouds]) for key in shared}
        coarsest = float(np.max([cloud.resolution for cloud in clouds]))
        points = np.concatenate([cloud.points for cloud in clouds])
        return cls(points, columns, name, coarsest, known[0] if known else None)


def as_cloud(points: Cloud | ArrayLike | pd.DataFrame | str | os.PathLike) -> Cloud:
    """Return points of any kind as a cloud, with the columns that came with them.

    Parameters
    ----------
    points : Cloud, array_like of shape (n, 3), DataFrame or path
        A DataFrame has columns x, y, z (or easting, northing, height); a path is of a file that
        ``io.read_cloud`` reads.

    Returns
    -------
    Cloud

    Raises
    ------
    ValueError, TypeError, FileNotFoundError
        If they are no points.

    Examples
    --------
    >>> as_cloud([[1, 2, 3]])
    <Cloud: 1 points, 0.000 m x 0.000 m x 0.000 m, columns none>
    >>> as_cloud(pd.DataFrame({"x": [1], "y": [2], "z": [3], "ring": [4]}))["ring"].tolist()
    [4]
    """
    if isinstance(points, Cloud):
        return points
    if isinstance(points, str | os.PathLike):
        from mmqa_lab.io import read_cloud

        return read_cloud(points)
    if is_table(points):
        return Cloud.from_frame(points)
    return Cloud(check_points(points, minimum=0))


class _Cells(NamedTuple):
    """What :func:`sort_into_cells` gives."""

    order: np.ndarray
    starts: np.ndarray
    places: np.ndarray


def sort_into_cells(points: np.ndarray, size: float) -> _Cells:
    """Sort points into square or cubic cells whose borders lie at multiples of their size.

    Parameters
    ----------
    points : array, shape (n, d)
        Coordinates, in any unit; one point or more.
    size : float
        Side of the cells, in that unit.

    Returns
    -------
    order : array of int, shape (n,)
        The points' rows, cell by cell; within a cell as they came.
    starts : array of int, shape (m + 1,)
        Cell k has the points ``order[starts[k]:starts[k + 1]]``.
    places : array of int, shape (m, d)
        Place of each cell with points, in cells from the origin; the last axis runs fastest.

    Raises
    ------
    ValueError
        If the box around the points has too many cells to be numbered.

    Examples
    --------
    >>> cells = sort_into_cells(np.array([[0.9, 0.2], [0.1, 0.1], [0.8, 0.3]]), 0.5)
    >>> cells.order.tolist(), cells.starts.tolist(), cells.places.tolist()
    ([1, 0, 2], [0, 1, 3], [[0, 0], [1, 0]])
    """
    index = np.floor(np.ascontiguousarray(points.T) / size).astype(np.int64)
    low = index.min(axis=1)
    wide = index.max(axis=1) - low + 1
    if np.prod(wide.astype(float)) > 2.0**62:
        raise ValueError(f"Invalid cell size {size}. Must be larger for a cloud as wide as this.")
    key = np.zeros(index.shape[1], np.int64)
    for along, first, count in zip(index, low, wide, strict=True):
        key = key * count + (along - first)
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    return _Cells(order, np.append(first, len(order)), index[:, order[first]].T.copy())
