"""The point-distribution chart: Table 2 as published, and the same metrics on real clouds."""

import numpy as np
import pandas as pd

from mmqa_lab import io, samples
from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.planes import PAPER_SCALE
from mmqa_lab.plots import COLOURS, draw_points, subplots
from mmqa_lab.published import pfeifer2021
from mmqa_lab.run import Check
from mmqa_lab.spacing.quadrants import poisson_spacing

HEAD_GAP_S = 0.01
"""The two scan heads of the road patch passed it one after the other, this far apart or more."""

BOARDS = {
    "board, VLP-16": "boards/vlp16_pose02.laz",
    "board, 64 rings": "boards/os64_pose02.laz",
}
"""Real clouds of flat boards in the folder that MMQA_DATA names."""


def road_patch_heads(cloud):
    """Split the road patch by scan head and drop repeated points.

    Parameters
    ----------
    cloud : Cloud
        With ``gps_time``.

    Returns
    -------
    dict of str to array, shape (n, 3)
        ``head A``, ``head B`` and ``both heads``, each without repeats.
    """
    times = np.sort(cloud["gps_time"])
    gap = np.argmax(np.diff(times))
    if times[gap + 1] - times[gap] < HEAD_GAP_S:
        raise ValueError(
            f"Invalid cloud {cloud.name}: no gap in GPS time. Must be {HEAD_GAP_S} s or more."
        )
    first = cloud["gps_time"] <= times[gap]
    parts = {"head A": first, "head B": ~first, "both heads": np.ones(len(cloud), dtype=bool)}
    return {name: np.unique(cloud.points[mask], axis=0) for name, mask in parts.items()}


def real_clouds():
    """Return the real clouds at hand: the road patch always, boards where MMQA_DATA has them."""
    clouds = road_patch_heads(io.read_cloud(samples.path("road_patch")))
    for name, relative in BOARDS.items():
        if samples.has_real(relative):
            clouds[name] = io.read_cloud(samples.real_path(relative), columns=()).points
    return clouds


def compute(clouds):
    """Evaluate clouds as the paper does: principal axes, hull density, its factor of sigma_MAD.

    Parameters
    ----------
    clouds : dict of str to array, shape (n, 3)

    Returns
    -------
    DataFrame
        ``cloud``, ``kind`` = measured, the figures of
        :class:`mmqa_lab.chart_cloud.CloudQuality`, and ``f_poisson``, ``d1_poisson_mm``: what a
        random pattern of that density has.
    """
    rows = []
    for name, points in clouds.items():
        quality = evaluate_cloud(points, scale=PAPER_SCALE)
        random = 1000 * poisson_spacing(quality.density_hull_per_m2)
        rows.append(
            quality.to_frame().assign(
                cloud=name,
                kind="measured",
                d1_poisson_mm=random[0],
                f_poisson=random[3] / random[0],
            )
        )
    table = pd.concat(rows, ignore_index=True)
    return table[["cloud", "kind", *table.columns.drop(["cloud", "kind"])]]


def draw_quadrants(xy, index, distances, *, ax):
    """Draw the four quadrants of one of a few points, and the nearest point in each.

    Parameters
    ----------
    xy : array, shape (n, 2)
        Metres.
    index : int
        The point whose quadrants are drawn.
    distances : array, shape (n, 4)
        From :func:`mmqa_lab.spacing.quadrants.quadrant_distances`.
    """
    xy = 1000 * np.asarray(xy)
    centre = xy[index]
    ax.axhline(centre[1], color=COLOURS["grey"], lw=0.6)
    ax.axvline(centre[0], color=COLOURS["grey"], lw=0.6)
    gaps = np.linalg.norm(xy - centre, axis=1)
    for rank, distance in enumerate(1000 * distances[index]):
        if np.isfinite(distance):
            near = xy[np.argmin(np.abs(gaps - distance))]
            ax.plot(*np.stack([centre, near], axis=1), color=COLOURS["vermilion"])
            ax.annotate(f"d{rank + 1}", (centre + near) / 2, fontsize=7)
    ax.plot(*xy.T, "o", ms=4, color=COLOURS["blue"])
    ax.plot(*centre, "o", ms=6, color=COLOURS["black"])
    ax.set(xlabel="axis 1 (mm)", ylabel="axis 2 (mm)", aspect="equal")
    return ax


