"""How good the image measurements are, against known truth: run it, it prints.

python tests/benchmarks/images.py [photographs] [pairs] [steps] [edges] [sizes] [panorama] [drive]
    [real] [--full]

A few cases of each kind, or with --full as many as the stated figures rest on.
"""

import argparse
import multiprocessing
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import camera
from photographed import RealPairs, real_edges
from rendered import grey, pattern_case, slanted_edge, true_mtf50

from mmqa_lab import bench, chart_image, charts, io, mtf, samples
from mmqa_lab.chart_image import reading
from mmqa_lab.chart_image.placing import align
from mmqa_lab.chart_image.reading import SMALLEST_GAP, SMALLEST_PAIR_PX
from mmqa_lab.simulate import cameras, site

CAMERA_CHAINS = {
    "plain": {},
    "Bayer": {"bayer": True},
    "Bayer, sharpened, sRGB, JPEG 85": {
        "bayer": True,
        "sharpening": 0.5,
        "gamma": "srgb",
        "bits": 8,
        "jpeg_quality": 85,
    },
}

SIZE_CASES = ((1.3, 0), (1.3, 45), (2.7, 30), (5.4, 0), (5.4, 45), (11, 0), (13, 0))
"""Pixel size at the middle of an orthogonal view, mm, and view, degrees."""

COUNTS = {
    "photographs": (8, 1),
    "pairs": (4, 60),
    "steps": (3, 100),
    "edges": (10, 100),
    "sizes": (2, 10),
}
"""Cases of each line: usually, and in full."""


def photographs(step, seeds=(0, 1), folder=None):
    """Every so many of the 242 photographs of the tests' own camera: found, read, and how well.

    Other ``seeds`` take other photographs of the same conditions; a run with a ``folder`` resumes.
    """
    began, cases = time.process_time(), list(dict.fromkeys(one[:2] for one in camera.cases()))
    cases = [{"condition": name, "pixel_mm": size} for name, size in cases[::step]]
    results = bench.run(cases, {"ours": _measured}, make=_shot, seeds=seeds, folder=folder)
    table = bench.cell_table(results)
    table = table[~table["failure"].str.contains("not whole")]
    found = table["spurious"].notna()
    for row in table[~found].itertuples():
        print(f"{row.condition}, {row.pixel_mm} mm, seed {row.seed}: {row.failure}")
    for size, part in [*table.groupby("pixel_mm"), ("all", table)]:
        steps = Counter(part[["steps_h", "steps_v"]].stack().dropna().astype(int))
        near = sum(steps[one] for one in (-1, 0, 1))
        scores = part.filter(regex="^score").stack().dropna().abs()
        print(
            f"{size} mm: found without corners {found[part.index].sum()} of {len(part)}; "
            f"w within one step {near} of {steps.total()}: {dict(sorted(steps.items()))} "
            f"(positive: finer); spurious {part['spurious'].sum():.0f}; "
            f"pixel size within 1.96 sigma {(scores < 1.96).mean():.3f} of {len(scores)}"
        )
    print(f"processor time {time.process_time() - began:.0f} s, rendering included")


def _shot(condition, pixel_mm, seed):
    """A photograph of the chart in one of the 37 conditions."""
    there = samples.has_real("images")
    background = io.read_image(samples.real_path("images/panorama.jpg")) if there else None
    scene = camera.CONDITIONS[condition]
    layout = charts.imaging_chart()
    return camera.shoot(layout, pixel_mm, seed=seed, background=background, **scene)


def _measured(shot):
    """What is read in a photograph, as errors against its truth."""
    layout = charts.imaging_chart()
    outline = shot.pixels(layout.corners())
    if (outline < 0).any() or (outline > np.array(shot.image.shape[1::-1]) - 1).any():
        raise ValueError("the chart is not whole in the frame")
    there = chart_image.locate(_bytes(shot.image), layout)
    quality = chart_image.evaluate_image(shot.linear, layout, there)
    resolved = quality.pairs[quality.pairs["resolved"]]["name"]
    truth = [shot.contrast(layout[name]) for name in resolved]
    found = {"spurious": sum(contrast < 0.05 or width < 2 for contrast, width in truth)}
    for one in "hv":
        steps = shot.steps(layout, quality.resolution(one).width_mm, one)
        found |= {} if steps is None else {f"steps_{one}": steps}
    for row in quality.sizes.dropna(subset=["length_px"]).itertuples():
        bar = layout[row.name].corners()[[0, 1] if row.direction == "h" else [0, 3]]
        bar = bar + (layout[row.name].corners().mean(axis=0) - bar.mean(axis=0))
        length = np.linalg.norm(np.diff(shot.pixels(bar), axis=0))
        found[f"score_{row.name}"] = (row.length_px - length) / row.length_sigma_px
    return found


