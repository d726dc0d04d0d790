"""Figures of Table 2 from specifications."""

import numpy as np

from mmqa_lab.plots import COLOURS, KIND_COLOURS

STEEPEST = 20
"""Degrees of tilt; nearer to upright, lines run along the crop and the hull misleads."""

SHORT = {"density_per_m2": "density", "d1_mm": "d1", "d4_mm": "d4", "f": "f"}


def draw_pattern(cloud, *, title, ax, side=0.3):
    """Draw the points on the middle of a chart, as one looks at its front.

    Parameters
    ----------
    cloud : Cloud
        Of :func:`mmqa_lab.simulate.systems.pass_chart`.
    title : str
    side : float
        Of the part drawn, metres.
    """
    x, y = 1000 * -cloud.points[:, 1], 1000 * cloud.points[:, 2]
    half = 500 * side
    near = (np.abs(x) < half) & (np.abs(y) < half)
    ax.plot(x[near], y[near], ".", ms=1.2, color=COLOURS["blue"], rasterized=True)
    ax.set(xlim=(-half, half), ylim=(-half, half), aspect="equal")
    ax.set(xlabel="along the path (mm)", ylabel="up (mm)")
    ax.set_title(title)
    return ax


def draw_cap(sweep, published, *, ax):
    """Draw what density comes with what d4 as the plane of system A tilts, and the printed pair.

    Parameters
    ----------
    sweep : DataFrame
        Of :func:`mmqa_lab.studies.chart_tables.systems.model.sweep_tilt`.
    published : DataFrame
        Table 2.
    """
    colours = (COLOURS["orange"], COLOURS["sky"])
    for colour, (frequency, part) in zip(
        colours, sweep.groupby("mirror_frequency_hz"), strict=False
    ):
        part = part[part["tilt_deg"] >= STEEPEST].sort_values("d4_mm")
        label = f"{frequency:.0f} Hz, d1 = {part['d1_mm'].median():.1f} mm"
        ax.plot(part["d4_mm"], part["density_hull_per_m2"], "-", color=colour, label=label)
        for row in part.iloc[:: max(len(part) // 4, 1)].itertuples():
            ax.plot(row.d4_mm, row.density_hull_per_m2, "o", ms=3, color=colour)
            ax.annotate(
                f"{row.tilt_deg:.0f}°",
                (row.d4_mm, row.density_hull_per_m2),
                xytext=(4, 3),
                textcoords="offset points",
                fontsize=6,
                color=colour,
            )
    printed = published.query("system == 'A' and distance_m == 5").iloc[0]
    place = printed["d4_mm"], printed["density_per_m2"]
    label = f"published, d1 = {printed['d1_mm']:.0f} mm"
    ax.errorbar(
        *place, xerr=0.5, fmt="s", ms=4, color=KIND_COLOURS["published"], label=label, capsize=2
    )
    ax.set(xlabel="d4 at 5 m (mm)", ylabel="density at 5 m (1/m²)")
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1.0))
    return ax


def draw_comparison(comparison, *, ax):
    """Draw predicted range, prediction and fits of every printed cell, as ratios to it."""
    table = comparison.dropna(subset=["published"]).sort_values(
        ["system", "distance_m", "quantity"], ignore_index=True
    )
    places = np.arange(len(table))
    printed = table["published"]
    ax.hlines(
        places,
        table["predicted_low"] / printed,
        table["predicted_high"] / printed,
        lw=5,
        color=KIND_COLOURS["predicted"],
        alpha=0.5,
        label="predicted, open parameters within bounds",
    )
    for name, label, mark, colour in (
        ("predicted", "predicted, usual values", "|", "predicted"),
        ("fitted", "fitted, open parameters", "o", "fitted"),
        ("fitted_released", "fitted, 200 Hz given up", "D", "fitted"),
    ):
        colour = KIND_COLOURS[colour]
        ax.plot(table[name] / printed, places, mark, ms=5, mfc="none", color=colour, label=label)
    ax.axvline(1, color=KIND_COLOURS["published"], lw=0.8)
    names = [f"{r.system}, {r.distance_m:.0f} m: {SHORT[r.quantity]}" for r in table.itertuples()]
    ax.set(yticks=places, yticklabels=names, xlabel="ratio to the published value", xscale="log")
    ticks = [0.3, 0.5, 0.7, 1, 1.5, 2, 3]
    ax.set_xticks(ticks, [f"{t:g}" for t in ticks])
    ax.minorticks_off()
    ax.set_ylim(len(table) - 0.5, -0.5)
    ax.set_xlim(0.25, 4)  # bars that leave the axes go on: an upright axis can draw single lines
    ax.legend(loc="lower center", bbox_to_anchor=(0.4, 1.0), ncols=2)
    return ax


def draw_hull_bias(bias, *, ax):
    """Draw the excess of the hull's density over the angle between scan lines and crop."""
    for colour, (distance, part) in zip(
        (COLOURS["blue"], COLOURS["vermilion"]), bias.groupby("distance_m"), strict=False
    ):
        ax.errorbar(
            part["turn_deg"] + 0.2 * (distance - 7.5) / 2.5,
            part["bias_percent"],
            part["bias_sd_percent"],
            fmt="o-",
            ms=3,
            capsize=2,
            color=colour,
            label=f"{distance:.0f} m",
        )
    ax.set(xlabel="angle between lines and crop (degrees)", ylabel="excess of hull density (%)")
    ax.set_ylim(0, None)
    ax.legend(title="chart at")
    return ax
