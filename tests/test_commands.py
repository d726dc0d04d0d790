"""The command line: what is printed, written, refused; and that it starts on a bare Python."""

import json
import os
import shlex
import subprocess
import sys
import venv
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pyproj
import pytest

from mmqa_lab import chart_cloud, charts, commands, io, samples, simulate
from mmqa_lab.__main__ import main
from mmqa_lab.cloud import Cloud
from mmqa_lab.commands import machine
from mmqa_lab.simulate.test_field import drive_test_field, make_test_field
from mmqa_lab.studies import chosen

IMAGE = "image chart.png --linear --corners '19.5,269.5; 269.5,269.5; 269.5,19.5; 19.5,19.5'"

CASES = {
    "evaluate": ("evaluate PATCH --out figure.svg", 1, "figure.svg"),
    "info": ("info PATCH", 1, None),
    "image": (f"{IMAGE} --out reading.png", 1, "reading.png"),
    "chart": ("chart --out chart.svg", 1, "chart.svg"),
    "radiometry": ("radiometry sharpness chart.png --linear", 1, None),
    "tender": ("tender pfeifer2021:2 pfeifer2021", 3, None),
    "lhd": ("lhd course.csv model.csv", None, None),
    "plan": ("plan --scanner vq-450 --speed 14 --range 8", None, None),
    "pattern": ("pattern head.laz", 5, None),
    "poles": ("poles street.xyz --method itc", 1, None),
    "map": ("map PATCH --out m.nc --cell 1", None, "m.nc"),
    "accuracy": ("accuracy PATCH levelled.csv --out differences.csv", 2, "differences.csv"),
}
"""A call of each command, the rows that it writes, and its main product beside its table."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Small files that every command can work on."""
    folder = tmp_path_factory.mktemp("commands")
    image = charts.reflectance(charts.imaging_chart(), cell=4)[::-1]
    grey = np.pad(255 * image, 20, constant_values=128).astype(np.uint8)
    cv2.imwrite(str(folder / "chart.png"), grey)
    shifts = [*np.random.default_rng(1).uniform(0.1, 0.3, 12), 40]  # the last has no partner
    for name, share in (("model", 0), ("course", 1)):
        ends = [
            (10 * k, share * y, 0, 10 * k + 6 * (k % 2), share * y, 6 * (1 - k % 2))
            for k, y in enumerate(shifts)
        ]
        np.savetxt(folder / f"{name}.csv", ends, delimiter=",")
    turn = np.arange(60) * 2.4
    post = np.stack([5 + 0.05 * np.cos(turn), 5 + 0.05 * np.sin(turn), turn / 48], axis=1)
    floor = np.stack([*np.mgrid[0:10:0.2, 0:10:0.2].reshape(2, -1), np.zeros(2500)], axis=1)
    np.savetxt(folder / "street.xyz", np.vstack([post, floor]))
    road = io.read_cloud(samples.path("road_patch"))
    first = road["gps_time"] < road["gps_time"].mean()  # the other head came later
    io.write_cloud(folder / "head.laz", road[first])
    rows = (f"{1423215.0 + 0.05 * k:.2f},4189097.6,67.88\n" for k in range(30))
    (folder / "levelled.csv").write_text("x,y,z\n" + "".join(rows))
    return folder


@pytest.fixture
def call(folder, tmp_path, monkeypatch, capfd):
    """A command's call in a fresh folder: exit status, standard output, standard error."""
    for file in folder.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    monkeypatch.chdir(tmp_path)

    def run(line):
        patch = str(samples.path("road_patch"))
        words = [patch if word == "PATCH" else word for word in shlex.split(line)]
        return main(words), *capfd.readouterr()

    return run


