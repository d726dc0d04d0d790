"""A whole study of edges: all comparisons of several clouds and a reference, and its report."""

from __future__ import annotations

import inspect
import io
import json
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_columns, check_number
from mmqa_lab._results import Shown
from mmqa_lab.cloud import Cloud
from mmqa_lab.lines.displacement import match_displaced
from mmqa_lab.lines.edges import extract_edges
from mmqa_lab.lines.hausdorff import lhd
from mmqa_lab.lines.segments import Segments, distance_matrix, pairing_scores

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LINE_ENDINGS = (".csv", ".txt", ".geojson", ".json", ".dxf")
LEAST_COVERAGE = 0.5
"""Share of the length of the lines that has a partner, below which a distance says little."""

TRUTH_COLUMNS = ["test_set", "model_set", "test_segment", "model_segment"]
VERDICTS = {
    "right": "#009E73",
    "wrong": "#D55E00",
    "missed": "#E69F00",
    "paired": "#0072B2",
    "several partners": "#CC79A7",
}
"""Colours of pairs: the first three where the truth is known, the others where it is not."""


def _settings_of(function):
    """The names of a function's settings."""
    return [name for name, one in inspect.signature(function).parameters.items() if one.kind == 3]


EXTRACTION = _settings_of(extract_edges)
COMPARISON = [name for name in _settings_of(lhd) if name != "pairs"]


