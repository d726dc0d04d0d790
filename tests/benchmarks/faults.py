"""Commands that are killed at drawn moments: the next run gives what one without a fault gives.

``python tests/benchmarks/faults.py`` kills ``map``, ``student``, ``bench`` and ``studies``, or
those that are named, by TERM and KILL after a drawn share of the time that they take.
Then nothing is left running, no file is half written, and a second run ends well with equal files.
"""

import argparse
import hashlib
import json
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import psutil

MOMENTS = ("TERM", "KILL")

# Letters that differ from run to run: seconds, places, what says when, and names of cells
# and controls.
CHANGING = re.compile(
    rb"\d+\.\d+ s|\"seconds\": [\d.]+|/tmp/[^\s\"<]*|<dc:date>[^<]*|/CreationDate \([^)]*\)"
    rb"|\d{4}-\d\d-\d\dT[\d:.]+Z?|(\"id\": \"|cell-id=)[0-9a-f]{8}|[0-9a-f]{32}"
)


def orders(folder):
    """The commands by name, with the folder that each writes."""
    from mmqa_lab import io

    cloud = np.random.default_rng(1).random((60_000, 3)) * [40, 40, 0.01]
    for number in range(3):
        io.write_cloud(folder / f"{number}.laz", cloud + [40 * number, 0, 0])
    clouds = [str(folder / f"{number}.laz") for number in range(3)]
    return {
        "map": ["map", *clouds, "--out", "{}/m.nc"],
        "student": ["student", "{}/class", "mimic"],
        "bench": ["bench", "anisotropy", "--quick", "--workers", "2", "--out", "{}/bench"],
        "studies": ["studies", "mimic", "--quick", "--out", "{}/results"],
    }


def begun(words, place):
    """A command in a session of its own, whose words name a place."""
    words = [sys.executable, "-m", "mmqa_lab", *(word.format(place) for word in words)]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    return subprocess.Popen(words, start_new_session=True, **quiet)


def lasting(file):
    """The bytes of a file that stay from run to run."""
    data = file.read_bytes()
    if file.suffix == ".ipynb":  # controls are stored in any order
        notebook = json.loads(data)
        notebook["metadata"].pop("widgets", None)
        data = json.dumps(notebook).encode()
    return CHANGING.sub(b"", data)


def hashes(place):
    """What is in a place: names of files, and sums of what does not change from run to run."""
    return {
        str(file.relative_to(place)): hashlib.sha256(lasting(file)).digest()
        for file in sorted(place.rglob("*"))
        if file.is_file() and file.suffix != ".lock"
    }


def wrong(words, sound, seconds, how, place):
    """What is wrong after a fault: processes that live, files cut short, another second run."""
    run = begun(words, place)
    time.sleep(seconds)
    started = psutil.Process(run.pid).children(recursive=True) if run.poll() is None else []
    run.send_signal(getattr(signal, f"SIG{how}"))
    run.wait(120)
    found = []
    if psutil.wait_procs(started, timeout=30)[1]:
        found.append("a process lives on")
    for file in place.rglob("*.json") if place.exists() else ():
        if not file.name.startswith("."):
            json.loads(file.read_text("utf-8"))
    if begun(words, place).wait(600):
        found.append("the second run fails")
    again = hashes(place)
    return found + [f"{name} differs" for name in sound if again.get(name) != sound[name]]


def main():
    """Print a row for each command and signal."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--draws", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("commands", nargs="*", help="map, student, bench, studies")
    given = parser.parse_args()
    rng, bad = random.Random(given.seed), 0
    print("| command | signal | moments | wrong |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        made = orders(folder)
        for command in given.commands or made:
            words = made[command]
            sound, start = folder / f"{command}_sound", time.monotonic()
            sound.mkdir()
            assert begun(words, sound).wait() == 0
            whole, files = time.monotonic() - start, hashes(sound)
            for how in MOMENTS:
                found = []
                for number in range(given.draws):
                    place = folder / f"{command}_{how}_{number}"
                    place.mkdir()
                    found += wrong(words, files, rng.uniform(0.2, 1) * whole, how, place)
                print(
                    f"| {command} | {how} | {given.draws} | {'; '.join(found) or 0} |", flush=True
                )
                bad += len(found)
    return bool(bad)


if __name__ == "__main__":
    sys.exit(main())
