"""What black and white are in the image of a chart, and how much noise there is.

Everything downstream reads the image in units of print: 0 where the black of the chart is, 1 where
its white is.
"""

from dataclasses import dataclass

import numpy as np

from mmqa_lab.charts import reflectance

CLEARANCES_PX = (3.0, 2.5, 2.0, 1.5, 1.2, 1.0, 0.7, 0.5, 0.3)
"""A pixel is plain when the next other tone is so far away; the widest that is possible counts."""

TYPICAL_SIGMA_PX = 0.65
"""Point spread, pixel included, that tells how much white spills into black where bars are thin."""

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
        Share of the plain pixels at zero or full scale.
    n_black, n_white : int
        Plain pixels the levels come from.

    Examples
    --------
    >>> from mmqa_lab.chart_image import ChartMap
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4)[::-1]  # pixels of 4 mm
    >>> there = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> levels = tones(0.1 + 0.6 * image, layout, there)
    >>> round(levels.black, 6), round(levels.white, 6), levels.values.max().round(6).item()
    (0.1, 0.7, 1.0)
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
        Linear light, full scale 1.
    layout : Layout
    chart_map : ChartMap

    Returns
    -------
    Tones

    Raises
    ------
    ValueError
        If the image is no grey image, or black and white cannot be told apart at these places.

    Examples
    --------
    >>> from mmqa_lab.chart_image import ChartMap
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4)[::-1]  # pixels of 4 mm
    >>> there = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> found = tones(0.05 + 0.5 * image, layout, there)
    >>> bool(np.allclose(found.values, image, atol=1e-6)), found.n_white > 1000
    (True, True)
    """
    image = check_image(image)
    inside, spilt, to_white, to_black = _printed(layout, chart_map, image.shape)
    white, black = _plainest(to_white), _plainest(to_black)
    if min(white.sum(), black.sum()) < 3:
        raise ValueError(
            f"Invalid chart of {int(inside.sum())} pixels: too small for a plain black and a plain "
            "white area. Must be imaged larger."
        )
    field = _plane(image, white)
    spill = spilt[black].mean()
    dark = float((image[black].mean() - spill * field[black].mean()) / (1 - spill))
    printed = dark + (field - dark) * spilt
    noise = max(_spread((image - printed)[mask]) for mask in (white, black))
    light = float(field[white].mean())
    # rounding alone makes a contrast of a plain image without noise
    least = SMALLEST_CONTRAST * noise + 1e-9 * abs(light)
    if not light - dark > least or not (field > dark)[inside].all():
        raise ValueError(
            f"Invalid chart: white exceeds black by {light - dark:.3g} at a noise of {noise:.3g}. "
            f"Must be {SMALLEST_CONTRAST:g} times the noise or more; is the chart there?"
        )
    plain = image[white | black]
    return Tones(
        values=np.where(inside, (image - dark) / np.where(inside, field - dark, 1), np.nan),
        noise=noise / (light - dark),
        black=dark,
        white=light,
        clipped_share=float(((plain >= 1) | (plain <= 0)).mean()),
        n_black=int(black.sum()),
        n_white=int(white.sum()),
    )


def check_image(image, *, convert=True):
    """Return a grey image as float64, or in its own type without ``convert``.

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
    return values.astype(np.float64) if convert else values


def _printed(layout, chart_map, shape):
    """Per pixel: whether it lies on the chart, the tone it would see there, and how many pixels
    deep it lies in white and in black."""
    import cv2

    rows, columns = np.indices(shape)
    places = chart_map.chart(np.column_stack([columns.ravel(), rows.ravel()]))
    sizes = chart_map.pixel_sizes_mm([[layout.width / 2, layout.height / 2]])
    cell = max(sizes.min() / 4, layout.width / 4000)
    printed = reflectance(layout, cell=cell)
    seen = cv2.GaussianBlur(printed, (0, 0), TYPICAL_SIGMA_PX * sizes.max() / cell)
    depths = [_depth(np.abs(printed - tone) < 1e-3) * (cell / sizes.max()) for tone in (1.0, 0.0)]
    places = (places / cell - 0.5).astype(np.float32).reshape(*shape, 2)
    constant = {"interpolation": cv2.INTER_LINEAR, "borderMode": cv2.BORDER_CONSTANT}
    at_pixels = [
        cv2.remap(one, places, None, **constant, borderValue=-1.0) for one in (seen, *depths)
    ]
    return (at_pixels[0] >= 0, *at_pixels)


def _depth(mask):
    """Distance of each cell from the nearest one outside of the mask or of the chart, cells."""
    import cv2

    framed = cv2.copyMakeBorder(mask.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    return cv2.distanceTransform(framed, cv2.DIST_L2, 5)[1:-1, 1:-1]


def _plainest(depth):
    """The pixels that lie deepest in a tone, enough of them if possible."""
    for clearance in CLEARANCES_PX:
        plain = depth >= clearance
        if plain.sum() >= PLAIN_PIXELS:
            break
    return plain


def _plane(image, white):
    """The level of white at every pixel: a plane where there is enough of it, else one level."""
    rows, columns = np.nonzero(white)
    middle = rows.mean(), columns.mean()
    design = np.column_stack([rows - middle[0], columns - middle[1], np.ones(len(rows))])
    if len(rows) < 100:
        return np.full(image.shape, image[white].mean())
    fit = np.linalg.lstsq(design, image[white], rcond=None)[0]
    all_rows, all_columns = np.indices(image.shape)
    return fit[0] * (all_rows - middle[0]) + fit[1] * (all_columns - middle[1]) + fit[2]


def _spread(residuals):
    """Standard deviation by the median absolute deviation."""
    return float(1.4826 * np.median(np.abs(residuals - np.median(residuals))))
