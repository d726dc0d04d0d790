"""Figures of the study; nothing is computed here that a reader may want."""

import numpy as np

from mmqa_lab.plots import COLOURS, KIND_COLOURS, subplots
from mmqa_lab.published import eurosdr2013
from mmqa_lab.studies.poles.surveys import accepted_at

METHOD_COLOURS = {"ours": COLOURS["blue"], "fgi": COLOURS["vermilion"], "itc": COLOURS["green"]}
METHOD_NAMES = {"ours": "learned (ours)", "fgi": "scan lines (FGI)", "itc": "components (ITC)"}


def draw_street(survey, name, *, ax, corridor=30.0):
    """Draw the plan of a street with hits, misses and false alarms of a method."""
    points = survey.cloud.points
    high = (points[:, 2] > 0.5) & (np.abs(points[:, 0]) < corridor)
    step = max(int(high.sum() / 30_000), 1)
    plan = points[high][::step]
    ax.plot(plan[:, 1], plan[:, 0], ",", color="0.75", rasterized=True)
    for (label, table), colour, marker in zip(
        survey.outcomes(name, corridor=corridor).items(),
        ("blue", "orange", "vermilion"),
        ("o", "s", "x"),
        strict=True,
    ):
        style = {"color": COLOURS[colour], "mfc": "none", "ms": 5, "ls": "none"}
        ax.plot(table["y_m"], table["x_m"], marker, label=f"{label} ({len(table)})", **style)
    ax.axhline(0, color=COLOURS["black"], lw=0.6)
    ax.set(xlabel="along the street (m)", ylabel="right of the path (m)", aspect="equal")
    ax.legend(ncols=3, loc="lower left", bbox_to_anchor=(0, 1.0), borderaxespad=0.2)
    return ax


def draw_operating(curves, rates, *, ax, corridor):
    """Draw precision over recall of each method, its operating point, and the published points."""
    for method, name in METHOD_NAMES.items():
        own = curves[curves["method"] == method]
        area = curves.attrs["average_precision"][method]
        colour = METHOD_COLOURS[method]
        ax.plot(own["recall"], own["precision"], color=colour, label=f"{name}, AP {area:.2f}")
        point = _point(rates, method, corridor)
        ax.errorbar(*point[:2], xerr=point[2], yerr=point[3], fmt="o", ms=4, color=colour, lw=0.8)
    for table, marker, name in (
        (eurosdr2013.table_4_1(), "*", "FGI, published"),
        (eurosdr2013.table_4_2(), "D", "ITC, published"),
    ):
        own = table[(table["corridor_m"] == corridor) & (table["class"] == "all")]
        if len(own):
            value = own.set_index("quantity")["value"]
            style = {"ls": "none", "ms": 8, "color": KIND_COLOURS["published"]}
            ax.plot(value["recall"], value["precision"], marker, label=name, **style)
    ax.set(
        xlabel=f"recall within {corridor:g} m", ylabel="precision", xlim=(0, 1), ylim=(0.4, 1.01)
    )
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1.0), borderaxespad=0.2)
    return ax


def _point(rates, method, corridor):
    """Recall, precision and the ends of their intervals as error bars."""
    own = rates[(rates["method"] == method) & (rates["corridor_m"] == corridor)]
    own = own[own["class"] == "all"].set_index("quantity")
    bars = []
    for quantity in ("recall", "precision"):
        row = own.loc[quantity]
        bars.append([[max(row["value"] - row["low"], 0)], [max(row["high"] - row["value"], 0)]])
    return own.loc["recall", "value"], own.loc["precision", "value"], *bars


