"""The report of an acceptance: one page as HTML, the same as PDF, its tables as CSV, the crops.

Nothing in it depends on the hour: two runs on the same files write the same bytes.
"""

import base64
import io
import platform
import textwrap
from pathlib import Path

import cv2
import laspy
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import scipy

from mmqa_lab import __version__, plots
from mmqa_lab.bench._tables import split_unit
from mmqa_lab.chart_cloud import CHART_MARGINS_M
from mmqa_lab.chart_image.legibility import CHECK_LIST, JUDGED, check_list, expected_text
from mmqa_lab.chart_image.rules import ALONG, MARKS, text_crops
from mmqa_lab.io import write_atomically
from mmqa_lab.io.images import encode
from mmqa_lab.planes import CONSISTENT_SCALE
from mmqa_lab.run.pages import filled
from mmqa_lab.tender import COVERAGE
from mmqa_lab.tender.acceptance import VIEWS
from mmqa_lab.tender.photographs import LIMIT_SHARE, exif_texts, fringes
from mmqa_lab.tender.site import sha256

LIBRARIES = (np, scipy, pd, cv2, laspy, matplotlib)

A4_INCHES = (8.27, 11.69)

ROWS_A_SHEET, LETTERS_A_ROW = 66, 125

WIDEST_CELL = 46

FEWEST_POINTS = 100
"""Fewer points on a board tell their number and where it stands, and no more."""

PARAMETERS = {
    "left out of a point chart below, right, above, left (m)": ", ".join(map(str, CHART_MARGINS_M)),
    "largest distance of a point from the board's plane (m)": "0.1",
    "factor of sigma_MAD": f"{CONSISTENT_SCALE:.4f}",
    "density": "of the selected part of the board (section 3.3)",
    "axes of the quadrants": "principal",
    "a cloud's intervals": "noise and place of the pattern on the board, its speed and heights",
    "least interval of d1 and d4": "half a step of the stored coordinates to either side",
    "fewest points of a board for more than their number": f"{FEWEST_POINTS}",
    "tolerance of a drive's distance (m), our own": "0.5",
    "uncertainty of the width at which line pairs vanish": f"{100 * LIMIT_SHARE:g} %",
    "standard deviations of a pixel size in its interval": f"{COVERAGE}",
}

COLUMNS = {
    "system": "system",
    "criterion": "criterion",
    "distance_m": "distance (m)",
    "view": "view",
    "direction": "direction",
    "value": "value",
    "interval": "95 % interval",
    "unit": "unit",
    "asked": "asked",
    "margin": "margin",
    "verdict": "verdict",
}
"""Of a table of verdicts, with their headings."""


def write_report(done, site, folder, *, criteria, root, inputs):
    """Write everything that an acceptance says.

    Parameters
    ----------
    done : Acceptance
    site : Site
    folder : path
        Gets ``report.html``, ``report.pdf``, ``verdicts.csv``, ``results.csv``, ``crops`` and
        ``jury.csv``.
    criteria : dict of DataFrame
    root : path
        Files of the report are named from here.
    inputs : list of path
        Files that count beside those of the drives.

    Returns
    -------
    list of path
        The report as HTML and as PDF.
    """
    folder = Path(folder)
    jury = _write_crops(done, folder / "crops")
    write_atomically(folder / "jury.csv", jury)
    rows = [table.assign(criteria=name) for name, table in done.verdicts.items()]
    write_atomically(folder / "verdicts.csv", pd.concat(rows))
    write_atomically(folder / "results.csv", done.results.drop(columns=["too_good", "too_bad"]))
    with plots.style():
        pictures = {title: _png(figure) for title, figure in _figures(done)}
    parts = _parts(done, site, criteria, _hashes(root, [*inputs, *site.files, *done.files]))
    texts = {"title": "Acceptance of mobile mapping data", "lines": _lines(done, site)}
    encoded = {name: base64.b64encode(picture).decode() for name, picture in pictures.items()}
    page = filled("acceptance.html", parts=parts, pictures=encoded, **texts)
    files = [folder / "report.html", folder / "report.pdf"]
    write_atomically(files[0], page)
    write_atomically(files[1], lambda path: _write_pdf(path, parts, pictures, **texts))
    return files


TABLE_1 = {
    "legibility of 40 mm text": ("legibility_40mm", ""),
    "pixel size (mm), horizontal 600": ("pixel_mm", "h"),
    "pixel size (mm), vertical 800": ("pixel_mm", "v"),
    "line pairs (mm), horizontal": ("w_mm", "h"),
    "line pairs (mm), vertical": ("w_mm", "v"),
}
"""Rows for each system and distance: quantity and direction."""

