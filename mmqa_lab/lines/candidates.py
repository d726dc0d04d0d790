"""Candidate pairs of lines side by side: their common stretches and what lies across them."""

from dataclasses import dataclass

import numpy as np

from mmqa_lab.lines.geometry import relative_ends

ANGLE_NOISE_RAD = np.radians(0.3)
"""Standard deviation of a line's direction, for places away from its midpoint."""


@dataclass(frozen=True, eq=False)
class Offsets:
    """What n line pairs say about the displacement.

    Parameters
    ----------
    place : array, shape (n, 3)
        Middle of the common stretch on the model line, m from the pairs' common origin.
    frame : array, shape (n, 2, 3)
        Two unit vectors across the model line.
    offset : array, shape (n, 2)
        Test line minus model line there, m along ``frame``.
    variance : array, shape (n,)
        What uncertain directions contribute to the offset, square metres.
    overlap : array, shape (n,)
        Common stretch as a part of the shorter line; negative across a gap.
    """

    place: np.ndarray
    frame: np.ndarray
    offset: np.ndarray
    variance: np.ndarray
    overlap: np.ndarray

    def select(self, which):
        """The chosen ones."""
        return Offsets(*(values[which] for values in vars(self).values()))


class LinePairs:
    """Lines of two sets side by side: ``rows`` of the test set, ``columns`` of the model set."""

    def __init__(self, test, model, rows, columns):
        test_ends, model_ends = relative_ends(test, model)
        self.axis = model.directions[columns]
        self.frame = _frames(self.axis)
        direction = test.directions[rows]
        self.sense = np.where((direction * self.axis).sum(axis=1) < 0, -1.0, 1.0)
        self.test_axis = direction * self.sense[:, None]
        self.test_half, self.model_half = test.lengths[rows] / 2, model.lengths[columns] / 2
        self.model_middle = model_ends.mean(axis=1)[columns]
        self.apart = test_ends.mean(axis=1)[rows] - self.model_middle

    def __len__(self):
        return len(self.axis)

    def common(self, expected):
        """Common stretches along the model lines, less an expected displacement (3,) or (n, 3).

        Returns the shift s of the test midpoint and both ends (low > high across a gap), shape
        (n,) each, m from the model midpoint.
        """
        s = ((self.apart - expected) * self.axis).sum(axis=1)
        low = np.maximum(s - self.test_half, -self.model_half)
        return s, low, np.minimum(s + self.test_half, self.model_half)

    def end_gaps(self, expected):
        """Gaps between the ends of both lines, along the model line, (n, 2), m."""
        s, longer = self.common(expected)[0], self.test_half - self.model_half
        return np.abs(np.stack([s - longer, s + longer], axis=1))

    def stretches(self, expected):
        """The stretches (n, 2) that each pair covers of its test and of its model segment, m."""
        s, low, high = self.common(expected)
        on_model = np.stack([low, high], axis=1)
        on_test = (on_model - s[:, None]) * self.sense[:, None]
        on_test[self.sense < 0] = on_test[self.sense < 0, ::-1]
        return on_test, on_model

    def observe(self, expected):
        """The :class:`Offsets` of all pairs at their common stretches."""
        s, low, high = self.common(expected)
        middle = (low + high) / 2
        arm = middle - s
        across = self.apart + arm[:, None] * self.test_axis - middle[:, None] * self.axis
        return Offsets(
            place=self.model_middle + middle[:, None] * self.axis,
            frame=self.frame,
            offset=np.einsum("nkd,nd->nk", self.frame, across),
            variance=ANGLE_NOISE_RAD**2 * (arm**2 + middle**2),
            overlap=(high - low) / (2 * np.minimum(self.test_half, self.model_half)),
        )


def _frames(axes):
    """Two unit vectors across each axis: (n, 2, 3)."""
    helper = np.eye(3)[np.argmin(np.abs(axes), axis=1)]
    first = np.cross(axes, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(axes, first)], axis=1)
