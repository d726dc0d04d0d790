"""Journal figures in matplotlib: widths in millimetres, one style, colours for all readers.

Only code that draws figures needs this module. It does not change matplotlib's settings
permanently. Use ``with style():`` for some figures, or matplotlib's
``plt.style.use(plots.STYLE)`` for a whole notebook. :func:`finish_figure` gives a figure that is
done its panel letters and symbols, :func:`say_kind` the kind of its numbers.
"""

import contextlib
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.category
import matplotlib.pyplot as plt
import numpy as np
from cycler import cycler
from matplotlib import font_manager
from matplotlib.collections import PathCollection
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_choice
from mmqa_lab._data import read_toml
from mmqa_lab.planes import flat_points

__all__ = ["draw_points", "style", "subplots"]
__dir__ = __all__.copy

JOURNALS = read_toml(Path(__file__).with_suffix(".toml"))
"""A publisher's rules for figures: widths of one column and of the whole text, fonts in the order
of preference, size of the letters, and the source. New publishers are added with their source.
"""

COLOURS = {
    "blue": "#0072B2",
    "vermilion": "#D55E00",
    "green": "#009E73",
    "purple": "#CC79A7",
    "orange": "#E69F00",
    "sky": "#56B4E9",
    "black": "#000000",
    "grey": "#7F7F7F",
}
"""The palette of Okabe and Ito (jfly.uni-koeln.de/color), and a grey."""

KIND_COLOURS = {
    "published": COLOURS["black"],
    "predicted": COLOURS["sky"],
    "fitted": COLOURS["orange"],
    "measured": COLOURS["blue"],
}
"""One colour for each kind of number, the same in all studies."""

MAP = "cividis"
DIVERGING_MAP = "RdBu_r"

_FILE = Path(__file__).with_suffix(".mplstyle")
STYLE = dict(mpl.rc_params_from_file(_FILE, use_default_template=False))
STYLE["axes.prop_cycle"] = cycler(
    color=[colour for name, colour in COLOURS.items() if name != "grey"],
    linestyle=["-", "--", "-.", ":", (0, (6, 1, 1, 1, 1, 1)), (0, (2, 1)), (0, (1, 3))],
)
"""The house style as matplotlib's settings, and its colours each with a dash of its own."""

# Symbols as words of a text: d1, d2, ..., f, g, thresholds, s_r, rho0 and sigma_MAD.
SYMBOL = re.compile(r"(?<![\w$\\])(?:([dsf])_?([1-9]|r|0)|([fg])|sigma_(?:MAD|mad)|rho0)(?![\w$(])")

# A name of words joined by underscores, which LaTeX escapes.
JOINED = re.compile(r"(?<![\w$\\])[a-z0-9]{2,}(?:\\?_[a-z0-9]+)+(?![\w.])")

# Formatters of axes whose ticks have names.
NAMING = mpl.ticker.FixedFormatter | mpl.ticker.FuncFormatter | mpl.category.StrCategoryFormatter

# A line or a set of dots of more points is drawn as pixels in PDF and SVG, too.
MOST_LINED = 5000

# Labels of ticks may share so much of their boxes, which have room for letters that are not there;
# else they get smaller, down to this size.
TOUCHING_PX, LEAST_PT = 1.0, 4.0

# Height of the line below the panels with its margins.
NOTE_INCHES = 0.18

_in_use = {"single": 85.0, "double": 178.0}


@contextlib.contextmanager
def style(journal: str = "house") -> Iterator[dict]:
    """Draw figures by a publisher's rules, inside a ``with`` block or as a function's decorator.

    Widths, fonts and lettering come from ``JOURNALS``. Afterwards matplotlib has its earlier
    settings again, so save the figure inside the block. If no font of the publisher is installed,
    DejaVu Sans replaces it, with a warning.

    Parameters
    ----------
    journal : {"house", "elsevier", "ieee", "mdpi", "isprs", "springer"}
        One column and the whole text are 85 and 178 mm wide (house, our choice), 90 and 190 mm
        (Elsevier, artwork sizing), 88.9 and 182 mm (IEEE, size requirements for graphics), 138.6
        and 184.6 mm (MDPI, LaTeX class of 2024), 82 and 170 mm (ISPRS, guidelines for authors), or
        84 and 174 mm (Springer, artwork instructions).

    Yields
    ------
    dict
        The rules of the journal, from ``JOURNALS``.

    Raises
    ------
    ValueError
        If the journal is unknown.

    Examples
    --------
    >>> with warnings.catch_warnings(action="ignore"), style("elsevier"):
    ...     figure, ax = subplots(width="double")
    >>> round(figure.get_size_inches()[0] * 25.4)
    190
    >>> plt.close(figure)
    """
    chosen = JOURNALS[check_choice(journal, "journal", tuple(JOURNALS))]
    before = dict(_in_use)
    with mpl.rc_context(STYLE | _lettering(chosen)):
        _in_use.update(zip(before, chosen["widths_mm"], strict=True))
        try:
            yield chosen
        finally:
            _in_use.update(before)


