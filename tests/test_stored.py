"""What the repository keeps of a full run: outputs of this code, small, without widgets."""

import base64
import io
import re

import nbformat
import numpy as np
import pandas as pd
import pytest
from PIL import Image

from mmqa_lab.__main__ import main
from mmqa_lab.io import write_atomically
from mmqa_lab.published.ledger import summary
from mmqa_lab.run import write_record
from mmqa_lab.run.notebooks import (
    _renew_advice,
    _renew_readme,
    code_hash,
    machine_speed,
    store,
    stored_seconds,
    usual_width,
)
from mmqa_lab.studies import STUDIES, TOOLS, notebooks_folder
from mmqa_lab.studies.fitness.tasks import FREE

LARGEST_BYTES = 1_000_000


@pytest.mark.parametrize("study", [*STUDIES, *TOOLS], ids=lambda study: study.stem)
def test_stored_outputs_are_of_this_code(study):
    notebook = nbformat.read(study.path, as_version=4)
    outputs = [one for cell in notebook.cells for one in cell.get("outputs", [])]
    if not outputs:
        pytest.skip("needs the outputs of a full run")
    assert notebook.metadata["mmqa_lab"]["code"] == code_hash(notebook)
    assert study.path.stat().st_size <= LARGEST_BYTES
    assert not any(one.get("name") == "stderr" or one.output_type == "error" for one in outputs)
    assert not any("widget" in kind for one in outputs for kind in one.get("data", {}))
    thumbnail = notebooks_folder() / "thumbnails" / f"{study.notebook}.png"
    assert study in TOOLS or thumbnail.stat().st_size <= 40_000


def test_a_quick_run_is_not_stored(tmp_path):
    with pytest.raises(ValueError, match="Must be of a full run"):
        store(tmp_path, tmp_path, STUDIES[:1])


