"""Exact ray casting against planar, conical and ellipsoidal primitives, compiled.

The primitives lie in a bounding volume hierarchy (binned surface-area heuristic), rays descend it
near child first. Every hit solves the primitive's own equation: no mesh, no marching. Curved
primitives are solved about the point of the ray closest to their centre, so that a post of 3 cm at
100 m keeps its digits.
"""

from contextlib import contextmanager
from typing import NamedTuple

import numba
import numpy as np
from numba import njit, prange

PARALLELOGRAM, ELLIPSE, POLYGON, FRUSTUM, ELLIPSOID = range(5)
"""Kinds of primitives; the meaning of their nine shape numbers stands in ``Tree.shape``."""

BINS = 16
LEAF_SIZE = 4
DEEPEST = 60  # levels cut where the heuristic says; below, halves, so that STACK suffices
STACK = 128
TASK = 512
RAYS_A_THREAD = 20_000  # fewer are not worth waking another thread for
FOOTPRINT = 7  # rays a beam: its axis and a ring
RING = 0.651  # radius of the ring over the 1/e2 radius: median of the outer 6/7 of a Gaussian beam


class Tree(NamedTuple):
    """Primitives in the order of their bounding volume hierarchy.

    ``shape`` holds, for planar kinds, the dual vectors p and q (local coordinates s = p.x, t = q.x
    from the centre) and the unit normal; for a frustum its unit axis, half length, radius at
    the centre, growth of the radius along the axis, whether it is capped; for an ellipsoid the
    rows of the matrix that maps it to the unit sphere.
    """

    low: np.ndarray  # (nodes, 3) corner of each node's box
    high: np.ndarray
    link: np.ndarray  # (nodes,) first primitive of a leaf, right child of an inner node
    count: np.ndarray  # (nodes,) primitives of a leaf, 0 in inner nodes
    axis: np.ndarray  # (nodes,) split axis
    kind: np.ndarray  # (n,)
    centre: np.ndarray  # (n, 3) from the origin of the scene
    shape: np.ndarray  # (n, 9)
    surface: np.ndarray  # (n,) id of the surface a primitive belongs to
    outline: np.ndarray  # (n, 2) first and last edge of a polygon
    cells: np.ndarray  # (n, 3) first reflectance, rows, columns
    edges: np.ndarray  # (m, 4) s, t of the start and the end of each polygon edge
    reflectance: np.ndarray  # (k,) of the cells