def _lettering(journal):
    """Settings for a publisher's fonts and size of letters."""
    installed = {font.name for font in font_manager.fontManager.ttflist}
    if not installed & set(journal["fonts"]):
        asked = " and ".join(journal["fonts"])
        warnings.warn(f"Fonts not installed: {asked}. DejaVu Sans is used instead.", stacklevel=4)
    size = journal["lettering_pt"]
    small = dict.fromkeys(("xtick.labelsize", "ytick.labelsize", "legend.fontsize"), min(size, 7))
    return {"font.sans-serif": [*journal["fonts"], "DejaVu Sans"], "font.size": size, **small}


def subplots(
    rows: int = 1,
    columns: int = 1,
    *,
    width: str = "single",
    height_mm: float = 60.0,
    **choices: Any,
) -> tuple[plt.Figure, Any]:
    """Return a figure with the width of a journal, and its axes.

    Parameters
    ----------
    rows, columns : int
        Numbers of panels.
    width : {"single", "double"}
        One column, or the whole width of the text, in the journal chosen by :func:`style`.
    height_mm : float
        Height of the figure, mm.
    **choices
        Arguments of ``matplotlib.pyplot.subplots``.

    Returns
    -------
    figure, axes
        As ``matplotlib.pyplot.subplots`` returns them.

    Raises
    ------
    ValueError
        If the width is neither ``"single"`` nor ``"double"``.

    Examples
    --------
    >>> figure, ax = subplots(width="single", height_mm=50)
    >>> round(figure.get_size_inches()[0] * 25.4)
    85
    >>> plt.close(figure)
    """
    check_choice(width, "width", tuple(_in_use))
    return plt.subplots(rows, columns, figsize=(_in_use[width] / 25.4, height_mm / 25.4), **choices)


def draw_points(xy: ArrayLike, *, ax: plt.Axes, **colours: Any) -> PathCollection:
    """Draw points in a plane, with the same scale on both axes.

    Parameters
    ----------
    xy : array, shape (n, 2)
        Coordinates, m.
    ax : Axes
        The axes to draw on.
    **colours
        ``c``, ``vmin``, ``vmax``, ``cmap`` of ``Axes.scatter``; blue by default.

    Returns
    -------
    matplotlib.collections.PathCollection
        The points, for a colour bar.

    Examples
    --------
    >>> figure, ax = subplots()
    >>> dots = draw_points([[0, 0], [1, 0]], ax=ax)
    >>> ax.get_xlabel()
    'along axis 1 (m)'
    >>> plt.close(figure)
    """
    xy = flat_points(xy)
    look = {"s": np.clip(4000 / max(len(xy), 1), 0.3, 6.0), "lw": 0, "rasterized": True}
    dots = ax.scatter(*xy.T, **look, **colours or {"color": COLOURS["blue"]})
    ax.set(xlabel="along axis 1 (m)", ylabel="along axis 2 (m)", aspect="equal")
    return dots


def finish_figure(figure):
    """Add letters to the panels of a figure and set its symbols; a second call changes nothing.

    Parameters
    ----------
    figure : Figure
        Changed in place.

    Examples
    --------
    >>> import matplotlib.pyplot as plt
    >>> figure, axes = plt.subplots(1, 2)
    >>> finish_figure(figure)
    >>> [ax.texts[0].get_text() for ax in axes]
    ['(a)', '(b)']
    >>> plt.close(figure)
    """
    _letter(figure)
    for text in figure.findobj(mpl.text.Text):
        if text.get_gid() != "letter":
            text.set_text(with_symbols(text.get_text()))
    for axis in (axis for ax in figure.axes for axis in (ax.xaxis, ax.yaxis)):
        form = axis.get_major_formatter()
        if not isinstance(form, NAMING):
            continue
        ticks = axis.get_majorticklocs()
        names = [str(name) for name in form.format_ticks(ticks)]
        if any(SYMBOL.fullmatch(name) or "_" in name for name in names):
            axis.set_ticks(ticks, labels=[with_symbols(name) for name in names])


