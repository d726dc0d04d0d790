"""What would be wrong without a word in images: one row a case, what is said, what must not appear.

A row calls a function that gives a figure and all that was said of it; a refusal gives no figure.
Where words are given they must be said; else nothing is, and the wrong figure must not appear.
"""

import re
import warnings
from typing import NamedTuple

import cv2
import numpy as np
import pandas as pd
import pytest
from camera import shoot
from distorted import Lens
from PIL import Image
from rendered import true_mtf50
from test_image_targets import tarps
from test_mtf import odd_edge
from test_radiometry import block

from mmqa_lab import charts, commands, image_targets, radiometry, samples, tender
from mmqa_lab.mtf import fit_edge, measure_star
from mmqa_lab.simulate.targets import PointSpread, render_edge, render_star

CHART = charts.imaging_chart()


class Row(NamedTuple):
    """A case: what it gives, what must be said, the true figure and how near, the wrong one."""

    found: object
    words: str
    wrong: float
    truth: float | None = None
    near: float = 0.0


def of_photograph(image, figure, tmp_path, *, linear=True, **choices):
    """A figure of ``mmqa image`` and its remark."""
    file = tmp_path / "photo.png"
    cv2.imwrite(str(file), np.uint8(np.clip(255 * image, 0, 255)) if linear else image)
    row = commands.image([file], linear=linear, **choices).iloc[0]
    return row[figure], row["remarks"]


def through_a_lens(path):
    """w of a photograph through a lens that moves the corners by 7.6 %."""
    lens = Lens(size=(600, 600), radial=(-0.076, 0), pixel_mm=1.8)
    return of_photograph(lens.photograph(CHART, seed=1), "w_v_mm", path)


def behind_a_post(path):
    """w of a photograph of the chart behind a post over a row of line pairs."""
    image = shoot(CHART, 4.0, seed=2, strips=((0, 500.0, 30.0),), margin=0.3).image
    return of_photograph(image, "w_h_mm", path, linear=False)


def two_charts(path):
    """Pixel size of a photograph of two charts."""
    parts = [shoot(CHART, one, seed=1, mono=True, margin=0.2).image for one in (5.5, 4.0)]
    image = np.full((max(map(len, parts)), sum(one.shape[1] for one in parts)), 90, np.uint8)
    image[: len(parts[0]), : parts[0].shape[1]] = parts[0]
    image[:, parts[0].shape[1] :] = parts[1]
    return of_photograph(image, "pixel_v_mm", path, linear=False)


def edge(kind, seed, noise=0.01, **how):
    """MTF50 of one of the odd edges over the true one."""

    def found(_):
        image, truth = odd_edge(kind, np.random.default_rng(seed), noise=noise, **how)
        fit = fit_edge(image)
        return fit.mtf50 / truth, "; ".join(fit.remarks)

    return found


def two_edges(_):
    """MTF50 of two edges beside each other."""
    one = render_edge((60, 90), PointSpread(0.8), angle_deg=5.0, low=0.1, high=0.6)
    return fit_edge((one + 0.6 * np.roll(one, 14, axis=1))[:, 16:-2]).mtf50, ""


def star(*, cycles=36, low=-9.0, high=9.0, hidden=9.0):
    """MTF50 of a star of 36 cycles over the true one."""

    def found(_):
        spread, rng = PointSpread(0.8), np.random.default_rng(2)
        image = render_star((150, 150), spread, cycles=36, radius_px=70)
        image = np.clip(image + 0.005 * rng.standard_normal(image.shape), low, high)
        y, x = np.mgrid[:150, :150] - 74.5
        seen = np.where(np.arctan2(y, x) > hidden, 0.3, image)
        fit = measure_star(seen, (74.5, 74.5), cycles=cycles, radius_px=70)
        return fit.mtf50 / spread.mtf50(0), "; ".join(fit.remarks)

    return found


def half_cloudy(table):
    """Light under a cloud over half of image 5."""
    return np.where((table["image"] == 5) & (table["azimuth_deg"] > 90), 0.7, 1.0)


def gain(light=lambda table: 1.0, *, shadow=1.0, order=1, twice=None):
    """The gain of image 5 of a block over the true one, under light that it does not know of.

    A control target may lie in shadow, or stand twice, its reflectances in either order.
    """

    def found(_):
        table, ground, truth = block(np.random.default_rng(4))
        table["radiance"] *= light(table) * np.where(table["tie"] == 3, shadow, 1.0)
        control = pd.DataFrame({"tie": range(6), "reflectance": ground[:6], "std": 0.003})
        if twice:
            again = control[:1].assign(reflectance=twice * ground[0])
            control = pd.concat([control, again])[::order]
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            fit = radiometry.adjust_block(table, control=control)
        words = [str(one.message) for one in said]
        doubts = [one for one in words if "cannot be told" not in one]  # of controls that are dark
        return fit.gains["gain"][5] / truth[5], " ".join(doubts)

    return found


