"""Copies for a class: answers gone, checks kept, sheets to print."""

import ast
import re
from types import SimpleNamespace

import nbformat
import pandas as pd
import pytest
from conftest import loaded, stored
from IPython.core.inputtransformer2 import TransformerManager

from mmqa_lab.__main__ import main
from mmqa_lab.run import exercises, students
from mmqa_lab.run.exercises import ASKED, student_cell
from mmqa_lab.run.pages import TEMPLATES
from mmqa_lab.run.students import write_solutions, write_student_notebooks
from mmqa_lab.studies import STUDIES, chosen

ANSWER = """# 2: twice the side makes four times the area
side = 3
areas = [s * s for s in (side, 2 * side)]
# check
assert areas[1] == 4 * areas[0]"""


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
    with pytest.raises(AssertionError, match="2: cannot be checked: areas is of type int"):
        run(given.replace("areas = ...", "areas = 9"))
    run(given.replace("areas = ...", "areas = [9, 36]"))


def test_what_a_check_says_and_needs_goes_with_it():
    given = student_cell(
        "# 3: it is even\n# asked for: n, a whole number\nimport math\nn = 4\n"
        "# check\nassert math.gcd(n, 2) == 2, 'n is odd'"
    )
    assert given.splitlines()[1:4] == ["# asked for: n, a whole number", "import math", "n = ..."]
    with pytest.raises(AssertionError, match="3: n is odd"):
        run(given.replace("n = ...", "n = 3"))


NUMBERED = """# 4: a line for each number
# asked for: length_m, a number
length_m = 2.0 + number / 10
# check
expected = 2.0 + number / 10
assert abs(length_m - expected) < 0.01, "too far off"
"""


def test_below_the_line_check_all_is_sealed_and_the_number_is_asked_for():
    given = student_cell(NUMBERED)
    assert "length_m = ...  # m" in given.splitlines()
    assert "expected" not in given.split("check_answer(")[0]
    done = given.replace("length_m = ...", "length_m = 2.3")
    exec(done, {"number": 3})
    with pytest.raises(AssertionError, match="4: too far off"):
        exec(done, {"number": 4})
    with pytest.raises(AssertionError, match="4: give number a value"):
        exec(done, {"number": ...})


def test_what_no_answer_changes_is_worked_out_once_however_many_units_are_tried():
    cell = """# 1: the slow one
# asked for: size, a number in m
size = 2 * slow()
# check
right = slow()
near = right * 0.01
miss = size - 2 * right
right = right + 0 * size
assert abs(miss) < near and right == 3, "too far off"
"""
    calls = []
    scope = {"slow": lambda: calls.append(1) or 3.0, "number": 1}
    done = student_cell(cell)
    with pytest.raises(AssertionError, match="1: too far off"):
        exec(done.replace("size = ...", "size = 5.0"), scope)
    assert len(calls) == 1
    with pytest.raises(AssertionError, match=r"1: it is right times 0\.01"):
        exec(done.replace("size = ...", "size = 600.0"), scope)
    exec(done.replace("size = ...", "size = 6.0"), scope)
    assert len(calls) == 3


@pytest.mark.parametrize("study", STUDIES, ids=lambda study: study.stem)
def test_copies_hold_no_answer_and_no_lesson(study, tmp_path):
    (path,) = write_student_notebooks(tmp_path, [study])
    copy, original = (nbformat.read(p, as_version=4) for p in (path, study.path))
    nbformat.validate(copy)
    answers = [c.source for c in original.cells if "solution" in c.metadata.get("tags", [])]
    texts = [cell.source for cell in copy.cells]
    assert not set(answers) & set(texts)
    tags = [tag for cell in copy.cells for tag in cell.metadata.get("tags", [])]
    assert tags.count("exercise") == len(answers)
    assert not {"lesson", "results"} & set(tags)
    assert tags.count("check") == len(answers)
    (number,) = [c.source for c in copy.cells if "number" in c.metadata.get("tags", [])]
    assert number.startswith("number = ...  # yours")
    graded = [cell for cell in copy.cells if "nbgrader" in cell.metadata]
    for cell in graded:
        part, grading = cell.metadata["tags"][0], cell.metadata["nbgrader"]
        checked = "check_answer(" in cell.source
        assert checked == grading["grade"] == grading["locked"] == (part == "check")
        assert "assert" not in cell.source  # nobody reads the range of the answer there
        assert grading["solution"] == (part == "exercise")
        if not checked:  # what is asked for names every answer
            work = cell.source.splitlines()
            (asked,) = [line for line in work if line.startswith(ASKED)]
            names = {line.split(" = ")[0] for line in work if " = ..." in line}
            assert names <= set(asked.replace(",", " ").replace(";", " ").split())
    assert len({c.metadata["nbgrader"]["grade_id"] for c in graded}) == 2 * len(answers)


