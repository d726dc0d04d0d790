"""Faults made by hand in the library, one after the other: does the test meant for it fail?

``python tests/benchmarks/mutations.py`` works on a copy of the repository. It lists what was
caught, what was not, and faults whose text no longer stands in the room. With names of rooms only
theirs.

``--random 200`` draws single changes over all rooms instead: a comparison, an operator, a number,
and / or. Plots, messages, checks, defaults and constants of layouts are left out. Each is tested by
the test files of its room and the examples of its file; what passes is listed, for people to judge.
"""

import argparse
import ast
import copy
import os
import random
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LONGEST_S = 1200

FAULTS = (
    # room, what stands there, the fault, the tests that must fail
    ("commands", 're.match(r"-\\.?\\d", word)', "False", "test_commands.py"),
    ("commands", 'or text.startswith("Invalid")', "or text", "test_commands.py"),
    ("commands", "if backend and backend in text", "if False", "test_commands.py"),
    ("commands", "if len(errors) == len(files) == 1:", "if errors:", "test_commands.py"),
    ("commands", "if len(text.splitlines()[0]) > WIDTH:", 'if "\\\\" in text:', "test_commands.py"),
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
    ("planes", "np.sin(turn)], [-np.sin(turn)", "-np.sin(turn)], [np.sin(turn)",
     "test_chart_cloud.py"),
    ("spacing", "self.d[-1] / self.d[0]", "self.d[-2] / self.d[0]", "test_spacing.py"),
    ("spacing", "np.sqrt(1 / check_positive(rho0", "np.sqrt(2 / check_positive(rho0",
     "test_spacing.py"),
    ("spacing", "np.sqrt(-4 * np.log1p", "np.sqrt(-2 * np.log1p", "test_spacing.py"),
    ("spacing", "known = (self.distances <= self.border)", "known = (self.distances <= np.inf)",
     "test_spacing_empty.py"),
    ("spacing", "query(places, [rank])", "query(places, [1])", "test_spacing_empty.py"),
    ("stats", "np.arange(3, 11)", "np.arange(3, 13, 2)", "test_stats.py"),
    ("stats", "counts.max() * WAVE_PARTS > len(places)", "False", "test_stats.py"),
    ("chart_cloud", "if coarse or is_by_chance(self.xy, self.axes):", "if coarse:",
     "test_chart_cloud.py"),
    ("chart_cloud", "noise_mm**2 > (1 - BENT)", "noise_mm**2 > 0", "test_chart_cloud.py"),
    ("chart_cloud", "(found.border >= reach)", "(found.border >= 0)", "test_chart_cloud.py"),
    ("scan_pattern", "axis=-1)[..., 2], 0.95", "axis=-1)[..., 1], 0.95", "test_plan.py"),
    ("scan_pattern", "gap *= 1 + slopes[:, 1] * fall", "gap *= 1", "test_scan_pattern_measure.py"),
    ("scan_pattern", "turn = slopes[:, 0] + slopes[:, 1] * rise", "turn = slopes[:, 0]",
     "test_scan_pattern_measure.py"),
    ("repeatability", "100 / abs(self.mean) if self.mean else np.nan", "100 / abs(self.mean or 1)",
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
    ("lines", "sqrt(weight * self.angle**2", "sqrt(weight * self.angle", "test_lines.py"),
    ("lines", "if pairs.size and not pairs.any()", "if pairs.sum() < 200", "test_lines_lhd.py"),
    ("lines", "<= least[0] and evidence <=", "<= 0 and 1e9 * evidence <=", "test_lines.py"),
    ("lines", "return np.maximum(ratio.sum(axis=0), 0)", "return 0 * ratio[0]", "test_lines.py"),
    ("lines", "min(RIVAL + share, MOST_RIVAL)", "1", "test_lines.py"),
    ("lines", "if share < FEW_SHARE", "if False", "test_lines.py"),
    ("lines", "np.radians([-3, -1.5, 0, 1.5, 3])", "np.radians([0.0])", "test_lines_lhd.py"),
    ("plane_search", "np.argsort(x + np.sqrt(2) * y + np.sqrt(3) * z", "np.argsort(0 * x",
     "test_lines_edges.py"),
    ("lines", "np.radians(8), 0.06, 0.05,", "np.radians(8), 0.06, 0.002,", "test_lines_lhd.py"),
    ("lines", "0.06, 0.05, 6.0", "0.06, 0.05, 60.0", "test_lines.py"),
    ("lines", "return off <= 5 * np.median(off)", "return off < np.inf", "test_lines.py"),
    ("lines", "return np.unique(turned, axis=0,", "return np.unique(segments, axis=0,",
     "test_lines.py"),
    ("lines", "high=MOST_RADIUS_M", "high=np.inf", "test_lines.py"),
    ("lines", "if last >= 0 and high <= low", "if high <= low", "test_lines.py"),
    ("lines", "> 0.3 * (high - low)", "> 3 * (high - low)", "test_lines_lhd.py"),
    ("plane_search", "contextlib.suppress(ValueError)", "contextlib.suppress()",
     "test_lines_edges.py"),
    ("plane_search", "np.abs(off - np.median(residuals))", "np.abs(off)", "test_lines_edges.py"),
    ("plane_search", "moments[0, 0] < 1.5 * beside", "moments[0, 0] < 0 * beside",
     "test_lines_edges.py"),
    ("lines", "math.sqrt(px * px", "math.sqrt(0 * px", "test_lines.py"),
    ("lines", "np.fmax(there.perp", "np.fmin(there.perp",
     "test_lines_lhd.py"),
    ("tender", "sign * (rank - limit)", "sign * (limit - rank)", "test_tender.py"),
    ("poles", "gaps = np.minimum(np.diff(used), 2 * ROOF_WINDOW)", "gaps = np.diff(used)",
     "test_poles.py"),
    ("poles", "size.prod() > MOST_GROUND_CELLS", "False", "test_poles.py"),
    ("poles", "order[rank < 3]", "order[rank < 1]", "test_poles.py"),
    ("poles", "unclear.any()", "False", "test_poles_scores.py"),
    ("poles", "upright.mean() > 0.5", "False", "test_poles.py"),
    ("poles", "> TALL_M:", "> 1e9:", "test_poles.py"),
    ("poles", '("method", "explain", *CHOICES[method])', "(name,)", "test_poles.py"),
    ("poles", "(width > COVERED * radius)", "(width > 0)", "test_poles.py"),
    ("poles", "2 * np.median(away) + LOW_M", "1e9", "test_poles.py"),
    ("poles", "axes[:, 2:4] @ turned[:2, :2].T", "axes[:, 2:4]", "test_poles.py"),
    ("poles", "top < STOUT * ", "0 * top > ", "test_poles.py"),
    ("studies", "counted[first], counted[other]", "counted[other], counted[first]",
     "test_study_poles.py"),
    ("tender", "COVERAGE = 1.96", "COVERAGE = 1.0", "test_tender.py"),
    ("tender", 'relation.replace(">", "<")', "relation", "test_tender.py"),
    ("tender", "if bare or doubted(quantity, remarks)", "if False", "test_tender.py"),
    ("tender", "if value != 0 and not np.isnan(value):", "if False:", "test_tender.py"),
    ("tender", '.dropna(how="all")', "", "test_tender.py"),
    ("tender", "surely and not any(", "surely and any(", "test_tender.py"),
    ("test_field", "dz.abs().quantile(0.9)", "dz.quantile(0.9)",
     "test_test_field.py"),
    ("mtf", "refuse(bent > TORN", "refuse(False", "test_silent_images.py"),
    ("mtf", "if clipped(fit, sign)]", "if False]", "test_silent_images.py"),
    ("mtf", "one_sided(fit) > ONE_SIDED", "False", "test_silent_images.py"),
    ("mtf", "= strange > OTHER_EDGE and", "= False and", "test_silent_images.py"),
    ("mtf", "(overshoot(fit) > OVERSHOOT, ", "(False, ", "test_silent_images.py"),
    ("mtf", " and overshoot(fit) <= OVERSHOOT", "", "test_silent_images.py"),
    ("mtf", "(clipped, clips)", "(False, clips)", "test_silent_images.py"),
    ("mtf", "np.sqrt(2 * bins)", "1", "test_mtf.py"),
    ("mtf", "WIDEST_GAP_PX = 0.75", "WIDEST_GAP_PX = 0.7", "test_mtf.py"),
    ("image_targets", "for name in targets.columns:", "for name in ():", "test_image_targets.py"),
    ("image_targets", "if np.ptp(means) > max(", "if 0 > max(", "test_image_targets.py"),
    ("image_targets", "except ValueError as error", "except OSError as error",
     "test_image_targets.py"),
    ("image_targets", '"exposure": exposure', '"exposure": 1.0', "test_image_targets.py"),
    ("image_targets", ", anisotropy=row.anisotropy", "", "test_image_targets.py"),
    ("mtf", "(second > OTHER_STEP, ", "(False, ", "test_silent_images.py"),
    ("mtf", "if np.ptp(phase) > LARGEST_DRIFT:", "if False:", "test_silent_images.py"),
    ("mtf", "(beyond > SHARPENED, ", "(False, ", "test_mtf.py"),
    ("mtf", "(unlike and not clipped, ", "(False, ", "test_mtf.py"),
    ("mtf", "(round_, ", "(False, ", "test_mtf.py"),
    ("mtf", "faintest < SEEN_SHARE,", "False,", "test_silent_images.py"),
    ("mtf", "np.maximum(fit.noise, PROFILE_ERROR) ** -2.0", "fit.noise**-2.0", "test_mtf.py"),
    ("mtf", "np.maximum(fit.noise, PROFILE_ERROR) ** -2.0", "fit.noise", "test_mtf.py"),
    ("mtf", "_plausible(across, values) |", "_plausible(across, 0 * values) |", "test_mtf.py"),
    ("mtf", "+ plane[1] * along", "", "test_mtf.py"),
    ("mtf", "2 * _plain_level(", "1.9 * _plain_level(", "test_mtf.py"),
    ("mtf", "frequency = n / (2 * np.pi * rings)", "frequency = n / (np.pi * rings)",
     "test_mtf.py"),
    ("radiometry", "(reference[1] / f_number) ** 2", "(f_number / reference[1]) ** 2",
     "test_radiometry.py"),
    ("radiometry", "np.argwhere(missing.to_numpy())[:1]", "()", "test_radiometry.py"),
    ("radiometry", "FALLOFF = (0.0, 0.3)", "FALLOFF = (0.0, 0.0)", "test_radiometry.py"),
    ("radiometry", "known[place] ** -0.5", "1.0", "test_radiometry.py"),
    ("radiometry", "            if iteration:\n", "            if False:\n", "test_radiometry.py"),
    ("radiometry", "(images, f", "(False, f", "test_radiometry.py"),
    ("radiometry", "(known, f", "(False, f", "test_radiometry.py"),
    ("radiometry", "covariance * loose**2", "covariance", "test_radiometry.py"),
    ("radiometry", "return odd if chance[odd] <", "return odd if 1 <", "test_radiometry.py"),
    ("radiometry", "(hot_spot, f", "(False, f", "test_radiometry.py"),
    ("radiometry", "if iteration > REWEIGHTINGS:", "if False:", "test_radiometry.py"),
    ("radiometry", "uneven.any(),", "False,", "test_radiometry.py"),
    ("radiometry", "odd > 0.01,", "False,", "test_radiometry.py"),
    ("radiometry", "5 * counts[1:].max(), FEWEST_PILED", "5 * counts[1:].max(), 1",
     "test_silent_images.py"),
    ("radiometry", "self.n - 1 - int(", "self.n - int(", "test_radiometry.py"),
    ("chart_image", "axis=1).max() > BEND_PX else", "axis=1).max() > 1e9 else",
     "test_chart_bent.py"),
    ("chart_image", "if typical > LEGIBLE and", "if False and", "test_chart_photographs.py"),
    ("chart_image", "refuse(bent > LARGEST_BEND", "refuse(False", "test_chart_bent.py"),
    ("chart_image", "(bent > SAID_BEND, ", "(False, ", "test_chart_bent.py"),
    ("chart_image", "size not in (None, (columns, rows))", "False", "test_io_cameras.py"),
    ("io", "if model not in BROWN:", "if False:", "test_io_cameras.py"),
    ("chart_image", "isin(crossed) & ~seen", "isin([])", "test_chart_photographs.py"),
    ("chart_image", "(clipped > 0.05, ", "(False, ", "test_silent_images.py"),
    ("chart_image", "abs(tone - 0.5) > 0.12", "False", "test_chart_photographs.py"),
    ("chart_image", "behind[behind].index", "behind[:0].index", "test_chart_photographs.py"),
    ("chart_image", "UNSEEN_PX * hidden", "0 * hidden", "test_chart_photographs.py"),
    ("chart_image", "1 + (other.charts if other else 0)", "1", "test_chart_photographs.py"),
    ("chart_image", "side(other, layout) > side(", "False and (", "test_chart_photographs.py"),
    ("chart_image", 'refuse(turned, "image"', 'refuse(False, "image"', "test_chart_image_files.py"),
    ("chart_image", "self.rim = int(np.ceil(RIM_SIGMAS * blur))", "self.rim = 0",
     "test_chart_photographs.py"),
    ("chart_image", "len(found := _finer(quality, one)) > 1", "False and (found := one)",
     "test_chart_photographs.py"),
    ("tender", "if odd and not (told", "if False and not (told", "test_tender.py"),
    ("tender", "all(axis=1))].drop_duplicates()", "all(axis=1))]", "test_tender.py"),
    ("charts", "LENGTHS & set(vars(one))", "{'pair'} & set(vars(one))", "test_charts.py"),
    ("stats", "of_next + 1 / n", "of_next + 1 / (n - 1)", "test_bench.py test_stats.py"),
    ("bench", "for case in draw", "for case in sorted(set(draw))", "test_bench.py"),
    ("bench", 'transform("sum") == cells', 'transform("sum") > 0', "test_bench.py"),
    ("bench", '"display.max_colwidth", None', '"display.max_colwidth", 50', "test_bench.py"),
    ("widgets", "PlaceHolderLayoutEngine(True, True)", '"none"', "test_widgets_selection.py"),
    ("widgets", "place[self._owner == 0], place[self._owner < 0] = 0, -2",
     "place[self._owner < 0] = -2", "test_widgets_selection.py"),
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
    ("maps", 'if np.prod(size / cell + 1) > most', "if False", "test_maps.py"),
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
    ("io", "_check_count(len(lines) != sum", "_check_count(len(lines) < sum", "test_io_kinds.py"),
    ("io", "at = _behind_lists(", "_behind_lists(", "test_io_kinds.py"),
    ("io", "back < -WEEK_S / 2", "back < -WEEK_S * 2", "test_io_kinds.py"),
    ("io", "other = near or np.median", "other = np.median", "test_io_trajectories.py"),
    ("io", "rows[:, 9] - rows[:, 10]", "rows[:, 9]", "test_io_trajectories.py"),
    ("io", "refuse(split, what,", "refuse(False, what,", "test_io_kinds.py"),
    ("io", 'check_columns(table, ["heading_deg"]', "check_columns(table, []", "test_io_kinds.py"),
    ("io", "counted or high or words.any()", "counted or high", "test_io_kinds.py"),
    ("io", "doubted = len(table) > 2 and (units or", "doubted = len(table) > 2 and (",
     "test_io_kinds.py"),
    ("io", "z = scale * heights.data", "z = heights.data", "test_io_kinds.py"),
    ("io", "~np.ma.getmaskarray(heights) & ", "", "test_io_kinds.py"),
    ("io", "- 1 - pixels", "- 1 - 0 * pixels", "test_io_kinds.py"),
    ("io", "pixels[:, ::-1] if mirrored", "pixels if mirrored", "test_io_kinds.py"),
    ("io", 'data.find(b"\\xff\\xd9", at)', 'data.find(b"\\xff\\xd9")', "test_io_kinds.py"),
    ("_checks", "if part.name != wanted.name and", "if part is ours[0] and part != wanted and",
     "test_io_kinds.py"),
    ("cloud", "crowded and np.abs", "False and np.abs", "test_cloud_units.py"),
    ("cloud", "np.mean(alone) > 0.5", "False", "test_cloud_units.py"),
    ("cloud", "if isinstance(which, tuple) or", "if", "test_cloud_units.py"),
    ("studies", "counts.min() < counts.max() / 10", "False", "test_study_fitness.py"),
    ("studies", "right = (values[~chooses] <=", "right = (values[~chooses] >=",
     "test_study_fitness.py"),
    ("studies", "1 - 0.025 / max(len(figures.columns) - 1, 1)", "0.975", "test_study_fitness.py"),
    ("studies", "errors.append(found if rank == 3 else", "errors.append(found if rank else",
     "test_study_fitness.py"),
    ("studies", "np.sqrt(farther), np.sqrt", "farther, np.sqrt", "test_study_fitness.py"),
    ("metrics", "2 * np.sqrt(chart.pattern.density)", "np.sqrt(chart.pattern.density)",
     "test_metrics.py"),
    ("metrics", "for n in (counts, counts - 1)", "for n in (counts, counts)", "test_metrics.py"),
    ("metrics", "RIPLEY_M) - len(centres)", "RIPLEY_M)", "test_metrics.py"),
    ("metrics", "return np.where(np.isnan(signed), np.inf, signed)", "return signed",
     "test_study_fitness.py"),
    ("commands", "-known.get(study.stem, 0)", "known.get(study.stem, 0)", "test_commands.py"),
    ("widgets", 'simplefilter("error", UserWarning)', 'simplefilter("ignore")',
     "test_widgets_selection.py"),
    ("widgets", 'or getattr(event.canvas.toolbar, "mode", "")', "", "test_widgets_selection.py"),
    ("views", "get_ipython() is not None", "None", "test_views.py"),
    ("widgets", "return [str(self)]", "return []", "test_studies.py"),
    ("widgets", "self._past.pop()\n", "pass\n", "test_widgets_selection.py"),
    ("widgets", "max(self._reach, np.ptp(along) / 2)", "self._reach", "test_widgets_selection.py"),
    ("widgets", "marks.set_data([], [])", "pass", "test_widgets_selection.py"),
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
    ("samples", "if _hash(target, one.hash) != one.hash:", "if True:", "test_samples.py"),
    ("samples", "return _hash(_cached(one), one.hash) == one.hash",
     "return _cached(one).is_file()", "test_samples.py"),
    ("samples", "refuse(other != one.hash", "refuse(not other", "test_samples.py"),
    ("io", "> Path(path).stat().st_size:", "> 2**40:", "test_io_kinds.py"),
    ("io", "refuse(held != header", "refuse(held < 0 and header", "test_io_kinds.py"),
    ("io", "held += count", "held += header.point_count",
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
    ("__main__", "if sys.version_info < (3, 11):", "if False:", "test_commands.py"),
    ("commands", "for sentence in lost:", "for sentence in ():", "test_commands.py"),
    ("commands", "elif said:", "elif False:", "test_commands.py"),
    ("commands", "(s for s in told if s not in o)", "()", "test_commands.py"),
    ("commands", 'else int(len(errors) > 0)', 'else 0',
     "test_commands.py"),
    ("io", "if inside and not ours and not (", "if False and not (", "test_outputs.py"),
    ("io", "_lock(file, folder)\n", "pass\n", "test_outputs.py"),
    ("io", "if made and [path.name", "if False and [path.name", "test_outputs.py"),
    ("commands", "own_folder(folder, ours=ours)", "own_folder(folder, ours=True)",
     "test_outputs.py"),
    ("io", 'found.sort(key="vertex".__ne__)', "found.sort()", "test_io_kinds.py"),
    ("io", "and name not in elements[-1][2]", "", "test_io_kinds.py"),
    ("io", "if number < 0:", "if False:", "test_io_kinds.py"),
    ("io", "and scale != 0", "", "test_io_kinds.py"),
    ("io", "refuse(one_bit or", "refuse(False and one_bit or", "test_io_kinds.py"),
    ("io", "if same > 1:", "if False:", "test_io_kinds.py"),
    ("io", "range(max(most, len(names)))", "range(len(names))", "test_io_kinds.py"),
    ("maps", "own_folder(own)", "own_folder(own, ours=True)", "test_outputs.py"),
)  # fmt: skip


# Rooms and functions that draw or speak, and what is called to refuse, to warn or to say.
DRAWN = ("plots", "views", "widgets", "commands", "run", "samples", "_checks", "published")
SPOKEN_BY = {"refuse", "warn", "sentences", "ValueError", "TypeError", "OSError", "print", "round"}
COMPARED = {ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Gt: ast.LtE, ast.GtE: ast.Lt}
COMPARED |= {ast.Eq: ast.NotEq, ast.NotEq: ast.Eq}
COUNTED = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult}
JOINED = {ast.And: ast.Or, ast.Or: ast.And}


def changes(path):
    """The single changes of a file: node, and the text that takes its place."""
    text = path.read_text("utf-8")
    for node in _working(ast.parse(text)):
        new = copy.deepcopy(node)
        if isinstance(node, ast.Compare) and type(node.ops[0]) in COMPARED:
            new.ops[0] = COMPARED[type(node.ops[0])]()
        elif isinstance(node, ast.BinOp) and type(node.op) in COUNTED:
            new.op = COUNTED[type(node.op)]()
        elif isinstance(node, ast.BoolOp):
            new.op = JOINED[type(node.op)]()
        elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
            new.value = node.value * 2 if node.value not in (0, 1) else 1 - node.value
        else:
            continue
        yield node, f"({ast.unparse(new)})"


def _working(node):
    """The nodes of a module's functions that calculate."""
    for child in ast.iter_child_nodes(node):
        name = getattr(getattr(child, "func", None), "id", getattr(child, "name", ""))
        name = name or getattr(getattr(child, "func", None), "attr", "")
        left_out = ast.Raise | ast.JoinedStr | ast.arguments | ast.Import | ast.ImportFrom
        spoken = isinstance(child, left_out) or name in SPOKEN_BY or "plot" in str(name)
        top = isinstance(node, ast.Module) and not isinstance(child, ast.FunctionDef | ast.ClassDef)
        if not spoken and not top and not str(name).startswith("check_"):
            yield child
            yield from _working(child)


def tests_of(path, tree):
    """The test files of a file's room, as far as they have its name."""
    parts = path.relative_to(tree / "mmqa_lab").with_suffix("").parts
    words = (
        [f"study_{parts[-1]}"] if parts[0] == "studies" else [f"{parts[0]}_{parts[-1]}", parts[0]]
    )
    for word in words:
        found = sorted(one.name for one in (tree / "tests").glob(f"test_{word.strip('_')}*.py"))
        if found:
            return " ".join(found)
    return {"plane_search": "test_lines_edges.py"}.get(parts[0], "")


def at_random(count, seed, tree):
    """Draw changes over all rooms and count which are caught."""
    copied(tree)
    rng, caught, seen = random.Random(seed), 0, 0
    files = [one for one in sorted((tree / "mmqa_lab").rglob("*.py")) if tests_of(one, tree)]
    files = [one for one in files if one.relative_to(tree / "mmqa_lab").parts[0] not in DRAWN]
    drawn = [(path, *change) for path in files for change in changes(path)]
    for path, node, new in rng.sample(drawn, min(count, len(drawn))):
        text, name = path.read_text("utf-8"), path.relative_to(tree)
        lines = text.encode().splitlines(keepends=True)
        before = sum(map(len, lines[: node.lineno - 1])) + node.col_offset
        after = sum(map(len, lines[: node.end_lineno - 1])) + node.end_col_offset
        old = text.encode()[before:after]
        path.write_bytes(text.encode()[:before] + new.encode() + text.encode()[after:])
        found = fails(tree, tests_of(path, tree), path)
        path.write_text(text, "utf-8")
        caught, seen = caught + found, seen + 1
        word = "caught" if found else "NOT CAUGHT"
        print(f"{word:10}  {name}:{node.lineno} {old.decode()} -> {new}")
        print(f"{caught} of {seen} caught", flush=True)
    return int(caught < 0.85 * seen)


def copied(tree):
    """Copy what the tests need into a folder."""
    for part in ("mmqa_lab", "tests", "data_samples", "notebooks"):
        shutil.copytree(ROOT / part, tree / part, ignore=shutil.ignore_patterns("results"))
    for name in ("pyproject.toml", "README.md", "environment.txt"):
        shutil.copy2(ROOT / name, tree / name)


def main(rooms, tree):
    """Plant each fault, run its tests, and put the file right again."""
    copied(tree)
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
    quiet = {"capture_output": True, "text": True}
    try:
        done = subprocess.run(command, cwd=tree, env=place, timeout=LONGEST_S, **quiet)
    except subprocess.TimeoutExpired:  # a change by which a loop has no end is seen
        return True
    if done.returncode not in (0, 1):  # no tests, or none that could be collected
        print(done.stdout[-500:])
    return done.returncode == 1


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rooms", nargs="*")
    parser.add_argument("--random", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if given.random:
            sys.exit(at_random(given.random, given.seed, Path(folder)))
        sys.exit(main(given.rooms, Path(folder)))
