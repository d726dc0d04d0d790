"""What f = d4/d1 measures: patterns of known anisotropy, other measures, and real clouds.

``sweeps`` computes, ``drawings`` draws.
"""

import numpy as np

from mmqa_lab.published import pfeifer2021
from mmqa_lab.run import Check
from mmqa_lab.simulate.point_patterns import aligned_lines_f, expected_f

QUICK = {
    "ratios": (1, 5, 20),
    "angles": (0, 30),
    "counts": (500,),
    "noises_mm": (0.5, 3),
    "seeds": (1000, 1001),
    "repeats": 6,
    "step": 15.0,
}


def checks(dataset, correlations, forms, lines, real):
    """Test what the notebook says.

    Parameters
    ----------
    dataset : Dataset
        Of :func:`mmqa_lab.studies.anisotropy.sweeps.compute`.
    correlations, forms, lines, real : DataFrame
        Of ``rank_correlations``, ``closed_forms``, and ``turns`` of simulated lines and of real
        clouds.
    """
    yield from _checks_on_f(dataset, forms, lines)
    yield from _checks_on_g(dataset, correlations)
    yield from _checks_on_real_clouds(real.groupby("cloud")["f"].agg(["min", "max"]))


def _checks_on_f(dataset, forms, lines):
    """What f is, and what it is not."""
    random = dataset["f"].sel(pattern="poisson")
    f0, f_random = pfeifer2021.F_THRESHOLD, expected_f("poisson", 1)
    passing = float((random <= f0).mean())
    inhomogeneous = dataset["f"].sel(pattern=["gradient", "holes"]).mean() / random.mean()
    noisy = lines.query("cloud == 'noise 0.5 mm'").set_index("angle_deg")["f"]
    largest = float(dataset["ratio"].max())
    turned = dataset["f_max"].sel(pattern="scan_lines", ratio=largest)
    return [
        Check(
            "f has its closed form on lattices, scan lines and random patterns.",
            bool((forms["z"].abs() < 3).all()),
            f"|z| up to {forms['z'].abs().max():.1f} in {len(forms)} cases",
            "three standard errors of the simulated mean",
        ),
        Check(
            f"A random pattern has f = {f_random:.2f} and fails f0 = {f0:g}.",
            passing == 0,
            f"{100 * passing:.0f} % of {random.size} patterns pass",
            "an order: f of the smallest selections spreads by less than f - f0",
        ),
        Check(
            "f does not see gradients and holes, though it is called inhomogeneity.",
            bool(abs(inhomogeneous - 1) < 0.15),
            f"f is {float(inhomogeneous):.2f} times that of homogeneous patterns",
            "15 %, what holes add by the points at their edges",
        ),
        Check(
            "f of noisy scan lines falls when the axes follow the lines, as the closed form says.",
            bool(noisy.loc[0] < 0.7 * noisy.max() and noisy.loc[0] < 1.5 * aligned_lines_f()),
            f"f = {noisy.loc[0]:.1f} along the lines, {noisy.max():.1f} off them",
            "jitter and noise raise the closed form's 5 by less than one half",
        ),
        Check(
            "Off the lines, f of scan lines grows with the ratio.",
            bool(turned.mean() > 0.75 * largest),
            f"f up to {float(turned.mean()):.1f} at ratio {largest:g}",
            "a quarter, for windows that hold few lines",
        ),
    ]


def _checks_on_g(dataset, correlations):
    """What the spacing ratio does better, and its limit."""
    by_name = correlations.set_index("name")["rank_correlation"]
    low, high = correlations.attrs["difference"]
    strong = dataset.sel(pattern="scan_lines", noise=dataset["noise"].min())
    strong = strong.sel(ratio=strong["ratio"] >= 2)
    off = np.abs((strong["direction"] - strong["angle"] + 90) % 180 - 90)
    crossed = dataset["g"].sel(pattern=["poisson", "gradient", "holes", "two_heads"])
    largest = dataset["g"].sel(ratio=dataset["ratio"].max())
    blind = largest.sel(pattern=["hard_core", "clusters"]).mean(["angle", "n", "noise", "seed"])
    lines = dataset["g"].sel(pattern="scan_lines").mean(["angle", "n", "seed"]).sel(ratio=5)
    clear, blurred = (float(lines.sel(noise=pick(lines["noise"]))) for pick in (min, max))
    change = strong["g"].mean("seed").max("angle") / strong["g"].mean("seed").min("angle")
    return [
        Check(
            "g orders the patterns by their true ratio better than f does.",
            bool(low > 0),
            f"rank correlation {by_name['g']:.2f} against {by_name['f']:.2f}, "
            f"difference {low:.2f} to {high:.2f}",
            "95 % interval of the difference, bootstrap over patterns",
        ),
        Check(
            "g of scan lines does not depend on the axes.",
            bool(change.max() < 1.25),
            f"largest over smallest mean of all angles: {float(change.max()):.2f}",
            "a quarter: means of few patterns with few lines each",
        ),
        Check(
            "g finds the direction of the lines.",
            bool(off.quantile(0.95) < 5),
            f"95 % within {float(off.quantile(0.95)):.1f} degrees",
            "directions are tried every 4 degrees",
        ),
        Check(
            "g stays near 1 where nothing has a direction, at every stretch.",
            bool(crossed.median() < 1.15),
            f"median {float(crossed.median()):.2f}",
            "chance makes 1 + 1.6 / sqrt(n), 1.09 at n = 300",
        ),
        Check(
            "Random patterns pass g <= 2.",
            bool(crossed.sel(pattern="poisson").max() < 2),
            f"g up to {float(crossed.sel(pattern='poisson').max()):.2f}",
            "an order, no tolerance",
        ),
        Check(
            "g hardly sees the anisotropy of hard cores and clusters.",
            bool(blind.max() < 2),
            f"g up to {float(blind.max()):.1f} at ratio {float(dataset['ratio'].max()):g}",
            "a tenth of the ratio",
        ),
        Check(
            "g falls when noise reaches the point spacing.",
            bool(blurred < 0.9 * clear),
            f"ratio 5: {clear:.1f} at {float(lines['noise'].min()):g} mm, "
            f"{blurred:.1f} at {float(lines['noise'].max()):g} mm",
            "a tenth",
        ),
    ]


def _checks_on_real_clouds(f):
    """What the road patch, and the boards where they are at hand, show."""
    heads = f.loc[["road, head A", "road, head B"]]
    both = f.loc["road, both heads"]
    found = [
        Check(
            "Two crossing scan heads together have a smaller f than each of them, for all axes.",
            bool(both["max"] < heads["min"].min()),
            f"both {both['min']:.1f} to {both['max']:.1f}, each {heads['min'].min():.1f} or more",
            "an order, no tolerance",
        )
    ]
    if "board, VLP-16" in f.index:
        vlp, rings = f.loc["board, VLP-16"], f.loc["board, 64 rings"]
        found.append(
            Check(
                "A board seen by 16 beams has f above 10, by 64 beams about 2.2.",
                bool(vlp["min"] > 10 and rings["min"] > 2 and rings["max"] < 2.4),
                f"{vlp['min']:.1f} to {vlp['max']:.1f}; {rings['min']:.2f} to {rings['max']:.2f}",
                "a tenth of 2.2",
            )
        )
    return found