def _bytes(image):
    """One grey image of what a file holds."""
    return image if image.ndim == 2 else image @ np.array([0.114, 0.587, 0.299])


def pairs(count):
    """Spurious and true line pairs accepted, by class and by camera chain."""
    kinds = {
        "true 3.2-8 px, sigma .5": (True, lambda r, c: pattern_case(r.uniform(3.2, 8), r, **c)),
        "true 4-8 px, sigma .7, noise 5 %": (
            True,
            lambda r, c: pattern_case(r.uniform(4, 8), r, sigma=0.7, noise=0.032, **c),
        ),
        "below Nyquist 1.1-2 px": (
            False,
            lambda r, c: pattern_case(r.uniform(1.1, 2), r, sigma=0.4, **c),
        ),
        "beats 2.0-2.3 px": (
            False,
            lambda r, c: pattern_case(r.uniform(2, 2.3), r, sigma=0.4, **c),
        ),
        "defocus, reversed": (False, _defocused),
        "motion 1.25-1.7 pairs, reversed": (
            False,
            lambda r, c: pattern_case(
                r.uniform(2.6, 8), r, sigma=0.4, travel=r.uniform(1.25, 1.7), **c
            ),
        ),
        "blurred away, noise 5 %": (
            False,
            lambda r, c: pattern_case(r.uniform(2.5, 4), r, sigma=2.0, noise=0.032, **c),
        ),
        "6, 7, 9 or 12 printed": (
            False,
            lambda r, c: pattern_case(r.uniform(4, 8), r, seen=int(r.choice([6, 7, 9, 12])), **c),
        ),
    }
    wrong = right = n_wrong = n_right = 0
    for chain, settings in CAMERA_CHAINS.items():
        for name, (true, case) in kinds.items():
            rng = np.random.default_rng(5)
            readings = [case(rng, settings | {"direction": "hv"[k % 2]}) for k in range(count)]
            accepted = sum(reading.resolved for reading in readings)
            print(f"{chain:34} {name:34} {accepted:4d} of {count} accepted", flush=True)
            if true:
                right, n_right = right + accepted, n_right + count
            else:
                wrong, n_wrong = wrong + accepted, n_wrong + count
    print(f"spurious accepted {wrong} of {n_wrong}, true accepted {right} of {n_right}")


def _defocused(rng, settings):
    """A pattern beyond the first zero of a defocused transfer."""
    width = rng.uniform(3, 8)
    return pattern_case(width, rng, sigma=0.3, defocus=rng.uniform(0.7, 1.0) * width, **settings)


def steps(count):
    """Stepwise width on whole charts against two noise-free limits of modulation.

    One is the closed form for optics and pixels; the other is read in a photograph without noise
    through the same chain, at the true place: demosaicing takes contrast, sharpening adds some.
    """
    layout = charts.imaging_chart()
    for chain, settings in CAMERA_CHAINS.items():
        within, missing = {"optics": Counter(), "chain": Counter()}, 0
        rng = np.random.default_rng(7)
        for seed in range(count):
            photo, plain, there, sigma = _whole_chart(layout, rng, seed, settings)
            gamma = settings.get("gamma", "linear")
            try:
                quality = chart_image.evaluate_image(grey(photo.image, gamma), layout, there)
            except ValueError:
                missing += 1
                continue
            levels = reading.find_tones(grey(plain.image, gamma), layout, plain.chart_map)
            seen = chart_image.read_pairs(levels, layout, plain.chart_map)
            for direction in "hv":
                readings = seen[seen["direction"] == direction]
                widths = list(readings["width_mm"])
                found = quality.resolution(direction).width_mm
                place = -1 if np.isnan(found) else widths.index(found)
                optics = reading.expected_contrast(readings["width_px"], sigma)
                for name, contrast in (("optics", optics), ("chain", readings["contrast"])):
                    good = (contrast >= SMALLEST_GAP) & (readings["width_px"] >= SMALLEST_PAIR_PX)
                    limit = len(widths) if good.all() else int(np.argmin(good))
                    within[name][place - (limit - 1)] += 1
        for name, found in within.items():
            near = sum(found[step] for step in (-1, 0, 1))
            print(
                f"{chain:34} {near} of {sum(found.values())} within one step of the limit of the "
                f"{name}; {dict(sorted(found.items()))} (positive: finer); {missing} not found",
                flush=True,
            )


