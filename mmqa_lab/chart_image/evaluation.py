"""Everything that one image of a chart tells about its camera."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from mmqa_lab._results import Shown
from mmqa_lab.chart_image.levels import Tones, tones
from mmqa_lab.chart_image.line_pairs import SMALLEST_GAP, SMALLEST_PAIR_PX, read_pairs, resolution
from mmqa_lab.chart_image.locate import align
from mmqa_lab.chart_image.mapping import ChartMap
from mmqa_lab.chart_image.pixel_size import SLENDERNESS, pixel_size, pixel_sizes
from mmqa_lab.charts import Bar
from mmqa_lab.mtf.edge_method import response

SINGLE_EDGE_PX = 16.0
"""Bars wider than this show two edges on their own, narrower ones are fitted as bars."""

EDGE_REACH_PX = 12.0
"""Pixels to either side of an edge that take part, as far as the ground is plain."""

NEIGHBOUR_PX = 1.5
"""Kept clear of the next element."""

SHORTEST_REACH_PX = 2.0

FREE_REACH_PX = 4.0
"""With less plain ground the fit is one Gaussian: more could not be told from the neighbours."""

OUTLINES = {True: "C5", False: "C1"}
"""Colours of resolved and refused patterns."""

EDGE_COLUMNS = (
    *("name", "direction", "mtf50", "mtf50_sigma", "mtf50_binned", "sigma_px", "angle_deg"),
    *("n", "remark"),
)


@dataclass(frozen=True, eq=False)
class ImageQuality(Shown):
    """The quality figures of one image of a chart.

    Parameters
    ----------
    chart_map : ChartMap
    tones : Tones
    sizes : DataFrame
        Of :func:`mmqa_lab.chart_image.pixel_sizes`.
    pairs : DataFrame
        Of :func:`mmqa_lab.chart_image.read_pairs`.
    edges : DataFrame
        Of :func:`mmqa_lab.chart_image.bar_edges`.

    Examples
    --------
    >>> from mmqa_lab.chart_image import ChartMap
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4)[::-1]  # pixels of 4 mm
    >>> there = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> quality = evaluate_image(image, layout, there, aligned=False)
    >>> quality.resolution("h").n, quality.to_frame()["pixel_v_mm"].round(3).item()
    (10, 4.0)
    """

    chart_map: ChartMap
    tones: Tones
    sizes: pd.DataFrame
    pairs: pd.DataFrame
    edges: pd.DataFrame

    def resolution(self, direction):
        """Return the finest resolved line pairs in direction h or v."""
        return resolution(self.pairs, direction)

    def mtf50(self, direction):
        """Return MTF50 in direction h or v and its standard deviation, cycles per pixel."""
        rows = self.edges[self.edges["direction"] == direction].dropna(subset=["mtf50_sigma"])
        if rows.empty:
            return np.nan, np.nan
        weights = 1 / np.maximum(rows["mtf50_sigma"], 1e-6) ** 2
        return float((weights * rows["mtf50"]).sum() / weights.sum()), float(weights.sum() ** -0.5)

    def to_frame(self):
        """Return one row with every figure in the field's units; NaN where not measurable."""
        residual = float(np.sqrt((self.sizes["offset_px"] ** 2).mean()))
        row = {"located_by": self.chart_map.source, "residual_px": residual}
        for direction in "hv":
            size, sigma = pixel_size(self.sizes, direction)
            found = self.resolution(direction)
            row[f"pixel_{direction}_mm"], row[f"pixel_{direction}_sigma_mm"] = size, sigma
            bars = self.sizes[self.sizes["direction"] == direction]
            row[f"pixel_{direction}_std_px"] = bars["repeats_std_px"].max() if len(bars) else np.nan
            row[f"w_{direction}_mm"] = found.width_mm
            row[f"w_{direction}_next_mm"] = found.next_mm
            row[f"limit_{direction}_mm"] = found.limit_mm
            mtf50, mtf50_sigma = self.mtf50(direction)
            row[f"mtf50_{direction}_per_px"] = mtf50
            row[f"mtf50_{direction}_sigma_per_px"] = mtf50_sigma
        row["noise_share"] = self.tones.noise
        row["clipped_share"] = self.tones.clipped_share
        return pd.DataFrame([row])

    def plot(self, image, layout, *, ax):
        """Draw the photograph with its line pairs outlined: resolved or refused.

        Parameters
        ----------
        image : array, shape (rows, columns)
        layout : Layout
        ax : matplotlib Axes

        Returns
        -------
        Axes
        """
        ax.imshow(image, cmap="gray", interpolation="nearest")
        for row in self.pairs.itertuples():
            pairs = layout[row.name]
            low, size = np.array([pairs.x, pairs.y]), np.array([pairs.width, pairs.height])
            outline = low + size * np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]])
            ax.plot(*self.chart_map.pixels(outline).T, color=OUTLINES[row.resolved], lw=1)
        for resolved, label in ((True, "resolved"), (False, "refused")):
            ax.plot([], [], color=OUTLINES[resolved], label=label)
        ax.set_axis_off()
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, 0), ncols=2)
        return ax

    def plot_contrast(self, *, ax):
        """Draw the contrast of line pairs over their width in pixels; resolved ones are filled.

        Parameters
        ----------
        ax : matplotlib Axes

        Returns
        -------
        Axes
        """
        for direction, marker, label in (("h", "o", "standing bars"), ("v", "s", "lying bars")):
            part = self.pairs[self.pairs["direction"] == direction]
            faces = part["resolved"].map({True: "C0", False: "none"})
            shape = {"marker": marker, "s": 18, "facecolors": faces, "edgecolors": "C0"}
            ax.scatter(part["width_px"], part["contrast"], label=label, **shape)
        ax.axhline(SMALLEST_GAP, color="C1", ls="--", lw=0.8)
        ax.axvspan(0.3, SMALLEST_PAIR_PX, color="C1", alpha=0.12, lw=0)
        ax.set(xscale="log", xlabel="width of a line pair (pixels)", ylabel="contrast")
        ax.set_xticks([0.5, 1, 2, 5, 10, 20], ["0.5", "1", "2", "5", "10", "20"])
        ax.minorticks_off()
        ax.legend()
        return ax


