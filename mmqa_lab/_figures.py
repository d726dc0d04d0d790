"""What every figure gets before it is shown or saved: panel letters, series told apart in grey.

Two series of one panel can be told apart without colour where their marks or dashes differ, or
where their luminances have a contrast of 2 or more (the formula of WCAG 2.1, as for texts).
"""

import itertools

from matplotlib.colors import to_rgb
from matplotlib.lines import Line2D

CONTRAST = 2.0

DASHES = ("-", "--", ":", "-.", (0, (6, 1.5, 1, 1.5, 1, 1.5)), (0, (2, 1)), (0, (1, 3)))
MARKERS = ("o", "s", "^", "D", "v", "X", "P", "<", ">", "*")


def finish_figure(figure):
    """Letter the panels of a figure and tell its series apart; twice is the same as once.

    Parameters
    ----------
    figure : Figure
        Changed in place.

    Examples
    --------
    >>> import matplotlib.pyplot as plt
    >>> figure, axes = plt.subplots(1, 2)
    >>> lines = axes[0].plot([0, 1], [[1, 2], [2, 3]], color="blue", label=["a", "b"])
    >>> finish_figure(figure)
    >>> [line.get_linestyle() for line in lines], [ax.texts[0].get_text() for ax in axes]
    (['-', '--'], ['(a)', '(b)'])
    >>> plt.close(figure)
    """
    _letter(figure)
    for ax in figure.axes:
        told = []
        for line in _series(ax):
            _tell_apart(line, told)
            told.append(line)
        _update_legends(figure, ax, told)


def alike(line, other):
    """Whether two lines look the same in grey."""
    return _look(line) == _look(other) and _contrast(line, other) < CONTRAST


def _letter(figure):
    """(a), (b), ... outside the upper left corner of each panel, where there are several."""
    panels = [ax for ax in figure.axes if ax.axison and ax.get_label() != "<colorbar>"]
    places = {tuple(ax.get_position().bounds): ax for ax in reversed(panels)}  # twins count once
    panels = [ax for ax in panels if ax in places.values()]
    if len(panels) < 2 or any(text.get_gid() == "letter" for text in panels[0].texts):
        return
    for letter, ax in zip("abcdefghijklmnopqrstuvwxyz", panels, strict=False):
        choices = {"textcoords": "offset points", "ha": "right", "va": "bottom", "gid": "letter"}
        ax.annotate(f"({letter})", (0, 1), (-3, 3), "axes fraction", **choices)


def _series(ax):
    """The lines of a panel that a legend could name."""
    return [line for line in ax.lines if not str(line.get_label()).startswith("_")]


def _tell_apart(line, told):
    """Give a line the first dashes, then the first marks, that none like it has."""
    if not any(alike(line, other) for other in told):
        return
    drawn, marked = line.get_linestyle() != "None", line.get_marker() not in ("None", "", None)
    dashes = DASHES if drawn else (line.get_linestyle(),)
    markers = (line.get_marker(), *(MARKERS if marked or drawn else ()))
    for marker, dash in itertools.product(markers, dashes):
        line.set(linestyle=dash, marker=marker)
        if not any(alike(line, other) for other in told):
            return


def _update_legends(figure, ax, lines):
    """Give the legends the looks of the lines that they name."""
    looks = {str(line.get_label()): line for line in lines}
    for legend in filter(None, [ax.get_legend(), *figure.legends]):
        for handle, text in zip(legend.legend_handles, legend.get_texts(), strict=True):
            line = looks.get(text.get_text())
            if line is not None and isinstance(handle, Line2D):
                handle.set(marker=line.get_marker(), linestyle=_dashes(line))


def _look(line):
    """Dashes and mark of a line, and whether its mark is open."""
    is_open = str(line.get_markerfacecolor()).lower() == "none"
    return str(_dashes(line)), str(line.get_marker()), is_open


def _dashes(line):
    """The dashes of a line as its ``set_linestyle`` takes them."""
    style, pattern = line.get_linestyle(), line._unscaled_dash_pattern
    return pattern if style == "--" and pattern[1] else style


def _contrast(line, other):
    """The contrast of two colours, 1 to 21."""
    dark, light = sorted(_luminance(one.get_color()) for one in (line, other))
    return (light + 0.05) / (dark + 0.05)


def _luminance(colour):
    """The relative luminance of WCAG 2.1."""
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(colour)]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
