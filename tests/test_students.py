"""Copies for a class: answers gone, checks kept."""

import ast

import nbformat
import pytest

from mmqa_lab.__main__ import main
from mmqa_lab.run.notebooks import student_cell, write_student_notebooks
from mmqa_lab.studies import STUDIES

ANSWER = """# 2: twice the side makes four times the area
side = 3
areas = [s * s for s in (side, 2 * side)]
assert areas[1] == 4 * areas[0]
areas"""


def run(source):
    scope = {}
    exec(compile(source, "cell", "exec"), scope)
    return scope


def test_check_fails_until_the_name_is_worked_out():
    given = student_cell(ANSWER)
    assert given.splitlines()[:2] == ["# 2: your work", "areas = ..."]
    with pytest.raises(AssertionError, match="2: give areas a value"):
        run(given)
    with pytest.raises(AssertionError, match="2: not right yet"):
        run(given.replace("areas = ...", "areas = [9, 18]"))
    run(given.replace("areas = ...", "areas = [9, 36]"))


def test_names_bound_inside_a_check_are_no_answers():
    given = student_cell("# 1: all\nvalues = [1, 2]\nassert all(v > 0 for v in values)")
    assert "v = ..." not in given


@pytest.mark.parametrize("source", ["# 1: nothing\nx = 2\nx", "# 1: not its own\nx = 2\nassert y"])
def test_an_answer_without_a_check_is_refused(source):
    with pytest.raises(ValueError, match=r"Invalid answer '# 1: .*Must be checked by an assert"):
        student_cell(source)


@pytest.mark.parametrize("study", STUDIES, ids=lambda study: study.stem)
def test_copies_hold_no_answer_and_no_lesson(study, tmp_path):
    (path,) = write_student_notebooks([study], tmp_path)
    copy, original = (nbformat.read(p, as_version=4) for p in (path, study.path))
    nbformat.validate(copy)
    answers = [c.source for c in original.cells if "solution" in c.metadata.get("tags", [])]
    texts = [cell.source for cell in copy.cells]
    assert not set(answers) & set(texts)
    tags = [tag for cell in copy.cells for tag in cell.metadata.get("tags", [])]
    assert tags.count("exercise") == len(answers)
    assert "lesson" not in tags
    assert tags.count("check") == len(answers)
    for cell in copy.cells:
        part = [tag for tag in cell.metadata.get("tags", []) if tag in ("exercise", "check")]
        if part:
            graded = cell.metadata["nbgrader"]
            asserted = any(isinstance(node, ast.Assert) for node in ast.parse(cell.source).body)
            assert asserted == graded["grade"] == graded["locked"] == (part == ["check"])
            assert graded["solution"] == (part == ["exercise"])
    ids = [c.metadata["nbgrader"]["grade_id"] for c in copy.cells if "nbgrader" in c.metadata]
    assert len(set(ids)) == len(ids) == 2 * len(answers)


def test_a_class_can_have_small_parameters(tmp_path):
    assert main(["student", str(tmp_path), "mimic", "--quick"]) == 0
    cells = nbformat.read(tmp_path / "05_mimic.ipynb", as_version=4).cells
    place = next(k for k, c in enumerate(cells) if "parameters" in c.metadata.get("tags", []))
    small = run(cells[place + 1].source)
    (study,) = (study for study in STUDIES if study.stem == "mimic")
    assert {name: small[name] for name in study.module.QUICK} == study.module.QUICK


def test_stored_outputs_stay_with_the_teacher(tmp_path):
    """The answer would otherwise be readable below the empty exercise."""
    output = nbformat.v4.new_output("stream", text="the answer is 36")
    cell = nbformat.v4.new_code_cell(ANSWER, outputs=[output], execution_count=7)
    cell.metadata["tags"] = ["solution"]
    plain = nbformat.v4.new_code_cell("2 + 2", outputs=[output], execution_count=8)

    class Ran:
        path = tmp_path / "01_ran.ipynb"

    nbformat.write(nbformat.v4.new_notebook(cells=[cell, plain]), Ran.path)
    (path,) = write_student_notebooks([Ran], tmp_path / "course")
    assert "answer is 36" not in path.read_text()
    assert [c.execution_count for c in nbformat.read(path, as_version=4).cells] == 3 * [None]


def test_a_students_work_is_not_overwritten(tmp_path, capsys):
    assert main(["student", str(tmp_path), "mimic"]) == 0
    (path,) = tmp_path.iterdir()
    path.write_text("work")
    assert main(["student", str(tmp_path)]) == 2
    assert "it contains 05_mimic.ipynb" in capsys.readouterr().err
    assert path.read_text() == "work"
    assert len(list(tmp_path.iterdir())) == 1
