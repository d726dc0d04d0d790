"""What is delivered of each pole: attributes, tiles, files, the page and its decisions."""

import base64
import json
import re
import sqlite3
from contextlib import closing

import cv2
import numpy as np
import pandas as pd
import pytest
import shapely

from mmqa_lab import poles
from mmqa_lab.__main__ import main
from mmqa_lab.cloud import Cloud
from mmqa_lab.io import write_cloud
from mmqa_lab.poles import common, delivery, ours


def shaft(foot, height, *, diameter=0.2, lean=(0.0, 0.0), taper=0.0, step=0.02):
    """Rings of points on a leaning, tapering shaft."""
    rise, turn = np.meshgrid(np.arange(0.02, height, step), np.linspace(0, 2 * np.pi, 60)[:-1])
    rise, turn = rise.ravel(), turn.ravel()
    radius = diameter / 2 - taper * rise / 2
    ring = np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1)
    return np.column_stack([ring + foot + rise[:, None] * np.array(lean), rise])


def floor(low, high, step=0.2):
    """Level ground."""
    x, y = np.mgrid[low[0] : high[0] : step, low[1] : high[1] : step].reshape(2, -1)
    return np.stack([x, y, 0 * x], axis=1)


@pytest.fixture(scope="module")
def leaning():
    """A pole that leans 0.05 m/m towards azimuth 120 degrees, with a lantern, and its table."""
    lean = 0.05 * np.array([np.sin(np.radians(120)), np.cos(np.radians(120))])
    top = np.array([3.0, 4.0]) + 6 * lean
    lantern = np.array([*top, 6.25]) + np.random.default_rng(1).uniform(-0.2, 0.2, (400, 3))
    made = shaft((3.0, 4.0), 6.0, lean=lean, taper=0.01)
    cloud = Cloud(np.vstack([floor((-4, -4), (11, 12)), made, lantern]), crs="EPSG:25832")
    return cloud, poles.detect(cloud)


def test_each_pole_has_what_a_user_asks(leaning):
    _, found = leaning
    assert found["id"].tolist() == [1]
    one = found.iloc[0]
    assert one["tilt_deg"] == pytest.approx(np.degrees(np.arctan(0.05)), abs=0.3)
    assert one["lean_azimuth_deg"] == pytest.approx(120, abs=5)
    # the lantern ends at 6.45 m
    assert one["total_height_m"] == pytest.approx(6.45, abs=0.05)
    assert 4 < one["height_m"] <= 6.5
    # 0.2 m less 0.01 m/m; slices of 0.25 m lean by 12 mm
    assert one["diameter_13_m"] == pytest.approx(0.187, abs=0.014)
    assert one["diameter_13_low_m"] < one["diameter_13_m"] < one["diameter_13_high_m"]
    assert one["class"] == "lamp or utility pole"
    assert 0.2 < one["class_probability"] <= 1
    # 59 points a ring, 50 rings a metre
    assert one["points"] == pytest.approx(59 * 50 * one["height_m"], rel=0.1)


def test_diameter_at_breast_height_has_an_honest_interval():
    rng, inside = np.random.default_rng(3), []
    for _ in range(60):
        points, line, taper = [], [], rng.uniform(0, 0.02)
        for number, z in enumerate(np.arange(0.3, 4, 0.15)):
            width = 0.16 - taper * z
            x = np.arange(rng.uniform(0, 0.015), width, 0.015)
            points.append(np.column_stack([x, rng.normal(0, 0.004, len(x)), np.full(len(x), z)]))
            line += [number] * len(x)
        made = common.shaft_chords(np.concatenate(points), np.array([0, 0, 1.0]), np.array(line))
        _, low, high = ours._diameter_at(1.3, made)
        inside.append(low <= 0.16 - taper * 1.3 <= high)
        assert high - low < 0.03
    # 95 % are asked for: of 60, fewer than 52 happen once in a thousand times
    assert sum(inside) >= 52
    assert np.isnan(ours._diameter_at(9.0, made)).all()


def test_poles_do_not_depend_on_tiles():
    # posts on the borders of the tiles, on their corners and between
    # each at its own y: rounding would decide the order of those in a row
    feet = [(x, y + x / 100) for x in (0.0, 10.0, 20.0) for y in (0.0, 7.0, 20.0)]
    low, high = (-15, -15), (35, 35)
    posts = np.vstack([floor(low, high), *(shaft(foot, 3.0, step=0.05) for foot in feet)])
    whole, tiled = poles.detect(posts), poles.detect(posts, tile=20.0)
    assert len(whole) == len(feet)
    columns = whole.columns.drop(["class", "method", "class_probability", "lean_azimuth_deg"])
    # an upright post leans by rounding alone, and its direction with it
    assert np.allclose(whole[columns], tiled[columns], atol=1e-6, equal_nan=True)
    assert whole["class"].equals(tiled["class"])


