"""The charts: what is printed where, drawn alike in every form."""

import re
import zlib
from xml.etree import ElementTree

import cv2
import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmqa_lab import charts
from mmqa_lab.charts import Bar, Layout, Text

CHART = charts.imaging_chart()


def test_bars_and_pairs_have_the_published_lengths():
    assert CHART["bar_left"].height == CHART["bar_right"].height == 800
    assert CHART["bar_horizontal"].width == 600
    assert (CHART.width, CHART.height) == (1000, 1000)
    pairs = CHART.of_kind(charts.LinePairs)
    assert {p.repeats for p in pairs} == {8}
    assert {p.length for p in pairs} == {80}
    widths = {d: [p.pair for p in pairs if p.direction == d] for d in "hv"}
    assert (widths["h"][0], widths["h"][-1]) == (40, 2)
    assert (max(widths["v"]), min(widths["v"])) == (30, 2)
    assert {text.cap for text in CHART.of_kind(Text)} == {40, 42, 45, 50}


def test_bar_tones_follow_the_option():
    assert CHART["bar_horizontal"].tone == 0.5
    assert charts.imaging_chart(horizontal_bar="black")["bar_horizontal"].tone == 0


@pytest.mark.parametrize(
    "layout",
    [
        CHART,
        charts.imaging_chart(dictionary=None),
        charts.imaging_chart(texts=(), widths_h=(30, 7)),
    ],
)
def test_nothing_overlaps_but_text_on_its_panel(layout):
    boxes = []
    for element in layout.elements:
        if element.ground == 1:
            far = element.x + element.width, element.y + element.height
            boxes.append((element.name, element.x, element.y, *far))
    for k, (name, x0, y0, x1, y1) in enumerate(boxes):
        for other, a0, b0, a1, b1 in boxes[k + 1 :]:
            apart = x1 <= a0 or a1 <= x0 or y1 <= b0 or b1 <= y0
            assert apart, (name, other)


def test_reflectance_is_the_mean_of_a_finer_one():
    layout = charts.imaging_chart()
    fine, coarse = (charts.reflectance(layout, cell=cell) for cell in (0.5, 2.5))
    mean = fine.reshape(400, 5, 400, 5).mean(axis=(1, 3))
    # rectangles are exact; of letters each cell is cut off to 1/255, in both images
    change = np.abs(mean - coarse)
    assert change.max() < 3 / 255
    # about 6 % of the cells lie on outlines
    assert mean.mean() == pytest.approx(coarse.mean(), abs=0.06 / 255)


def test_reflectance_keeps_the_printed_area():
    bar = Bar("a", 10.3, 20.7, 31.1, 12.9)
    image = charts.reflectance(Layout("a", 100, 60, (bar,)), cell=0.7)
    assert (1 - image).sum() * 0.49 == pytest.approx(31.1 * 12.9, rel=1e-5)


@pytest.mark.parametrize("letter", "gü8§³ªB½ʰ")
@pytest.mark.parametrize("face", ["DejaVuSans", "DejaVuSerif"])
def test_letters_match_freetype(letter, face):
    from PIL import Image, ImageDraw, ImageFont

    cap, cell = 40.0, 0.25
    layout = Layout("text", 100, 100, (Text("t", 20, 30, letter, cap, font=face),))
    ours = charts.reflectance(layout, cell=cell)[::-1]
    file = f"{mpl.get_data_path()}/fonts/ttf/{face}.ttf"
    # capitals of both faces are 1493 of 2048 units high
    font = ImageFont.truetype(file, cap / cell * 2048 / 1493)
    picture = Image.new("L", (400, 400), 255)
    ImageDraw.Draw(picture).text((80, 280), letter, font=font, fill=0, anchor="ls")
    theirs = np.asarray(picture) / 255
    # FreeType moves outlines to whole pixels, here 0.25 mm of strokes 5 mm wide
    assert (1 - ours).sum() == pytest.approx((1 - theirs).sum(), rel=0.05)
    assert np.corrcoef(ours.ravel(), theirs.ravel())[0, 1] > 0.96


