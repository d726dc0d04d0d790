"""What must not be wrong without a word: kinds of input, asked of every function that takes data.

A row of ``CASES`` is a public function with one small example of its data; the kinds follow from
what the data are. An answer is the same as before, the stated change of it, or one sentence.
``LEFT_OUT`` has the public functions that take no data, each group with its reason; what is known
to be wrong stands in ``WAITING`` and must be taken out when it is mended.
"""

import dataclasses
import importlib
import inspect
import pkgutil
import re
import warnings
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import pyproj
import pytest
import shapely
import xarray as xr

import mmqa_lab
from mmqa_lab import charts, io, scan_pattern, simulate
from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.cloud import Cloud
from mmqa_lab.mtf.transfer import spread_edge
from mmqa_lab.simulate import cameras, canyon, systems, test_field
from mmqa_lab.simulate.targets import PointSpread, blocks, render_star

RNG = np.random.default_rng(6)


def exact(values):
    """Values that float32 holds exactly, so that a type changes nothing."""
    return np.round(np.asarray(values, dtype=float) * 2**12) / 2**12


# The data of the examples

XY = exact(RNG.random((260, 2)) * [1, 0.7])
WALL = exact(np.insert(XY, 1, RNG.normal(0, 0.01, 260), axis=1))
FIELD = exact(np.column_stack([RNG.random((500, 2)) * 4, RNG.normal(0, 0.01, 500)]))
MARKS = exact(np.column_stack([0.5 + 3 * RNG.random((12, 2)), np.zeros(12)]))
SQUARE = exact([[0.1, 0, 0.1], [0.9, 0, 0.1], [0.9, 0, 0.6], [0.1, 0, 0.6]])
TURN = np.linspace(0, 5, 40)
CIRCLE = exact(np.column_stack([np.cos(TURN), np.sin(TURN)]) + RNG.normal(0, 0.01, (40, 2)))
VALUES = exact(RNG.normal(3, 1, 40))
BLOCKS = np.repeat(np.arange(8), 5)
ENDS = np.array([[[x, y, 0], [x, y, 6]] for x in (0, 9) for y in (0, 5, 11)], dtype=float)
LINES = np.concatenate([ENDS, ENDS[:, ::-1][:3] + [[[0, 0, 0], [4, 0, 6]]]])
MOVED = exact(LINES + RNG.normal(0, 0.01, LINES.shape))
PAIRS = np.eye(len(LINES), dtype=bool)
ROWS, COLS = np.mgrid[:40, :30]
EDGE = 40 + 150 * spread_edge((COLS - 15 + 0.1 * ROWS - 2) / np.hypot(1, 0.1), 0.8, 0.1)
EDGE = np.round(EDGE + RNG.normal(0, 1, EDGE.shape))
STAR = np.round(30 + 200 * render_star((74, 74), PointSpread(0.8), cycles=20, radius_px=32))
GREY = np.round(RNG.uniform(5, 250, (64, 64)))
CHECKED = 90 + 80 * np.kron(np.indices((8, 8)).sum(axis=0) % 2, np.ones((8, 8)))
CHECKED = np.round(np.roll(CHECKED, (3, 3), (0, 1)) + RNG.normal(0, 1, (64, 64)))
ALONG, LINE = (one.ravel() for one in np.meshgrid(np.arange(-20, 21) * 0.02, np.arange(-6, 7)))
SCANNED = np.stack([0 * ALONG, 0.05 * LINE, ALONG], axis=-1) + 1e-3 * RNG.normal(size=(533, 3))
SCANNED = exact(SCANNED)
U, V = (one.ravel() * 0.08 for one in np.mgrid[:25, :25])
CORNER = np.concatenate([np.column_stack([U, V, 0 * U]), np.column_stack([U, 0 * U, V])])
FOUND = pd.DataFrame({"x_m": [0.0, 5.1, 9.0], "y_m": [0.0, 0.2, 4.0], "diameter_m": 0.2})
TRUE = pd.DataFrame({"x_m": [0.1, 5.0, 20.0], "y_m": [0.0, 0.0, 4.0], "diameter_m": 0.2})
TIMES = np.concatenate([np.arange(50) * 0.01, 100 + np.arange(50) * 0.01])
PATH = pd.DataFrame({"easting_m": [0.0, 4, 8], "northing_m": [0.0, 1, 2]})
SELECTED = pd.DataFrame({"scan": np.repeat([1, 2, 3], 4), "f": 2 + exact(RNG.random(12))})
CROSSED = pd.DataFrame(
    {"scan": np.repeat([1, 2, 3], 4), "person": np.tile([1, 1, 2, 2], 3), "f": SELECTED["f"]}
)
TARGETS = pd.DataFrame({"x_m": [0.0], "y_m": [0.0], "z_m": [0.0], "kind": "pole", "name": "a"})
POST = np.column_stack([0.1 * np.cos(TURN), 0.1 * np.sin(TURN), np.linspace(0.5, 2.5, 40)])
POST = exact(np.concatenate([POST + RNG.normal(0, 0.002, POST.shape) for _ in range(4)]))
VOTES = pd.DataFrame(
    {
        "juror": np.tile(["p", "q", "r"], 4),
        "element": np.repeat(["e", "f", "g", "h"], 3),
        "mark": list("aabbbbccbabc"),
    }
)
PLACES = {"x_px": [2, 22, 42, 62], "y_px": 2, "width_px": 16, "height_px": 16}
TARPS = pd.DataFrame(PLACES | {"reflectance": [0.05, 0.2, 0.45, np.nan], "name": list("abcd")})
TARPED = np.repeat([[600.0, 1200, 2200, 1000]], 20, axis=1).repeat(20, axis=0)
TARPED = np.round(TARPED + RNG.normal(0, 5, (20, 80)))[None]
CRITERIA = pd.DataFrame(
    {"criterion": ["density", "pairs"], "quantity": ["density_per_m2", "w_mm"]}
    | {"relation": [">=", "<="], "threshold": [3000.0, 20.0]}
)
OFFERED = pd.DataFrame(
    {"system": list("XXYY"), "quantity": ["density_per_m2", "w_mm"] * 2}
    | {"value": [4000.0, 15, 2000, 21], "sigma": [100.0, 1, 100, 2]}
)
HEIGHTS = pd.DataFrame({"dz_m": exact(RNG.normal(0, 0.01, 40)), "reason": ""})
OFFSETS = pd.DataFrame(
    {"name": [f"p{k}" for k in range(12)], "kind": "pole", "x_m": 3.0 * np.arange(12), "y_m": 1.0}
    | {"height_m": 1.0, "n": 30, "reason": ""}
    | {"dx_m": exact(RNG.normal(0, 0.01, 12)), "dy_m": exact(RNG.normal(0, 0.01, 12))}
)
STATIONS = pd.DataFrame({"easting_m": -5.0, "northing_m": 8.0 * np.arange(-3, 3), "height_m": 1.5})
PRINTED = charts.imaging_chart()


