# SPDX-License-Identifier: GPL-3.0-or-later
"""What every receiver found, told to all others over the collaboration network, for as long as one may still miss it."""

import fcntl
import json
import socket
import struct
import threading
import time

from ...core.documents import json_text
from ...core.errors import CastError

_INTERFACE = "col0"
_SIOCGIFBRDADDR = 0x8919  # linux/sockios.h
_EVERY_S = 0.3
_LINGER_S = 600.0
_PATIENCE_S = 20.0  # for the others' once all are asked to stop


def gathered(node: int, own: dict, nodes: int, port: int, ended: threading.Event) -> dict[int, dict]:
    """Receiver to its losses, of all that were heard of until some seconds after `ended`. Without the network, the own alone."""
    columns = {node: own}
    address = broadcast_address()
    if address is None:
        return columns
    peer = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    peer.bind(("", port))
    peer.settimeout(_EVERY_S)
    data = json.dumps({"receiver": node, "path_loss_db": own}).encode()
    until_s = None
    while len(columns) < nodes and (until_s is None or time.monotonic() < until_s):
        if ended.is_set() and until_s is None:
            until_s = time.monotonic() + _PATIENCE_S
        _tell(peer, data, address, port)
        _hear(peer, columns, nodes)
    threading.Thread(target=_go_on, args=(peer, data, address, port), daemon=True).start()
    return columns


def _go_on(peer: socket.socket, data: bytes, address: str, port: int) -> None:
    until_s = time.monotonic() + _LINGER_S
    while time.monotonic() < until_s:
        _tell(peer, data, address, port)
        time.sleep(_EVERY_S)


def _tell(peer: socket.socket, data: bytes, address: str, port: int) -> None:
    try:
        peer.sendto(data, (address, port))
    except OSError:
        return  # the network may come back


def _hear(peer: socket.socket, columns: dict, nodes: int) -> None:
    """Take what has come; anything that is no column is not ours."""
    try:
        while True:
            told = json_text(peer.recv(65536), "column").document
            receiver, losses = told["receiver"], told["path_loss_db"]
            if isinstance(receiver, int) and 1 <= receiver <= nodes and isinstance(losses, dict):
                columns.setdefault(receiver, losses)
            peer.settimeout(0.01)
    except TimeoutError:
        peer.settimeout(_EVERY_S)
    except (CastError, OSError, ValueError, KeyError, TypeError):
        return


def broadcast_address() -> str | None:
    """Of the collaboration network; None where this node has none."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        try:
            answer = fcntl.ioctl(any_socket, _SIOCGIFBRDADDR, struct.pack("256s", _INTERFACE.encode()))
        except OSError:
            return None
    return socket.inet_ntoa(answer[20:24])
