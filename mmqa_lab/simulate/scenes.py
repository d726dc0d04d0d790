"""Scenes: surfaces side by side, the search tree over them, and the rays that meet them.

Ray casting is exact and compiled. Rays descend a bounding volume hierarchy near child first, and
every hit solves the primitive's own equation: no mesh, no marching. Shafts are solved about the
ray's point closest to their centre, so that a post of 3 cm at 100 m keeps its digits.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_points
from mmqa_lab._compiled import in_threads, njit
from mmqa_lab.rotations import across
from mmqa_lab.simulate.surfaces import DISC, SHAFT, group

__all__ = ["Hits", "Scene", "Tree", "nearest"]

STACK_DEPTH = 128


class Hits(NamedTuple):
    """What rays met: one entry a ray, NaN and surface -1 where it met nothing.

    Parameters
    ----------
    range_m : array, shape (n,)
    surface : array of int, shape (n,)
        Ids in the order of the scene's surfaces.
    cosine : array, shape (n,)
        Of the angle of incidence, between ray and normal.
    reflectance : array, shape (n,)

    Examples
    --------
    >>> from mmqa_lab.simulate import ground
    >>> hits = Scene([ground()]).cast([[0, 0, 2.0]], [[0, 1, -1], [0, 0, 1]])
    >>> hits.cosine.round(6).tolist(), hits.surface.tolist()
    ([0.707107, nan], [0, -1])
    """

    range_m: np.ndarray
    surface: np.ndarray
    cosine: np.ndarray
    reflectance: np.ndarray


class Scene:
    """Surfaces and the search tree over them.

    Parameters
    ----------
    surfaces : iterable of Surface
        The place in the list is the surface's id.

    Attributes
    ----------
    surfaces : list of Surface
    origin : array, shape (3,)
        The coordinates' mean, taken off before anything is multiplied.
    tree : Tree
    balls : array, shape (n, 4)
        Centre of each primitive, from the origin, and radius of the ball around it.

    Raises
    ------
    ValueError
        If there are no surfaces.

    Examples
    --------
    >>> from mmqa_lab.simulate import cylinder, ground
    >>> scene = Scene([ground(), cylinder([5, 0, 0], [5, 0, 4], 0.1, label="post")])
    >>> hits = scene.cast([[0, 0, 2]], [[1, 0, 0]])
    >>> float(hits.range_m[0]), scene.surfaces[hits.surface[0]].label
    (4.9, 'post')
    """

    def __init__(self, surfaces):
        self.surfaces = list(surfaces)
        if not self.surfaces:
            raise ValueError("Invalid surfaces: none given. Must be one or more.")
        whole = group(self.surfaces, label="")
        self.origin = np.round(whole.centre.mean(axis=0))
        centre = whole.centre - self.origin
        order, *nodes = _hierarchy(centre - whole.half, centre + whole.half, centre)
        self.tree = Tree(*nodes, whole.kind[order], centre[order], whole.shape[order])
        self.balls = np.column_stack([centre, np.linalg.norm(whole.half, axis=1)])
        ids = np.repeat(np.arange(len(self.surfaces), dtype=np.int32), [*map(len, self.surfaces)])
        # the last entry, -1, is of rays that meet nothing
        self._surface = np.append(ids[order], np.int32(-1))
        self._reflectance = np.append(whole.reflectance[order], np.nan)
        self._kind, self._shape = whole.kind, whole.shape

    @cached_property
    def boxes(self):
        """Axes (n, 3, 3) and half sizes (n, 3) of the box around each primitive."""
        axes, shaft = self._shape.reshape(-1, 3, 3).copy(), self._kind == SHAFT
        axes[shaft, 1:] = across(axes[shaft, 0])
        length = np.linalg.norm(axes, axis=2)
        half = np.column_stack([1 / length[:, :2], 0 * length[:, 2]])
        _, _, _, long, radius, growth, *_ = self._shape[shaft].T
        half[shaft] = np.column_stack([long, *2 * [radius + np.abs(growth) * long]])
        return axes / length[:, :, None], half

    def cast(self, origins: ArrayLike, directions: ArrayLike) -> Hits:
        """Return the ``Hits`` of rays.

        Parameters
        ----------
        origins : array_like, shape (n, 3) or (3,)
            Metres; one for all rays or one for each.
        directions : array_like, shape (n, 3)
            Of any length above zero.

        Raises
        ------
        ValueError
            If a direction has no length.
        """
        directions = check_points(directions, name="directions")
        length = np.linalg.norm(directions, axis=1, keepdims=True)
        if not length.all():
            raise ValueError(f"Invalid direction in row {np.argmin(length)}. Must be > 0 m long.")
        unit = directions / length
        local = np.broadcast_to(check_points(np.atleast_2d(origins)) - self.origin, unit.shape)
        return Hits(*(values[:, 0] for values in self.cast_beams(local[:, None], unit[:, None])))

    def cast_beams(self, origins: np.ndarray, directions: np.ndarray) -> Hits:
        """Return the ``Hits`` (n, k) of n beams of k rays that stay close together, (n, k, 3).

        Starts count from the scene's origin, directions have the length 1.
        """
        shape = directions.shape[:2]
        ranges, cosine = np.empty(shape), np.full(shape, np.nan)
        hit = np.empty(shape, np.int64)
        rays = np.concatenate([origins, directions], axis=2)
        in_threads(_cast, shape[0], self.tree, rays, ranges, hit, cosine, least=20_000)
        ranges[hit < 0] = np.nan
        return Hits(ranges, self._surface[hit], cosine, self._reflectance[hit])


class Tree(NamedTuple):
    """Primitives in the order of their bounding volume hierarchy.

    The numbers of ``shape`` are, for rectangles and discs, the dual vectors p and q (local
    coordinates s = p.x, t = q.x from the centre) and the unit normal; for a shaft its unit axis,
    half length, radius at the centre, growth of the radius along the axis, whether it is capped.
    """

    low: np.ndarray  # (nodes, 3) corner of each node's box
    high: np.ndarray
    link: np.ndarray  # (nodes,) first primitive of a leaf, right child of an inner node
    primitives: np.ndarray  # (nodes,) primitives of a leaf, 0 in inner nodes
    axis: np.ndarray  # (nodes,) split axis
    kind: np.ndarray  # (n,)
    centre: np.ndarray  # (n, 3) from the origin of the scene
    shape: np.ndarray  # (n, 9)


@njit(cache=True)
def _hierarchy(box_low, box_high, centre):
    """Order of the primitives and the nodes over them, left child next to its parent."""
    n = len(centre)
    order = np.arange(n)
    low, high = np.full((2 * n, 3), np.inf), np.full((2 * n, 3), -np.inf)
    link, count = np.zeros(2 * n, np.int64), np.zeros(2 * n, np.int64)
    axis = np.zeros(2 * n, np.int64)
    todo = [(0, n, -1, 0)]
    node = -1
    while len(todo):
        start, stop, parent, depth = todo.pop()
        node += 1
        if parent >= 0:
            link[parent] = node
        members = order[start:stop]
        for i in members:
            for k in range(3):
                low[node, k] = min(low[node, k], box_low[i, k] - 1e-9)
                high[node, k] = max(high[node, k], box_high[i, k] + 1e-9)
        if stop - start <= 4:
            link[node], count[node] = start, stop - start
            continue
        axis[node], middle = _cut(members, centre, depth)
        todo.append((start + middle, stop, node, depth + 1))
        todo.append((start, start + middle, -1, depth + 1))
    nodes = node + 1
    return order, low[:nodes], high[:nodes], link[:nodes], count[:nodes], axis[:nodes]


@njit(cache=True)
def _cut(members, centre, depth):
    """Cut a node where its centres' extent is widest, in the middle; return axis and place.

    Below 60 levels, nodes are halved by number, so that ``STACK_DEPTH`` suffices.
    """
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for i in members:
        for k in range(3):
            low[k], high[k] = min(low[k], centre[i, k]), max(high[k], centre[i, k])
    axis = int(np.argmax(high - low))
    first = 0
    for j in range(len(members)):
        if centre[members[j], axis] < 0.5 * (low[axis] + high[axis]):
            members[first], members[j] = members[j], members[first]
            first += 1
    if depth < 60 and 0 < first < len(members):
        return axis, first
    return axis, len(members) // 2


@njit(cache=True, error_model="numpy")
def _shaft(shape, ox, oy, oz, dx, dy, dz):
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


@njit(cache=True, error_model="numpy", inline="always")
def _range_to(tree, i, rays, k, best):
    """Range along unit ray ``k`` to primitive ``i``, inf where it misses or is beyond ``best``."""
    c, s, dx, dy, dz = tree.centre, tree.shape[i], rays[k, 3], rays[k, 4], rays[k, 5]
    ox, oy, oz = rays[k, 0] - c[i, 0], rays[k, 1] - c[i, 1], rays[k, 2] - c[i, 2]
    if tree.kind[i] == SHAFT:
        return _shaft(s, ox, oy, oz, dx, dy, dz)
    t = -(s[6] * ox + s[7] * oy + s[8] * oz) / (s[6] * dx + s[7] * dy + s[8] * dz)
    if not 0.0 < t < best:
        return np.inf
    x, y, z = ox + t * dx, oy + t * dy, oz + t * dz
    u = s[0] * x + s[1] * y + s[2] * z
    v = s[3] * x + s[4] * y + s[5] * z
    if tree.kind[i] == DISC:
        return t if u * u + v * v <= 1.0 else np.inf
    return t if abs(u) <= 1.0 and abs(v) <= 1.0 else np.inf


@njit(cache=True)
def _reciprocal(x):
    """1 / x with a huge number in place of infinity, so that 0 times it stays 0."""
    return 1.0 / x if abs(x) > 1e-290 else 1e290


@njit(cache=True, error_model="numpy", inline="always")
def _may_hit(low, high, node, rays, k, best):
    """Whether ray ``k`` meets the box of a node before ``best``."""
    enter, leave = 0.0, best
    for j in range(3):
        a = (low[node, j] - rays[k, j]) * rays[k, 6 + j]
        b = (high[node, j] - rays[k, j]) * rays[k, 6 + j]
        enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
    return leave >= enter


@njit(cache=True, error_model="numpy")
def nearest(tree, stack, rays, best, hit):
    """Write range and index of the first primitive that each unit ray meets; inf, -1 where none.

    Parameters
    ----------
    tree : Tree
    stack : array of int, shape (STACK_DEPTH,)
        To work with.
    rays : array, shape (k, 9)
        Start, direction, and room for the reciprocals of the direction. Rays that stay close
        together share their way down the tree.
    best, hit : array, shape (k,)
    """
    for k in range(len(rays)):
        best[k], hit[k] = np.inf, -1
        for j in range(3, 6):
            rays[k, j + 3] = _reciprocal(rays[k, j])
    low, high = tree.low, tree.high
    depth = 1
    stack[0] = 0
    while depth > 0:
        depth -= 1
        node = stack[depth]
        if tree.primitives[node] > 0:
            for k in range(len(rays)):
                if _may_hit(low, high, node, rays, k, best[k]):
                    for i in range(tree.link[node], tree.link[node] + tree.primitives[node]):
                        t = _range_to(tree, i, rays, k, best[k])
                        if t < best[k]:
                            best[k], hit[k] = t, i
            continue
        for k in range(len(rays)):
            if _may_hit(low, high, node, rays, k, best[k]):
                forward = rays[0, 3 + tree.axis[node]] >= 0.0
                stack[depth] = tree.link[node] if forward else node + 1
                stack[depth + 1] = node + 1 if forward else tree.link[node]
                depth += 2
                break


@njit(cache=True, error_model="numpy")
def _cosine(tree, ray, t, i):
    """Cosine of the angle at which a ray meets primitive ``i`` at ``t``."""
    s, c = tree.shape[i], tree.centre[i]
    nx, ny, nz = s[6], s[7], s[8]
    if tree.kind[i] == SHAFT:
        x, y, z = ray[0] - c[0] + t * ray[3], ray[1] - c[1] + t * ray[4], ray[2] - c[2] + t * ray[5]
        h = x * s[0] + y * s[1] + z * s[2]
        r = s[4] + s[5] * h
        mx, my, mz = x - h * s[0], y - h * s[1], z - h * s[2]
        radial = np.sqrt(mx * mx + my * my + mz * mz)
        if s[6] > 0.0 and abs(s[3] - abs(h)) < abs(r - radial):
            nx, ny, nz = s[0], s[1], s[2]
        else:
            nx, ny, nz = mx - r * s[5] * s[0], my - r * s[5] * s[1], mz - r * s[5] * s[2]
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    return abs(nx * ray[3] + ny * ray[4] + nz * ray[5]) / length


@njit(cache=True, nogil=True, error_model="numpy")
def _cast(begin, end, tree, beams, ranges, hit, cosine):
    """Write range, primitive and cosine of incidence of rays, (n, k), inf and -1 where none."""
    stack, rays = np.empty(STACK_DEPTH, np.int64), np.empty((beams.shape[1], 9))
    for n in range(begin, end):
        for k in range(len(rays)):
            for j in range(6):
                rays[k, j] = beams[n, k, j]
        nearest(tree, stack, rays, ranges[n], hit[n])
        for k in range(len(rays)):
            if hit[n, k] >= 0:
                cosine[n, k] = _cosine(tree, rays[k], ranges[n, k], hit[n, k])
