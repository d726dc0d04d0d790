"""Boresight and lever arm of scan heads, estimated from drives in both directions.

The effect of a mounting error changes its sign with the direction of travel. So a wall seen on the
way there and on the way back lies in two places. Planes and poles that several drives or heads have
seen are fitted, and the mounting that makes them thinnest is estimated. EuroSDR 2013, mobile laser
scanning, section 3.3.3, names the objects that show each error: the ground for roll, poles and
corners for pitch and heading. The least-squares adjustment is our own. Start here::

    from mmqa_lab.boresight import calibrate

    found = calibrate(drives, lever_arms_m=assumed, poles=poles, control=levelled_points)
    found.table                                        # estimates with standard errors
    [found.correct(cloud, path) for cloud, path in drives]

Signs are those of ``simulate``: vehicle frame x right, y travel, z up; boresight rolls about y,
pitches about x and heads about -z, so that the true beam is R(boresight) times the assumed one.
"""

from mmqa_lab.boresight.mounting import LEAST_POINTS, Calibration, calibrate, corrected

__all__ = ["LEAST_POINTS", "Calibration", "calibrate", "corrected"]
