"""The scan pattern predicted, validated and measured: MIMIC and the scan lattice.

``validation`` repeats the paper's tables, ``surfaces`` predicts beyond them, ``measuring`` and
``real_scans`` measure, ``drawings`` draws.
"""

import numpy as np

from mmqa_lab.run import Check

QUICK = {
    "sizes": (1.0,),
    "seeds": range(3),
    "set_ups": 1000,
    "draws": 2000,
    "step_m": 1.0,
    "pivots_m": (-0.2, -0.1, 0.0, 1.0),
}


def checks(
    *,
    table_3,
    set_ups,
    best,
    printed,
    turning,
    counted,
    attitude,
    budget,
    heads,
    speed,
    measured,
    naive_mm,
    street,
    road,
):
    """Test what the notebook says.

    Parameters
    ----------
    table_3, set_ups, best, printed : DataFrame
        Of ``validation.table_3``, ``random_set_ups``, ``best_reading`` and
        ``printed_equation_10``.
    turning : float
        Degrees by which motion turns the profiles of Table 3's first wall at 4 m.
    counted, attitude, budget, heads : DataFrame
        Of ``surfaces.counted``, ``attitude``, ``error_budget`` and ``two_heads``.
    speed : float
        Largest speed for 3000 points per square metre at 5 m with 1 MHz and a tilt of 45 degrees,
        m/s.
    measured : DataFrame
        Of ``measuring.compute``.
    naive_mm : float
        By how much the mean distance of neighbours exceeds the point spacing.
    street : real_scans.Street or None
    road : real_scans.Road
    """
    yield from _checks_on_validation(table_3, set_ups, best, printed, turning)
    yield from _checks_on_surfaces(counted, attitude, budget, heads, speed)
    yield from _checks_on_measuring(measured, naive_mm, road)
    yield from _checks_on_street(street)


def _checks_on_validation(table_3, set_ups, best, printed, turning):
    """The paper's equations and tables."""
    worst = set_ups["largest_difference_m"].max()
    low, high = 100 * printed["error"].quantile([0.05, 0.95])
    impossible = best.loc[~best["possible"], "row"].tolist()
    rays = table_3["difference_m"].abs().max()
    return [
        Check(
            "All five rows of Table 3 are reproduced, as the spacing along the level line.",
            bool(table_3["agrees"].all() and rays < 1e-9),
            f"{table_3['agrees'].sum()} of 5 to the printed digits, rays agree to {rays:.1g} m",
            "three printed decimals; 1e-9 m of float64 at some ten metres",
        ),
        Check(
            "The lattice is that of ray casting for scanners of all mountings.",
            bool(worst < 1e-9),
            f"largest difference {worst:.1g} m in {set_ups['n'].iloc[0]} set-ups",
            "1e-9 m, rounding of float64",
        ),
        Check(
            "Equation 10 as printed is wrong by tens of per cent off the scanner's height.",
            bool(low < -10 and high > 10),
            f"5 to 95 %: {low:+.0f} to {high:+.0f} %",
            "an order: heights of up to 3 m above or below the scanner",
        ),
        Check(
            "Motion during a revolution turns profiles by 0.08 degrees at 4 m.",
            bool(abs(turning - 0.08) < 0.002),
            f"{turning:.4f} degrees",
            "0.002 degrees, the next term in d / R",
        ),
        Check(
            "No reading gives more than six of the nine rows of Table 4.",
            bool(best["agrees"].sum() <= 6),
            f"best {best['agrees'].sum()} of 9, with one fitted height",
            "a count",
        ),
        Check(
            "Rows 8 and 9 of Table 4 cannot come from 4 m.",
            impossible == [8, 9],
            f"below the least spacing: rows {impossible}",
            "half a unit of the last printed digit",
        ),
    ]


