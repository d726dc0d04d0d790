"""The figures of the test-field study."""

import numpy as np

from mmqa_lab.plots import COLOURS, KIND_COLOURS, subplots
from mmqa_lab.testfield import height_accuracy, height_differences, trend

SYSTEM_COLOURS = dict(
    zip(
        ("profiler, not calibrated", "profiler", "two pulsed profilers", "low-cost multi-beam"),
        (COLOURS["vermilion"], COLOURS["blue"], COLOURS["green"], COLOURS["purple"]),
        strict=True,
    )
)

REASON_MARKERS = {
    "no points": ("x", "grey"),
    "not surrounded": ("+", "grey"),
    "slope": ("^", "orange"),
    "gross error": ("s", "vermilion"),
}


def draw_field(street, heights, *, ax):
    """Draw the field in plan with its reference points, and why some do not count."""
    x0, y0 = street.origin[:2]
    heights = heights[heights["direction"] == "both"]
    used = heights[heights["reason"] == ""]
    ax.plot(used["y_m"] - y0, used["x_m"] - x0, ".", ms=1.5, color=COLOURS["sky"], label="ground")
    for reason, (marker, colour) in REASON_MARKERS.items():
        rows = heights[heights["reason"] == reason]
        if len(rows):
            place = rows["y_m"] - y0, rows["x_m"] - x0
            ax.plot(*place, marker, ms=3, color=COLOURS[colour], label=reason)
    poles, corners = street.poles, street.corners
    ax.plot(poles["y_m"] - y0, poles["x_m"] - x0, "o", ms=4, color=COLOURS["black"], label="pole")
    ax.plot(
        corners["y_m"] - y0, corners["x_m"] - x0, "D", ms=3, color=COLOURS["green"], label="corner"
    )
    for path, way in zip(street.drives(), (1, -1), strict=True):
        place = path.position - street.origin
        ax.plot(place[:, 1], place[:, 0], "-", color=COLOURS["grey"], lw=0.8)
        middle = place[:, 1].mean(), place[0, 0]
        ax.annotate(
            "",
            (middle[0] + 4 * way, middle[1]),
            middle,
            arrowprops={"arrowstyle": "-|>", "color": COLOURS["grey"]},
        )
    ax.set(xlabel="along the street (m)", ylabel="across (m)", aspect="equal")
    ax.legend(ncols=7, loc="upper left", bbox_to_anchor=(0, 1.25), columnspacing=0.8)
    return ax


def draw_height_std(heights, bound_mm, *, ax):
    """Draw the height std of each system: measured, predicted, and the published bound."""
    chosen = (heights["shift"] == "removed") & (heights["direction"] == "both")
    rows = heights[chosen].reset_index(drop=True)
    places = np.arange(len(rows))
    kinds = {"lw": 5, "color": KIND_COLOURS["predicted"], "label": "predicted, 90 % of drives"}
    ax.hlines(places, rows["predicted_low_mm"], rows["predicted_high_mm"], **kinds)
    ax.plot(rows["std_mm"], places, "o", color=KIND_COLOURS["measured"], label="measured")
    ax.axvline(
        bound_mm,
        ls="--",
        color=KIND_COLOURS["published"],
        label="published bound of the accuracy",
    )
    ax.set(
        yticks=places,
        yticklabels=rows["system"],
        ylim=(len(rows) - 0.5, -0.5),
        xlabel="std of heights, shift removed (mm)",
        xlim=(0, None),
    )
    ax.legend(loc="upper left", bbox_to_anchor=(-0.35, 1.5), columnspacing=0.8)
    return ax


def draw_height_trend(surveys, *, ax, names=("profiler, not calibrated", "profiler")):
    """Draw absolute height differences over the distance from the path, with robust lines."""
    for survey in surveys:
        if survey.system not in names:
            continue
        both = survey.heights[survey.heights["direction"] == "both"]
        used = both[both["reason"] == ""]
        distance, size = used["distance_m"], 1000 * used["dz_m"].abs()
        colour = SYSTEM_COLOURS[survey.system]
        ax.plot(distance, size, ".", ms=2, alpha=0.4, color=colour)
        line = trend(distance, size)
        label = (
            f"{survey.system}: {line.slope:+.2f} "
            f"({line.slope_low:+.2f} to {line.slope_high:+.2f}) mm/m"
        )
        ends = np.array([distance.min(), distance.max()])
        ax.plot(ends, line.at(ends), color=colour, lw=1.5, label=label)
    ax.set(xlabel="distance from the path (m)", ylabel="|height difference| (mm)", ylim=(0, None))
    ax.legend(loc="upper left", bbox_to_anchor=(-0.15, 1.25))
    return ax


