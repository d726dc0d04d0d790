"""The test configuration: pairs of charts along a drive, and what a drive must keep to."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_number, check_points, check_positive

VIEWS = ("forward", "orthogonal", "backward")

ORTHOGONAL_DEG = 30.0
"""A view is orthogonal while its direction leaves the chart's normal by less."""

COLUMNS = ["time_s", "easting_m", "northing_m", "height_m"]


@dataclass(frozen=True)
class Limits:
    """What a test drive must keep to while it passes a chart.

    Parameters
    ----------
    distance_m, distance_tolerance_m : float
        Between the path and the chart's plane.
    speed_kmh, speed_tolerance_kmh : float
    roll_deg, pitch_deg : float
        Largest values to either side.
    heading_deg : float
        Largest angle between heading and the chart's plane.
    reach_m : float
        The drive counts so far before and after the chart.

    Raises
    ------
    ValueError
        If a limit is not above zero.

    Examples
    --------
    >>> limits = Limits(distance_m=5)
    >>> limits.speed_kmh - limits.speed_tolerance_kmh
    35.0
    """

    distance_m: float
    distance_tolerance_m: float = 0.5
    speed_kmh: float = 40.0
    speed_tolerance_kmh: float = 5.0
    roll_deg: float = 3.0
    pitch_deg: float = 3.0
    heading_deg: float = 5.0
    reach_m: float = 12.0

    def __post_init__(self):
        for name, value in vars(self).items():
            check_positive(value, name)


def chart_site(*, distances=(5.0, 10.0), spacing=10.0, height=1.5, size=1.0):
    """Return a straight test site: a pair of charts beside each of two driving axes.

    The axes run north; the charts of a pair, image chart first, stand to the right of them and face
    west.

    Parameters
    ----------
    distances : sequence of float
        From each axis to its charts, metres.
    spacing : float
        Between charts along the axis, metres.
    height : float
        Of the charts' middle above the ground, metres.
    size : float
        Side of a chart, metres.

    Returns
    -------
    DataFrame
        A row per chart: ``chart``, ``kind``, ``axis_m`` (distance), ``corners`` (array (4, 3) from
        the lower left as seen from the axis, metres: easting, northing, height).

    Raises
    ------
    ValueError
        If a distance is not above zero.

    Examples
    --------
    >>> chart_site()["chart"].tolist()
    ['image 5 m', 'point 5 m', 'image 10 m', 'point 10 m']
    """
    rows = []
    for distance in distances:
        distance = check_positive(distance, "distance", unit="m")
        for kind in ("image", "point"):
            north = spacing * len(rows)
            # to the left as one faces the chart from the west is north
            low = np.array([distance, north + size / 2, height - size / 2])
            along, up = np.array([0.0, -size, 0.0]), np.array([0.0, 0.0, size])
            corners = np.stack([low, low + along, low + along + up, low + up])
            rows.append((f"{kind} {distance:g} m", kind, distance, corners))
    return pd.DataFrame(rows, columns=["chart", "kind", "axis_m", "corners"])


def choose_images(stations, corners, *, distance):
    """Choose the image of each view by the paper's rule: the closest at the distance or farther.

    Parameters
    ----------
    stations : DataFrame
        Places of the images: ``time_s``, ``easting_m``, ``northing_m``, ``height_m``, in the order
        of the drive.
    corners : array_like, shape (4, 3)
        Of the chart, from the lower left counterclockwise, metres.
    distance : float
        Required distance between camera and middle of the chart, metres.

    Returns
    -------
    DataFrame
        For each of the views forward, orthogonal and backward: ``view``, ``station`` (row of
        ``stations``; None where no image qualifies), ``distance_m`` and ``direction_deg`` against
        the chart's normal, positive before the chart is passed.

    Raises
    ------
    ValueError
        If the distance is not above zero.

    References
    ----------
    Pfeifer et al. 2021, section 4.1. doi:10.3390/rs13020237

    Examples
    --------
    >>> stations = pd.DataFrame({"time_s": range(5), "northing_m": [-8.0, -4.0, 0.0, 4.0, 8.0]})
    >>> stations = stations.assign(easting_m=0.0, height_m=1.5)
    >>> corners = chart_site(distances=[5.0])["corners"][0]
    >>> choose_images(stations, corners, distance=5)["station"].tolist()
    [1, 2, 3]
    """
    distance = check_positive(distance, "distance", unit="m")
    table = _around(stations, corners)
    rows = []
    for view in VIEWS:
        fitting = table[(table["view"] == view) & (table["distance_m"] >= distance)]
        if fitting.empty:
            rows.append((view, None, np.nan, np.nan))
            continue
        best = fitting["distance_m"].idxmin()
        rows.append((view, best, *table.loc[best, ["distance_m", "direction_deg"]]))
    return pd.DataFrame(rows, columns=["view", "station", "distance_m", "direction_deg"])


