# SPDX-License-Identifier: GPL-3.0-or-later
"""Commands to a running emulator: one JSON object in, one out, over a ZeroMQ REP socket."""

import contextlib
import json
import threading

import zmq

from ..core.errors import CastError
from ..scenario import load
from .ports import address_to_bind

_KEYS = {
    "status": set(),
    "start": set(),
    "stop": set(),
    "quit": set(),
    "load": {"scenario"},
    "set_link": {"tx", "rx", "taps", "enabled"},
}


def obey(emulation, ended: threading.Event, command) -> dict:
    """Carry out one command, a dictionary; the answer holds `ok` and, where it failed, `errors`, a line each."""
    try:
        if not isinstance(command, dict) or command.get("command") not in _KEYS:
            raise CastError(f"command: got {command!r}, needs an object whose 'command' is one of {', '.join(_KEYS)}")
        name = command["command"]
        unknown = set(command) - _KEYS[name] - {"command"}
        if unknown:
            raise CastError(*(f"{name}: unknown key {key!r}" for key in sorted(unknown)))
        if name == "load":
            emulation.load(load(_text(command, "scenario")))
        elif name == "set_link":
            emulation.set_link(
                _text(command, "tx"),
                _text(command, "rx"),
                taps=_taps(command.get("taps")),
                enabled=_switch(command),
            )
        elif name in ("start", "stop"):
            emulation.switch(name == "start")
        elif name == "quit":
            ended.set()
        return {"ok": True, "status": emulation.status()}
    except CastError as error:
        return {"ok": False, "errors": list(error.faults)}


def _text(command: dict, key: str) -> str:
    if not isinstance(command.get(key), str):
        raise CastError(f"{command['command']}: {key}: got {command.get(key)!r}, needs a string")
    return command[key]


def _switch(command: dict) -> bool | None:
    enabled = command.get("enabled")
    if enabled is not None and not isinstance(enabled, bool):
        raise CastError(f"set_link: enabled: got {enabled!r}, needs true or false")
    return enabled


def _taps(taps) -> list[dict] | None:
    if taps is None:
        return None
    if not isinstance(taps, list):
        raise CastError(f"set_link: taps: got {taps!r}, needs a list")
    for number, tap in enumerate(taps, 1):
        names = {"delay_s", "gain_db"}
        good = isinstance(tap, dict) and names <= set(tap) <= names | {"phase_rad"}
        if not good or not all(_is_finite(value) for value in tap.values()) or tap["delay_s"] < 0:
            raise CastError(f"set_link: tap {number}: got {tap!r}, needs delay_s (0 s or more), gain_db and perhaps phase_rad")
    return taps


def _is_finite(value) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e9


class ControlServer:
    """Has `address` from the first, obeys the commands there with `obeying`; address None: nobody is listened to."""

    def __init__(self, address: str | None):
        self._socket = None
        if address is None:
            return
        self._socket = zmq.Context.instance().socket(zmq.REP)
        self._socket.setsockopt(zmq.LINGER, 200)
        try:
            self._socket.bind(address_to_bind("--control", address))
        except zmq.ZMQError as error:
            raise CastError(f"--control: address {address}: {error.strerror}") from None

    @contextlib.contextmanager
    def obeying(self, emulation, ended: threading.Event):
        """Commands to this emulation are obeyed in a thread while this is entered; `quit` sets `ended`."""
        closing = threading.Event()
        thread = threading.Thread(target=self._serve, args=(emulation, ended, closing), daemon=True)
        thread.start()
        try:
            yield
        finally:
            closing.set()
            thread.join()

    def _serve(self, emulation, ended: threading.Event, closing: threading.Event) -> None:
        while self._socket and not closing.is_set():
            if not self._socket.poll(100):
                continue
            try:
                command = json.loads(self._socket.recv())
            except ValueError:  # also text that is not UTF-8
                command = None
            self._socket.send_json(obey(emulation, ended, command))
        if self._socket:
            self._socket.close()
