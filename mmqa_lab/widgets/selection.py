"""A polygon on a surface, and the quality of the points within it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from html import escape
from typing import Any

import ipywidgets
import matplotlib.pyplot as plt
import numpy as np
from IPython.core.displaypub import CapturingDisplayPublisher
from IPython.display import HTML, Javascript, display
from IPython.utils.capture import capture_output
from matplotlib.figure import Figure
from matplotlib.layout_engine import PlaceHolderLayoutEngine
from matplotlib.widgets import PolygonSelector
from numpy.typing import ArrayLike

from mmqa_lab import plots
from mmqa_lab._checks import check_points, check_polygon
from mmqa_lab.chart_cloud import CloudQuality, evaluate_cloud, inside_polygon
from mmqa_lab.chart_cloud.doubts import part_off
from mmqa_lab.cloud import Cloud
from mmqa_lab.planes import CONSISTENT_SCALE, fit_plane
from mmqa_lab.views import is_headless
from mmqa_lab.widgets.screen import (
    SHOWN,
    SPOKEN,
    WIDE,
    canvas_of,
    corners_of,
    forget_zoom,
    in_turn,
    labelled,
    largest_rectangle,
    slider,
)

__all__ = ["MISSED", "SelectionTool"]

# A kernel tells the publisher of the moment of each click. One that comes while the output of a
# follower is captured would be lost, and its control dead, for what captures does not listen.
CapturingDisplayPublisher.set_parent = lambda *_: None  # type: ignore[attr-defined]

# Margins of the tool's figure, as shares of it, and between its panels, as shares of a panel.
MARGINS = {"left": 0.09, "right": 0.98, "bottom": 0.09, "top": 0.87, "wspace": 0.42, "hspace": 1}

# A cross-section shows this share of the selected points, on either side of its middle.
SECTION = 0.05

# A plane longer than so many times its width is shown through a window of this ratio, of at least
# so large a share of the plane.
WINDOW, LEAST_WINDOW = 2.5, 0.05

# Colour of places that would not show a detail.
MISSED = "#F7C9A8"

# Most points evaluated before anything is shown. Of more, those around the middle of the polygon
# come first, and all of them when the polygon has not changed for so many seconds.
SHOWN_FIRST, SETTLED_S = 40_000, 0.6


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
        self._thickness = choices.get("thickness", 0.1)
        self._detail, self._written, self._turn = detail, "", 0
        self.text = ipywidgets.HTML()
        self.figure = Figure(
            figsize=(7.2, 5.8), dpi=100, layout=PlaceHolderLayoutEngine(True, True)
        )
        ratios = {"width_ratios": (1.6, 1), "height_ratios": (1, 1, 0.7)}
        axes = self.figure.subplot_mosaic("ab;ac;dd", **ratios, gridspec_kw=MARGINS)
        self._map, *self._panels = axes.values()
        self._map.set(xlabel="along axis 1 (m)", ylabel="along axis 2 (m)", aspect="equal")
        self._strip = self._map.axhspan(0, 0, color=plots.COLOURS["grey"], alpha=0.3)
        self._dots = self._map.scatter([], [], s=3, lw=0, c=[], cmap=plots.DIVERGING_MAP)
        self.figure.colorbar(self._dots, ax=self._map, label="distance from plane (mm)", pad=0.03)
        look = {"ms": 4, "mew": 0, "color": MISSED, "zorder": 0.5}  # below the points
        (self._missed,) = self._map.plot([], [], ".", **look)
        look = {"ms": 3, "mew": 0.4, "mfc": "none", "mec": plots.COLOURS["black"], "zorder": 3}
        (self._off,) = self._map.plot([], [], "o", **look)
        self.canvas = canvas_of(self.figure)
        look = labelled("corners: east, north, up (m)") | {"layout": {"width": "44em"}}
        self._corners = ipywidgets.Textarea(continuous_update=False, rows=6, **look)
        self._alone = ipywidgets.Button(description="Leave out the points with rings", layout=WIDE)
        self._undo = ipywidgets.Button(description="Undo: the polygon before", layout=WIDE)
        self._cut = slider("cross-section at", 0.5, 0.0, 1.0, 0.05)
        self._place = slider("window at", 0.5, 0.0, 1.0, 0.05)
        self._corners.observe(lambda change: self._type(change["new"]), names="value")
        self._undo.on_click(lambda _: self.undo())
        self._alone.on_click(lambda _: self.leave_out())
        self._cut.observe(lambda _: self.quality and self._draw_section(), names="value")
        self._place.observe(lambda change: self._slide(change["new"]), names="value")
        look = {"color": plots.COLOURS["green"], "linewidth": 2}
        self._selector = PolygonSelector(self._map, self._moved, props=look)
        self.show(points, polygon)

    def show(self, points: ArrayLike, polygon: ArrayLike | None = None) -> None:
        """Show other points, shape (n, 3), m, and a polygon, shape (m, 3), m."""
        self.points, self._step = check_points(points, minimum=3), getattr(points, "resolution", 0)
        self._drawn = self.points[:: 1 + len(self.points) // SHOWN]
        plane = fit_plane(self._drawn, robust=True)
        if abs(plane.normal[2]) < np.cos(np.radians(45)):
            plane = replace(plane, axes=plane.horizontal_axes())
        self.frame = plane
        self._dots.set_offsets(plane.project(self._drawn))
        self._xy, self._past = plane.project(self.points), []
        self.choices["thickness"] = self._thickness
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
            polygon, self.choices["thickness"] = self._past.pop()
            self.select(polygon)

    @in_turn()
    def leave_out(self) -> None:
        """Leave out the points with rings, which mislead the plane: a thinner selection."""
        apart = np.abs(self.frame.distances(self.points[self._mask][self._apart]))
        if len(apart):
            self.choices["thickness"] = round(0.9 * float(np.quantile(apart, 0.02)), 4)
            self._moved(self._selector.verts)

    def selected(self) -> np.ndarray:
        """Return the mask of the selected points, shape (n,)."""
        thickness, corners = self.choices["thickness"], self.frame.project(self.vertices)
        low, high = corners.min(axis=0) - thickness, corners.max(axis=0) + thickness
        mask = np.all((self._xy >= low) & (self._xy <= high), axis=1)  # the others are surely out
        mask[mask] = inside_polygon(self.points[mask], self.vertices, thickness=thickness)
        return mask

    @in_turn()
    def _type(self, text):
        """Move the polygon to typed corners; a text that is none becomes a sentence."""
        if text == self._written:
            return
        try:
            self.select(corners_of(text))
        except ValueError:
            wanted = "Must be lines of easting, northing, height in metres, at least three."
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
        the text of a button, the function is called when the button is pressed, and a change clears
        its output; without a screen it is called once.
        """
        if function is None:
            return lambda decorated: self.follow(decorated, button=button)
        if is_headless():
            function(self)
            return function
        output = ipywidgets.Output()

        @in_turn()
        def again(_=None):
            """Replace the output shown; also from the thread that evaluates all points."""
            with capture_output() as said:
                display(HTML(self.text.value)) if self.quality is None else function(self)
            shown = [
                {"output_type": "display_data", "data": one.data, "metadata": one.metadata}
                for one in said.outputs
            ]
            printed = {"output_type": "stream", "name": "stdout", "text": said.stdout}
            output.outputs = ((printed,) if said.stdout else ()) + tuple(shown)

        if not button:  # what a button does, nobody has asked for yet
            again()

        def cleared():
            """Show nothing."""
            output.outputs = ()

        self._followers.append(cleared if button else again)
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
            controls = [self._undo, self._alone, self._cut, self._place, self._corners]
            display(ipywidgets.VBox([*self._pictures(), self.text, *controls]))

    def _pictures(self):
        """What is shown above the line of text."""
        return [self.canvas]

    def _summary(self):
        """The main figures in one line."""
        found, thin = self.quality, self.choices["thickness"]
        within = "" if thin == self._thickness else f" within ±{1000 * thin:.0f} mm of the plane"
        density = f"{found.density_polygon_per_m2:.0f} points/m²"
        noise = f"sigma_MAD {found.sigma_mad_mm:.2f} mm, e95 {found.e95_mm:.1f} mm"
        return f"{found.n} points{within}, {density}, {noise}{self._details()}"

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
        inside, share = self._mask, self._cut.value
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
        self.vertices, self._turn = self._to_space(vertices), self._turn + 1
        before = self._past[-1] if self._past else (None, None)
        if before[1] != self.choices["thickness"] or not np.array_equal(before[0], self.vertices):
            self._past.append((self.vertices, self.choices["thickness"]))
        self._written = ";\n".join(", ".join(f"{x:.3f}" for x in one) for one in self.vertices)
        self._corners.value = self._written
        try:
            self._mask = self.selected()
            some = is_headless() or self._mask.sum() <= SHOWN_FIRST
            self._take(self.evaluate() if some else self._middle(), whole=some)
        except ValueError as error:  # the picture stays
            self.quality, self.text.value = None, f"<b>{error}</b>"
            for marks in (self._missed, self._off):
                marks.set_data([], [])
            self._tell()
            return
        if not some:
            threading.Thread(target=self._settle, args=(self._turn,), daemon=True).start()

    def evaluate(self) -> CloudQuality:
        """Return the quality of all selected points, also while the picture shows a part."""
        mask = self.selected()
        mask |= mask.sum() < 3  # whose sentence tells where the cloud is
        inside = Cloud(self.points[mask], resolution=self._step or np.nan)
        return evaluate_cloud(inside, polygon=self.vertices, **self.choices)

    def _middle(self):
        """The quality of the points around the middle of the polygon."""
        centre = self.vertices.mean(axis=0)
        small = centre + (SHOWN_FIRST / self._mask.sum()) ** 0.5 * (self.vertices - centre)
        points = Cloud(self.points[self._mask], resolution=self._step or np.nan)
        return evaluate_cloud(points, polygon=small, **self.choices)

    def _settle(self, turn):
        """Show all points when the polygon has rested, unless it changes meanwhile."""
        time.sleep(SETTLED_S)
        if turn != self._turn:
            return
        quality = self.evaluate()
        with in_turn():
            if turn == self._turn:
                self._take(quality)

    def _take(self, quality, whole=True):
        """Show the quality of all points of the selection, or of those around its middle."""
        self.quality = quality
        for panel in self._panels:
            panel.clear()
        lines = [self._summary(), *quality.remarks]
        if not whole:
            lines.insert(0, "Working: these are the points around the middle, all points follow.")
        self.text.value = f"<b>{'<br>'.join(lines)}</b>"
        quality.draw_histograms(*self._panels[:2])
        for panel in self._panels[:2]:  # they are narrow
            plt.setp(panel.get_legend().get_texts(), fontsize=7)
        off_mm = 1000 * quality.plane.distances(self._drawn)
        self._dots.set(array=off_mm, clim=np.multiply([-3, 3], quality.sigma_mad_mm))
        self._draw_section()
        self._mark_apart()
        self._tell()

    def _mark_apart(self):
        """Put rings around the points that mislead the plane, and offer to leave them out."""
        inside = self.points[self._mask]
        misled = any("turn the plane" in one for one in self.quality.remarks)
        self._apart = (
            part_off(inside, CONSISTENT_SCALE)[0] if misled else np.zeros(len(inside), bool)
        )
        rings = self.frame.project(inside[self._apart])
        self._off.set_data(rings[:: 1 + len(rings) // 500].T)
        self._alone.layout.display = None if misled else "none"

    def _tell(self):
        """Draw, and call those who follow."""
        self.figure.canvas.draw_idle()
        for again in self._followers:
            again()
