"""The bench against loops, ranks and intervals made here."""

import itertools
import math
import re
import warnings
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from distributed import Client
from IPython.core.interactiveshell import InteractiveShell
from scipy import stats

from mmqa_lab import bench
from mmqa_lab.__main__ import main
from mmqa_lab.studies import lhd_weight


def noisy(sigma, count, seed):
    """Normal numbers, with sigma as their truth."""
    return np.random.default_rng([seed, count]).normal(0, sigma, count), sigma


def mad(x):
    return 1.4826 * np.median(np.abs(x - np.median(x)))


METHODS = {"std": np.std, "mad": mad}
CASES = bench.grid(sigma=(1.0, 2.0, 5.0), count=(10, 30))


@pytest.fixture
def results():
    return bench.run(CASES, METHODS, make=noisy, seeds=range(4))


def quietly(*arguments, **options):
    """A run whose failures are meant."""
    with warnings.catch_warnings(action="ignore", category=UserWarning):
        return bench.run(*arguments, **options)


# Cases


@pytest.mark.parametrize("form", [list, pd.DataFrame])
def test_cases_that_are_no_full_grid_stand_in_a_row(form):
    cases = [{"a": 1, "b": "x"}, {"a": 2, "b": "x"}, {"a": 2, "b": "y"}]
    found = bench.run(form(cases), {"a": lambda d: d[0]}, make=lambda a, b, seed: [a, b])
    assert found["value"].dims == ("method", "case", "seed")
    assert found["a"].values.tolist() == [1, 2, 2]
    assert found["b"].values.tolist() == ["x", "x", "y"]
    assert found["value"].values.ravel().tolist() == [1, 2, 2]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"cases": []}, "Invalid bench of 0 cases, 1 methods"),
        ({"cases": [{"a": 1}, {"b": 1}]}, "Invalid case {'b': 1}. Must have a."),
        ({"seeds": (1, 1)}, "seeds [1, 1]. Must have some of each, and different"),
    ],
)
def test_what_cannot_be_run_is_refused(change, sentence):
    whole = {"cases": [{"a": 1}], "methods": {"a": len}, "make": lambda a, seed: a} | change
    with pytest.raises(ValueError, match=re.escape(sentence)):
        bench.run(**whole)


# The loop


@pytest.mark.parametrize("cases", [CASES, [CASES[k] for k in (4, 0, 5, 2, 1, 3)]])
def test_run_is_the_loop(cases):
    results = bench.run(cases, METHODS, make=noisy, seeds=range(4))
    assert results["value"].dims == ("method", "sigma", "count", "seed")
    for (name, method), case, seed in itertools.product(METHODS.items(), CASES, range(4)):
        data, truth = noisy(**case, seed=seed)
        cell = results.sel({"method": name, "seed": seed, **case})
        assert cell["value"].item() == method(data)
        assert cell["truth"].item() == truth
    assert (results["failure"] == "").all()


def test_make_is_called_once_and_each_method_gets_its_own_copy():
    calls = []

    def make(n, seed):
        calls.append((n, seed))
        return np.full(3, float(n))

    def greedy(x):
        x *= 0
        return x.sum()

    found = bench.run(bench.grid(n=(1, 2)), {"greedy": greedy, "sum": np.sum}, make=make)
    assert calls == [(1, 0), (2, 0)]
    assert found["value"].sel({"method": "sum"}).values.ravel().tolist() == [3, 6]


def test_score_turns_results_into_figures_with_units():
    def score(result, truth):
        return {"error_mm": result - truth["height_mm"], "hits": True}

    found = bench.run(
        bench.grid(n=(1, 2)),
        {"low": lambda n: n},
        make=lambda n, seed: (n, {"height_mm": n + 1, "note": "free text"}),
        score=score,
    )
    assert found["error_mm"].values.ravel().tolist() == [-1, -1]
    assert found["error_mm"].attrs["units"] == found["truth_height_mm"].attrs["units"] == "mm"
    assert set(found.data_vars) == {"error_mm", "hits", "truth_height_mm", "failure"}


# Failures


def raises(x):
    raise RuntimeError("no\n  signal")


def leaves(x):
    raise SystemExit(3)


