# SPDX-License-Identifier: GPL-3.0-or-later
"""The contract's meaning of each parameter in plain NumPy: checks that a truth says what GNU Radio did.

Only the numbers of the truth enter; what the contract leaves unsaid (a phase, a pole) comes from the draw.
"""

import numpy as np

from . import channel, world

NAMES = {
    "carrier_frequency_offset",
    "sample_clock_offset",
    "iq_imbalance",
    "dc_offset",
    "lo_leakage",
    "pa_nonlinearity",
    "adc_clipping",
    "gain_step",
    "gain_drift",
    "power_supply_hum",
    "extra_path",
    "missing_path",
    "tap_gain_error",
    "tap_delay_error",
    "tap_doppler",
    "second_transmitter",
    "tone_interference",
    "sample_loss",
    "spectral_inversion",
}


def _v(effect, name):
    return effect["parameters"][name]["value"]


def _imbalanced(x, effect, conjugate):
    """μx + νx*, μ = (1 + r)/2 (r* at a receiver), ν = (r − 1)/2, r = gain·e^{jφ}."""
    g, p = _v(effect, "gain_imbalance_db"), _v(effect, "phase_imbalance_rad")
    r = 10 ** (g / 20) * np.exp(1j * p)
    ratio = (r - 1) / (r + 1)
    if abs(-20 * np.log10(abs(ratio)) - _v(effect, "image_rejection_db")) > 1e-6:
        raise AssertionError("image rejection disagrees with gain and phase")
    return (1 + (np.conj(r) if conjugate else r)) / 2 * x + (r - 1) / 2 * np.conj(x)


def _turned(x, effect, n, rate):
    t = n / rate
    drift = effect["parameters"].get("drift_hz_per_s", {"value": 0.0})["value"]
    return x * np.exp(2j * np.pi * (_v(effect, "offset_hz") * t + drift * t**2 / 2))


def _gains(x, effect, cause, n, rate):
    family = effect["family"]
    if family == "gain_step":
        return np.where(n / rate >= _v(effect, "time_s") - 1e-12, 10 ** (_v(effect, "step_db") / 20), 1.0) * x
    if family == "gain_drift":
        end = 10 ** (_v(effect, "total_db") / 20) - 1
        tau, last = _v(effect, "time_constant_s"), (n[-1] + 1) / rate
        shape = -np.expm1(-np.maximum(n / rate, 0) / tau) / -np.expm1(-last / tau)
        return (1 + end * shape) * x
    return (1 + _v(effect, "depth") * np.cos(2 * np.pi * _v(effect, "frequency_hz") * n / rate + cause.draw["phase"])) * x


def _sides(effects, causes, level):
    return [(e, c) for e, c in zip(effects, causes, strict=True) if e["owner"]["level"] == level]


def _transmit(scene, effects, causes, first, count):
    """The transmitted samples n = first … first + count − 1, and where they are not simply the waveform."""
    c = scene.context
    n = np.arange(first, first + count)
    x = scene.amplitude * c.waveform.samples[n % len(c.waveform.samples)]
    mean = np.sqrt(np.mean(np.abs(c.waveform.samples) ** 2)) * scene.amplitude
    bulk = int(np.floor(c.bulk))
    m = n + bulk  # time since t = 0, in samples, at the transmitter
    for effect, cause in _sides(effects, causes, "tx"):
        family = effect["family"]
        if family == "iq_imbalance":
            x = _imbalanced(x, effect, False)
        elif family == "lo_leakage":
            x = x + mean * 10 ** (_v(effect, "level_dbc") / 20) * np.exp(1j * cause.draw["phase"])
        elif family == "pa_nonlinearity":
            turn = np.exp(1j * cause.draw["angle"])
            # |1 − s·e^{jθ}| = 10^(−compression/20), solved for s
            g = 10 ** (-_v(effect, "compression_db") / 20)
            s = turn.real - np.sqrt(max(turn.real**2 - 1 + g**2, 0))
            peak = scene.amplitude * np.max(np.abs(c.waveform.samples))
            x = x * (1 - s * turn * np.abs(x) ** 2 / peak**2)
        elif family == "carrier_frequency_offset":
            x = _turned(x, effect, m, c.rate)
        elif family in ("gain_step", "gain_drift", "power_supply_hum"):
            x = _gains(x, effect, cause, m if family != "gain_drift" else np.r_[m[:-1], c.count - 1], c.rate)
    return n, x


