"""The published tables against the sources' files; rules of the ledger."""

import hashlib
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from mmqa_lab import published
from mmqa_lab.published import ledger

DATA = Path(str(published.DATA))
TABLES = [tuple(row[:2]) for row in published._strings("contents").to_numpy()]

HASH = "7ea597f882fd7b2df3085d81d6dca9b32d4a8b152c5f1165805840edda210542"


def test_no_printed_number_was_changed():
    """The files were compared cell by cell with the sources' tables when they had this hash."""
    names = sorted(f"{source}/{table}.csv" for source, table in TABLES)
    content = b"".join((DATA / name).read_bytes() for name in names)
    assert hashlib.sha256(content).hexdigest() == HASH


# The loader


def test_a_table_is_a_new_frame_each_time():
    first = published.table("pfeifer2021", "table_2")
    first.loc[0, "f"] = 99
    assert published.table("pfeifer2021", "table_2").loc[0, "f"] == 11.8


# The ledger


def test_cells_are_unique_and_each_has_a_reason():
    cells = ledger.cells()
    assert not cells.duplicated(["source", "table", "cell"]).any()
    empty = ledger.collect("no such folder")
    assert empty.loc[empty["note"] == "", "cell"].tolist() == []
    assert set(cells["role"]) == {"result", "set-up", "threshold", "literature"}


@pytest.mark.parametrize(
    ("source", "tables", "counts"),
    [
        ("pfeifer2021", "1 2", [12 + 24 + 24, 6 * 5]),
        ("poreba2013", "1 2", [4 * 3 + 8 * 4, 3 * 2 + 1 + 6 * 4]),
        ("cahalane2014", "2 3 4 5 6", [4 * 2, 5 * 3, 9 * 3, 6 * 3, 14 - 3]),
        ("eurosdr2013_mls", "3_3 3_4 4_1 4_2", [14 * 4, 12 * 6, 4, 2]),
    ],
)
def test_every_printed_number_is_a_cell(source, tables, counts):
    cells = ledger.cells().query("source == @source")["table"].value_counts()
    assert [cells[f"table_{number}"] for number in tables.split()] == counts


@pytest.mark.parametrize(
    ("table", "cell", "low", "high"),
    [
        ("pfeifer2021/table_2", "C 10 m density", 30914.5, 30915.5),
        ("pfeifer2021/table_1", "A 10 m backward h line-pair width", 40, np.inf),
        ("pfeifer2021/table_1", "A 10 m forward v line-pair width", 30, np.inf),
        ("pfeifer2021/table_1", "A 10 m forward h pixel size", np.nan, np.nan),
        ("pfeifer2021/table_1", "C 5 m orthogonal legibility", 1.5, 2.5),
        ("pfeifer2021/table_1", "C 5 m orthogonal h pixel size", 3.95, 4.05),
        ("poreba2013/table_1", "Course1-Course2 left detection rate", 99.895, 99.905),
        ("poreba2013/numbers", "absolute_abstract", -np.inf, 0.7),
        ("poreba2013/numbers", "precision_text", 0.2, 0.4),
        ("cahalane2014/table_3", "wall 1 mimic", 0.0815, 0.0825),
        ("eurosdr2013_mls/poles_text", "missed_points_around", 40, 60),
        ("eurosdr2013_radiometry/calibration_results", "dmc_r2_sjokulla", 0.993, np.inf),
        ("eurosdr2013_radiometry/reflectance_results", "empirical_line_rmse", 2.5, 7.5),
        ("eurosdr2013_radiometry/reflectance_results", "xpro_uniform", -np.inf, 5.5),
    ],
)
def test_the_interval_of_values_that_print_alike(table, cell, low, high):
    cells = ledger.cells()
    place = cells["source"] + "/" + cells["table"]
    row = cells[(place == table) & (cells["cell"] == cell)].iloc[0]
    assert row[["low", "high"]].tolist() == pytest.approx([low, high], nan_ok=True)


NAN = np.nan


@pytest.mark.parametrize(
    ("printed", "ours", "expected"),
    [
        (("=", 3.5, 4.5), (3.5, NAN, NAN), "reproduced"),
        (("=", 3.5, 4.5), (4.6, NAN, NAN), "differs"),
        (("=", 3.5, 4.5), (NAN, NAN, NAN), "not comparable"),
        (("=", 40, np.inf), (40, NAN, NAN), "differs"),
        (("=", 40, np.inf), (41, NAN, NAN), "reproduced"),
        (("=", 40, np.inf), (39, 38, 41), "consistent"),
        (("=", NAN, NAN), (NAN, NAN, NAN), "reproduced"),
        (("=", NAN, NAN), (12.0, NAN, NAN), "differs"),
        (("<", -np.inf, 0.7), (0.6, NAN, NAN), "consistent"),
        (("<", -np.inf, 0.7), (0.7, NAN, NAN), "differs"),
        (("<", -np.inf, 0.7), (0.8, 0.5, 1.1), "consistent"),
        (("<", -np.inf, 0.7), (0.8, 0.5, NAN), "consistent"),
        (("about", 0.2, 0.4), (0.3, NAN, NAN), "consistent"),
        (("range", 2.5, 7.5), (7.6, NAN, NAN), "differs"),
    ],
)
def test_verdicts(printed, ours, expected):
    printed = dict(zip(("relation", "low", "high"), printed, strict=True))
    ours = dict(zip(("value", "low", "high"), ours, strict=True))
    assert ledger.verdict(printed, ours) == expected


