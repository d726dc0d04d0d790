"""What a run of a study leaves behind."""

import hashlib
import json
import re
from datetime import datetime

import matplotlib.pyplot as plt
import nbformat
import numpy as np
import pandas as pd
import pytest
from conftest import spoiled
from matplotlib.figure import Figure
from overlaps import overlapping_texts
from PIL import Image

from mmqa_lab import plots
from mmqa_lab.published import ledger
from mmqa_lab.run import (
    Run,
    notebooks,
    pages,
    parameter_names,
    read_record,
    verdict,
    write_record,
)
from mmqa_lab.studies import STUDIES


@pytest.fixture
def run(tmp_path, monkeypatch):
    """A run that writes to a temporary folder."""
    monkeypatch.setenv("MMQA_RESULTS", str(tmp_path))
    return Run("example", parameters={})


def test_the_record_is_written_with_every_file(run):
    run.save_table(pd.DataFrame({"f": [3.257], "kind": ["predicted"]}), "table")
    assert read_record(run.folder)["files"] == ["table.csv", "table.tex"]
    run.save_value("f_2_of_a", 3.257, "1", "predicted")
    run.check("f exceeds 2", True, "3.257", "closed form")
    record = read_record(run.folder)
    assert record["failure"] == "running, or stopped before its end"
    run.finish()
    record = read_record(run.folder)
    assert record["failure"] == ""
    assert record["parameters"] == {}
    assert record["files"] == [
        "table.csv", "table.tex", "values.csv", "values.tex", "values.typ", "checks.csv",
    ]  # fmt: skip
    assert verdict(record) == "1 of 1 checks passed"
    assert record["versions"]["numpy"] == np.__version__
    assert pd.read_csv(run.folder / "values.csv")["value"].item() == 3.257
    number, commit = (run.folder / "values.tex").read_text().splitlines()
    assert number == "\\newcommand{\\mmqaExampleFTwoOfA}{3.257} % 1, predicted"
    assert commit.startswith("\\newcommand{\\mmqaExampleCodeCommit}{")


def test_runs_by_hand_on_other_files_or_in_other_notebooks_do_not_meet(tmp_path, monkeypatch):
    monkeypatch.delenv("MMQA_RESULTS", raising=False)
    monkeypatch.chdir(tmp_path)
    folders = []
    for session in ("one.ipynb", "copy.ipynb"):
        monkeypatch.setenv("JPY_SESSION_NAME", session)
        for files in (["a/wall.laz"], ["b/wall.laz"], ["a/wall.laz", "b/wall.laz"], []):
            made = [Run("cloud", parameters={}, files=files).folder for _ in range(2)]
            assert made[0] == made[1]  # the same again replaces its own results
            folders.append(made[0])
    assert len(set(folders)) == 7  # without files the study's own folder
    assert sum(folder.name.startswith("wall_") for folder in folders) == 6
    monkeypatch.setenv("MMQA_RESULTS", str(tmp_path))
    assert Run("cloud", parameters={}, files=["a/wall.laz"]).folder == tmp_path / "cloud"


def test_parameters_are_those_of_the_notebooks_cell(tmp_path, monkeypatch):
    monkeypatch.setenv("MMQA_RESULTS", str(tmp_path / "results"))
    monkeypatch.chdir(tmp_path)
    source = "a, b = range(3), 2  # two\nc = np.float64(0.5)\nd: int = 4"
    cells = [
        {"cell_type": "code", "metadata": {}, "source": "x = 1"},
        {"cell_type": "code", "metadata": {"tags": ["parameters"]}, "source": [source]},
    ]
    (tmp_path / "09_mine.ipynb").write_text(json.dumps({"cells": cells}))
    values = {"a": range(3), "b": 5, "c": np.float64(0.5), "d": {"x": 2}, "other": 7}
    run = Run("mine", parameters=values)
    recorded = read_record(run.folder)["parameters"]
    assert recorded == {"a": "range(0, 3)", "b": 5, "c": 0.5, "d": {"x": 2}}


