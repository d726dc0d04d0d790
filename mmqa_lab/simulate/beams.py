"""Laser pulses: where they leave a moving scanner, and the echo that a beam with a width brings."""

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from mmqa_lab._threads import enough_threads
from mmqa_lab.simulate.scenes import RAYS_A_THREAD, STACK, TASK, describe, mapped, nearest

FOOTPRINT = 7  # rays a beam: its axis and a ring
RING = 0.651  # radius of the ring over the 1/e2 radius: median of the outer 6/7 of a Gaussian beam


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
    with enough_threads(len(beams), RAYS_A_THREAD):
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
        x, y, z = mapped(matrix, beams[k, 0], beams[k, 1], beams[k, 2])
        x, y, z = _turned(states[k], x, y, z)
        directions[k, 0], directions[k, 1], directions[k, 2] = x, y, z
    return origins, directions


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


def echoes(tree, origins, directions, *, radius, growth, turn, separation):
    """Return the ``Echoes`` of pulses along unit directions.

    A beam of 1/e2 ``radius`` at the exit that grows by ``growth`` a metre is cast as its axis and a
    ring of six rays, each an equal share of its energy, turned by ``turn`` (0 to 1) at random. Hits
    closer than ``separation`` in range fall into one echo: its range is their mean weighted by the
    signal, its signal their sum, its surface and cosine those of its strongest part; it is mixed
    where they belong to several surfaces.
    """
    with enough_threads(len(directions), RAYS_A_THREAD):
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
