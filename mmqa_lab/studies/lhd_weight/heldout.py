"""What the matchers reach on scenes that no setting was chosen on, and replicas of the tables."""

from functools import partial

import numpy as np
import pandas as pd
from tqdm.auto import tqdm

from mmqa_lab import lines
from mmqa_lab.published import poreba2013
from mmqa_lab.simulate.canyon import COMPARISONS, Conditions, canyon
from mmqa_lab.stats import bootstrap
from mmqa_lab.studies.lhd_weight.comparisons import comparisons, measure
from mmqa_lab.views import is_headless

CHI2_3 = 7.8147
"""95 % quantile of chi-squared with three degrees of freedom."""

CONDITIONS = {
    "as in the paper": (Conditions(), tuple(COMPARISONS)),
    "displaced 0 m": (Conditions(bias_m=(0.0, 0.0)), ("absolute",)),
    "displaced 1 m": (Conditions(bias_m=(1.0, 1.0)), ("absolute",)),
    "displaced 2 m": (Conditions(bias_m=(2.0, 2.0)), ("absolute",)),
    "displaced 3 m": (Conditions(bias_m=(3.0, 3.0)), ("absolute",)),
    "drift 0.5 m": (Conditions(drift_m=0.5), ("repeatability",)),
}
"""What happens to the edges, and which comparisons are made."""

THRESHOLDS = {
    "peak 0.2 m": partial(lines.peak_threshold, sensitivity=0.2),
    "peak 0.5 m": lines.peak_threshold,
    "peak 1.0 m": partial(lines.peak_threshold, sensitivity=1.0),
    "fixed 1.5 m": partial(lines.fixed_threshold, delta=1.5),
    "fixed 2.0 m": partial(lines.fixed_threshold, delta=2.0),
    "mixture": lines.mixture_threshold,
    "Otsu": lines.otsu_threshold,
    "median + 3 MAD": lines.mad_threshold,
}


def evaluate(seeds, *, matchers=("all", "fragments", "displaced")):
    """Run matchers on fresh scenes under all CONDITIONS.

    Parameters
    ----------
    seeds : sequence of int
        Held out: on none of them was anything chosen.
    matchers : sequence of str

    Returns
    -------
    DataFrame
        A row for each condition, seed, comparison and matcher: ``f1``, ``fp``, ``fn`` (means of
        both directions), ``lhd_m``, ``perpendicular_m`` and their true counterparts,
        ``vector_error_m``, ``mahalanobis`` (squared distance of the displacement from the truth in
        its covariance), ``used``.
    """
    rows = []
    tasks = [(name, seed) for name in CONDITIONS for seed in seeds]
    for name, seed in tqdm(tasks, desc="held-out scenes", disable=is_headless()):
        conditions, kinds = CONDITIONS[name]
        for one in comparisons(canyon(seed, conditions=conditions), kinds):
            for matcher in matchers:
                rows.append({"condition": name, "seed": seed, **_scored(one, matcher)})
    return pd.DataFrame(rows)


def targets(table):
    """Set what was obtained beside what was to be reached.

    Parameters
    ----------
    table : DataFrame
        Of :func:`evaluate`.

    Returns
    -------
    DataFrame
        ``quantity``, ``published`` (implied by the paper's counts), ``literal``, ``displaced``
        with ``low`` and ``high`` (95 %, scenes resampled), ``target``, ``reached``, ``missed`` (the
        whole interval lies beyond the target), ``n`` (scenes).
    """
    published = poreba2013.check()
    absolute = published["comparison"].str.contains("TLS")
    base = table[table["condition"] == "as in the paper"]
    moved = table[table["condition"].str.startswith("displaced")]
    drift = table[table["condition"] == "drift 0.5 m"]
    near = base.query("kind == 'repeatability'")
    far = base.query("kind == 'absolute'")
    rows = [
        _target("F1, absolute", far, "f1", np.mean, ">=", 0.96),
        _target("F1, repeatability", near, "f1", np.mean, ">=", 0.94),
        _target("5th percentile of F1", base, "f1", _fifth, ">=", 0.85),
        _target("false pairs, absolute", far, "fp", np.mean, "<=", 0.8),
    ]
    for metres in (0, 1, 2, 3):
        part = moved[moved["condition"] == f"displaced {metres} m"]
        name = f"perpendicular bias at {metres} m (m)"
        rows.append(_target(name, part, "perpendicular_bias_m", np.nanmean, "abs <=", 0.01))
    rows += [
        _target("vector error, median (m)", far, "vector_error_m", np.nanmedian, "<=", 0.05),
        _target("cover of the 95 % ellipsoid", far, "mahalanobis", _cover, "0.90 to", 0.98),
        _drift_target(drift),
    ]
    frame = pd.DataFrame(rows)
    frame["published"] = np.nan
    for quantity, value in (
        ("F1, absolute", published.loc[absolute, "f1"].mean()),
        ("F1, repeatability", published.loc[~absolute, "f1"].mean()),
        ("5th percentile of F1", published["f1"].min()),
        ("false pairs, absolute", published.loc[absolute, "fp"].mean()),
    ):
        frame.loc[frame["quantity"] == quantity, "published"] = value
    return frame