def clean(scene, effects, causes):
    """The recording without noise, by formula; None where a cause has none. effects, causes: same order."""
    c = scene.context
    if any(e["family"] not in NAMES or k.draw.get("memory") for e, k in zip(effects, causes, strict=True)):
        return None
    if not c.waveform.repeat:
        return None
    taps = [dict(t) for t in world.twin_taps(scene, causes)]
    for e, _k in _sides(effects, causes, "link"):
        near = [i for i, t in enumerate(taps) if abs(t["delay_s"] - _v(e, "delay_s")) < 1e-13]
        if e["family"] == "extra_path":
            taps.append(
                {
                    "delay_s": _v(e, "delay_s"),
                    "gain_db": _v(e, "gain_db"),
                    "phase_rad": _v(e, "phase_rad"),
                    "doppler_hz": _v(e, "doppler_hz"),
                }
            )
        elif e["family"] == "missing_path":
            taps.pop(near[0])
        elif e["family"] == "tap_gain_error":
            taps[near[0]]["gain_db"] += _v(e, "error_db")
            taps[near[0]]["phase_rad"] += _v(e, "error_rad")
        elif e["family"] == "tap_delay_error":
            taps[near[0]]["delay_s"] += _v(e, "error_s")
        elif e["family"] == "tap_doppler":
            taps[near[0]]["doppler_hz"] = _v(e, "doppler_hz")
    extra = 600  # samples kept past the end: for clocks and losses
    n = np.arange(-extra, c.count + extra)
    steady = not [
        e for e, _ in _sides(effects, causes, "tx") if e["family"] not in ("iq_imbalance", "lo_leakage", "pa_nonlinearity")
    ]
    period = len(c.waveform.samples)
    if steady:
        _, x = _transmit(scene, effects, causes, 0, period)
        y = _paths(x, taps, c, n)
    else:
        margin = 4 * period + 2000
        m, x = _transmit(scene, effects, causes, -int(np.floor(c.bulk)) - extra - margin, len(n) + 2 * margin)
        y = _long_paths(x, taps, c, n, margin)
    wanted = np.sqrt(np.mean(np.abs(y * c.gain) ** 2))
    for e, k in _sides(effects, causes, "environment"):
        if e["family"] == "second_transmitter":
            tap = {
                "delay_s": _v(e, "delay_s"),
                "gain_db": _v(e, "gain_db"),
                "phase_rad": k.draw["phase"],
                "doppler_hz": 0.0,
            }
            y = y + _paths(scene.second.samples, [tap], c, n)
    y = y * c.gain
    for e, _k in _sides(effects, causes, "environment"):
        if e["family"] == "tone_interference":
            level = wanted * 10 ** (_v(e, "power_dbc") / 20)
            y = y + level * np.exp(2j * np.pi * _v(e, "frequency_hz") * n / c.rate)
    y = y * np.exp(2j * np.pi * c.offset_known_hz * n / c.rate)
    for e, k in _sides(effects, causes, "rx"):
        family = e["family"]
        if family == "iq_imbalance":
            y = _imbalanced(y, e, True)
        elif family == "dc_offset":
            y = y + wanted * 10 ** (_v(e, "level_dbc") / 20) * np.exp(1j * k.draw["phase"])
        elif family == "carrier_frequency_offset":
            y = _turned(y, e, n, c.rate)
        elif family in ("gain_step", "gain_drift", "power_supply_hum"):
            m = n if family != "gain_drift" else np.r_[n[:-1], c.count - 1]
            y = _gains(y, e, k, m, c.rate)
        elif family == "spectral_inversion":
            y = np.conj(y)
        elif family == "sample_clock_offset":
            y = _fast(y, _v(e, "offset_ppm"))
    for e, _k in _sides(effects, causes, "rx"):
        if e["family"] == "adc_clipping":
            a = _v(e, "level")
            y = np.clip(y.real, -a, a) + 1j * np.clip(y.imag, -a, a)
    y = y[extra:]
    for e, _k in _sides(effects, causes, "rx"):
        if e["family"] == "sample_loss":
            at, lost = round(_v(e, "time_s") * c.rate), int(_v(e, "samples"))
            y = np.concatenate([y[:at], y[at + lost :]])
    return y[: c.count]


def _paths(x, taps, c, n):
    """Periodic samples through taps by Fourier series, at sample times n."""
    wave = type("W", (), {"samples": x, "repeat": True})
    return channel.predict(
        wave,
        [{**t, "phase_rad": t["phase_rad"] + 2 * np.pi * t["doppler_hz"] * n[0] / c.rate} for t in taps],
        rate=c.rate,
        delay=c.bulk - n[0],
        count=len(n),
    )


def _long_paths(x, taps, c, n, margin):
    """A long stretch of samples through taps by one long FFT; its ends are cut away."""
    size = 1 << int(np.ceil(np.log2(len(x))))
    spectrum, f = np.fft.fft(x, size), np.fft.fftfreq(size)
    out = np.zeros(len(n), complex)
    for t in taps:
        turn = np.exp(-2j * np.pi * f * (t["delay_s"] * c.rate + c.bulk - np.floor(c.bulk)))
        y = np.fft.ifft(spectrum * turn)[margin:][: len(n)]
        out += channel.amplitude(t) * y * np.exp(2j * np.pi * t["doppler_hz"] * n / c.rate)
    return out


def _fast(y, ppm):
    """y(t·(1 + ppm)) by Fourier interpolation on a fine grid and a cubic within it."""
    from scipy.interpolate import CubicSpline
    from scipy.signal import resample

    fine = resample(y, 8 * len(y))
    at = np.arange(len(y)) * (1 + ppm * 1e-6) * 8
    return CubicSpline(np.arange(len(fine)), fine)(np.clip(at, 0, len(fine) - 1))


def misfit(scene, effects, causes, played=None):
    """Energy over noise variance of GNU Radio's noiseless recording less the formula's; None without one."""
    model = clean(scene, effects, causes)
    if model is None:
        return None
    y = world.play(scene, causes, noise=False) if played is None else played
    return float(np.sum(np.abs(_best(y, model)) ** 2) / scene.context.noise)


def _best(y, model):
    """The residual at the best whole and fractional delay, and complex gain."""
    f = np.fft.fftfreq(len(model))
    lags = np.arange(-40, 41)
    lag = lags[np.argmax([abs(np.vdot(np.roll(model, k), y)) for k in lags])]
    spectrum = np.fft.fft(np.roll(model, lag))
    d = 0.0
    cut = slice(64, -64)
    for _ in range(6):
        m = np.fft.ifft(spectrum * np.exp(-2j * np.pi * f * d))
        slope = np.fft.ifft(-2j * np.pi * f * spectrum * np.exp(-2j * np.pi * f * d))
        w = np.linalg.lstsq(np.stack([m, slope], 1)[cut], y[cut], rcond=None)[0]
        d += float(np.clip((w[1] / w[0]).real, -0.5, 0.5))
    return (y - np.stack([m, slope], 1) @ w)[cut]