def evaluate_image(image, layout, chart_map, *, aligned=True):
    """Measure pixel size, resolved line pairs and MTF in one image of a chart.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Linear light, full scale 1.
    layout : Layout
    chart_map : ChartMap
        Where the chart is in this image, to a few pixels.
    aligned : bool
        Improve the map by the whole printed chart first.

    Returns
    -------
    ImageQuality

    Raises
    ------
    ValueError
        If the chart is not found there, or black and white cannot be told apart.

    References
    ----------
    Pfeifer et al. 2021, sections 3.2 and 4.2. doi:10.3390/rs13020237

    Examples
    --------
    >>> from mmqa_lab.chart_image import ChartMap
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4)[::-1]  # pixels of 4 mm
    >>> there = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> quality = evaluate_image(image, layout, there, aligned=False)
    >>> quality.to_frame()[["pixel_h_mm", "pixel_v_mm"]].round(3).to_numpy().tolist()
    [[4.0, 4.0]]
    """
    if aligned:
        chart_map = align(image, layout, chart_map)
    levels = tones(image, layout, chart_map)
    return ImageQuality(
        chart_map=chart_map,
        tones=levels,
        sizes=pixel_sizes(levels, layout, chart_map),
        pairs=read_pairs(levels, layout, chart_map),
        edges=bar_edges(levels, layout, chart_map),
    )


