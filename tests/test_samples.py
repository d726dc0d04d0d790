"""The clouds and pictures that come with the package."""

import hashlib

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
