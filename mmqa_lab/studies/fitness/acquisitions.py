"""Acquisitions drawn at random: ten kinds of scanners and cameras that pass a chart and things."""

from dataclasses import replace

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree
from scipy.stats import qmc

from mmqa_lab.simulate import PRESETS, Scanner, Scene, cylinder, rectangle, straight, systems
from mmqa_lab.simulate.surfaces import disc
from mmqa_lab.simulate.trajectories import Trajectory

__all__ = [
    "KINDS", "POSTS", "RANGES", "SIGN_M", "SQUARE", "WIRE", "acquisitions", "beam_radius", "drive",
]  # fmt: skip

RANGES = {
    "speed_kmh": (20, 80), "distance_m": (4, 25), "height_m": (0, 2), "turn_deg": (-30, 30),
    "pulse_rate_hz": (1e5, 2e6), "mirror_frequency_hz": (48, 250), "noise_mm": (1, 20),
    "heading_deg": (0, 45), "tilt_deg": (0, 45), "divergence_mrad": (0.2, 3),
    "jitter_deg": (0, 0.03), "dropout": (0, 0.3), "nearer": (0.5, 2), "chart_turn_deg": (-30, 30),
}  # fmt: skip
"""From which acquisitions are drawn, fixed before the first score: rates, heights and turns are
those of the five sources and of heads of today (2 MHz and 250 Hz; RIEGL and Z+F data sheets), beams
from 0.2 to 3 mrad (the same; Velodyne, Ouster), jitter and lost echoes as a reader of 0.4 drew
them. In half of the cases the chart stands elsewhere on the drive: ``nearer`` times as far, and
turned by an angle of its own."""

KINDS = {
    "one head": {}, "two heads": {},
    "16 beams": {"pulse_rate_hz": (1e5, 3e5), "mirror_frequency_hz": (5, 20)},
    "32 beams": {"pulse_rate_hz": (3e5, 7e5), "mirror_frequency_hz": (5, 20)},
    "64 beams": {"pulse_rate_hz": (3e5, 6.5e5), "mirror_frequency_hz": (10, 20)},
    "128 beams": {"pulse_rate_hz": (6e5, 1.3e6), "mirror_frequency_hz": (10, 20)},
    "rosette": {"pulse_rate_hz": (1e5, 2.4e5), "tilt_deg": (0, 10)},
    "walker": {"speed_kmh": (3, 6), "distance_m": (2, 10), "pulse_rate_hz": (5e4, 1.5e5),
               "mirror_frequency_hz": (10, 20)},
    "two drives": {},
    "images": {"pulse_rate_hz": (300, 2e4)},
}  # fmt: skip
"""Kinds, and their own ranges (data sheets of Velodyne VLP-16, HDL-32E and VLS-128, of Ouster
OS1 at 512 columns, and of Livox; a pace of walking). Of ``images``, matched
photographs with holes where nothing could be matched, the rate is the number of points per
square metre at 10 m."""

LOGARITHMIC = ("distance_m", "pulse_rate_hz", "mirror_frequency_hz", "noise_mm", "divergence_mrad")
LOGARITHMIC += ("nearer",)

BORESIGHT_DEG, BETWEEN_DRIVES_M = 0.02, 0.008
"""Standard deviations: of a second head's turn about each axis, of a second drive along each."""

SPANS = {"16 beams": 30.0, "64 beams": 45.0, "128 beams": 40.0, "walker": 30.0}
"""Degrees between the outer beams, evenly spaced; 32 beams are those of the HDL-32E."""

PLACES = {"chart": -9, "board": -6, "corner": -2, "sign": 1, "wire": 3, "posts": 7}
"""Objects in a row along the road: places of their middles, m."""

WALLS = (
    ("chart", (-0.5, -0.5, 0), (1, 0, 0), (0, 1, 0)),
    ("board", (-0.5, -0.5, 0), (1, 0, 0), (0, 1, 0)),
    ("corner", (0, -1, 0), (-1.06, 0, -1.06), (0, 2, 0)),
    ("corner", (0, -1, 0), (1.06, 0, -1.06), (0, 2, 0)),
    ("posts", (-2, -1.5, -0.6), (4, 0, 0), (0, 0, 1.2)),
)
"""Rectangles of the objects: a corner and two sides, along the road, up and towards the road, m."""

