"""Point patterns of known density, anisotropy and direction."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from mmqa_lab.simulate import point_patterns
from mmqa_lab.simulate.point_patterns import KINDS, expected_f, point_pattern
from mmqa_lab.spacing import quadrant_distances

DENSITY = 2500.0


def interior_f(kind, seed, *, angle, noise=0.0, ratio=6.0, size=1.2):
    """f of the points that are no closer than 0.2 m to the window's edge."""
    xy = point_pattern(
        kind, density=DENSITY, size=size, seed=seed, ratio=ratio, angle=angle, noise=noise, jitter=0
    )
    inside = (np.abs(xy - size / 2) < size / 2 - 0.2).all(axis=1)
    medians = np.median(quadrant_distances(xy)[inside], axis=0)
    return medians[3] / medians[0]


@pytest.mark.parametrize("kind", KINDS)
def test_density_is_what_was_asked_for(kind):
    counts = [
        len(point_pattern(kind, density=DENSITY, size=1, seed=s, ratio=3, angle=20))
        for s in range(30)
    ]
    error = np.std(counts, ddof=1) / np.sqrt(len(counts))
    # four standard errors, and one point for windows that hold the same number each time
    assert abs(np.mean(counts) - DENSITY) < 4 * error + 1


@pytest.mark.parametrize("kind", ["lattice", "scan_lines", "hexagonal", "poisson"])
def test_f_has_its_closed_form(kind):
    seen = [interior_f(kind, seed, angle=25) for seed in range(12)]
    error = np.std(seen, ddof=1) / np.sqrt(len(seen))
    assert abs(np.mean(seen) - expected_f(kind, 6)) < 3 * error + 1e-9


def test_lines_along_an_axis_have_f_5_at_any_spacing():
    """Noise of a hundredth of the point spacing moves d1, the smaller of two, by about 1 %."""
    step = 1 / np.sqrt(DENSITY * 12)
    for ratio in (12, 20):
        seen = [interior_f("scan_lines", s, angle=0, ratio=ratio, noise=step / 100) for s in (1, 2)]
        assert seen == pytest.approx([point_patterns.aligned_lines_f()] * 2, rel=0.02)
        assert interior_f("scan_lines", 1, angle=20, ratio=ratio, noise=step / 100) > 0.95 * ratio


def test_the_law_behind_f_5_by_drawing():
    rng = np.random.default_rng(4)
    point, neighbours = rng.random((20_000, 1, 1)), rng.random((20_000, 2, 60))
    above = neighbours > point
    last = np.argmax(above != above[..., :1], axis=2) + 1  # the first on the other side
    assert np.median(last.max(axis=1)) == point_patterns.aligned_lines_f()


def test_stretching_a_random_pattern_is_a_random_pattern():
    """Counts in cells long across and long along have the variance of their mean: Poisson."""
    xy = point_pattern("poisson", density=DENSITY, size=2, seed=5, ratio=20, angle=0)
    for bins in ((5, 80), (80, 5)):
        counts = np.histogram2d(*xy.T, bins=bins, range=[[0, 2], [0, 2]])[0]
        ratio = counts.var(ddof=1) / counts.mean()
        assert abs(ratio - 1) < 4 * np.sqrt(2 / (counts.size - 1))


def test_gradient_grows_along():
    x = point_pattern("gradient", density=40_000, size=1, seed=5)[:, 0]
    slope = np.polyfit(np.arange(10), np.histogram(x, bins=10, range=(0, 1))[0], 1)[0]
    across = 2 * point_patterns.SLOPE * np.sqrt(0.5) * 0.1  # a tenth of the window's width
    assert slope / 4000 == pytest.approx(across, rel=0.1)


def test_holes_are_as_large_as_said():
    spots = np.random.default_rng(2).uniform(0.1, 2.9, (4000, 2))
    empty = {}
    for kind in ("poisson", "holes"):
        patterns = [point_pattern(kind, density=DENSITY, size=3, seed=s) for s in range(8)]
        empty[kind] = np.mean([cKDTree(xy).query(spots)[0] > 0.05 for xy in patterns])
    # spots within 30 mm of a hole's centre are 50 mm or more from its edge; few others are empty
    inner = 1 - (1 - point_patterns.HOLE_SHARE) ** ((0.03 / 0.08) ** 2)
    assert empty["poisson"] < 1e-6
    assert inner < empty["holes"] < point_patterns.HOLE_SHARE / 2


@settings(max_examples=40, deadline=None)
@given(
    kind=st.sampled_from(KINDS),
    ratio=st.floats(1, 20),
    angle=st.floats(-180, 180),
    noise=st.floats(0, 0.005),
    seed=st.integers(0, 2**32),
)
def test_any_pattern_lies_in_its_window_and_repeats(kind, ratio, angle, noise, seed):
    choices = {"density": 900, "size": 0.4, "ratio": ratio, "angle": angle, "noise": noise}
    xy = point_pattern(kind, seed=seed, **choices)
    assert xy.shape[1] == 2
    assert ((xy >= 0) & (xy <= 0.4)).all()
    assert np.array_equal(xy, point_pattern(kind, seed=seed, **choices))
    rounded = point_pattern(kind, seed=seed, rounding=0.01, **choices)
    assert np.abs(rounded - xy).max(initial=0) <= 0.005 + 1e-12
