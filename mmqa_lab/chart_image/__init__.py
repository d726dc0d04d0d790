"""The imaging chart in photographs: pixel size, resolved line pairs, MTF and legibility.

::

    from mmqa_lab import chart_image, charts

    layout = charts.imaging_chart()
    there = chart_image.locate_markers(image, layout)          # or locate_corners(corners, layout)
    quality = chart_image.evaluate_image(image, layout, there)
    quality.to_frame(), quality.pairs, quality.edges

Images are arrays of linear light with full scale 1; :func:`evaluate_file` reads
files, :func:`mmqa_lab.io.read_grey` their grey values.
"""

from mmqa_lab.chart_image.evaluation import ImageQuality, bar_edges, evaluate_image
from mmqa_lab.chart_image.files import (
    cut,
    evaluate_file,
    panorama_of,
    read_layout,
    read_orientation,
)
from mmqa_lab.chart_image.legibility import (
    agreement,
    quality_index,
    text_crops,
)
from mmqa_lab.chart_image.levels import Tones, tones
from mmqa_lab.chart_image.line_pairs import (
    expected_contrast,
    read_pairs,
    read_pattern,
    resolution,
)
from mmqa_lab.chart_image.locate import align, locate_corners, locate_markers
from mmqa_lab.chart_image.mapping import ChartMap, FrameCamera, PanoramaCamera, Pose
from mmqa_lab.chart_image.pixel_size import pixel_size, pixel_sizes
from mmqa_lab.chart_image.site import Limits, chart_site, check_drive, choose_images
from mmqa_lab.mtf.edge_method import edge_response

__all__ = [
    "ChartMap",
    "FrameCamera",
    "ImageQuality",
    "Limits",
    "PanoramaCamera",
    "Pose",
    "Tones",
    "agreement",
    "align",
    "bar_edges",
    "chart_site",
    "check_drive",
    "choose_images",
    "cut",
    "edge_response",
    "evaluate_file",
    "evaluate_image",
    "expected_contrast",
    "locate_corners",
    "locate_markers",
    "panorama_of",
    "pixel_size",
    "pixel_sizes",
    "quality_index",
    "read_layout",
    "read_orientation",
    "read_pairs",
    "read_pattern",
    "resolution",
    "text_crops",
    "tones",
]
