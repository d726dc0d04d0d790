"""Run the whole test suite: style checks by ruff, then every test by pytest.

Tests that need OpenGL libraries, Chromium or larger real clouds are skipped where those are
missing and say so. What stands after -- goes to pytest.
"""

SUMMARY = "run the test suite"

EPILOG = """\
example:
  mmqa test
  mmqa test -- -k planes
  mmqa test -- --cov --cov-report term-missing
"""


def add_arguments(parser):
    """Declare the arguments."""
    parser.add_argument("pytest", nargs="*", metavar="OPTION", help="handed to pytest")


def run(options):
    """Run ruff and pytest; return the first status that is not zero."""
    import subprocess
    import sys
    from pathlib import Path

    root = Path(__file__).resolve().parents[2]
    if not (root / "tests").is_dir():
        raise FileNotFoundError(f"Invalid folder {root}: no tests. Must be the repository.")
    steps = (
        ["ruff", "check", "."],
        ["ruff", "format", "--check", "."],
        ["pytest", "-q", "-ra", "--durations=15", *options.pytest],
    )
    statuses = [subprocess.call([sys.executable, "-m", *step], cwd=root) for step in steps]
    return next((status for status in statuses if status), 0)
