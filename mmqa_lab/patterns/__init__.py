"""Scan patterns measured in point clouds."""

from mmqa_lab.patterns.measure import PatternMeasurement, measure_pattern

__all__ = ["PatternMeasurement", "measure_pattern"]
