"""Planning: the largest speed that will do, how sure a prediction is, what explains an error."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
from scipy.optimize import brentq

from mmqa_lab._checks import check_choice, check_count, check_number, check_positive
from mmqa_lab.scan_pattern.lattice import (
    NUMBERS,
    QUANTITIES,
    Patch,
    ScanSetup,
    Target,
    scan_lattice,
    target_normal,
)

SLOWEST, FASTEST = 0.01, 100.0  # speeds that are searched, m/s
SPEEDS = 4001  # speeds tried before the last one that will do is refined: a step of 0.23 %
TWO_SIDED_95 = 1.959963984540054  # quantile of the normal distribution that leaves 2.5 % above it
TARGET_NAMES = {
    **{"target_heading_deg": "heading_deg", "target_tilt_deg": "tilt_deg"},
    **{"range_m": "range_m", "height_difference_m": "height_difference_m"},
}
"""Inputs that are fields of the target."""

# Quantities that have derivatives; d1..d4 and f jump from lattice point to lattice point.
SMOOTH = QUANTITIES[:6]
INPUTS = (*NUMBERS, *TARGET_NAMES)  # names of what may be in error
EXPLAINED = (
    *("scanner_heading_deg", "scanner_tilt_deg", "target_heading_deg", "target_tilt_deg"),
    *("mirror_frequency_hz", "speed_m_s"),
)
"""The inputs of Table 6."""

# Half steps of the central differences where 1e-4 (degree, degree/s, metre) is not apt.
STEPS = {"pulse_rate_hz": 1.0, "mirror_frequency_hz": 1e-3, "speed_m_s": 1e-4}


def largest_speed(
    setup: ScanSetup, target: Target | Patch, *, quantity: str, limit: float
) -> float:
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
    check_choice(quantity, "quantity", [q for q in QUANTITIES if q != "profile_angle_deg"])
    limit = check_positive(limit, "limit")
    patch = target.patch(setup) if hasattr(target, "patch") else target
    if patch.points.ndim != 1:
        raise ValueError(f"Invalid patch of shape {patch.points.shape}. Must be a single spot.")
    speeds = np.geomspace(SLOWEST, FASTEST, SPEEDS)
    margin = partial(_margin, setup, patch, quantity, limit)
    kept = np.flatnonzero(margin(speeds) >= 0)
    if not len(kept) or kept[-1] == SPEEDS - 1:
        fails, value = ("fails", SLOWEST) if not len(kept) else ("is kept", FASTEST)
        raise ValueError(
            f"Invalid limit {limit} for {quantity}: it {fails} at every speed tried, {value} m/s "
            f"included. Must be reached between {SLOWEST} and {FASTEST} m/s."
        )
    return float(brentq(margin, *speeds[kept[-1] : kept[-1] + 2], xtol=1e-9))


def _margin(setup, patch, quantity, limit, speeds):
    """How far a quantity keeps to its limit at each speed, as a share of it; -1 if not defined."""
    values = scan_lattice(replace(setup, speed_m_s=speeds), patch).quantity(quantity)
    share = values / limit - 1 if quantity == "density_per_m2" else 1 - values / limit
    return np.where(np.isnan(share), -1.0, share)


def sensitivities(
    setup: ScanSetup, target: Target, *, inputs: Sequence[str] = INPUTS
) -> pd.DataFrame:
    """Return the derivative of the predicted quantities by the inputs.

    The plane stays where the nominal set-up finds it, whatever the scanner does: a turned vehicle
    strikes the same spot of the wall, at another moment. A turned target turns about that spot.

    Parameters
    ----------
    setup : ScanSetup
        Of plain numbers.
    target : Target
    inputs : sequence of str
        Fields of ``ScanSetup``; ``target_heading_deg``, ``target_tilt_deg``, ``range_m``,
        ``height_difference_m``.

    Returns
    -------
    DataFrame
        A row per input, a column per quantity that has derivatives (d1..d4 and f have none: they
        jump when another point becomes the nearest): change of the quantity in its unit per unit
        of the input.

    Raises
    ------
    ValueError
        If an input is unknown.

    Examples
    --------
    >>> from mmqa_lab.scan_pattern import ScanSetup, Target
    >>> setup = ScanSetup(pulse_rate_hz=3e5, mirror_frequency_hz=100, speed_m_s=10,
    ...                   scanner_heading_deg=45, scanner_tilt_deg=45)
    >>> table = sensitivities(setup, Target(range_m=8), inputs=["speed_m_s"])
    >>> print(table.loc["speed_m_s", "profile_spacing_horizontal_m"].round(6))
    0.01
    """
    rows = {}
    for name in inputs:
        check_choice(name, "input", INPUTS)
        step = STEPS.get(name, 1e-4)
        ends = _predicted(setup, target, {name: np.array([-step, step])}, SMOOTH)
        rows[name] = [(ends[key][1] - ends[key][0]) / (2 * step) for key in SMOOTH]
    table = pd.DataFrame.from_dict(rows, orient="index", columns=list(SMOOTH))
    return table.rename_axis("input")


def propagate(
    setup: ScanSetup,
    target: Target,
    *,
    sigmas: dict[str, float],
    method: str = "first_order",
    draws: int = 20_000,
    seed: int = 0,
) -> pd.DataFrame:
    """Return what errors of set-up and target make of the prediction.

    First order adds the squares of sensitivity times standard deviation; Monte Carlo draws
    independent normal errors and predicts each time.

    Parameters
    ----------
    setup : ScanSetup
        Of plain numbers.
    target : Target
    sigmas : dict of str to float
        Standard deviation of inputs by their names, see ``sensitivities``.
    method : {"first_order", "monte_carlo"}
    draws, seed : int
        For Monte Carlo.

    Returns
    -------
    DataFrame
        A row per quantity: ``quantity``, ``predicted``, ``std``, ``low`` and ``high`` (2.5 % and
        97.5 %), ``n`` draws (0 for first order), ``method``. First order has NaN for d1..d4 and f,
        which jump from lattice point to lattice point.

    Raises
    ------
    ValueError
        If an input is unknown, a deviation negative, or ``draws`` below 100.

    Examples
    --------
    >>> from mmqa_lab.scan_pattern import ScanSetup, Target
    >>> setup = ScanSetup(pulse_rate_hz=3e5, mirror_frequency_hz=100, speed_m_s=10,
    ...                   scanner_heading_deg=45, scanner_tilt_deg=45)
    >>> table = propagate(setup, Target(range_m=8), sigmas={"speed_m_s": 0.1})
    >>> print(table.set_index("quantity").loc["profile_spacing_horizontal_m", "std"].round(6))
    0.001
    """
    check_choice(method, "method", ("first_order", "monte_carlo"))
    for name, sigma in sigmas.items():
        check_choice(name, "input", INPUTS)
        check_number(sigma, f"sigma of {name}", low=0)
    predicted = {key: values[0] for key, values in _predicted(setup, target, {}).items()}
    table = pd.DataFrame({"quantity": list(QUANTITIES), "predicted": predicted.values()})
    if method == "first_order":
        slopes = sensitivities(setup, target, inputs=list(sigmas))
        spread = np.sqrt((slopes.mul(pd.Series(sigmas, dtype=float), axis=0) ** 2).sum())
        table["std"] = table["quantity"].map(spread)
        table["low"] = table["predicted"] - TWO_SIDED_95 * table["std"]
        table["high"] = table["predicted"] + TWO_SIDED_95 * table["std"]
        return table.assign(n=0, method=method)
    draws = check_count(draws, "draws", low=100)
    rng = np.random.default_rng(seed)
    errors = {name: sigma * rng.standard_normal(draws) for name, sigma in sigmas.items()}
    drawn = pd.DataFrame(_predicted(setup, target, errors)).to_numpy()
    table["std"] = np.std(drawn, axis=0, ddof=1)
    table["low"], table["high"] = np.quantile(drawn, (0.025, 0.975), axis=0)
    return table.assign(n=draws, method=method)


def explain_error(
    setup: ScanSetup,
    target: Target,
    *,
    quantity: str,
    measured: float,
    inputs: Sequence[str] = EXPLAINED,
) -> pd.DataFrame:
    """Return the change of each input, one at a time, that turns the prediction into a measurement.

    What Table 6 of Cahalane et al. 2014 gives for an error of 2 mm: of the changes that do it, the
    smallest, found within a tenth of a rate, 15 degrees or a fifth of a range.

    Parameters
    ----------
    setup : ScanSetup
        Of plain numbers.
    target : Target
    quantity : str
        One of the spacings, the angle or the density, see ``sensitivities``.
    measured : float
        In the quantity's unit.
    inputs : sequence of str
        As for ``sensitivities``; those of Table 6 where left out.

    Returns
    -------
    DataFrame
        ``input``, ``unit``, ``change`` (signed; NaN where no change in the range will do),
        ``predicted`` and ``measured``.

    Raises
    ------
    ValueError
        If quantity or input is unknown, or the measured value not finite.

    References
    ----------
    Cahalane et al. 2014, section 4.3, Table 6. doi:10.3390/s140609471

    Examples
    --------
    >>> from mmqa_lab.scan_pattern import ScanSetup, Target
    >>> setup = ScanSetup(pulse_rate_hz=3e5, mirror_frequency_hz=100, speed_m_s=10,
    ...                   scanner_heading_deg=45, scanner_tilt_deg=45)
    >>> table = explain_error(setup, Target(range_m=8), measured=0.102,
    ...                       quantity="profile_spacing_horizontal_m", inputs=["speed_m_s"])
    >>> print(table["change"].round(6).item())
    0.2
    """
    check_choice(quantity, "quantity", SMOOTH)
    check_number(measured, "measured")
    rows = []
    for name in inputs:
        check_choice(name, "input", INPUTS)
        lack = partial(_lack, setup, target, quantity, measured, name)
        rows.append((name, _unit(name), _nearest_root(lack, _reach(setup, target, name))))
    table = pd.DataFrame(rows, columns=["input", "unit", "change"])
    predicted = _predicted(setup, target, {}, [quantity])[quantity][0]
    return table.assign(predicted=predicted, measured=measured)


def _lack(setup, target, quantity, measured, name, change):
    """By how much the prediction exceeds the measurement once an input is changed."""
    return _predicted(setup, target, {name: change}, [quantity])[quantity] - measured


def _reach(setup, target, name):
    """How far an input is changed at most."""
    if name.endswith(("_deg", "_deg_s")):
        return 15.0
    given = getattr(target, TARGET_NAMES[name]) if name in TARGET_NAMES else getattr(setup, name)
    return 0.2 * abs(given) or 1.0


def _unit(name):
    """Unit of an input, from its name."""
    endings = {"_deg_s": "deg/s", "_deg": "deg", "_hz": "Hz", "_m_s": "m/s", "_m": "m"}
    return next(unit for ending, unit in endings.items() if name.endswith(ending))


def _nearest_root(lack, reach):
    """The root of a function nearest to zero, NaN where it has none or is constant."""
    tried = np.linspace(-reach, reach, 601)
    values = lack(tried)
    crossed = np.flatnonzero(np.sign(values[1:]) * np.sign(values[:-1]) <= 0)
    if not len(crossed) or np.ptp(values) < 1e-12:
        return np.nan
    nearest = crossed[np.argmin(np.abs(tried[crossed] + tried[crossed + 1]))]
    return float(brentq(lambda x: lack(np.array([x]))[0], tried[nearest], tried[nearest + 1]))


def _predicted(setup, target, errors, names=QUANTITIES):
    """Quantities, as arrays, with errors added to the named inputs."""
    shift = {name: np.atleast_1d(values) for name, values in errors.items()}
    changed = {name: getattr(setup, name) + shift[name] for name in shift if name in NUMBERS}
    moved = {
        field: getattr(target, field) + shift.get(name, np.zeros(1))
        for name, field in TARGET_NAMES.items()
    }
    normal = target_normal(moved.pop("heading_deg"), moved.pop("tilt_deg"))
    points = replace(target, **moved).patch(setup).points
    lattice = scan_lattice(replace(setup, **changed), Patch(points, -normal))
    return {name: np.atleast_1d(lattice.quantity(name)) for name in names}