def _whole_chart(layout, rng, seed, settings):
    """A photograph of a chart with noise and without, where it is thought to be, and its spread."""
    pixel, sigma = rng.uniform(2.5, 11), rng.uniform(0.4, 1.0)
    camera = cameras.PanoramaCamera(2 * round(5000 * np.pi / pixel))
    view = cameras.chart_view(
        camera,
        distance=5,
        layout=layout,
        roll_deg=rng.uniform(-2, 2),
        heading_deg=rng.uniform(-30, 30),
        aim_deg=rng.uniform(0, 3),
    )
    photo, plain = (
        cameras.photograph(
            layout,
            view,
            optics=cameras.Optics(sigma),
            sensor=cameras.Sensor(noise=noise, **settings),
            seed=seed,
            supersampling=4,
        )
        for noise in (0.02, 0.0)
    )
    corners = photo.chart_map.pixels(layout.corners()) + rng.normal(0, 0.7, (4, 2))
    there = chart_image.locate(None, layout, corners=corners, camera=camera, offset=photo.origin)
    return photo, plain, there, sigma


def edges(count):
    """MTF50 against truth: median error and 95th percentile, per cent.

    Beside them the 95th percentile of the best estimate possible (Cramer-Rao): levels, place and
    angle of the edge known, only the Gaussian's width to be found.
    """
    for sigma in (0.5, 0.7, 1.0, 1.5, 2.0):
        for noise in (0.0, 0.01, 0.03):
            rng = np.random.default_rng(3)
            errors, binned, scores, bounds, began = [], [], [], [], time.perf_counter()
            for _ in range(count if noise else 10):
                angle = np.radians(rng.uniform(3, 11.5))
                image = slanted_edge(sigma, angle, rng.uniform(-0.5, 0.5), noise=noise, rng=rng)
                found, truth = mtf.fit_edge(image), true_mtf50(sigma, angle)
                errors.append(found.mtf50 / truth - 1)
                binned.append(found.mtf50_binned / truth - 1)
                scores.append((found.mtf50 - truth) / max(found.mtf50_sigma, 1e-9))
                bounds.append(_smallest_error(sigma, angle, noise))
            seconds = (time.perf_counter() - began) / len(errors)
            words = [
                f"{100 * np.median(one):+.2f} / {100 * np.percentile(np.abs(one), 95):.2f}"
                for one in (errors, binned)
            ]
            print(
                f"sigma {sigma} noise {noise}: value {words[0]} (possible "
                f"{196 * np.sqrt(np.mean(np.square(bounds))):.2f}), binned {words[1]}, "
                f"error over sigma {np.std(scores) if noise else np.nan:.2f}, {seconds:.2f} s",
                flush=True,
            )


def _smallest_error(sigma, angle, noise):
    """Cramer-Rao bound of the relative standard deviation of MTF50 in a rendered edge."""
    step = 1e-4
    wider, narrower = (slanted_edge(sigma + sign * step, angle, 0.0) for sign in (1, -1))
    slope = np.linalg.norm(wider - narrower) / (2 * step)
    mtf50 = [true_mtf50(sigma + sign * step, angle) for sign in (0, 1, -1)]
    return noise / slope * abs(mtf50[1] - mtf50[2]) / (2 * step) / mtf50[0]


def sizes(count):
    """Pixel size: bias in per cent and standard deviation in pixels of a bar's length."""
    for bar in ("grey", "black"):
        layout = charts.imaging_chart(horizontal_bar=bar)
        for pixel, heading in SIZE_CASES:
            for noise in (0.05, 0.10):
                _sizes_of(layout, bar, pixel, heading, noise, count if pixel > 2 else 2)


