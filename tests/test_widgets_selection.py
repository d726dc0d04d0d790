"""The polygon and the list of planes without a browser: what they compute, keep and say."""

import io as streams
import itertools
import threading
from contextlib import redirect_stdout

import matplotlib.pyplot as plt
import numpy as np
import pytest
from IPython.core.displaypub import CapturingDisplayPublisher
from matplotlib.backend_bases import MouseEvent

from mmqa_lab import plots, widgets
from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.cloud import Cloud
from mmqa_lab.io import read_outlines
from mmqa_lab.planes import fit_plane
from mmqa_lab.widgets import selection, surfaces
from mmqa_lab.widgets.screen import LOCK

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
def screen(monkeypatch):
    """A person at a screen."""
    monkeypatch.delenv("MMQA_HEADLESS", raising=False)


def test_the_first_polygon_is_upright_and_nearly_the_whole_wall(wall):
    tool = widgets.SelectionTool(wall)
    assert tool.quality.n == evaluate_cloud(wall, polygon=tool.vertices).n > 0.85 * len(wall)
    edges = np.diff(tool.vertices, axis=0)
    assert np.abs(np.prod(edges[:, [0, 2]], axis=1)).max() < 1e-3  # level or plumb


def test_a_saved_picture_is_drawn_as_before(wall):
    with plt.style.context(plots.STYLE):
        tool = widgets.SelectionTool(wall)
        first, second = streams.BytesIO(), streams.BytesIO()
        tool.figure.savefig(first)  # what the button of the toolbar does
        tool.select(tool.vertices)
        tool.figure.savefig(second)
    assert first.getvalue() == second.getvalue()


def test_the_first_rectangle_follows_a_strip(rng):
    strip = rng.uniform(-1, 1, (20_000, 3)) * [20, 1, 0]
    turned = strip @ [[0.8, 0.6, 0], [-0.6, 0.8, 0], [0, 0, 1]]
    tool = widgets.SelectionTool(turned)
    assert tool.quality.area_polygon_m2 > 0.9 * 2 * selection.WINDOW * 2  # all of the window
    box = tool._map.get_window_extent()
    height = np.ptp(tool._map.transData.transform(tool._selector.verts), axis=0)[1]
    assert height > 0.3 * box.width  # high enough to draw on
    assert tool._place.layout.display is None
    centres = []
    for share in (0, 1):  # the window moves from end to end, a polygon in each
        tool._place.value = share
        centres.append(tool.vertices.mean(axis=0))
        (low, high), x = tool._map.get_xlim(), np.array(tool._selector.verts)[:, 0]
        assert low < x.min() < x.max() < high
    assert np.linalg.norm(centres[1] - centres[0]) == pytest.approx(40 - 5, abs=0.5)


def test_a_long_polygon_is_shown_whole(rng):
    strip = rng.uniform(-1, 1, (20_000, 3)) * [20, 1, 0]
    drawn = [[-15, -0.5, 0], [15, -0.5, 0], [15, 0.5, 0], [-15, 0.5, 0]]
    tool = widgets.SelectionTool(strip, polygon=drawn)
    assert tool.quality.area_polygon_m2 == pytest.approx(30, abs=0.1)
    assert np.ptp(tool._map.get_xlim()) > 30


