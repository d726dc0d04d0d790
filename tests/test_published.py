"""The published tables against the sources' files and against themselves; rules of the ledger."""

import os
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from mmqa_lab import published
from mmqa_lab.published import ledger

DATA = Path(str(published.DATA))
ORIGINALS = Path(os.environ.get("MMQA_DATA", "no folder")).parent / "published"
TABLES = [tuple(row[:2]) for row in published._strings("contents").to_numpy()]

FILES = {
    "table_3_1": "table_3_1_systems",
    "table_3_2": "table_3_2_specifications",
    "table_3_3": "table_3_3_elevation",
    "table_3_4": "table_3_4_planimetry",
    "table_4_1": "table_4_1_fgi",
    "table_4_2": "table_4_2_itc",
    "poles_text": "poles_text_4_1_3",
    "eurosdr2013_radiometry/table_1": "table_1_participants",
    "eurosdr2013_radiometry/table_2": "table_2_interest_groups",
    "eurosdr2013_radiometry/table_3": "table_3_objectives",
    "eurosdr2013_radiometry/table_4": "table_4_resolution_methods",
    "eurosdr2013_radiometry/table_5": "table_5_processing_versions",
}
RENAMED = {
    "precision_sigma_mad_mm": "sigma_mad_mm",
    "density_printed": "density_per_m2_printed",
    "parameter": "quantity",
}
ALIKE = {"precision_printed": "sigma_mad_mm", "d1_printed": "d1_mm", "d4_printed": "d4_mm"}
ALIKE["f_printed"] = "f"
WORDS = {"available": {"yes": "printed", "no": "not_available"}}
EXEMPTION = "same points as density (so 5 m); see {}section 3.3"
WORDS["remark"] = {
    EXEMPTION.format("exemption in facts.md "): EXEMPTION.format("the exemption of ")
}
ADDED = {"id", "relation", "role", "status", "note", "comparison", "text", "unit", "printed"}
ADDED |= {"threshold", "distance"}
TABLE_6 = {
    "err_m": "error",
    "alpha_scan_deg": "alpha_scan",
    "gamma_scan_deg": "gamma_scan",
    "alpha_targ_deg": "alpha_targ",
    "beta_targ_deg": "beta_targ",
    "mirror_frequency_hz": "mirror frequency",
    "velocity_m_s": "velocity",
}


# The package's files against the sources' files


def differences(source, table, data=DATA):
    """Sentences on every cell of a package table that differs from the source's CSV."""
    ours = pd.read_csv(data / source / f"{table}.csv", dtype=str, keep_default_na=False)
    theirs = _original(source, table)
    found = []
    if len(ours) < len(theirs) or (len(ours) > len(theirs) and table != "numbers"):
        found.append(f"{source} {table}: {len(ours)} rows instead of {len(theirs)}")
    for (row, mine), (_, other) in zip(ours.iterrows(), theirs.iterrows(), strict=False):
        found += [
            f"{source} {table} row {row + 1} column {column}: {_ours(mine, column)!r} instead of "
            f"{cell!r}"
            for column, cell in other.items()
            if not _same(mine, column, cell)
        ]
    extra = set(ours) - set(theirs.rename(columns=RENAMED)) - ADDED
    return found + [f"{source} {table}: added column {column}" for column in sorted(extra)]


def _original(source, table):
    """The source's CSV, Table 6 of Cahalane brought into one row for each cell."""
    name = FILES.get(f"{source}/{table}") or FILES.get(table, table)
    frame = pd.read_csv(ORIGINALS / source / f"{name}.csv", dtype=str, keep_default_na=False)
    if (source, table) != ("cahalane2014", "table_6"):
        return frame
    long = frame.melt("surface", var_name="quantity", value_name="printed", ignore_index=False)
    long = long.sort_index(kind="stable").rename(columns={"surface": "output"})
    long["quantity"] = long["quantity"].map(TABLE_6)
    long["value"] = long["printed"].where(long["printed"] != "n/a", "")
    return long.reset_index(drop=True)


