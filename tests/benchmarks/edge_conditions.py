"""Edges of many conditions by an independent camera: errors, coverage, what is said.

``PYTHONPATH=tests:tests/benchmarks python tests/benchmarks/edge_conditions.py`` writes its section
of RESULTS.md; ``--draws`` makes it smaller.
"""

import argparse
import re

import cv2
import numpy as np
import pandas as pd
from rendered import slanted_edge
from results import write_section
from scipy.ndimage import gaussian_filter
from scipy.optimize import brentq
from scipy.special import roots_genlaguerre

from mmqa_lab.charts import decode, encode
from mmqa_lab.mtf import fit_edge

SFRMAT5 = {"noise 2 %": 1.6, "noise 3 %": 2.4, "noise 5 %": 3.1, "light 15 % across": 3.8}
"""Root mean square error of sfrmat5 (percent), as examined on scenes of these conditions."""


def edge(rng, *, sigma=(0.5, 1.2), degrees=(3.5, 12.0), noise=0.01, low=0.12, high=0.75, **how):
    """An edge by quadrature, turned and mirrored at random, and its true MTF50.

    ``tail``: share and width (px) of a spread that falls by e in each width, a sum of Gaussians.
    """
    width, angle = rng.uniform(*sigma), np.radians(rng.uniform(*degrees))
    share, reach = how.get("tail", (0.0, 1.0))
    parts, weights = roots_genlaguerre(8, 0.5) if share else (np.zeros(1), np.ones(1))
    sizes = np.append(reach * np.sqrt(2 * parts), width)
    weights = np.append(share * weights / weights.sum(), 1 - share)
    offset, shape = rng.uniform(-2, 2), how.get("shape", (80, 80))
    image = sum(
        weight * slanted_edge(max(size, 1e-3), angle, offset, shape=shape)
        for weight, size in zip(weights, sizes, strict=True)
        if weight
    )

    def above(f):
        """The transfer of the lens and a square pixel, less one half."""
        pixel = np.sinc(f * np.cos(angle)) * np.sinc(f * np.sin(angle))
        return weights @ np.exp(-2 * (np.pi * sizes * f) ** 2) * pixel - 0.5

    image = low + (high - low) * (image - 0.1) / 0.5
    image = how.get("light", lambda image, rng: image)(image, rng)
    image = image + noise * (high - low) * rng.standard_normal(image.shape)
    image = np.rot90(how.get("kept", lambda image, rng: image)(image, rng), rng.integers(4))
    return image[:, ::-1] if rng.random() < 0.5 else image, brentq(above, 1e-4, 0.99)


def light(share):
    """Light that changes over the image, across or along."""

    def changed(image, rng):
        place = np.indices(image.shape)[rng.integers(2)] / image.shape[0] - 0.5
        return image * (1 + share * rng.choice([-1, 1]) * place)

    return changed


def rounded(bits):
    """Grey values of a number of bits."""
    return lambda image, _: np.round(image * (2**bits - 1)) / (2**bits - 1)


def with_hot(share):
    """Pixels that are black or white."""

    def changed(image, rng):
        hot = rng.random(image.shape) < share
        return np.where(hot, rng.choice([0.0, 1.0], image.shape), image)

    return changed


