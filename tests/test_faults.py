"""Full disks, killed workers, two writers, damaged state, closed streams: nothing is lost."""

import json
import os
import random
import re
import resource
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pyproj
import pytest
import xarray as xr
from numba.core.caching import IndexDataCacheFile

from mmqa_lab import io, maps, samples, views
from mmqa_lab._checks.words import BEGINNINGS
from mmqa_lab._compiled import _can_write
from mmqa_lab._results import printed
from mmqa_lab.commands.laboratory import _write_bench
from mmqa_lab.commands.machine import FIGURE_ENDINGS, write_figure
from mmqa_lab.io import write_atomically
from mmqa_lab.run.students import write_student_notebooks
from mmqa_lab.studies import chosen

ROOT = Path(__file__).parents[1]
PATCH = str(samples.path("road_patch"))
WRITER = """
import sys
from mmqa_lab.io import write_atomically
for number in range(40):
    write_atomically(sys.argv[1], sys.argv[2] * 20_000)
"""


def mmqa(*words, **choices):
    """A command in a process of its own."""
    command = [sys.executable, "-m", "mmqa_lab", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, **choices)


# Writing


def test_threads_and_processes_that_write_one_file_leave_a_whole_one(tmp_path):
    file = tmp_path / "f.txt"
    others = [subprocess.Popen([sys.executable, "-c", WRITER, file, word]) for word in "ab"]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda word: write_atomically(file, word * 20_000), "cdefghij" * 20))
    assert [one.wait() for one in others] == [0, 0]
    text = file.read_text()
    assert len(text) == 20_000
    assert len(set(text)) == 1
    assert [one.name for one in tmp_path.iterdir()] == ["f.txt"]


def test_a_link_under_a_temporary_name_is_not_followed(tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("mine")
    for name in (f".t.{os.getpid()}.csv", ".t.csv"):
        (tmp_path / name).symlink_to(victim)
    write_atomically(tmp_path / "t.csv", "theirs")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / ".mmqa_lab").symlink_to(tmp_path / "elsewhere")
    with pytest.raises((OSError, ValueError), match=r"^Invalid folder"):  # noqa: SIM117
        with io.own_folder(tmp_path / "folder"):
            pass
    assert victim.read_text() == "mine"
    assert not (tmp_path / "elsewhere").exists()


def test_the_mode_of_a_file_that_is_replaced_stays(tmp_path):
    file = tmp_path / "f.csv"
    file.write_text("a\n1\n")
    file.chmod(0o600)
    write_atomically(file, pd.DataFrame({"a": [2]}))
    assert stat.S_IMODE(file.stat().st_mode) == 0o600


@pytest.fixture
def small_disk(tmp_path, monkeypatch):
    """A disk of 64 kB; where none may be mounted, files of so many bytes."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=64k", "none", folder]
    if shutil.which("mount") and not subprocess.run(command, capture_output=True).returncode:
        yield folder
        subprocess.run(["umount", folder], check=True)
        return
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (65_536, before[1]))
    yield folder
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def written_outputs():
    """Each kind of output: the name of a file, and what writes it with more than 64 kB."""
    rng = np.random.default_rng(1)
    table, cloud = pd.DataFrame({"a": rng.random(30_000)}), rng.random((30_000, 3))
    grid, zone = rng.random((200, 200)), pyproj.CRS("EPSG:25832")
    ring = np.column_stack([*rng.random((2, 9000)), np.zeros(9000)])
    ring = ring[np.argsort(np.arctan2(*(ring[:, :2] - 0.5).T))]
    dataset = xr.Dataset({"a": (("y", "x"), grid)}, {"x": np.arange(200.0), "y": np.arange(200.0)})
    place = {"corner": (0, 9), "cell": 1.0, "crs": zone}

    def draw():
        """A figure of many bytes in each form."""
        axes = plt.figure(figsize=(9, 9)).add_subplot()
        axes.plot(*rng.random((2, 40_000)), ",")
        return axes.figure

    return {
        **{f"f{end}": partial(io.write_cloud, cloud=cloud) for end in (".las", ".laz")},
        **{f"f{end}": partial(write_figure, draw=draw) for end in FIGURE_ENDINGS},
        "f.csv": partial(write_atomically, write=table),
        "f.html": partial(write_atomically, write="x" * 90_000),
        "f.tif": partial(io.write_raster, bands={"a": grid}, **place),
        "f.nc": partial(write_atomically, write=partial(dataset.to_netcdf, engine="scipy")),
        "f.json": partial(io.write_polygon, vertices=ring),
        "f.gpkg": partial(io.write_outlines, outlines={"a": ring}, crs=zone),
        "f.npy": partial(write_atomically, write=cloud.tofile),
    }


@pytest.mark.parametrize("name", written_outputs())
def test_a_full_disk_keeps_the_former_file_and_is_said_with_its_path(small_disk, name):
    write, file = written_outputs()[name], small_disk / name
    head = BEGINNINGS.get(file.suffix, b"")
    former = (head[0] if isinstance(head, tuple) else head) + b" former\n"
    file.write_bytes(former)
    with pytest.raises(OSError, match=rf"^Invalid file .*{name}: .*\. Must be writable\.$"):
        write(file)
    assert file.read_bytes() == former
    assert [one.name for one in small_disk.iterdir()] == [name]


# Workers and state


TOY = """
from mmqa_lab.run import Run
import pandas as pd
run = Run("toy", parameters=globals())
run.save_table(pd.DataFrame({"a": range(9)}), "first", kind="measured")
run.save_value("f", 3.257, "1", "predicted")
run.finish()
"""


def mapped(place):
    """A map of four tiles, and its file."""
    folder = maps.map_campaign([place.parent / "a.las"], place, cell=1.0, tile=4)
    maps.write_map(place / "m.nc", maps.open_map(folder))


def copied(place):
    """The copies of two notebooks for a class."""
    write_student_notebooks(place, chosen(["mimic", "repeatability"]))


def benched(place):
    """The tables and figures of a bench."""
    draw = partial(plt.figure, figsize=(2, 2))
    with io.own_folder(place):
        _write_bench(place, {"cells": pd.DataFrame({"a": np.arange(99.0)})}, draw)


def studied(place):
    """The tables, values and record of a study."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MMQA_RESULTS", str(place))
        exec(TOY, {})


