"""Outlines of a GIS: the same ring in every form, several with their names, on the cloud."""

import json
import warnings

import numpy as np
import pyogrio
import pyproj
import pytest
import shapely

from mmqa_lab import io
from mmqa_lab.__main__ import main
from mmqa_lab.chart_cloud import evaluate_cloud, inside_polygon
from mmqa_lab.cloud import Cloud
from mmqa_lab.io import outlines

ZONE = pyproj.CRS(25832)
CORNER = np.array([500_000.0, 5_400_000.0, 100.0])
RING = CORNER + [[0.2, 0.2, 0.01], [1.8, 0.2, 0.09], [1.8, 1.6, 0.09], [0.2, 1.6, 0.01]]


@pytest.fixture
def slope(rng):
    """A road of 6 m x 2 m whose height rises by 5 % to the east, m."""
    plan = rng.random((4000, 2)) * [6, 2]
    return CORNER + np.column_stack([plan, 0.05 * plan[:, 0]])


def written(path, rings, names, *, crs="EPSG:25832", flat=False, **layout):
    """Write rings by pyogrio."""
    made = [shapely.Polygon(np.asarray(ring)[:, : 2 if flat else 3]) for ring in rings]
    kind = "Polygon" if flat else "Polygon Z"
    shapes = np.array([shapely.to_wkb(one) for one in made])
    fields = [np.array(names, dtype=object)]
    pyogrio.raw.write(path, shapes, fields, ["name"], geometry_type=kind, crs=crs, **layout)


def same_ring(found, expected, atol):
    """Whether two rings have the same vertices."""
    one, other = (ring[np.lexsort(np.round(ring, 2).T)] for ring in (found, expected))
    return np.allclose(one, other, 0, atol)


@pytest.mark.parametrize("name", ["o.gpkg", "o.shp", "o.fgb", "o.kml", "o.wkt", "o.csv"])
def test_a_ring_is_the_same_in_every_form(tmp_path, name):
    path, atol = tmp_path / name, 1e-6
    if name in ("o.wkt", "o.csv"):
        text = shapely.to_wkt(shapely.Polygon(RING), rounding_precision=9)
        path.write_text(text if name == "o.wkt" else f'WKT,id\n"{text}",1\n')
    elif name == "o.kml":
        to = pyproj.Transformer.from_crs(ZONE, 4326, always_xy=True)
        degrees = np.column_stack([*to.transform(*RING[:, :2].T), RING[:, 2]])
        rows = " ".join(f"{x:.10f},{y:.10f},{z}" for x, y, z in [*degrees, degrees[0]])
        ring = f"<LinearRing><coordinates>{rows}</coordinates></LinearRing>"
        polygon = f"<Polygon><outerBoundaryIs>{ring}</outerBoundaryIs></Polygon>"
        path.write_text(
            '<kml xmlns="http://www.opengis.net/kml/2.2"><Document><Placemark><name>a</name>'
            f"{polygon}</Placemark></Document></kml>"
        )
        atol = 1e-3
    else:
        written(path, [RING], ["a"])
    ((label, found),) = io.read_outlines(path, crs=ZONE)
    assert label == ("1" if name in ("o.wkt", "o.csv") else "a")
    assert same_ring(found, RING, atol)
    assert same_ring(io.read_polygon(path, crs=ZONE), RING, atol)


def test_a_closed_polyline_of_a_drawing_is_an_outline(tmp_path):
    rows = ["0\nVERTEX\n8\nwall\n10\n{}\n20\n{}\n30\n{}\n70\n32".format(*v) for v in RING.tolist()]
    body = "\n".join(["0\nPOLYLINE\n8\nwall\n66\n1\n70\n9", *rows, "0\nSEQEND"])
    (tmp_path / "o.dxf").write_text(f"0\nSECTION\n2\nENTITIES\n{body}\n0\nENDSEC\n0\nEOF\n")
    ((label, found),) = io.read_outlines(tmp_path / "o.dxf")
    assert label == "wall"
    assert same_ring(found, RING, 1e-9)


@pytest.mark.parametrize("flat", [False, True])
def test_five_outlines_are_five_rows(tmp_path, slope, capfd, flat):
    rings = [RING * [1, 1, 1] + [0.9 * k, 0, 0.045 * k] for k in range(5)]
    names = ["first", "second", "third", "fourth", "fifth"]
    written(tmp_path / "five.gpkg", rings, names, flat=flat)
    io.write_cloud(tmp_path / "road.laz", Cloud(slope, crs=ZONE))
    done = main(["evaluate", str(tmp_path / "road.laz"), "--polygon", str(tmp_path / "five.gpkg"),
                 "--json"])  # fmt: skip
    assert done == 0
    rows = json.loads(capfd.readouterr().out)
    assert [row["outline"] for row in rows] == names
    for row, ring in zip(rows, rings, strict=True):
        inside = shapely.contains_xy(shapely.Polygon(ring), *slope[:, :2].T).sum()
        assert abs(row["n"] - inside) <= 2
    assert main(["pattern", str(tmp_path / "road.laz"), "--polygon", str(tmp_path / "five.gpkg")])
    assert "5 outlines. Must be one" in capfd.readouterr().err


