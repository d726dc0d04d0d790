"""Things made of several surfaces: walls with openings, kerbs, charts."""

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_number, check_points, check_positive
from mmqa_lab.charts import Layout, point_chart, reflectance
from mmqa_lab.simulate.surfaces import Surface, board, group, polygon, rectangle, vector

CELL_MM = 10.0
"""Cells of the printed chart; a scanner sees their mean reflectance."""


def wall(corner, along, height, *, openings=(), reveal=0.2, label="wall", reflectance=0.5):
    """Return a wall with openings, their reveals and the panes behind them.

    Parameters
    ----------
    corner : array_like, shape (3,)
        A lower corner, metres.
    along : array_like, shape (3,)
        The lower edge from there, level, metres; it runs to the left as one looks at the front.
    height : float
        Metres.
    openings : list of (float, float, float, float)
        Distance along, height above the lower edge, width and height of each, metres.
    reveal : float
        Depth from the wall to the panes, metres; 0 for a flat front.
    label : str
        Of the wall; the others are called ``"reveal"`` and ``"pane"``.
    reflectance : float
        Of wall and reveals; panes have 0.1.

    Returns
    -------
    list of Surface
        The wall; then, opening by opening, its four reveals as one surface, and its pane.

    Raises
    ------
    ValueError
        If an opening does not lie within the wall.

    Examples
    --------
    >>> from mmqa_lab.simulate import Scene
    >>> front = Scene(wall((5, 0, 0), (0, 9, 0), 6, openings=[(4, 1, 1, 2)]))
    >>> hits = front.cast([[0, 4.5, 2], [0, 7, 2]], [[1, 0, 0]] * 2)
    >>> [front.surfaces[k].label for k in hits.surface], hits.range_m.round(6).tolist()
    (['pane', 'wall'], [5.2, 5.0])
    """
    corner, along = vector(corner, "corner"), vector(along, "along")
    up = np.array([0.0, 0.0, check_positive(height, "height", unit="m")])
    length = np.linalg.norm(along)
    inward = check_number(reveal, "reveal", low=0, unit="m") * np.cross(along / length, [0, 0, 1])
    holes, parts = [], []
    for opening in openings:
        s, z, w, h = opening
        if min(s, z) <= 0 or min(w, h) <= 0 or s + w >= length or z + h >= height:
            raise ValueError(
                f"Invalid opening {opening}. Must lie within {length:.3f} m x {height} m of wall."
            )
        low = corner + s / length * along + [0, 0, z]
        side, rise = w / length * along, np.array([0.0, 0.0, h])
        holes.append([low, low + side, low + side + rise, low + rise])
        if reveal:
            starts = [(low, side), (low + rise, side), (low, rise), (low + side, rise)]
            faces = [rectangle(p, edge, inward, reflectance=reflectance) for p, edge in starts]
            parts.append(group(faces, label="reveal"))
        parts.append(rectangle(low + inward, side, rise, label="pane", reflectance=0.1))
    outline = [corner, corner + along, corner + along + up, corner + up]
    return [polygon(outline, holes=holes, label=label, reflectance=reflectance), *parts]


def kerb(line, height=0.12, *, label="kerb", reflectance=0.4):
    """Return the upright faces of a kerb along a line: a surface for each of its stretches.

    Parameters
    ----------
    line : array_like, shape (n, 3)
        Points at the foot of the kerb, two or more, metres.
    height : float
        Metres.
    label : str
    reflectance : float

    Returns
    -------
    list of Surface

    Raises
    ------
    ValueError
        If there are fewer than two points, two in a row are the same, or the height is not > 0.

    Examples
    --------
    >>> len(kerb([(4, 0, 0), (4, 20, 0), (3, 22, 0)]))
    2
    """
    line = check_points(line, name="line", minimum=2)
    up = (0, 0, check_positive(height, "height", unit="m"))
    stretches = pairwise(line)
    return [rectangle(a, b - a, up, label=label, reflectance=reflectance) for a, b in stretches]


def chart(
    centre: ArrayLike,
    *,
    heading: float,
    layout: Layout | None = None,
    bright: float = 0.8,
    dark: float = 0.1,
    label: str = "chart",
) -> Surface:
    """Return the point chart as it is printed, as a surface that scanners and cameras see.

    Parameters
    ----------
    centre : array_like, shape (3,)
        Metres.
    heading : float
        Where its front looks to, degrees clockwise from +y.
    layout : Layout, optional
        What is printed; by default :func:`mmqa_lab.charts.point_chart`.
    bright, dark : float
        Reflectances of white and of black.
    label : str

    Returns
    -------
    Surface
        With the mean reflectance of each cell of 10 mm.

    Raises
    ------
    ValueError
        If a reflectance lies outside 0 to 1.

    References
    ----------
    Pfeifer et al. 2021, section 3.3 (doi:10.3390/rs13020237); the random cells are this package's.

    Examples
    --------
    >>> from mmqa_lab.simulate import Scene
    >>> there = Scene([chart((5, 0, 1), heading=-90)])
    >>> corners = [[0, 0.35, 0.65], [0, -0.35, 0.65]]  # the plain squares below, left and right
    >>> there.cast(corners, [[1, 0, 0]] * 2).reflectance.round(6).tolist()
    [0.1, 0.8]
    """
    layout = point_chart() if layout is None else layout
    tones = reflectance(layout, cell=CELL_MM).astype(np.float64)
    size = layout.width / 1000, layout.height / 1000
    pattern = dark + (bright - dark) * tones
    return board(centre, *size, heading=heading, label=label, reflectance=pattern)


def chart_corners(centre: ArrayLike, *, heading: float, size: float = 1.0) -> np.ndarray:
    """Return the corners of a chart, (4, 3), from the lower left around, as one looks at its front.

    Parameters
    ----------
    centre, heading, size
        See :func:`chart`.

    Returns
    -------
    array, shape (4, 3)
        Metres.

    Raises
    ------
    ValueError
        If the size is not above zero or the heading is not finite.

    Examples
    --------
    >>> chart_corners((5, 0, 1), heading=-90)[0].round(9).tolist()
    [5.0, 0.5, 0.5]
    """
    h = np.radians(check_number(heading, "heading", unit="degrees"))
    along = check_positive(size, "size", unit="m") * np.array([-np.cos(h), np.sin(h), 0.0])
    up = np.array([0.0, 0.0, size])
    low = vector(centre, "centre") - along / 2 - up / 2
    return np.array([low, low + along, low + along + up, low + up])
