"""Radiometry of digital images: radiance, reflectance, even blocks of images.

EuroSDR 2013, image radiometry (project "Radiometric aspects of digital photogrammetric images",
2008-2011, Honkavaara et al.). A file a step of the report: DN to radiance (``sensor``: equations 2
and 3), ``reflectance`` (equation 4, empirical line, NDVI, anisotropy), and one adjustment of
overlapping images (``blocks``). Resolution is
in ``mmqa_lab.mtf``. The sum of radiances at the sensor (equation 1) is simulated in
``mmqa_lab.simulate.targets``. Equation 5 defines a bidirectional reflectance and is no model; the
model here is Walthall's, which the report names only where it describes the software XPro (a
modified form). Equations are numbered as in the report.

Angles in degrees: zenith angles of sun and view from the vertical; the relative azimuth is 0 where
the camera looks at the ground with the sun behind it (backward scattering) and 180 where it looks
against the sun.
"""

from mmqa_lab.radiometry.blocks import BlockAdjustment, adjust_block
from mmqa_lab.radiometry.reflectance import (
    EmpiricalLine,
    WalthallFit,
    empirical_line,
    fit_walthall,
    ndvi,
    reflectance_factor,
)
from mmqa_lab.radiometry.sensor import (
    SensorFit,
    coarse_pairs,
    fit_sensor,
    patch_statistics,
    relative_exposure,
    stability,
)

__all__ = [
    "BlockAdjustment", "EmpiricalLine", "SensorFit", "WalthallFit", "adjust_block", "coarse_pairs",
    "empirical_line", "fit_sensor", "fit_walthall", "ndvi", "patch_statistics",
    "reflectance_factor", "relative_exposure", "stability",
]  # fmt: skip
