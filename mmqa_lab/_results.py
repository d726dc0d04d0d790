"""What results of all rooms share: their table, and how they show themselves in a notebook."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pandas as pd


class Shown:
    """A result that shows itself as the table of ``to_frame``, a single row upright.

    ``_metres`` names the fields in metres whose names do not say so, ``_derived`` the properties
    that belong into the table.
    """

    _metres = ()
    _derived = ()

    def to_frame(self) -> pd.DataFrame:
        """Return one row: every number with its unit, short vectors by their axes."""
        row = {}
        for name in (*(field.name for field in fields(self)), *self._derived):
            value, unit = getattr(self, name), self._units.get(name, "")
            if isinstance(value, np.ndarray) and value.shape in ((2,), (3,)):
                row |= {
                    f"{name}_{axis}{unit}": one for axis, one in zip("xyz", value, strict=False)
                }
            elif np.ndim(value) == 0:
                row[name + unit] = value
        return pd.DataFrame([row])

    def _repr_html_(self):
        """The table as HTML, four digits a number."""
        frame = self.to_frame()
        if len(frame) == 1:
            frame = frame.T.rename(columns={frame.index[0]: type(self).__name__})
        return frame.to_html(float_format="{:.4g}".format, max_rows=30)
