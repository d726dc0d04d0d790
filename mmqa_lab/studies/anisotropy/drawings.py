"""Figures of the study: what f, the spacing ratio g and other measures make of patterns."""

import numpy as np

from mmqa_lab.plots import COLOURS, KIND_COLOURS, MAP, draw_points, subplots
from mmqa_lab.published import pfeifer2021
from mmqa_lab.simulate.point_patterns import expected_f, point_pattern
from mmqa_lab.spacing import directional_spacing, spacing, turned_f

F0 = pfeifer2021.F_THRESHOLD

SHADES = {
    "scan_lines": "blue",
    "two_heads": "sky",
    "lattice": "green",
    "hexagonal": "purple",
    "poisson": "vermilion",
    "hard_core": "orange",
    "clusters": "black",
    "gradient": "grey",
    "holes": "grey",
}


def named(pattern):
    """A pattern's name as a reader writes it."""
    return pattern.replace("_", " ")


def draw_pattern(kind, *, ax, ratio, density=3000.0, size=0.35, seed=1):
    """Draw one pattern with its lines turned by 20 degrees, and what f and g make of it."""
    xy = point_pattern(kind, density=density, size=size, seed=seed, ratio=ratio, angle=20)
    draw_points(xy, ax=ax)
    f, g = spacing(xy).f, directional_spacing(xy).g
    ax.set_title(f"{named(kind)}\nf = {f:.1f}, g = {g:.1f}", fontsize=7)
    ax.set(xlabel="", ylabel="", xticks=[], yticks=[], xlim=(0, size), ylim=(0, size))
    ax.spines[:].set_visible(True)
    return ax


def draw_sectors(xy, index, *, ax, direction):
    """Draw the sectors along and across about one of a few points, and its nearest point in each.

    Parameters
    ----------
    xy : array, shape (n, 2)
        Metres.
    index : int
    direction : float
        Along, degrees.
    """
    from matplotlib.patches import Wedge

    offsets = 1000 * (np.asarray(xy) - xy[index])
    reach = np.abs(offsets).max()
    for turn, name, colour in ((direction, "along", "blue"), (direction + 90, "across", "orange")):
        for way in (turn, turn + 180):
            wedge = Wedge(
                (0, 0), reach, way - 30, way + 30, color=COLOURS[colour], alpha=0.25, lw=0
            )
            ax.add_patch(wedge)
        distances = np.linalg.norm(offsets, axis=1)
        bearing = np.degrees(np.arctan2(offsets[:, 1], offsets[:, 0])) - turn
        within = np.abs((bearing + 90) % 180 - 90) <= 30
        near = np.argmin(np.where(within & (distances > 0), distances, np.inf))
        label = f"{name}: {distances[near]:.1f} mm"
        ax.plot(*np.stack([[0, 0], offsets[near]], axis=1), color=COLOURS[colour], label=label)
    ax.plot(*offsets.T, "o", ms=4, color=COLOURS["black"])
    ax.set(xlabel="axis 1 (mm)", ylabel="axis 2 (mm)", aspect="equal")
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2, borderaxespad=0.2)
    return ax


def draw_closed_forms(forms, *, ax):
    """Draw f over the ratio: closed forms as lines, simulated means with three standard errors."""
    marks = zip("os^Dv", ("green", "purple", "blue", "vermilion", "black"), strict=True)
    cases = forms.groupby(["pattern", "axes"], sort=False)
    for (mark, colour), ((pattern, axes), rows) in zip(marks, cases, strict=True):
        look = {"color": COLOURS[colour], "label": f"{named(pattern)}, {axes}"}
        ax.plot(rows["ratio"], rows["f_predicted"], color=COLOURS[colour], lw=0.8)
        error = 3 * rows["standard_error"]
        ax.errorbar(rows["ratio"], rows["f_measured"], error, fmt=mark, ms=4, mfc="none", **look)
    ax.axhline(F0, color=COLOURS["grey"], lw=0.6, ls=":", label="threshold f0")
    ax.set(xlabel="stretched by", ylabel="f = d4/d1", ylim=(0, None))
    ax.legend(loc="upper left", bbox_to_anchor=(1, 1))
    return ax


