"""A second street generator, for tests alone. It shares no code with ``mmqa_lab.simulate``.

Rays meet open cylinders, parallelograms and triangles in closed form; leaves are balls in which a
ray ends after an exponentially distributed way. The vehicle weaves along +y about x = 0.
"""

from dataclasses import dataclass, field

import numpy as np
import pandas as pd

SCANNERS = {
    "tilted profiler": {"rate": 60_000, "turns": 60, "tilt": 35, "heading": 30, "noise": 0.006},
    "16 beams": {"rate": 40_000, "turns": 10, "beams": np.linspace(-22, 14, 16), "noise": 0.015},
    "32 beams": {"rate": 80_000, "turns": 10, "beams": np.linspace(-26, 18, 32), "noise": 0.015},
    "64 beams": {"rate": 130_000, "turns": 10, "beams": np.linspace(-25, 15, 64), "noise": 0.015},
    "single sweep": {"rate": 50_000, "turns": 1, "beams": np.linspace(-20, 12, 64), "noise": 0.01},
}
"""Pulses and turns a second, mounting or elevations in degrees, noise of the range in metres."""

SPEED, HEIGHT, REACH, PAVEMENT = 8.0, 2.1, 60.0, 0.12


@dataclass
class OtherStreet:
    """Solids by kind as rows of numbers, and the truth: poles, and edges as pairs of points."""

    length: float
    slope: float = 0.0  # of the road that the vehicle climbs
    cylinders: list = field(default_factory=list)  # ends a, b, radius, pole
    faces: list = field(default_factory=list)  # corner, sides u, v, whether a triangle
    balls: list = field(default_factory=list)  # centre, radius, leaves met on a metre
    poles: list = field(default_factory=list)
    columns: list = field(default_factory=list)  # feet of porches' columns
    pillars: list = field(default_factory=list)  # feet of gates' pillars
    edges: list = field(default_factory=list)

    def cylinder(self, a, b, radius, pole=-1):
        self.cylinders.append([*a, *b, radius, pole])

    def face(self, corner, u, v, triangle=False):
        self.faces.append([*corner, *u, *v, triangle])

    def block(self, low, high):
        """An upright box between two opposite corners, without a bottom."""
        low, high = np.array(low, float), np.array(high, float)
        dx, dy, dz = np.diag(high - low)
        for corner, u, v in ((low, dx, dz), (low, dy, dz), (high, -dx, -dz), (high, -dy, -dz)):
            self.face(corner, u, v)
        self.face(high, -dx, -dy)

    def pole(self, kind, foot, height, diameter, lean):
        """A leaning shaft and its row in the table."""
        foot, lean = np.array(foot), np.array([*lean, 1.0])
        self.cylinder(foot, foot + height * lean, diameter / 2, len(self.poles))
        middle = foot + height / 2 * lean
        row = {"class": kind, "x_m": middle[0], "y_m": middle[1], "z_base_m": foot[2]}
        row |= {"height_m": height, "lean_x": lean[0], "lean_y": lean[1]}
        row |= {"foot_x_m": foot[0], "foot_y_m": foot[1]}
        self.poles.append(row | {"diameter_base_m": diameter, "diameter_top_m": diameter})
        return foot + height * lean


def make(seed, length=45.0, *, clutter=0, porches=False):
    """A street with houses and poles on both sides, cars and people; more of them by ``clutter``.

    With ``porches`` two to four columns carry each balcony: they are no poles.
    """
    rng = np.random.default_rng([seed, 77])
    street = OtherStreet(length)
    street.face((-3.5, -60, 0), (7, 0, 0), (0, length + 120, 0))
    for side in (-1, 1):
        kerb = (3.5 * side, -60, PAVEMENT)
        street.face(kerb, (60 * side, 0, 0), (0, length + 120, 0))
        street.face(kerb, (0, length + 120, 0), (0, 0, -PAVEMENT))
        for y in np.arange(-8, length + 8, 18):
            _house(street, rng, side, y + rng.uniform(0, 2))
            if porches:
                _porch(street, np.random.default_rng([seed, 80, len(street.columns)]))
        kinds = rng.permutation([_lamp, _sign, _bollard, _mast, _tree] * 9)
        for kind, y in zip(kinds, np.arange(3, length, 5.0), strict=False):
            foot = (side * rng.uniform(4.2, 8.0), y + rng.uniform(-1.5, 1.5), PAVEMENT)
            kind(street, rng, foot, side)
        for y in rng.uniform(0, length, 2):
            _car(street, side * 2.4, y)
            _person(street, side * rng.uniform(4, 8), rng.uniform(0, length))
    rng = np.random.default_rng([seed, 79])
    for _ in range(clutter):
        side = rng.choice([-1, 1])
        _car(street, side * 2.4, rng.uniform(0, length))
        _person(street, side * rng.uniform(4, 8), rng.uniform(0, length))
    return street


