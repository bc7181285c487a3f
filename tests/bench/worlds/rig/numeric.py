# SPDX-License-Identifier: GPL-3.0-or-later
"""Band-limited interpolation of periodic arrays, filtering, and the fit of what a twin does not claim to know."""

import numpy as np
from scipy.fft import fft, fftfreq, ifft, next_fast_len


def delayed(x, delay):
    """A periodic array, delayed by any number of samples; at the Nyquist bin the mean of both its signs."""
    whole = int(np.floor(delay))
    part = delay - whole
    if part:
        turn = np.exp(-2j * np.pi * fftfreq(len(x)) * part)
        if len(x) % 2 == 0:
            turn[len(x) // 2] = np.cos(np.pi * part)
        x = ifft(fft(x) * turn)
    return np.roll(x, whole)


def oversampled(x, times):
    """A periodic array on a grid `times` as fine, exactly."""
    n = len(x)
    spectrum, wide = fft(x), np.zeros(n * times, complex)
    half = n // 2
    wide[: half + (n % 2)] = spectrum[: half + (n % 2)]
    wide[-half:] = spectrum[-half:]
    if n % 2 == 0:
        wide[half] = wide[-half] = spectrum[half] / 2
    return ifft(wide) * times


def narrowed(x, times):
    """The inverse of `oversampled` behind an ideal anti-alias filter."""
    n = len(x) // times
    half = n // 2
    spectrum, out = fft(x), np.zeros(n, complex)
    out[: half + (n % 2)] = spectrum[: half + (n % 2)]
    out[-half:] = spectrum[-half:]
    if n % 2 == 0:
        out[half] = spectrum[half] + spectrum[-half]
    return ifft(out) / times


# Lagrange interpolation over 8 points of a grid 8 times as fine: errors below −90 dB up to the Nyquist frequency.
_POINTS = np.arange(-3, 5)


def at(x, positions, times=8):
    """A periodic array at any positions, in samples."""
    fine = oversampled(x, times)
    p = np.asarray(positions) * times
    base = np.floor(p).astype(np.int64)
    part = p - base
    out = np.zeros(len(p), complex)
    for j in _POINTS:
        weight = np.ones(len(p))
        for k in _POINTS:
            if k != j:
                weight *= (part - k) / (j - k)
        out += weight * fine[(base + j) % len(fine)]
    return out


def filtered(x, response, rate):
    """response: a function of frequency in Hz, or an array in the order of `fftfreq`."""
    h = response(fftfreq(len(x), 1 / rate)) if callable(response) else response
    return ifft(fft(x) * h)


def slope(x):
    """Derivative of a periodic array, per sample."""
    w = 2j * np.pi * fftfreq(len(x))
    if len(x) % 2 == 0:
        w[len(x) // 2] = 0
    return ifft(fft(x) * w)


def lag(y, x):
    """Delay of y against x in samples, to the nearest, of two arrays of one grid."""
    n = next_fast_len(len(y) + 64)
    c = np.abs(ifft(fft(y, n) * np.conj(fft(x, n))))
    k = int(np.argmax(c))
    return k if k <= n // 2 else k - n


def refit(y, x, window, mask, rounds=4, search=True):
    """What is left of y[window] after the gain, phase and delay of the wide, periodic x are fitted: (residual, fit, delay)."""
    keep = np.flatnonzero(mask)
    target = y[window][keep]
    d = 0.0
    if search:
        a, b = np.where(mask, y[window], 0), np.where(mask, x[window], 0)
        k = lag(a, b)
        if abs(k) <= 64:
            d = float(k)
    best = None
    for _ in range(rounds):
        moved = delayed(x, d)
        u, v = moved[window][keep], slope(moved)[window][keep]
        gram = np.array([[np.vdot(u, u), np.vdot(u, v)], [np.vdot(v, u), np.vdot(v, v)]])
        g, h = np.linalg.lstsq(gram, np.array([np.vdot(u, target), np.vdot(v, target)]), rcond=None)[0]
        g1 = np.vdot(u, target) / np.vdot(u, u)
        residual = target - g1 * u
        energy = np.vdot(residual, residual).real
        if best is not None and energy > best[0]:
            break
        best = (energy, residual, g1 * u, d)
        step = -(h / g).real if g != 0 else 0.0
        if not np.isfinite(step) or abs(step) < 1e-7:
            break
        d += float(np.clip(step, -1, 1))
    return best[1:]
