"""A person in JupyterLab: runs a study, moves a slider, drags a vertex of a polygon."""

import io
import re

import nbformat
import numpy as np
from matplotlib.colors import to_rgb
from PIL import Image
from playwright.sync_api import expect

from mmqa_lab.plots import COLOURS

RUN_MS = 400_000
"""Studies run with small parameters, but the machine may be busy."""


def points_selected(text):
    """The number that the tool's line begins with."""
    return int(re.match(r"(\d+) points", text).group(1))


def outline_corner(picture):
    """Pixel (x, y) of the upper right corner of the polygon's line, and its picture."""
    image = np.asarray(Image.open(io.BytesIO(picture)).convert("RGB"), dtype=float)
    colour = 255 * np.array(to_rgb(COLOURS["green"]))
    rows, columns = np.nonzero(np.abs(image - colour).max(axis=2) < 40)
    inside = columns < 0.6 * image.shape[1]  # the cloud's panel; histograms stand to the right
    rows, columns = rows[inside], columns[inside]
    best = np.argmax(columns - rows)
    return int(columns[best]), int(rows[best])


WALL = """
%matplotlib inline
import numpy as np
from mmqa_lab import widgets

widgets.SelectionTool(np.random.default_rng(0).uniform(0, 4, (3000, 3)) * [1, 0, 0.5])
"""


def write(folder, name, *sources):
    """Write a notebook of these cells into the folder that JupyterLab serves."""
    kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3 (ipykernel)"}}
    cells = [nbformat.v4.new_code_cell(source) for source in sources]
    nbformat.write(nbformat.v4.new_notebook(cells=cells, metadata=kernel), folder / name)


def test_dragging_a_vertex_changes_numbers_and_picture(ran, lab_folder):
    write(lab_folder, "wall.ipynb", WALL)
    page = ran("wall")
    line = page.locator(".widget-html", has_text="points/m²").first
    expect(line).to_be_visible(timeout=RUN_MS)
    canvas = page.locator(".jupyter-matplotlib-canvas-div").first
    canvas.scroll_into_view_if_needed()
    page.wait_for_timeout(3000)
    text, picture = line.inner_text(), canvas.screenshot()
    x, y = outline_corner(picture)
    box = canvas.bounding_box()
    page.mouse.move(box["x"] + x - 2, box["y"] + y + 2, steps=4)
    page.wait_for_timeout(300)
    page.mouse.down()
    page.wait_for_timeout(100)
    page.mouse.move(box["x"] + x - 60, box["y"] + y + 60, steps=8)
    page.wait_for_timeout(200)
    page.mouse.up()
    expect(line).not_to_have_text(text, timeout=20_000)
    page.wait_for_timeout(1000)
    smaller = points_selected(line.inner_text())
    assert 0.5 * points_selected(text) < smaller < 0.98 * points_selected(text)
    assert outline_corner(canvas.screenshot()) != (x, y)


SCENE = """
%matplotlib inline
import numpy as np
from mmqa_lab import widgets

flat = np.random.default_rng(0).uniform(0, 4, (3000, 3))
corner = np.concatenate([flat * [1, 1, 0], flat[:2000] * [1, 0, 1]])
tool = widgets.SurfaceTool({"corner": corner}, size=2)
tool
"""

FOLLOWS = """
import matplotlib.pyplot as plt

@tool.follow
def show(tool):
    figure, ax = plt.subplots()
    ax.plot([0, tool.number])
    display(figure)
    plt.close(figure)
    print("slope", round(tool.planes["slope_deg"][tool.number]))
"""


def test_a_click_in_the_list_chooses_a_plane_and_all_follows(ran, lab_folder, barriers):
    write(lab_folder, "s.ipynb", SCENE, FOLLOWS)
    page = ran("s")
    expect(page.get_by_text("slope 0", exact=True)).to_be_visible(timeout=RUN_MS)
    picture = page.locator(".jp-OutputArea-output img").last
    before = picture.get_attribute("src")
    assert not barriers(page, ".jp-OutputArea")
    listed = page.get_by_label("plane", exact=True)
    listed.focus()
    page.keyboard.press("ArrowDown")
    expect(page.get_by_text("slope 90", exact=True)).to_be_visible(timeout=10_000)
    expect(picture).not_to_have_attribute("src", before, timeout=10_000)


EXPLORED = """
%matplotlib inline
import matplotlib.pyplot as plt
from mmqa_lab import widgets

def draw(spacing):
    figure, ax = plt.subplots()
    ax.plot([0, spacing])
    return figure

widgets.explore(draw, spacing=widgets.slider("spacing", 5, 1, 20, 1, unit="mm"))
"""


def test_moving_a_slider_changes_numbers_and_picture(ran, lab_folder):
    write(lab_folder, "explored.ipynb", EXPLORED)
    page = ran("explored")
    handle = page.locator(".jupyter-widgets .noUi-handle").first
    expect(handle).to_be_visible(timeout=RUN_MS)
    explorer = page.locator(".jp-OutputArea-output", has=page.locator(".noUi-handle")).first
    picture = explorer.locator("img").last
    expect(picture).to_be_visible(timeout=RUN_MS)
    before = picture.get_attribute("src")
    readout = explorer.locator(".widget-readout").first
    expect(readout).to_have_text("5")
    handle.focus()
    page.keyboard.press("ArrowRight")
    expect(readout).to_have_text("6")
    expect(picture).not_to_have_attribute("src", before, timeout=20_000)