def test_outlines_without_heights_lie_on_the_surface_below_what_stands_on_it(tmp_path, slope):
    slope[:300, 2] += 1.5  # people
    written(tmp_path / "flat.gpkg", [RING], ["a"], flat=True)
    with pytest.warns(UserWarning, match="no heights: laid onto the cloud"):
        found = io.read_polygon(tmp_path / "flat.gpkg", crs=ZONE, points=slope)
    assert same_ring(found, RING, 1e-3)
    with pytest.raises(ValueError, match="vertices without heights"):
        io.read_polygon(tmp_path / "flat.gpkg", crs=ZONE)
    with pytest.raises(ValueError, match="0 points inside it"):
        io.read_polygon(tmp_path / "flat.gpkg", crs=ZONE, points=slope + [100, 0, 0])


def test_outlines_in_another_system_are_moved_onto_the_cloud(tmp_path):
    to = pyproj.Transformer.from_crs(ZONE, 25833, always_xy=True)
    other = np.column_stack([*to.transform(*RING[:, :2].T), RING[:, 2]])
    written(tmp_path / "o.gpkg", [other], ["a"], crs="EPSG:25833")
    assert same_ring(io.read_polygon(tmp_path / "o.gpkg", crs=ZONE), RING, 1e-6)
    assert same_ring(io.read_polygon(tmp_path / "o.gpkg"), other, 1e-6)


def with_hole():
    """A ring with a hole of a quarter of its area, as shapely's polygon."""
    middle = RING.mean(axis=0)
    return shapely.Polygon(RING, [(RING - middle) / 2 + middle])


@pytest.mark.parametrize("form", ["h.wkt", "h.gpkg", "h.geojson", "flat.gpkg"])
def test_a_hole_is_no_surface(tmp_path, slope, form):
    """Density, points and places leave it out; it is written and read back."""
    shape, path = with_hole(), tmp_path / form
    if form == "h.wkt":
        path.write_text(shapely.to_wkt(shape, rounding_precision=9))
    elif form == "h.geojson":
        io.write_outlines(path, {"a": io.read_polygon(polygon_file(tmp_path, shape))})
    else:
        polygon_file(path.parent, shape, name=form, flat=form == "flat.gpkg")
    with warnings.catch_warnings(action="ignore"):
        ring = io.read_polygon(path, crs=ZONE, points=slope)
    found = evaluate_cloud(slope, polygon=ring)
    inside = shapely.contains_xy(shape, *slope[:, :2].T)
    assert abs(found.n - inside.sum()) <= 2
    assert found.area_polygon_m2 == pytest.approx(shape.area * np.hypot(1, 0.05), rel=1e-4)
    assert found.outline.area == pytest.approx(found.area_polygon_m2)
    assert inside_polygon(slope[inside], ring).mean() > 0.999
    filled = evaluate_cloud(slope, polygon=RING)
    assert found.density_polygon_per_m2 == pytest.approx(filled.density_polygon_per_m2, rel=0.1)


def polygon_file(folder, shape, *, name="o.gpkg", flat=False):
    """Write one polygon by pyogrio."""
    stored = np.array([shapely.to_wkb(shapely.force_2d(shape) if flat else shape)])
    kind = "Polygon" if flat else "Polygon Z"
    layout = {"geometry_type": kind, "crs": "EPSG:25832"}
    pyogrio.raw.write(folder / name, stored, [np.array(["a"], dtype=object)], ["name"], **layout)
    return folder / name


def test_a_map_has_rows_for_each_area(tmp_path, slope, capfd):
    io.write_cloud(tmp_path / "road.laz", Cloud(slope, crs=ZONE))
    areas = [CORNER + [[x, 0, 0], [x + 2, 0, 0], [x + 2, 2, 0], [x, 2, 0]] for x in (0, 3)]
    written(tmp_path / "areas.gpkg", areas, ["west", "east"], flat=True)
    given = ["map", str(tmp_path / "road.laz"), "--out", str(tmp_path / "m.tif"), "--json"]
    assert main([*given, "--polygon", str(tmp_path / "areas.gpkg")]) == 0
    rows = [row for row in json.loads(capfd.readouterr().out) if row["figure"] == "density"]
    assert [(row["outline"], row["n"]) for row in rows] == [("west", 16), ("east", 16)]


def test_damage_gets_one_sentence(tmp_path):
    (tmp_path / "d.gpkg").write_bytes(b"SQLite format 3\0" + bytes(90))
    with pytest.raises(ValueError, match=r"damaged.* Must be outlines of a GIS"):
        io.read_outlines(tmp_path / "d.gpkg")


