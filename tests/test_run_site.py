"""The static site of the stored notebooks, and the page of public names."""

import importlib
import re

import nbformat
import pandas as pd
import pytest

from mmqa_lab.__main__ import main
from mmqa_lab.metrics import METRICS
from mmqa_lab.run.notebooks import execute, show_above
from mmqa_lab.run.pages import public_names
from mmqa_lab.studies import STUDIES, TOOLS, notebooks_folder
from mmqa_lab.studies.fitness.tasks import FREE


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
    first = notebook.cells[0]
    assert sorted(re.findall(r"`(\w+)`", first.source)) == sorted(METRICS)  # its contents
    first.attachments = {"other.png": {"image/png": ""}, "cards-counted.png": {"image/png": ""}}
    show_above(notebook)
    assert [len(one["image/png"]) > 10_000 for one in first.attachments.values()] == [False, True]


def test_the_cards_answer_is_what_the_stored_correlations_say():
    cards = next(study for study in TOOLS if study.stem == "metric_cards")
    said = " ".join(nbformat.read(cards.path, as_version=4).cells[0].source.split())
    table = pd.read_csv(notebooks_folder() / "tasks_by_figures.csv")
    ordered = table[(table["spearman"] >= 0.3) & (table["low"] > 0)]
    free = ordered[ordered["task"].isin({*FREE} - {"pole_missed_percent"})]
    counts = free["method"].value_counts().reindex(list(METRICS), fill_value=0)
    assert (counts["noise_of_a_mean"], len(FREE) - 1) == (7, 8)
    assert "The noise of a mean orders seven of the eight tasks that no metric defines." in said
    alike = [name for name in METRICS if name not in set(ordered["method"])]
    assert len(alike) == 6
    assert "f" in alike
    assert "f and five other metrics of evenness order none of them." in said
