"""Tries to pass an exercise's check without the work: by guesses, and by a neighbour's answer."""

import ast
from unittest import mock

from mmqa_lab.run import exercises
from mmqa_lab.run.exercises import student_cell

GUESSES = (0, 1, 2, 3, 5, 10, 20, 100, 500, 1000, 0.01, 0.1, 0.5, 0.9, 0.95, True, False, "1", [])


def around(source):
    """Code for a cell in front of an answer and for one behind it; they raise where one passes."""
    work, check = student_cell(source).split("\n\n", 1)
    names = [line.split(" = ")[0] for line in work.splitlines() if " = ..." in line]
    first = f"import guesses\nguesses.refuse({check!r}, globals(), {names!r})"
    own = any(getattr(node, "id", "") == "number" for node in ast.walk(ast.parse(source)))
    return first, f"import guesses\nguesses.refuse_neighbour({check!r}, globals(), own={own})"


def refuse(check, scope, names):
    """Raise where a check passes with the same guess for all names.

    What no answer changes is worked out once, for it may take long.
    """
    sealed = next(one.value for one in ast.walk(ast.parse(check)) if _is_text(one))
    _, answers, text = exercises.unsealed(sealed)
    known, asked = exercises.parts(text, answers)
    exec(known, scope := dict(scope))
    with mock.patch.object(exercises, "parts", return_value=("", asked)):
        passed = [g for g in GUESSES if _passes(check, scope | dict.fromkeys(names, g))]
    if passed:
        raise RuntimeError(f"{names} pass with {passed}.")


def refuse_neighbour(check, scope, *, own):
    """Raise where the answer does not pass, or passes for the next number in the class too."""
    if not _passes(check, dict(scope)):
        raise RuntimeError("The answer does not pass.")
    if own and _passes(check, scope | {"number": scope["number"] + 1}):
        raise RuntimeError("The answer of a neighbour passes.")


def _is_text(node):
    """Whether a part of a check is its sealed text."""
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def _passes(check, scope):
    """Whether a check passes with these names."""
    try:
        exec(check, scope)
    except AssertionError:
        return False
    return True
