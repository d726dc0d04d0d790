"""How well the chart's texts can be read: marks of a jury, and two stand-ins beside them.

The jury's marks are the reference. An automatic reader (OCR) and the quality index of line pairs
are stand-ins: they come in columns of their own and are never merged with the marks.
"""

import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_choice, check_positive
from mmqa_lab.charts import Text

MARKS = ("a", "b", "c")
"""a: every letter can be told; b: the text can be read; c: it cannot."""

X_HEIGHT_SHARE = 0.75
"""Height of lower-case letters in capitals of the chart's font."""

CROP_SIDES, CROP_BELOW, CROP_ABOVE = 0.5, 0.35, 0.2
"""Margins of a line, in heights of its capitals: its own tails fit, its neighbours' do not."""

READING_CAPS_PX = (20.0, 30.0)
"""Heights of the capitals that lines are enlarged to for an automatic reader, which tries both."""

DASHES = str.maketrans("–—‐‑", "----")
"""Dashes count as one letter: their length is typography."""

LEGIBLE_ERROR = 0.2
"""Share of wrong letters up to which a line counts as read: mark b."""

ENGINES = ("rapidocr", "tesseract")


@dataclass(frozen=True, eq=False)
class Crop:
    """One line of text as the image shows it.

    Parameters
    ----------
    name, text : str
        Of the chart's element.
    image : array, shape (rows, columns)
        Original pixels, linear light.
    cap_px : float
        Height of the capitals, pixels.

    Examples
    --------
    >>> from mmqa_lab.chart_image import ChartMap
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4)[::-1]  # pixels of 4 mm
    >>> there = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> crop = text_crops(image, layout, there)[0]
    >>> crop.text, round(crop.cap_px * 4), crop.image.ndim
    ('Halteverbot', 50, 2)
    """

    name: str
    text: str
    image: np.ndarray
    cap_px: float


@dataclass(frozen=True, eq=False)
class Reader:
    """An automatic reader; called with the grey image of one line, uint8, it returns the text.

    Parameters
    ----------
    name : str
        Engine and version.
    read : callable
    """

    name: str
    read: Callable

    def __call__(self, image):
        return self.read(image)


def text_crops(image, layout, chart_map):
    """Cut every line of text out of an image.

    Parameters
    ----------
    image : array, shape (rows, columns)
    layout : Layout
    chart_map : ChartMap

    Returns
    -------
    list of Crop
        In the layout's order; without the lines that reach over the image's edge.

    Examples
    --------
    >>> from mmqa_lab.chart_image import ChartMap
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4)[::-1]  # pixels of 4 mm
    >>> there = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> [crop.text for crop in text_crops(image, layout, there)][:2]
    ['Halteverbot', 'Mo.–Fr. 6–19 h']
    """
    crops = []
    for element in layout.of_kind(Text):
        low, size = np.array([element.x, element.y]), np.array([element.width, element.cap])
        high = low + size + element.cap * np.array([CROP_SIDES, CROP_ABOVE])
        low = low - element.cap * np.array([CROP_SIDES, CROP_BELOW])
        outline = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
        pixels = chart_map.pixels(outline)
        first = np.floor(pixels.min(axis=0)).astype(int)
        last = np.ceil(pixels.max(axis=0)).astype(int) + 1
        if (first < 0).any() or (last > image.shape[1::-1]).any():
            continue
        middle = (low + high)[None] / 2
        cap_px = element.cap / chart_map.pixel_sizes_mm(middle)[0, 1]
        part = image[first[1] : last[1], first[0] : last[0]]
        crops.append(Crop(element.name, element.text, part, float(cap_px)))
    return crops


