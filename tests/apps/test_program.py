# SPDX-License-Identifier: GPL-3.0-or-later
import argparse
import os
import subprocess
import sys
from types import SimpleNamespace

import _program
import pytest


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_program_whose_output_is_read_no_more_leaves_without_a_word(unbuffered):
    read, write = os.pipe()
    os.close(read)
    command = [sys.executable, _program.__file__.replace("_program", "cast_scenario"), "list"]
    environment = os.environ | {"PYTHONUNBUFFERED": unbuffered}
    ended = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, env=environment, timeout=60)
    os.close(write)
    assert (ended.returncode, ended.stderr) == (141, b"")


def test_a_pipe_that_breaks_elsewhere_is_told(capsys):
    def sends_to_nobody():
        read, write = os.pipe()
        os.close(read)
        os.write(write, b"x")

    with pytest.raises(SystemExit) as leaves:
        _program.run(sends_to_nobody)
    assert leaves.value.code == 2 and capsys.readouterr().err == "error: system: Broken pipe\n"


FLOWGRAPH_AND_TRANSFORM = """
import glob, os, sys, tempfile
sys.path[:0] = sys.argv[1:]
import _program
from gr_cast import blocks
from gr_cast.scenario import catalogue
from gnuradio import fft, gr, blocks as stock
top = gr.top_block()
top.connect(stock.null_source(8), stock.head(8, 1000), blocks.channel_emulator(1, 1), stock.null_sink(8))
top.run()
fft.fft_vcc(64, True, [])
assert catalogue.data_folder() == __import__("pathlib").Path("/proc/self/.local/share/gr_cast")
print(os.environ["HOME"])
"""


def test_flowgraphs_and_transforms_run_where_home_cannot_be_written_to():
    apps = os.path.dirname(_program.__file__)
    nowhere = {"HOME": "/proc/self", "PATH": "/usr/bin:/bin"}
    command = [sys.executable, "-c", FLOWGRAPH_AND_TRANSFORM, apps]
    done = subprocess.run(command, env=nowhere, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert not os.path.exists(done.stdout.strip())


def test_options_that_can_mean_nothing_are_refused_a_line_each():
    ranges = {"seed": (0, 2**64 - 1, ""), "gain_db": (-400, 400, "dB"), "absent": (0, 1, "")}
    _program.check_ranges(SimpleNamespace(seed=2**64 - 1, gain_db=-400.0, more=None), ranges)
    with pytest.raises(_program.CastError) as refused:
        _program.check_ranges(SimpleNamespace(seed=-1, gain_db=float("nan")), ranges)
    assert refused.value.faults == ("--seed: got -1, needs 0 to 1.84467e+19", "--gain-db: got nan, needs -400 to 400 dB")


@pytest.mark.parametrize(
    ("text", "hz"), [("20e6", 20e6), ("20M", 20e6), ("30.72MS/s", 30.72e6), ("32k", 32e3), ("1G", 1e9), ("100Hz", 100), ("0", 0)]
)
def test_a_rate_is_read_alike_however_it_is_written(text, hz):
    assert _program.rate(text) == pytest.approx(hz)


@pytest.mark.parametrize("read, text", [(_program.rate, "11.52"), (_program.carrier, "2400")])
def test_megahertz_without_their_unit_are_questioned(read, text):
    with pytest.raises(argparse.ArgumentTypeError, match=f"is {text}M meant"):
        read(text)
    assert read(f"{text}M") == pytest.approx(float(text) * 1e6) and read(f"{text}Hz") == pytest.approx(float(text))


@pytest.mark.parametrize("text", ["", "fast", "1e6e", "20 M", "20MM"])
def test_what_is_no_rate_is_refused_with_an_example(text):
    with pytest.raises(argparse.ArgumentTypeError, match="such as 20e6, 20M or 30.72M"):
        _program.rate(text)


INTERRUPTED = """
import os, signal, sys, time
sys.path[:0] = sys.argv[1:]
import _program

def main():
    try:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(9)
    except KeyboardInterrupt:  # as a library does that is interrupted while it is being loaded
        raise ImportError("initialization failed") from None

_program.run(main)
"""


@pytest.mark.parametrize("text", ["-2e6", "-3", "-.5", "-1.5E+3"])
def test_a_negative_number_is_no_option_however_it_is_written(text):
    parser = argparse.ArgumentParser()
    command = parser.add_subparsers(dest="command").add_parser("run")
    command.add_argument("--offset", type=float)
    assert _program.parse(parser, ["run", "--offset", text]).offset == float(text)


def test_an_interrupt_that_a_library_makes_another_error_of_is_told_as_one():
    command = [sys.executable, "-c", INTERRUPTED, os.path.dirname(_program.__file__)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (130, "interrupted\n")


DROPPED = """
import os, signal, sys, time
sys.path.insert(0, sys.argv[1])
import _program

class Gone:
    def __del__(self):  # what is raised here, Python drops
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0)

def main():
    Gone()
    time.sleep(9)
    return 0

_program.run(main)
"""


def test_an_interrupt_that_python_drops_comes_again_and_is_told_in_one_word():
    command = [sys.executable, "-c", DROPPED, os.path.dirname(_program.__file__)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (130, "interrupted\n")


def test_progress_without_a_terminal_is_how_long_it_takes_a_line_a_minute_and_the_last(monkeypatch, capsys):
    clock = {"s": 1000.0}
    monkeypatch.setattr(_program.time, "monotonic", lambda: clock["s"])
    monkeypatch.setattr(_program, "_told_s", -float("inf"))
    for done in range(1, 301):
        _program.progress("tasks", done, 300)
        clock["s"] += 1.0
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(",")[0] for line in lines] == [f"tasks: {done} of 300" for done in (1, 2, 62, 122, 182, 242, 300)]


def test_what_is_short_goes_on_without_a_word_and_what_is_long_tells_how_far_it_is(monkeypatch, capsys):
    clock = {"s": 1000.0}
    monkeypatch.setattr(_program.time, "monotonic", lambda: clock["s"])
    monkeypatch.setattr(_program, "_told_s", -float("inf"))
    look = _program.patient("samples of a run", lambda: 10 * (clock["s"] - 1000), 3000)
    for clock["s"] in range(1000, 1301):
        look()
    told = [line.split(",")[0] for line in capsys.readouterr().err.splitlines()]
    assert told[0] == "samples of a run: 110 of 3000" and told[-1] == "samples of a run: 3000 of 3000" and len(told) == 7


def test_progress_on_a_terminal_is_one_line_that_changes(monkeypatch, capsys):
    monkeypatch.setattr(_program.sys.stderr, "isatty", lambda: True)
    for done in (1, 2, 3):
        _program.progress("tasks", done, 3)
    assert capsys.readouterr().err.count("\n") == 1 and not _program._shown
