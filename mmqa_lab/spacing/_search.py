"""Exact searches for the nearest point in each quadrant and near each direction, compiled.

The points go into square cells of about a dozen, in Morton order; fuller cells are halved until no
leaf has more than 16 points, and a binary tree of bounding boxes stands over the leaves. All
points of a leaf search together, one lane each, so that the processor's vector units work on
several at once. A leaf first looks into the 3 x 3 cells around it, which settles even patterns;
whatever stays open there, or lies where cells are crowded, is found down the tree.

Coordinates are compared and subtracted as given, never scaled, so every distance has the bits that
sqrt(dx * dx + dy * dy) has.
"""

import math
from collections import namedtuple

import numba
import numpy as np
from numba import njit

from mmqa_lab._compiled import in_threads
from mmqa_lab.cloud import sort_into_cells

POINTS_PER_CELL = 12
CROWDED = 20 * POINTS_PER_CELL
"""Points in 3 x 3 cells above which the tree is quicker; an even pattern has 9 x 12."""

LANES = 16
"""Points that search together. Fewer and the compiler does not vectorise the loops over them."""

X, Y, BEST = 0, LANES, 2 * LANES
"""Where a group keeps its coordinates and, quadrant by quadrant, the least squared distances."""

POINTS_A_THREAD = 10_000

TASK = 256
"""Leaves or cells that a thread takes in a row: neighbours in the cloud, still warm in cache."""

Grid = namedtuple("Grid", "x0 y0 size column row")
"""Cells from the corner (x0, y0); a cell's place in the order is column[i] + row[j]."""

Points = namedtuple("Points", "x y rows")
"""The points cell by cell, and their rows in the input."""

Tree = namedtuple("Tree", "leaves boxes")
"""First point of each leaf; boxes (x low, x high, y low, y high), the children of k at 2k, 2k+1."""


