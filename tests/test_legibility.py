"""Legibility: a jury's agreement, crops of texts, the quality index."""

import functools

import numpy as np
import pandas as pd
import pytest

from mmqa_lab import chart_image, charts, published
from mmqa_lab.chart_image import legibility
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


def test_kappa_of_juries_that_always_and_never_agree():
    assert chart_image.agreement(votes("aaa", "ccc")).fleiss_kappa == pytest.approx(1)
    # two marks used equally by two who never agree: (0 - 1/2) / (1 - 1/2)
    assert chart_image.agreement(votes("ab", "ba")).fleiss_kappa == pytest.approx(-1)


def test_kappa_of_one_mark_is_not_defined():
    assert np.isnan(chart_image.agreement(votes("aaa", "aaa")).fleiss_kappa)


def test_kappa_leaves_out_elements_that_a_juror_did_not_mark():
    marks = votes("aaa", "ccc", "abc").drop(index=8)
    found = chart_image.agreement(marks)
    assert found.fleiss_kappa == pytest.approx(1)
    assert found.verdict["n"].tolist() == [3, 3, 2]


def test_order_of_votes_does_not_matter(rng):
    marks = votes("aab", "bbc", "ccc", "abb")
    mixed = marks.iloc[rng.permutation(len(marks))]
    one, two = (chart_image.agreement(m) for m in (marks, mixed))
    tables = [found.to_frame().set_index("element").sort_index() for found in (one, two)]
    pd.testing.assert_frame_equal(*tables)
    assert one.fleiss_kappa == pytest.approx(two.fleiss_kappa)


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


def test_crops_over_the_edge_are_left_out():
    layout, taken = photo(30)
    names = {c.name for c in chart_image.text_crops(taken.image, layout, taken.chart_map)}
    cut = taken.image[:75]
    left = {c.name for c in chart_image.text_crops(cut, layout, taken.chart_map)}
    assert left < names


def test_check_list_has_the_order_of_the_paper():
    texts = {text.name: text for text in legibility.check_list(charts.imaging_chart(revised=True))}
    order = list(texts)
    hard = ["Mo.-Fr.", "(werkt). v.", "raised h", "raised minutes", "double l"]
    words = ["double l, other font", "long word", "long word, other font"]
    assert order[:8] == hard + words
    later = ["reduced contrast", "text of 50 mm", "symbol of the block"]
    assert [name for name in order if name in later] == later
    assert {texts[name].cap for name in legibility.JUDGED if "symbol" not in name} == {40}
    # section 4.2: line, word in two fonts, block with a symbol, vertical block with two
    assert [name for name in legibility.JUDGED if "symbol" in name] == order[-3:]
    assert not {"reduced contrast", "white on red", "text of 45 mm"} & set(legibility.JUDGED)
    with pytest.raises(ValueError, match="Must be one of"):
        legibility.check_list(charts.imaging_chart(texts=False))


