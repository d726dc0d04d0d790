"""The clouds and pictures that come with the package."""

import hashlib
import http.server
import re
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from mmqa_lab import io, samples


def test_samples_are_registered_with_hash_and_licence():
    present = {path.name for path in samples.FOLDER.iterdir() if path.suffix in (".laz", ".jpg")}
    assert present == {sample.file for sample in samples.SAMPLES.values()}
    readme = (samples.FOLDER / "README.md").read_text(encoding="utf-8")
    for sample in samples.SAMPLES.values():
        content = (samples.FOLDER / sample.file).read_bytes()
        assert hashlib.sha256(content).hexdigest() == sample.sha256
        assert sample.licence
        assert sample.sha256 in readme


def test_the_heads_of_the_road_patch_are_together_all_of_its_points_once():
    heads = samples.road_patch_heads()
    one, other, both = (heads[name] for name in ("head A", "head B", "both heads"))
    assert min(len(one), len(other)) > 1000
    for part in (one, other, both):
        assert len(np.unique(part, axis=0)) == len(part)
    assert {*map(tuple, one), *map(tuple, other)} == {*map(tuple, both)}
    whole = np.unique(io.read_cloud(samples.path("road_patch")).points, axis=0)
    assert len(whole) == len(both)


def test_real_files_are_looked_for_only_where_a_folder_is_named(monkeypatch, tmp_path):
    monkeypatch.delenv(samples.REAL_VARIABLE, raising=False)
    assert not samples.has_real("")
    monkeypatch.setenv(samples.REAL_VARIABLE, str(tmp_path))
    (tmp_path / "own.laz").touch()
    assert samples.has_real("own.laz")
    assert not samples.has_real("other.laz")


def test_an_unknown_sample_is_refused_with_the_names_that_there_are():
    with pytest.raises(ValueError, match=r"Must be one of .*road_patch"):
        samples.path("road")


@pytest.fixture
def host(monkeypatch, tmp_path):
    """A server of this machine for files of a folder, and what was asked of it."""
    asked = []

    class Handler(http.server.SimpleHTTPRequestHandler):
        """Serves the folder."""

        def __init__(self, *given):
            super().__init__(*given, directory=tmp_path / "served")

        def do_GET(self):
            """Send a file, or the first part of an answer."""
            if self.path != "/cut.xyz":
                super().do_GET()
                return
            self.protocol_version = "HTTP/1.1"
            self.send_response(200)
            self.send_header("Transfer-Encoding", "chunked")
            self.end_headers()
            self.wfile.write(b"5\r\n0 0 0\r\n")
            self.close_connection = True

        def log_message(self, *_):
            """Keep the path alone."""
            asked.append(self.path)

    (tmp_path / "served").mkdir()
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.handle_error = lambda *_: None  # as of an answer that nobody reads to its end
    threading.Thread(target=server.serve_forever, daemon=True).start()
    monkeypatch.setenv(samples.CACHE_VARIABLE, str(tmp_path / "cache"))
    address = f"http://127.0.0.1:{server.server_port}"
    yield SimpleNamespace(address=address, asked=asked, folder=tmp_path / "served")
    server.shutdown()


@pytest.fixture(params=["sha256:", "blob:"])
def wall(request, host, monkeypatch):
    """A public cloud on that server: its entry and its bytes."""
    content = b"0 0 0\n1 0 0\n0 0 1\n"
    (host.folder / "wall.xyz").write_bytes(content)
    known = {
        "sha256:": hashlib.sha256(content).hexdigest(),
        "blob:": "6c244224c3735af884f35068d486cd9e584ffe14",
    }
    one = SimpleNamespace(
        name="wall", url=f"{host.address}/wall.xyz", hash=request.param + known[request.param]
    )
    one.size = len(content) * (request.param == "sha256:")  # not known of the other
    monkeypatch.setitem(samples.PUBLIC, "wall", one)
    return SimpleNamespace(one=one, content=content)


def test_a_public_cloud_is_downloaded_once_and_again_if_it_is_damaged(host, wall):
    for _ in range(2):
        assert samples.fetch("wall").read_bytes() == wall.content
    assert len(host.asked) == 1
    samples.fetch("wall").write_bytes(b"damaged")
    assert samples.fetch("wall").read_bytes() == wall.content
    assert len(host.asked) == 2


