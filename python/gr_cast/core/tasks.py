# SPDX-License-Identifier: GPL-3.0-or-later
"""Independent tasks on this machine or on a Dask cluster; results are the same, for a task is a pure function of its input."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from functools import partial

from .errors import CastError
from .programs import installer

_WAIT_S = 10  # for a scheduler to answer, and for a worker to be there


def run(
    function: Callable,
    common,
    inputs: Sequence,
    *,
    dask: str | None = None,
    processes: int | None = None,
    lost: Callable[[int], object] | None = None,
) -> Iterator[tuple]:
    """Yield (index, function(common, inputs[index])) as tasks finish. `common` travels once per worker, an input per task.

    `dask` is a scheduler's address (tcp://...). Without it tasks run in `processes` processes here (default: one per core),
    or in this one if that is 1. A task whose process is killed (out of memory) is tried once more alone, then `lost(index)`
    stands in for its result. Raises CastError if that is not given, if no cluster answers, or if it cannot do the work.
    """
    processes = processes or len(os.sched_getaffinity(0))
    if not inputs:
        return
    if dask:
        yield from _on_dask(function, common, inputs, dask)
    elif lost is None and (processes == 1 or len(inputs) < 2):
        for index, value in enumerate(inputs):
            yield index, function(common, value)
    else:
        undone = dict(enumerate(inputs))
        while undone:
            try:
                for index, result in _in_pool(function, common, undone, processes):
                    del undone[index]
                    yield index, result
            except BrokenProcessPool:  # nobody says whose process it was: of those that were under way each goes alone
                for index in list(undone)[: processes + 1]:
                    yield index, _alone(function, common, index, undone.pop(index), lost)


def _alone(function: Callable, common, index: int, value, lost: Callable[[int], object] | None):
    try:
        return next(_in_pool(function, common, {index: value}, 1))[1]
    except BrokenProcessPool:
        if lost is None:
            raise CastError(f"task {index + 1}: its process was killed (out of memory?)") from None
        return lost(index)


def _in_pool(function: Callable, common, inputs: dict, processes: int) -> Iterator[tuple]:
    # A fresh interpreter per process: threads of GNU Radio and of the ray tracer do not survive a fork.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(processes, len(inputs)), context, _begin, (common,)) as pool:
        futures = {pool.submit(_with_common, function, value): index for index, value in inputs.items()}
        try:
            for future in as_completed(futures):
                yield futures.pop(future), future.result()  # a future that is kept would keep its result
        finally:
            if futures:  # nobody waits for what is still being done
                workers, manager = list(pool._processes.values()), pool._executor_manager_thread  # the pool forgets them
                pool.shutdown(wait=False, cancel_futures=True)
                for worker in workers:
                    worker.terminate()
                manager.join()  # at the end of the interpreter it would meet what the interpreter closes


_common = None  # of the tasks of this worker


def _begin(common) -> None:
    global _common
    _common = common
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's, which ends its workers
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A parent that is killed cannot stop its workers: they would wait for ever."""
    multiprocessing.parent_process().join()
    os._exit(1)


def _with_common(function: Callable, value):
    return function(_common, value)


def _on_dask(function: Callable, common, inputs: Sequence, address: str) -> Iterator[tuple]:
    try:
        from distributed import Client, KilledWorker
        from distributed import as_completed as first_done
    except ImportError:
        raise CastError(f"--dask: Dask is not in this Python: Debian's python3-distributed, or {installer()}") from None
    try:
        client = Client(address, timeout=_WAIT_S)
    except (OSError, ValueError) as error:
        raise CastError(f"--dask: {address}: no scheduler answers: {error}") from None
    with client:
        try:
            client.wait_for_workers(1, timeout=_WAIT_S)
            # A task that hands `common` on, and no scattered copy: when its worker dies, it is made again.
            shared = client.submit(partial(_same, common), pure=False)
            futures = {client.submit(function, shared, value, pure=False): index for index, value in enumerate(inputs)}
            for future in first_done(futures):
                yield futures[future], future.result()
                future.release()
        except TimeoutError:
            raise CastError(f"--dask: {address}: the scheduler has no worker after {_WAIT_S} s") from None
        except ModuleNotFoundError as error:
            raise CastError(
                f"--dask: {address}: a worker has no module {error.name}: start it in this Python, PYTHONPATH with gr_cast"
            ) from None
        except (KilledWorker, CancelledError) as error:
            raise CastError(f"--dask: {address}: workers died at the work: {error}") from None


def _same(value):
    return value