class Taking:
    """A method that takes two things."""

    def __call__(self, x, y):
        return x


MUST = "Must be finite numbers (line N of <lambda>)."
NEEDS = "missing 1 required positional argument: 'y'"
BAD = {
    "raises": (raises, "RuntimeError: no signal (line N of raises)"),
    "leaves": (leaves, "SystemExit: 3 (line N of leaves)"),
    "two": (
        lambda x, y: x,
        "TypeError: <lambda>() missing 1 required positional argument: 'y' (line N of <lambda>)",
    ),
    "nan": (lambda x: math.nan, f"value is nan. {MUST}"),
    "text": (lambda x: "3", f"value is of type str. {MUST}"),
    "array": (
        lambda x: np.ones((2, 1)),
        "value is of type ndarray. Must be finite numbers (line N of <lambda>).",
    ),
    "ragged": (
        lambda x: [[1], [1, 2]],
        "value is of type list. Must be finite numbers (line N of <lambda>).",
    ),
    "nothing": (lambda x: None, "TypeError: nothing is returned (line N of <lambda>)"),
    "part": (
        partial(lambda x, y, z: x, 1),
        f"TypeError: <lambda>() {NEEDS.replace('y', 'z')} (line N of <lambda>)",
    ),
    "object": (Taking(), f"TypeError: Taking.__call__() {NEEDS} (line N of __call__)"),
    "empty": (lambda x: {}, f"the dict is empty. {MUST}"),
    "taken": (
        lambda x: {"count": 3},
        "count is a name that the results need for something else. Must be finite numbers "
        "(line N of <lambda>).",
    ),
}


def test_each_failure_costs_its_own_cells_and_one_sentence():
    methods = {"std": np.std} | {name: method for name, (method, _) in BAD.items()}
    with pytest.warns(UserWarning, match="cells not measured") as said:
        found = bench.run(CASES, methods, make=noisy, seeds=(0, 1))
    assert len(said) == len(BAD)
    assert str(said[0].message).startswith(
        "raises: 12 of 12 cells not measured; the first: RuntimeError: no signal (line "
    )
    assert np.isfinite(found["value"].sel({"method": "std"})).all()
    assert found["value"].sel({"method": list(BAD)}).isnull().all()
    table = bench.failures(found)
    assert table["method"].tolist() == list(BAD)
    reasons = table["reason"].str.replace(r"line \d+", "line N", regex=True)
    assert reasons.tolist() == [reason for _, reason in BAD.values()]
    assert (table["count"] == 12).all()
    assert (table["first_case"] == "sigma=1.0, count=10, seed=0").all()


def test_figures_that_a_method_leaves_out_are_named_in_one_order():
    names = ["zeta", "beta", "eta", "alpha", "theta", "gamma"]
    found = quietly(
        bench.grid(n=(0, 1)),
        {"m": lambda n: {"value": 1.0} | dict.fromkeys(names[: 6 * n], 2.0)},
        make=lambda n, seed: n,
    )
    (reason,) = bench.failures(found)["reason"]
    assert reason == f"{', '.join(sorted(names))}: nothing is returned."


def test_a_make_that_fails_costs_its_case_for_all_methods():
    def make(n, seed):
        return 1 / (n - 2)

    found = quietly(bench.grid(n=(1, 2, 3)), {"a": lambda x: x, "b": lambda x: -x}, make=make)
    assert found["value"].sel(n=2).isnull().all()
    assert found["value"].notnull().sum() == 4
    (reason,) = bench.failures(found)["reason"].unique()
    assert re.fullmatch(r"ZeroDivisionError: division by zero \(line \d+ of make\)", reason)


# Processes


def test_executors_give_the_same_bits_as_one_process():
    def product(x):
        return {"sum": float((np.outer(x, x) @ np.outer(x, x)).sum()), "std": x.std()}

    methods = {"product": product, "local": lambda x: np.exp(x).mean(), "raises": raises}
    here = quietly(CASES, methods, make=noisy, seeds=(0, 1))
    with ProcessPoolExecutor(2) as pool:
        assert quietly(CASES, methods, make=noisy, seeds=(0, 1), executor=pool).identical(here)
    with Client(processes=False, dashboard_address=None) as client:
        pool = client.get_executor()
        assert quietly(CASES, methods, make=noisy, seeds=(0, 1), executor=pool).identical(here)