TEMPORARY = re.compile(r"\.[0-9a-f]{16}\.\w+$")


def lasting(file):
    """The bytes of a file, but for its date."""
    return re.sub(rb"<dc:date>[^<]*|/CreationDate \([^)]*\)", b"", Path(file).read_bytes())


def files_in(place):
    """What is in a folder, other than what a writer that was ended left behind."""
    files = [one for one in place.rglob("*") if one.is_file() and one.name[0] != "."]
    return {str(one.relative_to(place)): lasting(one) for one in files}


def ended_at(moment, how, work, place):
    """Work in a process of its own, which a signal ends as it finishes its n-th file."""
    if (child := os.fork()) == 0:
        signal.alarm(60)  # no test waits for ever
        left = iter(range(moment))
        os.fsync = lambda _: next(left, None) is None and os.kill(os.getpid(), how)
        try:
            work(place)
        finally:
            os._exit(0)
    return os.WTERMSIG(os.waitpid(child, 0)[1])


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
@pytest.mark.parametrize("work", [mapped, copied, benched, studied])
def test_work_that_is_ended_at_any_file_is_whole_after_a_second_run(tmp_path, work, how):
    cloud = np.random.default_rng(1).random((3000, 3)) * [8, 8, 0.01]
    io.write_cloud(tmp_path / "a.las", cloud)  # LAZ has threads, which a fork loses
    written = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda file: written.append(lasting(file.name)))
        work(tmp_path / "sound")
    sound, rng = files_in(tmp_path / "sound"), random.Random(1)
    for moment in sorted(rng.sample(range(len(written)), min(2, len(written)))):
        place = tmp_path / f"ended_{moment}"
        assert ended_at(moment, how, work, place) == how
        assert {*files_in(place).values()} <= {*written}  # none is half a file
        assert [one for one in place.rglob(".*.*") if TEMPORARY.search(one.name)]  # beside it
        work(place)
        assert files_in(place) == sound


def test_workers_end_with_their_parent(tmp_path):
    code = (
        "import sys, time; from concurrent.futures import ProcessPoolExecutor as Pool\n"
        "from multiprocessing import get_context; from mmqa_lab._compiled import end_with_parent\n"
        "import os\n"
        "if __name__ == '__main__':\n"
        "    pool = Pool(1, get_context('spawn'), end_with_parent)\n"
        "    print(pool.submit(os.getpid).result(), flush=True); pool.submit(time.sleep, 60)\n"
        "    time.sleep(60)\n"
    )
    (tmp_path / "parent.py").write_text(code)
    command = [sys.executable, str(tmp_path / "parent.py")]
    parent = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    worker = int(parent.stdout.readline())
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    for _ in range(50):
        if not Path(f"/proc/{worker}").exists():
            return
        state = Path(f"/proc/{worker}/stat").read_text().split()[2]
        if state == "Z":  # ended, and nobody asks for its status
            return
        time.sleep(0.1)
    pytest.fail("the worker lives on")


def test_a_damaged_tile_and_a_damaged_record_count_as_missing(tmp_path):
    rng = np.random.default_rng(1)
    io.write_cloud(tmp_path / "a.las", rng.random((3000, 3)) * [8, 8, 0.01])
    folder = tmp_path / "map"
    made = {"cell": 1.0, "tile": 4}
    whole = maps.open_map(maps.map_campaign([tmp_path / "a.las"], folder, **made))
    own = folder / "mmqa_map"
    for damaged in (sorted(own.glob("tile_*.npy"))[0], own / "run.json"):
        damaged.write_bytes(b"")
        again = maps.open_map(maps.map_campaign([tmp_path / "a.las"], folder, **made))
        assert whole.equals(again)
    assert json.loads((own / "run.json").read_text())


