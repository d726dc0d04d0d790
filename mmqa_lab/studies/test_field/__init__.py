"""Test-field accuracy, EuroSDR 2013, chapter 3: heights, plan positions, mounting of the heads.

``surveys`` drives simulated systems over a simulated field and measures them; ``mounting`` breaks
and calibrates a two-head system; ``real`` compares two real drives with airborne heights;
``drawings`` draws.
"""

import numpy as np

from mmqa_lab.published import eurosdr2013_testfield
from mmqa_lab.run import Check
from mmqa_lab.studies.test_field import surveys
from mmqa_lab.testfield.heights import rms_check

QUICK = {
    "length_m": 48.0,
    "pulses_per_s": 30_000.0,
    "ground_spacing_m": 2.0,
    "draws": 20,
    "repeats": 2,
    "calibration_pulses_per_s": 60_000.0,
    "real_spacing_m": 0.5,
}
"""Small parameters for the tests."""

BORESIGHT_LIMIT_DEG, LEVER_LIMIT_M = 0.005, 0.005

compute = surveys.survey_all


def published_check():
    """Return what is at hand of Tables 3-3 and 3-4 with the check of RMSE against mean and std."""
    return {
        "table_3_3": rms_check(eurosdr2013_testfield.table_3_3()),
        "table_3_4": rms_check(eurosdr2013_testfield.table_3_4()),
    }


def checks(heights, plan, repeated, calibration, real):
    """Test what the notebook says.

    Parameters
    ----------
    heights, plan : DataFrame
        From ``surveys.height_table`` and ``surveys.plan_table``.
    repeated : DataFrame
        ``measured_mm`` of repeated drives and ``predicted_mm`` draws (longer), of one system.
    calibration : mounting.Mounting
    real : DataFrame or None
        From ``real.compare``.
    """
    yield from _contrast(heights, plan)
    yield from _against_prediction(heights, repeated)
    yield from _mounting(calibration)
    if real is not None:
        yield _absolute_and_relative(real)


def _contrast(heights, plan):
    """A boresight error and its cure."""
    heights = heights[(heights["direction"] == "both") & (heights["shift"] == "kept")]
    kept = heights.set_index("system")["std_mm"]
    off, good = kept["profiler, not calibrated"], kept["profiler"]
    low = plan["object"] == "pole, near the ground"
    poles = plan[low & (plan["direction"] == "both") & (plan["shift"] == "kept")]
    poles = poles.set_index("system")
    far, near = poles["rmse_mm"]["profiler, not calibrated"], poles["rmse_mm"]["profiler"]
    bound = eurosdr2013_testfield.statements().set_index("quantity")["bound_mm"]["elevation"]
    professional = heights[heights["system"].isin(surveys.PROFESSIONAL)]
    return [
        Check(
            "A boresight error of some tenths of a degree costs more than all else together.",
            bool(min(off / good, far / near) > np.sqrt(2)),
            f"height std {off:.1f} against {good:.1f} mm, poles {far:.1f} against {near:.1f} mm",
            "root of 2: the boresight's part alone is then larger than the rest",
        ),
        Check(
            "Calibrated professional systems stay within the published 3.5 cm in height.",
            bool((professional["rmse_mm"] < bound).all()),
            ", ".join(f"{r.system} {r.rmse_mm:.1f} mm" for r in professional.itertuples()),
            "the bound of the article's abstract; assumed navigation",
        ),
    ]


def _against_prediction(heights, repeated):
    """Measured against predicted standard deviations."""
    measured, predicted = (
        repeated[name].dropna().to_numpy() for name in ("measured_mm", "predicted_mm")
    )
    ratio = np.sqrt(np.mean(measured**2) / np.mean(predicted**2))
    error = predicted.std() / predicted.mean() / np.sqrt(len(measured))
    rows = heights[(heights["shift"] == "removed") & heights["predicted_std_mm"].notna()]
    inside = rows["std_mm"].between(rows["predicted_low_mm"], rows["predicted_high_mm"])
    return [
        Check(
            "The height std measured on the cloud lies where the specifications predict it.",
            bool(inside.sum() >= len(rows) - 1),
            ", ".join(
                f"{r.system} {r.std_mm:.1f} in {r.predicted_low_mm:.1f}-{r.predicted_high_mm:.1f}"
                for r in rows.itertuples()
            ),
            "90 % of the predicted drives; one system may miss",
        ),
        Check(
            "Over many drives the predicted std of heights is right within 20 %.",
            bool(abs(ratio - 1) < max(0.2, 3 * error)),
            f"measured over predicted {ratio:.2f} +- {error:.2f} from {len(measured)} surveys",
            "20 %, or three standard errors of the ratio where surveys are few",
        ),
    ]


def _mounting(calibration):
    """The two-head system's mounting."""
    table = calibration.table
    angle = table[table["parameter"].str.endswith("deg")]["error"].abs().max()
    arm = table[table["parameter"].str.endswith("_m")]["error"].abs().max()
    before, after = calibration.accuracy["pole_rmse_mm"]
    return [
        Check(
            "Two drives determine boresight angles to 0.005 degrees and lever arms to 5 mm.",
            bool(angle < BORESIGHT_LIMIT_DEG and arm < LEVER_LIMIT_M),
            f"largest errors {angle:.4f} degrees, {1000 * arm:.1f} mm",
            "the limits asked for; paths without error",
        ),
        Check(
            "Correcting the mounting makes the double poles single.",
            bool(after < before / 3),
            f"poles {before:.1f} mm before, {after:.1f} mm after",
            "a third; what is left is the survey's 3 mm and the range noise",
        ),
    ]


def _absolute_and_relative(real):
    """Two real drives."""
    rows = real[real["shift"] == "kept"].set_index("comparison")["mean_mm"]
    absolute = rows[["drive 1", "drive 2"]].abs().min()
    relative = abs(rows["drive 1 - drive 2"])
    return Check(
        "The real drives agree with each other far better than with the airborne heights.",
        bool(relative < absolute / 2),
        f"{relative:.1f} mm against {absolute:.1f} mm",
        "a half",
    )
