"""Reading and writing clouds, polygons and trajectories."""

import json
import os
import subprocess
import sys
from pathlib import Path

import laspy
import numpy as np
import pandas as pd
import plyfile
import pyproj
import pytest
import rasterio
import shapely
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from mmqa_lab import samples
from mmqa_lab._checks import check_points, check_same_crs
from mmqa_lab.cloud import Cloud
from mmqa_lab.io import (
    read_cloud,
    read_heights,
    read_polygon,
    read_trajectory,
    write_atomically,
    write_cloud,
    write_polygon,
)
from mmqa_lab.io.clouds import iterate_cloud

UTM = np.array([448_000.0, 5_411_000.0, 120.0])


@pytest.fixture
def cloud(rng):
    """A cloud in UTM coordinates, in whole millimetres, with LAS fields and an extra dimension."""
    points = np.round(rng.uniform(0, 50, (500, 3)), 3) + UTM
    columns = {
        "gps_time": np.sort(rng.uniform(0, 10, 500)),
        "intensity": rng.integers(0, 60000, 500).astype(np.uint16),
        "scan_angle": np.round(rng.uniform(-170, 170, 500) / 0.006) * 0.006,
        "ring": rng.integers(0, 32, 500).astype(np.uint8),
    }
    return Cloud(points, columns)


@pytest.mark.parametrize("ending", ["las", "laz"])
def test_las_there_and_back(tmp_path, cloud, ending):
    write_cloud(tmp_path / f"c.{ending}", cloud)
    again = read_cloud(tmp_path / f"c.{ending}")
    assert np.abs(again.points - cloud.points).max() < 1e-8  # half a step would be 5e-4
    for name, values in cloud.columns.items():
        assert np.allclose(again[name], values, rtol=0, atol=1e-9)
    assert again["ring"].dtype == np.uint8
    assert again.name == "c"


@pytest.mark.parametrize(("version", "form"), [("1.2", 3), ("1.3", 3), ("1.4", 6)])
def test_all_las_versions(tmp_path, cloud, version, form):
    header = laspy.LasHeader(version=version, point_format=form)
    header.offsets, header.scales = UTM, np.full(3, 0.001)
    las = laspy.LasData(header)
    las.xyz = cloud.points
    las.write(tmp_path / "c.laz")
    assert np.abs(read_cloud(tmp_path / "c.laz").points - cloud.points).max() < 1e-8


def test_sample_is_as_laspy_reads_it():
    path = samples.path("road_patch")
    assert np.array_equal(read_cloud(path).points, laspy.read(path).xyz)


@pytest.mark.parametrize(("separator", "header"), [(" ", ""), (",", "x,y,z,ring\n"), ("\t", "")])
def test_text(tmp_path, cloud, separator, header):
    rows = np.column_stack([cloud.points, cloud["ring"]])
    body = "\n".join(separator.join(f"{v:.3f}" for v in row) for row in rows)
    (tmp_path / "c.txt").write_text(f"# made by hand\n{header}{body}\n")
    again = read_cloud(tmp_path / "c.txt")
    assert np.allclose(again.points, cloud.points, rtol=0, atol=1e-8)
    assert np.array_equal(again["ring" if header else "column_4"], cloud["ring"])


@pytest.mark.parametrize("text", [True, False])
def test_ply_keeps_double_precision_and_every_property(tmp_path, cloud, text):
    fields = [("x", "f8"), ("y", "f8"), ("z", "f8"), ("ring", "u1")]
    vertices = np.empty(len(cloud), dtype=fields)
    vertices["x"], vertices["y"], vertices["z"] = cloud.points.T
    vertices["ring"] = cloud["ring"]
    element = plyfile.PlyElement.describe(vertices, "vertex")
    plyfile.PlyData([element], text=text).write(tmp_path / "c.ply")
    again = read_cloud(tmp_path / "c.ply")
    assert np.allclose(again.points, cloud.points, rtol=0, atol=1e-8)
    assert np.array_equal(again["ring"], cloud["ring"])


