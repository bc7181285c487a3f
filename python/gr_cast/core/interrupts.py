# SPDX-License-Identifier: GPL-3.0-or-later
"""Ctrl-C and SIGTERM while samples flow. A handler that takes a lock waits for ever for the code that it interrupted, so handlers
do nothing here: the signal's number goes through a pipe to a thread, which may take what locks it needs."""

import contextlib
import multiprocessing
import os
import re
import signal
import sys
import threading
from collections.abc import Callable

SIGNALS = (signal.SIGINT, signal.SIGTERM)
_AGAIN_S = 0.25  # until an interrupt that nobody heard of is raised again
_TOGETHER = re.compile(r"Signal (\d+) ignored due to race condition")  # CPython's words for one that came with the first
_has_come = False  # the first signal of a program that `second_ends` watches
_is_settled = False  # somebody heard of it


@contextlib.contextmanager
def heeded(stop: Callable[[], object]):
    """While this is entered, the first SIGINT or SIGTERM has `stop()` called in a thread of its own, and a second one ends the
    process at once with status 128 + its number. Yields an event that tells whether a signal came. For the main thread.
    Raises KeyboardInterrupt where one came before, and a library that was being loaded swallowed it."""
    if _has_come:
        raise KeyboardInterrupt
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

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    # The pipe before the handlers, and after them at the end: a signal in between is heard twice, and not lost.
    before, handlers = signal.set_wakeup_fd(sender, warn_on_full_buffer=False), {}
    try:
        for number in SIGNALS:
            handlers[number] = signal.signal(number, lambda *_: None)
        yield came
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(before)
        os.close(sender)
        watcher.join()
        os.close(receiver)


@contextlib.contextmanager
def held_back():
    """While this is entered, a first SIGINT or SIGTERM waits for its end, so that what tidies up is done whole;
    a second one ends the process."""
    handlers = {number: signal.getsignal(number) for number in SIGNALS}
    heard = {number: handler for number, handler in handlers.items() if callable(handler)}
    if threading.current_thread() is not threading.main_thread() or len(heard) < len(SIGNALS):  # or the first has come
        yield
        return
    came = []

    def wait(number, _):
        came.append(number)
        _heeded_by(signal.SIG_DFL)

    _heeded_by(wait)
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        if came:
            signal.raise_signal(came[0])


def _heeded_by(handler) -> None:
    """`handler` for SIGINT and SIGTERM; a program that was started with interrupts ignored goes on ignoring them."""
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)


def end_quietly() -> None:
    """Until `second_ends`, while a program is only being loaded and has made nothing: a signal ends it in one word, status 130.
    A worker leaves Ctrl-C to its parent from the beginning."""
    if multiprocessing.parent_process() is not None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        return

    def leave(*_):
        os.write(2, b"interrupted\n")
        os._exit(130)

    _heeded_by(leave)


def second_ends() -> Callable[[], bool]:
    """Have the first SIGINT or SIGTERM raise KeyboardInterrupt, so that what was begun is tidied up, and the second end the
    process, however far the first one got. Gives a function that tells whether the first has come: libraries that are interrupted
    while they are being loaded make other errors of it. What a library swallows, or Python drops, as in a finalizer, is raised
    again, but not into the tidying up, until it is `settled`."""
    global _has_come, _is_settled
    _has_come = _is_settled = False

    def once(*_):
        global _has_come
        _has_come = True
        _heeded_by(signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_REAL, _AGAIN_S, _AGAIN_S)
        raise KeyboardInterrupt

    def again(*_):
        if not _is_settled and not _is_being_heard(sys.exc_info()[1]):
            raise KeyboardInterrupt

    def dropped(what):
        if together := _TOGETHER.fullmatch(str(what.exc_value)):
            os.kill(os.getpid(), int(together[1]))
        elif not issubclass(what.exc_type, KeyboardInterrupt):
            others(what)

    others, sys.unraisablehook = sys.unraisablehook, dropped
    signal.signal(signal.SIGALRM, again)
    _heeded_by(once)
    return lambda: _has_come


def _is_being_heard(error: BaseException | None) -> bool:
    """Whether what is being handled came of an interrupt."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error is not None


def settled() -> None:
    """The program has heard of its interrupt, or ended without one: none is raised again. For whoever catches one and goes on."""
    global _is_settled
    _is_settled = True
    signal.setitimer(signal.ITIMER_REAL, 0)
