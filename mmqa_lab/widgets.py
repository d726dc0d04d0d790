"""Controls for notebooks: explorers of figures, the selection of a surface, the jury's form.

Without a screen (``MMQA_HEADLESS``) every control is replaced by a picture of its first state.
"""

from __future__ import annotations

import contextlib
import os
import threading
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

import ipywidgets
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import shapely
from IPython.display import HTML, Image, Javascript, display
from matplotlib.colors import to_rgba_array
from matplotlib.figure import Figure
from matplotlib.layout_engine import PlaceHolderLayoutEngine
from matplotlib.widgets import PolygonSelector
from numpy.typing import ArrayLike
from scipy import ndimage

from mmqa_lab import plots
from mmqa_lab._checks import check_choice, check_points, check_polygon
from mmqa_lab.chart_cloud import evaluate_cloud, inside_polygon
from mmqa_lab.chart_image.rules import MARKS, check_marks
from mmqa_lab.charts import encode
from mmqa_lab.io import write_atomically
from mmqa_lab.plane_search import detect_planes
from mmqa_lab.planes import fit_plane
from mmqa_lab.spacing import quadrant_distances
from mmqa_lab.views import is_headless

__all__ = ["Halt", "JuryForm", "SelectionTool", "SurfaceTool", "choice", "explore", "slider"]
__dir__ = __all__.copy

MEANINGS = {"a": "a: every letter", "b": "b: the text", "c": "c: not legible"}

# Largest width and zoom of a crop on the screen. The zoom is a whole number, so no pixel is
# interpolated.
WIDEST_PX, LARGEST_ZOOM = 800, 12

# Margins of the tool's figure, as shares of it, and between its panels, as shares of a panel.
MARGINS = {"left": 0.08, "right": 0.98, "bottom": 0.09, "top": 0.9, "wspace": 0.25, "hspace": 1}

# Most points drawn, and most planes listed, those with the most points first: of at least this
# share of the points of the largest. All are used.
SHOWN, LISTED, LISTED_SHARE = 10_000, 12, 0.01

# A cross-section shows this share of the selected points, on either side of its middle.
SECTION = 0.05

# A plane longer than so many times its width is shown through a window of this ratio, of at least
# so large a share of the plane.
WINDOW, LEAST_WINDOW = 2.5, 0.05

# Largest distance of a click from a point of the plane that it chooses, pixels.
NEAR_PX = 10

# Colours of the other planes in the picture and in the list.
TINTS = ("#56B4E9", "#009E73", "#E69F00", "#CC79A7", "#F0E442", "#999999")

# Colour of places that would not show a detail.
MISSED = "#F7C9A8"

WIDE = {"width": "24em"}

AXES = ("easting", "northing", "height")

# Gives controls and pictures names for screen readers.
SPOKEN = Path(__file__).with_suffix(".js")

LOCK = threading.RLock()


class Halt(ValueError):
    """A sentence that ends a notebook's run; a notebook shows no traceback with it.

    Examples
    --------
    >>> Halt("Invalid cloud bush. Must have a plane.")._render_traceback_()
    ['Invalid cloud bush. Must have a plane.']
    """

    def _render_traceback_(self):
        return [str(self)]


@contextlib.contextmanager
def _in_turn():
    """Let changes and drawings take turns: JupyterLab handles each widget in its own thread."""
    with LOCK:
        yield


