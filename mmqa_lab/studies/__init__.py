"""The studies, one module per notebook, and their list, which stands in a TOML file."""

from dataclasses import dataclass
from importlib import import_module
from inspect import signature
from pathlib import Path

from mmqa_lab import _shipped, _tables
from mmqa_lab._checks import check_choice


@dataclass(frozen=True)
class Study:
    """One study: a notebook, the module behind it, and what it asks."""

    number: int
    stem: str
    title: str
    question: str
    source: str
    tables: tuple = ()
    """Source and name of the printed tables that its ledger answers."""

    @property
    def notebook(self):
        """Name of the notebook without its ending."""
        return f"{self.number:02d}_{self.stem}"

    @property
    def path(self):
        """Path of the notebook."""
        return notebooks_folder() / f"{self.notebook}.ipynb"

    @property
    def quick(self):
        """Small parameters of its notebook, for the tests and for copies for a class."""
        return SMALL.get(self.stem, {})

    @property
    def module(self):
        """The imported module of the study."""
        return import_module(f"mmqa_lab.studies.{self.stem}")

    def bench(self, *, quick=False):
        """The study's comparison of methods, for a quick look with few seeds and small parameters.

        A study that compares nothing is refused with a ValueError.
        """
        make = getattr(self.module, "bench", None)
        if not callable(make):
            raise ValueError(f"Invalid study {self.stem!r}: no bench. Must compare methods.")
        small = {"seeds": range(3)} | self.quick
        known = signature(make).parameters
        return make(**{name: small[name] for name in small if quick and name in known})


_FOLDER = Path(__file__).parent

SMALL = _tables(_FOLDER / "quick.toml")
"""Small parameters of the notebooks, by study: for the tests and for copies for a class."""

_LISTED = _tables(_FOLDER / "catalogue.toml")

STUDIES = tuple(Study(**one) for one in _LISTED["studies"])

TOOLS = tuple(Study(**one) for one in _LISTED["tools"])
"""Notebooks that are tools: they have no answer, no checks and no module."""


def notebooks_folder():
    """Return the folder of the notebooks.

    Raises
    ------
    FileNotFoundError
        If the package was installed without them.
    """
    folder = _shipped("notebooks")
    if not folder.is_dir():
        raise FileNotFoundError(f"Invalid folder {folder}: no notebooks. Must be installed.")
    return folder


def results_folder(notebooks):
    """Return where full runs go: beside the notebooks, or here where these are installed."""
    own = (notebooks.parent / "pyproject.toml").is_file()
    return (notebooks if own else Path.cwd()) / "results"


def chosen(names=()):
    """Return the studies with these stems or notebook names, in the catalogue's order; all if none.

    Examples
    --------
    >>> [study.notebook for study in chosen(["chart_tables"])]
    ['01_chart_tables']
    """
    known = tuple(study.stem for study in STUDIES)
    stems = [Path(name).stem.lstrip("0123456789_") for name in names]
    for stem in stems:
        check_choice(stem, "study", known)
    return [study for study in STUDIES if study.stem in stems or not stems]
