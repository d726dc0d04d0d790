"""What speaks against a path in metres, degrees from north and the seconds of its cloud."""

from __future__ import annotations

import warnings

import numpy as np

from mmqa_lab._checks import refuse

__all__ = ["check_headings", "check_scales", "check_upright", "matched_times"]

# Headings so far off the movement are none; from here on they are doubted.
OTHER_HEADING_DEG, DOUBTED_HEADING_DEG = 45.0, 1.0

# So near is another reading of headings right; fewer rows that move tell nothing.
SAME_HEADING_DEG, FEWEST_MOVES = 2.0, 5

# No survey's vehicle is as fast or as slow, m/s; times as long as these are no seconds.
FASTEST_M_S, SLOWEST_M_S = 300.0, 0.1
LATEST_S = 1e10

DAY_S, WEEK_S = 86_400.0, 604_800.0

# Adjusted standard time of LAS is GPS time without a thousand million seconds. GPS time began so
# many seconds after Unix time, and is so many ahead of UTC since 2017.
ADJUSTED_S, EPOCH_S, LEAP_S = 1e9, 315_964_800.0, 18.0

# What times of a path may be: seconds to GPS time, after how many they begin again, from and to.
CLOCKS = {
    "seconds of the GPS week": (0.0, WEEK_S, 0.0, 2 * WEEK_S),
    "seconds of the day in GPS time": (0.0, DAY_S, 0.0, 2 * DAY_S),
    "seconds of the day in UTC": (LEAP_S, DAY_S, 0.0, 2 * DAY_S),
    "adjusted GPS time": (ADJUSTED_S, 0.0, 1e7, 1e9),
    "GPS time since 1980": (0.0, 0.0, 1e9, 2e9),
    "Unix time in GPS seconds": (-EPOCH_S, 0.0, 1e9, 3e9),
    "Unix time in UTC": (LEAP_S - EPOCH_S, 0.0, 1e9, 3e9),
}


def check_headings(table, what):
    """Compare headings with the movement: say it from 1 degree off, raise from 45 degrees.

    Also raise where they agree in another reading.
    """
    if "heading_deg" not in table:
        return
    steps = table[["easting_m", "northing_m"]].diff()[1:].to_numpy()
    length = np.hypot(*steps.T)
    moves = length > 0.2 * np.median(length[length > 0]) if length.any() else length > 0
    given = table["heading_deg"].to_numpy()[1:][moves]
    if len(given) < FEWEST_MOVES:
        return
    course = np.degrees(np.arctan2(*steps[moves].T))
    off = _off(given, course)
    readings = {
        "radians": _off(np.degrees(given), course),
        "gon": _off(0.9 * given, course),
        "angles from east, anticlockwise": _off(90 - given, course),
        "directions against the movement": _off(given + 180, course),
        "headings beside northing as x": _off(given, 90 - course),
    }
    near = [name for name, other in readings.items() if np.abs(other).mean() < SAME_HEADING_DEG]
    near = near[:1] if np.abs(off).mean() > SAME_HEADING_DEG else []
    middle = float(np.median(off))
    told = f"headings lie {np.median(np.abs(off)):.1f} degrees off the movement"
    told += f", and look like {near[0]}" if near else ""
    other = near or np.median(np.abs(off)) >= OTHER_HEADING_DEG
    refuse(other, what, told, "clockwise from north, in degrees")
    if abs(middle) >= DOUBTED_HEADING_DEG:
        warnings.warn(f"{told[0].upper()}{told[1:]} in {what}.", stacklevel=3)


def check_upright(table, what):
    """Say it where a vehicle lies on its side or its back: another frame, or another unit."""
    for name in [one for one in ("roll_deg", "pitch_deg") if one in table]:
        middle = np.median(np.abs(_off(table[name].to_numpy(), 0)))
        if middle >= OTHER_HEADING_DEG:
            name = name.partition("_")[0]
            told = (
                f"The middle {name} of {what} is {middle:.0f} degrees: the vehicle would lie over"
            )
            warnings.warn(f"{told}, as in the frame of a sensor.", stacklevel=3)


def check_scales(table, what):
    """Raise where the speed of a path shows that it is not in metres and seconds."""
    time = table["time_s"].to_numpy()
    refuse(time.max() > LATEST_S, what, f"times of {time.max():.4g}, as of ns or us", "in seconds")
    places = table[["easting_m", "northing_m"]].to_numpy()
    steps, seconds = np.hypot(*np.diff(places, axis=0).T), np.diff(time)
    moves = steps > 0.2 * steps.max(initial=0)
    if not moves.any():
        return
    speed = float(np.median(steps[moves] / seconds[moves]))
    globe = np.abs(places).max() <= 180 and np.ptp(places, axis=0).max() < 1
    refuse(
        globe and speed < SLOWEST_M_S / 10, what, "it looks like degrees", "projected, in metres"
    )
    refuse(speed > FASTEST_M_S, what, f"a speed of {speed:.0f} m/s, as in mm", "in metres")
    whole = (time == np.round(time)).all() and np.median(seconds) >= 10
    refuse(whole and speed < SLOWEST_M_S, what, "times that look like ms", "in seconds")
    if speed < SLOWEST_M_S:
        told = f"{what[0].upper()}{what[1:]} moves at {speed:.2g} m/s"
        warnings.warn(f"{told}: are its coordinates in metres, its times in seconds?", stacklevel=3)


def matched_times(time, cloud, what):
    """Return the times of a path in its order, s, as those of its cloud; say it if they change.

    Raise if two readings of them fit to the cloud, or none does.
    """
    first, last = float(np.min(cloud)), float(np.max(cloud))
    if first == last or (time.min() <= first and time.max() >= last):
        return time
    back = np.diff(time)
    size = WEEK_S if back.min(initial=0) < -WEEK_S / 2 else DAY_S
    time = time + size * np.append(0, np.cumsum(back < -size / 2))
    low, high = float(time.min()), float(time.max())
    home, again = (0.0, WEEK_S) if last <= 2 * WEEK_S else (ADJUSTED_S * (last < ADJUSTED_S), 0.0)
    fits = {}
    for name, (origin, turn, least, most) in CLOCKS.items():
        shift, step = origin - home, turn or again
        shift += step * np.floor((first - low - shift) / step) if step else 0.0
        if least <= low <= high <= most and low + shift <= first and high + shift >= last:
            fits[name] = shift
    found = f"times of {low:.10g} to {high:.10g} s, the cloud's are {first:.10g} to {last:.10g}"
    refuse(not fits, what, found, "around the cloud's")
    found = f"times that may be {' or '.join(fits)}"
    refuse(len({*fits.values()}) > 1, what, found, "in the seconds of the cloud")
    (name, shift), *_ = fits.items()
    if shift:
        told = (
            f"The times of {what} are taken for {name}: with {shift:+.10g} s they are the cloud's."
        )
        warnings.warn(told, stacklevel=3)
    return time + shift


def _off(given, course):
    """Differences of directions, -180 to 180 degrees."""
    return (given - course + 180) % 360 - 180