def explore(
    function: Callable[..., Figure], **controls: ipywidgets.Widget
) -> ipywidgets.VBox | Figure:
    """Draw a figure again whenever a control moves.

    Parameters
    ----------
    function : callable
        Takes the values of the controls by name and returns a matplotlib figure.
    **controls
        Controls of ipywidgets, such as :func:`slider` and :func:`choice` return.

    Returns
    -------
    ipywidgets.VBox or matplotlib.figure.Figure
        The controls with the figure below them; without a screen, the figure alone.

    Examples
    --------
    >>> from unittest.mock import patch
    >>> def draw(speed):
    ...     figure, ax = plt.subplots()
    ...     ax.plot([0, speed])
    ...     return figure
    >>> with patch.dict("os.environ", MMQA_HEADLESS="1"):
    ...     figure = explore(draw, speed=slider("speed", 10, 1, 20, 1, unit="m/s"))
    >>> figure.axes[0].lines[0].get_ydata().tolist()
    [0, 10]
    >>> plt.close(figure)
    """

    def drawn(**values):
        """The figure for values of the controls."""
        figure = function(**values)
        plots.finish_figure(figure)
        plt.close(figure)  # the cell shows it; pyplot would show it again
        return figure

    if is_headless():
        return drawn(**{name: control.value for name, control in controls.items()})
    display(Javascript(filename=SPOKEN))
    output = ipywidgets.interactive_output(lambda **values: display(drawn(**values)), controls)
    return ipywidgets.VBox([*controls.values(), output])


def slider(
    name: str, value: float, low: float, high: float, step: float, *, unit: str = ""
) -> ipywidgets.IntSlider | ipywidgets.FloatSlider:
    """Return a slider with the unit in its label; it reports its value on release.

    Parameters
    ----------
    name : str
        Label of the slider.
    value, low, high, step : float or int
        First value, ends and step. An int as step gives whole numbers.
    unit : str
        Unit of the values.

    Returns
    -------
    ipywidgets.IntSlider or ipywidgets.FloatSlider

    Examples
    --------
    >>> speed = slider("speed", 40.0, 10.0, 80.0, 5.0, unit="km/h")
    >>> speed.description, speed.value
    ('speed (km/h)', 40.0)
    """
    kind = ipywidgets.IntSlider if isinstance(step, int) else ipywidgets.FloatSlider
    limits = {"value": value, "min": low, "max": high, "step": step}
    return kind(**limits, continuous_update=False, **_look(f"{name} ({unit})" if unit else name))


def _look(label):
    """A label and its width, and the width of the control."""
    style, layout = {"description_width": "14em"}, {"width": "34em"}
    return {"description": label, "style": style, "layout": layout}


def choice(name: str, options: Sequence[str]) -> ipywidgets.Dropdown:
    """Return a drop-down list that starts with the first option.

    Parameters
    ----------
    name : str
        Label of the list.
    options : sequence of str
        Texts to choose from.

    Returns
    -------
    ipywidgets.Dropdown

    Examples
    --------
    >>> choice("pattern", ["lattice", "poisson"]).value
    'lattice'
    """
    return ipywidgets.Dropdown(options=options, **_look(name))


