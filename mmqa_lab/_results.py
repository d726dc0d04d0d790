"""What results of all rooms share: their table, and how they show themselves in a notebook."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, cast

import numpy as np
import pandas as pd

__all__ = ["NORMAL", "Shown", "about", "sentences"]

NORMAL = 1.96
"""Half the 95 % interval of normal errors, over their standard deviation."""


class Shown:
    """A result that shows itself as the table of ``to_frame``, a single row upright.

    ``_metres`` names the fields in metres whose names do not say so, ``_derived`` the properties
    that belong into the table.
    """

    _metres: tuple[str, ...] = ()
    _derived: tuple[str, ...] = ()

    def to_frame(self) -> pd.DataFrame:
        """Return one row: every number with its unit, short vectors by their axes."""
        row: dict[str, Any] = {}
        for name in (*(field.name for field in fields(cast(Any, self))), *self._derived):
            value, unit = getattr(self, name), "_m" if name in self._metres else ""
            if isinstance(value, np.ndarray) and value.shape in ((2,), (3,)):
                row |= {f"{name}_{axis}{unit}": v for axis, v in zip("xyz", value, strict=False)}
            elif np.ndim(value) == 0:
                row[name + unit] = value
        return pd.DataFrame([row])

    def intervals(self) -> pd.DataFrame:
        """Return ``figure``, ``value``, ``low``, ``high``, ``unit``: the 95 % confidence intervals.

        A row for each figure that has one; NaN where it is not known.
        """
        return pd.DataFrame(self._ends(), columns=["figure", "value", "low", "high", "unit"])

    def _ends(self):
        """The rows of ``intervals``; none of a result without."""
        return []

    def _repr_html_(self):
        """The table as HTML: four digits a number, three decimals of large coordinates."""
        frame = self.to_frame()
        if len(frame) == 1:
            frame = frame.T.rename(columns={frame.index[0]: type(self).__name__})
        return frame.to_html(float_format=_digits, max_rows=30)


def about(figure, value, std, unit):
    """The row of ``intervals`` of a figure with normal errors."""
    return figure, value, value - NORMAL * std, value + NORMAL * std, unit


def sentences(*remarks):
    """The sentences of (condition, sentence) whose condition holds; a sentence may be a function.

    >>> sentences((True, "Few points."), (False, lambda: 1 / 0))
    ['Few points.']
    """
    said = [sentence for applies, sentence in remarks if applies]
    return [sentence() if callable(sentence) else sentence for sentence in said]


def _digits(value):
    """A number as text.

    >>> _digits(0.0123456), _digits(452_123.4567), _digits(1e12)
    ('0.01235', '452123.457', '1e+12')
    """
    return f"{value:.3f}" if 1e4 <= abs(value) < 1e9 else f"{value:.4g}"
