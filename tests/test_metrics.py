"""Metrics of the field, each against a closed form or a brute force, on five clouds."""

import copy

import numpy as np
import pytest
import shapely
from scipy.spatial import Delaunay, Voronoi
from scipy.stats import qmc

from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.metrics import METRICS, table

SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
NAMES = [
    "density",
    "anps",
    "sigma_mad",
    "f",
    "g",
    "d1",
    "d2",
    "d3",
    "d4",
    "noise_of_a_mean",
    "clark_evans",
    "usgs_distribution",
    "void_5cm",
    "void_10cm",
    "e50",
    "e95",
    "e99",
    "e95_of_3",
    "fill_distance",
    "mesh_ratio",
    "voronoi_q95",
    "voronoi_cv",
    "delaunay_q95",
    "disc_q05",
    "dispersion",
    "ripley",
    "lacunarity",
    "discrepancy",
    "roughness",
    "mme",
    "mpv",
]


def cloud(kind, n=430):
    """Points of a board of 1 m with noise of 3 mm, (n, 3)."""
    rng = np.random.default_rng(5)
    xy = rng.random((n, 2))
    if kind == "hole":
        xy = xy[(np.abs(xy - [0.6, 0.45]) > 0.12).any(axis=1)]
    if kind == "clusters":
        xy = rng.choice(xy[:60], n) + 0.03 * rng.standard_normal((n, 2))
        xy = xy[(np.abs(xy - 0.5) < 0.5).all(axis=1)]
    if kind == "lines":
        xy[:, 1] = np.round(xy[:, 1] * 20 - 0.5) / 20 + 0.025 + 1e-4 * rng.standard_normal(n)
    if kind == "lattice":
        side = (np.arange(20) + 0.5) / 20
        xy = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    return np.column_stack([xy, 0.003 * rng.standard_normal(len(xy))])


def chart_of(points, turn=((1, 0, 0), (0, 1, 0), (0, 0, 1)), shift=0.0):
    """The chart of points on the board."""
    ring = np.column_stack([SQUARE, np.zeros(4)])
    return evaluate_cloud(
        points @ np.transpose(turn) + shift, polygon=ring @ np.transpose(turn) + shift, axes=0.0
    )


def brute_g(offset, away):
    """Medians of the nearest within 30 degrees of 45 directions; their second harmonic."""
    angle = np.degrees(np.arctan2(offset[..., 1], offset[..., 0]))
    degrees, spacing = np.arange(0, 180, 4), []
    for one in degrees:
        near = np.abs((angle - one + 90) % 180 - 90) <= 30
        spacing.append(np.median(np.where(near, away, np.inf).min(axis=1)))
    phase = np.angle(-np.log(spacing) @ np.exp(2j * np.radians(degrees)))
    along, across = np.interp(
        np.degrees(phase) / 2 + np.array([0, 90]), degrees, spacing, period=180
    )
    return across / along


