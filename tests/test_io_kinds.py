"""Files as other programs write them: the same cloud in another form, or one sentence."""

import json
import os
import re
import struct
import subprocess
import sys
import warnings

import cv2
import laspy
import numpy as np
import pyproj
import pytest
import rasterio
import tifffile
import xarray as xr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from mmqa_lab import io
from mmqa_lab.__main__ import main
from mmqa_lab.cloud import Cloud

QUICK = settings(
    deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
PLANE = np.round(np.random.default_rng(0).random((120, 3)) * [2, 2, 0.01], 3)
FAR = [500_000.0, 5_400_000.0, 100.0]
RING = (np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0.5], [0, 1, 0.5]]) + FAR).tolist()


def said(call):
    """What a call returns, and what it warned of."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = call()
    return found, " ".join(str(one.message) for one in told)


def las(path, form=6, version="1.4", points=PLANE + FAR, **fields):
    """Write a LAS file with these fields."""
    header = laspy.LasHeader(point_format=form, version=version)
    header.scales, header.offsets = np.full(3, 0.001), np.floor(points.min(axis=0))
    record = laspy.LasData(header)
    record.xyz = points
    for name, values in fields.items():
        record[name] = values
    record.write(path)
    return path


MARKS = {
    "withheld": (1, "Dropped", "are marked as withheld"),
    "synthetic": (1, "Counted", "are marked as synthetic"),
    "overlap": (1, "Counted", "are marked as overlap"),
    "classification": (7, "Dropped", "are of a noise class"),
}


@QUICK
@given(
    mark=st.sampled_from([*MARKS]),
    form=st.sampled_from([(6, "1.4"), (1, "1.2"), (3, "1.3")]),
    count=st.integers(1, 119),
    columns=st.sampled_from([None, ()]),
    chunk=st.sampled_from([50, 1000]),
)
def test_marked_points_are_left_out_or_counted(tmp_path, mark, form, count, columns, chunk):
    value, verb, reason = MARKS[mark]
    field = mark
    if mark == "overlap" and form[0] < 6:
        field, value = "classification", 12
    values = np.r_[np.full(count, value), np.zeros(120 - count, int)]
    path = las(tmp_path / "m.las", *form, **{field: values})
    parts, told = said(lambda: list(io.iterate_cloud(path, columns=columns, chunk=chunk)))
    assert f"{verb} {count} of 120 points of {path} that {reason}" in told
    assert sum(map(len, parts)) == (120 - count if verb == "Dropped" else 120)


def test_high_noise_and_later_returns(tmp_path):
    path = las(tmp_path / "n.laz", classification=np.r_[np.full(20, 18), np.full(100, 2)])
    assert "Dropped 20 of 120" in said(lambda: io.read_cloud(path))[1]
    path = las(tmp_path / "r.laz", return_number=np.tile([1, 2], 60), number_of_returns=[2] * 120)
    found, told = said(lambda: io.read_cloud(path, columns=()))
    assert "Counted 60 of 120" in told
    assert "later returns" in told
    assert len(found) == 120
    last = las(tmp_path / "l.laz", return_number=[2] * 120, number_of_returns=[2] * 120)
    assert not said(lambda: io.read_cloud(last))[1]  # a cloud of last returns has one a pulse


@QUICK
@given(
    row=st.sampled_from([(0, 0, 0), (-9999,) * 3, (5, 5, -9999.0), (1, 1, -32768), (1e30,) * 3]),
    count=st.integers(1, 30),
    ending=st.sampled_from([".xyz", ".ply", ".las"]),
)
def test_rows_that_stand_for_no_point_are_left_out(tmp_path, row, count, ending):
    if ending == ".las" and max(map(abs, row)) > 1e6:
        return
    points = np.concatenate([PLANE + FAR, np.full((count, 3), row)])
    path = tmp_path / f"n{ending}"
    if ending == ".las":
        header = laspy.LasHeader(point_format=6, version="1.4")
        header.scales = np.full(3, 0.01)
        record = laspy.LasData(header)
        record.xyz = points
        record.write(path)
    else:
        body = "".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in points.tolist())
        path.write_text((ply_header(len(points)) if ending == ".ply" else "") + body)
    found, told = said(lambda: io.read_cloud(path))
    assert len(found) == 120
    assert f"Dropped {count} of {120 + count} points" in told


def test_an_origin_among_its_neighbours_is_a_point(tmp_path):
    grid = np.stack(np.meshgrid(range(9), range(9), [0]), axis=-1).reshape(-1, 3) / 10
    np.savetxt(tmp_path / "g.xyz", grid)
    found, told = said(lambda: io.read_cloud(tmp_path / "g.xyz"))
    assert (len(found), told) == (81, "")


@QUICK
@given(axis=st.integers(0, 2), least=st.booleans(), count=st.integers(1, 40))
def test_integers_that_overflowed_are_left_out(tmp_path, axis, least, count):
    path = las(tmp_path / "o.las")
    raw = bytearray(path.read_bytes())
    start = int.from_bytes(raw[96:100], "little")
    value = (-(2**31) if least else 2**31 - 1).to_bytes(4, "little", signed=True)
    for k in range(count):
        raw[start + 30 * k + 4 * axis : start + 30 * k + 4 * axis + 4] = value
    path.write_bytes(raw)
    found, told = said(lambda: io.read_cloud(path))
    assert len(found) == 120 - count
    assert f"Dropped {count} of 120 points" in told
    assert "overflow" in told


def test_records_outside_the_box_of_the_header_are_said(tmp_path):
    path = las(tmp_path / "b.las")
    raw = bytearray(path.read_bytes())
    raw[179:187] = np.float64(FAR[0] + 1).tobytes()  # the largest x
    path.write_bytes(raw)
    _, told = said(lambda: io.read_cloud(path))
    assert f"Counted {(PLANE[:, 0] > 1.002).sum()} of 120 points" in told


@pytest.mark.parametrize(
    ("place", "value", "part"),
    [
        (131, np.float64(0).tobytes(), "scale 0, 0.001, 0.001 in its header"),
        (131, np.float64(np.nan).tobytes(), "scale nan"),
        (247, (60).to_bytes(8, "little"), "120 points where the header says 60"),
        (247, (130).to_bytes(8, "little"), "bytes for 120 points where the header says 130"),
    ],
)
def test_headers_that_contradict_their_file_are_refused(tmp_path, place, value, part):
    path = las(tmp_path / "h.las")
    raw = bytearray(path.read_bytes())
    raw[place : place + 8] = value
    path.write_bytes(raw)
    with pytest.raises(ValueError, match=re.escape(part)):
        io.read_cloud(path)


def counted(path, told, form):
    """Write another number of points into the header of a LAS or LAZ file."""
    raw = bytearray(path.read_bytes())
    raw[247:255] = told.to_bytes(8, "little")
    raw[107:111] = (told if form < 6 else 0).to_bytes(4, "little")
    path.write_bytes(raw)


COUNTS = [(120, 119), (120, 60), (120, 121), (120, 130), (50_010, 49_990), (50_010, 50_009),
          (50_010, 50_020), (100_000, 50_000), (100_000, 99_999), (60, 60_000)]  # fmt: skip


@pytest.mark.parametrize("form", range(11))
@pytest.mark.parametrize("ending", [".las", ".laz"])
def test_a_header_that_counts_too_few_or_too_many_points_is_refused(tmp_path, form, ending):
    for held, told in COUNTS if form in (1, 6) else COUNTS[:4]:
        points = np.random.default_rng(held).random((held, 3))
        path = las(tmp_path / f"c{ending}", form, points=points, user_data=np.arange(held) % 200)
        assert len(io.read_cloud(path)) == held
        counted(path, told, form)
        with pytest.raises(ValueError, match=r"points where the header says|cut short"):
            io.read_cloud(path)


@pytest.mark.parametrize("form", [0, 3, 6, 8])
def test_a_laz_file_whose_table_lacks_chunks_is_refused(tmp_path, form):
    points = np.random.default_rng(1).random((100_010, 3))
    for chunks in (0, 1, 2):
        path = las(tmp_path / "c.laz", form, points=points)
        raw = bytearray(path.read_bytes())
        first = int.from_bytes(raw[96:100], "little")
        table = int.from_bytes(raw[first : first + 8], "little")
        raw[table + 4 : table + 8] = chunks.to_bytes(4, "little")
        path.write_bytes(raw)
        for told in (100_010, 50_000 * chunks):
            counted(path, told, form)
            with pytest.raises(ValueError, match=r"points where the header says|cut short"):
                io.read_cloud(path)


@pytest.mark.parametrize("last", [8, 50])
def test_the_end_of_a_damaged_laz_asks_for_no_memory(tmp_path, last):
    path = las(tmp_path / "d.laz")
    path.write_bytes(path.read_bytes()[:-last] + b"\xff" * last)
    code = f"from mmqa_lab.commands import run; run(['evaluate', {str(path)!r}])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0
    assert "damaged" in done.stderr or not done.stderr


def test_a_count_in_one_of_both_places_of_a_header_is_refused(tmp_path):
    path = las(tmp_path / "z.las", form=1)
    raw = bytearray(path.read_bytes())
    raw[247:255] = bytes(8)
    raw[107:111] = (120).to_bytes(4, "little")
    path.write_bytes(raw)
    with pytest.raises(ValueError, match="120 points where the header says 0"):
        io.read_cloud(path)


@pytest.mark.parametrize(
    ("keys", "part"),
    [
        ({3072: 32632, 4099: 9003}, "heights in US survey foot"),
        ({1024: 1, 3072: 32767, 3076: 9003}, "in US survey foot"),
        ({3072: 32632, 3076: 9002}, "in foot"),
        ({1024: 2}, "in degree"),
        ({3072: 32632, 4096: 6360}, "heights in US survey foot"),
    ],
)
def test_units_beside_a_system_are_read(tmp_path, keys, part):
    from laspy.vlrs.known import GeoKeyDirectoryVlr

    vlr = GeoKeyDirectoryVlr()
    rows = [(key, 0, 1, value) for key, value in sorted(keys.items())]
    vlr.parse_record_data(np.array([(1, 1, 0, len(rows)), *rows], "<u2").tobytes())
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.vlrs.append(vlr)
    header.scales, header.offsets = np.full(3, 0.001), FAR
    record = laspy.LasData(header)
    record.xyz = PLANE + FAR
    record.write(tmp_path / "k.las")
    with pytest.raises(ValueError, match=part):
        io.read_cloud(tmp_path / "k.las")
    assert main(["info", str(tmp_path / "k.las")]) == 0


def test_systems_of_heights_are_compared(tmp_path):
    new, old = (pyproj.CRS(f"EPSG:25832+{number}") for number in (7837, 5783))
    io.write_cloud(tmp_path / "old.laz", Cloud(PLANE + FAR, crs=old))
    assert len(io.read_heights(tmp_path / "old.laz", crs=pyproj.CRS(25832))) == 120
    with pytest.raises(ValueError, match=r"in DHHN92 height\. Must be in DHHN2016 height"):
        io.read_heights(tmp_path / "old.laz", crs=new)


@QUICK
@given(
    name=st.sampled_from(["intensity", "classification", "point_source_id", "return_number"]),
    value=st.one_of(st.integers(-70_000, 140_000), st.floats(-3, 300)).filter(
        lambda value: value not in (7, 18)
    ),
)
def test_fields_of_las_keep_their_values_or_refuse_them(tmp_path, name, value):
    cloud = Cloud(PLANE[:2], {name: np.array([1, value])})
    path = tmp_path / "f.laz"
    path.unlink(missing_ok=True)
    largest = {"classification": 255, "return_number": 15}.get(name, 65_535)
    if 0 <= value <= largest and value % 1 == 0:
        io.write_cloud(path, cloud)
        assert io.read_cloud(path, columns=[name])[name][1] == value
        return
    with pytest.raises(ValueError, match=rf"Invalid {name} .* in row 2\. Must be whole"):
        io.write_cloud(path, cloud)
    assert not path.exists()


def test_other_columns_that_las_cannot_hold_are_refused(tmp_path):
    for name, values in {"X": [1, 2], "a" * 40: [1, 2], "scan_angle": [0, 270.0]}.items():
        with pytest.raises(ValueError, match=r"other than x, y, z|degrees from -180 to 180"):
            io.write_cloud(tmp_path / "c.laz", Cloud(PLANE[:2], {name: np.array(values)}))
    io.write_cloud(tmp_path / "c.laz", Cloud(PLANE[:2], {"half": np.array([0.5, 1], np.float16)}))
    assert io.read_cloud(tmp_path / "c.laz")["half"].tolist() == [0.5, 1]


def ply_header(count, *, order="ascii", before="", kind="double", names="xyz", behind=""):
    """The header of a PLY file of points."""
    fields = "".join(f"property {kind} {name}\n" for name in names)
    return f"ply\nformat {order} 1.0\n{before}element vertex {count}\n{fields}{behind}end_header\n"


FACES = "element face 2\nproperty list uchar int vertex_indices\nproperty uchar flag\n"


@QUICK
@given(
    binary=st.sampled_from(["", "<", ">"]),
    faces=st.sampled_from(["", "before", "behind"]),
    names=st.sampled_from(["xyz", "XYZ"]),
    end=st.sampled_from(["\n", "\r\n"]),
    mark=st.booleans(),
    letters=st.sampled_from(["comment plain\n", "comment für\n", "obj_info a\n", ""]),
)
def test_ply_of_any_order_is_the_same_cloud(tmp_path, binary, faces, names, end, mark, letters):
    order = {"": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}[binary]
    before = letters + (FACES if faces == "before" else "")
    behind = FACES if faces == "behind" else ""
    head = ply_header(120, order=order, before=before, names=names, behind=behind)
    if binary:
        rows = PLANE.astype(binary + "f8").tobytes()
        face = b"".join(
            np.uint8(n).tobytes() + np.arange(n).astype(binary + "i4").tobytes() + b"\1"
            for n in (3, 4)
        )
    else:
        rows = "".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in PLANE.tolist()).encode()
        face = b"3 0 1 2 1\n4 0 1 2 3 1\n"
    body = {"": rows, "before": face + rows, "behind": rows + face}[faces]
    start = b"\xef\xbb\xbf" if mark else b""
    (tmp_path / "p.ply").write_bytes(start + head.replace("\n", end).encode() + body)
    assert np.array_equal(io.read_cloud(tmp_path / "p.ply").points, PLANE)


def test_a_text_that_says_float_keeps_its_digits(tmp_path):
    rows = "".join(f"{x:.3f} {y:.3f} {z:.3f}\n" for x, y, z in PLANE + FAR)
    (tmp_path / "p.ply").write_text(ply_header(120, kind="float") + rows)
    assert np.array_equal(io.read_cloud(tmp_path / "p.ply").points, np.round(PLANE + FAR, 3))


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian"])
@pytest.mark.parametrize("count", [100, 130])
def test_ply_with_other_rows_than_its_header_says_is_refused(tmp_path, order, count):
    rows = "".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in PLANE.tolist()).encode()
    body = rows if order == "ascii" else PLANE.tobytes()
    (tmp_path / "p.ply").write_bytes(ply_header(count, order=order).encode() + body)
    with pytest.raises(ValueError, match=f"120 rows where its header says {count}"):
        io.read_cloud(tmp_path / "p.ply")


ROWS = [[f"{v:.3f}" for v in row] for row in PLANE]
FORMS = {
    "plain": lambda rows: rows,
    "comments": lambda rows: "# made by hand\n" * 100 + rows,
    "notes": lambda rows: rows.replace("\n", " // note\n", 30),
    "comment within": lambda rows: rows.replace("\n", "\n// second scan\n% third\n", 1),
    "count": lambda rows: f"120\n{rows}",
    "named in a comment": lambda rows: f"//X Y Z\n{rows}",
    "fortran": lambda rows: re.sub(r"(\d\.\d+)", r"\1D+00", rows),
    "tabs": lambda rows: rows.replace(" ", "\t"),
    "excel": lambda rows: "sep=;\nx;y;z\n" + rows.replace(" ", ";").replace(".", ","),
    "trailing": lambda rows: "x,y,z\n" + rows.replace(" ", ",").replace("\n", ",\n"),
    "pipes": lambda rows: rows.replace(" ", " | "),
    "no numbers": lambda rows: rows + "-nan(ind) 1 2\n1.#QNAN 3 4\n5 6 1.#INF\n",
    "E N H": lambda rows: "E,N,H\n" + rows.replace(" ", ","),
    "units": lambda rows: "x,y,z\nm,m,m\n" + rows.replace(" ", ","),
    "Rechtswert": lambda rows: "Rechtswert;Hochwert;Höhe\n" + rows.replace(" ", ";"),
}


@pytest.mark.filterwarnings("ignore:Dropped 3")
@QUICK
@given(
    form=st.sampled_from([*FORMS]),
    letters=st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252"]),
    end=st.sampled_from(["\n", "\r\n", "\r"]),
    ending=st.sampled_from([".xyz", ".csv", ".pts", ".asc"]),
)
def test_texts_of_any_form_are_the_same_cloud(tmp_path, form, letters, end, ending):
    rows = "".join(" ".join(row) + "\n" for row in ROWS)
    path = tmp_path / f"t{ending}"
    path.write_bytes(FORMS[form](rows).replace("\n", end).encode(letters))
    assert np.allclose(io.read_cloud(path).points, PLANE, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        (
            "x;y;z\n" + "5,400;1;2\n" * 2,
            "5,400 may be 5400 or 5.400. Must be numbers without thousands",
        ),
        ("x,y,z\n" + "0,8916,0,3159,0,0038\n" * 4, "decimal commas between commas"),
        ("0,8916,1,0159,2,0038\n" * 4, "decimal commas between commas"),
        ("x,y,z,x,y,z\n1,2,3,4,5,6\n", "column 'x' twice"),
        ("x,y,z\nmm,mm,mm\n1,2,3\n", r"columns x \[mm\], y \[mm\], z \[mm\]. Must .* in metres"),
        ("x,y,z\nus-ft,us-ft,us-ft\n1,2,3\n", r"x \[us-ft\].* Must .* in metres"),
        ("Y,X,H\n1,2,3\n", "columns Y, X, H. Must have x, y, z in metres"),
        ("P0,1,2,3\nP1,4,5,6\nP2,7,8,9\n", "its first columns are not x, y, z"),
        ("1 2 3\n" * 5 + "1 2 3 4\n", "4 columns in line 6 after 3 before"),
        ("x y z\n1 2 m\n", "no finite number in row 1 of column z, 'm'"),
    ],
)
def test_texts_that_say_two_things_get_one_sentence(tmp_path, text, part):
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(ValueError, match=part):
        io.read_cloud(tmp_path / "t.csv")


def geojson(kind="Polygon", rings=RING, **more):
    """A GeoJSON feature of one ring."""
    nested = [[*rings, rings[0]]]
    geometry = {"type": kind, "coordinates": [nested] if kind == "MultiPolygon" else nested}
    return {"type": "Feature", "properties": {}, "geometry": geometry} | more


@QUICK
@given(
    kind=st.sampled_from(["Polygon", "MultiPolygon"]),
    crs=st.sampled_from([None, "null", "EPSG:25832", "urn:ogc:def:crs:EPSG::25832"]),
    within=st.sampled_from(["Feature", "FeatureCollection", "geometry", "GeometryCollection"]),
    mark=st.booleans(),
    doubled=st.integers(0, 4),
)
def test_outlines_as_programs_write_them_are_the_same(tmp_path, kind, crs, within, mark, doubled):
    ring = [v for k, v in enumerate(RING) for _ in range(1 + (k == doubled))]
    node = geojson(kind, ring)
    if within == "FeatureCollection":
        node = {"type": within, "features": [node]}
    elif within == "geometry":
        node = node["geometry"]
    elif within == "GeometryCollection":
        node = {"type": within, "geometries": [node["geometry"]]}
    if crs is not None:
        node["crs"] = None if crs == "null" else {"type": "name", "properties": {"name": crs}}
    text = json.dumps(node).encode("utf-8-sig" if mark else "utf-8")
    (tmp_path / "p.geojson").write_bytes(text)
    found = io.read_polygon(tmp_path / "p.geojson", crs=pyproj.CRS(25832))
    assert np.array_equal(found, RING)


@pytest.mark.parametrize(
    ("node", "part"),
    [
        ({"type": "FeatureCollection", "features": [geojson()] * 2}, "2 outlines"),
        ({"type": "FeatureCollection", "features": []}, "of type unknown"),
        (geojson(geometry=None), "of type unknown"),
        (geojson(geometry={"type": "LineString", "coordinates": RING}), "of type LineString"),
        (geojson(rings=[v[:2] for v in RING]), "vertices without heights"),
        (geojson(crs={"properties": {"name": "EPSG:999999"}}), "a coordinate system that is known"),
        (geojson(crs={"properties": {"name": "local"}}), "a coordinate system that is known"),
        (geojson(rings=[[9, 48, 1], [9.0001, 48, 1], [9, 48.0001, 1]]), "looks like degrees"),
        (geojson(rings=[["a", 48, 1]] * 4), "numbers as vertices"),
        ([1], "of type unknown"),
        ("text", "of type unknown"),
    ],
)
def test_outlines_that_are_none_get_one_sentence(tmp_path, node, part):
    (tmp_path / "p.geojson").write_text(json.dumps(node))
    with pytest.raises(ValueError, match=part):
        io.read_polygon(tmp_path / "p.geojson")


def test_outlines_say_what_is_not_read(tmp_path):
    (tmp_path / "l.geojson").write_text(json.dumps(geojson(crs={"type": "link", "properties": {}})))
    assert "is not read" in said(lambda: io.read_polygon(tmp_path / "l.geojson"))[1]
    flat = [[x, y, 0.0] for x, y, _ in RING]
    (tmp_path / "f.geojson").write_text(json.dumps(geojson(rings=flat)))
    assert "All heights" in said(lambda: io.read_polygon(tmp_path / "f.geojson"))[1]


PATH = np.column_stack([np.arange(20) / 2, np.arange(20) + 1.0, np.zeros(20), np.full(20, 2.0)])
PATH_NAMES = ["time,x,y,z", "GPSTime,Easting,Northing,Height", "gps_time [s],x_m,y_m,z_m"]
ANGLES = {"roll,pitch,heading": 1, "roll_rad,pitch_rad,heading_rad": np.pi / 180}
ANGLES |= {"Roll (deg),Pitch (deg),Yaw (deg)": 1, "roll [gon],pitch [gon],heading [gon]": 10 / 9}


@QUICK
@given(
    names=st.sampled_from(PATH_NAMES),
    angles=st.sampled_from([*ANGLES]),
    separator=st.sampled_from([",", ";", "\t"]),
    both=st.booleans(),
    order=st.permutations(range(20)),
)
def test_paths_of_any_names_units_and_order_are_the_same(
    tmp_path, names, angles, separator, both, order
):
    attitude = np.tile([1.0, 2.0, 90.0], (20, 1)) * ANGLES[angles]
    rows = np.column_stack([PATH, attitude, PATH[:, 0] + 1e6])[order]
    header = f"{names},{angles}" + (",time" if both and "gps" in names.lower() else ",other")
    lines = [header, *(",".join(map(repr, row)) for row in rows.tolist())]
    (tmp_path / "path.csv").write_text("\n".join(lines).replace(",", separator))
    found = io.read_trajectory(tmp_path / "path.csv")
    assert np.allclose(found.iloc[:, :4], PATH)
    assert np.allclose(found.iloc[:, 4:], [1, 2, 90])


def test_paths_that_would_be_taken_wrongly_are_refused_or_said(tmp_path):
    file = tmp_path / "path.csv"

    def written(header, rows):
        file.write_text(header + "\n" + "\n".join(",".join(map(str, row)) for row in rows))
        return said(lambda: io.read_trajectory(file))

    week = np.where(PATH[:, :1] < 5, PATH[:, :1] + 604_795, PATH[:, :1] - 5)
    with pytest.raises(ValueError, match="the GPS week ends"):
        written("time,x,y,z", np.column_stack([week, PATH[:, 1:]]))
    headed = np.column_stack([week, PATH[:, 1:], np.full(20, 90)])
    told = written("time,x,y,z,heading", headed)[1]
    assert "The GPS week ends" in told
    assert "moves at" not in told
    radians = np.column_stack([PATH, np.full(20, np.pi / 2)])
    with pytest.raises(ValueError, match="look like radians"):
        written("time,x,y,z,heading", radians)
    other = np.column_stack([PATH, np.zeros((20, 3))])
    assert "not read are omega, phi, kappa" in written("time,x,y,z,omega,phi,kappa", other)[1]
    with pytest.raises(ValueError, match=r"of column time, '2026.*Must be seconds"):
        written("time,x,y,z", [["2026-10-31T23:59:50Z", 1, 2, 3]])
    with pytest.raises(ValueError, match="no header"):
        written("0 1 2 3 0 0 0", [[" ".join("1123000")]])
    with pytest.raises(ValueError, match="Must be in s or degrees"):
        written("time,x,y,z,roll [mils]", np.column_stack([PATH, PATH[:, 0]]))


def test_points_are_not_taken_for_segments(tmp_path):
    rng = np.random.default_rng(0)
    file, points = tmp_path / "s.txt", rng.random((30, 3)) * 50
    normals = rng.normal(size=(30, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    for more in (rng.integers(0, 256, (30, 3)), normals):
        np.savetxt(file, np.column_stack([points, more]), fmt="%.6g")
        with pytest.raises(ValueError, match="look like points with colours or normals"):
            io.read_segments(file)
    ends = np.column_stack([points, points + [0, 0, 3]])
    np.savetxt(file, ends)
    assert np.allclose(io.read_segments(file).reshape(-1, 6), ends)
    np.savetxt(file, ends[:, [0, 3, 1, 4, 2, 5]], header="X1 X2 Y1 Y2 Z1 Z2", comments="")
    assert np.allclose(io.read_segments(file).reshape(-1, 6), ends)
    np.savetxt(file, ends, header="x y z r g b", comments="")
    with pytest.raises(ValueError, match="no column 'x1'"):
        io.read_segments(file)
    names = {"header": "x1 y1 z1 x2 y2 z2", "comments": ""}
    np.savetxt(file, ends[:9] * 1000, **names)
    assert "millimetres" not in said(lambda: io.read_segments(file))[1]  # too few
    np.savetxt(file, np.tile(ends, (3, 1)) * 1000, **names)
    assert "millimetres" in said(lambda: io.read_segments(file))[1]


GREY = np.random.default_rng(1).integers(0, 200, (20, 30)).astype(np.uint8)
COLOUR = np.random.default_rng(2).integers(0, 200, (20, 30, 3)).astype(np.uint8)


@pytest.mark.parametrize("ending", [".jpg", ".png"])
def test_images_with_data_behind_their_end_are_read_and_cut_ones_not(tmp_path, ending):
    cv2.imwrite(str(tmp_path / f"i{ending}"), cv2.resize(GREY, (600, 400)))
    whole = (tmp_path / f"i{ending}").read_bytes()
    expected = io.read_image(tmp_path / f"i{ending}")
    thumbnail = b"\xff\xd8\xff\xd9"
    within = b"\xff\xe1" + (2 + len(thumbnail)).to_bytes(2, "big") + thumbnail
    held = whole[:2] + within + whole[2:] if ending == ".jpg" else whole
    (tmp_path / f"motion{ending}").write_bytes(held + bytes(range(256)) * 100)
    assert np.array_equal(io.read_image(tmp_path / f"motion{ending}"), expected)
    (tmp_path / f"cut{ending}").write_bytes(held[: len(held) // 2])
    with pytest.raises(ValueError, match="cut short"):
        io.read_image(tmp_path / f"cut{ending}")


@QUICK
@given(
    colour=st.booleans(),
    white=st.booleans(),
    deep=st.booleans(),
    packed=st.sampled_from(["none", "lzw", "deflate"]),
)
def test_tiffs_of_any_form_are_the_same_image(tmp_path, colour, white, deep, packed):
    shown = COLOUR if colour else GREY[..., None]
    shown = shown.astype(np.uint16) * 200 if deep else shown
    white = white and not colour
    stored = np.iinfo(shown.dtype).max - shown if white else shown
    path = tmp_path / "i.tif"
    rows, columns, count = stored.shape
    shape = {"driver": "GTiff", "count": count, "height": rows, "width": columns}
    more = {"photometric": "miniswhite"} if white else {"photometric": "rgb"} if colour else {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with rasterio.open(path, "w", dtype=stored.dtype, compress=packed, **shape, **more) as file:
            file.write(np.moveaxis(stored, 2, 0))
    assert np.array_equal(io.read_bands(path), np.moveaxis(shown, 2, 0))
    if not colour:
        assert np.array_equal(io.read_image(path), shown[..., 0])


@pytest.mark.parametrize("turn", range(1, 9))
def test_orientations_are_turned_upright(tmp_path, turn):
    """Against OpenCV's own reading of the same tag in a JPEG file."""
    tag = (274, "H", 1, turn, True)
    cv2.imwrite(str(tmp_path / "plain.jpg"), cv2.resize(COLOUR, (300, 200)))
    jpeg = (tmp_path / "plain.jpg").read_bytes()
    entry = b"\x12\x01\x03\x00\x01\x00\x00\x00" + bytes([turn, 0, 0, 0])
    exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0" + entry + bytes(4)
    head = b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif
    (tmp_path / "turned.jpg").write_bytes(jpeg[:2] + head + jpeg[2:])
    upright = io.read_bands(tmp_path / "plain.jpg")
    shown = io.read_bands(tmp_path / "turned.jpg")
    tifffile.imwrite(tmp_path / "t.tif", np.moveaxis(upright, 0, 2), extratags=[tag])
    assert np.array_equal(io.read_bands(tmp_path / "t.tif"), shown)
    image = Image.fromarray(np.moveaxis(upright, 0, 2))
    image.save(tmp_path / "l.tif", compression="tiff_lzw", tiffinfo={274: turn})
    assert np.array_equal(io.read_bands(tmp_path / "l.tif"), shown)
    assert io.read_image(tmp_path / "turned.jpg").shape == shown.shape[1:]


