"""Selecting a surface in the notebook: pick its plane in the scene, draw a polygon, keep it.

For the polygon the cloud is seen at right angles to its plane. Whatever the polygon selects is
evaluated at once, as ``mmqa evaluate --polygon`` does with the saved file.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import ipywidgets
import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.proj3d import proj_transform

from mmqa_lab import plots
from mmqa_lab._checks import check_points, check_polygon
from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.io import write_polygon
from mmqa_lab.planes import fit_plane
from mmqa_lab.views import is_headless

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from mmqa_lab.cloud import Cloud

SHOWN = 10_000
"""Points drawn; all of them are evaluated."""

FEW_TICKS = 4
"""On each axis: most of the time of drawing goes into ticks."""

SIZE_INCHES = (9.0, 4.6)

SCENE_INCHES = (7.0, 5.0)

NEAR_PX = 8
"""A click means the foremost of the points so near to it."""

CLICK_PX = 3
"""A mouse that moves farther while its button is down turns the scene."""


class _View:
    """A cloud as seen at right angles to its plane, upright where it stands."""

    def __init__(self, points):
        plane = fit_plane(points, robust=True)
        self.centre = plane.centre
        self.axes = plane.axes if abs(plane.normal[2]) > 0.999 else plane.horizontal_axes()

    def to_plane(self, points):
        """Coordinates in the plane, shape (n, 2), m."""
        return (np.asarray(points, dtype=np.float64) - self.centre) @ self.axes.T

    def to_space(self, xy):
        """Points of the plane in space, shape (n, 3), m."""
        return self.centre + np.asarray(xy, dtype=np.float64) @ self.axes

    def middle_polygon(self, points):
        """A rectangle about the middle half of the points, shape (4, 3), m."""
        low, high = np.percentile(self.to_plane(points), [15, 85], axis=0)
        return self.to_space([low, [high[0], low[1]], high, [low[0], high[1]]])


def select_polygon(
    cloud: Cloud | ArrayLike,
    *,
    polygon: ArrayLike | None = None,
    **choices: Any,
) -> SelectionTool | Figure:
    """Show a cloud with a polygon whose vertices can be dragged, and what it selects.

    Parameters
    ----------
    cloud : Cloud or array_like, shape (n, 3)
        A surface and what is around it, metres.
    polygon : array_like, shape (m, 3), optional
        Where to start; by default a rectangle about the middle.
    **choices
        Thickness, axes, radius, sectors and so on of :func:`mmqa_lab.chart_cloud.evaluate_cloud`.

    Returns
    -------
    SelectionTool or matplotlib.figure.Figure
        The tool, or its picture where there is no screen.

    Raises
    ------
    ValueError
        If there are fewer than three points, or the polygon selects too few of them.

    Examples
    --------
    >>> from unittest.mock import patch
    >>> x, y = np.meshgrid(np.arange(20) * 0.02, np.arange(10) * 0.04)
    >>> cloud = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    >>> with patch.dict("os.environ", MMQA_HEADLESS="1"):
    ...     figure = select_polygon(cloud)
    >>> figure.axes[0].get_title().split(",")[-1]
    ' f 2.00'
    """
    points = check_points(cloud, minimum=3)
    polygon = None if polygon is None else check_polygon(polygon)
    if not is_headless():
        return SelectionTool(points, polygon=polygon, **choices)
    view = _View(points)
    polygon = view.middle_polygon(points) if polygon is None else polygon
    figure, panels = _panels(Figure(figsize=SIZE_INCHES), view.to_plane(points))
    outline = view.to_plane(np.concatenate([polygon, polygon[:1]]))
    panels[0].plot(*outline.T, color=plots.COLOURS["vermilion"])
    quality = evaluate_cloud(points, polygon=polygon, **choices)
    _draw_histograms(panels, quality)
    panels[0].set_title(_summary(quality), fontsize=7)
    return figure


class SelectionTool:
    """A polygon on a cloud, its vertices, and the quality of what it selects.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Metres.
    polygon, **choices
        See :func:`select_polygon`.

    Attributes
    ----------
    vertices : array, shape (m, 3)
        The polygon as it is now, metres.
    quality : CloudQuality or None
        What it selects; None while it selects too little.
    box : ipywidgets.VBox
        What is shown.

    Raises
    ------
    ValueError
        If there are fewer than three points.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(20) * 0.02, np.arange(10) * 0.04)
    >>> tool = SelectionTool(np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1))
    >>> tool.vertices.shape, round(tool.quality.f, 2)
    ((4, 3), 2.0)
    """

    def __init__(self, points: ArrayLike, *, polygon: ArrayLike | None = None, **choices):
        from matplotlib.widgets import PolygonSelector

        self.points = check_points(points, minimum=3)
        self.choices = choices
        self.view = _View(self.points)
        middle = self.view.middle_polygon(self.points)
        self.vertices = middle if polygon is None else check_polygon(polygon)
        self.quality = None
        self.text = ipywidgets.HTML()
        figure = Figure(figsize=SIZE_INCHES, dpi=100)
        self.canvas, self._manager = _canvas(figure)
        _, self._panels = _panels(figure, self.view.to_plane(self.points))
        look = {"color": plots.COLOURS["vermilion"], "linewidth": 1.5}
        self._selector = PolygonSelector(self._panels[0], self._moved, props=look)
        self._selector.verts = self.view.to_plane(self.vertices).tolist()
        self._moved(self._selector.verts)
        self.box = ipywidgets.VBox([self.canvas, self.text, self._save_row()])

    def _ipython_display_(self):
        """Show the tool where it is the last value of a cell."""
        from IPython.display import display

        display(self.box)

    def select(self, vertices: ArrayLike) -> None:
        """Move the polygon to ``vertices``, shape (m, 3), and evaluate what it selects."""
        self._selector.verts = self.view.to_plane(vertices).tolist()
        self._moved(self._selector.verts)

    def save(self, path: str | os.PathLike) -> None:
        """Write the polygon as GeoJSON for ``mmqa evaluate --polygon`` and ``read_polygon``."""
        write_polygon(path, self.vertices)

    def _moved(self, vertices):
        """Evaluate and draw again after a vertex was dragged."""
        self.vertices = self.view.to_space(vertices)
        try:
            self.quality = evaluate_cloud(self.points, polygon=self.vertices, **self.choices)
        except ValueError as error:
            self.quality, self.text.value = None, f"<b>{error}</b>"
            return
        self.text.value = f"<b>{_summary(self.quality)}</b>"
        _draw_histograms(self._panels, self.quality)
        self.canvas.draw_idle()

    def _save_row(self):
        """A field for the file's name, a button, and what became of it."""
        name = ipywidgets.Text("polygon.geojson", description="file")
        button, said = ipywidgets.Button(description="Save polygon"), ipywidgets.HTML()

        def save(_):
            """Write the file and say so, or why not."""
            try:
                self.save(name.value)
                said.value = f"saved; mmqa evaluate CLOUD --polygon {name.value}"
            except (OSError, ValueError) as error:
                said.value = str(error)

        button.on_click(save)
        return ipywidgets.HBox([name, button, said])