def draw_turn(turned, *, ax):
    """Draw f over the turn of the axes, a line per cloud, and g in the margin."""
    for (name, rows), colour in zip(turned.groupby("cloud", sort=False), COLOURS, strict=False):
        ax.plot(rows["angle_deg"], rows["f"], color=COLOURS[colour], label=name)
        ax.plot(93, rows["g"].iloc[0], "<", ms=5, color=COLOURS[colour], clip_on=False)
    _mark_threshold(ax)
    ax.set(xlabel="axes turned by (degrees)", ylabel="f (lines), g (triangles)", xlim=(0, 93))
    ax.set(xticks=range(0, 91, 15), ylim=(0, None))
    return ax


def draw_map(dataset, measure, *, ax, angle, noise):
    """Draw a measure over pattern and ratio for one angle and noise: mean over sizes and seeds."""
    chosen = dataset[measure].sel(angle=angle, noise=noise)
    values = chosen.mean(["n", "seed"]).transpose("pattern", "ratio")
    ax.imshow(np.log(values), cmap=MAP, vmin=0, vmax=np.log(20), aspect="auto")
    for (row, column), value in np.ndenumerate(values.to_numpy()):
        colour = "black" if value > 4 else "white"
        ax.text(column, row, f"{value:.1f}", ha="center", va="center", fontsize=6, color=colour)
    ax.set_xticks(range(values.sizes["ratio"]), [f"{r:g}" for r in values["ratio"].to_numpy()])
    ax.set_yticks(range(values.sizes["pattern"]), [named(p) for p in values["pattern"].to_numpy()])
    ax.set(
        xlabel="stretched by", title=f"{measure}, lines {angle:g}° off the axes, {noise:g} mm noise"
    )
    ax.spines[:].set_visible(False)
    ax.tick_params(length=0)
    return ax


def draw_ranks(dataset, measure, correlations, *, ax):
    """Draw a measure over the true ratio, a colour per pattern."""
    table = dataset[[measure, "true_ratio"]].to_dataframe().reset_index()
    rng = np.random.default_rng(0)
    for kind, rows in table.groupby("pattern", sort=False):
        x = rows["true_ratio"] * np.exp(0.12 * rng.uniform(-1, 1, len(rows)))
        ax.plot(
            x, rows[measure], ".", ms=2, alpha=0.5, color=COLOURS[SHADES[kind]], rasterized=True
        )
        ax.plot([], [], "o", ms=4, color=COLOURS[SHADES[kind]], label=named(kind))
    for colour in dict.fromkeys(SHADES.values()):
        kinds = ", ".join(named(kind) for kind, shade in SHADES.items() if shade == colour)
        ax.plot([], [], "o", ms=4, color=COLOURS[colour], label=kinds)
    found = correlations.set_index("name").loc[measure]
    ax.set_title(f"rank correlation {found.rank_correlation:.2f}")
    ax.set(xscale="log", yscale="log", xlabel="true ratio across / along", ylabel=measure)
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_ticks([1, 2, 5, 10, 20], [1, 2, 5, 10, 20])
        axis.set_ticks([], minor=True)
    return ax


def draw_correlations(correlations, *, ax):
    """Draw the rank correlations with their intervals, the best on top."""
    rows = correlations.sort_values("rank_correlation")
    places = np.arange(len(rows))
    for place, row in zip(places, rows.itertuples(), strict=True):
        colour = COLOURS["vermilion" if row.name == "f" else "blue" if row.name == "g" else "grey"]
        ax.plot([row.low, row.high], [place, place], color=colour)
        ax.plot(row.rank_correlation, place, "o", ms=4, color=colour)
    ax.axvline(0, color=COLOURS["black"], lw=0.5)
    ax.set_yticks(places, rows["measure"])
    ax.set(xlabel="rank correlation", xlim=(-1, 1))
    return ax


