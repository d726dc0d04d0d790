"""Legibility: a jury's agreement, errors of a reader, crops, and readers that may be missing."""

import functools
import shutil
import sys

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mmqa_lab import chart_image, charts
from mmqa_lab.chart_image import legibility
from mmqa_lab.simulate import cameras

LETTERS = st.text(alphabet="aäbßc1²", max_size=7)


def votes(*rows):
    """Marks of a jury from strings of one letter per juror, an element each."""
    found = [
        (f"juror {j}", f"text {k}", m) for k, row in enumerate(rows) for j, m in enumerate(row)
    ]
    return pd.DataFrame(found, columns=["juror", "element", "mark"])


def edits(one, two):
    """Levenshtein's distance by its recursion."""
    if not one or not two:
        return len(one) + len(two)
    same = edits(one[1:], two[1:])
    if one[0] == two[0]:
        return same
    return 1 + min(same, edits(one[1:], two), edits(one, two[1:]))


def test_kappa_equals_fleiss_by_hand():
    marks = ["aaa", "aab", "bbb", "bcc", "ccc", "abc"]
    counts = np.array([[row.count(mark) for mark in "abc"] for row in marks])
    agreeing = ((counts**2).sum(axis=1) - 3) / 6
    chance = ((counts.sum(axis=0) / counts.sum()) ** 2).sum()
    expected = (agreeing.mean() - chance) / (1 - chance)
    verdict = chart_image.agreement(votes(*marks))
    assert verdict.attrs["fleiss_kappa"] == pytest.approx(expected, abs=1e-12)
    assert verdict["mark"].tolist() == ["a", "a", "b", "c", "c", None]
    assert verdict["unanimous"].tolist() == [True, False, True, False, True, False]
    assert verdict.attrs["unanimous_share"] == 0.5


def test_kappa_of_juries_that_always_and_never_agree():
    assert chart_image.agreement(votes("aaa", "ccc")).attrs["fleiss_kappa"] == pytest.approx(1)
    # two marks used equally by two who never agree: (0 - 1/2) / (1 - 1/2)
    assert chart_image.agreement(votes("ab", "ba")).attrs["fleiss_kappa"] == pytest.approx(-1)


def test_kappa_of_one_mark_is_not_defined():
    assert np.isnan(chart_image.agreement(votes("aaa", "aaa")).attrs["fleiss_kappa"])


def test_kappa_leaves_out_elements_that_a_juror_did_not_mark():
    marks = votes("aaa", "ccc", "abc").drop(index=8)
    verdict = chart_image.agreement(marks)
    assert verdict.attrs["fleiss_kappa"] == pytest.approx(1)
    assert verdict["n"].tolist() == [3, 3, 2]


def test_order_of_votes_does_not_matter(rng):
    marks = votes("aab", "bbc", "ccc", "abb")
    mixed = marks.iloc[rng.permutation(len(marks))]
    one, two = (chart_image.agreement(m).set_index("element").sort_index() for m in (marks, mixed))
    pd.testing.assert_frame_equal(one, two)
    assert one.attrs["fleiss_kappa"] == pytest.approx(two.attrs["fleiss_kappa"])


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda m: m.drop(columns="mark"), "no column 'mark'"),
        (lambda m: m.assign(mark="d"), "Invalid mark 'd'"),
        (lambda m: pd.concat([m, m[:1]]), "juror juror 0 marked text 0 twice"),
    ],
)
def test_marks_are_checked(change, sentence):
    with pytest.raises(ValueError, match=sentence):
        chart_image.agreement(change(votes("abc")))


@given(one=LETTERS, two=LETTERS)
def test_letter_errors_equal_the_recursion(one, two):
    error = chart_image.character_error(one, two)
    assert error == pytest.approx(edits(one, two) / max(len(two), 1))


def test_spaces_and_kinds_of_dashes_are_no_errors():
    assert chart_image.character_error("Mo.-Fr. 6 - 19h", "Mo.–Fr. 6–19 h") == 0


