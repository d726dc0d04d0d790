"""The edge spread function of one edge as a sigmoid: FWHM and MTF50.

EuroSDR 2013, image radiometry, section 5.1 and Table 4: a sigmoid is fitted to all pixels of a
region with one straight edge; its derivative is the line spread function. The report counts five
parameters and does not print the shape of its sigmoid. Lengths in pixels, frequencies in cycles per
pixel. For edges that no sigmoid describes (sharpened images) there is ``edge_response``.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_choice
from mmqa_lab._results import Shown
from mmqa_lab.mtf.spread import spread_edge

SHAPES = ("gaussian", "logistic")

GAUSSIAN_FWHM = 2 * np.sqrt(2 * np.log(2))
LOGISTIC_FWHM = 2 * np.log(3 + 2 * np.sqrt(2))
LOGISTIC_MTF50 = 2.17731898
"""x where x / sinh(x) = 1/2."""


@dataclass(frozen=True, eq=False)
class EdgeFit(Shown):
    """A sigmoid fitted to an edge.

    Parameters
    ----------
    shape : str
        See ``fit_edge``.
    low, high : float
        Grey values far from the edge.
    angle_deg : float
        Direction from dark to bright, 0 along the columns' direction (x, right), 90 along the
        rows' (y, down).
    position_px : float
        Distance of the edge from the region's centre along that direction.
    width_px : float
        Standard deviation of the Gaussian before the pixel's own width, or the logistic's scale.
    width_std_px : float
        Standard error of the width.
    rms : float
        Of the residuals, in grey values.
    n : int
        Pixels.

    Examples
    --------
    >>> fit = EdgeFit("logistic", 10, 200, 5.0, 0.0, 1.0, 0.01, 0.5, 900)
    >>> float(fit.esf(0.0)), float(fit.mtf(fit.mtf50).round(6))
    (0.5, 0.5)
    """

    shape: str
    low: float
    high: float
    angle_deg: float
    position_px: float
    width_px: float
    width_std_px: float
    rms: float
    n: int

    def esf(self, distance):
        """Edge spread function, 0 to 1, at distances across the edge."""
        return _esf(self.shape, np.asarray(distance, np.float64), self.width_px, self.angle_deg)

    def lsf(self, distance):
        """Line spread function, per pixel."""
        distance = np.asarray(distance, dtype=np.float64)
        if self.shape == "logistic":
            return 1 / (4 * self.width_px * np.cosh(distance / (2 * self.width_px)) ** 2)
        step = 1e-3 * self.width_px
        return (self.esf(distance + step) - self.esf(distance - step)) / (2 * step)

    def mtf(self, frequency):
        """Modulation transfer function across the edge."""
        f = np.asarray(frequency, dtype=np.float64)
        if self.shape == "logistic":
            x = 2 * np.pi**2 * self.width_px * np.maximum(np.abs(f), 1e-12)
            return x / np.sinh(x)
        a, b = np.cos(np.radians(self.angle_deg)), np.sin(np.radians(self.angle_deg))
        return np.exp(-2 * (np.pi * self.width_px * f) ** 2) * np.sinc(a * f) * np.sinc(b * f)

    @property
    def fwhm_px(self):
        """Full width at half maximum of the line spread function."""
        if self.shape == "logistic":
            return LOGISTIC_FWHM * self.width_px
        from scipy.optimize import brentq

        half = self.lsf(0.0) / 2
        return 2 * brentq(lambda d: self.lsf(d) - half, 0, GAUSSIAN_FWHM * self.width_px + 1)

    @property
    def mtf50(self):
        """Frequency at which the contrast is halved."""
        if self.shape == "logistic":
            return LOGISTIC_MTF50 / (2 * np.pi**2 * self.width_px)
        from scipy.optimize import brentq

        return brentq(lambda f: self.mtf(f) - 0.5, 0, min(0.2 / max(self.width_px, 1e-3), 0.99))

    def to_frame(self) -> pd.DataFrame:
        """Return one row: resolution, width with its standard error, direction, misfit."""
        names = ("shape", "mtf50", "fwhm_px", "width_px", "width_std_px", "angle_deg", "rms", "n")
        return pd.DataFrame([{name: getattr(self, name) for name in names}])


def fit_edge(region, *, shape: str = "gaussian") -> EdgeFit:
    """Fit a sigmoid to a region with one straight edge.

    Least squares over all pixels: two grey levels, direction and place of the edge, width.

    Parameters
    ----------
    region : array_like, shape (rows, columns)
        Grey values in proportion to light (linearise first), 8 x 8 pixels or more.
    shape : {"gaussian", "logistic"}
        A Gaussian's integral averaged over square pixels, whose width is that of the optics alone;
        or the plain logistic function 1 / (1 + exp(-d / w)), whose line spread function has longer
        tails.

    Returns
    -------
    EdgeFit

    Raises
    ------
    ValueError
        If the region is too small, not finite, or has no edge in it.

    Notes
    -----
    A sigmoid cannot overshoot: in sharpened images it reads too blurred a width or too sharp a
    one, with residuals above the noise. The direction must not lie along rows or columns to within
    a degree, else the width below a pixel is guessed from few samples.

    References
    ----------
    EuroSDR 2013, image radiometry, section 5.1 and Table 4.

    Examples
    --------
    >>> y, x = np.mgrid[:40, :40] - 19.5
    >>> across = x * np.cos(np.radians(5)) + y * np.sin(np.radians(5)) - 0.3
    >>> fit = fit_edge(10 + 80 / (1 + np.exp(-across / 0.8)), shape="logistic")
    >>> round(fit.width_px, 4), round(fit.angle_deg, 3), round(fit.position_px, 3)
    (0.8, 5.0, 0.3)
    """
    from scipy.optimize import least_squares

    check_choice(shape, "shape", SHAPES)
    grey = np.asarray(region, dtype=np.float64)
    if grey.ndim != 2 or min(grey.shape) < 8 or not np.isfinite(grey).all():
        raise ValueError(
            f"Invalid region of shape {grey.shape}. Must be 8 x 8 finite pixels or more."
        )
    y, x = np.mgrid[: grey.shape[0], : grey.shape[1]]
    x, y = (x - x.mean()).ravel(), (y - y.mean()).ravel()
    start, contrast = _start(grey, x, y)
    values = (grey.ravel() - start[0]) / contrast

    def misfit(p):
        """Residuals of levels, position, angle and log width."""
        low, high, position, angle, log_width = p
        across = x * np.cos(angle) + y * np.sin(angle) - position
        sigmoid = _esf(shape, across, np.exp(log_width), np.degrees(angle))
        return low + (high - low) * sigmoid - values

    begin = [0.0, 1.0, start[1], start[2], np.log(0.7)]
    found = least_squares(misfit, begin, x_scale=[1, 1, 1, 0.02, 1])
    low, high, position, angle, log_width = found.x
    variance = 2 * found.cost / max(len(values) - 5, 1)
    covariance = variance * np.linalg.pinv(found.jac.T @ found.jac)
    width = float(np.exp(log_width))
    return EdgeFit(
        shape=shape,
        low=float(start[0] + contrast * low),
        high=float(start[0] + contrast * high),
        angle_deg=float(np.degrees(angle)),
        position_px=float(position),
        width_px=width,
        width_std_px=float(width * np.sqrt(covariance[4, 4])),
        rms=float(contrast * np.sqrt(variance)),
        n=len(values),
    )


def dependence(edges: pd.DataFrame) -> pd.DataFrame:
    """Tell what the blur of edges all over an image depends on.

    The squared width is regressed on the squared distance from the image's centre, separately for
    blur along the radius and across it, and on the share of the edge's normal along the flight
    (image motion): variances of blurs add, widths do not.

    Parameters
    ----------
    edges : DataFrame
        ``x_px``, ``y_px`` from the image's centre, ``angle_deg`` (direction across the edge),
        ``fwhm_px``, one row an edge. The flight is along y.

    Returns
    -------
    DataFrame
        One row each for ``centre`` (squared FWHM there, px2), ``radial``, ``tangential`` (its
        growth per squared radius, px2 per px2) and ``flight`` (added along the flight, px2):
        ``estimate``, ``std``, ``p``, and ``n``.

    Raises
    ------
    ValueError
        If the edges do not tell the terms apart.

    References
    ----------
    EuroSDR 2013, image radiometry, chapter 5: resolution by radial, tangential, flight and
    cross-flight direction. The regression is our own.

    Examples
    --------
    >>> import pandas as pd
    >>> rng = np.random.default_rng(1)
    >>> (x, y), angle = rng.uniform(-1, 1, (2, 50)), rng.uniform(0, 180, 50)
    >>> width = np.sqrt(2.0 + 0.5 * np.sin(np.radians(angle)) ** 2)  # motion along the flight
    >>> edges = pd.DataFrame({"x_px": x, "y_px": y, "angle_deg": angle, "fwhm_px": width})
    >>> np.abs(dependence(edges)["estimate"]).round(6).tolist()
    [2.0, 0.0, 0.0, 0.5]
    """
    from statsmodels.regression.linear_model import OLS

    x, y, angle = (edges[name].to_numpy(np.float64) for name in ("x_px", "y_px", "angle_deg"))
    radius2 = x**2 + y**2
    along = np.cos(np.radians(angle) - np.arctan2(y, x)) ** 2
    terms = np.stack(
        [
            np.ones_like(x),
            radius2 * along,
            radius2 * (1 - along),
            np.sin(np.radians(angle)) ** 2,
        ],
        axis=1,
    )
    if len(terms) < 6 or np.linalg.matrix_rank(terms / terms.max(axis=0), tol=1e-6) < 4:
        raise ValueError(
            f"Invalid edges: {len(terms)} of them cannot tell four terms apart. Must lie all over "
            "the image in different directions."
        )
    fit = OLS(edges["fwhm_px"].to_numpy() ** 2, terms).fit()
    return pd.DataFrame(
        {
            "term": ["centre", "radial", "tangential", "flight"],
            "estimate": fit.params,
            "std": fit.bse,
            "p": fit.pvalues,
            "n": len(terms),
        }
    )


def _start(grey, x, y):
    """Low level, place and direction of the edge, and its contrast, to begin with."""
    low, high = np.percentile(grey, [5, 95])
    gy, gx = np.gradient(grey)
    gx, gy = gx.ravel(), gy.ravel()
    energy = gx**2 + gy**2
    if high <= low or not energy.any():
        raise ValueError("Invalid region: one grey value. Must show an edge.")
    angle = 0.5 * np.arctan2(2 * (gx * gy).sum(), (gx**2 - gy**2).sum())
    if (gx * np.cos(angle) + gy * np.sin(angle)).sum() < 0:
        angle += np.pi
    across = x * np.cos(angle) + y * np.sin(angle)
    strong = energy > 0.25 * energy.max()
    return (low, np.median(across[strong]), angle), high - low


def _esf(shape, across, width, angle_deg):
    """The sigmoid of a shape."""
    if shape == "logistic":
        from scipy.special import expit

        return expit(across / width)
    return spread_edge(across, width, np.radians(angle_deg))
