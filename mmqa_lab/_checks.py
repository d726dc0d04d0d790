"""Argument checks with one message pattern: what is wrong, its value, what must hold."""

import numbers

import numpy as np


def check_points(points, *, name="points", columns=3, minimum=1):
    """Return ``points`` as finite float64 of shape ``(n, columns)`` with ``n >= minimum``.

    Raises
    ------
    TypeError
        If the values are not real numbers.
    ValueError
        If the shape is wrong, points are too few, or a coordinate is not finite.

    Examples
    --------
    >>> check_points([[0, 0, 1]]).shape
    (1, 3)
    >>> check_points([[0, 0]])
    Traceback (most recent call last):
    ValueError: Invalid points of shape (1, 2). Must have shape (n, 3).
    """
    values = np.asarray(points)
    if values.dtype.kind not in "fiub":
        raise TypeError(f"Invalid {name} of type {values.dtype}. Must be real numbers.")
    if values.ndim != 2 or values.shape[1] != columns:
        raise ValueError(f"Invalid {name} of shape {values.shape}. Must have shape (n, {columns}).")
    if len(values) < minimum:
        raise ValueError(f"Invalid {name}: {len(values)} given. Must be {minimum} or more.")
    values = values.astype(np.float64, copy=False)
    if not np.isfinite(values).all():
        bad = ~np.isfinite(values).all(axis=1)
        raise ValueError(
            f"Invalid {name}: {bad.sum()} of {len(values)} not finite, the first in row "
            f"{int(np.argmax(bad))}. Must be finite coordinates."
        )
    return values


def check_number(value, name, *, low=None, high=None, unit=""):
    """Return ``value`` as a finite float within ``[low, high]``.

    Examples
    --------
    >>> check_number(5, "amount", low=0, high=1)
    Traceback (most recent call last):
    ValueError: Invalid amount 5. Must be between 0 and 1.
    """
    number = _finite(value, name)
    below = low is not None and number < low
    above = high is not None and number > high
    if below or above:
        raise ValueError(f"Invalid {name} {value}. Must be {_bounds(low, high)}{_spaced(unit)}.")
    return number


def check_positive(value, name, *, unit=""):
    """Return ``value`` as a finite float above zero.

    Examples
    --------
    >>> check_positive(-0.2, "radius", unit="m")
    Traceback (most recent call last):
    ValueError: Invalid radius -0.2. Must be > 0 m.
    """
    number = _finite(value, name)
    if number <= 0:
        raise ValueError(f"Invalid {name} {value}. Must be > 0{_spaced(unit)}.")
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


def check_choice(value, name, choices):
    """Return ``value`` if it is one of ``choices``.

    Examples
    --------
    >>> check_choice("up", "axes", ("principal", "horizontal"))
    Traceback (most recent call last):
    ValueError: Invalid axes 'up'. Must be one of principal, horizontal.
    """
    if value not in choices:
        listed = ", ".join(str(choice) for choice in choices)
        raise ValueError(f"Invalid {name} {value!r}. Must be one of {listed}.")
    return value


def _finite(value, name):
    """``value`` as a finite float, or the sentence that says why not."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise TypeError(f"Invalid {name} {value!r}. Must be a number.")
    if not np.isfinite(value):
        raise ValueError(f"Invalid {name} {value}. Must be finite.")
    return float(value)


def _bounds(low, high):
    """The interval in words."""
    if low is None:
        return f"<= {high}"
    if high is None:
        return f">= {low}"
    return f"between {low} and {high}"


def _spaced(unit):
    """A unit as it follows a number."""
    return f" {unit}" if unit else ""
