"""The compiled search for the nearest point in each quadrant; exact for every pattern.

The points are repeatedly halved across the longer side of their box, down to leaves of 16 points.
This gives a binary tree of boxes. All points of a leaf search together, so that the vector units of
the processor work on several points at once. They search their own leaf first, then the tree from
the root, the nearer box first. A leaf that lies wholly on one side of them has points in two of
their quadrants alone, which halves the work.

Coordinates are compared and subtracted as given and never scaled. So every distance equals
sqrt(dx * dx + dy * dy) to the last bit.
"""

import math

import numpy as np

from mmqa_lab._compiled import in_threads, njit

__all__ = ["nearest_per_quadrant"]

BELOW_ZERO = -5e-324
"""The largest number below zero: what is greater is zero or above."""

LEAF = 16
"""Number of points that search together. With fewer the compiler does not vectorise the loops."""


def nearest_per_quadrant(xy, radius, of):
    """Return the sorted distances to the nearest point in each quadrant, shape (n, 4), NaN last.

    Points (n, 2) and radius are in the same unit. Points outside the mask ``of`` (n,) get NaN.
    """
    count = -(-len(xy) // LEAF)
    # copies of the last point fill the leaves: a copy lies in no quadrant of its own place
    rows = np.minimum(np.arange(count * LEAF), len(xy) - 1)
    points = np.empty((2, len(rows)))
    points[:, : len(xy)], points[:, len(xy) :] = xy.T, xy[-1:].T
    size = LEAF << (count - 1).bit_length()
    while size > LEAF:
        in_threads(_halve, -(-len(rows) // size), points, rows, size, least=1 + 10_000 // size)
        size //= 2
    leaves = np.ascontiguousarray(points.reshape(2, -1, LEAF).transpose(1, 0, 2))
    found = np.full((len(xy), 4), np.nan)
    boxes = np.tile([np.inf, np.inf, -np.inf, -np.inf], (2 << (len(leaves) - 1).bit_length(), 1))
    _fill_boxes(leaves, boxes)
    in_threads(_search, len(leaves), leaves, boxes, rows, float(radius), of, found)
    return found


@njit(cache=True, nogil=True, fastmath={"nnan", "nsz"})
def _halve(first, last, points, rows, size):
    """Reorder blocks of points so that each block is divided in two along its longer side."""
    for block in range(first, last):
        start, end = block * size, min((block + 1) * size, len(rows))
        middle = start + size // 2
        if middle >= end:
            continue
        low_x, high_x, low_y, high_y = np.inf, -np.inf, np.inf, -np.inf
        for i in range(start, end):
            low_x, high_x = min(low_x, points[0, i]), max(high_x, points[0, i])
            low_y, high_y = min(low_y, points[1, i]), max(high_y, points[1, i])
        if high_x - low_x >= high_y - low_y:
            _select(points[0], points[1], rows, start, end - 1, middle, low_x, high_x)
        else:
            _select(points[1], points[0], rows, start, end - 1, middle, low_y, high_y)


@njit(cache=True)
def _select(key, other, rows, low, high, middle, least, most):
    """Reorder low..high until key[:middle] <= key[middle] <= key[middle:] (quickselect).

    The first pivots are where the key would be if keys were even between the least and the most.
    """
    turn = 0
    while low < high:
        a, b, c = key[low], key[(low + high) // 2], key[high]
        pivot = max(min(a, b), min(max(a, b), c))
        if turn < 3:
            pivot = least + (most - least) * ((middle - low + 0.5) / (high - low + 1))
            turn += 1
        first = _put_below(pivot, key, other, rows, low, high)
        if first == low and turn == 3:  # the pivot is the least: equal keys go first
            first = _put_below(np.nextafter(pivot, np.inf), key, other, rows, low, high)
            if middle < first:
                break
        if middle < first:
            high, most = first - 1, pivot
        else:
            low, least = first, pivot


@njit(cache=True)
def _put_below(bound, key, other, rows, low, high):
    """Put keys below a bound first; return the index of the next key. Free of branches."""
    first = low
    for i in range(low, high + 1):
        x, y, row = key[i], other[i], rows[i]
        key[i], other[i], rows[i] = key[first], other[first], rows[first]
        key[first], other[first], rows[first] = x, y, row
        first += x < bound
    return first


@njit(cache=True)
def _fill_boxes(leaves, boxes):
    """Fill in boxes (x low, y low, x high, y high) of a tree: box k encloses 2k and 2k + 1."""
    bottom = len(boxes) // 2
    for k in range(bottom, bottom + len(leaves)):
        x, y = leaves[k - bottom]
        boxes[k] = x.min(), y.min(), x.max(), y.max()
    for k in range(bottom - 1, 0, -1):
        a, b = boxes[2 * k], boxes[2 * k + 1]
        boxes[k] = min(a[0], b[0]), min(a[1], b[1]), max(a[2], b[2]), max(a[3], b[3])


@njit(cache=True, nogil=True)
def _search(first, last, leaves, boxes, order, radius, of, found):
    """Find the distances of the points of a range of leaves."""
    bottom = len(boxes) // 2
    group, reach, stack = np.empty(6 * LEAF), np.empty(4), np.empty(128, np.int64)
    for leaf in range(first, last):
        rows = order[leaf * LEAF : (leaf + 1) * LEAF]
        if not _is_any(of, rows):
            continue
        _gather(leaves, leaf, radius, group)
        _compare(leaves, leaf, group)
        _reach(group, reach)
        own = bottom + leaf
        for up in range(64):  # the other half of each box around the leaf, the smallest first
            if own >> up <= 1:
                break
            stack[0], top = own >> up ^ 1, 1
            while top:
                top -= 1
                node = stack[top]
                gap = _gap(boxes, own, node, reach)
                while node < bottom and gap < np.inf:
                    near, far = 2 * node, 2 * node + 1
                    gap = _gap(boxes, own, near, reach)
                    far_gap = _gap(boxes, own, far, reach)
                    if far_gap < gap:
                        near, far, gap, far_gap = far, near, far_gap, gap
                    if far_gap < np.inf:
                        stack[top] = far
                        top += 1
                    node = near
                if gap < np.inf:
                    _compare_beside(leaves, node - bottom, group, boxes[own], boxes[node])
                    _reach(group, reach)
        _write(group, rows, radius, of, found)


@njit(cache=True)
def _is_any(of, rows):
    """Whether any of the rows is in the mask."""
    found = False
    for row in rows:
        found |= of[row]
    return found


@njit(cache=True)
def _gather(leaves, leaf, radius, group):
    """Start a group: its least squared distances by quadrant, then its coordinates."""
    for k in range(4 * LEAF):
        # a little larger, since squaring rounds; the distance itself decides at the end
        group[k] = radius * radius * (1 + 1e-15)
    for k in range(LEAF):
        group[4 * LEAF + k], group[5 * LEAF + k] = leaves[leaf, 0, k], leaves[leaf, 1, k]


@njit(cache=True)
def _compare(leaves, leaf, group):
    """Lower the least squared distances of a group by the points of a leaf."""
    for j in range(LEAF):
        x, y = leaves[leaf, 0, j], leaves[leaf, 1, j]
        for k in range(LEAF):
            dx, dy = x - group[4 * LEAF + k], y - group[5 * LEAF + k]
            d = dx * dx + dy * dy
            a, b, c, e = k, LEAF + k, 2 * LEAF + k, 3 * LEAF + k
            group[a] = min(group[a], d if (dx > 0) & (dy >= 0) else np.inf)
            group[b] = min(group[b], d if (dx <= 0) & (dy > 0) else np.inf)
            group[c] = min(group[c], d if (dx < 0) & (dy <= 0) else np.inf)
            group[e] = min(group[e], d if (dx >= 0) & (dy < 0) else np.inf)


def _compared_in_two(axis, first, second, bound):
    """A kernel that lowers the distances of a group in two quadrants by the points of a leaf.

    All points lie on one side of the group by the coordinate ``axis``; those that are above the
    bound by the other coordinate lie in the first quadrant.
    """
    own, other = (4 + axis) * LEAF, (5 - axis) * LEAF
    a, b = first * LEAF, second * LEAF

    @njit(cache=True)
    def compare(points, group):
        for j in range(LEAF):
            x, y = points[axis, j], points[1 - axis, j]
            for k in range(LEAF):
                dx, dy = x - group[own + k], y - group[other + k]
                d = dx * dx + dy * dy
                group[a + k] = min(group[a + k], d if dy > bound else np.inf)
                group[b + k] = min(group[b + k], np.inf if dy > bound else d)

    return compare


_right = _compared_in_two(0, 0, 3, BELOW_ZERO)
_left = _compared_in_two(0, 1, 2, 0.0)
_above = _compared_in_two(1, 0, 1, 0.0)
_below = _compared_in_two(1, 3, 2, BELOW_ZERO)


@njit(cache=True)
def _compare_beside(leaves, leaf, group, own, other):
    """Lower the least squared distances of a group by the points of another leaf."""
    if other[0] > own[2]:
        _right(leaves[leaf], group)
    elif other[2] < own[0]:
        _left(leaves[leaf], group)
    elif other[1] > own[3]:
        _above(leaves[leaf], group)
    elif other[3] < own[1]:
        _below(leaves[leaf], group)
    else:  # points on the line between them
        _compare(leaves, leaf, group)


@njit(cache=True, fastmath={"nnan", "nsz"})
def _reach(group, reach):
    """The largest of a group's squared distances in each quadrant."""
    for q in range(4):
        worst = 0.0
        for k in range(q * LEAF, (q + 1) * LEAF):
            worst = max(worst, group[k])
        reach[q] = worst


@njit(cache=True, fastmath={"nnan", "nsz"})
def _gap(boxes, leaf, node, reach):
    """Squared gap between two boxes; inf if the node cannot improve the leaf."""
    x_low, y_low, x_high, y_high = boxes[leaf, 0], boxes[leaf, 1], boxes[leaf, 2], boxes[leaf, 3]
    low_x, low_y, high_x, high_y = boxes[node, 0], boxes[node, 1], boxes[node, 2], boxes[node, 3]
    dx = max(low_x - x_high, x_low - high_x, 0.0)
    dy = max(low_y - y_high, y_low - high_y, 0.0)
    d = dx * dx + dy * dy
    useful = (d < reach[0]) & (high_x > x_low) & (high_y >= y_low)
    useful |= (d < reach[1]) & (low_x <= x_high) & (high_y > y_low)
    useful |= (d < reach[2]) & (low_x < x_high) & (low_y <= y_high)
    useful |= (d < reach[3]) & (high_x >= x_low) & (low_y < y_high)
    return d if useful else np.inf


@njit(cache=True)
def _write(group, rows, radius, of, found):
    """Sort each point's four distances and put them into its row."""
    for k in range(LEAF):
        if not of[rows[k]]:
            continue
        a, b = math.sqrt(group[k]), math.sqrt(group[LEAF + k])
        c, d = math.sqrt(group[2 * LEAF + k]), math.sqrt(group[3 * LEAF + k])
        a, b, c, d = min(a, b), max(a, b), min(c, d), max(c, d)
        a, b, c, d = min(a, c), min(b, d), max(a, c), max(b, d)
        row = found[rows[k]]
        row[0], row[1], row[2], row[3] = a, min(b, c), max(b, c), d
        for q in range(4):
            if row[q] > radius:
                row[q] = np.nan
