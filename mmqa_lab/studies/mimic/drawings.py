"""The figures of the study: frame and signs, pattern, validation, measurement, maps, budgets."""

import numpy as np
from matplotlib.ticker import NullFormatter

from mmqa_lab.plots import COLOURS, KIND_COLOURS, MAP, subplots
from mmqa_lab.studies.mimic import surfaces

NAMES = {
    "profile_spacing_perpendicular_m": "profile spacing",
    "profile_spacing_horizontal_m": "level profile spacing",
    "profile_angle_deg": "profile angle",
    "point_spacing_m": "point spacing",
    "density_per_m2": "density",
}
"""Short names for titles."""


def draw_plan(*, ax, alpha_scan=45.0, alpha_targ=15.0):
    """Draw the frame from above: axes, scan plane, target, and the signs of their headings."""
    a, t = np.radians([alpha_scan, alpha_targ])
    hit = np.array([4.0, 4.0 * np.tan(a)])
    along = np.array([-np.sin(t), np.cos(t)])
    _arrow(ax, (0, 0), (0, 3.2), "black", "Y, travel", (0.1, 3.2))
    _arrow(ax, (0, 0), (2.4, 0), "black", "X", (2.45, -0.1))
    ax.plot(*np.array([[0, 0], hit]).T, color=COLOURS["vermilion"])
    ax.plot([4, 4], [2.2, 6.0], color=COLOURS["grey"], ls=":")
    ax.plot(*np.array([hit - 1.9 * along, hit + 1.9 * along]).T, color=COLOURS["blue"], lw=2)
    _arc(ax, (0, 0), 1.6, 0, alpha_scan, "vermilion", r"$\alpha_\mathrm{scan} > 0$", 22)
    _arc(ax, hit, 1.5, 90, 90 + alpha_targ, "blue", r"$\alpha_\mathrm{targ} > 0$", 118)
    ax.text(0.4, 2.05, "horizontal pulse", color=COLOURS["vermilion"], rotation=alpha_scan)
    ax.annotate("", (4, 0.35), (0, 0.35), arrowprops={"arrowstyle": "<->", "lw": 0.6})
    ax.text(3.3, 0.5, r"$H_r$", ha="center")
    ax.plot([4, 4], [0, hit[1]], color=COLOURS["grey"], lw=0.5, ls="--")
    ax.plot(0, 0, "s", color="black", ms=5)
    ax.set(xlim=(-0.6, 5.3), ylim=(-0.5, 6.3), aspect="equal")
    ax.set_title("from above (Z towards you)")
    ax.axis("off")
    return ax


def draw_sections(*, ax, gamma_scan=30.0, beta_targ=20.0):
    """Draw the two tilts: of the scanner seen along X, of the target seen along Y."""
    g, b = np.radians([gamma_scan, beta_targ])
    for origin, name, depth in (((0.0, 0.0), "Y", 1.7), ((4.4, 0.0), "X", 1.2)):
        end = np.add(origin, (depth, 0))
        _arrow(ax, origin, end, "black", name, np.add(end, (0.08, -0.08)))
        _arrow(ax, origin, np.add(origin, (0, 2.3)), "black", "Z", np.add(origin, (-0.1, 2.4)))
    lean = 2.1 * np.array([-np.sin(g), np.cos(g)])
    ax.plot(*np.array([-0.35 * lean, lean]).T, color=COLOURS["vermilion"], lw=2)
    _arc(ax, (0, 0), 1.5, 90, 90 + gamma_scan, "vermilion", r"$\gamma_\mathrm{scan} > 0$", 136)
    foot = np.array([6.3, -0.4])
    top = foot + 2.6 * np.array([np.sin(b), np.cos(b)])
    ax.plot(*np.array([foot, top]).T, color=COLOURS["blue"], lw=2)
    ax.plot([foot[0]] * 2, [foot[1], foot[1] + 2.5], color=COLOURS["grey"], ls=":")
    _arc(ax, foot, 1.9, 90 - beta_targ, 90, "blue", r"$\beta_\mathrm{targ} > 0$", 66)
    ax.text(-0.9, -0.95, "scan plane, seen from +X", color=COLOURS["vermilion"])
    ax.text(4.3, -0.95, "target, seen from −Y", color=COLOURS["blue"])
    ax.set(xlim=(-2.3, 8.4), ylim=(-1.2, 2.8), aspect="equal")
    ax.set_title("from the side")
    ax.axis("off")
    return ax


def _arrow(ax, start, end, colour, text, place):
    """An arrow and its name."""
    style = {"arrowstyle": "-|>", "color": COLOURS[colour], "lw": 1}
    ax.annotate("", end, start, arrowprops=style)
    ax.text(*place, text, color=COLOURS[colour])


