"""The equations of MIMIC (Cahalane et al. 2014), as printed and as they must be read.

MIMIC is the MobIle Mapping poInt density Calculator (Sensors 14(6), 9471-9488,
doi:10.3390/s140609471). Names follow the symbols of the paper. Notebook 05 lists them, with the
choices that the equations require. In these equations the scan plane stands still while the mirror
turns; in ``scan_lattice`` it moves. Angles are in degrees.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_values
from mmqa_lab.rotations import turned

__all__ = [
    "LEVEL", "PointSpacing", "point_spacing", "profile_angle", "profile_spacing_horizontal",
    "profile_spacing_vertical", "pulse_angle", "scanner_normal", "target_normal",
]  # fmt: skip

# A surface closer to level than 0.1 degree has no horizontal line of its own.
LEVEL = np.sin(np.radians(0.1))


def scanner_normal(alpha_scan: ArrayLike, gamma_scan: ArrayLike) -> np.ndarray:
    """Equation 1 for the scan plane: its normal, Y before rotation, (..., 3).

    The equation is read with row vectors, tilt before heading. This reading reproduces Table 3.

    Parameters
    ----------
    alpha_scan, gamma_scan : float or array_like
        Horizontal and vertical rotation of the scanner, degrees.

    Returns
    -------
    array, shape (..., 3)

    Examples
    --------
    >>> scanner_normal(45, 45).round(4).tolist()
    [-0.5, 0.5, 0.7071]
    """
    return turned(z=alpha_scan, x=gamma_scan)[..., :, 1]


def target_normal(alpha_targ: ArrayLike, beta_targ: ArrayLike) -> np.ndarray:
    """Equation 1 for the target plane: its normal, X before rotation, (..., 3).

    Parameters
    ----------
    alpha_targ, beta_targ : float or array_like
        Horizontal and vertical rotation of the target, degrees.

    Returns
    -------
    array, shape (..., 3)
        It points away from the vehicle.

    Examples
    --------
    >>> target_normal(0, 30).round(3).tolist()
    [0.866, 0.0, -0.5]
    """
    return turned(z=alpha_targ, y=beta_targ)[..., :, 0]


def profile_spacing_horizontal(
    d: float, alpha_scan: float, alpha_targ: float
) -> float | np.ndarray:
    """Equations 2 and 3: profile spacing along the target's horizontal line.

    Law of sines in the plan view: d sin(theta_3) / sin(theta_4) for a target turned away
    (equation 2, alpha_targ < 0, the paper's d+), d sin(theta_2) / sin(theta_5) for one turned
    towards the vehicle (equation 3, d-). The angles appear in figure 4 only; Table 3 requires
    theta_2 = theta_3 = 90 - alpha_scan, theta_4 = 90 - alpha_scan - |alpha_targ| and
    theta_5 = 90 - alpha_scan + |alpha_targ|. Scanner tilt and target tilt do not enter.

    Parameters
    ----------
    d : float
        Distance driven per revolution, v / Mf, metres.
    alpha_scan, alpha_targ : float
        Degrees.

    Returns
    -------
    float or array
        Metres.

    Raises
    ------
    ValueError
        If the horizontal pulse cannot hit the front of the target at these angles.

    References
    ----------
    Cahalane et al. 2014, equations 2 and 3, Table 3. doi:10.3390/s140609471

    Examples
    --------
    >>> [round(float(profile_spacing_horizontal(0.1, 45, a)), 6) for a in (15, 0, -15)]
    [0.08165, 0.1, 0.141421]
    """
    _check_strike(alpha_scan, alpha_targ)
    theta_23 = np.radians(90 - np.asarray(alpha_scan, dtype=np.float64))
    theta_45 = theta_23 + np.radians(alpha_targ)
    return d * np.sin(theta_23) / np.sin(theta_45)


def profile_angle(
    alpha_scan: ArrayLike, gamma_scan: ArrayLike, alpha_targ: ArrayLike, beta_targ: ArrayLike
) -> float | np.ndarray:
    """Angle theta_PrA between the profiles and the target's horizontal line, 0 to 90 degrees.

    The paper leaves the formula to its reference 34. Here tan = |n_s.h| / |n_s.v|, with h the
    target's horizontal line and v its line of greatest slope.

    Parameters
    ----------
    alpha_scan, gamma_scan, alpha_targ, beta_targ : float or array_like
        Rotations of scanner and target, degrees.

    Returns
    -------
    float or array
        Degrees.

    Examples
    --------
    >>> round(float(profile_angle(45, 45, 15, 0)), 4)
    40.8934
    """
    normal = scanner_normal(alpha_scan, gamma_scan)
    rotation = turned(z=alpha_targ, y=beta_targ)
    along = np.abs(np.sum(normal * rotation[..., :, 1], axis=-1))
    up = np.abs(np.sum(normal * rotation[..., :, 2], axis=-1))
    return np.degrees(np.arctan2(along, up))


def profile_spacing_vertical(d_prsh: ArrayLike, theta_pra: ArrayLike) -> float | np.ndarray:
    """Equation 4: spacing along the line of greatest slope, d_PrSH tan(theta_PrA), metres.

    Parameters
    ----------
    d_prsh : float or array_like
        Horizontal profile spacing, metres.
    theta_pra : float or array_like
        Profile angle, degrees.

    Returns
    -------
    float or array
        Metres.

    References
    ----------
    Cahalane et al. 2014, equation 4. doi:10.3390/s140609471

    Examples
    --------
    >>> round(float(profile_spacing_vertical(0.1, 45)), 6)
    0.1
    """
    return np.multiply(d_prsh, np.tan(np.radians(theta_pra)))


def pulse_angle(pulse_rate_hz: ArrayLike, mirror_frequency_hz: ArrayLike) -> float | np.ndarray:
    """Equation 5: theta_A, the field of view divided by the number of its pulses (PpM), degrees.

    PpM is not printed. It is PRR / Mf for 360 degrees and proportionally less for a smaller field
    of view, so that the field of view cancels.

    Parameters
    ----------
    pulse_rate_hz, mirror_frequency_hz : float or array_like
        Pulses and revolutions per second.

    Returns
    -------
    float or array
        Degrees.

    Examples
    --------
    >>> float(pulse_angle(300_000, 100))
    0.12
    """
    return 360 * np.divide(mirror_frequency_hz, pulse_rate_hz)


class PointSpacing(NamedTuple):
    """The results of equations 5 to 10, in metres and degrees, with the symbols of the paper.

    Parameters
    ----------
    d2 : float
        Distance along the profile to the evaluated height, metres (equations 6 and 7).
    r2 : float
        Length of the pulse there, metres (equation 9).
    theta_o : float
        Angle at the next point hit, degrees.
    d_ps : float
        Point spacing, metres (equation 10).

    Examples
    --------
    >>> chain = point_spacing((0, 0), (0, 0), h_r=5, height_difference=0, theta_a=0.12)
    >>> bool(np.isclose(chain.d_ps, 5 * np.tan(np.radians(0.12)))), float(chain.r2)
    (True, 5.0)
    """

    d2: float
    r2: float
    theta_o: float
    d_ps: float


def point_spacing(
    scanner: tuple[float, float],
    target: tuple[float, float],
    *,
    h_r: float,
    height_difference: float,
    theta_a: float,
    literal: bool = False,
    upwards: bool = True,
) -> PointSpacing:
    """Equations 5 to 10: the spacing of points along a profile of a scan plane at rest.

    Parameters
    ----------
    scanner, target : pair of float
        (alpha_scan, gamma_scan) and (alpha_targ, beta_targ), degrees.
    h_r : float
        Hr: X of the target where the horizontal pulse hits it, metres.
    height_difference : float
        h_targ - h_scan, metres.
    theta_a : float
        Turn of the mirror from pulse to pulse, degrees.
    literal : bool
        Equation 10 as printed, with r1.
    upwards : bool
        Spacing from the pulse at h_targ to the pulse above it; if False, to the pulse below it.

    Returns
    -------
    PointSpacing

    Raises
    ------
    ValueError
        If no pulse hits the front of the target.

    Notes
    -----
    theta_scan is the angle at the point hit by the horizontal pulse, between the directions to the
    scanner and up the profile. theta_o is the angle at the second point in the triangle of both
    pulses. At grazing incidence the spacings upwards and downwards differ by up to some per cent.

    References
    ----------
    Cahalane et al. 2014, equations 5-10. doi:10.3390/s140609471

    Examples
    --------
    >>> chain = point_spacing((45, 45), (15, 0), h_r=8, height_difference=0, theta_a=0.12)
    >>> round(1000 * float(chain.d_ps), 3)
    25.572
    """
    (alpha_scan, gamma_scan), (alpha_targ, beta_targ) = scanner, target
    _check_strike(alpha_scan, alpha_targ)
    normal, plane = scanner_normal(alpha_scan, gamma_scan), target_normal(alpha_targ, beta_targ)
    level = turned(z=alpha_scan)[..., :, 0]
    up = np.cross(normal, plane)
    up = up * np.sign(up[..., 2:]) / np.linalg.norm(up, axis=-1, keepdims=True)
    along = -np.sum(level * up, axis=-1)  # cosine of theta_scan
    theta_scan = np.degrees(np.arccos(np.clip(along, -1, 1)))
    z_diff = height_difference / np.cos(np.radians(gamma_scan))  # equations 6, 7
    r1 = h_r / np.cos(np.radians(alpha_scan))  # equation 8
    d2 = z_diff / np.sin(np.radians(theta_scan))
    r2 = np.sqrt(d2**2 + r1**2 - 2 * d2 * r1 * along)  # equation 9
    cosine = (d2 - r1 * along) / r2
    at_first = np.degrees(np.arccos(np.clip(-cosine if upwards else cosine, -1, 1)))
    theta_o = 180 - theta_a - at_first
    reach = r1 if literal else r2
    d_ps = reach * np.sin(np.radians(theta_a)) / np.sin(np.radians(theta_o))  # equation 10
    return PointSpacing(d2, r2, theta_o, d_ps)


def _check_strike(alpha_scan, alpha_targ):
    """Refuse angles at which the horizontal pulse misses the front of the target."""
    scan = check_values(alpha_scan, "alpha_scan")
    between = scan - check_values(alpha_targ, "alpha_targ")
    off = [np.abs((angle + 180) % 360 - 180) for angle in (between, scan)]
    if (np.maximum(*off) >= 90).any():
        raise ValueError(
            f"Invalid alpha_targ {alpha_targ}. Must be < 90 degrees from {alpha_scan}."
        )