@dataclass(frozen=True, eq=False)
class Study(Shown):
    """Comparisons of several sets of edges.

    Parameters
    ----------
    sets : dict of str to Segments
    edges : dict of str to Edges
        With their uncertainty, of those sets that were extracted from clouds.
    reference : str or None
        The set that the others are measured against.
    results : dict of (str, str) to LHD
        By test and model set: all pairs of sets, the reference always the model.
    displacements : dict of (str, str) to Displacement
        From the pairs of :func:`match_displaced`, which false neighbours do not pull.
    truth : dict of (str, str) to array of bool
        True pairs (p, q), where known.
    """

    sets: dict
    edges: dict
    reference: str | None
    results: dict
    displacements: dict
    truth: dict

    def to_frame(self) -> pd.DataFrame:
        """Return a row for each comparison and direction, with the columns of the paper's tables.

        ``lhd`` marks the larger distance of both directions, as the paper's asterisk does. Errors
        and rate are NaN where no truth is given.
        """
        rows = []
        for names, found in self.results.items():
            ways = {" to ".join(names): found.test_model}
            ways[" to ".join(names[::-1])] = found.model_test
            for name, way in ways.items():
                value = way.olhd(found.weight)
                figures = {"olhd_m": value, "lhd": "*" if value == found.value else ""}
                figures |= {"threshold_m": way.threshold.delta, "coverage": way.coverage}
                figures["perpendicular_m"] = way.perpendicular_only
                head = {"kind": self._kind(names), "comparison": "-".join(names), "direction": name}
                head |= {"p": len(found.test), "q": len(found.model), "pairs": way.n}
                rows.append(head | self._errors(names, way.pairs) | figures)
        return pd.DataFrame(rows)

    def comparisons(self) -> pd.DataFrame:
        """Return a row for each comparison: distance, kinds of correspondence, displacement."""
        rows = []
        for names, found in self.results.items():
            low, high = found.interval()
            row = {"kind": self._kind(names), "comparison": "-".join(names)}
            row |= {"lhd_m": found.value, "lhd_low_m": low, "lhd_high_m": high}
            moved = self.displacements[names]
            sigma = np.sqrt(np.diag(moved.covariance))
            row |= {
                f"displacement_{axis}_m": v for axis, v in zip("xyz", moved.vector, strict=True)
            }
            row |= {f"sigma_{axis}_m": v for axis, v in zip("xyz", sigma, strict=True)}
            row |= {"turn_deg": moved.turn_deg, "sigma_turn_deg": moved.turn_sigma_deg}
            row |= {"drift_m": moved.drift_m, "displaced_pairs": moved.n}
            rows.append(row | found.kinds().to_dict())
        return pd.DataFrame(rows)

    def parts(self) -> pd.DataFrame:
        """Return what each distance is made of, with intervals: see :meth:`LHD.split`."""
        tables = [
            found.split(truth=self.truth.get(names)).assign(comparison="-".join(names))
            for names, found in self.results.items()
        ]
        columns = ["comparison", "part", "value_m", "low_m", "high_m"]
        return pd.concat(tables, ignore_index=True)[columns]

    def verdicts(self, test: str, model: str) -> pd.DataFrame:
        """Return a row for each pair of a comparison: segments, distance, ``verdict``.

        With the truth: right, wrong or missed. Without: paired, or several partners.
        """
        found = self.results[test, model]
        pairs, truth = found.test_model.pairs, self.truth.get((test, model))
        rows, columns = np.nonzero(pairs if truth is None else pairs | truth)
        if truth is None:
            several = (pairs.sum(axis=1) > 1)[rows] | (pairs.sum(axis=0) > 1)[columns]
            verdict = np.where(several, "several partners", "paired")
        else:
            right = np.where(truth[rows, columns], "right", "wrong")
            verdict = np.where(pairs[rows, columns], right, "missed")
        distances = distance_matrix(found.test, found.model, weight=found.weight)[rows, columns]
        table = {"test_segment": rows, "model_segment": columns}
        return pd.DataFrame(table | {"distance_m": distances, "verdict": verdict})

    def coloured(self, test: str, model: str) -> list[tuple[np.ndarray, str]]:
        """Return pairs (ends (n, 2, 3), colour) of a comparison: all lines, then the paired ones.

        Model lines are grey, test lines black; those of pairs have the colour of the verdict.
        """
        found = self.results[test, model]
        parts = [(found.model.ends, "#b0b0b0"), (found.test.ends, "#000000")]
        for verdict, rows in self.verdicts(test, model).groupby("verdict"):
            both = found.test.ends[rows["test_segment"]], found.model.ends[rows["model_segment"]]
            parts.append((np.concatenate(both), VERDICTS[verdict]))
        return parts

    def plot(
        self, *, ax: Axes | None = None, test: str | None = None, model: str | None = None
    ) -> Axes:
        """Draw a comparison (the first if none is named) from above, pairs coloured by verdict."""
        from mmqa_lab import plots

        names = (test, model) if test else next(iter(self.results))
        ax = plots.subplots(width="double", height_mm=100)[1] if ax is None else ax
        for ends, colour in self.coloured(*names):
            ax.plot(*ends[..., :2].T, ".-", ms=3, color=colour)
        for verdict, rows in self.verdicts(*names).groupby("verdict"):
            ax.plot([], [], color=VERDICTS[verdict], label=f"{verdict} ({len(rows)})")
        ax.plot([], [], color="#000000", label=f"{names[0]}, no pair")
        ax.plot([], [], color="#b0b0b0", label=f"{names[1]}, no pair")
        ax.set(xlabel="easting (m)", ylabel="northing (m)", aspect="equal")
        ax.set_title(" - ".join(names))
        ax.legend(loc="upper left", bbox_to_anchor=(1, 1), frameon=False)
        return ax

    def _kind(self, names):
        return "absolute" if self.reference in names else "repeatability"

    def _errors(self, names, pairs):
        """What is wrong with pairs (test, model), where it is known."""
        if names not in self.truth:
            columns = ("true_pairs", "false_negative", "false_positive", "rate_percent", "f1")
            return dict.fromkeys(columns, np.nan)
        truth = self.truth[names]
        scores = pairing_scores(pairs, truth)
        errors = {"true_pairs": truth.sum(), "false_negative": scores.fn}
        errors |= {"false_positive": scores.fp, "rate_percent": 100 * scores.detection_rate}
        return errors | {"f1": scores.f1}


