"""The acceptance: figures and verdicts against the truth of a simulation, and faulty deliveries."""

import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import cv2
import laspy
import numpy as np
import pandas as pd
import pytest

from mmqa_lab.__main__ import main
from mmqa_lab.chart_image.legibility import CHECK_LIST, JUDGED
from mmqa_lab.chart_image.placing import find_markers
from mmqa_lab.charts import Marker
from mmqa_lab.io import read_cloud, read_trajectory, write_cloud
from mmqa_lab.simulate import site as simulated
from mmqa_lab.tender import photographs, published_criteria, report
from mmqa_lab.tender.acceptance import _risings, accept, speed_share
from mmqa_lab.tender.site import read_site

CRITERIA = {"test": published_criteria("test")}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The site, and what system A delivers."""
    place = tmp_path_factory.mktemp("site")
    simulated.write_site(place, systems="A", seed=1)
    return place


@pytest.fixture(scope="module")
def done(folder):
    """The acceptance of that delivery."""
    marks = photographs.read_marks(folder / "marks.csv")
    return accept(folder, read_site(folder / "site.json"), CRITERIA, marks=marks)


@pytest.fixture
def bare(folder, tmp_path):
    """A copy without images, which is judged at once."""
    place = tmp_path / "site"
    shutil.copytree(folder, place, ignore=shutil.ignore_patterns("*.jpg", "images.csv"))
    return place


def judged(place, marks=None):
    """The acceptance of a folder, and its sentences."""
    found = accept(place, read_site(place / "site.json"), CRITERIA, marks=marks)
    return found, [problem["what"] for problem in found.problems]


def test_images_are_those_the_rules_ask_for_and_measure_their_true_pixels(done):
    assert [(p.view, p.distance_m) for p in done.photographs] == [
        ("forward", 10.0),
        ("orthogonal", 5.0),
        ("backward", 10.0),
        ("orthogonal", 10.0),
    ]
    camera = simulated.VEHICLES["A"].camera
    for photo in done.photographs:
        near = photo.found["distance_m"]
        assert near >= 10 if photo.view != "orthogonal" else abs(near - photo.distance_m) < 0.5
        # a panorama's pixel at this distance, along the board's vertical
        size, sigma = photo.quality.pixel_size("v")
        assert size == pytest.approx(camera.pixel_size_mm(near), rel=0.1)
        drive = simulated.make_drive(photo.drive.distance_m, seed=1 + 1000 * ord("A"))
        board = simulated.site_boards().set_index("board", drop=False).loc[photo.board]
        time = drive.stations.iloc[int(photo.file.stem.split("_")[1])]["time_s"]
        there = simulated.station_map(simulated.VEHICLES["A"], drive, time, board)
        true = there.pixel_sizes_mm([[154.0, 500.0], [856.0, 500.0]])[:, 1].mean()
        assert abs(size - true) < max(4 * sigma, 0.003 * true)


def test_clouds_are_those_of_the_chart_along_the_path(done):
    table = done.results.set_index(["quantity", "distance_m"])
    assert table.loc[("sigma_mad_mm", 5.0), "value"] == pytest.approx(1.0, abs=0.15)  # 1 mm noise
    # two drives of one scanner: as many pulses for half the angle
    density = table.loc["density_per_m2", "value"]
    assert density[5.0] / density[10.0] == pytest.approx(2, rel=0.1)
    # lines follow each other at the vehicle's speed over 200 Hz, turned by 45 degrees
    spacing = 1000 * 44 / 3.6 / 200 / np.sqrt(2)
    assert table.loc[("d4_mm", 5.0), "value"] == pytest.approx(spacing, rel=0.05)
    assert (table["low"].dropna() <= table["high"].dropna()).all()


def test_verdicts_name_margin_and_uncertainty(done):
    table = done.verdicts["test"].set_index("criterion")
    density = table.loc["point density"]
    assert density["verdict"] == "met"
    assert density["margin"] == pytest.approx(density["value"] - 3000)
    assert density["low"] < density["value"] < density["high"]
    assert set(table.loc["pixel size", "verdict"]) == {"not met"}  # 9 to 13 mm, 5 are asked
    assert len(table.loc["pixel size"]) == 6  # three views, two directions
    assert set(table.loc["legibility", "value"]) == {"c"}
    assert done.summaries["test"]["verdict"].tolist() == ["fails"]


def test_missing_points_and_images_leave_gaps_with_reasons(bare):
    (bare / "A" / "drive_10m" / "cloud.laz").unlink()
    found, said = judged(bare)
    assert said.count("There are no images.") == 2
    assert "No points on the board 'point orthogonal'." in said
    assert any("No marks of a jury" in one for one in said)
    table = found.verdicts["test"].set_index("criterion")["verdict"]
    assert table["point density"] == "met"  # at 5 m
    assert set(table["pixel size"]) == set(table["legibility"]) == {"not measured"}
    shutil.rmtree(bare / "A" / "drive_10m")
    assert "No drive 10 m beside the boards." in judged(bare)[1]


def test_a_site_without_a_board_is_judged_by_the_others(bare):
    file = bare / "site.json"
    whole = json.loads(file.read_text())
    whole["boards"] = [b for b in whole["boards"] if b["board"] != "point orthogonal"]
    file.write_text(json.dumps(whole))
    found, said = judged(bare)
    table = found.verdicts["test"].set_index("criterion")["verdict"]
    assert table["point density"] == "not measured"
    assert "It has no point chart for the orthogonal view." in said
    whole["boards"] = []
    file.write_text(json.dumps(whole))
    with pytest.raises(ValueError, match="Must have one or more"):
        read_site(file)


def test_a_delivery_in_which_nothing_is_measured_gets_its_report(bare):
    plan = json.loads((bare / "site.json").read_text())
    plan["boards"] = [board for board in plan["boards"] if board["board"] != "point orthogonal"]
    (bare / "site.json").write_text(json.dumps(plan))
    assert main(["accept", str(bare), "--criteria", "pfeifer2021:1"]) == 1
    assert "not measured" in (bare / "report" / "report.html").read_text()


def test_a_slow_drive_proves_nothing_good(bare):
    for file in bare.rglob("trajectory.csv"):
        path = pd.read_csv(file)
        path["time_s"] *= 44 / 36
        path.to_csv(file, index=False)
    found, said = judged(bare)
    assert any("Speed was 3" in one and "at least 40" in one for one in said)
    table = found.verdicts["test"].set_index("criterion")["verdict"]
    assert table["point density"] == "undecided"  # slower is denser
    assert table["homogeneity"] == "not met"


def test_a_drive_too_far_away_proves_nothing_bad(bare):
    shutil.rmtree(bare / "A" / "drive_10m")
    file = bare / "A" / "drive_05m" / "trajectory.csv"
    path = pd.read_csv(file)
    path["easting_m"] -= 1.2
    path.to_csv(file, index=False)
    found, said = judged(bare)
    assert any("Distance was 6.2" in one and "between 4.5 and 5.5" in one for one in said)
    table = found.verdicts["test"].set_index("criterion")["verdict"]
    assert table["homogeneity"] == "undecided"
    assert table["point density"] == "met"


def test_clouds_in_other_coordinates_are_named(bare):
    file = bare / "A" / "drive_05m" / "cloud.laz"
    cloud = read_cloud(file)
    write_cloud(file, type(cloud)(cloud.points, crs="EPSG:25833"))
    assert any("cloud in ETRS89 / UTM zone 33N" in one for one in judged(bare)[1])
    write_cloud(file, type(cloud)(cloud.points + [3000, 0, 0]))
    assert any("no points on any board; it extends over 56" in one for one in judged(bare)[1])
    file.write_bytes(file.read_bytes()[:500])
    assert any("Must be a complete LAS" in one for one in judged(bare)[1])
    laspy.LasData(laspy.LasHeader(version="1.4", point_format=6)).write(str(file))
    assert "The cloud has no points." in judged(bare)[1]
    write_cloud(file, type(cloud)(cloud.points, {"gps_time": cloud["gps_time"] + 1e6}))
    assert any("times are not the trajectory's" in one for one in judged(bare)[1])


def test_the_site_of_another_place_is_refused_in_one_sentence(bare, capsys):
    file = bare / "site.json"
    whole = json.loads(file.read_text())
    for board in whole["boards"]:
        board["corners"] = (np.array(board["corners"]) + [5000, 0, 0]).tolist()
    file.write_text(json.dumps(whole))
    assert main(["accept", str(bare)]) == 2
    said = capsys.readouterr().err
    assert "stays 5005 m away from the boards: is it of another site?" in said
    assert not (bare / "report").exists()
    file.write_text("{}")
    assert main(["accept", str(bare)]) == 2
    assert "'boards'" in capsys.readouterr().err
    assert main(["accept", str(bare / "none")]) == 2
    assert "no such folder" in capsys.readouterr().err


def test_two_boards_in_one_image_without_orientation_are_told_apart_by_their_targets(tmp_path):
    boards = simulated.site_boards()
    other = boards.iloc[2]["layout"]  # its targets have other numbers
    boards = boards[:2].assign(layout=[boards.iloc[0]["layout"], other])  # side by side
    vehicle = simulated.Vehicle(None, 120)
    drive = simulated.make_drive(5.0, seed=1)
    time = float(np.interp(simulated.ORIGIN[1] - 7, drive.path.position[:, 1], drive.path.time))
    grey = {"seed": 1, "sensor": replace(simulated.SENSOR, bayer=False)}
    photos = [simulated.take_photo(vehicle, drive, time, b, **grey) for b in boards.itertuples()]
    low = np.min([photo.origin for photo in photos], axis=0)
    high = np.max([np.add(p.origin, p.image.shape[::-1]) for p in photos], axis=0)
    canvas = np.full((high - low)[::-1], 128, np.uint8)
    for photo in photos:
        column, row = photo.origin - low
        canvas[row:, column:][: photo.image.shape[0], : photo.image.shape[1]] = photo.image
    found = find_markers(canvas, list(boards["layout"]))
    position = drive.path.at([time])[0][0]
    for board in boards.itertuples():
        one = {
            marker.identifier: found[marker.identifier]
            for marker in board.layout.of_kind(Marker)[:1]
        }
        there = photographs._located(canvas, one, board.layout, vehicle.camera, low)
        place = photographs._camera_place(there, board)
        assert np.linalg.norm(place - position) < 0.3  # one target says where the chart is
    cv2.imwrite(str(tmp_path / "both.png"), canvas)
    window = {"first_column": low[0], "first_row": low[1]}
    images = pd.DataFrame([{"file": "both.png", **window}])
    ends = drive.path.position[[0, -1]]
    path = pd.DataFrame(ends, columns=["easting_m", "northing_m", "height_m"])
    here = SimpleNamespace(name="drive", folder=tmp_path, path=path)
    wanted, said = [(board, 7.0) for board in boards.itertuples()], []
    note = SimpleNamespace(say=lambda *words: said.append(words))
    chosen = photographs._chosen(here, images, wanted, vehicle.camera, note)
    assert [one["found"]["view"] for one in chosen] == ["forward", "forward"]
    away = np.linalg.norm(boards.iloc[0]["corners"].mean(axis=0) - position)
    assert chosen[0]["found"]["distance_m"] == pytest.approx(away, rel=0.03)
    tall = np.full((vehicle.camera.height, canvas.shape[1]), 128, np.uint8)  # from zenith to nadir
    tall[low[1] :][: canvas.shape[0]] = canvas
    cv2.imwrite(str(tmp_path / "tall.png"), tall)
    images = images.assign(file="tall.png", first_row=0)
    again = photographs._chosen(here, images, wanted, vehicle.camera, note)
    for one, whole, board in zip(chosen, again, boards.itertuples(), strict=True):
        pixels = [choice["map"].outline(board.layout.corners()) for choice in (one, whole)]
        assert np.allclose(pixels[1] - pixels[0], [0, low[1]], atol=0.2)
        assert whole["found"]["distance_m"] == pytest.approx(one["found"]["distance_m"], abs=0.02)
    same = [SimpleNamespace(board=name, layout=boards.iloc[0]["layout"]) for name in ("a", "b")]
    assert "Boards 'a' and 'b' have the same targets" in photographs._same_targets(same)
    assert not said


def test_the_command_writes_the_same_bytes_again(folder, done, tmp_path, monkeypatch, capsys):
    """Without evaluating the photographs a second time."""
    monkeypatch.setattr("mmqa_lab.tender.acceptance.accept", lambda *_, **__: done)
    for name in ("one", "two"):
        assert main(["accept", str(folder), "--out", str(tmp_path / name)]) == 1
    assert "scenario" not in capsys.readouterr().err
    written = sorted(f.relative_to(tmp_path / "one") for f in (tmp_path / "one").rglob("*.*"))
    assert {"report.html", "report.pdf", "verdicts.csv", "jury.csv"} <= {f.name for f in written}
    for file in written:
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()
    page = (tmp_path / "one" / "report.html").read_text()
    for title in ("Table 1", "Table 2", "SHA-256", "Could not be judged", "A/drive_05m/cloud.laz"):
        assert title in page
    form = pd.read_csv(tmp_path / "one" / "jury.csv")
    crops = form["crop"]
    photos = {name.split("_")[0] for name in crops}
    assert len(photos) == 4
    assert form["shows"].tolist() == 4 * list(JUDGED)
    names = {file.stem for file in (tmp_path / "one" / "crops").glob("*.png")}
    assert names == photos | set(crops)
    assert not [name for name in crops if "A" in name or "drive" in name]


def test_faulty_lists_of_images_are_named(folder, tmp_path):
    table = pd.read_csv(folder / "A" / "drive_10m" / "images.csv", dtype=object)
    said = []
    note = SimpleNamespace(say=lambda _, what: said.append(what), files=[])
    here = SimpleNamespace(name="drive", folder=tmp_path)
    table.loc[0, "file"] = "gone.jpg"
    shutil.copy(folder / "A" / "drive_10m" / table.loc[1, "file"], tmp_path)
    table.loc[1, "heading_deg"] = "north"
    table.to_csv(tmp_path / "images.csv", index=False)
    assert photographs._images(here, note).empty
    assert "gone.jpg: no such file." in str(said[0])
    assert "a number is missing" in said[1]
    table[:0].to_csv(tmp_path / "images.csv", index=False)
    assert photographs._images(here, note).empty
    (tmp_path / "images.csv").write_text("")
    assert photographs._images(here, note).empty
    assert "Must be rows of columns" in str(said[2])
    times = table.loc[[1], ["file", "time_s"]]
    times.to_csv(tmp_path / "images.csv", index=False)
    here.path = read_trajectory(folder / "A" / "drive_10m" / "trajectory.csv")
    assert len(photographs._images(here, note)) == 1
    times.assign(time_s=1e6).to_csv(tmp_path / "images.csv", index=False)
    assert photographs._images(here, note).empty
    assert said[3] == "Images with times outside of the path's: 1."
    image = tmp_path / table.loc[1, "file"]
    image.write_bytes(image.read_bytes()[:5000])
    assert photographs._images(here, note).empty
    assert f"Invalid image {image}" in str(said[4])


def test_a_second_drive_at_one_distance_does_not_count(bare):
    shutil.copytree(bare / "A" / "drive_05m", bare / "A" / "drive_twice")
    found, said = judged(bare)
    assert len(found.drives) == 2
    assert "It is 5 m beside the boards, as A/drive_05m is." in said


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"speed_kmh": "fast"}, "Invalid speed_kmh 'fast'. Must be a number"),
        ({"distances_m": []}, "boards, distances_m. Must have one or more"),
        ({"control_points": [[1, 2]]}, "Invalid control_points of shape (1, 2)"),
        ({"boards": 5}, "Must be a site as JSON"),
        ({"boards": [{"board": "x", "kind": "point"}]}, "no field 'corners'"),
        ({"order": [2, 3, 0, 1]}, "must begin lower left, then lower right"),
        ({"order": [1, 0, 3, 2]}, "The drive passes 5.0 m behind the boards"),
    ],
)
def test_a_wrong_field_of_a_site_gets_one_sentence(bare, capsys, change, sentence):
    whole = json.loads((bare / "site.json").read_text())
    order = change.pop("order", range(4))
    for board in whole["boards"]:
        board["corners"] = [board["corners"][k] for k in order]
    (bare / "site.json").write_text(json.dumps(whole | change))
    assert main(["accept", str(bare)]) == 2
    assert sentence in capsys.readouterr().err


def test_what_a_drive_or_a_list_of_criteria_has_wrong_leaves_the_rest_judged(bare):
    control, path = (bare / "A" / "drive_05m" / name for name in ("control.csv", "trajectory.csv"))
    table = pd.read_csv(control)
    for wrong in (table.assign(point=0), table.assign(easting_m=np.nan)):
        wrong.to_csv(control, index=False)
        found, said = judged(bare)
        assert len(found.control) == 6
        assert any("Invalid control.csv. Must have point, 1 to 6" in one for one in said)
    table.to_csv(control, index=False, sep=";", decimal=",")
    criteria = pd.DataFrame({"criterion": "xyz", "relation": ">=", "threshold": 3}, index=[*"xyz"])
    criteria["criterion"], criteria["distance_m"] = criteria.index, [5, 7, 5]
    criteria["quantity"] = ["densty_per_m2", "f", "f"]
    found = accept(bare, read_site(bare / "site.json"), {"own": criteria})
    assert len(found.control) == 12
    said = [row["what"] for row in found.problems if row["where"] == "criteria own"]
    assert said == ["'x': no figure 'densty_per_m2' at 5 m.", "'y': no figure 'f' at 7 m."]
    middle = pd.read_csv(path).median()
    standing = pd.read_csv(path).assign(easting_m=middle.easting_m, northing_m=middle.northing_m)
    standing.to_csv(path, index=False)
    found, said = judged(bare)
    assert [drive.distance_m for drive in found.drives] == [10.0]
    assert any("0.0 m long. Must be 10 m or more" in one for one in said)


def test_marks_of_three_jurors_in_both_forms(folder, tmp_path):
    wide = pd.read_csv(folder / "marks.csv")
    marks = photographs.read_marks(folder / "marks.csv")
    assert len(marks) == 3 * len(wide)
    marks.to_csv(tmp_path / "long.csv", index=False)
    assert photographs.read_marks(tmp_path / "long.csv").equals(marks.reset_index(drop=True))
    wide.map(lambda cell: f"{cell} ".upper() if cell in "abc" else cell).to_csv(
        tmp_path / "sheet.csv", index=False, sep=";"
    )
    assert photographs.read_marks(tmp_path / "sheet.csv").equals(marks)
    wide.assign(juror_1="", juror_2="", juror_3="").to_csv(tmp_path / "none.csv", index=False)
    none, said = photographs.read_marks(tmp_path / "none.csv"), []
    note = SimpleNamespace(say=lambda _, what: said.append(what))
    photo = SimpleNamespace(found={"crop": "0a"}, board="b", drive=SimpleNamespace(name="d"))
    assert photographs._jury(photo, none, note) == {}
    assert said == ["Board 'b': the jury did not mark crop 0a."]
    wide[["crop"]].to_csv(tmp_path / "bad.csv", index=False)
    with pytest.raises(ValueError, match="no jurors"):
        photographs.read_marks(tmp_path / "bad.csv")
    (tmp_path / "bad.csv").write_text("crop,juror_1\n0a,d\n")
    with pytest.raises(ValueError, match="Invalid mark 'd'"):
        photographs.read_marks(tmp_path / "bad.csv")


def test_elements_give_a_photograph_its_mark(tmp_path):
    numbers = [k for k, (what, _, _) in enumerate(CHECK_LIST, start=1) if what in JUDGED]
    table = pd.DataFrame({"crop": [f"0a_{k:02d}" for k in numbers], "shows": JUDGED})
    table[["one", "two", "three"]] = "a"
    table.loc[table["shows"] == "double l", ["one", "two"]] = ["b", "c"]
    table.loc[table["shows"] == "raised h", ["one", "two"]] = "b"
    table.to_csv(tmp_path / "marks.csv", index=False)
    marks, said = photographs.read_marks(tmp_path / "marks.csv"), []
    note = SimpleNamespace(say=lambda _, what: said.append(what))
    photo = SimpleNamespace(found={"crop": "0a"}, board="b", drive=SimpleNamespace(name="d"))
    assert photographs._jury(photo, marks, note) == {}  # a, b and c for the double l
    assert said == ["Crop 0a: the jury has no majority of 'double l', or left it out."]
    marks.loc[(marks["juror"] == "two") & (marks["mark"] == "c"), "mark"] = "a"
    found = photographs._jury(photo, marks, note)
    assert found == {"value": "b", "low": 0.0, "high": 1.0}  # raised h by two of three
    assert report._interval(*found.values()) == "a to b"
    assert (photo.found["because"], photo.found["marks"]) == ("raised h", "abb")
    photographs._jury(photo, marks[marks["juror"] != "one"], note)
    assert "Crop 0a: an element has 2 of 3 jurors' marks." in said
    photo.found["crop"] = "0b"
    assert photographs._jury(photo, marks, note) == {}
    assert said[-1] == "Board 'b': the jury did not mark crop 0b."
    (tmp_path / "bad.csv").write_text("")
    with pytest.raises(ValueError, match=r"Invalid marks .* Must be rows of columns"):
        photographs.read_marks(tmp_path / "bad.csv")
    (tmp_path / "bad.csv").write_text("crop,juror_1\n0a_99,a\n")
    with pytest.raises(ValueError, match=r"element 99\. Must be 1 to 24"):
        photographs.read_marks(tmp_path / "bad.csv")


def test_intervals_of_clouds_have_the_part_of_the_speed(done):
    drive, _, quality = next(one for one in done.clouds if one[1]["view"] == "orthogonal")
    middle = simulated.site_boards().set_index("board").loc["point orthogonal", "corners"]
    share = speed_share(drive.path, middle.mean(axis=0))
    assert 0.006 < share < 0.014  # wanders by 1 %
    alone = quality.intervals().set_index("figure")
    table = done.results.query("distance_m == 5").set_index("quantity")
    for figure, quantity in (("density", "density_per_m2"), ("d4", "d4_mm"), ("f", "f")):
        value, _, high, _ = alone.loc[figure]
        of_speed = np.sqrt((table.loc[quantity, "high"] - value) ** 2 - (high - value) ** 2)
        assert of_speed / value == pytest.approx(1.96 * share, rel=0.15)  # lines as far apart
    # no better than half a step of the stored coordinates, 0.1 mm
    assert alone.loc["d1", "high"] - alone.loc["d1", "value"] < 0.001
    assert table.loc["d1_mm", "high"] - table.loc["d1_mm", "value"] == pytest.approx(0.05)
    steady = pd.DataFrame({"time_s": [0.0, 5, 7], "northing_m": [0.0, 50, 100]})
    steady = steady.assign(easting_m=0.0, height_m=0.0)
    pace = np.array([0.1] * 50 + [0.04] * 49)  # half of it at 10, half at 25 m/s
    found = speed_share(steady, np.array([0.0, 50.0, 0.0]))
    assert found == pytest.approx(pace.std(ddof=1) / pace.mean(), rel=1e-6)


def test_other_heights_of_a_path_wander_as_much_and_keep_its_slope():
    north, board = np.arange(101.0), np.array([0.0, 50.0, 0.0])
    path = pd.DataFrame({"easting_m": 0.0, "northing_m": north, "time_s": north / 10})
    times = np.arange(1.0, 10)  # 10 m apart
    slope = 0.03 * north
    for up in _risings(path.assign(height_m=slope), board, times):
        assert up == pytest.approx(0, abs=1e-9)
    rng, squares = np.random.default_rng(1), []
    for _ in range(100):
        walk = np.cumsum(rng.normal(0, 0.001, len(north)))  # 1 mm a metre
        for up in _risings(path.assign(height_m=slope + walk), board, times):
            squares += list(np.diff(up[:, 2]) ** 2)
    # a walk less another has twice the variance of its 10 steps; but one mean of 99 steps is drawn
    expected = 10 * 0.001**2 * (2 * (1 - 10 / 99) + 10 / 99)
    assert np.mean(squares) == pytest.approx(expected, rel=0.1)


def test_control_points_differ_by_what_the_navigation_is_off(done, bare):
    table = pd.DataFrame(done.control)
    assert len(table) == 2 * 6
    off = table[["easting_m", "northing_m", "height_m"]]
    assert 1 < np.sqrt((off**2).mean(axis=None)) < 40  # mm; drifts by 10 mm an axis
    (bare / "A" / "drive_05m" / "control.csv").write_text("point,easting_m\n9,1\n")
    found, said = judged(bare)
    assert len(found.control) == 6
    assert any("Invalid control.csv. Must have point, 1 to 6" in one for one in said)


def test_images_tell_camera_date_aperture_and_exposure(done):
    found = photographs.exif_texts(done.photographs[0].file)
    assert found == {
        "camera": f"mmqa_lab panorama, {simulated.VEHICLES['A'].camera.width} columns",
        "date": "2021:01:12 10:00:00",
        "f-number": "8",
        "exposure (s)": "0.0005",
    }


def test_colour_fringes_are_read_where_a_photograph_has_colours(done, tmp_path):
    photo = done.photographs[0]
    assert min(photographs.fringes(photo).values()) > 0.03  # the example's cameras have a mosaic
    grey = cv2.imread(str(photo.file), cv2.IMREAD_GRAYSCALE)
    shares = []
    for step in (0, 1):
        colours = np.dstack([grey, grey, np.roll(grey, step, axis=1)])
        cv2.imwrite(str(tmp_path / "colour.png"), colours)
        here = SimpleNamespace(file=tmp_path / "colour.png", quality=photo.quality)
        shares.append(photographs.fringes(here)["h"])
    assert shares[0] == pytest.approx(0, abs=0.02)
    assert shares[1] > 0.2


def test_the_example_is_not_written_over_anything(folder, capsys):
    assert main(["accept", "--example", str(folder)]) == 2
    assert "not empty" in capsys.readouterr().err


def test_a_simulated_drive_keeps_the_rules(folder):
    for file in folder.rglob("trajectory.csv"):
        path = read_trajectory(file)
        speed = 3.6 * np.diff(path["northing_m"]) / np.diff(path["time_s"])
        assert speed.min() > 40
        beside = simulated.ORIGIN[0] - path["easting_m"].mean()
        assert beside == pytest.approx(float(file.parent.name[6:8]), abs=0.1)