TABLE_2 = {
    "density (1/m2)": "density_per_m2",
    "precision (mm)": "sigma_mad_mm",
    "d1 (mm)": "d1_mm",
    "d4 (mm)": "d4_mm",
    "f": "f",
    "g": "g",
}


def table_1(done):
    """Image quality as in Table 1 of the paper: a row per system, distance and quantity."""
    rows = []
    for place, figures in _by_drive(done):
        for label, key in TABLE_1.items():
            cells = {view: _cell(figures, (*key, view)) for view in VIEWS}
            rows.append({**place, "": label, **cells})
    return pd.DataFrame(rows)


def table_2(done):
    """Cloud quality as in Table 2 of the paper, of the chart parallel to the path, and g."""
    rows = []
    for place, figures in _by_drive(done):
        cells = {label: _cell(figures, (name, "", "")) for label, name in TABLE_2.items()}
        rows += [place | cells] if any(cells.values()) else []
    return pd.DataFrame(rows)


def _by_drive(done):
    """The figures of each system and distance by quantity, direction and view."""
    for (system, distance), part in done.results.groupby(["system", "distance_m"], sort=True):
        place = {"system": system, "distance (m)": f"{distance:g}"}
        yield place, part.set_index(["quantity", "direction", "view"])


def _cell(figures, key):
    """A figure with its interval; a dash where it could not be measured, empty where not asked."""
    if key not in figures.index:
        return ""
    row = figures.loc[[key]].iloc[0]
    value, low, high = row["value"], row["low"], row["high"]
    if isinstance(value, str):
        return value
    if pd.isna(value):
        return "–" if pd.isna(low) or np.isfinite(high) else f"– (> {low:.3g})"
    if pd.notna(row.get("sigma")):
        reach = COVERAGE * row["sigma"]
        return f"{value:.2f} ± {max(reach, 0.01):.2f}"
    low, high = _short(low), _short(high)
    return _short(value) if low == high else f"{_short(value)} ({low} to {high})"


def _short(number):
    """A number with four figures, whole where it is large."""
    return f"{number:.0f}" if abs(number) >= 1000 else f"{number:.4g}"


def _lines(done, site):
    """What the report begins with."""
    drives = ", ".join(drive.name for drive in done.drives)
    return [
        *([site.note] if site.note else []),
        f"Drives: {drives}.",
        f"Asked: {' m and '.join(f'{d:g}' for d in site.distances_m)} m beside the boards, at "
        f"least {site.speed_kmh:g} km/h; forward and backward images from {site.oblique_m:g} m or "
        "farther, of the nearest drive.",
        "A verdict is undecided where its threshold, or that of the exemption from it, lies within "
        "the 95 % interval, or where the drive was against the rules and may have caused it.",
        "Direction h: the lying bar of 600 mm, pairs of standing bars; v: the two standing bars of "
        "800 mm, pairs of lying bars.",
        "Marks: a every letter, b the text, c not legible; of each element that of most jurors, of "
        "a photograph that of its worst element of 40 mm; its interval is that of the jurors.",
        "Expected marks follow from the pixels per letter, by thresholds fitted to the marks of "
        "Table 1; no verdict uses them.",
        "Intervals of clouds are for another drive of the system at the same mean speed: they "
        "contain the pattern's chance on the board and how speed and heights of the path wander.",
        "All other figures are measured on the delivered data, after Pfeifer et al. 2021, "
        "doi:10.3390/rs13020237.",
    ]


def _parts(done, site, criteria, hashes):
    """Tables of the report by their titles."""
    parts = {"Who qualifies": _overview(done)}
    for name, table in done.verdicts.items():
        parts[f"Verdicts: {name}"] = _verdict_table(table)
    problems = done.problems or [{"where": "", "what": "Everything was judged."}]
    parts["Could not be judged, or only with doubt"] = pd.DataFrame(problems)
    parts["Table 1: image quality (measured)"] = table_1(done)
    parts["Table 2: cloud quality of the chart parallel to the path (measured)"] = table_2(done)
    parts["Drives"] = _drive_table(done)
    parts |= _image_tables(done)
    parts["Clouds on all point charts"] = _cloud_table(done)
    parts["Control points: seen minus surveyed"] = _control_table(done)
    for name, table in criteria.items():
        parts[f"Criteria: {name}"] = table.map(_plain)
    parts["Parameters"] = pd.DataFrame(PARAMETERS.items(), columns=["name", "value"])
    parts["Boards and control points"] = _board_table(site)
    parts["Files and their SHA-256"] = pd.DataFrame(hashes, columns=["file", "SHA-256"])
    names = {"mmqa_lab": __version__, "Python": platform.python_version()}
    names |= {library.__name__: library.__version__ for library in LIBRARIES}
    parts["Versions"] = pd.DataFrame(names.items(), columns=["name", "version"])
    return {title: table for title, table in parts.items() if len(table)}


