"""3-D views."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

from mmqa_lab import views
from mmqa_lab.widgets import choice, explore, slider


@pytest.mark.skipif(not views.can_render(), reason="needs the OpenGL libraries of the README")
def test_the_view_shows_the_cloud(rng, tmp_path):
    local = rng.uniform(0, 1, (500, 3)) * [4, 0.1, 3]
    views._plotter(local, local[:, 2], "height (m)").screenshot(tmp_path / "c.png")
    picture = (255 * plt.imread(tmp_path / "c.png")[..., :3]).astype(int).reshape(-1, 3)
    assert len(np.unique(picture, axis=0)) > 50  # colours


@pytest.mark.skipif(not views.can_render(), reason="needs the OpenGL libraries of the README")
def test_long_numbers_of_a_national_grid_do_not_cover_each_other(rng):
    tall = rng.uniform(0, 1, (500, 3)) * [1, 2.8, 6.2] + [2_683_213.5, 1_247_903.2, 408.5]
    axes = views._plotter(tall, tall[:, 2], "height (m)").renderer.cube_axes_actor
    shown = axes.x_labels, axes.y_labels, axes.z_labels
    # the longest axis has room for some 40 characters
    for labels, share in zip(shown, (1 / 6.2, 2.8 / 6.2, 1), strict=True):
        assert sum(map(len, labels)) <= 40 * share
    assert float(shown[1][0]) <= 1_247_903.3
    assert axes.x_title.startswith("easting 2683213.5")  # no room for numbers, so it is named


@pytest.mark.skipif(not views.can_render(), reason="needs the OpenGL libraries of the README")
@pytest.mark.parametrize("shell", [None, object()])
def test_a_view_is_the_notebooks_wherever_it_is_asked_for(shell, monkeypatch):
    """IPython tells only the code of a cell where it runs, not the function of a button."""
    monkeypatch.setattr("IPython.get_ipython", lambda: shell)
    points = np.eye(3)
    assert views._plotter(points, points[:, 2], "height (m)").notebook == (shell is not None)


def test_a_machine_that_cannot_draw_is_found_out_in_a_child(monkeypatch):
    monkeypatch.setattr(views, "PROBE", "import os; os.abort()")
    views.can_render.cache_clear()
    assert views.can_render() is False
    views.can_render.cache_clear()


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
