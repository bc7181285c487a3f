# SPDX-License-Identifier: GPL-3.0-or-later
"""Physics outside the contract's list, as GNU Radio makes it: a diagnosis must say `unexplained`."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from gnuradio import analog, blocks, channels

from . import flow


@dataclass(frozen=True, kw_only=True)
class Kind:
    """act: (x, size, draw, context) → x, at `place` of the world (tx_before, tx, channel, rx)."""

    place: str
    level: str
    act: Callable
    draw: Callable = lambda rng, c: {}
    where: Callable = lambda d, c: {}
    tolerated: tuple = ()
    start: float = 0.05
    most: float = 1.0
    fixed: bool = False
    few_taps: bool = False
    waveforms: tuple = ("rrc_qpsk", "rrc", "ofdm", "builtin", "zadoff_chu")


def _stretch(rng, c):
    length = int(c.count * rng.uniform(0.08, 0.25))
    return {
        "from": int(rng.uniform(0.1, 0.6) * c.count),
        "length": length,
        "shift": int(rng.integers(3, 40)),
        "seed": int(rng.integers(2**31 - 9)),
    }


def _interval(d, c):
    return {"time_s": [d["from"] / c.rate, (d["from"] + d["length"]) / c.rate]}


def _parts(x, d, c):
    a = c.first + d["from"]
    return x[:a], x[a : a + d["length"]], x[a + d["length"] :]


def _join(*parts):
    return flow.combine(blocks.stream_mux(8, [len(p) for p in parts]), *parts)


def _shifted(x, size, d, c):
    """A stretch turned round within itself: its last samples come first."""
    before, middle, after = _parts(x, d, c)
    return _join(before, middle[-d["shift"] :], middle[: -d["shift"]], after)


def _burst(x, size, d, c):
    """Noise during one stretch only."""
    before, middle, after = _parts(x, d, c)
    return _join(before, flow.add(middle, flow.gaussian(len(middle), size**2 * c.power, d["seed"])), after)


def _turned_stretch(x, size, d, c):
    """One stretch turned by an angle: a symbol clock or a synthesiser that slipped and came back."""
    before, middle, after = _parts(x, d, c)
    return _join(before, flow.through(middle, blocks.multiply_const_cc(complex(np.exp(1j * size)))), after)


def _no_prefix(x, size, d, c):
    """OFDM sent with its cyclic prefixes faded out, which the reference still holds."""
    n = np.arange(len(x)) - c.first - int(np.floor(c.bulk))
    return flow.multiply(x, np.where(n % 144 < 16, 1 - size, 1.0))


def _wrong_chips(x, size, d, c):
    """The same few samples of every period sent wrongly."""
    n = np.arange(len(x)) - c.first - int(np.floor(c.bulk))
    at = (n - d["shift"]) % len(c.waveform.samples)
    return flow.multiply(x, np.where(at < 3 * c.waveform.samples_per_chip, 1 + 1j * size, 1.0))


def _skew(x, size, d, c):
    """Q later than I: an image that grows with frequency."""
    late = (np.roll(x.imag, 1) - np.roll(x.imag, -1)) / 2
    return flow.add(x, 1j * size * late)


def _agc(x, size, d, c):
    """Gain pumping of `agc2_cc`, in part."""
    rms = np.sqrt(c.power)
    pumped = flow.same_length(x, analog.agc2_cc(d["attack"], d["attack"] / 4, rms, 1.0))
    return flow.add((1 - size) * x, size * pumped)


def _cubic_echo(x, size, d, c):
    """An echo from something that is not linear: |x|²x, later."""
    late = flow.through(x, blocks.delay(8, d["shift"]))[: len(x)]
    cubic = flow.same_length(late, channels.distortion_3_gen(1.0)) - late
    return flow.add(x, size * cubic / (1.5 * c.power))


def _second_order(x, size, d, c):
    """x + γ(x² + |x|²) of `distortion_2_gen`."""
    return flow.same_length(x, channels.distortion_2_gen(size / np.sqrt(c.power)))


def _clock_wander(x, size, d, c):
    """A sample clock that wanders: delay size·sin, by linear interpolation of early and late copies."""
    turn = flow.oscillator(d["cycles"] / c.count, len(x), c.first).imag
    slope = (np.roll(x, -1) - np.roll(x, 1)) / 2
    return flow.add(x, flow.multiply(slope, size * turn))


def _frequency_wander(x, size, d, c):
    """`cfo_model`: a carrier on a random walk."""
    model = channels.cfo_model(c.rate, size * c.rate / c.count, 200 * c.rate / c.count, d["seed"] % 10_000)
    return flow.same_length(x, model)


def _eager_corrector(x, size, d, c):
    """A blind I/Q corrector (`phase_bal`) that follows the symbols instead of the imbalance, in part."""
    corrected = flow.same_length(x, channels.phase_bal(d["attack"]))
    return flow.add((1 - size) * x, size * corrected)


def _clock_walk(x, size, d, c):
    """`sro_model`: a sample clock on a random walk."""
    model = channels.sro_model(c.rate, size * c.rate / c.count, 400e-6 * c.rate, d["seed"] % 10_000)
    return flow.same_length(x, model)


def _hop(x, size, d, c):
    """From one moment on the whole signal turns by an angle: a slipped synthesiser."""
    at = c.first + d["from"]
    return _join(x[:at], flow.through(x[at:], blocks.multiply_const_cc(complex(np.exp(1j * size)))))


KINDS = {
    "shifted_stretch": Kind(
        place="tx",
        level="tx",
        act=_shifted,
        draw=_stretch,
        where=_interval,
        tolerated=("sample_loss",),
        fixed=True,
    ),
    "noise_burst": Kind(
        place="channel",
        level="rx",
        act=_burst,
        draw=_stretch,
        where=_interval,
        tolerated=("pulsed_interference",),
    ),
    "turned_stretch": Kind(
        place="tx",
        level="tx",
        act=_turned_stretch,
        draw=_stretch,
        where=_interval,
        most=3.0,
        tolerated=("phase_noise",),
    ),
    "no_prefix": Kind(place="tx_before", level="tx", act=_no_prefix, waveforms=("ofdm",)),
    "wrong_chips": Kind(
        place="tx_before",
        level="tx",
        act=_wrong_chips,
        draw=_stretch,
        waveforms=("builtin", "rrc_qpsk", "zadoff_chu"),
        most=2.0,
    ),
    "iq_skew": Kind(
        place="rx",
        level="rx",
        act=_skew,
        tolerated=("iq_imbalance",),
        waveforms=("rrc_qpsk", "ofdm"),
        most=0.5,
    ),
    "eager_corrector": Kind(
        place="rx",
        level="rx",
        act=_eager_corrector,
        draw=lambda r, c: {"attack": float(10 ** r.uniform(-2.3, -1.3))},
        tolerated=("iq_imbalance",),
        waveforms=("rrc_qpsk", "ofdm"),
    ),
    "clock_walk": Kind(
        place="rx",
        level="rx",
        act=_clock_walk,
        draw=_stretch,
        start=0.001,
        tolerated=("sample_clock_offset", "tap_delay_error"),
        waveforms=("rrc_qpsk", "rrc"),
    ),
    "frequency_wander": Kind(
        place="rx",
        level="rx",
        act=_frequency_wander,
        draw=_stretch,
        start=0.01,
        tolerated=("phase_noise", "carrier_frequency_offset"),
    ),
    "agc_pumping": Kind(
        place="rx",
        level="rx",
        act=_agc,
        draw=lambda r, c: {"attack": float(10 ** r.uniform(-2.3, -1.3))},
        tolerated=("gain_drift", "pa_nonlinearity"),
        waveforms=("rrc_qpsk", "ofdm"),
    ),
    "cubic_echo": Kind(
        place="channel",
        level="link",
        act=_cubic_echo,
        draw=_stretch,
        tolerated=("extra_path", "pa_nonlinearity"),
        waveforms=("rrc_qpsk", "ofdm"),
    ),
    "second_order": Kind(
        place="rx",
        level="rx",
        act=_second_order,
        tolerated=("dc_offset", "lo_leakage", "pa_nonlinearity"),
        waveforms=("rrc_qpsk", "ofdm"),
    ),
    "clock_wander": Kind(
        place="rx",
        level="rx",
        act=_clock_wander,
        draw=lambda r, c: {"cycles": float(r.uniform(2, 9))},
        tolerated=("sample_clock_offset", "tap_delay_error"),
        waveforms=("rrc_qpsk", "rrc"),
        most=0.4,
    ),
    "phase_jump": Kind(
        place="rx",
        level="rx",
        act=_hop,
        draw=_stretch,
        tolerated=("phase_noise", "sample_loss"),
        most=3.0,
        where=lambda d, c: {"time_s": [d["from"] / c.rate] * 2},
    ),
}