@pytest.mark.parametrize("name", CASES)
def test_a_table_is_printed_and_written(name, call, tmp_path):
    line, rows, product = CASES[name]
    status, out, err = call(f"{line} --csv rows.csv --report page.html")
    assert (status, err) == (0, "")
    assert max(map(len, out.splitlines())) <= 100
    written = pd.read_csv(tmp_path / "rows.csv")
    assert rows is None or len(written) == rows
    assert product is None or (tmp_path / product).stat().st_size > 0
    page = (tmp_path / "page.html").read_text()
    assert f"<h1>mmqa {name}</h1>" in page
    assert ("PATCH" in line) == (samples.SAMPLES["road_patch"].sha256 in page)
    status, out, _ = call(f"{line} --json")
    printed = json.loads(out)
    assert (status, len(printed)) == (0, len(written))
    assert list(printed[0]) == list(written)


def test_a_command_is_its_function():
    table = commands.evaluate([samples.path("road_patch")])
    quality = chart_cloud.evaluate_cloud(io.read_cloud(samples.path("road_patch")))
    assert table["f"].item() == quality.f


def test_calibrate_takes_sbet_with_its_las_and_writes_corrected_clouds(call, tmp_path):
    street, zone = make_test_field(length_m=40, seed=1), pyproj.CRS(25832)
    choices = {"pulse_rate_hz": 2e4, "mirror_frequency_hz": 50, "heading_deg": 45, "tilt_deg": 30}
    head = simulate.Scanner(**choices, boresight_deg=(0.0, 0.4, 0.3))
    drives = drive_test_field(street, simulate.System("one head", (head,)), seed=4)
    away = np.array([448_000.0, 5_411_000.0, 100.0]) - drives[0][0].points[0]
    for name, (cloud, path) in zip(("there", "back"), drives, strict=True):
        moved = replace(cloud, points=cloud.points + away, crs=zone)
        io.write_cloud(tmp_path / f"{name}.laz", moved)
        places = path.position + away
        to = pyproj.Transformer.from_crs(zone, 4326, always_xy=True)
        globe = np.array(to.transform(*places[:, :2].T))
        north = pyproj.Proj(zone).get_factors(*globe).meridian_convergence
        rows = np.zeros((len(places), 17))
        rows[:, 0], rows[:, 3], rows[:, 10] = path.time, places[:, 2], 0.3  # the wander angle
        angles = [*globe[::-1], path.roll, path.pitch, path.heading + north]
        rows[:, [1, 2, 7, 8, 9]] = np.radians(angles).T + [0, 0, 0, 0, 0.3]
        rows.tofile(tmp_path / f"{name}.sbet")
    posts = street.poles.copy()
    posts[["x_m", "y_m", "z_m"]] += away
    posts.to_csv(tmp_path / "posts.csv", index=False)
    line = "calibrate there.laz back.laz --trajectory there.sbet --trajectory back.sbet"
    status, out, _ = call(f"{line} --poles posts.csv --out corrected --csv found.csv")
    assert status == 0
    assert "heading_deg" in out
    found = pd.read_csv(tmp_path / "found.csv").set_index("parameter")["value"]
    assert found[["roll_deg", "pitch_deg", "heading_deg"]].tolist() == pytest.approx(
        [0, 0.4, 0.3], abs=0.005
    )
    assert len(io.read_cloud(tmp_path / "corrected" / "1_there.laz")) == len(drives[0][0])


def test_what_is_empty_or_wide_fits_the_terminal():
    wide = pd.DataFrame({f"a_long_name_{k}": [k / 3] * 2 for k in range(20)} | {"none": ["", ""]})
    text = machine.as_text(wide.assign(remarks=["said once", "said once"], missing=0))
    assert max(map(len, text.splitlines())) <= 100
    assert text.count("said once") == 1
    assert not {"none", "missing"} & set(text.split())
    assert machine.as_text(wide[:0]).splitlines()[-1] == "none"
    table = pd.DataFrame({"file": ["a", "a", "b"], "f": [1, np.nan, 2]})
    table["remarks"] = ["It is bent.", "f has no points. It is bent.", "It is bent."]
    said = machine.as_text(table).splitlines()[-3:]
    assert said == ["a: It is bent.", "a: f has no points.", "b: It is bent."]