def test_a_geopackage_has_points_and_a_coordinate_system(leaning, tmp_path):
    cloud, found = leaning
    poles.write_poles(tmp_path / "p.gpkg", found, crs=cloud.crs)
    with closing(sqlite3.connect(tmp_path / "p.gpkg")) as file:
        one = pd.read_sql("SELECT * FROM poles", file)
        layer = pd.read_sql("SELECT * FROM gpkg_contents", file).iloc[0]
        known = pd.read_sql("SELECT * FROM gpkg_spatial_ref_sys", file).set_index("srs_id")
        assert file.execute("PRAGMA application_id").fetchone() == (int.from_bytes(b"GPKG"),)
        assert file.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        assert not file.execute("PRAGMA foreign_key_check").fetchall()
    # OGC 12-128r18, clause 2.1.3: magic, version 0, little endian, system, then WKB
    blob = one["geom"][0]
    assert blob[:4] == b"GP\x00\x01"
    assert int.from_bytes(blob[4:8], "little") == layer["srs_id"] == 25832
    point = shapely.from_wkb(blob[8:])
    assert (point.x, point.y, point.z) == tuple(found.loc[0, ["x_m", "y_m", "z_base_m"]])
    assert (layer["min_x"], layer["max_y"]) == (point.x, point.y)
    assert set(known.index) == {-1, 0, 25832}
    assert "ETRS89 / UTM zone 32N" in known.loc[25832, "definition"]
    assert one["class"][0] == found["class"][0]
    assert one["id"].dtype.kind == "i"


def test_geojson_and_csv(leaning, tmp_path):
    cloud, found = leaning
    found = found.assign(diameter_m=np.nan)
    for name in ("p.geojson", "p.csv"):
        poles.write_poles(tmp_path / name, found, crs=cloud.crs)
    made = json.loads((tmp_path / "p.geojson").read_text())
    assert made["crs"]["properties"]["name"] == "urn:ogc:def:crs:EPSG::25832"
    place = shapely.geometry.shape(made["features"][0]["geometry"])
    assert place.x == pytest.approx(found["x_m"][0], abs=1e-4)
    assert made["features"][0]["properties"]["diameter_m"] is None
    assert pd.read_csv(tmp_path / "p.csv").columns.tolist() == found.columns.tolist()


@pytest.mark.parametrize(
    ("name", "crs", "sentence"),
    [
        ("p.shp", None, "Must end in .csv, .geojson, .gpkg."),
        ("p.gpkg", "EPSG:2263", "Must be projected, in metres."),  # New York, US survey feet
        ("p.gpkg", "EPSG:4326", "Must be projected, in metres."),
    ],
)
def test_other_files_and_units_are_refused(leaning, tmp_path, name, crs, sentence):
    with pytest.raises(ValueError, match=re.escape(sentence)):
        poles.write_poles(tmp_path / name, leaning[1], crs=crs)
    assert not list(tmp_path.iterdir())


def test_a_page_shows_the_doubtful_first(leaning, tmp_path):
    cloud, found = leaning
    two = pd.concat([found, found.assign(id=2, score=0.41, x_m=found["x_m"] + 2)])
    delivery.write_report(tmp_path / "p.html", cloud.points, two, title="Test", lines=["a <b>"])
    text = (tmp_path / "p.html").read_text()
    assert re.findall(r'<article id="p(\d)"', text) == ["2", "1"]
    assert "a &lt;b&gt;" in text
    codes = re.findall(r'<img src="data:image/png;base64,([^"]+)"', text)
    pictures = [cv2.imdecode(np.frombuffer(base64.b64decode(c), np.uint8), 0) for c in codes]
    # 5 cm a pixel, 80 wide a view: the pole in the middle of its own picture alone
    beside, own = (picture[40:-20, 38:43].min(axis=1) == 0 for picture in pictures)
    assert own.mean() > 0.9
    assert beside.mean() < 0.1


def test_decisions_are_read_back(leaning, tmp_path, capsys):
    cloud, found = leaning
    write_cloud(tmp_path / "street.laz", cloud)
    words = ["poles", str(tmp_path / "street.laz"), "--json"]
    assert main([*words, "--report", str(tmp_path / "p.html")]) in (0, None)
    assert '<article id="p1"' in (tmp_path / "p.html").read_text()
    assert len(json.loads(capsys.readouterr().out)) == 1
    # as the page saves them; the second is about no pole
    saved = f"id,x_m,y_m,decision\n1,{found['x_m'][0]:.4f},{found['y_m'][0]:.4f},"
    for decision, left in (("accept", ["accept"]), ("reject", [])):
        (tmp_path / "d.csv").write_text(f"{saved}{decision}\n2,90,90,reject\n")
        assert main([*words, "--decisions", str(tmp_path / "d.csv")]) in (0, None)
        printed = capsys.readouterr()
        assert [row["decision"] for row in json.loads(printed.out)] == left
        assert "1 decisions are about no pole" in printed.err


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("a,b\n1,2\n", "no column 'x_m'. Must have one."),
        ("x_m,y_m,decision\n1,2,maybe\n", "Must be one of accept, reject."),
    ],
)
def test_wrong_decisions_get_a_sentence(tmp_path, text, sentence):
    (tmp_path / "d.csv").write_text(text)
    with pytest.raises(ValueError, match=re.escape(sentence)):
        delivery.read_decisions(tmp_path / "d.csv")


def test_a_cloud_in_feet_is_refused(tmp_path, capsys):
    pd.DataFrame(floor((0, 0), (2, 2)), columns=["x", "y", "z"]).to_csv(
        tmp_path / "c.csv", index=False
    )
    assert main(["poles", str(tmp_path / "c.csv"), "--crs", "EPSG:2263"]) == 2
    assert "Must be projected, in metres." in capsys.readouterr().err
