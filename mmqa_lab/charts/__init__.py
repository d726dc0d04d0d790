"""Test charts as data: what is printed where, in millimetres, in black, white and tones between.

One :class:`Layout` is drawn to PDF and SVG, turned into the reflectance that simulated cameras
photograph, and tells the evaluation where everything lies. The origin is the lower left corner, x
to the right, y up. Tones are relative reflectances, 0 black, 1 white.
"""

from mmqa_lab.charts.drawing import reflectance, to_pdf, to_svg
from mmqa_lab.charts.elements import Bar, Cells, Layout, LinePairs, Marker, Text, from_json, to_json
from mmqa_lab.charts.layouts import WIDTHS_H_MM, WIDTHS_V_MM, imaging_chart, point_chart

__all__ = [
    "WIDTHS_H_MM",
    "WIDTHS_V_MM",
    "Bar",
    "Cells",
    "Layout",
    "LinePairs",
    "Marker",
    "Text",
    "from_json",
    "imaging_chart",
    "point_chart",
    "reflectance",
    "to_json",
    "to_pdf",
    "to_svg",
]
