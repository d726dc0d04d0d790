"""What the notebooks' sentences say of a rise or a fall, against what it is computed from."""

import re

import nbformat
import numpy as np
import pytest

from mmqa_lab import published
from mmqa_lab.simulate.point_patterns import point_pattern
from mmqa_lab.spacing import turned_f
from mmqa_lab.studies import STUDIES

NUMBER = r"(\d+(?:\.\d+)?)"

CHANGE = re.compile(rf"\b(?:rises|falls|drops|grows) from {NUMBER}\D*? to {NUMBER}")


def prose(study):
    """The text cells of a notebook, each as one line."""
    cells = nbformat.read(study.path, as_version=4).cells
    return " ".join(" ".join(c.source.split()) for c in cells if c.cell_type == "markdown")


def numbers(stem, pattern):
    """The numbers in a sentence of a notebook."""
    study = next(study for study in STUDIES if study.stem == stem)
    found = re.search(pattern.replace("#", NUMBER), prose(study))
    assert found, f"{stem} no longer says: {pattern}"
    return [float(text) for text in found.groups()]


def test_system_c_from_5_m_to_10_m():
    said = numbers(
        "chart_tables", "density rises by # %, and sigma_MAD grows from # to # mm, # times"
    )
    table = published.table("pfeifer2021", "table_2").query("system == 'C'").set_index("distance_m")
    near, far = table.loc[5], table.loc[10]
    assert said[0] == round(100 * (far["density_per_m2"] / near["density_per_m2"] - 1))
    sigma = near["sigma_mad_mm"], far["sigma_mad_mm"]
    assert said[1:3] == pytest.approx(sigma, abs=0.5)
    assert said[3] == pytest.approx(sigma[1] / sigma[0], abs=0.06)


def test_f_of_lines_over_the_turn():
    said = numbers("anisotropy", "f is # at every turn. # mm of noise are enough that it drops")
    drop = numbers("anisotropy", "it drops from # to # where")
    angles = np.arange(0, 91, 15)
    choices = {"density": 3000, "size": 1.0, "seed": 1000, "ratio": 10}
    exact, noisy = (
        turned_f(point_pattern("scan_lines", noise=noise / 1000, **choices), angles=angles)
        for noise in (0, said[1])
    )
    assert exact == pytest.approx(said[0], abs=0.5)
    assert [noisy.max(), noisy.min()] == pytest.approx(drop, abs=0.5)


def test_blur_of_the_simulated_scenes():
    said = numbers("image_radiometry", "blur grows from # px in the centre to # px in the corners")
    cells = next(study for study in STUDIES if study.stem == "image_radiometry").path.read_text()
    assert f"blur = {said[0]:g} + {said[1] - said[0]:g} * (x**2 + y**2)" in cells


def test_no_other_sentence_tells_of_a_change():
    told = {study.stem: len(CHANGE.findall(prose(study))) for study in STUDIES}
    told = {stem: count for stem, count in told.items() if count}
    assert told == {"chart_tables": 1, "anisotropy": 1, "image_radiometry": 2}  # 10 to 90 %: a name
