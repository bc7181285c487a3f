# SPDX-License-Identifier: GPL-3.0-or-later
"""Nodes as network namespaces of this machine, joined by a wire or by TUN devices that the caller reads and writes."""

import errno
import fcntl
import os
import shutil
import struct
import subprocess
import sys

from ...core.errors import CastError

_TUNSETIFF, _IFF_TUN, _IFF_NO_PI = 0x400454CA, 0x0001, 0x1000  # linux/if_tun.h
_TUN = "/dev/net/tun"
MTU = 1500


def run_with_rights(argv: list[str]) -> None:
    """Go on as root of a new user namespace where the caller is not root; nothing happens for root.

    Raises CastError where the system allows neither.
    """
    for tool in ("unshare", "nsenter", "setpriv", "ip"):
        if shutil.which(tool) is None:
            raise CastError(f"namespaces: {tool} is missing (Debian: util-linux, iproute2)")
    rights = [] if os.geteuid() == 0 else ["--user", "--map-root-user"]
    tried = subprocess.run(["unshare", *rights, "--net", "true"], capture_output=True, text=True, check=False)
    if tried.returncode:
        raise CastError(
            f"namespaces: {_last_line(tried.stderr)}: needs root with CAP_SYS_ADMIN, or user namespaces that are not switched off"
        )
    if rights:
        sys.stdout.flush()
        os.execvp("unshare", ["unshare", *rights, "--net", sys.executable, *argv])


def _last_line(text: str) -> str:
    return (text.strip().splitlines() or ["failed without a word"])[-1]


class Namespace:
    """A network namespace that lives until `close()`, or until this process dies."""

    def __init__(self, name: str, address: str):
        self.name, self.address = name, address
        # It ends with its standard input, which the kernel closes whatever becomes of this process.
        self._holder = subprocess.Popen(["unshare", "--net", "cat"], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        try:
            self._holder.stdin.write(b"up\n")
            self._holder.stdin.flush()
        except BrokenPipeError:
            pass
        if self._holder.stdout.readline() != b"up\n":
            self.close()
            raise CastError(f"namespaces: node {name}: unshare --net failed")
        self.run("ip", "link", "set", "lo", "up")

    @property
    def pid(self) -> int:
        """Of the process that holds it."""
        return self._holder.pid

    def command(self, *words: str) -> list[str]:
        """The words that run `words` in here."""
        return ["nsenter", f"--net=/proc/{self.pid}/ns/net", *words]

    def run(self, *words: str) -> None:
        done = subprocess.run(self.command(*words), capture_output=True, text=True, check=False)
        if done.returncode:
            raise CastError(f"node {self.name}: {' '.join(words)}: {_last_line(done.stderr)}")

    def join(self, other: "Namespace") -> None:
        """A wire from here to another namespace, addresses at both ends."""
        self.run("ip", "link", "add", "cast0", "type", "veth", "peer", "name", "cast0", "netns", str(other.pid))
        for end in (self, other):
            end._up("cast0")

    def open_tun(self) -> int:
        """A TUN device in here; packets sent into it are read from the file that is returned, and the other way."""
        try:
            file = os.open(_TUN, os.O_RDWR)
        except OSError as error:
            hint = "needs root, or the right to read and write it"
            if error.errno == errno.ENOENT:
                hint = "modprobe tun, or give the container --device /dev/net/tun"
            raise CastError(f"{_TUN}: {error.strerror}: {hint}") from None
        try:
            answer = fcntl.ioctl(file, _TUNSETIFF, struct.pack("16sH22x", b"cast%d", _IFF_TUN | _IFF_NO_PI))
        except OSError as error:
            os.close(file)
            raise CastError(f"{_TUN}: cannot make a device: {error.strerror}: needs CAP_NET_ADMIN") from None
        device = answer[:16].rstrip(b"\0").decode()
        moved = ["ip", "link", "set", device, "netns", str(self.pid), "name", "cast0"]
        done = subprocess.run(moved, capture_output=True, text=True, check=False)
        if done.returncode:
            os.close(file)
            raise CastError(f"node {self.name}: {' '.join(moved)}: {_last_line(done.stderr)}")
        self._up("cast0")
        return file

    def _up(self, device: str) -> None:
        self.run("ip", "address", "add", f"{self.address}/24", "dev", device)
        self.run("ip", "link", "set", device, "mtu", str(MTU), "up")

    def close(self) -> None:
        self._holder.stdin.close()
        self._holder.wait()
        self._holder.stdout.close()
