"""What black and white are in the image of a chart, and how much noise there is.

Everything downstream reads the image in units of print: 0 where the black of the chart is, 1 where
its white is.
"""

from dataclasses import dataclass

import numpy as np

from mmqa_lab.charts import reflectance

CLEARANCES_PX = (3.0, 2.5, 2.0, 1.5, 1.2, 1.0)
"""A pixel is plain when the next other tone is so far away; the widest that is possible counts."""

PLAIN_PIXELS = 30
"""So many black and white pixels each are enough for a level."""

SMALLEST_CONTRAST = 3.0
"""Multiples of the noise by which white must differ from black."""


@dataclass(frozen=True, eq=False)
class Tones:
    """The image of a chart in units of print.

    Parameters
    ----------
    values : array, shape (rows, columns)
        0 at black, 1 at white; NaN outside of the chart.
    noise : float
        Standard deviation of a pixel, in the same unit: the larger one of black and white.
    black, white : float
        Levels in the middle of the chart, in the image's unit.
    clipped_share : float
        Share of the plain pixels at the lowest or highest value that the image has.
    n_black, n_white : int
        Plain pixels the levels come from.
    """

    values: np.ndarray
    noise: float
    black: float
    white: float
    clipped_share: float
    n_black: int
    n_white: int


def tones(image, layout, chart_map):
    """Bring an image into units of print by the plain areas of the chart.

    White is a plane over the image, because light falls off across a chart; black is one level.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Linear light.
    layout : Layout
    chart_map : ChartMap

    Returns
    -------
    Tones

    Raises
    ------
    ValueError
        If the image is no grey image, or black and white cannot be told apart at these places.
    """
    image = check_image(image)
    expected, to_white, to_black = _printed(layout, chart_map, image.shape)
    for clearance in CLEARANCES_PX:
        white, black = to_white >= clearance, to_black >= clearance
        if min(white.sum(), black.sum()) >= PLAIN_PIXELS:
            break
    if min(white.sum(), black.sum()) < 3:
        raise ValueError(
            f"Invalid chart of {int(np.isfinite(expected).sum())} pixels: too small for a plain "
            "black and a plain white area. Must be imaged larger."
        )
    rows, columns = np.nonzero(white)
    design = np.column_stack([columns - columns.mean(), rows - rows.mean(), np.ones(len(rows))])
    if len(rows) < 100:
        design = design[:, 2:]
    fit = np.linalg.lstsq(design, image[white], rcond=None)[0]
    all_rows, all_columns = np.indices(image.shape)
    field = np.full(image.shape, fit[-1])
    if len(fit) == 3:
        field += fit[0] * (all_columns - columns.mean()) + fit[1] * (all_rows - rows.mean())
    dark = float(np.median(image[black]))
    spread = max(_spread(image[white] - field[white]), _spread(image[black] - dark))
    contrast = float(fit[-1]) - dark
    if not contrast > SMALLEST_CONTRAST * spread or not (field > dark)[white].all():
        raise ValueError(
            f"Invalid chart: white exceeds black by {contrast:.3g} at a noise of {spread:.3g}. "
            f"Must be {SMALLEST_CONTRAST:g} times the noise or more; is the chart there?"
        )
    values = np.where(np.isfinite(expected), (image - dark) / (field - dark), np.nan)
    plain = image[white | black]
    clipped = (plain >= image.max()) & (image.max() > fit[-1]) | (plain <= image.min())
    share = float(clipped.mean()) if spread > 0 else 0.0
    counts = int(black.sum()), int(white.sum())
    return Tones(values, spread / contrast, dark, float(fit[-1]), share, *counts)


def check_image(image):
    """Return a grey image as float64.

    Raises
    ------
    TypeError, ValueError
        If it is no array of real numbers with two dimensions, or has values that are not finite.
    """
    values = np.asarray(image)
    if values.dtype.kind not in "fiu":
        raise TypeError(f"Invalid image of type {values.dtype}. Must be real numbers.")
    if values.ndim != 2 or min(values.shape) < 3:
        raise ValueError(f"Invalid image of shape {values.shape}. Must be grey, 3 x 3 or larger.")
    if not np.isfinite(values).all():
        raise ValueError("Invalid image: values that are not finite. Must be finite.")
    return values.astype(np.float64)


def _printed(layout, chart_map, shape):
    """The tone printed at each pixel, NaN off the chart, and how many pixels deep it lies in white
    and in black."""
    import cv2

    rows, columns = np.indices(shape)
    places = chart_map.chart(np.column_stack([columns.ravel(), rows.ravel()]))
    middle = np.array([[layout.width / 2, layout.height / 2]])
    sizes = chart_map.pixel_sizes_mm(middle)
    cell = max(sizes.min() / 4, layout.width / 4000)
    printed = reflectance(layout, cell=cell)
    masks = [(np.abs(printed - tone) < 1e-3).astype(np.uint8) for tone in (1.0, 0.0)]
    depths = [cv2.distanceTransform(mask, cv2.DIST_L2, 5) * (cell / sizes.max()) for mask in masks]
    places = (places / cell - 0.5).astype(np.float32).reshape(*shape, 2)
    outside = (float("nan"), 0.0, 0.0)
    return [
        cv2.remap(
            one,
            places,
            None,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=border,
        )
        for one, border in zip((printed, *depths), outside, strict=True)
    ]


def _spread(residuals):
    """Standard deviation by the median absolute deviation, at least that of rounding."""
    return float(1.4826 * np.median(np.abs(residuals - np.median(residuals))))
