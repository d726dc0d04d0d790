"""The polygon tool without a browser: what it computes, keeps and says."""

import json
import subprocess
import sys

import numpy as np
import pytest
from matplotlib.backend_bases import MouseEvent
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from mmqa_lab import plots, widgets
from mmqa_lab.__main__ import main
from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.cloud import Cloud
from mmqa_lab.io import read_polygon, write_cloud
from mmqa_lab.planes import detect_planes, fit_plane
from mmqa_lab.widgets import selection

# of ipympl's own toolbar
pytestmark = pytest.mark.filterwarnings("ignore:Passing unrecognized arguments to super")


@pytest.fixture
def wall(rng):
    """An upright wall of 4,000 points, 2 m x 1.5 m, far from the origin, turned by 30 degrees."""
    along, up, off = rng.random(4000) * 2, rng.random(4000) * 1.5, 0.003 * rng.standard_normal(4000)
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    points = np.stack([c * along - s * off, s * along + c * off, up], axis=1)
    return points + [500_000, 5_300_000, 200]


@pytest.fixture
def tool(wall, monkeypatch):
    """The tool as a person at a screen has it."""
    monkeypatch.delenv("MMQA_HEADLESS", raising=False)
    return widgets.select_polygon(wall)


def test_view_is_upright_and_inverts(wall):
    view = selection._View(wall)
    xy = view.to_plane(wall)
    assert np.ptp(xy, axis=0) == pytest.approx([2, 1.5], abs=0.02)
    assert abs(view.axes[0, 2]) < 1e-12
    back = view.to_space(xy)
    assert np.linalg.norm(back - wall, axis=1).max() < 0.02  # the points' distances from the plane


def test_view_of_level_ground_has_axes_all_the_same(rng):
    ground = np.column_stack([rng.random((500, 2)), np.zeros(500)])
    assert np.abs(selection._View(ground).axes[:, 2]).max() < 1e-9


def test_tool_shows_what_evaluate_cloud_finds(tool, wall):
    quality = evaluate_cloud(wall, polygon=tool.vertices)
    assert tool.quality.n == quality.n
    assert tool.quality.f == quality.f
    assert selection._summary(quality) in tool.text.value


def test_other_figures_stay_with_their_backend():
    code = "import matplotlib; matplotlib.use('svg')\n"
    code += "from mmqa_lab.widgets.selection import SelectionTool\n"
    code += "SelectionTool([[0, 0, 0], [1, 0, 0], [0, 0, 1]]); print(matplotlib.get_backend())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "svg"


def test_the_polygon_is_in_the_picture(tool):
    tool.canvas.draw()
    image = np.asarray(tool.canvas.buffer_rgba())[:, :, :3].astype(int)
    vermilion = 255 * np.array(to_rgb(plots.COLOURS["vermilion"]))
    painted = np.abs(image - vermilion).max(axis=2) < 20
    assert (
        painted[:, : int(0.6 * painted.shape[1])].sum() > 1000
    )  # the histograms are farther right


def test_moving_a_vertex_changes_numbers_and_picture(tool):
    before, text = np.asarray(tool.canvas.buffer_rgba()).copy(), tool.text.value
    larger = tool.vertices.copy()
    larger[2] += 0.15 * (larger[2] - larger[0])
    tool.select(larger)
    tool.canvas.draw()
    assert tool.text.value != text
    assert not np.array_equal(np.asarray(tool.canvas.buffer_rgba()), before)
    assert tool.vertices == pytest.approx(larger, abs=1e-8)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda v: v[[0, 2, 1, 3]], "Invalid polygon: Self-intersection"),
        (lambda v: v[0] + (v - v[0]) / 1000, "Invalid points inside the polygon"),
    ],
)
def test_a_polygon_that_selects_nothing_says_so(tool, change, said):
    tool.select(change(tool.vertices))
    assert tool.quality is None
    assert said in tool.text.value