def test_plot_shows_each_method_with_its_interval(results):
    figure = bench.plot(results, own=[str(results["method"].values[-1])])
    marks = [line for line in figure.axes[0].get_lines() if line.get_marker() in "oD"]
    means = bench.summary(results)["mean"]
    assert [line.get_xdata()[0] for line in marks] == pytest.approx(means.tolist())
    assert [line.get_marker() for line in marks][-1] == "D"


# Tables


def test_summary_is_the_t_interval(results):
    table = bench.summary(results, by="sigma").set_index(["method", "sigma"])
    for (method, sigma), row in table.iterrows():
        values = results["value"].sel({"method": method, "sigma": sigma}).values.ravel()
        interval = stats.ttest_1samp(values, 0).confidence_interval(0.95)
        assert row["mean"] == pytest.approx(values.mean())
        assert (row["low"], row["high"]) == pytest.approx((interval.low, interval.high))
        assert (row["n"], row["missing"]) == (8, 0)


def test_summary_counts_what_is_missing():
    def method(n):
        return {"error_mm": n if n < 3 else math.nan}

    found = quietly(bench.grid(n=range(5)), {"m": method}, make=lambda n, seed: n)
    row = bench.summary(found).iloc[0]
    assert (row["mean_mm"], row["n"], row["missing"]) == (1, 3, 2)
    single = bench.summary(found, "error_mm", by="n")
    assert np.isnan(single["low_mm"]).all()
    with pytest.raises(ValueError, match="Invalid figure 'error'"):
        bench.summary(found, "error")


def test_compare_is_the_paired_interval(results):
    row = bench.compare(results, reference="std").iloc[0]
    parts = [results["value"].sel({"method": name}).values.ravel() for name in ("mad", "std")]
    test = stats.ttest_rel(*parts)
    interval = test.confidence_interval(0.95)
    assert row["difference"] == pytest.approx(np.mean(parts[0] - parts[1]))
    assert (row["low"], row["high"]) == pytest.approx((interval.low, interval.high))
    assert row["better_share"] == np.mean(parts[0] < parts[1])
    higher = bench.compare(results, reference="std", better="higher").iloc[0]
    assert higher["better_share"] == np.mean(parts[0] > parts[1])


def test_compare_pairs_only_what_both_measured():
    methods = {"all": lambda n: n, "some": lambda n: n + 1 if n else math.nan}
    found = quietly(bench.grid(n=range(4)), methods, make=lambda n, seed: n)
    row = bench.compare(found, reference="all").iloc[0]
    assert (row["difference"], row["n"], row["missing"], row["better_share"]) == (1, 3, 1, 0)
    with pytest.raises(ValueError, match="Invalid reference 'none'"):
        bench.compare(found, reference="none")


def test_rank_is_spearman_with_the_truth(results):
    by_truth, by_parameter = bench.rank(results, "truth"), bench.rank(results, "sigma")
    pd.testing.assert_frame_equal(by_truth, by_parameter)
    for row in by_truth.itertuples():
        values = results["value"].sel({"method": row.method})
        sigma = results["truth"].broadcast_like(values)
        expected = stats.spearmanr(values.values.ravel(), sigma.values.ravel()).statistic
        assert row.spearman == pytest.approx(expected)
        assert row.low <= row.spearman <= row.high
        assert row.n == 24
    best, other = by_truth.itertuples()
    assert (best.behind_best, best.behind_low, best.behind_high) == (0, 0, 0)
    assert other.behind_best == pytest.approx(best.spearman - other.spearman)


def test_rank_resamples_whole_cases_the_same_for_all_methods():
    methods = {"a": lambda x: x, "twin": lambda x: 10 * x, "falling": lambda x: -x}

    def make(n, seed):
        return n + np.random.default_rng(seed + 100 * n).normal(0, 3)

    found = bench.run(bench.grid(n=range(10)), methods, make=make, seeds=range(5))
    table = bench.rank(found, "n").set_index("method")
    assert (table[["behind_best", "behind_low", "behind_high"]].abs() < 1e-12).all(axis=None)
    assert table.loc["falling", "spearman"] == pytest.approx(-table.loc["a", "spearman"])
    values = found["value"].sel({"method": "a"}).values[:, :]
    rng, drawn = np.random.default_rng(5), []
    for _ in range(600):
        pick = rng.integers(10, size=10)
        drawn.append(stats.spearmanr(values[pick].ravel(), np.repeat(pick, 5)).statistic)
    low, high = np.percentile(drawn, (2.5, 97.5))
    assert table.loc["a", ["low", "high"]].tolist() == pytest.approx([low, high], abs=0.05)


