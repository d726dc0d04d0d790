"""Figures of the imaging chart and of Table 1."""

import numpy as np

from mmqa_lab import chart_image, charts
from mmqa_lab.chart_image.line_pairs import SMALLEST_GAP, SMALLEST_PAIR_PX
from mmqa_lab.plots import COLOURS, KIND_COLOURS
from mmqa_lab.published.pfeifer2021_images import LADDER_MM, VIEWS
from mmqa_lab.studies.chart_images.rendered import ROW

STYLES = {
    "published": ("published", "_", "full"),
    "specification": ("predicted: specification", "^", "full"),
    "one spread": ("fitted: one point spread", "o", "none"),
    "per system": ("fitted: spread and motion per system", "s", "full"),
    "photograph": ("measured in rendered photographs", "s", "full"),
}
"""Label, marker and filling of each model."""


def draw_photo(image, chart_map, layout, readings, *, ax):
    """Draw a photograph of the chart with its line pairs outlined: resolved or refused."""
    ax.imshow(image, cmap="gray", interpolation="nearest")
    resolved = readings.set_index("name")["resolved"]
    for pairs in layout.of_kind(charts.LinePairs):
        low, size = np.array([pairs.x, pairs.y]), np.array([pairs.width, pairs.height])
        outline = low + size * np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]])
        colour = "sky" if resolved[pairs.name] else "vermilion"
        ax.plot(*chart_map.pixels(outline).T, color=COLOURS[colour], lw=1)
    ax.set(xticks=[], yticks=[])
    ax.spines[:].set_visible(False)
    for colour, label in (("sky", "resolved"), ("vermilion", "refused")):
        ax.plot([], [], color=COLOURS[colour], label=label)
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, 0), ncols=2)
    return ax


def draw_contrast(readings, *, ax, sigma_px=None):
    """Draw the contrast of line pairs over their width in pixels, and what counts as resolved."""
    for direction, marker, label in (("h", "o", "standing bars"), ("v", "s", "lying bars")):
        part = readings[readings["direction"] == direction].dropna(subset=["contrast"])
        for resolved, face in ((True, COLOURS["blue"]), (False, "none")):
            shown = part[part["resolved"] == resolved]
            name = label if resolved else None
            style = {"marker": marker, "ls": "", "mfc": face, "mec": COLOURS["blue"], "ms": 4}
            ax.plot(shown["width_px"], shown["contrast"], label=name, **style)
    if sigma_px is not None:
        widths = np.geomspace(1.2, 25, 200)
        curve = chart_image.expected_contrast(widths, sigma_px)
        label = f"closed form, sigma {sigma_px:g} px"
        ax.plot(widths, curve, color=COLOURS["grey"], label=label)
    ax.axhline(SMALLEST_GAP, color=COLOURS["vermilion"], ls="--", lw=0.8)
    ax.axvspan(0.5, SMALLEST_PAIR_PX, color=COLOURS["vermilion"], alpha=0.12, lw=0)
    ax.annotate("aliases\nand beats", (0.62, 0.75), color=COLOURS["vermilion"], fontsize=7)
    ax.set(xscale="log", xlim=(0.5, 40), ylim=(-0.25, 1.1))
    ax.set_xticks([0.5, 1, 2, 5, 10, 20], ["0.5", "1", "2", "5", "10", "20"])
    ax.minorticks_off()
    ax.set(xlabel="width of a line pair (pixels)", ylabel="contrast")
    ax.legend(loc="lower right")
    return ax


def draw_pixel_sizes(table, *, ax):
    """Draw published, predicted and measured horizontal pixel sizes.

    Parameters
    ----------
    table : DataFrame
        Of :func:`compare`.
    """
    part = table[(table["quantity"] == "pixel_mm") & (table["direction"] == "h")]
    names, places = _places(part)
    models = ("published", "specification", "photograph")
    for model, shift in zip(models, (-0.2, 0.0, 0.2), strict=True):
        shown = part[part["model"] == model]
        kind = shown["kind"].iloc[0]
        style = {"marker": "Dos"[models.index(model)], "ls": "", "ms": 4}
        ax.plot(
            shown["value"],
            places.loc[shown.index] + shift,
            color=KIND_COLOURS[kind],
            label=kind,
            **style,
        )
    ax.set(yticks=range(len(names)), yticklabels=names, ylim=(len(names) - 0.5, -0.5))
    ax.set(xlabel="pixel size, horizontal (mm)", xlim=(0, None))
    ax.legend(ncols=3, loc="lower center", bbox_to_anchor=(0.4, 1.0), columnspacing=1)
    return ax


