"""Clouds in the forms of other programs: E57, PCD, PTX; and what is not read is named."""

import bz2
import http.server
import json
import lzma
import sys
import threading

import numpy as np
import pye57
import pypcd4
import pytest
import tifffile

from mmqa_lab import io, samples
from mmqa_lab.__main__ import main
from mmqa_lab.io import forms, outlines
from mmqa_lab.io.forms import SPHERICAL
from mmqa_lab.planes import fit_plane

TURN = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # by 90 degrees about the vertical
PLACE = np.array([10.0, 20, 5])


@pytest.fixture
def wall(rng):
    """Points of a wall, m."""
    return np.round(rng.random((300, 3)) * [2, 0.01, 2], 4)


def test_the_scans_of_an_e57_stand_at_their_poses(tmp_path, wall, capsys, monkeypatch):
    file = pye57.E57(str(tmp_path / "three.e57"), mode="w")
    half = np.sqrt(0.5)
    for number in range(3):
        name = ["near", "far", "0"][number]
        data = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), wall.T.copy(), strict=True))
        data["intensity"] = np.arange(300.0)
        file.write_scan_raw(
            data,
            name=name,
            rotation=np.array([half, 0, 0, half]),
            translation=PLACE + [0, 0, 3 * number],
        )
    file.close()
    cloud = io.read_cloud(tmp_path / "three.e57")
    assert np.bincount(cloud["scan"]).tolist() == [300] * 3
    expected = [wall @ TURN.T + PLACE + [0, 0, 3 * number] for number in range(3)]
    np.testing.assert_allclose(cloud.points, np.concatenate(expected), atol=1e-9)
    assert cloud["intensity"].tolist() == [*range(300)] * 3
    parts = list(io.iterate_cloud(tmp_path / "three.e57", columns=()))
    assert [len(part) for part in parts] == [300] * 3
    for scan in (1, "far"):
        one = io.read_cloud(tmp_path / "three.e57", scan=scan)
        assert np.array_equal(one.points, cloud.points[300:600])
    with pytest.raises(ValueError, match=r"Invalid scan 7 of cloud .*: none of it\. Must be in it"):
        io.read_cloud(tmp_path / "three.e57", scan=7)
    for words in (
        ["evaluate", "--scan", "far"],
        ["map", "--out", str(tmp_path / "m.nc")],
        ["info"],
    ):
        assert main([words[0], str(tmp_path / "three.e57"), *words[1:], "--json"]) == 0
        rows = json.loads(capsys.readouterr().out)
        if words[0] == "info":
            assert (rows[0]["kind"], rows[0]["points"]) == ("E57 cloud, scans: 3", 900)
        if words[0] == "evaluate":
            assert rows[0]["n"] == 300
    monkeypatch.setattr("mmqa_lab.io.clouds.LARGE_BYTES", 10_000)
    with pytest.warns(UserWarning, match=r"three\.e57 of .* GB is read as a whole, E57 and PTX sc"):
        next(io.iterate_cloud(tmp_path / "three.e57"))
    whole = (tmp_path / "three.e57").read_bytes()
    (tmp_path / "cut.e57").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match=r"damaged.*Must be a complete E57 file"):
        io.read_cloud(tmp_path / "cut.e57")


def test_a_scan_of_ranges_and_angles_stands_at_its_pose_without_invalid_points(tmp_path, wall):
    """Range, azimuth and elevation, as libE57 writes them, are the points that they came from."""
    own, lib = wall + [1, 2, 0.5], pye57.libe57
    reach = np.linalg.norm(own, axis=1)
    angles = np.arctan2(own[:, 1], own[:, 0]), np.arcsin(own[:, 2] / reach)
    invalid = np.arange(300) % 50 == 0
    columns = dict(zip(SPHERICAL, (reach, *angles, invalid.astype(float)), strict=True))
    file = pye57.E57(str(tmp_path / "s.e57"), mode="w")
    image = file.image_file

    def node(value):
        """A number, or a structure of some."""
        if not isinstance(value, dict):
            return lib.FloatNode(image, float(value)) if np.isscalar(value) else value
        one = lib.StructureNode(image)
        for name, inner in value.items():
            one.set(name, node(inner))
        return one

    kinds = {name: lib.FloatNode(image, 0.0, lib.E57_DOUBLE, -9.0, 9.0) for name in columns}
    kinds[SPHERICAL[3]] = lib.IntegerNode(image, 0, 0, 2)
    points = lib.CompressedVectorNode(image, node(kinds), lib.VectorNode(image, True))
    turn = dict(zip("wxyz", [np.sqrt(0.5), 0, 0, np.sqrt(0.5)], strict=True))
    pose = {"rotation": turn, "translation": dict(zip("xyz", PLACE, strict=True))}
    label = lib.StringNode(image, "{1}")
    file.data3d.append(node({"guid": label, "pose": pose, "points": points}))
    buffers = lib.VectorSourceDestBuffer()
    for name, values in columns.items():
        buffers.append(lib.SourceDestBuffer(image, name, values, 300, True, True))
    writer = points.writer(buffers)
    writer.write(300)
    writer.close()
    file.close()
    with pytest.warns(UserWarning, match="Dropped 6 of 300 points .* marked as invalid"):
        cloud = io.read_cloud(tmp_path / "s.e57")
    expected = own @ TURN.T + PLACE
    np.testing.assert_allclose(cloud.points, expected[~invalid], atol=1e-9)


@pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
def test_each_kind_of_pcd_is_the_same_cloud(tmp_path, wall, capsys, encoding):
    wall = wall.astype(np.float32)
    wall[:5, 2] = np.nan
    rings = np.arange(300, dtype=np.uint16)
    fields = [*wall.T, rings, pypcd4.PointCloud.encode_rgb(np.tile([[200, 2, 3]], (300, 1)))]
    types = (*[np.float32] * 3, np.uint16, np.float32)
    made = pypcd4.PointCloud.from_points(fields, ("x", "y", "z", "ring", "rgb"), types)
    made.save(tmp_path / "w.pcd", encoding=pypcd4.Encoding(encoding))
    with pytest.warns(UserWarning, match="Dropped 5 of 300 points .* not finite"):
        cloud = io.read_cloud(tmp_path / "w.pcd")
    assert np.array_equal(cloud.points, wall[5:].astype(float))
    assert cloud["ring"].tolist() == [*range(5, 300)]
    if encoding != "ascii":  # in which its writer rounds the packed colours to nothing
        assert (cloud["red"][0], cloud["green"][0], cloud["blue"][0]) == (200, 2, 3)
    assert 0 < cloud.resolution < 1e-6
    assert main(["evaluate", str(tmp_path / "w.pcd"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["n"] == 295
    raw = (tmp_path / "w.pcd").read_bytes()
    (tmp_path / "moved.txt").write_bytes(raw.replace(b"0.0 0.0 0.0 1.0", b"1.0 0.0 0.0 1.0"))
    with pytest.warns(UserWarning, match="viewpoint, 1 0 0 1 0 0 0, which is not applied"):
        assert len(io.read_cloud(tmp_path / "moved.txt")) == 295
    for count in (b"290", b"2000000000"):
        (tmp_path / "odd.pcd").write_bytes(raw.replace(b"300", count, 2))
        with pytest.raises(ValueError, match="Invalid cloud"):
            io.read_cloud(tmp_path / "odd.pcd")


@pytest.mark.parametrize("ending", [".ptx", ".txt"])
def test_the_scans_of_a_ptx_stand_at_their_poses(tmp_path, wall, ending):
    text = ""
    for number in range(2):
        matrix = np.eye(4)
        matrix[:3, :3], matrix[3, :3] = TURN.T, PLACE + [0, 0, 3 * number]  # of rows
        head = [[30], [10], PLACE, *TURN.T, *matrix]
        rows = wall.copy()
        rows[:7] = 0
        body = [[*row, 0.5] for row in rows]
        text += "".join(" ".join(map(str, np.ravel(row).tolist())) + "\n" for row in head + body)
    (tmp_path / f"w{ending}").write_text(text)
    with pytest.warns(UserWarning, match="Dropped 14 of 600 points .* have no return"):
        cloud = io.read_cloud(tmp_path / f"w{ending}")
    expected = [wall[7:] @ TURN.T + PLACE + [0, 0, 3 * number] for number in range(2)]
    np.testing.assert_allclose(cloud.points, np.concatenate(expected), atol=1e-9)
    assert (cloud["row"][0], cloud["column"][3], cloud["scan"][-1]) == (7, 1, 1)
    (tmp_path / "cut.ptx").write_text(text[:-200])
    with pytest.raises(ValueError, match="rows where the header of scan 1 says 300"):
        io.read_cloud(tmp_path / "cut.ptx")


def test_real_files_of_other_programs(real):
    for name, count, column in (
        ("pumpAVisualReferenceImage.e57", 155_201, "red"),
        ("livox_source.pcd", 41_657, "intensity"),
        ("velodyne_source.pcd", 106_825, "timestamp"),
    ):
        cloud = io.read_cloud(real(f"public/{name}"))
        assert len(cloud) == count
        assert column in cloud
    with pytest.warns(UserWarning, match="Not read of .*normalX"):
        assert len(io.read_cloud(real("public/testWithNormals.e57"))) == 2
    moved = io.read_cloud(real("public/translationWithoutRotation.e57"))
    assert moved.points[[0, -1]].tolist() == [[4, 5, 6], [5, 6, 6]]


@pytest.mark.parametrize(("name", "content", "part"), [
    ("a.zip", b"PK\x03\x04rest", "a compressed archive. Must be another; unpack it"),
    ("b.xyz", bz2.compress(b"0 0 0\n"), "a compressed archive. Must be another; unpack it"),
    ("l.csv", lzma.compress(b"x,y,z\n"), "a compressed archive. Must be another; unpack it"),
    ("dtm.asc", b"ncols 12\nnrows 9\n", "an ESRI grid"),
    ("a.xyz", b"SQLite format 3\0", "a GeoPackage"),
    ("scan.fls", b"whatever", "a scanner's own format. Must be another; save it as E57"),
    ("c.obj", b"v 1 2 3\n", "a mesh"),
    ("a.fgb", b"fgb\x03fgb\0", "a FlatGeobuf. Must be another; give it as --polygon"),
])  # fmt: skip
def test_what_is_not_read_is_named(tmp_path, name, content, part):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=part):
        io.read_cloud(tmp_path / name)


@pytest.mark.parametrize("name", ["GPSTime", "gps time", "scalar_Gps_Time", "gps_time"])
def test_columns_of_las_are_known_under_other_names(tmp_path, name):
    (tmp_path / "c.csv").write_text(f"x,y,z,{name}\n0,0,0,5\n1,0,0,6\n")
    assert io.read_cloud(tmp_path / "c.csv", columns=["gps_time"])["gps_time"].tolist() == [5, 6]


def test_reference_points_that_are_given_twice_count_once(tmp_path):
    rows = [f"{x},{y},{x + y}" for x in range(3) for y in range(2)]
    (tmp_path / "r.csv").write_text("\n".join(["x,y,z", *rows, *rows[1:4]]))
    with pytest.warns(UserWarning, match="Dropped 3 points of .* that are given twice"):
        found = io.read_heights(tmp_path / "r.csv")
    assert found.tolist() == [[x, y, x + y] for x in range(3) for y in range(2)]


@pytest.mark.parametrize(("name", "content", "kind", "count"), [
    ("p.csv", "time,x,y,z,heading\n0,0,0,2,90\n1,5,0,2,90\n", "path", 2),
    ("t.txt", "0.5 1 2 3 0 0 0 1\n1.5 2 2 3 0 0 0 1\n", "path", 2),
    ("r.csv", "system,quantity,value\nA,density_per_m2,12\n", "table", 1),
    ("c.xyz", "0 0 0\n1 0 0\n0 1 0\n", "text cloud", 3),
    ("o.wkt", "POLYGON ((0 0, 1 0, 1 1, 0 0))", "1 outlines", 3),
    ("s.out", np.zeros(34).tobytes(), "path (SBET)", 2),
])  # fmt: skip
def test_info_says_what_a_file_is(tmp_path, name, content, kind, count):
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    found = io.describe_file(tmp_path / name)
    assert (found["kind"], found["points"]) == (kind, count)


@pytest.fixture
def ranges():
    """The address of the COPC sample on a server of this machine, and the bytes that it sent."""
    content, sent = samples.path("chart_b_5m").read_bytes(), []

    class Handler(http.server.BaseHTTPRequestHandler):
        """Answers with ranges of the file."""

        def do_GET(self):
            first, last = map(int, self.headers["Range"].removeprefix("bytes=").split("-"))
            part = content[first : last + 1] if self.path == "/b.copc.laz" else b""
            sent.append(len(part))
            self.send_response(206 if part else 404)
            self.send_header("Content-Length", str(len(part)))
            self.end_headers()
            self.wfile.write(part)

        def log_message(self, *_):
            """Say nothing."""

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/b.copc.laz", sent
    server.shutdown()


def test_what_a_polygon_needs_is_read_of_an_address(ranges, tmp_path, capsys, monkeypatch):
    """The same figures as of the file; without an outline only a cloud of few points is fetched."""
    address, sent = ranges
    file = str(samples.path("chart_b_5m"))
    whole = io.read_cloud(file)
    plane = fit_plane(whole.points)
    middle, side, up = plane.centre, *(np.cross(plane.normal, way) for way in np.eye(3)[1:])
    ring = [middle + 0.3 * (a * side + b * up) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    io.write_outlines(tmp_path / "o.geojson", {"inner": ring}, crs=whole.crs)
    found = []
    for source in (file, address):
        assert main(["evaluate", source, "--polygon", str(tmp_path / "o.geojson"), "--json"]) == 0
        found.append(json.loads(capsys.readouterr().out)[0])
    assert found[0]["n"] == found[1]["n"] > 100
    assert found[0]["sigma_mad_mm"] == pytest.approx(found[1]["sigma_mad_mm"])
    assert sent
    monkeypatch.setattr("mmqa_lab.io.las.MARGIN_M", 0.1)
    part = io.read_cloud(address, within=tmp_path / "o.geojson")
    assert found[1]["n"] <= len(part) < len(whole) == len(io.read_cloud(address))
    monkeypatch.setattr("mmqa_lab.io.las.MOST_FETCHED", 10)
    with pytest.raises(ValueError, match=r"points at an address\. Must be at most 10, or with"):
        io.read_cloud(address)
    assert main(["evaluate", address.replace("b.copc", "c.copc")]) == 2
    assert "Must be a COPC file whose host answers" in capsys.readouterr().err


def test_what_the_core_needs_for_a_raster_is_said(tmp_path, monkeypatch):
    tifffile.imwrite(tmp_path / "i.tif", np.zeros((20, 30), np.uint8))
    monkeypatch.setitem(sys.modules, "rasterio", None)
    assert io.describe_file(tmp_path / "i.tif")["kind"] == "image"
    with pytest.raises(ImportError, match=r"Missing rasterio: install mmqa_lab\[files\]"):
        io.read_heights(tmp_path / "i.tif")


def test_a_command_names_the_extra_that_it_misses(tmp_path, monkeypatch, capsys):
    pypcd4.PointCloud.from_xyz_points(np.zeros((3, 3), np.float32)).save(tmp_path / "a.pcd")
    monkeypatch.setitem(sys.modules, "pypcd4", None)
    assert main(["evaluate", str(tmp_path / "a.pcd")]) == 2
    said = capsys.readouterr().err
    assert said == "mmqa evaluate: Missing pypcd4: install mmqa_lab[files].\n"


def test_an_outline_without_heights_is_laid_onto_the_surface_and_not_what_stands_on_it(rng):
    xy = rng.uniform(0, 10, (600, 2)) + [450_000, 5_400_000]
    z = 30 + 0.2 * (xy[:, 0] - 450_000) - 0.1 * (xy[:, 1] - 5_400_000)
    z[:60] += rng.uniform(1, 3, 60)  # a tenth stands on it
    points = np.column_stack([xy, z])
    ring = np.array([[1, 1], [8, 2], [7, 9], [2, 6.0]]) + [450_000, 5_400_000]
    with pytest.warns(UserWarning, match="laid onto the cloud"):
        laid = outlines._laid(ring, points, "outline")
    local = ring - [450_000, 5_400_000]
    assert laid[:, :2].tolist() == ring.tolist()
    assert laid[:, 2] == pytest.approx(30 + 0.2 * local[:, 0] - 0.1 * local[:, 1], abs=1e-6)


def test_the_head_of_a_ply_file_says_its_elements_in_order():
    head = """ply
format binary_big_endian 1.0
comment made by hand
obj_info nothing

element vertex 12
property float x
property uint8 ring
element face 3
property list uchar int vertex_indices
property double area"""
    order, elements = forms._ply_header(head, "a.ply")
    assert order == ">"
    assert elements == [
        ("vertex", 12, {"x": ("f4",), "ring": ("u1",)}),
        ("face", 3, {"vertex_indices": ("u1", "i4"), "area": ("f8",)}),
    ]
    for wrong in (
        "property float x",  # before any element
        "element vertex 2\nproperty float x\nproperty int x",
        "element vertex 2\nproperty complex x",
        "element vertex two",
        "element face 2\nproperty list float int v",
        "element face 2\nproperty list uchar text v",
        "format utf8 1.0",
    ):
        with pytest.raises(ValueError, match=r"^Invalid cloud a.ply: "):
            forms._ply_header(f"ply\nformat ascii 1.0\n{wrong}", "a.ply")
    with pytest.raises(ValueError, match="no known format"):
        forms._ply_header("ply\nelement vertex 2\nproperty float x", "a.ply")
