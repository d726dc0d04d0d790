"""Run the studies: every notebook of the catalogue, without a screen.

Each study runs in a kernel of its own and leaves its tables, figures, named values and a page under
notebooks/results/, as they arrive; index.html there shows them all. Results of --quick go to
notebooks/results/quick/. A study that fails does not stop the others. The exit status is 1 where a
study failed or, with the delivered parameters, a check did not pass.
"""

from pathlib import Path

SUMMARY = "run the studies and write their tables, figures and pages"

EPILOG = """\
example:
  mmqa studies
  mmqa studies chart_tables anisotropy --quick
  mmqa studies --resume
"""


def add_arguments(parser):
    """Declare the arguments."""
    parser.add_argument("name", nargs="*", metavar="NAME", help="stems of studies; all if none")
    parser.add_argument("--quick", action="store_true", help="small parameters, for a first look")
    parser.add_argument(
        "--resume", action="store_true", help="skip studies that ended with the same code"
    )
    parser.add_argument("--timeout", type=float, metavar="SECONDS", help="of a study; default none")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="default notebooks/results")


def run(options):
    """Run the chosen studies one after the other, with a closing line for each."""
    from tqdm import tqdm

    from mmqa_lab.run import notebooks, pages
    from mmqa_lab.studies.catalogue import STUDIES, chosen, notebooks_folder

    usual = notebooks_folder() / "results"
    folder = (options.out or (usual / "quick" if options.quick else usual)).resolve()
    outcomes = []
    with tqdm(chosen(options.name), unit="study", desc="studies") as bar:
        for study in bar:
            bar.set_description(study.stem)
            done = notebooks.finished(study, folder, quick=options.quick)
            outcome = (
                done
                if options.resume and done
                else notebooks.run_study(
                    study, folder, quick=options.quick, timeout=options.timeout
                )
            )
            pages.write_pages(
                folder, STUDIES, [notebooks.read_outcome(folder / s.stem) for s in STUDIES]
            )
            outcomes.append(outcome)
            bar.write(f"{study.notebook:<24} {outcome.seconds:6.1f} s  {outcome.verdict}")
    print(f"Results: {folder / 'index.html'}")
    return 0 if all(outcome.ok and (outcome.quick or outcome.true) for outcome in outcomes) else 1
