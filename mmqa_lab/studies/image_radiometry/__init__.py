"""Image radiometry, EuroSDR 2013: what a digital camera's numbers mean.

``resolution`` measures edges, stars, bars and sharpness on rendered targets and a real photograph;
``reflectance`` goes from digital numbers to radiance and reflectance; ``blocks`` makes overlapping
images even; ``drawings`` draws.
"""

import numpy as np

from mmqa_lab.run import Check

QUICK = {
    "edges": 3,
    "star_cycles": (36,),
    "star_sigmas_px": (0.5, 1.5),
    "sensor_seeds": 50,
    "field_images": 2,
    "reflectance_seeds": 4,
    "block_strips": 3,
}
"""Small parameters for the tests."""

EDGE_LIMIT_PERCENT = 1.0
STAR_LIMIT = 0.02
CLEAN_LIMIT_PERCENT, HAZY_LIMIT_PERCENT = 1.0, 5.0


def checks(edges, stars, sensor, reflectance, block):
    """Test what the notebook says.

    Parameters
    ----------
    edges, stars : DataFrame
        From ``resolution.edge_trials`` and ``resolution.star_trials``.
    sensor : DataFrame
        From ``reflectance.sensor_trials``.
    reflectance : DataFrame
        From ``reflectance.summary``.
    block : DataFrame
        From ``blocks.summary``.
    """
    yield from _resolution(edges, stars)
    yield from _sensor(sensor)
    yield from _reflectance(reflectance)
    yield from _block(block)


def _resolution(edges, stars):
    """Edges and stars against their known point spread."""
    fit = edges[edges["method"] == "sigmoid: Gaussian"]
    worst = {
        name: np.quantile(fit[f"{name}_error_percent"].abs(), 0.95) for name in ("fwhm", "mtf50")
    }
    logistic = edges[edges["method"] == "sigmoid: logistic"]["fwhm_error_percent"].median()
    star = stars["largest_error"].max()
    return [
        Check(
            "At 1 % noise, FWHM and MTF50 of edges are right within 1 %.",
            bool(max(worst.values()) < EDGE_LIMIT_PERCENT),
            f"95 % of edges within {worst['fwhm']:.2f} % and {worst['mtf50']:.2f} %",
            "the limit asked for, 95 % of edges",
        ),
        Check(
            "A logistic sigmoid reads the FWHM of a Gaussian blur more than 10 % too small.",
            bool(logistic < -10),
            f"median {logistic:.1f} %",
            "without noise it is 12 to 16 %",
        ),
        Check(
            "The contrast of Siemens stars is right within 0.02 up to 0.9 of Nyquist's frequency.",
            bool(star < STAR_LIMIT),
            f"largest error {star:.4f}",
            "the limit asked for",
        ),
    ]


def _sensor(sensor):
    """Calibration coefficients and their standard errors."""
    shares = [(sensor[f"{name}_z"].abs() <= 2).mean() for name in ("gain", "offset")]
    # a share of 95 % from n seeds scatters by this
    slack = 3 * np.sqrt(0.95 * 0.05 / len(sensor))
    return [
        Check(
            "Gain and offset lie within two standard errors in 95 % of the seeds.",
            bool(min(shares) > 0.95 - slack),
            f"gain {100 * shares[0]:.1f} %, offset {100 * shares[1]:.1f} % of {len(sensor)}",
            f"95 % less three standard errors of the share, {100 * slack:.1f} %",
        )
    ]


def _reflectance(table):
    """The empirical line in clean and hazy air."""
    rows = table[table["anisotropy"] == "allowed for"]
    worst = rows.groupby("atmosphere")["rmse_percent"].max()
    ignored = table[(table["anisotropy"] == "ignored") & (table["atmosphere"] == "clean")]
    return [
        Check(
            "The empirical line recovers reflectance within 1 % in clean air, 5 % in haze.",
            bool(worst["clean"] < CLEAN_LIMIT_PERCENT and worst["hazy"] < HAZY_LIMIT_PERCENT),
            f"worst class {worst['clean']:.2f} % clean, {worst['hazy']:.2f} % hazy",
            "RMSE of every band and class; 5 % is the report's",
        ),
        Check(
            "Reference targets that are not Lambertian spoil it unless that is allowed for.",
            bool(ignored["rmse_percent"].min() > 2 * worst["clean"]),
            f"at least {ignored['rmse_percent'].min():.1f} % where ignored",
            "twice the worst error where it is allowed for",
        ),
    ]


def _block(table):
    """The adjusted block."""
    rows = table.set_index("adjustment")
    before, after = rows.loc["absolute", ["cv_before_percent", "cv_after_percent"]]
    error = rows.loc["absolute", "rmse_percent"]
    return [
        Check(
            "The adjustment takes nine tenths of the differences between images away.",
            bool(after < 0.1 * before),
            f"variation at ties {before:.2f} % before, {after:.2f} % after",
            "a tenth; what is left is noise of 5 x 5 pixels",
        ),
        Check(
            "With ten control targets the block's reflectances are right within 1 %.",
            bool(error < 1),
            f"RMSE {error:.2f} % of all tie points",
            "the controls themselves are known to 0.002",
        ),
    ]
