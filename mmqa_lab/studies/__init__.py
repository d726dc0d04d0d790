"""The studies, one module per notebook, and their list, read from a TOML file."""

from dataclasses import dataclass, field
from importlib import import_module
from inspect import signature
from pathlib import Path

from mmqa_lab._checks import check_choice
from mmqa_lab._data import read_toml, shipped_folder

__all__ = ["SIZES", "STUDIES", "TOOLS", "Study", "chosen", "notebooks_folder", "results_folder"]

SIZES = {
    "quick": "Quick run: small parameters, for a first look",
    "middle": "Middle size: fewer cases, intervals up to twice as wide",
    "full": "Full run, as the notebooks store it",
}
"""How much of a study a run works out."""


@dataclass(frozen=True)
class Study:
    """A study: its notebook, its module, its question and its source."""

    number: int
    stem: str
    title: str
    question: str
    source: str
    tables: tuple = ()
    """Source and name of the printed tables that its ledger answers."""
    quick: dict = field(default_factory=dict)
    """Small parameters of its notebook, for tests and for students' copies."""
    middle: dict = field(default_factory=dict)
    """Parameters of its notebook with fewer cases."""

    @property
    def notebook(self):
        """Name of the notebook without its ending."""
        return f"{self.number:02d}_{self.stem}"

    @property
    def path(self):
        """Path of the notebook."""
        return notebooks_folder() / f"{self.notebook}.ipynb"

    def bench(self, *, quick=False):
        """Return the study's comparison of methods; ``quick`` takes few seeds and small cases."""
        make = import_module(f"mmqa_lab.studies.{self.stem}").bench
        small = {"seeds": range(3)} | self.quick if quick else {}
        return make(**{name: small[name] for name in signature(make).parameters if name in small})


_LISTED = read_toml(Path(__file__).with_name("catalogue.toml"))
_OF_SIZE = {size: read_toml(Path(__file__).with_name(f"{size}.toml")) for size in [*SIZES][:2]}

STUDIES = tuple(
    Study(**row, **{size: given.get(row["stem"], {}) for size, given in _OF_SIZE.items()})
    for row in _LISTED["studies"]
)

TOOLS = tuple(Study(**row) for row in _LISTED["tools"])
"""Notebooks that are tools: they have no answer, no checks and no module."""


def notebooks_folder():
    """Return the folder of the notebooks.

    Raises
    ------
    FileNotFoundError
        If the package was installed without them.
    """
    folder = shipped_folder("notebooks")
    if not folder.is_dir():
        raise FileNotFoundError(f"Invalid folder {folder}: no notebooks. Must be installed.")
    return folder


def results_folder(notebooks):
    """Return the folder of full runs: beside the notebooks or, if installed, in this folder."""
    own = (notebooks.parent / "pyproject.toml").is_file()
    return (notebooks if own else Path.cwd()) / "results"


def chosen(names=()):
    """Return the studies with these stems or notebook names, in the catalogue's order.

    Without names it returns all studies.

    Examples
    --------
    >>> [study.notebook for study in chosen(["chart_tables"])]
    ['01_chart_tables']
    """
    known = tuple(study.stem for study in STUDIES)
    plain = (Path(name).stem.lstrip("0123456789_") for name in names)
    stems = [check_choice(stem, "study", known) for stem in plain]
    return [study for study in STUDIES if study.stem in stems or not stems]
