"""mmqa radiometry on files with several bands: figures with intervals, sentences for bad input."""

import json
import warnings

import cv2
import numpy as np
import pandas as pd
import pytest
import rasterio

from mmqa_lab.__main__ import main
from mmqa_lab.simulate.targets import PointSpread, expose, render_bars, render_edge, render_star

GAINS = (20.0, 28.0, 35.0)
RADIANCE = np.array([5.0, 20, 45, 70, 90])
REFLECTANCE = np.array([0.04, 0.15, 0.25, 0.35, 0.5])


def write(path, bands, **tags):
    """Write a TIFF of 16 bits with several bands."""
    bands = np.clip(np.round(bands), 0, 65_535).astype(np.uint16)
    shape = {"count": len(bands), "height": bands.shape[1], "width": bands.shape[2]}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        with rasterio.open(path, "w", driver="GTiff", dtype="uint16", **shape) as file:
            file.write(bands)
            file.update_tags(ns="EXIF", **tags)


def wedge(exposure=1.0, seed=0):
    """Three bands of five targets side by side, 30 pixels each."""
    light = np.repeat(np.repeat(RADIANCE[None], 40, axis=0), 30, axis=1) * exposure
    seen = [
        expose(light, gain=gain, offset=60.0, bits=12, seed=[seed, k])
        for k, gain in enumerate(GAINS)
    ]
    return np.stack(seen)


