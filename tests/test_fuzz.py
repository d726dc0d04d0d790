"""Damaged and hostile files: 200 mutants in a process with limits, and cases of each kind."""

import importlib.util
import struct
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import openpyxl
import pandas as pd
import pytest
import rasterio

from mmqa_lab import io, samples
from mmqa_lab.__main__ import main
from mmqa_lab.io import outlines

SPEC = importlib.util.spec_from_file_location(
    "fuzz", Path(__file__).parent / "benchmarks" / "fuzz.py"
)
fuzz = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(fuzz)


def test_damaged_files_are_read_or_refused_by_a_sentence():
    slow = (".kml", ".dbf", ".prj", ".shx")  # a process for each; GeoPackage, DXF and .shp stay
    rows = list(fuzz.fuzz(200, seed=7, left_out=slow))
    assert {outcome for _, kind, _, outcome in rows if kind == "sound"} == {"read"}
    bad = [row for row in rows if not row[-1].startswith(("read", "refused"))]
    assert not bad
    assert {row[-1].split(":")[0] for row in rows} == {"read", "refused"}


def deep_xml(path):
    path.write_text(30_000 * "<a>")
    io.read_camera(path)


def yaml_of_aliases(path):
    rows = ["a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    rows += [
        f"{b}: &{b} [{', '.join(9 * [f'*{a}'])}]"
        for a, b in zip("abcdefgh", "bcdefghi", strict=True)
    ]
    path.write_text("\n".join(rows))
    io.read_camera(path)


def wide_camera(path):
    plain = "K: [9, 0, 1, 0, 9, 1, 0, 0, 1]\nD: [0, 0, 0, 0]\n"
    path.write_text(f"image_width: {'9' * 400}\nimage_height: .inf\n{plain}")
    io.read_camera(path)


def large_png(path):
    cv2.imwrite(str(path.with_suffix(".png")), np.zeros((4, 4), np.uint8))
    data = bytearray(path.with_suffix(".png").read_bytes())
    data[16:24] = struct.pack(">II", 60_000, 60_000)
    path.write_bytes(data)
    io.read_image(path)


def wide_jpeg(path):
    """A few bytes that say 2.7e9 values; OpenCV itself stops only at 2^30 pixels."""
    cv2.imwrite(str(path), np.zeros((8, 8, 3), np.uint8), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])
    data = bytearray(path.read_bytes())
    at = data.index(b"\xff\xc2") + 5
    data[at : at + 4] = struct.pack(">HH", 30_000, 30_000)
    path.write_bytes(data)
    io.read_image(path)


