"""The README's numbers come from results, and from full ones only."""

import json
import re
import tomllib
from dataclasses import asdict
from importlib import metadata

import pytest
from overlaps import overlapping_texts

from mmqa_lab.__main__ import main
from mmqa_lab.planes import CONSISTENT_SCALE, PAPER_SCALE
from mmqa_lab.run import pages as readme
from mmqa_lab.run.pages import Outcome
from mmqa_lab.spacing import poisson_spacing
from mmqa_lab.studies import STUDIES, notebooks_folder


@pytest.fixture
def results(tmp_path):
    """Results of a full run of every study, with answers of their own."""
    for study in STUDIES:
        folder = tmp_path / study.stem
        folder.mkdir()
        outcome = Outcome(study.stem, False, "", failure="", checks=2, passed=2)
        (folder / "outcome.json").write_text(json.dumps(asdict(outcome)))
        answer = {"sentence": f"It is {study.number}.5 mm.", "figure": "key"}
        (folder / "run.json").write_text(json.dumps({"answer": answer}))
    return tmp_path


def test_table_has_a_row_for_each_study_with_its_answer(results):
    rows = readme.studies_table(results, STUDIES).splitlines()[2:]
    assert len(rows) == len(STUDIES)
    for study, row in zip(STUDIES, rows, strict=True):
        assert f"notebooks/{study.notebook}.ipynb" in row
        assert f"| It is {study.number}.5 mm. |" in row
    assert "[doi:10.3390/s140609471](https://doi.org/10.3390/s140609471)" in rows[4]


@pytest.mark.parametrize("change", [{"quick": True}, {"failure": "the kernel died"}, {"passed": 1}])
def test_a_quick_or_failed_run_is_refused(results, change):
    file = results / "mimic" / "outcome.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | change))
    with pytest.raises(
        ValueError, match=r"Invalid results of mimic in .* full run that came to its end"
    ):
        readme.studies_table(results, STUDIES)


def test_ledger_is_counted_by_source_and_verdict():
    published = pytest.importorskip("mmqa_lab.published.ledger")
    ledger = published.collect("no such folder")
    figure, _, head, _, *rows, total = readme.ledger_table(ledger).splitlines()
    assert "(notebooks/ledger.png)" in figure
    assert head == "| source | reproduced | consistent | contradicted | not comparable |"
    assert len(rows) == 5
    assert total.startswith("| all | 0 | 0 | 0 | ")
    figure = readme.ledger_figure(ledger)
    assert sum(bar.get_width() for bar in figure.axes[0].patches) == int(total.split()[-2])
    assert overlapping_texts(figure) == []


def test_check_tells_another_readme_and_writes_nothing(results):
    path = notebooks_folder().parent / "README.md"
    before = path.read_bytes()
    assert main(["readme", "--check", "--results", str(results)]) == 1
    assert path.read_bytes() == before


def test_missing_marks_are_named():
    with pytest.raises(ValueError, match="no marks <!-- x --> and <!-- end x -->"):
        readme.replaced("nothing here", "x", "new")


def test_numbers_in_the_text_are_those_of_the_code():
    root = notebooks_folder().parent
    text = (root / "README.md").read_text(encoding="utf-8")
    nearest, *_, farthest = poisson_spacing(1)
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    python = re.search(r"[0-9.]+", project["requires-python"])[0]
    for expected in (
        f"f = {farthest / nearest:.3f} at every density",
        f"{CONSISTENT_SCALE:.4f} x the median distance",
        f"The paper's code has {PAPER_SCALE}",
        f"`python3` ({python} or newer)",
        f"with 1 cm, d1 is 10 mm or {10 * 2**0.5:.1f} mm",
        f"**{metadata.version('mmqa_lab')}**",
    ):
        assert expected in text
