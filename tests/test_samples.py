"""The clouds and pictures that come with the package."""

import hashlib
import http.server
import io as streams
import re
import tarfile
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
    """A public cloud on a server of this machine: its entry, and the ranges that were asked for."""
    stream = streams.BytesIO()
    cloud = np.random.default_rng(0).uniform(0, 9, (20_000, 3)).astype("<f4").tobytes()
    with tarfile.open(fileobj=stream, mode="w:gz") as archive:
        entry = tarfile.TarInfo("a/wall.bin")
        entry.size = len(cloud)
        archive.addfile(entry, streams.BytesIO(cloud))
    whole, asked, cut = stream.getvalue(), [], []

    class Handler(http.server.BaseHTTPRequestHandler):
        """Answers with the rest of the archive, or with a half of it."""

        def do_GET(self):
            asked.append(self.headers.get("Range"))
            start = int((asked[-1] or "bytes=0-")[6:-1])
            self.send_response(416 if start >= len(whole) else 206 if start else 200)
            self.send_header("Content-Length", str(len(whole) - start))
            self.end_headers()
            self.wfile.write(whole[start:][: len(whole) // 2 if cut else None])

        def log_message(self, *_):
            """Say nothing."""

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    one = SimpleNamespace(
        name="wall",
        url=f"http://127.0.0.1:{server.server_port}/a.tar.gz",
        file="wall.bin",
        sha256=hashlib.sha256(cloud).hexdigest(),
        archive_sha256=hashlib.sha256(whole).hexdigest(),
        archive_size=len(whole),
    )
    monkeypatch.setitem(samples.PUBLIC, "wall", one)
    monkeypatch.setenv(samples.CACHE_VARIABLE, str(tmp_path / "cache"))
    yield SimpleNamespace(one=one, asked=asked, cut=cut, cloud=cloud, whole=whole)
    server.shutdown()


def test_a_public_cloud_is_downloaded_once_and_again_if_it_is_damaged(host, tmp_path):
    written = []
    for _ in range(3):
        assert samples.fetch("wall").read_bytes() == host.cloud
        written.append(samples.fetch("wall").stat().st_mtime_ns)
    assert len(set(written)) == 1  # a file with the right hash is not written again
    assert host.asked == [None]
    samples.fetch("wall").write_bytes(b"damaged")
    assert samples.fetch("wall").read_bytes() == host.cloud
    assert host.asked == [None]  # the archive is still there
    (archive,) = (tmp_path / "cache").glob("*.tar.gz")
    archive.write_bytes(host.whole[:-1])
    samples.fetch("wall").write_bytes(b"damaged")
    assert samples.fetch("wall").read_bytes() == host.cloud
    assert host.asked == [None, None]


def test_a_fetched_cloud_is_real_data_without_a_network(host):
    assert not samples.has_real("wall")
    with pytest.raises(FileNotFoundError, match=r"real cloud wall\. Must be fetched before"):
        samples.real_path("wall")
    assert host.asked == []  # nobody downloads by looking
    file = samples.fetch("wall")
    host.one.url = "http://127.0.0.1:9/none.tar.gz"
    assert samples.has_real("wall")
    assert samples.real_path("wall") == file == samples.fetch("wall")
    file.write_bytes(b"damaged")
    assert not samples.has_real("wall")


@pytest.mark.parametrize("share", [0.5, 1])
def test_an_interrupted_download_goes_on_from_where_it_stopped(host, share, tmp_path):
    host.cut.append(True)
    with pytest.raises(OSError, match=r"Invalid (download of wall|address)"):
        samples.fetch("wall")
    host.cut.clear()
    (part,) = (tmp_path / "cache").glob("*.part")
    part.write_bytes(host.whole[: int(share * len(host.whole))])
    assert samples.fetch("wall").read_bytes() == host.cloud
    later = [f"bytes={len(host.whole) // 2}-"] if share < 1 else []
    assert host.asked == [None, *later]


def test_another_file_under_the_address_is_refused_and_not_kept(host, tmp_path):
    host.one.archive_sha256 = "0" * 64
    with pytest.raises(ValueError, match="Invalid public cloud wall with SHA-256"):
        samples.fetch("wall")
    assert not [path for path in (tmp_path / "cache").iterdir() if path.is_file()]


def test_no_network_is_a_sentence(host):
    host.one.url = "http://127.0.0.1:9/none.tar.gz"
    with pytest.raises(OSError, match=r"Invalid address .*: no answer\. Must be reachable once"):
        samples.fetch("wall")
    with pytest.raises(ValueError, match="public cloud 'walls'"):
        samples.fetch("walls")


def test_public_clouds_state_licence_hash_and_size():
    readme = (samples.FOLDER / "README.md").read_text(encoding="utf-8")
    for one in samples.PUBLIC.values():
        assert f"`{one.name}`" in readme
        assert one.doi in readme
        assert min(map(len, (one.licence, one.origin, one.contents))) > 2
        assert re.fullmatch("[0-9a-f]{128}", one.sha256 + one.archive_sha256)
        assert re.fullmatch(r"(10\.\d+/.+)?", one.doi)
        assert one.url.startswith("https://")
        assert one.archive_size > 1000
    assert 3 <= len(samples.PUBLIC) <= 5