def brute(chart):
    """Every metric anew, from the distances of all pairs and of places on a fine grid."""
    xy, residuals, n = chart.xy, chart.plane.residuals, chart.n
    ring = shapely.get_coordinates(chart.outline)[:4]
    area = chart.outline.area
    away = np.hypot(*(xy[:, None] - xy[None]).transpose(2, 0, 1))
    np.fill_diagonal(away, np.inf)
    side = (np.arange(123) + 0.5) / 123  # in no step with 20 lines
    unit = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    e1, e2 = ring[1] - ring[0], ring[3] - ring[0]
    places = ring[0] + unit @ [e1, e2]
    border = np.minimum(unit, 1 - unit).min(axis=1)
    gaps = np.hypot(*(places.T[:, :, None] - xy.T[:, None]))
    near = gaps <= 0.05
    gaps = np.partition(gaps, [0, 2], axis=1)[:, :3]

    def within(gap, share):
        """Kaplan and Meier, place by place."""
        left = 1.0
        reach, seen = np.minimum(gap, border), gap <= border
        for k, row in enumerate(np.argsort(reach)):
            left *= 1 - seen[row] / (len(gap) - k)
            if 1 - left >= share:
                return 1000 * reach[row]
        return np.nan

    def cells(size):
        """Counts of whole cells of the square; the grid is that of its box's middle."""
        local = np.linalg.solve(np.array([e1, e2]).T, (xy - ring[0]).T).T
        many = int(1 / size + 1e-3)
        place = np.floor((local - (1 - many * size) / 2) / size).astype(int)
        return np.array(
            [(place == [i, j]).all(axis=1).sum() for i in range(many) for j in range(many)]
        )

    found = {"density": n / area, "anps": 1000 * (area / n) ** 0.5}
    mad = np.median(np.abs(residuals - np.median(residuals)))
    found |= {"sigma_mad": 1482.6 * mad, "noise_of_a_mean": 1482.6 * mad * (area / n) ** 0.5}
    offset = xy[None] - xy[:, None]
    dx, dy = offset[..., 0], offset[..., 1]
    parts = [(dx > 0) & (dy >= 0), (dx <= 0) & (dy > 0), (dx < 0) & (dy <= 0), (dx >= 0) & (dy < 0)]
    four = np.sort([np.where(part, away, np.inf).min(axis=1) for part in parts], axis=0)
    four[four > 0.5] = np.nan
    d = 1000 * np.array([np.nanmedian(row) for row in four])
    found |= {f"d{k + 1}": d[k] for k in range(4)} | {"f": d[3] / d[0]}
    found["clark_evans"] = away.min(axis=1).mean() / (0.5 * (area / n) ** 0.5)
    found["usgs_distribution"] = np.mean(cells(2 * (area / n) ** 0.5) > 0)
    found |= {"void_5cm": np.mean(cells(0.05) == 0), "void_10cm": np.mean(cells(0.1) == 0)}
    found |= {f"e{q}": within(gaps[:, 0], q / 100) for q in (50, 95, 99)}
    found["e95_of_3"] = within(gaps[:, 2], 0.95)
    diagram, sizes = Voronoi(xy), []
    border_at = np.linspace(0, 1, 301)[:, None, None]
    edge = (ring + border_at * (np.roll(ring, -1, axis=0) - ring)).reshape(-1, 2)
    inside = shapely.contains_xy(chart.outline, *diagram.vertices.T)
    fine = np.concatenate([edge, diagram.vertices[inside]])
    fill = np.hypot(*(fine.T[:, :, None] - xy.T[:, None])).min(axis=1).max()
    found |= {"fill_distance": 1000 * fill, "mesh_ratio": fill / away.min()}
    found["g"] = brute_g(offset, away)
    for region in (diagram.regions[k] for k in diagram.point_region):
        corners = diagram.vertices[region]
        if region and min(region) >= 0 and shapely.contains_xy(chart.outline, *corners.T).all():
            sizes.append(shapely.MultiPoint(corners).convex_hull.area)
    sizes = np.sort(sizes)
    found["voronoi_q95"] = 1000 * sizes[np.cumsum(sizes) >= 0.95 * sum(sizes)][0] ** 0.5
    found["voronoi_cv"] = np.std(sizes, ddof=1) / np.mean(sizes)
    triangles = [shapely.Polygon(xy[one]) for one in Delaunay(xy).simplices]
    longest = [max(np.hypot(*np.diff(one.exterior.coords, axis=0).T)) for one in triangles]
    rank = np.argsort(longest)
    share = np.cumsum([triangles[k].area for k in rank])
    found["delaunay_q95"] = 1000 * np.array(longest)[rank][share >= 0.95 * share[-1]][0]
    counts = near[border >= 0.05].sum(axis=1)
    found |= {"disc_q05": np.quantile(counts, 0.05), "dispersion": np.var(counts) / np.mean(counts)}
    local = np.linalg.solve(np.array([e1, e2]).T, (xy - ring[0]).T).T
    inner = (np.minimum(local, 1 - local) > 0.1).all(axis=1)
    pairs = [(away[inner] <= r).sum(axis=1).mean() for r in np.arange(1, 11) / 100]
    found["ripley"] = max(
        1000 * ((k * area / n / np.pi) ** 0.5 - r)
        for k, r in zip(pairs, np.arange(1, 11) / 100, strict=True)
    )
    boxes = cells(0.1).astype(float)
    found["lacunarity"] = np.mean(boxes**2) / np.mean(boxes) ** 2
    found["discrepancy"] = qmc.discrepancy(local.clip(0, 1))
    xyz, rough, least, entropy = np.column_stack([xy, residuals]), [], [], []
    for k, point in enumerate(xyz):
        near = np.linalg.norm(xyz - point, axis=1) <= 0.1
        if near.sum() >= 5:
            spread = np.cov(xyz[near].T)
            least.append(1e6 * np.linalg.eigvalsh(spread)[0])
            entropy.append(0.5 * np.log(np.linalg.det(2 * np.pi * np.e * spread)))
            near[k] = False
            normal = np.linalg.svd(xyz[near] - xyz[near].mean(axis=0))[2][2]
            rough.append(1000 * abs((point - xyz[near].mean(axis=0)) @ normal))
    return found | {"roughness": np.mean(rough), "mpv": np.mean(least), "mme": np.mean(entropy)}


SAMPLED = {"e50", "e95", "e99", "e95_of_3", "disc_q05", "dispersion"}
"""From places, which a brute force takes elsewhere: every 8 mm."""


@pytest.mark.parametrize("kind", ["random", "hole", "clusters", "lines", "lattice"])
def test_every_metric_equals_a_brute_force(kind):
    chart = chart_of(cloud(kind))
    expected = brute(chart)
    assert set(expected) == set(METRICS) == set(NAMES)
    for name, value in expected.items():
        tolerance = 0.02 if name in SAMPLED else 1e-4
        tolerance = 0.01 if name in ("fill_distance", "mesh_ratio") else tolerance
        least = 1 if name == "disc_q05" else 1e-9  # a count
        assert METRICS[name](chart) == pytest.approx(value, rel=tolerance, abs=least), name


