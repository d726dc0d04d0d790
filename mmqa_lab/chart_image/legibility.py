"""How well a photograph's texts can be read: check list, marks, and what stands in for a jury.

Pfeifer et al. 2021 (doi:10.3390/rs13020237), sections 3.2 and 4.2: a jury of three works through a
list of elements in its order, hard cases first, and gives one mark to each photograph. Pixels per
capital height and a program that reads texts stand in for it; their marks are never merged with
those of a jury.
"""

import unicodedata
from collections.abc import Callable, Sequence
from dataclasses import replace
from difflib import SequenceMatcher
from functools import lru_cache

import cv2
import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mmqa_lab import published
from mmqa_lab._checks import check_columns
from mmqa_lab.chart_image.geometry import ChartMap
from mmqa_lab.chart_image.reading import find_tones
from mmqa_lab.chart_image.rules import MARKS, Crop, agreement
from mmqa_lab.charts import Layout, LinePairs, Text
from mmqa_lab.io.images import encode

CHECK_LIST = (
    ("Mo.-Fr.", "text_line", "Mo.-Fr."),
    ("(werkt). v.", "text_line", "(werkt). v."),
    ("raised h", "text_line", "ʰ"),
    ("raised minutes", "text_line", "³⁰"),
    ("double l", "text_word", "ll"),
    ("double l, other font", "text_word_serif", "ll"),
    ("long word", "text_word", ""),
    ("long word, other font", "text_word_serif", ""),
    ("block, first line", "text_block_1", ""),
    ("block, second line", "text_block_2", ""),
    ("column, first line", "text_column_1", ""),
    ("column, second line", "text_column_2", ""),
    ("column, third line", "text_column_3", ""),
    ("reduced contrast", "text_faint", ""),
    ("white on blue", "text_blue", ""),
    ("white on red", "text_red", ""),
    ("black on yellow", "text_yellow", ""),
    ("text of 42 mm", "text_42", ""),
    ("text of 45 mm", "text_45_2", ""),
    ("small letters of 45 mm", "text_45_small", ""),
    ("text of 50 mm", "text_50", ""),
    ("symbol of the block", "text_block_symbol", ""),
    ("first symbol of the column", "text_column_symbol_1", ""),
    ("second symbol of the column", "text_column_symbol_2", ""),
)
"""What a jury looks at, in the order of section 3.2: hard cases, double letters before the long
word, the other texts of 40 mm, reduced contrast and colours, larger letters, symbols. With the
chart's element and the letters of it, all where none are given."""

NOT_JUDGED = ("text_faint", "text_blue", "text_red", "text_yellow", "text_4", "text_5")
"""Elements, by the beginning of their names, that do not count for the criterion of 40 mm: section
4.2 leaves out reduced contrast, colours and larger letters."""

JUDGED = tuple(what for what, name, _ in CHECK_LIST if not name.startswith(NOT_JUDGED))
"""Elements that give a photograph its mark."""

TEXT_MM, ROUNDING_MM = 40.0, 0.05
"""Capital height that was judged, and half of the last digit of printed pixel sizes."""

LEGIBLE_ERRORS = 0.2
"""A text is called legible (b) while a program misses at most this share of its letters."""

READ_PX = 40.0
"""Height of capitals that programs get to read; smaller ones are enlarged."""


def check_list(layout: Layout) -> list[Text]:
    """Return the texts and symbols of a chart in the order of the paper's check list.

    Parameters
    ----------
    layout : Layout
        An imaging chart with its texts.

    Returns
    -------
    list of Text
        Lines, or some letters of them; each has the name of its element of the list.

    Raises
    ------
    ValueError
        If the chart lacks an element.

    Examples
    --------
    >>> from mmqa_lab.charts import imaging_chart
    >>> [(text.name, text.text) for text in check_list(imaging_chart())[3:5]]
    [('raised minutes', '³⁰'), ('double l', 'll')]
    """
    texts = [(what, layout[name], letters) for what, name, letters in CHECK_LIST]
    return [replace(text.part(letters) if letters else text, name=w) for w, text, letters in texts]