def _porch(street, rng):
    """Columns under the front of the last house's balcony."""
    (x, y, up), end = street.edges[-1]
    for along in np.linspace(0.15, end[1] - y - 0.15, rng.integers(2, 5)):
        foot = np.array([x + 0.15 * np.sign(x), y + along, PAVEMENT])
        street.cylinder(foot, [*foot[:2], up - 1.0], rng.uniform(0.08, 0.2))
        street.columns.append(foot)


def _house(street, rng, side, y):
    """An L of two wings, the long one with a pitched roof, a dormer and a balcony."""
    near, deep, wide, out = rng.uniform(10, 13), 9.0, rng.uniform(13, 15), rng.uniform(1.5, 2.5)
    wing, eave, rise = rng.uniform(4.5, 5.5), rng.uniform(5.5, 7), rng.uniform(2, 3)

    def at(across, along, up):
        return np.array([side * across, y + along, up])

    def quad(a, b, c, *edges):
        street.face(a, b - a, c - a)
        street.edges.extend(edges)

    a, b, c = at(near, wing, PAVEMENT), at(near, wide, PAVEMENT), at(near - out, 0, PAVEMENT)
    d, up, ridge = c + [0, wing, 0], np.array([0, 0, eave]), np.array([side * deep / 2, 0, rise])
    quad(a, b, a + up, (a, b), (a + up, b + up), (b, b + up), (a, a + up))
    quad(c, d, c + up, (c, d), (c + up, d + up), (c, c + up), (d, d + up))
    quad(d, a, d + up, (d, a), (d + up, a + up))
    quad(c + up, d + up, at(near, 0, PAVEMENT + eave))
    street.face(c, at(near + deep, 0, 0) - at(near - out, 0, 0), up)
    street.face(b, (side * deep, 0, 0), up)
    roof = at(near, 0, PAVEMENT + eave)
    quad(roof, b + up, roof + ridge)
    for end in (roof, b + up):
        street.face(end, (side * deep, 0, 0), ridge, triangle=True)
    low = at(near + 1, wing + 3, PAVEMENT + eave)
    street.block(low, low + [side * 2.2, 1.6, 1.7])
    front = at(near - 1.3, wing + 2, PAVEMENT + 2.9)
    street.block(front, at(near, wing + 5, PAVEMENT + 3.9))
    street.edges.append((front + [0, 0, 1], front + [0, 3, 1]))


def _lamp(street, rng, foot, side):
    """A post with a curved arm of two pieces and a lantern."""
    top = street.pole("lamp", foot, rng.uniform(5, 8), rng.uniform(0.11, 0.18), _lean(rng))
    knee = top + [-0.4 * side, 0, 0.5]
    street.cylinder(top, knee, 0.03)
    street.cylinder(knee, knee + [-0.9 * side, 0, 0.1], 0.03)
    street.block(knee + [-1.3 * side, -0.15, 0], knee + [-0.8 * side, 0.15, 0.12])


def _sign(street, rng, foot, side):
    """A post with a triangular plate."""
    top = street.pole("sign", foot, rng.uniform(2.4, 3.1), rng.uniform(0.06, 0.08), _lean(rng))
    street.face(top - [0.45, 0.06, 0.75], (0.9, 0, 0), (0.45, 0, 0.78), triangle=True)