def test_texts_are_those_that_the_paper_names():
    texts = CHART.of_kind(Text)
    words = {text.text for text in texts}
    assert {"Mo.-Fr. (werkt). v.", "6³⁰-19ʰ", "Müllsammelfzge.", "Linienomnibusse"} <= words
    assert len({text.font for text in texts if text.text == "Müllsammelfzge."}) == 2
    assert {text.cap for text in texts} == {40, 42, 45, 50}


def test_targets_are_read_back_by_opencv():
    for dictionary in ("DICT_4X4_50", "DICT_APRILTAG_36H11"):
        layout = charts.imaging_chart(dictionary=dictionary, first_marker=7)
        image = np.uint8(255 * charts.reflectance(layout, cell=1)[::-1])
        book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
        corners, found, _ = cv2.aruco.ArucoDetector(book).detectMarkers(image)
        assert sorted(np.ravel(found).tolist()) == [7, 8, 9, 10]
        first = corners[np.ravel(found).tolist().index(7)].reshape(4, 2)
        expected = layout["marker_0"].corners()[::-1] * [1, -1] + [0, 1000]
        assert np.abs(first + 0.5 - expected).max() <= 1


def page_of(pdf):
    """The drawing operators of a PDF's page."""
    streams = re.findall(rb"stream\r?\n(.*?)\r?\nendstream", pdf, re.DOTALL)
    return b"\n".join(zlib.decompress(part) for part in streams)


def test_svg_has_every_element_at_true_size():
    tree = ElementTree.fromstring(CHART.to_svg())
    points = [float(tree.get(side).removesuffix("pt")) for side in ("width", "height")]
    assert np.array(points) * 25.4 / 72 == pytest.approx([1000, 1000], abs=1e-3)
    view = [float(number) for number in tree.get("viewBox").split()]
    assert view == pytest.approx([0, 0, *points], abs=1e-3)
    groups = {part.get("id"): part for part in tree.iter("{http://www.w3.org/2000/svg}g")}
    assert {element.name for element in CHART.elements} <= set(groups)
    text = ElementTree.tostring(groups["bar_left"], encoding="unicode")
    numbers = np.array(re.findall(r"[ML] ([\d.-]+) ([\d.-]+)", text), dtype=float) * 25.4 / 72
    assert np.ptp(numbers, axis=0) == pytest.approx([40, 800], abs=1e-3)


def test_pdf_is_one_page_at_true_size_whatever_the_style():
    with mpl.rc_context({"savefig.bbox": "tight", "figure.dpi": 50, "savefig.dpi": 33}):
        pdf = CHART.to_pdf()
    box = re.search(rb"/MediaBox \[ ?([^\]]+)\]", pdf).group(1).split()
    side_mm = [float(number) * 25.4 / 72 for number in box]
    assert side_mm == pytest.approx([0, 0, 1000, 1000], abs=1e-3)
    assert len(re.findall(rb"/Type /Page\b(?!s)", pdf)) == 1
    assert CHART.to_pdf() == pdf


def test_pdf_draws_the_bars_where_the_layout_has_them():
    layout = Layout("one", 100, 50, (Bar("a", 12, 7, 30, 5),))
    page = page_of(layout.to_pdf()).decode("latin1")
    corners = np.array(re.findall(r"([\d.]+) ([\d.]+) [ml]\b", page), dtype=float) * 25.4 / 72
    assert np.array([12, 7]) == pytest.approx(corners.min(axis=0), abs=1e-3)
    assert np.array([42, 12]) == pytest.approx(corners.max(axis=0), abs=1e-3)


def test_point_chart_is_random_with_two_plain_squares():
    layout = charts.point_chart(seed=3)
    _, _, tones = layout["cells"].grid()
    assert tones.shape == (100, 100)
    free = tones[25:95, 5:95]
    # 6,300 fair coins: within four standard deviations
    assert abs(free.mean() - 0.5) < 4 * 0.5 / np.sqrt(free.size)
    image = charts.reflectance(layout, cell=10)
    assert (image[5:25, 5:25] == 0).all()
    assert (image[5:25, 75:95] == 1).all()
    border = np.ones_like(image, dtype=bool)
    border[5:-5, 5:-5] = False
    assert (image[border] == 1).all()
    assert charts.point_chart(seed=4) != layout


