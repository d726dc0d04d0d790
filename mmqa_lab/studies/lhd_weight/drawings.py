"""Figures of the study of the line-segment Hausdorff distance."""

from functools import partial

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.lines import Line2D

from mmqa_lab import lines, plots
from mmqa_lab.plots import COLOURS
from mmqa_lab.published import poreba2013

CELLS = {"true pair": "green", "false pair": "vermilion", "missed pair": "orange"}
PARTS = {"angle": "orange", "parallel": "sky", "perpendicular": "blue"}
MATCHER_LOOK = {
    "all": ("black", "-", "all (paper)"),
    "nearest": ("sky", ":", "nearest"),
    "mutual": ("purple", "--", "mutual nearest"),
    "hungarian": ("orange", "-.", "Hungarian"),
    "fragments": ("green", "--", "fragments"),
    "displaced": ("vermilion", "-", "displaced"),
}


def draw_plan(comparison, pairs, *, ax):
    """Draw both segment sets from above, the test set coloured by what became of it.

    A test segment with a false partner is vermilion and linked to it, else one that misses a true
    partner is orange, else a paired one is green; black ones have no partner and should have none.
    Model segments are grey, uprights are dots.
    """
    truth = comparison.truth
    cells = (pairs & truth, pairs & ~truth, ~pairs & truth)
    colours = np.full(len(comparison.test), COLOURS["black"], dtype=object)
    for name in ("true pair", "missed pair", "false pair"):
        cell = cells[list(CELLS).index(name)]
        colours[cell.any(axis=1)] = COLOURS[CELLS[name]]
    _draw_edges(comparison.model, np.full(len(comparison.model), "#BBBBBB"), 3.0, ax)
    _draw_edges(comparison.test, colours, 1.1, ax)
    rows, columns = np.nonzero(cells[1])
    middles = comparison.test.midpoints[rows, :2], comparison.model.midpoints[columns, :2]
    links = LineCollection(np.stack(middles, axis=1), colors=COLOURS["vermilion"], linewidths=0.7)
    ax.add_collection(links)
    counts = [int(cell.sum()) for cell in cells]
    marks = [
        Line2D([], [], color=COLOURS[colour], label=f"{count} {name}{'s' * (count != 1)}")
        for (name, colour), count in zip(CELLS.items(), counts, strict=True)
    ]
    marks.append(Line2D([], [], color="#BBBBBB", lw=3, label="model segments"))
    ax.set(xlabel="easting (m)", ylabel="northing (m)", aspect="equal")
    ax.autoscale()
    ax.legend(handles=marks, loc="center left", bbox_to_anchor=(0.02, 0.52), fontsize=6)
    return ax


def draw_matrix(comparison, *, ax, weight):
    """Draw the similarity matrix, rows and columns in the order of the true edges."""
    rows, columns = _edge_order(comparison)
    distances = comparison.directions[0][0].distance(weight)[np.ix_(rows, columns)]
    low = max(distances.min(), 0.05)
    image = ax.imshow(
        distances, norm=LogNorm(low, distances.max()), aspect="auto", interpolation="none"
    )
    ax.figure.colorbar(image, ax=ax, label=f"d (m), W = {weight:g}", shrink=0.85)
    ax.set(xlabel="model segment", ylabel="test segment")
    return ax


def draw_threshold(nearest, *, ax, sensitivity):
    """Draw the sorted nearest distances, their differences, and the threshold at the peak."""
    found = lines.peak_threshold(nearest, sensitivity=sensitivity)
    shown = found.nearest
    ax.plot(shown, ".-", color=COLOURS["black"], ms=3, label="nearest distance")
    ax.plot(np.diff(shown), color=COLOURS["sky"], label="first difference")
    ax.plot(np.diff(shown, 2), color=COLOURS["purple"], label="second difference")
    if found.peak is not None:
        value = np.diff(shown, 2)[found.peak]
        ax.plot(found.peak, value, "v", color=COLOURS["vermilion"], label="first peak")
    label = f"threshold {found.delta:.2f} m"
    ax.axhline(found.delta, color=COLOURS["vermilion"], ls="--", label=label)
    top = max(3 * found.delta, 1.0)
    ax.set(xlabel="segment, by distance", ylabel="metres", ylim=(-1.1 * top, top))
    ax.legend(loc="lower left", fontsize=6)
    return ax


