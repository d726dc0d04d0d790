"""From linear light to the values of image files and back."""

import numpy as np

from mmqa_lab._checks import check_choice, real_array, refuse

__all__ = ["decode", "encode"]

GAMMAS = ("srgb", "linear")

KNEE = 0.0031308
"""Linear light below which the curve of sRGB is a straight line."""


def encode(values: np.ndarray, gamma: str) -> np.ndarray:
    """Return values 0..1 of linear light as the file's: unchanged, or by the curve of sRGB.

    References
    ----------
    IEC 61966-2-1:1999, section 5.2.

    Examples
    --------
    >>> encode(np.array([0.0, 0.18, 1.0]), "srgb").round(2).tolist()
    [0.0, 0.46, 1.0]
    """
    if check_choice(gamma, "gamma", GAMMAS) == "linear":
        return values
    values = np.clip(_grey(values), 0, 1)
    curve = 1.055 * np.maximum(values, KNEE) ** (1 / 2.4) - 0.055
    return np.where(values <= KNEE, 12.92 * values, curve).astype(values.dtype)


def decode(values: np.ndarray, gamma: str) -> np.ndarray:
    """Return a file's values 0..1 as linear light, the inverse of :func:`encode`.

    Examples
    --------
    >>> bool(np.isclose(decode(encode(np.array([0.2]), "srgb"), "srgb"), 0.2)[0])
    True
    """
    if check_choice(gamma, "gamma", GAMMAS) == "linear":
        return values
    values = _grey(values)
    curve = ((np.maximum(values, 12.92 * KNEE) + 0.055) / 1.055) ** 2.4
    return np.where(values <= 12.92 * KNEE, values / 12.92, curve).astype(values.dtype)


def _grey(values):
    """Grey values in their type, if that has fractions."""
    values = real_array(values, "grey values")
    refuse(not np.isfinite(values).all(), "grey values", "some not finite", "finite")
    return values if values.dtype.kind == "f" else values.astype(np.float64)
