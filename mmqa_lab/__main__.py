"""The command line: ``python3 -m mmqa_lab COMMAND``, and ``mmqa COMMAND`` once installed.

It starts with the standard library alone. Outside of a prepared environment it makes ``.venv`` from
``environment.txt`` (for ``test``: with ``tests/environment.txt``) and runs itself in there.
"""

import argparse
import hashlib
import importlib
import importlib.util
import inspect
import os
import pkgutil
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

from mmqa_lab import __version__, commands

ROOT = Path(__file__).resolve().parent.parent
ENVIRONMENT = ROOT / "environment.txt"
TOOLS = ROOT / "tests" / "environment.txt"
VENV = ROOT / ".venv"

PROBES = {
    ENVIRONMENT: ("numpy", "laspy", "numba", "pandas", "dask", "nbclient"),
    TOOLS: ("numpy", "pytest", "hypothesis", "ruff"),
}
"""What an environment made from these files can import."""

COMPILED = {"lhd": "detection", "map": "_search", "poles": "features"}
"""Commands that wait for the compiler when first called, and a module that they compile."""

DESCRIPTION = """\
The quality of mobile mapping point clouds and images: evaluate your own data, run the studies
that put the published metrics to the test, or open the notebooks.
"""


def main(arguments=None):
    """Run the command line and return its exit status."""
    arguments = list(sys.argv[1:] if arguments is None else arguments) or ["--help"]
    options, unknown = parser().parse_known_args(arguments)
    if unknown:
        of_command(options.command).error(f"unrecognized arguments: {' '.join(unknown)}")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices: threads would only wait
    wanted = TOOLS if options.command == "test" else ENVIRONMENT
    warnings.showwarning = lambda message, *_, **__: _say(options.command, message)
    try:
        if not prepared(wanted):
            command = [prepare(wanted), "-m", "mmqa_lab", *arguments]
            if os.name != "nt":  # in place of this process: signals reach the command itself
                os.execv(command[0], command)
            return subprocess.call(command)
        if sys.stderr.isatty() and _is_uncompiled(options.command):
            _say(options.command, "compiles its searches, once; later calls start at once.")
        return options.run(options) or 0
    except BrokenPipeError:  # as in: mmqa names | head
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (ValueError, TypeError, ImportError, OSError) as error:
        _say(options.command, error)
        return 2
    except KeyboardInterrupt:
        _say(options.command, "interrupted; what was finished is kept.")
        return 130


def parser():
    """Return the argument parser with a sub-parser for each command."""
    whole = argparse.ArgumentParser(prog="mmqa", description=DESCRIPTION)
    whole.add_argument("--version", action="version", version=f"mmqa_lab {__version__}")
    groups = whole.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, command in sorted(_commands().items()):
        one = groups.add_parser(
            name,
            help=command.summary,
            description=inspect.getdoc(command.run),
            epilog=command.examples,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        for names, about in command.arguments:
            one.add_argument(*names, **about)
        one.set_defaults(run=command.run)
    return whole


def of_command(name):
    """Return the parser of one command, so that an error shows that command's usage."""
    return parser()._subparsers._group_actions[0].choices[name]


def _commands():
    """Commands by their names, as the modules of ``mmqa_lab.commands`` declare them."""
    for one in pkgutil.iter_modules(commands.__path__):
        importlib.import_module(f"mmqa_lab.commands.{one.name}")
    return commands.COMMANDS


def prepared(wanted):
    """Return whether this interpreter has what a file of requirements asks for."""
    return not wanted.is_file() or all(map(importlib.util.find_spec, PROBES[wanted]))


def prepare(wanted):
    """Make ``.venv`` from a file of requirements, once for each of its versions; return its Python.

    uv does it in a fraction of pip's time. Where it is not installed, pip brings it to a temporary
    folder, which also works with Debian's Python without ensurepip; failing that, pip does it all.
    """
    python = VENV / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    stamp, digest = _stamp(wanted)
    if python.exists() and stamp.is_file() and stamp.read_text(encoding="utf-8") == digest:
        return str(python)
    if sys.version_info < (3, 11):  # noqa: UP036 - an older Python gets a sentence
        sys.exit(f"mmqa: Invalid Python {sys.version.split()[0]}. Must be 3.11 or newer.")
    began = time.monotonic()
    name = wanted.relative_to(ROOT)
    print(f"Preparing {VENV} from {name}, once; this takes minutes.", file=sys.stderr)
    try:
        with tempfile.TemporaryDirectory() as folder:
            _install(wanted, python, _uv(folder))
    except subprocess.CalledProcessError as error:
        sys.exit(
            f"mmqa: could not prepare the environment: {error.cmd[0]} ended with "
            f"{error.returncode}. Must have uv or pip and reach a package index."
        )
    stamp.write_text(digest, encoding="utf-8")
    print(f"Environment ready in {time.monotonic() - began:.0f} s.", file=sys.stderr)
    return str(python)


def _uv(folder):
    """The path of uv, installed or fetched into a folder; None where it cannot be had."""
    if found := shutil.which("uv"):
        return found
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--target", folder, "uv"]
    fetched = subprocess.call([*pip, "--disable-pip-version-check"], stderr=subprocess.DEVNULL) == 0
    return str(Path(folder) / "bin" / "uv") if fetched else None


def _install(wanted, python, uv):
    """Make the environment where it is missing and install what a file asks for."""
    if uv:
        make = [uv, "venv", "--quiet", "--python", sys.executable]
        install = [uv, "pip", "install", "--python", str(python)]
    else:
        make = [sys.executable, "-m", "venv"]
        install = [str(python), "-m", "pip", "install", "--no-compile"]
    if not python.exists():
        subprocess.check_call([*make, str(VENV)])
    subprocess.check_call([*install, "--quiet", "--requirement", str(wanted)], cwd=ROOT)


def _stamp(wanted):
    """The file that says what the environment was made from, and what it must say."""
    content = ENVIRONMENT.read_bytes() + wanted.read_bytes()
    return VENV / f"mmqa-{wanted.parent.name}.sha256", hashlib.sha256(content).hexdigest()


def _is_uncompiled(command):
    """Whether a command was never called here: numba keeps what it compiles beside the package."""
    folder = Path(os.environ.get("NUMBA_CACHE_DIR", Path(__file__).parent))
    if command not in COMPILED or not os.access(folder, os.W_OK):
        return False
    return not any(folder.rglob(f"{COMPILED[command]}.*.nbi"))


def _say(command, sentence):
    """One sentence on stderr."""
    print(f"mmqa {command}: {sentence}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
