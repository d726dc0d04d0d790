"""What every figure gets before it is shown or saved: panel letters, series told apart in grey.

Two series of one panel can be told apart without colour where their marks, dashes or hatches
differ, or where their luminances have a contrast of 2 or more (the formula of WCAG 2.1, as for
texts). And what a figure shows as a table, from which it can be drawn again.
"""

import itertools
import re
from dataclasses import dataclass

import matplotlib as mpl
import matplotlib.category
import numpy as np
import pandas as pd
from matplotlib.colors import to_hex, to_rgb
from matplotlib.container import BarContainer, ErrorbarContainer
from matplotlib.lines import Line2D
from matplotlib.markers import MarkerStyle

CONTRAST = 2.0

DASHES = ("-", "--", ":", "-.", (0, (6, 1.5, 1, 1.5, 1, 1.5)), (0, (2, 1)), (0, (1, 3)))
MARKERS = ("o", "s", "^", "D", "v", "X", "P", "<", ">", "*")
TRIANGLES = ("^", "v", "<", ">")
CAPS = ("_", "|")
"""Ends of error bars."""

HATCHES = ("", "////", "....", "xxxx", "----", "++++", "oooo")

SYMBOL = re.compile(r"(?<![\w$\\])(?:([dsf])_?([1-9]|r|0)|([fg])|sigma_(?:MAD|mad)|rho0)(?![\w$(])")
"""Spacings d1, d2, ..., ratios f and g, thresholds, s_r and sigma_MAD, as words of a text."""

JOINT = re.compile(r"(?<=[a-z0-9]{2})_(?=[a-z])")
"""What joins the words of a name."""

NAMING = mpl.ticker.FixedFormatter | mpl.ticker.FuncFormatter | mpl.category.StrCategoryFormatter
"""Formatters of axes whose places have names."""

NOTE_INCHES = 0.18
"""Height of the line below the panels, with its margins."""

LARGEST_IMAGE = 40_000
"""Pixels of a picture whose values are written with a figure's data: of a larger one every k-th."""


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
    looks = {}  # by name, so that a name looks the same in all panels
    for ax in figure.axes:
        told = []
        for one in series(ax):
            kind = type(one.artists[0]), one.name
            looks[kind] = _tell_apart(one, told, looks.get(kind) if one.name else None)
            told.append(one)
        _update_legends(figure, ax, told)
    _set_symbols(figure)


