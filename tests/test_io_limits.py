"""What readers look at in bytes, marks and numbers: each limit from both sides."""

import io as memory
import json
import re
import struct
import warnings
from types import SimpleNamespace

import cv2
import numpy as np
import pandas as pd
import pytest
import tifffile
from PIL import Image

from mmqa_lab import io
from mmqa_lab.io import images, las, marks, path_doubts


def said(call):
    """What a call returns, and what it warned of."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = call()
    return found, " ".join(str(one.message) for one in told)


COLOUR = np.random.default_rng(2).integers(0, 200, (20, 30, 3)).astype(np.uint8)
CLEAR = np.where(np.arange(600).reshape(20, 30) < 150, 0, 255).astype(np.uint8)  # a quarter


def pictures(folder, alpha):
    """The same photograph with transparency of several kinds."""
    Image.fromarray(np.dstack([COLOUR, alpha])).save(folder / "colour.png")
    Image.fromarray(np.dstack([COLOUR[..., 0], alpha]), "LA").save(folder / "grey.png")
    deep = np.dstack([COLOUR[..., ::-1], alpha]).astype(np.uint16) * 257
    cv2.imwrite(str(folder / "deep.png"), deep)
    few = Image.fromarray(np.where(alpha < 255, 3, COLOUR[..., 0] % 3).astype(np.uint8), "P")
    few.putpalette([*range(30)])
    few.save(folder / "palette.png", transparency=3)
    both = np.dstack([COLOUR, alpha])
    tifffile.imwrite(folder / "alpha.tif", both, photometric="rgb", extrasamples=["unassalpha"])
    return sorted(folder.iterdir())


@pytest.mark.parametrize("reader", [io.read_image, io.read_bands])
def test_transparent_pixels_are_said_and_have_the_colours_below(reader, tmp_path):
    for file in pictures(tmp_path, CLEAR):
        found, told = said(lambda file=file: reader(file))
        assert told.startswith(f"25 % of the pixels of {file} are transparent"), file.name
        if file.name == "colour.png" and reader is io.read_bands:
            assert np.array_equal(found, np.moveaxis(COLOUR, 2, 0))
    for file in pictures(tmp_path, np.full_like(CLEAR, 255)):
        assert said(lambda file=file: reader(file))[1] == "", file.name
    other = np.dstack([COLOUR, CLEAR])  # a fourth band is no transparency of itself
    tifffile.imwrite(tmp_path / "nir.tif", other, photometric="rgb", extrasamples=["unspecified"])
    assert said(lambda: reader(tmp_path / "nir.tif"))[1] == ""
    grey = Image.fromarray(COLOUR[..., 0])
    grey.save(tmp_path / "key.png", transparency=int(COLOUR[0, 0, 0]))
    assert said(lambda: reader(tmp_path / "key.png"))[1] == ""


@pytest.mark.parametrize("kind", ["RGB", "L", "RGBA", "LA", "P", "progressive"])
def test_the_shape_of_a_picture_stands_in_its_head(kind):
    file, jpeg = memory.BytesIO(), kind == "progressive"
    image = Image.fromarray(COLOUR).convert("RGB" if jpeg else kind)
    image.save(file, "JPEG" if jpeg else "PNG", **({"progressive": True} if jpeg else {}))
    bands = {"RGB": 3, "L": 1, "RGBA": 4, "LA": 2, "P": 3, "progressive": 3}[kind]
    assert images._shape(file.getvalue()) == (True, (20, 30, bands))
    assert images._shape(file.getvalue()[:-9])[0] == (not jpeg and False)


def test_the_frame_of_a_jpeg_is_found_among_its_segments():
    """Tables with markers among those of frames, fill bytes and bare markers stand before it."""
    part = lambda mark, body: b"\xff" + mark + (2 + len(body)).to_bytes(2, "big") + body  # noqa: E731
    wrong = struct.pack(">BHHB", 8, 7, 9, 1)
    frame = struct.pack(">BHHB", 8, 480, 640, 3)
    before = [part(b"\xe0", b"JFIF\xff\xd9"), b"\xff\x01", b"\xff\xd0", b"\xff\xd7", b"\xff",
              part(b"\xc4", wrong), part(b"\xc8", wrong), part(b"\xcc", wrong)]  # fmt: skip
    for mark in (b"\xc0", b"\xc2", b"\xcf"):
        data = b"\xff\xd8" + b"".join(before) + part(mark, frame) + part(b"\xda", b"\x01\x02")
        assert images._shape(data) == (False, (480, 640, 3))
        assert images._shape(data + b"\x12\xff\xd9more") == (True, (480, 640, 3))
    assert images._shape(b"II*\0") == (True, ())
    assert images._shape(b"\x89PNG") == (False, (0, 0, 1))


def las_bytes(*, records=(), gap=0, extended=(0, 0), minor=4, count=None, size=None, points=40):
    """The head of a LAS file with records of these user names and bodies, and some points."""
    body = b"".join(
        struct.pack("<2x16sHH32s", name, 7, len(data), b"") + data for name, data in records
    )
    head = bytearray(375)
    head[:4], head[24:26] = b"LASF", bytes([1, minor])
    first = 375 + len(body) + gap
    struct.pack_into("<HII", head, 94, 375, first, len(records) if count is None else count)
    struct.pack_into("<QI", head, 235, *extended)
    return bytes(head) + body + b"\0" * (max(gap, 0) + points)


LASZIP = b"laszip encoded"


@pytest.mark.parametrize(
    ("choices", "fits"),
    [
        ({"records": [(b"a", b"12345"), (b"b", b"")]}, True),
        ({"records": [(b"a", b"12345")], "gap": -1}, False),  # behind the first point
        ({"count": 1, "gap": 54}, True),
        ({"count": 1, "gap": 53}, False),
        ({"extended": (395, 1), "points": 80}, True),  # 60 bytes are left
        ({"extended": (396, 1), "points": 80}, False),
        ({"extended": (396, 1), "points": 80, "minor": 3}, True),  # it has no such number
        ({"records": [(LASZIP, bytes(12) + struct.pack("<I", las.LARGEST_CHUNK))]}, True),
        ({"records": [(LASZIP, bytes(12) + struct.pack("<I", las.LARGEST_CHUNK + 1))]}, False),
        ({"records": [(LASZIP, bytes(12) + struct.pack("<I", 2**32 - 1))]}, True),  # of any size
        ({"records": [(LASZIP, bytes(12) + struct.pack("<I", 2**32 - 2))]}, False),
        ({"records": [(b"other", bytes(12) + struct.pack("<I", 2**32 - 2))]}, True),
    ],
)
def test_records_and_chunks_fit_into_their_file(choices, fits, tmp_path):
    (tmp_path / "a.las").write_bytes(las_bytes(**choices))
    if fits:
        las._check_sizes(tmp_path / "a.las")
    else:
        with pytest.raises(ValueError, match=r"more records|records behind"):
            las._check_sizes(tmp_path / "a.las")


def test_letters_beside_ascii_are_replaced_in_names_alone(tmp_path):
    """In identifiers of the head and of each record: first and last byte, and the next to them."""
    records = [(b"first", b"123"), (b"second", b"4567")]
    plain, path = las_bytes(records=records), tmp_path / "a.las"
    path.write_bytes(plain)
    assert las._plain_source(path) is path
    second = 375 + 54 + 3
    names = [26, 89, 377, 392, 397, 428, second + 2, second + 17, second + 22, second + 53]
    others = [25, 90, 375, 393, 396, 429, 431, second + 1, second + 18, second + 21, second + 54]
    for at in (*names, *others):
        if at in (25, 393, 394, 395, 396) or at - second in (18, 19, 20, 21):
            continue  # a version, or how long a record is
        changed = bytearray(plain)
        changed[at] = 0xE9
        path.write_bytes(changed)
        found = las._plain_source(path)
        if at in names:
            expected = bytearray(plain)
            expected[at] = ord("?")
            assert found.read() == bytes(expected), at
        else:
            assert found is path, at


def test_points_outside_of_a_box_are_counted_on_all_its_sides(tmp_path):
    """Two steps of a millimetre are rounding, three are not."""
    import laspy

    points = np.random.default_rng(0).random((50, 3)).round(3) + 5
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.full(3, 0.001), np.zeros(3)
    record = laspy.LasData(header)
    record.xyz = points
    record.write(tmp_path / "a.las")
    raw = (tmp_path / "a.las").read_bytes()
    for axis in range(3):
        for place, sign, end in ((179, 1, points.max(axis=0)), (187, -1, points.min(axis=0))):
            for steps, counted in ((2, False), (2.5, True)):
                changed = bytearray(raw)
                at = place + 16 * axis
                stated = end[axis] - sign * steps * 0.001
                changed[at : at + 8] = np.float64(stated).tobytes()
                (tmp_path / "b.las").write_bytes(changed)
                told = said(lambda: io.read_cloud(tmp_path / "b.las"))[1]
                beyond = (sign * (points[:, axis] - stated) > 0.0021).sum()
                assert ("outside the box" in told) == counted
                assert not counted or f"Counted {beyond} of 50 points" in told


def field(low, high, name="user_data"):
    """A field of LAS."""
    return SimpleNamespace(name=name, min=low, max=high)


def test_columns_are_stored_in_their_fields_within_limits():
    stored = las._storable
    assert stored("user_data", np.array([0.0, 255]), field(0, 255)).tolist() == [0, 255]
    for wrong in (-1, 256, 0.5, np.nan):
        with pytest.raises(ValueError, match=r"Invalid user_data .* in row 2\. Must be whole"):
            stored("user_data", np.array([3, wrong]), field(0, 255))
    angle = field(-30_000, 30_000, "scan_angle")
    assert stored("scan_angle", np.array([-180, 12.0, 180]), angle).tolist() == [
        -30_000, 2000, 30_000]  # fmt: skip
    for wrong in (-180.1, 180.1):
        with pytest.raises(ValueError, match=r"in row 1\. Must be degrees from -180 to 180"):
            stored("scan_angle", np.array([wrong]), angle)
    for given, kind in (("f2", "f8"), ("f4", "f4"), ("f8", "f8"), ("?", "u1"), ("i2", "i2")):
        assert stored("extra", np.ones(2, given), None).dtype == kind
        assert stored("gps_time", np.ones(2, given), field(0, 0, "gps_time")).dtype == kind
    long = "ä" * (las.LONGEST_NAME // 2)
    assert len(stored(long, np.ones(2), None)) == 2
    for name, values in ((long + "ä", np.ones(2)), ("x", np.ones((2, 2))), ("x", np.array(["a"]))):
        with pytest.raises(ValueError, match="Invalid column"):
            stored(name, values, None)


def masks(points, **columns):
    """Reasons with the rows that have them."""
    columns = {name: np.asarray(values) for name, values in columns.items()}
    left, told = marks.marked(marks.Piece(np.asarray(points, float), columns))
    return [
        {why: np.flatnonzero(mask).tolist() for why, mask in one.items()} for one in (left, told)
    ]


def test_marks_of_points_are_told_by_their_columns():
    points = np.ones((6, 3)) * 500 + np.arange(6)[:, None]
    left, told = masks(
        points, Withheld=[0, 1, 0, 0, 0, 0], classification=[6, 7, 8, 17, 18, 12],
        synthetic=[1, 0, 0, 0, 0, 2], overlap=[0, 0, 1, 0, 0, 0],
    )  # fmt: skip
    assert left == {"are marked as withheld": [1], "are of a noise class, 7 or 18": [1, 4]}
    assert told == {"are marked as synthetic": [0, 5], "are marked as overlap": [2]}
    assert masks(points, classification=[11, 12, 13, 2, 2, 2])[1] == {"are marked as overlap": [1]}
    number, returns = [1, 2, 1, 2, 3, 1], [2, 2, 1, 3, 3, 1]
    later = masks(points, return_number=number, number_of_returns=returns)[1]
    assert later == {"are later returns of their pulses": [1, 3, 4]}
    assert masks(points, return_number=[2] * 6, number_of_returns=[2] * 6) == [{}, {}]
    assert masks(points, return_number=number, number_of_returns=[1, 2, 1, 3, 3, 1]) == [{}, {}]
    assert masks(points, withheld=["a"] * 6) == [{}, {}]


NONE = "stand for no data (-9999 and the like, or 0, 0, 0 far from others)"


def test_rows_that_stand_for_none_are_told_from_points():
    far = np.column_stack([np.arange(30.0) + 2000, np.arange(30.0) + 5, np.arange(30.0)])
    assert masks([*far, [np.nan, 1, 2], [1, np.inf, 2]])[0] == {"are not finite": [30, 31]}
    for row in (
        [5, 6, -9999],
        [5, 6, -999],
        [-9999, -9999, 7],
        [5, 6, 1.1e15],
        [-32768, -32768, 1],
    ):
        assert masks([*far, row])[0] == {NONE: [30]}, row
    for row in ([5, 6, -9998], [-9999, 5, 7], [5, -9999, 7], [-5, 6, 7]):
        assert masks([*far, row])[0] == {}, row
    # -999 is a height where others lie near it, up to 100 m
    for near, told in ((-900, False), (-898, True)):
        assert bool(masks([*far, [5, 6, -999], [5, 6, near]])[0]) == told
        assert marks.without_height(np.array([-999.0, near])).tolist() == [told, False]
    # 0, 0, 0 is none where the others are far by their spread, or where it is there often
    assert masks([*far, [0, 0, 0]])[0] == {NONE: [30]}
    steps = np.arange(31.0) - 15
    for middle, told in ((1155, False), (1165, True)):  # 1 km and 20 times their spread of 8
        there = np.column_stack([middle + steps, steps, steps])
        assert bool(masks([*there, [0, 0, 0]])[0]) == told
    for often, told in ((10, False), (11, True)):
        there = np.column_stack([steps + 50, steps, steps])
        found = masks([*there, *np.zeros((often, 3))])[0]
        assert found == ({NONE: [*range(31, 31 + often)]} if told else {})
    assert masks(np.zeros((0, 3))) == [{}, {}]


def test_every_number_of_a_camera_stands_in_its_place(tmp_path):
    right = [[900.5, 0, 320.25], [0, 910.0, 240.0], [0, 0, 1]]

    def read(matrix, terms, **more):
        (tmp_path / "c.json").write_text(json.dumps({"K": matrix, "D": terms, **more}))
        return io.read_camera(tmp_path / "c.json")

    for n in range(1, 16):
        if n in (4, 5, 8, 12, 14):
            matrix, terms, size = read(right, [0.1] * n)
            assert (matrix.tolist(), len(terms), size) == (right, n, None)
        else:
            with pytest.raises(ValueError, match="no usable distortion"):
                read(right, [0.1] * n)
    for i, j, value in ((0, 1, 0.5), (1, 0, 0.5), (2, 0, 0.5), (2, 1, 0.5), (2, 2, 2), (0, 0, -900),
                        (1, 1, 0)):  # fmt: skip
        wrong = np.array(right)
        wrong[i, j] = value
        with pytest.raises(ValueError, match="Must be fx, 0, cx; 0, fy, cy; 0, 0, 1"):
            read(wrong.tolist(), [0.1] * 5)
    assert read(right, [0] * 5, image_width=640, image_height=480)[2] == (640, 480)
    assert read(right, [0] * 5, image_width=640)[2] is None
    with pytest.raises(ValueError, match="a picture of whole pixels"):
        read(right, [0] * 5, image_width=640.5, image_height=480)
    with pytest.raises(ValueError, match="no usable matrix"):
        read(right[:2], [0] * 5)


def path_of(heading=90.0, *, step=5.0, seconds=0.5, n=30, start=0.0):
    """A drive to the east."""
    east = np.arange(n) * step
    table = {
        "time_s": start + np.arange(n) * seconds,
        "easting_m": 1000 + east,
        "northing_m": 5000.0,
    }
    return pd.DataFrame(table | {"height_m": 2.0, "heading_deg": heading})


@pytest.mark.parametrize(
    ("off", "word"),
    [(0.9, ""), (1.1, "Headings lie 1.1 degrees off"), (-1.1, "Headings lie 1.1 degrees off"),
     (44, "Headings lie 44.0 degrees off"), (46, "refused"), (-46, "refused")],
)  # fmt: skip
def test_headings_off_the_movement_are_said_and_refused_from_their_limits(off, word):
    table = path_of(90 + off)
    if word == "refused":
        with pytest.raises(ValueError, match=f"headings lie {abs(off)}.0 degrees off the movement"):
            path_doubts.check_headings(table, "p")
    else:
        assert said(lambda: path_doubts.check_headings(table, "p"))[1].startswith(word or "")
        assert bool(said(lambda: path_doubts.check_headings(table, "p"))[1]) == bool(word)
    few = path_of(90 + off, n=path_doubts.FEWEST_MOVES)  # one step less
    assert said(lambda: path_doubts.check_headings(few, "p"))[1] == ""


@pytest.mark.parametrize("name", ["roll_deg", "pitch_deg"])
def test_a_vehicle_that_lies_over_is_said_from_45_degrees(name):
    for angle, told in ((44, False), (46, True), (-46, True), (316, False), (180, True)):
        table = path_of().assign(**{name: angle})
        words = said(lambda table=table: path_doubts.check_upright(table, "p"))[1]
        assert bool(words) == told
        shown = abs((angle + 180) % 360 - 180)
        assert not told or words.startswith(f"The middle {name[:-4]} of p is {shown:.0f} degrees")


def test_speeds_tell_units_of_a_path():
    slow, fast = path_doubts.SLOWEST_M_S, path_doubts.FASTEST_M_S
    check = path_doubts.check_scales
    for speed, told in ((1.1 * slow, False), (0.9 * slow, True), (0.99 * fast, False)):
        words = said(lambda speed=speed: check(path_of(step=speed / 2), "p"))[1]
        assert bool(words) == told
    with pytest.raises(ValueError, match=rf"a speed of {1.01 * fast:.0f} m/s, as in mm"):
        check(path_of(step=1.01 * fast / 2), "p")
    for seconds, refused in ((10, True), (9, False)):
        table = path_of(step=0.9 * slow * seconds, seconds=seconds)
        if refused:
            with pytest.raises(ValueError, match="times that look like ms"):
                check(table, "p")
        else:
            assert said(lambda table=table: check(table, "p"))[1]
    degrees = path_of(step=0.04 * slow).assign(northing_m=50.0)
    degrees["easting_m"] -= 990
    with pytest.raises(ValueError, match="it looks like degrees"):
        check(degrees, "p")
    assert said(lambda: check(degrees.assign(northing_m=181.0), "p"))[1]
    with pytest.raises(ValueError, match="as of ns or us"):
        check(path_of(start=1.01 * path_doubts.LATEST_S), "p")
    check(path_of(step=0.0), "p")  # stands
    stops = path_of()  # every second step is none, or hardly any: what moves counts
    stops["easting_m"] = 1000 + np.repeat(np.arange(15) * 20.0, 2)
    assert said(lambda: check(stops, "p"))[1] == ""


def test_a_path_that_ends_its_week_or_its_day_is_told(tmp_path):
    def read(time):
        table = path_of()
        table["time_s"] = time
        table.columns = ["time", "x", "y", "z", "heading"]
        table.to_csv(tmp_path / "p.csv", index=False)
        return said(lambda: io.read_trajectory(tmp_path / "p.csv"))

    run = np.arange(30) / 2
    found, told = read(np.where(run < 5, run + 604_795, run - 5))
    assert "The GPS week ends within" in told
    assert found["time_s"].is_monotonic_increasing
    assert "moves at" not in told
    with pytest.raises(ValueError, match="the day ends within it"):
        read(np.where(run < 5, run + 86_395, run - 5))
    shuffled = np.roll(run, 7) + 40_000  # rows in another order are sorted
    assert read(shuffled)[0]["time_s"].tolist() == sorted(shuffled)
    with pytest.raises(ValueError, match="a time repeats"):
        read(np.where(run == 3, 2.5, run))


def test_sbet_has_seventeen_numbers_a_record_in_radians(tmp_path):
    def read(**more):
        rows = np.zeros((25, 17))
        rows[:, 0], rows[:, 3] = np.arange(25) + 100.0, 7.0
        rows[:, 1], rows[:, 2] = 0.9, 0.2
        rows[:, 7], rows[:, 8], rows[:, 9], rows[:, 10] = 0.01, -0.02, 1.5, 0.25
        for column, value in more.items():
            rows[3, int(column[1:])] = value
        rows.tofile(tmp_path / "a.out")
        return io.trajectories.path_table(tmp_path / "a.out")

    found = read()
    expected = {"time": 103, "height": 7, "latitude": np.degrees(0.9), "roll": np.degrees(0.01)}
    expected |= {"longitude": np.degrees(0.2), "pitch": np.degrees(-0.02)}
    assert dict(found.iloc[3]) == pytest.approx(expected | {"heading": np.degrees(1.25)})
    read(c1=np.pi / 2, c2=-np.pi)
    for wrong in ({"c1": 1.58}, {"c2": -3.15}, {"c16": np.nan}):
        with pytest.raises(ValueError, match="no latitudes and longitudes"):
            read(**wrong)
    for left in (0, 135, 271):
        (tmp_path / "a.out").write_bytes(bytes(left))
        with pytest.raises(ValueError, match=re.escape(f"{left} bytes. Must be SBET of 136")):
            io.trajectories.path_table(tmp_path / "a.out")


@pytest.mark.parametrize("size", [4, 24])
def test_a_las_file_shorter_than_its_version_is_cut_short(size, tmp_path):
    (tmp_path / "a.las").write_bytes(b"LASF".ljust(size, b"\0"))
    with pytest.raises(ValueError, match="damaged, cut short"):
        io.read_cloud(tmp_path / "a.las")
    (tmp_path / "a.las").write_bytes(b"LASF".ljust(24, b"\0") + b"\1\5")
    with pytest.raises(ValueError, match=r"LAS 1\.5\. Must be LAS 1\.0 to 1\.4"):
        io.read_cloud(tmp_path / "a.las")


def test_a_path_with_both_plan_and_globe_is_in_plan(tmp_path):
    table = path_of()[["easting_m", "northing_m", "height_m"]].assign(lat=49.0, lon=8.5)
    table.to_csv(tmp_path / "p.csv", index=False)
    with pytest.raises(ValueError, match=r"with columns easting_m.* Must have time"):
        io.read_trajectory(tmp_path / "p.csv")
    table.assign(time=np.arange(30) / 2).to_csv(tmp_path / "p.csv", index=False)
    found = said(lambda: io.read_trajectory(tmp_path / "p.csv"))[0]
    assert found["easting_m"].tolist() == table["easting_m"].tolist()
