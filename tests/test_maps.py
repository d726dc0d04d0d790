"""Maps against a brute force, and campaigns against one cloud: and a run that was killed."""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from unittest import mock

import numpy as np
import pandas as pd
import pyproj
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from mmqa_lab import io, maps
from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.cloud import Cloud
from mmqa_lab.commands.clouds import metrics_of
from mmqa_lab.maps import cells
from mmqa_lab.metrics import METRICS
from mmqa_lab.planes import fit_plane


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
        if n >= maps.cells.MINIMUM:
            assert float(cell["sigma_mad"]) == pytest.approx(sigma, rel=2e-4, abs=1e-6)
    assert int(dataset["n"].sum()) == len(points)


def test_e95_of_lines_of_random_points_and_of_gaps():
    x, y = np.meshgrid(np.arange(0, 6, 0.005), np.arange(0, 6, 0.04))
    lines = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    inside = slice(2, -2)
    e95 = maps.map_cloud(lines)["e95"][inside, inside]
    assert float(e95.mean()) == pytest.approx(19, rel=0.05)  # 95 % of half the gap
    rng = np.random.default_rng(3)
    points = rng.uniform([0, 0, 0], [20, 20, 0.01], (400 * 200, 3))
    e95 = maps.map_cloud(points)["e95"][inside, inside]
    assert float(e95.mean()) == pytest.approx(1000 * np.sqrt(np.log(20) / np.pi / 200), rel=0.05)
    bare = points[np.abs(points[:, 0] - 10.25) > 1.15]
    assert np.isnan(maps.map_cloud(bare, radius=0.3)["e95"].sel(x=9.25, y=10.25))


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
    with pytest.raises(ValueError, match="mmqa_map in it is a map of other files or parameters"):
        maps.map_campaign(paths, run, cell=0.25, tile=4)


def test_other_content_of_the_same_size_and_time_is_another_file(tmp_path):
    file = tmp_path / "a.las"
    for seed in (1, 2):
        io.write_cloud(file, np.random.default_rng(seed).random((500, 3)))
        os.utime(file, ns=(0, 0))
        if seed == 1:
            maps.map_campaign([file], tmp_path / "m")
    with pytest.raises(ValueError, match="a map of other files or parameters"):
        maps.map_campaign([file], tmp_path / "m")


RUN = "import sys; from mmqa_lab import maps; maps.campaign.ENOUGH = 1; "
RUN += "maps.map_campaign(sys.argv[2:], sys.argv[1], cell=0.5, tile=2)"


def tiles(folder):
    """Content of the files of a run's tiles."""
    return {path.name: path.read_bytes() for path in folder.rglob("tile_*.npy")}


@pytest.mark.parametrize("until", ["*.mmqa_points", "tile_*.npy"])
def test_a_run_that_was_killed_goes_on_with_the_same_bytes(campaign, until, monkeypatch, capsys):
    monkeypatch.setattr(maps.campaign, "ENOUGH", 1)
    paths, folder = campaign
    child = subprocess.Popen([sys.executable, "-c", RUN, folder / "killed", *paths])
    while not list((folder / "killed").rglob(until)) and child.poll() is None:
        time.sleep(0.01)
    child.kill()
    child.wait()
    before = {path: path.stat().st_mtime_ns for path in (folder / "killed").rglob("tile_*.npy")}
    maps.map_campaign(paths, folder / "killed", cell=0.5, tile=2)
    assert ("of 45 tiles are there." in capsys.readouterr().err) == bool(before)
    assert {path: path.stat().st_mtime_ns for path in before} == before  # what is there is done
    for workers in (1, 3):
        monkeypatch.setattr("os.cpu_count", lambda workers=workers: workers)
        maps.map_campaign(paths, folder / str(workers), cell=0.5, tile=2)
        assert tiles(folder / str(workers)) == tiles(folder / "killed")
    assert len(tiles(folder / "killed")) == 45
    assert {path.suffix for path in (folder / "killed").rglob("[!.]*.*")} == {".json", ".npy"}


