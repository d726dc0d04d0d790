"""Reading and writing clouds, polygons and trajectories."""

import json

import laspy
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pyproj
import pytest
import rasterio
from hypothesis import given, settings
from hypothesis import strategies as st

from mmqa_lab import samples
from mmqa_lab._checks import check_same_crs
from mmqa_lab.cloud import Cloud
from mmqa_lab.io import (
    iterate_cloud,
    read_bands,
    read_cloud,
    read_heights,
    read_polygon,
    write_atomically,
    write_cloud,
    write_polygon,
)

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


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize(("kind", "step"), [("double", np.nan), ("float", 0.5)])
def test_ply_keeps_every_property_and_knows_its_step(tmp_path, cloud, order, kind, step):
    types = [("x", "f8" if kind == "double" else "f4")] * 3
    types = [(axis, types[0][1]) for axis in "xyz"] + [("ring", "u1")]
    rows = np.empty(len(cloud), types)
    rows["x"], rows["y"], rows["z"] = cloud.points.T
    rows["ring"] = cloud["ring"]
    names = [f"property {kind} {axis}" for axis in "xyz"]
    head = ["ply", f"format {order} 1.0", "comment by hand", f"element vertex {len(cloud)}", *names]
    head += ["property uchar ring", "element face 0", "end_header", ""]
    body = rows.astype(rows.dtype.newbyteorder(">" if "big" in order else "<")).tobytes()
    if order == "ascii":
        body = "".join(" ".join(map(str, row.tolist())) + "\n" for row in rows).encode()
    (tmp_path / "c.ply").write_bytes("\n".join(head).encode() + body)
    again = read_cloud(tmp_path / "c.ply")
    assert np.array_equal(again.points[:, 0], rows["x"].astype(float))
    assert np.array_equal(again["ring"], cloud["ring"])
    assert np.array_equal(again.resolution, step, equal_nan=True)


def test_coordinate_systems_are_read_and_written_and_not_mixed(tmp_path, cloud):
    placed = Cloud(cloud.points, crs=pyproj.CRS("EPSG:25832"))
    write_cloud(tmp_path / "c.laz", placed, scale=0.01)
    again = read_cloud(tmp_path / "c.laz", columns=())
    assert again.crs == again[:3].crs == placed.crs
    assert again[:5].resolution == 0.01
    other = Cloud(cloud.points, crs=pyproj.CRS("EPSG:25833"))
    with pytest.raises(ValueError, match="Must be in ETRS89 / UTM zone 32N"):
        Cloud.concatenate([again, other])


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


def test_rejects_writing_what_las_cannot_hold(tmp_path, cloud):
    with pytest.raises(ValueError, match="Must be coarser for a cloud as wide"):
        write_cloud(tmp_path / "c.laz", Cloud([[0, 0, 0], [1e7, 0, 0]]), scale=1e-4)
    with pytest.raises(ValueError, match="Invalid column 'name'"):
        write_cloud(tmp_path / "c.laz", Cloud(cloud.points[:1], {"name": np.array(["a"])}))
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
    assert [path.name for path in tmp_path.iterdir()] == ["t.csv"]


def test_devices_stay_and_links_lead_to_their_file(tmp_path):
    with pytest.raises(OSError, match="a folder or device"):
        write_atomically("/dev/null", "text")
    (tmp_path / "far").mkdir()
    (tmp_path / "link.txt").symlink_to(tmp_path / "far" / "file.txt")
    write_atomically(tmp_path / "link.txt", "text")
    assert (tmp_path / "link.txt").is_symlink()
    assert (tmp_path / "far" / "file.txt").read_text() == "text"


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


NAMES = "x,y,z", "Easting,Northing,Height", "easting_m,northing_m,height_m", "x [m],y [m],z [m]"
NAMES += "X,Y,Z", "East,North,Elevation"


@settings(deadline=None)
@given(
    names=st.sampled_from([names.split(",") for names in NAMES]),
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
        names = ["x", "y", "z"]
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
    assert len(read_heights(tmp_path / "h.tif")) == 5
    raster(tmp_path / "whole.tif", heights)
    assert read_heights(tmp_path / "whole.tif")[:, 2].tolist() == heights.ravel().tolist()


@pytest.mark.parametrize("interleave", ["pixel", "band"])
def test_bands_of_a_raster_keep_their_order(tmp_path, interleave):
    values = np.arange(4 * 6 * 5, dtype=np.uint16).reshape(4, 6, 5) * 500
    shape = {"driver": "GTiff", "count": 4, "height": 6, "width": 5, "dtype": "uint16"}
    with rasterio.open(
        tmp_path / "i.tif", "w", interleave=interleave, compress="deflate", **shape
    ) as file:
        file.write(values)
    assert np.array_equal(read_bands(tmp_path / "i.tif"), values)


def test_bands_of_a_photograph_begin_with_red(tmp_path):
    values = np.arange(5 * 7 * 3, dtype=np.uint8).reshape(5, 7, 3)
    plt.imsave(tmp_path / "i.png", values)
    assert np.array_equal(read_bands(tmp_path / "i.png"), np.moveaxis(values, 2, 0))


def test_coordinate_systems_are_compared_in_plan():
    """A height system changes nothing in plan; ED50 in the same zone lies 100 m from ETRS89."""
    same = pyproj.CRS("EPSG:25832")
    check_same_crs("polygon", pyproj.CRS("EPSG:25832+7837"), "cloud", same)
    for number in (32632, 25833, 23032, 4258):
        with pytest.raises(ValueError, match="Must be in ETRS89 / UTM zone 32N, the cloud's"):
            check_same_crs("polygon", pyproj.CRS(number), "cloud", same)
