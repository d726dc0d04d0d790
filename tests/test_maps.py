"""Maps of one tile: known surfaces, the functions of a chart as reference, any cut into tiles."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmqa_lab.maps import METRICS
from mmqa_lab.maps.tile import FIGURES, LAYERS, evaluate_tile, reach
from mmqa_lab.planes import fit_plane, sigma_mad
from mmqa_lab.spacing import poisson_spacing, quadrant_distances, quadrants

LEVEL, UPRIGHT, OTHER = range(3)


def turned(tilt, azimuth):
    """Axes u, v, w of a plane: tilted from the horizontal, then turned about the vertical."""
    t, a = np.radians([tilt, azimuth])
    u = np.array([-np.sin(a), np.cos(a), 0.0])
    w = np.array([np.sin(t) * np.cos(a), np.sin(t) * np.sin(a), np.cos(t)])
    return np.array([u, np.cross(w, u), w])


def sheet(rng, n, *, size=4.0, axes=((1, 0, 0), (0, 1, 0), (0, 0, 1)), noise=0.0):
    """Random points of a square sheet about the origin."""
    uvw = np.stack([*(rng.random((2, n)) - 0.5) * size, rng.normal(0, noise, n)], axis=1)
    return uvw @ np.asarray(axes)


def street(rng, n=4000):
    """Road, wall and a shrub."""
    road = np.stack([*rng.uniform(-4, 4, (2, n)), rng.normal(0.2, 0.004, n)], axis=1)
    wall = np.stack(
        [4.2 + rng.normal(0, 0.004, n), rng.uniform(-4, 4, n), rng.uniform(0, 3, n)], axis=1
    )
    shrub = rng.normal([-3, 3, 0.8], 0.25, (n // 8, 3))
    return np.concatenate([road, wall, shrub])


@pytest.mark.parametrize(("tilt", "azimuth"), [(0, 0), (30, 20), (60, 200), (90, 0), (90, 30)])
def test_lattice_has_its_spacing_and_density_on_any_surface(tilt, azimuth):
    step = 0.02
    u, v = np.meshgrid(np.arange(-100, 100) * step, np.arange(-100, 100) * step)
    axes = turned(tilt, azimuth)
    points = np.stack([u.ravel(), v.ravel(), 0 * u.ravel()], axis=1) @ axes + [0.013, 0.017, 0.011]
    found = evaluate_tile(points, (-1, -1, 2, 2), cell=0.5)
    layer = LEVEL if tilt <= 45 else UPRIGHT
    assert found["n"][layer].sum() > 0.8 * found["n"].sum()
    # Quadrants are half open: however the axes lie in a square lattice, two of the four nearest
    # lie in each pair of opposite quadrants, so the four distances are the same.
    d = [np.nanmedian(found[f"d{k}"][layer]) for k in range(1, 5)]
    assert d[0] == pytest.approx(1000 * step, rel=1e-6)
    if tilt in (0, 90) and azimuth == 0:
        assert d[3] == pytest.approx(1000 * step, rel=1e-6)
        covered = np.nanmedian(found["density"][layer])
        assert covered == pytest.approx(1 / step**2, rel=0.06)  # 25 or 26 rows in a cell


def test_random_points_have_poisson_spacing_on_the_wall_as_on_the_road(rng):
    density = 4000.0
    for axes, layer in ((np.eye(3), LEVEL), (turned(90, 25), UPRIGHT), (turned(35, 70), LEVEL)):
        points = sheet(rng, int(16 * density), axes=axes, noise=0.003)
        found = evaluate_tile(points, (-2, -2, 4, 4), cell=0.5)
        n = found["n"][layer]
        full = n > 0.7 * n.max()
        expected = 1000 * poisson_spacing(density)
        for k in range(4):
            d = np.median(found[f"d{k + 1}"][layer][full])
            assert d == pytest.approx(expected[k], rel=0.04)  # median of 10 cells of 1000 points
        assert np.median(found["f"][layer][full]) == pytest.approx(3.257, rel=0.05)
        sigma = np.median(found["sigma_mad"][layer][full])
        assert sigma == pytest.approx(3.0, rel=0.06)


def test_horizontal_cells_equal_the_functions_of_a_chart(rng):
    points = street(rng)
    found = evaluate_tile(points, (-8, -8, 17, 16), cell=0.5, surface="horizontal")
    distances = quadrant_distances(points[:, :2], radius=0.5)
    places = np.floor(points[:, :2] / 0.5).astype(int) + 8
    for column, row in [(0, 0), (5, 9), (16, 3), (12, 12)]:
        own = (places == (column, row)).all(axis=1)
        assert found["n"][0, row, column] == own.sum()
        assert found["density"][0, row, column] == own.sum() / 0.25
        expected = 1000 * np.nanmedian(distances[own], axis=0)
        obtained = [found[f"d{k}"][0, row, column] for k in range(1, 5)]
        assert obtained == expected.tolist()
        plane = fit_plane(points[own])
        assert found["sigma_mad"][0, row, column] == pytest.approx(
            1000 * sigma_mad(plane.residuals), rel=1e-6
        )


def test_a_cell_of_a_wall_equals_the_functions_of_a_chart(rng):
    """One cube of a wall: its own regression plane, the points near it, horizontal axes."""
    wall = sheet(rng, 20_000, axes=turned(90, 15), noise=0.004) + [0.25, 0.25, 0]
    found = evaluate_tile(wall, (0, 0, 1, 1), cell=0.5, radius=0.3)
    inside = (np.floor(wall[:, :2] / 0.5) == 0).all(axis=1)
    parts, residuals = [], []
    for k in np.unique(np.floor(wall[inside, 2] / 0.5)):
        own = inside & (np.floor(wall[:, 2] / 0.5) == k)
        if own.sum() < 5:
            continue
        plane = fit_plane(wall[own])
        level = np.cross([0, 0, 1], plane.normal)
        level /= np.linalg.norm(level)
        uv = (wall - plane.centre) @ np.array([level, np.cross(plane.normal, level)]).T
        parts.append(quadrant_distances(uv, radius=0.3)[own])
        residuals.append(plane.residuals)
    total = np.concatenate(parts)
    assert found["n"][UPRIGHT, 0, 0] == len(total)
    for k in range(4):
        # Coordinates in the plane are rounded to a nanometre.
        assert found[f"d{k + 1}"][UPRIGHT, 0, 0] == pytest.approx(
            1000 * np.nanmedian(total[:, k]), abs=1e-4
        )
    sigma = 1000 * sigma_mad(np.concatenate(residuals))
    assert found["sigma_mad"][UPRIGHT, 0, 0] == pytest.approx(sigma, rel=1e-6)


@pytest.mark.parametrize("turn", [0.0, 10.0, 30.0, 45.0, 77.0])
@pytest.mark.parametrize("lean", [0.0, 15.0, 40.0, 70.0, 85.0])
def test_density_of_a_plane_does_not_depend_on_its_place_among_the_cells(rng, turn, lean):
    density, noise = 2000.0, 0.004
    flat = rng.uniform(-5, 5, (int(density * 100), 2))
    c, s, turn, lean = np.cos, np.sin, np.radians(turn), np.radians(lean)
    along = np.array([c(turn), s(turn), 0])
    steepest = np.array([-s(turn) * s(lean), c(turn) * s(lean), c(lean)])
    exact = flat @ [along, steepest] + [0.11, 0.23, 0.17]
    inside = (np.abs(exact) < 2.5).all(axis=1)  # so that every cube with points is full of them
    normal = np.cross(along, steepest)
    points = exact[inside] + rng.normal(0, noise, (inside.sum(), 1)) * normal
    found = evaluate_tile(points, (-6, -6, 12, 12), cell=0.5)
    assert found["n"][[LEVEL, UPRIGHT]].sum() > 0.99 * len(points)
    # Corners with few points and noise across the outer borders: up to 2 % of the area.
    assert found["area"].sum() == pytest.approx(len(points) / density, rel=0.025)
    known = found["area"] > 0
    values, area = found["density"][known], found["area"][known]
    order = np.argsort(values)
    median = values[order][np.searchsorted(np.cumsum(area[order]), area.sum() / 2)]
    assert median == pytest.approx(density, rel=0.015)


@pytest.mark.parametrize("offset", [-0.01, -0.003, 0.0, 0.004, 0.01])
def test_a_wall_on_a_border_keeps_its_density_and_its_dispersion(rng, offset):
    flat = rng.uniform(-3, 3, (72_000, 2))
    points = np.stack([flat[:, 0], rng.normal(offset, 0.005, len(flat)), flat[:, 1]], axis=1)
    found = evaluate_tile(points, (-6, -2, 12, 4), cell=0.5)
    assert found["n"][UPRIGHT].sum() == len(points)
    assert found["area"].sum() == pytest.approx(36, abs=1e-3)  # each cube's part in one of two
    known = found["area"] > 0
    # 500 points in a cube: a standard error of 4.5 %.
    assert np.median(found["density"][known]) == pytest.approx(2000, rel=0.03)
    # Half the points of each column at least: 3000, of which 1.17 / sqrt(2 n) is 1.5 %.
    assert np.nanmedian(found["sigma_mad"][known]) == pytest.approx(5, rel=0.03)
    assert np.average(found["void_share"][known], weights=found["area"][known]) < 0.01


def test_layers_part_road_wall_and_foliage_and_lose_no_point(rng):
    points = street(rng)
    found = evaluate_tile(points, (-12, -12, 24, 24), cell=0.5)
    assert found["n"].sum() == len(points)
    assert found["n"][LEVEL].sum() == pytest.approx(4000, rel=0.05)
    assert found["n"][UPRIGHT].sum() == pytest.approx(4000, rel=0.06)
    assert found["n"][OTHER, 16:20, 4:8].sum() > 200  # the shrub
    assert np.isnan(found["f"][OTHER]).all()


def test_a_road_on_a_border_of_cubes_is_one_sheet(rng):
    """Noise puts its points into cubes above and below: the area must not double."""
    points = sheet(rng, 16_000, noise=0.005)
    found = evaluate_tile(points, (-2, -2, 4, 4), cell=0.5)
    assert found["area"][LEVEL] == pytest.approx(0.25, rel=1e-3)
    assert found["density"][LEVEL].mean() == pytest.approx(1000, rel=0.03)


def test_voids_are_the_squares_without_a_point():
    x, y = np.meshgrid(np.arange(0.025, 1, 0.05), np.arange(0.025, 1, 0.05))
    points = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    points = points[~((points[:, 0] < 0.2) & (points[:, 1] < 0.3))]  # 2 x 3 squares of 0.1 m
    found = evaluate_tile(points, (0, 0, 2, 2), cell=0.5, metrics=("void_share",))
    assert found["void_share"][LEVEL].ravel() == pytest.approx([6 / 25, 0, 0, 0])
    assert set(found) == {"n", "coincident", "area", "void_share"}


@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    cut=st.integers(-7, 7),
    surface=st.sampled_from(tuple(LAYERS)),
    cell=st.sampled_from([0.5, 0.3, 1.0]),
    radius=st.sampled_from([0.2, 0.5, 0.7]),
)
def test_any_cut_into_tiles_gives_the_same_bits(seed, cut, surface, cell, radius):
    points = street(np.random.default_rng(seed), 1500)
    choices = {"cell": cell, "surface": surface, "radius": radius}
    whole = evaluate_tile(points, (-14, -14, 28, 28), **choices)
    halo = reach(surface, cell=cell, radius=radius)
    for low, high in ((-14, cut), (cut, 14)):
        near = (points[:, 0] >= low * cell - halo) & (points[:, 0] <= high * cell + halo)
        part = evaluate_tile(points[near], (low, -14, high - low, 28), **choices)
        for name, values in part.items():
            same = whole[name][:, :, low + 14 : high + 14]
            np.testing.assert_array_equal(values, same, err_msg=name)


def test_figures_follow_the_cloud_when_it_moves_by_whole_cells(rng):
    points = street(rng, 1500)
    moved = evaluate_tile(points + [512, -1024, 256], (1012, -2060, 24, 24), cell=0.5)
    for name, values in evaluate_tile(points, (-12, -12, 24, 24), cell=0.5).items():
        # Coordinates 1000 times larger carry 1e-13 m of rounding.
        np.testing.assert_allclose(moved[name], values, rtol=1e-6, atol=1e-6, err_msg=name)


def test_spacing_is_that_of_a_selection(rng):
    """The medians of one full cell are those of spacing() over its points."""
    points = sheet(rng, 3000, size=0.5) + [0.25, 0.25, 0.1]
    found = evaluate_tile(points, (0, 0, 1, 1), cell=0.5, surface="horizontal")
    whole = quadrants(points[:, :2], radius=0.5)
    assert [found[f"d{k}"][0, 0, 0] for k in range(1, 5)] == (1000 * whole.d).tolist()
    assert found["f"][0, 0, 0] == whole.f
    assert found["incomplete_share"][0, 0, 0] == pytest.approx(whole.incomplete_share)


def test_nothing_and_next_to_nothing_are_not_measurable():
    empty = evaluate_tile(np.empty((0, 3)), (0, 0, 2, 1), cell=0.5)
    assert empty["n"].shape == (3, 1, 2)
    assert not empty["n"].any()
    few = evaluate_tile(np.full((3, 3), 0.1), (0, 0, 2, 1), cell=0.5)
    assert few["n"][OTHER].tolist() == [[3, 0]]
    for name in set(FIGURES) - {"n", "coincident", "area"}:
        assert np.isnan(few[name]).all()


@pytest.mark.parametrize(
    ("choices", "sentence"),
    [
        ({"cell": 0}, "Invalid cell 0. Must be > 0 m."),
        ({"radius": -1}, "Invalid radius -1. Must be > 0"),
        ({"thickness": 0}, "Invalid thickness 0. Must be > 0"),
        ({"void": np.nan}, "Invalid void nan. Must be finite"),
        ({"surface": "curved"}, "Must be one of local, horizontal"),
        ({"metrics": ("beauty",)}, "Invalid metric 'beauty'. Must be one of density"),
    ],
)
def test_rejects(choices, sentence):
    with pytest.raises(ValueError, match=sentence.replace(".", r"\.")):
        evaluate_tile(np.zeros((1, 3)), (0, 0, 1, 1), **({"cell": 0.5} | choices))


def test_metrics_name_every_variable():
    everything = evaluate_tile(np.empty((0, 3)), (0, 0, 1, 1), cell=1, metrics=METRICS)
    assert set(everything) == set(FIGURES)