def test_rank_takes_what_a_method_measured():
    methods = {"part": lambda n: n if n < 3 else math.nan, "flat": lambda n: 1}
    found = quietly(bench.grid(n=range(6)), methods, make=lambda n, seed: n)
    table = bench.rank(found, "n").set_index("method")
    assert table.loc["part", ["spearman", "n", "missing"]].tolist() == [1, 3, 3]
    assert np.isnan(table.loc["flat", "spearman"])
    with pytest.raises(ValueError, match="Invalid truth 'none'"):
        bench.rank(found, "none")


# The command


RESEARCHER = """
import numpy as np

def spread(x):
    return np.ptp(x)

def std(x):
    return 0

def upset(x):
    raise ValueError("no signal")

def words(x):
    return "3"
"""


def small(seeds=(0, 1)):
    """A study of two methods."""
    tables = {"tables": lambda results: {"ranks": bench.rank(results, "sigma")}}
    return bench.Comparison(CASES, dict(METHODS), noisy, None, seeds, **tables)


@pytest.fixture
def call(tmp_path, monkeypatch, capsys):
    """A call of the command in a folder with a researcher's module: status, output, sentences."""
    monkeypatch.setattr(lhd_weight, "bench", small)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "researcher.py").write_text(RESEARCHER)

    def run(line):
        return main(["bench", "lhd_weight", *line.split()]), *capsys.readouterr()

    return run


def test_command_ranks_ones_own_method_and_names_its_files(call, tmp_path):
    status, out, err = call("--method researcher:spread --out out --csv rows.csv")
    assert status == 0
    assert out.split()[:2] == ["method", "spearman"]
    assert set(pd.read_csv("rows.csv")["method"]) == {"std", "mad", "spread"}
    written = {path.name for path in (tmp_path / "out").glob("[!.]*")}
    tables = {"ranks.csv", "cells.csv", "failures.csv", "summary.csv"}
    assert written == tables | {"methods.pdf", "methods.png", "methods.svg"}
    assert all(name in err for name in written)


def test_command_says_what_failed_and_goes_on_or_raises(call):
    status, out, err = call("--method researcher:upset --quick")
    assert status == 0
    assert err == ""
    said, reason = " ".join(out.split()), "ValueError: no signal (line 11 of upset)"
    assert f"upset: 18 of 18 cells not measured; the first: {reason}" in said
    assert f"upset: {reason}" in said
    with pytest.raises(ValueError, match="no signal"):
        call("--method researcher:upset --raise")
    _, out, _ = call("--method researcher:words --quick")
    assert "words: value is of type str. Must be finite numbers (line 13 of words)." in out


SAID = {
    "words": ("return 'x'", "value is of type str. Must be finite numbers (line 1 of mine)."),
    "raising": ("raise ValueError('no signal')", "ValueError: no signal (line 2 of mine)"),
    "signature": (None, "missing 1 required positional argument: 'y' (line 1 of mine)"),
    "slow and nothing": ("sum(range(10**5))", "TypeError: nothing is returned (line 1 of mine)"),
}


@pytest.mark.parametrize(("body", "reason"), SAID.values(), ids=SAID)
def test_a_notebooks_table_names_what_failed_with_its_line(body, reason):
    shell = InteractiveShell()
    shell.run_cell(f"def mine(x):\n    {body}" if body else "def mine(x, y):\n    return x")
    found = quietly(CASES, {"std": np.std, "mine": shell.user_ns["mine"]}, make=noisy)
    tables = [
        bench.summary(found, "value"),
        bench.summary(found, "value", by="sigma"),
        bench.rank(found, "sigma", "value"),
        bench.compare(found, "value", reference="std"),
        bench.remarked(pd.DataFrame({"method": ["std"]}), found),
    ]
    for table in tables:
        assert reason in shell.display_formatter.format(table.round(2))[0]["text/html"]
    assert "remarks" not in bench.summary(found.sel({"method": ["std"]}), "value")
    found["failure"][{"method": 1, "sigma": 0}] = ""  # with some cells it has its figures
    assert "remarks" not in bench.summary(found, "value")


