"""A whole study of edges: tables, truth, settings, report, and what is refused."""

import json

import numpy as np
import pandas as pd
import pytest

from mmqa_lab import lines
from mmqa_lab.__main__ import main
from mmqa_lab.cloud import Cloud
from mmqa_lab.io import read_segments, write_cloud, write_segments
from mmqa_lab.lines.comparisons import write_report
from mmqa_lab.simulate.canyon import canyon

COMPARED = [("C1", "C2"), ("C1", "C3"), ("C2", "C3"), ("C1", "TLS"), ("C2", "TLS"), ("C3", "TLS")]


@pytest.fixture(scope="module")
def scene():
    """A canyon with its surveys."""
    return canyon(1)


@pytest.fixture(scope="module")
def found(scene):
    """Three courses and the static scanner, with the truth."""
    sets = {name: one.segments for name, one in scene.surveys.items()}
    reference = sets.pop("TLS")
    truth = {names: scene.pairs(*names) for names in COMPARED}
    return lines.study(sets, reference=reference, truth=truth)


@pytest.fixture
def files(tmp_path, scene):
    """The sets and the truth as files."""
    for name, survey in scene.surveys.items():
        write_segments(tmp_path / f"{name}.csv", survey.segments)
    rows = [(*names, *cell) for names in COMPARED for cell in np.argwhere(scene.pairs(*names))]
    columns = ["test_set", "model_set", "test_segment", "model_segment"]
    pd.DataFrame(rows, columns=columns).to_csv(tmp_path / "truth.csv", index=False)
    return tmp_path


def test_the_tables_are_those_of_each_comparison(found, scene):
    frame = found.to_frame()
    assert frame["comparison"].tolist() == np.repeat(["-".join(c) for c in COMPARED], 2).tolist()
    assert frame["kind"].tolist() == ["repeatability"] * 6 + ["absolute"] * 6
    for k, (test, model) in enumerate(COMPARED):
        rows = frame.iloc[2 * k : 2 * k + 2]
        alone = lines.lhd(scene.surveys[test].segments, scene.surveys[model].segments)
        assert rows["olhd_m"].tolist() == [alone.test_model.olhd(10), alone.model_test.olhd(10)]
        assert rows.loc[rows["lhd"] == "*", "olhd_m"].item() == alone.value
        truth = scene.pairs(test, model)
        assert rows["false_positive"].iloc[0] == (alone.test_model.pairs & ~truth).sum()
        wrong = (alone.model_test.pairs != truth).mean()
        assert rows["rate_percent"].iloc[1] == pytest.approx(100 * (1 - wrong))


def test_a_distance_of_few_pairs_is_said(scene):
    near = scene.surveys["C1"].segments
    far = near.moved([0.0, 0.0, 1.5])  # most lines lose their partner, a few find another one
    with pytest.warns(UserWarning, match=r"The distance is that of \d+% of the length"):
        found = lines.study({"C1": near}, reference=far)
    frame = found.to_frame()
    assert frame["coverage"].min() < 0.5
    assert frame["olhd_m"].min() < 1.0  # though all lines are 1.5 m off


def test_every_pair_has_one_verdict(found, scene):
    verdicts = found.verdicts("C1", "TLS")["verdict"].value_counts()
    truth, pairs = scene.pairs("C1", "TLS"), found.results["C1", "TLS"].test_model.pairs
    assert verdicts["right"] == (truth & pairs).sum()
    assert verdicts["wrong"] == (pairs & ~truth).sum()
    assert verdicts["missed"] == (truth & ~pairs).sum()
    drawn = found.plot(test="C1", model="TLS").get_legend().get_texts()
    assert f"right ({verdicts['right']})" in [text.get_text() for text in drawn]


def test_without_truth_the_errors_are_unknown(scene):
    one = lines.study([scene.surveys[name].segments for name in ("C1", "C3")])
    assert one.to_frame()["false_negative"].isna().all()
    assert set(one.verdicts("C1", "C3")["verdict"]) == {"paired", "several partners"}


def room(shift=0.0):
    """A floor and two walls of 2.4 m that meet."""
    flat = np.random.default_rng(0).uniform(0, 5, (6000, 3))
    faces = np.repeat([[1, 1, 0], [1, 0, 0.48], [0, 1, 0.48]], 2000, axis=0)
    return flat * faces + shift


@pytest.mark.filterwarnings("ignore:a-b")
def test_settings_of_one_cloud_change_that_cloud_alone():
    clouds = {"a": room(), "b": room(0.05)}
    coarse = lines.study(clouds, settings={"b": {"size": 5.0}, "weight": 3})
    assert len(coarse.sets["a"]) == 3
    assert len(coarse.sets["b"]) == 2  # half of the size is longer than the upright edge
    assert coarse.results["a", "b"].weight == 3
    assert set(coarse.edges) == {"a", "b"}


def test_the_report_is_whole(found, tmp_path):
    write_report(found, tmp_path)
    page = (tmp_path / "index.html").read_text()
    assert page.count("<img") == 3
    assert '"C1-TLS": [[' in page
    matrix = pd.read_csv(tmp_path / "C1-C3_matrix_m.csv")
    result = found.results["C1", "C3"]
    np.testing.assert_allclose(matrix, lines.distance_matrix(result.test, result.model))
    assert len(read_segments(tmp_path / "TLS_edges.csv")) == len(found.sets["TLS"])
    assert len(pd.read_csv(tmp_path / "directions.csv")) == 12


