"""The charts: what is printed where, drawn alike in every form."""

import re
import zlib
from xml.etree import ElementTree

import cv2
import matplotlib as mpl
import numpy as np
import pytest
import rasterio.features

from mmqa_lab import charts
from mmqa_lab.charts import Bar, Layout, Text

CHART = charts.imaging_chart()


def test_what_is_printed_over_another_element_is_refused_or_covers_it():
    bar, panel = Bar("bar", 2, 2, 6, 6), Bar("panel", 5, 5, 6, 6, tone=1.0)
    with pytest.raises(ValueError, match="'bar' and 'panel': one over the other"):
        Layout("two", 20, 20, (bar, panel))
    white = Text("white", 3, 4, "I", 3, tone=1.0)  # on black, though it says no ground
    image = charts.reflectance(Layout("text", 10, 10, (bar, white)), cell=0.1)
    assert abs(image.min()) < 1e-6
    assert image.max() < 1 + 1e-6
    assert image[25:75, 25:75].max() > 0.9


def test_what_is_no_element_and_targets_without_a_code_are_refused():
    with pytest.raises(ValueError, match=r"Invalid elements of chart 'x': \['int'\]"):
        Layout("x", 20, 20, [Bar("bar", 2, 2, 6, 6), 3])
    for dictionary, number in (("DICT_9X9", 1), ("DICT_4X4_50", 50), ("DICT_4X4_50", -1)):
        with pytest.raises(ValueError, match="target 'm'"):
            Layout("x", 20, 20, [charts.Marker("m", 2, 2, 9, dictionary, number)])


@pytest.mark.parametrize("layout", [CHART, charts.imaging_chart("revised")])
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


@pytest.mark.parametrize("letter", "gü§ʰ")
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
    texts = [text for text in CHART.of_kind(Text) if text.name.startswith("text")]
    words = {text.text for text in texts}
    named = {"Mo.-Fr. (werkt). v. 6³⁰-19ʰ", "Müllsammelfzge.", "ausgen.", "Linienomnibusse"}
    assert named | {"Mo.-Sa.", "v. 6³⁰-18³⁰", "(werkt.) v.", "Aus-", "u.", "Einsteigen"} <= words
    assert len({text.font for text in texts if text.text == "Müllsammelfzge."}) == 2
    judged = [text for text in texts if text.text not in ("u.", "♿", "⇦")]
    assert {text.cap for text in judged} == {40, 42, 45, 50}
    assert CHART["text_45_small"].cap < CHART["text_45_1"].cap  # the letter made smaller
    assert CHART["text_45_small"].y == CHART["text_45_1"].y
    symbols = [text.name for text in texts if text.text in ("♿", "⇦")]
    assert symbols == ["text_block_symbol", "text_column_symbol_1", "text_column_symbol_2"]


def test_targets_are_read_back_by_opencv():
    image = np.uint8(255 * charts.reflectance(CHART, cell=1)[::-1])
    book = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    corners, found, _ = cv2.aruco.ArucoDetector(book).detectMarkers(image)
    assert sorted(np.ravel(found).tolist()) == [0, 1, 2, 3]
    first = corners[np.ravel(found).tolist().index(0)].reshape(4, 2)
    expected = CHART["marker_0"].corners()[::-1] * [1, -1] + [0, 1000]
    assert np.abs(first + 0.5 - expected).max() <= 1


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


def test_notes_are_a_second_page_and_the_first_stays_true_to_size():
    pdf = CHART.to_pdf(notes=charts.how_to_use())
    boxes = re.findall(rb"/MediaBox \[ ?([^\]]+)\]", pdf)
    side = 1000 * 72 / 25.4
    assert [float(one) for one in boxes[0].split()] == pytest.approx([0, 0, side, side], abs=0.01)
    assert len(re.findall(rb"/Type /Page\b(?!s)", pdf)) == 2


def page_of(pdf):
    """What the page of a PDF shows: colour and rings (mm) of each filled path; its size in mm."""
    mm = 25.4 / 72
    size = re.search(rb"/MediaBox \[ ?([^\]]+)\]", pdf).group(1).split()
    stream = re.search(rb"stream\r?\n(.*?)\r?\nendstream", pdf, re.DOTALL).group(1)
    shapes = list(shapes_of(zlib.decompress(stream).decode(), mm))
    return shapes, [float(number) * mm for number in size[2:]]


def shapes_of(stream, mm):
    """Colour and rings of each filled path; an unknown operator is an error."""
    numbers, rings, colour = [], [], (0.0,)
    for word in stream.split():
        if re.fullmatch(r"-?[\d.]+", word):
            numbers.append(float(word))
            continue
        if word in "ml":
            rings = rings if word == "l" else [*rings, []]
            rings[-1].append([mm * value for value in numbers])
        elif word in ("g", "rg"):
            colour = tuple(numbers)
        elif word == "f":
            yield colour, [np.array(ring) for ring in rings]
            rings = []
        else:
            known = ("re", "W", "h", "j", "w", "n", "q", "Q", "CS", "cs", "/DeviceRGB")
            assert word in known, word
        numbers = []


