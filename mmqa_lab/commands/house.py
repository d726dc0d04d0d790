"""The small commands that keep house: notebooks, studies, tests, names, README, completion."""

import importlib
import inspect
import os
import pkgutil
import shutil
import subprocess
import sys
import threading
from contextlib import contextmanager
from pathlib import Path

from mmqa_lab.commands import OUTPUT, Lazy, command, option, switch
from mmqa_lab.commands._output import print_rows

pd = Lazy("pandas")
checks = Lazy("mmqa_lab._checks")

NO_LIBRARY = ("__main__", "commands", "studies")
"""Modules of the package that make no names public."""

CORES = ("-n=logical", "--maxprocesses=4")
"""Tests run on all cores, up to four: each process has its own fixtures and libraries in memory."""

FILL_S = 4.0
"""Seconds between two states of the index while studies run."""

LONGEST = ("poles", "anisotropy", "test_field")
"""Studies that start first where several run at once, so that none is left over at the end."""

STUDIES = option("name", "NAME", "stems of studies; all if none", nargs="*")


@command(
    "print shell completion for bash, zsh or tcsh",
    option("shell", "SHELL", "of yours", choices=("bash", "zsh", "tcsh")),
    examples=(
        "bash > ~/.local/share/bash-completion/completions/mmqa",
        "zsh > ~/.zfunc/_mmqa",
    ),
)
def completion(options):
    """Print a script that lets the shell complete mmqa's commands, options, files and studies.

    Put its output where the shell looks for completions, or evaluate it from the shell's start
    file.
    """
    import shtab

    from mmqa_lab.__main__ import parser
    from mmqa_lab.studies import STUDIES

    whole = parser()
    for one in whole._subparsers._group_actions[0].choices.values():
        for action in one._actions:
            if action.type is Path or action.metavar in ("FILE", "CLOUD", "IMAGE"):
                action.complete = shtab.FILE
            elif action.dest in ("study", "name") and not action.option_strings:
                action.choices = [study.stem for study in STUDIES]
    print(shtab.complete(whole, shell=options.shell))


@command(
    "open the notebooks in JupyterLab",
    option("jupyter", "OPTION", "handed to jupyter lab", nargs="*"),
    examples=(
        "",
        "-- --no-browser --port 8890",
    ),
)
def lab(options):
    """Open JupyterLab with the notebooks.

    It shows the folder of the repository, and no news. From an installed package the notebooks are
    copied to the folder notebooks of the current directory; those that are there already stay as
    they are.
    """
    from mmqa_lab.run.pages import TEMPLATES
    from mmqa_lab.studies import notebooks_folder

    folder = notebooks_folder()
    root, place = folder.parent, "notebooks"
    if not (root / "pyproject.toml").is_file():
        root = Path.cwd()
        (root / place).mkdir(exist_ok=True)
        for notebook in folder.glob("*.ipynb"):
            if not (root / place / notebook.name).exists():
                shutil.copyfile(notebook, root / place / notebook.name)
    chosen = [f"--LabApp.default_url=/lab/tree/{place}", "--LabApp.news_url=None"]
    command = [sys.executable, "-m", "jupyterlab", *chosen, *options.jupyter]
    config = [str(TEMPLATES), os.environ.get("JUPYTER_CONFIG_PATH", "")]  # asks nobody about news
    environment = os.environ | {"JUPYTER_CONFIG_PATH": os.pathsep.join(filter(None, config))}
    return subprocess.call(command, cwd=root, env=environment)


@command(
    "list the public names of the library",
    option("word", "WORD", "all names if none", str, "", nargs="?"),
    *OUTPUT,
    examples=(
        "",
        "density --json",
    ),
)
def names(options):
    """List the public names of the library: room, name, and what it is for in a line.

    With WORD only those in which it occurs. What a name takes and gives back, its units, errors and
    source: help(mmqa_lab.ROOM.NAME) in Python, or NAME? in a notebook.
    """
    print_rows(name_table(options.word), options)


def name_table(word=""):
    """Return every public function and class: room, name and the first line of its docstring."""
    rows = [
        (room, name, inspect.getdoc(member).splitlines()[0])
        for room in _rooms()
        for name, member in _members(importlib.import_module(f"mmqa_lab.{room}"))
    ]
    rows = [row for row in rows if word.lower() in " ".join(row).lower()]
    if not rows:
        raise ValueError(f"Invalid word {word!r}. Must occur in a room, a name or its summary.")
    return pd.DataFrame(rows, columns=["room", "name", "summary"])