def observations():
    """A small even block of images."""
    rng = np.random.default_rng(3)
    rows = [(i, k, rng.random(), rng.uniform(0, 180)) for k in range(25) for i in range(4)]
    table = pd.DataFrame(rows, columns=["image", "tie", "radius", "azimuth_deg"])
    table["sun_zenith_deg"] = 40.0 + table["image"]
    table["view_zenith_deg"] = 30 * table["radius"]
    light = np.cos(np.radians(table["sun_zenith_deg"])) * (0.1 + 0.01 * table["tie"])
    return table.assign(radiance=light * (1 + 0.01 * rng.standard_normal(len(table))))


BLOCK = observations()
CONTROL = pd.DataFrame({"tie": range(4), "reflectance": 0.1 + 0.01 * np.arange(4), "std": 0.002})


# The functions


class Case(NamedTuple):
    """An example: what the data are, the data, and further kinds that hold for the function.

    ``order``: rows in another order change nothing, or (``rows``) only the order of the answer.
    ``shift``: nothing but coordinates follows a shift. ``scale``: every number follows a power of
    the unit. ``twice``: intervals are no narrower where every row stands twice. ``missing``: NaN
    stands for what is not known. ``large``: infinity is a large value, of which a median knows
    enough. ``array``: tables are not taken. ``tone``: grey values times a
    factor and plus an offset change nothing.
    """

    is_a: str
    data: object
    call: object
    kinds: str = ""


def of(room, name, is_a, data, kinds="", call=None, **choices):
    """A row of the table; ``call`` takes the function and the data."""

    def plain(function, data):
        return function(data, **choices)

    return f"{room}.{name}", Case(is_a, data, call or plain, kinds)


def with_pairs(function, lines):
    """Displacement of lines, of which each second half pairs as the first."""
    twice = isinstance(lines, np.ndarray) and lines.shape[:1] == (2 * len(PAIRS),)
    return function(lines, LINES, np.concatenate([PAIRS, PAIRS]) if twice else PAIRS)