def test_palettes_and_pages_and_linear_values(tmp_path):
    colours = np.random.default_rng(3).integers(0, 2**16, (3, 256)).astype(np.uint16)
    tifffile.imwrite(tmp_path / "p.tif", GREY, photometric="palette", colormap=colours)
    assert np.array_equal(io.read_bands(tmp_path / "p.tif"), colours[:, GREY] >> 8)
    with tifffile.TiffWriter(tmp_path / "pages.tif") as file:
        for _ in range(3):
            file.write(GREY)
    assert "Read the first of 3 pages" in said(lambda: io.read_bands(tmp_path / "pages.tif"))[1]
    cv2.imwrite(str(tmp_path / "g.png"), GREY)
    raw = (tmp_path / "g.png").read_bytes()
    gamma = b"\0\0\0\4gAMA" + (100_000).to_bytes(4, "big") + bytes.fromhex("31e8965f")
    (tmp_path / "linear.png").write_bytes(raw[:33] + gamma + raw[33:])
    assert "linear in light" in said(lambda: io.read_image(tmp_path / "linear.png"))[1]


HEIGHTS = np.arange(12.0).reshape(3, 4)


def raster(path, values=HEIGHTS, tags=(), tie=(0, 0, 0, 1000, 2000, 0), cell=(2, 2, 0), **more):
    """Write a GeoTIFF by its tags."""
    place = [] if tie is None else [(33922, "d", len(tie), tie, True)]
    place += [] if cell is None else [(33550, "d", 3, cell, True)]
    tifffile.imwrite(path, values, extratags=[*place, *tags], **more)
    return path


