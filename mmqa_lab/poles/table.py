"""The table of detections that all methods return."""

import numpy as np
import pandas as pd

COLUMNS = (
    *("x_m", "y_m", "z_base_m", "height_m", "diameter_m", "tilt_deg", "score", "method"),
    *("lean_x", "lean_y"),
)


def pole_table(rows, method, *, explain=False):
    """Return candidates as a DataFrame, the accepted ones or all of them with their verdict.

    Parameters
    ----------
    rows : dict of str to array
        ``x_m``, ``y_m`` (the axis at half height), ``z_base_m``, ``height_m``, ``diameter_m``,
        ``lean_x``, ``lean_y`` (m/m), ``score``, ``rejected_by`` (empty for accepted); of the
        component method also ``is_tree``.
    method : str
    explain : bool

    Returns
    -------
    DataFrame
        Ordered by northing, then easting.
    """
    frame = pd.DataFrame(rows)
    frame["tilt_deg"] = np.degrees(np.arctan(np.hypot(frame["lean_x"], frame["lean_y"])))
    frame["method"] = method
    if not explain:
        frame = frame[frame["rejected_by"] == ""]
    columns = [*COLUMNS, *frame.columns.intersection(["is_tree"]), *["rejected_by"] * explain]
    return frame.sort_values(["y_m", "x_m"], ignore_index=True)[columns]


def first_reason(n, **failed):
    """Name, for each of ``n`` candidates, the first test it failed; empty where none.

    Examples
    --------
    >>> first_reason(2, length=np.array([True, False]), tilt=np.array([True, False])).tolist()
    ['length', '']
    """
    reason = np.full(n, "", dtype=object)
    for name, wrong in reversed(failed.items()):
        reason[np.asarray(wrong)] = name
    return reason


def drop_duplicates(rows, distance):
    """Reject what lies nearer than ``distance`` to an accepted candidate with a higher score.

    Writes ``duplicate`` into ``rejected_by`` of the lower one.
    """
    from scipy.spatial import cKDTree

    kept = np.flatnonzero(rows["rejected_by"] == "")
    if len(kept) < 2:
        return
    xy = np.column_stack([rows["x_m"], rows["y_m"]])[kept]
    rank = np.lexsort([xy[:, 0], xy[:, 1], -rows["score"][kept]])
    near = cKDTree(xy).query_ball_point(xy, distance)
    gone = np.zeros(len(kept), dtype=bool)
    for k in rank:
        if not gone[k]:
            gone[[other for other in near[k] if other != k]] = True
    rows["rejected_by"][kept[gone]] = "duplicate"
