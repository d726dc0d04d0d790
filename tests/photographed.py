"""Real photographs of line pairs and edges, cut and made coarser, for tests and benchmarks."""

from dataclasses import replace

import cv2
import numpy as np
from scipy.optimize import minimize

from mmqa_lab import io, samples
from mmqa_lab.chart_image import ChartMap, Tones, read_pattern
from mmqa_lab.charts import LinePairs, decode

PERIOD_PX = 8.83
"""Of the 44 real line pairs, as published with them."""

ROWS = (800.0, 980.0)
"""The rows of the photograph that show nothing but those pairs."""


class RealPairs:
    """The photograph of 44 line pairs and where its bars are."""

    def __init__(self):
        grey = io.read_image(samples.real_path("images/line_pairs_44.png"))
        self.image = decode(grey / 255.0, "srgb")
        # the black rectangle and the paper above the pairs
        self.black, self.white = np.median(self.image[250:400, 180:310]), 0.0
        self.white = np.median(self.image[690:750, 100:400])
        rows, columns = np.mgrid[int(ROWS[0]) : int(ROWS[1]), 60:420]
        values = self.image[rows, columns]
        self._terms = np.stack([np.ones(rows.shape), *self._shapes(columns, rows)], axis=-1)

        def loss(parameters):
            turns = self._terms[..., 1:] @ parameters
            return -abs((values * np.exp(-2j * np.pi * turns)).sum())

        start = [180 / PERIOD_PX, 0.03 * 100 / PERIOD_PX, 0, 0, 0]
        found = minimize(loss, start, method="Nelder-Mead", options={"maxiter": 4000}).x
        wave = (values * np.exp(-2j * np.pi * (self._terms[..., 1:] @ found))).sum()
        # black comes first: white is highest at three quarters of a turn
        self._turns = np.concatenate([[0.75 + np.angle(wave) / (2 * np.pi)], found])

    @staticmethod
    def _shapes(columns, rows):
        x, y = (columns - 240.0) / 180, (rows - 890.0) / 100
        return x, y, x * x, x * y, y * y

    def _column(self, turn, row):
        """The column at which so many turns of the printed wave are over."""
        columns = np.linspace(30, 450, 4201)
        rows = np.full_like(columns, row)
        terms = np.stack([np.ones_like(columns), *self._shapes(columns, rows)], axis=-1)
        return float(np.interp(turn, terms @ self._turns, columns))

    def windows(self, count=5):
        """Corners of windows of eight pairs, lower left first, counterclockwise."""
        low, high = ROWS[1], ROWS[0]
        first = np.ceil(self._turns[0] - 180 / PERIOD_PX)
        for start in first + 8 * np.arange(count):
            ends = [(start, low), (start + 8, low), (start + 8, high), (start, high)]
            yield np.array([(self._column(turn, row), row) for turn, row in ends])

    def readings(self, width_px, *, motion=0.0):
        """Read every window after motion by so many pairs, with pairs of this width in pixels."""
        image = self.image
        if motion:
            kernel = np.ones((1, max(round(motion * PERIOD_PX), 1)))
            image = cv2.filter2D(image, -1, kernel / kernel.sum())
        size = np.round(np.array(image.shape[::-1]) * width_px / PERIOD_PX).astype(int)
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        scale = size / image.shape[::-1]
        values = (small - self.black) / (self.white - self.black)
        part = values[int(695 * scale[1]) : int(745 * scale[1]), : int(400 * scale[0])]
        noise = float(np.std(part[:, int(100 * scale[0]) :]))
        levels = Tones(values, noise)
        pairs = LinePairs("real", 0, 0, PERIOD_PX, "h", length=ROWS[1] - ROWS[0])
        x, y = pairs.width, pairs.height
        places = [[0, 0], [x, 0], [x, y], [0, y]]
        for corners in self.windows():
            there = ChartMap.from_points(places, (corners + 0.5) * scale - 0.5)
            yield replace(read_pattern(levels, pairs, there), name=f"{corners[0][0]:.0f}")