def test_copc_is_read_whole():
    path = samples.path("chart_b_5m")
    cloud = read_cloud(path)
    with laspy.CopcReader.open(path) as reader:  # by its octree, not point by point
        found = reader.query()
    points = np.stack([found.x, found.y, found.z], axis=1)
    assert np.array_equal(np.sort(points, axis=0), np.sort(cloud.points, axis=0))
    assert "gps_time" in cloud


def test_pieces_make_the_whole(tmp_path, cloud):
    write_cloud(tmp_path / "c.laz", cloud)
    parts = list(iterate_cloud(tmp_path / "c.laz", chunk=130))
    assert [len(part) for part in parts] == [130, 130, 130, 110]
    whole = read_cloud(tmp_path / "c.laz")
    assert np.array_equal(Cloud.concatenate(parts).points, whole.points)


def test_chosen_columns_only(tmp_path, cloud):
    write_cloud(tmp_path / "c.laz", cloud)
    assert list(read_cloud(tmp_path / "c.laz", columns=["ring"]).columns) == ["ring"]


def test_points_that_are_not_finite_are_counted_and_dropped(tmp_path):
    (tmp_path / "c.xyz").write_text("0 0 0\n1 nan 0\n2 0 inf\n3 0 0\n")
    with pytest.warns(UserWarning, match="Dropped 2 of 4 points"):
        cloud = read_cloud(tmp_path / "c.xyz")
    assert cloud.points[:, 0].tolist() == [0, 3]


def test_real_clouds_are_read_whole(real):
    counts = {
        "oakland/part2_ac.laz": ("label", 100_000),
        "street_profiles/street_0.02_s.laz": ("gps_time", 10_310),
        "hdl32e_pair/sweep_a.laz": (None, 64_056),
    }
    for name, (column, count) in counts.items():
        cloud = read_cloud(real(name))
        assert len(cloud) == count
        assert column is None or column in cloud


