# SPDX-License-Identifier: GPL-3.0-or-later
import os
import subprocess
import sys

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


def test_a_flowgraph_runs_where_home_cannot_be_written_to(tmp_path):
    program = _program.__file__.replace("_program", "cast_sounder")
    nowhere = {"HOME": "/proc/self", "PATH": "/usr/bin:/bin"}
    command = [sys.executable, program, "run", "--frames", "20", "--output", str(tmp_path)]
    done = subprocess.run(command, env=nowhere, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0 and (tmp_path / "result.json").exists(), done.stderr