def test_corners_are_typed_undone_and_kept_as_points(wall, screen):
    tool = widgets.SelectionTool(wall)
    first, corners = tool.vertices, tool._corners.value
    assert len(corners.split(";")) == 4
    square = tool._to_space([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    tool._corners.value = ";\n".join("{:.4f} {:.4f} {:.4f}".format(*one) for one in square) + ";"
    assert tool.quality.area_polygon_m2 == pytest.approx(1, abs=1e-3)
    assert tool.selected().sum() == tool.quality.n
    assert tool.quality.n == evaluate_cloud(tool.points[tool.selected()]).n
    typed = tool._to_space([[0, 0], [0.8, 0.8], [0.8, 0]]).round(4)
    comma = "\n".join(" ".join(map(str, one)).replace(".", ",") for one in typed.tolist())
    tool._corners.value = comma
    assert np.allclose(tool.vertices, typed, atol=1e-3)
    tool._undo.click()
    assert tool.quality.area_polygon_m2 == pytest.approx(1, abs=1e-3)
    tool._undo.click()
    assert np.allclose(tool.vertices, first, atol=1e-6)
    assert tool._corners.value == corners
    tool._undo.click()  # nothing is left to undo
    assert tool._corners.value == corners


@pytest.mark.parametrize(
    "text", ["", "0, 0, 0; 1, 1, 1", "0, 0, 0; 1, b, 0; 2, 0, 1", "0, 0; 1, 1; 1, 0"]
)
def test_typed_corners_that_are_none_are_a_sentence_and_change_nothing(wall, screen, text):
    tool = widgets.SelectionTool(wall)
    before = tool.quality
    tool._corners.value = text
    assert f"Invalid corners {text}. Must be" in tool.text.value
    assert tool.quality is before


def test_places_that_would_not_show_a_detail_are_marked(screen):
    x, y = np.meshgrid(np.arange(0, 2, 0.005), np.arange(0, 2, 0.06))  # lines 6 cm apart
    x, y = x[(y < 1) | (y > 1.3)], y[(y < 1) | (y > 1.3)]
    points = np.stack([x, y, 0 * x], axis=1)
    square = [[0, 0, 0], [2, 0, 0], [2, 1.9, 0], [0, 1.9, 0]]
    tool = widgets.SelectionTool(points, polygon=square, detail=0.05)
    share, missed = tool.quality.details(0.05)
    assert f"{100 * share:.1f} % of its places would show a detail of 50 mm" in tool.text.value
    marked = tool._to_space(np.transpose(tool._missed.get_data()))
    assert len(marked) == len(missed)
    assert np.mean((marked[:, 1] > 1) & (marked[:, 1] < 1.3)) > 0.4  # the gap
    tool._corners.value = "0, 0, 0; 0.02, 0, 0; 0, 0.02, 0"
    assert not len(tool._missed.get_data()[0])


def test_a_cross_section_shows_the_strip_that_its_slider_moves(rng, screen):
    points = rng.uniform(0, 4, (20_000, 3)) * [1, 0.5, 0]
    points[:, 2] = 0.03 * (np.abs(points[:, 1] - 1) < 0.2)  # a ridge along x
    square = [[0, 0, 0], [4, 0, 0], [4, 2, 0], [0, 2, 0]]
    tool = widgets.SelectionTool(points, polygon=square)
    heights = []
    for share in (0.2, 0.5):
        tool._cut.value = share
        (drawn,) = tool._panels[2].lines
        assert len(drawn.get_xdata()) == pytest.approx(0.1 * len(points), rel=0.01)
        assert np.ptp(drawn.get_xdata()) > 3.9
        heights.append(drawn.get_ydata())
        across = tool._strip.get_y() + np.array([0, tool._strip.get_height()])
        assert np.ptp(across) == pytest.approx(0.2, abs=0.02)
    step = np.median(heights[1]) - np.median(heights[0])
    assert abs(step) == pytest.approx(30, abs=1)


def test_only_planes_that_matter_are_listed(rng, screen):
    wide = rng.uniform(0, 12, (20_000, 3)) * [1, 1, 0]
    posts = [rng.uniform(0, 1, (150, 3)) * [1, 0, 1] + [2 * k, 13, 1] for k in range(6)]
    tool = widgets.SurfaceTool({"street": np.concatenate([wide, *posts])}, size=0.5)
    assert len(tool.planes) > 5
    assert [number for _, number in tool._list.options] == [0]


def test_a_dragged_corner_changes_everything_that_follows(wall, screen):
    tool, seen = widgets.SelectionTool(wall), []
    tool.follow(lambda tool: seen.append(tool.quality.n))
    pressed = []
    tool.follow(button="Write")(lambda tool: pressed.append(tool.quality.n))
    before, text = np.asarray(tool.canvas.buffer_rgba()).copy(), tool.text.value
    ax, corner = tool._map, tool._selector.verts[2]
    x, y = ax.transData.transform(corner)
    for name, place in (
        ("motion_notify_event", (x, y)),
        ("button_press_event", (x, y)),
        ("motion_notify_event", (x - 60, y - 60)),
        ("button_release_event", (x - 60, y - 60)),
    ):
        button = None if name.startswith("motion") and place == (x, y) else 1
        MouseEvent(name, tool.canvas, *place, button=button)._process()
    tool.canvas.draw()
    assert len(seen) == 2
    assert tool.quality.n == seen[1] < seen[0]
    assert pressed == []  # nobody pressed the button
    assert tool.text.value != text
    assert not np.array_equal(np.asarray(tool.canvas.buffer_rgba()), before)


@pytest.mark.parametrize(
    ("order", "rise_m", "part"),
    [
        ([0, 1, 2, 3], 100, "points inside the polygon: 0 given"),
        ([0, 2, 1, 3], 0, "crosses itself."),
    ],
)
def test_a_polygon_that_selects_nothing_is_a_sentence_below_the_last_picture(
    wall, order, rise_m, part
):
    tool = widgets.SelectionTool(wall)
    assert all(panel.has_data() for panel in tool._panels)
    tool.select(tool.vertices[order] + [0, 0, rise_m])
    assert tool.quality is None
    assert part in tool.text.value
    assert all(panel.has_data() for panel in tool._panels)
    assert np.allclose(tool._selector.verts, tool.frame.project(tool.vertices))
    tool._cut.value = 0.1  # a strip of nothing
    tool.undo()
    assert tool.quality is not None


def test_a_picture_is_not_drawn_while_it_changes(wall, screen):
    tool, drawn = widgets.SelectionTool(wall), threading.Event()
    draw = threading.Thread(target=lambda: (tool.canvas.draw(), drawn.set()))
    with LOCK:
        draw.start()
        assert not drawn.wait(0.3)
    assert drawn.wait(30)


@pytest.fixture
def clouds(rng, wall):
    """A corner of two planes, and the wall."""
    flat = rng.uniform(0, 5, (3000, 3))
    return {"corner": np.concatenate([flat * [1, 1, 0], flat[:2000] * [1, 0, 1]]), "wall": wall}


def test_a_click_in_the_list_chooses_a_plane_of_any_cloud(clouds, screen):
    tool = widgets.SurfaceTool(clouds, size=2)
    assert tool.planes["cloud"].tolist() == ["corner", "corner", "wall"]
    assert tool.planes["slope_deg"].round().tolist() == [0, 90, 90]
    tool._list.value = 1
    assert (tool.name, tool.number) == ("corner", 1)
    assert abs(fit_plane(tool.points).normal[1]) == pytest.approx(1)
    tool._clouds.value = "wall"
    assert tool.name == "wall"
    assert "wall facing" in tool._list.label
    tool._scene.draw_without_rendering()
    ticks = [text.get_text() for text in tool._scene.axes[0].get_xticklabels()]
    assert min(map(float, ticks)) > 499_000  # easting as it is


def test_a_click_in_the_picture_chooses_the_plane_there(clouds, screen):
    tool = widgets.SurfaceTool(clouds, size=2)
    tool._scene.draw_without_rendering()
    ax, places = tool._scene.axes[0], tool._scene_dots.get_offsets()
    owned = np.flatnonzero(tool._owner == 1)
    on = owned[np.abs(places[owned] - places[owned].mean(axis=0)).sum(axis=1).argmin()]
    x, y = ax.transData.transform(places[on])
    number = int(tool._owner[np.hypot(*(places - places[on]).T).argmin()])
    tool._scene_canvas.toolbar.mode = "zoom rect"
    MouseEvent("button_press_event", tool._scene_canvas, x, y, button=1)._process()
    assert tool.number == 0
    tool._scene_canvas.toolbar.mode = ""
    MouseEvent("button_press_event", tool._scene_canvas, x, y, button=1)._process()
    assert tool.number == number
    assert tool._list.value == number


def test_without_a_screen_the_tool_is_two_pictures(clouds):
    tool, said = widgets.SurfaceTool(clouds, size=2), streams.StringIO()
    tool.follow(lambda tool: print(tool.quality.n, file=said))
    assert int(said.getvalue()) == tool.quality.n
    with redirect_stdout(said):
        tool._ipython_display_()
    assert said.getvalue().count("Figure(") == 2


def test_a_cloud_without_planes_costs_the_others_nothing(clouds, rng):
    thin = rng.uniform(0, 60, (500, 3)) * [1, 1, 0]  # a point in 7 m2
    tool = widgets.SurfaceTool({"noise": rng.random((9, 3)), **clouds, "thin": thin}, size=2)
    assert tool.missing == ["noise: no plane of 2 m or more."]
    found = tool.planes.groupby("cloud")["points"].max()
    assert set(found.index) == {*clouds, "thin"}
    assert found["thin"] == len(thin)  # one plane, not splinters of the size asked for


def test_clouds_without_planes_are_refused(rng):
    with pytest.raises(ValueError, match="Invalid cloud noise, dust: no plane of 2 m"):
        widgets.SurfaceTool({name: rng.random((9, 3)) for name in ("noise", "dust")}, size=2)


def test_no_other_plane_has_the_colour_of_the_largest(rng):
    sizes = np.linspace(4, 2, 8)
    steps = [rng.uniform(0, 1, (2000, 3)) * [e, e, 0] + [0, 6 * k, k] for k, e in enumerate(sizes)]
    tool = widgets.SurfaceTool({"steps": np.concatenate(steps)}, size=1)
    tool.choose("steps", 1)
    colours = tool._scene_dots.get_facecolor()
    assert len(tool.planes) == len(sizes)
    same = (colours == colours[tool._owner == 0][0]).all(axis=1)
    assert set(tool._owner[same]) == {0}


def test_points_that_mislead_the_plane_have_rings_and_are_left_out_by_a_button(rng, screen):
    x, z = rng.uniform(0, 1, (2, 6000)) * [[4], [1.4]]
    proud = z < 0.1
    facade = np.stack([x, 0.003 * rng.standard_normal(6000) + 0.06 * proud, z], axis=1)
    outline = [[0, 0, 0], [4, 0, 0], [4, 0, 1.4], [0, 0, 1.4]]
    tool = widgets.SelectionTool(facade, polygon=outline)
    assert tool._alone.layout.display is None
    marked = tool._to_space(np.transpose(tool._off.get_data()))
    assert len(marked) > 100
    assert (marked[:, 2] < 0.11).all()
    with_them = tool.quality.sigma_mad_mm
    tool._alone.click()
    assert tool.quality.n == pytest.approx((~proud).sum(), abs=3)
    assert tool.quality.sigma_mad_mm == pytest.approx(3, rel=0.05)
    assert "within ±" in tool.text.value
    assert tool._alone.layout.display == "none"
    tool.undo()
    assert tool.quality.sigma_mad_mm == with_them


def test_of_many_points_those_around_the_middle_come_first(rng, screen, monkeypatch):
    monkeypatch.setattr(selection, "SHOWN_FIRST", 2000)
    monkeypatch.setattr(selection, "SETTLED_S", 0.2)
    points = rng.uniform(0, 2, (9000, 3)) * [1, 1, 0]
    square = [[0.1, 0.1, 0], [1.9, 0.1, 0], [1.9, 1.9, 0], [0.1, 1.9, 0]]
    tool = widgets.SelectionTool(points, polygon=square)
    seen = []
    tool.follow(lambda tool: seen.append(tool.quality.n))
    for shift in (0.01, 0.02, 0.03):  # steps in a row: all points once, at their end
        tool.select(np.add(square, [shift, 0, 0]))
        assert "Working" in tool.text.value
        assert tool.quality.n == pytest.approx(2000, rel=0.1)
    whole = tool.evaluate()
    assert whole.n > 6000
    for thread in threading.enumerate():
        if "_settle" in thread.name:
            thread.join(30)
    assert tool.quality.n == whole.n == seen[-1]
    assert [one > 6000 for one in seen] == [False] * 4 + [True]
    assert "Working" not in tool.text.value


@pytest.fixture
def room(rng):
    """A room of 6 m x 4 m x 3 m with colours."""
    flat = rng.uniform(0, 1, (6, 2500, 3)) * [6, 4, 3]
    for side, (axis, value) in enumerate(((2, 0), (2, 3), (1, 0), (1, 4), (0, 0), (0, 6))):
        flat[side, :, axis] = value
    rgb = {name: np.full(15_000, 200 + k, np.uint16) for k, name in enumerate(("red", "green"))}
    return Cloud(flat.reshape(-1, 3), rgb | {"blue": np.zeros(15_000)}, resolution=0.002)


def test_floor_ceiling_and_walls_are_told_apart(room, screen):
    tool = widgets.SurfaceTool({"room": room}, size=1)
    assert sorted(tool.planes["kind"]) == sorted(
        ["floor", "ceiling", *(f"wall facing {one}" for one in ("north", "south", "east", "west"))]
    )
    south = tool.planes.set_index("kind").loc["wall facing north"]
    assert south["northing_m"] == pytest.approx(0, abs=0.01)
    assert tool.planes.set_index("kind").loc["ceiling", "up_m"] == pytest.approx(3, abs=0.01)
    assert tool.quality.step_mm == 2.0  # of the file
    kinds = tool.planes["kind"][tool._owner[tool._owner >= 0]]
    assert "ceiling" in set(kinds)
    tool._top.value = 0.6
    kinds = tool.planes["kind"][tool._owner[tool._owner >= 0]]
    assert "ceiling" not in set(kinds)  # now a click finds the floor
    assert "floor" in set(kinds)
    tool._true.value = True
    colours = tool._scene_dots.get_facecolor()[tool._owner != tool.number]
    np.testing.assert_allclose(colours[:, :3], [[200 / 255, 201 / 255, 0]] * len(colours))


def test_the_list_of_planes_is_as_wide_as_its_box(room, screen):
    turned = room.points @ np.array([[1, 1, 0], [-1, 1, 0], [0, 0, 2**0.5]]) / 2**0.5
    house = np.concatenate([turned, turned + [0, 0, 3.3]])
    tool = widgets.SurfaceTool({"house": house}, tolerance=0.05, size=1)
    assert all("storey" in text for text, _ in tool._list.options)
    assert any("wall facing NW" in text for text, _ in tool._list.options)
    assert max(len(text) for text, _ in tool._list.options) <= 45  # of 292 pixels
    assert "wall facing north-west" in set(tool.planes["kind"])


def test_eastings_of_a_national_grid_stand_beside_each_other(rng, screen):
    wall = rng.uniform(0, 1, (3000, 3)) * [9.7, 0.01, 9.1] + [4_464_120.6, 5_333_972.7, 515]
    tool = widgets.SurfaceTool({"wall": wall}, size=1)
    tool._scene.draw_without_rendering()
    (low, high), texts = tool._scene.axes[0].get_xlim(), tool._scene.axes[0].get_xticklabels()
    boxes = [one.get_window_extent() for one in texts if low <= one.get_position()[0] <= high]
    assert len(boxes) > 1
    assert all(one.x1 < other.x0 for one, other in itertools.pairwise(boxes))


def test_storeys_are_counted_by_their_floors_and_a_pavement_is_no_ceiling(room, rng, screen):
    desk = rng.uniform(0, 1, (400, 3)) * [1.5, 1, 0] + [2, 1, 0.75]
    storey = np.concatenate([room.points, desk])
    flat = rng.uniform(0, 1, (3, 3000, 3)) * [12, 4, 3]
    flat[0, :, 2], flat[1, :, 2], flat[2, :, 1] = 0, 0.2, 6
    flat[1, :, 1] = 4 + flat[1, :, 1] / 2  # a pavement between a street and a wall
    clouds = {"house": np.concatenate([storey, storey + [0, 0, 3.3]]), "street": np.vstack(flat)}
    tool = widgets.SurfaceTool(clouds, tolerance=0.05, size=0.5)
    found = tool.planes.groupby(["cloud", "kind", "storey"]).size()
    assert found["house", "floor"].to_dict() == {1: 2, 2: 2}  # with the desks
    assert found["house", "ceiling"].to_dict() == {1: 1, 2: 1}
    assert found["house", "wall facing north"].to_dict() == {1: 1, 2: 1}
    assert found["street"].index.tolist() == [("floor", 1), ("wall facing south", 1)]
    assert all("storey" in text for text, _ in tool._list.options)


def test_an_interrupted_search_is_a_sentence(clouds, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(surfaces, "detect_planes", interrupted)
    with pytest.raises(widgets.Halt, match="Interrupted: planes of corner were sought"):
        widgets.SurfaceTool(clouds)


def test_a_cloud_or_plane_that_is_not_there_is_refused_and_changes_nothing(clouds, rng, screen):
    tool = widgets.SurfaceTool({"noise": rng.random((9, 3)), **clouds}, size=2)
    for place, part in ((("noise",), "cloud 'noise'"), (("wall", 99), "plane of wall 99")):
        with pytest.raises(ValueError, match=f"Invalid {part}"):
            tool.choose(*place)
        assert tool.name == "corner"


def test_selections_are_kept_under_names_shown_again_and_compared(room, screen):
    tool = widgets.SurfaceTool({"room": room}, size=1)
    numbers = tool.planes.set_index("kind")["plane"]
    for kind, shrunk in (("floor", 1), ("wall facing north", 1), ("wall facing north", 0.9)):
        tool.choose("room", int(numbers[kind]))
        centre = tool.vertices.mean(axis=0)
        tool.select(centre + shrunk * (tool.vertices - centre))
        name = tool.kept.keep()
        assert tool.kept.keep() == name  # it is kept already
    assert list(tool.kept.selections) == ["floor 1", "wall facing north 1", "wall facing north 2"]
    assert tool.kept.keep("my wall") == "my wall"
    assert tool.kept.keep("my wall") == "my wall 2"
    assert len(tool._outlines) == 2 * 5
    table = tool.kept.table()
    assert table["selection"].tolist() == list(tool.kept.selections)
    assert table["n"].tolist() == [one.quality.n for one in tool.kept.selections.values()]
    assert set(table["thickness_m"]) == {0.1}
    tool.kept._list.value = "floor 1"
    assert tool.number == numbers["floor"]
    np.testing.assert_allclose(tool.vertices, tool.kept.selections["floor 1"].polygon, atol=1e-9)
    tool.kept.forget("my wall")
    assert "my wall" not in tool.kept._list.options


def test_a_click_while_a_followers_output_is_captured_is_heard():
    # a kernel calls this of the publisher in place, before it looks what the message asks for
    CapturingDisplayPublisher().set_parent({"header": {}})


def test_kept_polygons_are_written_cloud_by_cloud(room, wall, screen, tmp_path):
    tool = widgets.SurfaceTool({"room": room, "wall": wall}, size=1)
    for cloud in ("room", "wall"):
        tool.choose(cloud)
        tool.kept.keep(f"of {cloud}")
    tool.kept.write(tmp_path / "room.geojson", "room")
    tool.kept.write(tmp_path / "chosen.geojson")
    for file, cloud in (("room", "room"), ("chosen", "wall")):
        ((name, ring),) = read_outlines(tmp_path / f"{file}.geojson")
        assert name == f"of {cloud}"
        np.testing.assert_allclose(ring, tool.kept.selections[name].polygon, atol=1e-9)


@pytest.mark.parametrize("names", [("red", "green", "blue"), ("R", "G", "B")])
def test_true_colours_are_those_of_scanners_and_of_texts(names):
    columns = {name: np.array([51 * k, 255]) for k, name in enumerate(names)}
    rgb = surfaces.true_colours(Cloud(np.zeros((2, 3)), columns))
    np.testing.assert_allclose(rgb, [[0, 0.2, 0.4], [1, 1, 1]])
    assert surfaces.true_colours(Cloud(np.zeros((2, 3)), {names[0]: np.zeros(2)})) is None
