"""Pairs and displacement found in turns, from a start, and the evidence for them."""

from __future__ import annotations

import math

import numpy as np

from mmqa_lab._compiled import njit
from mmqa_lab.lines.pairing import apart, levers, paired
from mmqa_lab.lines.settings import (
    CLUTTER_ENDS_PER_M,
    CLUTTER_PER_M2,
    END_M,
    ENDS_AGREE,
    FINE_RADIUS_M,
    FIRST_NOISE_M,
    LEFT_M,
    TURN_RAD,
)

__all__ = ["refined"]


def refined(lines, start):
    """Evidence, pairs, and the ends' part of the evidence, from a start.

    Pairs and displacement are updated in turns.
    """
    lines = lines.again(start(lines.place))
    moved, noise = start(lines.place), FIRST_NOISE_M
    off = lines.offset - np.einsum("nkd,nd->nk", lines.frame, moved)
    near = (off**2).sum(axis=1) < FINE_RADIUS_M**2
    lines = paired(lines.test, lines.model, lines.rows[near], lines.columns[near])
    moved = moved[near]
    outcome = 0.0, np.zeros(lines.shape, dtype=bool), 0.0
    for _ in range(10):
        lines = lines.again(moved)
        off = lines.offset - np.einsum("nkd,nd->nk", lines.frame, moved)
        variance = noise**2 + LEFT_M**2
        squares = (off**2).sum(axis=1) / variance
        # true pairs share 0.18 of the shorter line at least, and 99.7 % of them are as near
        allowed = (lines.overlap >= 0.18) & (squares < -2 * np.log(0.003))
        pairs = apart(lines, np.where(allowed, squares, np.inf))
        members = np.flatnonzero(pairs[lines.rows, lines.columns])
        if len(members) < 3:
            break
        # log likelihood ratio of true pairs to unrelated lines
        ratio = -squares[members] / 2 - np.log(2 * np.pi * variance * CLUTTER_PER_M2)
        ends = _agreement(lines)[members].sum()
        same, outcome = (pairs == outcome[1]).all(), (ratio.sum() + ends, pairs, ends)
        before, noise = noise, np.clip(np.median(np.abs(off[members])) * 1.48, 0.03, noise)
        if same and noise > 0.99 * before:
            break
        moved = _field(lines, start(lines.place), members, noise)
    return outcome


def _agreement(lines):
    """Log likelihood ratio of the gaps between the ends of paired lines, zero if they disagree."""
    half_t, half_m = lines.half
    gaps = np.abs(np.stack([lines.along - half_t + half_m, lines.along + half_t - half_m]))
    agree = np.exp(-gaps / END_M) / END_M
    ratio = np.log(1 - ENDS_AGREE + ENDS_AGREE * agree / CLUTTER_ENDS_PER_M)
    return np.maximum(ratio.sum(axis=0), 0)


def _field(lines, path, members, noise):
    """Displacement (n, 3) at all pairs, each from the other pairs: the path and what is left of it.

    What is left is a vector, a turn, and drift with a standard deviation of 0.25 m and a
    correlation length of 20 m.
    """
    frame, place = lines.frame[members], lines.place[members]
    centre = place.mean(axis=0)
    off = lines.offset[members] - np.einsum("nkd,nd->nk", frame, path[members])
    design = lines.design(centre)[members]
    prior = noise**2 * np.diag([1e-6, 1e-6, 1e-6, 1 / TURN_RAD**2])
    normal = np.einsum("nkd,nke->de", design, design) + prior
    mean = np.linalg.solve(normal, np.einsum("nkd,nk->d", design, off))
    off = off - design @ mean
    pulls = np.einsum("nkd,nk->nd", frame, off)
    parts = np.concatenate([frame.swapaxes(1, 2) @ frame, pulls[..., None]], axis=2)
    felt = _felt(lines.place, members, parts.reshape(-1, 12).T.copy()).reshape(-1, 3, 4)
    holds, pulls = felt[..., :3] + (noise / 0.25) ** 2 * np.eye(3), felt[..., 3:]
    steady = path + mean[:3] + mean[3] * levers(lines.place - centre)
    return steady + np.linalg.solve(holds, pulls)[..., 0]


@njit(cache=True, nogil=True, fastmath=True)
def _felt(places, members, parts):
    """Sum (n, 12) of the parts (12, members) of all but the place itself, less with distance."""
    felt, shares = np.zeros((len(places), 12)), np.empty(len(members))
    for n in range(len(places)):
        x, y, z = places[n]
        for m in range(len(members)):
            at = places[members[m]]
            gap = math.sqrt((x - at[0]) ** 2 + (y - at[1]) ** 2 + (z - at[2]) ** 2)
            shares[m] = math.exp(-gap / 20) if members[m] != n else 0.0
        for k in range(12):
            total = 0.0
            for m in range(len(members)):
                total += shares[m] * parts[k, m]
            felt[n, k] = total
    return felt