def test_a_lost_worker_costs_nothing(campaign):
    from distributed import Client, LocalCluster

    paths, folder = campaign
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": ":0"}
    with LocalCluster(**options) as cluster, Client(cluster.scheduler_address) as client:
        victim = next(iter(cluster.workers.values())).process.process
        os.kill(victim.pid, signal.SIGKILL)
        run = maps.map_campaign(paths, folder / "run", cell=0.5, tile=4, client=client)
    assert int(maps.open_map(run)["n"].sum()) == 6000


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such terminals")
def test_a_terminal_shows_progress_and_a_second_run_what_is_there(campaign):
    import pty

    paths, folder = campaign
    command = [sys.executable, "-m", "mmqa_lab", "map", *paths, "--out", folder / "m.nc"]
    shown = []
    for _ in range(2):
        ours, theirs = pty.openpty()
        os.set_blocking(ours, False)
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=theirs, check=True)
        shown.append(os.read(ours, 100_000).decode())
        os.close(theirs)
        os.close(ours)
    assert "files: " in shown[0]
    assert "tiles: " in shown[0]
    assert "m.run: 2 of 2 tiles are there." in shown[1]
    assert "points/m2" in done.stdout.decode()
    assert "Coordinates are in steps of 1 mm" in done.stdout.decode()


def test_maps_are_written_as_netcdf_and_geotiff(tmp_path):
    import rasterio

    dataset = maps.map_cloud(street())
    maps.write_map(tmp_path / "map.nc", dataset)
    with xr.open_dataset(tmp_path / "map.nc", engine="scipy") as written:
        assert written["d1"].attrs["units"] == "mm"
        assert int(written["n"].sum()) == 6000
    with pytest.raises(ValueError, match="no coordinate system"):
        maps.write_map(tmp_path / "map.tif", dataset)
    placed = maps.map_cloud(Cloud(street(), crs=pyproj.CRS("EPSG:25832")))
    maps.write_map(tmp_path / "map.tif", placed.sortby("y", ascending=False))
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
    with pytest.raises(ValueError, match=r"Must lie in 100 million cells of 0\.25 m"):
        maps.map_campaign([tmp_path / "mm.laz"], tmp_path / "run", cell=0.25)
    assert not [path for path in (tmp_path / "run").rglob("*") if path.is_file()]
    with pytest.raises(ValueError, match=r"over 2000 km x 0\.\d+ km\. Must lie in 2 million"):
        maps.map_cloud(np.vstack([street(n=500), [2448000.0, 5411000.0, 0.0]]), cell=0.05)


@pytest.mark.parametrize("tile", [0, 1.5, -3, True])
def test_a_tile_has_whole_cells(tmp_path, tile):
    io.write_cloud(tmp_path / "a.laz", street(n=50))
    with pytest.raises(ValueError, match=r"Invalid tile .*\. Must be a whole number >= 1\."):
        maps.map_campaign([tmp_path / "a.laz"], tmp_path / "run", tile=tile)
    assert not (tmp_path / "run").exists()


# Cells that a million metres is a multiple of, so that a shift moves no border.
CELLS = st.sampled_from([0.05, 0.1, 0.16, 0.2, 0.25, 0.5, 0.8, 1.0])


@st.composite
def in_steps(draw):
    """Points on whole centimetres or millimetres, as files have them; some coincide."""
    step = draw(st.sampled_from([0.001, 0.01]))
    seed, n = draw(st.integers(0, 2**32 - 1)), draw(st.integers(1, 400))
    high = [int(1.3 / step), int(0.7 / step), int(0.02 / step)]
    return np.random.default_rng(seed).integers([0, 0, 0], high, (n, 3), endpoint=True) * step


def equal(found, expected, shift=(0.0, 0.0)):
    """Assert that two maps have the same cells and figures."""
    for axis, off in zip("xy", shift, strict=True):
        np.testing.assert_allclose(found[axis] - off, expected[axis], atol=1e-6)
    for name in maps.FIGURES:
        limit, share = (0, 0) if name in ("n", "coincident") else (2e-5, 1e-6)
        np.testing.assert_allclose(
            found[name].values, expected[name].values, atol=limit, rtol=share, err_msg=name
        )


@settings(max_examples=60, deadline=None)
@given(in_steps(), CELLS, st.integers(-10, 10), st.integers(-10, 10), st.randoms())
def test_order_and_shift_do_not_matter(points, cell, east, north, random):
    expected = maps.map_cloud(points, cell=cell, radius=0.3)
    assert int(expected["n"].sum()) == len(points)
    order = random.sample(range(len(points)), len(points))
    equal(maps.map_cloud(points[order], cell=cell, radius=0.3), expected)
    shift = np.array([1e6 * east, 1e6 * north, 1e5])
    # as a reader of LAS does it: whole steps times scale, plus offset
    equal(maps.map_cloud(points + shift, cell=cell, radius=0.3), expected, shift[:2])


