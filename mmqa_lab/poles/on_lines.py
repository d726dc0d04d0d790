"""Scan lines of a cloud: as recorded, or recovered from time and scan angle."""

import numpy as np

from mmqa_lab.scan_pattern import revolutions_from_time


def scan_lines(cloud):
    """Return the scan line (n,) of each point of a cloud and its pulse along the line, or None.

    They are ``scan_line`` and ``pulse`` or ``gps_time``, or come from ``gps_time``, ``scan_angle``
    or both. Where there is a ``head`` or a ``point_source_id`` (one for each drive in LAS), lines
    of different heads and drives are not neighbours.

    A column whose values are all equal, as LAS files have it where nothing was recorded, says
    nothing. Without ``scan_line``, a line ends where the scan angle turns back by more than a
    quarter of its range while time runs on: this finds the turns of a full-circle profiler and the
    ends of an oscillating one. Without time, the points must lie in the order in which they were
    measured. From time alone, lines are cut in the pause that all revolutions share, the sky above
    the vehicle; without such a pause there is no answer. Times along a line become numbers of
    pulses by their median step; whole numbers stay as they are.

    Examples
    --------
    >>> from mmqa_lab.cloud import Cloud
    >>> angle = np.tile(np.arange(-180.0, 180, 45), 3)
    >>> columns = {"gps_time": np.arange(24.0), "scan_angle": angle}
    >>> line, pulse = scan_lines(Cloud(np.zeros((24, 3)), columns))
    >>> line[[0, 7, 8, 23]].tolist()
    [0, 0, 1, 2]
    """
    source = _source(cloud)
    along = "pulse" if "pulse" in cloud else "gps_time"
    if "scan_line" in cloud and along in cloud:
        line, place = np.asarray(cloud["scan_line"], dtype=np.int64), cloud[along]
    elif _varies(cloud, "scan_angle"):
        order = cloud["gps_time"] if _varies(cloud, "gps_time") else np.arange(len(cloud))
        place = np.asarray(order, dtype=np.float64)
        line = _lines_by_angle(place, np.asarray(cloud["scan_angle"], dtype=np.float64), source)
    elif _varies(cloud, "gps_time"):
        place = np.asarray(cloud["gps_time"], dtype=np.float64)
        line = _lines_by_time(place, source)
    else:
        line = None
    if line is None:
        return None
    apart = np.ptp(line) + 10 if len(line) else 0  # lines of other heads are no neighbours
    line = line - line.min(initial=0) + source * apart
    return line, _pulses(line, np.asarray(place, dtype=np.float64))


def _pulses(line, place):
    """Numbers of pulses from places along lines that may be times."""
    if not len(place) or np.array_equal(place, np.floor(place)):
        return place
    order = np.lexsort([place, line])
    steps = np.diff(place[order])[np.diff(line[order]) == 0]
    steps = steps[steps > 0]
    step = np.median(steps) if len(steps) else 1.0
    return np.round((place - place.min()) / step)


def _varies(cloud, name):
    """Whether a cloud has a column with more than one value."""
    return name in cloud and len(cloud) > 0 and np.ptp(cloud[name]) > 0


def _source(cloud):
    """A number for each head and drive."""
    source = np.zeros(len(cloud), dtype=np.int64)
    for name in ("head", "point_source_id"):
        if name in cloud:
            _, number = np.unique(cloud[name], return_inverse=True)
            source = source * (number.max(initial=0) + 1) + number
    return source


def _lines_by_angle(time, angle, source):
    """Lines numbered along time, a new one where the angle turns back."""
    order = np.lexsort([angle, time, source])
    step = np.diff(angle[order])
    turned = step < -0.25 * np.ptp(angle) if len(angle) else step
    if not turned.any():
        turned = step > 0.25 * np.ptp(angle)
    line = np.empty(len(time), dtype=np.int64)
    line[order] = np.concatenate([[0], np.cumsum(turned)])
    return line


def _lines_by_time(time, source):
    """Lines cut in the pause of each source's revolutions, or None where one has none."""
    line = np.empty(len(time), dtype=np.int64)
    for number in np.unique(source):
        own = source == number
        try:
            line[own] = revolutions_from_time(time[own])
        except ValueError:
            return None
    return line
