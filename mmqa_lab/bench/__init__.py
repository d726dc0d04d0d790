"""Methods compared on cases of known truth: any function of the data enters any study.

:func:`run` measures every method on every case and seed, :func:`rank`, :func:`compare` and
:func:`summary` say how the methods differ and how surely, :func:`failures` says what could not be
measured and why. A study is a :class:`Comparison`: its cases, methods, tables and figures.
"""

from mmqa_lab.bench.running import Comparison, grid, run
from mmqa_lab.bench.tables import cell_table, compare, failures, figure_names, rank, summary

__all__ = [
    "Comparison",
    "cell_table",
    "compare",
    "failures",
    "figure_names",
    "grid",
    "rank",
    "run",
    "summary",
]
