"""A polygon on a surface, and the quality of the points within it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from html import escape
from typing import Any

import ipywidgets
import numpy as np
from IPython.display import HTML, Javascript, display
from matplotlib.figure import Figure
from matplotlib.layout_engine import PlaceHolderLayoutEngine
from matplotlib.widgets import PolygonSelector
from numpy.typing import ArrayLike
from scipy import ndimage

from mmqa_lab import plots
from mmqa_lab._checks import check_points, check_polygon
from mmqa_lab.chart_cloud import evaluate_cloud, inside_polygon
from mmqa_lab.planes import fit_plane
from mmqa_lab.spacing import quadrant_distances
from mmqa_lab.views import is_headless
from mmqa_lab.widgets.explorers import slider
from mmqa_lab.widgets.screen import SPOKEN, WIDE, canvas_of, forget_zoom, in_turn, labelled

__all__ = ["MISSED", "SHOWN", "SelectionTool", "largest_rectangle"]

# Margins of the tool's figure, as shares of it, and between its panels, as shares of a panel.
MARGINS = {"left": 0.08, "right": 0.98, "bottom": 0.09, "top": 0.9, "wspace": 0.25, "hspace": 1}

# Most points drawn. All are used.
SHOWN = 10_000

# A cross-section shows this share of the selected points, on either side of its middle.
SECTION = 0.05

# A plane longer than so many times its width is shown through a window of this ratio, of at least
# so large a share of the plane.
WINDOW, LEAST_WINDOW = 2.5, 0.05

# Colour of places that would not show a detail.
MISSED = "#F7C9A8"


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
        self.canvas = canvas_of(self.figure)
        self._corners = ipywidgets.Text(
            continuous_update=False, **labelled("corners: x, y; ... (m)")
        )
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

    @in_turn()
    def undo(self) -> None:
        """Return to the polygon before the last change on this plane."""
        if len(self._past) > 1:
            self._past.pop()
            self.select(self._past.pop())

    def selected(self) -> np.ndarray:
        """Return the mask of the selected points, shape (n,)."""
        thickness = self.choices.get("thickness", 0.1)
        return inside_polygon(self.points, self.vertices, thickness=thickness)

    @in_turn()
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

    @in_turn()
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
        forget_zoom(self.figure)

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

        @in_turn()
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

    @in_turn()
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

    @in_turn()
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
