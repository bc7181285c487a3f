# SPDX-License-Identifier: GPL-3.0-or-later
"""IEEE 802.11a frames: bytes to samples and back, at 20 MS/s (IEEE Std 802.11-2016, clause 17).

The receiver is a plain one: cross-correlation with the long training field for time, its two halves for frequency, one
least-squares gain per carrier, a common phase from the pilots of a few symbols, soft bits weighted by the carrier's gain. It
knows nothing of interference. The Viterbi decoder is given by the caller (`gr_cast.blocks.modem` has GNU Radio's).
"""

import zlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.fft import next_fast_len

from ..core.errors import CastError

SAMPLE_RATE_HZ = 20e6
FFT = 64
GUARD = 16
SYMBOL = FFT + GUARD
TRAINING = 320  # samples of the short and the long training field
HEADER = TRAINING + SYMBOL
MAX_PAYLOAD = 4095 - 4  # LENGTH has 12 bits and counts the frame check sequence too
PHASE_REACH = 3  # symbols to either side over which the pilots' common phase is averaged
DETECTION = 0.15  # share of the power that follows the long training symbol; noise alone reaches it once in 4e7 samples

PILOT_CARRIERS = np.array([-21, -7, 7, 21])
PILOTS = np.array([1, 1, 1, -1])
CARRIERS = np.array([k for k in range(-26, 27) if k != 0])
DATA_CARRIERS = np.setdiff1d(CARRIERS, PILOT_CARRIERS)
_LONG = np.array(
    [1, 1, -1, -1, 1, 1, -1, 1, -1, 1, 1, 1, 1, 1, 1, -1, -1, 1, 1, -1, 1, -1, 1, 1, 1, 1]
    + [1, -1, -1, 1, 1, -1, 1, -1, 1, -1, -1, -1, -1, -1, 1, 1, -1, -1, 1, -1, 1, -1, 1, 1, 1, 1]
)
_SHORT_CARRIERS = np.array([-24, -20, -16, -12, -8, -4, 4, 8, 12, 16, 20, 24])
_SHORT = np.array([1, -1, 1, -1, -1, 1, -1, -1, 1, 1, 1, 1]) * (1 + 1j) * np.sqrt(13 / 6)

# Soft bits (n,), positive for 0, of n/2 code pairs that end in the all-zero state, to the n/2 − 6 information bits.
Viterbi = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, kw_only=True)
class Mode:
    """Modulation of the data at code rate 1/2. `axis` are the amplitudes of one axis by their bits, in binary order."""

    name: str
    rate_bits: tuple[int, ...]
    bits_per_carrier: int
    axis: tuple[float, ...]

    @property
    def coded_bits(self) -> int:
        """Of one OFDM symbol."""
        return self.bits_per_carrier * len(DATA_CARRIERS)

    @property
    def has_quadrature(self) -> bool:
        return self.bits_per_carrier > 1

    @property
    def bit_rate_hz(self) -> float:
        return self.coded_bits / 2 * SAMPLE_RATE_HZ / SYMBOL


MODES = {
    mode.name: mode
    for mode in (
        Mode(name="bpsk1/2", rate_bits=(1, 1, 0, 1), bits_per_carrier=1, axis=(-1, 1)),
        Mode(name="qpsk1/2", rate_bits=(0, 1, 0, 1), bits_per_carrier=2, axis=tuple(np.array([-1, 1]) / np.sqrt(2))),
        Mode(name="16qam1/2", rate_bits=(1, 0, 0, 1), bits_per_carrier=4, axis=tuple(np.array([-3, -1, 3, 1]) / np.sqrt(10))),
    )
}


@dataclass(frozen=True, kw_only=True)
class Packet:
    """A frame that was received whole: its check sequence is right. `start_sample` is where its training begins."""

    start_sample: int
    payload: bytes


def scrambling(state: int, size: int) -> np.ndarray:
    """Bits (size,) of the scrambler x⁷ + x⁴ + 1 from `state`, its seven bits with the oldest on top (17.3.5.5)."""
    bits = [state >> k & 1 for k in range(6, -1, -1)]
    for _ in range(min(size, 127)):
        bits.append(bits[-7] ^ bits[-4])
    return np.resize(np.array(bits[7:], np.uint8), size)


_POLARITY = 1 - 2 * scrambling(0x7F, 127).astype(int)  # of the pilots, symbol by symbol (17.3.5.10)


def encoded(bits: np.ndarray) -> np.ndarray:
    """The rate-1/2 code of generators 133 and 171 (octal), starting at zero: (n,) to (2n,) (17.3.5.6)."""
    past = np.concatenate([np.zeros(6, np.uint8), bits])

    def ago(k):
        return past[6 - k : len(past) - k]

    a = ago(0) ^ ago(2) ^ ago(3) ^ ago(5) ^ ago(6)
    b = ago(0) ^ ago(1) ^ ago(2) ^ ago(3) ^ ago(6)
    return np.stack([a, b], axis=1).reshape(-1)


