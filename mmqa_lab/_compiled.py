"""Parts of compiled work: threads for it, and ranks of numbers.

Compiling costs a new user more than computing: `parallel=True`, sorting and array expressions take
seconds each, plain loops a tenth of that.
"""

from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np


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


@numba.njit(cache=True)
def ranked(values, n, rank):
    """The number of a rank, from 0, among the first n, which are reordered (Hoare's selection)."""
    low, high = 0, n - 1
    while low < high:
        i, j, pivot = low, high, values[(low + high) // 2]
        while i <= j:
            while values[i] < pivot:
                i += 1
            while pivot < values[j]:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i, j = i + 1, j - 1
        if rank <= j:
            high = j
        elif rank >= i:
            low = i
        else:
            break
    return values[rank]


@numba.njit(cache=True)
def median(values, n):
    """Median of the first n numbers, which are reordered; NaN of none."""
    if n == 0:
        return np.nan
    middle = ranked(values, n, n // 2)
    if n % 2:
        return middle
    lower = values[0]
    for k in range(1, n // 2):
        lower = max(lower, values[k])
    return (lower + middle) / 2
