"""Charts in photographs of known truth: found, read, and whether aliases are accepted.

``PYTHONPATH=tests:tests/benchmarks python tests/benchmarks/images.py`` writes its sections of
RESULTS.md, or those named; ``--size`` makes them smaller.
"""

import argparse
import warnings

import numpy as np
import pandas as pd
from camera import CONDITIONS, shoot
from covered import ESTIMATES, shares, simulated
from distorted import Lens
from rendered import pattern_case
from results import write_section
from test_mtf import ODD_EDGES, TAILS, behind_tails, odd_edge, odd_star
from test_radiometry import block

from mmqa_lab import bench, chart_image, charts, io, samples
from mmqa_lab.mtf import fit_edge, measure_star
from mmqa_lab.radiometry import adjust_block
from mmqa_lab.simulate.targets import PointSpread, render_star
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


def errors(quality, length):
    """Relative errors of both pixel sizes, and those in their standard deviations."""
    found = []
    for direction in "hv":
        bars = [CHART[one] for one in quality.sizes.query("direction == @direction")["name"]]
        truth = sum(max(bar.width, bar.height) for bar in bars) / sum(map(length, bars))
        size, sigma = quality.pixel_size(direction)
        found.append((abs(size / truth - 1), abs(size - truth) / sigma))
    return np.array(found)


def photograph(condition, pixel_mm, seed, background):
    """What is read in one photograph as errors against its truth; None for a cut chart."""
    view = {"seed": seed, "background": background, "margin": 0.6, **CONDITIONS[condition]}
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
    steps = np.array([one for one in steps if one is not None])
    resolved = set(quality.pairs[quality.pairs["resolved"]]["name"])
    patterns = CHART.of_kind(charts.LinePairs)
    spurious = {one.name for one in patterns if forbidden(*shot.contrast(one))}
    hidden = {one.name for one in patterns if shot.hidden(one)}
    bars = quality.sizes.dropna(subset=["length_px"])
    lengths = bars["length_px"] - [shot.length(CHART[name]) for name in bars["name"]]
    pixel, scaled = errors(quality, shot.length).T
    row |= {"found": 1, "widths": len(steps), "finer": (steps > 0).sum(), "bars": len(bars)}
    row |= {"near": (np.abs(steps) <= 1).sum(), "spurious": len(spurious), "hidden": len(hidden)}
    row |= {"aliases": len(spurious & resolved), "seen through": len(hidden & resolved)}
    row["covered"] = (lengths.abs() < 1.96 * bars["length_sigma_px"]).sum()
    row |= {"pixel": 100 * np.median(pixel), "pixel covered": (scaled < 1.96).sum() / 2}
    return row | {"squares": (lengths**2).sum()}


def forbidden(contrast, width):
    """Whether a pattern of this contrast and width must not be resolved."""
    return contrast < 0.05 or width < 2


def photographs(seeds):
    """Charts of the tests' camera: found, read, lengths covered."""
    real = samples.has_real("images")
    background = io.read_image(samples.real_path("images/panorama.jpg")) if real else None
    cases = [(c, p, s) for p in (2.7, 5.4, 8, 10) for c in CONDITIONS for s in range(seeds)]
    write_photographs(pd.DataFrame(filter(None, (photograph(*one, background) for one in cases))))


def write_photographs(rows):
    """Counts and errors by the size of a pixel."""
    total = pd.concat([rows.groupby("pixel_mm").sum(), rows.sum().to_frame("all").T.iloc[:, 1:]])
    counts = ["charts", "found", "widths", "finer", "spurious", "aliases", "hidden", "seen through"]
    table = total[counts].astype(int)
    table["within one step"] = total["near"] / total["widths"]
    median = [*rows.groupby("pixel_mm")["pixel"].median(), rows["pixel"].median()]
    table["pixel size (%, median)"] = median
    table["pixel sizes covered"] = total["pixel covered"] / total["found"]
    table["lengths covered"] = total["covered"] / total["bars"]
    table["length error (px, rms)"] = np.sqrt(total["squares"] / total["bars"])
    write_section("Chart images: photographs", table.rename_axis("pixel (mm)").reset_index())


