"""mmqa image, chart and tender: figures for good input, one sentence for bad input."""

import json

import cv2
import numpy as np
import pandas as pd
import pytest

from mmqa_lab import charts
from mmqa_lab.__main__ import main
from mmqa_lab.simulate import cameras


def own_chart(widths):
    """The printed bars and targets with line pairs of other widths, in rows and columns."""
    kept = [e for e in charts.imaging_chart().elements if e.name.startswith(("bar_", "marker_"))]
    x, y, pairs = 220.0, 200.0, []
    for direction, ladder in widths.items():
        for width in ladder:
            name = f"pairs_{direction}_{width}"
            pairs.append(charts.LinePairs(name, x, y, width, direction, repeats=4, length=80))
            y += 100 if direction == "h" else 4 * width + 20
        x, y = x + 200, 200.0
    return charts.Layout("own", 1000.0, 1000.0, (*kept, *pairs))


@pytest.fixture(scope="module")
def photo(tmp_path_factory):
    """A photograph of a redesigned chart, its layout, and the chart's corners in the image."""
    folder = tmp_path_factory.mktemp("photo")
    layout = own_chart({"h": (40, 30, 24), "v": (30, 24, 20)})
    (folder / "own.csv").write_text(layout.to_csv())
    camera = cameras.FrameCamera(600, 500, focal_px=1200.0)
    view = cameras.chart_view(camera, distance=5, layout=layout, heading_deg=10)
    sensor = cameras.Sensor(noise=0.01, gamma="srgb", bits=8)
    shot = cameras.photograph(layout, view, sensor=sensor, margin=40, seed=3)
    cv2.imwrite(str(folder / "photo.png"), shot.image)
    corners = shot.chart_map.pixels(layout.corners())
    return folder, "; ".join(f"{x:.1f},{y:.1f}" for x, y in corners)


def failed(capsys, arguments):
    """The sentence on standard error of a call that must end with status 2."""
    try:
        status = main([str(argument) for argument in arguments])
    except SystemExit as stop:  # argparse leaves this way
        status = stop.code
    out, err = capsys.readouterr()
    assert status == 2
    assert out == ""
    assert "Traceback" not in err
    assert err.strip().splitlines()[-1].startswith(f"mmqa {arguments[0]}: ")
    return err


def test_image_prints_the_same_figures_however_it_finds_the_chart(photo, capsys, tmp_path):
    folder, corners = photo
    call = ["image", str(folder / "photo.png"), "--chart", str(folder / "own.csv"), "--json"]
    outputs = ["--csv", str(tmp_path / "o.csv"), "--figure", str(tmp_path / "f.png")]
    rows = []
    for more in (
        [],
        ["--corners", corners, "--patterns", str(tmp_path / "p.csv"), *outputs],
    ):
        assert main([*call, *more]) == 0
        rows += json.loads(capsys.readouterr().out)
    for row in rows:
        # 5 m at 1200 px are 4.17 mm, wider by the oblique view
        assert row["pixel_v_mm"] == pytest.approx(5 / 1.2 / np.cos(np.radians(10)), rel=0.01)
        assert (row["w_h_mm"], row["w_v_mm"]) == (24, 20)
        assert row["w_h_next_mm"] is None  # the ladder ends there
    assert rows[0]["px_per_40mm"] == pytest.approx(40 / rows[0]["pixel_v_mm"])
    assert rows[0]["expected_mark"] == "b to c"  # 9.45 pixels; b begins at 9.0
    assert rows[0]["located_by"] == "4 coded targets, aligned"
    assert len(pd.read_csv(tmp_path / "p.csv")) == 6
    assert len(pd.read_csv(tmp_path / "o.csv")) == 1
    assert (tmp_path / "f.png").read_bytes().startswith(b"\x89PNG")


