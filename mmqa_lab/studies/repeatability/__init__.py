"""How far density, sigma_MAD and f vary when the same chart is selected again.

``surfaces`` are what is selected from, ``selections`` computes, ``drawings`` draws.
"""

import numpy as np

from mmqa_lab.run import Check
from mmqa_lab.studies.repeatability.selections import LEVEL

QUICK = {
    "scans": 2,
    "repeats": 10,
    "law_repeats": 8,
    "law_clouds": 3,
    "areas_m2": (0.1, 0.3, 0.9),
    "densities": (500, 1000, 2000),
    "clicks_m": (0.005, 0.01, 0.02),
}


def checks(*, limits, answers, rounded, exponents, laws, strays, components):
    """Test what the notebook says; the arguments are tables of ``selections``."""
    yield from _checks_on_the_remark(answers)
    yield _check_on_axes(limits)
    yield _check_on_rounding(rounded)
    yield from _checks_on_the_law(exponents, laws)
    yield from _checks_on_dispersion(strays, laws)
    yield _check_on_components(components)


def _checks_on_the_remark(answers):
    """The paper's sentence about B at 10 m, under the stated click error."""
    shares = answers[answers["distance_m"] == 10].set_index(["published", "system"])["holds_share"]
    systems = {name: shares.xs(name, level="system") for name in ("B", "B tilted", "B" + LEVEL)}
    systems["B tilted" + LEVEL] = shares.xs("B tilted" + LEVEL, level="system")
    of_b = 100 * np.array([share.sort_index() for share in systems.values()])
    density, medians, precision = of_b.T  # in the order of the alphabet
    regular = 100 * shares["medians show no variation", "A" + LEVEL]
    return [
        Check(
            "Five selections of B at 10 m: precision ranges below 1 mm.",
            bool(precision.min() > 90),
            f"in {precision.min():.0f} % of the groups of five or more",
            "nine of ten groups",
        ),
        Check(
            "Five selections of B at 10 m: the density does not reliably vary below 1 %.",
            bool(density.max() < 90),
            f"in {density.min():.0f} % (upright) and {density.max():.0f} % (tilted) of the groups",
            "reliably: nine of ten groups; the paper states no click error",
        ),
        Check(
            "Five selections of B at 10 m: the medians of its irregular spacings do vary.",
            bool(medians.max() < 65),
            f"all stay within 0.5 mm in {medians[:2].max():.0f} % of the groups with principal "
            f"axes, {medians[2:].max():.0f} % with level ones",
            "half of the groups, and 15 % for the few groups of a small run",
        ),
        Check(
            "The medians of regular scan lines (A) with level axes show no variation.",
            bool(regular > 90),
            f"all stay within 0.5 mm in {regular:.0f} % of the groups",
            "half of the last printed digit, in nine of ten groups",
        ),
    ]


def _check_on_axes(limits):
    """Principal axes against level ones."""
    table = limits[(limits["distance_m"] == 10) & (limits["figure"] == "f")]
    spread = table.set_index("system")["relative_s_r_percent"]
    turning, fixed = (spread[["B" + name, "B tilted" + name]] for name in ("", LEVEL))
    return Check(
        "f of B repeats far better with level axes than with principal ones.",
        bool((turning.to_numpy() > 2 * fixed.to_numpy()).all()),
        f"s_r at 10 m: {turning.iloc[0]:.0f} % against {fixed.iloc[0]:.1f} % upright, "
        f"{turning.iloc[1]:.1f} % against {fixed.iloc[1]:.1f} % tilted",
        "a factor of two",
    )


def _check_on_rounding(rounded):
    """Medians of rounded coordinates."""
    table = rounded[rounded["figure"] == "d2_mm"].set_index("rounding_mm")
    fine, coarse = table.loc[0], table.loc[5]
    return Check(
        "Rounding to 5 mm holds the median d2 of B at 5 m still, at a distance on the grid.",
        bool(coarse["s_r"] < fine["s_r"] / 3 and abs(coarse["mean"] - 5 * 8**0.5) < 0.05),
        f"d2 = {fine['mean']:.3f} mm, s_r = {fine['s_r']:.4f} mm; rounded "
        f"{coarse['mean']:.3f} mm, s_r = {coarse['s_r']:.4f} mm",
        "a third of the spread; the tilt of the plane takes less than 0.05 mm from 5 sqrt(8) mm",
    )


def _checks_on_the_law(exponents, laws):
    """The strip law: its size, its exponents, and the turning axes."""
    known = laws[laws["figure"] == "density_polygon_per_m2"]
    ratio = np.exp(np.log(known["relative_s_r"] / known["predicted"]).mean())
    table = exponents.set_index(["varied", "axes", "figure"])
    area = table.loc[("area", "horizontal", "density_polygon_per_m2")]
    fixed, turning = (table.loc[("area", axes, "d4_mm")] for axes in ("horizontal", "principal"))
    return [
        Check(
            "The spread of the density of a random pattern has the size of the strip law.",
            bool(0.85 < ratio < 1.15),
            f"measured over predicted, mean of {len(known)}: {ratio:.2f}",
            "15 %: s_r of a dozen selections is known to a fifth, in ten places or more",
        ),
        Check(
            "The spread of the density falls with the area to the power of -3/4.",
            bool(abs(area["exponent"] - area["predicted"]) < max(3 * area["standard_error"], 0.15)),
            f"fitted {area['exponent']:.2f} with standard error {area['standard_error']:.2f}",
            "three standard errors of the fit, or 0.15",
        ),
        Check(
            "The spread of d4 falls more slowly with principal axes: they turn with the outline.",
            bool(turning["exponent"] > fixed["exponent"]),
            f"exponent {turning['exponent']:.2f} against {fixed['exponent']:.2f}",
            "an order, no tolerance",
        ),
    ]


def _checks_on_dispersion(strays, laws):
    """std against sigma_MAD, with strays and without."""
    means = strays.groupby("share").mean()
    clean, worst = means.iloc[0], means.iloc[-1]
    off = (means["sigma_mad_mm"] / means["sigma_mad_predicted_mm"] - 1).abs().max()
    spread = laws.groupby("figure")["relative_s_r"].mean()
    price = spread["sigma_mad_mm"] / spread["std_mm"]
    return [
        Check(
            "Strays multiply std and hardly touch sigma_MAD, as the closed form says.",
            bool(
                worst["std_mm"] > 3 * clean["std_mm"]
                and worst["sigma_mad_mm"] < 1.3 * clean["sigma_mad_mm"]
                and off < 0.15
            ),
            f"at {100 * means.index[-1]:.0f} %: std x {worst['std_mm'] / clean['std_mm']:.1f}, "
            f"sigma_MAD x {worst['sigma_mad_mm'] / clean['sigma_mad_mm']:.2f}, "
            f"{100 * off:.0f} % off the closed form",
            "15 %: strays also tilt the plane, which the closed form leaves out",
        ),
        Check(
            "Without strays sigma_MAD repeats about half as well as std.",
            bool(1.4 < price < 2.8),
            f"s_r of sigma_MAD over s_r of std: {price:.1f}",
            "1.65 asymptotically, more where few points change; 15 % for the few selections",
        ),
    ]


def _check_on_components(components):
    """Selections against systems and distances."""
    shares = components[components["factor"] == "selection"].set_index("figure")["share"]
    return Check(
        "Systems and distances differ far more than selections do, in every figure.",
        bool((shares < 0.1).all()),
        f"selections hold {100 * shares.max():.1f} % of the variance at most ({shares.idxmax()})",
        "a tenth of the variance of the logarithm",
    )