def _summary(quality):
    """The quality in one line."""
    density = f", {quality.density_polygon_per_m2:.0f} points/m²"
    return (
        f"{quality.n} points{density if np.isfinite(quality.area_polygon_m2) else ''}, "
        f"sigma_MAD {quality.sigma_mad_mm:.2f} mm, std {quality.std_mm:.2f} mm, "
        f"d1 {quality.d1_mm:.1f} mm, d4 {quality.d4_mm:.1f} mm, f {quality.f:.2f}"
    )


def pick_plane(cloud: Cloud | ArrayLike, patches: list, *, chosen: int = 0) -> PlanePicker | Figure:
    """Show a scene in 3-D with the planes found in it; a click on one of them chooses it.

    Parameters
    ----------
    cloud : Cloud or array_like, shape (n, 3)
        Metres.
    patches : list of Patch
        Of :func:`mmqa_lab.planes.detect_planes`.
    chosen : int
        The plane to start with.

    Returns
    -------
    PlanePicker or matplotlib.figure.Figure
        Its ``chosen`` is the place of the plane in ``patches``; a picture where there is no screen.

    Raises
    ------
    ValueError
        If there is no such plane.

    Examples
    --------
    >>> from unittest.mock import patch
    >>> from mmqa_lab.planes import detect_planes
    >>> flat = np.random.default_rng(0).uniform(0, 5, (1500, 3))
    >>> cloud = np.concatenate([flat * [1, 1, 0], flat * [1, 0, 1]])
    >>> with patch.dict("os.environ", MMQA_HEADLESS="1"):
    ...     figure = pick_plane(cloud, detect_planes(cloud))
    >>> figure.axes[0].get_title().split(":")[0]
    'plane 0 of 2'
    """
    points = check_points(cloud)
    if chosen not in range(len(patches)):
        raise ValueError(f"Invalid plane {chosen}. Must be one of the {len(patches)} planes found.")
    picker = PlanePicker(points, patches, chosen, shown=not is_headless())
    return picker.figure if is_headless() else picker


