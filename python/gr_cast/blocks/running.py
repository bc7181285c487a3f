# SPDX-License-Identifier: GPL-3.0-or-later
"""A flowgraph run to its end, or to where its samples stop coming: no wait is without a deadline."""

import threading
import time
from collections.abc import Callable

from gnuradio import gr

from ..core.errors import CastError

STILL_S = 5.0  # without a sample: a radio that delivers does so every few milliseconds
_LOOK_S = 0.05


def run_to_end(
    top: gr.top_block,
    passed: Callable[[], int],
    *,
    first_s: float = 0.0,
    stopped: threading.Event | None = None,
    look: Callable[[], object] = lambda: None,
) -> None:
    """Start `top` and return when it ends, or when `stopped` is set by whoever stops it.

    `passed()` counts the samples so far; the first may come `first_s` late (a timed start). `look()` is called
    every 50 ms. Raises CastError where none has come for STILL_S: the flowgraph is stopped then, and left behind where it
    does not stop either.
    """
    top.start()
    if stopped and stopped.is_set():  # it came before there was anything to stop
        top.stop()
    ended = threading.Event()
    waiter = threading.Thread(target=lambda: (top.wait(), ended.set()), daemon=True)
    waiter.start()
    begin = moved = time.monotonic()
    before, due = passed(), begin + first_s  # before that nobody has to hurry
    try:
        while not ended.wait(_LOOK_S):
            look()
            now, count = time.monotonic(), passed()
            if count != before:
                before, moved = count, now
            if stopped and stopped.is_set():
                due = min(due, now)
            if now - max(moved, due) > STILL_S:
                raise CastError(
                    f"radio: {count} samples passed in {now - begin:.1f} s, then none for {now - moved:.1f} s: is it there, is "
                    "its channel (--subdevice) right, do its clock and time come?"
                )
    finally:
        top.stop()
        ended.wait(STILL_S)