def draw_spread_trials(trials, *, ax):
    """Draw how many published widths one point spread explains."""
    ax.plot(trials["sigma_px"], trials["within_one_step"], "o-", label="within one step", ms=3)
    ax.plot(trials["sigma_px"], trials["exact"], "s-", label="exactly", ms=3)
    total = int(trials["cells"].iloc[0])
    ax.axhline(total, color=COLOURS["grey"], lw=0.6)
    ax.set(xlabel="point spread, sigma (pixels)", ylabel=f"of {total} cells of Table 1")
    ax.set_ylim(0, total + 1)
    ax.legend(loc="lower left")
    return ax


def draw_widths(table, *, ax):
    """Draw the published widths and those predicted and fitted, cell by cell.

    Parameters
    ----------
    table : DataFrame
        Of :func:`compare`.
    """
    part = table[(table["quantity"] == "w_mm") & table["model"].isin(list(STYLES))]
    names, places = _places(part, direction=True)
    for model, shift in (
        ("published", 0.0),
        ("specification", -0.25),
        ("one spread", 0.0),
        ("per system", 0.25),
    ):
        shown = part[part["model"] == model]
        label, marker, filling = STYLES[model]
        colour = KIND_COLOURS[shown["kind"].iloc[0]]
        size = {"ms": 15, "mew": 2} if model == "published" else {"ms": 4}
        ax.plot(
            places.loc[shown.index] + shift,
            shown["value"],
            marker=marker,
            ls="",
            color=colour,
            fillstyle=filling,
            label=label,
            **size,
        )
    ax.set_xticks(range(len(names)), names, rotation=90)
    ax.set(yscale="log", ylabel="resolved width w (mm)", xlim=(-0.7, len(names) - 0.3))
    ax.minorticks_off()
    shown = [width for width in LADDER_MM if width >= part["value"].min()]
    ax.set_yticks(shown, [f"{width:g}" for width in shown])
    ax.grid(axis="y", lw=0.3)
    ax.legend(ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0), markerscale=0.8)
    return ax


def draw_finer(table, *, ax):
    """Draw what the built chart and a finer one say of the same photographs: intervals.

    Parameters
    ----------
    table : DataFrame
        Of :func:`finer_chart`.
    """
    names, places = _places(table, direction=True)
    y = places.to_numpy()
    finer = [max((rung for rung in LADDER_MM if rung < w), default=0) for w in table.published_mm]
    ax.hlines(y - 0.15, finer, table["published_mm"], lw=4, color=KIND_COLOURS["published"])
    known = table.dropna(subset=["w_mm", "next_mm"])
    ax.hlines(
        places.loc[known.index] + 0.15,
        known["next_mm"],
        known["w_mm"],
        lw=4,
        color=KIND_COLOURS["fitted"],
    )
    ax.plot(table["limit_mm"], y + 0.15, "|", ms=8, color=COLOURS["black"])
    for kind, label in (("published", "published reading"), ("fitted", "finer chart, fitted")):
        ax.plot([], [], lw=4, color=KIND_COLOURS[kind], label=label)
    ax.plot([], [], "|", ms=8, color=COLOURS["black"], label="interpolated")
    ax.set(yticks=range(len(names)), yticklabels=names, ylim=(len(names) - 0.5, -0.5))
    ax.set(xlabel="limit of resolution: interval of w (mm)", xlim=(0, None))
    ax.locator_params(axis="x", integer=True, nbins=6)
    ax.legend(ncols=2, loc="lower center", bbox_to_anchor=(0.35, 1.0), columnspacing=1)
    return ax


def draw_crops(crops, legibility, *, axes, element="text_4"):
    """Draw one text as each photograph shows it, with the marks of the jury and the stand-ins.

    Parameters
    ----------
    crops : dict
        Of :func:`text_crops`.
    legibility : DataFrame
        Of :func:`legibility`.
    axes : array of Axes
        As many as photographs, or more.
    """
    axes = np.ravel(axes)
    rows = legibility.set_index(ROW)
    for ax, (key, lines) in zip(axes, crops.items(), strict=False):
        row = rows.loc[key]
        crop = next(crop for crop in lines if crop.name == element)
        ax.imshow(crop.image, cmap="gray", interpolation="nearest")
        title = f"{key[0]}, {key[1]:.0f} m, {key[2]}: jury {row['jury']}"
        ax.set_title(f"{title}\nindex {row['quality_index']:.1f}, OCR {row['ocr_mark'] or '–'}")
    for ax in axes:
        ax.axis("off")
    return axes


def _places(table, direction=False):
    """Names of the rows or cells of a table in its order, and for each line which one it is."""
    names = table["system"] + " " + table["distance_m"].map("{:.0f} m".format)
    oblique = table["view"] != "orthogonal"
    names = names + np.where(oblique, " " + table["view"].str[:4] + ".", "")
    keys = [*ROW, "direction"] if direction else ROW
    if direction:
        names = names + " " + table["direction"]
    ranks = table.assign(view=table["view"].map(VIEWS.index))
    order = names[ranks.sort_values(keys).index].drop_duplicates().tolist()
    return order, names.map(order.index)