def _overview(done):
    """A row per set of criteria and system."""
    parts = [table.assign(criteria=name) for name, table in done.summaries.items()]
    table = pd.concat(parts).rename(columns={"because": "not met, or open"})
    names = ["criteria", "system", "verdict", "not met, or open", "met", "exempt", "not_met"]
    table = table[[*names, "undecided", "not_measured"]]
    return table.rename(columns=lambda name: name.replace("_", " ")).map(_plain)


def _verdict_table(table):
    """Verdicts with margin and interval as texts."""
    shown = table.assign(
        interval=[*map(_interval, table["value"], table["low"], table["high"])],
        asked=table["relation"] + " " + table["threshold"].map(_plain),
        unit=table["quantity"].map(_unit),
        value=table["value"].map(_plain),
        margin=table["margin"].map(_plain),
        distance_m=table["distance_m"].map(_plain),
    )
    return shown[list(COLUMNS)].rename(columns=COLUMNS)


def _interval(value, low, high):
    """The ends of an interval as a text, those of marks as marks; empty where there is none."""
    if low == high or pd.isna(low):
        return ""
    if np.isinf(high):
        return f"> {_short(low)}"
    ends = [MARKS[int(end)] if isinstance(value, str) else _short(end) for end in (low, high)]
    return " to ".join(ends)


def _unit(quantity):
    """The unit of a quantity, as its name ends with it; marks of legibility have none."""
    return "" if quantity.startswith("legibility") else split_unit(quantity)[1]


def _plain(value):
    """A cell as text; empty for none."""
    if isinstance(value, str):
        return value
    if value is None or pd.isna(value):
        return ""
    return _short(value) if isinstance(value, float) else str(value)


def _drive_table(done):
    """What each drive did beside what is asked."""
    rows = []
    for drive in done.drives:
        for row in drive.checks.itertuples():
            asked = f"{row.at_least:g} to {row.at_most:g}".replace("to inf", "or more")
            low, high = (f"{round(end, 2) + 0.0:.2f}" for end in (row.low, row.high))
            seen = {"low": low, "high": high, "asked": asked}
            kept = "yes" if row.passed else "no"
            rows.append({"drive": drive.name, "quantity": row.quantity, **seen, "kept": kept})
    return pd.DataFrame(rows)


def _image_tables(done):
    """Which image counts for which board and how it was found; its EXIF; its texts and colours."""
    tables = {"Images": [], "Images: camera and remarks": [], "Images: legibility": []}
    for photo in done.photographs:
        found = photo.found
        place = {
            "drive": photo.drive.name,
            "image": photo.file.name,
            "board": photo.board,
            "view": photo.view,
            "distance (m)": f"{found['distance_m']:.2f}",
            "off normal (deg)": f"{found['off_normal_deg']:.1f}",
            "found by": photo.quality.chart_map.source,
            "right, up of survey (mm)": _shift_text(found["shift_mm"]),
        }
        texts = {
            "crop": found["crop"],
            "px per 40 mm": f"{found['cap_px']:.1f}",
            "marks": found["marks"],
            "because of": found["because"],
            "expected mark": expected_text(found["cap_px"]),
            "colour fringes at the limit": _fringe_text(photo),
        }
        said = {**exif_texts(photo.file), "remark": "; ".join(photo.quality.remarks)}
        image = {name: place[name] for name in ("drive", "image")}
        for name, row in zip(tables, (place, image | said, image | texts), strict=True):
            tables[name].append(row)
    # of grey photographs there are no fringes
    return {
        name: pd.DataFrame(rows).replace("", np.nan).dropna(axis=1, how="all").fillna("")
        for name, rows in tables.items()
    }


def _shift_text(shift):
    """How far from its surveyed place a board is seen; empty where no orientation is given."""
    return "" if shift is None else ", ".join(f"{round(one) + 0:d}" for one in shift)


