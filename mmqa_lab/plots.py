"""Journal figures in matplotlib: widths in millimetres, one style, colours all can tell apart.

Import it where figures are drawn: the rooms that compute never need it. Nothing here changes
matplotlib's settings for good: use ``with style():`` for some figures, or matplotlib's own
``plt.style.use(plots.STYLE)`` for a whole notebook.
"""

import contextlib
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from cycler import cycler
from matplotlib import font_manager
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_choice
from mmqa_lab.planes import flat_points
from mmqa_lab.spacing import Spacing

__all__ = [
    "Journal",
    "draw_points",
    "draw_residual_histogram",
    "draw_spacing_histogram",
    "style",
    "subplots",
]
__dir__ = __all__.copy

WIDTHS = ("single", "double")
"""One column, and the whole width of the page's text."""


@dataclass(frozen=True)
class Journal:
    """What a publisher asks of a figure.

    Parameters
    ----------
    widths_mm : tuple of 2 float
        Of one column and of the whole text, mm.
    fonts : tuple of str
        In the order of preference.
    lettering_pt : float
        Size of the letters, points.
    source : str
        Where the publisher says so.

    Examples
    --------
    >>> elsevier = JOURNALS["elsevier"]
    >>> elsevier.widths_mm[0], elsevier.fonts[0]
    (90.0, 'Arial')
    """

    widths_mm: tuple
    fonts: tuple
    lettering_pt: float
    source: str


JOURNALS = {
    "house": Journal((85.0, 178.0), ("DejaVu Sans",), 8.0, "this project's own choice"),
    "elsevier": Journal(
        (90.0, 190.0),
        ("Arial", "Helvetica"),
        7.0,
        "elsevier.com, artwork and media instructions: artwork sizing, artwork types",
    ),
    "ieee": Journal(
        (88.9, 182.0),
        ("Arial", "Helvetica"),
        8.0,
        "ieeeauthorcenter.ieee.org, size requirements for graphics; callouts of 8 points: "
        "IEEE guidelines for author supplied electronic text and graphics",
    ),
    "mdpi": Journal(
        (138.6, 184.6),
        ("Palatino", "Palatino Linotype"),
        8.0,
        "mdpi.cls of 12 September 2024: text from 58.7 mm to 12.7 mm within A4, fulllength",
    ),
    "isprs": Journal(
        (82.0, 170.0),
        ("Times New Roman", "Times"),
        8.0,
        "ISPRS guidelines for authors of the Archives and Annals: A4 with margins of 20 mm, two "
        "columns 6 mm apart, text of 9 points",
    ),
    "springer": Journal(
        (84.0, 174.0),
        ("Helvetica", "Arial"),
        8.0,
        "springer.com, artwork instructions: figures 39, 84, 129 or 174 mm wide, lettering of 8 "
        "to 12 points",
    ),
}
"""Widths, fonts and lettering by publisher; other publishers join with their source."""

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
"""Okabe and Ito's palette (jfly.uni-koeln.de/color), and a grey."""

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
    "ps.fonttype": 42,
    "svg.fonttype": "none",
    "svg.hashsalt": "mmqa_lab",
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 8.0,
    "axes.labelsize": 8.0,
    "axes.titlesize": 8.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 7.0,
    "legend.frameon": False,
    "lines.linewidth": 1.0,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "image.cmap": MAP,
    "figure.dpi": 150,
    "savefig.dpi": 300,
    "figure.constrained_layout.use": True,
    "axes.prop_cycle": cycler(color=[c for name, c in COLOURS.items() if name != "grey"]),
}
"""The house style as matplotlib's settings: fonts embedded as TrueType (Type 42), text in SVG stays
text, and files are equal to the byte from run to run."""

_in_use = {"single": 85.0, "double": 178.0, "default": 85.0}


