"""The line-segment Hausdorff distance: weights, thresholds, matchers on scenes of known truth."""

import warnings
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, t

from mmqa_lab import bench, io, lines, plots, samples
from mmqa_lab.lines.segments import otsu_threshold
from mmqa_lab.published import ledger, table
from mmqa_lab.simulate.canyon import COMPARISONS, Canyon, Conditions, canyon, canyon_edges
from mmqa_lab.studies import SMALL, stated

QUICK = SMALL["lhd_weight"]

COURSES = {f"{a}-{b}": (a, b) for pairs in COMPARISONS.values() for a, b in pairs}
"""Test and model survey of each comparison, in the order of Tables 1 and 2."""

FITTED = ("C1-C2", "C1-C3", "C1-TLS", "C2-TLS")
"""Rows whose distances and errors the canyon's noise was fitted to; the others were held out.

The numbers of segments and true pairs were set for all rows."""

IDENTITY = (
    "From the printed counts, 100 (1 - (FN + FP) / (p q)): the identity is checked, not the counts."
)

BOARD_M = np.array([0.85, 0.61])
"""The board's sides (acfr/cam_lidar_calibration)."""

CORNERS = "boards/corners.csv"
SWEEPS = ("hdl32e_pair/sweep_a.laz", "hdl32e_pair/sweep_b.laz", "hdl32e_pair/a_to_b.txt")


@dataclass(frozen=True, eq=False)
class Sets:
    """What a method is given: ``test`` and ``model``, both Segments."""

    test: lines.Segments
    model: lines.Segments


@dataclass(frozen=True, eq=False)
class Truth:
    """True pairs (p, q), the displacement (k, 3) of each and the direction (k, 3) of its edge."""

    sets: Sets
    pairs: np.ndarray
    displacements: np.ndarray
    axes: np.ndarray

    def mean(self, vectors):
        """Mean length of vectors (k, 3) weighted as the LHD is, m."""
        rows, columns = np.nonzero(self.pairs)
        lengths = np.linalg.norm(vectors, axis=1)
        weights = self.sets.model.lengths[columns], self.sets.test.lengths[rows]
        return max(float(np.average(lengths, weights=weight)) for weight in weights)

    @property
    def across(self):
        """The part of the displacements across the edges, (k, 3), m."""
        along = (self.displacements * self.axes).sum(axis=1, keepdims=True)
        return self.displacements - along * self.axes


@lru_cache(maxsize=256)
def _scene(seed, conditions) -> Canyon:
    return canyon(seed, conditions=conditions)


def scene(comparison="C1-TLS", *, seed, **conditions):
    """Two surveys of a simulated canyon, and what is true of them.

    Parameters
    ----------
    comparison : str
        One of ``COURSES``.
    seed : int
    **conditions
        Of :class:`~mmqa_lab.simulate.canyon.Conditions`, or ``displacement_m``, the length of
        the displacement that all courses share.

    Returns
    -------
    tuple of Sets and Truth
    """
    if "displacement_m" in conditions:
        conditions["bias_m"] = (conditions.pop("displacement_m"),) * 2
    found = _scene(seed, Conditions(**conditions))
    test, model = (found.surveys[name] for name in COURSES[comparison])
    sets = Sets(test.segments, model.segments)
    pairs = found.pairs(*COURSES[comparison])
    axes = found.edges.directions[test.edge[np.nonzero(pairs)[0]]]
    return sets, Truth(sets, pairs, found.displacements(*COURSES[comparison]), axes)


