"""Several drives over one place: telling them apart, and comparing them with each other."""

import numpy as np

from mmqa_lab._checks import check_positive

GAP_S = 3600.0
"""A drive may pass a place more than once; an hour without points is another drive."""


def split_drives(gps_time, *, gap_s=GAP_S):
    """Return the number of the drive of each point: a gap in time begins a new one.

    Parameters
    ----------
    gps_time : array_like, shape (n,)
        Seconds, in any order.
    gap_s : float
        Shortest gap, s.

    Returns
    -------
    array of int, shape (n,)
        Counted from 0 in the order of time.

    Raises
    ------
    ValueError
        If a time is not finite or the gap is not above zero.

    Examples
    --------
    >>> split_drives([5.0, 90_000.0, 6.0, 90_001.0]).tolist()
    [0, 1, 0, 1]
    """
    time = np.asarray(gps_time, dtype=np.float64)
    if time.ndim != 1 or not len(time) or not np.isfinite(time).all():
        raise ValueError(f"Invalid gps_time of shape {time.shape}. Must be finite seconds.")
    gap = check_positive(gap_s, "gap_s", unit="s")
    order = np.argsort(time, kind="stable")
    number = np.empty(len(time), dtype=int)
    number[order] = np.cumsum(np.diff(time[order], prepend=time[order[0]]) > gap)
    return number


def between_drives(first, second):
    """Return the height differences of two drives at the reference points that both have.

    Parameters
    ----------
    first, second : DataFrame
        From ``height_differences`` at the same reference points.

    Returns
    -------
    DataFrame
        As ``first``, with ``dz_m`` of the first drive less that of the second: relative accuracy,
        in which errors of the reference cancel. ``reason`` is that of whichever has one.

    Raises
    ------
    ValueError
        If the reference points are not the same.

    Examples
    --------
    >>> import pandas as pd
    >>> place = {"x_m": [0.0], "y_m": 0.0, "reference_m": 5.0}
    >>> first = pd.DataFrame(place | {"dz_m": 0.5, "reason": ""})
    >>> between_drives(first, first.assign(dz_m=0.25))["dz_m"].tolist()
    [0.25]
    """
    places = ["x_m", "y_m", "reference_m"]
    if len(first) != len(second) or not np.array_equal(first[places], second[places]):
        raise ValueError("Invalid tables. Must be of the same reference points.")
    reason = first["reason"].where(first["reason"] != "", second["reason"])
    return first.assign(dz_m=first["dz_m"] - second["dz_m"], reason=reason)
