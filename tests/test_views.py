"""3-D views, with and without OpenGL."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

from mmqa_lab import views
from mmqa_lab.cloud import Cloud
from mmqa_lab.widgets import choice, explore, slider


@pytest.fixture
def cloud(rng):
    """A wall in UTM coordinates."""
    points = rng.uniform(0, 1, (500, 3)) * [4, 0.1, 3] + [448_000, 5_411_000, 100]
    return Cloud(points)


def colours(path):
    """How many colours a picture has."""
    picture = (255 * plt.imread(path)[..., :3]).astype(int).reshape(-1, 3)
    return len(np.unique(picture, axis=0))


def test_without_opengl_a_picture_is_drawn_all_the_same(cloud, tmp_path, monkeypatch):
    monkeypatch.setattr(views, "can_render", lambda: False)
    figure = views.show_cloud(cloud, cloud.points[:, 2], label="height (m)")
    assert figure.axes[0].name == "3d"
    assert figure.axes[1].get_ylabel() == "height (m)"
    figure.savefig(tmp_path / "c.png")
    plt.close(figure)
    assert colours(tmp_path / "c.png") > 50


def test_a_machine_that_cannot_draw_is_found_out_in_a_child(monkeypatch):
    monkeypatch.setattr(views, "PROBE", "import os; os.abort()")
    views.can_render.cache_clear()
    assert views.can_render() is False
    views.can_render.cache_clear()


def test_with_opengl_the_view_shows_the_cloud(cloud, tmp_path):
    if not views.can_render():
        pytest.skip("needs the OpenGL libraries that the README names")
    local = cloud.points - cloud.points.mean(axis=0)
    plotter = views._plotter(local, local[:, 2], "height (m)")
    plotter.screenshot(tmp_path / "c.png")
    assert colours(tmp_path / "c.png") > 50


def test_controls_redraw_where_there_is_a_screen(monkeypatch):
    monkeypatch.delenv("MMQA_HEADLESS", raising=False)
    drawn = []

    def draw(speed, pattern):
        """A figure of two controls."""
        drawn.append((speed, pattern))
        return plt.figure()

    speed = slider("speed", 10, 1, 20, 1, unit="m/s")
    box = explore(draw, speed=speed, pattern=choice("pattern", ["lines", "random"]))
    speed.value = 15
    assert drawn == [(10, "lines"), (15, "lines")]
    assert speed.description == "speed (m/s)"
    assert box.children[0] is speed


def test_without_a_screen_controls_are_the_figure_of_their_start(monkeypatch):
    monkeypatch.setenv("MMQA_HEADLESS", "1")
    figure = explore(lambda speed: plt.figure(num=f"at {speed}"), speed=slider("v", 7, 1, 20, 1))
    assert figure.canvas.manager.get_window_title() == "at 7"
    plt.close(figure)
