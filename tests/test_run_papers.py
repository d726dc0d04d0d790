"""Papers: numbers from runs, skeletons that compile, what is missing said in a sentence."""

import re
import shutil
import subprocess
from collections import Counter

import matplotlib.pyplot as plt
import pandas as pd
import pytest

from mmqa_lab import commands, plots
from mmqa_lab.run import Run, papers, read_record, write_record
from mmqa_lab.run.papers import make_paper
from mmqa_lab.run.quotes import quoted_name, values_tex, values_typ
from mmqa_lab.studies import STUDIES, chosen, notebooks_folder

typst = pytest.importorskip("typst")


@plots.style("elsevier")
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
    with pytest.raises(FileNotFoundError, match=r"no full run to its end\. Must have one, as"):
        papers.new_paper(tmp_path / "mine", study, tmp_path)
    study_run(tmp_path / "results", monkeypatch)
    record = read_record(tmp_path / "results" / "mimic")
    write_record(tmp_path / "results" / "mimic", record | {"size": "middle"})
    with pytest.raises(FileNotFoundError, match=r"no full run"):  # its figures are of the screen
        papers.new_paper(tmp_path / "mine", study, tmp_path / "results")
    write_record(tmp_path / "results" / "mimic", record)
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


def test_one_document_takes_the_values_of_all_studies(tmp_path):
    source, files = tmp_path / "all.typ", []
    for study in STUDIES:
        names = [quoted_name(study.stem, name) for name in ("n", "f_low", "e95_low", "σ_2_mm")]
        rows = [{"quoted": one, "text": "5 %", "unit": "1", "kind": ""} for one in names]
        (tmp_path / f"{study.stem}.typ").write_text(values_typ(rows))
        files.append((study.stem, values_tex(rows)))
    tex = "".join(text for _, text in files)
    names = re.findall(r"(?m)^\\newcommand\{\\([A-Za-z]+)\}\{[^{}]*\} %.*$", tex)
    assert len(names) == len(set(names)) == 4 * len(STUDIES)
    imports = [f'#import "{stem}.typ": *' for stem, _ in files]
    source.write_text("\n".join([*imports, *(f"#{name}" for name in names)]))
    assert typst.compile(str(source)).startswith(b"%PDF")


NUMBER = re.compile(r"(?<![\w.@\"(-])[-−]?\d+(?:\.\d+)?(?![\w\"])")

SMALL = "three|four|five|six|seven|eight|nine|ten|eleven|twelve|dozen|hundred|thousand|million"
TENS = r"\w+teen|(?:twen|thir|for|fif|six|seven|eigh|nine)ty"
WORD = re.compile(rf"(?i)(?<![\w@-])(?:{SMALL}|{TENS})(?!\w)")
"""Numbers as words; one, two and a half count parts of a thing, and no run changes them."""


def typed_numbers(text):
    """The numbers of a paper's text that are typed, not quoted from a run.

    Left out are code, equations, comments, links, and numbers marked as constants by ``#stated``.
    """
    text = re.sub(r"(?m)//.*$|https?://\S+|\$[^$]*\$|#stated\[[^\]]*\]|places: \([^)]*\)", "", text)
    text = re.sub(r"#(?:import|let|show|set)[^\n]*", "", text)
    while (plain := re.sub(r"#[\w.]+\([^()]*(?:\([^()]*\)[^()]*)*\)", "", text)) != text:
        text = plain
    text = re.sub(r'#"[^"]*"', "", text)
    return NUMBER.findall(text) + WORD.findall(text)


def test_typed_numbers_are_found():
    text = '#import "x": a4\nWe saw 12.5 mm, #mmqaMimicSpeedKmh km/h and #stated[95] %; $f = 2$.'
    assert typed_numbers(text) == ["12.5"]
    text = (
        "Thirty-one metrics of seventeen, one of two; @fig-six, #stated[three] ways, for seventy."
    )
    assert typed_numbers(text) == ["Thirty", "seventeen", "seventy"]


PAPER = notebooks_folder() / "paper"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The paper of the stored results."""
    folder = tmp_path_factory.mktemp("paper") / "paper"
    shutil.copytree(PAPER, folder)
    return make_paper(folder, folder / "no_results")


def test_no_number_of_the_paper_is_typed_and_it_compiles(made):
    text = (PAPER / "paper.typ").read_text(encoding="utf-8")
    assert typed_numbers(text) == []
    abstract = re.search(r"(?s)abstract: \[(.*?)\],\n", text)[1]
    assert 180 <= len(abstract.split()) <= 200
    assert "are simulated" in abstract
    content = made.read_bytes()
    assert b"/Title" in content
    assert b"/Lang" in content
    assert content.count(b"/Alt") == text.count("#fig(") > 3
    assert 6 <= len(re.findall(rb"/Type ?/Page\b", content)) <= 8
    fonts = content.count(b"/FontDescriptor ")
    assert content.count(b"/FontFile") == fonts > 2  # each is embedded
    assert sum(path.stat().st_size for path in (PAPER / "from_runs").rglob("*.*")) < 1_000_000
    assert (PAPER / "lab.typ").read_text() == (papers.TEMPLATES / "paper/lab.typ").read_text()


def test_the_stored_paper_is_that_of_the_stored_results(made):
    stored = PAPER / "paper.pdf"
    if made.read_bytes() != stored.read_bytes():  # as with another Typst, or other fonts
        assert text_of(made) == text_of(stored)


def test_other_results_change_the_numbers_of_the_paper_and_no_word(made, tmp_path):
    def others(found):
        return "".join(str((int(one) + 1) % 10) if one.isdigit() else one for one in found[0])

    shutil.copytree(PAPER, tmp_path / "paper")
    for file in (tmp_path / "paper").glob("from_runs/*/values.typ"):
        file.write_text(re.sub(r'#"[^"]+"', others, file.read_text()))
    for file in (tmp_path / "paper").glob("from_runs/*/*.csv"):
        file.write_text(re.sub(r"(?<=,)-?\d+\.\d+(?=,)", others, file.read_text()))
    again = make_paper(tmp_path / "paper", tmp_path / "no_results")
    texts = [text_of(one).replace("-\n", "") for one in (made, again)]
    numbers, words = (
        [Counter(re.findall(pattern, text)) for text in texts]
        for pattern in (r"\d+\.\d+", r"[A-Za-z]{2,}")
    )
    assert words[0] == words[1]
    assert (numbers[0] - numbers[1]).total() > 50
