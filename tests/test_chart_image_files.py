"""Images from files: what is read, what is cut, and photographs that show no chart at all."""

from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

from mmqa_lab import chart_image, charts, commands, io, samples
from mmqa_lab.chart_image import align
from mmqa_lab.simulate import cameras

CHART = charts.imaging_chart()


@pytest.fixture(scope="module")
def panorama(tmp_path_factory):
    """A whole panorama of 8 megapixels with a chart 3 m away, in sRGB, and the true map."""
    camera = cameras.PanoramaCamera.of_megapixels(8)
    view = cameras.chart_view(camera, distance=3, layout=CHART, heading_deg=20, aim_deg=10)
    sensor = cameras.Sensor(noise=0.01, gamma="srgb", bits=8)
    photo = cameras.photograph(CHART, view, sensor=sensor, seed=2)
    whole = np.full((camera.height, camera.width), 120, dtype=np.uint8)
    (column, row), (rows, columns) = photo.origin, photo.image.shape
    whole[row : row + rows, column : column + columns] = photo.image
    file = tmp_path_factory.mktemp("panorama") / "pano.jpg"
    cv2.imwrite(str(file), whole, [cv2.IMWRITE_JPEG_QUALITY, 95])
    return file, view


def test_targets_and_corners_find_the_same_chart(panorama):
    file, view = panorama
    corners = view.pixels(CHART.corners())
    ways = (
        {"panorama": True},
        {"panorama": True, "corners": corners + 0.6},
    )
    rows = []
    for way in ways:
        quality = chart_image.evaluate_file(file, CHART, **way)
        places = quality.chart_map.pixels(CHART.corners()) + quality.origin
        assert np.abs(places - corners).max() < 0.3
        assert quality.image.size < 500_000  # of 8 million pixels
        rows.append(quality.to_frame().iloc[0])
    for row in rows:
        # 2 pi 3 m / 4000 at the middle, wider away from the normal
        assert row["pixel_v_mm"] == pytest.approx(4.71 / np.cos(np.radians(20)), rel=0.01)
        assert (row["w_h_mm"], row["w_v_mm"]) == (rows[0]["w_h_mm"], rows[0]["w_v_mm"])


def test_windows_are_the_same_pixels_at_the_same_places(panorama):
    file, view = panorama
    corners = view.pixels(CHART.corners())
    quality = chart_image.evaluate_file(file, CHART, panorama=True, corners=corners)
    (column, row), (rows, columns) = quality.origin, quality.image.shape
    expected = io.read_image(file)[row : row + rows, column : column + columns] / 255
    assert quality.image == pytest.approx(charts.decode(expected, "srgb"), abs=1e-6)
    # the whole outline is inside: in a panorama straight edges bulge
    side = quality.chart_map.pixels([[x, y] for x in (0, 1000) for y in range(0, 1001, 50)])
    assert (side > 10).all()
    assert (side < np.array(quality.image.shape[::-1]) - 10).all()


def test_charts_beyond_the_image_are_refused(panorama, tmp_path):
    file, view = panorama
    part, right = tmp_path / "part.png", int(view.pixels(CHART.corners())[1, 0])
    cv2.imwrite(str(part), io.read_image(file)[:, : right - 60])
    with pytest.raises(ValueError, match=r"[12] of 4 coded .* not cut by the border"):
        chart_image.evaluate_file(part, CHART)
    with pytest.raises(ValueError, match=f"Must be within {right - 60} x 2000 pixels"):
        chart_image.evaluate_file(part, CHART, corners=view.pixels(CHART.corners()))
    with pytest.raises(ValueError, match="Must be 2 : 1"):
        chart_image.evaluate_file(part, CHART, panorama=True)


def photographs():
    """Photographs that no one here made: of installed packages, and of MMQA_DATA."""
    import matplotlib
    import sklearn

    folders = [
        Path(matplotlib.get_data_path()) / "sample_data",
        Path(sklearn.__file__).parent / "datasets" / "images",
    ]
    if samples.has_real("images"):
        folders.append(samples.real_path("images"))
    endings = {".jpg", ".png", ".tif"}
    return [
        file for folder in folders for file in sorted(folder.iterdir()) if file.suffix in endings
    ]


