"""Checks of single numbers."""

import numbers

import numpy as np

__all__ = ["check_count", "check_number", "check_positive"]


def check_number(value, name, *, low=-np.inf, high=np.inf, unit=""):
    """Return ``value`` as a finite float within ``[low, high]``.

    Examples
    --------
    >>> check_number(5, "amount", low=0, high=1)
    Traceback (most recent call last):
    ValueError: Invalid amount 5. Must be between 0 and 1.
    """
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise TypeError(f"Invalid {name} {value!r}. Must be a number.")
    if not abs(value) <= np.finfo(float).max:
        raise ValueError(f"Invalid {name} {value}. Must be finite.")
    if not low <= value <= high:
        bounds = f">= {low}" if high == np.inf else f"between {low} and {high}"
        raise ValueError(f"Invalid {name} {value}. Must be {bounds} {unit}".strip() + ".")
    return float(value)


def check_positive(value, name, *, unit=""):
    """Return ``value`` as a finite float above zero.

    Examples
    --------
    >>> check_positive(-0.2, "radius", unit="m")
    Traceback (most recent call last):
    ValueError: Invalid radius -0.2. Must be > 0 m.
    """
    number = check_number(value, name)
    if number <= 0:
        raise ValueError(f"Invalid {name} {value}. Must be > 0 {unit}".strip() + ".")
    return number


def check_count(value, name, *, low=1):
    """Return ``value`` as an int of at least ``low``.

    Examples
    --------
    >>> check_count(0, "repeats")
    Traceback (most recent call last):
    ValueError: Invalid repeats 0. Must be a whole number >= 1.
    """
    whole = isinstance(value, numbers.Real) and not isinstance(value, bool) and value % 1 == 0
    if not whole or value < low:
        raise ValueError(f"Invalid {name} {value}. Must be a whole number >= {low}.")
    return int(value)
