"""Line sets of streets with rows of windows: equal verticals and sills a metre or two apart.

Two surveys of the same lines, each with its own gaps, cuts, noise and unrelated lines. One is
displaced, turned and drifts. Nothing is shared with ``mmqa_lab``.
"""

import numpy as np


def street_lines(rng, length=70.0):
    """Edges (n, 2, 3) of two rows of houses along y: outlines, ledges, windows."""
    ends = []
    for side in (-1, 1):
        y = rng.uniform(0, 3)
        while y < length:
            wide, storeys = rng.uniform(7, 14), rng.integers(2, 5)
            x = side * rng.uniform(6.5, 8.5)
            step, wall = rng.uniform(2.6, 3.3), rng.uniform(0.6, 1.2)
            top = wall + storeys * step
            a, b = y, y + wide
            ends += [((x, a, 0), (x, a, top)), ((x, b, 0), (x, b, top))]
            ends += [((x, a, 0), (x, b, 0)), ((x, a, top), (x, b, top))]
            ends += [((x, a, top), (x + 6 * side, a, top)), ((x, b, top), (x + 6 * side, b, top))]
            n, pane, high = int(wide // rng.uniform(1.9, 3.0)), rng.uniform(0.8, 1.3), step - 1.3
            pitch = wide / n
            for floor in range(storeys):
                sill = wall + floor * step + 0.3
                for k in range(n):
                    left = a + (k + 0.5) * pitch - pane / 2
                    for at in (left, left + pane):
                        ends.append(((x, at, sill), (x, at, sill + high)))
                    for level in (sill, sill + high):
                        ends.append(((x, left, level), (x, left + pane, level)))
            y = b + (rng.uniform(1, 6) if rng.random() < 0.4 else 0.0)
    return np.array(ends)


def seen(lines, share, noise, rng):
    """What a survey has of the lines: segments (m, 2, 3), number of line and stretch of each."""
    rows = []
    for number in np.flatnonzero(rng.random(len(lines)) < share):
        start, end = lines[number]
        size = np.linalg.norm(end - start)
        low, high = rng.exponential(0.12, 2) * min(size / 2, 1.0)
        spans = [(low, size - high)]
        if size > 4 and rng.random() < 0.3:
            cut = rng.uniform(1.2, size - 1.2)
            spans = [(low, cut - 0.3), (cut + 0.3, size - high)]
        for a, b in spans:
            if b - a > 0.5:
                off = rng.normal(0, noise, 3) + rng.normal(0, noise / 2, (2, 3))
                both = start + np.outer([a, b], (end - start) / size) + off
                rows.append((both[:: rng.choice([-1, 1])], number, (a, b)))
    ends, numbers, spans = zip(*rows, strict=True)
    return np.array(ends), np.array(numbers), np.array(spans)


def clutter(n, length, rng):
    """Lines of one survey only: posts, parked cars, branches."""
    start = rng.uniform([-9, 0, 0], [9, length, 8], (n, 3))
    ways = np.where(rng.random((n, 1)) < 0.5, [[0, 0, 1.0]], rng.normal(size=(n, 3)))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    return np.stack([start, start + ways * rng.uniform(0.7, 4, (n, 1))], axis=1)


def displaced(ends, shift, turn_deg, drift, rng):
    """Ends moved by a shift, a turn about the middle, and waves along the street of some height."""
    places = ends.reshape(-1, 3)
    middle, (c, s) = places.mean(axis=0), np.cos(np.radians([turn_deg, turn_deg - 90]))
    phases, lengths = rng.uniform(0, 2 * np.pi, 3), rng.uniform(60, 120, 3)
    waves = np.sin(phases + 2 * np.pi * places[:, 1:2] / lengths)
    waves *= drift * np.array([1, 1, 0.3])
    turned = (places - middle) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    return (middle + turned + shift + waves - waves.mean(axis=0)).reshape(ends.shape)


def scene(seed, *, shift=None, turn_deg=None, drift=None, share=None, length=70.0):
    """Test and model set, true pairs (p, q), and the displacement in the middle of the test set."""
    rng = np.random.default_rng([seed, 907])
    lines = street_lines(rng, length)
    shift = rng.uniform(0, 3) if shift is None else shift
    turn_deg = rng.uniform(-3, 3) if turn_deg is None else turn_deg
    drift = rng.uniform(0, 0.8) if drift is None else drift
    share = rng.uniform(0.35, 0.75) if share is None else share
    way = rng.normal(size=3) * [1, 1, 0.3]
    shift = shift * way / np.linalg.norm(way)
    sets = [seen(lines, share, 0.03, rng) for _ in range(2)]
    (test, number_t, span_t), (model, number_m, span_m) = sets
    low = np.maximum(span_t[:, None, 0], span_m[:, 0])
    common = np.minimum(span_t[:, None, 1], span_m[:, 1]) - low
    size = np.minimum(np.ptp(span_t, axis=1)[:, None], np.ptp(span_m, axis=1))
    pairs = (number_t[:, None] == number_m) & (common > 0.2 * size)
    test = displaced(test, shift, turn_deg, drift, rng)
    extra = [clutter(len(ends) // 8, length, rng) for ends in (test, model)]
    pairs = np.pad(pairs, ((0, len(extra[0])), (0, len(extra[1]))))
    sets = [np.concatenate(both) for both in zip((test, model), extra, strict=True)]
    orders = [rng.permutation(len(ends)) for ends in sets]
    return (
        *(ends[order] for ends, order in zip(sets, orders, strict=True)),
        pairs[np.ix_(*orders)],
        shift,
    )