class SelectionTool:
    """A polygon with draggable vertices on a surface, and the quality of the selected points.

    The view is at right angles to the plane of the surface. Upright surfaces are shown upright.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        The points of a surface and its surroundings, m.
    polygon : array_like, shape (m, 3), optional
        The first polygon, m; by default the largest rectangle without gaps, see
        :func:`largest_rectangle`. A long surface is shown through a window that a slider moves;
        the first polygon lies in it.
    detail : float, optional
        Mark the places that would not show a detail of this size, m, by three points.
    **choices
        Arguments of :func:`mmqa_lab.chart_cloud.evaluate_cloud`, such as thickness and axes.

    Attributes
    ----------
    vertices : array, shape (m, 3)
        The current polygon, m.
    frame : Plane
        The plane along whose axes, and from whose centre, the picture is drawn.
    quality : CloudQuality or None
        The quality of the selected points; None if they cannot be evaluated.

    Raises
    ------
    ValueError
        If there are fewer than three points.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(20) * 0.02, np.arange(10) * 0.04)
    >>> tool = SelectionTool(np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1))
    >>> round(tool.quality.f, 2)
    2.0
    """

    def __init__(
        self,
        points: ArrayLike,
        *,
        polygon: ArrayLike | None = None,
        detail: float | None = None,
        **choices: Any,
    ):
        self.choices, self.quality, self._followers = choices, None, []
        self._detail, self._written = detail, ""
        self.text = ipywidgets.HTML()
        self.figure = Figure(
            figsize=(8.4, 5.6), dpi=100, layout=PlaceHolderLayoutEngine(True, True)
        )
        ratios = {"width_ratios": (1.8, 1), "height_ratios": (1, 1, 0.7)}
        axes = self.figure.subplot_mosaic("ab;ac;dd", **ratios, gridspec_kw=MARGINS)
        self._map, *self._panels = axes.values()
        self._map.set(xlabel="along axis 1 (m)", ylabel="along axis 2 (m)", aspect="equal")
        self._strip = self._map.axhspan(0, 0, color=plots.COLOURS["grey"], alpha=0.3)
        self._dots = self._map.scatter([], [], s=3, lw=0, c=[], cmap=plots.DIVERGING_MAP)
        self.figure.colorbar(self._dots, ax=self._map, label="distance from plane (mm)", pad=0.03)
        look = {"ms": 4, "mew": 0, "color": MISSED, "zorder": 0.5}  # below the points
        (self._missed,) = self._map.plot([], [], ".", **look)
        self.canvas = _canvas(self.figure)
        self._corners = ipywidgets.Text(continuous_update=False, **_look("corners: x, y; ... (m)"))
        self._undo = ipywidgets.Button(description="Undo: the polygon before", layout=WIDE)
        self._cut = slider("cross-section at", 0.5, 0.0, 1.0, 0.05)
        self._place = slider("window at", 0.5, 0.0, 1.0, 0.05)
        self._corners.observe(lambda change: self._type(change["new"]), names="value")
        self._undo.on_click(lambda _: self.undo())
        self._cut.observe(lambda _: self.quality and self._draw_section(), names="value")
        self._place.observe(lambda change: self._slide(change["new"]), names="value")
        look = {"color": plots.COLOURS["green"], "linewidth": 2}
        self._selector = PolygonSelector(self._map, self._moved, props=look)
        self.show(points, polygon)

    def show(self, points: ArrayLike, polygon: ArrayLike | None = None) -> None:
        """Show other points, shape (n, 3), m, and a polygon, shape (m, 3), m."""
        self.points = check_points(points, minimum=3)
        self._drawn = self.points[:: 1 + len(self.points) // SHOWN]
        plane = fit_plane(self._drawn, robust=True)
        if abs(plane.normal[2]) < np.cos(np.radians(45)):
            plane = replace(plane, axes=plane.horizontal_axes())
        self.frame = plane
        self._dots.set_offsets(plane.project(self._drawn))
        self._xy, self._past = plane.project(self.points), []
        extent = np.ptp(self._xy, axis=0)
        self._along, length = extent.argmax(), extent.max()
        window = min(length, max(WINDOW * extent.min(), LEAST_WINDOW * length))
        self._reach = 0.5 * window
        self._place.layout.display = None if window < length else "none"
        self._look(self._xy[:, self._along])
        self._slide(self._place.value) if polygon is None else self.select(polygon)

    def select(self, polygon: ArrayLike) -> None:
        """Move the polygon, shape (m, 3), m, and evaluate the selected points."""
        xy = self.frame.project(check_polygon(polygon))
        if 2 * self._reach < np.ptp(self._xy[:, self._along]):
            self._look(xy[:, self._along])
        self._selector.verts = xy.tolist()
        self._moved(self._selector.verts)

    @_in_turn()
    def undo(self) -> None:
        """Return to the polygon before the last change on this plane."""
        if len(self._past) > 1:
            self._past.pop()
            self.select(self._past.pop())

    def selected(self) -> np.ndarray:
        """Return the mask of the selected points, shape (n,)."""
        thickness = self.choices.get("thickness", 0.1)
        return inside_polygon(self.points, self.vertices, thickness=thickness)

    @_in_turn()
    def _type(self, text):
        """Move the polygon to typed corners; a text that is none becomes a sentence."""
        if text == self._written:
            return
        try:
            pairs = [pair.split(",") for pair in text.strip("; ").split(";")]
            self.select(self._to_space(np.array(pairs, dtype=float)))
        except ValueError:
            wanted = "Must be x, y; x, y; x, y; ... in metres, at least three."
            self.text.value = f"<b>Invalid corners {escape(text)}. {wanted}</b>"

    @_in_turn()
    def _slide(self, share):
        """Move the window to a share of a long plane and draw the first polygon in it."""
        along = self._xy[:, self._along]
        ends = along.min() + self._reach, along.max() - self._reach
        off = np.abs(along - np.interp(share, (0, 1), ends))
        here = self._xy[off <= max(self._reach * (1 + 1e-9), np.partition(off, 2)[2])]
        self.select(self._to_space(largest_rectangle(here)))

    def _look(self, along):
        """Show the window around places along the plane, or all of it if it is short."""
        limits = np.column_stack([self._xy.min(axis=0), self._xy.max(axis=0)])
        if np.ptp(along) < np.ptp(limits[self._along]):
            centre = (along.min() + along.max()) / 2
            limits[self._along] = centre + max(self._reach, np.ptp(along) / 2) * np.array([-1, 1])
        limits += 0.05 * np.ptp(limits, axis=1).max() * np.array([-1, 1])
        self._map.set(xlim=limits[0], ylim=limits[1])
        _forget_zoom(self.figure)

    def follow(self, function: Callable | None = None, *, button: str = "") -> Callable:
        """Call a function with this tool now and after every change of the selection.

        It can be used as a decorator. The tool shows the output of the function. With ``button``,
        the text of a button, a change clears the output, and the function is called again only when
        the button is pressed.
        """
        if function is None:
            return lambda decorated: self.follow(decorated, button=button)
        if is_headless():
            function(self)
            return function
        output = ipywidgets.Output()

        @_in_turn()
        def again(_=None):
            """Replace the output shown."""
            with output:
                output.clear_output(wait=True)
                display(HTML(self.text.value)) if self.quality is None else function(self)

        again()
        self._followers.append(output.clear_output if button else again)
        pressed = ipywidgets.Button(description=button, layout=WIDE)
        pressed.on_click(again)
        display(ipywidgets.VBox([pressed, output]) if button else output)
        return function

    def _ipython_display_(self):
        """Show the tool; without a screen, its pictures."""
        if is_headless():
            display(*self._pictures(), HTML(self.text.value))
        else:
            display(Javascript(filename=SPOKEN))
            controls = [self._corners, self._undo, self._cut, self._place]
            display(ipywidgets.VBox([*self._pictures(), self.text, *controls]))

    def _pictures(self):
        """What is shown above the line of text."""
        return [self.canvas]

    def _summary(self):
        """The main figures in one line."""
        density, sigma = self.quality.density_polygon_per_m2, self.quality.sigma_mad_mm
        figures = f"{density:.0f} points/m², sigma_MAD {sigma:.2f} mm, f {self.quality.f:.2f}"
        return f"{self.quality.n} points, {figures}{self._details()}"

    def _details(self):
        """Mark the places that would not show a detail; what is said of them."""
        if self._detail is None:
            return ""
        share, missed = self.quality.details(self._detail)
        plane, what = self.quality.plane, f"a detail of {1000 * self._detail:g} mm"
        self._missed.set_data(self.frame.project(plane.centre + missed @ plane.axes).T)
        if np.isnan(share):
            return f"; {what} does not fit into the polygon"
        return f"; {100 * share:.1f} % of its places would show {what}, the orange ones would not"

    @_in_turn()
    def _draw_section(self):
        """Mark a strip along the selection, and draw the profile of its points."""
        inside, share = self.selected(), self._cut.value
        x, y = self._xy[inside].T
        ends = np.quantile(y, np.clip([share - SECTION, share + SECTION], 0, 1))
        self._strip.set(y=ends[0], height=np.ptp(ends))
        cut, strip = self._panels[2], (y >= ends[0]) & (y <= ends[1])
        off_mm = 1000 * self.quality.plane.distances(self.points[inside][strip])
        cut.clear()
        cut.plot(x[strip], off_mm, ".", ms=2, color=plots.COLOURS["blue"])
        cut.set(xlabel="along axis 1, in the strip (m)", ylabel="from plane (mm)")
        self.figure.canvas.draw_idle()

    def _to_space(self, xy):
        """Coordinates in space of points in the picture, shape (n, 3), m."""
        return self.frame.centre + np.asarray(xy) @ self.frame.axes

    @_in_turn()
    def _moved(self, vertices):
        """Evaluate and draw the selection again after a change of the polygon."""
        self.vertices = self._to_space(vertices)
        if not self._past or not np.array_equal(self._past[-1], self.vertices):
            self._past.append(self.vertices)
        self._written = "; ".join(f"{x:.3f}, {y:.3f}" for x, y in vertices)
        self._corners.value = self._written
        self._missed.set_data([], [])
        for panel in self._panels:
            panel.clear()
        try:
            self.quality = evaluate_cloud(self.points, polygon=self.vertices, **self.choices)
            self.text.value = f"<b>{'<br>'.join([self._summary(), *self.quality.remarks])}</b>"
            self.quality.draw_histograms(*self._panels[:2])
            off_mm = 1000 * self.quality.plane.distances(self._drawn)
            self._dots.set(array=off_mm, clim=np.multiply([-3, 3], self.quality.sigma_mad_mm))
            self._draw_section()
        except ValueError as error:
            self.quality, self.text.value = None, f"<b>{error}</b>"
        self.figure.canvas.draw_idle()
        for again in self._followers:
            again()


def _planes_of(points, tolerance, size):
    """The planes of a cloud, of a size doubled until the cloud is dense enough and has some."""
    largest = max(size, np.ptp(points, axis=0).max())
    while size <= largest:
        with contextlib.suppress(UserWarning), warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)  # too thin for this size
            if found := detect_planes(points, tolerance=tolerance, size=size):
                return found
        size *= 2
    return []


