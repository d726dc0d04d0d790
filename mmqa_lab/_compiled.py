"""Threads for compiled work.

Compiling costs a new user more than computing: `parallel=True`, sorting and array expressions take
seconds each, plain loops a tenth of that.
"""

from concurrent.futures import ThreadPoolExecutor

import numba

__all__ = ["in_threads"]


def in_threads(kernel, n, *arguments, least=64):
    """Let a compiled ``kernel(first, last, *arguments)`` work on n rows, in blocks over threads.

    A block has ``least`` rows or more: waking a thread takes longer than working on a few.
    """
    threads = numba.get_num_threads()
    rows = max(least, -(-n // (8 * threads))) if threads > 1 else max(n, 1)
    blocks = [(first, min(first + rows, n)) for first in range(0, n, rows)]
    if len(blocks) < 2:
        kernel(0, n, *arguments)
        return
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(lambda block: kernel(*block, *arguments), blocks))
