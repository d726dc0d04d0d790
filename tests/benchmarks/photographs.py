"""Photographs of charts behind fences, mirrored, blurred, with seams: found, covered, said.

``PYTHONPATH=tests:tests/benchmarks python tests/benchmarks/photographs.py`` writes its section of
RESULTS.md; ``--size`` is the number of seeds. ``--good N`` looks at N photographs of which nothing
need be said instead.
"""

import argparse
import re

import cv2
import numpy as np
import pandas as pd
from camera import CONDITIONS, linear, shoot
from results import write_section

from mmqa_lab import chart_image, charts

CHART = charts.imaging_chart()


def strips(axes, half, step):
    """Wires or bars across a chart, mm: along which axes, half as wide, so far apart."""
    return {"strips": tuple((axis, at, half) for axis in axes for at in range(30, 1000, step))}


KINDS = {
    "plain": {},
    **{name: CONDITIONS[name] for name in ("oblique 30", "phone", "vignette", "noise 5")},
    **{name: CONDITIONS[name] for name in ("shadow 75", "rolling 6 %", "motion 4", "motion 8")},
    **{f"blur {sigma}": {"blur": sigma} for sigma in (1.2, 1.6, 2.0, 3.0)},
    "wires of 10 mm, 20 %": strips((0,), 5.0, 50),
    "mesh of 10 mm, 20 %": strips((0, 1), 5.0, 100),
    "bars of 40 mm, 20 %": strips((0,), 20.0, 200),
    "bars of 30 mm, 15 %, level": strips((1,), 15.0, 200),
    "mirrored": {},
    "glare": {},
    "seam of 1 px": {},
    "chroma noise": {},
}
"""Conditions of the tests' camera, or the name of a change of the photograph."""


def changed(name, image, rng):
    """The photograph after a change of that name."""
    if name == "mirrored":
        return np.ascontiguousarray(image[:, ::-1])
    if name == "glare":  # a lamp beside the chart, spread by the lens over a fifth of the image
        y, x = np.indices(image.shape[:2])
        at = rng.uniform(0, 1, 2) * image.shape[:2]
        away = np.hypot(y - at[0], x - at[1]) / max(image.shape[:2])
        light = (image / 255.0) ** 2.2 + 0.8 * np.exp(-away / 0.2)[..., None]
        return np.uint8(255 * np.clip(light, 0, 1) ** (1 / 2.2))
    if name == "seam of 1 px":
        middle = image.shape[1] // 2
        return np.concatenate([image[:, :middle], np.roll(image[:, middle:], 1, axis=0)], axis=1)
    if name == "chroma noise":
        tint = 25 * rng.standard_normal((*image.shape[:2], 3))
        tint -= tint.mean(axis=2, keepdims=True)
        return np.uint8(np.clip(image + cv2.GaussianBlur(tint, (0, 0), 1.0) * 2, 0, 255))
    return image


def read(name, pixel_mm, seed):
    """What is found in a photograph, its errors and what is said."""
    shot = shoot(CHART, pixel_mm, seed=seed, margin=0.3, **KINDS[name])
    image = changed(name, shot.image, np.random.default_rng(seed))
    row = {"kind": name, "photographs": 1, "found": 0, "sizes": 0}
    try:
        there = chart_image.locate(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), CHART)
        quality = chart_image.evaluate_image(linear(image), CHART, there)
    except ValueError as error:
        return row | {"named mirrored": int("mirrored" in str(error))}
    said = "; ".join(quality.remarks)
    row |= {"found": 1, "hidden said": int("hidden: " in said), "end": int("an end is" in said)}
    row["gamma"] = int("gamma" in said)
    steps = [shot.steps(CHART, quality.resolution(one).width_mm, one) for one in "hv"]
    steps = np.array([one for one in steps if one is not None])
    row |= {"finer": int((steps > 0).sum()), "two coarse": int((steps < -1).any())}
    row["two coarse, silent"] = int((steps < -1).any() and not said)
    for direction in "hv":
        bars = [CHART[one] for one in quality.sizes.query("direction == @direction")["name"]]
        truth = sum(max(bar.width, bar.height) for bar in bars) / sum(map(shot.length, bars))
        size, sigma = quality.pixel_size(direction)
        if np.isfinite(size):
            row["sizes"] += 1
            row["covered"] = row.get("covered", 0) + int(abs(size - truth) < 1.96 * sigma)
            row["error (%)"] = row.get("error (%)", 0) + 100 * (size / truth - 1)
            row["half interval (%)"] = row.get("half interval (%)", 0) + 196 * sigma / size
    return row


GOOD = (
    *("base", "oblique 30", "oblique 50", "oblique 40+30", "panorama", "rolling 6 %"),
    *("rolling shear", "vignette", "jpeg 60", "motion 2", "noise 5", "blur 1.2", "white board"),
    *("dark", "mono"),
)
"""Conditions of which nothing need be said."""


def good(count):
    """How often each thing is said of photographs of which nothing need be said."""
    said = []
    for draw in range(count):
        rng = np.random.default_rng([8, draw])
        name, pixel_mm = GOOD[draw % len(GOOD)], rng.uniform(2.5, 8)
        shot = shoot(CHART, pixel_mm, seed=draw, **{"margin": 0.3, **CONDITIONS[name]})
        grey = shot.image if shot.image.ndim == 2 else cv2.cvtColor(shot.image, cv2.COLOR_BGR2GRAY)
        try:
            there = chart_image.locate(grey, CHART)
            told = chart_image.evaluate_image(shot.linear, CHART, there).remarks
        except ValueError as error:
            told = [str(error)]
        print(f"{name}, {pixel_mm:.2f} mm, seed {draw}:", *told) if told else None
        said += [(draw, re.split(r"[:;]|\d", one)[0].strip() or one) for one in told]
    rows = pd.DataFrame(said, columns=["photograph", "what is said"])
    table = rows.groupby("what is said")["photograph"].nunique()
    table["anything"] = rows["photograph"].nunique()
    write_section("Chart images: false alarms", table.to_frame("photographs").assign(of=count))


def main():
    """Write the section of photographs of new kinds."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=1, help="seeds of each kind and pixel size")
    parser.add_argument("--good", type=int, help="number of photographs without a fault instead")
    options = parser.parse_args()
    if options.good:
        good(options.good)
        return
    seeds = options.size
    cases = [(kind, mm, seed) for kind in KINDS for mm in (2.7, 4.0, 6.0, 8.0)
             for seed in range(seeds)]  # fmt: skip
    rows = pd.DataFrame([read(*case) for case in cases])
    table = rows.groupby("kind", sort=False).sum()
    for name in ("error (%)", "half interval (%)"):
        table[name] /= table["sizes"].where(table["sizes"] > 0)
    write_section("Chart images: photographs of other kinds", table.reset_index())


if __name__ == "__main__":
    main()
