"""The jury's form without a browser: order, marks on disk, several jurors."""

import threading

import cv2
import numpy as np
import pandas as pd
import pytest

from mmqa_lab import chart_image, widgets
from mmqa_lab.widgets import jury

CROPS = {name: np.linspace(0, 1, 6 * (9 + k)).reshape(6, -1) for k, name in enumerate("xyz")}


@pytest.fixture
def form(tmp_path):
    """Make a form on one file, for the first juror unless another is named."""

    def make(juror="first"):
        return widgets.JuryForm(CROPS, juror=juror, file=tmp_path / "marks.csv")

    return make


def on_disk(form):
    """The file's rows as tuples."""
    return list(pd.read_csv(form._file).itertuples(index=False, name=None))


def test_buttons_do_what_they_say(form):
    one = form()
    row = one.box.children[1].children
    assert [button.description[:1] for button in row] == ["a", "b", "c"]
    row[1].click()
    row[2].click()
    assert on_disk(one) == [("first", "x", "b"), ("first", "y", "c")]
    assert "3 of 3" in one.box.children[0].value
    row[0].click()
    assert all(button.disabled for button in row)
    assert one.box.children[2].value == b""
    one.mark("c")  # nothing is left to mark
    assert [mark for *_, mark in on_disk(one)] == ["b", "c", "a"]


def test_a_form_goes_on_where_it_was_left(form):
    form().mark("a")
    assert form().element == "y"


def test_jurors_share_a_file_and_see_only_their_own_state(form):
    jurors = [form(name) for name in ("first", "second", "NA")]
    for marks in ("abc", "abc", "acc"):
        for one, mark in zip(jurors, marks, strict=True):
            one.mark(mark)
    assert [one.element for one in jurors] == [None] * 3
    verdict = chart_image.agreement(jurors[0].marks).to_frame()
    assert verdict["n"].tolist() == [3, 3, 3]
    assert verdict["element"].tolist() == ["x", "y", "z"]


def test_picture_is_the_crop_enlarged_without_interpolation(form):
    one = form()
    shown = cv2.imdecode(np.frombuffer(one.box.children[2].value, np.uint8), cv2.IMREAD_UNCHANGED)
    zoom = jury.LARGEST_ZOOM
    assert shown.shape == (6 * zoom, 9 * zoom)
    for k in range(1, zoom):
        assert np.array_equal(shown[::zoom, ::zoom], shown[k::zoom, k::zoom])
    assert (np.diff(shown[0, ::zoom].astype(int)) >= 0).all()  # brighter stays brighter
    wide = widgets.JuryForm({"w": np.eye(3, 500)}, juror="first", file=one._file.with_name("w.csv"))
    assert cv2.imdecode(np.frombuffer(wide.box.children[2].value, np.uint8), 0).shape[1] == 500


def test_without_a_screen_the_crop_is_shown(form, monkeypatch):
    shown = []
    monkeypatch.setattr(jury, "display", shown.append)
    one = form()
    one._ipython_display_()
    assert shown[0].data == one.box.children[2].value
    monkeypatch.setenv("MMQA_HEADLESS", "")
    one._ipython_display_()
    assert shown[1] is one.box


def test_a_file_that_holds_something_else_is_kept(form, tmp_path):
    file = tmp_path / "marks.csv"
    file.write_text("name,age\nx,1\n")
    with pytest.raises(ValueError, match="no column 'juror'"):
        form()
    assert file.read_text() == "name,age\nx,1\n"
    with pytest.raises(ValueError, match="Invalid mark 'd'"):
        widgets.JuryForm(CROPS, juror="first", file=tmp_path / "other.csv").mark("d")


def test_jurors_who_mark_at_the_same_time_lose_no_mark(tmp_path):
    file, crops = tmp_path / "marks.csv", {f"t{k}": np.ones((4, 9)) for k in range(20)}
    forms = [widgets.JuryForm(crops, juror=name, file=file) for name in ("a", "b", "c")]
    threads = [threading.Thread(target=lambda f=f: [f.mark("a") for _ in crops]) for f in forms]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    marks = pd.read_csv(file)
    assert len(marks) == len(marks.drop_duplicates(["juror", "element"])) == 60


@pytest.mark.parametrize("name", [1, "", " "])
def test_a_crop_needs_a_name(tmp_path, name):
    with pytest.raises(ValueError, match="Invalid name of a crop"):
        widgets.JuryForm({name: np.eye(3)}, juror="first", file=tmp_path / "marks.csv")
    with pytest.raises(ValueError, match="Invalid juror:"):
        widgets.JuryForm({"sign": np.eye(3)}, juror=" ", file=tmp_path / "marks.csv")