def table_replicas(seeds):
    """Tables 1 and 2 on simulated courses beside the published ones.

    Returns
    -------
    DataFrame
        A row for each comparison, direction and ``kind_of_number`` (published, measured): ``p``,
        ``q``, ``pairs``, ``fn``, ``fp``, ``detection_rate_percent``, ``f1``, ``olhd_m``,
        ``coverage``, ``displacement_m``.
    """
    rows = []
    for seed in tqdm(seeds, desc="table scenes", disable=is_headless()):
        for one in comparisons(canyon(seed)):
            found = one.compared("all")
            for name, part in (("test-model", found.test_model), ("model-test", found.model_test)):
                scores = lines.pairing_scores(part.pairs, one.truth)
                rows.append(
                    {
                        "comparison": "-".join(one.names),
                        "direction": name,
                        "p": len(one.test),
                        "q": len(one.model),
                        "pairs": int(one.truth.sum()),
                        "fn": scores.fn,
                        "fp": scores.fp,
                        "detection_rate_percent": 100 * scores.detection_rate,
                        "f1": scores.f1,
                        "olhd_m": part.olhd(10.0),
                        "coverage": part.coverage,
                        "displacement_m": found.displacement.length,
                    }
                )
    keys = ["comparison", "direction"]
    simulated = pd.DataFrame(rows).groupby(keys, sort=False).mean().reset_index()
    printed = poreba2013.check()
    columns = [*keys, "p", "q", "pairs", "fn", "fp", "detection_rate_percent", "f1", "olhd_m"]
    both = [
        printed[columns].assign(kind_of_number="published"),
        simulated.assign(kind_of_number="measured (simulated)", scenes=len(seeds)),
    ]
    return pd.concat(both, ignore_index=True)


def matcher_table(seeds, *, weight=10.0):
    """Every threshold with every matcher.

    Returns
    -------
    DataFrame
        ``threshold``, ``matcher``, ``f1``, ``f1_fifth_percentile``, ``share_below_half``, ``fp``,
        ``fn``, ``n`` (comparisons, both directions averaged).
    """
    found = [c for seed in seeds for c in comparisons(canyon(seed))]
    rows = []
    for name, threshold in tqdm(THRESHOLDS.items(), desc="thresholds", disable=is_headless()):
        for matcher in lines.MATCHERS:
            scores = [
                measure(c, weight=weight, threshold=threshold, matcher=matcher) for c in found
            ]
            rows.append({"threshold": name, "matcher": matcher, **_summary(scores)})
    return pd.DataFrame(rows)


def one_to_one(seeds, *, weight=10.0, matchers=("all", "mutual", "hungarian", "fragments")):
    """One-to-one against one-to-many, with and without over-segmentation of the edges.

    Returns
    -------
    DataFrame
        ``segmentation`` (as simulated, whole edges), ``kind``, ``matcher``, ``f1``, ``fp``,
        ``fn``, ``n``.
    """
    whole = Conditions(splits=0.0, truncations=0.0)
    rows = []
    for name, conditions in (("as simulated", Conditions()), ("whole edges", whole)):
        found = [c for seed in seeds for c in comparisons(canyon(seed, conditions=conditions))]
        for kind in COMPARISONS:
            these = [c for c in found if c.kind == kind]
            for matcher in matchers:
                choices = {"weight": weight, "threshold": lines.peak_threshold}
                scores = [measure(c, matcher=matcher, **choices) for c in these]
                row = {"segmentation": name, "kind": kind, "matcher": matcher}
                rows.append(row | _summary(scores))
    return pd.DataFrame(rows)


def readings(seeds, *, weight=10.0):
    """What each reading of an ambiguous sentence of the paper makes of F1 and the distance.

    Returns
    -------
    DataFrame
        ``question``, ``reading``, ``f1``, ``olhd_m`` (means over comparisons and directions);
        the first reading of each question is the default.
    """
    found = [c for seed in seeds for c in comparisons(canyon(seed))]
    peak = lines.peak_threshold
    rows = []
    for question, reading, choices in (
        ("rotated line", "test", {}),
        ("rotated line", "shorter", {"rotate": "shorter"}),
        ("within the range", "containment", {}),
        ("within the range", "any overlap", {"within": "overlap"}),
        ("differences", "second", {}),
        ("differences", "first", {"threshold": partial(peak, order=1)}),
        ("distance at the peak", "last before the jump", {}),
        ("distance at the peak", "first of three", {"threshold": partial(peak, at="index")}),
        ("distance at the peak", "middle of the jump", {"threshold": partial(peak, at="middle")}),
        ("denominator", "pairs", {}),
        ("denominator", "matched targets", {"norm": "matched"}),
        ("denominator", "all targets", {"norm": "all"}),
        ("weights", "target lengths", {}),
        ("weights", "source lengths", {"weights": "source"}),
    ):
        values = np.array([_read(c, weight, **choices) for c in found])
        f1, distance = np.nanmean(values, axis=(0, 1))
        rows.append((question, reading, f1, distance, len(found)))
    return pd.DataFrame(rows, columns=["question", "reading", "f1", "olhd_m", "n"])


