"""How long studies take on this machine, from their stored runs and a small piece of work."""

import time
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

__all__ = ["TIMES", "machine_speed", "stored_seconds"]

TIMES = "times.csv"
"""Beside the notebooks: the seconds of each study's stored run."""

# Time of the work below where the stored runs were made, beside other work on the same cores, s.
REFERENCE_S = 2.2


def machine_speed():
    """Return how many times as long this machine takes for a fixed work as that of the stored runs.

    Returns
    -------
    float
        Above 1 on a slower machine.
    """
    points = np.random.default_rng(0).random((100_000, 3))
    began = time.process_time()
    for _ in range(3):
        cKDTree(points).query(points, k=4)
        np.linalg.eigvalsh(np.einsum("ni,nj->nij", points, points))
    return (time.process_time() - began) / REFERENCE_S


def stored_seconds(notebooks):
    """Return the seconds of the stored runs by study; empty where nothing is stored.

    Parameters
    ----------
    notebooks : path
        Folder of the notebooks.
    """
    file = Path(notebooks) / TIMES
    return dict(pd.read_csv(file).to_numpy()) if file.is_file() else {}
