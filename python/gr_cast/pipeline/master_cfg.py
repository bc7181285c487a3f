# SPDX-License-Identifier: GPL-3.0-or-later
"""Buildbot's configuration, read by Buildbot alone, in its own Python: `server.json` beside it says what to watch, and how."""

import json
from pathlib import Path

from buildbot.plugins import changes, schedulers, steps, util, worker

HERE = Path(__file__).parent
TOLD = json.loads((HERE / "server.json").read_text(encoding="utf-8"))
REMOTE = {name: Path(path).read_text(encoding="utf-8").strip() for name, path in TOLD["workers"].items()}
WORKERS = [worker.Worker(name, secret) for name, secret in REMOTE.items()] or [worker.LocalWorker("local")]
NAMES = [one.name for one in WORKERS]


def judge(repository: dict) -> util.BuildFactory:
    """One step: the same program that a person calls. It keeps its stages, so that a build that was cut goes on."""
    command = [*TOLD["program"], "run", util.Property("revision", default=util.Property("branch", default="HEAD"))]
    command += ["--repository", repository["address"], *TOLD["options"]]
    return util.BuildFactory([steps.ShellCommand(name="twin", command=command, timeout=None, haltOnFailure=True)])


BuildmasterConfig = c = {
    "title": "Twin and testbed",
    "titleURL": TOLD["page"],
    "buildbotURL": TOLD["address"],
    "buildbotNetUsageData": None,
    "db": {"db_url": TOLD["database"]},
    "workers": WORKERS,
    "protocols": {"pb": {"port": TOLD["worker_port"]}} if REMOTE else {"null": {}},
    "www": {"port": TOLD["port"], "plugins": {}},
    "collapseRequests": False,  # every commit is judged
    "change_source": [
        changes.GitPoller(
            repourl=one["address"],
            branches=one["branches"],
            project=one["name"],
            workdir=str(HERE / f"poller-{one['name']}"),
            pollInterval=TOLD["poll_s"],
            pollAtLaunch=True,
        )
        for one in TOLD["repositories"]
    ],
    "schedulers": [
        schedulers.AnyBranchScheduler(
            name=f"new-{one['name']}",
            change_filter=util.ChangeFilter(project=one["name"]),
            treeStableTimer=None,
            builderNames=[one["name"]],
        )
        for one in TOLD["repositories"]
    ]
    + [schedulers.ForceScheduler(name=f"again-{one['name']}", builderNames=[one["name"]]) for one in TOLD["repositories"]],
    "builders": [util.BuilderConfig(name=one["name"], workernames=NAMES, factory=judge(one)) for one in TOLD["repositories"]],
}