def test_students_copies_are_written_again_unless_somebody_worked_on_them(tmp_path):
    (target,) = write_student_notebooks(tmp_path, chosen(["mimic"]))
    first = target.read_bytes()
    write_student_notebooks(tmp_path, chosen(["mimic"]))
    assert target.read_bytes() == first
    target.write_bytes(first.replace(b"metadata", b"metadata ", 1))
    with pytest.raises(ValueError, match="may be a student's work"):
        write_student_notebooks(tmp_path, chosen(["mimic"]))


def test_compiled_code_of_an_older_source_is_never_run(tmp_path, monkeypatch):
    def of(adds):
        """The result of 1 with a source that adds so much, as a new process has it."""
        source = f"from mmqa_lab._compiled import njit\n@njit()\ndef f(x):\n    return x + {adds}\n"
        (tmp_path / "kernel.py").write_text(source)
        known = spec_from_file_location("kernel", tmp_path / "kernel.py")
        module = module_from_spec(known)
        known.loader.exec_module(module)
        return module.f(1)

    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    assert of(1) == 2
    with monkeypatch.context() as stopped:  # between the list of code and the code
        stopped.setattr(IndexDataCacheFile, "_save_data", lambda *_: None)
        assert of(100) == 101
    assert of(100) == 101


def test_compiled_code_is_not_kept_where_nothing_can_be_written(tmp_path):
    assert _can_write(tmp_path / "made")
    assert not _can_write(Path("/proc/none"))


READ_ONLY = """
import sys
import mmqa_lab.lines
from mmqa_lab._compiled import njit
from mmqa_lab.commands import run
assert njit()(lambda x: x + 1)(1) == 2
sys.exit(run(["info", sys.argv[1]]))
"""


def test_a_package_and_a_home_that_are_read_only_do_their_work():
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copytree(ROOT / "mmqa_lab", folder / "mmqa_lab", ignore=lambda *_: ["__pycache__"])
        (folder / "home").mkdir()
        shutil.copy(PATCH, folder / "a.laz")
        for one in (folder, *folder.rglob("*")):
            one.chmod(0o555 if one.is_dir() else 0o444)
        # nothing is read only to root, unless it has no capabilities
        bound = ["setpriv", "--bounding-set=-all", "--inh-caps=-all"] * (os.geteuid() == 0)
        places = {"HOME": str(folder / "home"), "PYTHONPATH": name, "XDG_CACHE_HOME": ""}
        command = [*bound, sys.executable, "-c", READ_ONLY, str(folder / "a.laz")]
        choices = {"capture_output": True, "text": True, "timeout": 120, "cwd": folder}
        done = subprocess.run(command, env=os.environ | places, **choices)
        left = {one for one in folder.rglob("*") if "__pycache__" in one.name}
        for one in (folder, *folder.rglob("*")):
            one.chmod(0o755)
    assert done.returncode == 0, done.stderr
    assert "28185" in done.stdout
    assert not left


# Other people's folders


def test_the_probe_of_a_screen_imports_nothing_from_the_current_folder(monkeypatch):
    monkeypatch.setenv(views.WINDOW_VARIABLE, "")
    monkeypatch.setattr(views, "PROBE", "import sys; sys.exit('' in sys.path)")
    views.can_render.cache_clear()
    assert views.can_render()
    views.can_render.cache_clear()


def test_names_stand_in_a_table_as_they_were_read(tmp_path):
    """What a spreadsheet program makes of them is said in SECURITY.md."""
    write_atomically(tmp_path / "t.csv", pd.DataFrame({"file": ["=1+1"]}))
    assert (tmp_path / "t.csv").read_text() == "file\n=1+1\n"


# Streams


def test_closed_streams_change_no_status_and_no_output(tmp_path):
    csv = tmp_path / "rows.csv"
    closed = f"{sys.executable} -m mmqa_lab info {PATCH} --csv {csv} 2>&- >/dev/null"
    assert subprocess.run(closed, shell=True, timeout=120).returncode == 0
    assert len(pd.read_csv(csv)) == 1
    piped = f"{sys.executable} -m mmqa_lab --help | head -c 5 >/dev/null; exit ${{PIPESTATUS[0]}}"
    assert subprocess.run(["bash", "-c", piped], timeout=120).returncode == 0


def test_a_method_that_ends_the_process_is_refused(tmp_path):
    (tmp_path / "ends.py").write_text("raise SystemExit(3)\n")
    done = mmqa("bench", "anisotropy", "--method", "ends:f", "--quick", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("mmqa bench: Invalid method 'ends:f': SystemExit")


def test_coordinates_keep_their_millimetres_in_every_printed_form():
    table = pd.DataFrame({"name": "a", "x_m": [452123.4567], "centre": 5411.2347, "f": 3.21987})
    assert printed(table).loc[0].tolist() == ["a", "452123.457", "5411.235", "3.22"]
