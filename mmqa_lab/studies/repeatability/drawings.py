"""Figures of the study: selections, their spread, where it comes from, and what was predicted."""

import numpy as np

from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.planes import fit_plane
from mmqa_lab.plots import (
    COLOURS,
    MAP,
    draw_points,
    draw_residual_histogram,
    draw_spacing_histogram,
    subplots,
)
from mmqa_lab.repeatability import operator_polygons, with_strays
from mmqa_lab.studies.repeatability.selections import FIGURES, THROUGH_M

PARTS = {"system": "grey", "distance_m": "sky", "scan": "orange", "selection": "blue"}
"""Colours of the variance components, from the coarsest to the finest."""

PREDICTED = {"area": "area (m²)", "density": "density (points/m²)", "click": "click error (m)"}


def surface_name(row):
    """System and distance as a reader writes them."""
    known = np.isfinite(row.distance_m)
    return f"{row.system}, {row.distance_m:.3g} m" if known else row.system


def draw_selections(surface, polygons, *, ax):
    """Draw the points of a surface and the polygons of an operator in the outline's plane."""
    plane = fit_plane(surface.corners)
    xy = plane.project(surface.points)
    draw_points(xy[np.abs(xy).max(axis=1) < 0.6], ax=ax)
    for polygon in polygons:
        outline = plane.project(np.concatenate([polygon, polygon[:1]]))
        ax.plot(*outline.T, color=COLOURS["vermilion"], lw=0.8)
    return ax


def draw_spread(limits, *, ax):
    """Draw s_r of each figure on each surface in percent of its mean, as a map."""
    surfaces = limits.groupby(["system", "distance_m"], dropna=False, sort=False)
    rows = [part.set_index("figure")["relative_s_r_percent"] for _, part in surfaces]
    values = np.array([row.reindex([*FIGURES]) for row in rows])
    shades = np.log10(np.clip(values, 0.03, 30))
    ax.imshow(shades, cmap=MAP, vmin=-1.5, vmax=1.5, aspect="auto")
    for (row, column), value in np.ndenumerate(values):
        colour = "black" if value > 1 else "white"
        ax.text(column, row, _digits(value), ha="center", va="center", fontsize=6.5, color=colour)
    ax.set_xticks(range(len(FIGURES)), [name.replace(", ", ",\n") for name in FIGURES.values()])
    names = [surface_name(next(part.itertuples())) for _, part in surfaces]
    ax.set_yticks(range(len(names)), names)
    ax.set_title(r"repeatability standard deviation $s_r$ (% of the mean)")
    ax.spines[:].set_visible(False)
    ax.tick_params(length=0)
    return ax


def _digits(percent):
    """Two digits, and what is below a hundredth of a percent as such."""
    return "<0.01" if percent < 0.01 else f"{percent:.2g}"


def draw_components(components, *, ax):
    """Draw the shares of variance of every figure, a bar each."""
    shares = components.pivot(index="figure", columns="factor", values="share").loc[[*FIGURES]]
    left = np.zeros(len(shares))
    for part, colour in PARTS.items():
        width = 100 * shares[part].to_numpy()
        label = part.removesuffix("_m")
        ax.barh(range(len(shares)), width, left=left, color=COLOURS[colour], label=label)
        left += width
    ax.set_yticks(range(len(shares)), [FIGURES[name] for name in shares.index])
    ax.set(xlabel="share of the variance of the logarithm (%)", xlim=(0, 100))
    ax.invert_yaxis()
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=4)
    return ax


def draw_inner_components(components, *, ax):
    """Draw what a scan and a selection add to a figure, as relative standard deviations."""
    table = components.pivot(index="figure", columns="factor", values="relative_sd").loc[[*FIGURES]]
    places = np.arange(len(table))
    for part, shift in (("scan", -0.18), ("selection", 0.18)):
        spread = 100 * table[part].to_numpy()
        ax.barh(places + shift, spread, 0.34, color=COLOURS[PARTS[part]], label=part)
    ax.set_yticks(places, [FIGURES[name] for name in table.index])
    ax.set(xlabel="relative standard deviation (%)", xscale="log", xlim=(0.01, None))
    ax.invert_yaxis()
    return ax