CASES = dict(
    [
        of("boresight", "corrected", "cloud", WALL,
           call=lambda f, one: f(one, simulate.straight(20, 1), lever_arms_m=[[0, 0, 2]],
                                 values=[[0.1, 0, 0, 0, 0, 0]])),
        of("chart_cloud", "chart_polygon", "space", SQUARE, "shift"),
        of("chart_cloud", "evaluate_cloud", "space", WALL, "order twice"),
        of("chart_cloud", "inside_polygon", "space", WALL, "rows",
           call=lambda f, one: f(one, SQUARE)),
        of("chart_cloud", "inside_polygon:polygon", "space", SQUARE, "",
           call=lambda f, one: f(WALL, one)),
        of("chart_image", "agreement", "table", VOTES, "order"),
        of("chart_image", "check_marks", "table", VOTES, ""),
        of("chart_image", "expected_contrast", "values", exact([2.0, 5, 9]), "", sigma_px=0.8),
        of("chart_image", "four_corners", "plan", exact([[0, 0], [9, 0], [9, 7], [0, 7]]), "",
           columns=2),
        of("chart_image", "choose_images", "table", STATIONS, "",
           call=lambda f, one: f(one, SQUARE + [0, 0, 1], distance=10)),
        of("chart_image", "choose_images:corners", "space", SQUARE, "",
           call=lambda f, one: f(STATIONS, one, distance=10)),
        of("chart_image", "locate", "picture", GREY, "", call=lambda f, one: f(one, PRINTED)),
        of("charts", "decode", "values", exact(np.linspace(0, 1, 9)), "", gamma="srgb"),
        of("charts", "encode", "values", exact(np.linspace(0, 1, 9)), "", gamma="srgb"),
        of("cloud", "cells_of", "space", FIELD, "rows", size=0.5),
        of("cloud", "extent", "space", FIELD, "order scale array"),
        of("cloud", "path_distance", "space", FIELD, "rows",
           call=lambda f, one: f(one, PATH.to_numpy())),
        of("cloud", "sort_into_cells", "space", FIELD, "", size=0.5),
        of("cloud", "unit_remarks", "space", FIELD, "order"),
        of("image_targets", "measure", "table", TARPS, "missing",
           call=lambda f, one: f(TARPED, "reflect", targets=one, linear=True)),
        of("lines", "check_segments", "lines", LINES, ""),
        of("lines", "components", "lines", MOVED, "", model=LINES),
        of("lines", "correspond", "values", exact([[0.1, 0.4], [0.3, 5.0]]), "", delta=0.5),
        of("lines", "directions", "lines", LINES, "rows"),
        of("lines", "extract_edges", "space",
           exact(CORNER),
           ""),
        of("lines", "fit_displacement", "lines", MOVED, "twice", call=with_pairs),
        of("lines", "lengths", "lines", LINES, "rows scale shift"),
        of("lines", "lhd", "lines", MOVED, "order", model=LINES),
        of("lines", "match_displaced", "lines", MOVED, "", model=LINES),
        of("lines", "midpoints", "lines", LINES, "rows scale"),
        of("lines", "peak_threshold", "values",
           exact([0.31, 0.33, 0.36, 0.4, 0.41, 0.47, 0.52, 0.55, 3.2, 4.1, 7.7]), "order"),
        of("maps", "map_cloud", "space", FIELD, "order", cell=1.0),
        of("mtf", "fit_edge", "image", EDGE, "tone"),
        of("mtf", "haar_sharpness", "image", CHECKED, "tone"),
        of("mtf", "measure_star", "image", STAR, "tone",
           call=lambda f, one: f(one, (36.5, 36.5), cycles=20, radius_px=32)),
        of("plane_search", "detect_planes", "space", FIELD, ""),
        of("plane_search", "usual_size", "space", FIELD, "order shift"),
        of("planes", "fit_circle", "plan", CIRCLE, "order shift twice"),
        of("planes", "fit_line", "plan", CIRCLE[:9], "shift"),
        of("planes", "fit_plane", "space", WALL, "shift scale"),
        of("planes", "flat_points", "space", WALL, ""),
        of("planes", "sigma_mad", "values", VALUES, "order scale"),
        of("poles", "detect", "space", POST, ""),
        of("poles", "match", "table", FOUND[["x_m", "y_m"]], "", references=TRUE),
        of("poles", "score", "table", FOUND, "order", references=TRUE),
        of("poles", "score:references", "table", TRUE, "", call=lambda f, one: f(FOUND, one)),
        of("radiometry", "adjust_block", "table", BLOCK, "order", control=CONTROL),
        of("radiometry", "adjust_block:control", "table", CONTROL, "order",
           call=lambda f, one: f(BLOCK, control=one)),
        of("radiometry", "coarse_pairs", "image", GREY, "", reference=GREY[:16, :16]),
        of("radiometry", "empirical_line", "values", exact([600, 1000, 1400, 2200]), "",
           reflectance=[0.05, 0.15, 0.26, 0.45]),
        of("radiometry", "empirical_line:reflectance", "values", exact([0.05, 0.15, 0.25, 0.45]),
           "", call=lambda f, one: f([600, 1000, 1400, 2200], one)),
        of("radiometry", "fit_sensor", "values", exact([10, 20, 40, 80]), "",
           dn=[120, 221, 420, 822]),
        of("radiometry", "fit_sensor:dn", "values", exact([120, 221, 420, 822]), "",
           call=lambda f, one: f([10, 20, 40, 80], one)),
        of("radiometry", "fit_walthall", "values", exact(0.3 + 0.1 * RNG.random(12)), "",
           view_zenith=np.linspace(0, 40, 12), azimuth=np.linspace(0, 170, 12) ** 1.1 % 180),
        of("radiometry", "ndvi", "values", exact([0.4, 0.5, 0.6]), "", red=[0.1, 0.1, 0.2]),
        of("radiometry", "patch_statistics", "image", GREY, "",
           patches=[[0, 9, 0, 9], [20, 40, 20, 40]]),
        of("radiometry", "reflectance_factor", "values", exact([20, 30, 50]), "", irradiance=500.0),
        of("metrics", "supports", "space", WALL, "order",
           call=lambda f, one: f(evaluate_cloud(one))),
        of("repeatability", "evaluate_selections", "space", WALL, "order",
           polygons=[SQUARE, SQUARE + [0.02, 0, 0]]),
        of("repeatability", "operator_polygons", "space", SQUARE, "",
           call=lambda f, one: f(one, repeats=3, click=0.01, seed=1)),
        of("repeatability", "repeatability", "table", SELECTED, "order", value="f"),
        of("repeatability", "variance_components", "table", CROSSED, "order", value="f",
           factors=["scan", "person"]),
        of("rotations", "rotations", "values", exact([1.0, 2, 3]), "", pitch=0.0, heading=90.0),
        of("scan_pattern", "lattice_distances", "values", exact([0.02, 0.01]), "",
           b=np.array([0.0, 0.05])),
        of("scan_pattern", "measure_pattern", "space", SCANNED, "", scan_line=LINE),
        of("spacing", "block_numbers", "plan", XY, "rows"),
        of("spacing", "directional", "plan", XY, "order shift"),
        of("spacing", "empty_space", "plan", XY, "order shift"),
        of("spacing", "line_parts", "plan", XY, ""),
        of("spacing", "quadrant_distances", "plan", XY, "rows shift"),
        of("spacing", "quadrants", "plan", XY, "order shift"),
        of("spacing", "turned_f", "plan", XY, "order", angles=[0, 30, 60]),
        of("stats", "bootstrap", "values", VALUES, "",
           call=lambda f, one: f(np.mean, one, repeats=200)),
        of("stats", "errors", "values", VALUES, "order missing"),
        of("stats", "mean_interval", "values", VALUES, "order scale missing"),
        of("stats", "rank_correlation", "values", exact(RNG.random((3, 20))), "missing scale",
           truth=np.arange(20.0)),
        of("stats", "student_reach", "values", exact([0.1, 0.2]), "scale", freedom=[3, 9]),
        of("stats", "mean_reach", "values", VALUES, "scale", block=BLOCKS),
        of("stats", "median_interval", "values", VALUES, "scale missing large", block=BLOCKS),
        of("stats", "median_ratio_interval", "values", VALUES, "missing large",
           bottom=VALUES[::-1].copy(), block=BLOCKS),
        of("stats", "order_parts", "plan", XY, "rows", direction=10.0),
        of("tender", "qualification", "table",
           pd.DataFrame({"system": list("XXY"), "criterion": list("ded"), "verdict": "met"}), ""),
        of("tender", "verdicts", "table", CRITERIA, "", results=OFFERED),
        of("tender", "verdicts:results", "table", OFFERED, "",
           call=lambda f, one: f(CRITERIA, one)),
        of("test_field", "compare_heights", "space", FIELD, "order", reference=MARKS),
        of("test_field", "compare_heights:reference", "space", MARKS, "twice",
           call=lambda f, one: f(FIELD, one)),
        of("test_field", "height_accuracy", "table", HEIGHTS, "order missing"),
        of("test_field", "height_differences", "space", FIELD, "order shift", reference=MARKS,
           call=lambda f, one: f(one, MARKS + (one[0, 0] > 1e6) * 1e7
                                 if isinstance(one, np.ndarray) and one.ndim == 2 and len(one)
                                 and one.dtype.kind == "f" else MARKS)),
        of("test_field", "plan_accuracy", "table", OFFSETS, "order missing"),
        of("test_field", "plan_differences", "space", POST, "order", targets=TARGETS),
        of("test_field", "plan_differences:targets", "table", TARGETS, "",
           call=lambda f, one: f(POST, one)),
        of("test_field", "split_drives", "values", TIMES, ""),
        of("test_field", "thinned", "space", FIELD, "", side=0.25),
        of("test_field", "trend", "values", exact([4, 6, 7, 9, 12, 13]), "missing",
           values=[10.0, 12, 13, 15, 19, 18]),
        of("test_field", "trend:values", "values", exact([10, 12, 13, 15, 19, 18]), "missing",
           call=lambda f, one: f([4.0, 6, 7, 9, 12, 13], one)),
    ]
)  # fmt: skip

