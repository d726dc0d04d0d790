"""Stated 95 % intervals contain the truth: few draws here, in full with MMQA_LONG=1."""

import os
from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest
from covered import ESTIMATES, Z, shares, simulated
from scipy.stats import binom, chi2

LONG = bool(os.environ.get("MMQA_LONG"))

KNOWN = {}
"""Least coverage of figures that the README's table shows below 90 % in a case."""

WIDE = {
    "board": ("density", "g"),  # the figure of a lattice hardly differs from draw to draw
}
"""Figures whose intervals are known to be wider than they must."""


@cache
def drawn(name):
    """The rows of an estimate, for all tests."""
    estimate = next(one for one in ESTIMATES if one.name == name)
    return simulated(estimate, estimate.many if LONG else estimate.few)


@pytest.mark.parametrize(
    "estimate", [one for one in ESTIMATES if one.few or LONG], ids=lambda one: one.name
)
def test_intervals_contain_the_truth(estimate):
    """As often as 90 % would but for one chance in ten thousand of the draws taken."""
    table = shares(estimate, drawn(estimate.name))
    for row in table.itertuples():
        least = KNOWN.get((estimate.name, row.figure), 0.9)
        assert row.coverage * row.draws >= binom.ppf(1e-4, row.draws, least), row


def too_wide(rows, draws):
    """Figures whose errors are smaller than intervals of 99 % would be for, and by how much.

    But for one chance in ten thousand of so many draws; an ellipsoid has three directions.
    """
    found = {}
    for figure, part in rows.groupby("figure"):
        half, middle = (part["high"] - part["low"]) / 2, (part["high"] + part["low"]) / 2
        off = ((part["truth"] - middle) / half * Z) ** 2
        if figure == "vector":
            off = part["truth"] / part["high"] * chi2.ppf(0.95, 3) / 3
        if off.mean() < chi2.ppf(1e-4, draws) / draws * (Z / 2.576) ** 2:
            found[figure] = round(float(np.sqrt(off.mean())), 2)
    return found


GROUPS = sorted({one.name.split(",")[0] for one in ESTIMATES if one.few or LONG})


@pytest.mark.parametrize("group", GROUPS)
def test_intervals_are_no_wider_than_they_must(group):
    """The kinds of boards, of displacements and of mountings count together."""
    among = [one for one in ESTIMATES if one.name.split(",")[0] == group and (one.few or LONG)]
    draws = sum((one.many if LONG else one.few) * len(one.cases) for one in among)
    found = too_wide(pd.concat([drawn(one.name) for one in among]), draws)
    assert not set(found) - set(WIDE.get(group, ())), found


@pytest.mark.parametrize("name", ["trend over distance", "line distance"])
def test_an_interval_that_is_twice_too_wide_is_seen(name):
    estimate = next(one for one in ESTIMATES if one.name == name)
    rows, draws = drawn(estimate.name), estimate.few * len(estimate.cases)
    half = (rows["high"] - rows["low"]) / 2
    assert too_wide(rows.assign(low=rows["low"] - half, high=rows["high"] + half), draws)


def test_coverage_of_an_interval_that_is_too_narrow_is_seen():
    """Half the reach of a rate's interval contains the truth in 67 %, which the bound refuses."""
    estimate = next(one for one in ESTIMATES if one.name == "sensor calibration")

    def narrow(seed, **case):
        found = estimate.draw(seed, **case)
        return {
            name: ((3 * low + high) / 4, (low + 3 * high) / 4, truth)
            for name, (low, high, truth) in found.items()
        }

    table = shares(estimate, simulated(replace(estimate, draw=narrow), 60))
    assert (table["coverage"] * table["draws"] < binom.ppf(1e-4, table["draws"], 0.9)).all()
