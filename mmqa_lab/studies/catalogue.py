"""The list of studies: notebook, module and table row belong together by their stem."""

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from mmqa_lab import _shipped
from mmqa_lab._checks import check_choice


@dataclass(frozen=True)
class Study:
    """One study: a notebook, the module behind it, and what it asks."""

    number: int
    stem: str
    title: str
    question: str
    source: str

    @property
    def notebook(self):
        """Name of the notebook without its ending."""
        return f"{self.number:02d}_{self.stem}"

    @property
    def path(self):
        """Path of the notebook."""
        return notebooks_folder() / f"{self.notebook}.ipynb"

    @property
    def module(self):
        """The imported module of the study."""
        return import_module(f"mmqa_lab.studies.{self.stem}")


STUDIES = (
    Study(
        number=1,
        stem="chart_tables",
        title="Chart metrics",
        question="How good are the point clouds of three systems, measured on a chart, and who "
        "wins the tender?",
        source="Pfeifer et al. 2021, doi:10.3390/rs13020237, Table 2",
    ),
    Study(
        number=2,
        stem="repeatability",
        title="Repeatability",
        question="How much do density, sigma_MAD and f vary when the same chart is selected again?",
        source="Pfeifer et al. 2021, doi:10.3390/rs13020237, section 4.4",
    ),
    Study(
        number=3,
        stem="anisotropy",
        title="Anisotropy",
        question="What does f = d4/d1 measure, and what should a tender ask for instead?",
        source="Pfeifer et al. 2021, doi:10.3390/rs13020237, section 3.3",
    ),
    Study(
        number=4,
        stem="lhd_weight",
        title="Line-segment Hausdorff distance",
        question="Is W = 10 the right weight, and does the distance show the displacement?",
        source="Poreba and Goulette 2013, hal-00846334",
    ),
    Study(
        number=5,
        stem="mimic",
        title="MIMIC",
        question="Which points will a scanner lay on a wall: predicted beforehand, measured after?",
        source="Cahalane et al. 2014, doi:10.3390/s140609471",
    ),
    Study(
        number=6,
        stem="poles",
        title="Poles",
        question="How many poles along a street does a method find, and how many finds are poles?",
        source="EuroSDR 2013, mobile laser scanning, Tables 4-1 and 4-2",
    ),
    Study(
        number=7,
        stem="test_field",
        title="Test-field accuracy",
        question="How accurate are heights and positions on a test field, and after calibration?",
        source="EuroSDR 2013, mobile laser scanning, chapter 3",
    ),
    Study(
        number=8,
        stem="image_radiometry",
        title="Image radiometry",
        question="What do a camera's numbers say of resolution and reflectance, and how surely?",
        source="EuroSDR 2013, image radiometry",
    ),
    Study(
        number=9,
        stem="chart_images",
        title="Chart images",
        question="What do photographs of a chart say of a camera, and what does its specification?",
        source="Pfeifer et al. 2021, doi:10.3390/rs13020237, Table 1",
    ),
)


TOOLS = (
    Study(
        number=0,
        stem="your_own_cloud",
        title="Your own cloud",
        question="How good are the points of a surface in a cloud of yours?",
        source="Pfeifer et al. 2021, doi:10.3390/rs13020237, sections 3.3 and 4.2",
    ),
)
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