def test_point_chart_without_a_border_reaches_its_edges():
    image = charts.reflectance(charts.point_chart(border=0, square=150), cell=10)
    assert (image[:15, :15] == 0).all()
    assert (image[:15, 85:] == 1).all()
    assert set(np.unique(image[-1])) == {0, 1}


def test_squares_off_the_cells_are_plain_to_their_edge():
    image = charts.reflectance(charts.point_chart(square=203, border=47), cell=1)
    assert (image[47:250, 47:250] == 0).all()
    assert (image[47:250, 750:953] == 1).all()


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.floats(2, 60), min_size=1, max_size=6, unique=True),
    st.lists(st.floats(2, 60), min_size=1, max_size=6, unique=True),
)
def test_any_ladder_fits_or_says_so(widths_h, widths_v):
    ladders = [sorted(widths, reverse=True) for widths in (widths_h, widths_v)]
    try:
        layout = charts.imaging_chart(widths_h=ladders[0], widths_v=ladders[1], texts=())
    except ValueError:
        # half of the field is enough for ladders this short
        assert 8 * sum(sum(ladder) for ladder in ladders) > 1500
        return
    pairs = layout.of_kind(charts.LinePairs)
    printed = {d: [p.pair for p in pairs if p.direction == d] for d in "hv"}
    assert [sorted(printed[d], reverse=True) for d in "hv"] == ladders
    assert Layout.from_json(layout.to_json()) == layout


def test_clearance_is_the_gap_to_the_next_element():
    layout = Layout("a", 100, 50, (Bar("a", 20, 10, 10, 5), Bar("b", 45, 12, 10, 5)))
    assert layout.clearance(layout["a"], (0, 0)).tolist() == [[20, 15], [10, 35]]
    lone = Layout("a", 100, 50, (Bar("a", 20, 10, 10, 5), Bar("b", 45, 25, 10, 5)))
    assert lone.clearance(lone["a"], (0, 0)).tolist() == [[20, 70], [10, 35]]
    assert lone.clearance(lone["a"], (0, 12)).tolist() == [[20, 15], [10, 35]]


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: charts.imaging_chart(horizontal_bar="red"), "Must be one of grey, black"),
        (lambda: charts.imaging_chart(widths_h=(10, 20)), "Must decrease"),
        (lambda: charts.imaging_chart(widths_h=(90,)), "Must fit on the chart"),
        (lambda: charts.imaging_chart(texts=((40, "x" * 60),)), "does not fit"),
        (lambda: charts.imaging_chart(texts=((40, "\U0001f697"),)), "not in the font"),
        (lambda: charts.imaging_chart(texts=((40, "x", "Comic"),)), "Invalid font 'Comic'"),
        (lambda: charts.imaging_chart(dictionary="DICT_9"), "Must be one of"),
        (lambda: Layout("a", 10, 10, (Bar("a", 5, 5, 9, 1),)), "Must lie within"),
        (lambda: Layout("a", 9, 9, (Bar("a", 1, 1, 1, 1),) * 2), "Must be distinct"),
        (lambda: Layout("a", 9, 9, (Bar("a", 1, 1, -1, 1),)), "Must be > 0 mm"),
        (lambda: Layout.from_json("{"), "Must be JSON"),
        (lambda: Layout.from_json('{"elements": [{"kind": "Bar"}]}'), "Must be JSON"),
        (lambda: charts.reflectance(CHART, cell=0), "Must be > 0 mm"),
        (lambda: charts.reflectance(CHART, cell=0.001), "Must be 1e9 or fewer"),
        (lambda: charts.point_chart(square=900), "Must be between 1 and 500"),
    ],
)
def test_rejects(make, sentence):
    with pytest.raises(ValueError, match=sentence):
        make()
