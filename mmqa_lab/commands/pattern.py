"""Measure the scan pattern of a planar patch: profile spacing, profile angle, point spacing.

All profiles of the patch are fitted at once; every figure has its standard deviation. Profiles are
told apart by scan line or GPS time where the file has them and --alone is not given, otherwise by
the pattern: the straightest of its families of lines, with a warning where two fit equally well.
One patch, one pass of one scanner head; without --polygon the whole cloud is taken for the patch.
After Cahalane et al. 2014 (doi 10.3390/s140609471), section 4, who clicked.
"""

from mmqa_lab.commands._output import (
    CLOUDS,
    OUTPUT,
    SELECTION,
    option,
    print_rows,
    switch,
    with_progress,
)

SUMMARY = "profile spacing, profile angle and point spacing in a cloud"

EPILOG = """\
example:
  mmqa pattern facade.laz --polygon "0,0,0; 1,0,0; 1,0,1; 0,0,1"
  mmqa pattern facade.laz --polygon patch.geojson --mirror-frequency 100 --json
"""


ARGUMENTS = (
    CLOUDS,
    *SELECTION,
    switch("--alone", "use neither times nor scan lines"),
    option("--mirror-frequency", "HZ", "revolutions a second, if known", float),
    option("--pulse-rate", "HZ", "pulses a second, if known", float),
    *OUTPUT,
)


def run(options):
    """Measure every cloud, then print and write."""
    import pandas as pd

    tables = []
    for file in with_progress(options.cloud, "cloud"):
        found = _measured(file, options)
        tables.append(found.to_frame().assign(numbering=found.numbering))
        tables[-1].insert(0, "file", file)
    print_rows(pd.concat(tables, ignore_index=True), options)


def _measured(file, options):
    """The pattern of one file."""
    from mmqa_lab.chart_cloud import inside_polygon
    from mmqa_lab.io import read_cloud, read_polygon
    from mmqa_lab.scan_pattern import measure_pattern

    cloud = read_cloud(file)
    if options.polygon is not None:
        polygon = read_polygon(options.polygon)
        cloud = cloud[inside_polygon(cloud, polygon, thickness=options.thickness)]
    rates = {
        "mirror_frequency_hz": options.mirror_frequency,
        "pulse_rate_hz": options.pulse_rate,
    }
    columns = {} if options.alone else {name: cloud[name] for name in _present(cloud)}
    return measure_pattern(cloud, **columns, **rates)


def _present(cloud):
    """Which of the columns that tell profiles apart a cloud has."""
    return [name for name in ("gps_time", "scan_line") if name in cloud.columns]