def say_kind(figure, kind):
    """Say in the lower right corner which kind of numbers a figure shows, unless its texts do.

    Parameters
    ----------
    figure : Figure
        Changed in place; twice is the same as once.
    kind : str
        Such as "measured (simulated)"; nothing is said without one.

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
        figure.set_figheight(figure.get_figheight() + NOTE_INCHES)  # the panels keep theirs
        figure.supxlabel(kind, x=0.99, ha="right", fontsize=6, color="0.35")


@dataclass
class Series:
    """What one name of a legend, or one colour, stands for: a line, dots, or filled areas."""

    name: str
    artists: list

    @property
    def colour(self):
        """Of what is drawn, as red, green, blue."""
        first = self.artists[0]
        if isinstance(first, Line2D):
            return to_rgb(first.get_color())
        return _paint(first)

    @property
    def look(self):
        """Dashes, mark and whether it is open; the outline of dots; the hatch of areas."""
        first = self.artists[0]
        if isinstance(first, Line2D):
            is_open = str(first.get_markerfacecolor()).lower() == "none"
            return str(_dashes(first)) if _is_drawn(first) else "", str(first.get_marker()), is_open
        if isinstance(first, mpl.collections.PathCollection):
            return first.get_paths()[0].vertices.tobytes()
        return first.get_hatch() or ""

    def alike(self, other):
        """Whether both look the same in grey, and are not meant to look the same."""
        if type(self.artists[0]) is not type(other.artists[0]) or self.look != other.look:
            return False
        dark, light = sorted(_luminance(one.colour) for one in (self, other))
        meant = self.colour == other.colour and "" in (self.name, other.name)
        return not meant and (light + 0.05) / (dark + 0.05) < CONTRAST

    def choices(self):
        """Settings that change the look, the most modest first."""
        first = self.artists[0]
        if isinstance(first, mpl.collections.PathCollection):
            shapes = (MarkerStyle(mark) for mark in MARKERS)
            return [{"paths": [one.get_path().transformed(one.get_transform())]} for one in shapes]
        if not isinstance(first, Line2D):
            return [{"hatch": hatch} for hatch in HATCHES]
        dashes = DASHES if _is_drawn(first) else (first.get_linestyle(),)
        own = first.get_marker()
        marks = TRIANGLES if own in TRIANGLES and not self.name else MARKERS
        chosen = itertools.product((own, *marks), dashes)
        return [{"linestyle": dash, "marker": mark} for mark, dash in chosen]


def series(ax):
    """The series of a panel: its lines, dots and areas; those without a name have the name ""."""
    bars = [one for one in ax.containers if isinstance(one, ErrorbarContainer | BarContainer)]
    names, found, caps = {}, [], set()
    for one in bars:
        parts = one.patches if isinstance(one, BarContainer) else one.lines[:1]
        caps |= set() if isinstance(one, BarContainer) else set(one.lines[1])
        if parts and parts[0] is not None:
            names |= {id(part): _name(one) for part in parts}
            found += [Series(_name(one), list(parts))] if isinstance(one, BarContainer) else []
    lines = [line for line in ax.lines if line not in caps]
    found += [Series(names.get(id(line), _name(line)), [line]) for line in lines]
    dots = [one for one in ax.collections if isinstance(one, mpl.collections.PathCollection)]
    found += [Series(_name(one), [one]) for one in dots if one.get_array() is None]
    kinds = mpl.patches.Patch | mpl.collections.PolyCollection
    areas = [one for one in (*ax.patches, *ax.collections) if isinstance(one, kinds)]
    areas = [one for one in areas if id(one) not in names and _name(one)]
    return found + [Series(_name(one), [one]) for one in areas]


def _name(artist):
    """The name that a legend could give."""
    label = str(artist.get_label())
    return "" if label.startswith("_") or label == "None" else label


def panels(figure):
    """The axes of a figure that are shown, without colour bars."""
    return [ax for ax in figure.axes if ax.axison and ax.get_label() != "<colorbar>"]


def _letter(figure):
    """(a), (b), ... outside the upper left corner of each panel, where there are several."""
    shown = panels(figure)
    places = {tuple(ax.get_position().bounds): ax for ax in reversed(shown)}  # twins count once
    shown = [ax for ax in shown if ax in places.values()]
    if len(shown) < 2 or any(text.get_gid() == "letter" for text in shown[0].texts):
        return
    for letter, ax in zip("abcdefghijklmnopqrstuvwxyz", shown, strict=False):
        choices = {"textcoords": "offset points", "ha": "right", "va": "bottom", "gid": "letter"}
        ax.annotate(f"({letter})", (0, 1), (-3, 3), "axes fraction", **choices)


def _tell_apart(one, told, usual):
    """Give a series the first look that none like it has; its usual look, if it has one, first."""
    if usual is None and not any(one.alike(other) for other in told):
        return None
    for choice in [*filter(None, [usual]), *one.choices()]:
        mpl.artist.setp(one.artists, **choice)
        if not any(one.alike(other) for other in told):
            return choice
    return None


def _update_legends(figure, ax, told):
    """Give the legends the looks of the series that they name."""
    named = {one.name: one.artists[0] for one in told if one.name}
    for legend in filter(None, [ax.get_legend(), *figure.legends]):
        columns = legend._legend_handle_box.get_children()
        rows = [row for column in columns for row in column.get_children()]
        for area, text in (row.get_children() for row in rows):
            drawn = named.get(text.get_text())
            handles = area.get_children()
            single = any(isinstance(one, Line2D) and len(one.get_xdata()) == 1 for one in handles)
            for handle in handles:
                _look_like(handle, drawn, apart=single)


def _look_like(handle, drawn, *, apart):
    """Give an artist of a legend the look of what it stands for.

    Error bars have their mark ``apart``: as one point, beside the line of two.
    """
    if isinstance(handle, Line2D) and isinstance(drawn, Line2D):
        if handle.get_marker() in CAPS and drawn.get_marker() not in CAPS:
            return
        handle.set_linestyle(_dashes(drawn))
        if not apart or len(handle.get_xdata()) == 1:
            handle.set_marker(drawn.get_marker())
    elif isinstance(handle, mpl.collections.PathCollection) and isinstance(drawn, type(handle)):
        handle.set_paths(drawn.get_paths())
    elif isinstance(handle, mpl.patches.Patch) and hasattr(drawn, "get_hatch"):
        handle.set_hatch(drawn.get_hatch())


def _dashes(line):
    """The dashes of a line as its ``set_linestyle`` takes them."""
    style, pattern = line.get_linestyle(), line._unscaled_dash_pattern
    return pattern if style == "--" and pattern[1] else style


def _set_symbols(figure):
    """Set symbols as formulas are set, in titles, labels, legends and names of places."""
    for text in figure.findobj(mpl.text.Text):
        if text.get_gid() != "letter":
            text.set_text(_with_symbols(text.get_text()))
    for axis in (axis for ax in figure.axes for axis in (ax.xaxis, ax.yaxis)):
        ticks, names = _ticks(axis)
        if any(SYMBOL.fullmatch(name) or "_" in name for name in names):
            axis.set_ticks(ticks, labels=[_with_symbols(name) for name in names])


def _ticks(axis):
    """Places with names on an axis, and the names; nothing where it has numbers."""
    form = axis.get_major_formatter()
    if not isinstance(form, NAMING):
        return [], []
    ticks = axis.get_majorticklocs()
    return ticks, [str(name) for name in form.format_ticks(ticks)]


def _with_symbols(text):
    """A text with its symbols in the form of formulas, and its names of parameters in words."""

    def set_one(found):
        letter, index, ratio = found.groups()
        if found[0] == "rho0":
            return r"$\rho_0$"
        symbol = f"{letter}_{index}" if index else ratio or r"\sigma_\mathrm{MAD}"
        return f"${symbol}$"

    return text if "$" in text else JOINT.sub(" ", SYMBOL.sub(set_one, text))


def _is_drawn(line):
    """Whether a line joins points."""
    return line.get_linestyle() != "None" and len(line.get_xdata()) > 1


def _paint(one):
    """The colour of an area or of dots on white: that of the edge where they are not filled."""
    colours = [*np.atleast_2d(one.get_facecolor()), *np.atleast_2d(one.get_edgecolor())]
    seen = (each for each in colours if len(each) and each[-1] > 0)
    *colour, alpha = next(seen, (0, 0, 0, 1))
    return tuple(1 - alpha * (1 - np.array(colour)))


def _luminance(colour):
    """The relative luminance of WCAG 2.1."""
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in colour]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def drawn(figure):
    """What a figure shows as a table, from which three lines draw it again.

    A row for each point of a panel's lines, dots, bars' ends and pictures, and of the outlines of
    areas; outlines and error bars are lines that NaN interrupts. ``mark`` is the format that
    ``plt.plot`` takes; ``x_name`` and ``y_name`` are the names of places that have one.
    """
    parts = [pd.DataFrame(columns=["panel", "artist", "series", "mark", "colour", "x", "y"])]
    for panel, ax in enumerate(panels(figure) or figure.axes, 1):
        words = {"title": ax.get_title(), "x_label": ax.get_xlabel(), "y_label": ax.get_ylabel()}
        for number, (name, mark, colour, points) in enumerate(_artists(ax), 1):
            known = {"panel": panel, "artist": number, "series": name or "_", "mark": mark}
            part = pd.DataFrame({**known, "colour": to_hex(colour), **points})
            for axis, place in ((ax.xaxis, "x"), (ax.yaxis, "y")):
                part[f"{place}_name"] = _place_names(axis, part[place])
            part.loc[part.index[:1], list(words)] = list(words.values())
            parts.append(part)
    return pd.concat([part for part in parts if len(part)] or parts, ignore_index=True)


def _artists(ax):
    """Name, mark, colour and points of all that a panel shows."""
    names = {id(part): one.name for one in series(ax) for part in one.artists}
    bars = [one for one in ax.containers if isinstance(one, BarContainer) and one.patches]
    for one in bars:
        boxes = [bar.get_bbox() for bar in one.patches]
        ends = [(box.x1, (box.y0 + box.y1) / 2) for box in boxes]
        if one.orientation != "horizontal":
            ends = [((box.x0 + box.x1) / 2, box.y1) for box in boxes]
        yield _name(one), "s", _paint(one.patches[0]), _columns(ends)
    in_bars = {id(bar) for one in bars for bar in one.patches}
    for line in ax.lines:
        dash = line.get_linestyle().replace("None", "") if _is_drawn(line) else ""
        mark = str(line.get_marker()).replace("None", "")
        xy = _in_data(ax, line.get_transform(), line.get_xydata())
        yield names.get(id(line), ""), f"{mark}{dash}" or ",", line.get_color(), _columns(xy)
    for one in (*ax.collections, *ax.images):
        yield from _of_collection(ax, one, names)
    for patch in ax.patches:
        if id(patch) not in in_bars:
            xy = ax.transData.inverted().transform(patch.get_verts())
            yield names.get(id(patch), ""), "-", _paint(patch), _columns(xy)


def _of_collection(ax, one, names):
    """Name, mark, colour and points of dots, of a picture, or of lines and outlines."""
    if isinstance(one, mpl.image.AxesImage | mpl.collections.QuadMesh):
        yield "", ",", "black", _of_picture(one)
        return
    name, value = names.get(id(one), _name(one)), one.get_array()
    colour = _paint(one)
    if isinstance(one, mpl.collections.PathCollection):
        xy = np.ma.filled(np.ma.asarray(one.get_offsets(), float), np.nan)
        yield name, "o", colour, _columns(xy) | ({} if value is None else {"value": value})
        return
    apart = [[np.nan, np.nan]]
    paths = [_in_data(ax, one.get_transform(), path.vertices) for path in one.get_paths()]
    outlines = [part for path in paths for part in (path, apart)]
    yield name, "-", colour, _columns(np.concatenate([np.empty((0, 2)), *outlines]))


def _of_picture(one):
    """Places and values of a picture with one value a pixel; of a large one every k-th."""
    value = np.ma.filled(np.ma.asarray(one.get_array(), float), np.nan)
    if value.ndim != 2:
        return _columns(np.empty((0, 2)))
    every = slice(None, None, int(np.ceil(np.sqrt(value.size / LARGEST_IMAGE))))
    if isinstance(one, mpl.collections.QuadMesh):
        corners = np.asarray(one.get_coordinates())
        middle = (corners[:-1, :-1] + corners[1:, 1:]) / 2
    else:
        left, right, bottom, top = one.get_extent()
        row, column = np.indices(value.shape) + 0.5
        x = left + (right - left) * column / value.shape[1]
        middle = np.stack([x, top + (bottom - top) * row / value.shape[0]], axis=-1)
    return _columns(middle[every, every].reshape(-1, 2)) | {"value": value[every, every].ravel()}


def _columns(xy):
    """Points as the columns of a table."""
    x, y = np.reshape(np.asarray(xy, dtype=float), (-1, 2)).T
    return {"x": x, "y": y}


def _in_data(ax, transform, xy):
    """Points in the coordinates of a panel's data."""
    if transform == ax.transData:
        return np.asarray(xy, dtype=float)
    return ax.transData.inverted().transform(transform.transform(np.asarray(xy, dtype=float)))


def _place_names(axis, places):
    """The names of places on an axis that has names instead of numbers."""
    ticks, names = _ticks(axis)
    if not len(ticks):
        return ""
    named = np.array([*names, ""], dtype=object)
    off = np.nan_to_num(np.abs(places.to_numpy()[:, None] - ticks), nan=np.inf)
    near = np.where(off.min(axis=1) < 0.5, off.argmin(axis=1), -1)
    return named[near]