def nearest_per_quadrant(xy, radius, of):
    """Sorted distances to the nearest point in each quadrant, shape (n, 4), NaN last.

    Only for the points in the mask ``of``; the others get NaN.
    """
    xy = np.require(xy, requirements="CW")  # compiled once, for what a table gives as well
    return _nearest(xy, radius, of, min(numba.get_num_threads(), 1 + len(xy) // POINTS_A_THREAD))


def _nearest(xy, radius, of, threads):
    """The steps of the search: cells, leaves, boxes, distances."""
    grid = _grid(xy)
    points = Points(np.empty(len(xy)), np.empty(len(xy)), np.empty(len(xy), np.int32))
    free = np.zeros((threads, grid.column[-1] + grid.row[-1] + 1), np.int32)
    _each(threads, _count, xy, grid, free)
    starts = _starts(free)
    _each(threads, _place, xy, grid, points, free)
    first = _first_leaves(starts)
    leaves = np.full(first[-1] + 1, len(xy), np.int32)
    _each(threads, _part, points, starts, first, leaves, threads)
    bottom = 1 << (len(leaves) - 2).bit_length()
    tree = Tree(leaves, np.tile([np.inf, -np.inf, np.inf, -np.inf], (2 * bottom, 1)))
    in_threads(_draw_boxes, len(leaves) - 1, points, leaves, tree.boxes, least=20 * TASK)
    _join_boxes(tree.boxes)
    distances = np.empty((len(xy), 4))
    _each(threads, _search, points, grid, starts, tree, radius, of, distances, threads)
    return distances


def _each(threads, kernel, *arguments):
    """Run a kernel once in every thread."""
    in_threads(kernel, threads, *arguments, least=1)


def _grid(xy):
    """Square cells over the bounding box."""
    x, y = xy.T
    x0, y0 = x.min(), y.min()
    width, height = x.max() - x0, y.max() - y0
    cells = max(1.0, len(xy) / POINTS_PER_CELL)
    size = max(math.sqrt(width * height / cells), max(width, height) / cells, 1e-300)
    columns, rows = 1 + int(width / size), 1 + int(height / size)
    bits = (min(columns, rows) - 1).bit_length()
    return Grid(x0, y0, size, _spread(columns, bits, 0), _spread(rows, bits, 1))


def _spread(count, bits, shift):
    """The bits of 0..count-1 as they go into a Morton code; the longer side's rest on top."""
    index = np.arange(count)
    low = sum((((index >> k) & 1) << (2 * k + shift) for k in range(bits)), np.zeros_like(index))
    return low + (index >> bits << 2 * bits)


@njit(cache=True)
def _cell(grid, x, y):
    """Place of the cell at (x, y)."""
    column = grid.column[int((x - grid.x0) / grid.size)]
    return column + grid.row[int((y - grid.y0) / grid.size)]


@njit(cache=True, nogil=True)
def _count(thread, _, xy, grid, free):
    """Count the points of a thread in each cell."""
    n, threads = len(xy), len(free)
    for i in range(n * thread // threads, n * (thread + 1) // threads):
        free[thread, _cell(grid, xy[i, 0], xy[i, 1])] += 1


@njit(cache=True)
def _starts(free):
    """First point of each cell; ``free`` becomes the place where each thread's points begin."""
    starts = np.empty(free.shape[1] + 1, np.int32)
    total = 0
    for c in range(free.shape[1]):
        starts[c] = total
        for t in range(len(free)):
            count = free[t, c]
            free[t, c] = total
            total += count
    starts[-1] = total
    return starts


@njit(cache=True, nogil=True)
def _place(thread, _, xy, grid, points, free):
    """Sort the points of a thread by cell, in each cell in input order."""
    n, threads = len(xy), len(free)
    for i in range(n * thread // threads, n * (thread + 1) // threads):
        c = _cell(grid, xy[i, 0], xy[i, 1])
        place = free[thread, c]
        free[thread, c] += 1
        points.x[place], points.y[place], points.rows[place] = xy[i, 0], xy[i, 1], i


@njit(cache=True)
def _first_leaves(starts):
    """First leaf of each cell: a cell has none, or a power of two."""
    first = np.zeros(len(starts), np.int32)
    for c in range(len(starts) - 1):
        count = starts[c + 1] - starts[c]
        leaves = min(count, 1)
        while leaves * LANES < count:
            leaves *= 2
        first[c + 1] = first[c] + leaves
    return first


@njit(cache=True, nogil=True)
def _part(thread, _, points, starts, first, leaves, threads):
    """Order the points of each cell into its leaves; note the first point of each leaf."""
    stack = np.empty((64, 3), np.int64)
    for task in range(thread * TASK, len(first) - 1, threads * TASK):
        for c in range(task, min(task + TASK, len(first) - 1)):
            if first[c + 1] > first[c]:
                stack[0, 0], stack[0, 1] = starts[c], starts[c + 1]
                stack[0, 2] = first[c + 1] - first[c]
                _halve(points, stack, leaves, first[c])


@njit(cache=True)
def _halve(points, stack, leaves, leaf):
    """Halve the range (start, end, leaves) on the stack across its longer side, over and over."""
    top = 1
    while top:
        top -= 1
        start, end, count = stack[top, 0], stack[top, 1], stack[top, 2]
        if count == 1:
            leaves[leaf] = start
            leaf += 1
            continue
        middle = (start + end) // 2
        x_low, x_high, y_low, y_high = _box(points, start, end)
        if x_high - x_low >= y_high - y_low:
            _select(points.x, points.y, points.rows, start, end - 1, middle)
        else:
            _select(points.y, points.x, points.rows, start, end - 1, middle)
        stack[top, 0], stack[top, 1], stack[top, 2] = middle, end, count // 2
        stack[top + 1, 0], stack[top + 1, 1], stack[top + 1, 2] = start, middle, count // 2
        top += 2


@njit(cache=True)
def _select(key, other, rows, low, high, middle):
    """Reorder low..high until key[:middle] <= key[middle] <= key[middle:] (Hoare's selection)."""
    while low < high:
        a, b, c = key[low], key[(low + high) // 2], key[high]
        pivot = max(min(a, b), min(max(a, b), c))
        i, j = low, high
        while i <= j:
            while key[i] < pivot:
                i += 1
            while pivot < key[j]:
                j -= 1
            if i <= j:
                key[i], key[j] = key[j], key[i]
                other[i], other[j] = other[j], other[i]
                rows[i], rows[j] = rows[j], rows[i]
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            break


@njit(cache=True)
def _box(points, start, end):
    """Bounding box of a range of points."""
    x_low, x_high, y_low, y_high = np.inf, -np.inf, np.inf, -np.inf
    for i in range(start, end):
        x_low, x_high = min(x_low, points.x[i]), max(x_high, points.x[i])
        y_low, y_high = min(y_low, points.y[i]), max(y_high, points.y[i])
    return x_low, x_high, y_low, y_high


@njit(cache=True, nogil=True)
def _draw_boxes(begin, end, points, leaves, boxes):
    """Fill in the boxes of the leaves."""
    m = len(boxes) // 2
    for k in range(begin, end):
        x_low, x_high, y_low, y_high = _box(points, leaves[k], leaves[k + 1])
        boxes[m + k, 0], boxes[m + k, 1] = x_low, x_high
        boxes[m + k, 2], boxes[m + k, 3] = y_low, y_high


@njit(cache=True)
def _join_boxes(boxes):
    """Fill in the boxes around two others, from the bottom up."""
    for k in range(len(boxes) // 2 - 1, 0, -1):
        left, right = boxes[2 * k], boxes[2 * k + 1]
        boxes[k, 0], boxes[k, 1] = min(left[0], right[0]), max(left[1], right[1])
        boxes[k, 2], boxes[k, 3] = min(left[2], right[2]), max(left[3], right[3])


@njit(cache=True, nogil=True)
def _search(thread, _, points, grid, starts, tree, radius, of, distances, threads):
    """Fill in the distances of one thread's leaves."""
    leaves, boxes = tree.leaves, tree.boxes
    group, need = np.empty(6 * LANES), np.empty(4)
    stack = np.empty(64, np.int64)
    for task in range(thread * TASK, len(leaves) - 1, threads * TASK):
        for k in range(task, min(task + TASK, len(leaves) - 1)):
            start, end = leaves[k], leaves[k + 1]
            if not _is_any(of, points.rows, start, end, distances):
                continue
            _gather(points, start, end, radius, group)
            if not _search_cells(points, grid, starts, group, need):
                _compare(points, start, end, group)
                for q in range(4):
                    need[q] = _worst(group, q)
            if max(need[0], need[1], need[2], need[3]) > 0:
                _search_tree(points, tree, len(boxes) // 2 + k, group, need, stack)
            _scatter(points.rows, start, end, radius, group, of, distances)


@njit(cache=True)
def _is_any(of, rows, start, end, distances):
    """Whether a leaf has one of the points that are asked for; NaN for those that are not."""
    found = False
    for i in range(start, end):
        if of[rows[i]]:
            found = True
        else:
            distances[rows[i], :] = np.nan
    return found


@njit(cache=True)
def _gather(points, start, end, radius, group):
    """Start a group; idle lanes repeat the last point."""
    for k in range(LANES):
        i = min(start + k, end - 1)
        group[X + k] = points.x[i]
        group[Y + k] = points.y[i]
    for k in range(BEST, BEST + 4 * LANES):
        # A little beyond, as squaring rounds: the distance itself decides in the end.
        group[k] = radius * radius * (1 + 1e-15)


@njit(cache=True)
def _compare(points, start, end, group):
    """Let points anywhere update the group."""
    for j in range(start, end):
        x, y = points.x[j], points.y[j]
        for k in range(LANES):
            dx, dy = x - group[X + k], y - group[Y + k]
            d = dx * dx + dy * dy
            a, b, c, e = BEST + k, BEST + LANES + k, BEST + 2 * LANES + k, BEST + 3 * LANES + k
            group[a] = min(group[a], d if (dx > 0) & (dy >= 0) else np.inf)
            group[b] = min(group[b], d if (dx <= 0) & (dy > 0) else np.inf)
            group[c] = min(group[c], d if (dx < 0) & (dy <= 0) else np.inf)
            group[e] = min(group[e], d if (dx >= 0) & (dy < 0) else np.inf)


def _compare_side(axis, sign, ahead, behind):
    """Kernel for points all strictly on one side: the sign along ``axis`` tells the quadrant."""
    ahead, behind = BEST + ahead * LANES, BEST + behind * LANES

    @njit(cache=True)
    def compare(points, start, end, group):
        for j in range(start, end):
            x, y = points.x[j], points.y[j]
            for k in range(LANES):
                dx, dy = x - group[X + k], y - group[Y + k]
                d = dx * dx + dy * dy
                is_ahead = sign * (dx if axis == 0 else dy) > 0
                group[ahead + k] = min(group[ahead + k], d if is_ahead else np.inf)
                group[behind + k] = min(group[behind + k], np.inf if is_ahead else d)

    return compare


_compare_north = _compare_side(0, 1, 0, 1)
_compare_south = _compare_side(0, -1, 2, 3)
_compare_east = _compare_side(1, -1, 3, 0)
_compare_west = _compare_side(1, 1, 1, 2)


@njit(cache=True)
def _search_cells(points, grid, starts, group, need):
    """Compare with 3 x 3 cells; set the squared reach still to search, 0 where settled.

    False, and nothing done, where the cells contain too many points.
    """
    i = int((group[X] - grid.x0) / grid.size)
    j = int((group[Y] - grid.y0) / grid.size)
    columns = grid.column[max(i - 1, 0) : i + 2]
    rows = grid.row[max(j - 1, 0) : j + 2]
    total = 0
    for row in rows:
        for column in columns:
            total += starts[column + row + 1] - starts[column + row]
    if total > CROWDED:
        return False
    here = grid.column[i], grid.row[j]
    for row in rows:
        for column in columns:
            start, end = starts[column + row], starts[column + row + 1]
            if row > here[1]:
                _compare_north(points, start, end, group)
            elif row < here[1]:
                _compare_south(points, start, end, group)
            elif column > here[0]:
                _compare_east(points, start, end, group)
            elif column < here[0]:
                _compare_west(points, start, end, group)
            else:
                _compare(points, start, end, group)
    _need_beyond(grid, i, j, group, need)
    return True


@njit(cache=True)
def _need_beyond(grid, i, j, group, need):
    """Squared reach per quadrant of the lanes whose best is beyond the edges of 3 x 3 cells."""
    # A millionth of a cell covers the rounding of a place to its cell.
    west = (i - 1 + 1e-6) * grid.size if i > 1 else -np.inf
    east = (i + 2 - 1e-6) * grid.size if i + 2 < len(grid.column) else np.inf
    south = (j - 1 + 1e-6) * grid.size if j > 1 else -np.inf
    north = (j + 2 - 1e-6) * grid.size if j + 2 < len(grid.row) else np.inf
    need[:] = 0.0
    for k in range(LANES):
        x, y = group[X + k] - grid.x0, group[Y + k] - grid.y0
        reach = (
            min(east - x, north - y),
            min(x - west, north - y),
            min(x - west, y - south),
            min(east - x, y - south),
        )
        for q in range(4):
            best = group[BEST + q * LANES + k]
            if best > reach[q] * reach[q]:
                need[q] = max(need[q], best)


@njit(cache=True)
def _search_tree(points, tree, leaf, group, need, stack):
    """Climb from a leaf, and search each branch passed on the way, the nearer box first."""
    boxes, m = tree.boxes, len(tree.boxes) // 2
    above = leaf
    while above > 1:
        stack[0] = above ^ 1
        above //= 2
        top = 1
        while top:
            top -= 1
            node = stack[top]
            gap = _gap(boxes, leaf, node, need)
            while node < m and gap < np.inf:
                node, far = 2 * node, 2 * node + 1
                gap, far_gap = _gap(boxes, leaf, node, need), _gap(boxes, leaf, far, need)
                if far_gap < gap:
                    node, far, gap, far_gap = far, node, far_gap, gap
                stack[top] = far
                top += far_gap < np.inf
            if gap < np.inf:
                _compare_leaf(points, tree, leaf, node, group)
                for q in range(4):
                    need[q] = min(need[q], _worst(group, q))


@njit(cache=True)
def _gap(boxes, leaf, node, need):
    """Squared gap between two boxes; inf where the node has nothing that the leaf needs."""
    x_low, x_high, y_low, y_high = boxes[leaf, 0], boxes[leaf, 1], boxes[leaf, 2], boxes[leaf, 3]
    low_x, high_x, low_y, high_y = boxes[node, 0], boxes[node, 1], boxes[node, 2], boxes[node, 3]
    dx = max(low_x - x_high, x_low - high_x, 0.0)
    dy = max(low_y - y_high, y_low - high_y, 0.0)
    d = dx * dx + dy * dy
    useful = (d < need[0]) & (high_x > x_low) & (high_y >= y_low)
    useful |= (d < need[1]) & (low_x <= x_high) & (high_y > y_low)
    useful |= (d < need[2]) & (low_x < x_high) & (low_y <= y_high)
    useful |= (d < need[3]) & (high_x >= x_low) & (low_y < y_high)
    return d if useful else np.inf


@njit(cache=True)
def _compare_leaf(points, tree, leaf, node, group):
    """Compare with the points of another leaf, cheaper where it lies to one side."""
    here, there = tree.boxes[leaf], tree.boxes[node]
    k = node - len(tree.boxes) // 2
    start, end = tree.leaves[k], tree.leaves[k + 1]
    if there[2] > here[3]:
        _compare_north(points, start, end, group)
    elif there[3] < here[2]:
        _compare_south(points, start, end, group)
    elif there[0] > here[1]:
        _compare_east(points, start, end, group)
    elif there[1] < here[0]:
        _compare_west(points, start, end, group)
    else:
        _compare(points, start, end, group)


@njit(cache=True, fastmath={"nnan", "nsz"})
def _worst(group, q):
    """Largest of a quadrant's squared distances."""
    worst = 0.0
    for k in range(BEST + q * LANES, BEST + (q + 1) * LANES):
        worst = max(worst, group[k])
    return worst


@njit(cache=True)
def _scatter(rows, start, end, radius, group, of, distances):
    """Sort each lane's four distances and put them into the row of its point."""
    for k in range(end - start):
        if not of[rows[start + k]]:
            continue
        a, b = math.sqrt(group[BEST + k]), math.sqrt(group[BEST + LANES + k])
        c, d = math.sqrt(group[BEST + 2 * LANES + k]), math.sqrt(group[BEST + 3 * LANES + k])
        a, b, c, d = min(a, b), max(a, b), min(c, d), max(c, d)
        a, b, c, d = min(a, c), min(b, d), max(a, c), max(b, d)
        row = distances[rows[start + k]]
        row[0], row[1], row[2], row[3] = a, min(b, c), max(b, c), d
        for q in range(4):
            if row[q] > radius:
                row[q] = np.nan


def nearest_per_sector(xy, limit, count, width):
    """Distances to the nearest point in each of ``count`` overlapping sectors, shape (n, count).

    Directions are axial: 0 to 180 degrees in ``count`` steps, each the middle of a sector ``width``
    (odd) steps wide that is open both ways. Infinite where no point is within ``limit``.
    """
    low = xy.min(axis=0)
    extent = np.ptp(xy, axis=0).max()
    cell = max(np.sqrt(2 * np.prod(np.ptp(xy, axis=0)) / len(xy)), extent / len(xy), limit / 64)
    cells = sort_into_cells(xy - low, cell)
    order, shape = cells.order, cells.places.max(axis=0) + 1
    first = np.searchsorted(cells.places @ [shape[1], 1], np.arange(np.prod(shape) + 1))
    first = cells.starts[first]
    of = np.repeat(cells.places, np.diff(cells.starts), axis=0)
    nearest = np.empty((len(xy), count))
    _search_sectors(xy[order] - low, of, shape, first, cell, limit, width, nearest)
    back = np.empty_like(nearest)
    back[order] = nearest
    return back


@njit(cache=True, nogil=True)
def _search_sectors(xy, cells, shape, first, cell, limit, width, out):
    """Widen a square of cells around each point until every sector has its nearest point."""
    count = out.shape[1]
    steps, wide = np.empty(count), np.empty(count + width - 1)
    for i in range(len(xy)):
        steps[:] = np.inf
        x, y = xy[i]
        cx, cy = cells[i]
        ring = 0
        while True:
            _look_around(xy, cx, cy, ring, shape, first, x, y, steps)
            # all points up to that distance have been seen
            seen = min(x - (cx - ring) * cell, (cx + ring + 1) * cell - x)
            seen = min(seen, y - (cy - ring) * cell, (cy + ring + 1) * cell - y)
            farthest = _widened(steps, width, wide, out[i])
            if seen >= min(farthest, limit):
                break
            ring += 1
        for k in range(count):
            if out[i, k] > limit:
                out[i, k] = np.inf


@njit(cache=True, nogil=True)
def _look_around(xy, cx, cy, ring, shape, first, x, y, steps):
    """Note the points in the cells of a square ring."""
    for row in range(max(cy - ring, 0), min(cy + ring, shape[1] - 1) + 1):
        apart = 1 if abs(row - cy) == ring else 2 * ring
        for column in range(cx - ring, cx + ring + 1, apart):
            at = column * shape[1] + row
            if 0 <= column < shape[0]:
                _note(xy, first[at], first[at + 1], x, y, steps)


@njit(cache=True, nogil=True, inline="always")
def _note(xy, start, stop, x, y, steps):
    """Keep each neighbour that is the nearest of its step of direction."""
    for j in range(start, stop):
        dx, dy = xy[j, 0] - x, xy[j, 1] - y
        distance = np.sqrt(dx * dx + dy * dy)
        if distance > 0:
            turn = np.arctan2(dy, dx) / np.pi * len(steps)
            k = int(np.floor(turn + 0.5)) % len(steps)
            steps[k] = min(steps[k], distance)


@njit(cache=True, nogil=True)
def _widened(steps, width, wide, nearest):
    """The nearest over ``width`` steps about each; returns the largest of them."""
    count, half = len(steps), width // 2
    for k in range(len(wide)):
        wide[k] = steps[(k - half) % count]
    span = 1
    while 2 * span <= width:  # minima over 2, 4, 8, ... steps
        for k in range(len(wide) - span):
            wide[k] = min(wide[k], wide[k + span])
        span *= 2
    farthest = 0.0
    for k in range(count):
        nearest[k] = min(wide[k], wide[k + width - span])
        farthest = max(farthest, nearest[k])
    return farthest