def photo_marks(marks: pd.DataFrame) -> pd.DataFrame:
    """Return the mark of each photograph from the marks of its elements.

    A photograph is as legible as the worst of the elements that count (:data:`JUDGED`), by the
    majority of the jury. The paper does not print how its jury came from elements to the mark.

    Parameters
    ----------
    marks : DataFrame
        ``photo``, ``juror``, ``element`` (of the check list), ``mark`` (a, b, c).

    Returns
    -------
    DataFrame
        ``photo``, ``mark`` (None where an element that counts has no mark or a tie), ``because``
        (the first element of the list with that mark, or without one), ``unanimous`` (share of
        the elements).

    Raises
    ------
    ValueError
        If a column is missing or a mark is another.

    Examples
    --------
    >>> rows = [("1", "x", name, "c" if name == "double l" else "b") for name in JUDGED]
    >>> photo_marks(pd.DataFrame(rows, columns=["photo", "juror", "element", "mark"]))
      photo mark   because  unanimous
    0     1    c  double l        1.0
    """
    check_columns(marks, ["photo"], "marks")
    rows = []
    for photo, part in marks.groupby("photo", sort=False):
        found = agreement(part)
        verdict = found.verdict.set_index("element")["mark"].reindex(list(JUDGED))
        open_ones = verdict[verdict.isna()]
        worst = None if len(open_ones) else verdict.max()
        because = open_ones.index[0] if len(open_ones) else verdict[verdict == worst].index[0]
        rows.append((photo, worst, because, found.unanimous_share))
    table = pd.DataFrame(rows, columns=["photo", "mark", "because", "unanimous"])
    return table.assign(mark=pd.Series([row[1] for row in rows], dtype=object))


def expected_marks(cap_px: ArrayLike) -> pd.DataFrame:
    """Return the marks that a jury would give by the pixels per capital height.

    Parameters
    ----------
    cap_px : array_like, shape (n,)
        Height of the capitals, pixels.

    Returns
    -------
    DataFrame
        ``cap_px``, ``mark`` (thresholds half way between the published photographs of neighbouring
        marks), ``best`` and ``worst`` (thresholds at the one and the other of these photographs,
        whose pixel sizes are rounded).

    Notes
    -----
    Two thresholds, a from 11.0 and b from 9.0 pixels, are fitted to the twelve marks of Table 1 and
    agree with all of them. Predicted from the eleven others, 10 of the 12 are right. One photograph
    alone has mark b.

    Examples
    --------
    >>> expected_marks([30.0, 11.3, 9.5, 5.0])[["mark", "best", "worst"]].values.tolist()
    [['a', 'a', 'a'], ['a', 'a', 'b'], ['b', 'b', 'c'], ['c', 'c', 'c']]
    """
    limits = mark_limits(_judged())
    table = pd.DataFrame({"cap_px": np.atleast_1d(np.asarray(cap_px, dtype=float))})
    for name in ("mark", "best", "worst"):
        steps = [(table["cap_px"] < limits.loc[name, mark]).to_numpy() for mark in MARKS[:-1]]
        table[name] = np.array(MARKS, dtype=object)[np.sum(steps, axis=0)]
    return table


def expected_text(cap_px):
    """The mark that pixels per capital height make expected, with its range where it is open."""
    if not np.isfinite(cap_px):
        return ""
    one = expected_marks(cap_px).iloc[0]
    return one["mark"] if one["best"] == one["worst"] else f"{one['best']} to {one['worst']}"


def mark_limits(judged):
    """Fewest pixels per capital height for marks a and b.

    Parameters
    ----------
    judged : DataFrame
        ``mark``, ``cap_px``, ``least_px`` and ``most_px`` (by rounding), a row per photograph.

    Returns
    -------
    DataFrame
        Columns a, b; rows ``mark`` (half way between neighbouring photographs), ``best``,
        ``worst``. NaN where a mark or all worse ones are missing.
    """
    limits = pd.DataFrame(index=["mark", "best", "worst"], columns=list(MARKS[:-1]), dtype=float)
    for mark in limits.columns:
        up, down = judged[judged["mark"] <= mark], judged[judged["mark"] > mark]
        half = (up["cap_px"].min() + down["cap_px"].max()) / 2
        limits[mark] = [half, down["least_px"].max(), up["most_px"].min()]
    return limits


def read_texts(
    crops: Sequence[Crop], *, reader: Callable[[np.ndarray], str] | None = None
) -> pd.DataFrame:
    """Let a program read texts.

    Parameters
    ----------
    crops : sequence of Crop
        Of :func:`mmqa_lab.chart_image.text_crops`.
    reader : callable, optional
        Takes an image of one line, shape (rows, columns), 8 bits, and returns its text. By default
        the recognition of the Python package rapidocr (3 or newer).

    Returns
    -------
    DataFrame
        ``element``, ``text`` (printed), ``read``, ``errors`` (share of the printed letters that
        were not read; capitals, accents and raised letters count as plain ones) and ``mark``: a
        without errors, b with a fifth of the letters or less, else c. Symbols are left out.

    Raises
    ------
    ModuleNotFoundError
        If no reader is given and the package is not installed.

    Examples
    --------
    >>> crop = Crop("word", "Müll", np.ones((20, 40)), 12.0)
    >>> read_texts([crop], reader=lambda image: "Mull")[["errors", "mark"]].values.tolist()
    [[0.0, 'a']]
    """
    reader = reader or _rapidocr()
    rows = []
    for crop in crops:
        printed = _plain(crop.text)
        if printed:
            seen = reader(_to_read(crop))
            blocks = SequenceMatcher(None, printed, _plain(seen), False).get_matching_blocks()
            errors = 1 - sum(block.size for block in blocks) / len(printed)
            rows.append((crop.name, crop.text, seen, errors, mark_of_errors(errors)))
    return pd.DataFrame(rows, columns=["element", "text", "read", "errors", "mark"])


