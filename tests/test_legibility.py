"""Legibility: a jury's agreement, crops of texts, the quality index."""

import numpy as np
import pandas as pd
import pytest

from mmqa_lab import chart_image, charts, published
from mmqa_lab.simulate import cameras


def votes(*rows):
    """Marks of a jury from strings of one letter per juror, an element each."""
    found = [
        (f"juror {j}", f"text {k}", m) for k, row in enumerate(rows) for j, m in enumerate(row)
    ]
    return pd.DataFrame(found, columns=["juror", "element", "mark"])


def test_kappa_equals_fleiss_by_hand():
    marks = ["aaa", "aab", "bbb", "bcc", "ccc", "abc"]
    counts = np.array([[row.count(mark) for mark in "abc"] for row in marks])
    agreeing = ((counts**2).sum(axis=1) - 3) / 6
    chance = ((counts.sum(axis=0) / counts.sum()) ** 2).sum()
    expected = (agreeing.mean() - chance) / (1 - chance)
    found = chart_image.agreement(votes(*marks))
    assert found.fleiss_kappa == pytest.approx(expected, abs=1e-12)
    assert found.verdict["mark"].tolist() == ["a", "a", "b", "c", "c", None]
    assert found.verdict["unanimous"].tolist() == [True, False, True, False, True, False]
    assert found.unanimous_share == 0.5


def test_kappa_of_one_mark_is_not_defined():
    assert np.isnan(chart_image.agreement(votes("aaa", "aaa")).fleiss_kappa)


def test_kappa_leaves_out_elements_that_a_juror_did_not_mark():
    marks = votes("aaa", "ccc", "abc").drop(index=8)
    found = chart_image.agreement(marks)
    assert found.fleiss_kappa == pytest.approx(1)
    assert found.verdict["n"].tolist() == [3, 3, 2]


def test_crops_hold_one_text_each_at_its_height():
    layout, camera = charts.imaging_chart(), cameras.PanoramaCamera.of_megapixels(250)
    view = cameras.chart_view(camera, distance=10, layout=layout)
    taken = cameras.photograph(layout, view, seed=1)
    crops = chart_image.text_crops(taken.image, layout, taken.chart_map)
    texts = [text for text in layout.of_kind(charts.Text) if text.name.startswith("text")]
    assert [crop.text for crop in crops] == [text.text for text in texts]
    for crop, text in zip(crops, texts, strict=True):
        # the panorama's pixel at 10 m, a little more where the chart is farther away
        assert crop.cap_px == pytest.approx(text.cap / 2.81, rel=0.01)
        if text.cap == 40 and text.ground == 1:
            side = int(0.5 * crop.cap_px) + 2  # margins at both sides
            ink = crop.image[:, side:-side] < (crop.image.min() + crop.image.max()) / 2
            # neither the line above nor the one below reaches in
            assert not ink[0].any()
            assert not ink[-1].any()
            assert ink.any(axis=0).mean() > 0.5


def judged():
    """Marks and pixel sizes (standing bars) of Table 1 of Pfeifer et al. 2021."""
    table = published.table("pfeifer2021", "table_1")
    key = ["system", "distance_m", "view"]
    marks = table[table["quantity"] == "legibility"].set_index(key)["printed"]
    sizes = table.query("quantity == 'pixel size' and direction == 'v'").set_index(key)["value"]
    return pd.DataFrame({"mark": marks, "pixel_mm": sizes}).query("mark != ''")


def test_pixels_per_capital_agree_with_the_printed_marks_in_sample_and_mostly_out_of_it():
    seen = judged()
    found = chart_image.expected_marks(40 / seen["pixel_mm"])
    assert len(seen) == 12
    assert (found["mark"].to_numpy() == seen["mark"]).all()
    assert (found["best"] <= found["mark"]).all()
    assert (found["mark"] <= found["worst"]).all()
    right = 0
    for k in range(len(seen)):
        rest = seen.drop(index=seen.index[k])
        ends = {
            mark: 40 / rest.loc[rest["mark"] == mark, "pixel_mm"] for mark in rest["mark"].unique()
        }
        pixels, mark = 40 / seen["pixel_mm"].iloc[k], "c"
        for better, worse in (("b", "c"), ("a", "b" if "b" in ends else "c")):
            if better in ends and pixels >= (ends[better].min() + ends[worse].max()) / 2:
                mark = better
        right += mark == seen["mark"].iloc[k]
    assert right == 10


def test_marks_are_open_between_the_photographs_that_were_judged():
    # C at 5 m is b with 40 mm / 3.8 mm, B backward a with 40 mm / 3.5 mm, printed to 0.1 mm
    pixels = [40 / 3.85 - 0.01, 40 / 3.85 + 0.01, 40 / 3.45 - 0.01, 40 / 3.45 + 0.01]
    found = chart_image.expected_marks(pixels)
    assert found["best"].tolist() == ["b", "a", "a", "a"]
    assert found["worst"].tolist() == ["c", "c", "b", "a"]