def measured(sets, **choices):
    """The LHD of the sets; that few pairs remain is part of the statistics, not a warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return lines.lhd(sets.test, sets.model, **choices)


def score(result, truth):
    """Figures of one comparison.

    Parameters
    ----------
    result : LHD, array of bool (p, q), or float
        What a method returns: the whole distance, pairs alone, or a distance alone.
    truth : Truth

    Returns
    -------
    dict of str to float
        ``f1``, ``false_pairs``, ``missed_pairs``, ``rate_percent`` (means of both directions);
        ``lhd_m``, ``perpendicular_m`` and what they are above the true displacement
        (``lhd_bias_m``, ``across_bias_m``).
    """
    if np.isscalar(result):
        return {"lhd_m": result, "lhd_bias_m": result - truth.mean(truth.displacements)}
    if not isinstance(result, lines.LHD):
        result = measured(truth.sets, pairs=result)
    both = [part.pairs for part in (result.test_model, result.model_test)]
    scores = [lines.pairing_scores(pairs, truth.pairs) for pairs in both]
    return {
        "f1": np.mean([np.nan_to_num(s.f1) for s in scores]),
        "false_pairs": np.mean([s.fp for s in scores]),
        "missed_pairs": np.mean([s.fn for s in scores]),
        "rate_percent": 100 * np.mean([s.detection_rate for s in scores]),
        "lhd_m": result.value,
        "perpendicular_m": result.perpendicular_only,
        "lhd_bias_m": result.value - truth.mean(truth.displacements),
        "across_bias_m": result.perpendicular_only - truth.mean(truth.across),
    }


def score_directions(result, truth):
    """The figures of Tables 1 and 2 for both directions: left is test to model."""
    figures = {"p": len(truth.sets.test), "q": len(truth.sets.model)}
    figures["pairs"] = int(truth.pairs.sum())
    for side, part in (("left", result.test_model), ("right", result.model_test)):
        counts = lines.pairing_scores(part.pairs, truth.pairs)
        figures[f"{side}_false_negative"] = counts.fn
        figures[f"{side}_false_positive"] = counts.fp
        figures[f"{side}_olhd_m"] = part.olhd(result.weight)
    return figures


METHODS = {
    "published": measured,
    "plain Hausdorff": lambda sets: lines.hausdorff(sets.test, sets.model),
    "peak's value": partial(measured, threshold=partial(lines.peak_threshold, at="value")),
    "differences sorted again": partial(
        measured, threshold=partial(lines.peak_threshold, sort_again=True)
    ),
    "first differences": partial(measured, threshold=partial(lines.peak_threshold, order=1)),
    "sensitivity 0.1 m": partial(measured, sensitivity=0.1),
    "sensitivity 2 m": partial(measured, sensitivity=2.0),
    "Otsu's threshold": partial(measured, threshold=otsu_threshold),
    "shorter line turned": partial(measured, rotate="shorter"),
    "any overlap": partial(measured, within="overlap"),
    "all targets": partial(measured, norm="all"),
    "hungarian": partial(measured, matcher="hungarian"),
    "fragments": partial(measured, matcher="fragments"),
    "displaced": partial(measured, matcher="displaced"),
}
"""The published method, its other readings, and others: functions of :class:`Sets`."""


def comparison(quick=False):
    """Compare methods on all comparisons of simulated canyons.

    Returns
    -------
    Comparison
        Every method is a function of :class:`Sets` and returns an ``LHD``, true pairs or a number.
    """
    seeds = QUICK["seeds"] if quick else range(30)
    return bench.Comparison(
        bench.grid(comparison=tuple(COURSES)),
        dict(METHODS),
        scene,
        score,
        seeds=seeds,
        tables=lambda results: {"f1": bench.summary(results, "f1")},
        figures=lambda results: {"f1": draw_methods(results)},
    )


def draw_methods(results, figure="f1"):
    """Draw a figure of all methods with its intervals."""
    found = bench.summary(results, figure)[::-1]
    mean, low, high = found.columns[1:4]
    drawing, ax = plots.subplots(height_mm=75)
    ax.hlines(found["method"], found[low], found[high], color=plots.COLOURS["grey"])
    ax.plot(found[mean], found["method"], "o", color=plots.COLOURS["blue"])
    ax.set(xlabel=f"{figure.replace('f1', 'F1')}, mean (simulated)")
    return drawing


def published_rows():
    """Both printed tables, and F1 and the rates that follow from the printed counts.

    Returns
    -------
    DataFrame
        The printed columns, with ``name`` (as in ``COURSES``), ``rate_from_counts_percent``,
        ``null_rate_percent`` (pairing nothing) and ``f1``.
    """
    rows = pd.concat(
        [table("poreba2013", name).assign(table=name) for name in ("table_1", "table_2")]
    )
    rows = rows.reset_index(drop=True)
    rows["name"] = rows["test_set"].str.replace("Course", "C") + "-"
    rows["name"] += rows["model_set"].str.replace("Course", "C")
    cells = rows["p_test_segments"] * rows["q_model_segments"]
    wrong = rows["false_negative"] + rows["false_positive"]
    rows["rate_from_counts_percent"] = 100 * (1 - wrong / cells)
    rows["null_rate_percent"] = 100 * (1 - rows["pairing_existing"] / cells)
    right = rows["pairing_existing"] - rows["false_negative"]
    rows["f1"] = 2 * right / (2 * right + wrong)
    return rows


def replicas(results):
    """The simulated means beside the printed tables.

    Parameters
    ----------
    results : Dataset
        Of the published method with :func:`score_directions`.

    Returns
    -------
    DataFrame
        A row for each of the 14 printed: ``name``, ``side``, the printed counts and distance, the
        simulated mean of each, and the 95 % range of single scenes for the distance.
    """
    rows = []
    for printed in published_rows().itertuples():
        scenes = results.sel({"method": "published", "comparison": printed.name})
        olhd = scenes[f"{printed.position_in_cell}_olhd_m"].values
        row = {"name": printed.name, "side": printed.position_in_cell, "table": printed.table}
        row["comparison"] = printed.comparison
        for name in ("false_negative", "false_positive"):
            row[f"{name}_printed"] = getattr(printed, name)
            row[f"{name}_simulated"] = float(scenes[f"{printed.position_in_cell}_{name}"].mean())
        low, high = _single_scene(olhd)
        row |= {"olhd_printed_m": printed.olhd_m, "olhd_simulated_m": np.nanmean(olhd)}
        row |= {"low_m": low, "high_m": high}
        second = "second" in printed.comparison
        row["kind"] = "fitted" if printed.name in FITTED and not second else "predicted"
        rows.append(row)
    return pd.DataFrame(rows)


def ledger_entries(results):
    """What the study says of each printed result of the source.

    Parameters
    ----------
    results : Dataset
        As for :func:`replicas`.

    Returns
    -------
    list of dict
    """
    entries, known = [], set()
    for row, printed in zip(
        replicas(results).itertuples(), published_rows().itertuples(), strict=True
    ):
        scenes = results.sel({"method": "published", "comparison": row.name})
        cell = f"{row.comparison} {row.side}"
        rate = printed.rate_from_counts_percent
        place = ("poreba2013", row.table, f"{cell} detection rate")
        agrees = abs(rate - printed.detection_rate_percent) <= 0.005 + 1e-9
        note = IDENTITY if agrees else f"{IDENTITY} The printed rate would take twelve errors."
        entries.append(ledger.entry(*place, rate, kind="predicted", note=note))
        for ending, label in (
            ("olhd_m", "olhd"),
            ("false_negative", "false negative"),
            ("false_positive", "false positive"),
        ):
            values = scenes[f"{row.side}_{ending}"].values
            entries.append(_of_scenes(row.table, f"{cell} {label}", values, row.kind))
        for name in ("p", "q", "pairs"):
            whose = "TLS" if row.table == "table_2" and name == "q" else row.comparison
            # the scenes imitate the first extraction of edges, not the second
            if f"{whose} {name}" not in known and "second" not in whose:
                known.add(f"{whose} {name}")
                # the canyon's numbers of segments and pairs were set to those of all rows
                entries.append(
                    _of_scenes(row.table, f"{whose} {name}", scenes[name].values, "fitted")
                )
    return entries + _of_text(results.sel({"method": "published"}))


def _of_text(results):
    """Entries for the results that the text prints."""
    lhd = np.fmax(results["left_olhd_m"], results["right_olhd_m"])
    wrong = results["left_false_negative"] + results["left_false_positive"]
    rate = 100 * (1 - wrong / (results["p"] * results["q"])).mean("comparison")
    near = lhd.sel(comparison="C1-C3")
    far = lhd.sel(comparison=["C1-TLS", "C3-TLS"]).mean("comparison")
    values = {"precision_abstract": near, "precision_text": near}
    values |= {"absolute_abstract": far, "absolute_text": far}
    entries = [_of_scenes("numbers", name, one.values, "fitted") for name, one in values.items()]
    return [*entries, _of_scenes("numbers", "pairing_confidence", rate.values, "predicted")]


def _of_scenes(name, cell, values, kind):
    """An entry with the mean of simulated scenes and the range of 95 % of them."""
    how = "partly fitted to this cell" if kind == "fitted" else "fitted to other cells only"
    note = f"Mean and 95 % range of single simulated canyons, whose conditions were {how}."
    low, high = _single_scene(values)
    ours = {"kind": kind, "low": low, "high": high, "note": note}
    return ledger.entry("poreba2013", name, cell, np.nanmean(values), **ours)


def _single_scene(values):
    """Where one more scene lies with 95 %: prediction interval by Student's t, not below 0."""
    values = values[np.isfinite(values)]
    n, middle = len(values), values.mean()
    half = t.ppf(0.975, max(n - 1, 1)) * values.std(ddof=min(1, n - 1)) * np.sqrt(1 + 1 / n)
    return max(middle - half, 0.0), middle + half


