# SPDX-License-Identifier: GPL-3.0-or-later
import operator
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from gr_cast.core import tasks
from gr_cast.core.errors import CastError

INPUTS = list(range(7))


@pytest.mark.parametrize("processes", [1, 2, 16])
def test_every_input_is_worked_on_once_with_what_all_share(processes):
    assert dict(tasks.run(operator.sub, 10, INPUTS, processes=processes)) == {n: 10 - n for n in INPUTS}
    assert not list(tasks.run(operator.sub, 10, [], processes=processes))


def test_workers_end_with_a_parent_that_is_killed():
    code = "import signal; from gr_cast.core import tasks; list(tasks.run(signal.sigtimedwait, [], [60, 60], processes=2))"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen([sys.executable, "-c", code], env=environment, stderr=subprocess.DEVNULL) as parent:
        workers = wait_for(lambda: [pid for pid in children(parent.pid) if "spawn_main" in command(pid)][1:])
        parent.kill()
    wait_for(lambda: not any("spawn_main" in command(pid) for pid in workers))


def children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def command(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_text()
    except OSError:
        return ""


def wait_for(condition):
    end = time.monotonic() + 50
    while not (value := condition()):
        assert time.monotonic() < end
        time.sleep(0.1)
    return value


def test_a_cluster_gives_what_this_machine_gives(dask_cluster):
    assert dict(tasks.run(operator.sub, 10, INPUTS, dask=dask_cluster(2))) == {n: 10 - n for n in INPUTS}


def test_a_cluster_that_cannot_work_is_named(dask_cluster, monkeypatch):
    monkeypatch.setattr(tasks, "_WAIT_S", 2)
    for address, says in ((dask_cluster(0), "no worker"), ("tcp://127.0.0.1:9", "no scheduler"), ("here", "no scheduler")):
        with pytest.raises(CastError, match=says):
            list(tasks.run(operator.sub, 10, INPUTS, dask=address))
