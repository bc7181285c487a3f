# SPDX-License-Identifier: GPL-3.0-or-later
"""What the link does: paths more, fewer, other than the twin says."""

import numpy as np
from gnuradio import channels

from .. import channel, flow
from .family import Family, grid_hz, level_db, value


def _tap(delay, gain, doppler=0.0):
    return {
        "delay_s": float(delay),
        "gain_db": level_db(gain),
        "phase_rad": float(np.angle(gain)),
        "doppler_hz": float(doppler),
    }


def _slow_doppler(rng, c):
    """A Doppler whose motion stays under 0.003 samples of delay, so that turning the phase alone is right."""
    most = min(0.003 * c.carrier_hz / c.count, 400.0)
    return float(rng.uniform(0.2, 1) * most * rng.choice([-1, 1])) if rng.random() < 0.5 and most * c.duration > 1.5 else 0.0


def _span(c):
    top = 0.4 * len(c.waveform.samples) if c.waveform.repeat else 400
    return min(top, 200)


def _extra_draw(rng, c):
    have = [t["delay_s"] * c.rate for t in c.taps]
    while True:
        delay = rng.uniform(2.5, _span(c))
        if min(abs(delay - h) for h in have) >= 2.5:
            break
    return {
        "delay_s": float(delay / c.rate),
        "phase": float(rng.uniform(-3.1, 3.1)),
        "doppler_hz": grid_hz(_slow_doppler(rng, c), c.rate),
    }


def _extra(taps, s, d, c):
    return [*taps, _tap(d["delay_s"], s * np.exp(1j * d["phase"]), d["doppler_hz"])]


def _extra_truth(s, d, c):
    return (
        {
            "delay_s": value(d["delay_s"]),
            "gain_db": value(level_db(s)),
            "phase_rad": value(d["phase"], z=False),
            "doppler_hz": value(d["doppler_hz"], z=d["doppler_hz"] != 0),
        },
        {},
        {"delay_s": [d["delay_s"]] * 2},
    )


def _which_tap(rng, c):
    return {
        "tap": int(rng.integers(0, len(c.taps))),
        "phase": float(rng.uniform(-np.pi, np.pi)),
        "sign": int(rng.choice([-1, 1])),
    }


def _weak_tap(rng, c):
    return {"tap": int(rng.integers(1, len(c.taps)))}


def _rescaled(taps, s, d, c):
    """The twin's tap takes the strength; the world lacks it."""
    index = d["tap"]
    return [{**t, "gain_db": round(level_db(s), 3)} if k == index else t for k, t in enumerate(taps)]


def _missing_truth(s, d, c):
    delay = c.taps[d["tap"]]["delay_s"]
    return {"delay_s": value(delay, z=False)}, {}, {"delay_s": [delay, delay]}


def _swap(taps, d, new):
    return [new if k == d["tap"] else t for k, t in enumerate(taps)]


def _gain_error(taps, s, d, c):
    old = taps[d["tap"]]
    return _swap(
        taps,
        d,
        _tap(old["delay_s"], channel.amplitude(old) * (1 + s * np.exp(1j * d["phase"])), old["doppler_hz"]),
    )


def _at_tap(c, d):
    delay = c.taps[d["tap"]]["delay_s"]
    return {"delay_s": value(delay, z=False)}, {"delay_s": [delay, delay]}


def _gain_error_truth(s, d, c):
    p, where = _at_tap(c, d)
    e = 1 + s * np.exp(1j * d["phase"])
    return {**p, "error_db": value(level_db(e)), "error_rad": value(np.angle(e))}, {}, where


def _delay_error(taps, s, d, c):
    old = taps[d["tap"]]
    return _swap(taps, d, {**old, "delay_s": old["delay_s"] + d["sign"] * s / c.rate})


def _delay_error_truth(s, d, c):
    p, where = _at_tap(c, d)
    return {**p, "error_s": value(d["sign"] * s / c.rate)}, {}, where


def _doppler_hz(s, d, c):
    return grid_hz(d["sign"] * s / c.duration, c.rate)


