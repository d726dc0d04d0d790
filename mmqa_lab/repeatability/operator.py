"""A model of the operator: polygons with click errors, strays, and what each selection gives."""

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_count, check_number, check_points
from mmqa_lab._polygons import polygon_vertices
from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.planes import fit_plane


def operator_polygons(corners, *, repeats, click, seed, vertices=4):
    """Draw the polygons of an operator who clicks the same outline again and again.

    Vertices lie evenly on the outline, the corners among them, and get independent normal errors in
    both directions of the plane.

    Parameters
    ----------
    corners : array_like, shape (4, 3)
        The outline meant, in order, metres, such as
        :func:`mmqa_lab.chart_cloud.chart_polygon` gives.
    repeats : int
        Number of polygons.
    click : float
        Standard deviation of a vertex in each direction, m; 1 to 2 cm in a 3-D editor.
    seed : int
    vertices : int
        A multiple of 4; 4 for a quadrilateral, more for a free polygon.

    Returns
    -------
    array, shape (repeats, vertices, 3)
        Metres.

    Raises
    ------
    ValueError
        If a polygon crosses itself because the click error is too large for the outline.

    Examples
    --------
    >>> square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    >>> polygons = operator_polygons(square, repeats=5, click=0.01, seed=1, vertices=8)
    >>> polygons.shape, bool(abs(polygons[:, 1] - [0.5, 0, 0]).max() < 0.05)
    ((5, 8, 3), True)
    """
    import shapely

    corners = polygon_vertices(corners, name="corners")
    repeats = check_count(repeats, "repeats")
    click = check_number(click, "click", low=0, unit="m")
    if len(corners) != 4 or check_count(vertices, "vertices", low=4) % 4:
        raise ValueError(f"Invalid vertices {vertices}. Must be a multiple of four corners.")
    plane = fit_plane(corners)
    steps = np.arange(vertices // 4)[:, None] * 4 / vertices
    sides = np.roll(corners, -1, axis=0) - corners
    outline = (corners[:, None] + steps * sides[:, None]).reshape(-1, 3)
    errors = click * np.random.default_rng(seed).standard_normal((repeats, vertices, 2))
    polygons = outline + errors @ plane.axes
    valid = shapely.is_valid(shapely.polygons(plane.project(polygons)))
    if not valid.all():
        raise ValueError(
            f"Invalid click {click}: {int((~valid).sum())} of {repeats} polygons cross themselves. "
            "Must be well below the distance of the vertices."
        )
    return polygons


def with_strays(points, *, share, depths, seed):
    """Add points that a selection catches by mistake behind or in front of a surface.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        On the surface, metres.
    share : float
        Of all points afterwards, 0 to 0.5.
    depths : pair of float
        Strays lie between these distances along the plane's normal, m; equally likely anywhere.
    seed : int

    Returns
    -------
    array, shape (m, 3)
        The points, then the strays: copies of random points, moved.

    Raises
    ------
    ValueError
        If there are fewer than three points or the share lies outside 0 to 0.5.

    Examples
    --------
    >>> surface = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    >>> with_strays(surface, share=0.2, depths=(0.1, 0.1), seed=1)[-1, 2].item()
    0.1
    """
    points = check_points(points, minimum=3)
    share = check_number(share, "share", low=0, high=0.5)
    rng = np.random.default_rng(seed)
    count = round(len(points) * share / (1 - share))
    depth = rng.uniform(*depths, count)[:, None]
    strays = points[rng.integers(len(points), size=count)] + depth * fit_plane(points).normal
    return np.concatenate([points, strays])


def evaluate_selections(points, polygons, *, thickness=0.1, axes="principal", radius=0.5):
    """Evaluate one cloud with each of many polygons.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Metres.
    polygons : array_like, shape (repeats, vertices, 3)
        Metres.
    thickness, axes, radius
        See :func:`mmqa_lab.chart_cloud.evaluate_cloud`.

    Returns
    -------
    DataFrame
        A row per polygon: ``selection`` and the figures of ``CloudQuality.to_frame``.

    Raises
    ------
    ValueError
        As :func:`mmqa_lab.chart_cloud.evaluate_cloud`: too few points in a polygon, and the like.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(50) * 0.02, np.arange(50) * 0.02)
    >>> cloud = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    >>> square = np.array([[0.1, 0.1, 0], [0.9, 0.1, 0], [0.9, 0.9, 0], [0.1, 0.9, 0]]) - 0.01
    >>> evaluate_selections(cloud, [square, square + [0.04, 0, 0]])["n"].tolist()
    [1600, 1600]
    """
    points = check_points(points, minimum=3)
    choices = {"thickness": thickness, "axes": axes, "radius": radius}
    frames = [evaluate_cloud(points, polygon=p, **choices).to_frame() for p in polygons]
    table = pd.concat(frames, ignore_index=True)
    return table.rename_axis("selection").reset_index()
