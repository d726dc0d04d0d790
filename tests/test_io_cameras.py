"""Calibrations of cameras as OpenCV, its tutorials and ROS write them."""

import json

import cv2
import numpy as np
import pytest
import yaml

from mmqa_lab import io

MATRIX = np.array([[912.5, 0.0, 640.25], [0.0, 911.0, 360.5], [0.0, 0.0, 1.0]])
TERMS = np.array([-0.31, 0.12, 0.001, -0.0005, 0.02])
SIZE = (1280, 720)


def by_opencv(ending):
    """A file of OpenCV's own storage."""
    store = cv2.FileStorage(ending, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    store.write("image_width", SIZE[0])
    store.write("image_height", SIZE[1])
    store.write("camera_matrix", MATRIX)
    store.write("distortion_coefficients", TERMS[:, None])
    return store.releaseAndGetString()


def by_ros():
    """The text of a camera's topic: flat lists with rows and columns."""
    return (
        "image_width: 1280\nimage_height: 720\ncamera_name: left\ndistortion_model: plumb_bob\n"
        f"camera_matrix:\n  rows: 3\n  cols: 3\n  data: {MATRIX.ravel().tolist()}\n"
        f"distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: {TERMS.tolist()}\n"
    )


PLAIN = {"camera_matrix": MATRIX.tolist(), "dist_coeff": [TERMS.tolist()]}

FILES = {
    "a.yml": by_opencv("a.yml"),
    "old.yml": by_opencv("a.yml").replace("%YAML 1.2", "%YAML:1.0"),
    "a.xml": by_opencv("a.xml"),
    "opencv.json": by_opencv("a.json"),
    "ros.yaml": by_ros(),
    "plain.yaml": yaml.dump(PLAIN, default_flow_style=False),
    "mixed.yaml": yaml.dump(PLAIN, default_flow_style=None),
    "plain.json": json.dumps({"K": MATRIX.tolist(), "D": TERMS.tolist()}, indent="\t"),
}


@pytest.mark.parametrize("name", FILES)
def test_every_form_of_a_calibration_gives_the_same(name, tmp_path):
    (tmp_path / name).write_text(FILES[name])
    matrix, terms, size = io.read_camera(tmp_path / name)
    assert matrix.tolist() == MATRIX.tolist()
    assert terms.tolist() == TERMS.tolist()
    assert size == (SIZE if "image" in FILES[name] else None)


REFUSED = {
    "no coefficients": {"camera_matrix": MATRIX.tolist()},
    "three of them": {"K": MATRIX.tolist(), "D": [0.1, 0.2, 0.3]},
    "words": {"K": MATRIX.tolist(), "D": ["a", "b", "c", "d"]},
    "a fisheye": {"K": MATRIX.tolist(), "D": [0.1] * 4, "distortion_model": "equidistant"},
    "transposed": {"K": MATRIX.T.tolist(), "D": TERMS.tolist()},
    "a list": [1, 2, 3],
    "no file of this kind": "hello\n\t- : world",
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_file_that_is_no_calibration_is_refused_in_a_sentence(name, tmp_path):
    content = REFUSED[name]
    text = content if isinstance(content, str) else json.dumps(content)
    (tmp_path / "camera.json").write_text(text)
    with pytest.raises(ValueError, match=r"Invalid camera .*camera\.json.*\. Must "):
        io.read_camera(tmp_path / "camera.json")


def test_a_calibration_of_another_size_is_refused(tmp_path):
    from mmqa_lab import chart_image, charts

    (tmp_path / "a.yml").write_text(FILES["a.yml"])
    cv2.imwrite(str(tmp_path / "photo.png"), np.zeros((60, 80), np.uint8))
    with pytest.raises(ValueError, match="for 80 x 60 pixels"):
        chart_image.evaluate_file(
            tmp_path / "photo.png", charts.imaging_chart(), calibration=tmp_path / "a.yml"
        )