@QUICK
@given(
    how=st.sampled_from(["tie", "tie inside", "matrix"]),
    kind=st.sampled_from(["float64", "float32", "int16", "int32"]),
    nothing=st.sampled_from([None, "-9999", "-99.99", "nan"]),
    scale=st.sampled_from([1.0, 0.01]),
    offset=st.sampled_from([0.0, 150.0]),
)
def test_rasters_of_any_form_are_the_same_heights(tmp_path, how, kind, nothing, scale, offset):
    stored = HEIGHTS.astype(kind)
    nothing = "-99" if nothing == "-99.99" and kind.startswith("int") else nothing
    if nothing not in (None, "nan"):
        stored[1, 2] = float(nothing)
    tags, place = [], {}
    if nothing:
        tags += [(42113, "s", 0, nothing, True)]
    if (scale, offset) != (1, 0):
        items = "".join(
            f'<Item name="{name.upper()}" sample="0" role="{name}">{value}</Item>'
            for name, value in (("offset", offset), ("scale", scale))
        )
        tags += [(42112, "s", 0, f"<GDALMetadata>{items}</GDALMetadata>", True)]
    if how == "tie inside":
        place["tie"] = (1, 2, 0, 1002, 1996, 0)
    if how == "matrix":
        matrix = (2, 0, 0, 1000, 0, -2, 0, 2000, 0, 0, 0, 0, 0, 0, 0, 1)
        tags, place = [*tags, (34264, "d", 16, matrix, True)], {"tie": None, "cell": None}
    found, told = said(lambda: io.read_heights(raster(tmp_path / "h.tif", stored, tags, **place)))
    row, column = np.indices(stored.shape)
    lost = stored == float(nothing or "nan")
    if kind == "float32" and nothing == "-99.99":
        lost = stored == np.float32(-99.99)
    z = scale * stored.astype(float) + offset
    expected = np.stack([1001 + 2 * column, 1999 - 2 * row, z], axis=-1)[~lost]
    assert np.allclose(found, expected)
    assert (f"Dropped {lost.sum()} of 12" in told) == lost.any()