def test_a_backslash_in_a_name_does_not_turn_a_table_round():
    table = pd.DataFrame({"file": ["C:\\drives\\there.laz"], "points": [3], "f": [2.0]})
    assert machine.as_text(table).splitlines()[0].split() == ["file", "points", "f"]


@pytest.mark.parametrize("files", [1, 2, 9])
def test_coordinates_are_printed_to_the_centimetre_in_degrees_too(files, tmp_path, capfd):
    place = np.array([11.5123456, 48.1234567, 512.34])
    names = [tmp_path / f"{k}.xyz" for k in range(files)]
    for name in names:
        np.savetxt(name, place + np.random.default_rng(1).random((60, 3)) * [1e-5, 1e-5, 1], "%.9f")
    np.savetxt(tmp_path / "far.xyz", [[452123.456, 5411234.567, 1]] * 3, "%.3f")
    (tmp_path / "bad.xyz").write_text("a b c\n")
    given = [*names, tmp_path / "far.xyz", *([tmp_path / "bad.xyz"] if files > 1 else [])]
    assert commands.run(["info", *map(str, given)]) == int(files > 1)
    shown = capfd.readouterr().out
    assert all(text in shown for text in ("11.51234", "48.12345", "452123.456", "5411234.567"))
    assert "nan" not in shown


def test_lab_asks_the_notebook_server_before_it_ends(monkeypatch):
    class Server:
        """Goes on after the first Ctrl-C, as Jupyter does until it has an answer."""

        def __init__(self, command, **_):
            self.ends = iter((KeyboardInterrupt, 0))

        def wait(self):
            end = next(self.ends)
            if end:
                raise end
            return end

    monkeypatch.setattr(commands.laboratory.subprocess, "Popen", Server)
    assert commands.laboratory.lab() == 0


def test_help_and_preparing_need_the_standard_library_alone(tmp_path):
    venv.create(tmp_path / "bare", with_pip=False)
    python = tmp_path / "bare" / ("Scripts" if sys.platform == "win32" else "bin") / "python"
    root = Path(commands.__file__).parents[2]
    for command in ("studies", "test", "lab"):
        code = (
            "import mmqa_lab.__main__ as m; m.prepare = lambda want: print(want.name) or 1 / 0\n"
            f"m.main(['{command}'])"
        )
        done = subprocess.run([python, "-c", code], cwd=root, capture_output=True, text=True)
        assert done.stdout == "environment.txt\n"
        assert "ZeroDivisionError" in done.stderr
    asked = [python, "-m", "mmqa_lab", "evaluate", "--help"]
    shown = subprocess.run(asked, cwd=root, capture_output=True, text=True)
    assert shown.stdout.startswith("The manual of evaluate comes with the environment.")
    shown = subprocess.run([python, "-m", "mmqa_lab", "--help"], cwd=root, capture_output=True)
    assert b"mmqa COMMAND" in shown.stdout


@pytest.mark.parametrize(
    ("line", "name"),
    [
        ("evaluate BAD head.laz", "bad.xyz"),
        ("pattern head.laz BAD", "bad.xyz"),
        ("radiometry sharpness BAD chart.png --linear", "bad.xyz"),
        (IMAGE.replace("image", "image BAD"), "bad.xyz"),
    ],
)
def test_a_file_that_fails_costs_the_others_nothing(line, name, folder, tmp_path, monkeypatch):
    monkeypatch.chdir(folder)
    (tmp_path / name).write_text("a b c\n")
    words = shlex.split(line.replace("BAD", str(tmp_path / name)))
    status = commands.run([*words, "--csv", str(tmp_path / "rows.csv")])
    rows = pd.read_csv(tmp_path / "rows.csv")
    bad = rows.iloc[:, 0] == name
    reason = rows[rows.columns[rows.columns.str.startswith("remark")][0]]
    assert (status, bad.sum()) == (1, 1)
    assert reason[bad].str.startswith("Invalid").all()
    assert rows.loc[~bad].drop(columns=reason.name).notna().any(axis=1).all()


