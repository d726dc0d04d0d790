"""Comparison of methods on cases of known truth; any function of the data can be a method.

:func:`run` measures every method on every case and seed. :func:`rank`, :func:`compare` and
:func:`summary` show how the methods differ, with intervals. :func:`failures` lists cells without
a value and the reasons. A study is a :class:`Comparison` of cases, methods, tables and figures.
"""

from mmqa_lab.bench.comparison import Comparison, grid, run
from mmqa_lab.bench.ranks import compare, plot, plot_tables, rank, summary
from mmqa_lab.bench.tables import cell_table, failures, figure_names, heading, remarked, split_unit

__all__ = [
    "Comparison", "cell_table", "compare", "failures", "figure_names", "grid", "heading", "plot",
    "plot_tables", "rank", "remarked", "run", "split_unit", "summary",
]  # fmt: skip
