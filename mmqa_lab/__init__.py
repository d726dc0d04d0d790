"""A laboratory for the quality of mobile mapping point clouds and images.

The package is a set of rooms, each a module named by a noun of the field; import the room you
need (``from mmqa_lab import chart_cloud``); CONTRIBUTING.md lists them. Nothing heavy is imported
here.
"""

import sysconfig
import tomllib
from pathlib import Path

__version__ = "0.3.0"


def _shipped(name):
    """The folder of the notebooks or samples: in the repository, or where the wheel puts it."""
    root = Path(__file__).resolve().parents[1]
    if (root / "pyproject.toml").is_file():
        return root / name
    schemes = {sysconfig.get_default_scheme(), sysconfig.get_preferred_scheme("user")}
    bases = [Path(sysconfig.get_path("data", scheme)) for scheme in schemes]
    there = [base / "share" / "mmqa_lab" / name for base in (*bases, root)]
    return next((folder for folder in there if folder.is_dir()), there[0])


def _tables(path):
    """The tables of a TOML file, with tuples in place of lists."""

    def with_tuples(value):
        if isinstance(value, dict):
            return {name: with_tuples(one) for name, one in value.items()}
        return tuple(map(with_tuples, value)) if isinstance(value, list) else value

    return with_tuples(tomllib.loads(Path(path).read_text("utf-8")))
