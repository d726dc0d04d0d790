"""How errors of set-up and target pass into the prediction: first order, and Monte Carlo."""

from dataclasses import fields, replace

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_choice, check_count, check_number
from mmqa_lab.scan_pattern.lattice import QUANTITIES, scan_lattice
from mmqa_lab.scan_pattern.setups import NUMBERS
from mmqa_lab.scan_pattern.surfaces import Patch, Target, target_normal

TWO_SIDED_95 = 1.959963984540054
"""Quantile of the normal distribution that leaves 2.5 % above it."""

TARGET_NAMES = {f"target_{field.name}": field.name for field in fields(Target)}
TARGET_NAMES["range_m"] = TARGET_NAMES.pop("target_range_m")
TARGET_NAMES["height_difference_m"] = TARGET_NAMES.pop("target_height_difference_m")

SMOOTH = QUANTITIES[:6]
"""Quantities that have derivatives; d1..d4 and f jump from lattice point to lattice point."""

INPUTS = (*NUMBERS, *TARGET_NAMES)
"""Names of what may be in error."""

STEPS = {"pulse_rate_hz": 1.0, "mirror_frequency_hz": 1e-3, "speed_m_s": 1e-4}
"""Half steps of the central differences where 1e-4 (degree, degree/s, metre) is not apt."""


def sensitivities(setup, target, *, inputs=INPUTS):
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
        ends = _predicted(setup, target, {name: np.array([-step, step])})
        rows[name] = [(ends[key][1] - ends[key][0]) / (2 * step) for key in SMOOTH]
    table = pd.DataFrame.from_dict(rows, orient="index", columns=list(SMOOTH))
    return table.rename_axis("input")


def propagate(setup, target, *, sigmas, method="first_order", draws=20_000, seed=0):
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


def _predicted(setup, target, errors):
    """Every quantity, as arrays, with errors added to the named inputs."""
    shift = {name: np.atleast_1d(values) for name, values in errors.items()}
    changed = {name: getattr(setup, name) + shift[name] for name in shift if name in NUMBERS}
    moved = {
        field: getattr(target, field) + shift.get(name, np.zeros(1))
        for name, field in TARGET_NAMES.items()
    }
    normal = target_normal(moved.pop("heading_deg"), moved.pop("tilt_deg"))
    points = replace(target, **moved).patch(setup).points
    lattice = scan_lattice(replace(setup, **changed), Patch(points, -normal))
    return {name: np.atleast_1d(lattice.quantity(name)) for name in QUANTITIES}
