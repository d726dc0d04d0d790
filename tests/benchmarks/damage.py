"""Damaged LAS and LAZ files: no crash, no hang, and no number where damage can be seen.

``python tests/benchmarks/damage.py 1000000`` makes so many damaged copies of six small files, reads
each in a child process, and writes what came of it into the README. A run that was stopped goes on
where it was; ``--state`` is the file that it keeps. A child that works for 20 s on one case is a
hang, a child that dies a crash; the next child begins with the case after it.

Bits of a point are the one kind of damage that nothing in the format shows: LAS and LAZ have no
check sums. It is seen only where a coordinate leaves the box of the header or a packet no longer
unpacks.
"""

import argparse
import contextlib
import json
import multiprocessing
import os
import resource
import tempfile
import warnings
from pathlib import Path

os.environ |= {"RAYON_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

import laspy
import numpy as np
import pandas as pd
import psutil
import pyproj

from mmqa_lab.io import read_cloud, write_atomically
from mmqa_lab.run.pages import replaced

ROOT = Path(__file__).resolve().parents[2]

BATCH = 50_000
PATIENCE_S = 20.0
MEMORY = 6 * 2**30
"""Cases of a child; its processor time without progress that is a hang; bytes of its memory."""

POINTS = 40

NEAR_M = 0.002
"""Coordinates this near to the sound ones, two steps of theirs, count as unchanged."""

KINDS = (
    # name, version, point format, CRS; more of those that are read fast
    *6 * (("plain.las", "1.2", 3, None), ("extended.las", "1.4", 6, None)),
    ("system.las", "1.4", 6, "EPSG:25832"),
    ("plain.laz", "1.2", 1, None),
    ("extended.laz", "1.4", 7, None),
)

FIELDS = {
    "signature and version": ((0, 4), (24, 1), (25, 1)),
    "sizes, counts, format": ((94, 2), (96, 4), (100, 4), (104, 1), (105, 2), (107, 4)),
    "extended counts": ((235, 8), (243, 4), (247, 8)),
    "scales and offsets": tuple((131 + 8 * k, 8) for k in range(6)),
    "box": tuple((179 + 8 * k, 8) for k in range(6)),
    "other header bytes": ((4, 20), (26, 68), (111, 20), (227, 8), (255, 120)),
}
"""First byte and length of the fields of a header, by what they are (LAS 1.4 R15, table 3)."""

REGIONS = (*FIELDS, "records after the header", "points", "cut, inserted or zeroed anywhere")
SHARES = (0.05, 0.22, 0.1, 0.1, 0.06, 0.05, 0.14, 0.16, 0.12)

OUTCOMES = ("refused", "doubt", "unchanged", "other column", "wrong", "exception", "crash", "hang")


def sound_files(folder):
    """Write the files that are to be damaged."""
    rng = np.random.default_rng(1)
    for name, version, kind, crs in dict.fromkeys(KINDS):
        header = laspy.LasHeader(version=version, point_format=kind)
        header.scales, header.offsets = np.full(3, 0.001), np.array([5e5, 5.4e6, 100.0])
        if crs:
            header.add_crs(pyproj.CRS(crs))
        if version == "1.4":
            header.add_extra_dim(laspy.ExtraBytesParams("range", "float32"))
        las = laspy.LasData(header)
        las.xyz = rng.uniform(0, 30, (POINTS, 3)) + header.offsets
        las.gps_time = np.sort(rng.uniform(0, 10, POINTS))
        las.intensity = rng.integers(0, 65_535, POINTS)
        las.return_number = np.ones(POINTS, int)
        las.write(str(folder / name))


def damaged(whole, seed, points_at):
    """Damaged bytes of a file, and where the damage is."""
    rng = np.random.default_rng(seed)
    region = rng.choice(REGIONS, p=SHARES)
    content = bytearray(whole)
    header_size = int.from_bytes(whole[94:96], "little")
    if region == REGIONS[-1]:
        return _cut(content, rng), region
    if region in FIELDS:
        inside = [field for field in FIELDS[region] if sum(field) <= header_size]
        if not inside:  # a file of version 1.2 has no extended counts
            region = "sizes, counts, format"
            inside = FIELDS[region]
        first, length = inside[rng.integers(len(inside))]
    elif region == "points":
        first, length = points_at, len(whole) - points_at
    else:
        first, length = header_size, points_at - header_size
    if length:
        _spoil(content, first, length, rng)
    return bytes(content), region


def _spoil(content, first, length, rng):
    """Change bits or bytes of a part of a file."""
    place = first + int(rng.integers(length))
    kind = rng.integers(4)
    if kind == 0:
        content[place] ^= 1 << int(rng.integers(8))
    elif kind == 1:
        content[place] = int(rng.integers(256))
    elif kind == 2:
        size = min(int(rng.integers(1, 9)), first + length - place)
        content[place : place + size] = rng.bytes(size)
    else:
        size = min(8, length)
        value = (0, 1, 255, 2**15 - 1, 2**31 - 1, 2**32 - 1, 2**63 - 1, 2**64 - 1)[rng.integers(8)]
        content[first : first + size] = (value % 256**size).to_bytes(size, "little")


def _cut(content, rng):
    """A file cut short, with bytes inserted, left out or zeroed."""
    kind, place = rng.integers(4), int(rng.integers(len(content)))
    size = int(rng.integers(1, 200))
    if kind == 0:
        return bytes(content[:place])
    if kind == 1:
        return bytes(content[:place] + rng.bytes(size) + content[place:])
    if kind == 2:
        return bytes(content[:place] + content[place + size :])
    content[place : place + size] = bytes(len(content[place : place + size]))
    return bytes(content)


def outcome(path, sound):
    """What comes of reading a damaged file, beside the sound one."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            cloud = read_cloud(path)
        except (ValueError, MemoryError) as error:
            return "refused" if str(error).startswith("Invalid") else "exception"
        except Exception:
            return "exception"
    if said:
        return "doubt"
    if len(cloud) != len(sound) or np.abs(cloud.points - sound.points).max() > NEAR_M:
        return "wrong"
    same = cloud.columns.keys() == sound.columns.keys() and all(
        np.array_equal(cloud[name], sound[name], equal_nan=True) for name in sound.columns
    )
    return "unchanged" if same and cloud.crs == sound.crs else "other column"


def batch(folder, first, last, now, counts):
    """Read the cases from first to last, in a child process; count outcomes as it goes on."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    names = dict.fromkeys(name for name, *_ in KINDS)
    whole = {name: (folder / name).read_bytes() for name in names}
    sound = {name: read_cloud(folder / name) for name in names}
    for seed in range(first, last):
        now.value = seed
        name = KINDS[seed % len(KINDS)][0]
        points_at = int.from_bytes(whole[name][96:100], "little")
        content, region = damaged(whole[name], seed, points_at)
        if content == whole[name]:
            result = "unchanged"
        else:
            path = folder / f"damaged{Path(name).suffix}"
            path.write_bytes(content)
            result = outcome(path, sound[name])
        counts[_place(name, region, result)] += 1
    now.value = last


def _place(name, region, result):
    """Where an outcome is counted."""
    row = REGIONS.index(region) + len(REGIONS) * name.endswith(".laz")
    return row * len(OUTCOMES) + OUTCOMES.index(result)


def guarded(folder, first, last):
    """Counts of the outcomes of a batch, and the case after the last one that was read."""
    context = multiprocessing.get_context("spawn")
    now = context.Value("q", first - 1, lock=False)  # not begun
    counts = context.Array("q", 2 * len(REGIONS) * len(OUTCOMES), lock=False)
    child = context.Process(target=batch, args=(folder, first, last, now, counts))
    child.start()
    seen, since, hung = None, np.inf, False
    while child.is_alive() and not hung:
        child.join(0.5)
        with contextlib.suppress(psutil.Error):  # it has just ended
            used = sum(psutil.Process(child.pid).cpu_times()[:2])
            if now.value != seen:
                seen, since = now.value, used
            hung = now.value >= first and used - since > PATIENCE_S
    if hung:
        child.kill()
        child.join()
    counts = np.array(counts[:])
    if now.value == last and child.exitcode == 0:
        return counts, last
    seed = max(now.value, first)
    name = KINDS[seed % len(KINDS)][0]
    whole = (folder / name).read_bytes()
    _, region = damaged(whole, seed, int.from_bytes(whole[96:100], "little"))
    word = "hang" if hung else "crash"
    print(f"case {seed}: {word} ({name}, {region}, exit {child.exitcode})", flush=True)
    counts[_place(name, region, word)] += 1
    return counts, seed + 1


def table(counts):
    """A row for each kind of file and place of the damage."""
    counts = np.reshape(counts, (2, len(REGIONS), len(OUTCOMES)))
    rows = []
    for ending, part in zip(("LAS", "LAZ"), counts, strict=True):
        for region, found in zip(REGIONS, part, strict=True):
            row = dict(zip(OUTCOMES, found.tolist(), strict=True))
            ended = {"crash or hang": row.pop("crash") + row.pop("hang")}
            rows.append({"file": ending, "damage": region, "cases": int(found.sum())} | row | ended)
    frame = pd.DataFrame(rows)
    whole = frame.drop(columns=["file", "damage"]).sum()
    last = pd.DataFrame([{"file": "all", "damage": ""} | whole.to_dict()])
    return pd.concat([frame, last], ignore_index=True)


def main():
    """Run what is still missing, and write the table into the README."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", type=int, nargs="?", default=1_000_000)
    state = ROOT / "notebooks" / "results" / "damage.json"
    parser.add_argument("--state", type=Path, default=state, help="what a stopped run goes on from")
    parser.add_argument("--no-readme", action="store_true", help="print the table only")
    options = parser.parse_args()
    done, counts = 0, np.zeros(2 * len(REGIONS) * len(OUTCOMES), dtype=int)
    if options.state.is_file():
        kept = json.loads(options.state.read_text())
        done, counts = kept["done"], np.array(kept["counts"])
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as name:
        folder = Path(name)
        sound_files(folder)
        while done < options.cases:
            found, done = guarded(folder, done, min(done + BATCH, options.cases))
            counts = counts + found
            kept = json.dumps({"done": done, "counts": counts.tolist()})
            write_atomically(options.state, lambda path, kept=kept: path.write_text(kept))
            print(f"{done} cases", flush=True)
    frame = table(counts)
    print(frame.to_string(index=False))
    if not options.no_readme:
        readme = ROOT / "README.md"
        text = replaced(
            readme.read_text(encoding="utf-8"), "damage", frame.to_markdown(index=False)
        )
        write_atomically(readme, lambda path: path.write_text(text, encoding="utf-8"))


if __name__ == "__main__":
    main()