LEFT_OUT = {
    "takes points that its callers have checked": "cloud.step_of",
    "take numbers or names one by one, which _checks refuses": """
        charts.how_to_use charts.imaging_chart charts.point_chart charts.reflectance
        chart_image.chart_site chart_image.quality_index
        radiometry.relative_exposure published.number published.raw published.table rotations.fixed
        rotations.turned
        repeatability.strip_law samples.fetch samples.has_real samples.path samples.real_path
        samples.road_patch_heads scan_pattern.detail_size scan_pattern.explain_error
        scan_pattern.largest_speed scan_pattern.propagate scan_pattern.scan_lattice
        scan_pattern.speeds simulate.board simulate.box simulate.chart_corners simulate.cylinder
        simulate.ground simulate.measured simulate.rectangle simulate.scan simulate.straight
        simulate.system simulate.wall simulate.with_speed_variation spacing.exempt
        spacing.poisson_spacing stats.wilson tender.published_criteria tender.published_results
        tender.verdict bench.grid bench.heading bench.split_unit views.is_headless widgets.choice
        widgets.slider plots.style plots.subplots studies.chosen studies.notebooks_folder
        studies.results_folder io.coordinate_columns""",
    "take a result of the package": """
        chart_image.align chart_image.colour_fringes chart_image.find_tones metrics.table
        chart_image.hidden_texts chart_image.pixel_sizes chart_image.read_pattern
        bench.cell_table bench.compare bench.failures bench.figure_names bench.plot
        bench.plot_tables bench.rank bench.remarked bench.summary chart_image.read_pairs
        chart_image.evaluate_image chart_image.resolution chart_image.text_crops cloud.describe
        cloud.group_axes
        lines.compare lines.pairing_scores maps.placed maps.summarise maps.write_map
        mtf.read_bars mtf.resolving_power radiometry.stability rotations.across
        scan_pattern.revolutions_from_time""",
    "take a user's function": "bench.run widgets.explore",
    "draw": "plots.draw_points views.show_cloud",
    "read files, which benchmarks/fuzz.py damages": """
        chart_image.evaluate_file io.iterate_cloud io.own_folder io.read_bands io.read_camera
        io.read_cloud io.read_heights io.read_image io.read_polygon io.read_segments io.read_table
        io.read_trajectory io.with_numbers io.write_atomically io.write_cloud io.write_polygon
        io.read_outlines io.is_raster io.describe_file io.write_raster
        io.write_outlines maps.map_campaign maps.open_map""",
    "take minutes": "boresight.calibrate",
}