def corrupt(path, kind):
    """Spoil a LAZ file in one of the ways that files are spoiled."""
    data = bytearray(path.read_bytes())
    if kind == "cut in the middle":
        data = data[: len(data) // 2]
    elif kind == "cut in the header":
        data = data[:100]
    elif kind == "empty":
        data = bytearray()
    elif kind == "a header that lies about the count":
        data[247:255] = (10**9).to_bytes(8, "little")
    elif kind == "no cloud at all":
        data = bytearray(b"<html>not found</html>" * 50)
    path.write_bytes(bytes(data))


@pytest.mark.parametrize(
    "kind",
    [
        "cut in the middle",
        "cut in the header",
        "empty",
        "a header that lies about the count",
        "no cloud at all",
    ],
)
@pytest.mark.parametrize("ending", ["las", "laz"])
def test_rejects_damaged_files(tmp_path, cloud, kind, ending):
    path = tmp_path / f"c.{ending}"
    write_cloud(path, cloud)
    corrupt(path, kind)
    with pytest.raises(ValueError, match=r"Invalid cloud .*Must be a complete LAS or LAZ file"):
        read_cloud(path)


SAMPLE = samples.path("road_patch").read_bytes()
POINTS_AT = int.from_bytes(SAMPLE[96:100], "little")
TABLE_AT = int.from_bytes(SAMPLE[POINTS_AT : POINTS_AT + 8], "little")

HEADERS = (*range(POINTS_AT + 16), *range(TABLE_AT, len(SAMPLE)))
"""Bytes that count or place something: the headers, the first chunk's begin, the chunk table."""


def outcome_of(data, folder):
    """What reading these bytes ends with."""
    path = folder / "c.laz"
    path.write_bytes(bytes(data))
    try:
        return f"{len(read_cloud(path))} points"
    except ValueError as error:
        return str(error)


@given(st.sampled_from(HEADERS) | st.integers(0, len(SAMPLE) - 1), st.integers(1, 255))
@settings(max_examples=80, deadline=10_000)
def test_a_flipped_byte_gives_a_cloud_or_a_sentence(tmp_path_factory, place, flip):
    data = bytearray(SAMPLE)
    data[place] ^= flip
    outcome = outcome_of(data, tmp_path_factory.mktemp("flip"))
    assert outcome.endswith(" points") or outcome.startswith("Invalid cloud")


DAMAGE = """
import re, sys, time, warnings
from pathlib import Path
import numpy as np
from mmqa_lab.io import read_cloud

warnings.simplefilter("ignore")
rng = np.random.default_rng(int(sys.argv[2]))
whole, slowest = Path(sys.argv[1]).read_bytes(), 0.0
path = Path(sys.argv[3]) / f"damaged{Path(sys.argv[1]).suffix}"
for kind in ("cut", "flips", "count", "zeros") * 8:
    data = bytearray(whole)
    if kind == "cut":
        data = data[: rng.integers(len(data))]
    elif kind == "flips":
        for place in rng.integers(0, min(len(data), 2000), 8):
            data[place] = rng.integers(256)
    elif kind == "count":
        data[247:255] = int(rng.integers(1, 2**62)).to_bytes(8, "little")
    else:
        start = rng.integers(len(data))
        data[start : start + 500] = bytes(500)
    path.write_bytes(data)
    began = time.monotonic()
    try:
        read_cloud(path)
    except ValueError as error:
        assert str(error).startswith("Invalid cloud"), error
    slowest = max(slowest, time.monotonic() - began)
peak = re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1]
print(slowest, int(peak) / 1024)
"""


@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="needs Linux's peak memory")
@pytest.mark.parametrize("ending", ["las", "laz", "pcd"])
def test_damage_neither_crashes_nor_hangs_nor_fills_the_memory(tmp_path, ending):
    rng = np.random.default_rng(3)
    whole = tmp_path / f"whole.{ending}"
    cloud = Cloud(rng.random((20_000, 3)), {"gps_time": np.arange(20_000.0)})
    if ending == "pcd":
        fields = [("x", "f8"), ("y", "f8"), ("z", "f8"), ("gps_time", "f8")]
        rows = np.column_stack([cloud.points, cloud["gps_time"]]).view(fields)[:, 0]
        whole.write_bytes(pcd_bytes(rows, "binary"))
    else:
        write_cloud(whole, cloud)
    command = [sys.executable, "-c", DAMAGE, str(whole), "7", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr  # a crash would be a negative status
    slowest_s, peak_mb = map(float, done.stdout.split())
    assert slowest_s < 10
    assert peak_mb < 1000


@pytest.mark.parametrize(
    ("place", "flip", "sentence"),
    [
        (103, 0xFF, "records before byte 878"),  # number of records: a loop of minutes
        (841, 0xFF, "chunks of"),  # points in a chunk: an allocation that ends the process
        (863, 0xFF, "bytes, not 34"),  # bytes of a point
        (878, 0xFF, "chunk"),  # place of the chunk table
        (TABLE_AT + 7, 0xFF, "chunks in"),  # number of chunks
    ],
)
def test_headers_that_lie_are_found_out_before_anything_is_allocated(
    tmp_path, place, flip, sentence
):
    data = bytearray(SAMPLE)
    data[place] ^= flip
    outcome = outcome_of(data, tmp_path)
    assert outcome.startswith("Invalid cloud")
    assert sentence in outcome


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("c.docx", "x", "with ending '.docx'. Must be one of .las, .laz, .ply"),
        ("c.xyz", "", "Must be rows of columns"),
        ("c.xyz", "1 2\n3 4\n", "2 columns. Must be rows of numbers, x y z first."),
        ("c.xyz", "1 2 3\n4 five 6\n", "Must be rows of numbers, x y z first or named"),
        ("c.csv", "x,y,z\n", "no points. Must contain one or more."),
        ("c.ply", "ply\nformat ascii 1.0\nend_header\n", "Must be a PLY file with vertices"),
    ],
)
def test_rejects_files(tmp_path, name, content, sentence):
    (tmp_path / name).write_text(content)
    with pytest.raises(ValueError, match="Invalid") as error:
        read_cloud(tmp_path / name)
    assert sentence in str(error.value)


