"""Finish figures before they are shown or saved: panel letters, symbols, kind of numbers."""

import re

import matplotlib as mpl
import matplotlib.category

__all__ = ["finish_figure", "say_kind", "with_symbols"]

# Symbols as words of a text: d1, d2, ..., f, g, thresholds, s_r, rho0 and sigma_MAD.
SYMBOL = re.compile(r"(?<![\w$\\])(?:([dsf])_?([1-9]|r|0)|([fg])|sigma_(?:MAD|mad)|rho0)(?![\w$(])")

# The underscore between the words of a name.
JOINT = re.compile(r"(?<=[a-z0-9]{2})_(?=[a-z])")

# Formatters of axes whose ticks have names.
NAMING = mpl.ticker.FixedFormatter | mpl.ticker.FuncFormatter | mpl.category.StrCategoryFormatter

# Height of the line below the panels with its margins.
NOTE_INCHES = 0.18


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
    """

    def set_one(found):
        letter, index, ratio = found.groups()
        if found[0] == "rho0":
            return r"$\rho_0$"
        symbol = f"{letter}_{index}" if index else ratio or r"\sigma_\mathrm{MAD}"
        return f"${symbol}$"

    return text if "$" in text else JOINT.sub(" ", SYMBOL.sub(set_one, text))
