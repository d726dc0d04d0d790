"""A two-head system whose mounting is wrong: what that does, and what calibration makes of it."""

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from mmqa_lab.boresight import Calibration, calibrate
from mmqa_lab.cloud import Cloud
from mmqa_lab.simulate import NavigationErrors, presets
from mmqa_lab.simulate.testfield import System, drive_testfield
from mmqa_lab.testfield import height_accuracy, height_differences, plan_accuracy, pole_positions

BORESIGHT_DEG = ((0.12, -0.08, 0.20), (-0.10, 0.15, -0.25))
LEVER_ARM_ERROR_M = ((0.030, -0.040, 0.020), (-0.020, 0.030, -0.030))
"""Assumed errors of the two heads: tenths of a degree and centimetres, as after installation."""

CONTROL_SPACING_M = 4.0


@dataclass(frozen=True, eq=False)
class Mounting:
    """The system before and after its calibration.

    Parameters
    ----------
    calibration : Calibration
    table : DataFrame
        Estimates with ``truth`` and ``error``.
    accuracy : DataFrame
        ``state`` (before, after), ``height_std_mm``, ``pole_rmse_mm``, ``pole_max_mm``.
    before, after : Cloud
        Both drives together.
    """

    calibration: Calibration
    table: pd.DataFrame
    accuracy: pd.DataFrame
    before: Cloud
    after: Cloud


def two_heads(navigation=None):
    """Return the system with its wrong mounting."""
    base = replace(presets.VQ_450, divergence_mrad=0.0)
    heads = tuple(
        replace(
            base,
            lever_arm_m=(side * 0.4, -0.6, 0.3),
            heading_deg=-side * 45,
            boresight_deg=boresight,
        )
        for side, boresight in zip((-1, 1), BORESIGHT_DEG, strict=True)
    )
    navigation = NavigationErrors() if navigation is None else navigation
    return System("two heads, not calibrated", heads, navigation, LEVER_ARM_ERROR_M)


def calibrate_two_heads(street, *, pulses_per_s, seed, navigation=None):
    """Drive the field both ways with the wrong mounting, and calibrate it.

    Parameters
    ----------
    street : SimulatedField
    pulses_per_s : float
        Simulated, of both heads together.
    seed : int
    navigation : NavigationErrors, optional
        None: paths without error.

    Returns
    -------
    Mounting
    """
    system = two_heads(navigation)
    drives = drive_testfield(street, system, seed=seed, pulses_per_s=pulses_per_s)
    control = street.ground(spacing_m=CONTROL_SPACING_M, seed=seed)
    found = calibrate(
        drives, lever_arms_m=system.assumed_lever_arms, poles=street.poles, control=control
    )
    truth = np.hstack([BORESIGHT_DEG, -np.array(LEVER_ARM_ERROR_M)]).ravel()
    table = found.table.assign(truth=truth)
    table["error"] = table["value"] - table["truth"]
    before = Cloud.concatenate([cloud for cloud, _ in drives])
    after = Cloud.concatenate([found.correct(cloud, path) for cloud, path in drives])
    reference = street.ground(spacing_m=2.0, seed=seed + 1)
    accuracy = pd.DataFrame(
        [
            {"state": name} | _accuracy(cloud, street, reference)
            for name, cloud in (("before", before), ("after", after))
        ]
    )
    return Mounting(found, table, accuracy, before, after)


def _accuracy(cloud, street, reference):
    """Height std and errors of poles of a cloud."""
    heights = height_accuracy(height_differences(cloud.points, reference, radius=0.5))
    poles = plan_accuracy(pole_positions(cloud.points, street.poles))
    return {
        "height_std_mm": heights["std_mm"].iloc[0],
        "pole_rmse_mm": poles["rmse_mm"].iloc[0],
        "pole_max_mm": poles["max_mm"].iloc[0],
    }
