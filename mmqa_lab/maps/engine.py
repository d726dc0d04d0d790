"""Tasks on processes of this machine or on a Dask cluster."""

import contextlib
import logging
import os

from mmqa_lab._checks import check_count

SPAWN = "distributed.nanny.pre-spawn-environ."
KEEP_MEMORY = {
    f"{SPAWN}MALLOC_TRIM_THRESHOLD_": 2**30,
    f"{SPAWN}MALLOC_MMAP_THRESHOLD_": 2**29,
    f"{SPAWN}MALLOC_ARENA_MAX": 1,
}
"""Workers keep what arrays leave instead of giving it back and asking anew for each one, which took
a seventh of their time."""


@contextlib.contextmanager
def workers(count=None, *, scheduler=None):
    """Give a function ``run(function, tasks)`` that yields ``(task, result)`` as results come in.

    Parameters
    ----------
    count : int, optional
        Processes on this machine; as many as there are cores when not given. With 1, tasks run in
        this process.
    scheduler : str, optional
        Address of a running Dask scheduler, ``tcp://host:port``; ``count`` is then up to it. Its
        workers need this package, and the files under the same paths.

    Raises
    ------
    OSError
        If no scheduler answers.

    Notes
    -----
    A task whose worker dies runs again elsewhere. One that took four workers with it gets the
    exception as its result.
    """
    count = check_count(os.cpu_count() if count is None else count, "workers")
    if scheduler is None and count == 1:
        yield _here
        return
    import dask
    from distributed import Client, LocalCluster

    with contextlib.ExitStack() as stack:
        if scheduler is None:
            stack.enter_context(dask.config.set(KEEP_MEMORY))
            cluster = LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                memory_limit=0,
                dashboard_address=None,
                silence_logs=logging.ERROR,
            )
            scheduler = stack.enter_context(cluster)
        try:
            client = stack.enter_context(Client(scheduler, timeout=10))
        except (OSError, ValueError) as error:
            raise OSError(f"Invalid scheduler {scheduler}. Must be a running one.") from error
        yield lambda function, tasks: _there(client, function, tasks)


def _here(function, tasks):
    """One task after the other."""
    for task in tasks:
        yield task, function(*task)


def _there(client, function, tasks):
    """All tasks on the cluster; results as they come."""
    from distributed import CancelledError, KilledWorker, as_completed

    futures = {client.submit(function, *task, pure=False): task for task in tasks}
    for future in as_completed(futures):
        try:
            result = future.result()
        except KilledWorker as error:
            result = error
        except CancelledError as error:
            raise OSError("Lost the scheduler. Must run on; what was finished is kept.") from error
        yield futures.pop(future), result
        future.release()