def agreement(marks):
    """Return the jury's verdict per element and how well its members agree.

    Parameters
    ----------
    marks : DataFrame
        ``juror``, ``element`` and ``mark`` (a, b or c), one row per juror and element.

    Returns
    -------
    DataFrame
        Per element: ``mark`` of the majority (None for a tie), ``n`` jurors, ``unanimous``.
        ``attrs["fleiss_kappa"]`` over the elements that all jurors marked (NaN when all of them got
        one and the same mark, where kappa is not defined), ``attrs["unanimous_share"]``.

    Raises
    ------
    ValueError
        If a column is missing, a mark is another, or a juror marked an element twice.

    References
    ----------
    Fleiss 1971, doi:10.1037/h0031619.

    Examples
    --------
    >>> rows = [(j, e, m) for j in "123" for e, m in (("x", "a"), ("y", "c"))]
    >>> verdict = agreement(pd.DataFrame(rows, columns=["juror", "element", "mark"]))
    >>> verdict["mark"].tolist(), round(verdict.attrs["fleiss_kappa"], 6)
    (['a', 'c'], 1.0)
    """
    from statsmodels.stats.inter_rater import fleiss_kappa

    marks = check_marks(marks)
    counts = pd.crosstab(marks["element"], marks["mark"]).reindex(columns=list(MARKS), fill_value=0)
    counts = counts.loc[marks["element"].drop_duplicates()]
    best, total = counts.max(axis=1), counts.sum(axis=1)
    winner = counts.idxmax(axis=1).astype(object)
    winner[counts.eq(best, axis=0).sum(axis=1) > 1] = None
    verdict = pd.DataFrame({"mark": winner, "n": total, "unanimous": best == total}).reset_index()
    complete = counts[total == marks["juror"].nunique()].to_numpy()
    several = marks["juror"].nunique() > 1 and (complete.sum(axis=0) > 0).sum() > 1
    verdict.attrs["fleiss_kappa"] = float(fleiss_kappa(complete)) if several else np.nan
    verdict.attrs["unanimous_share"] = float(verdict["unanimous"].mean())
    return verdict


def check_marks(marks):
    """Return a jury's marks as a DataFrame, checked."""
    missing = {"juror", "element", "mark"} - set(marks.columns)
    if missing:
        raise ValueError(f"Invalid marks: no column {sorted(missing)[0]!r}. Must have one.")
    for mark in marks["mark"].unique():
        check_choice(mark, "mark", MARKS)
    if marks.duplicated(["juror", "element"]).any():
        first = marks[marks.duplicated(["juror", "element"])].iloc[0]
        raise ValueError(
            f"Invalid marks: juror {first['juror']} marked {first['element']} twice. Must be once."
        )
    return marks


def quality_index(cap_mm, width_mm):
    """Return the quality index QI: height of lower-case letters over the resolved pair width.

    Parameters
    ----------
    cap_mm : float
        Height of the capitals.
    width_mm : float or array_like
        Resolved width w, mm; the geometric mean of both directions is usual.

    Returns
    -------
    float or array
        About 3 barely legible, 3.6 marginal, 5 good, 8 excellent in the reading of documents.

    Raises
    ------
    ValueError
        If ``cap_mm`` is not above zero.

    References
    ----------
    ANSI/AIIM MS23; Kenney and Chapman 1996, Digital Resolution Requirements, Cornell University.

    Examples
    --------
    >>> quality_index(40, 10)
    3.0
    """
    return X_HEIGHT_SHARE * check_positive(cap_mm, "cap_mm", unit="mm") / width_mm


def reader(engine="auto"):
    """Return an automatic reader of single lines that works offline.

    Parameters
    ----------
    engine : {"auto", "rapidocr", "tesseract"}
        The Python package rapidocr, whose models are in its wheel, or the program tesseract with
        its German data; the first one present.

    Returns
    -------
    Reader

    Raises
    ------
    ImportError
        If the engine is not installed.

    Examples
    --------
    >>> reader("eyes")
    Traceback (most recent call last):
    ValueError: Invalid engine 'eyes'. Must be one of auto, rapidocr, tesseract.
    """
    check_choice(engine, "engine", ("auto", *ENGINES))
    engines = {"rapidocr": _rapidocr, "tesseract": _tesseract}
    missing = []
    for name in ENGINES if engine == "auto" else (engine,):
        try:
            return engines[name]()
        except ImportError as error:
            missing.append(str(error))
    raise ImportError(
        f"No automatic reader: {', '.join(missing)}. Must be rapidocr (pip install rapidocr "
        "onnxruntime) or tesseract (apt install tesseract-ocr tesseract-ocr-deu)."
    )


