# SPDX-License-Identifier: GPL-3.0-or-later
"""Transmitted waveforms: built-in codes and files, made with gr-digital, gr-filter and gr-fft."""

from dataclasses import dataclass

import numpy as np
from gnuradio import blocks, digital, fft, filter

from . import flow


@dataclass(frozen=True, kw_only=True)
class Waveform:
    """One period, or all of a waveform that is sent once. `code`: its entry in twin.yaml if built in."""

    name: str
    samples: np.ndarray
    samples_per_chip: int
    repeat: bool = True
    code: dict | None = None

    @property
    def constant_envelope(self):
        return bool(np.ptp(np.abs(self.samples)) < 1e-6)

    @property
    def real(self):
        return bool(np.all(np.abs(self.samples.imag) < 1e-9))


def glfsr(rng, degree=None, per_chip=None):
    """The ±1 code of `digital.glfsr_source_f`, each chip held by `blocks.repeat`."""
    degree = degree or int(rng.choice([7, 8, 9, 10]))
    per_chip = per_chip or int(rng.integers(2, 5))
    length = 2**degree - 1
    seed = int(rng.integers(1, length))
    chips = flow.samples_real(digital.glfsr_source_f(degree, True, 0, seed), length)
    held = flow.through(chips, blocks.repeat(8, per_chip))
    code = {"code": "glfsr", "degree": degree, "mask": 0, "seed": seed, "samples_per_chip": per_chip}
    return Waveform(name="builtin", samples=np.sign(held.real) + 0j, samples_per_chip=per_chip, code=code)


def zadoff_chu(rng):
    """exp(−jπ·u·n·(n+1)/N), N odd and prime; chips held (Chu, IEEE Trans. Inf. Theory 18(4), 1972)."""
    length, per_chip = int(rng.choice([139, 251, 353, 839])), int(rng.integers(2, 4))
    root, n = int(rng.integers(1, 100)), np.arange(length)
    chips = np.exp(-1j * np.pi * (root * n * (n + 1) % (2 * length)) / length)
    code = {"code": "zadoff_chu", "length": length, "root": root, "samples_per_chip": per_chip}
    return Waveform(name="zadoff_chu", samples=np.repeat(chips, per_chip), samples_per_chip=per_chip, code=code)


def _unit_power(x):
    return x / np.sqrt(np.mean(np.abs(x) ** 2))


def _without_nyquist(x):
    """Half the sample rate has no defined fractional delay: a period of even length goes without it."""
    turn = (-1.0) ** np.arange(len(x))
    return x - turn * np.mean(x * turn) if len(x) % 2 == 0 else x


def _bits(rng, count, top):
    return rng.integers(0, top, count).astype(np.uint8)


def shaped_qpsk(rng, repeat=True, symbols=None):
    """QPSK through GNU Radio's root-raised-cosine interpolator."""
    per_chip = int(rng.integers(3, 6))
    symbols = symbols or int(rng.choice([127, 200, 255, 400, 511]))
    points = np.array(digital.constellation_qpsk().points())[_bits(rng, symbols, 4)]
    roll_off = float(rng.uniform(0.2, 0.4))
    taps = filter.firdes.root_raised_cosine(per_chip, per_chip, 1.0, roll_off, 32 * per_chip + 1)
    guard = 40
    ends = (points[-guard:], points[: guard + 40]) if repeat else (np.zeros(guard), np.zeros(guard + 40))
    x = flow.through(np.concatenate([ends[0], points, ends[1]]), filter.interp_fir_filter_ccf(per_chip, taps))
    if repeat:
        x = x[guard * per_chip + 16 * per_chip :][: symbols * per_chip]
    else:
        x = x[guard * per_chip :][: (symbols + 33) * per_chip]
    name, x = ("rrc_qpsk", _without_nyquist(x)) if repeat else ("burst", x)
    return Waveform(name=name, samples=_unit_power(x), samples_per_chip=per_chip, repeat=repeat)


def shaped_bpsk(rng):
    """A ±1 code, root-raised-cosine shaped: real, but not of constant envelope."""
    base = glfsr(rng, degree=int(rng.choice([7, 8, 9])), per_chip=1)
    per_chip = int(rng.integers(3, 5))
    taps = filter.firdes.root_raised_cosine(per_chip, per_chip, 1.0, float(rng.uniform(0.2, 0.4)), 32 * per_chip + 1)
    chips = np.tile(base.samples, 3)
    x = flow.through(chips, filter.interp_fir_filter_ccf(per_chip, taps))
    x = x[(len(base.samples) + 16) * per_chip :][: len(base.samples) * per_chip]
    return Waveform(name="rrc", samples=_unit_power(_without_nyquist(x.real)) + 0j, samples_per_chip=per_chip)


def ofdm(rng, repeat=True):
    """QPSK on 53 of 128 subcarriers by `fft.fft_vcc`, prefix by `digital.ofdm_cyclic_prefixer`."""
    size, prefix, count = 128, 16, int(rng.integers(8, 20) if repeat else rng.integers(100, 200))
    used = np.r_[1:27, size - 26 : size]
    grid = np.zeros((count, size), complex)
    grid[:, used] = np.array(digital.constellation_qpsk().points())[_bits(rng, count * len(used), 4)].reshape(count, -1)
    top = flow.gr.top_block("bank", catch_exceptions=False)
    source = blocks.vector_source_c(grid.astype(np.complex64).ravel(), False, size)
    inverse = fft.fft_vcc(size, False, [], False)
    cyclic, sink = digital.ofdm_cyclic_prefixer(size, size + prefix), blocks.vector_sink_c()
    top.connect(source, inverse, cyclic, sink)
    top.run()
    x = np.array(sink.data())[: count * (size + prefix)]
    x = _without_nyquist(x) if repeat else x
    return Waveform(name="ofdm" if repeat else "burst_ofdm", samples=_unit_power(x), samples_per_chip=2, repeat=repeat)
