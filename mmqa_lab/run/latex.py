"""Tables and numbers of a run for a paper in LaTeX."""

from __future__ import annotations

import re

from mmqa_lab._results import digits, printed
from mmqa_lab.plots import with_symbols

__all__ = ["as_latex", "macro"]

# Signs that LaTeX's usual fonts lack.
LATEX = str.maketrans(
    {"≥": r"$\geq$", "≤": r"$\leq$", "−": "--", "–": "--", "→": r"$\to$"}
    | {"√": r"$\surd$", "ρ": r"$\rho$", "σ": r"$\sigma$", "λ": r"$\lambda$", "∞": r"$\infty$"}
)

# Begins a table that is made smaller if it is wider than the text; a brace ends it.
FITTED = r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%"

DIGITS = ("zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")


def as_latex(frame, name, kind):
    """A table for a paper: no wider than its column, the kind in its caption, symbols in italics.

    It needs the packages booktabs and graphicx.
    """
    if "kind" in frame and frame["kind"].nunique() == 1:
        frame = frame.drop(columns="kind")
    text = printed(frame, missing="--").to_latex(index=False, escape=True, na_rep="--")
    lines = map(with_symbols, text.strip().splitlines())
    text, said = "\n".join(lines).translate(LATEX), f" Numbers: {kind}." if kind else ""
    caption = f"\\caption{{{name.replace('_', ' ').capitalize()}.{said}}}"
    return "\n".join(
        [r"\begin{table}", r"\centering", caption, FITTED, f"{text}}}", r"\end{table}"]
    )


def macro(name, value, unit, kind):
    """A named number as a LaTeX macro, whose name has letters only: digits become words."""
    spelled = re.sub(r"\d", lambda digit: f"_{DIGITS[int(digit[0])]}_", name)
    camel = "".join(part.capitalize() for part in re.split(r"[^A-Za-z]+", spelled))
    return f"\\newcommand{{\\mmqa{camel}}}{{{digits(value)}}} % {unit}, {kind}"
