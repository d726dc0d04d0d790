"""Maps against a brute force, and campaigns against one cloud: and a run that was killed."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pyproj
import pytest
import xarray as xr

from mmqa_lab import io, maps
from mmqa_lab.cloud import Cloud


def street(seed=1, n=6000):
    """Points of a road of 9 m x 5 m with a kerb, far from the coordinates' zero."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([0, 0, 0], [9, 5, 0.002], (n, 3))
    points[points[:, 0] > 6, 2] += 0.12
    return points + [448000.0, 5411000.0, 100.0]


def brute(points, cell, radius):
    """n, d1..d4 in mm and sigma_MAD in mm by cell, point by point."""
    found = {}
    for key in np.unique(np.floor(points[:, :2] / cell), axis=0):
        own = points[(np.floor(points[:, :2] / cell) == key).all(axis=1)]
        distances = []
        for point in own:
            dx, dy = (points[:, :2] - point[:2]).T
            quadrants = ((dx > 0) & (dy >= 0), (dx <= 0) & (dy > 0))
            quadrants += ((dx < 0) & (dy <= 0), (dx >= 0) & (dy < 0))
            near = [np.hypot(dx[q], dy[q]).min(initial=np.inf) for q in quadrants]
            distances.append(sorted(d if d <= radius else np.inf for d in near))
        distances = np.array(distances)
        medians = [np.median(d[np.isfinite(d)]) if np.isfinite(d).any() else np.nan
                   for d in distances.T]  # fmt: skip
        centred = own - own.mean(axis=0)
        residuals = centred @ np.linalg.svd(centred)[2][2]
        mad = np.median(np.abs(residuals - np.median(residuals)))
        found[tuple(key)] = len(own), 1000 * np.array(medians), 1482.6 * mad
    return found


def test_cells_are_those_of_a_brute_force():
    points = street(n=900)
    dataset = maps.map_cloud(points, cell=1.0, radius=0.4)
    for (i, j), (n, d, sigma) in brute(points, 1.0, 0.4).items():
        cell = dataset.sel(x=i + 0.5, y=j + 0.5)
        assert cell["n"] == n
        assert cell["density"] == n
        assert [float(cell[f"d{k}"]) for k in (1, 2, 3, 4)] == pytest.approx(d, abs=1e-5)
        assert float(cell["f"]) == pytest.approx(d[3] / d[0], abs=1e-5)
        if n >= maps.MINIMUM:
            assert float(cell["sigma_mad"]) == pytest.approx(sigma, rel=2e-4, abs=1e-6)
    assert int(dataset["n"].sum()) == len(points)


@pytest.fixture
def campaign(tmp_path):
    """Two files of one street."""
    points = street()
    for k, part in enumerate((points[::2], points[1::2])):
        io.write_cloud(tmp_path / f"{k}.laz", Cloud(part))
    return [tmp_path / "0.laz", tmp_path / "1.laz"], tmp_path


def whole(paths):
    """The points of the files in one cloud."""
    return np.concatenate([io.read_cloud(path).points for path in paths])


def test_tiles_are_one_cloud(campaign):
    paths, folder = campaign
    run = maps.map_campaign(paths, folder / "run", cell=0.5, tile=4)
    found = maps.open_map(run)
    expected = maps.map_cloud(whole(paths), cell=0.5)
    assert int(found["n"].sum()) == 6000
    for name in maps.FIGURES:
        np.testing.assert_allclose(found[name], expected[name], atol=2e-6, err_msg=name)
    with pytest.raises(ValueError, match="of other files or parameters"):
        maps.map_campaign(paths, run, cell=0.25, tile=4)