def test_crops_of_the_check_list_show_its_letters():
    layout, taken = photo(250)
    crops = chart_image.text_crops(
        taken.image, layout, taken.chart_map, texts=legibility.check_list(layout)
    )
    assert [crop.name for crop in crops] == [what for what, *_ in legibility.CHECK_LIST]
    double, word = (next(c for c in crops if c.name == name) for name in ("double l", "long word"))
    assert double.image.shape[1] < 0.35 * word.image.shape[1]
    middle = double.image[len(double.image) // 2] < 0.3
    starts = np.flatnonzero(np.diff(middle.astype(int)) == 1)
    assert len(starts) >= 2  # both letters


def marks_of(photo, **worse):
    """A jury's marks of one photograph: a but for some elements."""
    return pd.DataFrame(
        [
            (photo, juror, name, worse.get(name.replace(" ", "_"), "aaa")[juror])
            for juror in range(3)
            for name, *_ in legibility.CHECK_LIST
        ],
        columns=["photo", "juror", "element", "mark"],
    )


def test_a_photograph_is_as_legible_as_its_worst_element_of_40_mm():
    marks = [
        marks_of("all"),
        marks_of("one juror", double_l="aab"),
        marks_of("letters", double_l="bbb", raised_h="ccb", long_word="ccc"),
        marks_of("contrast", reduced_contrast="ccc", white_on_red="ccc"),
        marks_of("tie", long_word="abc"),
    ]
    marks.append(marks_of("left out").query("element != 'raised h'"))
    found = legibility.photo_marks(pd.concat(marks)).set_index("photo")
    expected = {"all": "a", "one juror": "a", "letters": "c", "contrast": "a"}
    assert found["mark"].to_dict() == expected | {"tie": None, "left out": None}
    because = found["because"].to_dict()
    assert [because[name] for name in ("letters", "tie", "left out")] == [
        "raised h",  # earlier in the list than the long word
        "long word",
        "raised h",
    ]
    assert found.loc["all", "unanimous"] == 1
    with pytest.raises(ValueError, match="no column 'photo'"):
        legibility.photo_marks(marks[0].drop(columns="photo"))


def judged():
    """Marks and pixel sizes (standing bars) of Table 1 of Pfeifer et al. 2021."""
    table = published.table("pfeifer2021", "table_1")
    key = ["system", "distance_m", "view"]
    marks = table[table["quantity"] == "legibility"].set_index(key)["printed"]
    sizes = table.query("quantity == 'pixel size' and direction == 'v'").set_index(key)["value"]
    return pd.DataFrame({"mark": marks, "pixel_mm": sizes}).query("mark != ''")


def test_pixels_per_capital_agree_with_the_printed_marks_in_sample_and_mostly_out_of_it():
    seen = judged()
    found = legibility.expected_marks(40 / seen["pixel_mm"])
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
    found = legibility.expected_marks(pixels)
    assert found["best"].tolist() == ["b", "a", "a", "a"]
    assert found["worst"].tolist() == ["c", "c", "b", "a"]


def test_read_texts_counts_letters_and_leaves_symbols_out():
    names = ["long word", "raised minutes", "symbol of the block"]
    texts = [t for t in legibility.check_list(charts.imaging_chart()) if t.name in names]
    crops = [legibility.Crop(t.name, t.text, np.eye(20), 10.0) for t in texts]
    sizes = []

    def reader(image):
        sizes.append((image.shape, image.dtype))
        return "MuIlsamm elfzge" if len(sizes) == 2 else "30"

    found = legibility.read_texts(crops, reader=reader).set_index("element")
    assert sizes == [((80, 80), np.uint8)] * 2  # capitals of 10 px enlarged to 40 px
    assert found.loc["raised minutes", ["errors", "mark"]].tolist() == [0.0, "a"]
    assert found.loc["long word", "errors"] == pytest.approx(1 / 14)
    assert found.loc["long word", "mark"] == "b"
    assert "symbol of the block" not in found.index


def test_a_missing_reader_says_how_to_install_one(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "rapidocr", None)
    legibility._rapidocr.cache_clear()
    with pytest.raises(ModuleNotFoundError, match="pip install rapidocr onnxruntime"):
        legibility.read_texts([])


def test_an_installed_reader_reads_large_texts_and_not_small_ones():
    pytest.importorskip("rapidocr")
    legibility._rapidocr.cache_clear()
    marks = {}
    for megapixels in (250, 10):  # capitals of 14 and 3 pixels
        layout, taken = photo(megapixels)
        crops = chart_image.text_crops(taken.image, layout, taken.chart_map)
        marks[megapixels] = legibility.read_texts(crops).set_index("element")["mark"]
    assert (marks[250] == "a").mean() > 0.8
    assert (marks[10] == "c").mean() > 0.8


def test_colours_fringe_at_the_limit_of_resolution_of_a_mosaic_and_nowhere_else():
    layout = charts.imaging_chart(texts=False)
    camera = cameras.PanoramaCamera.of_megapixels(30)  # 8 mm at 10 m
    view = cameras.chart_view(camera, distance=10, layout=layout)
    sensor = cameras.Sensor(noise=0.0, bayer=True)
    optics = cameras.Optics(0.3)
    choices = {"optics": optics, "supersampling": 3}
    taken = cameras.photograph(layout, view, sensor=sensor, **choices)
    found = legibility.colour_fringes(taken.image, layout, taken.chart_map).set_index("name")
    standing = found[found["direction"] == "h"]
    assert 1.8 < standing.loc[standing["fringe"].idxmax(), "width_px"] < 4
    assert standing["fringe"].max() > 1.4 * standing["fringe"]["pairs_h_40"]
    grey = cameras.photograph(layout, view, sensor=cameras.Sensor(noise=0.0), **choices)
    neutral = np.dstack([0.9 * grey.image, grey.image, 0.8 * grey.image])
    none = legibility.colour_fringes(neutral, layout, grey.chart_map)
    assert none["fringe"].max() < 1e-3  # a cast of the light is no fringe


def test_quality_index_of_documents():
    # ANSI/AIIM MS23: 8 line pairs per mm and letters of 1 mm read excellently
    assert chart_image.quality_index(1.0, 1 / 8) == pytest.approx(0.75 * 8)
    with pytest.raises(ValueError, match="Invalid cap_mm 0"):
        chart_image.quality_index(0, 1)