def draw_pairs(comparison, pairs, *, ax):
    """Draw the binary correspondence, coloured by what is true."""
    rows, columns = _edge_order(comparison)
    truth = comparison.truth[np.ix_(rows, columns)]
    pairs = pairs[np.ix_(rows, columns)]
    codes = np.select([pairs & truth, pairs & ~truth, ~pairs & truth], [1, 2, 3], 0)
    colours = ["#F2F2F2", *(COLOURS[name] for name in CELLS.values())]
    ax.imshow(
        codes, cmap=ListedColormap(colours), vmin=0, vmax=3, aspect="auto", interpolation="none"
    )
    counts = [(codes == code).sum() for code in (1, 2, 3)]
    marks = [
        Line2D([], [], ls="", marker="s", color=COLOURS[colour], label=f"{name} ({count})")
        for (name, colour), count in zip(CELLS.items(), counts, strict=True)
    ]
    ax.legend(handles=marks, loc="upper right", fontsize=6, handletextpad=0.2, frameon=True)
    ax.set(xlabel="model segment", ylabel="test segment")
    return ax


def draw_weights(bands, *, ax, label, colour, style="-"):
    """Draw the mean of a score over W with its scene-bootstrap band."""
    ax.plot(bands["weight"], bands["mean"], style, color=COLOURS[colour], label=label)
    ax.fill_between(
        bands["weight"], bands["low"], bands["high"], color=COLOURS[colour], alpha=0.2, lw=0
    )
    ax.axvline(poreba2013.WEIGHT, color=COLOURS["grey"], lw=0.6, ls=":")
    ax.set_xscale("symlog", linthresh=1)
    ax.set_xticks([0, 1, 3, 10, 30, 100], ["0", "1", "3", "10", "30", "100"])
    ax.set(xlabel="weight W of the angle")
    return ax


def draw_settings_map(f1, *, ax):
    """Draw F1 over W and sensitivity."""
    table = f1.transpose("sensitivity", "weight")
    image = ax.imshow(table, origin="lower", aspect="auto", interpolation="none")
    for row, column in np.ndindex(table.shape):
        value = float(table[row, column])
        shade = "white" if value < float(table.mean()) else "black"
        ax.text(column, row, f"{value:.2f}", ha="center", va="center", color=shade, fontsize=6)
    ax.set_xticks(range(table.sizes["weight"]), [f"{w:g}" for w in table["weight"].to_numpy()])
    names = [f"{s:g}" for s in table["sensitivity"].to_numpy()]
    ax.set_yticks(range(table.sizes["sensitivity"]), names)
    ax.figure.colorbar(image, ax=ax, label="F1", shrink=0.85)
    ax.set(xlabel="weight W of the angle", ylabel="sensitivity of the peak (m)")
    return ax


def draw_distance_over_weight(dataset, kind, *, ax):
    """Draw what is reported over W beside the true displacement."""
    mean = dataset.sel(kind=kind).mean("seed").squeeze(drop=True)
    weights = mean["weight"].to_numpy()
    for name, label, colour, style in (
        ("lhd_m", "LHD, same W", "black", "-"),
        ("lhd_w0_m", "same pairs, W = 0", "sky", "-"),
        ("perpendicular_m", "perpendicular only", "blue", "-"),
    ):
        ax.plot(weights, mean[name], style, color=COLOURS[colour], label=label)
    for name, label, style in (
        ("true_m", "true displacement", "--"),
        ("true_perpendicular_m", "true, across the edges", ":"),
    ):
        ax.axhline(float(mean[name]), color=COLOURS["green"], ls=style, label=label)
    ax.set_xscale("symlog", linthresh=1)
    ax.set_xticks([0, 1, 3, 10, 30, 100], ["0", "1", "3", "10", "30", "100"])
    ax.set(xlabel="weight W of the angle", ylabel="distance (m)", xlim=(0, None), ylim=(0, None))
    ax.legend(loc="lower right", fontsize=6)
    return ax


def draw_shares(shares, *, ax):
    """Draw the shares of the squared distance at true pairs as stacked bars."""
    names = [f"{row.kind}\n{row.angle_noise_deg:g}°" for row in shares.itertuples()]
    bottom = np.zeros(len(shares))
    for part, colour in PARTS.items():
        ax.bar(names, shares[part], 0.7, bottom, color=COLOURS[colour], label=part)
        bottom += shares[part].to_numpy()
    ax.set(ylabel="share of d²", ylim=(0, 1))
    ax.tick_params(axis="x", labelsize=6)
    ax.legend(loc="upper left", bbox_to_anchor=(0, 1.18), ncols=3, borderaxespad=0)
    return ax


