"""Simulated systems driven over a simulated test field, and what the reference says of them."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from tqdm.auto import tqdm

from mmqa_lab.published import eurosdr2013_testfield
from mmqa_lab.simulate import measured
from mmqa_lab.simulate.testfield import (
    SURVEY_STD_M,
    drive_testfield,
    make_testfield,
    systems,
)
from mmqa_lab.testfield import (
    corner_positions,
    distance_to_path,
    height_accuracy,
    height_differences,
    plan_accuracy,
    pole_positions,
    trend_columns,
)

PROFESSIONAL = ("profiler", "two pulsed profilers")

DIRECTIONS = {"there": (0,), "back": (1,), "both": (0, 1)}
"""Names of what is measured together, and the numbers of its drives."""

STANDS_FOR = {"profiler, not calibrated": "ROAMER I", "profiler": "ROAMER II"}
"""Rows of the report's tables that a simulated system is the like of."""

NOT_DECIDED = "Table 3-3 and the specifications in Table 3-2 were not at hand"

INTERVAL_S = 0.1
"""Of the paths drawn for predictions; navigation drifts over tens of seconds."""

RADIUS_M = 0.5
"""Of the surfaces: the report's for sparse points, which simulated pulses are kept to."""


@dataclass(frozen=True, eq=False)
class Survey:
    """One system on the field.

    Parameters
    ----------
    system : str
    points : array, shape (n, 3)
        Of both drives together.
    heights, poles, corners : DataFrame
        Differences, with ``distance_m`` from the nearer path, or from its own: one after the other
        for each ``direction`` (there, back, both).
    prediction : array, shape (draws,)
        Standard deviations of heights, mm, that drives of such a system would have.
    """

    system: str
    points: np.ndarray
    heights: pd.DataFrame
    poles: pd.DataFrame
    corners: pd.DataFrame
    prediction: np.ndarray


def survey_all(*, length_m, seed, pulses_per_s, ground_spacing_m, draws):
    """Drive every simulated system over one field.

    Parameters
    ----------
    length_m : float
        Of the street.
    seed : int
    pulses_per_s : float
        Simulated at most.
    ground_spacing_m : float
        Of the reference points.
    draws : int
        Drives drawn for the prediction.

    Returns
    -------
    SimulatedField, list of Survey
    """
    street = make_testfield(length_m=length_m, seed=seed)
    reference = street.ground(spacing_m=ground_spacing_m, seed=seed)
    surveys = []
    for number, system in enumerate(tqdm(systems().values(), unit="system")):
        drives = drive_testfield(street, system, seed=seed + 10 * number, pulses_per_s=pulses_per_s)
        clouds = [cloud.points for cloud, _ in drives]
        both = np.concatenate(clouds)
        found = [
            _measured(points, street, reference, direction)
            for points, direction in zip([*clouds, both], DIRECTIONS, strict=True)
        ]
        tables = [pd.concat(parts, ignore_index=True) for parts in zip(*found, strict=True)]
        prediction = predicted_std(street, system, reference, draws=draws, seed=seed)
        surveys.append(Survey(system.name, both, *tables, prediction))
    return street, surveys


def _measured(points, street, reference, direction):
    """Tables of heights, poles and corners of a cloud, with distances from its paths."""
    tables = [
        height_differences(points, reference, radius=RADIUS_M),
        pole_positions(points, street.poles),
        corner_positions(points, street.corners),
    ]
    driven = [street.drives()[number].position for number in DIRECTIONS[direction]]
    for table in tables:
        places = table[["x_m", "y_m"]].to_numpy()
        table["distance_m"] = np.min([distance_to_path(places, path) for path in driven], axis=0)
        table["direction"] = direction
    return tables


def predicted_std(street, system, reference, *, draws, seed, speed=10.0):
    """Return the height std (mm) of drives, from the specifications alone.

    Navigation errors are drawn for each drive and carried to the reference points from the nearer
    path; range noise enters with the sine of the beam's fall and the 0.7 that a triangulated
    surface leaves of it, the survey with its own. No ray is cast.

    Parameters
    ----------
    street : SimulatedField
    system : System
    reference : array, shape (n, 3)
    draws : int
    seed : int
    speed : float
        m/s.

    Returns
    -------
    array, shape (draws,)
        NaN where the mounting is wrong: no specification says how much.
    """
    paths = street.drives(speed)
    gaps = [np.abs(reference[:, 0] - path.position[0, 0]) for path in paths]
    nearer = np.argmin(gaps, axis=0)
    rng = np.random.default_rng(seed)
    if any(any(head.boresight_deg) for head in system.heads):
        return np.full(draws, np.nan)
    found = np.empty(draws)
    for draw in range(draws):
        error = rng.normal(0, SURVEY_STD_M, len(reference))
        for number, path in enumerate(paths):
            of_path = nearer == number
            points = reference[of_path]
            since = np.abs(points[:, 1] - path.position[0, 1]) / speed
            known = measured(
                path, system.navigation, seed=[seed, draw, number], interval_s=INTERVAL_S
            )
            place, rotation = path.at(path.time[0] + since)
            vector = np.einsum("nij,ni->nj", rotation, points - place)
            told, turned = known.at(path.time[0] + since)
            error[of_path] += (told - place + np.einsum("nij,nj->ni", turned, vector))[:, 2]
            error[of_path] -= (points - place)[:, 2]
            fall = np.abs(vector[:, 2]) / np.linalg.norm(vector, axis=1)
            noise = np.sqrt(0.5) * system.heads[0].range_noise_m * fall
            error[of_path] += rng.normal(0, 1, len(points)) * noise
        found[draw] = 1000 * error.std(ddof=1)
    return found