def _ours(mine, column):
    """The package's cell that stands for a column of the source."""
    column = RENAMED.get(column, ALIKE.get(column, column))
    if column == "available":
        return mine["status"]
    if column == "value" and "text" in mine:
        return mine["value"] + mine["text"]
    if column == "threshold":
        return mine["printed"]
    if column == "distance_m" and "distance" in mine:
        return mine["distance"]
    return mine.get(column)


def _same(mine, column, cell):
    """Whether the package's row says what a cell of the source says."""
    ours = _ours(mine, column)
    if column == "unit":
        return _same_unit(mine, cell)
    if column == "quantity" and cell.endswith(("_mm", "_per_m2")):
        return ours.replace("-", " ") == re.sub("_mm|_per_m2", "", cell).replace(
            "line_pair_width", "line pair width"
        ).replace("pixel_size", "pixel size")
    if column == "value" and "printed" in mine and not _is_number(cell):
        return ours == "" and cell in ("", mine["printed"].replace("–", "-"), _principle(mine))
    if {"low", "high"} <= set(mine.index) and column in ("low", "high"):
        return ours == cell or (mine["relation"] == ">" and ours == "" and mine["low"] == cell)
    return ours == WORDS.get(column, {}).get(cell, cell)


def _same_unit(mine, cell):
    """Units agree; what stood beside the unit stands in the note."""
    unit, note = mine["unit"], mine.get("note", "")
    if cell == "":
        return unit == ""
    rest = cell.replace("degree", "deg").removeprefix(unit).strip(" (),")
    return rest == "" or rest in note


def _principle(mine):
    """The word that the source's file derives from the printed principle of measurement."""
    return mine["printed"].split(",")[0].lower() if "principle" in mine["quantity"] else None


def _is_number(cell):
    """Whether a string is a number."""
    return re.fullmatch(r"-?\d+(\.\d+)?", cell) is not None


with_originals = pytest.mark.skipif(
    not ORIGINALS.is_dir(), reason="needs the sources' CSV files beside the folder of MMQA_DATA"
)
compared = [(s, t) for s, t in TABLES if t != "derived"]
written_here = [("pfeifer2021", "numbers")]
written_here += [("eurosdr2013_mls", "numbers"), ("eurosdr2013_radiometry", "numbers")]


@with_originals
@pytest.mark.parametrize(("source", "table"), [c for c in compared if c not in written_here])
def test_every_cell_is_that_of_the_source(source, table):
    assert differences(source, table) == []


@with_originals
def test_every_file_of_the_sources_is_in_the_package():
    files = {(file.parent.name, file.stem) for file in ORIGINALS.glob("*/*.csv")}
    names = {(s, FILES.get(f"{s}/{t}") or FILES.get(t, t)) for s, t in TABLES}
    assert files - names == set()


@with_originals
@pytest.mark.parametrize(
    ("source", "table", "column"),
    [
        ("pfeifer2021", "table_1", "printed"),
        ("pfeifer2021", "table_2", "d4_mm"),
        ("poreba2013", "table_2", "olhd_m"),
        ("cahalane2014", "table_6", "printed"),
        ("eurosdr2013_mls", "table_3_3", "std_cm"),
        ("eurosdr2013_mls", "reference_data", "value"),
        ("eurosdr2013_radiometry", "reflectance_results", "high"),
    ],
)
def test_a_changed_cell_is_named(tmp_path, source, table, column):
    copy = shutil.copytree(DATA, tmp_path / "data")
    frame = pd.read_csv(copy / source / f"{table}.csv", dtype=str, keep_default_na=False)
    frame.loc[2, column] = "77"
    frame.to_csv(copy / source / f"{table}.csv", index=False)
    named = [sentence.split(":")[0] for sentence in differences(source, table, copy)]
    assert f"{source} {table} row 3 column {column}" in named
    assert {name.split(" column ")[0] for name in named} == {f"{source} {table} row 3"}


