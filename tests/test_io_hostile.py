"""Files that would hang, swell or end the process, or hide what they are: one sentence each."""

import os
import warnings

import cv2
import laspy
import numpy as np
import pyproj
import pytest
import rasterio
import tifffile
from PIL import Image, ImageCms

from mmqa_lab import io, maps
from mmqa_lab.cloud import Cloud
from mmqa_lab.io import images

GREY = np.random.default_rng(2).integers(0, 256, (60, 80), np.uint8)


@pytest.fixture(params=[".las", ".laz"])
def las(request, tmp_path, rng):
    """The path and the bytes of a LAS or LAZ file of 500 points."""
    path = tmp_path / f"c{request.param}"
    io.write_cloud(path, Cloud(rng.random((500, 3)), {"head": np.arange(500)}))
    return path, bytearray(path.read_bytes())


@pytest.mark.parametrize(("place", "value", "size", "part"), [
    (100, 2**24, 4, "damaged"),
    (243, 2**24, 4, "damaged"),
    (25, 5, 1, "LAS 1.5. Must be LAS 1.0 to 1.4"),
    (96, 2**31, 4, "complete LAS"),
])  # fmt: skip
def test_sizes_in_the_head_of_las_are_bounded(las, place, value, size, part):
    path, raw = las
    raw[place : place + size] = value.to_bytes(size, "little")
    path.write_bytes(raw)
    with pytest.raises(ValueError, match=part):
        io.read_cloud(path)


@pytest.mark.parametrize(("place", "value", "part"), [
    (12, (2**31 - 1).to_bytes(4, "little"), "damaged"),
])  # fmt: skip
def test_sizes_in_the_record_of_laszip_are_bounded(tmp_path, rng, place, value, part):
    io.write_cloud(tmp_path / "c.laz", rng.random((500, 3)))
    raw = bytearray((tmp_path / "c.laz").read_bytes())
    at = raw.index(b"laszip encoded") - 2 + 54 + place
    raw[at : at + len(value)] = value
    (tmp_path / "c.laz").write_bytes(raw)
    with pytest.raises(ValueError, match=part):
        io.read_cloud(tmp_path / "c.laz")


def test_other_letters_in_names_of_records_are_no_damage(las):
    path, raw = las
    before = io.read_cloud(path)
    raw[26:30] = "Höhe".encode("latin-1")  # the system's identifier
    at = raw.index(b"LASF_Spec")
    raw[at + 20 + 2 : at + 20 + 4] = b"\xfc\xdf"  # the description of the extra bytes
    path.write_bytes(raw)
    again = io.read_cloud(path)
    assert np.array_equal(again.points, before.points)
    assert np.array_equal(again["head"], before["head"])


def test_a_second_record_of_extra_bytes_is_said(tmp_path):
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.add_extra_dim(laspy.ExtraBytesParams("amplitude", np.float32))
    header.vlrs.append(laspy.vlrs.known.ExtraBytesVlr())
    las = laspy.LasData(header)
    las.xyz = np.random.default_rng(1).random((60, 3))
    las.write(tmp_path / "e.las")
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        io.read_cloud(tmp_path / "e.las")
    records = len(laspy.open(tmp_path / "e.las").header.vlrs.get("ExtraBytesVlr"))
    assert any("first of 2 records" in str(one.message) for one in told) == (records > 1)


def test_texts_that_are_cut_or_named_at_length_get_one_sentence(tmp_path):
    (tmp_path / "c.pts").write_text("400\n" + "1 2 3 4\n" * 199)
    with pytest.raises(ValueError, match="199 rows where its first line says 400"):
        io.read_cloud(tmp_path / "c.pts")
    (tmp_path / "long.csv").write_text("x,y,z," + "(" * 100_000 + "\n1,2,3,4\n")
    with pytest.raises(ValueError, match="a name of more than 200 letters"):
        io.read_cloud(tmp_path / "long.csv")


def test_long_remarks_in_a_raster_change_no_height(tmp_path):
    choices = {"width": 4, "height": 3, "count": 1, "dtype": "float32", "driver": "GTiff"}
    place = rasterio.Affine(1, 0, 0, 0, -1, 3)
    with rasterio.open(tmp_path / "h.tif", "w", transform=place, crs=25832, **choices) as file:
        file.write(np.arange(12, dtype=np.float32).reshape(1, 3, 4))
        file.update_tags(**{f"remark_{k}": "<Item (" * 50 for k in range(1000)})
    assert (tmp_path / "h.tif").stat().st_size > 350_000
    assert sorted(io.read_heights(tmp_path / "h.tif")[:, 2]) == [*range(12)]


@pytest.mark.parametrize("inside", [True, False])
def test_the_picture_behind_a_thumbnail_is_read(tmp_path, inside):
    with tifffile.TiffWriter(tmp_path / "t.dng") as file:
        file.write(GREY[::4, ::4], subifds=int(inside), subfiletype=1)
        file.write(GREY)
    assert np.array_equal(io.read_bands(tmp_path / "t.dng")[0], GREY)