EXERCISES = (
    nbformat.v4.new_markdown_cell("# Squares\n\nn: the notebook sets it."),
    nbformat.v4.new_code_cell("side = 2", metadata={"tags": ["parameters"]}),
    nbformat.v4.new_markdown_cell("## Exercise 1\n\nHow long is n sides?"),
    nbformat.v4.new_code_cell("number = 1  # yours", metadata={"tags": ["number"]}),
    nbformat.v4.new_code_cell(
        "# 1: by counting\n# asked for: long_m, a number\nlong_m = number * side\n"
        "# check\nassert long_m == number * side",
        metadata={"tags": ["solution"]},
    ),
    nbformat.v4.new_markdown_cell("## Lesson plan", metadata={"tags": ["lesson"]}),
)


@pytest.fixture
def squares(tmp_path):
    """A study of one exercise, in a folder of its own."""
    study = SimpleNamespace(path=tmp_path / "99_squares.ipynb", title="Squares", quick={"side": 3})
    study.notebook = study.path.stem
    nbformat.write(nbformat.v4.new_notebook(cells=list(EXERCISES)), study.path)
    return study


def test_solutions_have_tasks_answers_by_number_and_the_lesson_plan(squares, tmp_path):
    (path,) = write_solutions(tmp_path / "mine", [squares], quick=True)
    page = path.read_text()
    answers = re.findall(r"<td>(\d+)</td>\s*<td>(\d+)</td>", page)
    assert answers == [(str(n), str(3 * n)) for n in range(1, 31)]
    for words in ("How long is n sides?", "by counting", "Lesson plan"):
        assert words in page
    assert "assert" not in page  # the test is for the program
    assert "All studies" not in page


def test_checks_can_be_kept_apart_and_students_set_their_number(squares, tmp_path):
    (path,) = write_student_notebooks(tmp_path / "course", [squares], checks=False)
    text = path.read_text()
    assert "check_answer" not in text
    assert "set it in the next cell" in text
    (path,) = write_student_notebooks(tmp_path / "checks", [squares])
    assert "check_answer" in path.read_text()


def test_a_given_cell_waits_for_the_students_number(squares, tmp_path):
    notebook = nbformat.read(squares.path, as_version=4)
    notebook.cells.insert(4, nbformat.v4.new_code_cell("drawn = [\n    number\n]\nother = 1"))
    nbformat.write(notebook, squares.path)
    (path,) = write_student_notebooks(tmp_path / "class", [squares])
    code = [cell.source for cell in nbformat.read(path, as_version=4).cells[:5]]
    scope = {}
    for text in (code[1], code[3], code[4]):
        exec(text, scope)
    assert "drawn" not in scope
    exec(code[4], scope | {"number": 3})


@pytest.mark.parametrize("study", STUDIES, ids=lambda study: study.stem)
def test_answers_by_number_need_no_name_of_a_cell_that_is_not_tagged_for_them(study):
    known, others, missing = set(), set(), set()
    for cell in nbformat.read(study.path, as_version=4).cells:
        tags = set(cell.metadata.get("tags", []))
        if cell.cell_type != "code" or tags & {"number", "results"}:
            continue
        code = TransformerManager().transform_cell(cell.source)
        if "solution" in tags:
            code = exercises.answer_parts(code)[1]
            code = code if "number" in exercises.names_in(code, ast.Load) else ""
        for node in ast.parse(code).body:
            if tags & {"parameters", "answers", "solution"}:
                drawn = "default_rng" in ast.unparse(node)
                assert not drawn or "solution" in tags  # another cell may draw from it
                own = stored(node) if isinstance(node, ast.For | ast.With) else set()
                missing |= (loaded(node) - known - own) & others
                known |= stored(node)
            else:
                others |= stored(node)
    assert missing == set()


def test_an_answer_is_worked_out_where_it_stands(squares):
    notebook = nbformat.read(squares.path, as_version=4)
    notebook.cells.append(nbformat.v4.new_code_cell("for side in (99,):\n    side += 1"))
    solution = next(c for c in notebook.cells if "solution" in c.metadata.get("tags", []))
    caught = "try:\n    int('x')\nexcept ValueError as error:\n    said = str(error)\n# check\n"
    solution.source = solution.source.replace("# check\n", caught)
    nbformat.write(notebook, squares.path)
    table = students.answer_table(squares, quick=True)
    assert table.to_numpy(dtype=float).tolist() == [[n, 3 * n] for n in range(1, 31)]


def test_words_of_the_glossary_are_the_notebooks_own():
    rows = pd.read_csv(TEMPLATES / "glossary.csv").to_dict("records")
    assert all(isinstance(word, str) for row in rows for word in row.values())
    assert len({row["english"].lower() for row in rows}) == len(rows)
    cells = [c for study in STUDIES for c in nbformat.read(study.path, as_version=4).cells]
    text = " ".join(" ".join(cell.source.lower().split()) for cell in cells)
    forms = {row["english"]: re.findall(r"[^,()]+", row["english"].lower()) for row in rows}
    assert [word for word, f in forms.items() if not any(one.strip() in text for one in f)] == []