def linear(colour):
    """Reflectance of a colour of a file, by the curve of IEC 61966-2-1."""
    coded = np.array(colour)
    return np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)


def painted(shapes, size, per_mm):
    """A page as an image of reflectances, shape (rows, columns, 3), lower row first."""
    tones, areas = [[1, 1, 1]], []
    for colour, rings in shapes:
        corners = [np.vstack([ring, ring[:1]]) for ring in rings]
        areas.append(({"type": "Polygon", "coordinates": corners}, len(tones)))
        tones.append(np.broadcast_to(linear(colour), 3))
    pixels = (round(size[1] * per_mm), round(size[0] * per_mm))
    to_mm = rasterio.Affine.scale(1 / per_mm)
    # a pixel has the tone of its middle
    number = rasterio.features.rasterize(areas, pixels, transform=to_mm, dtype=np.uint8)
    return np.array(tones, dtype=np.float16)[number]


def along(image, line, axis, per_mm):
    """Begin and length, mm, of the dark runs along a row (axis 0) or a column (axis 1)."""
    dark = np.take(image, round(line * per_mm), axis=axis) < 0.75
    steps = np.flatnonzero(np.diff(np.pad(dark.astype(int), 1)))
    return (steps[::2] / per_mm, (steps[1::2] - steps[::2]) / per_mm)


@pytest.fixture(scope="module")
def printed():
    """The page of the imaging chart, four pixels a millimetre: its green."""
    return painted(*page_of(CHART.to_pdf()), 4)[..., 1]


def runs_within(runs, low, length):
    """Of the runs along a line those of one element."""
    begin = runs[0]
    return [part[(begin > low - 1) & (begin < low + length)] for part in runs]


def test_printed_line_pairs_are_those_of_section_3_2(printed):
    seen = {"h": [], "v": []}
    for pairs in CHART.of_kind(charts.LinePairs):
        axis = 0 if pairs.direction == "h" else 1
        middle = pairs.corners().mean(axis=0)
        begin, size = runs_within(
            along(printed, middle[1 - axis], axis, 4), pairs.corners()[0, axis], pairs.extent
        )
        assert len(begin) == 8  # repetitions
        assert size == pytest.approx(pairs.pair / 2, abs=0.25)  # as much black as white
        seen[pairs.direction].append(np.diff(begin).mean())
        begin, size = runs_within(
            along(printed, pairs.corners()[0, axis] + pairs.pair / 4, 1 - axis, 4),
            *(pairs.corners()[0, 1 - axis], pairs.length),
        )
        assert size == pytest.approx([80], abs=0.25)
    ladder = [40, 30, 20, 15, 10, 8, 6, 4, 3, 2]
    assert sorted(seen["h"], reverse=True) == pytest.approx(ladder, abs=0.05)
    assert sorted(seen["v"], reverse=True) == pytest.approx(ladder[1:], abs=0.05)


def test_printed_bars_are_800_and_600_mm_long_and_the_lying_one_grey(printed):
    for column in (154, 856):
        assert max(along(printed, column, 1, 4)[1]) == pytest.approx(800, abs=0.25)
    assert max(along(printed, 50, 0, 4)[1]) == pytest.approx(600, abs=0.25)
    # on paper half of the light of white, which files code as 188 of 255
    assert printed[200, 2000] == pytest.approx(0.5, abs=1e-3)
    assert printed[2000, 616] == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize(
    "layout",
    [charts.imaging_chart("revised"), charts.point_chart(seed=2)],
    ids=["image", "points"],
)
def test_the_simulated_chart_is_the_printed_one(layout):
    page = painted(*page_of(layout.to_pdf()), 2).reshape(100, 20, 100, 20, 3)
    mean = page.mean(axis=(1, 3), dtype=np.float32)
    off = np.abs(mean - charts.reflectance(layout, cell=10, colour=True))
    # of a cell of 20 pixels a side an outline across it leaves out half a pixel
    assert off.max() < 0.06
    assert off.mean() < 0.003


def test_the_revised_chart_is_the_one_that_the_authors_ask_for():
    revised = charts.imaging_chart("revised")
    widths = {
        d: [p.pair for p in revised.of_kind(charts.LinePairs) if p.direction == d] for d in "hv"
    }
    assert min(max(widths[d]) for d in "hv") > 40
    assert sorted(widths["h"]) == sorted(widths["v"])
    assert {p.pair for p in CHART.of_kind(charts.LinePairs)} < set(widths["h"])
    assert revised["bar_horizontal"].tone == 0
    assert len(revised.of_kind(charts.Marker)) == 4
    texts = [text.name for text in CHART.of_kind(Text) if text.name.startswith("text")]
    assert [text.name for text in revised.of_kind(Text) if text.name.startswith("text")] == texts


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


