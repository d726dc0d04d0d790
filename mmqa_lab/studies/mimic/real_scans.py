"""Two real scans: profiles across a street, and a road patch from two crossing heads."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from mmqa_lab.io import read_cloud
from mmqa_lab.samples import has_real, path, real_path
from mmqa_lab.scan_pattern import (
    ScanPlanes,
    fit_scan_planes,
    measure_pattern,
    mirror_frequency,
    revolutions_from_time,
)

STREET = "street_profiles/street_0.02_s.laz"
"""0.02 s of a street (jakteristics test data, BSD), in the folder that ``MMQA_DATA`` names."""

PATCHES_M = (-4.0, -2.0, 0.0, 2.0, 4.0, 6.0)
"""Middles of six road patches side by side between the kerbs, across the street, 2 m wide."""


@dataclass(frozen=True, eq=False)
class Street:
    """The scan planes of the street, and the profile spacing on its road."""

    planes: ScanPlanes
    patches: pd.DataFrame


def street():
    """Return the street's scan planes and measured beside predicted spacing, or None without it.

    The prediction for a patch comes from all points outside it: their planes, cut with the plane
    of the patch. ``at_rest_mm`` takes the vehicle to move without turning, as MIMIC does;
    ``predicted_mm`` lets it turn.

    Returns
    -------
    Street or None
        Its patches have ``across_m``, ``n``, ``profiles``, ``measured_mm``, ``std_mm``,
        ``at_rest_mm``, ``predicted_mm``, ``difference_mm`` (from the latter).
    """
    if not has_real(STREET):
        return None
    cloud = read_cloud(real_path(STREET))
    points, time = cloud.points, cloud["gps_time"]
    planes = fit_scan_planes(points, time)
    number = revolutions_from_time(time)
    across, height = (points - planes.centre)[:, 1:].T
    rows = []
    for middle in PATCHES_M:
        patch = (np.abs(across - middle) < 1) & (height < 0.5)
        found = measure_pattern(points[patch], scan_line=number[patch])
        others = fit_scan_planes(points[~patch], time[~patch])
        normal = found.plane.normal
        crossing = np.linalg.norm(np.cross(others.normal, normal))
        at_rest = others.speed_m_s / others.mirror_frequency_hz / crossing
        gap, gap_std = (
            found.profile_spacing_perpendicular_m,
            found.profile_spacing_perpendicular_std,
        )
        predicted = others.spacing_on(found.plane.centre, normal)
        lengths = 1000 * np.array([gap, gap_std, at_rest, predicted, gap - predicted])
        rows.append((middle, found.points, found.profiles, *lengths))
    names = ["across_m", "n", "profiles", "measured_mm", "std_mm", "at_rest_mm", "predicted_mm"]
    return Street(planes, pd.DataFrame(rows, columns=[*names, "difference_mm"]))


@dataclass(frozen=True, eq=False)
class Road:
    """The profiles of two heads on a road patch."""

    heads: pd.DataFrame
    crossing_deg: float
    speed_m_s: float


def road():
    """Return what the points of the road patch say about the two heads that scanned it.

    Each head's profiles give the motion of the vehicle in a revolution along their normal; both
    together give it whole, up to a sign: that one is right for which both mirrors turn equally
    fast. Then times are compared at equal places across the track, where the mirror angle is equal.

    Returns
    -------
    Road
        ``heads``: ``head``, ``n``, ``profiles``, ``gap_mm``, ``std_mm``, ``mirror_frequency_hz``
        and ``uncorrected_hz``, from the middles of the profiles.
    """
    cloud = read_cloud(path("road_patch"))
    time = cloud["gps_time"] - cloud["gps_time"].min()
    order = np.sort(time)
    pause = order[np.argmax(np.diff(order))]
    parts = [time <= pause, time > pause]
    found = [measure_pattern(cloud.points[part], gps_time=time[part]) for part in parts]
    gaps = np.array([one.profile_spacing_perpendicular_m for one in found])
    along = np.array([one.direction[:2] / np.linalg.norm(one.direction[:2]) for one in found])
    normals = along @ [[0, 1], [-1, 0]]
    candidates = []
    for sign in (1, -1):
        motion = np.linalg.solve(normals, gaps * [1, sign])
        across = cloud.points[:, :2] @ [-motion[1], motion[0]] / np.linalg.norm(motion)
        rates = [_rate_across(time[part], across[part]) for part in parts]
        candidates.append((abs(rates[0] - rates[1]), rates, np.linalg.norm(motion)))
    _, rates, motion = min(candidates, key=lambda candidate: candidate[0])
    heads = pd.DataFrame(
        {
            "head": ["A", "B"],
            "n": [one.points for one in found],
            "profiles": [one.profiles for one in found],
            "gap_mm": 1000 * gaps,
            "std_mm": [1000 * one.profile_spacing_perpendicular_std for one in found],
            "mirror_frequency_hz": rates,
            "uncorrected_hz": [mirror_frequency(time[part]) for part in parts],
        }
    )
    crossing = np.degrees(np.arccos(abs(found[0].direction @ found[1].direction)))
    return Road(heads, float(crossing), float(motion * np.mean(rates)))


def _rate_across(time, across):
    """Revolutions per second from times at equal places across the track."""
    number = revolutions_from_time(time).astype(np.float64)
    place = across - across.mean()
    terms = np.stack([np.ones_like(place), number, place, place**2, place**3], axis=1)
    return float(1 / np.linalg.lstsq(terms, time - time.mean(), rcond=None)[0][1])
