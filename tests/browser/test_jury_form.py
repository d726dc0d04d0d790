"""Jurors in JupyterLab: they mark crops with the mouse, go back, and their marks reach a report."""

import shutil

import nbformat
import pandas as pd
from playwright.sync_api import expect

from mmqa_lab.__main__ import main
from mmqa_lab.chart_image.legibility import JUDGED
from mmqa_lab.simulate.site import write_site

expect.set_options(timeout=30_000)  # a busy machine answers late

CELL = """
import numpy as np
from mmqa_lab import widgets

crops = {name: np.linspace(0, 1, 20 * 50).reshape(20, 50) ** k for k, name in enumerate("xyz", 1)}
widgets.JuryForm(crops, juror="first", file="marks.csv", order=["z", "x", "y"])
"""

RUN_MS = 120_000
"""The kernel starts and imports on a machine that may be busy."""


def write_notebook(file, code):
    """A notebook of one cell."""
    kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3 (ipykernel)"}}
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(code)], metadata=kernel)
    nbformat.write(notebook, file)


def test_a_juror_marks_crops_in_order(ran, lab_folder):
    write_notebook(lab_folder / "jury.ipynb", CELL)
    page = ran("jury")
    line = page.locator(".widget-label", has_text="first:")
    expect(line).to_have_text("first: 1 of 3", timeout=RUN_MS)
    picture = page.locator(".jp-OutputArea-output img").first
    expect(picture).to_be_visible()
    assert picture.evaluate("image => image.naturalWidth") == 12 * 50
    before = picture.get_attribute("src")
    button = page.locator(".jp-OutputArea-output button")
    button.filter(has_text="b: the text").click()
    expect(line).to_have_text("first: 2 of 3")
    expect(picture).not_to_have_attribute("src", before)
    button.filter(has_text="c: not legible").click()
    expect(line).to_have_text("first: 3 of 3")
    button.filter(has_text="back").click()
    expect(line).to_have_text("first: 2 of 3")
    button.filter(has_text="a: every letter").click()
    button.filter(has_text="a: every letter").click()
    expect(line).to_have_text("first: all 3 are marked, thank you.")
    expect(button.filter(has_text="a: every letter")).to_be_disabled()
    marks = pd.read_csv(lab_folder / "marks.csv")
    assert marks[["element", "mark"]].values.tolist() == [["z", "b"], ["x", "a"], ["y", "a"]]


def test_three_jurors_mark_a_delivery_without_seeing_each_other(ran, lab_folder):
    site = lab_folder / "site"
    write_site(site, systems="A", seed=1)
    shutil.rmtree(site / "A" / "drive_05m")
    (site / "marks.csv").unlink()
    assert main(["accept", str(site)]) == 1
    given = {"Anna": "b: the text", "Berta": "c: not legible", "Carl": "b: the text"}
    for juror, mark in given.items():
        form = f'JuryForm("site/report", juror="{juror}", file="site/marks.csv")'
        write_notebook(
            lab_folder / f"{juror}.ipynb", f"from mmqa_lab import widgets\nwidgets.{form}"
        )
        output = ran(juror).locator(".jp-OutputArea-output")
        line = output.locator(".widget-label")
        for number in range(1, len(JUDGED) + 1):
            expect(line).to_have_text(f"{juror}: {number} of {len(JUDGED)}", timeout=RUN_MS)
            output.locator("button").filter(has_text=mark).click()
        expect(line).to_have_text(f"{juror}: all {len(JUDGED)} are marked, thank you.")
        assert not [name for name in given if name != juror and name in output.inner_text()]
    assert main(["accept", str(site)]) == 1
    results = pd.read_csv(site / "report" / "results.csv").set_index(["quantity", "view"])
    found = results.loc[[("legibility_40mm", "orthogonal")]].query("distance_m == 10")
    assert found[["value", "low", "high"]].values.tolist() == [["b", 1, 2]]
    assert "bbc" in (site / "report" / "report.html").read_text()