def _sizes_of(layout, bar, pixel, heading, noise, count):
    """One line of the table of pixel sizes."""
    camera = cameras.PanoramaCamera(2 * round(5000 * np.pi / pixel))
    errors, sigmas = {"h": [], "v": []}, {"h": [], "v": []}
    for seed in range(count):
        rng = np.random.default_rng(seed)
        view = cameras.chart_view(
            camera,
            distance=5,
            layout=layout,
            heading_deg=heading,
            roll_deg=rng.uniform(-1, 1),
            aim_deg=rng.uniform(0, 1),
        )
        photo = cameras.photograph(
            layout,
            view,
            optics=cameras.Optics(0.6),
            # noise is a share of the chart's contrast, 0.64 of full scale
            sensor=cameras.Sensor(noise=0.64 * noise, shot_share=0.0),
            seed=seed,
            supersampling=4,
        )
        corners = photo.chart_map.pixels(layout.corners()) + rng.normal(0, 0.7, (4, 2))
        there = chart_image.locate(
            None, layout, corners=corners, camera=camera, offset=photo.origin
        )
        there = align(photo.image, layout, there)
        levels = reading.find_tones(photo.image, layout, there)
        found = reading.pixel_sizes(levels, layout, there)
        truth = reading.pixel_sizes(levels, layout, photo.chart_map)["expected_mm"]
        for row, expected in zip(found.itertuples(), truth, strict=True):
            errors[row.direction].append(row.length_px - row.length_mm / expected)
            sigmas[row.direction].append(row.length_sigma_px)
    words = []
    for direction, values in errors.items():
        length_px = (600 if direction == "h" else 800) / pixel
        words.append(
            f"{direction} bias {-100 * np.nanmean(values) / length_px:+.3f} % "
            f"sd {np.nanstd(values):.3f} px (stated {np.nanmean(sigmas[direction]):.3f}), "
            f"{np.isnan(values).sum()} not measured"
        )
    print(f"{bar:5} bar, {pixel:4} mm, {heading:2d} deg, noise {noise}: {'; '.join(words)}")


def panorama():
    """Seconds and memory for panoramas of 24 and 250 megapixels, from the file to the figures."""
    for megapixels, distance in ((24, 5), (250, 10)):
        print(f"{megapixels} megapixels, {distance} m", flush=True)
        _panorama(megapixels, distance)