def test_raw_inks_and_profiles_are_noticed(tmp_path):
    tifffile.imwrite(tmp_path / "raw.dng", GREY, photometric=32803)
    with pytest.raises(ValueError, match=r"a RAW photograph\. Must be developed"):
        io.read_bands(tmp_path / "raw.dng")
    tifffile.imwrite(tmp_path / "inks.tif", np.stack([GREY] * 4, axis=2), photometric="separated")
    with pytest.raises(ValueError, match=r"of inks \(CMYK\)"):
        io.read_image(tmp_path / "inks.tif")
    (tmp_path / "a.jpg").write_bytes(b"\0\0\0\x18ftypheic" + bytes(99))
    with pytest.raises(ValueError, match=r"a HEIC photograph\. Must be another; save it as JPEG"):
        io.read_image(tmp_path / "a.jpg")
    (tmp_path / "a.nef").write_bytes(b"MM\0*" + bytes(2000))
    with pytest.raises(ValueError, match=r"a RAW photograph\. Must be another; save it as TIFF"):
        io.read_image(tmp_path / "a.nef")
    usual = bytearray(ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes())
    entry = usual.index(b"rTRC", 128)
    place = int.from_bytes(usual[entry + 4 : entry + 8], "big")
    linear = bytearray(usual)
    linear[place : place + 12] = b"curv" + bytes(8)
    for profile, said in ((usual, False), (linear, True)):
        Image.fromarray(GREY).convert("RGB").save(tmp_path / "p.png", icc_profile=bytes(profile))
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            io.read_bands(tmp_path / "p.png")
        assert any("linear in light" in str(one.message) for one in told) == said


def test_images_of_too_many_pixels_are_not_decoded(tmp_path):
    cv2.imwrite(str(tmp_path / "b.png"), GREY)
    raw = bytearray((tmp_path / "b.png").read_bytes())
    raw[16:24] = (60_000).to_bytes(4, "big") * 2
    (tmp_path / "b.png").write_bytes(raw)
    with pytest.raises(ValueError, match="Invalid image"):
        io.read_image(tmp_path / "b.png")


def test_a_netcdf_map_opens_at_its_place_in_a_gis(tmp_path, rng):
    """Also a hidden copy, as macOS leaves them, is no tile of the campaign."""
    points = rng.random((4000, 3)) * [6, 4, 0.01] + [448_000, 5_411_000, 100]
    (tmp_path / "tiles").mkdir()
    io.write_cloud(tmp_path / "tiles" / "a.laz", Cloud(points, crs=pyproj.CRS(25832)))
    (tmp_path / "tiles" / "._a.laz").write_bytes(b"\0\5\x16\7")
    folder = maps.map_campaign([tmp_path / "tiles"], tmp_path / "run", cell=0.5)
    dataset = maps.open_map(folder)
    maps.write_map(tmp_path / "m.nc", dataset)
    maps.write_map(tmp_path / "m.tif", dataset)
    with rasterio.open(tmp_path / "m.tif") as file:
        expected = file.transform
    names = {name: dataset[name].attrs["standard_name"] for name in "xy"}
    assert names == {name: f"projection_{name}_coordinate" for name in "xy"}
    if "netCDF" in rasterio.drivers.raster_driver_extensions().values():
        with rasterio.open(f"netcdf:{tmp_path / 'm.nc'}:density") as file:
            assert file.transform.almost_equals(expected, 1e-6)


@pytest.mark.parametrize(
    ("read", "ending"),
    [(io.read_cloud, "laz"), (io.read_trajectory, "csv"), (io.read_polygon, "geojson")],
)
def test_a_web_page_in_place_of_a_file_is_named(tmp_path, read, ending):
    (tmp_path / f"a.{ending}").write_text("\n<!DOCTYPE HTML>\n<html><body>404</body></html>\n")
    with pytest.raises(ValueError, match="a web page"):
        read(tmp_path / f"a.{ending}")


def test_a_workbook_of_points_is_no_archive_to_unpack(tmp_path):
    (tmp_path / "a.xlsx").write_bytes(b"PK\3\4" + bytes(99))
    with pytest.raises(ValueError, match=r"a workbook\. Must be another; save its sheet as CSV"):
        io.read_heights(tmp_path / "a.xlsx")


@pytest.mark.parametrize(("height", "left"), [(100.0, 37), (-950.0, 39)])
def test_minus_999_is_no_height_unless_others_are_near_it(tmp_path, height, left, rng):
    points = np.column_stack([rng.random((40, 2)), np.full(40, height)])
    points[:3, 2] = -9999, -999, -999
    np.savetxt(tmp_path / "a.csv", points, delimiter=",", header="x,y,z", comments="")
    layout = {"driver": "GTiff", "count": 1, "dtype": "float64", "crs": "EPSG:25832"}
    place = rasterio.Affine(0.5, 0, 448000, 0, -0.5, 5411004)
    with rasterio.open(
        tmp_path / "a.tif", "w", height=40, width=1, transform=place, **layout
    ) as file:
        file.write(points[:, 2:], 1)
    for ending in ("csv", "tif"):
        with pytest.warns(UserWarning, match=f"Dropped {40 - left} of 40"):
            assert len(io.read_heights(tmp_path / f"a.{ending}")) == left


def test_what_a_library_prints_while_it_decodes_is_kept_and_the_stream_is_as_before(capfd):
    with images._printed_below() as printed:
        os.write(2, b"first ")
        os.write(2, b"second\n")
    assert printed.getvalue() == b"first second\n"
    os.write(2, b"after\n")
    with images._printed_below() as printed:
        pass
    assert printed.getvalue() == b""
    assert capfd.readouterr().err == "after\n"
    first = os.dup(1)  # none of its places is left open
    os.close(first)
    with images._printed_below():
        pass
    second = os.dup(1)
    os.close(second)
    assert first == second
