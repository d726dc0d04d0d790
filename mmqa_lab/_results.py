"""What results of all rooms share: how they show themselves in a notebook."""


class Shown:
    """A result with ``to_frame`` that shows itself as that table, a single row upright."""

    def _repr_html_(self):
        """The table as HTML, four digits a number."""
        frame = self.to_frame()
        if len(frame) == 1:
            frame = frame.T.rename(columns={frame.index[0]: type(self).__name__})
        return frame.to_html(float_format="{:.4g}".format, max_rows=30)
