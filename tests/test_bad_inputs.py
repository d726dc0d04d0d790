"""Bad input of many kinds, for every command: exit status 2, one sentence, nothing written."""

import shlex

import cv2
import laspy
import numpy as np
import pytest
from odd_inputs import write_odd

from mmqa_lab import samples
from mmqa_lab.__main__ import _commands, main
from mmqa_lab.cloud import Cloud
from mmqa_lab.io import write_cloud

PATCH = str(samples.path("road_patch"))

PLAN = (
    "plan --pulse-rate 300000 --mirror-frequency 100 --speed 10 --scanner-heading 45 "
    "--scanner-tilt 45 --range 5"
)

SEGMENTS = "0,0,0,5,0,0\n0,1,0,5,1,0\n0,2,0,0,2,3\n"

CASES = [
    # clouds
    ("info none.laz", "none.laz: no such file. Must exist."),
    ("info notes.md", "Must be one of .las, .laz"),
    ("evaluate none.laz", "none.laz: no such file. Must exist."),
    ("evaluate notes.md", "Must be one of .las, .laz"),
    ("evaluate cut.laz", "Must be a complete LAS or LAZ file."),
    ("evaluate lying.las", "Must be a complete LAS or LAZ file."),
    ("evaluate empty.las", "no points. Must contain one or more."),
    ("evaluate broken.ply", "broken.ply"),
    ("evaluate nan.xyz", "no points. Must contain one or more."),
    ("evaluate two_columns.xyz", "two_columns.xyz"),
    ("evaluate nothing", "a folder. Must be a file."),
    ("evaluate empty.xyz", "Must be rows of columns."),
    ("evaluate words.xyz", "Must be rows of numbers"),
    ("evaluate two.xyz", "2 given. Must be 3 or more."),
    ("evaluate line.xyz", "Must span a plane."),
    ("evaluate one.las", "1 given. Must be 3 or more."),
    ("evaluate unnamed.csv", "with columns id, lat, lon. Must have x, y, z or easting"),
    ("evaluate numbered.csv", "its first column numbers the rows"),
    ("evaluate numbered_floats.xyz", "its first column numbers the rows"),
    ("evaluate broken.pcd", "Must be a PCD file with x, y, z"),
    ("evaluate PATCH --radius 0", "Invalid radius 0.0. Must be > 0 m."),
    ("evaluate PATCH --radius nan", "Invalid radius nan. Must be"),
    ("evaluate PATCH --axes up", "Must be principal, horizontal or degrees."),
    ("evaluate PATCH --axes inf", "Invalid axes inf. Must be finite."),
    ("evaluate PATCH --out figure.docx", "Must be one of .pdf, .svg, .png."),
    ("poles none.laz", "no such file. Must exist."),
    ("poles small.xyz --corridor 0 --trajectory path.csv", "corridor"),
    ("poles PATCH --corridor -3 --trajectory path.csv", "-3"),
    ("poles PATCH --gate 0 --reference poles.csv", "Invalid gate 0"),
    ("poles PATCH --reference none.csv", "no such file. Must exist."),
    ("poles PATCH --reference words.csv", "x_m"),
    ("map none.laz --out m.nc", "no such file. Must exist."),
    ("map nothing --out m.nc", "Must contain .las or .laz files."),
    ("map four_bytes.laz --out m.nc", "Must have a header."),
    ("map PATCH --out m.docx", "'.docx'. Must be one of .nc, .tif."),
    ("map PATCH --out m.tif", "no coordinate system in the files"),
    ("map PATCH one.las --out m.nc", "Must lie within 30000 tiles."),
    ("map PATCH --out m.nc --cell 0", "Invalid cell 0.0. Must be > 0 m."),
    ("map PATCH --out m.nc --cell nan", "Invalid cell nan"),
    # polygons
    ("evaluate PATCH --polygon none.csv", "no such file. Must exist."),
    ("evaluate PATCH --polygon words.csv", "words.csv"),
    ("evaluate PATCH --polygon broken.json", "broken.json"),
    ("evaluate PATCH --polygon object.json", "Must be GeoJSON"),
    ("evaluate PATCH --polygon '0,0,0; 1,0,0; 1,1,0'", "inside the polygon: 0 given. Must be 3"),
    ("evaluate PATCH --polygon '0,0,0; 1,0,0'", "Must be 3 or more."),
    ("evaluate PATCH --polygon '0,0,0; 1,0,0; 1,1,inf'", "inf"),
    ("evaluate PATCH --polygon '0,0,0; 1,1,0; 1,0,0; 0,1,0'", "Must be an outline that encloses"),
    ("evaluate PATCH --polygon degrees.json", "(CRS84)). Must be projected, in metres."),
    ("evaluate PATCH --polygon bent.csv", "of their spread. Must be at most 5 %."),
    ("evaluate PATCH --thickness 0 --polygon '0,0,0; 1,0,0; 1,1,0'", "Invalid thickness 0.0."),
    # segments
    ("lhd none.csv segments.csv", "no such file. Must exist."),
    ("lhd words.csv segments.csv", "words.csv"),
    ("lhd five_columns.csv segments.csv", "five_columns.csv"),
    ("lhd no_length.csv segments.csv", "no length in line 4"),
    ("lhd nan_segments.csv segments.csv", "nan_segments.csv"),
    ("lhd nothing.csv segments.csv", "nothing.csv"),
    ("lhd segments.csv segments.csv --weight -1", "Invalid weight -1"),
    ("lhd segments.csv segments.csv --sensitivity 0", "Invalid sensitivity 0"),
    ("lhd cut.laz segments.csv", "cut.laz"),
    # trajectories and heights
    ("accuracy none.laz heights.csv", "no such file. Must exist."),
    ("accuracy PATCH none.csv", "no such file. Must exist."),
    ("accuracy PATCH words.csv", "words.csv"),
    ("accuracy PATCH nothing.csv", "nothing.csv"),
    ("accuracy PATCH broken.tif", "broken.tif"),
    ("accuracy PATCH broken.npz", "broken.npz"),
    ("accuracy PATCH heights.csv --radius -1", "Invalid radius -1"),
    ("accuracy PATCH heights.csv --thin 0", "0.0"),
    ("accuracy PATCH heights.csv --trajectory none.csv", "no such file. Must exist."),
    ("accuracy PATCH heights.csv --trajectory words.csv", "words.csv"),
    ("accuracy small.xyz heights.csv --drives", "gps_time"),
    ("poles PATCH --trajectory words.csv", "words.csv"),
    # scan geometry
    (f"{PLAN} --speed 0", "Invalid speed_m_s 0.0. Must be > 0"),
    (f"{PLAN} --range -5", "Invalid range_m -5.0. Must be > 0"),
    (f"{PLAN} --pulse-rate nan", "nan"),
    (f"{PLAN} --mirror-frequency -100", "-100"),
    (f"{PLAN} --target-heading 135", "Invalid target heading 135.0"),
    ("plan --scanner toaster --range 5", "toaster"),
    # images, layouts
    ("image none.jpg --chart grey", "no such file. Must exist."),
    ("image words.csv --chart grey", "Must be JPEG, PNG or TIFF"),
    ("image cut.png --chart grey", "Must be a complete file."),
    ("image mosaic.tif --chart grey", "a raw mosaic of colours. Must be developed first."),
    ("image grey.png --chart grey", "none of the 4 coded targets"),
    ("image photo.heic --chart grey", "export HEIC and raw photographs"),
    ("image pixel.png --chart grey", "3 x 3 pixels or more"),
    ("image float.tif --chart grey", "with 8 or 16 bits"),
    ("image grey.png --chart none.json", "none.json"),
    ("image grey.png --chart broken.json", "Invalid chart layout"),
    ("image grey.png --chart grey --corners '1,1; 2,2'", "corners"),
    ("image grey.png --chart grey --corners '1,1; 2,2; 3,3; 4,4'", "corners"),
    ("image grey.png --chart grey --orientation broken.json", "broken.json"),
    ("chart --out chart.docx", "'.docx'. Must be one of .pdf, .svg, .json."),
    ("chart --out chart.pdf --widths-h 40,0", "0"),
    ("chart --out chart.pdf --widths-h words", "words"),
    ("chart --out nowhere/deep/chart.pdf --widths-v 900", "900"),
    # criteria and results
    ("tender none.csv pfeifer2021", "no such file. Must exist."),
    ("tender words.csv pfeifer2021", "criterion"),
    ("tender broken.json pfeifer2021", "broken.json"),
    ("tender odd_relation.csv pfeifer2021", "about"),
    ("tender no_threshold.csv pfeifer2021", "threshold"),
    ("tender pfeifer2021:1 words.csv", "system"),
    ("tender pfeifer2021:3 pfeifer2021", "pfeifer2021:3"),
    # other units, systems, names and ends than it should be
    ("info feet.csv", "with columns x_ft, y_ft, z_ft. Must have x, y, z"),
    ("evaluate feet.csv", "with columns x_ft, y_ft, z_ft. Must have x, y, z"),
    ("evaluate degrees.csv", "with columns lat, lon, height. Must have x, y, z"),
    ("evaluate feet.laz", "in US survey foot"),
    ("evaluate degrees.laz", "in degrees (WGS 84)"),
    ("pattern feet.laz", "in US survey foot"),
    ("poles feet.laz", "in US survey foot"),
    ("poles degrees.laz", "in degrees (WGS 84)"),
    ("accuracy feet.laz levelled.csv", "in US survey foot"),
    ("map feet.laz --out m.nc", "in US survey foot"),
    ("map degrees.laz --out m.nc", "in degrees (WGS 84)"),
    ("calibrate feet.laz feet.laz --trajectory late.csv", "in US survey foot"),
    ("evaluate same.csv", "50 of them on one line or spot. Must span a plane."),
    ("evaluate text.laz", "no LAS header"),
    ("evaluate picture.laz", "no LAS header"),
    ("evaluate laz.ply", "Must be a PLY file"),
    ("evaluate laz.csv", "Must be a name for each column."),
    ("evaluate utf16.csv", "Must have x, y, z"),
    ("evaluate scale0.las", "scales [0."),
    ("evaluate more.las", "room for 900 points where the header says 901"),
    ("evaluate flat.csv --rho0 -5", "Invalid rho0 -5.0. Must be > 0 points per m2."),
    ("evaluate flat.csv --radius -1", "Invalid radius -1.0. Must be > 0 m."),
    ("evaluate flat.csv --thickness nan --polygon square.geojson", "Invalid thickness nan."),
    ("evaluate flat.csv --out /proc/mmqa.pdf", "Must lie in a folder that can be written to."),
    ("evaluate flat.laz --polygon square_33.geojson", "zone 33N. Must be in that of the cloud"),
    ("evaluate flat.csv --polygon square_foot.geojson", "in US survey foot"),
    ("evaluate flat.csv --polygon none.geojson", "without an area. Must be a polygon."),
    ("evaluate flat.csv --polygon ringless.geojson", "ringless.geojson of shape (0,)."),
    ("evaluate flat.csv --polygon point.geojson", "without an area. Must be a polygon."),
    ("evaluate flat.csv --polygon collection.geojson", "without an area. Must be a polygon."),
    ("evaluate flat.csv --polygon flipped.geojson", "its nearest point is"),
    ("evaluate flat.csv --polygon nan.geojson", "4 of 4 not finite"),
    ("evaluate flat.csv --polygon crossed.geojson", "Must be an outline that encloses an area."),
    ("evaluate flat.csv --polygon list.geojson", "Must be GeoJSON with a polygon"),
    ("evaluate flat.csv --polygon null.geojson", "Must be GeoJSON with a polygon"),
    ("evaluate flat.csv --polygon flat.laz", "Must be a name for each column."),
    ("evaluate flat.csv --polygon '100,100,0; 900,100,0; 900,900,0'", "its nearest point is"),
    ("accuracy flat.laz zone33.laz", "zone 33N. Must be in that of the cloud"),
    ("accuracy flat.laz levelled_far.csv", "Must overlap, in one coordinate system."),
    ("accuracy flat.laz levelled_mm.csv", "Must overlap, in one coordinate system."),
    ("accuracy flat.laz levelled_plan.csv", "with columns x, y. Must have x, y, z"),
    ("accuracy flat.laz levelled.csv --slope-limit -5", "Invalid slope_limit -5.0."),
    ("accuracy flat.laz levelled.csv --gross-limit 0", "Invalid gross_limit 0.0."),
    ("accuracy flat.laz levelled.csv --drives --gap -1", "Invalid gap_s -1.0."),
    ("accuracy flat.laz levelled.csv --classes 99", "no points. Must be some of 0."),
    ("accuracy flat.laz levelled.csv --trajectory repeated.csv", "a time repeats."),
    ("accuracy flat.laz --targets trees.csv", "Invalid kind 'tree'. Must be one of pole"),
    ("accuracy flat.laz --targets blanks.csv", "no finite number in line 2."),
    ("accuracy flat.laz --targets far_poles.csv", "none measured in the cloud"),
    ("accuracy flat.laz --targets no_poles.csv", "no targets."),
    ("accuracy flat.laz", "Must have either REFERENCE or --targets."),
    ("map mixed --out m.nc", "have different ones. Must be the same."),
    ("map blank --out m.nc", "e.laz has no points."),
    (
        "map flat.laz --out m.nc --below density=-5",
        "Invalid threshold of density -5.0.",
    ),
    ("map flat.laz --out m.nc --crs EPSG:4326", "Invalid crs in degrees"),
    (
        "map flat.laz --out m.nc --crs EPSG:25833",
        "zone 33N. Must be in that of the files",
    ),
    ("lhd far_lines.csv one_line.csv", "no common edges, the nearest are"),
    ("calibrate timed.laz --trajectory late.csv", "Must cover them, on the same day and clock."),
    ("calibrate flat.laz flat.csv --trajectory in_ms.csv", "gps_time"),
    ("calibrate timed.laz again.laz --trajectory in_ms.csv --cell -1", "Invalid cell -1.0."),
    ("calibrate timed.laz again.laz --trajectory in_ms.csv --keep yaw", "Invalid keep 'yaw'."),
    ("pattern flat.csv", "what random points can reach"),
    ("tender pfeifer2021:1 many.csv", "'many'. Must be a number"),
    ("plan --scanner vq-450 --range nan", "Invalid range_m nan."),
    ("bench nowhere", "Invalid study 'nowhere'."),
    ("bench anisotropy --method os:nothing", "Must be a function."),
    ("chart --out /proc/chart.pdf", "Must lie in a folder that can be written to."),
    # columns without names, units of heights, polygons, paths, targets that cannot be right
    ("evaluate bright_utm.xyz", "its first column has whole numbers, the next three have not"),
    ("evaluate bright_local.xyz", "its first column has whole numbers, the next three have not"),
    ("evaluate colours.xyz", "its first three columns have whole numbers"),
    ("evaluate class_utm.xyz", "its third column has 53340"),
    ("evaluate time_utm.xyz", "its third column has 53340"),
    ("evaluate z_first.xyz", "its third column has 53340"),
    ("evaluate feet_up.laz", "in US survey foot"),
    ("accuracy feet_up.laz levelled.csv", "in US survey foot"),
    ("accuracy flat.csv grid_feet.tif", "in US survey foot"),
    ("accuracy flat.csv grid_up.tif", "in US survey foot"),
    ("evaluate flat.csv --polygon mixed.geojson", "Must all have heights, or none."),
    ("evaluate flat.csv --polygon outside.geojson", "Must be an outline that encloses an area."),
    ("evaluate flat.csv --polygon filled.geojson", "Must be an outline that encloses an area."),
    ("accuracy flat.laz levelled.csv --trajectory week.csv", "the week begins again"),
    ("accuracy flat.laz levelled.csv --trajectory leap.csv", "is the unit of time right?"),
    ("accuracy flat.laz levelled.csv --trajectory gap.csv", "no finite number in line 3"),
    ("poles flat.csv --trajectory leap.csv", "is the unit of time right?"),
    ("radiometry star star.tif --targets star_half.csv", "Must be tilted by 35 degrees or less"),
    ("radiometry reflect tarps.tif --targets tarps_percent.csv", "Must be between 0 and 1."),
    ("radiometry reflect tarps.tif --targets tarps_same.csv", "do not have a larger DN"),
    ("radiometry reflect tarps.tif --targets tarps_turned.csv", "do not have a larger DN"),
    ("radiometry edge none.tif", "no such file. Must exist."),
    ("radiometry star star.tif", "Invalid star without targets. Must have --targets."),
    ("radiometry edge tarps.tif --through-zero", "Must be with calibrate."),
    ("radiometry star star.tif --targets tarps.csv", "no column 'radius_px'"),
    # intervals that do not hold their value, paths of another place
    ("tender pfeifer2021:1 beyond.csv", "density_per_m2 of A 5000: low 100, high 200."),
    ("accuracy flat.laz levelled.csv --trajectory far_path.csv", "5000.0 km from the points"),
    ("poles flat.laz --trajectory far_path.csv", "5000.0 km from the points"),
    ("calibrate timed.laz again.laz --trajectory far_path.csv", "5000.0 km from the points"),
    # names
    ("studies nowhere", "Invalid study 'nowhere'. Must be one of chart_tables"),
    ("student copies nowhere", "Invalid study 'nowhere'. Must be one of chart_tables"),
    ("dance", "dance"),
]


