# SPDX-License-Identifier: GPL-3.0-or-later
"""Packet modems: bytes to samples of mean power 1, and samples to packets. One interface, whatever is installed."""

import ctypes
from functools import lru_cache
from typing import Protocol

import numpy as np
from gnuradio import fec

from ..core.errors import CastError
from ..signals import wifi
from ..signals.wifi import Packet
from .gr_ieee802_11 import GrIeee80211Modem

KINDS = ("auto", "gr-ieee802-11", "802.11a")
_POLYNOMIALS = [109, 79]  # 133 and 171 (octal), in GNU Radio's order of bits
_capsule = ctypes.pythonapi.PyCapsule_New
_capsule.restype, _capsule.argtypes = ctypes.py_object, [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]


class Modem(Protocol):
    """`name` says which modem it is and what its frames are made of; `sample_rate_hz` is that of its samples.

    `restarts`: how often it had to be started anew, each time losing a frame.
    """

    name: str
    restarts: int
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
    restarts = 0

    def __init__(self, mode: str):
        self._mode = wifi.MODES[mode]
        self.name = f"802.11a {mode} (gr_cast.signals.wifi, Viterbi decoder of GNU Radio's gr-fec)"

    def modulate(self, payload: bytes) -> np.ndarray:
        return wifi.modulated(payload, self._mode)

    def demodulate(self, samples: np.ndarray) -> list[Packet]:
        return wifi.received(samples, viterbi)


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
