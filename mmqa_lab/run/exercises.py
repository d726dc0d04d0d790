"""A student's cells of a notebook: names without values, checks of answers, answers by number.

A notebook imports this room alone, which needs no tools for files of notebooks.
"""

import ast
import base64
import contextlib
import json
import numbers
import textwrap
import zlib

import numpy as np

from mmqa_lab.bench import split_unit

__all__ = ["ASKED", "FEW", "NUMBER", "NotRight", "answer_parts", "check_answer", "names_in"]
__all__ += ["student_cell", "work_out"]

# Begins the line of an answer that states names, types and units. Students see this line.
ASKED = "# asked for: "

# The line of an answer that separates the work from its test.
CHECK = "# check"

# Tag of the cell for the student's number in the class, and name of the number.
NUMBER = "number"

# The numbers of a class in the table of answers.
NUMBERS = range(1, 31)

# Most numbers of an answer in the table of answers.
FEW = 6


def student_cell(source):
    """Return the student's version of an answer's cell: names without values, and the check.

    Parameters
    ----------
    source : str
        Code of a cell tagged ``solution``; its first line is a comment that begins with the
        exercise's number. The code below a line ``# check`` is compressed.

    Returns
    -------
    str

    Examples
    --------
    >>> print(student_cell("# 1: by symmetry\\narea_m2 = 4\\n# check\\nassert area_m2 == 4")[:70])
    # 1: your work
    area_m2 = ...  # m²
    <BLANKLINE>
    from mmqa_lab.run.exercises import
    """
    number, work, answers, check = answer_parts(source)
    kept = [line for line in work.splitlines() if line.startswith((ASKED, "import ", "from "))]
    blanks = [f"{name} = ...  # {split_unit(name)[1]}".rstrip(" #") for name in answers]
    needed = [NUMBER, *answers] if NUMBER in names_in(check, ast.Load) else answers
    task = json.dumps([number, needed, "\n".join([*kept, check])]).encode()
    sealed = textwrap.fill(base64.b64encode(zlib.compress(task, 9)).decode(), 80)
    call = f'check_answer(\n    """\n{sealed}\n""",\n    globals(),\n)'
    call = f"from mmqa_lab.run.exercises import check_answer\n\n{call}"
    return "\n".join([f"# {number}: your work", *kept, *blanks, "", call])


def answer_parts(source):
    """The number and the work of an answer, the names that the check reads of it, and the check."""
    work, _, check = source.partition(f"\n{CHECK}\n")
    read = set(names_in(check, ast.Load)) - set(names_in(check, ast.Store))
    answers = [name for name in dict.fromkeys(names_in(work, ast.Store)) if name in read]
    return source.split(":")[0].lstrip("# "), work, answers, check


class NotRight(AssertionError):
    """The error of an answer; a notebook shows only its sentence."""

    def _render_traceback_(self):
        return [f"Exercise {self}"]


def check_answer(sealed, scope):
    """Check a student's work, and state in a sentence what is wrong.

    Parameters
    ----------
    sealed : str
        The check, compressed by :func:`student_cell`.
    scope : dict
        The notebook's ``globals()``.

    Raises
    ------
    NotRight
        If a name has no value yet, or a check does not hold.
    """
    number, answers, check = unsealed(sealed)
    missing = [name for name in answers if scope.get(name, ...) is ...]
    if missing:
        raise NotRight(f"{number}: give {missing[0]} a value.")
    scope = dict(scope)
    for name in answers:  # as it is written where decimals stand behind a comma
        if isinstance(scope[name], str):
            with contextlib.suppress(ValueError):
                scope[name] = float(scope[name].replace(",", "."))
    known, asked = parts(check, answers)
    named = [name for name in answers if name != NUMBER]
    try:
        exec(known, scope)
        exec(asked, dict(scope))
    except AssertionError as error:
        usual = f"not right yet. Check the formula, and the unit of {', '.join(named)}."
        for power in (-9, -6, -3, -2, 2, 3, 6, 9):
            if named and _holds(asked, scope, named, 10.0**power):
                unit = f"it is right times {10.0**power:g}"
                raise NotRight(f"{number}: {unit}. Check the unit of {', '.join(named)}.") from None
        raise NotRight(f"{number}: {str(error) or usual}") from None
    except Exception:  # the work may have any type
        kinds = ", ".join(f"{name} is of type {type(scope[name]).__name__}" for name in answers)
        raise NotRight(f"{number}: cannot be checked: {kinds}. Give numbers or arrays.") from None
    print(f"{number}: right.")


def unsealed(sealed):
    """The number of an exercise, the names that its check reads, and the check."""
    return json.loads(zlib.decompress(base64.b64decode(sealed)))


def parts(check, answers):
    """Code of a check that is the same for all answers, which may take long, and what is left."""
    known, asked, theirs, read = [], [], set(answers) - {NUMBER}, set()
    for node in ast.parse(check).body:
        words = [one for one in ast.walk(node) if isinstance(one, ast.Name)]
        used = {one.id for one in words if isinstance(one.ctx, ast.Load)}
        made = {one.id for one in words if isinstance(one.ctx, ast.Store)}
        made |= {getattr(node, "name", "")}
        if isinstance(node, ast.Assert) or used & theirs or made & read:
            theirs, read = theirs | made, read | used
            asked.append(node)
        else:
            known.append(node)
    return [compile(ast.Module(part, []), "check", "exec") for part in (known, asked)]


def _holds(check, scope, names, factor):
    """Whether a check holds for the answers times a factor."""
    with contextlib.suppress(Exception):
        exec(check, scope | {name: np.asarray(scope[name], dtype=float) * factor for name in names})
        return True
    return False


def work_out(tasks, scope):
    """Return the numeric answers for each number of the class, as JSON.

    Parameters
    ----------
    tasks : dict
        Code and names of the answers by the exercise's number.
    scope : dict
        A notebook's ``globals()``.

    Examples
    --------
    >>> work_out({"1": ("side = number / 2", ["side"])}, {})[:56]
    '[{"n": 1, "1: side": "0.5"}, {"n": 2, "1: side": "1"}, {'
    """
    rows = {number: {"n": number} for number in NUMBERS}
    for task, (code, names) in tasks.items():
        for number, row in rows.items():
            scope[NUMBER] = number
            with contextlib.redirect_stdout(None):
                exec(code, scope)
            row |= {f"{task}: {name}": _short(scope[name]) for name in names}
            if not any(row[f"{task}: {name}"] for name in names):
                break  # the answer is a table or a curve
    return json.dumps(list(rows.values()))


def _short(answer):
    """A number or a few numbers as text; None for other answers."""
    values = np.ravel(np.asarray(answer, dtype=object))
    if len(values) > FEW or not all(isinstance(v, numbers.Real | np.bool_) for v in values):
        return None
    return ", ".join(f"{float(value):.4g}" for value in values)


def names_in(code, context):
    """Names that code reads or sets, in the order of the code."""
    found = [node for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Name)]
    found = [node for node in found if isinstance(node.ctx, context)]
    return [node.id for node in sorted(found, key=lambda node: (node.lineno, node.col_offset))]
