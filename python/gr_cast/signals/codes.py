# SPDX-License-Identifier: GPL-3.0-or-later
"""Code sequences that a sounder sends, one period each, and `from_spec`, which makes them from a waveform entry.

Binary codes are float32 arrays of ±1 with shape (length,); Zadoff-Chu is complex64. Sources are named at each function.
"""

import inspect
import math
from functools import reduce

import numpy as np

from ..core.errors import CastError

MAX_DEGREE = 24  # 2^24 chips are 128 MB of complex samples

# Feedback masks of primitive polynomials by degree, the defaults of GNU Radio's glfsr_source (Galois form).
PRIMITIVE_MASKS = (
    0x1, 0x3, 0x5, 0x9, 0x12, 0x21, 0x41, 0x8E, 0x108, 0x204, 0x402, 0x829, 0x100D, 0x2015, 0x4001, 0x8016,
    0x10004, 0x20013, 0x40013, 0x80004, 0x100002, 0x200001, 0x400010, 0x80000D, 0x1000004, 0x2000023, 0x4000013,
    0x8000004, 0x10000002, 0x20000029, 0x40000004, 0x80000057,
)  # fmt: skip

# Exponents of the preferred pairs of primitive polynomials (Gold 1967; the pairs that MATLAB's tables list).
PREFERRED_PAIRS = {
    63: ((6, 1, 0), (6, 5, 2, 1, 0)),
    127: ((7, 3, 0), (7, 3, 2, 1, 0)),
    511: ((9, 4, 0), (9, 6, 4, 3, 0)),
}


