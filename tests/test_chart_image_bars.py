"""A chart by its bars, in images of several sizes; alignment on finer and finer cells."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from mmqa_lab import charts
from mmqa_lab.chart_image import ChartMap, alignment, finding

CHART = charts.imaging_chart()


def flat(size, x=100.0, y=200.0):
    """The chart straight on, so many pixels wide, its lower left corner at a place."""
    return ChartMap(np.array([[size / 1000, 0, x], [0, -size / 1000, y], [0, 0, 1]]))


def test_by_bars_goes_through_sizes_and_counts_charts_that_lie_apart(monkeypatch):
    asked, answers = [], {}

    def guesses(small, layout, bars):
        asked.append((small.shape, [bar.name for bar in bars]))
        return answers.get(small.shape, [])

    monkeypatch.setattr(finding, "_guesses", guesses)
    grey = np.zeros((900, 1200), np.uint8)
    assert finding.by_bars(grey, CHART, 1.0) is None
    # the image, a third, twice as large; a ninth would be 100 px
    assert [shape for shape, _ in asked] == [(900, 1200), (300, 400), (1800, 2400)]
    assert asked[0][1] == ["bar_left", "bar_right", "bar_horizontal"]
    asked.clear()
    answers[900, 1200] = [(0.79, flat(300))]
    finding.by_bars(grey, CHART, 1.0)
    assert len(asked) == 3
    asked.clear()
    answers[900, 1200] = [(0.81, flat(300))]
    found = finding.by_bars(grey, CHART, 1.0)
    assert len(asked) == 1  # it needs no other guess
    assert found.charts == 1
    answers.clear()
    middle = ChartMap(flat(100, 40, 150).matrix)
    answers[300, 400] = [(0.9, middle)]
    found = finding.by_bars(grey, CHART, 1.0)
    # a pixel of the small image is three of the large one
    places = CHART.corners()
    assert found.pixels(places) == pytest.approx(3 * middle.pixels(places) + 1)
    answers[900, 1200] = [(0.9, flat(300)), (0.7, flat(290, 180)), (0.8, flat(350, 700, 700)),
                          (0.6, flat(330, 240))]  # fmt: skip
    found = finding.by_bars(grey, CHART, 1.0)
    # the second lies half of its side or less from the first, the last one hardly does
    assert found.charts == 2
    assert found.pixels(places) == pytest.approx(flat(350, 700, 700).pixels(places))
    large = np.zeros((2100, 2000), np.uint8)
    asked.clear()
    answers.clear()
    finding.by_bars(large, CHART, 0.5)
    assert [shape for shape, _ in asked] == [(1050, 1000), (350, 333), (117, 111)]


def test_the_six_likeliest_guesses_are_confirmed(monkeypatch):
    some = [SimpleNamespace(number=k) for k in range(9)]
    scores = [0.5, 0.31, 0.9, 0.29, 0.6, 0.7, 0.8, 0.45, 0.2]
    monkeypatch.setattr(finding, "_streaks", lambda _: None)
    monkeypatch.setattr(finding, "_suggested", lambda *_: None)
    monkeypatch.setattr(finding, "_glanced", lambda *_: zip(scores, some, strict=True))
    tried = []

    def confirmed(_, __, guess):
        tried.append(guess.number)
        return (guess.number, guess) if guess.number != 2 else None

    monkeypatch.setattr(finding, "confirmed", confirmed)
    found = finding._guesses(None, CHART, None)
    assert tried == [2, 6, 5, 4, 0, 7]
    assert [number for number, _ in found] == [6, 5, 4, 0, 7]
    scores[7], scores[0] = 0.1, 0.301
    tried.clear()
    finding._guesses(None, CHART, None)
    assert tried == [2, 6, 5, 4, 1, 0]
    scores[0], scores[1] = 0.299, 0.25
    tried.clear()
    finding._guesses(None, CHART, None)
    assert tried == [2, 6, 5, 4]


def test_found_looks_at_the_small_image_first_and_at_bars_there_alone(monkeypatch):
    asked = []
    results = {"targets": {}, "bars": None}

    def decoded(grey, markers, times):
        asked.append(("targets", times))
        return [times]

    def by_targets(grey, layout, found, markers, known):
        return results["targets"].get(found[0])

    def by_bars(grey, layout, times):
        asked.append(("bars", times))
        return results["bars"]

    monkeypatch.setattr(finding, "decoded", decoded)
    monkeypatch.setattr(finding, "_by_targets", by_targets)
    monkeypatch.setattr(finding, "by_bars", by_bars)
    monkeypatch.setattr(finding, "_shrunk", lambda _: 0.5)
    known = {"camera": None, "offset": (0.0, 0.0)}
    assert finding._found(None, CHART, known) == (None, 1)
    assert asked == [("targets", 0.5), ("bars", 0.5), ("targets", 1)]
    asked.clear()
    results["targets"] = {0.5: "the chart"}
    assert finding._found(None, CHART, known)[0] == "the chart"
    assert asked == [("targets", 0.5)]
    results["targets"], results["bars"] = {}, flat(300)
    found, _ = finding._found(None, CHART, known)
    assert found.source == finding.LONG_BARS
    assert found.pixels([[0, 0]]) == pytest.approx(np.array([[100, 200]]), abs=1e-3)
    monkeypatch.setattr(finding, "_shrunk", lambda _: 1)
    results["bars"] = None
    asked.clear()
    assert finding._found(None, CHART, known)[0] is None
    assert asked == [("targets", 1), ("bars", 1)]


LEVELS = {2.5: (30, 60, 160, 400), 1.0: (30, 60, 160, 800), 20.0: (30, 50, 50), 190.0: (5, 12)}


@pytest.mark.parametrize(("pixel_mm", "levels"), LEVELS.items())
def test_alignment_goes_from_coarse_cells_to_those_of_the_pixels(pixel_mm, levels, monkeypatch):
    asked, aligned, bent, toned = [], [], [], []
    most = 1.0

    class Level:
        def __init__(self, image, layout, chart_map, along):
            asked.append(along)
            self.along, self.sigma = along, None

        def behind(self, sigma):
            self.sigma = sigma
            return self

        def correlation(self, _):
            return most - np.log(self.sigma / 2.3) ** 2

        def as_seen(self, _):
            toned.append(self.sigma)
            return self

        def aligned(self, chart_map):
            aligned.append((self.along, self.sigma))
            return chart_map, 0.5

    monkeypatch.setattr(alignment, "Level", Level)
    monkeypatch.setattr(alignment, "with_bend", lambda level, one: bent.append(level.along) or one)
    view = flat(1000 / pixel_mm)
    found, correlation = alignment._aligned(None, CHART, view, bent=True)
    assert asked == [*levels]
    first = [one for one in levels[:-1] if one > 30]
    assert aligned[:-1] == [*((one, None) for one in first), (levels[-1], None)]
    # of 1.2, 2.0 and 3.2 the middle one is said, and the top of the parabola is used
    assert aligned[-1] == (levels[-1], pytest.approx(2.3))
    assert toned == [pytest.approx(2.3)]
    assert bent == [*levels]
    assert (found.blur_px, correlation) == (2.0, pytest.approx(1))
    bent.clear()
    toned.clear()
    most = 0.81  # of it .02 is lost at 2.0: too little, something stands before the chart
    alignment._aligned(None, CHART, view, bent=False)
    assert bent == toned == []
    assert aligned[-1] == (levels[-1], 2.0)


@pytest.mark.parametrize(
    ("best", "said", "used"),
    [(0.3, 0.6, 0.6), (0.8, 0.6, 0.6), (1.0, 1.2, 1.0), (2.7, 3.2, 2.7), (9.0, 3.2, 3.2)],
)
def test_a_point_spread_is_the_top_of_a_parabola_and_none_beyond_those_tried(best, said, used):
    tried = []
    level = SimpleNamespace(
        behind=lambda sigma: tried.append(sigma) or level,
        correlation=lambda _: -(np.log(tried[-1] / best) ** 2),
    )
    assert alignment._point_spread(level, None) == (said, pytest.approx(used))
    assert tried == [0.6, 1.2, 2.0, 3.2]
    level.correlation = lambda _: tried[-1]  # no top
    assert alignment._point_spread(level, None)[0] == 3.2


@pytest.mark.parametrize(("shift", "turn"), [((2.0, -1.5), 0.0), ((0.0, 0.0), 0.004)])
def test_an_aligned_level_moves_the_map_back_to_the_print(shift, turn):
    tones = charts.reflectance(CHART, cell=2.5)[::-1]
    image = np.pad(np.float32(30 + 200 * cv2.blur(tones, (2, 2))), 40, constant_values=120)
    truth = ChartMap(np.array([[0.4, 0, 40.0], [0, -0.4, 440.0], [0, 0, 1]]))
    c, s = np.cos(turn), np.sin(turn)
    change = np.array([[c, -s, shift[0] + 500 * (1 - c) + 500 * s],
                       [s, c, shift[1] + 500 * (1 - c) - 500 * s], [0, 0, 1]])  # fmt: skip
    wrong = replace(truth, matrix=truth.matrix @ change)
    level = alignment.Level(image, CHART, wrong, 160)
    before = level.correlation(wrong)
    found, correlation = level.aligned(wrong)
    off = found.pixels(CHART.corners()) - truth.pixels(CHART.corners())
    assert np.abs(off).max() < 0.35
    assert correlation > max(before, 0.9)
    assert level.correlation(found) == pytest.approx(correlation, abs=0.02)
    nothing = alignment.Level(np.float32(0 * image), CHART, wrong, 60)
    same, correlation = nothing.aligned(wrong)
    assert same.matrix == pytest.approx(wrong.matrix)
    assert abs(correlation) < 0.05
