"""Files as a sceptical surveyor would try them: other units and systems, wrong ends and names."""

import json

import cv2
import laspy
import numpy as np
import rasterio
import rasterio.transform

from mmqa_lab.cloud import Cloud
from mmqa_lab.io import write_cloud

SQUARE = [[0.1, 0.1, 0], [0.9, 0.1, 0], [0.9, 0.9, 0], [0.1, 0.9, 0], [0.1, 0.1, 0]]
HOLE = [[0.3, 0.3, 0], [0.6, 0.3, 0], [0.6, 0.6, 0], [0.3, 0.6, 0], [0.3, 0.3, 0]]


def write_odd(folder):
    """Write all of them into a folder."""
    rng = np.random.default_rng(7)
    profiles = np.stack(np.meshgrid([0.0], 0.05 * np.arange(12), 0.02 * np.arange(40)), axis=-1)
    np.savetxt(folder / "profiles.xyz", profiles.reshape(-1, 3), fmt="%.4f")
    flat = np.column_stack([rng.uniform(0, 1, (900, 2)), rng.normal(0, 0.004, 900)])
    places = np.column_stack([rng.uniform(0.1, 0.9, (40, 2)), np.zeros(40)])
    _write_texts(folder, flat, places)
    _write_clouds(folder, flat)
    _write_polygons(folder)
    texts = {
        "unsorted.csv": "time,x,y,z\n3,3,0,0\n1,1,0,0\n2,2,0,0\n",
        "repeated.csv": "time,x,y,z\n1,3,0,0\n1,1,0,0\n2,2,0,0\n",
        "trees.csv": "x,y,z,kind\n0.5,0.5,0,tree\n",
        "blanks.csv": "x,y,z,kind\n0.5,,0,pole\n",
        "far_poles.csv": "x,y,z,kind\n5000,5000,0,pole\n",
        "no_poles.csv": "x,y,z,kind\n",
        "far_lines.csv": "500000,0,0,500005,0,0\n500000,1,0,500005,1,0\n500000,2,0,500000,2,3\n",
        "one_line.csv": "0,0,0,5,0,0\n",
        "week.csv": "time,x,y,z\n604798,0,0,2\n604799,1,0,2\n0,2,0,2\n1,3,0,2\n",
        "leap.csv": "time,x,y,z\n0,0,0,2\n1,1,0,2\n2,90000,0,2\n3,2,0,2\n",
        "gap.csv": "time,x,y,z\n0,0,0,2\n1,,0,2\n2,2,0,2\n",
        "late.csv": "time,x,y,z,roll,pitch,heading\n100,0,0,2,0,0,0\n110,0,9,2,0,0,0\n",
        "in_ms.csv": "time,x,y,z,roll,pitch,heading\n0,0,0,2,0,0,0\n6000,0,9,2,0,0,0\n",
        "many.csv": "system,quantity,value\nA,density_per_m2,many\n",
        "beyond.csv": "system,quantity,value,low,high\nA,density_per_m2,5000,100,200\n",
        "far_path.csv": "time,x,y,z,roll,pitch,heading\n0,5e6,0,2,0,0,0\n10,5e6,9,2,0,0,0\n",
        "near_path.csv": "time,x,y,z,roll,pitch,heading\n0,99,0,2,0,0,0\n10,99,9,2,0,0,0\n",
        "text.laz": "x y z\n1 2 3\n",
    }
    for name, text in texts.items():
        (folder / name).write_text(text)
    _write_headerless(folder, flat)
    _write_images(folder, rng)
    _write_lines(folder, rng)


def _write_lines(folder, rng):
    """Two sets of lines, the one moved by (2.31, 5.50, 0.66) m."""
    starts, ways = rng.uniform(0, 1, (30, 3)) * [40, 40, 8], rng.normal(0, 3, (30, 3))
    still = np.hstack([starts, starts + ways])
    moved = still + np.tile([2.31, 5.5, 0.66], 2) + rng.normal(0, 0.01, still.shape)
    for name, lines in {"still": still, "moved": moved}.items():
        np.savetxt(folder / f"{name}.csv", lines, delimiter=",", fmt="%.3f")


def _write_headerless(folder, flat):
    """Text without a header whose first columns are not x, y, z; and some whose are."""
    utm, bright = flat + [691000.25, 5334000.5, 520], np.arange(900) * 7 % 251
    tables = {
        "bright_utm.xyz": ("%d %.3f %.3f %.3f", [bright[:, None], utm]),
        "bright_local.xyz": ("%d %.4f %.4f %.4f", [bright[:, None], flat]),
        "class_utm.xyz": ("%d %.3f %.3f %.3f", [np.full((900, 1), 2), utm]),
        "time_utm.xyz": ("%.3f %.3f %.3f %.3f", [345600 + np.arange(900)[:, None] / 1000, utm]),
        "colours.xyz": ("%d %d %d %.4f %.4f %.4f", [np.outer(bright, [1, 1, 1]), flat]),
        "z_first.xyz": ("%.3f %.3f %.3f", [utm[:, [2, 0, 1]]]),
        "plain_utm.xyz": ("%.4f %.4f %.4f %d", [utm, bright[:, None]]),
        "plain_local.xyz": ("%.4f %.4f %.4f %d", [flat, bright[:, None]]),
        "geocentric.xyz": ("%.4f %.4f %.4f", [flat + [4176500.0, 857900.0, 4727500.0]]),
    }
    for name, (form, parts) in tables.items():
        np.savetxt(folder / name, np.hstack(parts), fmt=form)


