"""The tables and folders that come with the package."""

import sysconfig
import tomllib
from pathlib import Path

__all__ = ["read_toml", "shipped_folder"]


def shipped_folder(name):
    """The folder of the notebooks or samples: in the repository, or where the wheel puts it."""
    root = Path(__file__).resolve().parents[1]
    if (root / "pyproject.toml").is_file():
        return root / name
    schemes = {sysconfig.get_default_scheme(), sysconfig.get_preferred_scheme("user")}
    bases = [Path(sysconfig.get_path("data", scheme)) for scheme in schemes]
    folders = [base / "share" / "mmqa_lab" / name for base in (*bases, root)]
    return next((folder for folder in folders if folder.is_dir()), folders[0])


def read_toml(path):
    """Return the tables of a TOML file, with tuples in place of lists."""

    def with_tuples(value):
        if isinstance(value, dict):
            return {name: with_tuples(one) for name, one in value.items()}
        return tuple(map(with_tuples, value)) if isinstance(value, list) else value

    return with_tuples(tomllib.loads(Path(path).read_text("utf-8")))