def test_elements_lie_within_the_chart_and_share_at_most_a_hair():
    whole = Bar("whole", 0, 0, 20, 10)
    assert Layout("x", 20, 10, (whole,))["whole"] is whole
    for x, y, wide, high in ((-0.01, 0, 5, 5), (0, -0.01, 5, 5), (15.01, 0, 5, 5), (0, 5.01, 5, 5)):
        with pytest.raises(ValueError, match="element 'a'"):
            Layout("x", 20, 10, (Bar("a", x, y, wide, high),))
    for share, fits in ((5e-7, True), (5e-6, False)):
        pair = Bar("a", 0, 0, 5, 5), Bar("b", 5 - share, 0, 5, 5)
        above = Bar("a", 0, 0, 5, 5), Bar("b", 0, 5 - share, 5, 5)
        for two in (pair, above):
            if fits:
                assert len(Layout("x", 20, 20, two).elements) == 2
            else:
                with pytest.raises(ValueError, match="one over the other"):
                    Layout("x", 20, 20, two)
    pairs = charts.LinePairs("p", 0, 0, 4.0, "h", repeats=2, length=6.0)  # white from 2 to 4
    assert Layout("x", 20, 20, (pairs, Bar("b", 2, 1, 2, 3)))
    for x, wide in ((2, 2.1), (1.9, 2), (4.1, 1)):
        with pytest.raises(ValueError, match="one over the other"):
            Layout("x", 20, 20, (pairs, Bar("b", x, 1, wide, 3)))
    with pytest.raises(ValueError, match="a name repeats"):
        Layout("x", 20, 20, (whole, Bar("whole", 0, 12, 2, 2)))
    last = charts.Marker("m", 2, 2, 9, "DICT_4X4_50", 49)
    assert Layout("x", 20, 20, (last,)).of_kind(charts.Marker) == [last]


def test_a_chart_that_a_printer_made_smaller_is_smaller_everywhere():
    made = CHART.printed(796.0)
    factor = 796 / 800
    assert (made.width, made.height) == pytest.approx((1000 * factor, 1000 * factor))
    for one, other in zip(CHART.elements, made.elements, strict=True):
        assert other.corners() == pytest.approx(factor * one.corners())
        assert other.ground == one.ground
    assert made["pairs_h_40"].pair == pytest.approx(40 * factor)
    assert made["text_45_1"].cap == pytest.approx(CHART["text_45_1"].cap * factor)


def test_srgb_is_coded_by_its_published_curve():
    values = np.array([-0.1, 0.0, 0.002, 0.0031308, 0.0032, 0.2140411, 0.5, 1.0, 1.3])
    linear_part = 12.92 * values[1:4]
    powers = 1.055 * np.clip(values[4:], 0, 1) ** (1 / 2.4) - 0.055
    assert charts.encode(values, "srgb") == pytest.approx([0, *linear_part, *powers])
    assert charts.encode(0.2140411, "srgb") == pytest.approx(0.5, abs=1e-6)
    codes = np.array([0.0, 0.03, 0.0404, 0.0406, 0.5, 1.0])
    expected = np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)
    assert charts.decode(codes, "srgb") == pytest.approx(expected)
    assert charts.decode(np.uint8([0, 1]), "srgb").tolist() == [0, 1]


def test_shapes_join_neighbours_of_one_tone_and_leave_out_white():
    from mmqa_lab.charts import draw
    from mmqa_lab.charts.elements import Cells

    cells = Cells("c", 10.0, 20.0, 30.0, ((0.0, 0.0, 1.0), (1.0, 0.5, 1.0), (0.0, 1.0, 1.0)))
    shapes = draw._shapes(cells)
    assert set(shapes) == {0.0, 0.5}
    ((low, high),) = [shapes[0.5].get_extents().get_points()]
    assert (*low, *high) == pytest.approx((20, 30, 30, 40))
    assert len([code for code in shapes[0.0].codes if code == 1]) == 2  # two and one cell
    assert shapes[0.0].get_extents().get_points() == pytest.approx(np.array([[10, 20], [30, 50]]))
    bar = draw._shapes(Bar("b", 1, 2, 3, 4, 0.3))
    assert bar[0.3].get_extents().get_points() == pytest.approx(np.array([[1, 2], [4, 6]]))
    dark = draw._shapes(charts.LinePairs("p", 0, 0, 4.0, "h", repeats=1, length=6.0, ground=0.2))
    assert set(dark) == {0.0, 1.0}
    where, shares = draw._overlaps(np.array([0.3, 1.0, 2.6]), 0.5)
    assert (where.start, where.stop) == (0, 6)
    assert shares == pytest.approx(np.array([[0.4, 1, 0, 0, 0, 0], [0, 0, 1, 1, 1, 0.2]]))