@pytest.mark.parametrize("study", STUDIES, ids=lambda study: study.stem)
def test_small_parameters_replace_delivered_ones(study):
    assert set(study.quick) <= set(parameter_names(study.path))


@pytest.mark.parametrize("study", STUDIES, ids=lambda study: study.stem)
def test_the_middle_size_has_a_quarter_of_the_cases_or_more(study):
    notebook = nbformat.read(study.path, as_version=4)
    (cell,) = (c for c in notebook.cells if "parameters" in c.metadata.get("tags", []))
    full = {}
    exec(cell.source, full)  # what the notebook delivers
    for name, value in study.middle.items():
        large, small = (one if np.isscalar(one) else len(one) for one in (full[name], value))
        assert large / 4 <= small < large, name  # an interval is at most twice as wide


@pytest.mark.parametrize(
    ("frame", "kind", "columns"),
    [
        ({"f": [2.0]}, "measured (simulated)", ["f", "kind"]),
        ({"f": [2.0], "kind": ["upright"]}, "fitted", ["f", "kind", "kind_of_number"]),
        ({"f_measured": [2.0], "f_predicted": [2.1]}, "", ["f_measured", "f_predicted"]),
        ({"f": [2.0, 3.0], "kind": ["published", "fitted"]}, "", ["f", "kind"]),
        ({"symbol": ["f"], "meaning": ["inhomogeneity"]}, "", ["symbol", "meaning"]),
    ],
)
def test_a_table_says_of_which_kind_its_numbers_are(run, frame, kind, columns):
    run.save_table(pd.DataFrame(frame), "table", kind=kind)
    assert list(pd.read_csv(run.folder / "table.csv")) == columns


@pytest.mark.parametrize(
    ("frame", "kind"),
    [({"f": [2.0]}, ""), ({"f": [2.0]}, "true"), ({"f": [2.0] * 2, "kind": ["fitted", ""]}, "")],
)
def test_a_table_of_an_unknown_kind_is_refused(run, frame, kind):
    with pytest.raises(ValueError, match=r"Invalid table table: numbers of no kind.*one of publ"):
        run.save_table(pd.DataFrame(frame), "table", kind=kind)
    assert not (run.folder / "table.csv").exists()


def test_checks_report_and_never_raise(run, capsys):
    run.check("f is above 1", np.True_, "3.257", "")
    run.check("f is below 2", False, "3.257", "")
    assert "Check FAILED: f is below 2 Found 3.257 (" in capsys.readouterr().out
    assert pd.read_csv(run.folder / "checks.csv")["passed"].tolist() == [True, False]
    run.check("f is above 1", False, "2", "the same words again replace the first")
    assert verdict(read_record(run.folder)) == "running, or stopped before its end"
    run.finish()
    assert verdict(read_record(run.folder)) == "0 of 2 checks passed"


def test_a_check_that_compares_with_print_reads_the_ledger(run):
    rows = [
        {"cell": "A 5 m d1", "value": 4.2, "low": 3.9, "high": 4.5, "kind": "measured"},
        {"cell": "A 5 m d4", "value": 99.0, "low": 98.0, "high": 99.5, "kind": "fitted"},
    ]
    run.save_ledger(ledger.entries(rows, source="pfeifer2021", table="table_2"))
    assert run.agrees("pfeifer2021 table_2 A 5 m d1")
    assert not run.agrees("pfeifer2021 table_2 A 5 m d1", "pfeifer2021 table_2 A 5 m d4")
    with pytest.raises(KeyError, match="A 9 m d1"):
        run.agrees("pfeifer2021 table_2 A 9 m d1")


def test_latex_has_signs_that_its_fonts_have(run):
    run.save_table(pd.DataFrame({"rule": ["f ≥ 2 → 3"], "kind": ["predicted"]}), "rules")
    text = (run.folder / "rules.tex").read_text(encoding="utf-8")
    assert r"$f$ $\geq$ 2 $\to$ 3" in text
    assert text.isascii()


