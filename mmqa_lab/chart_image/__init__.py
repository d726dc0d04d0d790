"""The imaging chart in photographs: pixel size, resolved line pairs, MTF and legibility.

::

    from mmqa_lab import chart_image, charts

    layout = charts.imaging_chart()
    there = chart_image.locate(image, layout)          # or locate(None, layout, corners=corners)
    quality = chart_image.evaluate_image(image, layout, there)
    quality.to_frame(), quality.pairs, quality.edges

Images are arrays of linear light with full scale 1; :func:`evaluate_file` reads
files, :func:`mmqa_lab.io.read_grey` their grey values. The check list of a jury, the mark of a
photograph and what stands in for a jury are in :mod:`mmqa_lab.chart_image.legibility`.
"""

from mmqa_lab.chart_image.evaluation import ImageQuality, evaluate_file, evaluate_image
from mmqa_lab.chart_image.geometry import ChartMap, FrameCamera, PanoramaCamera
from mmqa_lab.chart_image.placing import locate
from mmqa_lab.chart_image.reading import read_pairs, resolution
from mmqa_lab.chart_image.rules import (
    agreement,
    chart_site,
    check_drive,
    choose_images,
    quality_index,
    text_crops,
)

__all__ = [
    "ChartMap",
    "FrameCamera",
    "ImageQuality",
    "PanoramaCamera",
    "agreement",
    "chart_site",
    "check_drive",
    "choose_images",
    "evaluate_file",
    "evaluate_image",
    "locate",
    "quality_index",
    "read_pairs",
    "resolution",
    "text_crops",
]
__dir__ = __all__.copy
