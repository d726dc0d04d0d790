"""Finding a chart in an image: by coded targets, from four corners, and to a part of a pixel."""

import numpy as np

from mmqa_lab.chart_image.levels import check_image
from mmqa_lab.chart_image.mapping import ChartMap, four_corners
from mmqa_lab.charts import LinePairs, Marker, reflectance

ENLARGEMENTS = (1, 2, 4)
"""Small targets are looked for in the image enlarged so many times."""

ENLARGED_PIXELS = 4e6
"""Larger images than this are not enlarged."""

SMALLEST_OUTLINE_PX = 24
"""Pixels around a target: those of 8 px a side cannot be decoded any more."""

SEARCHED_PIXELS = 12e6
"""Larger images than this are searched in strips."""

OVERLAP_ROWS = 512
"""Of the strips: larger than any target in images that large."""

FINEST_PAIR_PX = 3.0
"""Line pairs narrower than this take no part in the alignment: aliased, they would mislead it."""

SMALLEST_CORRELATION = 0.6
"""Between chart and image after alignment; unrelated pictures stay below 0.3."""

ALIGNMENT_CELL_PX = 0.6
"""Cells of the alignment in pixels: with whole pixels it errs three times as much."""

COARSE_CELLS = 250
"""The alignment begins with about so many cells along a side: quick, also where there is no chart
at all."""

LARGEST_MOVE = 0.03
"""Share of the chart's side by which the alignment may move a corner."""


def locate_markers(image, layout, *, camera=None, offset=(0.0, 0.0)):
    """Find a chart by its coded targets.

    OpenCV finds and decodes the targets; all their corners together give the map.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Grey values, any unit.
    layout : Layout
        With at least one :class:`mmqa_lab.charts.Marker`.
    camera : FrameCamera or PanoramaCamera, optional
        What bends rays into pixels, for distorted images and panoramas.
    offset : (float, float)
        Column and row of the whole image where this window begins.

    Returns
    -------
    ChartMap
        ``residuals_px`` of the corners of all targets found.

    Raises
    ------
    ValueError
        If the layout has no targets or none of them is found.

    Notes
    -----
    The six modules of a target need about 2.5 pixels each. Of nine simulated views between -45 and
    45 degrees, all four targets of 90 mm were found in five and some of them in all at pixels of
    5.4 mm, some in six at 8 mm. Two targets alone extrapolate badly; :func:`align` then says that
    the chart is not there.

    Examples
    --------
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = np.pad(255 * reflectance(layout, cell=4)[::-1], 20, constant_values=255)
    >>> found = locate_markers(image.astype(np.uint8), layout)
    >>> found.source, bool(np.abs(found.pixels([[0, 0]]) - [19.5, 269.5]).max() < 0.5)
    ('4 coded targets', True)
    """
    image = check_image(image, convert=False)
    if image.dtype not in (np.uint8, np.uint16):
        image = image.astype(np.float32)
    markers = {marker.identifier: marker for marker in layout.of_kind(Marker)}
    if not markers:
        raise ValueError(f"Invalid chart {layout.name!r}: no coded targets. Must have some.")
    dictionary = next(iter(markers.values())).dictionary
    step = 1 + int(np.sqrt(image.size / 1e6))
    limits = np.percentile(image[::step, ::step], [0.5, 99.5]).astype(image.dtype)
    found = {}
    for enlargement in ENLARGEMENTS:
        if enlargement > 1 and image.size > ENLARGED_PIXELS:
            break
        seen = _detected(image, limits, dictionary, enlargement)
        seen = {key: corners for key, corners in seen.items() if key in markers}
        found = seen if len(seen) > len(found) else found
        if len(found) == len(markers):
            break
    if not found:
        raise ValueError(
            f"Invalid image: none of the {len(markers)} coded targets of {dictionary} found. "
            "Must show them, or the corners of the chart must be given."
        )
    places = np.concatenate([markers[key].corners() for key in found])
    corners = np.concatenate(list(found.values()))
    source = f"{len(found)} coded targets"
    return ChartMap.from_points(places, corners, camera=camera, offset=offset, source=source)


