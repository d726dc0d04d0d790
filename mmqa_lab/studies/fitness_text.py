"""Fit for reading? Figures of photographs beside the share of a text that can be read."""

from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.ndimage import map_coordinates

from mmqa_lab import bench as benches
from mmqa_lab.chart_image import ChartMap, Tones, find_tones, read_pairs, resolution
from mmqa_lab.charts import Bar, Layout, LinePairs, Text, reflectance
from mmqa_lab.mtf import fit_edge
from mmqa_lab.simulate import cameras
from mmqa_lab.studies.fitness import acquisitions

__all__ = ["GOOD", "METHODS", "PHOTOGRAPHS", "TEXT_CHART", "bench", "misread_percent"]
__all__ += ["photographed"]

PHOTOGRAPHS = {
    "pixel_mm": (1.5, 15), "spread_px": (0.3, 1.2), "motion_px": (0, 4), "white": (0.15, 0.9),
    "noise_percent": (0.5, 4), "roll_deg": (3, 7),
}  # fmt: skip
"""From which photographs are drawn: size and point spread of the pixels, motion along the lines of
text, white as a share of full scale (black is 0.06), noise. Fixed before any score, too."""

GOOD = {"text_misread_percent": 10}
"""The task, and the largest share with which a photograph is fit; fixed beforehand, too."""

LETTERS, CAP_MM = "ABCDEFGHKLMNPRSTUVXZ", 25.0
"""Twenty capitals and their height."""


def text_chart():
    """Return a chart with a black block, standing line pairs and the capitals of ``LETTERS``."""
    elements = [Bar("block", 20.0, 200.0, 160.0, 220.0)]
    left, low = 300.0, 330.0
    for pair in (40.0, 30.0, 20.0, 15.0, 10.0, 8.0, 6.0, 4.0, 3.0):
        left, low = (300.0, 220.0) if pair == 15 else (left, low)
        name = f"pairs_{pair:g}"
        elements.append(LinePairs(name, left, low, pair, "h", repeats=6, length=80.0))
        left += 6 * pair + 20
    for k, letter in enumerate(LETTERS):
        x, y = 40.0 + 80 * (k % 10), 110.0 - 70 * (k // 10)
        elements.append(Text(letter, x, y, letter, CAP_MM))
    return Layout("text chart", 900.0, 440.0, tuple(elements))


TEXT_CHART = text_chart()


class Seen(NamedTuple):
    """A photograph of :func:`text_chart`, linear light, its tones and its map."""

    image: np.ndarray
    tones: Tones
    chart_map: ChartMap

    @property
    def pixel_mm(self):
        """Size of a pixel, mm."""
        return float(self.chart_map.pixel_sizes_mm(np.array([[450.0, 220.0]])).mean())


def photographed(draw, number, *, seed, **case):
    """Photograph the text chart; return Seen, and the share of its capitals that are misread."""
    roll, pixel_mm = np.radians(case["roll_deg"]), case["pixel_mm"]
    c, s = np.cos(roll), np.sin(roll)
    column, row = np.random.default_rng([seed, draw, number]).uniform(0, 1, 2)
    turn = np.array([[c, s, column * pixel_mm], [s, -c, row * pixel_mm], [0, 0, pixel_mm]])
    motion = case["motion_px"]
    optics = cameras.Optics(case["spread_px"], travel=(motion * c, motion * s, 0.0))
    sensor = cameras.Sensor(white=case["white"], noise=case["noise_percent"] / 100)
    choices = {"optics": optics, "sensor": sensor, "seed": [seed, draw, number]}
    photo = cameras.photograph(TEXT_CHART, ChartMap(turn / pixel_mm), **choices)
    image = photo.image.astype(float)
    seen = Seen(image, find_tones(image, TEXT_CHART, photo.chart_map), photo.chart_map)
    return seen, {"text_misread_percent": misread_percent(seen)}


def misread_percent(seen, step_mm=1.0):
    """Return the share of the capitals that a reader who knows their places misreads, percent.

    The reader compares each with the print of all of ``LETTERS`` and takes the one that correlates
    best.
    """
    side = np.arange(-4.0, CAP_MM + 6, step_mm) + step_mm / 2
    box = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    corners = np.array([[TEXT_CHART[letter].x, TEXT_CHART[letter].y] for letter in LETTERS])
    places = corners[:, None] + box
    printed = reflectance(TEXT_CHART, cell=step_mm)
    column, row = np.floor(places / step_mm).astype(int).transpose(2, 0, 1)
    pixels = seen.chart_map.pixels(places.reshape(-1, 2))[:, ::-1].T
    found = map_coordinates(seen.image, pixels, order=1, mode="nearest").reshape(len(places), -1)
    match = np.corrcoef(found, printed[row, column])[: len(places), len(places) :]
    return 100 * float(np.mean(match.argmax(axis=1) != np.arange(len(places))))


def blur_mm(seen):
    """Return the period with half of its contrast left, mm: the pixel size over MTF50."""
    column, row = seen.chart_map.pixels(np.array([[180.0, 310.0]]))[0]
    reach = 80 / seen.pixel_mm
    rows, columns = (slice(int(np.ceil(m - reach)), int(m + reach) + 1) for m in (row, column))
    return seen.pixel_mm / fit_edge(seen.image[rows, columns]).mtf50


def resolved_mm(seen):
    """Return the width of the narrowest resolved line pairs, mm."""
    return resolution(read_pairs(seen.tones, TEXT_CHART, seen.chart_map), "h").width_mm


METHODS = {
    "pixel size": lambda seen: seen.pixel_mm,
    "resolved width": resolved_mm,
    "MTF50": blur_mm,
    "contrast": lambda seen: seen.tones.noise,
}
"""Figures of a photograph, of which less is better: the size of a pixel, mm; the narrowest resolved
line pairs, mm; the period with half of its contrast left, mm; noise as a share of the contrast."""


def bench(*, methods=None, count=40, draws=(3, 4), seed=1000):
    """Define the comparison of figures of photographs; see :func:`fitness.bench`."""
    drawn = [acquisitions(count, seed=draw, limits=PHOTOGRAPHS) for draw in draws]
    cases = pd.concat(drawn, ignore_index=True)
    return benches.Comparison(cases, dict(methods or METHODS), photographed, seeds=[seed])
