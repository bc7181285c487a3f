# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds the built package, and the recordings and cases that live outside the repository."""

import importlib.util
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import Phase, settings

ROOT = Path(__file__).resolve().parent.parent
BUILD = Path(os.environ.get("CAST_BUILD", ROOT / "build"))
sys.path.insert(0, str(BUILD / "python"))
sys.path += [str(ROOT / "apps"), str(ROOT / "tests")]
# A suite in the background inherits that interrupts are ignored, and so would every program that a test interrupts.
signal.signal(signal.SIGINT, signal.default_int_handler)
os.environ["GR_DONT_LOAD_PREFS"] = "1"
os.environ.setdefault("MPLBACKEND", "Agg")
# No test has a target to climb; looking for one takes half of a fuzz's time.
settings.register_profile("cast", phases=[phase for phase in Phase if phase is not Phase.target])
settings.load_profile("cast")


@pytest.fixture(scope="session")
def cast_data() -> Path:
    """The folder of real recordings and cases: CAST_DATA, or ../shared."""
    folder = Path(os.environ.get("CAST_DATA", ROOT.parent / "shared"))
    if not (folder / "real").is_dir():
        pytest.skip(f"NO REAL RECORDINGS at {folder}: set CAST_DATA to their folder")
    return folder


CLUSTER = """
import sys
from distributed import LocalCluster
if __name__ == "__main__":
    with LocalCluster(n_workers=int(sys.argv[1]), threads_per_worker=1, dashboard_address=None) as cluster:
        print(cluster.scheduler_address, flush=True)
        sys.stdin.read()
"""


@pytest.fixture(scope="session")
def dask_cluster(tmp_path_factory):
    """Address of a Dask scheduler with so many workers, processes of their own that stand in another folder."""
    if importlib.util.find_spec("distributed") is None:
        pytest.skip("NO DASK: apt-get install python3-distributed")
    folder = tmp_path_factory.mktemp("dask")
    (folder / "cluster.py").write_text(CLUSTER)
    # Idle workers look at themselves 100 times a second.
    quiet = {
        "WORKER__PROFILE__INTERVAL": "10s",
        "ADMIN__TICK__INTERVAL": "1s",
    }
    environment = os.environ | {"PYTHONPATH": str(BUILD / "python")} | {f"DASK_DISTRIBUTED__{k}": v for k, v in quiet.items()}
    started, addresses = [], {}

    def address(workers: int) -> str:
        if workers not in addresses:
            command = [sys.executable, "-W", "ignore", "cluster.py", str(workers)]
            pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL, "text": True}
            started.append(subprocess.Popen(command, cwd=folder, env=environment, **pipes))
            addresses[workers] = started[-1].stdout.readline().strip()
        return addresses[workers]

    yield address
    for cluster in started:
        cluster.communicate(timeout=60)
