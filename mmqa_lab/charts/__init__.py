"""Test charts as data: what is printed where, in millimetres, in grey tones and colours.

One :class:`Layout` is drawn to PDF and SVG, turned into the reflectance that simulated cameras
photograph, and tells the evaluation where everything lies. :func:`encode` and :func:`decode` lead
from linear light to the values of image files and back.
"""

from mmqa_lab.charts.draw import decode, encode, reflectance
from mmqa_lab.charts.elements import Bar, LinePairs, Marker, Text
from mmqa_lab.charts.layout import Layout, how_to_use, imaging_chart, point_chart

__all__ = [
    "Bar", "Layout", "LinePairs", "Marker", "Text", "decode", "encode", "how_to_use",
    "imaging_chart", "point_chart", "reflectance",
]  # fmt: skip
