"""Damaged files, read one by one in a process with limits: nothing dies, nothing hangs.

``python tests/benchmarks/fuzz.py`` makes 3,000 mutants of small files of every form that is read,
by kind and seed, and counts what becomes of each: read, refused by a sentence, other words, death
of the process, no answer. ``--count`` and ``--seed`` change how many and which, ``--first`` begins
in the middle of a long run, ``--only`` takes the files of some endings, and ``--unread`` draws
mutants of some endings without reading them (a file of a GIS takes a process of its own).
"""

import argparse
import collections
import contextlib
import io
import json
import os
import random
import resource
import select
import shutil
import struct
import subprocess
import sys
import tempfile
import warnings
import zipfile
from pathlib import Path

LIMIT_BYTES, LIMIT_S = 2 * 2**30, 20
KINDS = ("flip", "cut", "insert", "zero", "extreme", "swap", "word")
SHAPE = (".shp", ".shx", ".dbf", ".prj")
WORDS = (b"nan", b"-1", b"1e999", b"99999999999999999999", b"", b"\xff\xfe", b"(" * 300, b"\0")
WORDS += (b'"', b"<a>", b"&a;", b"[[[[", b"{}", b"2147483647", b"4294967295", b"inf", b"None")


def seeds(folder):
    """Small sound files of each form, by the reader that takes them."""
    import cv2
    import numpy as np
    import pandas as pd
    import pyproj
    import tifffile

    from mmqa_lab import io, samples
    from mmqa_lab.cloud import Cloud

    rng = np.random.default_rng(1)
    cloud = Cloud(
        rng.random((60, 3)) * 9, {"intensity": np.arange(60)}, crs=pyproj.CRS("EPSG:25832")
    )
    rows = "\n".join(" ".join(f"{one:.3f}" for one in row) for row in cloud.points)
    head = "ply\nformat {} 1.0\nelement vertex 60\n" + "".join(
        f"property float {name}\n" for name in "xyz"
    )
    ply = head.format("binary_little_endian") + "end_header\n"
    grey = rng.integers(0, 255, (24, 32), dtype=np.uint8)
    pages = folder / "page.tif"
    tifffile.imwrite(pages, grey, compression="zlib")
    dem = folder / "dem.tif"
    scale, tie = (33550, "d", 3, (1.0, 1.0, 0.0)), (33922, "d", 6, (0.0, 0, 0, 500.0, 600, 0))
    tifffile.imwrite(dem, grey.astype("f4"), extratags=[(*scale, True), (*tie, True)])
    for ending in (".las", ".laz"):
        io.write_cloud(folder / f"cloud{ending}", cloud)
    ring = [[0, 0, 1], [4, 0, 1], [4, 4, 1], [0, 4, 1], [0, 0, 1]]
    path = pd.DataFrame({"time": np.arange(9.0), "x": np.arange(9.0), "y": 0.0, "z": 2.0})
    segments = pd.DataFrame(rng.random((7, 6)), columns=[*"abcdef"])
    matrix = (
        '<{0} type_id="opencv-matrix"><rows>{1}</rows><cols>{2}</cols><dt>d</dt>'
        "<data>{3}</data></{0}>\n"
    )
    texts = {
        "cloud.xyz": rows,
        "cloud.csv": "x,y,z,name\n" + rows.replace(" ", ",").replace("\n", ",a\n"),
        "cloud.pts": f"60\n{rows}",
        "text.ply": head.format("ascii") + f"end_header\n{rows}\n",
        "ring.geojson": json.dumps({"type": "Polygon", "coordinates": [ring]}),
        "path.csv": path.to_csv(index=False),
        "segments.csv": segments.to_csv(index=False, header=False),
        "table.csv": "criterion,quantity,threshold\nd,density_per_m2,3000\nw,w_mm,20.5\n",
        "camera.yaml": "image_width: 640\nimage_height: 480\ncamera_matrix: {rows: 3, cols: 3, "
        "data: [500, 0, 320, 0, 500, 240, 0, 0, 1]}\ndistortion_coefficients: {rows: 1, cols: 5, "
        "data: [0.1, 0, 0, 0, 0]}\n",
        "camera.xml": '<?xml version="1.0"?>\n<opencv_storage>\n<image_width>640</image_width>\n'
        "<image_height>480</image_height>\n"
        + matrix.format("camera_matrix", 3, 3, "500. 0. 320. 0. 500. 240. 0. 0. 1.")
        + matrix.format("distortion_coefficients", 1, 5, "0.1 0. 0. 0. 0.")
        + "</opencv_storage>\n",
    }
    for name, text in texts.items():
        (folder / name).write_text(text)
    (folder / "binary.ply").write_bytes(ply.encode() + cloud.points.astype("<f4").tobytes())
    for ending in (".png", ".jpg"):
        cv2.imwrite(str(folder / f"grey{ending}"), grey)
    copc = samples.path("chart_b_5m")
    (folder / "tree.copc.laz").write_bytes(copc.read_bytes()) if copc.exists() else None
    of_libraries(folder, cloud, np.array(ring) + [500_000, 5_400_000, 100])
    readers = {"ring": "polygon", "path": "trajectory", "segments": "segments", "table": "table"}
    readers |= {"camera": "camera", "page": "image", "grey": "image", "dem": "heights"}
    return {
        file: readers.get(file.name.split(".")[0], "cloud") for file in sorted(folder.iterdir())
    }


