"""Numbers as people and programs write them, and texts that stay texts."""

from contextlib import nullcontext as nothing

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmqa_lab import io
from mmqa_lab.io.numbers import parsed

VALUES = [0.5, -12.25, 3250.0, 1_234_567.125, 40.0, 12_000.0, -0.125]


def written(value, decimal, group):
    """A number with its groups of thousands and its decimal sign."""
    text = f"{value:,.3f}".rstrip("0").rstrip(".")
    return text.replace(",", "_").replace(".", decimal).replace("_", group)


@settings(deadline=None, max_examples=60)
@given(
    marks=st.sampled_from([(".", ""), (",", ""), (".", ","), (",", "."), (",", " "), (".", "'")]),
    order=st.permutations(range(len(VALUES))),
    separator=st.sampled_from([";", "\t"]),
)
def test_numbers_of_any_form_are_the_same(tmp_path_factory, marks, order, separator):
    path = tmp_path_factory.mktemp("numbers") / "t.csv"
    rows = [f"A{k}{separator}{written(VALUES[k], *marks)}\n" for k in order]
    path.write_text(f"system{separator}value\n" + "".join(rows), encoding="utf-8")
    table = io.read_table(path, "results")
    assert table["value"].tolist() == [VALUES[k] for k in order]


@pytest.mark.parametrize(("entries", "separator", "expected"), [
    (["3.250", "2,5"], ",", [3250, 2.5]),
    (["5.400.000,06", "1"], ";", [5_400_000.06, 1]),
    (["5%", "22 %", "", "#N/A"], ",", [0.05, 0.22, np.nan, np.nan]),
    (["1e5", "-2.5E-1", "-nan(ind)", "inf"], ",", [1e5, -0.25, np.nan, np.inf]),
    (["3,250", "2,890"], ",", "3,250 may be 3250 or 3.250"),
    (["3.250", "2.890"], ";", "3.250 may be 3250 or 3.250"),
    (["3.250", "2.890"], ",", [3.25, 2.89]),
    (["1,5", "2.5"], ",", "decimal points, as in 2.5, and commas, as in 1,5"),
    (["001", "002"], ",", ["001", "002"]),
    (["1", "2", "?"], ",", ["1", "2", "?"]),
])  # fmt: skip
def test_entries_of_a_column(entries, separator, expected):
    table = pd.DataFrame({"value": entries})
    if isinstance(expected, str):
        with pytest.raises(ValueError, match=f"Invalid results: {expected}"):
            parsed(table, "results", separator=separator)
        return
    found = parsed(table, "results", separator=separator)["value"].tolist()
    assert found == pytest.approx(expected, nan_ok=True) if expected[0] != entries[0] else expected


def test_names_stay_as_they_stand_and_no_reason_is_none(tmp_path):
    """A result survives its own CSV file, and neither 1.10 nor NA becomes something else."""
    names = ["001", "1E5", "NA", "1.10"]
    before = pd.DataFrame({"system": names, "reason": [""] * 4, "dz_m": [1.5, np.nan, 2, 3]})
    io.write_atomically(tmp_path / "t.csv", before)
    pd.testing.assert_frame_equal(io.read_table(tmp_path / "t.csv", "t"), before, check_dtype=False)
    before.to_excel(tmp_path / "t.xlsx", index=False)
    again = io.read_table(tmp_path / "t.xlsx", "t")
    pd.testing.assert_frame_equal(again, before, check_dtype=False)


@pytest.mark.parametrize("title", ["Results of drive 3,,\n", "Results of drive 3\n", "sep=,\n"])
def test_titles_above_the_header_are_passed_over(tmp_path, title):
    (tmp_path / "t.csv").write_text(title + "system,quantity,value\nA,f,1.5\n")
    assert io.read_table(tmp_path / "t.csv", "t")["value"].tolist() == [1.5]


@pytest.mark.parametrize(("text", "column"), [
    ("code,x,y,z\n#NV,1,2,3\nok,4,5,6\n#REF!,7,8,9\n", "code"),
    ("id,x,y,z\nP#0,1,2,3\n12//1,4,5,6\nP# 2,7,8,9\n", "id"),
    ("No#,x,y,z\n0,1,2,3\n1,4,5,6\n2,7,8,9 # the last\n", "No#"),
    ("Levelled 2025,,,\nid,x,y,z\n0,1,2,3\n1,4,5,6\n2,7,8,9\n", "id"),
    ("id,x,y,z\n,(m),(m),(m)\n0,1,2,3\n1,4,5,6\n2,7,8,9\n", "id"),
])  # fmt: skip
def test_no_row_is_lost_to_marks_within_it(tmp_path, text, column):
    (tmp_path / "c.csv").write_text(text)
    with (
        pytest.warns(UserWarning, match="above the header") if text.startswith("Lev") else nothing()
    ):
        cloud = io.read_cloud(tmp_path / "c.csv")
    assert cloud.points.ravel().tolist() == [*range(1, 10)]
    assert any(name.startswith(column) for name in cloud.columns)