@with_originals
@pytest.mark.parametrize(("source", "table"), written_here)
def test_numbers_that_no_file_of_the_source_has_stand_in_its_facts(source, table):
    facts = (ORIGINALS / source / "facts.md").read_text(encoding="utf-8")
    facts = facts.replace("half a day", "0.5 day").replace("5 cm", "5 cm 5").lower()
    words = {"0": "no system", "1": "one", "2": "two", "3": "three", "8": "eight", "5": "five"}
    for row in published.raw(source, table).to_dict("records"):
        value = row["value"]
        alone = re.search(rf"(?<![\d.]){re.escape(value)}(?!\d|\.\d)", facts)
        assert alone or words.get(value, "\0") in facts, f"{source} {table} {row['id']}: {value}"


# The tables against themselves


def test_units_that_the_source_has_in_its_names_of_columns():
    table = published.table("pfeifer2021", "table_1")
    assert (table["unit"] == np.where(table["quantity"] == "legibility", "mark", "mm")).all()
    table = published.table("cahalane2014", "table_6").set_index("quantity")["unit"]
    angles = ["alpha_scan", "gamma_scan", "alpha_targ", "beta_targ"]
    units = dict.fromkeys(angles, "deg") | {"error": "m", "mirror frequency": "Hz"}
    assert table.to_dict() == units | {"velocity": "m/s"}


def test_thresholds_of_criteria_equal_their_printed_strings():
    table = published.table("pfeifer2021", "criteria")
    for number, string in (("threshold", "printed"), ("distance_m", "distance")):
        expected = pd.to_numeric(table[string], errors="coerce")
        assert table[number].equals(expected.astype(float))
    assert set(table.loc[table["threshold"].isna(), "printed"]) == {"b"}


def test_comparisons_of_poreba_name_their_data_sets():
    for name in ("table_1", "table_2"):
        table = published.table("poreba2013", name)
        again = table["data_sets"].where(table["row"] != 3, table["data_sets"] + " second")
        assert (table["comparison"] == (again if name == "table_1" else table["data_sets"])).all()


@pytest.mark.parametrize(
    ("source", "table"), [t for t in TABLES if "relation" in published.raw(*t)]
)
def test_relations_say_what_is_printed(source, table):
    for row in published.raw(source, table).to_dict("records"):
        low, high = row.get("low", ""), row.get("high", "")
        words = " ".join(str(row.get(k, "")) for k in ("quantity", "statement"))
        if re.search("better than|lower than|, below$|well below", words) and not low:
            assert row["relation"] == "<", words
        if words.endswith(("up to", "(up to)")):
            assert row["relation"] == "up to", words
        if words.endswith(("more than", ", over", ", above")):
            assert row["relation"] == ">", words
        if low and high and low != high:
            assert row["relation"] == "range", words
        empty = not (row.get("value") or row.get("threshold") or low or high)
        assert (row["relation"] == "") <= empty, words


def within(value, low, high):
    return (low - 1e-9 <= value) & (value <= high + 1e-9)


def test_pfeifer_table_1_has_its_marks_numbers_and_dashes():
    table = published.table("pfeifer2021", "table_1")
    counts = table.groupby(["quantity", "status"]).size().to_dict()
    assert counts == {
        ("legibility", "printed"): 12,
        ("legibility", "not_evaluated"): 6,
        ("pixel size", "printed"): 23,
        ("pixel size", "not_resolved"): 1,
        ("pixel size", "not_evaluated"): 12,
        ("line-pair width", "printed"): 22,
        ("line-pair width", "not_resolved"): 2,
        ("line-pair width", "not_evaluated"): 12,
    }
    numbers = table[table["quantity"] != "legibility"]
    assert (numbers["value"].notna() == (numbers["status"] == "printed")).all()
    assert ((table["printed"] == "") == (table["status"] == "not_evaluated")).all()
    empty = table[table["status"] == "not_evaluated"]
    assert (empty["distance_m"] == 5).all()
    assert set(empty["view"]) == {"forward", "backward"}


def test_pfeifer_table_1_numbers_equal_their_printed_strings():
    table = published.table("pfeifer2021", "table_1").dropna(subset="value")
    assert (table["printed"].astype(float) == table["value"]).all()
    widths = table.query("quantity == 'line-pair width'")["value"]
    assert set(widths) <= {40, 30, 20, 15, 10, 8, 6, 4, 2}


