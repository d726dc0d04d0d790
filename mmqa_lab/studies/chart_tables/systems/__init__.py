"""Table 2 from specifications: systems A, B and C predicted, fitted and compared.

``model`` predicts, fits and compares, ``figures`` draws, ``findings`` says what holds.
"""

from mmqa_lab.studies.chart_tables.systems.figures import (
    draw_cap,
    draw_comparison,
    draw_hull_bias,
    draw_pattern,
)
from mmqa_lab.studies.chart_tables.systems.findings import checks, unexplained
from mmqa_lab.studies.chart_tables.systems.model import (
    QUICK,
    SENSORS,
    cap,
    chart_points,
    compare,
    fit,
    hull_bias,
    predict,
    pulses_per_revolution,
    sweep_tilt,
    usual,
)

__all__ = [
    "QUICK",
    "SENSORS",
    "cap",
    "chart_points",
    "checks",
    "compare",
    "draw_cap",
    "draw_comparison",
    "draw_hull_bias",
    "draw_pattern",
    "fit",
    "hull_bias",
    "predict",
    "pulses_per_revolution",
    "sweep_tilt",
    "unexplained",
    "usual",
]
