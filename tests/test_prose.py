"""What the notebooks' sentences say of a rise or a fall, against what it is computed from."""

import os
import re
from pathlib import Path

import nbformat
import numpy as np
import pandas as pd
import pytest

from mmqa_lab import published
from mmqa_lab.simulate.point_patterns import point_pattern
from mmqa_lab.spacing import turned_f
from mmqa_lab.studies import STUDIES

NUMBER = r"(\d+(?:\.\d+)?)"

CHANGE = re.compile(rf"\b(?:rises|falls|drops|grows) from {NUMBER}\D*? to {NUMBER}")


def prose(study):
    """The text cells of a notebook, each as one line."""
    cells = nbformat.read(study.path, as_version=4).cells
    return " ".join(" ".join(c.source.split()) for c in cells if c.cell_type == "markdown")


def numbers(stem, pattern):
    """The numbers in a sentence of a notebook."""
    study = next(study for study in STUDIES if study.stem == stem)
    found = re.search(pattern.replace("#", NUMBER), prose(study))
    assert found, f"{stem} no longer says: {pattern}"
    return [float(text) for text in found.groups()]


def test_system_c_from_5_m_to_10_m():
    said = numbers(
        "chart_tables", "density rises by # %, and sigma_MAD grows from # to # mm, # times"
    )
    table = published.table("pfeifer2021", "table_2").query("system == 'C'").set_index("distance_m")
    near, far = table.loc[5], table.loc[10]
    assert said[0] == round(100 * (far["density_per_m2"] / near["density_per_m2"] - 1))
    sigma = near["sigma_mad_mm"], far["sigma_mad_mm"]
    assert said[1:3] == pytest.approx(sigma, abs=0.5)
    assert said[3] == pytest.approx(sigma[1] / sigma[0], abs=0.06)


def test_f_of_lines_over_the_turn():
    said = numbers("anisotropy", "f is # at every turn. # mm of noise are enough that it drops")
    drop = numbers("anisotropy", "it drops from # to # where")
    angles = np.arange(0, 91, 15)
    choices = {"density": 3000, "size": 1.0, "seed": 1000, "ratio": 10}
    exact, noisy = (
        turned_f(point_pattern("scan_lines", noise=noise / 1000, **choices), angles=angles)
        for noise in (0, said[1])
    )
    assert exact == pytest.approx(said[0], abs=0.5)
    assert [noisy.max(), noisy.min()] == pytest.approx(drop, abs=0.5)


def test_blur_of_the_simulated_scenes():
    said = numbers("image_radiometry", "blur grows from # px in the centre to # px in the corners")
    cells = next(study for study in STUDIES if study.stem == "image_radiometry").path.read_text()
    assert f"blur = {said[0]:g} + {said[1] - said[0]:g} * (x**2 + y**2)" in cells


def test_no_other_sentence_tells_of_a_change():
    told = {study.stem: len(CHANGE.findall(prose(study))) for study in STUDIES}
    told = {stem: count for stem, count in told.items() if count}
    assert told == {"chart_tables": 1, "anisotropy": 1, "image_radiometry": 2}  # 10 to 90 %: a name


def rows(table, **chosen):
    """The rows of a table with these values."""
    return table[np.logical_and.reduce([table[name] == value for name, value in chosen.items()])]


def misses(table, system):
    """How much is missing in the plan of a system, from least to most."""
    return sorted(rows(table, system=system, figure="plan_rmse")["missing_mm"])


def too_fine(table):
    """By how much the pixels of A are predicted too fine, least and most."""
    of_a = -table[table["system"] == "A"]["difference_percent"].dropna()
    return [of_a.min(), of_a.max()]


def lost_f1(table):
    """By how much other readings than the published one lower F1, of those that the text names."""
    f1 = table.set_index("method")["mean"]
    named = ["peak's value", "differences sorted again", "sensitivity 0.1 m"]
    return [f1["published"] - f1[named].max(), f1["published"] - f1[named].min()]


def too_dense(table):
    """By how much the hull's density is too high where lines run along the crop."""
    hull = rows(table, method="Appendix A").set_index("system")["density_percent"]
    return sorted(hull[["A upright", "B"]])


def denser(table):
    """B's predicted density over the printed one."""
    of_b = rows(table, system="B", figure="density_per_m2")
    return sorted(of_b["predicted"] / of_b["published"])


QUOTED = [
    ("chart_tables", "its density is # to # % too high", "readings_against_truth", too_dense),
    (
        "chart_tables",
        "B is predicted # to # times as dense as printed",
        "table_2_comparison",
        denser,
    ),
    (
        "chart_tables",
        "axis pitched by about # degrees",
        "table_2_parameters",
        lambda t: rows(t, system="B", parameter="tilt_deg")["fitted"],
    ),
    (
        "chart_tables",
        "f is then #, nearer",
        "system_c_models",
        lambda t: rows(t, model="pairs fused", distance_m=10)["f"],
    ),
    (
        "anisotropy",
        "f of random patterns is # whether stretched or not, and at most # with holes",
        "means",
        lambda t: [
            rows(t, method="f", kind=kind)[["1", "5", "20"]].max(axis=None)
            for kind in ("poisson", "holes")
        ],
    ),
    ("lhd_weight", "lower F1 by # to #,", "readings", lost_f1),
    (
        "mimic",
        "The first row is matched in every cell, the second in all but .*?: # degrees are enough",
        "table_6",
        lambda t: abs(rows(t, output="d_PrSV", name="gamma_scan")["change_fitted"]),
    ),
    (
        "poles",
        r"the share of visible poles \(# %\)",
        "values",
        lambda t: 100 * rows(t, name="visible_share")["value"],
    ),
    ("test_field", "A roll of # degrees", "values", lambda t: t["value"]),
    (
        "test_field",
        "# to # mm are missing there",
        "tables_3_3_and_3_4",
        lambda t: misses(t, "ROAMER I"),
    ),
    (
        "test_field",
        "In the plan of Optech Lynx # to # mm are missing",
        "tables_3_3_and_3_4",
        lambda t: misses(t, "Optech Lynx"),
    ),
    (
        "image_radiometry",
        "a FWHM that is # to # % too small",
        "edges",
        lambda t: (
            -rows(t, method="logistic sigmoid")[
                ["fwhm_px_error_percent_p95", "fwhm_px_error_percent_p05"]
            ].iloc[0]
        ),
    ),
    (
        "image_radiometry",
        "both is # to # % lower than other tools say, and that of the edge method # % higher",
        "real_edges",
        lambda t: rows(t, photograph="slanted edge").iloc[0, 1:4].astype(float) * [-1, -1, 1],
    ),
    ("chart_images", "pixels # to # % finer than those published", "pixel_sizes", too_fine),
    (
        "chart_images",
        "the fits repeat to about # pixels",
        "photograph",
        lambda t: t["pixel_h_std_px"],
    ),
]


@pytest.mark.parametrize(("stem", "pattern", "table", "found"), QUOTED)
def test_quoted_numbers_are_those_of_the_last_full_run(stem, pattern, table, found):
    """Numbers that only the full parameters give; half a unit of the printed digit is allowed."""
    folder = Path(os.environ.get("MMQA_RESULTS", "notebooks/results")) / stem
    said = numbers(stem, pattern)
    if not (folder / f"{table}.csv").is_file():
        pytest.skip(f"no full run of {stem}")
    for one, value in zip(said, found(pd.read_csv(folder / f"{table}.csv")), strict=True):
        decimals = len(f"{one:g}".partition(".")[2])
        assert value == pytest.approx(one, abs=0.51 * 10**-decimals)