def test_masks_of_rasters_leave_cells_out(tmp_path):
    mask = (HEIGHTS > 4).astype(np.uint8) * 255
    raster(tmp_path / "side.tif")
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK=False),
        rasterio.open(tmp_path / "side.tif", "r+") as file,
    ):
        file.write_mask(mask)
    assert (tmp_path / "side.tif.msk").is_file()
    assert len(io.read_heights(tmp_path / "side.tif")) == 7
    with tifffile.TiffWriter(tmp_path / "page.tif") as file:
        tags = [(33922, "d", 6, (0, 0, 0, 1000, 2000, 0), True), (33550, "d", 3, (2, 2, 0), True)]
        file.write(HEIGHTS, extratags=tags)
        file.write(mask > 0, photometric="mask", subfiletype=4)
    assert len(io.read_heights(tmp_path / "page.tif")) == 7


@pytest.mark.parametrize(
    ("more", "part"),
    [
        ({"cell": None}, "no tie point or no size of its cells"),
        ({"tie": None}, "no tie point or no size of its cells"),
        ({"cell": (2e-5, 2e-5, 0)}, "as of degrees"),
        ({"values": np.zeros((2, 9, 9))[..., :3], "photometric": "rgb"}, "bands"),
        ({"values": HEIGHTS.astype(np.int32) * 0 + 159_000}, "heights of 159000 to 159000"),
        ({"tags": [(34735, "H", 8, (1, 1, 0, 1, 4099, 0, 1, 9003), True)]}, "in US survey foot"),
    ],
)
def test_rasters_that_are_no_heights_in_metres_are_refused(tmp_path, more, part):
    with pytest.raises(ValueError, match=part):
        io.read_heights(raster(tmp_path / "h.tif", **more))