def draw_best_weights(table, *, ax):
    """Draw the range of good W over the angle noise, with the fitted rule."""
    floor = 0.1
    low = np.maximum(table["low_weight"], floor)
    high = np.maximum(table["high_weight"], floor)
    ax.vlines(
        table["angle_noise_deg"],
        low,
        high,
        color=COLOURS["blue"],
        lw=4,
        alpha=0.5,
        label="F1 within 0.01 of the best",
    )
    best = np.maximum(table["best_weight"], floor)
    ax.plot(table["angle_noise_deg"], best, "o", color=COLOURS["blue"], ms=4, label="best W")
    noise = np.geomspace(table["angle_noise_deg"].min(), table["angle_noise_deg"].max(), 50)
    rule = table.attrs["rule"]
    ax.plot(
        noise,
        rule / noise**2,
        "--",
        color=plots.KIND_COLOURS["fitted"],
        label=f"fitted: W = {rule:.1f} / σ²",
    )
    ax.axhline(poreba2013.WEIGHT, color=COLOURS["grey"], ls=":", lw=0.8, label="W = 10 (published)")
    ax.set(
        xscale="log",
        yscale="log",
        ylim=(floor * 0.8, 200),
        xlabel="noise σ of the courses' directions (°)",
        ylabel="weight W (0 drawn at 0.1)",
    )
    ax.set_xticks(table["angle_noise_deg"], [f"{v:g}" for v in table["angle_noise_deg"]])
    ax.minorticks_off()
    ax.legend(loc="upper right", fontsize=6)
    return ax


def draw_over_displacement(dataset, *, ax, value, label):
    """Draw a score or a bias over the displacement for each matcher.

    Parameters
    ----------
    dataset : Dataset
        One kind, W, sensitivity, angle noise and number of jambs.
    value : callable
        Takes the dataset, returns what to draw over displacement, matcher and seed.
    """
    values = value(dataset).mean("seed")
    rest = [dim for dim in values.dims if dim not in ("matcher", "displacement")]
    values = values.squeeze(rest, drop=True)
    for matcher in values["matcher"].to_numpy():
        colour, style, name = MATCHER_LOOK[matcher]
        curve = values.sel(matcher=matcher)
        ax.plot(values["displacement"], curve, style, color=COLOURS[colour], marker=".", label=name)
    ax.set(xlabel="common displacement (m)", ylabel=label)
    return ax


def draw_one_to_one(table, *, ax):
    """Draw false and missed pairs of each matcher, with and without over-segmentation."""
    groups = table.groupby(["segmentation", "matcher"], sort=False)[["fp", "fn"]].mean()
    names = [f"{MATCHER_LOOK[m][2]}\n{s}" for s, m in groups.index]
    places = np.arange(len(groups))
    ax.barh(places, groups["fp"], 0.7, color=COLOURS["vermilion"], label="false pairs")
    ax.barh(places, groups["fn"], 0.7, groups["fp"], color=COLOURS["orange"], label="missed pairs")
    ax.set_yticks(places, names, fontsize=6)
    ax.invert_yaxis()
    ax.set(xlabel="pairs per comparison")
    ax.legend(loc="lower right")
    return ax


def draw_targets(table, *, axes):
    """Draw F1 of every comparison by matcher as histograms, one axes for each kind."""
    base = table[table["condition"] == "as in the paper"]
    bins = np.linspace(0, 1, 41)
    for ax, (kind, part) in zip(axes, base.groupby("kind"), strict=True):
        for matcher in ("all", "displaced"):
            colour, style, name = MATCHER_LOOK[matcher]
            values = part.loc[part["matcher"] == matcher, "f1"]
            ax.hist(
                values,
                bins,
                histtype="step",
                color=COLOURS[colour],
                ls=style,
                label=f"{name}: mean {values.mean():.3f}",
            )
        ax.set(xlabel=f"F1, {kind}, measured", ylabel="simulated comparisons", xlim=(0.3, 1.02))
        ax.legend(loc="upper left")
    return axes


