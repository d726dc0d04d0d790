"""Cahalane et al. 2014: the tables that validate MIMIC, and checks of what they say.

Sensors 14(6), 9471-9488, doi:10.3390/s140609471. Cells that were not at hand when this module was
written are NaN; ``attrs["missing"]`` says which. Nothing is filled in by calculation.
"""

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_positive

SOURCE = "Cahalane et al. 2014, {}, doi:10.3390/s140609471"

SPEED_M_S = 10.0
"""Speed of the simulated vehicle (section 4.1)."""

SCANNER_DEG = (45.0, 45.0)
"""Horizontal and vertical rotation of the simulated scanner (section 4.1)."""

PULSE_RATE_HZ = 300_000.0
MIRROR_FREQUENCY_HZ = 100.0
"""Not stated with Tables 3 and 4; 100 Hz is what 0.100 m at 10 m/s in row 2 of Table 3 needs."""

RANGE_M = 4.0
"""Distance of the targets of Table 4, said to vary slightly."""


def table_3():
    """Return Table 3: profile spacing on five simulated targets.

    Returns
    -------
    DataFrame
        ``row``, ``alpha_targ_deg``, ``beta_targ_deg``, ``profile_spacing_m`` as printed, ``kind`` =
        published; ``attrs["source"]``.

    Notes
    -----
    The spacing is that along the target's horizontal line: rows 2 and 5 print d = v / Mf for walls
    that are tilted, whose other spacings differ.

    Examples
    --------
    >>> table_3()["profile_spacing_m"].tolist()
    [0.082, 0.1, 0.082, 0.141, 0.1]
    """
    rows = [(15, 0, 0.082), (0, 15, 0.100), (15, 15, 0.082), (-15, 0, 0.141), (0, -15, 0.100)]
    return _targets(rows, "profile_spacing_m", "Table 3")


def table_4():
    """Return Table 4: point spacing on nine simulated targets, not reproducible.

    Returns
    -------
    DataFrame
        ``row``, ``alpha_targ_deg``, ``beta_targ_deg``, ``point_spacing_mm`` as printed, ``kind`` =
        published; ``attrs["source"]``.

    Notes
    -----
    Rows 8 and 9 cannot come from the stated 4 m (:func:`smallest_spacing`), and no single
    convention gives all rows. To be shown, never to be tested against.

    Examples
    --------
    >>> table_4().query("row == 8")[["beta_targ_deg", "point_spacing_mm"]].to_numpy().tolist()
    [[-30, 6]]
    """
    rows = [(15, 0, 13), (0, 15, 20), (15, 15, 16), (30, 0, 10), (0, 30, 28), (30, 30, 21)]
    rows += [(-30, 0, 34), (0, -30, 6), (-30, -30, 6)]
    return _targets(rows, "point_spacing_mm", "Table 4")