D1 = {"source": "pfeifer2021", "table": "table_2", "cell": "A 5 m d1"}


def write(folder, study, entries):
    (folder / study).mkdir()
    pd.DataFrame(entries, columns=ledger.COLUMNS).to_csv(folder / study / "ledger.csv", index=False)


def test_collect_keeps_every_value_and_lets_one_decide(tmp_path):
    rows = [
        D1 | {"value": 6.0, "kind": "fitted"},
        D1 | {"value": 4.2, "kind": "measured", "low": 3.9, "high": 4.5},
        D1 | {"cell": "A 5 m f", "kind": "measured", "note": "No point has four neighbours."},
    ]
    write(tmp_path, "b", ledger.entries(rows))
    write(tmp_path, "a", ledger.entries([D1 | {"value": 4.9, "high": 5.0}], kind="predicted"))
    found = ledger.collect(tmp_path)
    d1 = found.query("cell == 'A 5 m d1'")
    assert d1["kind"].tolist() == ["predicted", "measured", "fitted"]
    assert d1["verdict"].tolist() == ["differs", "reproduced", "differs"]
    assert d1["decides"].tolist() == [True, False, False]
    assert d1["study"].tolist() == ["a", "b", "b"]
    assert found["decides"].sum() == len(ledger.cells())
    f = found.query("cell == 'A 5 m f' and source == 'pfeifer2021'").iloc[0]
    assert (f["verdict"], f["note"]) == ("not comparable", "No point has four neighbours.")
    argued = found[found["verdict"].isin(["differs", "not comparable"])]
    assert argued.loc[argued["note"] == "", "study"].tolist() == ["a", "b"]
    counts = ledger.summary(found)
    assert counts.loc["pfeifer2021", "differs"] == 1
    results = (ledger.cells()["role"] == "result").sum()
    assert counts.loc["all"].sum() == results
    waiting = ledger.summary(ledger.collect(tmp_path, not_run=["pfeifer2021 table_2"]))
    assert waiting["not run"].tolist() == [30 - 2, 0, 0, 0, 0, 28]  # two are answered above
    assert waiting.loc["pfeifer2021", "not comparable"] == counts.iloc[0]["not comparable"] - 28


@pytest.mark.parametrize(
    ("column", "word", "message"),
    [
        ("cell", "A 5 m d9", "Invalid cell pfeifer2021 table_2 A 5 m d9"),
        ("table", "table_9", "Invalid cell pfeifer2021 table_9 A 5 m d1"),
        ("kind", "guessed", "Invalid kind 'guessed'"),
    ],
)
def test_collect_refuses_what_it_does_not_know(tmp_path, column, word, message):
    table = ledger.entries([D1 | {"value": 4.0}], kind="measured")
    write(tmp_path, "a", table.assign(**{column: word}))
    with pytest.raises(ValueError, match=re.escape(message)):
        ledger.collect(tmp_path)


def test_a_fit_is_no_reproduction():
    printed = {"relation": "=", "low": 14.5, "high": 15.5}
    ours = {"value": 15.0, "low": NAN, "high": NAN}
    assert ledger.verdict(printed, ours | {"kind": "predicted"}) == "reproduced"
    assert ledger.verdict(printed, ours | {"kind": "fitted"}) == "fitted"


def test_every_cell_stands_in_its_table():
    marks = {"a": 1.0, "b": 2.0, "c": 3.0}
    for place, cells in ledger.cells().groupby(["source", "table"]):
        table = published.raw(*place)
        there = set(pd.to_numeric(table.stack(), errors="coerce")) | set(marks.values())
        assert set(cells["value"].dropna()) <= there
        texts = set(table.stack()) | {f"{a} {b}" for a in ("<", "about") for b in table.stack()}
        if "status" not in table:
            assert set(cells["printed"]) <= texts | set(cells["printed"][cells["relation"] != "="])


def test_one_row_decides_whatever_the_order_of_the_table(tmp_path):
    rows = [D1 | {"value": 9.0, "kind": "predicted"}, D1 | {"value": 4.0, "kind": "measured"}]
    write(tmp_path, "a", ledger.entries(rows))
    collected = ledger.collect(tmp_path).query("decides and cell == 'A 5 m d1'")["verdict"].item()
    for order in (rows, rows[::-1]):
        assert ledger.verdicts(ledger.entries(order)).tolist() == [collected] == ["differs"]
