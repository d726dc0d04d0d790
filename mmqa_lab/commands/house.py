"""The small commands that keep house: notebooks, studies, tests, names, README, completion."""

import os
import shutil
import signal
import subprocess
import sys
import threading
from contextlib import contextmanager
from pathlib import Path

from mmqa_lab.commands import Lazy, command, option, switch

pd = Lazy("pandas")
checks = Lazy("mmqa_lab._checks")

CORES = ("-n=logical", "--maxprocesses=4")
"""Tests run on all cores, up to four: each process has its own fixtures and libraries in memory."""

FILL_S = 4.0
"""Seconds between two states of the index while studies run."""

LONGEST = ("poles", "anisotropy", "test_field")
"""Studies that start first where several run at once, so that none is left over at the end."""

STUDIES = option("name", "NAME", "stems of studies; all if none", nargs="*")


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
    from mmqa_lab.run.students import write_solutions, write_student_notebooks
    from mmqa_lab.studies import chosen

    studies = chosen(options.name)
    paths = write_student_notebooks(studies, options.out, quick=options.quick)
    if options.sheets:
        paths += write_solutions(studies, options.sheets)
    print(*paths, sep="\n")


@command(
    "run the studies and write their tables, figures and pages",
    STUDIES,
    switch("--quick", "small parameters, for a first look"),
    option("--timeout", "SECONDS", "of a study; default none", float),
    option("--workers", "N", "studies at the same time", int, 1),
    option("--out", "FOLDER", "default notebooks/results", Path),
    examples=("", "chart_tables anisotropy --quick", "--workers 4"),
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

    signal.signal(signal.SIGTERM, signal.default_int_handler)  # kill is an interruption, too
    usual = results_folder(notebooks_folder())
    folder = (options.out or (usual / "quick" if options.quick else usual)).resolve()
    studies = chosen(options.name)
    several = checks.check_count(options.workers, "workers") > 1
    run = _several_at_once if several else _one_by_one
    outcomes = []
    print(f"Results, as they arrive: {folder / 'index.html'}", flush=True)
    with (
        _filling(folder, STUDIES, studies),
        tqdm(total=len(studies), unit="study", desc="studies") as bar,
    ):
        for study, outcome in run(studies, folder, options, bar):
            outcomes.append(outcome)
            bar.update()
            bar.write(f"{study.notebook:<24} {outcome.seconds:6.1f} s  {outcome.verdict}")
    return 0 if all(outcome.ok and (outcome.quick or outcome.true) for outcome in outcomes) else 1


@contextmanager
def _filling(folder, studies, running):
    """Write the pages every few seconds while studies run; open the index once it shows one."""
    from mmqa_lab.run import pages

    ended = threading.Event()

    def fill():
        opened = False
        while not ended.wait(FILL_S):
            pages.write_pages(folder, studies, running=running)
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

    how = {"quick": options.quick, "timeout": options.timeout}
    for study in studies:
        bar.set_description(study.stem)
        yield study, run_study(study, folder, **how)


def _several_at_once(studies, folder, options, bar):
    """Run studies in processes of their own, the longest first; yield each that has ended."""
    from concurrent.futures import ThreadPoolExecutor, as_completed

    from mmqa_lab.run.pages import Outcome, read_outcome

    command = [sys.executable, "-m", "mmqa_lab", "studies", "--out", str(folder)]
    command += ["--quick"] if options.quick else []
    command += [] if options.timeout is None else ["--timeout", str(options.timeout)]
    threads = max(1, (os.cpu_count() or 1) // options.workers)
    place = {"NUMBA_NUM_THREADS": str(threads), **os.environ}

    alone = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "start_new_session": True}
    running = []  # Ctrl-C reaches them through this process alone

    def run(study):
        child = subprocess.Popen([*command, study.stem], env=place, **alone)
        running.append(child)
        child.wait()

    with ThreadPoolExecutor(options.workers) as pool:
        order = sorted(studies, key=lambda study: study.stem not in LONGEST)
        tasks = {pool.submit(run, study): study for study in order}
        try:
            for task in as_completed(tasks):
                study = tasks[task]
                empty = Outcome(study.stem, options.quick)
                yield study, read_outcome(folder / study.stem) or empty
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in running:
                child.terminate()
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
