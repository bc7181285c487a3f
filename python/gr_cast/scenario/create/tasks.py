# SPDX-License-Identifier: GPL-3.0-or-later
"""Independent tasks on this machine or on a Dask cluster; results are the same, for a task is a pure function of its input."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context

from ...errors import CastError


def run(
    function: Callable, inputs: Sequence, *, dask: str | None = None, processes: int | None = None
) -> Iterator[tuple]:
    """Yield (index, function(inputs[index])) as tasks finish.

    `dask` is a scheduler's address (tcp://...). Without it tasks run in `processes` processes here (default: one per core),
    or in this one if that is 1: the ray tracer has threads of its own. Raises CastError if no cluster answers.
    """
    processes = processes or len(os.sched_getaffinity(0))
    if dask:
        yield from _on_dask(function, inputs, dask)
    elif processes == 1 or len(inputs) < 2:
        for index, value in enumerate(inputs):
            yield index, function(value)
    else:
        # A fresh interpreter per process: threads of the ray tracer do not survive a fork.
        with ProcessPoolExecutor(min(processes, len(inputs)), mp_context=get_context("spawn")) as pool:
            futures = {pool.submit(function, value): index for index, value in enumerate(inputs)}
            try:
                for future in as_completed(futures):
                    yield futures[future], future.result()
            finally:
                pool.shutdown(wait=False, cancel_futures=True)


def _on_dask(function: Callable, inputs: Sequence, address: str) -> Iterator[tuple]:
    try:
        from distributed import Client
        from distributed import as_completed as first_done
    except ImportError:
        raise CastError("--dask: Dask is not installed here: bash apps/install_raytracer.sh") from None
    try:
        client = Client(address, timeout="10s")
    except (OSError, ValueError) as error:
        raise CastError(f"--dask: {address}: no scheduler answers: {error}") from None
    with client:
        futures = {client.submit(function, value, pure=False): index for index, value in enumerate(inputs)}
        for future in first_done(futures):
            yield futures[future], future.result()
            future.release()