def test_an_answer_is_made_of_values_that_a_paper_can_quote(run):
    run.save_answer(
        "At 5 m {speed_kmh:.0f} km/h.", figure="speeds", kind="predicted", speed_kmh=54.2
    )
    answer = read_record(run.folder)["answer"]
    assert answer["sentence"] == "At 5 m 54 km/h."
    assert answer["thumbnail"] == "speeds"
    assert answer["kind"] == "predicted"
    assert pd.read_csv(run.folder / "values.csv").values.tolist() == [
        ["speed_kmh", 54.2, "km/h", "predicted"]
    ]
    assert "mmqaExampleSpeedKmh}{54}" in (run.folder / "values.tex").read_text()


def test_what_is_saved_again_leaves_nothing_of_before(run):
    run.save_table(pd.DataFrame({"f": [3.257], "kind": ["predicted"]}), "planes")
    run.save_table(pd.DataFrame({"f": range(99), "kind": "measured"}), "planes")
    assert not (run.folder / "planes.tex").exists()
    assert read_record(run.folder)["files"] == ["planes.csv"]
    again = Run("example", parameters={})
    assert not (again.folder / "planes.csv").exists()


@plots.style()
def test_figures_are_equal_to_the_byte(run):
    contents = []
    for _ in range(2):
        figure, ax = plots.subplots(height_mm=40)
        plots.draw_points([[0, 0], [1, 1], [2, 0]], ax=ax)
        run.save_figure(figure, "points", seen="Three points.")
        plt.close(figure)
        contents.append([(run.folder / f"points.{e}").read_bytes() for e in ("pdf", "svg", "png")])
    assert contents[0] == contents[1]


@plots.style()
@pytest.mark.parametrize("size", ["quick", "middle"])
def test_a_run_that_is_not_full_writes_a_png_for_the_screen(run, size):
    write_record(run.folder, read_record(run.folder) | {"size": size})
    figure, _ = plots.subplots(width="double", height_mm=40)
    again = Run("example", parameters={})
    again.save_figure(figure, "points", seen="Nothing.")
    plt.close(figure)
    assert {path.suffix for path in again.folder.glob("points.*")} == {".png", ".csv"}
    picture = Image.open(again.folder / "points.png")
    assert picture.size[0] == pytest.approx(178 / 25.4 * 150, abs=1)  # more than a page shows
    assert picture.text["Title"] == "Nothing."


def drawn():
    """A figure with a legend and a title, drawn."""
    figure, ax = plots.subplots(height_mm=40)
    ax.plot([0.1, 1], [0, 1], label="a line")
    ax.set(xlabel="range (m)", ylabel="error (mm)", title="plain")
    ax.legend()
    figure.canvas.draw()
    return figure, ax


def test_a_figure_has_its_data_a_caption_and_a_licence(run):
    figure, ax = drawn()
    ax.set_ylabel(r"$\sigma_\mathrm{MAD}$ (mm)")
    data = pd.DataFrame({"range_m": [0.1, 1], "error_mm": [0, 1]})
    run.save_figure(figure, "errors", data=data, seen="Errors.")
    run.save_table(pd.DataFrame({"f": [2.0]}), "again", kind="measured")
    run.save_figure(figure, "again", seen="One rising line.")
    plt.close(figure)
    assert list(pd.read_csv(run.folder / "again.csv")) == ["f", "kind"]  # is its data
    assert list(pd.read_csv(run.folder / "errors.csv")) == ["range_m", "error_mm"]
    captions = pd.read_csv(run.folder / "captions.csv").set_index("figure")
    assert captions["caption"].to_dict() == {
        "errors": "Errors.",
        "again": "One rising line. Numbers: measured.",
    }
    assert (captions["licence"] == "CC BY 4.0").all()