def _write_images(folder, rng):
    """A star, and tarps of known reflectance."""
    y, x = np.mgrid[:200, :200] - 99.5
    star = np.where(np.sin(36 * np.arctan2(y, x)) > 0, 50.0, 200.0)
    star[np.hypot(y, x) > 90] = 200
    star = 200 * cv2.GaussianBlur(star, (0, 0), 0.8) + rng.normal(0, 50, star.shape)
    cv2.imwrite(str(folder / "star.tif"), star.astype(np.uint16))
    rows = "name,x_px,y_px,radius_px,cycles\ns,{},99.5,85,{}\n"
    for name, (column, cycles) in {"at": (99.5, 36), "off": (110, 36), "half": (99.5, 18)}.items():
        (folder / f"star_{name}.csv").write_text(rows.format(column, cycles))
    tarps = rng.normal(500, 20, (100, 100))
    for (row, column), more in {(10, 10): 5000, (10, 50): 30_000, (60, 10): 15_000}.items():
        tarps[row : row + 20, column : column + 20] += more
    cv2.imwrite(str(folder / "tarps.tif"), tarps.astype(np.uint16))
    cv2.imwrite(str(folder / "float.tif"), tarps.astype(np.float32))
    cv2.imwrite(str(folder / "pixel.png"), np.zeros((1, 1), np.uint8))
    (folder / "photo.heic").write_bytes(b"\0\0\0\x18ftypheic" + bytes(64))
    head = "name,x_px,y_px,width_px,height_px,reflectance\n"
    known = {"": (0.05, 0.5), "_percent": (5, 50), "_same": (0.3, 0.3), "_turned": (0.5, 0.05)}
    for name, (dark, bright) in known.items():
        text = f"a,11,11,18,18,{dark}\nb,51,11,18,18,{bright}\nc,11,61,18,18,\n"
        (folder / f"tarps{name}.csv").write_text(head + text)


def _write_texts(folder, flat, places):
    """Tables of points."""
    tables = {
        "flat.csv": ("x,y,z", flat),
        "feet.csv": ("x_ft,y_ft,z_ft", flat / 0.3048),
        "millimetres.csv": ("x,y,z", 1000 * flat),
        "degrees.csv": ("lat,lon,height", flat * [1e-5, 1e-5, 1] + [48.1, 11.5, 0]),
        "huge.csv": ("x,y,z", flat + [5e14, 5e14, 0]),
        "swapped.csv": ("z,x,y", flat[:, [2, 0, 1]]),
        "spoilt.csv": ("x,y,z", np.vstack([flat, [[np.nan] * 3, [np.inf] * 3]])),
        "same.csv": ("x,y,z", np.ones((50, 3))),
        "doubled.csv": ("x,y,z", np.vstack([flat, flat])),
        "Straße Nord.csv": ("x,y,z", flat),
        "levelled.csv": ("x,y,z", places),
        "levelled_far.csv": ("x,y,z", places + [5e5, 5e6, 0]),
        "levelled_low.csv": ("x,y,z", places - [0, 0, 43]),
        "levelled_feet.csv": ("x,y,z", places / 0.3048),
        "levelled_mm.csv": ("x,y,z", 1000 * places),
        "levelled_plan.csv": ("x,y", places[:, :2]),
        "levelled_once.csv": ("x,y,z", np.repeat(places[:1], 40, axis=0)),
        "levelled_none.csv": ("x,y,z", np.vstack([places, [[0.5, 0.5, -9999]] * 3])),
        "sentinel.csv": ("x,y,z", np.vstack([flat, [[-9999] * 3] * 3])),
        "geographic.csv": ("x,y,z", flat * [1e-5, 1e-5, 1] + [11.5, 48.1, 0]),
        "levelled_id.csv": (
            "id,easting,northing,height",
            np.column_stack([np.arange(1, 41), places]),
        ),
        "id.csv": ("id,x,y,z", np.column_stack([np.arange(1, 901), flat])),
        "intensity.csv": ("intensity,x,y,z", np.column_stack([7 * np.arange(900) % 255, flat])),
    }
    for name, (header, rows) in tables.items():
        np.savetxt(folder / name, rows, fmt="%.9g", delimiter=",", header=header, comments="")
    text = (folder / "flat.csv").read_text()
    (folder / "comma.csv").write_text(text.replace(",", ";").replace(".", ","))
    (folder / "utf16.csv").write_text(text, encoding="utf-16")
    np.savetxt(folder / "huge.csv", flat + [5e14, 5e14, 0], header="x y z", comments="")


