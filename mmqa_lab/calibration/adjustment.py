"""The least-squares problem: all points, all features, the mounting of all heads."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from mmqa_lab.calibration.features import OWN_PARAMETERS, Feature
from mmqa_lab.calibration.observations import POINT_COLUMNS, Sample
from mmqa_lab.calibration.search import OUTLIER
from mmqa_lab.planes import sigma_mad

PARAMETERS = ("roll_deg", "pitch_deg", "heading_deg", "x_m", "y_m", "z_m")
"""Of each head: boresight, then what is to be added to the assumed lever arm."""

BAD_FEATURE = 3.0
"""Features whose points lie so many times farther off than is usual for their kind are left out."""


@dataclass(eq=False)
class Adjustment:
    """The points of all features, and the least-squares problem."""

    sample: Sample
    features: list
    absolute: bool
    last: tuple = None

    @classmethod
    def of(cls, samples, features, drives, lever, origin, absolute):
        """Take the features' points out of the samples and find their poses."""
        index = np.concatenate([feature.index for feature in features])
        starts = np.cumsum([0] + [len(feature.index) for feature in features])
        points, time, head, drive = (samples[name][index] for name in POINT_COLUMNS)
        part = []
        order = np.argsort(drive, kind="stable")
        for number in range(len(drives)):
            of_drive = order[drive[order] == number]
            if len(of_drive):
                piece = Sample.of(points[of_drive], time[of_drive], head[of_drive])
                piece.locate(drives[number][1], lever, origin)
                part.append(piece)
        sample = Sample.joined(part)
        back = np.empty(len(order), dtype=int)
        back[order] = np.arange(len(order))
        features = [
            Feature(f.kind, back[first:last], f.start)
            for f, first, last in zip(features, starts[:-1], starts[1:], strict=True)
        ]
        return cls(sample, features, absolute)

    def system(self, parameters):
        """Misfit of all points and its derivatives, the features' own parameters eliminated."""
        if self.last is not None and np.array_equal(self.last[0], parameters):
            return self.last[1:]
        values = parameters.reshape(-1, len(PARAMETERS))
        points = self.sample.placed(values)
        used = np.concatenate([feature.index for feature in self.features])
        misfit, normal = np.zeros(len(points)), np.zeros_like(points)
        own = []
        for feature in self.features:
            r, n, derivative = feature.misfit(points[feature.index])
            misfit[feature.index], normal[feature.index] = r, n
            own.append(derivative)
        jacobian = np.zeros((len(points), parameters.size))
        columns = self.sample.head[:, None] * len(PARAMETERS) + np.arange(len(PARAMETERS))
        derivatives = self.sample.derivatives(values, normal)
        np.put_along_axis(jacobian, columns, derivatives, axis=1)
        for feature, derivative in zip(self.features, own, strict=True):
            basis = np.linalg.qr(derivative)[0]
            rows = jacobian[feature.index]
            jacobian[feature.index] = rows - basis @ (basis.T @ rows)
        misfit, jacobian = misfit[used], jacobian[used]
        if not self.absolute:
            level = np.zeros((1, parameters.size))
            level[0, 5 :: len(PARAMETERS)] = np.sqrt(len(points))
            misfit, jacobian = np.append(misfit, level @ parameters), np.vstack([jacobian, level])
        self.last = (parameters.copy(), misfit, jacobian)
        return misfit, jacobian

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
                xtol=1e-9,
                ftol=1e-9,
                max_nfev=20,
            )
            parameters = found.x
            good = self.good_features(found.fun)
            kept = [f for f, keep in zip(self.features, good, strict=True) if keep]
            if good.all():
                kept, trimmed = self.trimmed(found.fun)
                if trimmed < 0.001:
                    return found, parameters.reshape(values.shape)
            self.features = kept

    def trimmed(self, misfit):
        """Features without the points far off their own, and the share of those."""
        counts = np.cumsum([len(feature.index) for feature in self.features])
        kept = []
        for feature, part in zip(self.features, np.split(misfit, counts), strict=False):
            near = np.abs(part) <= OUTLIER * max(sigma_mad(part), 1e-6)
            kept.append(Feature(feature.kind, feature.index[near], feature.start))
        left = sum(len(feature.index) for feature in kept)
        return kept, 1 - left / counts[-1]

    def good_features(self, misfit):
        """Which features lie no farther off than is usual for their kind."""
        counts = np.cumsum([len(feature.index) for feature in self.features])[:-1]
        square = [np.mean(part**2) for part in np.split(misfit, counts)]
        table = pd.DataFrame({"kind": [f.kind for f in self.features], "rms": np.sqrt(square)})
        usual = table.groupby("kind")["rms"].transform("median")
        return (table["rms"] <= BAD_FEATURE * np.maximum(usual, 1e-6)).to_numpy()

    @property
    def own_parameters(self):
        """Number of parameters that were eliminated."""
        return sum(OWN_PARAMETERS[feature.kind] for feature in self.features)


def clustered_covariance(features, found):
    """Covariance from what each feature pulls at the estimates (cluster-robust sandwich)."""
    counts = np.cumsum([len(feature.index) for feature in features])
    starts = np.append(0, counts[:-1])
    pulls = np.add.reduceat((found.jac * found.fun[:, None])[: counts[-1]], starts)
    inverse = np.linalg.inv(found.jac.T @ found.jac)
    share = len(features) / max(len(features) - found.x.size, 1)
    return share * inverse @ (pulls.T @ pulls) @ inverse