@settings(max_examples=15, deadline=None)
@given(in_steps(), CELLS, st.integers(0, 10), st.sampled_from([1, 3, 128]), st.booleans())
def test_tiles_and_repeated_files_do_not_matter(points, cell, east, tile, together):
    points = points + [1e6 * east, 5e6, 100.0]
    with tempfile.TemporaryDirectory() as name, mock.patch.object(
        maps.campaign, "ENOUGH", 100 if together else 1
    ):  # fmt: skip
        folder = Path(name)
        (folder / "dd").mkdir()
        io.write_cloud(folder / "dd" / "a.laz", points)
        written = io.read_cloud(folder / "dd" / "a.laz").points
        (folder / "link.laz").symlink_to(folder / "dd" / "a.laz")
        shutil.copy(folder / "dd" / "a.laz", folder / "copy.laz")
        again = pd.DataFrame(written[::-1], columns=list("xyz"))
        again.to_csv(folder / "text.csv", index=False)
        files = [folder / one for one in ("dd/a.laz", "dd", "link.laz", "copy.laz", "text.csv")]
        run = maps.map_campaign(files, folder / "run", cell=cell, radius=0.3, tile=tile)
        found = maps.open_map(run)
    equal(found, maps.map_cloud(written, cell=cell, radius=0.3))
    assert found.attrs["remarks"].count("counted once.") == 2


def test_the_same_cloud_in_two_scales_counts_once(tmp_path):
    points = street(n=3000)
    io.write_cloud(tmp_path / "fine.laz", points, scale=0.0001)
    io.write_cloud(tmp_path / "coarse.laz", points, scale=0.01)
    io.write_cloud(tmp_path / "other.laz", street(seed=2, n=3000), scale=0.01)
    names = ("fine.laz", "coarse.laz", "other.laz")
    files = [tmp_path / name for name in names]
    found = maps.open_map(maps.map_campaign(files, tmp_path / "run"))
    assert int(found["n"].sum()) == 6000
    assert "fine.laz has the points of" in found.attrs["remarks"]


def test_remarks_tell_of_pairs_steps_units_and_coincident_points():
    points = street(n=3000)
    assert maps.map_cloud(points).attrs["remarks"] == ""
    twice = np.vstack([points, points + [0, 0.0005, 0.001]])
    assert "points come in pairs" in maps.map_cloud(twice).attrs["remarks"]
    same = maps.map_cloud(np.vstack([points, points[:30]]))
    assert "60 points (1.98 %) share their place" in same.attrs["remarks"]
    assert int(same["coincident"].sum()) == 60
    again = np.vstack([np.round(points, 3), np.round(points[points[:, 0] < 448003], 4)])
    tiles = maps.map_cloud(Cloud(again, resolution=0.001)).attrs["remarks"]
    assert "nearer than the steps, as of tiles that overlap; the density counts both." in tiles
    coarse = maps.map_cloud(Cloud(points, resolution=0.05)).attrs["remarks"]
    assert "Coordinates are in steps of 50 mm: too coarse for sigma_MAD" in coarse
    degrees = (points - [448000, 5411000, 0]) / [1e5, 1e5, 1] + [11.5, 48.1, 0]
    with_unit = maps.map_cloud(degrees, cell=1e-5, radius=1e-5).attrs["remarks"]
    assert "Coordinates look like degrees" in with_unit


@pytest.mark.filterwarnings("ignore")
def test_points_that_are_left_out_or_counted_are_said_in_every_run(tmp_path, capsys):
    from mmqa_lab.commands import run

    columns = {"return_number": np.tile([1, 2], 3000), "number_of_returns": np.full(6000, 2)}
    columns |= {"classification": np.where(np.arange(6000) < 300, 7, 0)}
    io.write_cloud(tmp_path / "a.laz", Cloud(street(), columns))
    io.write_cloud(tmp_path / "b.laz", Cloud(street() + [9, 0, 0], columns))
    for _ in range(2):
        words = [str(tmp_path / "a.laz"), str(tmp_path / "b.laz"), "--out", str(tmp_path / "m.nc")]
        assert run(["map", *words]) == 0
        said = " ".join(capsys.readouterr().out.split())
        assert said.count("Dropped 300 of 6000 points") == 2
        assert said.count("later returns of their pulses") == 2


def test_a_map_with_missing_tiles_says_so(campaign, monkeypatch):
    monkeypatch.setattr(maps.campaign, "ENOUGH", 1)
    paths, folder = campaign
    run = maps.map_campaign(paths, folder / "run", tile=2)
    whole_map = maps.open_map(run)
    next(run.rglob("tile_*.npy")).unlink()
    assert "1 of 45 tiles are missing." in maps.open_map(run).attrs["remarks"]
    maps.map_campaign(paths, run, tile=2)
    equal(maps.open_map(run), whole_map)
    for tile in run.rglob("tile_*.npy"):
        tile.unlink()
    with pytest.raises(FileNotFoundError, match="no tile"):
        maps.open_map(run)


