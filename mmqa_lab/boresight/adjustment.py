"""The adjustment of a mounting: points placed by it, and the least squares of their misfits."""

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.optimize import least_squares, nnls

from mmqa_lab.boresight.features import COMMON, OWN_PARAMETERS, measured, near_own
from mmqa_lab.planes import CONSISTENT_SCALE, sigma_mad
from mmqa_lab.scan_pattern import rotations

PARAMETERS = ("roll_deg", "pitch_deg", "heading_deg", "x_m", "y_m", "z_m")
"""Of each head: boresight, then what is to be added to the assumed lever arm."""

AXES = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""About which roll, pitch and heading turn."""

BAD_FEATURE = 3.0
"""Features whose points lie so many times farther off than is usual for their kind are left out."""

STEADY = 0.001
"""Share of points left out below which the adjustment ends."""

WEAK = 1e-4
"""Smallest singular value of the scaled Jacobian; a combination of parameters below is open."""

MOST_TURNS = 15
"""Adjustments, points and features left out after each."""

SAMPLE = 2_000_000
"""Points of a cloud looked at in the search for planes; of larger clouds, so many at random."""

BLOCK = 200_000
"""Points placed at a time."""


@dataclass(eq=False)
class Shots:
    """Points by what places them: head, pose of the vehicle, vector from the head."""

    lever: np.ndarray
    head: np.ndarray
    offset: np.ndarray
    rotation: np.ndarray
    vector: np.ndarray
    drive: np.ndarray = None

    @classmethod
    def of(cls, drives, chosen, features, lever, origin):
        """Those of all features, one feature after the other."""
        index = np.concatenate([feature.index for feature in features])
        ends = np.cumsum([len(numbers) for numbers in chosen])
        drive = np.searchsorted(ends, index, side="right")
        n = len(index)
        whole = cls(
            lever, np.empty(n, int), np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 3)), drive
        )
        for number, (cloud, trajectory) in enumerate(drives):
            mine = drive == number
            rows = chosen[number][index[mine] - (ends[number] - len(chosen[number]))]
            part = cls.located(cloud, rows, trajectory, lever, origin)
            for name in ("head", "offset", "rotation", "vector"):
                getattr(whole, name)[mine] = getattr(part, name)
        return whole

    @classmethod
    def located(cls, cloud, rows, trajectory, lever, origin):
        """Those of some rows of a cloud."""
        head = _heads(cloud)[rows]
        position, rotation = trajectory.at(np.asarray(cloud["gps_time"][rows], dtype=np.float64))
        offset = position - origin
        from_vehicle = (cloud.points[rows] - origin) - offset
        vector = np.einsum("nij,ni->nj", rotation, from_vehicle) - lever[head]
        return cls(lever, head, offset, rotation, vector)

    def select(self, which):
        """Some of them."""
        arrays = (self.head, self.offset, self.rotation, self.vector, self.drive)
        return Shots(self.lever, *(values[which] for values in arrays))

    def turned(self, values):
        """Vectors under a boresight, (n, 3); ``values`` (heads, 6) in radians and metres."""
        return np.einsum("nij,nj->ni", rotations(*values[:, :3].T)[self.head], self.vector)

    def placed(self, values):
        """Points from the origin under a mounting, (n, 3)."""
        inside = self.turned(values) + (self.lever + values[:, 3:])[self.head]
        return self.offset + np.einsum("nij,nj->ni", self.rotation, inside)

    def beams(self, values):
        """Unit vectors from the head to each point, (n, 3)."""
        beam = np.einsum("nij,nj->ni", self.rotation, self.turned(values))
        return beam / np.linalg.norm(beam, axis=1)[:, None]

    def derivatives(self, values, normal):
        """Change of each point along ``normal`` (n, 3) by its own head's parameters, (n, 6)."""
        across = np.einsum("nij,ni->nj", self.rotation, normal)
        return np.hstack([np.cross(self.turned(values), across) @ AXES.T, across])


def sampled(drives, lever, origin, values, rng):
    """Rows taken of each drive, their points under a mounting, and the group of each."""
    chosen, placed, groups = [], [], []
    for number, (cloud, trajectory) in enumerate(drives):
        count = min(len(cloud), SAMPLE)
        rows = np.sort(rng.choice(len(cloud), count, replace=False))
        part = cloud[rows]
        moved = part.points - origin
        if values.any():
            moved = placed_points(part, trajectory, lever, values, origin)
        chosen.append(rows)
        placed.append(moved)
        groups.append(number * len(lever) + _heads(part))
    return chosen, np.concatenate(placed), np.concatenate(groups)


def placed_points(cloud, trajectory, lever, values, origin):
    """Points of a cloud (n, 3) from the origin, under a mounting whose angles are in radians."""
    placed = np.empty_like(cloud.points)
    for first in range(0, len(cloud), BLOCK):
        rows = slice(first, first + BLOCK)
        placed[rows] = Shots.located(cloud, rows, trajectory, lever, origin).placed(values)
    return placed


