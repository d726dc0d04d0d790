"""The command line as its users meet it: one sentence, status 2, nothing half-written."""

import json
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

from mmqa_lab import samples
from mmqa_lab.__main__ import main
from mmqa_lab.cloud import Cloud
from mmqa_lab.io import write_cloud

PATCH = str(samples.path("road_patch"))

JSON_KEYS = [
    "file",
    "n",
    "area_polygon_m2",
    "area_hull_m2",
    "density_polygon_per_m2",
    "density_hull_per_m2",
    "std_mm",
    "sigma_mad_mm",
    "d1_mm",
    "d2_mm",
    "d3_mm",
    "d4_mm",
    "f",
    "incomplete_share",
    "coincident",
    "axes",
]


def test_evaluate_prints_a_row_for_each_cloud(capsys, tmp_path):
    assert main(["evaluate", PATCH, PATCH, "--json", "--csv", str(tmp_path / "o.csv")]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [list(row) for row in rows] == [JSON_KEYS, JSON_KEYS]
    assert rows[0]["n"] == 28185
    assert rows[0]["area_polygon_m2"] is None  # no polygon was given
    assert len(pd.read_csv(tmp_path / "o.csv")) == 2


def test_evaluate_within_a_polygon_draws_its_figure(capsys, tmp_path):
    cloud = samples.path("road_patch")
    x, y, z = 1423215.6, 4189097.6, 67.88
    corners = [(x - 0.5, y - 0.5), (x + 0.5, y - 0.5), (x + 0.5, y + 0.5), (x - 0.5, y + 0.5)]
    polygon = "; ".join(f"{a},{b},{z}" for a, b in corners)
    figure = tmp_path / "f.png"
    arguments = ["evaluate", str(cloud), "--polygon", polygon, "--figure", str(figure), "--json"]
    assert main(arguments) == 0
    row = json.loads(capsys.readouterr().out)[0]
    assert row["area_polygon_m2"] == pytest.approx(1.0, rel=2e-3)  # the road is not quite level
    assert row["density_polygon_per_m2"] == pytest.approx(row["n"] / row["area_polygon_m2"])
    assert figure.read_bytes().startswith(b"\x89PNG")


def test_installed_command_and_module_are_the_same():
    done = subprocess.run(
        [sys.executable, "-m", "mmqa_lab", "--help"], capture_output=True, text=True
    )
    assert done.returncode == 0
    for command in ("evaluate", "studies", "test", "lab"):
        assert command in done.stdout


def test_every_command_explains_itself_with_an_example(capsys):
    from mmqa_lab.__main__ import parser

    commands = parser()._subparsers._group_actions[0].choices
    for name in commands:
        with pytest.raises(SystemExit) as stop:
            main([name, "--help"])
        assert stop.value.code == 0
        manual = capsys.readouterr().out
        assert f"mmqa {name}" in manual.split("example:")[1]


def bad(tmp_path):
    """Bad input of many kinds: arguments, and a part of the sentence they must get."""
    (tmp_path / "notes.md").write_text("no cloud")
    (tmp_path / "empty.xyz").write_text("")
    (tmp_path / "words.xyz").write_text("x y z\na b c\n")
    (tmp_path / "two.xyz").write_text("0 0 0\n1 0 0\n")
    (tmp_path / "line.xyz").write_text("\n".join(f"{k} {k} {k}" for k in range(9)))
    (tmp_path / "cut.laz").write_bytes(samples.path("road_patch").read_bytes()[:30_000])
    (tmp_path / "p.json").write_text("{}")
    write_cloud(tmp_path / "one.las", Cloud(np.zeros((1, 3))))
    away = "0,0,0; 1,0,0; 1,1,0"
    bow = "0,0,0; 1,1,0; 1,0,0; 0,1,0"
    return [
        ([str(tmp_path / "none.laz")], "no such file. Must exist."),
        ([str(tmp_path)], "no such file. Must exist."),
        ([str(tmp_path / "notes.md")], "Must be one of .las, .laz"),
        ([str(tmp_path / "empty.xyz")], "Must be rows of columns."),
        ([str(tmp_path / "words.xyz")], "Must be rows of numbers"),
        ([str(tmp_path / "two.xyz")], "2 given. Must be 3 or more."),
        ([str(tmp_path / "line.xyz")], "Must span a plane."),
        ([str(tmp_path / "cut.laz")], "Must be a complete LAS or LAZ file."),
        ([str(tmp_path / "one.las")], "1 given. Must be 3 or more."),
        ([PATCH, "--polygon", "none.csv"], "no such file. Must exist."),
        ([PATCH, "--polygon", "0,0,0; 1,0,0"], "Must be 3 or more."),
        ([PATCH, "--polygon", str(tmp_path / "p.json")], "Must be GeoJSON"),
        ([PATCH, "--polygon", away], "points inside the polygon: 0 given. Must be 3 or more."),
        ([PATCH, "--polygon", bow], "Must be an outline that encloses an area."),
        ([PATCH, "--polygon", away, "--thickness", "-1"], "Invalid thickness -1.0. Must be > 0 m."),
        ([PATCH, "--radius", "0"], "Invalid radius 0.0. Must be > 0 m."),
        ([PATCH, "--radius", "nan"], "Invalid radius nan. Must be"),
        ([PATCH, "--axes", "up"], "Must be principal, horizontal or degrees."),
        ([PATCH, "--axes", "inf"], "Invalid axes inf. Must be finite."),
        ([PATCH, "--figure", str(tmp_path / "f.docx")], "Must be one of .pdf, .svg, .png."),
    ]


@pytest.mark.parametrize("case", range(20))
def test_bad_input_gets_one_sentence_and_leaves_nothing(tmp_path, capsys, case):
    arguments, sentence = bad(tmp_path)[case]
    before = sorted(tmp_path.iterdir())
    outputs = ["--csv", str(tmp_path / "rows.csv")]
    if "--figure" not in arguments:
        outputs += ["--figure", str(tmp_path / "figure.pdf")]
    try:
        status = main(["evaluate", *arguments, *outputs])
    except SystemExit as stop:  # argparse leaves this way
        status = stop.code
    out, err = capsys.readouterr()
    assert status == 2
    assert out == ""
    assert sentence in err
    assert "Traceback" not in err
    assert err.strip().splitlines()[-1].startswith("mmqa evaluate")
    assert sorted(tmp_path.iterdir()) == before


def test_unknown_study_is_named(capsys):
    assert main(["studies", "nowhere"]) == 2
    assert "Invalid study 'nowhere'. Must be one of chart_tables" in capsys.readouterr().err


@pytest.mark.parametrize("word", ["ev", "evaluate --po", "lhd --mat"])
def test_shell_completes_commands_and_options(word, capsys, tmp_path):
    assert main(["completion", "bash"]) == 0
    script = tmp_path / "mmqa.bash"
    script.write_text(capsys.readouterr().out)
    words = ["mmqa", *word.split()]
    ask = f"COMP_WORDS=({' '.join(words)}); COMP_CWORD={len(words) - 1}"
    code = f'source {script}; {ask}; _shtab_mmqa; echo "${{COMPREPLY[@]}}"'
    done = subprocess.run(["bash", "-c", code], capture_output=True, text=True)
    assert done.stdout.split()[0] in ("evaluate", "--polygon", "--matcher")
    assert done.stdout.split()[0].startswith(words[-1])