def _rooms():
    """Dotted names of the modules that make names public.

    A room that is a package makes public what is in its ``__all__``; one that only gathers modules
    what those make public; a module its functions and classes, or its ``__all__``.
    """
    import mmqa_lab

    for found in pkgutil.iter_modules(mmqa_lab.__path__):
        if found.name.startswith("_") or found.name in NO_LIBRARY:
            continue
        yield found.name
        room = importlib.import_module(f"mmqa_lab.{found.name}")
        if found.ispkg and not hasattr(room, "__all__"):
            inner = pkgutil.iter_modules(room.__path__)
            yield from (f"{found.name}.{one.name}" for one in inner if one.name[0] != "_")


def _members(module):
    """Names and objects that a module makes public."""
    given = getattr(module, "__all__", None)
    for name in vars(module) if given is None else given:
        member = getattr(module, name)
        own = getattr(member, "__module__", None) == module.__name__ and not name.startswith("_")
        if (given is not None or own) and (inspect.isfunction(member) or inspect.isclass(member)):
            yield name, member


@command(
    "insert the studies' answers into the README",
    option("--results", "FOLDER", "default notebooks/results", Path),
    switch("--check", "only say whether it is up to date"),
    examples=(
        "",
        "--check",
    ),
)
def readme(options):
    """Insert the answers of the last full run of all studies, and its key figure, into the README.

    For those who change a study: nothing in that table is typed. The ledger's counts and figure are
    inserted too. With --check nothing is written; the exit status is 1 where the README differs.
    """
    from mmqa_lab.run import pages
    from mmqa_lab.studies import STUDIES, notebooks_folder, results_folder

    notebooks = notebooks_folder()
    folder = options.results or results_folder(notebooks)
    same = pages.update_readme(notebooks, folder, STUDIES, write=not options.check)
    return 1 if options.check and not same else 0


@command(
    "write notebooks without the answers, for students",
    option("out", "OUT_FOLDER", "made where missing", Path),
    switch("--quick", "small parameters"),
    option("--sheets", "FOLDER", "handouts and solutions, for the teacher", Path),
    STUDIES,
    examples=("course", "course anisotropy mimic --quick", "course --sheets mine"),
)
def student(options):
    """Write copies of the notebooks for a class: without the answers, with checks of the work.

    Each exercise says names, types and units of what is asked for. Its check says in a sentence
    what is wrong; it is compressed, so that the answer cannot be read at a glance. The teacher's
    lesson plan and stored outputs stay in the original notebook. --quick sets small parameters, so
    that a class reaches the first exercise soon. --sheets writes, for the teacher, a handout and a
    sheet of solutions of each study: PDF where Chromium is installed, else HTML pages to print. A
    folder that already contains such notebooks is refused.
    """
    from mmqa_lab.run.students import write_sheets, write_student_notebooks
    from mmqa_lab.studies import chosen

    studies = chosen(options.name)
    paths = write_student_notebooks(studies, options.out, quick=options.quick)
    if options.sheets:
        paths += write_sheets(studies, options.sheets)
    print(*paths, sep="\n")


@command(
    "run the studies and write their tables, figures and pages",
    STUDIES,
    switch("--quick", "small parameters, for a first look"),
    switch("--resume", "skip studies that ended with the same code"),
    option("--timeout", "SECONDS", "of a study; default none", float),
    option("--workers", "N", "studies at the same time", int, 1),
    option("--out", "FOLDER", "default notebooks/results", Path),
    examples=("", "chart_tables anisotropy --quick", "--resume --workers 4"),
)
def studies(options):
    """Run the studies: every notebook of the catalogue, without a screen.

    Each study runs in a kernel of its own and leaves its tables, figures, named values and a page
    under notebooks/results/ (results/ of the current directory where the package is installed), as
    they arrive; index.html there shows them all, opens in a browser where there is a screen, and
    fills as the studies run. Results of --quick go to results/quick/. A study
    that fails does not stop the others. The exit status is 1 where a study failed or, with the
    delivered parameters, a check did not pass.
    """
    from tqdm import tqdm

    from mmqa_lab.studies import STUDIES, chosen, notebooks_folder, results_folder

    usual = results_folder(notebooks_folder())
    folder = (options.out or (usual / "quick" if options.quick else usual)).resolve()
    studies = chosen(options.name)
    several = checks.check_count(options.workers, "workers") > 1
    run = _several_at_once if several else _one_by_one
    outcomes = []
    print(f"Results, as they arrive: {folder / 'index.html'}", flush=True)
    with (
        _filling(folder, STUDIES),
        tqdm(total=len(studies), unit="study", desc="studies") as bar,
    ):
        for study, outcome in run(studies, folder, options, bar):
            outcomes.append(outcome)
            bar.update()
            bar.write(f"{study.notebook:<24} {outcome.seconds:6.1f} s  {outcome.verdict}")
    return 0 if all(outcome.ok and (outcome.quick or outcome.true) for outcome in outcomes) else 1


