"""Charts in photographs of known truth: found, read, and whether aliases are accepted.

``PYTHONPATH=tests:tests/benchmarks python tests/benchmarks/images.py`` writes its sections of
RESULTS.md; ``--seeds``, ``--patterns`` and ``--draws`` make it smaller, 0 leaves a section out.
"""

import argparse

import numpy as np
import pandas as pd
from camera import CONDITIONS, shoot
from covered import ESTIMATES, shares, simulated
from rendered import pattern_case
from results import write_section

from mmqa_lab import bench, chart_image, charts, io, samples
from mmqa_lab.studies import image_resolution

CHART = charts.imaging_chart()

CLASSES = {
    "true, 3.2 to 8 px": lambda r: {"width_px": r.uniform(3.2, 8)},
    "below Nyquist": lambda r: {"width_px": r.uniform(1.1, 2), "sigma": 0.4},
    "beats, 2 to 2.3 px": lambda r: {"width_px": r.uniform(2, 2.3), "sigma": 0.4},
    "reversed by defocus": lambda r: {"width_px": 5.0, "sigma": 0.3, "defocus": r.uniform(3.5, 5)},
    "reversed by motion": lambda r: {"width_px": 5.0, "sigma": 0.4, "travel": r.uniform(1.25, 1.7)},
    "blurred away, noise 5 %": lambda r: {"width_px": 3.0, "sigma": 2.0, "noise": 0.032},
    "6, 7, 9 or 12 bars": lambda r: {"width_px": 6.0, "seen": int(r.choice([6, 7, 9, 12]))},
}


INTERVALS = (
    *("edge of an image", "Siemens star", "sensor calibration", "reflectance"),
    *("NDVI", "radiometric block"),
)
"""Estimates of images."""


def photograph(condition, pixel_mm, seed, background):
    """What is read in one photograph as errors against its truth; None for a cut chart."""
    view = {"seed": seed, "background": background, **CONDITIONS[condition]}
    shot = shoot(CHART, pixel_mm, **view)
    outline = shot.pixels(CHART.corners())
    if (outline < 0).any() or (outline > np.array(shot.image.shape[1::-1]) - 1).any():
        return None
    row = {"pixel_mm": pixel_mm, "charts": 1, "found": 0}
    grey = shot.image if shot.image.ndim == 2 else shot.image @ np.array([0.114, 0.587, 0.299])
    try:
        there = chart_image.locate(grey, CHART)
        quality = chart_image.evaluate_image(shot.linear, CHART, there)
    except ValueError:
        return row
    steps = [shot.steps(CHART, quality.resolution(one).width_mm, one) for one in "hv"]
    steps = [abs(one) <= 1 for one in steps if one is not None]
    resolved = quality.pairs[quality.pairs["resolved"]]["name"]
    truth = [shot.contrast(CHART[name]) for name in resolved]
    bars = quality.sizes.dropna(subset=["length_px"])
    errors = bars["length_px"] - [shot.length(CHART[name]) for name in bars["name"]]
    row |= {"found": 1, "widths": len(steps), "near": sum(steps), "bars": len(bars)}
    row["aliases"] = sum(contrast < 0.05 or width < 2 for contrast, width in truth)
    row["covered"] = (errors.abs() < 1.96 * bars["length_sigma_px"]).sum()
    return row | {"squares": (errors**2).sum()}


def photographs(seeds):
    """Charts of the tests' camera: found, read, lengths covered."""
    real = samples.has_real("images")
    background = io.read_image(samples.real_path("images/panorama.jpg")) if real else None
    cases = [(c, p, s) for p in (2.7, 5.4, 8, 10) for c in CONDITIONS for s in range(seeds)]
    rows = pd.DataFrame(filter(None, (photograph(*case, background) for case in cases)))
    total = pd.concat([rows.groupby("pixel_mm").sum(), rows.sum().to_frame("all").T.iloc[:, 1:]])
    table = total[["charts", "found", "widths", "aliases"]].astype(int)
    table["within one step"] = total["near"] / total["widths"]
    table["lengths covered"] = total["covered"] / total["bars"]
    table["length error (px, rms)"] = np.sqrt(total["squares"] / total["bars"])
    write_section("Chart images: photographs", table.rename_axis("pixel (mm)").reset_index())


def line_pairs(patterns):
    """Patterns that are there, and those that are not."""
    accepted = {}
    for name, case in CLASSES.items():
        rng = np.random.default_rng(5)
        readings = [pattern_case(**case(rng), rng=rng) for _ in range(patterns)]
        accepted[name] = sum(reading.resolved for reading in readings)
    frame = pd.DataFrame({"pattern": accepted.keys(), "accepted": accepted.values()})
    write_section("Chart images: line pairs", frame.assign(of=patterns))


def intervals(draws):
    """Coverage of edges, stars, sensors, reflectances, blocks; errors of edges by lens."""
    chosen = [one for one in ESTIMATES if one.name in INTERVALS]
    parts = [shares(one, simulated(one, draws)) for one in chosen]
    write_section("Images: intervals", pd.concat(parts))
    edges = image_resolution.bench(noises=(0.01,), seeds=range(max(draws // 5, 1))).run()
    errors = bench.cell_table(edges).groupby(["method", "lens"], sort=False)["mtf50_error_percent"]
    table = pd.DataFrame({"median (%)": errors.median(), "standard deviation (%)": errors.std()})
    write_section("Images: MTF50 of edges", table.assign(n=errors.count()))


def main():
    """Write all tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--patterns", type=int, default=60)
    parser.add_argument("--draws", type=int, default=60)
    options = parser.parse_args()
    for section, size in ((photographs, "seeds"), (line_pairs, "patterns"), (intervals, "draws")):
        if getattr(options, size):
            section(getattr(options, size))


if __name__ == "__main__":
    main()
