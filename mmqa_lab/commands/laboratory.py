"""The commands of the laboratory: benches, studies, students' copies, notebooks and tests."""

import importlib
import os
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from mmqa_lab._progress import progress
from mmqa_lab.commands.machine import FIGURE_ENDINGS, app, table, write_figure

__all__ = ["bench", "lab", "paper", "student", "studies", "test"]


@table
def bench(
    study: str,
    /,
    *,
    method: list[str] | None = None,
    quick: bool = False,
    workers: int = 1,
    out: Path | None = None,
    raise_: Annotated[bool, Parameter("--raise")] = False,
):
    """Run a study's comparison of methods, with methods of your own among them.

    A method is a function of the study's data. It is measured on the same cases as the others and
    ranked with an interval. A case on which it fails is left out.

    Parameters
    ----------
    study
        Short name of the study, such as anisotropy.
    method
        Your own MODULE:FUNCTION, in a file of the current directory. May be given several times.
    quick
        Use few cases, for a first look.
    workers
        Number of processes.
    out
        Write results, tables and figures into this folder.
    raise_
        Stop where your method fails, and print the traceback.
    """
    from concurrent.futures import ProcessPoolExecutor
    from dataclasses import replace

    from mmqa_lab import bench
    from mmqa_lab._compiled import end_with_parent
    from mmqa_lab.io import own_folder
    from mmqa_lab.studies import chosen

    comparison = chosen([study])[0].bench(quick=quick)
    own = dict(named_function(text) for text in method or [])
    taken = own.keys() & comparison.methods.keys()
    if taken:
        raise ValueError(f"Invalid method {min(taken)!r}: the study has it. Must have a new name.")
    comparison.methods = {**comparison.methods, **own}
    with nullcontext() if out is None else own_folder(out):
        if raise_ and own:
            replace(comparison, methods=own, costs_cells=()).run()
        pool = ProcessPoolExecutor(workers, initializer=end_with_parent) if workers > 1 else None
        results = comparison.run(executor=pool)
        tables, drawn = _answers(comparison, results)
        answer = next(iter(tables.values()))
        if out is not None:
            kept = {"cells": bench.cell_table(results), "failures": bench.failures(results)}
            _write_bench(out, tables | kept, lambda: bench.plot_tables(drawn, own=[*own]))
    return bench.remarked(answer, results) if "method" in answer else answer


def _answers(comparison, results):
    """The tables of a comparison, its answer first, and those that are drawn."""
    import pandas as pd

    from mmqa_lab import bench

    figures = [name for name in comparison.figures if name in results]
    figures = figures or bench.figure_names(results)
    drawn = {name: bench.summary(results, name) for name in figures}
    names = ["method", "mean", "low", "high", "n", "missing"]
    rows = [
        part.iloc[:, :6].set_axis(names, axis=1).assign(figure=name) for name, part in drawn.items()
    ]
    tables = comparison.tables(results) if comparison.tables else {}
    tables["summary"] = pd.concat(rows, ignore_index=True)
    answer = next(iter(tables.values()))
    if comparison.tables and list(answer)[2:4] == ["low", "high"]:
        drawn = {answer.columns[1]: answer}
    return tables, drawn


def named_function(text):
    """Name and function of MODULE:FUNCTION, in the current directory."""
    module, _, name = text.partition(":")
    sys.path.insert(0, str(Path.cwd()))
    try:
        function = getattr(importlib.import_module(module), name)
        if not callable(function):
            raise TypeError(f"{name} is not callable")
    except (Exception, SystemExit) as error:  # the module of a reader may raise anything
        raise ValueError(
            f"Invalid method {text!r}: {type(error).__name__}: {error}. Must be MODULE:FUNCTION."
        ) from error
    return name, function


def _write_bench(folder, tables, draw):
    """Write the tables and the figure of a bench, and print the names of the files."""
    from mmqa_lab.io import write_atomically

    for name, one in tables.items():
        write_atomically(folder / f"{name}.csv", one)
    for ending in FIGURE_ENDINGS:
        write_figure(folder / f"methods{ending}", draw)
    written = [f"{name}.csv" for name in tables] + [f"methods{ending}" for ending in FIGURE_ENDINGS]
    print(f"{folder}: {', '.join(written)}", file=sys.stderr)