@pytest.mark.parametrize("file", photographs(), ids=lambda file: file.name)
def test_photographs_without_a_chart_get_a_sentence(file):
    grey = io.read_image(file)
    rows, columns = grey.shape
    box = [[0, rows - 1], [columns - 1, rows - 1], [columns - 1, 0], [0, 0]]
    with pytest.raises(ValueError, match="coded targets"):
        chart_image.evaluate_file(file, CHART)
    with pytest.raises(ValueError, match="is the chart there"):
        chart_image.evaluate_file(file, CHART, corners=box)


def test_the_sample_photograph_is_measured_as_its_truth_says():
    truth = pd.read_csv(samples.FOLDER / "chart_photo_truth.csv", index_col="quantity")["value"]
    row = chart_image.evaluate_file(samples.path("chart_photo"), CHART).to_frame().iloc[0]
    for direction in "hv":
        pixel, w = f"pixel_{direction}_mm", f"w_{direction}_mm"
        assert row[pixel] == pytest.approx(truth[pixel], rel=1e-3)
        assert row[f"w_{direction}_next_mm"] <= truth[w] <= row[w]  # never finer than the truth
    assert not row["remarks"]


def test_a_chart_printed_too_small_is_measured_with_its_own_length():
    file = samples.path("chart_photo")
    full, small = (
        chart_image.evaluate_file(file, CHART.printed(length)).to_frame().iloc[0]
        for length in (800.0, 792.0)
    )
    for name in ("pixel_h_mm", "pixel_v_mm", "w_h_mm", "w_v_mm"):
        assert small[name] == pytest.approx(0.99 * full[name], rel=1e-3)
    with pytest.raises(ValueError, match=r"printed_mm 79.85\. Must be between 100 and 2000 mm"):
        CHART.printed(79.85)


def test_photographs_without_a_chart_cost_the_others_nothing(tmp_path):
    wall = tmp_path / "wall.png"
    cv2.imwrite(str(wall), np.random.default_rng(0).integers(0, 255, (200, 300), dtype=np.uint8))
    rows = commands.image([wall, samples.path("chart_photo"), tmp_path / "none.jpg"])
    assert rows["file"].tolist() == ["wall.png", "chart_photo.jpg", "none.jpg"]
    assert rows["pixel_v_mm"].notna().tolist() == [False, True, False]
    assert "long bars found" in rows["remarks"][0]
    none = commands.image([wall, wall])
    assert none["remarks"].str.contains("long bars found").tolist() == [True, True]
    assert (rows.attrs["status"], none.attrs["status"]) == (1, 2)


@pytest.mark.parametrize("size", [(5500, 5000), (7200, 6000)])
def test_targets_and_bars_are_found_in_large_photographs_made_smaller(size):
    small = cv2.imread(str(samples.path("chart_photo")), cv2.IMREAD_GRAYSCALE)
    large = np.full(size[::-1], 110, np.uint8)
    part = cv2.resize(small, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
    large[900 : 900 + len(part), 2000 : 2000 + part.shape[1]] = part
    there = chart_image.locate(large, CHART)
    assert there.pixel_sizes_mm([[500, 500]]) == pytest.approx(np.array([[1.65, 1.60]]), rel=0.02)


def test_a_mirrored_chart_is_refused():
    image = cv2.imread(str(samples.path("chart_photo")), cv2.IMREAD_GRAYSCALE)
    with pytest.raises(ValueError, match=r"image: the chart is mirrored\."):
        chart_image.locate(image[:, ::-1], CHART)
    corners = chart_image.locate(image, CHART).pixels(CHART.corners())[[1, 0, 3, 2]]
    corners[:, 0] = image.shape[1] - 1 - corners[:, 0]
    there = chart_image.locate(None, CHART, corners=corners)
    with pytest.raises(ValueError, match=r"image: the chart is mirrored\."):
        align(image[:, ::-1] / 255, CHART, there)
