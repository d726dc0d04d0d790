"""Bad input of commands and functions: a call, a part of the sentence, and nothing is written."""

import re
import shlex
from dataclasses import replace

import cv2
import laspy
import numpy as np
import pandas as pd
import pyproj
import pytest
import shapely

from mmqa_lab import (
    chart_cloud,
    chart_image,
    charts,
    io,
    lines,
    mtf,
    planes,
    plots,
    radiometry,
    repeatability,
    samples,
    scan_pattern,
    simulate,
    spacing,
    stats,
)
from mmqa_lab.__main__ import main
from mmqa_lab._checks import arrays, check_count, check_number
from mmqa_lab.cloud import Cloud, cells_of
from mmqa_lab.scan_pattern import mimic
from mmqa_lab.simulate import cameras
from mmqa_lab.simulate.point_patterns import point_pattern
from mmqa_lab.test_field import plan_differences, split_drives

PATCH = str(samples.path("road_patch"))
PLAN = "plan --pulse-rate 3e5 --mirror-frequency 100 --speed 10 --range 5"

COMMANDS = [
    ("info none.laz", "none.laz: no such file. Must exist."),
    ("info notes.md", "Must be one of .las, .laz"),
    ("info --csv feet.laz zone32.laz", "Invalid file feet.laz. Must end in .csv."),
    ("poles words.csv --csv words.csv", "words.csv: it is an input. Must be another file."),
    ("accuracy PATCH heights.csv --out heights.csv", "heights.csv: it is an input."),
    ("evaluate cut.laz", "Must be a complete LAS or LAZ file."),
    ("evaluate lying.las", "1000000000000 points in so few bytes"),
    ("evaluate empty.las", "no points. Must contain one or more."),
    ("evaluate broken.ply", "Must be a PLY file with vertices x, y, z."),
    ("evaluate nan.xyz", "no points. Must contain one or more."),
    ("evaluate two_columns.xyz", "with columns x, y. Must have x, y, z in metres."),
    ("evaluate empty.xyz", "no rows. Must be rows of columns."),
    ("evaluate words.xyz", "no finite number in row 1 of column x, 'a'. Must be numbers."),
    ("evaluate two.xyz", "2 given. Must be 3 or more."),
    ("evaluate line.xyz", "Must span a plane."),
    ("evaluate unnamed.csv", "with columns id, lat, lon. Must have x, y, z in metres."),
    ("evaluate class_first.xyz", "its first columns are not x, y, z."),
    ("evaluate short.csv", "3 names over 4 columns. Must agree."),
    ("evaluate PATCH --out figure.docx", "Must end in .pdf, .png, .svg."),
    ("evaluate PATCH --rho0 -5", "Invalid rho0 -5.0. Must be > 0 points per m2."),
    ("evaluate PATCH --radius 0", "Invalid radius 0.0. Must be > 0 m."),
    ("evaluate PATCH --reach 1", "--reach"),
    ("evaluate PATCH --polygon words.csv", "words.csv"),
    (
        "evaluate PATCH --polygon number.geojson",
        "damaged, cut short or of another kind. Must be GeoJSON",
    ),
    ("evaluate PATCH --polygon flat.geojson", "Must be GeoJSON with numbers as vertices."),
    ("evaluate PATCH --polygon far.csv", "1e+99 in it. Must be in metres."),
    ("evaluate PATCH --polygon farther.csv", "no finite number in row 2 of column x, '1e+308'"),
    ("evaluate floats.ply", "line 'property list float int of'. Must be a PLY file with"),
    ("evaluate zero_byte.xyz", "zero_byte.xyz: a zero byte in line 2. Must be text."),
    ("tender cut.laz pfeifer2021", "cut.laz: a zero byte in line 1. Must be text."),
    ("tender wide.csv pfeifer2021", "column 26, column .... Must have one."),
    ("accuracy PATCH no_pages.tif", "damaged, cut short or of another kind. Must be a raster"),
    ("lhd segments.csv segments.csv", "Invalid sets segments.csv with 3 segments. Must be two"),
    ("evaluate PATCH --polygon list.geojson", "of type unknown. Must be one polygon or more."),
    ("evaluate PATCH --polygon degrees.geojson", "(WGS 84 (CRS84)). Must be projected, in metres."),
    ("evaluate zone32.laz --polygon zone33.geojson", "inside the polygon: 0 given"),
    ("evaluate PATCH --polygon '0,0,0; 1,0,0; 1,1,0'", "inside the polygon: 0 given. Must be 3"),
    ("evaluate PATCH --polygon '0,0,0; 1,0,0'", "Invalid polygon: 2 given. Must be 3 or more."),
    ("evaluate PATCH --polygon '0,0,0; 1,a,0'", "1,a,0'. Must be 'x,y,z; x,y,z; x,y,z'."),
    ("evaluate PATCH --polygon '0,0,0; 1,1,0; 1,0,0; 0,1,0'", "Must be an outline that encloses"),
    ("evaluate PATCH --polygon bent.csv", "Must be at most 50 mm, half of the thickness."),
    ("map folder --out m.nc", "Must contain .las or .laz files."),
    ("map PATCH --out m.docx", "Invalid map m.docx. Must end in .nc, .tif."),
    ("map PATCH --out m.nc --cell 0", "Invalid cell 0.0. Must be > 0 m."),
    ("plan --scanner vq-450 --speed 0 --range 5", "Invalid speed_m_s 0.0. Must be > 0"),
    (f"{PLAN} --sigma speed", "Must be like speed_m_s=0.2."),
    ("plan --scanner toaster --speed 5 --range 5", "Invalid scanner 'toaster'. Must be one of"),
    ("plan --speed 5 --range 5", "Must have --pulse-rate and --mirror-frequency, or --scanner."),
    ("lhd words.csv segments.csv", "no column 'x1'"),
    ("lhd nan_segments.csv segments.csv", "no finite number in row 4 of column z1, nothing. Must"),
    ("lhd segments.csv moved.csv --weight -1", "Invalid weight -1"),
    ("poles PATCH --method own", "own"),
    ("poles PATCH --trajectory words.csv", "Must have time in seconds; easting"),
    (
        "poles PATCH --reference words.csv",
        "no column 'x_m' beside alpha, beta, gamma. Must have one.",
    ),
    ("accuracy PATCH", "Must have either REFERENCE or --targets."),
    ("accuracy PATCH broken.tif", "broken.tif"),
    ("accuracy PATCH heights.csv", "Must overlap, in one coordinate system."),
    ("poles PATCH --trajectory repeated.csv", "a time repeats."),
    ("poles PATCH --trajectory gap.csv", "no finite number in row 2"),
    ("accuracy PATCH heights.csv --radius -1", "Invalid radius -1"),
    ("accuracy zone32.laz zone33.laz", "zone 33N. Must be in ETRS89 / UTM zone 32N"),
    ("accuracy PATCH --targets trees.csv", "Invalid kind 'tree'. Must be one of"),
    ("calibrate PATCH PATCH --trajectory path.csv --lever-arm 1,a,2", "Must be X,Y,Z."),
    ("calibrate PATCH PATCH --trajectory path.csv --lever-arm 1,2", "Must be X,Y,Z."),
    (
        "calibrate PATCH --trajectory path.csv --lever-arm -1,2,3 --lever-arm -1,2",
        "Must be X,Y,Z.",
    ),
    ("accuracy PATCH --targets no_height.csv", "no column 'z_m' beside x_m, y_m"),
    ("accuracy PATCH --targets no_rows.csv", "Invalid targets: none given."),
    ("image grey.png --corners '-1,1; 2,2; 3'", "Must be four times x,y between ;."),
    ("chart --out chart.docx", "Invalid ending '.docx'. Must be one of .pdf, .svg."),
    ("image words.csv", "no image that can be decoded. Must be a complete JPEG"),
    ("image cut.png", "cut short. Must be a complete JPEG, PNG or TIFF file"),
    ("image no_pages.tif", "of another kind. Must be a complete JPEG, PNG or TIFF file"),
    ("image grey.png --corners '1,1; a,2'", "Must be four times x,y between ;."),
    ("radiometry star grey.png", "Invalid star without targets. Must have --targets."),
    ("radiometry star grey.png --targets path.csv", "no column 'x_px'"),
    ("radiometry reflect grey.png --targets region.csv", "Must have 16, or be linear."),
    ("radiometry edge grey.png --targets region.csv", "Must be within 200 x 150 pixels."),
    ("tender words.csv pfeifer2021", "criterion"),
    ("tender pfeifer2021:3 pfeifer2021", "pfeifer2021:3"),
    ("bench nowhere", "Invalid study 'nowhere'. Must be one of"),
    ("bench anisotropy --method os:nothing", "Must be MODULE:FUNCTION."),
    ("student copies nowhere", "Invalid study 'nowhere'. Must be one of"),
    ("evalute PATCH", 'Did you mean "evaluate"?'),
]

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
BOW = np.array([[0.0, 0.0], [1, 1], [1, 0], [0, 1]])
POLE = pd.DataFrame({"x_m": [0.0], "y_m": [0.0], "z_m": [0.0]})
HEAD = {"pulse_rate_hz": 3e5, "mirror_frequency_hz": 100, "speed_m_s": 10}
SETUP, WALL = scan_pattern.ScanSetup(**HEAD), scan_pattern.Target(range_m=5)
TWO_SPOTS = scan_pattern.Patch([[5.0, 0, 0], [6, 0, 0]], [[-1.0, 0, 0]] * 2)
AT_IT = scan_pattern.Patch([[0.0, 3, 0]], [[-1.0, 0, 0]])
LINES = np.stack(np.meshgrid([0.0], np.arange(9) / 9, np.arange(9) / 9), axis=-1).reshape(-1, 3)
EDGE = np.array([[[0, 0, 0], [1, 0, 0.0]]])
SCANNER = simulate.Scanner(pulse_rate_hz=3e5, mirror_frequency_hz=100)
DRIVE = simulate.straight(10, 1)
CAMERA, CHART = cameras.PanoramaCamera(2000), charts.imaging_chart()
VOTES = pd.DataFrame({"juror": [1], "element": ["x"], "mark": ["a"]})
RATED = pd.DataFrame({"scan": [1, 1, 2], "f": [1, 2, 3.0]})