@contextmanager
def enough_threads(n):
    """Let compiled code use no more threads than ``n`` rays keep busy."""
    before = numba.get_num_threads()
    numba.set_num_threads(min(before, 1 + n // RAYS_A_THREAD))
    try:
        yield
    finally:
        numba.set_num_threads(before)


def build(kind, centre, shape, half, surface, outline, cells, edges, reflectance):
    """Return the ``Tree`` of primitives whose boxes are ``centre`` +- ``half``."""
    order, low, high, link, count, axis = _hierarchy(centre - half, centre + half)
    sorted_ = (a[order] for a in (kind, centre, shape, surface, outline, cells))
    return Tree(low, high, link, count, axis, *sorted_, edges, reflectance)


@njit(cache=True)
def _hierarchy(box_low, box_high):
    """Order of the primitives and the nodes over them, left child next to its parent."""
    n = len(box_low)
    centre = 0.5 * (box_low + box_high)
    order = np.arange(n)
    size = max(2 * n, 1)
    low, high = np.full((size, 3), np.inf), np.full((size, 3), -np.inf)
    link, count = np.zeros(size, np.int64), np.zeros(size, np.int64)
    axis = np.zeros(size, np.int64)
    todo = [(0, n, -1, 0)]
    nodes = 0
    while len(todo):
        start, stop, parent, depth = todo.pop()
        node = nodes
        nodes += 1
        if parent >= 0:
            link[parent] = node
        for i in order[start:stop]:
            for k in range(3):
                low[node, k] = min(low[node, k], box_low[i, k] - 1e-9)
                high[node, k] = max(high[node, k], box_high[i, k] + 1e-9)
        if stop - start <= LEAF_SIZE:
            link[node], count[node] = start, stop - start
            continue
        middle = (start + stop) // 2
        if depth < DEEPEST:
            split, position = _best_split(order[start:stop], box_low, box_high, centre)
            middle = _partition(order, start, stop, centre[:, split], position)
            axis[node] = split
        todo.append((middle, stop, node, depth + 1))
        todo.append((start, middle, -1, depth + 1))
    return order, low[:nodes], high[:nodes], link[:nodes], count[:nodes], axis[:nodes]


@njit(cache=True)
def _best_split(members, box_low, box_high, centre):
    """Axis and position where the surface-area heuristic cuts a node."""
    best, best_axis, best_position = np.inf, 0, np.nan
    for k in range(3):
        first, last = np.inf, -np.inf
        for i in members:
            first, last = min(first, centre[i, k]), max(last, centre[i, k])
        if last <= first:
            continue
        cost = _bin_costs(members, box_low, box_high, centre, k, first, last)
        b = int(np.argmin(cost))
        if cost[b] < best:
            best, best_axis = cost[b], k
            best_position = first + (last - first) * (b + 1) / BINS
    return best_axis, best_position


@njit(cache=True)
def _bin_costs(members, box_low, box_high, centre, k, first, last):
    """Cost of cutting axis ``k`` after each bin."""
    lows, highs = np.full((BINS, 3), np.inf), np.full((BINS, 3), -np.inf)
    held = np.zeros(BINS)
    for i in members:
        b = min(int(BINS * (centre[i, k] - first) / (last - first)), BINS - 1)
        held[b] += 1
        for j in range(3):
            lows[b, j] = min(lows[b, j], box_low[i, j])
            highs[b, j] = max(highs[b, j], box_high[i, j])
    cost = np.zeros(BINS - 1)
    for side in (1, -1):
        low, high, n = np.full(3, np.inf), np.full(3, -np.inf), 0.0
        for step in range(BINS - 1):
            b = step if side == 1 else BINS - 1 - step
            n += held[b]
            low, high = np.minimum(low, lows[b]), np.maximum(high, highs[b])
            e = np.maximum(high - low, 0.0)
            area = e[0] * e[1] + e[1] * e[2] + e[2] * e[0]
            cost[b if side == 1 else b - 1] += n * area if n > 0 else 0.0
    return cost


@njit(cache=True)
def _partition(order, start, stop, key, position):
    """Move members below ``position`` to the front; halves where nothing separates them."""
    i = start
    for j in range(start, stop):
        if key[order[j]] < position:
            order[i], order[j] = order[j], order[i]
            i += 1
    return i if start < i < stop else (start + stop) // 2


@njit(cache=True, error_model="numpy", inline="always")
def _planar(tree, i, ox, oy, oz, dx, dy, dz):
    """Range to a planar primitive; ``ox`` ... is the ray's start from the centre."""
    s = tree.shape[i]
    t = -(s[6] * ox + s[7] * oy + s[8] * oz) / (s[6] * dx + s[7] * dy + s[8] * dz)
    if not 0.0 < t < np.inf:
        return np.inf
    x, y, z = ox + t * dx, oy + t * dy, oz + t * dz
    u = s[0] * x + s[1] * y + s[2] * z
    v = s[3] * x + s[4] * y + s[5] * z
    kind = tree.kind[i]
    if kind == PARALLELOGRAM:
        return t if abs(u) <= 1.0 and abs(v) <= 1.0 else np.inf
    if kind == ELLIPSE:
        return t if u * u + v * v <= 1.0 else np.inf
    inside = False
    for e in range(tree.outline[i, 0], tree.outline[i, 1]):
        a, b, c, d = tree.edges[e, 0], tree.edges[e, 1], tree.edges[e, 2], tree.edges[e, 3]
        if (b > v) != (d > v) and u < a + (c - a) * (v - b) / (d - b):
            inside = not inside
    return t if inside else np.inf


@njit(cache=True, error_model="numpy")
def _frustum(shape, ox, oy, oz, dx, dy, dz):
    """Range to a cone frustum: its mantle, and its caps where it has them."""
    ax, ay, az, half, radius, growth = shape[0], shape[1], shape[2], shape[3], shape[4], shape[5]
    shift = -(ox * dx + oy * dy + oz * dz)
    ox, oy, oz = ox + shift * dx, oy + shift * dy, oz + shift * dz
    z0, dzz = ox * ax + oy * ay + oz * az, dx * ax + dy * ay + dz * az
    mx, my, mz = ox - z0 * ax, oy - z0 * ay, oz - z0 * az
    ex, ey, ez = dx - dzz * ax, dy - dzz * ay, dz - dzz * az
    r0, dr = radius + growth * z0, growth * dzz
    a = ex * ex + ey * ey + ez * ez - dr * dr
    b = mx * ex + my * ey + mz * ez - r0 * dr
    c = mx * mx + my * my + mz * mz - r0 * r0
    best = np.inf
    root = b * b - a * c
    if root >= 0.0 and a != 0.0:
        root = np.sqrt(root)
        for t in ((-b - root) / a, (-b + root) / a):
            z = z0 + t * dzz
            if abs(z) <= half and r0 + t * dr >= 0.0 and 0.0 < t + shift < best:
                best = t + shift
    if shape[6] > 0.0 and dzz != 0.0:
        for end in (-half, half):
            t = (end - z0) / dzz
            x, y, z = mx + t * ex, my + t * ey, mz + t * ez
            r = radius + growth * end
            if x * x + y * y + z * z <= r * r and 0.0 < t + shift < best:
                best = t + shift
    return best


@njit(cache=True, error_model="numpy")
def _ellipsoid(s, ox, oy, oz, dx, dy, dz):
    """Range to an ellipsoid, solved on the unit sphere."""
    px, py, pz = _map(s, ox, oy, oz)
    ex, ey, ez = _map(s, dx, dy, dz)
    a = ex * ex + ey * ey + ez * ez
    shift = -(px * ex + py * ey + pz * ez) / a
    px, py, pz = px + shift * ex, py + shift * ey, pz + shift * ez
    root = (1.0 - px * px - py * py - pz * pz) / a
    if root < 0.0:
        return np.inf
    root = np.sqrt(root)
    if shift - root > 0.0:
        return shift - root
    return shift + root if shift + root > 0.0 else np.inf


@njit(cache=True)
def _map(s, x, y, z):
    """The rows of ``s`` as a matrix, applied."""
    return (
        s[0] * x + s[1] * y + s[2] * z,
        s[3] * x + s[4] * y + s[5] * z,
        s[6] * x + s[7] * y + s[8] * z,
    )


@njit(cache=True, error_model="numpy", inline="always")
def _range_to(tree, i, ox, oy, oz, dx, dy, dz):
    """Range along a unit ray to primitive ``i``, inf where it misses."""
    c = tree.centre[i]
    ox, oy, oz = ox - c[0], oy - c[1], oz - c[2]
    if tree.kind[i] == FRUSTUM:
        return _frustum(tree.shape[i], ox, oy, oz, dx, dy, dz)
    if tree.kind[i] == ELLIPSOID:
        return _ellipsoid(tree.shape[i], ox, oy, oz, dx, dy, dz)
    return _planar(tree, i, ox, oy, oz, dx, dy, dz)


@njit(cache=True)
def _reciprocal(x):
    """1 / x with a huge number in place of infinity, so that 0 times it stays 0."""
    return 1.0 / x if abs(x) > 1e-290 else 1e290


@njit(cache=True, error_model="numpy")
def nearest(tree, stack, ox, oy, oz, dx, dy, dz):
    """Range and index of the first primitive a unit ray meets; (inf, -1) where none."""
    ix, iy, iz = _reciprocal(dx), _reciprocal(dy), _reciprocal(dz)
    best, hit = np.inf, -1
    depth = 1
    stack[0] = 0
    while depth > 0:
        depth -= 1
        node = stack[depth]
        low, high = tree.low[node], tree.high[node]
        a, b = (low[0] - ox) * ix, (high[0] - ox) * ix
        enter, leave = min(a, b), max(a, b)
        a, b = (low[1] - oy) * iy, (high[1] - oy) * iy
        enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
        a, b = (low[2] - oz) * iz, (high[2] - oz) * iz
        enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
        if leave < max(enter, 0.0) or enter > best:
            continue
        if tree.count[node] > 0:
            for i in range(tree.link[node], tree.link[node] + tree.count[node]):
                t = _range_to(tree, i, ox, oy, oz, dx, dy, dz)
                if t < best:
                    best, hit = t, i
            continue
        axis = tree.axis[node]
        forward = (dx, dy, dz)[axis] >= 0.0
        stack[depth] = tree.link[node] if forward else node + 1
        stack[depth + 1] = node + 1 if forward else tree.link[node]
        depth += 2
    return best, hit


@njit(cache=True, error_model="numpy")
def describe(tree, i, x, y, z):
    """Unit normal and reflectance of primitive ``i`` at a point of it, given from its centre."""
    s = tree.shape[i]
    kind = tree.kind[i]
    if kind == FRUSTUM:
        h = x * s[0] + y * s[1] + z * s[2]
        r = s[4] + s[5] * h
        mx, my, mz = x - h * s[0], y - h * s[1], z - h * s[2]
        radial = np.sqrt(mx * mx + my * my + mz * mz)
        if s[6] > 0.0 and abs(s[3] - abs(h)) < abs(r - radial):
            nx, ny, nz = s[0], s[1], s[2]
        else:
            nx, ny, nz = mx - r * s[5] * s[0], my - r * s[5] * s[1], mz - r * s[5] * s[2]
    elif kind == ELLIPSOID:
        px, py, pz = _map(s, x, y, z)
        nx = s[0] * px + s[3] * py + s[6] * pz
        ny = s[1] * px + s[4] * py + s[7] * pz
        nz = s[2] * px + s[5] * py + s[8] * pz
    else:
        nx, ny, nz = s[6], s[7], s[8]
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    return nx / length, ny / length, nz / length, _cell(tree, i, x, y, z)


@njit(cache=True)
def _cell(tree, i, x, y, z):
    """Reflectance of the cell a point lies in."""
    first, rows, columns = tree.cells[i]
    if rows * columns == 1:
        return tree.reflectance[first]
    s = tree.shape[i]
    u, v = s[0] * x + s[1] * y + s[2] * z, s[3] * x + s[4] * y + s[5] * z
    column = min(max(int(0.5 * (u + 1.0) * columns), 0), columns - 1)
    row = min(max(int(0.5 * (v + 1.0) * rows), 0), rows - 1)
    return tree.reflectance[first + row * columns + column]


@njit(cache=True)
def _turned(state, x, y, z):
    """Rz(-heading) Rx(pitch) Ry(roll), the angles at the end of ``state``, applied to a vector."""
    s, c = np.sin(state[3]), np.cos(state[3])
    x, z = c * x + s * z, c * z - s * x
    s, c = np.sin(state[4]), np.cos(state[4])
    y, z = c * y - s * z, s * y + c * z
    s, c = np.sin(state[5]), np.cos(state[5])
    return c * x + s * y, c * y - s * x, z


def beam_rays(states, lever_arm, mounting, beams):
    """Origins and directions of beams in a mounted scanner's frame on a vehicle in given states.

    ``states`` are offsets in metres and roll, pitch, heading in radians, (n, 6).
    """
    with enough_threads(len(beams)):
        return _beam_rays(states, lever_arm, mounting, beams)


@njit(cache=True, parallel=True)
def _beam_rays(states, lever_arm, mounting, beams):
    """The arrays of ``beam_rays``."""
    n = len(beams)
    origins, directions = np.empty((n, 3)), np.empty((n, 3))
    matrix = np.ascontiguousarray(mounting).ravel()
    for k in prange(n):
        x, y, z = _turned(states[k], lever_arm[0], lever_arm[1], lever_arm[2])
        origins[k, 0], origins[k, 1] = states[k, 0] + x, states[k, 1] + y
        origins[k, 2] = states[k, 2] + z
        x, y, z = _map(matrix, beams[k, 0], beams[k, 1], beams[k, 2])
        x, y, z = _turned(states[k], x, y, z)
        directions[k, 0], directions[k, 1], directions[k, 2] = x, y, z
    return origins, directions


def cast(tree, origins, directions):
    """Range, surface, normal and reflectance where unit rays first meet a primitive."""
    with enough_threads(len(directions)):
        return _cast(tree, origins, directions)


@njit(cache=True, parallel=True, error_model="numpy")
def _cast(tree, origins, directions):
    """The arrays of ``cast``."""
    n = len(origins)
    ranges, surface = np.full(n, np.inf), np.full(n, -1, np.int32)
    normal, reflectance = np.full((n, 3), np.nan), np.full(n, np.nan)
    for task in prange((n + TASK - 1) // TASK):
        stack = np.empty(STACK, np.int64)
        for k in range(task * TASK, min((task + 1) * TASK, n)):
            ox, oy, oz = origins[k, 0], origins[k, 1], origins[k, 2]
            dx, dy, dz = directions[k, 0], directions[k, 1], directions[k, 2]
            t, i = nearest(tree, stack, ox, oy, oz, dx, dy, dz)
            if i >= 0:
                c = tree.centre[i]
                x, y, z = ox - c[0] + t * dx, oy - c[1] + t * dy, oz - c[2] + t * dz
                normal[k, 0], normal[k, 1], normal[k, 2], reflectance[k] = describe(
                    tree, i, x, y, z
                )
                ranges[k], surface[k] = t, tree.surface[i]
    return ranges, surface, normal, reflectance


@njit(cache=True, error_model="numpy")
def _perpendicular(dx, dy, dz, turn):
    """Unit vector square to a unit vector, at a turn about it in radians."""
    if abs(dx) < 0.6:
        ax, ay, az = 0.0, dz, -dy
    else:
        ax, ay, az = -dz, 0.0, dx
    length = np.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / length, ay / length, az / length
    bx, by, bz = dy * az - dz * ay, dz * ax - dx * az, dx * ay - dy * ax
    c, s = np.cos(turn), np.sin(turn)
    return c * ax + s * bx, c * ay + s * by, c * az + s * bz


@njit(cache=True, error_model="numpy")
def _hit(tree, stack, ray, echo):
    """Write range, signal, cosine and surface of a unit ray into ``echo``; False where none."""
    t, i = nearest(tree, stack, ray[0], ray[1], ray[2], ray[3], ray[4], ray[5])
    if i < 0:
        return False
    c = tree.centre[i]
    x, y, z = ray[0] - c[0] + t * ray[3], ray[1] - c[1] + t * ray[4], ray[2] - c[2] + t * ray[5]
    nx, ny, nz, reflectance = describe(tree, i, x, y, z)
    cosine = abs(nx * ray[3] + ny * ray[4] + nz * ray[5])
    echo[0], echo[1] = t, reflectance * cosine / (t * t)
    echo[2], echo[3] = cosine, tree.surface[i]
    return True


@njit(cache=True, error_model="numpy")
def _strongest(hits, n, separation):
    """First and last of the sorted hits that make the strongest echo."""
    best, first, last = -1.0, 0, 0
    start = 0
    while start < n:
        stop, signal = start, 0.0
        while stop < n and (stop == start or hits[stop, 0] - hits[stop - 1, 0] <= separation):
            signal += hits[stop, 1]
            stop += 1
        if signal > best:
            best, first, last = signal, start, stop
        start = stop
    return first, last


@njit(cache=True, error_model="numpy")
def _footprint(tree, stack, ray, part, hits, radius, growth, turn):
    """Hits of the rays that stand for equal shares of a Gaussian beam, nearest first."""
    n = 1 if _hit(tree, stack, ray, hits[0]) else 0
    for k in range(FOOTPRINT - 1):
        ex, ey, ez = _perpendicular(ray[3], ray[4], ray[5], turn + 2 * np.pi * k / (FOOTPRINT - 1))
        g = RING * growth
        length = np.sqrt(1 + g * g)
        part[0] = ray[0] + RING * radius * ex
        part[1] = ray[1] + RING * radius * ey
        part[2] = ray[2] + RING * radius * ez
        part[3] = (ray[3] + g * ex) / length
        part[4] = (ray[4] + g * ey) / length
        part[5] = (ray[5] + g * ez) / length
        if _hit(tree, stack, part, hits[n]):
            j = n
            while j > 0 and hits[j, 0] < hits[j - 1, 0]:
                for m in range(4):
                    hits[j, m], hits[j - 1, m] = hits[j - 1, m], hits[j, m]
                j -= 1
            n += 1
    return n


class Echoes(NamedTuple):
    """The strongest echo of each pulse, NaN and surface -1 where there is none.

    ``signal`` is reflectance x cosine(incidence) / range2, summed over the parts of the beam.
    """

    range_m: np.ndarray
    surface: np.ndarray
    cosine: np.ndarray
    signal: np.ndarray
    mixed: np.ndarray

    def select(self, which):
        """Return the echoes of a mask."""
        return Echoes(*(values[which] for values in self))


def echoes(tree, origins, directions, radius, growth, turn, separation):
    """Return the ``Echoes`` of pulses along unit directions.

    A beam of 1/e2 ``radius`` at the exit that grows by ``growth`` a metre is cast as its axis and a
    ring of six rays, each an equal share of its energy, turned by ``turn`` (0 to 1) at random. Hits
    closer than ``separation`` in range fall into one echo: its range is their mean weighted by the
    signal, its signal their sum, its surface and cosine those of its strongest part; it is mixed
    where they belong to several surfaces.
    """
    with enough_threads(len(directions)):
        return Echoes(*_echoes(tree, origins, directions, radius, growth, turn, separation))


@njit(cache=True, parallel=True, error_model="numpy")
def _echoes(tree, origins, directions, radius, growth, turn, separation):
    """The arrays of ``Echoes``."""
    n = len(origins)
    wide = radius > 0.0 or growth > 0.0
    ranges, surface = np.full(n, np.nan), np.full(n, -1, np.int32)
    cosine, signal = np.full(n, np.nan), np.zeros(n)
    mixed = np.zeros(n, np.bool_)
    for task in prange((n + TASK - 1) // TASK):
        stack = np.empty(STACK, np.int64)
        ray, part, hits = np.empty(6), np.empty(6), np.empty((FOOTPRINT, 4))
        for k in range(task * TASK, min((task + 1) * TASK, n)):
            ray[:3], ray[3:] = origins[k], directions[k]
            found, share = 0, 1.0
            if wide:
                share = 1.0 / FOOTPRINT
                found = _footprint(
                    tree, stack, ray, part, hits, radius, growth, 2 * np.pi * turn[k]
                )
            elif _hit(tree, stack, ray, hits[0]):
                found = 1
            if found == 0:
                continue
            first, last = _strongest(hits, found, separation)
            top, weighted = first, 0.0
            for j in range(first, last):
                signal[k] += hits[j, 1]
                weighted += hits[j, 1] * (hits[j, 0] - hits[first, 0])
                mixed[k] |= hits[j, 3] != hits[first, 3]
                if hits[j, 1] > hits[top, 1]:
                    top = j
            ranges[k] = hits[first, 0] + (weighted / signal[k] if signal[k] > 0.0 else 0.0)
            surface[k], cosine[k] = hits[top, 3], hits[top, 2]
            signal[k] *= share
    return ranges, surface, cosine, signal, mixed
