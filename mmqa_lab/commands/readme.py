"""Insert the answers of the last full run of all studies, and its key figure, into the README.

For those who change a study: nothing in that table is typed. With --check nothing is written; the
exit status is 1 where the README differs.
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
    from mmqa_lab import results
    from mmqa_lab.io import write_atomically
    from mmqa_lab.readme import KEY_FIGURE, replaced, studies_table
    from mmqa_lab.studies.catalogue import notebooks_folder

    folder, path = options.results or results.root(), notebooks_folder().parent / "README.md"
    text = path.read_text(encoding="utf-8")
    new = replaced(text, "studies", studies_table(folder))
    if options.check:
        return 0 if new == text else 1
    write_atomically(path, lambda file: file.write_text(new, encoding="utf-8"))
    figure = (folder / KEY_FIGURE).read_bytes()
    write_atomically(notebooks_folder() / "key_figure.png", lambda file: file.write_bytes(figure))
    return 0