WAITING: dict[str, str] = {}
"""Kinds of which a function is known to be wrong until its room is mended."""


def functions():
    """The public functions by ``room.name``, but for those that only read, call and print."""
    found = {}
    for room in pkgutil.iter_modules(mmqa_lab.__path__):
        if not room.name.startswith("_") and room.name not in ("commands", "run"):
            module = importlib.import_module(f"mmqa_lab.{room.name}")
            for name in module.__all__:
                if inspect.isroutine(getattr(module, name)):
                    found[f"{room.name}.{name}"] = getattr(module, name)
    return found


FUNCTIONS = functions()


def test_every_public_function_is_asked_or_has_a_reason():
    left_out = set(" ".join(LEFT_OUT.values()).split())
    asked = {name.split(":")[0] for name in CASES}
    assert not asked & left_out
    assert set(FUNCTIONS) <= asked | left_out, set(FUNCTIONS) - asked - left_out
    assert asked <= set(FUNCTIONS), asked - set(FUNCTIONS)
    assert len(CASES) >= 80


# What an answer is


def leaves(found, path=""):
    """The numbers and texts of an answer, each with where it stands."""
    if isinstance(found, Cloud):
        found = {"points": found.points, **found.columns}
    if isinstance(found, xr.Dataset):
        found = {name: found[name].to_numpy() for name in found.variables}
    if isinstance(found, pd.DataFrame | pd.Series):
        found = pd.DataFrame(found)
        found = {str(name): found[name].to_numpy() for name in found}
    if isinstance(found, shapely.Geometry):
        found = shapely.get_coordinates(shapely.normalize(found))
    if dataclasses.is_dataclass(found):
        names = [field.name for field in dataclasses.fields(found)]
        found = {name: getattr(found, name) for name in names if name not in ("image", "tones")}
    if isinstance(found, Mapping):
        for name, value in found.items():
            yield from leaves(value, f"{path}.{name}")
    elif isinstance(found, list | tuple) and not all(np.isscalar(one) for one in found):
        for number, value in enumerate(found):
            yield from leaves(value, f"{path}.{number}")
    elif found is not None and not callable(found):
        array = np.asarray(found)
        if array.dtype.kind in "biuf":
            yield path, array.astype(float)
        elif array.dtype.kind in "OUT":
            yield path, array.astype(str)


def equal(one, other, tolerance=1e-9):
    """Whether two leaves are equal."""
    if one.shape != other.shape or one.dtype.kind != other.dtype.kind:
        return False
    if one.dtype.kind != "f":
        return bool((one == other).all())
    size = np.nanmax(np.abs(one[np.isfinite(one)]), initial=1e-12)
    return np.allclose(one, other, rtol=tolerance, atol=tolerance * size, equal_nan=True)


class Refused(Exception):
    """The sentence of what was refused."""


