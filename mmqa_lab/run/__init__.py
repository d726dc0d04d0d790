"""Running the studies: results of a run, notebooks without a screen, pages, students' copies."""

from mmqa_lab.run.results import FORMATS, KINDS, Check, Run, parameter_names, results_folder

__all__ = ["FORMATS", "KINDS", "Check", "Run", "parameter_names", "results_folder"]