def picture(pixels):
    """A noisy picture of greys as PNG, and in base 64."""
    stream = io.BytesIO()
    noise = np.random.default_rng(0).integers(0, 255, (pixels // 2, pixels), dtype=np.uint8)
    Image.fromarray(noise).convert("RGB").save(stream, "png")
    return stream.getvalue(), base64.b64encode(stream.getvalue()).decode()


class Ran:
    """A study of one cell in a folder of its own."""

    stem, notebook = "ran", "99_ran"

    def __init__(self, folder):
        self.path = folder / "99_ran.ipynb"


def test_the_readme_advises_what_real_clouds_do_not_contradict(tmp_path):
    (tmp_path / "README.md").write_text("First.\n\n|task|ask for|\n|---|---|\n|old|f|\n\nEnd.\n")
    found = pd.DataFrame({"words": list("abcde"), "method": 4 * ["e95"] + ["density"], "n": 160})
    found["advised"] = ["no", "no", "no", "yes", "yes"]
    found["ask_for"] = 4 * ["no limit"] + ["at least 21 points/m²"]
    found["kept_by"] = [9, 9, 9, 0, 17]
    for _ in range(2):
        _renew_advice(tmp_path / "README.md", found)
    assert (tmp_path / "README.md").read_text().splitlines() == [
        "First.",
        "",
        "|task|ask for|kept by|",
        "|---|---|---|",
        "|d|`e95` no limit|0 of 160|",
        "|e|`density` at least 21 points/m²|17 of 160|",
        "",
        "End.",
    ]


def test_the_readme_asks_for_no_less_than_the_stored_limits():
    text = (notebooks_folder().parent / "README.md").read_text(encoding="utf-8")
    found = pd.read_csv(notebooks_folder() / "paper/from_runs/fitness/advice.csv")
    found = found[found["advised"] == "yes"]
    for row in found.itertuples():
        end, asked = re.match(r"(at \w+) ([\d.]+) ", f"{row.ask_for} ").groups()
        stricter = float(asked) / row.nine_of_ten
        assert 0.9 < stricter <= 1 if end == "at most" else 1 <= stricter < 1.1
        assert f"|{row.words}|`{row.method}` {row.ask_for}|{row.kept_by} of {row.n}|\n" in text
    assert len(found) == len(re.findall(r"^\|.*\d+ of \d+\|$", text, flags=re.MULTILINE)) > 0


def test_what_is_stored_is_small_and_needs_no_kernel(tmp_path):
    study, results = Ran(tmp_path), tmp_path / "results" / "ran"
    content, coded = picture(1500)
    outputs = [
        nbformat.v4.new_output("stream", name="stderr", text="a warning"),
        nbformat.v4.new_output("display_data", {"image/png": coded, "text/plain": "Figure"}),
    ]
    said = nbformat.v4.new_markdown_cell("# Ran\n\n**Answer.** Old.\n\nSource.")
    cells = [said, nbformat.v4.new_code_cell("draw()")]
    nbformat.write(nbformat.v4.new_notebook(cells=cells), study.path)
    cells[1].outputs = outputs
    said.source = "# Ran\n\n**Answer. Yes.** By 3 mm.\n\n![All](attachment:answer.png)\n\nSource."
    write_atomically(results / "ran.ipynb", nbformat.writes(nbformat.v4.new_notebook(cells=cells)))
    (results / "key.png").write_bytes(content)
    answer = {"sentence": "By 3 mm.", "short": "Yes.", "figure": "key", "thumbnail": "key"}
    ran = {"size": "full", "failure": "", "seconds": 2.5, "answer": answer}
    write_record(results, ran)
    for _ in range(2):  # what the first has written may be stored again
        store(tmp_path, results.parent, [study])
    stored = nbformat.read(study.path, as_version=4)
    assert stored.cells[0].source == said.source
    (shown,) = stored.cells[1].outputs
    width = Image.open(io.BytesIO(base64.b64decode(shown["data"]["image/png"]))).width
    assert width <= 1000
    assert study.path.stat().st_size <= LARGEST_BYTES
    assert stored.metadata["mmqa_lab"]["code"] == code_hash(stored)
    assert (tmp_path / "answers.csv").read_text() == "study,short,answer\nran,Yes.,By 3 mm.\n"
    assert (tmp_path / "thumbnails" / "99_ran.png").is_file()
    assert stored_seconds(tmp_path) == {"ran": 2.5}
    write_atomically(study.path, study.path.read_text().replace("draw()", "draw(2)"))
    with pytest.raises(ValueError, match="the notebook changed"):
        store(tmp_path, results.parent, [study])


def test_the_ledger_stays_where_a_study_that_it_names_was_not_run(tmp_path):
    (tmp_path / "ledger.csv").write_text("study,verdict\npoles,reproduced\n")
    store(tmp_path, tmp_path / "results", [])
    assert pd.read_csv(tmp_path / "ledger.csv")["verdict"].tolist() == ["reproduced"]
    (tmp_path / "ledger.csv").write_text("study,verdict\n,not comparable\n")
    store(tmp_path, tmp_path / "results", [])
    assert len(pd.read_csv(tmp_path / "ledger.csv")) > 465


MOST_WORDS = 18


def test_no_answer_has_a_number_that_was_not_measured():
    answers = pd.read_csv(notebooks_folder() / "answers.csv")
    assert len(answers) == len(STUDIES)
    assert not answers["answer"].str.contains(r"\bnan\b").any()
    if "short" in answers:  # the front page has a sentence of one breath for each
        assert not answers.loc[
            answers["short"].str.split().str.len() > MOST_WORDS, "study"
        ].tolist()


def test_a_machine_of_half_the_speed_takes_twice_as_long(monkeypatch):
    times = iter([10.0, 11.0, 20.0, 22.0])
    monkeypatch.setattr("time.process_time", lambda: next(times))
    assert 2 * machine_speed() == machine_speed() > 0


@pytest.mark.parametrize("study", [*STUDIES, *TOOLS], ids=lambda study: study.stem)
def test_no_cell_shows_a_representation_and_the_language_is_whole(study):
    notebook = nbformat.read(study.path, as_version=4)
    shown = [out for cell in notebook.cells for out in cell.get("outputs", [])]
    alone = [out.get("data", {}) for out in shown if list(out.get("data", {})) == ["text/plain"]]
    assert not [one for one in alone if re.match(r"\[?(<|Text\()", one["text/plain"])]
    assert len(notebook.metadata["language_info"]) > 3  # or JupyterLab fills it in on opening


def test_the_readme_is_short_and_has_the_stored_answers():
    text = (notebooks_folder().parent / "README.md").read_text(encoding="utf-8")
    seen = re.sub(r"!\[[^\]]*\]\([^)]*\)|\]\([^)]*\)", " ", text)
    assert len(re.findall(r"[^\s|#*`-]*\w[^\s|]*", seen)) <= 900
    brackets = re.findall(r"(?<!\])\(([^()]*)\)", re.sub(r"```.*?```", "", text, flags=re.DOTALL))
    assert [one for one in brackets if len(one.split()) > 6] == []
    answers = pd.read_csv(notebooks_folder() / "answers.csv").set_index("study")
    for study in STUDIES:
        short = answers.loc[study.stem, "short"]
        assert len(short.split()) <= 18
        assert not re.search(r"[(\[]", short)
        assert f"{study.notebook}.ipynb) | {short} |" in text
        first = nbformat.read(study.path, as_version=4).cells[0].source
        assert f"\n\n**Answer. {short}** {answers.loc[study.stem, 'answer']}\n\n" in first
    ledger = pd.read_csv(notebooks_folder() / "ledger.csv", dtype={"printed": str})
    counts, width = summary(ledger).loc["all"], f"{100 * usual_width(ledger):.0f} %"
    said = " ".join(text.split())
    assert f"print {counts.sum()} results. {counts['reproduced']} are reproduced to the" in said
    line = (
        f"{counts['consistent']} are consistent with our ranges, whose median width is {width} of"
    )
    assert f"{line} the value; {counts['differs']} differ." in said
    kinds = pd.read_csv(notebooks_folder() / "paper/from_runs/fitness/by_kind.csv")
    halves = kinds[kinds["task"].isin(FREE) & (kinds["scanners"] == "pooled")]
    behind = halves.loc[halves["behind_low"] > 0, "method"].value_counts()
    line = f"on {behind['f']} of {halves['task'].nunique()} city tasks another metric is shown to "
    assert f"{line}tell better," in said
    scores = halves.set_index(["task", "method"])
    asked = {"relief_percent": ("noise_of_a_mean", True), "wire_m": ("e95", False)}
    asked |= {"kerb_mm": ("noise_of_a_mean", False)}
    for task, (name, shown) in asked.items():
        row = [f"{scores.loc[(task, one), 'balanced']:.2f}" for one in (name, "density", "f")]
        assert f"|{name.replace('_', ' ')}|{'|'.join(row)}|\n" in text
        assert (scores.loc[(task, "density"), "behind_low"] > 0) == shown
    assert "Of these, density is shown to be beaten for waves only." in said
    real = pd.read_csv(notebooks_folder() / "paper/from_runs/fitness/real_ranks.csv")
    asked_of_real = ("f", "noise_of_a_mean", "e95")
    potholes = real[real["task"] == "pothole_percent"]
    assert len(potholes) == (potholes["e95"] > potholes["noise_of_a_mean"]).sum() == 4
    real = real[~real["data"].isin(["road, drive against drive", "boards"])]
    of_f, of_noise, of_e95 = ((real["density"] > real[name]).sum() for name in asked_of_real)
    line = f"Density orders {of_f} of their {len(real)} rankings better than f, {of_noise} than the"
    assert f"{line} noise of a mean, and {of_e95} than e95." in said
    wires = kinds[(kinds["task"] == "wire_m") & (kinds["method"] == "disc_q05")]
    wires = wires.loc[wires["scanners"] != "pooled", "limit"]
    assert round(wires.max() / wires.min()) == 12
    assert "for wires twelvefold" in text
    assert f"{counts['fitted']} served to fit, and {counts['not comparable']} are not" in text
    measured = (notebooks_folder().parent / "tests/benchmarks/RESULTS.md").read_text("utf-8")
    row = r"^\| 0\.[45] \| (\d+)/(\d+), \d+/\d+ \| \d+/\d+, (\d+)/(\d+) \|"
    (_, _, *before), (_, _, *now) = re.findall(row, measured, flags=re.MULTILINE)
    share, once = (f"{100 * int(right) / int(finds):.0f} %" for right, finds in (now, before))
    for command, timed in (("studies", r"alone: ([\d.]+) minutes"), ("test", r"([\d.]+) of wall")):
        minutes = float(re.search(timed, measured)[1])
        assert f"mmqa_lab {command} " in text
        assert int(re.search(rf"mmqa_lab {command} +# (\d+) minutes", text)[1]) == round(minutes)
    assert f"among look-alikes: {share} of its finds are right; it was {once}." in said


def test_new_answers_come_into_the_readme(tmp_path):
    readme = tmp_path / "README.md"
    readme.write_text("| ![old](a.png) | [05 MIMIC](notebooks/05_mimic.ipynb) | Old. |\n")
    _renew_readme(readme, {"mimic": ["New, 5 %.", ""], "poles": ["Other.", ""]})
    assert readme.read_text().endswith("(notebooks/05_mimic.ipynb) | New, 5 %. |\n")


def test_the_readme_shows_what_its_command_draws(tmp_path):
    repository = notebooks_folder().parent
    text = (repository / "README.md").read_text(encoding="utf-8")
    line = re.search(r"python3 -m mmqa_lab (evaluate .*) --out road.png", text)[1]
    line = line.replace("data_samples", str(repository / "data_samples"))
    assert main([*line.split(), "--out", str(tmp_path / "road.png")]) == 0
    shown = Image.open(notebooks_folder() / "road.png").convert("RGB")
    drawn = Image.open(tmp_path / "road.png").convert("RGB").resize(shown.size)
    assert (
        np.abs(np.subtract(shown, drawn, dtype=float)).mean() < 8
    )  # of 255; fonts and layouts may differ