def answered(case, function, data):
    """The leaves of an answer, and the sentences said; raises ``Refused``."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            found = dict(leaves(case.call(function, data)))
        except (ValueError, TypeError, OSError, ImportError) as error:
            if str(error).startswith(("Invalid ", "Missing ")):
                raise Refused(str(error)) from error
            raise
    for one in said:
        assert not issubclass(one.category, RuntimeWarning), f"Python's own words: {one.message}"
    return found, " ".join(str(one.message) for one in said)


def differs(found, other, tolerance=1e-9):
    """The places where two answers differ."""
    names = set(found) ^ set(other)
    return [
        *names,
        *(n for n in set(found) & set(other) if not equal(found[n], other[n], tolerance)),
    ]


# The kinds


def same_data(case):
    """The data in other types and layouts: the answer is the same."""
    data = case.data
    if case.is_a == "table":
        shuffled = data.set_axis(np.random.default_rng(1).permutation(len(data)) + 7, axis=0)
        yield "columns in another order", data[data.columns[::-1]]
        yield "labels of rows", shuffled
        return
    if case.is_a == "cloud":
        yield (
            "columns in another order",
            Cloud(data, dict(reversed(of_cloud(data).columns.items()))),
        )
        return
    frozen = data.copy()
    frozen.setflags(write=False)
    yield "big-endian", data.astype(">f8")
    yield "read-only", frozen
    yield "not contiguous", np.repeat(data, 2, axis=0)[::2]
    yield "Fortran order", np.asfortranarray(data)
    yield "float32", data.astype(np.float32)
    yield "a mask that hides nothing", np.ma.MaskedArray(data, mask=False)
    yield "a list", data.tolist()
    if case.is_a in ("image", "picture"):
        yield "uint8", data.astype(np.uint8)
        yield "uint16", data.astype(np.uint16)
        yield "int16", data.astype(np.int16)
    if case.is_a in ("space", "plan") and "array" not in case.kinds:
        names = ["x_m", "y_m", "z_m"][: data.shape[1]]
        frame = pd.DataFrame(data, columns=names).assign(ring=0)
        yield "a table by its names", frame[["ring", *names[::-1]]]
    if case.is_a == "values" and data.ndim == 1:
        yield "a column of a table", pd.Series(data, index=np.arange(len(data))[::-1] + 5)


def lacking(case):
    """The data with something taken away: an answer that says so, or one sentence."""
    data = case.data
    if case.is_a == "table":
        for column in data:
            yield f"without {column}", data.drop(columns=column)
            if data[column].dtype.kind == "f":
                for name, odd in (("NaN", np.nan), ("inf", np.inf)):
                    changed = data.copy()
                    changed.loc[1 % len(data), column] = odd
                    yield f"{name} in {column}", changed
        yield "no row", data[:0]
        yield "one row", data[:1]
        return
    if case.is_a == "cloud":
        yield "without gps_time", Cloud(data)
        yield "no row", of_cloud(data)[:0]
        return
    middle = tuple(n // 2 for n in data.shape)
    for name, odd in (("NaN", np.nan), ("inf", np.inf), ("None", None)):
        changed = data.astype(object) if odd is None else data.copy()
        changed[middle] = odd
        yield name, changed
    hidden = np.ma.MaskedArray(data, mask=False)
    hidden[middle] = np.ma.masked
    yield "masked", hidden
    yield "nothing", data[:0]
    yield "one", data[:1]
    if case.is_a == "space" and "array" not in case.kinds:
        yield "feet", Cloud(data, crs=pyproj.CRS("EPSG:2263"))
    if case.is_a in ("space", "plan") and "array" not in case.kinds:
        yield "float32 far away", (data + 5e6).astype(np.float32)
    if case.is_a in ("space", "plan", "lines") and "array" not in case.kinds:
        yield "too far for a square", data * 1e200
    yield "no dimension", data.reshape(-1)[0]
    yield "texts", data.astype(str)
    yield "complex", data.astype(complex)
    if data.ndim > 1:
        yield "rows of unlike lengths", [*data[:-1].tolist(), data[-1, :-1].tolist()]
        yield "a column missing", data[..., :-1]


def of_cloud(points):
    """A cloud of an example with what came with its points."""
    columns = {"gps_time": np.linspace(1, 9, len(points)), "intensity": np.arange(len(points))}
    return Cloud(points, columns)


MUST_BE_SAID = (
    "NaN",
    "inf",
    "None",
    "masked",
    "texts",
    "complex",
    "feet",
    "float32",
    "too far",
    "rows of unlike lengths",
)


def told(name, kinds, found, said):
    """Whether an answer to data that lack something says so."""
    if "missing" in kinds and name.startswith("NaN"):
        return True
    if not name.startswith(MUST_BE_SAID) or ("large" in kinds and name == "inf"):
        return True
    unknown = any(one.dtype.kind == "f" and not np.isfinite(one).all() for one in found.values())
    return bool(said) or unknown


def wrongs(name):
    """What is wrong of a function, by kinds."""
    case, function = CASES[name], FUNCTIONS[name.split(":")[0]]
    data = of_cloud(case.data) if case.is_a == "cloud" else case.data
    wrong = {}

    def ask(kind, changed, judge):
        try:
            found, said = answered(case, function, changed)
        except Refused as sentence:
            if judge is not told_by:
                wrong[kind] = f"refused: {sentence}"
        except Exception as error:
            wrong[kind] = f"{type(error).__name__}: {error}"
        else:
            fault = judge(kind, found, said)
            if fault:
                wrong[kind] = str(fault)[:200]

    def told_by(kind, found, said):
        return "" if told(kind, case.kinds, found, said) else "an answer without a word"

    try:
        base = answered(case, function, data)[0]
    except Refused:
        base = None
    assert base is not None or case.is_a == "picture"
    if base is not None:
        for kind, changed in same_data(case):
            ask(
                kind,
                changed,
                lambda k, found, __: differs(base, found, 1e-6 if k == "float32" else 1e-9),
            )
        for kind, changed, judge in moved(case, base):
            ask(kind, changed, judge)
    for kind, changed in lacking(case):
        ask(kind, changed, told_by)
    return wrong


@pytest.mark.parametrize("name", CASES)
def test_kinds(name):
    wrong, waiting = wrongs(name), set(filter(None, WAITING.get(name, "").split("; ")))
    assert set(wrong) == waiting, "\n".join(f"{kind}: {why}" for kind, why in wrong.items())


def moved(case, base):
    """Order, shift, scale, repetition: changes of which the answer's change is known."""
    data, kinds = case.data, case.kinds.split()
    order = np.random.default_rng(2).permutation(len(data))
    if "order" in kinds:
        mixed = data.iloc[order] if case.is_a == "table" else data[order]
        if case.is_a == "table":
            mixed = mixed.reset_index(drop=True)
        yield "another order", mixed, lambda _, found, __: unordered(base, found)
    if "rows" in kinds:
        yield "another order", data[order], lambda _, found, __: [
            n for n in base if not equal(base[n][..., order] if base[n].shape[0] != len(data)
                                         else base[n][order], found[n], 1e-6)
        ]  # fmt: skip
    if "shift" in kinds:
        yield "1e7 m away", data + 1e7, lambda _, found, __: [
            n for n in base if base[n].dtype.kind == "f" and not (
                equal(base[n], found[n], 1e-5) or equal(base[n] + 1e7, found[n], 1e-12))
        ]  # fmt: skip
    if "scale" in kinds:
        for factor in (1e-3, 1e3):
            yield f"times {factor:g}", factor * data, lambda _, found, __, k=factor: [
                n for n in base if not any(equal(base[n] * k**p, found[n], 1e-6)
                                           for p in (0, 1, 2, -1, -2))
            ]  # fmt: skip
    if "tone" in kinds:
        for factor, offset in ((1e-6, 0), (1e6, 0), (1e-3, 50)):
            yield f"tones {factor:g}, {offset}", factor * data + offset, toned(base)
    if "twice" in kinds:
        again = pd.concat([data] * 2, ignore_index=True) if case.is_a == "table" else None
        again = np.concatenate([data, data]) if again is None else again
        yield "every row twice", again, lambda _, found, __: narrower(base, found)