def draw_sweeps(table, *, ax):
    """Draw the edges of two real sweeps from above."""
    marks = []
    for name, label, colour, width in (
        ("model", "sweep b, pose applied", "#BBBBBB", 3.0),
        ("test", "sweep a", COLOURS["vermilion"], 1.1),
    ):
        one = table.attrs[name]
        _draw_edges(one, np.full(len(one), colour, dtype=object), width, ax)
        marks.append(Line2D([], [], color=colour, lw=width, label=f"{label} ({len(one)} edges)"))
    ax.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    ax.autoscale()
    ax.legend(handles=marks, loc="upper left", bbox_to_anchor=(0, 1.2), borderaxespad=0)
    return ax


def figure_of_components(angle, shift, offset, length, weight):
    """A figure of two segments and the parts of their distance, for sliders.

    Parameters
    ----------
    angle : float
        Of the test segment against the model segment, degrees.
    shift, offset : float
        Of its midpoint along and across the model segment, m.
    length : float
        Of the test segment, m; the model segment is 10 m long.
    weight : float

    Returns
    -------
    matplotlib.figure.Figure
    """
    turn = np.radians(angle)
    half = length / 2 * np.array([np.cos(turn), np.sin(turn), 0])
    middle = np.array([shift, offset, 0.0])
    test = lines.Segments([[middle - half, middle + half]])
    model = lines.Segments([[[-5.0, 0, 0], [5.0, 0, 0]]])
    parts = lines.components(test, model)
    figure, axes = plots.subplots(1, 2, width="double", height_mm=60, width_ratios=(2, 1))
    for one, colour, name in ((model, "grey", "model"), (test, "black", "test")):
        axes[0].plot(*one.ends[0, :, :2].T, "-o", ms=3, color=COLOURS[colour], label=name)
    along = length / 2 * np.array([-1, 1]) + shift
    axes[0].plot(along, [offset, offset], ":", color=COLOURS["black"], label="test, turned")
    axes[0].plot([shift, shift], [0, offset], color=COLOURS["blue"], label="perpendicular")
    axes[0].set(
        xlabel="along the model (m)",
        ylabel="across (m)",
        aspect="equal",
        xlim=(-13, 13),
        ylim=(-6, 6),
    )
    axes[0].legend(loc="upper left", ncols=2, fontsize=6)
    values = {
        "√W · angle": np.sqrt(weight) * parts.angle[0, 0],
        "parallel": parts.parallel[0, 0],
        "perpendicular": parts.perpendicular[0, 0],
        "d": parts.distance(weight)[0, 0],
    }
    colours = [COLOURS[name] for name in (*PARTS.values(), "black")]
    bars = axes[1].barh(list(values), list(values.values()), color=colours)
    axes[1].bar_label(bars, fmt="%.2f m", padding=2)
    axes[1].set(xlabel="metres", xlim=(0, 1.35 * max(*values.values(), 0.5)))
    axes[1].invert_yaxis()
    return figure


def figure_of_settings(comparison, weight, sensitivity):
    """A figure of one scene's threshold and pairs, for sliders over W and sensitivity."""
    parts = comparison.directions[0][0]
    distances = parts.distance(weight)
    nearest = distances.min(axis=1)
    pairs = distances <= lines.peak_threshold(nearest, sensitivity=sensitivity).delta
    scores = lines.pairing_scores(pairs, comparison.truth)
    figure, axes = plots.subplots(1, 2, width="double", height_mm=75)
    draw_threshold(nearest, ax=axes[0], sensitivity=sensitivity)
    draw_pairs(comparison, pairs, ax=axes[1])
    distance = lines.olhd(distances, pairs, comparison.model.lengths)
    figure.suptitle(
        f"F1 {scores.f1:.2f}, detection rate {scores.detection_rate:.1%}, OLHD {distance:.2f} m",
        fontsize=8,
    )
    return figure


def settings_of(comparison):
    """:func:`figure_of_settings` of one comparison, for the explorer."""
    return partial(figure_of_settings, comparison)


def _draw_edges(one, colours, width, ax):
    """Draw segments from above in their colours, uprights as dots."""
    upright = np.abs(one.directions[:, 2]) > 0.7
    level = ~upright
    drawn = LineCollection(one.ends[level][..., :2], colors=list(colours[level]), linewidths=width)
    ax.add_collection(drawn)
    ax.scatter(*one.midpoints[upright, :2].T, s=8 * width, color=list(colours[upright]), lw=0)


def _edge_order(comparison):
    """Rows and columns in the order of the true edges, clutter last."""
    orders = []
    for name in comparison.names:
        edge = comparison.scene.surveys[name].edge
        orders.append(np.argsort(np.where(edge < 0, edge.max() + 1, edge), kind="stable"))
    return orders
