"""Campaigns: any tiles, workers and interruptions give the same map, and nothing is lost silently.

The reference is one call of evaluate_tile over all points.
"""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import warnings

import laspy
import numpy as np
import pytest

from mmqa_lab import maps, samples
from mmqa_lab.cloud import Cloud
from mmqa_lab.io import read_cloud, write_cloud
from mmqa_lab.maps import campaign
from mmqa_lab.maps.campaign import _started, corner, fitting_tile, read_source
from mmqa_lab.maps.tile import evaluate_tile

CELL = 0.5
CORNER = np.array([600_000.0, 5_200_000.0, 100.0])


def write_street(folder, *, parts=4, n=6000):
    """A road and a wall along +y in files of 8 m; returns their paths."""
    paths = []
    for k in range(parts):
        rng = np.random.default_rng(k)
        y = np.sort(rng.uniform(8 * k, 8 * k + 8, n))
        road = np.stack([rng.uniform(0, 8, n), y, rng.normal(0.2, 0.004, n)], axis=1)
        wall = np.stack([rng.normal(8.2, 0.004, n), y, rng.uniform(0, 5, n)], axis=1)
        path = folder / f"part_{k}.laz"
        write_cloud(
            path, Cloud(np.concatenate([road, wall]) + CORNER, {"gps_time": np.arange(2.0 * n)})
        )
        paths.append(path)
    return paths


def chart_map(paths):
    """The map by one call over all points, in the cells that a campaign shows."""
    first = corner(read_low(paths), CELL)
    points = np.concatenate([read_cloud(path, columns=()).points for path in paths])
    points = points - np.array(first) * CELL
    low = np.floor(points[:, :2].min(axis=0) / CELL).astype(int)
    wide = np.floor(points[:, :2].max(axis=0) / CELL).astype(int) + 1 - low
    return evaluate_tile(points, (*low.tolist(), *wide.tolist()), cell=CELL)


def read_low(paths):
    """The least coordinates in the headers."""
    return np.min([read_source(path).low for path in paths], axis=0)


def assert_same(dataset, expected):
    """Equal to the last bit."""
    for name, values in expected.items():
        np.testing.assert_array_equal(dataset[name].values, values, err_msg=name)


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    """The files of a street and its map."""
    folder = tmp_path_factory.mktemp("street")
    paths = write_street(folder)
    return folder, paths, chart_map(paths)


@pytest.mark.parametrize("tile", [None, 2.0, 7.5])
def test_tiles_of_any_size_give_the_map_of_one_call(street, tmp_path, tile):
    folder, _, expected = street
    outcome = maps.map_campaign([folder], tmp_path / "run", cell=CELL, tile=tile, workers=1)
    assert outcome.problems == ()
    assert outcome.computed == outcome.tiles
    assert outcome.points == expected["n"].sum() == 48_000
    dataset = maps.open_map(tmp_path / "run")
    assert_same(dataset, expected)
    assert dataset["x"].values[0] % CELL == CELL / 2
    assert not list((tmp_path / "run").rglob("*.xyz"))  # room is given back


def test_order_of_files_and_a_file_given_twice_change_nothing(street, tmp_path):
    folder, paths, expected = street
    mixed = [paths[2], folder, paths[0], paths[2]]
    maps.map_campaign(mixed, tmp_path / "run", cell=CELL, workers=1)
    assert_same(maps.open_map(tmp_path / "run"), expected)


def test_a_map_that_would_fill_the_memory_is_lazy_and_the_same(street, tmp_path, monkeypatch):
    folder, _, expected = street
    maps.map_campaign([folder], tmp_path / "run", cell=CELL, tile=4.0, workers=1)
    assert maps.open_map(tmp_path / "run")["n"].chunks is None
    monkeypatch.setattr(maps, "IN_MEMORY", 0)
    lazy = maps.open_map(tmp_path / "run")
    assert lazy["n"].chunks is not None
    assert_same(lazy, expected)
    maps.write_map(lazy, tmp_path / "map.nc")
    assert (tmp_path / "map.nc").is_file()


