"""A bar that shows how far a long computation is."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from typing import Any

__all__ = ["progress"]

# Shorter work shows no bar, s.
SHORT_S = 1.0


def progress(items: Iterable, unit: str, *, total: int | None = None) -> Any:
    """Go through items, with a bar where somebody looks: in a terminal or a notebook.

    Examples
    --------
    >>> list(progress("ab", "letter"))
    ['a', 'b']
    """
    from tqdm.auto import tqdm  # a bar of its own in a notebook

    nobody = True if os.environ.get("MMQA_HEADLESS") else None  # None: unless it is a terminal
    # some terminals say that their size is zero; in a notebook, 80 would be pixels
    size = {"ncols": 80, "nrows": 24} if sys.stderr.isatty() else {}
    look = {"leave": False, "delay": SHORT_S, "disable": nobody} | size
    return tqdm(items, unit=unit, total=total, **look)