def test_a_run_that_was_killed_goes_on_with_the_same_bytes(campaign):
    paths, folder = campaign
    code = (
        "import sys; from mmqa_lab import maps; "
        "maps.map_campaign(sys.argv[2:], sys.argv[1], cell=0.5, tile=2)"
    )
    child = subprocess.Popen([sys.executable, "-c", code, folder / "killed", *paths])
    while not list((folder / "killed").glob("tile_*.nc")) and child.poll() is None:
        time.sleep(0.05)
    os.kill(child.pid, signal.SIGKILL)
    child.wait()
    time.sleep(0.5)  # its workers end
    before = {path: path.stat().st_mtime_ns for path in (folder / "killed").glob("tile_*.nc")}
    maps.map_campaign(paths, folder / "killed", cell=0.5, tile=2)
    assert {path: path.stat().st_mtime_ns for path in before} == before  # what is there is done
    maps.map_campaign(paths, folder / "straight", cell=0.5, tile=2)
    tiles = sorted(path.name for path in (folder / "straight").glob("*.nc"))
    assert tiles
    for name in tiles:
        assert (folder / "killed" / name).read_bytes() == (folder / "straight" / name).read_bytes()


def test_a_lost_worker_costs_nothing(campaign):
    from distributed import Client, LocalCluster

    paths, folder = campaign
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": ":0"}
    with LocalCluster(**options) as cluster, Client(cluster) as client:
        victim = next(iter(cluster.workers.values())).process.process
        os.kill(victim.pid, signal.SIGKILL)
        run = maps.map_campaign(paths, folder / "run", cell=0.5, tile=4, client=client)
    assert int(maps.open_map(run)["n"].sum()) == 6000


def test_maps_are_written_as_netcdf_and_geotiff(tmp_path):
    import rasterio

    dataset = maps.map_cloud(street())
    maps.write_map(dataset, tmp_path / "map.nc")
    with xr.open_dataset(tmp_path / "map.nc", engine="scipy") as written:
        assert written["d1"].attrs["units"] == "mm"
        assert int(written["n"].sum()) == 6000
    with pytest.raises(ValueError, match="no coordinate system"):
        maps.write_map(dataset, tmp_path / "map.tif")
    placed = maps.placed(dataset, "EPSG:25832")
    maps.write_map(placed, tmp_path / "map.tif")
    with rasterio.open(tmp_path / "map.tif") as raster:
        assert raster.crs.to_epsg() == 25832
        assert raster.descriptions == tuple(dataset)
        east, north = raster.xy(0, 0)
        value = placed["n"].sel(x=east, y=north, method="nearest")
        assert raster.read(1)[0, 0] == value


def test_tiles_without_points_and_files_without_a_coordinate_system(tmp_path):
    near, far = street(n=500), street(n=500) + [40.0, 0, 0]
    io.write_cloud(tmp_path / "a.laz", Cloud(near, crs=pyproj.CRS("EPSG:25832")))
    io.write_cloud(tmp_path / "b.laz", Cloud(far))
    files = [tmp_path / "a.laz", tmp_path / "b.laz"]
    with pytest.warns(UserWarning, match=r"No coordinate system in .*b\.laz: taken for ETRS89"):
        run = maps.map_campaign(files, tmp_path / "run", tile=4)
    found = maps.open_map(run)
    assert np.diff(found["x"]) == pytest.approx(0.5)
    assert int(found["n"].sum()) == 1000
    assert not found["n"].sel(x=slice(448012.0, 448038.0)).any()
    assert pyproj.CRS(found["spatial_ref"].attrs["crs_wkt"]).to_epsg() == 25832


def test_clouds_in_millimetres_are_refused_before_any_work(tmp_path):
    io.write_cloud(tmp_path / "mm.laz", 1000 * street(n=500), scale=0.01)
    with pytest.raises(ValueError, match="Must lie in 30000 tiles, in metres"):
        maps.map_campaign([tmp_path / "mm.laz"], tmp_path / "run", tile=16)
    assert not list((tmp_path / "run").glob("*.xyz"))


def test_summary_has_the_quantiles_of_the_cells():
    dataset = maps.map_cloud(street())
    table = maps.summarise(dataset).set_index("figure")
    known = dataset["f"].values[np.isfinite(dataset["f"].values)]
    assert table.loc["f", "q50"] == np.median(known)
    assert table.loc["f", "n"] == len(known)
