"""The largest speed that keeps a limit."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pandas as pd
from scipy.optimize import brentq

from mmqa_lab._checks import check_choice, check_positive
from mmqa_lab.scan_pattern.lattice import LATTICE_QUANTITIES, scan_lattice
from mmqa_lab.scan_pattern.setup import Patch, ScanSetup, Target

__all__ = ["largest_speed", "speeds"]


SPEEDS = np.geomspace(0.01, 100.0, 4001)  # tried before the refinement, m/s


SHOWN_WITH_SPEED = ("density_per_m2", "f", "detail_mm")


def largest_speed(
    setup: ScanSetup, target: Target | Patch, *, quantity: str, limit: float
) -> float:
    """Return the largest speed at which a predicted quantity still keeps a limit.

    The limit is a minimum for the density, and a maximum for spacings, distances and f. Speeds
    between 0.01 and 100 m/s are tried in steps of 0.23 %. The last speed that keeps the limit is
    refined to 1e-9 m/s. So the result is also correct for f, which may rise, fall and rise again
    with speed.

    Parameters
    ----------
    setup : ScanSetup
        Of plain numbers; its own speed is ignored.
    target : Target or Patch
        A single spot.
    quantity : str
        One of ``LATTICE_QUANTITIES`` except the profile angle, or detail_mm: the largest size of
        details of which 95 % shall show three points or more.
    limit : float
        In the unit of the quantity.

    Returns
    -------
    float
        Speed, m/s.

    Raises
    ------
    ValueError
        If no speed in the range keeps the limit, or even the fastest keeps it.

    Notes
    -----
    For a density the speed is PRR cos(i) / (2 pi density R |Y.n_s|). For a perpendicular profile
    spacing it is spacing x Mf |n_s x n_t| / |Y.n_s| up to the motion of the scan plane during a
    revolution.

    Examples
    --------
    >>> from mmqa_lab.scan_pattern import ScanSetup, Target
    >>> setup = ScanSetup(pulse_rate_hz=1e6, mirror_frequency_hz=200, speed_m_s=1,
    ...                   scanner_tilt_deg=45)
    >>> speed = largest_speed(setup, Target(range_m=5), quantity="density_per_m2", limit=3000)
    >>> round(3.6 * speed)
    54
    """
    allowed = [*(one for one in LATTICE_QUANTITIES if one != "profile_angle_deg"), "detail_mm"]
    check_choice(quantity, "quantity", allowed)
    limit = check_positive(limit, "limit")

    def margin(speed):
        """Margin of the quantity to its limit, as a share of the limit; -1 if undefined."""
        values = getattr(scan_lattice(replace(setup, speed_m_s=speed), target), quantity)
        share = values / limit - 1 if quantity == "density_per_m2" else 1 - values / limit
        return np.where(np.isnan(share), -1.0, share)

    margins = [margin(speeds) for speeds in np.array_split(SPEEDS, 50)]
    kept = np.flatnonzero(np.concatenate(margins) >= 0)
    if not len(kept) or kept[-1] == len(SPEEDS) - 1:
        raise ValueError(f"Invalid limit {limit}. Must be reached between 0.01 and 100 m/s.")
    return float(brentq(margin, *SPEEDS[kept[-1] : kept[-1] + 2], xtol=1e-9))


def speeds(
    setup: ScanSetup, target: Target | Patch, *, detail: float, rho0: float = 3000.0, f: float = 2.0
) -> pd.DataFrame:
    """Return the largest speed for a task, and for what tenders ask, with what each gives.

    Parameters
    ----------
    setup : ScanSetup
        Of plain numbers; its own speed is ignored.
    target : Target or Patch
        A single spot.
    detail : float
        Diameter of details, m; 95 % of them shall show three points or more.
    rho0, f : float
        Required density (points per m2) and inhomogeneity.

    Returns
    -------
    DataFrame
        A row for the details, the density and f: ``asked``, ``limit``, ``speed_km_h`` (NaN if no
        speed from 0.01 to 100 m/s is the largest that keeps the limit), and at this speed
        ``density_per_m2``, ``f``, ``detail_mm``.

    Examples
    --------
    >>> scanner = {"pulse_rate_hz": 1e6, "mirror_frequency_hz": 200, "scanner_tilt_deg": 45}
    >>> found = speeds(ScanSetup(**scanner, speed_m_s=1), Target(range_m=5), detail=0.05)
    >>> found["speed_km_h"].round().tolist()
    [51.0, 54.0, 13.0]
    """
    detail, rho0 = check_positive(detail, "detail", unit="m"), check_positive(rho0, "rho0")
    f, rows = check_positive(f, "f"), []
    scan_lattice(setup, target)  # an impossible set-up is no limit that cannot be kept
    for asked, limit in (("detail_mm", 1000 * detail), ("density_per_m2", rho0), ("f", f)):
        rows.append({"asked": asked, "limit": limit, "speed_km_h": np.nan})
        with suppress(ValueError):
            speed = largest_speed(setup, target, quantity=asked, limit=limit)
            found = scan_lattice(replace(setup, speed_m_s=speed), target)
            figures = {name: float(getattr(found, name)) for name in SHOWN_WITH_SPEED}
            rows[-1] |= {"speed_km_h": 3.6 * speed} | figures
    return pd.DataFrame(rows)