@functools.cache
def photo(megapixels):
    """A chart of bars and texts at 10 m."""
    layout = charts.imaging_chart(widths_h=(2.0,), widths_v=(2.0,))
    view = cameras.chart_view(
        cameras.PanoramaCamera.of_megapixels(megapixels), distance=10, layout=layout
    )
    return layout, cameras.photograph(layout, view, supersampling=3, seed=1)


def test_crops_hold_one_text_each_at_its_height():
    layout, taken = photo(250)
    crops = chart_image.text_crops(taken.image, layout, taken.chart_map)
    texts = layout.of_kind(charts.Text)
    assert [crop.text for crop in crops] == [text.text for text in texts]
    for crop, text in zip(crops, texts, strict=True):
        # the panorama's pixel at 10 m, a little more where the chart is farther away
        assert crop.cap_px == pytest.approx(text.cap / 2.81, rel=0.01)
        ink = crop.image < (crop.image.min() + crop.image.max()) / 2
        if text.name != "text_faint":
            # neither the line above nor the one below reaches in
            assert not ink[0].any()
            assert not ink[-1].any()
            assert ink.any(axis=0).mean() > 0.5


def test_crops_over_the_edge_are_left_out():
    layout, taken = photo(30)
    names = {c.name for c in chart_image.text_crops(taken.image, layout, taken.chart_map)}
    cut = taken.image[:75]
    left = {c.name for c in chart_image.text_crops(cut, layout, taken.chart_map)}
    assert left < names


def test_lines_are_read_at_their_best_enlargement_and_marked():
    crops = [
        chart_image.Crop(name, "Halteverbot", np.eye(12), 10.0) for name in ("one", "two", "three")
    ]
    sizes, answers = [], iter(["Halt", "Halteverbot", "Haltverbot", "Halteverb", "x", ""])

    def read(image):
        sizes.append(image.shape)
        assert image.dtype == np.uint8
        return next(answers)

    found = chart_image.read_crops(crops, read)
    assert found["ocr_mark"].tolist() == ["a", "b", "c"]
    assert found["read"].tolist() == ["Halteverbot", "Haltverbot", "x"]
    # capitals of 10 px are enlarged to 20 and to 30
    assert sizes[:2] == [(24, 24), (36, 36)]


def test_quality_index_of_documents():
    # ANSI/AIIM MS23: 8 line pairs per mm and letters of 1 mm read excellently
    assert chart_image.quality_index(1.0, 1 / 8) == pytest.approx(0.75 * 8)
    with pytest.raises(ValueError, match="Invalid cap_mm 0"):
        chart_image.quality_index(0, 1)


def test_missing_readers_are_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "rapidocr", None)
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(ImportError, match="rapidocr with onnxruntime is not installed, tesseract"):
        chart_image.reader()
    with pytest.raises(ImportError, match="pip install rapidocr onnxruntime"):
        chart_image.reader("rapidocr")
    with pytest.raises(ValueError, match="Invalid engine 'eye'"):
        chart_image.reader("eye")


def test_tesseract_without_german_is_named(monkeypatch, tmp_path):
    program = tmp_path / "tesseract"
    program.write_text("#!/bin/sh\necho 'List of available languages (1):'; echo eng\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    with pytest.raises(ImportError, match="tesseract has no German data"):
        chart_image.reader("tesseract")
    program.write_text("#!/bin/sh\necho 'no library' >&2; exit 1\n")
    with pytest.raises(ImportError, match=r"tesseract does not run \(no library\)"):
        chart_image.reader("tesseract")


@pytest.mark.parametrize("engine", legibility.ENGINES)
def test_reader_reads_a_sharp_chart_and_not_a_coarse_one(engine):
    try:
        read = chart_image.reader(engine)
    except ImportError as error:
        pytest.skip(str(error))
    assert read.name.startswith(engine)
    errors = []
    for megapixels in (250, 4):
        layout, taken = photo(megapixels)
        crops = chart_image.text_crops(taken.image, layout, taken.chart_map)
        plain = [crop for crop in crops if crop.name in ("text_1", "text_4")]
        errors.append(chart_image.read_crops(plain, read)["error"])
    # capitals of 14 px are read; those of 2 px nobody can, even who guesses words
    assert errors[0].max() == 0
    assert errors[1].min() > 0.2
