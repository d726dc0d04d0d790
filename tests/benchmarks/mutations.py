"""Faults made by hand in the library, one after the other: does the test meant for it fail?

``python tests/benchmarks/mutations.py`` works on a copy of the repository. It lists what was
caught, what was not, and faults whose text no longer stands in the room. With names of rooms only
theirs.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

FAULTS = (
    # room, what stands there, the fault, the tests that must fail
    ("commands", 're.match(r"-\\.?\\d", word)', "False", "test_commands.py"),
    ("commands", 'or text.startswith("Invalid")', "or text", "test_commands.py"),
    ("commands", "if backend and backend in text", "if False", "test_commands.py"),
    ("commands", "if len(errors) == len(files):", "if errors:", "test_commands.py"),
    ("cloud", 'path = path[["easting_m", "northing_m"]]', "pass", "test_test_field.py"),
    ("test_field", "default_rng(0).integers", "default_rng().integers", "test_test_field.py"),
    ("test_field", "if not len(targets):", "if False:", "test_test_field.py"),
    ("boresight", "(head < 0) | (head", "(head", "test_boresight.py"),
    ("boresight", "if time.min() == time.max()", "if False", "test_boresight.py"),
    ("boresight", 'f"Invalid {name}: {str(error)', 'f"{str(error)', "test_boresight.py"),
    ("_results", "value - NORMAL * std", "value - std", "test_results.py"),
    ("cloud", "starts) / counts[:, None, None]", "starts)", "test_boresight.py"),
    ("rotations", "ch * cr + sh * sp * sr", "ch * cr - sh * sp * sr", "test_rotations.py"),
    ("samples", 'return root != "" and', "return", "test_samples.py"),
    ("repeatability", "def r(self) -> float:", "def r(self) -> str:", "test_types.py"),
    ("stats", 'method="wilson"', 'method="exact"', "test_stats.py"),
    ("stats", "CONSISTENT_SCALE = 1.4826", "CONSISTENT_SCALE = 1.4862", "test_stats.py"),
    ("stats", "known.std(ddof=1)", "known.std(ddof=0)", "test_stats.py"),
    ("planes", "np.abs(residuals - np.median(residuals))", "np.abs(residuals)", "test_planes.py"),
    ("planes", "np.std(self.residuals, ddof=1)", "np.std(self.residuals)", "test_planes.py"),
    ("chart_cloud", "np.sin(turn)], [-np.sin(turn)", "-np.sin(turn)], [np.sin(turn)",
     "test_chart_cloud.py"),
    ("spacing", "self.d[-1] / self.d[0]", "self.d[-2] / self.d[0]", "test_spacing.py"),
    ("spacing", "np.sqrt(1 / check_positive(rho0", "np.sqrt(2 / check_positive(rho0",
     "test_spacing.py"),
    ("spacing", "np.sqrt(-4 * np.log1p", "np.sqrt(-2 * np.log1p", "test_spacing.py"),
    ("spacing", "known = (self.distances <= self.border)", "known = (self.distances <= np.inf)",
     "test_spacing_empty.py"),
    ("spacing", "query(places - low, [rank])", "query(places - low, [1])", "test_spacing_empty.py"),
    ("stats", "np.arange(3, 11)", "np.arange(3, 13, 2)", "test_stats.py"),
    ("stats", "counts.max() * WAVE_PARTS > len(places)", "False", "test_stats.py"),
    ("chart_cloud", "if _by_chance(self.xy, self.axes):", "if False:", "test_chart_cloud.py"),
    ("chart_cloud", "noise_mm**2 > (1 - BENT)", "noise_mm**2 > 0", "test_chart_cloud.py"),
    ("chart_cloud", "(found.border >= reach)", "(found.border >= 0)", "test_chart_cloud.py"),
    ("scan_pattern", "axis=-1)[..., 2], 0.95", "axis=-1)[..., 1], 0.95", "test_plan.py"),
    ("scan_pattern", "gap *= 1 + slopes[:, 1] * fall", "gap *= 1", "test_scan_pattern_measure.py"),
    ("scan_pattern", "turn = slopes[:, 0] + slopes[:, 1] * rise", "turn = slopes[:, 0]",
     "test_scan_pattern_measure.py"),
    ("repeatability", "100 / self.mean if self.mean else np.nan", "100 / (self.mean or 1)",
     "test_repeatability.py"),
    ("spacing", "self.across / self.along", "self.along / self.across",
     "test_spacing_directional.py"),
    ("chart_cloud", "self.n / self.area_hull_m2", "self.n / self.area_polygon_m2",
     "test_chart_cloud.py"),
    ("chart_cloud", "<= thickness", "<= 2 * thickness", "test_chart_cloud.py"),
    ("scan_pattern", "x=self.scanner_tilt_deg", "x=-self.scanner_tilt_deg", "test_scan_pattern.py"),
    ("scan_pattern", "turns = turns - np.round(turns)", "turns = 0 * turns",
     "test_scan_pattern.py"),
    ("scan_pattern", "(x > 0) & (y >= 0), (x <= 0)", "(x >= 0) & (y >= 0), (x <= 0)",
     "test_scan_pattern.py"),
    ("scan_pattern", "reach = r1 if literal else r2", "reach = r2 if literal else r1",
     "test_mimic.py"),
    ("scan_pattern", "height_difference / np.cos(np.radians(gamma_scan))", "height_difference",
     "test_mimic.py"),
    ("scan_pattern", "errors.get(name, 0.0)", "2 * errors.get(name, 0.0)", "test_plan.py"),
    ("scan_pattern", "off, off * x, off * y, x**2, x * y]", "off, off * x]",
     "test_scan_pattern_measure.py"),
    ("scan_pattern", "np.sqrt((len(left) - 1) * np.var", "np.sqrt(np.var",
     "test_scan_pattern_measure.py"),
    ("scan_pattern", "share < 1 - CROSSED", "False", "test_scan_pattern_measure.py"),
    ("lines", "sqrt(weight * self.angle**2", "sqrt(weight * self.angle", "test_lines_lhd.py"),
    ("lines", "if pairs.size and not pairs.any()", "if pairs.sum() < 200", "test_lines_lhd.py"),
    ("lines", "if evidence > max([least,", "if True or max([least,", "test_lines_lhd.py"),
    ("lines", "np.radians([-3, -1.5, 0, 1.5, 3])", "np.radians([0.0])", "test_lines_lhd.py"),
    ("plane_search", "np.argsort(x + np.sqrt(2) * y + np.sqrt(3) * z", "np.argsort(0 * x",
     "test_lines_edges.py"),
    ("lines", "CHANGED_M = 0.06, 0.05,", "CHANGED_M = 0.06, 0.002,", "test_lines_lhd.py"),
    ("lines", "0.06, 0.05, 6.0", "0.06, 0.05, 60.0", "test_lines.py"),
    ("lines", "return off <= 5 * np.median(off)", "return off < np.inf", "test_lines.py"),
    ("lines", "return np.unique(turned, axis=0,", "return np.unique(segments, axis=0,",
     "test_lines.py"),
    ("lines", "high=MOST_RADIUS_M", "high=np.inf", "test_lines.py"),
    ("lines", "if last >= 0 and high <= low", "if high <= low", "test_lines_lhd.py"),
    ("lines", "> 0.3 * (high - low)", "> 3 * (high - low)", "test_lines_lhd.py"),
    ("lines", "np.fmax(there.perp", "np.fmin(there.perp",
     "test_lines_lhd.py"),
    ("tender", "sign * (rank - limit)", "sign * (limit - rank)", "test_tender.py"),
    ("poles", "gaps = np.minimum(np.diff(used), 2 * ROOF_WINDOW)", "gaps = np.diff(used)",
     "test_poles.py"),
    ("poles", "size.prod() > MOST_GROUND_CELLS", "False", "test_poles.py"),
    ("poles", "unclear.any()", "False", "test_poles_scores.py"),
    ("poles", "upright.mean() > 0.5", "False", "test_poles.py"),
    ("poles", "> TALL_M:", "> 1e9:", "test_poles.py"),
    ("poles", '("method", "explain", *CHOICES[method])', "(name,)", "test_poles.py"),
    ("poles", "(width > COVERED * radius)", "(width > 0)", "test_poles.py"),
    ("poles", "top < STOUT * ", "0 * top > ", "test_poles.py"),
    ("studies", "value=factor * trees.value", "value=trees.value", "test_study_poles.py"),
    ("studies", "first + unit * STEP]", "first]", "test_study_poles.py"),
    ("studies", "counted[first], counted[other]", "counted[other], counted[first]",
     "test_study_poles.py"),
    ("tender", "COVERAGE = 1.96", "COVERAGE = 1.0", "test_tender.py"),
    ("tender", 'relation.replace(">", "<")', "relation", "test_tender.py"),
    ("tender", "if bare or _doubted(quantity, remarks)", "if False", "test_tender.py"),
    ("tender", "low <= value <= high):", "True):", "test_tender.py"),
    ("tender", '.dropna(how="all")', "", "test_tender.py"),
    ("tender", "surely and not any(", "surely and any(", "test_tender.py"),
    ("test_field", "dz.abs().quantile(0.9)", "dz.quantile(0.9)",
     "test_test_field.py"),
    ("mtf", "if crooked > TORN:", "if False:", "test_mtf.py"),
    ("mtf", "if fit.clipped(sign)]", "if False]", "test_mtf.py"),
    ("mtf", "fit.one_sided() > ONE_SIDED", "False", "test_mtf.py"),
    ("mtf", "(second > OTHER_STEP, ", "(False, ", "test_mtf.py"),
    ("mtf", "if np.ptp(phase) > LARGEST_DRIFT:", "if False:", "test_mtf.py"),
    ("mtf", "faintest < SEEN_SHARE,", "False,", "test_mtf.py"),
    ("mtf", "curve(places) if empty > 0.1 else", "", "test_mtf.py"),
    ("mtf", "2 * _plain_level(", "1.9 * _plain_level(", "test_mtf.py"),
    ("mtf", "frequency = n / (2 * np.pi * rings)", "frequency = n / (np.pi * rings)",
     "test_mtf.py"),
    ("radiometry", "(reference[1] / f_number) ** 2", "(f_number / reference[1]) ** 2",
     "test_radiometry.py"),
    ("radiometry", "if missing.any(axis=None):", "if False:", "test_radiometry.py"),
    ("radiometry", "FALLOFF = (0.0, 0.3)", "FALLOFF = (0.0, 0.0)", "test_radiometry.py"),
    ("radiometry", "known[place] ** -0.5", "1.0", "test_radiometry.py"),
    ("radiometry", "            if iteration:\n", "            if False:\n", "test_radiometry.py"),
    ("radiometry", "len(loose) > 0,", "False,", "test_radiometry.py"),
    ("radiometry", "5 * counts[1:].max(), FEWEST_PILED", "5 * counts[1:].max(), 1",
     "test_radiometry.py"),
    ("radiometry", "self.n - 1 - int(", "self.n - int(", "test_radiometry.py"),
    ("chart_image", "axis=1).max() > BEND_PX else", "axis=1).max() > 1e9 else",
     "test_chart_bent.py"),
    ("chart_image", "if typical > LEGIBLE and", "if False and", "test_chart_photographs.py"),
    ("chart_image", "if bent > LARGEST_BEND:", "if False:", "test_chart_bent.py"),
    ("chart_image", "(bent > SAID_BEND, ", "(False, ", "test_chart_bent.py"),
    ("chart_image", "size not in (None, (columns, rows))", "False", "test_io_cameras.py"),
    ("io", "if model not in BROWN:", "if False:", "test_io_cameras.py"),
    ("chart_image", "isin(crossed) & ~seen", "isin([])", "test_chart_photographs.py"),
    ("chart_image", "UNSEEN_PX * hidden", "0 * hidden", "test_chart_photographs.py"),
    ("chart_image", "1 + (other.charts if other else 0)", "1", "test_chart_photographs.py"),
    ("chart_image", "_side(other, layout) > _side(", "False and (", "test_chart_photographs.py"),
    ("charts", "LENGTHS & set(vars(one))", "{'pair'} & set(vars(one))", "test_charts.py"),
    ("bench", "np.sqrt(n)", "np.sqrt(n - 1)", "test_bench.py"),
    ("bench", "for case in draw", "for case in sorted(set(draw))", "test_bench.py"),
    ("run", "if len(frame) <= LONGEST_LATEX", "if frame.size", "test_run.py"),
    ("repeatability", "LIMIT * self.s_r", "LIMIT * self.s_r**2", "test_repeatability.py"),
    ("simulate", "np.array([np.sin(h), np.cos(h), 0.0])", "np.array([np.cos(h), np.sin(h), 0.0])",
     "test_simulate_trajectories.py"),
    ("simulate", "limit = reach[k] + growth * np.sqrt(square)", "limit = reach[k] / 2",
     "test_simulate_scan.py"),
    ("simulate", "np.linalg.norm(whole.half, axis=1)", "whole.half.min(axis=1)",
     "test_simulate_scan.py"),
    ("simulate", "int(np.ptp(since) / NODE_S) + 2", "2", "test_simulate_scan.py"),
    ("simulate", "RING * scanner.exit_diameter_m / 2", "RING * scanner.exit_diameter_m",
     "test_simulate_scan.py"),
    ("simulate", "abs(s[3] - abs(h)) < abs(r - radial)", "abs(s[3] - abs(h)) > abs(r - radial)",
     "test_simulate_scenes.py"),
    ("simulate", "[1:] *= np.sqrt(1 - keep**2)", "[1:] *= 1 - keep**2",
     "test_simulate_trajectories.py"),
    ("maps", "found.setdefault((file.stat().st_dev, file.stat().st_ino)", "found.setdefault(path",
     "test_maps.py"),
    ("maps", "if same is not None:", "if False:", "test_maps.py"),
    ("maps", 'OWN, WORKING = "mmqa_map", ".mmqa_points"', 'OWN, WORKING = "", ".xyz"',
     "test_outputs.py"),
    ("maps", "first * cell - margin, (", "first * cell, (", "test_maps.py"),
    ("maps", "-2, axis=1)[:, -2]", "-9, axis=1)[:, -9]", "test_maps.py"),
    ("maps", "(same, f", "(False, f", "test_maps.py"),
    ("maps", 'if np.prod(size / cell + 1) > MOST_MAP_CELLS', "if False", "test_maps.py"),
    ("maps", "if missing:\n", "if False:\n", "test_maps.py"),
    ("cloud", "places += ON_BORDER", "places += 0", "test_maps.py test_cloud.py"),
    ("_checks", "return path.samefile(other)", "return str(path) == str(other)",
     "test_outputs.py"),
    ("_checks", "for one in outputs[:number]", "for one in ()", "test_outputs.py"),
    ("_checks", "head and (zero or", "False and (zero or", "test_outputs.py"),
    ("_checks", "if not path.absolute().parent.is_dir()", "if False", "test_outputs.py"),
    ("published", 'bool(high > printed["low"])', 'bool(low > printed["low"])',
     "test_published.py"),
    ("io", '"are marked as withheld": withheld > 0', '"are marked as withheld": withheld > 1',
     "test_io_kinds.py"),
    ("io", "NOISE = (7, 18)", "NOISE = (7, 7)", "test_io_kinds.py"),
    ("io", "axis.min() == LEAST or", "", "test_io_kinds.py"),
    ("io", "box[1] <= high", "box[1] <= high + 1", "test_io_kinds.py"),
    ("io", "held = max(held, header.point_count)", "held = header.point_count", "test_io_kinds.py"),
    ("io", "zeros & (far or zeros.sum()", "zeros & (zeros.sum()", "test_io_kinds.py"),
    ("io", "numbers % 1 != 0", "numbers % 1 > 1", "test_io_kinds.py"),
    ("io", "conv_factor != 1 == stated", "conv_factor != 1 != stated", "test_io_kinds.py"),
    ("io", "if len(lines) != sum(counts)", "if len(lines) < sum(counts)", "test_io_kinds.py"),
    ("io", "at = _behind_lists(", "_behind_lists(", "test_io_kinds.py"),
    ("io", "diff() < -WEEK_S / 2", "diff() < -WEEK_S * 2", "test_io_kinds.py"),
    ("io", "in_radians < 15 < 45 < in_degrees", "False", "test_io_kinds.py"),
    ("io", "refuse(split, what,", "refuse(False, what,", "test_io_kinds.py"),
    ("io", "if len(table) > 2 and (units or", "if len(table) > 2 and (", "test_io_kinds.py"),
    ("io", "scale * heights + offset", "heights", "test_io_kinds.py"),
    ("io", "heights[mask[..., 0] == 0] = np.nan", "pass", "test_io_kinds.py"),
    ("io", "- 1 - pixels", "- 1 - 0 * pixels", "test_io_kinds.py"),
    ("io", "pixels[:, ::-1] if mirrored", "pixels if mirrored", "test_io_kinds.py"),
    ("io", 'data.find(b"\\xff\\xd9", at)', 'data.find(b"\\xff\\xd9")', "test_io_kinds.py"),
    ("_checks", "if part.name != wanted.name and", "if part is ours[0] and part != wanted and",
     "test_io_kinds.py"),
    ("cloud", "crowded and np.abs", "False and np.abs", "test_cloud_units.py"),
    ("cloud", "np.mean(alone) > 0.5", "False", "test_cloud_units.py"),
    ("cloud", "if isinstance(which, tuple) or", "if", "test_cloud_units.py"),
    ("studies", "first & known, ~first & known", "first & known, first & known",
     "test_study_fitness.py"),
    ("studies", "counts.min() < counts.max() / 10", "False", "test_study_fitness.py"),
    ("studies", '.fillna(np.inf)', "", "test_study_fitness.py"),
    ("studies", "% 1 * 0.9 - 0.45", "% 1 * 0.5 - 0.45", "test_study_fitness.py"),
    ("widgets", 'simplefilter("error", UserWarning)', 'simplefilter("ignore")',
     "test_widgets_selection.py"),
    ("widgets", 'or getattr(event.canvas.toolbar, "mode", "")', "", "test_widgets_selection.py"),
    ("widgets", "return [str(self)]", "return []", "test_studies.py"),
    ("widgets", "self._past.pop()\n", "pass\n", "test_widgets_selection.py"),
    ("widgets", "max(self._reach, np.ptp(along) / 2)", "self._reach", "test_widgets_selection.py"),
    ("widgets", "self._missed.set_data([], [])", "pass", "test_widgets_selection.py"),
    ("run", '{"lesson", "results"}', '{"lesson"}', "test_students.py"),
    ("run", "finish_figure(plt.figure(number))", "pass", "test_run.py"),
    ("run", 'remove_input_tags={"results"}', "remove_input_tags=set()", "test_run.py"),
    ("run", 'f"{seen} Numbers: {kind}."', "seen", "test_run.py"),
    ("run", 'os.environ.get("JPY_SESSION_NAME", "")', '""', "test_run.py"),
    ("run", 'ValueError(f"Invalid notebook {cause}', 'RuntimeError(f"{cause}',
     "test_students.py"),
    ("spacing", "_compared_in_two(0, 0, 3, BELOW_ZERO)", "_compared_in_two(0, 0, 3, 0.0)",
     "test_spacing.py"),
    ("spacing", "if other[0] > own[2]:", "if other[0] >= own[2]:", "test_spacing.py"),
    ("spacing", "own >> up <= 1:", "own >> up <= 3:", "test_spacing.py"),
    ("widgets", 'rows["points"] >= LISTED_SHARE', 'rows["points"] >= 0 * LISTED_SHARE',
     "test_widgets_selection.py"),
    ("widgets", "self.quality and self._draw_section()", "self._draw_section()",
     "test_widgets_selection.py"),
    ("samples", "_sha256(archive) != one.archive_sha256", "False", "test_samples.py"),
    ("samples", "if _sha256(target) == one.sha256:", "if False:", "test_samples.py"),
    ("samples", "if have >= one.archive_size:", "if False:", "test_samples.py"),
    ("samples", "return _sha256(_cached(PUBLIC[relative])) == PUBLIC[relative].sha256",
     "return _cached(PUBLIC[relative]).is_file()", "test_samples.py"),
    ("samples", "part.unlink()", "pass", "test_samples.py"),
    ("samples", 'have *= answer.status == 206', 'have *= 0', "test_samples.py"),
    ("samples", "st_size < one.archive_size:", "st_size < 0:", "test_samples.py"),
    ("io", "> Path(path).stat().st_size:", "> 2**40:", "test_io_kinds.py"),
    ("io", "refuse(held != header", "refuse(held < 0 and header", "test_io_kinds.py"),
    ("io", "held += struct.unpack", "held += header.point_count + 0 * struct.unpack",
     "test_io_kinds.py"),
    ("io", "if written == stored else 0", "", "test_io_kinds.py"),
    ("io", "if ends[-1] != table:", "if False:", "test_io_kinds.py"),
    ("io", 'TYPES[size][0] != "f"', "True", "test_bad_inputs.py"),
    ("io", "~(found.abs() < NO_NUMBER)", "~np.isfinite(found)", "test_bad_inputs.py"),
    ("io", 'raw.find(b"\\0")) >= 0', 'raw.find(b"\\0")) < -1', "test_bad_inputs.py"),
    ("io", "file.pages.first ", "file.pages ", "test_bad_inputs.py"),
    ("io", "cv2.imdecode(np.frombuffer(data, np.uint8), flags)", "cv2.imread(str(path), flags)",
     "test_commands.py"),
    ("_checks", "refuse(largest > FARTHEST_M", "refuse(False", "test_bad_inputs.py"),
    ("chart_cloud", "np.multiply(2, d1_mm) < step_mm", "np.multiply(0, d1_mm) > 1",
     "test_chart_cloud.py"),
    ("maps", '["f"][1][below] = np.nan', '["f"][1][below] *= 1', "test_chart_cloud.py"),
    ("commands", "for sentence in lost:", "for sentence in ():", "test_commands.py"),
    ("commands", "elif said:", "elif False:", "test_commands.py"),
    ("commands", "(s for s in told if s not in o)", "()", "test_commands.py"),
    ("commands", 'whole.attrs["failed"] = len(errors)', 'whole.attrs["failed"] = 0',
     "test_commands.py"),
    ("io", "if inside and not ours and not (", "if False and not (", "test_outputs.py"),
    ("io", "_lock(file, folder)\n", "pass\n", "test_outputs.py"),
    ("io", "if made and [path.name", "if False and [path.name", "test_outputs.py"),
    ("commands", "own_folder(folder, ours=ours)", "own_folder(folder, ours=True)",
     "test_outputs.py"),
    ("maps", "own_folder(own)", "own_folder(own, ours=True)", "test_outputs.py"),
)  # fmt: skip


def main(rooms, tree):
    """Plant each fault, run its tests, and put the file right again."""
    for part in ("mmqa_lab", "tests", "data_samples", "notebooks"):
        shutil.copytree(ROOT / part, tree / part, ignore=shutil.ignore_patterns("results"))
    for name in ("pyproject.toml", "README.md", "environment.txt"):
        shutil.copy2(ROOT / name, tree / name)
    outcomes = [outcome(tree, *fault) for fault in FAULTS if not rooms or fault[0] in rooms]
    print({word: outcomes.count(word) for word in sorted(set(outcomes))})
    return int(set(outcomes) != {"caught"})


def outcome(tree, room, old, new, tests):
    """Whether a fault is ``caught``, ``NOT CAUGHT``, or its text is ``GONE``."""
    inside = [tree / "mmqa_lab" / f"{room}.py", *(tree / "mmqa_lab" / room).rglob("*.py")]
    places = [path for path in inside if path.is_file() and old in path.read_text("utf-8")]
    word = "GONE"
    if places:
        text = places[0].read_text("utf-8")
        places[0].write_text(text.replace(old, new, 1), "utf-8")
        word = "caught" if fails(tree, tests, places[0]) else "NOT CAUGHT"
        places[0].write_text(text, "utf-8")
    print(f"{word:10}  {room}: {old}  ->  {new}", flush=True)
    return word


def fails(tree, tests, path):
    """Whether the tests fail on the copy, or the examples in the docstrings of the file."""
    files = [str(path), *(f"tests/{name}" for name in tests.split())]
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:randomly", *files]
    place = {**os.environ, "PYTHONPATH": str(tree)}
    done = subprocess.run(command, cwd=tree, env=place, capture_output=True, text=True)
    if done.returncode not in (0, 1):  # no tests, or none that could be collected
        print(done.stdout[-500:])
    return done.returncode == 1


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rooms", nargs="*")
    with tempfile.TemporaryDirectory() as folder:
        sys.exit(main(parser.parse_args().rooms, Path(folder)))