def test_rejects_what_is_not_there(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no such file\. Must exist\."):
        read_cloud(tmp_path / "none.laz")
    with pytest.raises(ValueError, match=r"Invalid column 'ring'.*those present: intensity"):
        read_cloud(samples.path("road_patch"), columns=["ring"])


def test_rejects_writing_what_las_cannot_hold(tmp_path, cloud):
    with pytest.raises(ValueError, match="Must be coarser for a cloud as wide"):
        write_cloud(tmp_path / "c.laz", Cloud([[0, 0, 0], [1e7, 0, 0]]), scale=1e-4)
    with pytest.raises(ValueError, match="Invalid column 'name'"):
        write_cloud(tmp_path / "c.laz", Cloud(cloud.points[:1], {"name": np.array(["a"])}))
    with pytest.raises(ValueError, match=r"Must be one of \.las, \.laz"):
        write_cloud(tmp_path / "c.ply", cloud)
    assert not list(tmp_path.iterdir())


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    target = tmp_path / "t.csv"
    target.write_text("old")

    def fails(path):
        path.write_text("half")
        raise RuntimeError("power cut")

    with pytest.raises(RuntimeError, match="power cut"):
        write_atomically(target, fails)
    assert target.read_text() == "old"
    assert os.listdir(tmp_path) == ["t.csv"]


def test_polygons(tmp_path):
    vertices = UTM + [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0.3, 0, 0.1]]
    write_polygon(tmp_path / "p.geojson", vertices)
    assert np.array_equal(read_polygon(tmp_path / "p.geojson"), vertices)
    geometry = json.loads((tmp_path / "p.geojson").read_text())
    feature = {"type": "FeatureCollection", "features": [{"type": "Feature", "geometry": geometry}]}
    (tmp_path / "f.geojson").write_text(json.dumps(feature))
    assert np.array_equal(read_polygon(tmp_path / "f.geojson"), vertices)
    pd.DataFrame(vertices, columns=["x", "y", "z"]).to_csv(tmp_path / "p.csv", index=False)
    assert np.allclose(read_polygon(tmp_path / "p.csv"), vertices, rtol=0, atol=1e-9)
    inline = "; ".join(",".join(map(repr, map(float, vertex))) for vertex in vertices)
    assert np.array_equal(read_polygon(inline), vertices)


@pytest.mark.parametrize(
    ("source", "sentence"),
    [
        ("0,0,0; 1,0,0", "2 given. Must be 3 or more"),
        ("0,0,0,0; 1,0,0,0; 1,1,0,0", "Must have shape (n, 3)"),
        ("0,0,0; a,0,0; 1,1,0", "Must be vertices x,y,z"),
        ("nowhere.csv", "no such file. Must exist."),
        ("0,0,0; 1,nan,0; 1,1,0", "1 of 3 not finite"),
    ],
)
def test_rejects_polygons(source, sentence):
    with pytest.raises((ValueError, FileNotFoundError)) as error:
        read_polygon(source)
    assert sentence in str(error.value)


def test_rejects_geojson_without_a_polygon(tmp_path):
    (tmp_path / "q.geojson").write_text('{"type": "Point", "coordinates": [1, 2]}')
    with pytest.raises(ValueError, match=r"Must be a polygon\."):
        read_polygon(tmp_path / "q.geojson")
    (tmp_path / "q.geojson").write_text('{"name": "nothing"}')
    with pytest.raises(ValueError, match="Must be GeoJSON with a polygon"):
        read_polygon(tmp_path / "q.geojson")


def test_polygons_with_holes_and_parts_come_back(tmp_path):
    ring = np.array([[0, 0, 1.0], [4, 0, 1], [4, 4, 1], [0, 4, 1]])
    holed = shapely.Polygon(ring, [ring / 4 + [1, 1, 0.75]])
    both = shapely.MultiPolygon([holed, shapely.Polygon(ring + [9, 0, 0])])
    for shape in (holed, both):
        write_polygon(tmp_path / "p.geojson", shape)
        again = read_polygon(tmp_path / "p.geojson")
        assert again.equals(shape)
        assert shapely.get_coordinates(again, include_z=True)[0].tolist() == [0, 0, 1]