class SurfaceTool(SelectionTool):
    """A list of planes in clouds beside a picture, and the selection tool for the chosen plane.

    Parameters
    ----------
    clouds : dict of str to Cloud or array_like, shape (n, 3)
        Points by name of the cloud, m.
    tolerance, size : float
        See :func:`mmqa_lab.plane_search.detect_planes`, m.
    **choices
        See :class:`SelectionTool`.

    Attributes
    ----------
    name : str
        Name of the chosen cloud.
    patch : PlanePart
        The chosen plane.
    planes : DataFrame
        ``cloud``, ``plane``, ``points``, ``area_m2``, ``slope_deg``, ``std_mm``, ``easting_m``,
        ``northing_m``, ``height_m`` of all planes.
    missing : list of str
        A sentence for each cloud without planes; it is left out of the list.

    Raises
    ------
    Halt
        If no cloud has a plane of that size or larger.

    Examples
    --------
    >>> flat = np.random.default_rng(0).uniform(0, 5, (1500, 3))
    >>> tool = SurfaceTool({"corner": np.concatenate([flat * [1, 1, 0], flat * [1, 0, 1]])}, size=2)
    >>> tool.planes["area_m2"].round().tolist(), tool.name
    ([25.0, 25.0], 'corner')
    """

    def __init__(
        self, clouds: Mapping, *, tolerance: float = 0.1, size: float = 0.5, **choices: Any
    ):
        self._points = {name: check_points(cloud) for name, cloud in clouds.items()}
        self._patches, self.missing, rows = {}, [], []
        for name, points in self._points.items():
            patches = self._patches[name] = _planes_of(points, tolerance, size)
            if not patches:
                self.missing.append(f"{name}: no plane of {size:g} m or more.")
            for number, patch in enumerate(patches):
                rows.append({"cloud": name, "plane": number, **_described(patch, points)})
        listed = [name for name, patches in self._patches.items() if patches]
        if not listed:
            named = ", ".join(self._points)
            raise Halt(f"Invalid cloud {named}: no plane of {size:g} m or more. Must have one.")
        self.planes = pd.DataFrame(rows)
        self._scene = Figure(figsize=(5.6, 4.4), dpi=100, layout="constrained")
        self._scene.get_layout_engine().set(rect=(0, 0, 0.93, 1))  # buttons are to the right
        self._scene_canvas = _canvas(self._scene)
        self._scene.canvas.mpl_connect("button_press_event", self._clicked)
        look = {"layout": {"width": "30em"}, "style": {"description_width": "4em"}}
        self._clouds = ipywidgets.Dropdown(options=listed, description="cloud", **look)
        self._clouds.observe(lambda change: self.choose(change["new"]), names="value")
        self._list = ipywidgets.Select(description="plane", rows=LISTED, **look)
        self._list.observe(lambda change: self._listed(change["new"]), names="value")
        self.name, first = None, listed[0]
        self._enter(first, 0)
        super().__init__(self.surface(first), **choices)

    @_in_turn()
    def choose(self, cloud: str, plane: int = 0) -> None:
        """Choose a plane by the name of its cloud and its number in ``planes``."""
        check_choice(cloud, "cloud", tuple(self._points))
        self._enter(cloud, plane)
        self.show(self.surface(cloud, plane))

    def surface(self, cloud: str, plane: int = 0) -> np.ndarray:
        """Return the points of a plane, shape (n, 3), m."""
        return self._points[cloud][self._patches[cloud][plane].index]

    def _enter(self, cloud, plane):
        """Mark a plane in the picture; draw picture and list again if the cloud has changed."""
        if cloud != self.name:
            self.name = self._clouds.value = cloud
            self._draw_scene()
        self.number, self.patch = plane, self._patches[cloud][plane]
        palette = to_rgba_array([*TINTS, "#DDDDDD", plots.COLOURS["vermilion"]])
        place = 1 + (self._owner - 1) % (len(TINTS) - 1)  # the first tint is the largest plane's
        place[self._owner == 0], place[self._owner < 0] = 0, -2
        place[self._owner == plane] = -1
        self._scene_dots.set_facecolor(palette[place])
        shown = [number for _, number in self._list.options]
        self._list.value = plane if plane in shown else None
        self._scene.axes[0].set_title(f"{self.name}, plane {plane}")
        self._scene.canvas.draw_idle()

    def _draw_scene(self):
        """Draw the chosen cloud along its shortest extent, and list its planes."""
        points, patches = self._points[self.name], self._patches[self.name]
        owner = np.full(len(points), -1)
        for number, patch in enumerate(patches):
            owner[patch.index] = number
        step = 1 + len(points) // SHOWN
        self._owner, shown = owner[::step], points[::step]
        across, up = sorted(np.argsort(np.ptp(points, axis=0))[1:])
        self._scene.clear()
        ax = self._scene.add_subplot(aspect="equal")
        self._scene_dots = ax.scatter(*shown[:, [across, up]].T, s=3, lw=0)
        ax.set(xlabel=f"{AXES[across]} (m)", ylabel=f"{AXES[up]} (m)")
        ax.ticklabel_format(useOffset=False, style="plain")
        ax.locator_params(nbins=5)
        _forget_zoom(self._scene)
        rows = self.planes[self.planes["cloud"] == self.name].head(LISTED)
        rows = rows[rows["points"] >= LISTED_SHARE * rows["points"].max()].to_dict("records")
        text = "{plane}: {area_m2:.1f} m², height {height_m:.1f} m, slope {slope_deg:.0f}°"
        self.number = 0
        self._list.options = [(text.format(**row), row["plane"]) for row in rows]

    def _listed(self, plane):
        """Choose a plane of the list."""
        if plane not in (None, self.number):
            self.choose(self.name, plane)

    def _clicked(self, event):
        """Choose the plane of the point nearest to a click; a click that zooms chooses nothing."""
        if event.inaxes is None or getattr(event.canvas.toolbar, "mode", ""):
            return
        pixels = event.inaxes.transData.transform(self._scene_dots.get_offsets())
        away = np.where(self._owner < 0, np.inf, np.hypot(*(pixels - (event.x, event.y)).T))
        if away.min() <= NEAR_PX:
            self.choose(self.name, int(self._owner[away.argmin()]))

    def _pictures(self):
        """The picture and the list above the polygon."""
        side = [] if is_headless() else [ipywidgets.VBox([self._clouds, self._list])]
        return [ipywidgets.HBox([self._scene_canvas, *side]) if side else self._scene, self.canvas]


