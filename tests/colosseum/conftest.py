# SPDX-License-Identifier: GPL-3.0-or-later
"""Where containers are possible, a place for boxes that leaves nothing."""

import os
import shutil
import tempfile
from pathlib import Path

import pytest
from gr_cast.colosseum import box


@pytest.fixture
def boxes(monkeypatch):
    """A folder of boxes of its own. Skips where containers are not possible."""
    if os.geteuid() != 0:
        pytest.skip("NO ROOT: boxes of containers are tested as root")
    missing = [tool for tool in ("lxc-start", "ip", "nsenter", "setpriv") if shutil.which(tool) is None]
    if missing:
        pytest.skip(f"NO LXC: apt install lxc iproute2 ({', '.join(missing)} missing)")
    folder = Path(tempfile.mkdtemp(prefix="cb", dir="/tmp"))  # sockets have short names
    monkeypatch.setenv("CAST_BOXES", str(folder / "b"))
    yield folder
    for name, path in box.boxes().items():
        box.remove(name, path)
    shutil.rmtree(folder)