def read_crops(crops, read):
    """Read lines of text automatically, each at several enlargements.

    Parameters
    ----------
    crops : list of Crop
    read : callable
        From :func:`reader`.

    Returns
    -------
    DataFrame
        Per line: ``element``, ``text`` as printed, ``read``, ``error`` (edits per letter, at best
        over the enlargements), ``cap_px`` and ``ocr_mark``: a without errors, b up to a fifth,
        else c. The mark is a stand-in: readers know the language, a letter on its own they miss.

    Examples
    --------
    >>> crop = Crop("sign", "Wien", np.ones((20, 60)), 12.0)
    >>> read_crops([crop], lambda image: "Wien")[["error", "ocr_mark"]].to_numpy().tolist()
    [[0.0, 'a']]
    """
    rows = []
    for crop in crops:
        scales = [cap / crop.cap_px for cap in READING_CAPS_PX]
        tried = [read(_prepared(crop.image, scale)) for scale in scales]
        best = min(tried, key=lambda text: character_error(text, crop.text))
        error = character_error(best, crop.text)
        mark = "a" if error == 0 else "b" if error <= LEGIBLE_ERROR else "c"
        rows.append((crop.name, crop.text, best, error, crop.cap_px, mark))
    columns = ["element", "text", "read", "error", "cap_px", "ocr_mark"]
    return pd.DataFrame(rows, columns=columns)


def character_error(read, text):
    """Return the edits that turn what was read into the text, per letter.

    Spaces are left out, and all dashes are one letter.

    Parameters
    ----------
    read, text : str
        What was read and what is printed.

    Returns
    -------
    float
        0 where they agree.

    Examples
    --------
    >>> round(character_error("Mullsammelfzge", "Müllsammelfzge."), 2)
    0.13
    """
    read, text = ("".join(part.split()).translate(DASHES) for part in (read, text))
    row = np.arange(len(text) + 1)
    for k, letter in enumerate(read):
        change = row[:-1] + (np.array(list(text)) != letter)
        best = np.minimum(change, row[1:] + 1)
        row = np.concatenate([[k + 1], best])
        # insertions run along the row: the cheapest start so far plus the way from there
        steps = np.arange(len(row))
        row = np.minimum.accumulate(row - steps) + steps
    return float(row[-1] / max(len(text), 1))


def _prepared(image, scale):
    """A crop stretched to full contrast, enlarged, as 8-bit display values."""
    import cv2

    from mmqa_lab.chart_image.light import encode

    low, high = np.percentile(image, [1, 99])
    grey = encode(np.clip((image - low) / max(high - low, 1e-9), 0, 1), "srgb")
    size = np.maximum(np.round(np.array(image.shape[::-1]) * scale), 1).astype(int)
    enlarged = cv2.resize(grey.astype(np.float32), size, interpolation=cv2.INTER_CUBIC)
    return np.clip(np.round(enlarged * 255), 0, 255).astype(np.uint8)


def _rapidocr():
    """The reader of the package rapidocr."""
    try:
        from rapidocr import RapidOCR

        engine = RapidOCR(params={"Global.log_level": "critical"})
    except ImportError:
        raise ImportError("rapidocr with onnxruntime is not installed") from None

    def read(image):
        """Lines are cut out already: recognition alone."""
        colour = np.repeat(image[:, :, None], 3, axis=2)
        found = engine(colour, use_det=False, use_cls=False, use_rec=True)
        return " ".join(found.txts or ())

    return Reader(f"rapidocr {metadata.version('rapidocr')}", read)


def _tesseract():
    """The reader of the program tesseract."""
    if shutil.which("tesseract") is None:
        raise ImportError("tesseract is not installed")
    if "deu" not in _run_tesseract("--list-langs").split():
        raise ImportError("tesseract has no German data")

    def read(image):
        """One line of text."""
        import cv2

        png = cv2.imencode(".png", image)[1].tobytes()
        return _run_tesseract("stdin", "stdout", "-l", "deu", "--psm", "7", data=png).strip()

    return Reader(" ".join(_run_tesseract("--version").split()[:2]), read)


def _run_tesseract(*arguments, data=b""):
    """What the program tesseract prints."""
    done = subprocess.run(["tesseract", *arguments], input=data, capture_output=True, check=False)
    if done.returncode:
        said = done.stderr.decode(errors="replace").strip().splitlines() or ["no message"]
        raise ImportError(f"tesseract does not run ({said[-1]})")
    return done.stdout.decode(errors="replace")
