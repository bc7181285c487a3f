# SPDX-License-Identifier: GPL-3.0-or-later
"""Other emitters."""

import numpy as np
from gnuradio import analog, blocks, filter

from .. import flow
from .family import Family, grid_hz, level_db, value


def _tone_draw(rng, c):
    return {"frequency_hz": grid_hz(float(rng.choice([-1, 1]) * rng.uniform(0.02, 0.4) * c.rate), c.rate)}


def _tone(x, s, d, c):
    return flow.add(x, s * np.sqrt(c.power) * flow.oscillator(d["frequency_hz"] / c.rate, len(x), c.first))


def _tone_truth(s, d, c):
    f = d["frequency_hz"]
    return {"frequency_hz": value(f), "power_dbc": value(level_db(s))}, {}, {"frequency_hz": [f, f]}


def _narrow_draw(rng, c):
    return {
        "frequency_hz": grid_hz(float(rng.choice([-1, 1]) * rng.uniform(0.05, 0.35) * c.rate), c.rate),
        "bandwidth_hz": float(c.rate * rng.uniform(0.01, 0.06)),
        "seed": int(rng.integers(1, 2**31 - 9)),
    }


def _narrow_path(s, d, c, count):
    share = d["bandwidth_hz"] / c.rate
    taps = filter.firdes.low_pass_2(1, 1, share / 2, share / 6, 60)
    noise = flow.through(flow.gaussian(count + len(taps), 1.0, d["seed"]), filter.fft_filter_ccf(1, taps))[len(taps) // 2 :][
        :count
    ]
    noise *= s * np.sqrt(c.power / np.mean(np.abs(noise) ** 2))
    return flow.multiply(noise, flow.oscillator(d["frequency_hz"] / c.rate, len(noise), 0))


def plus(path):
    def act(x, s, d, c):
        y = path(s, d, c, len(x))
        return flow.add(x, np.concatenate([y, np.zeros(len(x) - len(y))]))

    return act


def _narrow_truth(s, d, c):
    f, b = d["frequency_hz"], d["bandwidth_hz"]
    return (
        {
            "frequency_hz": value(f, z=False),
            "power_dbc": value(level_db(s), z=False),
            "bandwidth_hz": value(b, z=False),
        },
        {},
        {"frequency_hz": [f - b / 2, f + b / 2]},
    )


def _pulse_draw(rng, c):
    return {
        "period": float(c.count / rng.uniform(8, 60)),
        "duty": float(rng.uniform(0.03, 0.15)),
        "seed": int(rng.integers(1, 2**31 - 9)),
        "phase": float(rng.uniform(0, 6.28)),
    }


def _pulse_gate(d, count):
    """1 while a sawtooth of the pulses' period is under the duty cycle."""
    saw = flow.samples_real(analog.sig_source_f(1.0, analog.GR_SAW_WAVE, 1 / d["period"], 1.0, 0.0, d["phase"]), count)
    return 1 - flow.through_real(saw, blocks.threshold_ff(d["duty"], d["duty"], 0))


def _pulse_path(s, d, c, count):
    return flow.multiply(flow.gaussian(count, s**2 * c.power, d["seed"]), _pulse_gate(d, count))


def _pulse_truth(s, d, c):
    mean = level_db(s) + 10 * np.log10(d["duty"])
    return (
        {
            "period_s": value(d["period"] / c.rate, z=False),
            "duty_cycle": value(d["duty"], z=False),
            "power_dbc": value(level_db(s), z=False, also=(mean,)),
        },
        {},
        {},
    )


def _impulse_draw(rng, c):
    return {"keep": float(rng.uniform(0.15, 1)), "seed": int(rng.integers(1, 2**31 - 9))}


_IMPULSE_RATE = float(np.exp(-9 / np.sqrt(2)))  # of `GR_IMPULSE`, per sample
_IMPULSE_POWER = 81 + 18 * np.sqrt(2) + 4  # mean z² where z = 9 + √2·Exp(1)


def _impulse_path(s, d, c, count):
    z = flow.samples_real(analog.noise_source_f(analog.GR_IMPULSE, 1.0, d["seed"]), count)
    on = flow.through_real(flow.uniform(count, d["seed"] + 1), blocks.threshold_ff(1 - 2 * d["keep"], 1 - 2 * d["keep"], 0))
    turn = np.exp(1j * np.pi * flow.uniform(count, d["seed"] + 2))
    return flow.multiply(z / 9 * on * turn, np.full(count, s * np.sqrt(c.noise) / np.sqrt(_IMPULSE_POWER) * 9))


def _impulse_truth(s, d, c):
    hits = np.abs(_impulse_path(s, d, c, c.first + c.count)[c.first :])
    hits = hits[hits > 0]
    rate = len(hits) / c.duration
    power = 10 * np.log10(s**2 * c.noise)
    realised = 10 * np.log10(np.mean(hits**2)) if len(hits) else power
    return (
        {
            "rate_hz": value(rate, z=False, also=(_IMPULSE_RATE * d["keep"] * c.rate,)),
            "power_db": value(power, z=False, also=(realised,)),
        },
        {},
        {},
    )


def _second_draw(rng, c):
    return {"delay_s": float(rng.uniform(0, 0.9) * 500 / c.rate), "phase": float(rng.uniform(-3.1, 3.1))}


def _second_truth(s, d, c):
    return {"gain_db": value(level_db(s)), "delay_s": value(d["delay_s"], z=False)}, {"code": "w9"}, {}


FAMILIES = (
    Family(
        name="second_transmitter",
        level="environment",
        stage="second",
        draw=_second_draw,
        act=None,
        truth=_second_truth,
        fits=lambda c: c.offset_known_hz == 0,
    ),
    Family(
        name="tone_interference",
        level="environment",
        stage="air",
        draw=_tone_draw,
        act=_tone,
        truth=_tone_truth,
        fits=lambda c: c.offset_known_hz == 0,
    ),
    Family(
        name="narrowband_interference",
        level="environment",
        stage="air",
        draw=_narrow_draw,
        act=plus(_narrow_path),
        truth=_narrow_truth,
        stochastic=True,
        fits=lambda c: c.offset_known_hz == 0,
        start=0.1,
    ),
    Family(
        name="pulsed_interference",
        level="environment",
        stage="air",
        draw=_pulse_draw,
        act=plus(_pulse_path),
        truth=_pulse_truth,
        stochastic=True,
        start=0.1,
    ),
    Family(
        name="impulsive_noise",
        level="environment",
        stage="air",
        draw=_impulse_draw,
        act=plus(_impulse_path),
        truth=_impulse_truth,
        stochastic=True,
        start=6.0,
    ),
)