def test_the_saved_polygon_gives_the_same_numbers_at_the_command_line(
    tool, wall, tmp_path, capsys, monkeypatch
):
    write_cloud(tmp_path / "wall.laz", Cloud(wall), scale=1e-6)
    monkeypatch.chdir(tmp_path)
    name, button, said = tool.box.children[-1].children
    name.value = "chosen.geojson"
    button.click()
    assert "mmqa evaluate CLOUD --polygon chosen.geojson" in said.value
    assert np.array_equal(read_polygon("chosen.geojson"), tool.vertices)
    assert main(["evaluate", "wall.laz", "--polygon", "chosen.geojson", "--json"]) in (0, None)
    row = json.loads(capsys.readouterr().out)[0]
    assert row["n"] == tool.quality.n
    # the file keeps a micrometre
    assert row["sigma_mad_mm"] == pytest.approx(tool.quality.sigma_mad_mm, abs=0.002)
    assert row["f"] == pytest.approx(tool.quality.f, rel=1e-3)


def test_a_polygon_that_cannot_be_saved_says_why(tool, tmp_path):
    name, button, said = tool.box.children[-1].children
    (tmp_path / "file").write_text("")
    name.value = str(tmp_path / "file" / "polygon.geojson")
    button.click()
    assert "file" in said.value
    assert "saved" not in said.value


def test_without_a_screen_it_is_a_picture(wall, monkeypatch):
    monkeypatch.setenv("MMQA_HEADLESS", "1")
    corners = selection._View(wall).middle_polygon(wall)
    figure = widgets.select_polygon(wall, polygon=corners)
    assert isinstance(figure, Figure)
    quality = evaluate_cloud(wall, polygon=corners)
    assert figure.axes[0].get_title() == selection._summary(quality)
    assert fit_plane(corners).rms < 1e-9


@pytest.fixture
def floors(rng):
    """Two level floors, one above the other, 10 km from the origin, and their planes."""
    flat = rng.uniform(0, 4, (3000, 2))
    low, high = (np.column_stack([flat, np.full(3000, z)]) for z in (0.0, 2.0))
    points = np.concatenate([low, high]) + 10_000
    return points, detect_planes(points)


@pytest.mark.parametrize(("elevation", "height"), [(80, 10_002), (-80, 10_000)])
def test_a_click_takes_the_foremost_plane(floors, elevation, height, monkeypatch):
    monkeypatch.delenv("MMQA_HEADLESS", raising=False)
    picker = widgets.pick_plane(*floors)
    picker.ax.view_init(elevation, 30)
    picker.canvas.draw()
    middle = np.array(picker.canvas.get_width_height()) / 2
    for name in ("button_press_event", "button_release_event"):
        event = MouseEvent(name, picker.canvas, *middle, button=1)
        picker.canvas.callbacks.process(name, event)
    assert picker.patches[picker.chosen].plane.centre[2] == pytest.approx(height)
    assert picker.ax.get_title().startswith(f"plane {picker.chosen} of 2: 3000 points, slope 0")


def test_a_drag_or_a_click_beside_the_cloud_chooses_nothing(floors, monkeypatch):
    monkeypatch.delenv("MMQA_HEADLESS", raising=False)
    picker = widgets.pick_plane(*floors, chosen=1)
    assert picker.plane_at(1, 1) is None
    middle = np.array(picker.canvas.get_width_height()) / 2
    for name, place in (("button_press_event", middle), ("button_release_event", middle + 30)):
        picker.canvas.callbacks.process(name, MouseEvent(name, picker.canvas, *place, button=1))
    assert picker.chosen == 1


def test_a_plane_that_is_not_there_is_refused(floors):
    with pytest.raises(ValueError, match=r"Invalid plane 2\. Must be one of the 2 planes found"):
        widgets.pick_plane(*floors, chosen=2)


def test_rejects(monkeypatch):
    monkeypatch.delenv("MMQA_HEADLESS", raising=False)
    with pytest.raises(ValueError, match="Must be 3 or more"):
        widgets.select_polygon([[0, 0, 0]])