def test_a_stated_coordinate_system_is_said_and_degrees_are_refused(tmp_path):
    ring = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 0, 0]]
    node = {"type": "Polygon", "coordinates": [ring]}
    for name in ("urn:ogc:def:crs:EPSG::25832", "urn:ogc:def:crs:OGC:1.3:CRS84"):
        node["crs"] = {"type": "name", "properties": {"name": name}}
        (tmp_path / f"{name[-4:]}.geojson").write_text(json.dumps(node))
    with pytest.warns(UserWarning, match="EPSG::25832; it is taken for that of the cloud"):
        assert len(read_polygon(tmp_path / "5832.geojson")) == 3
    with pytest.raises(ValueError, match=r"CRS84.*Must be projected, in metres\."):
        read_polygon(tmp_path / "RS84.geojson")


NAMES = st.sampled_from(
    [
        ("x", "y", "z"),
        ("X", "Y", "Z"),
        ("Easting", "Northing", "Height"),
        ("easting_m", "northing_m", "height_m"),
        ("x [m]", "y [m]", "z [m]"),
        ("East", "North", "Elevation"),
    ]
)


@given(
    names=NAMES,
    order=st.permutations(range(5)),
    separator=st.sampled_from([",", ";", "\t", ", ", " "]),
    commas=st.booleans(),
    before=st.sampled_from(["", "# surveyed by hand\n", "\ufeff", "// by another program\n"]),
    commented=st.booleans(),
    end=st.sampled_from(["\n", "\r\n"]),
)
def test_columns_of_text_are_found_by_their_names(
    tmp_path_factory, names, order, separator, commas, before, commented, end
):
    if separator == " " and "[" in names[0]:
        names = ("x", "y", "z")
    if commented and before == "\ufeff":
        before = ""
    rng = np.random.default_rng(1)
    values = np.column_stack([np.arange(1, 21), np.round(rng.random((20, 4)) * 900, 3)])
    titles = np.array(["id", *names, "intensity"])
    rows = [separator.join(f"{v:.3f}" for v in row[order]) for row in values]
    if separator in (";", "\t", " ") and commas:
        rows = [row.replace(".", ",") for row in rows]
    header = ("# " if commented else "") + separator.join(titles[order])
    path = tmp_path_factory.mktemp("text") / "c.csv"
    path.write_bytes((before + end.join([header, *rows]) + end).encode())
    cloud = read_cloud(path)
    assert np.allclose(cloud.points, values[:, 1:4], rtol=0, atol=1e-9)
    assert set(cloud.columns) == {"id", "intensity"}
    assert np.allclose(cloud["intensity"], values[:, 4])


def test_points_with_a_count_before_them(tmp_path):
    (tmp_path / "c.pts").write_text("2\n1.5 2 3 -700 10 20 30\n4 5 6 -800 10 20 30\n")
    cloud = read_cloud(tmp_path / "c.pts")
    assert cloud.points.tolist() == [[1.5, 2, 3], [4, 5, 6]]
    assert cloud["column_4"].tolist() == [-700, -800]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("id,lat,lon\n1,48.1,11.5\n", "with columns id, lat, lon. Must have x, y, z or easting"),
        ("a b c d\n1 2 3 4\n", "with columns a, b, c, d. Must have x, y, z"),
        ("x y z\n1 2 3 4\n", "3 names over 4 columns"),
        ("1,5.2,6.1,7.0\n2,5.3,6.1,7.0\n3,5.4,6.2,7.1\n", "its first column numbers the rows"),
    ],
)
def test_text_whose_columns_are_not_known_is_refused(tmp_path, text, sentence):
    (tmp_path / "c.csv").write_text(text)
    with pytest.raises(ValueError, match="Invalid") as error:
        read_cloud(tmp_path / "c.csv")
    assert sentence in str(error.value)


def pcd_bytes(rows, kind):
    """Rows as a PCD file, written by hand after the format's description (PCL 0.7)."""
    codes = {"f": "F", "i": "I", "u": "U"}
    fields = [rows.dtype[name] for name in rows.dtype.names]
    header = [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        "FIELDS " + " ".join(rows.dtype.names),
        "SIZE " + " ".join(str(field.itemsize) for field in fields),
        "TYPE " + " ".join(codes[field.kind] for field in fields),
        "COUNT " + " ".join("1" for _ in fields),
        f"WIDTH {len(rows)}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(rows)}",
        f"DATA {kind}",
    ]
    text = "\n".join(" ".join(repr(value.item()) for value in row) for row in rows)
    return (
        "\n".join(header).encode() + b"\n" + (text.encode() if kind == "ascii" else rows.tobytes())
    )


