"""No file of a user's is lost: outputs that are inputs, outputs in one file, other kinds."""

import hashlib
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmqa_lab import boresight, io, maps, samples
from mmqa_lab.cloud import Cloud
from mmqa_lab.commands import run
from mmqa_lab.maps import campaign

OTHERS = {
    "my_survey.xyz": b"0 0 0\n1 0 0\n",
    "0_0.xyz": b"0 0 0\n",
    "run.json": b'{"mine": 1}',
    "tile_0_0.nc": b"CDF mine",
    "tile_0_0.npy": b"mine",
    "points.mmqa_points.txt": b"mine",
    "notes.docx": b"PK\x03\x04",
    "photo.jpg": b"\xff\xd8\xff\xd9",
}


# Files of the names that commands write into a folder, and what stands for them.
NAMES = [
    "index.html", "glossary.html", "api.html", "ledger.html", "notebook.css", "05_mimic.html",
    "thumbnails/05_mimic.png", "mimic/run.json", "mimic/.my.cfg", "mimic/mimic.html",
    "summary.csv", "results.csv", "cells.csv", "failures.csv", "methods.pdf", "methods.png",
    "1_street.laz", "1_own.laz", "05_mimic.ipynb", "05_mimic_solutions.html",
    "mmqa_map/run.json", "mmqa_map/a.mmqa_points", "mmqa_map/.tile_0_0.npy",
]  # fmt: skip

OF_FOLDERS = [
    "bench lhd_weight --quick --out", "calibrate street.laz --trajectory path.csv --out",
    "studies mimic --quick --out", "studies mimic --site", "student copies mimic --sheets",
]  # fmt: skip


def grid(n=40, step=0.05):
    """Points of a square, m."""
    x, y = np.meshgrid(np.arange(n) * step, np.arange(n) * step)
    return np.stack([x.ravel(), y.ravel(), 0.001 * (np.arange(n * n) % 7)], axis=1)


