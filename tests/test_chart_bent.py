"""Charts through lenses that bend lines, and on bent boards: measured right, or refused."""

import cv2
import numpy as np
import pytest
import yaml
from distorted import Lens

from mmqa_lab import chart_image, charts, commands

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


def bent_share(lens):
    """How far the lens bends the chart's sides, over their length."""
    share = 0.0
    for a, b in zip(CHART.corners(), np.roll(CHART.corners(), -1, axis=0), strict=True):
        first, middle, last = lens.pixels([a, (a + b) / 2, b])
        way = last - first
        off = (middle - first) @ [-way[1], way[0]] / (way @ way)
        share = max(share, abs(off))
    return share


@pytest.mark.parametrize("radial", [(-0.15, 0.0), (0.1, 0.0), (-0.02, 0.0)])
def test_how_far_lines_are_bent_is_said(radial):
    lens = Lens(size=(400, 400), radial=radial, pixel_mm=3.2)
    image = lens.photograph(CHART, seed=1)
    there = chart_image.locate(np.uint8(255 * image), CHART)
    quality = chart_image.evaluate_image(image, CHART, there)
    found = quality.chart_map.bent_share(CHART)
    assert found == pytest.approx(bent_share(lens), rel=0.03, abs=4e-4)
    said = f"straight lines are bent by {found:.1%}" in "; ".join(quality.remarks)
    assert said == (bent_share(lens) > 0.01)


STRONG = Lens(size=(440, 440), radial=(-0.4, 0.1), pixel_mm=2.7)
"""Such a lens moves the corners of the image by a third."""


def calibration(lens):
    """Camera matrix and coefficients of a lens, as OpenCV names them, for its own distances."""
    focal = 4000 / lens.pixel_mm
    rate = focal / lens.corner
    column, row = (np.array(lens.size) - 1) / 2
    matrix = np.array([[focal, 0, column], [0, focal, row], [0, 0, 1.0]])
    return matrix, np.array([lens.radial[0] * rate**2, lens.radial[1] * rate**4, 0, 0, 0])


def test_lines_bent_too_far_are_refused_and_measured_with_the_lens(tmp_path):
    image = STRONG.photograph(CHART, seed=1)
    cv2.imwrite(str(tmp_path / "photo.png"), np.uint8(np.clip(255 * image, 0, 255)))
    # how far is not said: of such lines a cubic tells a quarter too much
    assert bent_share(STRONG) > 0.06
    with pytest.raises(ValueError, match="straight lines are bent by more than 6% of their"):
        chart_image.evaluate_file(tmp_path / "photo.png", CHART, gamma="linear")
    matrix, distortion = calibration(STRONG)
    camera = {"camera_matrix": matrix.tolist(), "dist_coeff": [distortion.tolist()]}
    (tmp_path / "lens.yaml").write_text(yaml.dump(camera))
    row = commands.image([tmp_path / "photo.png"], linear=True, camera=tmp_path / "lens.yaml")
    truth = 1600 / sum(STRONG.length(CHART[name]) for name in ("bar_left", "bar_right"))
    assert row["pixel_v_mm"].item() == pytest.approx(truth, rel=1e-3)
    assert row["w_v_mm"].item() <= 3.3 * truth
    assert "bent" not in row["remarks"].item()