@pytest.mark.parametrize("kind", ["ascii", "binary"])
@pytest.mark.parametrize("type_", ["f4", "f8"])
def test_pcd(tmp_path, cloud, kind, type_):
    local = cloud.points - UTM
    rows = np.empty(len(cloud), [("x", type_), ("y", type_), ("z", type_), ("ring", "u2")])
    rows["x"], rows["y"], rows["z"] = local.T
    rows["ring"] = cloud["ring"]
    (tmp_path / "c.pcd").write_bytes(pcd_bytes(rows, kind))
    again = read_cloud(tmp_path / "c.pcd")
    step = np.spacing(np.float32(50.0)) if type_ == "f4" else 1e-12
    assert np.abs(again.points - local).max() <= step
    assert np.array_equal(again["ring"], cloud["ring"])
    assert np.isnan(again.resolution) == (type_ == "f8")


def test_damaged_pcd_gets_a_sentence(tmp_path, cloud):
    rows = np.zeros(9, [("x", "f4"), ("y", "f4"), ("z", "f4")])
    whole = pcd_bytes(rows, "binary")
    damaged = {
        "is cut": whole[:-7],
        "9 points": whole.replace(b"POINTS 9", b"POINTS 9000000000000"),
        "data are binary_compressed": whole.replace(b"DATA binary", b"DATA binary_compressed"),
        "'POINTS'": b"x y z\n1 2 3\n",
    }
    for data in damaged.values():
        (tmp_path / "c.pcd").write_bytes(data)
        with pytest.raises(ValueError, match=r"Must be a PCD file with x, y, z, ascii or binary"):
            read_cloud(tmp_path / "c.pcd")


def test_e57_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pye57", None)
    (tmp_path / "c.e57").write_bytes(b"ASTM-E57")
    with pytest.raises(ValueError, match=r"Install it by pip install pye57\."):
        read_cloud(tmp_path / "c.e57")


@pytest.fixture
def pye57():
    """The reader of E57, which is an option."""
    return pytest.importorskip("pye57", reason="needs pye57, which reads E57 files")


def test_e57_is_placed_and_its_invalid_points_are_left_out(tmp_path, cloud, pye57):
    origin = np.floor(cloud.points.mean(axis=0))
    x, y, z = (cloud.points - origin).T
    state = np.arange(len(x), dtype=np.int8) % 2
    scan = {"cartesianX": x, "cartesianY": y, "cartesianZ": z, "intensity": np.ones(len(x))}
    quarter = np.array([np.sqrt(0.5), 0, 0, np.sqrt(0.5)])  # turn about the vertical
    with pye57.E57(str(tmp_path / "c.e57"), mode="w") as file:
        for more in ({}, {"cartesianInvalidState": state}):
            file.write_scan_raw(scan | more, rotation=quarter, translation=origin)
    again = read_cloud(tmp_path / "c.e57")
    assert again.resolution <= np.spacing(np.float32(np.abs([x, y, z]).max()))
    assert again["intensity"].tolist() == [1.0] * len(again)
    placed = origin + np.column_stack([-y, x, z])
    assert np.abs(again.points - np.concatenate([placed, placed[state == 0]])).max() < 1e-5


def test_e57_of_ranges_and_angles(tmp_path, pye57):
    across, up = np.meshgrid(np.linspace(-3, 3, 7), [-0.5, 0.2])
    spherical = {"Range": np.linspace(2, 9, 14), "Azimuth": across.ravel(), "Elevation": up.ravel()}
    write_spherical(tmp_path / "c.e57", pye57, spherical)
    again = read_cloud(tmp_path / "c.e57")
    distance, azimuth, elevation = spherical.values()
    flat = distance * np.cos(elevation)
    wanted = [flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)]
    assert np.abs(again.points - np.transpose(wanted)).max() < 1e-12
    assert np.isnan(again.resolution)


