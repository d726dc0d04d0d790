"""Random numbers: each function and kind of thing has a key of its own for one seed."""

import zlib
from collections.abc import Sequence

import numpy as np

__all__ = ["stream"]


def stream(seed: int | Sequence[int], kind: str) -> np.random.Generator:
    """Return the random stream of a kind of thing, independent of that of every other kind.

    Examples
    --------
    >>> stream(1, "lamp").random() == stream(1, "sign").random()
    False
    """
    return np.random.default_rng([*np.atleast_1d(seed).tolist(), zlib.crc32(kind.encode())])