def target(what, column, *, dn=None, change=lambda image: image, **columns):
    """A figure of tarps in an image, and its remark."""

    def found(_):
        image, table = tarps(np.random.default_rng(0), *([dn] if dn else []))
        row = image_targets.measure(change(image), what, targets=table.assign(**columns)).iloc[0]
        return row[column], row["remarks"]

    return found


def of_file(*, lzw, turn=0):
    """Reflectance of a tarp in a TIFF file, its pixels stored turned by half if the tag says so."""

    def found(path):
        image, table = tarps(np.random.default_rng(0))
        pixels = Image.fromarray(np.rot90(image[0], turn))
        kept = {"compression": "tiff_lzw"} if lzw else {}
        pixels.save(path / "a.tif", tiffinfo={274: 1 + turn}, **kept)
        table.to_csv(path / "targets.csv", index=False)
        files = [path / "a.tif"]
        row = commands.radiometry("reflect", files, targets=path / "targets.csv").iloc[0]
        return row["reflectance"], row["remarks"]

    return found


def saturated(values):
    """Share of saturated pixels in a target that has these largest values."""

    def found(_):
        image = np.linspace(100, 3000, 1600).reshape(40, 40)
        image[0, : len(values)] = values
        return radiometry.patch_statistics(image, [[0, 1, 0, 40]])["saturated_share"].item(), ""

    return found


def verdict(value, relation, threshold, quantity, asked=None):
    """1 if a tender lets a figure pass, and the verdict."""

    def found(_):
        rows = {"criterion": ["x"], "quantity": asked or quantity, "relation": relation}
        seen = pd.DataFrame({"system": ["A"], "quantity": quantity, "value": value})
        table = tender.verdicts(pd.DataFrame(rows | {"threshold": threshold}), seen)
        said = table["verdict"].item()
        return float(said != "not met"), f"the verdict is {said}"

    return found


def sixteen_bits(_):
    """MTF50 of an edge in 16 bits of sRGB over the true one."""
    edge_image = render_edge((100, 64), PointSpread(0.8), angle_deg=5.0)
    codes = np.round(charts.encode(edge_image, "srgb") * 65535).astype(np.uint16)
    table = pd.DataFrame({"x_px": [0], "y_px": 0, "width_px": 64, "height_px": 100})
    row = image_targets.measure(codes[None], "edge", targets=table).iloc[0]
    return row["mtf50_per_px"] / true_mtf50(0.8, np.radians(5)), row["remarks"]


def clipped_in_photograph(path):
    """Pixel size of an overexposed photograph."""
    image = shoot(CHART, 5.4, seed=2, white=1.3, black=0.09).image
    return of_photograph(image, "pixel_v_mm", path, linear=False)


def without_a_chart(path):
    """Pixel size of the photograph beside one that shows no chart."""
    wall = np.random.default_rng(0).integers(0, 255, (200, 300), dtype=np.uint8)
    cv2.imwrite(str(path / "wall.png"), wall)
    rows = commands.image([path / "wall.png", samples.path("chart_photo")])
    return rows["pixel_v_mm"][1], rows["remarks"][0]


