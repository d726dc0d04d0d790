"""The least-squares problem: all points, all features, the mounting of all heads."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from mmqa_lab.boresight.features import OWN_PARAMETERS, Feature, measured
from mmqa_lab.boresight.observations import POINT_COLUMNS, Sample
from mmqa_lab.boresight.search import OUTLIER
from mmqa_lab.planes import sigma_mad

PARAMETERS = ("roll_deg", "pitch_deg", "heading_deg", "x_m", "y_m", "z_m")
"""Of each head: boresight, then what is to be added to the assumed lever arm."""

BAD_FEATURE = 3.0
"""Features whose points lie so many times farther off than is usual for their kind are left out."""

STEADY = 0.001
"""Share of points left out below which the adjustment ends."""


@dataclass(eq=False)
class Adjustment:
    """The points of all features, one feature after the other, and the least-squares problem."""

    sample: Sample
    features: list
    absolute: bool
    last: tuple = None

    @classmethod
    def of(cls, samples, features, drives, lever, origin, absolute):
        """Take the features' points out of the samples and find their poses."""
        index = np.concatenate([feature.index for feature in features])
        points, time, head, drive = (samples[name][index] for name in POINT_COLUMNS)
        order = np.argsort(drive, kind="stable")
        parts = []
        for number in np.unique(drive):
            of_drive = order[drive[order] == number]
            part = Sample.of(points[of_drive], time[of_drive], head[of_drive])
            part.locate(drives[number][1], lever, origin)
            parts.append(part)
        return cls(Sample.joined(parts).select(np.argsort(order)), features, absolute)

    @property
    def counts(self):
        """Points of each feature."""
        return np.array([len(feature) for feature in self.features])

    def system(self, parameters):
        """Misfit of all points and its derivatives, the features' own parameters eliminated."""
        if self.last is not None and np.array_equal(self.last[0], parameters):
            return self.last[1:]
        values = parameters.reshape(-1, len(PARAMETERS))
        misfit, normal, basis = measured(self.features, self.sample.placed(values))
        jacobian = np.zeros((len(misfit), parameters.size))
        columns = self.sample.head[:, None] * len(PARAMETERS) + np.arange(len(PARAMETERS))
        derivatives = self.sample.derivatives(values, normal)
        np.put_along_axis(jacobian, columns, derivatives, axis=1)
        planes = sum(feature.kind == "plane" for feature in self.features)
        for number, column in enumerate(basis.T):
            # the first columns are all that planes, which come first, have
            self._eliminate(jacobian, column, first=0 if number < 3 else planes)
        if not self.absolute:
            level = np.zeros((1, parameters.size))
            level[0, 5 :: len(PARAMETERS)] = np.sqrt(len(misfit))
            misfit, jacobian = np.append(misfit, level @ parameters), np.vstack([jacobian, level])
        self.last = (parameters.copy(), misfit, jacobian)
        return misfit, jacobian

    def _eliminate(self, jacobian, column, first):
        """Take a column of unit length in each feature out of the rows from a feature on."""
        counts = self.counts[first:]
        rows = slice(self.counts[:first].sum(), None)
        column = column[rows, None]
        if len(counts):
            share = np.add.reduceat(column * jacobian[rows], np.cumsum(counts) - counts)
            jacobian[rows] -= column * np.repeat(share, counts, axis=0)

    def solved(self, values):
        """The scipy result, and the estimates (heads, 6); bad features leave on the way."""
        from scipy.optimize import least_squares

        parameters = values.ravel()
        while True:
            self.last = None
            found = least_squares(
                lambda p: self.system(p)[0],
                parameters,
                jac=lambda p: self.system(p)[1],
                x_scale="jac",
                xtol=1e-7,
                ftol=1e-7,
                max_nfev=20,
            )
            parameters = found.x
            by_feature = np.split(found.fun[: self.counts.sum()], np.cumsum(self.counts)[:-1])
            good = self._usual(by_feature)
            near = [_near(part) & keep for part, keep in zip(by_feature, good, strict=True)]
            if good.all() and np.concatenate(near).mean() > 1 - STEADY:
                return found, parameters.reshape(values.shape)
            self._keep(near)

    def _usual(self, by_feature):
        """Which features lie no farther off than is usual for their kind."""
        rms = [np.sqrt(np.mean(part**2)) for part in by_feature]
        table = pd.DataFrame({"kind": [f.kind for f in self.features], "rms": rms})
        usual = table.groupby("kind")["rms"].transform("median")
        return (table["rms"] <= BAD_FEATURE * np.maximum(usual, 1e-6)).to_numpy()

    def _keep(self, near):
        """Leave out points, and features of which none is left."""
        self.sample = self.sample.select(np.concatenate(near))
        self.features = [
            Feature(feature.kind, feature.index[inside], feature.start)
            for feature, inside in zip(self.features, near, strict=True)
            if inside.any()
        ]

    @property
    def own_parameters(self):
        """Number of parameters that were eliminated."""
        return sum(OWN_PARAMETERS[feature.kind] for feature in self.features)


def _near(misfit):
    """Which points lie near their own feature."""
    return np.abs(misfit) <= OUTLIER * max(sigma_mad(misfit), 1e-6)


def clustered_covariance(features, found):
    """Covariance from what each feature pulls at the estimates (cluster-robust sandwich)."""
    ends = np.cumsum([len(feature) for feature in features])
    pulls = np.add.reduceat((found.jac * found.fun[:, None])[: ends[-1]], np.append(0, ends[:-1]))
    inverse = np.linalg.inv(found.jac.T @ found.jac)
    share = len(features) / max(len(features) - found.x.size, 1)
    return share * inverse @ (pulls.T @ pulls) @ inverse
