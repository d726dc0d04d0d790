"""The pages of a run in Chromium: answers on the first screen, ledger and glossary on a phone."""

import base64
import re
import shutil

import matplotlib.pyplot as plt
import nbformat
import pandas as pd
import pytest

from mmqa_lab.published.ledger import entries
from mmqa_lab.run import Run, pages
from mmqa_lab.studies import STUDIES

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
    tables, figures = {"F": pd.DataFrame({"f": [2.0]})}, {"A line": run.folder / "seen.png"}
    pages.write_report(folder / "report.html", title="Report", tables=tables, figures=figures)
    plt.close(figure)
    run.save_answer("f is 2 on a lattice that is stretched by 2. " * 5, figure="seen")
    row = {"source": "pfeifer2021", "table": "table_2", "cell": "A 5 m d1", "value": 4.2}
    run.save_ledger(entries([row], kind="measured", note="A."))
    run.check("f is 2.", True, "f = 2.0", "digits")
    run.check("g is 2.", False, "3", "")
    run.finish()
    table = {"text/html": pd.DataFrame({f"column_{k}_m": [k] for k in range(40)}).to_html()}
    output = nbformat.v4.new_output("display_data", data=table)
    text = nbformat.v4.new_markdown_cell("# Title\n\nWhere $d_0 = \\sqrt{1/\\rho_0}$.\n\n## Part")
    drawn = base64.b64encode((run.folder / "seen.png").read_bytes()).decode()
    drawn = nbformat.v4.new_output("display_data", data={"image/png": drawn})
    shown = nbformat.v4.new_code_cell('run.save_figure(f, "a", seen="A line that rises.")')
    shown.outputs = [drawn]
    cells = [text, nbformat.v4.new_code_cell(CODE, outputs=[output]), shown]
    page = pages.notebook_page(nbformat.v4.new_notebook(cells=cells), study.title)
    (folder / "seen.html").write_text(page, encoding="utf-8")


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


def test_all_answers_are_on_the_first_screen(opened):
    page = opened("index.html")
    answers = page.locator(".answers li")
    assert answers.count() == len(STUDIES)
    lowest = max(box["y"] + box["height"] for box in (one.bounding_box() for one in answers.all()))
    assert lowest < 1000


@pytest.mark.parametrize("name", ["index.html", "ledger.html", "glossary.html"])
def test_pages_are_as_wide_as_a_phone(opened, name):
    page = opened(name)
    page.set_viewport_size({"width": 390, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


@pytest.mark.parametrize(
    "name", ["index.html", "ledger.html", "glossary.html", "api.html", "chart_tables/report.html"]
)
def test_pages_have_no_barrier(opened, barriers, name):
    assert not barriers(opened(name))


def test_the_index_has_no_barrier_by_night(opened, barriers):
    page = opened("index.html")
    page.emulate_media(color_scheme="dark")
    assert not barriers(page)


def test_a_page_of_a_notebook_has_no_barrier(opened, barriers):
    page = opened(f"{STUDIES[0].stem}/seen.html")
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        assert not barriers(page)
    assert page.locator("img").get_attribute("alt") == "A line that rises."


@pytest.mark.parametrize(
    ("name", "width"),
    [("index.html", 700), ("ledger.html", 1030), ("glossary.html", 700), ("api.html", 700)],
)
def test_pages_print_and_need_no_network(opened, name, width):
    """On A4, the wide ledger across, without its box to type in, no word cut in two."""
    page = opened("index.html")
    asked = []
    page.on("request", lambda request: asked.append(request.url))
    page = opened(name)
    assert asked
    assert all(url.startswith(("file:", "data:")) for url in asked)
    page.emulate_media(media="print")
    page.set_viewport_size({"width": width, "height": 900})
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert not page.locator("input").all() or page.locator("input").is_hidden()
    pages_of = page.pdf(prefer_css_page_size=True, format="A4")
    box = re.search(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", pages_of)
    assert (float(box[1]) > float(box[2])) == (name == "ledger.html")
    if name == "ledger.html":
        first = "#rows tbody tr:first-child td:nth-child({})"
        lines = "one => one.clientHeight"
        heights = [page.locator(first.format(k)).evaluate(lines) for k in (1, 2, 8, 9)]
        assert max(heights) < 20  # each word on one line
