"""A juror in JupyterLab: marks crops with the mouse, goes back, and finds the marks on disk."""

import nbformat
import pandas as pd
from playwright.sync_api import expect

expect.set_options(timeout=30_000)  # a busy machine answers late

CELL = """
import numpy as np
from mmqa_lab import widgets

crops = {name: np.linspace(0, 1, 20 * 50).reshape(20, 50) ** k for k, name in enumerate("xyz", 1)}
widgets.JuryForm(crops, juror="first", file="marks.csv", order=["z", "x", "y"])
"""

RUN_MS = 120_000
"""The kernel starts and imports on a machine that may be busy."""


def test_a_juror_marks_crops_in_order(ran, lab_folder):
    kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3 (ipykernel)"}}
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(CELL)], metadata=kernel)
    nbformat.write(notebook, lab_folder / "jury.ipynb")
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
