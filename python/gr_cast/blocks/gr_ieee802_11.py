# SPDX-License-Identifier: GPL-3.0-or-later
"""The transceiver of gr-ieee802-11 (https://github.com/bastibl/gr-ieee802-11): one flowgraph for a run, in a process of its own.

The module's receiver neither tells where a frame was nor when it is through with samples. So every stretch is followed by a
marker, a frame of our own: streams keep their order, and when the marker is heard all before it has been decided.
"""

import contextlib
import itertools
import multiprocessing
import os
import queue
import signal
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pmt
from gnuradio import gr

from ..core.errors import CastError
from ..signals import wifi
from ..signals.wifi import Packet

_ENCODING = {"bpsk1/2": 0, "qpsk1/2": 2, "16qam1/2": 4}
_ADDRESSES = ([0x23] * 6, [0x42] * 6, [0xFF] * 6)
_MAC_HEADER = 24  # bytes
_MARKER, _MARKERS = b"gr-cast marker ", 16
_GAP = 1000  # samples: more than the receiver needs between two frames (480), and than its delays hold back
_GAP_AMPLITUDE = 0.01  # its normalised correlation of nothing at all would be noise of rounding
_MARKER_S, _PATIENCE_S, _START_S = 0.25, 20.0, 60.0
_MOST_RESTARTS = 3  # in a row
MODULES = ("ieee802_11", "wifi_phy_hier")


def find_modules() -> None:
    """Raises ImportError where gr-ieee802-11, or its hierarchy written by `grcc examples/wifi_phy_hier.grc`, is not there."""
    generated = os.environ.get("GRC_HIER_PATH", str(Path.home() / ".grc_gnuradio"))
    if generated not in sys.path:  # where GNU Radio Companion puts what it generates
        sys.path.append(generated)
    for name in MODULES:
        if find_spec(name) is None:
            raise ImportError(f"No module named {name!r}")


class _Feed(gr.sync_block):
    """Samples of a queue, as a stream."""

    def __init__(self):
        gr.sync_block.__init__(self, "feed", None, [np.complex64])
        self.queue, self._left = queue.Queue(), np.empty(0, np.complex64)

    def work(self, input_items, output_items):
        if not self._left.size:
            try:
                self._left = self.queue.get(timeout=0.05)
            except queue.Empty:
                return 0
        count = min(self._left.size, len(output_items[0]))
        output_items[0][:count] = self._left[:count]
        self._left = self._left[count:]
        return count


class _Frames(gr.sync_block):
    """A tagged stream's packets, each to a queue."""

    def __init__(self):
        gr.sync_block.__init__(self, "frames", [np.complex64], None)
        self.queue, self._parts, self._missing = queue.Queue(), [], 0

    def work(self, input_items, output_items):
        samples = input_items[0]
        if not self._missing:
            (length,) = (tag.value for tag in self.get_tags_in_window(0, 0, 1) if str(tag.key) == "packet_len")
            self._missing = pmt.to_long(length)
        self._parts.append(samples[: self._missing].copy())
        count = self._parts[-1].size
        self._missing -= count
        if not self._missing:
            self.queue.put(np.concatenate(self._parts))
            self._parts = []
        return count


class _Payloads(gr.basic_block):
    """The bytes of messages, to a queue."""

    def __init__(self):
        gr.basic_block.__init__(self, "payloads", None, None)
        self.queue = queue.Queue()
        self.message_port_register_in(pmt.intern("in"))
        self.set_msg_handler(pmt.intern("in"), self._take)

    def _take(self, message):
        self.queue.put(bytes(pmt.u8vector_elements(pmt.cdr(message)))[_MAC_HEADER:])


