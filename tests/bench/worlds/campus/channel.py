# SPDX-License-Identifier: GPL-3.0-or-later
"""A recording through the whole radio: four times oversampled up to the amplifier, twice through the channel.

I/Q and carrier of the transmitter → its filter → amplifier → oscillator, gain → paths → others on the air → noise → inversion →
the receiver's oscillator → filter → gain → I/Q, DC → lost samples → rails → steps. Causes are given as {family: spec}.
"""

import math

import numpy as np
from scipy import fft

from . import interpolation

TURN = 2 * np.pi
FINE = 4  # grid up to the amplifier
MARGIN = 256  # samples computed before the recording's first
GAINS = ("gain_step", "gain_drift", "power_supply_hum")
TAPS = ("tap_gain_error", "tap_delay_error", "tap_doppler", "tap_fading")
OTHERS = ("tone_interference", "narrowband_interference", "pulsed_interference", "impulsive_noise")


def sent(link):
    """The transmitted waveform on the fine grid, in a block that begins `link.lead` samples before the recording."""
    if link.fine is not None:
        return link.fine
    link.lead = 900 + int(link.latest_s * link.rate)
    link.block = fft.next_fast_len(link.n + link.spare + 2 * link.lead)
    if link.repeat:
        index = np.arange(link.block * FINE) - link.lead * FINE
        u = interpolation.periodic(link.x, FINE, link.delay, index)
        ramp = 400 * FINE  # the block's ends, far outside of the recording
        edge = np.sin(np.arange(ramp) / ramp * np.pi / 2) ** 2
        u[:ramp] *= edge
        u[-ramp:] *= edge[::-1]
    else:
        z = np.zeros(link.block, complex)
        whole = int(math.floor(link.delay))
        z[link.lead + whole : link.lead + whole + len(link.x)] = link.x
        z = fft.fft(z) * np.exp(-1j * TURN * np.fft.fftfreq(link.block) * (link.delay - whole))
        wide = np.zeros(link.block * FINE, complex)
        half = (link.block - 1) // 2
        wide[: half + 1], wide[-half:] = z[: half + 1], z[-half:]
        u = fft.ifft(wide) * FINE
    link.fine = u * link.amplitude
    return link.fine


def turned(offset, t):
    return TURN * (offset["offset_hz"] * t + 0.5 * offset["drift"] * t**2)


def at_end(causes, family, end):
    spec = causes.get(family)
    return spec if spec is not None and spec["at"] == end else None


def modulated(link, causes):
    """Spectrum of what leaves the transmitter, on the grid of twice the sample rate."""
    early = ("iq_imbalance", "front_end_filter", "carrier_frequency_offset", "phase_noise", *GAINS)
    at_tx = any(at_end(causes, f, "tx") for f in early)
    if not at_tx and not {"lo_leakage", "pa_nonlinearity"} & set(causes):
        if link.plain is None:
            link.plain = _halved(link, sent(link))
        return link.plain
    u = sent(link)
    mixer = at_end(causes, "iq_imbalance", "tx")
    if mixer:
        u = mixer["direct"] * u + mixer["image"] * np.conj(u)
    if "lo_leakage" in causes:
        u = u + causes["lo_leakage"]["level"]
    filtering = at_end(causes, "front_end_filter", "tx")
    if filtering:
        u = fft.ifft(fft.fft(u) * filtering["response"](np.fft.fftfreq(len(u), 1 / (link.rate * FINE))))
    if "pa_nonlinearity" in causes:
        u = causes["pa_nonlinearity"]["bend"](u, FINE)
    v = _halved(link, u)
    t = times(link)
    factor, phase = None, None
    offset = at_end(causes, "carrier_frequency_offset", "tx")
    if offset:
        phase = turned(offset, t)
    wander = at_end(causes, "phase_noise", "tx")
    if wander:
        phase = (0 if phase is None else phase) + np.interp(t, wander["t"], wander["phase"])
    if phase is not None:
        factor = np.exp(1j * phase)
    for family in GAINS:
        spec = at_end(causes, family, "tx")
        if spec:
            factor = (1 if factor is None else factor) * spec["gain"](t)
    return v if factor is None else fft.fft(fft.ifft(v) * factor)


def _halved(link, u):
    """What lies within the sample rate, from the grid of four times to that of twice."""
    line, out = fft.fft(u), np.zeros(2 * link.block, complex)
    half = link.block // 2
    out[:half], out[-half:] = line[:half] / 2, line[-half:] / 2
    return out


def times(link):
    return (np.arange(2 * link.block) / 2 - link.lead) / link.rate