def hashes(folder):
    """The hash of each file below a folder."""
    files = (file for file in Path(folder).rglob("*") if file.is_file())
    return {file: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


@pytest.fixture
def full(tmp_path, monkeypatch):
    """A working folder full of other people's files, a cloud among them."""
    for name, content in OTHERS.items():
        (tmp_path / name).write_bytes(content)
    table = pd.DataFrame(grid(), columns=list("xyz"))
    table.to_csv(tmp_path / "own.csv", index=False)
    io.write_cloud(tmp_path / "street.laz", Cloud(grid()))
    (tmp_path / "sub").mkdir()
    monkeypatch.chdir(tmp_path)
    return tmp_path


SPELLINGS = {
    "absolute": lambda path: path.absolute(),
    "dotted": lambda path: Path(f"./{path}"),
    "upwards": lambda path: Path("sub") / ".." / path,
    "symbolic": lambda path: link(path, os.symlink),
    "hard": lambda path: link(path, os.link),
}


def link(path, make):
    """Another name of a file."""
    other = Path(f"other_name{path.suffix}")
    make(path, other)
    return other


@pytest.mark.parametrize("spelling", SPELLINGS)
@pytest.mark.parametrize("command", [
    "evaluate own.csv --csv {}", "info own.csv street.laz --csv {}", "lhd own.csv --csv {}",
    "evaluate street.laz --polygon ./own.csv --csv {}", "accuracy street.laz own.csv --out {}",
    "poles street.laz --reference own.csv --csv {}", "tender own.csv own.csv --csv {}",
    "map own.csv --out m.nc --csv {}",
])  # fmt: skip
def test_an_output_that_is_an_input_is_refused_however_it_is_spelt(full, capsys, command, spelling):
    other = SPELLINGS[spelling](Path("own.csv"))
    before = hashes(full)
    assert run(command.format(other).split()) == 2
    assert "it is an input. Must be another file." in capsys.readouterr().err
    assert hashes(full) == before


def test_two_outputs_are_two_files(full, capsys):
    before = hashes(full)
    assert run(["accuracy", "street.laz", "own.csv", "--out", "a.csv", "--csv", "./a.csv"]) == 2
    assert "given twice. Must be another file." in capsys.readouterr().err
    assert hashes(full) == before


@pytest.mark.parametrize(("words", "sentence"), [
    ("evaluate own.csv --csv sub", "Must end in .csv."),
    ("evaluate own.csv --csv table.csv", "no .csv file is there. Must be another name."),
    ("evaluate own.csv --out figure.png", "no .png file is there. Must be another name."),
    ("evaluate own.csv --report page.html", "no .html file is there. Must be another name."),
    ("map own.csv --out m.nc", "no .nc file is there. Must be another name."),
    ("map own.csv --out m.tif", "no .tif file is there. Must be another name."),
    ("chart --out chart.pdf", "no .pdf file is there. Must be another name."),
    ("accuracy street.laz own.csv --out street.laz", "it is an input."),
    ("map own.csv --out missing/m.nc", "no folder missing. Must exist."),
    ("evaluate own.csv --out missing/f.png", "no folder missing. Must exist."),
    ("map own.csv --out map", "Must end in .nc, .tif."),
    ("map own.csv --out photo.jpg", "a file of another kind is there."),
])  # fmt: skip
def test_files_of_other_kinds_stay_and_wrong_paths_make_no_folder(full, capsys, words, sentence):
    for name in ("table.csv", "figure.png", "page.html", "m.nc", "m.tif", "chart.pdf"):
        (full / name).write_bytes(b"LASF\0 a cloud that was named by mistake")
    before = hashes(full)
    assert run(words.split()) == 2
    assert sentence in capsys.readouterr().err
    assert hashes(full) == before
    assert not (full / "missing").exists()
    assert not (full / "m.run").exists()


def test_functions_do_not_replace_files_of_another_kind(full):
    (full / "m.nc").write_bytes(b"not a map")
    with pytest.raises(ValueError, match=r"no \.nc file is there"):
        maps.write_map(full / "m.nc", maps.map_cloud(grid()))
    (full / "c.laz").write_bytes(b"x,y,z\n")
    with pytest.raises(ValueError, match=r"no \.laz file is there"):
        io.write_cloud(full / "c.laz", grid())
    assert (full / "m.nc").read_bytes() == b"not a map"
    assert (full / "c.laz").read_bytes() == b"x,y,z\n"


def test_files_of_its_own_kind_are_replaced(full):
    for _ in range(2):
        words = "evaluate street.laz --csv t.csv --report t.html --out t.png"
        assert run(words.split()) == 0


def test_corrected_clouds_do_not_replace_the_drives(full, monkeypatch, capsys):
    monkeypatch.setattr(boresight, "calibrate", lambda *_, **__: pytest.fail("worked first"))
    Path("street.laz").rename("1_a.laz")
    os.link("1_a.laz", "a.laz")
    before = hashes(full)
    assert run(["calibrate", "a.laz", "--trajectory", "own.csv", "--out", "."]) == 2
    assert "it is an input" in capsys.readouterr().err
    assert hashes(full) == before


@pytest.fixture
def taken(full):
    """A full folder in which each name that a command uses is taken."""
    for name in NAMES:
        (full / name).parent.mkdir(exist_ok=True)
        (full / name).write_bytes(b"LASF" if ".laz" in name else b'{"files": ["my.laz"]}')
    (full / "mimic" / "my.laz").write_bytes(b"mine")
    (full / "path.csv").write_text("time,x,y,z\n0,0,0,0\n1,1,1,1\n")
    return full


@pytest.mark.parametrize("line", [*OF_FOLDERS, "student", "student copies mimic --checks"])
def test_a_folder_of_other_files_is_refused_before_any_work(taken, capsys, line):
    before = hashes(taken)
    assert run([*line.split(), "."]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "in it is not from mmqa. Must be new" in said or "it contains" in said
    assert {file: hashes(taken)[file] for file in before} == before


@pytest.mark.parametrize(("record", "sentence"), [(True, "other files"), (False, "not from mmqa")])
def test_a_campaign_leaves_a_folder_of_its_name(taken, record, sentence):
    if not record:
        (taken / "mmqa_map" / "run.json").unlink()
    before = hashes(taken)
    with pytest.raises(ValueError, match=sentence):
        maps.map_campaign([taken / "street.laz"], taken)
    assert hashes(taken) == before


@settings(deadline=None)
@given(name=st.sampled_from(NAMES), deep=st.booleans())
def test_any_file_of_another_keeps_a_folder(name, deep):
    with tempfile.TemporaryDirectory() as place:
        other = Path(place) / ("sub" if deep else "") / name
        other.parent.mkdir(parents=True, exist_ok=True)
        other.write_text("mine")
        with pytest.raises(ValueError, match="not from mmqa"), io.own_folder(place):
            pytest.fail("opened")
        assert [path for path in Path(place).rglob("*") if path.is_file()] == [other]


def test_a_folder_of_an_earlier_run_is_used_again_and_a_mistake_leaves_none(tmp_path):
    for content in "ab":
        with io.own_folder(tmp_path / "results") as folder:
            io.write_atomically(folder / "f.csv", content)
    assert (folder / "f.csv").read_text() == "b"
    with pytest.raises(KeyError), io.own_folder(tmp_path / "none"):
        raise KeyError
    assert [path.name for path in tmp_path.iterdir()] == ["results"]


HOLDING = """
import sys
from mmqa_lab import io
with io.own_folder(sys.argv[1]), io.own_folder(sys.argv[2]):
    print(flush=True)
    sys.stdin.read()
"""


def test_two_runs_into_one_folder_are_refused_until_the_first_has_ended(full, capsys):
    call = [sys.executable, "-c", HOLDING, full / "out", full / "m.run" / campaign.OWN]
    with subprocess.Popen(call, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        other.stdout.readline()
        for line in [*(f"{line} out" for line in OF_FOLDERS), "map own.csv --out m.nc"]:
            assert run(line.split()) == 2
            said = capsys.readouterr().err
            assert "another run writes into it. Must be another one." in said
        other.kill()
    assert run(["map", "own.csv", "--out", "m.nc"]) == 0
    with io.own_folder(full / "out"):
        pass


@pytest.mark.parametrize("clouds", [["street.laz"], ["my_survey.xyz"], ["."]])
def test_a_campaign_leaves_a_full_folder_as_it_is(full, clouds):
    before = hashes(full)
    maps.map_campaign([full / one for one in clouds], full)
    assert maps.open_map(full)["n"].sum() > 0
    maps.map_campaign([full / one for one in clouds], full)
    assert {file: hashes(full)[file] for file in before} == before


def test_every_command_leaves_a_full_folder_as_it_is(full):
    patch = str(samples.path("road_patch"))
    before = hashes(full)
    words = [
        "info street.laz own.csv", "evaluate street.laz --csv e.csv --out e.pdf --report e.html",
        "map street.laz my_survey.xyz --out m.nc", "pattern street.laz", "lhd own.csv",
        "poles street.laz", "accuracy street.laz own.csv --out a.csv", "chart --out c.svg",
        "image photo.jpg", "tender own.csv own.csv", f"map {patch} . --out street.nc",
    ]  # fmt: skip
    for line in words:
        run(line.split())
    assert {file: hashes(full)[file] for file in before} == before
