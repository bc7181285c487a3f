# SPDX-License-Identifier: GPL-3.0-or-later
import multiprocessing
import operator
import os
import signal
import subprocess
import sys
import threading
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


def test_nothing_of_a_pool_is_left_when_its_tasks_are_done_or_given_up():
    before = set(threading.enumerate())  # of which an earlier test's may end meanwhile
    list(tasks.run(operator.sub, 10, INPUTS, processes=2))
    assert set(threading.enumerate()) <= before and not multiprocessing.active_children()
    given_up = tasks.run(operator.sub, 10, INPUTS, processes=2)
    next(given_up)
    given_up.close()
    assert set(threading.enumerate()) <= before and not multiprocessing.active_children()


def test_workers_end_with_a_parent_that_is_killed():
    code = "import signal; from gr_cast.core import tasks; list(tasks.run(signal.sigtimedwait, [], [60, 60], processes=2))"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen([sys.executable, "-c", code], env=environment, stderr=subprocess.DEVNULL) as parent:
        workers = wait_for(lambda: [pid for pid in children(parent.pid) if "spawn_main" in command(pid)][1:])
        parent.kill()
    wait_for(lambda: not any("spawn_main" in command(pid) for pid in workers))


def deadly(folder: Path, value: int) -> int:
    """Dies by SIGKILL for 3, always, and for 1 the first time."""
    first = folder / str(value)
    if value == 3 or value == 1 and not first.exists():
        first.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return -value


def test_a_killed_worker_loses_no_other_task(tmp_path):
    code = (
        "import sys, pickle; sys.path[:0] = sys.argv[1:3]\n"
        "import test_tasks\nfrom gr_cast.core import tasks\n"
        "if __name__ == '__main__':\n"
        "    from pathlib import Path\n"
        "    found = tasks.run(test_tasks.deadly, Path(sys.argv[3]), list(range(9)), processes=2, lost=lambda index: 'lost')\n"
        "    print(sorted(found))\n"
    )
    program = tmp_path / "program.py"
    program.write_text(code)
    package = str(Path(tasks.__file__).resolve().parents[2])
    command = [sys.executable, str(program), str(Path(__file__).parent), package, str(tmp_path)]
    told = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert told.stdout.strip() == str([(n, "lost" if n == 3 else -n) for n in range(9)]), told.stderr


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
