#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs tests again and again for bench_mutants.py, each time in a fork that has loaded SciPy already.

Arguments: the test files, `--`, the files whose functions are watched. The first answer, a line of JSON, tells of every test how
long it took, which of those functions it called, and whether it started a process, which may have called any. Then every line
asked, a list of tests' names in order, is answered by 0 (all passed) or another status.
"""

import contextlib
import json
import os
import select
import signal
import sys
import threading
import time

import hypothesis
import numpy
import pytest
import scipy.fft
import scipy.io
import scipy.optimize
import scipy.signal
import scipy.stats
import yaml

LOADED = (hypothesis, numpy, scipy, yaml)  # not GNU Radio: it has threads, which no fork keeps
OPTIONS = ("-q", "-p", "no:cacheprovider", "--hypothesis-seed=0")
LEAST_LIMIT_S, TIMES = 20, 10  # a test has hung after so long, or so many times as long as it took
ALL_TIMES = 3  # all of them together: C++ in a loop heeds no alarm


class Watch:
    """Which functions of some files every test calls."""

    def __init__(self, watched):
        self.watched, self.tests, self.called, self.starts = frozenset(watched), {}, set(), False
        self.failed, self.shared = [], {}
        sys.addaudithook(self._hear)

    def _hear(self, event, _):
        if event in ("subprocess.Popen", "os.fork", "os.forkpty", "os.posix_spawn"):
            self.starts = True

    def _call(self, frame, *_):
        code = frame.f_code
        if code.co_filename in self.watched:
            self.called.add((code.co_filename, code.co_firstlineno))

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_protocol(self, item):
        self.called, self.starts, begin = set(), False, time.monotonic()
        sys.settrace(self._call)
        threading.settrace(self._call)
        yield
        sys.settrace(None)
        threading.settrace(None)
        self.tests[item.nodeid] = (time.monotonic() - begin, self.called, self.starts, item.path)

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_setup(self, item):
        yield
        self.shared.setdefault(item.path, set()).update(self.called)  # what a fixture made serves the whole file, perhaps

    def pytest_runtest_logreport(self, report):
        if report.failed:
            self.failed.append(report.nodeid)

    def report(self) -> dict:
        """{test: {"seconds", "called": [(file, first line)], "starts"}}."""
        return {
            name: {"seconds": seconds, "called": sorted(called | self.shared[path]), "starts": starts}
            for name, (seconds, called, starts, path) in self.tests.items()
        }


class Chosen:
    """These tests alone, in this order."""

    def __init__(self, limits_s: dict[str, float]):
        self.limits_s = limits_s

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items):
        place = {name: k for k, name in enumerate(self.limits_s)}
        items[:] = sorted((item for item in items if item.nodeid in place), key=lambda item: place[item.nodeid])
        for item in items:
            item.add_marker(pytest.mark.timeout(self.limits_s[item.nodeid]))


def in_a_fork(work, limit_s=None):
    """What `work()` returns there, as JSON; None where it hung or died."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        os.setsid()
        nothing = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(nothing, stream)
        try:
            os.write(write, b"") if (told := work()) is None else _write_all(write, json.dumps(told).encode())
        finally:
            os._exit(0)
    os.close(write)
    told, end = b"", None if limit_s is None else time.monotonic() + limit_s
    while select.select([read], [], [], None if end is None else max(end - time.monotonic(), 0))[0]:
        if not (piece := os.read(read, 1 << 16)):
            break
        told += piece
    os.close(read)
    with contextlib.suppress(ProcessLookupError):  # what a test left running goes, too
        os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return json.loads(told) if told else None


def _write_all(pipe: int, told: bytes) -> None:
    while told:
        told = told[os.write(pipe, told) :]


def main() -> None:
    between = sys.argv.index("--")
    files, watched = sys.argv[1:between], sys.argv[between + 1 :]

    def look():
        watch = Watch(watched)
        pytest.main([*OPTIONS, *files], plugins=[watch])
        return {"failed": watch.failed, "tests": watch.report()}

    def run(names):
        sys.dont_write_bytecode = True  # of a mutant
        limits_s = {name: LEAST_LIMIT_S + TIMES * tests[name]["seconds"] for name in names}
        return int(pytest.main([*OPTIONS, "-x", *dict.fromkeys(n.split("::")[0] for n in names)], plugins=[Chosen(limits_s)]))

    told = in_a_fork(look)
    tests, slowed = told["tests"], told["failed"]
    for name in slowed:  # to be watched takes time, which some tests limit: they may have called anything
        tests[name]["starts"] = True
    status = in_a_fork(lambda: run(slowed)) if slowed else 0
    print(json.dumps({"status": status, "tests": tests}), flush=True)
    for line in sys.stdin:
        names = json.loads(line)
        limit_s = LEAST_LIMIT_S + ALL_TIMES * sum(tests[name]["seconds"] for name in names)
        status = in_a_fork(lambda names=names: run(names), limit_s)
        print(json.dumps(status), flush=True)


if __name__ == "__main__":
    main()
