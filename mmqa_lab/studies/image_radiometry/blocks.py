"""A simulated block of images made even, relatively and absolutely."""

import numpy as np
import pandas as pd

from mmqa_lab.radiometry.block import FREE, Priors, adjust_block
from mmqa_lab.simulate.blocks import Flight, fly_block

CONTROL_STD = 0.002

FLAT_FIELD_STD = 0.01
"""How well a laboratory knows the loss of light in the corners."""


def fly(*, strips, seed):
    """Return a block and what its tie points show."""
    block = fly_block(Flight(strips=strips), seed=seed)
    return block, block.observations()


def adjust(block, observations, *, controls, seed):
    """Adjust a block relatively (no control) and absolutely.

    Returns
    -------
    dict of str to BlockAdjustment
    """
    radial = (block.flight.radial, FLAT_FIELD_STD)
    relative = adjust_block(observations, priors=Priors(radial=radial))
    known = observations.drop_duplicates("tie").set_index("tie")["reference"]
    rng = np.random.default_rng(seed)
    chosen = rng.choice(known.index, controls, replace=False)
    control = pd.DataFrame({"tie": chosen, "std": CONTROL_STD})
    control["reflectance"] = known[chosen].to_numpy() + rng.normal(0, CONTROL_STD, controls)
    priors = Priors(radial=radial, haze=(0.0, FREE))
    absolute = adjust_block(observations, control=control, priors=priors)
    return {"relative": relative, "absolute": absolute}


def summary(adjusted, observations):
    """Return what the adjustments did: variation at the ties, errors of the reflectance.

    Returns
    -------
    DataFrame
        ``adjustment``, ``ties``, ``observations``, ``sigma0``, ``cv_before_percent``,
        ``cv_after_percent`` (means over the ties), ``rmse`` and ``rmse_percent`` of the reflectance
        (the relative one scaled to the same mean), ``haze``.
    """
    known = observations.drop_duplicates("tie").set_index("tie")["reference"]
    rows = []
    for name, found in adjusted.items():
        value = found.ties.set_index("tie")["reflectance"]
        true = known[value.index]
        if not found.absolute:
            value = value * true.mean() / value.mean()
        error = value - true
        rows.append(
            {
                "adjustment": name,
                "ties": len(value),
                "observations": len(observations),
                "sigma0": found.sigma0,
                "cv_before_percent": found.ties["cv_before_percent"].mean(),
                "cv_after_percent": found.ties["cv_after_percent"].mean(),
                "rmse": np.sqrt((error**2).mean()),
                "rmse_percent": 100 * np.sqrt(((error / true) ** 2).mean()),
                "haze": found.haze[0],
            }
        )
    return pd.DataFrame(rows)


def mosaic(block, adjustment=None):
    """Return the block as one picture: each cell from the image whose centre is nearest.

    Parameters
    ----------
    block : ImageBlock
    adjustment : BlockAdjustment, optional
        Without one, radiance as the sensor gives it.

    Returns
    -------
    array, shape (height, width)
    """
    high, wide = block.surface.shape
    flight, gsd = block.flight, block.flight.gsd_m
    y, x = (v.ravel() for v in np.indices((high, wide)))
    stations = block.stations
    gaps = np.stack(
        [
            np.hypot(x * gsd - station.x_m, y * gsd - station.y_m)
            for station in stations.itertuples()
        ]
    )
    image = gaps.argmin(axis=0)
    row = (stations["y_m"].to_numpy()[image] / gsd - 0.5 - y) + (flight.rows - 1) / 2
    column = (x + 0.5 - stations["x_m"].to_numpy()[image] / gsd) + (flight.columns - 1) / 2
    row = np.clip(np.round(row).astype(int), 0, flight.rows - 1)
    column = np.clip(np.round(column).astype(int), 0, flight.columns - 1)
    values = block.radiance(image, row, column)
    if adjustment is not None:
        seen = block.pixels(image, row, column).assign(radiance=values)
        values = adjustment.correct(seen)
    return values.reshape(high, wide)