def draw_beside_published(table, *, ax):
    """Draw published and measured rates with their intervals, side by side."""
    places = np.arange(len(table))
    for shift, kind, value, low, high in (
        (0.15, "published", "published", "low", "high"),
        (-0.15, "measured", "measured", "measured_low", "measured_high"),
    ):
        bars = np.nan_to_num([table[value] - table[low], table[high] - table[value]])
        style = {"fmt": "o", "ms": 3.5, "color": KIND_COLOURS[kind], "lw": 0.8, "label": kind}
        ax.errorbar(table[value], places + shift, xerr=np.maximum(bars, 0), **style)
    names = [
        f"{row.method.upper()}, {row.quantity} {row.corridor_m:g} m"
        + ("" if table.loc[row.Index, "class"] == "all" else f", {table.loc[row.Index, 'class']}")
        for row in table.itertuples()
    ]
    ax.set_yticks(places, names)
    ax.set(xlabel="rate", xlim=(0, 1.02), ylim=(len(table) - 0.5, -0.5))
    ax.legend(loc="lower left")
    return ax


def draw_factors(dataset, *, axes):
    """Draw recall and precision of each method under each change; one axes each."""
    places = np.arange(dataset.sizes["change"])
    for ax, quantity in zip(axes, ("recall", "precision"), strict=True):
        for k, (method, name) in enumerate(METHOD_NAMES.items()):
            one = dataset.sel({"method": method, "quantity": quantity})
            bars = [one["value"] - one["low"], one["high"] - one["value"]]
            style = {"fmt": "o", "ms": 3, "lw": 0.8, "color": METHOD_COLOURS[method]}
            bars = np.maximum(np.nan_to_num(bars), 0)
            ax.errorbar(one["value"], places + 0.2 * (k - 1), xerr=bars, label=name, **style)
            ax.axvline(float(one["value"][0]), color=METHOD_COLOURS[method], lw=0.5, ls=":")
        ax.set(xlabel=f"{quantity} within 30 m", xlim=(0, 1.02), ylim=(len(places) - 0.5, -0.5))
    axes[0].set_yticks(places, dataset["change"].values)
    axes[1].set_yticks(places, [])
    _legend_above(axes)
    return axes


def _legend_above(axes):
    """One legend over both axes."""
    handles, labels = axes[0].get_legend_handles_labels()
    axes[0].figure.legend(handles, labels, loc="outside upper center", ncols=3)


def draw_thresholds(table, *, ax):
    """Draw recall against precision of the scan-line method, one threshold changed at a time."""
    own = table[(table["class"] == "all") & table["quantity"].isin(["recall", "precision"])]
    wide = own.pivot(index="method", columns="quantity", values="value")
    families = sorted({name.split(" = ")[0] for name in wide.index if name != "default"})
    colours = [colour for name, colour in COLOURS.items() if name != "black"]
    taken = []
    for family, colour in zip(families, colours * 3, strict=False):
        part = wide[[name.startswith(f"{family} = ") for name in wide.index]]
        ax.plot(part["recall"], part["precision"], "o", ms=4, color=colour, label=family)
        for label, row in part.iterrows():
            at = (row["recall"], row["precision"])
            taken.append(at)
            # settings with the same outcome are written one above the other
            shift = {"xytext": (5, 7 * taken.count(at) - 5), "textcoords": "offset points"}
            ax.annotate(label.split(" = ")[1], at, color=colour, fontsize=6, **shift)
    middle = wide.loc["default"]
    star = {"ms": 9, "ls": "none", "color": COLOURS["black"], "label": "default"}
    ax.plot(middle["recall"], middle["precision"], "*", **star)
    ax.set(xlabel="recall within 30 m", ylabel="precision")
    ax.margins(0.12)
    ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return ax


def draw_range(table, *, axes):
    """Draw recall and position error over the distance from the vehicle."""
    for method, part in table.groupby("method", sort=False):
        part = part[part["n"] > 0]
        colour, label = METHOD_COLOURS[method], METHOD_NAMES[method]
        axes[0].plot(part["range_m"], part["recall"], "o-", ms=3, color=colour, label=label)
        axes[0].fill_between(part["range_m"], part["low"], part["high"], color=colour, alpha=0.15)
        errors_mm = 1000 * part["position_error_m"]
        axes[1].plot(part["range_m"], errors_mm, "o-", ms=3, color=colour, label=label)
    axes[0].set(xlabel="distance from the path (m)", ylabel="recall", ylim=(0, 1.02))
    axes[1].set(xlabel="distance from the path (m)", ylabel="median position error (mm)")
    _legend_above(axes)
    axes[1].set_ylim(bottom=0)
    return axes