SQUARE = 0.5 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
"""Corners of a chart or a board about its middle, m."""

SIGN_M, WIRE = 0.3, ((-1, -0.4, 0), (1, 0.4, 0), 0.01)
"""Radius of the round sign; ends and radius of the wire, m."""

POSTS = {-1.2: 0.06, 0.0: 0.12, 1.2: 0.30}
"""Places along the road from the middle of the posts, and diameters, m."""


def acquisitions(count, *, seed):
    """Draw acquisitions by a Latin hypercube over ``RANGES``, as many of each of ``KINDS``.

    Parameters
    ----------
    count : int
        Acquisitions of each kind.
    seed : int
        Seed of the draw. It becomes the column ``draw``.

    Returns
    -------
    DataFrame
        ``draw``, ``number``, the names of the ranges, ``elsewhere`` (every other) and ``kind``.

    Examples
    --------
    >>> acquisitions(1, seed=31)["kind"].tolist()[:3]
    ['one head', 'two heads', '16 beams']
    """
    parts = []
    for k, (kind, own) in enumerate(KINDS.items()):
        limits = RANGES | own
        low, high = np.array(list(limits.values()), dtype=float).T
        drawn = qmc.LatinHypercube(len(limits), rng=[seed, k]).random(count)
        steady = np.maximum(low, 1e-9) * (high / np.maximum(low, 1e-9)) ** drawn
        values = np.where(np.isin(list(limits), LOGARITHMIC), steady, low + drawn * (high - low))
        parts.append(pd.DataFrame(values, columns=list(limits)).assign(kind=kind))
    found = pd.concat(parts, ignore_index=True)
    numbered = {"draw": seed, "number": found.index, "elsewhere": found.index % 2 == 1}
    return found.assign(**numbered)


def drive(case, rng, only=None):
    """Pass the row of objects, each turned about its own middle.

    Parameters
    ----------
    case : dict
        A row of :func:`acquisitions`.
    rng : numpy.random.Generator
    only : str, optional
        Scan this object alone.

    Returns
    -------
    points : dict of array, shape (n, 3)
        Points of each object along the road, up and towards the road from its middle, m.
    surface : dict of array of int, shape (n,)
        The surface of each point.
    axes : dict of array, shape (3, 3)
        These directions.
    """
    names = list(PLACES) if only is None else [only]
    far = dict.fromkeys(names, case["distance_m"])
    turns = dict.fromkeys(names, case["turn_deg"])
    if case["elsewhere"] and "chart" in names:
        far["chart"] = case["distance_m"] * case["nearer"]
        turns["chart"] = case["chart_turn_deg"]
    axes = {name: _axes(turn) for name, turn in turns.items()}
    middles = {name: np.array([far[name], PLACES[name], 0]) for name in names}
    surfaces, ends, owners = _objects(names, axes, middles)
    scene, ends = Scene(surfaces), np.array(ends)
    if case["kind"] == "images":
        points, hit = _matched(case, scene, axes, middles, rng)
    elif case["kind"] == "rosette":
        points, hit = _rosette(case, scene, ends, rng)
    else:
        points, hit = _scanned(case, scene, ends, rng)
    of = {name: np.array(owners)[hit] == name for name in names}
    local = {name: (points[of[name]] - middles[name]) @ axes[name].T for name in names}
    return local, {name: hit[of[name]] for name in names}, axes


def _axes(turn_deg):
    """Directions along the road, up and towards the road of an object that is turned, (3, 3)."""
    turn = np.radians(systems.FACING_THE_ROAD + turn_deg)
    return np.array([
        [-np.cos(turn), np.sin(turn), 0], [0, 0, 1], [np.sin(turn), np.cos(turn), 0],
    ])  # fmt: skip


