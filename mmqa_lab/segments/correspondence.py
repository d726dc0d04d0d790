"""Which segments of two sets belong together, given their distances and a threshold."""

import numpy as np
from scipy.optimize import linear_sum_assignment

from mmqa_lab._checks import check_choice
from mmqa_lab.segments.geometry import check_segments, relative_ends

MATCHERS = ("all", "nearest", "mutual", "hungarian", "fragments")
FRAGMENT_OVERLAP = 0.3
"""Partners of one segment may share this part of their stretches on it."""


def correspond(distances, delta, *, matcher="all", test=None, model=None):
    """Pair segments whose distance is at most ``delta``.

    Parameters
    ----------
    distances : array_like, shape (p, q)
        Of test (rows) to model segments (columns), m.
    delta : float
        Threshold, m; NaN pairs nothing.
    matcher : {"all", "nearest", "mutual", "hungarian", "fragments"}
        ``all``: every cell (equation 6 of the paper). ``nearest``: the nearest model of each test.
        ``mutual``: nearest both ways. ``hungarian``: one-to-one of least total distance.
        ``fragments``: nearest first; a segment takes several partners only where they cover
        different stretches of it, as the pieces of a split edge do.
    test, model : Segments or array_like
        The segments; ``fragments`` needs them.

    Returns
    -------
    array of bool, shape (p, q)

    Raises
    ------
    ValueError
        If the matcher is unknown, ``fragments`` lacks the segments, or their numbers differ from
        the matrix.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), equation 6.

    Examples
    --------
    >>> d = [[0.1, 0.4], [0.3, 5.0]]
    >>> correspond(d, 0.5).sum(), correspond(d, 0.5, matcher="mutual").sum()
    (np.int64(3), np.int64(1))
    """
    check_choice(matcher, "matcher", MATCHERS)
    distances = np.asarray(distances, dtype=np.float64)
    near = distances <= delta
    if matcher == "all" or not near.any():
        return near
    if matcher == "fragments":
        return _fragments(distances, near, *_checked(distances, test, model))
    if matcher == "hungarian":
        return _hungarian(distances, near)
    nearest = near & _is_argmin(distances, 1)
    return nearest if matcher == "nearest" else nearest & _is_argmin(distances, 0)


def stretches(test, model):
    """The stretch of each test segment that each model segment covers, shape (p, q, 2), m.

    From the test segment's midpoint along it, cut off at its ends; reversed (low > high) where the
    model segment lies beyond an end.
    """
    test_ends, model_ends = relative_ends(test, model)
    along = np.einsum("qkd,pd->pqk", model_ends, test.directions)
    along -= np.einsum("pd,pd->p", test_ends.mean(axis=1), test.directions)[:, None, None]
    half = test.lengths[:, None] / 2
    low = np.maximum(along.min(axis=2), -half)
    return np.stack([low, np.minimum(along.max(axis=2), half)], axis=2)


def by_stretches(costs, allowed, on_test, on_model):
    """Accept allowed cells in the order of their costs while stretches stay apart, bool (p, q)."""
    pairs = np.zeros(costs.shape, dtype=bool)
    rows, columns = np.nonzero(allowed)
    taken = [[] for _ in range(costs.shape[0])], [[] for _ in range(costs.shape[1])]
    for k in np.argsort(costs[rows, columns], kind="stable"):
        i, j = rows[k], columns[k]
        if _free(on_test[i, j], taken[0][i]) and _free(on_model[j, i], taken[1][j]):
            pairs[i, j] = True
            taken[0][i].append(on_test[i, j])
            taken[1][j].append(on_model[j, i])
    return pairs


def _checked(distances, test, model):
    """Both sets, in the numbers that the matrix has."""
    if test is None or model is None:
        raise ValueError("Invalid matcher 'fragments' without segments. Must have test and model.")
    test, model = check_segments(test, name="test"), check_segments(model, name="model")
    if distances.shape != (len(test), len(model)):
        raise ValueError(
            f"Invalid distances of shape {distances.shape}. Must be ({len(test)}, {len(model)})."
        )
    return test, model


def _fragments(distances, near, test, model):
    return by_stretches(distances, near, stretches(test, model), stretches(model, test))


def _free(stretch, taken):
    """Whether a stretch leaves those already taken alone, but for a part of it."""
    if not taken:
        return True
    length = stretch[1] - stretch[0]
    shared = max(min(stretch[1], other[1]) - max(stretch[0], other[0]) for other in taken)
    return length > 0 and shared <= FRAGMENT_OVERLAP * length


def _hungarian(distances, near):
    """One-to-one assignment of the near cells; a cell at the very threshold still counts."""
    most = distances[near].max()
    gain = np.where(near, distances - most * (1 + 1e-9) - 1e-12, 0.0)
    rows, columns = linear_sum_assignment(gain)
    pairs = np.zeros_like(near)
    pairs[rows, columns] = True
    return pairs & near


def _is_argmin(distances, axis):
    """Cells that are the first least of their row (axis 1) or column (axis 0)."""
    cells = np.zeros(distances.shape, dtype=bool)
    np.put_along_axis(cells, np.argmin(distances, axis=axis, keepdims=True), True, axis=axis)
    return cells
