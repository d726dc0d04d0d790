"""The largest speed that keeps a limit, and what errors of the inputs do to a prediction."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pandas as pd
from scipy.optimize import brentq

from mmqa_lab._checks import check_choice, check_count, check_number, check_positive, refuse
from mmqa_lab._streams import stream
from mmqa_lab.scan_pattern.lattice import LATTICE_QUANTITIES, SMOOTH, scan_lattice
from mmqa_lab.scan_pattern.mimic import target_normal
from mmqa_lab.scan_pattern.setup import SETUP_NAMES, TARGET_NAMES, Patch, ScanSetup, Target

__all__ = ["explain_error", "largest_speed", "propagate", "speeds"]


SPEEDS = np.geomspace(0.01, 100.0, 4001)  # tried before the refinement, m/s

SHOWN_WITH_SPEED = ("density_per_m2", "f", "detail_mm")

EXPLAINED = (
    *(f"{side}_{turn}_deg" for side in ("scanner", "target") for turn in ("heading", "tilt")),
    *("mirror_frequency_hz", "speed_m_s"),
)
"""The inputs of Table 6."""

INPUTS = (*SETUP_NAMES, *TARGET_NAMES)  # names of the inputs that may have errors


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
    limit, target = check_positive(limit, "limit"), _one_spot(setup, target)

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


def _one_spot(setup, target):
    """A target of one spot, whatever its shape; a sentence for more of them."""
    spots = np.size(scan_lattice(setup, target).point_spacing_m)
    refuse(spots != 1, "target", f"{spots} spots", "a single spot")
    return Patch(*(np.reshape(one, 3) for one in target)) if isinstance(target, Patch) else target


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
    target = _one_spot(setup, target)  # an impossible set-up is no limit that cannot be kept
    for asked, limit in (("detail_mm", 1000 * detail), ("density_per_m2", rho0), ("f", f)):
        rows.append({"asked": asked, "limit": limit, "speed_km_h": np.nan})
        with suppress(ValueError):
            speed = largest_speed(setup, target, quantity=asked, limit=limit)
            found = scan_lattice(replace(setup, speed_m_s=speed), target)
            figures = {name: float(getattr(found, name)) for name in SHOWN_WITH_SPEED}
            rows[-1] |= {"speed_km_h": 3.6 * speed} | figures
    return pd.DataFrame(rows)


def propagate(
    setup: ScanSetup,
    target: Target,
    *,
    sigmas: dict[str, float],
    draws: int = 2_000,
    seed: int = 0,
) -> pd.DataFrame:
    """Propagate errors of set-up and target to the prediction, by Monte Carlo.

    Independent normal errors are drawn, and the pattern is predicted for each draw. The plane stays
    at the spot of the nominal set-up. A target with an error of rotation turns about that spot.

    Parameters
    ----------
    setup : ScanSetup
        Of plain numbers.
    target : Target
        The nominal target.
    sigmas : dict of str to float
        Standard deviations of inputs by name: fields of ``ScanSetup``, ``target_heading_deg``,
        ``target_tilt_deg``, ``range_m``, ``height_difference_m``; in the unit of the input.
    draws, seed : int
        Number of draws (100 or more) and seed.

    Returns
    -------
    DataFrame
        One row per quantity: ``quantity``, ``predicted``, ``std``, the 95 % interval ``low`` and
        ``high`` (NaN where a draw has no value, as near a level surface), and the number of draws
        ``n`` that have one.

    Raises
    ------
    ValueError
        If an input is unknown, a deviation negative or so large that a draw is impossible, or
        ``draws`` below 100.

    Examples
    --------
    >>> from mmqa_lab.scan_pattern import ScanSetup, Target
    >>> setup = ScanSetup(pulse_rate_hz=3e5, mirror_frequency_hz=100, speed_m_s=10,
    ...                   scanner_heading_deg=45, scanner_tilt_deg=45)
    >>> table = propagate(setup, Target(range_m=8), sigmas={"speed_m_s": 0.1})
    >>> print(table.set_index("quantity").loc["profile_spacing_horizontal_m", "std"].round(4))
    0.001
    """
    for name, sigma in sigmas.items():
        check_choice(name, "input", INPUTS)
        check_number(sigma, f"sigma of {name}", low=0)
    draws, rng = check_count(draws, "draws", low=100), stream(seed, "propagate")
    predicted = scan_lattice(setup, target).to_frame().iloc[0].to_numpy()
    errors = {name: sigma * rng.standard_normal(draws) for name, sigma in sigmas.items()}
    try:
        drawn = _with_errors(setup, target, errors).to_frame()
    except ValueError:
        raise ValueError(
            f"Invalid sigmas {sigmas}. Must be small enough: a draw is an impossible set-up."
        ) from None
    low, high = np.quantile(drawn, (0.025, 0.975), axis=0)
    table = {"quantity": LATTICE_QUANTITIES, "predicted": predicted}
    table["std"] = drawn.std(skipna=False).to_numpy()
    return pd.DataFrame({**table, "low": low, "high": high, "n": drawn.notna().sum().to_numpy()})


def explain_error(
    setup: ScanSetup, target: Target, *, quantity: str, measured: float
) -> pd.DataFrame:
    """Return the change of each input, one at a time, that turns the prediction into a measurement.

    Table 6 of Cahalane et al. 2014 gives such changes for an error of 2 mm. The result is the
    smallest change within 15 degrees, or within a fifth of a rate or speed.

    Parameters
    ----------
    setup : ScanSetup
        Of plain numbers.
    target : Target
    quantity : str
        A spacing, the angle or the density, as in the table of :func:`propagate`.
    measured : float
        In the unit of the quantity.

    Returns
    -------
    DataFrame
        ``input`` (the inputs of Table 6), ``change`` (signed, in the unit of the input; NaN if no
        change in the range explains the error), ``predicted`` and ``measured``.

    Raises
    ------
    ValueError
        If the quantity is unknown or the measured value not finite.

    References
    ----------
    Cahalane et al. 2014, section 4.3, Table 6. doi:10.3390/s140609471

    Examples
    --------
    >>> from mmqa_lab.scan_pattern import ScanSetup, Target
    >>> setup = ScanSetup(pulse_rate_hz=3e5, mirror_frequency_hz=100, speed_m_s=10,
    ...                   scanner_heading_deg=45, scanner_tilt_deg=45)
    >>> table = explain_error(setup, Target(range_m=8), measured=0.102,
    ...                       quantity="profile_spacing_horizontal_m").set_index("input")
    >>> print(table.loc["speed_m_s", "change"].round(6))
    0.2
    """
    check_choice(quantity, "quantity", SMOOTH)
    check_number(measured, "measured")
    changes = [_change(setup, target, quantity, measured, name) for name in EXPLAINED]
    predicted = float(getattr(scan_lattice(setup, target), quantity))
    table = {"input": EXPLAINED, "change": changes}
    return pd.DataFrame({**table, "predicted": predicted, "measured": measured})


def _change(setup, target, quantity, measured, name):
    """The smallest change of an input that explains the error; NaN if none or every change does."""
    reach = 15.0 if name.endswith("_deg") else 0.2 * getattr(setup, name)

    def lack(change):
        """Excess of the prediction over the measurement after a change of the input."""
        return getattr(_with_errors(setup, target, {name: change}), quantity) - measured

    tried = np.linspace(-reach, reach, 601)
    values = lack(tried)
    crossed = np.flatnonzero(np.sign(values[1:]) * np.sign(values[:-1]) <= 0)
    if not len(crossed) or np.ptp(values) < 1e-12:
        return np.nan
    nearest = crossed[np.argmin(np.abs(tried[crossed] + tried[crossed + 1]))]
    return float(brentq(lack, tried[nearest], tried[nearest + 1]))


def _with_errors(setup, target, errors):
    """The lattice with errors added to the named inputs, at the spot of the nominal set-up."""
    changed = {name: getattr(setup, name) + errors[name] for name in errors if name in SETUP_NAMES}
    moved = {
        own: getattr(target, own) + errors.get(name, 0.0) for name, own in TARGET_NAMES.items()
    }
    normal = -target_normal(moved.pop("heading_deg"), moved.pop("tilt_deg"))
    points = replace(target, **moved).patch(setup).points
    return scan_lattice(replace(setup, **changed), Patch(points, normal))