def _described(patch, points):
    """The figures of a plane in the list and in the table."""
    hull = shapely.convex_hull(shapely.multipoints(patch.plane.project(points[patch.index])))
    return {
        "points": len(patch),
        "area_m2": hull.area,
        "slope_deg": np.degrees(np.arccos(min(1.0, abs(patch.plane.normal[2])))),
        "std_mm": 1000 * patch.sigma,
        **{f"{AXES[k]}_m": patch.plane.centre[k] for k in range(3)},
    }


def _forget_zoom(figure):
    """Let the button home of a canvas return to the present view."""
    if figure.canvas.toolbar is not None:
        figure.canvas.toolbar.update()


def _canvas(figure):
    """A canvas of ipympl; without a screen, the figure.

    The import of ipympl changes the backend of the whole session, so the backend is set back.
    """
    if is_headless():
        return figure
    backend = matplotlib.get_backend()
    from ipympl.backend_nbagg import Canvas, FigureManager

    matplotlib.use(backend)
    canvas = Canvas(figure)
    canvas.draw = _in_turn()(canvas.draw)  # or a half changed figure would be drawn
    canvas.header_visible, canvas.toolbar_visible = False, True
    canvas.toolbar_position = "right"  # below, it would hide the coordinates of the mouse
    canvas.keep = FigureManager(canvas, 0)  # without its manager the toolbar disappears
    canvas.toolbar.layout.width = "3em"
    return canvas


