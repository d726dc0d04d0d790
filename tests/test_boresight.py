"""Boresight and lever arms recovered from simulated two-way drives."""

import numpy as np
import pytest

from mmqa_lab.boresight import calibrate
from mmqa_lab.simulate import NavigationErrors, ProfileScanner
from mmqa_lab.simulate.testfield import System, drive_testfield, make_testfield
from mmqa_lab.studies import test_field as study


@pytest.fixture(scope="module")
def street():
    return make_testfield(length_m=48, seed=1)


@pytest.fixture(scope="module")
def drives(street):
    return drive_testfield(street, study.two_heads(NavigationErrors()), seed=4, pulses_per_s=80_000)


@pytest.fixture(scope="module")
def found(street, drives):
    control = street.ground(spacing_m=4.0, seed=2)
    lever = study.two_heads(NavigationErrors()).assumed_lever_arms
    return calibrate(drives, lever_arms_m=lever, poles=street.poles, control=control)


def test_mounting_is_recovered(found):
    truth = np.hstack([study.BORESIGHT_DEG, -np.array(study.LEVER_ARM_ERROR_M)])
    assert np.abs(found.values - truth)[:, :3].max() < 0.005
    assert np.abs(found.values - truth)[:, 3:].max() < 0.005
    assert found.planes > 100
    assert np.allclose(np.diag(found.correlation), 1)


def test_correction_takes_points_to_their_surfaces(found, street, drives):
    cloud, path = drives[0]
    road = [k for k, s in enumerate(street.scene.surfaces) if s.label == "road"]
    on_road = np.isin(cloud["surface"], road)
    before = cloud.points[on_road, 2] - street.origin[2]
    after = found.correct(cloud, path).points[on_road, 2] - street.origin[2]
    # 5 mm of range noise is what may be left
    assert np.sqrt(np.mean(after**2)) < 0.006 < np.sqrt(np.mean(before**2))


def test_rejects(drives, street):
    lever = study.two_heads(NavigationErrors()).assumed_lever_arms
    with pytest.raises(ValueError, match="none given"):
        calibrate([], lever_arms_m=lever)
    cloud, path = drives[0]
    lone = cloud[cloud["head"] == 0]
    with pytest.raises(ValueError, match="no planes in common"):
        calibrate([(lone, path)], lever_arms_m=lever)


def test_drives_that_leave_a_parameter_open_are_refused(street):
    head = ProfileScanner(pulse_rate_hz=2e5, mirror_frequency_hz=100, heading_deg=45, tilt_deg=30)
    system = System("one head", (head,), NavigationErrors())
    drives = drive_testfield(street, system, seed=4, pulses_per_s=10_000)
    choices = {"lever_arms_m": system.assumed_lever_arms, "patches": 100, "rounds": 1}
    with pytest.raises(ValueError, match="do not determine the mounting"):
        calibrate(drives, **choices)
