"""Table 1 from images: systems A, B and C predicted, fitted, photographed and compared.

``predicted`` has the specifications and the limit of line pairs, ``fitted`` point spreads and
motion, ``rendered`` photographs and reads the chart, ``comparisons`` sets everything side by side,
``legible`` holds legibility, ``drawings`` draws and ``findings`` says what holds.
"""

from mmqa_lab.studies.chart_images.comparisons import (
    compare,
    photographed,
    pixel_sizes,
    scenarios,
    side_by_side,
    widths,
)
from mmqa_lab.studies.chart_images.drawings import (
    draw_contrast,
    draw_crops,
    draw_finer,
    draw_photo,
    draw_pixel_sizes,
    draw_spread_trials,
    draw_widths,
)
from mmqa_lab.studies.chart_images.findings import checks
from mmqa_lab.studies.chart_images.fitted import (
    best_spread,
    fit_systems,
    one_spread,
    same_spread,
)
from mmqa_lab.studies.chart_images.legible import (
    IndexFit,
    fit_index,
    jury_crops,
    jury_of,
    legibility,
    readable,
    text_crops,
)
from mmqa_lab.studies.chart_images.predicted import (
    TYPICAL_SIGMA_PX,
    geometry,
    ladder_widths,
    limits_mm,
    pair_limit,
    pair_limits,
    steps_between,
    width_cells,
)
from mmqa_lab.studies.chart_images.rendered import (
    evaluate,
    finer_chart,
    photograph,
    photographs,
    readings,
    specified,
)

QUICK = {
    "photographed_systems": ["C"],
    "photographed_distances": [10],
    "photos_per_row": 1,
    "spreads_px": [0.4, 0.7, 1.0],
    "motions_px": [0, 2, 4],
}
"""For the tests: parameters of the notebook."""

__all__ = [
    "QUICK",
    "TYPICAL_SIGMA_PX",
    "IndexFit",
    "best_spread",
    "checks",
    "compare",
    "draw_contrast",
    "draw_crops",
    "draw_finer",
    "draw_photo",
    "draw_pixel_sizes",
    "draw_spread_trials",
    "draw_widths",
    "evaluate",
    "finer_chart",
    "fit_index",
    "fit_systems",
    "geometry",
    "jury_crops",
    "jury_of",
    "ladder_widths",
    "legibility",
    "limits_mm",
    "one_spread",
    "pair_limit",
    "pair_limits",
    "photograph",
    "photographed",
    "photographs",
    "pixel_sizes",
    "readable",
    "readings",
    "same_spread",
    "scenarios",
    "side_by_side",
    "specified",
    "steps_between",
    "text_crops",
    "width_cells",
    "widths",
]
