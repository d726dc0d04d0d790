"""Distances to the nearest points around each point, and what they say about a pattern.

Pfeifer et al. 2021 (doi 10.3390/rs13020237), sections 3.3 and 4.2: the distances to the nearest
point in each of four quadrants, sorted, show whether points lie evenly or in lines.
"""

import threading
from dataclasses import dataclass, field

import numpy as np

from mmqa_lab._checks import check_number, check_positive
from mmqa_lab.planes import flat_points

_ONE_AT_A_TIME = threading.Lock()
"""Some of numba's threading layers stop the process when two threads enter them at once."""


@dataclass(frozen=True, eq=False)
class Spacing:
    """The typical point spacings of a pattern in the plane.

    Parameters
    ----------
    d : array, shape (4,)
        Medians d1..d4 of the sorted quadrant distances, in the unit of the coordinates; NaN where
        no point has a neighbour of that rank.
    counts : array of int, shape (4,)
        Points behind each median.
    incomplete_share : float
        Share of the points with at least one empty quadrant within the radius.
    coincident : int
        Points that share their place with another one.
    n : int
        Points in all.
    distances : array, shape (n, 4)
        The sorted quadrant distances of each point, NaN where a quadrant is empty.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(20) * 0.02, np.arange(10) * 0.04)
    >>> found = spacing(np.stack([x.ravel(), y.ravel()], axis=1))
    >>> found.d.round(6).tolist(), round(found.f, 6)
    ([0.02, 0.02, 0.04, 0.04], 2.0)
    """

    d: np.ndarray
    counts: np.ndarray
    incomplete_share: float
    coincident: int
    n: int
    distances: np.ndarray = field(repr=False)

    @property
    def f(self):
        """Inhomogeneity d4 / d1; NaN where one of them is not measurable."""
        return float(self.d[3] / self.d[0])


def quadrant_distances(xy, *, radius=0.5, angle=0.0, of=None):
    """Distance from each point to the nearest other one in each of four quadrants.

    The quadrants about a point are half open and share no place: [dx > 0, dy >= 0],
    [dx <= 0, dy > 0], [dx < 0, dy <= 0], [dx >= 0, dy < 0]. The search is exact.

    Parameters
    ----------
    xy : array_like, shape (n, 2)
        Coordinates in the plane, metres.
    radius : float
        Neighbours up to this far count, m.
    angle : float
        Turns the axes of the quadrants counter-clockwise, degrees.
    of : array_like of bool, shape (n,), optional
        Measure from these points only; the others are neighbours, and their rows NaN.

    Returns
    -------
    array, shape (n, 4)
        Metres, in each row ascending and NaN last: one NaN for each quadrant that holds no point
        within the radius. Rows are in the order of the points.

    Raises
    ------
    ValueError
        If there is no point, a coordinate is not finite, the radius is not positive, or ``of`` is
        not one truth value for each point.

    Notes
    -----
    Coincident points lie in none of each other's quadrants and count for nothing here. Distances
    depend on the axes: where these run along noisy scan lines, all four quadrants find neighbours
    on the point's own line, and the gap to the next line goes unseen.

    References
    ----------
    Pfeifer et al. 2021, section 3.3. doi:10.3390/rs13020237

    Examples
    --------
    >>> quadrant_distances([[0, 0], [0.3, 0], [0, 0.4], [-0.1, 0]])[0]
    array([0.1, 0.3, 0.4, nan])
    """
    xy = flat_points(xy)
    radius = check_positive(radius, "radius", unit="m")
    angle = check_number(angle, "angle", unit="degrees")
    _check_width(xy)
    from mmqa_lab.spacing._grid_search import nearest_per_quadrant

    of = np.ones(len(xy), dtype=bool) if of is None else np.asarray(of)
    if of.dtype != bool or of.shape != (len(xy),):
        raise ValueError(
            f"Invalid of, {of.dtype} of shape {of.shape}. Must be bool of shape ({len(xy)},)."
        )
    with _ONE_AT_A_TIME:
        return nearest_per_quadrant(_turned(xy, angle), radius, of)