def draw_causes(table, *, ax):
    """Draw the false alarms per 100 m of street by cause and method."""
    wide = table.pivot(index="cause", columns="method", values="per_100m").fillna(0)
    wide = wide.loc[wide.sum(axis=1).sort_values().index]
    places = np.arange(len(wide))
    for k, (method, name) in enumerate(METHOD_NAMES.items()):
        if method in wide:
            colour = METHOD_COLOURS[method]
            ax.barh(places + 0.27 * (1 - k), wide[method], 0.25, color=colour, label=name)
    ax.set_yticks(places, wide.index)
    ax.set(xlabel="false alarms per 100 m, within 30 m")
    ax.legend(loc="lower right")
    return ax


def draw_gates(table, *, axes):
    """Draw recall and precision over the gate of a match; one axes each."""
    return _over(table, "gate_m", "gate of a match (m)", axes)


def draw_density(table, *, axes):
    """Draw recall and precision over the density of the cloud; one axes each."""
    _over(table, "density_per_m2", "points per m² of ground within 5 m", axes)
    densities = table["density_per_m2"].unique()
    for ax in axes:
        ax.set_xscale("log")
        ax.set_xticks(densities, [f"{density:.0f}" for density in densities])
        ax.minorticks_off()
    return axes


def _over(table, column, label, axes):
    """Recall and precision of each method over a column, with their intervals."""
    for ax, quantity in zip(axes, ("recall", "precision"), strict=True):
        for method, name in METHOD_NAMES.items():
            own = table[(table["method"] == method) & (table["quantity"] == quantity)]
            colour = METHOD_COLOURS[method]
            ax.plot(own[column], own["value"], "o-", ms=3, color=colour, label=name)
            ax.fill_between(own[column], own["low"], own["high"], color=colour, alpha=0.15)
        ax.set(xlabel=label, ylabel=f"{quantity} within 30 m", ylim=(0, 1.02))
    _legend_above(axes)
    return axes


def draw_facades(table, *, ax):
    """Draw completeness, correctness and quality of the class of walls over the distance."""
    own = table[table["range_m"].notna() & (table["n"] > 0)]
    for name, colour, line in (
        ("completeness", "blue", "o-"),
        ("correctness", "orange", "o-"),
        ("quality", "black", "x:"),
    ):
        ax.plot(own["range_m"], own[name], line, ms=4, color=COLOURS[colour], label=name)
    ax.set(xlabel="distance from the path (m)", ylabel="share of facade points", ylim=(0, 1.02))
    ax.legend(loc="lower left")
    return ax


def draw_reach(table, *, ax):
    """Draw what was to be reached and what was obtained, with intervals."""
    own = table[table["unit"] == "1"].reset_index(drop=True)
    places = np.arange(len(own))
    bars = np.nan_to_num([own["value"] - own["low"], own["high"] - own["value"]])
    style = {"fmt": "o", "ms": 3.5, "lw": 0.8, "color": COLOURS["blue"], "label": "measured"}
    ax.errorbar(own["value"], places, xerr=np.maximum(bars, 0), **style)
    ax.plot(own["aim"], places, "|", ms=9, mew=1.5, color=COLOURS["vermilion"], label="aim")
    names = [f"{row.setting}: {row.quantity}" for row in own.itertuples()]
    ax.set_yticks(places, names)
    ax.set(xlabel="rate of the learned method", xlim=(0.6, 1.005), ylim=(len(own) - 0.5, -0.5))
    ax.legend(loc="lower left")
    return ax


def figure_of_threshold(survey):
    """Return a function that draws a street at an operating point of the learned method."""
    candidates = survey.found["ours"]

    def draw(threshold):
        """The plan with what a threshold accepts."""
        survey.found["at threshold"] = accepted_at(candidates, threshold)
        figure, ax = subplots(width="double", height_mm=95)
        draw_street(survey, "at threshold", ax=ax)
        result = survey.score("at threshold", corridor=30.0)
        ax.set_title(f"recall {result.recall}, precision {result.precision}", loc="right")
        return figure

    return draw