def _objects(names, axes, middles):
    """Surfaces, their outer ends and the names of their objects."""
    surfaces, ends, owners = [], [], []
    for name, *sides in WALLS:
        if name in names:
            corner, along, up = np.array(sides) @ axes[name]
            corner = corner + middles[name]
            surfaces.append(rectangle(corner, along, up))
            ends += [corner, corner + along, corner + up, corner + along + up]
            owners.append(name)
    rods = [("posts", (x, -1.5, 0), (x, 1.5, 0), size / 2) for x, size in POSTS.items()]
    for name, *two, radius in [*rods, ("wire", *WIRE)]:
        if name in names:
            both = np.array(two) @ axes[name] + middles[name]
            surfaces.append(cylinder(*both, radius))
            ends += [*both]
            owners.append(name)
    if "sign" in names:
        surfaces.append(disc(middles["sign"], axes["sign"][2], SIGN_M))
        ends += [middles["sign"] + SIGN_M * side for side in (axes["sign"][1], -axes["sign"][1])]
        owners.append("sign")
    return surfaces, ends, owners


def _heads(case, rng):
    """The scanners of an acquisition.

    The second of two has the opposite heading, by chance also the opposite tilt, which crosses the
    lines on walls, and is turned against the first by ``BORESIGHT_DEG``.
    """
    names = "heading_deg", "tilt_deg", "pulse_rate_hz", "mirror_frequency_hz"
    choices = {name: case[name] for name in names} | {"range_noise_m": case["noise_mm"] / 1000}
    choices |= {"divergence_mrad": case["divergence_mrad"], "exit_diameter_m": 0.005}
    choices |= {"angle_noise_deg": case["jitter_deg"], "dropout_share": case["dropout"]}
    kind = case["kind"]
    if kind == "32 beams":
        return [replace(PRESETS["hdl-32e"], **choices)]
    if kind in SPANS:
        count = 16 if kind == "walker" else int(kind.split()[0])
        beams = tuple(SPANS[kind] * (np.arange(count) / (count - 1) - 0.5))
        return [Scanner(elevations_deg=beams, upright=True, **choices)]
    first, boresight = Scanner(**choices), tuple(BORESIGHT_DEG * rng.standard_normal(3))
    mounted = {"heading_deg": -first.heading_deg, "tilt_deg": rng.choice([-1, 1]) * first.tilt_deg}
    return [first, replace(first, boresight_deg=boresight, **mounted)][: 1 + (kind == "two heads")]


def _scanned(case, scene, ends, rng):
    """Points and surfaces from beams that turn, on one drive or two."""
    clouds = []
    for number in range(1 + (case["kind"] == "two drives")):
        shift = number * BETWEEN_DRIVES_M * rng.standard_normal(3)
        for head in _heads(case, rng):
            seed = [int(rng.integers(2**32))]
            cloud = systems.drive_past(scene, head, _path(case, ends, rng), ends, seed=seed)
            if len(cloud):
                clouds.append((cloud.points + shift, cloud["surface"]))
    clouds.append((np.empty((0, 3)), np.empty(0, int)))
    return tuple(np.concatenate(parts) for parts in zip(*clouds, strict=True))


def _path(case, ends, rng):
    """A straight drive, or a walk: steps at 1.8 Hz, turns and sways of some degrees."""
    reach = 1.2 * ends[:, 0].max() + np.abs(ends[:, 1]).max()
    start, speed = rng.uniform(-0.5, 0.5) - reach, case["speed_kmh"] / 3.6
    if case["kind"] != "walker":
        return straight(2 * reach, speed, start=(0, start, case["height_m"]))
    time = np.arange(0, 2 * reach / speed, 0.05)
    phase = 2 * np.pi * rng.random(4)
    rate = np.array([[0.9], [1.8], [0.2]])
    roll, pitch, turn = np.array([[3], [2], [6]]) * np.sin(
        2 * np.pi * rate * time + phase[:3, None]
    )
    sway, bob = 0.03 * np.sin(5.7 * time + phase[3]), 0.02 * np.sin(11.3 * time)
    place = np.column_stack([sway, start + speed * time, case["height_m"] + bob])
    return Trajectory(time, place, roll=roll, pitch=pitch, heading=turn)