def test_a_failing_method_is_named_where_the_answer_has_no_row_for_it(call, monkeypatch):
    tables = {"tables": lambda results: {"models": pd.DataFrame({"model": ["a", "b"]})}}
    study = bench.Comparison(CASES, dict(METHODS), noisy, None, (0, 1), **tables)
    monkeypatch.setattr(lhd_weight, "bench", lambda seeds: study)
    status, out, _ = call("--method researcher:upset --quick")
    assert status == 0
    assert "upset: 12 of 12 cells not measured; the first: ValueError: no signal (line 11" in out


@pytest.mark.parametrize(
    ("method", "sentence"),
    [
        ("researcher:np", "Must be MODULE:FUNCTION."),
        ("researcher:std", "Invalid method 'std': the study has it."),
    ],
)
def test_command_refuses_in_one_sentence(method, sentence, call):
    status, out, err = call(f"--method {method}")
    assert (status, out, len(err.splitlines())) == (2, "", 1)
    assert sentence in err


def test_a_method_stands_at_one_place_in_all_panels():
    tables = {
        "p": pd.DataFrame({"method": ["a", "b"], "p": [1.0, 2], "low": [0, 1], "high": [2, 3]}),
        "q": pd.DataFrame({"method": ["b", "a"], "q": [4.0, 3], "low": [3, 2], "high": [5, 4]}),
    }
    figure = bench.plot_tables(tables)
    names = [text.get_text() for text in figure.axes[0].get_yticklabels()]
    for ax, at in zip(figure.axes, ({"a": 1, "b": 2}, {"a": 3, "b": 4}), strict=True):
        marks = [line.get_xydata()[0] for line in ax.lines]
        assert {names[int(y)]: x for x, y in marks} == at
    plt.close(figure)


def test_a_part_of_the_results_has_a_table_and_its_failures_too():
    with warnings.catch_warnings(action="ignore"):
        results = bench.run([{"n": 3}], {"a": abs, "b": str}, make=lambda n, seed: n, seeds=(1, 2))
    assert len(bench.cell_table(results.sel({"method": "a"}))) == 2
    one = bench.failures(results.sel({"method": "b", "seed": 2}))
    assert one[["method", "count"]].values.tolist() == [["b", 1]]
    assert bench.summary(results.sel({"method": "a"}))["mean"].tolist() == [3]
    assert bench.compare(results.sel({"method": "a"}), reference="a").empty


def test_a_case_without_a_value_of_its_parameter_is_a_case():
    rng, tables = np.random.default_rng(3), []
    noise = rng.normal(size=(4, 3, 9))
    for last in (9.0, np.nan):
        cases = bench.grid(n=(1.0, 2.0, 3.0, last), s=range(3))
        rows = zip(cases, noise.reshape(12, 9), strict=True)
        drawn = {(str(one["n"]), one["s"]): row for one, row in rows}
        made = {"make": lambda n, s, seed, drawn=drawn: drawn[str(n), s] + s}
        results = bench.run(cases, {"mean": np.mean, "max": np.max}, **made)
        tables.append(bench.rank(results, "s"))
    pd.testing.assert_frame_equal(*tables)


def test_a_figure_that_a_method_leaves_out_once_has_a_reason():
    with pytest.warns(UserWarning, match="1 of 3 cells not measured; the first: v: nothing"):
        found = bench.run(
            bench.grid(n=(1, 2, 3)),
            {"a": lambda n: {"u": n} | ({} if n == 2 else {"v": n}), "b": lambda n: {"u": -n}},
            make=lambda n, seed: n,
        )
    assert bench.failures(found)[["method", "first_case"]].values.tolist() == [["a", "n=2, seed=0"]]
    assert found["u"].sel({"method": "a"}).values.ravel().tolist() == [1, 2, 3]
