# SPDX-License-Identifier: GPL-3.0-or-later
"""What of this machine a box uses, and what of it is left when its runner was killed: found by its mark, and removed.

All that a box starts carries its folder in its environment (CAST_BOX) or stands in its control group; its interfaces live in
a network namespace of its own, which goes with the last process in it, and its mounts in those of its containers.
"""

import contextlib
import os
import shutil
import signal
import time
import zlib
from pathlib import Path

from ..core.errors import CastError

MARK = "CAST_BOX"
GROUP = "cast_box"
_NEEDED = {
    "lxc-start": "lxc",
    "lxc-attach": "lxc",
    "ip": "iproute2",
    "nsenter": "util-linux",
    "setpriv": "util-linux",
    "tar": "tar",
}
_PATIENCE_S = 10.0


def boxes_folder() -> Path:
    """Where boxes have their files: $CAST_BOXES, else /var/lib/cast_box."""
    return Path(os.environ.get("CAST_BOXES") or "/var/lib/cast_box")


def check_host() -> None:
    """Raises CastError with all that a box needs and this machine does not have."""
    faults = [] if os.geteuid() == 0 else ["box: got no root: LXC's containers, network namespaces and overlays need it (sudo)"]
    for tool, package in _NEEDED.items():
        if shutil.which(tool) is None:
            faults.append(f"box: {tool}: not installed (Debian: apt install {package})")
    if "overlay" not in Path("/proc/filesystems").read_text():
        faults.append("box: this kernel has no overlay file system (modprobe overlay)")
    if not any(line.split()[2] in ("cgroup", "cgroup2") for line in Path("/proc/mounts").read_text().splitlines()):
        faults.append("box: no control groups are mounted at /sys/fs/cgroup")
    if faults:
        raise CastError(*faults)


def started_at(pid: int) -> str:
    """When a process began, in the kernel's ticks; "" where there is none: numbers come again, both together do not."""
    with contextlib.suppress(OSError):
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return "" if fields[0] in "ZX" else fields[19]
    return ""


def group_of(folder: Path) -> str:
    """The control group of a box, below every hierarchy's root: boxes in two folders may have one name."""
    return f"{GROUP}/{folder.name}-{zlib.crc32(bytes(folder.resolve())):08x}"


def groups_of(folder: Path) -> list[Path]:
    """The control groups of a box, in every hierarchy."""
    roots = [
        Path(line.split()[1])
        for line in Path("/proc/mounts").read_text().splitlines()
        if line.split()[2] in ("cgroup", "cgroup2")
    ]
    name = group_of(folder)
    return [path for root in roots for path in (root / name, *root.glob(f"*/{name}"), *root.glob(f"*/*/{name}")) if path.is_dir()]


def processes_of(folder: Path) -> set[int]:
    """Every process of a box but this one, and but those that have no number here: 0 would stand for this one's whole group."""
    found, mark = set(), f"{MARK}={folder}".encode()
    for path in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if mark in (path / "environ").read_bytes().split(b"\0"):
                found.add(int(path.name))
    for group in groups_of(folder):
        for listing in group.rglob("cgroup.procs"):
            with contextlib.suppress(OSError):
                found |= {int(pid) for pid in listing.read_text().split()}
    return found - {os.getpid(), 0}


def sweep(folder: Path, name: str) -> list[str]:
    """End and remove all that is left of a box; what was found, in words."""
    removed = []
    until_s = time.monotonic() + _PATIENCE_S
    while left := processes_of(folder):
        if not removed:
            removed.append(f"{len(left)} processes")
        for pid in left:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        if time.monotonic() > until_s:
            raise CastError(f"{name}: processes {sorted(left)} do not end")
        time.sleep(0.02)
    groups = groups_of(folder)
    if groups:
        removed.append(f"{len(groups)} control groups")
    for group in groups:
        for path in sorted((p for p in group.rglob("*") if p.is_dir()), key=lambda p: -len(p.parts)):
            _remove_group(path)
        _remove_group(group)
        with contextlib.suppress(OSError):
            group.parent.rmdir()
    if folder.exists():
        shutil.rmtree(folder, onerror=_unless_gone)
        removed.append("its files")
    return removed


def _unless_gone(_function, _path, raised) -> None:
    """What another `down` removes at the same time is gone."""
    if not isinstance(raised[1], FileNotFoundError):
        raise raised[1]


def _remove_group(path: Path) -> None:
    """A group whose last process has just died is busy for a moment."""
    until_s = time.monotonic() + _PATIENCE_S
    while path.is_dir():
        try:
            path.rmdir()
        except OSError:
            if time.monotonic() > until_s:
                raise
            time.sleep(0.02)