@contextmanager
def _filling(folder, studies):
    """Write the pages every few seconds while studies run; open the index once it shows one."""
    from mmqa_lab.run import pages

    ended = threading.Event()

    def fill():
        opened = False
        while not ended.wait(FILL_S):
            pages.write_pages(folder, studies, running=True)
            if not opened and any(folder.glob("*/*.png")):
                opened = True
                _open(folder / "index.html")

    filling = threading.Thread(target=fill, daemon=True)
    filling.start()
    try:
        yield
    finally:
        ended.set()
        filling.join()
        pages.write_pages(folder, studies)


def _open(page):
    """Open a page in the browser of somebody who sits at a screen."""
    import webbrowser

    screen = {"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ) or sys.platform in ("darwin", "win32")
    if screen and sys.stdout.isatty():
        webbrowser.open(page.as_uri())


def _one_by_one(studies, folder, options, bar):
    """Run studies in turn; yield each with its outcome."""
    from mmqa_lab.run.notebooks import run_study

    how = {"quick": options.quick, "timeout": options.timeout, "resume": options.resume}
    for study in studies:
        bar.set_description(study.stem)
        yield study, run_study(study, folder, **how)


def _several_at_once(studies, folder, options, bar):
    """Run studies in processes of their own, the longest first; yield each that has ended."""
    from concurrent.futures import ThreadPoolExecutor, as_completed

    from mmqa_lab.run.pages import Outcome, read_outcome

    command = [sys.executable, "-m", "mmqa_lab", "studies", "--out", str(folder)]
    command += [f"--{name}" for name in ("quick", "resume") if getattr(options, name)]
    command += [] if options.timeout is None else ["--timeout", str(options.timeout)]
    threads = max(1, (os.cpu_count() or 1) // options.workers)
    place = {"NUMBA_NUM_THREADS": str(threads), **os.environ}

    def run(study):
        subprocess.run([*command, study.stem], env=place, capture_output=True)

    with ThreadPoolExecutor(options.workers) as pool:
        order = sorted(studies, key=lambda study: study.stem not in LONGEST)
        tasks = {pool.submit(run, study): study for study in order}
        try:
            for task in as_completed(tasks):
                study = tasks[task]
                empty = Outcome(study.stem, options.quick, "")
                yield study, read_outcome(folder / study.stem) or empty
        except KeyboardInterrupt:  # those that run have got it too
            pool.shutdown(cancel_futures=True)
            raise


@command(
    "run the test suite",
    option("pytest", "OPTION", "handed to pytest", nargs="*"),
    examples=("", "-- -k planes", "-- --cov --cov-report term-missing"),
)
def test(options):
    """Run the whole test suite: style checks by ruff, then every test on up to four cores.

    Tests that need OpenGL libraries, Chromium or larger real clouds are skipped where those are
    missing and say so. What stands after -- goes to pytest.
    """
    root = Path(__file__).resolve().parents[2]
    if not (root / "tests").is_dir():
        raise FileNotFoundError(f"Invalid folder {root}: no tests. Must be the repository.")
    steps = (
        ["ruff", "check", "."],
        ["ruff", "format", "--check", "."],
        ["pytest", "-q", "-ra", "--durations=15", *CORES, *options.pytest],
    )
    statuses = [subprocess.call([sys.executable, "-m", *step], cwd=root) for step in steps]
    return next((status for status in statuses if status), 0)
