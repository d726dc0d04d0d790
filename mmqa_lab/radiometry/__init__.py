"""Radiometry of digital images: radiance, reflectance, even blocks of images.

EuroSDR 2013, image radiometry (project "Radiometric aspects of digital photogrammetric images",
2008-2011, Honkavaara et al.). The modules follow the steps of the report: ``sensor`` (DN to
radiance, equations 2 and 3), ``reflectance`` (equation 4, empirical line, directions, errors by
equations 6-8, NDVI), ``block`` (one adjustment of overlapping images). Resolution is in
``mmqa_lab.mtf``.
The sum of radiances at the sensor (equation 1) is simulated in ``mmqa_lab.simulate.targets``.
Equation 5 defines a bidirectional reflectance and is no model. Equations are numbered as in the
report; the notation is that of this package.
"""

from mmqa_lab.radiometry.block import Priors, adjust_block
from mmqa_lab.radiometry.reflectance import (
    empirical_line,
    fit_walthall,
    ndvi,
    reflectance_errors,
    reflectance_factor,
)
from mmqa_lab.radiometry.sensor import (
    fit_sensor,
    patch_statistics,
    relative_exposure,
    saturation_level,
    stability,
)

__all__ = [
    "Priors",
    "adjust_block",
    "empirical_line",
    "fit_sensor",
    "fit_walthall",
    "ndvi",
    "patch_statistics",
    "reflectance_errors",
    "reflectance_factor",
    "relative_exposure",
    "saturation_level",
    "stability",
]