def test_rasters_of_other_programs_are_read_as_they_are_meant(tmp_path):
    """A turned one, an own system, one without a number, a grid of ESRI and a NetCDF file."""
    turn = rasterio.Affine(0, 2, 1000, 2, 0, 2000)  # columns go north, rows go east
    layout = {"width": 4, "height": 3, "count": 1, "dtype": "float64"}
    own = "+proj=tmerc +lon_0=13.7 +ellps=GRS80"
    with rasterio.open(tmp_path / "t.tif", "w", transform=turn, crs=own, **layout) as file:
        file.write(HEIGHTS, 1)
    row, column = np.indices(HEIGHTS.shape).reshape(2, -1)
    expected = np.column_stack([1001 + 2 * row, 2001 + 2 * column, np.arange(12.0)])
    assert np.array_equal(io.read_heights(tmp_path / "t.tif", crs=pyproj.CRS(own)), expected)
    with pytest.raises(ValueError, match="Must be in ETRS89 / UTM zone 32N, the cloud's"):
        io.read_heights(tmp_path / "t.tif", crs=pyproj.CRS(25832))
    nameless = [(34735, "H", 8, (1, 1, 0, 1, 3072, 0, 1, 32767), True)]
    path = raster(tmp_path / "n.tif", tags=nameless)
    expected = np.column_stack([1001 + 2 * column, 1999 - 2 * row, np.arange(12.0)])
    assert np.array_equal(io.read_heights(path, crs=pyproj.CRS(25832)), expected)
    rows = "\n".join(" ".join(map(str, values)) for values in HEIGHTS.tolist()).replace("5.0", "-1")
    head = "ncols 4\nnrows 3\nxllcorner 1000\nyllcorner 1994\ncellsize 2\nNODATA_value -1\n"
    (tmp_path / "dtm.asc").write_text(head + rows)
    with pytest.warns(UserWarning, match="Dropped 1 of 12 heights"):
        assert np.array_equal(io.read_heights(tmp_path / "dtm.asc"), expected[np.arange(12) != 5])
    if "netCDF" in rasterio.drivers.raster_driver_extensions().values():
        axes = {
            name: (name, places, {"standard_name": f"projection_{name}_coordinate"})
            for name, places in (("y", 1999 - 2.0 * np.arange(3)), ("x", 1001 + 2.0 * np.arange(4)))
        }
        xr.Dataset({"z": (("y", "x"), HEIGHTS)}, axes).to_netcdf(tmp_path / "h.nc", engine="scipy")
        assert np.array_equal(io.read_heights(tmp_path / "h.nc"), expected)
        xr.Dataset(dict.fromkeys(("up", "down"), (("y", "x"), HEIGHTS)), axes).to_netcdf(
            tmp_path / "two.nc", engine="scipy"
        )
        with pytest.raises(ValueError, match="several rasters, up, down"):
            io.read_heights(tmp_path / "two.nc")