def draw_rounding(check, *, ax):
    """Draw the printed f against what the printed d1 and d4 allow."""
    known = check.dropna(subset=["f"])
    names = [f"{row.system} at {row.distance_m:.0f} m" for row in known.itertuples()]
    places = np.arange(len(known))
    ax.hlines(places, known["f_low"], known["f_high"], lw=5, color=COLOURS["sky"])
    ax.plot(known["f"], places, "|", ms=12, color=COLOURS["black"])
    ax.axvline(pfeifer2021.F_THRESHOLD, color=COLOURS["vermilion"], ls="--", lw=0.8)
    ax.set(yticks=places, yticklabels=names, xlabel="f = d4/d1", ylim=(len(known) - 0.5, -0.7))
    ax.annotate("threshold", (2.1, -0.45), color=COLOURS["vermilion"], fontsize=7, va="center")
    return ax


def draw_spacings(table, *, ax):
    """Draw the four spacings of each cloud, and those of a random pattern as short lines."""
    places = np.arange(len(table))
    for rank, colour in enumerate(("blue", "sky", "green", "orange")):
        values = table[f"d{rank + 1}_mm"]
        ax.bar(
            places + 0.2 * (rank - 1.5), values, 0.18, color=COLOURS[colour], label=f"d{rank + 1}"
        )
    random = {"color": COLOURS["black"], "lw": 1.2}
    d1, d4 = table["d1_poisson_mm"], table["d1_poisson_mm"] * table["f_poisson"]
    ax.hlines(d1, places - 0.4, places - 0.2, label="random pattern", **random)
    ax.hlines(d4, places + 0.2, places + 0.4, **random)
    for place, row in zip(places, table.itertuples(), strict=True):
        ax.annotate(f"f = {row.f:.1f}", (place, row.d4_mm), ha="center", va="bottom", fontsize=7)
    ax.set_xticks(places, [name.replace(", ", ",\n") for name in table["cloud"]])
    ax.set(ylabel="spacing (mm)", ylim=(0, 1.15 * table["d4_mm"].max()))
    ax.legend(ncols=5, loc="upper left", bbox_to_anchor=(0, 1.17), columnspacing=1)
    return ax


def figure_of_axes(cloud):
    """Return a function that draws f of a cloud for turned axes and a search radius."""

    def draw(angle, radius_mm):
        """The points of a 20 cm window with the axes, and what they give."""
        quality = evaluate_cloud(cloud, axes=angle, radius=radius_mm / 1000)
        xy = quality.plane.project(cloud)
        figure, ax = subplots(height_mm=85)
        draw_points(xy[np.abs(xy).max(axis=1) < 0.1], ax=ax)
        for turn in (angle, angle + 90):
            way = 0.1 * np.array([np.cos(np.radians(turn)), np.sin(np.radians(turn))])
            ax.plot(*np.stack([-way, way], axis=1), color=COLOURS["vermilion"])
        spacings = f"d1 = {quality.d1_mm:.1f} mm, d4 = {quality.d4_mm:.1f} mm"
        share = f"{100 * quality.incomplete_share:.1f} % of points incomplete"
        ax.set_title(f"f = {quality.f:.2f}  ({spacings}, {share})")
        return figure

    return draw


def checks(table, check):
    """Test what the notebook says of the published table and of the road patch."""
    by_cloud = table.set_index("cloud")
    patch = by_cloud.loc[["head A", "head B", "both heads"], "f"]
    regular = check.query("system == 'A' and distance_m == 5").iloc[0]
    known = check.dropna(subset=["f"])
    yield from [
        Check(
            "Every published f is d4/d1 within the rounding of the spacings.",
            bool(known["f_consistent"].all()),
            f"{int(known['f_consistent'].sum())} of {len(known)} rows",
            "half a unit of the last printed digit",
        ),
        Check(
            "At 5 m, system A's density is below every density its printed spacings allow on a "
            "lattice.",
            bool(regular["density_per_m2"] < regular["lattice_low_per_m2"]),
            f"{regular['density_per_m2']:.0f} < {regular['lattice_low_per_m2']:.0f} points/m²",
            "half a millimetre of d1 and d4",
        ),
        Check(
            "Two scan heads together are more even than either of them.",
            bool(patch["both heads"] < patch[["head A", "head B"]].min()),
            ", ".join(f"{name} {f:.1f}" for name, f in patch.items()),
            "an order, no tolerance",
        ),
        Check(
            "Coordinates rounded to 1 cm leave d1 of head A at one rounding step.",
            bool(abs(by_cloud.loc["head A", "d1_mm"] - 10) < 0.1),
            f"d1 = {by_cloud.loc['head A', 'd1_mm']:.2f} mm",
            "the plane's tilt changes a step by less than 0.1 mm",
        ),
    ]