def test_command_makes_the_study(files, capsys):
    words = [str(files / f"{name}.csv") for name in ("C1", "C2", "C3")]
    words += ["--reference", str(files / "TLS.csv"), "--truth", str(files / "truth.csv")]
    assert main(["lhd", *words, "--json", "--out", str(files / "report")]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert len(printed["directions"]) == 12
    assert printed["comparisons"][0]["comparison"] == "C1-C2"
    assert (files / "report" / "pairs.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ("C1,C9,0,0", "'C9' in row 1. Must be two of C1, C3"),
        ("C1,C3,0,0\nC1,C3,0,999", "segment 999 of C3 in row 2. Must be a whole number from 0 to"),
        ("C1,C3,-1,0", "segment -1 of C1"),
        ("C1,C3,0.5,0", "segment 0.5 of C1"),
        ("", "Invalid truth of 0 pairs. Must have one or more."),
    ],
)
def test_wrong_truth_is_refused_and_nothing_written(files, capsys, table, said):
    header = "test_set,model_set,test_segment,model_segment\n"
    (files / "bad.csv").write_text(header + table)
    words = [str(files / "C1.csv"), str(files / "C3.csv"), "--truth", str(files / "bad.csv")]
    assert main(["lhd", *words, "--out", str(files / "report")]) == 2
    assert said in capsys.readouterr().err
    assert not (files / "report").exists()


def test_what_cannot_be_compared_is_refused(tmp_path, capsys, rng):
    for name, points in {
        "here": room(),
        "there": room(5000.0),
        "near": room([40.0, 40.0, 20.0]),
        "few": rng.normal(0, 1, (100, 3)),
    }.items():
        write_cloud(tmp_path / f"{name}.laz", Cloud(points))
    (tmp_path / "bad.json").write_text('{"wieght": 3}')
    (tmp_path / "no.json").write_text("{")
    cases = {
        "there.laz": "Invalid here and there: no common edges, the nearest are",
        "near.laz": "no common edges",
        "few.laz": "few: no edges between planes",
        "here.laz --settings bad.json": "Invalid setting 'wieght'. Must be one of tolerance, size",
        "here.laz --settings no.json": "no.json. Must be a JSON file",
        "here.laz --truth none.csv": "none.csv: no such file",
    }
    for words, said in cases.items():
        names = [str(tmp_path / w) if "." in w else w for w in ["here.laz", *words.split()]]
        assert main(["lhd", *names, "--out", str(tmp_path / "report")]) == 2
        error = capsys.readouterr().err
        assert said in error
        assert error.count("Invalid") == 1
        assert not (tmp_path / "report").exists()


def test_lines_of_geojson_and_dxf(tmp_path, monkeypatch):
    chain = {"type": "LineString", "coordinates": [[0, 0, 0], [0, 0, 9], [8, 0, 9]]}
    flat = {"type": "MultiLineString", "coordinates": [[[1, 1], [4, 5]]]}
    features = [{"type": "Feature", "geometry": one} for one in (chain, flat)]
    node = {"type": "FeatureCollection", "features": features}
    (tmp_path / "edges.geojson").write_text(json.dumps(node))
    assert read_segments(tmp_path / "edges.geojson").lengths.tolist() == [9, 8, 5]
    (tmp_path / "bad.geojson").write_text('{"type": "LineString"}')
    with pytest.raises(ValueError, match="Must be GeoJSON with lines"):
        read_segments(tmp_path / "bad.geojson")
    monkeypatch.setitem(__import__("sys").modules, "ezdxf", None)
    (tmp_path / "edges.dxf").write_text("0\nEOF\n")
    with pytest.raises(ValueError, match="ezdxf is not installed"):
        read_segments(tmp_path / "edges.dxf")


def test_drawings_of_a_cad(tmp_path):
    """Blocks are resolved, polylines cut up, arcs and points left out; other units refused."""
    ezdxf = pytest.importorskip("ezdxf", reason="needs ezdxf, which reads DXF files")
    drawing = ezdxf.new()
    model, block = drawing.modelspace(), drawing.blocks.new("window")
    block.add_line((0, 0, 0), (1, 0, 0))
    model.add_blockref("window", (10, 0, 3), dxfattribs={"rotation": 90, "xscale": 2})
    model.add_polyline3d([(0, 0, 0), (0, 0, 5), (3, 0, 5), (3, 0, 5)])
    model.add_lwpolyline([(0, 0, 1), (4, 0, 0), (4, 7, 0)], format="xyb")  # an arc first
    drawing.saveas(tmp_path / "edges.dxf")
    found = read_segments(tmp_path / "edges.dxf")
    assert sorted(found.lengths.tolist()) == pytest.approx([2, 3, 5, 7])
    window = found.ends[found.lengths.round(6) == 2][0]
    assert window == pytest.approx(np.array([[10, 0, 3], [10, 2, 3]]))
    drawing.units = ezdxf.units.MM
    drawing.saveas(tmp_path / "edges.dxf")
    with pytest.raises(ValueError, match=r"in Millimeters \(\$INSUNITS\). Must be in metres"):
        read_segments(tmp_path / "edges.dxf")
