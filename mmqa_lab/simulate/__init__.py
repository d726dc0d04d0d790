"""Simulated scans whose truth is known: scenes, trajectories, scanners, exact ray casting.

Frames and signs: world x east, y north, z up; vehicle x right, y travel, z up. Start here::

    from mmqa_lab import simulate

    scene = simulate.Scene([
        simulate.ground(),
        simulate.rectangle((8, 0, 0), along=(0, 50, 0), up=(0, 0, 6), label="wall"),
        simulate.cylinder((5, 20, 0), (5, 20, 6), 0.08, label="lamp"),
    ])
    scanner = simulate.Scanner(
        pulse_rate_hz=300_000, mirror_frequency_hz=100, heading_deg=45, tilt_deg=45,
        lever_arm_m=(0, 0, 2.5), range_noise_m=0.005, divergence_mrad=0.5,
    )
    cloud = simulate.scan(scene, scanner, simulate.straight(50, 10), seed=1)
    cloud["surface"], cloud["scan_line"], cloud["range_m"]     # and the rest of the truth

Real scanners are in ``PRESETS``; ``dataclasses.replace(PRESETS["roamer"], tilt_deg=30)`` varies
one. ``system("vmx-250")`` and the other systems of the sources are in ``systems``.
"""

from mmqa_lab.simulate.scan import Scanner, scan
from mmqa_lab.simulate.scenes import Scene
from mmqa_lab.simulate.surfaces import board, box, chart_corners, cylinder, ground, rectangle, wall
from mmqa_lab.simulate.systems import PRESETS, System, system
from mmqa_lab.simulate.trajectories import (
    NavigationErrors,
    Trajectory,
    measured,
    straight,
    with_speed_variation,
)

__all__ = [
    "PRESETS", "NavigationErrors", "Scanner", "Scene", "System", "Trajectory", "board", "box",
    "chart_corners", "cylinder", "ground", "measured", "rectangle", "scan", "straight", "system",
    "wall", "with_speed_variation",
]  # fmt: skip