FUNCTIONS = [
    (lambda: chart_cloud.evaluate_cloud("road_patch.laz"), "Must be real numbers."),
    (lambda: chart_cloud.evaluate_cloud(SQUARE[:, :2]), "Must have shape (n, 3)."),
    (lambda: chart_cloud.evaluate_cloud(SQUARE, radius=0), "Invalid radius 0. Must be > 0 m."),
    (lambda: chart_cloud.inside_polygon(SQUARE, SQUARE[:2]), "2 given. Must be 3 or more."),
    (lambda: chart_cloud.chart_polygon(SQUARE, margins=0.6), "and leave some of the chart."),
    (lambda: chart_cloud.evaluate_cloud(SQUARE, axes="up"), "Must be one of principal, horizontal"),
    (lambda: chart_cloud.evaluate_cloud(SQUARE, axes=np.nan), "Invalid axes nan. Must be finite."),
    (lambda: chart_cloud.evaluate_cloud(SQUARE, scale=0), "Invalid scale 0. Must be > 0."),
    (lambda: spacing.quadrants(SQUARE * np.nan), "4 of 4 not finite, the first in row 0"),
    (lambda: spacing.quadrants(SQUARE, angle=np.nan), "Invalid angle nan. Must be finite."),
    (lambda: spacing.quadrant_distances(SQUARE, of=[0, 1]), "Must be bool of shape (4,)."),
    (lambda: spacing.directional(SQUARE[:1, :2]), "1 given. Must be 2 or more."),
    (lambda: spacing.poisson_spacing(0), "Invalid density 0. Must be > 0 points per m2."),
    (
        lambda: io.read_cloud(PATCH, columns=["ring"]),
        "no column 'ring' beside intensity, return_number",
    ),
    (lambda: io.write_cloud("c.ply", SQUARE), "Must be one of .las, .laz."),
    (lambda: plots.style("Nature").__enter__(), "Invalid journal 'Nature'. Must be one of"),
    (lambda: plots.subplots(width="triple"), "Invalid width 'triple'. Must be one of"),
    (lambda: samples.path("moon"), "Invalid sample 'moon'. Must be one of"),
    (lambda: replace(SETUP, pulse_rate_hz=0), "Invalid pulse_rate_hz 0. Must be > 0"),
    (lambda: replace(SETUP, pulse_rate_hz=50), "Must be 100 pulses a revolution or more."),
    (lambda: replace(SETUP, scanner_tilt_deg=90), "off the direction of travel."),
    (lambda: replace(SETUP, speed_m_s="fast"), "Invalid speed_m_s 'fast'. Must be a number"),
    (lambda: replace(WALL, heading_deg=-95).patch(SETUP), "Must let the horizontal pulse strike"),
    (lambda: scan_pattern.propagate(SETUP, WALL, sigmas={"wind": 1}), "Invalid input 'wind'."),
    (
        lambda: scan_pattern.largest_speed(SETUP, WALL, quantity="f", limit=0.5),
        "Must be reached between",
    ),
    (lambda: scan_pattern.explain_error(SETUP, WALL, quantity="f", measured=2), "quantity 'f'"),
    (lambda: scan_pattern.scan_lattice(SETUP, AT_IT), "Invalid points: no length"),
    (lambda: split_drives([1, 2], gap_s=np.nan), "Invalid gap_s nan."),
    (lambda: cells_of([[1e12, 1]], 1e-9), "Invalid cells of 1e-09: 1e+21 of them on an axis."),
    (lambda: cells_of([[1e30, 1]], 1.0), "1e+30 in it. Must be in metres."),
    (lambda: lines.extract_edges([*LINES, [1e9, 1e9, 0]]), "too wide for cells of"),
    (lambda: scan_pattern.measure_pattern(LINES[:5]), "Must be 12 or more."),
    (lambda: scan_pattern.measure_pattern(LINES), "without gps_time and scan_line. Must have one"),
    (lambda: scan_pattern.measure_pattern(LINES, gps_time=[0] * 3), "gps_time of shape (3,)."),
    (lambda: scan_pattern.measure_pattern(LINES, gps_time=[0] * 81), "time without pauses"),
    (lambda: scan_pattern.measure_pattern(LINES, gps_time=np.arange(81) * 1e5), "a week's end"),
    (lambda: scan_pattern.speeds(SETUP, TWO_SPOTS, detail=0.05), "2 spots. Must be a single spot"),
    (lambda: scan_pattern.measure_pattern(LINES, scan_line=[0] * 81), "Invalid patch: 1 profiles"),
    (lambda: mimic.profile_spacing_horizontal(0.1, 45, -60), "Invalid alpha_targ -60"),
    (lambda: check_count(2.5, "repeats"), "Invalid repeats 2.5. Must be a whole number >= 1."),
    (lambda: check_number(-1, "speed", low=0, unit="m/s"), "Must be >= 0 m/s."),
    (lambda: Cloud(SQUARE, {"ring": [1, 2]}), "Invalid column 'ring' of shape (2,)."),
    (lambda: stats.wilson(5, 4), "Invalid k 5. Must be <= n = 4."),
    (lambda: stats.errors([np.inf]), "Invalid errors: infinite."),
    (lambda: planes.fit_line([[1, 1], [1, 1]]), "Must span a line"),
    (lambda: planes.fit_plane(SQUARE).horizontal_axes(), "Must be 0.1 degrees or more"),
    (lambda: chart_cloud.chart_polygon(SQUARE, margins=(0.1, 0.1, 0.1)), "margins: 3 given"),
    (lambda: repeatability.evaluate_selections(SQUARE, []), "Invalid polygons: none given."),
    (lambda: spacing.empty_space(SQUARE[:, :2], outline=shapely.Polygon()), "Invalid outline"),
    (lambda: spacing.empty_space(SQUARE[:, :2], outline=BOW), "Invalid outline: crosses itself"),
    (lambda: plan_differences(SQUARE, POLE, slices={"pole": ()}), "Invalid slices of 'pole': none"),
    (lambda: io.write_cloud("a.laz", Cloud(SQUARE, {"xyz": range(len(SQUARE))})), "'xyz'. Must be"),
    (lambda: planes.sigma_mad([np.nan]), "Must be a row of finite numbers"),
    (lambda: lines.components(0 * EDGE, EDGE), "no length in row 0"),
    (lambda: lines.components(np.zeros((3, 5)), EDGE), "shape (3, 5)"),
    (lambda: lines.components(np.float32(EDGE + [6e6, 0, 0]), EDGE), "float32 in steps of 500 mm"),
    (lambda: lines.components(EDGE, EDGE, rotate="longer"), "Must be one of test, shorter"),
    (lambda: lines.components(EDGE, EDGE, within="touch"), "one of containment, overlap"),
    (lambda: lines.peak_threshold([-0.1, 0.2]), "Invalid nearest distances"),
    (lambda: lines.correspond([[1.0]], 1.0, matcher="fragments"), "None among them"),
    (lambda: lines.pairing_scores([[True]], [[True, False]]), "Must be Boolean of shape (1, 2)"),
    (lambda: lines.lhd(EDGE, EDGE + 651_000), "one coordinate"),
    (lambda: lines.lhd(EDGE, EDGE, pairs=[[1]]), "Invalid pairs of type int64"),
    (lambda: lines.compare({"a": EDGE}), "two or more"),
    (lambda: lines.compare({"a": EDGE, "b": []}), "sets a with 1 segments, b with 0 segments."),
    (lambda: simulate.rectangle((0, 0, 0), (1, 0, 0), (2, 0, 0)), "Must not be parallel"),
    (lambda: simulate.wall((0, 0, 0), (3, 0, 0), 2, openings=[(1, 1, 3, 0.5)]), "Must lie with"),
    (lambda: simulate.Scene([]), "Invalid surfaces: none"),
    (lambda: simulate.Scene([simulate.ground()]).cast((0, 0, 1), [[0, 0, 0]]), "in row 0"),
    (lambda: replace(SCANNER, field_of_view_deg=(30, 10)), "Invalid field_of_view_deg 10"),
    (lambda: replace(SCANNER, dropout_share=1.5), "Invalid dropout_share 1.5."),
    (lambda: replace(SCANNER, lever_arm_m=(0, 0)), "Invalid lever_arm_m"),
    (lambda: simulate.Trajectory([0, 0], SQUARE[:2]), "Invalid time 0.0 in row 1. Must be later"),
    (lambda: DRIVE.at([11]), "Must be between 0.0 and 10.0 s"),
    (lambda: cameras.chart_view(CAMERA, distance=5, layout=CHART, heading_deg=90), "Invalid head"),
    (lambda: cameras.Sensor(jpeg_quality=90), "Invalid bits"),
    (lambda: charts.imaging_chart("red"), "Must be one of grey, revised"),
    (lambda: charts.Layout("a", 9, 9, (charts.Bar("a", 5, 5, 9, 1),)), "Must be within"),
    (lambda: charts.Layout("a", 9, 9, (charts.Bar("a", 1, 1, 1, 1),) * 2), "Must be distinct"),
    (lambda: charts.Layout("a", 9, 9, (charts.Bar("a", 1, 1, 1, 1, 2),)), "between 0 and 1"),
    (lambda: charts.Text("a", 9, 9, "\U0001f697", 40).width, "not in the font"),
    (lambda: charts.reflectance(CHART, cell=0.001), "Must be 1e9 or fewer"),
    (lambda: chart_image.locate(None, CHART, corners=SQUARE[:3, :2]), "Must be 4"),
    (lambda: chart_image.locate(None, CHART, corners=SQUARE[:, :2]), "four corners in order"),
    (lambda: chart_image.locate(np.zeros((50, 50)), CHART), "0 of 4 coded targets"),
    (lambda: chart_image.agreement(VOTES.assign(mark="d")), "Invalid mark 'd'"),
    (lambda: chart_image.agreement(pd.concat([VOTES] * 2)), "juror 1 marked x twice"),
    (lambda: mtf.fit_edge(np.zeros((4, 4))), "Must be 10 x 10 or larger."),
    (lambda: mtf.fit_edge(np.zeros((20, 20))), "no edge"),
    (lambda: mtf.measure_star(np.zeros((60, 60)), (30, 30), cycles=36, radius_px=25), "larger"),
    (lambda: mtf.haar_sharpness(np.zeros((20, 20))), "at least a block large"),
    (lambda: radiometry.fit_sensor([1, 1, 1], [2, 2, 2]), "of different radiance"),
    (lambda: radiometry.adjust_block(VOTES), "no column 'image'"),
    (lambda: point_pattern("spiral", density=9, size=1, seed=1), "Invalid kind 'spiral'"),
    (lambda: point_pattern("lattice", density=9, size=1, seed=1, ratio=0.5), "Invalid ratio 0.5"),
    (lambda: repeatability.repeatability(RATED[1:], "f"), "a single selection"),
    (lambda: repeatability.variance_components(RATED, "f", factors=["scan"]), "not balanced"),
    (lambda: repeatability.variance_components(-RATED, "f", factors=["scan"]), "not positive"),
]