def unordered(base, found):
    """Leaves that are not those of before but for the order of their rows."""

    def kept(one):
        return np.sort(one.reshape(-1)) if one.ndim else one

    return [n for n in base if n not in found or not equal(kept(base[n]), kept(found[n]), 1e-6)]


def toned(base):
    """Judge an answer to the same picture in other grey values: MTFs and remarks are the same."""
    return lambda _, found, __: [
        n for n in base if ("mtf" in n or "remark" in n or "sharp" in n or "width" in n)
        and not equal(base[n], found[n], 1e-3)
    ]  # fmt: skip


def narrower(base, found):
    """Deviations and intervals that got narrower though nothing new was seen."""
    return [
        n for n in base if any(part in n for part in ("std", "half", "reach"))
        and n in found and base[n].shape == found[n].shape and base[n].dtype.kind == "f"
        and (found[n] < 0.9 * base[n]).any()
    ]  # fmt: skip


# Names, and what is written and read back

ODD_NAMES = ("a b", "ü ß", "$x_1$", "50% & more#1", "<b>", "~", ".hidden", "\u05d0\u05d1")


@pytest.mark.parametrize("name", ODD_NAMES)
def test_files_of_any_name_are_written_and_read_back_as_they_were(name, tmp_path):
    folder = tmp_path / name
    points = np.array([[452123.457, 5411987.123, 511.002], [452124.0, 5411988.5, 512.25]])
    cloud = Cloud(points, {"intensity": np.array([3, 4])}, crs=pyproj.CRS("EPSG:25832"))
    io.write_cloud(folder / f"{name}.laz", cloud)
    again = io.read_cloud(folder / f"{name}.laz")
    assert np.abs(again.points - points).max() < 1e-6
    assert again["intensity"].tolist() == [3, 4]
    assert again.crs.to_epsg() == 25832
    io.write_polygon(folder / f"{name}.geojson", SQUARE + points[0])
    assert np.abs(io.read_polygon(folder / f"{name}.geojson") - SQUARE - points[0]).max() < 1e-6
    table = pd.DataFrame({"name": [name, "001"], "x_m": points[:, 0], "n": [3, 4], "reason": ""})
    io.write_atomically(folder / f"{name}.csv", table)
    read = io.read_table(folder / f"{name}.csv", "table")
    assert read["name"].tolist() == [name, "001"]
    assert read["x_m"].tolist() == points[:, 0].tolist()
    assert read["n"].tolist() == [3, 4]
    assert read["reason"].fillna("?").tolist() == ["", ""]