def _arc(ax, centre, radius, first, last, colour, text, at):
    """An arc between two directions in degrees, with an arrow at its end, and its name."""
    angle = np.radians(np.linspace(first, last, 60))
    x, y = centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)
    ax.plot(x, y, color=COLOURS[colour], lw=0.8)
    place = np.radians(at)
    ax.text(
        centre[0] + 1.12 * radius * np.cos(place),
        centre[1] + 1.12 * radius * np.sin(place),
        text,
        color=COLOURS[colour],
        ha="left" if np.cos(place) > 0.1 else "right" if np.cos(place) < -0.25 else "center",
    )


def draw_pattern(lattice, xy, *, ax):
    """Draw the points about a spot, the two steps, and what follows from them."""
    a, _, b = 1000 * np.array(lattice.plane_steps())
    ax.plot(*(1000 * xy).T, ".", ms=2.5, color=COLOURS["grey"], mew=0)
    for step, name, colour in ((a, "a", "vermilion"), (b, "b", "blue")):
        style = {"arrowstyle": "-|>", "color": COLOURS[colour], "shrinkA": 0, "shrinkB": 0}
        ax.annotate("", step, (0, 0), arrowprops=style)
        ax.annotate(name, step, (4, 4), textcoords="offset points", color=COLOURS[colour])
    half = 1000 * np.abs(xy).max() if len(xy) else 250
    ax.set(xlim=(-half, half), ylim=(-half, half), aspect="equal")
    ax.set(xlabel="along the level line (mm)", ylabel="up the slope (mm)")
    ax.text(1.04, 1.0, _figures_of(lattice), transform=ax.transAxes, va="top", fontsize=7)
    return ax


def _figures_of(lattice):
    """The figures of a lattice as lines of text."""
    lengths = {
        "profiles apart": "profile_spacing_perpendicular_m",
        "  level": "profile_spacing_horizontal_m",
        "  upwards": "profile_spacing_vertical_m",
        "points apart": "point_spacing_m",
    }
    lines = [f"{text} {1000 * lattice.quantity(name):.1f} mm" for text, name in lengths.items()]
    lines.insert(3, f"profile angle {lattice.profile_angle_deg:.2f}°")
    lines.append(f"density {lattice.density_per_m2:.0f} / m²")
    d = [f"{1000 * value:.1f}" for value in lattice.distances_m]
    lines.append(f"d1..d4 {', '.join(d[:2])},\n       {', '.join(d[2:])} mm")
    return "\n".join([*lines, f"f = {lattice.f:.2f}", f"range {lattice.range_m:.2f} m"])


def figure_of_pattern(**given):
    """Return a figure of the pattern that a set-up lays on a target; the explorer's function."""
    figure, ax = subplots(width="double", height_mm=85)
    try:
        draw_pattern(*surfaces.pattern(**given), ax=ax)
    except (ValueError, np.linalg.LinAlgError) as error:
        ax.text(0.5, 0.5, "\n".join(_wrapped(str(error))), ha="center", transform=ax.transAxes)
        ax.axis("off")
    return figure


def _wrapped(sentence):
    """A sentence in lines of 60 characters."""
    from textwrap import wrap

    return wrap(sentence, 60)


def draw_table_4(best, *, ax):
    """Draw Table 4: what is printed, the best single reading, and the least 4 m allows."""
    row = best["row"].to_numpy()
    published = KIND_COLOURS["published"]
    ax.errorbar(
        row, best["published_mm"], yerr=0.5, fmt="_", color=published, label="published ±0.5"
    )
    for agrees, marker, text in ((True, "o", "agrees"), (False, "x", "does not")):
        part = best[best["agrees"] == agrees]
        ax.plot(
            part["row"] + 0.15,
            part["fitted_mm"],
            marker,
            color=KIND_COLOURS["fitted"],
            ms=4,
            label=f"best reading (fitted), {text}",
        )
    missing = best[best["fitted_mm"].isna()]
    for place in missing["row"]:
        ax.text(place, 1.5, "no hit", ha="center", fontsize=6, color=KIND_COLOURS["fitted"])
    ax.step(
        [*(row - 0.5), row[-1] + 0.5],
        [*best["smallest_mm"], best["smallest_mm"].iloc[-1]],
        where="post",
        color=COLOURS["blue"],
        label="least possible at 4 m",
    )
    ax.set(xlabel="row of Table 4", ylabel="point spacing (mm)", xticks=row, ylim=(0, 38))
    ax.legend(loc="upper left", bbox_to_anchor=(1, 1))
    return ax


def draw_printed_equation(errors, *, ax):
    """Draw the error of equation 10 as printed over the height it is used at."""
    ax.plot(
        errors["height_difference_m"], 100 * errors["error"], ".", ms=1.2, color=COLOURS["blue"],
        rasterized=True,
    )  # fmt: skip
    ax.axhline(0, color="black", lw=0.6)
    ax.set(xlabel="height above the scanner (m)", ylabel="error of printed equation (%)")
    ax.set(ylim=(-80, 80))
    return ax


