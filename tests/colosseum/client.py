# SPDX-License-Identifier: GPL-3.0-or-later
"""Colosseum's own command line, unmodified, shut in: /tmp/socket is a folder of the test's, and it sees no process but its own,
for its `gps stop` ends by name whatever is called gpsd or socat. Or in a container, which shuts it in too."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BOUND = 'mkdir -p /tmp/socket; mount --bind "$0" /tmp/socket; exec "$@"'
# One process for many commands, and for bytes that are sent without the client; it tells the longest reply that came so far.
MANY = """
import contextlib, io, json, os, socket, sys

class Watched(socket.socket):
    longest = 0
    def recv(self, *limit):
        data = super().recv(*limit)
        Watched.longest = max(Watched.longest, len(data))
        return data

socket.socket = Watched
from colosseum_cli import colosseum_cli_constants as constants
from colosseum_cli.cli_app import ColCliApp

def run(*words):
    told = io.StringIO()
    with contextlib.redirect_stdout(told), contextlib.redirect_stderr(told):
        try:
            status = ColCliApp().run(list(words))
        except SystemExit as end:
            status = end.code
    return status, told.getvalue()

def send(*parts):
    with socket.socket(socket.AF_UNIX) as peer:
        peer.settimeout(20)
        peer.connect(constants.SOCKET_PATH)
        for part in parts:
            peer.sendall(part.encode("latin-1"))
        peer.shutdown(socket.SHUT_WR)
        return 0, peer.recv(3276800).decode()

for line in sys.stdin:
    what, *words = json.loads(line)
    print(json.dumps([*{"run": run, "send": send}[what](*words), Watched.longest]), flush=True)
"""
SWIFT = "import time\ntime.sleep = lambda seconds: None\n"  # the client's sleeps pass at once, where the time is the test's


def sources() -> tuple[Path, str]:
    """The folder of colosseum_cli and the Python that runs it."""
    for folder in (
        Path(os.environ.get("CAST_COLOSSEUMCLI", ROOT.parent / "stacks/colosseumcli")),
        ROOT.parents[1] / "stacks/colosseumcli",
    ):
        python = folder.parent / "colosseumcli-venv/bin/python"
        python = str(python) if python.exists() else sys.executable
        if (folder / "colosseum_cli").is_dir() and not subprocess.run(
            [python, "-c", "import cliff"], capture_output=True
        ).returncode:
            return folder, python
    pytest.skip("NO COLOSSEUMCLI: its sources, and a Python with cliff, at CAST_COLOSSEUMCLI or ../stacks/colosseumcli")


def put_entry_points(folder: Path, into: Path) -> None:
    """The client's entry points, as an installation would leave them."""
    info = into / "colosseumcli-19.0.0.dist-info"
    info.mkdir(parents=True)
    text = (folder / "setup.py").read_text()
    lines = [line.strip(" ',\n") for line in text.split("'cliff.colosseum': [")[1].split("]")[0].splitlines() if "=" in line]
    (info / "entry_points.txt").write_text("[cliff.colosseum]\n" + "\n".join(lines) + "\n")
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: colosseumcli\nVersion: 19.0.0\n")


def prepared(base: Path) -> tuple[list[str], dict[str, str]]:
    """(words before Python's own arguments, environment) with which the client finds itself, and base/socket its socket."""
    if os.geteuid() != 0:
        pytest.skip("NO ROOT: the client's socket stands at a fixed place, bound there for the client alone")
    folder, python = sources()
    put_entry_points(folder, base / "site")
    (base / "socket").mkdir()
    environment = os.environ | {"COLOSSEMCLI_TEST_MODE": "TRUE", "PYTHONPATH": f"{folder}:{base / 'site'}", "HOME": str(base)}
    return [
        "unshare",
        "--mount",
        "--pid",
        "--fork",
        "--kill-child",
        "--mount-proc",
        "sh",
        "-c",
        BOUND,
        str(base / "socket"),
        python,
    ], environment


def tidied() -> None:
    if Path("/tmp/socket").is_dir() and not any(Path("/tmp/socket").iterdir()):
        Path("/tmp/socket").rmdir()


def put_on_share(folder: Path) -> None:
    """The client, cliff and the program above as a folder that a container may see: `python3 FOLDER/many.py` runs them."""
    sources_, python = sources()
    where = "import cliff, sys; print(cliff.__path__[0]); sys.exit(sys.prefix == sys.base_prefix)"
    found = subprocess.run([python, "-c", where], capture_output=True, text=True)
    if found.returncode:
        pytest.skip("NO ENVIRONMENT OF CLIFF'S OWN: python3 -m venv ../stacks/colosseumcli-venv, and in it pip install cliff")
    left_out = shutil.ignore_patterns("__pycache__", "pip*", "setuptools*", "_distutils_hack", "pkg_resources", "*.pth")
    shutil.copytree(Path(found.stdout.strip()).parent, folder, ignore=left_out)
    shutil.copytree(sources_ / "colosseum_cli", folder / "colosseum_cli", ignore=left_out)
    put_entry_points(sources_, folder)
    (folder / "many.py").write_text(MANY)


class Client:
    """A process that runs one command after the other; each gives (exit status, what it printed). `longest`: of all replies."""

    def __init__(self, words: list[str], **more):
        self.longest = 0
        self._process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, **more)

    def run(self, *words: str) -> tuple[int, str]:
        return self._asked("run", *words)

    def send(self, *parts: bytes) -> dict:
        return json.loads(self._asked("send", *(part.decode("latin-1") for part in parts))[1])

    def _asked(self, *words: str) -> tuple[int, str]:
        self._process.stdin.write(json.dumps(words) + "\n")
        self._process.stdin.flush()
        status, told, self.longest = json.loads(self._process.stdout.readline())
        return status, told

    def close(self) -> None:
        self._process.stdin.close()
        self._process.wait(20)
        self._process.stdout.close()


def shut_in(base: Path) -> Client:
    words, environment = prepared(base)
    return Client([*words, "-c", SWIFT + MANY], cwd=base, env=environment)