@contextlib.contextmanager
def style(journal: str = "house", *, width: str = "single") -> Iterator[Journal]:
    """Draw figures as a publisher asks, for the lines of a ``with`` or, above it, of a function.

    Widths, fonts and lettering are those of ``JOURNALS``; matplotlib's settings are as they were
    afterwards. Save the figure within it, too. A font that is not installed is replaced by DejaVu
    Sans, with a warning.

    Parameters
    ----------
    journal : {"house", "elsevier", "ieee", "mdpi", "isprs", "springer"}
        Columns and whole text are 85 and 178 mm wide (our own choice), 90 and 190 mm (Elsevier,
        artwork sizing), 88.9 and 182 mm (IEEE, size requirements for graphics), 138.6 and 184.6 mm
        (MDPI, its LaTeX class of 2024), 82 and 170 mm (ISPRS, guidelines for authors), 84 and
        174 mm (Springer, artwork instructions).
    width : {"single", "double"}
        Of figures that do not say their own.

    Yields
    ------
    Journal

    Raises
    ------
    ValueError
        If the width or the journal is not known.

    Examples
    --------
    >>> with warnings.catch_warnings(action="ignore"), style("elsevier", width="double"):
    ...     figure, ax = subplots()
    >>> round(figure.get_size_inches()[0] * 25.4)
    190
    >>> plt.close(figure)
    """
    chosen = JOURNALS[check_choice(journal, "journal", tuple(JOURNALS))]
    check_choice(width, "width", WIDTHS)
    widths = dict(zip(WIDTHS, chosen.widths_mm, strict=True))
    before = dict(_in_use)
    with mpl.rc_context(STYLE | _lettering(chosen)):
        _in_use.update(widths, default=widths[width])
        try:
            yield chosen
        finally:
            _in_use.update(before)


def _lettering(journal):
    """Settings for the letters that a publisher asks for."""
    installed = {font.name for font in font_manager.fontManager.ttflist}
    if not installed & set(journal.fonts):
        asked = " and ".join(journal.fonts)
        warnings.warn(f"Fonts not installed: {asked}. DejaVu Sans is used instead.", stacklevel=4)
    size = journal.lettering_pt
    small = dict.fromkeys(("xtick.labelsize", "ytick.labelsize", "legend.fontsize"), min(size, 7))
    large = dict.fromkeys(("font.size", "axes.labelsize", "axes.titlesize"), size)
    return {"font.sans-serif": [*journal.fonts, "DejaVu Sans"], **large, **small}


def subplots(
    rows: int = 1,
    columns: int = 1,
    *,
    width: str = "default",
    height_mm: float = 60.0,
    **choices: Any,
) -> tuple[plt.Figure, plt.Axes | np.ndarray]:
    """Return a figure of a journal's width and its axes.

    Parameters
    ----------
    rows, columns : int
    width : {"default", "single", "double"}
        Of the journal that :func:`style` was given; "default" is the width given there.
    height_mm : float
    **choices
        Handed to ``matplotlib.pyplot.subplots``.

    Returns
    -------
    figure, axes
        As ``matplotlib.pyplot.subplots`` returns them.

    Raises
    ------
    ValueError
        If the width is none of these.

    Examples
    --------
    >>> figure, ax = subplots(width="single", height_mm=50)
    >>> round(figure.get_size_inches()[0] * 25.4)
    85
    >>> plt.close(figure)
    """
    check_choice(width, "width", ("default", *WIDTHS))
    size = (_in_use[width] / 25.4, height_mm / 25.4)
    return plt.subplots(rows, columns, figsize=size, **choices)


def draw_points(
    xy: ArrayLike,
    *,
    ax: plt.Axes,
    values: ArrayLike | None = None,
    label: str = "",
    limits: tuple[float, float] | None = None,
    cmap: str = MAP,
) -> plt.Axes:
    """Draw points in a plane, in mm-true proportion, coloured by a value.

    Parameters
    ----------
    xy : array, shape (n, 2)
        Metres.
    ax : Axes
    values : array, shape (n,), optional
        Colours the points.
    label : str
        Names the value with its unit on the colour bar.
    limits : pair of float, optional
        Range of the colours.
    cmap : str
        Map of the colours, in matplotlib.

    Returns
    -------
    Axes

    Examples
    --------
    >>> figure, ax = subplots()
    >>> draw_points([[0, 0], [1, 0]], ax=ax).get_xlabel()
    'along axis 1 (m)'
    >>> plt.close(figure)
    """
    xy = flat_points(xy)
    size = np.clip(4000 / max(len(xy), 1), 0.3, 6.0)
    x, y = xy.T
    if values is None:
        ax.scatter(x, y, s=size, color=COLOURS["blue"], lw=0, rasterized=True)
    else:
        low, high = limits if limits is not None else (None, None)
        shades = {"c": values, "vmin": low, "vmax": high, "cmap": cmap}
        dots = ax.scatter(x, y, s=size, lw=0, rasterized=True, **shades)
        ax.figure.colorbar(dots, ax=ax, label=label, shrink=0.85)
    ax.set(xlabel="along axis 1 (m)", ylabel="along axis 2 (m)", aspect="equal")
    return ax


