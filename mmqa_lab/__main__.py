"""mmqa: the quality of mobile mapping point clouds and images.

Type python3 -m mmqa_lab COMMAND or, if the package is installed, mmqa COMMAND. mmqa --help lists
the commands; mmqa COMMAND --help is the manual. studies runs all studies, lab opens the notebooks,
test runs the tests. The first call makes .venv from environment.txt; test adds
tests/environment.txt.
"""

# This module starts with the standard library alone, then runs again in its environment.
import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

__all__ = ["main", "prepare", "prepared"]

ROOT = Path(__file__).resolve().parent.parent
ENVIRONMENT = ROOT / "environment.txt"
TOOLS = ROOT / "tests" / "environment.txt"
VENV = ROOT / ".venv"

# Packages that an environment from each file can import.
PROBES = {
    ENVIRONMENT: ("numpy", "laspy", "numba", "pandas", "dask", "nbclient", "cyclopts"),
    TOOLS: ("numpy", "pytest", "hypothesis", "ruff"),
}


def main(arguments=None):
    """Run the command line and return its exit status."""
    try:
        return _run(list(sys.argv[1:] if arguments is None else arguments) or ["--help"])
    except KeyboardInterrupt:
        print("mmqa: interrupted; the next call goes on from here.", file=sys.stderr)
        return 130
    except BrokenPipeError:  # as in: python3 -m mmqa_lab --help | head -1
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _run(arguments):
    """Run a command in this interpreter, or in the environment that it needs."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # matrices are small: threads would wait
    wanted = TOOLS if arguments[0] == "test" else ENVIRONMENT
    if prepared(wanted):
        from mmqa_lab import commands

        return commands.run(arguments)
    if "--help" in arguments:
        later = "comes with the environment. Type python3 -m mmqa_lab --version once to make it."
        whole = arguments[0].startswith("-")
        print(__doc__ if whole else f"The manual of {arguments[0]} {later}", flush=True)
        return 0
    command = [prepare(wanted), "-m", "mmqa_lab", *arguments]
    if os.name != "nt":  # replaces this process, so signals reach the command
        os.execv(command[0], command)
    return subprocess.call(command)


def prepared(wanted):
    """Return whether this interpreter has the packages of a requirements file."""
    return not wanted.is_file() or all(map(importlib.util.find_spec, PROBES[wanted]))


def prepare(wanted):
    """Make ``.venv`` from a requirements file, once per version of the file; return its Python.

    uv needs a fraction of pip's time. If uv is not installed, pip installs it into a temporary
    folder, which also works with Debian's Python without ensurepip. If that fails, pip makes the
    whole environment.
    """
    python = VENV / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    stamp = VENV / f"mmqa-{wanted.parent.name}.sha256"
    digest = hashlib.sha256(ENVIRONMENT.read_bytes() + wanted.read_bytes()).hexdigest()
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
    """The path of uv, installed or fetched into a folder; None if it cannot be fetched."""
    if found := shutil.which("uv"):
        return found
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--target", folder, "uv"]
    fetched = subprocess.call([*pip, "--disable-pip-version-check"], stderr=subprocess.DEVNULL) == 0
    return str(Path(folder) / "bin" / "uv") if fetched else None


def _install(wanted, python, uv):
    """Make the environment if it is missing, and install the packages of a file."""
    if uv:
        make = [uv, "venv", "--quiet", "--python", sys.executable]
        install = [uv, "pip", "install", "--python", str(python)]
    else:
        make = [sys.executable, "-m", "venv"]
        install = [str(python), "-m", "pip", "install", "--no-compile"]
    if not python.exists():
        subprocess.check_call([*make, str(VENV)])
    subprocess.check_call([*install, "--quiet", "--requirement", str(wanted)], cwd=ROOT)


if __name__ == "__main__":
    sys.exit(main())
