# SPDX-License-Identifier: GPL-3.0-or-later
"""Ctrl-C and SIGTERM while samples flow. A handler that takes a lock waits for ever for the code that it interrupted, so handlers
do nothing here: the signal's number goes through a pipe to a thread, which may take what locks it needs."""

import contextlib
import os
import signal
import threading
from collections.abc import Callable

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextlib.contextmanager
def heeded(stop: Callable[[], object]):
    """While this is entered, the first SIGINT or SIGTERM has `stop()` called in a thread of its own, and a second one ends the
    process at once with status 128 + its number. Yields an event that tells whether a signal came. For the main thread."""
    came = threading.Event()
    receiver, sender = os.pipe()
    os.set_blocking(sender, False)

    def watch():
        while number := os.read(receiver, 1):
            if number[0] not in SIGNALS:
                continue
            if came.is_set():
                os._exit(128 + number[0])
            came.set()
            threading.Thread(target=stop, daemon=True).start()  # it may take long, or for ever

    handlers = {number: signal.signal(number, lambda *_: None) for number in SIGNALS}
    before = signal.set_wakeup_fd(sender, warn_on_full_buffer=False)
    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield came
    finally:
        signal.set_wakeup_fd(before)
        for number, handler in handlers.items():
            signal.signal(number, handler)
        os.close(sender)
        watcher.join()
        os.close(receiver)


def second_ends() -> None:
    """Have the first Ctrl-C raise KeyboardInterrupt and the second end the process, however far the first one got. A program that
    was started with interrupts ignored goes on ignoring them."""

    def once(*_):
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        raise KeyboardInterrupt

    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, once)
