"""Open JupyterLab in the folder of the notebooks."""

SUMMARY = "open the notebooks in JupyterLab"

EPILOG = """\
example:
  mmqa lab
  mmqa lab -- --no-browser --port 8890
"""


def add_arguments(parser):
    """Declare the arguments."""
    parser.add_argument("jupyter", nargs="*", metavar="OPTION", help="handed to jupyter lab")


def run(options):
    """Start JupyterLab and wait for it."""
    import subprocess
    import sys

    from mmqa_lab.studies.catalogue import notebooks_folder

    command = [sys.executable, "-m", "jupyterlab", *options.jupyter]
    return subprocess.call(command, cwd=notebooks_folder())
