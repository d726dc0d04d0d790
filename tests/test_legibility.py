"""Legibility: a jury's agreement, crops of texts, the quality index."""

import numpy as np
import pandas as pd
import pytest

from mmqa_lab import chart_image, charts, published, tender
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


def test_marks_of_texts_that_were_not_judged_lie_between_those_of_judged_photographs():
    seen = judged()
    texts = tender.published_results(by_pixels=True).query("quantity == 'legibility_60mm'")
    texts = texts.set_index("system")
    judged_px, text_px = 40 / seen["pixel_mm"], 60 / seen["pixel_mm"].loc["A", 5.0, "orthogonal"]
    best = seen["mark"][judged_px >= text_px].max()
    worst = seen["mark"][judged_px <= text_px].min()
    found = texts.loc["A", ["low", "high", "value"]]
    assert found.tolist() == ["abc".index(best), "abc".index(worst), worst]