def _fringe_text(photo):
    """Colours of the finest resolved pairs as shares of the contrast; empty of a grey file."""
    found = fringes(photo)
    return ", ".join(f"{direction} {100 * share:.0f} %" for direction, share in found.items())


def _cloud_table(done):
    """Figures of every point chart, those across the path too; dashes for those of few points."""
    rows = []
    for drive, about, quality in done.clouds:
        figures = {
            "precision (mm)": quality.sigma_mad_mm,
            "d1 (mm)": quality.d1_mm,
            "d4 (mm)": quality.d4_mm,
            "f": quality.f,
        }
        enough = about["n"] >= FEWEST_POINTS
        figures = {name: _short(value) if enough else "–" for name, value in figures.items()}
        counts = {"points": str(about["n"])}
        counts["density (1/m2)"] = _short(quality.density_polygon_per_m2)
        figures = counts | figures
        figures["before its surveyed plane (mm)"] = f"{about['offset_mm']:.1f}"
        place = {"board": about["board"], "view": about["view"]}
        rows.append({"drive": drive.name, **place, **figures})
    return pd.DataFrame(rows)


def _control_table(done):
    """Differences of each control point, and the root mean square of each drive."""
    if not done.control:
        return pd.DataFrame()
    table = pd.DataFrame(done.control)
    squares = table.drop(columns="control point").set_index("drive") ** 2
    rms = np.sqrt(squares.groupby("drive", sort=False).mean()).reset_index()
    table = pd.concat([table, rms.assign(**{"control point": "root mean square"})])
    names = {name: name.removesuffix("_m") + " (mm)" for name in table if name.endswith("_m")}
    numbers = table[list(names)].map("{:.1f}".format).rename(columns=names)
    return pd.concat([table[["drive", "control point"]].astype(str), numbers], axis=1)


def _board_table(site):
    """Places of the boards' middles and of the control points."""
    boards = site.boards
    rows = [(one.board, one.kind, one.corners.mean(axis=0)) for one in boards.itertuples()]
    rows += [(f"control point {k}", "control", place) for k, place in enumerate(site.control, 1)]
    names = ["name", "kind", "easting (m)", "northing (m)", "height (m)"]
    texts = [(name, kind, *(f"{x:.3f}" for x in place)) for name, kind, place in rows]
    return pd.DataFrame(texts, columns=names)


def _figures(done):
    """Title and figure of the clouds and of the photographs of each system."""
    for system in dict.fromkeys(drive.system for drive in done.drives):
        clouds = [one for one in done.clouds if one[0].system == system]
        clouds = [one for one in clouds if one[1]["view"] == ALONG]
        if clouds:
            title = f"System {system}: points on the chart parallel to the path"
            yield title, _cloud_figure(clouds)
        photos = [photo for photo in done.photographs if photo.drive.system == system]
        if photos:
            yield f"System {system}: photographs, with resolved line pairs", _photo_figure(photos)


def _cloud_figure(clouds):
    """The points of each drive by their distance from the plane."""
    figure, axes = plots.subplots(1, len(clouds), width="double", height_mm=75, squeeze=False)
    for ax, (drive, _, quality) in zip(axes[0], clouds, strict=True):
        reach = 3 * quality.sigma_mad_mm
        shades = {"label": "distance from plane (mm)", "cmap": plots.DIVERGING_MAP}
        residuals = 1000 * quality.plane.residuals
        plots.draw_points(quality.xy, ax=ax, values=residuals, limits=(-reach, reach), **shades)
        ax.set_title(f"{drive.distance_m:g} m, {quality.n} points")
    return figure


