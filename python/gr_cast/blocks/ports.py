# SPDX-License-Identifier: GPL-3.0-or-later
"""What a node's transmitter or receiver is joined to: a protocol stack, a radio, a recording, or nothing.

ZeroMQ samples go as srsRAN's radio sends them: the side that receives asks (REQ) with one small message, the side that
transmits answers (REP) with complex floats. GNU Radio's own REQ Source and REP Sink speak the same, but hang when their
peer dies between question and answer; `zmq_requester` and `zmq_replier` do not.
"""

import atexit
import contextlib
import socket
from dataclasses import dataclass
from pathlib import Path

from gnuradio import blocks, gr, zeromq

from ..core.errors import CastError
from ..signals import recording
from .cast_python import zmq_replier, zmq_requester, zmq_subscriber
from .recorder import SigmfRecorder
from .usrp import RadioSettings, second_of, usrp_source

KINDS = ("zmq", "pubsub", "file", "uhd", "null")
LEAD_S = 0.05  # from a sample's coming to its leaving by a radio: what the radio's queue holds
_RADIO_WORDS = {  # of a uhd port's own among its device arguments: the setting, and how it is read
    "frequency": ("center_frequency_hz", float),
    "gain": ("gain_db", float),
    "antenna": ("antenna", str),
    "subdevice": ("subdevice", str),
    "clock_source": ("clock_source", str),
    "time_source": ("time_source", str),
    "start_at": ("start_at_s", second_of),
}


@dataclass(frozen=True, kw_only=True)
class Port:
    """One direction of a node: `kind` of KINDS, `where` an address, a SigMF stem or UHD device arguments."""

    node: str
    direction: str  # "tx": what the node transmits, "rx": what it receives
    kind: str
    where: str = ""

    @property
    def name(self) -> str:
        return f"port {self.node}:{self.direction}"

    def __post_init__(self):
        name = self.name
        if self.direction not in ("tx", "rx"):
            raise CastError(f"{name}: direction: got {self.direction!r}, needs tx or rx")
        if self.kind not in KINDS:
            raise CastError(f"{name}: kind: got {self.kind!r}, needs one of {', '.join(KINDS)}")
        if self.kind in ("zmq", "pubsub") and not _is_address(self.where):
            raise CastError(f"{name}: address: got {self.where!r}, needs tcp://HOST:PORT (1 to 65535) or ipc://PATH")
        if self.kind == "file" and not self.where:
            raise CastError(f"{name}: file: got nothing, needs a SigMF stem")

    def radio(self, defaults: dict) -> RadioSettings:
        """Settings of a uhd port: those of RadioSettings that `defaults` holds for all, and what the port says itself among its
        device arguments, `uhd:addr=192.168.40.2,gain=20,antenna=RX2`. Raises CastError, all faults at once."""
        return radio_settings(self.name, self.where, defaults, LEAD_S if self.direction == "rx" else 0.0)

    @classmethod
    def parse(cls, text: str) -> "Port":
        """Read NODE:tx=KIND:WHERE or NODE:rx=KIND:WHERE. Raises CastError where it is not of that form."""
        left, equals, right = text.partition("=")
        node, colon, direction = left.rpartition(":")
        if not (equals and colon and node):
            raise CastError(f"port: got {text!r}, needs NODE:tx=KIND:WHERE or NODE:rx=KIND:WHERE")
        kind, _, where = right.partition(":")
        return cls(node=node, direction=direction, kind=kind, where=where)


def radio_settings(name: str, where: str, defaults: dict, lead_s: float = 0.0) -> RadioSettings:
    """Settings of a radio: those of RadioSettings that `defaults` holds, and what stands among its device arguments `where`.
    Raises CastError, all faults at once, each with the radio's `name`."""
    own, arguments, faults = {}, [], []
    for word in filter(None, where.split(",")):
        key, _, value = word.partition("=")
        if key not in _RADIO_WORDS:
            arguments.append(word)
            continue
        setting, read = _RADIO_WORDS[key]
        try:
            own[setting] = read(value)
        except ValueError:
            faults.append(f"{key}: got {value!r}, needs a number")
        except CastError as error:
            faults.append(f"{key}: {error}")
    told = {key: value for key, value in {**defaults, **own}.items() if value is not None}
    if "center_frequency_hz" not in told:
        faults.append("frequency: got nothing, a radio needs its carrier in Hz: frequency=HZ, or --frequency for all")
    if not faults:
        try:
            return RadioSettings(**told, device_args=",".join(arguments), lead_s=lead_s)
        except CastError as error:
            faults = error.faults
    raise CastError(*(f"{name}: {fault}" for fault in faults))


