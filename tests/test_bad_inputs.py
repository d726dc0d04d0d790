"""Bad input of many kinds, for every command: exit status 2, one sentence, nothing written."""

import shlex

import cv2
import laspy
import numpy as np
import pytest

from mmqa_lab import samples
from mmqa_lab.__main__ import main
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
    ("map none.laz --out m.nc", "no such file or folder. Must exist."),
    ("map nothing --out m.nc", "Must be, or contain, .las or .laz files."),
    ("map notes.md --out m.nc", "Must be, or contain, .las or .laz files."),
    ("map four_bytes.laz --out m.nc", "Must have a header."),
    ("map PATCH --out m.docx", "'.docx'. Must be one of .nc, .zarr, .tif."),
    ("map PATCH --out m.tif", "no coordinate reference system in the files"),
    ("map PATCH --out m.nc --crs EPSG:0", "Invalid crs 'EPSG:0'. Must be known"),
    ("map PATCH one.las --out m.nc", "Must lie within 5e+09 cells of 0.5 m."),
    ("map PATCH --out m.nc --cell 0", "Invalid cell 0.0. Must be > 0 m."),
    ("map PATCH --out m.nc --cell nan", "Invalid cell nan"),
    ("map PATCH --out m.nc --tile -5", "Invalid tile -5.0. Must be > 0 m."),
    ("map PATCH --out m.nc --metrics beauty", "Invalid metric 'beauty'. Must be one of density"),
    ("map PATCH --out m.nc --below density", "Must be NAME=VALUE"),
    ("map PATCH --out m.nc --below beauty=1", "Invalid figure with a threshold 'beauty'"),
    ("map PATCH --out m.nc --workers 0", "Invalid workers 0. Must be a whole number >= 1."),
    ("map PATCH --out m.nc --scheduler nowhere", "nowhere"),
    # polygons
    ("evaluate PATCH --polygon none.csv", "no such file. Must exist."),
    ("evaluate PATCH --polygon words.csv", "words.csv"),
    ("evaluate PATCH --polygon broken.json", "broken.json"),
    ("evaluate PATCH --polygon object.json", "Must be GeoJSON"),
    ("evaluate PATCH --polygon '0,0,0; 1,0,0; 1,1,0'", "inside the polygon: 0 given. Must be 3"),
    ("evaluate PATCH --polygon '0,0,0; 1,0,0'", "Must be 3 or more."),
    ("evaluate PATCH --polygon '0,0,0; 1,0,0; 1,1,inf'", "inf"),
    ("evaluate PATCH --polygon '0,0,0; 1,1,0; 1,0,0; 0,1,0'", "Must be an outline that encloses"),
    ("evaluate PATCH --polygon degrees.json", "CRS84. Must be projected, in metres."),
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
    ("image grey.png --chart grey", "none of the 4 coded targets"),
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
    # names
    ("studies nowhere", "Invalid study 'nowhere'. Must be one of chart_tables"),
    ("student copies nowhere", "Invalid study 'nowhere'. Must be one of chart_tables"),
    ("dance", "dance"),
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
    (folder / "cut.png").write_bytes((folder / "grey.png").read_bytes()[:60])
    return folder


def words(line):
    """The arguments of a line, quoted ones whole; files are asked for that must not appear."""
    given = [PATCH if word == "PATCH" else word for word in shlex.split(line)]
    if given[0] in ("evaluate", "image") and "--out" not in given:
        given += ["--out", "figure.pdf"]
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


def test_there_are_sixty_kinds_over_all_commands():
    commands = {line.split()[0] for line, _ in CASES}
    assert len(CASES) >= 60
    assert commands >= {"evaluate", "poles", "map", "lhd", "accuracy", "plan", "image", "tender"}