def locate_corners(corners, layout, *, camera=None, offset=(0.0, 0.0)):
    """Return the map of a chart from its four corners in the image.

    Parameters
    ----------
    corners : array_like, shape (4, 2)
        Column and row of the lower left, lower right, upper right and upper left corner of the
        printed chart.
    layout : Layout
    camera : FrameCamera or PanoramaCamera, optional
        What bends rays into pixels.
    offset : (float, float)
        Column and row of the whole image where the window begins that corners are counted in.

    Returns
    -------
    ChartMap

    Raises
    ------
    ValueError
        If there are not four corners, or they are not in this order.

    Examples
    --------
    >>> from mmqa_lab.charts import imaging_chart
    >>> layout = imaging_chart()  # 1000 mm x 1000 mm
    >>> there = locate_corners([[100, 350], [350, 350], [350, 100], [100, 100]], layout)
    >>> there.pixels([[0, 0], [500, 500]]).round(6).tolist()
    [[100.0, 350.0], [225.0, 225.0]]
    """
    corners = four_corners(corners, columns=2)
    places = layout.corners()
    return ChartMap.from_points(places, corners, camera=camera, offset=offset, source="corners")


def align(image, layout, chart_map):
    """Improve a map by the whole printed chart.

    The image is brought to the chart's frame, where OpenCV maximises its correlation with the
    printed tones over the eight parameters of a homography (ECC). Fine line pairs are left out.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Linear light.
    layout : Layout
    chart_map : ChartMap
        Right to a few pixels.

    Returns
    -------
    ChartMap
        Without residuals: :func:`mmqa_lab.chart_image.pixel_sizes` measures how far the ends of
        the long bars lie from where it puts them.

    Raises
    ------
    ValueError
        If the chart is not found there: no convergence, a correlation below 0.6, or corners that
        moved by more than 3 % of the chart's side.

    References
    ----------
    Evangelidis and Psarakis 2008, doi:10.1109/TPAMI.2008.113.

    Examples
    --------
    >>> from mmqa_lab.chart_image import ChartMap
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4)[::-1]  # pixels of 4 mm
    >>> there = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> wrong = ChartMap(there.matrix + [[0, 0, 0.8], [0, 0, -0.6], [0, 0, 0]])
    >>> right = align(image, layout, wrong)
    >>> off = np.abs(right.pixels(layout.corners()) - there.pixels(layout.corners()))
    >>> bool(off.max() < 0.1)
    True
    """
    import cv2

    image = check_image(image)
    pixel_mm = float(np.median(chart_map.pixel_sizes_mm(layout.corners())))
    cell = max(ALIGNMENT_CELL_PX * pixel_mm, layout.width / 1500)
    printed = cv2.GaussianBlur(reflectance(layout, cell=cell), (0, 0), 0.55 * pixel_mm / cell)
    seen, inside = _rectified(image, layout, chart_map, cell, printed.shape)
    mask = inside & _trusted(layout, chart_map, cell, printed.shape)
    to_cells = np.array([[1 / cell, 0, -0.5], [0, 1 / cell, -0.5], [0, 0, 1]])
    change = np.linalg.inv(to_cells) @ _change(printed, seen, mask) @ to_cells
    aligned = chart_map.corrected(change / change[2, 2])
    moved = np.linalg.norm(
        aligned.pixels(layout.corners()) - chart_map.pixels(layout.corners()), axis=1
    ).max()
    limit = max(LARGEST_MOVE * layout.width / pixel_mm, 4)
    if moved > limit:
        raise ValueError(
            f"Invalid place of the chart: a corner lies {moved:.1f} px away. Must be given to "
            f"{limit:.1f} px."
        )
    return aligned


