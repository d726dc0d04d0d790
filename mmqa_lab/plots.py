"""Journal figures in matplotlib: widths in millimetres, one style, colours for all readers.

Only code that draws figures needs this module. It does not change matplotlib's settings
permanently. Use ``with style():`` for some figures, or matplotlib's
``plt.style.use(plots.STYLE)`` for a whole notebook.
"""

import contextlib
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib as mpl
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

STYLE = {
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
    "svg.hashsalt": "mmqa_lab",
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "mathtext.fontset": "custom",  # the fonts of the text, also for publishers
    "mathtext.cal": "sans:italic",
    "font.size": 8.0,
    **dict.fromkeys(("axes.titlesize", "figure.labelsize", "figure.titlesize"), "medium"),
    **dict.fromkeys(("xtick.labelsize", "ytick.labelsize", "legend.fontsize"), 7.0),
    "legend.frameon": False,
    "lines.linewidth": 1.0,
    "axes.linewidth": 0.6,
    **dict.fromkeys(("axes.spines.top", "axes.spines.right"), False),
    "image.cmap": MAP,
    "figure.dpi": 150,
    "savefig.dpi": 300,
    "figure.constrained_layout.use": True,
    "axes.prop_cycle": cycler(color=[c for name, c in COLOURS.items() if name != "grey"])
    + cycler(linestyle=["-", "--", "-.", ":", (0, (6, 1, 1, 1, 1, 1)), (0, (2, 1)), (0, (1, 3))]),
}
"""The house style as matplotlib's settings. Fonts are embedded as TrueType (Type 42). Text in SVG
stays text. Equal runs give files with equal bytes."""

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