def _bollard(street, rng, foot, side):
    street.pole("other", foot, rng.uniform(1.05, 1.3), rng.uniform(0.1, 0.16), (0, 0))


def _mast(street, rng, foot, side):
    """A wooden mast with a cross-beam."""
    top = street.pole("other", foot, rng.uniform(6, 8), rng.uniform(0.18, 0.26), _lean(rng))
    street.cylinder(top - [0.9, 0, 0.4], top + [0.9, 0, -0.4], 0.05)


def _tree(street, rng, foot, side):
    """A trunk that forks into boughs with balls of leaves at their ends."""
    fork = street.pole("tree", foot, rng.uniform(2.2, 3.2), rng.uniform(0.16, 0.4), _lean(rng))
    for turn in rng.uniform(0, 2 * np.pi) + 2 * np.pi / 4 * np.arange(4):
        tip = fork + rng.uniform(1.2, 1.8) * np.array([np.cos(turn), np.sin(turn), 1.1])
        street.cylinder(fork, tip, 0.05)
        street.balls.append([*tip, rng.uniform(0.8, 1.2), 0.9])


def _car(street, x, y):
    """A body, and a cabin whose screens slope."""
    street.block((x - 0.85, y - 2.1, 0.3), (x + 0.85, y + 2.1, 0.85))
    for sign in (-1, 1):
        street.face((x - 0.8, y + sign * 1.3, 0.85), (1.6, 0, 0), (0, -0.6 * sign, 0.6))
        street.face((x + sign * 0.8, y - 0.7, 0.85), (0, 1.4, 0), (0, 0, 0.6))
    street.face((x - 0.8, y - 0.7, 1.45), (1.6, 0, 0), (0, 1.4, 0))


def _person(street, x, y):
    """A coat and a head."""
    street.cylinder((x, y, PAVEMENT), (x, y, 1.5), 0.17)
    street.balls.append([x, y, 1.68, 0.12, 1e3])


def _lean(rng):
    return rng.normal(0, 0.015, 2)


