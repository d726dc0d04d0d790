"""The test site: where charts stand, and which images count.

Pfeifer et al. 2021, section 4.1: three pairs of boards stand along one line, one pair parallel to
it, two pairs across it. The vehicle passes on straight lines 5 m and 10 m beside them, at 40 km/h
or faster. Forward and backward views are of boards across the path. Here the first pair faces the
vehicle as it comes and the last as it leaves, which the paper does not print. The control points of
the paper's site are left out.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_columns, check_points, check_positive, refuse
from mmqa_lab.chart_image.maps import four_corners

__all__ = ["PLACE_COLUMNS", "chart_site", "choose_images"]

ALONG, AHEAD, BEHIND = "orthogonal", "forward", "backward"

PLACE_COLUMNS = ["easting_m", "northing_m", "height_m"]


def chart_site() -> pd.DataFrame:
    """Return the test site: three pairs of boards on a line that runs north at easting 0.

    The vehicle drives north, west of the line. The first pair faces south, to be seen ahead; the
    second stands along the line and faces west; the third faces north, to be seen behind. The
    boards of 1 m x 1 m stand 1 m apart in a pair, their middle is 1.5 m high, and the pairs are
    10 m apart. The paper does not say how far apart pairs are, how high they stand and which way
    they face.

    Returns
    -------
    DataFrame
        A row for each of six boards: ``chart``, ``kind`` (image or point), ``view`` and ``corners``
        (array (4, 3) from the lower left as one looks at it: easting, northing, height, metres).

    References
    ----------
    Pfeifer et al. 2021, section 4.1. doi:10.3390/rs13020237

    Examples
    --------
    >>> chart_site()["chart"].tolist()[:3]
    ['image forward', 'point forward', 'image orthogonal']
    """
    # to the right as one looks at the board
    rightward = {AHEAD: (1.0, 0.0, 0.0), ALONG: (0.0, -1.0, 0.0), BEHIND: (-1.0, 0.0, 0.0)}
    rows = []
    for number, (view, right) in enumerate(rightward.items()):
        step = np.array([0.0, 1.0, 0.0] if view == ALONG else [1.0, 0.0, 0.0])
        for place, kind in enumerate(("image", "point")):
            middle = np.array([0.0, 10.0 * number, 1.5]) + 2 * place * step
            aside, up = np.array(right) / 2, np.array([0.0, 0.0, 0.5])
            corners = middle + [-aside - up, aside - up, aside + up, up - aside]
            rows.append((f"{kind} {view}", kind, view, corners))
    return pd.DataFrame(rows, columns=["chart", "kind", "view", "corners"])


def choose_images(stations: pd.DataFrame, corners: ArrayLike, *, distance: float) -> pd.DataFrame:
    """Choose the image of a board by the paper's rules.

    For a board across the path it is the closest image at the required distance or farther (section
    3.2). For a board along the path it is the image that the vehicle takes as it passes, which may
    be somewhat nearer or farther (section 4.1).

    Parameters
    ----------
    stations : DataFrame
        Places of the images, ``easting_m``, ``northing_m``, ``height_m``, in the order of a
        straight drive; two or more.
    corners : array_like, shape (4, 3)
        Of the board, from the lower left counterclockwise, metres.
    distance : float
        Required distance between camera and middle of the board, metres.

    Returns
    -------
    DataFrame
        One row: ``view`` (orthogonal, forward or backward, as the board stands to the drive),
        ``station`` (row of ``stations``; None where no image qualifies), ``distance_m`` and
        ``off_normal_deg``, the level angle between the line of sight and the board's normal.

    Raises
    ------
    ValueError
        If the distance is not above zero, or there are fewer than two stations.

    References
    ----------
    Pfeifer et al. 2021, sections 3.2 and 4.1. doi:10.3390/rs13020237

    Examples
    --------
    >>> north = [-24.0, -16.0, -8.0, 0.0, 8.0, 16.0]
    >>> stations = pd.DataFrame({"easting_m": -5.0, "northing_m": north, "height_m": 1.5})
    >>> boards = chart_site().set_index("chart")["corners"]
    >>> found = choose_images(stations, boards["image forward"], distance=10)
    >>> found[["view", "station"]].to_numpy().tolist(), found["distance_m"].round(1).item()
    ([['forward', 1]], 16.8)
    >>> found = choose_images(stations, boards["image orthogonal"], distance=10)
    >>> found["distance_m"].round(1).item()
    5.4
    """
    distance = check_positive(distance, "distance", unit="m")
    check_columns(stations, PLACE_COLUMNS, "stations")
    refuse(len(stations) < 2, "stations", f"{len(stations)} given", "two or more")
    places = check_points(stations[PLACE_COLUMNS].to_numpy(), name="stations")
    corners = four_corners(corners, columns=3)
    right, up = corners[[1, 3]] - corners[0] + corners[2] - corners[[3, 1]]
    right, up = right / np.linalg.norm(right), up / np.linalg.norm(up)
    normal = np.cross(right, up)
    away = places - corners.mean(axis=0)
    view = _view(right, normal, away)
    angle = np.degrees(np.arctan2(np.abs(away @ right), away @ normal))
    seen = {"distance_m": np.linalg.norm(away, axis=1), "off_normal_deg": angle}
    seen = pd.DataFrame(seen)[away @ normal > 0]
    if view != ALONG:
        seen = seen[seen["distance_m"] >= distance]
    if seen.empty:
        return pd.DataFrame([{"view": view, "station": None, **dict.fromkeys(seen, np.nan)}])
    station = seen["off_normal_deg" if view == ALONG else "distance_m"].idxmin()
    return pd.DataFrame([{"view": view, "station": station, **seen.loc[station]}])


def _view(right, normal, places):
    """How a straight drive sees a board: as it passes, ahead, or behind."""
    travel = places[-1] - places[0]
    facing = travel @ normal
    if abs(facing) <= abs(travel @ right):
        return ALONG
    return AHEAD if facing < 0 else BEHIND