def _checks_on_surfaces(counted, attitude, budget, heads, speed):
    """Densities, attitude, errors, two heads and planning."""
    off = (counted["ratio"] - 1).abs().max()
    yaw = attitude.set_index("input").loc["heading_rate_deg_s", "horizontal_mm"]
    spread = budget[budget["source"] == "all"].pivot(
        index="quantity", columns="method", values="std"
    )
    quotient = (spread["monte_carlo"] / spread["first_order"]).dropna()
    draws = budget.loc[budget["method"] == "monte_carlo", "n"].iloc[0]
    allowed = 4 / np.sqrt(2 * draws) + 0.015
    blind = heads[heads["turn_deg"] <= -45]
    return [
        Check(
            "Counted points are those that the density predicts, on a wall and on a post.",
            bool(off < 0.01),
            f"off by {100 * off:.2f} % at most",
            "1 %, what whole profiles and the edges of the patch allow",
        ),
        Check(
            "A degree a second of yaw changes the spacing by 2.4 mm at 11.8 m.",
            bool(abs(abs(yaw) - 2.4) < 0.05),
            f"{abs(yaw):.2f} mm",
            "half a unit of the last digit",
        ),
        Check(
            "First order and Monte Carlo give the same uncertainty of spacings, angle, density.",
            bool(((quotient - 1).abs() < allowed).all()),
            f"quotients {quotient.min():.3f} to {quotient.max():.3f} from {draws} draws",
            f"{100 * allowed:.1f} %: four standard errors, and 1.5 % of second order",
        ),
        Check(
            "A head turned by +45 degrees sees no facade that is turned away by 45 or more.",
            bool((blind["density_first_per_m2"] == 0).all() and len(blind)),
            f"density 0 on all {len(blind)} of them",
            "none, it is the back",
        ),
        Check(
            "3000 points per square metre at 5 m allow 54 km/h, with 1 MHz and 45 degrees of tilt.",
            bool(abs(3.6 * speed - 54) < 0.1),
            f"{3.6 * speed:.2f} km/h",
            "a tenth, whole km/h are said",
        ),
    ]


def _checks_on_measuring(table, naive_mm, road):
    """Measured patterns."""
    rms = table.groupby(["quantity", "case"])["error"].agg(lambda e: np.sqrt((e**2).mean()))
    gap = 1000 * rms["profile_spacing_perpendicular_m"].max()
    angle = rms["profile_angle_deg"].max()
    z = table.dropna(subset="z").groupby(["quantity", "numbering"])["z"]
    covered, n = z.agg(lambda v: (v.abs() < 1.959964).mean()), int(z.count().min())
    slack = 2 * np.sqrt(0.95 * 0.05 / n)
    rates = road.heads["mirror_frequency_hz"]
    return [
        Check(
            "Profile spacing is measured to 0.2 mm and the profile angle to 0.1 degrees.",
            bool(gap < 0.2 and angle < 0.1),
            f"root mean square errors up to {gap:.3f} mm and {angle:.3f} degrees",
            "of the set-up that is measured worst",
        ),
        Check(
            "95 % intervals cover 90 to 98 % of the truths, though the speed drifts.",
            bool(covered.min() > 0.90 - slack and covered.max() < 0.98 + slack),
            f"{100 * covered.min():.0f} to {100 * covered.max():.0f} % of {n}",
            f"two standard errors of a share, {100 * slack:.1f} %, on top",
        ),
        Check(
            "The mean distance between neighbours is more than a millimetre too long.",
            bool(naive_mm > 1),
            f"{naive_mm:.2f} mm",
            "an order: 5 mm of range noise",
        ),
        Check(
            "On the road patch two heads at 198.6 Hz cross at 89 degrees.",
            bool((rates - 198.6).abs().max() < 0.05 and abs(road.crossing_deg - 89) < 0.5),
            f"{rates.min():.2f} and {rates.max():.2f} Hz, {road.crossing_deg:.2f} degrees",
            "half a unit of the last digits",
        ),
    ]


def _checks_on_street(street):
    """What the street says, where it is at hand."""
    if street is None:
        return []
    planes, patches = street.planes, street.patches
    advance = 1000 * planes.speed_m_s / planes.mirror_frequency_hz
    worst = patches["difference_mm"].abs().max()
    at_rest = (patches["measured_mm"] - patches["at_rest_mm"]).abs()
    return [
        Check(
            "The street's profiles follow at 199.4 Hz, 27.0 mm apart.",
            bool(abs(planes.mirror_frequency_hz - 199.4) < 0.15 and abs(advance - 27.0) < 0.05),
            f"{planes.mirror_frequency_hz:.2f} Hz, {advance:.2f} mm",
            "0.15 Hz: three revolutions and two cut ones; half a unit of the last digit",
        ),
        Check(
            "Six road patches are within 0.3 mm of the prediction from all other points.",
            bool(len(patches) == 6 and worst < 0.3),
            f"{worst:.2f} mm at most, {patches['difference_mm'].abs().mean():.2f} mm on average",
            "0.3 mm, a third of the error of measurements by hand",
        ),
        Check(
            "Taking the vehicle to be at rest in attitude makes the prediction worse.",
            bool(at_rest.mean() > 2 * patches["difference_mm"].abs().mean()),
            f"{at_rest.mean():.2f} mm on average",
            "twice",
        ),
    ]