def _heads(cloud):
    """Head of each point; all the first where the cloud does not say."""
    return cloud["head"].astype(int) if "head" in cloud else np.zeros(len(cloud), dtype=int)


@dataclass(eq=False)
class Adjustment:
    """The points of all features, one feature after the other, and the least-squares problem.

    ``survey`` is the standard deviation of a control point's height over that of a laser point,
    ``noise_m`` that of ranges. Vectors in ``shots`` are without the range errors that the last
    turn found (``error``), so that planes tilt about where the beams meet them: a range error moves
    a point along its plane too, which would tilt the plane. ``left`` is what these errors are in
    misfits, without what the features' own parameters take out.
    """

    shots: Shots
    features: list
    absolute: bool
    free: np.ndarray
    survey: float = 0.0
    noise_m: float = 0.0
    last: tuple = None

    def __post_init__(self):
        self.error = self.left = np.zeros(len(self.shots.head))

    @property
    def counts(self):
        """Points of each feature."""
        return np.array([len(feature) for feature in self.features])

    def misfits(self, values):
        """Misfits, directions and basis of :func:`measured` under a mounting."""
        points, beams = self.shots.placed(values), self.shots.beams(values)
        found = measured(self.features, points, beams, self.survey, self.noise_m)
        return found[0] + self.left, *found[1:]

    def system(self, parameters):
        """Misfit of all points and its derivatives, the features' own parameters eliminated."""
        if self.last is not None and np.array_equal(self.last[0], parameters):
            return self.last[1:]
        values = self.values(parameters)
        misfit, normal, basis = self.misfits(values)
        self._eliminate(misfit[:, None], basis[:, COMMON], first=self._first("control"))
        jacobian = np.zeros((len(misfit), values.size))
        columns = self.shots.head[:, None] * len(PARAMETERS) + np.arange(len(PARAMETERS))
        derivatives = self.shots.derivatives(values, normal)
        np.put_along_axis(jacobian, columns, derivatives, axis=1)
        for number, column in enumerate(basis.T):
            # the first columns are all that planes, which come first, have
            self._eliminate(jacobian, column, first=0 if number < 3 else self._first("pole"))
        if not self.absolute:
            level = np.zeros((1, values.size))
            level[0, 5 :: len(PARAMETERS)] = np.sqrt(len(misfit))
            misfit = np.append(misfit, level @ values.ravel())
            jacobian = np.vstack([jacobian, level])
        self.last = (parameters.copy(), misfit, jacobian[:, self.free])
        return self.last[1:]

    def path_changes(self, values, rows):
        """Change of the misfits by errors of the drives' paths, (rows, 6 drives): place, angles.

        An error that lasts the whole drive moves and turns its points together.
        """
        shots, placed = self.shots, self.shots.placed(values)
        _, normal, basis = self.misfits(values)
        arm = np.einsum("nij,ni->nj", shots.rotation, placed - shots.offset)
        across = np.einsum("nij,ni->nj", shots.rotation, normal)
        effects = np.column_stack([normal, np.cross(arm, across) @ AXES.T])
        change = np.zeros((len(placed), 6 * (shots.drive.max() + 1)))
        columns = shots.drive[:, None] * 6 + np.arange(6)
        np.put_along_axis(change, columns, effects, axis=1)
        for column in basis.T:
            self._eliminate(change, column, first=0)
        return np.pad(change, ((0, rows - len(change)), (0, 0)))

    def values(self, parameters):
        """Array (heads, 6), 0 where a parameter is kept."""
        values = np.zeros(len(self.free))
        values[self.free] = parameters
        return values.reshape(-1, len(PARAMETERS))

    def _first(self, kind):
        """Number of the first feature that is of a kind or a later one."""
        kinds = list(OWN_PARAMETERS)
        return sum(kinds.index(feature.kind) < kinds.index(kind) for feature in self.features)

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
        parameters = values.ravel()[self.free]
        refuse_open(self.system(parameters)[1], self.free)
        limits = {"x_scale": "jac", "xtol": 1e-5, "ftol": 1e-6, "max_nfev": 20}
        for left in reversed(range(MOST_TURNS)):
            self.last = None
            found = least_squares(
                lambda p: self.system(p)[0], parameters, jac=lambda p: self.system(p)[1], **limits
            )
            parameters, values = found.x, self.values(found.x)
            misfit = self.misfits(values)[0]
            by_feature = np.split(misfit, np.cumsum(self.counts)[:-1])
            good = self._usual(by_feature)
            near = [
                near_own(feature.inside(part)) & keep
                for feature, part, keep in zip(self.features, by_feature, good, strict=True)
            ]
            survey, seen = self.survey, self._survey_error(by_feature)
            # halfway: weights and medians of few heights could change to and fro for ever
            self.survey = (survey + seen) / 2 if survey else seen
            settled = np.abs(self.survey - survey) <= 0.1 * self.survey
            steady = good.all() and np.concatenate(near).mean() > 1 - STEADY and settled
            if (steady and self.noise_m) or not left:
                return found, values
            self._keep(near)
            self._take_errors(values)

    def _survey_error(self, by_feature):
        """Standard deviation of the control points' heights over that of a laser point."""
        first = self._first("control")
        if first == len(by_feature):
            return 0.0
        noise = max(np.sqrt(np.mean(np.concatenate(by_feature[:first]) ** 2)), 1e-6)
        heights = np.array([part.mean() for part in by_feature[first:]])
        inside = np.mean([noise**2 / len(part) for part in by_feature[first:]])
        return np.sqrt(max(sigma_mad(heights) ** 2 - inside, 0)) / noise

    def _usual(self, by_feature):
        """Which features lie no farther off than is usual for their kind.

        Of heights over control points, most of which is one survey error, three deviations count.
        """
        rms = [np.sqrt(np.mean(part**2)) for part in by_feature]
        table = pd.DataFrame({"kind": [f.kind for f in self.features], "rms": rms})
        usual = table.groupby("kind")["rms"].transform("median")
        usual = usual.where(table["kind"] != "control", CONSISTENT_SCALE * usual)
        return (table["rms"] <= BAD_FEATURE * np.maximum(usual, 1e-6)).to_numpy()

    def _take_errors(self, values):
        """Take the range errors that explain the misfits out of the vectors."""
        misfit, normal, _ = self.misfits(values)
        planes, poles = (self.counts[: self._first(kind)].sum() for kind in ("pole", "control"))
        along = (normal * self.shots.beams(values)).sum(axis=1)
        design = np.column_stack([np.ones(planes), along[:planes] ** 2])
        surface, ranges = nnls(design, misfit[:planes] ** 2)[0]
        self.noise_m = max(np.sqrt(ranges), 1e-9)
        means = np.add.reduceat(misfit, np.cumsum(self.counts) - self.counts) / self.counts
        error = misfit - np.repeat(means, self.counts)
        error *= ranges * along / np.maximum(surface + ranges * along**2, 1e-300)
        error[planes:poles] = 0.0
        length = np.linalg.norm(self.shots.vector, axis=1)
        self.shots.vector *= (1 + (self.error - error) / length)[:, None]
        self.error, self.left = error, error * along
        basis = self.misfits(values)[2]
        for column in basis.T:
            self._eliminate(self.left[:, None], column, first=0)

    def _keep(self, near):
        """Leave out points, and features of which none is left."""
        inside = np.concatenate(near)
        self.shots = self.shots.select(inside)
        self.error, self.left = self.error[inside], self.left[inside]
        self.features = [
            replace(feature, index=feature.index[inside])
            for feature, inside in zip(self.features, near, strict=True)
            if inside.any()
        ]


