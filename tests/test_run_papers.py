"""Papers: numbers from runs, skeletons that compile, what is missing said in a sentence."""

import re
import shutil
import subprocess

import matplotlib.pyplot as plt
import pandas as pd
import pytest

from mmqa_lab import commands, plots
from mmqa_lab.run import Run, papers
from mmqa_lab.run.papers import make_paper
from mmqa_lab.studies import STUDIES, chosen, notebooks_folder

typst = pytest.importorskip("typst")


@plots.style()
def study_run(folder, monkeypatch, stem="mimic", value=54.21):
    """A run of a study with all that a paper takes from one."""
    monkeypatch.setenv("MMQA_RESULTS", str(folder))
    run = Run(stem, parameters={})
    figure, ax = plots.subplots(width="double", height_mm=50)
    ax.plot([1, 2], [value, 3], label="speed")
    ax.set(xlabel="range (m)", ylabel="speed (km/h)")
    run.save_figure(figure, "speeds", kind="predicted", seen="Speed & range of 5 % of cars, d1.")
    plt.close(figure)
    frame = pd.DataFrame({"scanner": ["a", "b_c"], "f_2": [3.257, 0.5], "n": [1200, 3]})
    run.save_table(frame, "speed_table", kind="predicted")
    run.save_answer(
        "At 5 m {speed_kmh:.0f} km/h of {share:.1%}.",
        figure="speeds", kind="predicted", speed_kmh=value, share=0.054,
    )  # fmt: skip
    run.save_value("σ_2_mm", -0.5, "mm", "measured")
    run.finish()
    return run.folder


def text_of(pdf):
    """What stands in a PDF."""
    tool = shutil.which("pdftotext") or pytest.skip("needs pdftotext, of poppler")
    return subprocess.run([tool, str(pdf), "-"], capture_output=True, text=True).stdout


def test_values_have_the_studys_name_and_the_answers_digits(tmp_path, monkeypatch):
    folder = study_run(tmp_path, monkeypatch)
    tex, typ = ((folder / f"values.{ending}").read_text() for ending in ("tex", "typ"))
    assert "\\newcommand{\\mmqaMimicSpeedKmh}{54} % km/h, predicted\n" in tex
    assert "\\newcommand{\\mmqaMimicShare}{5.4 \\%}" in tex
    assert '#let mmqaMimicSigmaTwoMm = [#"−0.5"] // mm, measured\n' in typ
    run = Run("mimic", parameters={})
    run.save_value("d1", 1.0, "mm", "measured")
    with pytest.raises(ValueError, match=r"Invalid name 'd_one' of a value: a paper names d1 so"):
        run.save_value("d_one", 1.0, "mm", "measured")
    with pytest.raises(ValueError, match="no letter in it"):
        run.save_value("_", 1.0, "mm", "measured")


def test_names_of_all_studies_differ():
    # a stem that begins with another would let two studies share a name
    stems = [study.stem for study in STUDIES]
    names = [papers.quoted_name(stem, "x").removesuffix("X") for stem in stems]
    assert not [(a, b) for a in names for b in names if a != b and b.startswith(a)]


@pytest.mark.parametrize("stem", ["mimic", "poles"])
def test_a_skeleton_compiles_and_follows_its_run(stem, tmp_path, monkeypatch):
    study_run(tmp_path / "results", monkeypatch, stem)
    (study,) = chosen([stem])
    source = papers.new_paper(tmp_path / "mine", study, tmp_path / "results")
    before = source.read_text()
    assert typed_numbers(before) == []
    pdf = papers.make_paper(tmp_path / "mine", tmp_path / "results")
    first = text_of(pdf)
    assert set(re.findall(r"[−\d.]+", first)) >= {"54", "5.4", "−0.5", "3.26", "0.50", "1200"}
    study_run(tmp_path / "results", monkeypatch, stem, value=61.0)
    papers.make_paper(tmp_path / "mine", tmp_path / "results")
    assert "61" in text_of(pdf)
    assert source.read_text() == before
    content = pdf.read_bytes()
    assert b"/FontFile" in content
    assert b"/Lang" in content
    shutil.rmtree(tmp_path / "results")  # what was brought stays
    assert papers.make_paper(tmp_path / "mine", tmp_path / "results") == pdf


def test_what_is_missing_is_said(tmp_path, monkeypatch):
    (study,) = chosen(["mimic"])
    with pytest.raises(FileNotFoundError, match=r"no run to its end\. Must have one, as after"):
        papers.new_paper(tmp_path / "mine", study, tmp_path)
    study_run(tmp_path / "results", monkeypatch)
    source = papers.new_paper(tmp_path / "mine", study, tmp_path / "results")
    source.write_text(source.read_text() + '\n#fig("mimic", "gone")\n')
    with pytest.raises(FileNotFoundError, match=r"gone\.svg of the study mimic is not there"):
        papers.make_paper(source.parent, tmp_path / "results")
    source.write_text("#mmqaMimicNone")
    with pytest.raises(ValueError, match=r"unknown variable: mmqaMimicNone\. Must be Typst"):
        papers.make_paper(source.parent, tmp_path / "results")
    with pytest.raises(ValueError, match="not empty"):
        papers.new_paper(source.parent, study, tmp_path / "results")
    assert commands.run(["paper", "--new", str(tmp_path / "more")]) == 2


def test_a_skeleton_for_latex_escapes_signs_and_closes_what_it_opens(tmp_path, monkeypatch):
    study_run(tmp_path / "results", monkeypatch)
    where = ["--results", str(tmp_path / "results"), "--latex"]
    assert commands.run(["paper", "--new", str(tmp_path / "m"), "--study", "mimic", *where]) == 0
    text = (tmp_path / "m" / "paper.tex").read_text()
    assert "Speed \\& range of 5 \\% of cars, $d_1$." in text
    assert text.count("\\begin{") == text.count("\\end{") == 4
    for study, name in papers.quoted_files(text):
        assert (tmp_path / "m" / papers.RUNS / study / name).is_file()


NUMBER = re.compile(r"(?<![\w.@\"(-])[-−]?\d+(?:\.\d+)?(?![\w\"])")


def typed_numbers(text):
    """The numbers of a paper's text that are typed, not quoted from a run.

    Left out are code, equations, comments, links, and numbers marked as constants by ``#stated``.
    """
    text = re.sub(r"(?m)//.*$|https?://\S+|\$[^$]*\$|#stated\[[^\]]*\]|places: \([^)]*\)", "", text)
    text = re.sub(r"#(?:import|let|show|set)[^\n]*", "", text)
    while (plain := re.sub(r"#[\w.]+\([^()]*(?:\([^()]*\)[^()]*)*\)", "", text)) != text:
        text = plain
    text = re.sub(r'#"[^"]*"', "", text)
    return NUMBER.findall(text)


def test_typed_numbers_are_found():
    text = '#import "x": a4\nWe saw 12.5 mm, #mmqaMimicSpeedKmh km/h and #stated[95] %; $f = 2$.'
    assert typed_numbers(text) == ["12.5"]


def test_no_number_of_the_paper_is_typed_and_it_compiles(tmp_path):
    folder = notebooks_folder() / "paper"
    assert typed_numbers((folder / "paper.typ").read_text(encoding="utf-8")) == []
    shutil.copytree(folder, tmp_path / "paper")
    made = make_paper(tmp_path / "paper", tmp_path / "no_results")
    assert made.read_bytes().startswith(b"%PDF")
    kept = sum(path.stat().st_size for path in (folder / "from_runs").rglob("*.*"))
    assert kept < 1_000_000
