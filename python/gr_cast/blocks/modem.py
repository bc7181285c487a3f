# SPDX-License-Identifier: GPL-3.0-or-later
"""Packet modems: bytes to samples of mean power 1, and samples to packets. One interface, whatever is installed."""

import ctypes
import time
from functools import lru_cache
from typing import Protocol

import numpy as np
from gnuradio import blocks, fec, gr

from ..core.errors import CastError
from ..signals import wifi
from ..signals.wifi import Packet

KINDS = ("auto", "gr-ieee802-11", "802.11a")
_POLYNOMIALS = [109, 79]  # 133 and 171 (octal), in GNU Radio's order of bits
_capsule = ctypes.pythonapi.PyCapsule_New
_capsule.restype, _capsule.argtypes = ctypes.py_object, [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]


class Modem(Protocol):
    """`name` says which modem it is and what its frames are made of; `sample_rate_hz` is that of its samples."""

    name: str
    sample_rate_hz: float

    def modulate(self, payload: bytes) -> np.ndarray:
        """Samples (n,) complex64 of one frame, mean power 1."""

    def demodulate(self, samples: np.ndarray) -> list[Packet]:
        """The whole packets in samples (n,) complex, in order of time."""


@lru_cache(maxsize=64)
def _decoder(bits: int):
    return fec.cc_decoder.make(bits, 7, 2, _POLYNOMIALS, 0, 0, fec.CC_TERMINATED, False)


def viterbi(soft: np.ndarray) -> np.ndarray:
    """GNU Radio's decoder of the rate-1/2 code, constraint length 7: soft bits (2n + 12,), positive for 0, to (n,) uint8."""
    scale = 40 / max(np.mean(np.abs(soft)), 1e-30)  # of ±127: room for strong bits, steps fine enough for weak ones
    levels = np.clip(np.rint(127.5 - scale * soft), 0, 255).astype(np.uint8)
    bits = np.empty(len(levels) // 2 - 6, np.uint8)
    # The decoder without a scheduler takes bare addresses; a flow graph per frame would cost more than the decoding.
    _decoder(len(bits)).generic_work(_capsule(levels.ctypes.data, None, None), _capsule(bits.ctypes.data, None, None))
    return bits


class OfdmModem:
    """IEEE 802.11a frames of `gr_cast.signals.wifi`, decoded by GNU Radio's gr-fec."""

    sample_rate_hz = wifi.SAMPLE_RATE_HZ

    def __init__(self, mode: str):
        self._mode = wifi.MODES[mode]
        self.name = f"802.11a {mode} (gr_cast.signals.wifi, Viterbi decoder of GNU Radio's gr-fec)"

    def modulate(self, payload: bytes) -> np.ndarray:
        return wifi.modulated(payload, self._mode)

    def demodulate(self, samples: np.ndarray) -> list[Packet]:
        return wifi.received(samples, viterbi)


class GrIeee80211Modem:
    """The transceiver hierarchy of gr-ieee802-11 (https://github.com/bastibl/gr-ieee802-11), with its MAC header."""

    sample_rate_hz = wifi.SAMPLE_RATE_HZ
    _ENCODING = {"bpsk1/2": 0, "qpsk1/2": 2, "16qam1/2": 4}
    _ADDRESSES = ([0x23] * 6, [0x42] * 6, [0xFF] * 6)
    _MAC_HEADER = 24  # bytes
    _PATIENCE_S, _QUIET_S = 30.0, 0.2

    def __init__(self, mode: str):
        import ieee802_11
        from wifi_phy_hier import wifi_phy_hier  # written by `grcc examples/wifi_phy_hier.grc`

        self._package, self._hierarchy, self._encoding = ieee802_11, wifi_phy_hier, self._ENCODING[mode]
        self.name = f"802.11a {mode} (gr-ieee802-11)"

    def _phy(self):
        package = self._package
        return self._hierarchy(
            bandwidth=self.sample_rate_hz, chan_est=package.Equalizer(0), encoding=package.Encoding(self._encoding),
            frequency=2.4e9, sensitivity=0.56,
        )  # fmt: skip

    def modulate(self, payload: bytes) -> np.ndarray:
        import pmt

        flowgraph, phy, sink = gr.top_block(), self._phy(), blocks.vector_sink_c()
        mac, silence = self._package.mac(*self._ADDRESSES), blocks.null_source(gr.sizeof_gr_complex)
        flowgraph.connect(silence, blocks.head(gr.sizeof_gr_complex, 1), phy, sink)
        flowgraph.msg_connect(mac, "phy out", phy, "mac_in")
        flowgraph.start()
        mac.to_basic_block()._post(pmt.intern("app in"), pmt.cons(pmt.PMT_NIL, pmt.init_u8vector(len(payload), list(payload))))
        frame = self._settled(lambda: len(sink.data())) and np.array(sink.data(), np.complex64)
        flowgraph.stop()
        flowgraph.wait()
        if not np.size(frame):
            raise CastError("gr-ieee802-11: made no samples of a frame")
        return frame / np.sqrt(np.mean(np.abs(frame) ** 2))

    def demodulate(self, samples: np.ndarray) -> list[Packet]:
        import pmt

        flowgraph, phy, store = gr.top_block(), self._phy(), blocks.message_debug()
        # Silence after the samples pushes the last frame through the buffers.
        padded = np.concatenate([samples, np.zeros(1 << 16)]).astype(np.complex64)
        source = blocks.vector_source_c(padded.tolist())
        flowgraph.connect(source, phy, blocks.null_sink(gr.sizeof_gr_complex))
        flowgraph.msg_connect(phy, "mac_out", store, "store")
        flowgraph.start()  # its transmitter never ends by itself
        self._settled(lambda: source.nitems_written(0) + store.num_messages(), len(padded))
        flowgraph.stop()
        flowgraph.wait()
        found = []
        for number in range(store.num_messages()):
            frame = bytes(pmt.u8vector_elements(pmt.cdr(store.get_message(number))))
            # The hierarchy does not tell where a frame was: callers name frames in their payload.
            found.append(Packet(start_sample=0, payload=frame[self._MAC_HEADER :]))
        return found

    def _settled(self, size, least: int = 1) -> bool:
        """Wait until `size()` has reached `least` and grows no more; False after `_PATIENCE_S`."""
        until, last, since = time.monotonic() + self._PATIENCE_S, 0, time.monotonic()
        while (now := time.monotonic()) < until:
            if (here := size()) != last:
                last, since = here, now
            if last >= least and now - since > self._QUIET_S:
                return True
            time.sleep(0.02)
        return False


def open_modem(kind: str, mode: str) -> Modem:
    """The modem of a kind (KINDS; auto: gr-ieee802-11 where it is installed) and mode (`wifi.MODES`)."""
    if mode not in wifi.MODES:
        raise CastError(f"mode: got {mode!r}, needs one of {', '.join(wifi.MODES)}")
    if kind not in KINDS:
        raise CastError(f"modem: got {kind!r}, needs one of {', '.join(KINDS)}")
    if kind != "802.11a":
        try:
            return GrIeee80211Modem(mode)
        except ImportError as error:
            if kind != "auto":
                raise CastError(
                    f"modem: gr-ieee802-11 cannot be loaded ({error}); install it and run grcc on its wifi_phy_hier.grc, "
                    "or take --modem 802.11a"
                ) from None
    return OfdmModem(mode)
