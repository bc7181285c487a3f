#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Arena with the real ray tracer, made three times: in one run, killed in every step and started again, on Dask workers.

All three must install the same content: exit status 1 where they do not. Kills are SIGKILL; what each left is printed.
Needs apps/install_raytracer.sh.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "apps"))
import _program
import numpy as np
import scipy.stats
import yaml
from gr_cast import scenario as sc
from gr_cast.core.errors import CastError
from gr_cast.scenario import zarr_file
from gr_cast.scenario.create.pipeline import STEPS

PROGRAM = Path(_program.__file__).with_name("cast_scenario.py")
PYTHON = Path(os.environ.get("CAST_RAYTRACER") or sc.data_folder() / "raytracer/bin/python")
ID = "bench"
POLL_S = 0.002
OF_TASKS = ("sampling", "parsing", "approximation")
CLUSTER = """
import sys
from distributed import LocalCluster
if __name__ == "__main__":
    with LocalCluster(n_workers=int(sys.argv[1]), threads_per_worker=1, dashboard_address=None) as cluster:
        print(cluster.scheduler_address, flush=True)
        sys.stdin.read()
"""


def shortened_arena(folder: Path, duration_s: float) -> Path:
    """The SPEC of Arena with so much movement, under an id of its own."""
    examples = sc.examples_folder()
    spec = yaml.safe_load((examples / "arena.yaml").read_text(encoding="utf-8"))
    spec["id"], spec["model"]["mesh"] = ID, str(examples / spec["model"]["mesh"])
    spec["sampling"]["duration_s"] = duration_s
    path = folder / f"{ID}.yaml"
    path.write_text(yaml.safe_dump(spec, sort_keys=False), encoding="utf-8")
    return path


class Create:
    """`cast_scenario.py create` of one SPEC, into a work folder and a catalogue of its own."""

    def __init__(self, folder: Path, spec: Path, *options: str):
        folder.mkdir()
        self.work, self.catalogue, self.log = folder / "work", folder / "catalogue", folder / "log"
        self.command = ["/usr/bin/python3", str(PROGRAM), "create", str(spec), "--work", str(self.work), *options]

    def start(self) -> subprocess.Popen:
        environment = os.environ | {"CAST_CATALOGUE": str(self.catalogue), "CAST_RAYTRACER": str(PYTHON)}
        with open(self.log, "ab") as log:
            return subprocess.Popen(self.command, stdout=log, stderr=log, env=environment)

    def to_the_end(self) -> str:
        """The hash of what is installed."""
        if self.start().wait():
            raise CastError(f"{self.log}: the run failed: {self.log.read_text(errors='replace').splitlines()[-1]}")
        return zarr_file.attributes(self.catalogue / f"{ID}.zarr")["content_sha256"]

    def tasks_done(self, step: str) -> int:
        return len(list((self.work / step).glob("*_*.pickle")))

    def kill_when(self, name: str, is_time: Callable[[], bool]) -> None:
        process = self.start()
        while process.poll() is None and not is_time():
            time.sleep(POLL_S)
        process.kill()
        if process.wait() != -signal.SIGKILL:
            raise CastError(f"{self.log}: the run ended before it was killed: {name}")
        record = self.work / "steps.json"
        steps = len(json.loads(record.read_text())) if record.exists() else 0
        tasks = ", ".join(f"{self.tasks_done(step)} of {step}" for step in OF_TASKS)
        installed = [path.name for path in self.catalogue.glob("*")] if self.catalogue.exists() else []
        print(f"  killed: {name}: {steps} steps were done, tasks: {tasks}, in the catalogue: {installed}", flush=True)

    def killed_in_every_step(self, tasks: dict[str, int]) -> str:
        """Each step is killed as it begins; those of `tasks` also after a third and two thirds of them, installing also
        while it writes."""
        for step in STEPS:
            self.kill_when(f"{step} begins", (self.work / step).exists)
            for part in (1, 2) if step in tasks else ():
                count = part * tasks[step] // 3
                self.kill_when(f"{count} tasks of {step}", lambda step=step, n=count: self.tasks_done(step) >= n)
        self.kill_when("installing writes", lambda: any(self.catalogue.glob(".aside*")))
        return self.to_the_end()


def loss_over_distance(made: sc.Scenario, block_s: float = 0.5) -> dict[str, float]:
    """Spearman's rank correlation of path loss (means over a block) with distance: still pairs, and pairs that move."""
    block = max(1, round(block_s / np.diff(made.time_s).min()))
    pairs = {"still": [], "moving": []}
    for tx, rx in made.links:
        apart_m = np.linalg.norm(made.position_m[tx] - made.position_m[rx], axis=1)
        loss_db = -sc.tap_power_db(made, (tx, rx))
        starts = range(0, len(apart_m) - len(apart_m) % block or 1, block)
        rows = [(apart_m[at : at + block].mean(), loss_db[at : at + block].mean()) for at in starts]
        pairs["still" if len(apart_m) == 1 else "moving"] += rows
    return {kind: float(scipy.stats.spearmanr(rows)[0]) for kind, rows in pairs.items()}


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="where the runs leave their results: a new one")
    parser.add_argument("--seconds", type=float, default=0.6, help="of movement (default 0.6; Arena as it ships: 10)")
    parser.add_argument("--workers", type=int, default=2, help="of Dask, on this machine (default 2)")
    args = parser.parse_args(argv)
    if not PYTHON.exists():
        raise CastError(f"{PYTHON}: no ray tracer: bash apps/install_raytracer.sh")
    folder = args.folder.absolute()
    folder.mkdir(parents=True)
    spec = shortened_arena(folder, args.seconds)
    hashes = set()

    def show(name: str, made: Callable[[], str]) -> None:
        start = time.monotonic()
        content = made()
        hashes.add(content)
        print(f"{name}: {content} in {time.monotonic() - start:.0f} s", flush=True)

    whole = Create(folder / "whole", spec)
    show("in one run", whole.to_the_end)
    law = loss_over_distance(sc.read(whole.catalogue / f"{ID}.zarr"))
    print("  path loss over distance, rank correlation: " + ", ".join(f"{law[kind]:.2f} of {kind} pairs" for kind in law))
    tasks = {step: whole.tasks_done(step) for step in OF_TASKS}
    killed = Create(folder / "killed", spec)
    show("killed in every step", lambda: killed.killed_in_every_step(tasks))
    environment = os.environ | {"PYTHONPATH": str(Path(sc.__file__).parents[2])}
    command = [str(PYTHON), "-W", "ignore", "-c", CLUSTER, str(args.workers)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, cwd=folder, env=environment, **pipes) as cluster:
        address = cluster.stdout.readline().strip()
        show(f"{args.workers} Dask workers", Create(folder / "dask", spec, "--dask", address).to_the_end)
        cluster.communicate()
    print("the same content three times" if len(hashes) == 1 else f"NOT THE SAME: {len(hashes)} contents")
    return int(len(hashes) > 1)


if __name__ == "__main__":
    _program.run(main)
