# SPDX-License-Identifier: GPL-3.0-or-later
"""Band-limited signals on finer grids and at any positions."""

import numpy as np

TURN = 2 * np.pi


def periodic(x, times, delay, index):
    """A periodic signal's samples x(index/times − delay); delay in samples."""
    n = len(x)
    line = np.fft.fft(x) * np.exp(-1j * TURN * np.fft.fftfreq(n) * delay)
    wide = np.zeros(n * times, complex)
    half = (n - 1) // 2
    wide[: half + 1], wide[-half:] = line[: half + 1], line[-half:]
    return (np.fft.ifft(wide) * times)[index % (n * times)]


# A Kaiser-windowed sinc for a signal that fills half of its grid's band: flat to a half of Nyquist, nothing from 1 on.
HALF, CUT, STEPS = 20, 0.75, 2000
_GRID = np.linspace(-HALF - 1, HALF + 1, 2 * (HALF + 1) * STEPS + 1)
_SHARE = np.sqrt(np.maximum(0, 1 - (_GRID / HALF) ** 2))
_KERNEL = CUT * np.sinc(CUT * _GRID) * np.where(np.abs(_GRID) < HALF, np.i0(9.0 * _SHARE) / np.i0(9.0), 0)


def at(v, positions):
    """The signal v, on a grid twice as fine as its band needs, at fractional positions of that grid."""
    whole = np.floor(positions).astype(int)
    part = (positions - whole) * STEPS
    entry = np.floor(part).astype(int)
    part -= entry
    out = np.zeros(len(positions), complex)
    for k in range(-HALF + 1, HALF + 1):
        j = entry + (HALF + 1 - k) * STEPS
        out += v[whole + k] * (_KERNEL[j] * (1 - part) + _KERNEL[j + 1] * part)
    return out