def spacing(xy, *, radius=0.5, angle=0.0, complete=False):
    """Medians d1..d4 of the sorted quadrant distances, and their ratio f.

    Parameters
    ----------
    xy : array_like, shape (n, 2)
        Coordinates in the plane, metres.
    radius : float
        Neighbours up to this far count, m.
    angle : float
        Turns the axes of the quadrants counter-clockwise, degrees.
    complete : bool
        Use only the points with a neighbour in all four quadrants. By default each median is over
        the points that have a neighbour of that rank, as the histogram of an attribute would be.

    Returns
    -------
    Spacing

    Raises
    ------
    ValueError
        As :func:`quadrant_distances`.

    Notes
    -----
    Points at the edge lack neighbours on one side: their first distances go with the others' unless
    ``complete``. Repeated points leave d as it is and raise the density; see ``coincident``.
    f of a homogeneous random pattern is 3.257, see :func:`poisson_spacing`.

    References
    ----------
    Pfeifer et al. 2021, sections 3.3 and 4.2. doi:10.3390/rs13020237

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(9) * 0.02, np.arange(9) * 0.04)
    >>> found = spacing(np.stack([x.ravel(), y.ravel()], axis=1))
    >>> found.d.round(3), round(found.f, 3), round(found.incomplete_share, 2)
    (array([0.02, 0.02, 0.04, 0.04]), 2.0, 0.4)
    """
    xy = flat_points(xy)
    distances = quadrant_distances(xy, radius=radius, angle=angle)
    known = ~np.isnan(distances)
    full = known[:, 3]
    if complete:
        known = np.repeat(full[:, None], 4, axis=1)
    return Spacing(
        d=np.array([_median(distances[known[:, k], k]) for k in range(4)]),
        counts=known.sum(axis=0),
        incomplete_share=float(1 - full.mean()),
        coincident=count_coincident(xy),
        n=len(xy),
        distances=distances,
    )


def poisson_spacing(density):
    """Expected d1..d4 of a homogeneous Poisson pattern.

    The area pi r^2 / 4 of a quadrant out to its nearest point is exponential, so the k-th of the
    four sorted distances has the median d_k = sqrt(-4 ln(1 - q_k) / (pi density)), with q_k the
    median of the k-th of four uniform order statistics, Beta(k, 5 - k).

    Parameters
    ----------
    density : float
        Points per square metre.

    Returns
    -------
    array, shape (4,)
        Metres.

    Raises
    ------
    ValueError
        If the density is not positive.

    Notes
    -----
    d4 / d1 = 3.257 at every density, without edges and for a radius well above d4. A threshold of
    f <= 2 therefore asks for more regularity than chance gives.

    Examples
    --------
    >>> d = poisson_spacing(2500)
    >>> (1000 * d).round(1), round(float(d[3] / d[0]), 3)
    (array([ 9.4, 15.8, 22. , 30.6]), 3.257)
    """
    from scipy.stats import beta

    density = check_positive(density, "density", unit="points per m2")
    k = np.arange(1, 5)
    return np.sqrt(-4 * np.log1p(-beta.median(k, 5 - k)) / (np.pi * density))


def count_coincident(xy):
    """Return the number of points that share their place with another one.

    Parameters
    ----------
    xy : array_like, shape (n, 2)
        Any unit.

    Returns
    -------
    int

    Raises
    ------
    ValueError
        If there are no points or one is not finite.

    Examples
    --------
    >>> count_coincident([[0, 0], [1, 0], [0, 0], [0, 0]])
    3
    """
    xy = flat_points(xy)
    # numpy orders complex numbers by their real, then their imaginary part.
    places = np.sort(np.ascontiguousarray(xy).view(np.complex128).ravel())
    same = places[1:] == places[:-1]
    return int((np.append(same, False) | np.append(False, same)).sum())


def _check_width(xy):
    """Reject coordinates whose differences, squared, would overflow."""
    with np.errstate(over="ignore"):
        width = max(np.ptp(xy[:, 0]), np.ptp(xy[:, 1]))
    if width >= 1e150:
        raise ValueError(f"Invalid xy, {width:g} m wide. Must be less than 1e+150 m.")


def _turned(xy, angle):
    """``xy`` in axes turned by ``angle`` degrees; four quarter turns are the same quadrants."""
    turn = np.radians(angle % 90)
    if turn == 0:
        return xy
    c, s = np.cos(turn), np.sin(turn)
    return (xy - xy.min(axis=0)) @ np.array([[c, -s], [s, c]])


def _median(values):
    """Median, NaN of nothing."""
    return float(np.median(values)) if len(values) else np.nan