def draw_reliability(table, quantity, *, ax):
    """Draw errors against their own standard deviations, a point a patch (Figures 7 and 8)."""
    scale, unit = (1000, "mm") if quantity.endswith("_m") else (1, "degrees")
    part = table[table["quantity"] == quantity]
    colours = list(COLOURS.values())
    for number, (case, rows) in enumerate(part.groupby("case", sort=False)):
        ax.plot(
            scale * rows["std"], scale * rows["error"].abs(), ".", ms=4, color=colours[number],
            label=case, mew=0,
        )  # fmt: skip
    line = scale * np.array([part["std"].min() / 1.5, part["std"].max() * 1.5])
    ax.plot(line, 1.96 * line, color="black", lw=0.8)
    ax.text(line[1], 1.96 * line[1], "95 % ", ha="right", va="bottom", fontsize=7)
    ax.set(xscale="log", yscale="log", ylim=(line[0] / 30, 12 * line[1]))
    ax.set(xlabel=f"standard deviation ({unit})", ylabel=f"|measured − true| ({unit})")
    ax.set_title(NAMES[quantity])
    ax.xaxis.set_minor_formatter(NullFormatter())
    return ax


def draw_street(patches, *, ax):
    """Draw measured and predicted profile spacing on the road of the real street."""
    ax.errorbar(
        patches["across_m"], patches["measured_mm"], 1.96 * patches["std_mm"], fmt="o", ms=3.5,
        color=KIND_COLOURS["measured"], label="measured, 95 %",
    )  # fmt: skip
    ax.plot(
        patches["across_m"], patches["at_rest_mm"], "--", color=KIND_COLOURS["published"],
        label="predicted, attitude at rest",
    )  # fmt: skip
    ax.plot(
        patches["across_m"], patches["predicted_mm"], color=KIND_COLOURS["predicted"],
        label="predicted, turning",
    )  # fmt: skip
    ax.set(xlabel="across the street (m)", ylabel="profile spacing (mm)")
    ax.legend(loc="lower right")
    return ax


def draw_map(dataset, quantity, *, ax, label, scale=1.0):
    """Draw a quantity over a surface."""
    values = dataset[quantity] * scale
    across = values.dims[1]
    image = ax.pcolormesh(
        values[across], values["height"], values, cmap=MAP, shading="nearest", rasterized=True
    )
    lines = ax.contour(
        values[across], values["height"], values, colors="white", linewidths=0.5, levels=5
    )
    ax.clabel(lines, fmt="%.0f", fontsize=6)
    ax.figure.colorbar(image, ax=ax, label=label)
    unit = "degrees" if across == "azimuth" else "m"
    ax.set(xlabel=f"{across} ({unit})", ylabel="height above the scanner (m)")
    return ax


def draw_two_heads(table, *, ax):
    """Draw density on turned facades by one head and by two, and the angle of their crossing."""
    turn = table["turn_deg"]
    ax.plot(turn, table["density_first_per_m2"], "--", color=COLOURS["vermilion"], label="head +45")
    ax.plot(turn, table["density_second_per_m2"], ":", color=COLOURS["blue"], label="head −45")
    ax.plot(turn, table["density_per_m2"], color="black", label="both")
    ax.set(xlabel="facade turned by (degrees)", ylabel="density (1/m²)", ylim=(0, None))
    right = ax.twinx()
    right.plot(turn, table["crossing_deg"], color=COLOURS["green"], lw=0.8)
    right.set_ylabel("profiles cross at (degrees)", color=COLOURS["green"])
    right.set(ylim=(0, 95))
    right.spines["right"].set_visible(True)
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1), ncols=3)
    return ax


def draw_budget(budget, quantity, *, ax):
    """Draw what each source of error adds to a prediction, and all of them in both ways."""
    scale = 1000 if quantity.endswith("_m") else 1
    part = budget[budget["quantity"] == quantity].iloc[::-1]
    drawn = part["method"] == "monte_carlo"
    labels = part["source"].where(~drawn, "all, Monte Carlo")
    colours = [COLOURS["orange"] if d else COLOURS["sky"] for d in drawn]
    ax.barh(labels, scale * part["std"], color=colours)
    unit = {"profile_angle_deg": "degrees", "density_per_m2": "1/m²"}.get(quantity, "mm")
    ax.set(title=NAMES[quantity], xlabel=f"standard deviation ({unit})")
    return ax


def draw_largest_speeds(table, *, ax, labels):
    """Draw the largest speed over distance, a line per requirement."""
    for (quantity, rows), style in zip(
        table.groupby("quantity", sort=False), ("-", "--", "-."), strict=False
    ):
        ax.plot(rows["distance_m"], 3.6 * rows["speed_m_s"], style, label=labels[quantity])
    ax.set(xlabel="distance of the wall (m)", ylabel="largest speed (km/h)", ylim=(0, None))
    ax.legend()
    return ax


def draw_profile_turn(ranges, turns, *, ax):
    """Draw the angle by which motion turns profiles, over horizontal range."""
    ax.plot(ranges, turns, "o-", ms=3, color=COLOURS["vermilion"])
    ax.set(xlabel="horizontal range (m)", ylabel="profiles turned by (degrees)", ylim=(0, None))
    return ax