def _tap_doppler(taps, s, d, c):
    return _swap(taps, d, {**taps[d["tap"]], "doppler_hz": _doppler_hz(s, d, c)})


def _tap_doppler_truth(s, d, c):
    p, where = _at_tap(c, d)
    return {**p, "doppler_hz": value(_doppler_hz(s, d, c))}, {}, where


def _fading_draw(rng, c):
    return {
        "tap": int(rng.integers(0, len(c.taps))),
        "spread_hz": float(min(rng.uniform(4, 40) / c.duration, 0.002 * c.rate)),
        "seed": int(rng.integers(1, 2**31 - 9)),
    }


def fading(s, d, c, count):
    """1 + s·Rayleigh of `fading_model`, whose own line of sight would carry a Doppler."""
    block = channels.fading_model(24, d["spread_hz"] / c.rate, False, 1.0, d["seed"])
    return 1 + s * flow.same_length(np.ones(count), block)


def _fading_truth(s, d, c):
    p, where = _at_tap(c, d)
    part = fading(s, d, c, c.first + c.count)[c.first :]
    realised = 10 * np.log10(abs(part.mean()) ** 2 / part.var())
    return (
        {
            **p,
            "k_factor_db": value(-level_db(s), z=False, also=(realised,)),
            "doppler_spread_hz": value(d["spread_hz"], z=False, also=(d["spread_hz"] / np.sqrt(2), 2 * d["spread_hz"])),
        },
        {},
        where,
    )


def _tail_draw(rng, c):
    decay = rng.uniform(5, min(25, 0.08 * len(c.waveform.samples)))
    return {"decay": float(decay), "start": float(rng.uniform(2, 4)), "seed": int(rng.integers(2**31 - 9))}


def _tail(taps, s, d, c):
    lags = np.arange(int(7 * d["decay"]))
    h = flow.gaussian(len(lags), 1.0, d["seed"]) * np.exp(-lags / d["decay"] / 2)
    h *= s / np.sqrt(np.sum(np.abs(h) ** 2))
    return [*taps, *(_tap((d["start"] + lag) / c.rate, g) for lag, g in zip(lags, h, strict=True))]


def _tail_truth(s, d, c):
    start = d["start"] / c.rate
    decay = d["decay"] / c.rate
    return (
        {"decay_s": value(decay, z=False, also=(2 * decay,)), "power_db": value(level_db(s), z=False)},
        {},
        {"delay_s": [start, start + 3 * decay]},
    )


def _many(c):
    return len(c.taps) >= 3


FAMILIES = (
    Family(name="extra_path", level="link", stage="link", draw=_extra_draw, act=_extra, truth=_extra_truth),
    Family(
        name="missing_path",
        level="link",
        stage="twin",
        draw=_weak_tap,
        act=_rescaled,
        truth=_missing_truth,
        fits=_many,
        start=0.05,
    ),
    Family(
        name="tap_gain_error",
        level="link",
        stage="link",
        draw=_which_tap,
        act=_gain_error,
        truth=_gain_error_truth,
        fits=_many,
    ),
    Family(
        name="tap_delay_error",
        level="link",
        stage="link",
        draw=_which_tap,
        act=_delay_error,
        truth=_delay_error_truth,
        fits=_many,
    ),
    Family(
        name="tap_doppler",
        level="link",
        stage="link",
        draw=_which_tap,
        act=_tap_doppler,
        truth=_tap_doppler_truth,
        fits=lambda c: len(c.taps) >= 2 and all(t["doppler_hz"] == 0 for t in c.taps),
        start=0.05,
        same_as=("extra_path_at_tap",),
    ),
    Family(
        name="tap_fading",
        level="link",
        stage="fade",
        draw=_fading_draw,
        act=fading,
        truth=_fading_truth,
        fits=lambda c: len(c.taps) >= 2,
        stochastic=True,
    ),
    Family(
        name="diffuse_tail",
        level="link",
        stage="link",
        draw=_tail_draw,
        act=_tail,
        truth=_tail_truth,
        fits=lambda c: len(c.waveform.samples) > 400,
    ),
)
