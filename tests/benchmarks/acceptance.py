"""Acceptances of simulated sites against their truth: write the table of the README.

``python tests/benchmarks/acceptance.py FOLDER`` simulates and judges sites of each of three
systems, a seed of all three before the next; what is finished stays in FOLDER, so that a run that
was stopped goes on. A site has the boards and images that verdicts need. Truth of a cloud's figure
is its mean over the other finished sites of the same system: drives at the same nominal speed and
distance; of a pixel size the camera's geometry; of a pair width what the photograph without noise
says; of a mark the simulated jury's rule without its scatter.
"""

import argparse
import json
import shutil
from dataclasses import replace
from io import StringIO
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from mmqa_lab import stats
from mmqa_lab.chart_image import read_pairs, resolution
from mmqa_lab.chart_image.reading import find_tones
from mmqa_lab.io import write_atomically
from mmqa_lab.run.pages import markdown_table, replaced
from mmqa_lab.simulate import site as simulated
from mmqa_lab.tender import COVERAGE, OWN_SET, SETS, published_criteria, verdicts
from mmqa_lab.tender.acceptance import FIGURES, accept
from mmqa_lab.tender.photographs import read_marks
from mmqa_lab.tender.site import read_site

README = Path(__file__).resolve().parents[2] / "README.md"
SYSTEMS = "ABC"
CLEAN = {"noise": 0.0, "gamma": "linear", "bits": None, "jpeg_quality": None}
CRITERIA = {name: published_criteria(name) for name in (*SETS, OWN_SET)}
PLACE = ["system", "quantity", "distance_m", "view", "direction"]
PASSES = ("met", "exempt")
BARS = {"h": ("bar_horizontal",), "v": ("bar_left", "bar_right")}


def image_truth(photo, system, seed, boards):
    """Rows of pixel size, pair width and marks of one photograph."""
    vehicle, board = simulated.VEHICLES[system], boards.loc[photo.board]
    drive = simulated.make_drive(photo.drive.distance_m, seed=seed + 1000 * ord(system))
    time = drive.stations.iloc[int(photo.file.stem.split("_")[1])]["time_s"]
    there = simulated.station_map(vehicle, drive, time, board)
    sensor = replace(simulated.SENSOR, **CLEAN)
    clean = simulated.take_photo(vehicle, drive, time, board, seed=seed, sensor=sensor)
    grey = cv2.cvtColor(clean.image, cv2.COLOR_BGR2GRAY) if sensor.bayer else clean.image
    tones = find_tones(grey, board.layout, clean.chart_map)
    pairs = read_pairs(tones, board.layout, clean.chart_map)
    place = {"system": system, "distance_m": photo.distance_m, "view": photo.view}
    for direction, names in BARS.items():
        size = bar_pixel(there, [board.layout[name] for name in names])
        width = resolution(pairs, direction).width_mm
        width = np.inf if np.isnan(width) else width
        for quantity, value in (("pixel_mm", size), ("w_mm", width)):
            yield {**place, "direction": direction, "quantity": quantity, "value": value}
    pixels = 40 / there.pixel_sizes_mm([[500.0, 500.0]])[0, 1]
    mark = next((m for m, least in simulated.LEGIBLE_PX.items() if pixels >= least), "c")
    yield {**place, "direction": "", "quantity": "legibility_40mm", "value": mark}
    if photo.view == "orthogonal" and mark != "c":
        yield {**place, "direction": "", "quantity": "legibility_60mm", "value": mark}


def bar_pixel(there, bars):
    """Length of bars over that of their image, from the middles of their ends."""
    long, seen = 0.0, 0.0
    for bar in bars:
        ends = np.array([[bar.x, bar.y], [bar.x + bar.width, bar.y + bar.height]])
        across = int(bar.height < bar.width)
        ends[:, across] = ends[:, across].mean()
        long += np.ptp(ends, axis=0).max()
        seen += np.linalg.norm(np.diff(there.pixels(ends), axis=0))
    return long / seen


def judged(system, seed, folder):
    """Figures of one site, and the truth of its photographs."""
    site_folder = folder / f"site_{system}_{seed}"
    shutil.rmtree(site_folder, ignore_errors=True)
    simulated.write_site(site_folder, systems=system, seed=seed)
    marks = read_marks(site_folder / "marks.csv")
    done = accept(site_folder, read_site(site_folder / "site.json"), CRITERIA, marks=marks)
    boards = simulated.site_boards().set_index("board", drop=False)
    rows = [row for p in done.photographs for row in image_truth(p, system, seed, boards)]
    shutil.rmtree(site_folder)
    return done.results.assign(seed=seed), pd.DataFrame(rows).assign(seed=seed)


def cloud_truth(figures):
    """Of each cloud's figure the mean over the other sites of its system."""
    own = figures[figures["quantity"].isin(FIGURES.values())]
    value = pd.to_numeric(own["value"])
    group = value.groupby([own[name] for name in ("system", "quantity", "distance_m")])
    others = (group.transform("sum") - value) / (group.transform("count") - 1)
    return own[[*PLACE, "seed"]].assign(value=others)


