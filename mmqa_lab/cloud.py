"""The container that every room hands on: points and their named columns."""

from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_points


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points and the attributes that came with them.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Easting, northing, height in metres, float64.
    columns : dict of str to array, shape (n,)
        Named values of each point, kept as read: ``gps_time``, ``intensity``, ``ring``, ...
    name : str
        Where the cloud comes from, for tables and figures.

    Raises
    ------
    ValueError
        If a coordinate is not finite or a column is not as long as the points.

    Examples
    --------
    >>> cloud = Cloud([[0, 0, 0], [1, 0, 0]], {"ring": [3, 4]})
    >>> len(cloud), cloud["ring"].tolist()
    (2, [3, 4])
    >>> cloud.select(cloud["ring"] == 4).points.tolist()
    [[1.0, 0.0, 0.0]]
    """

    points: np.ndarray
    columns: dict = field(default_factory=dict)
    name: str = ""

    def __post_init__(self):
        points = check_points(self.points, minimum=0)
        columns = {key: np.asarray(values) for key, values in self.columns.items()}
        for key, values in columns.items():
            if values.shape[:1] != (len(points),):
                raise ValueError(
                    f"Invalid column {key!r} of shape {values.shape}. "
                    f"Must hold one value for each of {len(points)} points."
                )
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "columns", columns)

    def __len__(self):
        return len(self.points)

    def __contains__(self, column):
        return column in self.columns

    def __getitem__(self, column):
        if column not in self.columns:
            present = ", ".join(self.columns) or "none"
            raise ValueError(f"Invalid column {column!r}. Must be one of those present: {present}.")
        return self.columns[column]

    def select(self, which):
        """Return the points where a mask holds, or those of an index array, with their columns."""
        columns = {key: values[which] for key, values in self.columns.items()}
        return Cloud(self.points[which], columns, self.name)

    def to_frame(self):
        """Return a DataFrame with ``x_m``, ``y_m``, ``z_m`` and the one-valued columns."""
        frame = pd.DataFrame(self.points, columns=["x_m", "y_m", "z_m"])
        plain = {key: values for key, values in self.columns.items() if values.ndim == 1}
        return frame.assign(**plain)

    @classmethod
    def concatenate(cls, clouds, *, name=""):
        """Return one cloud of several, with the columns that all of them have."""
        clouds = list(clouds)
        if not clouds:
            return cls(np.empty((0, 3)), name=name)
        shared = [key for key in clouds[0].columns if all(key in cloud for cloud in clouds)]
        columns = {key: np.concatenate([cloud[key] for cloud in clouds]) for key in shared}
        return cls(np.concatenate([cloud.points for cloud in clouds]), columns, name)