def test_errors_of_the_package_do_not_look_like_damage(tmp_path, monkeypatch):
    path = las(tmp_path / "a.las")

    def fails(*_):
        raise KeyError("a slip of ours")

    monkeypatch.setattr("mmqa_lab.io.las.las_system", fails)
    with pytest.raises(KeyError, match="a slip of ours"):
        io.read_cloud(path)


def test_tables_without_some_rows_and_with_tabs(tmp_path):
    (tmp_path / "t.csv").write_text("a,b\n1,x\n,\n,\n2,y\n")
    assert io.read_table(tmp_path / "t.csv", "marks")["a"].tolist() == [1, 2]
    (tmp_path / "t.tsv").write_text("sep=\t\na\tb\n1,5\tx\n")
    assert io.read_table(tmp_path / "t.tsv", "marks")["a"].tolist() == [1.5]
    with pytest.raises(ValueError, match=r"no column 'c' beside a, b\. Must have one"):
        io.read_table(tmp_path / "t.csv", "marks", ("c",))


def test_info_describes_whatever_is_in_a_folder(tmp_path, capfd):
    las(tmp_path / "good.laz")
    las(tmp_path / "held.laz", withheld=[1] * 120)
    io.write_cloud(tmp_path / "feet.laz", Cloud(PLANE + FAR, crs=pyproj.CRS(2263)))
    laspy.LasData(laspy.LasHeader(version="1.4", point_format=6)).write(tmp_path / "empty.las")
    (tmp_path / "degrees.xyz").write_text(
        "".join(f"{11 + x / 1e5} {48 + y / 1e5} {500 + z}\n" for x, y, z in PLANE.tolist())
    )
    cv2.imwrite(str(tmp_path / "photo.png"), COLOUR)
    io.write_polygon(tmp_path / "ring.geojson", RING)
    (tmp_path / "notes.md").write_text("no cloud")
    assert main(["info", str(tmp_path), "--json"]) == 1  # notes.md
    rows = {row["file"]: row for row in json.loads(capfd.readouterr().out)}
    assert rows["good.laz"]["points"] == 120
    assert (rows["held.laz"]["points"], rows["empty.las"]["points"]) == (0, 0)
    assert "Dropped 120 of 120" in rows["held.laz"]["remarks"]
    assert rows["feet.laz"]["unit"] == "US survey foot, m"
    assert "Other commands refuse it" in rows["feet.laz"]["remarks"]
    assert "degrees" in rows["degrees.xyz"]["remarks"]
    assert rows["photo.png"]["image"] == "30 x 20 pixels, 3 bands"
    assert rows["ring.geojson"]["points"] == 4
    assert "Must be one of" in rows["notes.md"]["remarks"]