@app.command
def studies(
    names: Annotated[list[str] | None, Parameter()] = None,
    /,
    *,
    quick: bool = False,
    full: bool = False,
    workers: int | None = None,
    store: bool = False,
    out: Path | None = None,
    site: Path | None = None,
):
    """Run the studies: every notebook, without a screen, with tables, figures and pages.

    A run has the middle size: fewer cases than a full one, and intervals up to twice as wide.
    Results are written into notebooks/results/middle/, those of a quick run into
    notebooks/results/quick/, those of a full one into notebooks/results/; the page index.html in
    that folder shows them all. A study that fails does not stop the others. The exit status is 1 if
    a study failed or, but for a quick run, a check did not pass.

    Parameters
    ----------
    names
        Short names of studies, such as mimic. By default all studies.
    quick
        Use small parameters, for a first look.
    full
        Work out all that the notebooks store.
    workers
        Number of studies that run at the same time. By default as many as cores and memory permit.
    store
        Run in full, and store the outputs in the notebooks of the repository and their thumbnails
        beside them.
    out
        Write the results into this folder instead.
    site
        Run nothing. Write the stored notebooks into this folder as pages, with a gallery, the
        ledger, the glossary and the public names.
    """
    from mmqa_lab.io import own_folder
    from mmqa_lab.run import notebooks, pages, verdict
    from mmqa_lab.studies import STUDIES, TOOLS, chosen, notebooks_folder, results_folder

    if site is not None:
        with own_folder(site):
            print(pages.write_site(site, notebooks_folder(), [*chosen(names or []), *TOOLS]))
        return 0
    if quick and (full or store):
        raise ValueError("Invalid request --quick. Must stand without --full and --store.")
    size = "quick" if quick else "full" if full or store else "middle"
    usual = results_folder(notebooks_folder())
    folder = (out or (usual if size == "full" else usual / size)).resolve()
    wanted = [*chosen(names or []), *(TOOLS if store and not names else ())]
    failed = False
    ours = usual.parent == notebooks_folder() and out is None  # a repository's own
    with own_folder(folder, ours=ours):
        print(f"Results, as they arrive: {folder / 'index.html'}", flush=True)
        workers = min(workers or _fitting_workers(), len(wanted))
        known = notebooks.stored_seconds(notebooks_folder())
        share = 1 if size == "full" else 0.7  # measured
        left = sum(known.get(study.stem, 0) for study in wanted) * share
        if left and not quick:
            slower = notebooks.machine_speed()
            estimate = f"About {left * slower / workers / 60:.0f} minutes: this machine takes "
            print(f"{estimate}{slower:.1f} times as long as that of the stored runs.", flush=True)
        runs = _run_studies(notebooks.run_study, wanted, folder, size, workers, known)
        for study, record in runs:
            untrue = not quick and any(not check["passed"] for check in record["checks"])
            failed = failed or bool(record["failure"]) or untrue
            print(f"{study.notebook:<24} {record['seconds']:6.1f} s  {verdict(record)}", flush=True)
            pages.write_pages(folder, STUDIES)
    if store:
        notebooks.store(notebooks_folder(), folder, wanted)
    return int(failed)


