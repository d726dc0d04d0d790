"""Insert the answers of the last full run of all studies, and its key figure, into the README.

For those who change a study: nothing in that table is typed. The ledger's counts and figure are
inserted too. With --check nothing is written; the exit status is 1 where the README differs.
"""

from pathlib import Path

SUMMARY = "insert the studies' answers into the README"

EPILOG = """\
example:
  mmqa studies && mmqa readme
  mmqa readme --check
"""


def add_arguments(parser):
    """Declare the arguments."""
    parser.add_argument("--results", type=Path, metavar="FOLDER", help="default notebooks/results")
    parser.add_argument("--check", action="store_true", help="only say whether it is up to date")


def run(options):
    """Write the README, or compare."""
    from mmqa_lab.io import write_atomically
    from mmqa_lab.run import pages, readme
    from mmqa_lab.run.results import write_text
    from mmqa_lab.studies.catalogue import STUDIES, notebooks_folder

    notebooks = notebooks_folder()
    folder, path = options.results or notebooks / "results", notebooks.parent / "README.md"
    text = path.read_text(encoding="utf-8")
    new = readme.replaced(text, "studies", readme.studies_table(folder, STUDIES))
    ledger = pages.read_ledger(folder)
    if ledger is not None:
        new = readme.replaced(new, "ledger", readme.ledger_table(ledger))
    if options.check:
        return 0 if new == text else 1
    write_text(path, new)
    picture = (folder / readme.KEY_FIGURE).read_bytes()
    write_atomically(notebooks / "key_figure.png", lambda file: file.write_bytes(picture))
    if ledger is not None:
        figure = readme.ledger_figure(ledger)
        write_atomically(notebooks / "ledger.png", lambda file: figure.savefig(file, dpi=150))
    return 0
