# SPDX-License-Identifier: GPL-3.0-or-later
"""One standard radio node as an LXC container: its configuration, and what is asked of it while it runs."""

import os
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

from ..core.errors import CastError

# What a radio needs of root: its own network, its own files, real-time threads. No mounts, no devices, no clock, no modules.
CAPABILITIES = (
    "chown", "dac_override", "dac_read_search", "fowner", "fsetid", "kill", "setgid", "setuid", "setpcap", "net_bind_service",
    "net_broadcast", "net_admin", "net_raw", "sys_chroot", "sys_ptrace", "sys_nice", "sys_resource", "ipc_lock", "audit_write",
    "setfcap",
)  # fmt: skip
_DEVICES = ("c 1:3 rwm", "c 1:5 rwm", "c 1:7 rwm", "c 1:8 rwm", "c 1:9 rwm", "c 5:0 rwm", "c 5:1 rwm", "c 5:2 rwm", "c 136:* rwm")
_ETHERNET = "02:10"
_WAIT_S = 60.0
_STOP_S = 15.0
INIT = "#!/bin/sh\ntrap 'exit 0' TERM PWR\nwhile :; do sleep 3600 & wait $!; done\n"


@dataclass(frozen=True, kw_only=True)
class Wire:
    """An interface of a container: its name, and its other end's name outside."""

    name: str
    pair: str
    address: str


def hardware_address(address: str) -> str:
    """`02:10:` and the four bytes of an IPv4 address."""
    return ":".join([_ETHERNET, *(f"{int(part):02x}" for part in address.split("."))])


def configuration(*, name: str, root: Path, folder: Path, wires: list[Wire], mounts: dict[str, Path], group: str) -> str:
    """LXC's file for a container over the unpacked image `root`; all that it writes goes to `folder`."""
    init = root / "sbin/init"
    is_systemd = init.is_symlink() and "systemd" in os.readlink(init)
    cgroup = "cgroup2" if Path("/sys/fs/cgroup/cgroup.controllers").exists() else "cgroup"
    lines = [
        f"lxc.uts.name = {name}",
        f"lxc.rootfs.path = overlay:{root}:{folder}/upper",
        "lxc.mount.auto = proc:mixed sys:ro" + (" cgroup:mixed" if is_systemd else ""),
        "lxc.autodev = 1",
        "lxc.tty.max = 0",
        "lxc.pty.max = 64",
        f"lxc.cap.keep = {' '.join(CAPABILITIES + (('sys_admin',) if is_systemd else ()))}",
        "lxc.seccomp.profile = /usr/share/lxc/config/common.seccomp",
        "lxc.apparmor.profile = unconfined",
        f"lxc.init.cmd = {'/sbin/init' if init.is_symlink() or init.exists() else '/.init'}",
        f"lxc.cgroup.dir.container = {group}/container",
        f"lxc.cgroup.dir.monitor = {group}/monitor",
        f"lxc.cgroup.dir.monitor.pivot = {group}/pivot",
        f"lxc.{cgroup}.devices.deny = a",
        *(f"lxc.{cgroup}.devices.allow = {device}" for device in _DEVICES),
    ]
    for number, wire in enumerate(wires):
        network = wire.address.rpartition(".")[0]
        lines += [
            f"lxc.net.{number}.{key} = {value}"
            for key, value in (
                ("type", "veth"), ("name", wire.name), ("veth.pair", wire.pair), ("hwaddr", hardware_address(wire.address)),
                ("ipv4.address", f"{wire.address}/24 {network}.255"), ("flags", "up"),
            )
        ]  # fmt: skip
    if not wires:
        lines.append("lxc.net.0.type = empty")
    lines += [f"lxc.mount.entry = {path} {place.strip('/')} none bind,create=dir 0 0" for place, path in mounts.items()]
    return "\n".join(lines) + "\n"


class Container:
    """A container within a network namespace; `inside(*words)` runs `words` there. It ends with this process."""

    def __init__(self, name: str, lxc: Path, inside):
        self.name, self._lxc, self._inside = name, lxc, inside
        self._process = None

    def _words(self, tool: str, *words: str) -> list[str]:
        return self._inside(tool, "-P", str(self._lxc), "-n", self.name, *words)

    def start(self) -> None:
        log = self._lxc / self.name / "lxc.log"
        words = self._words("lxc-start", "-F", "-l", "WARN", "-o", str(log))
        with open(self._lxc / self.name / "console", "wb") as out:
            self._process = subprocess.Popen(
                ["setpriv", "--pdeathsig", "KILL", *words], stdin=subprocess.DEVNULL, stdout=out, stderr=out
            )

    def wait_until_running(self) -> None:
        """Raises CastError with LXC's own words where it does not start."""
        until_s = time.monotonic() + _WAIT_S
        while time.monotonic() < until_s and self._process.poll() is None:
            done = subprocess.run(self._words("lxc-info", "-s", "-H"), capture_output=True, text=True, check=False)
            if done.stdout.strip() == "RUNNING":
                return
            time.sleep(0.05)
        log = self._lxc / self.name / "lxc.log"
        lines = [line for line in log.read_text(errors="replace").splitlines() if "ERROR" in line] if log.exists() else []
        raise CastError(f"{self.name}: does not start: {lines[0].split(' - ')[-1] if lines else 'lxc-start ended'}")

    def pid(self) -> int:
        """Of its first process, as this machine numbers it."""
        done = subprocess.run(self._words("lxc-info", "-p", "-H"), capture_output=True, text=True, check=False)
        if not done.stdout.strip().isdecimal():
            raise CastError(f"{self.name}: has ended")
        return int(done.stdout)

    @property
    def is_running(self) -> bool:
        return self._process is not None and self._process.poll() is None

    def words(self, *words: str) -> list[str]:
        """The words that run `words` in the container, with nothing of this process's environment."""
        path = "PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
        return self._words("lxc-attach", "--clear-env", "-v", path, "-v", "HOME=/root", "--", *words)

    def run(self, *words: str, data: bytes = b"", timeout_s: float = 20.0) -> str:
        """Run a command of ours in the container. Raises CastError where it fails."""
        try:
            done = subprocess.run(self.words(*words), input=data, capture_output=True, check=False, timeout=timeout_s)
        except subprocess.TimeoutExpired:
            raise CastError(f"{self.name}: {' '.join(words)[:80]}: no end after {timeout_s:g} s") from None
        if done.returncode:
            raise CastError(f"{self.name}: {' '.join(words)[:80]}: {done.stderr.decode(errors='replace').strip()[-300:]}")
        return done.stdout.decode(errors="replace")

    def put(self, place: str, data: bytes) -> None:
        """Write a file in the container, by a process in there: no link of its leads out."""
        self.run("/bin/sh", "-c", 'mkdir -p "${0%/*}" && cat > "$0.new" && mv "$0.new" "$0"', place, data=data)

    def stop(self) -> None:
        if self._process is None:
            return
        try:
            if self._process.poll() is None:
                subprocess.run(self._words("lxc-stop", "-k"), capture_output=True, check=False, timeout=_STOP_S)
            self._process.wait(_STOP_S)
        except subprocess.TimeoutExpired:  # LXC waits until all are reaped, which not every machine's first process does
            self._process.kill()
            self._process.wait()
