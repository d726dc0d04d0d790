"""One manner over all commands that take users' data: what is printed, written, refused, said."""

import io
import json
import shlex
import sys

import cv2
import numpy as np
import pandas as pd
import pytest

from mmqa_lab import charts, samples, simulate
from mmqa_lab.__main__ import main, parser
from mmqa_lab.commands import _output
from mmqa_lab.io import write_cloud
from mmqa_lab.simulate.testfield import drive_testfield, make_testfield

PLAN = "plan --scanner vq-450 --speed 14 --range 8"

IMAGE = "image chart.png --linear --corners '19.5,269.5; 269.5,269.5; 269.5,19.5; 19.5,19.5'"

CALIBRATE = "calibrate there.laz back.laz --trajectory path.csv --patches 60 --poles posts.csv"

CASES = {
    "evaluate": ("evaluate PATCH", 1, "figure.svg"),
    "info": ("info PATCH", 1, None),
    "image": (IMAGE, 1, "reading.png"),
    "chart": ("chart --out chart.svg", 1, "chart.svg"),
    "radiometry": ("radiometry sharpness chart.png --linear", 1, None),
    "tender": ("tender pfeifer2021:2 pfeifer2021", 3, None),
    "lhd": ("lhd course.csv model.csv", 1, "edges"),
    "plan": (PLAN, 1, None),
    "poles": ("poles street.xyz --method itc", 1, "poles.geojson"),
    "map": ("map PATCH --out m.nc --cell 1 --metrics density --workers 1", None, "m.nc"),
    "accuracy": ("accuracy PATCH levelled.csv", 2, "differences.csv"),
    "calibrate": (CALIBRATE, 6, "corrected"),
}
"""A call of each command, the rows that it writes, and its main product beside its table."""

RANDOM = {"chart", "lhd"}

OBJECT = {"plan", "lhd"}
"""Their JSON is one object; that of the others a list with one for each row."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Small files that every command can work on."""
    folder = tmp_path_factory.mktemp("commands")
    image = charts.reflectance(charts.imaging_chart(), cell=4)[::-1]
    cv2.imwrite(
        str(folder / "chart.png"), np.pad(255 * image, 20, constant_values=128).astype(np.uint8)
    )
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
    street = make_testfield(length_m=40, seed=1)
    mounting = {"heading_deg": 45, "tilt_deg": 30}
    head = simulate.ProfileScanner(pulse_rate_hz=2e4, mirror_frequency_hz=50, **mounting)
    drives = drive_testfield(street, simulate.System("one head", (head,)), seed=4)
    rows = []
    for name, (cloud, path) in zip(("there", "back"), drives, strict=True):
        write_cloud(folder / f"{name}.laz", cloud)
        rows += [*np.column_stack([path.time, path.position, path.heading])]
    columns = ["time", "x", "y", "z", "heading"]
    pd.DataFrame(rows, columns=columns).to_csv(folder / "path.csv", index=False)
    street.poles.to_csv(folder / "posts.csv", index=False)
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
        try:
            status = main(words)
        except SystemExit as stop:  # argparse leaves this way
            status = stop.code
        return status, *capfd.readouterr()

    return run


@pytest.fixture(params=CASES)
def case(request):
    """Name, call, rows and product of a command."""
    return request.param, *CASES[request.param]


def options(name):
    """The options of a command by their long names."""
    commands = parser()._subparsers._group_actions[0].choices
    return {text: one for one in commands[name]._actions for text in one.option_strings}


def test_options_have_one_name_and_one_meaning(case):
    name, _, _, product = case
    known, first = options(name), options("evaluate")
    for option in ("--json", "--csv"):
        assert (known[option].help, known[option].metavar) == (
            first[option].help,
            first[option].metavar,
        )
    assert ("--out" in known) == (product is not None)
    assert ("--seed" in known) == (name in RANDOM)


def test_json_is_all_that_is_printed_and_csv_holds_the_rows(case, call, tmp_path):
    name, line, rows, _ = case
    status, out, err = call(f"{line} --json --csv rows.csv")
    assert status == 0
    assert err == ""
    printed = json.loads(out)
    assert isinstance(printed, dict if name in OBJECT else list)
    table = pd.read_csv("rows.csv")
    assert len(table) == (len(printed) if rows is None else rows)
    if name not in OBJECT:
        assert list(printed[0]) == list(table)
    written = (tmp_path / "rows.csv").read_bytes()
    status, out, _ = call(f"{line} --csv rows.csv")  # the table for readers leaves it as it is
    assert status == 0
    assert not out.startswith(("{", "["))
    assert (tmp_path / "rows.csv").read_bytes() == written


def test_out_is_the_main_product(case, call, tmp_path):
    _, line, _, product = case
    if product is None:
        pytest.skip("makes no file of what is given here")
    more = "" if "--out" in line else f"--out {product}"
    assert call(f"{line} {more}")[0] == 0
    assert (tmp_path / product).stat().st_size > 0


def test_a_folder_in_place_of_a_file_is_refused_before_any_work(case, call, tmp_path):
    _, line, _, _ = case
    (tmp_path / "rows").mkdir()
    before = sorted(tmp_path.rglob("*"))
    status, out, err = call(f"{line} --csv rows")
    assert (status, out) == (2, "")
    assert "Invalid file rows: a folder. Must be a file." in err.splitlines()[-1]
    assert sorted(tmp_path.rglob("*")) == before


def test_the_bar_is_for_terminals(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    for stream, seen in ((Terminal(), True), (io.StringIO(), False)):
        monkeypatch.setattr(sys, "stderr", stream)
        assert list(_output.with_progress("ab", "cloud")) == ["a", "b"]
        assert ("cloud" in stream.getvalue()) == seen


def test_no_rows_are_said_to_be_none(call):
    status, printed, _ = call("poles PATCH --method itc")
    assert status == 0
    assert printed.splitlines()[1] == "none"
    assert printed.startswith("id x_m y_m class")


def test_same_seed_same_interval(call):
    line = "lhd course.csv model.csv --json"
    texts = [call(f"{line} --seed {seed}")[1] for seed in (1, 1, 2)]
    assert texts[0] == texts[1] != texts[2]
    assert call(f"{line} --seed -1")[0] == 2