def test_the_home_folder_is_meant_by_its_sign(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    io.write_atomically("~/a.csv", pd.DataFrame({"a": [1]}))
    assert (tmp_path / "a.csv").is_file()
    assert len(io.read_table("~/a.csv", "table")) == 1


def test_a_result_that_was_written_is_the_same_result_when_it_is_read(tmp_path):
    heights, plan = FUNCTIONS["test_field.height_accuracy"], FUNCTIONS["test_field.plan_accuracy"]
    for function, table in ((heights, HEIGHTS), (plan, OFFSETS)):
        io.write_atomically(tmp_path / "t.csv", table)
        for again in (io.read_table(tmp_path / "t.csv", "table"), pd.read_csv(tmp_path / "t.csv")):
            assert function(again).equals(function(table))


# Independent draws

HAND_ON = "drive drive_test_field drive_past crown"
"""Functions that draw nothing themselves: they hand their seed on."""

SETUP = scan_pattern.ScanSetup(
    pulse_rate_hz=3e5, mirror_frequency_hz=100, speed_m_s=10, scanner_heading_deg=45,
    scanner_tilt_deg=45,
)  # fmt: skip
SCANNER = simulate.Scanner(pulse_rate_hz=1000, mirror_frequency_hz=10)
ROAD = simulate.Scene([simulate.ground()]), SCANNER
VIEW = cameras.chart_view(cameras.PanoramaCamera.of_megapixels(30), distance=10, layout=PRINTED)
DRAWING = {
    "bootstrap": lambda f: f(np.mean, VALUES, repeats=2, seed=3),
    "canyon": lambda f: f(3),
    "canyon_cloud": lambda f: f(canyon.canyon(1), "C1", density=0.01, seed=3),
    "expose": lambda f: f(GREY, gain=1.0, seed=3),
    "fly_block": lambda f: f(seed=3),
    "foliage": lambda f: f((0, 0, 5), 2.0, leaves=5, leaf_radius=0.1, seed=3),
    "ground": lambda f: f(test_field.make_test_field(length_m=40, seed=1), seed=3),
    "make_test_field": lambda f: f(length_m=40, seed=3),
    "measured": lambda f: f(simulate.straight(9, 9), simulate.NavigationErrors(), seed=3),
    "operator_polygons": lambda f: f(SQUARE, repeats=3, click=0.01, seed=3),
    "pass_chart": lambda f: f(systems.SYSTEM_B, 9.0, seed=3),
    "pass_chart:camera": lambda f: f(systems.SYSTEM_C, 5.0, seed=3),
    "photograph": lambda f: f(PRINTED, VIEW, margin=0, seed=3),
    "point_chart": lambda f: f(seed=3),
    "point_pattern": lambda f: f("poisson", density=9, size=1, seed=3),
    "propagate": lambda f: f(SETUP, scan_pattern.Target(range_m=8), sigmas={}, draws=100, seed=3),
    "radiance": lambda f: f(blocks.ATMOSPHERES["clean"], 0.2, seed=3),
    "scan": lambda f: f(*ROAD, simulate.straight(1, 10, start=(0, 0, 2)), seed=3),
    "street": lambda f: f("quiet", length=60, seed=3),
    "texture": lambda f: f((9, 9), seed=3),
    "with_speed_variation": lambda f: f(simulate.straight(9, 9), share=0.1, seed=3),
}


def taking_a_seed():
    """The public functions and methods of rooms that take a seed, by name."""
    for room in ("charts", "repeatability", "scan_pattern", "simulate", "stats"):
        top = importlib.import_module(f"mmqa_lab.{room}")
        inside = pkgutil.walk_packages(getattr(top, "__path__", ()), f"{top.__name__}.")
        for module in [top.__name__, *(one.name for one in inside)]:
            for found in vars(importlib.import_module(module)).values():
                for one in vars(found).values() if inspect.isclass(found) else [found]:
                    ours = inspect.isfunction(one) and one.__module__ == module
                    if (
                        ours
                        and one.__name__[0] != "_"
                        and "seed" in inspect.signature(one).parameters
                    ):
                        yield one.__name__, one


def test_functions_that_take_a_seed_draw_uncorrelated_numbers_for_one_seed(monkeypatch):
    functions = dict(taking_a_seed())
    assert {*functions} == {name.partition(":")[0] for name in DRAWING} | {*HAND_ON.split()}
    sound, drawn, begun = np.random.default_rng, {}, []

    def recorded(*seed):
        begun.append(tuple(np.ravel(seed).tolist()))
        return sound(*seed)

    monkeypatch.setattr(np.random, "default_rng", recorded)
    for name, call in DRAWING.items():
        call(functions[name.partition(":")[0]])
        keys = {key for key in begun if key and key[0] == 3}
        assert keys, name
        for key in keys:
            drawn[name, key] = sound(list(key)).standard_normal(2000)
        begun.clear()
    alike = np.triu(np.abs(np.corrcoef([*drawn.values()])) > 0.1, 1)
    assert not [[[*drawn][k] for k in pair] for pair in np.argwhere(alike)]


def test_doubts_of_results_are_remarks_and_nothing_else():
    modules = [one.name for one in pkgutil.walk_packages(mmqa_lab.__path__, "mmqa_lab.")]
    modules = [importlib.import_module(name) for name in modules if "__main__" not in name]
    classes = {one for module in modules for one in vars(module).values() if inspect.isclass(one)}
    ours = [one for one in classes if one.__module__.startswith("mmqa_lab.")]
    for one in ours:
        named = {**vars(one), **inspect.get_annotations(one)}
        assert not {"remark", "doubt", "doubts", "warning", "warnings"} & {*named}, one
        said = named.get("remarks", "tuple[str, ...]")
        if isinstance(said, property | cached_property):
            read = getattr(said, "fget", None) or said.func
            said = inspect.signature(read).return_annotation
        assert said == "tuple[str, ...]", one
    assert sum(hasattr(one, "remarks") or "remarks" in vars(one) for one in ours) >= 7
    columns = {path.name for path in Path(mmqa_lab.__file__).parent.rglob("*.py")
               if re.search(r'"remark": (?!"remarks")', path.read_text("utf-8"))}  # fmt: skip
    assert not columns
