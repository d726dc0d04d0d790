"""Edges of the second street generator, for tests alone: truth by geometry, and how to score.

Every line in which two faces of a street touch is a true edge. It counts as visible where the
points of both faces show it for half a metre to either side, over a metre at least: kerbs and
window reveals are edges, but no edges of principal planes. Nothing is shared with ``mmqa_lab``.
"""

import numpy as np
from other_street import HEIGHT, cast, make

BAND, LEAST_M, NEAR_M, PARALLEL = 0.5, 1.0, 0.1, np.cos(np.radians(3))


def with_windows(street, rng):
    """The street with a row of windows per storey, set back, in every wall towards the road."""
    faces, street.faces = street.faces, []
    for row in faces:
        corner, u, v = np.array(row[:9]).reshape(3, 3)
        wide, high = np.linalg.norm(u), abs(v[2])
        upright = abs(u[2]) + np.hypot(v[0], v[1]) < 1e-9 and not row[9]
        if not (upright and 3 < wide < 20 and abs(u[0]) < 1e-9 and high > 4):
            street.faces.append(row)
            continue
        way, up = u / wide, np.array([0, 0, 1.0])
        inwards = np.sign(corner[0]) * np.array([1.0, 0, 0])
        deep, n = rng.uniform(0.1, 0.18), int(wide // 2.2)
        lefts = (np.arange(n) + 0.5) * wide / n - 0.5
        sills = np.arange(0.9, high - 1.9, 2.8)
        _pierced(street, corner, way, up, (wide, high), (lefts, 1.0), (sills, 1.4), deep * inwards)
    return street


def _pierced(street, corner, way, up, size, columns, rows, back):
    """A wall of some size with windows: columns at stations, rows at heights, their glass back."""

    def part(left, right, low, high, shift=0.0):
        start = corner + left * way + low * up + shift
        street.face(start, (right - left) * way, (high - low) * up)

    bottom = 0.0
    for sill in rows[0]:
        part(0, size[0], bottom, sill)
        head, left = sill + rows[1], 0.0
        for start in columns[0]:
            end = start + columns[1]
            part(left, start, sill, head)
            part(start, end, sill, head, back)
            for side in (start, end):
                street.face(corner + side * way + sill * up, back, (head - sill) * up)
            for level in (sill, head):
                street.face(corner + start * way + level * up, back, (end - start) * way)
            left = end
        part(left, size[0], sill, head)
        bottom = head
    part(0, size[0], bottom, size[1])


def covered(street, density, noise, rng):
    """Points (n, 3) at random on all that is seen from the path, with noise along each axis."""
    rows = np.array(street.faces, float)
    points = []
    for row in rows:
        corner, u, v = row[:9].reshape(3, 3)
        # only what lies near the street is drawn: the ground goes on for 60 m
        n = rng.poisson(density * np.linalg.norm(np.cross(u, v)))
        a, b = rng.random((2, n, 1))
        if row[9]:
            over = a + b > 1
            a, b = np.where(over, 1 - a, a), np.where(over, 1 - b, b)
        drawn = corner + a * u + b * v
        near = (np.abs(drawn[:, 0]) < 24) & (
            np.abs(drawn[:, 1] - street.length / 2) < street.length / 2 + 4
        )
        drawn = drawn[near]
        cell = np.floor(drawn / 2).astype(int)
        points.append(drawn[np.lexsort(cell.T)])
    points = np.concatenate(points)
    y = (
        np.floor(points[:, 1] / 2) * 2
        + rng.choice([-9, -3, 3, 9], len(points) // 64 + 1).repeat(64)[: len(points)]
    )
    origin = np.column_stack([np.zeros(len(y)), y, np.full(len(y), HEIGHT)])
    way = points - origin
    reach = np.linalg.norm(way, axis=1)
    seen = cast(street, origin, way / reach[:, None], rng)[0] > reach - 1e-6
    return points[seen] + rng.normal(0, noise, (int(seen.sum()), 3))


def true_edges(faces):
    """Lines in which faces touch: ends (m, 2, 3) and the normals of both planes (m, 2, 3)."""
    rows = np.array(faces, float)
    corner, u, v, triangle = rows[:, :3], rows[:, 3:6], rows[:, 6:9], rows[:, 9] > 0
    corners = np.stack(
        [corner, corner + u, corner + v, corner + np.where(triangle[:, None], v, u + v)], 1
    )
    low, high = corners.min(axis=1) - 0.01, corners.max(axis=1) + 0.01
    normal = np.cross(u, v)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    lines = {}
    for i in range(len(rows) - 1):
        touch = ((low[i] <= high[i + 1 :]) & (high[i] >= low[i + 1 :])).all(axis=1)
        for j in i + 1 + np.flatnonzero(touch):
            way = np.cross(normal[i], normal[j])
            if np.linalg.norm(way) < 0.2:
                continue
            way /= np.linalg.norm(way)
            way *= 1 if way[np.abs(way).argmax()] > 0 else -1
            at = np.linalg.solve(
                [normal[i], normal[j], way], [normal[i] @ corner[i], normal[j] @ corner[j], 0.0]
            )
            spans = [_inside(rows[k], at, way) for k in (i, j)]
            a, b = max(span[0] for span in spans), min(span[1] for span in spans)
            if b - a > 0.02:
                planes = sorted(
                    tuple(n * np.sign(n[np.abs(n).argmax()])) for n in (normal[i], normal[j])
                )
                key = tuple(np.round([*at, *way, *planes[0], *planes[1]], 3) + 0.0)
                lines.setdefault(key, [at, way, planes, []])[3].append((a, b))
    ends, normals = [], []
    for at, way, planes, spans in lines.values():
        merged = _union(spans, gap=0.02)
        ends += [at + np.outer(span, way) for span in merged]
        normals += [planes] * len(merged)
    return np.array(ends), np.array(normals)


def _inside(row, at, way):
    """From where to where a line is inside a face, a centimetre beyond its outline included."""
    corner, u, v = row[:9].reshape(3, 3)
    frame = np.linalg.pinv(np.array([u, v]).T)
    start, step = frame @ (at - corner), frame @ way
    spare = 0.01 / np.linalg.norm([u, v], axis=1)
    limits = [(-step, start + spare)]
    if row[9]:
        limits.append((step.sum(keepdims=True), np.array([1 + spare.max() - start.sum()])))
    else:
        limits.append((step, 1 + spare - start))
    low, high = -np.inf, np.inf
    for slopes, rooms in limits:
        for slope, room in zip(slopes, rooms, strict=True):  # slope t <= room
            if abs(slope) < 1e-12:
                if room < 0:
                    return 0.0, 0.0
            elif slope > 0:
                high = min(high, room / slope)
            else:
                low = max(low, room / slope)
    return low, high


def visible(edges, normals, points, noise):
    """The visible parts of edges: rows (edge, from, to) in metres from its first end."""
    from scipy.spatial import cKDTree

    tree, parts = cKDTree(points), []
    for number, (ends, planes) in enumerate(zip(edges, normals, strict=True)):
        length = np.linalg.norm(ends[1] - ends[0])
        if length < LEAST_M:
            continue
        way = (ends[1] - ends[0]) / length
        steps = ends[0] + np.outer(np.arange(0, length + 0.5, 0.5), way)
        near = np.unique(np.concatenate(tree.query_ball_point(steps, 0.8)).astype(int))
        off = points[near] - ends[0]
        station = off @ way
        height = np.abs(off @ planes.T)
        sides = [[], []]
        for here in (0, 1):
            across = np.cross(planes[here], way)
            depth = off @ across
            on = height[:, here] < 4 * noise + 1e-9
            for sign in (-1, 1):  # a plane may lie on either side of the edge, or on both
                band = on & (sign * depth > BAND / 2) & (sign * depth < BAND)
                close = on & (sign * depth > 4 * noise) & (sign * depth <= BAND / 2)
                spans = [_runs(station[one], length) for one in (band, close)]
                sides[here] += _common(*spans)
        both = _common(*map(_union, sides))
        parts += [(number, a, b) for a, b in both if b - a >= LEAST_M]
    return np.array(parts).reshape(-1, 3)


def _runs(stations, length):
    """Intervals of four stations or more that follow each other without a gap.

    In thin clouds a gap is five usual ones; their median, which a hidden part does not enlarge.
    """
    stations = np.sort(stations[(stations > -0.25) & (stations < length + 0.25)])
    if len(stations) < 4:
        return []
    gaps = np.diff(stations)
    gap = max(BAND, 5 * np.median(gaps) / np.log(2))
    cuts = np.flatnonzero(gaps > gap)
    first, last = np.r_[0, cuts + 1], np.r_[cuts, len(stations) - 1]
    half = min(gap, gaps.mean())
    spans = np.column_stack([stations[first] - half, stations[last] + half])
    return [tuple(span) for span in spans[last - first >= 3].clip(0, length)]


def _common(a, b):
    found = [(max(s[0], t[0]), min(s[1], t[1])) for s in a for t in b]
    return [span for span in found if span[1] > span[0]]


def _union(spans, gap=0.0):
    found = []
    for low, high in sorted(spans):
        if found and low <= found[-1][1] + gap:
            found[-1][1] = max(found[-1][1], high)
        else:
            found.append([low, high])
    return [tuple(span) for span in found]


def score(found, faces, points, noise):
    """Recall of visible edges, share of the found length that is true, error of ends."""
    edges, normals = true_edges(faces)
    parts = visible(edges, normals, points, noise)
    ways = edges[:, 1] - edges[:, 0]
    lengths = np.linalg.norm(ways, axis=1)
    ways = ways / lengths[:, None]
    true_length = []
    for ends in found:
        size = np.linalg.norm(ends[1] - ends[0])
        way = (ends[1] - ends[0]) / size
        steps = ends[0] + np.outer(np.arange(0.025, size, 0.05), way)
        along = np.flatnonzero(np.abs(ways @ way) > PARALLEL)
        off = steps[:, None] - edges[along, 0]
        station = np.einsum("snd,nd->sn", off, ways[along])
        across = np.linalg.norm(off - station[..., None] * ways[along], axis=2)
        over = np.maximum(np.maximum(-station, station - lengths[along]), 0)
        on = (across < NEAR_M) & (over < NEAR_M)
        true_length.append((on.any(axis=1).mean() if on.size else 0.0, size))
    shares = []
    for number, low, high in parts:
        number = int(number)
        spans = [span for at, span in _along(edges[[number]], ways[[number]], found)]
        inside = _common(_union(spans), [(low, high)])
        shares.append(sum(b - a for a, b in inside) / (high - low))
    errors = []
    for ends in found:
        for at, span in _along(edges, ways, ends[None]):
            marks = np.r_[0, lengths[at], parts[parts[:, 0] == at, 1:].ravel()]
            if span[1] > 0 and span[0] < lengths[at]:
                errors += [np.abs(marks - end).min() for end in span]
                break
    true, sizes = np.transpose(true_length)
    return {
        "visible": len(parts),
        "recall": np.mean(np.array(shares) >= 0.5),
        "true_length": np.average(true, weights=sizes),
        "ends_median_m": np.median(np.abs(errors)),
    }


def held_across(found, faces):
    """Whether the 95 % ellipse across each end of found edges on a true one has the true line."""
    edges, _ = true_edges(faces)
    ways = edges[:, 1] - edges[:, 0]
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    held = []
    for ends, covariance in zip(found.segments, found.covariance, strict=True):
        number, _ = next(_along(edges, ways, ends[None]), (None, None))
        if number is None:
            continue
        frame = np.linalg.svd(ways[number][None])[2][1:]
        for off, spread in zip((ends - edges[number, 0]) @ frame.T, covariance, strict=True):
            held.append(off @ np.linalg.solve(frame @ spread @ frame.T, off) < 5.99)
    return np.array(held)


def _along(edges, ways, found):
    """Which edge and from where to where, for each found segment on an edge."""
    for ends in found:
        off = ends - edges[:, :1]
        station = np.einsum("nkd,nd->nk", off, ways)
        across = np.linalg.norm(off - station[..., None] * ways[:, None], axis=2).max(axis=1)
        near = (across < NEAR_M) & (np.abs(np.diff(station, axis=1)[:, 0]) > 0.2)
        for at in np.flatnonzero(near)[np.argsort(across[near])]:
            yield at, tuple(np.sort(station[at]))


def street_of_facades(seed, length=30.0, windows=True):
    """L-shaped houses with dormers, balconies and windows, and what stands before them."""
    street = make(seed, length)
    return with_windows(street, np.random.default_rng([seed, 79])) if windows else street