class PlanePicker:
    """A scene with its planes, one of them chosen, see :func:`pick_plane`.

    Attributes
    ----------
    chosen : int
        Place of the chosen plane among the patches.
    box : ipywidgets.VBox
        What is shown.
    """

    def __init__(self, points: ArrayLike, patches: list, chosen: int, *, shown: bool):
        self.patches = patches
        self.figure = Figure(figsize=SCENE_INCHES, dpi=100)
        self.ax = self.figure.add_axes((0, 0.08, 0.96, 0.84), projection="3d")
        local = points - points.mean(axis=0)
        step = max(1, len(local) // SHOWN)
        self._rows = np.arange(0, len(local), step)
        self._local, self._owner = local[::step], np.full(len(local), -1)
        for number, patch in enumerate(patches):
            self._owner[patch.index] = number
        self._owner = self._owner[::step]
        self._lines = [self._drawn(number) for number in range(-1, len(patches))]
        self.ax.set(xlabel="easting (m)", ylabel="northing (m)", zlabel="height (m)")
        self.ax.set_aspect("equal")
        self.ax.locator_params(nbins=FEW_TICKS)
        self.choose(chosen)
        if shown:
            self._show()

    def choose(self, number: int) -> None:
        """Choose a plane by its place among the patches."""
        self.chosen = number
        for k, line in enumerate(self._lines[1:]):
            line.set_color(plots.COLOURS["vermilion"] if k == number else _shade(k))
        patch = self.patches[number]
        slope = np.degrees(np.arccos(min(1.0, abs(patch.plane.normal[2]))))
        self.ax.set_title(
            f"plane {number} of {len(self.patches)}: {len(patch)} points, slope {slope:.0f} "
            f"degrees, std {1000 * patch.sigma:.1f} mm",
            fontsize=9,
        )
        self.figure.canvas.draw_idle()

    def plane_at(self, x: float, y: float) -> int | None:
        """The plane under a place of the canvas (pixels from its lower left corner), or None."""
        across, up, depth = proj_transform(*self._local.T, self.ax.get_proj())
        places = self.ax.transData.transform(np.column_stack([across, up]))
        away = np.hypot(*(places - [x, y]).T)
        near = np.flatnonzero((away <= NEAR_PX) & (self._owner >= 0))
        return int(self._owner[near[np.argmin(depth[near])]]) if len(near) else None

    def _ipython_display_(self):
        """Show the scene where it is the last value of a cell."""
        from IPython.display import display

        display(self.box)

    def _drawn(self, number):
        """The points of a plane, or of none."""
        points = self._local[self._owner == number]
        colour = plots.COLOURS["grey"] if number < 0 else _shade(number)
        return self.ax.plot(*points.T, ".", ms=1 if number < 0 else 2, color=colour)[0]

    def _show(self):
        """The canvas with the mouse: a click chooses, a drag turns."""
        self.canvas, self._manager = _canvas(self.figure)
        self.box = ipywidgets.VBox([self.canvas])
        self.canvas.mpl_connect("button_press_event", self._pressed)
        self.canvas.mpl_connect("button_release_event", self._released)

    def _pressed(self, event):
        """Note where the mouse's button went down."""
        self._down = event.x, event.y

    def _released(self, event):
        """Choose the plane where the mouse has not moved."""
        if np.hypot(event.x - self._down[0], event.y - self._down[1]) <= CLICK_PX:
            number = self.plane_at(event.x, event.y)
            if number is not None:
                self.choose(number)


def _shade(number):
    """A colour for a plane that is not chosen."""
    return ("#0072B2", "#56B4E9", "#009E73", "#E69F00", "#CC79A7")[number % 5]


def _canvas(figure):
    """A canvas of ipympl, which on import takes over the figures of the whole session, and its
    manager."""
    import matplotlib

    backend = matplotlib.get_backend()
    from ipympl.backend_nbagg import Canvas, FigureManager

    if matplotlib.get_backend() != backend:
        matplotlib.use(backend)
    canvas = Canvas(figure)
    canvas.header_visible = False
    return canvas, FigureManager(canvas, 0)


def _panels(figure, xy):
    """The cloud on the left, room for two histograms on the right; fixed, so drawing is quick."""
    figure.set_layout_engine("none")
    panels = [
        figure.add_axes(place)
        for place in ((0.07, 0.11, 0.52, 0.8), (0.69, 0.62, 0.29, 0.24), (0.69, 0.13, 0.29, 0.24))
    ]
    shown = xy[:: max(1, len(xy) // SHOWN)]
    mark = "," if len(shown) > SHOWN // 3 else "."  # one pixel each where there are many
    panels[0].plot(*shown.T, mark, ms=2, color=plots.COLOURS["blue"])
    panels[0].set(xlabel="along axis 1 (m)", ylabel="along axis 2 (m)", aspect="equal")
    panels[0].locator_params(nbins=FEW_TICKS)
    return figure, panels


def _draw_histograms(panels, quality):
    """Distances from the plane, and nearest and farthest quadrant distances."""
    _, residuals, spacings = panels
    residuals.clear()
    spacings.clear()
    quality.draw_histograms(spacings, residuals)
    for panel in (residuals, spacings):
        panel.locator_params(nbins=FEW_TICKS)
