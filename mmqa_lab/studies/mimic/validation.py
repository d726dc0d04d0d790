"""MIMIC's validation once more, with ray casting in place of CAD drawings and clicks."""

from itertools import product

import numpy as np
import pandas as pd

from mmqa_lab import simulate
from mmqa_lab.published import cahalane2014
from mmqa_lab.scan_pattern import Patch, ScanSetup, Target, mimic, scan_lattice, sensitivities

SETUP = ScanSetup(
    pulse_rate_hz=cahalane2014.PULSE_RATE_HZ,
    mirror_frequency_hz=cahalane2014.MIRROR_FREQUENCY_HZ,
    speed_m_s=cahalane2014.SPEED_M_S,
    scanner_heading_deg=cahalane2014.SCANNER_DEG[0],
    scanner_tilt_deg=cahalane2014.SCANNER_DEG[1],
)
"""The simulated scanner of the paper's section 4.1."""

ADVANCE_M = SETUP.speed_m_s / SETUP.mirror_frequency_hz

GROUND_M = -3.1
"""Height of the ground below the scanner, said with Table 4."""


def wall(normal, spot, *, size=400.0):
    """Return a scene of one square wall, its level line and its line of greatest slope."""
    level = np.cross([0.0, 0.0, 1.0], normal)
    level /= np.linalg.norm(level)
    slope = np.cross(normal, level)
    corner = np.asarray(spot) - size / 2 * (level + slope)
    return simulate.Scene([simulate.rectangle(corner, size * level, size * slope)]), level, slope


def table_3(*, range_m):
    """Compute Table 3 by the closed form and by casting rays on the walls.

    Parameters
    ----------
    range_m : float
        Distance of the walls; it does not matter, and is not stated.

    Returns
    -------
    DataFrame
        The published table with ``predicted_m``, ``ray_cast_m`` (two profiles of a scan plane at
        rest), ``difference_m``, ``agrees`` (to the printed digits), and what the paper does not
        print: ``vertical_m``, ``perpendicular_m``, ``angle_deg`` at rest, ``moving_angle_deg``.
    """
    table = cahalane2014.table_3()
    rows = [
        _row_of_table_3(row.alpha_targ_deg, row.beta_targ_deg, range_m)
        for row in table.itertuples()
    ]
    found = pd.concat([table, pd.DataFrame(rows)], axis=1)
    found["difference_m"] = found["ray_cast_m"] - found["predicted_m"]
    found["agrees"] = found["predicted_m"].round(3) == found["profile_spacing_m"]
    return found


def _row_of_table_3(alpha, beta, range_m):
    """Spacings and angles of one wall."""
    target = Target(heading_deg=alpha, tilt_deg=beta, range_m=range_m)
    spot = target.patch(SETUP).points
    scene, level, slope = wall(-target.normal, spot)
    rotation, tip = SETUP.rotation(), np.radians(1.0)
    aims = np.array([[1, 0, 0], [np.cos(tip), 0, np.sin(tip)]]) @ rotation.T
    starts = np.array([[0, 0, 0], [0, 0, 0], [0, ADVANCE_M, 0]], dtype=float)
    hits = starts + scene.cast(starts, aims[[0, 1, 0]]).range_m[:, None] * aims[[0, 1, 0]]
    (u, v), (s, t) = (hits[1:] - hits[0]) @ np.array([level, slope]).T
    horizontal = mimic.profile_spacing_horizontal(ADVANCE_M, 45, alpha)
    angle = mimic.profile_angle(45, 45, alpha, beta)
    moving = scan_lattice(SETUP, target.patch(SETUP))
    return {
        "predicted_m": float(horizontal),
        "ray_cast_m": abs(s - t * u / v),
        "vertical_m": float(mimic.profile_spacing_vertical(horizontal, angle)),
        "perpendicular_m": float(horizontal * np.sin(np.radians(angle))),
        "angle_deg": float(angle),
        "moving_angle_deg": float(moving.profile_angle_deg),
    }