def of_libraries(folder, cloud, ring):
    """Small files of the forms that come with the extra ``files``: scans, outlines, a workbook."""
    import numpy as np
    import pandas as pd
    import pye57
    import pyogrio
    import pypcd4
    import shapely

    names = ("cartesianX", "cartesianY", "cartesianZ", "intensity")
    columns = [*cloud.points.T, np.arange(60.0)]
    file = pye57.E57(str(folder / "scans.e57"), mode="w")
    for _ in range(2):
        pose = {"rotation": np.array([1.0, 0, 0, 0]), "translation": np.array([1.0, 2, 3])}
        file.write_scan_raw(dict(zip(names, columns, strict=True)), **pose)
    file.close()
    packed = [column.astype(np.float32) for column in columns]
    made = pypcd4.PointCloud.from_points(packed, (*"xyz", "intensity"), [np.float32] * 4)
    for form in ("ascii", "binary", "binary_compressed"):
        made.save(folder / f"{form}.pcd", encoding=pypcd4.Encoding(form))
    head = "6\n10\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n9 9 9 1\n"
    rows = "\n".join(" ".join(f"{one:.4f}" for one in row) for row in np.stack(columns, axis=1))
    (folder / "scans.ptx").write_text(f"{head}{rows}\n{head}{rows}\n")
    records = np.zeros((9, 17))
    records[:, 0], records[:, 1:3], records[:, 3] = np.arange(9), np.radians([48.7, 9.1]), 300
    records[:, 1] += 1e-6 * np.arange(9)
    (folder / "path.sbet").write_bytes(records.astype("<f8").tobytes())
    shapes, name = np.array([shapely.to_wkb(shapely.Polygon(ring))]), [np.array(["a"], object)]
    for ending in (".gpkg", ".shp"):
        layout = {"geometry_type": "Polygon Z", "crs": "EPSG:25832"}
        pyogrio.raw.write(folder / f"ring{ending}", shapes, name, ["name"], **layout)
    (folder / "ring.cpg").unlink()
    degrees = " ".join(
        f"{9 + x / 1e5},{48 + y / 1e5},{z}" for x, y, z in ring - ring[0] + [0, 0, 5]
    )
    (folder / "ring.kml").write_text(
        '<kml xmlns="http://www.opengis.net/kml/2.2"><Document><Placemark><name>a</name><Polygon>'
        f"<outerBoundaryIs><LinearRing><coordinates>{degrees}</coordinates></LinearRing>"
        "</outerBoundaryIs></Polygon></Placemark></Document></kml>"
    )
    body = "".join(f"0\nVERTEX\n8\nA\n10\n{x}\n20\n{y}\n30\n{z}\n70\n32\n" for x, y, z in ring)
    line = f"0\nPOLYLINE\n8\nA\n66\n1\n70\n9\n{body}0\nSEQEND"
    (folder / "ring.dxf").write_text(f"0\nSECTION\n2\nENTITIES\n{line}\n0\nENDSEC\n0\nEOF\n")
    rows = {"criterion": ["d", "w"], "quantity": ["density_per_m2", "w_mm"], "threshold": [3, 20.5]}
    pd.DataFrame(rows).to_excel(folder / "table.xlsx", index=False)


