# SPDX-License-Identifier: GPL-3.0-or-later
"""What a node's transmitter or receiver is joined to: a protocol stack, a radio, a recording, or nothing.

ZeroMQ samples go as srsRAN's radio sends them: the side that receives asks (REQ) with one small message, the side that
transmits answers (REP) with complex floats. GNU Radio's own REQ Source and REP Sink speak the same, but hang when their
peer dies between question and answer; these do not.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import zmq
from gnuradio import blocks, gr, zeromq
from zmq.utils.monitor import recv_monitor_message

from .. import recording
from ..errors import CastError
from .recorder import SigmfRecorder
from .usrp import RadioSettings, usrp_sink, usrp_source

KINDS = ("zmq", "pubsub", "file", "uhd", "null")
_WAIT_MS = 20  # the longest that a block waits before it looks whether the flowgraph stops
_QUESTION = b"\xff"  # srsRAN's; any message will do


@dataclass(frozen=True, kw_only=True)
class Port:
    """One direction of a node: `kind` of KINDS, `where` an address, a SigMF stem or UHD device arguments."""

    node: str
    direction: str  # "tx": what the node transmits, "rx": what it receives
    kind: str
    where: str = ""

    def __post_init__(self):
        name = f"port {self.node}:{self.direction}"
        if self.direction not in ("tx", "rx"):
            raise CastError(f"{name}: direction: got {self.direction!r}, needs tx or rx")
        if self.kind not in KINDS:
            raise CastError(f"{name}: kind: got {self.kind!r}, needs one of {', '.join(KINDS)}")
        if self.kind in ("zmq", "pubsub") and not self.where.startswith(("tcp://", "ipc://")):
            raise CastError(f"{name}: address: got {self.where!r}, needs tcp://HOST:PORT or ipc://PATH")
        if self.kind == "file" and not self.where:
            raise CastError(f"{name}: file: got nothing, needs a SigMF stem")

    @classmethod
    def parse(cls, text: str) -> "Port":
        """Read NODE:tx=KIND:WHERE or NODE:rx=KIND:WHERE. Raises CastError where it is not of that form."""
        left, equals, right = text.partition("=")
        node, colon, direction = left.rpartition(":")
        if not (equals and colon and node):
            raise CastError(f"port: got {text!r}, needs NODE:tx=KIND:WHERE or NODE:rx=KIND:WHERE")
        kind, _, where = right.partition(":")
        return cls(node=node, direction=direction, kind=kind, where=where)


class ZmqRequester(gr.sync_block):
    """Samples of a peer that answers questions: srsRAN's tx_port, GNU Radio's ZMQ REP Sink."""

    def __init__(self, address: str):
        gr.sync_block.__init__(self, "zmq_requester", None, [np.complex64])
        self.address = address
        self._left = np.empty(0, np.complex64)

    def start(self):
        self._socket = zmq.Context.instance().socket(
            zmq.DEALER
        )  # a REQ socket would wait for the dead for ever
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(zmq.IMMEDIATE, 1)
        self._socket.setsockopt(zmq.RECONNECT_IVL, 10)
        self._monitor = self._socket.get_monitor_socket(
            zmq.EVENT_HANDSHAKE_SUCCEEDED | zmq.EVENT_DISCONNECTED
        )
        self._poller = zmq.Poller()
        self._poller.register(self._socket, zmq.POLLIN)
        self._poller.register(self._monitor, zmq.POLLIN)
        self._connected = self._asked = False
        self._socket.connect(self.address)
        return True

    def stop(self):
        self._socket.disable_monitor()
        self._monitor.close(0)
        self._socket.close(0)
        return True

    def work(self, input_items, output_items):
        out = output_items[0]
        self._ask()
        if not self._left.size:
            self._listen()
            self._ask()  # the next message comes while this one is worked on
        n = min(len(out), len(self._left))
        out[:n] = self._left[:n]
        self._left = self._left[n:]
        return n

    def _ask(self) -> None:
        if self._connected and not self._asked:
            try:
                self._socket.send_multipart([b"", _QUESTION], zmq.NOBLOCK)
                self._asked = True
            except zmq.Again:
                pass

    def _listen(self) -> None:
        ready = dict(self._poller.poll(_WAIT_MS))
        if self._monitor in ready:
            event = recv_monitor_message(self._monitor)["event"]
            self._connected = event == zmq.EVENT_HANDSHAKE_SUCCEEDED
            self._asked = False  # whoever was asked is gone
        if self._socket in ready:
            payload = self._socket.recv_multipart()[-1]
            self._asked = False
            self._left = np.frombuffer(payload[: len(payload) // 8 * 8], np.complex64)


class ZmqReplier(gr.sync_block):
    """Samples for a peer that asks: srsRAN's rx_port, GNU Radio's ZMQ REQ Source."""

    def __init__(self, address: str):
        gr.sync_block.__init__(self, "zmq_replier", [np.complex64], None)
        self.address = address

    def start(self):
        self._socket = zmq.Context.instance().socket(zmq.ROUTER)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(
            zmq.ROUTER_MANDATORY, 1
        )  # an answer to somebody gone is an error, not lost samples
        try:
            self._socket.bind(self.address)
        except zmq.ZMQError as error:
            raise CastError(f"address {self.address}: {error.strerror}") from None
        self._question = None
        return True

    def stop(self):
        self._socket.close(0)
        return True

    def work(self, input_items, output_items):
        samples = input_items[0]
        if self._question is None and self._socket.poll(_WAIT_MS):
            self._question = self._socket.recv_multipart()
        if self._question is None:
            return 0
        *envelope, text = self._question
        self._question = None
        # GNU Radio's source says how many samples it has room for, in four bytes.
        limit = int(np.frombuffer(text, np.uint32)[0]) if len(text) == 4 else len(samples)
        n = min(len(samples), limit)
        try:
            self._socket.send_multipart([*envelope, samples[:n].tobytes()])
        except zmq.ZMQError:
            return 0
        return n


def _address_of_bind(where: str) -> str:
    return where.replace("tcp://localhost", "tcp://127.0.0.1")


def _file_source(port: Port, sample_rate_hz: float):
    recorded = recording.read(port.where, count=1)
    if recorded.sample_rate_hz != sample_rate_hz:
        raise CastError(
            f"port {port.node}:{port.direction}: {port.where}: got {recorded.sample_rate_hz} samples/s, "
            f"the emulator runs at {sample_rate_hz:g} samples/s"
        )
    if recorded.datatype == "cf32_le":
        return blocks.file_source(gr.sizeof_gr_complex, str(recording.data_path(port.where)), False)
    return blocks.vector_source_c(recording.read(port.where).samples.tolist(), False)


def source_block(port: Port, settings: RadioSettings | None, sample_rate_hz: float):
    """The block that brings what a node transmits. Raises CastError where it cannot be."""
    if port.kind == "zmq":
        return ZmqRequester(port.where)
    if port.kind == "pubsub":
        return zeromq.sub_source(gr.sizeof_gr_complex, 1, port.where, 100, False, -1, "")
    if port.kind == "file":
        return _file_source(port, sample_rate_hz)
    if port.kind == "uhd":
        return usrp_source(settings)
    return blocks.null_source(gr.sizeof_gr_complex)


def connect_sink(
    top: gr.top_block, source, output: int, port: Port, settings: RadioSettings | None, sample_rate_hz: float
):
    """Join a receiver to its port; returns the recorder of a file, to be finished after the run, or else the block."""
    if port.kind == "file":
        Path(port.where).parent.mkdir(parents=True, exist_ok=True)
        return SigmfRecorder(
            top,
            source,
            port.where,
            port=output,
            sample_rate_hz=sample_rate_hz,
            fields={"cast:receiver": port.node},
        )
    if port.kind == "zmq":
        sink = ZmqReplier(_address_of_bind(port.where))
    elif port.kind == "pubsub":
        sink = zeromq.pub_sink(gr.sizeof_gr_complex, 1, _address_of_bind(port.where), 100, False, -1, "")
    elif port.kind == "uhd":
        sink = usrp_sink(settings)
    else:
        sink = blocks.null_sink(gr.sizeof_gr_complex)
    top.connect((source, output), sink)
    return sink
