"""Measuring scan patterns on simulated patches whose truth is known."""

from dataclasses import replace

import numpy as np
import pandas as pd

from mmqa_lab import simulate
from mmqa_lab.scan_pattern import Patch, ScanSetup, Target, measure_pattern, scan_lattice


def _case(pulse_rate, mirror, speed, scanner, target, place):
    """A set-up and a target from (heading, tilt) pairs and (range, height difference)."""
    setup = ScanSetup(
        pulse_rate_hz=pulse_rate,
        mirror_frequency_hz=mirror,
        speed_m_s=speed,
        scanner_heading_deg=scanner[0],
        scanner_tilt_deg=scanner[1],
    )
    return setup, Target(
        heading_deg=target[0],
        tilt_deg=target[1],
        range_m=place[0],
        height_difference_m=place[1],
    )


CASES = {
    "5 m, 45/45": _case(300e3, 100, 8, (45, 45), (0, 0), (5, 0)),
    "8 m, 45/45, 15/15": _case(300e3, 100, 10, (45, 45), (15, 15), (8, -1)),
    "12 m, 45/30, -20/30": _case(500e3, 200, 12, (45, 30), (-20, 30), (12, 1)),
    "16 m, 30/30, 40/10": _case(300e3, 100, 13, (30, 30), (40, 10), (16, 2)),
    "6 m, 45/20, -10/0": _case(125e3, 100, 6, (45, 20), (-10, 0), (6, 1)),
}
"""Range, rotations of the scanner and of the target: five set-ups from near to far."""


def simulate_patch(
    setup,
    target,
    *,
    size,
    seed,
    range_noise_m=0.005,
    angle_noise_deg=0.005,
    speed_share=0.01,
    dropout_share=0.05,
):
    """Scan a square patch of a target, from a vehicle whose speed wanders.

    Parameters
    ----------
    setup : ScanSetup
    target : Target
    size : float
        Width of the patch, metres.
    seed : int
    range_noise_m, angle_noise_deg, speed_share, dropout_share : float
        Standard deviations of ranges, recorded mirror angles and speed (correlated over 0.5 s), and
        share of pulses without an echo.

    Returns
    -------
    Cloud, Lattice
        The points, and the lattice in the patch's middle at the mean of the speeds at which they
        were scanned. The beam of the lattice ends there.
    """
    spot = target.patch(setup)
    corners = _corners(setup, spot, size)
    reach = corners @ setup.plane_normal / setup.plane_normal[1]
    ends = reach.min() - 0.1, reach.max() + 0.1
    level = simulate.straight(ends[1] - ends[0], setup.speed_m_s, start=(0, ends[0], 0))
    drive = simulate.with_speed_variation(level, share=speed_share, seed=seed)
    scanner = simulate.ProfileScanner(
        pulse_rate_hz=setup.pulse_rate_hz,
        mirror_frequency_hz=setup.mirror_frequency_hz,
        heading_deg=setup.scanner_heading_deg,
        tilt_deg=setup.scanner_tilt_deg,
        field_of_view_deg=_view(setup, spot, corners),
        range_noise_m=range_noise_m,
        angle_noise_deg=angle_noise_deg,
        dropout_share=dropout_share,
    )
    wall = simulate.rectangle(corners[0], corners[1] - corners[0], corners[2] - corners[0])
    cloud = simulate.scan_all(simulate.Scene([wall]), scanner, drive, seed=seed)
    after, before = (drive.at(cloud["gps_time"] + side * 1e-4)[0][:, 1] for side in (1, -1))
    speed = float(np.mean(after - before) / 2e-4)
    return cloud, scan_lattice(replace(setup, speed_m_s=speed), spot)


def _corners(setup, spot, size):
    """Three corners of a square about a spot, along its level line and its slope."""
    along, up = scan_lattice(setup, spot).axes
    first = spot.points - size / 2 * (along + up)
    return np.array([first, first + size * along, first + size * up, first + size * (along + up)])


def _view(setup, spot, corners):
    """Scan angles between which a patch lies, with a margin of two degrees."""
    beams = scan_lattice(setup, Patch(corners, spot.normals)).beam @ setup.rotation()
    angle = np.degrees(np.arctan2(beams[:, 0], -beams[:, 2]))
    return max(angle.min() - 2, -180.0), min(angle.max() + 2, 180.0)


def compute(*, sizes, seeds, cases=tuple(CASES), numberings=("gps_time", "pattern"), progress=True):
    """Measure simulated patches and compare with their truth.

    Parameters
    ----------
    sizes : sequence of float
        Widths of the patches, metres.
    seeds : sequence of int
    cases : sequence of str
        Of ``CASES``.
    numberings : sequence of str
        ``gps_time``: with time stamps; ``pattern``: from the points alone.
    progress : bool
        Show a bar.

    Returns
    -------
    DataFrame
        A row per patch, way and quantity: ``case``, ``size_m``, ``seed``, ``numbering``,
        ``quantity``, ``true``, ``measured``, ``std``, ``error``, ``z`` = error / std.
    """
    from tqdm.auto import tqdm

    jobs = [(case, size, seed) for case in cases for size in sizes for seed in seeds]
    tables = []
    for case, size, seed in tqdm(jobs, desc="patches", disable=not progress):
        own_seed = [list(CASES).index(case), round(1000 * size), seed]
        number = int(np.random.SeedSequence(own_seed).generate_state(1)[0])
        cloud, truth = simulate_patch(*CASES[case], size=size, seed=number)
        for numbering in numberings:
            time = cloud["gps_time"] if numbering == "gps_time" else None
            found = measure_pattern(cloud.points, gps_time=time, reference=truth.beam).to_frame()
            true = [float(truth.quantity(name)) for name in found["quantity"]]
            tables.append(
                found.assign(case=case, size_m=size, seed=seed, numbering=numbering, true=true)
            )
    table = pd.concat(tables, ignore_index=True)
    table["error"] = table["measured"] - table["true"]
    table["z"] = table["error"] / table["std"]
    return table


def summary(table):
    """Return root mean square errors, mean standard deviations and the coverage of 95 % intervals.

    Returns
    -------
    DataFrame
        A row per case, size, numbering and quantity: ``rms_error``, ``std`` (root mean square),
        ``coverage`` (share of errors within 1.96 standard deviations), ``n``, ``missing`` (not
        measurable). Lengths in millimetres (``unit``).
    """
    keys = ["case", "size_m", "numbering", "quantity"]
    scale = np.where(table["quantity"].str.endswith("_m"), 1000.0, 1.0)
    table = table.assign(error=table["error"] * scale, std=table["std"] * scale)
    groups = table.groupby(keys, sort=False)
    found = groups.agg(
        rms_error=("error", lambda e: np.sqrt((e**2).mean())),
        std=("std", lambda s: np.sqrt((s**2).mean())),
        coverage=("z", lambda z: (z.dropna().abs() < 1.959964).mean()),
        n=("z", "count"),
        missing=("z", lambda z: z.isna().sum()),
    ).reset_index()
    found["unit"] = np.where(found["quantity"].str.endswith("_m"), "mm", "degrees")
    return found


def naive_spacing(cloud, *, scan_line):
    """Mean distance between neighbours along profiles: what clicking measures, metres."""
    order = np.lexsort((cloud["gps_time"], scan_line))
    steps = np.linalg.norm(np.diff(cloud.points[order], axis=0), axis=1)
    same = np.diff(scan_line[order]) == 0
    return float(steps[same].mean())
