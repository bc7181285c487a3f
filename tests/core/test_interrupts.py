# SPDX-License-Identifier: GPL-3.0-or-later
"""A signal at any moment ends a program, and a second one ends it at once, whatever lock the main thread holds."""

import os
import random
import signal
import subprocess
import sys
import time

import pytest

WAITING = """
import sys, threading
from gr_cast.core import interrupts
ended = threading.Event()
with interrupts.heeded({stop}) as came:
    print("ready", flush=True)
    while not ended.wait(1e-4):  # takes and lets go of the event's lock all the time
        {within}
print("tidied", came.is_set(), flush=True)
"""


def program(stop="ended.set", within="pass"):
    code = WAITING.format(stop=stop, within=within)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    started = subprocess.Popen(
        [sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert started.stdout.readline() == "ready\n"
    return started


@pytest.mark.parametrize("seed", range(12))
def test_signals_in_quick_succession_never_lock_up(seed):
    rng = random.Random(seed)
    running = program()
    time.sleep(rng.uniform(0, 0.02))
    for _ in range(2):
        running.send_signal(rng.choice([signal.SIGINT, signal.SIGTERM]))
        time.sleep(rng.uniform(0, 1e-3))
    running.communicate(timeout=10)  # that it ends is the law; with which status depends on the moment


def test_the_first_signal_lets_the_program_tidy_up():
    running = program()
    running.send_signal(signal.SIGTERM)
    assert running.communicate(timeout=10)[0] == "tidied True\n" and running.returncode == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_second_signal_ends_what_does_not_end_by_itself(number):
    running = program(stop="threading.Event().wait", within="pass")
    running.send_signal(signal.SIGINT)
    time.sleep(0.2)
    assert running.poll() is None
    running.send_signal(number)
    running.communicate(timeout=10)
    assert running.returncode == 128 + number


def test_handlers_are_as_before_afterwards():
    from gr_cast.core import interrupts

    before = [signal.getsignal(number) for number in interrupts.SIGNALS]
    descriptors = len(os.listdir("/proc/self/fd"))
    with interrupts.heeded(lambda: None) as came:
        assert [signal.getsignal(number) for number in interrupts.SIGNALS] != before
    assert [signal.getsignal(number) for number in interrupts.SIGNALS] == before and not came.is_set()
    assert len(os.listdir("/proc/self/fd")) == descriptors


AT_WORK = """
import time
from gr_cast.core import interrupts
interrupts.{how}()
try:
    print("ready", flush=True)
    time.sleep(30)
finally:
    print("tidied", flush=True)
    time.sleep({longer})
"""


def at_work(how, longer=0):
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    code = AT_WORK.format(how=how, longer=longer)
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    started = subprocess.Popen([sys.executable, "-c", code], env=environment, **pipes)
    assert started.stdout.readline() == "ready\n"
    return started


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_program_that_is_being_loaded_ends_in_one_word(number):
    running = at_work("end_quietly")
    running.send_signal(number)
    assert running.communicate(timeout=10) == ("", "interrupted\n") and running.returncode == 130


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_program_at_work_tidies_up_and_a_second_signal_ends_it(number):
    running = at_work("second_ends")
    running.send_signal(number)
    told, errors = running.communicate(timeout=10)
    assert told == "tidied\n" and errors.endswith("KeyboardInterrupt\n")
    running = at_work("second_ends", longer=30)
    running.send_signal(number)
    assert running.stdout.readline() == "tidied\n"
    running.send_signal(number)
    running.communicate(timeout=10)
    assert running.returncode == -number


SWALLOWED = """
import os, signal, threading
from gr_cast.core import interrupts
interrupts.second_ends()
try:  # as libraries do around what may be missing, which an interrupt then passes for
    os.kill(os.getpid(), signal.SIGINT)
    import gr_cast.core.errors
except BaseException:
    pass
ended = threading.Event()
with interrupts.heeded(ended.set) as came:
    ended.wait(20)
    print("played on" if not ended.is_set() else "stopped", flush=True)
"""
SWALLOWED_WITHOUT_SAMPLES = """
import os, signal, time
from gr_cast.core import interrupts
interrupts.second_ends()
class Dropping:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
def swallowing():
    try:
        os.kill(os.getpid(), signal.SIGINT)
    except BaseException:
        pass
{how}()
try:
    try:
        time.sleep(20)
        print("played on", flush=True)
    except BaseException:
        try:
            raise OSError("what tidies up may meet faults of its own")
        except OSError:
            time.sleep(1)
        print("tidied", flush=True)
        raise
except KeyboardInterrupt:
    interrupts.settled()
time.sleep(1)
print("went on", flush=True)
"""
TOGETHER = """
import os, signal, time
from gr_cast.core import interrupts
interrupts.second_ends()
signal.pthread_sigmask(signal.SIG_BLOCK, interrupts.SIGNALS)
for number in interrupts.SIGNALS:
    os.kill(os.getpid(), number)
try:
    signal.pthread_sigmask(signal.SIG_UNBLOCK, interrupts.SIGNALS)
finally:
    time.sleep(20)
    print("played on", flush=True)
"""
BETWEEN = """
import os, signal, sys, threading
from gr_cast.core import interrupts
interrupts.second_ends()
name, moment = sys.argv[1:]
changed = getattr(signal, name)
calls = 0
def slow(*given, **more):  # the signal comes while handlers are changed, before or after this one is
    global calls
    calls += 1
    if calls == 1 and moment == "before":
        os.kill(os.getpid(), signal.SIGINT)
    before = changed(*given, **more)
    if calls == 1 and moment == "after":
        os.kill(os.getpid(), signal.SIGINT)
    return before
setattr(signal, name, slow)
ended = threading.Event()
with interrupts.heeded(ended.set) as came:
    setattr(signal, name, changed)
    ended.wait(20)
    print("played on" if not ended.is_set() else "stopped", flush=True)
"""


def ends(code, *words):
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, "-c", code, *words], env=environment, capture_output=True, text=True, timeout=60)
    assert "played on" not in done.stdout
    return done