def _detected(image, limits, dictionary, enlargement):
    """Corners of the coded targets by number, in pixels of the image."""
    import cv2

    book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_CONTOUR
    found = {}
    for first, strip in _strips(image):
        low, high = (float(limit) for limit in limits)
        scale = 255 / max(high - low, 1e-12)
        strip = cv2.convertScaleAbs(np.clip(strip, *limits), alpha=scale, beta=-low * scale)
        if enlargement > 1:
            size = (strip.shape[1] * enlargement, strip.shape[0] * enlargement)
            strip = cv2.resize(strip, size, interpolation=cv2.INTER_CUBIC)
        # of the longer side; every smaller contour of a textured image would cost its time
        settings.minMarkerPerimeterRate = SMALLEST_OUTLINE_PX * enlargement / max(strip.shape)
        detector = cv2.aruco.ArucoDetector(book, settings)
        corners, identifiers, _ = detector.detectMarkers(strip)
        for one, key in zip(corners, () if identifiers is None else identifiers, strict=False):
            places = (one.reshape(4, 2).astype(float) + 0.5) / enlargement - 0.5
            found[int(np.ravel(key)[0])] = places + [0, first]
    return found


def _strips(image):
    """An image as strips of rows that overlap, with their first rows."""
    rows = max(int(SEARCHED_PIXELS / image.shape[1]), 4 * OVERLAP_ROWS)
    for first in range(0, max(len(image) - OVERLAP_ROWS, 1), rows - OVERLAP_ROWS):
        yield first, image[first : first + rows]


def _change(printed, seen, mask):
    """The homography of cells that brings print and image together, coarsely first."""
    change = np.eye(3)
    for step, smoothing in ((max(1, max(printed.shape) // COARSE_CELLS), 11), (1, 5)):
        to_coarse = np.array([[1, 0, (1 - step) / 2], [0, 1, (1 - step) / 2], [0, 0, step]]) / step
        start = to_coarse @ change @ np.linalg.inv(to_coarse)
        coarse = [_coarser(one, step) for one in (printed, seen, mask)]
        correlation, found = _maximised(*coarse, start, smoothing)
        if not correlation >= SMALLEST_CORRELATION:
            raise ValueError(
                f"Invalid place of the chart: its print correlates by {correlation:.2f} with the "
                f"image. Must be {SMALLEST_CORRELATION} or more; is the chart there?"
            )
        change = np.linalg.inv(to_coarse) @ found @ to_coarse
    return change


def _coarser(values, step):
    """Means of squares of cells; those beyond the last whole square are left out."""
    import cv2

    rows, columns = (side // step for side in values.shape)
    whole = values[: rows * step, : columns * step]
    return cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA)


def _maximised(printed, seen, mask, start, smoothing):
    """The largest correlation, 0 without convergence, and the homography that reaches it."""
    import cv2

    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-7)
    start, mask = start.astype(np.float32), np.uint8(mask == 255) * 255
    try:
        correlation, found = cv2.findTransformECC(
            printed, seen, start, cv2.MOTION_HOMOGRAPHY, stop, mask, smoothing
        )
    except cv2.error:
        return 0.0, start
    return correlation, found.astype(float)


def _rectified(image, layout, chart_map, cell, shape):
    """The image in the chart's frame, and where it is known."""
    import cv2

    rows, columns = np.indices(shape)
    places = np.column_stack([columns.ravel() + 0.5, rows.ravel() + 0.5]) * cell
    pixels = chart_map.pixels(places).astype(np.float32).reshape(*shape, 2)
    image = image.astype(np.float32)
    seen = cv2.remap(image, pixels, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    limit = np.array(image.shape[::-1]) - 1
    inside = ((pixels >= 0) & (pixels <= limit)).all(axis=2)
    return seen, inside.astype(np.uint8) * 255


def _trusted(layout, chart_map, cell, shape):
    """The cells that may take part in the alignment."""
    trusted = np.full(shape, 255, dtype=np.uint8)
    for pairs in layout.of_kind(LinePairs):
        middle = [[pairs.x + pairs.width / 2, pairs.y + pairs.height / 2]]
        axis = 0 if pairs.direction == "h" else 1
        if pairs.pair / chart_map.pixel_sizes_mm(middle)[0, axis] < FINEST_PAIR_PX:
            low = np.floor((np.array([pairs.x, pairs.y]) / cell) - 2).astype(int)
            size = np.array([pairs.width, pairs.height])
            high = np.ceil((np.array([pairs.x, pairs.y]) + size) / cell + 2).astype(int)
            low = np.maximum(low, 0)
            trusted[low[1] : high[1], low[0] : high[0]] = 0
    return trusted
