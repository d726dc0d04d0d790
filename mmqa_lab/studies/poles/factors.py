"""One thing changed at a time: what it costs in recall and precision."""

from dataclasses import replace

import numpy as np
import xarray as xr

from mmqa_lab.poles import METHODS
from mmqa_lab.simulate import streets
from mmqa_lab.studies.poles import surveys

CHANGES = {
    "as it is": {},
    "no shrubs": {"shrub_share": 0.0},
    "shrubs at 80 %": {"shrub_share": 0.8},
    "no low crowns": {"low_crown_share": 0.0, "low_branch_share": 0.0},
    "low crowns at 60 %": {"low_crown_share": 0.6},
    "no undergrowth": {"thicket_share": 0.0},
    "no buildings": {"building_share": 0.0},
    "balconies at 80 %": {"balcony_share": 0.8, "building_share": 0.9},
    "12 cars per 100 m": {"cars_per_100m": 12.0},
    "5 people per 100 m": {"pedestrians_per_100m": 5.0},
}
"""Changes of the plan by name; all else, the places of all things included, stays."""


def sweep(names, *, plan, scanner, seeds, length, speed):
    """Return recall and precision at 30 m of each method under each change.

    Parameters
    ----------
    names : tuple of str
        Of ``CHANGES``; the unchanged street is always added.
    plan, scanner, seeds, length, speed
        As for :func:`mmqa_lab.studies.poles.compute`.

    Returns
    -------
    Dataset
        ``value``, ``low``, ``high`` over ``change``, ``method`` and ``quantity``.
    """
    names = ["as it is", *(name for name in names if name != "as it is")]
    shape = (len(names), len(METHODS), 2)
    data = {name: np.full(shape, np.nan) for name in ("value", "low", "high")}
    for i, name in enumerate(names):
        changed = replace(streets.PLANS[plan], **CHANGES[name])
        made = surveys.drive_all(changed, scanner, seeds, length=length, speed=speed)
        for survey in made:
            for method in METHODS:
                survey.detect(method)
        table = surveys.rates(made, corridors=(30.0,))
        table = table[table["class"] == "all"].set_index(["method", "quantity"])
        for j, method in enumerate(METHODS):
            for k, quantity in enumerate(("recall", "precision")):
                for column in data:
                    data[column][i, j, k] = table.loc[(method, quantity), column]
    dims = ("change", "method", "quantity")
    coords = {"change": names, "method": list(METHODS), "quantity": ["recall", "precision"]}
    dataset = xr.Dataset({name: (dims, values) for name, values in data.items()}, coords)
    for name in dataset:
        dataset[name].attrs["units"] = "1"
    return dataset


def fgi_thresholds(made, changes):
    """Return the rates of the scan-line method at 30 m with one threshold changed at a time.

    Parameters
    ----------
    made : list of Survey
    changes : dict of str to tuple
        Values of each field of :class:`mmqa_lab.poles.fgi.Settings`.

    Returns
    -------
    DataFrame
        As :func:`mmqa_lab.studies.poles.surveys.rates`, ``method`` = ``"default"`` or
        ``"<threshold> = <value>"``.
    """
    settings = {"default": {}}
    for name, values in changes.items():
        settings |= {f"{name} = {value:g}": {name: value} for value in values}
    for survey in made:
        for label, change in settings.items():
            survey.detect("fgi", name=label, **change)
    table = surveys.rates(made, corridors=(30.0,), names=list(settings))
    for survey in made:
        for label in settings:
            del survey.found[label]
    return table
