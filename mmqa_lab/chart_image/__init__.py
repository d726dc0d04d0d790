"""The imaging chart in photographs: pixel size, resolved line pairs, legibility.

::

    layout = charts.imaging_chart()
    chart_map = chart_image.locate(image, layout)  # or locate(None, layout, corners=corners)
    quality = chart_image.evaluate_image(image, layout, chart_map)

Images are arrays of linear light with full scale 1; :func:`evaluate_file` reads files.
"""

# isort: off
from mmqa_lab.chart_image.alignment import BLOCKS, SIGMAS_PX, align
from mmqa_lab.chart_image.doubts import hidden_texts
from mmqa_lab.chart_image.finding import locate
from mmqa_lab.chart_image.legibility import (
    MARKS, Agreement, Crop, agreement, check_marks, text_crops,
)  # fmt: skip
from mmqa_lab.chart_image.line_pairs import (
    HIDDEN, MOVED, SMALLEST_GAP, SMALLEST_PAIR_PX, PairReading, Resolution, expected_contrast,
    read_pairs, read_pattern, resolution,
)  # fmt: skip
from mmqa_lab.chart_image.maps import Bend, ChartMap, LensCamera, PanoramaCamera, four_corners
from mmqa_lab.chart_image.quality import ImageQuality, evaluate_file, evaluate_image
from mmqa_lab.chart_image.site import PLACE_COLUMNS, chart_site, choose_images
from mmqa_lab.chart_image.tones import Tones, find_tones, pixel_sizes

__all__ = [
    "BLOCKS", "HIDDEN", "MARKS", "MOVED", "PLACE_COLUMNS", "SIGMAS_PX", "SMALLEST_GAP",
    "SMALLEST_PAIR_PX", "Agreement", "Bend", "ChartMap", "Crop", "ImageQuality", "LensCamera",
    "PairReading", "PanoramaCamera", "Resolution", "Tones", "agreement", "align", "chart_site",
    "check_marks", "choose_images", "evaluate_file", "evaluate_image",
    "expected_contrast", "find_tones", "four_corners", "hidden_texts", "locate",
    "pixel_sizes", "read_pairs", "read_pattern", "resolution", "text_crops",
]  # fmt: skip
