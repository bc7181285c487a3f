# SPDX-License-Identifier: GPL-3.0-or-later
"""What speaks against a recording's own metadata: samples that are of another datatype, rates and carriers in MHz.

Read as another datatype samples are still numbers, but their bytes tell: exponents of floats lie together and their low halves
are noise; the high byte of a small integer is its sign; bytes that are samples of their own look alike.
"""

import numpy as np

from ..core.frequencies import LEAST_CARRIER_HZ, LEAST_RATE_HZ, questioned
from .recording import DATATYPES, Recording, to_complex, to_raw

LOOKED_AT = 1 << 16  # samples, enough for every share below
LEAST = 256  # samples that tell anything
EXPONENTS = (127 - 40, 127 + 14)  # of floats that are samples: −240 dB to +84 dB re 1
SURE = 0.999  # share of all
MANY, NOISE = 6.5, 7.7  # bits of a byte that is much, or nothing but noise, of 8
ALIKE = 0.15  # distance of the histograms of two bytes that are the same kind of number, of 1


def doubts(recorded: Recording) -> list[str]:
    """A line for everything in a recording's metadata that its samples, or common sense, speak against."""
    lines = []
    if recorded.sample_rate_hz and (question := questioned(recorded.sample_rate_hz, LEAST_RATE_HZ, "a rate")):
        lines.append(f"core:sample_rate: {question.partition('? ')[0]}?")
    if recorded.center_frequency_hz and (question := questioned(recorded.center_frequency_hz, LEAST_CARRIER_HZ, "a carrier")):
        lines.append(f"core:frequency: {question.partition('? ')[0]}?")
    if looks := _looks_like(to_raw(recorded.samples[:LOOKED_AT], recorded.datatype).view(np.uint8), recorded.datatype):
        lines.append(f"core:datatype: says {recorded.datatype}, but {looks}")
    return lines


def _looks_like(data: np.ndarray, datatype: str) -> str:
    """Why bytes (n,) are hardly samples of `datatype`, and of which they may be; "" where nothing speaks against it."""
    words = data[: len(data) // 8 * 8].reshape(-1, 8)
    data = words[words.any(axis=1)].reshape(-1)  # silence tells nothing
    if len(data) < 8 * LEAST:
        return ""
    floats, shorts, pairs = data.view("<u4"), data.view("<u2"), data.reshape(-1, 2)
    exponents = (floats[floats & 0x7FFFFFFF != 0] >> 23) & 255
    if datatype == "cf32_le":
        huge = np.mean((exponents > EXPONENTS[1]) & (exponents < 255)) if len(exponents) > LEAST else 0.0  # 255: NaN, not known
        return "samples are far beyond full scale, which is 1: is it ci16_le, ci8 or cu8?" if huge > 0.01 else ""
    are_floats = len(exponents) > LEAST and np.mean((exponents > EXPONENTS[0]) & (exponents <= EXPONENTS[1])) > SURE
    low_halves = shorts[::2] / 65536
    is_noise = abs(low_halves.std() * np.sqrt(12) - 1) < 0.03 and _entropy(data[::4]) > MANY
    if are_floats and (is_noise or np.mean(low_halves == 0) > 0.9):
        return "they are as floats are: is it cf32_le?"
    first, second = pairs[:, 0], pairs[:, 1]
    if datatype == "ci16_le":
        is_alike = np.abs(_histogram(first) - _histogram(second)).sum() / 2 < ALIKE
        return "its low bytes are as its high ones: is it ci8 or cu8?" if is_alike and 1 < _entropy(first) < NOISE else ""
    is_sign = np.mean((second == 255 * (first > 127)) & np.isin(second, (0, 255))) > SURE and np.ptp(second) > 0
    if is_sign or (_entropy(first) > NOISE and _entropy(second) < _entropy(first) - 1):
        return "Q is as the high byte of I: is it ci16_le?"
    size = np.abs(to_complex(data.view(DATATYPES[datatype][0]), datatype).view(np.float32))
    outer, inner, rails = np.mean(size > 7 / 8), np.mean(size < 1 / 8), np.mean(size > 127 / 128 - 1e-6)
    if inner < 0.02 * outer and rails < outer / 2:
        return f"more is near full scale than near 0: is it {'cu8' if datatype == 'ci8' else 'ci8'}?"
    return ""


def _histogram(byte: np.ndarray) -> np.ndarray:
    return np.bincount(byte, minlength=256) / len(byte)


def _entropy(byte: np.ndarray) -> float:
    """Bits that a byte tells."""
    share = _histogram(byte)
    return float(-np.sum(share[share > 0] * np.log2(share[share > 0])))