def test_pfeifer_table_2_f_is_d4_over_d1_within_rounding():
    table = published.table("pfeifer2021", "table_2")
    low = (table["d4_mm"] - 0.5) / (table["d1_mm"] + 0.5) - 0.05
    high = (table["d4_mm"] + 0.5) / (table["d1_mm"] - 0.5) + 0.05
    assert within(table["f"], low, high).all()
    printed = table["density_per_m2_printed"].str.replace(",", "").astype(float)
    assert (printed == table["density_per_m2"]).all()


@pytest.mark.parametrize("name", ["table_1", "table_2"])
def test_poreba_detection_rates_follow_from_the_counts(name):
    table = published.table("poreba2013", name)
    errors = table["false_negative"] + table["false_positive"]
    rate = 100 * (1 - errors / (table["p_test_segments"] * table["q_model_segments"]))
    off = table[(rate - table["detection_rate_percent"]).abs() > 0.005 + 1e-9]
    slips = [] if name == "table_1" else [("Course3-TLS", "right", 99.54)]
    columns = ["comparison", "position_in_cell", "detection_rate_percent"]
    assert [tuple(row) for row in off[columns].to_numpy()] == slips


@pytest.mark.parametrize("name", ["table_1", "table_2"])
def test_poreba_asterisk_stands_at_the_larger_distance(name):
    for _, pair in published.table("poreba2013", name).groupby("comparison"):
        starred = pair.loc[pair["final_lhd_asterisk"], "olhd_m"]
        assert starred.tolist() == [pair["olhd_m"].max()]
        assert pair["position_in_cell"].tolist() == ["left", "right"]


def test_poreba_sets_have_one_size():
    both = pd.concat([published.table("poreba2013", n) for n in ("table_1", "table_2")])
    first = both[both["comparison"] != "Course1-Course3 second"]
    sides = [
        first[["test_set", "p_test_segments"]].set_axis(["set", "n"], axis=1),
        first[["model_set", "q_model_segments"]].set_axis(["set", "n"], axis=1),
    ]
    sizes = pd.concat(sides).groupby("set")["n"].unique().map(list).to_dict()
    assert sizes == {"Course1": [36], "Course2": [28], "Course3": [41], "TLS": [64]}


@pytest.mark.parametrize("name", ["table_3", "table_4"])
def test_cahalane_error_is_mimic_less_cad(name):
    table = published.table("cahalane2014", name)
    off = (table["mimic_m"] - table["cad_m"]).abs() - table["error_m"]
    assert (off.abs() <= 0.001).all()  # three rounded numbers: at most a unit and a half


def test_cahalane_table_2_error_is_measured_less_mimic():
    table = published.table("cahalane2014", "table_2").set_index("result")
    for profile in ("profile_1_m", "profile_2_m"):
        off = abs(table.loc["Measured (Average)", profile] - table.loc["MIMIC", profile])
        assert off == pytest.approx(table.loc["Error", profile], abs=0.0005)


def test_cahalane_table_3_follows_from_the_projected_spacing():
    table = published.table("cahalane2014", "table_3")
    scan, turned = np.radians(45), np.radians(table["alpha_targ_deg"])
    spacing = 0.1 * np.cos(scan) / np.cos(scan - turned)
    assert (np.abs(spacing - table["mimic_m"]) <= 0.0005 + 1e-9).all()


def test_cahalane_table_5_is_ordered():
    table = published.table("cahalane2014", "table_5")
    assert ((table["min_m"] <= table["mean_m"]) & (table["mean_m"] <= table["max_m"])).all()
    assert (table.loc[table["test"] == "Constructed", "max_m"] == 0).all()


def test_table_3_4_rmse_follows_from_mean_and_std():
    table = published.table("eurosdr2013_mls", "table_3_4")
    correction = (table["n"] - 1) / table["n"]

    def rmse(shift):
        mean, std = table["mean_cm"] + shift, table["std_cm"] + shift
        return np.sqrt(mean**2 + std**2 * correction)

    assert within(table["rmse_cm"], rmse(-0.05) - 0.05, rmse(0.05) + 0.05).all()
    assert ((table["min_cm"] < table["mean_cm"]) & (table["mean_cm"] < table["max_cm"])).all()