def test_all_names_are_there_with_what_a_reader_needs():
    assert set(METRICS) == set(NAMES)
    for name, one in METRICS.items():
        assert one.name == name
        assert one.better in ("less", "more")
        assert one.unit
        assert one.formula
        assert one.misses.endswith(".")
        assert one.function.__doc__
    assert len({one.source for one in METRICS.values()}) >= 12


def test_closed_forms_of_random_points_of_a_lattice_and_of_lines():
    rng = np.random.default_rng(2)
    many = np.column_stack([rng.random((9000, 2)), rng.normal(0, 0.005, 9000)])
    chart = chart_of(many)
    found = {name: METRICS[name](chart) for name in NAMES if name != "discrepancy"}
    mean = 9000 * np.pi * 0.05**2
    closed = {
        "anps": 1000 / 9000**0.5, "clark_evans": 1.0, "f": 3.257, "g": 1.0,
        "e50": 1000 * (np.log(2) / np.pi / 9000) ** 0.5, "lacunarity": 1 + 1 / 90,
        "e95": 1000 * (np.log(20) / np.pi / 9000) ** 0.5, "voronoi_cv": 0.53,
        "usgs_distribution": 1 - np.exp(-4), "noise_of_a_mean": 5 / 9000**0.5,
        "e99": 1000 * (np.log(100) / np.pi / 9000) ** 0.5,
        "disc_q05": mean - 1.645 * mean**0.5, "mpv": 25.0,
    }  # fmt: skip
    for name, value in closed.items():
        assert found[name] == pytest.approx(value, rel=0.05), name
    assert abs(found["ripley"]) < 0.5
    assert abs(found["dispersion"] - 1) < 0.15  # of some 100 discs that do not overlap
    flat = cloud("lattice")
    for name, value in {"clark_evans": 2.0, "f": 1.0, "voronoi_cv": 0.0}.items():
        assert METRICS[name](chart_of(flat)) == pytest.approx(value, abs=1e-4), name
    assert METRICS["mesh_ratio"](chart_of(flat)) == pytest.approx(0.5**0.5, rel=1e-3)


def test_shift_turn_and_order_change_nothing():
    points = cloud("clusters")
    before = {name: METRICS[name](chart_of(points)) for name in NAMES}
    c, s = np.cos(0.7), np.sin(0.7)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.array(
        [[1, 0, 0], [0, c, -s], [0, s, c]]
    )
    after = chart_of(np.random.default_rng(1).permutation(points), turn, [450_000, 5.4e6, 80])
    for name in NAMES:
        sampled = 0.02 if name in {*SAMPLED, "fill_distance", "mesh_ratio"} else 1e-4
        assert METRICS[name](after) == pytest.approx(before[name], rel=sampled), name


def test_what_cannot_be_measured_is_nan_with_a_reason():
    x, y = np.meshgrid(np.arange(4) * 0.004, np.arange(3) * 0.005)
    twice = np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()])[[*range(12), 3]]
    rows = table(evaluate_cloud(twice)).set_index("metric")
    assert rows.loc["density", "value"] > 0
    assert not rows.loc["density", "remarks"]
    reasons = {"mesh_ratio": "share their place", "void_5cm": "5 cm", "disc_q05": "10 cm",
               "ripley": "10 cm", "mme": "without noise"}  # fmt: skip
    for name, reason in reasons.items():
        assert np.isnan(rows.loc[name, "value"])
        assert reason in rows.loc[name, "remarks"]
    assert (rows["value"].isna() == (rows["remarks"] != "")).all()


def test_intervals_are_those_of_the_chart_and_own_metrics_stand_beside():
    chart = chart_of(cloud("random"))
    own = {"mine": lambda one: one.n / 10}
    rows = table(chart, ["density", "void_5cm", "mine"], own=own).set_index("metric")
    ends = chart.intervals().set_index("figure").loc["density"]
    assert rows.loc["density", ["low", "high"]].tolist() == ends[["low", "high"]].tolist()
    assert rows.loc["mine", "value"] == 43.0
    assert np.isnan(rows.loc["void_5cm", "low"])
    with pytest.raises(ValueError, match="'anps' is the nearest"):
        table(chart, ["anpd"])


def test_copies_of_a_chart_share_what_is_worked_out_and_none_of_it_can_be_written():
    chart = evaluate_cloud(np.random.default_rng(2).random((300, 3)) * [1, 1, 0.01])
    first = METRICS["e95"](chart)
    other = copy.deepcopy(chart)
    assert other.pattern is chart.pattern
    for part in ("xy", "residuals", "nearest", "discs", "cells"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(other.pattern, part)[0] = 0
    other.xy[:] = 0  # a metric may change its copy
    assert METRICS["e95"](chart) == first == METRICS["e95"](other)
