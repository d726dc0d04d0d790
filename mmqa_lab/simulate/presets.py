"""Scanners as their makers describe them; mount and vary them with ``dataclasses.replace``.

Each preset says where its numbers come from and whether they are nominal or calibrated. What a
source does not state (beam widths, mostly) is left at zero and named.
"""

from dataclasses import replace

import pandas as pd

from mmqa_lab.simulate.scanners import MultiBeamScanner, ProfileScanner

ZF_9012 = ProfileScanner(
    name="Z+F Profiler 9012",
    pulse_rate_hz=1e6,
    mirror_frequency_hz=200,
    range_noise_m=0.001,
    max_range_m=119,
    min_range_m=0.3,
    source="pulse rate and mirror frequency: Pfeifer et al. 2021 (doi 10.3390/rs13020237); noise "
    "of a phase-based profiler at short range: 1 mm, assumed; beam width not stated",
)

HDL_32E = MultiBeamScanner(
    name="Velodyne HDL-32E",
    pulse_rate_hz=32 / 46.08e-6,
    spin_hz=10,
    elevations_deg=tuple(-92 / 3 + 4 / 3 * (k // 2 + 16 * (k % 2)) for k in range(32)),
    range_noise_m=0.02,
    min_range_m=1.0,
    max_range_m=100,
    source="32 beams from -30.67 to +10.67 degrees, 46.08 us a firing cycle (0.69 MHz; 1.39 MHz "
    "of two returns), noise 2 cm: as usually quoted from the maker's manual, which was not "
    "seen; firing order as in a real sweep; beam width not stated",
)

ROAMER = ProfileScanner(
    name="ROAMER",
    pulse_rate_hz=120_000,
    mirror_frequency_hz=48,
    tilt_deg=45,
    range_noise_m=0.002,
    exit_diameter_m=0.0033,
    divergence_mrad=0.16,
    max_range_m=76,
    min_range_m=0.6,
    source="EuroSDR 2013, mobile laser scanning, section 3.1.3.2: 48 Hz, plane tilted backwards by "
    "45 degrees; Table 3-2: 120 kHz, 3.3 mm + 0.16 mrad, 2 mm at 25 m, 76 m; least range, and that "
    "the 76 m are for a reflectance of 80 %, assumed",
)

VQ_450 = ProfileScanner(
    name="RIEGL VQ-450",
    pulse_rate_hz=550_000,
    mirror_frequency_hz=200,
    heading_deg=45,
    tilt_deg=45,
    range_noise_m=0.005,
    divergence_mrad=0.3,
    min_range_m=1.5,
    max_range_m=300,
    source="550 kHz, 200 Hz, 0.3 mrad, 1.5 m: scanner library of HELIOS++ "
    "(github.com/3dgeo-heidelberg/helios, data/scanners_tls.xml); noise 5 mm and range assumed; "
    "mounting of 45/45 degrees assumed, as of the constructed models of Cahalane et al. 2014",
)

VQ_250 = ProfileScanner(
    name="RIEGL VQ-250 of the XP1",
    pulse_rate_hz=300_000,
    mirror_frequency_hz=100,
    heading_deg=45,
    tilt_deg=45,
    range_noise_m=0.005,
    source="Cahalane et al. 2014 (doi 10.3390/s140609471), sections 3.2.1 and 4.2.2: 300 kHz, one "
    "scanner, 100 Hz for targets 1 to 6; mounting of 45/45 degrees and noise 5 mm assumed; ranges "
    "and beam width not stated there",
)

LYNX_M1 = ProfileScanner(
    name="Optech Lynx M1, first head",
    pulse_rate_hz=500_000,
    mirror_frequency_hz=200,
    heading_deg=45,
    tilt_deg=45,
    range_noise_m=0.005,
    source="Cahalane et al. 2014 (doi 10.3390/s140609471), sections 3.2.2 and 4.2.2: two scanners, "
    "each up to 500 kHz and 200 Hz (125 kHz and 100 Hz for targets 7 to 11); mountings of +-45/45 "
    "degrees and noise 5 mm assumed; ranges and beam width not stated",
)

LYNX_M1_SECOND = replace(LYNX_M1, name="Optech Lynx M1, second head", heading_deg=-45)

ZF_9012_FITTED = replace(
    ZF_9012,
    name="Z+F Profiler 9012, fitted",
    mirror_frequency_hz=1e6 / 7000,
    tilt_deg=53.6,
    range_noise_m=0.0011,
    status="calibrated",
    source="mirror frequency, tilt and noise fitted to Table 2 of Pfeifer et al. 2021, which "
    "contradicts the 200 Hz stated there (study chart_tables)",
)

HDL_32E_FITTED = replace(
    HDL_32E,
    name="Velodyne HDL-32E, fitted",
    tilt_deg=38,
    range_noise_m=0.0101,
    status="calibrated",
    source="pitch and noise fitted to Table 2 of Pfeifer et al. 2021, which does not state the "
    "mounting (study chart_tables)",
)

PRESETS = {
    "zf-9012": ZF_9012,
    "zf-9012-fitted": ZF_9012_FITTED,
    "hdl-32e": HDL_32E,
    "hdl-32e-fitted": HDL_32E_FITTED,
    "roamer": ROAMER,
    "vq-250": VQ_250,
    "vq-450": VQ_450,
    "lynx-m1": LYNX_M1,
    "lynx-m1-second": LYNX_M1_SECOND,
}
"""Presets by the name that the command line knows."""


def table():
    """Return the presets as a DataFrame: preset, name, pulse rate, lines a second, status, source.

    Examples
    --------
    >>> table().query("preset == 'roamer'")["lines_per_s"].item()
    48.0
    """
    rows = []
    for preset, s in PRESETS.items():
        many = isinstance(s, MultiBeamScanner)
        lines = s.spin_hz * len(s.elevations_deg) if many else s.mirror_frequency_hz
        rows.append((preset, s.name, s.pulse_rate_hz, float(lines), s.status, s.source))
    columns = ["preset", "name", "pulse_rate_hz", "lines_per_s", "status", "source"]
    return pd.DataFrame(rows, columns=columns)
