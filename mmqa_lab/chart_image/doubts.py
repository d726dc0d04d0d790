"""What speaks against the figures of a photograph of a chart."""

from dataclasses import replace

import numpy as np

from mmqa_lab._results import sentences
from mmqa_lab.chart_image.line_pairs import HIDDEN, MOVED, SMALLEST_PAIR_PX, is_crossed
from mmqa_lab.chart_image.maps import ChartMap
from mmqa_lab.chart_image.tones import Tones
from mmqa_lab.charts import Layout, Text

__all__ = ["doubts", "hidden_texts"]

CLEAR_CONTRAST = 0.2
"""Contrast of line pairs at their printed places that speaks for them, though not each gap does."""

SAID_BEND = 0.01
"""How far lines are bent over their length, from where on it is said."""

FEWEST_PIXELS, SMALLEST_SPREAD, LEGIBLE, LOST = 6, 0.02, 0.3, 0.12
"""Parts of a text, half as wide as its capitals are high, that count: pixels, and variance of the
print. Contrast of a text that is seen; a part with that share of it is hidden."""


def doubts(quality):
    """Return reasons to doubt pixel sizes and widths of an ImageQuality, sentences."""
    clipped, residual = quality.tones.clipped_share, quality.residual_px
    charts, pairs = quality.chart_map.charts, quality.pairs
    unseen = quality.sizes.loc[quality.sizes["pixel_mm"].isna(), "name"]
    hidden = pairs.loc[pairs["reason"] == HIDDEN, "name"].tolist()
    hidden += hidden_texts(quality.tones, quality.layout, quality.chart_map)
    moved = (pairs["reason"] == MOVED) & (pairs["width_px"] > 4)
    moved = pairs.loc[moved & (pairs["contrast"].abs() > 0.1), "name"]
    # blurred pairs are half white, half black in linear light; a display's curve adds 0.2
    around = (quality.layout[name] for name in pairs["name"])
    crossed = [is_crossed(quality.tones, one, quality.chart_map) for one in around]
    free = ~np.array(crossed, dtype=bool)
    blurred = pairs["contrast"].between(0.02, 0.7) & (pairs["reason"] != HIDDEN) & free
    tone = pairs.loc[blurred, "mean"].median()
    unread = [one for one in "hv" if np.isnan(quality.resolution(one).width_mm)]
    coarse = [(one, ", ".join(found)) for one in "hv" if len(found := _finer(quality, one)) > 1]
    bent = 0 if quality.chart_map.bend is None else quality.chart_map.bent_share(quality.layout)
    toned = f"blurred line pairs have a mean tone of {tone:.2f} for 0.50: is gamma right?"
    return sentences(
        (bent > SAID_BEND, f"straight lines are bent by {bent:.1%}, the map follows them"),
        (charts > 1, f"{charts} charts are seen, the largest is measured"),
        (clipped > 0.05, f"{clipped:.0%} of the plain pixels are clipped"),
        (residual > 1, f"bars end {residual:.1f} px from their places"),
        (len(unseen), f"an end is not seen where the map has it: {', '.join(unseen)}"),
        (len(hidden), f"hidden: {', '.join(hidden)}, by a thing, glare or a shadow's edge"),
        (len(moved), f"bars are not where they are printed: {', '.join(moved)}"),
        (abs(tone - 0.5) > 0.12 and not hidden, toned),  # what hides has a tone of its own
        *((True, f"{names} have contrast: w_{one} may be coarse") for one, names in coarse),
        *((True, f"no line pairs are resolved in direction {one}") for one in unread),
    )


def _finer(quality, direction):
    """Names of the line pairs finer than w with contrast at their printed places, or resolved."""
    pairs = quality.pairs[quality.pairs["direction"] == direction]
    finer = pairs["width_mm"] < np.nan_to_num(quality.resolution(direction).width_mm, nan=np.inf)
    wide = pairs["width_px"] >= SMALLEST_PAIR_PX
    clear = pairs["resolved"] | (pairs["contrast"] > CLEAR_CONTRAST)
    return pairs.loc[finer & wide & clear & (pairs["reason"] != HIDDEN), "name"].tolist()


def hidden_texts(tones: Tones, layout: Layout, chart_map: ChartMap) -> list[str]:
    """Return names of the texts of which a part does not look like the print, though the others do.

    None, where the tones come without the print.
    """
    names: list[str] = []
    if tones.printed is None:
        return names
    for text in (one for one in layout.of_kind(Text) if one.name.startswith("text_")):
        places, seen = tones.near(chart_map, text.corners())
        _, printed = replace(tones, values=tones.printed).near(chart_map, text.corners())
        part = np.maximum((places[:, 0] - text.x) / (text.cap / 2), 0).astype(int)
        n = np.maximum(np.bincount(part), 1)
        level, light, square, both = (
            np.bincount(part, values) / n for values in (printed, seen, printed**2, printed * seen)
        )
        spread = square - level**2
        clear = (n >= FEWEST_PIXELS) & (spread > SMALLEST_SPREAD)
        gain = ((both - level * light) / np.maximum(spread, 1e-9))[clear]
        typical = np.median(gain) if len(gain) else 0
        if typical > LEGIBLE and gain.min() < LOST * typical:
            names.append(text.name)
    return names
