"""Bent lines: the cubic displacement that print and photograph of a chart show."""

from dataclasses import replace

import cv2
import numpy as np
from numpy.polynomial.polynomial import polyvander2d

from mmqa_lab.chart_image.maps import Bend, plain, unit

__all__ = ["BLOCKS", "SPREADS", "straight", "with_bend"]

BLOCKS = 20
"""Blocks along a side of the chart in which the alignment looks for bent lines."""

SPREADS = 3.0
"""Number of local spreads to which larger differences are cut."""

CUBIC = [4 * i + j for i in range(4) for j in range(4 - i)]
"""Products of powers of x and y up to the third, of the sixteen up to x^3 y^3."""

BEND_GAIN, BEND_PX = 14.0, 0.4
"""How many times more than chance a bend must explain, and how far it must reach, to count."""


def with_bend(level, chart_map):
    """A map with the cubic displacement that print and photograph show, if they show one.

    Blocks of the chart ask for shifts (Lucas and Kanade); those that differ from the print,
    behind a post or at a shadow's edge, count little.
    """
    places = (np.indices((BLOCKS, BLOCKS))[::-1].reshape(2, -1).T + 0.5) / BLOCKS * level.size
    design = polyvander2d(*unit(places, level.size), (3, 3))[:, CUBIC]
    for _ in range(8):
        seen, trusted = level.seen(chart_map)
        # close to the chart's edge, pixels see what is beyond
        trusted[:2] = trusted[-2:] = trusted[:, :2] = trusted[:, -2:] = 0
        change, gain = _shifts(level.printed, seen, trusted, design)
        far = np.abs(design @ change).max() * level.cell / max(level.pixel_mm, level.cell)
        if chart_map.bend is None and (gain < BEND_GAIN or far < BEND_PX):
            break
        terms = np.zeros((16, 2))
        terms[CUBIC] = change * level.cell
        terms = terms.reshape(4, 4, 2)
        if chart_map.bend is not None:
            terms = terms + chart_map.bend.terms
        chart_map = replace(chart_map, bend=Bend(level.size, terms))
        if gain < 1 or far < 0.02:
            break
    return chart_map


def straight(chart_map, layout):
    """A map without its bend where a homography does as well."""
    flat, outline = plain(chart_map, layout), layout.corners()
    leaves = flat.outline(outline) - chart_map.outline(outline)
    return chart_map if np.linalg.norm(leaves, axis=1).max() > BEND_PX else flat


def _shifts(printed, seen, trusted, design):
    """Terms of the displacement, cells, and what they explain beyond chance per term."""
    down, right = np.gradient(seen)
    parts = [right, down, np.clip(printed - seen, -SPREADS, SPREADS)]
    sums = np.array([[one * two * trusted for one in parts] for two in parts]).reshape(9, -1)
    size = {"dsize": (BLOCKS, BLOCKS), "interpolation": cv2.INTER_AREA}
    sums = np.stack([cv2.resize(part.reshape(seen.shape), **size).ravel() for part in sums], axis=1)
    sums = sums.reshape(-1, 3, 3)
    slopes, asked, before = sums[:, :2, :2], sums[:, :2, 2], sums[:, 2, 2]
    weight = np.ones(len(sums))
    for _ in range(8):
        matrix = np.einsum("b,bi,bjk,bl->ijlk", weight, design, slopes, design)
        matrix = matrix.reshape(2 * design.shape[1], -1)
        wanted = np.einsum("b,bi,bj->ij", weight, design, asked)
        matrix += 1e-6 * np.trace(matrix) * np.eye(len(matrix))
        change = np.linalg.solve(matrix, wanted.ravel()).reshape(-1, 2)
        shift = design @ change
        left = before - 2 * (shift * asked).sum(1) + np.einsum("bi,bij,bj->b", shift, slopes, shift)
        typical = max(np.median(left[before > 0]), 1e-12) if before.any() else 1.0
        weight = 1 / (1 + (np.maximum(left, 0) / (2 * typical)) ** 2)
    explained, rest = weight @ (before - left), max(weight @ left, 1e-12)
    return change, float(explained / change.size / (rest / (2 * len(sums))))
