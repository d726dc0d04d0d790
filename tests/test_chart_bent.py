"""Charts through lenses that bend lines, and on bent boards: measured right, or refused."""

import numpy as np
import pytest
from distorted import Lens

from mmqa_lab import chart_image, charts

CHART = charts.imaging_chart()

LENSES = {
    "barrel, chart fills the frame": {"radial": (-0.15, 0.0), "pixel_mm": 1.7},
    "pincushion": {"radial": (0.076, 0.0), "pixel_mm": 1.9},
    "board bent by 20 mm, from aside": {"sag": 20.0, "turn": (0, 30, 1), "pixel_mm": 2.0},
    "tangential, off the axis": {
        "radial": (-0.06, 0.02),
        "tangential": (0.002, -0.001),
        "aside": (40, -20),
        "pixel_mm": 2.2,
    },
}


@pytest.mark.parametrize("name", LENSES)
def test_bent_lines_change_neither_pixel_size_nor_widths(name):
    lens = Lens(size=(660, 660), **LENSES[name])
    image = lens.photograph(CHART, seed=1)
    there = chart_image.locate(np.uint8(255 * image), CHART)
    quality = chart_image.evaluate_image(image, CHART, there)
    for direction in "hv":
        bars = [CHART[one] for one in quality.sizes.query("direction == @direction")["name"]]
        truth = sum(max(bar.width, bar.height) for bar in bars) / sum(map(lens.length, bars))
        assert quality.pixel_size(direction)[0] == pytest.approx(truth, rel=1e-3)
        assert quality.resolution(direction).width_mm <= 3.3 * quality.pixel_size(direction)[0]
    places = np.random.default_rng(0).uniform(0, 1000, (50, 2))
    found = quality.chart_map.chart(quality.chart_map.pixels(places))
    assert found == pytest.approx(places, abs=0.02)


def test_lines_bent_too_far_are_refused_by_name():
    lens = Lens(size=(500, 500), radial=(-0.3, 0.0), pixel_mm=2.0)
    image = lens.photograph(CHART)
    given = chart_image.locate(None, CHART, corners=lens.pixels(CHART.corners()))
    with pytest.raises(ValueError, match="are its lines straight"):
        chart_image.evaluate_image(image, CHART, given)