def largest_rectangle(xy: ArrayLike) -> np.ndarray:
    """Return the largest rectangle along the axes without gaps between points.

    Parameters
    ----------
    xy : array_like, shape (n, 2)
        Coordinates, m.

    Returns
    -------
    array, shape (4, 2)
        Its corners, m, in steps of a sixtieth of the longer extent or three times the spacing.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(0, 4, 0.05), np.arange(0, 4, 0.05))
    >>> band = np.column_stack([x.ravel(), y.ravel()])[(abs(x - y) < 1).ravel()]
    >>> corners = largest_rectangle(band)
    >>> bool((np.abs(corners @ [1, -1]) < 1.25).all())
    True
    """
    xy = np.asarray(xy, dtype=np.float64)
    extent = np.ptp(xy, axis=0)
    some = np.arange(len(xy)) % (1 + len(xy) // SHOWN) == 0
    away = quadrant_distances(xy, radius=extent.max() / 4, of=some)[:, -1]
    away = away[~np.isnan(away)]
    edge = max(extent.max() / 60, 3 * np.median(away)) if len(away) else extent.max() / 10
    cells = np.maximum(1, (extent / edge).astype(int))
    counts, x, y = np.histogram2d(xy[:, 0], xy[:, 1], bins=cells)
    filled = ndimage.binary_closing(np.pad(counts > 0, 1))[1:-1, 1:-1] | (counts > 0)
    best, heights = (0, 0, 0, 0, 0), np.zeros(filled.shape[1], dtype=int)
    for end, row in enumerate(filled, 1):
        heights = (heights + 1) * row
        for first in range(len(row)):
            lowest = np.minimum.accumulate(heights[first:])
            areas = lowest * np.arange(1, len(lowest) + 1)
            k = np.argmax(areas)
            best = max(best, (areas[k], end - lowest[k], first, end, first + k + 1))
    _, x0, y0, x1, y1 = best
    return np.array([(x[x0], y[y0]), (x[x1], y[y0]), (x[x1], y[y1]), (x[x0], y[y1])])


class JuryForm:
    """A form in which a juror marks how well texts can be read.

    Each juror sees the same crops in the same order, without their names. The marks are a (every
    letter), b (the text) and c (not legible). Every mark is written to the file before the next
    crop is shown. A new form on the same file continues with the first crop without a mark.

    Parameters
    ----------
    crops : dict of str to array, shape (rows, columns)
        Images in linear light by name of the element, such as ``"photo 3, text_1"``.
    juror : str
        Name of the juror.
    file : path
        CSV with ``juror``, ``element``, ``mark``. All jurors share it. It is created if missing.

    Attributes
    ----------
    box : ipywidgets.Widget
        The form, as a notebook shows it.

    Raises
    ------
    ValueError
        If the file contains invalid marks.

    Examples
    --------
    >>> import tempfile
    >>> file = Path(tempfile.mkdtemp()) / "marks.csv"
    >>> form = JuryForm({"sign": np.ones((4, 9))}, juror="first", file=file)
    >>> form.mark("a")
    >>> pd.read_csv(file)["mark"].tolist(), form.element is None
    (['a'], True)
    """

    def __init__(self, crops: Mapping[str, Any], *, juror: str, file: str | os.PathLike):
        self._juror, self._file, self._crops = juror.strip(), Path(file), dict(crops)
        self._picture = ipywidgets.Image(format="png", layout={"object_fit": "none"})
        self._line = ipywidgets.Label()
        self._buttons = [ipywidgets.Button(description=text) for text in MEANINGS.values()]
        for mark, button in zip(MEANINGS, self._buttons, strict=True):
            button.on_click(lambda _, mark=mark: self.mark(mark))
        self.box = ipywidgets.VBox([self._line, ipywidgets.HBox(self._buttons), self._picture])
        self._show()

    @property
    def marks(self) -> pd.DataFrame:
        """All marks in the file, of all jurors."""
        if not self._file.is_file():
            return pd.DataFrame(columns=["juror", "element", "mark"])
        return check_marks(pd.read_csv(self._file, dtype=str, keep_default_na=False))

    @property
    def element(self) -> str | None:
        """Name of the crop shown; None if all crops are marked."""
        marks = self.marks
        done = set(marks.loc[marks["juror"] == self._juror, "element"])
        return next((name for name in self._crops if name not in done), None)

    def mark(self, mark: str) -> None:
        """Mark the crop shown with a, b or c, write the mark to the file and show the next crop."""
        check_choice(mark, "mark", MARKS)
        if (element := self.element) is not None:
            row = {"juror": self._juror, "element": element, "mark": mark}
            write_atomically(self._file, pd.concat([self.marks, pd.DataFrame([row])]))
            self._show()

    def _ipython_display_(self):
        """Show the form; without a screen, the current crop."""
        display(Image(self._picture.value) if is_headless() else self.box)

    def _show(self):
        """Show the next crop, or the end of the form."""
        element, names = self.element, list(self._crops)
        place = len(names) if element is None else names.index(element)
        for button in self._buttons:
            button.disabled = element is None
        state = f"{place + 1} of {len(names)}" if element else "all are marked, thank you."
        self._line.value = f"{self._juror}: {state}"
        self._picture.value = _png(self._crops[element]) if element else b""


def _png(crop):
    """A crop as PNG, each pixel enlarged to a square."""
    import cv2

    low, high = np.percentile(crop, [0.5, 99.5])
    shown = encode(np.clip((crop - low) / max(high - low, 1e-9), 0, 1), "srgb")
    zoom = int(np.clip(WIDEST_PX // crop.shape[1], 1, LARGEST_ZOOM))
    pixels = np.kron(np.round(shown * 255).astype(np.uint8), np.ones((zoom, zoom), np.uint8))
    return cv2.imencode(".png", pixels)[1].tobytes()