def test_table_3_3_extremes_lie_beyond_the_spread():
    table = published.table("eurosdr2013_mls", "table_3_3")
    assert (table["min_cm"] < -table["std_cm"]).all()
    assert (table["max_cm"] > table["std_cm"]).all()
    narrow = table["system"].isin(["RIEGL VMX-250", "Streetmapper 360", "Optech Lynx"])
    assert (table["search_radius_m"] == np.where(narrow, 0.2, 0.5)).all()
    assert (table["n"] <= published.table("eurosdr2013_mls", "reference_data")["value"].max()).all()


@pytest.mark.parametrize(
    ("count", "n", "rate"),
    [("trees_found", 127, 59.1), ("signs_found", 79, 82.3), ("lamp_posts_found", 46, 95.7)]
    + [("found_12_5_m", 190, 71.6)],
)
def test_derived_pole_counts_are_the_only_ones_that_round_to_the_rates(count, n, rate):
    fits = [k for k in range(n + 1) if round(100 * k / n, 1) == rate]
    derived = published.table("eurosdr2013_mls", "derived").set_index("id")["value"]
    assert fits == [derived[count]]
    tables = ["poles_text", "table_4_1"]
    printed = pd.concat([published.table("eurosdr2013_mls", t) for t in tables])
    printed = printed["value"].fillna(printed["value_percent"])[printed["n"] == n]
    assert rate in printed.tolist()


def test_derived_numbers_of_pfeifer():
    derived = published.table("pfeifer2021", "derived").set_index("id")["value"]
    x1, x4 = np.log(2) / 4, -np.log(1 - 0.5**0.25)  # medians of least and largest of four exp(1)
    assert derived["random_f"] == pytest.approx(np.sqrt(x4 / x1), abs=0.005)
    for distance, density in ((5, 28901), (10, 30915)):
        d4_mm = 1000 * np.sqrt(4 * x4 / (np.pi * density))
        assert derived[f"random_d4_c_{distance}"] == pytest.approx(d4_mm, abs=0.05)
    assert derived["d0_at_3000"] == pytest.approx(1000 / np.sqrt(3000), abs=0.05)
    at_5 = "quantity == 'pixel size' and distance_m == 5 and system == "
    table = published.table("pfeifer2021", "table_1")
    for system, text in (("a", 60), ("c", 40)):
        pixels = text / table.query(f"{at_5} '{system.upper()}'")["value"]
        name = f"text_{text}_pixels_{system}"
        assert derived[f"{name}_lower"] == pytest.approx(pixels.min(), abs=0.05)
        assert derived[f"{name}_upper"] == pytest.approx(pixels.max(), abs=0.05)


def test_derived_numbers_of_poreba():
    derived = published.table("poreba2013", "derived").set_index("id")["value"]
    both = [published.table("poreba2013", n) for n in ("table_1", "table_2")]
    for name, table in zip(("table_1", "table_2"), both, strict=True):
        found = table["pairing_existing"] - table["false_negative"]
        wrong = table["false_negative"] + table["false_positive"]
        f1 = (2 * found / (2 * found + wrong)).mean()
        assert derived[f"f1_mean_{name}"] == pytest.approx(f1, abs=0.0005)
    table = pd.concat(both)
    cells = table["p_test_segments"] * table["q_model_segments"]
    null = 100 * (1 - table["pairing_existing"] / cells)
    assert derived["null_rate_lower"] == pytest.approx(null.min(), abs=0.05)
    assert derived["null_rate_upper"] == pytest.approx(null.max(), abs=0.05)


@pytest.mark.parametrize("targets", ["xp1_1_6", "lynx_a_7_11", "lynx_b_12_16"])
def test_derived_angular_steps_of_cahalane(targets):
    system, first, last = targets.rsplit("_", 2)
    rate = published.number("cahalane2014", f"targets_{system}_prr")["value"] * 1000
    frequency = published.number("cahalane2014", f"targets_{system}_mf")["value"]
    step = published.table("cahalane2014", "derived").set_index("id")["value"]
    assert step[f"step_targets_{first}_{last}"] == pytest.approx(360 * frequency / rate)