@pytest.mark.parametrize("words", ["poles", "accuracy", "map"])
def test_geocentric_clouds_have_no_heights(tmp_path, capfd, words):
    path = str(tmp_path / "g.laz")
    io.write_cloud(path, Cloud(PLANE + FAR, crs=pyproj.CRS("EPSG:4978")))
    more = {"accuracy": [path], "map": ["--out", str(tmp_path / "m.nc")]}.get(words, [])
    assert main([words, path, *more]) == 2
    assert "Must have z upwards" in capfd.readouterr().err


def test_letters_that_a_terminal_lacks_and_no_output_at_all(tmp_path):
    las(tmp_path / "größe.las")
    line = f"{sys.executable} -m mmqa_lab info größe.las"
    for more, text in (("", "gr??e.las"), (">&-", "")):
        done = subprocess.run(
            f"{line} {more}", shell=True, cwd=tmp_path, capture_output=True, text=True,
            env={**os.environ, "PYTHONIOENCODING": "ascii"},
        )  # fmt: skip
        assert (done.returncode, done.stderr) == (0, "")
        assert text in done.stdout


def ply_file(path, order, *elements):
    """Write a PLY file of elements: name, count, properties, bytes."""
    head = f"ply\nformat {order} 1.0\n"
    for name, count, properties, _ in elements:
        lines = "".join(f"property {one}\n" for one in properties)
        head += f"element {name} {count}\n{lines}"
    data = b"".join(content for *_, content in elements)
    path.write_bytes(f"{head}end_header\n".encode() + data)
    return path


XYZ = ("float x", "float y", "float z")


@pytest.mark.parametrize("camera_first", [True, False])
def test_vertices_are_read_where_other_elements_have_a_place_too(tmp_path, camera_first):
    camera = ("camera", 1, XYZ, np.zeros(3, "<f4").tobytes())
    vertex = ("vertex", 120, XYZ, PLANE.astype("<f4").tobytes())
    elements = [camera, vertex] if camera_first else [vertex, camera]
    path = ply_file(tmp_path / "c.ply", "binary_little_endian", *elements)
    np.testing.assert_allclose(io.read_cloud(path).points, PLANE, atol=1e-6)