def mark_of_errors(share):
    """The mark for a share of letters that a program missed."""
    return "a" if share == 0 else "b" if share <= LEGIBLE_ERRORS else "c"


def colour_fringes(image: np.ndarray, layout: Layout, chart_map: ChartMap) -> pd.DataFrame:
    """Measure the colours that black and white line pairs take on in a colour photograph.

    The paper saw strong ones at and beyond the limit of resolution (section 4.4).

    Parameters
    ----------
    image : array, shape (rows, columns, 3)
        Linear light, full scale 1.
    layout : Layout
    chart_map : ChartMap

    Returns
    -------
    DataFrame
        A row per pattern: ``name``, ``direction``, ``width_mm``, ``width_px`` and ``fringe``, the
        mean range of the three colours as share of the contrast of black and white.

    Examples
    --------
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4, colour=True)[::-1]  # pixels of 4 mm
    >>> there = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> float(colour_fringes(image, layout, there)["fringe"].max().round(6))
    0.0
    """
    bands = [find_tones(image[..., k], layout, chart_map) for k in range(3)]
    span = replace(bands[0], values=np.ptp([band.values for band in bands], axis=0))
    rows = []
    for pairs in layout.of_kind(LinePairs):
        outline = pairs.corners()
        places, values, _ = span.near(chart_map, outline)
        inside = ((places >= outline[0]) & (places <= outline[2])).all(axis=1)
        axis = "hv".index(pairs.direction)
        pixel_mm = chart_map.pixel_sizes_mm(outline.mean(axis=0)[None])[0, axis]
        fringe = float(values[inside].mean()) if inside.any() else np.nan
        rows.append((pairs.name, pairs.direction, pairs.pair, pairs.pair / pixel_mm, fringe))
    return pd.DataFrame(rows, columns=["name", "direction", "width_mm", "width_px", "fringe"])


@lru_cache(maxsize=1)
def _judged():
    """The photographs of Table 1 with their marks and pixels per capital height."""
    table = published.table("pfeifer2021", "table_1").query("status != 'not_evaluated'")
    key = ["system", "distance_m", "view"]
    marks = table[table["quantity"] == "legibility"].set_index(key)["printed"].rename("mark")
    bars = table.query("quantity == 'pixel size' and direction == 'v'").set_index(key)["value"]
    sizes = {"cap_px": bars, "least_px": bars + ROUNDING_MM, "most_px": bars - ROUNDING_MM}
    return pd.concat([marks, TEXT_MM / pd.DataFrame(sizes)], axis=1)


def _plain(text):
    """Letters and digits in lower case, without accents, raised ones as plain ones."""
    parts = unicodedata.normalize("NFKD", text.casefold())
    return "".join(letter for letter in parts if letter.isalnum())


def _to_read(crop):
    """A crop as programs want it: dark on light, 8 bits, large enough."""
    low, high = np.percentile(crop.image, [1, 99])
    coded = encode((crop.image - low) / max(high - low, 1e-9), "srgb")
    times = max(READ_PX / crop.cap_px, 1.0)
    large = cv2.resize(coded, None, fx=times, fy=times, interpolation=cv2.INTER_CUBIC)
    return np.uint8(np.clip(255 * large, 0, 255))


@lru_cache(maxsize=1)
def _rapidocr():
    """A reader of one line by rapidocr, whose models come with it."""
    try:
        from rapidocr import RapidOCR
    except ModuleNotFoundError:
        raise ModuleNotFoundError(
            "Invalid reader: none given and rapidocr is not installed. "
            "Must be installed with: pip install rapidocr onnxruntime."
        ) from None
    engine = RapidOCR(params={"Global.log_level": "error"})

    def read(image):
        found = engine(np.dstack([image] * 3), use_det=False, use_cls=False)
        return "".join(found.txts or ())

    return read
