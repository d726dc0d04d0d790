"""Planes: the regression plane of points, their dispersion, and the planes of whole clouds."""

from mmqa_lab.planes.regression import (
    CONSISTENT_SCALE,
    PAPER_SCALE,
    TUKEY,
    Plane,
    fit_circle,
    fit_line,
    fit_plane,
    flat_points,
    sigma_mad,
    turned_axes,
)

__all__ = [
    "CONSISTENT_SCALE",
    "PAPER_SCALE",
    "TUKEY",
    "Plane",
    "detect_planes",
    "fit_circle",
    "fit_line",
    "fit_plane",
    "flat_points",
    "sigma_mad",
    "turned_axes",
]
__dir__ = __all__.copy


def __getattr__(name):
    """The detection when it is asked for: it is compiled, and importing numba takes a while."""
    if name == "detect_planes":
        from mmqa_lab.planes.detection import detect_planes

        return detect_planes
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