def true_edges(found, edges, *, near_m=0.1, parallel_deg=2.0):
    """Compare extracted edges with the true ones of a canyon.

    Parameters
    ----------
    found : Edges
    edges : Canyon
    near_m, parallel_deg : float
        An extracted edge shows a true one when it is as near and as parallel.

    Returns
    -------
    DataFrame
        One row: ``edges`` and ``shown`` true ones of ``true_edges``, ``error_median_mm`` across
        them, ``sigma_median_mm`` as stated, ``cover_95`` of the stated covariance.
    """
    true = canyon_edges(edges)
    parts = lines.components(found.segments, true)
    shorter = np.minimum(found.segments.lengths[:, None], true.lengths)
    near = parts.angle < np.sin(np.radians(parallel_deg)) * shorter
    near &= (parts.perpendicular < near_m) & (parts.parallel < near_m)
    rows = np.flatnonzero(near.any(axis=1))
    columns = np.where(near[rows], parts.perpendicular[rows], np.inf).argmin(axis=1)
    axes = true.directions[columns]
    rest = np.eye(3) - axes[:, :, None] * axes[:, None]
    offsets = found.segments.ends[rows] - true.midpoints[columns][:, None]
    errors = np.einsum("nde,nke->nkd", rest, offsets)
    across = rest[:, None] @ found.covariance[rows] @ rest[:, None]
    inverse = np.linalg.pinv(across, rcond=1e-6, hermitian=True)
    squares = np.einsum("nkd,nkde,nke->nk", errors, inverse, errors)
    return pd.DataFrame(
        {
            "edges": [len(found)],
            "true_edges": len(true),
            "shown": len(np.unique(columns)),
            "error_median_mm": 1000 * np.median(np.linalg.norm(errors, axis=2)),
            "sigma_median_mm": 1000 * np.median(found.sigma[rows]),
            "cover_95": (squares <= chi2.ppf(0.95, 2)).mean(),
        }
    )