def interleaving(mode: Mode) -> np.ndarray:
    """Place of each coded bit of a symbol after the two permutations of 17.3.5.7."""
    n, s = mode.coded_bits, max(mode.bits_per_carrier // 2, 1)
    k = np.arange(n)
    i = n // 16 * (k % 16) + k // 16
    return s * (i // s) + (i + n - 16 * i // n) % s


def _points(bits: np.ndarray, mode: Mode) -> np.ndarray:
    """Carrier values (symbols, 48) of interleaved bits (symbols, coded_bits)."""
    half = mode.bits_per_carrier // 2 if mode.has_quadrature else 1
    groups = bits.reshape(len(bits), len(DATA_CARRIERS), -1, half)
    level = np.array(mode.axis)[groups @ (1 << np.arange(half)[::-1])]
    return level[..., 0] + 1j * level[..., 1] if mode.has_quadrature else level[..., 0].astype(complex)


def _in_time(values: np.ndarray, carriers: np.ndarray, guard: int) -> np.ndarray:
    """Symbols (n, carriers) as samples of mean power 1, each after its guard interval, (n·(64 + guard),)."""
    spectrum = np.zeros((len(values), FFT), complex)
    spectrum[:, carriers] = values
    body = np.fft.ifft(spectrum, axis=1) * (FFT / np.sqrt(len(CARRIERS)))
    return np.concatenate([body[:, FFT - guard :], body], axis=1).reshape(-1)


_LONG_BODY = _in_time(_LONG[None, :], CARRIERS, 0)
_SHORT_BODY = _in_time(_SHORT[None, :], _SHORT_CARRIERS, 0)
PREAMBLE = np.concatenate([np.tile(_SHORT_BODY, 3)[:160], _LONG_BODY[32:], _LONG_BODY, _LONG_BODY])


def _symbols(coded: np.ndarray, mode: Mode, first: int) -> np.ndarray:
    """Samples of the OFDM symbols number `first` and on that carry coded bits (17.3.5.9)."""
    blocks = coded.reshape(-1, mode.coded_bits)
    placed = np.empty_like(blocks)
    placed[:, interleaving(mode)] = blocks
    values = np.zeros((len(blocks), FFT), complex)
    values[:, DATA_CARRIERS] = _points(placed, mode)
    values[:, PILOT_CARRIERS] = PILOTS * _POLARITY[(first + np.arange(len(blocks))) % 127, None]
    return _in_time(values[:, CARRIERS], CARRIERS, GUARD)


def _bits(data: bytes) -> np.ndarray:
    return np.unpackbits(np.frombuffer(data, np.uint8), bitorder="little")


def modulated(payload: bytes, mode: Mode, scrambler: int = 0b1011101) -> np.ndarray:
    """The frame of a payload and its CRC-32: (samples,) complex64 of mean power 1.

    Raises CastError for a payload that LENGTH cannot tell.
    """
    if not 1 <= len(payload) <= MAX_PAYLOAD:
        raise CastError(f"payload: got {len(payload)} bytes, limit 1 to {MAX_PAYLOAD}")
    psdu = payload + zlib.crc32(payload).to_bytes(4, "little")
    length = [len(psdu) >> k & 1 for k in range(12)]
    signal = [*mode.rate_bits, 0, *length]
    signal = np.array([*signal, sum(signal) % 2, *[0] * 6], np.uint8)
    used = 16 + 8 * len(psdu) + 6
    per_symbol = mode.coded_bits // 2
    data = np.zeros(-(-used // per_symbol) * per_symbol, np.uint8)
    data[16 : used - 6] = _bits(psdu)
    data ^= scrambling(scrambler, len(data))
    data[used - 6 : used] = 0  # the tail stays zero so that the code ends in its first state
    header = _symbols(encoded(signal), MODES["bpsk1/2"], 0)
    return np.concatenate([PREAMBLE, header, _symbols(encoded(data), mode, 1)]).astype(np.complex64)


def _training_match(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Power along the two long symbols that begin at each sample, and its share of all power there, (n − 127,) each."""
    size = next_fast_len(len(samples) + FFT)
    spectrum = np.fft.fft(samples, size) * np.conj(np.fft.fft(_LONG_BODY, size))
    along = np.abs(np.fft.ifft(spectrum)[: len(samples) - FFT + 1]) ** 2 / np.sum(np.abs(_LONG_BODY) ** 2)
    energy = np.cumsum(np.concatenate([[0.0], np.abs(samples) ** 2]))
    energy = energy[2 * FFT :] - energy[: -2 * FFT]
    along = along[: -FFT or None] + along[FFT:]
    return along, along / np.maximum(energy, 1e-30)


def received(samples: np.ndarray, viterbi: Viterbi) -> list[Packet]:
    """All frames in samples (n,) complex whose header and check sequence are right, in order of time."""
    samples = np.asarray(samples, complex)
    if len(samples) < HEADER + SYMBOL:
        return []
    along, share = _training_match(samples)
    # A window as long as the guard holds all echoes that the receiver can use; the best one begins before the first of them.
    caught = np.convolve(along, np.ones(GUARD), "valid")
    found, after = [], 0
    for at in np.flatnonzero(share[: len(caught)] > DETECTION):
        if at < after:
            continue
        near = max(at - 2 * GUARD, 0)
        body = near + int(np.argmax(caught[near : at + 2 * FFT]))
        packet, end = _decoded(samples, body, viterbi)
        if packet:
            found.append(packet)
        after = max(end, at + 2 * FFT)
    return found


def _decoded(samples: np.ndarray, body: int, viterbi: Viterbi) -> tuple[Packet | None, int]:
    """The frame whose first long symbol begins at `body`, and where to look on: after it if it is whole.

    A header has one parity bit: a wrong length must not hide the frames after it.
    """
    start = body - (TRAINING - 2 * FFT)
    first, second = samples[body : body + FFT], samples[body + FFT : body + 2 * FFT]
    turn = np.angle(np.vdot(first, second)) / FFT  # rad per sample
    gain = _carriers((first + second * np.exp(-1j * turn * FFT))[None, :] / 2, turn)[0] * _LONG
    header = _equalised_bits(samples, body, 0, 1, gain, turn, MODES["bpsk1/2"])
    if header is None:
        return None, body
    signal = viterbi(header)
    length = int(signal[5:17] @ (1 << np.arange(12)))
    mode = next((mode for mode in MODES.values() if mode.rate_bits == tuple(signal[:4])), None)
    if mode is None or signal[4] or signal.sum() % 2 or length <= 4:
        return None, body
    used = 16 + 8 * length + 6
    count = -(-used // (mode.coded_bits // 2))
    end = body + 2 * FFT + (1 + count) * SYMBOL
    soft = _equalised_bits(samples, body, 1, count, gain, turn, mode)
    if soft is None:
        return None, body
    bits = viterbi(soft[: 2 * used])
    state = int(bits[:7] @ (1 << np.arange(7)[::-1]))  # the service field is zero: what is there is the scrambler
    plain = bits.copy()
    plain[7:] ^= scrambling(state, len(bits) - 7)
    psdu = np.packbits(plain[16:], bitorder="little").tobytes()
    payload, check = psdu[:-4], psdu[-4:]
    whole = zlib.crc32(payload).to_bytes(4, "little") == check
    return (Packet(start_sample=start, payload=payload), end) if whole else (None, body)


def _carriers(bodies: np.ndarray, turn: float) -> np.ndarray:
    """Carrier values (n, 52) of symbol bodies (n, 64) that turn by `turn` rad per sample."""
    spectrum = np.fft.fft(bodies * np.exp(-1j * turn * np.arange(FFT)), axis=1) / (FFT / np.sqrt(len(CARRIERS)))
    return spectrum[:, CARRIERS]


def _equalised_bits(samples, body, first, count, gain, turn, mode) -> np.ndarray | None:
    """Soft bits (count·coded_bits,) of symbols from number `first` on; None where the samples end before them."""
    begin = body + 2 * FFT + first * SYMBOL
    if begin + count * SYMBOL > len(samples):
        return None
    bodies = samples[begin : begin + count * SYMBOL].reshape(count, SYMBOL)[:, GUARD:]
    offset = begin - body + GUARD + SYMBOL * np.arange(count)
    values = _carriers(bodies, turn) * np.exp(-1j * turn * offset)[:, None]
    at_pilots, at_data = np.searchsorted(CARRIERS, PILOT_CARRIERS), np.searchsorted(CARRIERS, DATA_CARRIERS)
    sent = PILOTS * _POLARITY[(first + np.arange(count)) % 127, None]
    pilots = np.sum(values[:, at_pilots] * np.conj(gain[at_pilots]) * sent, axis=1)
    phase = np.angle(np.convolve(pilots, np.ones(2 * PHASE_REACH + 1))[PHASE_REACH : PHASE_REACH + count])
    matched = values[:, at_data] * np.conj(gain[at_data]) * np.exp(-1j * phase)[:, None]
    soft = _soft_bits(matched, np.abs(gain[at_data]) ** 2, mode)
    return soft[:, interleaving(mode)].reshape(-1)


def _soft_bits(matched: np.ndarray, power: np.ndarray, mode: Mode) -> np.ndarray:
    """Soft bits (symbols, coded_bits), positive for 0: differences of squared distances over the noise (max-log).

    `matched` (symbols, 48) is H*·y, `power` (48,) is |H|²: |y − H·a|² = const − 2·a·Re(H*·y) + |H|²·a².
    """
    half = max(mode.bits_per_carrier // 2, 1)
    axes = np.stack([matched.real, matched.imag][: 1 + mode.has_quadrature], axis=-1)
    level = np.array(mode.axis)
    distance = power[:, None, None] * level**2 - 2 * axes[..., None] * level
    soft = []
    for bit in range(half):
        is_one = np.arange(len(level)) >> (half - 1 - bit) & 1 == 1
        soft.append(distance[..., is_one].min(axis=-1) - distance[..., ~is_one].min(axis=-1))
    return np.stack(soft, axis=-1).reshape(len(matched), -1)
