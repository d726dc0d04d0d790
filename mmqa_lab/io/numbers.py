"""Numbers in tables of text, as people and programs write them, and texts that are none."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd

from mmqa_lab._checks import refuse

__all__ = ["parsed"]

# Columns that name something: 001, 1E5 and NA are names there. Nothing in the last three is "".
NAME_COLUMNS = (
    *("name", "id", "system", "criterion", "quantity"),
    *("image", "file", "crop", "juror", "code"),
)
REMARK_COLUMNS = ("reason", "remarks", "rejected_by")

# What stands for no number, also in C and in spreadsheets; a number; one that must be a name.
MISSING_WORDS = r"(?:-?nan(?:\(s?n?a?n?(?:ind)?\))?|n/?a|null|none|<na>|-|#n/a)?"
PLAIN_NUMBER = r"[+-]?(?:\d+(?:[.,]\d+)*[.,]?|[.,]\d+)(?:e[+-]?\d+)?(?:\s?%)?|[+-]?inf(?:inity)?"
MISSING_ENTRY = re.compile(rf"^{MISSING_WORDS}$", re.I | re.M)
NO_PLAIN_NUMBER = re.compile(rf"^(?!(?:{PLAIN_NUMBER}|{MISSING_WORDS})$).*$", re.I | re.M)
LEADING_ZEROS = re.compile(r"^0\d+$", re.M)

# So many columns of nothing but numbers with three digits behind a sign are no thousands.
FEWEST_ALIKE = 3

# Blanks and apostrophes between groups of three digits.
GAPS = re.compile(r"(?<=\d)[ '\u2019\u00a0\u202f](?=\d{3}(?!\d))")


def parsed(table: pd.DataFrame, what: str, *, separator: str = ",") -> pd.DataFrame:
    """Return a table of texts with numbers in the columns that hold nothing else.

    Decimal commas or points, thousands between commas, points, blanks or apostrophes and percent
    (5% is 0.05) are told by all of the columns together: 3,250 beside 448000.257 is 3250, beside
    2,5 it is 3.25. Where nothing tells, as of 3,250 alone, or 3.250 between semicolons: ValueError.

    Examples
    --------
    >>> texts = pd.DataFrame({"system": ["001", "NA"], "value": ["3.250", "2,5"]})
    >>> parsed(texts, "results r.csv").to_numpy().tolist()
    [['001', 3250.0], ['NA', 2.5]]
    """
    found, numbers = {}, {}
    for name in table:
        texts = table[name].fillna("").astype(str).str.strip()
        plain, text = str(name).lower().strip(), GAPS.sub("", "\n".join(texts))
        names = (
            plain in (*NAME_COLUMNS, *REMARK_COLUMNS)
            or NO_PLAIN_NUMBER.search(text)
            or LEADING_ZEROS.search(text)
        )
        if names:
            found[name] = texts.where(
                texts != "", "" if plain in REMARK_COLUMNS else np.nan
            ).astype(object)
        else:
            numbers[name] = text
    few = len(numbers) < FEWEST_ALIKE
    comma = _has_decimal_commas("\n".join(numbers.values()), what, separator, few)
    for name, text in numbers.items():
        percent = "" if re.search("percent|%", str(name).lower()) else "e-2"
        bare = text.replace("." if comma else ",", "").replace(",", ".")
        bare = re.sub(r"\s?%", percent, MISSING_ENTRY.sub("nan", bare)) if len(table) else ""
        values = pd.Series([*map(float, bare.split())], table.index, dtype=np.float64)
        whole = re.fullmatch(r"[-+\d\s]*", bare) and values.abs().max() < 2**53
        found[name] = values.astype(np.int64) if whole else values
    return pd.DataFrame({name: found[name] for name in table})


def _has_decimal_commas(text, what, separator, few):
    """Whether numbers, one in a line, have decimal commas; a sentence if that cannot be told.

    Not all numbers of several columns are thousands: then they are decimals.
    """
    points, commas, doubted = None, None, {}
    for mark, other in (".,", ",."):
        alone = rf"[+-]?[1-9]\d{{0,2}}[{mark}]\d{{3}}$"
        neither = rf"[^{mark}{other}\n]*"
        last = rf"^(?!{alone})(?:[^{mark}\n]*[{other}])?{neither}[{mark}]{neither}$"
        twice = rf"^.*[{other}].*[{other}].*$"
        told = re.search(last, text, re.M) or re.search(twice, text, re.M)
        points, commas = (told, commas) if mark == "." else (points, told)
        if mark == "," or separator == ";":
            doubted[mark] = re.search(f"^{alone}", text, re.M)
            if doubted[mark] and not few and not re.search(f"^(?!{alone})", text, re.M):
                return mark == ","
    if points and commas:
        found = f"decimal points, as in {points[0]}, and commas, as in {commas[0]}"
        refuse(True, what, found, "numbers of one kind")
    if (unsure := doubted.get(",") or doubted.get(".")) and not points and not commas:
        one = unsure[0]
        found = f"{one} may be {re.sub('[.,]', '', one)} or {one.replace(',', '.')}"
        refuse(True, what, found, "numbers without thousands separators")
    return bool(commas)
