# SPDX-License-Identifier: GPL-3.0-or-later
"""Ports of this machine for programs that listen: below those that the kernel lends to whoever connects to another."""

import os
import socket

_PORTS = iter(range(21000 + os.getpid() % 50 * 100, 32000, 2))


def free_port() -> int:
    """A port that is free, as is its next one, and that no call of this process returned before."""
    for port in _PORTS:
        with socket.socket() as one, socket.socket() as other:
            try:
                one.bind(("127.0.0.1", port))
                other.bind(("127.0.0.1", port + 1))
            except OSError:
                continue
            return port
    raise OSError("no port is free")


def free_address() -> str:
    return f"tcp://127.0.0.1:{free_port()}"