def test_image_prints_a_table_for_people(photo, capsys):
    folder, corners = photo
    file = str(folder / "photo.png")
    assert main(["image", file, "--chart", str(folder / "own.csv"), "--corners", corners]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["figure", file]
    assert any(line.split()[:2] == ["w_h_mm", "24"] for line in lines)


def test_images_that_cannot_be_read_have_their_row(photo, capsys, tmp_path):
    folder, _ = photo
    (tmp_path / "words.png").write_text("no image")
    files = [str(tmp_path / "none.png"), str(folder / "photo.png"), str(tmp_path / "words.png")]
    assert main(["image", *files, "--chart", str(folder / "own.csv"), "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [row["file"] for row in rows] == [files[1], files[0], files[2]]
    assert rows[0]["w_h_mm"] == 24
    assert rows[1]["w_h_mm"] is None
    assert "no such file" in rows[1]["remark"]
    assert "Must be JPEG" in rows[2]["remark"]


def test_a_wrong_layout_is_doubted(photo, capsys, tmp_path):
    folder, corners = photo
    other = own_chart({"h": (33, 27, 21), "v": (26, 22)})
    (tmp_path / "other.csv").write_text(other.to_csv())
    call = ["image", str(folder / "photo.png"), "--chart", str(tmp_path / "other.csv")]
    assert main([*call, "--corners", corners, "--json"]) == 0
    remark = json.loads(capsys.readouterr().out)[0]["remark"]
    assert "line pairs are hidden or not those of the layout" in remark


IMAGE_FAULTS = {
    "no file": (["none.png"], "no such file"),
    "no image": (["own.csv", "--chart", "own.csv"], "Must be JPEG, PNG or TIFF"),
    "other chart": (["photo.png", "--corners", "0,9; 9,9; 9,0; 0,0"], "Must be"),
    "no chart file": (["photo.png", "--chart", "none.csv"], "No such file"),
    "no chart": (["photo.png", "--chart", "photo.png"], "Must be grey, black, revised or a .csv"),
    "three corners": (["photo.png", "--corners", "1,9; 9,9; 9,1"], "Must be 4"),
    "words": (["photo.png", "--corners", "a,b; c"], "Must be four times x,y"),
    "turned corners": (
        ["photo.png", "--corners", "1,1; 99,1; 99,99; 1,99"],
        "Must be four corners in order",
    ),
    "no panorama": (["photo.png", "--panorama"], "Must be 2 : 1"),
    "figure": (["photo.png", "--figure", "f.docx"], "Must be one of .pdf, .svg, .png"),
}


@pytest.mark.parametrize("fault", IMAGE_FAULTS)
def test_image_says_what_is_wrong_and_writes_nothing(photo, capsys, monkeypatch, fault):
    monkeypatch.chdir(photo[0])
    before = sorted(photo[0].iterdir())
    arguments, sentence = IMAGE_FAULTS[fault]
    outputs = ["--csv", "o.csv", "--patterns", "p.csv"]
    if "--figure" not in arguments:
        outputs += ["--figure", "f.png"]
    assert sentence in failed(capsys, ["image", *arguments, *outputs])
    assert sorted(photo[0].iterdir()) == before


@pytest.mark.parametrize("ending", ["pdf", "svg", "csv"])
def test_chart_writes_what_its_ending_says(capsys, tmp_path, ending):
    file = tmp_path / f"chart.{ending}"
    assert main(["chart", "--chart", "black", "--out", str(file), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["chart"] == "imaging chart, black bar"
    layout = charts.read_layout("black")
    written = {"pdf": layout.to_pdf, "svg": layout.to_svg, "csv": lambda: layout.to_csv().encode()}
    assert file.read_bytes() == written[ending]()


def test_an_edited_table_is_a_chart_of_ones_own(capsys, tmp_path):
    table = charts.imaging_chart().to_csv().replace("pairs_h_40,212", "pairs_h_40,222")
    (tmp_path / "own.csv").write_text(table)
    call = ["chart", "--chart", str(tmp_path / "own.csv"), "--out", str(tmp_path / "again.csv")]
    assert main(call) == 0
    assert (tmp_path / "again.csv").read_text() == table


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--out", "c.txt"], "Must be one of .pdf, .svg, .csv"),
        (["--out", "c.pdf", "--chart", "blue"], "Must be grey, black, revised or a .csv file"),
        (["--out", "c.pdf", "--points", "--seed", "-1"], "Invalid seed -1"),
    ],
)
def test_chart_says_what_is_wrong_and_writes_nothing(
    capsys, tmp_path, monkeypatch, arguments, sentence
):
    monkeypatch.chdir(tmp_path)
    assert sentence in failed(capsys, ["chart", *arguments])
    assert list(tmp_path.iterdir()) == []


def write_tender(folder, **columns):
    """Criteria and results as CSV and JSON."""
    criteria = pd.DataFrame(
        [("pixel", "pixel_mm", "<", 5.0), ("text", "legibility", "<=", "b")],
        columns=["criterion", "quantity", "relation", "threshold"],
    )
    results = pd.DataFrame(
        [
            ("A", "pixel_mm", 6.0, 0.1),
            ("A", "legibility", "c", None),
            ("B", "pixel_mm", 3.0, 0.1),
            ("B", "legibility", "a", None),
        ],
        columns=["system", "quantity", "value", "sigma"],
    ).assign(**columns)
    criteria.to_csv(folder / "c.csv", index=False)
    criteria.to_json(folder / "c.json", orient="records")
    results.to_csv(folder / "r.csv", index=False)
    results.to_json(folder / "r.json", orient="records")


@pytest.mark.parametrize("ending", ["csv", "json"])
def test_tender_reads_csv_and_json_alike(capsys, tmp_path, ending):
    write_tender(tmp_path)
    files = [str(tmp_path / f"c.{ending}"), str(tmp_path / f"r.{ending}")]
    assert main(["tender", *files, "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(row["system"], row["verdict"]) for row in rows] == [("A", "fails"), ("B", "qualifies")]
    assert main(["tender", *files, "--json", "--details"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [row["margin"] for row in rows] == [-1.0, -1.0, 2.0, 1.0]


def test_tender_status_says_whether_any_system_qualifies(capsys, tmp_path):
    assert main(["tender", "pfeifer2021:1", "pfeifer2021"]) == 1
    assert "qualifies" not in capsys.readouterr().out
    for results, count in {"pfeifer2021": 1, "pfeifer2021:pixels": 2}.items():
        assert main(["tender", "pfeifer2021:2", results]) == 0
        assert capsys.readouterr().out.count("qualifies") == count


def test_tender_exempts_f_for_the_density_asked_for(capsys, tmp_path):
    (tmp_path / "c.csv").write_text("criterion,quantity,relation,threshold\neven,f,<,2\n")
    call = ["tender", str(tmp_path / "c.csv"), "pfeifer2021", "--json"]
    assert main(call) == 1
    capsys.readouterr()
    assert main([*call, "--rho0", "3000"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(row["system"], row["exempt"]) for row in rows] == [("A", 0), ("B", 0), ("C", 2)]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["none.csv", "r.csv"], "no such file"),
        (["c.csv", "none.json"], "no such file"),
        (["r.csv", "r.csv"], "no column 'criterion'"),
        (["c.csv", "c.csv"], "no column 'system'"),
        (["words.json", "r.csv"], "Must be CSV or JSON"),
        (["object.json", "r.csv"], "no list of objects"),
        (["empty.csv", "r.csv"], "Must be rows of columns"),
        (["bytes.csv", "r.csv"], "Must be rows of columns"),
        (["pfeifer2021:3", "r.csv"], "no such file"),
    ],
)
def test_tender_says_what_is_wrong_and_writes_nothing(
    capsys, tmp_path, monkeypatch, arguments, sentence
):
    write_tender(tmp_path)
    (tmp_path / "words.json").write_text("no json")
    (tmp_path / "object.json").write_text('{"a": 1}')
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe\x00criterion")
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.iterdir())
    assert sentence in failed(capsys, ["tender", *arguments, "--csv", "o.csv"])
    assert sorted(tmp_path.iterdir()) == before
