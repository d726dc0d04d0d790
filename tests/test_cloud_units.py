"""What cannot be in metres is said."""

import warnings

import numpy as np
import pyproj
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmqa_lab import samples
from mmqa_lab.cloud import Cloud, describe, unit_remarks
from mmqa_lab.io import read_cloud, write_cloud

PER_DEGREE_M = 111_000.0


def street(seed, density, length, shift):
    """Ground and one facade of a street of this length, at this density, m."""
    rng = np.random.default_rng(seed)
    ground = rng.random((int(density * length * 12), 3)) * [length, 12, 0.05]
    facade = rng.random((int(density * length * 9), 3)) * [length, 0.02, 9]
    return np.concatenate([ground, facade]) + shift


@settings(deadline=None)
@given(
    seed=st.integers(0, 99),
    density=st.sampled_from([1, 20, 100]),
    length=st.sampled_from([3.0, 30.0]),
    east=st.floats(0, 1e7),
    unit=st.sampled_from(["m", "mm", "degrees"]),
)
def test_units_are_told_apart_at_any_density_place_and_size(seed, density, length, east, unit):
    cloud = street(seed, density, length, [east, east / 2, 100])
    if unit == "mm":
        cloud = cloud * 1000
    if unit == "degrees":
        cloud = cloud / [PER_DEGREE_M, PER_DEGREE_M, 1]
    said = " ".join(unit_remarks(cloud))
    assert ("millimetres" in said) == (unit == "mm")
    assert ("degrees" in said) == (unit == "degrees")


def test_flat_ground_in_degrees_is_said():
    plane = np.random.default_rng(2).random((500, 3)) * [2e-5, 1e-5, 0.01] + [11.5, 48.1, 500]
    assert "degrees" in unit_remarks(plane)[0]


def test_sample_clouds_are_in_metres():
    clouds = [name for name in samples.SAMPLES if samples.path(name).suffix == ".laz"]
    assert len(clouds) == 3
    for name in clouds:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            assert unit_remarks(read_cloud(samples.path(name))) == []


def test_reading_says_what_is_not_in_metres(tmp_path):
    np.savetxt(tmp_path / "mm.xyz", street(0, 20, 5, 0) * 1000, fmt="%.2f")
    with pytest.warns(UserWarning, match=r"mm\.xyz: Points have no neighbour"):
        cloud = read_cloud(tmp_path / "mm.xyz")
    assert "millimetres" in describe(cloud)["remarks"]


def test_an_empty_cloud_is_described():
    found = describe(Cloud(np.empty((0, 3)), {"gps_time": np.empty(0)}))
    assert found["points"] == 0
    assert np.isnan([found["x_low_m"], found["z_high_m"], found["time_span_s"]]).all()


def test_pairs_of_indices_give_coordinates_as_of_an_array():
    cloud = Cloud(np.arange(12.0).reshape(4, 3), {"ring": [1, 2, 3, 4]})
    assert np.array_equal(cloud[:, :2], cloud.points[:, :2])
    assert cloud[1, 2] == 5


def test_columns_of_texts_and_numbers_that_lack_some_are_counted():
    texts = np.array(["wall", np.nan, "roof"], dtype=object)
    cloud = Cloud(np.zeros((3, 3)), {"label": texts, "ring": [1.0, np.nan, np.nan]})
    assert describe(cloud)["columns"] == "label (3), ring (2)"


@pytest.mark.parametrize(
    ("system", "east", "north", "stretched"),
    [
        # of a sphere the Mercator map is 1 / cos(latitude) as long: at 49 degrees 1.52
        ("EPSG:3857", 935_000, 6_275_000, "52 % longer"),
        ("EPSG:3035", 2_700_000, 1_900_000, "1.3 % longer"),
        ("EPSG:3034", 4_000_000, 2_800_000, "3.4 % shorter"),
        ("EPSG:3857+5783", 935_000, 6_275_000, "52 % longer"),
        ("EPSG:25832", 456_000, 5_429_000, ""),
        ("EPSG:25832", 833_000, 5_400_000, ""),  # at the edge of its zone
        ("EPSG:2056", 2_600_000, 1_200_000, ""),
        ("EPSG:2154", 100_000, 6_200_000, ""),
        ("EPSG:27700", 400_000, 300_000, ""),
    ],
)
def test_maps_that_are_longer_than_the_ground_are_said(tmp_path, system, east, north, stretched):
    crs = pyproj.CRS(system)
    points = np.random.default_rng(1).random((500, 3)) * [1, 0.01, 1] + [east, north, 100]
    said = " ".join(unit_remarks(points, crs=crs))
    assert (stretched and f"are {stretched} here than on the ground") in said
    assert stretched or "on the ground" not in said
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        write_cloud(tmp_path / "c.laz", Cloud(points, crs=crs))
        read_cloud(tmp_path / "c.laz")
    assert any("on the ground" in str(one.message) for one in told) == bool(stretched)


def test_a_stretched_map_does_not_hide_that_points_lie_metres_apart():
    in_mm = np.random.default_rng(1).random((1000, 3)) * 1000 + [935_000, 6_275_000, 100]
    on_map, apart = unit_remarks(in_mm, crs=pyproj.CRS("EPSG:3857"))
    assert "on the ground" in on_map
    assert "no neighbour" in apart