ROWS = {
    # edges and stars: MTF50 over the true one
    "edge, white clipped": Row(edge("white", 1), "white is clipped", 1.16),
    "edge, black clipped": Row(edge("black", 2), "black is clipped", 1.11),
    "second edge": Row(edge("second", 3), "a second edge of 1[345]% of the step", 0.75),
    "second edge near the first": Row(edge("near", 4), "as beside a second edge", 0.61),
    "bent edge": Row(edge("bend", 5), "leaves a straight line by [5-7].%", 0.834),
    "kink": Row(edge("kink", 6), "leaves a straight line by [5-7].%", 0.821),
    "wave": Row(edge("wave", 7), "leaves a straight line by [5-7].%", 0.833),
    "torn edge": Row(edge("torn", 8), "leaves a straight line by [5-7].%", 0.708),
    "sharpened": Row(edge("sharpened", 9), "^sharpened$", 1.6),
    "sharpened strongly": Row(edge("sharpened", 8), "^sharpened$", np.nan),
    "two edges": Row(two_edges, "leaves a single step by .* one edge", np.nan),
    "edge of 45 degrees": Row(edge("plain", 10, angle_deg=45.0), "", np.nan, 1, 0.02),
    "16 bits of sRGB": Row(sixteen_bits, "", 0.974, 1, 0.01),
    "star as stated": Row(star(), "", np.nan, 1, 0.02),
    "star of 35 cycles for 36": Row(star(cycles=35), "it shows about 36", 0.53),
    "star of 37 cycles for 36": Row(star(cycles=37), "star of 37 cycles", 0.53),
    "star, a third hidden": Row(star(hidden=1.05), "a part of the star is hidden", 1.31),
    "star, white clipped": Row(star(high=0.5), "white is clipped", 1.155),
    "star, black clipped": Row(star(low=0.2), "black is clipped", 1.155),
    # radiometry: gains over the true ones, reflectances, DN
    "falloff of 25 %": Row(gain(lambda t: 1 - 0.25 * t["radius"] ** 2), "", 1.06, 1, 0.02),
    "half an image under a cloud": Row(gain(half_cloudy), "images 5 contradict each other", 0.9),
    "a control in shadow": Row(gain(shadow=0.5), "Control targets 3 contradict", 1.012),
    "a control that stands twice": Row(gain(twice=1.01), "", 1.018, 1, 0.005),
    "the same, its rows turned": Row(gain(twice=1.01, order=-1), "", 1.013, 1, 0.005),
    "exposure": Row(target("calibrate", "gain", exposure=0.5), "", 10, 20, 0.01),
    "time and f-number": Row(
        target("calibrate", "gain", time_s=0.02, f_number=8.0), "", 10, 20, 0.01
    ),
    "anisotropy": Row(
        target("reflect", "reflectance", anisotropy=[1, 1, 1, 1.5]), "", 0.15, 0.1, 0.02
    ),
    "an unknown column": Row(
        target("reflect", "reflectance", height_m=0.2), "column of targets 'height_m'", 0.15
    ),
    "a reference half beside its tarp": Row(
        target("reflect", "reflectance", x_px=[0, 30, 40, 60]), "b not even: half beside", 0.118
    ),
    "a target half beside its tarp": Row(
        target("reflect", "reflectance", x_px=[0, 20, 40, 50]), "d not even: half beside", 0.3
    ),
    "LZW": Row(of_file(lzw=True), "", np.nan, 0.15, 0.01),
    "displayed pixels": Row(of_file(lzw=True, turn=2), "", -0.35, 0.15, 0.01),
    "two pixels share the largest value": Row(saturated((3500, 3500)), "", 0.05, 0),
    "forty pixels share it": Row(saturated((3500,) * 40), "", 0, 1),
    "largest value of 12 bits": Row(saturated((4095, 4095)), "", 0, 0.05),
    # tenders: 1 lets a figure pass
    "text c for at least b": Row(verdict("c", ">=", "b", "legibility"), "not met", 1, 0),
    "the same, the other sign": Row(verdict("c", "<=", "b", "legibility"), "not met", 1, 0),
    "a misspelled quantity": Row(
        verdict(9.0, "<=", 5.0, "pixel_mm", "pixl_mm"), "'pixel_mm' is the nearest", 1
    ),
    "d4 in metres": Row(verdict(0.02, "<=", 20.0, "d4_mm"), "in the unit of d4_mm", 1),
    # charts in photographs
    "lens, 7.6 %": Row(through_a_lens, "bent by 1.8%", 15, 6),
    "post over a row": Row(
        behind_a_post,
        "hidden: pairs_h_40, .*; pairs_h_15, pairs_h_10 have contrast", 40, 20,
    ),
    "white clipped in the photograph": Row(
        clipped_in_photograph, "50% of the plain pixels are clipped", np.nan, 5.4, 0.01
    ),
    "two charts": Row(two_charts, "2 charts are seen, the largest is measured", 5.5, 4, 0.01),
    "no chart in one of two photographs": Row(
        without_a_chart, "no long bars found", np.nan, 3.2, 0.01
    ),
}  # fmt: skip
"""What is photographed and what of it is read, the words, the wrong figure, the right one."""


@pytest.mark.parametrize("name", ROWS)
def test_no_wrong_figure_stands_without_a_word(name, tmp_path):
    found, words, wrong, truth, near = ROWS[name]
    try:
        figure, said = found(tmp_path)
    except ValueError as error:
        figure, said = np.nan, str(error)
    assert re.search(words, said) if words else not said
    assert truth is None or figure == pytest.approx(truth, rel=near)
    assert words or figure != pytest.approx(wrong, rel=near, nan_ok=True)
