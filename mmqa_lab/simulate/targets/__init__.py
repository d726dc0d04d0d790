"""Resolution and radiometric targets and blocks of images of known truth."""

from mmqa_lab.simulate.targets.blocks import (
    ATMOSPHERES,
    FLIGHT_LENGTH_M,
    SURFACES,
    Atmosphere,
    Flight,
    ImageBlock,
    fly_block,
)
from mmqa_lab.simulate.targets.resolution import (
    FINE,
    PointSpread,
    blur_over_image,
    expose,
    render_bars,
    render_edge,
    render_star,
    texture,
)

__all__ = [
    "ATMOSPHERES", "FINE", "FLIGHT_LENGTH_M", "SURFACES", "Atmosphere", "Flight", "ImageBlock",
    "PointSpread", "blur_over_image", "expose", "fly_block", "render_bars", "render_edge",
    "render_star", "texture",
]  # fmt: skip
