"""Measure how long the polygon tool takes from a moved vertex to the finished picture.

Evaluation, histograms and drawing of a cloud of 30,000 points, warm, median and slowest of the
repeats, as a person waits for it, and the processor time, which a busy machine leaves alone. The
promise is 0.3 s.

    python tests/benchmarks/selection.py --points 30000
"""

import argparse
import time

import numpy as np

from mmqa_lab import plots
from mmqa_lab.widgets.selection import SelectionTool

PROMISE_S = 0.3


def wall(count):
    """A wall of 2 m x 1.5 m with 3 mm noise."""
    rng = np.random.default_rng(1)
    return rng.random((count, 3)) * [2, 0, 1.5] + [0, 1, 0] * rng.normal(0, 0.003, (count, 1))


def updates(count, repeats):
    """Seconds of each update: evaluated, drawn, and the processor's for both."""
    tool = SelectionTool(wall(count))
    tool.canvas.draw()
    seconds = []
    for k in range(repeats):
        vertices = tool.vertices.copy()
        vertices[k % 4] += 0.01 * (vertices[(k + 2) % 4] - vertices[k % 4])
        began, busy = time.perf_counter(), time.process_time()
        tool.select(vertices)
        evaluated = time.perf_counter()
        tool.canvas.draw()
        ended = time.perf_counter()
        seconds.append((evaluated - began, ended - evaluated, time.process_time() - busy))
    return np.array(seconds)


def main():
    """Print one line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=30_000)
    parser.add_argument("--repeats", type=int, default=20)
    options = parser.parse_args()
    with plots.style():
        seconds = updates(options.points, options.repeats)[1:]
    total = seconds[:, :2].sum(axis=1)
    evaluated, drawn, busy = np.median(seconds, axis=0)
    print(
        f"{options.points} points: {np.median(total):.3f} s (evaluated {evaluated:.3f}, drawn "
        f"{drawn:.3f}), slowest {total.max():.3f}; processor {busy:.3f}; promised {PROMISE_S} s"
    )


if __name__ == "__main__":
    main()
