"""The line-segment Hausdorff distance and the weight W of its angle.

``sweeps`` varies the settings, ``heldout`` reports what is reached on fresh scenes and repeats the
paper's tables, ``clouds`` goes from simulated clouds to the distance, ``real`` looks at real ones,
``drawings`` draws.
"""

from mmqa_lab.run import Check

QUICK = {
    "weights": (0, 1, 10, 100),
    "sensitivities": (0.1, 0.5, 2.0),
    "displacements": (3.0,),
    "angle_noises": (0.4, 1.5),
    "jambs": (0.2, 2.0),
    "matchers": ("all", "displaced"),
    "seeds": range(2),
    "held_out": range(30000, 30002),
    "density": 10.0,
    "chain_seeds": (),
}

FEWEST_SCENES = 100
"""Targets are put to the test from this number of held-out scenes on."""


def checks(*, check, sweep, settings, displaced, angles, pairing, targets, boards, sweeps):
    """Test what the notebook says.

    Parameters
    ----------
    check : DataFrame
        Of ``published.poreba2013.check``.
    sweep, settings, displaced : Dataset
        Of ``sweeps.compute``: over W, over W and sensitivity, over displacement and matcher.
    angles : DataFrame
        Of ``sweeps.best_weights``.
    pairing, targets : DataFrame
        Of ``heldout.one_to_one`` and ``heldout.targets``.
    boards, sweeps : DataFrame or None
        Of ``real.board_sizes`` and ``real.sweep_pair``; None where the data are not at hand.

    Yields
    ------
    Check
    """
    yield from _checks_on_tables(check)
    yield from _checks_on_weight(sweep, settings, angles)
    yield from _checks_on_distance(displaced, pairing)
    yield from _checks_on_targets(targets)
    yield from _checks_on_real(boards, sweeps)


def _checks_on_tables(check):
    wrong = check[~check["agrees"]]
    named = (wrong["comparison"] + " " + wrong["direction"]).tolist()
    gain = (check["detection_rate_percent"] - check["null_rate_percent"]).mean()
    return [
        Check(
            "13 of the 14 published detection rates follow from the printed counts; C3-TLS from "
            "model to test does not.",
            len(check) == 14 and named == ["C3-TLS model-test"],
            f"{int(check['agrees'].sum())} of {len(check)}; not: {', '.join(named)}",
            "half a unit of the last printed digit",
        ),
        Check(
            "Pairing nothing at all would score within 1.2 points of the published rates.",
            0 < gain < 1.2,
            f"{gain:.2f} points",
            "arithmetic on the printed counts",
        ),
    ]


def _checks_on_weight(sweep, settings, angles):
    f1 = sweep["f1"].mean(["seed", "kind"]).squeeze(drop=True)
    rate = 100 * sweep["detection_rate"].mean(["seed", "kind"]).squeeze(drop=True)
    behind = float(f1.max() - f1.sel(weight=10))
    lost = float(f1.max() - f1.sel(weight=100))
    moved = float(rate.max() - rate.min())
    both = settings["f1"].mean(["seed", "kind"]).squeeze(drop=True)
    by_weight = both.sel(sensitivity=0.5)
    by_sensitivity = both.sel(weight=10)
    spans = [float(one.max() - one.min()) for one in (by_sensitivity, by_weight)]
    quiet, loud = angles.iloc[0], angles.iloc[-1]
    drop = loud["f1_best"] - loud["f1_at_10"]
    return [
        Check(
            "W = 10 lies on the plateau: its F1 is within 0.03 of the best W.",
            behind <= 0.03,
            f"{behind:.3f} behind; W = 100 is {lost:.3f} behind",
            "three standard errors of a mean over 30 scenes",
        ),
        Check(
            "The detection rate moves by less than half a point from W = 0 to 100.",
            moved < 0.5,
            f"{moved:.2f} points, while F1 moves by {float(f1.max() - f1.min()):.3f}",
            "nearly all cells are true negatives",
        ),
        Check(
            "The sensitivity of the peak decides more than W.",
            spans[0] > spans[1],
            f"F1 spans {spans[0]:.3f} over the sensitivity, {spans[1]:.3f} over W",
            "the sweep covers factors of 20 or more of either",
        ),
        Check(
            "With noisy directions W = 10 is too much.",
            drop > quiet["f1_best"] - quiet["f1_at_10"] and drop > 0.03,
            f"at {loud['angle_noise_deg']:g} degrees W = 10 is {drop:.3f} behind the best",
            "three standard errors of a mean over 30 scenes",
        ),
    ]


