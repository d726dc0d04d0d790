"""What the images show of Table 1, put to the test."""

from mmqa_lab.published import pfeifer2021_images as published
from mmqa_lab.run import Check


def checks(table, trials, fits, legibility, verdicts):
    """Test what the notebook says of Table 1.

    Parameters
    ----------
    table, trials, fits, legibility, verdicts : DataFrame
        Of :func:`compare`, :func:`one_spread`, :func:`fit_systems`, :func:`legibility` and
        :func:`scenarios`.
    """
    yield from _pixel_checks(table)
    yield from _width_checks(table, trials, fits)
    yield from _verdict_checks(legibility, verdicts)


def _pixel_checks(table):
    """Of pixel sizes."""
    sizes = table[table["quantity"] == "pixel_mm"]
    wide = sizes.pivot_table(
        index=["system", "distance_m", "direction"], columns="model", values="value"
    )
    measured = (wide["photograph"] / wide["specification"] - 1).abs().max()
    predicted = sizes[sizes["kind"] == "predicted"].set_index("system")["difference_percent"]
    near, far = predicted[["B", "C"]].abs().max(), predicted["A"].max()
    return [
        Check(
            "The pixel size measured in a photograph is that of the panorama.",
            bool(measured < 0.01),
            f"largest difference {100 * measured:.2f} %",
            "the lying bar is half a metre below the camera: 0.5 % farther away at 5 m",
        ),
        Check(
            "For B and C, megapixels predict the published pixel sizes.",
            bool(near < 10),
            f"largest difference {near:.1f} %",
            "1.3 mm is printed to 4 %, and the distance of the closest image is not",
        ),
        Check(
            "For A, megapixels promise finer pixels than were published.",
            bool(far < -10),
            f"by {-predicted['A'].max():.0f} to {-predicted['A'].min():.0f} %",
            "more than rounding and distance explain for B and C",
        ),
    ]


def _width_checks(table, trials, fits):
    """Of line pairs."""
    ratio = published.ratio_check().iloc[-1]
    cells = int(trials["cells"].iloc[0])
    photographed = table[table["model"].str.endswith("photographed")]
    largest = photographed["steps"].abs().max()
    exact, best = int(fits["exact"].sum()), int(trials["exact"].max())
    return [
        Check(
            "No single number of pixels per line pair satisfies all published widths.",
            bool(ratio["satisfies"] < ratio["cells"]),
            f"the best, {ratio['ratio']:.2f}: {ratio['satisfies']} of {ratio['cells']}",
            f"an inequality per cell, of the cells at hand ({published.W_CELLS_PRINTED} printed)",
        ),
        Check(
            "One point spread for all systems explains every published width within one step.",
            bool(trials["within_one_step"].max() == cells),
            f"{trials['within_one_step'].max()} of {cells}, {best} exactly",
            "one step is what readers differed by (section 4.2); one parameter is fitted",
        ),
        Check(
            "A point spread and a motion blur for each system explain more widths exactly.",
            exact > best,
            f"{exact} against {best} of {cells}",
            "six parameters on these cells: a description, no reproduction",
        ),
        Check(
            "Read in photographs, both fits stay within one step of the published widths.",
            bool(largest <= 1),
            f"largest difference {largest:.0f} in {len(photographed)} cells",
            "one step is what readers differed by (section 4.2)",
        ),
    ]


def _verdict_checks(legibility, verdicts):
    """Of legibility and of the tender."""
    fit = legibility.attrs["index"]
    qualified = verdicts[verdicts["verdict"] == "qualifies"].groupby("scenario")["system"].agg(list)
    second = verdicts[verdicts["scenario"] == 2].set_index("system")["one_step_coarser"]
    return [
        Check(
            "Thresholds of the quality index give all rows but one the jury's mark.",
            fit.agree == fit.n - 1,
            f"{fit.agree} of {fit.n}",
            "A and C at 5 m have the same widths but not the same mark: no threshold parts them",
        ),
        Check(
            "No system qualifies in the first scenario, B and C do in the second.",
            1 not in qualified and qualified.get(2) == ["B", "C"],
            "; ".join(
                f"scenario {number}: {' and '.join(qualified.get(number, ['none']))}"
                for number in published.SCENARIOS
            ),
            "counted; the second scenario's criteria are a reading of the paper",
        ),
        Check(
            "C qualifies without any margin: one step coarser and it fails; B does not.",
            second["C"] == "fails" and second["B"] == "qualifies",
            f"B {second['B']}, C {second['C']}",
            "one step is what readers differed by (section 4.2)",
        ),
    ]
