"""Parts of maps: what lies around a tile, how tiles are joined, and what stands in a cell."""

import numpy as np
import pandas as pd
import pytest

from mmqa_lab import maps
from mmqa_lab.maps import campaign, cells


@pytest.mark.parametrize(
    ("radius", "cell", "reach"), [(0.5, 0.25, 3), (0.51, 0.25, 4), (0.1, 2.0, 2), (1.0, 1.0, 2)]
)
def test_cells_around_a_tile_reach_a_cell_farther_than_neighbours(radius, cell, reach):
    assert campaign._reach({"radius": radius, "cell": cell}) == reach


@pytest.mark.parametrize("side", [4, 8])
@pytest.mark.parametrize("place", [(0, 0), (-1, 1), (1, -2)])
def test_slices_near_a_tile_have_a_cell_within_reach(place, side):
    """Tiles of 4 cells, joined to 4 or 8; two files with the points of a column in a row."""
    run = {"radius": 0.5, "cell": 0.25, "tile": 4, "side": side}  # three cells around
    rows = [(name, i, j, 10 * (20 * i + j), 10 * (20 * i + j) + 7)
            for name in "ab" for i in range(-6, 7) for j in range(-6, 7)]  # fmt: skip
    slices = pd.DataFrame(rows, columns=["name", "column", "row", "start", "stop"])
    expected = []
    low = np.multiply(place, side) - 3
    high = np.multiply(place, side) + side + 3
    inside = [k for k in range(-6, 7) if 4 * k + 4 > low[0] and 4 * k < high[0]]
    down = [k for k in range(-6, 7) if 4 * k + 4 > low[1] and 4 * k < high[1]]
    for name in "ab":
        for i in inside:
            expected.append([name, 10 * (20 * i + min(down)), 10 * (20 * i + max(down)) + 7])
    assert campaign._near(slices, place, run) == expected


def test_tiles_are_joined_until_one_has_enough_points(monkeypatch):
    monkeypatch.setattr(campaign, "ENOUGH", 100)
    rows = [(i, j, 0, 3) for i in range(-8, 8) for j in range(-8, 8)]
    slices = pd.DataFrame(rows, columns=["column", "row", "start", "stop"])
    side, places = campaign._tiles(slices, 5)  # 3, 12, 48, then 192 points
    assert side == 40
    assert sorted(places) == [[i, j] for i in (-1, 0) for j in (-1, 0)]
    side, places = campaign._tiles(slices.assign(stop=101), 5)
    assert (side, len(places)) == (5, 256)
    side, places = campaign._tiles(slices.assign(stop=30), 5)
    assert (side, len(places)) == (10, 64)
    few = slices[(slices["column"].abs() <= 1) & (slices["row"] == 0)]
    assert campaign._tiles(few, 5) == (5, [[-1, 0], [0, 0], [1, 0]])


def test_files_have_the_same_points_within_a_step():
    file = {"n": 9, "about": [[0, 0, 0], [1, 2, 3], [0.5, 1, 1.5]], "step": 0.01}
    for off, step, same in ((0.02, 0.02, True), (0.0201, 0.02, False), (0.01, 0.001, True),
                            (0.0101, 0.001, False)):  # fmt: skip
        other = {"n": 9, "about": (np.array(file["about"]) + [0, off, 0]).tolist(), "step": step}
        assert campaign._has_same_points(file, other) == same
        assert campaign._has_same_points(other, file) == same
        assert not campaign._has_same_points(file | {"n": 8}, other)
    exact = {"n": 1, "about": [[0.0] * 3] * 3, "step": 0.0}
    for off, same in ((1e-5, True), (1.1e-5, False)):
        assert campaign._has_same_points(exact, exact | {"about": [[off] * 3] * 3}) == same


def test_the_hash_of_a_file_is_that_of_its_first_and_last_megabyte(tmp_path):
    size, content = 2**20, np.zeros(3 * 2**20, np.uint8)

    def hashed(place=None):
        changed = content.copy()
        if place is not None:
            changed[place] = 1
        (tmp_path / "a").write_bytes(changed.tobytes())
        return campaign._hash_of_ends(tmp_path / "a")

    same = hashed()
    for place in (0, size - 1, 2 * size, 3 * size - 1):
        assert hashed(place) != same
    for place in (size, 2 * size - 1):
        assert hashed(place) == same
    (tmp_path / "b").write_bytes(b"12345")
    twice = campaign.sha256(b"1234512345").hexdigest()  # both ends of a short file are all of it
    assert campaign._hash_of_ends(tmp_path / "b") == twice


def test_a_rectangle_has_its_lower_sides_and_not_its_upper_ones():
    places = np.array([[1, 2, 9], [3, 2, 9], [1, 4, 9], [2.9, 3.9, 9], [0.9, 2, 9], [1, 1.9, 9]])
    found = campaign._within(places, (1, 2), (3, 4))
    assert found.tolist() == [True, False, False, True, False, False]


def test_the_empty_space_of_cells_is_the_second_largest_of_their_places(rng):
    xy = rng.uniform(0, 6, (150, 2))
    corners = np.array([[0, 0], [2, 3], [5, 1]])
    places = corners[:, None] + cells.CELL_PLACES
    found = cells._empty_space(xy, places, 1.0, 0.4)
    for corner, e95 in zip(corners, found, strict=True):
        away = [np.hypot(*(xy - place).T).min() for place in corner + cells.CELL_PLACES]
        second = np.sort(away)[-2]
        assert e95 == pytest.approx(second if second < 0.4 else np.nan, nan_ok=True)
    assert len(cells.CELL_PLACES) * 0.05 <= 2
    wide = cells._empty_space(2 * xy, places, 2.0, 9.0)
    assert wide == pytest.approx(2 * cells._empty_space(xy, places, 1.0, 9.0))


def test_a_map_has_each_figure_at_its_place_with_quantiles_over_cells():
    """Cells of 0.5 m with 4, 6 and 9 points on a lattice, about -3 m and 7 m."""
    parts, counts = [], {(-6, 14): 2, (-5, 14): 3, (-6, 15): 2}
    for (i, j), n in counts.items():
        step = (np.arange(n) + 0.5) / n / 2
        x, y = (one.ravel() for one in np.meshgrid(i / 2 + step, j / 2 + step))
        parts.append(np.column_stack([x, y, 100 + 0 * x]))
    found = maps.map_cloud(np.vstack(parts), cell=0.5)
    assert found["x"].values.tolist() == [-2.75, -2.25]
    assert found["y"].values.tolist() == [7.25, 7.75]
    for name, scale in (("n", 1), ("density", 4)):
        values = found[name].values
        assert values[0].tolist() == [4 * scale, 9 * scale]
        assert values[1, 0] == 4 * scale
        assert values[1, 1] == 0 if name == "n" else np.isnan(values[1, 1])
    assert found.attrs["cell_m"] == 0.5
    table = maps.summarise(found).set_index("figure")
    row = table.loc["density"]
    assert (row["n"], row["unit"]) == (3, "points/m2")
    quantiles = {f"q{100 * q:02.0f}": np.quantile([16, 16, 36], q) for q in cells.QUANTILES}
    assert dict(row[[*quantiles]]) == pytest.approx(quantiles)
    assert {"q05", "q50", "q95"} <= {*quantiles}
