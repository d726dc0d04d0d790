"""The one door: ``python3 -m mmqa_lab COMMAND``, and ``mmqa COMMAND`` once installed.

It starts with the standard library alone. Outside of a prepared environment it makes ``.venv`` from
``environment.txt`` and runs itself in there.
"""

import argparse
import hashlib
import importlib
import importlib.util
import os
import pkgutil
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

from mmqa_lab import __version__, commands

ROOT = Path(__file__).resolve().parent.parent
ENVIRONMENT = ROOT / "environment.txt"
VENV = ROOT / ".venv"
STAMP = VENV / "mmqa-environment.sha256"

PROBES = ("numpy", "laspy", "numba", "pandas", "dask", "nbclient", "pytest", "ruff")
"""An environment that can import these was made from environment.txt."""

DESCRIPTION = """\
The quality of mobile mapping point clouds and images: evaluate your own data, run the studies
that put the published metrics to the test, or open the notebooks.
"""


def main(arguments=None):
    """Run the command line and return its exit status."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    options = parser().parse_args(arguments)
    if not prepared():
        return subprocess.call([prepare(), "-m", "mmqa_lab", *arguments])
    warnings.showwarning = lambda message, *_, **__: _say(options.command, message)
    try:
        return options.run(options) or 0
    except (ValueError, TypeError, ImportError, OSError) as error:
        _say(options.command, error)
        return 2
    except KeyboardInterrupt:
        _say(options.command, "interrupted; what was finished is kept.")
        return 130


def parser():
    """Return the argument parser with a sub-parser per module of ``mmqa_lab.commands``."""
    whole = argparse.ArgumentParser(prog="mmqa", description=DESCRIPTION)
    whole.add_argument("--version", action="version", version=f"mmqa_lab {__version__}")
    groups = whole.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for found in pkgutil.iter_modules(commands.__path__):
        if found.name.startswith("_"):
            continue
        module = importlib.import_module(f"mmqa_lab.commands.{found.name}")
        one = groups.add_parser(
            found.name,
            help=module.SUMMARY,
            description=module.__doc__,
            epilog=module.EPILOG,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        module.add_arguments(one)
        one.set_defaults(run=module.run)
    return whole


def prepared():
    """Return whether this interpreter has what environment.txt asks for."""
    return not ENVIRONMENT.is_file() or all(importlib.util.find_spec(name) for name in PROBES)


def prepare():
    """Make ``.venv`` from environment.txt, once for each of its versions; return its Python."""
    python = VENV / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    stamped = STAMP.is_file() and STAMP.read_text(encoding="utf-8") == _wanted()
    if python.exists() and stamped:
        return str(python)
    if sys.version_info < (3, 11):  # noqa: UP036 - an older Python gets a sentence
        sys.exit(f"mmqa: Invalid Python {sys.version.split()[0]}. Must be 3.11 or newer.")
    began = time.monotonic()
    print(f"Preparing {VENV} from environment.txt, once; takes minutes.", file=sys.stderr)
    try:
        if importlib.util.find_spec("ensurepip"):
            _with_pip(python)
        else:
            _with_uv(python)
    except subprocess.CalledProcessError as error:
        sys.exit(
            f"mmqa: could not prepare the environment: {error.cmd[0]} ended with "
            f"{error.returncode}. Must have pip and reach a package index."
        )
    STAMP.write_text(_wanted(), encoding="utf-8")
    print(f"Environment ready in {time.monotonic() - began:.0f} s.", file=sys.stderr)
    return str(python)


def _with_pip(python):
    """The usual way: venv and pip."""
    subprocess.check_call([sys.executable, "-m", "venv", str(VENV)])
    install = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.check_call([*install, "--requirement", str(ENVIRONMENT)], cwd=ROOT)


def _with_uv(python):
    """Debian's python3 without python3-venv: uv makes environments without ensurepip.

    Installing to a folder of one's own is what a system's pip allows everywhere.
    """
    with tempfile.TemporaryDirectory() as folder:
        pip = [sys.executable, "-m", "pip", "install", "--quiet", "--target", folder, "uv"]
        subprocess.check_call(pip)
        uv = str(Path(folder) / "bin" / "uv")
        if not python.exists():
            subprocess.check_call([uv, "venv", "--quiet", "--python", sys.executable, str(VENV)])
        install = [uv, "pip", "install", "--quiet", "--compile-bytecode", "--python", str(python)]
        subprocess.check_call([*install, "--requirement", str(ENVIRONMENT)], cwd=ROOT)


def _wanted():
    """The hash that the stamp must hold."""
    return hashlib.sha256(ENVIRONMENT.read_bytes()).hexdigest()


def _say(command, sentence):
    """One sentence on stderr."""
    print(f"mmqa {command}: {sentence}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
