# SPDX-License-Identifier: GPL-3.0-or-later
"""One key for both ends of a control port: ZeroMQ's CURVE, which encrypts, and lets in nobody without it.

A key file holds a secret of the emulator's and one of those who ask it, and both ends hold the file. The client knows the
emulator by the first, the emulator a client by the second.
"""

import contextlib
import json
import os
import re
import stat
from dataclasses import dataclass
from pathlib import Path

import zmq
from zmq.auth.thread import ThreadAuthenticator
from zmq.utils import z85

from .documents import json_file
from .errors import CastError
from .files import written_aside

_ENDS = ("emulator", "client")
_SECRET = re.compile(r"[0-9a-f]{64}")  # 32 bytes


@dataclass(frozen=True, kw_only=True, repr=False)
class Key:
    """Secrets of both ends, 32 bytes each."""

    emulator: bytes
    client: bytes

    @contextlib.contextmanager
    def required_of(self, context: zmq.Context):
        """Sockets of `context` that `guard` was called on admit clients with this key, none else, while this is entered."""
        gate = ThreadAuthenticator(context)
        gate.start()
        gate.configure_curve_callback(credentials_provider=self)
        try:
            yield
        finally:
            gate.stop()

    def callback(self, domain: str, public: bytes) -> bool:
        """What ZeroMQ's gate asks: may the holder of this public key (Z85) come in?"""
        return public == _public(self.client)

    def guard(self, socket: zmq.Socket) -> None:
        """Before a socket is bound: it speaks with holders of the key."""
        socket.curve_server = True
        socket.curve_secretkey = z85.encode(self.emulator)

    def present(self, socket: zmq.Socket) -> None:
        """Before a socket is connected: it speaks with an emulator that has the key."""
        socket.curve_serverkey = _public(self.emulator)
        socket.curve_publickey, socket.curve_secretkey = _public(self.client), z85.encode(self.client)


def _public(secret: bytes) -> bytes:
    return zmq.curve_public(z85.encode(secret))


def write_key(path: str | Path) -> None:
    """Draw a key and write it where only this user reads it. Raises CastError where something is there already."""
    path = Path(path)
    if path.exists():
        raise CastError(f"{path}: is there; nothing is overwritten, choose another name")
    secrets = {end: z85.decode(zmq.curve_keypair()[1]).hex() for end in _ENDS}
    with written_aside(path) as aside, open(os.open(aside, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600), "w") as file:
        json.dump({"cast_key": 1, **secrets}, file, indent=1)


def read_key(path: str | Path) -> Key:
    """The key of a file. Raises CastError where it is none, or where other users of this machine have access to it."""
    get = json_file(path)
    mode = stat.S_IMODE(Path(path).stat().st_mode)
    if mode & 0o077:
        raise CastError(
            f"{path}: other users have access to this key (mode {mode:03o}): chmod 600 and, if in doubt, make another"
        )
    get.keys(get.document, "", {"cast_key", *_ENDS}, ("cast_key", *_ENDS))
    get.version("cast_key", 1)
    secrets = {end: get.document.get(end) for end in _ENDS}
    for end, secret in secrets.items():
        if end in get.document and not (isinstance(secret, str) and _SECRET.fullmatch(secret)):
            get.faults.add(end, "needs 64 hexadecimal digits")  # what it is stays unsaid: it may be most of a secret
    get.faults.raise_if_any()
    return Key(**{end: bytes.fromhex(secret) for end, secret in secrets.items()})
