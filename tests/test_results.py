"""What a study leaves behind."""

import json
import re

import matplotlib.pyplot as plt
import pandas as pd
import pytest

from mmqa_lab import plots
from mmqa_lab.results import Claim, Run, overlapping_texts


@pytest.fixture
def run(tmp_path, monkeypatch):
    """A run that writes to a temporary folder."""
    monkeypatch.setenv("MMQA_RESULTS", str(tmp_path))
    return Run("example", parameters={"seed": 3})


def test_record_tables_values(run):
    run.save_table(pd.DataFrame({"f": [3.257], "kind": ["predicted"]}), "table")
    run.save_value("f_poisson", 3.257, "1", "predicted")
    run.save_claims([Claim("f exceeds 2", True, "3.257", "closed form")])
    run.finish()
    record = json.loads((run.folder / "run.json").read_text())
    assert record["parameters"] == {"seed": 3}
    assert record["files"] == ["table.csv", "claims.csv", "values.csv"]
    assert (record["claims"], record["claims_that_hold"]) == (1, 1)
    assert record["versions"]["numpy"]
    assert pd.read_csv(run.folder / "values.csv")["value"].item() == 3.257


@pytest.mark.parametrize(
    ("frame", "kind", "columns"),
    [
        ({"f": [2.0]}, "measured (simulated)", ["f", "kind"]),
        ({"f": [2.0], "kind": ["upright"]}, "fitted", ["f", "kind", "kind_of_number"]),
        ({"f_measured": [2.0], "f_predicted": [2.1]}, "", ["f_measured", "f_predicted"]),
        ({"f": [2.0, 3.0], "kind": ["published", "fitted"]}, "", ["f", "kind"]),
        ({"symbol": ["f"], "meaning": ["inhomogeneity"]}, "", ["symbol", "meaning"]),
    ],
)
def test_a_table_says_of_which_kind_its_numbers_are(run, frame, kind, columns):
    run.save_table(pd.DataFrame(frame), "table", kind=kind)
    assert list(pd.read_csv(run.folder / "table.csv")) == columns


@pytest.mark.parametrize(
    ("frame", "kind"),
    [({"f": [2.0]}, ""), ({"f": [2.0]}, "true"), ({"f": [2.0] * 2, "kind": ["fitted", ""]}, "")],
)
def test_a_table_of_an_unknown_kind_is_refused(run, frame, kind):
    with pytest.raises(ValueError, match=r"Invalid table table: nothing says.*one of published, "):
        run.save_table(pd.DataFrame(frame), "table", kind=kind)
    assert not (run.folder / "table.csv").exists()


def test_a_claim_that_fails_is_written_and_named(run):
    claims = [Claim("one", True, "1", ""), Claim("f is below 2", False, "3.257", "")]
    with pytest.raises(AssertionError, match=r"Does not hold: f is below 2 \(3\.257\)"):
        run.save_claims(claims)
    assert pd.read_csv(run.folder / "claims.csv")["holds"].tolist() == [True, False]
    assert (run.folder / "run.json").is_file()


def test_figures_are_equal_to_the_byte(run):
    plots.use_style()
    contents = []
    for _ in range(2):
        figure, ax = plots.subplots(height_mm=40)
        plots.draw_points([[0, 0], [1, 1], [2, 0]], ax=ax)
        run.save_figure(figure, "points")
        plt.close(figure)
        contents.append([(run.folder / f"points.{e}").read_bytes() for e in ("pdf", "svg", "png")])
    assert contents[0] == contents[1]


def test_fonts_are_embedded_as_truetype(run):
    plots.use_style()
    figure, ax = plots.subplots(height_mm=40)
    ax.set_xlabel("range (m)")
    run.save_figure(figure, "font")
    plt.close(figure)
    pdf = (run.folder / "font.pdf").read_bytes()
    assert b"/Type3" not in pdf
    assert b"/FontFile2" in pdf


def drawn(height_mm=40, **choices):
    """A figure with a legend and a title, drawn."""
    plots.use_style(**choices)
    figure, ax = plots.subplots(height_mm=height_mm)
    ax.plot([0.1, 1], [0, 1], label="a line")
    ax.set(xlabel="range (m)", ylabel="error (mm)", title="plain")
    ax.legend()
    figure.canvas.draw()
    return figure, ax


def test_texts_on_each_other_or_outside_are_named(run):
    figure, ax = drawn()
    assert overlapping_texts(figure) == []
    ax.text(0.2, 0.5, "first")
    ax.text(0.22, 0.5, "second")
    figure.text(0.9, 0.6, "a text that runs over the edge", in_layout=False)
    run.save_figure(figure, "crowded")
    run.finish()
    plt.close(figure)
    found = json.loads((run.folder / "run.json").read_text())["overlapping_texts"]["crowded"]
    assert sorted(found) == [
        "'a text that runs over the edge' leaves the figure",
        "'first' and 'second' overlap",
    ]


@pytest.mark.parametrize("journal", plots.JOURNALS)
@pytest.mark.parametrize("width", plots.WIDTHS)
def test_files_have_the_width_that_the_journal_asks_for(journal, width, run):
    figure, _ = drawn(journal=journal, width=width)
    run.save_figure(figure, "page")
    plt.close(figure)
    plots.use_style()
    box = re.search(rb"/MediaBox \[ ?([^\]]+)\]", (run.folder / "page.pdf").read_bytes())
    points = float(box.group(1).split()[2])
    wanted = plots.JOURNALS[journal].widths_mm[plots.WIDTHS.index(width)]
    assert points / 72 * 25.4 == pytest.approx(wanted, abs=0.1)  # a third of a point
    assert plots.JOURNALS[journal].source


def test_an_unknown_journal_or_width_is_refused():
    with pytest.raises(ValueError, match=r"Invalid journal 'Nature'. Must be one of"):
        plots.use_style(journal="Nature")
    with pytest.raises(ValueError, match=r"Invalid width 'triple'. Must be one of"):
        plots.use_style(width="triple")