FRAME = {"size": (1200, 1200)}
LENSES = {
    **{
        f"corner {share:+.1%}": {
            **FRAME, "radial": (share, 0.0), "pixel_mm": 0.95 * (1 + 0.9 * max(share, 0))
        }
        for share in (0.015, 0.038, 0.076, 0.15, -0.015, -0.038, -0.076, -0.15)
    },
    "corner -7.6 %, from aside": {
        **FRAME, "radial": (-0.076, 0.0), "turn": (0, 25, 2), "pixel_mm": 1.0
    },
    "tangential, off the axis": {
        "radial": (-0.06, 0.02), "tangential": (0.002, -0.001), "aside": (250, -90),
        "pixel_mm": 1.25,
    },
    "small, in a corner, -15 %": {"radial": (-0.15, 0.03), "aside": (500, -300), "pixel_mm": 2.4},
    **{
        f"board bent by {sag} mm{where}": {**FRAME, "sag": sag, "pixel_mm": 1.3, **how}
        for sag, where, how in (
            (10.0, "", {}),
            (20.0, "", {}),
            (20.0, ", upright", {"axis": 1}),
            (-20.0, ", from 30 degrees", {"turn": (0, 30, 1)}),
            (20.0, ", from 40 degrees", {"turn": (10, 40, 1)}),
            (60.0, ", from 30 degrees", {"turn": (0, 30, 1)}),
        )
    },
    "corner -40 %": {**FRAME, "radial": (-0.4, 0.1), "pixel_mm": 1.0},
}  # fmt: skip
"""Lenses by how far they move the corners of an image, and boards."""


def bent_lines(seeds):
    """Charts through lenses that bend lines, and on bent boards."""
    rows = []
    for name, changes in LENSES.items():
        lens = Lens(**changes)
        for seed in range(seeds):
            image = lens.photograph(CHART, seed=seed)
            row = {"lens or board": name, "seed": seed, "said": ""}
            try:
                there = chart_image.locate(np.uint8(255 * image), CHART)
                quality = chart_image.evaluate_image(image, CHART, there)
            except ValueError as error:
                rows.append(row | {"said": str(error).split(". Must")[0]})
                continue
            for direction, (error, _) in zip("hv", errors(quality, lens.length), strict=True):
                row[f"pixel_{direction} (%)"] = 100 * error
                found = quality.resolution(direction)
                row[f"w_{direction} (px)"] = found.width_mm / quality.pixel_size(direction)[0]
                row[f"w_{direction} (mm)"] = found.width_mm
            rows.append(row | {"said": "; ".join(quality.remarks)})
    write_section("Chart images: bent lines", pd.DataFrame(rows))


def odd_edges(draws):
    """Edges that are not one straight unclipped edge: said, refused, or silent and how wrong."""
    rows = []
    for kind in ("plain", *ODD_EDGES):
        for noise in (0.01, 0.05):
            off, said, refused = [], 0, 0
            for draw in range(draws):
                image, truth = odd_edge(kind, np.random.default_rng(9000 + draw), noise=noise)
                try:
                    found = fit_edge(image)
                except ValueError:
                    refused += 1
                    continue
                said += bool(found.remarks)
                if not found.remarks:
                    off.append(abs(found.mtf50 / truth - 1))
            row = {"edge": kind, "noise": noise, "draws": draws, "refused": refused, "said": said}
            rows.append(row | {"silent": len(off), "largest error (%)": 100 * max(off, default=0)})
    write_section("Images: edges that are odd", pd.DataFrame(rows))


STARS = {
    "as stated": {},
    **{f"{n} cycles for 36": {"cycles": n} for n in (34, 35, 37, 38)},
    "white clipped": {"high": 0.5},
    "black clipped": {"low": 0.2},
    "a third hidden": {"hidden": 2.1},
    **{kind: {"kind": kind} for kind in ("sharpened", "mild", "unlike", "sinusoidal", "bent")},
    **{f"tails of {width:g} px, {share:.0%}": {"tails": (share, width)} for share, width in TAILS},
}
"""Stars of 36 cycles, light 0.1 to 0.6: what is stated, cut off, or hidden (radians); stars of 24
that no lens alone makes."""


