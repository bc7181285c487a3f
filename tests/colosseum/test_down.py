# SPDX-License-Identifier: GPL-3.0-or-later
"""Boxes are removed whoever else removes them at the same time."""

import json
import subprocess
import sys
import threading

import pytest
from gr_cast.colosseum import box, host

# Ends as a box does: what it says of itself goes first, then the rest.
HOLDER = """
import os, signal, sys, time
def end(*_):
    os.unlink(f"{sys.argv[1]}/box.json")
    time.sleep(0.5)
    sys.exit()
signal.signal(signal.SIGTERM, end)
print(os.getpid(), flush=True)
time.sleep(60)
"""


def test_down_waits_for_the_runner_to_have_ended_and_not_for_its_file_to_be_gone(tmp_path):
    with subprocess.Popen([sys.executable, "-c", HOLDER, str(tmp_path)], stdout=subprocess.PIPE, text=True) as holder:
        pid = int(holder.stdout.readline())
        (tmp_path / "box.json").write_text(json.dumps({"name": "b", "pid": pid, "started": host.started_at(pid)}))
        box.remove("b", tmp_path)
        assert host.started_at(pid) == "" and not tmp_path.exists()
        assert holder.wait(10) == 0


def test_two_that_remove_one_box_do_not_fail(tmp_path):
    for number in range(20):
        folder, failed = tmp_path / str(number), []
        for one in range(100):
            (folder / str(one) / "share").mkdir(parents=True)

        def sweep(folder=folder, failed=failed):
            try:
                host.sweep(folder, folder.name)
            except OSError as error:
                failed.append(error)

        sweepers = [threading.Thread(target=sweep) for _ in range(4)]
        for sweeper in sweepers:
            sweeper.start()
        for sweeper in sweepers:
            sweeper.join()
        assert failed == [] and not folder.exists()


def test_what_cannot_be_removed_is_told(tmp_path, monkeypatch):
    (tmp_path / "box").mkdir()

    def denied(*_, **__):
        raise PermissionError("denied")

    monkeypatch.setattr(host.os, "rmdir", denied)
    with pytest.raises(PermissionError):
        host.sweep(tmp_path / "box", "box")


def test_a_process_that_has_no_number_here_is_none_that_could_be_killed(tmp_path, monkeypatch):
    """In a namespace of processes of its own a control group lists those outside as 0, and kill(0) ends the caller's group."""
    (tmp_path / "cgroup.procs").write_text("0\n")
    monkeypatch.setattr(host, "groups_of", lambda _: [tmp_path])
    assert host.processes_of(tmp_path / "box") == set()
