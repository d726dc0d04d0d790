"""``mmqa map`` as its users meet it."""

import json

import numpy as np
import pandas as pd
import pytest

from mmqa_lab import samples
from mmqa_lab.__main__ import main
from mmqa_lab.cloud import Cloud

PATCH = str(samples.path("road_patch"))
QUICK = ["--workers", "1", "--radius", "0.2", "--cell", "0.25"]


def test_a_map_comes_with_summary_figure_and_report(tmp_path, capsys):
    import xarray as xr

    out = tmp_path / "patch.nc"
    assert (
        main(["map", PATCH, "--out", str(out), "--below", "f=2,density=1000", "--json", *QUICK])
        == 0
    )
    rows = json.loads(capsys.readouterr().out)
    level = {row["variable"]: row for row in rows if row["layer"] == "level"}
    assert level["density"]["share_below"] < 0.5
    assert (level["f"]["threshold"], level["f"]["share_below"]) == (2, 0)  # crossing scan heads
    assert level["d1"]["threshold"] is None
    assert len(pd.read_csv(tmp_path / "patch.csv")) == len(rows)
    with xr.open_dataset(out) as dataset:
        assert dataset["n"].sum() == 28_185
        assert dataset["d1"].attrs["units"] == "mm"
        assert dataset.attrs["cell_m"] == 0.25
    page = (tmp_path / "patch.html").read_text(encoding="utf-8")
    for word in (
        "NCHRP",
        "2024 rev. A",
        "28185 points",
        "All files and all tiles",
        "data:image/png",
    ):
        assert word in page
    assert (tmp_path / "patch.png").read_bytes().startswith(b"\x89PNG")


def test_a_map_says_where_f_does_not_matter(tmp_path, capsys):
    import xarray as xr

    from mmqa_lab.spacing import exempt

    out = tmp_path / "patch.nc"
    assert main(["map", PATCH, "--out", str(out), "--rho0", "1800", "--json", *QUICK]) == 0
    rows = json.loads(capsys.readouterr().out)
    share = next(r["exempt_share"] for r in rows if (r["layer"], r["variable"]) == ("level", "f"))
    with xr.open_dataset(out) as dataset:
        level = dataset.sel(layer="level").load()
    known = np.isfinite(level["f"].values)
    expected = exempt(level["d1"] / 1000, level["d4"] / 1000, 1800)
    np.testing.assert_array_equal(level["exempt"].values[known], expected[known])
    weights = level["area"].values[known]
    assert share == pytest.approx(np.average(np.asarray(expected)[known], weights=weights))
    assert 0 < share < 1


def test_rho0_needs_spacing(tmp_path, capsys):
    given = ["map", PATCH, "--out", str(tmp_path / "m.nc"), "--metrics", "density"]
    assert main([*given, "--rho0", "3000"]) == 2
    assert "metric for --rho0" in capsys.readouterr().err


def test_gaps_and_coarse_coordinates_are_said(rng):
    from mmqa_lab import maps

    points = rng.random((6000, 3)) * [4, 4, 0.01]
    gap = (np.abs(points[:, :2] - 2) < 1.1).all(axis=1)  # 4 x 4 cells of half a metre
    whole, holed = (maps.map_cloud(p, metrics=("spacing",)) for p in (points, points[~gap]))
    assert (maps.summarise(whole)["remarks"] == "").all()
    said = maps.summarise(holed)["remarks"]
    assert said.str.startswith("16 cells (4 m2) without points lie between others").all()
    coarse = maps.map_cloud(Cloud(points, resolution=0.02), metrics=("spacing",))
    table = maps.summarise(coarse).set_index("variable")
    assert "steps of 20 mm" in table["remarks"]["d1"]
    assert table["remarks"]["incomplete_share"] == ""


def test_geotiff_and_zarr_hold_the_same_numbers_at_the_same_places(tmp_path):
    import rasterio
    import xarray as xr

    from mmqa_lab import maps

    choices = {"cell": 0.25, "metrics": ("density", "spacing"), "workers": 1}
    maps.map_campaign([PATCH], tmp_path / "run", tile=2, **choices)
    for ending in ("tif", "zarr", "nc"):
        dataset = maps.open_map(tmp_path / "run", crs="EPSG:2056")
        maps.write_map(dataset, tmp_path / f"m.{ending}")
    with xr.open_zarr(tmp_path / "m.zarr") as zarr, xr.open_dataset(tmp_path / "m.nc") as netcdf:
        np.testing.assert_array_equal(zarr["d4"].values, netcdf["d4"].values)
        expected = netcdf["d4"].sel(layer="level").load()
    with rasterio.open(tmp_path / "m.tif") as tif:
        assert tif.crs.to_epsg() == 2056
        band = tif.descriptions.index("level d4") + 1
        rows, columns = 3, 4
        x, y = tif.xy(rows, columns)
        obtained = tif.read(band)
        assert obtained[rows, columns] == expected.sel(x=x, y=y, method="nearest")
        np.testing.assert_array_equal(obtained, expected.values[::-1])


def test_a_damaged_file_gives_status_1_and_its_name(tmp_path, capsys):
    whole = samples.path("road_patch").read_bytes()
    (tmp_path / "cut.laz").write_bytes(whole[: len(whole) // 2])
    out = tmp_path / "map.nc"
    arguments = ["map", PATCH, str(tmp_path / "cut.laz"), "--out", str(out), *QUICK]
    assert main(arguments) == 1
    printed = capsys.readouterr()
    assert "cut.laz" in printed.err
    assert "density" in printed.out
    assert out.is_file()
    page = (tmp_path / "map.html").read_text(encoding="utf-8")
    assert "Missing from the map" in page
    assert "cut.laz" in page