def bar_edges(levels, layout, chart_map):
    """Measure the MTF across the long bars.

    Parameters
    ----------
    levels : Tones
    layout : Layout
    chart_map : ChartMap

    Returns
    -------
    DataFrame
        A row per edge of a wide bar, or per narrow bar: ``name``, ``direction`` (h: across
        standing bars), and the fields of :class:`mmqa_lab.chart_image.EdgeResponse`; NaN and a
        ``remark`` where the edge could not be measured.

    Examples
    --------
    >>> from mmqa_lab.chart_image import ChartMap
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4)[::-1]  # pixels of 4 mm
    >>> there = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> edges = bar_edges(tones(image, layout, there), layout, there)
    >>> sorted(set(edges["name"])), sorted(set(edges["direction"]))
    (['bar_horizontal', 'bar_left', 'bar_right'], ['h', 'v'])
    """
    rows = []
    for bar in layout.of_kind(Bar):
        sides = bar.width, bar.height
        if max(sides) >= SLENDERNESS * min(sides):
            rows += _bar_rows(levels, layout, bar, chart_map)
    return pd.DataFrame(rows, columns=EDGE_COLUMNS)


def _bar_rows(levels, layout, bar, chart_map):
    """The rows of one bar: its two edges, or both in one fit."""
    axis = 0 if bar.width < bar.height else 1
    middle = np.array([[bar.x + bar.width / 2, bar.y + bar.height / 2]])
    width_px = min(bar.width, bar.height) / chart_map.pixel_sizes_mm(middle)[0, axis]
    sides = (0, 1) if width_px >= SINGLE_EDGE_PX else (None,)
    rows = []
    for side in sides:
        name = bar.name if side is None else f"{bar.name}, {('low', 'high')[side]} edge"
        row = {"name": name, "direction": "hv"[axis]}
        try:
            found = _across(levels, layout, bar, chart_map, axis, side)
        except ValueError as error:
            row |= {"n": 0, "remark": str(error)}
        else:
            row |= {field: getattr(found, field) for field in EDGE_COLUMNS[2:]}
        rows.append(row)
    return rows


def _across(levels, layout, bar, chart_map, axis, side):
    """The MTF from the pixels along one edge of a bar, or along both."""
    low = np.array([bar.x, bar.y], dtype=float)
    size = np.array([bar.width, bar.height])
    pixel_mm = chart_map.pixel_sizes_mm((low + size / 2)[None])[0]
    clear = layout.clearance(bar, (0.0, 0.0))[axis] / pixel_mm[axis] - NEIGHBOUR_PX
    clear = np.minimum(clear, EDGE_REACH_PX)
    outer = clear.min() if side is None else clear[side]
    if outer < SHORTEST_REACH_PX:
        raise ValueError(f"Invalid edge: {outer:.1f} px of plain ground. Must be 2 px or more.")
    rows, columns = np.nonzero(np.isfinite(levels.values))
    pixels = np.column_stack([columns, rows]).astype(float)
    places = chart_map.chart(pixels) - low
    end = 3 * pixel_mm[1 - axis]
    # depth grows from the edge towards the bar's inside
    edge, inward = (size[axis], -1.0) if side else (0.0, 1.0)
    depth = inward * (places[:, axis] - edge) / pixel_mm[axis]
    width_px = size[axis] / pixel_mm[axis]
    inner = width_px + outer if side is None else min(EDGE_REACH_PX, width_px / 2)
    used = (places[:, 1 - axis] > end) & (places[:, 1 - axis] < size[1 - axis] - end)
    used &= (depth > -outer) & (depth < inner)
    feet = places[used]
    feet[:, axis] = edge
    along = 2 * feet[:, 1 - axis] / size[1 - axis] - 1
    vectors = chart_map.scale(feet + low)
    tangent = vectors[:, 1 - axis]
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    offset = pixels[used] - chart_map.pixels(feet + low)
    normal = np.column_stack([tangent[:, 1], -tangent[:, 0]])
    across = (vectors[:, axis] * normal).sum(axis=1)
    distance = (offset * normal).sum(axis=1) * np.sign(across) * inward
    angle = float(np.arctan2(*np.sort(np.abs(normal.mean(axis=0)))))
    width = size[axis] * np.abs(across).mean() if side is None else np.inf
    values = 1 - levels.values[rows[used], columns[used]]
    terms = 3 if outer >= FREE_REACH_PX else 1
    return response(distance, along, values, angle, order=2, width=float(width), terms=terms)
