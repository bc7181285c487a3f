# SPDX-License-Identifier: GPL-3.0-or-later
"""Clean rooms for commands of a stack: namespaces of their own where the system allows them, else a bare environment.

A folder is seen as /mnt; there is no network, no variable, no home of the caller's. `kind` says what was used, for provenance.
"""

import os
import shutil
import subprocess
import time
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from ..core.errors import CastError
from .patience import waited

KINDS = ("auto", "lxc", "namespaces", "process")
PATH = "/usr/local/bin:/usr/bin:/bin"
_FLAGS = ("--mount", "--net", "--ipc", "--pid", "--fork", "--kill-child", "--mount-proc")
_ENTER = 'mount --make-rprivate / && mount --bind "$0" /mnt && cd "/mnt/$1" && shift && exec "$@"'
_MOST_LOG = 1 << 20  # bytes of a command's output that are kept


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """How a command ended: `status` is None where it was stopped after its time, `wall_s` on the wall's clock."""

    status: int | None
    log: str
    wall_s: float = 0.0

    @property
    def last_line(self) -> str:
        lines = [line.strip() for line in self.log.splitlines() if line.strip()]
        return lines[-1] if lines else "without a word"

    def stopped_after(self, limit_s: float) -> str:
        """What is said of one that had its time, and more where the machine was busy."""
        busy = f", {self.wall_s:.3g} s on a busy machine" if self.wall_s > 1.2 * limit_s else ""
        return f"stopped after {limit_s:g} s{busy}: {self.last_line}"


@lru_cache
def has_namespaces() -> bool:
    """Whether this user may make them, as root or as root of a user namespace."""
    if shutil.which("unshare") is None:
        return False
    return subprocess.run([*_unshare(), "mount", "--make-rprivate", "/"], capture_output=True, check=False).returncode == 0


def _unshare() -> list[str]:
    return ["unshare", *([] if os.geteuid() == 0 else ["--user", "--map-root-user"]), *_FLAGS, "--"]


def chosen(kind: str, root: Path | None = None) -> "Room":
    """The room of a kind; `auto`: LXC where it is installed and a root file system is given, else namespaces, else a process."""
    has_lxc = shutil.which("lxc-execute") is not None and os.geteuid() == 0
    if kind == "lxc" and not (has_lxc and root):
        raise CastError("lxc: needs root, Debian's lxc, and a root file system (--root-filesystem)")
    if kind == "namespaces" and not has_namespaces():
        raise CastError("namespaces: not allowed here: needs root, or user namespaces that are not switched off")
    if kind == "auto":
        kind = "lxc" if root and has_lxc else "namespaces" if has_namespaces() else "process"
    return Room(kind=kind, root=root if kind == "lxc" else None)


@dataclass(frozen=True, kw_only=True)
class Room:
    """One kind of clean room."""

    kind: str
    root: Path | None = None

    def place(self, folder: Path) -> str:
        """What commands see `folder` as."""
        return str(folder.resolve()) if self.kind == "process" else "/mnt"

    def run(self, folder: Path, command: str, *, within: str, environment: dict[str, str], timeout_s: float) -> Outcome:
        """Run a command of a shell in `folder`/`within`, and end it with all that it started once it has had `timeout_s`."""
        words = ["env", "-i", *(f"{key}={value}" for key, value in sorted((_bare() | environment).items())), "sh", "-ec", command]
        log, cwd = folder / "output.log", folder / within
        if self.kind == "namespaces":
            words = [*_unshare(), "sh", "-ec", _ENTER, str(folder.resolve()), within, *words]
        elif self.kind == "lxc":
            words = ["lxc-execute", *self._container(folder), "--", "sh", "-ec", 'cd "$0" && exec "$@"', f"/mnt/{within}", *words]
        words = ["setpriv", "--pdeathsig", "KILL", *words]  # who starts it may be killed
        begun_s = time.monotonic()
        with open(log, "wb") as file:
            process = subprocess.Popen(
                words, cwd=cwd, stdout=file, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, start_new_session=True
            )
            try:
                status = waited(process, timeout_s)
            finally:
                _end(process)
        with open(log, "rb") as file:
            text = file.read(_MOST_LOG).decode(errors="replace")
        log.unlink()
        return Outcome(status=status, log=text, wall_s=time.monotonic() - begun_s)

    def _container(self, folder: Path) -> list[str]:
        """A container without network on a read-only root, for one command."""
        told = {
            "lxc.rootfs.path": f"dir:{self.root.resolve()}",
            "lxc.rootfs.options": "ro",
            "lxc.net.0.type": "empty",
            "lxc.mount.auto": "proc:mixed sys:ro",
            "lxc.mount.entry": f"{folder.resolve()} mnt none bind 0 0",
            "lxc.apparmor.profile": "unconfined",
        }
        path = folder / "container.conf"
        path.write_text("".join(f"{key} = {value}\n" for key, value in told.items()), encoding="utf-8")
        return ["--name", f"cast-{os.getpid()}-{folder.stat().st_ino}", "--rcfile", str(path)]


def _bare() -> dict[str, str]:
    """What every command finds: the same on every machine."""
    python = {"PYTHONHASHSEED": "0", "PYTHONDONTWRITEBYTECODE": "1"}
    return {"PATH": PATH, "HOME": "/nonexistent", "LANG": "C.UTF-8", "TZ": "UTC", "OPENBLAS_NUM_THREADS": "1"} | python


def _end(process: subprocess.Popen) -> None:
    """Kill what is left of a command's session."""
    try:
        os.killpg(process.pid, 9)
    except ProcessLookupError:
        pass
    process.wait()
