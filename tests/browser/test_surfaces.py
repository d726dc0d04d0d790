"""Surfaces of a room and of a facade with a sill in JupyterLab, and the page of notebook 00."""

import os
import shutil

import numpy as np
import pytest
from playwright.sync_api import expect

from mmqa_lab.cloud import Cloud
from mmqa_lab.io import read_outlines, read_polygon, write_cloud
from mmqa_lab.studies import TOOLS

from .test_lab import RUN_MS, write

ROOM = """
%matplotlib inline
import numpy as np
from mmqa_lab import widgets
from mmqa_lab.cloud import Cloud

rng = np.random.default_rng(0)
flat = rng.uniform(0, 1, (6, 2500, 3)) * [6, 4, 3]
for side, (axis, value) in enumerate(((2, 0), (2, 3), (1, 0), (1, 4), (0, 0), (0, 6))):
    flat[side, :, axis] = value
points = flat.reshape(-1, 3) + [500_000, 5_300_000, 200] + rng.normal(0, 0.002, (15_000, 3))
points[7500:10_000] += [[0, 0.06, 0]] * (points[7500:10_000, 2:] < 200.25)  # a skirting board
rgb = {name: np.full(15_000, 90 + 40 * k) for k, name in enumerate(("red", "green", "blue"))}
tool = widgets.SurfaceTool({"room": Cloud(points, rgb)}, size=1, detail=0.1)
tool
"""

SELECTED = """
@tool.follow
def show(tool):
    print(f"shown: {tool.planes['kind'][tool.number]}, {tool.quality.n} points")
"""


def test_selections_are_kept_by_the_keyboard_and_marked_points_left_out(
    browser, ran, lab_folder, barriers
):
    write(lab_folder, "room.ipynb", ROOM, SELECTED)
    page = ran("room")
    page.set_viewport_size({"width": 1200, "height": 900})
    shown = page.locator("pre", has_text="shown: ").last
    expect(shown).to_be_visible(timeout=RUN_MS)
    wide = page.locator(".jp-OutputArea-output").first
    assert wide.evaluate("one => one.scrollWidth - one.clientWidth") <= 2
    planes = page.get_by_label("plane", exact=True)
    assert planes.evaluate("one => one.scrollWidth - one.clientWidth") <= 2
    corners = page.get_by_label("corners")  # four, each in a line of its own
    assert corners.evaluate("one => one.scrollHeight - one.clientHeight") <= 2
    keep = page.get_by_role("button", name="Keep this selection")
    names = []
    for _ in range(6):
        names.append(shown.inner_text().split(": ")[1].split(",")[0])
        keep.focus()
        page.keyboard.press("Enter")
        expect(page.get_by_label("kept", exact=True)).to_contain_text(f"{names[-1]} 1")
        before = shown.inner_text()
        planes.focus()
        page.keyboard.press("ArrowDown")
        if len(names) < 6:
            expect(shown).not_to_have_text(before, timeout=20_000)
    assert sorted(names)[:2] == ["ceiling", "floor"]
    assert len(set(names)) == 6
    kept = page.get_by_label("kept", exact=True)
    kept.select_option("wall facing south 1")  # the one with the skirting board
    alone = page.get_by_role("button", name="Leave out the points with rings")
    expect(alone).to_be_visible(timeout=20_000)
    page.screenshot(path=os.environ.get("MMQA_SHOT", "/dev/null"), full_page=True, type="png")
    before = shown.inner_text()
    alone.focus()
    page.keyboard.press("Enter")
    expect(shown).not_to_have_text(before, timeout=20_000)
    expect(alone).to_be_hidden()
    assert not barriers(page, ".jp-OutputArea")


def test_reports_and_selections_of_ones_own_cloud_have_folders_of_their_own(
    ran, lab_folder, rng_cloud
):
    source = (
        TOOLS[0]
        .path.read_text()
        .replace(
            'files = (\\"road_patch\\", \\"chart_b_5m\\")', f'files = (\\"{rng_cloud.name}\\",)'
        )
    )
    assert rng_cloud.name in source
    (lab_folder / "own.ipynb").write_text(source)
    page = ran("own")
    results = lab_folder.parent / "results" / TOOLS[0].stem
    button = page.get_by_role("button", name="Write the report of this selection")
    expect(button).to_be_visible(timeout=RUN_MS)
    expect(page.locator(".widget-upload")).to_be_visible()
    expect(page.locator(".widget-html", has_text="points/m²").first).to_be_visible()
    assert not [*results.glob("*/report.html")]  # nobody has asked for one
    for number in (1, 2):  # the same selection, in a folder of its own
        button.click()
        expect(page.get_by_text(f"_1_{number}/report.html")).to_be_visible(timeout=30_000)
    page.get_by_role("button", name="Save the kept selections").click()
    expect(page.get_by_text("selections_1").last).to_be_visible(timeout=20_000)
    reports = sorted(results.glob("*/report.html"))
    assert len(reports) == 2
    assert "B_ro_2._OG" in reports[0].parent.name.replace("ü", "_")
    assert "floor 1 of" in (reports[0].parent / "surface.svg").read_text()
    text = reports[0].read_text()
    assert rng_cloud.name in text
    assert "--thickness 0.1" in text
    polygon = read_polygon(reports[0].parent / "selection.geojson")
    (outlines,) = (results / "selections_1").glob("*.geojson")
    ((name, ring),) = read_outlines(outlines)
    assert name == "floor 1"
    np.testing.assert_array_equal(ring, polygon)
    assert page.locator(".jp-OutputArea").get_by_text("Traceback").count() == 0


@pytest.fixture
def rng_cloud(lab_folder, rng):
    """A floor in a file whose name has dots and an umlaut."""
    path = lab_folder / "Büro 2. OG.laz"
    floor = rng.uniform(0, 3, (4000, 3)) * [1, 1, 0] + rng.normal(0, 0.002, (4000, 3))
    write_cloud(path, Cloud(floor))
    yield path
    shutil.rmtree(lab_folder.parent / "results" / TOOLS[0].stem, ignore_errors=True)