def _photo_figure(photos):
    """The photographs of a system with their line pairs, resolved or refused."""
    columns = min(len(photos), 4)
    rows = -(-len(photos) // columns)
    figure, axes = plots.subplots(rows, columns, width="double", height_mm=62 * rows, squeeze=False)
    for ax in axes.flat[len(photos) :]:
        ax.set_axis_off()
    for ax, photo in zip(axes.flat, photos, strict=False):
        photo.quality.plot(ax=ax).set_anchor("N")
        ax.get_legend().remove()
        ax.set_title(f"{photo.view}, {photo.found['distance_m']:.1f} m", fontsize=7)
    named = axes.flat[0].get_legend_handles_labels()
    figure.legend(*named, loc="outside lower center", ncols=2)
    return figure


def _png(figure):
    """A figure as PNG without the program's version."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=150, metadata={"Software": None})
    plt.close(figure)
    return buffer.getvalue()


def _write_crops(done, folder):
    """Crops under names that tell nothing, and the form for three jurors in the list's order."""
    rows = []
    for photo in done.photographs:
        crop, quality = photo.found["crop"], photo.quality
        _write_picture(folder / f"{crop}.png", quality.image)
        for number, element, image in _elements(quality):
            name = f"{crop}_{number:02d}"
            _write_picture(folder / f"{name}.png", image)
            rows.append((name, element))
        if not any(name.startswith(crop) for name, _ in rows):
            rows.append((crop, "the photograph"))
    empty = dict.fromkeys(("juror_1", "juror_2", "juror_3"), "")
    return pd.DataFrame(sorted(rows), columns=["crop", "shows"]).assign(**empty)


def _elements(quality):
    """Number, name and image of the elements that count; none where the chart lacks them."""
    try:
        texts = check_list(quality.layout)
    except ValueError:
        return
    numbers = {what: number for number, (what, _, _) in enumerate(CHECK_LIST, start=1)}
    texts = [text for text in texts if text.name in JUDGED]
    for crop in text_crops(quality.image, quality.layout, quality.chart_map, texts=texts):
        yield numbers[crop.name], crop.name, crop.image


def _write_picture(file, image):
    """Linear light as PNG."""
    grey = np.round(255 * np.clip(encode(image, "srgb"), 0, 1)).astype(np.uint8)
    data = cv2.imencode(".png", grey)[1].tobytes()
    write_atomically(file, lambda path: path.write_bytes(data))


def _hashes(root, files):
    """Each file, named from a folder, with its SHA-256."""
    root = Path(root).resolve()
    named = {}
    for file in files:
        whole = Path(file).resolve()
        name = whole.relative_to(root).as_posix() if whole.is_relative_to(root) else whole.name
        named[name] = whole
    return [(name, sha256(file)) for name, file in sorted(named.items())]


def _write_pdf(path, parts, pictures, *, title, lines):
    """The report as sheets of A4: tables, then figures, three to a sheet."""
    from matplotlib.backends.backend_pdf import PdfPages
    from matplotlib.figure import Figure
    from matplotlib.image import imread

    with PdfPages(path, metadata={"CreationDate": None, "Title": title}) as file:
        for sheet in _sheets(parts, title, lines):
            file.savefig(sheet)
        named = list(pictures.items())
        for first in range(0, len(named), 3):
            sheet = Figure(figsize=A4_INCHES, layout="none")
            for place, (caption, picture) in enumerate(named[first : first + 3]):
                top = 0.97 - 0.32 * place
                sheet.text(0.07, top, caption, fontsize=10, va="top")
                ax = sheet.add_axes((0.05, top - 0.3, 0.9, 0.28), frame_on=False)
                ax.set(xticks=[], yticks=[])
                ax.imshow(imread(io.BytesIO(picture)))
                ax.set_anchor("N")
            file.savefig(sheet)


def _sheets(parts, title, lines):
    """Sheets with as many rows of text as fit; tables in letters of one width."""
    from matplotlib.figure import Figure

    pages = [[title, "", *(row for line in lines for row in textwrap.wrap(line, 118))]]
    for name, table in parts.items():
        head, *rows = _rows(table)
        if len(pages[-1]) + 6 > ROWS_A_SHEET:
            pages.append([])
        pages[-1] += ["", "", name, "", head]
        for row in rows:
            if len(pages[-1]) == ROWS_A_SHEET:
                pages.append([f"{name}, continued", "", head])
            pages[-1].append(row)
    for number, page in enumerate(pages, start=1):
        sheet = Figure(figsize=A4_INCHES, layout="none")
        size = 6.3 * min(1, LETTERS_A_ROW / max(map(len, page)))
        choices = {"family": "DejaVu Sans Mono", "va": "top", "linespacing": 1.9 * 6.3 / size}
        sheet.text(0.06, 0.97, "\n".join(page), parse_math=False, fontsize=size, **choices)
        sheet.text(0.94, 0.02, f"{number}", fontsize=7, ha="right")
        yield sheet


def _rows(table):
    """A table as lines of text, its long cells wrapped."""
    wrapped = []
    for row in table.astype(str).to_numpy():
        cells = [textwrap.wrap(cell, WIDEST_CELL) or [""] for cell in row]
        depth = max(map(len, cells))
        wrapped += zip(*(cell + [""] * (depth - len(cell)) for cell in cells), strict=True)
    columns = list(zip(map(str, table.columns), *wrapped, strict=True))
    widths = [max(map(len, column)) for column in columns]
    rows = zip(*columns, strict=True)
    return [
        "  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
