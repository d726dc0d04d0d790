"""Rotations against those of scipy, and perpendicular vectors."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mmqa_lab.rotations import across, rotations, turned

DEGREES = st.floats(-360, 360)


@given(DEGREES, DEGREES, DEGREES)
def test_turns_are_those_of_scipy_about_axes_that_turn_along(z, x, y):
    found = turned(z=z, x=x, y=y)
    np.testing.assert_allclose(
        found, Rotation.from_euler("ZXY", [z, x, y], True).as_matrix(), 0, 1e-12
    )
    np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-12)


def test_heading_east_is_clockwise_from_north():
    east = rotations(0, 0, np.radians([0, 90, 180])) @ [0, 1, 0]
    np.testing.assert_allclose(east, [[0, 1, 0], [1, 0, 0], [0, -1, 0]], atol=1e-12)


@given(st.lists(st.tuples(DEGREES, DEGREES), min_size=1, max_size=9))
def test_two_vectors_across_are_perpendicular_units(angles):
    axes = turned(z=[a for a, _ in angles], x=[b for _, b in angles])[..., 1]
    frame = np.concatenate([axes[:, None], across(axes)], axis=1)
    np.testing.assert_allclose(
        frame @ frame.swapaxes(1, 2), np.broadcast_to(np.eye(3), frame.shape), 0, 1e-12
    )