def true_verdicts(truth, results):
    """Verdicts of one site beside those from its truth."""
    unresolved = truth["value"].map(lambda value: value == np.inf)
    bounds = truth.assign(low=np.where(unresolved, 40.1, np.nan))
    bounds["high"] = np.where(unresolved, np.inf, np.nan)
    bounds["value"] = truth["value"].mask(unresolved, None)
    for name, criteria in CRITERIA.items():
        true = verdicts(criteria, bounds)[[*PLACE, "criterion", "margin", "verdict"]]
        found = verdicts(criteria, results)
        both = found.merge(true, on=[*PLACE, "criterion"], suffixes=("", "_true"))
        yield both.assign(set=name)


def coverage(figures):
    """How often intervals contain the truth, by figure."""
    rows = []
    figures = figures[~figures["quantity"].str.startswith("legibility")].copy()
    for name in ("value", "value_true"):
        figures[name] = pd.to_numeric(figures[name])
    reach = (COVERAGE * figures["sigma"]).fillna(0)
    low = figures["low"].fillna(figures["value"] - reach)
    high = figures["high"].fillna(figures["value"] + reach)
    figures["inside"] = (low <= figures["value_true"]) & (figures["value_true"] <= high)
    for quantity, part in figures.groupby("quantity", sort=False):
        found = stats.wilson(int(part["inside"].sum()), len(part))
        ends = {"draws": len(part), "coverage": found.value, "from": found.low, "to": found.high}
        systems = {f"system {s}": p["inside"].mean() for s, p in part.groupby("system")}
        rows.append({"figure": quantity, **ends, **systems})
    table = pd.DataFrame(rows)
    shares = table.columns.drop(["figure", "draws"])
    return table.assign(**{name: table[name].map("{:.3f}".format) for name in shares})


def agreement(found):
    """Verdicts beside those from truth, by system."""
    rows = []
    open_ones = found["verdict"].isin(["undecided", "not measured"])
    same = found["verdict"].isin(PASSES) == found["verdict_true"].isin(PASSES)
    rank = pd.to_numeric(found["margin"], errors="coerce")
    half = (pd.to_numeric(found["high"]) - pd.to_numeric(found["low"])) / 2
    clear = found["margin_true"].abs() > half.where(np.isfinite(half), np.inf)
    for system, part in found.assign(open=open_ones, same=same, rank=rank).groupby("system"):
        sure = clear.loc[part.index]
        rows.append(
            {
                "system": system,
                "verdicts": len(part),
                "as from truth": int((part["same"] & ~part["open"]).sum()),
                "undecided": int((part["verdict"] == "undecided").sum()),
                "not measured": int((part["verdict"] == "not measured").sum()),
                "against truth": int((~part["same"] & ~part["open"]).sum()),
                "margin beyond the uncertainty": int(sure.sum()),
                "of these decided as from truth": int((part["same"] & ~part["open"])[sure].sum()),
            }
        )
    return pd.DataFrame(rows)


def without_spares(boards_of, photographed):
    """What makes the boards and photographs of a site, without those that no verdict sees."""

    def boards():
        every = boards_of()
        return every[(every["kind"] == "image") | (every["view"] == "orthogonal")]

    def chosen(drive, boards):
        return photographed(drive, boards).iloc[::2]

    return boards, chosen


def unit(options, system, seed):
    """Tables of one site, kept or simulated; none of what is missing with --finished."""
    kept = options.folder / f"{system}_{seed:02d}.json"
    if not kept.is_file():
        if options.finished:
            return []
        tables = judged(system, seed, options.folder)
        text = json.dumps([table.to_json(orient="records") for table in tables])
        write_atomically(kept, lambda path: path.write_text(text))
        print(kept.stem, flush=True)
    texts = json.loads(kept.read_text())
    tables = [pd.read_json(StringIO(text), dtype=False) for text in texts]
    for table, name in zip(tables, ("high", "value"), strict=True):
        infinite = (table["quantity"] == "w_mm") & table[name].isna()  # JSON has no infinity
        table.loc[infinite, name] = np.inf
    return [tables]


def main():
    """Simulate what is missing, print, and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seeds", type=int, default=20, help="sites of each system")
    parser.add_argument("--grey", action="store_true", help="cameras without a colour mosaic")
    parser.add_argument("--finished", action="store_true", help="tables of what is finished")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    simulated.SENSOR = replace(simulated.SENSOR, bayer=not options.grey)
    spare = simulated.site_boards, simulated.photographed
    simulated.site_boards, simulated.photographed = without_spares(*spare)
    places = [(system, seed) for seed in range(1, options.seeds + 1) for system in SYSTEMS]
    tables = [table for place in places for table in unit(options, *place)]
    figures, images = (pd.concat(part, ignore_index=True) for part in zip(*tables, strict=True))
    truth = pd.concat([cloud_truth(figures), images], ignore_index=True)
    beside = figures.merge(truth, how="left", on=[*PLACE, "seed"], suffixes=("", "_true"))
    found = []
    for (_, seed), part in figures.groupby(["system", "seed"]):
        own = truth[(truth["seed"] == seed) & (truth["system"] == part["system"].iloc[0])]
        found += true_verdicts(own.reset_index(drop=True), part.reset_index(drop=True))
    shown = [coverage(beside), agreement(pd.concat(found, ignore_index=True))]
    print(*(table.to_string(index=False) for table in shown), sep="\n\n")
    text = README.read_text(encoding="utf-8")
    for name, table in zip(("acceptance", "acceptance verdicts"), shown, strict=True):
        text = replaced(text, name, markdown_table(table))
    write_atomically(README, lambda path: path.write_text(text, encoding="utf-8"))


if __name__ == "__main__":
    main()
