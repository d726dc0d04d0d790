"""Argument checks with one message pattern: what is wrong, its value, what is expected."""

# isort: off
from mmqa_lab._checks.arrays import (
    FARTHEST_M, check_image, check_plan, check_points, check_polygon, check_row, check_same_crs,
    check_together, check_upright, check_values, coordinate_columns, plain_name,
    polygon_rings, real_array, remark_on_map,
    type_step,
)  # fmt: skip
from mmqa_lab._checks.words import (
    check_choice, check_columns, check_count, check_file, check_kind, check_known, check_number,
    check_outputs, check_positive, full_path, is_file, listed, needs, refuse,
)  # fmt: skip

__all__ = [
    "FARTHEST_M", "check_choice", "check_columns", "check_count", "check_file", "check_image",
    "check_kind", "check_known", "check_number", "check_outputs", "check_plan", "check_points",
    "check_polygon", "check_positive", "check_row", "check_same_crs", "check_together",
    "check_upright", "check_values", "coordinate_columns", "full_path", "is_file", "listed",
    "needs", "plain_name", "polygon_rings", "real_array", "refuse", "remark_on_map",
    "type_step",
]  # fmt: skip