def scan(street, scanner, seed):
    """Points (n, 3), times, scan lines, the pole of each point (-1: none), and the path."""
    rng = np.random.default_rng([seed, 78])
    look = SCANNERS[scanner]
    still = scanner == "single sweep"
    time = np.arange(0, 1 if still else street.length / SPEED, 1 / look["rate"])
    direction, line = _directions(look, time)
    y = np.full(len(time), street.length / 2) if still else SPEED * time
    origin = np.column_stack([0.2 * np.sin(y / 15), y, HEIGHT + street.slope * y])
    reach, pole = cast(street, origin, direction, rng)
    back = reach < REACH
    reach += rng.normal(0, look["noise"], len(reach))
    points = origin[back] + reach[back, None] * direction[back]
    return points, time[back], line[back], pole[back], origin[:: max(len(origin) // 100, 1)]


def _directions(look, time):
    """Unit vectors and the number of the scan line of each pulse."""
    turn = look["turns"] * time
    angle = 2 * np.pi * turn
    if "beams" in look:
        beam = np.arange(len(time)) % len(look["beams"])
        up = np.radians(look["beams"])[beam]
        level = np.cos(up)
        vectors = np.column_stack([level * np.sin(angle), level * np.cos(angle), np.sin(up)])
        return vectors, np.floor(turn).astype(int) * len(look["beams"]) + beam
    tilt, heading = np.radians([look["tilt"], look["heading"]])
    x, y, z = np.sin(angle), np.cos(angle) * np.sin(tilt), -np.cos(angle) * np.cos(tilt)
    c, s = np.cos(heading), np.sin(heading)
    return np.column_stack([c * x + s * y, c * y - s * x, z]), np.floor(turn).astype(int)


def cast(street, origin, direction, rng):
    """Range to the first solid, inf where none, and the pole it belongs to, -1 where none."""
    a, b, radius, owner = np.split(np.array(street.cylinders), [3, 6, 7], axis=1)
    corner, u, v, _ = np.split(np.array(street.faces, float), [3, 6, 9], axis=1)
    size = [np.linalg.norm(sides, axis=1) / 2 for sides in (b - a, u, v)]
    posts = np.array(street.cylinders), (a + b) / 2, size[0] + radius[:, 0]
    walls = np.array(street.faces, float), corner + (u + v) / 2, size[1] + size[2]
    leaves = np.array(street.balls)
    reach, pole = np.full(len(origin), np.inf), np.full(len(origin), -1)
    for first in range(0, len(origin), 64):
        rays = origin[first : first + 64, None], direction[first : first + 64, None]
        near = _near(*posts[1:], *rays)
        found = _cylinders(posts[0][near], *rays), _faces(walls[0][_near(*walls[1:], *rays)], *rays)
        balls = _balls(leaves[_near(leaves[:, :3], leaves[:, 3], *rays)], *rays, rng)
        ranges = np.column_stack([*found, balls, np.full(len(rays[0]), np.inf)])
        owners = np.full(ranges.shape[1], -1)
        owners[: near.sum()] = owner[near, 0]
        reach[first : first + 64] = ranges.min(axis=1)
        pole[first : first + 64] = owners[ranges.argmin(axis=1)]
    return reach, pole


def _near(middles, radii, origin, direction):
    """Solids that a narrow bundle of rays may meet."""
    axis = direction[:, 0].mean(axis=0)
    axis /= np.linalg.norm(axis)
    wide = np.arccos(np.clip(direction[:, 0] @ axis, -1, 1)).max()
    way = middles - origin[0, 0]
    far = np.linalg.norm(way, axis=1)
    off = np.arccos(np.clip(way @ axis / far, -1, 1))
    reach = radii + np.ptp(origin[:, 0], axis=0).max()
    return (far <= reach) | (off <= wide + np.arcsin(np.clip(reach / far, 0, 1)))


def _dot(a, b):
    return (a * b).sum(axis=-1)


@np.errstate(invalid="ignore", divide="ignore")
def _cylinders(rows, origin, direction):
    start, axis = origin - rows[:, :3], rows[:, 3:6] - rows[:, :3]
    length = np.linalg.norm(axis, axis=1)
    axis = axis / length[:, None]
    p = start - _dot(start, axis)[..., None] * axis
    q = direction - _dot(direction, axis)[..., None] * axis
    aa, bb, cc = _dot(q, q), _dot(p, q), _dot(p, p) - rows[:, 6] ** 2
    t = (-bb - np.sqrt(bb**2 - aa * cc)) / aa
    along = _dot(start + t[..., None] * direction, axis)
    return np.where((t > 0) & (along >= 0) & (along <= length), t, np.inf)


@np.errstate(invalid="ignore", divide="ignore")
def _faces(rows, origin, direction):
    corner, u, v, triangle = rows[:, :3], rows[:, 3:6], rows[:, 6:9], rows[:, 9] > 0
    normal = np.cross(u, v)
    t = _dot(corner - origin, normal) / _dot(direction, normal)
    inside = origin + t[..., None] * direction - corner
    size = _dot(normal, normal)
    s, r = _dot(np.cross(inside, v), normal) / size, _dot(np.cross(u, inside), normal) / size
    met = (t > 0) & (s >= 0) & (r >= 0) & np.where(triangle, s + r <= 1, (s <= 1) & (r <= 1))
    return np.where(met, t, np.inf)


@np.errstate(invalid="ignore")
def _balls(rows, origin, direction, rng):
    start = origin - rows[:, :3]
    b = _dot(start, direction)
    half = np.sqrt(b**2 - _dot(start, start) + rows[:, 3] ** 2)
    t = np.maximum(-b - half, 0) + rng.exponential(1 / rows[:, 4], b.shape)
    return np.where(t < half - b, t, np.inf)


def tables(street, pole):
    """Poles as a table, visible where ten points or more lie on the shaft; edges (m, 2, 3)."""
    seen = np.bincount(pole[pole >= 0], minlength=len(street.poles))
    poles = pd.DataFrame(street.poles).assign(points=seen, visible=seen >= 10)
    return poles, np.array(street.edges)
