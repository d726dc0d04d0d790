"""3-D views, with and without a screen."""

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


def test_without_a_screen_it_is_a_figure(cloud):
    values = cloud.points[:, 2].copy()
    values[:10] = np.nan
    figure = views.show_cloud(cloud, values, label="height (m)")
    assert figure.axes[0].name == "3d"
    assert figure.axes[1].get_ylabel() == "height (m)"
    assert len(figure.axes[0].collections[0].get_array()) == 490
    plt.close(figure)


def test_the_view_has_the_points_in_single_precision_and_their_values(cloud, monkeypatch):
    monkeypatch.delenv("MMQA_HEADLESS")
    heights = cloud.points[:, 2] - 100
    plot = views.show_cloud(cloud, heights, label="height (m)")
    points, text = plot.objects
    local = cloud.points - cloud.points.mean(axis=0)
    assert np.abs(points.positions - local).max() < 1e-6
    assert points.attribute == pytest.approx(heights, abs=1e-6)
    assert plot.colorbar_object_id == points.id
    assert text.text == "height (m)"


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