def test_a_notebook_shows_captions_and_letters_and_its_page_has_solutions_of_what_is_folded(
    tmp_path,
):
    cells = [
        "%matplotlib inline\nfrom mmqa_lab import plots\nfrom mmqa_lab.run import Run\n"
        "run = Run('shown', parameters=globals())",
        "figure, axes = plots.subplots(1, 2)",
        "print([ax.texts[0].get_text() for ax in axes])\n"
        "run.save_figure(figure, 'two', kind='predicted', seen='Two panels.')",
        "drawn = axes[0].fill([0, 1, 1], [0, 0, 1])",
        "solved = 1 + 1",
    ]
    notebook = nbformat.v4.new_notebook(cells=[*map(nbformat.v4.new_code_cell, cells)])
    for number, tags in ((2, ["results"]), (3, []), (4, ["solution"])):
        notebook.cells[number].metadata |= {"tags": tags, "jupyter": {"source_hidden": True}}
    assert notebooks.execute(notebook, tmp_path, results=tmp_path) == ""
    letters, caption = notebook.cells[2].outputs
    assert letters["text"] == "['(a)', '(b)']\n"  # the picture above has them, too
    assert caption["data"]["text/markdown"].endswith("Two panels. Numbers: predicted.")
    page = pages.notebook_page(notebook, "Shown")
    assert "Two panels." in page
    assert "save_figure" not in page
    assert "drawn" not in page
    assert "subplots" in page
    assert "solved" in page


def test_a_figure_is_laid_out_once_and_its_many_points_are_pixels(run, monkeypatch):
    drawn, draw = [], Figure.draw
    monkeypatch.setattr(Figure, "draw", lambda *given: drawn.append(1) or draw(*given))
    with plt.rc_context({"figure.constrained_layout.use": True}):
        figure, ax = plt.subplots()
        places = np.random.default_rng(1).random((3, 2, 6000))
        ax.plot(*places[0], "k.", gid="line")
        ax.scatter(*places[1], gid="dots")
        ax.scatter(*places[2, :, :5], gid="few")
        run.save_figure(figure, "points", kind="measured", seen="Points.")
    assert len(drawn) == 4  # the layout, and each of three formats
    svg = (run.folder / "points.svg").read_text()
    assert "<image" in svg
    assert svg.count("<use") < 100
    assert 'id="few"' in svg


def test_a_figure_leaves_what_it_draws_under_its_name(run):
    figure, axes = plt.subplots(1, 2)
    axes[0].plot([1, 2, 3], [4, np.nan, 6], label="rising")
    axes[0].scatter([7, 8], [9, 10], label="dots")
    axes[1].bar([0, 1], [5, 2])
    axes[1].set(xlabel="group", ylabel="f")
    run.save_figure(figure, "drawn", kind="measured", seen="Points.")
    axes[1].hist([1.0, 2.0], histtype="stepfilled", label="steps")
    run.save_figure(figure, "drawn", kind="measured", seen="Points.")
    table = pd.read_csv(run.folder / "drawn.csv")
    rising = table.query("label == 'rising'")[["x", "y"]].to_numpy()
    np.testing.assert_array_equal(rising, [[1, 4], [2, np.nan], [3, 6]])
    assert table.query("label == 'dots'")["y"].tolist() == [9, 10]
    bars = table.query("panel == 2 and label.isna()")
    assert bars["y"].tolist() == [5, 2]
    assert set(bars["y_label"]) == {"$f$"}
    assert set(table["kind"]) == {"measured"}
    run.save_table(pd.DataFrame({"f": [1.0]}), "drawn", kind="predicted")
    run.save_figure(figure, "drawn", seen="Points.")
    assert pd.read_csv(run.folder / "drawn.csv").columns.tolist() == ["f", "kind"]
    plt.close(figure)


