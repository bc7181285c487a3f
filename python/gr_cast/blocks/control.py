# SPDX-License-Identifier: GPL-3.0-or-later
"""Commands to a running emulator: one JSON object in, one out, over a ZeroMQ REP socket."""

import contextlib
import ipaddress
import threading
import traceback
from pathlib import Path

import zmq

from ..core.documents import is_number, json_text, short
from ..core.errors import CastError
from ..core.keys import Key
from ..emulation.reference import filter_length
from ..scenario import catalogue
from .ports import address_to_bind

MOST_BYTES = 1 << 20  # of a request
MOST_GAIN_DB = 120.0  # of a tap that is set by hand, up or down
MOST_NOISE_DB = 300.0  # of a power or a ratio, up or down
_KEYS = {
    "status": set(),
    "start": set(),
    "stop": set(),
    "quit": set(),
    "load": {"scenario", "cycle"},
    "set_link": {"tx", "rx", "taps", "enabled"},
    "set_noise": {"power_db", "snr_db"},
}


def obey(emulation, ended: threading.Event, command, folders: tuple[Path, ...] | None = None) -> dict:
    """Carry out one command, a dictionary; the answer holds `ok` and, where it failed, `errors`, a line each.

    `folders`: where scenario files may lie that `load` names, beside the catalogue's ids; None: anywhere.
    """
    try:
        if not isinstance(command, dict) or not isinstance(command.get("command"), str) or command["command"] not in _KEYS:
            raise CastError(f"command: got {short(command)}, needs an object whose 'command' is one of {', '.join(_KEYS)}")
        name = command["command"]
        unknown = set(command) - _KEYS[name] - {"command"}
        if unknown:
            raise CastError(*(f"{name}: unknown key {short(key)}" for key in sorted(unknown)))
        if name == "load":
            emulation.load(_scenario(_text(command, "scenario"), folders), _switch(command, "cycle"))
        elif name == "set_link":
            emulation.set_link(
                _text(command, "tx"),
                _text(command, "rx"),
                taps=_taps(command.get("taps"), emulation.sample_rate_hz),
                enabled=_switch(command, "enabled"),
            )
        elif name == "set_noise":
            emulation.set_noise(**_noise(command))
        elif name in ("start", "stop"):
            emulation.switch(name == "start")
        elif name == "quit":
            ended.set()
        return {"ok": True, "status": emulation.status()}
    except CastError as error:
        return {"ok": False, "errors": list(error.faults)}
    except OSError as error:
        return {"ok": False, "errors": [f"{command['command']}: {error.strerror}"]}


def _scenario(name: str, folders: tuple[Path, ...] | None):
    """The scenario of that catalogue id or file; what a peer may not read is refused before it is opened."""
    if name in catalogue.catalogue_entries():
        return catalogue.load(name)
    path = Path(name.replace("\0", "")).resolve()
    if folders is not None and not any(path.is_relative_to(folder.resolve()) for folder in folders):
        raise CastError("load: scenario: needs an id of the catalogue, or a file in a folder that --allow-load names")
    return catalogue.read(path)


def _text(command: dict, key: str) -> str:
    if not isinstance(command.get(key), str):
        raise CastError(f"{command['command']}: {key}: got {short(command.get(key))}, needs a string")
    return command[key]


def _switch(command: dict, key: str) -> bool | None:
    value = command.get(key)
    if value is not None and not isinstance(value, bool):
        raise CastError(f"{command['command']}: {key}: got {short(value)}, needs true or false")
    return value


def _noise(command: dict) -> dict[str, float]:
    given = {key: command[key] for key in ("power_db", "snr_db") if key in command}
    if len(given) != 1 or not all(_is_sane(value) and abs(value) <= MOST_NOISE_DB for value in given.values()):
        raise CastError(f"set_noise: got {short(given)}, needs power_db or snr_db, within ±{MOST_NOISE_DB:g} dB")
    return given


def _taps(taps, sample_rate_hz: float) -> list[dict] | None:
    if taps is None:
        return None
    if not isinstance(taps, list):
        raise CastError(f"set_link: taps: got {short(taps)}, needs a list")
    longest_s = filter_length(sample_rate_hz) / sample_rate_hz
    for number, tap in enumerate(taps, 1):
        names = {"delay_s", "gain_db"}
        good = isinstance(tap, dict) and names <= set(tap) <= names | {"phase_rad"} and all(map(_is_sane, tap.values()))
        if not good or not 0 <= tap["delay_s"] <= longest_s or abs(tap["gain_db"]) > MOST_GAIN_DB:
            raise CastError(
                f"set_link: tap {number}: got {short(tap)}, needs delay_s (0 to {longest_s:.3g} s), "
                f"gain_db (−{MOST_GAIN_DB:g} to {MOST_GAIN_DB:g} dB) and perhaps phase_rad"
            )
    return taps


def _is_sane(value) -> bool:
    return is_number(value) and abs(value) < 1e9


def command_of(parts: list[bytes]):
    """The command in a request's parts; None where there is none to be read."""
    if len(parts) != 1 or len(parts[0]) > MOST_BYTES:
        return None
    try:
        get = json_text(parts[0], "command")
    except CastError:
        return None
    return None if get.faults else get.document


def is_local(address: str) -> bool:
    """Whether nobody but this machine's users reaches a ZeroMQ address."""
    transport, _, where = address.partition("://")
    host = where.rpartition(":")[0].strip("[]")
    if transport != "tcp":
        return True
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return host == "localhost"


class ControlServer:
    """Has `address` until it is left, obeys the commands there with `obeying`; address None: nobody is listened to.

    Whoever reaches the address commands the emulator, or with a `key` whoever holds it. From this machine it may load any
    scenario file; from elsewhere the catalogue's and those in `folders`.
    """

    def __init__(self, address: str | None, folders: tuple[Path, ...] = (), key: Key | None = None):
        self._socket = None
        self._folders = None if address is None or is_local(address) else folders
        with contextlib.ExitStack() as opened:
            if address is not None:
                context = opened.enter_context(zmq.Context())  # of its own: a gate is that of a whole context
                if key:
                    opened.enter_context(key.required_of(context))
                self._socket = opened.enter_context(context.socket(zmq.REP))
                self._bind(address, key)
            self._opened = opened.pop_all()

    def _bind(self, address: str, key: Key | None) -> None:
        self._socket.setsockopt(zmq.LINGER, 200)
        self._socket.setsockopt(zmq.MAXMSGSIZE, MOST_BYTES)
        if key:
            key.guard(self._socket)
        try:
            self._socket.bind(address_to_bind("--control", address))
        except zmq.ZMQError as error:
            raise CastError(f"--control: address {address}: {error.strerror}") from None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._opened.close()

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
            command = command_of(self._socket.recv_multipart())
            try:
                answer = obey(emulation, ended, command, self._folders)
            except Exception as error:  # a fault of ours: whoever asks is told, and the next one has an answer too
                traceback.print_exc()
                answer = {"ok": False, "errors": [f"internal error: {type(error).__name__}: {error}"]}
            self._socket.send_json(answer)
