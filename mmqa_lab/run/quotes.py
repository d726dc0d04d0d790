"""What a paper quotes of a run: tables for LaTeX, and values for LaTeX and Typst."""

from __future__ import annotations

import re
import unicodedata

from mmqa_lab._results import printed
from mmqa_lab.plots import with_symbols

__all__ = ["as_latex", "escaped", "quoted_name", "values_tex", "values_typ"]

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
    caption = f"\\caption{{{escaped(name.replace('_', ' ').capitalize())}.{said}}}"
    return "\n".join(
        [r"\begin{table}", r"\centering", caption, FITTED, f"{text}}}", r"\end{table}"]
    )


def escaped(text):
    """Return a text for LaTeX: its signs are letters, symbols are in italics.

    >>> escaped("50 % of x_1 & more, f ≥ 2")
    '50 \\\\% of x\\\\_1 \\\\& more, $f$ $\\\\geq$ 2'
    """
    return with_symbols(re.sub(r"([%&#_{}$])", r"\\\1", text)).translate(LATEX)


def quoted_name(study, name):
    """The name of a study's value in a paper: letters only; digits and Greek letters are words.

    >>> quoted_name("fitness", "f_2_of_a"), quoted_name("mimic", "σ_mm")
    ('mmqaFitnessFTwoOfA', 'mmqaMimicSigmaMm')
    """
    return "mmqa" + "".join(_word(part) for part in re.findall(r"\d|[^\W\d_]+", f"{study}_{name}"))


def _word(part):
    """A part of a name with a capital: a digit as its word, letters other than Latin by name."""
    if part.isdigit():
        return DIGITS[int(part)].capitalize()
    return "".join(
        one if one.isascii() else unicodedata.name(one).split()[-1].lower() for one in part
    ).capitalize()


def values_tex(rows):
    """Return values as macros of LaTeX; ``rows`` have quoted, text, unit and kind."""
    return "".join(
        f"\\newcommand{{\\{row['quoted']}}}{{{escaped(row['text'])}}} "
        f"% {row['unit']}, {row['kind']}\n"
        for row in rows
    )


def values_typ(rows):
    """Return values as names of Typst; ``rows`` have quoted, text, unit and kind."""
    return "".join(
        f'#let {row["quoted"]} = [#"{row["text"].replace("-", "−")}"]'
        f" // {row['unit']}, {row['kind']}\n"
        for row in rows
    )
