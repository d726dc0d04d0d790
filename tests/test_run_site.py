"""The static site of the stored notebooks, and the page of public names."""

import importlib
import re

import nbformat
import pytest

from mmqa_lab.__main__ import main
from mmqa_lab.metrics import METRICS
from mmqa_lab.run.notebooks import execute
from mmqa_lab.run.pages import public_names
from mmqa_lab.studies import STUDIES, TOOLS


def test_public_names_are_those_that_can_be_imported():
    names = public_names()
    assert len(names) > 150
    assert (names["purpose"].str.len() > 10).all()
    assert not names["purpose"].str.contains("`").any()
    for module, part in names.groupby("module"):
        assert set(part["name"]) <= set(dir(importlib.import_module(module)))


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    assert main(["studies", "mimic", "--site", str(folder)]) == 0
    return folder


def test_a_site_opens_from_a_file_without_a_network(site):
    listed = {"05_mimic.html", "api.html", "glossary.html", "index.html", "notebook.css"}
    assert listed <= {path.name for path in site.iterdir()}
    for page in site.glob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert not re.search(r"<(script|link|img)[^>]+(src|href)=.https?:", text)
    assert sum(path.stat().st_size for path in site.rglob("*")) < 15e6 / len((*STUDIES, *TOOLS)) * 4


def test_links_between_pages_of_a_site_resolve(site):
    whole = {f"{study.notebook}.html" for study in (*STUDIES, *TOOLS)}
    for page in site.glob("*.html"):
        for link in re.findall(r'(?:href|src)="([^"#:]+)["#]', page.read_text(encoding="utf-8")):
            assert link in whole or (site / link).is_file(), f"{page.name}: {link}"


def test_metric_cards_run_and_show_every_card(tmp_path):
    cards = next(study for study in TOOLS if study.stem == "metric_cards")
    notebook = nbformat.read(cards.path, as_version=4)
    assert execute(notebook, cards.path.parent, results=tmp_path) == ""
    texts = [cell.source for cell in notebook.cells]
    outputs = [one for cell in notebook.cells for one in cell.get("outputs", [])]
    texts += [
        one["data"]["text/markdown"] for one in outputs if "text/markdown" in one.get("data", ())
    ]
    titles = {text.split("\n")[0].lstrip("# ") for text in texts if text.startswith("##")}
    assert titles >= {*METRICS, "Pixel size at the object", "MTF50", "Siemens star"}