def draw_answers(groups, *, ax, threshold_percent=1.0):
    """Draw the range of the density over groups of five selections, as cumulated shares."""
    colours = iter(("blue", "sky", "vermilion", "orange", "green", "purple", "black", "grey"))
    for _, rows in groups.groupby(["system", "distance_m"], dropna=False, sort=False):
        ranges = np.sort(rows["density_range_percent"])
        share = 100 * (np.arange(len(ranges)) + 1) / len(ranges)
        ax.step(ranges, share, color=COLOURS[next(colours)], label=surface_name(rows.iloc[0]))
    ax.axvline(threshold_percent, color=COLOURS["grey"], ls=":", lw=0.8)
    ax.set(xlabel="range of the density in five selections (%)", ylabel="share of groups (%)")
    ax.set(xlim=(0, None), ylim=(0, 100))
    ax.legend(loc="upper left", bbox_to_anchor=(1, 1))
    return ax


def draw_law(laws, varied, *, ax):
    """Draw how the spread follows one quantity: simulated, with the predicted law as lines."""
    rows = laws[laws["varied"] == varied]
    cases = (
        ("density_polygon_per_m2", "horizontal", "o", "blue", "density"),
        ("sigma_mad_mm", "horizontal", "s", "green", "sigma_MAD"),
        ("d4_mm", "horizontal", "^", "orange", "d4, level axes"),
        ("d4_mm", "principal", "v", "vermilion", "d4, principal axes"),
    )
    for figure, axes, mark, colour, name in cases:
        part = rows[(rows["figure"] == figure) & (rows["axes"] == axes)]
        spread = 100 * part["relative_s_r"]
        ax.plot(part["value"], spread, mark, ms=4, mfc="none", color=COLOURS[colour], label=name)
        ax.plot(part["value"], 100 * part["predicted"], color=COLOURS[colour], lw=0.8)
    ax.set(xscale="log", yscale="log", xlabel=PREDICTED[varied], ylabel=r"$s_r$ / mean (%)")
    ticks = rows["value"].unique()
    ax.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    ax.set_yticks([0.2, 0.5, 1, 2, 5], [0.2, 0.5, 1, 2, 5])
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_ticks([], minor=True)
    return ax


def draw_strays(strays, *, ax):
    """Draw std and sigma_MAD over the share of strays: measured dots, predicted lines."""
    share = 100 * strays["share"]
    predicted = strays.drop_duplicates("share")
    for name, colour, label in (("std", "vermilion", "std"), ("sigma_mad", "blue", "sigma_MAD")):
        ax.plot(share, strays[f"{name}_mm"], "o", ms=3, mfc="none", color=COLOURS[colour])
        line = predicted[f"{name}_predicted_mm"]
        ax.plot(100 * predicted["share"], line, color=COLOURS[colour], label=label)
    ax.set(xlabel="strays behind the chart (%)", ylabel="dispersion (mm)", ylim=(0, None))
    ax.legend(loc="upper left")
    return ax


def figure_of_operator(surface):
    """Return a function that draws one selection for a click error, strays and a seed."""

    def draw(click_cm, strays_percent, seed):
        """The polygon, the histograms of the distances, and the figures."""
        polygon = operator_polygons(surface.corners, repeats=1, click=click_cm / 100, seed=seed)[0]
        share = strays_percent / 100
        points = with_strays(surface.points, share=share, depths=(0.1, 0.5), seed=seed)
        quality = evaluate_cloud(points, polygon=polygon, thickness=THROUGH_M)
        figure, axes = subplots(1, 3, width="double", height_mm=65)
        draw_selections(surface, [polygon], ax=axes[0])
        density = f"{quality.density_polygon_per_m2:.0f} points/m²"
        axes[0].set_title(f"{density}, f = {quality.f:.2f}")
        measures = {"std_mm": quality.std_mm, "sigma_mad_mm": quality.sigma_mad_mm}
        residuals_mm = 1000 * quality.plane.residuals
        draw_residual_histogram(residuals_mm, ax=axes[1], **measures)
        spacings = {"d1_mm": quality.d1_mm, "d4_mm": quality.d4_mm}
        draw_spacing_histogram(quality.distances_mm, ax=axes[2], **spacings)
        return figure

    return draw