def stars(draws):
    """Stars with another number of cycles, clipped or hidden."""
    rows = []
    for name, change in STARS.items():
        row = {"star": name, "draws": draws, "refused": 0, "said": 0, "silent": 0, "off (%)": 0.0}
        for draw in range(draws):
            rng = np.random.default_rng(draw)
            spread, place = PointSpread(rng.uniform(0.5, 1.2)), rng.uniform(-0.5, 0.5, 2)
            image = render_star((150, 150), spread, cycles=36, radius_px=70, centre=place)
            image = behind_tails(image, *change.get("tails", (0, 1)))
            y, x = np.mgrid[:150, :150] - 74.5
            turn = (np.arctan2(y, x) + rng.uniform(0, 6)) % (2 * np.pi)
            image = np.where(turn < change.get("hidden", 0), rng.uniform(0.1, 0.6), image)
            image = image + 0.005 * rng.standard_normal(image.shape)
            image = np.clip(image, change.get("low", -9), change.get("high", 9))
            how = {"cycles": change.get("cycles", 36), "radius_px": 70}
            place = place + 74.5
            if "kind" in change:
                image, spread, place = odd_star(change["kind"], rng), PointSpread(0.8), (84.5, 84.5)
                how = {"cycles": 24, "radius_px": 80}
            try:
                found = measure_star(image, place, **how)
            except ValueError:
                row["refused"] += 1
                continue
            row["said" if found.remarks else "silent"] += 1
            if not found.remarks:
                row["off (%)"] = max(row["off (%)"], 100 * abs(found.mtf50 / spread.mtf50(0) - 1))
        rows.append(row)
    write_section("Images: stars", pd.DataFrame(rows))


BLOCKS = {
    "plain": lambda table, rng: 1.0,
    "falloff of 25 %": lambda table, rng: 1 - 0.25 * table["radius"] ** 2,
    "half an image under a cloud": lambda table, rng: np.where(
        (table["image"] == 5) & (table["azimuth_deg"] > 90), 1 - rng.uniform(0.1, 0.4), 1.0
    ),
    "a control in shadow": lambda table, rng: np.where(
        table["tie"] == 3, rng.uniform(0.4, 0.8), 1.0
    ),
    "a control labelled 1.15 times": lambda table, rng: 1.0,
    "the brightest control labelled 1.15 times": lambda table, rng: 1.0,
    "a control wrong by 3 deviations": lambda table, rng: 1.0,
    "a control wrong by 5 deviations": lambda table, rng: 1.0,
    "a control wrong by 7 deviations": lambda table, rng: 1.0,
}
"""Light that a block does not know of, and a control's wrong label."""


def blocks(draws):
    """Gains of blocks of eight images, six controls: covered where nothing is said, or said.

    That an error of a control cannot be told is no fault of a block, and counted apart.
    """
    rows = []
    for name, light in BLOCKS.items():
        for noise in (0.005, 0.01, 0.02):
            covered, said, blind, quiet = [], [], [], []
            for draw in range(draws):
                rng = np.random.default_rng(500 + draw)
                table, ground, gain = block(rng, noise=noise)
                table["radiance"] *= light(table, rng)
                known = ground[:6] + 0.003 * rng.standard_normal(6)
                wrong = known.argmax() if "brightest" in name else 3
                known[wrong] *= 1.15 if "labelled" in name else 1
                known[3] += 0.003 * int(name.split()[-2]) if "deviations" in name else 0
                control = pd.DataFrame({"tie": range(6), "reflectance": known, "std": 0.003})
                with warnings.catch_warnings(record=True) as told:
                    warnings.simplefilter("always")
                    found = adjust_block(table, control=control).gains
                untold = ["cannot be told" in str(one.message) for one in told]
                said.append(not all(untold))
                blind.append(any(untold))
                off = abs(found["gain"] / gain - 1) / (found["gain_std_percent"] / 100)
                covered.append((off < 1.96).mean())
                quiet += [] if told else [covered[-1]]
            row = {"light": name, "noise": noise, "draws": draws, "coverage": np.mean(covered)}
            row["where nothing is said"] = np.mean(quiet) if quiet else np.nan
            row |= {"said": np.mean(said), "an error cannot be told": np.mean(blind)}
            rows.append(row | {"neither": 1 - np.mean(np.array(said) | blind)})
    write_section("Images: blocks", pd.DataFrame(rows))


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


SECTIONS = {
    "photographs": (photographs, 2),
    "pairs": (line_pairs, 60),
    "bent": (bent_lines, 1),
    "edges": (odd_edges, 40),
    "stars": (stars, 40),
    "blocks": (blocks, 60),
    "intervals": (intervals, 60),
}
"""What writes a section, and its usual number of seeds, patterns or draws."""


def main():
    """Write the sections named, or all of them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sections", nargs="*", choices=[*SECTIONS, []], default=list(SECTIONS))
    parser.add_argument("--size", type=int, help="seeds, patterns or draws of each")
    options = parser.parse_args()
    for name in options.sections:
        section, size = SECTIONS[name]
        section(options.size or size)


if __name__ == "__main__":
    main()
