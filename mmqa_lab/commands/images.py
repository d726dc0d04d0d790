"""The commands on photographs: the chart to print and to measure, and radiometry."""

import warnings
from pathlib import Path
from typing import Literal

from mmqa_lab._checks import check_choice
from mmqa_lab.commands.machine import (
    FIGURE_ENDINGS,
    check_ending,
    each_file,
    say_shown,
    table,
    write_figure,
)

__all__ = ["chart", "image", "radiometry"]

TRUE_SIZE = (
    "Taken as printed at true size: give --printed-mm if a rule on the print says that a standing "
    "bar is not 800 mm long."
)


@table
def chart(*, out: Path, chart: Literal["grey", "revised", "points"] = "grey", seed: int = 0):
    """Write a test chart to print, 1 m x 1 m at true size, as PDF or SVG.

    The imaging chart has long bars for the pixel size, line pairs for the resolution, texts and
    symbols for the legibility, and coded targets that place it. The point chart has random cells
    (Pfeifer et al. 2021, doi 10.3390/rs13020237). Print without scaling. The second page of the
    imaging chart's PDF says how to use it.

    Parameters
    ----------
    out
        Write the chart into this file: .pdf or .svg.
    chart
        The chart: grey and revised are imaging charts, points is the point chart.
    seed
        Seed of the point chart's random cells.
    """
    import pandas as pd

    from mmqa_lab import charts
    from mmqa_lab.io import write_atomically

    ending = check_choice(out.suffix.lower(), "ending", (".pdf", ".svg"))
    points = chart == "points"
    layout = charts.point_chart(seed=seed) if points else charts.imaging_chart(chart)
    notes = "" if points else charts.how_to_use()
    content = layout.to_pdf(notes=notes) if ending == ".pdf" else layout.to_svg()
    write_atomically(out, lambda path: path.write_bytes(content))
    size = {"width_mm": layout.width, "height_mm": layout.height}
    return pd.DataFrame([{"file": out.name, **size, "elements": len(layout.elements)}])


@table
def image(
    images: list[Path],
    /,
    *,
    chart: Literal["grey", "revised"] = "grey",
    printed_mm: float | None = None,
    corners: str | None = None,
    panorama: bool = False,
    camera: Path | None = None,
    linear: bool = False,
    out: Path | None = None,
):
    """Measure photographs of the imaging chart: pixel size, resolved line pairs, noise.

    The chart is found by its coded targets and long bars, or at its corners (Pfeifer et al. 2021,
    doi 10.3390/rs13020237). What cannot be measured is empty; the remark tells what speaks against
    the figures. A photograph that cannot be measured has a row with the reason alone.

    Parameters
    ----------
    images
        Photographs: JPEG, PNG or TIFF.
    chart
        The chart that was printed.
    printed_mm
        Length of its standing bars by a rule, after printing: no photograph shows that a chart was
        printed at 98 %, and all pixel sizes are then 2 % too large. Without it, 800 mm.
    corners
        Corners of the chart in pixels, "X,Y; X,Y; X,Y; X,Y": lower left, lower right, upper right,
        upper left.
    panorama
        The image is equirectangular, 2 : 1.
    camera
        Calibration of a lens that bends lines, as OpenCV writes it: YAML, XML or JSON.
    linear
        Grey values are linear in light.
    out
        Draw the last image that can be measured into this file: .pdf, .png or .svg.
    """
    from mmqa_lab import chart_image, charts

    check_ending(out, "figure", FIGURE_ENDINGS)
    choices = {
        "corners": None if corners is None else _corners(corners),
        "panorama": panorama,
        "calibration": camera,
        "gamma": "linear" if linear else "srgb",
    }
    layout, done = charts.imaging_chart(chart), []
    layout = layout if printed_mm is None else layout.printed(printed_mm)

    def measured(file):
        quality = chart_image.evaluate_file(file, layout, **choices)
        if printed_mm is None and not done:
            warnings.warn(TRUE_SIZE, stacklevel=2)
        done.append((file.name, quality))
        return quality.to_frame()

    frame = each_file(images, "image", measured)
    if out is not None and done:
        say_shown(out, frame)
        write_figure(out, lambda: _two_panels(*done[-1]))
    return frame


def _two_panels(name, quality):
    """A photograph of the chart, and the contrasts of its line pairs."""
    from mmqa_lab import plots

    figure, axes = plots.subplots(1, 2, width="double", height_mm=85)
    quality.plot(ax=axes[0]).set_title(name)
    quality.plot_contrast(ax=axes[1])
    return figure


def _corners(text):
    """Four corners from 'x,y; x,y; x,y; x,y'."""
    import numpy as np

    try:
        return np.array([corner.split(",") for corner in text.split(";")], float).reshape(4, 2)
    except ValueError:
        raise ValueError(f"Invalid corners {text!r}. Must be four times x,y between ;.") from None


@table
def radiometry(
    measure: Literal["edge", "star", "sharpness", "calibrate", "reflect"],
    images: list[Path],
    /,
    *,
    targets: Path | None = None,
    linear: bool = False,
):
    """Measure a camera in your own images: resolution, sensor and reflectance, band by band.

    edge and star measure the resolution on targets; sharpness needs none. calibrate fits gain and
    offset of the sensor to targets of known radiance. reflect turns digital numbers into
    reflectance by the empirical line (EuroSDR 2013, image radiometry). Intervals are of 95 %.

    A row of the targets has image (name of the file; without the column it is in every one), name,
    and for edge, calibrate and reflect x_px, y_px, width_px, height_px (a region); for star x_px,
    y_px, radius_px, cycles; for calibrate radiance, for reflect reflectance (empty where sought),
    or radiance_1, radiance_2, ... by band. Optionally exposure, or time_s and f_number (calibrate);
    reflectance_std, anisotropy (reflect). Other columns are refused. Pixels count in the upright
    image, the first one's centre at 0.

    Parameters
    ----------
    measure
        What to measure.
    images
        Images with any number of bands: JPEG, PNG or TIFF.
    targets
        CSV file of the targets, see above.
    linear
        Values are linear in light, as of RAW files; else edge, star and sharpness decode sRGB.
    """
    from mmqa_lab import image_targets, io

    known = None if targets is None else io.read_table(targets, "targets")
    if known is None and measure != "sharpness":
        raise ValueError(f"Invalid {measure} without targets. Must have --targets.")

    def measured(file):
        values = io.read_bands(file)
        shown = known
        if known is not None and "image" in known:
            names = known["image"].astype(str).str.strip().str.casefold()
            shown = known[names.isin([file.name.casefold(), file.stem.casefold()])]
        return image_targets.measure(values, measure, targets=shown, linear=linear)

    return each_file(images, "image", measured, column="image")