@pytest.mark.parametrize("ending", [".geojson", ".gpkg"])
def test_outlines_there_and_back(tmp_path, ending):
    before = {"wall": RING, "001": RING + [3, 0, 0.25], "flat": RING * [1, 1, 0]}
    io.write_outlines(tmp_path / f"o{ending}", before, crs=ZONE)
    again = dict(io.read_outlines(tmp_path / f"o{ending}", crs=ZONE))
    assert list(again) == list(before)
    for name, ring in before.items():
        assert np.array_equal(again[name], ring)
    with pytest.raises(ValueError, match=r"Invalid ending '\.csv'"):
        io.write_outlines(tmp_path / "o.csv", before)


def test_an_outline_is_laid_onto_the_plane_of_most_points_inside(rng):
    """A slanted floor with noise of a millimetre; of its points a quarter stands up to 2 m high."""
    points = rng.uniform([4e5, 5e6, 0], [4e5 + 10, 5e6 + 10, 0.001], (2000, 3))
    floor = lambda xy: 50 + 0.2 * (xy[:, 0] - 4e5) - 0.1 * (xy[:, 1] - 5e6)  # noqa: E731
    points[:, 2] += floor(points)
    points[:500, 2] += rng.uniform(0.1, 2, 500)
    ring = np.array([[1.0, 1], [9, 1], [9, 8], [1, 8]]) + [4e5, 5e6]
    aside = np.vstack([points, [[4e5 - 1, 5e6 + 2, 900]]])  # outside
    for given in (
        ring,
        np.column_stack([ring, np.zeros(4)]),
        np.column_stack([ring, [np.nan] * 4]),
    ):
        with pytest.warns(UserWarning, match="have no heights: laid onto the cloud"):
            found = outlines._placed(given, None, None, aside, "p")
        assert found[:, :2].tolist() == ring.tolist()
        assert found[:, 2] == pytest.approx(floor(ring) + 0.0005, abs=5e-4)
    level = np.column_stack([ring, np.zeros(4)])
    low = points - [0, 0, points[:, 2].min() - 1]  # a cloud that begins a metre above zero
    with pytest.warns(UserWarning, match="All heights of p are 0"):
        found = outlines._placed(level, None, None, low, "p")
    assert found.tolist() == level.tolist()
    small = np.column_stack([[0.0, 900, 900], [0, 0, 900], [0, 0, 0]])
    assert outlines._placed(small, None, None, points, "p").tolist() == small.tolist()
    for n in (2, 3):
        few = np.column_stack([ring.mean(axis=0) + np.eye(2)[[0, 1, 0]][:n] * [[1], [1], [2]][:n],
                               np.ones(n)])  # fmt: skip
        if n == 2:
            with pytest.raises(ValueError, match="2 points inside it"):
                outlines._placed(ring, None, None, few, "p")
    with pytest.raises(ValueError, match="vertices without heights"):
        outlines._placed(ring, None, None, None, "p")


def test_narrow_outlines_are_degrees_and_others_are_transformed_in_plan():
    zone = pyproj.CRS(25832)
    globe = np.array([[8.5, 49.0, 3], [8.5004, 49.0, 4], [8.5004, 49.0003, 5]])
    expected = pyproj.Transformer.from_crs(4326, zone, always_xy=True).transform(*globe.T[:2])
    found = outlines._in_system(globe, None, zone, "p")
    assert found[:, :2] == pytest.approx(np.transpose(expected), abs=1e-4)
    assert found[:, 2].tolist() == [3, 4, 5]
    assert outlines._in_system(globe, pyproj.CRS(4326), zone, "p") == pytest.approx(found)
    for wide, degrees in ((0.0009, True), (0.0011, False)):
        ring = np.array([[8.5, 49.0], [8.5 + wide, 49.0], [8.5, 49.0002]])
        if degrees:
            with pytest.raises(ValueError, match="it looks like degrees"):
                outlines._in_system(ring, None, None, "p")
        else:
            assert outlines._in_system(ring, None, None, "p") is ring
    far = globe + [172, 0, 0]  # more than 180
    assert outlines._in_system(far, None, None, "p") is far
    assert outlines._in_system(globe, zone, zone, "p") is globe
    (low, high) = outlines.plan_extent("1,2,3; 5,2,3; 5,9,3")
    assert (low.tolist(), high.tolist()) == ([1, 2], [5, 9])


def test_names_that_repeat_are_numbered_and_rings_without_one_counted(tmp_path):
    square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 0]]
    named = ["wall", None, "wall", "roof", "3"]
    features = [
        {"type": "Feature", "properties": {"name": one} if one else {},
         "geometry": {"type": "Polygon", "coordinates": [square]}}
        for one in named
    ]  # fmt: skip
    node = {"type": "FeatureCollection", "features": features}
    (tmp_path / "o.geojson").write_text(json.dumps(node))
    found = [name for name, _ in io.read_outlines(tmp_path / "o.geojson")]
    assert found == ["wall", "2", "wall (2)", "roof", "3"]
