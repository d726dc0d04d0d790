"""Results of a study's run: tables, figures, values, checks, and a record of the run."""

from importlib.util import find_spec

from mmqa_lab._checks import needs

for part in ("IPython", "nbformat", "nbclient", "nbconvert", "jinja2", "latex2mathml"):
    if not find_spec(part):  # imported where it is used: a kernel does without 3 s of nbformat
        needs("lab", part)

from mmqa_lab.run.results import Run, parameter_names, read_record, verdict, write_record

__all__ = ["Run", "parameter_names", "read_record", "verdict", "write_record"]
