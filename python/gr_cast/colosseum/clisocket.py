# SPDX-License-Identifier: GPL-3.0-or-later
"""The socket of the command line: one request, one reply, then closed. The client reads its reply with one `recv`."""

import contextlib
import json
import os
import selectors
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from ..core.documents import is_cut, json_text
from ..core.errors import CastError
from .desk import REFUSED

MOST_BYTES = 64 * 1024  # of a reply
MOST_ASKED = 64 * 1024  # of a request: a radio map of 256 nodes has 14 kB
PATIENCE_S = 5.0  # for a request that was begun
MOST_WAITING = 4096  # connections that the kernel holds until they are accepted; its own limit may be lower
MOST_OPEN = 256  # connections that are open at once, of all sockets: then who has most of them loses the oldest
TEST_MODE = "COLOSSEMCLI_TEST_MODE"  # spelt so


def socket_path() -> Path:
    """Where the command line looks for its socket."""
    return Path("/tmp/socket/clisocket" if os.environ.get(TEST_MODE) == "TRUE" else "/socket/clisocket")


def request_of(data: bytes):
    """The request in what came; None where the rest of it may still come. Raises CastError for what can become none."""
    if len(data) > MOST_ASKED:
        raise CastError(f"request: got more than {MOST_ASKED} bytes, limit {MOST_ASKED} bytes")
    if is_cut(data):
        return None
    get = json_text(data, "request")
    get.faults.raise_if_any()
    return get.document


def reply_bytes(reply: dict) -> bytes:
    """A reply for the wire. A list that is too long is cut at its end, so that what comes is still JSON."""
    data = json.dumps(reply).encode()
    while len(data) > MOST_BYTES and isinstance(reply.get("data"), str):
        entries = json_text(reply["data"], "reply", kind=(list, dict)).document
        keep = int(len(entries) * MOST_BYTES / len(data) * 0.95)
        cut = entries[:keep] if isinstance(entries, list) else dict(list(entries.items())[:keep])
        reply = reply | {"data": json.dumps(cut), "message": f"{keep} of {len(entries)} entries: a reply has 64 kB"}
        data = json.dumps(reply).encode()
    return data


class Server:
    """Answers at one or more sockets until it is left; `answer(key, request)` gives the reply to what came at the socket of
    `key`, in one thread for all. Connections that ask nothing end after PATIENCE_S, or sooner where there are MOST_OPEN."""

    def __init__(self, paths: dict[object, Path], answer: Callable[[object, object], dict]):
        self._answer, self._paths = answer, paths
        self._selector = selectors.DefaultSelector()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self):
        for key, path in self._paths.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.unlink(missing_ok=True)
            listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            listener.bind(str(path))
            os.chmod(path, 0o666)
            listener.listen(MOST_WAITING)
            listener.setblocking(False)
            self._selector.register(listener, selectors.EVENT_READ, (key, None, 0.0))
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._closing.set()
        self._thread.join()
        for registered in list(self._selector.get_map().values()):
            registered.fileobj.close()
        self._selector.close()
        for path in self._paths.values():
            path.unlink(missing_ok=True)

    def _serve(self) -> None:
        while not self._closing.is_set():
            for registered, _ in self._selector.select(0.05):
                key, data, until_s = registered.data
                if registered.fileobj.fileno() < 0:  # closed since, for there were too many
                    continue
                if data is None:
                    self._accept(registered.fileobj, key)
                else:
                    self._read(registered.fileobj, key, data, until_s)
            now = time.monotonic()
            for registered in [r for r in self._selector.get_map().values() if r.data[1] is not None and r.data[2] < now]:
                self._send(registered.fileobj, _refusal(f"request: not whole after {PATIENCE_S:g} s"))
                self._close(registered.fileobj)

    def _accept(self, listener: socket.socket, key) -> None:
        """All that wait, so that who comes after them need not."""
        with contextlib.suppress(OSError):  # there is none more
            for _ in range(MOST_WAITING):
                peer, _ = listener.accept()
                peer.setblocking(False)
                self._selector.register(peer, selectors.EVENT_READ, (key, bytearray(), time.monotonic() + PATIENCE_S))
                self._keep_few()

    def _keep_few(self) -> None:
        """Close the oldest connection of the socket that has most, where there are more than MOST_OPEN."""
        idle = [one for one in self._selector.get_map().values() if one.data[1] is not None]
        if len(idle) > MOST_OPEN:
            busiest = Counter(one.data[0] for one in idle).most_common(1)[0][0]
            oldest = min((one for one in idle if one.data[0] == busiest), key=lambda one: one.data[2])
            self._send(oldest.fileobj, _refusal(f"request: none came, and more than {MOST_OPEN} connections are open"))
            self._close(oldest.fileobj)

    def _read(self, peer: socket.socket, key, data: bytearray, until_s: float) -> None:
        """Take what has come; answer once it is a whole request, or can become none: the client does not say where it ends."""
        try:
            came = peer.recv(MOST_ASKED)
        except OSError:
            came = b""
        is_answered = len(data) > MOST_ASKED  # what goes on coming is dropped, so that the reply can be read
        if not is_answered:
            data += came
            reply = self._reply_to(key, bytes(data), is_ended=not came)
            if reply is None:
                return
            self._send(peer, reply)
        if not came or len(data) <= MOST_ASKED:
            self._close(peer)

    def _reply_to(self, key, data: bytes, is_ended: bool) -> dict | None:
        """None while a request is not whole."""
        try:
            request = request_of(data)
            if request is None:
                return _refusal("request: ends before it is whole") if is_ended else None
            return self._answer(key, request)
        except CastError as error:
            return _refusal("; ".join(error.faults))

    def _send(self, peer: socket.socket, reply: dict) -> None:
        with contextlib.suppress(OSError):  # one that has left needs none
            peer.send(reply_bytes(reply), socket.MSG_NOSIGNAL)

    def _close(self, peer: socket.socket) -> None:
        self._selector.unregister(peer)
        peer.close()


def _refusal(text: str) -> dict:
    return {"status": REFUSED, "message": text[:2000]}