def photograph_with_a_hole(path):
    data = bytearray((samples.path("road_patch").parent / "chart_photo.jpg").read_bytes())
    del data[len(data) // 2 : len(data) // 2 + 300]
    path.write_bytes(data)
    io.read_image(path)


def large_chunk(path):
    data = bytearray(samples.path("road_patch").read_bytes())
    at = data.index(b"laszip encoded")
    data[at + 64 : at + 68] = struct.pack("<I", 2**31 - 1)
    path.write_bytes(data)
    io.read_cloud(path)


def many_points(path, chunk=2**31 - 8, points=2**31 - 8):
    """Header, record and chunk agree on more points than so few bytes can hold."""
    io.write_cloud(path, np.random.default_rng(1).random((900, 3)))
    data = bytearray(path.read_bytes())
    (first,) = struct.unpack_from("<I", data, 96)
    struct.pack_into("<QQ", data, 247, points, points)
    struct.pack_into("<I", data, data.index(b"laszip encoded") + 64, chunk)
    struct.pack_into("<I", data, first + 8 + 30, points)
    path.write_bytes(data)
    io.read_cloud(path)


def large_layer(path):
    io.write_cloud(path, np.random.default_rng(1).random((900, 3)))
    data = bytearray(path.read_bytes())
    (first,) = struct.unpack_from("<I", data, 96)  # the table's place, a point, its count, layers
    struct.pack_into("<I", data, first + 8 + 30 + 4 + 8, 0xFF000000)
    path.write_bytes(data)
    io.read_cloud(path)


def endless_dxf(path):
    path.write_text("0\nSECTION\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(outlines, "GDAL", "while True: pass")
        patch.setattr(outlines, "GDAL_S", 0.1)
        io.read_outlines(path)


def far_cell(path):
    book = openpyxl.Workbook()
    book.active["A1"], book.active["XFD1048576"] = "criterion", 1
    book.save(path)
    io.read_table(path, "table")


def sparse_raster(path):
    """Heights of 400 million cells, none of them stored."""
    place = rasterio.Affine(1, 0, 500_000, 0, -1, 5_400_000)
    layout = {"driver": "GTiff", "count": 1, "dtype": "float32", "sparse_ok": True, "tiled": True}
    layout |= {"blockxsize": 4096, "blockysize": 4096}
    with rasterio.open(
        path, "w", width=20_000, height=20_000, crs="EPSG:25832", transform=place, **layout
    ):
        pass
    io.read_heights(path)


def lzw_with_zeros(path):
    grey = cv2.GaussianBlur(np.random.default_rng(1).random((200, 300)) * 255, (0, 0), 2)
    cv2.imwrite(str(path), grey.astype(np.uint8), [cv2.IMWRITE_TIFF_COMPRESSION, 5])
    data = bytearray(path.read_bytes())
    data[len(data) // 2 : len(data) // 2 + 200] = bytes(200)
    path.write_bytes(data)
    io.read_image(path)


def many_records(path):
    io.write_cloud(path, np.random.default_rng(1).random((9, 3)))
    data = bytearray(path.read_bytes())
    data[100:104] = struct.pack("<I", 2**24)
    path.write_bytes(data)
    io.read_cloud(path)


HOSTILE = {
    "camera.xml": deep_xml,
    "camera.yaml": yaml_of_aliases,
    "wide.yaml": wide_camera,
    "large.png": large_png,
    "hole.jpg": photograph_with_a_hole,
    "chunk.laz": large_chunk,
    "many.laz": many_points,
    "few.laz": partial(many_points, chunk=50_000),
    "wide.jpg": wide_jpeg,
    "records.las": many_records,
    "layer.laz": large_layer,
    "far.xlsx": far_cell,
    "endless.dxf": endless_dxf,
    "sparse.tif": sparse_raster,
    "zeros.tif": lzw_with_zeros,
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_are_refused_at_once(name, tmp_path):
    with pytest.raises(ValueError, match=rf"^Invalid .*{name}"):
        HOSTILE[name](tmp_path / name)


def test_a_text_longer_than_a_name_is_no_path():
    with pytest.raises(ValueError, match=r"^Invalid "):
        io.read_polygon("1,2,3;" * 100 + "nowhere")


def test_corners_longer_than_a_name_are_evaluated_into_a_report_and_a_table(tmp_path, capsys):
    points = np.random.default_rng(1).random((400, 3)) * [1, 1, 0.001]
    io.write_cloud(tmp_path / "c.laz", points)
    corners = ";".join(f"{0.1 + 0.8 * x:.6f},{y:.6f},0" for y in (0.1, 0.9) for x in
                       np.linspace(y > 0.5, y < 0.5, 20))  # fmt: skip
    assert len(corners) > 255
    order = ["evaluate", str(tmp_path / "c.laz"), f"--polygon={corners}"]
    order += ["--csv", str(tmp_path / "t.csv"), "--report", str(tmp_path / "r.html")]
    for _ in range(2):  # the second time the table exists
        assert main(order) == 0, capsys.readouterr().err
    (row,) = pd.read_csv(tmp_path / "t.csv").to_dict("records")
    assert 200 < row["n"] < 300  # of 400 on a square metre, 0.64 m2