def draw_residual_histogram(
    residuals_mm: ArrayLike, *, ax: plt.Axes, std_mm: float, sigma_mad_mm: float
) -> plt.Axes:
    """Draw the distances from the plane with the two measures of their dispersion.

    Parameters
    ----------
    residuals_mm : array, shape (n,)
        Signed distances from the plane, mm.
    ax : Axes
    std_mm, sigma_mad_mm : float
        Drawn to either side of zero, mm.

    Returns
    -------
    Axes

    Examples
    --------
    >>> figure, ax = subplots()
    >>> ax = draw_residual_histogram([-1.0, 0.0, 1.0], ax=ax, std_mm=1.0, sigma_mad_mm=1.5)
    >>> ax.get_legend().get_texts()[0].get_text()
    '±std = 1.0 mm'
    >>> plt.close(figure)
    """
    half = max(4 * sigma_mad_mm, 0.5)
    ax.hist(
        np.clip(residuals_mm, -half, half), bins=61, color=COLOURS["sky"], histtype="stepfilled"
    )
    for value, name, colour, dash in (
        (std_mm, "std", "vermilion", "-"),
        (sigma_mad_mm, r"$\sigma_\mathrm{MAD}$", "black", "--"),
    ):
        label = f"±{name} = {value:.1f} mm"
        ax.axvline(-value, color=COLOURS[colour], ls=dash)
        ax.axvline(value, color=COLOURS[colour], ls=dash, label=label)
    ax.set(xlabel="distance from plane (mm)", ylabel="points", xlim=(-half, half))
    ax.legend(loc="upper left", bbox_to_anchor=(0, 1.32), borderaxespad=0)
    return ax


def draw_spacing_histogram(spacing: Spacing, *, ax: plt.Axes) -> plt.Axes:
    """Draw the nearest and the farthest quadrant distance of each point, and their medians.

    Parameters
    ----------
    spacing : Spacing
        Of :func:`mmqa_lab.spacing.quadrants`.
    ax : Axes

    Returns
    -------
    Axes

    Examples
    --------
    >>> figure, ax = subplots()
    >>> from mmqa_lab.spacing import quadrants
    >>> lattice = np.mgrid[0:9, 0:9].reshape(2, -1).T * [0.02, 0.04]
    >>> ax = draw_spacing_histogram(quadrants(lattice), ax=ax)
    >>> [text.get_text() for text in ax.get_legend().get_texts()]
    ['median d1 = 20.0 mm', 'median d4 = 40.0 mm']
    >>> plt.close(figure)
    """
    nearest, farthest = 1000 * spacing.distances[:, [0, -1]].T
    top = np.nanpercentile(farthest, 98) if np.isfinite(farthest).any() else np.nanmax(nearest)
    bins = np.linspace(0, 1.1 * top, 56)
    for values, name, median, colour in (
        (nearest, "d1", 1000 * spacing.d[0], "blue"),
        (farthest, f"d{len(spacing.d)}", 1000 * spacing.d[-1], "orange"),
    ):
        filled = {"color": COLOURS[colour], "alpha": 0.6, "histtype": "stepfilled"}
        ax.hist(values[np.isfinite(values)], bins=bins, **filled)
        measure = "median" if spacing.statistic == 50 else f"{spacing.statistic:g} % quantile"
        label = f"{measure} {name} = {median:.1f} mm"
        ax.axvline(median, color=COLOURS[colour], label=label)
    ax.set(xlabel="distance to the next point (mm)", ylabel="points", xlim=(0, bins[-1]))
    ax.legend(loc="upper left", bbox_to_anchor=(0, 1.32), borderaxespad=0)
    return ax