def _fitting_workers():
    """The number of processes for which there are cores and memory."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    try:
        free = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9
    except (AttributeError, ValueError, OSError):  # Windows does not tell the free memory
        return cores
    return max(1, min(cores, int(free / 1.5)))  # a study may need 1.5 GB


def _apart():
    """Let a worker end with its parent; Ctrl-C is for that alone."""
    from mmqa_lab._compiled import end_with_parent

    getattr(os, "setpgrp", int)()
    end_with_parent()


def _run_studies(run_study, studies, folder, size, workers, known):
    """Run each study in a process of its own; yield it with its record when it ends."""
    import signal
    from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
    from multiprocessing import active_children, get_context

    os.environ.setdefault("NUMBA_NUM_THREADS", str(max(1, (os.cpu_count() or 1) // workers)))
    pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_apart)
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends the workers, too
    try:
        first = sorted(studies, key=lambda study: -known.get(study.stem, 0))
        first.insert(1, first.pop())  # the longest and the shortest: there is a result soon
        tasks = {pool.submit(run_study, study, folder, size=size): study for study in first}
        shares = {task: round(known.get(study.stem, 1)) for task, study in tasks.items()}
        bar, waiting = progress(range(sum(shares.values())), "s"), set(tasks)
        while waiting:
            names = [tasks[task].notebook for task in tasks if task.running()]
            bar.set_postfix_str(", ".join(names[:workers]))
            done, waiting = wait(waiting, timeout=1, return_when=FIRST_COMPLETED)
            bar.update(sum(shares[task] for task in done))
            for task in sorted(done, key=[*tasks].index):
                bar.clear()
                yield tasks[task], task.result()
        bar.close()
    except KeyboardInterrupt:  # a kernel ends with its worker
        for child in active_children():
            child.kill()
        raise
    finally:
        signal.signal(signal.SIGTERM, before)
        pool.shutdown(cancel_futures=True)


@app.command
def student(
    out: Path,
    /,
    *names: str,
    quick: bool = False,
    sheets: Path | None = None,
    checks: Path | None = None,
):
    """Write copies of the notebooks for a class: without the answers, with checks of the work.

    Parameters
    ----------
    out
        Write the copies into this folder. It must not contain such notebooks yet.
    names
        Short names of studies, such as mimic. By default all studies.
    quick
        Use small parameters, so that a class reaches the first exercise soon.
    sheets
        Write pages for the teacher into this folder: solutions, answers by number, lesson plans.
    checks
        Write copies with the checks of the exercises into this folder. Those of the class then have
        none.
    """
    from mmqa_lab.io import own_folder
    from mmqa_lab.run import students
    from mmqa_lab.studies import chosen

    wanted = chosen(names)
    with nullcontext() if sheets is None else own_folder(sheets):
        paths = students.write_student_notebooks(out, wanted, quick=quick, checks=checks is None)
        if checks is not None:
            paths += students.write_student_notebooks(checks, wanted, quick=quick)
        if sheets is not None:
            paths += students.write_solutions(sheets, wanted, quick=quick)
    print(*paths, sep="\n")


@app.command
def paper(
    folder: Path | None = None,
    /,
    *,
    new: Path | None = None,
    study: str | None = None,
    latex: bool = False,
    results: Path | None = None,
):
    """Make the PDF of a paper from results of studies, or lay a skeleton of a new paper.

    Every number, table and figure of a paper comes from a run. Where the results have a newer run,
    its values, tables and figures are taken; the others are those kept in the paper's folder.

    Parameters
    ----------
    folder
        Folder of the paper, with paper.typ. By default the one that comes with the notebooks.
    new
        Lay a skeleton of a paper into this new folder.
    study
        Short name of the study of the new paper, such as anisotropy.
    latex
        Lay the skeleton for LaTeX; by default it is for Typst.
    results
        Folder of the results. By default that of mmqa studies.
    """
    from mmqa_lab.run.papers import make_paper, new_paper
    from mmqa_lab.studies import chosen, notebooks_folder, results_folder

    if (new is None) != (study is None) or (new is not None and folder is not None):
        raise ValueError("Invalid request. Must have FOLDER, or --new and --study.")
    ran = results or results_folder(notebooks_folder())
    if new is not None:
        print(new_paper(new, chosen([study])[0], ran, latex=latex))
    else:
        print(make_paper(folder or notebooks_folder() / "paper", ran))


@app.command
def lab(*options: Annotated[str, Parameter(allow_leading_hyphen=True)]):
    """Open the notebooks in JupyterLab.

    Parameters
    ----------
    options
        Options that are passed on to jupyter lab.
    """
    from mmqa_lab.run.pages import TEMPLATES
    from mmqa_lab.studies import notebooks_folder

    command = [sys.executable, "-m", "jupyterlab", "--LabApp.news_url=None", *options]
    config = [str(TEMPLATES), os.environ.get("JUPYTER_CONFIG_PATH", "")]  # asks nobody about news
    environment = os.environ | {"JUPYTER_CONFIG_PATH": os.pathsep.join(filter(None, config))}
    child = subprocess.Popen(command, cwd=notebooks_folder(), env=environment)
    while True:
        try:
            return child.wait()
        except KeyboardInterrupt:  # Jupyter has it too, and asks whether to stop
            continue


FAST = ("-m", "not (long or browser)")
# One process more than cores, for some wait for a browser or a kernel.
TEST_CORES = f"-n={min(4, (os.cpu_count() or 1) + 1)}"


@app.command
def test(*options: Annotated[str, Parameter(allow_leading_hyphen=True)], fast: bool = False):  # noqa: PT028 a command, no test
    """Run the tests: style by ruff, then every test in up to four processes.

    Parameters
    ----------
    options
        Options that are passed on to pytest.
    fast
        Leave out notebooks, the browser and the files of tests that take longest.
    """
    root = Path(__file__).resolve().parents[2]
    if not (root / "tests").is_dir():
        raise FileNotFoundError(f"Invalid folder {root}: no tests. Must be the repository.")
    steps = (
        ["ruff", "check", "."],
        ["ruff", "format", "--check", "."],
        ["pytest", "-q", "-ra", TEST_CORES, *FAST[: 2 * fast], *options],
    )
    statuses = [subprocess.call([sys.executable, "-m", *step], cwd=root) for step in steps]
    return next((status for status in statuses if status), 0)