def jpeg(quality, gamma="linear"):
    """Compressed, by a phone with the display's curve."""

    def changed(image, _):
        codes = np.uint8(np.round(255 * encode(np.clip(image, 0, 1), gamma)))
        file = cv2.imencode(".jpg", codes, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        return decode(cv2.imdecode(file, 0) / 255, gamma)

    return changed


def shot(image, rng):
    """Noise of 2,000 electrons at white."""
    return rng.poisson(2000 * image) / 2000


def grain(image, rng):
    """Noise that neighbouring pixels share."""
    return image + 0.05 * gaussian_filter(rng.standard_normal(image.shape), 0.7)


def off_by(remarks):
    """Largest error of which nothing more need be said, percent: 3, or what a remark says."""
    said = [int(one) for one in re.findall(r"off by (\d+)%", "; ".join(remarks))]
    return max(3, *said, 10 * ("a tenth" in "; ".join(remarks)))


STEPS = [{"degrees": (at, at), "shape": ((80, 80), (60, 120), (120, 60))[k % 3]}
         for k, at in enumerate(np.arange(2, 44.1, 0.5))]  # fmt: skip
"""Each half degree, in square, wide and long images in turn."""

SLOPES = {"1:1": 1, "1:2": 1 / 2, "1:3": 1 / 3, "2:3": 2 / 3, "1:4": 1 / 4, "3:4": 3 / 4}
CONDITIONS = {
    "usual": {},
    "no noise": {"noise": 0.0},
    **{f"noise {k} %": {"noise": k / 100} for k in (2, 3, 5)},
    **{f"noise {k} %, 2 to 44 degrees": {"noise": k / 100, "degrees": (2, 44)} for k in (2, 5)},
    **{
        f"slope {name}, noise 2 %": {"noise": 0.02, "degrees": [np.degrees(np.arctan(slope))] * 2}
        for name, slope in SLOPES.items()
    },
    **{f"each half degree, noise {k} %": {"noise": k / 100, "draws": STEPS} for k in (0, 2, 5)},
    "38 to 44 degrees, long": {"degrees": (38, 44), "shape": (120, 60)},
    "38 to 44 degrees, wide": {"degrees": (38, 44), "shape": (60, 120)},
    "30 to 44 degrees, noise 3 %": {"degrees": (30, 44), "noise": 0.03},
    "long": {"shape": (200, 40)},
    "wide": {"shape": (40, 160)},
    "crops of 20 px": {"shape": (20, 20)},
    "crops of 12 px": {"shape": (12, 12), "sigma": (0.4, 0.8)},
    "soft": {"sigma": (2, 4)},
    "sharp": {"sigma": (0.25, 0.4)},
    "tails of 1 px, 30 %": {"tail": (0.3, 1.0)},
    "tails of 2 px, 15 %": {"tail": (0.15, 2.0)},
    "tails of 4 px, 10 %": {"tail": (0.1, 4.0)},
    "20 grey values": {"low": 0.2, "high": 0.28, "noise": 0.04, "kept": rounded(8)},
    "20 grey values, no noise": {"low": 0.2, "high": 0.28, "noise": 0.0, "kept": rounded(8)},
    "8 bits": {"noise": 0.005, "kept": rounded(8)},
    "8 bits, no noise": {"noise": 0.0, "kept": rounded(8)},
    "6 bits, no noise": {"noise": 0.0, "kept": rounded(6)},
    "light 15 % across": {"light": light(0.15)},
    "light 15 %, noise 3 %": {"light": light(0.15), "noise": 0.03},
    "light 30 %": {"light": light(0.3)},
    "hot pixels .5 %": {"kept": with_hot(0.005)},
    "hot pixels 2 %, noise 2 %": {"kept": with_hot(0.02), "noise": 0.02},
    "JPEG 50": {"noise": 0.005, "kept": jpeg(50)},
    "JPEG 75": {"noise": 0.005, "kept": jpeg(75)},
    "JPEG 85 of a phone": {"kept": jpeg(85, "srgb")},
    "shot noise": {"noise": 0.0, "kept": shot},
    "grain": {"noise": 0.0, "kept": grain},
}


def table(draws):
    """A row a condition: error, coverage of intervals, share said, silent by more than 5 %."""
    rows = []
    for number, (name, how) in enumerate(CONDITIONS.items()):
        off, covered, said, beyond, refused = [], [], [], 0, 0
        each = how.get("draws", [{}] * draws)
        for draw, change in enumerate(each):
            image, truth = edge(np.random.default_rng([number, draw]), **how | change)
            try:
                found = fit_edge(image)
            except ValueError:
                refused += 1
                continue
            off.append(100 * (found.mtf50 / truth - 1))
            said.append(bool(found.remarks))
            beyond += abs(off[-1]) > off_by(found.remarks)
            known = np.isfinite(found.mtf50_sigma)
            covered += [abs(found.mtf50 - truth) < 1.96 * found.mtf50_sigma] * bool(known)
        off = np.array(off)
        row = {"edges": name, "draws": len(each), "refused": refused, "said": np.mean(said)}
        row |= {"rms (%)": np.sqrt(np.mean(off**2)), "sfrmat5 (%)": SFRMAT5.get(name, np.nan)}
        row |= {"bias (%)": off.mean(), "largest (%)": np.abs(off).max()}
        row |= {"intervals": len(covered), "covered": np.mean(covered) if covered else np.nan}
        row["beyond 3 % and what is said"] = beyond
        rows.append(row | {"silent above 5 %": int(((np.abs(off) > 5) & ~np.array(said)).sum())})
    return pd.DataFrame(rows)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=24)
    result = table(parser.parse_args().draws)
    print(result.round(2).to_string())
    write_section("Images: edges by condition", result)