def smallest_spacing(
    table=None,
    *,
    range_m=RANGE_M,
    pulse_rate_hz=PULSE_RATE_HZ,
    mirror_frequency_hz=MIRROR_FREQUENCY_HZ,
):
    """Return the spacing that no point of a target can fall below, beside what Table 4 prints.

    Two pulses theta_A apart strike a plane p away (measured square to it) at least 2 p
    tan(theta_A / 2) apart, wherever they strike it and however scanner and target are turned. A
    plane ``range_m`` away, measured level and square to its trace, and tilted by beta_targ, has
    p = range_m cos(beta_targ). If instead the spot that is struck is ``range_m`` away across
    the track (Hr of equation 8), the pulse is that long or longer, and spacing at least
    range_m sin(theta_A).

    Parameters
    ----------
    table : DataFrame, optional
        ``table_4()``.
    range_m, pulse_rate_hz, mirror_frequency_hz : float

    Returns
    -------
    DataFrame
        The table with ``distance_square_m``, ``smallest_mm`` and ``smallest_at_spot_mm`` (the two
        bounds), ``possible`` (whether the printed value, half a millimetre up, reaches either) and
        ``largest_range_m``, from which it can come at most by the lower bound.

    Raises
    ------
    ValueError
        If range or pulse rate is not above zero.

    Examples
    --------
    >>> proof = smallest_spacing()
    >>> proof.loc[~proof["possible"], "row"].tolist()
    [8, 9]
    """
    table = table_4() if table is None else table
    range_m = check_positive(range_m, "range_m", unit="m")
    step = 2 * np.pi * mirror_frequency_hz / check_positive(pulse_rate_hz, "pulse_rate_hz")
    square = range_m * np.cos(np.radians(table["beta_targ_deg"]))
    smallest = 2000 * square * np.tan(step / 2)
    at_spot = 1000 * range_m * np.sin(step)
    rounded_up = table["point_spacing_mm"] + 0.5
    return table.assign(
        distance_square_m=square,
        smallest_mm=smallest,
        smallest_at_spot_mm=at_spot,
        possible=rounded_up >= np.minimum(smallest, at_spot),
        largest_range_m=range_m * rounded_up / np.minimum(smallest, at_spot),
    )


def table_5():
    """Return what is at hand of Table 5: prediction against manual measurement in real clouds.

    Returns
    -------
    DataFrame
        ``statistic``, ``value_mm``, ``kind`` = published; ``attrs["source"]``,
        ``attrs["missing"]``.

    Examples
    --------
    >>> table_5().set_index("statistic")["value_mm"].tolist()
    [1.0, 2.0]
    """
    rows = [("mean difference of profile spacing", 1.0), ("largest difference", 2.0)]
    table = pd.DataFrame(rows, columns=["statistic", "value_mm"]).assign(kind="published")
    table.attrs["source"] = SOURCE.format("Table 5")
    table.attrs["missing"] = "the single rows were not at hand, only the summary of the text"
    return table


def table_6():
    """Return Table 6: the change of each input that changes a profile spacing by 2 mm or so.

    Returns
    -------
    DataFrame
        A row per spacing: ``quantity``; ``alpha_scan_deg``, ``gamma_scan_deg``, ``alpha_targ_deg``,
        ``beta_targ_deg``, ``mirror_frequency_hz``, ``speed_m_s``, NaN where the table says "n/a" or
        the cell was not at hand (``attrs["missing"]``); ``d_m`` = v / Mf from the ratio of the last
        two; ``kind`` = published; ``attrs["source"]``.

    Notes
    -----
    The set-up behind the two rows is not stated and is not the same: the last two columns alone
    give d = 0.050 m for the one and 0.087 m for the other.

    Examples
    --------
    >>> table_6()["d_m"].round(4).tolist()
    [0.05, 0.0867]
    """
    nan = np.nan
    rows = [
        ("profile_spacing_horizontal_m", 1.5, nan, nan, nan, 4.0, 0.2),
        ("profile_spacing_vertical_m", 1.0, 0.5, nan, 1.0, 1.5, 0.13),
    ]
    names = ["quantity", "alpha_scan_deg", "gamma_scan_deg", "alpha_targ_deg", "beta_targ_deg"]
    table = pd.DataFrame(rows, columns=[*names, "mirror_frequency_hz", "speed_m_s"])
    table["d_m"] = table["speed_m_s"] / table["mirror_frequency_hz"]
    table["kind"] = "published"
    table.attrs["source"] = SOURCE.format("Table 6")
    table.attrs["missing"] = "alpha_targ of the first row; the other empty cells say n/a"
    return table


def _targets(rows, value, name):
    """Rows of target rotations and a printed value, numbered from 1."""
    table = pd.DataFrame(rows, columns=["alpha_targ_deg", "beta_targ_deg", value])
    table.insert(0, "row", np.arange(1, len(table) + 1))
    table["kind"] = "published"
    table.attrs["source"] = SOURCE.format(name)
    return table
