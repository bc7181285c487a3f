# SPDX-License-Identifier: GPL-3.0-or-later
"""Colosseum's own command line, unmodified, shut in: /tmp/socket is a folder of the test's, and it sees no process but its own,
for its `gps stop` ends by name whatever is called gpsd or socat."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BOUND = 'mkdir -p /tmp/socket; mount --bind "$0" /tmp/socket; exec "$@"'
# One process for many commands: the client's sleeps pass at once, for the desk's time is the test's.
MANY = """
import contextlib, io, json, sys, time
time.sleep = lambda seconds: None
from colosseum_cli.cli_app import ColCliApp
for line in sys.stdin:
    told = io.StringIO()
    with contextlib.redirect_stdout(told), contextlib.redirect_stderr(told):
        try:
            status = ColCliApp().run(json.loads(line))
        except SystemExit as end:
            status = end.code
    print(json.dumps([status, told.getvalue()]), flush=True)
"""


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


def prepared(base: Path) -> tuple[list[str], dict[str, str]]:
    """(words before Python's own arguments, environment) with which the client finds itself, and base/socket its socket."""
    if os.geteuid() != 0:
        pytest.skip("NO ROOT: the client's socket stands at a fixed place, bound there for the client alone")
    folder, python = sources()
    info = base / "site" / "colosseumcli-19.0.0.dist-info"  # its entry points, as an installation would leave them
    info.mkdir(parents=True)
    (base / "socket").mkdir()
    text = (folder / "setup.py").read_text()
    lines = [line.strip(" ',\n") for line in text.split("'cliff.colosseum': [")[1].split("]")[0].splitlines() if "=" in line]
    (info / "entry_points.txt").write_text("[cliff.colosseum]\n" + "\n".join(lines) + "\n")
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: colosseumcli\nVersion: 19.0.0\n")
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


class Client:
    """Runs one command after the other; each gives (exit status, what it printed)."""

    def __init__(self, base: Path):
        words, environment = prepared(base)
        self._process = subprocess.Popen(
            [*words, "-c", MANY], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=base, env=environment
        )

    def run(self, *words: str) -> tuple[int, str]:
        self._process.stdin.write(json.dumps(words) + "\n")
        self._process.stdin.flush()
        return tuple(json.loads(self._process.stdout.readline()))

    def close(self) -> None:
        self._process.stdin.close()
        self._process.wait(20)
        self._process.stdout.close()