def board_edges():
    """Outlines of real boards: their size, and the lidar's edges against the camera's.

    All camera corners are brought to the lidar's by one rigid motion. Poses whose camera corners
    coincide are left out.

    Returns
    -------
    DataFrame
        A row for each pose: ``sensor``, ``pose``, ``long_error_mm`` and ``short_error_mm`` of the
        outline's sides, ``lhd_m``, ``perpendicular_m`` and ``corner_rms_mm`` from the camera.
    Sets
        All edges of the lidars (test) and of the camera (model), partners in one row.
    """
    camera = _corners("camera")
    outlines = {key: _outline(*key) for key in camera if _shortest(camera[key]) > 0.1}
    fixed = np.array([outline.corners for outline in outlines.values()])
    moving = np.array([camera[key] for key in outlines])
    rough = _fitted(moving, moving.mean(axis=1), fixed.mean(axis=1))
    order = np.array([_order(a, b) for a, b in zip(rough, fixed, strict=True)])
    moving = np.take_along_axis(moving, order[..., None], axis=1)
    turned = _fitted(moving, moving.reshape(-1, 3), fixed.reshape(-1, 3))
    seen = np.stack([turned, np.roll(turned, -1, axis=1)], axis=2)
    rows = []
    for (key, outline), edges, corners in zip(outlines.items(), seen, turned, strict=True):
        long, short = 1000 * (outline.size - BOARD_M)
        found = measured(Sets(outline.segments, lines.Segments(edges)))
        rms = 1000 * np.sqrt(((outline.corners - corners) ** 2).sum(axis=1).mean())
        rows.append((*key, long, short, found.value, found.perpendicular_only, rms))
    names = ["sensor", "pose", "long_error_mm", "short_error_mm", "lhd_m", "perpendicular_m"]
    ends = np.concatenate([outline.segments.ends for outline in outlines.values()])
    sets = Sets(lines.Segments(ends), lines.Segments(seen.reshape(-1, 2, 3)))
    return pd.DataFrame(rows, columns=[*names, "corner_rms_mm"]), sets


def _corners(source):
    """Corners (4, 3) of each (sensor, pose) by one source."""
    corners = pd.read_csv(samples.real_path(CORNERS)).query("source == @source")
    groups = corners.sort_values("corner").groupby(["sensor", "pose"])
    return {key: group[["x_m", "y_m", "z_m"]].to_numpy() for key, group in groups}