def refuse_open(jacobian, free):
    """Name the parameters that can change together without any effect."""
    lengths = np.maximum(np.linalg.norm(jacobian, axis=0), np.finfo(float).tiny)
    _, size, ways = np.linalg.svd(jacobian / lengths, full_matrices=False)
    if size[-1] >= WEAK:
        return
    numbers = np.flatnonzero(free)[np.abs(ways[-1]) > 0.1]
    names = [f"{PARAMETERS[k % 6]} of head {k // 6 + 1}" for k in numbers]
    raise ValueError(
        f"Invalid drives: they do not determine the mounting ({' with '.join(names)} stays open). "
        "Must run in both directions past walls and poles; or keep one of these as assumed."
    )


def clustered_covariance(features, found):
    """Covariance from what each feature pulls at the estimates (cluster-robust, jackknife).

    Each pull is that of the feature's misfit under the mounting that the others give. Also the
    degrees of freedom of each variance: as many as features that share alike in it would have.
    """
    ends = np.cumsum([len(feature) for feature in features])
    starts, jacobian = np.append(0, ends[:-1]), found.jac[: ends[-1]]
    pulls = np.add.reduceat(jacobian * found.fun[: ends[-1], None], starts)
    inverse = np.linalg.inv(found.jac.T @ found.jac)
    own = np.array([part.T @ part for part in np.split(jacobian, ends[:-1])])
    others = np.eye(len(inverse)) - own @ inverse
    effects = inverse @ np.linalg.solve(others, pulls[..., None])[..., 0].T
    share = np.einsum("ij,gjk,ki->gi", inverse, own, inverse)
    return effects @ effects.T, share.sum(axis=0) ** 2 / (share**2).sum(axis=0)