def check_drive(trajectory, corners, limits):
    """Check a drive past a chart against limits of distance, speed and attitude.

    Parameters
    ----------
    trajectory : DataFrame
        As :func:`mmqa_lab.io.read_trajectory` gives it; angles are checked where present. Headings
        count clockwise from north.
    corners : array_like, shape (4, 3)
        Of the chart, from the lower left counterclockwise, metres.
    limits : Limits

    Returns
    -------
    DataFrame
        Per quantity: ``quantity``, ``low``, ``high`` (extremes near the chart), ``at_least``,
        ``at_most``, ``n`` values, ``passed``. Angles that the trajectory lacks are left out.

    Raises
    ------
    ValueError
        If fewer than two poses lie near the chart.

    Examples
    --------
    >>> along = np.linspace(-20, 20, 41)
    >>> drive = {"time_s": along / 10, "easting_m": 0.0, "northing_m": along, "height_m": 1.5}
    >>> corners = chart_site(distances=[5.0])["corners"][0]
    >>> found = check_drive(pd.DataFrame(drive), corners, Limits(distance_m=5))
    >>> found["high"].round(6).tolist(), found["passed"].tolist()
    ([5.0, 36.0], [True, True])
    """
    frame = _chart_frame(corners)
    places = trajectory[COLUMNS[1:]].to_numpy(dtype=float) - frame[0]
    across, along = places @ frame[2], places @ frame[1]
    near = np.abs(along) <= limits.reach_m
    if near.sum() < 2:
        raise ValueError(f"Invalid trajectory: {near.sum()} poses near the chart. Must be two.")
    steps = np.linalg.norm(np.diff(places[near], axis=0), axis=1)
    speed = 3.6 * steps / np.diff(trajectory["time_s"].to_numpy()[near])
    quantities = {
        "distance_m": (across[near], limits.distance_m, limits.distance_tolerance_m),
        "speed_kmh": (speed, limits.speed_kmh, limits.speed_tolerance_kmh),
    }
    for name, limit in (("roll_deg", limits.roll_deg), ("pitch_deg", limits.pitch_deg)):
        if name in trajectory:
            quantities[name] = (_signed(trajectory[name].to_numpy()[near]), 0.0, limit)
    if "heading_deg" in trajectory:
        azimuth = np.degrees(np.arctan2(frame[1][0], frame[1][1]))
        turned = _signed(2 * (trajectory["heading_deg"].to_numpy()[near] - azimuth)) / 2
        quantities["heading_from_chart_deg"] = (turned, 0.0, limits.heading_deg)
    rows = [
        (name, values.min(), values.max(), goal - slack, goal + slack, len(values))
        for name, (values, goal, slack) in quantities.items()
    ]
    names = ["quantity", "low", "high", "at_least", "at_most", "n"]
    table = pd.DataFrame(rows, columns=names)
    table["passed"] = (table["low"] >= table["at_least"]) & (table["high"] <= table["at_most"])
    return table


def view_name(direction_deg):
    """Return the view's name by its direction against the chart's normal, positive ahead.

    Parameters
    ----------
    direction_deg : float
        -90 to 90.

    Returns
    -------
    str
        forward, orthogonal or backward.

    Raises
    ------
    ValueError
        If the direction lies outside -90 to 90 degrees.

    Examples
    --------
    >>> view_name(45), view_name(-10), view_name(-45)
    ('forward', 'orthogonal', 'backward')
    """
    direction = check_number(direction_deg, "direction_deg", low=-90, high=90, unit="degrees")
    if abs(direction) < ORTHOGONAL_DEG:
        return "orthogonal"
    return "forward" if direction > 0 else "backward"


def _around(stations, corners):
    """Distance, direction and view of each station that sees the chart's front."""
    missing = set(COLUMNS) - set(stations.columns)
    if missing:
        raise ValueError(f"Invalid stations: no column {sorted(missing)[0]!r}. Must have one.")
    middle, along, normal = _chart_frame(corners)
    places = stations[COLUMNS[1:]].to_numpy(dtype=float) - middle
    travel = np.sign((places[-1] - places[0]) @ along) if len(places) > 1 else 1.0
    direction = -travel * np.degrees(np.arctan2(places @ along, places @ normal))
    table = pd.DataFrame(
        {"distance_m": np.linalg.norm(places, axis=1), "direction_deg": direction},
        index=stations.index,
    )
    table = table[places @ normal > 0]
    return table.assign(view=[view_name(angle) for angle in table["direction_deg"]])


def _chart_frame(corners):
    """Middle, level direction to the right and outward normal of a chart."""
    corners = check_points(corners, name="corners", minimum=4)
    if len(corners) != 4:
        raise ValueError(f"Invalid corners: {len(corners)} given. Must be four.")
    along = corners[1] - corners[0]
    normal = np.cross(along, corners[3] - corners[0])
    along, normal = along / np.linalg.norm(along), normal / np.linalg.norm(normal)
    return corners.mean(axis=0), along, normal


def _signed(angles):
    """Angles between -180 and 180 degrees."""
    return (np.asarray(angles, dtype=float) + 180) % 360 - 180