def own_words(where: str, direction: str) -> str:
    """Device arguments for one direction of a node: `tx_gain=10` is the transmitter's gain, and nothing to its receiver."""
    words = []
    for word in where.split(","):
        prefix, _, rest = word.partition("_")
        is_one_way = prefix in ("tx", "rx") and rest.partition("=")[0] in _RADIO_WORDS
        if not is_one_way:
            words.append(word)
        elif prefix == direction:
            words.append(rest)
    return ",".join(words)


def _is_address(where: str) -> bool:
    transport, _, place = where.partition("://")
    host, _, number = place.rpartition(":")
    if transport == "tcp":
        return bool(host) and number.isdecimal() and 0 < int(number) < 65536
    return transport == "ipc" and bool(place)


def address_to_bind(place: str, where: str) -> str:
    """As ZeroMQ wants it. CastError where somebody listens at an IPC socket: ZeroMQ would take it over without a word."""
    transport, _, path = where.partition("://")
    with socket.socket(socket.AF_UNIX) as probe, contextlib.suppress(OSError):
        if transport == "ipc":
            probe.connect(path)
            raise CastError(f"{place}: address {where}: Address already in use")
    if transport == "ipc" and not path.startswith("@"):
        atexit.register(Path(path).absolute().unlink, missing_ok=True)  # ZeroMQ leaves it behind
    return where.replace("tcp://localhost", "tcp://127.0.0.1")


def _open(port: Port, make, *arguments):
    """A block with a socket. Raises CastError where the address cannot be."""
    try:
        return make(*arguments)
    except RuntimeError as error:
        reason = str(error).rpartition(": ")[2]
        raise CastError(f"{port.name}: address {port.where}: {reason}") from None


def _file_source(port: Port, sample_rate_hz: float):
    recorded = recording.read(port.where, count=1)
    if recorded.sample_rate_hz != sample_rate_hz:
        raise CastError(
            f"{port.name}: {port.where}: got {recorded.sample_rate_hz} samples/s, "
            f"the emulator runs at {sample_rate_hz:g} samples/s"
        )
    if recorded.datatype == "cf32_le":
        return blocks.file_source(gr.sizeof_gr_complex, str(recording.data_path(port.where)), False)
    return blocks.vector_source_c(recording.read(port.where).samples.tolist(), False)


def waveform_entry(port: Port) -> dict | None:
    """What a recording says of what a `tx` port sends, None where nobody knows."""
    return {"file": str(Path(port.where).resolve()), "repeat": False} if port.kind == "file" else None


def source_block(port: Port, settings: RadioSettings | None, sample_rate_hz: float):
    """The block that brings what a node transmits. Raises CastError where it cannot be."""
    if port.kind == "zmq":
        return _open(port, zmq_requester, port.where)
    if port.kind == "pubsub":
        return _open(port, zmq_subscriber, port.where)
    if port.kind == "file":
        return _file_source(port, sample_rate_hz)
    if port.kind == "uhd":
        return usrp_source(settings)
    return blocks.null_source(gr.sizeof_gr_complex)


def connect_sink(
    top: gr.top_block,
    source,
    output: int,
    port: Port,
    sample_rate_hz: float,
    center_frequency_hz: float | None,
    fields: dict,
):
    """Join a receiver to a port that is no radio; returns the recorder of a file, to be finished after the run, or the block.
    `fields` and the carrier are what a recording says of itself."""
    if port.kind == "file":
        Path(port.where).parent.mkdir(parents=True, exist_ok=True)
        return SigmfRecorder(
            top,
            source,
            port.where,
            port=output,
            sample_rate_hz=sample_rate_hz,
            center_frequency_hz=center_frequency_hz,
            fields=fields,
        )
    if port.kind == "zmq":
        sink = _open(port, zmq_replier, address_to_bind(port.name, port.where))
    elif port.kind == "pubsub":
        address = address_to_bind(port.name, port.where)
        sink = _open(port, zeromq.pub_sink, gr.sizeof_gr_complex, 1, address, 100, False, -1, "")
    else:
        sink = blocks.null_sink(gr.sizeof_gr_complex)
    top.connect((source, output), sink)
    return sink
