"""From clouds to edges to the distance, on a canyon whose faces and displacements are known."""

import time
import warnings

import numpy as np
import pandas as pd

from mmqa_lab import lines
from mmqa_lab.lines import extract_edges
from mmqa_lab.simulate.canyon import canyon
from mmqa_lab.simulate.canyon_cloud import canyon_cloud, canyon_edges

SAME_M, SAME_DEG = 0.1, 2.0
"""An extracted edge shows a true one when it is as near and as parallel as this."""

CHI2_2 = 5.9915
"""95 % quantile of chi-squared with two degrees of freedom."""


def extraction(*, seed, density, noise, tolerance=0.04, size=2.0, minimum=150):
    """Extract the edges of a static survey's cloud and compare them with the true ones.

    Returns
    -------
    DataFrame
        One row: ``n_points``, ``seconds`` of the extraction, ``n_edges``, ``n_true`` edges of
        facades, ``n_found`` of them, ``error_median_mm`` and ``error_95_mm`` across the edge at
        its ends, ``sigma_median_mm``, ``cover_95`` of the stated covariance.
    """
    scene = canyon(seed)
    cloud = canyon_cloud(scene, "TLS", density=density, noise=noise, seed=seed)
    began = time.perf_counter()
    sizes = {"tolerance": tolerance, "size": size, "minimum": minimum}
    found = extract_edges(cloud.points, **sizes)
    seconds = time.perf_counter() - began
    true = canyon_edges(scene)
    rows, columns = _shown(found.segments, true)
    errors = _across(found.segments.ends[rows], true.midpoints[columns], true.directions[columns])
    inverse = np.linalg.pinv(found.covariance[rows], rcond=1e-6, hermitian=True)
    squares = np.einsum("nkd,nkde,nke->nk", errors, inverse, errors)
    millimetres = 1000 * np.linalg.norm(errors, axis=2)
    return pd.DataFrame(
        {
            "n_points": [len(cloud)],
            "seconds": seconds,
            "n_edges": len(found),
            "n_true": len(true),
            "n_found": len(np.unique(columns)),
            "error_median_mm": np.median(millimetres),
            "error_95_mm": np.percentile(millimetres, 95),
            "sigma_median_mm": 1000 * np.median(found.sigma[rows]),
            "cover_95": (squares <= CHI2_2).mean(),
        }
    )


def chain(*, seeds, density, noise, tolerance=0.06, size=2.0, minimum=100):
    """Clouds of a course and of the static survey, their edges, and the displacement between them.

    Returns
    -------
    DataFrame
        A row for each seed, comparison and matcher: ``n_test`` and ``n_model`` edges, ``pairs``,
        ``lhd_m``, ``perpendicular_m``, ``true_m`` (mean length of the true displacement at the
        paired edges), ``vector_error_m``, ``sigma_m``.
    """
    rows = []
    sizes = {"tolerance": tolerance, "size": size, "minimum": minimum}
    for seed in seeds:
        scene = canyon(seed)
        found = {}
        for name in ("C1", "C2", "TLS"):
            cloud = canyon_cloud(scene, name, density=density, noise=noise, seed=seed)
            found[name] = extract_edges(cloud.points, **sizes).segments
        for names in (("C1", "TLS"), ("C2", "TLS"), ("C1", "C2")):
            for matcher in ("all", "displaced"):
                rows.append({"seed": seed, **_compared(scene, names, found, matcher)})
    return pd.DataFrame(rows)


def _compared(scene, names, found, matcher):
    """One comparison of extracted edges with what is true at the pairs."""
    test, model = (found[name] for name in names)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # few pairs: the column "pairs" says so
        result = lines.lhd(test, model, matcher=matcher)
    paired = np.nonzero(result.test_model.pairs)[0]
    true = _true_displacements(scene, names, test.midpoints[paired])
    error = result.displacement.vector - true.mean(axis=0)
    return {
        "comparison": "-".join(names),
        "matcher": result.matcher,
        "n_test": len(test),
        "n_model": len(model),
        "pairs": len(paired),
        "lhd_m": result.value,
        "perpendicular_m": result.perpendicular_only,
        "true_m": np.linalg.norm(true, axis=1).mean(),
        "vector_error_m": np.linalg.norm(error),
        "sigma_m": np.sqrt(np.trace(result.displacement.covariance)),
    }


def _true_displacements(scene, names, places):
    """Displacement of test from model at places (n, 3), by the street of the nearest true edge."""
    true = canyon_edges(scene)
    streets = np.repeat(scene.buildings["street"].to_numpy(), 4)
    apart = np.linalg.norm(places[:, None] - true.midpoints[None], axis=2)
    street = streets[apart.argmin(axis=1)]
    test, model = (scene.surveys[name].positioning.at(places, street) for name in names)
    return test - model


def _shown(found, true):
    """Extracted edges that show a true one, and which."""
    parts = lines.components(found, true)
    shorter = np.minimum(found.lengths[:, None], true.lengths)
    parallel = parts.angle < np.sin(np.radians(SAME_DEG)) * shorter
    near = parallel & (parts.perpendicular < SAME_M) & (parts.parallel < SAME_M)
    rows = np.flatnonzero(near.any(axis=1))
    return rows, np.where(near[rows], parts.perpendicular[rows], np.inf).argmin(axis=1)


def _across(ends, origins, axes):
    """Offsets (n, 2, 3) of ends across the lines through origins along axes."""
    offsets = ends - origins[:, None]
    along = np.einsum("nkd,nd->nk", offsets, axes)
    return offsets - along[..., None] * axes[:, None]
