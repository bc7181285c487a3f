# SPDX-License-Identifier: GPL-3.0-or-later
"""What a laboratory's generators send."""

import numpy as np

from ..rig import waves
from ..rig.waves import Wave
from ..rig.world import hide, pick

PERIODS = (1601, 1667, 1721, 1777, 1801, 1881, 1901, 1921, 1999, 2003, 2047, 2113, 2187, 2221, 2297)


def again(wave, make):
    wave.family["again"] = make
    return wave


def psk(rng, order=4, once=None):
    """Root-raised-cosine QPSK, 16-QAM, 64-QAM: odd and prime periods, any ratio of rates; or a burst sent once."""
    once = rng.random() < 0.3 if once is None else once
    period = int(rng.integers(9_000, 40_000)) if once else pick(rng, PERIODS)
    ratio = rng.uniform(2.0, 4.5)
    beta = pick(rng, [0.2, 0.22, 0.25, 0.35, 0.5])
    return psk_of(rng, order, once, period, int(period / ratio), beta)


def psk_of(rng, order, once, period, count, beta):
    x = waves.shaped(waves.constellation(rng, order, count), period, beta)
    if once:
        ramp = 0.5 - 0.5 * np.cos(np.pi * (np.arange(64) + 0.5) / 64)
        x[:64] *= ramp
        x[-64:] *= ramp[::-1]
    name = f"{order}-QAM{', once' if once else ''}"
    w = Wave(name=name, samples=x, repeat=not once, samples_per_chip=period / count)
    return again(w, lambda r: psk_of(r, order, once, period, count, beta))


def qpsk(rng):
    return psk(rng, 4)


def qam(rng):
    return psk(rng, pick(rng, [16, 64]))


def bpsk(rng):
    return psk(rng, 2, False)


def ofdm(rng):
    """CP-OFDM of three numerologies, twice oversampled, once or repeated."""
    size, prefix, active = pick(rng, [(64, 16, 52), (128, 9, 72), (256, 32, 200), (512, 36, 300)])
    once = rng.random() < 0.35
    span = (size + prefix) * 2
    symbols = int(rng.integers(8_000, 30_000) // span) if once else max(2, int(rng.integers(1_600, 5_000) // span))
    return ofdm_of(rng, size, prefix, active, symbols, once, pick(rng, [4, 16, 64]))


def ofdm_of(rng, size, prefix, active, symbols, once, order):
    x = waves.ofdm(rng, size=size, prefix=prefix, active=active, symbols=symbols, order=order, taper=8, times=2)
    w = Wave(name=f"OFDM-{size}{', once' if once else ''}", samples=x, repeat=not once, samples_per_chip=2 * size / active)
    return again(w, lambda r: ofdm_of(r, size, prefix, active, symbols, once, order))


def lora(rng):
    factor, times = pick(rng, [(7, 2), (7, 4), (8, 2), (9, 2)])
    return lora_of(rng, factor, times, int(rng.integers(3, 9)))


def lora_of(rng, factor, times, count):
    x = waves.chirps(rng.integers(0, 2**factor, count), factor, times)
    return again(
        Wave(name=f"chirps SF{factor}", samples=x, samples_per_chip=times, limited=times > 2),
        lambda r: lora_of(r, factor, times, count),
    )


def sweep(rng):
    """One linear chirp per period, as a network analyser or a radar sweeps; odd period, phase closed."""
    period = pick(rng, PERIODS)
    share = rng.uniform(0.2, 0.6)
    n = np.arange(period)
    k = 2 * round(share * period / 2)
    phase = np.pi * k / period * (n - (period - 1) / 2) ** 2 / period
    return Wave(name="sweep", samples=np.exp(1j * phase), samples_per_chip=1 / share, limited=True)


def gmsk(rng):
    per, bt = int(rng.integers(4, 9)), pick(rng, [0.3, 0.5])
    return gmsk_of(rng, per, bt, 2 * int(rng.integers(100, 350)))


def gmsk_of(rng, per, bt, count):
    x = waves.continuous_phase(rng.choice([-1, 1], count), per, 0.5, bt)
    return again(Wave(name="GMSK", samples=x, samples_per_chip=per), lambda r: gmsk_of(r, per, bt, count))


def gfsk(rng):
    """A 2-FSK packet with a Gaussian filter, sent once."""
    per, index = int(rng.integers(4, 9)), rng.uniform(0.3, 0.7)
    return gfsk_of(rng, per, index, int(rng.integers(1_200, 3_500)))


def gfsk_of(rng, per, index, count):
    x = waves.continuous_phase(rng.choice([-1, 1], count), per, index, 0.5, closed=False)
    w = Wave(name="GFSK, once", samples=x, repeat=False, samples_per_chip=per)
    return again(w, lambda r: gfsk_of(r, per, index, count))


def random_chips(rng, wave):
    hold = wave.samples_per_chip
    x = np.repeat(rng.choice([-1.0, 1.0], len(wave.samples) // hold), hold).astype(complex)
    return Wave(name="other code", samples=x, samples_per_chip=hold, limited=False)


def code(rng):
    hold = pick(rng, [2, 2, 3, 4, 4])
    entry = pick(
        rng,
        [
            {"code": "glfsr", "degree": pick(rng, [8, 9, 10]), "mask": 0, "seed": int(rng.integers(1, 200))},
            {"code": "gold", "length": pick(rng, [127, 511])},
            {"code": "ls"},
            {"code": "ga128"},
        ],
    )
    if hold == 3 and entry["code"] in ("ls", "ga128", "gb128"):
        hold = 4  # an even period with power at the Nyquist frequency could not be delayed by a fraction
    w = waves.builtin({**entry, "samples_per_chip": hold})
    return again(w, lambda r: random_chips(r, w))


def zadoff_chu(rng):
    length = pick(rng, [353, 419, 571, 839])
    if rng.random() < 0.5:
        entry = {
            "code": "zadoff_chu",
            "length": length,
            "root": int(rng.integers(1, 200)),
            "samples_per_chip": pick(rng, [2, 3, 4]),
        }
        w = waves.builtin(entry)
        return again(w, lambda r: waves.builtin({**entry, "root": (entry["root"] + int(r.integers(1, 100))) % length}))
    period = pick(rng, PERIODS)
    return zadoff_chu_of(rng, length, period)


def zadoff_chu_of(rng, length, period):
    x = waves.shaped(waves.zadoff_chu(length, int(rng.integers(1, length))), period, 0.25)
    w = Wave(name="Zadoff-Chu, shaped", samples=x, samples_per_chip=period / length, limited=period > 2.6 * length)
    return again(w, lambda r: zadoff_chu_of(r, length, period))


def piloted(rng):
    """Data between pilots: the reference file does not tell them."""
    once = rng.random() < 0.6
    return hide(rng, psk(rng, 4, once=once))


EVERY = (qpsk, qpsk, qam, ofdm, ofdm, lora, sweep, gmsk, gfsk, code, code, zadoff_chu, bpsk, piloted)
CONSTANT = (gmsk, sweep, code)
REAL = (code, bpsk)
SHAPED = (qpsk, qam, ofdm)