def _panorama(megapixels, distance):
    """The time of one panorama, the chart found by its corners and by itself."""
    import cv2

    layout = charts.imaging_chart()
    camera = cameras.PanoramaCamera.of_megapixels(megapixels)
    view = cameras.chart_view(camera, distance=distance, layout=layout, heading_deg=20, aim_deg=30)
    sensor = cameras.Sensor(noise=0.02, gamma="srgb", bits=8)
    photo = cameras.photograph(layout, view, sensor=sensor, seed=1)
    rng = np.random.default_rng(1)
    coarse = cv2.GaussianBlur(rng.random((camera.height // 8, camera.width // 8)), (0, 0), 2)
    coarse = np.uint8(255 * (coarse - coarse.min()) / np.ptp(coarse))
    whole = cv2.resize(coarse, (camera.width, camera.height), interpolation=cv2.INTER_CUBIC)
    (column, row), (rows, columns) = photo.origin, photo.image.shape
    whole[row : row + rows, column : column + columns] = photo.image
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "panorama.jpg"
        cv2.imwrite(str(file), whole, [cv2.IMWRITE_JPEG_QUALITY, 92])
        del whole
        for name, corners in (("corners", view.pixels(layout.corners())), ("targets", None)):
            began = time.perf_counter(), time.process_time()
            quality = chart_image.evaluate_file(file, layout, corners=corners, camera="panorama")
            wall, cpu = time.perf_counter() - began[0], time.process_time() - began[1]
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
            size = quality.to_frame()["pixel_h_mm"].iloc[0]
            print(f"{name}: {wall:.1f} s ({cpu:.1f} s of CPU), peak {peak:.2f} GB, {size:.3f} mm")


def drive():
    """An acceptance of two drives of 27 whole panoramas of 250 megapixels with 10 million points.

    All panoramas share a background; the boards of system B are put into those that are to show
    them.
    """
    with tempfile.TemporaryDirectory() as folder:
        # a process begins with the peak of the one that starts it
        writer = multiprocessing.get_context("spawn").Process(target=_write_drives, args=(folder,))
        writer.start()
        writer.join()
        began = time.perf_counter()
        judge = subprocess.Popen([sys.executable, "-m", "mmqa_lab", "accept", folder])
        used = os.wait4(judge.pid, 0)[2]
        print(
            f"{time.perf_counter() - began:.0f} s, processor time {used.ru_utime:.0f} s, "
            f"peak {used.ru_maxrss / 1e6:.2f} GB"
        )


def _write_drives(folder):
    """System B's delivery with whole panoramas at every station, and clouds of a whole street."""
    import cv2

    folder = Path(folder)
    site.write_site(folder, systems="B", seed=1)
    boards = site.site_boards()
    camera, rng = site.VEHICLES["B"].camera, np.random.default_rng(1)
    coarse = cv2.GaussianBlur(rng.random((camera.height // 8, camera.width // 8, 3)), (0, 0), 2)
    coarse = np.uint8(255 * (coarse - coarse.min()) / np.ptp(coarse))
    empty = cv2.resize(coarse, (camera.width, camera.height), interpolation=cv2.INTER_CUBIC)
    cv2.imwrite(str(folder / "empty.jpg"), empty)
    for distance in site.DISTANCES:
        place = folder / "B" / f"drive_{distance:02.0f}m"
        drive = site.make_drive(distance, seed=1 + 1000 * ord("B"))
        shots = site.photographed(drive, boards).groupby("station")["board"].agg(list)
        drive.stations.assign(file=[f"{k}.jpg" for k in drive.stations.index]).to_csv(
            place / "images.csv", index=False
        )
        for file in place.glob("image_*.jpg"):
            file.unlink()
        for k, station in drive.stations.iterrows():
            if k not in shots:
                (place / f"{k}.jpg").hardlink_to(folder / "empty.jpg")
                continue
            whole = empty.copy()
            for board in boards[boards["board"].isin(shots[k])].itertuples():
                photo = site.take_photo(site.VEHICLES["B"], drive, station["time_s"], board, seed=k)
                (column, row), (rows, columns) = photo.origin, photo.image.shape[:2]
                whole[row : row + rows, column : column + columns] = photo.image
            cv2.imwrite(str(place / f"{k}.jpg"), whole)
        _widen(place / "cloud.laz", drive, rng)
    (folder / "empty.jpg").unlink()


def _widen(file, drive, rng, points=10_000_000):
    """Add the points of a street to a cloud of boards."""
    cloud = io.read_cloud(file)
    time_s = np.sort(rng.uniform(*drive.reported.time[[0, -1]], points))
    north = np.interp(time_s, drive.path.time, drive.path.position[:, 1])
    east, north = rng.uniform(-30, 20, points) - 10, north - site.ORIGIN[1]
    street = site.ORIGIN + np.column_stack([east, north, rng.normal(0, 0.02, points)])
    columns = {"gps_time": time_s, "intensity": np.zeros(points)}
    street = type(cloud)(street, columns, crs=cloud.crs)
    io.write_cloud(file, type(cloud).concatenate([street, cloud]), scale=0.0001)


def real():
    """Real line pairs made coarser, reversed by motion, and real edges against published tools."""
    found = RealPairs()
    for width in (8.8, 7, 5.9, 5, 4, 3.5, 3, 2.7, 2.4, 2.2, 2.05, 1.9, 1.7, 1.5):
        resolved = [reading.resolved for reading in found.readings(width)]
        print(f"real pairs of {width} px: {sum(resolved)} of {len(resolved)} windows resolved")
    for motion in (1.25, 1.5, 1.7):
        readings = [one for width in (8, 6, 4, 3) for one in found.readings(width, motion=motion)]
        accepted, contrast = (
            [getattr(one, name) for one in readings] for name in ("resolved", "contrast")
        )
        print(
            f"real pairs after motion by {motion} pairs: {sum(accepted)} of {len(accepted)} "
            f"resolved, contrast {min(contrast):.2f} to {max(contrast):.2f}"
        )
    for name, image, published in real_edges():
        edge = mtf.fit_edge(image)
        print(
            f"{name}: MTF50 {edge.mtf50:.4f} +- {edge.mtf50_sigma:.4f}, binned "
            f"{edge.mtf50_binned:.4f}, published {published} ({edge.mtf50 / published - 1:+.1%})"
        )


def main():
    """Run the parts that the command line names."""
    known = {
        "photographs": photographs,
        "pairs": pairs,
        "steps": steps,
        "edges": edges,
        "sizes": sizes,
        "panorama": panorama,
        "drive": drive,
        "real": real,
    }
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(known))
    parser.add_argument("--full", action="store_true", help="the full number of cases")
    options = parser.parse_args()
    for part in options.parts or known:
        print(f"== {part}", flush=True)
        arguments = [COUNTS[part][options.full]] if part in COUNTS else []
        known[part](*arguments)


if __name__ == "__main__":
    main()
