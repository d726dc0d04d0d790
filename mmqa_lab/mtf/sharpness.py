"""Local sharpness all over an image, by Haar wavelets, without any target.

After EuroSDR 2013, image radiometry, chapter 5 (IGN), which prints no formula. Here detail at the
finest scale is divided by detail twice as coarse and mapped over the image plane. The measure
depends on what the image shows and is for comparison only.
"""

import numpy as np
import xarray as xr

from mmqa_lab._checks import check_count, check_number

CLEAR = 4.0
"""Detail counts as measurable when its energy is so many times that of the noise."""


def haar_sharpness(image, *, block=64, noise_std=None):
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
        Over ``y_px``, ``x_px`` (the blocks' centres): ``sharpness``; ``along_x`` and ``along_y``,
        the same of details in one direction only (image motion along y lowers the second). NaN
        where the coarser details do not stand out from the noise.
        ``attrs``: ``noise_std`` used, ``not_measurable`` (count of blocks).

    Raises
    ------
    ValueError
        If the image is smaller than a block or not finite.

    Notes
    -----
    A sharp edge has as much detail at both levels, fine texture has more at the finest: values
    about 0.5 to 1 are usual. Compare images of the same ground, or average many images over the
    image plane (``mean_sharpness``) so that the scenes even out.

    Examples
    --------
    >>> noise = np.random.default_rng(1).normal(size=(64, 64))
    >>> haar_sharpness(noise, noise_std=0)["sharpness"].round(1).item()
    1.0
    """
    import pywt
    from scipy.stats import median_abs_deviation

    grey = np.asarray(image, dtype=np.float64)
    side = check_count(block, "block", low=8)
    if grey.ndim != 2 or min(grey.shape) < side or not np.isfinite(grey).all() or side % 4:
        raise ValueError(
            f"Invalid image of shape {grey.shape} for blocks of {side} px. Must be finite and at "
            "least a block large; the block's side must be a multiple of 4."
        )
    rows, columns = (size // side for size in grey.shape)
    approximation, fine = pywt.dwt2(grey[: rows * side, : columns * side], "haar")
    coarse = pywt.dwt2(approximation, "haar")[1]
    if noise_std is None:
        noise_std = float(median_abs_deviation(fine[2], axis=None, scale="normal"))
    noise = check_number(noise_std, "noise_std", low=0) ** 2
    energy = {
        level: [_block_means(part**2, rows, columns) - noise for part in details]
        for level, details in (("fine", fine), ("coarse", coarse))
    }
    # pywt: the first detail varies along rows (y), the second along columns (x), the third both
    choices = {"sharpness": (0, 1, 2), "along_x": (1,), "along_y": (0,)}
    maps = {}
    for name, parts in choices.items():
        above, below = (sum(energy[level][k] for k in parts) for level in ("fine", "coarse"))
        clear = below > CLEAR * max(noise, 1e-12) * len(parts)
        ratio = np.sqrt(np.maximum(above, 0) / np.where(clear, below, np.nan))
        maps[name] = (("y_px", "x_px"), ratio)
    centres = {"y_px": (np.arange(rows) + 0.5) * side, "x_px": (np.arange(columns) + 0.5) * side}
    missing = int(np.isnan(maps["sharpness"][1]).sum())
    about = {"noise_std": noise_std, "not_measurable": missing}
    return xr.Dataset(maps, coords=centres, attrs=about)


def mean_sharpness(maps):
    """Return the median of sharpness maps of many images, block by block, and its spread.

    Parameters
    ----------
    maps : sequence of Dataset
        From ``haar_sharpness``, all of the same size.

    Returns
    -------
    Dataset
        The medians, and ``n``: images that were measurable there.

    Examples
    --------
    >>> maps = [xr.Dataset({"sharpness": ("x", values)}) for values in ([1.0, 2.0], [3.0, np.nan])]
    >>> middle = mean_sharpness(maps)
    >>> middle["sharpness"].values.tolist(), middle["n"].values.tolist()
    ([2.0, 2.0], [2, 1])
    """
    stack = xr.concat(list(maps), dim="image")
    middle = stack.median("image")
    middle["n"] = stack["sharpness"].notnull().sum("image")
    return middle


def _block_means(values, rows, columns):
    """Means over the blocks of an array, shape (rows, columns)."""
    high, wide = values.shape[0] // rows, values.shape[1] // columns
    return values.reshape(rows, high, columns, wide).mean(axis=(1, 3))
