"""The test configuration: pairs of charts along a line, and what a drive past them must keep to.

Pfeifer et al. 2021, section 4.1: three pairs of boards stand along one line, one pair parallel to
it, two pairs across it. The vehicle passes on straight lines 5 m and 10 m beside them, at 40 km/h
or faster. Forward and backward views are of boards across the path. Here the first pair faces the
vehicle as it comes and the last as it leaves, which the paper does not print. The control points of
the paper's site are left out.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_positive
from mmqa_lab.chart_image.mapping import four_corners, rectangle_frame

ALONG, AHEAD, BEHIND = "orthogonal", "forward", "backward"

PLACE = ["easting_m", "northing_m", "height_m"]


@dataclass(frozen=True)
class Limits:
    """What a test drive must keep to while it passes a chart.

    The paper gives distance and smallest speed; the tolerances are this package's own.

    Parameters
    ----------
    distance_m, distance_tolerance_m : float
        Between the path and the line of charts.
    speed_kmh : float
        At least.
    roll_deg, pitch_deg : float
        Largest values to either side.
    heading_deg : float
        Largest angle between heading and the line of charts.
    reach_m : float
        The drive counts so far before and after the chart.

    Raises
    ------
    ValueError
        If a limit is not above zero.

    Examples
    --------
    >>> Limits(distance_m=5).speed_kmh
    40.0
    """

    distance_m: float
    distance_tolerance_m: float = 0.5
    speed_kmh: float = 40.0
    roll_deg: float = 3.0
    pitch_deg: float = 3.0
    heading_deg: float = 5.0
    reach_m: float = 12.0

    def __post_init__(self):
        for name, value in vars(self).items():
            check_positive(value, name)


def chart_site(*, spacing=10.0, height=1.5, size=1.0):
    """Return the test site: three pairs of boards on a line that runs north at easting 0.

    The vehicle drives north, west of the line. The first pair faces south, to be seen ahead; the
    second stands along the line and faces west; the third faces north, to be seen behind. The paper
    does not say how far apart the pairs are, how high they stand and which way they face.

    Parameters
    ----------
    spacing : float
        Between the pairs, metres; the two boards of a pair are one size apart.
    height : float
        Of the boards' middle above the ground, metres.
    size : float
        Side of a board, metres.

    Returns
    -------
    DataFrame
        A row for each of six boards: ``chart``, ``kind`` (image or point), ``view`` and ``corners``
        (array (4, 3) from the lower left as one looks at it: easting, northing, height, metres).

    Raises
    ------
    ValueError
        If a length is not above zero.

    References
    ----------
    Pfeifer et al. 2021, section 4.1. doi:10.3390/rs13020237

    Examples
    --------
    >>> chart_site()["chart"].tolist()[:3]
    ['image forward', 'point forward', 'image orthogonal']
    """
    for name, value in (("spacing", spacing), ("height", height), ("size", size)):
        check_positive(value, name, unit="m")
    # to the right as one looks at the board
    rightward = {AHEAD: (1.0, 0.0, 0.0), ALONG: (0.0, -1.0, 0.0), BEHIND: (-1.0, 0.0, 0.0)}
    rows = []
    for number, (view, right) in enumerate(rightward.items()):
        step = np.array([0.0, 1.0, 0.0] if view == ALONG else [1.0, 0.0, 0.0])
        for place, kind in enumerate(("image", "point")):
            middle = np.array([0.0, number * spacing, height]) + 2 * size * place * step
            aside, up = np.array(right) * size / 2, np.array([0.0, 0.0, size / 2])
            corners = middle + [-aside - up, aside - up, aside + up, up - aside]
            rows.append((f"{kind} {view}", kind, view, corners))
    return pd.DataFrame(rows, columns=["chart", "kind", "view", "corners"])


def choose_images(stations, corners, *, distance):
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
    middle, right, normal = _frame(corners)
    away = _places(stations) - middle
    view = _view(right, normal, away)
    seen = pd.DataFrame(
        {
            "distance_m": np.linalg.norm(away, axis=1),
            "off_normal_deg": np.degrees(np.arctan2(np.abs(away @ right), away @ normal)),
        },
        index=stations.index,
    )
    seen = seen[away @ normal > 0]
    if view != ALONG:
        seen = seen[seen["distance_m"] >= distance]
    if seen.empty:
        return pd.DataFrame([{"view": view, "station": None, **dict.fromkeys(seen, np.nan)}])
    station = seen["off_normal_deg" if view == ALONG else "distance_m"].idxmin()
    return pd.DataFrame([{"view": view, "station": station, **seen.loc[station]}])


def check_drive(trajectory, corners, limits):
    """Check a drive past a board that stands along it: distance, speed and attitude.

    Parameters
    ----------
    trajectory : DataFrame
        As :func:`mmqa_lab.io.read_trajectory` gives it; angles are checked where present. Headings
        count clockwise from north.
    corners : array_like, shape (4, 3)
        Of a board along the path, from the lower left counterclockwise, metres.
    limits : Limits

    Returns
    -------
    DataFrame
        Per quantity: ``quantity``, ``low``, ``high`` (extremes near the board), ``at_least``,
        ``at_most``, ``n`` values, ``passed``. Angles that the trajectory lacks are left out.

    Raises
    ------
    ValueError
        If fewer than two poses lie near the board, or it stands across the path.

    References
    ----------
    Pfeifer et al. 2021, section 4.1. doi:10.3390/rs13020237

    Examples
    --------
    >>> north = np.linspace(-10, 30, 41)
    >>> drive = {"time_s": north / 12, "easting_m": -5.0, "northing_m": north, "height_m": 1.5}
    >>> corners = chart_site().set_index("chart")["corners"]["image orthogonal"]
    >>> found = check_drive(pd.DataFrame(drive), corners, Limits(distance_m=5))
    >>> found["low"].round(6).tolist(), found["passed"].tolist()
    ([5.0, 43.2], [True, True])
    """
    middle, right, normal = _frame(corners)
    places = _places(trajectory) - middle
    if _view(right, normal, places) != ALONG:
        raise ValueError("Invalid board: stands across the path. Must stand along it.")
    near = np.abs(places @ right) <= limits.reach_m
    if near.sum() < 2:
        raise ValueError(f"Invalid trajectory: {near.sum()} poses near the board. Must be two.")
    steps = np.linalg.norm(np.diff(places[near], axis=0), axis=1)
    speed = 3.6 * steps / np.diff(trajectory["time_s"].to_numpy()[near])
    away, slack = limits.distance_m, limits.distance_tolerance_m
    checked = {
        "distance_m": ((places @ normal)[near], away - slack, away + slack),
        "speed_kmh": (speed, limits.speed_kmh, np.inf),
    }
    azimuth = np.degrees(np.arctan2(*right[:2]))
    for name, reference in (("roll_deg", 0.0), ("pitch_deg", 0.0), ("heading_deg", azimuth)):
        if name in trajectory:
            angles = trajectory[name].to_numpy(dtype=float)[near] - reference
            # the board's line has no direction
            turn = 180 if name == "heading_deg" else 360
            limit = getattr(limits, name)
            checked[name] = ((angles + turn / 2) % turn - turn / 2, -limit, limit)
    rows = [
        (name, values.min(), values.max(), least, most, len(values))
        for name, (values, least, most) in checked.items()
    ]
    table = pd.DataFrame(rows, columns=["quantity", "low", "high", "at_least", "at_most", "n"])
    table["quantity"] = table["quantity"].replace("heading_deg", "heading_from_line_deg")
    return table.assign(
        passed=(table["low"] >= table["at_least"]) & (table["high"] <= table["at_most"])
    )


def _frame(corners):
    """Middle of a board, its level direction to the right and its outward normal."""
    middle, right, up = rectangle_frame(four_corners(corners, columns=3))
    return middle, right, np.cross(right, up)


def _places(stations):
    """Eastings, northings and heights of two or more stations."""
    missing = set(PLACE) - set(stations.columns)
    if missing:
        raise ValueError(f"Invalid stations: no column {sorted(missing)[0]!r}. Must have one.")
    if len(stations) < 2:
        raise ValueError(f"Invalid stations: {len(stations)} given. Must be two or more.")
    return stations[PLACE].to_numpy(dtype=float)


def _view(right, normal, places):
    """How a straight drive sees a board: as it passes, ahead, or behind."""
    travel = places[-1] - places[0]
    facing = travel @ normal
    if abs(facing) <= abs(travel @ right):
        return ALONG
    return AHEAD if facing < 0 else BEHIND