ANSWERED = [
    # right numbers, or numbers with what is to be known of them: part of the table or remark
    ("evaluate flat.csv", "900", ""),
    ("evaluate flat.csv flat.csv", "n 900 900", ""),
    ("evaluate swapped.csv", "900", ""),
    ("evaluate comma.csv", "900", ""),
    ("evaluate id.csv", "area_hull_m2 0.9775", ""),
    ("evaluate intensity.csv", "area_hull_m2 0.9775", ""),
    ("evaluate 'Straße Nord.csv'", "900", ""),
    ("evaluate laz.las", "900", ""),
    ("evaluate spoilt.csv", "900", "Dropped 2 of 902 points"),
    ("evaluate millimetres.csv", "d4 and f are not measured", ""),
    ("evaluate flat.csv --radius 1e-9", "d4 and f are not measured", ""),
    ("evaluate huge.csv", "too coarse for sigma_MAD", ""),
    ("evaluate doubled.csv", "1800 points (100 %) share their place", ""),
    ("evaluate coarse.laz", "in steps of 50 mm: too coarse", ""),
    ("evaluate single.ply", "in steps of 500 mm: too coarse", ""),
    (
        "lhd moved.csv still.csv",
        "displacement_y_m 5.498",
        "at a displacement beyond the radius of 4 m",
    ),
    ("evaluate scaled.las", "900", "leave or do not fill the header's box, by 98.9"),
    ("evaluate moved.las", "900", "leave or do not fill the header's box, by 1000 m"),
    ("evaluate fewer.las", "500", "room for 900 points, the header says 500"),
    ("evaluate format.las", "900", "2 bytes a point are not described"),
    ("evaluate flat.csv --polygon hole.geojson", "n 505", ""),
    ("evaluate flat.csv --polygon plan.geojson", "The polygon has no heights", ""),
    ("evaluate flat.csv --polygon '0,0; 1,0; 1,1'", "The polygon has no heights", ""),
    ("evaluate flat.csv --polygon square_33.geojson", "states the coordinate system", ""),
    ("evaluate flat.csv --polygon square_own.geojson", "grid of the site; it is taken", ""),
    ("evaluate flat.laz --polygon square_32.geojson", "sigma_mad_mm", ""),
    ("accuracy flat.laz levelled_feet.csv", "37 of 40 reference points lie where", ""),
    ("accuracy flat.laz levelled_low.csv", "The median difference is +43.00 m", ""),
    ("accuracy flat.laz levelled.csv --trajectory unsorted.csv", "trend_mm_per_m", ""),
    ("accuracy flat.laz levelled_id.csv", "all kept 40", ""),
    ("accuracy rollover.laz levelled.csv --drives", "drive 1 kept 40 -0.4644", ""),
    ("evaluate plain_utm.xyz", "area_hull_m2 0.97", ""),
    ("evaluate plain_local.xyz", "area_hull_m2 0.97", ""),
    ("evaluate geocentric.xyz", "area_hull_m2 0.97", ""),
    ("evaluate flat.csv --polygon repeated.geojson", "area_polygon_m2 0.64", ""),
    ("evaluate flat.csv --polygon clockwise.geojson", "area_polygon_m2 0.64", ""),
    ("evaluate flat.csv --polygon upright.geojson", "turned by 89 degrees from the polygon", ""),
    ("evaluate sentinel.csv", "3 points lie far from the others, up to 1.7", ""),
    ("evaluate geographic.csv", "are the coordinates in degrees, not metres?", ""),
    ("evaluate withheld.las", "900", "300 of 900 points of withheld.las are withheld"),
    ("evaluate noise.las", "900", "300 of 900 points of noise.las are withheld"),
    ("info feet_up.laz", "Coordinates are not in metres", ""),
    ("accuracy flat.csv grid.tif", "all kept 41", ""),
    ("accuracy flat.laz levelled_once.csv", "1 differences in a row", "Dropped 39 points"),
    ("accuracy flat.laz levelled_none.csv", "all kept 40", "Dropped 3 points"),
    ("radiometry star star.tif --targets star_off.csv", "are centre and cycles right?", ""),
    ("radiometry reflect tarps.tif --targets tarps.csv", "0.2", ""),
    ("map again --out m.nc", "1798 points (99.9 %) share their place with another", ""),
    ("map tiles --out m.nc", "counted once", ""),
    ("map fewer.las --out m.nc", "room for 900 points, the header says 500", ""),
    ("pattern profiles.xyz", "the lines with the densest points are taken for the profiles", ""),
    ("info feet.laz", "Coordinates are not in metres", ""),
    ("poles flat.laz --trajectory near_path.csv", "none", "within the corridor of 30 m about"),
    (
        "plan --scanner vq-450 --speed 10 --range 8 --height-difference 200",
        "point_spacing_m 28.6",
        "struck at 88.7 degrees of incidence",
    ),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Files that are wrong, each in its own way, beside a few that are right."""
    folder = tmp_path_factory.mktemp("bad")
    whole = samples.path("road_patch").read_bytes()
    texts = {
        "notes.md": "no cloud",
        "words.csv": "alpha,beta,gamma\none,two,three\n",
        "nothing.csv": "",
        "nan.xyz": "nan nan nan\n" * 9,
        "two_columns.xyz": "1 2\n3 4\n5 6\n",
        "small.xyz": "".join(f"{k % 5} {k // 5} 0\n" for k in range(25)),
        "broken.ply": "ply\nformat ascii 1.0\nelement vertex 9\nend_header\n1 2 3\n",
        "broken.json": '{"elements": [',
        "object.json": "{}",
        "unnamed.csv": "id,lat,lon\n1,48.1,11.5\n",
        "numbered.csv": "".join(f"{k},5.{k},6.1,7.0\n" for k in range(9)),
        "numbered_floats.xyz": "".join(f"{k}.0 5.{k} 6.1 7.0\n" for k in range(1, 9)),
        "broken.pcd": "VERSION 0.7\nFIELDS x y z\n",
        "degrees.json": '{"type": "Polygon", "crs": {"properties": {"name": "OGC:CRS84"}}}',
        "bent.csv": "x,y,z\n0,0,0\n1,0,0\n1,1,1\n0,1,0\n",
        "empty.xyz": "",
        "words.xyz": "x y z\na b c\n",
        "two.xyz": "0 0 0\n1 0 0\n",
        "line.xyz": "".join(f"{k} {k} {k}\n" for k in range(9)),
        "broken.tif": "no raster",
        "broken.npz": "no arrays",
        "segments.csv": SEGMENTS,
        "five_columns.csv": "1,2,3,4,5\n",
        "no_length.csv": SEGMENTS + "1,1,1,1,1,1\n",
        "nan_segments.csv": SEGMENTS + "1,1,nan,1,1,1\n",
        "heights.csv": "x,y,z\n0,0,0\n1,1,0\n",
        "path.csv": "time,x,y,z\n0,0,0,0\n1,5,0,0\n",
        "poles.csv": "x_m,y_m\n0,0\n",
        "odd_relation.csv": "criterion,quantity,relation,threshold\nd,density_per_m2,about,3000\n",
        "no_threshold.csv": "criterion,quantity,relation,threshold\nd,density_per_m2,>=,\n",
    }
    for name, text in texts.items():
        (folder / name).write_text(text)
    (folder / "nothing").mkdir()
    (folder / "cut.laz").write_bytes(whole[:30_000])
    (folder / "four_bytes.laz").write_bytes(b"LASF")
    laspy.LasData(laspy.LasHeader(version="1.4", point_format=6)).write(folder / "empty.las")
    write_cloud(folder / "one.las", Cloud(np.zeros((1, 3))))
    write_cloud(folder / "lying.las", Cloud(np.zeros((5, 3))))
    lying = bytearray((folder / "lying.las").read_bytes())
    lying[247:255] = (10**12).to_bytes(8, "little")  # the header's count of points
    (folder / "lying.las").write_bytes(lying)
    grey = np.tile(np.arange(0, 200, dtype=np.uint8), (150, 1))
    cv2.imwrite(str(folder / "grey.png"), grey)
    cv2.imwrite(str(folder / "mosaic.tif"), grey)
    tiff = (folder / "mosaic.tif").read_bytes()
    field = tiff.index(b"\x06\x01\x03\x00\x01\x00\x00\x00")  # what values mean
    filters = (32803).to_bytes(2, "little")  # a mosaic of colour filters
    (folder / "mosaic.tif").write_bytes(tiff[: field + 8] + filters + tiff[field + 10 :])
    (folder / "cut.png").write_bytes((folder / "grey.png").read_bytes()[:60])
    write_odd(folder)
    return folder


def words(line):
    """The arguments of a line, quoted ones whole; files are asked for that must not appear."""
    given = [PATCH if word == "PATCH" else word for word in shlex.split(line)]
    if given[0] in ("evaluate", "image") and "--out" not in given:
        given += ["--out", "figure.pdf"]
    if given[0] == "map" and not {"--workers", "--scheduler"} & set(given):
        given += ["--workers", "1"]  # no cluster for what is refused
    return given if given[0] in ("studies", "student", "dance") else [*given, "--csv", "rows.csv"]


@pytest.mark.parametrize(("line", "part"), CASES, ids=[line for line, _ in CASES])
def test_bad_input_gets_one_sentence_and_leaves_nothing(line, part, folder, monkeypatch, capfd):
    monkeypatch.chdir(folder)
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    try:
        status = main(words(line))
    except SystemExit as stop:  # argparse leaves this way
        status = stop.code
    out, err = capfd.readouterr()
    assert status == 2, out + err
    rows = [row for row in err.splitlines() if row.startswith("mmqa")]
    said = [row for row in rows if "Dropped" not in row]  # counts of bad points come before
    assert len(said) == 1, err
    assert part in said[0]
    assert "Traceback" not in err
    assert out == ""
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before


@pytest.mark.parametrize(("line", "shown", "said"), ANSWERED, ids=[row[0] for row in ANSWERED])
def test_odd_input_gets_the_right_number_or_a_remark(
    line, shown, said, folder, tmp_path, monkeypatch, capfd
):
    monkeypatch.chdir(folder)
    given = shlex.split(line.replace("--out m.nc", f"--out {tmp_path / 'm.nc'} --workers 1"))
    assert main(given) == 0
    out, err = capfd.readouterr()
    assert shown in " ".join(out.split())
    assert said in " ".join(err.split())
    if not said:
        assert err == ""


def test_there_are_kinds_over_all_commands():
    commands = {line.split()[0] for line, _ in CASES}
    assert len(CASES) + len(ANSWERED) >= 240
    given = {name for name, one in _commands().items() if one.arguments}
    assert given - commands == {"completion", "lab", "names", "readme", "test"}  # take no data