def _outline(sensor, pose):
    """The outline of one board cloud."""
    cloud = io.read_cloud(samples.real_path(f"boards/{sensor}_pose{pose:02d}.laz"))
    return lines.fit_outline(cloud.points, lines=cloud["ring"])


def _shortest(corners):
    return np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).min()


def _order(corners, like):
    """The order of corners, forwards or backwards from any of them, that fits others best."""
    turns = [np.roll(order, k) for order in (np.arange(4), np.arange(4)[::-1]) for k in range(4)]
    return min(turns, key=lambda turn: np.linalg.norm(corners[turn] - like))


def _fitted(points, moving, fixed):
    """Points (..., 3) after the rigid motion that takes ``moving`` nearest to ``fixed``."""
    centres = moving.mean(axis=0), fixed.mean(axis=0)
    turn, _ = Rotation.align_vectors(fixed - centres[1], moving - centres[0])
    return (points - centres[0]) @ turn.as_matrix().T + centres[1]


check = stated("lhd_weight")


def checks(*, by_weight, by_noise, by_displacement, held_out, rows):
    """Compare what the notebook says with this run.

    Parameters
    ----------
    by_weight, by_noise, by_displacement, held_out : Dataset
        Of :func:`mmqa_lab.bench.run`: methods ``W = ...`` on the comparisons; the same over the
        noise of directions; matchers over the displacement; published and displaced on fresh seeds.
    rows : DataFrame
        Of :func:`replicas`.

    Yields
    ------
    mmqa_lab.run.Check
    """
    f1, rate = _means(by_weight, "f1"), _means(by_weight, "rate_percent")
    scenes = by_weight.sizes["seed"]
    tolerance = 0.03 * np.sqrt(30 / scenes)
    yield check(
        "plateau",
        f1.max() - f1["W = 10"] <= tolerance,
        f"{f1.max() - f1['W = 10']:.3f} behind {f1.idxmax()}",
        tolerance=tolerance,
        scenes=scenes,
    )
    yield check(
        "rate", np.ptp(rate) < 0.5, f"{np.ptp(rate):.2f} points, while F1 moves by {np.ptp(f1):.3f}"
    )
    loud = by_noise.sel(angle_noise_deg=by_noise["angle_noise_deg"].max())
    loudest = _means(loud, "f1")
    yield check(
        "noisy_directions",
        loudest.max() - loudest["W = 10"] > 0.03,
        f"{loudest.max() - loudest['W = 10']:.3f} behind {loudest.idxmax()}",
    )
    far = by_displacement.sel(displacement_m=by_displacement["displacement_m"].max())
    bias, across = _means(far, "lhd_bias_m"), _means(far, "across_bias_m")
    yield check(
        "saturates",
        bias["all"] < -0.2 and abs(across["displaced"]) < 0.03,
        f"{bias['all']:+.2f} m and {across['displaced']:+.3f} m",
    )
    gain = bench.compare(held_out, "f1", reference="published", better="higher").iloc[0]
    yield check(
        "held_out",
        gain["low"] > 0,
        f"F1 {gain['difference']:+.3f} ({gain['low']:+.3f} to {gain['high']:+.3f})",
    )
    inside = rows["olhd_printed_m"].between(rows["low_m"], rows["high_m"])
    others = rows["kind"] == "predicted"
    yield check(
        "printed_distances",
        inside[others].all() and inside.mean() >= 12 / 14,
        f"{inside.sum()} of {len(rows)} within the range of single scenes; of the rows held out "
        f"{inside[others].sum()} of {others.sum()}",
    )


def _means(results, figure):
    """Mean of a figure for each method."""
    return bench.summary(results, figure).set_index("method").iloc[:, 0]


def answer(by_weight, held_out, rows):
    """The study's answer in two sentences."""
    over, f1 = _means(by_weight, "f1"), _means(held_out, "f1")
    weights = [name.removeprefix("W = ") for name in over.index]
    ratio = float(np.exp(np.log(rows["olhd_simulated_m"] / rows["olhd_printed_m"]).abs().mean()))
    return (
        "In simulated canyons, whose distances differ from the printed ones by "
        f"{100 * (ratio - 1):.0f} % on average, F1 is {over.mean():.2f}, varies by "
        f"{np.ptp(over):.3f} for W from {weights[0]} to {weights[-1]}, and is "
        f"{f1['displaced']:.2f} once the displacement is estimated first. The distance saturates "
        "and does not show the displacement."
    )