@contextlib.contextmanager
def laid_out(figure):
    """Lay a figure out once for all formats it is saved in, and draw many points as pixels.

    With a layout engine matplotlib draws a figure twice for each format. Labels of ticks that
    would overlap get smaller.
    """
    for ax in figure.axes:
        parts = [(one, one.get_xdata()) for one in ax.lines]
        parts += [(one, one.get_offsets()) for one in ax.collections]
        for part in (one for one, places in parts if len(places) > MOST_LINED):
            part.set_rasterized(True)
    figure.draw_without_rendering()
    shown = [ax for ax in figure.axes if ax.axison and ax.name == "rectilinear"]
    for axis in (axis for ax in shown for axis in (ax.xaxis, ax.yaxis)):
        _part(axis)
    with mpl.rc_context({"figure.autolayout": False, "figure.constrained_layout.use": False}):
        figure.set_layout_engine(None)
        yield


def _part(axis):
    """Make the upright labels of an axis smaller until none lies on its neighbour."""
    low, high = sorted(axis.get_view_interval())
    labels = zip(axis.get_majorticklocs(), axis.get_majorticklabels(), strict=False)
    labels = [one for place, one in labels if low <= place <= high and one.get_text()]
    labels = [one for one in labels if not one.get_rotation()]
    size = labels[0].get_fontsize() if labels else 0
    while size > LEAST_PT and _overlap(labels, "xy".index(axis.axis_name)):
        size -= 0.5
        axis.set_tick_params(labelsize=size)


def _overlap(labels, along):
    """Whether one of some texts lies on the next along an axis of the figure."""
    boxes = np.array([one.get_window_extent().extents for one in labels]).reshape(-1, 4)
    first, last = boxes[np.argsort(boxes[:, along])][:, [along, along + 2]].T
    return bool((last[:-1] - first[1:] > TOUCHING_PX).any())


def say_kind(figure, kind):
    """Write the kind of a figure's numbers in its lower right corner, unless its texts state it.

    Parameters
    ----------
    figure : Figure
        Changed in place; a second call changes nothing.
    kind : str
        The kind, such as "measured (simulated)"; an empty text leaves the figure as it is.

    Examples
    --------
    >>> import matplotlib.pyplot as plt
    >>> figure = plt.figure()
    >>> say_kind(figure, "measured (simulated)")
    >>> figure.get_supxlabel()
    'measured (simulated)'
    >>> plt.close(figure)
    """
    said = " ".join(text.get_text() for text in figure.findobj(mpl.text.Text))
    if kind and kind not in said and not all(word in said for word in re.findall(r"\w+", kind)):
        figure.set_figheight(figure.get_figheight() + NOTE_INCHES)  # the panels keep their height
        figure.supxlabel(kind, x=0.99, ha="right", fontsize=6, color="0.35")


def _letter(figure):
    """Write (a), (b), ... outside the upper left corner of each panel, if there are several."""
    shown = [ax for ax in figure.axes if ax.axison and ax.get_label() != "<colorbar>"]
    places = {tuple(ax.get_position().bounds): ax for ax in reversed(shown)}  # count twin axes once
    shown = [ax for ax in shown if ax in places.values()]
    if len(shown) < 2 or any(text.get_gid() == "letter" for text in shown[0].texts):
        return
    for letter, ax in zip("abcdefghijklmnopqrstuvwxyz", shown, strict=False):
        choices = {"textcoords": "offset points", "ha": "right", "va": "bottom", "gid": "letter"}
        ax.annotate(f"({letter})", (0, 1), (-3, 3), "axes fraction", **choices)


def with_symbols(text):
    """Return a text with symbols as formulas and names of parameters as words.

    Parameters
    ----------
    text : str
        A text with a formula stays as it is.

    Examples
    --------
    >>> with_symbols("f below d4")
    '$f$ below $d_4$'
    >>> with_symbols("noise_of_a_mean")
    'noise of a mean'
    """

    def set_one(found):
        letter, index, ratio = found.groups()
        if found[0] == "rho0":
            return r"$\rho_0$"
        symbol = f"{letter}_{index}" if index else ratio or r"\sigma_\mathrm{MAD}"
        return f"${symbol}$"

    def say_one(found):
        return re.sub(r"\\?_", " ", found[0])

    return text if "$" in text else JOINED.sub(say_one, SYMBOL.sub(set_one, text))
