"""What results of all rooms share: their table, and how they show themselves in a notebook."""

from __future__ import annotations

import re
from dataclasses import fields
from typing import TYPE_CHECKING, Any, cast

import numpy as np

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["NORMAL", "Shown", "about", "digits", "printed", "sentences"]

NORMAL = 1.96
"""Half the 95 % interval of normal errors, over their standard deviation."""

COORDINATE = re.compile(r"(^|_)([xyz]|easting|northing|height)(_low|_high)?(_m)?$")
"""How the name of a column of coordinates ends."""


class Shown:
    """A result that shows itself as the table of ``to_frame``, a single row upright.

    ``_metres`` names the fields in metres whose names do not say so, ``_derived`` the properties
    that belong into the table. Residuals, one for each row of the data, do not.
    """

    _metres: tuple[str, ...] = ()
    _derived: tuple[str, ...] = ()

    def to_frame(self) -> pd.DataFrame:
        """Return one row: every number with its unit, short vectors by their axes."""
        import pandas as pd

        row: dict[str, Any] = {}
        for name in (*(field.name for field in fields(cast(Any, self))), *self._derived):
            value, unit = getattr(self, name), "_m" if name in self._metres else ""
            short = isinstance(value, np.ndarray) and value.shape in ((2,), (3,))
            if short and name != "residuals":
                row |= {f"{name}_{axis}{unit}": v for axis, v in zip("xyz", value, strict=False)}
            elif np.ndim(value) == 0:
                row[name + unit] = value
        return pd.DataFrame([row])

    def intervals(self) -> pd.DataFrame:
        """Return ``figure``, ``value``, ``low``, ``high``, ``unit``: the 95 % confidence intervals.

        A row for each figure that has one; NaN where it is not known.
        """
        import pandas as pd

        return pd.DataFrame(self._ends(), columns=["figure", "value", "low", "high", "unit"])

    def _ends(self):
        """The rows of ``intervals``; none of a result without."""
        return []

    def _repr_html_(self):
        """The table as HTML, its numbers as :func:`printed` has them."""
        frame = printed(self.to_frame())
        if len(frame) == 1:
            frame = frame.T.rename(columns={frame.index[0]: type(self).__name__})
        return frame.to_html(max_rows=30)


def about(figure, value, std, unit):
    """Return the row of ``intervals`` of a figure with normal errors."""
    return figure, value, value - NORMAL * std, value + NORMAL * std, unit


def sentences(*remarks):
    """The sentences of (condition, sentence) whose condition holds; a sentence may be a function.

    >>> sentences((True, "Few points."), (False, lambda: 1 / 0))
    ('Few points.',)
    """
    said = (sentence for applies, sentence in remarks if applies)
    return tuple(sentence() if callable(sentence) else sentence for sentence in said)


def digits(value):
    """A number as text: four digits, but of a large one all before the point and three behind it.

    So a coordinate keeps its millimetres, whichever column it stands in.

    >>> [digits(one) for one in (0.0123456, 33.333, 4629.0, 452_123.4567, 1e12, -0.0)]
    ['0.01235', '33.33', '4629', '452123.457', '1e+12', '0']
    """
    large = 1e3 <= abs(value) < 1e9
    return f"{value:.3f}".rstrip("0").rstrip(".") if large else f"{value + 0.0:.4g}"


def printed(frame, *, missing=""):
    """Return a table with its numbers as text, as all pages, papers and terminals show it.

    Columns of coordinates in metres keep their millimetres, such in other units seven decimals.

    >>> import pandas as pd
    >>> table = pd.DataFrame({"x_m": [123.45678], "f": [123.45678], "x": [11.576543]})
    >>> printed(table).loc[0].tolist()
    ['123.457', '123.5', '11.5765430']
    """
    return frame.apply(_texts, missing=missing) if len(frame.columns) else frame


def _texts(column, missing):
    """The numbers of a column as text."""
    import pandas as pd

    if column.dtype.kind != "f":
        return column
    name, write = str(column.name), digits
    if COORDINATE.search(name):
        write = _coordinate if name.endswith("_m") else "{:.7f}".format
    texts = [missing if pd.isna(one) else write(one) for one in column]
    return pd.Series(texts, column.index, dtype=object, name=column.name)


def _coordinate(value):
    """A coordinate in metres as text: millimetres, and of a small one four digits."""
    return f"{value:.3f}" if 1 <= abs(value) < 1e9 else digits(value)