def _write_clouds(folder, flat):
    """LAS and LAZ files."""
    systems = {"flat": 25832, "zone33": 25833, "feet": 2263, "degrees": 4326}
    systems["feet_up"] = "26918+6360"
    for name, number in systems.items():
        write_cloud(folder / f"{name}.laz", Cloud(flat, crs=f"EPSG:{number}"), scale=1e-4)
    for name in ("box.las", "tiles/a.las", "tiles/a.laz", "again/a.las"):
        write_cloud(folder / name, Cloud(flat), scale=1e-4)
    write_cloud(folder / "again" / "b.las", Cloud(flat[:0:-1]), scale=1e-4)
    few = (np.arange(len(flat)) < 300).astype(np.uint8)
    write_cloud(folder / "withheld.las", Cloud(flat, {"withheld": few}), scale=1e-4)
    write_cloud(folder / "noise.las", Cloud(flat, {"classification": 7 * few}), scale=1e-4)
    unset = np.where(np.arange(121).reshape(11, 11) < 60, -32768.0, 0.0)
    places = rasterio.transform.from_origin(-0.05, 1.05, 0.1, 0.1)
    for name, crs in (("grid", None), ("grid_feet", "EPSG:2263"), ("grid_up", "EPSG:26918+6360")):
        about = {"driver": "GTiff", "height": 11, "width": 11, "count": 1, "dtype": "float32"}
        with rasterio.open(folder / f"{name}.tif", "w", crs=crs, transform=places, **about) as file:
            file.write(unset.astype(np.float32), 1)
    write_cloud(folder / "coarse.laz", Cloud(flat), scale=0.05)
    for name, number in (("a", 25832), ("b", 25833)):
        write_cloud(folder / "mixed" / f"{name}.laz", Cloud(flat, crs=f"EPSG:{number}"), scale=1e-4)
    whiles = {"timed": (0, 5), "again": (0, 4), "rollover": (604_790, 604_810)}
    for name, ends in whiles.items():
        timed = Cloud(flat, {"gps_time": np.linspace(*ends, len(flat)) % 604_800})
        write_cloud(folder / f"{name}.laz", timed, scale=1e-4)
    single = (flat + [6.9e6, 6.9e6, 500]).astype(np.float32)
    names = "".join(f"property float {axis}\n" for axis in "xyz")
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex 900\n{names}end_header\n"
    (folder / "single.ply").write_bytes(header.encode() + single.tobytes())
    (folder / "blank").mkdir()
    laspy.LasData(laspy.LasHeader(version="1.4", point_format=6)).write(folder / "blank" / "e.laz")
    for name in ("laz.ply", "laz.csv", "laz.las"):
        (folder / name).write_bytes((folder / "flat.laz").read_bytes())
    (folder / "picture.laz").write_bytes(cv2.imencode(".png", np.zeros((9, 9), np.uint8))[1])
    changes = {
        "scaled.las": (131, np.float64(0.01).tobytes()),
        "scale0.las": (131, np.float64(0).tobytes()),
        "fewer.las": (247, (500).to_bytes(8, "little")),
        "more.las": (247, (901).to_bytes(8, "little")),
        "moved.las": (155, np.float64(1000).tobytes()),
        "format.las": (104, b"\x01"),
    }
    for name, (place, field) in changes.items():
        content = bytearray((folder / "box.las").read_bytes())
        content[place : place + len(field)] = field
        (folder / name).write_bytes(content)


def _write_polygons(folder):
    """GeoJSON files."""
    polygons = {
        "square": [SQUARE],
        "hole": [SQUARE, HOLE],
        "none": [],
        "ringless": [[]],
        "flipped": [[vertex[::-1] for vertex in SQUARE]],
        "nan": [[[np.nan] * 3] * 4],
        "crossed": [[SQUARE[k] for k in (0, 2, 1, 3, 0)]],
        "plan": [[vertex[:2] for vertex in SQUARE]],
        "mixed": [[SQUARE[0], SQUARE[1], SQUARE[2][:2], SQUARE[3][:2], SQUARE[0]]],
        "repeated": [[vertex for vertex in SQUARE for _ in range(2)]],
        "clockwise": [SQUARE[::-1]],
        "outside": [SQUARE, [[x + 5, y, z] for x, y, z in HOLE]],
        "filled": [SQUARE, SQUARE],
        "upright": [[[0.1, 0, -1], [0.9, 0, -1], [0.9, 0, 1], [0.1, 0, 1], [0.1, 0, -1]]],
    }
    nodes = {name: {"type": "Polygon", "coordinates": rings} for name, rings in polygons.items()}
    systems = {"32": "EPSG:25832", "33": "urn:ogc:def:crs:EPSG::25833", "own": "grid of the site"}
    for name, system in (systems | {"foot": "EPSG:2263"}).items():
        nodes[f"square_{name}"] = nodes["square"] | {"crs": {"properties": {"name": system}}}
    nodes |= {"list": [1, 2], "null": None, "point": {"type": "Point", "coordinates": [0, 0]}}
    nodes["collection"] = {"type": "FeatureCollection", "features": []}
    for name, node in nodes.items():
        (folder / f"{name}.geojson").write_text(json.dumps(node))
