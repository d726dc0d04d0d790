"""The figure and the page that a map is handed over with."""

import base64
import io
from html import escape

import numpy as np

from mmqa_lab import plots
from mmqa_lab.io import write_atomically

DRAWN = {
    "density": "density (points/m²)",
    "d4": "d4 (mm)",
    "f": "f = d4/d1",
    "sigma_mad": r"$\sigma_\mathrm{MAD}$ (mm)",
    "void_share": "void share",
    "linear_point_distance": "linear point distance (mm)",
}
"""The variables to draw, the first four of those that a map has, and their labels."""

PIXELS = 600
"""Cells drawn along a side; larger maps are drawn by the means of blocks."""

SLIMMEST = 4
"""Length over width of a panel; maps of streets are longer, and stretched to that."""

TERMS = """
<dl>
<dt>density</dt><dd>All points in the cell over the area of the surface in it. This is what NCHRP
Report 748 (project 15-44, 2013) calls point density. It is no <em>nominal pulse density</em>: the
USGS Lidar Base Specification (online edition 2024 rev. A) counts first returns of single swaths.
The report's classes of density (coarse, intermediate, fine) are not judged here, for want of their
thresholds at first hand: give your own with <code>--below</code>.</dd>
<dt>linear point distance</dt><dd>sqrt(1 / density): the spacing of a square lattice as dense as
the points. Specifications for airborne lidar call the like of it nominal spacing. It hides whether
points lie in lines; d1 and d4 do not.</dd>
<dt>d1..d4, f</dt><dd>Medians of the sorted distances to the nearest point in each of four
quadrants; f = d4/d1 (Pfeifer et al. 2021, doi:10.3390/rs13020237). A random even pattern has
f = 3.26.</dd>
<dt>sigma_MAD</dt><dd>1.4826 x the median absolute deviation of the points from the plane.</dd>
<dt>void share</dt><dd>Share of the surface's small squares without a point. A void is a square of
the side given here; the USGS specification's data voids, defined by the pulse spacing, are
another thing.</dd>
<dt>layers</dt><dd><em>level</em>: surfaces up to 45 degrees from the horizontal; <em>upright</em>:
steeper ones, as walls; <em>other</em>: points that show no plane, as foliage, only counted.</dd>
</dl>
"""


@plots.style()
def draw_map(dataset):
    """Return a figure with a row for each layer and a panel for each figure of the map."""
    names = [name for name in DRAWN if name in dataset][:4]
    layers = [k for k in dataset["layer"].values if (dataset["area"].sel(layer=k) > 0).any()]
    steps = {axis: int(np.ceil(dataset.sizes[axis] / PIXELS)) for axis in ("x", "y")}
    small = dataset[[*names, "area"]]
    if max(steps.values()) > 1:
        small = small.coarsen(steps, boundary="pad").mean()
    rows, columns = max(len(layers), 1), max(len(names), 1)
    shape = float(np.clip(dataset.sizes["y"] / dataset.sizes["x"], 1 / SLIMMEST, SLIMMEST))
    scale = "" if shape == dataset.sizes["y"] / dataset.sizes["x"] else ", stretched"
    height = rows * float(np.clip(178 / columns * shape, 45, 150))
    figure, axes = plots.subplots(
        rows, columns, width="double", height_mm=min(height, 230), squeeze=False, sharex=True,
        sharey=True,
    )  # fmt: skip
    for row, layer in zip(axes, layers, strict=False):
        for ax, name in zip(row, names, strict=False):
            _draw_panel(small[name].sel(layer=layer), ax, DRAWN[name])
            ax.set_aspect("auto" if scale else "equal")
        north = "northing (m)" + scale * (dataset.sizes["y"] < dataset.sizes["x"])
        row[0].set_ylabel(f"{layer}\n{north}" if layer != "horizontal" else north)
    for ax in axes[-1]:
        ax.set_xlabel("easting (m)" + scale * (dataset.sizes["x"] < dataset.sizes["y"]))
    return figure


def write_report(path, figure, table, *, title, lines, problems):
    """Write a page of one file: the figure, the table, the words, and what went wrong."""
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=200)
    text = PAGE.format(
        title=escape(title),
        lines="".join(f"<li>{escape(line)}</li>" for line in lines),
        problems=_problems(problems),
        picture=base64.b64encode(picture.getvalue()).decode(),
        table=table.to_html(index=False, float_format=lambda v: f"{v:.4g}", na_rep="", border=0),
        terms=TERMS,
    )
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def _draw_panel(values, ax, label):
    """One figure of one layer; colours between the 2nd and the 98th percentile."""
    shown = values.values
    known = shown[np.isfinite(shown)]
    low, high = np.percentile(known, [2, 98]) if len(known) else (0, 1)
    x, y = values["x"].values, values["y"].values
    half_x, half_y = _half(x), _half(y)
    extent = (0, x[-1] - x[0] + 2 * half_x, 0, y[-1] - y[0] + 2 * half_y)
    image = ax.imshow(
        shown, origin="lower", extent=extent, vmin=low, vmax=high, interpolation="nearest"
    )
    ax.figure.colorbar(image, ax=ax, label=label, location="top", shrink=0.9)


def _half(centres):
    """Half the distance between cells."""
    return (centres[1] - centres[0]) / 2 if len(centres) > 1 else 0.5


def _problems(problems):
    """What is missing from the map, or that nothing is."""
    if not problems:
        return "<p>All files and all tiles are in the map.</p>"
    rows = "".join(f"<li>{escape(problem)}</li>" for problem in problems)
    return f'<p class="failed"><b>Missing from the map:</b></p><ul>{rows}</ul>'


PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title><style>
body {{ max-width: 70em; margin: 2em auto; padding: 0 1em; font: 16px/1.5 sans-serif; color: #222 }}
img {{ max-width: 100% }} .failed {{ color: #D55E00 }}
table {{ border-collapse: collapse; font-size: 14px }}
td, th {{ padding: .2em .6em; text-align: right }}
th {{ border-bottom: 1px solid #222 }} dt {{ font-weight: bold }}
</style></head><body><h1>{title}</h1><ul>{lines}</ul>{problems}
<img src="data:image/png;base64,{picture}" alt="maps of the quality figures">
<p>Easting and northing count from the lower left corner of the map.</p>
<h2>Figures, weighted by area</h2>{table}
<p>Measured; n cells; share_below is the share of the area below the threshold.</p>
<h2>What the words mean</h2>{terms}</body></html>
"""
