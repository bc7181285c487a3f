# SPDX-License-Identifier: GPL-3.0-or-later
"""A server that judges every commit: Buildbot polls the repositories, and calls the same program that a person calls."""

import os
import shutil
import subprocess
from pathlib import Path

from ..core.errors import CastError
from ..core.files import write_json
from ..core.programs import installer
from .source import Source

CONFIGURATION = Path(__file__).with_name("master_cfg.py")
PROTOCOL = "tcp:9989"
_DRIVERS = {"psycopg": "'psycopg[binary]'", "psycopg2": "psycopg2-binary"}  # how PyPI calls what is imported
# Asked of Buildbot's own Python, which alone has SQLAlchemy: the module that an address needs, where it is missing.
_DRIVER = """
import sys, sqlalchemy
try:
    sqlalchemy.create_engine(sys.argv[1])
except ModuleNotFoundError as error:
    print(error.name)
except Exception as error:
    sys.exit(str(error).splitlines()[0])
"""


def python() -> Path:
    """The Python that has Buildbot. Raises CastError where there is none, with what to type."""
    home = os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share"
    found = Path(os.environ.get("CAST_SERVER") or Path(home) / "gr_cast" / "server" / "bin" / "python")
    if not found.with_name("buildbot").is_file():
        raise CastError(
            f"{found}: no Buildbot here: {installer()} --server installs it, or set CAST_SERVER to a Python that has it"
        )
    return found


def settings(
    *, storage: Path, repositories: list[str], branches: list[str], program: list[str], options: list[str], port: int,
    page: str, database: str | None, workers: dict[str, str], poll_s: float,
) -> dict:  # fmt: skip
    """What `master_cfg` reads: SQLite in the storage and a worker of this machine unless others are named."""
    sources = [Source(address, storage) for address in repositories]
    return {
        "repositories": [{"name": one.name, "address": one.address, "branches": branches} for one in sources],
        "program": program,
        "options": options,
        "port": f"tcp:{port}:interface=127.0.0.1",
        "address": f"http://127.0.0.1:{port}/",
        "page": page,
        "database": database or "sqlite:///state.sqlite",
        "workers": {name: str(Path(path).resolve()) for name, path in workers.items()},
        "worker_port": PROTOCOL,
        "poll_s": poll_s,
    }


def check_database(address: str) -> None:
    """Raises CastError where it is no address of a database, or its driver is not beside Buildbot."""
    found = python()
    done = subprocess.run([str(found), "-c", _DRIVER, address], capture_output=True, text=True, check=False)
    if done.returncode:
        raise CastError(f"--database: got {address!r}: {done.stderr.strip()}")
    if driver := done.stdout.strip():
        package = _DRIVERS.get(driver, driver)
        raise CastError(f"--database: its driver {driver} is not beside Buildbot: {found} -m pip install {package}")


def prepared(folder: Path, told: dict) -> list[str]:
    """The words that start a master in `folder`, which is made, or brought up to date, with its configuration checked."""
    check_database(told["database"])
    buildbot = str(python().with_name("buildbot"))
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "server.json", told)
    shutil.copyfile(CONFIGURATION, folder / "master.cfg")
    if not (folder / "buildbot.tac").is_file():
        _called(buildbot, "create-master", "--relocatable", "--log-size=10000000", str(folder))
    _called(buildbot, "checkconfig", str(folder))
    _called(buildbot, "upgrade-master", "--quiet", str(folder))
    return [buildbot, "start", "--nodaemon", str(folder)]


def _called(*words: str) -> None:
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode:
        lines = [line for line in (done.stdout + done.stderr).splitlines() if line.strip()]
        raise CastError(f"buildbot {words[1]}: {' '.join(lines[-3:]) or 'failed without a word'}")