def draw_plan_errors(surveys, *, ax):
    """Draw the plan errors of poles over the distance from the path, with robust lines.

    Filled near the ground, open 5 m up.
    """
    for survey in surveys:
        poles = survey.poles[survey.poles["direction"] == "both"]
        poles = poles[poles["reason"] == ""]
        size = 1000 * np.hypot(poles["dx_m"], poles["dy_m"])
        colour = SYSTEM_COLOURS[survey.system]
        high = poles["height_m"] > 3
        for part, face in ((~high, colour), (high, "none")):
            kind = {"ms": 3, "color": colour, "markerfacecolor": face}
            ax.plot(poles["distance_m"][part], size[part], "o", **kind)
        line = trend(poles["distance_m"], size)
        ends = np.array([poles["distance_m"].min(), poles["distance_m"].max()])
        interval = f"{line.slope_low:+.1f} to {line.slope_high:+.1f}"
        label = f"{survey.system}: {line.slope:+.1f} ({interval}) mm/m"
        ax.plot(ends, np.maximum(line.at(ends), 0.5), color=colour, lw=1.2, label=label)
    for label, face in (("near the ground", COLOURS["grey"]), ("5 m up", "none")):
        kind = {"ms": 3, "color": COLOURS["grey"], "markerfacecolor": face}
        ax.plot([], [], "o", label=label, **kind)
    ax.set(xlabel="distance from the path (m)", ylabel="plan error of poles (mm)", yscale="log")
    ax.legend(loc="upper left", bbox_to_anchor=(-0.15, 1.55))
    return ax


def draw_pole(cloud, pole, *, ax, title):
    """Draw the points of one pole in plan, by head and drive."""
    off = cloud.points - pole[["x_m", "y_m", "z_m"]].to_numpy(dtype=np.float64)
    near = (np.abs(off[:, :2]).max(axis=1) < 0.3) & (off[:, 2] > 0.5) & (off[:, 2] < 5.5)
    colours = iter(("blue", "vermilion", "green", "purple"))
    for head in (0, 1):
        for drive in (0, 1):
            chosen = near & (cloud["head"] == head) & (cloud["drive"] == drive)
            label = f"head {head + 1}, drive {drive + 1}" if chosen.any() else None
            xy = 1000 * off[chosen, :2]
            ax.plot(*xy.T, ".", ms=2, color=COLOURS[next(colours)], label=label)
    turn = np.linspace(0, 2 * np.pi, 100)
    radius = 500 * pole["diameter_m"]
    ax.plot(radius * np.cos(turn), radius * np.sin(turn), color=COLOURS["black"], lw=0.8)
    ax.set(xlabel="east (mm)", ylabel="north (mm)", aspect="equal", title=title)
    ax.set(xlim=(-200, 200), ylim=(-200, 200))
    return ax


def draw_estimates(table, *, axes, limits=(0.005, 5.0)):
    """Draw the errors of the estimated mounting with two standard errors, and the limits."""
    groups = (table["parameter"].str.endswith("deg"), table["parameter"].str.endswith("_m"))
    for ax, rows, scale, unit, limit in zip(
        axes, groups, (1, 1000), ("degrees", "mm"), limits, strict=True
    ):
        part = table[rows].reset_index(drop=True)
        names = [f"{r.parameter.rsplit('_', 1)[0]} {r.head + 1}" for r in part.itertuples()]
        places = np.arange(len(part))
        bars = {"fmt": "o", "ms": 4, "color": KIND_COLOURS["fitted"], "capsize": 2}
        ax.errorbar(scale * part["error"], places, xerr=2 * scale * part["std"], **bars)
        ax.axvspan(-limit, limit, color=COLOURS["sky"], alpha=0.3)
        ax.set(yticks=places, yticklabels=names, ylim=(len(part) - 0.5, -0.5))
        ax.set(xlabel=f"estimate minus truth ({unit})", xlim=(-1.5 * limit, 1.5 * limit))
    return axes


def draw_real(tables, *, ax):
    """Draw the height differences of the real drives: against airborne heights, and relative."""
    colours = ("blue", "orange", "green")
    bins = np.arange(-130, 60, 3)
    for (name, table), colour in zip(tables.items(), colours, strict=True):
        dz = 1000 * table.loc[table["reason"] == "", "dz_m"]
        label = f"{name}: median {dz.median():.0f} mm"
        kind = {"density": True, "histtype": "step", "lw": 1.2, "color": COLOURS[colour]}
        ax.hist(dz, bins=bins, label=label, **kind)
        ax.axvline(dz.median(), color=COLOURS[colour], lw=0.8, ls=":")
    ax.set(xlabel="height difference (mm)", ylabel="density (1/mm)")
    ax.legend(loc="upper left", bbox_to_anchor=(-0.15, 1.36))
    return ax


def figure_of_radius(points, reference):
    """Return a function that draws height differences for a search radius."""

    def draw(radius_mm):
        """The differences as a histogram."""
        table = height_differences(points, reference, radius=radius_mm / 1000)
        row = height_accuracy(table).iloc[0]
        figure, ax = subplots(height_mm=55)
        ax.hist(1000 * table.loc[table["reason"] == "", "dz_m"], bins=40, color=COLOURS["sky"])
        ax.set(xlabel="height difference (mm)", ylabel="reference points")
        ax.set_title(f"{row['n']:.0f} of {len(table)} points, std {row['std_mm']:.1f} mm")
        return figure

    return draw
