"""Run the studies: every notebook of the catalogue, without a screen.

Each study runs in a child process with a time limit for every cell and leaves its tables, figures,
named values and a page under notebooks/results/; index.html there shows them all. A study that
fails does not stop the others; the exit status is then 1.
"""

from pathlib import Path

SUMMARY = "run the studies and write their tables, figures and pages"

EPILOG = """\
example:
  mmqa studies
  mmqa studies chart_tables anisotropy --quick
"""


def add_arguments(parser):
    """Declare the arguments."""
    parser.add_argument("name", nargs="*", metavar="NAME", help="stems of studies; all if none")
    parser.add_argument("--quick", action="store_true", help="small parameters, for a first look")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="default notebooks/results")


def run(options):
    """Run the chosen studies one after the other, with a closing line for each."""
    from tqdm import tqdm

    from mmqa_lab import gallery, headless, results
    from mmqa_lab.studies.catalogue import chosen

    studies = chosen(options.name)
    folder = (options.out or results.root()).resolve()
    failed = 0
    with tqdm(studies, unit="study", desc="studies") as bar:
        for study in bar:
            bar.set_description(study.stem)
            outcome = headless.run_study(study, folder, quick=options.quick)
            gallery.write_index(folder)
            failed += not outcome.ok
            bar.write(f"{study.notebook:<24} {outcome.seconds:6.1f} s  {outcome.verdict}")
    print(f"Results: {folder / 'index.html'}")
    return 1 if failed else 0