def _linear_recurrence(lags, first_bits, count: int) -> np.ndarray:
    """Bits with a[n] = XOR over `lags` of a[n − lag], from the first max(lags) bits; uint8, shape (count,).

    A recurrence over GF(2) also holds with all lags doubled (p(x)² = p(x²)), so that long runs come in blocks.
    """
    bits = np.empty(max(count, len(first_bits)), np.uint8)
    known = len(first_bits)
    bits[:known] = first_bits
    while known < count:
        stretch = 1 << int(math.log2(known // max(lags)))
        block = min(stretch * min(lags), count - known)
        sources = [bits[known - lag * stretch : known - lag * stretch + block] for lag in lags]
        bits[known : known + block] = reduce(np.bitwise_xor, sources)
        known += block
    return bits[:count]


def _bpsk(bits) -> np.ndarray:
    return (2.0 * bits - 1.0).astype(np.float32)  # bit 1 → +1


def _period_of_state(mask: int, seed: int) -> int:
    """Steps after which a Galois LFSR is back at `seed`."""
    state, steps = seed, 0
    while True:
        state = (state >> 1) ^ (mask if state & 1 else 0)
        steps += 1
        if state == seed:
            return steps


def glfsr(degree: int, mask: int = 0, seed: int = 1) -> np.ndarray:
    """One period of a Galois LFSR, bit-exact with GNU Radio's `glfsr_source`: 2^degree − 1 chips for a primitive mask.

    `mask` 0 takes the primitive default of the degree (1…24); `seed` is the register at the first chip.
    """
    if not 1 <= degree <= MAX_DEGREE:
        raise CastError(f"glfsr: degree: got {degree}, needs 1 to {MAX_DEGREE}")
    top = 1 << (degree - 1)
    if mask and not top <= mask < 2 * top:
        raise CastError(f"glfsr: mask: got {mask:#x}, needs 0 or bit {degree - 1} as its highest for degree {degree}")
    if not 1 <= seed < 2 * top:
        raise CastError(f"glfsr: seed: got {seed}, needs 1 to {2 * top - 1} for degree {degree}")
    mask_used = mask or PRIMITIVE_MASKS[degree - 1]
    primitive = mask_used == PRIMITIVE_MASKS[degree - 1]
    length = 2 * top - 1 if primitive else _period_of_state(mask_used, seed)
    state, first_bits = seed, []
    for _ in range(degree):
        first_bits.append(state & 1)
        state = (state >> 1) ^ (mask_used if state & 1 else 0)
    lags = [bit + 1 for bit in range(degree) if mask_used >> bit & 1]
    return _bpsk(_linear_recurrence(lags, first_bits, length))


def m_sequence(degree: int) -> np.ndarray:
    """The maximum-length sequence of 2^degree − 1 chips (the GLFSR with its default mask)."""
    return glfsr(degree)


def _gold_bits(pair, count: int) -> np.ndarray:
    """XOR of two Fibonacci LFSRs, both started at 0…01, with no shift between them."""
    degree = pair[0][0]
    start = [1] + [0] * (degree - 1)
    first, second = (_linear_recurrence([degree - e for e in p[1:]], start, count) for p in pair)
    return first ^ second


def gold(length: int) -> np.ndarray:
    """A Gold code of 63, 127 or 511 chips from a preferred pair (Gold 1967). Degree 8 has none, so 255 is refused."""
    if length not in PREFERRED_PAIRS:
        reason = "; no preferred pair exists at degree 8, for the paper's sequence use gold_paper" if length == 255 else ""
        raise CastError(f"gold: length: got {length}, needs one of {', '.join(map(str, PREFERRED_PAIRS))}{reason}")
    return _bpsk(_gold_bits(PREFERRED_PAIRS[length], length))


def gold_paper() -> np.ndarray:
    """The 255 chips that the CaST paper calls "Gold": in truth the Gold code of 63 chips, four times and cut at 255."""
    return _bpsk(_gold_bits(PREFERRED_PAIRS[63], 255))


def golay_pair(delays, weights) -> tuple[np.ndarray, np.ndarray]:
    """Complementary Golay pair (a, b) by the Budišin recursion: a' = w·a + b(D), b' = w·a − b(D)."""
    length = 1 + sum(delays)
    a = np.zeros(length, np.float32)
    a[0] = 1.0
    b = a.copy()
    for delay, weight in zip(delays, weights, strict=True):
        shifted = np.concatenate([np.zeros(delay, np.float32), b[:-delay]])
        a, b = weight * a + shifted, weight * a - shifted
    return a, b


_GOLAY_128 = ((1, 8, 2, 4, 16, 32, 64), (-1, -1, -1, -1, 1, -1, -1))  # IEEE 802.11ad-2012, table 21-25


def ga128() -> np.ndarray:
    """Golay sequence Ga of 128 chips (IEEE 802.11ad-2012, clause 21.11)."""
    return golay_pair(*_GOLAY_128)[0][::-1].copy()


def gb128() -> np.ndarray:
    """Golay sequence Gb of 128 chips, complementary to Ga: their aperiodic autocorrelations add up to one peak."""
    return golay_pair(*_GOLAY_128)[1][::-1].copy()


def ls() -> np.ndarray:
    """The paper's loosely synchronised code: 256 chips from a Golay pair, without an interference-free window."""
    a, b = np.array([1, 1]), np.array([-1, 1])
    while len(a) < 256:
        a, b = np.concatenate([a, b]), np.concatenate([a, -b])
    return a.astype(np.float32)


def zadoff_chu(length: int, root: int) -> np.ndarray:
    """Zadoff-Chu sequence exp(−jπ·root·n·(n + length mod 2)/length) (Chu 1972): constant amplitude, no sidelobes."""
    if not 2 <= length <= 1 << MAX_DEGREE:
        raise CastError(f"zadoff_chu: length: got {length}, needs 2 to {1 << MAX_DEGREE}")
    if not 1 <= root < length or math.gcd(root, length) != 1:
        raise CastError(f"zadoff_chu: root: got {root}, needs 1 to {length - 1} without a factor in common with {length}")
    n = np.arange(length)
    # The phase is exact in integers modulo 2·length before it becomes a float.
    turns = root * (n * (n + length % 2) % (2 * length)) % (2 * length)
    return np.exp(-1j * np.pi * turns / length).astype(np.complex64)


CODES = {
    "glfsr": glfsr,
    "gold_paper": gold_paper,
    "gold": gold,
    "ga128": ga128,
    "gb128": gb128,
    "ls": ls,
    "zadoff_chu": zadoff_chu,
}


def chips_from_spec(spec: dict) -> np.ndarray:
    """One period of chips of a built-in code, `{code: NAME, …}`; faults of the entry are raised all at once."""
    name = spec.get("code")
    if not isinstance(name, str) or name not in CODES:
        raise CastError(f"code: got {name!r}, needs one of {', '.join(CODES)}")
    parameters = inspect.signature(CODES[name]).parameters
    arguments = {key: value for key, value in spec.items() if key not in ("code", "samples_per_chip")}
    required = [key for key, p in parameters.items() if p.default is p.empty]
    faults = [f"{name}: {key}: unknown key" for key in arguments if key not in parameters]
    faults += [f"{name}: {key}: missing" for key in required if key not in arguments]
    faults += [
        f"{name}: {key}: got {value!r}, needs an integer"
        for key, value in arguments.items()
        if key in parameters and (not isinstance(value, int) or isinstance(value, bool))
    ]
    if faults:
        raise CastError(*faults)
    return CODES[name](**arguments)


def from_spec(spec: dict) -> np.ndarray:
    """One period of samples of a built-in code: each chip held for `samples_per_chip` samples; complex64, 1-D."""
    samples_per_chip = spec.get("samples_per_chip", 1)
    if not isinstance(samples_per_chip, int) or isinstance(samples_per_chip, bool) or not 1 <= samples_per_chip <= 4096:
        raise CastError(f"samples_per_chip: got {samples_per_chip!r}, needs an integer from 1 to 4096")
    return np.repeat(chips_from_spec(spec), samples_per_chip).astype(np.complex64)


def periodic_autocorrelation(samples: np.ndarray) -> np.ndarray:
    """Circular autocorrelation of one period, 1 at lag 0; complex128, shape of the input."""
    spectrum = np.fft.fft(samples.astype(np.complex128))
    correlation = np.fft.ifft(np.abs(spectrum) ** 2)
    return correlation / correlation[0]
