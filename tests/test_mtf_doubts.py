"""What speaks against an edge or a star: each is said beyond its bound and not below."""

from types import SimpleNamespace

import numpy as np
import pytest

from mmqa_lab.mtf import doubts
from mmqa_lab.mtf.transfer import spread_edge

MEASURES = {"clipped": False, "bend": 0.0, "second_step": 0.0, "overshoot": 0.0}
MEASURES |= {"one_sided": 0.0, "strangeness": 0.0}
FIT = {"rounding": 1e-9, "rounded_alike": False, "ringing": 0.0, "hot": 0}


@pytest.mark.parametrize(
    ("known", "bound", "words"),
    [
        ("bend", 0.12, "not straight by 12% of its width: MTF50 is too low"),
        ("second_step", 0.03, "a second edge of 3% of the step"),
        ("overshoot", 0.006, "sharpened"),
        ("one_sided", 0.025, "the profile is not alike on both sides, as beside a second edge"),
        ("strangeness", 0.02, "no sigmoid of this shape fits"),
        ("ringing", 0.012, "noise of 1.2% beside the edge alone, as of compression: MTF50 may be"
                           " off by 5%"),
        ("rounding", 0.01, "100 grey values in the step and no noise: MTF50 may be a tenth too"
                           " high"),
    ],
)  # fmt: skip
def test_remarks_on_an_edge_are_said_beyond_their_bounds(known, bound, words, monkeypatch):
    for value, said in ((0.999 * bound, ()), (1.001 * bound, (words,))):
        for name, usual in MEASURES.items():
            found = value if name == known else usual
            monkeypatch.setattr(doubts, name, lambda *_, found=found: found)
        given = FIT | {known: value} if known in FIT else FIT
        fit = SimpleNamespace(**given | {"rounded_alike": known == "rounding"})
        assert doubts.remarks_on(fit, 0.3, 0.003, 5.0, True) == said


def test_remarks_on_an_edge_of_its_direction_its_interval_and_its_sides(monkeypatch):
    for name, usual in MEASURES.items():
        monkeypatch.setattr(doubts, name, lambda *_, usual=usual: usual)
    fit = SimpleNamespace(**FIT)
    assert doubts.remarks_on(fit, 0.3, 0.003, 3.01, False) == ()
    assert doubts.remarks_on(fit, np.nan, np.nan, 5.0, False) == ("MTF stays above 0.5",)
    (said,) = doubts.remarks_on(fit, 0.3, 0.003, 2.99, False)
    assert said == "edge within 3 degrees of the pixel grid"
    # half an interval of 95 % beyond 3 % of MTF50
    limit = 0.03 * 0.3 / 1.95996398
    assert doubts.remarks_on(fit, 0.3, 0.999 * limit, 5.0, False) == ()
    (said,) = doubts.remarks_on(fit, 0.3, 2 * limit, 5.0, False)
    assert said == "MTF50 may be off by 6%, as its interval says"
    ringing = SimpleNamespace(**FIT | {"ringing": 0.1, "hot": 3})  # which says it already
    found = doubts.remarks_on(ringing, 0.3, 2 * limit, 5.0, False)
    assert [one.split()[0] for one in found] == ["noise", "3"]
    assert found[1] == "3 odd pixels left out"
    monkeypatch.setattr(doubts, "strangeness", lambda _: 1.0)
    assert doubts.remarks_on(fit, 0.3, 0.003, 5.0, False) == ()  # of bins, not of a sigmoid
    monkeypatch.setattr(doubts, "one_sided", lambda _: 1.0)
    for side, word in ((1, "white"), (-1, "black")):
        monkeypatch.setattr(doubts, "clipped", lambda _, sign, side=side: sign == side)
        found = doubts.remarks_on(ringing, 0.3, 0.003, 5.0, False)
        assert found == (f"{word} is clipped: MTF50 is too high", "3 odd pixels left out")
    monkeypatch.setattr(doubts, "clipped", lambda *_: False)
    monkeypatch.setattr(doubts, "second_step", lambda _, side: 0.2 * (side > 0))
    found = doubts.remarks_on(ringing, 0.3, 0.003, 5.0, False)
    assert found == ("a second edge of 20% of the step", "3 odd pixels left out")
    monkeypatch.setattr(doubts, "second_step", lambda _, side: 0.2 * (side < 0))
    assert doubts.remarks_on(fit, 0.3, 0.003, 5.0, False)[0].startswith("a second edge")


