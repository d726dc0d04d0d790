"""Which segments of two sets belong together, given their distances and a threshold."""

import numpy as np
from scipy.optimize import linear_sum_assignment

from mmqa_lab._checks import check_choice
from mmqa_lab.lines.candidates import LinePairs
from mmqa_lab.lines.geometry import check_segments

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
        ``mutual``: nearest both ways. ``hungarian``: one-to-one, with the largest sum of
        ``delta - d``.
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
        test, model = _checked(distances, test, model)
        rows, columns = np.nonzero(near)
        stretches = LinePairs(test, model, rows, columns).stretches(np.zeros(3))
        return by_stretches(near.shape, rows, columns, distances[near], stretches)
    if matcher == "hungarian":
        return _hungarian(distances, near, delta)
    nearest = near & _is_argmin(distances, 1)
    return nearest if matcher == "nearest" else nearest & _is_argmin(distances, 0)


def by_stretches(shape, rows, columns, costs, stretches):
    """Accept cells in the order of their costs while stretches stay apart; bool, of that shape.

    ``stretches`` are those of :meth:`LinePairs.stretches`: on the test and on the model segments.
    """
    pairs = np.zeros(shape, dtype=bool)
    taken = [[] for _ in range(shape[0])], [[] for _ in range(shape[1])]
    for k in np.argsort(costs, kind="stable"):
        on_test, on_model = taken[0][rows[k]], taken[1][columns[k]]
        if _free(stretches[0][k], on_test) and _free(stretches[1][k], on_model):
            pairs[rows[k], columns[k]] = True
            on_test.append(stretches[0][k])
            on_model.append(stretches[1][k])
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


def _free(stretch, taken):
    """Whether a stretch leaves those already taken alone, but for a part of it."""
    if not taken:
        return True
    length = stretch[1] - stretch[0]
    shared = max(min(stretch[1], other[1]) - max(stretch[0], other[0]) for other in taken)
    return length > 0 and shared <= FRAGMENT_OVERLAP * length


def _hungarian(distances, near, delta):
    """One-to-one assignment of the near cells; a cell at the very threshold still counts."""
    cost = np.where(near, distances - delta * (1 + 1e-9) - 1e-12, 0.0)
    rows, columns = linear_sum_assignment(cost)
    pairs = np.zeros_like(near)
    pairs[rows, columns] = True
    return pairs & near


def _is_argmin(distances, axis):
    """Cells that are the first least of their row (axis 1) or column (axis 0)."""
    cells = np.zeros(distances.shape, dtype=bool)
    np.put_along_axis(cells, np.argmin(distances, axis=axis, keepdims=True), True, axis=axis)
    return cells