def table_4_readings(*, pivots_m):
    """Compute Table 4 in every reading of a family, and count the rows each one gives.

    The wall stands through (4, 4) and leans about a level line through a pivot at some height; it
    is struck by the horizontal pulse, and the next pulse goes up or down. The scanner's tilt is +45
    or -45 degrees, or as the wall leans, or against it.

    Parameters
    ----------
    pivots_m : sequence of float
        Heights of the pivot over the ground.

    Returns
    -------
    DataFrame
        A row per reading and row of the table: ``reading``, ``pivot_m``, ``row``, ``published_mm``,
        ``fitted_mm``, ``agrees``, ``rows_that_agree`` of the reading.
    """
    signs = {
        "+45": lambda lean: 1,
        "-45": lambda lean: -1,
        "with the wall": lambda lean: 1 if lean >= 0 else -1,
        "against the wall": lambda lean: -1 if lean >= 0 else 1,
    }
    tables = []
    for (name, sign), (way, step), pivot in product(
        signs.items(), (("up", 1), ("down", -1)), pivots_m
    ):
        table = cahalane2014.table_4()
        table = table.rename(columns={"point_spacing_mm": "published_mm"})
        table["fitted_mm"] = [
            1000 * _spacing_of_reading(row, sign(row.beta_targ_deg), step, GROUND_M + pivot)
            for row in table.itertuples()
        ]
        table["agrees"] = (table["fitted_mm"] - table["published_mm"]).abs() <= 0.5
        tables.append(
            table.assign(
                reading=f"tilt {name}, next pulse {way}",
                pivot_m=pivot,
                rows_that_agree=int(table["agrees"].sum()),
            )
        )
    return pd.concat(tables, ignore_index=True)


def best_reading(readings):
    """Return the rows of the reading that gives most rows of Table 4, with what 4 m allows."""
    best = readings[readings["rows_that_agree"] == readings["rows_that_agree"].max()]
    first = best.iloc[0]
    same = (best["reading"] == first["reading"]) & (best["pivot_m"] == first["pivot_m"])
    proof = cahalane2014.smallest_spacing()[["row", "smallest_mm", "possible"]]
    names = ["row", "alpha_targ_deg", "beta_targ_deg", "published_mm", "fitted_mm", "agrees"]
    return best.loc[same, names].merge(proof, on="row")


def _spacing_of_reading(row, sign, step, pivot):
    """Distance of two pulses on the wall, NaN where they do not meet it."""
    normal = mimic.target_normal(row.alpha_targ_deg, row.beta_targ_deg)
    plane = mimic.scanner_normal(45, sign * 45)
    level = np.array([1, 1, 0]) / np.sqrt(2)
    up = np.cross(level, plane)
    up *= np.sign(up[2])
    angle = np.radians(SETUP.pulse_step_deg)
    aims = np.array([level, np.cos(angle) * level + step * np.sin(angle) * up])
    reach = normal @ [4, 4, pivot] / (aims @ normal)
    if not (reach > 0).all():
        return np.nan
    return float(np.linalg.norm(reach[1] * aims[1] - reach[0] * aims[0]))


def table_6(*, range_m, change_m=0.002):
    """Compute what each input must change by for a profile spacing to change by ``change_m``.

    For the set-up that the paper declares, on three walls; the paper's own row is beside it, whose
    set-up is not stated. Inputs that the paper leaves out, the attitude and its rates, stand below.

    Returns
    -------
    DataFrame
        ``quantity``, ``input``, ``unit``, ``published``, and ``predicted`` per wall (inf where the
        spacing does not depend on the input).
    """
    published = cahalane2014.table_6().set_index("quantity")
    inputs = {
        "scanner_heading_deg": ("alpha_scan_deg", "degrees"),
        "scanner_tilt_deg": ("gamma_scan_deg", "degrees"),
        "target_heading_deg": ("alpha_targ_deg", "degrees"),
        "target_tilt_deg": ("beta_targ_deg", "degrees"),
        "mirror_frequency_hz": ("mirror_frequency_hz", "Hz"),
        "speed_m_s": ("speed_m_s", "m/s"),
        "roll_rate_deg_s": (None, "degrees/s"),
        "pitch_rate_deg_s": (None, "degrees/s"),
        "heading_rate_deg_s": (None, "degrees/s"),
    }
    walls = {(0, 0): "parallel", (-15, 0): "-15/0", (15, 15): "15/15"}
    slopes = {
        name: sensitivities(
            SETUP, Target(heading_deg=a, tilt_deg=b, range_m=range_m), inputs=list(inputs)
        )
        for (a, b), name in walls.items()
    }
    rows = []
    for quantity in published.index:
        for name, (column, unit) in inputs.items():
            row = {"quantity": quantity, "input": name, "unit": unit}
            row["published"] = published.loc[quantity, column] if column else np.nan
            for key, table in slopes.items():
                slope = abs(table.loc[name, quantity])
                row[f"predicted, wall {key}"] = change_m / slope if slope > 1e-7 else np.inf
            rows.append(row)
    return pd.DataFrame(rows)