def study(
    clouds: Mapping[str, Any] | Sequence[Any],
    *,
    reference: Cloud | ArrayLike | Segments | str | os.PathLike | None = None,
    truth: pd.DataFrame | str | os.PathLike | Mapping[tuple[str, str], ArrayLike] | None = None,
    settings: Mapping[str, Any] | str | os.PathLike | None = None,
) -> Study:
    """Compare the edges of several clouds with each other and with a reference, both ways.

    Parameters
    ----------
    clouds : dict or list
        Two or more clouds or sets of segments (one, if a reference is given), with their names: a
        Cloud, an array of points (n, 3), Segments, or a path of a file of either. Edges are
        extracted once per cloud. Items of a list are named after their files.
    reference : cloud, Segments or path, optional
        The model of the absolute comparisons; its name is that of its file, else ``reference``.
    truth : DataFrame, path of a CSV file, or dict, optional
        True pairs: columns ``test_set``, ``model_set``, ``test_segment``, ``model_segment`` with
        the numbers of segments counted from 0; or Boolean arrays (p, q) by (test, model).
        Comparisons that are not in it have no truth.
    settings : dict or path of a JSON file, optional
        Settings of :func:`extract_edges` and :func:`lhd`; those of one cloud in a dict under its
        name.

    Returns
    -------
    Study

    Raises
    ------
    ValueError
        If there are fewer than two sets, a cloud shows no edges, two sets have no common edges,
        or names, settings or numbers of segments are wrong.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), Tables 1 and 2.

    Examples
    --------
    >>> from mmqa_lab.simulate.canyon import canyon
    >>> scene = canyon(1)
    >>> courses = {name: scene.surveys[name].segments for name in ("C1", "C3")}
    >>> true = {("C1", "C3"): scene.pairs("C1", "C3")}
    >>> found = study(courses, reference=scene.surveys["TLS"].segments, truth=true)
    >>> found.to_frame()["direction"].tolist()[:3]
    ['C1 to C3', 'C3 to C1', 'C1 to TLS']
    """
    sources, reference = _named(clouds, reference)
    settings = _settings(settings, sources)
    common = {name: value for name, value in settings.items() if name not in sources}
    sets, edges = {}, {}
    for name, source in sources.items():
        own = common | settings.get(name, {})
        chosen = {key: value for key, value in own.items() if key in EXTRACTION}
        sets[name], edges[name] = _segments(name, source, chosen)
    pairs = sorted(combinations(sets, 2), key=lambda names: reference in names)
    truth = _truth(truth, sets, pairs)
    choices = {key: value for key, value in common.items() if key in COMPARISON}
    radius = choices.get("radius", 4.0)
    results, displacements = {}, {}
    for names in pairs:
        test, model = (sets[name] for name in names)
        _refuse_strangers(names, test, model, radius)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            results[names] = lhd(test, model, **choices)
            displacements[names] = match_displaced(test, model, radius=radius).displacement
            if np.isnan(displacements[names].vector).any():
                said = "No displacement: too few lines, or lines of one direction, agree on one."
                warnings.warn(said, stacklevel=2)
            ways = results[names].test_model, results[names].model_test
            paired = min(way.coverage for way in ways)
            if paired < LEAST_COVERAGE:
                said = (
                    f"The distance is that of {paired:.0%} of the length of the lines; the others"
                )
                warnings.warn(f"{said} have no partner within the threshold.", stacklevel=2)
        for said in caught:
            warnings.warn(f"{'-'.join(names)}: {said.message}", stacklevel=2)
    edges = {name: found for name, found in edges.items() if found is not None}
    return Study(sets, edges, reference, results, displacements, truth)


def _named(clouds, reference):
    """All sources by their names, the reference last, and its name."""
    if not isinstance(clouds, Mapping):
        named = {}
        for number, cloud in enumerate(clouds, start=1):
            named[_name(cloud, f"set {number}", named)] = cloud
        clouds = named
    sources, name = dict(clouds), None
    if reference is not None:
        name = _name(reference, "reference", sources)
        sources[name] = reference
    if len(sources) < 2:
        raise ValueError(f"Invalid study of {len(sources)} sets. Must be two or more.")
    return sources, name


def _name(source, otherwise, taken):
    """What a file, a cloud or a set of segments is called; with a number where that is taken."""
    is_file = isinstance(source, str | os.PathLike)
    name = Path(source).stem if is_file else getattr(source, "name", "") or otherwise
    return name if name not in taken else f"{name}_{len(taken) + 1}"