def test_tables_are_written_for_latex(run):
    frame = pd.DataFrame({"area_polygon_m2": [0.56, np.nan], "what": ["50 %", "a_b & f"]})
    frame = frame.assign(error_percent=[0.0, 5.0], p=[0.2, 3e-73], n=[28901.0, 2])
    run.save_table(frame, "table", kind="measured")
    text = (run.folder / "table.tex").read_text()
    parts = ("\\toprule", "area polygon (m²)", "error (\\%)", "& 0 &", "28901 \\\\", "0.56 &")
    parts += ("-- &", "3e-73", "50 \\%", "a\\_b \\& $f$", "\\caption{Table. Numbers: measured.}")
    assert [part for part in parts if part not in text] == []
    body = text.partition("\\toprule")[2]
    assert "kind" not in body  # it is in the caption
    assert "measured" not in body
    assert text.count("{") == text.count("}")
    assert text.count("\\begin") == text.count("\\end")
    assert text.index("\\resizebox") < text.index("\\begin{tabular}")  # no wider than the text
    mixed = frame.assign(kind=["measured", "predicted"])
    run.save_table(mixed, "mixed")
    text = (run.folder / "mixed.tex").read_text()
    assert "predicted" in text.partition("\\toprule")[2]  # each row says its own
    run.save_table(pd.concat([frame] * 40), "long", kind="measured")
    assert not (run.folder / "long.tex").exists()


@pytest.mark.parametrize(
    ("kind", "data", "said"),
    [
        ("predicted", None, "predicted"),
        ("", {"f_measured": [1.0]}, "measured"),
        ("", {"f": [1.0, 2.0], "kind": ["published", "fitted"]}, "published, fitted"),
        ("measured", {"f_predicted": [1.0]}, "measured"),
    ],
)
def test_a_figure_says_the_kind_of_its_numbers(run, kind, data, said):
    figure, ax = drawn()
    high = ax.get_position().height * figure.get_figheight()
    data = None if data is None else pd.DataFrame(data)
    run.save_figure(figure, "kinds", kind=kind, data=data, seen="A line.")
    assert figure.get_supxlabel() == said
    assert ax.get_position().height * figure.get_figheight() > 0.99 * high
    plt.close(figure)


@plots.style()
def test_files_embed_fonts_as_truetype(run):
    figure, _ = drawn()
    run.save_figure(figure, "named", seen="A line.")
    plt.close(figure)
    pdf = (run.folder / "named.pdf").read_bytes()
    assert b"/FontFile2" in pdf
    assert b"/Type3" not in pdf


@plots.style()
def test_texts_on_each_other_or_outside_are_named():
    figure, ax = drawn()
    assert overlapping_texts(figure) == []
    ax.text(0.2, 0.5, "first")
    ax.text(0.22, 0.5, "second")
    figure.text(0.9, 0.6, "a text that runs over the edge", in_layout=False)
    found = overlapping_texts(figure)
    plt.close(figure)
    assert sorted(found) == [
        "'a text that runs over the edge' leaves the figure",
        "'first' and 'second' overlap",
    ]


@pytest.mark.filterwarnings("ignore:Fonts not installed")
@pytest.mark.parametrize("journal", plots.JOURNALS)
def test_files_have_the_width_that_the_journal_asks_for(journal, tmp_path):
    with plots.style(journal):
        figure, _ = plots.subplots(width="double")
        figure.savefig(tmp_path / "page.pdf")
    plt.close(figure)
    box = re.search(rb"/MediaBox \[ ?([^\]]+)\]", (tmp_path / "page.pdf").read_bytes())
    points = float(box.group(1).split()[2])
    wanted = plots.JOURNALS[journal]["widths_mm"][1]
    assert points / 72 * 25.4 == pytest.approx(wanted, abs=0.1)  # a third of a point


@pytest.mark.filterwarnings("ignore:Fonts not installed")
def test_a_style_leaves_everything_as_it_was():
    @plots.style("elsevier")
    def interrupted():
        assert plt.rcParams["font.size"] == 7
        raise KeyError

    before = dict(plt.rcParams)
    with pytest.raises(KeyError):
        interrupted()
    assert dict(plt.rcParams) == before
    figure, _ = plots.subplots()
    assert figure.get_figwidth() * 25.4 == pytest.approx(85)
    plt.close(figure)


NOTEBOOK = """import numpy as np
table = run.table()
run.check("the mean is 2", np.mean(values) == 2, f"{np.mean(values)}", "by hand")
run.check("it is known", unknown, "", "")
run.check("the mean is above 1", np.mean(values) > 1, "", "")"""