def repeated_std(street, system, *, repeats, seed, pulses_per_s):
    """Return the height std of surveys with one system, again and again, beside the prediction.

    Parameters
    ----------
    street : SimulatedField
    system : System
    repeats : int
        Surveys in both directions.
    seed : int
    pulses_per_s : float
        Simulated at most.

    Returns
    -------
    DataFrame
        ``measured_mm`` of each survey, ``predicted_mm`` of ten times as many draws.
    """
    reference = street.ground(spacing_m=2.0, seed=seed)
    found = np.empty(repeats)
    for k in tqdm(range(repeats), unit="survey"):
        drives = drive_testfield(
            street, system, seed=seed + 100 + 10 * k, pulses_per_s=pulses_per_s
        )
        points = np.concatenate([cloud.points for cloud, _ in drives])
        table = height_differences(points, reference, radius=RADIUS_M)
        found[k] = height_accuracy(table)["std_mm"].iloc[1]
    predicted = predicted_std(street, system, reference, draws=10 * repeats, seed=seed)
    columns = {"predicted_mm": pd.Series(predicted), "measured_mm": pd.Series(found)}
    return pd.DataFrame(columns)


def height_table(surveys):
    """Return the elevation accuracy of all systems, measured beside predicted.

    Returns
    -------
    DataFrame
        ``system``, ``direction``, ``kind`` = measured, the columns of ``height_accuracy``, gross
        errors, the trend of absolute differences (mm per m with its 95 % interval);
        ``predicted_std_mm`` of both directions together and its 5 and 95 % quantiles.
    """
    rows = []
    for survey in surveys:
        low, middle, high = np.quantile(survey.prediction, [0.05, 0.5, 0.95])
        for direction, heights in survey.heights.groupby("direction", sort=False):
            table = height_accuracy(heights).assign(system=survey.system, direction=direction)
            table["gross_errors"] = int((heights["reason"] == "gross error").sum())
            used = heights[heights["reason"] == ""]
            table = table.assign(**trend_columns(used["distance_m"], 1000 * used["dz_m"].abs()))
            if direction == "both":
                table["predicted_std_mm"] = middle
                table["predicted_low_mm"], table["predicted_high_mm"] = low, high
            rows.append(table.assign(kind="measured"))
    return _first(pd.concat(rows, ignore_index=True), ["system", "direction", "kind"])


def plan_table(surveys):
    """Return the planimetric accuracy of all systems.

    Returns
    -------
    DataFrame
        ``system``, ``direction``, ``object`` (poles near the ground and 5 m up, building and curb
        corners), ``kind`` = measured, the columns of ``plan_accuracy``, and the trend of distances
        in plan (mm per m with its 95 % interval; NaN of fewer than three objects).
    """
    rows = []
    for survey in surveys:
        named = pd.concat([survey.poles.assign(object=pole_names(survey.poles)), survey.corners])
        named["object"] = named["object"].fillna(named["kind"])
        for (name, direction), table in named.groupby(["object", "direction"], sort=False):
            found = plan_accuracy(table).assign(system=survey.system, direction=direction)
            used = table[table["reason"] == ""]
            size = 1000 * np.hypot(used["dx_m"], used["dy_m"])
            found = found.assign(object=name, **trend_columns(used["distance_m"], size))
            rows.append(found.assign(kind="measured"))
    return _first(pd.concat(rows, ignore_index=True), ["system", "object", "direction", "kind"])


def pole_names(poles):
    """Return what to call the poles of a table by the height they were measured at."""
    return np.where(poles["height_m"] < 3, "pole, near the ground", "pole, 5 m up")


def against_published(heights):
    """Hold the height std of the simulated systems against Table 3-3, within 20 %.

    Returns
    -------
    DataFrame
        ``system``, ``predicted_std_mm``, ``measured_std_mm``, ``published_std_mm`` (NaN where the
        table's cell is not at hand), ``within_20_percent`` (None where undecided) and ``reason``.
    """
    rows = heights[(heights["direction"] == "both") & (heights["shift"] == "removed")]
    table = rows[["system", "predicted_std_mm"]].assign(measured_std_mm=rows["std_mm"])
    printed = eurosdr2013_testfield.table_3_3().groupby("system")["std_mm"].mean()
    table["published_std_mm"] = table["system"].map(STANDS_FOR).map(printed)
    share = table["measured_std_mm"] / table["published_std_mm"]
    decided = table["published_std_mm"].notna()
    table["within_20_percent"] = share.between(0.8, 1.2).astype(object).where(decided, None)
    table["reason"] = np.where(decided, "", NOT_DECIDED)
    return table.reset_index(drop=True)


def left_out(surveys):
    """Return how many reference objects were not measured in both directions together, and why."""
    rows = []
    for survey in surveys:
        tables = {"ground": survey.heights, "pole": survey.poles, "corner": survey.corners}
        for name, table in tables.items():
            table = table[table["direction"] == "both"]
            counts = table.loc[table["reason"] != "", "reason"].value_counts()
            for reason, count in counts.items():
                rows.append((survey.system, name, reason, int(count), len(table)))
    return pd.DataFrame(rows, columns=["system", "object", "reason", "count", "n"])


def _first(table, names):
    """The table with these columns first."""
    return table[[*names, *table.columns.drop(names)]]
