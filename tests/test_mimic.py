"""MIMIC's equations against rays cast here, and the paper's tables."""

import numpy as np
import pytest

from mmqa_lab.published import table as printed_table
from mmqa_lab.rotations import turned
from mmqa_lab.scan_pattern import mimic

THETA_A = 0.12


def scanner_axes(alpha, gamma):
    """Level and upward axis of scan planes at rest, and their normal, from sines and cosines."""
    a, g = np.radians(alpha), np.radians(gamma)
    level = np.stack([np.cos(a), np.sin(a), 0 * a], axis=-1)
    upward = np.stack([np.sin(a) * np.sin(g), -np.cos(a) * np.sin(g), np.cos(g)], axis=-1)
    return level, upward


def target_axes(alpha, beta):
    """Normal, level line and line of greatest slope of target planes."""
    a, b = np.radians(alpha), np.radians(beta)
    normal = np.stack([np.cos(b) * np.cos(a), np.cos(b) * np.sin(a), -np.sin(b)], axis=-1)
    level = np.stack([-np.sin(a), np.cos(a), 0 * a], axis=-1)
    slope = np.stack([np.sin(b) * np.cos(a), np.sin(b) * np.sin(a), np.cos(b)], axis=-1)
    return normal, level, slope


def random_angles(rng, n):
    """Angles at which the horizontal pulse strikes the front at 80 degrees or less."""
    alpha, gamma = rng.uniform(-60, 60, (2, n))
    alpha_targ, beta = rng.uniform(-40, 40, (2, n))
    alpha_targ = np.clip(alpha_targ, alpha - 80, alpha + 80)
    return alpha, gamma, alpha_targ, beta


def strike(origin, direction, point, normal):
    """Where rays meet planes through points."""
    reach = np.sum((point - origin) * normal, axis=-1) / np.sum(direction * normal, axis=-1)
    return origin + reach[:, None] * direction


def test_profile_spacings_are_those_of_rays_for_ten_thousand_set_ups(rng):
    n = 10_000
    alpha, gamma, alpha_targ, beta = random_angles(rng, n)
    d, h_r = rng.uniform(0.01, 0.2, n), rng.uniform(3, 30, n)
    level, upward = scanner_axes(alpha, gamma)
    normal, along, slope = target_axes(alpha_targ, beta)
    spot = (h_r / level[:, 0])[:, None] * level
    # two pulses of a profile, and their twins a revolution later; the scan plane is at rest
    tip = np.radians(1.0)
    first, second = level, np.cos(tip) * level + np.sin(tip) * upward
    here = [strike(np.zeros(3), aim, spot, normal) for aim in (first, second)]
    later = strike(d[:, None] * [0, 1, 0], first, spot, normal)
    profile = here[1] - here[0]
    u, v = np.sum(profile * along, axis=1), np.sum(profile * slope, axis=1)
    shift = later - here[0]
    s, t = np.sum(shift * along, axis=1), np.sum(shift * slope, axis=1)
    horizontal = mimic.profile_spacing_horizontal(d, alpha, alpha_targ)
    assert np.abs(horizontal - np.abs(s - t * u / v)).max() < 1e-9
    angle = mimic.profile_angle(alpha, gamma, alpha_targ, beta)
    assert np.abs(angle - np.degrees(np.arctan2(np.abs(v), np.abs(u)))).max() < 1e-9
    vertical = mimic.profile_spacing_vertical(horizontal, angle)
    # it grows without end where profiles are upright: there compare at the size it has
    assert (np.abs(vertical - np.abs(t - s * v / u)) < 1e-9 * np.maximum(1, vertical)).all()


@pytest.mark.parametrize("upwards", [True, False])
def test_point_spacing_is_that_of_rays_for_ten_thousand_set_ups(rng, upwards):
    n = 10_000
    alpha, gamma, alpha_targ, beta = random_angles(rng, n)
    h_r, dz = rng.uniform(3, 20, n), rng.uniform(-2, 3, n)
    theta_a = rng.uniform(0.02, 0.3, n)
    level, upward = scanner_axes(alpha, gamma)
    normal, *_ = target_axes(alpha_targ, beta)
    spot = (h_r / level[:, 0])[:, None] * level
    # the point of the profile at the height of the target, by walking along the profile
    profile = np.cross(np.cross(upward, level), normal)
    steep = np.abs(profile[:, 2]) > 0.05 * np.linalg.norm(profile, axis=1)
    here = spot + (dz / np.where(steep, profile[:, 2], 1.0))[:, None] * profile
    in_plane = np.arctan2(np.sum(here * upward, axis=1), np.sum(here * level, axis=1))
    angle = in_plane + np.radians(theta_a) * (1 if upwards else -1)
    aim = np.cos(angle)[:, None] * level + np.sin(angle)[:, None] * upward
    there = strike(np.zeros(3), aim, spot, normal)
    pulse = np.linalg.norm(here, axis=1)
    ahead = (np.sum(here * level, axis=1) > 0) & (
        np.abs(np.sum(here * normal, axis=1)) > 0.1 * pulse
    )
    usable = steep & ahead
    assert usable.mean() > 0.7
    chain = mimic.point_spacing(
        (alpha, gamma), (alpha_targ, beta),
        h_r=h_r, height_difference=dz, theta_a=theta_a, upwards=upwards,
    )  # fmt: skip
    assert np.abs(chain.r2 - pulse)[usable].max() < 1e-9
    assert np.abs(chain.d_ps - np.linalg.norm(there - here, axis=1))[usable].max() < 1e-9


def test_equation_10_as_printed_is_right_for_the_horizontal_pulse_alone():
    angles = (45, 45), (15, 10)
    for height, agree in ((0.0, True), (-2.0, False), (1.5, False)):
        given = {"h_r": 6.0, "height_difference": height, "theta_a": THETA_A}
        right = mimic.point_spacing(*angles, **given).d_ps
        printed = mimic.point_spacing(*angles, **given, literal=True).d_ps
        assert (abs(printed / right - 1) < 1e-12) == agree
        assert agree or abs(printed / right - 1) > 0.03


def test_table_3_to_the_printed_digits_and_its_reading():
    table = printed_table("cahalane2014", "table_3")
    found = [mimic.profile_spacing_horizontal(0.1, 45, a) for a in table["alpha_targ_deg"]]
    assert np.allclose(found, [0.081650, 0.100000, 0.081650, 0.141421, 0.100000], atol=5e-7)
    assert np.round(found, 3).tolist() == table["mimic_m"].tolist()
    # with column vectors (heading first) equation 1 gives other spacings, 0.0751 m in row 1
    spacing = []
    for row in table.itertuples():
        plane = turned(x=45) @ turned(z=45) @ [0, 1, 0]
        tilt = turned(y=row.beta_targ_deg)
        level = np.cross([0, 0, 1], tilt @ turned(z=row.alpha_targ_deg) @ [1, 0, 0])
        spacing.append(0.1 * abs(plane[1] / (plane @ level)) * np.linalg.norm(level))
    assert (np.round(spacing, 3) == table["mimic_m"]).tolist() == [False, True, False, False, True]