# The loader


def test_contents_lists_every_file():
    files = {(file.parent.name, file.stem) for file in DATA.glob("*/*.csv")}
    assert files == set(TABLES)
    assert len(TABLES) == len(set(TABLES))


@pytest.mark.parametrize(("source", "table"), TABLES)
def test_numbers_are_typed_and_have_a_unit(source, table):
    raw, typed = published.raw(source, table), published.table(source, table)
    text = {"section", "page", "printed", "number", "figure", "result", "no", "type", "distance"}
    text |= {"density_per_m2_printed", "version", "date", "text"}
    for column in raw:
        filled = raw[column][raw[column] != ""]
        if len(filled) and filled.map(_is_number).all() and column not in text:
            assert typed[column].dtype.kind in "ifb", column
    if {"unit", "value"} <= set(typed) and table != "criteria":
        assert (typed.loc[typed["value"].notna(), "unit"] != "").all()


def test_columns_are_used_and_named_once():
    used = {column for s, t in TABLES for column in published.raw(s, t)}
    named = published._columns().index
    assert named.is_unique
    assert set(named) <= used


def test_status_says_why_a_number_is_missing():
    known = {"printed", "not_resolved", "not_evaluated", "not_applicable"}
    known |= {"not_available", "not_printed"}
    for source, name in TABLES:
        table = published.table(source, name)
        if "status" in table:
            assert set(table["status"]) <= known
            assert table.loc[table["status"] != "printed", "value"].isna().all()


def test_a_table_is_a_new_frame_each_time():
    first = published.table("pfeifer2021", "table_2")
    first.loc[0, "f"] = 99
    assert published.table("pfeifer2021", "table_2").loc[0, "f"] == 11.8
    assert published.table("pfeifer2021", "table_2").attrs == {}


