"""Compiled functions, and threads for their work.

Compiling costs a new user more than computing: `parallel=True`, sorting and array expressions take
seconds each, plain loops a tenth of that.
"""

import contextlib
import functools
import hashlib
import os
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numba
from numba.misc.appdirs import AppDirs

__all__ = ["end_with_parent", "in_threads", "njit"]


def njit(*, cache=True, **choices):
    """Return numba's decorator; compiled code is kept only where something can be written.

    numba lists a file of code before it writes it, under the name that the code before had. A
    process that reads in between would run what an older numba or an older source left. So names
    have a mark of both.
    """
    places = Path(__file__).parent / "__pycache__", AppDirs("numba", False).user_cache_dir
    kept = numba.njit(cache=cache and any(map(_can_write, places)), **choices)

    def marked(function):
        compiled = kept(function)
        if file := getattr(compiled._cache, "_cache_file", None):
            of = hashlib.sha256(repr((numba.__version__, file._source_stamp)).encode())
            file._data_name_pattern = of.hexdigest()[:8] + "." + file._data_name_pattern
        return compiled

    return marked


@functools.cache
def _can_write(folder):
    """Whether a file can be made in a folder, which is made where missing.

    >>> _can_write(Path("/proc/none"))
    False
    """
    with contextlib.suppress(OSError):
        Path(folder).mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    return False


def end_with_parent():
    """Let this process end when the one that started it has ended, however that came."""
    parent = os.getppid()

    def watch():
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


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