def test_coordinates_far_away_give_the_same_figures(tmp_path):
    """Moved by 10 000 km, coordinates carry 2e-9 m of rounding: figures agree to 1e-4 mm."""
    rng = np.random.default_rng(7)
    points = np.stack([*rng.uniform(0, 4, (2, 8000)), rng.normal(0.2, 0.005, 8000)], axis=1)
    found = []
    for k, move in enumerate((0, 1e7)):
        path = tmp_path / f"{k}.las"
        write_cloud(path, Cloud(points + [move, move, 0]))
        maps.map_campaign([path], tmp_path / f"{k}.run", cell=CELL, workers=1)
        found.append(maps.open_map(tmp_path / f"{k}.run"))
    np.testing.assert_array_equal(found[0]["n"].values, found[1]["n"].values)
    for name in ("d1", "d4", "sigma_mad"):
        np.testing.assert_allclose(found[0][name].values, found[1][name].values, atol=1e-4)


def test_copc_is_the_same_cloud_in_laz(tmp_path):
    copc = samples.path("chart_b_5m")
    write_cloud(tmp_path / "plain.laz", read_cloud(copc), scale=0.0001)
    choices = {"cell": 0.25, "workers": 1, "radius": 0.25}
    maps.map_campaign([copc], tmp_path / "a.run", tile=0.5, **choices)
    maps.map_campaign([tmp_path / "plain.laz"], tmp_path / "b.run", **choices)
    a, b = maps.open_map(tmp_path / "a.run"), maps.open_map(tmp_path / "b.run")
    assert a["n"].sum() == len(read_cloud(copc))
    a = a.sel(x=b["x"], y=b["y"])
    np.testing.assert_array_equal(a["n"].values, b["n"].values)
    # The headers have other offsets, so coordinates differ in the last bits.
    np.testing.assert_allclose(a["d4"].values, b["d4"].values, atol=1e-3)


def test_a_cloud_in_memory_has_the_map_of_its_file(street, tmp_path):
    _, paths, _ = street
    maps.map_campaign([paths[0]], tmp_path / "run", cell=CELL, tile=4.0, workers=1)
    campaign = maps.open_map(tmp_path / "run").load()
    found = maps.map_cloud(read_cloud(paths[0]), cell=CELL)
    for name in campaign:
        np.testing.assert_array_equal(found[name].values, campaign[name].values, err_msg=name)
    np.testing.assert_array_equal(found["x"], campaign["x"])