def test_a_signal_that_a_library_swallowed_is_not_forgotten():
    ends(SWALLOWED)


@pytest.mark.parametrize("how", ["swallowing", "Dropping"])
def test_a_swallowed_signal_comes_again_until_somebody_hears_of_it_and_not_into_tidying_up(how):
    done = ends(SWALLOWED_WITHOUT_SAMPLES.format(how=how))
    assert (done.stdout, done.stderr, done.returncode) == ("tidied\nwent on\n", "", 0)


def test_two_signals_at_one_moment_are_a_first_and_a_second():
    done = ends(TOGETHER)
    assert done.returncode == -signal.SIGTERM and done.stderr == ""


@pytest.mark.parametrize("moment", ["before", "after"])
@pytest.mark.parametrize("name", ["signal", "set_wakeup_fd"])
def test_a_signal_while_handlers_are_changed_is_not_lost(name, moment):
    ends(BETWEEN, name, moment)


TIDYING = """
import time
from gr_cast.core import interrupts
interrupts.second_ends()
try:
    with interrupts.held_back():
        print("ready", flush=True)
        time.sleep(0.5)
        print("whole", flush=True)
except KeyboardInterrupt:
    print("then", flush=True)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_first_signal_waits_for_the_end_of_tidying_up_and_a_second_one_does_not(number):
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    for signals, told, status in ((1, "whole\nthen\n", 0), (2, "", -number)):
        running = subprocess.Popen([sys.executable, "-c", TIDYING], env=environment, stdout=subprocess.PIPE, text=True)
        assert running.stdout.readline() == "ready\n"
        for _ in range(signals):
            running.send_signal(number)
            time.sleep(0.1)
        assert (running.communicate(timeout=10)[0], running.returncode) == (told, status)


def test_a_folder_is_whole_in_its_place_though_an_interrupt_comes_while_it_takes_it(tmp_path):
    code = """if True:
        import os, signal, sys
        from gr_cast.core import files, interrupts
        interrupts.second_ends()
        real = os.replace
        def replace(source, target):
            real(source, target)
            signal.raise_signal(signal.SIGINT) if "before" in str(target) else None
        os.replace = replace
        try:
            with files.written_aside(sys.argv[1]) as aside:
                aside.mkdir()
                (aside / "new").touch()
        except KeyboardInterrupt:
            print("then")"""
    (tmp_path / "out").mkdir()
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-c", code, tmp_path / "out"], env=environment, capture_output=True, text=True, check=False
    )
    assert done.stdout == "then\n", done.stderr
    assert [path.name for path in tmp_path.rglob("*")] == ["out", "new"]