def test_ids_are_unique_within_a_source():
    for source in published._strings("sources")["source"]:
        tables = [published.raw(source, t) for s, t in TABLES if s == source and t != "derived"]
        ids = pd.concat([t["id"] for t in tables if "id" in t])
        assert ids[ids != ""].is_unique


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: published.table("pfeifer", "table_1"), "Invalid source 'pfeifer'"),
        (lambda: published.table("poreba2013", "table_9"), "Invalid table 'table_9' of poreba2013"),
        (lambda: published.number("poreba2013", "w"), "Invalid number 'w' of poreba2013"),
    ],
)
def test_unknown_words_are_refused(call, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        call()


# The ledger


def test_cells_are_unique_and_each_has_a_reason():
    cells = ledger.cells()
    assert not cells.duplicated(["source", "table", "cell"]).any()
    empty = ledger.collect("no such folder")
    assert empty.loc[empty["note"] == "", "cell"].tolist() == []
    assert set(cells["role"]) == {"result", "set-up", "threshold", "literature"}


def test_each_reason_is_the_first_for_some_cell_and_a_sentence():
    rules = published._strings("reasons")["reason"]
    assert set(rules) == set(ledger.collect("no such folder")["note"])
    assert rules.str.fullmatch(r"[A-Z].*\.").all()


@pytest.mark.parametrize(
    ("source", "table", "count"),
    [
        ("pfeifer2021", "table_1", 12 + 24 + 24),
        ("pfeifer2021", "table_2", 6 * 5),
        ("poreba2013", "table_1", 4 * 3 + 8 * 4),
        ("poreba2013", "table_2", 3 * 2 + 1 + 6 * 4),
        ("cahalane2014", "table_2", 4 * 2),
        ("cahalane2014", "table_3", 5 * 3),
        ("cahalane2014", "table_4", 9 * 3),
        ("cahalane2014", "table_5", 6 * 3),
        ("cahalane2014", "table_6", 14 - 3),
        ("eurosdr2013_mls", "table_3_3", 14 * 4),
        ("eurosdr2013_mls", "table_3_4", 12 * 6),
        ("eurosdr2013_mls", "table_4_1", 4),
        ("eurosdr2013_mls", "table_4_2", 2),
    ],
)
def test_every_printed_number_is_a_cell(source, table, count):
    assert len(ledger.cells().query("source == @source and table == @table")) == count


@pytest.mark.parametrize(
    "table",
    [(s, t) for s, t in TABLES if t != "derived" and "role" in published.raw(s, t)],
)
def test_every_number_in_the_text_is_a_cell(table):
    frame = published.table(*table)
    measures = [m for m in ("value", "n", "gsd_cm", "reflectance") if m in frame]
    expected = sum(frame[m].notna().sum() for m in measures)
    if "low" in frame:
        expected = frame[["low", "high"]].notna().any(axis=1).sum()
    cells = ledger.cells()
    assert ((cells["source"] == table[0]) & (cells["table"] == table[1])).sum() == expected


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
        (("=", 3.5, 4.5), (4.4, NAN, NAN), "reproduced"),
        (("=", 3.5, 4.5), (3.5, NAN, NAN), "reproduced"),
        (("=", 3.5, 4.5), (4.6, 4.4, 4.8), "consistent"),
        (("=", 3.5, 4.5), (4.6, 4.55, 4.65), "differs"),
        (("=", 3.5, 4.5), (4.6, NAN, NAN), "differs"),
        (("=", 3.5, 4.5), (NAN, NAN, NAN), "not comparable"),
        (("=", 40, np.inf), (40, NAN, NAN), "differs"),
        (("=", 40, np.inf), (41, NAN, NAN), "reproduced"),
        (("=", 40, np.inf), (np.inf, NAN, NAN), "reproduced"),
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


def write(folder, study, entries):
    (folder / study).mkdir()
    pd.DataFrame(entries, columns=ledger.COLUMNS).to_csv(folder / study / "ledger.csv", index=False)


def test_collect_keeps_every_value_and_lets_one_decide(tmp_path):
    place = ("pfeifer2021", "table_2")
    entries = [
        ledger.entry(*place, "A 5 m d1", 6.0, kind="fitted"),
        ledger.entry(*place, "A 5 m d1", 4.2, kind="measured", low=3.9, high=4.5),
        ledger.entry(*place, "A 5 m f", NAN, kind="measured", note="No point has four neighbours."),
    ]
    write(tmp_path, "b", entries)
    write(tmp_path, "a", [ledger.entry(*place, "A 5 m d1", 4.9, kind="predicted", high=5.0)])
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
        ("cell", "A 5 m d9", "Invalid cell 'A 5 m d9' of pfeifer2021 table_2"),
        ("table", "table_9", "Invalid table pfeifer2021 table_9"),
        ("kind", "guessed", "Invalid kind 'guessed'"),
    ],
)
def test_collect_refuses_what_it_does_not_know(tmp_path, column, word, message):
    row = ledger.entry("pfeifer2021", "table_2", "A 5 m d1", 4.0, kind="measured")
    write(tmp_path, "a", [row | {column: word}])
    with pytest.raises(ValueError, match=re.escape(message)):
        ledger.collect(tmp_path)


def test_collect_refuses_a_file_that_lacks_a_column(tmp_path):
    write(tmp_path, "a", [])
    (tmp_path / "a" / "ledger.csv").write_text("source,table,cell,value\n")
    with pytest.raises(ValueError, match="no column low"):
        ledger.collect(tmp_path)


def test_an_entry_lies_within_its_own_interval():
    with pytest.raises(ValueError, match="between its own low 5 and high nan"):
        ledger.entry("pfeifer2021", "table_2", "A 5 m d1", 4.0, kind="measured", low=5)


def test_a_fit_is_no_reproduction():
    printed = {"relation": "=", "low": 14.5, "high": 15.5}
    ours = {"value": 15.0, "low": NAN, "high": NAN}
    assert ledger.verdict(printed, ours | {"kind": "predicted"}) == "reproduced"
    assert ledger.verdict(printed, ours | {"kind": "fitted"}) == "consistent"