def test_summary_has_the_quantiles_of_the_cells():
    dataset = maps.map_cloud(street())
    table = maps.summarise(dataset).set_index("figure")
    known = dataset["f"].values[np.isfinite(dataset["f"].values)]
    assert table.loc["f", "q50"] == np.median(known)
    assert table.loc["f", "n"] == len(known)


def test_metrics_of_the_field_and_of_ones_own_stand_in_a_map(monkeypatch, tmp_path):
    points = street()
    found = maps.map_cloud(points, cell=1.0, metrics=["e95_of_3", "noise_of_a_mean", "e95"])
    row, column = 2, 3
    corner = np.array([found["x"][column], found["y"][row]]) - 0.5
    own = points[((points[:, :2] >= corner) & (points[:, :2] < corner + 1)).all(axis=1)]
    ring = np.column_stack([corner + [[0, 0], [1, 0], [1, 1], [0, 1]], np.full(4, 100.0)])
    chart = evaluate_cloud(own, polygon=ring)
    for name in ("e95_of_3", "noise_of_a_mean", "e95"):
        measured = float(found[name][row, column])
        assert measured == pytest.approx(METRICS[name](chart), rel=0.01), name
    assert found["e95_of_3"].attrs["units"] == "mm"
    assert "e95_of_3" in maps.summarise(found)["figure"].tolist()
    (tmp_path / "mine.py").write_text("def points(chart):\n    return chart.n\n")
    io.write_cloud(tmp_path / "a.laz", Cloud(points))
    words = ["map", "a.laz", "--out", "m.nc", "--metrics", "mesh_ratio,mine:points"]
    done = subprocess.run(
        [sys.executable, "-m", "mmqa_lab", *words], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    (tmp_path / "broken.py").write_text("def points(chart):\n    return chart.points\n")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match="Invalid metric broken:points: AttributeError"):
        metrics_of("broken:points")["points"](chart)
    again = maps.open_map(tmp_path / "m.run")
    known = again["n"].values >= maps.cells.MINIMUM
    assert (again["points"].values[known] == again["n"].values[known]).all()
    with pytest.raises(ValueError, match="files or parameters"):
        maps.map_campaign([tmp_path / "a.laz"], tmp_path / "m.run", metrics=["e99"])


def test_different_places_never_count_as_one_and_steps_are_found_as_in_a_chart():
    points = np.random.default_rng(7).random((200_000, 3)) * [40, 40, 4] - [20, 20, 0]
    points = np.round(points * 1024) / 1024
    counts = np.unique(points, axis=0, return_counts=True)[1]
    found = maps.map_cloud(points, cell=4.0)
    assert int(found["coincident"].sum()) == counts[counts > 1].sum()
    coarse = np.round(street(), 2)
    assert "steps of 10 mm" in maps.map_cloud(coarse).attrs["remarks"]


def test_heights_in_coarser_steps_than_the_plan_are_said_of_a_cloud_and_of_a_campaign(
    tmp_path, rng
):
    points = np.column_stack([10 * rng.random((3000, 2)), rng.normal(100, 0.002, 3000)])
    np.savetxt(tmp_path / "a.xyz", points, fmt=["%.3f", "%.3f", "%.2f"])
    words = "Coordinates are in steps of 10 mm: too coarse for sigma_MAD"
    whole = maps.map_cloud(io.read_cloud(tmp_path / "a.xyz"), cell=2.0)
    assert words in whole.attrs["remarks"]
    maps.map_campaign([tmp_path / "a.xyz"], tmp_path / "map", cell=2.0)
    assert words in maps.open_map(tmp_path / "map").attrs["remarks"]


def test_distances_from_the_planes_of_groups_and_equal_places_are_those_of_a_loop(rng):
    counts = np.array([4, 30, 9])
    starts, group = np.array([0, 4, 34]), np.repeat(np.arange(3), counts)
    xyz = rng.normal(size=(3, 43)) * [[1], [1], [0.1]] + [[7], [8], [9]]
    found = cells._deviations(xyz, starts, counts, group)
    for k in range(3):
        expected = fit_plane(xyz[:, group == k].T).residuals
        assert np.abs(found[group == k]) == pytest.approx(np.abs(expected), abs=1e-9)
    places = rng.integers(0, 4, (3, 200)).astype(float) / 1024
    places[:, 0], places[:, 1] = (0.0, 5.0, 5.0), (-0.0, 5.0, 5.0)
    same = (places[:, :, None] == places[:, None]).all(axis=0).sum(axis=0) > 1
    assert np.array_equal(cells._coincident(places) > 0, same)