def regions(**columns):
    """The table of those targets."""
    table = {"name": list("abcde"), "x_px": 30 * np.arange(5) + 3, "y_px": 5}
    return pd.DataFrame(table | {"width_px": 24, "height_px": 30} | columns)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Images of all kinds of targets, and the tables that say where they are."""
    folder, rng = tmp_path_factory.mktemp("bands"), np.random.default_rng(1)

    def bands(image):
        noisy = image + 0.005 * rng.standard_normal((2, *image.shape))
        return 1000 + 40_000 * noisy

    write(folder / "edge.tif", bands(render_edge((100, 64), PointSpread(0.7), angle_deg=6.0)))
    star = render_star((160, 160), PointSpread(0.6), cycles=36, radius_px=70)
    write(folder / "star.tif", bands(star))
    centre = {"x_px": 79.5, "y_px": 79.5, "radius_px": 70.0, "cycles": 36}
    pd.DataFrame([centre]).to_csv(folder / "star.csv", index=False)
    groups = [render_bars((64, 64), PointSpread(0.5), period_px=p) for p in (8.0, 1.9)]
    write(folder / "bars.tif", bands(np.hstack(groups)))
    rows = [{"x_px": 31.5 + 64 * k, "period_px": p} for k, p in enumerate((8.0, 1.9))]
    table = pd.DataFrame(rows).assign(y_px=31.5, bars=4, angle_deg=0.0)
    table.to_csv(folder / "bars.csv", index=False)
    write(folder / "a.tif", wedge(), EXIF_ExposureTime="(0.005)", EXIF_FNumber="(8)")
    more = {"EXIF_ExposureTime": "(0.0025)", "EXIF_FNumber": "(8)"}
    write(folder / "b.tif", wedge(0.5, seed=1), **more)
    write(folder / "plain.tif", wedge())
    write(folder / "flat.tif", np.full((1, 40, 40), 500.0))
    write(folder / "full.tif", np.full((3, 40, 150), 4095.0))
    cv2.imwrite(str(folder / "eight.png"), np.full((40, 150), 9, np.uint8))
    regions(radiance=RADIANCE).to_csv(folder / "radiance.csv", index=False)
    known = np.where([True, False, True, False, True], REFLECTANCE, np.nan)
    regions(reflectance=known).to_csv(folder / "tarps.csv", index=False)
    regions(reflectance=np.where(known > 0.4, known, np.nan)).to_csv(
        folder / "one_known.csv", index=False
    )
    regions(x_px=900, reflectance=0.1).to_csv(folder / "far_known.csv", index=False)
    regions(x_px=900).to_csv(folder / "far.csv", index=False)
    regions(reflectance=0.1, image="other.tif").to_csv(folder / "other.csv", index=False)
    return folder


@pytest.fixture
def rows(folder, monkeypatch, capsys):
    """What a call prints as JSON."""
    monkeypatch.chdir(folder)

    def call(line):
        assert main(["radiometry", *line.split(), "--json"]) == 0
        return pd.DataFrame(json.loads(capsys.readouterr().out))

    return call


def test_edge_in_every_band_in_all_units(rows):
    found = rows("edge edge.tif --gsd-cm 5 --pixel-um 12")
    truth = PointSpread(0.7).mtf50(6.0)
    assert found["band"].tolist() == ["1", "2"]
    assert found["mtf50_per_px"].to_numpy() == pytest.approx(truth, rel=0.01)
    inside = (found["mtf50_low_per_px"] < truth) & (truth < found["mtf50_high_per_px"])
    assert inside.any()
    assert found["mtf50_lines_per_mm"][0] == pytest.approx(2 * found["mtf50_per_px"][0] / 0.012)
    assert found["fwhm_cm"][0] == pytest.approx(5 * found["fwhm_px"][0])


def test_the_star_of_the_report_is_measured(rows):
    found = rows("star star.tif --targets star.csv")
    assert len(found) == 2
    truth = PointSpread(0.6).mtf50(0.0)
    assert found["mtf50_per_px"].to_numpy() == pytest.approx(truth, rel=0.02)
    assert (found["mtf50_low_per_px"] < found["mtf50_high_per_px"]).all()


def test_bars_are_resolved_or_not(rows):
    found = rows("bars bars.tif --targets bars.csv")
    groups = found.dropna(subset=["period_px"])
    assert groups["resolved"].tolist() == [True, False] * 2
    assert groups["remark"].tolist() == ["", "too few pixels"] * 2
    assert found["resolving_high_px"].dropna().tolist() == [8.0, 8.0]
    assert found["resolving_low_px"].dropna().tolist() == [1.9, 1.9]


def test_sensor_of_every_band_and_setting(rows):
    found = rows("calibrate a.tif b.tif --targets radiance.csv")
    assert found["setting"].tolist() == ["0.005 s, f/8", "0.0025 s, f/8", "all"] * 3
    together = found[found["setting"] == "all"]
    assert together["gain"].to_numpy() == pytest.approx(GAINS, rel=0.005)
    assert (together["gain_low"] < GAINS).all()
    assert (together["gain_high"] > GAINS).all()
    assert found["stability_percent"].max() < 1


def test_reflectance_of_targets_that_are_not_known(rows):
    found = rows("reflect a.tif b.tif --targets tarps.csv")
    assert len(found) == 2 * 3 * 2
    # radiance is not proportional to reflectance here: the line through three references
    line = np.polyfit(RADIANCE[::2], REFLECTANCE[::2], 1)
    expected = np.polyval(line, RADIANCE[[1, 3]])
    means = found.groupby("target")["reflectance"].mean().to_numpy()
    assert means == pytest.approx(expected, abs=0.003)
    assert (found["reflectance_low"] < found["reflectance_high"]).all()


def test_bars_and_edges_depend_on_the_distance_from_the_centre(rows, folder):
    rng, image, targets = np.random.default_rng(3), np.zeros((420, 420)), []
    for row, column in [(r, c) for r in (0, 180, 360) for c in (0, 180, 360)]:
        far = np.hypot(row - 180, column - 180) / np.hypot(210, 210)
        turn = 6.0 if (row + column) % 360 else 96.0
        part = render_edge((60, 60), PointSpread(0.6 + 0.6 * far), angle_deg=turn)
        image[row : row + 60, column : column + 60] = part
        targets.append({"x_px": column, "y_px": row, "width_px": 60, "height_px": 60})
    noisy = image + 0.002 * rng.standard_normal(image.shape)
    write(folder / "over.tif", 1000 + 40_000 * noisy[None])
    pd.DataFrame(targets).to_csv(folder / "over.csv", index=False)
    found = rows("edge over.tif --targets over.csv --over-image").set_index("term")
    row = found.loc["fwhm_px: corner over centre"]
    truth = PointSpread(1.2).fwhm(6) / PointSpread(0.6).fwhm(6)
    assert row["low"] < truth < row["high"]
    assert found.loc["squared fwhm_px: centre", "n"] == 9


def test_calibration_against_an_image_and_on_even_ground(rows, folder):
    rng = np.random.default_rng(4)
    radiance = 20 + 60 * rng.random((12, 12))
    write(folder / "known.tif", 100 * radiance[None])
    fine = np.kron(radiance, np.ones((8, 8)))
    write(folder / "fine.tif", 30 * fine[None] + rng.normal(0, 3, (1, *fine.shape)))
    found = rows("calibrate fine.tif --radiance known.tif --through-zero").iloc[0]
    assert found["gain"] == pytest.approx(0.30, rel=0.002)
    assert (found["offset_dn"], found["n"]) == (0, 144)
    write(folder / "even.tif", 2000 + rng.normal(0, 10, (3, 40, 60)))
    even = rows("calibrate even.tif even.tif --even")
    assert (even["radial_low"] < 0).all()
    assert (even["radial_high"] > 0).all()


def test_one_target_and_the_darkest_pixels_make_a_line(rows, folder):
    known = np.where([False] * 4 + [True], REFLECTANCE, np.nan)
    regions(reflectance=known).to_csv(folder / "one.csv", index=False)
    found = rows("reflect a.tif --targets one.csv --dark-pixel")
    line = np.polyfit(RADIANCE[[0, 4]], [0.01, 0.5], 1)
    means = found.groupby("target")["reflectance"].mean().to_numpy()
    assert means == pytest.approx(np.polyval(line, RADIANCE[:4]), abs=0.02)


def test_repeatability_over_images(rows):
    found = rows("reflect a.tif b.tif --targets tarps.csv --repeatability")
    assert len(found) == 3 * 2
    assert (found["images"] == 2).all()
    assert (found["within_low_percent"] < found["within_percent"]).all()
    assert found["within_percent"].max() < 3


FAULTS = {
    "sharpness none.tif": "no such file",
    "sharpness star.csv": "Must be JPEG, PNG or TIFF",
    "star star.tif": "Must have --targets",
    "star star.tif --targets none.csv": "no such file",
    "star star.tif --targets bars.csv": "no column 'radius_px'",
    "star a.tif --targets star.csv": "Invalid star",
    "edge a.tif --targets far.csv": "Must lie within 150 x 40 pixels",
    "edge flat.tif": "Invalid image: no edge",
    "calibrate a.tif edge.tif --targets radiance.csv": "2 bands. Must have 3",
    "calibrate a.tif plain.tif --targets radiance.csv": "no exposure time and f-number",
    "calibrate a.tif --targets tarps.csv": "no column 'radiance'",
    "calibrate full.tif --targets radiance.csv": "0 unsaturated of",
    "reflect eight.png --targets tarps.csv": "8 bits, usually not linear in light",
    "reflect a.tif --targets radiance.csv": "no column 'reflectance'",
    "reflect full.tif --targets tarps.csv": "0 unsaturated with a known reflectance",
    "reflect a.tif --targets other.csv": "none of a.tif",
    "edge edge.tif --gsd-cm -1": "Invalid gsd-cm -1",
    "edge edge.tif --over-image": "Must be four or more",
    "edge edge.tif --even": "Invalid --even for edge. Must be with calibrate.",
    "sharpness a.tif --over-image": "Invalid --over-image for sharpness",
    "calibrate full.tif --even": "100% saturated",
    "calibrate a.tif edge.tif --even": "2 bands. Must have 3",
    "calibrate a.tif --radiance edge.tif": "2 bands. Must have 3",
    "calibrate a.tif --radiance none.tif": "no such file",
    "reflect a.tif --targets one_known.csv": "1 unsaturated with a known reflectance",
    "reflect a.tif --targets far.csv": "no column 'reflectance'",
    "reflect a.tif --targets far_known.csv": "Invalid patch",
    "reflect a.tif --targets tarps.csv --repeatability": "one shows 'b'. Must be two or more",
}


@pytest.mark.parametrize("line", FAULTS)
def test_bad_input_gets_a_sentence(folder, monkeypatch, capsys, line):
    monkeypatch.chdir(folder)
    assert main(["radiometry", *line.split(), "--csv", "rows.csv"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert FAULTS[line] in err.splitlines()[-1]
    assert not (folder / "rows.csv").exists()