@pytest.mark.parametrize(("folder", "expected"), [("", ".cache/mmqa_lab"), ("~/clouds", "clouds")])
def test_an_empty_folder_or_a_sign_for_home_is_not_the_current_folder(
    folder, expected, tmp_path, monkeypatch
):
    monkeypatch.setenv("MMQA_CACHE", folder)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    (tmp_path / expected).mkdir(parents=True)
    one = SimpleNamespace(
        name="x", url="https://a/b.ply", hash=f"sha256:{hashlib.sha256(b'ply').hexdigest()}"
    )
    (tmp_path / expected / "x.ply").write_bytes(b"ply")
    monkeypatch.setitem(samples.PUBLIC, "x", one)
    assert samples.fetch("x") == tmp_path / expected / "x.ply"


def test_a_fetched_cloud_is_real_data_without_a_network(host, wall):
    assert not samples.has_real("wall")
    with pytest.raises(FileNotFoundError, match=r"real cloud wall\. Must be fetched before"):
        samples.real_path("wall")
    assert host.asked == []  # nobody downloads by looking
    file = samples.fetch("wall")
    wall.one.url = "http://127.0.0.1:9/wall.xyz"
    assert samples.has_real("wall")
    assert samples.real_path("wall") == file == samples.fetch("wall")
    file.write_bytes(b"damaged")
    assert not samples.has_real("wall")


def test_another_file_under_the_address_is_refused_and_not_kept(host, wall, tmp_path):
    (host.folder / "wall.xyz").write_bytes(b"another")
    with pytest.raises(ValueError, match=r"Invalid public cloud wall: a file with (sha256|blob):"):
        samples.fetch("wall")
    assert not list((tmp_path / "cache").iterdir())


def test_what_another_process_has_just_fetched_stays(host, wall, monkeypatch):
    sound, target = samples._hash, samples._cached(wall.one)

    def late(file, wanted):
        found = sound(file, wanted)
        target.parent.mkdir(exist_ok=True)
        target.write_bytes(wall.content)  # by the other one, while this one looks
        return found

    monkeypatch.setattr(samples, "_hash", late)
    wall.one.url = "http://127.0.0.1:9/wall.xyz"
    with pytest.raises(OSError, match="wall"):
        samples.fetch("wall")
    assert target.read_bytes() == wall.content


def test_a_download_stops_at_the_stated_size(host, wall, tmp_path, monkeypatch):
    monkeypatch.setattr(samples, "LARGEST_BYTES", 18)
    (host.folder / "wall.xyz").write_bytes(bytes(5_000_000))
    written = []
    monkeypatch.setattr(samples, "_hash", lambda file, _: written.append(file.exists()) or "")
    with pytest.raises(ValueError, match=r"^Invalid public cloud wall: more than 18 bytes at"):
        samples.fetch("wall")
    assert written == [False]  # there was no whole file whose hash could be asked
    assert not list((tmp_path / "cache").iterdir())


def test_an_answer_that_is_cut_short_is_a_sentence_and_leaves_nothing(host, wall, tmp_path):
    wall.one.url = f"{host.address}/cut.xyz"
    with pytest.raises(OSError, match=r"^Invalid address .*: no answer, or one that was cut short"):
        samples.fetch("wall")
    assert not list((tmp_path / "cache").iterdir())


def test_no_network_is_a_sentence(wall):
    wall.one.url = "http://127.0.0.1:9/wall.xyz"
    with pytest.raises(OSError, match=r"Invalid address .*: no answer.*\. Must be reachable once"):
        samples.fetch("wall")
    with pytest.raises(ValueError, match="public cloud 'walls'"):
        samples.fetch("walls")


@pytest.mark.parametrize(("name", "file", "count"), [
    ("street_tree_a", "stem_121913_487434.las", 44_363),
    ("rotating_sweep", "velodyne_source.pcd", 106_825),
])  # fmt: skip
def test_the_bytes_that_were_published_are_taken(host, real, monkeypatch, name, file, count):
    one = samples.PUBLIC[name]
    (host.folder / file).write_bytes(real(f"public/{file}").read_bytes())
    monkeypatch.setattr(one, "url", f"{host.address}/{file}")
    assert samples.fetch(name).stat().st_size == one.size
    assert len(io.read_cloud(samples.real_path(name), columns=())) == count


def test_public_clouds_state_licence_hash_and_address():
    readme = (samples.FOLDER / "README.md").read_text(encoding="utf-8")
    for one in samples.PUBLIC.values():
        assert f"`{one.name}`" in readme
        assert one.doi in readme
        assert min(map(len, (one.licence, one.origin, one.contents))) > 2
        assert re.fullmatch("sha256:[0-9a-f]{64}|blob:[0-9a-f]{40}", one.hash)
        assert re.fullmatch(r"(10\.\d+/.+)?", one.doi)
        assert re.match("https://raw.githubusercontent.com/[^/]+/[^/]+/[0-9a-f]{40}/", one.url)
    assert len(samples.PUBLIC) >= 10