def read_settings(source):
    """The settings of a study as a dict, from a JSON file where a path is given."""
    if isinstance(source, str | os.PathLike):
        try:
            source = json.loads(Path(source).read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise ValueError(f"Invalid settings {source}. Must be a JSON file.") from error
    if not isinstance(source or {}, Mapping):
        raise ValueError(f"Invalid settings {source!r}. Must be names with values.")
    return dict(source or {})


def _settings(settings, sources):
    """Checked settings: known names, those of one cloud under its own."""
    settings = read_settings(settings)
    known = {*EXTRACTION, *COMPARISON}
    for name, value in settings.items():
        own = value if name in sources and isinstance(value, Mapping) else {}
        wrong = [key for key in own if key not in EXTRACTION]
        if wrong or not (name in known or (isinstance(value, Mapping) and name in sources)):
            raise ValueError(
                f"Invalid setting {(wrong or [name])[0]!r}. Must be one of {', '.join(EXTRACTION)} "
                f"(also for one of the clouds {', '.join(sources)}), {', '.join(COMPARISON)}."
            )
    return settings


def _segments(name, source, choices):
    """The segments of a source, and the edges that they are where it is a cloud."""
    if isinstance(source, str | os.PathLike) and Path(source).suffix.lower() in LINE_ENDINGS:
        from mmqa_lab.io import read_segments

        source = read_segments(source)
    if isinstance(source, Segments):
        found, edges = source, None
    else:
        edges = extract_edges(source, **choices)
        found = edges.segments
    if not len(found):
        what = "no segments" if edges is None else "no edges between planes"
        raise ValueError(f"Invalid {name}: {what}. Must have some.")
    return Segments(found.ends, name=name), edges


def _refuse_strangers(names, test, model, radius):
    """Raise when no segment of one set is within reach of any of the other."""
    radius = check_number(radius, "radius", low=0, unit="m")
    nearest = distance_matrix(test, model, weight=0, within="overlap").min()
    if nearest > radius:
        raise ValueError(
            f"Invalid {names[0]} and {names[1]}: no common edges, the nearest are {nearest:.1f} m "
            f"apart. Must have edges within {radius:g} m of each other, in one coordinate system."
        )


def _truth(truth, sets, pairs):
    """True pairs as Boolean arrays by (test, model)."""
    if truth is None:
        return {}
    if isinstance(truth, Mapping):
        for names, matrix in truth.items():
            shape = tuple(len(sets[name]) for name in names) if names in pairs else None
            if np.shape(matrix) != shape:
                raise ValueError(
                    f"Invalid truth of shape {np.shape(matrix)} for {names}. "
                    f"Must be {shape} for one of {pairs}."
                )
        return {names: np.asarray(matrix, dtype=bool) for names, matrix in truth.items()}
    if not isinstance(truth, pd.DataFrame):
        from mmqa_lab.io.tables import read_table

        truth = read_table(truth, "truth", dtype={"test_set": str, "model_set": str})
    check_columns(truth, TRUTH_COLUMNS, "truth")
    if not len(truth):
        raise ValueError("Invalid truth of 0 pairs. Must have one or more.")
    found = {}
    for row, (a, b, i, j) in enumerate(truth[TRUTH_COLUMNS].itertuples(index=False), start=1):
        names = (a, b) if (a, b) in pairs else (b, a)
        if names not in pairs:
            raise ValueError(
                f"Invalid truth {a!r}, {b!r} in row {row}. Must be two of {', '.join(sets)}."
            )
        cell = (i, j) if names == (a, b) else (j, i)
        for name, number in zip(names, cell, strict=True):
            if number not in range(len(sets[name])):
                raise ValueError(
                    f"Invalid truth: segment {number} of {name} in row {row}. "
                    f"Must be a whole number from 0 to {len(sets[name]) - 1}."
                )
        shape = tuple(len(sets[name]) for name in names)
        found.setdefault(names, np.zeros(shape, dtype=bool))[tuple(map(int, cell))] = True
    return found


def write_report(found, folder):
    """Write all files of a :class:`Study`, each whole or not at all; return their names.

    None is written before all could be made: the page, tables, pictures, the edges of every set,
    and for each comparison its matrix and its pairs.
    """
    from mmqa_lab.io import write_atomically

    files = {"directions.csv": found.to_frame(), "comparisons.csv": found.comparisons()}
    files["parts.csv"] = parts = found.parts()
    for name, one in found.sets.items():
        columns = ["x1", "y1", "z1", "x2", "y2", "z2"]
        files[f"{name}_edges.csv"] = pd.DataFrame(one.ends.reshape(-1, 6), columns=columns)
    for names, result in found.results.items():
        distances = distance_matrix(result.test, result.model, weight=result.weight)
        files[f"{'-'.join(names)}_matrix_m.csv"] = pd.DataFrame(distances)
        files[f"{'-'.join(names)}_pairs.csv"] = found.verdicts(*names)
    files = {name: table.to_csv(index=False).encode() for name, table in files.items()}
    files |= {f"{draw.__name__}.png": _picture(draw, found) for draw in DRAWINGS}
    files["index.html"] = _page(found, parts, files).encode()
    for name, content in files.items():
        write_atomically(
            Path(folder) / name, lambda file, content=content: file.write_bytes(content)
        )
    return list(files)


def _page(found, parts, files):
    """The page: tables, pictures, a view that can be turned, links."""
    from jinja2 import Environment, PackageLoader

    loader = PackageLoader("mmqa_lab", "run/templates")
    page = Environment(loader=loader, autoescape=True).get_template("lines.html")
    compared = found.comparisons().set_index("comparison").T
    compared = compared.rename_axis(columns=None).reset_index(names="comparison")
    tables = {"Both directions": found.to_frame(), "Comparisons": compared}
    tables["What the distances are made of"] = parts
    shown = {
        title: table.dropna(axis=1, how="all").to_html(
            index=False, float_format="{:.4g}".format, border=0, na_rep=""
        )
        for title, table in tables.items()
    }
    figures = {f"{draw.__name__}.png": draw.__doc__ for draw in DRAWINGS}
    scenes = json.dumps(_scenes(found))
    return page.render(tables=shown, figures=figures, files=sorted(files), scenes=scenes)


def _scenes(found):
    """For each comparison: lines (x, y, z, x, y, z, colour) about their middle, cm resolution."""
    scenes = {}
    for names, result in found.results.items():
        origin = result.model.midpoints.mean(axis=0)
        scenes["-".join(names)] = [
            [*row, colour]
            for ends, colour in found.coloured(*names)
            for row in (ends - origin).reshape(-1, 6).round(2).tolist()
        ]
    return scenes


def _picture(draw, found):
    """A figure with a panel for each comparison as PNG."""
    from mmqa_lab import plots

    columns = 1 if draw is pairs else min(3, len(found.results))
    rows = -(-len(found.results) // columns)
    height = rows * (90 if columns == 1 else 60)
    picture = io.BytesIO()
    with plots.style():
        size = {"width": "double", "height_mm": height}
        figure, axes = plots.subplots(rows, columns, squeeze=False, **size)
        for ax in axes.flat[len(found.results) :]:
            ax.set_axis_off()
        for ax, names in zip(axes.flat, found.results, strict=False):
            draw(ax, found, names)
        figure.savefig(picture, format="png", dpi=150)
        plots.plt.close(figure)
    return picture.getvalue()


def matrices(ax, found, names):
    """Similarity matrices: the distance of every test to every model segment."""
    result = found.results[names]
    distances = distance_matrix(result.test, result.model, weight=result.weight)
    image = ax.imshow(np.log10(np.maximum(distances, 1e-3)), cmap="gray", aspect="auto")
    ax.set(title=" - ".join(names), xlabel=f"segment of {names[1]}", ylabel=f"of {names[0]}")
    ax.figure.colorbar(image, ax=ax, label="log10 of distance (m)")


def thresholds(ax, found, names):
    """Sorted nearest distances, their second differences, and the threshold."""
    threshold = found.results[names].test_model.threshold
    ax.plot(threshold.nearest, "k.-", ms=3, label="nearest distance")
    ax.plot(np.diff(threshold.nearest, 2), color="#CC79A7", label="second difference")
    if np.isfinite(threshold.delta):
        ax.axhline(threshold.delta, color="#D55E00", ls="--", label=f"{threshold.delta:.2f} m")
        ax.set_ylim(-2 * threshold.delta, 6 * threshold.delta)
    ax.set(title=" to ".join(names), xlabel="segment", ylabel="metres")
    ax.legend()


def pairs(ax, found, names):
    """Lines from above, coloured by the verdict on their pairs; dots are upright lines."""
    found.plot(ax=ax, test=names[0], model=names[1])


DRAWINGS = matrices, thresholds, pairs
"""The pictures of the report, each named by its function and explained by its docstring."""
