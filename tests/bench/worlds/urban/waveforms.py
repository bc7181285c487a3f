# SPDX-License-Identifier: GPL-3.0-or-later
"""What is on the air in a city: frames of mobile radio, wireless LAN, vehicles, sensors."""

import numpy as np
from scipy.fft import fft, ifft

from ..rig import numeric, waves
from ..rig.waves import Wave
from ..rig.world import hide, pick


def again(wave, make):
    wave.family["again"] = make
    return wave


def cellular(rng):
    """LTE/NR-like CP-OFDM with a longer first prefix in every slot; a slot repeated, or a frame sent once."""
    size, active, order = pick(rng, [(128, 72, 4), (256, 180, 16), (512, 300, 64), (128, 60, 4)])
    once = bool(rng.random() < 0.45)
    return cellular_of(rng, size, active, order, once, pick(rng, [1, 2]), int(rng.integers(1, 4)) if once else 1)


def cellular_of(rng, size, active, order, once, times, slots):
    short, first = int(size * 0.0703), int(size * 0.0781)
    parts = []
    symbols = 7 if once or size < 512 else 3
    for _ in range(slots if once else 1):
        for n in range(symbols):
            prefix = first if n == 0 else short
            parts.append(waves.ofdm(rng, size=size, prefix=prefix, active=active, symbols=1, order=order, times=times))
    x = np.concatenate(parts)
    x = x / np.sqrt(np.mean(np.abs(x) ** 2))
    if once:
        while len(x) < 8000:
            x = np.concatenate([x, cellular_of(rng, size, active, order, True, times, slots + 1).samples])
    w = Wave(
        name=f"cellular OFDM-{size}{', once' if once else ''}",
        samples=x,
        repeat=not once,
        samples_per_chip=times * size / active,
    )
    return again(w, lambda r: cellular_of(r, size, active, order, once, times, slots))


def cellular_pilots(rng):
    """The same with the data between the reference symbols unknown."""
    return hide(rng, cellular(rng), fractions=(0.5, 0.8), stretches=(3, 8))


def single_carrier(rng):
    """SC-FDMA: QAM spread by a DFT over neighbouring subcarriers, beside the carrier."""
    size, active, low = pick(rng, [(256, 96, -20), (256, 60, 25), (512, 144, -100)])
    return single_carrier_of(rng, size, active, low, 7 if size == 256 else 3)


def single_carrier_of(rng, size, active, low, symbols):
    parts = []
    for _ in range(symbols):
        grid = np.zeros(size, complex)
        grid[(low + np.arange(active)) % size] = fft(waves.constellation(rng, 4, active)) / np.sqrt(active)
        s = ifft(grid) * size
        parts.append(np.concatenate([s[-18:], s]))
    x = np.concatenate(parts)
    x = x / np.sqrt(np.mean(np.abs(x) ** 2))
    w = Wave(name="SC-FDMA", samples=x, samples_per_chip=size / active)
    return again(w, lambda r: single_carrier_of(r, size, active, low, symbols))


def spread_spectrum(rng):
    """WCDMA-like: QPSK chips under a 0.22 root raised cosine, odd periods."""
    period = pick(rng, [1683, 1751, 1823, 1881, 1921, 1979, 2043, 2129, 2231, 2299])
    return spread_of(rng, period, int(period / rng.uniform(1.6, 4.0)))


def spread_of(rng, period, chips):
    x = waves.shaped(waves.constellation(rng, 4, chips), period, 0.22)
    return again(Wave(name="WCDMA", samples=x, samples_per_chip=period / chips), lambda r: spread_of(r, period, chips))


def lan_burst(rng):
    """A wireless-LAN frame, twice oversampled: short and long training, then data; sent once."""
    short = np.zeros(64, complex)
    places = np.array([-24, -20, -16, -12, -8, -4, 4, 8, 12, 16, 20, 24])
    short[places % 64] = np.sqrt(13 / 6) * (1 + 1j) * np.array([1, -1, 1, -1, -1, 1, -1, -1, 1, 1, 1, 1])
    signs = rng.choice([-1.0, 1.0], 53)
    signs[26] = 0
    long = np.zeros(64, complex)
    long[np.arange(-26, 27) % 64] = signs
    fine = [numeric.oversampled(ifft(v) * 64, 2) for v in (short, long)]
    head = np.concatenate([np.tile(fine[0][:32], 10), fine[1][-64:], fine[1], fine[1]])
    data = waves.ofdm(
        rng, size=64, prefix=16, active=52, symbols=int(rng.integers(40, 150)), order=pick(rng, [4, 16]), taper=4, times=2
    )
    x = np.concatenate([head / np.sqrt(np.mean(np.abs(head) ** 2)), data])
    return Wave(name="WLAN frame, once", samples=x, repeat=False, samples_per_chip=2 * 64 / 52)


