"""The field's metrics of a planar point pattern and its noise, each with its source."""

__all__ = []