def write_spherical(path, pye57, values):
    """An E57 file with one scan in ranges and angles, which pye57 reads but does not write."""
    node = pye57.libe57
    with pye57.E57(str(path), mode="w") as file:
        image, buffers = file.image_file, node.VectorSourceDestBuffer()
        kinds, scan = node.StructureNode(image), node.StructureNode(image)
        for name, column in values.items():
            limits = column.min(), node.E57_DOUBLE, column.min(), column.max()
            kinds.set(f"spherical{name}", node.FloatNode(image, *limits))
            column = np.ascontiguousarray(column)
            entry = image, f"spherical{name}", column, len(column), True, True
            buffers.append(node.SourceDestBuffer(*entry))
        file.data3d.append(scan)
        points = node.CompressedVectorNode(image, kinds, node.VectorNode(image, True))
        scan.set("points", points)
        writer = points.writer(buffers)
        writer.write(len(column))
        writer.close()


def test_a_damaged_e57_gets_a_sentence(tmp_path, cloud, pye57):
    x, y, z = cloud.points.T
    with pye57.E57(str(tmp_path / "c.e57"), mode="w") as file:
        file.write_scan_raw({"cartesianX": x, "cartesianY": y, "cartesianZ": z})
    whole = (tmp_path / "c.e57").read_bytes()
    changed = bytearray(whole)
    changed[len(whole) // 2] ^= 255
    for data in (b"", b"ASTM-E57", whole[:-1024], bytes(changed)):
        (tmp_path / "c.e57").write_bytes(data)
        with pytest.raises(ValueError, match=r"Invalid cloud .* Must be an E57 file"):
            read_cloud(tmp_path / "c.e57")


def test_the_coordinate_system_is_read_and_written_again(tmp_path, cloud):
    placed = Cloud(cloud.points, crs="EPSG:25832")
    write_cloud(tmp_path / "c.laz", placed)
    again = read_cloud(tmp_path / "c.laz")
    assert again.crs == again[:3].crs == placed.crs
    assert read_cloud(tmp_path / "c.laz", columns=()).to_xarray().attrs["crs_wkt"]
    both = Cloud.concatenate([again, Cloud(cloud.points)])
    assert both.crs == placed.crs
    with pytest.raises(ValueError, match="Must be in one"):
        Cloud.concatenate([again, Cloud(cloud.points, crs="EPSG:25833")])
    with pytest.raises(ValueError, match="Invalid crs 'nowhere'"):
        Cloud(cloud.points, crs="nowhere")


def test_a_cloud_knows_the_step_of_its_coordinates(tmp_path, cloud):
    write_cloud(tmp_path / "c.laz", cloud, scale=0.01)
    assert read_cloud(tmp_path / "c.laz").resolution == 0.01
    assert read_cloud(tmp_path / "c.laz", columns=())[:5].resolution == 0.01
    for type_, step in (("f4", 0.5), ("f8", np.nan)):
        vertices = np.array([(448_000.1, 5_411_000.2, 120.3)], [(a, type_) for a in "xyz"])
        element = plyfile.PlyElement.describe(vertices, "vertex")
        plyfile.PlyData([element]).write(tmp_path / "c.ply")
        assert np.array_equal(read_cloud(tmp_path / "c.ply").resolution, step, equal_nan=True)
    (tmp_path / "c.xyz").write_text("1 2 3\n")
    assert np.isnan(read_cloud(tmp_path / "c.xyz").resolution)


def raster(path, heights, **choices):
    """Write heights over cells of half a metre with their upper left corner at (1000, 2000)."""
    place = rasterio.transform.from_origin(1000, 2000, 0.5, 0.5)
    rows, columns = heights.shape
    shape = {"width": columns, "height": rows, "count": 1, "dtype": heights.dtype}
    with rasterio.open(
        path, "w", driver="GTiff", **{"transform": place, **shape, **choices}
    ) as file:
        file.write(heights, 1)


@pytest.mark.parametrize("type_", ["float64", "float32", "int16"])
def test_rasters_are_the_middles_of_their_cells(tmp_path, type_):
    heights = np.arange(6).reshape(2, 3).astype(type_)
    heights[0, 1] = -99
    raster(tmp_path / "h.tif", heights, nodata=-99, crs="EPSG:25832", tiled=True, compress="lzw")
    expected = [[1000.25, 1999.75, 0], [1001.25, 1999.75, 2], [1000.25, 1999.25, 3]]
    assert read_heights(tmp_path / "h.tif")[:3].tolist() == expected
    assert check_points(tmp_path / "h.tif").shape == (5, 3)


def test_arrays_of_heights_with_coordinates_are_points(tmp_path):
    heights = np.arange(6.0).reshape(2, 3)
    heights[0, 1] = np.nan
    raster(tmp_path / "h.tif", heights)
    array = xr.DataArray(
        heights, {"y": [1999.75, 1999.25], "x": [1000.25, 1000.75, 1001.25]}, ("y", "x")
    )
    expected = read_heights(tmp_path / "h.tif")
    for same in (
        array,
        array.T,
        array.expand_dims("band"),
        array.fillna(-1).assign_attrs(_FillValue=-1),
    ):
        found = check_points(same)
        assert sorted(found.tolist()) == sorted(expected.tolist())


@pytest.mark.parametrize(
    ("choices", "sentence"),
    [
        (
            {"transform": rasterio.Affine.identity()},
            "Must be a GeoTIFF of one band whose cells have",
        ),
        ({"crs": "EPSG:4326"}, "in degrees (WGS 84). Must be projected, in metres."),
    ],
)
def test_rasters_without_a_place_in_metres_are_refused(tmp_path, choices, sentence):
    raster(tmp_path / "h.tif", np.ones((2, 2)), **choices)
    with pytest.raises(ValueError, match="Invalid reference") as error:
        read_heights(tmp_path / "h.tif")
    assert sentence in str(error.value)


@pytest.mark.parametrize(
    "text", ["ncols 3\nnrows 2\n", "ncols 3\nnrows 9\nxllcorner 0\nyllcorner 0\n"]
)
def test_damaged_grids_are_refused(tmp_path, text):
    (tmp_path / "h.asc").write_text(text + "cellsize 1\n1 2 3\n4 5 6\n")
    with pytest.raises(ValueError, match="Must be an Esri ASCII grid"):
        read_heights(tmp_path / "h.asc")


def test_trajectory_of_a_survey_vehicle(real):
    path = real("vehicle_trajectory.csv")
    table = read_trajectory(path, time_unit="us", angle_unit="radians")
    raw = pd.read_csv(path)
    assert len(table) == 3000
    assert table["time_s"].diff().median() == pytest.approx(0.1, rel=0.05)  # 10 Hz
    assert np.allclose(table["heading_deg"], np.degrees(raw["heading"]))


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("time,easting,northing\n0,1,2\n", "no column 'height_m'. Must have one."),
        ("time,easting,northing,height\n0,1,2,3\n1,x,2,3\n", "no finite number in line 3"),
        ("time,easting,northing,height\n0,1,2,3\n0,1,2,3\n", "a time repeats"),
    ],
)
def test_rejects_trajectories(tmp_path, content, sentence):
    (tmp_path / "t.csv").write_text(content)
    with pytest.raises(ValueError, match="Invalid trajectory") as error:
        read_trajectory(tmp_path / "t.csv")
    assert sentence in str(error.value)


@pytest.mark.parametrize(
    ("number", "same"),
    [("32632", True), ("25832+7837", True), ("25833", False), ("23032", False), ("4258", False)],
)
def test_coordinate_systems_are_compared_in_plan(number, same):
    """ED50 in the same zone lies 100 m from ETRS89; WGS 84 lies within a metre, a height system
    changes nothing in plan."""
    systems = pyproj.CRS(f"EPSG:{number}"), pyproj.CRS("EPSG:25832")
    if same:
        check_same_crs("polygon", systems[0], "cloud", systems[1])
    else:
        with pytest.raises(ValueError, match="Must be in that of the cloud, ETRS89 / UTM zone 32N"):
            check_same_crs("polygon", systems[0], "cloud", systems[1])
