"""The pages of a run in Chromium: WCAG 2.1 AA by axe, and the answers on the first screen."""

import shutil
from pathlib import Path

import matplotlib.pyplot as plt
import nbformat
import pandas as pd
import pytest

from mmqa_lab.published.ledger import entry
from mmqa_lab.run import Run, notebooks, pages
from mmqa_lab.run.students import PYTHON
from mmqa_lab.studies import STUDIES

RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa"]

CODE = "import pandas as pd\npd.DataFrame({'a': [x for x in range(3) if x in (1, 2)]})  # why"


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of a run of all studies, each with a figure, tables, checks and a page."""
    folder = tmp_path_factory.mktemp("site")
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("MMQA_RESULTS", str(folder))
        write_study(STUDIES[0], folder / STUDIES[0].stem)
    once = shutil.ignore_patterns("ledger.csv")
    for study in STUDIES[1:]:
        shutil.copytree(folder / STUDIES[0].stem, folder / study.stem, ignore=once)
    pages.write_pages(folder, STUDIES)
    return folder


def write_study(study, folder):
    """What a run of a study leaves."""
    run = Run(study.stem, parameters={"seed": 1})
    figure, ax = plt.subplots(figsize=(3.3, 2.4))
    ax.plot([1, 2])
    run.save_figure(figure, "seen", seen="A line.")
    tables, figures = {"F": pd.DataFrame({"f": [2.0]})}, {"A line": figure}
    pages.write_report(folder / "report.html", title="Report", tables=tables, figures=figures)
    plt.close(figure)
    run.save_answer("f is 2 on a lattice that is stretched by 2. " * 5, figure="seen")
    run.save_ledger([entry("pfeifer2021", "table_2", "A 5 m d1", 4.2, kind="measured", note="A.")])
    run.check("f is 2.", True, "f = 2.0", "digits")
    run.check("g is 2.", False, "3", "")
    run.finish()
    table = {"text/html": pd.DataFrame({f"column_{k}_m": [k] for k in range(40)}).to_html()}
    output = nbformat.v4.new_output("display_data", data=table)
    text = nbformat.v4.new_markdown_cell("# Title\n\nWhere $d_0 = \\sqrt{1/\\rho_0}$.\n\n## Part")
    cells = [text, nbformat.v4.new_code_cell(CODE, outputs=[output])]
    notebook = nbformat.v4.new_notebook(cells=cells, metadata={"language_info": PYTHON})
    page = pages.notebook_page(notebook, study.title, figures={})
    (folder / f"{study.stem}.html").write_text(page, encoding="utf-8")
    notebooks.write_outcome(
        pages.Outcome(study.stem, False, failure="", checks=2, passed=1), folder
    )


@pytest.fixture
def opened(browser, site):
    """Open a page of the run."""
    page = browser.new_page(viewport={"width": 1400, "height": 1000})

    def open_page(name):
        """The page with all its parts unfolded."""
        page.goto((site / name).as_uri())
        page.evaluate("document.querySelectorAll('details').forEach(one => one.open = true)")
        return page

    yield open_page
    page.close()


@pytest.mark.parametrize(
    "name",
    [
        "index.html",
        "ledger.html",
        "glossary.html",
        "chart_tables/chart_tables.html",
        "chart_tables/report.html",
    ],
)
def test_axe_finds_nothing(opened, name):
    axe = pytest.importorskip("axe_playwright_python", reason="needs axe-playwright-python")
    page = opened(name)
    page.evaluate((Path(axe.__path__[0]) / "axe.min.js").read_text(encoding="utf-8"))
    found = page.evaluate("rules => axe.run(document, {runOnly: rules})", RULES)
    assert len(found["passes"]) > 5
    assert [(one["id"], one["nodes"][0]["html"]) for one in found["violations"]] == []


def test_all_answers_are_on_the_first_screen(opened):
    page = opened("index.html")
    answers = page.locator(".answers li")
    assert answers.count() == len(STUDIES)
    lowest = max(box["y"] + box["height"] for box in (one.bounding_box() for one in answers.all()))
    assert lowest < 1000


def test_the_index_is_worked_by_keys(opened):
    page = opened("index.html")
    page.keyboard.press("Tab")
    seen = set()
    for _ in range(4):
        page.keyboard.press("Tab")
        seen.add(page.evaluate("document.activeElement.getAttribute('href')"))
    assert "#chart_tables" in seen