def test_a_class_can_have_small_parameters(tmp_path):
    assert main(["student", str(tmp_path), "mimic", "--quick"]) == 0
    cells = nbformat.read(tmp_path / "05_mimic.ipynb", as_version=4).cells
    place = next(k for k, c in enumerate(cells) if "parameters" in c.metadata.get("tags", []))
    small, (study,) = run(cells[place + 1].source), chosen(["mimic"])
    assert {name: small[name] for name in study.quick} == study.quick


def test_stored_outputs_stay_with_the_teacher(squares, tmp_path):
    """The answer would otherwise be readable below the empty exercise."""
    notebook = nbformat.read(squares.path, as_version=4)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.outputs = [nbformat.v4.new_output("stream", text="the answer is 36")]
            cell.execution_count = 7
    nbformat.write(notebook, squares.path)
    (path,) = write_student_notebooks(tmp_path / "course", [squares])
    assert "answer is 36" not in path.read_text()
    assert '"execution_count": 7' not in path.read_text()


def test_a_students_work_is_not_overwritten(tmp_path, capsys):
    assert main(["student", str(tmp_path), "mimic"]) == 0
    (path,) = tmp_path.iterdir()
    path.write_text("work")
    assert main(["student", str(tmp_path)]) == 2
    assert "it contains 05_mimic.ipynb" in capsys.readouterr().err
    assert path.read_text() == "work"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("study", STUDIES, ids=lambda study: study.stem)
def test_the_lesson_plan_takes_the_notebooks_minutes(study):
    cells = nbformat.read(study.path, as_version=4).cells
    spoken = r"(?:(\d+) x )?(\d+) minutes"
    times, each = next(one for cell in cells for one in re.findall(spoken, cell.source))
    (plan,) = [cell.source for cell in cells if "lesson" in cell.metadata.get("tags", [])]
    steps = re.findall(r"^\| (\d+) \|", plan, re.MULTILINE)
    assert sum(map(int, steps)) == int(times or 1) * int(each)


def test_a_notebook_that_fails_is_named_with_its_cause(tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(students, "execute", lambda *_, **__: "KeyError: 'rho'")
    with pytest.raises(
        ValueError, match=r"Invalid notebook .*mimic\.ipynb: KeyError: 'rho'\. Must"
    ):
        students.answer_table(chosen(["mimic"])[0])
    words = ["student", str(tmp_path / "a"), "mimic", "--sheets", str(tmp_path / "b")]
    assert main(words) == 2
    assert "mimic.ipynb: KeyError: 'rho'. Must run to its end." in capfd.readouterr().err


@pytest.mark.parametrize("study", STUDIES, ids=lambda study: study.stem)
def test_copies_need_no_name_of_a_cell_that_is_left_out_or_waits(study):
    """Given cells run from top to bottom, whatever a student has done so far."""
    assert missing_names(nbformat.read(study.path, as_version=4)) == set()


def missing_names(notebook):
    """The names that given cells of a copy read, and that only cells set which it has not."""
    known, left_out, missing = set(), set(), set()
    for cell in (cell for cell in notebook.cells if cell.cell_type == "code"):
        theirs = {"results", "solution", "number"} & set(cell.metadata.get("tags", []))
        given = not theirs and students._waiting(cell) == cell.source
        for node in ast.parse(TransformerManager().transform_cell(cell.source)).body:
            if given:
                own = stored(node) if isinstance(node, ast.For | ast.With) else set()
                missing |= (loaded(node) - known - own) & left_out
                known |= stored(node)
            else:
                left_out |= stored(node)
    return missing


def test_a_cell_that_reads_what_a_student_has_not_done_is_found(monkeypatch):
    made = {"number": "number = 1", "solution": "# 1: sum\ntotal_m = 3", "results": "kept = 2"}
    made |= {"given": "drawn = [number, 1]", "waits": "drawn[0]", "answer": "total_m * kept"}
    made |= {"set anew": "total_m = 4", "then": "total_m + 1"}
    cells = [
        nbformat.v4.new_code_cell(text, metadata={"tags": [tag]}) for tag, text in made.items()
    ]
    notebook = nbformat.v4.new_notebook(cells=cells)
    assert missing_names(notebook) == {"drawn", "total_m", "kept"}
    monkeypatch.setattr(students, "_waiting", lambda cell: cell.source)
    assert missing_names(notebook) == {"number", "total_m", "kept"}


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("'3,5'", "1: right."),
        ("'3.5'", "1: right."),
        ("3500", "Exercise 1: it is right times 0.001. Check the unit of width_m."),
        ("3.5e6", "Exercise 1: it is right times 1e-06. Check the unit of width_m."),
        ("4", "Exercise 1: not right yet. Check the formula, and the unit of width_m."),
        ("None", "Exercise 1: cannot be checked: width_m is of type NoneType."),
    ],
)
def test_a_hint_says_what_is_wrong_with_an_answer(given, said, capsys):
    text = student_cell("# 1: halve it\nwidth_m = 7 / 2\n# check\nassert abs(width_m - 3.5) < 0.01")
    scope = {}
    try:
        exec(text.replace("width_m = ...", f"width_m = {given}"), scope)
    except exercises.NotRight as error:
        print(*error._render_traceback_())
    assert capsys.readouterr().out.startswith(said)
