"""The planes of clouds in a list and a picture, and the selection on the chosen one."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Mapping
from typing import Any

import ipywidgets
import numpy as np
import pandas as pd
import shapely
from matplotlib.colors import to_rgba_array
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from mmqa_lab import plots
from mmqa_lab._checks import check_choice, check_points, refuse
from mmqa_lab._progress import progress
from mmqa_lab.chart_cloud import inside_polygon
from mmqa_lab.cloud import Cloud
from mmqa_lab.plane_search import detect_planes
from mmqa_lab.views import is_headless
from mmqa_lab.widgets.kept import Kept
from mmqa_lab.widgets.screen import SHOWN, Halt, canvas_of, forget_zoom, in_turn
from mmqa_lab.widgets.selection import SelectionTool

__all__ = ["SurfaceTool", "kind_of", "true_colours"]


# Most planes listed, those with the most points first: of at least this share of the points of the
# largest. All can be chosen.
LISTED, LISTED_SHARE = 12, 0.01

# Largest distance of a click from a point of the plane that it chooses, pixels.
NEAR_PX = 10

# Colours of the other planes in the picture and in the list.
TINTS = ("#56B4E9", "#009E73", "#E69F00", "#CC79A7", "#F0E442", "#999999")

AXES = ("easting", "northing", "height")

# Looks of the name of a kept selection.
TAG = {"fontsize": 7, "ha": "center", "bbox": {"fc": "w", "lw": 0, "pad": 1, "alpha": 0.8}}

# Cosine of the slope of a floor, 25 degrees; its difference from 1 is that of a wall, 84 degrees.
LEVEL_COSINE = 0.9

# Points nearer to a level plane are not above or below it; storeys are higher, m.
CLEAR_M, STOREY_M = 0.15, 2.0

POINTS_OF_COMPASS = (
    "north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west",
)  # fmt: skip


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
        ``northing_m``, ``height_m`` of all planes; ``kind``: floor, ceiling, slope, or where a wall
        faces, towards the middle of the cloud; ``up_m`` above the lowest point of the cloud;
        ``storey`` of the plane's centre, from 1.
    kept : Kept
        Selections that are kept under names.
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
        self._given = dict(clouds)
        self._patches, self.missing, found = {}, [], []
        for name, points in progress(self._points.items(), "cloud"):
            try:
                patches = self._patches[name] = _planes_of(points, tolerance, size)
            except KeyboardInterrupt:
                said = f"Interrupted: planes of {name} were sought. Run the cell again."
                raise Halt(said) from None
            if not patches:
                self.missing.append(f"{name}: no plane of {size:g} m or more.")
                continue
            table = pd.DataFrame([_described(patch, points) for patch in patches])
            table.insert(0, "cloud", name)
            table.insert(1, "plane", table.index)
            found.append(table.assign(storey=_storeys(table)))
        listed = [name for name, patches in self._patches.items() if patches]
        if not listed:
            named = ", ".join(self._points)
            raise Halt(f"Invalid cloud {named}: no plane of {size:g} m or more. Must have one.")
        self.planes = pd.concat(found, ignore_index=True)
        self._scene = Figure(figsize=(3.9, 4), dpi=100, layout="constrained")
        self._scene.get_layout_engine().set(rect=(0, 0, 0.93, 1))  # buttons are to the right
        self._scene_canvas = canvas_of(self._scene)
        self._scene.canvas.mpl_connect("button_press_event", self._clicked)
        look = {"layout": {"width": "25.5em"}, "style": {"description_width": "3.2em"}}
        self._clouds = ipywidgets.Dropdown(options=listed, description="cloud", **look)
        self._clouds.observe(lambda change: self.choose(change["new"]), names="value")
        self._list = ipywidgets.Select(description="plane", rows=LISTED, **look)
        self._list.observe(lambda change: self._listed(change["new"]), names="value")
        self._top = ipywidgets.FloatSlider(
            1.0, min=0.05, max=1.0, step=0.05, description="cut at", readout_format=".0%",
            continuous_update=False, **look,
        )  # fmt: skip
        self._true = ipywidgets.Checkbox(False, description="true colours", **look)
        for control in (self._top, self._true):
            control.observe(lambda _: self._again(), names="value")
        self.kept = Kept(self)
        self.name, first = None, listed[0]
        self._enter(first, 0)
        super().__init__(self.surface(first), **choices)

    @in_turn()
    def choose(self, cloud: str, plane: int = 0) -> None:
        """Choose a plane by the name of its cloud and its number in ``planes``."""
        check_choice(cloud, "cloud", tuple(self._clouds.options))
        check_choice(plane, f"plane of {cloud}", range(len(self._patches[cloud])))
        self._enter(cloud, plane)
        self.show(self.surface(cloud, plane))

    def surface(self, cloud: str, plane: int = 0) -> Cloud:
        """Return the points of a plane."""
        points = self._points[cloud][self._patches[cloud][plane].index]
        return Cloud(points, resolution=getattr(self._given[cloud], "resolution", np.nan))

    def crs_of(self, cloud: str) -> Any:
        """Return the coordinate system of a cloud, or None."""
        return getattr(self._given[cloud], "crs", None)

    def plane_at(self, polygon: ArrayLike) -> int:
        """Return the number of the plane of the chosen cloud that most points at a polygon have."""
        owners = self._owners[inside_polygon(self._points[self.name], polygon)]
        counts = np.bincount(owners[owners >= 0])
        refuse(not len(counts), "polygon", "no plane of the cloud there", "on a plane")
        return int(counts.argmax())

    @property
    def row(self) -> int:
        """The row of the chosen plane in ``planes``."""
        one = (self.planes["cloud"] == self.name) & (self.planes["plane"] == self.number)
        return int(np.flatnonzero(one)[0])

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
        colours = palette[place]
        if self._true.value and self._rgb is not None:
            colours = np.where((place == -1)[:, None], palette[-1], self._rgb)
        self._scene_dots.set_facecolor(colours)
        shown = [number for _, number in self._list.options]
        self._list.value = plane if plane in shown else None
        kind = _short(self.planes["kind"][self.row])
        self._scene.axes[0].set_title(f"{self.name}, plane {plane}: {kind}")
        self._scene.canvas.draw_idle()

    def _draw_scene(self):
        """Draw the chosen cloud along its shortest extent, and list its planes."""
        points, patches = self._points[self.name], self._patches[self.name]
        owner = np.full(len(points), -1)
        for number, patch in enumerate(patches):
            owner[patch.index] = number
        across, up = self._across = sorted(np.argsort(np.ptp(points, axis=0))[1:])
        low, high = points[:, 2].min(), points[:, 2].max()
        below = np.flatnonzero(points[:, 2] <= low + self._top.value * (high - low) + 1e-9)
        drawn = below[:: 1 + len(below) // SHOWN]
        drawn = drawn[np.argsort(points[drawn, 2], kind="stable")]  # what is higher covers
        self._owners, self._owner, shown = owner, owner[drawn], points[drawn]
        rgb = true_colours(self._given[self.name])
        self._rgb = None if rgb is None else to_rgba_array(rgb[drawn])
        self._true.layout.display = "none" if rgb is None else None
        self._scene.clear()
        ax = self._scene.add_subplot(aspect="equal")
        self._scene_dots = ax.scatter(*shown[:, [across, up]].T, s=3, lw=0)
        ax.set(xlabel=f"{AXES[across]} (m)", ylabel=f"{AXES[up]} (m)")
        ax.ticklabel_format(useOffset=False, style="plain")
        ax.locator_params("y", nbins=5)
        ax.locator_params("x", nbins=3, steps=[1, 2, 5, 10])  # room for numbers of a national grid
        forget_zoom(self._scene)
        rows = self.planes[self.planes["cloud"] == self.name].head(LISTED)
        rows = rows[rows["points"] >= LISTED_SHARE * rows["points"].max()].to_dict("records")
        text = "{plane}: {short}, {area_m2:.0f} m², {up_m:.1f} m up"
        text += ", storey {storey}" * (len({row["storey"] for row in rows}) > 1)
        self.number = 0
        self._list.options = [
            (text.format(**row, short=_short(row["kind"])), row["plane"]) for row in rows
        ]
        self._outlines = []
        self.draw_kept()

    @in_turn()
    def _again(self):
        """Draw the picture again."""
        number = self.number
        self._draw_scene()
        self._enter(self.name, number)

    @in_turn()
    def draw_kept(self) -> None:
        """Draw the outlines of the kept selections of the chosen cloud."""
        for artist in self._outlines:
            artist.remove()
        self._outlines, ax = [], self._scene.axes[0]
        for name, one in self.kept.selections.items():
            if one.cloud == self.name:
                ring = one.polygon[[*range(len(one.polygon)), 0]][:, self._across]
                self._outlines += ax.plot(*ring.T, color="k", lw=1.2)
                self._outlines.append(ax.annotate(name, ring[:-1].mean(axis=0), **TAG))
        self._scene.canvas.draw_idle()

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
        if is_headless():
            return [self._scene, self.canvas]
        side = ipywidgets.VBox([self._clouds, self._list, self._top, self._true])
        top = ipywidgets.HBox([self._scene_canvas, side], layout={"flex_flow": "row wrap"})
        return [top, self.canvas, self.kept.box]


def _described(patch, points):
    """The figures of a plane in the list and in the table."""
    own, some = points[patch.index], points[:: 1 + len(points) // (10 * SHOWN)]
    normal = patch.plane.normal
    if abs(normal[2]) > LEVEL_COSINE:
        normal = np.sign(normal[2]) * normal * (-1 if _is_ceiling(patch, own, some) else 1)
    else:
        normal = normal * (1 if normal @ (np.median(some, axis=0) - patch.plane.centre) > 0 else -1)
    hull = shapely.convex_hull(shapely.linestrings(patch.plane.project(own)))
    return {
        "kind": kind_of(normal),
        "points": len(patch),
        "area_m2": hull.area,
        "slope_deg": np.degrees(np.arccos(min(1.0, abs(patch.plane.normal[2])))),
        "std_mm": 1000 * patch.sigma,
        **{f"{AXES[k]}_m": patch.plane.centre[k] for k in range(3)},
        "up_m": patch.plane.centre[2] - points[:, 2].min(),
    }


def _is_ceiling(patch, own, some):
    """Whether the room at a level plane is below it: what is nearest to its middle is above."""
    hull = shapely.convex_hull(shapely.linestrings(own[:, :2]))
    hull = hull.buffer(-0.1 * hull.area**0.5)  # without the walls
    rise = patch.plane.distances(some[shapely.contains_xy(hull, *some[:, :2].T)])
    rise = rise * np.sign(patch.plane.normal[2])
    above, below = rise[rise > CLEAR_M], -rise[rise < -CLEAR_M]
    least = 0.05 * (len(rise) - len(above) - len(below))
    if min(len(above), len(below)) <= least:
        return len(below) > least
    return bool(np.quantile(above, 0.05) < np.quantile(below, 0.05))


def _storeys(planes):
    """The storey of each plane of a cloud, by the floors below its centre; 1 without a ceiling."""
    floors = planes[(planes["kind"] == "floor") & (planes["area_m2"] > planes["area_m2"].max() / 5)]
    levels = [-np.inf]
    for up in sorted(floors["up_m"]) if (planes["kind"] == "ceiling").any() else ():
        levels += [up] * (up > levels[-1] + STOREY_M)
    return np.maximum(1, np.searchsorted(levels, planes["up_m"] + 0.05) - 1)


def kind_of(normal: np.ndarray) -> str:
    """Return what a plane is whose normal points into the cloud: floor, ceiling, slope or wall.

    Examples
    --------
    >>> kind_of(np.array([0, -0.1, 0.99])), kind_of(np.array([-0.7, 0.7, 0.1]))
    ('floor', 'wall facing north-west')
    """
    if abs(normal[2]) > LEVEL_COSINE:
        return "floor" if normal[2] > 0 else "ceiling"
    turn = np.degrees(np.arctan2(normal[0], normal[1]))
    facing = POINTS_OF_COMPASS[round(turn / 45) % 8]
    upright = normal[2] ** 2 < 1 - LEVEL_COSINE**2
    return f"wall facing {facing}" if upright else f"slope facing {facing}"


def _short(kind):
    """What a plane is in the narrow list, as wall facing NW."""
    *words, last = kind.split()
    compass = "".join(part[0] for part in last.split("-")).upper()
    return " ".join([*words, compass if last in POINTS_OF_COMPASS else last])


def true_colours(cloud: Any) -> np.ndarray | None:
    """Return the colours of a cloud, shape (n, 3), 0 to 1; None of one without.

    They are its columns red, green and blue, or R, G and B as texts have them.
    """
    known = {name.lower(): name for name in getattr(cloud, "columns", ())}
    for names in (("red", "green", "blue"), ("r", "g", "b")):
        if known.keys() >= {*names}:
            rgb = np.stack([cloud[known[one]] for one in names], axis=1).astype(float)
            return rgb / (65_535 if rgb.max() > 255 else 255 if rgb.max() > 1 else 1)
    return None
