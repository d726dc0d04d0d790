"""Commands that are killed at drawn moments: the next run gives what one without a fault gives.

``python tests/benchmarks/faults.py`` kills ``map``, ``student`` and ``bench``, and with
``--studies`` also ``studies``, by TERM and KILL after a drawn share of the time that they take.
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

# Letters that differ from run to run: seconds, places, and what says when.
CHANGING = re.compile(
    rb"\d+\.\d+ s|\"seconds\": [\d.]+|/tmp/[^\s\"<]*|<dc:date>[^<]*|/CreationDate \([^)]*\)"
)


def orders(folder, studies=False):
    """The commands by name, with the folder that each writes."""
    from mmqa_lab import io

    cloud = np.random.default_rng(1).random((60_000, 3)) * [40, 40, 0.01]
    for number in range(3):
        io.write_cloud(folder / f"{number}.laz", cloud + [40 * number, 0, 0])
    clouds = [str(folder / f"{number}.laz") for number in range(3)]
    made = {
        "map": ["map", *clouds, "--out", "{}/m.nc"],
        "student": ["student", "{}/class", "mimic"],
        "bench": ["bench", "anisotropy", "--quick", "--workers", "2", "--out", "{}/bench"],
    }
    if studies:
        made["studies"] = ["studies", "mimic", "--quick", "--out", "{}/results"]
    return made


def begun(words, place):
    """A command in a session of its own, whose words name a place."""
    words = [sys.executable, "-m", "mmqa_lab", *(word.format(place) for word in words)]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    return subprocess.Popen(words, start_new_session=True, **quiet)


def hashes(place):
    """What is in a place: names of files, and sums of what does not change from run to run."""
    return {
        str(file.relative_to(place)): hashlib.sha256(CHANGING.sub(b"", file.read_bytes())).digest()
        for file in sorted(place.rglob("*"))
        if file.is_file() and file.suffix not in (".lock", ".html")
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
    parser.add_argument("--studies", action="store_true")
    given = parser.parse_args()
    rng, bad = random.Random(given.seed), 0
    print("| command | signal | moments | wrong |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for command, words in orders(folder, given.studies).items():
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
