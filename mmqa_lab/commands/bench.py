"""Methods compared on the cases of a study."""

import importlib
import sys
from pathlib import Path

from mmqa_lab.commands import OUTPUT, Lazy, command, option, switch
from mmqa_lab.commands._output import print_rows, write_figure

pd = Lazy("pandas")
bench = Lazy("mmqa_lab.bench")
io = Lazy("mmqa_lab.io")
plots = Lazy("mmqa_lab.plots")

METHODS = {"action": "append", "default": []}


@command(
    "compare methods, yours too, on the cases of a study",
    option("study", "STUDY", "stem of a study, such as poles"),
    option(
        "--method", "MODULE:FUNCTION", "a method of your own; may be given several times", **METHODS
    ),
    switch("--quick", "few cases, for a first look"),
    option("--out", "FOLDER", "write results, tables and figures there", Path),
    *OUTPUT,
    examples=(
        "poles --method my_module:my_detector --out folder",
        "anisotropy --method mine:ratio --method mine:entropy --quick --json",
    ),
)
def bench_(options):
    """Run a study's comparison of methods, with methods of your own among them.

    STUDY is the stem of a study. A method is a function of the study's data, named by its module, a
    file of the current directory or anything that can be imported: MODULE:FUNCTION. It enters the
    study's tables and figures as one more row. The table printed has a row for each method and
    figure: the mean over all cases and seeds with its 95 % interval, n cells measured, missing
    cells not. A method that fails in some cells goes on in the others; failures.csv has its
    reasons.
    """
    out = options.out
    if out is not None and out.exists() and not out.is_dir():
        raise ValueError(f"Invalid folder {out}: a file. Must be a folder.")
    comparison = _comparison(options.study, options.quick)
    for text in options.method:
        _add(comparison.methods, text)
    results = comparison.run()
    if out is not None:
        _write(comparison, results, out)
    print_rows(_means(results), options)


def _comparison(stem, quick):
    """The comparison of a study."""
    from mmqa_lab.studies import chosen

    study = chosen([stem])[0]
    if callable(getattr(study.module, "bench", None)):  # the study's own definition, three seeds for a quick look
        return study.module.bench(**({"seeds": range(3)} if quick else {}))
    if not hasattr(study.module, "comparison"):
        raise ValueError(f"Invalid study {stem!r}: it compares no methods. Must have a comparison.")
    return study.module.comparison(quick=quick)


def _add(methods, text):
    """Put the function that a text names among the methods."""
    module, colon, name = text.partition(":")
    if not (module and colon and name):
        raise ValueError(f"Invalid method {text!r}. Must be MODULE:FUNCTION.")
    if name in methods:
        raise ValueError(f"Invalid method {text!r}: {name} is in the study. Must have a new name.")
    if str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))
    try:
        function = getattr(importlib.import_module(module), name, None)
    except (Exception, SystemExit) as error:
        raise ValueError(
            f"Invalid method {text!r}: {type(error).__name__}: {error}. Must be in a module that "
            "can be imported."
        ) from error
    if function is None:
        raise ValueError(f"Invalid method {text!r}: no {name} in {module}. Must be a function.")
    if not callable(function):
        raise TypeError(f"Invalid method {text!r}: not callable. Must be a function.")
    methods[name] = function


def _means(results):
    """A row for each method and figure."""
    parts = []
    for figure in bench.figure_names(results):
        part = bench.summary(results, figure)
        part.columns = ["method", "mean", "low", "high", "n", "missing"]
        part.insert(1, "figure", figure)
        parts.append(part)
    columns = ["method", "figure", "mean", "low", "high", "n", "missing"]
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=columns)


def _write(comparison, results, out):
    """Write the results, the study's tables and figures, and what failed."""
    io.write_atomically(out / "results.nc", results.to_netcdf)
    own = comparison.tables(results) if comparison.tables else {"means": _means(results)}
    for name, table in {**own, "failures": bench.failures(results)}.items():
        indexed = any(table.index.names)
        text = table.to_csv(index=indexed)
        io.write_atomically(out / f"{name}.csv", lambda path, text=text: path.write_text(text))
    if comparison.figures is None:
        return
    with plots.style():
        for name, figure in comparison.figures(results).items():
            for ending in ("png", "svg"):
                write_figure(out / f"{name}.{ending}", figure, title=name)
