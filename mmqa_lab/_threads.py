"""How many threads a piece of compiled work is worth."""

from contextlib import contextmanager

import numba


@contextmanager
def enough_threads(items, share):
    """Let compiled code use one thread, and one more for every ``share`` items.

    Waking a thread takes longer than searching a small cloud.
    """
    before = numba.get_num_threads()
    numba.set_num_threads(min(before, 1 + items // share))
    try:
        yield
    finally:
        numba.set_num_threads(before)