def _checks_on_distance(displaced, pairing):
    far = displaced.sel(kind="absolute", displacement=3.0).squeeze(drop=True)
    bias = (far["lhd_m"] - far["true_m"]).mean("seed").sel(matcher="all").item()
    across = (far["perpendicular_m"] - far["true_perpendicular_m"]).mean("seed")
    across = across.sel(matcher="displaced").item()
    mean = pairing.groupby(["segmentation", "matcher"])[["f1", "fp"]].mean()
    split, whole = mean.loc["as simulated"], mean.loc["whole edges"]
    fewer = 1 - split.loc["hungarian", "fp"] / split.loc["all", "fp"]
    gain = whole.loc["hungarian", "f1"] - split.loc["hungarian", "f1"]
    return [
        Check(
            "Displaced by 3 m, the published method reads at least 0.2 m too little.",
            bias < -0.2,
            f"{bias:+.2f} m",
            "false neighbours within 3 m replace the true partners",
        ),
        Check(
            "The displaced matcher's perpendicular distance is right to 3 cm at 3 m.",
            abs(across) < 0.03,
            f"{across:+.3f} m",
            "the target of 1 cm needs more scenes than a small run has",
        ),
        Check(
            "One-to-one pairing removes a third of the false pairs at least; splitting and cutting "
            "of edges costs it more than 0.03 of F1.",
            fewer > 1 / 3 and gain > 0.03,
            f"{fewer:.0%} fewer; whole edges {gain:+.3f}",
            "three standard errors of a mean over 30 scenes",
        ),
    ]


def _checks_on_targets(targets):
    rows = targets.set_index("quantity")
    better = rows.loc[["F1, absolute", "F1, repeatability"]]
    gains = better["displaced"] - better["literal"]
    found = [
        Check(
            "On held-out scenes the displaced matcher beats the published method.",
            bool((gains > 0).all()),
            f"F1 {gains.iloc[0]:+.3f} absolute, {gains.iloc[1]:+.3f} repeatability",
            "the sign alone; the interval stands in the table",
        )
    ]
    for quantity, row in rows.iterrows():
        if row["n"] >= FEWEST_SCENES:
            found.append(
                Check(
                    f"Held-out target not missed beyond chance: {quantity} {row['target']}.",
                    not row["missed"],
                    f"{row['displaced']:.3f} ({row['low']:.3f} to {row['high']:.3f})"
                    f"{'' if row['reached'] else ', itself short of it'}",
                    f"95 % interval of {row['n']} scenes on which nothing was chosen",
                )
            )
    return found


def _checks_on_real(boards, sweeps):
    found = []
    if boards is not None:
        errors = boards[["long_error_mm", "short_error_mm"]].median()
        found.append(
            Check(
                "Board outlines are right to 2 cm.",
                bool((errors.abs() < 20).all()),
                f"median {errors.iloc[0]:+.1f} and {errors.iloc[1]:+.1f} mm",
                "half the beam's footprint, about 1 cm at 3 m",
            )
        )
    if sweeps is not None:
        row = sweeps.query("frame == 'pose applied' and matcher == 'displaced'").iloc[0]
        left = (row["east_m"] ** 2 + row["north_m"] ** 2 + row["up_m"] ** 2) ** 0.5
        found.append(
            Check(
                "The known pose leaves two real sweeps displaced by less than 6 cm.",
                left < 0.06,
                f"{100 * left:.1f} cm with a standard deviation of {100 * row['sigma_m']:.1f} cm",
                "two standard deviations and the pose's own centimetre",
            )
        )
    return found