def _scored(one, matcher):
    """A row of :func:`evaluate`."""
    found = one.compared(matcher)
    parts = (found.test_model, found.model_test)
    scores = [lines.pairing_scores(part.pairs, one.truth) for part in parts]
    error = found.displacement.vector - one.true_vector
    covariance = found.displacement.covariance
    known = np.isfinite(covariance).all()
    return {
        "kind": one.kind,
        "comparison": "-".join(one.names),
        "matcher": matcher,
        "used": found.matcher,
        "f1": np.mean([0.0 if np.isnan(s.f1) else s.f1 for s in scores]),
        "fp": np.mean([s.fp for s in scores]),
        "fn": np.mean([s.fn for s in scores]),
        "lhd_m": found.value,
        "true_m": one.true_length,
        "perpendicular_m": found.perpendicular_only,
        "perpendicular_bias_m": found.perpendicular_only - one.true_perpendicular,
        "vector_error_m": np.linalg.norm(error) if known else np.nan,
        "mahalanobis": error @ np.linalg.solve(covariance, error) if known else np.nan,
    }


def _target(quantity, part, column, statistic, relation, bound):
    """One row of :func:`targets`."""
    values = part[part["matcher"] == "displaced"]
    interval = bootstrap(
        statistic, values[column].to_numpy(), groups=values["seed"].to_numpy(), repeats=500
    )
    literal = statistic(part.loc[part["matcher"] == "all", column].to_numpy())
    accepted = {
        ">=": lambda value: value >= bound,
        "<=": lambda value: value <= bound,
        "abs <=": lambda value: abs(value) <= bound,
        "0.90 to": lambda value: 0.90 <= value <= bound,
    }[relation]
    within = [accepted(value) for value in (interval.low, interval.value, interval.high)]
    return {
        "quantity": quantity,
        "literal": literal,
        "displaced": interval.value,
        "low": interval.low,
        "high": interval.high,
        "target": f"{relation} {bound}",
        "reached": bool(within[1]),
        "missed": not any(within),
        "n": values["seed"].nunique(),
    }


def _drift_target(part):
    """F1 under strong drift: no worse than the literal method on the same scenes."""
    wide = part.pivot_table(index=["seed", "comparison"], columns="matcher", values="f1")
    scenes = wide.index.get_level_values("seed").to_numpy()
    interval = bootstrap(np.mean, wide["displaced"].to_numpy(), groups=scenes, repeats=500)
    literal = wide["all"].mean()
    return {
        "quantity": "F1 at drift 0.5 m, repeatability",
        "literal": literal,
        "displaced": interval.value,
        "low": interval.low,
        "high": interval.high,
        "target": ">= literal",
        "reached": bool(interval.value >= literal),
        "missed": bool(interval.high < literal),
        "n": len(np.unique(scenes)),
    }


def _fifth(values):
    return float(np.percentile(values, 5))


def _cover(values):
    """Share of displacements whose truth lies in the 95 % ellipsoid."""
    values = values[np.isfinite(values)]
    return float((values <= CHI2_3).mean()) if len(values) else np.nan


def _summary(scores):
    """F1 with its tail and the errors of a list of measures."""
    f1 = np.array([score["f1"] for score in scores])
    return {
        "f1": f1.mean(),
        "f1_fifth_percentile": np.percentile(f1, 5),
        "share_below_half": (f1 < 0.5).mean(),
        "fp": np.mean([score["fp"] for score in scores]),
        "fn": np.mean([score["fn"] for score in scores]),
        "n": len(scores),
    }


def _read(
    one,
    weight,
    *,
    rotate="test",
    within="containment",
    threshold=lines.peak_threshold,
    norm="pairs",
    weights="target",
):
    """F1 and oriented distance of both directions under one reading, (2, 2)."""
    values = []
    for source, target, truth in (
        (one.test, one.model, one.truth),
        (one.model, one.test, one.truth.T),
    ):
        parts = lines.components(source, target, rotate=rotate, within=within)
        distances = parts.distance(weight)
        pairs = distances <= threshold(distances.min(axis=1)).delta
        lengths = target.lengths if weights == "target" else source.lengths[:, None]
        values.append(
            (
                lines.pairing_scores(pairs, truth).f1,
                lines.olhd(distances, pairs, lengths, norm=norm),
            )
        )
    return values