def random_set_ups(*, n, seed):
    """Compare the closed forms with the simulator's ray caster on random set-ups.

    Scanners of all mountings drive past one leaning wall; each casts the pulses half a step and
    half a revolution before and after a spot.

    Returns
    -------
    DataFrame
        ``quantity``, ``largest_difference_m``, ``n``.
    """
    rng = np.random.default_rng(seed)
    setup = ScanSetup(
        pulse_rate_hz=rng.uniform(1e5, 1e6, n),
        mirror_frequency_hz=rng.uniform(50, 250, n),
        speed_m_s=rng.uniform(1, 30, n),
        scanner_heading_deg=rng.uniform(-60, 60, n),
        scanner_tilt_deg=rng.uniform(-60, 60, n),
    )
    normal = mimic.target_normal(20, 10)
    scene, *_ = wall(-normal, [6, 0, 0])
    mirror = rng.uniform(-0.6, 0.6, n)
    origin = np.zeros((n, 3))
    beam = _aims(setup, mirror) * scene.cast(origin, _aims(setup, mirror)).range_m[:, None]
    usable = np.linalg.norm(beam, axis=1) < 60
    lattice = scan_lattice(setup, Patch(np.where(usable[:, None], beam, [6.0, 0, 0]), -normal))
    pulse, turn = 1 / setup.pulse_rate_hz, 1 / setup.mirror_frequency_hz
    cast = {}
    for name, seconds, turns in (("a", pulse, pulse / turn), ("b", turn, 0 * turn)):
        ends = []
        for side in (-0.5, 0.5):
            aim = _aims(setup, mirror + side * 2 * np.pi * turns)
            start = np.stack([0 * turn, side * seconds * setup.speed_m_s, 0 * turn], axis=1)
            ends.append(start + scene.cast(start, aim).range_m[:, None] * aim)
        cast[name] = ends[1] - ends[0]
    spacing = np.linalg.norm(cast["a"], axis=1)
    gap = np.linalg.norm(np.cross(cast["a"], cast["b"]), axis=1) / spacing
    differences = {
        "step to the next pulse": np.linalg.norm(lattice.a - cast["a"], axis=1),
        "step to the next profile": np.linalg.norm(lattice.b - cast["b"], axis=1),
        "point spacing": np.abs(lattice.point_spacing_m - spacing),
        "profile spacing": np.abs(lattice.profile_spacing_perpendicular_m - gap),
    }
    rows = [(name, np.nanmax(values[usable])) for name, values in differences.items()]
    table = pd.DataFrame(rows, columns=["quantity", "largest_difference_m"])
    return table.assign(n=int(usable.sum()))


def _aims(setup, mirror):
    """Directions of pulses at mirror angles from the level axis upwards."""
    local = np.stack([np.cos(mirror), 0 * mirror, np.sin(mirror)], axis=1)
    return (setup.rotation() @ local[..., None])[..., 0]


def printed_equation_10(*, n, seed):
    """Return the relative error of equation 10 as printed (r1), for random set-ups.

    Returns
    -------
    DataFrame
        ``height_difference_m``, ``error`` = printed / corrected - 1.
    """
    rng = np.random.default_rng(seed)
    alpha, gamma = rng.uniform(-60, 60, (2, n))
    alpha_targ = np.clip(rng.uniform(-40, 40, n), alpha - 80, alpha + 80)
    beta = rng.uniform(-40, 40, n)
    height = rng.uniform(-3, 3, n)
    given = {"h_r": rng.uniform(3, 20, n), "height_difference": height, "theta_a": 0.12}
    angles = (alpha, gamma), (alpha_targ, beta)
    corrected = mimic.point_spacing(*angles, **given)
    printed = mimic.point_spacing(*angles, **given, literal=True)
    usable = np.abs(corrected.d2) < corrected.r1
    error = (printed.d_ps / corrected.d_ps - 1)[usable]
    return pd.DataFrame({"height_difference_m": height[usable], "error": error})
