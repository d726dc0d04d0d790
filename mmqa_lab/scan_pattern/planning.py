"""Planning: the largest speed at which a surface still gets what is required."""

from dataclasses import replace

import numpy as np

from mmqa_lab._checks import check_choice, check_positive
from mmqa_lab.scan_pattern.lattice import QUANTITIES, scan_lattice

SLOWEST, FASTEST = 0.01, 100.0
"""Speeds that are searched, m/s."""

SPEEDS = 4001
"""Speeds tried before the last one that will do is refined: a step of 0.23 %."""

ANGLE = "profile_angle_deg"


def largest_speed(setup, target, *, quantity, limit):
    """Return the largest speed at which a predicted quantity still keeps to a limit.

    Density must be the limit or more, spacings, distances and f the limit or less. The speeds
    between 0.01 and 100 m/s are tried in steps of 0.23 %, and the last one that will do is refined
    to 1e-9 m/s; so the answer is right also for f, which may rise, fall and rise again with speed.

    Parameters
    ----------
    setup : ScanSetup
        Of plain numbers; its own speed does not matter.
    target : Target or Patch
        A target is laid out for the set-up; a patch must be a single spot.
    quantity : str
        One of ``QUANTITIES`` except the profile angle.
    limit : float
        In the quantity's unit.

    Returns
    -------
    float
        m/s.

    Raises
    ------
    ValueError
        If no speed in the range keeps to the limit, or the fastest still does.

    Notes
    -----
    For steady attitude a density has the closed form PRR cos(i) / (2 pi density R |Y.n_s|) and
    a perpendicular profile spacing is spacing x Mf |n_s x n_t| / |Y.n_s| up to the motion of the
    scan plane during a revolution.

    Examples
    --------
    >>> from mmqa_lab.scan_pattern import ScanSetup, Target
    >>> setup = ScanSetup(pulse_rate_hz=1e6, mirror_frequency_hz=200, speed_m_s=1,
    ...                   scanner_tilt_deg=45)
    >>> speed = largest_speed(setup, Target(range_m=5), quantity="density_per_m2", limit=3000)
    >>> round(3.6 * speed)
    54
    """
    choices = tuple(name for name in QUANTITIES if name != ANGLE)
    check_choice(quantity, "quantity", choices)
    limit = check_positive(limit, "limit")
    patch = target.patch(setup) if hasattr(target, "patch") else target
    if patch.points.ndim != 1:
        raise ValueError(f"Invalid patch of shape {patch.points.shape}. Must be a single spot.")
    speeds = np.geomspace(SLOWEST, FASTEST, SPEEDS)
    margin = _margin(setup, patch, quantity, limit, speeds)
    kept = np.flatnonzero(margin >= 0)
    if not len(kept) or kept[-1] == SPEEDS - 1:
        value = SLOWEST if not len(kept) else FASTEST
        raise ValueError(
            f"Invalid limit {limit} for {quantity}: it {'fails' if not len(kept) else 'holds'} at "
            f"every speed tried, {value} m/s included. Must be reached between {SLOWEST} and "
            f"{FASTEST} m/s."
        )
    return _refined(setup, patch, quantity, limit, speeds[kept[-1]], speeds[kept[-1] + 1])


def _margin(setup, patch, quantity, limit, speeds):
    """How far a quantity keeps to its limit at each speed, as a share of it; -1 if not defined."""
    values = scan_lattice(replace(setup, speed_m_s=speeds), patch).quantity(quantity)
    share = values / limit - 1 if quantity == "density_per_m2" else 1 - values / limit
    return np.where(np.isnan(share), -1.0, share)


def _refined(setup, patch, quantity, limit, low, high):
    """The speed between two at which the limit is met, by cutting the interval in 64, six times."""
    while high - low > 1e-9:
        speeds = np.linspace(low, high, 65)
        last = np.flatnonzero(_margin(setup, patch, quantity, limit, speeds) >= 0)
        last = last[-1] if len(last) else 0
        if last == len(speeds) - 1:
            return float(high)
        low, high = speeds[last], speeds[last + 1]
    return float(low)