def test_checks_of_a_notebook_fail_on_spoiled_names(tmp_path):
    cells = [nbformat.v4.new_markdown_cell("# One"), nbformat.v4.new_code_cell(NOTEBOOK)]
    nbformat.write(nbformat.v4.new_notebook(cells=cells), tmp_path / "one.ipynb")
    assert spoiled(tmp_path / "one.ipynb", {"values": [1, 3]}) == []
    assert spoiled(tmp_path / "one.ipynb", {"values": [1, 4]}) == ["the mean is 2"]


def test_a_run_deletes_nothing_but_its_own_files(tmp_path, monkeypatch):
    monkeypatch.setenv("MMQA_RESULTS", str(tmp_path / "results"))
    thesis, folder = tmp_path / "thesis.txt", tmp_path / "results" / "example"
    (folder / ".cache.d").mkdir(parents=True)
    left = folder / f".table.{16 * 'a'}.csv"
    for file in (thesis, folder / ".notes.txt", left, folder / "old.csv"):
        file.write_text("kept")
    files = ["../../thesis.txt", str(thesis), ".cache.d", "old.csv"]
    write_record(folder, {"files": files})
    Run("example", parameters={})
    inside = {path.name for path in folder.iterdir()}
    assert inside == {".cache.d", ".notes.txt", "run.json"}
    assert thesis.is_file()
    for damaged in ("", '{"files": [', "[]"):
        (folder / "run.json").write_text(damaged)
        assert read_record(folder) == {}
        Run("example", parameters={})


def test_names_of_an_index_are_written_and_odd_names_refused(run):
    frame = pd.DataFrame({"method": ["b", "a"], "f": [2.0, 1.0]}).groupby("method").mean()
    run.save_table(frame, "means", kind="measured")
    assert pd.read_csv(run.folder / "means.csv")["method"].tolist() == ["a", "b"]
    assert "method" in (run.folder / "means.tex").read_text()
    for name in ("50% & more#1", "a/b", ""):
        with pytest.raises(ValueError, match="Invalid name"):
            run.save_table(frame, name, kind="measured")


def test_parameters_come_from_the_notebook_of_that_name(tmp_path, monkeypatch):
    monkeypatch.setenv("MMQA_RESULTS", str(tmp_path / "results"))
    monkeypatch.chdir(tmp_path)
    for name in ("03_other_poles_test", "06_poles", "06_poles_copy"):
        cell = nbformat.v4.new_code_cell(f"of_{name} = 1", metadata={"tags": ["parameters"]})
        nbformat.write(nbformat.v4.new_notebook(cells=[cell]), tmp_path / f"{name}.ipynb")
    run = Run("poles", parameters={"of_06_poles": 1})
    assert read_record(run.folder)["parameters"] == {"of_06_poles": 1}


def test_a_report_tells_files_of_one_name_apart_and_when_it_was_written(tmp_path):
    files = [tmp_path / part / "cloud.xyz" for part in ("a", "b")]
    for number, file in enumerate(files):
        file.parent.mkdir()
        file.write_text(str(number))
    pages.write_report(tmp_path / "r.html", title="Two", files=files)
    text = (tmp_path / "r.html").read_text()
    for number, file in enumerate(files):
        assert str(file) in text
        assert hashlib.sha256(str(number).encode()).hexdigest() in text
    assert f"{datetime.now():%Y-%m-%d}" in text


def test_of_two_runs_in_one_folder_one_writes_and_the_other_says_so(run):
    other = Run("example", parameters={})
    other.save_value("b", 2.0, "1", "predicted")
    for late in (lambda: run.save_value("a", 1.0, "1", "predicted"), run.finish):
        with pytest.raises(ValueError, match=r"^Invalid run in .*another one writes there"):
            late()
    other.save_value("c", 3.0, "1", "predicted")
    other.finish()
    assert pd.read_csv(other.folder / "values.csv")["name"].tolist() == ["b", "c"]
    assert read_record(other.folder)["failure"] == ""
