"""Rows of texts and of binary clouds: how words, names and counts are told, from both sides."""

import struct
import threading
import time
import warnings

import laspy
import numpy as np
import pandas as pd
import pytest
import rasterio

from mmqa_lab import io
from mmqa_lab.io import files, forms, rasters, tables


def said(call):
    """What a call returns, and what it warned of."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = call()
    return found, " ".join(str(one.message) for one in told)


@pytest.mark.parametrize(
    ("line", "mark"),
    [("1;2,5 3", ";"), ("1\t2,5", "\t"), ("1|2", "|"), ("1,2,3", ","), ("1 2 3", r"\s+"),
     ("1,5 2,5 3,5", r"\s+"), ("1,5 2,5", ","), ("1, 2, 3", ","), ("a,b c,d e,f", ",")],
)  # fmt: skip
def test_the_separator_of_a_line_is_told_by_its_marks(line, mark):
    assert tables._separator(line) == mark


@pytest.mark.parametrize(
    ("words", "data"),
    [(["1", "2", "x"], True), (["x", "1", "y"], False), (["1"], True), (["x"], False),
     (["+.5", "-,5", "a"], True), (["nan", "a", "b"], True), (["x", "NaN", "1"], False), ([], True),
     (["a", "1x", "2y"], True)],
)  # fmt: skip
def test_a_line_of_numbers_has_two_that_begin_as_numbers(words, data):
    assert tables._is_data(words) == data


def test_rows_above_the_data_are_names_units_and_titles():
    names, units = ["x", "y", "z"], ["(m)", "[m]", "m"]
    assert tables._header([names]) == (names, 0)
    assert tables._header([names, units]) == (["x [m]", "y [m]", "z [m]"], 0)
    assert tables._header([["a title"], names, units]) == (["x [m]", "y [m]", "z [m]"], 1)
    assert tables._header([["a"], ["b"], names]) == (names, 2)
    assert tables._header([names, ["m", "m"]]) == (names, 0)  # for two of three columns


@pytest.mark.parametrize(
    ("rows", "names", "split"),
    [([["1", "5", "2", "25"]] * 2, ["a", "b"], True), ([["1", "5", "2"]] * 2, ["a", "b"], False),
     ([["1", "5", "2", "05"]] * 2, None, True), ([["1", "5", "2", "50"]] * 2, None, False),
     ([["01", "5", "2", "5"]] * 2, None, False), ([["1.0", "05"]] * 2, None, False),
     ([["1", "5", "2", "5"], ["1", "5"]], ["a", "b"], False)],
)  # fmt: skip
def test_commas_within_numbers_between_commas_are_told(rows, names, split):
    assert bool(tables._has_split_numbers(rows, names)) == split


def named(columns, names=None):
    """A table without names, with its names."""
    return tables._with_names(pd.DataFrame(dict(enumerate(columns))), names, "t")


def test_names_agree_with_columns_and_without_names_the_first_are_coordinates():
    x = [1.0, 2.5, 3.0]
    assert list(named([x] * 2)) == ["x", "y"]
    assert list(named([x] * 5)) == ["x", "y", "z", "column_4", "column_5"]
    assert list(named([x] * 3, ["a", "b", "c"])) == ["a", "b", "c"]
    assert list(named([x, x, [np.nan] * 3], ["a", "b"])) == ["a", "b"]  # a separator behind
    assert list(named([x, x], ["a", "b", "", ""])) == ["a", "b"]
    for columns, names, part in (
        ([x, x, x], ["a", "b"], "2 names over 3 columns"),
        ([x, x], ["a", "b", "c"], "3 names over 2 columns"),
        ([x, x, x], ["a", "b", "a"], "column 'a' twice"),
        ([[1, 2, 3], x, x, x], None, "not x, y, z"),  # counted
        ([x, x, [11e3, 12e3, 3], x], None, "not x, y, z"),  # two of three heights of 10 km
        ([["a", "b", "c"], x, x], None, "not x, y, z"),
    ):
        with pytest.raises(ValueError, match=part):
            named(columns, names)
    for columns in ([[1, 2, 3], x, x], [x, x, [11e3, 12, 3], x], [[1, 2, 4], x, x, x],
                    [x, x, [11e3, 12e3, 13e3]]):  # fmt: skip
        named(columns)
    assert len(named([[1, 2], [1, 2], [1, 2], [5, 6]])) == 2  # too few to tell
    long = "n" * tables.LONGEST_HEADER
    assert list(named([x], [long])) == [long]
    with pytest.raises(ValueError, match="a name of more than 200 letters"):
        named([x], [long + "n"])


ROWS = "1.5 2.25 3\n4 5 6.5\n7 8 9\n"


@pytest.mark.parametrize(
    ("text", "names"),
    [(ROWS, "xyz"), ("# a b c\n" + ROWS, "xyz"), ("# x y z\n" + ROWS, "xyz"),
     ("// n e h\n" + ROWS, "neh"), ("3\n" + ROWS, "xyz"),
     ("sep=;\n" + ROWS.replace(" ", ";"), "xyz"),
     ("e n h\n" + ROWS, "enh"), ("% no names\n" + ROWS.replace("3\n", "3 # of one\n"), "xyz"),
     (ROWS.replace("2.25", "2.25D+00").replace("1.5", "15d-1"), "xyz")],
)  # fmt: skip
def test_texts_with_comments_counts_and_exponents_are_the_same_table(tmp_path, text, names):
    (tmp_path / "t.txt").write_text(text)
    found, told = said(lambda: tables.text_table(tmp_path / "t.txt", "cloud"))
    assert list(found) == list(names)
    assert found.to_numpy().tolist() == [[1.5, 2.25, 3], [4, 5, 6.5], [7, 8, 9]]
    assert told == ""


@pytest.mark.parametrize(
    ("text", "part"),
    [("4\n" + ROWS, "3 rows where its first line says 4"), ("", "no rows"),
     ("# x y z\n", "no rows"),
     ("1,5,2,25\n1,5,2,05\n3,5,4,05\n", "decimal commas between commas"),
     (ROWS + "1 2 3 4\n", "4 columns in line 4 after 3 before")],
)  # fmt: skip
def test_texts_that_are_no_table_get_their_sentence(tmp_path, text, part):
    (tmp_path / "t.txt").write_text(text)
    with pytest.raises(ValueError, match=part):
        tables.text_table(tmp_path / "t.txt", "cloud")


def test_titles_above_a_header_and_units_below_are_heeded(tmp_path):
    text = "My survey of 2026\ntime, roll, east\n(s), (deg), (m)\n" + ROWS.replace(" ", ",")
    (tmp_path / "t.csv").write_text(text)
    found, told = said(lambda: tables.text_table(tmp_path / "t.csv", "path", header="time"))
    assert list(found) == ["time [s]", "roll [deg]", "east [m]"]
    assert "Passed over what stands above the header" in told
    (tmp_path / "t.csv").write_text(ROWS)
    with pytest.raises(ValueError, match=r"no header\. Must have one with time"):
        tables.text_table(tmp_path / "t.csv", "path", header="time")


def segment_text(rows, header="", mark=" "):
    """A text of segments."""
    return header + "\n".join(mark.join(f"{v:.9g}" for v in row) for row in rows) + "\n"


def test_segments_are_told_from_points_with_colours_or_normals(tmp_path, rng):
    file, first = tmp_path / "s.txt", rng.uniform(0, 9, (4, 3)) + 0.001
    unit = rng.normal(size=(4, 3))
    unit /= np.linalg.norm(unit, axis=1)[:, None]
    whole = rng.integers(0, 200, (4, 3)).astype(float)
    for last, points in (
        (whole, True), (whole + 0.5, False), (whole - 201, False), (whole + 65_400, False),
        (unit, True), (1.009 * unit, True), (1.011 * unit, False),
    ):  # fmt: skip
        last = np.where(last.max() > 60_000, np.minimum(last, 65_536), last)
        file.write_text(segment_text(np.column_stack([first, last])))
        if points:
            with pytest.raises(ValueError, match="look like points with colours or normals"):
                io.read_segments(file)
        else:
            assert io.read_segments(file)[:, 1] == pytest.approx(last, abs=1e-6)
    file.write_text(segment_text(np.column_stack([first, whole])[:2]))
    assert io.read_segments(file).shape == (2, 2, 3)  # too few to tell
    named = segment_text(np.column_stack([whole, first, whole]), "z2 Y1 x1 X2 y2 z1 a b c\n")
    file.write_text(named)
    found = io.read_segments(file)
    order = np.column_stack([whole, first])
    assert found[:, 0] == pytest.approx(order[:, [2, 1, 5]], abs=1e-6)
    assert found[:, 1] == pytest.approx(order[:, [3, 4, 0]], abs=1e-6)


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_tables_have_their_rows_whatever_stands_between(tmp_path, separator):
    text = "a title\nsystem,f,remarks\nA,1.5,none said\n,,\n007,2,\n"
    (tmp_path / "t.csv").write_text(text.replace(",", separator))
    found, told = said(lambda: tables.read_table(tmp_path / "t.csv", "results"))
    assert "Passed over the title 'a title'" in told
    assert found["system"].tolist() == ["A", "007"]
    assert found["f"].tolist() == [1.5, 2.0]
    (tmp_path / "t.csv").write_text("sep=" + separator + "\n" + text[8:].replace(",", separator))
    again, told = said(lambda: tables.read_table(tmp_path / "t.csv", "results"))
    assert again.equals(found)
    assert told == ""


def test_the_first_entry_that_is_no_number_is_named():
    table = pd.DataFrame({"a": [1, 2, 3], "b": ["4", "x", "y"], "c": [1.0, np.nan, np.inf]})
    for columns, part in (
        (["a", "b"], r"row 2 of column b, 'x'\. Must be numbers\."),
        (["c", "b"], r"row 2 of column c, nothing\. Must"),
        (["a", "c"], r"row 2 of column c, nothing"),
    ):
        with pytest.raises(ValueError, match=part):
            tables.with_numbers(table, columns, "t")
    loose = tables.with_numbers(table, ["a", "c"], "t", finite=False)
    assert loose["c"].tolist()[:1] == [1.0]
    for entry, grouped in (("1,234", 1), ("1.234.567,8", 1), ("12345,6", 0), ("1,23", 0)):
        wrong = pd.DataFrame({"a": [entry, "x"]})
        with pytest.raises(ValueError, match="Must be numbers") as error:
            tables.with_numbers(wrong, ["a"], "t")
        assert ("without thousands" in str(error.value)) == bool(grouped)
    for value, fits in ((0.99e300, True), (1.01 * tables.NO_NUMBER, False)):
        one = pd.DataFrame({"a": [value]})
        if fits and value < tables.NO_NUMBER:
            assert len(tables.with_numbers(one, ["a"], "t")) == 1
        elif not fits:
            with pytest.raises(ValueError, match="no finite number in row 1"):
                tables.with_numbers(one, ["a"], "t")


POINTS = np.array([[1.5, 2, 3], [4, 5.25, 6], [7, 8, 9.125]])


@pytest.mark.parametrize("order", ["<", ">", ""])
def test_vertices_stand_behind_rows_with_lists_of_any_type(tmp_path, order):
    """Two faces of three and of four corners, and an element without lists, before the vertices."""
    word = {"<": "binary_little_endian", ">": "binary_big_endian", "": "ascii"}[order]
    head = f"ply\nformat {word} 1.0\ncomment one\nelement face 2\n"
    head += "property list uchar int corners\nproperty ushort kind\nelement other 3\n"
    head += "property short a\nproperty double b\nelement vertex 3\n"
    head += "property double x\nproperty double y\nproperty double z\nproperty uchar red\n"
    head += "obj_info two\nend_header\n"
    faces, body = [(3, 0, 1, 2), (4, 0, 1, 2, 0)], b""
    for n, *corners in faces:
        body += struct.pack(f"{order}B{n}iH", n, *corners, 9) if order else (
            " ".join(map(str, (n, *corners, 9))) + "\n").encode()  # fmt: skip
    for k in range(3):
        body += struct.pack(f"{order}hd", k, k) if order else f"{k} {k}.5\n".encode()
    for k, row in enumerate(POINTS):
        body += struct.pack(f"{order}dddB", *row, k) if order else (
            " ".join(map(str, row)) + f" {k}\n").encode()  # fmt: skip
    path = tmp_path / "a.ply"
    path.write_bytes(head.encode() + body)
    points, columns, about = forms.read_ply(path)
    assert points.tolist() == POINTS.tolist()
    assert columns["red"].tolist() == [0, 1, 2]
    assert np.isnan(about["resolution"]) or not order
    for changed in (
        body[:-1] if order else body[: body[:-1].rfind(b"\n")],
        body + (b"\0" * 25 if order else b"1 2 3 4"),
    ):
        path.write_bytes(head.encode() + changed)
        with pytest.raises(ValueError, match="rows where its header says"):
            forms.read_ply(path)


@pytest.mark.parametrize("kind", ["<f4", "<f8"])
def test_points_of_pcd_have_their_colours_and_their_step(tmp_path, kind):
    """Colours are packed into four bytes, blue first."""
    colour = np.array([0x112233, 0x445566, 0xAABBCC], "<u4")
    rows = np.zeros(3, [("x", kind), ("y", kind), ("z", kind), ("rgb", "<u4"), ("i", "<u2")])
    for axis, values in zip("xyz", POINTS.T, strict=True):
        rows[axis] = values
    rows["rgb"], rows["i"] = colour, [7, 8, 9]
    size = kind[-1]
    head = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z rgb i\n"
    head += f"SIZE {size} {size} {size} 4 2\nTYPE F F F U U\nCOUNT 1 1 1 1 1\nWIDTH 3\nHEIGHT 1\n"
    head += "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 3\nDATA binary\n"
    path = tmp_path / "a.pcd"
    path.write_bytes(head.encode() + rows.tobytes())
    (points, columns, about), told = said(lambda: forms.read_pcd(path))
    assert points.tolist() == POINTS.tolist()
    assert told == ""
    assert columns["red"].tolist() == [0x11, 0x44, 0xAA]
    assert columns["green"].tolist() == [0x22, 0x55, 0xBB]
    assert columns["blue"].tolist() == [0x33, 0x66, 0xCC]
    assert columns["i"].tolist() == [7, 8, 9]
    step = about["resolution"]
    assert step == np.spacing(np.float32(9.125)) if kind == "<f4" else np.isnan(step)
    path.write_bytes(head.encode() + rows.tobytes()[: -rows.itemsize])
    with pytest.raises(ValueError, match="Invalid cloud"):
        forms.read_pcd(path)
    path.write_bytes(head.replace("0 0 0 1 0 0 0", "1 2 0 1 0 0 0").encode() + rows.tobytes())
    assert "states a viewpoint, 1 2 0 1 0 0 0" in said(lambda: forms.read_pcd(path))[1]


def test_scans_of_ptx_stand_at_their_poses_in_columns_and_rows(tmp_path):
    """Two scans of 2 x 3 points, the second turned by a quarter; 0, 0, 0 is no return."""
    own = np.arange(18.0).reshape(6, 3)
    own[0] = 0
    matrices = [np.eye(4), np.array([[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [10, 20, 30, 1.0]])]
    text = ""
    for matrix in matrices:
        text += "2\n3\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n"
        text += "\n".join(" ".join(map(str, row)) for row in matrix.tolist()) + "\n"
        text += "".join(f"{x} {y} {z} {k / 8} {k} 2 3\n" for k, (x, y, z) in enumerate(own))
    (tmp_path / "a.ptx").write_text(text)
    pieces = list(forms.ptx_pieces(tmp_path / "a.ptx"))
    for number, (piece, matrix) in enumerate(zip(pieces, matrices, strict=True)):
        expected = np.column_stack([own, np.ones(6)]) @ matrix
        assert piece.points == pytest.approx(expected[:, :3])
        assert piece.columns["scan"].tolist() == [number] * 6
        assert piece.columns["column"].tolist() == [0, 0, 0, 1, 1, 1]
        assert piece.columns["row"].tolist() == [0, 1, 2, 0, 1, 2]
        assert piece.columns["intensity"].tolist() == [k / 8 for k in range(6)]
        assert piece.columns["red"].tolist() == [*range(6)]
        assert piece.left["have no return"].tolist() == [True] + [False] * 5
    for scan in (1, "1"):
        (piece,) = forms.ptx_pieces(tmp_path / "a.ptx", scan)
        assert piece.points == pytest.approx(pieces[1].points)
    (tmp_path / "a.ptx").write_text(text.rstrip("\n").rpartition("\n")[0])
    with pytest.raises(ValueError, match="5 rows where the header of scan 1 says 6"):
        list(forms.ptx_pieces(tmp_path / "a.ptx"))


@pytest.mark.parametrize("name", ["turned", "scaled"])
def test_cells_of_rasters_lie_at_the_middles_of_their_places(tmp_path, name):
    heights = np.arange(12.0).reshape(3, 4) + 1
    heights[1, 2], heights[0, 0] = -9999, np.nan
    place = rasterio.Affine(2, 0, 1000, 0, -2, 2000)
    if name == "turned":
        place = rasterio.Affine(1.2, 1.6, 1000, 1.6, -1.2, 2000)
    layout = {"driver": "GTiff", "width": 4, "height": 3, "count": 1, "dtype": "float64"}
    with rasterio.open(
        tmp_path / "h.tif", "w", transform=place, crs="EPSG:25832", **layout
    ) as file:
        file.write(heights, 1)
        if name == "scaled":
            file.scales, file.offsets = (0.5,), (7.0,)
    found, told = said(lambda: io.read_heights(tmp_path / "h.tif"))
    i, j = np.nonzero(np.isfinite(heights) & (heights > -999))
    matrix = np.reshape(place, (3, 3))[:2]
    expected = np.column_stack([j + 0.5, i + 0.5, np.ones(len(i))]) @ matrix.T
    assert found[:, :2] == pytest.approx(expected)
    scale, offset = (0.5, 7) if name == "scaled" else (1, 0)
    assert found[:, 2] == pytest.approx(scale * heights[i, j] + offset)
    assert "Dropped 2 of 12 heights" in told
    with rasters.open_raster(tmp_path / "h.tif", "reference") as (file, names):
        assert (file.count, names) == (1, [])


def test_heights_of_ten_kilometres_and_points_given_twice_are_counted(tmp_path):
    limit = rasters.NO_HEIGHT_M
    rows = [(0, 0, 1), (1, 0, limit - 1), (2, 0, limit), (3, 0, -limit - 5), (0, 0, 1), (4, 4, 2)]
    text = "x,y,z\n" + "\n".join(",".join(map(str, row)) for row in rows)
    (tmp_path / "h.csv").write_text(text + "\n")
    found, told = said(lambda: io.read_heights(tmp_path / "h.csv"))
    assert found.tolist() == [[0, 0, 1], [1, 0, limit - 1], [4, 4, 2]]
    assert "Dropped 2 of 6 heights" in told
    assert "Dropped 1 points of" in told
    (tmp_path / "h.csv").write_text("x,y,z\n0,0,20000\n1,1,30000\n")
    with pytest.raises(ValueError, match="heights of 20000 to 30000"):
        io.read_heights(tmp_path / "h.csv")


def test_letters_of_a_text_are_told_by_its_first_bytes(tmp_path):
    text = "x,y,z,größe\n1,2,3,4\n"
    for letters in ("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32", "cp1252"):
        (tmp_path / "t.csv").write_bytes(text.encode(letters))
        found = tables.read_table(tmp_path / "t.csv", "cloud")
        assert list(found)[:3] == ["x", "y", "z"], letters
        assert letters == "cp1252" or list(found)[3] == "größe", letters
        assert found.to_numpy().tolist() == [[1, 2, 3, 4]]


def test_letters_are_told_by_the_places_of_zeros():
    """More zeros than a quarter of one half of the bytes are the empty bytes of UTF-16."""
    for zeros, letters in ((10, "utf-8"), (11, "utf-16-le")):
        head = bytearray(b"a" * 80)
        head[1 : 2 * zeros : 2] = bytes(zeros)
        assert files._letters(bytes(head)) == letters
        assert files._letters(b"a" + bytes(head[:-1])) == letters.replace("le", "be")
    assert files._letters(bytes(80)) == "utf-8"  # of all alike nothing is told
    assert files._letters("ä".encode() * 40) == "utf-8"
    assert files._letters(("ä" * 40).encode()[:-1]) == "utf-8"  # cut within a letter
    assert files._letters("ä".encode("cp1252") * 3 + b"a") == "cp1252"


def test_a_lock_that_was_left_behind_is_taken_over_and_another_waited_for(tmp_path):
    file, lock = tmp_path / "a" / "t.csv", tmp_path / "a" / "t.csv.lock"
    with files.alone(file):
        assert lock.exists()
        begun = time.monotonic()
        with files.alone(file, seconds=0.1):  # as if the first had died
            assert time.monotonic() - begun >= 0.1
    assert not lock.exists()
    with files.alone(file):
        waiting = threading.Thread(target=lambda: files.alone(file).__enter__())
        waiting.start()
        waiting.join(0.1)
        assert waiting.is_alive()
    waiting.join(5)
    assert not waiting.is_alive()


def test_a_folder_of_a_run_is_new_empty_or_marked(tmp_path):
    new = tmp_path / "deep" / "new"
    with files.own_folder(new) as folder:
        assert (folder / files.MARK).stat().st_size > 0
        with pytest.raises(ValueError, match="another run writes into it"), files.own_folder(new):
            pass
    assert not new.exists()  # it was made for nothing
    empty = tmp_path / "empty"
    empty.mkdir()
    with files.own_folder(empty):
        pass
    assert [one.name for one in empty.iterdir()] == [files.MARK]
    size = (empty / files.MARK).stat().st_size
    (empty / "f.csv").write_text("1")
    with files.own_folder(empty):
        pass
    assert (empty / files.MARK).stat().st_size == size  # is marked once
    other = tmp_path / "other"
    other.mkdir()
    (other / "mine.txt").write_text("1")
    with pytest.raises(ValueError, match=r"mine\.txt in it is not from mmqa"):
        files.own_folder(other).__enter__()
    with files.own_folder(other, ours=True):
        assert (other / files.MARK).is_file()
    assert (other / "mine.txt").read_text() == "1"


def test_pieces_of_a_cloud_count_what_is_dropped_over_all_of_them(tmp_path, rng):
    """Seven of 250 points in pieces of 100 are withheld, and thirteen overlap, one of them both."""
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = np.full(3, 0.001)
    record = laspy.LasData(header)
    record.xyz = rng.random((250, 3)).round(3) + 5
    withheld, overlap = np.zeros(250, int), np.zeros(250, int)
    withheld[[0, 50, 99, 100, 199, 200, 249]] = 1
    overlap[[249, *range(130, 142)]] = 1
    record.withheld, record.overlap, record.user_data = withheld, overlap, np.arange(250) % 200
    record.write(tmp_path / "a.laz")
    parts, told = said(lambda: list(io.iterate_cloud(tmp_path / "a.laz", chunk=100)))
    assert [len(part) for part in parts] == [97, 98, 48]
    assert f"Dropped 7 of 250 points of {tmp_path / 'a.laz'} that are marked as withheld" in told
    assert f"Counted 12 of 250 points of {tmp_path / 'a.laz'} that are marked as overlap" in told
    kept = np.concatenate([part["user_data"] for part in parts])
    assert np.array_equal(kept, (np.arange(250) % 200)[withheld == 0])
    one = said(lambda: list(io.iterate_cloud(tmp_path / "a.laz", columns=["user_data"])))[0]
    assert [*one[0].columns] == ["user_data"]
    with pytest.raises(ValueError, match="no scans in it"):
        list(io.iterate_cloud(tmp_path / "a.laz", scan=0))


def test_a_long_entry_is_named_by_its_first_letters():
    with pytest.raises(ValueError, match=r"column a, '" + "b" * 30 + r"'\. Must be numbers\."):
        tables.with_numbers(pd.DataFrame({"a": ["b" * 50]}), ["a"], "t")