def draw_spacings(dataset, *, ax, patterns=("scan_lines", "poisson", "hard_core")):
    """Draw d1 and d4 in units of the linear point distance sqrt(1 / density), over the ratio."""
    unit = 1000 / np.sqrt(dataset.attrs["density_per_m2"])
    turned = dataset.isel(angle=-1, noise=0, n=-1).mean("seed")
    for kind in patterns:
        for name, dash in (("d1", "-"), ("d4", "--")):
            label = f"{name}, {named(kind)}"
            values = turned[name].sel(pattern=kind) / unit
            ax.plot(turned["ratio"], values, dash, color=COLOURS[SHADES[kind]], label=label)
    root = np.sqrt(turned["ratio"])
    for values, label in ((root, r"$\sqrt{a}$"), (1 / root, r"$1/\sqrt{a}$")):
        ax.plot(turned["ratio"], values, ":", color=COLOURS["grey"], label=label)
    ax.set(xscale="log", yscale="log", xlabel="stretched by a")
    ax.set_ylabel(r"spacing in units of $\sqrt{1/\rho}$")
    ax.set_xticks(dataset["ratio"], [f"{ratio:g}" for ratio in dataset["ratio"].to_numpy()])
    ax.set_xticks([], minor=True)
    ax.set_yticks([0.2, 0.5, 1, 2, 5], [0.2, 0.5, 1, 2, 5])
    ax.set_yticks([], minor=True)
    ax.legend(loc="upper left", bbox_to_anchor=(1, 1))
    return ax


def draw_sizes(statistics, *, ax, measure, ratio, angle, patterns=("scan_lines", "poisson")):
    """Draw a measure over the noise for patterns and selection sizes, with 95 % intervals."""
    chosen = statistics[measure].sel(ratio=ratio, angle=angle)
    for kind in patterns:
        for n, dash in zip(chosen["n"].to_numpy(), ("--", "-"), strict=False):
            rows = chosen.sel(pattern=kind, n=n)
            mean, low, high = (rows.sel(statistic=name) for name in ("mean", "low", "high"))
            shade = {"color": COLOURS[SHADES[kind]]}
            label = f"{named(kind)}, n = {n}"
            ax.plot(chosen["noise"], mean, dash, marker="o", ms=3, label=label, **shade)
            ax.fill_between(chosen["noise"], low, high, alpha=0.15, lw=0, **shade)
    ax.set(xlabel="noise in the plane (mm)", ylabel=measure, ylim=(0, None))
    return ax


def draw_roundings(rounded, *, ax):
    """Draw f and g over the grid of the coordinates."""
    means = rounded.groupby(["pattern", "rounding_mm"])[["f", "g"]].mean()
    for kind in rounded["pattern"].unique():
        for name, dash in (("f", "-"), ("g", "--")):
            rows = means.loc[kind, name]
            label = f"{name}, {named(kind)}"
            ax.plot(
                rows.index, rows, dash, marker="o", ms=3, color=COLOURS[SHADES[kind]], label=label
            )
    ax.set(xscale="log", xlabel="grid of the coordinates (mm)", ylabel="f, g", ylim=(0, None))
    ax.legend(loc="upper left", bbox_to_anchor=(1, 1))
    return ax


def figure_of_pattern(kind, stretched_by, angle, noise_mm, points):
    """Return a figure of one pattern, its f over the turn of the axes, and its spacing around."""
    density = 3000.0
    size = np.sqrt(points / density)
    choices = {"ratio": stretched_by, "angle": angle, "noise": noise_mm / 1000}
    xy = point_pattern(kind, density=density, size=size, seed=1, **choices)
    found = directional_spacing(xy)
    figure, axes = subplots(1, 3, width="double", height_mm=65)
    draw_points(xy, ax=axes[0])
    turns = np.arange(0, 91, 5)
    turned = turned_f(xy, angles=turns)
    axes[1].plot(turns, turned, color=KIND_COLOURS["measured"])
    _mark_threshold(axes[1])
    axes[1].set(xlabel="axes turned by (degrees)", ylabel="f", ylim=(0, 1.1 * max(turned.max(), 5)))
    axes[1].legend(loc="lower right")
    axes[1].set_title(f"f = {turned.min():.2f} to {turned.max():.2f}")
    axes[2].plot(found.directions_deg, 1000 * found.spacing, color=KIND_COLOURS["measured"])
    axes[2].axvline(found.direction_deg, color=COLOURS["green"], ls=":")
    axes[2].set(xlabel="direction (degrees)", ylabel="spacing (mm)", ylim=(0, None))
    axes[2].set_title(f"g = {found.g:.2f}, along {found.direction_deg:.0f}°")
    return figure


def _mark_threshold(ax):
    """Draw the threshold of the tender and the value of a random pattern."""
    look = {"color": COLOURS["grey"], "lw": 0.8}
    ax.axhline(expected_f("poisson", 1), ls="--", label="random pattern", **look)
    ax.axhline(F0, ls=":", label="threshold f0", **look)