def damaged(name, data, kind, rng):
    """A damaged copy of a file, half of them with sums and parts that agree again."""
    sealed = rng.random() < 0.5
    if name.endswith(".xlsx") and sealed:
        return zipped(data, kind, rng)
    if name.endswith(".e57") and sealed:
        plain = b"".join(data[at : at + 1020] for at in range(0, len(data), 1024))
        plain = mutant(plain, kind, rng)
        pages = [plain[at : at + 1020].ljust(1020, b"\0") for at in range(0, len(plain), 1020)]
        return b"".join(page + struct.pack(">I", castagnoli(page)) for page in pages)
    return mutant(data, kind, rng)


def zipped(data, kind, rng):
    """A workbook of which one part is damaged and packed again."""
    made = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(made, "w") as new:
        broken = rng.choice(old.namelist())
        for name in old.namelist():
            part = old.read(name)
            new.writestr(name, mutant(part, kind, rng) if name == broken else part)
    return made.getvalue()


def castagnoli(page):
    """The sum of a page of E57, CRC-32C."""
    rest = 2**32 - 1
    for byte in page:
        rest ^= byte
        for _ in range(8):
            rest = rest >> 1 ^ 0x82F63B78 * (rest & 1)
    return rest ^ 2**32 - 1


def mutant(data, kind, rng):
    """A damaged copy of bytes."""
    data, at = bytearray(data), rng.randrange(max(1, len(data)))
    if rng.random() < 0.5:  # heads say what follows
        at = rng.randrange(max(1, min(400, len(data))))
    if kind == "flip":
        for _ in range(rng.choice((1, 1, 4, 30))):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    elif kind == "cut":
        del data[at:]
    elif kind == "insert":
        data[at:at] = bytes(rng.randrange(256) for _ in range(rng.choice((1, 7, 500))))
    elif kind == "zero":
        data[at : at + 200] = bytes(len(data[at : at + 200]))
    elif kind == "extreme":
        code, value = rng.choice(
            (("<I", 2**32 - 1), ("<I", 2**31 - 1), ("<I", 2**24), ("<H", 65535))
        )
        new = (
            struct.pack(code, value)
            if rng.random() < 0.7
            else struct.pack("<d", rng.choice((1e308, -0.0)))
        )
        data[at : at + len(new)] = new
    elif kind == "swap":
        to = rng.randrange(len(data))
        data[at : at + 40], data[to : to + 40] = data[to : to + 40], data[at : at + 40]
    else:
        parts = bytes(data).split(rng.choice((b" ", b",", b"\n", b":")))
        parts[rng.randrange(len(parts))] = rng.choice(WORDS)
        data = (
            bytearray(rng.choice((b" ", b",", b"\n")).join(parts))
            if len(parts) < 2
            else bytearray(b",".join(parts) if b"," in data else b" ".join(parts))
        )
    return bytes(data)


def read_lines():
    """A worker: read each file that is named on standard input, and say what became of it."""
    import pyproj

    from mmqa_lab import io

    zone = pyproj.CRS("EPSG:25832")
    used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (used + LIMIT_BYTES,) * 2)
    warnings.simplefilter("ignore")
    readers = {
        "cloud": lambda path: io.read_cloud(path),
        "polygon": lambda path: io.read_outlines(path, crs=zone if path.suffix == ".kml" else None),
        "trajectory": lambda path: io.read_trajectory(path, crs=zone),
        "segments": io.read_segments,
        "table": lambda path: io.read_table(path, "criteria"),
        "camera": io.read_camera,
        "image": io.read_image,
        "heights": io.read_heights,
    }
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print is no answer
    for line in sys.stdin:
        reader, path = line.rstrip("\n").split(" ", 1)
        try:
            readers[reader](Path(path))
            found = "read"
        except Exception as error:
            sentence = str(error).startswith(("Invalid ", "Missing "))
            found = "refused" if sentence else f"other words: {type(error).__name__}: {error}"
        answers.write(" ".join(found.split())[:200] + "\n")
        answers.flush()