@pytest.mark.parametrize(
    ("known", "words"),
    [
        ({"length": 0.999 * 64 * 0.01}, "a step of 200 at a noise of 20"),
        ({"bend": 0.501}, "it leaves a straight line by 50% of its width"),
        ({"strangeness": 0.251}, "the profile leaves a single step by 25% of it"),
        ({"strangeness": 0.251, "overshoot": 0.007}, ""),  # as sharpening does
        ({"bend": 0.499, "strangeness": 0.249, "length": 1.001 * 64 * 0.01}, ""),
    ],
)
def test_check_refuses_what_is_no_edge_no_straight_one_or_several(known, words, monkeypatch):
    for name in ("bend", "strangeness", "overshoot"):
        monkeypatch.setattr(doubts, name, lambda _, name=name: known.get(name, 0.0))
    fit = SimpleNamespace(step=200.0, grain=0.1, length=known.get("length", 9.0))
    if not words:
        assert doubts.check(fit) is None
    else:
        with pytest.raises(ValueError, match=words):
            doubts.check(fit)


STAR = {"clipped": "", "harmonics": (0.0, 0.3), "transfers": (0.5, 0.3), "beyond": 0.0}
STAR |= {"tail": 0.0, "alike": (0.0, 900)}


@pytest.mark.parametrize(
    ("known", "below", "above", "words"),
    [
        ("beyond", 0.0249, 0.0251, "sharpened: no lens transfers so much"),
        ("tail", -0.299, -0.301, "sharpened: no lens transfers so much"),
        ("tail", 0.0, 0.04, "4% of the light are in the tails of the lens: MTF50 may be off by 8%"),
        ("alike", (-0.119, 900), (-0.121, 900), "sharpened: no lens transfers so much"),
        ("alike", (-0.049, 10_000), (-0.051, 10_000), "sharpened: no lens transfers so much"),
        ("harmonics", (0.0299, 0.3), (0.0301, 0.3),
         "dark and bright sectors are unlike: MTF50 is too low"),
        ("harmonics", (0.0, 0.0601), (0.0, 0.0599),
         "sectors have no plain middle, as of a sinusoidal star: MTF50 is too low"),
        ("clipped", "", "white", "white is clipped: MTF50 is too high"),
    ],
)  # fmt: skip
def test_remarks_on_a_star_are_said_beyond_their_bounds(known, below, above, words):
    waves = np.full(12, 0.3 + 0.1j)
    assert doubts.remarks_on_star(waves, **STAR | {known: below}) == ()
    assert doubts.remarks_on_star(waves, **STAR | {known: above}) == (words,)


def test_remarks_on_a_star_of_its_parts():
    plain = np.full(12, 0.5j)
    faint = np.where(np.arange(12) == 5, 0.701, 1) * plain
    assert doubts.remarks_on_star(faint, **STAR) == ()
    (said,) = doubts.remarks_on_star(faint * np.where(np.arange(12) == 5, 0.99, 1), **STAR)
    assert said == "a part of the star is hidden: contrast 69% of the others'"
    for lag, said in ((0.0199, 0), (0.0201, 1)):
        bent = plain * np.exp(1j * lag * np.cos(2 * np.pi * np.arange(12) / 12 + 0.3))
        assert doubts._lag(bent) == pytest.approx(lag, rel=1e-3)
        found = doubts.remarks_on_star(bent, **STAR)
        assert (
            found == ("sectors are bent, as by a lens: MTF50 may be off by some per cent",) * said
        )
    assert doubts._lag(bent[:11]) == 0
    cut = {"clipped": "black", "harmonics": (0.2, 0.3)}  # which makes them unlike
    assert doubts.remarks_on_star(plain, **STAR | cut) == ("black is clipped: MTF50 is too high",)
    blurred = {"transfers": (0.5, 0.149), "harmonics": (0.0, 0.0)}
    assert doubts.remarks_on_star(plain, **STAR | blurred) == ()


def test_check_cycles_counts_the_turns_of_a_phase():
    turn = np.arange(12)
    for extra in (-3, -1, 2):
        waves = 0.4 * np.exp(2j * np.pi * extra * turn / 12)
        with pytest.raises(
            ValueError, match=f"Invalid star of 36 cycles: it shows about {36 + extra}"
        ):
            doubts.check_cycles(waves, 36)
    for drift in (1.49, 1.51):
        waves = np.exp(1j * drift * np.linspace(0, 1, 12) ** 8)
        if drift < 1.5:
            assert doubts.check_cycles(waves, 36) is None
            continue
        with pytest.raises(ValueError, match="its wave is not regular"):
            doubts.check_cycles(waves, 36)
    hidden = np.where(turn == 4, 0.49j, np.ones(12))  # less than half as strong: not looked at
    assert doubts.check_cycles(hidden, 36) is None
    with pytest.raises(ValueError, match="not regular"):
        doubts.check_cycles(np.where(turn == 4, 0.51j * 1j, np.ones(12)), 36)


