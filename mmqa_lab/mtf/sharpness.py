"""Sharpness of images without targets."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_count, check_image, check_number, refuse

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["haar_sharpness"]
__dir__ = __all__.copy


def haar_sharpness(
    image: ArrayLike, *, block: int = 64, noise_std: float | None = None
) -> xr.Dataset:
    """Map the sharpness of an image, block by block.

    Two levels of the Haar transform; in each block the root mean square of the details of the
    finest level over that of the next, each less what noise adds. On the same scene a blurred image
    gives less.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Grey values in proportion to light.
    block : int
        Side of the blocks, px, a multiple of 4; the rest at the right and lower edge is left out.
    noise_std : float, optional
        Standard deviation of the noise, in grey values. Estimated from the finest diagonal details
        where left out, which takes fine texture for noise.

    Returns
    -------
    Dataset
        ``sharpness`` over ``y_px``, ``x_px`` (the blocks' centres); NaN where the coarser details
        do not stand out from the noise.
        ``attrs``: ``noise_std`` used, ``not_measurable`` (count of blocks).

    Raises
    ------
    ValueError
        If the image is smaller than a block or not finite.

    Notes
    -----
    A sharp edge has as much detail at both levels, fine texture has more at the finest: values
    about 0.5 to 1 are usual. Compare images of the same ground, or take the median of many images
    at each place of the image plane, so that the scenes even out.

    Examples
    --------
    >>> noise = np.random.default_rng(1).normal(size=(64, 64))
    >>> haar_sharpness(noise, noise_std=0)["sharpness"].round(1).item()
    1.0
    """
    import xarray as xr
    from scipy.stats import median_abs_deviation

    grey, side = check_image(image), check_count(block, "block", low=8)
    found = f"{grey.shape} pixels for blocks of {side} px"
    must = "at least a block large; the block's side must be a multiple of 4"
    refuse(min(grey.shape) < side or side % 4, "image", found, must)
    rows, columns = (size // side for size in grey.shape)
    approximation, fine = _haar(grey[: rows * side, : columns * side])
    coarse = _haar(approximation)[1]
    if noise_std is None:
        noise_std = float(median_abs_deviation(fine[2], axis=None, scale="normal"))
    noise = check_number(noise_std, "noise_std", low=0) ** 2
    above, below = (
        sum(cv2.resize(part**2, (columns, rows), interpolation=cv2.INTER_AREA) for part in details)
        - 3 * noise
        for details in (fine, coarse)
    )
    clear = below > 4 * max(noise, 1e-12) * len(fine)
    ratio = np.sqrt(np.maximum(above, 0) / np.where(clear, below, np.nan))
    centres = {"y_px": (np.arange(rows) + 0.5) * side, "x_px": (np.arange(columns) + 0.5) * side}
    about = {"noise_std": noise_std, "not_measurable": int((~clear).sum())}
    return xr.Dataset({"sharpness": (("y_px", "x_px"), ratio)}, coords=centres, attrs=about)


def _haar(grey):
    """One level of Haar wavelets: the approximation, and the details along y, x and both."""
    a, b = grey[::2, ::2], grey[::2, 1::2]
    c, d = grey[1::2, ::2], grey[1::2, 1::2]
    return (a + b + c + d) / 2, ((a + b - c - d) / 2, (a - b + c - d) / 2, (a - b - c + d) / 2)