def damaged(tmp_path):
    """A street whose second file is cut short; its whole bytes."""
    paths = write_street(tmp_path / "clouds", n=2000)
    whole = paths[1].read_bytes()
    paths[1].write_bytes(whole[: len(whole) // 2])
    return paths, whole


def test_a_damaged_file_is_named_the_others_are_mapped_and_it_can_follow(tmp_path):
    (tmp_path / "clouds").mkdir()
    paths, whole = damaged(tmp_path)
    (tmp_path / "clouds" / "empty.las").write_bytes(b"")
    run = {"cell": CELL, "tile": 4.0, "workers": 1}
    first = maps.map_campaign([tmp_path / "clouds"], tmp_path / "run", **run)
    assert len(first.problems) == 2
    assert "part_1.laz" in first.problems[1]
    assert "empty.las" in first.problems[0]
    assert first.points == 12_000
    assert maps.open_map(tmp_path / "run")["n"].sum() == 12_000

    (tmp_path / "clouds" / "empty.las").unlink()
    paths[1].write_bytes(whole)
    again = maps.map_campaign([tmp_path / "clouds"], tmp_path / "run", **run)
    assert again.problems == ()
    assert 0 < again.computed < again.tiles  # those about the file alone
    assert_same(maps.open_map(tmp_path / "run"), chart_map(paths))


def test_a_damaged_copc_file_is_named_and_the_others_are_mapped(tmp_path):
    copc = samples.path("chart_b_5m")
    (tmp_path / "clouds").mkdir()
    content = bytearray(copc.read_bytes())
    half = len(content) // 2
    content[half : half + 2000] = bytes(2000)
    (tmp_path / "clouds" / "bad.copc.laz").write_bytes(bytes(content))
    (tmp_path / "clouds" / "good.laz").write_bytes((samples.path("chart_a_5m")).read_bytes())
    choices = {"cell": 0.25, "workers": 1, "radius": 0.25}
    found = maps.map_campaign([tmp_path / "clouds"], tmp_path / "a.run", **choices)
    assert [("bad.copc.laz" in problem) for problem in found.problems] == [True]
    maps.map_campaign([samples.path("chart_a_5m")], tmp_path / "b.run", **choices)
    assert_same(*(maps.open_map(tmp_path / f"{name}.run") for name in "ab"))


def test_the_same_tile_twice_counts_once_and_an_empty_one_is_said(street, tmp_path):
    _, paths, expected = street
    (tmp_path / "clouds").mkdir()
    for path in paths:
        (tmp_path / "clouds" / path.name).write_bytes(path.read_bytes())
    write_cloud(tmp_path / "clouds" / "again.las", read_cloud(paths[1]))
    laspy.LasData(laspy.LasHeader(point_format=6, version="1.4")).write(
        str(tmp_path / "clouds" / "empty.laz")
    )
    outcome = maps.map_campaign([tmp_path / "clouds"], tmp_path / "run", cell=CELL, workers=1)
    assert outcome.problems == ()
    assert ["part_1.laz has the points of" in remark for remark in outcome.remarks] == [False, True]
    assert outcome.remarks[0].endswith("empty.laz has no points.")
    assert maps.open_map(tmp_path / "run")["n"].sum() == expected["n"].sum()


def test_points_outside_of_the_header_are_damage(tmp_path):
    path = tmp_path / "wild.las"
    write_cloud(path, Cloud(np.random.default_rng(1).random((100, 3)) * 10))
    content = bytearray(path.read_bytes())
    content[-30:-26] = (2**30).to_bytes(4, "little")  # easting of the last point
    path.write_bytes(bytes(content))
    with pytest.raises(ValueError, match=r"wild\.las: 1 points outside of the box in its header"):
        maps.map_campaign([path], tmp_path / "run", cell=CELL, workers=1)


def test_a_finished_run_computes_nothing_again(street, tmp_path):
    folder, _, expected = street
    run = {"cell": CELL, "tile": 8.0, "workers": 1}
    maps.map_campaign([folder], tmp_path / "run", **run)
    again = maps.map_campaign([folder], tmp_path / "run", **run)
    assert again.computed == 0
    with pytest.raises(ValueError, match=r"its cell is 0\.5, not 1\.0\. Must be removed"):
        maps.map_campaign([folder], tmp_path / "run", **(run | {"cell": 1.0}))
    with pytest.raises(ValueError, match="its tile is 16, not 8"):
        maps.map_campaign([folder], tmp_path / "run", **(run | {"tile": 4.0}))
    assert_same(maps.open_map(tmp_path / "run"), expected)


def tiles_of(folder):
    """The tiles written so far."""
    return list((folder / "tiles").glob("[!.]*.npz"))


def wait_for(condition, *, seconds=120):
    """Wait until a condition holds."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited too long"
        time.sleep(0.01)


def test_a_run_killed_in_the_middle_goes_on_where_it_was(street, tmp_path):
    folder, _, expected = street
    run = tmp_path / "map.run"
    command = [sys.executable, "-m", "mmqa_lab", "map", str(folder), "--out", f"{tmp_path}/map.nc"]
    child = subprocess.Popen([*command, "--tile", "2", "--workers", "1"], stderr=subprocess.DEVNULL)
    wait_for(lambda: len(tiles_of(run)) >= 5)
    child.send_signal(signal.SIGKILL)
    child.wait()
    kept = tiles_of(run)
    for tile in kept:
        with np.load(tile) as found:
            assert found["n"].shape == (3, 4, 4)  # whole
    outcome = maps.map_campaign([folder], run, cell=CELL, tile=2.0, workers=1)
    assert outcome.computed == outcome.tiles - len(kept) > 0
    assert not list(run.rglob(".*"))
    assert_same(maps.open_map(run), expected)


@pytest.fixture
def cluster(tmp_path):
    """A Dask scheduler and two workers, each a process of its own; address and workers."""
    note = tmp_path / "scheduler.json"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    dask = [sys.executable, "-m", "dask"]
    ours = ["--host", "127.0.0.1", "--no-dashboard"]
    environment = os.environ | {"NUMBA_NUM_THREADS": "1"}
    scheduler = subprocess.Popen(
        [*dask, "scheduler", *ours, "--port", "0", "--scheduler-file", str(note)], **quiet
    )
    workers = []
    try:
        wait_for(lambda: note.is_file() and note.read_text().endswith("}"))
        address = json.loads(note.read_text())["address"]
        one = [*dask, "worker", address, "--no-nanny", "--nthreads", "1", *ours]
        one += ["--local-directory", str(tmp_path / "scratch")]
        workers += [subprocess.Popen(one, env=environment, **quiet) for _ in range(2)]
        yield address, workers
    finally:
        for process in [*workers, scheduler]:
            process.kill()
            process.wait()


def test_a_cluster_that_loses_a_worker_completes_the_same_map(street, tmp_path, cluster):
    from distributed import Client

    folder, _, expected = street
    address, workers = cluster
    with Client(address) as client:
        client.wait_for_workers(2, timeout=120)
    run, outcomes = tmp_path / "run", []
    arguments = {"cell": CELL, "tile": 1.0, "scheduler": address}
    thread = threading.Thread(
        target=lambda: outcomes.append(maps.map_campaign([folder], run, **arguments))
    )
    thread.start()
    wait_for(lambda: len(tiles_of(run)) >= 5)
    os.kill(workers[0].pid, signal.SIGKILL)
    done = len(tiles_of(run))
    thread.join(timeout=1200)
    (outcome,) = outcomes
    assert done < outcome.tiles  # there was work left
    assert workers[0].wait() == -signal.SIGKILL
    assert outcome.problems == ()
    assert outcome.computed == outcome.tiles
    assert_same(maps.open_map(run), expected)


def test_no_scheduler_is_one_sentence(street, tmp_path, monkeypatch):
    import dask
    import distributed  # noqa: F401 - its settings would be lost with the one below

    folder, *_ = street
    monkeypatch.setattr(campaign, "ANSWERS_S", 2)
    with (
        dask.config.set({"distributed.comm.timeouts.connect": "1s"}),
        pytest.raises(OSError, match=r"Invalid scheduler tcp://127\.0\.0\.1:1\. Must be a run"),
    ):
        maps.map_campaign([folder], tmp_path / "run", cell=1, scheduler="tcp://127.0.0.1:1")


def test_tiles_get_smaller_until_they_hold_a_comfortable_number():
    boxes = np.array([[0, 0, 128, 128.0], [0, 0, 16, 16]])
    assert fitting_tile(boxes, np.array([1000, 1000]), cell=0.5) == 256
    assert fitting_tile(boxes, np.array([1000, 6_000_000]), cell=0.5) == 16
    assert fitting_tile(boxes, np.array([1000, 10**12]), cell=0.5) == 8


def test_quantiles_and_shares_count_by_area():
    """Against the weighted quantile by its definition."""
    import xarray as xr

    rng = np.random.default_rng(3)
    values, area = rng.random(400), rng.random(400)
    values[:50] = np.nan
    cells = {"area": ("x", area), "n": ("x", np.ones(400, int)), "f": ("x", values, {"units": "1"})}
    table = maps.summarise(xr.Dataset(cells).expand_dims(layer=["level"]), below={"f": 0.3})
    known = np.isfinite(values)
    order = np.argsort(values[known])
    cumulated = np.cumsum(area[known][order]) / area[known].sum()
    for q in (5, 25, 50, 75, 95):
        expected = values[known][order][np.searchsorted(cumulated, q / 100)]
        assert table[f"q{q:02d}"][0] == expected
    assert table["n"][0] == 350
    assert table["share_below"][0] == pytest.approx(
        area[known][values[known] < 0.3].sum() / area[known].sum()
    )
    with pytest.raises(ValueError, match="Invalid figure with a threshold 'g'"):
        maps.summarise(xr.Dataset(cells).expand_dims(layer=["level"]), below={"g": 1})


def test_two_maps_at_the_same_time_do_not_disturb_each_other():
    """Dask's usual port for its pages may be taken; that is no news to a user."""
    with socket.socket() as other, warnings.catch_warnings():
        with contextlib.suppress(OSError):  # taken already
            other.bind(("", 8787))
            other.listen()
        warnings.filterwarnings("error", message="Port 8787")
        with _started(2, None) as run:
            assert sorted(result for _, result in run(abs, [(-1,), (2,)])) == [1, 2]