def test_clipped_side_shares_one_value_while_the_other_has_noise(rng):
    dark, bright = 0.2 + 0.01 * rng.standard_normal(500), 0.8 + 0.01 * rng.standard_normal(500)
    assert doubts.clipped_side(dark, bright) == ""
    floor, ceiling = np.maximum(dark, 0.2), np.minimum(bright, 0.8)  # of half of the pixels
    assert doubts.clipped_side(floor, bright) == "black"
    assert doubts.clipped_side(dark, ceiling) == "white"
    tenth = np.sort(dark)
    for count, name in ((49, ""), (50, "black")):
        side = np.where(np.arange(500) < count, tenth[count], tenth)
        assert doubts.clipped_side(side, bright) == name
    # all at the end: the other side's noise beyond 4 of its own and a two-thousandth of the step
    still = np.full(500, 0.2)
    step = 0.6
    for std, name in ((0.00049 * step, ""), (0.00052 * step, "black")):
        other = 0.8 + std * (bright - bright.mean()) / bright.std()
        assert doubts.clipped_side(still, other) == name
    # noise of the side itself, beyond a 400th of the step
    for std, name in ((0.0024, ""), (0.0026, "black")):
        side = np.where(np.arange(500) % 2, 0.2, 0.2 + 2 * std * step)
        assert doubts.clipped_side(side, 0.8 + 1e-9 * bright) == name
        assert doubts.clipped_side(side, 0.8 + 1e-9 * bright, 2 * std * step) == ""
    for ratio, name in ((3.9, ""), (4.1, "black")):
        side = np.where(np.arange(500) % 2, 0.2, 0.2 + 2 * 0.001 * step)
        other = 0.8 + ratio * 0.001 * step * (bright - bright.mean()) / bright.std()
        assert doubts.clipped_side(side, other) == name


def profiled(grey, across, **known):
    """An edge as clipped looks at it."""
    fit = {"distance": across, "grey": grey, "spread": 0.75, "rounding": 0.0}
    return SimpleNamespace(**fit | known)


def test_clipped_pixels_share_a_value_and_are_noisy_or_one_sided(rng, monkeypatch):
    across = rng.uniform(-20, 20, 4000)
    plain = spread_edge(across, 0.7, 0.1) + 0.05 * rng.standard_normal(4000)
    one = [0.0]
    monkeypatch.setattr(doubts, "one_sided", lambda _: one[0])
    for sign, cut in ((1, np.minimum(plain, 1.02)), (-1, np.maximum(plain, -0.02))):
        assert doubts.clipped(profiled(cut, across), sign)
        assert not doubts.clipped(profiled(cut, across), -sign)
    assert not doubts.clipped(profiled(np.zeros(4000), across), 1)
    far, one[0] = np.flatnonzero(across > 4 * 0.75 + 1), 1.0
    for count, found in ((0.099, False), (0.101, True)):
        grey = np.where(across > 0, 0.9, 0.0) + 0.01 * rng.random(4000)
        grey[far[: int(count * len(far))]] = 1.0
        assert doubts.clipped(profiled(grey, across), 1) == found
    # all at the wall but one pixel: no noise, so that the halves of the profile must differ
    grey = np.where(across > 0, 1.0, 0.0)
    grey[far[0]] = 0.999
    for value, rounding, found in (
        (0.0049, 0, 0),
        (0.0051, 0, 1),
        (0.0059, 0.002, 0),
        (0.0061, 0.002, 1),
    ):
        one[0] = value
        assert doubts.clipped(profiled(grey, across, rounding=rounding), 1) == found
    one[0] = 0.0
    half = np.arange(len(far)) % 2 == 0  # noise beside the wall, beyond a 400th and one grey value
    for below, found in ((0.0049, False), (0.0051, True)):
        grey[far] = np.where(half, 1.0, 1 - below)
        grey[far[1]] = 1 - 1e-4
        assert doubts.clipped(profiled(grey, across), 1) == found


def test_shares_are_between_the_medians_of_both_sides(rng):
    across = rng.uniform(-9, 9, 3000)
    values = np.where(across < 0, 5.0, 25.0) + rng.choice([-0.4, 0, 0.1], 3000)
    values[np.abs(across) < 4 * 0.75 + 1] = 11.0
    bins = np.array([-3.0, 0, 2]), np.array([5.0, 10, 26]), np.array([9, 16, 40]), None
    fit = SimpleNamespace(distance=across, values=values, bins=bins, spread=0.75, grain=0.2)
    places, share, noise = doubts._shares(fit)
    assert places.tolist() == [-3, 0, 2]
    assert share == pytest.approx([0, 0.25, 1.05])
    assert noise == pytest.approx(0.2 / 4)
    fit.distance = across / 10  # nothing is far: the levels are 0 and 1
    assert doubts._shares(fit)[1] == pytest.approx([5, 10, 26])


def test_strangeness_is_the_largest_mean_of_a_bin_beyond_four_of_its_errors():
    distance = np.repeat([-1.0, 0.0, 0.5], [4, 9, 16])
    residuals = np.repeat([0.02, -0.06, 0.05], [4, 9, 16])
    fit = SimpleNamespace(distance=distance, residuals=residuals, grain=0.03)
    assert doubts.strangeness(fit) == pytest.approx(max(0.02 - 0.06, 0.06 - 0.04, 0.05 - 0.03))
