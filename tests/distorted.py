"""A second camera of the tests' own: lenses with Brown's distortion, boards that are bent.

It shares no code with the package's maps and none with ``camera.py``. Lengths are in mm on the
chart or in pixels; pixels are (column, row), the first centre at (0, 0).
"""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.interpolate import RectBivariateSpline

from mmqa_lab import charts

FINE, STEP = 3, 8
"""Samples along each side of a pixel; pixels between those whose places are calculated."""


@dataclass(frozen=True)
class Lens:
    """A pinhole with Brown's distortion in front of a board that is a piece of a cylinder.

    Parameters
    ----------
    size : (int, int)
        Columns and rows.
    pixel_mm : float
        At the middle of the board.
    radial, tangential : (float, float)
        Of Brown's model, for distances from the axis in units of the corner's.
    turn : (float, float, float)
        Of the board about its x, y and normal, degrees.
    aside : (float, float)
        Of the board's middle from the middle of the image, pixels.
    sag : float
        Height of the bent board's middle above its edges, mm; ``axis`` is 0 where x is bent.
    """

    size: tuple = (1600, 1200)
    pixel_mm: float = 1.0
    radial: tuple = (0.0, 0.0)
    tangential: tuple = (0.0, 0.0)
    turn: tuple = (0.0, 0.0, 0.0)
    aside: tuple = (0.0, 0.0)
    sag: float = 0.0
    axis: int = 0

    @property
    def corner(self):
        """Distance of the image's corner from its middle, pixels."""
        return np.hypot(*self.size) / 2

    def pixels(self, xy):
        """Where places of the chart are in the photograph, shape (n, 2)."""
        flat = np.asarray(xy, dtype=float) - 500.0
        place = np.column_stack([flat, np.zeros(len(flat))])
        if self.sag:
            radius = 1000.0**2 / (8 * self.sag)
            angle = flat[:, self.axis] / radius
            place[:, self.axis] = radius * np.sin(angle)
            place[:, 2] = radius * (np.cos(angle) - 1)
        board, _ = cv2.Rodrigues(np.radians([self.turn[0], self.turn[1], 0.0]))
        roll, _ = cv2.Rodrigues(np.radians([0.0, 0.0, self.turn[2]]))
        x, y, z = (place @ (roll @ board).T).T
        far = 4000.0  # mm
        seen = np.column_stack([x, -y]) / (far - z)[:, None] * (far / self.pixel_mm)
        u, v = (seen + self.aside).T / self.corner
        square = u * u + v * v
        one = 1 + self.radial[0] * square + self.radial[1] * square**2
        p, q = self.tangential
        bent = [
            u * one + 2 * p * u * v + q * (square + 2 * u * u),
            v * one + p * (square + 2 * v * v) + 2 * q * u * v,
        ]
        return np.stack(bent, axis=1) * self.corner + (np.array(self.size) - 1) / 2

    def places(self):
        """Places of the chart at all samples, by Newton's steps at a few and lines between them."""
        knots = [np.arange(-STEP, side + 2 * STEP, STEP, dtype=float) for side in self.size]
        grid = np.stack(np.meshgrid(*knots), axis=-1).reshape(-1, 2)
        xy = (grid - np.array(self.size) / 2 - self.aside) * [self.pixel_mm, -self.pixel_mm] + 500
        for _ in range(30):
            wrong = grid - self.pixels(xy)
            slopes = np.stack(
                [(self.pixels(xy + e) - self.pixels(xy - e)) / 2 for e in np.eye(2)], axis=2
            )
            xy = xy + np.clip(np.linalg.solve(slopes, wrong[..., None])[..., 0], -80, 80)
        xy = xy.reshape(len(knots[1]), len(knots[0]), 2)
        at = [(np.arange(side * FINE) + 0.5) / FINE - 0.5 for side in self.size]
        both = [RectBivariateSpline(*knots[::-1], xy[..., k])(*at[::-1]) for k in (0, 1)]
        return np.stack(both, axis=-1)

    def length(self, bar):
        """True length of a bar's middle line, pixels."""
        ends = np.array([[bar.x, bar.y], [bar.x + bar.width, bar.y + bar.height]], dtype=float)
        narrow = 0 if bar.width < bar.height else 1
        ends[:, narrow] = ends[:, narrow].mean()
        return float(np.linalg.norm(np.diff(self.pixels(ends), axis=0)))

    def photograph(self, layout, *, seed=0, blur=0.5, noise=0.01):
        """The photograph in linear light; around the chart a wall with spots."""
        rng = np.random.default_rng(seed)
        cell = min(0.25, self.pixel_mm / FINE)
        printed = cv2.GaussianBlur(charts.reflectance(layout, cell=cell), (0, 0), 0.5)
        places = self.places()
        sought = (places / cell - 0.5).astype(np.float32)
        spots = rng.random((self.size[1] // 30 + 1, self.size[0] // 30 + 1)).astype(np.float32)
        light = cv2.resize(0.2 + 0.5 * spots, sought.shape[1::-1], interpolation=cv2.INTER_LINEAR)
        paint = cv2.remap(printed, sought, None, cv2.INTER_LINEAR)
        inside = ((places >= 0) & (places <= [layout.width, layout.height])).all(axis=-1)
        light = np.where(inside, 0.05 + 0.65 * paint, light)
        light = cv2.GaussianBlur(light.astype(np.float32), (0, 0), blur * FINE)
        light = cv2.resize(light, self.size, interpolation=cv2.INTER_AREA)
        return np.clip(light + noise * rng.standard_normal(light.shape), 0, 1)