@pytest.mark.parametrize("order", ["binary_little_endian", "ascii"])
@pytest.mark.parametrize("names", ["xxyz", "xyxz", "xyzz"])
def test_a_property_that_is_there_twice_is_refused(tmp_path, order, names):
    rows = np.ones((9, 4), "<f4")
    data = rows.tobytes() if order != "ascii" else b"1 1 1 1\n" * 9
    vertex = ("vertex", 9, [f"float {name}" for name in names], data)
    with pytest.raises(ValueError, match="line 'property float "):
        io.read_cloud(ply_file(tmp_path / "t.ply", order, vertex))


@pytest.mark.parametrize("count", [-1, -3, 127])
def test_a_list_of_an_impossible_length_is_refused(tmp_path, count):
    faces = ("face", 1, ["list char int vertex_indices"], np.int8(count).tobytes())
    vertex = ("vertex", 30, XYZ, PLANE[:30].astype("<f4").tobytes())
    path = ply_file(tmp_path / "l.ply", "binary_little_endian", faces, vertex)
    with pytest.raises(ValueError, match=r"damaged|rows where its header says"):
        io.read_cloud(path)


@pytest.mark.parametrize(("stated", "part"), [
    ({"scales": [0]}, r"scale 0 and offset 0\. Must be numbers"),
    ({"offsets": [np.inf]}, r"scale 1 and offset inf\. Must be numbers"),
    ({"units": ["ft"]}, r"heights in ft\. Must be in metres"),
])  # fmt: skip
def test_what_a_raster_states_of_its_values_is_heeded(tmp_path, stated, part):
    path = raster(tmp_path / "s.tif")
    with rasterio.open(path, "r+") as file:
        for name, value in stated.items():
            setattr(file, name, value)
    with pytest.raises(ValueError, match=part):
        io.read_heights(path)


@pytest.mark.parametrize("kind", [bool, np.complex64])
def test_values_that_are_no_heights_are_refused(tmp_path, kind):
    with pytest.raises(ValueError, match="values of type"):
        io.read_heights(raster(tmp_path / "k.tif", np.ones((4, 5), kind), photometric="minisblack"))


def test_that_a_raster_has_more_pages_is_said_and_nothing_of_the_library_is(tmp_path):
    path = raster(tmp_path / "p.tif", np.stack([HEIGHTS] * 3), photometric="minisblack")
    found, told = said(lambda: io.read_heights(path))
    assert len(found)
    assert told.startswith("Read the first of 3 pages of")
    assert "rasterio" not in told


@pytest.mark.parametrize(("text", "sentence"), [
    ("a,b\n1,2,3\n4,5,6\n", "names over"),
    ("a;b\n1;2;3;4\n", "names over"),
    ("a,b,a\n1,2,3\n", "column 'a' twice. Must be distinct names."),
])  # fmt: skip
def test_tables_whose_columns_are_not_told_apart_are_refused(tmp_path, text, sentence):
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(ValueError, match=re.escape(sentence)):
        io.read_table(tmp_path / "t.csv", "table", ("a",))


@pytest.mark.parametrize("text", [
    "a,b\n1,2\n", "a,b\n1,2,\n", "a;b\n1;2;\n", " a , b \n1,2\n", '"a","b"\r\n1,2\r\n',
    "a,b,\n1,2,\n", "a,b\n1,2,,\n",
])  # fmt: skip
def test_tables_of_any_form_have_the_same_columns(tmp_path, text):
    (tmp_path / "t.csv").write_text(text)
    table = io.read_table(tmp_path / "t.csv", "table", ("a", "b"))
    assert table[["a", "b"]].to_numpy().tolist() == [[1, 2]]


@pytest.mark.parametrize("unit", ['UNIT["metre",1]', 'UNIT["foot",0.3048]'])
def test_a_system_that_nobody_knows_is_said_and_its_feet_are_refused(tmp_path, unit):
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = np.full(3, 0.001)
    text = f'PROJCS["of the site",GEOGCS["none"],PROJECTION["Unheard_Of"],{unit}]'
    header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(text))
    record = laspy.LasData(header)
    record.xyz = PLANE
    record.write(tmp_path / "s.las")
    if "foot" in unit:
        with pytest.raises(ValueError, match=r"in foot.* Must be projected, in metres"):
            io.read_cloud(tmp_path / "s.las")
        return
    cloud, told = said(lambda: io.read_cloud(tmp_path / "s.las"))
    assert cloud.crs is None
    assert "s.las names a coordinate system that is not known" in told


@pytest.mark.parametrize("form", [1, 6])
def test_a_laz_file_that_was_written_as_a_stream_has_its_table_s_place_at_its_end(tmp_path, form):
    points = np.random.default_rng(1).random((50_010, 3))
    path = las(tmp_path / "c.laz", form, points=points)
    raw = bytearray(path.read_bytes())
    first = int.from_bytes(raw[96:100], "little")
    table = bytes(raw[first : first + 8])
    raw[first : first + 8] = (-1).to_bytes(8, "little", signed=True)
    path.write_bytes(raw + table)
    assert np.abs(io.read_cloud(path).points - points).max() < 0.001


def test_heights_that_are_none_are_counted_once_each(tmp_path):
    heights = np.arange(12, dtype=np.float32).reshape(1, 3, 4)
    heights[0, 0, :2], heights[0, 2, 3] = -1, 12_000
    choices = {"width": 4, "height": 3, "count": 1, "dtype": "float32", "driver": "GTiff"}
    place = rasterio.Affine(1, 0, 0, 0, -1, 3)
    with rasterio.open(tmp_path / "h.tif", "w", transform=place, nodata=-1, **choices) as file:
        file.write(heights)
    found, told = said(lambda: io.read_heights(tmp_path / "h.tif"))
    assert len(found) == 9
    assert "Dropped 3 of 12 heights" in told


def test_points_that_are_dropped_are_not_counted_besides(tmp_path):
    path = las(tmp_path / "i.las")
    raw = bytearray(path.read_bytes())
    raw[155:163] = struct.pack("<d", np.inf)  # the offset of x
    path.write_bytes(raw)
    _, told = said(lambda: list(io.iterate_cloud(path)))
    assert "Dropped 120 of 120 points" in told
    assert "Counted" not in told