def heard(link, causes, v):
    """The wanted signal behind the paths, on the grid of twice the rate; paths of equal motion together."""
    f, t = np.fft.fftfreq(2 * link.block, 1 / (2 * link.rate)), times(link)
    still, special = {}, []
    for i, tap in enumerate(link.taps):
        if i == link.gone and "missing_path" in causes:
            continue
        gain, delay, doppler = tap_gain(tap), tap["delay_s"], tap["doppler_hz"]
        motion, course = 0.0, None
        for family in TAPS:
            spec = causes.get(family)
            if spec is not None and spec["tap"] == i:
                gain, delay = gain * spec.get("factor", 1), delay + spec.get("later_s", 0.0)
                motion += spec.get("doppler_hz", 0.0)
                course = spec.get("course", course)
        if course is None and motion == 0:
            still.setdefault(doppler, []).append((gain, delay))
        else:
            special.append((gain, delay, doppler + motion, motion, course))
    if "extra_path" in causes:
        e = causes["extra_path"]
        special.append((e["gain"], e["delay_s"], e["doppler_hz"], e["doppler_hz"], None))
    if "diffuse_tail" in causes:
        still.setdefault(0.0, []).extend(causes["diffuse_tail"]["rays"])
    out = np.zeros(2 * link.block, complex)
    for doppler, taps in still.items():
        h = sum(gain * np.exp(-1j * TURN * f * delay) for gain, delay in taps)
        w = fft.ifft(v * h)
        out += w * np.exp(1j * TURN * doppler * t) if doppler else w
    for gain, delay, doppler, motion, course in special:
        line = v * (gain * np.exp(-1j * TURN * f * delay))
        w = fft.ifft(line)
        early, power = motion / link.carrier * t, 1.0  # a moving path's delay shrinks: Taylor's series about its first
        for order in range(1, 5 if motion else 1):
            line = line * (1j * TURN * f)
            power = power * early / order
            w = w + power * fft.ifft(line)
        if course is not None:
            w = w * course(t)
        out += w * np.exp(1j * TURN * doppler * t) if doppler else w
    return out


def tap_gain(tap):
    return 10 ** (tap["gain_db"] / 20) * np.exp(1j * tap["phase_rad"])


def received(link, causes, noise=None, slope=False):
    """The recorded samples, before the file. noise: two rows of unit circular noise; slope: the derivative per sample."""
    u = modulated(link, causes)
    if slope:
        u = u * (1j * TURN * np.fft.fftfreq(2 * link.block, 0.5))
    v = heard(link, causes, u)
    n = np.arange(-MARGIN, link.n + link.spare + MARGIN)
    t = n / link.rate
    foreign = causes.get("outside", {})
    fast = 1e-6 * causes["sample_clock_offset"]["ppm"] if "sample_clock_offset" in causes else 0.0
    if fast or "wobble" in foreign:
        wobble = foreign["wobble"](t) if "wobble" in foreign else 0.0
        y = interpolation.at(v, (n * (1 + fast) + wobble + link.lead) * 2)
    else:
        y = v[(n + link.lead) * 2]
    y = link.gain * y
    if "wanted" in foreign:
        y = foreign["wanted"](y, t)
    beside = np.zeros(len(y), complex)
    for family in OTHERS:
        if family in causes:
            beside = beside + causes[family]["signal"](t)
    if "beside" in foreign:
        beside = beside + foreign["beside"](t)
    if noise is not None:
        change = causes["noise_floor"]["change_db"] if "noise_floor" in causes else 0.0
        beside = beside + math.sqrt(link.noise * 10 ** (change / 10)) * noise[0]
        if "signal_dependent_noise" in causes:
            size = link.noise * 10 ** (causes["signal_dependent_noise"]["slope_db"] / 10) / link.wanted
            beside = beside + math.sqrt(size) * np.abs(y) * noise[1]
    if "second_transmitter" in causes:
        y = y + causes["second_transmitter"]["signal"](t)
    offset = at_end(causes, "carrier_frequency_offset", "rx")
    if offset:
        y = y * np.exp(1j * turned(offset, t))
    if link.offset_hz:  # the receiver's, which the twin knows: all that it hears is turned
        y = y * np.exp(1j * TURN * link.offset_hz * t)
    return converted(link, causes, y + beside, t)


def converted(link, causes, y, t):
    """The receiver's oscillator, filter, gain, mixer and converter."""
    if "spectral_inversion" in causes:
        y = np.conj(y)
    wander = at_end(causes, "phase_noise", "rx")
    if wander:
        y = y * np.exp(1j * np.interp(t, wander["t"], wander["phase"]))
    filtering = at_end(causes, "front_end_filter", "rx")
    if filtering:
        y = fft.ifft(fft.fft(y) * filtering["response"](np.fft.fftfreq(len(y), 1 / link.rate)))
    for family in GAINS:
        spec = at_end(causes, family, "rx")
        if spec:
            y = y * spec["gain"](t)
    mixer = at_end(causes, "iq_imbalance", "rx")
    if mixer:
        y = mixer["direct"] * y + mixer["image"] * np.conj(y)
    if "dc_offset" in causes:
        y = y + causes["dc_offset"]["signal"](t)
    y = y[MARGIN:-MARGIN]
    index = np.arange(link.n)
    if "sample_loss" in causes:
        loss = causes["sample_loss"]
        index = np.where(index < loss["joint"], index, index + loss["samples"])
    y = y[index]
    if "held" in causes.get("outside", {}):
        y = causes["outside"]["held"](y)
    if "adc_clipping" in causes:
        y = clipped(y, causes["adc_clipping"]["level"])
    if "quantization" in causes:
        step, shift = causes["quantization"]["step"], 0.5 if causes["quantization"]["rise"] else 0.0
        level = np.floor if shift else np.round
        y = (level(y.real / step) + shift) * step + 1j * (level(y.imag / step) + shift) * step
    return y


def clipped(y, level):
    return np.clip(y.real, -level, level) + 1j * np.clip(y.imag, -level, level)