def synchronisation(rng):
    """A primary synchronisation signal among empty symbols: Zadoff–Chu on the inner subcarriers; repeated with odd periods."""
    period, root = pick(rng, [1747, 1881, 1921, 2017, 2203]), pick(rng, [25, 29, 34])
    length = pick(rng, [61, 139, 419])
    n = np.arange(length)
    chips = np.exp(-1j * np.pi * root * n * (n + 1) / length)
    x = waves.shaped(np.tile(chips, max(1, int(period / 2.2 / length))), period, 0.3)
    return Wave(name="synchronisation", samples=x, samples_per_chip=period / (length * max(1, int(period / 2.2 / length))))


def bursts_gmsk(rng):
    """GSM-like: normal bursts with guard times, ramped, sent once."""
    per = int(rng.integers(4, 7))
    return bursts_of(rng, per, int(rng.integers(10, 26)))


def bursts_of(rng, per, count):
    out = []
    for _ in range(count):
        s = waves.continuous_phase(rng.choice([-1, 1], 148), per, 0.5, 0.3, closed=False)
        ramp = 0.5 - 0.5 * np.cos(np.pi * (np.arange(2 * per) + 0.5) / (2 * per))
        s[: 2 * per] *= ramp
        s[-2 * per :] *= ramp[::-1]
        out.append(np.concatenate([s, np.zeros(round(8.25 * per))]))
    w = Wave(name="GSM bursts, once", samples=np.concatenate(out), repeat=False, samples_per_chip=per)
    return again(w, lambda r: bursts_of(r, per, count))


def beacon(rng):
    """Bluetooth-like GFSK, index 1/2, repeated."""
    per, count = int(rng.integers(3, 8)), 2 * int(rng.integers(120, 330))
    return beacon_of(rng, per, count)


def beacon_of(rng, per, count):
    x = waves.continuous_phase(rng.choice([-1, 1], count), per, 0.5, 0.5)
    return again(Wave(name="GFSK beacon", samples=x, samples_per_chip=per), lambda r: beacon_of(r, per, count))


def zigbee(rng):
    """O-QPSK with half-sine chips: a constant envelope; repeated."""
    return zigbee_of(rng, 2 * int(rng.integers(2, 4)), 2 * int(rng.integers(130, 260)))


def zigbee_of(rng, per, chips):
    arc = np.sin(np.pi * (np.arange(2 * per) + 0.5) / (2 * per))
    i = np.concatenate([a * arc for a in rng.choice([-1.0, 1.0], chips // 2)])
    q = np.concatenate([a * arc for a in rng.choice([-1.0, 1.0], chips // 2)])
    x = i + 1j * np.roll(q, per)
    return again(Wave(name="O-QPSK", samples=x, samples_per_chip=per), lambda r: zigbee_of(r, per, chips))


def sounder(rng):
    """A channel sounder's code."""
    hold = pick(rng, [2, 3, 4])
    entry = pick(
        rng,
        [
            {"code": "glfsr", "degree": pick(rng, [8, 9, 10]), "mask": 0, "seed": int(rng.integers(1, 250))},
            {"code": "gold", "length": 511},
            {"code": "gb128"},
            {"code": "ls"},
        ],
    )
    if hold == 3 and entry["code"] in ("ls", "ga128", "gb128"):
        hold = 4  # an even period with power at the Nyquist frequency could not be delayed by a fraction
    w = waves.builtin({**entry, "samples_per_chip": hold})

    def other(r):
        x = np.repeat(r.choice([-1.0, 1.0], len(w.samples) // hold), hold).astype(complex)
        return Wave(name="other code", samples=x, samples_per_chip=hold)

    return again(w, other)


def navigation(rng):
    """A BPSK ranging code through the satellite's filter: a prime period, no whole number of samples per chip."""
    return navigation_of(rng, pick(rng, [1823, 2039, 2179]))


def navigation_of(rng, period):
    x = waves.shaped(rng.choice([-1.0, 1.0], 511).astype(complex), period, 0.9, root=False)
    return again(Wave(name="ranging code", samples=x, samples_per_chip=period / 511), lambda r: navigation_of(r, period))


EVERY = (
    cellular,
    cellular,
    cellular_pilots,
    single_carrier,
    spread_spectrum,
    spread_spectrum,
    lan_burst,
    synchronisation,
    bursts_gmsk,
    beacon,
    zigbee,
    sounder,
    sounder,
    navigation,
)
CONSTANT = (beacon, zigbee, sounder)
REAL = (sounder, navigation)