MARKED = ["evaluate C", "info C", "pattern C", "accuracy C C", "map C --out m.nc", "evaluate C C"]


@pytest.mark.parametrize("line", MARKED)
def test_what_a_reader_says_of_a_file_is_in_the_table(line, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    x, y = np.mgrid[0:1:0.05, 0:1:0.02].reshape(2, -1)
    kind = np.where(np.arange(len(x)) < 7, 7, 2)
    times = np.floor(x / 0.05) * 0.01 + y / 1000
    cloud = Cloud(np.stack([x, y, 0 * x], axis=1), {"classification": kind, "gps_time": times})
    io.write_cloud("c.laz", cloud)
    words = line.replace("C", "c.laz").split()
    assert commands.run([*words, "--json", "--csv", "rows.csv", "--report", "page.html"]) == 0
    out, err = capfd.readouterr()
    said = "Dropped 7 of 1000 points of"
    assert said in json.loads(out)[0]["remarks"]
    assert said in pd.read_csv("rows.csv")["remarks"][0]
    assert said in Path("page.html").read_text()
    assert said not in err


def test_what_was_left_out_is_said_where_nothing_remains(tmp_path, capfd):
    cloud = Cloud(np.random.default_rng(1).random((60, 3)), {"withheld": np.ones(60, np.uint8)})
    io.write_cloud(tmp_path / "c.laz", cloud)
    assert commands.run(["evaluate", str(tmp_path / "c.laz")]) == 2
    said = capfd.readouterr().err
    assert "Dropped 60 of 60 points" in said
    assert "no points. Must contain one or more." in said


@pytest.mark.parametrize(
    ("line", "status"),
    [
        ("--help", 0), ("evaluate --help", 0), ("evaluate good.xyz", 0), ("info good.xyz", 0),
        ("evaluate good.xyz bad.xyz", 1), ("info good.xyz bad.xyz", 1), ("pattern bad.xyz", 2),
        ("info bad.xyz", 2), ("evaluate none.xyz", 2), ("nonsense", 2), ("evaluate", 2),
        ("map good.xyz bad.xyz --out m.nc", 2), ("lhd good.xyz bad.xyz", 2), ("poles bad.xyz", 2),
        ("calibrate good.xyz --trajectory bad.xyz", 2), ("chart --out chart.docx", 2),
        ("student copies none", 2), ("studies none", 2), ("bench none", 2), ("tender a b", 2),
    ],
)  # fmt: skip
def test_the_exit_status_says_what_was_done(line, status, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    np.savetxt("good.xyz", np.random.default_rng(1).random((60, 3)))
    Path("bad.xyz").write_text("a b c\n")
    assert main(line.split()) == status
    assert (status == 2) == (capfd.readouterr().out == "")


@pytest.mark.parametrize("name", [b"n\xff\xfe.png", "ä ü.png".encode()])
def test_names_of_files_may_have_any_bytes(name, tmp_path):
    path = tmp_path / os.fsdecode(name)
    path.write_bytes(cv2.imencode(".png", np.full((90, 90), 99, np.uint8))[1].tobytes())
    words = ["info", os.fsencode(path), "--json", "--csv", "rows.csv", "--report", "page.html"]
    words = [sys.executable, "-m", "mmqa_lab", *words]  # outside: a decoder may end the process
    done = subprocess.run(words, capture_output=True, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"90 x 90 pixels" in done.stdout


@pytest.mark.parametrize(
    "error",
    [
        KeyError("reason_"),
        IndexError("of bounds"),
        AttributeError("no attribute"),
        MemoryError(),
        ZeroDivisionError(),
        ValueError("setting an array element with a sequence"),
        OverflowError("too large"),
    ],
    ids=lambda one: type(one).__name__,
)
def test_an_error_that_nobody_foresaw_is_one_sentence(error, monkeypatch, capfd):
    def fails(*_, **__):
        raise error

    monkeypatch.setattr(chart_cloud, "evaluate_cloud", fails)
    path = str(samples.path("road_patch"))
    assert commands.run(["evaluate", path]) == 2
    said = capfd.readouterr().err
    assert said.startswith(f"mmqa evaluate: Invalid input {path}: ")
    assert said.count("\n") == 1
    assert not str(error) or str(error) not in said.replace(path, "")


def test_negative_numbers_are_values(capfd):
    path = str(samples.path("road_patch"))
    for line in ("-.5,1,2; 3,4,5; 6,7,9", "-0.5,1,2; 3,-4,5; 6,7,9"):
        assert commands.run(["evaluate", path, "--polygon", line]) == 2
        assert "inside the polygon: 0 given" in capfd.readouterr().err
    given = ["calibrate", path, "--trajectory", "no.csv", "--lever-arm", "-0.35,-0.7,0.25"]
    assert commands.run(given) == 2
    assert "no.csv: no such file" in capfd.readouterr().err


@pytest.mark.parametrize("backend", ["module://nothing", "nonsense"])
def test_a_backend_that_is_not_there_is_named(backend, tmp_path):
    path, figure = str(samples.path("road_patch")), str(tmp_path / "figure.png")
    call = [sys.executable, "-m", "mmqa_lab", "evaluate", path, "--out", figure]
    place = dict(os.environ, MPLBACKEND=backend)
    done = subprocess.run(call, env=place, capture_output=True, text=True)
    name = backend.removeprefix("module://")
    wanted = f"Invalid MPLBACKEND {name}. Must name an installed module, or be agg."
    assert (done.returncode, done.stderr) == (2, f"mmqa evaluate: {wanted}\n")


@pytest.mark.parametrize("version", [(3, 10, 13), (3, 8, 18)])
def test_an_older_python_gets_a_sentence_and_no_environment(version, tmp_path):
    """It has no tomllib and none of the packages."""
    code = f"""import sys
sys.version = "{".".join(map(str, version))} (main)"
sys.version_info = (*{version}, "final", 0)
sys.modules |= dict.fromkeys(("tomllib", "numpy", "pandas"))
import mmqa_lab.__main__ as m
from pathlib import Path
m.prepared, m.VENV = lambda wanted: False, Path({str(tmp_path / "made")!r})
m._uv = m._install = lambda *_: None
m.main(["info", "x.laz"])"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    name = ".".join(map(str, version))
    assert done.stderr == f"mmqa: Invalid Python {name}. Must be 3.11 or newer.\n"
    assert done.returncode == 1
    assert not (tmp_path / "made").exists()


def asked(study, folder, *, size):
    """A run of a study that takes no time."""
    return study.stem


def test_the_longest_study_begins_first_and_the_shortest_is_next(tmp_path):
    studies = chosen(["mimic", "poles", "fitness"])
    known = {"mimic": 20.0, "fitness": 5.0, "poles": 90.0}
    ran = list(commands.laboratory._run_studies(asked, studies, tmp_path, "quick", 1, known))
    assert [record for _, record in ran] == ["poles", "fitness", "mimic"]
    assert [study.stem for study, _ in ran] == ["poles", "fitness", "mimic"]


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("calibrate a.laz --trajectory p.csv --lever-arm 0 0 0", "arguments 0 0"),
        ("map a.laz --cell 1 2 --out m.nc", "arguments 2"),
        ("map a.laz --cell x --out m.nc", "--cell x"),
        ("evaluate a.laz --json=maybe", "--json maybe"),
        ("evaluate a.laz --polygon", "command without --polygon"),
        ("evaluate", "command without CLOUDS"),
        ("evaluate a.laz --polgon b", "option --polgon"),
        ("evaluate a.laz --raise", "option --raise"),
        ("evalute a.laz", "command line: "),
    ],
)
def test_a_command_line_that_does_not_fit_is_one_own_sentence(words, found, capsys):
    assert main(words.split()) == 2
    told = capsys.readouterr().err.strip()
    assert told.startswith(f"mmqa {words.split()[0]}: Invalid {found}")
    assert ". Must be " in told
    assert len(told.splitlines()) == 1