class Worker:
    """A process that reads files; a new one takes the place of one that died or hangs."""

    def __init__(self):
        self.child = None

    def outcome(self, reader, path):
        """What became of a file."""
        if self.child is None or self.child.poll() is not None:
            command = [sys.executable, __file__, "--worker"]
            pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
            self.child = subprocess.Popen(command, stderr=subprocess.DEVNULL, **pipes)
            self.ask("table", path, 120)  # it imports
        return self.ask(reader, path, LIMIT_S)

    def ask(self, reader, path, seconds):
        with contextlib.suppress(BrokenPipeError):
            self.child.stdin.write(f"{reader} {path}\n")
            self.child.stdin.flush()
            if not select.select([self.child.stdout], [], [], seconds)[0]:
                self.child.kill()
                self.child.wait()
                return "no answer"
            if answer := self.child.stdout.readline().strip():
                return answer
        return f"death {self.child.wait()}"

    def close(self):
        if self.child is not None:
            self.child.stdin.close()
            self.child.wait()


def fuzz(count, seed, keep=None, left_out=(), first=0, only=None, unread=()):
    """Rows (file, kind, number, outcome) of mutants, drawn over files and kinds."""
    rng, worker = random.Random(seed), Worker()
    with tempfile.TemporaryDirectory() as name:
        sound, folder = Path(name) / "sound", Path(name) / "mutants"
        sound.mkdir()
        folder.mkdir()
        files = {
            file: one
            for file, one in seeds(sound).items()
            if file.suffix not in left_out and (only is None or file.suffix in only)
        }
        for file in files:
            read = file.with_suffix(".shp") if file.suffix in SHAPE else file
            yield file.name, "sound", -1, worker.outcome(files[file], read)
        for number in range(count):
            file = [*files][number % len(files)]
            kind = KINDS[number // len(files) % len(KINDS)]
            changed = folder / f"{number}_{file.name}"
            changes = damaged(file.name, file.read_bytes(), kind, rng)
            if number < first or file.suffix in unread:
                continue
            beside = SHAPE if file.suffix in SHAPE else ()  # four files are one
            for ending in beside:
                shutil.copy(file.with_suffix(ending), changed.with_suffix(ending))
            changed.write_bytes(changes)
            read = changed.with_suffix(".shp") if beside else changed
            outcome = worker.outcome(files[file], read)
            for part in (changed, *map(changed.with_suffix, beside)):
                if keep and not outcome.startswith(("read", "refused")):
                    keep.mkdir(exist_ok=True)
                    shutil.copy(part, keep / part.name)
            for part in folder.iterdir():
                part.unlink()
            yield file.name, kind, number, outcome
    worker.close()


def main():
    """Print counts by form, and each mutant that is neither read nor refused."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--count", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", nargs="+")
    parser.add_argument("--unread", nargs="+", default=())
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--worker", action="store_true")
    given = parser.parse_args()
    if given.worker:
        return read_lines()
    counts, bad = collections.defaultdict(collections.Counter), []
    drawn = {"first": given.first, "only": given.only, "unread": given.unread}
    for name, kind, number, outcome in fuzz(given.count, given.seed, given.keep, **drawn):
        if kind == "sound":
            continue
        counts[name][outcome.split(":")[0].split(" -")[0]] += 1
        if not outcome.startswith(("read", "refused")):
            bad.append(f"{number} {name} {kind}: {outcome}")
            print(bad[-1], flush=True)
    columns = ("read", "refused", "other words", "death", "no answer")
    print("| form |", " | ".join(columns), "|\n|---|" + "---|" * len(columns))
    for name, row in [
        *sorted(counts.items()),
        ("all", sum(counts.values(), collections.Counter())),
    ]:
        print(f"| {name} |", " | ".join(str(row[column]) for column in columns), "|")
    return bool(bad)


if __name__ == "__main__":
    sys.exit(main())
