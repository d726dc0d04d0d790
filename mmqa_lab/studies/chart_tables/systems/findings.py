"""What the comparison with Table 2 shows, and what it leaves open."""

import pandas as pd

from mmqa_lab.published import pfeifer2021
from mmqa_lab.run import Check
from mmqa_lab.studies.chart_tables.systems.model import SENSORS, pulses_per_revolution


def unexplained(comparison, parameters, capped):
    """Return what no parameter explains, with the numbers at hand.

    Parameters
    ----------
    comparison, parameters, capped : DataFrame
        Of :func:`compare`, :func:`fit` and :func:`cap`.

    Returns
    -------
    DataFrame
        ``system``, ``what``, ``numbers``.
    """
    stated = capped.set_index("mirror_frequency_hz").loc[200.0]
    pulses = SENSORS["A"].pulse_rate_hz / _value(parameters, "A", "mirror_frequency_hz")
    missing = comparison.loc[comparison["system"] == "C", "published"].isna().sum()
    rows = [
        (
            "A",
            "The stated 1 MHz and 200 Hz cannot give the printed density and d4 together",
            f"d4 = 47 mm comes with {stated['density_hull_per_m2']:.0f} points/m2, 4629 is printed",
        ),
        (
            "A",
            "The printed f at 5 m needs a d1 that contradicts the d1 at 10 m",
            f"{pulses:.0f} pulses a revolution: f = "
            f"{_cell(comparison, 'A', 5, 'f', 'fitted_released'):.1f}, 11.8 is printed",
        ),
        (
            "B",
            "The fitted d1 stays below the printed one",
            ", ".join(
                f"{_cell(comparison, 'B', d, 'd1_mm', 'fitted'):.1f} mm at {d} m, "
                f"{_cell(comparison, 'B', d, 'd1_mm', 'published'):.0f} is printed"
                for d in (5, 10)
            ),
        ),
        (
            "B",
            "The data-sheet's range noise of 20 mm is about twice what the chart shows",
            f"sigma_MAD {_cell(comparison, 'B', 5, 'precision_mm', 'fitted'):.1f} mm, about 9.2 mm "
            "is reported",
        ),
        (
            "C",
            "Neither images nor matching are described: density, precision and spacing are free",
            f"{missing} of 10 cells are not at hand either",
        ),
    ]
    return pd.DataFrame(rows, columns=["system", "what", "numbers"])


def checks(comparison, parameters, capped, bias):
    """Test what the notebook says of the three systems.

    Parameters
    ----------
    comparison, parameters, capped, bias : DataFrame
        Of :func:`compare`, :func:`fit`, :func:`cap` at the printed d4, and :func:`hull_bias`.
    """
    stated = capped.set_index("mirror_frequency_hz").loc[200.0]
    least, most = pulses_per_revolution(pfeifer2021.table_2())
    misfit = parameters.groupby(["system", "fit"])["misfit"].first()
    pulses = SENSORS["A"].pulse_rate_hz / _value(parameters, "A", "mirror_frequency_hz")
    tilt = _value(parameters, "B", "tilt_deg")
    upright = comparison.query("system == 'B' and quantity == 'density_per_m2'")
    excess = 100 * (upright["predicted"] / upright["published"] - 1)
    parallel, oblique = (
        bias.loc[which, "bias_percent"].mean()
        for which in (bias["turn_deg"] == 0, bias["turn_deg"] >= 20)
    )
    random = _cell(comparison, "C", 5, "f", "predicted")
    yield from [
        Check(
            "At 1 MHz and 200 Hz, A's printed d4 goes with 3300 to 3600 points/m2, not with 4629.",
            3300 <= stated["density_polygon_per_m2"] <= stated["density_hull_per_m2"] <= 3600,
            f"{stated['density_polygon_per_m2']:.0f} (polygon), "
            f"{stated['density_hull_per_m2']:.0f} (hull)",
            "1 / (d1 d4) with d1 = 5 m x 2 pi / 5000 is 3387; the hull adds up to 6 % on few lines",
        ),
        Check(
            "A's printed d1 ask for about 7000 pulses a revolution, which is 135 to 143 Hz.",
            6900 < least < most < 7500,
            f"{least:.0f} to {most:.0f}",
            "half a millimetre to either side of the printed values",
        ),
        Check(
            "Giving up the stated 200 Hz, A's rows fit with about 7000 pulses a revolution.",
            misfit["A", "released"] < misfit["A", "open"] / 3 and 6500 < pulses < 7700,
            f"{pulses:.0f} pulses, misfit {misfit['A', 'open']:.1f} -> "
            f"{misfit['A', 'released']:.1f} tolerances",
            "a search by chance ends within 5 % of the best frequency",
        ),
        Check(
            "With its axis upright, B's density is predicted 35 % or more too high.",
            (excess > 35).all(),
            " and ".join(f"{value:.0f} %" for value in excess),
            "density by count repeats to 1 %; heights from 0 to 2 m change it by 5 %",
        ),
        Check(
            "B's rows ask for an axis pitched by about 40 degrees.",
            30 <= tilt <= 48,
            f"{tilt:.0f} degrees",
            "the two rows pull apart: from 33 to 45 degrees the misfit hardly changes",
        ),
        Check(
            "The hull's density is too high by 5 % or more where lines run along the crop, and by "
            "less than 3 % where they do not.",
            parallel > 5 and oblique < 3,
            f"{parallel:.1f} % and {oblique:.1f} %",
            "about one line spacing is lost of 0.71 m: 56 mm are 8 %",
        ),
        Check(
            "A random pattern has f = 3.26: C's printed d1 and d4 do not contradict one.",
            abs(random - 3.257) < 0.15 and 7.5 / 3.5 < random < 8.5 / 2.5,
            f"{random:.2f}",
            "14,000 points give f to 2 %; the printed digits allow 2.1 to 3.4",
        ),
    ]


def _cell(comparison, system, distance, quantity, column):
    """One value of a comparison."""
    which = (comparison["system"] == system) & (comparison["distance_m"] == distance)
    return float(comparison.loc[which & (comparison["quantity"] == quantity), column].item())


def _value(parameters, system, name):
    """One fitted parameter, of the fit that releases most."""
    which = (parameters["system"] == system) & (parameters["parameter"] == name)
    return float(parameters.loc[which, "value"].iloc[-1])