class _Transceiver:
    def __init__(self, mode: str):
        import ieee802_11
        from wifi_phy_hier import wifi_phy_hier

        phy = self._phy = wifi_phy_hier(
            bandwidth=wifi.SAMPLE_RATE_HZ, chan_est=ieee802_11.Equalizer(0), encoding=ieee802_11.Encoding(_ENCODING[mode]),
            frequency=2.4e9, sensitivity=0.56,
        )  # fmt: skip
        self._mac = ieee802_11.mac(*_ADDRESSES)
        self._feed, self._frames, self._payloads = _Feed(), _Frames(), _Payloads()
        self._top = gr.top_block()
        self._top.connect(self._feed, phy, self._frames)
        self._top.msg_connect(self._mac, "phy out", phy, "mac_in")
        self._top.msg_connect(phy, "mac_out", self._payloads, "in")
        self._top.start()
        names = [_MARKER + bytes([number]) for number in range(_MARKERS)]
        self._markers = itertools.cycle([(name, self.modulate(name)) for name in names])
        self._rng = np.random.default_rng(0)

    def modulate(self, payload: bytes) -> np.ndarray:
        message = pmt.cons(pmt.PMT_NIL, pmt.init_u8vector(len(payload), list(payload)))
        self._mac.to_basic_block()._post(pmt.intern("app in"), message)
        frame = self._frames.queue.get(timeout=_PATIENCE_S)
        return frame / np.sqrt(np.mean(np.abs(frame) ** 2))

    def demodulate(self, samples: np.ndarray) -> list[bytes]:
        self._feed.queue.put(samples)
        found, sent = [], set()
        for _ in range(int(_PATIENCE_S / _MARKER_S)):  # after a noisy frame the module may refuse a clean one or two
            name, marker = next(self._markers)
            sent.add(name)
            padded = np.pad(marker, _GAP)
            noise = self._rng.normal(size=(len(padded), 2)) @ (1, 1j)
            self._feed.queue.put((padded + _GAP_AMPLITUDE * noise).astype(np.complex64))
            with contextlib.suppress(queue.Empty):
                while (payload := self._payloads.queue.get(timeout=_MARKER_S)) not in sent:
                    if not payload.startswith(_MARKER):  # of a stretch before, heard late
                        found.append(payload)
                return found
        raise queue.Empty


def _serve(connection, mode: str) -> None:
    """Requests (method, argument) until the other end is closed; an answer each."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the run's own affair
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # the module prints there
    find_modules()
    transceiver = _Transceiver(mode)
    connection.send(None)
    with contextlib.suppress(EOFError):
        while True:
            method, argument = connection.recv()
            connection.send(getattr(transceiver, method)(argument))
    os._exit(0)  # its threads wait for samples


class GrIeee80211Modem:
    """The modem that another process runs. `restarts` counts how often it died or hung, and was started anew."""

    sample_rate_hz = wifi.SAMPLE_RATE_HZ

    def __init__(self, mode: str):
        find_modules()
        self.name, self.restarts = f"802.11a {mode} (gr-ieee802-11)", 0
        self._mode, self._failures = mode, 0
        self._start()

    def modulate(self, payload: bytes) -> np.ndarray:
        while (frame := self._ask("modulate", payload)) is None:
            pass
        return frame

    def demodulate(self, samples: np.ndarray) -> list[Packet]:
        """Whole packets, none where the process died; their place is not told, so that callers name frames in their payload."""
        payloads = self._ask("demodulate", np.asarray(samples, np.complex64)) or []
        return [Packet(start_sample=0, payload=payload) for payload in payloads]

    def _start(self) -> None:
        processes = multiprocessing.get_context("spawn")
        self._connection, theirs = processes.Pipe()
        self._process = processes.Process(target=_serve, args=(theirs, self._mode), daemon=True)
        self._process.start()
        theirs.close()
        if not self._connection.poll(_START_S) or self._receive() is not None:
            self._end()
            raise CastError(f"gr-ieee802-11: does not start (status {self._process.exitcode}); the lines above say why")

    def _receive(self):
        """The answer; the error where there is none."""
        try:
            return self._connection.recv()
        except (EOFError, OSError) as error:
            return error

    def _ask(self, method: str, argument):
        """The answer; None where the process has died or hangs: then another one is there for the next question."""
        with contextlib.suppress(OSError):
            self._connection.send((method, argument))
        if self._connection.poll(2 * _PATIENCE_S):
            answer = self._receive()
            if not isinstance(answer, Exception):
                self._failures = 0
                return answer
        self._end()
        self.restarts, self._failures = self.restarts + 1, self._failures + 1
        if self._failures > _MOST_RESTARTS:
            raise CastError(f"gr-ieee802-11: died {self._failures} times in a row (status {self._process.exitcode})")
        self._start()
        return None

    def _end(self) -> None:
        self._connection.close()
        self._process.kill()
        self._process.join()