def _rosette(case, scene, ends, rng):
    """Points and surfaces from a solid-state scanner whose two prisms draw a rosette of 70 degrees.

    The prisms turn at 7294 and -4664 revolutions per minute, as in the Livox Mid-40.
    """
    speed, reach = case["speed_kmh"] / 3.6, 0.8 * ends[:, 0].max()
    first, last = ends[:, 1].min() - reach, ends[:, 1].max() + reach
    time = np.arange(0, (last - first) / speed, 1 / case["pulse_rate_hz"])
    time = time[rng.random(len(time)) >= case["dropout"]]
    turns = 2 * np.pi * (np.outer([7294, -4664], time) / 60 + rng.random((2, 1)))
    side, up = np.tan(np.radians(17.6)) * np.array(
        [np.cos(turns).sum(axis=0), np.sin(turns).sum(axis=0)]
    )
    side, up = (
        one + np.radians(case["jitter_deg"]) * rng.standard_normal(len(one)) for one in (side, up)
    )
    beams = np.column_stack([np.ones(len(side)), side, up])
    beams /= np.linalg.norm(beams, axis=1, keepdims=True)
    from_ = np.column_stack([0 * time, first + speed * time, 0 * time + case["height_m"]])
    # beams that pass the objects by more than 2.5 m are not cast
    at = from_ + beams * (np.median(ends[:, 0]) / beams[:, :1])
    near = np.abs(at[:, 2]) < 2.5
    return _cast(case, scene, from_[near], beams[near], rng)[:2]


def _cast(case, scene, origins, beams, rng):
    """Points with noise along their beams, their surfaces, and which beams have one."""
    hits = scene.cast(origins, beams)
    there = np.isfinite(hits.range_m)
    ranges = hits.range_m[there] + case["noise_mm"] / 1000 * rng.standard_normal(there.sum())
    return origins[there] + ranges[:, None] * beams[there], hits.surface[there], there


def _matched(case, scene, axes, middles, rng):
    """Points and surfaces from photographs: none in holes, errors in common within 10 cm."""
    parts = []
    for name, middle in middles.items():
        density = case["pulse_rate_hz"] * (10 / middle[0]) ** 2
        wide = 5.0 if name == "posts" else 2.8
        places = rng.uniform(-0.5, 0.5, (rng.poisson(min(density, 4e4) * wide * 3.2), 2)) * [
            wide,
            3.2,
        ]
        holes = rng.uniform(-0.5, 0.5, (rng.poisson(4 * wide), 2)) * [wide, 3.2]
        radii = rng.uniform(0.02, 0.12, len(holes))
        inside = cKDTree(places).query_ball_point(holes, radii)
        places = np.delete(places, np.concatenate([*inside, []]).astype(int), axis=0)
        aims = middle + np.column_stack([places, np.zeros(len(places))]) @ axes[name]
        camera = np.array([0, middle[1], case["height_m"]])
        beams = (aims - camera) / np.linalg.norm(aims - camera, axis=1, keepdims=True)
        waves = rng.standard_normal((2, 20)) / 0.1
        phases = 2 * np.pi * rng.random(20)
        half = case | {"noise_mm": 0.6 * case["noise_mm"]}
        from_ = np.broadcast_to(camera, beams.shape)
        points, hit, there = _cast(half, scene, from_, beams, rng)
        common = np.cos(places[there] @ waves + phases).sum(axis=1, keepdims=True) / 10**0.5
        parts.append((points + 0.0008 * case["noise_mm"] * common * beams[there], hit))
    return tuple(np.concatenate(one) for one in zip(*parts, strict=True))


def beam_radius(case):
    """Return the radius over which a beam averages on the things of an acquisition, m."""
    if case["kind"] in ("rosette", "images"):
        return 0.0
    return 0.33 * (0.005 + case["divergence_mrad"] / 1000 * case["distance_m"])
