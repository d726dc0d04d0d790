"""The command line as its users meet it: one sentence, status 2, nothing half-written."""

import json
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pandas as pd
import pytest

from mmqa_lab import __version__, samples
from mmqa_lab.__main__ import COMPILED, main

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
    "f_exempt",
    "incomplete_share",
    "coincident",
    "axes",
    "remarks",
]


def test_info_says_what_a_file_contains_and_cannot_tell(capsys):
    assert main(["info", PATCH, "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert (row["points"], row["resolution_mm"], row["coincident"]) == (28185, 10, 16881)
    assert row["time_span_s"] > row["time_longest_pause_s"] > 0
    assert row["crs"] == ""
    assert "No coordinate system" in row["remarks"]
    assert "No time" not in row["remarks"]
    assert main(["info", PATCH]) == 0
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) < 100
    assert f"{row['x_low_m']:.2f}" in printed  # to centimetres: figures enough to find the place
    assert main(["info", PATCH, str(samples.path("chart_a_5m"))]) == 0
    assert max(map(len, capsys.readouterr().out.splitlines())) < 150  # side by side, not 230


def test_the_first_call_says_that_it_compiles(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    for said in (True, False):
        assert main(["poles", "nowhere.laz"]) == 2
        assert ("compiles its searches, once" in capsys.readouterr().err) == said
        (tmp_path / "features._seen-66.py311.nbi").touch()
    for room, module in zip(("planes", "spacing", "poles"), COMPILED.values(), strict=True):
        assert "njit" in Path(find_spec(f"mmqa_lab.{room}.{module}").origin).read_text()


def test_evaluate_prints_a_row_for_each_cloud(capsys, tmp_path):
    assert main(["evaluate", PATCH, PATCH, "--json", "--csv", str(tmp_path / "o.csv")]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [list(row) for row in rows] == [JSON_KEYS, JSON_KEYS]
    assert rows[0]["n"] == 28185
    assert rows[0]["area_polygon_m2"] is None  # no polygon was given
    assert len(pd.read_csv(tmp_path / "o.csv")) == 2


def test_evaluate_gives_intervals_and_the_exemption_of_f(capsys):
    assert main(["evaluate", PATCH, "--rho0", "1000", "--json"]) == 0
    row = json.loads(capsys.readouterr().out)[0]
    assert row["f_exempt"] is True  # d4 is 22.4 mm, sqrt(1 / 1000) = 31.6 mm
    assert main(["evaluate", PATCH, "--intervals", "--json"]) == 0
    rows = {row["figure"]: row for row in json.loads(capsys.readouterr().out)}
    assert rows["f"]["value"] == row["f"]
    assert rows["density"]["low"] < row["density_hull_per_m2"] < rows["density"]["high"]


def test_evaluate_takes_other_sectors_statistics_and_each_place_once(capsys):
    choices = ["--sectors", "8", "--statistic", "90", "--distinct"]
    assert main(["evaluate", PATCH, *choices, "--json"]) == 0
    row = json.loads(capsys.readouterr().out)[0]
    assert row["n"] == 28185 - 16881 + 7031  # places of several points
    assert row["coincident"] == 0
    assert row["f"] == pytest.approx(row["d8_mm"] / row["d1_mm"])
    assert "90 % quantiles" in row["remarks"]
    assert main(["evaluate", PATCH, "--sectors", "three"]) == 2
    assert "Invalid sectors 'three'" in capsys.readouterr().err


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
    assert f"mmqa_lab {__version__}".encode() in figure.read_bytes()


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
        assert f"mmqa {name}" in re.split("examples?:", manual)[1]


def test_an_unknown_option_shows_the_usage_of_its_command(capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["evaluate", PATCH, "--sector-count", "8"])
    assert "usage: mmqa evaluate" in capsys.readouterr().err


def test_a_folder_in_place_of_a_cloud_is_named(capsys, tmp_path):
    assert main(["info", str(tmp_path)]) == 2
    assert "a folder. Must be a file." in capsys.readouterr().err


def test_a_polygon_in_plan_can_be_written_in_the_command(capsys):
    x, y = 1423215.6, 4189097.6
    plan = f"{x},{y}; {x + 0.5},{y}; {x + 0.5},{y + 0.5}; {x},{y + 0.5}"
    assert main(["evaluate", PATCH, "--polygon", plan, "--json"]) == 0
    row = json.loads(capsys.readouterr().out)[0]
    assert row["area_polygon_m2"] == pytest.approx(0.25, rel=5e-3)  # the road slopes a little
    assert "The polygon has no heights" in row["remarks"]


def test_lab_asks_nobody_about_news(monkeypatch):
    from jupyter_server.services.config.manager import ConfigManager

    called = {}
    monkeypatch.setattr(subprocess, "call", lambda command, **choices: called.update(choices) or 0)
    assert main(["lab"]) == 0
    monkeypatch.setenv("JUPYTER_CONFIG_PATH", called["env"]["JUPYTER_CONFIG_PATH"])
    settings = ConfigManager(config_dir_name="labconfig").get("default_setting_overrides")
    assert settings["@jupyterlab/apputils-extension:notification"] == {"fetchNews": "false"}


def test_unknown_study_is_named(capsys):
    assert main(["studies", "nowhere"]) == 2
    assert "Invalid study 'nowhere'. Must be one of chart_tables" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("word", "whole"),
    [
        ("ev", "evaluate"),
        ("evaluate --po", "--polygon"),
        ("lhd --mat", "--matcher"),
        ("studies poles an", "anisotropy"),
        ("bench mi", "mimic"),
        ("student course test", "test_field"),
    ],
)
def test_shell_completes_commands_options_and_studies(word, whole, capsys, tmp_path):
    assert main(["completion", "bash"]) == 0
    script = tmp_path / "mmqa.bash"
    script.write_text(capsys.readouterr().out)
    words = ["mmqa", *word.split()]
    ask = f"COMP_WORDS=({' '.join(words)}); COMP_CWORD={len(words) - 1}"
    code = f'source {script}; {ask}; _shtab_mmqa; echo "${{COMPREPLY[@]}}"'
    done = subprocess.run(["bash", "-c", code], capture_output=True, text=True)
    assert done.stdout.split()[0] == whole