def polygon(*rings, crs=None):
    """GeoJSON of a polygon."""
    import json

    node = {"type": "Polygon", "coordinates": [[list(map(float, v)) for v in r] for r in rings]}
    return json.dumps(node | ({"crs": {"properties": {"name": crs}}} if crs else {}))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Files that are wrong, each in its own way, beside a few that are right."""
    folder = tmp_path_factory.mktemp("bad")
    segments = "0,0,0,5,0,0\n0,1,0,5,1,0\n0,2,0,0,2,3\n"
    texts = {
        "notes.md": "no cloud",
        "words.csv": "alpha,beta,gamma\none,two,three\n",
        "nan.xyz": "nan nan nan\n" * 9,
        "two_columns.xyz": "1 2\n3 4\n5 6\n",
        "broken.ply": "ply\nformat ascii 1.0\nelement vertex 9\nend_header\n1 2 3\n",
        "unnamed.csv": "id,lat,lon\n1,48.1,11.5\n",
        "class_first.xyz": "".join(f"2 691000.{k} 5334000.{k} 520.1\n" for k in range(9)),
        "short.csv": "x,y,z\n1,2,3,4\n5,6,7,8\n",
        "empty.xyz": "",
        "words.xyz": "x y z\na b c\n",
        "two.xyz": "0 0 0\n1 0 0\n",
        "line.xyz": "".join(f"{k} {k} {k}\n" for k in range(9)),
        "bent.csv": "x,y,z\n0,0,0\n1,0,0\n1,1,1\n0,1,0\n",
        "list.geojson": "[1]",
        "number.geojson": '{"type": "MultiPolygon", "coordinates": [5]}',
        "flat.geojson": '{"type": "Polygon", "coordinates": [5]}',
        "far.csv": "x,y,z\n0,0,0\n1e99,0,0\n1,1,0\n",
        "farther.csv": "x,y,z\n0,0,0\n1e308,0,0\n1,1,0\n",
        "floats.ply": "ply\nelement face 1\nproperty list float int of\nend_header\n",
        "zero_byte.xyz": "1 2 3\n1 2 3\0\n",
        "wide.csv": ",".join(f"column {k}" for k in range(999)) + "\n",
        "no_pages.tif": "II*\0" + 4 * "\0",
        "degrees.geojson": polygon(SQUARE, crs="urn:ogc:def:crs:OGC:1.3:CRS84"),
        "zone33.geojson": polygon(SQUARE + [0, 0, 1], crs="EPSG:25833"),
        "broken.tif": "no raster",
        "segments.csv": segments,
        "moved.csv": segments,
        "nan_segments.csv": segments + "1,1,nan,1,1,1\n",
        "heights.csv": "x,y,z\n0,0,0\n1,1,0\n",
        "path.csv": "time,x,y,z,roll,pitch,heading\n0,0,0,0,0,0,0\n1,5,0,0,0,0,0\n",
        "repeated.csv": "time,x,y,z\n1,3,0,0\n1,1,0,0\n2,2,0,0\n",
        "gap.csv": "time,x,y,z\n0,0,0,2\n1,,0,2\n2,2,0,2\n",
        "no_height.csv": "x,y\n1,2\n",
        "no_rows.csv": "x,y,z,kind\n",
        "trees.csv": "x,y,z,kind\n0.5,0.5,0,tree\n",
        "region.csv": "x_px,y_px,width_px,height_px,reflectance\n190,10,20,20,0.1\n",
    }
    for name, text in texts.items():
        (folder / name).write_text(text)
    (folder / "folder").mkdir()
    (folder / "cut.laz").write_bytes(samples.path("road_patch").read_bytes()[:30_000])
    laspy.LasData(laspy.LasHeader(version="1.4", point_format=6)).write(folder / "empty.las")
    for name, code in (("zone32", 25832), ("zone33", 25833), ("feet", 2263)):
        io.write_cloud(folder / f"{name}.laz", Cloud(SQUARE, crs=pyproj.CRS.from_epsg(code)))
    io.write_cloud(folder / "lying.las", np.zeros((5, 3)))
    lying = bytearray((folder / "lying.las").read_bytes())
    lying[247:255] = (10**12).to_bytes(8, "little")  # the header's count of points
    (folder / "lying.las").write_bytes(lying)
    cv2.imwrite(str(folder / "grey.png"), np.tile(np.arange(200, dtype=np.uint8), (150, 1)))
    (folder / "cut.png").write_bytes((folder / "grey.png").read_bytes()[:60])
    return folder


@pytest.mark.parametrize(("line", "part"), COMMANDS, ids=[line for line, _ in COMMANDS])
def test_bad_input_gets_one_sentence_and_leaves_nothing(line, part, folder, monkeypatch, capfd):
    monkeypatch.chdir(folder)
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    status = main([PATCH if word == "PATCH" else word for word in shlex.split(line)])
    out, err = capfd.readouterr()
    said = [row for row in err.splitlines() if not re.search("Dropped|taken for", row)]
    assert (status, out, len(said)) == (2, "", 1)
    assert said[0].startswith(f"mmqa {line.split()[0]}: ")
    assert part in said[0]
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before


@pytest.mark.parametrize(("call", "part"), FUNCTIONS, ids=[part for _, part in FUNCTIONS])
def test_functions_say_what_they_refuse(call, part, folder, monkeypatch):
    monkeypatch.chdir(folder)
    with pytest.raises((ValueError, TypeError)) as error:
        call()
    assert part in str(error.value)


def test_steps_of_a_type_are_those_of_its_largest_number():
    assert arrays.type_step(np.float32([3.0, -1000.0])) == np.spacing(np.float32(1000))
    assert arrays.type_step(np.float64([3.0, -1000.0])) == np.spacing(1000.0)
    assert arrays.type_step([5, 6]) == arrays.type_step(np.empty(0)) == 0
    for largest, fits in ((16_000.0, True), (16_500.0, False)):  # steps of 0.98 and 1.95 mm
        points = np.float32([[largest, 0, 0]])
        if fits:
            assert arrays.check_points(points).dtype == np.float64
        else:
            with pytest.raises(ValueError, match=r"float32 in steps of 1\.95 mm"):
                arrays.check_points(points)
    for far, fits in ((0.99e15, True), (-0.99e15, True), (1.01e15, False), (-1.01e15, False)):
        if fits:
            assert arrays.check_points([[far, 0, 0]])[0, 0] == far
        else:
            with pytest.raises(ValueError, match=r"1\.01e\+15 in it"):
                arrays.check_points([[far, 0, 0]])


@pytest.mark.parametrize(
    ("names", "found"),
    [("id X y_m z[m]", "X y_m z[m]"), ("northing easting h", "easting northing h"),
     ("a b c", ""), ("x y", "x y"), ("y x h", "x y"), ("x y x", "x y")],
)  # fmt: skip
def test_columns_of_coordinates_are_told_by_their_names(names, found):
    assert arrays.coordinate_columns(names.split()) == found.split()


def test_holes_of_a_polygon_follow_its_first_vertex():
    square, hole = np.array([[0.0, 0, 0], [9, 0, 0], [9, 9, 0], [0, 9, 0]]), np.ones((4, 3)) * 2
    hole += [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0]]
    whole = np.vstack([square, square[:1], hole, square[:1], hole + 3])
    rings = arrays.polygon_rings(whole)
    assert [rows.tolist() for rows in rings] == [[*range(4)], [*range(5, 9)], [*range(10, 14)]]
    closed = np.vstack([square, square[:1]])
    assert len(arrays.polygon_rings(closed)) == 1
    short = np.vstack([square, square[:1], hole[:3]])  # three vertices are no closed hole
    assert len(arrays.polygon_rings(short)) == 1


def test_maps_are_said_from_half_a_percent_on():
    """A Mercator map of a sphere stretches by 1 / cos of the latitude: half a percent at 5.7."""
    sphere = pyproj.CRS("+proj=merc +R=6371000")
    to = pyproj.Proj(sphere)
    for latitude, told in ((5.6, False), (5.8, True)):
        said = arrays.remark_on_map(sphere, to(8, latitude))
        off = 100 * (1 / np.cos(np.radians(latitude)) - 1)
        assert bool(said) == told
        assert not told or f"are {off:.2g} % longer here" in said
    scaled = pyproj.CRS("+proj=tmerc +lon_0=8 +k=0.994 +R=6371000")
    assert "0.6 % shorter here" in arrays.remark_on_map(scaled, (0, 0))
    assert arrays.remark_on_map(pyproj.CRS(4326), (8, 49)) == ""
    assert arrays.remark_on_map(None, (8, 49)) == ""
